"""Scatter, samples and intervals of the parameters of a next recording."""

import functools
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from scipy.special import log_ndtr, logsumexp, ndtri_exp, softmax
from sklearn.utils import check_random_state

from sklearn_vbjfa.effects import declared
from sklearn_vbjfa.equations._features import Follower
from sklearn_vbjfa.equations._plan import effect_places
from sklearn_vbjfa.physical import Options, PhysicalProjector

# Sweeps of Gibbs's sampler for draws outside the possible values.
_SWEEPS = 200
# Eigenvalues of a correlation below this are rounding.
_ROUNDING = 1e-14
# Halvings of an interval that a quantile is in.
_HALVINGS = 70


# -- from recording to recording -------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class BetweenRecordings:
    """How far values are off from one recording to another."""

    # recordings, or groups of them where there are many; one where these are stretches
    # of a single recording
    count: int
    places: np.ndarray  # (k,): parameters that were found in two of them or more
    # (k,): deviation of the next recording's value from the one that was fitted, for a
    # scale of one
    size: np.ndarray
    weights: np.ndarray  # (m, k): probabilities of the scales
    scales: np.ndarray  # (m,), in equal steps of their logarithm

    @property
    def deviations(self):
        """Deviations (m, k) of the next recording's value from the fitted one."""
        return self.scales[:, None] * self.size

    @property
    def std(self):
        """Root mean square deviations (k,)."""
        return np.sqrt((self.weights * self.deviations**2).sum(axis=0))


# -- intervals -------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Marginal:
    """Marginal distribution of a value: a mixture of normals, truncated below."""

    centre: float
    deviations: np.ndarray  # (m,)
    weights: np.ndarray  # (m,)
    lowest: float = -np.inf

    def quantiles(self, levels):
        """Quantiles (n,) of shares (n,), by halving."""
        levels = np.asarray(levels, dtype=float)
        if not self.deviations.max() > 0:
            return np.full(levels.shape, max(self.centre, self.lowest))
        asked = self._above(np.array([self.lowest]))[0] + np.log1p(-levels)
        reach = 50.0 * self.deviations.max()
        low = np.full(levels.shape, max(self.centre - reach, self.lowest))
        high = np.full(levels.shape, max(self.centre, low[0]) + reach)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            more = self._above(middle) > asked
            low, high = np.where(more, middle, low), np.where(more, high, middle)
        return 0.5 * (low + high)

    def _above(self, x):
        """Logarithms of the mixture's shares above x (n,), not cut off."""
        with np.errstate(divide="ignore"):
            own = np.log(self.weights)[:, None]
        z = (self.centre - x) / self.deviations[:, None]
        return logsumexp(own + log_ndtr(z), axis=0)

    def moments(self):
        if not self.deviations.max() > 0:
            return max(self.centre, self.lowest), 0.0
        with np.errstate(divide="ignore"):
            share = np.log(self.weights) + log_ndtr(
                (self.centre - self.lowest) / self.deviations
            )
        mean, std = _cut_off(self.centre, self.deviations, self.lowest)
        weight = softmax(share)
        middle = weight @ mean
        return middle, np.sqrt(weight @ (std**2 + (mean - middle) ** 2))


def _cut_off(centre, deviation, lowest):
    """Means and deviations (m,) of normals that are cut off below."""
    a = (lowest - centre) / deviation
    # from a thousand deviations on they fall as an exponential
    far, a = a > 1e3, np.clip(a, -40.0, 1e3)
    ratio = np.exp(-0.5 * (a**2 + np.log(2 * np.pi)) - log_ndtr(-a))
    share = np.sqrt(np.maximum(1.0 + a * ratio - ratio**2, 0.0))
    mean = np.where(far, lowest + deviation / a, centre + deviation * ratio)
    return mean, np.where(far, deviation / a, deviation * share)


