"""The body of a joint that follows another, as an effect of the joint that leads."""

from typing import NamedTuple

import numpy as np

from sklearn_vbjfa.effects import Effect, InFiles
from sklearn_vbjfa.model._dynamics import last_body_columns
from sklearn_vbjfa.model._trees import Tree
from sklearn_vbjfa.physical import INERTIAL_NAMES

_MASS, _MOMENT = ("kg", "kg"), ("kg m", "kg m")
_INERTIA = ("kg m^2", "kg m^2")


class ChainJoint(NamedTuple):
    """One joint between the base and a body."""

    joint: int  # joint of the robot that moves it, from zero: itself or its leader
    # its position is rate times that of `joint` plus offset [rad or m]
    rate: float
    offset: float
    slides: bool  # whether it is prismatic
    place: tuple  # its origin in the frame of the joint before it [m]
    frame: tuple  # its axes there, by rows of the rotation matrix
    axis: tuple  # direction about or along which it moves, in its own frame


class Follower(Effect):
    """The body of a joint that follows another joint (mimic).

    It is declared automatically for descriptions with such joints, see
    `RobotIdentifier`; it is not searched for.

    Parameters
    ----------
    joint : int, default=0
        Joint that leads, from zero; all joints that carry the body feel it.
    of : str, default=""
        Name of the joint that follows.
    chain : tuple of tuple, default=()
        Joints from the base to the body, each as a `ChainJoint`.
    gravity : tuple of three floats, default=(0.0, 0.0, -9.81)
        Gravity in the axes of the base [m/s^2].

    Notes
    -----
    The chain is that of the description: effects that correct the geometry of the
    robot do not move it.
    """

    name = "follower"
    label = "body of a joint that follows another joint"
    formula = r"A^{\mathsf T}\Phi_f(Aq + b, A\dot q, A\ddot q)\,\pi_f"
    coefficients = INERTIAL_NAMES
    units = (_MASS,) + (_MOMENT,) * 3 + (_INERTIA,) * 6
    visible = "the joint that leads moves"
    whole_robot = True
    files = InFiles(urdf="", mjcf="")

    def __init__(self, joint=0, of="", chain=(), gravity=(0.0, 0.0, -9.81)):
        super().__init__(joint)
        self.of = of
        self.chain = chain
        self.gravity = gravity

    def prefix(self, joint_name):
        return self.of

    def columns(self, motion):
        links = [ChainJoint(*row) for row in self.chain]
        joints, count = [link.joint for link in links], len(links)
        rate, offset = np.array([(link.rate, link.offset) for link in links]).T
        slides = np.array([link.slides for link in links], dtype=float)
        offsets = np.array([link.place for link in links])
        offsets[0] = 0.0
        base = np.zeros((count, 3))
        base[0] = -np.asarray(self.gravity)
        tree = Tree(
            parents=np.arange(count) - 1,
            offsets=offsets,
            frames=np.array([np.reshape(link.frame, (3, 3)).T for link in links]),
            axes=np.array([link.axis for link in links]),
            turns=1.0 - slides,
            slides=slides,
            base=base,
            base_angular=np.zeros(3),
        )
        states = [rate * x[:, joints] for x in (motion.q, motion.v, motion.a)]
        states[0] += offset
        out = np.zeros((motion.q.shape[0], motion.n_joints, len(INERTIAL_NAMES)))
        for joint, factor, own in zip(joints, rate, last_body_columns(tree, *states)):
            out[:, joint] += factor * own
        return out

    def shapes(self, motion):
        """Nothing is searched: the description defines the joints that follow."""
        return []
