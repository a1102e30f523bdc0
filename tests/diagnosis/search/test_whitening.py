"""The residual's memory, and rows from which it is taken out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import lfilter

from sklearn_vbjfa.diagnosis.search._blocks import (
    Whitening,
    correlation_time,
    fit_memory,
)


def autoregression(keep, n, seed=0):
    rng = np.random.default_rng(seed)
    steps = np.sqrt(1 - keep**2) * rng.normal(size=n)
    return lfilter([1.0], [1.0, -keep], steps, zi=[keep * rng.normal()])[0]


def whitened(x, root=None, starts=(0,), step=0.1, **given):
    """Whitening of one joint's rows and what it makes of them."""
    root = np.ones((x.size, 1)) if root is None else root
    white = Whitening(x[None] * root.T, root, starts, step, **given)
    return white, white(x[None] * root.T, [0])[0]


def lagged(x, lag=1):
    return np.corrcoef(x[lag:], x[:-lag])[0, 1]


@pytest.mark.parametrize("keep", [0.0, 0.6, 0.95])
def test_what_is_left_is_white(keep):
    x = autoregression(keep, 4000)
    white, left = whitened(x)
    # Three standard errors of an autocorrelation.
    for lag in (1, 2, 5, 20):
        assert abs(lagged(left, lag)) < 3 / np.sqrt(x.size)
    assert left.std() == pytest.approx(np.sqrt(1 - keep**2), rel=0.05)
    # Sum of keep^k over both sides.
    expected = 0.1 * (1 + keep) / (1 - keep)
    assert white.memory[0].time == pytest.approx(expected, rel=0.3)


def test_slow_residuals_of_short_recordings_are_not_read_too_short():
    """Correlated for 10 s in 30 s, and a mean was taken out: half are above 6 s."""
    times = []
    for seed in range(60):
        x = autoregression(np.exp(-0.1 / 5.0), 300, seed)
        x = (x - x.mean())[:, None]
        times.append(correlation_time(x, np.ones_like(x), 0.1, [0]))
    assert 6.0 < np.median(times)
    # Those of a tenth that time are read as such.
    fast = []
    for seed in range(60):
        x = autoregression(np.exp(-0.1 / 0.5), 300, seed)
        x = (x - x.mean())[:, None]
        fast.append(correlation_time(x, np.ones_like(x), 0.1, [0]))
    assert np.median(fast) == pytest.approx(1.0, rel=0.25)


def test_a_random_walk_is_correlated_for_ever():
    x = np.cumsum(np.random.default_rng(1).normal(size=300))
    memory = fit_memory(x, np.ones(300, bool), [0], 0.1)
    assert memory.time > 30.0
    assert memory.phi.sum() <= 1.0


def test_columns_and_torques_go_the_same_way():
    """What explains the rows explains the whitened ones with the same coefficients."""
    rng = np.random.default_rng(0)
    m, starts = 400, np.array([0, 150])
    root = np.sqrt(rng.uniform(0.2, 1.0, size=(m, 2)))
    root[60:75, 0] = 0.0
    root[148:153, 1] = 0.0
    root[-3:] = 0.0
    A, theta = rng.normal(size=(2, m, 3)), np.array([1.0, -2.0, 0.5])
    residual = np.array([autoregression(0.9, m, s) for s in (1, 2)]) * root.T
    rows = A * root.T[:, :, None]
    white = Whitening(residual, root, starts, 0.1)
    y = rows @ theta + residual
    left = white(y, [0, 1]) - white(rows, [0, 1]) @ theta
    assert_allclose(left, white(residual, [0, 1]), atol=1e-12)
    # Rows that do not count stay so; a joint may come alone.
    assert_array_equal(left[root.T == 0], 0.0)
    assert_allclose(white(y[[1]], [1]), white(y, [0, 1])[[1]])


def test_missing_rows_do_not_break_the_memory():
    """Rows after a gap still know the level before it."""
    x = autoregression(0.99, 3000) + 5.0
    root = np.ones((3000, 1))
    root[np.arange(3000) % 50 < 3] = 0.0
    _, left = whitened(x, root)
    after = np.flatnonzero(np.arange(3000) % 50 == 3)[1:]
    assert left[after].std() < 3 * left[root[:, 0] > 0].std()
    assert np.abs(left[after]).max() < 2.0


def test_nothing_passes_from_one_recording_to_the_next():
    x = np.concatenate([autoregression(0.9, 300, s) for s in range(4)])
    level = np.repeat([0.0, 50.0, 0.0, 50.0], 300)
    starts = np.arange(0, 1200, 300)
    white, apart = whitened(x + level, starts=starts)
    beginnings = starts[1:, None] + np.arange(3)
    assert np.abs(apart[beginnings]).max() < 10.0
    assert white.memory[0].phi[0] == pytest.approx(0.9, abs=0.2)


def test_the_low_pass_is_no_memory():
    """Rows that are alike because of the filter stay alike."""
    rng = np.random.default_rng(0)
    x = np.convolve(rng.normal(size=4003), np.ones(4) / 2, mode="valid")
    white, left = whitened(x, step=0.025, cutoff=5.0)
    assert lagged(x) > 0.7
    assert lagged(left) > 0.6
    assert white.memory[0].time < 0.2


def test_too_few_rows_have_no_memory():
    x = autoregression(0.9, 9)
    memory = fit_memory(x, np.ones(9, bool), [0], 0.1)
    assert memory.phi.size == 0
    assert memory.time == 0.1


def test_many_short_recordings_have_one_memory():
    x = np.concatenate([autoregression(0.9, 6, s) for s in range(80)])
    memory = fit_memory(x, np.ones(480, bool), np.arange(0, 480, 6), 0.1)
    assert memory.phi.sum() == pytest.approx(0.9, abs=0.05)