# -- the posterior ---------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """What the fit of a robot knows of all parameters together."""

    theta: np.ndarray  # (p,): of the robot
    # (p,): before the projection; where nothing tells a value, that of the robot
    centre: np.ndarray
    # (p,): deviations within recordings of each by itself, `theta_std_`
    std: np.ndarray
    # (p, p): covariance of the same, with one factor for the scatter in time: what
    # torques tell of sums stays told. Zero for what is held
    covariance: np.ndarray
    between: BetweenRecordings | None
    bodies: np.ndarray  # (n, 10): places of the bodies' parameters
    nonnegative: np.ndarray  # (p,), bool: values of drives that cannot be negative

    @classmethod
    def of(cls, robot):
        if robot.prediction_covariance is None:
            raise ValueError(
                "samples and ranges need the covariance of the parameters, which this "
                "robot does not have: its regressor gives none (leave regressor=None, "
                "or use VBJFARegressor or JFARegressor)."
            )
        covariance = np.zeros(2 * robot.theta_.shape)
        fitted = robot.prediction_covariance.covariance
        finite = np.isfinite(np.diagonal(fitted))
        covariance[np.ix_(finite, finite)] = fitted[np.ix_(finite, finite)]
        # Of values of the geometry only the deviations are known.
        alone = of_the_model(robot) & ~finite & np.isfinite(robot.theta_std_)
        covariance[alone, alone] = robot.theta_std_[alone] ** 2
        moves = np.diagonal(covariance) > 0
        return cls(
            theta=robot.theta_,
            centre=np.where(moves, robot.theta_unconstrained_, robot.theta_),
            std=robot.theta_std_,
            covariance=covariance,
            between=robot.recording_variance,
            bodies=body_places(robot),
            nonnegative=_nonnegative(robot),
        )

    @property
    def within(self):
        """Deviations (p,) of samples within recordings."""
        return np.sqrt(np.diagonal(self.covariance))

    @functools.cached_property
    def off(self):
        """Deviations (p,) from recording to recording."""
        out = np.zeros(self.theta.size)
        if self.between is not None:
            out[self.between.places] = self.between.std
        return out

    def marginal(self, k):
        """Return the `Marginal` of a parameter; None if nothing tells it."""
        if not np.isfinite(self.std[k]):
            return None
        within, weights, off = self.std[k], np.ones(1), np.zeros(1)
        if self.between is not None and k in self.between.places:
            at = int(np.flatnonzero(self.between.places == k)[0])
            weights, off = self.between.weights[:, at], self.between.deviations[:, at]
        return Marginal(
            centre=self.centre[k],
            deviations=np.hypot(within, off),
            weights=weights,
            lowest=0.0 if self.nonnegative[k] else -np.inf,
        )

    def correlation(self):
        """Correlations (p, p) of values in the next recording; nan for constants."""
        total = self.covariance + np.diag(self.off**2)
        size = np.sqrt(np.diagonal(total))
        with np.errstate(divide="ignore", invalid="ignore"):
            return total / np.outer(size, size)

    def sample(self, seed, numbers):
        """Draw parameters (n, p): rows of the endless table that a seed has."""
        # Each row has random numbers of its own, and does not depend on the others.
        rngs = [np.random.default_rng([seed, int(k)]) for k in numbers]
        p, cut = self.theta.size, np.flatnonzero(self.nonnegative & (self.within > 0))
        x = np.array([rng.standard_normal(p) for rng in rngs]) @ _root(self.covariance)
        off = _Off.drawn(self.between, rngs, p)
        _into(x, self.covariance, self.centre, cut, off, rngs)
        bodies = self.bodies.ravel()
        if self.covariance[bodies, bodies].any():
            self._consistent(x, bodies, cut, off, rngs)
        return self.centre + x + off.values

    def _consistent(self, x, bodies, cut, off, rngs):
        """Project the bodies of draws (n, p), in place; the rest follows them."""
        # The nearest consistent bodies in the metric of their posterior. What the rest
        # may be is drawn beside them, so that the torques stay as well as they can.
        rest = np.setdiff1d(np.arange(self.theta.size), bodies)
        own = self.covariance[np.ix_(bodies, bodies)]
        precision = covariance_inverse(own)
        projector = PhysicalProjector(
            metric=precision,
            options=Options(
                body_starts=np.arange(0, bodies.size, 10),
                nonnegative=(),
                anchor=self.theta[bodies],
            ),
        )
        projector.fit(self.theta[bodies][None])
        centre = self.centre[bodies]
        fixed = projector.transform(centre + x[:, bodies]) - centre
        follow = self.covariance[np.ix_(rest, bodies)] @ precision
        left = self.covariance[np.ix_(rest, rest)] - follow @ own @ follow.T
        # Rounding; what bodies do not tell of the rest is never negative.
        left = 0.5 * (left + left.T)
        mean = fixed @ follow.T
        beside = x[:, rest] - x[:, bodies] @ follow.T
        inside = np.flatnonzero(np.isin(rest, cut))
        own_off = _Off(off.between, off.values[:, rest], off.chosen, rest)
        _into(beside, left, self.centre[rest] + mean, inside, own_off, rngs)
        off.values[:, rest] = own_off.values
        x[:, bodies], x[:, rest] = fixed, beside + mean


