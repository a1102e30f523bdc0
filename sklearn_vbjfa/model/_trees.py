"""Trees of joints as Pinocchio has them: what they hold, and which joints count.

A base that is free is held in one orientation: a recording of joints says nothing of
where it is, and of its orientation what gravity shows. A joint that follows another is
folded if it carries nothing but followers: the robot that is left is a tree of joints
with encoders and motors, which feel the followers' bodies.
"""

import sys
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sklearn_vbjfa.physical import (
    body_scales,
    inertial_parameters,
    min_eigenvalue,
    pseudo_inertia,
)

# A body's smallest pseudo-inertia eigenvalue, in units of its own mass and length,
# below which the body has next to no extension in some direction.
_SOLID = 1e-6
# No robot has joints farther apart [m].
_LONGEST = 50.0
# Beyond this a position limit stands for none, and what is looked at of a slide [m].
_NO_LIMIT, _SLIDE = 1e6, 1.0
# Radius of the ball without whose extension no body is, over the largest distance
# between joints.
_BALL = 0.1
# Sine of the angle from the vertical below which a base is called level.
_LEVEL = 1e-6


def import_pinocchio():
    """Import pinocchio, or say in one line how to get it."""
    try:
        import pinocchio
    except ImportError as error:
        # PyPI has no wheels for Windows.
        how = 'pip install "pin>=3.3.1"'
        if sys.platform == "win32":
            how = "conda install -c conda-forge pinocchio"
        raise ImportError(
            f"Robot models need Pinocchio, which is not installed: {how}"
        ) from error
    return pinocchio


# -- what a tree holds -----------------------------------------------------------------


def joint_names(model):
    """Names of the moving joints, in Pinocchio's order."""
    return tuple(model.names)[1:]


def body_names(model):
    """Names of the bodies that the joints move, in Pinocchio's order."""
    # Of several links that are fixed to each other, the one next to the joint; the
    # joint's own name where the description names none.
    body = import_pinocchio().FrameType.BODY
    found = {}
    for frame in model.frames:
        if frame.type == body:
            found.setdefault(frame.parentJoint, frame.name)
    return tuple(found.get(j, name) for j, name in enumerate(model.names))[1:]


def is_prismatic(model):
    """Return which joints are prismatic, ndarray of shape (nv,) of bool."""
    return np.array(
        [joint.shortname().startswith("JointModelP") for joint in model.joints[1:]]
    )


def position_range(model):
    """Return lowest and highest positions, a turn or 2 m where there is no limit."""
    reach = np.where(is_prismatic(model), _SLIDE, np.pi)
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    low = np.where(np.abs(low) < _NO_LIMIT, low, -reach)
    return low, np.where(np.abs(high) < _NO_LIMIT, high, reach)


def joint_origin(model, joint):
    """Axes (3, 3) of a joint's origin in its carrying link, as a URDF has them."""
    # Links that are fixed to each other are one body of the model, in whose axes the
    # placement is; that of the carrying link is among its frames. A model without
    # frames of links has the body's axes.
    pin = import_pinocchio()
    placed = model.jointPlacements[joint + 1].rotation
    name = model.names[joint + 1]
    if not model.existFrame(name, pin.FrameType.JOINT):
        return placed.copy()
    frame = model.frames[model.getFrameId(name, pin.FrameType.JOINT)]
    link = model.frames[frame.parentFrame]
    carried = link.parentJoint == model.parents[joint + 1]
    if link.type != pin.FrameType.BODY or not carried:
        return placed.copy()
    return link.placement.rotation.T @ placed


def nominal_parameters(model):
    """Inertial parameters (nv, 10) in the model, about the joint frames."""
    # Pinocchio's order: m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz [kg, kg m, kg
    # m^2].
    return np.array([body.toDynamicParameters() for body in model.inertias[1:]])


def solid_bodies(bodies, least=_SOLID):
    """Return which bodies (nv, 10) have mass and extension, (nv,) of bool."""
    # least: eigenvalue of the pseudo-inertia, in units of the body's mass and length.
    solid = bodies[:, 0] > 0
    mass, size = body_scales(bodies[solid])
    smallest = min_eigenvalue(bodies[solid], mass_scale=mass, length_scale=size)
    solid[solid] = smallest > least
    return solid


