"""What blocks of time say about a change of the model."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats

from sklearn_vbjfa.diagnosis.explain import SMALLEST_GAIN, Comparison, compare, p_value


def pairs(n, better, seed=0, spread=0.3):
    """Squared errors of n blocks, of which the second are the smaller by a factor."""
    rng = np.random.default_rng(seed)
    difficult = rng.gamma(2.0, size=n)
    before = difficult * np.exp(spread * rng.normal(size=n))
    return before, difficult * np.exp(spread * rng.normal(size=n)) * (1 - better)


def test_gain_and_its_error_by_hand():
    before = np.array([4.0, 6.0, 10.0, 5.0])
    after = np.array([3.0, 6.0, 5.0, 6.0])
    found = compare(before, after)
    assert found.gain == pytest.approx(5 / 25)
    assert found.n_blocks == 3
    assert found.helped == pytest.approx(2 / 3)
    difference = np.array([1.0, 0.0, 5.0, -1.0])
    assert found.gain_std == pytest.approx(2 * difference.std() / 25)


def test_equal_models_are_no_evidence():
    same = np.arange(5.0)
    found = compare(same, same)
    assert found == Comparison(gain=0, gain_std=0, p_value=1, n_blocks=0, helped=0)
    assert not found.significant(0.999)
    assert compare(np.zeros(4), np.ones(4)).p_value == 1


def test_swapping_the_models_swaps_the_sign():
    before, after = pairs(40, 0.3)
    there, back = compare(before, after), compare(after, before)
    assert there.gain * before.sum() == pytest.approx(-back.gain * after.sum())
    assert there.p_value < 1e-3
    assert back.p_value == 1.0


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10**6), unit=st.floats(1e-6, 1e6))
def test_units_do_not_matter(seed, unit):
    before, after = pairs(25, 0.1, seed)
    one, other = compare(before, after), compare(unit * before, unit * after)
    assert other.gain == pytest.approx(one.gain)
    assert other.gain_std == pytest.approx(one.gain_std)
    assert other.p_value == pytest.approx(one.p_value, rel=1e-6)
    order = np.random.default_rng(seed).permutation(25)
    shuffled = compare(before[order], after[order])
    assert shuffled.p_value == pytest.approx(one.p_value, rel=1e-6)


def test_p_values_are_honest():
    """Where the models are equally good, five in a hundred are below 5 %."""
    found = np.array([p_value(*pairs(40, 0.0, seed)) for seed in range(200)])
    for level in (0.05, 0.01):
        # three deviations of a binomial above the level
        bound = level + 3 * np.sqrt(level * (1 - level) / 200)
        assert np.mean(found < level) <= bound
    assert found.max() == 1.0


def test_the_smaller_of_two_tests_counts_twice():
    before, after = pairs(30, 0.2)
    ranks = stats.wilcoxon(before - after, alternative="greater").pvalue
    t = stats.ttest_1samp(np.log(before / after), 0, alternative="greater").pvalue
    assert p_value(before, after) == pytest.approx(2 * min(ranks, t), rel=1e-3)


def test_a_dozen_blocks_can_reach_the_level_of_a_hundred_candidates():
    before, after = pairs(12, 0.7, spread=0.1)
    assert p_value(before, after) < 0.05 / 100
    assert p_value(before[:2], after[:2]) == 1.0


def test_worse_in_the_sum_is_no_evidence_however_often_it_helps():
    before = np.ones(40)
    after = np.where(np.arange(40) == 3, 30.0, 0.9)
    found = compare(before, after)
    assert found.helped > 0.9
    assert found.gain < 0
    assert found.p_value == 1.0
    assert p_value(before, after) < 1e-6


def test_one_difficult_block_does_not_decide():
    before, after = pairs(40, 0.0, seed=2)
    before[7] += 100.0
    found = compare(before, after)
    assert found.gain > 0.4
    assert not found.significant(0.01)


def test_what_is_too_small_has_no_name():
    sure = Comparison(
        gain=0.5 * SMALLEST_GAIN, gain_std=0, p_value=0, n_blocks=9, helped=1
    )
    assert not sure.significant(0.05)
    assert sure.significant(0.05, smallest=0.0)


def test_exactly_fitted_blocks_do_not_break_the_test():
    before, after = pairs(20, 0.2)
    after[3] = 0.0
    assert np.isfinite(p_value(before, after))
    assert_allclose(compare(before, np.zeros(20)).gain, 1.0)
