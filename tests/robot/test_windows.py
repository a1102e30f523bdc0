"""Simulated windows of a recording: starts, errors, baselines, bad input."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.diagnosis import simulate_windows
from sklearn_vbjfa.effects import Drift
from sklearn_vbjfa.robot import clearly_smaller

DT = 0.01


@pytest.fixture(scope="module")
def recording(simulated):
    """Return two noise-free motions of the simulated arm."""
    return replace(simulated, q=simulated.states[:, :6], tau=simulated.tau_clean)


@pytest.fixture(scope="module")
def robot(recording):
    """Identify from true states, nearly exactly."""
    robot = RobotIdentifier(
        recording.urdf, dt=DT, friction=("viscous", "coulomb"), cutoff=None
    )
    return robot.fit(recording.states, recording.tau, groups=recording.groups)


@pytest.fixture(scope="module")
def windows(robot, recording):
    return simulate_windows(
        robot, recording.q, recording.tau, recording.groups, window=0.5
    )


def test_windows_are_consecutive_within_recordings(windows, recording):
    rows = windows.starts[:, None] + np.arange(51)
    labels = recording.groups[rows]
    assert (labels == labels[:, :1]).all()
    steps = np.diff(windows.starts)
    same = np.diff(labels[:, 0]) == 0
    assert (steps[same] == 50).all()
    for label, part in enumerate(recording.segments):
        starts = windows.starts[labels[:, 0] == label]
        # Velocities of the first rows are one-sided estimates.
        assert part.start < starts[0] < part.start + 50
        assert starts[-1] + 2 * 50 >= part.stop - 1
    np.testing.assert_array_equal(windows.positions, recording.q[rows])
    np.testing.assert_allclose(windows.t, DT * rows, atol=1e-12)


def test_a_window_may_end_in_the_last_row(robot, recording):
    # Given states are not smoothed, so windows start equally in any part.
    def starts(rows):
        data = recording.states[:rows], recording.tau[:rows]
        return simulate_windows(robot, *data, window=0.5).starts

    first = starts(400)[0]
    np.testing.assert_array_equal(starts(first + 151), first + np.arange(0, 101, 50))
    np.testing.assert_array_equal(starts(first + 150), first + np.arange(0, 51, 50))


def test_accurate_robot_follows_the_measured_motion(windows):
    assert not windows.failed.any()
    assert windows.failures == {}
    # Interpolated torques miss the jumps of friction at reversals.
    for baseline in (windows.rivals["at rest"], windows.rivals["constant velocity"]):
        assert np.median(windows.errors) < 0.02 * np.median(baseline.errors)


def test_errors_are_root_mean_squares(windows):
    error = windows.simulated[..., :6] - windows.positions
    np.testing.assert_allclose(windows.errors, np.sqrt(np.mean(error**2, axis=1)))


def test_baselines_at_rest_and_at_constant_velocity(windows):
    nv = len(windows.joint_names)
    dt = DT * np.arange(51)
    q0, v0 = np.split(windows.start_states, 2, axis=1)
    at_rest, moving = (
        windows.rivals["at rest"].simulated,
        windows.rivals["constant velocity"].simulated,
    )
    np.testing.assert_array_equal(at_rest[..., :nv], np.repeat(q0[:, None], 51, axis=1))
    np.testing.assert_allclose(
        moving[..., :nv], q0[:, None] + dt[:, None] * v0[:, None], atol=1e-12
    )


def test_clearly_smaller_is_a_test_at_five_per_cent():
    rng = np.random.default_rng(0)
    for n in (4, 40):
        errors = rng.normal(size=(n, 4000))
        rate = clearly_smaller(errors, np.zeros_like(errors)).mean()
        # Slightly below 5 % because neighbours correlate by chance.
        assert 0.02 < rate < 0.06
    # Without positive correlation it is Student's paired test.
    alternating = np.array([1.0, -0.7, 0.9, -1.1, 1.2, -0.8])
    for shift in np.linspace(-2.0, 2.0, 41):
        shifted = alternating + shift
        p = stats.ttest_1samp(shifted, 0.0, alternative="less").pvalue
        assert clearly_smaller(shifted, np.zeros(6)) == (p < 0.05)
    # Correlated neighbours do not count as independent.
    slow = np.repeat(rng.normal(size=(20, 2000)), 4, axis=0)
    naive = stats.ttest_1samp(slow, 0.0, alternative="less").pvalue < 0.05
    assert naive.mean() > 0.18
    assert clearly_smaller(slow, np.zeros_like(slow)).mean() < 0.6 * naive.mean()
    assert not clearly_smaller(-np.ones((1, 3)), np.zeros((1, 3))).any()


def test_time_varying_effects_use_the_clock_of_the_fit(recording):
    robot = RobotIdentifier(
        recording.urdf,
        dt=DT,
        friction=("viscous", "coulomb"),
        effects=[Drift(joint=1, of="offset", time_constant=3.0)],
        cutoff=None,
    )
    t = 100.0 + DT * np.arange(recording.n_samples)
    drift = 20.0 * np.exp(-t / 3.0 + 100.0 / 3.0)
    tau = recording.tau.copy()
    tau[:, 1] += drift
    robot.fit(recording.states, tau, groups=recording.groups, t=t)
    late = slice(300, 600)
    data = recording.q[late], tau[late]
    right = simulate_windows(robot, *data, t=t[late], window=0.5)
    wrong = simulate_windows(robot, *data, window=0.5)
    assert np.median(right.errors[:, 1]) < 0.2 * np.median(wrong.errors[:, 1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"window": 0.0}, "window must be a time in seconds, at least the sample"),
        (
            {"window": 17.0},
            "No recording is as long as a window of 17 s: the longest has",
        ),
        ({"y": np.zeros((5, 6))}, r"inconsistent numbers of samples: \[3200, 5\]"),
        ({"y": np.zeros((3200, 2))}, r"y must have 6 column\(s\) of torques; got 2"),
        ({"t": np.zeros(3)}, r"inconsistent numbers of samples: \[3200, 3\]"),
    ],
)
def test_invalid_windows_are_refused(change, message, robot, recording):
    inputs = {"X": recording.q, "y": recording.tau, "groups": recording.groups}
    with pytest.raises(ValueError, match=message):
        simulate_windows(robot, **(inputs | change))
