"""Marginal likelihood of torques under a robot description."""

import functools
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
import scipy

from sklearn_vbjfa._core._linear_systems import components, solve_spd
from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.model import TreeRegressor, end_joints, nominal_parameters


def under_gravity(model, gravity):
    """Return a copy of a robot under another gravity (3,) [m/s^2]."""
    model = model.copy()
    model.gravity.linear = gravity
    return model


class Bodies:
    """Bodies of a described robot, `Folded`; regressors of motion and of gravity."""

    def __init__(self, robot):
        # Joints that follow others have bodies, but no channels.
        model, (self._rates, self._offsets) = robot.full, robot.motion
        self.nv = robot.model.nv
        self.gravity = np.array(model.gravity.linear) / 9.81
        nominal = nominal_parameters(model)
        self.parameters, mass = nominal.ravel(), nominal[:, 0]
        mass = np.maximum(mass, 0.02 * mass.max() + 1e-12)
        trace = nominal[:, [4, 6, 9]].sum(axis=1)
        length = np.maximum(np.sqrt(np.maximum(0.5 * trace / mass, 0.0)), 0.05)
        scales = [mass] + 3 * [mass * length] + 6 * [mass * length**2]
        self.prior_std = number.NOMINAL_ERROR * np.column_stack(scales).ravel()
        pulls = np.vstack([np.zeros(3), 9.81 * np.eye(3)])
        self._regressor = TreeRegressor(model)
        self._parts = [TreeRegressor(under_gravity(model, x)) for x in pulls]
        # Indices of the inertial parameters that act on each joint.
        support = np.any([x.support for x in self._parts], axis=0)
        support = (self._rates != 0).T @ support.reshape(model.nv, -1)
        self.used = [np.flatnonzero(row) for row in support]
        # Leaves of the tree, which may carry a load.
        self.leaf = np.isin(np.arange(model.nv), end_joints(model))
        # Whether no body has mass, so that torques cannot be compared.
        self.massless = bool(nominal[:, 0].max() <= 0)

    @property
    def weightless(self):
        """Whether gravity loads no joint of the description."""
        states = np.zeros((8, 3 * self.nv))
        states[:, : self.nv] = np.random.default_rng(0).normal(size=(8, self.nv))
        load, mass = self.described(states)[1], self.parameters[::10].sum()
        return bool(np.abs(load).max(initial=0.0) <= 1e-9 * mass)

    def regressor(self, states):
        """Regressors (n, nv, 10 nv) under the gravity of the description."""
        return self._regressors(self._regressor, states)

    def parts(self, states):
        """Regressors without gravity, and at rest under 1 g along each axis."""
        still = states.copy()
        still[:, self.nv :] = 0.0
        motion, *pulls = map(self._regressors, self._parts, [states, *3 * [still]])
        return motion, pulls

    def torques(self, states):
        """Torques (n, nv) of the described bodies."""
        torques = self._regressor.torques(*self._motion(states), self.parameters)
        return torques @ self._rates

    def described(self, states):
        """Torques (n, nv) of the described bodies: inertial ones, and the weight."""
        still = states.copy()
        still[:, self.nv :] = 0.0
        weight = self.torques(still)
        return self.torques(states) - weight, weight

    def _motion(self, states):
        """Return position, velocity and acceleration (n, n_bodies) of all joints."""
        q, v, a = (x @ self._rates.T for x in np.split(states, 3, axis=1))
        return q + self._offsets, v, a

    def _regressors(self, regressor, states):
        q, v, a = self._motion(states)
        X = regressor(q, v, a).reshape(*q.shape, -1)
        return X if X.shape[1] == self.nv else self._rates.T @ X


