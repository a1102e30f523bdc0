"""How well torques agree with a robot description, by one likelihood."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.inspection._rivals import body_spread
from sklearn_vbjfa.model import nominal_parameters
from sklearn_vbjfa.robot._features import RigidBodyFeatures

# Entries of all regressors together; more rows cost time without adding evidence.
_MOST_ENTRIES = 2_000_000
_FEWEST, _MOST = 200, 1200
# Deviation of the prior of friction, rotor and offset, in units of the torque.
_WIDE = 10.0
# Deviation of the prior of factors that are estimated.
_FACTOR = 1e3
_ITERATIONS = 20
_LEAST_NOISE = 1e-6
# A torque that varies less than this, relative to the largest, says nothing.
_LEAST_VARIANCE = 1e-12
# Autocorrelation at which residuals count as independent.
_INDEPENDENT = 0.05


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
    """

    evidence: float
    factors: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray


class DescribedRobot:
    """Regressors of a described robot in a recording, by motion and by gravity."""

    # times: correlation times (nv,) [rows] of residuals; readings of one log are only
    # compared with the same.

    def __init__(self, model, signals, times=None):
        nv = model.nv
        thin = int(np.clip(_MOST_ENTRIES // (nv * nv * 10), _FEWEST, _MOST))
        self.model, self.signals = model, signals.thinned(thin)
        states = self.signals.states
        still = states.copy()
        still[:, nv:] = 0.0
        gravity = np.array(model.gravity.linear)
        self.size = float(np.linalg.norm(gravity))
        self.down = gravity / self.size if self.size else np.zeros(3)
        self.motion = _regressors(model, np.zeros(3), states)
        self.gravity = [_regressors(model, 9.81 * x, still) for x in np.eye(3)]
        self.bodies = nominal_parameters(model).ravel()
        self.spread = body_spread(model)
        size = self.signals.now.var(axis=0)
        varies = size > _LEAST_VARIANCE * size.max(initial=0.0)
        self.joints = np.flatnonzero(self.signals.informative() & varies)
        self.rows = [np.flatnonzero(w > 0) for w in self.signals.weight.T]
        self.times = self._correlation_times() if times is None else times

    def pulled(self, direction):
        """Regressors (n, nv, 10 nv) with gravity along a vector (3,), in units of g."""
        parts = zip(np.asarray(direction, dtype=float), self.gravity)
        return self.motion + sum(part * one for part, one in parts)

    @property
    def pull(self):
        """Gravity of the description (3,), in units of g."""
        return self.down * self.size / 9.81

    @property
    def described(self):
        """Regressors (n, nv, 10 nv) with the gravity of the description."""
        return self.pulled(self.pull)

    @property
    def moving(self):
        """Torques (n, nv) of the described bodies without gravity."""
        return self.motion @ self.bodies

    @property
    def weight(self):
        """Torques (n, nv) of the described bodies by gravity alone."""
        return self.described @ self.bodies - self.moving

    def fit(
        self,
        regressors=None,
        *,
        tau=None,
        scale=1.0,
        mean=None,
        columns=None,
        deviation=_FACTOR,
    ):
        """Fit torques (n, nv), less a mean; columns (n, nv, m) get factors."""
        Y = self.described if regressors is None else regressors
        tau = self.signals.now if tau is None else tau
        if mean is None:
            mean = scale * (Y @ self.bodies)
        n_factors = 0 if columns is None else columns.shape[2]
        prior = np.r_[scale * self.spread, np.full(n_factors, deviation)]
        parts = []
        for j in self.joints:
            rows, time = self.rows[j], self.times[j]
            design = Y[rows, j]
            if columns is not None:
                design = np.column_stack([design, columns[rows, j]])
            used = np.flatnonzero(design.any(axis=0) & (prior > 0))
            plain = self._plain(j)[rows]
            y = tau[rows, j]
            wide = _WIDE * max(np.sqrt(np.mean(y**2)), 1e-300)
            own = np.column_stack(
                [design[:, used] * prior[used], plain * wide, y - mean[rows, j]]
            )
            parts.append((used, own.T @ own, rows.size, time, np.var(y) + 1e-300))
        return _solve(parts, prior, n_factors)

    def _plain(self, j):
        """Columns (n, 4) of viscous and Coulomb friction, rotor and offset."""
        q, v, a = self.signals.states[:, j :: self.model.nv].T
        columns = np.column_stack([v, self.signals.sign[:, j], a, np.ones(len(q))])
        size = np.sqrt((columns**2).mean(axis=0))
        return columns / np.where(size > 0, size, 1.0)

    def _correlation_times(self):
        """Correlation times [rows] of what free bodies leave of each joint's torque."""
        found, Y = np.ones(self.model.nv), self.described
        for j in self.joints:
            rows = self.rows[j]
            X = np.column_stack([Y[rows, j], self._plain(j)[rows]])
            X = X[:, X.any(axis=0)]
            X /= np.sqrt((X**2).mean(axis=0))
            y = self.signals.now[rows, j]
            gram = X.T @ X
            gram[np.diag_indices_from(gram)] += 1e-6 * rows.size
            found[j] = correlation_time(y - X @ np.linalg.solve(gram, X.T @ y))
        return found


def without_mass(model):
    """Whether a body of a description has no mass, so that its torques say nothing."""
    return min(one.mass for one in list(model.inertias)[1:]) <= 0


def correlation_time(x):
    """Correlation time [samples] of a series, at least one."""
    x = x - x.mean()
    power = np.abs(np.fft.rfft(x, 2 * x.size)) ** 2
    correlation = np.fft.irfft(power)[: x.size]
    if correlation[0] <= 0:
        return 1.0
    correlation = correlation / correlation[0]
    low = np.flatnonzero(correlation < _INDEPENDENT)
    stop = low[0] if low.size else x.size // 4
    return max(1.0, 1.0 + 2.0 * float(correlation[1:stop].sum()))


def _regressors(model, gravity, states):
    """Regressors (n, nv, 10 nv) of a model under a gravity (3,) [m/s^2]."""
    model = model.copy()
    model.gravity.linear = gravity
    features = RigidBodyFeatures(model, friction=()).load()
    found = np.zeros((len(states), *features.support_.shape))
    found[:, features.support_] = features.entries(states).T
    return found


def _solve(parts, prior, n_factors):
    """`Fit` of joints that share bodies, each with its own plain terms and noise."""
    # parts: used bodies, moments of [design | plain | torque], rows, correlation time
    # and variance of the torque of each joint. Noise variances are found by EM.
    noise = [0.01 * part[-1] for part in parts]
    p = prior.size
    for last in range(_ITERATIONS):
        A, b, plain = np.eye(p), np.zeros(p), []
        for (used, M, _, time, _), variance in zip(parts, noise):
            k, w = used.size, 1.0 / (variance * time)
            H = np.eye(4) + w * M[k:-1, k:-1]
            solved = np.linalg.solve(H, w * M[k:-1])
            A[np.ix_(used, used)] += w * (M[:k, :k] - M[:k, k:-1] @ solved[:, :k])
            b[used] += w * (M[:k, -1] - M[:k, k:-1] @ solved[:, -1])
            plain.append((H, solved))
        covariance = np.linalg.inv(A)
        theta = covariance @ b
        before, noise, log_likelihood = noise, [], 0.0
        for (used, M, n, time, variance), own, (H, solved) in zip(parts, before, plain):
            k = used.size
            phi = solved[:, -1] - solved[:, :k] @ theta[used]
            x = np.r_[theta[used], phi, -1.0]
            squares = float(x @ M @ x)
            shared = covariance[np.ix_(used, used)]
            w = 1.0 / (own * time)
            spent = w * float(np.sum(shared * M[:k, :k])) + 4.0
            rows = n / time
            log_likelihood -= 0.5 * rows * np.log(own) + 0.5 * w * squares
            log_likelihood -= 0.5 * (np.linalg.slogdet(H)[1] + phi @ phi)
            left = max(rows - min(spent, 0.5 * rows), 1.0)
            noise.append(max(squares / time / left, _LEAST_NOISE * variance))
        if last and np.allclose(noise, before, rtol=1e-3):
            break
    evidence = log_likelihood - 0.5 * (theta @ theta + np.linalg.slogdet(A)[1])
    own = slice(p - n_factors, p)
    return Fit(
        evidence=evidence,
        factors=theta[own] * prior[own],
        covariance=covariance[own, own] * np.outer(prior[own], prior[own]),
        noise=np.array(noise),
    )
