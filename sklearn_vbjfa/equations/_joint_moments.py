"""Second moments of the equations of joints that share one parameter vector."""

import functools
import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._linear_systems import block_variance, branches
from sklearn_vbjfa._core._moments import Scatter
from sklearn_vbjfa.equations._ranges import SignalRanges, sum_ranges

# Number of blocks over all recordings of a fit, and the fewest rows per block: 2.5
# periods of the cut-off.
_BLOCKS = 40
_FEWEST_ROWS = 10
# Stretches of a single recording that may differ as recordings do, each of them long.
_STRETCHES = 4
# Parts of blocks that are kept before parts of the same block are merged.
_MOST_PARTS = 4 * _BLOCKS


@dataclass(frozen=True, kw_only=True)
class BlockAssignment:
    """How filtered rows are divided into blocks, however a recording is split."""

    rows: int  # per block
    together: int = 1  # recordings per block, if there are more recordings than blocks
    # (n, 2) of each recording: block of each row, where these are phases of a motion
    keys: list | None = None
    # recordings whose moments are kept as those of one; None of a single recording
    several: int | None = None

    @classmethod
    def of(cls, lengths, phases=None):
        together = -(-len(lengths) // _BLOCKS)
        several = together if len(lengths) > 1 else None
        if phases is None:
            return cls(
                rows=max(-(-sum(lengths) // _BLOCKS), _FEWEST_ROWS),
                together=together,
                several=several,
            )
        motion, phase = np.unique(phases[0], return_inverse=True)[1], phases[1].copy()
        spans = []
        for own in (motion == k for k in range(motion.max() + 1)):
            phase[own] -= phase[own].min()
            spans.append(int(phase[own].max()) + 1)
        made = cls.of(spans)
        number = (phase // made.rows).astype(int) if made.together == 1 else 0 * motion
        keys = np.column_stack([motion // made.together, number])
        keys = np.split(keys, np.cumsum(lengths)[:-1])
        return replace(made, keys=keys, several=several)

    def recording(self, number):
        """Key of a recording, given by its number, among several; None of one alone."""
        # Group of recordings that it is kept in, and how many are in one.
        if self.several is None:
            return None
        return number // self.several, self.several

    def parts(self, recording, rows):
        # Returns keys (n_parts, 2), recording and block number of each part, and starts
        # (n_parts,), the first row of each part within the slice.
        if self.keys is not None:
            own = self.keys[recording][rows]
            new = (np.diff(own, axis=0) != 0).any(axis=1)
            starts = np.flatnonzero(np.r_[True, new])
            return own[starts], starts
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
    """Sum `BlockMoments` of one robot by their keys."""
    keys = np.concatenate([moments.keys for moments in several])
    unique, at = np.unique(keys, axis=0, return_inverse=True)
    if len(several) == 1 and np.array_equal(unique, keys):
        return several[0]

    def summed(parts):
        out = np.zeros((len(unique), *parts[0].shape[1:]))
        for k, own in zip(at.ravel(), itertools.chain(*parts)):
            out[k] += own
        return out

    return BlockMoments(
        keys=unique,
        n=summed([moments.n for moments in several]),
        columns=several[0].columns,
        G=tuple(map(summed, zip(*[moments.G for moments in several]))),
        g=tuple(map(summed, zip(*[moments.g for moments in several]))),
    )


def block_scatter(stats, weight, theta):
    """Compare an estimate's scatter between blocks with that of white residuals."""
    # weight (nv,): weights of the joints; theta (p,): estimate. Entries that are zero
    # in the total moments count as zero in the blocks. Returns a `BlockVariance`.
    blocks = _join(stats.blocks)
    found, scores = _weighted_parts(stats, blocks, weight, theta)
    squares = stats.yy - 2 * stats.g @ theta + stats.products(theta) @ theta
    noise = weight @ np.maximum(squares, 0.0) / stats.n[weight > 0].sum()
    return block_variance(found, scores, blocks.keys, float(noise))


def weighted_parts(stats, parts, weight, theta):
    """Keys (n, 2), weighted Gram matrices (n, p, p), scores (n, p) of joined parts."""
    joined = _join(parts)
    found, scores = _weighted_parts(stats, joined, weight, theta)
    whole = np.zeros((*scores.shape, theta.size))
    for columns, grams in found:
        whole[:, columns[:, None], columns] = grams
    return joined.keys, whole, scores


def _weighted_parts(stats, blocks, weight, theta):
    """Weighted Gram matrices (n, k, k) and scores (n, p) of `BlockMoments`."""
    # The former for each branch, joints that share columns, with these (k,).
    count = blocks.keys.shape[0]
    scores = np.zeros((count, theta.size))
    # The scores do not sum to zero with input noise or a prior: shared by all rows.
    excess = weight[:, None] * (stats.g - stats.products(theta))
    excess /= np.where(stats.n > 0, stats.n, 1.0)[:, None]
    scores -= blocks.n @ excess
    found, support = [], np.zeros(stats.g.shape, dtype=bool)
    for j in np.flatnonzero(weight):
        support[j, stats.parts[j][0]] = True
    for joints, columns in branches(support):
        grams = np.zeros((count, columns.size, columns.size))
        found.append((columns, grams))
        for j in joints:
            own = stats.parts[j][0]
            at, here = np.searchsorted(columns, own), own - blocks.columns[j].start
            G = blocks.G[j][:, here[:, None], here]
            grams[:, at[:, None], at] += weight[j] * G
            left = blocks.g[j][:, here] - G @ theta[own]
            scores[:, own] += weight[j] * left
    return found, scores


@dataclass(frozen=True, kw_only=True)
class JointMoments:
    """Second moments of each joint's equations, sufficient for a shared fit."""

    n: np.ndarray  # (nv,): sum of the weights of the joint's rows
    n_rows: np.ndarray  # (nv,): number of the joint's rows with positive weight
    # sums of w phi phi' over the rows phi of each joint's regressor, nv pairs: range of
    # its columns and matrix of these, as whole ones are mostly zeros with many joints
    G: tuple
    g: np.ndarray  # (nv, p): sum of w phi tau
    yy: np.ndarray  # (nv,): sum of w tau^2
    noise: tuple | None = None  # contribution of input noise to G, if measured
    # (nv, p) or None: contribution to g of noise that inputs and torques have in common
    in_common: np.ndarray | None = None
    # G and g by blocks of time, if the time order of the rows is known
    blocks: tuple | None = None
    # the same by recordings, see `BlockAssignment.recording`, if there are several
    recordings: tuple | None = None
    # ranges of positions, speeds and directions in the joint's rows with weight, where
    # the states are known
    ranges: SignalRanges | None = None

    def in_stretches(self):
        if self.recordings or self.blocks is None:
            return self
        blocks = _join(self.blocks)
        count = len(blocks.keys)
        stretch = _STRETCHES * np.arange(count) // max(count, 1)
        # as recordings are kept, each by itself
        keys = np.column_stack([stretch, np.ones_like(stretch)])
        own = (_join((replace(blocks, keys=keys),)),)
        few = count < 2 * _STRETCHES
        return replace(self, blocks=None, recordings=None if few else own)

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
        """Columns that are not zero in the rows of each joint, and their moments."""
        # A joint has rows of the bodies that it moves alone.
        return _parts_of(self.G)

    @functools.cached_property
    def noise_parts(self):
        """The same of the input noise; None if it is not measured."""
        return None if self.noise is None else _parts_of(self.noise)

    def products(self, theta):
        """Products of the moments of each joint with parameters (p,), (nv, p)."""
        out = np.zeros(self.g.shape)
        for row, (own, moments) in zip(out, self.parts):
            row[own] = moments @ theta[own]
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
        """Split residuals into input noise and the rest, deviations (nv,) each."""
        # The first is the input noise through the parameters; the second is nan for a
        # joint without rows.
        n = np.where(self.n > 0, self.n, np.nan)
        through = np.zeros(n.size)
        if self.noise is not None:
            through = squares_of(self.noise_parts, theta) / n
            through = np.maximum(through, 0.0)  # rounding
        rest = self.residual_squares(theta) / n - through
        return np.sqrt(through), np.sqrt(np.maximum(rest, 0.0))

    def total(self, weight):
        """Return the `Scatter` of all joints' rows, with weights (nv,)."""
        # Without what noise in common adds to the products of inputs and torques.
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
    """Columns that are not zero in matrices of ranges, and these without the others."""
    found = []
    for columns, one in matrices:
        own = np.flatnonzero(one.diagonal())
        found.append((columns.start + own, one[np.ix_(own, own)]))
    return found


def _summed(parts, weight, p):
    """Sum matrices by their parts with weights (nv,), (p, p)."""
    out = np.zeros((p, p))
    for factor, (own, one) in zip(weight, parts):
        out[np.ix_(own, own)] += factor * one
    return out


def squares_of(parts, theta):
    """Return theta' M theta of matrices by their parts, (nv,)."""
    return np.array([theta[own] @ one @ theta[own] for own, one in parts])


def _kept(matrices, keep):
    """Return matrices of ranges whose other rows and columns than `keep` are zero."""
    pairs = zip(keep, matrices)
    return tuple((at, one * np.outer(own[at], own[at])) for own, (at, one) in pairs)


def piece_moments(Phi, tau, weight):
    """Moments of rows Phi (n, nv, p), tau (n, nv) with weights (n, nv)."""
    n, nv, p = Phi.shape
    every = joint_entries(np.ones((nv, p), dtype=bool), np.arange(nv * p))
    sums = MomentSums(every, p, tau, weight)
    sums.add(0, Phi.reshape(n, -1).copy())
    return sums.moments()


class MomentSums:
    """Moments of a piece, whose rows come block by block and are not kept."""

    # entries: of `joint_entries`, those that are zero in every motion are nowhere;
    # parts, recording: see `BlockAssignment`; apart (n, nv): torque of the even samples
    # minus that of the odd ones, of a drive that makes it of positions.

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
        apart=None,
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
        self._apart = apart if noise else None
        self._common = [np.zeros((1, k)) for k in widths]
        # Where rows have one weight, or none, they need not be multiplied with it.
        highest, self._out = weight.max(axis=0, initial=0.0), weight == 0
        alike = ((weight == highest) | self._out).all(axis=0)
        self._factors = np.where(alike, highest, np.nan).tolist()
        self._gaps = self._out.any(axis=0).tolist()

    def add(self, first, rows, difference=None):
        """Add entries (n, n_entries) of rows from the piece's row `first` on."""
        # Rows that do not count are set to zero. difference: of two regressors from
        # separate halves of the samples; it has the noise of both, their mean a quarter
        # of its square.
        stop = first + rows.shape[0]
        for i, (start, end) in enumerate(zip(self._starts.tolist(), self._ends)):
            own = slice(max(start, first), min(end, stop))
            if own.start < own.stop:
                here = slice(own.start - first, own.stop - first)
                apart = None if difference is None else difference[here]
                self._add(i, own, rows[here], apart)

    def _add(self, part, own, rows, difference):
        for j, (where, _) in enumerate(self._entries):
            factor = self._factors[j]
            values, torque = rows[:, where], self._tau[own, j]
            apart = None if difference is None else difference[:, where]
            also = None if self._apart is None else self._apart[own, j]
            if not math.isnan(factor):
                for one in (values, apart) if self._gaps[j] else ():
                    if one is not None:
                        one[self._out[own, j]] = 0.0
            else:
                factor, root = 1.0, np.sqrt(self._weight[own, j])
                values, torque = values * root[:, None], torque * root
                apart = None if apart is None else apart * root[:, None]
                also = None if also is None else also * root
            self._G[j][part] += _gram(values, factor)
            self._g[j][part] += factor * (torque @ values)
            if apart is not None:
                self._noise[j][0] += _gram(apart, 0.25 * factor)
                if also is not None:
                    self._common[j][0] += 0.25 * factor * (also @ apart)

    def moments(self):
        weight, tau = self._weight, self._tau
        G, g, n = self._wide(self._G), self._wide(self._g), weight.sum(axis=0)
        total = [own.sum(axis=0) for own in G], [own.sum(axis=0) for own in g]
        blocks = recordings = noise = common = None
        if self._keys is not None:
            by_part = np.add.reduceat(weight, self._starts, axis=0)
            blocks = _merge_blocks((), (self._parts(self._keys, by_part, G, g),))
        if self._recording is not None:
            whole = [[own[None] for own in sums] for sums in total]
            key = np.array([self._recording])
            recordings = (self._parts(key, n[None], *whole),)
        if self._noise is not None:
            wide = [own[0] for own in self._wide(self._noise)]
            noise = tuple(zip(self._ranges, wide))
        if self._apart is not None:
            common = self._dense([own[0] for own in self._wide(self._common)])
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
        """Put sums of the ranges of columns into rows of all columns, (nv, p)."""
        out = np.zeros((len(sums), self._p))
        for row, part, own in zip(out, self._ranges, sums):
            row[part] = own
        return out

    def _wide(self, sums):
        """Put sums (n, k) or (n, k, k) of entries into the ranges of their columns."""
        out = []
        for own, (_, columns), part in zip(sums, self._entries, self._ranges):
            width, k = part.stop - part.start, own.ndim - 1
            if width > columns.size:
                wide = np.zeros((len(own), *k * (width,)))
                at = k * (columns - part.start,)
                wide[np.ix_(np.arange(len(own)), *at)] = own
                own = wide
            out.append(own)
        return out


def _gram(rows, factor):
    """Matrix of products of the columns of rows (n, k), times a factor."""
    # One array on both sides: half of the products do.
    gram = rows.T @ rows
    if factor != 1.0:
        gram *= factor
    return gram


def _range(columns):
    """Range from the first to the last of columns (k,) in order, a slice."""
    return slice(int(columns[0]), int(columns[-1]) + 1) if columns.size else slice(0, 0)


def joint_entries(support, used):
    """Pair for each joint the places of its entries in a row with their columns."""
    # support (nv, p); used (n_entries,): places of entries in a flattened matrix. Those
    # of a joint are a slice where they follow one another.
    joints, columns = np.divmod(used, support.shape[1])
    found = []
    for j in range(support.shape[0]):
        own = np.flatnonzero(joints == j)
        own = own[np.argsort(columns[own])]
        places = _range(own)
        adjacent = places.stop - places.start == own.size
        found.append((places if adjacent else own, columns[own]))
    return found


def sum_moments(several):
    """Sum of `JointMoments` of disjoint rows, or of pieces; None if there are none."""
    total = None
    for moments in several:
        if total is None:
            total = moments
            continue
        both = total.in_common, moments.in_common
        total = replace(
            total,
            n=total.n + moments.n,
            n_rows=total.n_rows + moments.n_rows,
            G=_added(total.G, moments.G),
            g=total.g + moments.g,
            yy=total.yy + moments.yy,
            noise=None if total.noise is None else _added(total.noise, moments.noise),
            in_common=None if any(x is None for x in both) else sum(both),
            blocks=_merge_blocks(total.blocks, moments.blocks),
            recordings=_merge_blocks(total.recordings, moments.recordings),
            ranges=sum_ranges([total.ranges, moments.ranges]),
        )
    return total


def _added(total, G):
    return tuple((part, own + other) for (part, own), (_, other) in zip(total, G))
