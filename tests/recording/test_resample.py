"""Resampling against functions with a known value everywhere."""

import numpy as np
import pytest

from sklearn_vbjfa.recording import (
    Log,
    interpolate,
    join,
    median_period,
    merge_doubled,
    resample_uniform,
)


@pytest.fixture
def make_stamps():
    def make(n_samples, dt=0.01, jitter=0.3, seed=0):
        rng = np.random.default_rng(seed)
        return dt * (np.arange(n_samples) + rng.uniform(-jitter, jitter, n_samples))

    return make


def test_cubic_reproduces_a_cubic_and_linear_a_line(make_stamps):
    t = make_stamps(200)
    channels = {
        "q": np.column_stack([t**3 - t, 2 * t**2]),
        "tau": np.column_stack([3 * t, 1 - t]),
        "temperature": 20 + t,
    }
    ((grid, part),) = resample_uniform(t, channels, dt=0.01)
    np.testing.assert_allclose(np.diff(grid), 0.01)
    assert grid[0] == 0
    assert 0 <= (t[-1] - t[0]) - grid[-1] < 0.01
    x = grid + t[0]
    np.testing.assert_allclose(part["q"], np.column_stack([x**3 - x, 2 * x**2]))
    np.testing.assert_allclose(part["tau"], np.column_stack([3 * x, 1 - x]))
    np.testing.assert_allclose(part["temperature"], 20 + x)


def test_uniform_stamps_return_the_values_untouched():
    t = np.round(0.008 * np.arange(50) + 5, 6)
    q = np.random.default_rng(0).normal(size=(50, 2))
    ((grid, part),) = resample_uniform(t, {"q": q}, dt=0.008)
    np.testing.assert_array_equal(part["q"], q)
    np.testing.assert_allclose(grid, 0.008 * np.arange(50))


def test_repeated_stamps_and_rows_are_dropped(make_stamps):
    t = make_stamps(100, jitter=0.0)
    q = np.sin(t)[:, None]
    stamps = np.insert(t, 40, t[39])
    ((_, part),) = resample_uniform(
        stamps, {"q": np.insert(q, 40, 7.0, axis=0)}, dt=0.01
    )
    np.testing.assert_array_equal(part["q"], q)

    held = q.copy()
    held[50] = held[49]
    ((_, part),) = resample_uniform(t, {"q": held}, dt=0.01, drop_repeated=True)
    np.testing.assert_allclose(part["q"], q, atol=1e-8)
    ((_, part),) = resample_uniform(t, {"q": held}, dt=0.01)
    np.testing.assert_array_equal(part["q"], held)


@pytest.mark.parametrize(("gap", "n_parts"), [(9.5, 1), (10.5, 2)])
def test_only_long_gaps_split(gap, n_parts):
    t = 0.01 * np.concatenate([np.arange(50), 49 + gap + np.arange(40)])
    parts = resample_uniform(t, {"q": t[:, None]}, dt=0.01)
    assert len(parts) == n_parts
    if n_parts == 2:
        assert [len(grid) for grid, _ in parts] == [50, 40]
        np.testing.assert_allclose(parts[1][1]["q"][:, 0], t[50:])


def test_join_labels_logs_and_their_parts(make_stamps):
    t = make_stamps(60)
    gapped = np.concatenate([t, t + 2.0])
    logs = [
        Log(name="a", t=t, q=t[:, None], tau=t[:, None], signals={"x": t}),
        Log(
            name="b",
            t=gapped,
            q=gapped[:, None],
            tau=gapped[:, None],
            signals={"x": gapped},
        ),
    ]
    assert median_period(logs) == pytest.approx(0.01, rel=0.1)
    joined = join(logs, dt=0.01)
    assert joined["group_names"] == ("a", "b [1]", "b [2]")
    assert joined["v"] is None
    np.testing.assert_array_equal(np.unique(joined["groups"]), [0, 1, 2])
    starts = np.flatnonzero(np.diff(joined["groups"], prepend=-1))
    np.testing.assert_array_equal(joined["t"][starts], 0)
    same = np.diff(joined["groups"]) == 0
    np.testing.assert_allclose(np.diff(joined["t"])[same], 0.01)
    np.testing.assert_allclose(joined["signals"]["x"], joined["q"][:, 0])

    raw = join(logs, dt=0.01, resample=False)
    assert raw["group_names"] == ("a", "b")
    np.testing.assert_array_equal(raw["t"], np.concatenate([t, gapped]))


def test_doubled_stamps_are_averaged_where_stamps_count():
    t, merged = merge_doubled(
        np.array([0.0, 1.0, 1.0, 1.0, 2.0]),
        {"q": np.array([[0], [1], [2], [6], [5]]), "I": np.arange(5)},
    )
    np.testing.assert_array_equal(t, [0, 1, 2])
    np.testing.assert_array_equal(merged["q"], [[0], [3], [5]])
    np.testing.assert_array_equal(merged["I"], [0, 2, 4])


def test_interpolation_is_local():
    dt = 0.01
    t = dt * (np.arange(100) + 0.2 * np.sin(np.arange(100)))
    q = np.zeros((100, 1))
    q[50] = 1.0
    grid, resampled = interpolate(t - t[0], {"q": q}, dt)
    far = np.abs(grid - grid[50]) > 3.5 * dt
    assert np.abs(resampled["q"][far]).max() == 0.0
    assert np.abs(resampled["q"]).max() > 0.8
