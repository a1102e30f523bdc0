"""States of recordings, and statistics of their motion: ranges, top speeds, stops."""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from joblib import Parallel, delayed

from sklearn_vbjfa._core._runtime import counted, one_blas_thread
from sklearn_vbjfa.equations._states import RecordingStates

# Quantile of the speeds that defines a joint's top speed, robust to outliers.
_TOP_QUANTILE = 0.995
# Below this fraction of its top speed a joint counts as standing still: its friction
# may then take any value inside the stiction band.
STANDSTILL_SHARE = 0.02
# A joint also stands still below the first share of the fastest joint's speed, which
# is rounding, or if it never moves by more than so many deviations of encoder noise.
_ROUNDING, NOISE_DEVIATIONS = 1e-9, 5.0
# A joint that reverses without stopping is below the standstill speed for as long as
# between one and three times that speed; one that stops, longer by this factor.
_STOP_RATIO = 1.2


def in_parallel(function, tasks, n_jobs):
    # Uses threads unless a `joblib.parallel_config` sets another backend: compiled code
    # takes nearly all the time, and nothing is copied. Each has one BLAS thread:
    # matrices are small, and sums must not depend on the number of threads.
    settings = {"prefer": "threads", "return_as": "generator"}
    with one_blas_thread():
        yield from Parallel(n_jobs, **settings)(delayed(function)(*x) for x in tasks)


def n_fastest(n):
    """Return how many of n speeds lie at or above the top-speed quantile."""
    return n - int(np.floor(_TOP_QUANTILE * (n - 1)))


@dataclass(frozen=True, kw_only=True)
class MotionFacts:
    """Statistics of a motion: range of positions, top speeds, stops."""

    n: int
    # (nv,): range of the positions [rad or m]
    lowest: np.ndarray
    highest: np.ndarray
    # (nv,): largest range in one recording
    travel: np.ndarray
    # (k, nv): largest speeds of each joint [rad/s or m/s], in any order
    fastest: np.ndarray
    # (2, nv): number of slow phases between faster motion, and number of stops
    slow: np.ndarray
    # (nv,): `_fastest_period` [s], if all states were available together
    period: np.ndarray | None = None

    @classmethod
    def of(cls, positions, velocities, keep, n_jobs=None):
        """Statistics of the positions and velocities (n, nv) of one recording."""
        # `keep` is `n_fastest` of all recordings together.
        joints = in_parallel(_speeds, ((v, keep) for v in velocities.T), n_jobs)
        fastest, slow = map(np.transpose, zip(*joints))
        lowest, highest = positions.min(axis=0), positions.max(axis=0)
        ranges = {"lowest": lowest, "highest": highest, "travel": highest - lowest}
        return cls(n=positions.shape[0], fastest=fastest, slow=slow, **ranges)

    def merge(self, other, keep):
        return MotionFacts(
            n=self.n + other.n,
            lowest=np.minimum(self.lowest, other.lowest),
            highest=np.maximum(self.highest, other.highest),
            travel=np.maximum(self.travel, other.travel),
            fastest=_largest(np.concatenate([self.fastest, other.fastest]), keep),
            slow=self.slow + other.slow,
        )

    def fast(self):
        """Return the 99.5th percentiles of the speeds (nv,) over all samples."""
        return _top_quantile(self.fastest, self.n)

    @property
    def stops(self):
        """Joints (nv,), bool, that stop in more than half of their reversals."""
        return 2 * self.slow[1] > self.slow[0]

    def standstill(self, setting, estimator):
        """Return the speeds (nv,) of `resolve_standstill`, by an estimator or None."""
        limit = resolve_standstill(setting, self.fast())
        if estimator is None or not isinstance(setting, str):
            return limit
        still = self.travel <= NOISE_DEVIATIONS * np.sqrt(estimator.noise_variance_)
        return np.where(still & ~still.all(), self.fastest.max(axis=0), limit)


def _fastest_period(facts, accelerations):
    """Return periods (nv,) [s] of sines of the joints' top speed and acceleration."""
    # 2 pi times top speed over top acceleration; zero without acceleration.
    speed = facts.fast()
    acceleration = _top_quantile(_largest(accelerations, n_fastest(facts.n)), facts.n)
    out = np.zeros_like(speed)
    return np.divide(2 * np.pi * speed, acceleration, out=out, where=acceleration > 0)


def estimate_states(recording, estimator, halves, n_jobs):
    """Estimate the states of a recording, and the statistics of its motion."""
    # estimator: None if states are given; halves: also from even and odd samples.
    if estimator is not None:
        keep = n_fastest(recording.n_samples)
        return smooth_recording(recording, estimator, halves, keep, n_jobs)
    states = RecordingStates.of_rows(recording.segments, recording.states)
    X = states.full[0] if len(states.full) == 1 else np.concatenate(states.full)
    q, v, a = np.split(X, 3, axis=1)
    keep = n_fastest(X.shape[0])
    parts = [MotionFacts.of(q[x], v[x], keep, n_jobs) for x in recording.segments]
    facts = reduce(lambda x, y: x.merge(y, keep), parts)
    return states, replace(facts, period=_fastest_period(facts, a))


