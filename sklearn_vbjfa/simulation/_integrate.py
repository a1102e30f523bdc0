"""Motion of a robot from its accelerations, through the events of dry friction.

Between events, at which a joint stops, turns round or breaks loose, accelerations are
smooth, and classical Runge-Kutta steps of order four follow them. The slope at the end
of a step replaces the last of its four slopes in a formula of order three; the
difference is the error estimate. A step in which a joint's velocity changes its sign is
done again up to the time when it is zero, by the cubic through its values and slopes at
both ends. There the joint sticks if dry friction can hold it, and slides on otherwise.
Where friction or a stiffness is so steep that steps would be short for stability alone,
they are implicit: ROS34PW2 of order three with any Jacobian matrix A, here that of
friction and springs, L-stable, with an embedded method of order two (Rang and
Angermann, BIT 45(4), 2005, doi:10.1007/s10543-005-0035-y):

    (1 - gamma h A) k_i = f(t + alpha_i h, y + h sum_j alpha_ij k_j)
        + h A sum_j gamma_ij k_j + gamma_i h f_t,  y(t + h) = y + h sum_i b_i k_i.
"""

from collections import namedtuple

import numpy as np
from scipy.linalg import lapack

# Error of a step, in units of a joint's velocity.
_TOLERANCE, _STIFF_TOLERANCE = 1e-8, 1e-7
# A joint's velocity counts as at least this [rad/s or m/s], for the tolerance.
SLOWEST = 1e-2
# The step may shrink and grow by these factors, with some reserve.
_SHRINK, _GROW, _RESERVE = 0.2, 4.0, 0.9
# Steps are implicit from this product of their length and a friction's decay rate on.
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
# Shortest step, as a share of the sample period, and most steps in it.
_SHORTEST, _MOST_STEPS = 1e-12, 20_000
# Velocity that no joint reaches [rad/s or m/s]: the motion has diverged.
_RUNAWAY = 1e4
# So many times a joint may stop within a sample period; then it sticks until its end.
_MOST_STOPS = 20
# Beyond what holds a joint by this share it breaks loose, which is found to this share.
_HOLDS, _LOOSE = 1e-9, 1e-6
# Rules of compiled steps.
_RULES = (_STIFF, _TOLERANCE, _RESERVE, _SHRINK, _GROW, 1 + _HOLDS, _LOOSE)
# Most steps in search of one event, and most changes of joints between sticking and
# sliding at one instant.
_MOST_TRIES, _MOST_PIVOTS = 12, 100


class Diverged(ArithmeticError):
    """The motion cannot be followed: time [s] after the last sample, joint."""


