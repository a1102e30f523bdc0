"""Trees of joints as Pinocchio models: their properties, and the joints that count.

A free base is fixed in one orientation: recorded joints do not determine its position,
and its orientation only by gravity. A joint that follows another (mimic) is folded if
all joints that it carries follow as well: the remaining robot is a tree of joints with
encoders and motors, whose torques include the followers' bodies.
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
# below which the body has no extension in some direction.
_SOLID = 1e-6
# Largest plausible distance between joints [m].
_LONGEST = 50.0
# Position limits beyond this mean none; range of a prismatic joint without limit [m].
_NO_LIMIT, _SLIDE = 1e6, 1.0
# Radius of the ball of least extension, over the largest distance between joints.
_BALL = 0.1
# Sine of the tilt below which a base is described as level.
_LEVEL = 1e-6


def import_pinocchio():
    """Import pinocchio, or raise an error with the command that installs it."""
    try:
        import pinocchio
    except ImportError as error:
        # PyPI has no wheels for Windows.
        command = 'pip install "pin>=3.3.1"'
        if sys.platform == "win32":
            command = "conda install -c conda-forge pinocchio"
        raise ImportError(
            f"Robot models need Pinocchio, which is not installed: {command}"
        ) from error
    return pinocchio


# -- properties of trees ---------------------------------------------------------------


def joint_names(model):
    """Names of the moving joints, in Pinocchio's order."""
    return tuple(model.names)[1:]


def end_joints(model):
    """Joints at the end of a branch, list of int."""
    return np.setdiff1d(np.arange(model.nv), np.subtract(model.parents, 1)).tolist()


def body_names(model):
    """Names of the bodies that the joints move, in Pinocchio's order."""
    # Of links that are fixed to each other, the link next to the joint; the joint's
    # name if there is no link with a name.
    kind = import_pinocchio().FrameType.BODY
    links = {}
    for frame in model.frames:
        if frame.type == kind:
            links.setdefault(frame.parentJoint, frame.name)
    return tuple(links.get(j, name) for j, name in enumerate(model.names))[1:]


def is_prismatic(model):
    """Return which joints are prismatic, ndarray of shape (nv,) of bool."""
    return np.array(
        [joint.shortname().startswith("JointModelP") for joint in model.joints[1:]]
    )


def position_range(model):
    """Return lowest and highest positions; without limits, a range of a turn or 2 m."""
    reach = np.where(is_prismatic(model), _SLIDE, np.pi)
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    # Descriptions without limits are read as zeros.
    low, high = np.where(low == high, [[-np.inf], [np.inf]], [low, high])
    low = np.where(np.abs(low) < _NO_LIMIT, low, -reach)
    return low, np.where(np.abs(high) < _NO_LIMIT, high, reach)


def joint_origin(model, joint):
    """Axes (3, 3) of a joint's origin in its parent link, as in a URDF."""
    # The placement is in the axes of the parent body, which may consist of several
    # links that are fixed to each other; the parent link has one of its frames. Without
    # such a frame, the axes of the body are used.
    pin = import_pinocchio()
    rotation = model.jointPlacements[joint + 1].rotation
    name = model.names[joint + 1]
    if not model.existFrame(name, pin.FrameType.JOINT):
        return rotation.copy()
    frame = model.frames[model.getFrameId(name, pin.FrameType.JOINT)]
    link = model.frames[frame.parentFrame]
    is_parent = link.parentJoint == model.parents[joint + 1]
    if link.type != pin.FrameType.BODY or not is_parent:
        return rotation.copy()
    return link.placement.rotation.T @ rotation


def nominal_parameters(model):
    """Inertial parameters (nv, 10) of a model, about the joint frames."""
    # Pinocchio: m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz [kg, kg m, kg m^2].
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
    """Give bodies without extension at least that of a small ball."""
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
        inertia = pin.Inertia.FromDynamicParameters(inertial_parameters(P))
        model.inertias[k + 1] = inertia
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
    """Geometry of the joints as arrays."""

    parents: np.ndarray  # (nv,): number of the parent, -1 for none
    # (nv, 3): origin of a joint in its parent's frame [m]; zero without parent
    offsets: np.ndarray
    frames: np.ndarray  # (nv, 3, 3): axes of a joint, by rows, in its parent's frame
    # (nv, 3): direction about or along which the joint moves, in its own frame
    axes: np.ndarray
    # (nv,): rotation and translation per unit of position; helical joints have both
    turns: np.ndarray
    slides: np.ndarray
    # (nv, 3): acceleration that replaces gravity, of joints without parent [m/s^2]
    base: np.ndarray
    base_angular: np.ndarray  # (3,): its angular part [rad/s^2]
    # (nv, 3): coordinate that moves a joint, and rate and offset of its position
    leads: np.ndarray

    def changed(self, **values):
        """Return the tree with some other values."""
        return self._replace(**values)


