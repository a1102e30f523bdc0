"""Errors on the held-out part, which is looked at here and only once."""

from dataclasses import replace

import numpy as np
from scipy import special

from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.diagnosis.explain._curves import residual_curves, torque_curves
from sklearn_vbjfa.diagnosis.explain._gaps import memory_seconds
from sklearn_vbjfa.diagnosis.explain._split import FEWEST_VALUES
from sklearn_vbjfa.effects import Sudden
from sklearn_vbjfa.equations._equations import torque_spread

# Time for which errors are predicted [s].
NEXT_SECONDS = 50.0
# Slowest cosines of time whose mean square is the long-run variance. Few of them leave
# residuals that are slow their full variance, and Student's t knows how few they are
# (equal-weighted cosines with fixed-b critical values: Lazarus, Lewis, Stock, Watson,
# "HAR inference: recommendations for practice", J. Bus. Econ. Stat. 36(4), 2018).
_COSINES = 10
# Share of the absolute residuals below the threshold of collision detection.
_BELOW = 0.999
# Joints whose curves are drawn, those with the largest errors.
_WORST = 3


def judge(loop, found, split, near, whole):
    """Measure the errors of the models of a loop on the held-out part; plain data."""
    # found: result of the search; near: the split with the rows that the search looked
    # at. Arrays (nv,) and (2, nv) are over the deviation of the torque.
    declared, plain = loop.declared_, loop.baseline_
    completed, view, dt = loop.validation_model_, found.view, declared.dt
    # No guard is long enough for a memory without end.
    guard = int(min(memory_seconds(found) / whole.dt, whole.n_samples))
    instants = [one.instant for one in found.effects if isinstance(one, Sudden)]
    kept = split.decided(whole.t, instants).guarded(guard)
    used, seen = view.root.any(axis=0), len(view.states)

    def residuals(part, rows):
        """Residuals of each model on some rows of the whole recording."""
        every = dict.fromkeys((declared, plain, completed))
        found = {one: one.robot_.residuals_of(part) for one in every}
        return {one: replace(x, index=rows[x.index]) for one, x in found.items()}

    def alike(found, used=1.0):
        """Residuals in the same rows for all models."""
        # At rest the torque of a joint is predicted as well where its friction has a
        # memory.
        weight = found[completed].weight * used
        return {one: replace(x, weight=weight) for one, x in found.items()}

    held_out = residuals(kept.held_out(whole), kept.held_out_rows)
    searched = residuals(near.searched(whole), near.rows)
    fitted = searched[plain]
    if near is not split:
        fitted = plain.robot_.residuals_of(split.searched(whole), predicts=False)
    # A joint whose channel carries no information counts nowhere.
    fitted = replace(fitted, weight=fitted.weight * used)
    spread = torque_spread(fitted, held_out[declared])
    held_out, searched = alike(held_out), alike(searched, used)
    before, after = held_out[declared], held_out[completed]
    weight = after.weight

    def intervals(model):
        pairs = ((x[model], x[completed]) for x in (held_out, searched))
        return error_intervals(*pairs, spread, view.step)

    # Rows in which a joint moves throughout have its largest weight.
    full = np.maximum(weight.max(axis=0), np.finfo(float).tiny)
    seconds = (weight / full).sum(axis=0) * view.step
    values = 2.0 * min(completed.cutoff_, 0.5 / dt) * seconds
    most = np.full(spread.size, np.nan)
    for j in np.flatnonzero((weight > 0).any(axis=0)):
        residual = after.residual[weight[:, j] > 0, j]
        most[j] = np.quantile(np.abs(residual), _BELOW)
    error = after.relative_error(spread)
    order = np.argsort(-np.nan_to_num(error, nan=-1.0), kind="stable")
    worst = order[:_WORST].tolist()
    return {
        "columns": {
            "before": before.relative_error(spread),
            "plain": held_out[plain].relative_error(spread),
            "after": error,
            "spread": spread,
            "threshold": most,
            "seconds": seconds,
            "enough": values >= FEWEST_VALUES,
            "searched": used,
        },
        "intervals": intervals(declared) | {"added": intervals(plain)["difference"]},
        # 0 if the search looked at all samples
        "looked_at": seen if seen < split.rows.size else 0,
        "settings": {
            "held_out_seconds": len(weight) * float(view.step),
            "guard_seconds": float(guard * dt),
        },
        "curves": {
            "index": before.index,
            "residuals": residual_curves(after, dt, worst),
            "torques": torque_curves(before, after, whole.t, worst),
        },
    }


# -- intervals -------------------------------------------------------------------------


def error_intervals(held_out, searched, spread, step):
    """Return 90 % intervals (2, nv) of an error and its change in the next motion."""
    # held_out, searched: residuals before and after. An error is a mean over time, and
    # the next stretch scatters as the held-out one does: the slow variation of the
    # squared residual in both parts of the recording shows by how much.
    index = np.concatenate([searched[0].index, held_out[0].index])
    order = np.argsort(index, kind="stable")

    def in_time(name, k):
        values = [getattr(x[k], name) for x in (searched, held_out)]
        return np.concatenate(values)[order]

    weight = in_time("weight", 0)
    (m, nv), total = weight.shape, weight.sum(axis=0)
    freedom = min(_COSINES, m // 4)
    if freedom < 1:
        return dict.fromkeys(("after", "difference"), np.full((2, nv), np.nan))
    before, after = (part.relative_error(spread) for part in held_out)
    waves = np.outer(np.arange(1, freedom + 1), np.arange(m) + 0.5)
    cosines = np.sqrt(2.0 / m) * np.cos(np.pi * waves / m)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Of the logarithm of each error, about its mean over the rows that count.
        squares = [weight * in_time("residual", k) ** 2 for k in (0, 1)]
        own = [0.5 * (x / or_one(x.sum(axis=0) / total) - weight) for x in squares]
        # The variance of a mean over rows that count as in the whole recording.
        rows = held_out[0].weight
        reach = len(rows) / rows.sum(axis=0) ** 2
        reach = reach + (m / total) ** 2 * step / NEXT_SECONDS

        def half(part):
            """Half the interval of what a mean (m, nv) scatters by."""
            variance = ((cosines @ part) ** 2).mean(axis=0) * reach
            return special.stdtrit(freedom, 0.95) * np.sqrt(variance)

        ends = np.array([[-1.0], [1.0]])
        return {
            "after": after * np.exp(ends * half(own[1])),
            "difference": after
            - before
            + ends * half(after * own[1] - before * own[0]),
        }
