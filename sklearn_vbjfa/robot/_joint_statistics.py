"""Second moments of joint-torque regressors, joint by joint."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._stats import SufficientStatistics
from sklearn_vbjfa.robot._block_moments import BlockMoments, merge


@dataclass(frozen=True, kw_only=True)
class JointStatistics:
    """What a fit of one shared parameter vector needs of each joint's equations.

    Attributes
    ----------
    n : ndarray of shape (nv,)
        Sum of the weights of the joint's rows.
    n_rows : ndarray of shape (nv,)
        Number of the joint's rows with positive weight.
    G : ndarray of shape (nv, p, p)
        sum of w phi phi' over the rows phi of each joint's regressor.
    g : ndarray of shape (nv, p)
        sum of w phi tau.
    yy : ndarray of shape (nv,)
        sum of w tau^2.
    noise : ndarray of shape (nv, p, p) or None
        What of G is input noise, where it was measured.
    blocks : tuple of BlockMoments or None
        G and g by blocks of time, where the order of the rows is known.
    """

    n: np.ndarray
    n_rows: np.ndarray
    G: np.ndarray
    g: np.ndarray
    yy: np.ndarray
    noise: np.ndarray | None = None
    blocks: dict | None = None

    def __add__(self, other):
        """Merge the statistics of disjoint rows."""
        return JointStatistics(
            n=self.n + other.n,
            n_rows=self.n_rows + other.n_rows,
            G=self.G + other.G,
            g=self.g + other.g,
            yy=self.yy + other.yy,
            noise=None if self.noise is None else self.noise + other.noise,
            blocks=merge(self.blocks, other.blocks),
        )


def joint_statistics(Phi, tau, weight, difference=None, parts=None):
    """Accumulate rows.

    Parameters
    ----------
    Phi : ndarray of shape (n, nv, p)
        Regressor matrices.
    tau : ndarray of shape (n, nv)
        Torques.
    weight : ndarray of shape (n, nv)
        Weights, zero to leave a row out.
    difference : ndarray of shape (n, nv, p), default=None
        Difference of two regressor matrices from separate halves of the samples. Its
        noise is that of both halves, that of their mean a quarter of its square.
    parts : tuple of ndarray, default=None
        Blocks of time that the rows belong to, see `Numbering.parts`.
    """
    root = np.sqrt(weight)
    keys, starts = (None, np.zeros(1, dtype=int)) if parts is None else parts
    made = _part_moments(Phi, tau, root, starts)
    _, nv, p = Phi.shape
    G, g = np.zeros((nv, p, p)), np.zeros((nv, p))
    for j, (used, Gs, gs) in enumerate(made):
        G[j, used, used] = Gs.sum(axis=0)
        g[j, used] = gs.sum(axis=0)
    blocks = None
    if keys is not None:
        columns, Gs, gs = zip(*made)
        n = np.add.reduceat(weight, starts, axis=0)
        blocks = (BlockMoments(keys=keys, n=n, columns=columns, G=Gs, g=gs),)
    return JointStatistics(
        n=weight.sum(axis=0),
        n_rows=(weight > 0).sum(axis=0),
        G=G,
        g=g,
        yy=np.einsum("nj,nj->j", weight, tau**2),
        noise=None if difference is None else 0.25 * _gram(difference, root),
        blocks=blocks,
    )


def _part_moments(Phi, tau, root, starts):
    """Moments of parts of the rows, for each joint (columns, their G, their g)."""
    ends = [*starts[1:].tolist(), Phi.shape[0]]
    made = []
    for j in range(Phi.shape[1]):
        used = _used(Phi[:, j])
        rows = Phi[:, j, used] * root[:, j, None]
        torque = tau[:, j] * root[:, j]
        G = np.empty((starts.size, rows.shape[1], rows.shape[1]))
        g = np.empty((starts.size, rows.shape[1]))
        for i, (start, end) in enumerate(zip(starts.tolist(), ends)):
            own = rows[start:end]
            np.matmul(own.T, own, out=G[i])
            np.matmul(torque[start:end], own, out=g[i])
        made.append((used, G, g))
    return made


def _used(rows):
    """From the first column of rows (n, p) that is not zero to the last, a slice.

    A joint's torque does not depend on bodies below it in the tree.
    """
    columns = np.flatnonzero(rows.any(axis=0))
    return slice(int(columns[0]), int(columns[-1]) + 1) if columns.size else slice(0, 0)


def _gram(Phi, root):
    """Sum of root^2 phi phi' over the rows of each joint."""
    _, nv, p = Phi.shape
    G = np.zeros((nv, p, p))
    for j in range(nv):
        used = _used(Phi[:, j])
        rows = Phi[:, j, used] * root[:, j, None]
        G[j, used, used] = rows.T @ rows
    return G


def _least_squares(G, g):
    """Minimum-norm solution in columns scaled to unit diagonal."""
    scale = np.sqrt(np.diagonal(G))
    unit = np.where(scale > 0, scale, 1.0)
    values, vectors = linalg.eigh(G / np.outer(unit, unit))
    keep = values > max(values[-1], 0.0) * values.size * np.finfo(float).eps * 8
    V = vectors[:, keep]
    return V @ ((V.T @ (g / unit)) / values[keep]) / unit


