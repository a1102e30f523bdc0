"""Friction and rotor inertia fitted again to torques that a file has no place for."""

import warnings
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from sklearn_vbjfa.effects import OfChannel, OfTime
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.simulation import SimulationError, simulate, without_limits

# What joints of MJCF have, by the names of declared friction.
TERMS = ("coulomb", "viscous", "rotor_inertia")
# Rows of the motion, the frequencies of its sines over the first one, and the share of
# a joint's top speed below which its friction may have any value.
_ROWS, _FREQUENCIES, _REST = 6000, (0.35, 0.7, 1.0, 1.6), 0.02
# Windows in which the file is simulated, their length [s], and the least rows of one.
_WINDOWS, _SECONDS, _LEAST = 6, 1.0, 20
# Change of the simulated positions, as a share of their spread, that is too large.
_CHANGED = 0.02
# A torque below this share of the joint's whole torque is rounding.
_ROUNDING = 1e-9


def without_place(effect, coef):
    """Coefficients (k,) of a law of motion that MJCF lacks, zero elsewhere."""
    others = effect.in_model or effect.whole_robot or "signals" in effect.needs
    if others or isinstance(effect, (OfChannel, OfTime)) or not effect.files.mjcf:
        return np.zeros(len(coef))
    held = [name for _, *names in effect.files.places for name in names]
    return np.where(np.isin(effect.coefficients, held), 0.0, coef)


def typical_motion(ranges, nv, dt):
    """States (n, 3 nv) within the ranges of a fit, and which joints move in them."""
    # ranges: `EffectRange` of at least one effect or friction term of each joint.
    t, known = dt * np.arange(_ROWS), {one.joint: one for one in ranges}
    states, moves = np.zeros((3, _ROWS, nv)), np.zeros(nv, dtype=bool)
    rng = np.random.default_rng(0)
    for j, one in known.items():
        low, high = one.position
        size, speed = 0.5 * (high - low), one.speed[1]
        phase = rng.uniform(0, 2 * np.pi, len(_FREQUENCIES))
        if not (size > 0 and speed > 0):
            continue
        moves[j] = True
        amplitude = size / len(_FREQUENCIES)
        omega = speed / (amplitude * np.sum(_FREQUENCIES)) * np.array(_FREQUENCIES)
        angle = np.multiply.outer(t, omega) + phase
        states[0, :, j] = 0.5 * (low + high) + amplitude * np.sin(angle).sum(axis=1)
        states[1, :, j] = amplitude * np.cos(angle) @ omega
        states[2, :, j] = -amplitude * np.sin(angle) @ omega**2
    return np.hstack(list(states)), moves


def refitted(robot, totals):
    """Fit the joints of a file to what it lacks of an identified robot, (nv, 3)."""
    # totals (nv, 3): of `TERMS` in the file, which are to stay positive.
    nv, added = len(totals), np.zeros(totals.shape)
    pairs = list(zip(robot.effects_, robot.split(robot.theta_)))
    left = [without_place(*pair) for pair in pairs]
    if not _is_known(robot) or not any(coef.any() for coef in left):
        return added
    states, moves = typical_motion(robot.effect_ranges_, nv, robot.plan.dt)
    v, a = states[:, nv : 2 * nv], states[:, 2 * nv :]
    plain = {"coulomb": np.sign(v), "viscous": v, "rotor_inertia": a}
    lacking = np.zeros((_ROWS, nv))
    for (effect, columns), coef in zip(robot.columns_of(states), left):
        if coef.any():
            j, name = effect.joint, effect.files.parameter
            lacking[:, j] += columns @ coef
            if name in plain:
                lacking[:, j] -= plain[name][:, j] * effect.in_file(coef).sum()
    for j in np.flatnonzero(moves & lacking.any(axis=0)):
        rows = np.abs(v[:, j]) > _REST * np.abs(v[:, j]).max()
        X = np.column_stack([plain[name][rows, j] for name in TERMS])
        size, y = np.sqrt((X**2).mean(axis=0)), lacking[rows, j]
        most = np.maximum(totals[j], 0.0)
        found = lsq_linear(X / size, y, (-most * size - _ROUNDING, np.inf)).x / size
        found = np.maximum(found, -most)
        if ((y - X @ found) ** 2).sum() < (y**2).sum():
            added[j] = found
    return added


def _is_known(robot):
    return robot.plan.dt is not None and len(robot.effect_ranges_) > 0


def warn_of_motion(robot, joints):
    """Warn of joints that move differently with what an MJCF file has of a robot."""
    # joints: declared friction of the file, (nv,) by name.
    model = robot.torque_model()
    left = [without_place(*pair) for pair in zip(model.effects, model.coefficients)]
    if not _is_known(robot) or not any(coef.any() for coef in left):
        return
    plain = [
        not (isinstance(effect, (OfChannel, OfTime)) or "signals" in effect.needs)
        for effect in model.effects
    ]
    model = replace(
        model,
        model=without_limits(model.model),
        coefficients=tuple(x * used for x, used in zip(model.coefficients, plain)),
    )
    file = replace(
        model,
        friction_names=tuple(joints),
        friction=np.column_stack(list(joints.values())),
        coefficients=tuple(
            (x - gone) * (effect.files.parameter not in joints)
            for effect, x, gone in zip(model.effects, model.coefficients, left)
        ),
    )
    shares = changed_motion(robot, model, file)
    lines = [
        f"{100 * share:.2g} % on {name}"
        for name, share in zip(robot.joint_names_, shares)
        if share > _CHANGED
    ]
    if lines:
        warnings.warn(
            "The MJCF file moves differently: positions simulated over a second change "
            f"by {', '.join(lines)} (of their spread). MuJoCo lacks such friction: "
            "simulate the saved robot (identified.json).",
            DoubtWarning,
            stacklevel=3,
        )


def changed_motion(robot, model, other):
    """Root mean square change (nv,) of simulated positions, over their spread."""
    # model, other: `TorqueModel`, both driven by the torques of the first in a typical
    # motion; infinite where the other one diverges.
    nv, dt = model.n_joints, robot.plan.dt
    states, moves = typical_motion(robot.effect_ranges_, nv, dt)
    length = min(max(round(_SECONDS / dt), _LEAST), _ROWS)
    count = min(_WINDOWS, _ROWS // length)
    starts = np.linspace(0, _ROWS - length, count).astype(int)
    tau = robot.torques(robot.prepare(states).noiseless(robot.plan))
    changes, spread = [], states[:, :nv].std(axis=0)
    for rows in (slice(start, start + length) for start in starts):
        q, v, _ = np.split(states[rows.start], 3)
        own = _simulated(model, tau[rows], q, v)
        if own is not None:
            changed = _simulated(other, tau[rows], q, v)
            changes.append(np.inf if changed is None else changed - own)
    if not changes:
        return np.zeros(nv)
    squares = np.mean([np.mean(np.square(x), axis=0) for x in changes], axis=0)
    return np.where(moves, np.sqrt(squares) / np.where(moves, spread, 1.0), 0.0)


def _simulated(model, tau, q, v):
    """Positions (n, nv) under torques, None where they cannot be followed."""
    with warnings.catch_warnings():
        # What a simulation leaves out is left out of both.
        warnings.simplefilter("ignore")
        try:
            return simulate(model, tau, q, v)[:, : q.size]
        except (SimulationError, ValueError):
            return None
