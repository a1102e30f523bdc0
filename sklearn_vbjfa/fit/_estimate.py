"""From second moments to parameters: regression, projection, identifiability."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import ROUNDING, ScaledEigen, scaled_eigen
from sklearn_vbjfa.effects import declared
from sklearn_vbjfa.equations._features import nominal_followers
from sklearn_vbjfa.equations._joint_moments import JointMoments, block_scatter
from sklearn_vbjfa.equations._plan import effect_indices
from sklearn_vbjfa.fit._bodies import (
    BodyPosterior,
    around,
    as_described,
    complete,
    little_learned,
)
from sklearn_vbjfa.model import nominal_parameters
from sklearn_vbjfa.physical import Options, PhysicalProjector
from sklearn_vbjfa.regression import (
    BaseJointFactorRegressor,
    VBJFARegressor,
    fit_moments,
)
from sklearn_vbjfa.robot._posterior import min_eigenvalues

# Largest weight of a joint's equations in units of its mean squared torque: no robot is
# modelled better than to 1e-4 of its torque. Without noise, the weight of a joint that
# is fitted already would hide what only the others show.
_FINEST = 1e8
# Directions of parameter space that the data determine less than this, relative to
# the best-determined one in scaled columns, count as unidentifiable, ...
IDENTIFIABLE = 1e-9
# ... and so does a parameter with more than this share in such directions.
LOST = 1e-6
# Iterations of the joints' weights, and the relative change that ends them.
_MOST_WEIGHTINGS, _SETTLED = 30, 1e-6
# Student's t has a deviation from three degrees of freedom on.
_LEAST_FREEDOM = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Parameters shared by all joints, and their uncertainty."""

    # (p,): parameters after and before a projection
    theta: np.ndarray
    theta_unconstrained: np.ndarray
    # (p,): posterior deviations of the latter, accounting for residuals correlated in
    # time; nan if the regressor provides none
    std: np.ndarray
    joint_weights: np.ndarray  # (nv,): of the joints' equations [1 / torque squared]
    # (p, p): weighted Gram matrix, input noise subtracted, X_t' X_t of eq. 35
    metric: np.ndarray
    # of the fit; of a single recording the stretches in place of blocks of time
    moments: JointMoments
    regressor: object  # None where the description is the prior
    # (p, p): posterior, with one factor for residuals correlated in time; infinite on
    # the diagonal where nothing tells a parameter, None if the regressor has none
    covariance: np.ndarray | None = None
    projector: object = None
    bodies: object = None  # what the description added, where bodies have a prior
    # (p,): factors by which residuals correlated in time widen the deviations
    wider: np.ndarray | None = None
    pooled: float = 1.0  # that of the variance in the mean of all directions
    alike: tuple = ()  # `AlikeValue` of joints that are near each other

    @property
    def identifiable(self):
        """Parameters determined individually by the data, (p,), bool."""
        return identifiable(self.metric)

    @property
    def posterior_metric(self):
        """`metric` with what the description adds in the same units, (p, p)."""
        if self.bodies is None:
            return self.metric
        metric = self.metric + self.bodies.noise * self.bodies.prior
        # What is held does not give way to anything else.
        held = self.prior_std == 0
        metric[np.not_equal.outer(held, held)] = 0.0
        return metric

    @property
    def prior_std(self):
        """Deviations (p,) by the description alone; nan for what it does not say."""
        if self.bodies is None:
            return np.full(self.theta.size, np.nan)
        return self.bodies.before

    @property
    def from_description(self):
        """Parameters (p,), bool, that the data determine less than the description."""
        return little_learned(self.std, self.prior_std)

    def noise(self):
        """Residual deviations (nv,) due to input noise, and the rest [N m or N]."""
        return self.moments.split_residual(self.theta)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlainEstimate:
    """Least squares without a prior and without a projection."""

    theta: np.ndarray  # (p,): directions that the data do not determine are left out
    covariance: np.ndarray  # (p, p): without these directions
    known: np.ndarray  # (p,): parameters that the data determine individually
    eigen: ScaledEigen  # of the Gram matrix, input noise subtracted

    @property
    def std(self):
        return np.sqrt(np.diagonal(self.covariance))


