"""The best motion within limits, by gradients: augmented Lagrangian over L-BFGS.

SciPy's solvers for constraints (SLSQP, trust-constr) keep matrices of all constraints:
a limit at every sample of every joint makes some ten thousand of them. The augmented
Lagrangian (Nocedal and Wright, Numerical optimization, 2006, chapter 17) needs one
number for each, and unconstrained steps, which L-BFGS-B does.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from sklearn_vbjfa._core._progress import say, stage
from sklearn_vbjfa.design._criterion import information_of, worth

# Motions are kept this far inside the limits while they are improved: between samples
# they go a little further, and a margin is to be left.
INSIDE = 0.97
# Rounds of multipliers, steps in each, and the factor between penalties.
_ROUNDS, _STEPS, _HARDER = 7, 45, 3.0
# Rounds in which limits are kept between the samples as well, with this to spare.
_MORE_ROUNDS, _SPARE = 4, 1e-3
# By how much a motion is made smaller, step by step.
_GAPS = 1e-4 * 1.6 ** np.arange(20)
# Penalty at first: an excess of one per cent at one sample costs this much [nats].
_FIRST_COST = 0.02
# Distances between bodies are looked at in every so many samples.
_SKIPPED = 2
# Excess over a limit that is left to the last shrinking, relative.
_TOLERATED = 2e-3


@dataclass(frozen=True, eq=False)
class Problem:
    """A motion to be designed."""

    curve: object
    model: object
    questions: object
    limits: object
    # (n_columns,): for the torques; zero of effects not known to be there
    coefficients: np.ndarray
    # (nv,): independent samples per second over the variance of a joint's noise
    precision: np.ndarray
    still: np.ndarray  # (nv,): speeds below which a joint may be standing
    clearance: object = None
    room: float = 0.0  # smallest distance that is allowed [m]

    def times(self, per_period=16):
        """Return samples [s], so many in the shortest period."""
        n = per_period * self.curve.n_harmonics
        return np.arange(n) * (self.curve.period / n)

    def weights(self, states, step):
        """Weights of rows (n, nv), and their derivatives by the velocities."""
        # Equations of a joint that stands are left out of a fit: friction may be
        # anywhere in its band.
        v = np.split(states, 3, axis=1)[1]
        slow = self.still**2
        moving = v**2 / (v**2 + slow)
        scale = self.precision * step
        return scale * moving, scale * 2 * v * slow / (v**2 + slow) ** 2

    def information(self, states, step):
        """Information matrix of states (n, 3 nv), `step` seconds apart."""
        weight, _ = self.weights(states, step)
        return information_of(
            self.model(states), self.model.places, self.model.n_columns, weight
        )

    def torques(self, equations):
        """Torques (n, nv) of the model."""
        return np.column_stack(
            [
                self._own(place) @ rows
                for rows, place in zip(equations.rows, self.model.places)
            ]
        )

    def _own(self, place):
        """Coefficients of the columns of a joint; zero of those not known."""
        known = np.zeros(self.model.n_columns)
        known[: self.coefficients.size] = self.coefficients
        return known[place]


def excess(problem, states, torques, inside=INSIDE):
    """How far limits are exceeded, relative: a list of (n, nv) for each side."""
    # Each with its slope: what it gains by one unit of the signal. Kept are shares
    # `inside` of the limits: one, or of each of the four and each joint, (4, nv).
    limits = problem.limits
    shares = np.broadcast_to(inside, (4, len(limits.velocity)))
    q, v, a = np.split(states, 3, axis=1)
    low, high = limits.position.T
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if problem.curve.start is not None:
        # A start near an end of the range keeps the margin that it has.
        reach = np.abs(problem.curve.start - middle)
        half = np.maximum(half, np.minimum(reach, half) / shares[0])
    found = []
    for signal, centre, size, share in (
        (q, middle, half, shares[0]),
        (v, 0.0, limits.velocity, shares[1]),
        (a, 0.0, limits.acceleration, shares[2]),
        (torques, 0.0, limits.torque, shares[3]),
    ):
        scaled = (signal - centre) / (share * size)
        slope = 1.0 / (share * size)
        found.append((scaled - 1.0, slope))
        found.append((-scaled - 1.0, -slope))
    return found


class Lagrangian:
    """Augmented Lagrangian of a problem, with its gradient."""

    def __init__(self, problem):
        self.problem = problem
        self.t = problem.times()
        self.step = self.t[1]
        self.basis = problem.curve.basis(self.t)
        self.inside = np.full((4, problem.model.nv), INSIDE)
        self.multipliers = None
        self.penalty = 2 * _FIRST_COST / 1e-4
        self.shape = (problem.model.nv, problem.curve.size)

    def states(self, z):
        return self.problem.curve.states(z.reshape(self.shape), self.basis)

    def __call__(self, x):
        """Return value and gradient of what is to be made small."""
        problem = self.problem
        z = x.reshape(self.shape)
        states = problem.curve.states(z, self.basis)
        nv = self.shape[0]
        equations = problem.model(states, self.t)
        weight, by_speed = problem.weights(states, self.step)
        places = problem.model.places
        M = information_of(equations, places, problem.model.n_columns, weight)
        judged = worth(M, problem.questions)
        value = -judged.value
        by_rows, by_states = [], np.zeros_like(states)
        for j, (rows, place) in enumerate(zip(equations.rows, places)):
            G = judged.by_information[np.ix_(place, place)] @ rows
            by_rows.append(-2 * G * weight[:, j])
            by_states[:, nv + j] -= (rows * G).sum(axis=0) * by_speed[:, j]
        torques = problem.torques(equations)
        cost, by_signals = self._penalised(states, torques)
        value += cost
        by_states += by_signals[:, : 3 * nv]
        by_torque = by_signals[:, 3 * nv :]
        for j, place in enumerate(places):
            by_rows[j] += np.outer(problem._own(place), by_torque[:, j])
        if problem.clearance is not None:
            cost, by_q = self._near(states[:, :nv])
            value += cost
            by_states[:, :nv] += by_q
        more, by_z = problem.model.pulled_back(
            equations, by_rows, problem.curve, z, self.basis
        )
        gradient = problem.curve.pulled_back(by_states + more, self.basis) + by_z
        return value, gradient.ravel()

    def _penalised(self, states, torques):
        """Cost of the limits, and its derivative by states and torques (n, 4 nv)."""
        found = excess(self.problem, states, torques, self.inside)
        if self.multipliers is None:
            self.multipliers = [np.zeros_like(g) for g, _ in found]
        cost, by = 0.0, [0.0] * 4
        for k, ((g, slope), multiplier) in enumerate(zip(found, self.multipliers)):
            pressed = np.maximum(multiplier + self.penalty * g, 0.0)
            cost += ((pressed**2 - multiplier**2) / (2 * self.penalty)).sum()
            by[k // 2] = by[k // 2] + pressed * slope
        return cost, np.hstack(by)

    def _near(self, q):
        """Cost of bodies that come too near each other, and its derivative by q."""
        clearance = self.problem.clearance
        rows = slice(None, None, _SKIPPED)
        room = self.problem.room / INSIDE
        found = clearance(q[rows], within=room + clearance.near)
        g = np.maximum(room - found.distance, 0.0) / clearance.near
        weight = _SKIPPED * self.penalty
        by = np.zeros_like(q)
        by[rows] = -weight / clearance.near * np.einsum("np,npj->nj", g, found.gradient)
        return 0.5 * weight * (g**2).sum(), by

    def tighten(self, x):
        """Raise multipliers and penalty; return the largest excess."""
        states = self.states(x)
        torques = self.problem.torques(self.problem.model(states, self.t))
        worst = 0.0
        found = excess(self.problem, states, torques, self.inside)
        for k, (g, _) in enumerate(found):
            self.multipliers[k] = np.maximum(
                self.multipliers[k] + self.penalty * g, 0.0
            )
            worst = max(worst, float(g.max(initial=0.0)))
        self.penalty *= _HARDER
        return worst

    def keep_between(self, x, fine, inside):
        """Keep back what samples in between, at times `fine`, need of the limits."""
        # Returns by how much they exceed the share `inside` of the limits.
        problem = self.problem
        basis = problem.curve.basis(fine)
        states = problem.curve.states(x.reshape(self.shape), basis)
        torques = problem.torques(problem.model(states, fine))
        sides = [g for g, _ in excess(problem, states, torques, inside)]
        over = np.maximum(np.max(sides[::2], axis=1), np.max(sides[1::2], axis=1))
        self.inside /= 1.0 + np.where(over > 0, over + _SPARE, 0.0)
        return over.max()


def optimise(problem, starts, fine, inside):
    """Improve motions, coordinates (nv, size) each, and the best of them to the end."""
    # At the times `fine`, many more than those of the design, it keeps the share
    # `inside` of the limits, which it may exceed by a trace: see `shrunk`. Returns its
    # coordinates and the motion that it was improved from.
    most = len(starts) + _ROUNDS - 1 + _MORE_ROUNDS
    with stage("improving", most, "rounds") as step:
        return _optimised(problem, starts, fine, inside, step)


def _optimised(problem, starts, fine, inside, step):
    """Improve as `optimise` does, and count the rounds."""
    tried = []
    for z in starts:
        say(f"start {len(tried) + 1}")
        lagrangian = Lagrangian(problem)
        x, value = _improved(lagrangian, np.array(z, dtype=float).ravel())
        tried.append((value, len(tried), x, lagrangian))
        step()
    _, best, x, lagrangian = min(tried, key=lambda one: one[:2])
    lagrangian.tighten(x)
    before = np.inf
    for _ in range(_ROUNDS - 1):
        say("within the limits")
        x, value = _improved(lagrangian, x)
        worst = lagrangian.tighten(x)
        step()
        settled = abs(before - value) < 0.05
        before = value
        if worst < _TOLERATED and settled:
            break
    # Where friction turns round at the load's peak, torques jump between samples.
    for _ in range(_MORE_ROUNDS):
        say("between the samples")
        if lagrangian.keep_between(x, fine, inside) <= 0.0:
            break
        x, _ = _improved(lagrangian, x)
        lagrangian.tighten(x)
        step()
    return x.reshape(lagrangian.shape), starts[best]


def _improved(lagrangian, x):
    """Return the result of one round and its value."""
    found = minimize(
        lagrangian,
        x,
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": _STEPS, "maxcor": 20},
    )
    return found.x, found.fun


def shrunk(problem, z, t, inside, *, apart=True):
    """Scale a motion until it keeps all limits at the times t."""
    # It is scaled about its start if that is given, else about the pose in it that is
    # furthest from the limits. With `apart` its bodies keep their distance as well.
    basis = problem.curve.basis(t)
    about = _roomiest(problem, z, basis)

    def keeps(factor):
        states = problem.curve.states(_scaled(problem, z, factor, about), basis)
        torques = problem.torques(problem.model(states, t))
        over = max(
            float(g.max(initial=-1.0))
            for g, _ in excess(problem, states, torques, inside)
        )
        if over <= 1e-9 and apart and problem.clearance is not None:
            q = states[:, : problem.model.nv]
            over = 1.0 - problem.clearance.smallest(q) / problem.room
        return over <= 1e-9

    if keeps(1.0):
        return z
    # A smaller motion may take a larger torque, nearer to a pose that is hard to hold:
    # the largest factor is looked for from above.
    high = 1.0
    for gap in _GAPS:
        low = 1.0 - gap
        if keeps(low):
            break
        high = low
    else:
        low = 0.0
    for _ in range(6):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return _scaled(problem, z, low, about)


def _roomiest(problem, z, basis):
    """Pose (nv,) of a motion at rest in which it is furthest from its limits."""
    if problem.curve.start is not None:
        return problem.curve.start
    states = problem.curve.states(z, basis)
    states[:, problem.model.nv :] = 0.0
    torques = problem.torques(problem.model(states))
    sides = [g for g, _ in excess(problem, states, torques)]
    worst = np.max(sides, axis=(0, 2))
    return states[np.argmin(worst), : problem.model.nv]


def _scaled(problem, z, factor, about):
    """Make the motion smaller about a pose."""
    scaled = factor * z
    if problem.curve.start is None:
        # The last coordinate is the start itself.
        scaled[:, -1] += (1.0 - factor) * about
    return scaled
