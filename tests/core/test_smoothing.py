"""The penalised spline: gain, units and the chosen cut-off."""

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
    # Derivatives of a quintic spline are accurate for eight samples in a period, and
    # wrong by 4 % for three.
    if dt * frequency < 0.15:
        assert_allclose(v / w, expected, rtol=2e-3)
        assert_allclose(-a / w**2, expected, rtol=4e-3)
    elif share == 1.0:
        assert_allclose(-a / w**2, expected, rtol=0.06)


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
    spectra = _smoothing.acceleration_spectra([x[:, None]], dt)
    return [float(one[0]) for one in _smoothing.choose_cutoff(*spectra, dt)]


def test_steps_are_no_motion():
    position, _ = make_motion(3, 0.002, highest=0.5)
    for x in (np.repeat(position[::4], 4), 0.05 * np.round(position / 0.05)):
        assert choose(x, 0.002)[0] < 5.0


@pytest.mark.parametrize("dt", [0.01, 0.002])
@pytest.mark.parametrize("noise", [1e-4, 3e-3])
def test_chosen_cutoff_is_close_to_an_oracle(noise, dt):
    position, acceleration = make_motion(3, dt)
    rng = np.random.default_rng(103)
    x = position + noise * rng.normal(size=position.size)
    # The two seconds at each end have additional errors, which the choice neglects.
    inner = slice(len(x) // 10, -len(x) // 10)

    def error(cutoff):
        difference = smooth(x, dt, cutoff)[2] - acceleration
        return np.sqrt(np.mean(difference[inner] ** 2))

    chosen, _ = choose(x, dt)
    candidates = np.geomspace(1.0, 1 / (3 * dt), 20)
    errors = np.array([error(cutoff) for cutoff in candidates])
    oracle = candidates[np.argmin(errors)]
    assert error(chosen) < 1.25 * errors.min()
    assert 1 / 1.5 < chosen / oracle < 1.5
    # The choice matters: at twice and half of it the error is larger.
    assert min(error(2 * chosen), error(chosen / 2)) > 1.5 * errors.min()
