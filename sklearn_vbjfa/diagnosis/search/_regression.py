"""Out-of-sample scores of candidate columns, from the second moments of folds.

All joints share one parameter vector, so that a column added to one joint's torque
changes all of them. A candidate is scored by refitting everything: the Gram matrix of
the declared columns is factorised once for each fold, and what a candidate adds is the
Schur complement of its own few columns.
"""

import functools
import itertools
from dataclasses import dataclass

import numpy as np
from scipy import linalg

# Ridge to choose from, relative to columns of unit mean square.
_RIDGES = 10.0 ** np.arange(-10, -2)
LEAST_RIDGE = float(_RIDGES[0])
# Directions of the scaled Gram matrix below this are never used.
_RANK = 1e-12
# Share of its own power that a column must keep outside the declared ones' span.
SPAN = 1e-6
_ONE = np.ones((1, 1, 1))


def reduced(equations, precision):
    """Express a regressor in the directions that the data determine.

    Returns it in reduced coordinates (nv, m, r), rows scaled by the root of their
    weight, and the matrix (p, r) that leads back to the parameters.
    """
    weight = equations.weight
    root = np.sqrt(weight).T[:, :, None]
    rows = equations.Phi.transpose(1, 0, 2) * root
    G = np.einsum("j,jmp,jmq->pq", precision, rows, rows, optimize=True)
    scale = np.sqrt(np.diagonal(G))
    used = scale > 0
    unit = np.where(used, scale, 1.0)
    values, vectors = linalg.eigh(G / np.outer(unit, unit))
    keep = values > _RANK * values[-1]
    back = np.where(used[:, None], vectors[:, keep] / unit[:, None], 0.0)
    back *= np.sqrt(max(float((weight * precision).sum()), 1.0))
    return rows @ back, back


class FoldMoments:
    """Second moments of columns fold by fold, joint by joint.

    What the joints weigh may change afterwards.

    Parameters
    ----------
    Z : ndarray of shape (nv, m, r)
        Rows, scaled by the root of their weights.
    y : ndarray of shape (nv, m)
        Torques, scaled alike.
    folds : list of ndarray of int
        Rows of each fold.
    """

    def __init__(self, Z, y, folds):
        self._folds = folds
        # Fold, joint, column, column.
        self._G = np.array([_transposed(Z[:, f]) @ Z[:, f] for f in folds])
        self._g = np.array([_transposed(Z[:, f]) @ y[:, f, None] for f in folds])
        self._last = None

    def _weighted(self, precision):
        """Sum over the joints; the sums for the last weights are kept."""
        # Models beside each other, with other effects, have the same weights, and the
        # sum over many joints takes longer than what the effects add to it.
        last = self._last
        if last is None or not np.array_equal(last[0], precision):
            G = np.einsum("j,fjab->fab", precision, self._G)
            g = np.einsum("j,fja->fa", precision, self._g[..., 0])
            # Set at once: several threads may ask.
            self._last = last = precision.copy(), G, g
        return last[1:]

    def extended(self, Z, y, precision):
        """Gram matrices (n_folds, r, r) and products (n_folds, r) with the torques.

        Weighted sums over the joints, for a Z (nv, m, r) that may have more columns.
        """
        r, known = Z.shape[2], self._G.shape[-1]
        G, g = np.empty((len(self._folds), r, r)), np.empty((len(self._folds), r))
        G[:, :known, :known], g[:, :known] = self._weighted(precision)
        if r > known:
            used = np.flatnonzero(Z[:, :, known:].any(axis=(1, 2)))
            for i, rows in enumerate(self._folds):
                columns = Z[np.ix_(used, rows)]
                new, weight = columns[:, :, known:], precision[used]
                G[i, :, known:] = _weighted_product(weight, columns, new)
                G[i, known:, :known] = G[i, :known, known:].T
                torque = y[np.ix_(used, rows)][:, :, None]
                g[i, known:] = _weighted_product(weight, new, torque)[:, 0]
        return G, g


def _transposed(A):
    return A.transpose(0, 2, 1)


def _weighted_product(precision, A, B):
    """Sum of A' B over joints, weighted, (a, b) for A (nj, m, a), B (nj, m, b)."""
    total = 0.0
    for p, a, b in zip(precision, A, B):
        total = total + p * (a.T @ b)
    return total


