"""Second moments of the equations of joints that share one parameter vector."""

import functools
import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._linear_systems import block_variance, branches
from sklearn_vbjfa._core._moments import Scatter
from sklearn_vbjfa.equations._ranges import SignalRanges, sum_ranges

# Number of blocks of a fit, and fewest rows per block: 2.5 periods of the cut-off.
_BLOCKS = 40
_FEWEST_ROWS = 10
# Stretches of a single recording that are compared as separate recordings.
_STRETCHES = 4
# Largest number of parts of blocks before parts of the same block are merged.
_MOST_PARTS = 4 * _BLOCKS


@dataclass(frozen=True, kw_only=True)
class BlockAssignment:
    """How filtered rows are divided into blocks, however a recording is split."""

    rows: int  # per block
    per_block: int = 1  # recordings per block, if there are more recordings than blocks
    # (n, 2) of each recording: block of each row, if blocks are phases of a motion
    keys: list | None = None
    # recordings per group whose moments are kept together; None for one recording
    per_group: int | None = None

    @classmethod
    def of(cls, lengths, phases=None):
        per_block = -(-len(lengths) // _BLOCKS)
        per_group = per_block if len(lengths) > 1 else None
        if phases is None:
            return cls(
                rows=max(-(-sum(lengths) // _BLOCKS), _FEWEST_ROWS),
                per_block=per_block,
                per_group=per_group,
            )
        motion, phase = np.unique(phases[0], return_inverse=True)[1], phases[1].copy()
        spans = []
        for mask in (motion == k for k in range(motion.max() + 1)):
            phase[mask] -= phase[mask].min()
            spans.append(int(phase[mask].max()) + 1)
        base = cls.of(spans)
        number = (phase // base.rows).astype(int) if base.per_block == 1 else 0 * motion
        keys = np.column_stack([motion // base.per_block, number])
        keys = np.split(keys, np.cumsum(lengths)[:-1])
        return replace(base, keys=keys, per_group=per_group)

    def recording(self, number):
        """Return the group of a recording and the group size; None for a single one."""
        if self.per_group is None:
            return None
        return number // self.per_group, self.per_group

    def parts(self, recording, rows):
        # Returns keys (n_parts, 2), recording and block number of each part, and starts
        # (n_parts,), the first row of each part within the slice.
        if self.keys is not None:
            keys = self.keys[recording][rows]
            changes = (np.diff(keys, axis=0) != 0).any(axis=1)
            starts = np.flatnonzero(np.r_[True, changes])
            return keys[starts], starts
        if self.per_block > 1:
            return np.array([[recording // self.per_block, 0]]), np.zeros(1, dtype=int)
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
    parts = first + second
    if sum(moments.keys.shape[0] for moments in parts) > _MOST_PARTS:
        return (_join(parts),)
    return parts


def _join(parts):
    """Sum `BlockMoments` of one robot by key."""
    keys = np.concatenate([moments.keys for moments in parts])
    unique, index = np.unique(keys, axis=0, return_inverse=True)
    if len(parts) == 1 and np.array_equal(unique, keys):
        return parts[0]

    def summed(arrays):
        out = np.zeros((len(unique), *arrays[0].shape[1:]))
        for k, values in zip(index.ravel(), itertools.chain(*arrays)):
            out[k] += values
        return out

    return BlockMoments(
        keys=unique,
        n=summed([moments.n for moments in parts]),
        columns=parts[0].columns,
        G=tuple(map(summed, zip(*[moments.G for moments in parts]))),
        g=tuple(map(summed, zip(*[moments.g for moments in parts]))),
    )


def block_scatter(moments, weight, theta):
    """Compare an estimate's scatter between blocks with that of white residuals."""
    # weight (nv,): weights of the joints; theta (p,): estimate. Entries that are zero
    # in the total moments are set to zero in the blocks. Returns a `BlockVariance`.
    blocks = _join(moments.blocks)
    grams, scores = _weighted_parts(moments, blocks, weight, theta)
    squares = moments.yy - 2 * moments.g @ theta + moments.products(theta) @ theta
    noise = weight @ np.maximum(squares, 0.0) / moments.n[weight > 0].sum()
    return block_variance(grams, scores, blocks.keys, float(noise))


def weighted_parts(moments, parts, weight, theta):
    """Keys (n, 2), weighted Gram matrices (n, p, p), scores (n, p) of joined parts."""
    joined = _join(parts)
    branch_grams, scores = _weighted_parts(moments, joined, weight, theta)
    total = np.zeros((*scores.shape, theta.size))
    for columns, grams in branch_grams:
        total[:, columns[:, None], columns] = grams
    return joined.keys, total, scores


def _weighted_parts(moments, blocks, weight, theta):
    """Weighted Gram matrices (n, k, k) and scores (n, p) of `BlockMoments`."""
    # Gram matrices by branch (joints that share columns), each with its columns (k,).
    count = blocks.keys.shape[0]
    scores = np.zeros((count, theta.size))
    # With input noise or a prior scores do not sum to zero: subtract the mean.
    excess = weight[:, None] * (moments.g - moments.products(theta))
    excess /= np.where(moments.n > 0, moments.n, 1.0)[:, None]
    scores -= blocks.n @ excess
    branch_grams, support = [], np.zeros(moments.g.shape, dtype=bool)
    for j in np.flatnonzero(weight):
        support[j, moments.parts[j][0]] = True
    for joints, columns in branches(support):
        grams = np.zeros((count, columns.size, columns.size))
        branch_grams.append((columns, grams))
        for j in joints:
            used = moments.parts[j][0]
            at, cols = np.searchsorted(columns, used), used - blocks.columns[j].start
            G = blocks.G[j][:, cols[:, None], cols]
            grams[:, at[:, None], at] += weight[j] * G
            score = blocks.g[j][:, cols] - G @ theta[used]
            scores[:, used] += weight[j] * score
    return branch_grams, scores


@dataclass(frozen=True, kw_only=True)
class JointMoments:
    """Second moments of each joint's equations, sufficient for a shared fit."""

    n: np.ndarray  # (nv,): sum of the weights of the joint's rows
    n_rows: np.ndarray  # (nv,): number of the joint's rows with positive weight
    # sums of w phi phi' over the rows phi of each joint's regressor: nv pairs of column
    # range and matrix of these columns (with many joints, full ones are mostly zero)
    G: tuple
    g: np.ndarray  # (nv, p): sum of w phi tau
    yy: np.ndarray  # (nv,): sum of w tau^2
    noise: tuple | None = None  # contribution of input noise to G, if measured
    # (nv, p) or None: contribution to g of noise common to inputs and torques
    in_common: np.ndarray | None = None
    # G and g by blocks of time, if the time order of the rows is known
    blocks: tuple | None = None
    # G and g by recordings, see `BlockAssignment.recording`, if there are several
    recordings: tuple | None = None
    # ranges of positions, speeds and directions in the joint's rows with positive
    # weight, if the states are known
    ranges: SignalRanges | None = None

    def in_stretches(self):
        if self.recordings or self.blocks is None:
            return self
        blocks = _join(self.blocks)
        count = len(blocks.keys)
        stretch = _STRETCHES * np.arange(count) // max(count, 1)
        # each stretch is a group of one recording
        keys = np.column_stack([stretch, np.ones_like(stretch)])
        recordings = (_join((replace(blocks, keys=keys),)),)
        few = count < 2 * _STRETCHES
        return replace(self, blocks=None, recordings=None if few else recordings)

    def zeroed(self, entries):
        """Return the moments with regressor entries (nv, p), bool, set to zero."""
        keep = ~entries
        common = None if self.in_common is None else self.in_common * keep
        noise = None if self.noise is None else _kept(self.noise, keep)
        return replace(
            self, G=_kept(self.G, keep), g=self.g * keep, noise=noise, in_common=common
        )

    @functools.cached_property
    def parts(self):
        """Nonzero columns of each joint, and their moments."""
        # Rows of a joint are nonzero only for the bodies that it moves.
        return _parts_of(self.G)

    @functools.cached_property
    def noise_parts(self):
        """Like `parts`, for the input noise; None if it is not measured."""
        return None if self.noise is None else _parts_of(self.noise)

    def products(self, theta):
        """Products of the moments of each joint with parameters (p,), (nv, p)."""
        out = np.zeros(self.g.shape)
        for row, (columns, moments) in zip(out, self.parts):
            row[columns] = moments @ theta[columns]
        return out

    def gram(self, weight):
        """Sum the moments of the joints with weights (nv,), (p, p)."""
        return _summed(self.parts, weight, self.g.shape[1])

    def residual_squares(self, theta):
        """Weighted sum of squared residuals of each joint, ndarray of shape (nv,)."""
        squares = self.yy - 2 * self.g @ theta + squares_of(self.parts, theta)
        # A difference of sums: below this fraction of yy it is rounding.
        return np.maximum(squares, 1e-13 * self.yy)

    def split_residual(self, theta):
        """Split residuals into input noise and remainder, standard deviations (nv,)."""
        # The first is propagated by the parameters. The second is nan without rows.
        n = np.where(self.n > 0, self.n, np.nan)
        propagated = np.zeros(n.size)
        if self.noise is not None:
            propagated = squares_of(self.noise_parts, theta) / n
            propagated = np.maximum(propagated, 0.0)  # rounding
        rest = self.residual_squares(theta) / n - propagated
        return np.sqrt(propagated), np.sqrt(np.maximum(rest, 0.0))

    def total(self, weight):
        """Return the `Scatter` of all joints' rows, with weights (nv,)."""
        # Remove the contribution of common noise to the products of input and torque.
        g = self.g if self.in_common is None else self.g - self.in_common
        return Scatter(
            n_samples=float(self.n[weight > 0].sum()),
            S_xx=self.gram(weight),
            S_xy=weight @ g,
            S_yy=float(weight @ self.yy),
        )

    def total_noise(self, weight):
        """Input-noise covariance (p, p) of a weighted row of all joints, or None."""
        if self.noise is None:
            return None
        total = self.n[weight > 0].sum()
        return _summed(self.noise_parts, weight, self.g.shape[1]) / total


def _parts_of(matrices):
    """Return the nonzero columns of each matrix, and its submatrix of these."""
    parts = []
    for columns, matrix in matrices:
        nonzero = np.flatnonzero(matrix.diagonal())
        parts.append((columns.start + nonzero, matrix[np.ix_(nonzero, nonzero)]))
    return parts


def _summed(parts, weight, p):
    """Sum the matrices of `_parts_of` with weights (nv,), (p, p)."""
    out = np.zeros((p, p))
    for factor, (columns, matrix) in zip(weight, parts):
        out[np.ix_(columns, columns)] += factor * matrix
    return out


def squares_of(parts, theta):
    """Return theta' M theta of the matrices of `_parts_of`, (nv,)."""
    return np.array([theta[at] @ matrix @ theta[at] for at, matrix in parts])


def _kept(matrices, keep):
    """Set rows and columns outside `keep` (nv, p) to zero in matrices of ranges."""
    pairs = zip(keep, matrices)
    return tuple((at, G * np.outer(mask[at], mask[at])) for mask, (at, G) in pairs)


def piece_moments(Phi, tau, weight):
    """Moments of rows Phi (n, nv, p), tau (n, nv) with weights (n, nv)."""
    n, nv, p = Phi.shape
    entries = joint_entries(np.ones((nv, p), dtype=bool), np.arange(nv * p))
    sums = MomentSums(entries, p, tau, weight)
    sums.add(0, Phi.reshape(n, -1).copy())
    return sums.moments()


class MomentSums:
    """Accumulate the moments of a piece from its rows, block by block."""

    # entries: of `joint_entries`, without entries that are zero in every motion; parts,
    # recording: see `BlockAssignment`; drive_noise (n, nv): torque of a drive
    # with position feedback, from the even samples minus that from the odd ones.

    def __init__(
        self,
        entries,
        p,
        tau,
        weight,
        parts=None,
        recording=None,
        *,
        noise=False,
        drive_noise=None,
    ):
        self._entries, self._tau, self._weight = entries, tau, weight
        self._ranges = tuple(_range(columns) for _, columns in entries)
        self._keys, starts = (None, np.zeros(1, dtype=int)) if parts is None else parts
        self._recording, self._starts, self._p = recording, starts, p
        self._ends = [*starts[1:].tolist(), tau.shape[0]]
        widths = [columns.size for _, columns in entries]
        self._G = [np.zeros((starts.size, k, k)) for k in widths]
        self._g = [np.zeros((starts.size, k)) for k in widths]
        self._noise = [np.zeros((1, k, k)) for k in widths] if noise else None
        self._drive_noise = drive_noise if noise else None
        self._common = [np.zeros((1, k)) for k in widths]
        # If all nonzero weights of a joint are equal, sums are multiplied, not rows.
        highest, self._out = weight.max(axis=0, initial=0.0), weight == 0
        uniform = ((weight == highest) | self._out).all(axis=0)
        self._factors = np.where(uniform, highest, np.nan).tolist()
        self._gaps = self._out.any(axis=0).tolist()

    def add(self, first, rows, difference=None):
        """Add entries (n, n_entries) of rows from the piece's row `first` on."""
        # Rows without weight are set to zero. difference: of the regressors from the
        # two halves of the samples; a quarter of its square is the noise of their mean.
        for i, (start, end) in enumerate(zip(self._starts.tolist(), self._ends)):
            span = slice(max(start, first), min(end, first + rows.shape[0]))
            if span.start < span.stop:
                local = slice(span.start - first, span.stop - first)
                noise = None if difference is None else difference[local]
                self._add(i, span, rows[local], noise)

    def _add(self, part, span, rows, difference):
        for j, (columns, _) in enumerate(self._entries):
            factor = self._factors[j]
            values, torque = rows[:, columns], self._tau[span, j]
            noise = None if difference is None else difference[:, columns]
            feedback = None if self._drive_noise is None else self._drive_noise[span, j]
            if not math.isnan(factor):
                for array in (values, noise) if self._gaps[j] else ():
                    if array is not None:
                        array[self._out[span, j]] = 0.0
            else:
                factor, root = 1.0, np.sqrt(self._weight[span, j])
                values, torque = values * root[:, None], torque * root
                noise = None if noise is None else noise * root[:, None]
                feedback = None if feedback is None else feedback * root
            self._G[j][part] += _gram(values, factor)
            self._g[j][part] += factor * (torque @ values)
            if noise is not None:
                self._noise[j][0] += _gram(noise, 0.25 * factor)
                if feedback is not None:
                    self._common[j][0] += 0.25 * factor * (feedback @ noise)

    def moments(self):
        weight, tau = self._weight, self._tau
        G, g, n = self._wide(self._G), self._wide(self._g), weight.sum(axis=0)
        total = [x.sum(axis=0) for x in G], [x.sum(axis=0) for x in g]
        blocks = recordings = noise = common = None
        if self._keys is not None:
            by_part = np.add.reduceat(weight, self._starts, axis=0)
            blocks = _merge_blocks((), (self._parts(self._keys, by_part, G, g),))
        if self._recording is not None:
            whole = [[x[None] for x in sums] for sums in total]
            key = np.array([self._recording])
            recordings = (self._parts(key, n[None], *whole),)
        if self._noise is not None:
            wide = [x[0] for x in self._wide(self._noise)]
            noise = tuple(zip(self._ranges, wide))
        if self._drive_noise is not None:
            common = self._dense([x[0] for x in self._wide(self._common)])
        return JointMoments(
            n=n,
            n_rows=(weight > 0).sum(axis=0),
            G=tuple(zip(self._ranges, total[0])),
            g=self._dense(total[1]),
            yy=np.einsum("nj,nj->j", weight, tau**2),
            noise=noise,
            in_common=common,
            blocks=blocks,
            recordings=recordings,
        )

    def _parts(self, keys, n, G, g):
        return BlockMoments(
            keys=keys, n=n, columns=self._ranges, G=tuple(G), g=tuple(g)
        )

    def _dense(self, sums):
        """Expand sums over column ranges to rows of all columns, (nv, p)."""
        out = np.zeros((len(sums), self._p))
        for row, part, values in zip(out, self._ranges, sums):
            row[part] = values
        return out

    def _wide(self, sums):
        """Expand sums (n, k) or (n, k, k) of entries to the ranges of their columns."""
        out = []
        for total, (_, columns), part in zip(sums, self._entries, self._ranges):
            width, k = part.stop - part.start, total.ndim - 1
            if width > columns.size:
                wide = np.zeros((len(total), *k * (width,)))
                at = k * (columns - part.start,)
                wide[np.ix_(np.arange(len(total)), *at)] = total
                total = wide
            out.append(total)
        return out


def _gram(rows, factor):
    """Gram matrix of the columns of rows (n, k), times a factor."""
    # With one array on both sides, BLAS computes only half of the products.
    gram = rows.T @ rows
    if factor != 1.0:
        gram *= factor
    return gram


def _range(columns):
    """Return the slice from the first to the last of sorted columns (k,)."""
    return slice(int(columns[0]), int(columns[-1]) + 1) if columns.size else slice(0, 0)


def joint_entries(support, used):
    """Pair for each joint the positions of its entries in a row with their columns."""
    # support (nv, p); used (n_entries,): indices of the entries in a flattened matrix.
    # Positions are a slice if they are contiguous.
    joints, columns = np.divmod(used, support.shape[1])
    pairs = []
    for j in range(support.shape[0]):
        positions = np.flatnonzero(joints == j)
        positions = positions[np.argsort(columns[positions])]
        span = _range(positions)
        adjacent = span.stop - span.start == positions.size
        pairs.append((span if adjacent else positions, columns[positions]))
    return pairs


def sum_moments(parts):
    """Sum `JointMoments` of disjoint rows or pieces; None if there are none."""
    total = None
    for moments in parts:
        if total is None:
            total = moments
            continue
        common = total.in_common, moments.in_common
        total = replace(
            total,
            n=total.n + moments.n,
            n_rows=total.n_rows + moments.n_rows,
            G=_added(total.G, moments.G),
            g=total.g + moments.g,
            yy=total.yy + moments.yy,
            noise=None if total.noise is None else _added(total.noise, moments.noise),
            in_common=None if any(x is None for x in common) else sum(common),
            blocks=_merge_blocks(total.blocks, moments.blocks),
            recordings=_merge_blocks(total.recordings, moments.recordings),
            ranges=sum_ranges([total.ranges, moments.ranges]),
        )
    return total


def _added(total, G):
    return tuple((part, x + y) for (part, x), (_, y) in zip(total, G))
