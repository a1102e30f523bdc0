"""The declared model with some effects, fitted to a recording, and how it is judged."""

import functools
import itertools
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.search._regression import BlockRegression
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.effects import Motion


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchModel:
    """The declared model with some effects, fitted to a recording.

    Attributes
    ----------
    view : RecordingView
        Recording.
    effects : tuple of Effect
        Effects beside the declared model.
    motion : Motion
        Signals that the effects' columns are made from, with the load of the model.
    fitted : BlockRegression
        The fit, in reduced coordinates, and with the effects' columns behind them.
    scales : tuple of ndarray
        What the columns of each effect were multiplied with.
    """

    view: RecordingView
    effects: tuple
    motion: Motion
    fitted: BlockRegression
    scales: tuple

    @classmethod
    def of(cls, view, effects=(), start=None):
        """Fit a model whose joint weights and load are its own.

        Weights, ridge and load of the model to start from are the first guess; without
        one, those of the declared model's fit, and no load.
        """
        effects = tuple(effects)
        motion, precision, ridge = view.motion(None), view.precision, None
        if start is not None:
            precision, ridge = start.precision, start.ridge
            if effects:
                motion = start.signals()
        guess = cls._fit(view, effects, motion, precision, ridge)
        view = guess.view
        squares, rows = guess.squares.sum(axis=0), view.rows
        used = (rows > 0) & (squares > 0)
        precision = np.where(used, rows / np.where(used, squares, 1.0), 0.0)
        guess = cls._fit(view, effects, motion, precision, None)
        motion = guess.signals()
        return cls._fit(view, effects, motion, precision, guess.ridge)

    @classmethod
    def _fit(cls, view, effects, motion, precision, ridge):
        """Fit with given weights, load and ridge; None chooses the ridge."""
        # The view is that of the robot as the effects correct it.
        view = view.corrected(effects)
        Z, scales = view.stacked(effects, motion)
        fitted = BlockRegression(
            Z, view.target, precision, view.blocks, ridge, view.moments
        )
        return cls(
            view=view, effects=effects, motion=motion, fitted=fitted, scales=scales
        )

    @classmethod
    def on(cls, view, effects, model):
        """Fit effects on another view of the rows that a model was fitted to.

        Load and weights of that model are the first guess.
        """
        guess = cls._fit(view, effects, model.motion, model.precision, None)
        motion = guess.signals()
        return cls._fit(view, effects, motion, model.precision, guess.ridge)

    def beside(self, effects, ridge="same"):
        """Fit other effects with the weights and the load of this model.

        The ridge is that of this model, or with None the one that suits them best.
        """
        ridge = self.ridge if ridge == "same" else ridge
        return self._fit(self.view, tuple(effects), self.motion, self.precision, ridge)

    def signals(self):
        """Signals with this model's load and torque, a `Motion`."""
        scales = np.concatenate([np.empty(0), *self.scales])
        coefs = self.fitted.theta[self.view.Z.shape[2] :] * scales
        return self.view.motion(self.theta, self.effects, coefs)

    def deviations(self, effect):
        """Return deviations of an effect's coefficients (k,), for independent rows."""
        for one, scale, place in zip(self.effects, self.scales, self.places()):
            if one is effect:
                return self.fitted.deviations(place) * scale
        raise ValueError(f"{effect} is not among the accepted effects.")

    def without(self, effect):
        """Return the effects but one, tuple of Effect."""
        return tuple(one for one in self.effects if one is not effect)

    @property
    def precision(self):
        """Weights of the joints, (nv,)."""
        return self.fitted.precision

    @property
    def ridge(self):
        """Ridge, relative to the mean square of a column."""
        return self.fitted.ridge

    @property
    def theta(self):
        """Coefficients of the declared model in reduced coordinates, (r,)."""
        return self.fitted.theta[: self.view.Z.shape[2]]

    @functools.cached_property
    def squares(self):
        """Out-of-sample squared residuals, (n_blocks, nv)."""
        return self.fitted.squares()

    def residuals(self):
        """Out-of-sample residuals (nv, m), scaled by the root of the weights."""
        return self.fitted.residuals()

    def memory_seconds(self):
        """How long the residual of each joint stays correlated, list [s]."""
        memories = self.view.whitening(self.residuals()).memory
        return [memory.time for memory in memories]

    def coefficients(self, effect):
        """Coefficients of one of the model's effects, in its own units."""
        for one, scale, place in zip(self.effects, self.scales, self.places()):
            if one is effect:
                return self.fitted.theta[place] * scale
        raise ValueError(f"{effect} is not among the accepted effects.")

    def places(self):
        """Columns of the fit that belong to each effect, list of slice."""
        edges = np.cumsum([self.view.Z.shape[2], *(s.size for s in self.scales)])
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]

    def family(self, effect):
        """Effect with all shapes of its grid, and their columns."""
        return self.view.family(effect, self.motion)

    def columns_of(self, effect):
        """Columns of an effect, (nj, m, k)."""
        return self.view.columns_of(effect, self.motion)

    def columns_on_all(self, effect):
        """Columns of an effect in all joints' equations, (nv, m, k)."""
        own = self.columns_of(effect)
        columns = np.zeros((self.view.nv, *own.shape[1:]))
        columns[self.view.joints_of(effect)] = own
        return columns

    def relevant(self, effect, *squares):
        """Squared errors of an effect's joint, or of the robot in units of noise."""
        if effect.everywhere:
            return [s @ self.precision for s in squares]
        return [s[:, effect.joint] for s in squares]


