"""Motion that repeats within recordings and between them."""

from dataclasses import dataclass

import numpy as np

# Time between compared rows [s], and their largest number.
_STEP, _MAX_ROWS = 0.04, 20_000
# Velocities repeat if they differ by less than the first share of their power, after a
# difference above the second one: a slow motion resembles itself a little later.
_TOLERANCE, _DIFFERENT = 0.03, 0.5
# Period: smallest lag with a difference below this times the least one, or this value.
_RATIO, _FLOOR = 3.0, 1e-3
# A joint moves if its speed exceeds this share of that of the fastest joint.
_MOVES = 0.02
# A motion repeats if it occurs more often than this.
_MIN_COUNT = 1.5
# Share of the shorter of two recordings in which they are compared.
_OVERLAP = 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class Repetition:
    """Distinct motions, and the times at which recordings repeat them."""

    begins: np.ndarray  # (r,): start times of recordings [s]
    motion: np.ndarray  # (r,): motion of each recording, from zero
    delay: np.ndarray  # (r,): time within its motion at which a recording begins [s]
    # (m,): periods of the motions [s], infinite for one that is not periodic
    period: np.ndarray
    # repetitions: duration ("seconds"), number ("count"), "recordings" (from zero)
    repeated: tuple[dict, ...]

    def __bool__(self):
        return bool(self.repeated)

    def phase(self, recording, t):
        """Return the motion (n,) and the time in it (n,) [s] of rows."""
        # recording (n,): its number for each row; t (n,): times of the rows [s].
        motion = self.motion[recording]
        phase = t - self.begins[recording] + self.delay[recording]
        period = self.period[motion]
        finite = np.isfinite(period)
        # Rounded: a row at the end of a period belongs to the next one.
        phase[finite] = np.round(phase[finite] % period[finite], 9)
        phase[finite] %= np.round(period[finite], 9)
        return motion, phase


def find_repetition(q, t, parts):
    """Find repeated motion in positions (n, nv); the result is false without any."""
    # q: at times t (n,) [s]; parts: slices of the recordings.
    seconds = np.array([np.ptp(t[part]) for part in parts])
    rows = sum(part.stop - part.start for part in parts)
    step = max(_STEP, seconds.sum() / _MAX_ROWS, seconds.sum() / max(rows, 1))
    speeds = [_speeds(q[part], t[part], step) for part in parts]
    power = np.array([(v**2).sum(axis=0) for v in speeds]).sum(axis=0)
    moves = power > _MOVES**2 * power.max(initial=0.0)
    speeds = [v[:, moves] for v in speeds]
    first, motion, delay, period = [], [], [], []
    for k, v in enumerate(speeds):
        shifts = [_shift(speeds[other], v) for other in first]
        m = next((m for m, x in enumerate(shifts) if x is not None), len(first))
        if m == len(first):
            first.append(k)
            period.append(np.inf)
            delay.append(0.0)
        else:
            delay.append(delay[first[m]] + step * shifts[m])
        motion.append(m)
        period[m] = min(period[m], step * _period(v))
    motion, delay, repeated = np.array(motion), np.array(delay), []
    for k, cycle in enumerate(period):
        members = np.flatnonzero(motion == k)
        length = min(cycle, (delay + seconds)[members].max() - delay[members].min())
        count = seconds[members].sum() / length if length else 0.0
        if count > _MIN_COUNT:
            entry = {"seconds": float(length), "count": float(count)}
            repeated.append(entry | {"recordings": tuple(members.tolist())})
    return Repetition(
        begins=np.array([t[part.start] for part in parts]),
        motion=motion,
        delay=delay,
        period=np.array(period),
        repeated=tuple(repeated),
    )


def _speeds(q, t, step):
    """Return mean velocities (m, nv) in intervals of `step` seconds."""
    if len(q) < 2:
        return np.zeros((0, q.shape[1]))
    edges = np.arange(t[0], t[-1], step)
    rows = np.searchsorted(t[1:-1], edges, side="right")
    share = (edges - t[rows]) / (t[rows + 1] - t[rows])
    return np.diff(q[rows] + share[:, None] * (q[rows + 1] - q[rows]), axis=0) / step


def _differences(a, b):
    """Return lags, overlaps, and largest relative differences of a(i), b(i + lag)."""
    from scipy.signal import fftconvolve

    def products(x, y):
        # The sum of x(i) y(i + lag) for each lag.
        return fftconvolve(y, x[::-1], axes=0)

    n, m = len(a), len(b)
    lags = np.arange(-n + 1, m)
    power = products(np.ones_like(a), b**2) + products(a**2, np.ones_like(b))
    overlap = np.minimum(n, m - lags) - np.maximum(0, -lags)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = 1.0 - 2.0 * products(a, b) / power
    return lags, overlap, np.nan_to_num(share, nan=0.0).max(axis=1, initial=0.0)


def _period(v):
    """Return the smallest lag, in rows, after which a motion repeats, or infinity."""
    n = len(v)
    if n < 4 or not v.size:
        return np.inf
    lags, _, share = _differences(v, v)
    # A period is at most half of the recording; a minimum needs rows on both sides.
    share = share[(lags >= 0) & (lags <= n // 2 + 2)]
    different = np.flatnonzero(share > _DIFFERENT)
    if not different.size:
        return np.inf
    dips = np.flatnonzero((share[1:-1] <= share[:-2]) & (share[1:-1] <= share[2:])) + 1
    minima = [
        _minimum(share, k) for k in dips if k > different[0] and share[k] < _TOLERANCE
    ]
    least = max(_RATIO * min((value for _, value in minima), default=0.0), _FLOOR)
    return next((place for place, value in minima if value <= least), np.inf)


def _shift(a, b):
    """Return the row of motion `a` at which recording `b` begins, None for none."""
    if min(len(a), len(b)) < 4 or not a.size:
        return None
    lags, overlap, share = _differences(a, b)
    share = np.where(overlap >= _OVERLAP * min(len(a), len(b)), share, np.inf)
    best = int(np.argmin(share))
    return -(lags[0] + _minimum(share, best)[0]) if share[best] < _TOLERANCE else None


def _minimum(share, best):
    """Return position and value of a minimum between rows, by parabolic fit."""
    values = share[max(best - 1, 0) : best + 2]
    slope, bend = values[0] - values[-1], values[0] - 2 * share[best] + values[-1]
    if values.size < 3 or not 0 < bend < np.inf:
        return float(best), float(share[best])
    return best + 0.5 * slope / bend, float(share[best] - slope**2 / (8 * bend))