def with_extension(model, least):
    """Give bodies that no solid body is at least the extension of a small ball."""
    # least: see `solid_bodies`.
    size = [np.linalg.norm(place.translation) for place in model.jointPlacements[1:]]
    ball = 0.2 * (_BALL * (max(size, default=0.0) or 1.0)) ** 2
    pin = import_pinocchio()
    bodies = nominal_parameters(model)
    thin = (bodies[:, 0] > 0) & ~solid_bodies(bodies, least)
    for k in np.flatnonzero(thin).tolist():
        P = pseudo_inertia(bodies[k])
        shift = np.outer(P[:3, 3], P[:3, 3]) / P[3, 3]
        # Second moments of the mass about its centre, along their principal axes.
        moment, axes = np.linalg.eigh(P[:3, :3] - shift)
        P[:3, :3] = shift + (axes * np.maximum(moment, ball * P[3, 3])) @ axes.T
        rounder = pin.Inertia.FromDynamicParameters(inertial_parameters(P))
        model.inertias[k + 1] = rounder
    return model


def with_bodies(model, bodies, armature=None):
    """Return a copy of a model with other bodies (nv, 10) and rotor inertias (nv,)."""
    pin = import_pinocchio()
    out = model.copy()
    for j, body in enumerate(bodies):
        if not body[0] > 0:
            raise ValueError(
                f"The body of {model.names[j + 1]} has the mass {body[0]:.6g} kg: only "
                "physically consistent parameters can be simulated. Identify with "
                'projector="default".'
            )
        out.inertias[j + 1] = pin.Inertia.FromDynamicParameters(body)
    out.armature = np.zeros(model.nv) if armature is None else np.asarray(armature)
    return out


class Tree(NamedTuple):
    """Geometry of the joints, as loops over them need it."""

    parents: np.ndarray  # (nv,): number of the parent, -1 for none
    # (nv, 3): place of a joint at zero in its parent's frame [m]; zero without parent
    offsets: np.ndarray
    frames: np.ndarray  # (nv, 3, 3): its axes, by rows, in the frame of its parent
    # (nv, 3): direction about or along which it moves, in its own frame
    axes: np.ndarray
    # (nv,): radians and metres by unit of its position; a helical joint has both
    turns: np.ndarray
    slides: np.ndarray
    # (nv, 3): acceleration in place of gravity, of joints without parent [m/s^2]
    base: np.ndarray
    base_angular: np.ndarray  # (3,): its angular part [rad/s^2]
    # (nv, 3): coordinate that moves a joint, and rate and offset of the joint by it
    leads: np.ndarray

    def changed(self, **values):
        """Return the tree with some other values."""
        return self._replace(**values)


def describe(model):
    """Return the `Tree` of a model, from how Pinocchio moves its joints."""
    pin, nv = import_pinocchio(), model.nv
    tree = Tree(
        parents=np.array(model.parents.tolist()[1:]) - 1,
        offsets=np.zeros((nv, 3)),
        frames=np.empty((nv, 3, 3)),
        axes=np.empty((nv, 3)),
        turns=np.empty(nv),
        slides=np.empty(nv),
        base=np.zeros((nv, 3)),
        base_angular=-model.gravity.angular,
        leads=np.arange(nv)[:, None] * (1.0, 0.0, 0.0) + (0.0, 1.0, 0.0),
    )
    data, zero = model.createData(), np.zeros(model.nq)
    for i in range(nv):
        # The motion of a joint in its own frame is the same everywhere.
        pin.forwardKinematics(model, data, zero, np.eye(nv)[i])
        placement, motion = data.liMi[i + 1], data.v[i + 1]
        turns = motion.angular.any()
        axis = motion.angular if turns else motion.linear
        tree.axes[i] = axis / np.linalg.norm(axis)
        tree.turns[i], tree.slides[i] = turns, motion.linear @ tree.axes[i]
        tree.frames[i] = placement.rotation.T
        if tree.parents[i] >= 0:
            tree.offsets[i] = placement.translation
        else:
            # Moments about the first joint: about the world's origin those of a robot
            # far away would be rounded. The base accelerates upwards for gravity.
            lever = np.cross(tree.base_angular, placement.translation)
            tree.base[i] = lever - model.gravity.linear
    return tree


def side_by_side(trees):
    """Return several trees as one, under the gravity of the first one."""
    sizes = [tree.parents.size for tree in trees]
    shift = np.repeat(np.cumsum(sizes) - sizes, sizes)
    whole = Tree(*map(np.concatenate, zip(*trees)))
    return whole.changed(
        parents=np.where(whole.parents < 0, -1, whole.parents + shift),
        base_angular=trees[0].base_angular,
    )


def check_kinds(model, tree):
    """Refuse joints that no description can hold, which turn and slide at once."""
    both = (tree.turns != 0) & (tree.slides != 0)
    wrong = [name for name, helical in zip(joint_names(model), both) if helical]
    if wrong:
        raise ValueError(
            f"URDF and MJCF have no helical joint, which {', '.join(wrong)} would be: "
            "only revolute and prismatic joints can be written."
        )


