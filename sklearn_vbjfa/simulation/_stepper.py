"""An identified robot without data, and its torques one state at a time."""

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sklearn_vbjfa.effects import (
    HELD,
    Floats,
    InModel,
    Motion,
    OfChannel,
    OfRobot,
    OfSignals,
    OnAllJoints,
    Payload,
    Rest,
    State,
    Stateful,
    TorqueLag,
)
from sklearn_vbjfa.model import TreeRegressor, describe, is_prismatic, joint_names


@dataclass(frozen=True, kw_only=True, eq=False)
class Load:
    """Parameters of the load and the torque in the columns of effects."""

    # Parameters of the fit before the last one, slightly different from the final ones;
    # see `sklearn_vbjfa.equations._equations.make_motion`.
    bodies: np.ndarray  # (nv, 10)
    friction: np.ndarray  # (nv, n_friction): of the declared friction
    coefficients: tuple  # of each effect; empty for effects that need a load themselves


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueModel:
    """An identified robot: bodies, friction, effects, and gains of its channels."""

    # Pinocchio model: geometry and gravity, corrected by effects, without inertias.
    model: object
    bodies: np.ndarray  # (nv, 10): inertial parameters in Pinocchio's order
    friction_names: tuple  # declared columns, such as ("viscous", "coulomb")
    friction: np.ndarray  # (nv, n_friction): their coefficients
    effects: tuple = ()  # including those in the model (`InModel`)
    # By effect; effects in the model act through `model` and `gains` alone.
    coefficients: tuple = ()
    ranges: tuple = ()  # `EffectRange` of each effect or None; empty clips none
    gains: np.ndarray  # (nv,): ratio of channel reading to true torque
    load: Load | None = None  # None if no effect needs a load
    rest: Rest | None = None  # speeds at or below which joints may be at rest
    since: float | None = None  # first time of the fit [s], where effects of time begin
    dt: float | None = None  # sample period of the fit [s]

    @property
    def limits(self):
        return self.ranges or (None,) * len(self.effects)

    @property
    def n_joints(self):
        return self.model.nv

    @property
    def joint_names(self):
        return joint_names(self.model)

    def true_torques(self, tau, t):
        """Convert measured torques (n, nv) at times t (n,) to joint torques."""
        out = tau / self.gains
        for effect, coef in zip(self.effects, self.coefficients):
            if isinstance(effect, (OfChannel, TorqueLag)) and t.size > 1:
                for j in effect.acts_on(self.n_joints):
                    out[:, j] = effect.corrected(coef, out[:, j], t)
        return out


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Part of an identified robot that a file or a control loop omits."""

    name: str  # of the effect, or of the declared friction
    joint: int  # from zero
    joint_name: str  # "all joints" of an effect of the whole robot
    reason: str  # why it is omitted, or what is missing

    @classmethod
    def of(cls, effect, names, reason):
        j, whole = effect.joint, isinstance(effect, OfRobot)
        where = "all joints" if whole else names[j]
        return cls(name=effect.name, joint=j, joint_name=where, reason=reason)

    def __str__(self):
        return f"{self.name} on {self.joint_name}: {self.reason}"


def why_left_out(effect):
    """Return why an effect cannot be computed state by state; empty if it can."""
    if isinstance(effect, (OfChannel, TorqueLag)):
        return "it is a property of the torque channel"
    if isinstance(effect, Stateful) and effect.law(Floats(None)) is None:
        return "it depends on other states, and has no law"
    return ""


def causal(model):
    """Remove effects that need other states; return these as `LeftOut`."""
    reasons = list(map(why_left_out, model.effects))

    def kept(values):
        return tuple(x for x, reason in zip(values, reasons) if not reason)

    load = model.load
    if load is not None:
        load = replace(load, coefficients=kept(load.coefficients))
    changes = {"effects": kept(model.effects), "coefficients": kept(model.coefficients)}
    reduced = replace(model, **changes, ranges=kept(model.limits), load=load)
    left = [pair for pair in zip(model.effects, reasons) if pair[1]]
    return reduced, tuple(LeftOut.of(x, model.joint_names, why) for x, why in left)


class Stepper:
    """Torques of a `TorqueModel` state by state, for control loops."""

    # Hysteresis, play, delays and lags store the states since `reset`, back to the last
    # reversal or over their duration. `left_out_`: effects that need future states. An
    # object must not be shared between threads.

    def __init__(self, model):
        self._model, self.left_out_ = causal(model)
        model = self._model
        self._nv, loads = model.n_joints, len(model.effects) * [np.empty(0)]
        if model.load is not None:
            loads = model.load.coefficients
        # Effects in the model act through it and the gains alone.
        pairs = [
            (effect, np.asarray(coefs, dtype=float), np.asarray(load_coefs), limits)
            for effect, coefs, load_coefs, limits in zip(
                model.effects, model.coefficients, loads, model.limits, strict=True
            )
            if not isinstance(effect, InModel)
        ]
        effects = [effect for effect, *_ in pairs]
        self._timed = any("time" in effect.needs for effect in effects)
        recorded = [x.recorded for x in effects if isinstance(x, OfSignals)]
        self._signals = set().union(*recorded)
        self._payloads = [x for x in pairs if isinstance(x[0], Payload)]
        self._pairs = [x for x in pairs if not isinstance(x[0], Payload)]
        self._needs_load = any("load" in effect.needs for effect in effects)
        functions = self._functions = Floats(model.rest)
        signs = [functions.sign(j) for j in range(self._nv)]
        self._friction = _JointFriction(model.friction_names, model.friction, signs)
        self._rigid = _Rigid(model, model.bodies, self._payloads)
        self._load_friction = self._load_rigid = self._load_whole = None
        if self._needs_load:
            load = model.load
            self._load_friction = _JointFriction(
                model.friction_names, load.friction, signs
            )
            self._load_rigid = _Rigid(model, load.bodies)
            if self._payloads:
                self._load_whole = _Rigid(model, load.bodies, self._payloads, 1)
        self._row = State()
        self._gains = np.asarray(model.gains, dtype=float)
        self.reset()

    def reset(self):
        self._n, self._last = 0, None
        self._terms, self._load_terms = [], []
        for effect, coefs, load, limits in self._pairs:
            law = effect.law(self._functions)
            if law is None:
                law = _RowLaw(self._model, effect, self._needs_load)
            term = _Term(_clipped(law, limits), effect, coefs.tolist(), load.tolist())
            (self._load_terms if "load" in effect.needs else self._terms).append(term)

    def step(self, q, v, a, t=None, signals=None):
        """Return channel torques (nv,) of the next state, friction included."""
        # q, v, a (nv,): assumed noiseless; t: time [s] on the clock of the fit, None
        # for one sample period after the last state; signals: name -> value.
        row = self._row
        q = np.asarray(q, dtype=float)
        v = np.asarray(v, dtype=float)
        a = np.asarray(a, dtype=float)
        nv = self._nv
        if not q.shape == v.shape == a.shape == (nv,):
            raise ValueError(
                f"q, v and a must have the shape ({nv},); got {q.shape}, {v.shape} and "
                f"{a.shape}."
            )
        row.q, row.v, row.a = q.tolist(), v.tolist(), a.tolist()
        finite = math.isfinite(sum(row.q) + sum(row.v) + sum(row.a))
        # Sums may overflow although all values are finite.
        if not finite and not np.isfinite([q, v, a]).all():
            raise ValueError(
                f"State {self._n} since the reset is not finite: q={row.q}, v={row.v}, "
                f"a={row.a}."
            )
        if self._signals:
            row.signals = self._pick_signals(signals)
        # Last check: a rejected state must not change the memory.
        if self._timed:
            self._set_time(t)
        self._n += 1
        torque = self._rigid(q, v, a, row)
        self._friction(torque, row)
        total = None
        if self._needs_load:
            row.load = self._load_rigid(q, v, a, row)
            loaded = self._load_whole
            total = row.load.copy() if loaded is None else loaded(q, v, a, row)
            self._load_friction(total, row)
        for term in self._terms:
            term.add(row, torque, total)
        if self._load_terms:
            row.torque = total
            for term in self._load_terms:
                term.add(row, torque, None)
        return np.array(torque) * self._gains

    def _set_time(self, t):
        since, dt = self._model.since, self._model.dt
        if t is None:
            if dt is None:
                raise ValueError(
                    "t is needed: effects vary with time, and the robot was identified "
                    "without a sample period."
                )
            t = (0.0 if since is None else since) + self._n * dt
        else:
            t = float(t)
        if not (t > self._last if self._last is not None else math.isfinite(t)):
            before = "" if self._last is None else f" after {self._last}"
            raise ValueError(
                f"t must go on from state to state; got {t}{before}. Call reset() for "
                "another motion."
            )
        self._last = self._row.t = t
        self._row.clipped_t = t if since is None else max(t, since)

    def _pick_signals(self, signals):
        signals = {} if signals is None else signals
        missing = sorted(self._signals - set(signals))
        if missing:
            raise ValueError(
                f"signals must hold {', '.join(map(repr, missing))}, which effects "
                "vary with."
            )
        return {name: float(signals[name]) for name in self._signals}


def _clipped(columns, limits):
    """Clip the signals of a `State` to an `EffectRange` in a function of columns."""
    for quantity, name in HELD.items() if limits is not None else ():
        ends = limits.ends(quantity)
        if np.isfinite(ends).any():
            columns = _clip_signal(columns, name, limits.joint, *ends)
    return columns


def _clip_signal(columns, name, j, low, high):
    """Return the same function with a signal of joint j clipped to two limits."""

    def clipped_columns(row):
        signal = getattr(row, name)
        value = signal[j]
        signal[j] = min(max(value, low), high)
        result = columns(row)
        # Other terms use the original value.
        signal[j] = value
        return result

    return clipped_columns


class _Term:
    """An effect with its coefficients, and those of the `Load`."""

    __slots__ = ("_coefs", "_columns", "_everywhere", "_joint", "_load_coefs", "_loads")

    def __init__(self, columns, effect, coefs, load_coefs):
        self._columns, self._joint = columns, effect.joint
        self._everywhere = isinstance(effect, OnAllJoints)
        self._coefs, self._load_coefs = coefs, load_coefs
        self._loads = effect.loads

    def add(self, row, torque, total):
        """Add the effect to a torque, and to the torque of the load fit unless None."""
        columns, load = self._columns(row), row.load if self._loads else None
        pairs = (torque, self._coefs), (total, self._load_coefs)
        for out, coefs in (*pairs, (load, self._load_coefs)):
            if out is not None and self._everywhere:
                for j, value in enumerate((np.asarray(columns) @ coefs).tolist()):
                    out[j] += value
            elif out is not None:
                out[self._joint] += sum(map(_product, coefs, columns))


_product = float.__mul__


class _JointFriction:
    def __init__(self, names, coefficients, signs):
        terms = "viscous", "coulomb", "offset", "rotor_inertia"
        table = dict(zip(names, np.asarray(coefficients, dtype=float).T.tolist()))
        zeros = [0.0] * len(signs)
        rows = [table.get(name, zeros) for name in terms]
        self._rows = list(zip(*rows, signs))

    def __call__(self, torque, row):
        """Add the friction of a row to a torque."""
        v, a = row.v, row.a
        for j, (viscous, coulomb, offset, rotor, sign) in enumerate(self._rows):
            friction = viscous * v[j] + offset + rotor * a[j]
            torque[j] += friction + coulomb * sign(v[j], a[j]) if coulomb else friction


class _Rigid:
    """Rigid-body torques with payloads, without rotors."""

    def __init__(self, model, bodies, payloads=(), which=0):
        from sklearn_vbjfa.model._kernel import torques

        self._compute = torques
        self._tree, nv = describe(model.model), model.n_joints
        self._state, self._out = np.empty((3, nv)), np.empty((1, nv))
        self._instants = sorted({t for x in payloads for t, _ in x[0].changes})
        self._bodies = []
        for instant in [-math.inf, *self._instants]:
            carried = np.array(bodies, dtype=float)
            for effect, *coefs, _ in payloads:
                for t, sign in effect.changes:
                    carried[effect.joint] += (
                        sign * (t <= instant) * effect.inertial(coefs[which])
                    )
            self._bodies.append(carried)

    def __call__(self, q, v, a, row):
        """Torques of a state, a list of floats."""
        state = self._state
        state[0], state[1], state[2] = q, v, a
        index = sum(row.t >= instant for instant in self._instants)
        self._compute(state.reshape(1, -1), self._tree, self._bodies[index], self._out)
        return self._out[0].tolist()


class _RowLaw:
    """Columns of a custom effect, from a `Motion` of one row."""

    def __init__(self, model, effect, load):
        self._columns, self._model, self._effect = effect.columns, model, effect
        self._prismatic = is_prismatic(model.model)
        self._tree = TreeRegressor(model.model)
        self._rigid = None
        if load:
            self._rigid = partial(self._tree.torques, inertial=model.load.bodies)

    def __call__(self, row):
        """Columns (k,) or (nv, k) of a row."""
        q, v, a = (np.array([x]) for x in (row.q, row.v, row.a))
        motion = Motion(
            q=q,
            v=v,
            a=a,
            t=None if row.t is None else np.array([row.t]),
            load=None if row.load is None else np.array([row.load]),
            torque=None if row.torque is None else np.array([row.torque]),
            prismatic=self._prismatic,
            rigid=self._rigid,
            rest=self._model.rest,
            since=self._model.since,
            signals={name: np.array([x]) for name, x in row.signals.items()},
        )
        columns = self._columns(motion)[0]
        return columns if isinstance(self._effect, OnAllJoints) else columns.tolist()
