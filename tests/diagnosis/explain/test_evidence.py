"""What blocks of time say about a change of the model."""

import numpy as np
import pytest
from scipy import stats

from sklearn_vbjfa.diagnosis.search import CrossValidatedGain

gain_of = CrossValidatedGain.of


def pairs(n, better, seed=0, spread=0.3):
    """Squared errors of n blocks, of which the second are the smaller by a factor."""
    rng = np.random.default_rng(seed)
    difficult = rng.gamma(2.0, size=n)
    before = difficult * np.exp(spread * rng.normal(size=n))
    return before, difficult * np.exp(spread * rng.normal(size=n)) * (1 - better)


def test_p_values_are_honest():
    """Where the models are equally good, five in a hundred are below 5 %."""
    found = np.array([gain_of(*pairs(40, 0.0, seed)).p_value for seed in range(200)])
    for level in (0.05, 0.01):
        # three deviations of a binomial above the level
        bound = level + 3 * np.sqrt(level * (1 - level) / 200)
        assert np.mean(found < level) <= bound


def test_blocks_are_compared_by_the_logarithms_of_their_errors():
    before, after = pairs(30, 0.2)
    expected = stats.ttest_1samp(np.log(before / after), 0, alternative="greater")
    assert gain_of(before, after).p_value == pytest.approx(expected.pvalue, rel=1e-3)


def test_a_dozen_blocks_can_reach_the_level_of_a_hundred_candidates():
    before, after = pairs(12, 0.7, spread=0.1)
    assert gain_of(before, after).p_value < 0.05 / 100
    assert gain_of(before[:1], after[:1]).p_value == 0.5
