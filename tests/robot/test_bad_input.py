"""Wrong and poor input: what was expected, what came, what to do."""

from dataclasses import fields

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import demo_arm_urdf
from sklearn_vbjfa.robot import FitOptions

OPTIONS = {one.name for one in fields(FitOptions)}


def identify(new_motion, q=None, tau=None, groups=None, **settings):
    options = {k: settings.pop(k) for k in OPTIONS & set(settings)}
    settings = {"dt": new_motion.dt, "options": FitOptions(**options), **settings}
    robot = RobotIdentifier(demo_arm_urdf(), **{"friction": ("viscous",), **settings})
    return robot.fit(
        new_motion.q if q is None else q,
        new_motion.tau if tau is None else tau,
        groups=groups,
    )


def changed(values, where, value):
    values = values.copy()
    values[where] = value
    return values


@pytest.mark.parametrize(
    ("setting", "value", "message"),
    [
        ("dt", None, "dt must be the sample period in seconds, positive.*got None"),
        ("dt", 0.0, r"dt must be .*got 0\.0"),
        ("dt", "0.01", r"dt must be .*got '0\.01'"),
        ("dt", np.nan, "dt must be .*got nan"),
        (
            "cutoff",
            50.0,
            "cutoff must lie below the Nyquist frequency 50 Hz.*Give None",
        ),
        ("state_cutoff", "low", "cutoff must be 'auto', a frequency in Hz, or None"),
        ("standstill", "slow", "standstill must be 'auto', a speed, or None; got"),
        ("standstill", -1.0, "one non-negative speed or 6 of them; got -1"),
        ("standstill", 99.0, "Every sample is masked as standstill; lower"),
        ("joint_weights", "even", "joint_weights must be 'auto', None or an array"),
        ("input_noise", "some", "input_noise must be 'auto' .* or None .*got 'some'"),
        ("projector", "convex", "projector must be 'default', a PhysicalProjector or"),
        ("options", {"window": 1}, "options must be an instance of .*FitOptions, None"),
        ("friction", ("sticky",), r"Unknown friction column\(s\).*expected some of"),
    ],
)
def test_wrong_settings(new_motion, setting, value, message):
    with pytest.raises((TypeError, ValueError), match=message):
        identify(new_motion, **{setting: value})


def test_wrong_shapes(new_motion):
    q, tau = new_motion.q, new_motion.tau
    with pytest.raises(
        ValueError,
        match=r"6 joint\(s\) \(joint_1, .*6 columns of positions or 18 of states "
        r".*got 5\. Leave out channels .*buildReducedModel",
    ):
        identify(new_motion, q=q[:, :5])
    with pytest.raises(ValueError, match=r"y must have 6 column\(s\).*got 5"):
        identify(new_motion, tau=tau[:, :5])
    with pytest.raises(ValueError, match=r"one label per row, shape \(800,\); got"):
        identify(new_motion, groups=np.zeros(799))
    with pytest.raises(ValueError, match="requires y to be passed"):
        RobotIdentifier(demo_arm_urdf(), dt=0.01, friction=("viscous",)).fit(q, None)


def test_a_joint_that_never_moves(new_motion):
    q = changed(new_motion.q, (slice(None), 3), 0.25)
    with pytest.warns(UserWarning, match=r"joint_4 never moves: .* 0\.25,"):
        robot = identify(new_motion, q=q)
    for name in ("theta_", "theta_unconstrained_", "min_eigenvalues_"):
        assert np.isfinite(getattr(robot, name)).all()
    assert np.all(robot.min_eigenvalues_ > 0)
    assert robot.estimate_.moments.n_rows[3] == 0
    assert np.all(robot.estimate_.moments.n_rows[[0, 1, 2, 4, 5]] > 100)
    names = np.array(robot.parameter_names_)
    assert not robot.identifiable_[names == "joint_4:viscous"]
    assert np.abs(robot.theta_unconstrained_).max() < 1e3
    error = robot.predict(q) - new_motion.tau
    assert np.isfinite(error).all()


def test_channels_that_say_nothing(new_motion):
    tau = changed(new_motion.tau, (slice(None), [1, 4]), 3.0)
    message = r"torque of joint_2, joint_5 is constant: .*Check the rec"
    with pytest.raises(ValueError, match=message):
        identify(new_motion, tau=tau)
    with pytest.raises(ValueError, match=r"No joint moves.*Check the position columns"):
        identify(new_motion, q=np.ones_like(new_motion.q))


def test_too_few_rows(new_motion):
    q, tau, states = new_motion.q, new_motion.tau, new_motion.states[:10]
    message = "60 equations .* fewer than the 66 parameters; record for"
    with pytest.raises(ValueError, match=message):
        identify(new_motion, states, tau[:10], standstill=None, bodies="free")
    with pytest.raises(ValueError, match="at least 16 samples; the longest has 15"):
        identify(new_motion, q[:15], tau[:15])
    with pytest.raises(ValueError, match="has 63 rows; record at least 64"):
        identify(new_motion, q[:63], tau[:63])
    with pytest.raises(ValueError, match=r"The low-pass at 2 Hz is .*higher cutoff"):
        identify(new_motion, q[:60], tau[:60], cutoff=2.0)


def test_what_is_no_robot(new_motion):
    for model, kind, message in (
        ("nowhere.urdf", FileNotFoundError, "No robot description at 'nowhere.urdf'"),
        (7, TypeError, "path of a URDF or MJCF file or a pinocchio.Model, got int"),
    ):
        with pytest.raises(kind, match=message):
            RobotIdentifier(model, dt=0.01, friction=("viscous",)).fit(
                new_motion.q, new_motion.tau
            )
