"""What the next recording will show, by what differs between recordings."""

import functools
from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis.explain import ExpectedError, MotionStatistics
from sklearn_vbjfa.diagnosis.explain._next import _COMMON, _KINDS, _MAX_SHARE, _WIDTH
from tests.diagnosis._recordings import SPRINGY

LEFT, FLOOR, SCATTER = 0.05, 0.04, 0.05


def motion(fast=1.0, friction=0.8, seed=0, nv=1):
    """Sinusoids of speed, acceleration and load over a torque of unit size."""
    rng = np.random.default_rng(seed)
    v, a, load = fast * rng.standard_normal((3, 500, nv))
    ones = np.ones((500, nv))
    return MotionStatistics(v, a, load, friction * np.sign(v), ones, np.ones(nv))


def described(expectation, of=None):
    found = expectation.of(of)
    return SimpleNamespace(
        error=found[0, :-1],
        interval=found[1:, :-1],
        mean=found[0, -1],
        source=expectation.source,
        recordings=expectation.recordings,
    )


def expected(
    left_out=(),
    left=LEFT,
    floor=FLOOR,
    of=None,
    friction=0.8,
    alone=np.nan,
    timed=False,
):
    left_out = np.reshape(left_out, (-1, 1)).astype(float)
    fitted = motion(friction=friction)
    known = np.array([left]), np.array([floor]), np.array([SCATTER])
    expectation = ExpectedError(*known, left_out, np.array([alone]), fitted, timed)
    return described(expectation, of)


@pytest.mark.parametrize(
    ("r", "source"),
    [(0, "assumed"), (2, "partly measured"), (3, "measured"), (9, "measured")],
)
def test_where_it_is_from(r, source):
    found = expected(r * [0.06])
    assert (found.source, found.recordings) == (source, r)
    assert found.interval[0] < found.error < found.interval[1]
    assert found.mean == pytest.approx(found.error[0])


def error_of(away, sizes, rng):
    noise = FLOOR * np.exp(SCATTER * rng.standard_normal())
    return np.hypot(noise, np.linalg.norm(away * sizes))


@pytest.mark.parametrize("r", [0, 2, 4])
def test_nine_of_ten_next_recordings_of_robots_like_those_assumed(r):
    sizes, inside = motion().sizes[:, 0], []
    medians, count = np.array([*_KINDS.values()]), max(r, 1)
    common, own = np.sqrt([_COMMON, 1.0 - _COMMON])
    for seed in range(150):
        rng = np.random.default_rng(seed)
        drawn = common * rng.standard_normal() + own * rng.standard_normal(4)
        shares = medians * np.exp(_WIDTH * drawn)
        shares /= 1.0 + shares / _MAX_SHARE
        values = rng.standard_normal((count + 1, 4)) * shares
        fitted, following = values[:count], values[count]

        # A model that lacks nothing, whose parameters are means over its recordings.
        error = functools.partial(error_of, sizes=sizes, rng=rng)
        mean = fitted.mean(axis=0)
        left = np.sqrt(np.mean([error(x - mean) ** 2 for x in fitted]))
        out = [error((x - mean) * r / (r - 1)) for x in fitted] if r else []
        low, high = expected(out, left=left, alone=FLOOR).interval[:, 0]
        inside.append(low < error(following - mean) < high)
    # Three deviations of 150 draws.
    assert 0.82 < np.mean(inside) < 0.98


def test_noise_is_no_evidence_that_recordings_agree():
    at, small = (expected(left=FLOOR, friction=size) for size in (2.0, 0.01))
    assert at.interval[1, 0] > 2 * small.interval[1, 0]


def test_recordings_that_agree_narrow_it_and_others_widen_it():
    one, alike = expected(), expected(4 * [0.05])
    apart = expected([0.3, 0.1, 0.2, 0.3], left=0.18)
    assert alike.interval[1, 0] < 0.5 * one.interval[1, 0]
    assert alike.interval[1, 0] < apart.error
    # Held-out data of the same recordings have a share of what these differ by.
    assert apart.interval[0, 0] < 0.18


def test_effects_that_follow_the_time_hide_no_difference_of_recordings():
    # A payload that changes between two recordings leaves the noise alone.
    hidden, seen = (expected([0.3, 0.4], left=FLOOR, timed=x) for x in (False, True))
    assert hidden.interval[1, 0] < 0.3 < seen.interval[1, 0]


def test_errors_within_recordings_are_those_of_the_model():
    given = {"left_out": [0.2, 0.25, 0.2, 0.3], "left": 0.18}
    model, apart = (expected(alone=x, **given) for x in (0.18, FLOOR))
    widths = [np.divide(*one.interval[::-1, 0]) for one in (model, apart)]
    assert widths[1] > 1.5 * widths[0]
    assert apart.interval[0, 0] < 0.5 * model.interval[0, 0]


def test_it_grows_with_the_distance_from_what_was_fitted():
    errors = [expected(of=motion(fast), left=0.1).error[0] for fast in (0.5, 1, 2, 4)]
    assert errors[0] == pytest.approx(errors[1], rel=0.3)
    assert errors[1] < 0.7 * errors[2] < 0.5 * errors[3]


def test_a_joint_that_was_not_judged_has_none():
    known = np.array([0.1, np.nan]), np.array([0.05, 0.05]), np.full(2, SCATTER)
    left_out = np.array([[0.1, np.nan], [0.2, np.nan], [0.1, np.nan]])
    found = described(ExpectedError(*known, left_out, known[0], motion(nv=2)))
    assert np.isnan(found.error[1])
    assert np.isnan(found.interval[:, 1]).all()
    assert found.error[0] == pytest.approx(found.mean)


def test_a_search_expects_more_of_faster_motion(springy):
    fitted = springy.report_.outcome.facts_of("next recording")
    like, interval = springy.expected_error(SPRINGY.position)
    assert like == pytest.approx([one.value for one in fitted[:2]], rel=0.3)
    assert (interval[0] < like).all()
    assert (like < interval[1]).all()
    # The same path three times as fast.
    fast, _ = springy.expected_error(SPRINGY.position[::3])
    assert (fast > 1.2 * like).all()
