"""The errors on the untouched part, which is looked at here and only once."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.diagnosis.explain._band import Band, measure_band
from sklearn_vbjfa.diagnosis.explain._intervals import (
    FinalFit,
    added_effects,
    error_intervals,
)
from sklearn_vbjfa.diagnosis.explain._price import (
    ProjectionPrice,
    price_of,
    without_constraints,
)
from sklearn_vbjfa.diagnosis.explain._split import FEWEST_VALUES
from sklearn_vbjfa.diagnosis.explain._whitening import memory_seconds
from sklearn_vbjfa.recording import OfferedSignals
from sklearn_vbjfa.robot._identifier import RobotIdentifier, outside_of
from sklearn_vbjfa.robot._residuals import TorqueResiduals, torque_spread

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """Errors of the models of a loop on the untouched part."""

    # residuals of the declared model, with the plain terms, and of the completed one
    before: TorqueResiduals
    plain: TorqueResiduals
    after: TorqueResiduals
    # before and after on the search part, to which the models were fitted
    searched: tuple
    # (nv,): root mean squares before and after in a wider band [N m or N]
    wide: tuple | None
    wide_cutoff: float  # where that band ends [Hz]; nan where there is none
    # (nv,): spread of the torque in the moving time of the recording [N m or N]
    spread: np.ndarray
    # those of the errors before and after and their difference, see `error_intervals`;
    # "plain" and "added" are the error with the plain terms and what the effects add to
    # it
    intervals: dict
    seconds: np.ndarray  # (nv,): untouched time in which each joint moves [s]
    enough: np.ndarray  # (nv,): whether that is enough for an error
    n_stretches: int  # untouched ones
    # those left out since something jumps in them, the search cannot say when
    n_undecided: int
    guard: float  # time left out next to the search part [s]
    band: Band  # of the fit
    # what consistent parameters cost; None if they were not made consistent
    price: ProjectionPrice | None
    # where the untouched part leaves what the completed model was fitted on
    outside: tuple = ()

    @property
    def errors(self):
        """Errors before, plain and after over the torque's spread, ndarray (3, nv)."""
        parts = self.before, self.plain, self.after
        return np.array([part.relative_error(self.spread) for part in parts])


def judge(models, found, split, whole):
    """Judge the `Models` of a loop on the part of a recording that is untouched."""
    # They were fitted to the rows of the search, and `found` is what it found there.
    completed = models.judged
    model, dt = found.model, completed.dt
    memory = max(memory_seconds(model), default=0.0)
    # Of a memory without end nothing is far enough.
    guard = int(min(memory / dt, whole.n_samples))
    instants = [getattr(e, name) for e in found.effects for name in e.jumping]
    count = len(split.stretches)
    split = split.decided(whole.t, instants).guarded(guard)
    rows = split.test
    rest = split.untouched(whole)

    three = models.declared, models.plain, completed

    def errors(**band):
        each = {one: _residuals(one, rest, **band) for one in dict.fromkeys(three)}
        return tuple(each[one] for one in three)

    before, plain, after = (_numbered(part, rows) for part in errors())
    part, step = split.searched(whole), model.view.step
    added = added_effects(completed, len(found.effects))
    fit = FinalFit(models.plain, completed, model.view.corrected(()), added)
    of_plain, of_completed = (_numbered(one, split.search) for one in fit.residuals())
    of_declared = of_plain
    if models.declared is not models.plain:
        own = _numbered(_residuals(models.declared, part), split.search)
        of_declared = replace(own, weight=of_plain.weight)
    searched = of_declared, of_completed
    spread = torque_spread(of_plain, before)
    intervals = error_intervals((before, after), searched, spread, step)
    beyond = error_intervals((plain, after), (of_plain, of_completed), spread, step)
    intervals |= {"plain": beyond["before"], "added": beyond["difference"]}
    wide_cutoff = _wide(completed.cutoff_, dt)
    wide = None
    if np.isfinite(wide_cutoff):
        wide = tuple(part.rms() for part in errors(cutoff=wide_cutoff))
    # Rows in which a joint moves throughout have its largest weight.
    full = np.maximum(before.weight.max(axis=0), np.finfo(float).tiny)
    seconds = (before.weight / full).sum(axis=0) * step
    cutoff = min(completed.cutoff_, 0.5 / dt)
    price = None
    if completed.projector_ is not None:
        free = _residuals(without_constraints(completed), rest)
        of_free = fit.residuals_of(completed.theta_unconstrained_)
        price = price_of(
            completed,
            (_numbered(free, rows), after),
            (_numbered(of_free, split.search), of_completed),
            spread,
            step,
        )
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
        n_stretches=len(split.stretches),
        n_undecided=count - len(split.stretches),
        guard=float(guard * dt),
        band=measure_band(
            model.view, part.tau, max(p.stop - p.start for p in part.segments)
        ),
        price=price,
        outside=outside_of(completed, rest),
    )


def _residuals(model, part, **band):
    """Residuals of a model on some recorded rows."""
    given = part.inputs, part.tau, part.groups, part.weight, part.t
    return model.residuals(*given, signals=OfferedSignals(columns=part.signals), **band)


def _numbered(part, rows):
    """Count the rows of residuals in the whole recording."""
    return TorqueResiduals(
        index=rows[part.index],
        torque=part.torque,
        predicted=part.predicted,
        weight=part.weight,
    )


def _wide(cutoff, dt):
    """End of the wider band [Hz]; nan where there is no room for it."""
    wide = min(max(_WIDER * cutoff, _CONTROL), _HIGHEST / dt)
    return wide if np.isfinite(cutoff) and wide > 1.1 * cutoff else np.nan
