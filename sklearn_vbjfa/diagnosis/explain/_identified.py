"""Parameters of the fit that is reported."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.equations._features import nominal_followers
from sklearn_vbjfa.model._loading import nominal_parameters
from sklearn_vbjfa.robot._channels import HALF_WIDTH

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
