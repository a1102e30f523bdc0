"""Results of a discovery as plain data."""

import dataclasses
import math
import platform
from dataclasses import dataclass, replace

import numpy as np
import scipy
import sklearn

from sklearn_vbjfa.diagnosis.explain._curves import residual_curves, torque_curves
from sklearn_vbjfa.diagnosis.explain._effects import discovered_effects
from sklearn_vbjfa.diagnosis.explain._errors import NEXT_SECONDS
from sklearn_vbjfa.diagnosis.explain._gaps import (
    ABOVE_FLOOR,
    WELL,
    is_refuted,
    not_identifiable,
    rises,
    unexplained,
)
from sklearn_vbjfa.diagnosis.explain._next import ExpectedError, motion_statistics
from sklearn_vbjfa.diagnosis.explain._recordings import RecordingMoments, contradictions
from sklearn_vbjfa.effects import OfTime, UnnamedTorque, declarable, resolve
from sklearn_vbjfa.equations._features import nominal_followers
from sklearn_vbjfa.inspection import motion_of
from sklearn_vbjfa.model import body_names, import_pinocchio, is_prismatic
from sklearn_vbjfa.model._loading import nominal_parameters
from sklearn_vbjfa.robot._channels import HALF_WIDTH
from sklearn_vbjfa.robot._corrections import corrections_of
from sklearn_vbjfa.robot._posterior import body_indices

# Limits that count as unlimited.
_UNLIMITED = 1e3
# Number of joints whose curves are drawn, those with the largest errors.
_N_DRAWN = 3


@dataclass(frozen=True, kw_only=True)
class JointErrors:
    """Errors of a joint on held-out data, over the standard deviation of its torque."""

    joint: int  # from zero
    name: str
    unit: str  # of the torque, "N m" or "N"; of the channel if its gain is relative
    position_unit: str = "rad"  # or "m"
    # RMS error of the declared model, with four friction terms, and completed
    before: float
    plain: float
    after: float
    floor: float  # due to noise alone; nan if unknown
    # ends of the 90 % intervals over the next 50 s of the same motion: of the error
    # "after", and of after minus before ("difference") and after minus plain ("added")
    intervals: dict
    spread: float = math.nan  # standard deviation of the torque in motion [unit]
    # 99.9 % quantile of |residual "after"| in the whole recording [unit]
    threshold: float = math.nan
    seconds: float = math.nan  # held-out time in which the joint moves [s]
    enough: bool = True  # whether that suffices for a verdict
    searched: bool = True  # whether its channels carry enough information


