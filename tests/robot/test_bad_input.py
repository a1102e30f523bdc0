"""Wrong and poor input: what was expected, what came, what to do."""

from dataclasses import fields

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import demo_arm_urdf, make_robot_recording
from sklearn_vbjfa.robot import FitOptions


@pytest.fixture(scope="module")
def recording():
    return make_robot_recording(duration=12.0, dt=0.01, frequency=1.0, random_state=3)


OPTIONS = {one.name for one in fields(FitOptions)}


def identify(recording, q=None, tau=None, groups=None, **settings):
    options = {k: settings.pop(k) for k in OPTIONS & set(settings)}
    settings = {"dt": recording.dt, "options": FitOptions(**options), **settings}
    robot = RobotIdentifier(demo_arm_urdf(), **{"friction": ("viscous",), **settings})
    return robot.fit(
        recording.q if q is None else q,
        recording.tau if tau is None else tau,
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
        ("friction", ("sticky",), r"Unknown friction column\(s\).*expected some of"),
    ],
)
def test_wrong_settings(recording, setting, value, message):
    with pytest.raises(ValueError, match=message):
        identify(recording, **{setting: value})


def test_wrong_shapes(recording):
    q, tau = recording.q, recording.tau
    with pytest.raises(
        ValueError,
        match=r"6 joint\(s\) \(joint_1, .*6 columns of positions or 18 of states "
        r".*got 5\. Leave out channels .*buildReducedModel",
    ):
        identify(recording, q=q[:, :5])
    with pytest.raises(ValueError, match=r"y must have 6 column\(s\).*got 5"):
        identify(recording, tau=tau[:, :5])
    with pytest.raises(ValueError, match=r"one label per row, shape \(1200,\); got"):
        identify(recording, groups=np.zeros(1199))
    with pytest.raises(ValueError, match="requires y to be passed"):
        RobotIdentifier(demo_arm_urdf(), dt=0.01, friction=("viscous",)).fit(q, None)


def test_a_joint_that_never_moves(recording):
    q = changed(recording.q, (slice(None), 3), 0.25)
    with pytest.warns(UserWarning, match=r"joint_4 never move\(s\).*are left out"):
        robot = identify(recording, q=q)
    for name in ("theta_", "theta_unconstrained_", "min_eigenvalues_"):
        assert np.isfinite(getattr(robot, name)).all()
    assert np.all(robot.min_eigenvalues_ > 0)
    assert robot.estimate_.moments.n_rows[3] == 0
    assert np.all(robot.estimate_.moments.n_rows[[0, 1, 2, 4, 5]] > 100)
    names = np.array(robot.parameter_names_)
    assert not robot.identifiable_[names == "joint_4:viscous"]
    assert np.abs(robot.theta_unconstrained_).max() < 1e3
    error = robot.predict(q) - recording.tau
    assert np.isfinite(error).all()


def test_a_dead_torque_channel(recording):
    tau = changed(recording.tau, (slice(None), [1, 4]), 3.0)
    with pytest.raises(
        ValueError,
        match=r"torque of joint_2, joint_5 is constant while .*Check the rec",
    ):
        identify(recording, tau=tau)


def test_no_motion_at_all(recording):
    with pytest.raises(ValueError, match=r"No joint moves.*Check the position columns"):
        identify(recording, q=np.ones_like(recording.q))


def test_too_few_equations(recording):
    states = recording.states[:10]
    with pytest.raises(
        ValueError, match=r"60 equations .* fewer than the 66 parameters; record for"
    ):
        identify(
            recording,
            q=states,
            tau=recording.tau[:10],
            standstill=None,
            bodies="free",
        )


def test_too_short_to_differentiate(recording):
    with pytest.raises(ValueError, match="at least 16 samples; the longest has 15"):
        identify(recording, q=recording.q[:15], tau=recording.tau[:15])


def test_too_short_for_the_filter(recording):
    with pytest.raises(ValueError, match=r"The low-pass at 2 Hz is .*higher cutoff"):
        identify(recording, q=recording.q[:60], tau=recording.tau[:60], cutoff=2.0)


def test_what_is_no_robot(recording):
    for model, kind, message in (
        ("nowhere.urdf", FileNotFoundError, "No robot description at 'nowhere.urdf'"),
        (7, TypeError, "path of a URDF or MJCF file or a pinocchio.Model, got int"),
    ):
        with pytest.raises(kind, match=message):
            RobotIdentifier(model, dt=0.01, friction=("viscous",)).fit(
                recording.q, recording.tau
            )
