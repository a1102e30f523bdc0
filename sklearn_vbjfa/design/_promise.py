"""What a motion will show: conditions, expected intervals, effects and their rivals."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from sklearn_vbjfa.design._criterion import DECIDED, worth

# Why no motion shows an effect.
SAME_COLUMNS = "what is fitted anyway does the same, whatever the motion"
# Half width of a 90 % interval, in standard errors.
_NINETY = float(ndtri(0.95))


@dataclass(frozen=True, kw_only=True)
class ExpectedInterval:
    """How well a parameter will be known."""

    # one of the bodies stands for the combination of parameters that torques depend on
    name: str
    unit: str
    half_width: float  # of its 90 % interval
    # what the model has now, of bodies of the combination; nan if nothing is known
    value: float


@dataclass(frozen=True, kw_only=True)
class Visible:
    """An effect that a motion shows."""

    name: str
    joint: int  # from zero
    joint_name: str
    # smallest root mean square of its torque, in the most active conditions, that is
    # told from the model and from its nearest rival [N m or N]
    least: float
    rival: str  # empty if there is none


@dataclass(frozen=True, kw_only=True)
class Parted:
    """Two causes of which a report leaves open which one it is."""

    names: tuple
    joint: int  # from zero
    joint_name: str
    # smallest root mean square of the torque of either, in the most active conditions,
    # at which it is told from the other [N m or N]
    least: float


@dataclass(frozen=True, kw_only=True)
class Invisible:
    """An effect that a motion does not show."""

    name: str
    joint: int  # from zero
    joint_name: str
    reason: str


def condition_number(problem, states):
    """Condition number of the model's columns, rows over their noise."""
    # Columns are over their sizes at random states within the limits, the same for all
    # motions.
    n = problem.model.n_model
    scale = problem.questions.scale[:n]
    M = problem.information(states, 1.0)[:n, :n] * np.outer(scale, scale)
    values = np.linalg.eigvalsh(M)
    if not values[0] > 1e-14 * values[-1]:
        return float("inf")
    return float(np.sqrt(values[-1] / values[0]))


def expected_intervals(problem, robot, states, step):
    """Return the expected 90 % intervals of the parameters of the model."""
    model = problem.model
    n = model.n_model
    M = problem.information(states, step)[:n, :n]
    size = np.sqrt(np.diag(M))
    safe = np.where(size > 0, size, 1.0)
    variance = np.diag(np.linalg.pinv(M / np.outer(safe, safe), hermitian=True))
    width = np.where(size > 0, _NINETY * np.sqrt(variance) / safe, np.inf)
    features = robot.features
    names = [features.parameter_names_[k] for k in model.base]
    units = [features.parameter_units_[k] for k in model.base]
    for one in model.effects[: model.n_own]:
        effect = one.effect
        joint = robot.joint_names[effect.joint]
        kind = int(bool(model.prismatic[effect.joint]))
        for c, unit in zip(effect.coefficients, effect.units):
            names.append(
                f"{joint}:{effect.name}"
                + (f":{c}" if len(effect.coefficients) > 1 else "")
            )
            units.append(unit[kind])
    return tuple(
        ExpectedInterval(name=name, unit=unit, half_width=float(w), value=float(c))
        for name, unit, w, c in zip(names, units, width, problem.coefficients)
    )


def _least(noise, evidence):
    """Torque that decides, where one as large as the noise has some evidence."""
    return float(noise * np.sqrt(DECIDED / max(evidence, 1e-12)))


def promise(problem, robot, states, step, noise):
    """Say what the motion shows and what not, keyword arguments of the motion."""
    questions, model = problem.questions, problem.model
    if not questions.effects:
        return {}
    judged = worth(problem.information(states, step), questions)
    effects = [one.effect for one in model.effects[model.n_own :]]
    asked = questions.beside > 0
    # Of what the library holds beside it nobody has asked.
    asked_for = questions.beside >= 1
    shows, invisible = [], []
    for k, effect in enumerate(effects):
        told = {
            "name": effect.name,
            "joint": effect.joint,
            "joint_name": robot.joint_names[effect.joint],
        }
        if not questions.alone[k] > 0:
            invisible.append(Invisible(reason=SAME_COLUMNS, **told))
            continue
        evidence, rival = judged.alone[k], ""
        if asked[k].any():
            beside = np.where(asked[k], judged.beside[k], np.inf)
            nearest = int(np.argmin(beside))
            if beside[nearest] < evidence:
                evidence, rival = beside[nearest], effects[nearest].name
        least = _least(noise[effect.joint], evidence)
        shows.append(Visible(least=least, rival=rival, **told))
    parts = []
    for k, i in zip(*np.nonzero(np.triu(np.minimum(asked_for, asked_for.T)))):
        weakest = min(judged.beside[k, i], judged.beside[i, k])
        joint = effects[k].joint
        parts.append(
            Parted(
                names=(effects[k].name, effects[i].name),
                joint=joint,
                joint_name=robot.joint_names[joint],
                least=_least(noise[joint], weakest),
            )
        )
    return {
        "shows": tuple(shows),
        "invisible": tuple(invisible),
        "parts": tuple(sorted(parts, key=lambda one: (one.joint, one.least))),
    }
