"""Error to expect of the next recording, from held-out data and left-out recordings."""

import numpy as np
from scipy import special

from sklearn_vbjfa.effects import RotorInertia, Varied

# Share by which parameters differ between recordings of one robot, median over robots.
# Friction follows the temperature, loads are changed by hand; offsets are shares of the
# deviation of the torque.
_KINDS = {"friction": 0.03, "gain": 0.003, "offset": 0.004, "load": 0.02}
# Deviation of its logarithm, and the share of that variance which all kinds have in
# common.
_WIDTH, _COMMON = 2.4, 0.5
# Share that such differences hardly exceed, and probability that there are none.
_LARGEST, _AGREE = 0.3, 0.1
# Kinds that differ on all joints at once: temperature, and what the robot carries.
_SHARED = (True, False, False, True)
# Model errors are larger where the model was not fitted: logarithm of the factor, a
# part of it over the number of fitted recordings, and its deviation between motions.
# Means and deviations over robots.
_AGAIN, _FIRST, _DIFFER = (0.1, 0.1), (0.2, 0.2), (0.25, 0.5)
# Recordings from which on the differences are measured.
_MEASURED = 3
# Median, and ends: that nothing differs next time is always possible.
_ENDS = (0.5, 0.02, 0.95)
# Draws of the unknown parameters, the smallest visible difference over an error, and
# rows of which the size of torques is taken.
_DRAWS, _SLACK, _ROWS = 4000, 0.2, 4000


class Expectation:
    """Error to expect of the next recording, by its motion.

    The squared error is that on held-out data (noise and model errors) plus the
    differences of parameters between recordings, times the torques that they act on.
    The differences have a prior by kind, whose draws are weighted by recordings that
    were left out in turn.
    """

    # left, floor (nv,): error on held-out data and that of the noise alone, over the
    # spread; scatter (nv,): deviation of the logarithm of the first; left_out (r, nv):
    # errors on each recording of a model fitted to the others, nan where there is none;
    # alone (nv,): of models fitted to single recordings, on other parts of these;
    # motion: `Motions` of the fit; timed: whether effects follow the time

    def __init__(self, left, floor, scatter, left_out, alone, motion, timed=False):
        self._left, self._motion = left, motion
        self._scatter = np.nan_to_num(scatter)
        self.recordings = r = len(left_out)
        known = np.where(left_out > 0, left_out, np.nan) ** 2
        out, some = np.full(left.size, np.nan), np.isfinite(known).any(axis=0)
        out[some] = np.nanmean(known[:, some], axis=0)
        self._noise = np.where(np.isnan(floor), 0.0, np.fmin(floor, left) ** 2)
        # What a model lacks it lacks within a recording, too.
        self._lacks = np.maximum(np.fmin(alone, left) ** 2 - self._noise, 0.0)
        used = np.isfinite(out) & (left > 0) & (r > 1)
        # Squared errors on a recording that was left out have r / (r - 1) of the
        # variance between recordings, and larger model errors; held-out data have (r -
        # 1) / r of it, seldom a quarter of that, unless the model follows the time.
        share, more = max(r - 1, 1) / max(r, 1), np.exp(2 * _robots(max(r - 1, 1))[1])
        between = share * np.nan_to_num(out - self._noise - more * self._lacks)
        most = np.inf if timed else 4.0 * (left**2 - self._noise) / share
        between = np.clip(between, 0.0, np.nan_to_num(most, posinf=np.inf))
        self._weights = special.softmax(self._evidence(between, used), axis=0)

    def _evidence(self, between, used):
        """Logarithms of likelihoods of the variance between recordings, (n, nv + 1)."""
        # Of each joint by its own, and of their mean by all.
        found = np.zeros((_DRAWS, used.size + 1))
        if not used.any():
            return found
        sizes = self._motion.sizes[:, used] ** 2
        expected = (_robots(1)[0][:, :, None] ** 2 * sizes).sum(axis=1)
        # More than recordings ever differ by is left where a few do not tell a value.
        between = np.minimum(between[:, used], np.quantile(expected, 0.99, axis=0))
        # Usually one kind dominates, and the variance is chi-squared.
        least = (_SLACK * self._left[used]) ** 2
        ratio = (between + least) / (expected + least)
        own = 0.5 * (self.recordings - 1) * (np.log(ratio) - ratio)
        found[:, np.append(used, False)] = own
        found[:, np.append(~used, True)] = own.mean(axis=1, keepdims=True)
        return found

    @property
    def source(self):
        """Source of the differences between recordings: these, or other robots."""
        if self.recordings >= _MEASURED:
            return "measured"
        return "partly measured" if self.recordings == 2 else "assumed"

    def of(self, motion=None):
        """Expect errors for a motion, by default one like the fitted, (3, nv + 1)."""
        # Median and ends in nine of ten recordings of the error of each joint, nan for
        # one that was not judged, and of the mean of the joints.
        motion, count = motion or self._motion, max(self.recordings, 1)
        differ, again, motions = _robots(count)
        lacks = self._lacks * self._motion.distance(motion)
        rng, nv = np.random.default_rng(1), lacks.size
        values = rng.standard_normal((_DRAWS, len(_KINDS), nv))
        values[:, _SHARED] = values[:, _SHARED, :1]
        change, luck = rng.standard_normal((2, _DRAWS, nv))
        alone = self._noise + lacks * np.exp(2 * (again + motions * change))
        squares = alone * np.exp(2 * self._scatter * luck)
        shifts = differ[:, :, None] * motion.sizes * values
        errors = np.sqrt(squares + (1 + 1 / count) * (shifts**2).sum(axis=1))
        judged = np.flatnonzero(np.isfinite(self._left))
        found = np.full((len(_ENDS), nv + 1), np.nan)
        if judged.size:
            errors = np.column_stack([errors, errors[:, judged].mean(axis=1)])
            for k in (*judged, nv):
                order = np.argsort(errors[:, k])
                done = np.cumsum(self._weights[order, k])
                found[:, k] = errors[order[np.searchsorted(done, _ENDS)], k]
        return found


