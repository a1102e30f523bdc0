"""Downsampled curves of the report."""

from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis.explain import torque_curves


def residuals(rows, torque, offset):
    return SimpleNamespace(
        index=rows, torque=torque, predicted=torque + offset, weight=torque % 7
    )


def test_downsampled_curves_keep_peaks_and_gaps():
    n = 100_000
    rows = np.arange(n) + 10 * (np.arange(n) >= 70_000)
    torque = np.sin(np.arange(n) / 50.0)[:, None]
    torque[[12_345, 60_000], 0] = 9.0, -9.0
    fit = residuals(rows, torque, 0.0)
    (curve,) = torque_curves(fit, fit, np.arange(n + 10.0), [0])
    assert curve.seconds.size < 600
    assert (np.diff(curve.seconds) > 0).all()
    assert (np.nanmin(curve.measured), np.nanmax(curve.measured)) == (-9.0, 9.0)
    assert curve.seconds[np.isnan(curve.measured)].tolist() == [70_000]


def test_torque_curves_have_gaps_between_segments():
    # rows 20 to 39 and 100 to 119 are held out
    rows = np.r_[20:40, 100:120]
    torque = np.column_stack([rows, -rows]).astype(float)
    before, after = (residuals(rows, torque, k) for k in (1.0, 2.0))
    clock = 0.1 * np.arange(120)
    second, curve = torque_curves(before, after, clock, [1, 0])
    assert (second.joint, curve.joint) == (1, 0)
    (gap,) = curve.seconds[np.isnan(curve.measured)]
    assert gap == pytest.approx(2.0)
    finite = np.isfinite(curve.measured)
    np.testing.assert_array_equal(curve.measured[finite], rows)
    np.testing.assert_allclose(np.diff(curve.seconds), 0.1)
    np.testing.assert_allclose(curve.before[finite], curve.measured[finite] + 1.0)
    np.testing.assert_allclose(second.after[finite], second.measured[finite] + 2.0)
    # Samples at standstill and samples without data are not counted.
    np.testing.assert_array_equal(curve.counts[finite], curve.measured[finite] % 7 > 0)
    assert not curve.counts[~finite].any()
