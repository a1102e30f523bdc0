"""Intervals that respect correlation in time, and how recordings differ."""

import functools
import itertools
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.special import softmax
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import block_variance, scaled_eigen
from sklearn_vbjfa.effects import Shaped
from sklearn_vbjfa.equations._equations import (
    TorqueResiduals,
    held_columns,
    make_motion,
)
from sklearn_vbjfa.equations._joint_moments import BlockAssignment

# Probability below the upper end of an interval, and above its lower end.
_UPPER_END = 0.95
# Relative step of the derivative by a shape parameter.
_STEP = 1e-3
# Where the shape of another form of an effect is looked for, over that of this one; and
# the smallest eigenvalue of what is known of the others, over the largest.
_WAYS = tuple(np.geomspace(1 / 3, 3.0, 21).tolist())
_RANK = 1e-10
# Time for which errors are predicted [s].
NEXT_SECONDS = 50.0
# Slowest cosines of time whose mean square is the long-run variance. Few of them leave
# residuals that are slow their full variance, and Student's t knows how few they are
# (equal-weighted cosines with fixed-b critical values: Lazarus, Lewis, Stock, Watson,
# "HAR inference: recommendations for practice", J. Bus. Econ. Stat. 36(4), 2018).
_COSINES = 10


def quantile(freedom):
    """Half width of a 90 % interval in standard deviations (Student's t)."""
    return float(special.stdtrit(freedom, _UPPER_END))


# -- effects ------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectEstimate:
    """Coefficients of an effect, and how well they and its shape are known."""

    coef: np.ndarray  # (k,)
    shape: tuple  # shape parameters that were tuned
    covariance: np.ndarray  # (k + n_shape, k + n_shape)
    freedom: float  # of the covariance
    # other forms of the effect, of which `Shaped.averaged` tells: their probabilities
    # and parameters
    forms: tuple = ()


def added_effects(identifier, count):
    """Return the last effects of a fitted identifier, with the values it found."""
    return identifier.effects_[len(identifier.effects_) - count :]


