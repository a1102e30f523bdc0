"""Checks of the rows of a log that need little of the robot model."""

import functools
from itertools import combinations, pairwise

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._likelihood import Bodies
from sklearn_vbjfa.inspection._sentences import finding, percent
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.recording import (
    bridged,
    filled_gaps,
    rows_alternate,
    rows_per_sample,
)


class Rows:
    """Rows of a log, and the faults that checks find in them."""

    # q [rad or m], tau [N m or N] (n, nv), which the checks change: they unwrap them
    # and interpolate lost rows; parts: slices of all rows; place: text of a row.

    def __init__(self, robot, names, q, tau, dt, parts, place):
        self.robot, self.revolute = robot, ~is_prismatic(robot.model)
        self.names, self.q, self.tau, self.dt = names, q, tau, dt
        self.parts, self.place = parts, place
        self.findings = []
        self.label = np.repeat(np.arange(len(parts)), [p.stop - p.start for p in parts])
        self.first = np.isin(np.arange(len(q)), [part.start for part in parts])
        self.usable = np.ones(q.shape, dtype=bool)
        self.counted = np.ones(len(q), dtype=bool)  # rows with nonzero weight
        self.held = np.zeros(q.shape[1], dtype=bool)  # torques updated at a lower rate
        self.every = 1  # rows per update of all positions
        self.jumps = []  # rows at which positions jump and do not return

    @functools.cached_property
    def still(self):
        """Joints that never move, ndarray (nv,) of bool."""
        return still_joints(self.q, self.parts)

    @functools.cached_property
    def moves(self):
        """Rows in which each joint moves, ndarray (n, nv) of bool."""
        moves = np.zeros(self.q.shape, dtype=bool)
        for part in self.parts:
            q = self.q[part]
            width = max(2, min(20, len(q) // 8))
            travel = np.zeros(q.shape)
            travel[width:-width] = np.abs(q[2 * width :] - q[: -2 * width])
            high = np.maximum(np.quantile(travel, 0.99, axis=0), 1e-300)
            moves[part] = travel > 0.02 * high
        return moves

    @functools.cached_property
    def moving(self):
        """Rows in which any joint moves, ndarray (n,) of bool."""
        return self.moves.any(axis=1)

    def steps(self, x):
        """Return differences to the row before, zero where a recording begins."""
        step = np.diff(x, axis=0, prepend=x[:1])
        step[self.first] = 0
        return step

    def runs(self, flags):
        """Return first and last row of each run of true flags within a recording."""
        flags = flags & self.counted
        previous = np.r_[False, flags[:-1]] & ~self.first
        starts = np.flatnonzero(flags & ~previous)
        ends = np.flatnonzero(flags & ~np.r_[flags[1:] & ~self.first[1:], False])
        return list(zip(starts.tolist(), ends.tolist()))

    def together(self, first, last):
        """Whether two rows exist and belong to the same recording."""
        inside = 0 <= first and last < len(self.label)
        return inside and self.label[first] == self.label[last]

    def report(self, kind, joints, severity, runs=(), **facts):
        """Add a finding, optionally on runs of rows (first, last)."""
        if len(runs):
            longest = max(b - a + 1 for a, b in runs)
            facts |= {"times": len(runs), "place": self.place(runs[0][0])}
            facts |= {"count": sum(b - a + 1 for a, b in runs), "longest": longest}
            facts |= {"share": percent(facts["count"] / len(self.q))}
            facts |= {"seconds": longest * self.dt}
        self.findings.append(finding(kind, self.names, joints, severity, **facts))


def _mask(x, runs):
    """Mark runs of rows (first, last), ndarray (n,) of bool."""
    marked = np.zeros(len(x), dtype=bool)
    for a, b in runs:
        marked[a : b + 1] = True
    return marked


def shuffled_rows(names, q, parts):
    """Find rows of positions (n, nv) that are out of time order; one error or none."""
    # parts: slices of the recordings.
    pieces = [np.asarray(q[part]) for part in parts if part.stop > part.start]
    sizes = np.array([len(x) for x in pieces])
    n = int(sizes.sum()) - len(pieces)
    if n < number.SHORT_RUN:
        return []

    squares = [[np.square(np.diff(y)).sum() for y in x.T] for x in pieces]
    square = np.sum(squares, axis=0)
    variance = sizes @ [[y.var() for y in x.T] for x in pieces] / sizes.sum()
    moving = variance > number.LEAST_MOTION**2
    smallest = (square[moving] / (2 * n * variance[moving])).min(initial=np.inf)
    if not (number.SHUFFLED <= smallest < np.inf or any(map(rows_alternate, pieces))):
        return []
    every, facts = range(len(names)), {"change": np.sqrt(2 * smallest)}
    return [finding("shuffled_rows", names, every, "error", **facts)]


def _check_wraps(log):
    """Find angles that jump by a full turn, and unwrap them."""
    # An error: differentiating across a jump gives speeds of hundreds of rad/s.
    revolute = np.flatnonzero(log.revolute).tolist()
    widest = max((np.ptp(log.q[:, j]) for j in revolute), default=0.0)
    # Degrees and encoder counts may be wrapped, too.
    least = 1.0 if widest <= 1.0 else number.FEWEST_COUNTS
    counts = 2.0 ** np.ceil(np.log2(max(widest, least)))
    for turn, text in ((2 * np.pi, "2 pi"), (360.0, "360"), (counts, f"{counts:.0f}")):
        jumps = {j: _find_wraps(log, log.q[:, j], turn) for j in revolute}
        jumps = {j: rows for j, rows in jumps.items() if rows.size}
        if not jumps:
            continue
        for j in jumps:
            log.q[:, j] = _unwrapped(log, log.q[:, j], turn)
        rows = np.concatenate(list(jumps.values()))
        facts = {"count": rows.size, "place": log.place(rows.min()), "turn": text}
        log.report("wrapped_position", list(jumps), "error", **facts)


def _check_overflows(log):
    """Find torques that jump by a constant span between their extremes."""
    for j in np.flatnonzero(log.usable.any(axis=0)):
        x, span = log.tau[:, j], np.ptp(log.tau[:, j])
        rows = _find_wraps(log, x, span)
        # Outliers begin far from the other extreme, and without its jumps by twice the
        # friction, a torque has a small range.
        step = np.median(np.abs(log.steps(x)[rows])) if rows.size > 1 else 0.0
        is_full = step > (1 - number.EDGE) * span
        if is_full and np.ptp(_unwrapped(log, x, span)) > number.WORST * span:
            facts = {"count": rows.size, "place": log.place(rows[0]), "span": span}
            log.report("wrapped_torque", j, "error", **facts)
            log.usable[:, j] = False


def _unwrapped(log, x, turn):
    """Return a channel (n,) without jumps by a full turn."""
    pieces = [np.unwrap(x[part], period=turn) for part in log.parts]
    # Each recording may begin in a different turn.
    return np.concatenate([y - turn * np.round(y.mean() / turn) for y in pieces])


def _find_wraps(log, x, turn):
    """Return the rows after jumps by a full turn."""
    step = log.steps(x)
    jumps = np.flatnonzero(np.abs(step) > (1 - number.TURN_LEFT) * turn)
    # If many steps are as large as a turn, the channel has another fault.
    widest = max(np.ptp(x[part]) for part in log.parts)
    if not 0 < jumps.size <= 0.05 * step.size or widest > 1.1 * turn:
        return jumps[:0]
    remainder = step - turn * np.round(step / turn)
    typical = np.quantile(np.abs(np.delete(step, jumps)), 0.999)
    # After unwrapping, the steps must be as small as the others.
    return jumps[np.abs(remainder[jumps]) <= 3 * typical + 1e-3 * turn]


def still_joints(q, parts):
    """Return which joints are always at rest, up to position noise, (nv,) of bool."""
    pieces = [q[part] for part in parts if part.stop > part.start]
    travel = np.max([np.ptp(x, axis=0) for x in pieces], axis=0)
    differences = np.concatenate([np.diff(x, n=3, axis=0) for x in pieces])
    # The variance of the third difference of white noise is 20 times that of the noise.
    noise = np.sqrt((differences**2).sum(axis=0) / (20 * max(len(differences), 1)))
    return travel <= number.STILL_TRAVEL * noise


def at_rest(names, q, parts):
    """Return the finding that no joint moves, for rows in any order; else None."""
    # Shuffled rows of a motion look like noise as well, but with a larger deviation.
    small = q.std(axis=0).max() <= number.LEAST_MOTION
    return _nothing_moves(names, q) if small and still_joints(q, parts).all() else None


def _nothing_moves(names, q):
    x = q[:, np.argmax(np.ptp(q, axis=0))]
    facts = {"range": np.ptp(x), "mean": x.mean()}
    return finding("still_joint:all", names, range(len(names)), "error", **facts)


def _check_rest(log):
    if log.still.all():
        log.findings.append(_nothing_moves(log.names, log.q))
        return
    for j in np.flatnonzero(log.still):
        x = log.q[:, j]
        log.report("still_joint", j, "warning", range=np.ptp(x), mean=x.mean())


def _check_held(log):
    """Find channels that are updated at a lower rate than the rows."""
    # A warning: they show the recorded motion, but their lag of half a period and their
    # steps look like delay, elasticity, and friction at reversals.
    moving = np.flatnonzero(~log.still)
    for what, channels in (("position", log.q), ("torque", log.tau)):
        pieces = [(np.arange(x.stop - x.start), channels[x]) for x in log.parts]
        rates = np.array(
            [max(rows_per_sample(t, x[:, [j]]) for t, x in pieces) for j in moving]
        )
        joints = moving[rates > 1]
        if not joints.size:
            continue
        k = float(np.median(rates[rates > 1]))
        # If it is no integer, speeds vary from row to row.
        severity = "error" if what == "position" and k % 1 else "warning"
        facts = {"k": k, "late": 500 * (k - 1) * log.dt, "dt": k * log.dt}
        log.report(f"held_{what}", joints, severity, what=what, **facts)
        if what == "torque":
            log.held[joints] = True
        elif (rates > 1).all() or k % 1:
            log.every = k if k % 1 else int(k)


def _check_lost_rows(log):
    """Find rows during motion with zero torques, or that repeat the row before."""
    # They are interpolated for the later checks.
    if log.every > 1:
        return
    gaps = [(x.start, filled_gaps(log.q[x], log.tau[x])) for x in log.parts]
    filled = [(a + k, b + k) for k, runs in gaps for a, b in runs]
    empty = (log.tau == 0).all(axis=1)
    runs = _find_breaks(log, empty, 1)
    if len(runs) >= number.DROPOUT_RUNS or any(b > a for a, b in runs):
        # If some zero rows interrupt a motion, all zero rows are reported.
        _report_lost(log, "empty_rows", log.runs(empty), "warning")
    if off := _find_switched_off(log):
        _report_lost(log, "empty_rows:off", off, "warning")
    repeats = (log.steps(log.q) == 0).all(axis=1) & ~log.first
    repeats &= (log.steps(log.tau) == 0).all(axis=1)
    runs = _find_breaks(log, repeats, number.FROZEN_ROWS - 1)
    count = sum(b - a + 1 for a, b in runs)
    long = max((b - a + 2 for a, b in runs), default=0) >= number.FROZEN_ROWS
    if long or count >= max(number.FEWEST_REPEATED, number.REPEATED_SHARE * len(log.q)):
        # A few are interpolated from their neighbours; many distort the speeds and the
        # sample period.
        serious = long or count > number.MANY_REPEATED * len(log.q)
        _report_lost(log, "repeated_rows", runs, "warning" if serious else "note")
    if filled:
        few = _mask(log.q, filled).mean() <= number.STUCK_SHARE
        _report_lost(log, "interpolated_rows", filled, "note" if few else "warning")


def _check_missing_rows(log):
    """Find steps of all positions by multiples of the neighbouring steps."""
    # Rows are missing there, which only time stamps would show.
    if log.every > 1 or log.still.all():
        return
    step = log.steps(log.q)[:, ~log.still]
    step /= np.sqrt((step**2).mean(axis=0))
    usual = scipy.ndimage.median_filter(step, (number.MEDIAN, 1))
    size = (usual**2).sum(axis=1)
    factor = (step * usual).sum(axis=1) / np.maximum(size, 1e-300)
    rest = ((step - np.round(factor)[:, None] * usual) ** 2).sum(axis=1)
    fast = (size > np.median(size)) & ~log.first
    is_multiple = rest < number.WORST**2 * size
    missing = fast & is_multiple & (factor > 1.5)
    least = max(number.FEWEST_REPEATED, number.REPEATED_SHARE * fast.sum())
    # If steps vary between these multiples, positions are coarse or noisy.
    others = (fast & ~is_multiple).sum() + (fast & (factor < 0.5)).sum()
    if missing.sum() > max(least, number.CLEARLY_MISSING * others):
        every = range(len(log.names))
        log.report("missing_rows", every, "warning", log.runs(missing))


def _find_switched_off(log):
    """Find runs in which all torques vanish, some abruptly, although links weigh."""
    step, size = np.abs(log.steps(log.tau)), np.sqrt((log.tau**2).mean(axis=0))
    sudden = (step > number.SUDDEN * np.quantile(step, 0.995, axis=0)).any(axis=1)
    runs = log.runs((np.abs(log.tau) <= number.OFF_SHARE * size).all(axis=1))
    runs = [(a, b) for a, b in runs if b - a + 2 >= number.STUCK_RUN]
    if not runs:
        return []
    still = np.pad(log.q[[a for a, _ in runs]], ((0, 0), (0, 2 * log.q.shape[1])))
    weight = np.abs(Bodies(log.robot).described(still)[1])
    loaded = [runs[k] for k in np.flatnonzero((weight > number.OFF_LOAD * size).any(1))]
    ends = [k for a, b in loaded for k in (a, b + 1)]
    ends = [k for k in ends if log.together(k - 1, k) and log.moving[k]]
    return loaded if sudden[ends].any() else []


def _find_breaks(log, flags, least):
    """Find runs of flagged rows at which positions jump, or the motion goes on."""
    # least: length of runs for which a jump of a position is sufficient.
    near = flags | np.r_[False, flags[:-1]]
    steps = [np.abs(log.steps(x)) for x in (log.q, log.tau)]
    if near.all() or not flags.any():
        return []
    typical = [np.quantile(x[~near], 0.995, axis=0) for x in steps]
    jumps = [(x > number.SUDDEN * y).any(axis=1) for x, y in zip(steps, typical)]
    breaks = []
    for a, b in log.runs(flags):
        # A run of repeated rows begins one row after the first equal row.
        begin = a if (log.tau[a] == 0).all() or not log.together(a - 1, a) else a - 1
        ends = [k for k in (begin, b + 1) if log.together(k - 1, k)]
        if b - a + 1 >= least and jumps[0][ends].any():
            first = begin if jumps[0][begin] or log.first[begin] else a
            breaks.append((first, b))
        elif least > 1 or jumps[1][ends].any():
            if _amid_motion(log, a, b, number.HELD_SPEED * typical[0]):
                breaks.append((a, b))
    return breaks


def _amid_motion(log, a, b, least):
    """Whether a joint moves faster than `least` (nv,) before row a and after row b."""
    k = number.NEAR_ROWS
    if not log.together(a - 1 - k, b + 1 + k):
        return False
    before = (log.q[a - 1] - log.q[a - 1 - k]) / k
    after = (log.q[b + 1 + k] - log.q[b + 1]) / k
    return bool((np.minimum(before * np.sign(after), np.abs(after)) > least).any())


def _report_lost(log, kind, runs, severity):
    """Report lost rows, and replace them by linear interpolation."""
    log.report(kind, range(len(log.names)), severity, runs)
    lost, rows = _mask(log.q, runs), np.arange(len(log.q))
    # Interpolation is accurate in short gaps only.
    gaps = [(max(a - 1, 0), b + 1) for a, b in runs if b - a >= number.NEAR_ROWS]
    log.usable[_mask(log.q, gaps)] = False
    for part in log.parts:
        good, bad = rows[part][~lost[part]], rows[part][lost[part]]
        for x in (*log.q.T, *log.tau.T) if good.size else ():
            x[bad] = np.interp(bad, good, x[good])


def _check_constant(log):
    """Find torques that are constant or zero while their joints move."""
    largest, spread = np.abs(log.tau).max(axis=0), np.ptp(log.tau, axis=0)
    is_zero = largest < number.ZERO
    constant = (spread <= number.ROUNDING * largest) | is_zero
    joints = np.flatnonzero(~log.still & constant)
    if joints.size:
        values = (0.0 if is_zero[j] else log.tau[0, j] for j in joints)
        values = " or ".join(dict.fromkeys(f"{x:.6g}" for x in values))
        log.report("constant_torque", joints, "error", values=values)
    log.usable[:, joints] = False


def _check_torques(log):
    for j in np.flatnonzero(~log.still & log.usable.any(axis=0)):
        x = log.tau[:, j]
        if _check_coarse(log, j, x):
            log.usable[:, j] = False
            continue
        faulty = _mask(x, []) if log.held[j] else _find_dropouts(log, j, x)
        outliers = outlying(x) & ~faulty & ~log.held[j]
        if outliers.any():
            log.report("torque_outliers", j, "warning", log.runs(outliers))
        faulty |= outliers
        log.usable[:, j] &= ~(faulty | _find_clipped(log, j, x, log.moving & ~faulty))


def _check_coarse(log, j, x):
    """Find a torque too coarsely quantised to show its shape."""
    # Zeros at the end of the range may be those of a lost sign.
    step = np.abs(log.steps(x))[log.moving & ((x != 0) | (x.min() < 0 < x.max()))]
    changes = step[step > 0]
    if changes.size == 0:
        return False
    repeated = 1.0 - changes.size / step.size
    # The median change if the torque mostly stays on one level, else the smallest one.
    size = np.quantile(changes, 0.5 if repeated >= 0.5 and not log.held[j] else 0.02)
    spread = max(x[log.moving].std(), np.finfo(float).tiny)
    if size / np.sqrt(12) < number.COARSE * spread:
        return False
    # Small quantisation errors are part of the joint's noise floor.
    severity = "warning" if np.ptp(x) < number.LEVELS * size else "note"
    log.report("coarse_torque", j, severity, step=size, spread=spread)
    return severity == "warning"


def _find_dropouts(log, j, x):
    """Find torques that are constant while their joint moves (lost readings)."""
    step = np.abs(log.steps(x))
    repeats = (step == 0) & ~log.first
    typical = np.median(step[step > 0]) if step.any() else 0.0
    required = max(number.DROPOUT_STEP * typical, number.LEAST_DROPOUT * x.std())
    jumps, long = np.r_[step > required, False], []
    # A zero is lost amid values of the same sign, if no other value is as frequent.
    moving, beyond = log.moves[:, j], np.pad(np.sign(x), 1)
    zero = (x == 0) & moving
    lost = zero & jumps[:-1] & jumps[1:] & (beyond[2:] * beyond[:-2] > 0)
    _, sizes = np.unique(x[moving & ~zero], return_counts=True)
    zero &= lost.sum() >= number.DENSITY * sizes.max(initial=1)
    short = log.runs(zero)
    for a, b in log.runs(repeats & moving & ~zero):
        # Runs at an extreme value are a limit. Short runs must begin and end with a
        # jump, as torques also stay at zero if they pass it slowly.
        if b - a + 2 >= number.STUCK_RUN and x[b] not in (x.min(), x.max()):
            # The last value of a joint at rest may be logged with a delay.
            if not repeats[a - 1] or (b - a + 2) * log.dt > number.ARRIVES:
                long.append((a - 1, b))
        elif b > a and jumps[a - 1] and jumps[b + 1]:
            short.append((a - 1, b))
    # Include the pauses of the joint.
    all_runs = log.runs(repeats)
    long = [(a - 1, b) for a, b in all_runs if any(a <= k <= b for _, k in long)]
    dropouts = sorted(long + short * (len(short) >= number.DROPOUT_RUNS))
    faulty = _mask(x, dropouts)
    # A torque that often repeats its value is coarse.
    if not dropouts or repeats[~faulty].mean() > number.STUCK_REPEATS:
        return np.zeros_like(faulty)
    # Adding zero turns -0.0 into 0.0.
    level = x[dropouts[0][0]] + 0.0
    log.report("torque_dropouts", j, "warning", dropouts, level=level)
    return faulty


def outlying(x):
    """Mark single torques that deviate from their neighbours, (n,) of bool."""
    # A median filter preserves the steps of friction at reversals.
    smoothed = scipy.ndimage.median_filter(x, number.MEDIAN)
    deviation = np.abs(x - smoothed)
    threshold = number.OUTLIER * np.quantile(deviation, 0.9) / 1.645
    outliers = deviation > max(threshold, number.WORST * smoothed.std())
    # Smaller or more frequent deviations are noise.
    size = np.sqrt(np.mean(deviation**2 * outliers))
    if size < number.WORST * smoothed.std() or outliers.mean() > number.STUCK_REPEATS:
        outliers = np.zeros_like(outliers)
    # Some in a row are far beyond all other values.
    distance = np.abs(x - np.median(x))
    usual = np.quantile(distance, 0.99)
    near, far = np.outer(number.BEYOND, usual) < distance
    return outliers | (far & (far == near).all() & (usual > 0))


def _find_clipped(log, j, x, moving, mean=1):
    """Find plateaus at the highest or lowest torque, also of its means over rows."""
    plateaus, limits, repeats, width = [], [], log.steps(x) == 0, 0.0
    if mean > 1:
        # Third differences have 20 times the variance of the noise.
        noise = np.median(np.abs(np.diff(x, n=3))) / (0.6745 * np.sqrt(20 * mean))
        x, width = scipy.ndimage.uniform_filter1d(x, mean), 6 * noise
    width = max(width, number.PLATEAU * np.ptp(x))
    # Quantised torques with noise have many values at few levels.
    _, sizes = np.unique(np.floor(x / width), return_counts=True)
    # If a torque rarely repeats a value, one plateau is sufficient; otherwise plateaus
    # must be longer at the limit than elsewhere.
    rare, between = repeats.mean() < 0.25, np.minimum(x.max() - x, x - x.min()) > width
    usual = max((b - a + 2 for a, b in log.runs(repeats & moving & between)), default=0)
    for level in {x.max(), x.min()}:
        distance = np.abs(x - level)
        close = (distance <= width) & moving
        if level == 0:
            # One sign was lost, unless at rest, or only some readings were lost.
            close &= log.moves[:, j]
            close &= close.mean() > number.STUCK_REPEATS
        # Noise divides a plateau.
        close = scipy.ndimage.binary_closing(close, np.ones(2 * mean - 1))
        least = number.PLATEAU_RUN + mean - 1
        runs = [x for x in log.runs(close) if x[1] - x[0] + 1 >= least]
        span = max((b - a + 1 for a, b in runs), default=0)
        near = ((distance > width) & (distance <= 6 * width) & moving).sum() / 5
        dense = close.sum() >= number.DENSITY * max(near, 0.5)
        longer = close.sum() >= np.quantile(sizes, 0.75) if rare else span >= 5 * usual
        exact = (x[_mask(x, runs)] == level).all() and span >= number.LONG_PLATEAU
        several = len(runs) >= number.PLATEAU_RUNS
        if dense and (longer or mean > 1) and (several or (rare and exact)):
            limits.append(level if mean == 1 else np.median(x[_mask(x, runs)]))
            plateaus += runs
    clipped = _mask(x, plateaus)
    if not limits and mean == 1 and rare:
        return _find_clipped(log, j, x, moving, number.AVERAGED)
    if mean > 1 and limits:
        # Friction and constant accelerations give plateaus, too, but weight varies.
        still = np.pad(log.q[clipped], ((0, 0), (0, 2 * log.q.shape[1])))
        if np.ptp(Bodies(log.robot).described(still)[1][:, j]) <= width:
            return np.zeros_like(clipped)
    if limits:
        where = " and ".join(f"{level:.4g}" for level in sorted(limits))
        if len(limits) == 2 and np.isclose(limits[0], -limits[1], rtol=number.PLATEAU):
            where = f"+-{max(limits):.4g}"
        severity = "warning" if clipped.mean() > number.MANY_CLIPPED else "note"
        kind = "unsigned_torque:half" if 0.0 in limits else "clipped_torque"
        severity = "error" if 0.0 in limits else severity
        log.report(kind, j, severity, sorted(plateaus), where=where)
    return clipped


def _check_positions(log):
    stands = _find_standstill(log) if log.every == 1 else None
    for j in np.flatnonzero(~log.still):
        if stands is not None:
            log.usable[_find_stuck(log, j, stands)] = False
        x, jumps = log.q[:, j], _find_jumps(log.q[:, j], log.parts)
        log.jumps += [first for first, _, back in jumps if not back]
        jumps = [jump for jump in jumps if log.usable[jump[0]].any()]
        log.findings += _jump_findings(log.names, j, x, jumps, log.place)
        near = [(max(first - 2, 0), last + 1) for first, last, _ in jumps]
        log.usable[_mask(x, near)] = False
        for first, last, _ in (jump for jump in jumps if jump[2]):
            rows, ends = np.arange(first, last), [first - 1, last]
            x[rows] = np.interp(rows, ends, x[ends])


def _find_standstill(log):
    """Mark rows (n, nv) in which a position is constant up to noise."""
    width = number.LEAST_STOP
    stopped = np.zeros(log.q.shape, dtype=bool)
    for part in log.parts:
        x = log.q[part]
        high = scipy.ndimage.maximum_filter1d(x, width, axis=0)
        travel = high - scipy.ndimage.minimum_filter1d(x, width, axis=0)
        inside = travel <= number.STOP_RANGE * np.quantile(travel, 0.99, axis=0)
        # Mark all rows of these windows.
        stopped[part] = scipy.ndimage.maximum_filter1d(inside, width, axis=0, origin=-1)
    return stopped


def _find_stuck(log, j, stands):
    """Find positions that stop within one sample, or lose their noise."""
    x, step = log.q[:, j], log.steps(log.q[:, j])
    moving, speed = ~stands[:, j], np.abs(step)
    change = np.abs(np.diff(step))[moving[1:] & moving[:-1]]
    if not change.size:
        return _mask(x, [])
    threshold = number.SUDDEN * np.quantile(change, number.USUAL)
    fast, stuck, abrupt = max(threshold, 0.5 * np.median(speed[moving])), [], False
    # Third differences estimate the noise. If it is far above the resolution, values
    # rarely repeat, even at rest.
    noise = np.median(np.abs(np.diff(x, n=3, prepend=x[:3]))[moving])
    noisy = noise > number.DEAD_NOISE * speed[speed > 0].min()
    repeats, others = (step == 0) & ~log.first, ~log.still
    others[j], n_repeats = False, repeats.sum()
    for a, b in log.runs(stands[:, j]):
        if b - a <= number.LEAST_STOP:
            continue
        part = log.parts[log.label[a]]
        ends = speed[max(a - 1, part.start) : a + 1], speed[b + 1 : part.stop][:2]
        sudden = np.concatenate(ends).max(initial=0.0) > fast
        # If all joints stop together, the robot pauses.
        pauses = stands[a + 3 : b - 1, others].all(axis=1).any()
        other = n_repeats - repeats[a : b + 1].sum()
        dead = noisy and b - a > number.DEAD_RUN and other < number.REPEATED * len(x)
        dead = dead and repeats[a : b + 1].mean() > number.DEAD_SHARE
        if (sudden or dead) and not pauses:
            stuck.append((a, b))
            abrupt = abrupt or sudden
    if stuck:
        level = x[max(stuck, key=lambda run: run[1] - run[0])[0]]
        few = _mask(x, stuck).mean() <= number.STUCK_SHARE
        severity = "note" if few else "error" if abrupt else "warning"
        log.report("stuck_position", j, severity, stuck, level=level)
    return _mask(x, [(a, min(b + 1, len(x) - 1)) for a, b in stuck])


def disorder(names, q, parts):
    """Find positions (n, nv) out of time order, or else jumps between recordings."""
    # Column-major order, since signals are processed one by one.
    findings, q = [], np.asfortranarray(q)
    for j, x in enumerate(q.T):
        findings += _jump_findings(names, j, x, _find_jumps(x, parts), "row {}".format)
    lasting = [x for x in findings if x.severity != "note"]
    return shuffled_rows(names, q, parts) or lasting


def _find_jumps(x, parts):
    """List first and last row of jumps of a position, and whether it returns."""
    rows, least = [], number.LEAST_JUMP * np.ptp(x)
    for part in parts:
        step = np.diff(x[part])
        # Interpolated, a jump takes two steps.
        bends = np.abs(np.diff(step)).max(initial=0.0)
        if step.size < number.FEWEST_AROUND or bends <= 0.4 * least:
            continue
        # Adjacent steps are left out, since an interpolated jump takes two.
        nearby = [step[:-6], step[1:-5], step[2:-4], step[4:-2], step[5:-1], step[6:]]
        expected = np.median(nearby, axis=0)
        excess = np.abs(step[3:-3] - expected)
        # The quantile keeps the scale positive if the joint rests most of the time.
        middle, high = np.quantile(excess, [0.5, 0.9])
        scale = max(middle / 0.6745, high / 1.645, np.finfo(float).tiny)
        is_jump = (excess > number.OUTLIER * scale) & (excess > least)
        is_jump &= excess > 2.5 * np.abs(expected)
        rows += list(part.start + 4 + np.flatnonzero(is_jump))
    step = np.diff(x, prepend=x[:1])
    # Many jumps far beyond the resolution are between blocks of rows.
    many = len(rows) > number.MOST_OUTLIERS * x.size
    if not rows or (many and np.median(np.abs(step[rows])) <= 10 * least):
        return []
    jumps, apart = [], np.flatnonzero(np.diff(rows) > number.NEAR_ROWS) + 1
    for near in np.split(rows, apart):
        # Wrong samples are jumps there and back.
        first, last = int(near[0]), int(near[-1])
        shift = step[first : last + 2] - 0.5 * (step[first - 1] + step[last + 2])
        back = bool(abs(shift.sum()) <= 0.5 * abs(shift).max())
        jumps.append((first, max(last, first + back), back))
    return jumps


def _jump_findings(names, j, x, jumps, place):
    """Return the finding on jumps of a position, or no finding."""
    if not jumps:
        return []
    k, lasting = jumps[0][0], sum(not back for *_, back in jumps)
    facts = {"count": len(jumps), "step": x[k] - x[k - 1], "place": place(k)}
    severity, kind = "warning", "position_jumps"
    if lasting >= number.FEWEST_STEPS:
        severity, kind = "error", "shuffled_rows:blocks"
    elif not lasting:
        severity, kind = "note", "position_jumps:outliers"
    return [finding(kind, names, j, severity, **facts)]


def wrong_states(recording):
    """Find given velocities or accelerations that are no derivatives; one or none."""
    names, parts, dt = recording.joint_names, recording.segments, recording.dt
    given = recording.states is not None
    motion = [recording.q, recording.v]
    if given:
        motion = np.split(recording.states, 3, axis=1)
    if motion[1] is None or shuffled_rows(names, recording.q, parts):
        return []
    for of, (x, rate) in zip(("positions", "velocities"), pairwise(motion)):
        joints = np.flatnonzero(~still_joints(x, parts))
        fits = {j: _rate_fit(x[:, j], dt * rate[:, j], parts) for j in joints}
        wrong = [j for j in joints if not 1 / number.RATE < fits[j][0] < number.RATE]
        back = [_rate_fit(rate[:, j], dt * x[:, j], parts) for j in wrong]
        swapped = [j for j, y in zip(wrong, back) if abs(y - 1).max() < number.GOOD_FIT]
        kind, severity = "wrong_states", "error"
        if swapped:
            kind, wrong = "wrong_states:swapped", swapped
        elif not given:
            # Velocities beside positions only determine the delay of a drive's.
            wrong = [j for j in wrong if fits[j][1] > 1 - number.GOOD_FIT]
            if recording.feedback is None:
                kind, severity = "wrong_states:unused", "note"
        if wrong:
            facts = {"of": of, "factor": fits[wrong[0]][0], "name": names[wrong[0]]}
            return [finding(kind, names, wrong, severity, **facts)]
    return []


def _rate_fit(x, step, parts):
    """Return the factor of changes of x (n,) over sums of steps, and its R squared."""
    # Sums over times in which x changes by its standard deviation suppress noise.
    longest = max(part.stop - part.start for part in parts)
    pairs = [(x[p], np.cumsum(step[p]) - step[p] / 2) for p in parts]
    for width in 2 ** np.arange(max(longest // 8, 1).bit_length()):
        changes = [[y[width:] - y[:-width] for y in pair] for pair in pairs]
        change, total = np.hstack([pair for pair in changes if len(pair[0])])
        if (change**2).mean() > x.var():
            break
    factor = change @ total / max(total @ total, 1e-300)
    return np.array([factor, factor * (change @ total) / max(change @ change, 1e-300)])


def contradicted(recording, errors, size):
    """Whether a fit contradicts the description, so that its log is inspected."""
    # errors (nv,): residual standard deviations of the fit; size: factor of all torques
    # against the description, and its relative error.
    tau, (factor, error) = bridged(recording).tau, size
    scale = np.abs(np.log(max(factor, 1e-300)))
    far = scale > max(np.log(number.SCALE), number.DECISIVE * error)
    # Rows of lost torques (zeros) make the torques appear smaller.
    empty = (tau == 0).all(axis=1).any()
    poor = (errors > number.WORST * np.std(tau, axis=0)).any()
    contradicts = far or empty or poor or any(outlying(x).any() for x in tau.T)
    return bool(contradicts or wrong_states(recording))


def _check_copies(log):
    """Find equal positions, and torques that are equal up to a factor."""
    # Positions may be proportional, as joints may have similar reference motions.
    pairs = ("position", log.q, 0.0), ("torque", log.tau, number.COPY)
    for what, values, share in pairs:
        centred = values - values.mean(axis=0)
        square, copies = (centred**2).sum(axis=0), set()
        varying = np.flatnonzero((np.ptp(values, axis=0) > 0) & (square > 0))
        for k, j in combinations(varying, 2):
            factor = centred[:, k] @ centred[:, j] / square[k] if share else 1.0
            residual = centred[:, j] - factor * centred[:, k]
            if residual @ residual <= share**2 * square[j] and j not in copies:
                copies.add(j)
                facts = {"first": log.names[k], "second": log.names[j], "what": what}
                log.report(f"copied_{what}", [k, j], "error", factor=factor, **facts)


# Each check reports findings and marks samples as unusable for the later ones.
CHECKS = (
    _check_wraps, _check_rest, _check_held, _check_lost_rows, _check_missing_rows,
    _check_constant, _check_overflows, _check_torques, _check_positions, _check_copies,
)  # fmt: skip
