"""Errors on the held-out part, which is used here and only once."""

from dataclasses import replace

import numpy as np
from scipy import fft, special

from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.diagnosis.explain._gaps import memory_seconds
from sklearn_vbjfa.diagnosis.explain._split import FEWEST_VALUES
from sklearn_vbjfa.equations._equations import torque_spread

# Duration of the motion for which errors are predicted [s].
NEXT_SECONDS = 50.0
# Quantile of the absolute residuals that is the threshold of collision detection.
_QUANTILE = 0.999
# Number of the lowest cosines whose mean square estimates the long-run variance. Few of
# them keep the variance of slow residuals, and Student's t accounts for their number
# (equal-weighted cosines with fixed-b critical values: Lazarus, Lewis, Stock, Watson,
# "HAR inference: recommendations for practice", J. Bus. Econ. Stat. 36(4), 2018).
_COSINES = 10


def held_out_errors(discovery, result, split, thinned, whole):
    """Compute the errors of the models of a discovery on the held-out part, a dict."""
    # thinned: the split with the rows that the search used.
    # Arrays (nv,) and (2, nv) are over the standard deviation of the torque.
    declared, plain = discovery.declared_, discovery.baseline_
    completed, view, dt = discovery.validation_model_, result.view, declared.dt
    # The correlation time may be infinite.
    guard = int(min(memory_seconds(result) / whole.dt, whole.n_samples))
    guarded = split.without(whole.t, result.changes).with_guard(guard)
    used, n_rows = view.root.any(axis=0), len(view.states)

    def residuals(part, rows, used=1.0):
        """Residuals of each model on some rows of the whole recording."""
        # Also with equal weights: a completed model whose friction has memory has
        # weight in rows at rest.
        models = dict.fromkeys((declared, plain, completed))
        results = {model: model.robot_.residuals_of(part) for model in models}
        common = {"index": rows[results[completed].index]}
        common["weight"] = results[completed].weight * used
        return results, {model: replace(x, **common) for model, x in results.items()}

    rows = np.r_[guarded.stretches]
    own_weights, held_out = residuals(guarded.held_out(whole), rows)
    fitted, searched = residuals(thinned.searched(whole), thinned.rows, used)
    if thinned.rows.size < split.rows.size:
        searched_rows = split.searched(whole)
        fitted = {plain: plain.robot_.residuals_of(searched_rows, predicts=False)}
    spread = torque_spread(fitted[plain], own_weights[declared])
    weight = held_out[completed].weight

    def intervals(model):
        pairs = ((x[model], x[completed]) for x in (held_out, searched))
        return error_intervals(*pairs, spread, view.step)

    # The held-out part alone has too few samples for the quantile.
    parts = held_out[completed], searched[completed]
    size = np.concatenate([np.abs(x.residual) for x in parts])
    moving = np.concatenate([x.weight > 0 for x in parts])
    sizes = (x[rows] for x, rows in zip(size.T, moving.T))
    thresholds = [
        np.quantile(x, _QUANTILE, method="higher") if x.size else np.nan for x in sizes
    ]
    # A weight is largest in rows whose whole filter window is in motion.
    full = np.maximum(weight.max(axis=0), np.finfo(float).tiny)
    seconds = (weight / full).sum(axis=0) * view.step
    values = 2.0 * min(completed.cutoff_, 0.5 / dt) * seconds
    return {
        "columns": {
            "before": held_out[declared].relative_error(spread),
            "plain": held_out[plain].relative_error(spread),
            "after": held_out[completed].relative_error(spread),
            "spread": spread,
            "threshold": np.array(thresholds),
            "seconds": seconds,
            "enough": values >= FEWEST_VALUES,
            "searched": used,
        },
        "intervals": intervals(declared) | {"added": intervals(plain)["difference"]},
        # 0 if the search used all samples
        "looked_at": n_rows if n_rows < split.rows.size else 0,
        "settings": {
            "held_out_seconds": len(weight) * float(view.step),
            "guard_seconds": float(guard * dt),
        },
        "residuals": (held_out[declared], held_out[completed]),
    }


def error_intervals(held_out, searched, spread, step):
    """Return 90 % intervals (2, nv) of the next motion's error and its change."""
    # held_out, searched: pairs of residuals, before and after. An error is a mean over
    # time, whose variance in the next motion follows from the long-run variance of the
    # squared residual in both parts of the recording.
    parts = searched, held_out
    by_time = np.argsort(np.concatenate([x.index for x, _ in parts]), kind="stable")
    weight = np.concatenate([x.weight for x, _ in parts])[by_time]
    residuals = (np.concatenate([x.residual for x in pair]) for pair in zip(*parts))
    (m, nv), total = weight.shape, weight.sum(axis=0)
    freedom = min(_COSINES, m // 4)
    if freedom < 1:
        return dict.fromkeys(("after", "difference"), np.full((2, nv), np.nan))
    before, after = (part.relative_error(spread) for part in held_out)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Linearised logarithm of each error, about its mean over the weighted rows.
        squares = [weight * residual[by_time] ** 2 for residual in residuals]
        logs = [0.5 * (x / or_one(x.sum(axis=0) / total) - weight) for x in squares]
        # Variance of a mean for rows weighted as in the whole recording.
        rows = held_out[0].weight
        factor = len(rows) / rows.sum(axis=0) ** 2
        factor = factor + (m / total) ** 2 * step / NEXT_SECONDS

        def half_width(values):
            """Return the half-width of the interval of the mean of rows (m, nv)."""
            cosines = fft.dct(values, axis=0, norm="ortho")[1 : freedom + 1]
            variance = (cosines**2).mean(axis=0) * factor
            return special.stdtrit(freedom, 0.95) * np.sqrt(variance)

        ends, change = np.array([[-1.0], [1.0]]), after * logs[1] - before * logs[0]
        difference = after - before + ends * half_width(change)
        after = after * np.exp(ends * half_width(logs[1]))
        return {"after": after, "difference": difference}
