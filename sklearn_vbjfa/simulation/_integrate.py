"""Motion of a robot from its accelerations, through the events of dry friction.

Between events, at which a joint stops, reverses or breaks away, accelerations are
smooth and integrated by the classical Runge-Kutta method of order four. The slope at
the end of a step replaces the last of its four slopes in a formula of order three; the
difference is the error estimate. A step in which a joint's velocity changes its sign is
repeated up to the time of zero velocity, found by the cubic through values and slopes
at both ends. There the joint sticks if dry friction can hold it, and slides otherwise.
If stability of friction or springs would limit the length of steps, they are implicit:
ROS34PW2 of order three with any Jacobian matrix A, here that of friction and springs,
L-stable, with an embedded method of order two (Rang and
Angermann, BIT 45(4), 2005, doi:10.1007/s10543-005-0035-y):

    (1 - gamma h A) k_i = f(t + alpha_i h, y + h sum_j alpha_ij k_j)
        + h A sum_j gamma_ij k_j + gamma_i h f_t,  y(t + h) = y + h sum_i b_i k_i.
"""

from collections import namedtuple

import numpy as np
from scipy.linalg import lapack

# Error of a step, in units of a joint's velocity.
_TOLERANCE, _STIFF_TOLERANCE = 1e-8, 1e-7
# Smallest unit of a joint's velocity in the tolerance [rad/s or m/s].
SLOWEST = 1e-2
# Limits of the change of the step length, and safety factor.
_SHRINK, _GROW, _RESERVE = 0.2, 4.0, 0.9
# Largest product of the length of an explicit step and a decay rate of friction.
_STIFF = 1.0
# Coefficients of the implicit method [1]_.
_GAMMA, _STAGES = 0.435866521508459, 4
_TO = np.array(
    [
        [0.0, 0.0, 0.0],
        [0.87173304301691801, 0.0, 0.0],
        [0.84457060015369423, -0.11299064236484185, 0.0],
        [0.0, 0.0, 1.0],
    ]
)
_MIXED = np.array(
    [
        [0.0, 0.0, 0.0],
        [-0.87173304301691801, 0.0, 0.0],
        [-0.90338057013044082, 0.054180672388095326, 0.0],
        [0.24212380706095346, -1.2232505839045147, 0.54526025533510214],
    ]
)
_WEIGHTS = np.array(
    [0.24212380706095346, -1.2232505839045147, 1.545260255335102, 0.435866521508459]
)
_LOWER = np.array(
    [0.37810903145819369, -0.096042292212423178, 0.5, 0.21793326075422950]
)
# Shortest step, as a share of the sample period, and largest number of steps in it.
_SHORTEST, _MOST_STEPS = 1e-12, 1000
# Velocity that no joint reaches [rad/s or m/s]: the motion has diverged.
_RUNAWAY = 1e4
# A joint that stops more often within a sample period sticks until its end.
_MOST_STOPS = 20
# A joint breaks away if the needed friction exceeds its limit by the first share; the
# second is the tolerance of this event.
_MARGIN, _EVENT_TOLERANCE = 1e-9, 1e-6
# Constants of compiled steps.
_RULES = _STIFF, _TOLERANCE, _RESERVE, _SHRINK, _GROW, 1 + _MARGIN, _EVENT_TOLERANCE
# Largest number of steps in the search for an event, and of changes of joints between
# sticking and sliding at one instant.
_MOST_TRIES, _MOST_PIVOTS = 12, 100


class Diverged(ArithmeticError):
    """The motion diverges: time [s] after the last sample, joint."""


# State at the start or end of a step: time, velocities, and `StateSolution`.
_StepEnd = namedtuple("_StepEnd", "time v solution")