class Judge:
    """Blocks of time as independent witnesses, whatever the colour of the residual.

    Models are compared in rows from which the residual's own memory is taken out. The
    memory is that of the residual with the candidate, not without it: what a poor
    model lacks is correlated for as long as the motion is, and is no noise. Once the
    right effect is in, the residual forgets again; noise that is slow stays so with
    whatever is put in.

    Parameters
    ----------
    base : SearchModel
        Model without the candidate.
    residual : ndarray of shape (nv, m)
        Residuals with it, scaled by the root of the weights.

    Attributes
    ----------
    residual : ndarray of shape (nv, m)
        As given.
    squares : ndarray of shape (n_blocks, nv)
        Squared out-of-sample residuals of the model without the candidate, in units
        of each joint's noise, so that joints may be added up.
    """

    def __init__(self, base, residual):
        view, fitted = base.view, base.fitted
        joints = range(view.nv)
        self.residual = residual
        self._size = view.size
        self._whiten = view.whitening(residual)
        power, rows = (self._whiten(residual, joints) ** 2).sum(axis=1), view.rows
        used = (base.precision > 0) & (power > 0)
        self._precision = np.where(used, rows / np.where(used, power, 1.0), 0.0)
        Z = self._whiten(fitted.Z, joints)
        # The ridge is relative to the columns; slow ones must not shrink for it.
        size, left = ((x**2).sum(axis=(0, 1)) for x in (fitted.Z, Z))
        self._fitted = BlockRegression(
            Z * np.sqrt(size / np.where(left > 0, left, 1.0)),
            self._whiten(fitted.y, joints),
            self._precision,
            view.blocks,
            base.ridge,
        )
        self.squares = self._fitted.squares() * self._precision

    def score(self, joints, columns):
        """Squared out-of-sample residuals with a candidate, shape chosen by fold."""
        white = self._whiten(columns, joints)
        return self._fitted.score(joints, white).squares * self._precision

    def without(self, joint, groups):
        """Squared residuals of a joint (n_blocks, c) where columns of Z are missing."""
        return self._fitted.squares_without(joint, groups) * self._precision[joint]

    def forward(self, joints, columns, blocks, border, ridge=None):
        """Squared residuals of later blocks (n_blocks - border, nv), in units of noise.

        Without the candidate's columns (nj, m, k) and with them, all fitted to the
        blocks before the border, with another ridge if that is given.
        """
        base = self._fitted
        if ridge is not None:
            base = BlockRegression(base.Z, base.y, base.precision, base.blocks, ridge)
        extra = np.zeros((*base.Z.shape[:2], columns.shape[-1]))
        extra[joints] = self._whiten(columns, joints)
        power = np.mean(extra**2, axis=(0, 1))
        extra *= self._size / np.sqrt(np.where(power > 0, power, 1.0))
        larger = BlockRegression(
            np.concatenate([base.Z, extra], axis=2),
            base.y,
            base.precision,
            base.blocks,
            base.ridge,
        )
        return [
            model.forward_squares(border, blocks) * self._precision
            for model in (base, larger)
        ]