def from_moments(regressor):
    """Whether a regressor (None: the default) needs second moments only."""
    return regressor is None or isinstance(regressor, BaseJointFactorRegressor)


def estimate(
    moments, regressor=None, *, joint_weights="auto", rows=(), described=False
):
    """Estimate one parameter vector from the equations of all joints; not projected."""
    # regressor: linear, which is cloned; joint_weights: "auto", None or (nv,); rows:
    # the equations themselves, if the regressor needs them; described: whether the
    # description will be the prior, so that the equations alone count here.
    weight = resolve_weights(joint_weights, moments)
    total, noise = moments.total(weight), moments.total_noise(weight)
    metric = denoised(total, noise)
    covariance = None
    if described:
        theta = scaled_eigen(metric, IDENTIFIABLE).solve(total.S_xy)
        regressor, std = None, np.full(theta.shape, np.nan)
    else:
        if regressor is None:
            # Bayesian regression with automatic relevance determination.
            regressor = VBJFARegressor(latent="correlated", query="noiseless")
        regressor = clone(regressor)
        if from_moments(regressor):
            theta, std, covariance = _fit_moments(regressor, total, noise)
        else:
            theta, std = _fit_rows(regressor, rows, weight, total)
    wider, pooled = _correlation(moments, weight, theta)
    return Estimate(
        theta=theta,
        theta_unconstrained=theta,
        std=std * wider,
        covariance=None if covariance is None else pooled * covariance,
        joint_weights=weight,
        metric=metric,
        moments=moments.in_stretches(),
        regressor=regressor,
        wider=wider,
        pooled=pooled,
    )


def plain_estimate(moments, joint_weights="auto", bodies=None):
    """Estimate by weighted least squares without a prior, input noise corrected for."""
    # Its covariance accounts for residuals correlated in time. Directions that the data
    # do not determine are left out. bodies: `BodyPosterior` of an estimate, whose prior
    # is taken as it is, or None. Returns a `PlainEstimate`.
    weight = resolve_weights(joint_weights, moments)
    if isinstance(joint_weights, str):
        most = np.full(weight.size, np.inf)
        np.divide(_FINEST * moments.n, moments.yy, out=most, where=moments.yy > 0)
        weight = np.minimum(weight, most)
    total, noise = moments.total(weight), moments.total_noise(weight)
    metric = denoised(total, noise)
    right, held = total.S_xy, np.zeros(total.S_xy.size, dtype=bool)
    if bodies is not None:
        prior, held = bodies.noise * bodies.prior, bodies.before == 0
        right = right + prior @ bodies.centre
        right = np.where(held, 0.0, right - metric @ np.where(held, bodies.centre, 0.0))
        metric = np.where(held | held[:, None], 0.0, metric + prior)
    found = scaled_eigen(metric, IDENTIFIABLE)
    theta = found.solve(right)
    if held.any():
        theta[held] = bodies.centre[held]
    variance = noise_variance(moments, weight, theta, found.rank)
    wider, _ = _correlation(moments, weight, theta)
    return PlainEstimate(
        theta=theta,
        covariance=found.inverse() * variance * np.outer(wider, wider),
        known=identifiable(metric),
        eigen=found,
    )


def noise_variance(moments, weight, theta, rank, taken=0.0):
    """Weighted mean square of the noise, of which a fit took `rank` directions."""
    # taken: of the sum of squares, by directions that theta does not have
    used = weight > 0
    count = moments.n_rows[used].sum()
    squares = max(weight @ moments.residual_squares(theta) - taken, 0.0)
    # Weights may be fractions of a row; only the count knows what was estimated.
    return squares / moments.n[used].sum() * count / max(count - rank, 1)


