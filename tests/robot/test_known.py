import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.model import nominal_parameters
from sklearn_vbjfa.robot import FitOptions, note_of_masses
from sklearn_vbjfa.robot._posterior import known_parameters
from tests.effects._arms import arm, inverse_dynamics, motion


def fitted(axes, noise=0.01, friction=(), bodies="free"):
    """Identify an arm from states and torques with noise."""
    model = arm(axes)
    _, states = motion(model.nv, dt=0.01, seed=3)
    torque = inverse_dynamics(model, states)
    torque += noise * np.random.default_rng(0).normal(size=torque.shape)
    robot = RobotIdentifier(model, dt=0.01, friction=friction, bodies=bodies)
    robot.set_params(options=FitOptions(standstill=None))
    return robot.fit(states, torque), states


def spanned(robot, states):
    """Tell what is known from the null space of the regressor, literally."""
    Phi = robot.features_.matrices(states[::7]).reshape(-1, robot.theta_.size)
    size = np.linalg.norm(Phi, axis=0)
    _, values, Vt = np.linalg.svd(Phi / np.where(size > 0, size, 1.0))
    kernel = Vt[(values > 1e-6 * values[0]).sum() :]
    lost = (kernel**2).sum(axis=0)
    found = np.where(lost < 1e-6, "yes", "in combination")
    return np.where(size == 0, "no", found)


@pytest.mark.parametrize("axes", ["Y", "ZY", "ZYX", "zY", "xy"])
def test_what_is_known_is_what_no_motion_of_parameters_hides(axes):
    robot, states = fitted(axes)
    assert list(robot.robot_.known_) == spanned(robot, states).tolist()


def test_a_slider_is_weighed_and_the_link_of_a_revolute_joint_is_not():
    both = fitted("zY")[0].robot_.known_
    assert (both[0], both[10]) == ("in combination", "in combination")
    alone = fitted("x")[0]
    assert alone.robot_.known_[0] == "yes"
    assert alone.theta_[0] == pytest.approx(4.0, abs=0.05)
    assert 0 < alone.theta_std_[0] < 0.05
    assert fitted("Y")[0].robot_.known_[0] == "no"
    assert "joint_1" in note_of_masses(fitted("Y")[0])
    assert note_of_masses(fitted("x")[0]) == ""


@pytest.mark.parametrize("bodies", ["free", "prior"])
def test_one_direction_determines_a_sum_only(bodies, tmp_path):
    """Coulomb friction of 2 N m and an offset of 1 N m on joints that never turn."""
    model, terms = arm("ZY"), ("viscous", "coulomb", "offset")
    _, states = motion(2, dt=0.01, seed=3, size=0.2)
    q, v, a = np.split(states, 3, axis=1)
    speed = 0.1 - v.min(axis=0)
    time = 0.01 * np.arange(len(q))[:, None]
    states = np.hstack([q + speed * time, v + speed, a])
    torque = inverse_dynamics(model, states) + 0.5 * states[:, 2:4] + 3.0
    torque += 0.01 * np.random.default_rng(0).normal(size=torque.shape)
    options = FitOptions(standstill=None)
    robot = RobotIdentifier(
        model, dt=0.01, friction=terms, options=options, bodies=bodies
    ).fit(states, torque)
    std = robot.theta_std_.reshape(2, -1)
    assert np.isinf(std[:, 11:]).all()
    assert (std[:, 10] < 0.1).all()
    # A description determines bodies that the motion does not.
    alone = robot.identifiable_.reshape(2, -1)[:, :10]
    assert np.isfinite(std[:, :10][alone]).all()
    assert np.isfinite(std[:, :10]).all() == (bodies == "prior")
    sums = robot.sample(20, 0).reshape(20, 2, -1)[:, :, 11:].sum(axis=2)
    np.testing.assert_allclose(sums, 3.0, atol=0.1)
    ranges = robot.ranges()
    ranges.save(tmp_path / "ranges.json")
    text = (tmp_path / "ranges.json").read_text(encoding="utf-8")
    for joint in ("joint_1", "joint_2"):
        assert np.isnan(ranges[f"{joint}:coulomb"].upper)
        assert f"{joint}:viscous" in text
        assert f"{joint}:coulomb" not in text
        assert f"{joint}:offset" not in text


def test_a_mass_in_much_noise_is_not_known():
    quiet, loud = (fitted("x", noise=noise)[0] for noise in (1.0, 2000.0))
    assert quiet.robot_.known_[0] == "yes"
    assert quiet.theta_std_[0] < 0.5 * quiet.theta_[0]
    assert loud.robot_.known_[0] == "no"
    assert loud.identifiable_[0]


def test_friction_is_known_beside_unknown_bodies():
    robot, _ = fitted("ZY", friction=("viscous",))
    known = dict(zip(robot.parameter_names_, robot.robot_.known_))
    assert known["joint_1:viscous"] == known["joint_2:viscous"] == "yes"
    assert known["joint_1:m"] == "no"
    assert known["joint_2:m"] == "in combination"


def test_beside_a_description_its_values_say_so():
    robot, _ = fitted("Y", bodies="prior")
    known = dict(zip(robot.parameter_names_, robot.robot_.known_))
    # The moments and the inertia about the axis are felt, nothing else is.
    felt = {"joint_1:mc_x", "joint_1:mc_z", "joint_1:I_yy"}
    assert {name for name, how in known.items() if how == "yes"} == felt
    assert {how for name, how in known.items() if name not in felt} == {
        "from the description"
    }
    nominal = nominal_parameters(robot.features_.model_)[0, 0]
    assert robot.theta_[0] == pytest.approx(nominal, rel=0.3)
    assert np.isfinite(robot.estimate_.prior_std[:10]).all()
    assert (robot.theta_std_[:10] <= robot.estimate_.prior_std[:10] * 1.01).all()
    assert "joint_1" in note_of_masses(robot)
    # A value that the fit has moved far away is not the description's.
    robot.theta_[0] += 3.0 * robot.estimate_.prior_std[0]
    assert known_parameters(robot, robot.estimate_)[0] == "no"