@dataclass(frozen=True, kw_only=True)
class Fact:
    """An identified value with its interval and source."""

    kind: str  # "parameter", "mass" or "next recording"
    name: str  # of the parameter or body
    joint: int | None  # from zero; None for the robot, and for the mean of its joints
    value: float
    interval: tuple  # 90 %; (nan, nan) where it is unknown
    unit: str = ""
    # whether the recording determines it ("yes", "in combination", "from the
    # description", "no"), or the source of the variance between recordings
    source: str = "yes"
    described: float = math.nan  # value of the robot description


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Results of a discovery, from which the report is made."""

    errors: tuple[JointErrors, ...]  # one for each joint
    # Tuples by kind: "effects", "possible", "unexplained", "not_identifiable",
    # "channels", "contradictions", "repeated", "unnamed", "departures", "alike".
    findings: dict
    facts: tuple[Fact, ...]
    # declared model ("name", "joints", "friction", ...), "added" terms, "gains" and
    # "corrections" of the exported model, "library" of effects
    robot: dict
    # for figures: "residuals", "torques"; "index" of the held-out rows
    curves: dict
    provenance: dict  # recordings, settings and versions; files and date if known

    @property
    def searched(self):
        """Whether effects were searched for."""
        return len(self.provenance["settings"].get("effects", "all")) > 0

    def column(self, name):
        """Return an attribute of the errors of all joints, (nv,)."""
        return np.array([getattr(joint, name) for joint in self.errors])

    def facts_of(self, kind):
        """Return the facts of a kind, a tuple."""
        return tuple(fact for fact in self.facts if fact.kind == kind)


def make_outcome(discovery, result, final, judged, channels, whole):
    """Return the `Outcome` of a discovery, and the `ExpectedError` of other motions."""
    # Its models were fitted to the rows of the search, `final` to all data;
    # `judged` is returned by `held_out_errors`; `whole` is all data.
    identifier, columns = final.identifier, dict(judged["columns"])
    names, spread, after = identifier.joint_names_, columns["spread"], columns["after"]
    validated = discovery.validation_model_
    # The final fit has the most data; missing effects raise the declared one's floor.
    floor = identifier.noise_floor_
    floor = np.where(np.isfinite(floor), floor, validated.noise_floor_)
    with np.errstate(divide="ignore", invalid="ignore"):
        columns["floor"] = floor / spread
    parts, interval = RecordingMoments.of(final), judged["intervals"]["after"]
    expectation, low = _expectation(final, parts, columns, interval), interval[0]
    noise, enough = low <= ABOVE_FLOOR[0] * columns["floor"], columns["enough"]
    good = noise & enough, (noise | (after < WELL) | ~enough) & enough.any()
    errors = np.where(enough, after, np.nan)
    least = np.fmin(columns["before"], columns["plain"])
    rose = rises(errors, least, columns["floor"])
    rising = np.where(rose, errors - least, np.fmin(errors - least, 0.0))
    differing = contradictions(parts, spread, discovery.alpha)
    hidden = not_identifiable(result, names)
    doubts = {x.joint for x in differing}, rising, hidden
    prismatic = is_prismatic(identifier.features_.model_)
    effects = tuple(discovered_effects(result, final, names, prismatic, *doubts))
    gains, units = np.abs(identifier.features_.gains_), np.where(prismatic, "N", "N m")
    if identifier.gains_ is not None and not identifier.gains_.absolute:
        gains, recorded = np.ones(spread.size), whole.torque_units
        units = ["channel units" if x in ("N m", "N", "") else x for x in recorded]
    residuals = [
        replace(x, torque=x.torque / gains, predicted=x.predicted / gains)
        for x in judged["residuals"]
    ]
    columns |= {"joint": range(spread.size), "name": names, "unit": units}
    columns |= {"position_unit": np.where(prismatic, "m", "rad")}
    sizes, parameters = (spread, floor, gains), parameter_values(identifier)
    masses = _masses(identifier, parameters)
    worst = np.argsort(-np.nan_to_num(after, nan=-1), kind="stable")[:_N_DRAWN].tolist()
    outcome = Outcome(
        errors=_joint_errors(columns, judged["intervals"], gains),
        findings={
            "effects": tuple(e for e in effects if not e.warning),
            "possible": tuple(e for e in effects if e.warning),
            "unnamed": tuple(
                e for e in validated.effects_ if isinstance(e, UnnamedTorque)
            ),
            "unexplained": unexplained(result, names, sizes, errors, low),
            "not_identifiable": hidden,
            "channels": tuple(c for c in channels if not is_refuted(c, *good)),
            "contradictions": differing,
            "repeated": final.view.repetition.repeated,
            "departures": identifier.mass_deviations_,
            "alike": identifier.alike_,
        },
        facts=(*parameters, *masses, *_expected(expectation, names)),
        robot=_robot(discovery, result, identifier, whole),
        curves={
            "index": residuals[0].index,
            "residuals": residual_curves(residuals[1], discovery.declared_.dt, worst),
            "torques": torque_curves(*residuals, whole.t, worst),
        },
        provenance={
            "recordings": tuple(map(str, whole.group_names)),
            "samples": int(whole.n_samples),
            "seconds": float(whole.n_samples * whole.dt),
            "rate": float(1.0 / whole.dt),
            "looked_at": judged["looked_at"],
            "left_out": expectation.recordings,
            "settings": _settings(discovery, result) | judged["settings"],
        },
    )
    return outcome, expectation


def _joint_errors(columns, intervals, gains):
    """Return the `JointErrors` of all joints, torques in units of the channels."""
    intervals = {key: zip(*ends.tolist()) for key, ends in intervals.items()}
    columns = columns | {key: columns[key] / gains for key in ("spread", "threshold")}
    rows = _rows(columns | {"intervals": _rows(intervals)})
    return tuple(JointErrors(**row) for row in rows)


def _expectation(final, parts, columns, interval):
    """Return the `ExpectedError` of a final fit, from its errors."""
    identifier, error, spread = final.identifier, columns["after"], columns["spread"]
    with np.errstate(divide="ignore", invalid="ignore"):
        scatter = np.log(interval[1] / interval[0]) / (2 * HALF_WIDTH)
    left_out, alone = np.empty((0, spread.size)), error
    if parts is not None:
        left_out, alone = parts.left_out(spread), parts.alone(spread)
    states, weight = final.view.states[final.view.index], final.view.equations.weight
    predicted = final.predicted(identifier.theta_) / final.view.gains
    spread = spread / np.abs(identifier.features_.gains_)
    motion = motion_statistics(identifier, states, predicted, weight, spread)
    timed = any(isinstance(effect, OfTime) for effect in identifier.effects_)
    data = columns["floor"], scatter, left_out, alone, motion, timed
    return ExpectedError(error, *data)


def _robot(discovery, result, identifier, whole):
    """Describe the declared model, and properties of the completed one."""
    robot, drive = discovery.declared_, discovery.declared_.drive
    features, plain = robot.features_, discovery.baseline_.features_.friction_
    model = features.model_
    library = (*resolve(declarable()), *robot.effects_, *result.library)
    limits = [model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit]
    limits = np.array(limits).T
    # Descriptions without limits are read as zeros.
    unknown = (np.abs(limits) > _UNLIMITED) | ~limits.any(axis=1, keepdims=True)
    return {
        "name": model.name,
        "joints": robot.joint_names_,
        "friction": features.friction_,
        "added": tuple(name for name in plain if name not in features.friction_),
        "n_parameters": features.n_parameters_,
        "cutoff": float(robot.cutoff_),
        # lowest and highest position and speed of each joint
        "limits": np.where(unknown, np.inf, limits),
        # its inputs replace measured torques
        "drive": drive and {"kind": type(drive).__name__, **drive.facts(whole)},
        "motion": motion_of(whole, features.nominal_),
        "gains": identifier.gains_,
        "corrections": corrections_of(identifier),
        "common_size": identifier.common_size_,
        "library": {effect.name: effect for effect in library},
        # joints with declared effects that a simulation omits
        "unsimulated": [x.joint for x in robot.effects_ if x.files.simulation],
    }


def _settings(discovery, result):
    """Thresholds, signals and versions, a dict."""
    from sklearn_vbjfa import __version__

    return {
        "test_size": float(discovery.test_size),
        "alpha": float(discovery.alpha),
        "n_candidates": int(result.n_candidates),
        "search": dataclasses.asdict(result.settings),
        "effects": tuple(e.name for e in result.library),
        "signals": tuple(result.view.signals),
        "error_seconds": NEXT_SECONDS,
        "versions": {
            "sklearn_vbjfa": __version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "scikit-learn": sklearn.__version__,
            "pinocchio": import_pinocchio().__version__,
            "python": platform.python_version(),
        },
    }


def parameter_values(robot):
    """Return the parameters of a fitted identifier, a tuple of Fact."""
    features, nominal = robot.features_, np.full(robot.theta_.size, np.nan)
    names, joints, theta = robot.parameter_names_, robot.joint_names_, robot.theta_
    if robot.gains_ is None or robot.gains_.absolute:
        # Unknown gains of the torque channels scale all values.
        bodies = nominal_parameters(features.nominal_), nominal_followers(features)
        nominal[body_indices(robot)] = np.vstack(bodies)
    std = robot.theta_std_
    half = HALF_WIDTH * np.where(np.isfinite(std), std, np.nan)
    # The longest match, since names may contain colons.
    owners = ([j for j, x in enumerate(joints) if n.startswith(f"{x}:")] for n in names)
    columns = {
        "name": names,
        "joint": [max(x, key=lambda j: len(joints[j]), default=None) for x in owners],
        "value": theta,
        "interval": zip((theta - half).tolist(), (theta + half).tolist()),
        "unit": robot.parameter_units_,
        "source": robot.robot_.known_,
        "described": nominal,
    }
    return tuple(Fact(kind="parameter", **row) for row in _rows(columns))


def _rows(columns):
    """Return the rows of a table as dicts; columns are arrays or iterables."""
    values = (x.tolist() if isinstance(x, np.ndarray) else x for x in columns.values())
    return [dict(zip(columns, row)) for row in zip(*values)]


def _masses(robot, parameters):
    """Yield the masses of bodies as facts."""
    model = robot.features_.model_
    nominal = nominal_parameters(model)[:, 0].tolist()
    rows = zip(body_names(model), body_indices(robot)[:, 0], nominal)
    for name, at, described in rows:
        yield replace(parameters[at], kind="mass", name=name, described=described)


def _expected(expectation, names):
    """Yield the expected errors of a next recording with the same motion."""
    about = {"kind": "next recording", "source": expectation.source}
    joints = [*enumerate(names), (None, "mean of the joints")]
    for (joint, name), (error, *ends) in zip(joints, expectation.of().T.tolist()):
        yield Fact(name=name, joint=joint, value=error, interval=tuple(ends), **about)