def noise_of(found):
    """Variance by which the normal equations of an `Estimate` are divided."""
    # The likelihood is worth what its scatter between blocks of time leaves of it.
    moments, weight = found.moments, found.joint_weights
    rank = scaled_eigen(found.metric, IDENTIFIABLE).rank
    start = found.theta_unconstrained
    return noise_variance(moments, weight, start, rank) * max(found.pooled, 1.0)


def beside_description(found, description, bodies="prior"):
    """Return an `Estimate` with the bodies near their description, or as described."""
    total, noise = found.moments.total(found.joint_weights), noise_of(found)
    way = around if bodies == "prior" else as_described
    posterior = way(description, found.metric / noise, total.S_xy / noise)
    # Deviations: what the prior leaves, and the noise as it scatters in time.
    covariance = posterior.covariance
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    of_prior = ((finite @ posterior.prior) * finite.T).sum(axis=1)
    of_noise = ((finite @ (found.metric / noise)) * finite.T).sum(axis=1)
    wider = found.wider**2 / max(found.pooled, 1.0)
    std = np.sqrt(of_prior + np.maximum(of_noise, 0.0) * wider)
    std = np.where(np.isfinite(np.diagonal(covariance)), std, np.inf)
    # However the residual scatters, data do not make a description worse.
    std = np.fmin(std, posterior.before)
    return replace(
        found,
        theta=posterior.theta,
        theta_unconstrained=posterior.theta,
        std=std,
        covariance=covariance,
        bodies=replace(posterior, noise=noise),
    )


def widening(found):
    """Covariance (p, p), zero where nothing tells a value, and factors (p,) for std."""
    # By these factors residuals correlated in time widen the deviations.
    C = np.where(np.isfinite(found.covariance), found.covariance, 0.0)
    size, ratio = np.sqrt(np.diagonal(C)), np.ones(len(C))
    finite = np.isfinite(found.std) & (size > 0)
    ratio[finite] = found.std[finite] / size[finite]
    return C, ratio


def with_prior(found, at, moved, less, precision, right):
    """Return an `Estimate` with a prior on values at k places, all others following."""
    # moved (k,), less (k, k): change of their means, and of their covariance before it
    # is widened; precision (k, k), right (k,): of the prior, and its product with the
    # mean.
    C, ratio = widening(found)
    follow = scaled_eigen(C[np.ix_(at, at)]).solve(C[at]).T
    theta = found.theta_unconstrained + follow @ moved
    C = C - follow @ less @ follow.T
    std = ratio * np.sqrt(np.maximum(np.diagonal(C), 0.0))
    C = np.where(np.isfinite(found.covariance), 0.5 * (C + C.T), found.covariance)
    changes, bodies = {"theta": theta, "covariance": C}, found.bodies
    if bodies is None:
        # Nothing is said of the values so far.
        bodies = BodyPosterior(
            **changes,
            noise=noise_of(found),
            prior=np.zeros(C.shape),
            before=np.full(theta.size, np.nan),
            centre=np.zeros(theta.size),
        )
    prior, sums = bodies.prior.copy(), bodies.prior @ bodies.centre
    prior[np.ix_(at, at)] += precision
    sums[at] += right
    # The mean of both priors, of these values and of what is tied to them; where they
    # say nothing, that of the estimate.
    tied = np.flatnonzero((prior[at] != 0).any(axis=0))
    centre, within = bodies.centre.copy(), prior[np.ix_(tied, tied)]
    off = np.linalg.lstsq(within, sums[tied] - within @ theta[tied])[0]
    centre[tied] = theta[tied] + off
    return replace(
        found,
        **changes,
        theta_unconstrained=theta,
        std=np.where(np.isfinite(found.std), std, found.std),
        bodies=replace(bodies, **changes, prior=prior, centre=centre),
    )


