"""How well torques agree with a robot description, by one likelihood."""

import functools
from dataclasses import dataclass

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.model import TreeRegressor, nominal_parameters


def under_gravity(model, gravity):
    """Return a copy of a robot under another gravity (3,) [m/s^2]."""
    model = model.copy()
    model.gravity.linear = gravity
    return model


class Bodies:
    """Described bodies of a robot, and their regressors by motion and by gravity."""

    def __init__(self, model):
        self.nv = model.nv
        self.pull = np.array(model.gravity.linear) / 9.81
        self.parameters = nominal_parameters(model).ravel()
        self.spread = body_spread(model)
        pulls = np.vstack([np.zeros(3), 9.81 * np.eye(3)])
        made = [TreeRegressor(under_gravity(model, x)) for x in pulls]
        # Entries that any motion or any gravity makes nonzero, joint by joint.
        self.support = np.any([x.support for x in made], axis=0)
        self.used = [np.flatnonzero(row) for row in self.support.reshape(self.nv, -1)]
        self.edges = np.cumsum([0, *(used.size for used in self.used)])
        self._motion, *self._pulls = made
        self._whole = TreeRegressor(model)

    @property
    def weightless(self):
        """Whether gravity loads no joint of the description."""
        states = np.zeros((8, 3 * self.nv))
        states[:, : self.nv] = np.random.default_rng(0).normal(size=(8, self.nv))
        load, mass = self.torques(self.whole(states)), self.parameters[::10].sum()
        return bool(np.abs(load).max(initial=0.0) <= 1e-9 * mass)

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
        by_gravity = [self._entries(one, still) for one in self._pulls]
        return self._entries(self._motion, states), by_gravity

    def torques(self, entries):
        """Torques (n, nv) of the described bodies from regressor entries."""
        edges = zip(self.used, self.edges, self.edges[1:])
        return np.column_stack(
            [self.parameters[used] @ entries[a:b] for used, a, b in edges]
        )

    def rows_of(self, entries, j):
        """Regressor (n, k) of a joint's torque by the parameters that it depends on."""
        return entries[self.edges[j] : self.edges[j + 1]].T

    def _entries(self, regressor, states):
        out = np.zeros((self.edges[-1], len(states)))
        places = np.full(self.support.shape, -1)
        places[self.support] = np.arange(self.edges[-1])
        places = np.where(regressor.support, places, -1)
        parts = map(np.ascontiguousarray, np.split(states, 3, axis=1))
        regressor.entries(*parts, places, out)
        return out


def body_spread(model):
    """Prior standard deviations of all inertial parameters, ndarray (10 nv,)."""
    parameters = nominal_parameters(model)
    mass = np.maximum(parameters[:, 0], 0.02 * parameters[:, 0].max() + 1e-12)
    trace = parameters[:, [4, 6, 9]].sum(axis=1)
    length = np.maximum(np.sqrt(np.maximum(0.5 * trace / mass, 0.0)), 0.05)
    columns = [mass] + 3 * [mass * length] + 6 * [mass * length**2]
    return number.NOMINAL_ERROR * np.column_stack(columns).ravel()


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Described bodies and plain terms, fitted to the torques of some joints.

    Attributes
    ----------
    evidence : float
        Logarithm of the marginal likelihood of torques in units of their deviations,
        so that readings in other units and orders can be compared.
    left : ndarray of shape (n_joints,)
        Logarithm of the share of each torque's variance that is left.
    factors, covariance : ndarray of shape (m,) and (m, m)
        Estimates of the factors asked for.
    power : ndarray of shape (n_joints,)
        Mean power that friction takes out of the motion, in standard errors.
    """

    evidence: float
    left: np.ndarray
    factors: np.ndarray
    covariance: np.ndarray
    power: np.ndarray

    @property
    def errors(self):
        """Standard errors of the factors, ndarray (m,)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    def fall(self, other):
        """Sum over joints by which the log squared errors are below another's."""
        return float(np.sum(other.left - self.left))


