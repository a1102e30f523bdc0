"""Arms that are moved from pose to pose, simulated with Pinocchio alone."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from sklearn_vbjfa.recording import Recording

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 1 0")
DT, MOVE, HOLD, APPROACH, SLIP = 0.01, 0.6, 1.0, 0.05, 0.002
NOISE, STEP, ENCODER = 0.01, 0.02, 1e-5


@dataclass(frozen=True)
class Arm:
    """A serial arm; its bodies may differ from those of the description."""

    masses: np.ndarray
    centres: np.ndarray
    lengths: np.ndarray

    @classmethod
    def drawn(cls, n, rng):
        """Random arm of n joints, the first of them vertical."""
        lengths = rng.uniform(0.1, 0.4, n)
        centres = np.c_[rng.normal(size=(n, 2)) * 0.02, 0.5 * lengths]
        return cls(np.sort(rng.uniform(0.5, 5.0, n))[::-1], centres, lengths)

    def misdescribed(self, rng):
        """Arm of which two bodies are off by 20 to 50 %."""
        masses, centres = self.masses.copy(), self.centres.copy()
        n = len(masses)
        for body in rng.choice(np.arange(1, n), size=2, replace=False):
            off = rng.uniform(0.2, 0.5)
            masses[body] *= 1 + off * rng.choice([-1, 1])
            centres[body] *= 1 + off * rng.uniform(-1, 1)
        return Arm(masses, centres, self.lengths)

    def write(self, path):
        """Write the arm as a URDF."""
        lines = ['<robot name="arm"><link name="base"/>']
        parent, place = "base", 0.2
        for k, (mass, centre, length) in enumerate(
            zip(self.masses, self.centres, self.lengths)
        ):
            about = mass * (length**2 / 12 + 0.03**2)
            lines.append(
                f'<link name="link{k + 1}"><inertial>'
                f'<origin xyz="{centre[0]} {centre[1]} {centre[2]}"/>'
                f'<mass value="{mass}"/><inertia ixx="{about}" iyy="{about}" '
                f'izz="{0.3 * about + 1e-4}" ixy="0" ixz="0" iyz="0"/></inertial>'
                f'</link><joint name="joint{k + 1}" type="revolute">'
                f'<parent link="{parent}"/><child link="link{k + 1}"/>'
                f'<origin xyz="0 0 {place}"/><axis xyz="{AXES[k]}"/>'
                '<limit lower="-2.5" upper="2.5" effort="60" velocity="4"/></joint>'
            )
            parent, place = f"link{k + 1}", length
        Path(path).write_text("".join([*lines, "</robot>"]), encoding="utf-8")
        return pin.buildModelFromUrdf(str(path))


def gravity(model, q):
    """Gravity torques (n, nv)."""
    data = model.createData()
    return np.array([pin.computeGeneralizedGravity(model, data, x).copy() for x in q])


def visit(poses, both_sides=True):
    """Positions (n, nv) of a robot that goes to poses, and holds each for a second."""
    q = [poses[0] - 2 * APPROACH]
    for pose in poses:
        stops = [(pose - APPROACH, 0.0), (pose, HOLD)]
        if both_sides:
            stops += [(pose + APPROACH, 0.0), (pose, HOLD)]
        for target, hold in stops:
            way = target - q[-1]
            steps = round((MOVE if np.abs(way).max() < 0.2 else 2.0) / DT)
            s = np.linspace(0.0, 1.0, steps)[:, None]
            q.extend(q[-1] + way * (10 * s**3 - 15 * s**4 + 6 * s**5))
            q.extend([target] * round(hold / DT))
    return np.array(q)


def record(model, q, friction, rng):
    """Record a motion, with friction that slips after 2 mrad, and noise."""
    v = np.gradient(q, DT, axis=0)
    data, states = model.createData(), zip(q, v, np.gradient(v, DT, axis=0))
    tau = np.array([pin.rnea(model, data, *state) for state in states])
    z = np.zeros_like(q)
    for k in range(1, len(q)):
        z[k] = np.clip(z[k - 1] + (q[k] - q[k - 1]) / SLIP, -1, 1)
    size = np.sqrt((gravity(model, q) ** 2).mean(axis=0)).max()
    tau += friction * z + rng.normal(size=q.shape) * NOISE * size
    nv = q.shape[1]
    return Recording(
        name="poses",
        q=q + rng.normal(size=q.shape) * ENCODER,
        tau=np.round(tau / STEP) * STEP,
        t=None,
        dt=DT,
        groups=np.zeros(len(q), dtype=int),
        group_names=("poses",),
        joint_names=tuple(f"joint{k + 1}" for k in range(nv)),
        position_units=("rad",) * nv,
        torque_units=("N m",) * nv,
    )
