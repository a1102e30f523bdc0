"""The penalised spline: what it keeps, what it damps, and the cut-off it chooses."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa._core import _smoothing


def smooth(x, dt, cutoff):
    """Smooth samples (n,) and differentiate them twice, (3, n)."""
    spline = _smoothing.fit(x, dt, cutoff)
    return np.stack([spline(0, x.size, order) for order in range(3)])


# (dt, cut-off) with one knot for each sample, and with fewer knots than samples.
RATES = [(0.01, 33.0), (0.01, 5.0), (0.002, 100.0), (0.002, 8.0)]


def make_motion(seed, dt, duration=20.0, highest=2.0):
    """Random sum of sines up to `highest` [Hz]: positions and accelerations."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration / dt)) * dt
    w = 2 * np.pi * rng.uniform(0.1, highest, 8)
    size, phase = rng.normal(size=8) / w, rng.uniform(0, 2 * np.pi, 8)
    angle = np.outer(t, w) + phase
    return np.sin(angle) @ size, -np.sin(angle) @ (size * w**2)


@pytest.mark.parametrize("n", [20, 50, 501])
@pytest.mark.parametrize(("dt", "cutoff"), RATES)
def test_constant_acceleration_is_kept_to_the_ends(dt, cutoff, n):
    # The null space of the penalty. The unit is the whole recording.
    length = (n - 1) * dt
    u = np.linspace(0.0, 1.0, n)
    x, v, a = smoothed = smooth(0.5 - 2.0 * u + 3.0 * u**2, dt, cutoff)
    assert smoothed.shape == (3, n)
    assert_allclose(x, 0.5 - 2.0 * u + 3.0 * u**2, atol=1e-9)
    assert_allclose(v * length, -2.0 + 6.0 * u, atol=1e-7)
    # Rounding of the samples, 1e-16, times the square of n at the most.
    assert_allclose(a * length**2, 6.0, atol=1e-6)


@pytest.mark.parametrize("degree", [1, 5])
def test_interpolation_keeps_polynomials_of_its_degree(degree):
    dt, n = 0.01, 201
    u = np.arange(n) * dt / 2.0
    p = np.polynomial.Polynomial(np.linspace(1.0, -2.0, degree + 1))
    x, v, a = smooth(p(u), dt, np.inf)
    # The penalty that fixes the ends costs positions nothing; derivatives at the ends
    # it does cost, less and less over a dozen samples.
    assert_allclose(x, p(u), atol=1e-12)
    inner = slice(20, -20)
    assert_allclose(v[inner] * 2.0, p.deriv()(u)[inner], atol=1e-6)
    assert_allclose(a[inner] * 4.0, p.deriv(2)(u)[inner], atol=2e-3)
    scale = np.abs(p.deriv(2)(u)).max()
    assert_allclose(a * 4.0, p.deriv(2)(u), atol=0.03 * scale + 1e-3)


