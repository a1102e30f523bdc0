"""Evidence for a group of columns against explicit integrals and densities."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import integrate, special, stats

from sklearn_vbjfa._core._groups import Groups, Overdispersion

ROWS = 30


def problem(k, seed=0, size=1.0):
    """Columns (n, k) of unequal sizes and torques with noise of unit variance."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(ROWS, k)) @ (np.eye(k) + 0.5 * rng.normal(size=(k, k)))
    X *= np.geomspace(0.2, 5.0, k)
    y = size * X @ rng.normal(size=k) / np.linalg.norm(X) + rng.normal(size=ROWS)
    return X, y


def groups_of(X, y, unit, freedom=np.inf):
    """Moments of a single group of columns."""
    return Groups(
        H=(X.T @ X)[None],
        q=(X.T @ y)[None],
        norms=(X**2).sum(axis=0)[None],
        unit=np.asarray(unit)[None],
        freedom=freedom,
    )


def log_density(y, covariance):
    """Return the log density of a zero-mean normal distribution."""
    power = y @ np.linalg.solve(covariance, y)
    return -0.5 * (power + np.linalg.slogdet(2 * np.pi * covariance)[1])


def log_factor(X, y, unit, scale):
    """Log density ratio of the torques with and without the group, for one scale."""
    prior = np.diag((scale * np.asarray(unit)) ** 2)
    noise = np.eye(len(y))
    return log_density(y, noise + X @ prior @ X.T) - log_density(y, noise)


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("size", [0.0, 3.0, 30.0])
def test_evidence_is_the_integral_over_the_half_cauchy_scale(k, size):
    X, y = problem(k, seed=k, size=size)
    unit, width = 1.0 / np.sqrt((X**2).mean(axis=0)), 0.1

    def integrand(log_scale):
        scale = np.exp(log_scale)
        density = stats.halfcauchy.pdf(scale, scale=width) * scale
        return density * np.exp(log_factor(X, y, unit, scale))

    limits = np.log([1e-5, 1e3])
    integral, _ = integrate.quad(integrand, *limits, limit=200)
    found = groups_of(X, y, unit).evidence(width)
    assert_allclose(found, [np.log(integral)], atol=0.01)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_evidence_with_student_noise_is_that_of_its_density(k):
    """The likelihood ratio of a scale is that of a t distribution in k dimensions."""
    X, y = problem(k, seed=k, size=30.0)
    unit, width, freedom = 1.0 / np.sqrt((X**2).mean(axis=0)), 0.1, 8.0
    noise = stats.multivariate_t(shape=np.eye(k), df=freedom)

    def integrand(log_scale):
        scale = np.exp(log_scale)
        volume = np.linalg.slogdet(np.eye(k) + scale**2 * (X * unit).T @ (X * unit))[1]
        gain = log_factor(X, y, unit, scale) + 0.5 * volume
        away = np.sqrt(2 * gain) * np.eye(k)[0]
        factor = noise.logpdf(np.zeros(k)) - noise.logpdf(away) - 0.5 * volume
        return stats.halfcauchy.pdf(scale, scale=width) * scale * np.exp(factor)

    integral, _ = integrate.quad(integrand, *np.log([1e-5, 1e3]), limit=200)
    found = groups_of(X, y, unit, freedom).evidence(width)
    assert_allclose(found, [np.log(integral)], atol=0.01)


@pytest.mark.parametrize("k", [1, 3])
def test_overdispersion_discounts_the_likelihood(k):
    X, y = problem(k, seed=k, size=30.0)
    overdispersion = Overdispersion(ratio=2.5, freedom=6.0, usual=1.5)
    # Noise variance multiplied by the ratio, and Student's t instead of a normal.
    expected = groups_of(*(x / np.sqrt(2.5) for x in (X, y)), np.ones(k), 6.0)
    found = groups_of(X, y, np.ones(k)).discounted(overdispersion)
    assert_allclose(found.evidence(0.1), expected.evidence(0.1), rtol=1e-10)
    t = stats.multivariate_t(shape=np.eye(k), df=6.0)
    away = np.sqrt(2 * 10.0 / 2.5) * np.eye(k)[0]
    ratio = t.logpdf(np.zeros(k)) - t.logpdf(away)
    assert_allclose(overdispersion.discounted(10.0, k), ratio, rtol=1e-10)
    assert_allclose(overdispersion.as_usual().discounted(10.0, k), 10.0 / 1.5)
    assert overdispersion.discounted(-10.0, k) == -4.0


