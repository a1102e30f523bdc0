"""Friction and effects as scalar laws, split by how they enter forward dynamics.

A torque that the drive must produce beside the rigid bodies' is smooth (of positions,
velocities, time and memory), dry (a size times the sign of the joint's velocity, and
anything between at rest), either of them over the load, or in proportion to
accelerations. The library's effects are a table of numbers for one scalar function,
`add_terms`, compiled where Numba is installed; others are evaluated by their columns.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.effects import (
    AsymmetricFriction,
    Backlash,
    Coulomb,
    Counterbalance,
    Coupling,
    Delay,
    Drift,
    Elastic,
    Jerk,
    LoadFriction,
    Motion,
    Offset,
    Payload,
    Presliding,
    Ripple,
    RotorInertia,
    Signal,
    Spring,
    Stribeck,
    TorqueFilter,
    Viscous,
    ViscousQuadratic,
)
from sklearn_vbjfa.effects._ranges import HELD, own_motions
from sklearn_vbjfa.model._loading import is_prismatic

# Kinds of terms in the table.
_STRIBECK, _QUADRATIC, _ABSOLUTE, _TANH, _LOAD_TANH = 0, 1, 2, 3, 4
_HARMONICS, _LINKAGE, _RIPPLE, _PRESLIDING, _BACKLASH = 5, 6, 7, 8, 9
_COUPLED_DRY, _LEVEL, _LEVEL_DRY, _VISCOUS, _SPRING = 10, 11, 12, 13, 14
_FRICTION = (_STRIBECK, _QUADRATIC, _ABSOLUTE, _TANH, _LOAD_TANH, _PRESLIDING)
_FRICTION += (_LEVEL_DRY, _VISCOUS)
# Parameters of a term in the table; the two behind them are its ends.
_WIDTH = 4
_ENDLESS = (-math.inf, math.inf)
# Torques of the channels, before the robot; and what a simulation cannot do.
CHANNELS = (Delay, TorqueFilter)
LEFT_OUT = {
    Elastic: "a first-order correction of the torque, which has no forward dynamics",
    Jerk: "it stands for a lag of a channel or for flexibility",
}
# Below this speed the sign of a coupled speed turns, where no other is known.
_SLOW = 1e-3
# What other effects depend on is seen on so many rows, so far apart in time [s]. Their
# torque jumps if that between these speeds on both sides of zero is at least this share
# of that between -1 and 1.
_ROWS, _PERIOD, _TURNS, _JUMP = 5, 0.01, 1e-12, 1e-3
# Their derivatives are differences over this share of the accelerations.
_SLOPE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Terms:
    """Friction and effects of a robot, as numbers."""

    # (nv,): what needs no table; load_dry is over the load
    viscous: np.ndarray
    constant: np.ndarray
    dry: np.ndarray
    load_dry: np.ndarray
    # (2, nv): lowest and highest load that friction over the load follows
    load_ends: np.ndarray
    armature: np.ndarray
    # (nv, nv): torque of joint (row) by acceleration of joint (column), beside rigid
    # bodies and rotors
    inertia: np.ndarray
    # (nv, nv): torque of joint (row) by velocity of joint (column), beside `viscous`
    coupling: np.ndarray
    # (n_terms,): the table: laws, and the joints that they act on
    kinds: np.ndarray
    joints: np.ndarray
    # (n_terms, 6): parameters of each law, and the ends between which it follows its
    # joint's position or velocity, whichever it is a law of
    numbers: np.ndarray
    # sizes of terms that change with time or a signal: (t, signals) -> float
    levels: tuple
    leveled: tuple  # their places in the table
    others: object  # effects that are not in the table
    payloads: tuple  # instants [s], and what the last body's parameters (10,) change by
    remembers: np.ndarray  # (nv,): joints with a memory of where they turned
    bends: np.ndarray  # (nv,): joints whose torque has a bend where they turn

    @property
    def of_load(self):
        """Whether friction depends on the load."""
        return bool(self.load_dry.any() or (self.kinds == _LOAD_TANH).any())

    @property
    def is_friction(self):
        """Which terms of the table are friction, ndarray of bool."""
        return np.isin(self.kinds, _FRICTION)

    @property
    def lines(self):
        """What needs no table, ndarray (6, nv)."""
        return self._lines

    def __post_init__(self):
        lines = self.viscous, self.constant, self.dry, self.load_dry, *self.load_ends
        object.__setattr__(self, "_lines", np.array(lines))

    def dry_terms(self):
        """Return which terms of the table are dry friction, ndarray of bool."""
        return np.isin(self.kinds, (_STRIBECK, _LEVEL_DRY))

    @property
    def is_timed(self):
        """Whether anything changes with time or a signal."""
        return bool(self.leveled)

    @classmethod
    def of(cls, robot, known=None):
        """Sort the friction and effects of a `TorqueModel`."""
        # known: values of recorded signals, one of each.
        nv = robot.n_joints
        made = _Table(nv, None if robot.rest is None else robot.rest.speed, robot.since)
        declared = dict(zip(robot.friction_names, robot.friction.T))
        for name, add in (
            ("viscous", made.viscous),
            ("coulomb", made.dry),
            ("offset", made.constant),
            ("rotor_inertia", made.armature),
        ):
            add += declared.pop(name, 0.0)
        if declared:
            raise ValueError(
                f"friction holds {', '.join(declared)}, which cannot be simulated; "
                "give it in effects."
            )
        others = []
        every = zip(robot.effects, robot.coefficients, robot.held, strict=True)
        for effect, coef, held in every:
            if effect.in_model or isinstance(effect, (*CHANNELS, *LEFT_OUT)):
                continue
            if not made.take(effect, coef, held):
                others.append((effect, np.asarray(coef), held))
        return made.finished(
            OtherEffects(robot, others, known or {}) if others else None
        )

    def memory(self, q):
        """Start the memory of joints at positions q (nv,): (n_terms, 2)."""
        out = np.zeros((self.kinds.size, 2))
        for k in np.flatnonzero(np.isin(self.kinds, (_PRESLIDING, _BACKLASH))):
            out[k, 0] = q[self.joints[k]]
            out[k, 1] = q[self.joints[k]] if self.kinds[k] == _BACKLASH else 0.0
        return out

    def set_levels(self, rows, t, signals):
        """Write the present sizes of terms that change with time into rows."""
        for k, level in zip(self.leveled, self.levels):
            rows[k][0] = level(t, signals)


class _Table:
    """Collects the terms of a robot."""

    def __init__(self, nv, slow, since):
        self.viscous, self.constant, self.dry = np.zeros((3, nv))
        self.load_dry, self.armature = np.zeros((2, nv))
        self.load_ends, self.ends = {}, _ENDLESS
        self.inertia, self.coupling = np.zeros((2, nv, nv))
        self.rows, self.levels, self.leveled, self.payloads = [], [], [], []
        self.slow, self.since = slow, since

    def add(self, kind, joint, *numbers):
        left = (0.0,) * (_WIDTH - len(numbers))
        self.rows.append((kind, joint, (*numbers, *left, *self.ends)))

    def add_level(self, joint, of, level):
        """Add a torque, dry or viscous friction whose size changes with time."""
        kind = {"offset": _LEVEL, "coulomb": _LEVEL_DRY, "viscous": _VISCOUS}[of]
        self.leveled.append(len(self.rows))
        self.levels.append(level)
        self.add(kind, joint)

    def take(self, effect, coef, held):
        """Take an effect of the library, in an `EffectRange`; False if it is none."""
        # Nor is friction over the load, if that of the joint is held within other ends.
        found = _LAWS.get(type(effect))
        if found is None:
            return False
        effect.check()
        self.ends = _ends(held)
        if found is _load_friction:
            ends = self.load_ends.setdefault(effect.joint, self.ends)
            if ends != self.ends:
                return False
        found(self, effect, effect.joint, *map(float, coef))
        return True

    def finished(self, others):
        kinds, joints, numbers = zip(*self.rows) if self.rows else ((), (), ())
        kinds, joints = np.array(kinds, dtype=int), np.array(joints, dtype=int)
        remembers, bends = np.zeros((2, self.dry.size), dtype=bool)
        remembers[joints[np.isin(kinds, (_PRESLIDING, _BACKLASH))]] = True
        bends[joints[np.isin(kinds, (_ABSOLUTE, _TANH, _LOAD_TANH))]] = True
        every = [self.load_ends.get(j, _ENDLESS) for j in range(self.dry.size)]
        return Terms(
            viscous=self.viscous,
            constant=self.constant,
            dry=self.dry,
            load_dry=self.load_dry,
            load_ends=np.transpose(every),
            armature=self.armature,
            inertia=self.inertia,
            coupling=self.coupling,
            kinds=kinds,
            joints=joints,
            numbers=np.array(numbers, dtype=float).reshape(-1, _WIDTH + 2),
            levels=tuple(self.levels),
            leveled=tuple(self.leveled),
            others=others,
            payloads=tuple(sorted(self.payloads, key=lambda pair: pair[0])),
            remembers=remembers,
            bends=bends,
        )


def _ends(held):
    """Return the ends of the one signal that a law of the library depends on."""
    for quantity in HELD if held is not None else ():
        ends = held.ends(quantity)
        if ends != _ENDLESS:
            return ends
    return _ENDLESS


# -- effects of the library ------------------------------------------------------------


def _viscous(table, effect, j, Fv):
    table.add(_VISCOUS, j, Fv)


def _coulomb(table, effect, j, Fc):
    if effect.smoothing > 0:
        table.add(_TANH, j, Fc, effect.smoothing)
    else:
        table.dry[j] += Fc


def _asymmetric(table, effect, j, dFc, dFv):
    # At rest friction is between its values of both directions: their mean remains.
    table.constant[j] += dFc
    table.add(_ABSOLUTE, j, dFv)


def _stribeck(table, effect, j, Fs):
    table.add(_STRIBECK, j, Fs, effect.vs, effect.k)


def _quadratic(table, effect, j, F2):
    table.add(_QUADRATIC, j, F2)


def _load_friction(table, effect, j, mu):
    if effect.smoothing > 0:
        table.add(_LOAD_TANH, j, mu, effect.smoothing)
    else:
        table.load_dry[j] += mu


def _presliding(table, effect, j, Fp):
    table.add(_PRESLIDING, j, Fp, effect.displacement)


def _backlash(table, effect, j, k, c):
    table.constant[j] += c
    table.add(_BACKLASH, j, k, 0.5 * effect.width)


def _offset(table, effect, j, c):
    table.constant[j] += c


def _spring(table, effect, j, k, c):
    table.add(_SPRING, j, k)
    table.constant[j] += c


def _counterbalance(table, effect, j, *coef):
    if effect.form == "linkage":
        table.add(_LINKAGE, j, *coef, effect.ratio, effect.angle)
    else:
        *harmonics, constant = coef
        table.constant[j] += constant
        table.add(_HARMONICS, j, *harmonics)


def _ripple(table, effect, j, c, s):
    table.add(_RIPPLE, j, c, s, 2 * math.pi / effect.period)


def _rotor(table, effect, j, Ir):
    table.armature[j] += Ir


def _coupling(table, effect, j, Fvm, Fcm, Iam):
    k = effect.other
    own = {"other": 0.0, "sum": 1.0, "difference": -1.0}[effect.of]
    table.coupling[j, k] += Fvm
    table.coupling[j, j] += own * Fvm
    table.inertia[j, k] += Iam
    table.inertia[j, j] += own * Iam
    # The sign turns over the speeds at which both joints may be standing: friction of
    # a sum of speeds does not hold one joint alone.
    slow = _SLOW if table.slow is None else table.slow[k] + abs(own) * table.slow[j]
    table.add(_COUPLED_DRY, j, Fcm, k, own, max(slow, _SLOW))


def _drift(table, effect, j, D):
    since, T = table.since, effect.time_constant

    def level(t, signals):
        return D * math.exp(-(t if since is None else max(t, since)) / T)

    table.add_level(j, effect.of, level)


def _signal(table, effect, j, k):
    def level(t, signals):
        return k * (signals(effect.signal, t) - effect.reference)

    table.add_level(j, effect.of, level)


def _payload(table, effect, j, *coef):
    table.payloads.append((float(effect.instant), effect.inertial(coef)))


_LAWS = {
    Viscous: _viscous,
    Coulomb: _coulomb,
    AsymmetricFriction: _asymmetric,
    Stribeck: _stribeck,
    ViscousQuadratic: _quadratic,
    LoadFriction: _load_friction,
    Presliding: _presliding,
    Backlash: _backlash,
    Offset: _offset,
    Spring: _spring,
    Counterbalance: _counterbalance,
    Ripple: _ripple,
    RotorInertia: _rotor,
    Coupling: _coupling,
    Drift: _drift,
    Signal: _signal,
    Payload: _payload,
}


# -- the table, one state at a time ----------------------------------------------------


def add_terms(
    kinds,
    joints,
    numbers,
    memory,
    q,
    v,
    placed,
    smooth,
    dry,
    load_smooth,
    by_position,
    by_velocity,
    load_by_velocity,
):
    """Add the torques of a table of terms (kinds, joints, numbers) at one state."""
    # Beyond its ends a term is as it is there. memory (n_terms, 2): position at which
    # each term was last looked at, and its state there; the joint has not turned since.
    # Added to, all (nv,): placed, what depends on position and time alone or couples
    # joints, and may do work; smooth friction; the size of dry friction; smooth
    # friction over the load; and the derivatives of smooth torques by the joint's own
    # position and velocity, and of load_smooth.
    for i in range(len(kinds)):
        kind, j = kinds[i], joints[i]
        row = numbers[i]
        size = row[0]
        x, u = min(max(q[j], row[4]), row[5]), min(max(v[j], row[4]), row[5])
        # Derivatives by what is beyond its ends are zero.
        moves_x = 1.0 if x == q[j] else 0.0
        moves_u = 1.0 if u == v[j] else 0.0
        if kind == 0:  # Stribeck
            r = abs(v[j]) / row[1]
            dry[j] += size * math.exp(-r if row[2] == 1 else -r * r)
        elif kind == 1:  # quadratic
            smooth[j] += size * u * abs(u)
            by_velocity[j] += moves_u * 2.0 * size * abs(u)
        elif kind == 2:  # absolute
            smooth[j] += size * abs(u)
            by_velocity[j] += moves_u * size * (1.0 if v[j] > 0 else -1.0)
        elif kind == 3:  # tanh
            s = math.tanh(v[j] / row[1])
            smooth[j] += size * s
            by_velocity[j] += size * (1.0 - s * s) / row[1]
        elif kind == 4:  # tanh, over the load
            s = math.tanh(v[j] / row[1])
            load_smooth[j] += size * s
            load_by_velocity[j] += size * (1.0 - s * s) / row[1]
        elif kind == 5:  # two harmonics
            c, s = math.cos(x), math.sin(x)
            c2, s2 = c * c - s * s, 2.0 * s * c
            placed[j] += size * c + row[1] * s + row[2] * c2 + row[3] * s2
            slope = row[1] * c - size * s + 2.0 * (row[3] * c2 - row[2] * s2)
            by_position[j] += moves_x * slope
        elif kind == 6:  # linkage
            ratio = row[2]
            c, s = math.cos(x - row[3]), math.sin(x - row[3])
            square = 1.0 + ratio * ratio - 2.0 * ratio * c
            length = math.sqrt(square)
            placed[j] += (size / length + row[1]) * s
            slope = (size / length + row[1]) * c
            slope -= size * ratio * s * s / (square * length)
            by_position[j] += moves_x * slope
        elif kind == 7:  # ripple
            c, s = math.cos(row[2] * x), math.sin(row[2] * x)
            placed[j] += size * c + row[1] * s
            by_position[j] += moves_x * row[2] * (row[1] * c - size * s)
        elif kind == 8:  # presliding
            gone = q[j] - memory[i][0]
            way = 1.0 if gone > 0 else -1.0
            left = (memory[i][1] - way) * math.exp(-abs(gone) / row[1])
            smooth[j] += size * (way + left)
            by_position[j] += size * abs(left) / row[1]
        elif kind == 9:  # backlash
            p = max(min(memory[i][1], x + row[1]), x - row[1])
            placed[j] += size * p
            if p != memory[i][1]:
                by_position[j] += moves_x * size
        elif kind == 10:  # dry friction of a coupled speed
            w = v[int(row[1])] + row[2] * v[j]
            placed[j] += size * max(min(w / row[3], 1.0), -1.0)
            if abs(w) < row[3]:
                by_velocity[j] += abs(row[2]) * size / row[3]
        elif kind == 11:  # a torque that changes with time
            placed[j] += size
        elif kind == 12:  # dry friction that changes with time
            dry[j] += size
        elif kind == 13:  # viscous, which may change with time
            smooth[j] += size * u
            by_velocity[j] += moves_u * size
        elif kind == 14:  # spring
            placed[j] += size * x
            by_position[j] += moves_x * size


def remember(kinds, joints, numbers, memory, q):
    """Move the memory of a table on to positions q; no joint turned on the way."""
    for i in range(len(kinds)):
        kind, j = kinds[i], joints[i]
        if kind == 8:
            gone = q[j] - memory[i][0]
            way = 1.0 if gone > 0 else -1.0
            left = (memory[i][1] - way) * math.exp(-abs(gone) / numbers[i][1])
            memory[i][1] = way + left
            memory[i][0] = q[j]
        elif kind == 9:
            half, low, high = numbers[i][1], numbers[i][4], numbers[i][5]
            x = min(max(q[j], low), high)
            memory[i][1] = max(min(memory[i][1], x + half), x - half)
            memory[i][0] = q[j]


class OtherEffects:
    """Effects that are not of the library, by their own columns at one state."""

    # Their torque may depend on accelerations and loads, and may jump where a joint
    # turns (`jumps`, (nv,)), which is dry friction of that joint. What depends on
    # several rows (a memory, a derivative) has no torque at one state and is left out;
    # left_out says why. effects: with coefficients, and the `EffectRange` that they are
    # held within or None; known: values of recorded signals.

    def __init__(self, robot, effects, known):
        self._nv = robot.n_joints
        self._prismatic = is_prismatic(robot.model)
        self._since = robot.since
        rng = np.random.default_rng(0)
        q, v, a, load = rng.normal(size=(4, _ROWS, self._nv))
        t = _PERIOD * np.arange(_ROWS) + (robot.since or 0.0)
        tried = q, v, a, t, load, known
        self._effects, self._held, left_out, ranges = [], (), [], []
        for effect, coef, held in effects:
            reason = effect.applies(self._motion(*tried))
            if reason:
                raise ValueError(
                    f"effects holds {effect.name} on joint {effect.joint}: {reason}."
                )
            if self._looks_around(effect, *tried):
                left_out.append((effect, "its torque depends on other rows"))
            else:
                self._effects.append((effect, coef))
                ranges.append(held)
        self.left_out = tuple(left_out)
        one = [values[0] for values in (q, v)]
        torque = self._torque(*one, a[0], t[0], load[0], known)
        moved = self._torque(*one, a[1], t[0], load[1], known)
        self._accelerates = not np.array_equal(torque, moved, equal_nan=True)
        self.jumps = np.zeros(self._nv, dtype=bool)
        for j in range(self._nv):
            sides = []
            for speed in (-1.0, -_TURNS, _TURNS, 1.0):
                v[0, j] = speed
                sides.append(self._torque(q[0], v[0], a[0], t[0], load[0], known)[j])
            far, near = sides[3] - sides[0], sides[2] - sides[1]
            self.jumps[j] = abs(near) > _JUMP * abs(far)
        # What they depend on was looked at without.
        self._held = tuple(ranges)

    def _motion(self, q, v, a, t, load, known):
        """Make a `Motion` of rows."""
        return Motion(
            q=q,
            v=v,
            a=a,
            t=t,
            load=load,
            torque=load,
            prismatic=self._prismatic,
            since=self._since,
            signals={name: np.full(t.size, value) for name, value in known.items()},
        )

    def _looks_around(self, effect, q, v, a, t, load, known):
        """Whether the columns of rows differ when they are looked at one by one."""
        whole = effect.columns(self._motion(q, v, a, t, load, known))
        rows = [slice(i, i + 1) for i in range(t.size)]
        single = [
            effect.columns(self._motion(q[i], v[i], a[i], t[i], load[i], known))
            for i in rows
        ]
        return not np.allclose(np.concatenate(single), whole, equal_nan=True)

    def _torque(self, q, v, a, t, load, known):
        """Torque at one state (nv,)."""
        motion = self._motion(
            q[None], v[None], a[None], np.array([t]), load[None], known
        )
        out = np.zeros(self._nv)
        held = own_motions(self._effects, self._held, motion)
        for (effect, coef), own in zip(self._effects, held):
            torque = effect.columns(own)[0] @ coef
            if effect.whole_robot:
                out += torque
            else:
                out[effect.joint] += torque
        return out

    def at(self, q, v, t, known, mode, stuck):
        """Torques at a state, `StateTorques`."""
        # mode (nv,): signs of dry friction; stuck (nv,), bool: joints that stick.
        turning = self.jumps & ~stuck & (v * mode <= 0)
        v = np.where(turning, _TURNS * mode, v)
        held = self.jumps & stuck
        if not held.any():
            return StateTorques(
                lambda a, load: self._torque(q, v, a, t, load, known),
                lambda a, load: np.zeros(self._nv),
                self._accelerates,
            )

        def sides(a, load):
            return [
                self._torque(q, np.where(held, way * _TURNS, v), a, t, load, known)
                for way in (-1.0, 1.0)
            ]

        return StateTorques(
            lambda a, load: 0.5 * sum(sides(a, load)),
            lambda a, load: np.where(held, 0.5 * np.subtract(*sides(a, load)[::-1]), 0),
            self._accelerates,
        )


@dataclass(frozen=True)
class StateTorques:
    """Torques of other effects at one state."""

    # (a, load) -> torque (nv,), and the size of dry friction of joints that stick
    torque: Callable
    dry: Callable
    accelerates: bool  # whether they depend on the accelerations or the load

    def tangent(self, a, ML, hL):
        """Torque at no acceleration, and by accelerations, as they are around `a`."""
        # ML, hL: inertia matrix and nonlinear effects of the load. Returns ndarrays
        # (nv,) and (nv, nv); None for the latter where there is nothing.
        there = self.torque(a, ML @ a + hL)
        if not self.accelerates:
            return there, None
        step = _SLOPE * (1.0 + np.abs(a).max())
        moved = a + step * np.eye(a.size)
        slopes = [(self.torque(b, ML @ b + hL) - there) / step for b in moved]
        slopes = np.column_stack(slopes)
        return there - slopes @ a, slopes
