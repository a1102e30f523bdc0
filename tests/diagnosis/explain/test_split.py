"""Which rows are kept for the end."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.diagnosis.explain import split_in_time
from sklearn_vbjfa.recording import take_arrays
from tests.effects._arms import arm

DT = 0.02
MODEL = arm("ZY")


def robot(**given):
    return RobotIdentifier(MODEL, dt=DT, friction=("viscous",), **given)


def motion(seconds, still=(), seed=0):
    """Positions (n, 2) in steady motion that pauses in intervals [s] of joints."""
    t = np.arange(round(seconds / DT)) * DT
    going = np.ones((t.size, 2))
    for joint, low, high in still:
        going[(t >= low) & (t < high), joint] = 0.0
    # Pauses begin and end in half a second.
    smooth = np.hanning(25) / np.hanning(25).sum()
    going = np.column_stack([np.convolve(g, smooth, mode="same") for g in going.T])
    path = np.cumsum(going, axis=0) * DT
    rng = np.random.default_rng(seed)
    return np.sin(2 * np.pi * path * [0.5, 0.4]) + 1e-6 * rng.normal(size=(t.size, 2))


def divided(robot, X, groups=None, share=0.25):
    """Split of a recording of positions or states by a robot that is not fitted."""
    known = {"dt": robot.dt, "joint_names": ("a", "b")}
    whole = take_arrays(X, np.zeros((len(X), 2)), groups, **known)
    return split_in_time(robot, whole, share)


@pytest.fixture(scope="module")
def minute():
    """Return positions of a minute of motion, and how they are split."""
    q = motion(60.0)
    return q, divided(robot(cutoff=4.0), q)


def moving(q):
    """Rows in which each joint clearly moves, (n, 2)."""
    return np.abs(np.gradient(q, DT, axis=0)) > 0.05


def whole(split, n, groups=None):
    """Every row is in one part, stretches are contiguous and in order."""
    search, test = split.rows, split.held_out_rows
    assert_array_equal(np.sort(np.r_[search, test]), np.arange(n))
    assert np.all(np.diff(search) > 0)
    assert np.all(np.diff(test) > 0)
    # Nothing is filtered across a cut, and all else is.
    groups = np.zeros(n) if groups is None else groups
    cut = (np.diff(search) > 1) | (np.diff(groups[search]) != 0)
    assert_array_equal(np.diff(split.pieces) > 0, cut)


def test_several_stretches_of_a_single_recording(minute):
    q, split = minute
    whole(split, len(q))
    assert len(split.stretches) == 3
    assert split.held_out_rows.size == pytest.approx(0.25 * len(q), rel=0.05)
    assert split.stretches[-1].stop == len(q)
    middle = [0.5 * (s.start + s.stop) / len(q) for s in split.stretches]
    assert_allclose(middle, (np.arange(3) + 0.875) / 3, atol=0.03)
    assert split.borders == ((True, True), (True, True), (True, False))


def test_both_ends_of_each_of_several_recordings():
    q = motion(90.0)
    groups = np.repeat([7, 3, 7], [2000, 1000, 1500])
    split = divided(robot(cutoff=8.0), q, groups)
    whole(split, len(q), groups)
    edges = [(s.start, s.stop) for s in split.stretches]
    assert [a for a, _ in edges[::2]] == [0, 2000, 3000]
    assert [b for _, b in edges[1::2]] == [2000, 3000, 4500]
    lengths = [b - a for a, b in edges]
    assert_allclose(lengths, [250, 250, 125, 125, 188, 188], rtol=0.2)
    assert split.borders == ((False, True), (True, False)) * 3


def test_a_robot_that_comes_to_rest_is_judged_in_motion():
    q = motion(60.0, still=[(0, 40.0, 60.0), (1, 40.0, 60.0)])
    split = divided(robot(), q)
    whole(split, len(q))
    share = moving(q)[split.held_out_rows].sum() / moving(q).sum()
    assert share == pytest.approx(0.25, abs=0.04)
    # The last quarter of the rows holds none of it.
    assert moving(q)[-len(q) // 4 :].sum() == 0


def test_joints_that_move_one_at_a_time_are_all_judged():
    q = motion(80.0, still=[(0, 40.0, 80.0), (1, 0.0, 40.0)])
    for groups in (None, np.repeat([0, 1], len(q) // 2)):
        split = divided(robot(), q, groups)
        whole(split, len(q), groups)
        share = moving(q)[split.held_out_rows].sum(axis=0) / moving(q).sum(axis=0)
        assert np.all(share > 0.12), share
        assert np.all(share < 0.4), share


def test_the_guard_leaves_half_of_every_stretch(minute):
    q, split = minute
    near = split.with_guard(10)
    assert near.held_out_rows.size == split.held_out_rows.size - 10 * 5
    assert near.stretches[-1].stop == len(q)
    assert_array_equal(near.rows, split.rows)
    far = split.with_guard(10**6)
    assert far.held_out_rows.size < near.held_out_rows.size
    for before, after in zip(split.stretches, far.stretches):
        assert after.stop - after.start >= 0.5 * (before.stop - before.start)


def test_a_short_recording_gives_more_for_a_verdict():
    q = motion(16.0)
    split = divided(robot(cutoff=2.2), q, None, 0.15)
    share = split.held_out_rows.size / len(q)
    assert 0.16 < share < 0.41
    assert np.all(split.count_moving(split.stretches) >= split.need)
    # Not in vain, where even that is too little.
    short = divided(robot(cutoff=2.2), q[:400], None, 0.15)
    assert short.held_out_rows.size == pytest.approx(0.15 * 400, rel=0.6)


def test_a_stretch_in_which_something_jumps_is_not_judged(minute):
    q, split = minute
    clock = np.arange(len(q)) * DT
    first, second, last = split.stretches
    inside = clock[(second.start + second.stop) // 2]
    assert split.without(clock, [inside]).stretches == (first, last)
    # Where the search begins again is as far as it knows.
    assert split.without(clock, [clock[second.stop]]).stretches == (first, last)
    for known in (clock[second.start - 1], clock[second.stop + 1], clock[last.start]):
        assert split.without(clock, [known]).stretches == split.stretches
