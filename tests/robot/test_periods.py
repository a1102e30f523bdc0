"""Noise measured between the periods of a motion that repeats."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal

from sklearn_vbjfa import RigidBodyFeatures, RobotIdentifier, StateEstimator
from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.effects import Drift
from sklearn_vbjfa.model import nominal_parameters
from sklearn_vbjfa.recording import take_arrays
from sklearn_vbjfa.robot import RecordingStates
from sklearn_vbjfa.robot._periods import average_periods, period_samples
from tests.model._robots import swing

pytest.importorskip("pinocchio")


DT = 0.005
N_PERIOD = 800
PERIOD = DT * N_PERIOD
# Nominal inertias of the swing and its viscous friction [N m s/rad].
THETA = np.r_[nominal_parameters(swing())[0], 0.5]


def one_period(rng, n_period=N_PERIOD, harmonics=8):
    """States (n_period, 3) of a sum of harmonics of the period."""
    t = DT * np.arange(n_period)
    w = 2 * np.pi * np.arange(1, harmonics + 1) / (DT * n_period)
    size = rng.uniform(0.3, 1.0, harmonics) / w
    size /= size.sum()
    angle = np.outer(t, w) + rng.uniform(0, 2 * np.pi, harmonics)
    s, c = np.sin(angle), np.cos(angle)
    return np.stack([s @ size, c @ (size * w), -s @ (size * w**2)], axis=1)


def coloured(rng, n, correlation, size):
    """First-order autoregressive noise of standard deviation `size`, (n, 1)."""
    e = np.sqrt(1 - correlation**2) * rng.normal(size=n + 2000)
    return size * signal.lfilter([1], [1, -correlation], e)[2000:, None]


def record(seed, n_periods=10, correlation=0.9, encoder_noise=3e-3, torque_noise=0.05):
    """States, clean torques, positions and torques of the swing, all periods."""
    rng = np.random.default_rng(seed)
    states = np.tile(one_period(rng), (n_periods, 1))
    clean = RigidBodyFeatures(swing()).load().matrices(states) @ THETA
    q = states[:, :1] + coloured(rng, len(states), correlation, encoder_noise)
    return states, clean, q, clean + torque_noise * rng.normal(size=clean.shape)


def identify(q, tau, period=PERIOD, groups=None, sample_weight=None, **settings):
    robot = RobotIdentifier(
        swing(),
        **{
            "friction": ("viscous",),
            "dt": DT,
            "projector": None,
            "period": period,
            **settings,
        },
    )
    return robot.fit(q, tau, groups=groups, sample_weight=sample_weight)


# -- averages


@pytest.mark.parametrize("n_periods", [2, 5, 8])
def test_white_noise_of_averages(n_periods):
    rng = np.random.default_rng(0)
    n_period, sigma = 20_000, 0.3
    motion = np.sin(2 * np.pi * np.arange(n_period) / n_period)
    X = np.tile(motion, n_periods)[:, None] + sigma * rng.normal(
        size=(n_period * n_periods, 1)
    )
    y = X[:, [0, 0]] * [1.0, 2.0]
    periods = average_periods(X, y, n_period)
    n_even, n_odd = (n_periods + 1) // 2, n_periods // 2
    noise = (periods.even - motion[:, None]), (periods.odd - motion[:, None])
    # Variances of 20 000 normal numbers are known to 1 %.
    assert_allclose(noise[0].var(), sigma**2 / n_even, rtol=0.05)
    assert_allclose(noise[1].var(), sigma**2 / n_odd, rtol=0.05)
    assert abs(np.mean(noise[0] * noise[1])) < 0.05 * sigma**2 / n_odd
    # What a quarter of the squared difference says is the noise of the mean ...
    expected = (periods.mean - motion[:, None]).var()
    assert_allclose(((periods.even - periods.odd) ** 2).mean() / 4, expected, rtol=0.05)
    # ... and the torque is the mean over all periods.
    assert_allclose(periods.torque, y.reshape(n_periods, n_period, 2).mean(axis=0))
    rms = np.sqrt((periods.torque_noise**2).mean(axis=0))
    assert_allclose(rms, sigma / np.sqrt(n_periods) * np.array([1, 2]), rtol=0.05)
    assert_allclose(periods.weight, 1.0)


def test_weights_leave_samples_out():
    rng = np.random.default_rng(1)
    n_period, n_periods = 20, 4
    X = rng.normal(size=(n_period * n_periods, 1))
    y = rng.normal(size=(n_period * n_periods, 2))
    weight = np.ones((n_periods, n_period, 2))
    weight[0, 3, 0] = 0.0
    weight[::2, 5, 1] = 0.0  # all even periods
    weight[:, 7, 1] = 0.0
    y[7::n_period, 1] = 1e300  # weighs nothing
    periods = average_periods(X, y, n_period, None, weight.reshape(-1, 2))
    tau = y.reshape(n_periods, n_period, 2)
    assert_allclose(periods.torque[3, 0], tau[1:, 3, 0].mean())
    assert_allclose(periods.torque[5, 1], tau[1::2, 5, 1].mean())
    assert_allclose(periods.torque[0], tau[:, 0].mean(axis=0))
    assert_array_equal(np.isnan(periods.torque_noise).nonzero(), [[5, 7], [1, 1]])
    assert_allclose(periods.weight[[0, 3, 5, 7], [0, 0, 1, 1]], [1, 0.75, 0.5, 0])
    assert_array_equal(periods.even, X.reshape(n_periods, n_period, 1)[::2].mean(0))


def test_each_recording_has_its_own_period_and_rest():
    rng = np.random.default_rng(2)
    n_period = 32
    lengths = [3 * n_period + 7, 5 * n_period + 31]
    X, y = rng.normal(size=(2, sum(lengths), 1))
    groups = np.repeat(["b", "a"], lengths)
    both = average_periods(X, y, n_period, groups)
    assert_array_equal(both.counts, [3, 5])
    assert_array_equal(both.groups, np.repeat([0, 1], n_period))
    # More periods say more; on average a row counts as one.
    assert_allclose(both.weight[[0, -1], 0], [3 / 4, 5 / 4])
    border = lengths[0]
    for rows, part in (
        (slice(border), slice(32)),
        (slice(border, None), slice(32, 64)),
    ):
        alone = average_periods(X[rows], y[rows], n_period)
        assert_array_equal(both.even[part], alone.even)
        assert_array_equal(both.odd[part], alone.odd)
        assert_array_equal(both.torque[part], alone.torque)
    rows, parts = both.repeated(40)
    assert [part.stop - part.start for part in parts] == [112, 112]
    assert_array_equal(rows[:10], [24, 25, 26, 27, 28, 29, 30, 31, 0, 1])
    assert_array_equal(rows[parts[1]], 32 + rows[parts[0]])


# -- states


@pytest.mark.parametrize("cutoff", [15.0, None])
def test_states_know_no_ends(cutoff):
    states = one_period(np.random.default_rng(3))
    q = np.tile(states[:, :1], (4, 1))
    periods = average_periods(q, q, N_PERIOD)
    estimator = StateEstimator(DT, cutoff=cutoff).fit(q)
    even, odd = periods.states(estimator)
    assert_allclose(even, odd, rtol=0, atol=1e-9 * np.abs(states).max())
    error = np.abs(even - states).max(axis=0) / np.abs(states).max(axis=0)
    # 2 Hz and a cut-off of 15 Hz: a gain of 1 - 2e-9
    assert np.all(error < 1e-5)
    # a period that begins elsewhere has the same states
    later = average_periods(q[100:-700], q[100:-700], N_PERIOD).states(estimator)[0]
    assert_allclose(later, np.roll(even, -100, axis=0), rtol=0, atol=1e-5)


def test_filter_stands_on_each_sample_once():
    rng = np.random.default_rng(4)
    q = np.tile(rng.normal(size=(100, 1)), (2, 1))
    periods = average_periods(q, q, 100)
    lowpass = _lowpass.design(DT, 10.0, 1)
    recording = take_arrays(q, q, dt=DT, joint_names="a")
    states = RecordingStates(
        own=[np.zeros((100, 3))], halves=([np.zeros((100, 3))],) * 2
    )
    mean, states = periods.extended(recording, states, lowpass.half)
    assert [part.stop for part in mean.segments] == [100 + 2 * lowpass.half]
    assert [len(half[0]) for half in states.halves] == 2 * [mean.n_samples]
    # circular convolution: the filter sees a period without ends
    taps = np.zeros(100)
    np.add.at(taps, np.arange(-lowpass.half, lowpass.half + 1) % 100, lowpass.taps)
    expected = np.fft.ifft(np.fft.fft(q[:100, 0]) * np.fft.fft(taps)).real
    assert_allclose(lowpass(mean.tau)[:, 0], expected, atol=1e-12)


# -- identification


def test_coloured_noise_is_seen_between_periods_only():
    # Encoder noise that is correlated over ten samples: neighbours share it.
    errors, floors = [], []
    for seed in range(3):
        states, clean, q, tau = record(seed)
        for period in (None, PERIOD):
            robot = identify(q, tau, period, cutoff=10.0, state_cutoff=20.0)
            error = robot.predict(states) - clean
            errors.append(np.sqrt(np.mean(error**2)) / clean.std())
            # The residual of the true parameters in what was fitted.
            truth = robot.estimator_.statistics_
            squares = truth.yy - 2 * truth.g @ THETA
            squares += np.einsum("i,jik,k->j", THETA, truth.G, THETA)
            floors.append(robot.noise_floor_[0] / np.sqrt(squares / truth.n)[0])
    errors, floors = np.reshape(errors, (3, 2)), np.reshape(floors, (3, 2))
    # Even and odd samples see a part of the noise, or nothing can be told; even and odd
    # periods all of it: 4 s at 10 Hz are some 80 independent numbers.
    assert not np.any(floors[:, 0] >= 0.6)
    assert_allclose(floors[:, 1], 1.0, atol=0.25)
    assert np.all(errors[:, 1] < 0.1 * errors[:, 0])
    assert np.all(errors[:, 1] < 0.01)


def test_white_noise_is_seen_either_way():
    n_periods = 8
    _, _, q, tau = record(5, n_periods, correlation=0.0)
    settings = {"cutoff": 8.0, "state_cutoff": 5.0, "bodies": "free"}
    samples = identify(q, tau, None, **settings)
    periods = identify(q, tau, PERIOD, **settings)
    # The mean period has an eighth of the variance.
    for name in ("torque_noise_", "input_noise_torque_", "noise_floor_"):
        ratio = getattr(samples, name) / getattr(periods, name)
        assert_allclose(ratio, np.sqrt(n_periods), rtol=0.25)
    taps = periods.estimator_.lowpass_.taps
    expected = 0.05 * np.sqrt(taps @ taps / n_periods)
    assert_allclose(periods.torque_noise_, expected, rtol=0.25)
    # As near to the parameters, from an eighth of the rows; a little less certain of
    # how near, as few blocks of time are left to tell (Student's t).
    assert_allclose(
        periods.theta_unconstrained_, samples.theta_unconstrained_, atol=0.02
    )
    ratio = samples.theta_std_[[1, 3, 6, 10]] / periods.theta_std_[[1, 3, 6, 10]]
    assert np.all((ratio > 0.35) & (ratio < 1.0))


def test_recordings_are_periods_of_their_own():
    parts = [record(seed, n) for seed, n in ((6, 4), (7, 6))]
    q, tau = (np.concatenate([part[k] for part in parts]) for k in (2, 3))
    groups = np.repeat([0, 1], [len(part[2]) for part in parts])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot = identify(q, tau, groups=groups, cutoff=10.0, state_cutoff=20.0)
    swapped = identify(
        np.concatenate([parts[1][2], parts[0][2]]),
        np.concatenate([parts[1][3], parts[0][3]]),
        groups=np.repeat([1, 0], [len(part[2]) for part in parts[::-1]]),
        cutoff=10.0,
        state_cutoff=20.0,
    )
    assert_allclose(swapped.theta_, robot.theta_, rtol=1e-6, atol=1e-9)
    for states, clean, _, _ in parts:
        error = robot.predict(states) - clean
        assert np.sqrt(np.mean(error**2)) < 0.02 * clean.std()


def test_automatic_choices_see_the_mean_period():
    states, clean, q, tau = record(8, 10, correlation=0.0, encoder_noise=1e-3)
    robot = identify(q, tau)
    estimator = robot.state_estimator_
    # 2 Hz is the highest harmonic; the taper spreads a line over two of 0.25 Hz.
    assert 1.5 < estimator.bandwidth_[0] < 2.8
    assert_allclose(np.sqrt(estimator.noise_variance_), 1e-3 / np.sqrt(10), rtol=0.15)
    error = robot.predict(states) - clean
    assert np.sqrt(np.mean(error**2)) < 1e-3 * clean.std()
    residuals = robot.residuals(q, tau)
    assert residuals.rms()[0] > robot.noise_floor_[0]


def test_states_are_averaged_as_well():
    rng = np.random.default_rng(9)
    states, clean, _, tau = record(9)
    # none in the position, of which the torque is no linear function
    scale = [0.0, 0.3, 0.3] * states.std(axis=0)
    X = states + np.hstack([coloured(rng, len(states), 0.9, s) for s in scale])
    exact = identify(X, tau, None)
    robot = identify(X, tau)
    assert robot.state_estimator_ is None
    assert_array_equal(exact.input_noise_torque_, 0.0)
    # Nothing is filtered: damping and inertia times the noise of the mean of ten.
    expected = np.sqrt(np.sum((scale[1:] * THETA[[10, 6]]) ** 2) / 10)
    assert_allclose(robot.input_noise_torque_, expected, rtol=0.2)
    error = [np.sqrt(np.mean((r.predict(states) - clean) ** 2)) for r in (exact, robot)]
    assert error[1] < 0.8 * error[0]


def test_noise_may_be_left_alone():
    _, _, q, tau = record(10)
    robot = identify(q, tau, input_noise=None)
    assert_array_equal(robot.input_noise_torque_, 0.0)
    assert_array_equal(robot.noise_floor_, robot.torque_noise_)
    with pytest.raises(ValueError, match="input_noise must be 'auto'"):
        identify(q, tau, input_noise="some")


def test_sample_weights_reach_the_means():
    _, _, q, tau = record(11, 6)
    weight = np.ones(len(q))
    broken = slice(N_PERIOD + 100, N_PERIOD + 300)
    weight[broken] = 0.0
    wrong = tau.copy()
    wrong[broken] += 50.0
    robot = identify(q, wrong, sample_weight=weight, cutoff=10.0, state_cutoff=20.0)
    without = identify(q, tau, sample_weight=weight, cutoff=10.0, state_cutoff=20.0)
    assert_allclose(robot.theta_, without.theta_, rtol=1e-9)


# -- bad input


@pytest.mark.parametrize("period", ["long", np.nan, np.inf, 0.0, -1.0, [1.0, 2.0]])
def test_a_period_is_a_positive_time(period):
    with pytest.raises(ValueError, match="period must be the time in seconds"):
        period_samples(period, DT)


def test_what_is_no_whole_number_of_samples():
    q = np.zeros((1000, 1))
    message = r"whole number of samples; got 100\.3.*slip of 2\.4 samples over 9 per"
    with pytest.raises(ValueError, match=message):
        average_periods(q, q, period_samples(100.3 * DT, DT))
    # rounding of dt is none
    assert average_periods(q, q, period_samples(0.5, DT * (1 + 1e-9))).counts == [10]
    with pytest.raises(ValueError, match=r"0\.05 s are 10 samples .* at least 16"):
        period_samples(0.05, DT)
    with pytest.raises(ValueError, match=r"dt must be the sample period"):
        period_samples(1.0, None)


def test_too_few_periods():
    _, _, q, tau = record(12, 4)
    with pytest.raises(
        ValueError, match=r"At least 2 whole periods.*0 has 1599 sam.*2"
    ):
        identify(q[:1599], tau[:1599])
    groups = np.repeat([0, 1], [1700, 1500])
    with pytest.raises(ValueError, match=r"from row 1700 has 1500 samples, 1\.88 per"):
        identify(q, tau, groups=groups)
    identify(q[:1600], tau[:1600])


def test_motion_that_does_not_repeat_is_named():
    states, _, q, tau = record(13, 6, correlation=0.97)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        identify(q, tau)  # coloured noise is no other motion
    message = r"motion of swing \(0\.\d+ between periods, 0\.\d+ within, white noise .*"
    with pytest.warns(UserWarning, match=message + "Check period"):
        identify(q, tau, PERIOD - 2 * DT)
    drifting = states[:, :1] + np.linspace(0, 0.2, len(q))[:, None]
    noisy = drifting + 1e-4 * np.random.default_rng(0).normal(size=q.shape)
    with pytest.warns(UserWarning, match=r"does not repeat to within its noise"):
        identify(noisy, tau)


def test_effects_that_change_with_time_need_all_of_it():
    _, _, q, tau = record(14, 2)
    with pytest.raises(ValueError, match=r"drift change\(s\) with time.*period=None"):
        identify(q, tau, effects=(Drift(),))