def in_order(model, names):
    """Return a model with its joints in another order, parents before children."""
    # Readers of URDF put branches of a tree in an order of their own.
    current = joint_names(model)
    if tuple(names) == current:
        return model
    if sorted(names) != sorted(current):
        raise ValueError(
            f"the joints {', '.join(names)} are not those of the robot description, "
            f"{', '.join(current)}"
        )
    made = import_pinocchio().Model()
    made.name, made.gravity = model.name, model.gravity
    made.inertias[0] = model.inertias[0]
    numbers = {0: 0}
    for name in names:
        old = model.getJointId(name)
        if model.parents[old] not in numbers:
            raise ValueError(f"joint {name} comes before the one that carries it")
        joint = model.joints[old]
        q = slice(joint.idx_q, joint.idx_q + joint.nq)
        v = slice(joint.idx_v, joint.idx_v + joint.nv)
        numbers[old] = made.addJoint(
            numbers[model.parents[old]],
            joint,
            model.jointPlacements[old],
            name,
            model.effortLimit[v],
            model.velocityLimit[v],
            model.lowerPositionLimit[q],
            model.upperPositionLimit[q],
        )
        made.inertias[numbers[old]] = model.inertias[old]
        at = made.joints[numbers[old]].idx_v
        made.armature[at : at + joint.nv] = model.armature[v]
    frames = {0: 0}
    # Those of a joint come after those of the joint that carries it.
    order = sorted(
        range(1, len(model.frames)), key=lambda k: numbers[model.frames[k].parentJoint]
    )
    for old in order:
        frame = model.frames[old]
        moved = frame.copy()
        moved.parentJoint = numbers[frame.parentJoint]
        moved.parentFrame = frames[frame.parentFrame]
        # The inertias of the joints have those of the frames already.
        frames[old] = made.addFrame(moved, False)
    return made


def check_joints(loaded):
    """Refuse a model with joints of other than one degree of freedom, or none."""
    if loaded.nv == 0:
        raise ValueError(
            "The robot model has no moving joint; expected a tree of revolute or "
            "prismatic joints. Check the joint types in the description."
        )
    wrong = [
        f"{loaded.names[i]} ({joint.shortname()}, nq={joint.nq}, nv={joint.nv})"
        for i, joint in enumerate(loaded.joints)
        if i > 0 and (joint.nq, joint.nv) != (1, 1)
    ]
    if wrong:
        raise ValueError(
            "Every joint must have one degree of freedom (nq == nv); got "
            + ", ".join(wrong)
            + ". A free joint is held only if there is no other one and it carries all "
            "other joints. Split spherical joints into three revolute ones, and lock "
            "what does not move with pinocchio.buildReducedModel (command line: "
            "--joints)."
        )
    lengths = [np.linalg.norm(place.translation) for place in loaded.jointPlacements]
    far = int(np.argmax(lengths))
    if lengths[far] > _LONGEST:
        raise ValueError(
            f"Joint {loaded.names[far]} is {lengths[far]:.3g} m from the joint before "
            "it: lengths of a description are in metres, and these look like "
            "millimetres; divide them by 1000."
        )
    for name, body in zip(loaded.names[1:], loaded.inertias[1:]):
        if np.trace(body.inertia) > 2 * body.mass * _LONGEST**2 > 0:
            raise ValueError(
                f"The inertia of the body of joint {name} is that of {body.mass:.3g} "
                f"kg more than {_LONGEST:g} m away: inertias of a description are in "
                "kg m^2, and these look like kg mm^2; divide them by 1e6."
            )
    return loaded


# -- what a description says -----------------------------------------------------------


class Closure(NamedTuple):
    """What a description has beside its tree of joints and cannot be kept."""

    said: str
    bodies: tuple = ()  # links that it joins, None for the world
    joints: tuple = ()  # joints that it couples, where it joins no links


