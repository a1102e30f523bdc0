"""How well torques agree with a robot description, by one likelihood."""

import functools
from dataclasses import dataclass
from itertools import combinations_with_replacement

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
        nominal = nominal_parameters(model)
        self.parameters, self.spread = nominal.ravel(), _spread(nominal)
        pulls = np.vstack([np.zeros(3), 9.81 * np.eye(3)])
        self._whole = TreeRegressor(model)
        self._parts = [TreeRegressor(under_gravity(model, x)) for x in pulls]
        # Parameters that any motion or any gravity needs, joint by joint.
        support = np.any([x.support for x in self._parts], axis=0)
        self.used = [np.flatnonzero(row) for row in support.reshape(self.nv, -1)]
        # Bodies that may carry a load.
        self.last = ~np.isin(np.arange(1, self.nv + 1), list(model.parents))
        # Whether no body has mass, so that torques cannot be compared.
        self.massless = bool(nominal[:, 0].max() <= 0)

    @property
    def weightless(self):
        """Whether gravity loads no joint of the description."""
        states = np.zeros((8, 3 * self.nv))
        states[:, : self.nv] = np.random.default_rng(0).normal(size=(8, self.nv))
        load, mass = self.described(states)[1], self.parameters[::10].sum()
        return bool(np.abs(load).max(initial=0.0) <= 1e-9 * mass)

    def whole(self, states):
        """Regressors (n, nv, 10 nv) with the gravity of the description."""
        return _regressors(self._whole, states)

    def parts(self, states):
        """Regressors of the motion, and of 1 g along each axis."""
        still = states.copy()
        still[:, self.nv :] = 0.0
        motion, *pulls = self._parts
        return _regressors(motion, states), [_regressors(x, still) for x in pulls]

    def described(self, states):
        """Torques (n, nv) of the described bodies' motion, and of their weight."""
        still = states.copy()
        still[:, self.nv :] = 0.0
        whole, weight = (
            self._whole.torques(*np.split(x, 3, axis=1), self.parameters)
            for x in (states, still)
        )
        return whole - weight, weight


def _regressors(regressor, states):
    q, v, a = map(np.ascontiguousarray, np.split(states, 3, axis=1))
    return regressor(q, v, a).reshape(*q.shape, -1)


def _spread(bodies):
    """Prior standard deviations of all inertial parameters, ndarray (10 nv,)."""
    mass = np.maximum(bodies[:, 0], 0.02 * bodies[:, 0].max() + 1e-12)
    trace = bodies[:, [4, 6, 9]].sum(axis=1)
    length = np.maximum(np.sqrt(np.maximum(0.5 * trace / mass, 0.0)), 0.05)
    columns = [mass] + 3 * [mass * length] + 6 * [mass * length**2]
    return number.NOMINAL_ERROR * np.column_stack(columns).ravel()


@dataclass(frozen=True, kw_only=True)
class BodyFit:
    """Described bodies and plain terms, fitted to the torques of some joints."""

    # Logarithm of the marginal likelihood of torques in units of their deviations, so
    # that readings in other units and orders can be compared.
    evidence: float
    left: np.ndarray  # (n_joints,): log of the share of each torque's variance left
    factors: np.ndarray  # (m,): estimates of the factors asked for
    errors: np.ndarray  # (m,): standard errors of these
    power: np.ndarray  # (n_joints,): that friction takes, in standard errors

    def fall(self, other):
        """Sum over joints by which the log squared errors are below another's."""
        return float(np.sum(other.left - self.left))


