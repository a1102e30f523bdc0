"""Objective and optimisation of trajectories.

``docs/design.rst`` states the objective with the names that are used here.
Limits at every sample of every joint are about ten thousand constraints. An augmented
Lagrangian (Nocedal and Wright, Numerical optimization, 2006, chapter 17) needs one
multiplier for each, and unconstrained steps, here by L-BFGS-B.
"""

from collections import namedtuple
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from sklearn_vbjfa._core._runtime import counted, say

# Evidence at which two effects count as distinguished: a sum of squared differences of
# 50 noise variances is a difference of log likelihoods of 25.
DECIDED = 50.0
# Offset of the evidence over that, which bounds the value of effects without evidence.
_HOPELESS = 1e-3
_RIDGE, _LEAST = 1e-9, 1e-9
# Value of a condition number that is smaller by a factor e, for each parameter [nats],
# and the exponent of the power means of eigenvalues.
BALANCE, _POWER = 2.0, 6.0
# Share of the limits that the optimisation may use: motions go slightly further between
# samples, and a margin is required.
INSIDE = 0.98
# Rounds of multipliers, steps in each, and the factor between penalties.
_ROUNDS, _STEPS, _HARDER = 7, 45, 3.0
# Steps of the line search that scales a motion down.
_GAPS = 1e-4 * 1.6 ** np.arange(20)
# Penalty at first: an excess of one per cent at one sample costs this much [nats].
_FIRST_COST = 0.02
# Smallest distance between bodies of a motion [m].
ROOM = 0.01
# Distances between bodies are computed for every `_SKIPPED`-th sample.
_SKIPPED = 2
# Relative excess over a limit that the final scaling removes.
_TOLERATED = 2e-3


# Questions to a motion: the number of columns of the model, which come first; sizes of
# coefficients (n_columns,); columns of effects that the model may lack; weights of
# distinguishing each from the model (n_effects,), and each row from the model with the
# effect of the column (n_effects, n_effects).
Questions = namedtuple(
    "Questions", "n_model scale effects alone beside", defaults=((), 0.0, 0.0)
)
# Value of a criterion to maximise [nats]; its derivative by the information (n_columns,
# n_columns); and the evidence, in squared standard errors averaged over random
# coefficients, of each effect given the model (n_effects,), and given the model with
# each rival (n_effects, n_effects).
Worth = namedtuple("Worth", "value by_information alone beside")


def worth(information, questions):
    """Evaluate an information matrix (n_columns, n_columns) of scaled columns."""
    D = questions.scale
    M = information * np.outer(D, D)
    # Keeps the value finite for a motion with almost no information.
    M[np.diag_indices_from(M)] += _LEAST
    n = questions.n_model
    A = M[:n, :n]
    size = np.sqrt(np.diag(A))
    factor = cho_factor(A / np.outer(size, size) + _RIDGE * np.eye(n), lower=True)
    value = float(np.log(np.diag(factor[0])).sum() + np.log(size).sum())
    inverse = cho_solve(factor, np.eye(n)) / np.outer(size, size)
    by = np.zeros_like(M)
    by[:n, :n] = 0.5 * inverse
    balance, by_model = _balance(A)
    value += n * BALANCE * balance
    by[:n, :n] += n * BALANCE * by_model
    alone, beside = np.zeros(0), np.zeros((0, 0))
    if questions.effects:
        C = M[n:, :n]
        S = M[n:, n:] - C @ inverse @ C.T
        decided, by_left, alone, beside = _decisions(S, questions)
        weight = np.sum(questions.alone) + np.sum(questions.beside)
        if weight > 0:
            # All questions together weigh as much as the parameters of the model.
            share = n / weight
            value += share * decided
            L = np.hstack([-C @ inverse, np.eye(len(S))])
            by += share * (L.T @ by_left @ L)
    return Worth(value, by * np.outer(D, D), alone, beside)


def _balance(A):
    """Minus the logarithm of a smooth condition number, and its derivative by A."""
    # Power means of the eigenvalues approximate the largest and the smallest.
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, 1e-12 * values[-1])
    high = (values / values[-1]) ** _POWER
    low = (values[0] / values) ** _POWER
    value = -0.5 * (
        np.log(values[-1] / values[0])
        + (np.log(high.sum()) + np.log(low.sum())) / _POWER
    )
    slope = -0.5 * (high / high.sum() - low / low.sum()) / values
    return value, (vectors * slope) @ vectors.T