class Integrator:
    """A robot in motion: its state under true torques tau (nv,) at a time t [s]."""

    # a (nv,): accelerations.

    def __init__(self, dynamics, q, v, tau, t):
        self._dynamics = dynamics
        self._steps = dynamics.compiled
        nv = q.size
        self.q, self.v = q.copy(), v.copy()
        self._mode = np.where(dynamics.terms.has_dry, np.sign(v), 0.0)
        self._stuck = np.zeros(nv, dtype=bool)
        # Joints whose reversals are events.
        terms = dynamics.terms
        self._watched = terms.has_dry | terms.has_memory | terms.has_kink
        self._direction = np.sign(v)
        self._fast = np.maximum(np.abs(v), SLOWEST)
        self._zero_speed = _TOLERANCE * self._fast
        self._step, self.steps = np.inf, 0
        self._stops, self._stops_often = np.zeros(nv, dtype=int), False
        self._time, self._compiles = t, not terms.is_timed
        dynamics.start(self.q)
        self.settle(tau)

    def _evaluate(self, q, v, tau, ahead=0.0):
        """Compute accelerations at a state, `ahead` seconds after the present one."""
        self._dynamics.set_time(self._time + ahead)
        return self._dynamics.accelerate(q, v, tau, self._mode, self._stuck)

    def settle(self, tau):
        # A linear complementarity problem. Repeatedly changing the first joint that
        # neither sticks within its limit nor slides the way it accelerates ends at the
        # one solution (Judice and Pires, Computers & Operations Research 21(5), 1994,
        # doi:10.1016/0305-0548(94)90106-6).
        dynamics = self._dynamics
        at_rest = dynamics.terms.has_dry & ((self.v == 0) | self._stuck)
        self.v[at_rest] = 0.0
        self._mode[at_rest] = 0.0
        self._stuck[:] = at_rest
        free = at_rest & (self._stops <= _MOST_STOPS)
        a = self._evaluate(self.q, self.v, tau)
        for _ in range(_MOST_PIVOTS if free.any() else 0):
            result = dynamics.solution
            loose = self._stuck & (np.abs(result.needed) > (1 + _MARGIN) * result.limit)
            wrong = free & (loose | (a * self._mode < 0))
            if not wrong.any():
                break
            j = int(np.argmax(wrong))
            self._mode[j] = np.sign(result.needed[j]) if self._stuck[j] else 0.0
            self._stuck[j] = self._mode[j] == 0
            a = self._evaluate(self.q, self.v, tau)
        self._arrive(a)

    def _arrive(self, a):
        self._direction = self._steps.directions(self.v, a)
        self._begin_here()

    def _begin_here(self):
        dynamics = self._dynamics
        self.a, self._last = dynamics.solution.a, (dynamics.values, dynamics.mass)
        self._begin = _StepEnd(0.0, self.v, dynamics.solution)

    def advance(self, tau, after, dt):
        """Advance by a sample period, while torques change linearly to `after`."""
        # Raises Diverged if values are not finite, or steps become too short.
        rate = (after - tau) / dt
        if self._stops_often:
            was_held = (self._stops > _MOST_STOPS).any()
            self._stops[:], self._stops_often = 0, False
            if was_held:
                self.settle(tau)
        start, elapsed, shortest = self._time, 0.0, _SHORTEST * dt
        for _ in range(_MOST_STEPS if np.abs(self.v).max() < _RUNAWAY else 0):
            left = dt - elapsed
            if not left > shortest:
                self._time = start + dt
                return
            if self._compiles:
                elapsed = self._smooth(tau, rate, (elapsed, dt, shortest))
                left = dt - elapsed
                if not left > shortest:
                    continue
            self._time = start + elapsed
            h = left if self._step >= left else min(self._step, 0.5 * left)
            length, new = self._attempt(tau + elapsed * rate, rate, max(h, shortest))
            if new is not None:
                elapsed += length
                self._time = start + elapsed
                self._accept(new, tau + elapsed * rate)
            elif h <= shortest:
                break
        raise Diverged(elapsed, int(np.argmax(np.abs(self.v))))

    def _smooth(self, tau, rate, span):
        """Advance by compiled steps up to an event; return the time reached."""
        state = self.q, self.v, *self._last, self._step, span, tau, rate
        joints = self._mode, self._stuck, self._held(), self._watched, self._direction
        result = self._dynamics.smooth_steps(*state, *joints, self._fast, _RULES)
        self.q, self.v, time, self._step, self._direction, count = result
        if count:
            np.multiply(_TOLERANCE, self._fast, out=self._zero_speed)
            self.steps += count
            self._begin_here()
        return time

    # -- one step ----------------------------------------------------------------------

    def _attempt(self, tau, rate, h):
        """Try a step of length h, or to its first event; return length and result."""
        # The result is None if the error is too large: the next step is shorter.
        dynamics, requested = self._dynamics, h
        slopes = dynamics.solution.by_position, dynamics.solution.by_velocity
        # Explicit steps do not include effects that change with time.
        stiff = dynamics.terms.is_timed or self._steps.is_stiff(
            h, dynamics.mass, *slopes, self._stuck, _STIFF
        )
        method = self._implicit if stiff else self._explicit
        before, after, joints = self._begin, None, None
        for tries in range(1, _MOST_TRIES + 1):
            q, v, a, error = method(tau, rate, h)
            grown = _RESERVE * max(error, 1e-12) ** (-1.0 / 3.0 if stiff else -0.25)
            if not error <= 1:
                self._step = h * (max(grown, _SHRINK) if grown < 1 else _SHRINK)
                return 0.0, None
            excess = self._event_excess(v)
            passed = excess.max() > 0
            if not passed:
                if after is None:
                    hit = None
                    break
                hit = joints & ~self._stuck & (excess >= -1)
            else:
                hit = excess > 0
            if hit.any() and (excess <= 1).all():
                break
            end = _StepEnd(h, v, dynamics.solution)
            if passed:
                after, joints = end, hit
            else:
                before = end
            if tries < _MOST_TRIES:
                h = self._first_event(before, after, joints)
        next_step = h * min(grown, _GROW)
        if h < requested or self._step > requested:
            # The step was limited by an event, or by the end of the sample period.
            next_step = max(next_step, self._step)
        self._step = next_step
        return h, (q, v, a, hit)

    def _accept(self, new, tau):
        self.q, self.v, a, hit = new
        # Without this, rounding would leave a nonzero velocity.
        self.v[self._stuck] = 0.0
        self.steps += 1
        np.maximum(self._fast, np.abs(self.v), out=self._fast)
        np.multiply(_TOLERANCE, self._fast, out=self._zero_speed)
        self._dynamics.remember(self.q, self.v)
        if hit is None:
            self._arrive(a)
            return
        turned = hit & ~self._stuck
        self.v[turned] = 0.0
        self._stops += turned
        self._stops_often = True
        self.settle(tau)

    def _explicit(self, tau, rate, h):
        state, modes = (self.q, self.v, self.a, tau, rate, h), (self._mode, self._stuck)
        return self._dynamics.explicit_step(*state, *modes, self._fast, _TOLERANCE)

    def _implicit(self, tau, rate, h):
        robot, stuck = self._dynamics, self._stuck
        q, v, a = self.q, self.v, self.a
        # Jacobian and inertia matrix are those at the start of the step.
        self._evaluate(q, v, tau)
        M = robot.mass.copy()
        D, K = robot.solution.by_velocity.copy(), robot.solution.by_position.copy()
        g = _GAMMA * h
        W = M + np.diag(g * D + g * g * K)
        free = np.flatnonzero(~stuck)
        lu, pivots, _ = lapack.dgetrf(W[np.ix_(free, free)])
        k = np.zeros((_STAGES, 2, q.size))
        for i, (to, mixed) in enumerate(zip(_TO, _MIXED)):
            if i:
                y, z = (q, v) + h * np.tensordot(to[:i], k[:i], 1)
                share = to.sum()
                a = self._evaluate(y, z, tau + share * h * rate, share * h)
            else:
                z = v
            sq, sv = h * np.tensordot(mixed[:i], k[:i], 1) if i else np.zeros((2, 1))
            fq = z + sv
            late = h * (mixed.sum() + _GAMMA) * rate
            rhs = M @ a - K * sq - D * sv + late - g * K * fq
            if free.size:
                k[i, 1, free] = lapack.dgetrs(lu, pivots, rhs[free])[0]
            k[i, 0] = np.where(stuck, 0.0, fq + g * k[i, 1])
        q, v = (q, v) + h * np.tensordot(_WEIGHTS, k, 1)
        error_v = h * np.tensordot(_WEIGHTS - _LOWER, k[:, 1], 1)
        a = self._evaluate(q, v, tau + h * rate, h)
        scale = _STIFF_TOLERANCE * np.maximum(self._fast, h * np.abs(self.a))
        return q, v, a, float((np.abs(error_v) / scale).max())

    def _held(self):
        """Joints (nv,), bool, that stick until they break away."""
        return self._stuck & (self._stops <= _MOST_STOPS)

    def _event_excess(self, v):
        """Distance of joints past events, relative to the tolerance, (nv,)."""
        needed, limit = self._dynamics.solution.needed, self._dynamics.solution.limit
        reversals = self._watched, self._direction, v, self._zero_speed
        breakaways = self._held(), needed, limit, 1 + _MARGIN, _EVENT_TOLERANCE
        return self._steps.event_excess(*reversals, *breakaways)

    def _first_event(self, before, after, joints):
        width, shares = after.time - before.time, []
        for j in np.flatnonzero(joints):
            if self._stuck[j]:
                start, end = before.solution, after.solution
                under = (1 + _MARGIN) * start.limit[j] - abs(start.needed[j])
                over = abs(end.needed[j]) - end.limit[j]
                # A little later, so that the joint has broken away.
                later = 0.5 * _EVENT_TOLERANCE * end.limit[j]
                shares.append((max(under, 0.0) + later) / (max(under, 0.0) + over))
            else:
                slopes = width * before.solution.a[j], width * after.solution.a[j]
                shares.append(_root(before.v[j], after.v[j], *slopes))
        return before.time + width * min(max(min(shares), 1e-9), 1.0)


def _root(v0, v1, a0, a1):
    """First zero in (0, 1] of the cubic with these values and slopes at 0 and 1."""
    # The signs of the values differ, or the first is zero.
    c3, c2 = 2 * (v0 - v1) + a0 + a1, 3 * (v1 - v0) - 2 * a0 - a1
    low, high = 0.0, 1.0
    sign = np.sign(v1)
    for _ in range(60):
        middle = 0.5 * (low + high)
        if sign * (((c3 * middle + c2) * middle + a0) * middle + v0) > 0:
            high = middle
        else:
            low = middle
    return high
