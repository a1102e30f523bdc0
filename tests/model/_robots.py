"""Robots and equations that several tests build on, each with its truth."""

import numpy as np

from tests.physical._problems import parameters_of

_AXES = ("RX", "RY", "RZ", "PX", "PY", "PZ")


def random_body(rng):
    """Ten inertial parameters of a cloud of point masses, in Pinocchio's order."""
    masses = rng.uniform(0.2, 2.0, size=8)
    return parameters_of(0.3 * rng.normal(size=(8, 3)), masses)


def random_tree(rng, n_joints, axes=_AXES):
    """Branching tree of revolute and prismatic joints with random bodies.

    Returns the pinocchio model and the bodies (n_joints, 10).
    """
    import pinocchio as pin

    model = pin.Model()
    bodies = []
    for j in range(n_joints):
        parent = int(rng.integers(0, j + 1))
        kind = rng.choice([*axes, "oblique"])
        if kind == "oblique":
            axis = rng.normal(size=3)
            joint = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
        else:
            joint = getattr(pin, f"JointModel{kind}")()
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        placement = pin.SE3(rotation, rng.normal(size=3))
        number = model.addJoint(parent, joint, placement, f"joint_{j}")
        bodies.append(random_body(rng))
        model.inertias[number] = pin.Inertia.FromDynamicParameters(bodies[-1])
    return model, np.array(bodies)


def swing():
    """Model of one link that swings about a horizontal axis."""
    import pinocchio as pin

    model = pin.Model()
    number = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "swing")
    model.inertias[number] = pin.Inertia(
        2.0, np.array([0.1, 0.0, 0.3]), np.diag([0.1, 0.1, 0.05])
    )
    return model


def arms(count, axes=("RY", "RX", "RZ", "RY")):
    """Make a robot of several arms whose joints take turns in the order."""
    import pinocchio as pin

    rng = np.random.default_rng(7)
    model = pin.Model()
    last = np.zeros(count, dtype=int)
    for j, axis in enumerate(axes):
        for arm in range(count):
            place = pin.SE3(np.eye(3), np.r_[0.0, 0.0, 0.3] + 0.1 * rng.normal(size=3))
            joint = getattr(pin, f"JointModel{axis}")()
            name = f"arm_{arm}_joint_{j}"
            last[arm] = model.addJoint(int(last[arm]), joint, place, name)
            link = pin.Inertia.FromBox(4.0 / (1 + j), 0.08, 0.1, 0.3)
            centre = pin.SE3(np.eye(3), np.array([0.05, 0.03, 0.15]))
            model.appendBodyToJoint(int(last[arm]), link, centre)
    return model


def joint_equations(rng, n=300, nv=3, p=5, noise=0.0):
    """Random equations of nv joints and one parameter vector.

    Returns Phi (n, nv, p), tau (n, nv), theta (p,); `noise` is the standard deviation
    of the torque noise, one number or one per joint.
    """
    Phi = rng.normal(size=(n, nv, p)) * np.geomspace(0.1, 10, p)
    theta = rng.uniform(0.5, 2.0, size=p) * rng.choice([-1, 1], size=p)
    return Phi, Phi @ theta + noise * rng.normal(size=(n, nv)), theta


def wide(Phi):
    """Regressor matrices as the rows that the estimators take."""
    return Phi.reshape(Phi.shape[0], -1)


def weighted_least_squares(Phi, tau, weight):
    """Least squares written out equation by equation; `weight` is (n, nv)."""
    rows, values = [], []
    for i in range(Phi.shape[0]):
        for j in range(Phi.shape[1]):
            rows.append(np.sqrt(weight[i, j]) * Phi[i, j])
            values.append(np.sqrt(weight[i, j]) * tau[i, j])
    return np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0]
