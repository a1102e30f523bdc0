"""The completed model on the rows it was fitted to, with covariances of effects."""

import functools
import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy import special
from sklearn.base import clone

from sklearn_vbjfa._core._groups import Groups
from sklearn_vbjfa._core._linear_systems import (
    block_variance,
    branches,
    or_one,
    scaled_eigen,
)
from sklearn_vbjfa.effects import Bank
from sklearn_vbjfa.equations._equations import excluded_columns
from sklearn_vbjfa.equations._joint_moments import BlockAssignment

# Relative step of finite differences with respect to a shape parameter.
_STEP = 1e-3
# Axes of rows and joints in products of columns (m, nj, k).
_ROWS = (0, 1), (0, 1)
# Trial factors on the shape parameter of other forms of an effect; relative eigenvalue
# threshold for the rank of the other columns.
_SHAPE_FACTORS, _RANK = tuple(np.geomspace(1 / 3, 3.0, 21).tolist()), 1e-10


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectEstimate:
    """Estimate of an effect's coefficients and shape parameters, with covariance."""

    coef: np.ndarray  # (k,)
    shape: tuple  # names of the shape parameters that were tuned
    covariance: np.ndarray  # (k + n_shape, k + n_shape)
    freedom: float  # degrees of freedom of the covariance
    # (k, k): further covariance of the coefficients, of directions that only a prior
    # determines; nan on the diagonal if nothing does
    of_prior: np.ndarray | float = 0.0
    # probabilities and parameters of other forms of the effect, see `Effect.forms`
    forms: tuple = ()
    position_noise: float = np.nan  # standard deviation [rad or m]; nan if unknown

    def given_shape(self):
        """Return the estimate of the coefficients, conditional on the shape."""
        k = len(self.coef)
        rows, shape = self.covariance[:k], self.covariance[k:, k:]
        finite = np.isfinite(np.diagonal(shape))
        cross = rows[:, k:][:, finite]
        explained = cross @ np.linalg.pinv(shape[np.ix_(finite, finite)]) @ cross.T
        covariance = rows[:, :k] - explained
        # What nothing determines is unknown for any shape.
        prior = 0.0 * self.of_prior
        return replace(self, shape=(), covariance=covariance, of_prior=prior, forms=())


