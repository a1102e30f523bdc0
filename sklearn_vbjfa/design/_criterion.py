r"""What a motion is worth: how it determines a model and parts what may be missing.

With rows :math:`x_{tj}` and noise :math:`\sigma_j` the information on all coefficients
is :math:`M = \sum_{tj} w_{tj} x_{tj} x_{tj}^T / \sigma_j^2`. That on the model alone is
its block :math:`M_{AA}`. For columns C that the model lacks, :math:`S = M_{CC} - M_{CA}
M_{AA}^{-1} M_{AC}` is what the model cannot imitate of them: a coefficient c of one
effect i leaves :math:`c^T S_{ii} c`, in squared standard errors, beside the model, and
:math:`c^T (S_{ii} - S_{ik} S_{kk}^{-1} S_{ki}) c` beside the model with a rival k: the
largest difference that the two can show at equal fit.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

# Evidence at which two causes count as told apart: a sum of squared differences of 50
# noise variances is a difference of log likelihoods of 25.
DECIDED = 50.0
# What remains to be gained where nothing shows at all, of that.
_HOPELESS = 1e-3
_RIDGE = 1e-9
# Worth of a condition number that is smaller by a factor e, for each parameter [nats],
# and the power of its means of eigenvalues.
BALANCE, _POWER = 3.0, 6.0


@dataclass(frozen=True)
class Decision:
    """An effect that shall show, beside the model or beside a rival as well.

    Attributes
    ----------
    columns : slice
        Columns of the effect.
    beside : slice or None
        Columns of the rival.
    weight : float
        How much it counts.
    """

    columns: slice
    beside: slice | None = None
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class Questions:
    """What a motion is to decide.

    Attributes
    ----------
    n_model : int
        The first columns are those of the model.
    scale : ndarray of shape (n_columns,)
        Sizes of coefficients in which columns are compared.
    decisions : tuple of Decision
        What shall show.
    """

    n_model: int
    scale: np.ndarray
    decisions: tuple = ()


@dataclass(frozen=True, eq=False)
class Worth:
    """Value of a criterion.

    Attributes
    ----------
    value : float
        To be made large [nats].
    by_information : ndarray of shape (n_columns, n_columns)
        Its derivative by the information matrix, symmetric.
    evidence : ndarray of shape (n_decisions,)
        Evidence in each decision, in squared standard errors: the harmonic mean over
        the coefficients of the effect.
    """

    value: float
    by_information: np.ndarray
    evidence: np.ndarray


def worth(information, questions):
    """Judge an information matrix (n_columns, n_columns) of scaled columns."""
    D = questions.scale
    M = information * np.outer(D, D)
    a = slice(0, questions.n_model)
    n = questions.n_model
    A = M[a, a]
    size = np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    factor = cho_factor(A / np.outer(size, size) + _RIDGE * np.eye(n), lower=True)
    value = float(np.log(np.diag(factor[0])).sum() + np.log(size).sum())
    inverse = cho_solve(factor, np.eye(n)) / np.outer(size, size)
    by = np.zeros_like(M)
    by[a, a] = 0.5 * inverse
    told, by_model = _balance(A)
    value += n * BALANCE * told
    by[a, a] += n * BALANCE * by_model
    evidence = np.zeros(0)
    total = sum(decision.weight for decision in questions.decisions)
    if total > 0:
        told, by_left, evidence = _decisions(M, inverse, questions)
        # Together they count as much as the parameters of the model.
        share = n / total
        value += share * told
        L = np.hstack([-M[n:, a] @ inverse, np.eye(len(M) - n)])
        by += share * (L.T @ by_left @ L)
    return Worth(value, by * np.outer(D, D), evidence)


def _balance(A):
    """Minus the logarithm of a smooth condition number, and its derivative by A.

    Power means of the eigenvalues stand for the largest and the smallest.
    """
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, 1e-12 * values[-1])
    high = (values / values[-1]) ** _POWER
    low = (values[0] / values) ** _POWER
    value = -0.5 * (
        np.log(values[-1] / values[0])
        + (np.log(high.sum()) + np.log(low.sum())) / _POWER
    )
    slope = -0.5 * (high / high.sum() - low / low.sum()) / values
    return value, (vectors * slope) @ vectors.T


def _decisions(M, inverse, questions):
    """Value of all decisions, its derivative by S, and the evidence of each."""
    n = questions.n_model
    C = M[n:, :n]
    S = M[n:, n:] - C @ inverse @ C.T
    by = np.zeros_like(S)
    value, evidence = 0.0, []
    for decision in questions.decisions:
        i = _shift(decision.columns, n)
        if decision.beside is None:
            left, slope, found = _decided(S[i, i])
            by[i, i] += decision.weight * slope
        else:
            k = _shift(decision.beside, n)
            Skk = S[k, k]
            ridge = _RIDGE * np.trace(Skk) / len(Skk) + np.finfo(float).tiny
            W = np.linalg.solve(Skk + ridge * np.eye(len(Skk)), S[k, i])
            left, slope, found = _decided(S[i, i] - S[i, k] @ W)
            slope = decision.weight * slope
            by[i, i] += slope
            by[k, k] += W @ slope @ W.T
            cross = -slope @ W.T
            by[i, k] += cross
            by[k, i] += cross.T
        value += decision.weight * left
        evidence.append(found)
    return value, by, np.array(evidence)


def _decided(left):
    """Value of what is left of an effect, its derivative, and the evidence.

    The value is -log(1 + DECIDED / evidence) / 2: nearly all is gained once the
    evidence is larger than what decides, and where it is small a doubling is worth the
    same everywhere.
    """
    k = len(left)
    floor = _HOPELESS * DECIDED
    inverse = np.linalg.inv(left + floor * np.eye(k))
    inverse = 0.5 * (inverse + inverse.T)
    total = np.trace(inverse) / k  # 1 / (evidence + floor)
    value = -0.5 * np.log1p(DECIDED * total)
    slope = 0.5 * DECIDED / (1 + DECIDED * total) * (inverse @ inverse) / k
    return value, slope, 1.0 / total - floor


def _shift(columns, n):
    return slice(columns.start - n, columns.stop - n)


def information_of(equations, places, n_columns, weight):
    """Information matrix (n_columns, n_columns) of rows with weights (n, nv)."""
    M = np.zeros((n_columns, n_columns))
    for j, (rows, place) in enumerate(zip(equations.rows, places)):
        M[np.ix_(place, place)] += (rows * weight[:, j]) @ rows.T
    return M
