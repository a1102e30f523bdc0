"""The errors on the held-out part, which is looked at here and only once."""

import copy
import warnings
from dataclasses import dataclass, field, replace

import numpy as np

from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.diagnosis.explain._curves import (
    TimeLine,
    over_time,
    residual_curves,
    time_line,
)
from sklearn_vbjfa.diagnosis.explain._gaps import SMALLEST_GAIN, memory_seconds
from sklearn_vbjfa.diagnosis.explain._identified import recorded_motion
from sklearn_vbjfa.diagnosis.explain._intervals import FinalFit, error_intervals
from sklearn_vbjfa.diagnosis.explain._split import FEWEST_VALUES
from sklearn_vbjfa.effects import Shaped
from sklearn_vbjfa.equations._equations import torque_spread
from sklearn_vbjfa.fit._identifier import RobotIdentifier
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.robot._windows import CommandFollower, warn_once

# At most so much of the held-out part is simulated [s]: the beginnings of its
# stretches.
_SIMULATED = 60.0
# The wider band reaches this many times as far as that of the fit, and at least to
# the frequency [Hz] at which controllers act.
_WIDER, _CONTROL = 4.0, 10.0
# Share of the sample rate up to which it may reach.
_HIGHEST = 0.4


@dataclass(frozen=True, kw_only=True, eq=False)
class Models:
    """The models of a loop, fitted to the search part."""

    # as declared, with the four plain terms, and with the effects as well
    declared: RobotIdentifier
    plain: RobotIdentifier
    judged: RobotIdentifier


# -- errors of the torque --------------------------------------------------------------


def judge(models, found, split, near, whole, commanded):
    """Judge the `Models` of a loop; returns fields, settings and curves of `Outcome`.

    They were fitted to the rows of the search, in which `found` was found; near: the
    split with those of these rows that were looked at; commanded: the recording with
    the channels of its drive.
    """
    completed, view = models.judged, found.model.view
    dt, step = completed.dt, view.step
    memory = memory_seconds(found.model)
    # Of a memory without end nothing is far enough.
    guard = int(min(max(memory, default=0.0) / dt, whole.n_samples))
    shaped = [e for e in found.effects if isinstance(e, Shaped)]
    instants = [getattr(e, name) for e in shaped for name in e.jumping]
    kept = split.decided(whole.t, instants).guarded(guard)
    rest = kept.untouched(whole)
    (before, plain, after), wide, wide_cutoff = _held_out(models, kept, rest, whole)
    fit = FinalFit(
        models.plain,
        completed,
        view.corrected(()),
        completed.effects_[len(models.plain.effects_) :],
    )
    of_plain, of_after = (_numbered(x, near.searched_parts) for x in fit.residuals())
    of_before, fitted = of_plain, of_plain
    if models.declared is not models.plain:
        own = models.declared.robot_.residuals_of(near.searched(whole))
        own = _numbered(own, near.searched_parts)
        of_before = replace(own, weight=of_plain.weight)
    if near is not split:
        fitted = models.plain.robot_.measured(split.searched(whole))
        # A joint whose channel carries no information counts nowhere here.
        used = view.root.any(axis=0)
        fitted = replace(fitted, weight=fitted.weight * used)
    spread = torque_spread(fitted, before)
    searched = of_before, of_after
    intervals = error_intervals((before, after), searched, spread, step)
    beyond = error_intervals((plain, after), (of_plain, of_after), spread, step)
    intervals |= {"plain": beyond["before"], "added": beyond["difference"]}
    # Rows in which a joint moves throughout have its largest weight.
    full = np.maximum(before.weight.max(axis=0), np.finfo(float).tiny)
    seconds = (before.weight / full).sum(axis=0) * step
    cost = None
    if completed.projector_ is not None:
        free = without_constraints(completed).robot_.residuals_of(rest)
        of_free = fit.residuals_of(completed.theta_unconstrained_)
        of_free = _numbered(of_free, near.searched_parts)
        parts = (_numbered(free, kept.stretches), after), (of_free, of_after)
        cost = cost_of(*parts, spread, step)
    alone, positions = commands_alone(models, kept.stretches, commanded)
    with np.errstate(divide="ignore", invalid="ignore"):
        wide = wide / spread
    fields = {
        "error_before": before.relative_error(spread),
        "error_plain": plain.relative_error(spread),
        "error_after": after.relative_error(spread),
        "wide_after": wide,
        "wide_cutoff": wide_cutoff,
        "spread": spread,
        "intervals": intervals,
        "seconds": seconds,
        "enough": 2.0 * min(completed.cutoff_, 0.5 / dt) * seconds >= FEWEST_VALUES,
        "projection": cost,
        "outside": completed.robot_.outside(completed.robot_.prepare_recording(rest)),
        "commands_alone": alone,
        "recorded": recorded_motion(whole.n_samples, dt, _looked_at(view, split)),
    }
    settings = {
        "untouched_stretches": len(kept.stretches),
        "undecided_stretches": len(split.stretches) - len(kept.stretches),
        "untouched_seconds": before.weight.shape[0] * float(step),
        "guard_seconds": float(guard * dt),
        "correlation_seconds": max(memory, default=0.0),
    }
    curves = {
        "index": before.index,
        "residuals": residual_curves(after, dt),
        "positions": positions,
        "line": time_line(
            searched, (before, after), whole.t, [p.start for p in whole.segments]
        ),
    }
    return fields, settings, curves