def resolve_weights(joint_weights, moments):
    """Return the weights (nv,) of the joints' equations; zero without equations."""
    nv = moments.n.size
    if joint_weights is None:
        return np.where(moments.n > 0, 1.0, 0.0)
    if isinstance(joint_weights, str):
        if joint_weights != "auto":
            raise ValueError(
                "joint_weights must be 'auto', None or an array of shape "
                f"({nv},); got {joint_weights!r}."
            )
        return noise_weights(moments)
    weight = np.asarray(joint_weights, dtype=float)
    if weight.shape != (nv,) or not np.isfinite(weight).all() or weight.min() < 0:
        raise ValueError(
            f"joint_weights must hold {nv} finite, non-negative numbers; got "
            f"{joint_weights!r}."
        )
    return np.where(moments.n > 0, weight, 0.0)


def _correlation(moments, weight, theta):
    """Factors (p,) by which residuals correlated in time widen the deviations."""
    # They include the standard deviation of Student's t with the blocks' degrees of
    # freedom, slightly larger than that of a normal distribution. The second value is
    # the factor of the variance in the mean of all directions.
    if moments.blocks is None or not np.isfinite(theta).all():
        return np.ones(theta.size), 1.0
    found = block_scatter(moments, weight, theta)
    freedom = np.maximum(found.freedom, _LEAST_FREEDOM)
    factor = np.sqrt(found.factor * freedom / (freedom - 2.0))
    # Parameters that no equation determines are left unchanged.
    return np.where(np.isfinite(factor), factor, 1.0), found.pooled


def _fit_moments(regressor, total, noise):
    """Fit a regressor to second moments; coefficients (p,), deviations, covariance."""
    regressor.set_params(fit_intercept=False)
    takes_covariance = getattr(regressor, "latent", None) == "correlated"
    if takes_covariance and regressor.input_noise is None:
        # Measured noise or none: rigid-body regressors are far too correlated to
        # assume a noise level. The parameters belong to the noise-free motion.
        measured = 0.0 if noise is None else noise
        regressor.set_params(input_noise=measured, query="noiseless")
    fit_moments(regressor, total)
    return tuple(
        getattr(regressor, name).copy() for name in ("coef_", "coef_std_", "coef_cov_")
    )


def _fit_rows(regressor, rows, joint_weights, total):
    n = total.n_samples
    scale = np.sqrt(np.diagonal(total.S_xx) / n)
    scale = np.where(scale > 0, scale, 1.0)
    y_scale = np.sqrt(total.S_yy / n) or 1.0
    root = np.sqrt(joint_weights)[:, None]

    def stacked(name):
        return np.concatenate(
            [(getattr(one, name) * root)[one.weight > 0] / scale for one in rows]
        )

    A, fit_params = stacked("Phi"), {}
    if rows[0].instruments is not None:
        fit_params["instruments"] = stacked("instruments")
    b = np.concatenate([(one.tau * root[:, 0])[one.weight > 0] for one in rows])
    b = b / y_scale
    weight = np.concatenate([one.weight[one.weight > 0] for one in rows])
    if not np.all(weight == weight[0]):
        # Scale the rows: not every regressor takes sample_weight.
        own = np.sqrt(weight / weight.mean())
        A, b = A * own[:, None], b * own
        fit_params = {name: Z * own[:, None] for name, Z in fit_params.items()}
    parameters = regressor.get_params(deep=True)
    names = {name.split("__")[-1] for name in parameters}
    intercepts = [n for n in parameters if n.split("__")[-1] == "fit_intercept"]
    regressor.set_params(**dict.fromkeys(intercepts, False))
    if not intercepts or "steps" in names:
        # What always centres (PLS, a scaler in a pipeline) sees each equation with
        # its mirror image: the means are zero and nothing is lost.
        A, b = _mirror(A), _mirror(b)
        fit_params = {name: _mirror(Z) for name, Z in fit_params.items()}
    regressor.fit(A, b, **fit_params)
    theta = _read_coefficients(regressor, A[:50])
    std = getattr(regressor, "coef_std_", None)
    unit = y_scale / scale
    std = np.full(theta.shape, np.nan) if std is None else np.ravel(std) * unit
    return theta * unit, std


