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
from sklearn_vbjfa.recording import (
    contiguous_groups,
    take_rows,
)

# Stretches of a single recording: a robot does not do the same all the time, and what
# it does last need not be like the rest.
_STRETCHES = 3
# The most, where fewer would miss the motion of a joint.
_MOST_STRETCHES = 12
# A stretch, and what is left between two of them, is this many times longer than the
# low-pass, which takes half its length at each end; the second number holds where a
# recording has more than one stretch, so that these do not cost more than they show.
_FILTER_LENGTHS, _LENGTHS_OF_MORE = 2.0, 2.5
# Samples, where nothing is filtered.
_FEWEST_SAMPLES = 24
# Each joint should have this share of its due in the held-out part.
_DUE = 0.5
# At most this share of a stretch is given to the guard at either end, and what is tried
# where that would leave too little.
_MOST_GUARD = 0.25
_GUARDS = (1.0, 0.75, 0.5, 0.25, 0.0)
# Values that are independent in the band of the fit: fewer are no sample of an error.
FEWEST_VALUES = 10.0
# The held-out part may grow to this share for them.
_LARGEST = 0.4
_GROWTH = 1.2


@dataclass(frozen=True, kw_only=True, eq=False)
class Split:
    """Rows of the search and held-out stretches."""

    # slices of rows of the search: nothing is filtered or differentiated from one to
    # the next
    searched_parts: tuple
    origins: tuple  # number of the recording that each of them is from
    stretches: tuple  # held-out rows
    # whether rows of the search lie right before and right after each stretch
    borders: tuple
    amount: object  # how much of a motion a stretch holds

    def searched(self, recording):
        """Return the rows of a recording that are searched, as a recording."""
        parts = self.searched_parts
        return take_rows(recording, parts, range(len(parts)))

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

    @property
    def searched_motion(self):
        """Which joints move in the rows that are searched, (n_searched, nv)."""
        return np.concatenate([self.amount.moving[own] for own in self.searched_parts])

    def untouched(self, recording):
        """Return the held-out rows of a recording, as a recording."""
        return take_rows(recording, self.stretches, range(len(self.stretches)))

    @property
    def origin(self):
        """Number of the recording that each row of the search is from, ndarray."""
        lengths = [s.stop - s.start for s in self.searched_parts]
        return np.repeat(np.asarray(self.origins, dtype=int), lengths)

    def decided(self, clock, instants):
        """Return the split without stretches in which something jumps."""
        # All that the search knows of such an instant [s] is that it lies between two
        # of its rows on the clock (n,). A stretch at the end of a recording stays: what
        # changes there changes between the recordings.
        kept = [
            k
            for k, (stretch, border) in enumerate(zip(self.stretches, self.borders))
            if not all(border)
            or not any(
                clock[stretch.start - 1] < x <= clock[stretch.stop] for x in instants
            )
        ]
        # Better a stretch in doubt than none.
        kept = kept or range(len(self.stretches))
        return replace(
            self,
            stretches=tuple(self.stretches[k] for k in kept),
            borders=tuple(self.borders[k] for k in kept),
        )

    def guarded(self, rows):
        """Return the split without the held-out rows next to rows of the search."""
        # What is left of a residual after `rows` rows is new. At least half of what is
        # there is kept, and as much as a verdict needs.
        there = self.amount.of(self.stretches)
        least = np.minimum(np.maximum(self.amount.need, 0.5 * there), there)
        for share in _GUARDS:
            kept = []
            for own, (before, after) in zip(self.stretches, self.borders):
                guard = int(share * min(rows, _MOST_GUARD * (own.stop - own.start)))
                kept.append(slice(own.start + before * guard, own.stop - after * guard))
            if (self.amount.of(kept) >= least).all():
                break
        return replace(self, stretches=tuple(kept))


@dataclass(frozen=True, kw_only=True, eq=False)
class Amount:
    """How much of each joint's motion rows hold."""

    moving: np.ndarray  # (n, nv): which joints move
    half: int  # rows that the low-pass takes at either end
    need: float  # moving rows behind it that a verdict needs

    @property
    def lengths(self):
        """Minimum rows of a stretch, and where a recording has more than one."""
        # Or of the rest between two.
        return [
            max(int(times * 2 * self.half), _FEWEST_SAMPLES)
            for times in (_FILTER_LENGTHS, _LENGTHS_OF_MORE)
        ]

    def of(self, stretches):
        """Count the moving rows of each joint after the low-pass, (nv,)."""
        count = np.zeros(self.moving.shape[1])
        for s in stretches:
            inner = slice(s.start + self.half, max(s.stop - self.half, s.start))
            count += counted_rows(self.moving[inner])
        return count


def check_share(test_size):
    """Return the share that is held out as a float."""
    try:
        share = float(test_size)
    except (TypeError, ValueError):
        share = np.nan
    if not 0 < share < 1:
        raise ValueError(
            "test_size must be the share of the motion that is kept for the test, "
            f"between 0 and 1; got {test_size!r}."
        )
    return share


def split_in_time(identifier, recording, test_size):
    """Choose the held-out stretches from the motion; torques are not looked at."""
    # At both ends of each of several recordings, or at several places of a single one;
    # of recordings that are too short to be cut, some as a whole. The identifier is the
    # declared model, not fitted.
    share, parts = check_share(test_size), recording.segments
    return _divide(_amount(identifier, recording, parts), parts, share)


