"""Joints that follow others: which can be folded into their leaders, and their bodies.

A follower is folded if it carries nothing but followers: the robot that is left is a
tree of joints with encoders and motors, and the followers' bodies are felt by these.
"""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.model._pinocchio import import_pinocchio


@dataclass(frozen=True, kw_only=True)
class Link:
    """How a joint follows another: position = multiplier * leader + offset."""

    leader: str  # name of the joint that moves it, which may follow another one
    multiplier: float
    offset: float  # [rad or m]


@dataclass(frozen=True, kw_only=True, eq=False)
class ChainLink:
    """One joint between the base and the body of a follower."""

    joint: int  # joint of the folded robot that moves it, from zero
    # its position is rate times that of `joint` plus offset
    rate: float
    offset: float
    slides: bool  # whether it is prismatic
    placement: object  # where it is in the frame of the joint before it
    axis: np.ndarray  # (3,): its direction in its own frame


@dataclass(frozen=True, kw_only=True, eq=False)
class FollowingBody:
    """The body that a follower moves."""

    name: str
    leader: int  # joint of the folded robot that moves it, from zero
    chain: tuple  # joints from the base to the body
    gravity: np.ndarray  # (3,) [m/s^2]
    parameters: np.ndarray  # (10,): of the description, in Pinocchio's order


@dataclass(frozen=True, kw_only=True, eq=False)
class Folded:
    """A robot without its followers."""

    model: object  # joints that are left, with their bodies
    followers: tuple  # bodies that these move besides
    # the same with the followers' bodies held where they are while the leaders are at
    # zero, so that no mass is missing
    still: object
    full: object  # robot in which followers are joints of their own
    links: dict

    @classmethod
    def without(cls, model):
        """Return a robot that has no followers."""
        return cls(model=model, followers=(), still=model, full=model, links={})


def foldable(carriers, links, path):
    """Return the followers that carry nothing but followers, by name."""
    # Their leaders do not follow themselves. carriers: for each joint the one that
    # carries it, or None; path: what messages name.
    for name, link in links.items():
        if link.leader not in carriers:
            raise ValueError(
                f"{str(path)!r}: joint {name!r} is to follow {link.leader!r}, which is "
                "no moving joint of the robot; correct the description."
            )
        seen = [name]
        while seen[-1] in links:
            seen.append(links[seen[-1]].leader)
            if seen[-1] in seen[:-1]:
                raise ValueError(
                    f"{str(path)!r}: the joints {', '.join(seen[:-1])} follow each "
                    "other in a ring; correct the description."
                )
    kept = dict(links)
    while True:
        carrying = {
            carrier
            for joint, carrier in carriers.items()
            if joint not in kept and carrier in kept
        }
        if not carrying:
            return {name: _resolved(name, kept) for name in kept}
        kept = {name: link for name, link in kept.items() if name not in carrying}


def _resolved(name, links):
    """Return how a follower moves with a joint that does not follow."""
    leader, rate, offset = name, 1.0, 0.0
    while leader in links:
        link = links[leader]
        offset, rate = offset + rate * link.offset, rate * link.multiplier
        leader = link.leader
    return Link(leader=leader, multiplier=rate, offset=offset)


def fold(full, links):
    """Take followers that are `foldable` out of a robot."""
    if not links:
        return Folded.without(full)
    pin = import_pinocchio()
    names = list(full.names)
    left = [name for name in names[1:] if name not in links]
    empty = full.copy()
    for name in links:
        empty.inertias[names.index(name)] = pin.Inertia.Zero()
    at_zero = np.zeros(full.nq)
    for name, link in links.items():
        at_zero[full.joints[names.index(name)].idx_q] = link.offset
    locked = [names.index(name) for name in links]
    model, still = (
        pin.buildReducedModel(one, locked, at_zero) for one in (empty, full)
    )
    model.name = still.name = full.name
    steps = {}
    data = full.createData()
    for at, name in enumerate(names[1:], 1):
        pin.forwardKinematics(full, data, np.zeros(full.nq), np.eye(full.nv)[at - 1])
        motion = data.v[at]
        slides = not motion.angular.any()
        axis = motion.linear if slides else motion.angular
        link = links.get(name, Link(leader=name, multiplier=1.0, offset=0.0))
        steps[at] = ChainLink(
            joint=left.index(link.leader),
            rate=link.multiplier,
            offset=link.offset,
            slides=slides,
            placement=full.jointPlacements[at].copy(),
            axis=axis / np.linalg.norm(axis),
        )
    followers = []
    for name in names[1:]:
        if name not in links:
            continue
        at, chain = names.index(name), []
        parameters = full.inertias[at].toDynamicParameters()
        while at > 0:
            chain.insert(0, steps[at])
            at = int(full.parents[at])
        followers.append(
            FollowingBody(
                name=name,
                leader=left.index(links[name].leader),
                chain=tuple(chain),
                gravity=full.gravity.linear.copy(),
                parameters=parameters,
            )
        )
    return Folded(
        model=model, followers=tuple(followers), still=still, full=full, links=links
    )