@dataclass(frozen=True, kw_only=True, eq=False)
class Description:
    """What a description says of a robot, all its joints in one model."""

    model: object
    called: str  # how messages call the robot
    listed: tuple = ()  # names of the joints as listed, which may be any order
    links: dict = field(default_factory=dict)  # name -> `Link`
    closures: tuple = ()
    left_out: tuple = ()  # sentences on what does not enter the model

    @property
    def names(self):
        """Names of the joints, a tuple."""
        return joint_names(self.model)

    @property
    def in_file_order(self):
        """Names of the joints in the order of the file, a tuple."""
        # It may name what a joint carries before the joint.
        return tuple(name for name in self.listed or self.names if name in self.names)

    @property
    def carriers(self):
        """Name of the joint that carries each joint, name -> name or None."""
        return carriers_of(self.model)

    @property
    def free(self):
        """Names of the joints that let a body float freely."""
        kinds = [joint.shortname() for joint in self.model.joints][1:]
        pairs = zip(self.names, kinds)
        return [name for name, kind in pairs if kind == "JointModelFreeFlyer"]

    def with_base(self, name, turn=None):
        """Hold the free joint at the root; return the robot, and its base's axes."""
        # turn (3, 3): axes of the base in the world; None for those of the description.
        pin, model = import_pinocchio(), self.model
        at = model.getJointId(name)
        placed = model.jointPlacements[at].rotation
        turn = placed if turn is None else turn
        q = pin.neutral(model)
        first = model.joints[at].idx_q + 3
        q[first : first + 4] = pin.Quaternion(placed.T @ turn).coeffs()
        return replace(self, model=pin.buildReducedModel(model, [at], q)), turn

    def held(self, moving):
        """Return the robot, whose joints that are not named stay at zero."""
        # A follower that is named has columns and a torque of its own.
        unknown = [name for name in moving if name not in self.names]
        if unknown:
            raise ValueError(
                f"{self.called}: the robot has no movable joint {unknown[0]!r}; it has "
                f"{', '.join(self.names) or 'none'}."
            )
        links = {name: link for name, link in self.links.items() if name not in moving}
        follow = led_by(moving, self.carriers, links, self.called)
        for name, link in links.items():
            if name not in follow and link.leader in moving:
                raise ValueError(
                    f"{self.called}: {name} follows {link.leader}, which moves, and "
                    "carries joints that do not follow: it can neither be held nor "
                    "folded. Give it columns and a torque (name it as well), or hold "
                    f"{link.leader} too."
                )
        pin, model = import_pinocchio(), self.model
        still = [
            k
            for k, name in enumerate(self.names, 1)
            if name not in moving and name not in follow
        ]
        if still:
            model = pin.buildReducedModel(model, still, pin.neutral(model))
        links = {name: link for name, link in links.items() if name in follow}
        return replace(self, model=model, links=links)

    def check(self):
        """Refuse what is not a tree of joints of one degree of freedom each."""
        wrong = [one.said for one in self.closures if self._closes(one)]
        if wrong:
            raise ValueError(
                f"{self.called}: {'; '.join(wrong)}. Take out what closes the loop, or "
                "hold what is not recorded at zero: name the joints that are (--joints "
                "in the command line, joint_names in Python)."
            )
        check_joints(self.model)

    def _closes(self, closure):
        """Whether a closure is felt by the joints; held ones make one body of two."""
        if closure.joints:
            return not set(closure.joints).isdisjoint(self.names)
        return len(closure.bodies) < 2 or len(set(map(self._mover, closure.bodies))) > 1

    def _mover(self, link):
        """Return the number of the joint that moves a link, 0 for the base."""
        if link is None:
            return 0
        kind = import_pinocchio().FrameType.BODY
        return self.model.frames[self.model.getFrameId(link, kind)].parentJoint


def carriers_of(model):
    """Name of the joint that carries each joint, name -> name or None."""
    names = list(model.names)
    return {
        name: names[above] if above else None
        for name, above in zip(names[1:], list(model.parents)[1:])
    }


# -- a base that is free ---------------------------------------------------------------


def hold_base(robot, orientation):
    """Hold a base that alone carries all joints; return the robot, and what to say."""
    # orientation: a quaternion, None for that of the description.
    free, carriers = robot.free, robot.carriers
    on_world = [name for name, above in carriers.items() if above is None]
    # A body that carries nothing is no base.
    if len(free) != 1 or not on_world == free != [*carriers]:
        if orientation is not None:
            raise ValueError(
                f"{robot.called} has no free joint that alone carries all other "
                "joints; leave base_orientation out."
            )
        return robot, []
    turn = None if orientation is None else rotation_of(orientation)
    robot, axes = robot.with_base(free[0], turn)
    return robot, [_said_of(free[0], axes)]


def rotation_of(orientation):
    """Rotation (3, 3) of a quaternion w, x, y, z, of any length."""
    try:
        given = np.asarray(orientation, dtype=float)
    except (TypeError, ValueError):
        given = np.empty(0)
    length = np.linalg.norm(given) if given.shape == (4,) else 0.0
    if not 0 < length < np.inf:
        raise ValueError(
            "base_orientation must be a quaternion of four finite numbers w, x, y, z, "
            f"not all zero; got {orientation!r}."
        )
    w, x, y, z = given / length
    return import_pinocchio().Quaternion(w, x, y, z).toRotationMatrix()


