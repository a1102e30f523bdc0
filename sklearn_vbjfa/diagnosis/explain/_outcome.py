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
from sklearn_vbjfa.diagnosis.explain._curves import effect_curves, friction_curves
from sklearn_vbjfa.diagnosis.explain._gaps import (
    hidden,
    memory_seconds,
    named_beside,
    too_short,
    unexplained,
)
from sklearn_vbjfa.diagnosis.explain._identified import (
    ParameterValue,
    RecordedMotion,
    parameter_values,
)
from sklearn_vbjfa.diagnosis.explain._intervals import (
    NEXT_SECONDS,
    quantile,
)
from sklearn_vbjfa.diagnosis.explain._judgement import CommandsAlone, ConsistencyCost
from sklearn_vbjfa.diagnosis.explain._next import (
    Expectation,
    NextRecording,
    fitted_motion,
)
from sklearn_vbjfa.diagnosis.search._posterior import Evidence
from sklearn_vbjfa.effects import (
    EffectRange,
    OfTime,
    UnnamedTorque,
    declarable,
    resolve,
)
from sklearn_vbjfa.inspection import motion_of
from sklearn_vbjfa.model import import_pinocchio, is_prismatic
from sklearn_vbjfa.robot._channels import HALF_WIDTH, ChannelGains
from sklearn_vbjfa.robot._corrections import Corrections, corrections_of
from sklearn_vbjfa.robot._spreads import body_masses

# Why the values of an effect give it no name.
_UNKNOWN = "no parameter of it is known from zero"
# Position or velocity that is no limit of a joint.
_UNLIMITED = 1e3
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
    motion: tuple = ()  # what each joint does, `JointMotion`s
    next_recording: NextRecording | None = None  # of motion like the fitted
    expectation: Expectation | None = None  # of other motion
    repeated: tuple = ()  # motion that was recorded more than once
    # recordings that are not of one robot
    contradictions: Contradictions = field(default_factory=Contradictions)
    # masses of the model that is handed over, and which of them are known
    bodies: tuple = ()
    # of pictures: "effects" has an `EffectCurves` or None of each effect, "friction",
    # and "residuals" the curves of the joints, "line" the `TimeLine`,
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


def make_outcome(search, models, final, judged, channels, asked, whole, recordings):
    """Collect what `Report` shows."""
    # `models` were fitted to the search part, `final` to all data; `judged` is what
    # `judge` returns; `asked` are the parameters of the loop, of which the report
    # repeats some; `whole` is all data, `recordings` what each of it is called.
    fields, settings, curves = judged
    robot, identifier = models.declared, final.identifier
    features, names = robot.features_, robot.joint_names_
    prismatic, spread = is_prismatic(features.model_), fields["spread"]
    floor, after = _noise_floor(final, models.judged), fields["error_after"]
    with np.errstate(divide="ignore", invalid="ignore"):
        relative_floor = floor / spread
    parts = Parts.of(final)
    expectation = Expectation(
        after,
        relative_floor,
        _scatter(fields["intervals"]["after"]),
        np.empty((0, spread.size)) if parts is None else parts.left_out(spread),
        fitted_motion(final, spread),
    )
    effects = tuple(_effects(search, final, names, prismatic, float(whole.t[-1])))
    drawn = zip(effect_curves(final), effects)
    curves |= {
        "effects": tuple(own for own, effect in drawn if not effect.warning),
        "friction": friction_curves(robot, final),
    }
    return Outcome(
        **fields,
        declared={
            "robot": features.model_.name,
            "joints": names,
            "friction": features.friction_,
            "n_parameters": features.n_parameters_,
            "cutoff": float(robot.cutoff_),
            "standstill": robot.standstill_.tolist(),
            "limits": _limits(features.model_),
            **_drive(robot.drive, whole),
        },
        effects=tuple(effect for effect in effects if not effect.warning),
        possible=tuple(effect for effect in effects if effect.warning),
        unexplained=unexplained(
            search.model,
            names,
            spread,
            floor,
            np.where(fields["enough"], after, np.nan),
        ),
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
        floor=relative_floor,
        library={e.name: e for e in (*resolve(declarable()), *search.library)},
        settings=settings | _settings(search, asked),
        bodies=body_masses(identifier),
        recordings=recordings,
        motion=() if whole.dt is None else motion_of(whole, features.nominal_),
        repeated=final.view.repetition.motions(),
        contradictions=contradictions(
            parts, spread, float(asked["alpha"]), search.settings.rivals
        ),
        next_recording=expectation.of(),
        expectation=expectation,
        curves=curves,
        gains=identifier.gains_,
        corrections=corrections_of(identifier),
        departures=identifier.mass_deviations_,
        common_size=identifier.common_size_,
        alike=identifier.alike_,
        parameters=parameter_values(identifier),
        unnamed=tuple(e for e in final.effects if isinstance(e, UnnamedTorque)),
    )


def _limits(model):
    """Lowest and highest position and speed of each joint; infinite without limits."""
    limits = [model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit]
    limits = np.array(limits).T
    # Zero is what descriptions without limits are read as.
    unknown = (np.abs(limits) > _UNLIMITED) | ~limits.any(axis=1, keepdims=True)
    return np.where(unknown, np.inf, limits)


def _drive(drive, whole):
    """Name what stands in place of measured torques, in an entry; none for these."""
    if drive is None:
        return {}
    return {"drive": {"kind": type(drive).__name__, **drive.facts(whole)}}


def _noise_floor(final, judged):
    """Noise floor of the completed model, (nv,) [N m or N]."""
    # More data show more of the noise; the declared model's would hold what it lacks.
    own = final.identifier.noise_floor_
    return np.where(np.isfinite(own), own, judged.noise_floor_)


