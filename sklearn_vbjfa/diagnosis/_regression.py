"""Out-of-sample scores of candidate columns, from the statistics of blocks of time.

All joints share one parameter vector, so that a column added to one joint's torque
changes all of them. A candidate is scored by refitting everything: the Gram matrix of
the declared columns is factorised once for each fold, and what a candidate adds is the
Schur complement of its own few columns.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

# Ridge to choose from, relative to columns of unit mean square.
_RIDGES = 10.0 ** np.arange(-10, -2)
# Directions of the scaled Gram matrix below this are never used.
_RANK = 1e-12
# Share of its own power that a column must keep outside the declared ones' span.
SPAN = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """Filtered equations of all joints.

    Attributes
    ----------
    Phi : ndarray of shape (m, nv, p)
        Regressor.
    tau : ndarray of shape (m, nv)
        Torques.
    weight : ndarray of shape (m, nv)
        Weights; zero leaves an equation out.
    """

    Phi: np.ndarray
    tau: np.ndarray
    weight: np.ndarray

    def reduce(self, precision):
        """Express the regressor in the directions that the data determine.

        Parameters
        ----------
        precision : ndarray of shape (nv,)
            Weights of the joints.

        Returns
        -------
        Z : ndarray of shape (nv, m, r)
            Regressor in reduced coordinates, rows scaled by the root of their weight.
        back : ndarray of shape (p, r)
            theta = back @ reduced coordinates.
        """
        root = np.sqrt(self.weight).T[:, :, None]
        rows = self.Phi.transpose(1, 0, 2) * root
        G = np.einsum("j,jmp,jmq->pq", precision, rows, rows, optimize=True)
        scale = np.sqrt(np.diagonal(G))
        used = scale > 0
        unit = np.where(used, scale, 1.0)
        values, vectors = linalg.eigh(G / np.outer(unit, unit))
        keep = values > _RANK * values[-1]
        back = np.where(used[:, None], vectors[:, keep] / unit[:, None], 0.0)
        back *= np.sqrt(max(float((self.weight * precision).sum()), 1.0))
        return rows @ back, back


class BlockRegression:
    """Ridge regression of all joints' torques, cross-validated by blocks of time.

    Parameters
    ----------
    Z : ndarray of shape (nv, m, r)
        Regressor rows, scaled by the root of their weights.
    y : ndarray of shape (nv, m)
        Torques, scaled alike.
    precision : ndarray of shape (nv,)
        Weight of each joint.
    blocks : Blocks
        Blocks and folds.
    ridge : float or None, default=None
        Ridge relative to the mean square of a column; None chooses by
        cross-validation.
    """

    def __init__(self, Z, y, precision, blocks, ridge=None):
        self.Z, self.y, self.precision, self.blocks = Z, y, precision, blocks
        self.n = max(float((np.any(Z != 0, axis=2) @ np.ones(Z.shape[1])).sum()), 1.0)
        self._folds = [np.flatnonzero(blocks.fold == k) for k in range(blocks.n_folds)]
        self._G = np.array(
            [self._moments(Z[:, rows], Z[:, rows]) for rows in self._folds]
        )
        self._g = np.array(
            [self._moments(Z[:, rows], y[:, rows, None])[:, 0] for rows in self._folds]
        )
        size = np.sqrt(np.mean(np.diagonal(self._G.sum(axis=0)))) or 1.0
        self._unit = size**2
        self.ridge = self._choose() if ridge is None else ridge
        self._solve(self.ridge)

    def _moments(self, A, B):
        return np.einsum("j,jma,jmb->ab", self.precision, A, B, optimize=True)

    def _choose(self):
        """Ridge of least cross-validated error."""
        errors = []
        for ridge in _RIDGES:
            self._solve(ridge)
            errors.append((self.squares() * self.precision).sum())
        return float(_RIDGES[int(np.argmin(errors))])

    def _solve(self, ridge):
        total_G, total_g = self._G.sum(axis=0), self._g.sum(axis=0)
        penalty = ridge * self._unit * np.eye(total_G.shape[0])
        self._factors, self._theta = [], []
        for G, g in zip([*self._G, 0.0], [*self._g, 0.0]):
            factor = linalg.cho_factor(total_G - G + penalty)
            self._factors.append(factor)
            self._theta.append(linalg.cho_solve(factor, total_g - g))

    @property
    def theta(self):
        """Coefficients fitted to all rows."""
        return self._theta[-1]

    def residuals(self):
        """Out-of-sample residuals (nv, m), scaled by the root of the weights."""
        out = np.empty_like(self.y)
        for rows, theta in zip(self._folds, self._theta):
            out[:, rows] = self.y[:, rows] - self.Z[:, rows] @ theta
        return out

    def squares(self):
        """Out-of-sample squared residuals, summed over blocks (n_blocks, nv)."""
        return self.blocks.sums((self.residuals() ** 2).T)

    def forward_squares(self, border):
        """Squared residuals of the blocks from `border` on, fitted to those before."""
        early = self.blocks.label < border
        Z, y = self.Z[:, early], self.y[:, early]
        G = self._moments(Z, Z)
        G += self.ridge * self._unit * np.eye(G.shape[0])
        theta = linalg.solve(G, self._moments(Z, y[:, :, None])[:, 0], assume_a="pos")
        residual = self.y[:, ~early] - self.Z[:, ~early] @ theta
        sums = self.blocks.sums(
            np.concatenate([np.zeros((early.sum(), y.shape[0])), (residual**2).T])
        )
        return sums[border:]

    def score(self, joints, F):
        """Score a family of candidates, one for each value of a shape parameter.

        Parameters
        ----------
        joints : list of int
            Joints that the columns act on.
        F : ndarray of shape (nj, m, c, k)
            Columns of the c candidates, rows scaled by the root of the weights.

        Returns
        -------
        Score
            Out-of-sample error, with the shape chosen inside each fold, and the
            choice on all rows.
        """
        nj, _m, c, k = F.shape
        precision = self.precision[joints]
        power = np.einsum("j,jmck->ck", precision, F**2)
        unit = np.sqrt(self._unit / np.where(power > 0, power, 1.0))
        F = F * unit
        Z, y = self.Z[joints], self.y[joints]
        cross, own, right = [], [], []
        for rows in self._folds:
            f = F[:, rows]
            flat = f.reshape(nj, rows.size, c * k)
            cross.append(
                np.einsum("j,jma,jmb->ab", precision, Z[:, rows], flat, optimize=True)
            )
            own.append(np.einsum("j,jmck,jmcl->ckl", precision, f, f, optimize=True))
            right.append(
                np.einsum("j,jmck,jm->ck", precision, f, y[:, rows], optimize=True)
            )
        totals = [np.sum(x, axis=0) for x in (cross, own, right)]
        squares = np.empty_like(self.y)
        for i, rows in enumerate([*self._folds, None]):
            last = rows is None
            C, S, s = (
                totals
                if last
                else (totals[0] - cross[i], totals[1] - own[i], totals[2] - right[i])
            )
            X, beta, drop, kept = self._complement(i, C, S, s, c, k)
            best = int(np.argmax(drop))
            at = slice(best * k, (best + 1) * k)
            theta = self._theta[i] - X[:, at] @ beta[best]
            if last:
                break
            residual = self.y[:, rows] - self.Z[:, rows] @ theta
            residual[joints] -= F[:, rows, best] @ beta[best]
            squares[:, rows] = residual**2
        return Score(
            squares=self.blocks.sums(squares.T),
            best=best,
            coef=beta[best] * unit[best],
            outside=float(kept[best]),
            drop=drop,
        )

    def drop(self, joints, F):
        """Fall of the weighted squared error on all rows for one candidate."""
        nj, m, c, k = F.shape
        precision = self.precision[joints]
        power = np.einsum("j,jmck->ck", precision, F**2)
        F = F * np.sqrt(self._unit / np.where(power > 0, power, 1.0))
        flat = F.reshape(nj, m, c * k)
        C = np.einsum("j,jma,jmb->ab", precision, self.Z[joints], flat, optimize=True)
        S = np.einsum("j,jmck,jmcl->ckl", precision, F, F, optimize=True)
        s = np.einsum("j,jmck,jm->ck", precision, F, self.y[joints], optimize=True)
        return float(self._complement(-1, C, S, s, c, k)[2][0])

    def outside(self, joints, F):
        """Share of each column's power outside the others' span, ndarray (c, k)."""
        precision = self.precision[joints]
        power = np.einsum("j,jmck->ck", precision, F**2)
        flat = F.reshape(*F.shape[:2], -1)
        C = np.einsum("j,jma,jmb->ab", precision, self.Z[joints], flat, optimize=True)
        inside = np.einsum("rb,rb->b", C, linalg.cho_solve(self._factors[-1], C))
        with np.errstate(divide="ignore", invalid="ignore"):
            share = 1.0 - inside.reshape(power.shape) / power
        return np.where(power > 0, share, 0.0)

    def _complement(self, i, C, S, s, c, k):
        """Solve for the candidates' own columns beside the refitted others."""
        X = linalg.cho_solve(self._factors[i], C)
        S = S + self.ridge * self._unit * np.eye(k)
        power = np.trace(S, axis1=1, axis2=2)
        Xc = X.reshape(-1, c, k)
        inner = np.einsum("rck,rcl->ckl", C.reshape(-1, c, k), Xc, optimize=True)
        schur = S - inner
        schur = 0.5 * (schur + schur.transpose(0, 2, 1))
        rest = s - np.einsum("rck,r->ck", C.reshape(-1, c, k), self._theta[i])
        kept = np.trace(schur, axis1=1, axis2=2) / np.where(power > 0, power, 1.0)
        # What lies in the span of the others within rounding must not be divided by.
        values, vectors = np.linalg.eigh(schur)
        floor = (SPAN + 2 * self.ridge) * self._unit
        inverse = np.where(values > floor, 1.0 / np.maximum(values, floor), 0.0)
        inside = np.einsum("ckl,ck->cl", vectors, rest)
        beta = np.einsum("ckl,cl->ck", vectors, inverse * inside)
        return X, beta, np.einsum("ck,ck->c", beta, rest), kept


@dataclass(frozen=True, kw_only=True, eq=False)
class Score:
    """What a candidate does to the out-of-sample error.

    Attributes
    ----------
    squares : ndarray of shape (n_blocks, nv)
        Squared residuals with the candidate.
    best : int
        Shape chosen on all rows.
    coef : ndarray of shape (k,)
        Its coefficients on all rows.
    outside : float
        Share of its columns' power that the other columns do not explain.
    drop : ndarray of shape (c,)
        Fall of the weighted sum of squares on all rows, for each shape.
    """

    squares: np.ndarray
    best: int
    coef: np.ndarray
    outside: float
    drop: np.ndarray
