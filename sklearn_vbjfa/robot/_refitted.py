"""Friction and rotor inertia fitted again to torques that a file has no place for."""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from sklearn_vbjfa.effects import OfChannel, OfTime
from sklearn_vbjfa.model import DoubtWarning

# What joints of MJCF have, by the names of declared friction.
TERMS = ("coulomb", "viscous", "rotor_inertia")
# Rows of the motion, the frequencies of its sines over the first one, and the share of
# a joint's top speed below which its friction may have any value.
_ROWS, _FREQUENCIES, _REST = 6000, (0.35, 0.7, 1.0, 1.6), 0.02
# Share of a joint's torque without which a file moves in another way.
_MISSING = 0.02
# A torque below this share of the joint's whole torque is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Refitted:
    """What is added to the joints of a file, and what the file still lacks."""

    added: np.ndarray  # (nv, 3): to `TERMS`
    # (nv,): root mean square of what is left over that of what had no place, and over
    # that of the whole torque
    share: np.ndarray
    missing: np.ndarray

    @classmethod
    def nothing(cls, nv):
        return cls(added=np.zeros((nv, 3)), share=np.ones(nv), missing=np.zeros(nv))

    def warn(self, names):
        """Warn of joints whose motion a file changes."""
        lines = [
            f"{100 * share:.2g} % of the torque of {name}"
            for name, share in zip(names, self.missing)
            if share > _MISSING
        ]
        if lines:
            warnings.warn(
                f"The MJCF file lacks {', '.join(lines)}, which MuJoCo has no friction "
                "for: simulate the saved robot instead (identified.json).",
                DoubtWarning,
                stacklevel=3,
            )


def has_no_place(effect):
    """Whether an effect is a law of a joint's motion that MJCF lacks in part."""
    others = (OfChannel, OfTime)
    if effect.in_model or effect.whole_robot or isinstance(effect, others):
        return False
    return bool(effect.files.mjcf) and "signals" not in effect.needs


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
    """Fit the joints of a file to what it lacks of an identified robot, `Refitted`."""
    # totals (nv, 3): of `TERMS` in the file, which are to stay positive.
    nv = len(totals)
    left = [has_no_place(effect) for effect in robot.effects_]
    nothing = Refitted.nothing(nv)
    if not any(left) or robot.plan.dt is None or not robot.effect_ranges_:
        return nothing
    states, moves = typical_motion(robot.effect_ranges_, nv, robot.plan.dt)
    made = robot.columns_of(states)
    v, a = states[:, nv : 2 * nv], states[:, 2 * nv :]
    plain = {"coulomb": np.sign(v), "viscous": v, "rotor_inertia": a}
    lacking = np.zeros((_ROWS, nv))
    coefficients = robot.split(robot.theta_)
    for lacks, (effect, columns), coef in zip(left, made, coefficients):
        if lacks:
            j, name = effect.joint, effect.files.parameter
            lacking[:, j] += columns @ coef
            if name in plain:
                lacking[:, j] -= plain[name][:, j] * effect.in_file(coef).sum()
    added, share, missing = nothing.added, nothing.share, nothing.missing
    whole = robot.torques(robot.prepare(states).noiseless(robot.plan))
    for j in np.flatnonzero(moves & lacking.any(axis=0)):
        rows = np.abs(v[:, j]) > _REST * np.abs(v[:, j]).max()
        X = np.column_stack([plain[name][rows, j] for name in TERMS])
        size, y = np.sqrt((X**2).mean(axis=0)), lacking[rows, j]
        lowest = -np.maximum(totals[j], 0.0) * size - _ROUNDING
        found = lsq_linear(X / size, y, (lowest, np.inf)).x / size
        found = np.maximum(found, -np.maximum(totals[j], 0.0))
        sizes = [y, y - X @ found, whole[rows, j]]
        before, after, torque = (np.sqrt((x**2).mean()) for x in sizes)
        if after < before:
            added[j], share[j] = found, after / before
        missing[j] = min(before, after) / max(torque, before)
    return Refitted(added=added, share=share, missing=missing)
