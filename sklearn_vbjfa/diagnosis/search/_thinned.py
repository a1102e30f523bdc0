"""Thinning of long recordings for the search."""

from dataclasses import replace

import numpy as np

# Most samples that are looked at, and of more than that the fewest for each filtered
# row (of which there are four in a period of the cut-off).
_SAMPLES, _PER_ROW = 50_000, 5
# A stretch is so many times longer than the low-pass, which takes its ends.
_LENGTHS = 30


def stride(n, lowpass):
    """Return which samples of n are looked at: all (1), or every so many."""
    if n <= _SAMPLES:
        return 1
    most = lowpass.step // _PER_ROW
    return max((k for k in range(1, most + 1) if lowpass.step % k == 0), default=1)


def coarser(lowpass, every):
    """Return the same low-pass for every so many of its samples."""
    if every == 1:
        return lowpass
    taps = lowpass.taps[lowpass.half % every :: every]
    return replace(lowpass, taps=taps / taps.sum(), step=lowpass.step // every)


def coarser_rows(parts, lowpass, every):
    """Return rows that are every so many of some parts, and the parts of these."""
    # Those on which the outputs of the low-pass stand, so that the coarser one has the
    # same.
    if every == 1:
        return slice(None), tuple(parts)
    half = lowpass.half // every
    rows, made, first = [], [], 0
    for part in parts:
        count = lowpass.centres(part.stop - part.start).size
        most = (
            2 * half + (count - 1) * (lowpass.step // every) + 1 if count else 2 * half
        )
        own = np.arange(part.start + lowpass.half % every, part.stop, every)[:most]
        rows.append(own)
        made.append(slice(first, first + own.size))
        first += own.size
    return np.concatenate(rows), tuple(made)


def share_of(n, lowpass):
    """Share of n samples that the search looks at, every so many left aside."""
    return min(1.0, _SAMPLES * stride(n, lowpass) / n)


def stretches(parts, moving, lowpass):
    """Return the rows that a search looks at, and the number of the stretch of each."""
    # Of recordings, or pieces of them, `parts`, in which some joints move, `moving`
    # (n, nv): all rows of few.
    n = len(moving)
    share = share_of(n, lowpass)
    length = min(_LENGTHS * (2 * lowpass.half + 1), int(share * n) // 2)
    if share == 1.0:
        kept = list(parts)
    else:
        weight = even_weight(moving)
        kept, due = [], 0.0
        # Short recordings come in turns, which do not know the order of these.
        for part in sorted(
            parts, key=lambda p: (p.stop - p.start, *counted_rows(moving[p]))
        ):
            due += share * (part.stop - part.start)
            found = _within(part, weight[part], int(due), length)
            due -= sum(one.stop - one.start for one in found)
            kept += found
        kept.sort(key=lambda one: one.start)
    rows = [np.arange(one.start, one.stop) for one in kept]
    return np.concatenate(rows), np.repeat(np.arange(len(kept)), list(map(len, rows)))


def counted_rows(moving):
    """Count the rows (n, nv) in which each joint moves, (nv,)."""
    return np.sum(moving, axis=0, dtype=int)


def even_weight(moving):
    """Motion in each row, all joints counting the same, however little they do."""
    return (moving / np.maximum(counted_rows(moving), 1)).sum(axis=1)


def _within(part, weight, most, length):
    """Stretches of a recording, at most so many rows together, slices."""
    n = weight.size
    if most < min(length, n):
        return []
    count = max(min(most, n) // length, 1)
    size = min(most // count, n // count)
    done = np.cumsum(weight)
    if not done[-1] > 0:
        done = np.arange(1.0, n + 1)
    # In the middle of as many intervals of equal motion.
    middle = np.searchsorted(done, (np.arange(count) + 0.5) / count * done[-1])
    first, found = 0, []
    for left, row in zip(range(count - 1, -1, -1), middle.tolist()):
        start = min(max(row - size // 2, first), n - (left + 1) * size)
        found.append(slice(part.start + start, part.start + start + size))
        first = start + size
    return found
