"""Expected error on the next recording, from the variation between recordings."""

from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis.explain import ExpectedError, MotionStatistics
from tests.diagnosis._recordings import SPRINGY

LEFT, FLOOR, SCATTER = 0.05, 0.04, 0.05
# Prior of the variation of friction, gain, offset and load between recordings.
MEDIANS, WIDTH, COMMON, MOST = np.array([0.03, 0.003, 0.004, 0.02]), 2.4, 0.5, 0.3


def motion(fast=1.0, friction=0.8, seed=0, nv=1):
    """Draw velocity, acceleration and load, relative to a torque of unit size."""
    rng = np.random.default_rng(seed)
    v, a, load = fast * rng.standard_normal((3, 500, nv))
    ones = np.ones((500, nv))
    return MotionStatistics(v, a, load, friction * np.sign(v), ones, np.ones(nv))


def summarize(expectation, of=None):
    estimate = expectation.of(of)
    return SimpleNamespace(
        error=estimate[0, :-1],
        interval=estimate[1:, :-1],
        mean=estimate[0, -1],
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
    errors = np.array([left]), np.array([floor]), np.array([SCATTER])
    expectation = ExpectedError(*errors, left_out, np.array([alone]), fitted, timed)
    return summarize(expectation, of)


@pytest.mark.parametrize(
    ("r", "source"),
    [(0, "assumed"), (2, "partly measured"), (3, "measured"), (9, "measured")],
)
def test_source_of_the_expected_error(r, source):
    estimate = expected(r * [0.06])
    assert (estimate.source, estimate.recordings) == (source, r)
    assert estimate.interval[0] < estimate.error < estimate.interval[1]
    assert estimate.mean == pytest.approx(estimate.error[0])


@pytest.mark.parametrize("r", [0, 2, 4])
def test_coverage_of_the_expected_error(r):
    sizes, inside = motion().sizes[:, 0], []
    count, (common, individual) = max(r, 1), np.sqrt([COMMON, 1.0 - COMMON])
    for seed in range(150):
        rng = np.random.default_rng(seed)
        drawn = common * rng.standard_normal() + individual * rng.standard_normal(4)
        shares = MEDIANS * np.exp(WIDTH * drawn)
        shares /= 1.0 + shares / MOST
        values = rng.standard_normal((count + 1, 4)) * shares
        fitted, following = values[:count], values[count]

        # A complete model; its parameters are means over the recordings.
        def error(deviation, rng=rng):
            noise = FLOOR * np.exp(SCATTER * rng.standard_normal())
            return np.hypot(noise, np.linalg.norm(deviation * sizes))

        mean = fitted.mean(axis=0)
        left = np.sqrt(np.mean([error(x - mean) ** 2 for x in fitted]))
        left_out = [error((x - mean) * r / (r - 1)) for x in fitted] if r else []
        low, high = expected(left_out, left=left, alone=FLOOR).interval[:, 0]
        inside.append(low < error(following - mean) < high)
    # Three standard deviations for 150 draws.
    assert 0.82 < np.mean(inside) < 0.98


def test_noise_does_not_narrow_the_expected_error():
    strong, weak = (expected(left=FLOOR, friction=size) for size in (2.0, 0.01))
    assert strong.interval[1, 0] > 2 * weak.interval[1, 0]


def test_agreeing_recordings_narrow_the_expected_error():
    single, agreeing = expected(), expected(4 * [0.05])
    differing = expected([0.3, 0.1, 0.2, 0.3], left=0.18)
    assert agreeing.interval[1, 0] < 0.5 * single.interval[1, 0]
    assert agreeing.interval[1, 0] < differing.error
    # The held-out error contains part of the variation between recordings.
    assert differing.interval[0, 0] < 0.18


def test_time_effects_do_not_hide_variation_between_recordings():
    # With a payload change between the recordings only the noise remains.
    hidden, seen = (expected([0.3, 0.4], left=FLOOR, timed=x) for x in (False, True))
    assert hidden.interval[1, 0] < 0.3 < seen.interval[1, 0]


def test_errors_within_recordings_limit_the_variation_between_them():
    keywords = {"left_out": [0.2, 0.25, 0.2, 0.3], "left": 0.18}
    model, differing = (expected(alone=x, **keywords) for x in (0.18, FLOOR))
    widths = [np.divide(*estimate.interval[::-1, 0]) for estimate in (model, differing)]
    assert widths[1] > 1.5 * widths[0]
    assert differing.interval[0, 0] < 0.5 * model.interval[0, 0]


def test_expected_error_grows_with_faster_motion():
    errors = [expected(of=motion(fast), left=0.1).error[0] for fast in (0.5, 1, 2, 4)]
    assert errors[0] == pytest.approx(errors[1], rel=0.3)
    assert errors[1] < 0.7 * errors[2] < 0.5 * errors[3]


def test_joints_without_error_have_no_expected_error():
    errors = np.array([0.1, np.nan]), np.array([0.05, 0.05]), np.full(2, SCATTER)
    left_out = np.array([[0.1, np.nan], [0.2, np.nan], [0.1, np.nan]])
    estimate = summarize(ExpectedError(*errors, left_out, errors[0], motion(nv=2)))
    assert np.isnan(estimate.error[1])
    assert np.isnan(estimate.interval[:, 1]).all()
    assert estimate.error[0] == pytest.approx(estimate.mean)


def test_discovery_expects_larger_errors_for_faster_motion(springy):
    fitted = springy.report_.outcome.facts_of("next recording")
    same_motion, interval = springy.expected_error(SPRINGY.position)
    assert same_motion == pytest.approx([fact.value for fact in fitted[:2]], rel=0.3)
    assert (interval[0] < same_motion).all()
    assert (same_motion < interval[1]).all()
    # The same path three times as fast.
    fast, _ = springy.expected_error(SPRINGY.position[::3])
    assert (fast > 1.2 * same_motion).all()