def of_the_model(robot):
    """Parameters (p,), bool, that are values of effects in the model."""
    return of_effects(robot, lambda effect: effect.in_model)


def body_places(robot):
    """Places (n, 10) of the parameters of bodies, with those of followers."""
    features = robot.features_
    n, nv = features.n_parameters_, features.n_joints_
    starts = np.arange(nv) * (n // nv)
    own = of_effects(robot, lambda effect: isinstance(effect, Follower))
    following = np.flatnonzero(own).reshape(-1, 10)
    return np.vstack([starts[:, None] + np.arange(10), following])


def of_effects(robot, asked):
    """Parameters (p,), bool, of the effects of which something is true."""
    out = [np.zeros(robot.features_.n_parameters_, dtype=bool)]
    out += [np.repeat(asked(one), len(one.coefficients)) for one in robot.effects_]
    return np.concatenate(out)


def _nonnegative(robot):
    """Parameters (p,), bool, of drives that cannot be negative."""
    features = robot.features_
    out = np.zeros(robot.theta_.size, dtype=bool)
    width = features.n_parameters_ // features.n_joints_
    for k, name in enumerate(features.friction_):
        out[10 + k : features.n_parameters_ : width] = bool(declared(name).nonnegative)
    for effect, at in effect_places(robot.effects_, features.n_parameters_):
        out[at] = [name in effect.nonnegative for name in effect.coefficients]
    return out


def seed_of(random_state):
    """Return a whole number for a random state; for one that is a number, itself."""
    if isinstance(random_state, Integral) and random_state >= 0:
        return int(random_state)
    return int(check_random_state(random_state).randint(2**31 - 1))


def check_number(name, value, least):
    is_number = isinstance(value, Integral) and not isinstance(value, bool)
    if not is_number or value < least:
        raise ValueError(
            f"{name} must be a whole number from {least} on; got {value!r}."
        )
    return int(value)


# -- draws -----------------------------------------------------------------------------


def _unit(covariance):
    """Correlations of a covariance (p, p), and the deviations (p,), one for none."""
    size = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    size = np.where(size > 0, size, 1.0)
    return covariance / np.outer(size, size), size


def _spectrum(correlation):
    value, axes = np.linalg.eigh(0.5 * (correlation + correlation.T))
    return np.maximum(value, 0.0), axes


def _root(covariance):
    """Matrix R (p, p) with R' R the covariance; no unit changes a draw with it."""
    correlation, size = _unit(covariance)
    value, axes = _spectrum(correlation)
    return (axes * np.sqrt(value)) @ axes.T * size


def covariance_inverse(covariance):
    """Inverse of a covariance (p, p); zero where nothing varies."""
    correlation, size = _unit(covariance)
    value, axes = _spectrum(correlation)
    value = np.maximum(value, _ROUNDING * value.max())
    moves = np.diagonal(covariance) > 0
    inverse = (axes / value) @ axes.T / np.outer(size, size)
    return inverse * np.outer(moves, moves)


@dataclass(eq=False)
class _Off:
    """How far drawn recordings are off, in all parameters."""

    between: BetweenRecordings | None
    values: np.ndarray  # (n, p)
    chosen: np.ndarray  # (n, k): which deviation each has
    places: np.ndarray  # (p,): the parameters

    @classmethod
    def drawn(cls, between, rngs, p):
        off = cls(between, np.zeros((len(rngs), p)), None, np.arange(p))
        if between is None:
            return off
        k = between.places.size
        share = np.array([rng.random(k) for rng in rngs])
        below = np.cumsum(between.weights, axis=0)
        off.chosen = (share[:, None] > below / below[-1]).sum(axis=1)
        off.chosen = np.minimum(off.chosen, below.shape[0] - 1)
        z = np.array([rng.standard_normal(k) for rng in rngs])
        off.values[:, between.places] = z * between.deviations[off.chosen, np.arange(k)]
        return off

    def place(self, k):
        """Return which of `between` the k-th parameter is; None for none of it."""
        if self.between is None:
            return None
        at = np.flatnonzero(self.between.places == self.places[k])
        return int(at[0]) if at.size else None

    def again(self, rows, k, least, numbers):
        at = self.place(k)
        if at is None:
            return
        deviations = self.between.deviations[:, at]
        scale = deviations[self.chosen[rows, at]]
        value = scale * _tail(least / scale, numbers[:, 0])
        with np.errstate(divide="ignore"):
            weight = np.log(self.between.weights[:, at] / deviations)
        along = weight - 0.5 * (value[:, None] / deviations) ** 2
        below = np.cumsum(softmax(along, axis=1), axis=1)
        new = (numbers[:, 1, None] > below).sum(axis=1)
        self.values[rows, k] = value
        self.chosen[rows, at] = np.minimum(new, deviations.size - 1)


def _tail(least, share):
    """Draw standard normals that are at least so much, by shares (n,) in (0, 1)."""
    return -ndtri_exp(np.log1p(-share) + log_ndtr(-least))


def _into(x, covariance, centre, cut, off, rngs):
    """Move draws x (n, q) to where centre + x + off is not negative, in place."""
    # cut: places in x that may not be. Draws that are possible are drawn rightly as
    # they are, with the others refused; those are drawn one parameter at a time, given
    # all else (Geman and Geman, 1984), which leaves the distribution as it is. What is
    # not cut off follows by its regression.
    centre = np.broadcast_to(centre, x.shape)
    rows = np.flatnonzero((centre + x + off.values)[:, cut].min(axis=1, initial=0) < 0)
    if not rows.size:
        return
    own = covariance[np.ix_(cut, cut)]
    precision = covariance_inverse(own)
    before, now = x[np.ix_(rows, cut)], x[np.ix_(rows, cut)]
    mean, numbers = centre[np.ix_(rows, cut)], [rngs[row] for row in rows]
    for _ in range(_SWEEPS):
        share = np.array([rng.random((cut.size, 3)) for rng in numbers])
        for i, k in enumerate(cut):
            width = 1.0 / np.sqrt(precision[i, i])
            others = now[:, i] - now @ precision[i] * width**2
            least = -mean[:, i] - off.values[rows, k]
            drawn = _tail((least - others) / width, share[:, i, 0])
            now[:, i] = others + width * drawn
            off.again(rows, k, -mean[:, i] - now[:, i], share[:, i, 1:])
    follow = covariance[:, cut] @ precision
    x[rows] += (now - before) @ follow.T
    x[np.ix_(rows, cut)] = now
