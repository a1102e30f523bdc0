"""Simulated motion of an identified robot, and checks of what it is asked."""

import warnings

import numpy as np

from sklearn_vbjfa.model import DoubtWarning, is_prismatic
from sklearn_vbjfa.simulation._dynamics import ForwardDynamics
from sklearn_vbjfa.simulation._integrate import (
    MOST_STOPS,
    SLOWEST,
    Diverged,
    Integrator,
)

# Time stamps may differ from whole periods by this share of one.
_JITTER = 0.01
# Energy may exceed what was put in by this share; looked at every so many rows.
_EXCESS, _EVERY = 0.01, 8
# Of this share of the potential energy nothing is known.
_ROUNDING = 1e-9
# A start may lie outside the limits by this share of the range: noise, or a zero.
_MARGIN = 1e-3


class SimulationError(ValueError):
    """The motion of an identified robot cannot be followed to its end.

    It diverges, or has more energy than was put in. The message says when, and which
    joint is to be looked at.

    Attributes
    ----------
    time : float
        Time at which the simulation was given up [s].

    Examples
    --------
    >>> from sklearn_vbjfa.simulation import SimulationError
    >>> issubclass(SimulationError, ValueError)
    True
    """

    def __init__(self, message, time):
        super().__init__(message)
        self.time = time


class Recorded:
    """Recorded signals (n,) at times t, interpolated linearly."""

    def __init__(self, signals, t):
        self._signals, self._t = dict(signals), t

    def __call__(self, name, t):
        """Value of one of them at a time."""
        if name not in self._signals:
            raise ValueError(
                f"The robot has an effect that varies with the recorded signal {name!r}"
                "; give it in signals, one value per row of tau."
            )
        return float(np.interp(t, self._t, self._signals[name]))

    def at(self, t):
        return {name: self(name, t) for name in self._signals}


def simulate(robot, tau, q0, v0=None, t=None, *, signals=None):
    """Simulate a robot that is driven by measured torques; states (n, 3 nv)."""
    # tau (n, nv): as the channels read them; q0, v0 (nv,): in the first row; t (n,):
    # times of the rows [s] on the clock of the fit, by default every `dt` of the robot;
    # signals: by name.
    q0, v0 = _start(robot, q0, v0)
    tau = _torques(robot, tau)
    t = _times(robot, t, len(tau))
    signals = Recorded(_signals(signals, len(tau)), t)
    dynamics = ForwardDynamics(robot, signals)
    _tell_left_out(robot, dynamics)
    _check_inertia(robot, dynamics, q0)
    torque = robot.true_torques(tau, t)
    states = _run(robot, dynamics, torque, q0, v0, t)
    _tell_limits(robot, states, t)
    return states


def _run(robot, dynamics, tau, q0, v0, t):
    """States (n, 3 nv) of a motion, row by row."""
    n, nv = tau.shape
    states = np.empty((n, 3 * nv))
    energy = _Energy(robot, dynamics)
    with np.errstate(all="ignore"):
        dynamics.set_bodies(t[0])
        instants = dynamics.instants
        motion = Integrator(dynamics, q0, v0, tau[0], t[0])
        for i in range(n):
            if i:
                _follow(robot, dynamics, motion, energy, i, t, tau, instants)
            states[i, :nv], states[i, nv : 2 * nv] = motion.q, motion.v
            states[i, 2 * nv :] = motion.a
            if i % _EVERY == 0 or i + 1 == n:
                energy.check(motion, t[i])
    tell_held(robot, motion, stacklevel=5)
    return states


