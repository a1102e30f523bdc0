"""Robots with joints that follow: identified, saved, written, simulated."""

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa.effects import LoadFriction
from sklearn_vbjfa.model import DoubtWarning, joint_names, load_folded
from sklearn_vbjfa.physical import min_eigenvalue
from sklearn_vbjfa.simulation._dynamics import ForwardDynamics
from tests.effects import _arms
from tests.model.test_followers import joint, link

LINKS = {"upper": 4.0, "lower": 3.0, "left": 1.0, "right": 1.2}
MIMIC = 'joint="grip" multiplier="-2.5" offset="0.2"'
JOINTS = (
    joint("shoulder", "base", "upper"),
    joint("elbow", "upper", "lower", axis="1 0 0"),
    joint("grip", "lower", "left", "prismatic", "1 1 0"),
    joint("follow", "lower", "right", axis="1 0 1", mimic=MIMIC),
)
# Of the joints in Pinocchio's order: shoulder, elbow, follow, grip.
A = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, -2.5], [0, 0, 1.0]])
B = np.array([0.0, 0.0, 0.2, 0.0])
VISCOUS = np.array([1.0, 0.5, 3.0])
DT = 0.005


def torques(model, q, v, a):
    """Torques of a full model that the three leaders feel, (n, 3)."""
    data = model.createData()
    rows = [(A @ x + B, A @ y, A @ z) for x, y, z in zip(q, v, a)]
    return np.array([A.T @ pin.rnea(model, data, *row) for row in rows])


@pytest.fixture(scope="module")
def motion():
    """Positions, velocities and accelerations (n, 3) of sums of sines."""
    _, states = _arms.motion(3, duration=15.0, dt=DT, top=1.3)
    return np.stack(np.split(states, 3, axis=1))


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "gripper.urdf"
    parts = "".join([*(link(*one) for one in LINKS.items()), *JOINTS])
    path.write_text(f'<robot name="gripper"><link name="base"/>{parts}</robot>')
    return path


@pytest.fixture(scope="module")
def recorded(path, motion):
    """Noisy positions and torques of the leaders alone."""
    rng = np.random.default_rng(1)
    tau = torques(pin.buildModelFromUrdf(str(path)), *motion) + VISCOUS * motion[1]
    q = motion[0] + 1e-5 * rng.normal(size=motion[0].shape)
    return q, tau + 0.02 * rng.normal(size=tau.shape)


@pytest.fixture(scope="module")
def fitted(path, recorded):
    # From a description with other masses than those of the robot.
    other = path.with_name("nominal.urdf")
    text = path.read_text().replace('value="1.2"', 'value="0.7"')
    other.write_text(text.replace('value="3.0"', 'value="2.0"'))
    return RobotIdentifier(str(other), dt=DT, friction=("viscous",)).fit(*recorded)


def test_a_recording_needs_no_columns_of_a_follower(fitted, recorded, motion, path):
    assert fitted.joint_names_ == ("shoulder", "elbow", "grip")
    q, _ = recorded
    true = torques(pin.buildModelFromUrdf(str(path)), *motion) + VISCOUS * motion[1]
    error = np.sqrt(np.mean((fitted.predict(q) - true) ** 2, axis=0))
    assert (error < 0.01 * true.std(axis=0)).all()


def test_a_follower_has_ten_parameters_of_its_own(fitted, path):
    at = fitted.parameter_names_.index("follow:m")
    assert fitted.parameter_units_[at] == "kg"
    body = fitted.theta_[at : at + 10]
    assert min_eigenvalue(body[None])[0] > 0
    # It swings about an axis of its own, which shows a moment of inertia about it.
    axis = np.array([1.0, 0.0, 1.0]) / np.sqrt(2)
    full = pin.buildModelFromUrdf(str(path))
    true, found = (
        axis @ one.matrix()[3:, 3:] @ axis
        for one in (
            full.inertias[full.getJointId("follow")],
            pin.Inertia.FromDynamicParameters(body),
        )
    )
    assert found == pytest.approx(true, rel=0.02)


def test_the_load_includes_the_follower(motion, path, tmp_path):
    """Of friction that is fitted, saved, computed state by state and simulated."""
    tau = torques(pin.buildModelFromUrdf(str(path)), *motion)
    tau[:, 2] += 0.2 * np.abs(tau[:, 2]) * np.sign(motion[1, :, 2])
    robot = RobotIdentifier(path, dt=DT, friction=(), effects=[LoadFriction(2)])
    robot = robot.fit(X := np.hstack(motion), tau).robot_
    assert robot.theta_[-1] == pytest.approx(0.2, rel=0.01)
    robot.save(tmp_path / "robot.json")
    with pytest.warns(DoubtWarning, match="lacks the bodies of follow: use"):
        robot.to_pinocchio()
    for one in (robot, load_identified(tmp_path / "robot.json")):
        dynamics = ForwardDynamics(one.torque_model())
        for row, tau in zip(X[::99], robot.predict(X[::99])):
            q, v, a = np.split(row, 3)
            np.testing.assert_allclose(one.step(q, v, a), tau, atol=1e-9)
            for _ in range(9):
                found = dynamics.accelerate(q, v, tau, np.sign(v), np.zeros(3, bool))
            np.testing.assert_allclose(found, a, atol=1e-6)


def test_a_written_mjcf_has_the_follower(fitted, motion, tmp_path):
    import mujoco

    target = tmp_path / "identified.xml"
    fitted.to_mjcf(target)
    model = mujoco.MjModel.from_xml_path(str(target))
    names = [model.joint(j).name for j in range(model.njnt)]
    assert names == ["shoulder", "elbow", "grip", "follow"]
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data, found = mujoco.MjData(model), []
    order = [0, 1, 3, 2]
    for x, y, z in zip(*motion[:, :100]):
        data.qpos[:], data.qvel[:] = (A @ x + B)[order], (A @ y)[order]
        data.qacc[:] = (A @ z)[order]
        mujoco.mj_inverse(model, data)
        found.append(A[order].T @ data.qfrc_inverse)
    expected = fitted.predict(np.hstack(motion[:, :100]))
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())
    # And it is the same robot to those who read it here.
    with pytest.warns(UserWarning, match="not taken over .*damping"):
        read = load_folded(target)
    assert joint_names(read.model) == fitted.joint_names_
    (body,) = read.followers
    at = fitted.parameter_names_.index("follow:m")
    np.testing.assert_allclose(body.parameters, fitted.theta_[at : at + 10], atol=1e-9)
    assert (body.chain[-1].rate, body.chain[-1].offset) == (-2.5, 0.2)
