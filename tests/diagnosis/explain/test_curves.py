"""Curves of the pictures, thinned."""

from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis.explain import torque_curves


def residuals(rows, torque, above):
    return SimpleNamespace(
        index=rows, torque=torque, predicted=torque + above, weight=torque % 7
    )


def test_a_thinned_curve_keeps_its_peaks_and_its_gaps():
    n = 100_000
    rows = np.arange(n) + 10 * (np.arange(n) >= 70_000)
    torque = np.sin(np.arange(n) / 50.0)[:, None]
    torque[[12_345, 60_000], 0] = 9.0, -9.0
    one = residuals(rows, torque, 0.0)
    (drawn,) = torque_curves(one, one, np.arange(n + 10.0), [0])
    assert drawn.seconds.size < 600
    assert (np.diff(drawn.seconds) > 0).all()
    assert (np.nanmin(drawn.measured), np.nanmax(drawn.measured)) == (-9.0, 9.0)
    assert drawn.seconds[np.isnan(drawn.measured)].tolist() == [70_000]


def test_torques_over_time_have_gaps_between_the_stretches():
    # rows 20 to 39 and 100 to 119 are held out
    rows = np.r_[20:40, 100:120]
    torque = np.column_stack([rows, -rows]).astype(float)
    before, after = (residuals(rows, torque, k) for k in (1.0, 2.0))
    clock = 0.1 * np.arange(120)
    other, one = torque_curves(before, after, clock, [1, 0])
    assert (other.joint, one.joint) == (1, 0)
    (gap,) = one.seconds[np.isnan(one.measured)]
    assert gap == pytest.approx(2.0)
    known = np.isfinite(one.measured)
    np.testing.assert_array_equal(one.measured[known], rows)
    np.testing.assert_allclose(np.diff(one.seconds), 0.1)
    np.testing.assert_allclose(one.before[known], one.measured[known] + 1.0)
    np.testing.assert_allclose(other.after[known], other.measured[known] + 2.0)
    # Where the joint stands still errors do not count, nor where nothing is known.
    np.testing.assert_array_equal(one.counts[known], one.measured[known] % 7 > 0)
    assert not one.counts[~known].any()
