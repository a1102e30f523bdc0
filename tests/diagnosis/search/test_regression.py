"""Scores by the Schur complement against refits written out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa.diagnosis.search._blocks import Blocks
from sklearn_vbjfa.diagnosis.search._regression import (
    BlockRegression,
    FoldMoments,
    reduced,
)
from sklearn_vbjfa.robot._equations import Equations

NV, M, R = 2, 240, 4
PRECISION = np.array([1.0, 7.0])
RIDGE = 1e-4


def make_blocks(n_blocks=24, n_folds=8, m=M):
    label = np.arange(m) * n_blocks // m
    return Blocks(label=label, fold=label % n_folds, length=1.0)


BLOCKS = make_blocks()


def problem(seed=0, c=3, k=2, joints=(1,)):
    """Rows of all joints, and a family of candidates of which one is true."""
    rng = np.random.default_rng(seed)
    root = np.sqrt(rng.uniform(0.2, 1.0, size=(NV, M)))
    root[:, ::17] = 0.0
    Z = rng.normal(size=(NV, M, R)) * np.geomspace(0.1, 10, R) * root[:, :, None]
    F = rng.normal(size=(len(joints), M, c, k)) * np.geomspace(0.01, 100, c)[:, None]
    F += 0.3 * Z[list(joints), :, None, :1]
    F *= root[list(joints)][:, :, None, None]
    y = Z @ rng.normal(size=R) + 0.3 * rng.normal(size=(NV, M)) * root
    y[list(joints)] += F[:, :, 0] @ np.full(k, 50.0)
    return Z, y, F


def regression(Z, y, ridge=RIDGE, precision=PRECISION, blocks=BLOCKS):
    return BlockRegression(Z, y, precision, blocks, ridge)


def ridge_fit(columns, y, penalty, precision=PRECISION):
    """Ridge regression equation by equation; columns (nv, m, p)."""
    root = np.repeat(np.sqrt(precision), columns.shape[1])
    A = columns.reshape(-1, columns.shape[2]) * root[:, None]
    p = A.shape[1]
    rows = np.vstack([A, np.diag(np.sqrt(penalty) * np.ones(p))])
    values = np.r_[y.ravel() * root, np.zeros(p)]
    return np.linalg.lstsq(rows, values, rcond=None)[0]


def unit_of(Z, precision=PRECISION):
    """Mean square column of the declared equations, which the ridge is relative to."""
    return np.mean([precision @ (Z[:, :, i] ** 2).sum(axis=1) for i in range(R)])


def with_candidate(Z, F, i, joints, precision=PRECISION):
    """Append the columns of a candidate, brought to the same size."""
    k = F.shape[3]
    extra = np.zeros((NV, Z.shape[1], k))
    extra[list(joints)] = F[:, :, i]
    power = np.array([precision @ (extra[:, :, c] ** 2).sum(axis=1) for c in range(k)])
    scale = np.sqrt(unit_of(Z, precision) / power)
    return np.concatenate([Z, extra * scale], axis=2), scale


# -- cross-validation


def test_declared_model_is_ridge_fold_by_fold():
    Z, y, _ = problem()
    base = regression(Z, y)
    penalty = RIDGE * unit_of(Z)
    residual = np.empty_like(y)
    for fold in range(BLOCKS.n_folds):
        out = BLOCKS.fold == fold
        theta = ridge_fit(Z[:, ~out], y[:, ~out], penalty)
        residual[:, out] = y[:, out] - Z[:, out] @ theta
    assert_allclose(base.residuals(), residual, atol=1e-9)
    assert_allclose(base.theta, ridge_fit(Z, y, penalty), atol=1e-9)
    squares = [
        (residual[:, BLOCKS.label == b] ** 2).sum(axis=1)
        for b in range(BLOCKS.n_blocks)
    ]
    assert_allclose(base.squares(), squares, rtol=1e-9)


@pytest.mark.parametrize("joints", [(0,), (1,), (0, 1)])
@pytest.mark.parametrize("ridge", [1e-8, 1e-4, 1e-2])
def test_score_is_a_refit_with_the_candidate(joints, ridge):
    """One candidate: everything is refitted in every fold."""
    Z, y, F = problem(seed=3, c=1, joints=joints)
    score = regression(Z, y, ridge).score(list(joints), F)
    columns, scale = with_candidate(Z, F, 0, joints)
    penalty = ridge * unit_of(Z)
    residual = np.empty_like(y)
    for fold in range(BLOCKS.n_folds):
        out = BLOCKS.fold == fold
        theta = ridge_fit(columns[:, ~out], y[:, ~out], penalty)
        residual[:, out] = y[:, out] - columns[:, out] @ theta
    assert_allclose(score.squares, BLOCKS.sums((residual**2).T), rtol=1e-6)
    theta = ridge_fit(columns, y, penalty)
    assert_allclose(score.coef, theta[R:] * scale, rtol=1e-6)
    assert score.best == 0


def test_score_chooses_the_shape_inside_each_fold():
    Z, y, F = problem(seed=5, c=4)
    y = y - F[:, :, 0].sum(axis=2) * [[0.0], [50.0]]  # none is true: folds disagree
    score = regression(Z, y).score([1], F)
    penalty = RIDGE * unit_of(Z)
    columns = [with_candidate(Z, F, i, (1,))[0] for i in range(4)]

    def cost(A, rows):
        theta = ridge_fit(A[:, rows], y[:, rows], penalty)
        rest = y[:, rows] - A[:, rows] @ theta
        return PRECISION @ (rest**2).sum(axis=1) + penalty * theta @ theta, theta

    residual, chosen = np.empty_like(y), []
    for fold in range(BLOCKS.n_folds):
        out = BLOCKS.fold == fold
        fits = [cost(A, ~out) for A in columns]
        chosen.append(int(np.argmin([value for value, _ in fits])))
        theta = fits[chosen[-1]][1]
        residual[:, out] = y[:, out] - columns[chosen[-1]][:, out] @ theta
    assert_allclose(score.squares, BLOCKS.sums((residual**2).T), rtol=1e-6)
    whole = [cost(A, np.ones(M, bool))[0] for A in columns]
    assert score.best == np.argmin(whole)
    assert len(set(chosen)) > 1


def test_drop_is_the_fall_of_the_penalised_error():
    Z, y, F = problem(seed=6)
    base = regression(Z, y)
    penalty = RIDGE * unit_of(Z)

    def cost(A):
        theta = ridge_fit(A, y, penalty)
        return PRECISION @ ((y - A @ theta) ** 2).sum(axis=1) + penalty * theta @ theta

    without = cost(Z)
    score = base.score([1], F)
    for i in range(3):
        fall = without - cost(with_candidate(Z, F, i, (1,))[0])
        assert base.drop([1], F[:, :, [i]]) == pytest.approx(fall, rel=1e-6)
        assert score.drop[i] == pytest.approx(fall, rel=1e-6)
    assert score.best == 0


@settings(deadline=None, max_examples=30)
@given(factor=st.floats(1e-6, 1e6), seed=st.integers(0, 1000))
def test_size_of_a_candidate_does_not_matter(factor, seed):
    Z, y, F = problem(seed)
    base = regression(Z, y)
    one, other = base.score([1], F), base.score([1], factor * F)
    assert_allclose(other.squares, one.squares, rtol=1e-6)
    assert_allclose(other.coef * factor, one.coef, rtol=1e-6)
    assert other.best == one.best
    assert other.outside == pytest.approx(one.outside, rel=1e-6)


def test_unit_of_the_torque_does_not_matter():
    Z, y, F = problem()
    one = regression(Z, y).score([1], F)
    other = regression(Z, 1e3 * y).score([1], F)
    assert_allclose(other.squares, 1e6 * one.squares, rtol=1e-9)
    assert_allclose(other.coef, 1e3 * one.coef, rtol=1e-9)
    rescaled = regression(Z, y, precision=100 * PRECISION).score([1], F)
    assert_allclose(rescaled.squares, one.squares, rtol=1e-9)


def test_a_candidate_on_one_joint_moves_the_others_through_the_parameters():
    Z, y, F = problem(seed=2)
    base = regression(Z, y)
    change = base.squares() - base.score([1], F).squares
    assert np.abs(change[:, 0]).max() > 0


def test_what_the_model_has_already_adds_nothing():
    Z, y, _ = problem()
    base = regression(Z, y, ridge=1e-10)
    F = np.stack([Z[1, :, [0]].T, Z[1, :, [1]].T], axis=1)[None][:, :, :1]
    both = np.concatenate([Z, np.zeros((NV, M, 1))], axis=2)
    both[1, :, -1] = Z[1, :, 0]
    again = BlockRegression(both, y, PRECISION, BLOCKS, 1e-10)
    score = again.score([1], F)
    assert score.outside < 1e-6
    assert_allclose(score.coef, 0.0, atol=1e-9)
    assert_allclose(score.squares, again.squares(), rtol=1e-6)
    assert base.score([1], F).outside > 0.1


def test_an_empty_column_adds_nothing():
    Z, y, F = problem()
    base = regression(Z, y)
    score = base.score([1], 0 * F)
    assert_allclose(score.squares, base.squares(), rtol=1e-9)
    assert_array_equal(score.coef, 0.0)
    assert base.drop([1], 0 * F[:, :, :1]) == 0.0
    assert_array_equal(base.outside([1], 0 * F), 0.0)


# -- span


@pytest.mark.parametrize("joints", [(0,), (1,), (0, 1)])
def test_outside_is_what_projection_leaves(joints):
    Z, y, F = problem(seed=4, joints=joints)
    outside = regression(Z, y, ridge=1e-10).outside(list(joints), F)
    root = np.repeat(np.sqrt(PRECISION), M)
    A = Z.reshape(-1, R) * root[:, None]
    for i in range(F.shape[2]):
        for k in range(F.shape[3]):
            column = np.zeros((NV, M))
            column[list(joints)] = F[:, :, i, k]
            f = column.ravel() * root
            rest = f - A @ np.linalg.lstsq(A, f, rcond=None)[0]
            share = (rest @ rest) / (f @ f)
            assert outside[i, k] == pytest.approx(share, abs=2e-6)


# -- later blocks


def test_forward_squares_are_of_what_comes_later():
    Z, y, _ = problem()
    base = regression(Z, y)
    early = BLOCKS.label < 18
    theta = ridge_fit(Z[:, early], y[:, early], RIDGE * unit_of(Z))
    residual = (y - Z @ theta) ** 2
    expected = [residual[:, BLOCKS.label == b].sum(axis=1) for b in range(18, 24)]
    assert_allclose(base.forward_squares(18), expected, rtol=1e-6)


# -- ridge


def test_ridge_is_the_one_of_least_error():
    Z, y, _ = problem()
    chosen = regression(Z, y, ridge=None)

    def error(ridge):
        return (regression(Z, y, ridge).squares() @ PRECISION).sum()

    ridges = 10.0 ** np.arange(-10, -2)
    assert chosen.ridge == ridges[np.argmin([error(r) for r in ridges])]
    assert_allclose(chosen.theta, regression(Z, y, chosen.ridge).theta)


# -- reduction


def test_reduced_coordinates_give_the_same_torques():
    rng = np.random.default_rng(0)
    Phi = rng.normal(size=(M, NV, 6)) * np.geomspace(1e-3, 1e3, 6)
    Phi[:, :, 4] = 2 * Phi[:, :, 0] - Phi[:, :, 1]  # not determined
    Phi[:, :, 5] = 0.0  # not excited
    weight = rng.uniform(0, 1, size=(M, NV))
    weight[::9] = 0.0
    tau = rng.normal(size=(M, NV))
    Z, back = reduced(Equations(Phi=Phi, tau=tau, weight=weight), PRECISION)
    assert Z.shape == (NV, M, 4)
    assert back.shape == (6, 4)
    u = rng.normal(size=4)
    theta = back @ u
    root = np.sqrt(weight)
    assert_allclose((root * (Phi @ theta)).T, Z @ u, atol=1e-9)
    assert_array_equal(back[5], 0.0)
    # columns of mean square one, apart from the direction
    G = np.einsum("j,jma,jmb->ab", PRECISION, Z, Z)
    assert_allclose(G, np.diag(np.diagonal(G)), atol=1e-6 * np.diagonal(G).max())
    # least squares in reduced coordinates is least squares
    small = np.linalg.lstsq(
        (Z * np.sqrt(PRECISION)[:, None, None]).reshape(-1, 4),
        ((root * tau).T * np.sqrt(PRECISION)[:, None]).ravel(),
        rcond=None,
    )[0]
    rows = (Phi * (root * np.sqrt(PRECISION))[:, :, None]).reshape(-1, 6)
    unit = np.sqrt((rows**2).sum(axis=0))
    unit[5] = 1.0
    full = np.linalg.lstsq(
        rows / unit, (root * np.sqrt(PRECISION) * tau).ravel(), rcond=1e-10
    )[0]
    assert_allclose(Phi @ (back @ small), Phi @ (full / unit), atol=1e-8)


# -- leaving columns out


@pytest.mark.parametrize("groups", [[[0]], [[1], [2, 3]], [[3, 0]]])
def test_squares_without_columns_are_those_of_fits_without_them(groups):
    Z, y, _ = problem(seed=3)
    fitted = regression(Z, y)
    penalty = RIDGE * unit_of(Z)
    groups = [np.array(group) for group in groups]
    for joint in range(NV):
        squares = fitted.squares_without(joint, groups)
        for k, group in enumerate(groups):
            rest = np.setdiff1d(np.arange(R), group)
            expected = np.empty(M)
            for fold in range(BLOCKS.n_folds):
                out = BLOCKS.fold == fold
                theta = ridge_fit(Z[:, ~out][:, :, rest], y[:, ~out], penalty)
                expected[out] = (y[joint, out] - Z[joint, out][:, rest] @ theta) ** 2
            assert_allclose(squares[:, k], BLOCKS.sums(expected), rtol=1e-6)


def test_moments_follow_the_weights():
    """What is kept of the last weights does not outlive them."""
    rng = np.random.default_rng(3)
    Z, y = rng.normal(size=(NV, M, R)), rng.normal(size=(NV, M))
    folds = BLOCKS.folds()
    moments = FoldMoments(Z[:, :, :3], y, folds)
    for precision in (PRECISION, PRECISION, PRECISION[::-1], PRECISION):
        G, g = moments.extended(Z, y, precision)
        for i, rows in enumerate(folds):
            own = [w * z[rows].T @ z[rows] for w, z in zip(precision, Z)]
            assert_allclose(G[i], sum(own))
            right = [w * z[rows].T @ t[rows] for w, z, t in zip(precision, Z, y)]
            assert_allclose(g[i], sum(right))
        # what is returned belongs to who asked
        G[:] = g[:] = 0.0