@dataclass(frozen=True, kw_only=True)
class BodyFit:
    """Fit of described bodies, friction and offsets to the torques of some joints."""

    # Log marginal likelihood of the torques over their standard deviations.
    evidence: float
    loss: np.ndarray  # (n_joints,): log unexplained share of each torque's variance
    factors: np.ndarray  # (m,): estimated factors of the extra columns
    errors: np.ndarray  # (m,): their standard errors
    power: np.ndarray  # (n_joints,): power of friction over its standard error

    def fall(self, other):
        """Return by how much log squared errors, summed, are below another fit's."""
        return float(np.sum(other.loss - self.loss))


class DescribedRobot:
    """A described robot with the signals of a log."""

    # times (nv,): correlation times [rows], the same for all interpretations of a log.
    # X (n, nv, 10 nv): regressors.

    def __init__(self, bodies, signals, times=None, X=None):
        self.bodies, self.signals = bodies, signals
        self.rows = [np.flatnonzero(w > 0) for w in signals.weight.T]
        size = signals.tau.var(axis=0)
        varies = size > number.LEAST_VARIANCE * size.max(initial=0.0)
        least = number.ROWS_PER_PARAMETER * np.array([x.size for x in bodies.used])
        least = np.minimum(least, min(number.ENOUGH_ROWS, 2 * signals.few))
        enough = np.array([rows.size for rows in self.rows]) >= least
        self.joints = np.flatnonzero(signals.informative() & varies & enough)
        self.regressor = bodies.regressor(signals.states) if X is None else X
        self.times = self.correlation_times() if times is None else times

    @functools.cached_property
    def _parts(self):
        return self.bodies.parts(self.signals.states)

    def under_gravity(self, direction):
        """Regressors under a gravity vector (3,) in units of g."""
        motion, gravity = self._parts
        return motion + sum(x * axis for x, axis in zip(direction, gravity))

    @functools.cached_property
    def described(self):
        """Torques (n, nv) of the described bodies."""
        return self.regressor @ self.bodies.parameters

    @functools.cached_property
    def floating(self):
        """The described robot without gravity."""
        return DescribedRobot(self.bodies, self.signals, self.times, self._parts[0])

    @functools.cached_property
    def unit_weights(self):
        """Torques (n, nv, 3) of the described bodies by 1 g along each axis."""
        bodies = self.bodies.parameters
        return np.stack([x @ bodies for x in self._parts[1]], axis=-1)

    @property
    def weight(self):
        """Torques (n, nv) of the described bodies by gravity alone."""
        return self.described - self.floating.described

    @functools.cached_property
    def baseline(self):
        """`BodyFit` of the unchanged torques."""
        return self.fit()

    @functools.cached_property
    def invented(self):
        """Log odds of inaccurate (invented) inertias against the described ones."""
        # A link without mass may be a body that the description lacks.
        missing = self.bodies.parameters[::10] <= 0
        return self._prior_odds(missing, number.INVENTED)

    @functools.cached_property
    def loaded(self):
        """Log odds of invented inertias, or of a load, against the described ones."""
        return max(self.invented, self._prior_odds(self.bodies.leaf, 1.0))

    def _prior_odds(self, unknown, factor):
        """Return the log odds, at least zero, of a wider prior of the bodies."""
        # That of some (nv,) is as wide as the widest, that of others by a factor wider.
        spread = self.bodies.prior_std.reshape(-1, 10)
        ratio = np.where(unknown[:, None], spread.max(axis=0) / spread, factor).ravel()
        return max(0.0, self.fit(spread=ratio).evidence - self.baseline.evidence)

    def spring_evidence(self, joints, turns=False):
        """Return the evidence for springs and, with turns, for counterbalances."""
        # In a small motion, a missing or turned weight is linear in the positions.
        nv, tau = self.bodies.nv, self.signals.tau
        q = self.signals.states[:, :nv] - self.signals.states[:, :nv].mean(axis=0)
        size = np.sqrt((q**2).mean(axis=0))
        ratio = np.sqrt((tau**2).mean(axis=0))[:, None] / np.where(size > 0, size, 1.0)
        # A stiffness between two joints acts on both.
        stiffness = np.zeros((nv, nv, nv * (nv + 1) // 2))
        for k, (i, j) in enumerate(combinations_with_replacement(range(nv), 2)):
            stiffness[[i, j], [j, i], k] = max(ratio[i, j], ratio[j, i])
        functions = np.stack([q, np.sin(q), np.cos(q)] if turns else [q])
        columns = np.einsum("fnj,ijk->nifk", functions, stiffness).reshape(*q.shape, -1)
        return self.fit(columns=columns, deviation=1.0, joints=joints).evidence

    @functools.cached_property
    def springs(self):
        """Log odds of springs at and between all joints, against none."""
        return self.spring_evidence(self.joints) - self.baseline.evidence

    @functools.cached_property
    def one_joint(self):
        """Log odds, at least zero, of a factor and spring of one torque of several."""
        q, tau = self.signals.states[:, : self.bodies.nv], self.signals.tau
        stiffness = tau.std(axis=0) / np.maximum(q.std(axis=0), 1e-99)
        columns = np.stack([self.described, stiffness * (q - q.mean(axis=0))], axis=-1)
        one = np.eye(self.bodies.nv)[self.joints, :, None] * (self.joints.size > 1)
        fits = [self.fit(columns=columns * x, deviation=1.0).evidence for x in one]
        return max(0.0, max(fits) - self.baseline.evidence)

    @functools.cached_property
    def load_friction(self):
        """Log odds of load-dependent friction in all joints, against none."""
        sizes = np.abs(self.described) * self.signals.sign
        columns = sizes[:, :, None] * np.eye(self.bodies.nv)
        fit = self.fit(columns=columns, deviation=number.LOSS)
        return fit.evidence - self.baseline.evidence

    @property
    def unmodelled(self):
        """Log odds of invented inertias, springs or load-dependent friction."""
        return max(self.invented, self.springs, self.load_friction)

    def surpasses(self, log_odds):
        """Whether log odds far exceed those of what a description may lack."""
        return log_odds > self.unmodelled + number.FAR_ODDS

    @property
    def sizes(self):
        """Standard deviation of each torque over that of the described one, (nv,)."""
        described = self.described.std(axis=0)
        return self.signals.tau.std(axis=0) / np.where(described > 0, described, np.nan)

    def fit(
        self,
        X=None,
        *,
        tau=None,
        spread=1.0,
        mean=None,
        columns=None,
        deviation=number.FACTOR,
        joints=None,
    ):
        """Fit torques (n, nv) minus a mean; estimate factors of columns (n, nv, m)."""
        # spread, deviation: factor of the bodies' prior deviations, and factors' own.
        bodies = self.bodies
        X = self.regressor if X is None else X
        tau = self.signals.tau if tau is None else tau
        joints = self.joints if joints is None else np.asarray(joints)
        mean = X @ bodies.parameters if mean is None else mean
        m = 0 if columns is None else columns.shape[2]
        prior = np.r_[spread * bodies.prior_std, np.full(m, deviation)]
        n_inertial, terms = bodies.prior_std.size, []
        for j in joints:
            rows, used = self.rows[j], bodies.used[j]
            design = X[rows, j][:, used]
            if m:
                joint_columns = columns[rows, j]
                is_active = joint_columns.any(axis=0)
                design = np.hstack([design, joint_columns[:, is_active]])
                used = np.r_[used, n_inertial + np.flatnonzero(is_active)]
            y = tau[rows, j]
            nuisance_std = number.WIDE * max(np.sqrt(np.mean(y**2)), 1e-300)
            nuisance = nuisance_std * self.friction(j)[rows]
            table = np.column_stack([nuisance, design * prior[used], y - mean[rows, j]])
            moments = table.T @ table / self.times[j]
            terms.append((used, moments, rows.size / self.times[j], np.var(y) + 1e-300))
        return _solve(terms, prior, m)

    def deviates(self, part):
        """Whether some rows fit far worse than the others, or with other masses."""
        whole, (share, size), (usual, other) = self.losses(part)
        if not whole.size:
            # Next to positions in degrees, those in radians appear to be at rest.
            moves = self.signals.weight[part].sum(axis=0)
            return bool((moves > number.FEWEST_ROWS).any())
        worse = (share - usual)[share > 2 * np.log(number.GOOD_FIT)]
        apart = np.logaddexp(np.log(part.mean()) + size, np.log((~part).mean()) + other)
        return bool(np.r_[whole - apart, worse - number.CLEAR].max() > number.CLEAR)

    def losses(self, part):
        """Return logs of variances left (k,), and of shares and these by two parts."""
        moves = np.array([self.signals.weight[x].sum(axis=0) for x in (part, ~part)])
        joints = self.joints[moves.min(axis=0)[self.joints] > number.FEWEST_ROWS]
        if not joints.size:
            return np.zeros(0), *np.zeros((2, 2, 0))
        pairs = (
            (self.signals.select_rows(x), self.regressor[x]) for x in (part, ~part)
        )
        fits = (DescribedRobot(self.bodies, x, self.times, y) for x, y in pairs)
        return self._loss(joints)[1], *(fit._loss(joints) for fit in fits)

    def _loss(self, joints):
        """Return logs of the unexplained share and variance (k,) of joints' torques."""
        log_share = self.fit(joints=joints).loss
        variances = [self.signals.tau[self.rows[j], j].var() for j in joints]
        return log_share, log_share + np.log(variances)

    def residual(self, columns=None):
        """Return residuals (n, nv) of a separate fit of each joint, zero at rest."""
        signals, residual = self.signals, np.zeros(self.signals.tau.shape)
        for j in self.joints:
            rows, X = self.rows[j], self.design(j, columns)[self.rows[j]]
            gram = X.T @ X + 1e-6 * rows.size * np.eye(X.shape[1])
            y = signals.tau[rows, j]
            residual[rows, j] = y - X @ np.linalg.solve(gram, X.T @ y)
        return residual

    def design(self, j, columns=None):
        """Columns (n, p) of a joint's bodies, friction and offsets, zero at rest."""
        extra = [] if columns is None else [columns]
        rigid = self.regressor[:, j][:, self.bodies.used[j]]
        X = np.column_stack([rigid, self.friction(j), *extra])
        X = X * (self.signals.weight[:, [j]] > 0)
        X = X[:, X.any(axis=0)]
        return X / np.sqrt((X[self.rows[j]] ** 2).mean(axis=0))

    def errors(self):
        """Relative errors (n_joints,) of separate fits of each joint's torque."""
        residual, errors = self.residual(), []
        for j in self.joints:
            rows, torque = self.rows[j], self.signals.tau[:, j]
            # Correct for the degrees of freedom of the fit.
            dof = max(1 - (self.bodies.used[j].size + 4) / rows.size, 0.1)
            errors.append(residual[rows, j].var() / dof / (torque[rows].var() + 1e-300))
        return np.sqrt(errors)

    @functools.cached_property
    def explained(self):
        """Joints (k,) of which a separate fit explains most of the torque."""
        return self.joints[self.errors() < number.WORST]

    def friction(self, j):
        """Columns (n, k) of viscous and Coulomb friction, rotor inertia and offsets."""
        q, v, a = self.signals.states[:, j :: self.bodies.nv].T
        columns = np.column_stack([v, self.signals.sign[:, j], a, np.ones(len(q))])
        size = np.sqrt((columns**2).mean(axis=0))
        return np.hstack([columns / np.where(size > 0, size, 1.0), self._offsets])

    @functools.cached_property
    def _offsets(self):
        """Columns (n, r) of offset differences between recordings, if not many."""
        member = self.signals.recording[:, None] == np.unique(self.signals.recording)
        offsets = number.OFFSETS / number.WIDE * member
        return offsets if 1 < member.shape[1] <= number.MANY else offsets[:, :0]

    def correlation_times(self, columns=None):
        """Correlation times [rows] of the residuals of separate fits of each joint."""
        # columns (n, m): additional regressors of every joint.
        times, residual = np.ones(self.bodies.nv), self.residual(columns)
        for j in self.joints:
            times[j] = correlation_time(residual[self.rows[j], j])
        return times


def correlation_time(x):
    """Return the integrated autocorrelation time [samples] of a series, at least 1."""
    x = x - x.mean()
    power = np.abs(np.fft.rfft(x, 2 * x.size)) ** 2
    correlation = np.fft.irfft(power)[: x.size]
    if correlation[0] <= 0:
        return 1.0
    low = np.flatnonzero(correlation < number.INDEPENDENT * correlation[0])
    stop = low[0] if low.size else x.size // 4
    return max(1.0, 1.0 + 2.0 * float(correlation[1:stop].sum() / correlation[0]))


def _solve(joints, prior, m):
    """Return the `BodyFit` of joints with common parameters and separate noise."""
    # joints: of each, indices of its common parameters (the last m are the factors),
    # moments of [friction and offsets | these | torque] at a standard normal prior,
    # number of independent rows, and torque variance. Noise variances are fixed points
    # (MacKay, Bayesian interpolation, Neural Comp. 4, 1992).
    used, moments, rows, total = zip(*joints)
    indices = np.unique(np.concatenate(used))
    rows, total = np.array(rows), np.array(total)
    n_plain = len(moments[0]) - 1 - used[0].size
    p = indices.size + n_plain * len(joints)
    plain = [np.arange(k, k + n_plain) for k in range(indices.size, p, n_plain)]
    positions = [np.r_[x, np.searchsorted(indices, y)] for x, y in zip(plain, used)]
    blocks, noise, parts = [np.ix_(x, x) for x in positions], 0.01 * total, []
    for iteration in range(number.ITERATIONS):
        A, b = np.eye(p), np.zeros(p)
        for x, block, M, variance in zip(positions, blocks, moments, noise):
            A[block] += M[:-1, :-1] / variance
            b[x] += M[:-1, -1] / variance
        parts = parts or components(A)
        theta, covariance, log_det = solve_spd(A, b, parts=parts)
        coefficients = [np.r_[theta[x], -1.0] for x in positions]
        squares = np.array([x @ M @ x for x, M in zip(coefficients, moments)])
        traces = [np.sum(covariance[x] * M[:-1, :-1]) for x, M in zip(blocks, moments)]
        dof = np.maximum(rows - np.minimum(traces / noise, 0.5 * rows), 1.0)
        previous, noise = noise, np.maximum(squares / dof, number.LEAST_NOISE * total)
        if iteration and np.abs(np.log(noise / previous)).max() < number.CONVERGED:
            break
    penalty = theta @ theta + log_det + np.sum(squares / previous)
    penalty += rows @ np.log(previous / total)
    # Friction dissipates power; negative friction is improbable.
    power = []
    for x, M in zip(plain, moments):
        speed, friction = M[0, :2], x[:2]
        error = speed @ covariance[np.ix_(friction, friction)] @ speed
        power.append(speed @ theta[friction] / np.sqrt(max(error, 1e-300)))
    friction = np.maximum(scipy.special.log_ndtr(power), -number.FRICTION).sum()
    positions = np.flatnonzero(indices >= prior.size - m)
    columns = indices[positions] - prior.size
    factors, errors = np.zeros(m), prior[prior.size - m :].copy()
    factors[columns] = theta[positions] * prior[columns]
    errors[columns] *= np.sqrt(np.maximum(np.diagonal(covariance)[positions], 0.0))
    evidence, loss = float(friction - 0.5 * penalty), np.log(noise / total)
    extra = {"factors": factors, "errors": errors, "power": np.array(power)}
    return BodyFit(evidence=evidence, loss=loss, **extra)
