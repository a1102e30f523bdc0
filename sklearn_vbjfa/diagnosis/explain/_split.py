"""The held-out part: stretches of motion kept for the final evaluation."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.diagnosis.search._view import even_weight
from sklearn_vbjfa.equations._equations import derivative
from sklearn_vbjfa.equations._motion_facts import estimate_states
from sklearn_vbjfa.equations._plan import resolve_cutoff
from sklearn_vbjfa.equations._states import fit_states
from sklearn_vbjfa.recording import take_rows

# Number of stretches of a single recording, whose motion may vary; its upper bound if
# fewer stretches would miss the motion of a joint.
_STRETCHES, _MAX_STRETCHES = 3, 12
# Minimum length of a stretch over that of the low-pass, which loses half its length at
# each end; the second value applies to several stretches of one recording.
_LENGTHS = 2.0, 2.5
# Minimum number of samples of a stretch without low-pass.
_MIN_SAMPLES = 24
# Minimum share of each joint's motion in the held-out part, over `test_size`.
_MIN_SHARE = 0.5
# Largest guard over the length of a stretch, and factors on the guard that are tried
# until enough motion is left.
_MAX_GUARD, _GUARDS = 0.25, (1.0, 0.75, 0.5, 0.25, 0.0)
# Minimum number of independent values, in the band of the fit, for an error; largest
# share, and growth per step, of the held-out part to reach it.
FEWEST_VALUES, _MAX_SHARE, _GROWTH = 10.0, 0.4, 1.2


@dataclass(frozen=True, kw_only=True, eq=False)
class Split:
    """Rows of the search and held-out stretches."""

    moving: np.ndarray  # (n, nv): which joints move
    # (n, nv): filtered rows in motion that each row adds if it lies inside a stretch
    filtered: np.ndarray
    half: int  # rows that the low-pass loses at each end
    need: float  # filtered rows in motion that a verdict needs
    stretches: tuple = ()  # held-out rows, slices
    # whether rows of the search adjoin the start and the end of each stretch
    borders: tuple = ()
    # (k,): rows of the search, and their pieces; no filter or derivative crosses pieces
    rows: np.ndarray | None = None
    pieces: np.ndarray | None = None

    def searched(self, recording):
        """Return the rows of the search, as a recording."""
        return take_rows(recording, self.rows, self.pieces)

    def held_out(self, recording):
        """Return the held-out rows of a recording, as a recording."""
        return take_rows(recording, self.stretches, range(len(self.stretches)))

    def count_moving(self, slices):
        """Count the filtered rows of slices in which each joint moves, (nv,)."""
        half = self.half
        inner = (slice(s.start + half, max(s.stop - half, s.start)) for s in slices)
        return sum(self.filtered[rows].sum(axis=0) for rows in inner)

    def without(self, clock, instants):
        """Return the split without stretches that contain an instant of change."""

        # The search locates an instant [s] only between two of its rows on the clock
        # (n,). A stretch at the end of a recording is not affected, and at least one
        # stretch is kept.
        def clean(s, border):
            inside = (clock[s.start - 1] < x <= clock[s.stop] for x in instants)
            return not all(border) or not any(inside)

        pairs = list(zip(self.stretches, self.borders))
        stretches, borders = zip(*[x for x in pairs if clean(*x)] or pairs)
        return replace(self, stretches=stretches, borders=borders)

    def with_guard(self, rows):
        """Return the split without held-out rows adjacent to rows of the search."""
        # Residuals are uncorrelated after `rows` rows. At least half of the motion is
        # kept, and as much as a verdict needs.
        total = self.count_moving(self.stretches)
        least = np.minimum(np.maximum(self.need, 0.5 * total), total)
        for share in _GUARDS:
            cut = []
            for s, (before, after) in zip(self.stretches, self.borders):
                guard = int(share * min(rows, _MAX_GUARD * (s.stop - s.start)))
                cut.append(slice(s.start + before * guard, s.stop - after * guard))
            if (self.count_moving(cut) >= least).all():
                break
        return replace(self, stretches=tuple(cut))


def split_in_time(identifier, recording, test_size):
    """Choose the held-out stretches from the motion, without using torques."""
    # At both ends of each of several recordings, or in cells of a single one. The
    # identifier is the declared model, not fitted.
    share, parts = float(test_size), recording.segments
    bare, first = _without_stretches(identifier, recording, parts), None
    while True:
        chosen, enough = _best_count(bare, parts, share)
        first = chosen if first is None else first
        if enough or share >= _MAX_SHARE:
            # If the largest share does not suffice, the requested one is used.
            return _with_stretches(bare, parts, chosen if enough else first)
        share = min(_GROWTH * share, _MAX_SHARE)


def _without_stretches(identifier, recording, parts):
    """Return a split with moving joints and needed rows, but no stretches."""
    estimator, dt, options = None, identifier.dt, identifier.fit_options
    if recording.states is None:
        estimator = fit_states(dt, options.state_cutoff, recording.q, recording.groups)
    states, facts = estimate_states(recording, estimator, False, identifier.n_jobs)
    limit = np.maximum(facts.standstill(options.standstill, estimator), 0.0)
    longest = max(part.stop - part.start for part in parts)
    cutoff = resolve_cutoff(identifier.cutoff, longest, dt, estimator, identifier.drive)
    speeds = (np.abs(derivative(q, slice(None), 1)) for q in states.full)
    moving, lowpass = [speed > limit for speed in speeds], _lowpass.design(dt, cutoff)
    filtered = np.zeros((parts[-1].stop, limit.size))
    for part, moves in zip(parts, moving):
        rows = part.start + lowpass.centres(len(moves))
        # as `Segment.filtered_weight`, in rows
        filtered[rows] = lowpass.samples(moves * 1.0) / (lowpass.taps @ lowpass.taps)
        filtered[rows] *= np.where(facts.stops, lowpass.certainty(moves), 1.0)
    return Split(
        moving=np.concatenate(moving),
        filtered=filtered,
        half=lowpass.half,
        need=FEWEST_VALUES / (2.0 * min(cutoff, 0.5 / dt) * dt),
    )


def _best_count(bare, parts, share):
    """Return the stretches with the most motion of all joints, and if it suffices."""
    moving = bare.moving
    total, weight = moving.sum(axis=0), even_weight(moving)
    progress = [_progress(weight[part]) for part in parts]
    lengths = [max(int(x * 2 * bare.half), _MIN_SAMPLES) for x in _LENGTHS]
    wanted = _STRETCHES if len(parts) == 1 else 1
    sufficient = _MAX_SHARE * bare.filtered.sum(axis=0) > bare.need
    best, chosen = (False, -1.0), None
    for count in (*range(wanted, _MAX_STRETCHES + 1), *range(wanted - 1, 0, -1)):
        stretches = _place(progress, parts, count, share, *lengths)
        held_out = sum(moving[stretch].sum(axis=0) for stretch in stretches)
        # Joints that never move are ignored.
        shares = (held_out / np.maximum(total, 1) / share)[total > 0]
        least = float(np.min(shares, initial=_MIN_SHARE))
        enough = bool((bare.count_moving(stretches) >= bare.need)[sufficient].all())
        if (enough, least) > best:
            best, chosen = (enough, least), stretches
        if best == (True, _MIN_SHARE):
            break
    return chosen, best[0]


def _progress(weight):
    """Return the cumulative share of motion (n,); of time if no joint moves."""
    cumulative = np.cumsum(weight if weight.any() else np.ones(weight.size))
    return cumulative / cumulative[-1]


def _row(cum, share):
    """Return the first row with this share of the cumulative motion before it."""
    return int(np.searchsorted(cum, share * (1 - 1e-12), side="left")) + 1


def _place(progress, parts, count, share, shortest, short):
    """Return the held-out slices of all recordings, in order."""
    stretches, n_short, turn, single = [], 0, max(round(1 / share), 2), len(parts) == 1
    for part, cum in zip(parts, progress):
        if cum.size * min(share, 1 - share) < shortest:
            n_short += 1
            # Every `turn`-th of the short recordings is held out as a whole.
            ranges = [] if single or n_short % turn else [(0, cum.size)]
        else:
            ranges = _cells(cum, count, share, shortest, short)
            if len(ranges) == 1 and not single:
                ranges = _both_ends(cum, share, short) or ranges
        stretches += [slice(part.start + a, part.start + b) for a, b in ranges]
    if not stretches:
        # A single recording is too short for a verdict; the fit reports that.
        last, n = parts[-1], progress[-1].size
        size = max(round(share * n), 1) if single else n
        stretches = [slice(last.stop - size, last.stop)]
    return stretches


def _cells(cum, max_count, share, shortest, short):
    """Return held-out ends of cells of equal motion, as many as are long enough."""
    ranges = []
    for count in range(1, max_count + 1):
        edges = [0, *(_row(cum, k / count) for k in range(1, count)), cum.size]
        starts = [_row(cum, (k + 1 - share) / count) for k in range(count)]
        cells = list(zip(edges, starts, edges[1:]))
        if count > 1 and np.diff(cells).min() < short:
            break
        ranges = [(min(start, stop - shortest), stop) for _, start, stop in cells]
    return ranges


def _both_ends(cum, share, short):
    """Return both ends of a recording, since motion varies; none if too short."""
    first, last = _row(cum, 0.5 * share), _row(cum, 1 - 0.5 * share)
    if min(first, cum.size - last, last - first) < short:
        return []
    return [(0, first), (last, cum.size)]


def _with_stretches(bare, parts, stretches):
    """Return a split with its stretches; all other rows are searched."""
    ends = {edge for part in parts for edge in (part.start, part.stop)}
    starts, stops = {s.start for s in stretches}, {s.stop for s in stretches}
    edges = sorted(ends | starts | stops)
    pieces = np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    rows = np.delete(np.arange(len(pieces)), np.r_[tuple(stretches)])
    first, last = ends | stops, ends | starts
    borders = tuple((s.start not in first, s.stop not in last) for s in stretches)
    chosen = {"stretches": tuple(stretches), "borders": borders}
    return replace(bare, rows=rows, pieces=pieces[rows], **chosen)
