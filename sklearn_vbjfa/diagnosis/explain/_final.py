"""The completed model on the rows it was fitted to, with covariances of effects."""

import functools
import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy import special
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import (
    block_variance,
    branches,
    or_one,
    scaled_eigen,
)
from sklearn_vbjfa.effects import Bank, Shaped
from sklearn_vbjfa.equations._equations import excluded_columns
from sklearn_vbjfa.equations._joint_moments import BlockAssignment

# Relative step of finite differences with respect to a shape parameter.
_STEP = 1e-3
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
    # probabilities and parameters of other forms of the effect, see `Shaped.averaged`
    forms: tuple = ()

    def given_shape(self):
        """Return the estimate of the coefficients, conditional on the shape."""
        k = len(self.coef)
        rows, shape = self.covariance[:k], self.covariance[k:, k:]
        finite = np.isfinite(np.diagonal(shape))
        cross = rows[:, k:][:, finite]
        explained = cross @ np.linalg.pinv(shape[np.ix_(finite, finite)]) @ cross.T
        covariance = rows[:, :k] - explained
        return replace(self, shape=(), covariance=covariance, of_prior=0.0, forms=())


class FinalFit:
    """A completed model, and the equations it was fitted to."""

    # declared, identifier: the declared and the completed model; view: first of the
    # search, then of the robot model as corrected by effects; effects: the added ones,
    # in the order of the last parameters; share: of the fitted rows in the view.

    def __init__(self, declared, identifier, view, share=1.0):
        self.declared, self.identifier, self.share = declared, identifier, share
        self.effects = list(identifier.effects_[len(declared.effects_) :])
        excluded = excluded_columns(identifier.features_, identifier.effects_)
        at = declared.theta_.size
        # Other effects change the values of the declared ones.
        view = view.corrected(identifier.effects_)
        self.view = view.without([i for i in excluded if i < at])
        load = identifier.robot_.load_parameters
        self.motion = view.motion_of(load, self.effects)
        self._columns = [self.in_equations(e) for e in self.effects]
        for Phi in self._columns:
            Phi[:, :, [i - at for i in excluded if 0 <= i - at < Phi.shape[2]]] = 0.0
            at += Phi.shape[2]

    def in_equations(self, effect):
        """Return columns (m, nv, k) of an effect, for the completed model's load."""
        return self.view.in_equations(effect, self.motion)

    def columns(self):
        """Return the regressor of the completed model, (m, nv, p)."""
        return np.concatenate([self.view.equations.Phi, *self._columns], axis=2)

    def _effect_coefs(self, theta):
        """Return the coefficients of each effect, from all parameters."""
        widths = [columns.shape[2] for columns in self._columns]
        theta = theta[self.declared.theta_.size :]
        return np.split(theta, np.cumsum(widths)[:-1]) if widths else []

    def predicted(self, theta):
        """Predict torques of the completed model for some parameters, (m, nv)."""
        theta = self.identifier.robot_.linear_part(theta)
        declared = self.view.equations.torques(theta[: self.declared.theta_.size])
        pairs = zip(self._columns, self._effect_coefs(theta))
        return sum((columns @ coef for columns, coef in pairs), declared)

    @functools.cached_property
    def effect_estimates(self):
        """Estimates of the effects, a list of `EffectEstimate`."""
        # Coefficients are those of the completed model. Their covariance comes from the
        # variance between blocks of time in the same equations before the projection,
        # with derivatives with respect to shape parameters as further columns.
        if not self.effects:
            return []
        coefs = self._effect_coefs(self.identifier.theta_)
        shapes = [
            tuple(n for n in effect.continuous if getattr(effect, n))
            for effect in self.effects
        ]
        extra = []
        for effect, Phi, coef, shape in zip(self.effects, self._columns, coefs, shapes):
            # Elements at their bound of zero do not exist.
            Phi = Phi * (coef > 0) if isinstance(effect, Bank) else Phi
            derivatives = [self._derivative(effect, name, coef) for name in shape]
            extra.append(np.concatenate([Phi, *derivatives], axis=2))
        variance = self._block_variance(np.concatenate(extra, axis=2))
        # The variance is inversely proportional to the number of fitted rows.
        covariance = self.share * variance.scores.T @ variance.scores
        edges = np.cumsum([self.view.Z.shape[2], *(x.shape[2] for x in extra)])
        of_prior, at = self._prior_covariance(), self.declared.theta_.size
        estimates = []
        for i, (a, b) in enumerate(itertools.pairwise(edges)):
            # Degrees of freedom of columns that are not excited are nan.
            freedom = np.fmin.reduce(variance.freedom[a:b], initial=np.inf)
            block = slice(at, at := at + coefs[i].size)
            estimate = EffectEstimate(
                coef=coefs[i],
                shape=shapes[i],
                covariance=covariance[a:b, a:b],
                freedom=float(freedom),
                of_prior=of_prior[block, block],
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

    def _scaled_residual(self):
        """Return standardised residuals (m, nv), and the factor of each joint (nv,)."""
        # Without bounds, nearly collinear elements of a bank cancel each other.
        bounded = any(isinstance(effect, Bank) for effect in self.effects)
        robot, view = self.identifier, self.view
        theta = robot.theta_ if bounded else robot.theta_unconstrained_
        residual = (view.equations.tau - self.predicted(theta)) * view.root
        count, squares = view.equations.weight.sum(axis=0), (residual**2).sum(axis=0)
        factor = np.sqrt(np.where(squares > 0, count / or_one(squares), 0.0))
        return residual * factor, factor

    def _branches(self, extra, factor):
        """Yield joints with common columns, these, and their scaled rows (m, nj, k)."""
        # extra (m, nv, q): further columns; rows are scaled like the residuals.
        Z, extra = self.view.Z, extra * self.view.root[:, :, None]
        support = Z.any(axis=1), extra.any(axis=0)
        for joints, columns in branches(np.hstack(support)):
            declared, further = np.split(columns, np.searchsorted(columns, Z.shape[2:]))
            rows = [Z[joints[:, None], :, declared].transpose(2, 0, 1)]
            rows.append(extra[:, joints][:, :, further - Z.shape[2]])
            yield joints, columns, np.concatenate(rows, axis=2) * factor[joints, None]

    def _block_variance(self, extra):
        """Estimate the variance from blocks, for columns (m, nv, q) of effects."""
        residual, factor = self._scaled_residual()
        keys, label = _blocks(self.view)
        parts, n = [], self.view.Z.shape[2] + extra.shape[2]
        scores = np.zeros((len(keys), n))
        for joints, columns, rows in self._branches(extra, factor):
            grams = np.zeros((len(keys), columns.size, columns.size))
            for k in range(len(keys)):
                block = label == k
                block_rows = rows[block].reshape(-1, columns.size)
                grams[k] = block_rows.T @ block_rows
                scores[k, columns] = residual[block][:, joints].ravel() @ block_rows
            parts.append((columns, grams))
        return block_variance(parts, scores, keys)

    def _forms(self, i, estimate):
        """Return probabilities and parameters of other forms of a one-column effect."""
        effect = self.effects[i]
        forms = effect.forms() if isinstance(effect, Shaped) else []
        forms = [form for form in forms if form.shape() != effect.shape()]
        if not forms:
            return ()
        (name,), j = effect.continuous, effect.joint
        trials = [
            clone(form).set_params(**{name: factor * getattr(form, name)})
            for form in forms
            for factor in _SHAPE_FACTORS
        ]
        y, factor = self._scaled_residual()
        others = [columns for k, columns in enumerate(self._columns) if k != i]
        others.append(np.zeros((*y.shape, 0)))
        coupled = self._branches(np.concatenate(others, axis=2), factor)
        coupled = [(joints, base) for joints, _, base in coupled if j in joints]
        if not coupled:
            return ()
        ((joints, base),) = coupled
        tested = [self._columns[i], *(self.in_equations(form) for form in trials)]
        C = np.hstack([x[:, j] for x in tested]) * (factor * self.view.root)[:, [j]]
        y[:, j] += C[:, 0] * self._effect_coefs(self.identifier.theta_unconstrained_)[i]
        # Partial Gram matrix (diagonal) and cross product, given the other columns.
        flat = base.reshape(-1, base.shape[2])
        root = scaled_eigen(flat.T @ flat, _RANK).inverse_root()
        cross = root.T @ (base[:, np.searchsorted(joints, j)].T @ C)
        H = (C**2).sum(axis=0) - (cross**2).sum(axis=0)
        q = C.T @ y[:, j] - cross.T @ (root.T @ (flat.T @ y[:, joints].ravel()))
        # Log evidence is divided by the overdispersion of the blocks.
        variance = estimate.given_shape().covariance[0, 0]
        gain = 0.5 * q**2 / H / max(1.0, variance * H[0])
        parameters, weights = [], [0.0]
        for at in range(1, len(gain), len(_SHAPE_FACTORS)):
            best = at + int(np.argmax(gain[at : at + len(_SHAPE_FACTORS)]))
            form = trials[best - 1]
            shape = {name: getattr(form, name)}
            parameters.append(form.parameters([q[best] / H[best]]) | shape)
            weights.append(gain[best] - gain[0])
        return tuple(zip(special.softmax(weights)[1:].tolist(), parameters))


def _blocks(view):
    """Return keys of the blocks of a view (n_blocks, 2), and the block of each row."""
    lengths = np.diff([*view.starts, view.index.size]).tolist()
    phases = view.phases and (view.phases[0], view.phases[1] / view.step)
    numbering, keys = BlockAssignment.of(lengths, phases), []
    for number, n in enumerate(lengths):
        block_keys, starts = numbering.parts(number, slice(0, n))
        keys.append(np.repeat(block_keys, np.diff([*starts, n]), axis=0))
    keys, label = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    return keys, label.ravel()
