"""Everything that a loop found out, in the form in which it is read."""

import dataclasses
import platform
from dataclasses import dataclass, field

import numpy as np
import scipy
import sklearn
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.explain._contradictions import (
    Contradictions,
    Parts,
    contradictions,
)
from sklearn_vbjfa.diagnosis.explain._curves import (
    effect_curves,
    friction_curves,
    residual_curves,
    time_line,
)
from sklearn_vbjfa.diagnosis.explain._gaps import (
    hidden,
    memory_seconds,
    motion_limits,
    named_beside,
    too_short,
    unexplained,
)
from sklearn_vbjfa.diagnosis.explain._identified import (
    ParameterValue,
    RecordedMotion,
    parameter_values,
    recorded_motion,
)
from sklearn_vbjfa.diagnosis.explain._intervals import (
    NEXT_SECONDS,
    NextRecording,
    next_recording,
    quantile,
)
from sklearn_vbjfa.diagnosis.explain._judgement import CommandsAlone, ConsistencyCost
from sklearn_vbjfa.diagnosis.search._posterior import Evidence
from sklearn_vbjfa.effects import (
    EffectRange,
    OfTime,
    UnnamedTorque,
    declarable,
    resolve,
)
from sklearn_vbjfa.model import import_pinocchio, is_prismatic
from sklearn_vbjfa.robot._corrections import Corrections, corrections_of
from sklearn_vbjfa.robot._gains import ChannelGains
from sklearn_vbjfa.robot._spreads import body_masses

# Why the values of an effect give it no name.
_UNKNOWN = "no parameter of it is known from zero"
_UNSURE = "its value is not known well enough to correct anything"


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Where a report comes from, as the program that ran the search knows it."""

    file: str | tuple = ""  # recording; the files if there were several
    description: str = ""  # its file
    held: tuple = ()  # joints that were held at zero
    warnings: tuple = ()  # what the run warned of
    files: tuple = ()  # written with the page, which links to them
    date: str = ""  # of the identification
    command: str = ""  # that designs the motion for the open questions; empty for none


@dataclass(frozen=True, kw_only=True)
class Afterwards:
    """State of an effect of time after the recording."""

    seconds: float  # last time of the fit [s]
    how: str  # what the effect is taken to do from then on
    # what is left of its coefficients at that time; empty if it stays as it is
    left: dict
    intervals: dict  # 90 %


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What would take the place of an effect."""

    name: str
    joint: int  # from zero
    shape: dict  # parameters of its best variant