def _looked_at(view, split):
    """Count the samples that a view has of the search part; 0 if all."""
    there = sum(part.stop - part.start for part in split.searched_parts)
    seen = view.states.shape[0]
    return seen if seen < there else 0


def _held_out(models, kept, rest, whole):
    """Residuals of the models on held-out rows, and the error in a wider band."""
    completed = models.judged
    end = _wide(completed.cutoff_, completed.dt)
    found, wide = {}, np.full(whole.nv, np.nan)
    three = models.declared, models.plain, completed
    for one in dict.fromkeys(three):
        bands = ["fit", end] if one is completed and np.isfinite(end) else ["fit"]
        narrow, *more = one.robot_.residuals_behind(rest, bands)
        found[one] = _numbered(narrow, kept.stretches)
        # Of the wide band, as large as a long recording, only sums are kept.
        for part in more:
            wide = part.rms()
        del more
    return [found[one] for one in three], wide, end


def _wide(cutoff, dt):
    """End of the wider band [Hz]; nan where there is no room for it."""
    wide = min(max(_WIDER * cutoff, _CONTROL), _HIGHEST / dt)
    return wide if np.isfinite(cutoff) and wide > 1.1 * cutoff else np.nan


def _numbered(part, slices):
    """Count the rows of residuals of some slices in the whole recording."""
    edges = np.cumsum([0, *(s.stop - s.start for s in slices)])
    own = np.searchsorted(edges, part.index, side="right") - 1
    starts = np.array([s.start for s in slices])
    return replace(part, index=part.index - edges[own] + starts[own])


# -- what physically consistent parameters cost ----------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class ConsistencyCost:
    """Errors on held-out data with and without physically consistent parameters."""

    # (nv,): error of the completed model with `theta_unconstrained_` and with `theta_`,
    # over the spread of the torque
    free: np.ndarray
    held: np.ndarray
    # (2, nv): 90 % interval of held minus free, over the next 50 s of the same motion
    interval: np.ndarray
    # (nv,): difference where it is above 0 by more than its interval, and as large as
    # what an effect has to save to be named; 0 elsewhere, nan where unknown
    cost: np.ndarray

    @property
    def costs(self):
        """Joints whose error the constraints raise by more than chance, (nv,), bool."""
        return self.cost > 0


