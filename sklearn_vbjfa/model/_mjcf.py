"""Writing an identified robot as MJCF, the description of MuJoCo.

The tree is written from the Pinocchio model, with the frames of its joints, and needs
no URDF, shapes or meshes. Torques that MuJoCo's passive joints cannot represent, a
constant and a spring without stable equilibrium, are the bias of the joint's motor.
"""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.model._trees import (
    ChainJoint,
    body_names,
    check_kinds,
    describe,
    import_pinocchio,
    is_prismatic,
    joint_names,
)
from sklearn_vbjfa.model._urdf import (
    add_comment,
    body_about_com,
    number,
    numbers,
    write_tree,
)

# Longest time step [s]. MuJoCo's dry friction is a soft constraint that brings a joint
# to rest within one step (see `_FRICTION`): with shorter steps it is complete at lower
# speeds, abs(a) step instead of abs(a) dt.
_LONGEST_STEP = 5e-4
# Constraint impedance of dry friction, the hardest that MuJoCo accepts: the constraint
# yields by 1e-4 of the inertia.
_FRICTION = "0.9999 0.9999 0.001 0.5 2"
# Position limits beyond this mean none [rad or m].
UNLIMITED = 1e6


@dataclass(frozen=True, eq=False)
class FollowingJoint:
    """A joint without motor that follows another joint, and its body."""

    name: str
    # parent joint, which may be a follower as well; None for the base
    carrier: str | None
    link: ChainJoint  # placement in its parent, and joint that it follows
    body: np.ndarray  # (10,): inertial parameters


@dataclass(frozen=True, kw_only=True, eq=False)
class JointDynamics:
    """Joint torques of an MJCF file that are not due to bodies."""

    # (nv,): nonnegative
    damping: np.ndarray
    frictionloss: np.ndarray
    armature: np.ndarray
    stiffness: np.ndarray
    springref: np.ndarray  # (nv,): equilibrium positions of the springs
    ref: np.ndarray  # (nv,): encoder readings at the zeros of the model
    # (nv,): additional torques constant + slope q of a motor
    constant: np.ndarray
    slope: np.ndarray
    # (nv,): reading of the torque channel, the motor's control, over the true torque
    gain: np.ndarray
    # springs k (q[first] - ratio q[second]) + c: tuples (first, second, ratio, k, c)
    tendons: tuple = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Servo:
    """Position servos instead of torque motors."""

    # (nv,): gains (kp = 0 for torque motors), and torque limits, infinite for none
    kp: np.ndarray
    kd: np.ndarray
    torque_limits: np.ndarray
    delay: float = 0.0  # from a command to its effect [s]; 0 is written if negative


def write_mjcf(
    path, model, bodies, dynamics, *, dt=None, note="", followers=(), servo=None
):
    """Write a robot as MJCF."""
    # Refuses bodies without positive mass, and helical joints. model: with the zeros of
    # joints, without the encoder offsets `dynamics.ref`; bodies (nv, 10); dt: sample
    # period [s], multiple of the time step; note: comment at the top; followers:
    # parents before children; servo: `Servo`, or None for torque motors.
    tree = _Tree(model, bodies, dynamics, followers)
    # The longest step that divides dt, robust to rounding: 0.01 / 5e-4 must give 20.
    dt = _LONGEST_STEP if dt is None else dt
    step = dt / np.ceil(dt / _LONGEST_STEP * (1 - 1e-9))
    root = ElementTree.Element("mujoco", model="robot")
    add_comment(root, note)
    ElementTree.SubElement(
        root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false"
    )
    ElementTree.SubElement(
        root,
        "option",
        timestep=number(step),
        gravity=numbers(model.gravity.linear),
        integrator="implicitfast",
    )
    dry = {"solreffriction": f"{number(2 * step)} 1", "solimpfriction": _FRICTION}
    default = ElementTree.SubElement(root, "default")
    ElementTree.SubElement(default, "joint", dry)
    tree.add_bodies(ElementTree.SubElement(root, "worldbody"))
    if followers:
        tree.add_equalities(ElementTree.SubElement(root, "equality"))
    if dynamics.tendons:
        tree.add_tendons(ElementTree.SubElement(root, "tendon"))
    tree.add_motors(ElementTree.SubElement(root, "actuator"), servo, step)
    write_tree(ElementTree.ElementTree(root), path)


def _quaternion(rotation):
    """Return a rotation matrix (3, 3) as the text of a quaternion w, x, y, z."""
    q = import_pinocchio().Quaternion(rotation)
    return numbers([q.w, q.x, q.y, q.z])


def _body(carrier, name, placement, phi):
    """Add a body with its inertia; return its element."""
    body = ElementTree.SubElement(
        carrier,
        "body",
        name=name,
        pos=numbers(placement.translation),
        quat=_quaternion(placement.rotation),
    )
    mass, com, inertia = body_about_com(phi)
    # MuJoCo diagonalises full matrices, to six digits only until version 3.3.
    principal, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.linalg.det(axes)
    ElementTree.SubElement(
        body,
        "inertial",
        pos=numbers(com),
        quat=_quaternion(axes),
        mass=number(mass),
        diaginertia=numbers(principal),
    )
    return body


