"""The held-out part: stretches of motion that are kept for the end."""

from bisect import bisect_right
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.diagnosis.search._view import counted_rows, even_weight
from sklearn_vbjfa.equations._equations import derivative
from sklearn_vbjfa.equations._plan import observe, resolve_cutoff, resolve_standstill
from sklearn_vbjfa.equations._states import fit_states
from sklearn_vbjfa.recording import contiguous_groups, take_rows

# Stretches of a single recording, whose motion need not be the same throughout; the
# most, where fewer would miss the motion of a joint.
_STRETCHES, _MOST_STRETCHES = 3, 12
# Length of a stretch over that of the low-pass, which takes half its length at each
# end; the second number holds for several stretches of one recording.
_LENGTHS = 2.0, 2.5
# Samples of a stretch, where nothing is filtered.
_FEWEST_SAMPLES = 24
# Each joint should have this share of its due in the held-out part.
_DUE = 0.5
# Largest share of a stretch that is a guard, and what is tried of it until enough is
# left.
_MOST_GUARD, _GUARDS = 0.25, (1.0, 0.75, 0.5, 0.25, 0.0)
# Values that are independent in the band of the fit: fewer are no sample of an error.
# The held-out part may grow to a share for them.
FEWEST_VALUES, _LARGEST, _GROWTH = 10.0, 0.4, 1.2


@dataclass(frozen=True, kw_only=True, eq=False)
class Split:
    """Rows of the search, and held-out stretches."""

    moving: np.ndarray  # (n, nv): which joints move
    half: int  # rows that the low-pass takes at either end
    need: float  # filtered rows in which a joint moves that a verdict needs
    stretches: tuple = ()  # held-out rows, slices
    # whether rows of the search lie right before and right after each stretch
    borders: tuple = ()
    # slices of rows of the search: nothing is filtered or differentiated from one to
    # the next; and the number of the recording that each of them is from
    searched_parts: tuple = ()
    origins: tuple = ()

    def searched(self, recording):
        """Return the rows of a recording that are searched, as a recording."""
        parts = self.searched_parts
        return take_rows(recording, parts, range(len(parts)))

    def held_out(self, recording):
        """Return the held-out rows of a recording, as a recording."""
        return take_rows(recording, self.stretches, range(len(self.stretches)))

    @property
    def searched_motion(self):
        """Which joints move in the rows that are searched, (n_searched, nv)."""
        return np.concatenate([self.moving[own] for own in self.searched_parts])

    @property
    def origin(self):
        """Number of the recording that each row of the search is from, ndarray."""
        lengths = [s.stop - s.start for s in self.searched_parts]
        return np.repeat(np.asarray(self.origins, dtype=int), lengths)

    def counted(self, slices):
        """Count the filtered rows of slices in which each joint moves, (nv,)."""
        count = np.zeros(self.moving.shape[1])
        for s in slices:
            inner = slice(s.start + self.half, max(s.stop - self.half, s.start))
            count += counted_rows(self.moving[inner])
        return count

    def narrowed(self, kept, pieces):
        """Return the split with some of its search rows, in pieces (n_kept,)."""
        edges = [0, *accumulate(s.stop - s.start for s in self.searched_parts)]
        if kept.size == edges[-1]:
            return self
        parts, origins = [], []
        for own in contiguous_groups(pieces, kept.size):
            k = bisect_right(edges, kept[own.start]) - 1
            start = self.searched_parts[k].start + int(kept[own.start]) - edges[k]
            parts.append(slice(start, start + own.stop - own.start))
            origins.append(self.origins[k])
        return replace(self, searched_parts=tuple(parts), origins=tuple(origins))

    def decided(self, clock, instants):
        """Return the split without stretches in which something jumps."""
        # All that the search knows of such an instant [s] is that it lies between two
        # of its rows on the clock (n,). What changes at the end of a recording changes
        # between recordings, and no split is left without a stretch.
        kept = [
            k
            for k, (s, border) in enumerate(zip(self.stretches, self.borders))
            if not all(border)
            or not any(clock[s.start - 1] < x <= clock[s.stop] for x in instants)
        ]
        kept = kept or range(len(self.stretches))
        return replace(
            self,
            stretches=tuple(self.stretches[k] for k in kept),
            borders=tuple(self.borders[k] for k in kept),
        )

    def guarded(self, rows):
        """Return the split without the held-out rows next to rows of the search."""
        # A residual is new after `rows` rows. At least half of the motion is kept, and
        # as much as a verdict needs.
        there = self.counted(self.stretches)
        least = np.minimum(np.maximum(self.need, 0.5 * there), there)
        for share in _GUARDS:
            kept = []
            for own, (before, after) in zip(self.stretches, self.borders):
                guard = int(share * min(rows, _MOST_GUARD * (own.stop - own.start)))
                kept.append(slice(own.start + before * guard, own.stop - after * guard))
            if (self.counted(kept) >= least).all():
                break
        return replace(self, stretches=tuple(kept))


def split_in_time(identifier, recording, test_size):
    """Choose the held-out stretches from the motion; torques are not looked at."""
    # At both ends of each of several recordings, or at several places of a single one.
    # The identifier is the declared model, not fitted.
    share, parts = float(test_size), recording.segments
    bare, first = _bare(identifier, recording, parts), None
    while True:
        chosen, enough = _best_count(bare, parts, share)
        first = chosen if first is None else first
        if enough or share >= _LARGEST:
            # If there is never enough, a larger part is not taken in vain.
            return _with_stretches(bare, parts, chosen if enough else first)
        share = min(_GROWTH * share, _LARGEST)


