"""How surely the value of an effect in the model is not the one that changes nothing.

A tilt of the base or a gain acts through gravity, as slowly as the poses change, and on
many joints a little. Blocks of rows from which the residual's memory is taken out see
little of that. What such an effect has, other than most, is a value with a meaning,
whose standard error follows from the scatter of its estimating equations between blocks
of time, slow residuals included; its distance from the idle value in that unit is
Wald's test.
"""

import itertools

import numpy as np
from scipy import special

from sklearn_vbjfa._core._sandwich import block_variance
from sklearn_vbjfa.robot._joint_moments import Numbering

# Standard deviations beyond the level of a test from which four in five pass it.
_POWER = 0.84
# Share of a column's power that is the rounding of nothing, ridge included.
_NOTHING = 1e-8


def blocks_of_time(view):
    """Yield the rows of each block of a view, a slice, and its place (recording, k)."""
    edges = [*view.starts.tolist(), view.index.size]
    numbering = Numbering.of(np.diff(edges).tolist())
    for number, (first, last) in enumerate(itertools.pairwise(edges)):
        places, starts = numbering.parts(number, slice(0, last - first))
        begins = [*(first + starts), last]
        for place, (begin, end) in zip(places, itertools.pairwise(begins)):
            yield slice(begin, end), place


def p_of_value(model, effect):
    """p-value of an effect in the model: that its value is idle, after Wald.

    It is one of the `SearchModel`, or comes beside it. 1 where nothing shows it.
    """
    estimate, covariance, freedom = value_and_spread(model, effect)
    # A value that the columns do not show at all has no deviation.
    variance = np.diagonal(covariance)
    shown = np.isfinite(variance) & (variance > 0)
    k = np.count_nonzero(shown)
    if k == 0 or not freedom > k:
        return 1.0
    values, vectors = np.linalg.eigh(covariance[np.ix_(shown, shown)])
    if values[0] <= 1e-12 * values[-1]:
        return 1.0
    away = vectors.T @ (estimate - effect.idle)[shown]
    # Hotelling's T squared.
    ratio = (away**2 / values).sum() * (freedom - k + 1) / (freedom * k)
    return float(special.fdtrc(k, freedom - k + 1, ratio))


def shows(model, effect, level):
    """Whether an effect in the model would be named if it were there.

    Whether a plausible one of its values is so far from the idle one that a test at a
    level finds it in four of five recordings such as this.
    """
    _, covariance, freedom = value_and_spread(model, effect)
    deviation = np.sqrt(np.diagonal(covariance))
    low, high = effect.bounds()
    away = np.maximum(high - effect.idle, effect.idle - low)
    needed = _POWER - special.stdtrit(max(freedom, 1.0), level / 2)
    # Columns of which nothing is left have no deviation.
    known = np.isfinite(deviation) & (deviation > 0)
    return bool((known & (needed * deviation <= away)).any())


def value_and_spread(model, effect):
    """Estimate (k,) of an effect's value, its covariance (k, k) and their freedom.

    All else is fitted beside it; see `p_of_value`.
    """
    view, fitted = model.view, model.fitted
    place = next(
        (p for e, p in zip(model.effects, model.places()) if e is effect), None
    )
    if place is not None:
        scale = next(s for e, s in zip(model.effects, model.scales) if e is effect)
        found = fitted.profile_of(place)
    else:
        columns = model.columns_on_all(effect)
        power = np.sqrt(np.mean(columns**2, axis=(0, 1)))
        scale = view.size / np.where(power > 0, power, 1.0)
        found = fitted.profile(columns * scale)
    hidden = (found.left**2).sum(axis=(0, 1)) <= _NOTHING * found.power
    found.left[:, :, hidden] = 0.0
    count, squares = view.rows, (found.residual**2).sum(axis=1)
    used = (fitted.precision > 0) & (squares > 0)
    weight = np.where(used, fitted.precision, 0.0)
    grams, scores, places = [], [], []
    for rows, where in blocks_of_time(view):
        left = found.left[:, rows]
        grams.append(np.einsum("j,jma,jmb->ab", weight, left, left, optimize=True))
        own = found.residual[:, rows]
        scores.append(np.einsum("j,jma,jm->a", weight, left, own, optimize=True))
        places.append(where)
    variance = float(weight @ squares / max(count[used].sum(), 1.0))
    spread = block_variance(
        np.array(grams), np.array(scores), np.array(places), variance
    )
    covariance = spread.scores.T @ spread.scores * np.outer(scale, scale)
    estimate = effect.values + found.coef * scale
    return estimate, covariance, float(np.fmin.reduce(spread.freedom, initial=np.inf))
