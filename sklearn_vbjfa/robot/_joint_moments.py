"""Second moments of joint-torque regressors, joint by joint.

Second moments of blocks of time: what tells how residuals are correlated.

They are made together with the moments of all rows, which are their sum, and merged
like those, so that recordings may come in pieces, in any order and from several
machines.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._moments import Moments
from sklearn_vbjfa._core._sandwich import block_variance

# Blocks that the recordings of a fit are divided into, all together, and the fewest
# rows of one: 2.5 periods of the cut-off.
_BLOCKS = 40
_FEWEST_ROWS = 10
# Parts of blocks that are kept before those of the same block are added.
_MOST_PARTS = 4 * _BLOCKS


@dataclass(frozen=True, kw_only=True)
class Numbering:
    """How rows behind the low-pass are divided into blocks.

    The division does not depend on the pieces in which a recording comes.

    Attributes
    ----------
    rows : int
        Rows of a block.
    together : int
        Recordings that share a block, where there are more of them than blocks.
    """

    rows: int
    together: int = 1

    @classmethod
    def of(cls, lengths):
        """Divide recordings with so many rows behind the low-pass."""
        return cls(
            rows=max(-(-sum(lengths) // _BLOCKS), _FEWEST_ROWS),
            together=-(-len(lengths) // _BLOCKS),
        )

    def parts(self, recording, rows):
        """Divide a piece of a recording.

        Parameters
        ----------
        recording : int
            Number of the recording.
        rows : slice
            Its rows that the piece has.

        Returns
        -------
        keys : ndarray of shape (n_parts, 2)
            Recording and number of the block that each part belongs to.
        starts : ndarray of shape (n_parts,)
            First row of each part, counted in the piece.
        """
        if self.together > 1:
            return np.array([[recording // self.together, 0]]), np.zeros(1, dtype=int)
        numbers = np.arange(rows.start // self.rows, -(-rows.stop // self.rows))
        starts = np.maximum(numbers * self.rows - rows.start, 0)
        return np.column_stack([np.full(numbers.size, recording), numbers]), starts


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockMoments:
    """Moments of the rows of several blocks, or of parts of them.

    Attributes
    ----------
    keys : ndarray of shape (n_parts, 2)
        Recording and number of each block.
    n : ndarray of shape (n_parts, nv)
        Sums of the weights.
    columns : tuple of slice
        From the first to the last column that is not zero, of each joint.
    G : tuple of ndarray of shape (n_parts, k, k)
        Sums of w phi phi' of these.
    g : tuple of ndarray of shape (n_parts, k)
        Sums of w phi tau of these.
    """

    keys: np.ndarray
    n: np.ndarray
    columns: tuple
    G: tuple
    g: tuple


def merge(first, second):
    """Merge the blocks of disjoint rows, tuples of BlockMoments; None if one is."""
    if first is None or second is None:
        return None
    both = first + second
    if sum(moments.keys.shape[0] for moments in both) > _MOST_PARTS:
        return (_join(both),)
    return both


def _join(several):
    """Add the parts of the same blocks; keys come out sorted."""
    keys = np.concatenate([moments.keys for moments in several])
    unique, row = np.unique(keys, axis=0, return_inverse=True)
    if len(several) == 1 and np.array_equal(unique, keys):
        return several[0]
    row = row.ravel()
    count, nv = unique.shape[0], several[0].n.shape[1]
    columns = tuple(
        slice(min(k.start for k in own), max(k.stop for k in own))
        for own in zip(*[moments.columns for moments in several])
    )
    widths = [k.stop - k.start for k in columns]
    out = BlockMoments(
        keys=unique,
        n=np.zeros((count, nv)),
        columns=columns,
        G=tuple(np.zeros((count, width, width)) for width in widths),
        g=tuple(np.zeros((count, width)) for width in widths),
    )
    first = 0
    for moments in several:
        for i, at in enumerate(row[first : first + moments.keys.shape[0]]):
            out.n[at] += moments.n[i]
            for j, (own, k) in enumerate(zip(moments.columns, columns)):
                inside = slice(own.start - k.start, own.stop - k.start)
                out.G[j][at, inside, inside] += moments.G[j][i]
                out.g[j][at, inside] += moments.g[j][i]
        first += moments.keys.shape[0]
    return out


def variance(stats, weight, theta):
    """Compare the scatter of an estimate between blocks with that of white residuals.

    Parameters
    ----------
    stats : JointStatistics
        Moments of all rows and of the blocks; entries of the former that are zero
        count as such in the latter.
    weight : ndarray of shape (nv,)
        Weights of the joints.
    theta : ndarray of shape (p,)
        Estimate.

    Returns
    -------
    BlockVariance
        Factors of the variances.
    """
    keys = np.concatenate([moments.keys for moments in stats.blocks])
    if np.unique(keys, axis=0).shape[0] < keys.shape[0]:
        return variance(replace(stats, blocks=(_join(stats.blocks),)), weight, theta)
    p = theta.size
    grams, scores = np.zeros((keys.shape[0], p, p)), np.zeros((keys.shape[0], p))
    # What the scores add up to is the input noise's part, or a prior's: every row's.
    excess = weight[:, None] * (stats.g - stats.G @ theta)
    excess /= np.where(stats.n > 0, stats.n, 1.0)[:, None]
    first = 0
    for moments in stats.blocks:
        rows = slice(first, first + moments.keys.shape[0])
        first = rows.stop
        scores[rows] -= moments.n @ excess
        for j in np.flatnonzero(weight):
            k, G, g = moments.columns[j], moments.G[j], moments.g[j]
            power = stats.G[j].diagonal()[k]
            if (power == 0).any():
                G = G * ((power > 0)[:, None] & (power > 0))
                g = g * (power > 0)
            grams[rows, k, k] += weight[j] * G
            scores[rows, k] += weight[j] * (g - G @ theta[k])
    order = np.lexsort(keys.T[::-1])
    squares = stats.yy - 2 * stats.g @ theta + (stats.G @ theta) @ theta
    noise = weight @ np.maximum(squares, 0.0) / stats.n[weight > 0].sum()
    if (np.diff(order) != 1).any():
        grams, scores, keys = grams[order], scores[order], keys[order]
    return block_variance(grams, scores, keys, float(noise))


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
    scatter = np.empty((p + 1, p + 1))
    scatter[:-1, :-1] = np.einsum("j,jik->ik", weight, stats.G)
    scatter[-1, :-1] = scatter[:-1, -1] = weight @ stats.g
    scatter[-1, -1] = weight @ stats.yy
    return Moments(
        n_rows=int(stats.n_rows[used].sum()),
        n_samples=float(stats.n[used].sum()),
        mean=np.zeros(p + 1),
        scatter=scatter,
    )