class DescribedRobot:
    """A described robot in the motion of a log."""

    # times (nv,): correlation times [rows] of residuals; readings of one log are only
    # compared with the same. entries: of the regressors, if they are known.

    def __init__(
        self, bodies, signals, times=None, most=number.MOST_FITTED, entries=None
    ):
        nv = bodies.nv
        thin = int(np.clip(number.MOST_ENTRIES // (nv * nv * 10), number.LEAST, most))
        self.bodies, self.signals = bodies, signals.thinned(thin)
        self.rows = [np.flatnonzero(w > 0) for w in self.signals.weight.T]
        size = self.signals.now.var(axis=0)
        varies = size > number.LEAST_VARIANCE * size.max(initial=0.0)
        least = number.ROWS_PER_PARAMETER * np.array([x.size for x in bodies.used])
        least = np.minimum(least, number.ENOUGH_ROWS)
        enough = np.array([rows.size for rows in self.rows]) >= least
        self.joints = np.flatnonzero(self.signals.informative() & varies & enough)
        whole = entries is None
        self.entries = bodies.whole(self.signals.states) if whole else entries
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

    @functools.cached_property
    def now(self):
        """`Fit` of the torques as they are."""
        return self.fit()

    @property
    def sizes(self):
        """Deviation of each torque over that of the described one, ndarray (nv,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.signals.now.std(axis=0) / self.described.std(axis=0)

    def fit(
        self,
        entries=None,
        *,
        tau=None,
        scale=1.0,
        mean=None,
        columns=None,
        deviation=number.FACTOR,
        joints=None,
        least=-np.inf,
    ):
        """Fit torques (n, nv), less a mean; columns (n, nv, m) get factors."""
        # joints: some only. A fit whose evidence will stay below `least` is given up.
        bodies = self.bodies
        entries = self.entries if entries is None else entries
        tau = self.signals.now if tau is None else tau
        if mean is None:
            mean = scale * bodies.torques(entries)
        n_factors = 0 if columns is None else columns.shape[2]
        prior = np.r_[scale * bodies.spread, np.full(n_factors, deviation)]
        extra = bodies.spread.size + np.arange(n_factors)
        parts = []
        for j in self.joints if joints is None else joints:
            rows, used = self.rows[j], bodies.used[j]
            design = bodies.rows_of(entries, j)[rows]
            if n_factors:
                own = columns[rows, j]
                acts = own.any(axis=0)
                design, used = (
                    np.hstack([design, own[:, acts]]),
                    np.r_[used, extra[acts]],
                )
            y = tau[rows, j]
            wide = number.WIDE * max(np.sqrt(np.mean(y**2)), 1e-300)
            plain = wide * self._plain(j)[rows]
            whole = np.column_stack([design * prior[used], plain, y - mean[rows, j]])
            moments, variance = whole.T @ whole, np.var(y) + 1e-300
            parts.append(_Joint(used, moments, rows.size, self.times[j], variance))
        return _solve(parts, prior, n_factors, least)

    def with_times(self, times):
        """Return the robot with other correlation times (nv,)."""
        return DescribedRobot(
            self.bodies, self.signals, times, len(self.signals.row), self.entries
        )

    def residual(self, columns=None, without=None):
        """Return what bodies that are free for each joint leave of torques, (n, nv)."""
        # Zero where a joint stands. without (n,): rows that are not fitted.
        left = np.zeros(self.signals.now.shape)
        for j in self.joints:
            left[self.rows[j], j] = self._left(j, columns, without)
        return left

    def errors(self):
        """Relative errors (n_joints,) of torques with bodies free for each joint."""
        left, errors = self.residual(), []
        for j in self.joints:
            rows, now = self.rows[j], self.signals.now[:, j]
            # Parameters that are fitted explain a part of any noise.
            free = max(1 - (self.bodies.used[j].size + 4) / rows.size, 0.1)
            errors.append(left[rows, j].var() / free / (now[rows].var() + 1e-300))
        return np.sqrt(errors)

    def _left(self, j, columns, without):
        """Return what free bodies leave of one torque, in the joint's rows."""
        rows, rigid = self.rows[j], self.bodies.rows_of(self.entries, j)
        others = [] if columns is None else [columns]
        X = np.column_stack([rigid, self._plain(j), *others])[rows]
        X = X[:, X.any(axis=0)]
        X /= np.sqrt((X**2).mean(axis=0))
        y, fitted = self.signals.now[rows, j], X
        if without is not None:
            fitted = X * ~without[rows, None]
        gram = fitted.T @ fitted
        gram[np.diag_indices_from(gram)] += 1e-6 * rows.size
        return y - X @ np.linalg.solve(gram, fitted.T @ y)

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


class _Joint:
    """Moments of one joint's equations, its plain terms rotated to be uncorrelated."""

    def __init__(self, used, moments, n, time, variance):
        # moments: of [bodies | 4 plain terms | torque] of n rows.
        k = used.size
        self.used, self.block = used, np.ix_(used, used)
        self.rows, self.variance = n / time, variance
        values, turn = np.linalg.eigh(moments[k:-1, k:-1])
        self.values = np.maximum(values, 0.0) / time
        rest = np.r_[np.arange(k), len(moments) - 1]
        self.others = moments[np.ix_(rest, rest)] / time
        self.crossed = turn.T @ moments[k:-1, rest] / time
        self._offset = turn[:2], moments[k, k : k + 2] / time

    def among(self, places):
        """Count parameters by their places among some."""
        self.used = np.searchsorted(places, self.used)
        self.block = np.ix_(self.used, self.used)

    def marginal(self, noise):
        """Moments of bodies and torque once plain terms are integrated out."""
        share = 1 / (noise + self.values)
        reduced = self.crossed * np.sqrt(share)[:, None]
        return (self.others - reduced.T @ reduced) / noise, share

    def plain(self, theta, noise):
        """Estimated plain terms, and the square of what is left."""
        x = np.r_[theta, -1.0]
        phi = -(self.crossed @ x) / (noise + self.values)
        cross = phi @ (self.crossed @ x)
        return phi, float(x @ self.others @ x + 2 * cross + self.values @ phi**2)

    def power(self, phi, noise, shared):
        """Mean power of friction in standard errors."""
        turn, moments = self._offset
        share = 1 / (noise + self.values)
        solved = turn @ (share[:, None] * self.crossed[:, :-1])
        spread = (turn * noise * share) @ turn.T + solved @ shared @ solved.T
        error = np.sqrt(max(moments @ spread @ moments, 1e-300))
        return float(moments @ (turn @ phi) / error)


def _solve(joints, prior, n_factors, least):
    """`Fit` of joints that share bodies, each with its own plain terms and noise."""
    first, evidence = prior.size - n_factors, 0.0
    left, power = np.zeros(len(joints)), np.zeros(len(joints))
    factors, covariance = np.zeros(n_factors), np.diag(prior[first:] ** 2)
    parts = _apart(joints)
    for part in parts:
        places = np.unique(np.concatenate([joints[k].used for k in part]))
        for k in part:
            joints[k].among(places)
        asked = least if len(parts) == 1 else -np.inf
        of_part = _solve_together([joints[k] for k in part], places.size, asked)
        evidence += of_part.evidence
        left[part], power[part] = of_part.left, of_part.power
        known = np.flatnonzero(places >= first)
        at, size = places[known] - first, prior[places[known]]
        factors[at] = of_part.factors[known] * size
        covariance[np.ix_(at, at)] = (
            of_part.covariance[np.ix_(known, known)] * size * size[:, None]
        )
    return Fit(
        evidence=float(evidence),
        left=left,
        factors=factors,
        covariance=covariance,
        power=power,
    )


def _apart(joints):
    """Split joints into lists of those that share parameters, by their places."""
    found = []
    for k, one in enumerate(joints):
        own = set(one.used.tolist())
        shares = [pair for pair in found if pair[1] & own]
        found = [pair for pair in found if not pair[1] & own]
        places = sorted([*(place for pair in shares for place in pair[0]), k])
        found.append((places, own.union(*(pair[1] for pair in shares))))
    return [places for places, _ in found]


def _solve_together(joints, p, least):
    """`Fit` of joints by p parameters of which the prior is standard normal."""
    # Noise variances are found by fixed points of the evidence (MacKay, Bayesian
    # interpolation, Neural Computation 4, 1992).
    noise = np.array([0.01 * one.variance for one in joints])
    rows = np.array([one.rows for one in joints])
    size = np.array([one.variance for one in joints])
    for passed in range(number.ITERATIONS):
        A, b, plain = np.eye(p), np.zeros(p), 0.0
        for one, variance in zip(joints, noise):
            M, share = one.marginal(variance)
            A[one.block] += M[:-1, :-1]
            b[one.used] += M[:-1, -1]
            plain += np.log(variance * share).sum()
        theta, covariance, log_det = _solved(A, b)
        before, noise, misfit = noise, noise.copy(), 0.0
        phis = []
        for i, one in enumerate(joints):
            phi, square = one.plain(theta[one.used], before[i])
            spent = np.sum(covariance[one.block] * one.others[:-1, :-1]) / before[i] + 4
            left = max(one.rows - min(spent, 0.5 * one.rows), 1.0)
            noise[i] = max(square / left, number.LEAST_NOISE * one.variance)
            misfit += square / before[i] + phi @ phi
            phis.append(phi)
        change = np.log(noise / before)
        missed = theta @ theta + log_det - plain + misfit + rows @ np.log(before / size)
        if passed and np.abs(change).max() < number.CONVERGED:
            break
        # Each further pass changes noise by less than the one before.
        gain = rows @ np.maximum(-change, 0.0)
        if passed > 1 and gain - 0.5 * missed < least:
            break
    power = [
        one.power(phi, variance, covariance[one.block])
        for one, phi, variance in zip(joints, phis, before)
    ]
    # Friction takes power out of a motion; what feeds it is unlikely.
    friction = np.maximum(scipy.special.log_ndtr(power), -number.FRICTION).sum()
    return Fit(
        evidence=float(friction - 0.5 * missed),
        left=np.log(noise / size),
        factors=theta,
        covariance=covariance,
        power=np.array(power),
    )


def _solved(A, b):
    """Solve A x = b, no eigenvalue below one; x, inverse and log determinant of A."""
    root, failed = scipy.linalg.lapack.dpotrf(A, lower=True)
    if failed:
        # Columns of wrong units may be so large that rounding exceeds the prior.
        values, vectors = np.linalg.eigh(A)
        values = np.maximum(values, max(1.0, 1e-13 * values[-1]))
        inverse = (vectors / values) @ vectors.T
        return inverse @ b, inverse, np.log(values).sum()
    inverse, _ = scipy.linalg.lapack.dpotri(root, lower=True)
    inverse += np.tril(inverse, -1).T
    x = scipy.linalg.cho_solve((root, True), b)
    return x, inverse, 2.0 * np.log(np.diagonal(root)).sum()