def _read_coefficients(regressor, sample):
    p = sample.shape[1]
    probe = np.vstack([np.zeros((1, p)), np.eye(p)])
    answer = np.ravel(regressor.predict(probe))
    coef = answer[1:] - answer[0]
    direct = np.ravel(regressor.predict(sample)) - answer[0]
    size = np.abs(sample) @ np.abs(coef) + np.abs(answer[0])
    if np.any(np.abs(direct - sample @ coef) > 1e-6 * size + 1e-300):
        raise ValueError(
            "regressor must be linear in its inputs, since its coefficients are "
            f"the parameters; got {type(regressor).__name__}."
        )
    return coef


def denoised(total, noise):
    """Gram matrix without the input noise's share (X_t' X_t of eq. 35), projected."""
    # Directions in which the noise exceeds the signal keep nothing; noise: or None.
    if noise is None:
        return total.S_xx.copy()
    scale = np.sqrt(np.diagonal(total.S_xx))
    unit = np.where(scale > 0, scale, 1.0)
    signal = total.S_xx - total.n_samples * noise
    root = scaled_eigen(0.5 * (signal + signal.T), 0.0, scale=unit).root()
    # by the scale and not the unit: a column of zeros stays one to the last bit
    root *= scale > 0
    return root.T @ root


def _mirror(rows):
    """Each row followed by its negative: pairs stay together in any block split."""
    return np.stack([rows, -rows], axis=1).reshape(-1, *rows.shape[1:])


# -- projection ------------------------------------------------------------------------


def project(found, projector, features, effects=()):
    """Project an estimate onto the physically consistent parameters of a robot."""
    # Coefficients of effects follow: the distance (eq. 35) is minimised over all.
    if projector is None:
        return found
    theta, metric = found.theta_unconstrained, found.posterior_metric
    # Coefficients of effects that physics requires to be positive.
    positive = [
        places[k]
        for effect, places in effect_indices(effects, features.n_parameters_)
        for k, name in enumerate(effect.coefficients)
        if name in effect.nonnegative
    ]
    if positive:
        theta, metric = _without_negative(theta, metric, np.array(positive))
    fitted = _fit_projector(projector, features, theta, metric)
    # At their bound sizes stay zero, without the rounding of the solver.
    bound = theta[positive] == 0
    theta = fitted.transform(theta[None])[0]
    theta[positive] = np.where(bound, 0.0, np.maximum(theta[positive], 0.0))
    kept = np.where(found.prior_std == 0, found.theta_unconstrained, theta)
    own = kept[: features.n_parameters_].reshape(features.n_joints_, -1)
    if (min_eigenvalues(own) > 0).all():
        # What is held has not moved but for the accuracy of the solver.
        theta = kept
    return replace(found, theta=theta, projector=fitted)


def consistent_anchor(model, theta, metric, per_joint, followers):
    """Return a consistent vector (p,) near the model's parameters, in data's units."""
    # The torques do not depend on some directions; the projection completes them from
    # this point: the described inertias or a solid ball, times a factor to the estimate
    # theta (p,) in the Gram matrix metric (p, p).
    bodies = complete(model, np.vstack([nominal_parameters(model), followers]))
    p = model.nv * per_joint
    anchor = theta[:p].reshape(-1, per_joint).copy()
    anchor[:, 10:] = np.maximum(anchor[:, 10:], 0.0)
    inertial = np.zeros((model.nv, per_joint), dtype=bool)
    inertial[:, :10] = True
    at = np.append(np.flatnonzero(inertial.ravel()), np.arange(p, theta.size))
    block = metric[np.ix_(at, at)]
    nominal, estimate = bodies.ravel(), theta[at]
    seen = nominal @ block @ nominal
    factor = 1.0
    if seen > 0:
        factor = (nominal @ block @ estimate) / seen
        if not factor > 0:
            factor = np.sqrt(max(estimate @ block @ estimate, 0.0) / seen) or 1.0
    anchor[:, :10] = factor * bodies[: model.nv]
    return np.append(anchor.ravel(), factor * bodies[model.nv :])


