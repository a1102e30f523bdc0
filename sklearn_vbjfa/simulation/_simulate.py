"""Simulated motion of an identified robot, and checks of the input."""

import warnings

import numpy as np

from sklearn_vbjfa.model import DoubtWarning, is_prismatic
from sklearn_vbjfa.simulation._dynamics import ForwardDynamics
from sklearn_vbjfa.simulation._integrate import Diverged, Integrator


class SimulationError(ValueError):
    """An identified robot diverges, or lacks inertia; the message says where."""


def recorded(signals, t):
    """Return a function that interpolates signals (n,) at times t (n,) linearly."""

    def value(name, at):
        if name not in signals:
            raise ValueError(
                f"The robot has an effect that varies with the recorded signal {name!r}"
                "; give it in signals, one value per row of tau."
            )
        return float(np.interp(at, t, signals[name]))

    return value


def simulate(robot, tau, q0, v0=None, t=None, *, signals=None):
    """Simulate a robot under measured torques; return states (n, 3 nv)."""
    # tau (n, nv): channel readings; q0, v0 (nv,): initial state; t (n,): times [s] on
    # the clock of the fit, by default every `dt` of the robot; signals: by name.
    zeros = np.zeros(robot.n_joints)
    q0 = _checked(robot, "q0", q0, zeros.shape)
    v0 = _checked(robot, "v0", zeros if v0 is None else v0, zeros.shape)
    tau = np.array(tau, dtype=float)
    if tau.ndim == 1 and robot.n_joints == 1:
        tau = tau[:, None]
    tau = _checked(robot, "tau", tau, (max(len(tau), 1), robot.n_joints))
    t = _times(robot, t, len(tau))
    signals = recorded(_signals(signals, len(tau)), t)
    dynamics = ForwardDynamics(robot, signals)
    warn_left_out(robot.joint_names, dynamics.terms.left_out, stacklevel=4)
    check_inertia(robot, dynamics, q0)
    torque = robot.true_torques(tau, t)

    def torques(row, q, v):
        return torque[row], torque[min(row + 1, len(torque) - 1)]

    return _run(robot, dynamics, torques, q0, v0, t)


def simulate_controlled(robot, control, q0, v0, t, signals=None, updates=1):
    """Simulate a robot under torques that a controller sets and then holds."""
    # control: (row, q, v) -> torques (nv,) in units of the channels; row 3.5 is halfway
    # between rows 3 and 4; updates: per sample period. Returns states (n, 3 nv).
    dynamics = ForwardDynamics(robot, recorded(signals or {}, t))

    def torques(row, q, v):
        drive = control(row, q, v) / robot.gains
        return drive, drive

    return _run(robot, dynamics, torques, q0, v0, t, updates)


def _run(robot, dynamics, torques, q0, v0, t, updates=None):
    """Integrate a motion row by row; return states (n, 3 nv)."""
    # torques: (row, q, v) -> torques at the ends of an interval: linear over a sample
    # period, held over an update period of a controller.
    n, nv, count = t.size, q0.size, updates or 1
    states = np.empty((n, 3, nv))
    with np.errstate(all="ignore"):
        dynamics.set_bodies(t[0])
        motion = Integrator(dynamics, q0, v0, torques(0, q0, v0)[0], t[0])
        for i in range(n):
            last = i + 1 == n
            for part in range(1 if last else count):
                length = 0.0 if last else (t[i + 1] - t[i]) / count
                row, start = i + part / count if updates else i, t[i] + part * length
                ends = torques(row, motion.q, motion.v)
                if updates:
                    dynamics.set_bodies(start)
                    motion.settle(ends[0])
                if part == 0:
                    states[i] = motion.q, motion.v, motion.a
                if not last:
                    stop = t[i + 1] if count == 1 else start + length
                    _advance(robot, dynamics, motion, ends, start, stop, i, updates)
    return states.reshape(n, -1)


