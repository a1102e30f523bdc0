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
    fix_bodies,
    force_solid,
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

# Maximum weight of a joint's equations in units of its mean squared torque, i.e. a
# relative model error of 1e-4. Without noise, the weight of an exactly fitted joint
# would hide parameters that only other joints determine.
_MAX_WEIGHT = 1e8
# Relative eigenvalue of the scaled Gram matrix below which a direction of parameter
# space is not identifiable, ...
IDENTIFIABLE = 1e-9
# ... and share of a parameter in such directions above which it is not identifiable.
NULL_SHARE = 1e-6
# Maximum iterations of the joints' weights, and the relative change that ends them.
_MAX_ITERATIONS, _TOLERANCE = 30, 1e-6
# Student's t has a finite variance from three degrees of freedom on.
_MIN_FREEDOM = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Parameters shared by all joints, and their uncertainty."""

    # (p,): parameters after and before a projection
    theta: np.ndarray
    theta_unconstrained: np.ndarray
    # (p,): posterior standard deviations of the latter, inflated for residuals that are
    # correlated in time; nan if the regressor provides none
    std: np.ndarray
    joint_weights: np.ndarray  # (nv,): of the joints' equations [1 / torque squared]
    # (p, p): weighted Gram matrix, input noise subtracted, X_t' X_t of eq. 35
    metric: np.ndarray
    # of the fit; a single recording has stretches in place of blocks of time
    moments: JointMoments
    regressor: object  # None if the description is the prior
    # (p, p): posterior, with one common inflation factor; infinite on the diagonal if
    # nothing determines a parameter, None if the regressor has none
    covariance: np.ndarray | None = None
    projector: object = None
    bodies: object = None  # `BodyPosterior`, if bodies have a prior
    # (p,): inflation factors of the deviations for residuals correlated in time
    inflation: np.ndarray | None = None
    pooled: float = 1.0  # factor of the variance, mean over all directions
    alike: tuple = ()  # `AlikeValue` of joints with the same drive

    @property
    def marginal_std(self):
        """`std`, infinite for a part that neither data nor prior determine, (p,)."""
        # A described body is determined, and directions that change it.
        free, metric = np.isnan(self.prior_std), self.posterior_metric
        lost = free & (np.diagonal(metric) > 0) & ~identifiable(metric, free)
        return np.where(lost & ~np.isnan(self.std), np.inf, self.std)

    @property
    def posterior_metric(self):
        """`metric` plus the precision of the prior in the same units, (p, p)."""
        if self.bodies is None:
            return self.metric
        metric = self.metric + self.bodies.weighted_prior
        # Fixed parameters do not move with any other.
        fixed = self.prior_std == 0
        metric[np.not_equal.outer(fixed, fixed)] = 0.0
        return metric

    @property
    def prior_std(self):
        """Standard deviations (p,) of the prior; nan for parameters without one."""
        if self.bodies is None:
            return np.full(self.theta.size, np.nan)
        return self.bodies.prior_std

    @property
    def from_description(self):
        """Parameters (p,), bool, that the description determines more than the data."""
        return little_learned(self.std, self.prior_std)

    def noise(self):
        """Split residual deviations [N m or N] into input noise and output noise."""
        return self.moments.split_residual(self.theta)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlainEstimate:
    """Least squares without a prior and without a projection."""

    theta: np.ndarray  # (p,): minimum norm; unidentifiable directions are zero
    covariance: np.ndarray  # (p, p): zero in these directions
    identifiable: np.ndarray  # (p,): bool
    eigen: ScaledEigen  # of the Gram matrix, input noise subtracted

    @property
    def std(self):
        return np.sqrt(np.diagonal(self.covariance))


def from_moments(regressor):
    """Return whether a regressor (None: the default) needs second moments only."""
    return regressor is None or isinstance(regressor, BaseJointFactorRegressor)


def estimate(
    moments, regressor=None, *, joint_weights="auto", rows=(), described=False
):
    """Estimate one parameter vector from the equations of all joints; not projected."""
    # regressor: linear, is cloned; joint_weights: "auto", None or (nv,); rows: the
    # equations, if the regressor needs them; described: whether the prior from the
    # description is applied afterwards, so that least squares suffices here.
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
            theta, std, covariance = _fit_scatter(regressor, total, noise)
        else:
            theta, std = _fit_rows(regressor, rows, weight, total)
    inflation, pooled = _block_inflation(moments, weight, theta)
    return Estimate(
        theta=theta,
        theta_unconstrained=theta,
        std=std * inflation,
        covariance=None if covariance is None else pooled * covariance,
        joint_weights=weight,
        metric=metric,
        moments=moments.in_stretches(),
        regressor=regressor,
        inflation=inflation,
        pooled=pooled,
    )


def plain_estimate(moments, joint_weights, bodies):
    """Estimate by weighted least squares, corrected for input noise."""
    # The covariance is inflated for residuals correlated in time. bodies:
    # `BodyPosterior` whose prior is added, or None. Returns a `PlainEstimate`.
    weight = resolve_weights(joint_weights, moments)
    if isinstance(joint_weights, str):
        limit = np.full(weight.size, np.inf)
        np.divide(_MAX_WEIGHT * moments.n, moments.yy, out=limit, where=moments.yy > 0)
        weight = np.minimum(weight, limit)
    total, noise = moments.total(weight), moments.total_noise(weight)
    metric = denoised(total, noise)
    right, fixed = total.S_xy, np.zeros(total.S_xy.size, dtype=bool)
    if bodies is not None:
        prior, fixed = bodies.weighted_prior, bodies.prior_std == 0
        known = np.where(fixed, bodies.centre, 0.0)
        right = right + prior @ bodies.centre
        right = np.where(fixed, 0.0, right - metric @ known)
        metric = np.where(fixed | fixed[:, None], 0.0, metric + prior)
    eigen = scaled_eigen(metric, IDENTIFIABLE)
    theta = eigen.solve(right)
    if fixed.any():
        theta[fixed] = bodies.centre[fixed]
    variance = noise_variance(moments, weight, theta, eigen.rank)
    inflation, _ = _block_inflation(moments, weight, theta)
    return PlainEstimate(
        theta=theta,
        covariance=eigen.inverse() * variance * np.outer(inflation, inflation),
        identifiable=identifiable(metric),
        eigen=eigen,
    )


def noise_variance(moments, weight, theta, rank, explained=0.0):
    """Return the weighted residual variance after a fit of `rank` directions."""
    # explained: sum of squares explained by further directions, not in theta
    used = weight > 0
    count = moments.n_rows[used].sum()
    squares = max(weight @ moments.residual_squares(theta) - explained, 0.0)
    # Weights may be fractional, so degrees of freedom come from the number of rows.
    return squares / moments.n[used].sum() * count / max(count - rank, 1)


def inflated_noise(result):
    """Return the noise variance that scales the normal equations of an `Estimate`."""
    # Its inflation discounts the likelihood for residuals correlated in time.
    moments, weight = result.moments, result.joint_weights
    rank = scaled_eigen(result.metric, IDENTIFIABLE).rank
    theta = result.theta_unconstrained
    return noise_variance(moments, weight, theta, rank) * max(result.pooled, 1.0)


def apply_description(result, description, bodies):
    """Return an `Estimate` with the description as prior, or with fixed bodies."""
    total, noise = result.moments.total(result.joint_weights), inflated_noise(result)
    method = around if bodies == "prior" else fix_bodies
    posterior = method(description, result.metric / noise, total.S_xy / noise)
    # The part of the variance that comes from noise is inflated per parameter.
    covariance = posterior.covariance
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    of_noise = ((finite @ (result.metric / noise)) * finite.T).sum(axis=1)
    inflation = result.inflation**2 / max(result.pooled, 1.0)
    std = np.sqrt(np.maximum(np.diagonal(finite) + of_noise * (inflation - 1), 0.0))
    std = np.where(np.isfinite(np.diagonal(covariance)), std, np.inf)
    # Inflated for correlated residuals, a deviation cannot exceed that of the prior.
    std = np.fmin(std, posterior.prior_std)
    return replace(
        result,
        theta=posterior.theta,
        theta_unconstrained=posterior.theta,
        std=std,
        covariance=covariance,
        bodies=replace(posterior, noise=noise),
    )


def size_of_bodies(result, description, gains):
    """Return the common size of bodies that were fitted without the description."""
    if description is None or gains is None or not gains.absolute:
        return 1.0
    weight = result.joint_weights.copy()
    weight[list(gains.hidden)] = 0.0
    total, noise = result.moments.total(weight), inflated_noise(result)
    metric = denoised(total, result.moments.total_noise(weight))
    return around(description, metric / noise, total.S_xy / noise).common_size


def uninflated_covariance(result):
    """Return the covariance, zero if infinite, and inflation factors (p,) of std."""
    C = np.where(np.isfinite(result.covariance), result.covariance, 0.0)
    std, ratio = np.sqrt(np.diagonal(C)), np.ones(len(C))
    finite = np.isfinite(result.std) & (std > 0)
    ratio[finite] = result.std[finite] / std[finite]
    return C, ratio


def with_prior(result, indices, shift, reduction, precision, right):
    """Return an `Estimate` with a prior on k parameters; all others are conditioned."""
    # shift (k,), reduction (k, k): change of mean, and decrease of covariance before
    # inflation; precision (k, k), right (k,): of the prior, product with its mean.
    C, ratio = uninflated_covariance(result)
    gain = scaled_eigen(C[np.ix_(indices, indices)]).solve(C[indices]).T
    theta = result.theta_unconstrained + gain @ shift
    C = C - gain @ reduction @ gain.T
    std = ratio * np.sqrt(np.maximum(np.diagonal(C), 0.0))
    C = np.where(np.isfinite(result.covariance), 0.5 * (C + C.T), result.covariance)
    changes, bodies = {"theta": theta, "covariance": C}, result.bodies
    if bodies is None:
        # There was no prior so far.
        bodies = BodyPosterior(
            **changes,
            noise=inflated_noise(result),
            prior=np.zeros(C.shape),
            prior_std=np.full(theta.size, np.nan),
            centre=np.zeros(theta.size),
        )
    prior, product = bodies.prior.copy(), bodies.prior @ bodies.centre
    prior[np.ix_(indices, indices)] += precision
    product[indices] += right
    # Mean of the combined prior, for these parameters and those that it couples to
    # them; in directions without prior, that of the estimate.
    coupled = np.flatnonzero((prior[indices] != 0).any(axis=0))
    centre, block = bodies.centre.copy(), prior[np.ix_(coupled, coupled)]
    offset = np.linalg.lstsq(block, product[coupled] - block @ theta[coupled])[0]
    centre[coupled] = theta[coupled] + offset
    return replace(
        result,
        **changes,
        theta_unconstrained=theta,
        std=np.where(np.isfinite(result.std), std, result.std),
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


def _block_inflation(moments, weight, theta):
    """Return inflation factors (p,) of deviations for residuals correlated in time."""
    # They include the standard deviation of Student's t with the blocks' degrees of
    # freedom. The second value is the factor of the variance, mean over all directions.
    if moments.blocks is None or not np.isfinite(theta).all():
        return np.ones(theta.size), 1.0
    scatter = block_scatter(moments, weight, theta)
    freedom = np.maximum(scatter.freedom, _MIN_FREEDOM)
    factor = np.sqrt(scatter.factor * freedom / (freedom - 2.0))
    # Parameters without equations are not inflated.
    return np.where(np.isfinite(factor), factor, 1.0), scatter.pooled


def _fit_scatter(regressor, total, noise):
    """Fit a regressor to a `Scatter`; return coef, std and covariance."""
    regressor.set_params(fit_intercept=False)
    takes_covariance = getattr(regressor, "latent", None) == "correlated"
    if takes_covariance and regressor.input_noise is None:
        # Use measured noise or none: rigid-body regressors are too correlated to infer
        # the noise level. The parameters belong to the noise-free motion.
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
            [(getattr(piece, name) * root)[piece.weight > 0] / scale for piece in rows]
        )

    A, fit_params = stacked("Phi"), {}
    if rows[0].instruments is not None:
        fit_params["instruments"] = stacked("instruments")
    b = np.concatenate([(piece.tau * root[:, 0])[piece.weight > 0] for piece in rows])
    b = b / y_scale
    weight = np.concatenate([piece.weight[piece.weight > 0] for piece in rows])
    if not np.all(weight == weight[0]):
        # Scale the rows, since not every regressor takes sample_weight.
        root_weight = np.sqrt(weight / weight.mean())
        A, b = A * root_weight[:, None], b * root_weight
        fit_params = {name: Z * root_weight[:, None] for name, Z in fit_params.items()}
    parameters = regressor.get_params(deep=True)
    names = {name.split("__")[-1] for name in parameters}
    intercepts = [n for n in parameters if n.split("__")[-1] == "fit_intercept"]
    regressor.set_params(**dict.fromkeys(intercepts, False))
    if not intercepts or "steps" in names:
        # For regressors that always centre (PLS, a scaler in a pipeline), each equation
        # is repeated with opposite sign, so that all means are zero.
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
    response = np.ravel(regressor.predict(probe))
    coef = response[1:] - response[0]
    predicted = np.ravel(regressor.predict(sample)) - response[0]
    magnitude = np.abs(sample) @ np.abs(coef) + np.abs(response[0])
    if np.any(np.abs(predicted - sample @ coef) > 1e-6 * magnitude + 1e-300):
        raise ValueError(
            "regressor must be linear in its inputs, since its coefficients are "
            f"the parameters; got {type(regressor).__name__}."
        )
    return coef


def denoised(total, noise):
    """Subtract input noise from the Gram matrix (X_t' X_t of eq. 35), keep it psd."""
    # Directions in which the noise exceeds the signal become zero; noise: or None.
    if noise is None:
        return total.S_xx.copy()
    scale = np.sqrt(np.diagonal(total.S_xx))
    divisor = np.where(scale > 0, scale, 1.0)
    signal = total.S_xx - total.n_samples * noise
    root = scaled_eigen(0.5 * (signal + signal.T), 0.0, scale=divisor).root()
    # Zero columns stay exactly zero.
    root *= scale > 0
    return root.T @ root


def _mirror(rows):
    """Follow each row by its negative, so that block splits keep pairs together."""
    return np.stack([rows, -rows], axis=1).reshape(-1, *rows.shape[1:])


# -- projection ------------------------------------------------------------------------


def project(result, projector, features, effects=()):
    """Project an estimate onto the physically consistent parameters of a robot."""
    # The distance (eq. 35) is minimised over coefficients of effects as well.
    if projector is None:
        return result
    theta, metric = result.theta_unconstrained, result.posterior_metric
    # Coefficients of effects that must not be negative.
    positive = [
        indices[k]
        for effect, indices in effect_indices(effects, features.n_parameters_)
        for k, name in enumerate(effect.coefficients)
        if name in effect.nonnegative
    ]
    if positive:
        theta, metric = _nonnegative_solution(theta, metric, np.array(positive))
    fitted = _fit_projector(projector, features, theta, metric)
    # Coefficients at their bound are exactly zero, without the solver's rounding.
    at_bound = theta[positive] == 0
    theta = fitted.transform(theta[None])[0]
    theta[positive] = np.where(at_bound, 0.0, np.maximum(theta[positive], 0.0))
    restored = np.where(result.prior_std == 0, result.theta_unconstrained, theta)
    bodies = restored[: features.n_parameters_].reshape(features.n_joints_, -1)
    if (min_eigenvalues(bodies) > 0).all():
        # Fixed parameters have moved by the solver's accuracy only.
        theta = restored
    return replace(result, theta=theta, projector=fitted)


def consistent_anchor(model, theta, metric, per_joint, followers):
    """Return a consistent vector (p,) near the model's parameters, in data's units."""
    # The projection takes unidentifiable directions from this point: the described
    # inertias or a solid ball, times the factor that is nearest to the estimate theta
    # (p,) in the Gram matrix metric (p, p).
    bodies = force_solid(model, np.vstack([nominal_parameters(model), followers]))
    p = model.nv * per_joint
    anchor = theta[:p].reshape(-1, per_joint).copy()
    anchor[:, 10:] = np.maximum(anchor[:, 10:], 0.0)
    inertial = np.zeros((model.nv, per_joint), dtype=bool)
    inertial[:, :10] = True
    indices = np.append(np.flatnonzero(inertial.ravel()), np.arange(p, theta.size))
    block = metric[np.ix_(indices, indices)]
    nominal, estimate = bodies.ravel(), theta[indices]
    norm = nominal @ block @ nominal
    factor = 1.0
    if norm > 0:
        factor = (nominal @ block @ estimate) / norm
        if not factor > 0:
            factor = np.sqrt(max(estimate @ block @ estimate, 0.0) / norm) or 1.0
    anchor[:, :10] = factor * bodies[: model.nv]
    return np.append(anchor.ravel(), factor * bodies[model.nv :])


def _fit_projector(projector, features, theta, metric):
    """Fit a projector, with layout and anchor of the robot, to an estimate."""
    # theta (p + n_effects,): effects come last and are unconstrained, except for bodies
    # of mimic joints, which come first among them.
    default = isinstance(projector, str)
    if default and projector != "default":
        raise ValueError(
            "projector must be 'default', a PhysicalProjector or None; got "
            f"{projector!r}."
        )
    friction, p = features.friction_, features.n_parameters_
    followers = nominal_followers(features)
    per_joint, bodies = 10 + len(friction), p + followers.size
    columns = [10 + k for k, name in enumerate(friction) if declared(name).nonnegative]
    anchor = consistent_anchor(
        features.model_, theta[:bodies], metric[:bodies, :bodies], per_joint, followers
    )
    fitted = PhysicalProjector() if default else clone(projector)
    options = replace(
        fitted.options or Options(),
        body_starts=np.append(np.arange(0, p, per_joint), np.arange(p, bodies, 10)),
        nonnegative=[j + k for j in range(0, p, per_joint) for k in columns],
        anchor=np.concatenate([anchor, theta[bodies:]]),
    )
    # Names of effects do not follow the projector's convention.
    fitted.set_params(metric=metric, parameter_names=None, options=options)
    return fitted.fit(theta[None])


def identifiable(metric, free=True):
    """Return the free parameters (p,), bool, whose unit vectors the data determine."""
    excited = free & (np.diagonal(metric) > 0)
    result = np.zeros(excited.size, dtype=bool)
    if excited.any():
        eigen = scaled_eigen(metric[np.ix_(excited, excited)], IDENTIFIABLE)
        result[excited] = ~eigen.lost(NULL_SHARE)
    return result


def _nonnegative_solution(theta, metric, positive):
    """Return the nearest theta (p,) with non-negative entries, and its metric."""
    # Entries at zero are removed from the metric. The active set is exact, whereas
    # columns of neighbouring elements are too correlated for the projection.
    others = np.setdiff1d(np.arange(theta.size), positive)
    cross = metric[np.ix_(others, positive)]
    response = scaled_eigen(metric[np.ix_(others, others)]).solve(cross)
    root = scaled_eigen(metric[np.ix_(positive, positive)] - cross.T @ response).root()
    sizes, _ = nnls(root, root @ theta[positive])
    solution, metric = theta.copy(), metric.copy()
    solution[others] -= response @ (sizes - theta[positive])
    solution[positive] = sizes
    zero = positive[sizes == 0]
    metric[zero] = metric[:, zero] = 0.0
    return solution, metric


# -- weights of joints -----------------------------------------------------------------


def noise_weights(moments):
    """Inverse residual variance of each joint by iterated weighted least squares."""
    # Starting from mean squared torques makes the result independent of torque units;
    # a joint without rows gets zero weight.
    used = moments.n > 0
    n = np.where(used, moments.n, 1.0)
    variance = np.where(used & (moments.yy > 0), moments.yy / n, np.inf)
    for _ in range(_MAX_ITERATIONS):
        weight = 1.0 / variance
        gram = moments.gram(weight)
        eigen = scaled_eigen(gram, 2 * ROUNDING * len(gram))
        theta = eigen.solve(weight @ moments.g)
        new = moments.residual_squares(theta) / n
        new = np.where(np.isfinite(variance), new, np.inf)
        # Prevents infinite weight of an exactly fitted joint.
        new = np.maximum(new, 1e-12 * np.where(used, moments.yy / n, np.inf))
        new = np.where(new > 0, new, np.inf)
        finite = np.isfinite(new)
        change = np.abs(new[finite] / variance[finite] - 1)
        variance = new
        if change.size == 0 or change.max() < _TOLERANCE:
            break
    return 1.0 / variance
