"""Friction and effects as scalar laws, split by how they enter forward dynamics.

A torque in addition to the rigid bodies is smooth (a function of positions, velocities,
time and memory), dry (a size times the sign of the joint's velocity, and any value in
between at rest), either of these times the load, or proportional to accelerations. The
effects of the library form a table of numbers for one scalar function, `add_terms`,
compiled by Numba; custom effects are left out.
"""

import math
from typing import NamedTuple

import numpy as np

from sklearn_vbjfa.effects import HELD, InModel, OfChannel

# Kinds of terms in the table, by the names that effects use in `TermTable.add`.
_NAMES = (
    "stribeck quadratic absolute harmonics linkage ripple stop backlash coupled_dry "
    "level level_dry viscous spring coupled_spring bristle dry_ripple"
)
KINDS = {name: kind for kind, name in enumerate(_NAMES.split())}
_STRIBECK, _QUADRATIC, _ABSOLUTE = range(3)
_HARMONICS, _LINKAGE, _RIPPLE, _STOP, _BACKLASH = range(3, 8)
_COUPLED_DRY, _LEVEL, _LEVEL_DRY, _VISCOUS, _SPRING = range(8, 13)
_COUPLED_SPRING, _BRISTLE, _DRY_RIPPLE = 13, 14, 15
_DRY = _STRIBECK, _LEVEL_DRY
_ELEMENTS = _STOP, _BRISTLE
_WITH_MEMORY = (*_ELEMENTS, _BACKLASH)
# Terms with one coefficient per joint, outside the table.
_JOINT_TERMS = ("constant", "dry", "load_dry", "armature")
# Parameter of an element with memory: whether its size is proportional to the load.
_OF_LOAD = 3
# Coefficients that change with time, and the kind of their term.
_LEVELS = {"offset": "level", "coulomb": "level_dry", "viscous": "viscous"}
# Number of parameters of a term in the table; two more are its limits.
_WIDTH = 4
_LOW, _HIGH = _WIDTH, _WIDTH + 1
_ENDLESS = (-math.inf, math.inf)
# Most iterations for the signs of the loads that friction depends on.
MOST_SIGNS = 8


class TermArrays(NamedTuple):
    """Friction and effects of a robot as arrays for compiled code."""

    of_load: bool  # whether friction depends on the load
    # (6, nv): coefficients outside the table: viscous friction, constant torque, dry
    # friction, dry friction per load, lowest and highest load to which it is clipped
    lines: np.ndarray
    # (nv, nv): torque of joint (row) by acceleration and by velocity of joint (column),
    # in addition to rigid bodies, rotors and viscous friction
    inertia: np.ndarray
    coupling: np.ndarray
    # (n_terms,): laws, and the joints that they act on
    kinds: np.ndarray
    joints: np.ndarray
    # (n_terms, 6): parameters of each law, and the limits to which its argument, the
    # joint's position or velocity, is clipped
    numbers: np.ndarray
    # (n_terms, 2): position at the last update of the memory, and the state there
    memory: np.ndarray


