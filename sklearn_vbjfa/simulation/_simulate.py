"""Simulated motion of an identified robot, and checks of what it is asked."""

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
    """Simulate a robot that is driven by measured torques; states (n, 3 nv)."""
    # tau (n, nv): as the channels read them; q0, v0 (nv,): in the first row; t (n,):
    # times of the rows [s] on the clock of the fit, by default every `dt` of the robot;
    # signals: by name.
    nothing = np.zeros(robot.n_joints)
    q0 = _checked(robot, "q0", q0, nothing.shape)
    v0 = _checked(robot, "v0", nothing if v0 is None else v0, nothing.shape)
    tau = np.array(tau, dtype=float)
    if tau.ndim == 1 and robot.n_joints == 1:
        tau = tau[:, None]
    tau = _checked(robot, "tau", tau, (max(len(tau), 1), robot.n_joints))
    t = _times(robot, t, len(tau))
    signals = recorded(_signals(signals, len(tau)), t)
    dynamics = ForwardDynamics(robot, signals)
    warn_left_out(robot.joint_names, dynamics.terms.left_out, stacklevel=4)
    _check_inertia(robot, dynamics, q0)
    torque = robot.true_torques(tau, t)

    def torques(row, q, v):
        return torque[row], torque[min(row + 1, len(torque) - 1)]

    return _run(robot, dynamics, torques, q0, v0, t)


def simulate_controlled(robot, control, q0, v0, t, signals=None, updates=1):
    """Simulate a robot whose torques a controller sets and then holds."""
    # control: (row, q, v) -> torques (nv,) as the channels read them, row being 3.5
    # between rows 3 and 4; updates: how often in a sample period. Returns states (n, 3
    # nv).
    dynamics = ForwardDynamics(robot, recorded(signals or {}, t))

    def torques(row, q, v):
        drive = control(row, q, v) / robot.gains
        return drive, drive

    return _run(robot, dynamics, torques, q0, v0, t, updates)


def _run(robot, dynamics, torques, q0, v0, t, updates=None):
    """States (n, 3 nv) of a motion, row by row."""
    # torques: (row, q, v) -> those from a row on and at the end of what is done at a
    # time: a sample period, over which they go straight, or one of the `updates` of a
    # controller, over which they are held.
    n, nv, count = t.size, q0.size, updates or 1
    states = np.empty((n, 3, nv))
    with np.errstate(all="ignore"):
        dynamics.set_bodies(t[0])
        motion = Integrator(dynamics, q0, v0, torques(0, q0, v0)[0], t[0])
        for i in range(n):
            last = i + 1 == n
            for part in range(1 if last else count):
                length = 0.0 if last else (t[i + 1] - t[i]) / count
                row, since = i + part / count if updates else i, t[i] + part * length
                ends = torques(row, motion.q, motion.v)
                if updates:
                    dynamics.set_bodies(since)
                    motion.settle(ends[0])
                if part == 0:
                    states[i] = motion.q, motion.v, motion.a
                if not last:
                    until = t[i + 1] if count == 1 else since + length
                    _advance(robot, dynamics, motion, ends, since, until, i, updates)
    return states.reshape(n, -1)


def _advance(robot, dynamics, motion, ends, since, until, row, updates):
    """Move on between two times, through the instants between them."""
    begin, end = ends
    period, now, torque = until - since, since, begin
    between = [x for x in dynamics.instants if since < x <= until]
    for instant in sorted({*between, until}) if between else (until,):
        left = (until - instant) / period
        then = end if left == 0 else end - left * (end - begin)
        try:
            motion.advance(torque, then, instant - now)
        except Diverged as found:
            late, joint = found.args
            raise _diverged(robot, motion, now + late, row, joint, updates) from None
        if instant in between:
            dynamics.set_bodies(instant)
            motion.settle(then)
        now, torque = instant, then


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


# -- what is asked ---------------------------------------------------------------------


def _checked(robot, name, values, shape):
    """Check values of joints, in one row or in many."""
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
    """Return the times of the rows, (n,)."""
    since = 0.0 if robot.since is None else robot.since
    if t is None:
        if robot.dt is None:
            raise ValueError(
                "The robot was identified without a sample period; give the times of "
                "the rows as t."
            )
        return since + robot.dt * np.arange(n)
    return np.array(t, dtype=float)


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
        raise SimulationError(
            f"The inertia of {name} at q0 is not positive ({values[0]:.3g} kg m^2); "
            'identify with projector="default" and more motion.'
        )


def warn_left_out(names, left, stacklevel):
    """Warn of effects that a simulation goes without, each with the reason."""
    if left:
        left = [f"{e.name} on {names[e.joint]} ({reason})" for e, reason in left]
        text = f"The simulation leaves out {'; '.join(left)}."
        warnings.warn(text, DoubtWarning, stacklevel=stacklevel)
