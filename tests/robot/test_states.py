"""State estimation from positions: exactness, phase, noise, separate recordings."""

import numpy as np
import pytest

from sklearn_vbjfa import StateEstimator

DT = 0.005


def wave(t, frequency, phase=0.3):
    """Return a sine with its first two derivatives, (n, 3)."""
    w = 2 * np.pi * frequency
    s, c = np.sin(w * t + phase), np.cos(w * t + phase)
    return np.column_stack([s, w * c, -(w**2) * s])


def noisy_wave(n, noise, seed=0):
    """Return slow sines of several joints, with white noise and without."""
    t = np.arange(n) * DT
    joints = [wave(t, f, f) for f in np.linspace(0.2, 0.6, len(noise))]
    truth = np.stack(joints, axis=2).reshape(n, -1)  # [q | v | a]
    rng = np.random.default_rng(seed)
    q = truth[:, : len(noise)] + noise * rng.normal(size=(n, len(noise)))
    return q, truth


def test_interpolation_keeps_samples_and_quintics():
    t = np.arange(400) * DT
    polynomial = np.polynomial.Polynomial([1, -2, 3, 1, -1, 0.5])
    states = StateEstimator(DT, cutoff=None).fit_transform(polynomial(t)[:, None])
    np.testing.assert_allclose(states[:, 0], polynomial(t), atol=1e-12)
    inside = slice(40, -40)
    for k in (1, 2):
        np.testing.assert_allclose(
            states[inside, k], polynomial.deriv(k)(t[inside]), atol=1e-7
        )


@pytest.mark.parametrize(("frequency", "cutoff"), [(0.5, 5.0), (3.0, 5.0), (5.0, 5.0)])
def test_sines_pass_with_the_stated_gain_and_no_phase(frequency, cutoff):
    t = np.arange(4000) * DT
    truth = wave(t, frequency)
    states = StateEstimator(DT, cutoff=cutoff).fit_transform(truth[:, :1])
    inside = slice(400, -400)
    w = 2 * np.pi * frequency
    basis = np.column_stack([np.sin(w * t + 0.3), np.cos(w * t + 0.3)])[inside]
    amplitude = np.linalg.lstsq(basis, states[inside], rcond=None)[0]
    gain = 1 / (1 + (frequency / cutoff) ** 10)
    # 1e-4: the knots, ten per period of the cut-off, damp a little themselves. The
    # penalty is one on differences, not derivatives, which is worth some 6 % of it.
    atol = 1e-4 + 0.1 * gain * (1 - gain)
    np.testing.assert_allclose(
        amplitude / [1, w, w**2], [[gain, 0, -gain], [0, gain, 0]], atol=atol
    )
    # No quadrature component, so no lag.
    np.testing.assert_allclose(amplitude[[1, 0, 1], range(3)], 0, atol=1e-9 * w**2)


def test_recordings_are_smoothed_separately():
    q, _ = noisy_wave(1200, np.array([1e-3, 1e-4]))
    groups = np.repeat(["a", "b", "c"], [500, 300, 400])
    jumped = q + np.repeat([0.0, 1e3, -50.0], [500, 300, 400])[:, None]
    estimator = StateEstimator(DT, cutoff=6.0).fit(jumped, groups=groups)
    states = estimator.transform(jumped, groups=groups)
    for label in "abc":
        alone = estimator.transform(jumped[groups == label])
        np.testing.assert_array_equal(states[groups == label], alone)


def test_noise_variance():
    noise = np.array([1e-4, 1e-3, 1e-2])
    q, _ = noisy_wave(20_000, noise)
    estimator = StateEstimator(DT).fit(q)
    # A median of 8000 tapered ordinates: its relative deviation is about 2.5 %.
    np.testing.assert_allclose(estimator.noise_variance_, noise**2, rtol=0.12)
    np.testing.assert_allclose(estimator.rest_variance_, noise**2, rtol=0.12)
    # The second half vibrates: the tenth is a fifth of the quiet blocks.
    q[10_000:] += 1e-3 * np.random.default_rng(1).normal(size=(10_000, 3))
    quiet = StateEstimator(DT).fit(q).rest_variance_
    np.testing.assert_allclose(quiet[0], noise[0] ** 2, rtol=0.3)


def test_bandwidth_is_that_of_the_motion():
    t = np.arange(8000) * DT
    q = wave(t, 0.2)[:, :1] + 1e-4 * np.random.default_rng(1).normal(size=(8000, 1))
    q = np.hstack([q, wave(t, 2.0)[:, :1], np.full((8000, 1), 0.7)])
    estimator = StateEstimator(DT).fit(q)
    # The taper widens a line by two bins of 1 / 40 Hz.
    np.testing.assert_allclose(estimator.bandwidth_[:2], [0.2, 2.0], atol=0.06)
    assert estimator.bandwidth_[2] == 0.0