class TermTable:
    """Friction and effects of a robot as terms, which the effects add themselves."""

    # viscous, constant, dry, load_dry, armature (nv,): coefficients outside the table,
    # load_dry per load; inertia, coupling (nv, nv): see `TermArrays`; payloads:
    # instants [s], joints, changes of their bodies' parameters (10,); since: first time
    # of the fit [s]; left_out: effects that are not simulated, with reasons.

    def __init__(self, robot):
        nv = robot.n_joints
        self._rest, self.since = robot.rest, robot.since
        self.viscous, self.constant, self.dry = np.zeros((3, nv))
        self.load_dry, self.armature = np.zeros((2, nv))
        self.inertia, self.coupling = np.zeros((2, nv, nv))
        self._load_ends, self._ends = {}, _ENDLESS
        self._rows, self._levels, self.left_out = [], {}, []
        self.payloads = []
        declared = dict(zip(robot.friction_names, robot.friction.T))
        for name, add in (
            ("viscous", self.viscous),
            ("coulomb", self.dry),
            ("offset", self.constant),
            ("rotor_inertia", self.armature),
        ):
            add += declared.get(name, 0.0)
        rows = zip(robot.effects, robot.coefficients, robot.limits, strict=True)
        for effect, coef, limits in rows:
            reason = effect.files.simulation
            # Effects in the model act through it.
            if not reason and not isinstance(effect, (InModel, OfChannel)):
                effect.check()
                self._ends = _ends(limits)
                if not effect.simulated(self, *map(float, coef)):
                    reason = "it has no terms of a simulation"
            if reason:
                self.left_out.append((effect, reason))
        self.payloads.sort(key=lambda pair: pair[0])
        kinds, joints, numbers = zip(*self._rows) if self._rows else ((), (), ())
        self.kinds, self.joints = np.array(kinds, dtype=int), np.array(joints, int)
        self._numbers = np.array(numbers, dtype=float).reshape(-1, _WIDTH + 2)
        # (2, nv): lowest and highest load to which load-dependent friction is clipped.
        ends = [self._load_ends.get(j, _ENDLESS) for j in range(nv)]
        self.load_ends = np.transpose(ends)
        # Joints with memory of their reversals, and with a kink at zero velocity.
        self.has_memory, self.has_kink = np.zeros((2, nv), dtype=bool)
        self.has_memory[self._joints_of(_WITH_MEMORY)] = True
        self.has_kink[self._joints_of([_ABSOLUTE])] = True
        self.has_dry = (self.dry != 0) | (self.load_dry != 0)
        self.has_dry[self._joints_of((*_DRY, _DRY_RIPPLE))] = True

    def _joints_of(self, kinds):
        return self.joints[np.isin(self.kinds, kinds)]

    # -- methods for effects -----------------------------------------------------------

    def add(self, name, joint, *numbers):
        """Add a term; return False if it cannot be simulated."""
        # name: of `KINDS`, see `add_terms`, or `_JOINT_TERMS`; numbers: size first.
        of_load = name == "load_dry"
        if KINDS.get(name) in _ELEMENTS:
            of_load = numbers[_OF_LOAD] > 0
        # All load-dependent friction of a joint must have the same limits.
        if of_load and self._load_ends.setdefault(joint, self._ends) != self._ends:
            return False
        if name in _JOINT_TERMS:
            getattr(self, name)[joint] += numbers[0]
        else:
            padding = (0.0,) * (_WIDTH - len(numbers))
            self._rows.append((KINDS[name], joint, (*numbers, *padding, *self._ends)))
        return True

    def add_level(self, joint, of, level):
        self._levels[len(self._rows)] = level
        return self.add(_LEVELS[of], joint)

    def slow(self, joint):
        return 0.0 if self._rest is None else self._rest.speed[joint]

    # -- methods for the simulation ----------------------------------------------------

    @property
    def of_load(self):
        elements = self._numbers[np.isin(self.kinds, _ELEMENTS)]
        return bool(self.load_dry.any() or elements[:, _OF_LOAD].any())

    @property
    def is_timed(self):
        return bool(self._levels)

    def table(self, q):
        """Return the `TermArrays` of a motion that starts at positions q (nv,)."""
        memory = np.zeros((self.kinds.size, 2))
        for k in np.flatnonzero(np.isin(self.kinds, _WITH_MEMORY)):
            memory[k, 0] = q[self.joints[k]]
            memory[k, 1] = memory[k, 0] if self.kinds[k] == _BACKLASH else 0.0
        lines = self.viscous, self.constant, self.dry, self.load_dry, *self.load_ends
        return TermArrays(
            of_load=self.of_load,
            lines=np.array(lines),
            inertia=self.inertia,
            coupling=self.coupling,
            kinds=self.kinds,
            joints=self.joints,
            numbers=self._numbers.copy(),
            memory=memory,
        )

    def set_levels(self, rows, t, signals):
        for k, level in self._levels.items():
            rows[k][0] = level(t, signals)


def _ends(limits):
    for quantity in HELD if limits is not None else ():
        ends = limits.ends(quantity)
        if ends != _ENDLESS:
            return ends
    return _ENDLESS


# -- the table, one state at a time ----------------------------------------------------


