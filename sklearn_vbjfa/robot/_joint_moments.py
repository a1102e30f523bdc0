"""Second moments of the equations of joints that share one parameter vector.

Moments are sums over rows, so recordings may come in pieces, in any order and from
several machines. Moments of blocks of time are kept alongside the totals; they show how
residuals are correlated in time.
"""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._moments import Moments
from sklearn_vbjfa._core._sandwich import block_variance
from sklearn_vbjfa.robot._ranges import SignalRanges, sum_ranges

# Number of blocks over all recordings of a fit, and the fewest rows per block: 2.5
# periods of the cut-off.
_BLOCKS = 40
_FEWEST_ROWS = 10
# Parts of blocks that are kept before parts of the same block are merged.
_MOST_PARTS = 4 * _BLOCKS


@dataclass(frozen=True, kw_only=True)
class Numbering:
    """How filtered rows are divided into blocks, however a recording is split."""

    rows: int  # per block
    together: int = 1  # recordings per block, if there are more recordings than blocks

    @classmethod
    def of(cls, lengths):
        """Divide recordings of these numbers of filtered rows."""
        return cls(
            rows=max(-(-sum(lengths) // _BLOCKS), _FEWEST_ROWS),
            together=-(-len(lengths) // _BLOCKS),
        )

    def parts(self, recording, rows):
        """Divide rows (a slice) of a recording, given by its number."""
        # Returns keys (n_parts, 2), recording and block number of each part, and starts
        # (n_parts,), the first row of each part within the slice.
        if self.together > 1:
            return np.array([[recording // self.together, 0]]), np.zeros(1, dtype=int)
        numbers = np.arange(rows.start // self.rows, -(-rows.stop // self.rows))
        starts = np.maximum(numbers * self.rows - rows.start, 0)
        return np.column_stack([np.full(numbers.size, recording), numbers]), starts


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockMoments:
    """Moments of the rows of several blocks, or of parts of them."""

    keys: np.ndarray  # (n_parts, 2): recording and number of each block
    n: np.ndarray  # (n_parts, nv): sums of the weights
    columns: tuple  # range from the first to the last nonzero column of each joint
    G: tuple  # (n_parts, k, k): sums of w phi phi' over these columns
    g: tuple  # (n_parts, k): sums of w phi tau over these columns


def _merge_blocks(first, second):
    """Merge tuples of BlockMoments of disjoint rows; None if either is None."""
    if first is None or second is None:
        return None
    both = first + second
    if sum(moments.keys.shape[0] for moments in both) > _MOST_PARTS:
        return (_join(both),)
    return both


def _join(several):
    """Add up the parts of each block; keys come out sorted."""
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


def block_scatter(stats, weight, theta):
    """Compare an estimate's scatter between blocks with that of white residuals."""
    # weight (nv,): weights of the joints; theta (p,): estimate. Entries that are zero
    # in the total moments count as zero in the blocks. Returns a `BlockVariance`.
    keys = np.concatenate([moments.keys for moments in stats.blocks])
    if np.unique(keys, axis=0).shape[0] < keys.shape[0]:
        return block_scatter(
            replace(stats, blocks=(_join(stats.blocks),)), weight, theta
        )
    p = theta.size
    grams, scores = np.zeros((keys.shape[0], p, p)), np.zeros((keys.shape[0], p))
    # The scores do not sum to zero with input noise or a prior: shared by all rows.
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
class JointMoments:
    """Second moments of each joint's equations, sufficient for a shared fit."""

    n: np.ndarray  # (nv,): sum of the weights of the joint's rows
    n_rows: np.ndarray  # (nv,): number of the joint's rows with positive weight
    # (nv, p, p): sum of w phi phi' over the rows phi of each joint's regressor
    G: np.ndarray
    g: np.ndarray  # (nv, p): sum of w phi tau
    yy: np.ndarray  # (nv,): sum of w tau^2
    # (nv, p, p) or None: contribution of input noise to G, if measured
    noise: np.ndarray | None = None
    # G and g by blocks of time, if the time order of the rows is known
    blocks: tuple | None = None
    # ranges of positions, speeds and directions in the joint's rows with weight, where
    # the states are known
    ranges: SignalRanges | None = None

    def __add__(self, other):
        """Merge the moments of disjoint rows."""
        return JointMoments(
            n=self.n + other.n,
            n_rows=self.n_rows + other.n_rows,
            G=self.G + other.G,
            g=self.g + other.g,
            yy=self.yy + other.yy,
            noise=None if self.noise is None else self.noise + other.noise,
            blocks=_merge_blocks(self.blocks, other.blocks),
            ranges=sum_ranges([self.ranges, other.ranges]),
        )

    def zeroed(self, entries):
        """Return the moments with regressor entries (nv, p), bool, set to zero."""
        keep = ~entries
        both = keep[:, :, None] * keep[:, None, :]
        noise = None if self.noise is None else self.noise * both
        return replace(self, G=self.G * both, g=self.g * keep, noise=noise)

    def columns(self, chosen):
        """Return the moments of some of the columns, without blocks of time."""
        both = np.ix_(range(self.n.size), chosen, chosen)
        noise = None if self.noise is None else self.noise[both]
        return replace(
            self, G=self.G[both], g=self.g[:, chosen], noise=noise, blocks=None
        )

    def residual_squares(self, theta):
        """Weighted sum of squared residuals of each joint, ndarray of shape (nv,)."""
        squares = self.yy - 2 * self.g @ theta
        squares += np.einsum("i,jik,k->j", theta, self.G, theta)
        # A difference of sums: below this fraction of yy it is rounding.
        return np.maximum(squares, 1e-13 * self.yy)

    def split_residual(self, theta):
        """Split residuals into input noise and the rest, deviations (nv,) each."""
        # The first is the input noise through the parameters; the second is nan for a
        # joint without rows.
        n = np.where(self.n > 0, self.n, np.nan)
        through = np.zeros(n.size)
        if self.noise is not None:
            through = np.einsum("i,jik,k->j", theta, self.noise, theta) / n
            through = np.maximum(through, 0.0)  # rounding
        rest = self.residual_squares(theta) / n - through
        return np.sqrt(through), np.sqrt(np.maximum(rest, 0.0))

    def total(self, weight):
        """Return the moments about zero of all joints' rows, with weights (nv,)."""
        p = self.g.shape[1]
        used = weight > 0
        scatter = np.empty((p + 1, p + 1))
        scatter[:-1, :-1] = np.einsum("j,jik->ik", weight, self.G)
        scatter[-1, :-1] = scatter[:-1, -1] = weight @ self.g
        scatter[-1, -1] = weight @ self.yy
        return Moments(
            n_rows=int(self.n_rows[used].sum()),
            n_samples=float(self.n[used].sum()),
            mean=np.zeros(p + 1),
            scatter=scatter,
        )

    def total_noise(self, weight):
        """Input-noise covariance (p, p) of a weighted row of all joints, or None."""
        if self.noise is None:
            return None
        total = self.n[weight > 0].sum()
        return np.einsum("j,jik->ik", weight, self.noise) / total


def joint_moments(Phi, tau, weight, difference=None, parts=None):
    """Accumulate rows Phi (n, nv, p), tau (n, nv) with weights (n, nv)."""
    # difference (n, nv, p): of two regressors from separate halves of the samples; it
    # has the noise of both, their mean a quarter of its square. parts: blocks of time
    # of the rows, see `Numbering.parts`.
    return sum_moments([piece_moments(Phi, tau, weight, difference, parts)])


def piece_moments(Phi, tau, weight, difference=None, parts=None):
    """Accumulate rows for `sum_moments`, see `joint_moments`."""
    # G and noise hold the range of each joint's columns and the matrix of these: of
    # many joints whole matrices would be larger than the rows of a piece.
    root = np.sqrt(weight)
    keys, starts = (None, np.zeros(1, dtype=int)) if parts is None else parts
    made = _part_moments(Phi, tau, root, starts)
    g = np.zeros(Phi.shape[1:])
    for j, (used, _, gs) in enumerate(made):
        g[j, used] = gs.sum(axis=0)
    blocks = None
    if keys is not None:
        columns, Gs, gs = zip(*made)
        n = np.add.reduceat(weight, starts, axis=0)
        blocks = (BlockMoments(keys=keys, n=n, columns=columns, G=Gs, g=gs),)
    return JointMoments(
        n=weight.sum(axis=0),
        n_rows=(weight > 0).sum(axis=0),
        G=tuple((used, Gs.sum(axis=0)) for used, Gs, _ in made),
        g=g,
        yy=np.einsum("nj,nj->j", weight, tau**2),
        noise=None if difference is None else _noise(difference, root),
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
    """Range from the first to the last nonzero column of rows (n, p), a slice."""
    # A joint's torque depends only on the bodies it moves.
    # A few rows usually suffice; checking the rest is faster than column by column.
    columns = np.flatnonzero(rows[:: len(rows) // 8 + 1].any(axis=0))
    if (
        not columns.size
        or rows[:, : columns[0]].any()
        or rows[:, columns[-1] + 1 :].any()
    ):
        columns = np.flatnonzero(rows.any(axis=0))
    return slice(int(columns[0]), int(columns[-1]) + 1) if columns.size else slice(0, 0)


def _noise(difference, root):
    """Take a quarter of the moments of differences, see `piece_moments`."""
    starts = np.zeros(1, dtype=int)
    made = _part_moments(difference, np.zeros(root.shape), root, starts)
    return tuple((used, 0.25 * Gs[0]) for used, Gs, _ in made)


def sum_moments(several):
    """Sum of `JointMoments` of disjoint rows, or of pieces; None if there are none."""
    total = None
    for moments in several:
        if total is None:
            # What is added to must not be anyone else's.
            shape = (*moments.g.shape, moments.g.shape[1])
            noise = moments.noise
            total = replace(
                moments,
                G=_added(np.zeros(shape), moments.G),
                noise=None if noise is None else _added(np.zeros(shape), noise),
            )
            continue
        total = replace(
            total,
            n=total.n + moments.n,
            n_rows=total.n_rows + moments.n_rows,
            G=_added(total.G, moments.G),
            g=total.g + moments.g,
            yy=total.yy + moments.yy,
            noise=None if total.noise is None else _added(total.noise, moments.noise),
            blocks=_merge_blocks(total.blocks, moments.blocks),
            ranges=sum_ranges([total.ranges, moments.ranges]),
        )
    return total


def _added(total, G):
    """Add matrices (nv, p, p), or ranges and theirs, in place; return the sum."""
    for own, other in zip(total, G):
        if isinstance(other, tuple):
            part, other = other
        else:
            used = np.flatnonzero(np.diagonal(other))
            part = slice(used[0], used[-1] + 1) if used.size else slice(0, 0)
            other = other[part, part]
        own[part, part] += other
    return total