def test_resting_joint_has_zero_velocity():
    t = np.arange(300) * DT
    q = np.column_stack([np.sin(t), np.full(300, 0.37)])
    estimator = StateEstimator(DT).fit(q)
    states = estimator.transform(q)
    assert estimator.cutoff_[1] == np.inf
    assert estimator.noise_variance_[1] == 0.0
    np.testing.assert_allclose(
        states[:, [1, 3, 5]], [[0.37, 0.0, 0.0]] * 300, atol=1e-15
    )


def test_half_sample_estimates_have_independent_noise():
    noise = np.array([1e-3])
    q, truth = noisy_wave(40_000, noise)
    estimator = StateEstimator(DT, cutoff=5.0).fit(q)
    inside = slice(400, -400)
    errors = [(h[:] - truth)[inside] for h in estimator.smooth_halves(q, 0)]
    whole = (estimator.transform(q) - truth)[inside]
    for k in range(3):
        first, second = errors[0][:, k], errors[1][:, k]
        # About 2 * 5 Hz * 200 s independent values: a standard error of 0.022.
        assert abs(np.corrcoef(first, second)[0, 1]) < 0.1
        # Half the samples double the variance; 0.1 is three standard errors.
        for half in (first, second):
            assert half.var() / whole[:, k].var() == pytest.approx(2.0, rel=0.2)
    # The estimate from all samples shares its noise with each half.
    assert np.corrcoef(errors[0][:, 1], whole[:, 1])[0, 1] > 0.5


def test_velocity_noise():
    q, truth = noisy_wave(6000, noise=np.array([1e-4, 1e-3]))
    estimator = StateEstimator(DT, cutoff=[20.0, None]).fit(q)
    error = (estimator.transform(q) - truth)[100:-100, 2:4]
    # Without a cut-off, the noise is nearly that of the ideal derivative.
    noise_std = estimator.noise(1)
    np.testing.assert_allclose(noise_std[0], error[:, 0].std(), rtol=0.1)
    np.testing.assert_allclose(noise_std[1], 1e-3 * np.pi / np.sqrt(3) / DT, rtol=0.05)


@pytest.mark.parametrize(
    ("cutoff", "message"),
    [
        (100.0, r"below the Nyquist frequency 100 Hz of dt=0\.005 s; got 100 Hz"),
        (-1.0, "positive frequency in Hz, 'auto', or None.*got -1"),
        ("high", "cutoff must be 'auto', a frequency in Hz, or None; got 'high'"),
        ([1.0, 2.0, 3.0], r"one for each of the 2 joints; got .* shape \(3,\)"),
    ],
)
def test_refuses_a_wrong_cutoff(cutoff, message):
    with pytest.raises(ValueError, match=message):
        StateEstimator(DT, cutoff=cutoff).fit(np.zeros((30, 2)))


def test_refuses_wrong_labels_and_values():
    q = np.zeros((30, 1))
    with pytest.raises(ValueError, match=r"one label per row, shape \(30,\); got .*29"):
        StateEstimator(DT, cutoff=5.0).fit(q, groups=np.zeros(29))
    for bad in (np.nan, np.inf):
        q[3] = bad
        with pytest.raises(ValueError, match=r"NaN|infinity"):
            StateEstimator(DT).fit(q)


def jittered_wave(dt=0.001, duration=20.0, period=0.4):
    """Return slow motion sampled at jittered times and interpolated to a grid."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, duration, dt)
    jittered = t + 0.3 * dt * rng.normal(size=t.size)
    samples = np.sin(2 * np.pi * period * jittered)
    smooth = np.convolve(samples, [0.25, 0.5, 0.25], mode="same")
    return t, smooth + 1e-9 * rng.normal(size=t.size)


def test_coloured_noise_is_not_motion():
    """The noise is flat and a decade above the motion."""
    t, q = jittered_wave()
    estimator = StateEstimator(dt=0.001).fit(q[:, None])
    assert estimator.bandwidth_[0] < 1.0
    # Two spectral lines are motion, whatever lies between.
    quiet = np.sin(2 * np.pi * 0.4 * t) + 1e-9 * np.random.default_rng(1).normal(
        size=t.size
    )
    lines = 3e-3 * np.sin(2 * np.pi * 31.0 * t) + 2e-3 * np.sin(2 * np.pi * 43.0 * t)
    shaking = StateEstimator(dt=0.001).fit((quiet + lines)[:, None])
    assert shaking.bandwidth_[0] > 40.0
