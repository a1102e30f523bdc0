"""Effects of the library as functions of one state, with memory where they have one.

`Effect.columns` computes the same for all rows of a recording at once. In a control
loop a state of seven joints has some tens of microseconds, of which arrays of one
element would take all: the laws here are sums of a few floats.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa.effects import (
    AsymmetricFriction,
    Backlash,
    Coulomb,
    Counterbalance,
    Coupling,
    Delay,
    Drift,
    LoadFriction,
    Offset,
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
from sklearn_vbjfa.effects._ranges import HELD

_TINY = 2.2250738585072014e-308
_LOG_2 = math.log(2.0)
# Share of a smoothing speed below which an interval of speeds is none; as in `Rest`.
_NARROW = 1e-3


@dataclass(slots=True)
class Row:
    """One state, as lists of floats."""

    q: list = field(default_factory=list)
    v: list = field(default_factory=list)
    a: list = field(default_factory=list)
    # [s]; known_t is not earlier than the fit
    t: float | None = None
    known_t: float | None = None
    dt: float | None = None  # time since the state before [s]; None for the first
    signs: list = field(default_factory=list)  # mean signs of the velocities
    # torques of the rigid bodies and of the whole model for effects of the load
    load: list | None = None
    torque: list | None = None
    signals: dict = field(default_factory=dict)  # what is recorded beside the motion


# -- signs of velocities ---------------------------------------------------------------


def sign_of(rest, smoothing=0.0) -> Callable:
    """Return a function (v, a) -> mean sign of a velocity, by the rule of `Rest`."""
    # rest: `Rest` of one joint or of a sum of speeds, or None; its noise is zero.
    # smoothing: that of tanh(v / smoothing), zero for the sign.
    speed = 0.0 if rest is None else float(rest.speed[0])
    time = 0.0 if rest is None else float(rest.time[0])
    square = speed * speed

    def sign(v, a):
        width = square / max(speed + abs(a) * time, _TINY)
        if -width < v < width:
            return v / width
        return 1.0 if v > 0 else -1.0 if v < 0 else v

    def smoothed(v, a):
        width = square / max(speed + abs(a) * time, _TINY)
        if not width > _NARROW * smoothing:
            return math.tanh(v / smoothing)
        ends = _log_cosh((v + width) / smoothing) - _log_cosh((v - width) / smoothing)
        return smoothing * ends / (2 * width)

    return smoothed if smoothing > 0 else sign


def _log_cosh(x):
    x = abs(x)
    return x + math.log1p(math.exp(-2 * x)) - _LOG_2


# -- laws ------------------------------------------------------------------------------
#
# Each takes an effect and the `Rest` of the robot, and returns a function of a `Row`
# to the effect's columns, a tuple of floats; what has a memory begins a new one.


def _viscous(effect, rest):
    j = effect.joint
    return lambda row: (row.v[j],)


def _coulomb(effect, rest):
    j, sign = effect.joint, _own_sign(effect, rest, effect.smoothing)
    return lambda row: (sign(row.v[j], row.a[j]),)


def _asymmetric(effect, rest):
    j = effect.joint
    if rest is None:
        return lambda row: (float(row.v[j] != 0), abs(row.v[j]))
    return lambda row: (1.0, abs(row.v[j]))


def _stribeck(effect, rest):
    j, vs, k = effect.joint, effect.vs, effect.k

    def columns(row):
        return (math.exp(-(abs(row.v[j] / vs) ** k)) * row.signs[j],)

    return columns


def _quadratic(effect, rest):
    j = effect.joint
    return lambda row: (row.v[j] * abs(row.v[j]),)


def _load_friction(effect, rest):
    j, sign = effect.joint, _own_sign(effect, rest, effect.smoothing)
    return lambda row: (abs(row.load[j]) * sign(row.v[j], row.a[j]),)


def _own_sign(effect, rest, smoothing=0.0):
    return sign_of(None if rest is None else rest.pick(effect.joint), smoothing)


def _offset(effect, rest):
    return lambda row: (1.0,)


def _spring(effect, rest):
    j = effect.joint
    return lambda row: (row.q[j], 1.0)


def _counterbalance(effect, rest):
    j, ratio, angle = effect.joint, effect.ratio, effect.angle

    def linkage(row):
        x = row.q[j] - angle
        s = math.sin(x)
        return s / math.sqrt(1 + ratio**2 - 2 * ratio * math.cos(x)), s

    def harmonics(row):
        q = row.q[j]
        return math.cos(q), math.sin(q), math.cos(2 * q), math.sin(2 * q), 1.0

    return linkage if effect.form == "linkage" else harmonics


def _ripple(effect, rest):
    j, waves = effect.joint, 2 * math.pi / effect.period

    def columns(row):
        angle = waves * row.q[j]
        return math.cos(angle), math.sin(angle)

    return columns


def _rotor_inertia(effect, rest):
    j = effect.joint
    return lambda row: (row.a[j],)


def _coupling(effect, rest):
    j, k = effect.joint, effect.other
    factor = {"other": 0.0, "sum": 1.0, "difference": -1.0}[effect.of]
    joints = (k,) if effect.of == "other" else (k, j)
    sign = sign_of(None if rest is None else rest.pick(*joints))

    def columns(row):
        w, dw = row.v[k] + factor * row.v[j], row.a[k] + factor * row.a[j]
        return w, sign(w, dw), dw

    return columns


def _varied(effect):
    """Return what a drift or a signal varies, a function of a row."""
    j = effect.joint
    return {
        "coulomb": lambda row: row.signs[j],
        "offset": lambda row: 1.0,
        "viscous": lambda row: row.v[j],
    }[effect.of]


def _drift(effect, rest):
    varied, constant = _varied(effect), effect.time_constant
    return lambda row: (varied(row) * math.exp(-row.known_t / constant),)


def _signal(effect, rest):
    varied, name, reference = _varied(effect), effect.signal, effect.reference
    return lambda row: ((row.signals[name] - reference) * varied(row),)


# -- laws with a memory ----------------------------------------------------------------


def _presliding(effect, rest):
    """Dahl's bristle, solved from the last turning point on."""
    j, displacement = effect.joint, effect.displacement
    # Last position and state, those of the last turning point, and the way from there.
    last = z = turned = begin = None
    way = 0.0

    def columns(row):
        nonlocal last, z, turned, begin, way
        q = row.q[j]
        if last is None:
            last = turned = q
            z = begin = 0.0
            return (0.0,)
        step = q - last
        if step:
            new = 1.0 if step > 0 else -1.0
            if new != way:
                turned, begin, way = last, z, new
            decay = math.exp(-abs(q - turned) / displacement)
            z, last = way + (begin - way) * decay, q
        return (z,)

    return columns


