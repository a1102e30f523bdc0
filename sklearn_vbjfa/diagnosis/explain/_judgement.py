"""The errors on the held-out part, which is looked at here and only once."""

import copy
import warnings
from dataclasses import dataclass, field, replace

import numpy as np

from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.diagnosis.explain._curves import Spectra, TimeLine, over_time
from sklearn_vbjfa.diagnosis.explain._gaps import SMALLEST_GAIN, memory_seconds
from sklearn_vbjfa.diagnosis.explain._intervals import (
    FinalFit,
    error_intervals,
)
from sklearn_vbjfa.diagnosis.explain._split import FEWEST_VALUES
from sklearn_vbjfa.effects import Shaped
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.robot._equations import TorqueResiduals, torque_spread
from sklearn_vbjfa.robot._identifier import RobotIdentifier
from sklearn_vbjfa.robot._windows import CommandFollower, tell_once

# At most so much of the held-out part is simulated [s]: the beginnings of its
# stretches.
_SIMULATED = 60.0


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
    drive = models.declared.drive
    if drive is None or not drive.of_positions:
        return None, None
    dt, nv = recording.dt, recording.nv
    lengths = [rows.stop - rows.start for rows in stretches]
    most = max(lengths)
    if sum(lengths) * dt > _SIMULATED:
        most = max(int(_SIMULATED / dt / len(lengths)), 2)
    parts = [slice(x.start, min(x.start + most, x.stop)) for x in stretches]
    measured = models.judged.robot_.states(recording.inputs, recording.groups)
    known = {"before": models.declared, "plain": models.plain, "after": models.judged}
    found, failed, left_out = {}, {}, ()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for model in counted(list(dict.fromkeys(known.values())), "closed loop"):
            try:
                follower = CommandFollower(model.robot_, drive, recording)
                if model is models.judged:
                    left_out = follower.left_out
                states = [
                    follower.run(rows, measured[rows.start], recording.t[rows])
                    for rows in parts
                ]
                found[model] = np.concatenate(states)[:, :nv]
            except ValueError as error:
                found[model], failed[model] = None, str(error)
    tell_once(caught, "models", stacklevel=2)
    q = np.concatenate([recording.q[rows] for rows in parts])
    aim = np.reshape(recording.signals[drive.told], recording.q.shape)
    aim = np.concatenate([aim[rows] for rows in parts])
    reached = {
        name: np.full(q.shape, np.nan) if found[one] is None else found[one]
        for name, one in known.items()
    }
    result = CommandsAlone(
        **{name: _size(x - q) for name, x in reached.items()},
        told=_size(aim - q),
        units=tuple(
            "m" if slides else "rad"
            for slides in is_prismatic(models.judged.features_.model_)
        ),
        seconds=len(q) * dt,
        n_stretches=len(parts),
        failed={name: failed[one] for name, one in known.items() if one in failed},
        left_out=left_out,
    )
    return result, _line(parts, q, reached, dt)


def _size(errors):
    return np.sqrt((errors**2).mean(axis=0))


def _line(parts, q, reached, dt):
    """Positions over time, `TimeLine`, the stretches one after the other."""
    starts = np.cumsum([rows.stop - rows.start for rows in parts])[:-1]
    torques = over_time(
        dt * np.arange(len(q)),
        starts,
        q,
        reached["before"],
        reached["after"],
        np.ones(q.shape, dtype=bool),
        dt,
    )
    return TimeLine(
        torques=torques,
        borders=tuple((dt * starts).tolist()),
        untouched=(),
        in_seconds=True,
    )


# The wider band reaches this many times as far as that of the fit, and at least to
# the frequency [Hz] at which controllers act.
_WIDER, _CONTROL = 4.0, 10.0
# Share of the sample rate up to which it may reach.
_HIGHEST = 0.4


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


# -- errors on the held-out part ------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Models:
    """The models of a loop, fitted to the search part."""

    # as declared, with the four plain terms, and with the effects as well
    declared: RobotIdentifier
    plain: RobotIdentifier
    judged: RobotIdentifier


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """Errors of the models of a loop on the held-out part."""

    # residuals of the declared model, with the plain terms, and of the completed one
    before: TorqueResiduals
    plain: TorqueResiduals
    after: TorqueResiduals
    # before and after on the search part, to which the models were fitted
    searched: tuple
    # (nv,): root mean squares after in a wider band [N m or N]; nan where there is none
    wide: np.ndarray
    wide_cutoff: float  # where that band ends [Hz]; nan where there is none
    # (nv,): spread of the torque in the moving time of the recording [N m or N]
    spread: np.ndarray
    # those of the errors before and after and their difference, see `error_intervals`;
    # "plain" and "added" are the error with the plain terms and what the effects add to
    # it
    intervals: dict
    seconds: np.ndarray  # (nv,): held-out time in which each joint moves [s]
    enough: np.ndarray  # (nv,): whether that is enough for an error
    n_stretches: int  # untouched ones
    # those left out since something jumps in them, the search cannot say when
    n_undecided: int
    guard: float  # time left out next to the search part [s]
    # what consistent parameters cost; None if they were not made consistent
    cost: ConsistencyCost | None
    spectra: tuple = ()  # of the residuals before and after, see `SpectrumCurves`
    # where the held-out part leaves what the completed model was fitted on
    outside: tuple = ()
    looked_at: int = 0  # see `RecordedMotion`
    # positions from commands alone, and the `TimeLine` of them; None without such
    alone: CommandsAlone | None = None
    positions: TimeLine | None = None

    @property
    def errors(self):
        """Errors before, plain and after over the torque's spread, ndarray (3, nv)."""
        parts = self.before, self.plain, self.after
        return np.array([part.relative_error(self.spread) for part in parts])