def _follow(robot, dynamics, motion, energy, i, t, tau, instants):
    """Move on to row i from the one before, through the instants between them."""
    since, start, period = t[i - 1], tau[i - 1], t[i] - t[i - 1]
    between = [x for x in instants if since < x <= t[i]]
    for until in sorted({*between, t[i]}) if between else (t[i],):
        left = (t[i] - until) / period
        end = tau[i] if left == 0 else tau[i] - left * (tau[i] - tau[i - 1])
        try:
            motion.advance(start, end, until - since)
        except Diverged as found:
            raise _diverged(robot, motion, since + found.time, i, found.joint) from None
        if until in between:
            before = energy.present(motion)
            dynamics.set_bodies(until)
            motion.settle(end)
            energy.jump(before, motion)
        since, start = until, end


def _diverged(robot, motion, time, row, joint):
    unit = "m/s" if is_prismatic(robot.model)[joint] else "rad/s"
    return SimulationError(
        f"The simulation diverges at t = {time:.6g} s (before row {row}): "
        f"{robot.joint_names[joint]} has the velocity {motion.v[joint]:.3g} {unit}. "
        "Torques or a start in another unit do that, friction with a negative "
        "coefficient, or bodies that the recording does not determine: check the "
        "units, look at the parameters of this joint, and identify with more motion.",
        time,
    )


class _Energy:
    """The balance of energy of a motion, looked at row by row."""

    def __init__(self, robot, dynamics):
        self._robot, self._dynamics = robot, dynamics
        self._start, self._least = None, 0.0
        self._largest, self._moved, self._work = 0.0, 0.0, 0.0

    def present(self, motion):
        kinetic = self._dynamics.kinetic_energy(motion.v)
        self._largest = max(self._largest, kinetic)
        energy = kinetic + self._dynamics.potential_energy(motion.q)
        if self._start is None:
            # What rounding and slow joints make of nothing is no energy.
            slow = 0.5 * SLOWEST**2 * self._dynamics.mass.diagonal().max()
            self._least = slow + _ROUNDING * abs(energy)
        return energy

    def jump(self, before, motion):
        self._start += self.present(motion) - before

    def check(self, motion, t):
        energy = self.present(motion)
        if self._start is None:
            self._start = energy
        self._moved += abs(motion.work - self._work)
        self._work = motion.work
        excess = energy - self._start - motion.work
        size = self._largest + self._moved + self._least
        if excess > _EXCESS * size:
            raise SimulationError(
                f"At t = {t:.6g} s the robot has {excess:.3g} J more than was put in, "
                f"{100 * excess / size:.2g} % of all energy: {self._reason()}.",
                t,
            )

    def _reason(self):
        driving = self._dynamics.terms.drives()
        names = [n for n, bad in zip(self._robot.joint_names, driving) if bad]
        if names:
            return (
                f"friction of {', '.join(names)} has a negative coefficient, with "
                "which it drives the joint; the recording does not determine it, or "
                "it stands for something else"
            )
        return "the steps of the integration do not follow so fast a motion"


# -- under a controller ----------------------------------------------------------------


def simulate_controlled(robot, control, q0, v0, t, signals=None, updates=1):
    """Simulate a robot whose torques a controller sets and then holds."""
    # control: (row, q, v) -> torques (nv,) as the channels read them, row being 3.5
    # between rows 3 and 4; updates: how often in a sample period. Returns states (n, 3
    # nv), torques (n, nv).
    n, nv = t.size, robot.n_joints
    dynamics = ForwardDynamics(robot, Recorded(signals or {}, t))
    states, tau = np.empty((n, 3 * nv)), np.empty((n, nv))
    drive = control(0.0, q0, v0)
    with np.errstate(all="ignore"):
        dynamics.set_bodies(t[0])
        motion = Integrator(dynamics, q0, v0, drive / robot.gains, t[0])
        for i in range(n):
            for part in range(updates):
                own = control(i + part / updates, motion.q, motion.v)
                drive = own / robot.gains
                length = 0.0 if i + 1 == n else (t[i + 1] - t[i]) / updates
                time = t[i] + part * length
                dynamics.set_bodies(time)
                motion.settle(drive)
                if part == 0:
                    tau[i] = own
                    states[i] = np.concatenate([motion.q, motion.v, motion.a])
                if i + 1 == n:
                    break
                _advance_held(robot, motion, drive, length, time, i)
    tell_held(robot, motion, stacklevel=3)
    return states, tau