def _fit_projector(projector, features, theta, metric):
    """Fit a projector to an estimate; its layout and anchor follow from the robot."""
    # theta (p + n_effects,): effects come last and are unconstrained, but for bodies of
    # followers, which come first among them.
    default = isinstance(projector, str)
    if default and projector != "default":
        raise ValueError(
            "projector must be 'default', a PhysicalProjector or None; got "
            f"{projector!r}."
        )
    friction, p = features.friction_, features.n_parameters_
    followers = nominal_followers(features)
    per_joint, bodies = 10 + len(friction), p + followers.size
    never = [10 + k for k, name in enumerate(friction) if declared(name).nonnegative]
    anchor = consistent_anchor(
        features.model_, theta[:bodies], metric[:bodies, :bodies], per_joint, followers
    )
    fitted = PhysicalProjector() if default else clone(projector)
    options = replace(
        fitted.options or Options(),
        body_starts=np.append(np.arange(0, p, per_joint), np.arange(p, bodies, 10)),
        nonnegative=[j + k for j in range(0, p, per_joint) for k in never],
        anchor=np.concatenate([anchor, theta[bodies:]]),
    )
    # Effects have names of their own.
    fitted.set_params(metric=metric, parameter_names=None, options=options)
    return fitted.fit(theta[None])


def identifiable(metric):
    """Parameters (p,), bool, whose unit vectors the data determine."""
    moved = np.diagonal(metric) > 0
    result = np.zeros(moved.size, dtype=bool)
    if moved.any():
        found = scaled_eigen(metric[np.ix_(moved, moved)], IDENTIFIABLE)
        result[moved] = ~found.lost(LOST)
    return result


def _without_negative(theta, metric, places):
    """Take the nearest theta (p,) with places that are not negative, and its metric."""
    # Those at zero stay there, without a metric. An active set finds them exactly,
    # where the columns of neighbouring elements are too alike for the projection.
    rest = np.setdiff1d(np.arange(theta.size), places)
    across = metric[np.ix_(rest, places)]
    follow = scaled_eigen(metric[np.ix_(rest, rest)]).solve(across)
    root = scaled_eigen(metric[np.ix_(places, places)] - across.T @ follow).root()
    sizes, _ = nnls(root, root @ theta[places])
    found, metric = theta.copy(), metric.copy()
    found[rest] -= follow @ (sizes - theta[places])
    found[places] = sizes
    zero = places[sizes == 0]
    metric[zero] = metric[:, zero] = 0.0
    return found, metric


# -- weights of joints -----------------------------------------------------------------


def noise_weights(moments):
    """Inverse residual variance of each joint by iterated weighted least squares."""
    # Starts from the mean squared torques, so the unit of a joint's torque does not
    # matter; a joint without rows gets zero weight.
    used = moments.n > 0
    n = np.where(used, moments.n, 1.0)
    variance = np.where(used & (moments.yy > 0), moments.yy / n, np.inf)
    for _ in range(_MOST_WEIGHTINGS):
        weight = 1.0 / variance
        gram = moments.gram(weight)
        found = scaled_eigen(gram, 2 * ROUNDING * len(gram))
        theta = found.solve(weight @ moments.g)
        new = moments.residual_squares(theta) / n
        new = np.where(np.isfinite(variance), new, np.inf)
        # An exactly fitted joint would get infinite weight.
        new = np.maximum(new, 1e-12 * np.where(used, moments.yy / n, np.inf))
        new = np.where(new > 0, new, np.inf)
        finite = np.isfinite(new)
        change = np.abs(new[finite] / variance[finite] - 1)
        variance = new
        if change.size == 0 or change.max() < _SETTLED:
            break
    return 1.0 / variance
