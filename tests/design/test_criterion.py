"""The worth of an information matrix, against least squares done by hand."""

import numpy as np
import pytest

from sklearn_vbjfa.design import Questions, worth

N_MODEL, SPANS = 4, (slice(4, 5), slice(5, 7), slice(7, 8))
N = 8


@pytest.fixture
def rows():
    """Rows of a model of four columns and of effects of one, two and one."""
    rng = np.random.default_rng(3)
    X = rng.normal(size=(300, N)) @ (np.eye(N) + 0.5 * rng.normal(size=(N, N)))
    return X * rng.uniform(0.5, 3.0, size=N)


def questions(effects=True, scale=None):
    scale = np.linspace(0.4, 1.7, N) if scale is None else scale
    if not effects:
        return Questions(N_MODEL, scale[:N_MODEL])
    beside = np.array([[0.0, 1.0, 0.2], [1.0, 0.0, 0.5], [0.2, 0.5, 0.0]])
    return Questions(N_MODEL, scale, SPANS, np.array([1.0, 0.3, 0.7]), beside)


def left(X, column, others):
    """Sum of squares of a column after a regression on others."""
    fit = np.linalg.lstsq(X[:, others], X[:, column], rcond=None)[0]
    return ((X[:, column] - X[:, others] @ fit) ** 2).sum()


def test_evidence_is_what_a_regression_leaves(rows):
    asked = questions()
    X = rows * asked.scale
    told = worth(rows.T @ rows, asked)
    model = list(range(N_MODEL))
    for i, span in enumerate(SPANS):
        own = range(span.start, span.stop)
        alone = np.mean([left(X, c, model) for c in own])
        assert told.alone[i] == pytest.approx(alone, rel=1e-6)
        for k, rival in enumerate(SPANS):
            if k != i:
                others = model + list(range(rival.start, rival.stop))
                beside = np.mean([left(X, c, others) for c in own])
                assert told.beside[i, k] == pytest.approx(beside, rel=1e-6)
                assert told.beside[i, k] <= told.alone[i] + 1e-9


def test_evidence_is_twice_the_likelihood_that_the_wrong_cause_loses(rows):
    # Truth: the model and one effect. Fitted: the model with a rival, and with it.
    rng = np.random.default_rng(0)
    asked = questions(scale=np.ones(N))
    X = 0.2 * rows
    evidence = worth(X.T @ X, asked).beside[0, 2]
    size = 6.0 / np.sqrt(evidence)
    model = X[:, :N_MODEL]
    gains = []
    for _ in range(1500):
        y = model @ np.ones(N_MODEL) + size * X[:, 4] + rng.normal(size=len(X))
        rest = []
        for column in (4, 7):
            A = np.column_stack([model, X[:, column]])
            rest.append(((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2).sum())
        gains.append(rest[1] - rest[0])
    # Both fits have as many columns: what noise they take cancels on average.
    assert np.mean(gains) == pytest.approx(36.0, rel=0.05)


def test_of_equal_conditions_it_is_the_logarithm_of_the_determinant(rows):
    # Turned by orthogonal matrices, and larger: the condition number stays.
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
    told = worth(M, asked).by_information
    np.testing.assert_allclose(told, told.T, rtol=1e-9, atol=1e-12 * np.abs(told).max())
    rng = np.random.default_rng(5)
    for _ in range(5):
        step = rng.normal(size=(n, n))
        step = 1e-5 * np.sqrt(np.outer(np.diag(M), np.diag(M))) * (step + step.T)
        ends = [worth(M + sign * step, asked).value for sign in (1, -1)]
        assert ends[0] - ends[1] == pytest.approx(2 * (told * step).sum(), rel=1e-4)


def test_units_of_coefficients_cancel(rows):
    # A column in other units, with the size of its coefficient in these units.
    factor = np.array([1.0, 1e3, 1.0, 1e-3, 60.0, 1.0, 1.0, 0.1])
    asked = questions()
    changed = questions(scale=asked.scale / factor)
    one = worth(rows.T @ rows, asked)
    other = worth((rows * factor).T @ (rows * factor), changed)
    assert other.value == pytest.approx(one.value, rel=1e-9)
    np.testing.assert_allclose(other.alone, one.alone, rtol=1e-9)
    np.testing.assert_allclose(other.beside, one.beside, rtol=1e-7)