def _advance_held(robot, motion, drive, length, time, row):
    try:
        motion.advance(drive, drive, length)
    except Diverged as found:
        time += found.time
        raise SimulationError(
            f"The controlled robot diverges at t = {time:.6g} s (row {row}), joint "
            f"{robot.joint_names[found.joint]}: with these gains the loop is not "
            "stable. Check their units and signs, that the reference is the commanded "
            "position, and the period of the controller, which may be shorter than "
            "that of the recording.",
            time,
        ) from None


# -- what is asked ---------------------------------------------------------------------


def _start(robot, q0, v0):
    names, found = robot.joint_names, []
    for name, values in (("q0", q0), ("v0", v0)):
        values = np.zeros(len(names)) if values is None else values
        values = np.array(values, dtype=float)
        if values.shape != (len(names),):
            raise ValueError(
                f"{name} must hold one value for each joint ({', '.join(names)}), "
                f"shape ({len(names)},); got shape {values.shape}."
            )
        bad = ~np.isfinite(values)
        if bad.any():
            j = int(np.argmax(bad))
            raise ValueError(f"{name} holds {values[j]} for {names[j]}.")
        found.append(values)
    q0, v0 = found
    low, high = _limits(robot.model)
    margin = _MARGIN * np.where(np.isfinite(high - low), high - low, 0.0)
    for j in np.flatnonzero((q0 < low - margin) | (q0 > high + margin)):
        unit = "m" if is_prismatic(robot.model)[j] else "rad"
        raise ValueError(
            f"q0 lies outside the limits of {names[j]}: {q0[j]:.6g} {unit}, limits "
            f"{low[j]:.6g} to {high[j]:.6g} {unit}. Check the zero and the unit of the "
            "positions, or correct the limits in the robot description."
        )
    return q0, v0


def _limits(model):
    low, high = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    real = (low < high) & (np.abs(low) < 1e9) & (np.abs(high) < 1e9)
    return np.where(real, low, -np.inf), np.where(real, high, np.inf)


def _torques(robot, tau):
    """Check the torques, (n, nv)."""
    tau = np.array(tau, dtype=float)
    nv = robot.n_joints
    if tau.ndim == 1 and nv == 1:
        tau = tau[:, None]
    if tau.ndim != 2 or tau.shape[1] != nv or not len(tau):
        raise ValueError(
            f"tau must hold one row of torques per sample and one column per joint "
            f"({', '.join(robot.joint_names)}), shape (n, {nv}); got shape {tau.shape}."
        )
    bad = np.argwhere(~np.isfinite(tau))
    if bad.size:
        row, j = bad[0]
        at = "" if robot.dt is None else f" ({row * robot.dt:.6g} s after the start)"
        raise ValueError(
            f"tau holds {tau[row, j]} in row {row}{at}, joint {robot.joint_names[j]}; "
            f"{len(bad)} value(s) in all. A simulation needs every torque: cut the "
            "recording there, or fill the gap."
        )
    return tau