def _scatter(interval):
    """Deviation of the logarithm of an error with a 90 % interval (2, nv)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(interval[1] / interval[0]) / (2 * HALF_WIDTH)


def _settings(search, asked):
    """Thresholds, blocks, seed and versions, a dict."""
    from sklearn_vbjfa import __version__

    view, seed = search.model.view, asked["random_state"]
    return {
        "test_size": float(asked["test_size"]),
        "alpha": float(asked["alpha"]),
        "n_candidates": int(search.n_candidates),
        "search": dataclasses.asdict(search.settings),
        "effects": tuple(e.name for e in search.library),
        "signals": tuple(view.signals),
        "n_blocks": view.blocks.n_blocks,
        "block_seconds": float(view.blocks.length),
        "n_folds": view.blocks.n_folds,
        "too_short": tuple(too_short(search.model, memory_seconds(search.model))),
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


# -- effects ---------------------------------------------------------------------------


def _effects(search, final, names, prismatic, seconds):
    """Yield each `DiscoveredEffect`, with the values of the final fit."""
    # The effects of the declared model come first.
    count = len(final.effects)
    ranges = final.identifier.effect_ranges_[-count:] if count else ()
    for finding, effect, estimate, fitted in zip(
        search.findings, final.effects, final.effect_estimates, ranges
    ):
        values, deviations = named_values(effect, estimate)
        half = quantile(estimate.freedom)
        units = effect.parameter_units(prismatic[effect.joint])
        # What no column determines, or no scatter tells of, has no interval.
        intervals = {
            key: (values[key] - half * std, values[key] + half * std)
            for key, std in deviations.items()
            if std > 0
        }
        rivals = (named_beside(r, finding.effect, names) for r in finding.rivals)
        known = search.settings.known
        yield DiscoveredEffect(
            name=effect.name,
            joint=effect.joint,
            joint_name=names[effect.joint],
            scope=effect.scope,
            parameters=values,
            units={key: units.get(key, "") for key in values},
            intervals=intervals,
            evidence=finding.evidence,
            rivals=tuple(dict.fromkeys(rivals)),
            trials=tuple(
                Trial(name=r.name, joint=r.joint, shape=r.shape())
                for r in finding.rivals
            ),
            effect=effect,
            ranges=fitted,
            afterwards=_afterwards(effect, estimate, seconds),
            warning=finding.warning
            or _unknown(effect, estimate.coef, values, deviations, intervals, known),
        )


def _unknown(effect, coef, values, deviations, intervals, known):
    """Say why the values of an effect give it no name; "" if they do."""
    if effect.in_model:
        nominal = dict(zip(effect.model_parameters, effect.nominal))
        sure = (
            abs(values[key] - nominal.get(key, 0.0)) > known * std
            for key, std in deviations.items()
            if std > 0
        )
        return "" if any(sure) else _UNSURE
    # A shape alone is no sign that the effect is there.
    own = [key for key in intervals if key not in effect.shape()] or list(intervals)
    if not any(coef):
        return _UNKNOWN
    away = (intervals[key][0] > 0.0 or intervals[key][1] < 0.0 for key in own)
    return "" if not own or any(away) else _UNKNOWN


def _afterwards(effect, estimate, seconds):
    """Return the state of an effect of time after the recording, or None."""
    if not isinstance(effect, OfTime):
        return None
    k = len(estimate.coef)

    def left(x):
        shape = dict(zip(estimate.shape, x[k:].tolist()))
        return clone(effect).set_params(**shape).later(x[:k], seconds)

    x = np.r_[estimate.coef, [getattr(effect, name) for name in estimate.shape]]
    found, deviations = _propagated(left, x, estimate.covariance)
    half = quantile(estimate.freedom)
    reach = {name: half * std for name, std in deviations.items() if std == std}
    return Afterwards(
        seconds=seconds,
        how=effect.afterwards,
        left=found,
        intervals={k: (found[k] - r, found[k] + r) for k, r in reach.items()},
    )


def named_values(effect, estimate):
    """Parameters as an engineer calls them, and standard deviations (delta method)."""
    covariance, k = estimate.covariance, len(estimate.coef)
    known = np.array(estimate.coef, dtype=float), covariance[:k, :k]
    values, deviations = _propagated(effect.parameters, *known)
    for i, name in enumerate(estimate.shape, k):
        if name not in values:
            values[name] = float(getattr(effect, name))
            own = np.arange(len(covariance)) == i
            deviations[name] = _deviation(own.astype(float), covariance)
    # About the value, of all forms together.
    for weight, other in estimate.forms:
        for key, value in other.items():
            away = np.sqrt(weight) * (value - values[key])
            deviations[key] = float(np.hypot(deviations[key], away))
    for name, value in effect.shape().items():
        values.setdefault(name, value)
    return values, deviations


def _propagated(function, x, covariance):
    """Values of a function of x (k,), by name, and their standard deviations."""
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    # Small compared with the value, where the deviation is not.
    steps = 1e-4 * np.minimum(scale, np.abs(x))
    steps[~(steps > 0)] = 1e-9
    values = function(x)
    sides = [
        [function(x + way * step) for way in (0.5, -0.5)] for step in np.diag(steps)
    ]
    deviations = {}
    for name in values:
        rises = np.array([above[name] - below[name] for above, below in sides])
        deviations[name] = _deviation(rises / steps, covariance)
    return values, deviations


def _deviation(slope, covariance):
    """Deviation of what has a slope by some values; nan if one of them is not known."""
    seen = slope != 0
    slope = slope[seen]
    return float(np.sqrt(np.maximum(slope @ covariance[np.ix_(seen, seen)] @ slope, 0)))
