"""Stepwise selection by partial F-tests on a correlation matrix."""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

# Smallest fraction of a selected feature's variance that the other selected
# features may leave unexplained ("tolerance"; its inverse is the variance
# inflation factor). Half the digits of a pivot are then still correct.
TOLERANCE = np.sqrt(np.finfo(np.float64).eps)

# A residual sum of squares below this fraction of the total one is rounding of the
# correlation matrix: the fit is exact and F-ratios between such fits mean nothing.
EXACT_FIT = 1e-12

# F-ratios that agree this well are ties (duplicate columns in different units), so
# that rounding does not decide which of two duplicates is taken.
TIE = 1e-8


@dataclass(frozen=True, kw_only=True)
class StepwiseStep:
    """One step of a stepwise regression.

    Attributes
    ----------
    feature : int
        Column of X that entered or left the model.

    action : {"enter", "remove"}
        What happened to it.

    F : float
        Partial F-ratio of the feature, on 1 and the residual degrees of freedom of
        the larger of the two models; no unit.

    p_value : float
        Upper tail probability of `F`.
    """

    feature: int
    action: str
    F: float
    p_value: float


@dataclass(frozen=True, kw_only=True)
class StepwiseSelection:
    """Outcome of :func:`select_features`.

    Attributes
    ----------
    selected : ndarray of shape (n_features,), dtype=bool
        Features in the final model.

    path : tuple of StepwiseStep
        Steps in order.

    status : {"converged", "max_iter", "revisited"}
        Why the search ended; "revisited" if rounding proposed a model seen before.
    """

    selected: np.ndarray
    path: tuple
    status: str


def sweep(table, pivot):
    """Sweep a square matrix on one diagonal element (Goodnight, 1979).

    Swept on a set S, a correlation matrix R of [X y] holds ``inv(R_SS)`` in the
    block SS, the standardised coefficients in S y, and in the rest the products of
    what S leaves unexplained: 1 - R^2 of each other feature on the diagonal, the
    residual sum of squares in y y.

    Parameters
    ----------
    table : ndarray of shape (n_columns, n_columns)
        Matrix, possibly swept on other elements; not modified.

    pivot : int
        Row and column to sweep.

    Returns
    -------
    ndarray of shape (n_columns, n_columns)
        Swept matrix.
    """
    column = table[:, pivot].copy()
    row = table[pivot] / column[pivot]
    swept = table - np.outer(column, row)
    swept[pivot] = row
    swept[:, pivot] = -column / column[pivot]
    swept[pivot, pivot] = 1.0 / column[pivot]
    return swept


def select_features(correlation, dof, *, p_enter, p_remove, max_iter):
    """Run forward selection with backward elimination until no test moves a feature.

    Parameters
    ----------
    correlation : ndarray of shape (n_features + 1, n_features + 1)
        Products of the unit-length columns of [X y]; zero rows and columns for
        constants.

    dof : float
        Degrees of freedom of y before any feature enters.

    p_enter, p_remove : float
        A feature enters below `p_enter` and leaves above `p_remove`;
        ``p_enter <= p_remove``.

    max_iter : int or None
        Largest number of steps.

    Returns
    -------
    StepwiseSelection
        Final model, steps and reason of the end.
    """
    n_features = correlation.shape[0] - 1
    selected = np.zeros(n_features, dtype=bool)
    path = []
    if correlation[-1, -1] == 0:
        return StepwiseSelection(selected=selected, path=(), status="converged")
    table = correlation
    visited = {selected.tobytes()}
    while True:
        step = _removal(table, selected, dof, p_remove)
        if step is None:
            step = _entry(table, selected, dof, p_enter)
        if step is None:
            status = "converged"
            break
        if max_iter is not None and len(path) >= max_iter:
            status = "max_iter"
            break
        proposal = selected.copy()
        proposal[step.feature] = step.action == "enter"
        # In exact arithmetic a model never comes back: with Fe(nu) >= Fr(nu) the
        # critical values of the two tests for nu residual degrees of freedom,
        # log RSS + sum over the sizes of log(1 + Fe(nu) / nu) falls strictly at
        # each entry and does not rise at a removal (Miller, 2002).
        if proposal.tobytes() in visited:
            status = "revisited"
            break
        visited.add(proposal.tobytes())
        selected = proposal
        path.append(step)
        if step.action == "enter":
            table = sweep(table, step.feature)
        else:
            # Reverse sweeps would pile up rounding; removals are rare enough to
            # start again from the correlations.
            table = correlation
            for feature in np.flatnonzero(selected):
                table = sweep(table, feature)
    return StepwiseSelection(selected=selected, path=tuple(path), status=status)


def _f_ratio(rss_smaller, rss_larger, dof_larger):
    """Partial F-ratio of nested models that differ by one feature."""
    rss_smaller = np.maximum(rss_smaller, EXACT_FIT)
    rss_larger = np.maximum(rss_larger, EXACT_FIT)
    return (rss_smaller - rss_larger) / (rss_larger / dof_larger)


def _removal(table, selected, dof, p_remove):
    """Least significant selected feature, if its test lets it go."""
    features = np.flatnonzero(selected)
    if features.size == 0:
        return None
    nu = dof - features.size
    increase = table[features, -1] ** 2 / table[features, features]
    F = _f_ratio(table[-1, -1] + increase, table[-1, -1], nu)
    chosen = np.flatnonzero(F <= F.min() * (1 + TIE))[-1]
    p_value = fdtrc(1, nu, F[chosen])
    if not p_value > p_remove:
        return None
    return StepwiseStep(
        feature=int(features[chosen]),
        action="remove",
        F=float(F[chosen]),
        p_value=float(p_value),
    )


def _entry(table, selected, dof, p_enter):
    """Most significant feature outside the model, if its test lets it in."""
    inside = np.flatnonzero(selected)
    features = np.flatnonzero(~selected)
    nu = dof - inside.size - 1
    if nu <= 0:
        return None
    features = features[table[features, features] >= TOLERANCE]
    # An entry must leave the tolerance of the selected features acceptable too.
    inflation = (
        table[inside, inside][:, np.newaxis]
        + table[np.ix_(inside, features)] ** 2 / table[features, features]
    )
    features = features[np.all(inflation * TOLERANCE <= 1, axis=0)]
    if features.size == 0:
        return None
    decrease = table[features, -1] ** 2 / table[features, features]
    F = _f_ratio(table[-1, -1], table[-1, -1] - decrease, nu)
    chosen = np.flatnonzero(F >= F.max() * (1 - TIE))[0]
    p_value = fdtrc(1, nu, F[chosen])
    if not p_value < p_enter:
        return None
    return StepwiseStep(
        feature=int(features[chosen]),
        action="enter",
        F=float(F[chosen]),
        p_value=float(p_value),
    )