def _times(robot, t, n):
    """Check the times of the rows, (n,)."""
    since = 0.0 if robot.since is None else robot.since
    if t is None:
        if robot.dt is None:
            raise ValueError(
                "The robot was identified without a sample period; give the times of "
                "the rows as t."
            )
        return since + robot.dt * np.arange(n)
    t = np.array(t, dtype=float)
    if t.shape != (n,):
        raise ValueError(
            f"tau has {n} rows and t has shape {t.shape}; expected one time for each "
            f"row, shape ({n},)."
        )
    bad = ~np.isfinite(t)
    if bad.any():
        raise ValueError(f"t holds {t[np.argmax(bad)]} in row {int(np.argmax(bad))}.")
    steps = np.diff(t)
    if not steps.size:
        return t
    if not (steps > 0).all():
        row = int(np.argmax(steps <= 0))
        raise ValueError(
            f"t must rise; it goes from {t[row]:.6g} to {t[row + 1]:.6g} s in row "
            f"{row + 1}."
        )
    if robot.dt is not None:
        usual = float(np.median(steps))
        if abs(usual - robot.dt) > _JITTER * robot.dt:
            raise ValueError(
                f"The torques come every {usual:.6g} s (t), and the robot was "
                f"identified at {robot.dt:.6g} s: resample them to that rate, or "
                "identify from a recording of this one."
            )
        wrong = np.abs(steps - robot.dt) > 0.5 * robot.dt
        if wrong.any():
            row = int(np.argmax(wrong))
            raise ValueError(
                f"t goes from {t[row]:.6g} to {t[row + 1]:.6g} s in row {row + 1}, the "
                f"sample period is {robot.dt:.6g} s: rows are missing. Simulate the "
                "pieces one by one."
            )
    return t


def _signals(signals, n):
    """Check recorded signals, (n,) each."""
    found = {}
    for name, values in ({} if signals is None else signals).items():
        found[name] = np.array(values, dtype=float)
        if found[name].shape != (n,) or not np.isfinite(found[name]).all():
            raise ValueError(
                f"signals[{name!r}] must hold one finite value per row of tau, shape "
                f"({n},); got shape {found[name].shape}."
            )
    return found


def _check_inertia(robot, dynamics, q0):
    nv = robot.n_joints
    still = np.zeros(nv), np.zeros(nv), np.zeros(nv), np.zeros(nv, dtype=bool)
    dynamics.start(q0)
    dynamics.accelerate(q0, *still)
    mass = dynamics.mass + dynamics.terms.inertia
    values, vectors = np.linalg.eigh(0.5 * (mass + mass.T))
    if not values[0] > 0:
        name = robot.joint_names[int(np.argmax(np.abs(vectors[:, 0])))]
        raise ValueError(
            f"The inertia of {name} at q0 is not positive ({values[0]:.3g} kg m^2): it "
            "would be accelerated against its torque. Its rotor inertia or coupling is "
            "negative, or its bodies are not determined; identify with "
            'projector="default" and more motion.'
        )


def _tell_left_out(robot, dynamics):
    names, others = robot.joint_names, dynamics.terms.others
    left = [(e, e.not_simulated) for e in robot.effects if e.not_simulated]
    left += [] if others is None else others.left_out
    if left:
        left = [f"{e.name} on {names[e.joint]} ({reason})" for e, reason in left]
        warnings.warn(
            f"The simulation leaves out {'; '.join(left)}.",
            DoubtWarning,
            stacklevel=4,
        )


def tell_held(robot, motion, stacklevel):
    """Warn of joints that stopped so often in a sample period that they were held."""
    named = [
        f"{name} in {count} sample period{'s' if count > 1 else ''}"
        for name, count in zip(robot.joint_names, motion.held)
        if count
    ]
    if named:
        warnings.warn(
            f"A simulated joint stops more than {MOST_STOPS} times within a sample "
            f"period and is held to its end: {', '.join(named)}, first at t = "
            f"{motion.held_since:.6g} s. It moves faster than the torques are sampled: "
            "look for a stiffness too high or an inertia too small for this period "
            "among the parameters of this joint, or simulate in shorter periods.",
            UserWarning,
            stacklevel=stacklevel,
        )


def _tell_limits(robot, states, t):
    nv = robot.n_joints
    low, high = _limits(robot.model)
    outside = (states[:, :nv] < low) | (states[:, :nv] > high)
    left = [
        f"{name} at t = {t[np.argmax(out)]:.6g} s"
        for name, out in zip(robot.joint_names, outside.T)
        if out.any()
    ]
    if left:
        warnings.warn(
            f"The simulated robot leaves its joint limits: {', '.join(left)}; there "
            "are no stops in the simulation.",
            UserWarning,
            stacklevel=4,
        )
