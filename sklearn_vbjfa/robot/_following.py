"""Bodies of joints that follow others, as effects that the robot declares by itself."""

import numpy as np

from sklearn_vbjfa.effects import ChainJoint, Follower
from sklearn_vbjfa.model._loading import import_pinocchio
from sklearn_vbjfa.model._mjcf import FollowingJoint


def with_followers(effects, features):
    """Return the bodies of a robot's followers, and behind them declared effects.

    Parameters
    ----------
    effects : tuple of Effect
        What is declared; followers among them are taken from the robot instead.
    features : RigidBodyFeatures
        Loaded features.
    """
    declared = tuple(one for one in effects if not _follows(one))
    return (*map(_follower, features.followers_), *declared)


def follower_parameters(effects, coefficients):
    """Return the inertial parameters (10,) of followers, by the joints' names.

    effects, coefficients : all effects of a robot and what each was found to be.
    """
    return {
        effect.of: np.asarray(own)
        for effect, own in zip(effects, coefficients)
        if _follows(effect)
    }


def following_joints(effects, coefficients, names):
    """Return the followers as MJCF has them, a tuple of `FollowingJoint`.

    effects, coefficients : all effects of a robot and what each was found to be;
    names : joints of the robot.
    """
    pin = import_pinocchio()
    found = [pair for pair in zip(effects, coefficients) if _follows(pair[0])]
    # What carries others has a shorter way to the base.
    found.sort(key=lambda pair: len(pair[0].chain))
    ways = {tuple(effect.chain): effect.of for effect, _ in found}
    joints = []
    for effect, own in found:
        *above, last = map(ChainJoint.of_flat, effect.chain)
        carrier = ways.get(tuple(effect.chain[:-1]))
        if carrier is None and above:
            carrier = names[above[-1].joint]
        joints.append(
            FollowingJoint(
                name=effect.of,
                carrier=carrier,
                leader=last.joint,
                rate=last.rate,
                offset=last.offset,
                slides=last.slides,
                placement=pin.SE3(np.reshape(last.frame, (3, 3)), np.array(last.place)),
                axis=np.asarray(last.axis),
                body=np.asarray(own),
            )
        )
    return tuple(joints)


def refuse_followers(effects, what, remedy):
    """Refuse something that cannot be done with joints that follow others.

    effects : all effects of a robot; what : what cannot be done; remedy : what can.
    """
    names = [effect.of for effect in effects if _follows(effect)]
    if names:
        raise ValueError(
            f"{what} cannot do with joints that follow others, {', '.join(names)}: "
            f"{remedy}, or give a description in which they are fixed joints."
        )


def _follows(effect):
    return isinstance(effect, Follower)


def nominal_followers(features):
    """Inertial parameters of the followers in the description, (n, 10)."""
    found = [body.parameters for body in features.followers_]
    return np.reshape(found, (-1, 10))


def _follower(body):
    """Turn a `FollowingBody` into an effect."""
    chain = tuple(
        ChainJoint(
            joint=link.joint,
            rate=link.rate,
            offset=link.offset,
            slides=link.slides,
            place=tuple(link.placement.translation),
            frame=tuple(link.placement.rotation.ravel()),
            axis=tuple(link.axis),
        ).flat()
        for link in body.chain
    )
    return Follower(
        joint=body.leader,
        of=body.name,
        chain=chain,
        gravity=tuple(map(float, body.gravity)),
    )
