"""Hypotheses on torques: their size, and what they leave out."""

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import (
    Candidate,
    Hypothesis,
    every,
    of,
    score_of,
)
from sklearn_vbjfa.inspection._signals import Change
from sklearn_vbjfa.recording import listed_joints

# Torque in N m is this many times a number in the unit.
_UNITS = {
    "kgf m": 9.80665,
    "lbf ft": 1.35582,
    "lbf in": 0.112985,
    "kgf cm": 0.0980665,
    "N cm": 0.01,
    "ozf in": 0.00706155,
    "N mm or mN m": 0.001,
    "gf cm": 9.80665e-5,
}


# -- size ------------------------------------------------------------------------------


def factor_of(robot):
    """Factor of all torques against the described ones, and its relative error."""
    factor, nothing = 1.0, np.zeros_like(robot.signals.now)
    columns = robot.described[:, :, None]
    for _ in range(number.PASSES):
        fit = robot.fit(scale=abs(factor), mean=nothing, columns=columns)
        factor = float(fit.factors[0])
        if factor <= 0:
            return 0.0, np.inf
    return factor, float(fit.errors[0]) / factor


def size_message(factor, error, n_joints):
    """Say that all torques are so many times the described ones."""
    # error: standard error of the logarithm.
    low, high = (factor * np.exp(x * number.INTERVAL * error) for x in (-1.0, 1.0))
    inside = [name for name, x in _UNITS.items() if low < 1 / x < high]
    unit = f" ({' or '.join(inside)} would be inside)" if inside else ""
    what = (
        "motor currents, or in another unit than N m"
        if factor < 1
        else "in another unit than N m"
    )
    unknown = ', or --gain unknown (Python: gains="unknown")' if n_joints > 1 else ""
    return (
        f"All torques together are {factor:.3g} ({low:.2g} to {high:.2g}) times what "
        f"the described masses require: they are {what}{unit}, or the described masses "
        f"are wrong. Give the factor to N m (--gain {1 / factor:.3g}){unknown}; if "
        'they are N m, use --bodies free (Python: bodies="free").'
    )


def _scaled(reading):
    """Return all torques over a factor."""
    factor, error = factor_of(reading.robot)
    if factor == 0.0 or 1 / number.SCALE < factor < number.SCALE:
        return None
    score = score_of(reading.robot, reading.robot.fit(scale=factor))
    return Candidate(
        change=Change(scale=1 / factor),
        joints=every(reading),
        log_odds=of(score, reading.now, 1),
        values={"factor": factor, "error": error},
    )


def _say_scaled(reading, candidate):
    values = candidate.values
    return size_message(values["factor"], values["error"], reading.nv)


def _factors(robot):
    """Factor of each joint's torque (nv,), and its error; nan where nothing is said."""
    nv = robot.bodies.nv
    columns = np.zeros((*robot.described.shape, nv))
    columns[:, np.arange(nv), np.arange(nv)] = robot.described
    factors = np.ones(nv)
    for _ in range(number.PASSES):
        tau = robot.signals.now / factors
        fit = robot.fit(tau=tau, mean=np.zeros_like(tau), columns=columns)
        error = number.INTERVAL * fit.errors
        # Of joints that the masses hardly load, nothing is said.
        known = (fit.factors > 2 * error) & (error < 1.0)
        factors = factors * np.where(known, fit.factors, 1.0)
    return np.where(known, factors, np.nan)


def _scaled_each(reading):
    """Return torques with a different factor on each joint."""
    robot = reading.robot
    factors = _factors(robot)
    known = np.isfinite(factors)
    if known.sum() < 2:
        return None
    # Of many, a single one that is off is another finding.
    ordered = np.sort(factors[known])
    ordered = ordered[1:-1] if ordered.size > 3 else ordered
    if ordered[-1] < number.SCALE * ordered[0]:
        return None
    whole = np.where(known, factors, np.exp(np.log(factors[known]).mean()))
    change = Change(scale=1 / whole)
    score = reading.tried(change)
    return score and Candidate(
        change=change,
        joints=every(reading),
        log_odds=of(score, reading.now, 1),
        values={"factors": factors},
    )


def _say_each(reading, candidate):
    factors = candidate.values["factors"]
    each = ", ".join(
        f"{reading.names[j]} {factors[j]:.2g}"
        for j in np.flatnonzero(np.isfinite(factors))
    )
    return (
        "The torques have different factors against what the described masses require "
        f"({each}): motor currents, or shares of each joint's rated torque. Give the "
        'factors to N m (--gain), or --gain unknown (Python: gains="unknown").'
    )