def smooth_recording(recording, estimator, halves, keep, n_jobs):
    """Smooth the positions of a recording, segment by segment, `n_jobs` at a time."""
    # halves: also from the even and odd samples; keep: `n_fastest` of all samples.
    # Returns `RecordingStates` and `MotionFacts`.
    parts = recording.segments
    tasks = ((recording.q[part], part.start, estimator, halves, keep) for part in parts)
    results = in_parallel(_smooth_segment, tasks, n_jobs)
    full, by_half, facts = [], ([], []), None
    for states, pair, new in counted(results, "states", len(parts)):
        full.append(states)
        for half, half_states in zip(by_half, pair or ()):
            half.append(half_states)
        # Merging at once keeps only the fastest rows of all segments in memory.
        facts = new if facts is None else facts.merge(new, keep)
    return RecordingStates(full=full, halves=by_half if halves else None), facts


def _smooth_segment(x, start, estimator, halves, keep):
    states = estimator.smooth(x, start)
    pair = estimator.smooth_halves(x, start) if halves else None
    positions, speeds = (states.derivative(slice(None), order) for order in range(2))
    return states, pair, MotionFacts.of(positions, speeds, keep)


def _speeds(v, keep):
    """Return the top speeds of a joint (n,), and its counts of `_count_stops`."""
    v = np.ascontiguousarray(v)
    fastest = _largest_of(v, keep)
    limit = STANDSTILL_SHARE * _top_quantile(fastest[:, None], v.size)[0]
    return fastest, _count_stops(v, limit)


def _count_stops(v, limit):
    """Count slow phases of a joint between faster motion, and those with a stop."""
    # v (n,): linear between samples; limit: standstill speed.
    low, high = np.minimum(v[:-1], v[1:]), np.maximum(v[:-1], v[1:])
    near = (low < 3 * limit) & (high > -3 * limit) & (limit > 0)
    near |= (low == high) & (np.abs(low) == 3 * limit)
    edges = np.flatnonzero(np.diff(near))[int(near[:1].any()) :] + 1
    rows = np.flatnonzero(near)
    ends = np.searchsorted(rows, edges[: edges.size // 2 * 2].reshape(-1, 2).T)
    low, high, counts = low[rows], high[rows], []
    for speed in (limit, 3 * limit):
        inside = np.maximum(np.minimum(high, speed) - np.maximum(low, -speed), 0.0)
        share = (np.abs(low) <= speed).astype(float)
        np.divide(inside, high - low, out=share, where=high != low)
        counts.append(np.diff(np.r_[0.0, np.cumsum(share)][ends], axis=0)[0])
    below, slow = counts
    return below.size, np.count_nonzero(2 * below > _STOP_RATIO * (slow - below))


def _largest(values, keep):
    """Largest magnitudes of values (n, k), at most `keep` by column, in any order."""
    return np.transpose([_largest_of(x, keep) for x in values.T])


def _largest_of(values, keep):
    sizes = np.abs(values)
    if sizes.size <= keep:
        return sizes
    # A tenth of the values gives a threshold that about twice as many exceed.
    sample = sizes[::10]
    place = max(sample.size - keep // 5 - 2, 0)
    above = sizes[sizes >= np.partition(sample, place)[place]]
    above = above if above.size >= keep else sizes
    return np.partition(above, above.size - keep)[above.size - keep :]


def _top_quantile(largest, n):
    """Return the 99.5th percentiles (k,) of n magnitudes from the largest of them."""
    position = _TOP_QUANTILE * (n - 1)
    below = int(np.floor(position))
    # ascending; the first has rank `below` among all n
    top = np.sort(largest, axis=0)[-(n - below) :]
    return np.quantile(top[:2], position - below, axis=0)


def resolve_standstill(standstill, fast):
    """Return the speeds (nv,) at or below which a joint counts as standing still."""
    # fast (nv,): 99.5th percentiles of the speeds of the joints.
    nv = fast.size
    if standstill is None:
        return np.full(nv, -1.0)
    if isinstance(standstill, str):
        if standstill != "auto":
            raise ValueError(
                f"standstill must be 'auto', a speed, or None; got {standstill!r}."
            )
        return np.maximum(STANDSTILL_SHARE * fast, _ROUNDING * fast.max(initial=0.0))
    value = np.asarray(standstill, dtype=float)
    if value.shape not in {(), (nv,)} or not (value >= 0).all():
        raise ValueError(
            f"standstill must be one non-negative speed or {nv} of them; got "
            f"{standstill!r}."
        )
    return np.broadcast_to(value, (nv,)).copy()