@pytest.mark.parametrize("k", [1, 2, 3])
def test_one_scale_is_the_density_of_the_torques(k):
    X, y = problem(k, seed=4, size=5.0)
    unit = np.linspace(0.5, 2.0, k) / np.sqrt((X**2).mean(axis=0))
    for scale in (0.01, 0.4, 7.0):
        groups = groups_of(X, y, unit)
        found = groups.evidence(0.1) - groups.integrated(0.1, scale)
        assert_allclose(found, [log_factor(X, y, unit, scale)], rtol=1e-8)


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 1000),
    factors=st.lists(st.floats(1e-6, 1e6), min_size=3, max_size=3),
)
def test_units_of_columns_do_not_matter(seed, factors):
    X, y = problem(3, seed, size=5.0)
    factors, unit = np.array(factors), np.array([0.5, 1.0, 2.0])
    one, other = groups_of(X, y, unit), groups_of(X * factors, y, unit / factors)
    assert_allclose(other.evidence(0.1), one.evidence(0.1), rtol=1e-6, atol=1e-6)
    assert_allclose(other.gain(), one.gain(), rtol=1e-6)
    assert_allclose(other.coefficients() * factors, one.coefficients(), rtol=1e-5)


def test_a_column_of_zeros_costs_nothing():
    X, y = problem(2, size=5.0)
    unit = np.array([0.5, 2.0])
    one = groups_of(X, y, unit)
    more = groups_of(np.column_stack([X, np.zeros(ROWS)]), y, [*unit, 0.0])
    assert_allclose(more.evidence(0.1), one.evidence(0.1), rtol=1e-12)
    assert_allclose(more.coefficients()[0], [*one.coefficients()[0], 0.0], rtol=1e-10)
    empty = groups_of(np.zeros((ROWS, 1)), y, [0.0])
    assert_allclose(empty.evidence(0.1), [0.0], atol=1e-12)
    assert not empty.shown().any()


def test_gain_and_coefficients_equal_least_squares():
    X, y = problem(3, size=5.0)
    groups = groups_of(X, y, [1.0, 0.3, 3.0])
    coef, rest, *_ = np.linalg.lstsq(X, y, rcond=None)
    assert_allclose(groups.coefficients()[0], coef, rtol=1e-8)
    assert_allclose(groups.gain(), [y @ y - rest[0]], rtol=1e-8)
    # Even if the model explains nearly all of a column.
    one = groups_of(X[:, :1], y, [1.0])
    nearly = Groups(H=one.H, q=one.q, norms=1e6 * one.norms, unit=one.unit)
    assert_allclose(nearly.gain(), one.gain())


def test_odds_are_calibrated():
    """Half of the groups are present, as in the prior.

    In each interval of probability, the mean probability is the share present.
    """
    rng = np.random.default_rng(0)
    X, _ = problem(2)
    unit = 1.0 / np.sqrt((X**2).mean(axis=0))
    count = 8000
    present = rng.random(count) < 0.5
    scale = np.abs(0.1 * np.tan(0.5 * np.pi * rng.random(count))) * present
    coef = scale[:, None] * unit * rng.normal(size=(count, 2))
    y = coef @ X.T + rng.normal(size=(count, ROWS))
    groups = Groups(
        H=np.broadcast_to(X.T @ X, (count, 2, 2)),
        q=y @ X,
        norms=np.broadcast_to((X**2).sum(axis=0), (count, 2)),
        unit=np.broadcast_to(unit, (count, 2)),
    )
    probability = special.expit(groups.evidence(0.1))
    for low, high in ((0.0, 0.48), (0.48, 0.6), (0.6, 0.9), (0.9, 1.0)):
        chosen = (probability >= low) & (probability <= high)
        mean = probability[chosen].mean()
        std = np.sqrt(mean * (1 - mean) / chosen.sum())
        assert chosen.sum() > 50
        assert abs(present[chosen].mean() - mean) < 3.5 * std + 0.005