class DescribedRobot:
    """A described robot in the motion of a log."""

    # times (nv,): correlation times [rows] of residuals; readings of one log are only
    # compared with the same. entries: of the regressors, if they are known.

    def __init__(self, bodies, signals, times=None, entries=None):
        self.bodies, self.signals = bodies, signals
        self.rows = [np.flatnonzero(w > 0) for w in signals.weight.T]
        size = signals.tau.var(axis=0)
        varies = size > number.LEAST_VARIANCE * size.max(initial=0.0)
        least = number.ROWS_PER_PARAMETER * np.array([x.size for x in bodies.used])
        least = np.minimum(least, number.ENOUGH_ROWS)
        enough = np.array([rows.size for rows in self.rows]) >= least
        self.joints = np.flatnonzero(signals.informative() & varies & enough)
        self.entries = bodies.whole(signals.states) if entries is None else entries
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
        return self.entries @ self.bodies.parameters

    @functools.cached_property
    def moving(self):
        """Torques (n, nv) of the described bodies without gravity."""
        return self._parts[0] @ self.bodies.parameters

    @functools.cached_property
    def by_gravity(self):
        """Torques (n, nv, 3) of the described bodies by 1 g along each axis."""
        bodies = self.bodies.parameters
        return np.stack([x @ bodies for x in self._parts[1]], axis=-1)

    @property
    def weight(self):
        """Torques (n, nv) of the described bodies by gravity alone."""
        return self.described - self.moving

    @functools.cached_property
    def now(self):
        """`BodyFit` of the torques as they are."""
        return self.fit()

    @functools.cached_property
    def invented(self):
        """Log odds of bodies that were invented, against the described ones."""
        return self._otherwise(number.INVENTED)

    @functools.cached_property
    def loaded(self):
        """Log odds of invented bodies, or of a load, against the described ones."""
        spread = self.bodies.spread.reshape(-1, 10)
        load = np.where(self.bodies.last[:, None], spread.max(axis=0), spread) / spread
        return max(self.invented, self._otherwise(load.ravel()))

    def _otherwise(self, spread):
        """Log odds of bodies with a wider prior."""
        return max(0.0, self.fit(spread=spread).evidence - self.now.evidence)

    def with_springs(self, joints, turns=False):
        """Return the evidence for springs and, with turns, for counterbalances."""
        # In a small motion the lack of weight, or its turn, is linear in the positions.
        nv, tau = self.bodies.nv, self.signals.tau
        q = self.signals.states[:, :nv] - self.signals.states[:, :nv].mean(axis=0)
        size = np.sqrt((q**2).mean(axis=0))
        ratio = np.sqrt((tau**2).mean(axis=0))[:, None] / np.where(size > 0, size, 1.0)
        # One stiffness of two joints acts on both.
        stiffness = np.zeros((nv, nv, nv * (nv + 1) // 2))
        for k, (i, j) in enumerate(combinations_with_replacement(range(nv), 2)):
            stiffness[[i, j], [j, i], k] = max(ratio[i, j], ratio[j, i])
        forms = np.stack([q, np.sin(q), np.cos(q)] if turns else [q])
        columns = np.einsum("fnj,ijk->nifk", forms, stiffness).reshape(*q.shape, -1)
        return self.fit(columns=columns, deviation=1.0, joints=joints).evidence

    @functools.cached_property
    def springs(self):
        """Log odds of springs between all joints, against none."""
        return self.with_springs(self.joints) - self.now.evidence

    def surpasses(self, log_odds):
        """Whether log odds are far above those of other masses, and of springs."""
        return log_odds > max(self.invented, self.springs) + number.FAR

    @property
    def sizes(self):
        """Deviation of each torque over that of the described one, ndarray (nv,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.signals.tau.std(axis=0) / self.described.std(axis=0)

    def fit(
        self,
        entries=None,
        *,
        tau=None,
        scale=1.0,
        spread=1.0,
        mean=None,
        columns=None,
        deviation=number.FACTOR,
        joints=None,
    ):
        """Fit torques (n, nv), less a mean; columns (n, nv, m) get factors."""
        # joints: some only; scale, spread: of the described bodies, and of their prior.
        bodies = self.bodies
        entries = self.entries if entries is None else entries
        tau = self.signals.tau if tau is None else tau
        joints = self.joints if joints is None else np.asarray(joints)
        if mean is None:
            mean = scale * (entries @ bodies.parameters)
        m = 0 if columns is None else columns.shape[2]
        prior = np.r_[scale * spread * bodies.spread, np.full(m, deviation)]
        first, made = bodies.spread.size, []
        for j in joints:
            rows, used = self.rows[j], bodies.used[j]
            design = entries[rows, j][:, used]
            if m:
                own = columns[rows, j]
                acts = own.any(axis=0)
                design = np.hstack([design, own[:, acts]])
                used = np.r_[used, first + np.flatnonzero(acts)]
            y = tau[rows, j]
            wide = number.WIDE * max(np.sqrt(np.mean(y**2)), 1e-300)
            plain = wide * self.plain(j)[rows]
            whole = np.column_stack([plain, design * prior[used], y - mean[rows, j]])
            moments = whole.T @ whole / self.times[j]
            made.append((used, moments, rows.size / self.times[j], np.var(y) + 1e-300))
        return _solve(made, prior, m)

    def is_apart(self, own):
        """Whether some rows agree far worse than others, or with other masses."""
        few = number.FEWEST_ROWS
        moves, rest = (self.signals.weight[x].sum(axis=0) for x in (own, ~own))
        joints = [j for j in self.joints if min(moves[j], rest[j]) > few]
        if not joints:
            # Beside positions in degrees those of others stand still.
            return bool((moves > few).any())
        both = [self._of_rows(rows)._left(joints) for rows in (own, ~own)]
        (share, one), (usual, other) = both
        worse = (share - usual)[share > 2 * np.log(number.GOOD_FIT)]
        apart = np.logaddexp(np.log(own.mean()) + one, np.log((~own).mean()) + other)
        fall = self._left(joints)[1] - apart
        return bool(np.r_[fall, worse - number.CLEAR].max() > number.CLEAR)

    def _of_rows(self, rows):
        known = self.times, self.entries[rows]
        return DescribedRobot(self.bodies, self.signals.taken(rows), *known)

    def _left(self, joints):
        """Log of the share and of the variance (k,) that is left of joints' torques."""
        same = np.array_equal(joints, self.joints)
        left = (self.now if same else self.fit(joints=joints)).left
        size = [self.signals.tau[self.rows[j], j].var() for j in joints]
        return left, left + np.log(size)

    def residual(self, columns=None):
        """Return what bodies that are free for each joint leave of torques, (n, nv)."""
        # Zero where a joint stands.
        signals, left = self.signals, np.zeros(self.signals.tau.shape)
        for j in self.joints:
            rows, X = self.rows[j], self.free(j, columns)[self.rows[j]]
            gram = X.T @ X + 1e-6 * rows.size * np.eye(X.shape[1])
            y = signals.tau[rows, j]
            left[rows, j] = y - X @ np.linalg.solve(gram, X.T @ y)
        return left

    def free(self, j, columns=None):
        """Columns (n, p) of a joint's bodies and plain terms, zero where it stands."""
        others = [] if columns is None else [columns]
        rigid = self.entries[:, j][:, self.bodies.used[j]]
        X = np.column_stack([rigid, self.plain(j), *others])
        X = X * (self.signals.weight[:, [j]] > 0)
        X = X[:, X.any(axis=0)]
        return X / np.sqrt((X[self.rows[j]] ** 2).mean(axis=0))

    def errors(self):
        """Relative errors (n_joints,) of torques with bodies free for each joint."""
        left, errors = self.residual(), []
        for j in self.joints:
            rows, now = self.rows[j], self.signals.tau[:, j]
            # Parameters that are fitted explain a part of any noise.
            free = max(1 - (self.bodies.used[j].size + 4) / rows.size, 0.1)
            errors.append(left[rows, j].var() / free / (now[rows].var() + 1e-300))
        return np.sqrt(errors)

    def plain(self, j):
        """Columns (n, k) of viscous and Coulomb friction, rotor and offsets."""
        q, v, a = self.signals.states[:, j :: self.bodies.nv].T
        columns = np.column_stack([v, self.signals.sign[:, j], a, np.ones(len(q))])
        size = np.sqrt((columns**2).mean(axis=0))
        return np.hstack([columns / np.where(size > 0, size, 1.0), self._differ])

    @functools.cached_property
    def _differ(self):
        """Columns (n, r) of what the offset of each of some recordings differs by."""
        own = self.signals.recording[:, None] == np.unique(self.signals.recording)
        known = number.OFFSETS / number.WIDE * own
        return known if 1 < own.shape[1] <= number.MANY else known[:, :0]

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


def _solve(joints, prior, m):
    """`BodyFit` of joints with plain terms and noise of each, and m common factors."""
    # joints: parameters that each depends on, moments of [plain | these | torque], the
    # prior of which is standard normal, number of independent rows and variance. Noise
    # variances are fixed points (MacKay, Bayesian interpolation, Neural Comp. 4, 1992).
    used, moments, rows, size = zip(*joints)
    places = np.unique(np.concatenate(used))
    rows, size = np.array(rows), np.array(size)
    n_plain = len(moments[0]) - 1 - used[0].size
    p = places.size + n_plain * len(joints)
    plain = [np.arange(k, k + n_plain) for k in range(places.size, p, n_plain)]
    at = [np.r_[x, np.searchsorted(places, y)] for x, y in zip(plain, used)]
    blocks, noise = [np.ix_(x, x) for x in at], 0.01 * size
    for passed in range(number.ITERATIONS):
        A, b = np.eye(p), np.zeros(p)
        for x, block, M, variance in zip(at, blocks, moments, noise):
            A[block] += M[:-1, :-1] / variance
            b[x] += M[:-1, -1] / variance
        theta, covariance, log_det = _solved(A, b)
        known = [np.r_[theta[x], -1.0] for x in at]
        square = np.array([x @ M @ x for x, M in zip(known, moments)])
        spent = [np.sum(covariance[x] * M[:-1, :-1]) for x, M in zip(blocks, moments)]
        free = np.maximum(rows - np.minimum(spent / noise, 0.5 * rows), 1.0)
        before, noise = noise, np.maximum(square / free, number.LEAST_NOISE * size)
        if passed and np.abs(np.log(noise / before)).max() < number.CONVERGED:
            break
    missed = theta @ theta + log_det + np.sum(square / before)
    missed += rows @ np.log(before / size)
    # Friction takes power out of a motion; what feeds it is unlikely.
    power = []
    for x, M in zip(plain, moments):
        speed, friction = M[0, :2], x[:2]
        error = speed @ covariance[np.ix_(friction, friction)] @ speed
        power.append(speed @ theta[friction] / np.sqrt(max(error, 1e-300)))
    friction = np.maximum(scipy.special.log_ndtr(power), -number.FRICTION).sum()
    at = np.flatnonzero(places >= prior.size - m)
    which = places[at] - prior.size
    factors, errors = np.zeros(m), prior[prior.size - m :].copy()
    factors[which] = theta[at] * prior[which]
    errors[which] *= np.sqrt(np.maximum(np.diagonal(covariance)[at], 0.0))
    return BodyFit(
        evidence=float(friction - 0.5 * missed),
        left=np.log(noise / size),
        factors=factors,
        errors=errors,
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