def _decisions(S, questions):
    """Value of all questions, its derivative by S, and the evidence of each."""
    n, m = questions.n_model, len(questions.effects)
    spans = [slice(block.start - n, block.stop - n) for block in questions.effects]
    # Mean over the columns of each effect, (m, n_columns).
    mean = np.zeros((m, len(S)))
    for row, span in zip(mean, spans):
        row[span] = 1.0 / (span.stop - span.start)
    alone = mean @ np.diag(S)
    value, slope = _value_of(alone)
    total = float(questions.alone @ value)
    by = np.diag((questions.alone * slope) @ mean)
    beside = np.zeros((m, m))
    for k, span in enumerate(spans):
        block = S[span, span]
        ridge = _RIDGE * np.trace(block) / len(block) + np.finfo(float).tiny
        W = np.linalg.solve(block + ridge * np.eye(len(block)), S[span])
        left = np.diag(S) - np.einsum("kc,kc->c", S[span], W)
        beside[:, k] = mean @ np.maximum(left, 0.0)
        weight = questions.beside[:, k]
        value, slope = _value_of(beside[:, k])
        total += float(weight @ value)
        each = (weight * slope) @ mean
        by += np.diag(each)
        cross = -W * each
        by[span] += cross
        by[:, span] += cross.T
        by[span, span] += (W * each) @ W.T
    return total, by, alone, beside


def _value_of(evidence):
    """Value of evidence, -log(1 + DECIDED / evidence) / 2, and its derivative."""
    # Saturates above the evidence that decides; below, doubling adds a constant.
    e = evidence + _HOPELESS * DECIDED
    return -0.5 * np.log1p(DECIDED / e), 0.5 * DECIDED / (e * (e + DECIDED))


def information_of(equations, places, n_columns, weight):
    """Information matrix (n_columns, n_columns) of rows with weights (n, nv)."""
    M = np.zeros((n_columns, n_columns))
    for j, (rows, place) in enumerate(zip(equations.rows, places)):
        M[np.ix_(place, place)] += (rows * weight[:, j]) @ rows.T
    return M


# -- motions within limits -------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """Design problem of a motion."""

    curve: object
    model: object
    robot: object
    dt: float  # sample period of the recording [s]
    questions: object
    limits: object
    # (n_columns,): for the torques; zero for effects that are only possible
    coefficients: np.ndarray
    noise: np.ndarray  # (nv,): deviation in the band of the fit
    band: float  # that band [Hz]
    still: np.ndarray  # (nv,): speeds below which a joint may be at rest
    clearance: object
    no_clearance: str  # reason why the distance between bodies is unknown

    def times(self):
        """Return sample times [s], 16 in the shortest period."""
        n = 16 * self.curve.n_harmonics
        return np.arange(n) * (self.curve.period / n)

    def weights(self, states, step):
        """Weights of rows (n, nv), and their derivatives by the velocities."""
        # A fit omits equations at rest, where dry friction is indeterminate.
        v = np.split(states, 3, axis=1)[1]
        slow = self.still**2
        moving = v**2 / (v**2 + slow)
        # Independent samples over the variance of a joint's noise.
        scale = 2 * self.band / self.noise**2 * step
        return scale * moving, scale * 2 * v * slow / (v**2 + slow) ** 2

    def information(self, states, step):
        """Information matrix of states (n, 3 nv), `step` seconds apart."""
        weight, _ = self.weights(states, step)
        return information_of(
            self.model(states), self.model.places, self.model.n_columns, weight
        )

    def torques(self, equations):
        """Torques (n, nv) of the model."""
        pairs = zip(equations.rows, self.model.places)
        return np.column_stack([self.coefficients[at] @ rows for rows, at in pairs])

    def excess(self, states, torques, inside=INSIDE):
        """Return the relative excess over shares of the limits, (4, 2, n, nv).

        Also returns its derivatives by the signals, (4, nv), negative for the second
        side.
        """
        limits = self.limits
        low, high = limits.position.T
        signals = np.stack([*np.split(states, 3, axis=1), torques])
        signals[0] -= 0.5 * (low + high)
        sizes = 0.5 * (high - low), limits.velocity, limits.acceleration, limits.torque
        slope = 1.0 / (inside * np.array(sizes))
        scaled = signals * slope[:, None]
        return np.stack([scaled - 1.0, -scaled - 1.0], axis=1), slope

    def keeps(self, z, t, inside, *, apart=True):
        """Whether a motion is within its limits, and free of collisions, at times."""
        states = self.curve.states(z, self.curve.basis(t))
        torques = self.torques(self.model(states, t))
        if self.excess(states, torques, inside)[0].max() > 1e-9:
            return False
        if not apart or self.clearance is None:
            return True
        return self.clearance.nearest(states[:, : self.model.nv])[0] >= ROOM