def _backlash(effect, rest):
    """Follow the position at half the width (play operator)."""
    j, half = effect.joint, 0.5 * effect.width
    last = p = None

    def columns(row):
        nonlocal last, p
        q = row.q[j]
        if p is None:
            p = q
        elif q > last:
            p = max(p, q - half)
        elif q < last:
            p = min(p, q + half)
        last = q
        return p, 1.0

    return columns


def _delay(effect, rest):
    """Torque between past rows, along straight lines."""
    j, delay = effect.joint, effect.delay
    times, torques = deque(), deque()

    def columns(row):
        t, torque = row.t, row.torque[j]
        times.append(t)
        torques.append(torque)
        asked = t - delay
        while len(times) > 2 and times[1] <= asked:
            times.popleft()
            torques.popleft()
        if len(times) < 2 or asked <= times[0]:
            lagged = torques[0]
        else:
            slope = (torques[1] - torques[0]) / (times[1] - times[0])
            lagged = torques[0] + slope * (asked - times[0])
        return ((lagged - torque) / delay,)

    return columns


def _low_pass(constant):
    """Return a function (x, dt) -> first-order low-pass, as `low_pass` of channels."""
    before = y = None

    def filtered(x, dt):
        nonlocal before, y
        if y is None:
            y = x
        else:
            left = math.exp(-dt / constant)
            mean = constant / dt * (1 - left)
            y = left * y + (1 - mean) * x + (mean - left) * before
        before = x
        return y

    return filtered


def _torque_filter(effect, rest):
    j, constant = effect.joint, effect.time_constant
    first, second = _low_pass(constant), _low_pass(constant)
    backwards = effect.of == "position"

    def columns(row):
        torque, dt = row.torque[j], row.dt
        change = first(torque, dt) - torque
        if backwards:
            change = second(change, dt) - 2 * change
        return (change / constant,)

    return columns


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
    RotorInertia: _rotor_inertia,
    Coupling: _coupling,
    Delay: _delay,
    TorqueFilter: _torque_filter,
    Signal: _signal,
    Drift: _drift,
}


def law_of(effect, rest):
    """Return a function of a `Row` to the columns of an effect of one joint."""
    # None for one that is not of the library, or acts on several joints.
    law = _LAWS.get(type(effect))
    return None if law is None else law(effect, rest)


def held_columns(columns, held):
    """Return columns of a `Row` in which an `EffectRange` holds the signals."""
    if held is None:
        return columns
    for quantity, name in HELD.items():
        ends = held.ends(quantity)
        if np.isfinite(ends).any():
            columns = _holding(columns, name, held.joint, *ends)
    return columns


def _holding(columns, name, j, low, high):
    """Return the same columns with a signal of joint j between two ends."""

    def held(row):
        signal = getattr(row, name)
        value = signal[j]
        signal[j] = min(max(value, low), high)
        found = columns(row)
        # Others see it as it is.
        signal[j] = value
        return found

    return held