def _robots(count):
    """Draw how recordings of robots differ: by kind, again and between motions."""
    # count: recordings that are fitted
    rng = np.random.default_rng(0)
    medians = np.array([*_KINDS.values()])
    common, own = np.sqrt([_COMMON, 1.0 - _COMMON])
    drawn = common * rng.standard_normal((_DRAWS, 1))
    drawn = drawn + own * rng.standard_normal((_DRAWS, medians.size))
    differ = medians * np.exp(_WIDTH * drawn)
    differ /= 1.0 + differ / _LARGEST
    differ *= rng.random((_DRAWS, 1)) > _AGREE
    first, other, motions = rng.standard_normal((3, _DRAWS, 1))
    again = _AGAIN[0] + _AGAIN[1] * first + (_FIRST[0] + _FIRST[1] * other) / count
    return differ, again, _DIFFER[0] * np.exp(_DIFFER[1] * motions)


class Motions:
    """Sizes of torques of a motion, and the speeds, accelerations and loads in it."""

    # v, a, load, friction (n, nv); weight (n, nv): zero where a joint rests; spread
    # (nv,): of the torque of the fit

    def __init__(self, v, a, load, friction, weight, spread):
        total = np.maximum(weight.sum(axis=0), 1e-300)

        def size(values):
            return np.sqrt((weight * values**2).sum(axis=0) / total) / spread

        ones = np.ones(weight.shape)
        parts = friction, friction + load, spread * ones, load
        with np.errstate(divide="ignore", invalid="ignore"):
            self.sizes = np.nan_to_num([size(values) for values in parts])
        rows = np.stack([ones, v, v * np.abs(v), a, load], axis=-1)
        self._moments = np.einsum("nj,njk,njl->jkl", weight / total, rows, rows)

    def distance(self, other):
        """Leverage of the rows of a motion over that of these, at least 1."""
        found = np.ones(len(self._moments))
        for j, (own, rows) in enumerate(zip(self._moments, other._moments)):
            if (size := np.trace(own)) > 0:
                rank = np.linalg.matrix_rank(own, tol=1e-9 * size, hermitian=True)
                inverse = np.linalg.pinv(own, rcond=1e-9, hermitian=True)
                found[j] = np.trace(inverse @ rows) / rank
        return np.maximum(found, 1.0)


def motions_of(identifier, states, predicted, weight, spread):
    """`Motions` of states (n, 3 nv) with predicted torques and weights (n, nv)."""
    # Torques are divided into friction and load.
    rows = np.linspace(0, len(states) - 1, min(len(states), _ROWS)).astype(int)
    states, features = states[rows], identifier.features_
    theta = identifier.theta_[: features.n_parameters_]
    theta = theta.reshape(features.n_joints_, -1)
    plain = features.declared(states) * theta[:, 10:]
    rotor = [name == RotorInertia.name for name in features.friction_]
    friction = plain[:, :, ~np.array(rotor, dtype=bool)].sum(axis=2)
    load = features.torques(*np.split(states, 3, axis=1), theta[:, :10])
    load += plain[:, :, rotor].sum(axis=2)
    for effect in identifier.effects_:
        varies = isinstance(effect, Varied) and effect.of != "offset"
        if varies or not {"speed", "direction"}.isdisjoint(effect.depends):
            # The torque of the effects of such a joint.
            friction[:, effect.joint] = (predicted[rows] - load)[:, effect.joint]
    _, v, a = np.split(states, 3, axis=1)
    return Motions(v, a, load, friction, weight[rows], spread)