@dataclass(frozen=True, kw_only=True, eq=False)
class FamilyMoments:
    """Second moments of c candidates' columns with the model's and with themselves.

    Attributes
    ----------
    cross : ndarray of shape (r, c * k)
        With the model's columns.
    own : ndarray of shape (c, k, k)
        Of each candidate's columns.
    right : ndarray of shape (c, k)
        With the torques.
    """

    cross: np.ndarray
    own: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, precision, Z, y, F):
        """Weighted sum over joints, of columns F (nj, m, c, k)."""
        nj, m, c, k = F.shape
        flat = F.reshape(nj, m, c * k)
        own = np.zeros((c, k, k))
        for p, f in zip(precision, F):
            if k == 1:
                own[:, 0, 0] += p * (f[..., 0] ** 2).sum(axis=0)
            else:
                own += p * (f.transpose(1, 2, 0) @ f.transpose(1, 0, 2))
        right = _weighted_product(precision, _transposed(y[:, None]), flat)
        return cls(
            cross=_weighted_product(precision, Z, flat),
            own=own,
            right=right.reshape(c, k),
        )

    def __add__(self, other):
        """Merge the moments of disjoint rows."""
        return FamilyMoments(
            cross=self.cross + other.cross,
            own=self.own + other.own,
            right=self.right + other.right,
        )

    def __sub__(self, other):
        """Take the moments of some of the rows away."""
        return FamilyMoments(
            cross=self.cross - other.cross,
            own=self.own - other.own,
            right=self.right - other.right,
        )

    def factors(self, size):
        """Factors (c, k) that bring the columns to a square sum."""
        power = np.diagonal(self.own, axis1=1, axis2=2)
        return np.sqrt(size / np.where(power > 0, power, 1.0))

    def times(self, unit):
        """Moments of the columns times factors (c, k)."""
        return FamilyMoments(
            cross=self.cross * unit.ravel(),
            own=self.own * unit[:, :, None] * unit[:, None],
            right=self.right * unit,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Profile:
    """Some columns of a regression with everything else fitted beside them.

    Attributes
    ----------
    left : ndarray of shape (nv, m, k)
        What the other columns leave of them.
    power : ndarray of shape (k,)
        Sum of squares of the columns themselves.
    coef : ndarray of shape (k,)
        Their coefficients.
    residual : ndarray of shape (nv, m)
        What is left of the torques.
    """

    left: np.ndarray
    power: np.ndarray
    coef: np.ndarray
    residual: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Refit:
    """What becomes of a fit with each of c candidates beside the model's columns.

    Attributes
    ----------
    shift : ndarray of shape (r, c * k)
        What the model's coefficients lose for each unit of a candidate's.
    beta : ndarray of shape (c, k)
        Coefficients of the candidates.
    drop : ndarray of shape (c,)
        Fall of the weighted, penalised squared error.
    kept : ndarray of shape (c,)
        Share of the columns' power outside the span of the model's.
    """

    shift: np.ndarray
    beta: np.ndarray
    drop: np.ndarray
    kept: np.ndarray

    def theta(self, theta, best):
        """Coefficients of the model beside one candidate."""
        k = self.beta.shape[1]
        own = slice(best * k, (best + 1) * k)
        return theta - self.shift[:, own] @ self.beta[best]


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
    known : FoldMoments, default=None
        Second moments of the first columns of Z, where they are known already.
    """

    def __init__(self, Z, y, precision, blocks, ridge=None, known=None):
        self.Z, self.y, self.precision, self.blocks = Z, y, precision, blocks
        self._folds = blocks.folds()
        known = FoldMoments(Z, y, self._folds) if known is None else known
        self._G, self._g = known.extended(Z, y, precision)
        diagonal = np.diagonal(self._G.sum(axis=0))
        size = np.sqrt(diagonal.sum() / max(diagonal.size, 1)) or 1.0
        self._unit = size**2
        self.ridge = self._choose() if ridge is None else ridge
        self._solve(self.ridge)

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

    @functools.cached_property
    def _parts(self):
        """Rows and torques of each fold."""
        return [(self.Z[:, rows], self.y[:, rows]) for rows in self._folds]

    @property
    def theta(self):
        """Coefficients fitted to all rows."""
        return self._theta[-1]

    def deviations(self, place):
        """Deviations of some coefficients, a slice, for independent rows of unit noise.

        The weights of the joints are the inverse variances of their residuals.
        """
        unit = np.eye(self.Z.shape[2])[:, place]
        return np.sqrt(np.diagonal(linalg.cho_solve(self._factors[-1], unit)[place]))

    def residuals(self):
        """Out-of-sample residuals (nv, m), scaled by the root of the weights."""
        out = np.empty_like(self.y)
        for rows, theta in zip(self._folds, self._theta):
            out[:, rows] = self.y[:, rows] - self.Z[:, rows] @ theta
        return out

    def squares(self):
        """Out-of-sample squared residuals, summed over blocks (n_blocks, nv)."""
        return self.blocks.sums((self.residuals() ** 2).T)

    def forward_squares(self, border, blocks=None):
        """Squared residuals of the blocks from `border` on, fitted to those before.

        The blocks are those of the folds, or others.
        """
        blocks = self.blocks if blocks is None else blocks
        early = blocks.label < border
        Z, y = self.Z[:, early], self.y[:, early]
        G = _weighted_product(self.precision, Z, Z)
        G += self.ridge * self._unit * np.eye(G.shape[0])
        g = _weighted_product(self.precision, Z, y[:, :, None])[:, 0]
        theta = linalg.solve(G, g, assume_a="pos")
        residual = self.y[:, ~early] - self.Z[:, ~early] @ theta
        sums = blocks.sums(
            np.concatenate([np.zeros((early.sum(), y.shape[0])), (residual**2).T])
        )
        return sums[border:]

    def score(self, joints, F):
        """Score c candidates, one for each value of a shape parameter.

        Their columns F (nj, m, c, k) act on the given joints, rows scaled by the root
        of the weights. The shape is chosen inside each fold, and once more on all rows.
        """
        # A slice takes no copy.
        chosen = slice(joints[0], joints[0] + 1) if len(joints) == 1 else joints
        precision = self.precision[chosen]
        made = [
            FamilyMoments.of(precision, Z[chosen], y[chosen], F[:, rows])
            for rows, (Z, y) in zip(self._folds, self._parts)
        ]
        unit = _total(made).factors(self._unit)
        made = [moments.times(unit) for moments in made]
        total = _total(made)
        squares = np.empty_like(self.y)
        for i, rows in enumerate(self._folds):
            refit = self._refit(i, total - made[i])
            best = int(np.argmax(refit.drop))
            Z, y = self._parts[i]
            residual = y - Z @ refit.theta(self._theta[i], best)
            residual[joints] -= F[:, rows, best] @ (refit.beta[best] * unit[best])
            squares[:, rows] = residual**2
        refit = self._refit(-1, total)
        best = int(np.argmax(refit.drop))
        return Score(
            squares=self.blocks.sums(squares.T),
            best=best,
            coefs=refit.beta * unit,
            outside=float(refit.kept[best]),
            drop=refit.drop,
        )

    def squares_without(self, joint, groups):
        """Squared out-of-sample residuals of a joint (n_blocks, c) with less.

        Each of c groups of columns of Z is left out, everything else fitted anew: by
        the block inverse, without another factorisation.
        """
        columns = np.concatenate(groups)
        edges = np.cumsum([0, *(len(group) for group in groups)])
        unit = np.zeros((self.Z.shape[2], columns.size))
        unit[columns, np.arange(columns.size)] = 1.0
        out = np.empty((self.y.shape[1], len(groups)))
        for i, rows in enumerate(self._folds):
            inverse = linalg.cho_solve(self._factors[i], unit)
            shift = np.empty((unit.shape[0], len(groups)))
            for k, (a, b) in enumerate(itertools.pairwise(edges)):
                group = columns[a:b]
                own = np.linalg.solve(inverse[group, a:b], self._theta[i][group])
                shift[:, k] = inverse[:, a:b] @ own
            Z, y = self._parts[i][0][joint], self._parts[i][1][joint]
            out[rows] = (y - Z @ self._theta[i])[:, None] + Z @ shift
        return self.blocks.sums(out**2)

    def drop(self, joints, F):
        """Fall of the weighted squared error on all rows for one candidate."""
        moments = FamilyMoments.of(
            self.precision[joints], self.Z[joints], self.y[joints], F
        )
        moments = moments.times(moments.factors(self._unit))
        return float(self._refit(-1, moments).drop[0])

    def outside(self, joints, F):
        """Share of each column's power outside the others' span, ndarray (c, k)."""
        precision = self.precision[joints]
        power = np.einsum("j,jmck->ck", precision, F**2)
        flat = F.reshape(*F.shape[:2], -1)
        C = _weighted_product(precision, self.Z[joints], flat)
        inside = np.einsum("rb,rb->b", C, linalg.cho_solve(self._factors[-1], C))
        with np.errstate(divide="ignore", invalid="ignore"):
            share = 1.0 - inside.reshape(power.shape) / power
        return np.where(power > 0, share, 0.0)

    def profile(self, F):
        """Fit columns F (nv, m, k) beside the model's, on all rows, without a ridge.

        Returns a `Profile`.
        """
        C = _weighted_product(self.precision, self.Z, F)
        left = F - self.Z @ linalg.cho_solve(self._factors[-1], C)
        return self._profile(F, left, self.y - self.Z @ self.theta)

    def profile_of(self, place):
        """Return the `Profile` of columns that the model has already, a slice."""
        own = np.zeros(self.Z.shape[2], dtype=bool)
        own[place] = True
        Z, F = self.Z[:, :, ~own], self.Z[:, :, own]
        G, g = self._G.sum(axis=0), self._g.sum(axis=0)
        penalty = self.ridge * self._unit * np.eye(Z.shape[2])
        factor = linalg.cho_factor(G[np.ix_(~own, ~own)] + penalty)
        left = F - Z @ linalg.cho_solve(factor, G[np.ix_(~own, own)])
        return self._profile(F, left, self.y - Z @ linalg.cho_solve(factor, g[~own]))

    def _profile(self, F, left, residual):
        """Regress residuals (nv, m) on what is left of columns (nv, m, k)."""
        S = _weighted_product(self.precision, left, left)
        right = _weighted_product(self.precision, left, residual[:, :, None])[:, 0]
        coef = np.linalg.pinv(S, hermitian=True) @ right
        return Profile(
            left=left,
            power=(F**2).sum(axis=(0, 1)),
            coef=coef,
            residual=residual - left @ coef,
        )

    def left_gram(self, F):
        """Gram matrix (k, k) of what the model leaves of columns F (nv, m, k)."""
        own = _weighted_product(self.precision, F, F)
        C = _weighted_product(self.precision, self.Z, F)
        return own - C.T @ linalg.cho_solve(self._factors[-1], C)

    def _refit(self, i, moments):
        """Solve for candidates beside the model's columns: all but fold i, or all."""
        c, k = moments.right.shape
        X = linalg.cho_solve(self._factors[i], moments.cross)
        own = moments.own + self.ridge * self._unit * np.eye(k)
        power = np.trace(own, axis1=1, axis2=2)
        by_candidate = moments.cross.reshape(-1, c, k).transpose(1, 2, 0)
        schur = own - by_candidate @ X.reshape(-1, c, k).transpose(1, 0, 2)
        schur = 0.5 * (schur + schur.transpose(0, 2, 1))
        rest = moments.right - (self._theta[i] @ moments.cross).reshape(c, k)
        kept = np.trace(schur, axis1=1, axis2=2) / np.where(power > 0, power, 1.0)
        # What lies in the span of the others within rounding must not be divided by.
        values, vectors = np.linalg.eigh(schur) if k > 1 else (schur[:, 0], _ONE)
        floor = (SPAN + 2 * self.ridge) * self._unit
        inverse = np.where(values > floor, 1.0 / np.maximum(values, floor), 0.0)
        inside = (rest[:, None] @ vectors)[:, 0]
        beta = (vectors @ (inverse * inside)[:, :, None])[:, :, 0]
        return Refit(shift=X, beta=beta, drop=(beta * rest).sum(axis=1), kept=kept)


def _total(moments):
    return sum(moments[1:], start=moments[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Score:
    """What a candidate does to the out-of-sample error.

    Attributes
    ----------
    squares : ndarray of shape (n_blocks, nv)
        Squared residuals with the candidate.
    best : int
        Shape chosen on all rows.
    coefs : ndarray of shape (c, k)
        Coefficients of all shapes on all rows.
    outside : float
        Share of its columns' power that the other columns do not explain.
    drop : ndarray of shape (c,)
        Fall of the weighted sum of squares on all rows, for each shape.
    """

    squares: np.ndarray
    best: int
    coefs: np.ndarray
    outside: float
    drop: np.ndarray

    @property
    def coef(self):
        """Coefficients of the best shape on all rows, (k,)."""
        return self.coefs[self.best]