# State at an end of a step: its time, velocities, and what was found.
_End = namedtuple("_End", "time v found")


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
        # Joints whose turns are events.
        terms = dynamics.terms
        self._watched = terms.has_dry | terms.remembers | terms.bends
        self._way = np.sign(v)
        self._fast = np.maximum(np.abs(v), SLOWEST)
        self._exact = _TOLERANCE * self._fast
        self._step, self.steps = np.inf, 0
        self._stops, self._stops_often = np.zeros(nv, dtype=int), False
        self._time, self._compiles = t, not terms.is_timed
        dynamics.start(self.q)
        self.settle(tau)

    def _evaluate(self, q, v, tau, ahead=0.0):
        """Accelerations at a state, some time ahead of the present one."""
        self._dynamics.set_time(self._time + ahead)
        return self._dynamics.accelerate(q, v, tau, self._mode, self._stuck)

    def settle(self, tau):
        # A linear complementarity problem. Changing the first joint that neither sticks
        # within its limit nor slides the way it is pushed, again and again, ends at the
        # one solution (Judice and Pires, Computers & Operations Research 21(5), 1994,
        # doi:10.1016/0305-0548(94)90106-6).
        own = self._dynamics
        at_rest = own.terms.has_dry & ((self.v == 0) | self._stuck)
        self.v[at_rest] = 0.0
        self._mode[at_rest] = 0.0
        self._stuck[:] = at_rest
        free = at_rest & (self._stops <= _MOST_STOPS)
        a = self._evaluate(self.q, self.v, tau)
        for _ in range(_MOST_PIVOTS if free.any() else 0):
            found = own.found
            loose = self._stuck & (np.abs(found.needed) > (1 + _HOLDS) * found.limit)
            wrong = free & (loose | (a * self._mode < 0))
            if not wrong.any():
                break
            j = int(np.argmax(wrong))
            self._mode[j] = np.sign(found.needed[j]) if self._stuck[j] else 0.0
            self._stuck[j] = self._mode[j] == 0
            a = self._evaluate(self.q, self.v, tau)
        self._arrive(a)

    def _arrive(self, a):
        self._way = self._steps.directions(self.v, a)
        self._begin_here()

    def _begin_here(self):
        own = self._dynamics
        self.a, self._known = own.found.a, (own.values, own.mass)
        self._begin = _End(0.0, self.v, own.found)

    def advance(self, tau, after, dt):
        """Go on for a sample period, in which torques go from `tau` to `after`."""
        # Diverged if the numbers do not stay finite, or steps become ever shorter.
        rate = (after - tau) / dt
        if self._stops_often:
            barred = (self._stops > _MOST_STOPS).any()
            self._stops[:], self._stops_often = 0, False
            if barred:
                self.settle(tau)
        start, done, shortest = self._time, 0.0, _SHORTEST * dt
        for _ in range(_MOST_STEPS if np.abs(self.v).max() < _RUNAWAY else 0):
            left = dt - done
            if not left > shortest:
                self._time = start + dt
                return
            if self._compiles:
                done = self._smooth(tau, rate, (done, dt, shortest))
                left = dt - done
                if not left > shortest:
                    continue
            self._time = start + done
            h = left if self._step >= left else min(self._step, 0.5 * left)
            taken, new = self._attempt(tau + done * rate, rate, max(h, shortest))
            if new is not None:
                done += taken
                self._time = start + done
                self._accept(new, tau + done * rate)
            elif h <= shortest:
                break
        raise Diverged(done, int(np.argmax(np.abs(self.v))))

    def _smooth(self, tau, rate, span):
        """Go on by compiled steps while nothing happens; the time that is reached."""
        state = self.q, self.v, *self._known, self._step, span, tau, rate
        joints = self._mode, self._stuck, self._barred(), self._watched, self._way
        found = self._dynamics.smooth_steps(*state, *joints, self._fast, _RULES)
        self.q, self.v, done, self._step, self._way, count = found
        if count:
            np.multiply(_TOLERANCE, self._fast, out=self._exact)
            self.steps += count
            self._begin_here()
        return done

    # -- one step ----------------------------------------------------------------------

    def _attempt(self, tau, rate, h):
        """Try a step of length h, or to its first event; its length and result."""
        # There is no result where the error is too large: the next step is shorter.
        own, asked = self._dynamics, h
        slopes = own.found.by_position, own.found.by_velocity
        # Explicit steps know nothing of what changes with time.
        stiff = own.terms.is_timed or self._steps.is_stiff(
            h, own.mass, *slopes, self._stuck, _STIFF
        )
        method = self._implicit if stiff else self._explicit
        before, after, joints = self._begin, None, None
        for tries in range(1, _MOST_TRIES + 1):
            q, v, a, error = method(tau, rate, h)
            grown = _RESERVE * max(error, 1e-12) ** (-1.0 / 3.0 if stiff else -0.25)
            if not error <= 1:
                self._step = h * (max(grown, _SHRINK) if grown < 1 else _SHRINK)
                return 0.0, None
            past = self._past(v)
            beyond = past.max() > 0
            if not beyond:
                if after is None:
                    hit = None
                    break
                hit = joints & ~self._stuck & (past >= -1)
            else:
                hit = past > 0
            if hit.any() and (past <= 1).all():
                break
            end = _End(h, v, own.found)
            if beyond:
                after, joints = end, hit
            else:
                before = end
            if tries < _MOST_TRIES:
                h = self._first_event(before, after, joints)
        next_step = h * min(grown, _GROW)
        if h < asked or self._step > asked:
            # It was short for an event, or for the end of the sample period.
            next_step = max(next_step, self._step)
        self._step = next_step
        return h, (q, v, a, hit)

    def _accept(self, new, tau):
        self.q, self.v, a, hit = new
        # Rounding of zero would be a velocity, and not at rest.
        self.v[self._stuck] = 0.0
        self.steps += 1
        np.maximum(self._fast, np.abs(self.v), out=self._fast)
        np.multiply(_TOLERANCE, self._fast, out=self._exact)
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
        own, stuck = self._dynamics, self._stuck
        q, v, a = self.q, self.v, self.a
        # The Jacobian matrix and the masses are those of the beginning.
        self._evaluate(q, v, tau)
        M = own.mass.copy()
        D, K = own.found.by_velocity.copy(), own.found.by_position.copy()
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

    def _barred(self):
        """Joints (nv,), bool, that stick until their friction gives way."""
        if not self._stops_often:
            return self._stuck
        return self._stuck & (self._stops <= _MOST_STOPS)

    def _past(self, v):
        """How far joints are past events, in units of what they may be (nv,)."""
        own = self._dynamics
        return self._steps.past_events(
            self._watched,
            self._way,
            v,
            self._exact,
            self._barred(),
            own.found.needed,
            own.found.limit,
            1 + _HOLDS,
            _LOOSE,
        )

    def _first_event(self, before, after, joints):
        width, shares = after.time - before.time, []
        for j in np.flatnonzero(joints):
            if self._stuck[j]:
                one, other = before.found, after.found
                under = (1 + _HOLDS) * one.limit[j] - abs(one.needed[j])
                over = abs(other.needed[j]) - other.limit[j]
                # A little later, so that it is loose.
                later = 0.5 * _LOOSE * other.limit[j]
                shares.append((max(under, 0.0) + later) / (max(under, 0.0) + over))
            else:
                slopes = width * before.found.a[j], width * after.found.a[j]
                shares.append(_root(before.v[j], after.v[j], *slopes))
        return before.time + width * min(max(min(shares), 1e-9), 1.0)


def _root(v0, v1, a0, a1):
    """First zero in (0, 1] of the cubic with these values and slopes at 0 and 1."""
    # The signs of the values differ, or the first is zero.
    c3, c2 = 2 * (v0 - v1) + a0 + a1, 3 * (v1 - v0) - 2 * a0 - a1
    low, high = 0.0, 1.0
    way = np.sign(v1)
    for _ in range(60):
        middle = 0.5 * (low + high)
        if way * (((c3 * middle + c2) * middle + a0) * middle + v0) > 0:
            high = middle
        else:
            low = middle
    return high
