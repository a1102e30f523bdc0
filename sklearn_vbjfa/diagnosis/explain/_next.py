"""Expected error on the next recording, from held-out data and recordings."""

import numpy as np
from scipy import special

from sklearn_vbjfa.effects import RotorInertia, Varied

# Relative standard deviation of parameters between recordings of one robot, median over
# robots. Friction varies with temperature, the load with the payload; offsets are
# relative to the standard deviation of the torque.
_KINDS = {"friction": 0.03, "gain": 0.003, "offset": 0.004, "load": 0.02}
# Standard deviation of its logarithm over robots, and its variance's common share.
_WIDTH, _COMMON = 2.4, 0.5
# Saturation level of these deviations, and probability that they are zero.
_MAX_SHARE, _P_NONE = 0.3, 0.1
# Kinds whose deviation all joints share: temperature and payload.
_SHARED = (True, False, False, True)
# Model errors grow outside the fitted data: logarithm of the factor, a second term
# divided by the number of fitted recordings, and standard deviation between motions;
# each with mean and standard deviation over robots.
_FACTOR, _FIRST, _BETWEEN = (0.1, 0.1), (0.2, 0.2), (0.25, 0.5)
# Minimum number of recordings from which deviations count as measured.
_MEASURED = 3
# Quantiles: median and ends. The lower end allows for no deviation at all.
_LEVELS = (0.5, 0.02, 0.95)
# Number of prior draws, smallest detectable deviation over the error, and number of
# rows for the root mean squares of torques.
_DRAWS, _DETECTABLE, _ROWS = 4000, 0.2, 4000


class ExpectedError:
    """Expected error on the next recording, given its motion.

    The squared error is that on held-out data (noise and model error) plus the variance
    of parameters between recordings times the torques that they scale. This variance
    has a prior by kind, whose draws are weighted by the errors on left-out recordings.
    """

    # error, floor (nv,): held-out error and noise floor over the spread; scatter (nv,):
    # standard deviation of the logarithm of the error; left_out (r, nv): errors on each
    # recording of a model fitted to the others, nan if missing; single (nv,): errors of
    # models fitted to single recordings, on held-out parts of these; motion: of the
    # fit; timed: whether effects depend on time

    def __init__(self, error, floor, scatter, left_out, single, motion, timed=False):
        self._error, self._motion = error, motion
        self._scatter = np.nan_to_num(scatter)
        self.recordings = r = len(left_out)
        valid = left_out > 0
        out = np.sum(left_out**2, axis=0, where=valid)
        out /= np.where(valid.any(axis=0), valid.sum(axis=0), np.nan)
        self._noise = np.where(np.isnan(floor), 0.0, np.fmin(floor, error) ** 2)
        # Model error is also present within a single recording.
        self._model_error = np.maximum(np.fmin(single, error) ** 2 - self._noise, 0.0)
        used = np.isfinite(out) & (error > 0) & (r > 1)
        # Squared errors on a left-out recording contain r / (r - 1) of the variance
        # between recordings, and larger model errors; those on held-out data contain
        # (r - 1) / r, or at least a quarter of that unless the model depends on time.
        share, more = max(r - 1, 1) / max(r, 1), np.exp(2 * _prior(max(r - 1, 1))[1])
        between = share * np.nan_to_num(out - self._noise - more * self._model_error)
        limit = np.inf if timed else 4.0 * (error**2 - self._noise) / share
        between = np.clip(between, 0.0, np.nan_to_num(limit, posinf=np.inf))
        self._weights = special.softmax(self._evidence(between, used), axis=0)

    def _evidence(self, between, used):
        """Log likelihoods of the variance between recordings, (n, nv + 1)."""
        # For each joint from its variance, for their mean from all variances.
        log_likelihood = np.zeros((_DRAWS, used.size + 1))
        if not used.any():
            return log_likelihood
        sizes = self._motion.sizes[:, used] ** 2
        expected = (_prior(1)[0][:, :, None] ** 2 * sizes).sum(axis=1)
        # Outliers of a few recordings exceed any plausible variance.
        between = np.minimum(between[:, used], np.quantile(expected, 0.99, axis=0))
        # Chi-squared likelihood, since usually one kind dominates.
        least = (_DETECTABLE * self._error[used]) ** 2
        ratio = (between + least) / (expected + least)
        terms = 0.5 * (self.recordings - 1) * (np.log(ratio) - ratio)
        log_likelihood[:, np.append(used, False)] = terms
        log_likelihood[:, np.append(~used, True)] = terms.mean(axis=1, keepdims=True)
        return log_likelihood

    @property
    def source(self):
        """Source of the variance between recordings: measured here, or other robots."""
        if self.recordings >= _MEASURED:
            return "measured"
        return "partly measured" if self.recordings == 2 else "assumed"

    def of(self, motion=None):
        """Predict errors for a motion, by default the fitted one, (3, nv + 1)."""
        # Median and interval (nine of ten recordings) of the error of each joint, nan
        # without held-out error, and of the mean over joints.
        motion, count = motion or self._motion, max(self.recordings, 1)
        deviations, growth, sigma = _prior(count)
        model_error = self._model_error * self._motion.distance(motion)
        rng, nv = np.random.default_rng(1), model_error.size
        values = rng.standard_normal((_DRAWS, len(_KINDS), nv))
        values[:, _SHARED] = values[:, _SHARED, :1]
        change, noise = rng.standard_normal((2, _DRAWS, nv))
        power = self._noise + model_error * np.exp(2 * (growth + sigma * change))
        squares = power * np.exp(2 * self._scatter * noise)
        shifts = deviations[:, :, None] * motion.sizes * values
        errors = np.sqrt(squares + (1 + 1 / count) * (shifts**2).sum(axis=1))
        judged = np.flatnonzero(np.isfinite(self._error))
        quantiles = np.full((len(_LEVELS), nv + 1), np.nan)
        if judged.size:
            errors = np.column_stack([errors, errors[:, judged].mean(axis=1)])
            for k in (*judged, nv):
                order = np.argsort(errors[:, k])
                cumulative = np.cumsum(self._weights[order, k])
                quantiles[:, k] = errors[order[np.searchsorted(cumulative, _LEVELS)], k]
        return quantiles