def judge(models, found, split, near, whole, commanded):
    """Judge the `Models` of a loop on the held-out part of a recording."""
    # They were fitted to the rows of the search, `found` is what it found there; near:
    # the split with those of these rows that it looked at; commanded: the recording
    # with the channels of its drive.
    completed = models.judged
    model, dt = found.model, completed.dt
    memory = max(memory_seconds(model), default=0.0)
    # Of a memory without end nothing is far enough.
    guard = int(min(memory / dt, whole.n_samples))
    shaped = [e for e in found.effects if isinstance(e, Shaped)]
    instants = [getattr(e, name) for e in shaped for name in e.jumping]
    count = len(split.stretches)
    kept = split.decided(whole.t, instants).guarded(guard)
    rows, rest = kept.stretches, kept.untouched(whole)

    three = models.declared, models.plain, completed
    wide_cutoff = _wide(completed.cutoff_, dt)
    bands = ["fit", wide_cutoff] if np.isfinite(wide_cutoff) else ["fit"]
    each, roots, of_all = {}, {}, None
    told, wide = (), np.full(whole.nv, np.nan)
    for one in dict.fromkeys(three):
        behind = one.robot_.residuals_behind(rest, bands)
        each[one] = _numbered(behind[0], rows)
        # Of the wide band, as large as a long recording, only sums are kept.
        for part in (_numbered(own, rows) for own in behind[1:]):
            if of_all is None:
                of_all = Spectra(part, dt, completed.cutoff_, wide_cutoff)
            roots[one] = of_all.of(part)
            if one is completed:
                wide = part.rms()
        del behind
    before, plain, after = (each[one] for one in three)
    step = model.view.step
    added = completed.effects_[len(models.plain.effects_) :]
    fit = FinalFit(models.plain, completed, model.view.corrected(()), added)
    seen = near.searched_parts
    of_plain, of_completed = (_numbered(one, seen) for one in fit.residuals())
    of_declared = of_plain
    if models.declared is not models.plain:
        own = _numbered(models.declared.robot_.residuals_of(near.searched(whole)), seen)
        of_declared = replace(own, weight=of_plain.weight)
    searched = of_declared, of_completed
    fitted = of_plain
    if near is not split:
        fitted = models.plain.robot_.measured(split.searched(whole))
        # A joint whose channel carries no information counts nowhere here.
        heard = model.view.root.any(axis=0)
        fitted = replace(fitted, weight=fitted.weight * heard)
    spread = torque_spread(fitted, before)
    intervals = error_intervals((before, after), searched, spread, step)
    beyond = error_intervals((plain, after), (of_plain, of_completed), spread, step)
    intervals |= {"plain": beyond["before"], "added": beyond["difference"]}
    if of_all is not None:
        told = of_all.curves(roots[models.declared], roots[completed])
    # Rows in which a joint moves throughout have its largest weight.
    full = np.maximum(before.weight.max(axis=0), np.finfo(float).tiny)
    seconds = (before.weight / full).sum(axis=0) * step
    cutoff = min(completed.cutoff_, 0.5 / dt)
    cost = None
    if completed.projector_ is not None:
        free = without_constraints(completed).robot_.residuals_of(rest)
        of_free = fit.residuals_of(completed.theta_unconstrained_)
        cost = cost_of(
            (_numbered(free, rows), after),
            (_numbered(of_free, seen), of_completed),
            spread,
            step,
        )
    alone, positions = commands_alone(models, rows, commanded)
    return Judgement(
        before=before,
        plain=plain,
        after=after,
        searched=searched,
        wide=wide,
        wide_cutoff=wide_cutoff,
        spread=spread,
        intervals=intervals,
        seconds=seconds,
        enough=2.0 * cutoff * seconds >= FEWEST_VALUES,
        n_stretches=len(kept.stretches),
        n_undecided=count - len(kept.stretches),
        guard=float(guard * dt),
        cost=cost,
        outside=completed.robot_.outside(completed.robot_.prepare_recording(rest)),
        spectra=told,
        looked_at=_looked_at(model.view, split),
        alone=alone,
        positions=positions,
    )


def _looked_at(view, split):
    """Count the samples that a view has of the search part; 0 if all."""
    there = sum(part.stop - part.start for part in split.searched_parts)
    seen = view.states.shape[0]
    return seen if seen < there else 0


def _numbered(part, slices):
    """Count the rows of residuals of some slices in the whole recording."""
    edges = np.cumsum([0, *(s.stop - s.start for s in slices)])
    own = np.searchsorted(edges, part.index, side="right") - 1
    starts = np.array([s.start for s in slices])
    return TorqueResiduals(
        index=part.index - edges[own] + starts[own],
        torque=part.torque,
        predicted=part.predicted,
        weight=part.weight,
    )


def _wide(cutoff, dt):
    """End of the wider band [Hz]; nan where there is no room for it."""
    wide = min(max(_WIDER * cutoff, _CONTROL), _HIGHEST / dt)
    return wide if np.isfinite(cutoff) and wide > 1.1 * cutoff else np.nan
