"""The errors on the untouched part, which is looked at here and only once."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.search._band import Band, measure_band
from sklearn_vbjfa.diagnosis.search._intervals import (
    FinalFit,
    added_effects,
    error_intervals,
)
from sklearn_vbjfa.diagnosis.search._price import (
    ProjectionPrice,
    price_of,
    without_constraints,
)
from sklearn_vbjfa.diagnosis.search._split import FEWEST_VALUES
from sklearn_vbjfa.recording._signals import OfferedSignals
from sklearn_vbjfa.robot._identifier import outside_of
from sklearn_vbjfa.robot._residuals import TorqueResiduals, torque_spread

# The wider band reaches this many times as far as that of the fit, and at least to
# the frequency [Hz] at which controllers act.
_WIDER, _CONTROL = 4.0, 10.0
# Share of the sample rate up to which it may reach.
_HIGHEST = 0.4


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """Errors of the declared and of the completed model on the untouched part.

    Attributes
    ----------
    before, after : TorqueResiduals
        In the band of the fit.
    searched : tuple of TorqueResiduals
        The same on the search part, to which both models were fitted.
    wide : tuple of ndarray of shape (nv,) or None
        Root mean squares before and after in a wider band [N m or N].
    wide_cutoff : float
        Where that band ends [Hz]; nan where there is none.
    spread : ndarray of shape (nv,)
        Spread of the torque in the moving time of the whole recording [N m or N].
    intervals : dict
        Of the errors, see `error_intervals`.
    seconds : ndarray of shape (nv,)
        Untouched time in which each joint moves [s].
    enough : ndarray of shape (nv,), bool
        Whether that is enough for an error.
    n_stretches : int
        Number of untouched stretches.
    n_undecided : int
        Stretches left out since something jumps in them, the search cannot say when.
    guard : float
        Time left out next to the search part [s].
    band : Band
        The band of the fit.
    price : ProjectionPrice or None
        What physically consistent parameters cost; None if the parameters were not
        made consistent.
    outside : tuple of OutsideRange
        Where the untouched part leaves what the completed model was fitted on.
    """

    before: TorqueResiduals
    after: TorqueResiduals
    searched: tuple
    wide: tuple | None
    wide_cutoff: float
    spread: np.ndarray
    intervals: dict
    seconds: np.ndarray
    enough: np.ndarray
    n_stretches: int
    n_undecided: int
    guard: float
    band: Band
    price: ProjectionPrice | None
    outside: tuple = ()

    @property
    def errors(self):
        """Errors before and after over the spread of the torque, ndarray (2, nv)."""
        parts = self.before, self.after
        return np.array([part.relative_error(self.spread) for part in parts])


def judge(declared, completed, found, split, whole):
    """Judge two fitted models on the part of a recording that is untouched.

    Both were fitted to the rows of the search, and `found` is what it found there.
    """
    model, dt = found.model, declared.dt
    memory = max(model.memory_seconds(), default=0.0)
    # Of a memory without end nothing is far enough.
    guard = int(min(memory / dt, whole.n_samples))
    instants = [getattr(e, name) for e in found.effects for name in e.jumping]
    count = len(split.stretches)
    split = split.decided(whole.t, instants).guarded(guard)
    rows = split.test
    rest = split.untouched(whole)

    given = rest.inputs, rest.tau, rest.groups, rest.weight, rest.t
    beside = {"signals": OfferedSignals(columns=rest.signals)}

    def errors(**band):
        return tuple(
            one.residuals(*given, **beside, **band) for one in (declared, completed)
        )

    before, after = (_numbered(part, rows) for part in errors())
    added = added_effects(completed, len(found.effects))
    fit = FinalFit(declared, completed, model.view.corrected(()), added)
    searched = tuple(_numbered(part, split.search) for part in fit.residuals())
    spread = torque_spread(searched[0], before)
    wide_cutoff = _wide(completed.cutoff_, dt)
    wide = None
    if np.isfinite(wide_cutoff):
        wide = tuple(part.rms() for part in errors(cutoff=wide_cutoff))
    # Rows in which a joint moves throughout have its largest weight.
    full = np.maximum(before.weight.max(axis=0), np.finfo(float).tiny)
    step = model.view.step
    seconds = (before.weight / full).sum(axis=0) * step
    cutoff = min(completed.cutoff_, 0.5 / dt)
    price = None
    if completed.projector_ is not None:
        free = without_constraints(completed).residuals(*given, **beside)
        of_free = fit.residuals_of(completed.theta_unconstrained_)
        price = price_of(
            completed,
            (_numbered(free, rows), after),
            (_numbered(of_free, split.search), searched[1]),
            spread,
            step,
        )
    part = split.searched(whole)
    return Judgement(
        before=before,
        after=after,
        searched=searched,
        wide=wide,
        wide_cutoff=wide_cutoff,
        spread=spread,
        intervals=error_intervals((before, after), searched, spread, step),
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