def _said_of(name, rotation):
    """Say how the base is held; rotation : of the base in the world (3, 3)."""
    if np.linalg.norm(rotation[2, :2]) < _LEVEL and rotation[2, 2] > 0:
        how = "level"
    else:
        angles = np.rad2deg(import_pinocchio().rpy.matrixToRpy(rotation))
        # No minus in front of zero.
        listed = " ".join(f"{x:.4g}" for x in np.round(angles, 4) + 0.0)
        how = f"turned by rpy {listed} degrees"
    return (
        f"the base, which {name} leaves free, is held {how} (base_orientation or "
        "--base-orientation turns it, the effect base_tilt finds a few degrees more)"
    )


# -- joints that follow others ---------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Link:
    """How a joint follows another: position = multiplier * leader + offset."""

    leader: str  # name of the joint that moves it, which may follow another one
    multiplier: float
    offset: float  # [rad or m]


class ChainJoint(NamedTuple):
    """One joint between the base and the body of a follower."""

    joint: int  # joint of the folded robot that moves it, from zero
    # its position is rate times that of `joint` plus offset [rad or m]
    rate: float
    offset: float
    slides: bool  # whether it is prismatic
    place: tuple  # its origin in the frame of the joint before it [m]
    frame: tuple  # its axes there, by rows of the rotation matrix
    axis: tuple  # direction about or along which it moves, in its own frame


@dataclass(frozen=True, kw_only=True, eq=False)
class FollowingBody:
    """The body that a follower moves."""

    name: str
    leader: int  # joint of the folded robot that moves it, from zero
    chain: tuple  # joints from the base to the body
    gravity: tuple  # (3,) [m/s^2]
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
    text: str | None = None  # of the URDF that it was read from

    @classmethod
    def without(cls, model):
        """Return a robot that has no followers."""
        return cls(model=model, followers=(), still=model, full=model, links={})


def foldable(carriers, links, called):
    """Return the followers that carry nothing but followers, by name."""
    # Their leaders do not follow themselves. carriers: for each joint the one that
    # carries it, or None; called: how messages call the robot.
    for name, link in links.items():
        if link.leader not in carriers:
            raise ValueError(
                f"{called}: joint {name!r} mimics {link.leader!r}, which is not a "
                "moving joint of the robot; correct the description."
            )
        seen = [name]
        while seen[-1] in links:
            seen.append(links[seen[-1]].leader)
            if seen[-1] in seen[:-1]:
                raise ValueError(
                    f"{called}: mimic joints {', '.join(seen[:-1])} form a cycle; "
                    "correct the description."
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


def led_by(moving, carriers, links, called):
    """Names of the followers that joints which move lead, if they can be folded."""
    # carriers, links: as for `foldable`, of all joints, whose mistakes it refuses.
    foldable(carriers, links, called)
    follow = set(links)
    while True:
        # What is held is one body with the joint that carries it, and leads nothing.
        left = {*moving, *follow}
        kept = {name: links[name] for name in follow if links[name].leader in left}
        if len(kept) == len(follow):
            above = {name: _next(carriers, name, left) for name in left}
            kept = foldable(above, kept, called)
        if len(kept) == len(follow):
            return follow
        follow = set(kept)


def _next(carriers, name, joints):
    """Return the nearest joint of some that carries a joint; None for the base."""
    name = carriers[name]
    while name is not None and name not in joints:
        name = carriers[name]
    return name


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
    for name, link in links.items():
        rotor = link.multiplier**2 * full.armature[names.index(name) - 1]
        for one in (model, still):
            one.armature[left.index(link.leader)] += rotor
    steps, tree = {}, describe(full)
    for at, name in enumerate(names[1:], 1):
        link = links.get(name, Link(leader=name, multiplier=1.0, offset=0.0))
        placed = full.jointPlacements[at]
        steps[at] = ChainJoint(
            joint=left.index(link.leader),
            rate=link.multiplier,
            offset=link.offset,
            slides=not tree.turns[at - 1],
            place=tuple(placed.translation.tolist()),
            frame=tuple(placed.rotation.ravel().tolist()),
            axis=tuple(tree.axes[at - 1].tolist()),
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
                gravity=tuple(full.gravity.linear.tolist()),
                parameters=parameters,
            )
        )
    return Folded(
        model=model, followers=tuple(followers), still=still, full=full, links=links
    )
