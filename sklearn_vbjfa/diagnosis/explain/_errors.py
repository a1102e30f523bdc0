"""Errors on the held-out part, which is looked at here and only once."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.diagnosis.explain._curves import (
    residual_curves,
    torque_curves,
    worst_joints,
)
from sklearn_vbjfa.diagnosis.explain._final import FinalFit, added_effects, quantile
from sklearn_vbjfa.diagnosis.explain._gaps import memory_seconds
from sklearn_vbjfa.diagnosis.explain._split import FEWEST_VALUES
from sklearn_vbjfa.effects import Shaped
from sklearn_vbjfa.equations._equations import torque_spread
from sklearn_vbjfa.fit._identifier import RobotIdentifier

# Time for which errors are predicted [s].
NEXT_SECONDS = 50.0
# Slowest cosines of time whose mean square is the long-run variance. Few of them leave
# residuals that are slow their full variance, and Student's t knows how few they are
# (equal-weighted cosines with fixed-b critical values: Lazarus, Lewis, Stock, Watson,
# "HAR inference: recommendations for practice", J. Bus. Econ. Stat. 36(4), 2018).
_COSINES = 10


@dataclass(frozen=True, kw_only=True, eq=False)
class Models:
    """The models of a discovery, fitted to the rows of the search."""

    # as declared, with the four plain terms, and with the effects as well
    declared: RobotIdentifier
    plain: RobotIdentifier
    judged: RobotIdentifier


def judge(models, found, split, near, whole):
    """Measure the errors of `Models` on the held-out part; returns plain data."""
    # found: result of the search; near: the split with the rows that the search looked
    # at. Arrays (nv,) and (2, nv) are over the deviation of the torque.
    completed, view = models.judged, found.model.view
    dt, step = completed.dt, view.step
    memory = max(memory_seconds(found.model), default=0.0)
    # No guard is long enough for a memory without end.
    guard = int(min(memory / dt, whole.n_samples))
    shaped = [e for e in found.effects if isinstance(e, Shaped)]
    instants = [getattr(e, name) for e in shaped for name in e.jumping]
    kept = split.decided(whole.t, instants).guarded(guard)
    rest = kept.held_out(whole)
    residuals = {
        one: _numbered(one.robot_.residuals_of(rest), kept.stretches)
        for one in dict.fromkeys((models.declared, models.plain, completed))
    }
    moving, after = residuals[models.declared], residuals[completed]
    # The same rows for all: at rest the torque of a joint is predicted as well where
    # its friction has a memory.
    before, plain = (
        replace(residuals[one], weight=after.weight)
        for one in (models.declared, models.plain)
    )
    added = added_effects(
        completed, len(completed.effects_) - len(models.plain.effects_)
    )
    fit = FinalFit(models.plain, completed, view.corrected(()), added)
    of_plain, of_after = (_numbered(x, near.searched_parts) for x in fit.residuals())
    of_before, fitted = of_plain, replace(of_plain, weight=view.moving)
    if models.declared is not models.plain:
        own = models.declared.robot_.residuals_of(near.searched(whole))
        own = _numbered(own, near.searched_parts)
        of_before = replace(own, weight=of_plain.weight)
    if near is not split:
        fitted = models.plain.robot_.residuals_of(split.searched(whole))
        # A joint whose channel carries no information counts nowhere here.
        fitted = replace(fitted, weight=fitted.weight * view.root.any(axis=0))
    spread = torque_spread(fitted, moving)
    searched = of_before, of_after
    intervals = error_intervals((before, after), searched, spread, step)
    beyond = error_intervals((plain, after), (of_plain, of_after), spread, step)
    intervals |= {"plain": beyond["before"], "added": beyond["difference"]}
    columns = {
        "before": before.relative_error(spread),
        "plain": plain.relative_error(spread),
        "after": after.relative_error(spread),
        "spread": spread,
    }
    # Rows in which a joint moves throughout have its largest weight.
    full = np.maximum(before.weight.max(axis=0), np.finfo(float).tiny)
    seconds = (before.weight / full).sum(axis=0) * step
    values = 2.0 * min(completed.cutoff_, 0.5 / dt) * seconds
    columns |= {"seconds": seconds, "enough": values >= FEWEST_VALUES}
    worst = worst_joints(columns["after"])
    return {
        "columns": columns,
        "intervals": intervals,
        "looked_at": _looked_at(view, split),
        "settings": {
            "held_out_seconds": before.weight.shape[0] * float(step),
            "guard_seconds": float(guard * dt),
        },
        "curves": {
            "index": before.index,
            "residuals": residual_curves(after, dt, worst),
            "torques": torque_curves(before, after, whole.t, worst),
        },
    }


def _looked_at(view, split):
    """Count the samples that a view has of the rows of the search; 0 if all."""
    there = sum(part.stop - part.start for part in split.searched_parts)
    seen = view.states.shape[0]
    return seen if seen < there else 0


def _numbered(part, slices):
    """Count the rows of residuals of some slices in the whole recording."""
    edges = np.cumsum([0, *(s.stop - s.start for s in slices)])
    own = np.searchsorted(edges, part.index, side="right") - 1
    starts = np.array([s.start for s in slices])
    return replace(part, index=part.index - edges[own] + starts[own])


# -- intervals -------------------------------------------------------------------------


def error_intervals(held_out, searched, spread, step):
    """Return 90 % intervals (2, nv) of errors over the next seconds of such motion."""
    # held_out, searched: residuals before and after, whose indices count the rows of
    # the whole recording; spread (nv,) counts as given. An error is a mean over time,
    # of the next stretch as of the held-out one, and both scatter: the slow variation
    # of the squared residual in both parts of the recording shows by how much.
    index = np.concatenate([searched[0].index, held_out[0].index])
    order = np.argsort(index, kind="stable")
    weight, *residuals = (
        np.concatenate([getattr(pair[k], name) for pair in (searched, held_out)])[order]
        for k, name in ((0, "weight"), (0, "residual"), (1, "residual"))
    )
    m, nv = weight.shape
    errors = [part.relative_error(spread) for part in held_out]
    total = weight.sum(axis=0)
    freedom = min(_COSINES, m // 4)
    if freedom < 1:
        return dict.fromkeys(
            ("before", "after", "difference"), np.full((2, nv), np.nan)
        )
    time = (np.arange(m) + 0.5) / m
    cosines = np.cos(np.pi * np.outer(np.arange(1, freedom + 1), time))
    cosines *= np.sqrt(2.0 / m)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Of the logarithm of an error, about its mean over the rows that count.
        parts = [0.5 * (_shares(weight, r, total) - weight) for r in residuals]
        parts.append(errors[1] * parts[1] - errors[0] * parts[0])
        # The variance of a mean over rows that count as in the whole recording.
        rows = held_out[0].weight
        reach = rows.shape[0] / rows.sum(axis=0) ** 2
        reach = reach + (m / total) ** 2 * step / NEXT_SECONDS
        half = [
            quantile(freedom) * np.sqrt(((cosines @ part) ** 2).mean(axis=0) * reach)
            for part in parts
        ]
        difference = errors[1] - errors[0]
        return {
            "before": errors[0] * np.exp([-half[0], half[0]]),
            "after": errors[1] * np.exp([-half[1], half[1]]),
            "difference": difference + np.array([-half[2], half[2]]),
        }


def _shares(weight, values, total):
    """Weighted squares over their mean; zero where all are."""
    squares = weight * values**2
    mean = squares.sum(axis=0) / total
    return np.where(mean > 0, squares / np.where(mean > 0, mean, 1.0), 0.0)
