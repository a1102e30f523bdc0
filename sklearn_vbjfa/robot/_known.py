"""Which parameters of a fitted robot are measured, and which only agree with it."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.model import body_names, nominal_parameters

# A mass is known if its deviation, and what the projection moves it by, are below this
# share of it: a body that may as well have half or no mass was not weighed.
_KNOWN = 0.5


@dataclass(frozen=True, kw_only=True)
class BodyMass:
    """Mass of a body that a joint moves."""

    joint: int  # from zero
    name: str  # of the body
    mass: float  # of the fitted robot [kg]
    std: float  # [kg]; nan or infinite where there is none
    nominal: float  # of the robot description [kg]
    known: str  # whether the recording determines it, see `known_parameters`


def known_parameters(robot):
    """State which parameters of a fitted identifier the recording determines."""
    # "yes": by itself, as well as its standard deviation says. "in combination":
    # torques depend on it, but only together with others; its value agrees with them
    # and with the robot description, but is one of many. "from the description": the
    # torques say little beyond it (`from_description_`). "no": no torque depends on it,
    # or it is a mass whose deviation, with what the projection moved it by, is over
    # half its value. A robot from a file says itself what was known.
    if hasattr(robot, "known_"):
        return robot.known_
    # Values of effects in the model have no columns of their own.
    seen = (np.diagonal(robot.estimator_.metric_) > 0) | robot.identifiable_
    known = np.where(robot.identifiable_, "yes", "in combination").astype(object)
    known[~seen] = "no"
    masses = _masses(robot)
    moved = robot.theta_ - robot.theta_unconstrained_
    doubt = np.hypot(np.nan_to_num(robot.theta_std_, posinf=np.inf), moved)
    with np.errstate(invalid="ignore"):
        vague = ~(doubt[masses] <= _KNOWN * robot.theta_[masses])
    vague &= robot.identifiable_[masses]
    known[masses[vague]] = "no"
    silent = (known == "no") & np.isfinite(robot.theta_prior_std_)
    known[silent | robot.from_description_] = "from the description"
    return tuple(known)


def _masses(robot):
    """Return where the masses are among the parameters, (nv,)."""
    nv = robot.features_.n_joints_
    return np.arange(nv) * (robot.features_.n_parameters_ // nv)


def body_masses(robot):
    """Masses of a fitted identifier's bodies, tuple of `BodyMass`."""
    known = known_parameters(robot)
    model = robot.features_.model_
    nominal = nominal_parameters(model)[:, 0]
    return tuple(
        BodyMass(
            joint=joint,
            name=name,
            mass=float(robot.theta_[at]),
            std=float(robot.theta_std_[at]),
            nominal=float(nominal[joint]),
            known=known[at],
        )
        for joint, (name, at) in enumerate(zip(body_names(model), _masses(robot)))
    )


def note_of_masses(robot):
    """Say which bodies of an identified robot have no measured mass; empty for none."""
    names = [body.name for body in body_masses(robot) if body.known != "yes"]
    if not names:
        return ""
    return (
        f"The recording does not determine the masses of {', '.join(names)}: their "
        "inertias agree with the torques, but are not measured one by one."
    )
