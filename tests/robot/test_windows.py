"""Windows of a recording: where they begin, their errors, and those that fail."""

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
    """Two motions of the made-up arm, without noise."""
    return replace(simulated, q=simulated.states[:, :6], tau=simulated.tau_clean)


@pytest.fixture(scope="module")
def robot(recording):
    """Identify from true states: as good as the truth."""
    robot = RobotIdentifier(
        recording.urdf, dt=DT, friction=("viscous", "coulomb"), cutoff=None
    )
    return robot.fit(recording.states, recording.tau, groups=recording.groups)


@pytest.fixture(scope="module")
def found(robot, recording):
    return simulate_windows(
        robot, recording.q, recording.tau, recording.groups, window=0.5
    )


def test_windows_follow_one_another_within_recordings(found, recording):
    rows = found.starts[:, None] + np.arange(51)
    labels = recording.groups[rows]
    assert (labels == labels[:, :1]).all()
    own = np.diff(found.starts)
    same = np.diff(labels[:, 0]) == 0
    assert (own[same] == 50).all()
    for label, part in enumerate(recording.segments):
        inside = found.starts[labels[:, 0] == label]
        # Velocities of the very first rows rest on one side only.
        assert part.start < inside[0] < part.start + 50
        assert inside[-1] + 2 * 50 >= part.stop - 1
    np.testing.assert_array_equal(found.positions, recording.q[rows])
    np.testing.assert_allclose(found.t, DT * rows, atol=1e-12)


def test_a_window_may_end_in_the_last_row(robot, recording):
    # Given states are not smoothed, and the windows begin alike in any part.
    def starts(rows):
        given = recording.states[:rows], recording.tau[:rows]
        return simulate_windows(robot, *given, window=0.5).starts

    first = starts(400)[0]
    np.testing.assert_array_equal(starts(first + 151), first + np.arange(0, 101, 50))
    np.testing.assert_array_equal(starts(first + 150), first + np.arange(0, 51, 50))


def test_a_true_robot_stays_at_the_measured_motion(found):
    assert not found.failed.any()
    assert found.failures == {}
    # Torques go straight between rows, with a jump at every turn; the robot's did not.
    for rival in (found.rivals["at rest"], found.rivals["constant velocity"]):
        assert np.median(found.errors) < 0.02 * np.median(rival.errors)


def test_errors_are_root_mean_squares_by_hand(found):
    own = found.simulated[..., :6] - found.positions
    np.testing.assert_allclose(found.errors, np.sqrt(np.mean(own**2, axis=1)))


def test_rivals_stay_and_go_on(found):
    nv = len(found.joint_names)
    since = DT * np.arange(51)
    q0, v0 = np.split(found.start_states, 2, axis=1)
    stays, goes_on = (
        found.rivals["at rest"].simulated,
        found.rivals["constant velocity"].simulated,
    )
    np.testing.assert_array_equal(stays[..., :nv], np.repeat(q0[:, None], 51, axis=1))
    np.testing.assert_allclose(
        goes_on[..., :nv], q0[:, None] + since[:, None] * v0[:, None], atol=1e-12
    )


def test_clearly_smaller_is_a_test_at_five_per_cent():
    rng = np.random.default_rng(0)
    for n in (4, 40):
        drawn = rng.normal(size=(n, 4000))
        rate = clearly_smaller(drawn, np.zeros_like(drawn)).mean()
        # A little less, as some neighbours are alike by chance.
        assert 0.02 < rate < 0.06
    # Where neighbours are not alike it is Student's test of pairs.
    alternating = np.array([1.0, -0.7, 0.9, -1.1, 1.2, -0.8])
    for shift in np.linspace(-2.0, 2.0, 41):
        own = alternating + shift
        p = stats.ttest_1samp(own, 0.0, alternative="less").pvalue
        assert clearly_smaller(own, np.zeros(6)) == (p < 0.05)
    # Where they are, it is not taken in by their number.
    slow = np.repeat(rng.normal(size=(20, 2000)), 4, axis=0)
    naive = stats.ttest_1samp(slow, 0.0, alternative="less").pvalue < 0.05
    assert naive.mean() > 0.18
    assert clearly_smaller(slow, np.zeros_like(slow)).mean() < 0.6 * naive.mean()
    assert not clearly_smaller(-np.ones((1, 3)), np.zeros((1, 3))).any()


def test_effects_of_time_have_the_clock_of_the_fit(recording):
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
    own = recording.q[late], tau[late]
    right = simulate_windows(robot, *own, t=t[late], window=0.5)
    wrong = simulate_windows(robot, *own, window=0.5)
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
def test_what_cannot_be_is_refused(change, message, robot, recording):
    given = {"X": recording.q, "y": recording.tau, "groups": recording.groups}
    with pytest.raises(ValueError, match=message):
        simulate_windows(robot, **(given | change))
