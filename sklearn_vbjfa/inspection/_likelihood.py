"""How well torques agree with a robot description, by one likelihood."""

import functools
from dataclasses import dataclass

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._signals import Change
from sklearn_vbjfa.model import TreeRegressor, nominal_parameters


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Described bodies and plain terms, fitted to the torques of all joints.

    Attributes
    ----------
    evidence : float
        Logarithm of the marginal likelihood, up to a constant of the torques.
    factors, covariance : ndarray of shape (m,) and (m, m)
        Estimates of the factors asked for.
    noise : ndarray of shape (n_joints,)
        Residual variances [(N m)^2] of the informative joints.
    power : ndarray of shape (n_joints,)
        Mean power that friction takes out of the motion, in standard errors.
    """

    evidence: float
    factors: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray
    power: np.ndarray

    @property
    def errors(self):
        """Standard errors of the factors, ndarray (m,)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))


class Bodies:
    """Described bodies of a robot, and their regressors by motion and by gravity."""

    def __init__(self, model):
        self.model, self.nv = model, model.nv
        gravity = np.array(model.gravity.linear)
        self.size = float(np.linalg.norm(gravity))
        self.pull = gravity / 9.81
        self.parameters = nominal_parameters(model).ravel()
        self.spread = body_spread(model)
        pulls = np.vstack([np.zeros(3), 9.81 * np.eye(3)])
        made = [TreeRegressor(Change(gravity=x).model(model)) for x in pulls]
        # Entries that any motion or any gravity makes nonzero, joint by joint.
        self.support = np.any([x.support for x in made], axis=0)
        self.used = [np.flatnonzero(row) for row in self.support.reshape(self.nv, -1)]
        self.edges = np.cumsum([0, *(used.size for used in self.used)])
        self._motion, *self._pulls = made
        self._whole = TreeRegressor(model)

    @property
    def weightless(self):
        """Whether gravity loads no joint of the description."""
        rng = np.random.default_rng(0)
        states = np.zeros((8, 3 * self.nv))
        states[:, : self.nv] = rng.normal(size=(8, self.nv))
        load, whole = self.torques(self.whole(states)), self.parameters[::10].sum()
        return bool(np.abs(load).max(initial=0.0) <= 1e-9 * whole * max(self.size, 1.0))

    @property
    def massless(self):
        """Whether a body has no mass, so that its torques carry no information."""
        return bool(self.parameters[::10].min() <= 0)

    def whole(self, states):
        """Regressor entries (n_entries, n) with the gravity of the description."""
        return self._entries(self._whole, states)

    def parts(self, states):
        """Regressor entries of the motion, and of 1 g along each axis."""
        still = states.copy()
        still[:, self.nv :] = 0.0
        return self._entries(self._motion, states), [
            self._entries(one, still) for one in self._pulls
        ]

    def torques(self, entries):
        """Torques (n, nv) of the described bodies from regressor entries."""
        return np.column_stack(
            [
                self.parameters[used] @ entries[a:b]
                for used, a, b in zip(self.used, self.edges, self.edges[1:])
            ]
        )

    def rows_of(self, entries, j):
        """Regressor (n, k) of a joint's torque by the parameters that it depends on."""
        return entries[self.edges[j] : self.edges[j + 1]].T

    def _entries(self, regressor, states):
        n = len(states)
        out = np.zeros((self.edges[-1], n))
        places = np.full(self.support.shape, -1)
        places[self.support] = np.arange(self.edges[-1])
        places = np.where(regressor.support, places, -1)
        regressor.entries(
            *map(np.ascontiguousarray, np.split(states, 3, axis=1)), places, out
        )
        return out