def _scaled_one(reading):
    """Return the torque of one joint over a factor that differs from the others'."""
    # A doubt and not an error: a description with invented inertias looks the same.
    robot, best = reading.robot, None
    now, nv = robot.signals.now, reading.nv
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = now.std(axis=0) / robot.described.std(axis=0)
    for j in robot.joints:
        others = [sizes[k] for k in robot.joints if k != j and np.isfinite(sizes[k])]
        middle = float(np.median(others)) if others else 1.0
        if not np.isfinite(sizes[j]) or sizes[j] <= 0:
            continue
        if 1 / number.SINGLE < sizes[j] / max(middle, 1e-300) < number.SINGLE:
            continue
        factor = _factor_of_joint(robot, j, sizes[j])
        if factor is None or 1 / number.SINGLE < factor < number.SINGLE:
            continue
        change = Change(scale=np.where(np.arange(nv) == j, 1 / factor, 1.0))
        score = reading.tried(change)
        if score is None:
            continue
        log_odds = of(score, reading.now, nv)
        if best is None or log_odds > best.log_odds:
            best = Candidate(
                change=change,
                joints=(int(j),),
                log_odds=log_odds,
                values={"factor": factor},
            )
    return best


def _factor_of_joint(robot, j, factor):
    """Factor of one torque, about a first value; None if it is not shown."""
    columns = np.zeros((*robot.described.shape, 1))
    columns[:, j, 0] = robot.described[:, j]
    mean = robot.described.copy()
    mean[:, j] = 0.0
    for _ in range(number.PASSES):
        tau = robot.signals.now.copy()
        tau[:, j] /= factor
        fit = robot.fit(tau=tau, mean=mean, columns=columns)
        if not fit.factors[0] > 2 * number.INTERVAL * fit.errors[0]:
            return None
        factor *= float(fit.factors[0])
    return factor


def _say_one(reading, candidate):
    (j,), factor = candidate.joints, candidate.values["factor"]
    ratio = f"{1 / factor:.3g}" if factor < 1 else f"1/{factor:.3g}"
    return (
        f"The torque of {reading.names[j]} is {factor:.3g} times what the masses of "
        "the robot description require: torque of the motor instead of the joint, a "
        f"current, or another unit? Multiply it by the gear ratio (about {ratio} would "
        "fit)."
    )


def _silent(reading):
    """Return a torque that does not follow a motion that should load it."""
    robot = reading.robot
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = robot.signals.now.std(axis=0) / robot.described.std(axis=0)
    for j, error in zip(robot.joints, robot.errors()):
        others = [k for k in robot.joints if k != j and np.isfinite(sizes[k])]
        usual = min(np.median(sizes[others]), 1.0) if others else 1.0
        if sizes[j] < number.SILENT * usual and error > number.UNRELATED:
            return Candidate(
                change=Change(),
                joints=(int(j),),
                log_odds=np.inf,
                values={"size": sizes[j]},
            )
    return None


def _say_silent(reading, candidate):
    (j,) = candidate.joints
    return (
        f"The torque of {reading.names[j]} does not follow the motion and is "
        f"{candidate.values['size']:.2g} times what the description requires: only "
        "noise was recorded. Check the cable or the column, or leave the joint out "
        "(--joints)."
    )


def _commanded(reading):
    """Return commanded torques whose order of magnitude contradicts the model."""
    now, described = reading.robot.signals.now, reading.robot.described
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = now.std(axis=0) / described.std(axis=0)
    joints = [j for j in reading.robot.joints if np.isfinite(sizes[j])]
    middle = float(np.median(sizes[joints])) if joints else 1.0
    if 1 / number.COMMANDED < middle < number.COMMANDED:
        return None
    return Candidate(
        change=Change(scale=1 / middle),
        joints=tuple(int(j) for j in joints),
        log_odds=np.inf,
        values={"factor": middle, "name": "gear_factor"},
    )


def _say_commanded(reading, candidate):
    return (
        f"The commanded torques are {candidate.values['factor']:.2g} times those of "
        "the described robot, in the median over the joints: check the numbers of the "
        "drive (--drive)."
    )


# -- weight ----------------------------------------------------------------------------


def loaded(robot, weight):
    """Joints that weights (n, nv) load, and the largest weight."""
    heavy = np.abs(weight).max(axis=0)
    return [int(j) for j in robot.joints if heavy[j] > 0.1 * heavy.max()], heavy.max()


def as_springs(robot):
    """Return the evidence for springs between all joints, the weight as described."""
    # In a small motion the lack of weight, or its turn, is linear in the positions.
    nv, tau = robot.signals.now.shape[1], robot.signals.now
    q = robot.signals.states[:, :nv]
    q = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-300)
    columns = np.einsum("ni,jk->njik", q, np.eye(nv) * np.sqrt((tau**2).mean(axis=0)))
    columns = columns.reshape(len(q), nv, nv * nv)
    return robot.fit(columns=columns, deviation=1.0).evidence