@dataclass(frozen=True, kw_only=True)
class DiscoveredEffect:
    """An effect that the declared model lacked."""

    name: str  # of its class, in the library or of one's own
    joint: int  # from zero
    joint_name: str
    parameters: dict  # coefficients and shape parameters, as an engineer calls them
    units: dict
    # 90 %: Student's t, from the scatter between blocks of time of the completed
    # model's residuals; none for a shape parameter that was not searched on, what the
    # recording does not excite, and an instant
    intervals: dict
    # posterior odds, and what it saves on stretches of time that were not fitted
    evidence: Evidence
    # effects that this data cannot tell from it; another use of the same one with what
    # sets it apart, such as "signal: voltage"
    rivals: tuple = ()
    trials: tuple = ()  # the same as `Trial`s, with their shapes
    effect: object = None  # the transformer itself
    # whether it belongs to its joint, or to the robot as a whole; its joint is the
    # first one then
    scope: str = "joint"
    # positions, speeds and loads of its joint that it was fitted on, in the model that
    # is handed over
    ranges: EffectRange | None = None
    # what an effect of time is taken to do after the recording
    afterwards: Afterwards | None = None
    warning: str = ""  # why it is only possible; empty for one that is named

    @property
    def log_odds(self):
        """Logarithm of the posterior odds that the declared model lacked it [nats]."""
        return self.evidence.log_odds

    @property
    def probability(self):
        """Probability that the declared model lacked it."""
        # The posterior one, or the probability that it lowers the error on stretches of
        # time that were not fitted, if that is less.
        return self.evidence.probability


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Everything that a discovery found out; the report is made from it."""

    # declared model: robot, joints, friction, number of parameters, cut-off
    declared: dict
    effects: tuple  # those that have a name
    # those that are more probable than not and have none; in the completed model too
    possible: tuple
    unexplained: tuple  # joints that stay above their noise floor
    hidden: tuple  # effects that could not be looked for
    channels: tuple  # what is wrong with channels of the recording
    joint_names: tuple
    torque_units: tuple  # "N m" or "N"
    unsearched: tuple  # joints whose channels show too little to be searched
    added: tuple  # plain terms that were fitted on every joint beyond what was declared
    # (nv,): errors on the held-out part over `spread`: declared, plain, completed
    error_before: object
    error_plain: object
    error_after: object
    # (nv,): deviation of the torque in the moving time of the whole recording [N m or
    # N]
    spread: object
    # (nv,): error after in a wider band than that of the fit; nan for none
    wide_after: object
    wide_cutoff: float  # where that band ends [Hz]; nan for none
    seconds: object  # (nv,): held-out time in which each joint moves [s]
    enough: object  # (nv,): whether that is enough for a verdict
    # (2, nv): where the errors ``"before"``, ``"plain"``, ``"after"``, and after minus
    # before (``"difference"``) and minus plain (``"added"``), over the next 50 s of the
    # same motion lie in 90 % of cases
    intervals: dict
    floor: object  # (nv,): noise floor over the spread
    # what was looked for, by name: what an effect is called and what to record
    library: dict
    settings: dict  # thresholds, split, blocks, what intervals are of, seed, versions
    # what physically consistent parameters cost; None if they were not asked for
    projection: ConsistencyCost | None = None
    recordings: tuple = ()  # what each recording is called
    motion_limits: tuple = ()  # what joints do in no recording
    next_recording: NextRecording | None = None
    repeated: tuple = ()  # motion that was recorded more than once
    # recordings that are not of one robot
    contradictions: Contradictions = field(default_factory=Contradictions)
    # masses of the model that is handed over, and which of them are known
    bodies: tuple = ()
    # of pictures: "effects" has an `EffectCurves` or None of each effect, "friction",
    # "spectra" and "residuals" the curves of the joints, "line" the `TimeLine`,
    # "positions" that of the positions from commands alone; "index" the held-out rows
    curves: dict = field(default_factory=dict)
    # where the held-out part leaves what the judged model was fitted on
    outside: tuple = ()
    # those of the torque channels in the model that is handed over, if unknown
    gains: ChannelGains | None = None
    # what effects in the model that is handed over ask for
    corrections: Corrections = field(default_factory=Corrections)
    # bodies that are not as described; see `RobotIdentifier.mass_deviations_`
    departures: tuple = ()
    # how many times as heavy all bodies together are as described
    common_size: float = 1.0
    # values that joints share; see `RobotIdentifier.alike_`
    alike: tuple = ()
    parameters: tuple[ParameterValue, ...] = ()  # of the model that is handed over
    recorded: RecordedMotion | None = None
    # positions on the held-out part from commands alone; None without a drive that is
    # told positions
    commands_alone: CommandsAlone | None = None
    provenance: Provenance | None = None
    # joint torque of the completed model beyond the effects, `UnnamedTorque`s
    unnamed: tuple = ()


def make_outcome(search, models, final, judgement, channels, asked, whole, recordings):
    """Collect what `Report` shows."""
    # `models` were fitted to the search part, `final` to all data; `asked` are the
    # parameters of the loop, of which the report repeats some; `whole` is all data,
    # `recordings` what each of it is called.
    robot = models.declared
    features, names = robot.features_, robot.joint_names_
    prismatic = is_prismatic(features.model_)
    spread, floor = judgement.spread, _noise_floor(final, models.judged)
    before, plain, after = judgement.errors
    decided = np.where(judgement.enough, after, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        wide = judgement.wide / spread
        relative_floor = floor / spread
    rest = unexplained(search.model, names, spread, floor, decided)
    parts = Parts.of(final)
    left_out = np.empty((0, spread.size)) if parts is None else parts.left_out(spread)
    effects = tuple(_effects(search, final, names, prismatic, float(whole.t[-1])))
    return Outcome(
        declared={
            "robot": features.model_.name,
            "joints": names,
            "friction": features.friction_,
            "n_parameters": features.n_parameters_,
            "cutoff": float(robot.cutoff_),
            "standstill": robot.standstill_.tolist(),
            **_drive(robot.drive, whole),
        },
        effects=tuple(effect for effect in effects if not effect.warning),
        possible=tuple(effect for effect in effects if effect.warning),
        unexplained=rest,
        hidden=hidden(search, names),
        channels=channels,
        joint_names=names,
        torque_units=tuple("N" if p else "N m" for p in prismatic),
        unsearched=tuple(np.flatnonzero(~search.model.view.root.any(axis=0)).tolist()),
        added=tuple(
            name
            for name in models.plain.features_.friction_
            if name not in features.friction_
        ),
        error_before=before,
        error_plain=plain,
        error_after=after,
        spread=spread,
        wide_after=wide,
        wide_cutoff=judgement.wide_cutoff,
        seconds=judgement.seconds,
        enough=judgement.enough,
        intervals=judgement.intervals,
        floor=relative_floor,
        library={e.name: e for e in (*resolve(declarable()), *search.library)},
        settings=_settings(search, judgement, asked),
        projection=judgement.cost,
        bodies=body_masses(final.identifier),
        recordings=recordings,
        motion_limits=motion_limits(final.view),
        repeated=final.view.repetition.motions(),
        contradictions=contradictions(
            parts, spread, float(asked["alpha"]), search.settings.rivals
        ),
        next_recording=next_recording(left_out, after, relative_floor),
        curves=_curves(models, final, judgement, effects, whole),
        outside=judgement.outside,
        gains=final.identifier.gains_,
        corrections=corrections_of(final.identifier),
        departures=final.identifier.mass_deviations_,
        common_size=final.identifier.common_size_,
        alike=final.identifier.alike_,
        parameters=parameter_values(final.identifier),
        recorded=recorded_motion(whole.n_samples, robot.dt, judgement.looked_at),
        commands_alone=judgement.alone,
        unnamed=tuple(e for e in final.effects if isinstance(e, UnnamedTorque)),
    )


def _drive(drive, whole):
    """Say what stands in place of measured torques, in an entry; none for these."""
    if drive is None:
        return {}
    told = {"kind": type(drive).__name__, **drive.facts(whole)}
    return {"drive": told}


def _noise_floor(final, judged):
    """Noise floor of the completed model, (nv,) [N m or N]."""
    # More data show more of the noise; the declared model's would hold what it lacks.
    own = final.identifier.noise_floor_
    return np.where(np.isfinite(own), own, judged.noise_floor_)


def _effects(search, final, names, prismatic, seconds):
    """Yield each `DiscoveredEffect`, with the values of the final fit."""
    # The effects of the declared model come first.
    count = len(final.effects)
    ranges = final.identifier.effect_ranges_[-count:] if count else ()
    for finding, effect, estimate, fitted in zip(
        search.findings,
        final.effects,
        final.effect_estimates,
        ranges,
    ):
        values, deviations = named_values(effect, estimate)
        half = quantile(estimate.freedom)
        units = effect.parameter_units(prismatic[effect.joint])
        intervals = {
            key: (
                values[key] - half * deviations[key],
                values[key] + half * deviations[key],
            )
            for key in deviations
            # What no column determines, or no scatter tells of, has no interval.
            if deviations[key] > 0
        }
        told = (named_beside(r, finding.effect, names) for r in finding.rivals)
        known = search.settings.known
        why = finding.warning or _unknown(
            effect, estimate.coef, values, deviations, intervals, known
        )
        yield DiscoveredEffect(
            name=effect.name,
            joint=effect.joint,
            joint_name=names[effect.joint],
            scope=effect.scope,
            parameters=values,
            units={key: units.get(key, "") for key in values},
            intervals=intervals,
            evidence=finding.evidence,
            rivals=tuple(dict.fromkeys(told)),
            trials=tuple(
                Trial(name=r.name, joint=r.joint, shape=r.shape())
                for r in finding.rivals
            ),
            effect=effect,
            ranges=fitted,
            afterwards=_afterwards(effect, estimate, seconds),
            warning=why,
        )


def _unknown(effect, coef, values, deviations, intervals, known):
    """Say why the values of an effect give it no name; "" if they do."""
    idle = dict.fromkeys(values, 0.0)
    if effect.in_model:
        idle |= dict(zip(effect.model_parameters, effect.nominal))
        sure = [
            abs(values[key] - idle[key]) > known * deviation
            for key, deviation in deviations.items()
            if deviation > 0
        ]
        return "" if any(sure) else _UNSURE
    # A shape alone is no sign that the effect is there.
    own = [key for key in intervals if key not in effect.shape()] or list(intervals)
    if not any(coef):
        return _UNKNOWN
    away = (intervals[k][0] > idle[k] or intervals[k][1] < idle[k] for k in own)
    return "" if not own or any(away) else _UNKNOWN


def _afterwards(effect, estimate, seconds):
    """Return the state of an effect of time after the recording, or None."""
    if not isinstance(effect, OfTime):
        return None
    k = len(estimate.coef)
    values = np.r_[estimate.coef, [getattr(effect, name) for name in estimate.shape]]

    def left(given):
        shape = dict(zip(estimate.shape, given[k:].tolist()))
        return clone(effect).set_params(**shape).later(given[:k], seconds)

    half, found = quantile(estimate.freedom), left(values)
    scale = np.sqrt(np.maximum(np.diagonal(estimate.covariance), 0.0))
    # Small beside what the value itself is, where the deviation is not.
    steps = 1e-4 * np.minimum(scale, np.abs(values))
    steps[~(steps > 0)] = 1e-9
    sides = [
        [left(values + way * step) for way in (0.5, -0.5)] for step in np.diag(steps)
    ]
    intervals = {}
    for name, value in found.items():
        slope = np.array([above[name] - below[name] for above, below in sides]) / steps
        reach = half * _deviation(slope, estimate.covariance)
        if not np.isnan(reach):
            intervals[name] = (value - reach, value + reach)
    return Afterwards(
        seconds=seconds, how=effect.afterwards, left=found, intervals=intervals
    )


def named_values(effect, estimate):
    """Parameters as an engineer calls them, and standard deviations (delta method)."""
    coef, covariance = estimate.coef, estimate.covariance
    k = len(coef)
    values = effect.parameters(coef)
    scale = np.sqrt(np.maximum(np.diagonal(covariance)[:k], 0.0))
    slopes = {key: np.zeros(k) for key in values}
    for i in range(k):
        step = 1e-4 * scale[i] if scale[i] > 0 else 1e-9
        moved = np.array(coef, dtype=float)
        moved[i] += step
        for key, value in effect.parameters(moved).items():
            slopes[key][i] = (value - values[key]) / step
    own = covariance[:k, :k]
    deviations = {key: _deviation(slope, own) for key, slope in slopes.items()}
    for i, name in enumerate(estimate.shape):
        if name not in values:
            values[name] = float(getattr(effect, name))
            own = np.arange(len(covariance)) == k + i
            deviations[name] = _deviation(own.astype(float), covariance)
    # About the value, of all forms together.
    for weight, other in estimate.forms:
        for key, value in other.items():
            away = np.sqrt(weight) * (value - values[key])
            deviations[key] = float(np.hypot(deviations[key], away))
    for name, value in effect.shape().items():
        values.setdefault(name, value)
    return values, deviations


def _deviation(slope, covariance):
    """Deviation of what has a slope by some values; nan if one of them is not known."""
    seen = slope != 0
    slope = slope[seen]
    return float(np.sqrt(np.maximum(slope @ covariance[np.ix_(seen, seen)] @ slope, 0)))


def _settings(search, judgement, asked):
    """Thresholds, split, blocks, seed and versions, a dict."""
    from sklearn_vbjfa import __version__

    view, seed = search.model.view, asked["random_state"]
    seconds = memory_seconds(search.model)
    return {
        "test_size": float(asked["test_size"]),
        "untouched_stretches": judgement.n_stretches,
        "undecided_stretches": judgement.n_undecided,
        "untouched_seconds": judgement.before.weight.shape[0] * float(view.step),
        "guard_seconds": judgement.guard,
        "alpha": float(asked["alpha"]),
        "n_candidates": int(search.n_candidates),
        "search": dataclasses.asdict(search.settings),
        "effects": tuple(e.name for e in search.library),
        "signals": tuple(view.signals),
        "n_blocks": view.blocks.n_blocks,
        "block_seconds": float(view.blocks.length),
        "n_folds": view.blocks.n_folds,
        "correlation_seconds": max(seconds, default=0.0),
        "too_short": tuple(too_short(search.model, seconds)),
        "error_seconds": NEXT_SECONDS,
        "search_rows": view.n_rows,
        "random_state": seed if isinstance(seed, (int, type(None))) else "given",
        "versions": {
            "sklearn_vbjfa": __version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "scikit-learn": sklearn.__version__,
            "pinocchio": import_pinocchio().__version__,
            "python": platform.python_version(),
        },
    }


def _curves(models, final, judgement, effects, whole):
    """Curves of the pictures, by what they show."""
    return {
        "index": judgement.before.index,
        "effects": tuple(
            own
            for own, effect in zip(effect_curves(final), effects)
            if not effect.warning
        ),
        "friction": friction_curves(models.declared, final),
        "spectra": judgement.spectra,
        "residuals": residual_curves(judgement.after, models.judged.dt),
        "positions": judgement.positions,
        "line": time_line(judgement, whole.t, [p.start for p in whole.segments]),
    }