def _bare(identifier, recording, parts):
    """Return which joints move, and what a verdict needs: a split without stretches."""
    estimator, dt = None, identifier.dt or 1.0
    if recording.states is None:
        options = identifier.fit_options
        estimator = fit_states(
            identifier.dt, options.state_cutoff, recording.q, recording.groups
        )
    states, facts = observe(recording, estimator, False, identifier.n_jobs)
    limit = resolve_standstill(identifier.fit_options.standstill, facts.fast())
    longest = max(part.stop - part.start for part in parts)
    cutoff = resolve_cutoff(
        identifier.cutoff, longest, identifier.dt, estimator, identifier.drive
    )
    moving = [
        np.abs(derivative(own, slice(None), 1)) > np.maximum(limit, 0.0)
        for own in states.own
    ]
    return Split(
        moving=np.concatenate(moving),
        half=_lowpass.design(dt, cutoff).half,
        need=FEWEST_VALUES / (2.0 * min(cutoff, 0.5 / dt) * dt),
    )


def _best_count(bare, parts, share):
    """Return the stretches by which all joints are judged best, and if well enough."""
    moving, alone = bare.moving, len(parts) == 1
    total, weight = counted_rows(moving), even_weight(moving)
    if not total.any():
        weight = np.ones(weight.shape)
    lengths = [max(int(x * 2 * bare.half), _FEWEST_SAMPLES) for x in _LENGTHS]
    most = [_most_stretches(weight[part], share, *lengths) for part in parts]
    wanted = _STRETCHES if alone else 1
    can = _LARGEST * total > bare.need
    best, chosen = (False, -1.0), None
    for count in (*range(wanted, _MOST_STRETCHES + 1), *range(wanted - 1, 0, -1)):
        counts = [min(count, limit) for limit in most]
        stretches = _place(weight, parts, counts, share, *lengths)
        kept = sum(counted_rows(moving[stretch]) for stretch in stretches)
        # A joint that never moves has nothing due.
        due = (kept / np.maximum(total, 1) / share)[total > 0]
        least = min(float(np.min(due, initial=_DUE)), _DUE)
        enough = bool((bare.counted(stretches) >= bare.need)[can].all())
        if (enough, least) > best:
            best, chosen = (enough, least), stretches
        if best == (True, _DUE):
            break
    return chosen, best[0]


def _most_stretches(weight, share, length, more):
    """Most stretches of a recording that leave all pieces long enough; 0 for none."""
    if weight.size * min(share, 1 - share) < length:
        return 0
    count = 1
    while count < _MOST_STRETCHES:
        if np.diff(_cells(weight, count + 1, share)).min() < more:
            break
        count += 1
    return count


def _cells(weight, count, share):
    """First row, first held-out row and end of cells of equal motion."""
    edges = [_row(weight, k / count) for k in range(1, count)]
    borders = [_row(weight, (k + 1 - share) / count) for k in range(count)]
    return list(zip([0, *edges], borders, [*edges, weight.size]))


def _row(weight, share):
    """First row before which this share of the motion lies."""
    done = np.cumsum(weight)
    if done[-1] <= 0:
        done = np.arange(1.0, weight.size + 1)
    return int(np.searchsorted(done / done[-1], share * (1 - 1e-12), side="left")) + 1


def _place(weight, parts, counts, share, length, more):
    """Held-out slices of all recordings, in order."""
    short = [k for k, count in enumerate(counts) if count == 0]
    # Recordings that are too short to be cut are held out as a whole, in turns.
    turn = max(round(1 / share), 2)
    whole = set(short[turn - 1 :: turn])
    if not whole and len(short) == len(parts) > 1:
        whole = {short[-1]}
    stretches = []
    for k, (part, count) in enumerate(zip(parts, counts)):
        n = part.stop - part.start
        if k in whole:
            found = [(0, n)]
        elif count:
            ends = count == 1 and len(parts) > 1
            found = _both_ends(weight[part], share, more) if ends else ()
            cells = _cells(weight[part], count, share)
            found = found or [(min(at, stop - length), stop) for _, at, stop in cells]
        elif len(parts) == 1:
            # Too short for a verdict; the fit says what is missing.
            found = [(n - max(round(share * n), 1), n)]
        else:
            found = []
        stretches += [slice(part.start + a, part.start + b) for a, b in found]
    return stretches


def _both_ends(weight, share, more):
    """Both ends of a recording, since motions change; nothing if they are too short."""
    n, first = weight.size, _row(weight, 0.5 * share)
    last = _row(weight, 1 - 0.5 * share)
    if not weight.any() or min(first, n - last, last - first) < more:
        return ()
    return [(0, first), (last, n)]


def _with_stretches(bare, parts, stretches):
    """Return a split with its stretches; what lies between them is searched."""
    ends = {p.start for p in parts} | {p.stop for p in parts}
    starts, stops = {s.start for s in stretches}, {s.stop for s in stretches}
    searched, origins = [], []
    for k, part in enumerate(parts):
        own = [s for s in stretches if part.start <= s.start < part.stop]
        edges = [part.start, *(e for s in own for e in (s.start, s.stop)), part.stop]
        between = [slice(a, b) for a, b in zip(edges[::2], edges[1::2]) if a < b]
        searched += between
        origins += len(between) * [k]
    return replace(
        bare,
        stretches=tuple(stretches),
        borders=tuple(
            (s.start not in ends | stops, s.stop not in ends | starts)
            for s in stretches
        ),
        searched_parts=tuple(searched),
        origins=tuple(origins),
    )