def _amount(identifier, recording, parts):
    """Which joints move in which rows, and what a verdict needs of that."""
    estimator, dt = None, identifier.dt or 1.0
    if recording.states is None:
        known = recording.q, recording.groups
        estimator = fit_states(
            identifier.dt, identifier.fit_options.state_cutoff, *known
        )
    states, facts = observe(recording, estimator, False, identifier.n_jobs)
    limit = resolve_standstill(identifier.fit_options.standstill, facts.fast())
    cutoff = resolve_cutoff(
        identifier.cutoff,
        max(part.stop - part.start for part in parts),
        identifier.dt,
        estimator,
        identifier.drive,
    )
    band = min(cutoff, 0.5 / dt)
    moving = [
        np.abs(derivative(own, slice(None), 1)) > np.maximum(limit, 0.0)
        for own in states.own
    ]
    return Amount(
        moving=np.concatenate(moving),
        half=_lowpass.design(dt, cutoff).half,
        need=FEWEST_VALUES / (2.0 * band * dt),
    )


def _divide(amount, parts, share):
    """Choose how many stretches a recording has, and where."""
    first = None
    while True:
        chosen, enough = _best_count(amount, parts, share)
        first = chosen if first is None else first
        if enough or share >= _LARGEST:
            # If there is never enough, a larger part is not taken in vain.
            return _described(amount, parts, chosen if enough else first)
        share = min(_GROWTH * share, _LARGEST)


def _best_count(amount, parts, share):
    """Return the stretches by which all joints are judged best, and if well enough."""
    moving, (length, more) = amount.moving, amount.lengths
    total, weight = counted_rows(moving), even_weight(moving)
    if not total.any():
        weight = np.ones(weight.shape)
    most = [_most_stretches(weight[part], share, length, more) for part in parts]
    wanted = _STRETCHES if len(parts) == 1 else 1
    can = _LARGEST * total > amount.need
    best, chosen = (False, -1.0), None
    for count in (*range(wanted, _MOST_STRETCHES + 1), *range(wanted - 1, 0, -1)):
        counts = [min(count, limit) for limit in most]
        stretches = _place(weight, parts, counts, share, length, more)
        kept = sum(counted_rows(moving[stretch]) for stretch in stretches)
        # A joint that never moves has nothing due.
        due = (kept / np.maximum(total, 1) / share)[total > 0]
        least = min(float(np.min(due, initial=_DUE)), _DUE)
        enough = bool((amount.of(stretches) >= amount.need)[can].all())
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
    done = np.cumsum(weight)
    if done[-1] <= 0:
        done = np.arange(1.0, weight.size + 1)
    done = done / done[-1]
    edges = [0, *(_row(done, k / count) for k in range(1, count)), weight.size]
    borders = [_row(done, (k + 1 - share) / count) for k in range(count)]
    return [(edges[k], borders[k], edges[k + 1]) for k in range(count)]


def _row(done, share):
    """First row before which this share of the motion lies."""
    return int(np.searchsorted(done, share * (1 - 1e-12), side="left")) + 1


def _place(weight, parts, counts, share, length, more):
    """Held-out slices of all recordings, in order."""
    short = [k for k, count in enumerate(counts) if count == 0]
    # Recordings too short to be cut are kept as a whole, in turns.
    turn = max(round(1 / share), 2)
    whole = set(short[turn - 1 :: turn])
    if not whole and len(short) == len(parts):
        whole = {short[-1]} if len(short) > 1 else set()
    stretches = []
    for k, (part, count) in enumerate(zip(parts, counts)):
        n = part.stop - part.start
        if k in whole:
            found = [(0, n)]
        elif count == 1 and len(parts) > 1:
            found = _ends(weight[part], share, length, more)
        elif count:
            cells = _cells(weight[part], count, share)
            found = [(min(border, stop - length), stop) for _, border, stop in cells]
        elif len(parts) == 1:
            # Too short for a verdict; the fit says what is missing.
            found = [(n - max(round(share * n), 1), n)]
        else:
            found = []
        stretches += [slice(part.start + a, part.start + b) for a, b in found]
    return stretches


def _ends(weight, share, length, more):
    """Both ends of a recording, since motions change as they go on, or the last."""
    done = np.cumsum(weight)
    n = weight.size
    if done[-1] > 0:
        first = _row(done / done[-1], 0.5 * share)
        last = _row(done / done[-1], 1 - 0.5 * share)
        if more <= first and more <= n - last and more <= last - first:
            return [(0, first), (last, n)]
    ((_, border, stop),) = _cells(weight, 1, share)
    return [(min(border, stop - length), stop)]


def _described(amount, parts, stretches):
    # Of each recording, what lies between its stretches is searched.
    ends = {p.start for p in parts} | {p.stop for p in parts}
    starts, stops = {s.start for s in stretches}, {s.stop for s in stretches}
    borders = [
        (s.start not in ends | stops, s.stop not in ends | starts) for s in stretches
    ]
    searched, origins = [], []
    for k, part in enumerate(parts):
        own = [s for s in stretches if part.start <= s.start < part.stop]
        edges = [part.start, *(e for s in own for e in (s.start, s.stop)), part.stop]
        between = [slice(a, b) for a, b in zip(edges[::2], edges[1::2]) if a < b]
        searched += between
        origins += len(between) * [k]
    return Split(
        searched_parts=tuple(searched),
        origins=tuple(origins),
        stretches=tuple(stretches),
        borders=tuple(borders),
        amount=amount,
    )
