"""The completed model on the rows it was fitted to, with the scatter of its values."""

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

# Relative step of the derivative by a shape parameter.
_STEP = 1e-3
# Shape parameters that are tried for another form of an effect, over that of this one;
# and the smallest eigenvalue of the other columns, over the largest.
_WAYS, _RANK = tuple(np.geomspace(1 / 3, 3.0, 21).tolist()), 1e-10


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectEstimate:
    """Coefficients of an effect, with the covariance of these and of its shape."""

    coef: np.ndarray  # (k,)
    shape: tuple  # names of the shape parameters that were tuned
    covariance: np.ndarray  # (k + n_shape, k + n_shape)
    freedom: float  # of the covariance
    # probabilities and parameters of other forms of the effect, see `Shaped.averaged`
    forms: tuple = ()

    def given_shape(self):
        """Return the estimate of the coefficients, were the shape known."""
        k = len(self.coef)
        own, shape = self.covariance[:k], self.covariance[k:, k:]
        seen = np.isfinite(np.diagonal(shape))
        cross = own[:, k:][:, seen]
        known = cross @ np.linalg.pinv(shape[np.ix_(seen, seen)]) @ cross.T
        return replace(self, shape=(), covariance=own[:, :k] - known, forms=())


class FinalFit:
    """A completed model, and the equations it was fitted to."""

    # declared, identifier: the declared and the completed model; view: of the search,
    # and then of the robot as effects correct it; effects: those that were added, in
    # the order of the last parameters; share: of the fitted rows in the view.

    def __init__(self, declared, identifier, view, share=1.0):
        self.declared, self.identifier, self.share = declared, identifier, share
        self.effects = list(identifier.effects_[len(declared.effects_) :])
        held = excluded_columns(identifier.features_, identifier.effects_)
        at = declared.theta_.size
        # Other effects change the values of the declared ones.
        view = view.corrected(identifier.effects_)
        self.view = view.without([i for i in held if i < at])
        load = identifier.robot_.load_parameters
        self.motion = view.motion_of(load, self.effects)
        self._columns = [self.in_equations(e) for e in self.effects]
        for own in self._columns:
            own[:, :, [i - at for i in held if 0 <= i - at < own.shape[2]]] = 0.0
            at += own.shape[2]

    def in_equations(self, effect):
        """Columns of any effect, (m, nv, k), with the load of the completed model."""
        return self.view.in_equations(effect, self.motion)

    def columns(self):
        """Columns of the completed model, (m, nv, p)."""
        return np.concatenate([self.view.equations.Phi, *self._columns], axis=2)

    def _split(self, theta):
        """Coefficients of each effect in the parameters of the completed model."""
        widths = [own.shape[2] for own in self._columns]
        theta = theta[self.declared.theta_.size :]
        return np.split(theta, np.cumsum(widths)[:-1]) if widths else []

    def predicted(self, theta):
        """Torques of the completed model with some parameters, (m, nv)."""
        theta = self.identifier.robot_.linear_part(theta)
        declared = self.view.equations.torques(theta[: self.declared.theta_.size])
        pairs = zip(self._columns, self._split(theta))
        return sum((own @ coef for own, coef in pairs), declared)

    # -- estimates of the effects ------------------------------------------------------

    @functools.cached_property
    def effect_estimates(self):
        """Estimate of each effect, list of EffectEstimate."""
        # Coefficients are those of the completed model. Their covariance is that of the
        # same equations before the projection, with derivatives by the shape parameters
        # as columns, from the scatter between blocks of time.
        if not self.effects:
            return []
        coefs = self._split(self.identifier.theta_)
        shapes = [
            tuple(n for n in effect.continuous if getattr(effect, n))
            for effect in self.effects
        ]
        extra = []
        for effect, own, coef, shape in zip(self.effects, self._columns, coefs, shapes):
            # Elements at the bound of their sizes, zero, do not exist.
            own = own * (coef > 0) if isinstance(effect, Bank) else own
            slopes = [self._slope(effect, name, coef) for name in shape]
            extra.append(np.concatenate([own, *slopes], axis=2))
        found = self._variance(np.concatenate(extra, axis=2))
        # A mean over all rows scatters less, by the root of how many more these are.
        covariance = self.share * found.scores.T @ found.scores
        edges = np.cumsum([self.view.Z.shape[2], *(own.shape[2] for own in extra)])
        estimates = []
        for i, (a, b) in enumerate(itertools.pairwise(edges)):
            # A column that the recording does not excite has no freedom.
            freedom = np.fmin.reduce(found.freedom[a:b], initial=np.inf)
            one = EffectEstimate(
                coef=coefs[i],
                shape=shapes[i],
                covariance=covariance[a:b, a:b],
                freedom=float(freedom),
            )
            estimates.append(replace(one, forms=self._forms(i, one)))
        return estimates

    def _slope(self, effect, name, coef):
        """Differentiate an effect's torque by a shape parameter, (m, nv, 1)."""
        value, step = getattr(effect, name), _STEP * abs(getattr(effect, name))
        above, below = (
            self.in_equations(clone(effect).set_params(**{name: value + way * step}))
            for way in (0.5, -0.5)
        )
        return (((above - below) @ coef) / step)[:, :, None]

    def _scaled_residual(self):
        """Weighted residuals (m, nv), and one over their scale for each joint (nv,)."""
        # Elements of a bank that are alike cancel in a fit without bounds.
        bounded = any(isinstance(effect, Bank) for effect in self.effects)
        robot, view = self.identifier, self.view
        theta = robot.theta_ if bounded else robot.theta_unconstrained_
        residual = (view.equations.tau - self.predicted(theta)) * view.root
        count, squares = view.equations.weight.sum(axis=0), (residual**2).sum(axis=0)
        factor = np.sqrt(np.where(squares > 0, count / or_one(squares), 0.0))
        return residual * factor, factor

    def _branches(self, extra, factor):
        """Yield joints that share columns, these, and their rows (m, nj, k)."""
        # extra (m, nv, q): further columns; rows are scaled as the residuals are.
        Z, extra = self.view.Z, extra * self.view.root[:, :, None]
        support = Z.any(axis=1), extra.any(axis=0)
        for joints, columns in branches(np.hstack(support)):
            own, further = np.split(columns, np.searchsorted(columns, Z.shape[2:]))
            rows = [Z[joints[:, None], :, own].transpose(2, 0, 1)]
            rows.append(extra[:, joints][:, :, further - Z.shape[2]])
            yield joints, columns, np.concatenate(rows, axis=2) * factor[joints, None]

    def _variance(self, extra):
        """Scatter between blocks of the fit with the columns (m, nv, q) of effects."""
        residual, factor = self._scaled_residual()
        places, label = _blocks(self.view)
        parts, n = [], self.view.Z.shape[2] + extra.shape[2]
        scores = np.zeros((len(places), n))
        for joints, columns, rows in self._branches(extra, factor):
            grams = np.zeros((len(places), columns.size, columns.size))
            for k in range(len(places)):
                block = label == k
                own = rows[block].reshape(-1, columns.size)
                grams[k] = own.T @ own
                scores[k, columns] = residual[block][:, joints].ravel() @ own
            parts.append((columns, grams))
        return block_variance(parts, scores, places)

    def _forms(self, i, estimate):
        """Probabilities and parameters of other forms of an effect of one column."""
        effect = self.effects[i]
        forms = effect.forms() if isinstance(effect, Shaped) else []
        forms = [form for form in forms if form.shape() != effect.shape()]
        if not forms:
            return ()
        (name,), j = effect.continuous, effect.joint
        tried = [
            clone(form).set_params(**{name: way * getattr(form, name)})
            for form in forms
            for way in _WAYS
        ]
        y, factor = self._scaled_residual()
        others = [own for k, own in enumerate(self._columns) if k != i]
        others.append(np.zeros((*y.shape, 0)))
        near = self._branches(np.concatenate(others, axis=2), factor)
        near = [(joints, base) for joints, _, base in near if j in joints]
        if not near:
            return ()
        ((joints, base),) = near
        every = [self._columns[i], *(self.in_equations(one) for one in tried)]
        C = np.hstack([own[:, j] for own in every]) * (factor * self.view.root)[:, [j]]
        y[:, j] += C[:, 0] * self._split(self.identifier.theta_unconstrained_)[i]
        # What the other columns leave of each form, and of the torque.
        flat = base.reshape(-1, base.shape[2])
        root = scaled_eigen(flat.T @ flat, _RANK).inverse_root()
        seen = root.T @ (base[:, np.searchsorted(joints, j)].T @ C)
        H = (C**2).sum(axis=0) - (seen**2).sum(axis=0)
        q = C.T @ y[:, j] - seen.T @ (root.T @ (flat.T @ y[:, joints].ravel()))
        # Evidence is discounted by the scatter between blocks over that of white noise.
        known = estimate.given_shape().covariance[0, 0]
        gain = 0.5 * q**2 / H / max(1.0, known * H[0])
        found, weights = [], [0.0]
        for at in range(1, len(gain), len(_WAYS)):
            best = at + int(np.argmax(gain[at : at + len(_WAYS)]))
            one = tried[best - 1]
            shape = {name: getattr(one, name)}
            found.append(one.parameters([q[best] / H[best]]) | shape)
            weights.append(gain[best] - gain[0])
        return tuple(zip(special.softmax(weights)[1:].tolist(), found))


def _blocks(view):
    """Places of the blocks of a view, see `BlockAssignment`, and the block of a row."""
    lengths = np.diff([*view.starts, view.index.size]).tolist()
    phases = view.phases and (view.phases[0], view.phases[1] / view.step)
    numbering, places = BlockAssignment.of(lengths, phases), []
    for number, n in enumerate(lengths):
        own, starts = numbering.parts(number, slice(0, n))
        places.append(np.repeat(own, np.diff([*starts, n]), axis=0))
    places, label = np.unique(np.concatenate(places), axis=0, return_inverse=True)
    return places, label.ravel()
