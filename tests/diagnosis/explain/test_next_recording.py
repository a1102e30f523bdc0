"""What the next recording will show, by how recordings differ."""

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis.explain import next_recording

NOISE = np.full(2, np.nan)


def drawn(r, deviation, seed, nv=1):
    rng = np.random.default_rng(seed)
    return 0.05 * np.exp(deviation * rng.standard_normal((r, nv)))


@pytest.mark.parametrize(
    ("r", "source"), [(0, "assumed"), (2, "mixed"), (3, "measured"), (9, "measured")]
)
def test_where_it_is_from(r, source):
    found = next_recording(drawn(r, 0.3, 0, 2), np.full(2, 0.04), NOISE)
    assert (found.source, found.recordings) == (source, r)
    assert (found.interval[0] < found.error).all()
    assert (found.error < found.interval[1]).all()
    assert found.mean_interval[0] < found.mean < found.mean_interval[1]


@pytest.mark.parametrize("r", [2, 4, 10])
def test_nine_of_ten_next_recordings_lie_between(r):
    # Another recording is half as bad again as one that was fitted alone.
    inside, untouched = [], np.array([0.05 / 1.5 ** (1 / r)])
    for seed in range(400):
        errors = drawn(r + 1, 0.45, seed)
        found = next_recording(errors[:r], untouched, NOISE[:1])
        low, high = found.interval[:, 0]
        inside.append(low < errors[r, 0] < high)
    assert 0.86 < np.mean(inside) < 0.985


@pytest.mark.parametrize("r", [2, 5])
def test_the_median_is_conjugate_to_what_is_assumed(r):
    """Half as bad again, shared among the recordings, counts for two of them."""
    errors, untouched = np.full((r, 1), 0.2), np.array([0.05])
    found = next_recording(errors, untouched, NOISE[:1])
    assumed = np.log(0.05) + np.log(1.5) / r
    expected = ((r - 1) * np.log(0.2) + 2 * assumed) / (r + 1)
    assert np.log(found.error[0]) == pytest.approx(expected)


def test_recordings_that_hardly_differ_say_so_when_there_are_many():
    few, many = (
        next_recording(drawn(r, 0.02, 1), np.array([0.05]), NOISE[:1]) for r in (2, 40)
    )
    width = [x.interval[1, 0] / x.interval[0, 0] for x in (few, many)]
    assert width[1] < 0.5 * width[0]


def test_noise_does_not_differ_between_recordings():
    at, above = (
        next_recording(np.empty((0, 1)), np.array([0.05]), np.array([floor]))
        for floor in (0.05, 0.005)
    )
    assert at.interval[1, 0] < 0.06
    assert above.interval[1, 0] > 0.1


def test_a_joint_that_was_not_judged_has_none():
    errors = np.array([[0.1, np.nan], [0.2, np.nan], [0.1, np.nan]])
    found = next_recording(errors, np.array([0.1, np.nan]), NOISE)
    assert np.isnan(found.error[1])
    assert np.isnan(found.interval[:, 1]).all()
    assert found.error[0] == pytest.approx(found.mean)