def describe(model):
    """Return the `Tree` of a model, from the motions that Pinocchio computes."""
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
        # The motion of a joint in its own frame does not depend on its position.
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
            # Moments are about the first joint: about the world's origin, those of a
            # robot far away would lose digits. The base accelerates against gravity.
            lever = np.cross(tree.base_angular, placement.translation)
            tree.base[i] = lever - model.gravity.linear
    return tree


def concatenate_trees(trees):
    """Return several trees as one, under the gravity of the first one."""
    sizes = [tree.parents.size for tree in trees]
    shift = np.repeat(np.cumsum(sizes) - sizes, sizes)
    whole = Tree(*map(np.concatenate, zip(*trees)))
    return whole.changed(
        parents=np.where(whole.parents < 0, -1, whole.parents + shift),
        base_angular=trees[0].base_angular,
    )


def check_kinds(model, tree):
    """Refuse helical joints, which URDF and MJCF do not have."""
    both = (tree.turns != 0) & (tree.slides != 0)
    wrong = [name for name, helical in zip(joint_names(model), both) if helical]
    if wrong:
        raise ValueError(
            f"URDF and MJCF have no helical joint, which {', '.join(wrong)} would be: "
            "only revolute and prismatic joints can be written."
        )


def in_order(model, names):
    """Return a model with reordered joints, parents before children."""
    # Readers of URDF sort the branches of a tree.
    current = joint_names(model)
    if tuple(names) == current:
        return model
    if sorted(names) != sorted(current):
        raise ValueError(
            f"the joints {', '.join(names)} are not those of the robot description, "
            f"{', '.join(current)}"
        )
    ordered = with_joints(model, names)
    indices = [0, *map(ordered.getJointId, current)]
    frames = {0: 0}
    # Frames of a joint come after those of its parent joint.
    order = sorted(
        range(1, len(model.frames)), key=lambda k: indices[model.frames[k].parentJoint]
    )
    for old in order:
        frame = model.frames[old]
        copy = frame.copy()
        copy.parentJoint = indices[frame.parentJoint]
        copy.parentFrame = frames[frame.parentFrame]
        # The inertias of the joints include those of the frames.
        frames[old] = ordered.addFrame(copy, False)
    return ordered


def with_joints(model, names):
    """Return a model of some joints, parents before children, without frames."""
    part = import_pinocchio().Model()
    part.name, part.gravity = model.name, model.gravity
    part.inertias[0] = model.inertias[0]
    indices = {0: 0}
    for name in names:
        old = model.getJointId(name)
        if model.parents[old] not in indices:
            raise ValueError(f"joint {name} comes before the one that carries it")
        joint = model.joints[old]
        q = slice(joint.idx_q, joint.idx_q + joint.nq)
        v = slice(joint.idx_v, joint.idx_v + joint.nv)
        indices[old] = part.addJoint(
            indices[model.parents[old]],
            joint,
            model.jointPlacements[old],
            name,
            model.effortLimit[v],
            model.velocityLimit[v],
            model.lowerPositionLimit[q],
            model.upperPositionLimit[q],
        )
        part.inertias[indices[old]] = model.inertias[old]
        first = part.joints[indices[old]].idx_v
        part.armature[first : first + joint.nv] = model.armature[v]
    return part


