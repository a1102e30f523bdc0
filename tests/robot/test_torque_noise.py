"""Estimated noise of torque channels from residuals of known noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.equations import (
    _torque_noise,
    filtered_noise,
    held_rows,
    noise_facts,
)

DT, CUTOFF = 0.005, 4.0
N = 12_000
T = DT * np.arange(N)
# Two joints that reverse at 0.4 and 0.7 Hz.
Q = np.column_stack([np.sin(2 * np.pi * 0.4 * T), np.cos(2 * np.pi * 0.7 * T)])
V = np.gradient(Q, DT, axis=0)
STATES = np.hstack([Q, V, np.gradient(V, DT, axis=0)])


def coloured(rho, rng, n=N):
    x = signal.lfilter([1.0], [1.0, -rho], rng.normal(size=(n + 2000, 2)), axis=0)
    return x[2000:] * np.sqrt(1 - rho**2)


def sensor_noise(rng, n=N):
    b, a = signal.butter(2, 2 * 20.0 * DT)
    return signal.lfilter(b, a, rng.normal(size=(n + 2000, 2)), axis=0)[2000:]


def held(rng, n=N):
    return np.repeat(rng.normal(size=(n // 4 + 1, 2)), 4, axis=0)[:n]


NOISES = {
    "white": lambda rng, n=N: rng.normal(size=(n, 2)),
    "AR(0.5)": lambda rng, n=N: coloured(0.5, rng, n),
    "AR(0.8)": lambda rng, n=N: coloured(0.8, rng, n),
    "sensor": sensor_noise,
    "held": held,
}


def noise_of(residual, torque=None, states=STATES, dt=DT, cutoff=CUTOFF):
    torque = residual if torque is None else torque
    return filtered_noise(
        [noise_facts(residual, torque, states, dt, cutoff)], dt, cutoff
    )


def truth(noise):
    taps = _lowpass.design(DT, CUTOFF).taps
    long = NOISES[noise](np.random.default_rng(99), 400_000)[:, 0]
    return np.convolve(long, taps, mode="valid").std()


@pytest.mark.parametrize("noise", NOISES)
def test_coloured_noise_is_estimated(noise):
    estimate = noise_of(NOISES[noise](np.random.default_rng(0)))
    np.testing.assert_allclose(estimate, truth(noise), rtol=0.15)


@pytest.mark.parametrize("noise", ["white", "AR(0.5)", "sensor"])
def test_unmodelled_friction_is_not_noise(noise):
    rng = np.random.default_rng(1)
    clean = noise_of(NOISES[noise](rng))
    jumps = noise_of(NOISES[noise](rng) + 5 * np.sign(V))
    np.testing.assert_allclose(jumps, clean, rtol=0.2)


def test_slow_model_errors_are_not_noise():
    rng = np.random.default_rng(2)
    noise = NOISES["white"](rng)
    estimate = noise_of(noise + 3 * np.sin(8 * Q) * (1 + 0.3 * V))
    finite = np.isfinite(estimate)
    np.testing.assert_allclose(estimate[finite], truth("white"), rtol=0.25)


def test_quantisation_noise_is_included():
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(N, 2))
    slow = 20 * Q
    rounded = 2.0 * np.round((slow + noise) / 2.0)
    estimate = noise_of(rounded - slow, rounded)
    expected = truth("white") * np.sqrt(1 + 2.0**2 / 12)
    np.testing.assert_allclose(estimate, expected, rtol=0.15)
    # Without noise, its spectrum depends on the motion.
    rounded = 2.0 * np.round(slow / 2.0)
    facts = noise_facts(rounded - slow, rounded, STATES, DT, CUTOFF)
    taps = _lowpass.design(DT, CUTOFF).taps[:, None]
    left = signal.convolve(rounded - slow, taps, mode="valid").std(axis=0)
    np.testing.assert_allclose(filtered_noise([facts], DT, CUTOFF, left), left, 0.05)


def test_random_walk_noise_is_not_underestimated():
    """A random walk has no finite level at the frequencies of the motion."""
    rng = np.random.default_rng(4)
    walk = np.cumsum(rng.normal(size=(N, 2)), axis=0)
    walk -= walk.mean(axis=0)
    white = np.diff(walk, axis=0).std() * truth("white")
    estimate = noise_of(walk)
    assert np.all(np.isnan(estimate) | (estimate > 3 * white))


def test_noise_does_not_exceed_the_residual():
    """Stick-slip friction hides the noise within the band."""
    noise = NOISES["white"](np.random.default_rng(6))
    facts = noise_facts(noise, noise, STATES, DT, CUTOFF)
    steps = np.linspace(1.0, 1.3, facts.scales.shape[1]) ** 2
    facts = replace(facts, scales=steps * facts.scales, gap=50 * facts.gap)
    white = truth("white")
    # nan stands for a joint without weighted rows.
    for residual in (np.inf, 10 * white, np.nan):
        assert np.isnan(filtered_noise([facts], DT, CUTOFF, residual)).all()
    for residual in (1.02 * white, 1.2 * white):
        estimate = filtered_noise([facts], DT, CUTOFF, residual)
        np.testing.assert_allclose(estimate, white, rtol=0.2)
        assert (estimate <= residual).all()
    # The residual is uncertain, and low rates allow few strides.
    few = np.where(np.arange(steps.size) < 3, facts.scales / steps, np.nan)
    facts = replace(facts, scales=few)
    assert np.isfinite(filtered_noise([facts], DT, CUTOFF, 0.85 * white)).all()


def test_noise_is_unknown_without_a_stopband():
    noise = np.random.default_rng(5).normal(size=(N, 2))
    assert np.isnan(noise_of(noise, cutoff=60.0)).all()
    taps = _lowpass.design(DT, 50.0).taps
    np.testing.assert_allclose(noise_of(noise, cutoff=50.0), np.sqrt(taps @ taps), 0.1)
    assert not _torque_noise.stopband_exists(None, 1.0)
    assert not _torque_noise.stopband_exists(DT, np.inf)


@pytest.mark.parametrize("count", [1, 3, 10])
def test_held_rows(count):
    x = np.repeat(np.random.default_rng(9).normal(size=2000), count)
    assert held_rows(x) == count
