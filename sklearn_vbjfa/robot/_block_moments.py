"""Second moments of blocks of time: what tells how residuals are correlated.

They are made together with the moments of all rows, which are their sum, and merged
like those, so that recordings may come in pieces, in any order and from several
machines.
"""

from dataclasses import dataclass, replace

import numpy as np

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
