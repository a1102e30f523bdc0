"""Correlation times of residuals."""

import numpy as np
import pytest
from scipy.signal import lfilter

from sklearn_vbjfa._core._autocorrelation import (
    _integrated,
    correlation_time,
    memory_time,
)


def stationary(keep, n, seed=0):
    """Simulate a stationary AR(1) process of unit variance."""
    rng = np.random.default_rng(seed)
    steps = np.sqrt(1 - keep**2) * rng.normal(size=n)
    return lfilter([1.0], [1.0, -keep], steps, zi=[keep * rng.normal()])[0]


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_correlation_time_of_an_autoregression(rho):
    """Two-sided sum of rho^k: (1 + rho) / (1 - rho) steps."""
    x = stationary(rho, 20000)[:, None]
    time = correlation_time(x, np.ones_like(x), 0.1, np.array([0]))
    assert time == pytest.approx(0.1 * (1 + rho) / (1 - rho), rel=0.25)


def test_correlation_time_ignores_jumps_between_recordings():
    lengths = np.full(30, 60)
    x = np.concatenate([stationary(0.8, 60, seed) for seed in range(30)])[:, None]
    starts = np.r_[0, np.cumsum(lengths)[:-1]]
    separate = correlation_time(x, np.ones_like(x), 1.0, starts)
    assert separate == pytest.approx(1.8 / 0.2, rel=0.25)
    jumping = x + np.repeat(np.tile([40.0, -40.0], 15), lengths)[:, None]
    within = correlation_time(jumping, np.ones_like(x), 1.0, starts)
    across = correlation_time(jumping, np.ones_like(x), 1.0, np.array([0]))
    assert across < 0.5 * within


@pytest.mark.parametrize("keep", [0.0, 0.6, 0.95])
def test_memory_time_of_an_autoregression(keep):
    time = memory_time(stationary(keep, 4000), np.ones(4000, bool), [0], 0.1)
    assert time == pytest.approx(0.1 * (1 + keep) / (1 - keep), rel=0.3)


def test_correlation_time_is_not_underestimated_in_short_recordings():
    """Correlation time 10 s in 30 s of data without mean: the median is above 6 s."""

    def median(seconds):
        times = []
        for seed in range(60):
            x = stationary(np.exp(-0.1 / seconds), 300, seed)[:, None]
            times.append(correlation_time(x - x.mean(), np.ones_like(x), 0.1, [0]))
        return np.median(times)

    assert median(5.0) > 6.0
    # A tenth of this correlation time is estimated without bias.
    assert median(0.5) == pytest.approx(1.0, rel=0.25)


def test_memory_time_of_a_random_walk_is_long():
    walk = np.cumsum(np.random.default_rng(1).normal(size=300))
    assert memory_time(walk, np.ones(300, bool), [0], 0.1) > 30.0


def test_memory_time_does_not_depend_on_the_order_of_recordings():
    parts = [stationary(0.9, 300, seed) for seed in range(4)]
    starts, times = np.arange(0, 1200, 300), []
    for order in ([0, 1, 2, 3], [2, 0, 3, 1]):
        x = np.concatenate([parts[k] for k in order])
        times.append(memory_time(x, np.ones(1200, bool), starts, 0.1))
    assert times[0] == pytest.approx(times[1], rel=1e-9)


def test_memory_time_ignores_the_low_pass_filter():
    rng = np.random.default_rng(0)
    x = np.convolve(rng.normal(size=4003), np.ones(4) / 2, mode="valid")
    assert memory_time(x, np.ones(4000, bool), [0], 0.025, stride=4) < 0.2


@pytest.mark.parametrize(
    "phi", [[1.0], [0.0, 1.0], [0.0, -1.0], [1.7, -0.7], [2.0, -1.0]]
)
def test_unit_roots_are_detected_despite_rounding(phi):
    for shrunk in (0.0, 1.2e-16, 1e-15, 1e-12):
        assert np.isinf(_integrated(np.array(phi) * (1.0 - shrunk)))