def without_constraints(robot):
    """Copy a fitted identifier, which predicts with its unconstrained parameters."""
    other = copy.copy(robot)
    other.theta_ = robot.theta_unconstrained_
    return other


def cost_of(untouched, searched, spread, step):
    """Price of the constraints of a fitted identifier, a `ConsistencyCost`."""
    free, held = (part.relative_error(spread) for part in untouched)
    interval = error_intervals(untouched, searched, spread, step)["difference"]
    with np.errstate(invalid="ignore"):
        material = free**2 < (1.0 - SMALLEST_GAIN) * held**2
        cost = np.where((interval[0] > 0) & material, held - free, 0.0)
    cost[~np.isfinite(held - free)] = np.nan
    return ConsistencyCost(free=free, held=held, interval=interval, cost=cost)


# -- positions from commands alone -----------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandsAlone:
    """Positions that models reach on the held-out data, from its commands alone."""

    # (nv,): root mean square of simulated minus measured positions [rad or m], of the
    # declared model, with the plain terms, and of the completed one; nan where a
    # simulation did not come to its end
    before: np.ndarray
    plain: np.ndarray
    after: np.ndarray
    told: np.ndarray  # (nv,): the same of commanded minus measured positions
    units: tuple  # "rad" or "m"
    seconds: float  # that each model was simulated [s]
    n_stretches: int  # each from its measured first state on
    failed: dict = field(default_factory=dict)  # why, by the name of the error
    left_out: tuple = ()  # effects of the completed model that are not simulated


def commands_alone(models, stretches, recording):
    """Return `CommandsAlone` and the `TimeLine` of its positions; None without."""
    drive, dt = models.declared.drive, recording.dt
    if drive is None or not drive.of_positions:
        return None, None
    lengths = [rows.stop - rows.start for rows in stretches]
    most = max(lengths)
    if sum(lengths) * dt > _SIMULATED:
        most = max(int(_SIMULATED / dt / len(lengths)), 2)
    parts = [slice(x.start, min(x.start + most, x.stop)) for x in stretches]
    q, aim = (
        np.concatenate([values[rows] for rows in parts])
        for values in (
            recording.q,
            np.reshape(recording.signals[drive.told], recording.q.shape),
        )
    )
    measured = models.judged.robot_.states(recording.inputs, recording.groups)
    known = {"before": models.declared, "plain": models.plain, "after": models.judged}
    found, failed, left_out = {}, {}, ()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for model in counted(list(dict.fromkeys(known.values())), "closed loop"):
            found[model] = np.full(q.shape, np.nan)
            try:
                follower = CommandFollower(model.robot_, drive, recording)
                left_out = follower.left_out if model is models.judged else left_out
                states = [
                    follower.run(rows, measured[rows.start], recording.t[rows])
                    for rows in parts
                ]
                found[model] = np.concatenate(states)[:, : recording.nv]
            except ValueError as error:
                failed[model] = str(error)
    warn_once(caught, "models", stacklevel=2)
    reached = {name: found[one] for name, one in known.items()}
    slides = is_prismatic(models.judged.features_.model_)
    result = CommandsAlone(
        **{name: _size(x - q) for name, x in reached.items()},
        told=_size(aim - q),
        units=tuple("m" if one else "rad" for one in slides),
        seconds=len(q) * dt,
        n_stretches=len(parts),
        failed={name: failed[one] for name, one in known.items() if one in failed},
        left_out=left_out,
    )
    # The stretches one after the other.
    starts = np.cumsum([rows.stop - rows.start for rows in parts])[:-1]
    curves = q, reached["before"], reached["after"], np.ones(q.shape, dtype=bool)
    line = TimeLine(
        torques=over_time(dt * np.arange(len(q)), starts, *curves, dt),
        borders=tuple((dt * starts).tolist()),
        untouched=(),
        in_seconds=True,
    )
    return result, line


def _size(errors):
    return np.sqrt((errors**2).mean(axis=0))
