"""Motion of the two-link arm by SciPy's solvers and literal friction laws.

Independent of the simulator: rigid-body dynamics are those of `Arm` in closed form,
and times at which joints stop or break loose are events of `solve_ivp`.
"""

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

from tests.simulation._machines import Arm

NONE = np.zeros(2)


@dataclass
class Law:
    """Torques of the arm's drives in addition to those of the rigid bodies.

    smooth : (q, v, t) -> (2,); dry : (v, t) -> (2,), levels of dry friction; mu :
    load-dependent friction coefficients (2,); inertia : (2, 2); turned : (joint, q),
    called at reversals of a joint.
    """

    smooth: object = lambda q, v, t: NONE
    dry: object = lambda v, t: NONE
    sticks: tuple = (False, False)
    watched: tuple = (False, False)
    mu: np.ndarray = field(default_factory=lambda: np.zeros(2))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((2, 2)))
    turned: object = lambda joint, q: None


def accelerations(law, torque, q, v, t, way, stuck):
    """Return accelerations, required friction and its limits, (2,) each."""
    arm = Arm()
    M, h = arm.mass(q), arm.bias(q, v)
    dry, smooth = law.dry(v, t), law.smooth(q, v, t)
    moving = np.where(stuck, 0.0, way)
    free = ~stuck
    for signs in itertools.product((1.0, -1.0), repeat=2):
        pressed = np.eye(2) + np.diag(law.mu * moving * signs)
        A = pressed @ M + law.inertia
        b = torque(t) - pressed @ h - smooth - dry * moving
        a = np.zeros(2)
        a[free] = np.linalg.solve(A[np.ix_(free, free)], b[free])
        load = M @ a + h
        if (signs * load >= -1e-9).all():
            return a, b - A @ a, dry + law.mu * np.abs(load)
    raise AssertionError("no signs of the loads fit")


def rests(law, torque, y, t, way):
    """Find directions and sticking of joints at rest by enumeration, (2,) each."""
    q, v = y[:2], y[2:]
    still = np.array(law.sticks) & (v == 0)
    choices = [(-1.0, 0.0, 1.0) if s else (w,) for s, w in zip(still, way)]
    for modes in itertools.product(*choices):
        modes = np.array(modes)
        stuck = still & (modes == 0)
        a, needed, limit = accelerations(law, torque, q, v, t, modes, stuck)
        held = np.abs(needed) <= limit * (1 + 1e-9) + 1e-12
        if np.where(stuck, held, ~still | (a * modes > 0)).all():
            return np.where(still | (v != 0), modes, np.sign(a)), stuck
    raise AssertionError("no modes fit")


def follow(law, torque, q0, v0, t):
    """Return the states [q | v | a] (n, 6) at times t."""
    y = np.array([*q0, *v0], dtype=float)
    way, stuck = rests(law, torque, y, t[0], np.sign(v0))
    at, out, row = t[0], np.empty((len(t), 6)), 0
    watched = np.array(law.sticks) | np.array(law.watched)
    while row < len(t):

        def rhs(t, x, way=way, stuck=stuck):
            a, _, _ = accelerations(law, torque, x[:2], x[2:], t, way, stuck)
            return [*np.where(stuck, 0.0, x[2:]), *a]

        def event(j, way=way, stuck=stuck):
            def turns(t, x):
                return x[2 + j] * way[j]

            def loosens(t, x):
                state = x[:2], x[2:], t, way, stuck
                _, needed, limit = accelerations(law, torque, *state)
                return limit[j] * (1 + 1e-7) - abs(needed[j])

            found = loosens if stuck[j] else turns
            found.terminal, found.direction = True, -1
            return found

        events = [event(j) for j in range(2) if watched[j]]
        joints = np.flatnonzero(watched)
        wanted = t[row:]
        found = solve_ivp(
            rhs,
            (at, t[-1] + 1e-9),
            y,
            method="DOP853",
            events=events,
            dense_output=True,
            rtol=1e-11,
            atol=1e-12,
        )
        assert found.success, found.message
        end = found.t[-1]
        for sample in wanted[wanted < end]:
            state = found.sol(sample)
            state[2:4][stuck] = 0.0
            out[row] = [*state[:4], *rhs(sample, state)[2:4]]
            row += 1
        y, at = found.y[:, -1].copy(), end
        y[2:4][stuck] = 0.0
        for j, times in zip(joints, found.t_events or ()):
            if len(times) and not stuck[j]:
                y[2 + j] = 0.0
                law.turned(j, y[:2])
        if row < len(t):
            way, stuck = rests(law, torque, y, at, np.where(y[2:4] == 0, 0, way))
    return out
