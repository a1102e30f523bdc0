"""Trees of all kinds of joints, and their regressor matrices by Pinocchio."""

import numpy as np
import pinocchio as pin

ALIGNED = ("RX", "RY", "RZ", "PX", "PY", "PZ")
OBLIQUE = ("RevoluteUnaligned", "PrismaticUnaligned")
OTHERS = ("HY", "HelicalUnaligned", "Composite")


def make_joint(kind, rng):
    if kind in ALIGNED:
        return getattr(pin, f"JointModel{kind}")()
    axis = rng.normal(size=3)
    if rng.random() < 0.3:
        # Along a coordinate axis, backwards perhaps, yet not called so.
        axis = rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]
    axis /= np.linalg.norm(axis)
    if kind == "HY":
        return pin.JointModelHY(rng.normal())
    if kind == "HelicalUnaligned":
        return pin.JointModelHelicalUnaligned(axis, rng.normal())
    if kind == "Composite":
        inner = pin.JointModelComposite()
        inner.addJoint(pin.JointModelRevoluteUnaligned(axis), random_placement(rng))
        return inner
    return getattr(pin, f"JointModel{kind}")(axis)


def random_placement(rng):
    translation = rng.choice([0.0, 1.0]) * rng.normal(size=3)
    if rng.random() < 0.3:
        quarter = rng.choice([-1, 0, 1], size=3) * np.pi / 2
        return pin.SE3(pin.rpy.rpyToMatrix(quarter), translation)
    return pin.SE3(pin.Quaternion(*rng.normal(size=4)).normalized(), translation)


def build(rng, kinds, parents=None, gravity=None):
    """Tree with joints of given kinds; bodies are set where they matter."""
    model = pin.Model()
    model.gravity.linear = rng.normal(size=3) if gravity is None else gravity
    for j, kind in enumerate(kinds):
        parent = int(rng.integers(0, j + 1)) if parents is None else parents[j]
        joint = make_joint(kind, rng)
        model.addJoint(parent, joint, random_placement(rng), f"joint_{j}")
    return model


def by_sample(model, q, v, a):
    data = model.createData()
    rows = [pin.computeJointTorqueRegressor(model, data, *x) for x in zip(q, v, a)]
    return np.array(rows).reshape(len(q), model.nv, model.nv, 10)
