"""Projection: closed form, independent optimum, optimality, invariances, errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from sklearn_vbjfa.physical import (
    Options,
    PhysicalProjector,
    ProjectionError,
    _solver,
    body_scales,
)
from tests.physical._problems import cvxopt_projection, metric, robot

seeds = st.integers(0, 2**31 - 1)
constraints = st.sampled_from(["pseudo-inertia", "eq30"])
properties = settings(derandomize=True, deadline=None, max_examples=15)

FLAT = np.array([2.0, 0, 0, 0, 1, 0, 1, 0, 0, 3])
# Powers of length in the units of the ten parameters of a body.
POWERS = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])


def project(theta, metric=None, constraint="pseudo-inertia", **options):
    projector = PhysicalProjector(constraint, metric=metric, options=Options(**options))
    return projector.fit_transform([theta])[0]


def inconsistent_robot(rng, n_bodies, n_extra=1, noise=0.5):
    """Robot with noise of the order of its parameters added to them."""
    theta = robot(rng, n_bodies, n_extra)
    return theta + noise * rng.normal(size=theta.size) * (np.abs(theta) + 0.2)


def test_closed_form_of_the_flat_body():
    result = project(FLAT, np.diag([1.0] * 9 + [4.0]))
    expected = FLAT.copy()
    expected[[4, 6, 9]] = 13 / 9, 13 / 9, 26 / 9
    # The margin moves the boundary by 1e-8 of the body's size, the solver ends near it.
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-6)


def test_columns_without_a_body_are_projected_on_the_non_negative_ones():
    # Minimise x1^2 + x0^2 + (x0 - x1)^2 about (0, -1) with x1 >= 0: x1 = 0, and the
    # derivative by x0 vanishes at x0 = 1 / 2.
    A = np.array([[2.0, -1.0], [-1.0, 2.0]])
    result = project([0.0, -1.0], A, body_starts=[], nonnegative=[1])
    np.testing.assert_allclose(result, [0.5, 0.0], rtol=0, atol=1e-7)


def test_free_columns_keep_their_sign():
    rng = np.random.default_rng(0)
    theta = inconsistent_robot(rng, 2, n_extra=3)
    theta[[11, 24]] = -2.0
    nonnegative = [10, 12, 23, 25]
    theta[nonnegative] = -1.0
    result = project(theta, body_starts=[0, 13], nonnegative=nonnegative)
    np.testing.assert_allclose(result[[11, 24]], -2.0, rtol=1e-6)
    assert (result[nonnegative] >= 0).all()


def anchor_weight(A, rank, weight=1e-10):
    """Documented weight of the anchor, in scaled units; rank None: full rank."""
    if rank is None:
        return np.zeros_like(A)
    diagonal, nonnegative = np.diag(A), np.arange(10, len(A), 11)
    largest = diagonal[np.setdiff1d(np.arange(len(A)), nonnegative)].max()
    units = np.ones(len(A))
    units[nonnegative] = np.sqrt(largest / diagonal[nonnegative])
    _, basis = np.linalg.eigh(A * np.outer(units, units))
    null_space = basis[:, : len(A) - rank] / units[:, None]
    return weight * largest * null_space @ null_space.T


conditionings = st.sampled_from(
    [(1.0, None), (1e4, None), (1e10, None), (1e3, 0.6), (1e8, 0.8)]
)


@properties
@given(seeds, constraints, st.integers(1, 4), conditionings)
def test_objective_is_the_optimum_of_an_independent_solver(
    seed, constraint, n_bodies, conditioning
):
    condition, share = conditioning
    rng = np.random.default_rng(seed)
    theta = inconsistent_robot(rng, n_bodies)
    rank = None if share is None else int(share * theta.size)
    A = metric(rng, theta.size, condition, rank)
    starts, kept = np.arange(0, theta.size, 11), np.arange(10, theta.size, 11)
    result = project(theta, A, constraint, margin=1e-6)
    # The margin is in scaled units of the bodies.
    mass, length = body_scales(theta[None, starts[:, None] + np.arange(10)])
    units = np.ones((n_bodies, 11))
    units[:, :10] = mass[:, None] * length[:, None] ** POWERS
    units = units.ravel()
    # With the documented anchor both have the same unique minimum.
    full = A * np.outer(units, units)
    full = full + anchor_weight(full, rank)
    _, optimum = cvxopt_projection(theta / units, full, constraint, starts, kept, 1e-6)
    delta = (result - theta) / units
    reached = delta @ full @ delta
    if (result == theta).all():
        assert optimum <= 1e-12
        return
    # The certified gap of the worst of these metrics, and the error of the oracle.
    assert optimum * (1 - 1e-6) <= reached <= optimum * (1 + 2e-5)


@properties
@given(seeds, constraints)
def test_a_consistent_vector_is_returned_unchanged(seed, constraint):
    rng = np.random.default_rng(seed)
    theta = robot(rng, 3)
    result = project(
        theta,
        metric(rng, theta.size, 1e8, 20),
        constraint=constraint,
        anchor=robot(rng, 3),
    )
    np.testing.assert_array_equal(result, theta)


@pytest.mark.parametrize("seed", [1, 3, 10])
def test_a_nearly_massless_anchor_does_not_outweigh_the_metric(seed):
    rng = np.random.default_rng(seed)
    theta, anchor = inconsistent_robot(rng, 3), robot(rng, 3)
    A, distances = metric(rng, theta.size, 1e7, 20), []
    for factor in (1.0, 1e-3):
        anchor[11:21] *= factor
        change = project(theta, A, anchor=anchor) - theta
        distances.append(change @ A @ change)
    assert distances[1] == pytest.approx(distances[0], rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_a_light_body_does_not_move_a_heavy_one(seed):
    rng = np.random.default_rng(seed)
    heavy, light = robot(rng, 1), 1e-4 * inconsistent_robot(rng, 1)
    A, small = (metric(rng, heavy.size, 1e8, 7) for _ in range(2))
    theta, anchor = np.r_[heavy, light], np.r_[robot(rng, 1), 1e-4 * robot(rng, 1)]
    moved = project(theta, block_diag(A, 1e8 * small), anchor=anchor)[:11] - heavy
    assert moved @ A @ moved < 2e-6


def test_rounding_of_a_singular_regression_is_removed_with_a_warning():
    rng = np.random.default_rng(6)
    theta = inconsistent_robot(rng, 3)
    basis, _ = np.linalg.qr(rng.normal(size=(33, 33)))
    A = basis[:, :20] @ basis[:, :20].T
    clean = project(basis[:, :20] @ basis[:, :20].T @ theta, A)
    disturbed = theta + 1e9 * basis[:, 20:] @ rng.normal(size=13)
    with pytest.warns(UserWarning, match="rounding of a singular regression"):
        result = project(disturbed, A)
    assert np.abs(result).max() < 1e2
    # The disturbed vector is only known to 1e9 times the machine precision.
    np.testing.assert_allclose(A @ result, A @ clean, rtol=0, atol=1e-3)


def test_unfinished_solve_raises_and_returns_nothing(monkeypatch):
    monkeypatch.setattr(_solver, "_MAX_STEPS", 1)
    theta = inconsistent_robot(np.random.default_rng(0), 3)
    with pytest.raises(ProjectionError, match="clarabel ended with MaxIter"):
        project(theta)
    with pytest.raises(ProjectionError):
        PhysicalProjector("eq30").fit_transform(theta[None])


INDEFINITE = np.eye(10)
INDEFINITE[0, 1] = INDEFINITE[1, 0] = 2.0


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"metric": np.eye(9)}, "metric"),
        ({"metric": INDEFINITE}, "metric"),
        ({"metric": np.triu(INDEFINITE)}, "symmetric"),
        ({"metric": np.full((10, 10), np.nan)}, "metric"),
        ({"constraint": "triangle"}, "constraint"),
        ({"margin": 0.0}, "margin"),
        ({"anchor": np.ones(9)}, "inconsistent"),
        ({"theta": np.where(np.arange(10) == 3, np.nan, FLAT)}, "NaN"),
    ],
)
def test_invalid_arguments_are_named(options, name):
    with pytest.raises(ValueError, match=name):
        project(**{"theta": FLAT, **options})