class _Tree:
    """Elements of the bodies and motors of a robot."""

    def __init__(self, model, bodies, dynamics, followers):
        self._model, self._bodies, self._dynamics = model, bodies, dynamics
        self._followers = followers
        self._names = joint_names(model)
        self._slides = is_prismatic(model)
        self._tree = describe(model)
        check_kinds(model, self._tree)
        bodies_named = body_names(model)
        # Names of bodies must differ.
        self._body_names = [
            body
            if body and bodies_named.count(body) == 1 and body != "world"
            else joint
            for body, joint in zip(bodies_named, self._names)
        ]

    def add_bodies(self, world):
        """Add the bodies, each inside its parent body."""
        elements = {-1: world}
        # Parents come first in Pinocchio's order.
        for j, parent in enumerate(self._tree.parents):
            elements[j] = self._add_body(elements[int(parent)], j)
        by_name = {name: elements[j] for j, name in enumerate(self._names)}
        for joint in self._followers:
            carrier = world if joint.carrier is None else by_name[joint.carrier]
            R, p = np.reshape(joint.link.frame, (3, 3)), np.array(joint.link.place)
            placement = import_pinocchio().SE3(R, p)
            body = _body(carrier, f"{joint.name} body", placement, joint.body)
            by_name[joint.name] = body
            ElementTree.SubElement(
                body,
                "joint",
                name=joint.name,
                type="slide" if joint.link.slides else "hinge",
                axis=numbers(joint.link.axis),
            )

    def add_equalities(self, parent):
        for follower in self._followers:
            # In MuJoCo both positions are relative to those in the file.
            link, leader = follower.link, self._names[follower.link.joint]
            shift = link.offset + link.rate * self._dynamics.ref[link.joint]
            ElementTree.SubElement(
                parent,
                "joint",
                name=f"{follower.name} follows {leader}",
                joint1=follower.name,
                joint2=leader,
                polycoef=numbers([shift, link.rate, 0.0, 0.0, 0.0]),
            )

    def add_tendons(self, parent):
        for first, second, ratio, k, c in self._dynamics.tendons:
            spring = {"stiffness": number(k), "springlength": number(-c / k)}
            fixed = ElementTree.SubElement(parent, "fixed", spring)
            for j, coef in ((first, 1.0), (second, -ratio)):
                end = {"joint": self._names[j], "coef": number(coef)}
                ElementTree.SubElement(fixed, "joint", end)

    def _add_body(self, carrier, j):
        dynamics, placement = self._dynamics, self._model.jointPlacements[j + 1]
        body = _body(carrier, self._body_names[j], placement, self._bodies[j])
        joint = ElementTree.SubElement(
            body,
            "joint",
            name=self._names[j],
            type="slide" if self._slides[j] else "hinge",
            axis=numbers(self._tree.axes[j]),
        )
        low = self._model.lowerPositionLimit[j] + dynamics.ref[j]
        high = self._model.upperPositionLimit[j] + dynamics.ref[j]
        if low < high and max(-low, high) < UNLIMITED:
            joint.set("range", numbers([low, high]))
        for key in ("armature", "damping", "frictionloss", "ref", "stiffness"):
            value = getattr(dynamics, key)[j]
            if value != 0:
                joint.set(key, number(value))
        if dynamics.stiffness[j] != 0 and dynamics.springref[j] != 0:
            joint.set("springref", number(dynamics.springref[j]))
        return body

    def add_motors(self, parent, servo, step):
        """Add a motor for each joint, in Pinocchio's order, named like the joint."""
        dynamics = self._dynamics
        for j, name in enumerate(self._names):
            motor = ElementTree.SubElement(parent, "general", name=name, joint=name)
            constant, stiffness = -dynamics.constant[j], -dynamics.slope[j]
            damping = 0.0
            if servo is None:
                motor.set("gainprm", number(1.0 / dynamics.gain[j]))
            else:
                motor.set("gainprm", number(servo.kp[j] or 1.0))
                if servo.delay > 0:
                    # Commands are interpolated linearly between steps.
                    size = int(np.ceil(servo.delay / step)) + 2
                    motor.attrib |= {"delay": number(servo.delay), "nsample": str(size)}
                    motor.set("interp", "linear")
                stiffness, damping = stiffness - servo.kp[j], -servo.kd[j]
                if np.isfinite(servo.torque_limits[j]):
                    # The limit applies to the control loop without the constant.
                    limits = constant + servo.torque_limits[j] * np.array([-1.0, 1.0])
                    motor.set("forcerange", numbers(limits))
            bias = constant, stiffness, damping
            if any(bias):
                motor.set("biastype", "affine")
                motor.set("biasprm", numbers(bias))
