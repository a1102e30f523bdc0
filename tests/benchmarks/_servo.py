"""A position servo on a pendulum with the friction model M1 of BAM, written anew.

M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended friction models for the physics
simulation of servo actuators", ICRA 2025, and the documentation of Rhoban/bam.
"""

from dataclasses import replace

import numba
import numpy as np

# Firmware of the servo: duty cycle of one unit of P gain and one radian, 4096 counts a
# turn, gains in 256ths, 885 of full scale.
DUTY = 4096 / (2 * np.pi) / 256 / 885
MASS, LENGTH, GRAVITY = 0.49, 0.10, 9.81
SUPPLY = 7.4  # nominal [V]
STEPS = 6  # of the physics in a row
# What CMA-ES may change: boxes, on logarithms but for the offset.
BOX = {
    "kt": (0.1, 1.5),
    "R": (1.0, 8.0),
    "armature": (2e-4, 2e-2),
    "q_offset": (-0.1, 0.1),
    "friction_base": (1e-4, 0.1),
    "friction_viscous": (1e-4, 0.1),
}


def prepared(recording):
    """Return the recording as one of goals and gains, and of voltages beside."""
    signals = recording.signals
    volts = signals["duty"] * signals["supply_volts"]
    full = np.abs(DUTY * signals["kp"] * (signals["q_ref"] - recording.q)[:, 0]) >= 1
    return replace(
        recording,
        v=None,
        tau=volts[:, None],
        weight=np.where(full, 0.0, 1.0)[:, None],
        signals={
            "q_desired": signals["q_ref"],
            "kp": (DUTY * signals["kp"] * signals["supply_volts"])[:, None],
            "kd": np.zeros((recording.n_samples, 1)),
            "firmware": signals["kp"],
        },
    )


def nominal(recording):
    """Return the recording at the nominal supply."""
    kp = DUTY * recording.signals["firmware"] * SUPPLY
    return replace(recording, signals={**recording.signals, "kp": kp[:, None]})


@numba.njit(cache=True)
def swing(p, goal, gain, q0, v0, dt):
    """Positions at rows of `dt` [s] from commanded ones, both (n,)."""
    q, v, h = q0, v0, dt / STEPS
    inertia = MASS * LENGTH**2 + p[2]
    found = np.empty(goal.size)
    for k in range(goal.size):
        found[k] = q
        ahead = goal[min(k + 1, goal.size - 1)] - goal[k]
        for step in range(STEPS):
            error = goal[k] + step / STEPS * ahead - q
            duty = min(max(DUTY * gain * error, -1.0), 1.0)
            motor = p[0] / p[1] * (duty * SUPPLY - p[0] * v)
            external = -MASS * GRAVITY * LENGTH * np.sin(q + p[3])
            stop = -(inertia * v / h + motor + external)
            most = p[4] + p[5] * abs(v)
            v += h * (motor + external + min(max(stop, -most), most)) / inertia
            q += h * v
    return found


def voltage(p, q, v, a):
    """Voltages (n,) that a motion needs."""
    external = -MASS * GRAVITY * LENGTH * np.sin(q + p[3])
    friction = np.sign(v) * (p[4] + p[5] * np.abs(v))
    motor = (MASS * LENGTH**2 + p[2]) * a - external + friction
    return p[1] / p[0] * motor + p[0] * v


def swung(p, recording, states, window):
    """Positions (n,) from the goals, in windows [s] from measured states."""
    found, length = np.empty(recording.n_samples), round(window / recording.dt)
    goal, gain = recording.signals["q_desired"][:, 0], recording.signals["firmware"]
    for part in recording.segments:
        for first in range(part.start, part.stop, length):
            rows = slice(first, min(first + length, part.stop))
            state = states[first, :2]
            found[rows] = swing(p, goal[rows], gain[first], *state, recording.dt)
    return found


def fitted(recording, states, evaluations, seed=0):
    """Parameters by CMA-ES on simulated positions, as BAM fits them."""
    import cma

    low, high = np.array(list(BOX.values())).T
    free = np.array([key == "q_offset" for key in BOX])
    goal, gain = recording.signals["q_desired"][:, 0], recording.signals["firmware"]

    def point(x):
        scaled = np.abs(low) * np.abs(high / low) ** x
        return np.where(free, low + x * (high - low), scaled)

    def missed(x):
        total = 0.0
        for part in recording.segments:
            q, v0 = recording.q[part, 0], states[part.start, 1]
            given = gain[part.start], q[0], v0, recording.dt
            total += np.abs(swing(point(x), goal[part], *given) - q).mean()
        return total if np.isfinite(total) else 1e6

    options = {"bounds": [0, 1], "verbose": -9, "seed": seed + 1}
    options |= {"maxfevals": evaluations, "popsize": 20}
    search = cma.CMAEvolutionStrategy(np.full(len(BOX), 0.5), 0.25, options)
    search.optimize(missed)
    return point(search.result.xbest)
