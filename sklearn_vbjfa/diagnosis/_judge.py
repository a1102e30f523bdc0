"""Evidence on rows from which the residual's own memory is taken out."""

import numpy as np

from sklearn_vbjfa.diagnosis._regression import BlockRegression


class Judge:
    """Blocks of time as independent witnesses, whatever the colour of the residual.

    The memory is that of the residual with the candidate, not without it: what a poor
    model lacks is correlated for as long as the motion is, and is no noise. Once the
    right effect is in, the residual forgets again; noise that is slow stays so with
    whatever is put in.

    Parameters
    ----------
    view : RecordingView
        Recording.
    base : BlockRegression
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

    def __init__(self, view, base, residual):
        joints = range(view.nv)
        self.residual = residual
        self._whiten = view.whitening(residual)
        power = (self._whiten(residual, joints) ** 2).sum(axis=1)
        rows = (view.root.T**2).sum(axis=1)
        used = (view.precision > 0) & (power > 0)
        precision = np.where(used, rows / np.where(used, power, 1.0), 0.0)
        Z = self._whiten(base.Z, joints)
        # The ridge is relative to the columns; slow ones must not shrink for it.
        size, left = ((x**2).sum(axis=(0, 1)) for x in (base.Z, Z))
        self._scale = np.sqrt(size / np.where(left > 0, left, 1.0))
        self._view = view
        self.regression = BlockRegression(
            Z * self._scale,
            self._whiten(base.y, joints),
            precision,
            view.blocks,
            base.ridge,
        )
        self._precision = precision
        self.squares = self.regression.squares() * precision

    def score(self, joints, columns):
        """Squared out-of-sample residuals with a candidate, shape chosen by fold."""
        white = self._whiten(columns, joints)
        return self.regression.score(joints, white).squares * self._precision

    def forward(self, joints, columns, blocks, border):
        """Squared residuals of later blocks, all fitted to those before.

        Parameters
        ----------
        joints : list of int
            Joints that the candidate acts on.
        columns : ndarray of shape (nj, m, k)
            Its columns.
        blocks : Blocks
            Blocks that are summed over.
        border : int
            First of the later blocks.

        Returns
        -------
        without, with_it : ndarray of shape (n_blocks - border, nv)
            Sums of squares in units of noise.
        """
        base = self.regression
        extra = np.zeros((*base.Z.shape[:2], columns.shape[-1]))
        extra[joints] = self._whiten(columns, joints)
        power = np.mean(extra**2, axis=(0, 1))
        extra *= self._view.size / np.sqrt(np.where(power > 0, power, 1.0))
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