class DescribedRobot:
    """A described robot in the motion of a log."""

    # times (nv,): correlation times [rows] of residuals; readings of one log are only
    # compared with the same.

    # entries: of the regressors, where another reading has them already.

    def __init__(
        self, bodies, signals, times=None, most=number.MOST_FITTED, entries=None
    ):
        nv = bodies.nv
        thin = int(np.clip(number.MOST_ENTRIES // (nv * nv * 10), number.LEAST, most))
        self.bodies, self.signals = bodies, signals.thinned(thin)
        size = self.signals.now.var(axis=0)
        varies = size > number.LEAST_VARIANCE * size.max(initial=0.0)
        self.rows = [np.flatnonzero(w > 0) for w in self.signals.weight.T]
        least = [
            min(number.ROWS_PER_PARAMETER * used.size, number.ENOUGH_ROWS)
            for used in bodies.used
        ]
        enough = np.array([rows.size for rows in self.rows]) >= least
        self.joints = np.flatnonzero(self.signals.informative() & varies & enough)
        if entries is None:
            entries = bodies.whole(self.signals.states)
        self.entries = entries
        self.times = self.correlation_times() if times is None else times

    @functools.cached_property
    def _parts(self):
        return self.bodies.parts(self.signals.states)

    def pulled(self, direction):
        """Regressor entries with gravity along a vector (3,), in units of g."""
        motion, gravity = self._parts
        return motion + sum(part * one for part, one in zip(direction, gravity))

    @functools.cached_property
    def described(self):
        """Torques (n, nv) of the described bodies."""
        return self.bodies.torques(self.entries)

    @functools.cached_property
    def moving(self):
        """Torques (n, nv) of the described bodies without gravity."""
        return self.bodies.torques(self._parts[0])

    @functools.cached_property
    def by_gravity(self):
        """Torques (n, nv, 3) of the described bodies by 1 g along each axis."""
        return np.stack([self.bodies.torques(x) for x in self._parts[1]], axis=-1)

    @property
    def weight(self):
        """Torques (n, nv) of the described bodies by gravity alone."""
        return self.described - self.moving

    @property
    def information(self):
        """Independent rows of each informative joint, ndarray (n_joints,)."""
        return np.array([self.rows[j].size / self.times[j] for j in self.joints])

    @property
    def variance(self):
        """Variances of the torques of informative joints, ndarray (n_joints,)."""
        now = self.signals.now
        return np.array([now[self.rows[j], j].var() for j in self.joints]) + 1e-300

    def fit(
        self,
        entries=None,
        *,
        tau=None,
        scale=1.0,
        mean=None,
        columns=None,
        deviation=number.FACTOR,
    ):
        """Fit torques (n, nv), less a mean; columns (n, nv, m) get factors."""
        bodies = self.bodies
        entries = self.entries if entries is None else entries
        tau = self.signals.now if tau is None else tau
        if mean is None:
            mean = scale * bodies.torques(entries)
        n_factors = 0 if columns is None else columns.shape[2]
        prior = np.r_[scale * bodies.spread, np.full(n_factors, deviation)]
        own = bodies.spread.size + np.arange(n_factors)
        parts = []
        for j in self.joints:
            rows, time = self.rows[j], self.times[j]
            design, used = bodies.rows_of(entries, j)[rows], bodies.used[j]
            if n_factors:
                design, used = np.hstack([design, columns[rows, j]]), np.r_[used, own]
            plain, y = self._plain(j)[rows], tau[rows, j]
            wide = number.WIDE * max(np.sqrt(np.mean(y**2)), 1e-300)
            whole = np.column_stack(
                [design * prior[used], plain * wide, y - mean[rows, j]]
            )
            parts.append((used, whole.T @ whole, rows.size, time, np.var(y) + 1e-300))
        return _solve(parts, prior, n_factors)

    def residual(self, columns=None):
        """Return what bodies that are free for each joint leave of torques, (n, nv)."""
        # Zero where a joint stands.
        left = np.zeros(self.signals.now.shape)
        for j in self.joints:
            rows, solve = self._ridge(j, 1e-6, columns)
            left[rows, j] = solve(self.signals.now[rows, j])
        return left

    def errors(self):
        """Relative errors (n_joints,) of torques with bodies free for each joint."""
        left = self.residual()
        # Parameters that are fitted explain a part of any noise.
        left = [
            left[self.rows[j], j].var() / max(1 - (used.size + 4) / rows.size, 0.1)
            for j, rows, used in zip(
                self.joints,
                (self.rows[j] for j in self.joints),
                (self.bodies.used[j] for j in self.joints),
            )
        ]
        return np.sqrt(np.array(left) / self.variance)

    def crossed(self):
        """Share (n_joints, n_joints) of each torque that the joint's motion leaves."""
        out, scale = np.empty((self.joints.size,) * 2), np.sqrt(self.variance)
        torque = self.signals.now[:, self.joints] / scale
        for place, j in enumerate(self.joints):
            rows, solve = self._ridge(j, 1e-3)
            out[place] = (solve(torque[rows]) ** 2).mean(axis=0)
        return np.maximum(out, 1e-12)

    def _ridge(self, j, share, columns=None):
        """Rows of a joint, and a function from their torques to residuals."""
        rows, bodies = self.rows[j], self.bodies
        rigid = bodies.rows_of(self.entries, j)[rows]
        others = [] if columns is None else [columns[rows]]
        X = np.column_stack([rigid, self._plain(j)[rows], *others])
        X = X[:, X.any(axis=0)]
        X /= np.sqrt((X**2).mean(axis=0))
        gram = X.T @ X
        gram[np.diag_indices_from(gram)] += share * rows.size
        return rows, lambda y: y - X @ np.linalg.solve(gram, X.T @ y)

    def _plain(self, j):
        """Columns (n, 4) of viscous and Coulomb friction, rotor and offset."""
        q, v, a = self.signals.states[:, j :: self.bodies.nv].T
        columns = np.column_stack([v, self.signals.sign[:, j], a, np.ones(len(q))])
        size = np.sqrt((columns**2).mean(axis=0))
        return columns / np.where(size > 0, size, 1.0)

    def correlation_times(self, columns=None):
        """Correlation times [rows] of what free bodies leave of each joint's torque."""
        # columns (n, m): what else acts on the joints.
        found, left = np.ones(self.bodies.nv), self.residual(columns)
        for j in self.joints:
            found[j] = correlation_time(left[self.rows[j], j])
        return found


def correlation_time(x):
    """Correlation time [samples] of a series, at least one."""
    x = x - x.mean()
    power = np.abs(np.fft.rfft(x, 2 * x.size)) ** 2
    correlation = np.fft.irfft(power)[: x.size]
    if correlation[0] <= 0:
        return 1.0
    correlation = correlation / correlation[0]
    low = np.flatnonzero(correlation < number.INDEPENDENT)
    stop = low[0] if low.size else x.size // 4
    return max(1.0, 1.0 + 2.0 * float(correlation[1:stop].sum()))


def _solve(parts, prior, n_factors):
    """`Fit` of joints that share bodies, each with its own plain terms and noise."""
    # parts: used bodies, moments of [design | plain | torque], rows, correlation time
    # and variance of the torque of each joint. Noise variances are found by EM.
    noise = np.array([0.01 * part[-1] for part in parts])
    p = prior.size
    blocks = [np.ix_(part[0], part[0]) for part in parts]
    for last in range(number.ITERATIONS):
        A, b, plain = np.eye(p), np.zeros(p), []
        for (used, M, _, time, _), block, variance in zip(parts, blocks, noise):
            k, w = used.size, 1.0 / (variance * time)
            H = np.eye(4) + w * M[k:-1, k:-1]
            solved = np.linalg.solve(H, w * M[k:-1])
            A[block] += w * (M[:k, :k] - M[:k, k:-1] @ solved[:, :k])
            b[used] += w * (M[:k, -1] - M[:k, k:-1] @ solved[:, -1])
            plain.append((H, solved))
        covariance = np.linalg.inv(A)
        theta = covariance @ b
        before, noise, squares, values = noise, np.empty(len(parts)), [], []
        for i, (used, M, n, time, variance) in enumerate(parts):
            k, solved = used.size, plain[i][1]
            phi = solved[:, -1] - solved[:, :k] @ theta[used]
            x = np.r_[theta[used], phi, -1.0]
            squares.append(float(x @ M @ x))
            values.append(phi)
            spent = np.sum(covariance[blocks[i]] * M[:k, :k]) / (before[i] * time) + 4.0
            rows = n / time
            left = max(rows - min(spent, 0.5 * rows), 1.0)
            noise[i] = max(squares[i] / time / left, number.LEAST_NOISE * variance)
        if last and np.allclose(noise, before, rtol=number.CONVERGED):
            break
    evidence, power = -0.5 * (theta @ theta + np.linalg.slogdet(A)[1]), []
    for i, (used, M, n, time, _) in enumerate(parts):
        k, (H, solved), phi = used.size, plain[i], values[i]
        evidence -= 0.5 * n / time * np.log(before[i])
        evidence -= 0.5 * squares[i] / (before[i] * time)
        evidence -= 0.5 * (np.linalg.slogdet(H)[1] + phi @ phi)
        shared = covariance[blocks[i]]
        power.append(_power(M[k, k : k + 2], phi, H, solved[:2, :k], shared))
    # Friction takes power out of a motion; what feeds it is unlikely.
    friction = np.maximum(scipy.special.log_ndtr(power), -number.FRICTION).sum()
    own = slice(p - n_factors, p)
    return Fit(
        evidence=float(evidence + friction),
        factors=theta[own] * prior[own],
        covariance=covariance[own, own] * np.outer(prior[own], prior[own]),
        noise=noise,
        power=np.array(power),
    )


def _power(moments, phi, H, solved, shared):
    """Mean power of friction (2,) in standard errors."""
    spread = np.linalg.inv(H)[:2, :2] + solved @ shared @ solved.T
    return float(moments @ phi[:2] / np.sqrt(max(moments @ spread @ moments, 1e-300)))


def body_spread(model):
    """Prior standard deviations of all inertial parameters, ndarray (10 nv,)."""
    parameters = nominal_parameters(model)
    mass = np.maximum(parameters[:, 0], 0.02 * parameters[:, 0].max() + 1e-12)
    trace = parameters[:, [4, 6, 9]].sum(axis=1)
    length = np.maximum(np.sqrt(np.maximum(0.5 * trace / mass, 0.0)), 0.05)
    columns = [mass] + 3 * [mass * length] + 6 * [mass * length**2]
    return number.NOMINAL_ERROR * np.column_stack(columns).ravel()
