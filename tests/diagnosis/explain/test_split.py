"""Split into searched and held-out rows."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.diagnosis.explain import split_in_time
from sklearn_vbjfa.recording import take_arrays
from tests.effects._arms import arm

DT = 0.02
MODEL = arm("ZY")


def robot(**options):
    return RobotIdentifier(MODEL, dt=DT, friction=("viscous",), **options)


def motion(seconds, still=(), seed=0):
    """Positions (n, 2) of a steady motion; `still` lists pauses (joint, start, end)."""
    t = np.arange(round(seconds / DT)) * DT
    pace = np.ones((t.size, 2))
    for joint, low, high in still:
        pace[(t >= low) & (t < high), joint] = 0.0
    # Joints stop and start within half a second.
    smooth = np.hanning(25) / np.hanning(25).sum()
    pace = np.column_stack([np.convolve(g, smooth, mode="same") for g in pace.T])
    path = np.cumsum(pace, axis=0) * DT
    rng = np.random.default_rng(seed)
    return np.sin(2 * np.pi * path * [0.5, 0.4]) + 1e-6 * rng.normal(size=(t.size, 2))


def split_positions(robot, X, groups=None, share=0.25):
    """Split a recording of positions or states with an unfitted identifier."""
    keywords = {"dt": robot.dt, "joint_names": ("a", "b")}
    whole = take_arrays(X, np.zeros((len(X), 2)), groups, **keywords)
    return split_in_time(robot, whole, share)


@pytest.fixture(scope="module")
def minute():
    """Return positions of one minute of motion, and their split."""
    q = motion(60.0)
    return q, split_positions(robot(cutoff=4.0), q)


def moving(q):
    """Rows in which each joint clearly moves, (n, 2)."""
    return np.abs(np.gradient(q, DT, axis=0)) > 0.05


def whole(split, n, groups=None):
    """Assert that the parts are a partition and that cuts start new pieces."""
    search, test = split.rows, np.r_[split.stretches]
    assert_array_equal(np.sort(np.r_[search, test]), np.arange(n))
    assert np.all(np.diff(search) > 0)
    assert np.all(np.diff(test) > 0)
    # Filters must not cross a cut.
    groups = np.zeros(n) if groups is None else groups
    cut = (np.diff(search) > 1) | (np.diff(groups[search]) != 0)
    assert_array_equal(np.diff(split.pieces) > 0, cut)


def test_a_single_recording_has_several_held_out_segments(minute):
    q, split = minute
    whole(split, len(q))
    assert len(split.stretches) == 3
    assert np.r_[split.stretches].size == pytest.approx(0.25 * len(q), rel=0.05)
    assert split.stretches[-1].stop == len(q)
    centres = [0.5 * (s.start + s.stop) / len(q) for s in split.stretches]
    assert_allclose(centres, (np.arange(3) + 0.875) / 3, atol=0.03)
    assert split.borders == ((True, True), (True, True), (True, False))


def test_both_ends_of_several_recordings_are_held_out():
    q = motion(90.0)
    groups = np.repeat([7, 3, 7], [2000, 1000, 1500])
    split = split_positions(robot(cutoff=8.0), q, groups)
    whole(split, len(q), groups)
    edges = [(s.start, s.stop) for s in split.stretches]
    assert [a for a, _ in edges[::2]] == [0, 2000, 3000]
    assert [b for _, b in edges[1::2]] == [2000, 3000, 4500]
    lengths = [b - a for a, b in edges]
    assert_allclose(lengths, [250, 250, 125, 125, 188, 188], rtol=0.2)
    assert split.borders == ((False, True), (True, False)) * 3


def test_held_out_rows_contain_motion():
    q = motion(60.0, still=[(0, 40.0, 60.0), (1, 40.0, 60.0)])
    split = split_positions(robot(), q)
    whole(split, len(q))
    share = moving(q)[np.r_[split.stretches]].sum() / moving(q).sum()
    assert share == pytest.approx(0.25, abs=0.04)
    # The last quarter of the rows contains no motion.
    assert moving(q)[-len(q) // 4 :].sum() == 0


def test_held_out_rows_contain_motion_of_every_joint():
    q = motion(80.0, still=[(0, 40.0, 80.0), (1, 0.0, 40.0)])
    for groups in (None, np.repeat([0, 1], len(q) // 2)):
        split = split_positions(robot(), q, groups)
        whole(split, len(q), groups)
        share = moving(q)[np.r_[split.stretches]].sum(axis=0) / moving(q).sum(axis=0)
        assert np.all(share > 0.12), share
        assert np.all(share < 0.4), share


def test_the_guard_keeps_half_of_every_segment(minute):
    q, split = minute
    narrow = split.with_guard(10)
    assert np.r_[narrow.stretches].size == np.r_[split.stretches].size - 10 * 5
    assert narrow.stretches[-1].stop == len(q)
    assert_array_equal(narrow.rows, split.rows)
    wide = split.with_guard(10**6)
    assert np.r_[wide.stretches].size < np.r_[narrow.stretches].size
    for before, after in zip(split.stretches, wide.stretches):
        assert after.stop - after.start >= 0.5 * (before.stop - before.start)


def test_filtered_rows_of_short_moves_are_counted():
    q = motion(40.0, [(j, k + 1.0, k + 3.0) for k in range(0, 40, 3) for j in (0, 1)])
    split, tau = split_positions(robot(cutoff=4.0), q), np.gradient(q, DT, axis=0)
    rows, sizes = np.r_[split.stretches], [len(q[x]) for x in split.stretches]
    labels = np.repeat(range(len(sizes)), sizes)
    weight = robot(cutoff=4.0).fit(q, tau).residuals(q[rows], tau[rows], labels).weight
    count = 3 * (weight / weight.max(axis=0)).sum(axis=0)  # decimated by three
    assert_allclose(split.count_moving(split.stretches), count, rtol=0.05)


def test_short_recordings_have_a_larger_held_out_share():
    q = motion(16.0)
    split = split_positions(robot(cutoff=2.2), q, None, 0.15)
    share = np.r_[split.stretches].size / len(q)
    assert 0.16 < share < 0.41
    assert np.all(split.count_moving(split.stretches) >= split.need)
    # The share is not increased if even that is not enough.
    shorter = split_positions(robot(cutoff=2.2), q[:400], None, 0.15)
    assert np.r_[shorter.stretches].size == pytest.approx(0.15 * 400, rel=0.6)


def test_segments_with_a_jump_are_not_held_out(minute):
    q, split = minute
    clock = np.arange(len(q)) * DT
    first, second, last = split.stretches
    inside = clock[(second.start + second.stop) // 2]
    assert split.without(clock, [inside]).stretches == (first, last)
    # An instant at the first row after the segment also excludes it.
    assert split.without(clock, [clock[second.stop]]).stretches == (first, last)
    for instant in (clock[second.start - 1], clock[second.stop + 1], clock[last.start]):
        assert split.without(clock, [instant]).stretches == split.stretches