class FinalFit:
    """The completed model on the rows that it was fitted to."""

    # declared, identifier: the declared and the completed model; view: of the search,
    # and then of the robot as effects correct it; effects: what was added, in the order
    # of the model's last parameters; share: of the rows that were fitted, those that
    # the view holds.

    def __init__(self, declared, identifier, view, effects, share=1.0):
        self.declared, self.identifier = declared, identifier
        self.effects, self.share = list(effects), share
        # What was declared has other values with other effects beside it.
        values = (*identifier.effects_[: len(declared.effects_)], *self.effects)
        held = held_columns(identifier.features_, identifier.effects_)
        at = declared.theta_.size
        self.nominal = view
        self.view = view.corrected(values).without([i for i in held if i < at])
        self.motion = make_motion(
            identifier.features_,
            view.states,
            view.clock,
            view.parts,
            identifier.robot_.load_parameters,
            view.robot.cutoff_,
            rest=view.robot.plan.turning,
            effects=effects,
            signals=view.signals,
            before=view.before,
        )
        self._columns = [self.view.in_equations(e, self.motion) for e in self.effects]
        for own in self._columns:
            own[:, :, [i - at for i in held if 0 <= i - at < own.shape[2]]] = 0.0
            at += own.shape[2]

    def columns(self, rows=slice(None)):
        """Columns of the completed model in some equations, (n, nv, p)."""
        own = [columns[rows] for columns in self._columns]
        return np.concatenate([self.view.equations.Phi[rows], *own], axis=2)

    def in_equations(self, effect):
        """Columns of any effect, (m, nv, k), with the load of the completed model."""
        return self.view.in_equations(effect, self.motion)

    def _predicted(self, theta):
        """Torques of the completed model with some parameters, (m, nv)."""
        Phi, theta = self.view.equations.Phi, self.identifier.robot_.linear_part(theta)
        predicted = Phi @ theta[: Phi.shape[2]]
        for own, coef in zip(self._columns, self._split(theta)):
            predicted = predicted + own @ coef
        return predicted

    def _split(self, theta):
        """Coefficients of each effect."""
        widths = [columns.shape[2] for columns in self._columns]
        at = self.declared.theta_.size
        return np.split(theta[at:], np.cumsum(widths)[:-1]) if widths else []

    def effect_torques(self):
        """Torque that each effect adds, a list of ndarray (m, nv) [N m or N]."""
        # Of an effect in the robot model to first order, by its derivatives.
        found = []
        for effect, own, coef in zip(
            self.effects, self._columns, self._split(self.identifier.theta_)
        ):
            idle = effect.nominal if effect.in_model else 0.0
            found.append(own @ (coef - np.asarray(idle)))
        return found

    def residuals(self):
        """Residuals before and after, a pair of TorqueResiduals."""
        theta = self.declared.robot_.linear_part(self.declared.theta_)
        before = self.nominal.equations.Phi @ theta
        return self._compared(before), self.residuals_of(self.identifier.theta_)

    def residuals_of(self, theta):
        """Residuals of the completed model with some parameters, TorqueResiduals."""
        return self._compared(self._predicted(theta))

    def _compared(self, predicted):
        """Compare the torques with predicted ones (m, nv)."""
        return TorqueResiduals(
            index=self.view.recorded,
            torque=self.view.equations.tau,
            predicted=predicted,
            weight=self.view.equations.weight,
        )

    @functools.cached_property
    def effect_estimates(self):
        """Estimate of each effect, list of EffectEstimate."""
        # The coefficients are those of the completed model. Their covariance is that of
        # the same equations before the projection, with the shape parameters beside the
        # coefficients by their derivatives, from the scatter between blocks of time.
        if not self.effects:
            return []
        view = self.view
        coefs = self._split(self.identifier.theta_)
        columns, places, shapes = [], [], []
        at = view.Z.shape[2]
        for effect, own, coef in zip(self.effects, self._columns, coefs):
            shape = ()
            if isinstance(effect, Shaped):
                shape = tuple(
                    name
                    for name in effect.continuous
                    if getattr(effect, name) and name not in effect.jumping
                )
            slopes = [self._slope(effect, name, coef) for name in shape]
            if effect.bank:
                # Elements at the bound of their sizes, zero, are not there.
                own = own * (coef > 0)
            made = np.concatenate([own, *slopes], axis=2) * view.root[:, :, None]
            places.append(slice(at, at + made.shape[2]))
            shapes.append(shape)
            at += made.shape[2]
            columns.append(made)
        found = self._variance(np.concatenate(columns, axis=2))
        # A mean over all rows scatters less, by the root of how many more these are.
        covariance = self.share * found.scores.T @ found.scores
        return [
            EffectEstimate(
                coef=coef,
                shape=shape,
                covariance=covariance[place, place],
                # A column that the recording does not excite has none.
                freedom=float(np.fmin.reduce(found.freedom[place], initial=np.inf)),
                forms=self._forms(i, covariance[place, place]),
            )
            for i, (coef, shape, place) in enumerate(zip(coefs, shapes, places))
        ]

    def _forms(self, i, covariance):
        """Other forms of an effect of one column, with what each makes of the data."""
        effect, view = self.effects[i], self.view
        if not (isinstance(effect, Shaped) and effect.averaged):
            return ()
        form, values = effect.averaged
        (name,), j = effect.continuous, effect.joint
        values = [value for value in values if value != getattr(effect, form)]
        tried = [
            clone(effect).set_params(**{form: value, name: way * getattr(effect, name)})
            for value in values
            for way in _WAYS
        ]
        residual, factor = self._scaled_residual()
        others = [own for k, own in enumerate(self._columns) if k != i]
        others = [own * view.root[:, :, None] for own in others]
        base = np.concatenate([view.Z.transpose(1, 0, 2), *others], axis=2)
        base *= factor[:, None]
        every = [self._columns[i], *(self.in_equations(one) for one in tried)]
        C = np.hstack([own[:, j] for own in every]) * (factor * view.root)[:, [j]]
        y = residual * factor
        y[:, j] += C[:, 0] * self._split(self.identifier.theta_unconstrained_)[i]
        flat = base.reshape(-1, base.shape[2])
        cross, eigen = base[:, j].T @ C, scaled_eigen(flat.T @ flat, _RANK)
        root = eigen.inverse_root()
        seen = root.T @ cross
        H = (C**2).sum(axis=0) - (seen**2).sum(axis=0)
        q = C.T @ y[:, j] - seen.T @ (root.T @ (flat.T @ y.ravel()))
        # Evidence is discounted by the scatter between blocks over that of white noise.
        own = np.atleast_2d(covariance)
        known = own[0, 0] - own[0, 1] ** 2 / own[1, 1] if len(own) > 1 else own[0, 0]
        gain = 0.5 * q**2 / H / max(1.0, known * H[0])
        found, weights = [], [0.0]
        for k in range(len(values)):
            at = 1 + k * len(_WAYS)
            best = at + int(np.argmax(gain[at : at + len(_WAYS)]))
            one = tried[best - 1]
            found.append(
                one.parameters([q[best] / H[best]]) | {name: getattr(one, name)}
            )
            weights.append(gain[best] - gain[0])
        return tuple(zip(softmax(weights)[1:].tolist(), found))

    def _slope(self, effect, name, coef):
        """Differentiate an effect's torque by a shape parameter, (m, nv, 1)."""
        value = getattr(effect, name)
        step = _STEP * abs(value)
        sides = [
            clone(effect).set_params(**{name: value + way * step})
            for way in (0.5, -0.5)
        ]
        above, below = (self.view.in_equations(e, self.motion) @ coef for e in sides)
        return ((above - below) / step)[:, :, None]

    def _scaled_residual(self):
        """Weighted residuals (m, nv), and one over their scale for each joint (nv,)."""
        view = self.view
        theta = self.identifier.theta_unconstrained_
        residual = (view.equations.tau - self._predicted(theta)) * view.root
        count = view.equations.weight.sum(axis=0)
        squares = (residual**2).sum(axis=0)
        used = (count > 0) & (squares > 0)
        factor = np.sqrt(np.where(used, count / np.where(used, squares, 1.0), 0.0))
        return residual, factor

    def _variance(self, extra):
        """Scatter between blocks of the fit with the columns (m, nv, q) of effects."""
        view = self.view
        residual, factor = self._scaled_residual()
        grams, scores, places = [], [], []
        for block, place in _blocks(view):
            declared = view.Z[:, block].transpose(1, 0, 2)
            rows = np.concatenate([declared, extra[block]], axis=2)
            rows = (rows * factor[:, None]).reshape(-1, rows.shape[2])
            own = (residual[block] * factor).ravel()
            grams.append(rows.T @ rows)
            scores.append(own @ rows)
            places.append(place)
        return block_variance(np.array(grams), np.array(scores), np.array(places), 1.0)