def _prior(count):
    """Draw parameter deviations by kind, and log factors on the model error."""
    # count: number of fitted recordings
    rng = np.random.default_rng(0)
    medians = np.array([*_KINDS.values()])
    common, single = np.sqrt([_COMMON, 1.0 - _COMMON])
    draws = common * rng.standard_normal((_DRAWS, 1))
    draws = draws + single * rng.standard_normal((_DRAWS, medians.size))
    deviations = medians * np.exp(_WIDTH * draws)
    deviations /= 1.0 + deviations / _MAX_SHARE
    deviations *= rng.random((_DRAWS, 1)) > _P_NONE
    first, other, sigma = rng.standard_normal((3, _DRAWS, 1))
    growth = _FACTOR[0] + _FACTOR[1] * first + (_FIRST[0] + _FIRST[1] * other) / count
    return deviations, growth, _BETWEEN[0] * np.exp(_BETWEEN[1] * sigma)


class MotionStatistics:
    """Root mean squares of torques of a motion, and moments of its regressors."""

    # v, a, load, friction (n, nv); weight (n, nv): zero for joints at rest; spread
    # (nv,): standard deviation of the torque of the fit

    def __init__(self, v, a, load, friction, weight, spread):
        total, ones = np.maximum(weight.sum(axis=0), 1e-300), np.ones(weight.shape)
        parts = np.array([friction, friction + load, spread * ones, load])
        with np.errstate(divide="ignore", invalid="ignore"):
            rms = np.sqrt((weight * parts**2).sum(axis=1) / total)
            self.sizes = np.nan_to_num(rms / spread)
        rows = np.stack([ones, v, v * np.abs(v), a, load], axis=-1)
        self._moments = np.einsum("nj,njk,njl->jkl", weight / total, rows, rows)

    def distance(self, other):
        """Return the relative leverage (nv,) of the rows of a motion, at least 1."""
        inverse = np.linalg.pinv(self._moments, rcond=1e-9, hermitian=True)
        leverage = np.einsum("jkl,jlk->j", inverse, other._moments)
        tolerance = 1e-9 * np.einsum("jkk->j", self._moments)
        rank = np.linalg.matrix_rank(self._moments, tol=tolerance, hermitian=True)
        # The rank is zero for joints at rest.
        return np.maximum(leverage / np.maximum(rank, 1), 1.0)


def motion_statistics(identifier, states, predicted, weight, spread):
    """Compute statistics of states (n, 3 nv), torques and weights (n, nv)."""
    # Torques are separated into friction and load.
    rows = np.linspace(0, len(states) - 1, min(len(states), _ROWS)).astype(int)
    states, features = states[rows], identifier.features_
    theta = identifier.theta_[: features.n_parameters_]
    theta = theta.reshape(features.n_joints_, -1)
    plain = features.declared(states) * theta[:, 10:]
    rotor = [name == RotorInertia.name for name in features.friction_]
    friction = plain[:, :, ~np.array(rotor, dtype=bool)].sum(axis=2)
    q, v, a = np.split(states, 3, axis=1)
    load = identifier.robot_.rigid(q, v, a) + plain[:, :, rotor].sum(axis=2)
    for effect in identifier.effects_:
        varies = isinstance(effect, Varied) and effect.of != "offset"
        if varies or not {"speed", "direction"}.isdisjoint(effect.depends):
            # All torque but the load counts as friction.
            friction[:, effect.joint] = (predicted[rows] - load)[:, effect.joint]
    return MotionStatistics(v, a, load, friction, weight[rows], spread)
