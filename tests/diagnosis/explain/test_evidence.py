"""Cross-validated gain from squared errors of time blocks."""

import numpy as np
import pytest
from scipy import stats

from sklearn_vbjfa.diagnosis.search._held_out import CrossValidatedGain

gain_of = CrossValidatedGain.of


def pairs(n, improvement, seed=0, spread=0.3):
    """Squared errors of n blocks before and after an improvement."""
    rng = np.random.default_rng(seed)
    difficult = rng.gamma(2.0, size=n)
    before = difficult * np.exp(spread * rng.normal(size=n))
    return before, difficult * np.exp(spread * rng.normal(size=n)) * (1 - improvement)


def test_p_values_are_calibrated():
    """For equally good models at most 5 % of the p-values are below 0.05."""
    p_values = np.array([gain_of(*pairs(40, 0.0, seed)).p_value for seed in range(200)])
    for level in (0.05, 0.01):
        # Three standard deviations of the binomial above the level.
        bound = level + 3 * np.sqrt(level * (1 - level) / 200)
        assert np.mean(p_values < level) <= bound


def test_p_value_is_a_t_test_on_log_errors():
    before, after = pairs(30, 0.2)
    expected = stats.ttest_1samp(np.log(before / after), 0, alternative="greater")
    assert gain_of(before, after).p_value == pytest.approx(expected.pvalue, rel=1e-3)


def test_twelve_blocks_can_be_significant_for_a_hundred_candidates():
    before, after = pairs(12, 0.7, spread=0.1)
    assert gain_of(before, after).p_value < 0.05 / 100
    assert gain_of(before[:1], after[:1]).p_value == 0.5