def check_joints(model):
    """Refuse a model without joints, or with joints of several degrees of freedom."""
    if model.nv == 0:
        raise ValueError(
            "The robot model has no moving joint; expected a tree of revolute or "
            "prismatic joints. Check the joint types in the description."
        )
    wrong = [
        f"{model.names[i]} ({joint.shortname()}, nq={joint.nq}, nv={joint.nv})"
        for i, joint in enumerate(model.joints)
        if i > 0 and (joint.nq, joint.nv) != (1, 1)
    ]
    if wrong:
        raise ValueError(
            "Every joint must have one degree of freedom (nq == nv); got "
            + ", ".join(wrong)
            + ". Of continuous joints (RUB), give the URDF file in place of the model. "
            "A free joint is held only if there is no other one and it carries all "
            "other joints. Split spherical joints into three revolute ones, and lock "
            "what does not move with pinocchio.buildReducedModel (command line: "
            "--joints)."
        )
    lengths = [np.linalg.norm(place.translation) for place in model.jointPlacements]
    far = int(np.argmax(lengths))
    if lengths[far] > _LONGEST:
        raise ValueError(
            f"Joint {model.names[far]} is {lengths[far]:.3g} m from the joint before "
            "it: lengths of a description are in metres, and these look like "
            "millimetres; divide them by 1000."
        )
    for name, body in zip(model.names[1:], model.inertias[1:]):
        if np.trace(body.inertia) > 2 * body.mass * _LONGEST**2 > 0:
            raise ValueError(
                f"The inertia of the body of joint {name} is that of {body.mass:.3g} "
                f"kg more than {_LONGEST:g} m away: inertias of a description are in "
                "kg m^2, and these look like kg mm^2; divide them by 1e6."
            )
    return model


# -- descriptions ----------------------------------------------------------------------


class Closure(NamedTuple):
    """A constraint of a description, which a tree of joints cannot hold."""

    message: str
    bodies: tuple = ()  # constrained links, None for the world
    joints: tuple = ()  # constrained joints, if no links are


@dataclass(frozen=True, kw_only=True, eq=False)
class Description:
    """Contents of a robot description, with all joints in one model."""

    model: object
    label: str  # name of the robot in messages
    listed: tuple = ()  # names of the joints in the order of the file
    mimics: dict = field(default_factory=dict)  # name -> `Mimic`
    closures: tuple = ()
    left_out: tuple = ()  # messages about contents that are not modelled

    @property
    def names(self):
        """Names of the joints, a tuple."""
        return joint_names(self.model)

    @property
    def in_file_order(self):
        """Names of the joints in the order of the file, a tuple."""
        # A joint may be listed before its parent.
        return tuple(name for name in self.listed or self.names if name in self.names)

    @property
    def free(self):
        """Names of the free joints."""
        pairs = zip(self.model.names, self.model.joints)
        return [x for x, joint in pairs if joint.shortname() == "JointModelFreeFlyer"]

    def with_fixed_base(self, name, axes=None):
        """Fix the free joint at the root; return the robot and the axes of its base."""
        # axes (3, 3): of the base in the world; None for those of the description.
        pin, model = import_pinocchio(), self.model
        joint = model.getJointId(name)
        nominal = model.jointPlacements[joint].rotation
        axes = nominal if axes is None else axes
        q = pin.neutral(model)
        first = model.joints[joint].idx_q + 3
        q[first : first + 4] = pin.Quaternion(nominal.T @ axes).coeffs()
        return replace(self, model=pin.buildReducedModel(model, [joint], q)), axes

    def with_moving(self, moving):
        """Return the robot with all joints except the named ones fixed at zero."""
        # A named follower counts as a separate joint.
        unknown = [name for name in moving if name not in self.names]
        if unknown:
            raise ValueError(
                f"{self.label}: the robot has no movable joint {unknown[0]!r}; it has "
                f"{', '.join(self.names) or 'none'}."
            )
        mimics = {k: mimic for k, mimic in self.mimics.items() if k not in moving}
        carriers = carriers_of(self.model)
        followers = movable_followers(moving, carriers, mimics, self.label)
        for name, mimic in mimics.items():
            if name not in followers and mimic.leader in moving:
                raise ValueError(
                    f"{self.label}: {name} follows {mimic.leader}, which moves, and "
                    "carries joints that do not follow: it can neither be held nor "
                    "folded. Give it columns and a torque (name it as well), or hold "
                    f"{mimic.leader} too."
                )
        pin, model = import_pinocchio(), self.model
        kept = {*moving, *followers}
        fixed = [k for k, name in enumerate(self.names, 1) if name not in kept]
        if fixed:
            model = pin.buildReducedModel(model, fixed, pin.neutral(model))
        mimics = {name: mimic for name, mimic in mimics.items() if name in followers}
        return replace(self, model=model, mimics=mimics)

    def check(self):
        """Refuse closed loops, and joints with several degrees of freedom."""
        wrong = [x.message for x in self.closures if self._constrains(x)]
        if wrong:
            raise ValueError(
                f"{self.label}: {'; '.join(wrong)}. Take out what closes the loop, or "
                "hold what is not recorded at zero: name the joints that are (--joints "
                "in the command line, joint_names in Python)."
            )
        check_joints(self.model)

    def _constrains(self, closure):
        """Whether a closure constrains joints, unlike one between links of one body."""
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
    """Name of the parent joint of each joint, name -> name or None."""
    names = list(model.names)
    return {
        name: names[above] if above else None
        for name, above in zip(names[1:], list(model.parents)[1:])
    }