def _weightless(reading):
    """Return torques without the weight of the links."""
    robot = reading.robot
    down, moving, weight = robot.bodies.pull, robot.moving, robot.weight
    columns, share, scale = np.stack([moving, weight], axis=-1), 1.0, 1.0
    nothing = np.zeros_like(moving)
    for _ in range(number.PASSES):
        entries = robot.pulled(share * down)
        fit = robot.fit(entries, scale=scale, mean=nothing, columns=columns)
        error = number.INTERVAL * fit.errors
        # Slow motion does not show the scale: it is that of N m then.
        shown = fit.factors[0] > 2 * error[0]
        scale = float(fit.factors[0]) if shown else 1.0
        share = float(fit.factors[1]) / scale
    least = number.NO_WEIGHT if shown else 0.1 * number.NO_WEIGHT
    if abs(share) + error[1] / scale > least:
        return None
    # Without any weight, or with that of the description taken off.
    added = robot.fit(tau=robot.signals.now + scale * weight, scale=scale)
    without = robot.fit(robot.pulled(0 * down), scale=scale)
    described = robot.fit(scale=scale)
    joints, heavy = loaded(robot, weight)
    # What balances a single joint is likelier a spring.
    severity = "doubt" if len(joints) < 2 else "error"
    best = max(without, added, key=lambda fit: fit.evidence)
    if as_springs(robot) > best.evidence - number.RIVAL:
        return None
    now = max(reading.now.evidence, score_of(robot, described).evidence)
    return Candidate(
        change=Change(gravity=np.zeros(3)),
        joints=tuple(joints),
        log_odds=score_of(robot, best).evidence - now + number.PRIOR,
        values={
            "severity": severity,
            "share": share,
            "error": error[1] / scale,
            "heavy": heavy,
        },
    )


def _say_weightless(reading, candidate):
    values = candidate.values
    other = " Or a spring balances it." if values["severity"] == "doubt" else ""
    return (
        f"The torques contain no weight of the links: the factor of gravity is "
        f"{values['share']:.2f} ± {values['error']:.2f} (described weight: up to "
        f"{values['heavy']:.3g} N m on "
        f"{listed_joints(reading.names, candidate.joints)}). "
        "Controllers that compensate gravity report such torques: log the full torque, "
        f"or add the weight.{other}"
    )


def _static(reading):
    """Return torques that hold nothing but the weight of the links."""
    robot = reading.robot
    columns = np.stack([robot.moving, robot.weight], axis=-1)
    fit = robot.fit(mean=np.zeros_like(robot.moving), columns=columns)
    error = number.INTERVAL * fit.errors
    part, weight = fit.factors
    if not (abs(part) + error[0] < number.NO_WEIGHT and weight > error[1]):
        return None
    still = robot.fit(robot.entries - robot.pulled(np.zeros(3)))
    return Candidate(
        change=Change(),
        joints=every(reading),
        log_odds=of(score_of(robot, still), reading.now, 1),
        values={"part": part, "error": error[0]},
    )


def _say_static(reading, candidate):
    values = candidate.values
    return (
        "The torques contain the weight of the links alone: the factor of their "
        f"inertia is {values['part']:.2f} ± {values['error']:.2f}. A model of gravity "
        "was logged, not a measurement: log the torques or currents of the motors."
    )


def _computed(reading):
    """Return torques that are those of the description: no friction, no noise."""
    robot = reading.robot
    left = robot.signals.now - robot.described
    share = [
        np.sqrt(np.mean(left[robot.rows[j], j] ** 2) / variance)
        for j, variance in zip(robot.joints, robot.variance)
    ]
    if len(share) < 2 or max(share) > number.COMPUTED:
        return None
    return Candidate(
        change=Change(),
        joints=every(reading),
        log_odds=np.inf,
        values={"share": max(share)},
    )


def _say_computed(reading, candidate):
    return (
        "The torques are those of the description to "
        f"{100 * candidate.values['share']:.1g} %, without friction: a model was "
        "logged, not a measurement, and nothing can be identified beyond it. Log the "
        "torques or currents of the motors."
    )


def _measured(reading):
    return not reading.commanded


def _measured_weight(reading):
    return not (reading.commanded or reading.bodies.weightless)


HYPOTHESES = (
    Hypothesis(
        name="torque_unit",
        severity="doubt",
        applies=_measured,
        propose=_scaled,
        message=_say_scaled,
    ),
    Hypothesis(
        name="torque_factors",
        severity="doubt",
        applies=_measured,
        propose=_scaled_each,
        message=_say_each,
    ),
    Hypothesis(
        name="gear_factor",
        severity="doubt",
        applies=_measured,
        propose=_scaled_one,
        message=_say_one,
    ),
    Hypothesis(
        name="commanded_size",
        severity="doubt",
        applies=lambda reading: reading.commanded,
        propose=_commanded,
        message=_say_commanded,
    ),
    Hypothesis(
        name="no_gravity",
        severity="error",
        applies=_measured_weight,
        propose=_weightless,
        message=_say_weightless,
    ),
    Hypothesis(
        name="gravity_only",
        severity="error",
        applies=_measured_weight,
        propose=_static,
        message=_say_static,
        repairs=False,
    ),
    Hypothesis(
        name="computed_torque",
        severity="doubt",
        applies=_measured,
        propose=_computed,
        message=_say_computed,
        repairs=False,
    ),
    Hypothesis(
        name="silent_torque",
        severity="error",
        applies=_measured,
        propose=_silent,
        message=_say_silent,
        repairs=False,
    ),
)