def _advance(robot, dynamics, motion, ends, start, stop, row, updates):
    """Advance between two times, with a change of bodies at instants between them."""
    begin, end = ends
    period, now, torque = stop - start, start, begin
    changes = [x for x in dynamics.instants if start < x <= stop]
    for instant in sorted({*changes, stop}) if changes else (stop,):
        remaining = (stop - instant) / period
        after = end if remaining == 0 else end - remaining * (end - begin)
        try:
            motion.advance(torque, after, instant - now)
        except Diverged as error:
            delay, joint = error.args
            raise _diverged(robot, motion, now + delay, row, joint, updates) from None
        if instant in changes:
            dynamics.set_bodies(instant)
            motion.settle(after)
        now, torque = instant, after


def _diverged(robot, motion, time, row, joint, updates):
    unit = "m/s" if is_prismatic(robot.model)[joint] else "rad/s"
    advice = (
        "Torques or a start in another unit do that, friction with a negative "
        "coefficient, or bodies that the recording does not determine: check the "
        "units, look at the parameters of this joint, and identify with more motion."
    )
    if updates:
        advice = "With these gains the loop is not stable: check their units and signs."
    return SimulationError(
        f"The simulation diverges at t = {time:.6g} s (after row {row}): "
        f"{robot.joint_names[joint]} has the velocity {motion.v[joint]:.3g} {unit}. "
        f"{advice}"
    )


def _checked(robot, name, values, shape):
    """Return validated values of all joints, in one or many rows."""
    values = np.array(values, dtype=float)
    if values.shape != shape:
        raise ValueError(
            f"{name} must have shape {shape}, with a column for each joint "
            f"({', '.join(robot.joint_names)}); got shape {values.shape}."
        )
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        *row, j = bad[0]
        where = f"joint {robot.joint_names[j]}"
        if row:
            since = f" ({row[0] * robot.dt:.6g} s after the start)" if robot.dt else ""
            where = f"row {row[0]}{since}, {where}"
        raise ValueError(
            f"{name} holds {values[tuple(bad[0])]} in {where}; {len(bad)} value(s) in "
            "all. Cut the recording there, or fill the gap."
        )
    return values


def _times(robot, t, n):
    start = 0.0 if robot.since is None else robot.since
    if t is None:
        if robot.dt is None:
            raise ValueError(
                "The robot was identified without a sample period; give the times of "
                "the rows as t."
            )
        return start + robot.dt * np.arange(n)
    return np.array(t, dtype=float)


def _signals(signals, n):
    checked = {}
    for name, values in ({} if signals is None else signals).items():
        checked[name] = np.array(values, dtype=float)
        if checked[name].shape != (n,) or not np.isfinite(checked[name]).all():
            raise ValueError(
                f"signals[{name!r}] must hold one finite value per row of tau, shape "
                f"({n},); got shape {checked[name].shape}."
            )
    return checked


def check_inertia(robot, dynamics, q0):
    nv = robot.n_joints
    arguments = np.zeros(nv), np.zeros(nv), np.zeros(nv), np.zeros(nv, dtype=bool)
    dynamics.start(q0)
    dynamics.accelerate(q0, *arguments)
    mass = dynamics.mass + dynamics.terms.inertia
    values, vectors = np.linalg.eigh(0.5 * (mass + mass.T))
    if not values[0] > 0:
        name = robot.joint_names[int(np.argmax(np.abs(vectors[:, 0])))]
        raise SimulationError(
            f"The inertia of {name} at q0 is not positive ({values[0]:.3g} kg m^2): "
            "bodies or couplings are not determined; identify with more motion."
        )


def warn_left_out(names, left, stacklevel):
    """Warn of effects that a simulation omits, each with the reason."""
    if left:
        left = [f"{e.name} on {names[e.joint]} ({reason})" for e, reason in left]
        text = f"The simulation leaves out {'; '.join(left)}."
        warnings.warn(text, DoubtWarning, stacklevel=stacklevel)