def residual_squares(stats, theta):
    """Weighted sum of squared residuals of each joint, ndarray of shape (nv,)."""
    squares = stats.yy - 2 * stats.g @ theta
    squares += np.einsum("i,jik,k->j", theta, stats.G, theta)
    # A difference of sums: below this share of yy it is rounding.
    return np.maximum(squares, 1e-13 * stats.yy)


def split_residual(stats, theta):
    """Split each joint's residual into what input noise explains and the rest.

    Returns
    -------
    through, rest : ndarray of shape (nv,)
        Standard deviations of the input noise through the parameters, and of what it
        leaves; nan for the rest of a joint without rows.
    """
    n = np.where(stats.n > 0, stats.n, np.nan)
    through = np.zeros(n.size)
    if stats.noise is not None:
        through = np.einsum("i,jik,k->j", theta, stats.noise, theta) / n
        through = np.maximum(through, 0.0)  # rounding
    rest = residual_squares(stats, theta) / n - through
    return np.sqrt(through), np.sqrt(np.maximum(rest, 0.0))


def noise_weights(stats, max_iter=30, tol=1e-6):
    """Inverse residual variance of each joint by iterated weighted least squares.

    Starts from the torques' own mean squares, so that the unit of a joint's torque
    never matters; a joint without rows gets the weight zero.
    """
    used = stats.n > 0
    n = np.where(used, stats.n, 1.0)
    variance = np.where(used & (stats.yy > 0), stats.yy / n, np.inf)
    for _ in range(max_iter):
        weight = 1.0 / variance
        theta = _least_squares(
            np.einsum("j,jik->ik", weight, stats.G), weight @ stats.g
        )
        new = residual_squares(stats, theta) / n
        new = np.where(np.isfinite(variance), new, np.inf)
        # A joint that is fitted exactly would get an infinite weight.
        new = np.maximum(new, 1e-12 * np.where(used, stats.yy / n, np.inf))
        new = np.where(new > 0, new, np.inf)
        finite = np.isfinite(new)
        change = np.abs(new[finite] / variance[finite] - 1)
        variance = new
        if change.size == 0 or change.max() < tol:
            break
    return 1.0 / variance


# Degrees of freedom of Student's t; the customary value for robust regression without
# tuning (Lange, Little and Taylor, 1989).
_STUDENT_FREEDOM = 4.0


def block_precisions(pieces, blocks, max_iter=20, tol=1e-3):
    """Relative precision of each joint's noise in each block of time.

    The residual of a joint is Gaussian with a precision of its own in every block,
    Gamma(nu/2, nu/2) times the joint's: a multivariate Student t. What the model lacks
    (stiction, transients) comes in stretches of time, which then count less. The
    parameters in between are weighted least squares; EM to convergence.

    Parameters
    ----------
    pieces : list of (Phi, tau, weight)
        Equations (n, nv, p), (n, nv), (n, nv).
    blocks : list of ndarray of shape (n,)
        Number of the block of each row, over all pieces.

    Returns
    -------
    list of ndarray of shape (n, nv)
        Factors of the weights, near one.
    """
    n_blocks = 1 + max(int(block.max()) for block in blocks)
    nv = pieces[0][1].shape[1]
    nu = _STUDENT_FREEDOM
    factor = np.ones((n_blocks, nv))
    count = sum(_by_block(w, b, n_blocks) for (_, _, w), b in zip(pieces, blocks))
    for _ in range(max_iter):
        stats = _sum_statistics(pieces, blocks, factor)
        weight = noise_weights(stats)
        theta = _least_squares(
            np.einsum("j,jik->ik", weight, stats.G), weight @ stats.g
        )
        squares = sum(
            _by_block(w * (tau - Phi @ theta) ** 2, b, n_blocks)
            for (Phi, tau, w), b in zip(pieces, blocks)
        )
        scaled = squares * weight
        new = (nu + count) / (nu + scaled)
        new = np.where(count > 0, new, 1.0)
        change = np.abs(new / factor - 1).max()
        factor = new
        if change < tol:
            break
    return [factor[b] for b in blocks]


def _by_block(values, block, n_blocks):
    out = np.zeros((n_blocks, values.shape[1]))
    np.add.at(out, block, values)
    return out


def _sum_statistics(pieces, blocks, factor):
    total = None
    for (Phi, tau, weight), block in zip(pieces, blocks):
        stats = joint_statistics(Phi, tau, weight * factor[block])
        # The factors re-weight the samples; their number stays what it is.
        stats = replace(stats, n=weight.sum(axis=0))
        total = stats if total is None else total + stats
    return total


def combined_noise(stats, weight):
    """Input-noise covariance per weighted row of all joints together, or None."""
    if stats.noise is None:
        return None
    total = stats.n[weight > 0].sum()
    return np.einsum("j,jik->ik", weight, stats.noise) / total


def combine(stats, weight):
    """Statistics of all joints' rows together, weighted, about zero."""
    p = stats.g.shape[1]
    used = weight > 0
    return SufficientStatistics(
        n_rows=int(stats.n_rows[used].sum()),
        n_samples=float(stats.n[used].sum()),
        x_mean=np.zeros(p),
        y_mean=0.0,
        S_xx=np.einsum("j,jik->ik", weight, stats.G),
        S_xy=weight @ stats.g,
        S_yy=float(weight @ stats.yy),
    )