# -- errors -------------------------------------------------------------------------


def error_intervals(untouched, searched, spread, step):
    """Intervals that hold the errors over the next seconds of the same motion."""
    # An error is a mean over time, of the next stretch as of the held-out one, and
    # both scatter. How much is read off the slow variation of what the error is a mean
    # of, the squared residual, in both parts of the recording. The spread (nv,) of the
    # torque that it is divided by is that of the whole recording and counts as given.
    # untouched, searched: residuals before and after, on the same rows, whose indices
    # count the rows of the whole recording. Returns the ends (2, nv) of 90 % intervals
    # of the errors "before" and "after" and of their "difference" over the next
    # `NEXT_SECONDS`.
    order = np.argsort(
        np.concatenate([searched[0].index, untouched[0].index]), kind="stable"
    )
    weight, *residuals = (
        np.concatenate([one, other])[order]
        for one, other in zip(_series(searched), _series(untouched))
    )
    m, nv = weight.shape
    errors = [part.relative_error(spread) for part in untouched]
    total = weight.sum(axis=0)
    freedom = min(_COSINES, m // 4)
    if freedom < 1:
        nothing = np.full((2, nv), np.nan)
        return {"before": nothing, "after": nothing, "difference": nothing}
    time = (np.arange(m) + 0.5) / m
    cosines = np.cos(np.pi * np.outer(np.arange(1, freedom + 1), time))
    cosines *= np.sqrt(2.0 / m)
    ahead = NEXT_SECONDS / step
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Of the logarithm of an error, about its mean over what counts.
        parts = [0.5 * (_shares(weight, r, total) - weight) for r in residuals]
        parts.append(errors[1] * parts[1] - errors[0] * parts[0])
        # The variance of a mean over rows that count as in the whole recording.
        rows = untouched[0].weight
        reach = rows.shape[0] / rows.sum(axis=0) ** 2 + (m / total) ** 2 / ahead
        half = [
            quantile(freedom) * np.sqrt(((cosines @ part) ** 2).mean(axis=0) * reach)
            for part in parts
        ]
        difference = errors[1] - errors[0]
        return {
            "before": errors[0] * np.exp([-half[0], half[0]]),
            "after": errors[1] * np.exp([-half[1], half[1]]),
            "difference": difference + np.array([-half[2], half[2]]),
        }


def _series(pair):
    before, after = pair
    return before.weight, before.residual, after.residual


def _shares(weight, values, total):
    """Weighted squares over their mean; zero where all are."""
    squares = weight * values**2
    mean = squares.sum(axis=0) / total
    return np.where(mean > 0, squares / np.where(mean > 0, mean, 1.0), 0.0)


def _blocks(view):
    """Yield the rows of each block of a view and its place, see `BlockAssignment`."""
    edges = [*view.starts.tolist(), view.index.size]
    phases = view.phases and (view.phases[0], view.phases[1] / view.step)
    numbering = BlockAssignment.of(np.diff(edges).tolist(), phases)
    places = []
    for number, (first, last) in enumerate(itertools.pairwise(edges)):
        own, starts = numbering.parts(number, slice(0, last - first))
        places.append(np.repeat(own, np.diff([*starts, last - first]), axis=0))
    places, label = np.unique(np.concatenate(places), axis=0, return_inverse=True)
    for k, place in enumerate(places):
        yield np.flatnonzero(label.ravel() == k), place
