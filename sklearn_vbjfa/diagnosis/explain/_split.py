"""The held-out part: stretches of motion that are kept for the end."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.diagnosis.search._view import even_weight
from sklearn_vbjfa.equations._equations import derivative
from sklearn_vbjfa.equations._plan import observe, resolve_cutoff
from sklearn_vbjfa.equations._states import fit_states
from sklearn_vbjfa.recording import take_rows

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
    # (k,): rows of the search, and the piece that each is in: nothing is filtered or
    # differentiated from one piece to the next
    rows: np.ndarray | None = None
    pieces: np.ndarray | None = None

    def searched(self, recording):
        """Return the rows of a recording that are searched, as a recording."""
        return take_rows(recording, self.rows, self.pieces)

    @property
    def held_out_rows(self):
        """Rows of all held-out stretches, ndarray."""
        return np.r_[self.stretches]

    def held_out(self, recording):
        """Return the held-out rows of a recording, as a recording."""
        return take_rows(recording, self.stretches, range(len(self.stretches)))

    def counted(self, slices):
        """Count the filtered rows of slices in which each joint moves, (nv,)."""
        count = np.zeros(self.moving.shape[1])
        for s in slices:
            inner = slice(s.start + self.half, max(s.stop - self.half, s.start))
            count += self.moving[inner].sum(axis=0)
        return count

    def decided(self, clock, instants):
        """Return the split without stretches in which something jumps."""
        # All that the search knows of such an instant [s] is that it lies between two
        # of its rows on the clock (n,). What changes at the end of a recording changes
        # between recordings, and no split is left without a stretch.
        pairs = list(zip(self.stretches, self.borders))
        kept = [
            (s, border)
            for s, border in pairs
            if not all(border)
            or not any(clock[s.start - 1] < x <= clock[s.stop] for x in instants)
        ]
        stretches, borders = zip(*kept or pairs)
        return replace(self, stretches=stretches, borders=borders)

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
    estimator, dt, options = None, identifier.dt, identifier.fit_options
    if recording.states is None:
        cutoff = options.state_cutoff
        estimator = fit_states(dt, cutoff, recording.q, recording.groups)
    states, facts = observe(recording, estimator, False, identifier.n_jobs)
    limit = np.maximum(facts.standstill(options.standstill, estimator), 0.0)
    longest = max(part.stop - part.start for part in parts)
    cutoff = resolve_cutoff(identifier.cutoff, longest, dt, estimator, identifier.drive)
    speeds = (np.abs(derivative(own, slice(None), 1)) for own in states.full)
    return Split(
        moving=np.concatenate([speed > limit for speed in speeds]),
        half=_lowpass.design(dt, cutoff).half,
        need=FEWEST_VALUES / (2.0 * min(cutoff, 0.5 / dt) * dt),
    )


def _best_count(bare, parts, share):
    """Return the stretches by which all joints are judged best, and if well enough."""
    moving = bare.moving
    total, weight = moving.sum(axis=0), even_weight(moving)
    done = [_progress(weight[part]) for part in parts]
    lengths = [max(int(x * 2 * bare.half), _FEWEST_SAMPLES) for x in _LENGTHS]
    wanted = _STRETCHES if len(parts) == 1 else 1
    can = _LARGEST * total > bare.need
    best, chosen = (False, -1.0), None
    for count in (*range(wanted, _MOST_STRETCHES + 1), *range(wanted - 1, 0, -1)):
        stretches = _place(done, parts, count, share, *lengths)
        kept = sum(moving[stretch].sum(axis=0) for stretch in stretches)
        # A joint that never moves has nothing due.
        due = (kept / np.maximum(total, 1) / share)[total > 0]
        least = float(np.min(due, initial=_DUE))
        enough = bool((bare.counted(stretches) >= bare.need)[can].all())
        if (enough, least) > best:
            best, chosen = (enough, least), stretches
        if best == (True, _DUE):
            break
    return chosen, best[0]


def _progress(weight):
    """Share of the motion (n,) that is done after each row; of time if none moves."""
    done = np.cumsum(weight)
    if not done[-1] > 0:
        done = np.arange(1.0, weight.size + 1)
    return done / done[-1]


def _row(done, share):
    """First row before which this share of the motion lies."""
    return int(np.searchsorted(done, share * (1 - 1e-12), side="left")) + 1


def _place(progress, parts, count, share, shortest, short):
    """Held-out slices of all recordings, in order."""
    found, uncut, turn, alone = [], 0, max(round(1 / share), 2), len(parts) == 1
    for part, done in zip(parts, progress):
        if done.size * min(share, 1 - share) < shortest:
            uncut += 1
            # As a whole, in turns.
            own = [] if alone or uncut % turn else [(0, done.size)]
        else:
            own = _cells(done, count, share, shortest, short)
            if len(own) == 1 and not alone:
                own = _both_ends(done, share, short) or own
        found += [slice(part.start + a, part.start + b) for a, b in own]
    if not found:
        # Too short for a verdict if it is a single one; the fit says what is missing.
        last, n = parts[-1], progress[-1].size
        kept = max(round(share * n), 1) if alone else n
        found = [slice(last.stop - kept, last.stop)]
    return found


def _cells(done, most, share, shortest, short):
    """Held-out ends of cells of equal motion, as many as are long enough."""
    found = []
    for count in range(1, most + 1):
        edges = [0, *(_row(done, k / count) for k in range(1, count)), done.size]
        starts = [_row(done, (k + 1 - share) / count) for k in range(count)]
        cells = list(zip(edges, starts, edges[1:]))
        if count > 1 and np.diff(cells).min() < short:
            break
        found = [(min(start, stop - shortest), stop) for _, start, stop in cells]
    return found


def _both_ends(done, share, short):
    """Both ends of a recording, since motions change; nothing if they are too short."""
    first, last = _row(done, 0.5 * share), _row(done, 1 - 0.5 * share)
    if min(first, done.size - last, last - first) < short:
        return []
    return [(0, first), (last, done.size)]


def _with_stretches(bare, parts, stretches):
    """Return a split with its stretches; all other rows are searched."""
    ends = {edge for part in parts for edge in (part.start, part.stop)}
    starts, stops = {s.start for s in stretches}, {s.stop for s in stretches}
    edges = sorted(ends | starts | stops)
    pieces = np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    rows = np.delete(np.arange(len(pieces)), np.r_[tuple(stretches)])
    return replace(
        bare,
        stretches=tuple(stretches),
        borders=tuple(
            (s.start not in ends | stops, s.stop not in ends | starts)
            for s in stretches
        ),
        rows=rows,
        pieces=pieces[rows],
    )