class FinalFit:
    """A completed model, and the equations it was fitted to."""

    # view: first of the search, then of the robot model as corrected by effects;
    # effects: the added ones, in the order of the last parameters; added: their columns
    # (m, nv, k); share: of the fitted rows in the view.

    def __init__(self, declared, identifier, view, share=1.0):
        self.identifier, self.share = identifier, share
        self.effects = list(identifier.effects_[len(declared.effects_) :])
        excluded = excluded_columns(identifier.features_, identifier.effects_)
        self._n_declared = n = declared.theta_.size
        # Other effects change the values of the declared ones.
        view = view.corrected(identifier.effects_)
        self.view = view.without([i for i in excluded if i < n])
        load = identifier.robot_.load_parameters
        self.motion = view.motion_of(load, identifier.effects_)
        columns = [np.empty((*view.equations.tau.shape, 0))]
        columns += [self.in_equations(e) for e in self.effects]
        edges = itertools.pairwise(np.cumsum([x.shape[2] for x in columns]))
        self._places = [slice(*ends) for ends in edges]
        self.added = np.concatenate(columns, axis=2)
        self.added[:, :, [i - n for i in excluded if i >= n]] = 0.0

    def in_equations(self, effect):
        """Return columns (m, nv, k) of an effect, for the completed model's load."""
        return self.view.in_equations(effect, self.motion)

    def predicted(self, theta):
        """Predict torques of the completed model for some parameters, (m, nv)."""
        theta = self.identifier.robot_.linear_part(theta)
        declared, coef = np.split(theta, [self._n_declared])
        return self.view.equations.torques(declared) + self.added @ coef

    @functools.cached_property
    def effect_estimates(self):
        """Estimates of the effects, a list of `EffectEstimate`."""
        # Coefficients are those of the completed model. Their covariance comes from the
        # variance between blocks of time in the same equations before the projection,
        # with derivatives with respect to shape parameters as further columns.
        if not self.effects:
            return []
        n, extra, shapes = self._n_declared, [], []
        for effect, at in zip(self.effects, self._places):
            Phi, coef = self.added[:, :, at], self.identifier.theta_[n:][at]
            # Elements at their bound of zero do not exist.
            extra.append(Phi * (coef > 0) if isinstance(effect, Bank) else Phi)
            shapes.append(tuple(x for x in effect.continuous if getattr(effect, x)))
            extra += [self._derivative(effect, name, coef) for name in shapes[-1]]
        widths = [at.stop - at.start + len(x) for at, x in zip(self._places, shapes)]
        variance = self._block_variance(np.concatenate(extra, axis=2))
        # The variance is inversely proportional to the number of fitted rows.
        covariance = self.share * variance.scores.T @ variance.scores
        of_prior = self._prior_covariance()[n:, n:]
        estimator = self.identifier.robot_.plan.state_estimator
        noise = np.sqrt(getattr(estimator, "noise_variance_", np.zeros(self.view.nv)))
        estimates, b = [], self.view.Z.shape[2]
        for i, (effect, at) in enumerate(zip(self.effects, self._places)):
            a, b = b, b + widths[i]
            # Degrees of freedom of columns that are not excited are nan.
            freedom = np.fmin.reduce(variance.freedom[a:b], initial=np.inf)
            estimate = EffectEstimate(
                coef=self.identifier.theta_[n:][at],
                shape=shapes[i],
                covariance=covariance[a:b, a:b],
                freedom=float(freedom),
                of_prior=of_prior[at, at],
                position_noise=noise[effect.joint],
            )
            estimates.append(replace(estimate, forms=self._forms(i, estimate)))
        return estimates

    def _prior_covariance(self):
        """Return the covariance (p, p) due to the prior, see `EffectEstimate`."""
        estimate = self.identifier.estimate_
        undetermined = np.isinf(self.identifier.theta_std_)
        covariance = np.zeros(2 * undetermined.shape)
        if estimate.bodies is not None:
            C = np.nan_to_num(estimate.covariance, posinf=0.0)
            covariance = C @ estimate.bodies.prior @ C
        covariance[undetermined, undetermined] = np.nan
        return covariance

    def _derivative(self, effect, name, coef):
        """Differentiate an effect's torque by a shape parameter, (m, nv, 1)."""
        value, step = getattr(effect, name), _STEP * abs(getattr(effect, name))
        above, below = (
            self.in_equations(clone(effect).set_params(**{name: value + side * step}))
            for side in (0.5, -0.5)
        )
        return (((above - below) @ coef) / step)[:, :, None]

    @functools.cached_property
    def _scaled(self):
        """Coefficients of effects, standardised residuals (m, nv), factors (nv,)."""
        # Without bounds, nearly collinear elements of a bank cancel each other.
        bounded = any(isinstance(effect, Bank) for effect in self.effects)
        robot, view = self.identifier, self.view
        theta = robot.theta_ if bounded else robot.theta_unconstrained_
        residual = (view.equations.tau - self.predicted(theta)) * view.root
        count, squares = view.equations.weight.sum(axis=0), (residual**2).sum(axis=0)
        factor = np.sqrt(np.where(squares > 0, count / or_one(squares), 0.0))
        return theta[self._n_declared :], residual * factor, factor

    def _branches(self, extra):
        """Yield joints with common columns, these, and their scaled rows (m, nj, k)."""
        # extra (m, nv, q): further columns; rows are scaled like the residuals.
        Z, (_, _, factor) = self.view.Z, self._scaled
        extra = extra * self.view.root[:, :, None]
        support = Z.any(axis=1), extra.any(axis=0)
        for joints, columns in branches(np.hstack(support)):
            declared, further = np.split(columns, np.searchsorted(columns, Z.shape[2:]))
            rows = [Z[joints[:, None], :, declared].transpose(2, 0, 1)]
            rows.append(extra[:, joints][:, :, further - Z.shape[2]])
            yield joints, columns, np.concatenate(rows, axis=2) * factor[joints, None]

    def _block_variance(self, extra):
        """Estimate the variance from blocks, for columns (m, nv, q) of effects."""
        (keys, label), (_, residual, _) = _blocks(self.view), self._scaled
        parts, n = [], self.view.Z.shape[2] + extra.shape[2]
        scores = np.zeros((len(keys), n))
        for joints, columns, rows in self._branches(extra):
            rows = np.dstack([rows, residual[:, joints]])
            blocks = (rows[label == k] for k in range(len(keys)))
            products = np.array([np.tensordot(x, x, _ROWS) for x in blocks])
            parts.append((columns, products[:, :-1, :-1]))
            scores[:, columns] = products[:, :-1, -1]
        return block_variance(parts, scores, keys)

    @functools.cached_property
    def _coupled(self):
        """Joints with common columns, these, scaled rows and Gram matrix, a list."""
        coupled = self._branches(self.added)
        return [(*names, x, np.tensordot(x, x, _ROWS)) for *names, x in coupled]

    def _forms(self, i, estimate):
        """Return probabilities and parameters of other forms of an effect."""
        effect, at = self.effects[i], self._places[i]
        forms = [x for x in effect.forms() if x.shape() != effect.shape()]
        j, names, bank = effect.joint, effect.continuous, isinstance(effect, Bank)
        coupled = [x for x in self._coupled if j in x[0]] if forms else ()
        if not coupled:
            return ()
        ((joints, columns, rows, gram),) = coupled
        coef, residual, factor = self._scaled
        place = columns - self.view.Z.shape[2]
        kept = (place < at.start) | (place >= at.stop)
        scale, y = (factor * self.view.root)[:, [j]], residual.copy()
        y[:, j] += scale[:, 0] * (self.added[:, j, at] @ coef[at])
        root = scaled_eigen(gram[np.ix_(kept, kept)], _RANK).inverse_root()
        inside = root.T @ rows[:, np.searchsorted(joints, j)][:, kept].T
        target = root.T @ np.einsum("mjk,mj->k", rows, y[:, joints])[kept]

        def moments(effect):
            # Partial second moments, given the other columns.
            C = self.in_equations(effect)[:, j] * scale
            cross, unit = inside @ C, np.ones((1, C.shape[1]))
            H, q = C.T @ C - cross.T @ cross, C.T @ y[:, j] - cross.T @ target
            norms = np.diagonal(H)[None] + (cross**2).sum(axis=0)
            return Groups(H=H[None], q=q[None], norms=norms, unit=unit, positive=bank)

        given, variance = moments(effect), estimate.given_shape().covariance
        parameters, gains = [], [given.gain()]
        for form in forms:
            factors = (1.0,) if bank else _SHAPE_FACTORS
            values = [{n: x * getattr(form, n) for n in names} for x in factors]
            trials = [clone(form).set_params(**shape) for shape in values]
            fits = zip(map(moments, trials), values, trials)
            best, shape, form = max(fits, key=lambda fit: fit[0].gain())
            parameters.append(form.parameters(best.coefficients()[0]) | shape)
            gains.append(best.gain())
        # Log evidence is divided by the overdispersion of the blocks, or by that which
        # the effect lacks to the noise floor: its law is an approximation.
        excess = (variance * given.H[0]).sum() / max((variance.diagonal() > 0).sum(), 1)
        robot, count = self.identifier, self.view.equations.weight[:, j].sum()
        share = robot.noise_floor_[j] / or_one(robot.output_noise_[j])
        lack = 0.5 * count * (1.0 - share**2)
        gains = 0.5 * np.concatenate(gains) / np.fmax.reduce([1.0, excess, lack])
        return tuple(zip(special.softmax(gains)[1:].tolist(), parameters))


def _blocks(view):
    """Return keys of the blocks of a view (n_blocks, 2), and the block of each row."""
    lengths = np.diff([*view.starts, view.index.size]).tolist()
    phases = view.phases and (view.phases[0], view.phases[1] / view.step)
    assignment, keys = BlockAssignment.of(lengths, phases), []
    for number, n in enumerate(lengths):
        block_keys, starts = assignment.parts(number, slice(0, n))
        keys.append(np.repeat(block_keys, np.diff([*starts, n]), axis=0))
    keys, label = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    return keys, label.ravel()
