"""Posterior of the parameters, and their scatter from one recording to the next."""

import functools
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from scipy.special import log_ndtr, logsumexp
from sklearn.utils import check_random_state

from sklearn_vbjfa.effects import POSITION, SPEED, TORQUE, InModel, declared
from sklearn_vbjfa.equations._plan import effect_indices
from sklearn_vbjfa.model._trees import body_names
from sklearn_vbjfa.physical import (
    Options,
    PhysicalProjector,
    body_scales,
    min_eigenvalue,
)

# Eigenvalues of a correlation below this are rounding.
_ROUNDING = 1e-14
# Halvings of an interval that a quantile is in.
_HALVINGS = 70


@dataclass(frozen=True, kw_only=True, eq=False)
class BetweenRecordings:
    """Scatter of the parameters from one recording to another."""

    # recordings, or groups if there are many; one for stretches of a single recording
    count: int
    places: np.ndarray  # (k,): parameters that at least two of them determine
    # (k,): deviation of the next recording's value from the fitted one, at scale one
    size: np.ndarray
    weights: np.ndarray  # (m, k): probabilities of the scales
    scales: np.ndarray  # (m,), in equal steps of their logarithm

    @property
    def deviations(self):
        """Deviations (m, k) of values in the next recording from the fitted ones."""
        return self.scales[:, None] * self.size

    @property
    def std(self):
        """Root mean square deviations (k,)."""
        return np.sqrt((self.weights * self.deviations**2).sum(axis=0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Marginal:
    """Marginal distribution of a value: a mixture of normals, truncated below."""

    centre: float
    deviations: np.ndarray  # (m,)
    weights: np.ndarray  # (m,)
    lowest: float = -np.inf

    def quantiles(self, levels):
        """Quantiles (n,) of probabilities (n,)."""
        return self.inverse_survival(np.log1p(-np.asarray(levels, dtype=float)))

    def inverse_survival(self, logs):
        """Values (n,) of given log survival probabilities, by bisection."""
        if not self.deviations.max() > 0:
            return np.full(logs.shape, max(self.centre, self.lowest))
        wanted = self.log_survival(np.array([self.lowest]))[0] + logs
        reach = 50.0 * self.deviations.max()
        low = np.full(logs.shape, max(self.centre - reach, self.lowest))
        high = np.maximum(self.centre, low) + reach
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            more = self.log_survival(middle) > wanted
            low, high = np.where(more, middle, low), np.where(more, high, middle)
        return 0.5 * (low + high)

    def log_survival(self, x):
        """Log probabilities of values above x (n,), without the truncation."""
        with np.errstate(divide="ignore"):
            log_weights = np.log(self.weights)[:, None]
        z = (self.centre - x) / self.deviations[:, None]
        return logsumexp(log_weights + log_ndtr(z), axis=0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """Joint posterior of all parameters of a robot."""

    theta: np.ndarray  # (p,): of the robot
    # (p,): before the projection; theta where the data determine nothing
    centre: np.ndarray
    # (p,): marginal deviations within recordings, `theta_std_`
    std: np.ndarray
    # (p, p): covariance within recordings, with one factor for the correlation in time,
    # which keeps the deviations of well-known sums. Zero for fixed parameters
    covariance: np.ndarray
    between: BetweenRecordings | None
    bodies: np.ndarray  # (n, 10): indices of the bodies' parameters
    nonnegative: np.ndarray  # (p,), bool: values of drives that cannot be negative

    @classmethod
    def of(cls, robot):
        if robot.covariance is None:
            raise ValueError(
                "samples and ranges need the covariance of the parameters, which this "
                "robot does not have: its regressor gives none (leave regressor=None, "
                "or use VBJFARegressor or JFARegressor)."
            )
        covariance = np.zeros(2 * robot.theta_.shape)
        fitted = robot.covariance
        finite = np.isfinite(np.diagonal(fitted))
        covariance[np.ix_(finite, finite)] = fitted[np.ix_(finite, finite)]
        # For parameters of the geometry only the deviations are known.
        alone = model_parameter_mask(robot) & ~finite & np.isfinite(robot.theta_std_)
        covariance[alone, alone] = robot.theta_std_[alone] ** 2
        moves = np.diagonal(covariance) > 0
        return cls(
            theta=robot.theta_,
            centre=np.where(moves, robot.theta_unconstrained_, robot.theta_),
            std=robot.theta_std_,
            covariance=covariance,
            between=robot.recording_variance,
            bodies=body_indices(robot),
            nonnegative=_nonnegative(robot),
        )

    @property
    def within(self):
        """Deviations (p,) of samples within recordings."""
        return np.sqrt(np.diagonal(self.covariance))

    @functools.cached_property
    def between_std(self):
        """Deviations (p,) from recording to recording."""
        out = np.zeros(self.theta.size)
        if self.between is not None:
            out[self.between.places] = self.between.std
        return out

    def marginal(self, k):
        """Return the `Marginal` of a parameter; None if it is undetermined."""
        return self._mixture(k, self.std[k]) if np.isfinite(self.std[k]) else None

    def _mixture(self, k, within):
        weights, between = np.ones(1), np.zeros(1)
        if self.between is not None and k in self.between.places:
            at = int(np.flatnonzero(self.between.places == k)[0])
            weights = self.between.weights[:, at]
            between = self.between.deviations[:, at]
        return Marginal(
            centre=self.centre[k],
            deviations=np.hypot(within, between),
            weights=weights,
            lowest=0.0 if self.nonnegative[k] else -np.inf,
        )

    def sample(self, seed, numbers):
        """Draw parameters (n, p): rows with these numbers in the sequence of a seed."""
        # Each row has a separate generator and does not depend on the others.
        rngs = [np.random.default_rng([seed, int(k)]) for k in numbers]
        x = np.array([rng.standard_normal(self.theta.size) for rng in rngs])
        # With the symmetric root of the correlations, units do not change a draw.
        value, axes, size = _spectrum(self.covariance)
        drawn = self.centre + x @ ((axes * np.sqrt(value)) @ axes.T * size)
        if self.between is not None:
            drawn[:, self.between.places] += self._draw_between(rngs)
        # Draws of non-negative parameters move to the same quantiles of the truncated
        # marginal. The other parameters follow by regression on the share within the
        # recording, which preserves the torques.
        cut = np.flatnonzero(self.nonnegative & (self.within > 0))
        mixed = [self._mixture(k, self.within[k]) for k in cut]
        logs = [m.log_survival(drawn[:, k]) for k, m in zip(cut, mixed)]
        after = [m.inverse_survival(log) for m, log in zip(mixed, logs)]
        after = np.reshape(after, (-1, len(x)))
        within, between = self.within[cut] ** 2, self.between_std[cut] ** 2
        share = within / (within + between)
        precision = covariance_inverse(self.covariance[np.ix_(cut, cut)])
        moved = share * (after.T - drawn[:, cut])
        drawn += moved @ precision @ self.covariance[cut]
        drawn[:, cut] = after.T
        return self._consistent(drawn)

    def _draw_between(self, rngs):
        """Draw deviations from recording to recording, (n, k)."""
        between, k = self.between, self.between.places.size
        share = np.array([rng.random(k) for rng in rngs])
        below = np.cumsum(between.weights, axis=0)
        chosen = (share[:, None] > below / below[-1]).sum(axis=1)
        chosen = np.minimum(chosen, below.shape[0] - 1)
        z = np.array([rng.standard_normal(k) for rng in rngs])
        return z * between.deviations[chosen, np.arange(k)]

    def _consistent(self, drawn):
        """Project draws (n, p) onto consistent bodies in the posterior's metric."""
        bodies = self.bodies.ravel()
        if not self.covariance[np.ix_(bodies, bodies)].any():
            return drawn
        others = np.setdiff1d(np.flatnonzero(self.within > 0), bodies)
        places = np.concatenate([bodies, others])
        projector = PhysicalProjector(
            metric=covariance_inverse(self.covariance[np.ix_(places, places)]),
            options=Options(
                body_starts=np.arange(0, bodies.size, 10),
                nonnegative=bodies.size + np.flatnonzero(self.nonnegative[others]),
                anchor=self.theta[places],
            ),
        )
        projector.fit(self.theta[places][None])
        drawn[:, places] = projector.transform(drawn[:, places])
        return drawn


def model_parameter_mask(robot):
    """Parameters (p,), bool, of effects in the model."""
    return effect_mask(robot, lambda effect: isinstance(effect, InModel))


def body_indices(robot):
    """Return indices (n, 10) of the parameters of bodies, including followers."""
    features = robot.features_
    n, nv = features.n_parameters_, features.n_joints_
    starts = np.arange(nv) * (n // nv)
    mask = effect_mask(robot, lambda effect: effect.loads)
    following = np.flatnonzero(mask).reshape(-1, 10)
    return np.vstack([starts[:, None] + np.arange(10), following])


def effect_mask(robot, condition):
    """Parameters (p,), bool, of the effects that meet a condition."""
    out = [np.zeros(robot.features_.n_parameters_, dtype=bool)]
    out += [np.repeat(condition(e), len(e.coefficients)) for e in robot.effects_]
    return np.concatenate(out)


def joint_mask(robot, joints):
    """Parameters (p,), bool, of bodies, friction and effects of joints (nv,), bool."""
    mask = effect_mask(robot, lambda e: joints[e.joint] and not isinstance(e, InModel))
    n = robot.features_.n_parameters_
    mask[:n] = np.repeat(joints, n // robot.features_.n_joints_)
    return mask


def _nonnegative(robot):
    """Parameters (p,), bool, of friction and drives that cannot be negative."""
    features = robot.features_
    out = np.zeros(robot.theta_.size, dtype=bool)
    width = features.n_parameters_ // features.n_joints_
    for k, name in enumerate(features.friction_):
        out[10 + k : features.n_parameters_ : width] = bool(declared(name).nonnegative)
    for effect, at in effect_indices(robot.effects_, features.n_parameters_):
        out[at] = [name in effect.nonnegative for name in effect.coefficients]
    return out


def seed_of(random_state):
    """Return a random state as an integer seed."""
    if isinstance(random_state, Integral) and random_state >= 0:
        return int(random_state)
    return int(check_random_state(random_state).randint(2**31 - 1))


def _spectrum(covariance):
    """Eigenvalues and eigenvectors of the correlations, and the deviations."""
    size = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    size = np.where(size > 0, size, 1.0)
    correlation = covariance / np.outer(size, size)
    value, axes = np.linalg.eigh(0.5 * (correlation + correlation.T))
    return np.maximum(value, 0.0), axes, size


def covariance_inverse(covariance):
    """Inverse of a covariance (p, p); zero for parameters without variance."""
    value, axes, size = _spectrum(covariance)
    value = np.maximum(value, _ROUNDING * value.max(initial=0.0))
    moves = np.diagonal(covariance) > 0
    scaled = np.divide(axes, value, out=np.zeros_like(axes), where=value > 0)
    inverse = scaled @ axes.T / np.outer(size, size)
    return inverse * np.outer(moves, moves)


# A mass is known if its deviation, with the change by projection, is below this share.
_KNOWN = 0.5
# Standard deviations within which a value agrees with the description.
_NEAR = 2.0


def min_eigenvalues(bodies):
    """Smallest pseudo-inertia eigenvalues (nv,) of bodies (nv, k), scaled by body."""
    mass, length = body_scales(bodies[:, :10])
    return min_eigenvalue(bodies[:, :10], mass_scale=mass, length_scale=length)


def known_parameters(robot, estimate):
    """Return which parameters of a robot its recording determines, see `known_`."""
    # "yes": individually, to within its standard deviation. "in combination": only
    # together with others. "from the description": the data add little to the prior.
    # "no": no torque depends on it, or it is a mass whose deviation, including the
    # change by the projection, exceeds half its value.
    seen = (np.diagonal(estimate.metric) > 0) | robot.identifiable_
    state = np.where(robot.identifiable_, "yes", "in combination").astype(object)
    state[~seen] = "no"
    masses = body_indices(robot)[: robot.features_.n_joints_, 0]
    moved = robot.theta_ - robot.theta_unconstrained_
    deviation = np.hypot(np.nan_to_num(robot.theta_std_, posinf=np.inf), moved)
    with np.errstate(invalid="ignore"):
        vague = ~(deviation[masses] <= _KNOWN * robot.theta_[masses])
    vague &= robot.identifiable_[masses]
    state[masses[vague]] = "no"
    silent = (state == "no") & np.isfinite(estimate.prior_std)
    described = silent | estimate.from_description
    if estimate.bodies is not None:
        away = np.abs(robot.theta_ - estimate.bodies.centre)
        near = away <= _NEAR * estimate.prior_std
        described &= (estimate.prior_std == 0) | near
    state[described] = "from the description"
    return tuple(state)


def note_of_masses(robot):
    """Name the bodies whose mass, or whose inertia, is not identified."""
    bodies, lines = body_names(robot.features_.model_), []
    known = np.array(robot.robot_.known_)[body_indices(robot)[: len(bodies)]]
    if names := [name for name, body in zip(bodies, known) if body[0] != "yes"]:
        lines.append(
            f"Masses that are not individually identifiable: {', '.join(names)}; the "
            "values of all bodies together reproduce the torques."
        )
    described = (known[:, 4:] == "from the description").all(axis=1)
    if described.any():
        names = [name for name, keep in zip(bodies, described) if keep]
        lines.append(f"Inertias from the description: {', '.join(names)}.")
    return " ".join(lines)


_UNITS = {"position": POSITION, "speed": SPEED, "load": TORQUE}
_WAYS = ("forward motion", "backward motion")
_PLURALS = {"position": "positions", "speed": "speeds", "load": "loads"}


def outside_text(ranges, names, prismatic):
    """Describe the signals outside the ranges of a fit, `OutsideRange` each."""
    texts = []
    for out in ranges:
        share = round(100 * out.share, 0 if out.share > 0.02 else 1)
        rows = f"({', '.join(out.names)}; {share:g} % of the rows)"
        if out.quantity == "direction":
            way, other = _WAYS if out.reached > 0 else _WAYS[::-1]
            texts.append(f"{names[out.joint]}: {way}, fitted on {other} only {rows}")
            continue
        unit = _UNITS[out.quantity][int(prismatic[out.joint])]
        low, high = out.fitted
        texts.append(
            f"{names[out.joint]}: {_PLURALS[out.quantity]} to {out.reached:.3g} {unit},"
            f" fitted on {low:.3g} to {high:.3g} {unit} {rows}"
        )
    return ". ".join(filter(None, ["; ".join(texts), _clipped_text(ranges)]))


def _clipped_text(ranges):
    """Name the effects that are held constant and those that are extrapolated."""
    ranges = [x for x in ranges if x.quantity != "direction"]
    clipped = [name for x in ranges for name in x.clipped]
    others = [name for x in ranges for name in x.names if name not in x.clipped]
    texts = {"Held constant beyond the margin": clipped, "Extrapolated": others}
    return ". ".join(
        f"{what}: {', '.join(dict.fromkeys(names))}"
        for what, names in texts.items()
        if names
    )
