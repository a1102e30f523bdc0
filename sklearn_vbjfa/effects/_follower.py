"""A body that a joint moves without an encoder and a motor of its own.

The other finger of a gripper, the rods of a parallelogram: its joint follows another,
q_f = m q + o, so that a recording needs no columns of it. By the principle of virtual
work its body is felt by the joints that move it, tau = A' Phi_f(A q + b, A v, A a) pi,
where row c of A has the rate m of the c-th joint between the base and the body.
"""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.effects._base import Effect, InFiles

_MASS, _MOMENT = ("kg", "kg"), ("kg m", "kg m")
_INERTIA = ("kg m^2", "kg m^2")


@dataclass(frozen=True, kw_only=True)
class ChainJoint:
    """One joint between the base and a body."""

    joint: int  # joint of the robot that moves it, from zero: itself or its leader
    # its position is rate times that of `joint` plus offset [rad or m]
    rate: float
    offset: float
    slides: bool  # whether it is prismatic
    place: tuple  # its origin in the frame of the joint before it [m]
    frame: tuple  # its axes there, by rows of the rotation matrix
    axis: tuple  # direction about or along which it moves, in its own frame

    def flat(self):
        """Return all in one row, (18,) of float, as a file holds it."""
        return (
            float(self.joint),
            float(self.rate),
            float(self.offset),
            float(self.slides),
            *map(float, (*self.place, *self.frame, *self.axis)),
        )

    @classmethod
    def of_flat(cls, row):
        """Read what `flat` returned."""
        return cls(
            joint=int(row[0]),
            rate=row[1],
            offset=row[2],
            slides=bool(row[3]),
            place=tuple(row[4:7]),
            frame=tuple(row[7:16]),
            axis=tuple(row[16:19]),
        )


class Follower(Effect):
    """The body of a joint that follows another one.

    A robot description that has such joints declares it by itself, see
    `RobotIdentifier`; it is not searched for.

    Parameters
    ----------
    joint : int, default=0
        Joint that leads, from zero; all joints that carry the body feel it.
    of : str, default=""
        Name of the joint that follows.
    chain : tuple of tuple of float, default=()
        Joints from the base to the body, rows of `ChainJoint.flat`.
    gravity : tuple of three floats, default=(0.0, 0.0, -9.81)
        Gravity in the axes of the base [m/s^2].

    Notes
    -----
    The chain is that of the description: effects that correct the geometry of the
    robot do not move it.
    """

    name = "follower"
    label = "body of a joint that follows another one"
    formula = r"A^{\mathsf T}\Phi_f(Aq + b, A\dot q, A\ddot q)\,\pi_f"
    coefficients = (
        "m",
        "mc_x",
        "mc_y",
        "mc_z",
        "I_xx",
        "I_xy",
        "I_yy",
        "I_xz",
        "I_yz",
        "I_zz",
    )
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
        n = motion.q.shape[0]
        links = [ChainJoint.of_flat(row) for row in self.chain]
        frame, place = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
        w, dw = np.zeros((2, n, 3))
        field = np.broadcast_to(-np.asarray(self.gravity, dtype=float), (n, 3))
        screws = []
        for link in links:
            arm = frame @ np.asarray(link.place)
            field = field + _cross(dw, arm) + _cross(w, _cross(w, arm))
            place = place + arm
            frame = frame @ np.reshape(link.frame, (3, 3))
            axis = frame @ np.asarray(link.axis)
            q, v, a = (
                link.rate * x[:, link.joint] for x in (motion.q, motion.v, motion.a)
            )
            q, v, a = (x[:, None] for x in (q + link.offset, v, a))
            if link.slides:
                shift = q * axis
                field = field + _cross(dw, shift) + _cross(w, _cross(w, shift))
                field = field + 2 * _cross(w, v * axis) + a * axis
                place = place + shift
            else:
                frame = frame @ _turns(np.asarray(link.axis), q[:, 0])
                dw = dw + a * axis + _cross(w, v * axis)
                w = w + v * axis
            screws.append((link, axis, place))
        force, moment = _wrench(frame, w, dw, field)
        out = np.zeros((n, motion.n_joints, 10))
        for link, axis, origin in screws:
            torque = force
            if not link.slides:
                lever = place - origin
                torque = moment + _skew(lever) @ force
            out[:, link.joint] += link.rate * np.einsum("ni,nik->nk", axis, torque)
        return out

    def shapes(self, motion):
        """Nothing is searched: the description says which joints follow."""
        return []


def _turns(axis, angle):
    """Rotation matrices (n, 3, 3) about an axis (3,) by angles (n,)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)


def _cross(x, y):
    """Cross products of vectors (n, 3); for single rows quicker than NumPy's."""
    x0, x1, x2 = x.T
    y0, y1, y2 = y.T
    return np.array([x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0]).T


def _skew(x):
    """Matrices (n, 3, 3) that take y to x cross y, for vectors (n, 3)."""
    zero = np.zeros(x.shape[0])
    rows = [
        [zero, -x[:, 2], x[:, 1]],
        [x[:, 2], zero, -x[:, 0]],
        [-x[:, 1], x[:, 0], zero],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _of_inertia(x):
    """Matrices (n, 3, 6) of x (n, 3) that take xx, xy, yy, xz, yz, zz of I to I x."""
    out = np.zeros((x.shape[0], 3, 6))
    for row, columns in enumerate(((0, 1, 3), (1, 2, 4), (3, 4, 5))):
        out[:, row, columns] = x
    return out


def _wrench(frame, w, dw, field):
    """Force and moment, each (n, 3, 10), that move a body, by its ten parameters."""
    # frame (n, 3, 3): its axes by columns; w, dw: angular velocity and acceleration;
    # field: acceleration of its origin, less gravity; all (n, 3) and the results in the
    # base's axes.
    w, dw, field = (np.einsum("nji,nj->ni", frame, x) for x in (w, dw, field))
    spin = _skew(w)
    force, moment = np.zeros((2, w.shape[0], 3, 10))
    force[:, :, 0] = field
    force[:, :, 1:4] = _skew(dw) + spin @ spin
    moment[:, :, 1:4] = -_skew(field)
    moment[:, :, 4:] = _of_inertia(dw) + spin @ _of_inertia(w)
    return frame @ force, frame @ moment