def add_terms(kinds, joints, numbers, memory, q, v, out):
    """Add the torques of a table of terms at one state."""
    # Outside its limits a term is constant. No joint has reversed since the last update
    # of its memory. out (7, nv), added to: torques of position and time, or of several
    # joints; smooth friction; size of dry friction; smooth friction per load; gradients
    # of smooth torques by the joint's position and velocity, of the last by position.
    static, smooth, dry, load_smooth = out[0], out[1], out[2], out[3]
    by_position, by_velocity, load_by_position = out[4], out[5], out[6]
    for i in range(len(kinds)):
        kind, j = kinds[i], joints[i]
        row = numbers[i]
        size = row[0]
        x, u = min(max(q[j], row[_LOW]), row[_HIGH]), v[j]
        u = min(max(u, row[_LOW]), row[_HIGH])
        # Derivatives by a clipped argument are zero.
        moves_x = 1.0 if x == q[j] else 0.0
        moves_u = 1.0 if u == v[j] else 0.0
        if kind == _STRIBECK:
            r = abs(v[j]) / row[1]
            dry[j] += size * math.exp(-r if row[2] == 1 else -r * r)
        elif kind == _QUADRATIC:
            smooth[j] += size * u * abs(u)
            by_velocity[j] += moves_u * 2.0 * size * abs(u)
        elif kind == _ABSOLUTE:
            smooth[j] += size * abs(u)
            by_velocity[j] += moves_u * size * (1.0 if v[j] > 0 else -1.0)
        elif kind == _HARMONICS:
            c, s = math.cos(x), math.sin(x)
            c2, s2 = c * c - s * s, 2.0 * s * c
            static[j] += size * c + row[1] * s + row[2] * c2 + row[3] * s2
            slope = row[1] * c - size * s + 2.0 * (row[3] * c2 - row[2] * s2)
            by_position[j] += moves_x * slope
        elif kind == _LINKAGE:
            ratio = row[2]
            c, s = math.cos(x - row[3]), math.sin(x - row[3])
            square = 1.0 + ratio * ratio - 2.0 * ratio * c
            length = math.sqrt(square)
            static[j] += (size / length + row[1]) * s
            slope = (size / length + row[1]) * c
            slope -= size * ratio * s * s / (square * length)
            by_position[j] += moves_x * slope
        elif kind == _RIPPLE:
            waves = 2.0 * math.pi / row[2]
            c, s = math.cos(waves * x), math.sin(waves * x)
            static[j] += size * c + row[1] * s
            by_position[j] += moves_x * waves * (row[1] * c - size * s)
        elif kind == _DRY_RIPPLE:
            waves = 2.0 * math.pi / row[2]
            dry[j] += size * math.cos(waves * x) + row[1] * math.sin(waves * x)
        elif kind == _STOP or kind == _BRISTLE:
            # State z in the direction of motion, its level, and the slopes of both.
            step = (q[j] - memory[i][0]) / row[1]
            sign = 1.0 if step > 0.0 or (step == 0.0 and v[j] > 0.0) else -1.0
            level, bend = 1.0, 0.0
            if row[2] > 0:
                r = v[j] / row[2]
                level += math.exp(-r * r)
                bend = -2.0 * r * (level - 1.0) / row[2]
            z = sign * memory[i][1]
            if kind == _BRISTLE:
                left = math.exp(-sign * step / level)
                z = level + (z - level) * left
                slope, bend = (level - z) / (level * row[1]), bend * (1.0 - left)
            elif z + sign * step < level:
                z, slope, bend = z + sign * step, 1.0 / row[1], 0.0
            else:
                z, slope = level, 0.0
            if row[_OF_LOAD] > 0:
                load_smooth[j] += size * sign * z
                load_by_position[j] += size * slope
            else:
                smooth[j] += size * sign * z
                by_position[j] += size * slope
                by_velocity[j] += size * sign * bend
        elif kind == _BACKLASH:
            half = 0.5 * row[1]
            p = max(min(memory[i][1], x + half), x - half)
            static[j] += size * p
            if p != memory[i][1]:
                by_position[j] += moves_x * size
        elif kind == _COUPLED_DRY:
            w = v[int(row[1])] + row[2] * v[j]
            static[j] += size * max(min(w / row[3], 1.0), -1.0)
            if abs(w) < row[3]:
                by_velocity[j] += abs(row[2]) * size / row[3]
        elif kind == _COUPLED_SPRING:
            static[j] += size * q[int(row[1])]
        elif kind == _LEVEL:
            static[j] += size
        elif kind == _LEVEL_DRY:
            dry[j] += size
        elif kind == _VISCOUS:
            smooth[j] += size * u
            by_velocity[j] += moves_u * size
        elif kind == _SPRING:
            static[j] += size * x
            by_position[j] += moves_x * size


def remember(kinds, joints, numbers, memory, q, v):
    """Update the memory of a table to positions q, reached without reversals."""
    for i in range(len(kinds)):
        kind, j = kinds[i], joints[i]
        if kind == _STOP or kind == _BRISTLE:
            step, level = (q[j] - memory[i][0]) / numbers[i][1], 1.0
            if numbers[i][2] > 0:
                level += math.exp(-((v[j] / numbers[i][2]) ** 2))
            sign = 1.0 if step > 0.0 else -1.0
            z = sign * memory[i][1]
            if kind == _BRISTLE:
                z = level + (z - level) * math.exp(-sign * step / level)
            elif step != 0.0:
                z = min(z + sign * step, level)
            memory[i][1] = sign * z
            memory[i][0] = q[j]
        elif kind == _BACKLASH:
            half, low, high = 0.5 * numbers[i][1], numbers[i][_LOW], numbers[i][_HIGH]
            x = min(max(q[j], low), high)
            memory[i][1] = max(min(memory[i][1], x + half), x - half)
            memory[i][0] = q[j]


def load_size(L, low, high):
    """Magnitudes of clipped loads L (nv,), as constants and slopes by the loads."""
    constant, slope = np.zeros(L.size), np.zeros(L.size)
    for j in range(L.size):
        clipped = min(max(L[j], low[j]), high[j])
        if clipped == L[j]:
            slope[j] = np.sign(clipped)
        else:
            constant[j] = abs(clipped)
    return constant, slope
