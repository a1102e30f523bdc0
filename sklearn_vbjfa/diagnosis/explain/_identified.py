"""The fit that is handed over: its parameters, and the band of its errors."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.model._loading import nominal_parameters
from sklearn_vbjfa.robot._features import nominal_followers
from sklearn_vbjfa.robot._gains import HALF_WIDTH
from sklearn_vbjfa.robot._plan import CUTOFF_PER_BANDWIDTH, resolve_cutoff

# Inertial parameters of a body, Pinocchio's.
_INERTIAL = 10


@dataclass(frozen=True, kw_only=True)
class ParameterValue:
    """A parameter of the model that is handed over."""

    name: str  # as in `RobotIdentifier.parameter_names_`
    value: float
    interval: tuple  # 90 %; (nan, nan) where the recording says nothing
    unit: str
    # value of the robot description; nan for what it does not have, and where the gain
    # of the torque channels is unknown, which is in every value
    nominal: float
    known: str  # whether the recording determines it
    # deviation of the description before the recording, nan where it says nothing
    before: float = float("nan")
    # share of that variance which the recording took away; nan where there is none
    learned: float = float("nan")


@dataclass(frozen=True, kw_only=True)
class RecordedMotion:
    """What was recorded."""

    samples: int  # rows
    seconds: float  # nan if the sample period is not known
    rate: float  # [Hz]; nan if it is not known
    # rows that the search looked at, of more than it might; 0 if at all
    looked_at: int = 0


def parameter_values(robot):
    """Return the parameters of a fitted identifier, a tuple of ParameterValue."""
    nv, count = robot.features_.n_joints_, robot.features_.n_parameters_
    nominal = np.full(robot.theta_.size, np.nan)
    if robot.gains_ is None or robot.gains_.absolute:
        at = np.arange(nv)[:, None] * (count // nv) + np.arange(_INERTIAL)
        nominal[at] = nominal_parameters(robot.features_.nominal_)
        followers = nominal_followers(robot.features_).ravel()
        nominal[count : count + followers.size] = followers
    found = []
    for name, value, std, unit, description, known, prior in zip(
        robot.parameter_names_,
        robot.theta_,
        robot.theta_std_,
        robot.parameter_units_,
        nominal,
        robot.robot_.known_,
        robot.theta_prior_std_,
    ):
        half = HALF_WIDTH * std if np.isfinite(std) else np.nan
        found.append(
            ParameterValue(
                name=name,
                value=float(value),
                interval=(float(value - half), float(value + half)),
                unit=unit,
                nominal=float(description),
                known=known,
                before=float(prior),
                learned=float(np.clip(1.0 - (std / prior) ** 2, 0.0, 1.0))
                if prior > 0
                else float("nan"),
            )
        )
    return tuple(found)


def alike_values(alike):
    """Return what alike joints share, and factors of those that do not share it."""
    for one in alike:
        name = f"{one.group}:{one.parameter}"
        if one.joints:
            yield _known(name, one.value, one.std, one.unit), one.std, one.scatter
        for other in one.apart:
            for joint, factor, std in zip(other.bodies, other.factors, other.stds):
                over = f"{joint}:{one.parameter} over the other {one.group} joints"
                yield _known(over, factor, std, "times"), std, np.nan


def _known(name, value, std, unit):
    """Collect a value that the recording determines."""
    half = HALF_WIDTH * std
    return ParameterValue(
        name=name,
        value=float(value),
        interval=(float(value - half), float(value + half)),
        unit=unit,
        nominal=np.nan,
        known="yes",
    )


def recorded_motion(n_samples, dt, looked_at=0):
    """Return what was recorded; `dt` is the sample period [s] or None."""
    return RecordedMotion(
        samples=int(n_samples),
        seconds=float("nan") if dt is None else float(n_samples * dt),
        rate=float("nan") if dt is None else float(1.0 / dt),
        looked_at=looked_at,
    )


# -- the band --------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """The band of a fit, and what lies in it."""

    cutoff: float  # of regressor and torques [Hz]; infinity if nothing is filtered
    # bandwidth of the motion; length of the recording, of which the filter may be a
    # small part only; the user, with a frequency or with None; states that were given,
    # which are not filtered; or a motion too fast for the sample rate to be filtered
    decided_by: str
    # what the motion asks for [Hz]; infinity for none, nan if the states were given
    automatic: float
    # frequency below which 99 % of the power of the fastest joint's velocity lies [Hz];
    # nan if the states were given
    bandwidth: float
    fastest: int  # that joint, from zero
    # cut-off of its states [Hz], where its motion meets the encoder noise unless it was
    # given; infinity where nothing is smoothed
    smoothed_at: float
    # (nv,): share of the power (about the mean) of velocity and torque that the
    # low-pass lets through, while the joint moves; nan for a joint that does not
    speed_share: np.ndarray
    torque_share: np.ndarray
    sample_rate: float  # [Hz]; nan if unknown


def measure_band(view, asked, longest):
    """Describe the band of a fitted declared model, as a `Band`."""
    robot = view.robot
    estimator, nv = robot.state_estimator_, view.nv
    bandwidth, fastest, smoothed_at, automatic = np.nan, 0, np.nan, np.nan
    if estimator is not None:
        fastest = int(np.argmax(estimator.bandwidth_))
        bandwidth = float(estimator.bandwidth_[fastest])
        smoothed_at = float(estimator.cutoff_[fastest])
        automatic = resolve_cutoff("auto", longest, robot.dt, estimator)
        if isinstance(asked, str):
            automatic = float(robot.cutoff_)
    velocity = view.states[:, nv : 2 * nv]
    weight = view.equations.weight
    return Band(
        cutoff=float(robot.cutoff_),
        decided_by=_decided_by(robot, asked, bandwidth),
        automatic=automatic,
        bandwidth=bandwidth,
        fastest=fastest,
        smoothed_at=smoothed_at,
        speed_share=power_share(velocity[view.index], view.filtered(velocity), weight),
        torque_share=power_share(view.measured, view.equations.tau, weight),
        sample_rate=np.nan if robot.dt is None else 1.0 / robot.dt,
    )


def _decided_by(robot, asked, bandwidth):
    """Say what the cut-off of a fitted identifier follows from."""
    finite = np.isfinite(robot.cutoff_)
    if not isinstance(asked, str):
        return "given" if finite else "none"
    if robot.state_estimator_ is None:
        return "states"
    if not finite:
        return "sample rate"
    motion = CUTOFF_PER_BANDWIDTH * bandwidth
    if np.isclose(robot.cutoff_, motion):
        return "motion"
    return "length" if robot.cutoff_ > motion else "drive"


def power_share(raw, filtered, weight):
    """Share of the power of signals (m, nv) that a filter leaves."""
    # Their power is about their mean; weight (m, nv) tells which rows count. nan for a
    # constant signal.
    with np.errstate(divide="ignore", invalid="ignore"):
        total = weight.sum(axis=0)
        mean = (weight * raw).sum(axis=0) / total
        power = (weight * (raw - mean) ** 2).sum(axis=0)
        lost = (weight * (raw - filtered) ** 2).sum(axis=0)
        return np.where(power > 0, np.clip(1.0 - lost / power, 0.0, 1.0), np.nan)