@pytest.mark.parametrize(("dt", "cutoff"), RATES)
@pytest.mark.parametrize("share", [0.1, 0.3, 1.0, 1.3])
def test_gain_in_mid_recording(dt, cutoff, share):
    n = 2 * int(20 / cutoff / dt) + 1
    t = (np.arange(n) - n // 2) * dt
    frequency = share * cutoff
    w = 2 * np.pi * frequency
    expected = _smoothing.gain(np.array([frequency]), dt, cutoff)[0]
    x, _, a = smooth(np.cos(w * t), dt, cutoff)[:, n // 2]
    _, v, _ = smooth(np.sin(w * t), dt, cutoff)[:, n // 2]
    if share == 1.0:
        assert_allclose(expected, 0.5, rtol=1e-12)
    # The ends are twenty periods of the cut-off away, and knots lie between samples.
    assert_allclose(x, expected, rtol=1e-4)
    # A quintic spline's own derivatives are right for eight samples in a period,
    # 4 % off for three.
    if dt * frequency < 0.15:
        assert_allclose(v / w, expected, rtol=2e-3)
        assert_allclose(-a / w**2, expected, rtol=4e-3)
    elif share == 1.0:
        assert_allclose(-a / w**2, expected, rtol=0.06)


@pytest.mark.parametrize(("dt", "frequency"), [(0.01, 1.0), (0.002, 3.0)])
def test_derivatives_of_a_sine(dt, frequency):
    w = 2 * np.pi * frequency
    t = np.arange(int(6 / frequency / dt)) * dt
    x, v, a = smooth(np.sin(w * t), dt, 10 * frequency)
    inner = slice(len(t) // 5, -len(t) // 5)
    # Ten times the frequency leaves 1e-6 of the gain; six knots per period of the
    # cut-off, sixty of the sine, leave less of the spline.
    assert_allclose(x[inner], np.sin(w * t)[inner], atol=1e-5)
    assert_allclose(v[inner] / w, np.cos(w * t)[inner], atol=1e-5)
    assert_allclose(a[inner] / w**2, -np.sin(w * t)[inner], atol=1e-5)
    # At the ends the motion goes on by the spline's own polynomial: no transient.
    # Its jerk is free there, which costs some percent in the last knots.
    assert_allclose(v / w, np.cos(w * t), atol=0.02)
    assert_allclose(a / w**2, -np.sin(w * t), atol=0.3)


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_units(unit):
    dt = 0.01
    x, _ = make_motion(1, dt)
    x = x + 1e-3 * np.random.default_rng(1).normal(size=x.size)
    plain = smooth(x, dt, 5.0)
    scaled = smooth(unit * x, dt, 5.0)
    assert_allclose(scaled, unit * plain, atol=1e-9 * unit * np.abs(plain).max())
    # Another unit of time: derivatives in it, and the same chosen cut-off.
    slow = smooth(x, dt / unit, 5.0 * unit)
    powers = np.array([[1.0], [unit], [unit**2]])
    for k in range(3):
        scale = np.abs(plain[k]).max()
        assert_allclose((slow / powers)[k], plain[k], atol=1e-9 * scale)
    chosen, variance = choose(x, dt)
    again, scaled_variance = choose(unit * x, dt)
    assert_allclose(again, chosen, rtol=1e-12)
    assert_allclose(scaled_variance, unit**2 * variance, rtol=1e-9)
    again, same_variance = choose(x, dt / unit)
    assert_allclose(again, unit * chosen, rtol=1e-9)
    assert_allclose(same_variance, variance, rtol=1e-9)


def choose(x, dt):
    return _smoothing.choose_cutoff(*_smoothing.acceleration_spectra([x], dt), dt)


@pytest.mark.parametrize("dt", [0.01, 0.002])
@pytest.mark.parametrize("noise", [1e-4, 1e-3])
@pytest.mark.parametrize("n_segments", [1, 4])
def test_white_noise_variance_under_a_motion(noise, dt, n_segments):
    rng = np.random.default_rng(2)
    segments = []
    for k in range(n_segments):
        x, _ = make_motion(k, dt)
        vibration = 5 * noise * np.sin(0.8 * np.pi * np.arange(x.size))
        segments.append(x + vibration + noise * rng.normal(size=x.size))
    spectra = _smoothing.acceleration_spectra(segments, dt)
    variance = _smoothing.white_noise_variance(*spectra)
    # Two deviations of one recording of 20 s; a line in the upper half, with thirteen
    # times the power of the noise, does not count.
    assert_allclose(variance / noise**2, 1.0, atol=0.16)


@pytest.mark.parametrize("dt", [0.01, 0.002])
@pytest.mark.parametrize("noise", [1e-4, 3e-3])
@pytest.mark.parametrize("seed", [3])
def test_chosen_cutoff_is_nearly_that_of_an_oracle(noise, dt, seed):
    position, acceleration = make_motion(seed, dt)
    rng = np.random.default_rng(100 + seed)
    x = position + noise * rng.normal(size=position.size)
    # The two seconds at each end have errors of their own, which no choice knows of.
    inner = slice(len(x) // 10, -len(x) // 10)

    def error(cutoff):
        wrong = smooth(x, dt, cutoff)[2] - acceleration
        return np.sqrt(np.mean(wrong[inner] ** 2))

    chosen, _ = choose(x, dt)
    candidates = np.geomspace(1.0, 1 / (3 * dt), 20)
    errors = np.array([error(cutoff) for cutoff in candidates])
    oracle = candidates[np.argmin(errors)]
    assert error(chosen) < 1.25 * errors.min()
    assert 1 / 1.5 < chosen / oracle < 1.5
    # The choice matters: at twice and half of it the error is larger.
    assert min(error(2 * chosen), error(chosen / 2)) > 1.5 * errors.min()


def test_bandwidth_of_the_velocity():
    dt = 0.002
    t = np.arange(20_000) * dt
    x = np.sin(2 * np.pi * t) + 0.2 * np.sin(2 * np.pi * 3.0 * t + 1.0)
    noisy = x + 1e-4 * np.random.default_rng(4).normal(size=t.size)
    frequency, power, noise_gain = _smoothing.acceleration_spectra([noisy], dt)
    variance = _smoothing.white_noise_variance(frequency, power, noise_gain)
    cutoff, _ = choose(noisy, dt)
    args = frequency, power, noise_gain, variance
    # The velocities are 1 and 0.6: the slow sine has 74 % of the power.
    width = _smoothing.velocity_bandwidth
    assert_allclose(width(*args, cutoff), 3.0, atol=0.1)
    assert_allclose(width(*args, cutoff, share=0.7), 1.0, atol=0.1)
    # What lies beyond twice the cut-off is not asked for.
    assert_allclose(width(*args, 1.2), 1.0, atol=0.1)
    # Nothing stands out of a noise a million times larger: the cut-off itself.
    assert width(frequency, power, noise_gain, 1e12 * variance, cutoff) == cutoff


def test_too_short_a_recording_for_a_choice():
    with pytest.raises(ValueError, match=r"at least 16 samples, got 15; give cutoff"):
        _smoothing.acceleration_spectra([np.arange(15.0)], 0.01)
    with pytest.raises(ValueError, match=r"got 0"):
        _smoothing.acceleration_spectra([], 0.01)
