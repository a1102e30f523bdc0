"""Recordings of a joint whose armature and friction vary between recordings."""

import numpy as np

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.equations import RigidBodyFeatures
from sklearn_vbjfa.model import nominal_parameters

URDF = """<robot name="one"><link name="base"/><link name="arm"><inertial>
<origin xyz="0.1 0 0"/><mass value="2"/><inertia ixx="0.01" iyy="0.02" izz="0.02"
ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="hip" type="revolute">
<parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="100" velocity="20"/></joint></robot>"""
VALUES = {"viscous": 0.3, "coulomb": 0.5, "offset": 0.0, "rotor_inertia": 0.1}
NAMES = [f"hip:{name}" for name in VALUES]


def recordings(urdf, seed, n, *, off, rows=80, noise=0.05):
    """Return rows, torques and labels of n recordings, and the values of one more."""
    # off (4,): standard deviations of the joint's values between recordings
    rng = np.random.default_rng(seed)
    features = RigidBodyFeatures(urdf, friction=tuple(VALUES)).load()
    body, X, y = nominal_parameters(features.model_)[0], [], []

    def values():
        return np.array(list(VALUES.values())) + off * rng.standard_normal(4)

    for _ in range(n):
        x = rng.standard_normal((rows, 3)) * [0.5, 2.0, 8.0]
        theta = np.r_[body, values()]
        torque = features.transform(x).reshape(rows, -1) @ theta
        X.append(x)
        y.append(torque + noise * rng.standard_normal(rows))
    labels = np.repeat(np.arange(n), rows)
    return np.concatenate(X), np.concatenate(y)[:, None], labels, values()


def share_of(share):
    """Return standard deviations of the joint's values as a share of each."""
    return share * np.array([0.3, 0.5, 0.25, 0.1])


def covers(urdf, seed, n, off):
    """Test whether values of a held-out recording lie in the ranges, and by noise."""
    X, y, labels, new = recordings(urdf, seed, n, off=off)
    ranges = RobotIdentifier(urdf, bodies="fixed").fit(X, y, groups=labels).ranges(0.9)
    pairs = [(ranges[name], value) for name, value in zip(NAMES, new)]
    noise = [abs(value - row.value) <= 1.645 * row.within for row, value in pairs]
    return [row.lower <= value <= row.upper for row, value in pairs], noise
