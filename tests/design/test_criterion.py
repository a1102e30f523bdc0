"""Criterion of an information matrix against explicit least squares."""

import numpy as np
import pytest

from sklearn_vbjfa.design import Questions, worth

N_MODEL, SPANS = 4, (slice(4, 5), slice(5, 7), slice(7, 8))
N = 8


@pytest.fixture
def rows():
    """Draw rows of four model columns and of effects of one, two and one columns."""
    rng = np.random.default_rng(3)
    X = rng.normal(size=(300, N)) @ (np.eye(N) + 0.5 * rng.normal(size=(N, N)))
    return X * rng.uniform(0.5, 3.0, size=N)


def questions(effects=True, scale=None):
    scale = np.linspace(0.4, 1.7, N) if scale is None else scale
    if not effects:
        return Questions(N_MODEL, scale[:N_MODEL])
    rivals = np.array([[0.0, 1.0, 0.2], [1.0, 0.0, 0.5], [0.2, 0.5, 0.0]])
    return Questions(N_MODEL, scale, SPANS, np.array([1.0, 0.3, 0.7]), rivals)


def residual_sum(X, column, others):
    """Return the residual sum of squares of a column regressed on others."""
    fit = np.linalg.lstsq(X[:, others], X[:, column], rcond=None)[0]
    return ((X[:, column] - X[:, others] @ fit) ** 2).sum()


def test_evidence_is_the_residual_sum_of_squares(rows):
    asked = questions()
    X = rows * asked.scale
    criterion = worth(rows.T @ rows, asked)
    model = list(range(N_MODEL))
    for i, span in enumerate(SPANS):
        columns = range(span.start, span.stop)
        alone = np.mean([residual_sum(X, c, model) for c in columns])
        assert criterion.alone[i] == pytest.approx(alone, rel=1e-6)
        for k, rival in enumerate(SPANS):
            if k != i:
                others = model + list(range(rival.start, rival.stop))
                beside = np.mean([residual_sum(X, c, others) for c in columns])
                assert criterion.beside[i, k] == pytest.approx(beside, rel=1e-6)
                assert criterion.beside[i, k] <= criterion.alone[i] + 1e-9


def test_evidence_is_twice_the_log_likelihood_difference_to_the_rival(rows):
    # Truth: model and one effect. Fits: model with this effect, and with a rival.
    rng = np.random.default_rng(0)
    asked = questions(scale=np.ones(N))
    X = 0.2 * rows
    evidence = worth(X.T @ X, asked).beside[0, 2]
    size = 6.0 / np.sqrt(evidence)
    model = X[:, :N_MODEL]
    gains = []
    for _ in range(1500):
        y = model @ np.ones(N_MODEL) + size * X[:, 4] + rng.normal(size=len(X))
        sums = []
        for column in (4, 7):
            A = np.column_stack([model, X[:, column]])
            sums.append(((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2).sum())
        gains.append(sums[1] - sums[0])
    # Both fits have the same number of columns, so that fitted noise cancels.
    assert np.mean(gains) == pytest.approx(36.0, rel=0.05)


def test_worth_at_equal_condition_number_is_the_log_determinant(rows):
    # Rotation and scaling do not change the condition number.
    asked = questions(effects=False, scale=np.ones(N))
    X = rows[:, :N_MODEL]
    M = X.T @ X
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=M.shape))[0]
    before, after = (worth(A, asked).value for A in (M, 7.0 * Q @ M @ Q.T))
    assert after - before == pytest.approx(0.5 * N_MODEL * np.log(7.0), abs=1e-6)


@pytest.mark.parametrize("effects", [True, False])
@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_derivative_by_the_information(rows, effects, size):
    n = N if effects else N_MODEL
    asked = questions(effects)
    X = size * rows[:, :n]
    M = X.T @ X
    grad = worth(M, asked).by_information
    np.testing.assert_allclose(grad, grad.T, rtol=1e-9, atol=1e-12 * np.abs(grad).max())
    rng = np.random.default_rng(5)
    for _ in range(5):
        step = rng.normal(size=(n, n))
        step = 1e-5 * np.sqrt(np.outer(np.diag(M), np.diag(M))) * (step + step.T)
        ends = [worth(M + sign * step, asked).value for sign in (1, -1)]
        assert ends[0] - ends[1] == pytest.approx(2 * (grad * step).sum(), rel=1e-4)


def test_units_of_coefficients_cancel(rows):
    # Columns in other units, with the scale of the coefficient converted.
    factor = np.array([1.0, 1e3, 1.0, 1e-3, 60.0, 1.0, 1.0, 0.1])
    asked = questions()
    changed = questions(scale=asked.scale / factor)
    one = worth(rows.T @ rows, asked)
    other = worth((rows * factor).T @ (rows * factor), changed)
    assert other.value == pytest.approx(one.value, rel=1e-9)
    np.testing.assert_allclose(other.alone, one.alone, rtol=1e-9)
    np.testing.assert_allclose(other.beside, one.beside, rtol=1e-7)