# -- free base -------------------------------------------------------------------------


def hold_base(robot, orientation):
    """Fix a free base that carries all joints; return the robot and messages."""
    # orientation: a quaternion, None for that of the description.
    free, carriers = robot.free, carriers_of(robot.model)
    on_world = [name for name, above in carriers.items() if above is None]
    # A free body that carries no joints is not a base.
    if len(free) != 1 or not on_world == free != [*carriers]:
        if orientation is not None:
            raise ValueError(
                f"{robot.label} has no free joint that alone carries all other "
                "joints; leave base_orientation out."
            )
        return robot, []
    rotation = None if orientation is None else rotation_of(orientation)
    robot, axes = robot.with_fixed_base(free[0], rotation)
    if np.linalg.norm(axes[2, :2]) < _LEVEL and axes[2, 2] > 0:
        pose = "level"
    else:
        angles = np.rad2deg(import_pinocchio().rpy.matrixToRpy(axes))
        # Adding 0.0 turns -0.0 into 0.0.
        degrees = " ".join(f"{x:.4g}" for x in np.round(angles, 4) + 0.0)
        pose = f"turned by rpy {degrees} degrees"
    return robot, [
        f"the base, which {free[0]} leaves free, is held {pose} (base_orientation or "
        "--base-orientation turns it, the effect base_tilt finds a few degrees more)"
    ]


def rotation_of(orientation):
    """Rotation (3, 3) of a quaternion w, x, y, z, of any length."""
    try:
        quaternion = np.asarray(orientation, dtype=float)
    except (TypeError, ValueError):
        quaternion = np.empty(0)
    length = np.linalg.norm(quaternion) if quaternion.shape == (4,) else 0.0
    if not 0 < length < np.inf:
        raise ValueError(
            "base_orientation must be a quaternion of four finite numbers w, x, y, z, "
            f"not all zero; got {orientation!r}."
        )
    w, x, y, z = quaternion / length
    return import_pinocchio().Quaternion(w, x, y, z).toRotationMatrix()


# -- followers: joints that follow others (mimic) --------------------------------------


@dataclass(frozen=True, kw_only=True)
class Mimic:
    """How a joint follows another: position = multiplier * leader + offset."""

    leader: str  # name of the followed joint, which may follow another one
    multiplier: float = 1.0
    offset: float = 0.0  # [rad or m]


class ChainJoint(NamedTuple):
    """A joint between the base and the body of a follower."""

    joint: int  # joint of the folded robot that moves it, from zero
    # its position is rate times that of `joint` plus offset [rad or m]
    rate: float
    offset: float
    slides: bool  # whether it is prismatic
    place: tuple  # its origin in the frame of its parent joint [m]
    frame: tuple  # its axes in that frame, by rows of the rotation matrix
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

    model: object  # remaining joints and their bodies
    followers: tuple  # `FollowingBody` of each follower
    # `model` with the followers' bodies fixed, leaders at zero, so no mass is missing
    still: object
    full: object  # model in which followers are separate joints
    mimics: dict
    text: str | None = None  # of the URDF that it was read from

    @property
    def motion(self):
        """Rates (n, nv) and offsets (n,) of the positions of all joints of `full`."""
        mimics = [self.mimics.get(x, Mimic(leader=x)) for x in joint_names(self.full)]
        leads = np.array([[x.leader] for x in mimics]) == joint_names(self.model)
        offsets = np.array([x.offset for x in mimics])
        return leads * np.array([[x.multiplier] for x in mimics]), offsets