class Lagrangian:
    """Augmented Lagrangian of a problem, with its gradient."""

    def __init__(self, problem):
        self.problem = problem
        self.t = problem.times()
        self.step = self.t[1]
        self.basis = problem.curve.basis(self.t)
        self.multipliers = 0.0
        self.penalty = 2 * _FIRST_COST / 1e-4
        self.shape = (problem.model.nv, problem.curve.size)

    def __call__(self, x):
        problem, z, nv = self.problem, x.reshape(self.shape), self.shape[0]
        states = problem.curve.states(z, self.basis)
        equations = problem.model(states, self.t)
        weight, by_speed = problem.weights(states, self.step)
        places = problem.model.places
        M = information_of(equations, places, problem.model.n_columns, weight)
        judged = worth(M, problem.questions)
        cost, by_signals = self._penalised(states, problem.torques(equations))
        by_states, by_torque = by_signals[:, : 3 * nv], by_signals[:, 3 * nv :]
        by_rows = []
        for j, (rows, place) in enumerate(zip(equations.rows, places)):
            G = judged.by_information[np.ix_(place, place)] @ rows
            by_rows.append(-2 * G * weight[:, j])
            by_rows[j] += np.outer(problem.coefficients[place], by_torque[:, j])
            by_states[:, nv + j] -= (rows * G).sum(axis=0) * by_speed[:, j]
        if problem.clearance is not None:
            near, by_q = self._near(states[:, :nv])
            cost += near
            by_states[:, :nv] += by_q
        by_columns, by_z = problem.model.pulled_back(equations, by_rows, z, self.basis)
        gradient = problem.curve.pulled_back(by_states + by_columns, self.basis) + by_z
        return cost - judged.value, gradient.ravel()

    def _penalised(self, states, torques):
        """Cost of the limits, and its derivative by states and torques (n, 4 nv)."""
        over, slope = self.problem.excess(states, torques)
        pressed = np.maximum(self.multipliers + self.penalty * over, 0.0)
        cost = (pressed**2 - self.multipliers**2).sum() / (2 * self.penalty)
        return cost, np.hstack(list((pressed[:, 0] - pressed[:, 1]) * slope[:, None]))

    def _near(self, q):
        """Cost of bodies within the required clearance, and its derivative by q."""
        clearance = self.problem.clearance
        rows = slice(None, None, _SKIPPED)
        room = ROOM / INSIDE
        distance, gradient = clearance(q[rows], within=room + clearance.near)
        g = np.maximum(room - distance, 0.0) / clearance.near
        weight = _SKIPPED * self.penalty
        by = np.zeros_like(q)
        by[rows] = -weight / clearance.near * np.einsum("np,npj->nj", g, gradient)
        return 0.5 * weight * (g**2).sum(), by

    def tighten(self, x):
        """Raise multipliers and penalty; return the largest excess."""
        problem = self.problem
        states = problem.curve.states(x.reshape(self.shape), self.basis)
        torques = problem.torques(problem.model(states, self.t))
        over, _ = problem.excess(states, torques)
        self.multipliers = np.maximum(self.multipliers + self.penalty * over, 0.0)
        self.penalty *= _HARDER
        return over.max()


def optimise(problem, starts):
    """Optimise motions, coordinates (nv, size) each, and the best within its limits.

    Returns the result and its starting point.
    """
    lagrangian = Lagrangian(problem)

    def improved(x):
        options = {"maxiter": _STEPS, "maxcor": 20}
        return minimize(lagrangian, x, jac=True, method="L-BFGS-B", options=options)

    shown = counted(starts, "improving start", len(starts))
    results = [improved(z.ravel()) for z in shown]
    first = int(np.argmin([result.fun for result in results]))
    best, before = results[first], np.inf
    for _ in range(_ROUNDS - 1):
        worst = lagrangian.tighten(best.x)
        if worst < _TOLERATED and abs(before - best.fun) < 0.05:
            break
        say(f"limits exceeded by {max(worst, 0.0):.1%}")
        best, before = improved(best.x), best.fun
    return best.x.reshape(lagrangian.shape), starts[first]


def shrunk(problem, z, t, inside, *, apart=True):
    """Scale a motion about the pose of largest margin until it keeps its limits."""
    if problem.keeps(z, t, inside, apart=apart):
        return z
    states = problem.curve.states(z, problem.curve.basis(t))
    states[:, problem.model.nv :] = 0.0
    torques = problem.torques(problem.model(states))
    worst = problem.excess(states, torques)[0].max(axis=(0, 1, 3))
    about = states[np.argmin(worst), : problem.model.nv]

    def scaled(factor):
        smaller = factor * z
        # The last coordinate is the start itself.
        smaller[:, -1] += (1.0 - factor) * about
        return smaller

    # A smaller motion may need a larger torque, near a pose with a large static torque:
    # search the largest factor from above.
    low, high = 0.0, 1.0
    for gap in _GAPS:
        if problem.keeps(scaled(1.0 - gap), t, inside, apart=apart):
            low = 1.0 - gap
            break
        high = 1.0 - gap
    for _ in range(6):
        middle = 0.5 * (low + high)
        kept = problem.keeps(scaled(middle), t, inside, apart=apart)
        low, high = (middle, high) if kept else (low, middle)
    return scaled(low)
