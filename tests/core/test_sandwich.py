"""Variances from the scatter between blocks, against repeated estimates."""

import numpy as np
import pytest

from sklearn_vbjfa._core._linear_systems import block_variance
from tests.core._problems import coloured

NORMAL = 1.6449


def scatter(grams, scores, place, noise=1.0):
    """Return the block variance with all parameters in one group."""
    return block_variance([(np.arange(scores.shape[1]), grams)], scores, place, noise)


def study(rho, *, p=3, n=1200, n_blocks=40, trials=150, recordings=1):
    """Least-squares errors (trials, p) with coloured noise, factors, freedoms."""
    rng = np.random.default_rng(0)
    label = np.arange(n) * n_blocks // n
    per = n_blocks // recordings
    place = np.column_stack([np.arange(n_blocks) // per, np.arange(n_blocks) % per])
    errors, deviations, factors, freedoms = [], [], [], []
    for _ in range(trials):
        X, noise = coloured(rng, (n, p), 0.9), coloured(rng, n, rho)
        error = np.linalg.lstsq(X, noise, rcond=None)[0]
        residual = noise - X @ error
        rows = [label == b for b in range(n_blocks)]
        grams = np.array([X[r].T @ X[r] for r in rows])
        scores = np.array([X[r].T @ residual[r] for r in rows])
        found = scatter(grams, scores, place, residual @ residual / n)
        errors.append(error)
        deviations.append(np.sqrt(np.diagonal(found.scores.T @ found.scores)))
        np.testing.assert_allclose(
            deviations[-1], np.sqrt(found.factor * found.white), rtol=1e-9
        )
        factors.append(found.factor)
        freedoms.append(found.freedom)
    return (np.array(x) for x in (errors, deviations, factors, freedoms))


@pytest.mark.parametrize("p", [1, 3, 15])
def test_white_residuals_give_a_factor_of_one_on_average(p):
    """The noise that 15 parameters absorb from 40 blocks is corrected."""
    _, _, factors, freedoms = study(0.0, p=p)
    # three standard deviations of the mean of 150 factors
    error = np.std(np.mean(factors, axis=1)) / np.sqrt(len(factors))
    assert np.mean(factors) == pytest.approx(1.0, abs=3 * error)
    assert error < 0.04
    assert 20 < np.mean(freedoms) <= 40


@pytest.mark.parametrize("rho", [0.0, 0.7, 0.95])
def test_ninety_per_cent_intervals_cover_the_truth(rho):
    errors, deviations, _, freedoms = study(rho)
    inside = np.abs(errors) < NORMAL * np.sqrt(freedoms / (freedoms - 2)) * deviations
    # 450 intervals: 1.4 % for one standard deviation
    assert 0.87 < inside.mean() < 0.93


def test_slow_residuals_count_beyond_a_block():
    """Noise is correlated over three blocks of 30 rows; the regressor is slow."""
    rng = np.random.default_rng(1)
    n, blocks = 3000, 100
    grams, place = np.full((blocks, 1, 1), 30.0), np.zeros((blocks, 2), dtype=int)
    place[:, 1] = np.arange(blocks)
    ratio = []
    for _ in range(200):
        noise = coloured(rng, n, 0.98)
        mean = noise.mean()
        scores = (noise - mean).reshape(blocks, 30).sum(axis=1)[:, None]
        found = scatter(grams, scores, place, noise.var())
        ratio.append([mean**2, found.factor[0] * found.white[0]])
    true, estimated = np.mean(ratio, axis=0)
    assert estimated == pytest.approx(true, rel=0.3)


def test_blocks_of_other_recordings_are_no_neighbours():
    """The same scores, in one recording and in one recording for each block."""
    rng = np.random.default_rng(2)
    scores = np.repeat(rng.normal(size=(20, 1)), 2, axis=0)
    grams = np.ones((40, 1, 1))
    together = np.column_stack([np.zeros(40, int), np.arange(40)])
    separate = np.column_stack([np.arange(40), np.zeros(40, int)])
    joined = scatter(grams, scores, together)
    apart = scatter(grams, scores, separate)
    assert joined.factor[0] > 1.25 * apart.factor[0]
    # By hand: equal neighbours are one block; the part absorbed by the fit is added,
    # and the correlation of neighbours counts on both sides.
    sums = scores.reshape(20, 2).sum(axis=1)
    plain = sums @ sums / (40 * (1 - 1 / 20))
    absorbed = plain * 40 / 20**2
    products = (sums[:-1] * sums[1:] + absorbed).mean()
    correlation = products / ((sums**2 + absorbed).mean())
    expected = plain * max(1 + 2 * correlation, 0.5)
    assert joined.factor[0] == pytest.approx(expected, rel=1e-9)


def test_undetermined_parameters_have_no_variance():
    grams = np.zeros((20, 2, 2))
    grams[:, 0, 0] = 1.0
    scores = np.zeros((20, 2))
    scores[:, 0] = np.random.default_rng(0).normal(size=20)
    place = np.column_stack([np.zeros(20, int), np.arange(20)])
    found = scatter(grams, scores, place)
    assert np.isfinite(found.factor[0])
    assert np.isnan(found.factor[1])
    assert found.scores[:, 1].tolist() == [0.0] * 20


def test_a_parameter_of_one_block_has_the_factor_of_the_others():
    """The fit leaves no residual in its block to estimate the noise."""
    rng = np.random.default_rng(3)
    grams = np.zeros((30, 2, 2))
    grams[:, 0, 0] = 1.0
    grams[4, 1, 1] = 1.0
    scores = np.zeros((30, 2))
    scores[:, 0] = 3.0 * rng.normal(size=30)
    place = np.column_stack([np.zeros(30, int), np.arange(30)])
    found = scatter(grams, scores, place)
    assert found.factor[1] == pytest.approx(found.factor[0], rel=0.1)
    assert np.isnan(found.freedom[1])
    # Its scores are zero: the covariance is NaN, not zero.
    covariance = found.scores.T @ found.scores
    assert np.isnan(covariance[1]).all()
    assert covariance[0, 0] == pytest.approx(found.factor[0] * found.white[0])