def foldable(carriers, mimics, label):
    """Return the followers that carry only followers, name -> `Mimic`."""
    # The returned leaders are not followers. carriers: parent joint of each joint, or
    # None; label: name of the robot in messages.
    for name, mimic in mimics.items():
        if mimic.leader not in carriers:
            raise ValueError(
                f"{label}: joint {name!r} mimics {mimic.leader!r}, which is not a "
                "moving joint of the robot; correct the description."
            )
        chain = [name]
        while chain[-1] in mimics:
            chain.append(mimics[chain[-1]].leader)
            if chain[-1] in chain[:-1]:
                raise ValueError(
                    f"{label}: mimic joints {', '.join(chain[:-1])} form a cycle; "
                    "correct the description."
                )
    kept = dict(mimics)
    while True:
        carrying = {
            carrier
            for joint, carrier in carriers.items()
            if joint not in kept and carrier in kept
        }
        if not carrying:
            return {name: _resolve(name, kept) for name in kept}
        kept = {name: mimic for name, mimic in kept.items() if name not in carrying}


def _resolve(name, mimics):
    """Return how a follower follows a joint that is not a follower."""
    leader, rate, offset = name, 1.0, 0.0
    while leader in mimics:
        mimic = mimics[leader]
        offset, rate = offset + rate * mimic.offset, rate * mimic.multiplier
        leader = mimic.leader
    return Mimic(leader=leader, multiplier=rate, offset=offset)


def movable_followers(moving, carriers, mimics, label):
    """Return the names of foldable followers whose leaders move."""
    # carriers, mimics: of all joints, validated by `foldable`.
    foldable(carriers, mimics, label)
    followers = set(mimics)
    while True:
        # A fixed joint is one body with its parent and has no followers.
        joints = {*moving, *followers}
        kept = {k: mimics[k] for k in followers if mimics[k].leader in joints}
        if len(kept) == len(followers):
            parents = {name: _carrier(carriers, name, joints) for name in joints}
            kept = foldable(parents, kept, label)
        if len(kept) == len(followers):
            return followers
        followers = set(kept)


def _carrier(carriers, name, joints):
    """Return the nearest of some joints that carries a joint; None for the base."""
    name = carriers[name]
    while name is not None and name not in joints:
        name = carriers[name]
    return name


def fold(full, mimics):
    """Remove `foldable` followers from the joints of a robot."""
    if not mimics:
        return Folded(model=full, followers=(), still=full, full=full, mimics={})
    pin, numbers = import_pinocchio(), {name: i for i, name in enumerate(full.names)}
    mimics = {name: mimics[name] for name in full.names if name in mimics}
    massless, positions = full.copy(), np.zeros(full.nq)
    for name, mimic in mimics.items():
        massless.inertias[numbers[name]] = pin.Inertia.Zero()
        positions[full.joints[numbers[name]].idx_q] = mimic.offset
    locked = [numbers[name] for name in mimics]
    model, still = (
        pin.buildReducedModel(x, locked, positions) for x in (massless, full)
    )
    model.name = still.name = full.name
    remaining, steps, tree = joint_names(model), [None], describe(full)
    for name, mimic in mimics.items():
        rotor = mimic.multiplier**2 * full.armature[numbers[name] - 1]
        for x in (model, still):
            x.armature[remaining.index(mimic.leader)] += rotor
    for i, name in enumerate(joint_names(full)):
        mimic = mimics.get(name, Mimic(leader=name))
        placement = full.jointPlacements[i + 1]
        step = ChainJoint(
            joint=remaining.index(mimic.leader),
            rate=mimic.multiplier,
            offset=mimic.offset,
            slides=not tree.turns[i],
            place=tuple(placement.translation.tolist()),
            frame=tuple(placement.rotation.ravel().tolist()),
            axis=tuple(tree.axes[i].tolist()),
        )
        steps.append(step)
    followers = tuple(
        FollowingBody(
            name=name,
            leader=remaining.index(mimic.leader),
            chain=tuple(steps[k] for k in full.supports[numbers[name]].tolist()[1:]),
            gravity=tuple(full.gravity.linear.tolist()),
            parameters=full.inertias[numbers[name]].toDynamicParameters(),
        )
        for name, mimic in mimics.items()
    )
    return Folded(
        model=model, followers=followers, still=still, full=full, mimics=mimics
    )
