"""Resampling against functions with a known value everywhere."""

import numpy as np

from sklearn_vbjfa.recording import interpolate


def make_stamps(n_samples, dt=0.01, jitter=0.3, seed=0):
    rng = np.random.default_rng(seed)
    return dt * (np.arange(n_samples) + rng.uniform(-jitter, jitter, n_samples))


def test_cubic_reproduces_a_cubic_and_linear_a_line():
    t = make_stamps(200)
    channels = {
        "q": np.column_stack([t**3 - t, 2 * t**2, np.full(t.size, 0.1038)]),
        "tau": np.column_stack([3 * t, 1 - t]),
        "temperature": 20 + t,
    }
    grid, part = interpolate(t - t[0], channels, 0.01)
    np.testing.assert_allclose(np.diff(grid), 0.01)
    assert grid[0] == 0
    assert 0 <= (t[-1] - t[0]) - grid[-1] < 0.01
    x = grid + t[0]
    np.testing.assert_allclose(part["q"][:, :2], np.c_[x**3 - x, 2 * x**2])
    # A constant position stays constant to the last bit.
    assert (part["q"][:, 2] == 0.1038).all()
    np.testing.assert_allclose(part["tau"], np.column_stack([3 * x, 1 - x]))
    np.testing.assert_allclose(part["temperature"], 20 + x)
