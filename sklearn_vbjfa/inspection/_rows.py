"""Faults that the rows of a log show with little of a robot model: a table of checks.

Most are runs of rows in which a channel keeps its value although the robot moves.
"""

import functools
from itertools import combinations

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._likelihood import Bodies
from sklearn_vbjfa.inspection._sentences import finding, percent
from sklearn_vbjfa.model import is_prismatic


class Rows:
    """Rows of a log, and the faults that checks find in them."""

    # q [rad or m], tau [N m or N] (n, nv): later checks see them without jumps of a
    # turn and lost rows; parts: slices of the recordings, which hold all rows; rows
    # (n,): row numbers for messages.

    def __init__(self, model, names, q, tau, dt, parts, rows):
        self.model, self.revolute = model, ~is_prismatic(model)
        self.names, self.q, self.tau, self.dt = names, q, tau, dt
        self.parts, self.rows = parts, rows
        self.findings = []
        self.label = np.repeat(np.arange(len(parts)), [p.stop - p.start for p in parts])
        self.first = np.isin(np.arange(len(q)), [part.start for part in parts])
        self.usable = np.ones(q.shape, dtype=bool)
        self.counted = np.ones(len(q), dtype=bool)  # rows that have a weight
        self.held = np.zeros(q.shape[1], dtype=bool)  # torques at a lower rate
        self.every = 1  # rows until all positions are new

    @functools.cached_property
    def still(self):
        """Joints that never move, ndarray (nv,) of bool."""
        return still_joints(self.q, self.parts)

    @functools.cached_property
    def moving(self):
        """Rows in which any joint moves, ndarray (n,) of bool."""
        return self.moves(self.q)

    def steps(self, x):
        """Return differences to the row before, zero where a recording begins."""
        step = np.diff(x, axis=0, prepend=x[:1])
        step[self.first] = 0
        return step

    def runs(self, flags):
        """Return first and last row of each run of flags within a recording."""
        flags = flags & self.counted
        before = np.r_[False, flags[:-1]] & ~self.first
        starts = np.flatnonzero(flags & ~before)
        ends = np.flatnonzero(flags & ~np.r_[flags[1:] & ~self.first[1:], False])
        return list(zip(starts.tolist(), ends.tolist()))

    def together(self, first, last):
        """Whether two rows exist and are of one recording."""
        inside = 0 <= first and last < len(self.label)
        return inside and self.label[first] == self.label[last]

    def moves(self, x):
        """Return the rows (n,) in which any channel of x (n, m) moves."""
        moving = np.zeros(len(x), dtype=bool)
        for part in self.parts:
            y = x[part]
            width = max(2, min(20, len(y) // 8))
            travel = np.zeros(y.shape)
            travel[width:-width] = np.abs(y[2 * width :] - y[: -2 * width])
            high = np.maximum(np.quantile(travel, 0.99, axis=0), 1e-300)
            moving[part] = (travel > 0.02 * high).any(axis=1)
        return moving

    def report(self, kind, joints, severity, runs=(), **facts):
        """Add a finding, perhaps on runs of rows (first, last)."""
        if len(runs):
            longest = max(b - a + 1 for a, b in runs)
            facts |= {"times": len(runs), "row": self.rows[runs[0][0]]}
            facts |= {"count": sum(b - a + 1 for a, b in runs), "longest": longest}
            facts |= {"share": percent(facts["count"] / len(self.q))}
            facts |= {"seconds": longest * self.dt}
        self.findings.append(finding(kind, self.names, joints, severity, **facts))


def _marked(x, runs):
    """Mark runs of rows (first, last), ndarray (n,) of bool."""
    marked = np.zeros(len(x), dtype=bool)
    for a, b in runs:
        marked[a : b + 1] = True
    return marked


# -- order and wraps -------------------------------------------------------------------


def shuffled_rows(names, q, parts):
    """Find rows of positions (n, nv) that are out of time order; one error or none."""
    # parts: slices of the recordings.
    pieces = [np.asarray(q[part]) for part in parts if part.stop > part.start]
    sizes = np.array([len(x) for x in pieces])
    n = int(sizes.sum()) - len(pieces)
    if n < number.SHORT_RUN:
        return []

    def change(k):
        """Mean squared change (nv,) in k rows, one signal at a time."""
        each = [[np.square(y[k:] - y[:-k]).sum() for y in x.T] for x in pieces]
        return np.sum(each, axis=0) / n

    square, later = change(1), change(2)
    variance = sizes @ [[y.var() for y in x.T] for x in pieces] / sizes.sum()
    moves = variance > number.LEAST_MOTION**2
    least = (square[moves] / (2 * variance[moves])).min(initial=np.inf)
    # Rows of two robots in turn resemble the row before the last one.
    turns = moves.any() and (square > number.IN_TURN * later)[moves].all()
    if not (turns or number.SHUFFLED <= least < np.inf):
        return []
    every, facts = range(len(names)), {"change": np.sqrt(2 * least)}
    return [finding("shuffled_rows", names, every, "error", **facts)]


def _wraps(log):
    """Find angles that jump by a full turn, and unwrap them."""
    # An error: differentiating across a jump gives speeds of hundreds of rad/s.
    revolute = np.flatnonzero(log.revolute).tolist()
    widest = max((np.ptp(log.q[:, j]) for j in revolute), default=0.0)
    # Degrees, or counts of an encoder, are wrapped as well.
    counts = 2.0 ** np.ceil(np.log2(max(widest, 1.0)))
    for turn, text in ((2 * np.pi, "2 pi"), (360.0, "360"), (counts, f"{counts:.0f}")):
        turns = {j: _turns(log, log.q[:, j], turn) for j in revolute}
        turns = {j: rows for j, rows in turns.items() if rows.size}
        if not turns:
            continue
        log.q = log.q.copy()
        for j in turns:
            for part in log.parts:
                x = np.unwrap(log.q[part, j], period=turn)
                # Each recording may begin in another turn.
                log.q[part, j] = x - turn * np.round(x.mean() / turn)
        rows = np.concatenate(list(turns.values()))
        facts = {"count": rows.size, "row": log.rows[rows.min()], "turn": text}
        log.report("wrapped_position", list(turns), "error", **facts)


def _turns(log, x, turn):
    """Return the rows after jumps by a full turn."""
    step = log.steps(x)
    over = np.flatnonzero(np.abs(step) > (1 - number.TURN_LEFT) * turn)
    # Steps as large as a turn everywhere are another fault.
    widest = max(np.ptp(x[part]) for part in log.parts)
    if not 0 < over.size <= 0.05 * step.size or widest > 1.1 * turn:
        return over[:0]
    rest = step - turn * np.round(step / turn)
    usual = np.quantile(np.abs(np.delete(step, over)), 0.999)
    # After unwrapping, the steps must match those of the motion.
    return over[np.abs(rest[over]) <= 3 * usual + 1e-3 * turn]


# -- rest and whole rows ---------------------------------------------------------------


def still_joints(q, parts):
    """Joints at rest throughout, but for the noise of their positions, (nv,), bool."""
    pieces = [q[part] for part in parts if part.stop > part.start]
    travel = np.max([np.ptp(x, axis=0) for x in pieces], axis=0)
    bends = np.concatenate([np.diff(x, n=3, axis=0) for x in pieces])
    # The third difference of white noise has 20 times its variance.
    noise = np.sqrt((bends**2).sum(axis=0) / (20 * max(len(bends), 1)))
    return travel <= number.STILL_TRAVEL * noise


def at_rest(names, q, parts):
    """Return the finding that nothing moves, in rows in any order; None if not."""
    # Rows out of order look like noise as well, but like more of it.
    still = q.std(axis=0).max() <= number.LEAST_MOTION
    still = still and still_joints(q, parts).all()
    return _nothing_moves(names, q) if still else None


def _nothing_moves(names, q):
    """Return the finding that every joint is at rest."""
    x = q[:, np.argmax(np.ptp(q, axis=0))]
    facts = {"range": np.ptp(x), "mean": x.mean()}
    return finding("still_joint:all", names, range(len(names)), "error", **facts)


def _rest(log):
    """Name joints that never move."""
    if log.still.all():
        log.findings.append(_nothing_moves(log.names, log.q))
        return
    for j in np.flatnonzero(log.still):
        x = log.q[:, j]
        log.report("still_joint", j, "warning", range=np.ptp(x), mean=x.mean())


def _held(log):
    """Find channels that have new values at a lower rate."""
    # They lag by half a period and change in steps, which looks like delay, elasticity
    # and friction at reversals, but they show the recorded motion: a warning.
    moving = np.flatnonzero(~log.still)
    for what, channels in (("position", log.q), ("torque", log.tau)):
        rates = np.array([_rate(log, channels[:, j]) for j in moving])
        joints = moving[rates > 0]
        if not joints.size:
            continue
        k = round(float(np.median(rates[rates > 0])))
        facts = {"k": k, "late": 500 * (k - 1) * log.dt, "dt": k * log.dt}
        log.report(f"held_{what}", joints, "warning", what=what, **facts)
        if what == "torque":
            log.held[joints] = True
        elif (rates > 0).all():
            log.every = k


def _rate(log, x):
    """Rows per new value; zero if every row of every recording has one."""
    found = []
    for part in log.parts:
        y = x[part]
        change = np.flatnonzero(np.diff(y) != 0)
        if change.size <= number.FEWEST_STEPS:
            continue
        steps, gaps = np.abs(y[change + 1] - y[change])[1:], np.diff(change)
        # A quantised signal changes by its resolution and is constant where it is slow;
        # steps of several quanta within one row cannot follow rows without any.
        fast = steps >= number.STEP * np.quantile(steps, 0.02)
        if fast.sum() < max(number.FEWEST_STEPS, number.STEP_SHARE * steps.size):
            continue
        k = np.median(gaps[fast])
        # If the rates have no integer ratio, some gaps are longer or shorter by a row.
        regular = (np.abs(gaps[fast] - k) <= 1) & (gaps[fast] >= 2)
        found += [k] if regular.mean() >= number.SAME_RATE else []
    return float(np.median(found)) if found else 0.0


def _lost_rows(log):
    """Find rows without any torque, or equal to the row before, amid a motion."""
    # Later checks see a straight line in their place.
    if log.every > 1:
        return
    empty = (log.tau == 0).all(axis=1)
    found = _breaks(log, empty, 1)
    if len(found) >= number.DROPOUT_RUNS or any(b > a for a, b in found):
        # What some of them show is true of all.
        _report_lost(log, "empty_rows", log.runs(empty), "warning")
    if off := _switched_off(log):
        _report_lost(log, "empty_rows:off", off, "warning")
    same = (log.steps(log.q) == 0).all(axis=1) & ~log.first
    same &= (log.steps(log.tau) == 0).all(axis=1)
    found = _breaks(log, same, number.FROZEN_ROWS - 1)
    count = sum(b - a + 1 for a, b in found)
    long = max((b - a + 2 for a, b in found), default=0) >= number.FROZEN_ROWS
    if long or count >= max(number.FEWEST_REPEATED, number.REPEATED_SHARE * len(log.q)):
        # A few are recognisable from the motion around them; many make the speed and
        # the sample period wrong.
        many = long or count > number.MANY_REPEATED * len(log.q)
        _report_lost(log, "repeated_rows", found, "warning" if many else "note")


def _switched_off(log):
    """Find runs in which all torques vanish, some at once, although links weigh."""
    step, size = np.abs(log.steps(log.tau)), np.sqrt((log.tau**2).mean(axis=0))
    sudden = (step > number.SUDDEN * np.quantile(step, 0.995, axis=0)).any(axis=1)
    runs = log.runs((np.abs(log.tau) <= number.OFF * size).all(axis=1))
    runs = [(a, b) for a, b in runs if b - a + 2 >= number.STUCK_RUN]
    if not runs:
        return []
    still = np.pad(log.q[[a for a, _ in runs]], ((0, 0), (0, 2 * log.q.shape[1])))
    weight = np.abs(Bodies(log.model).described(still)[1])
    found = [runs[k] for k in np.flatnonzero((weight > number.LOADED * size).any(1))]
    ends = [k for a, b in found for k in (a, b + 1)]
    ends = [k for k in ends if log.together(k - 1, k) and log.moving[k]]
    return found if sudden[ends].any() else []


def _breaks(log, flags, least):
    """Find runs of flagged rows at which a motion jumps, or does not stop."""
    # least: rows from which on a jump of the position is enough.
    around = flags | np.r_[False, flags[:-1]]
    steps = [np.abs(log.steps(x)) for x in (log.q, log.tau)]
    if around.all() or not flags.any():
        return []
    usual = [np.quantile(x[~around], 0.995, axis=0) for x in steps]
    jumps = [(x > number.SUDDEN * y).any(axis=1) for x, y in zip(steps, usual)]
    found = []
    for a, b in log.runs(flags):
        # Rows that equal the one before begin a row late.
        begin = a if (log.tau[a] == 0).all() or not log.together(a - 1, a) else a - 1
        ends = [k for k in (begin, b + 1) if log.together(k - 1, k)]
        if b - a + 1 >= least and jumps[0][ends].any():
            new = begin if jumps[0][begin] or log.first[begin] else a
            found.append((new, b))
        elif least > 1 or jumps[1][ends].any():
            if _amid_motion(log, a, b, number.HELD_SPEED * usual[0]):
                found.append((a, b))
    return found


def _amid_motion(log, a, b, least):
    """Whether a joint moves faster than `least` (nv,) up to row a - 1 and from b on."""
    near = number.BESIDE
    if not log.together(a - 1 - near, b + 1 + near):
        return False
    into = (log.q[a - 1] - log.q[a - 1 - near]) / near
    out = (log.q[b + 1 + near] - log.q[b + 1]) / near
    return bool((np.minimum(into * np.sign(out), np.abs(out)) > least).any())


def _report_lost(log, kind, runs, severity):
    """Report whole rows that were lost, and put a straight line in their place."""
    log.report(kind, range(len(log.names)), severity, runs)
    lost, rows = _marked(log.q, runs), np.arange(len(log.q))
    # Only short gaps are bridged well.
    gaps = [(max(a - 1, 0), b + 1) for a, b in runs if b - a >= number.BESIDE]
    log.usable[_marked(log.q, gaps)] = False
    log.q, log.tau = log.q.copy(), log.tau.copy()
    for part in log.parts:
        good, bad = rows[part][~lost[part]], rows[part][lost[part]]
        for x in (*log.q.T, *log.tau.T) if good.size else ():
            x[bad] = np.interp(bad, good, x[good])


# -- torques ---------------------------------------------------------------------------


def _constant(log):
    """Find torques that are constant, or nothing, while their joints move."""
    largest, spread = np.abs(log.tau).max(axis=0), np.ptp(log.tau, axis=0)
    nothing = largest < number.NOTHING
    joints = np.flatnonzero(
        ~log.still & ((spread <= number.ROUNDED * largest) | nothing)
    )
    if joints.size:
        values = (0.0 if nothing[j] else log.tau[0, j] for j in joints)
        values = " or ".join(dict.fromkeys(f"{x:.6g}" for x in values))
        log.report("constant_torque", joints, "error", values=values)
    log.usable[:, joints] = False


def _torques(log):
    """Find torques that are coarse, lost or clipped."""
    for j in np.flatnonzero(~log.still & log.usable.any(axis=0)):
        x = log.tau[:, j]
        if _coarse(log, j, x):
            log.usable[:, j] = False
            continue
        bad = np.zeros(x.shape, dtype=bool)
        if not log.held[j]:
            bad = _dropped(log, j, x) | _outliers(log, j, x)
        log.usable[:, j] &= ~(bad | _clipped(log, j, x, log.moving & ~bad))


def _coarse(log, j, x):
    """Find a torque too coarsely quantised to show its shape."""
    step = np.abs(log.steps(x))[log.moving]
    changes = step[step > 0]
    if changes.size == 0:
        return False
    same = 1.0 - changes.size / step.size
    # If the torque mostly stays on one quantisation level, a typical change is one
    # step; if it is sampled so slowly that it passes several, the smallest change is. A
    # held value is far from the next one, whatever the resolution.
    size = np.quantile(changes, 0.5 if same >= 0.5 and not log.held[j] else 0.02)
    spread = max(x[log.moving].std(), np.finfo(float).tiny)
    if size / np.sqrt(12) < number.COARSE * spread:
        return False
    # A smaller error is noise, which the noise floor of the joint contains.
    severity = "warning" if np.ptp(x) < number.LEVELS * size else "note"
    log.report("coarse_torque", j, severity, step=size, spread=spread)
    return True


def _dropped(log, j, x):
    """Find torques that keep a value while their joint moves, as lost readings do."""
    step = np.abs(log.steps(x))
    repeats = (step == 0) & ~log.first
    usual = np.median(step[step > 0]) if step.any() else 0.0
    least = max(number.DROPOUT_STEP * usual, number.LEAST_DROPOUT * x.std())
    jumps, long, short = np.r_[step > least, False], [], []
    for a, b in log.runs(repeats & log.moves(log.q[:, [j]])):
        # Those at an end are of a limit; torques that pass zero slowly stay there, but
        # do not jump there and back.
        if b - a + 2 >= number.STUCK_RUN and x[b] not in (x.min(), x.max()):
            # The value that a joint had at rest may arrive late.
            if not repeats[a - 1] or (b - a + 2) * log.dt > number.ARRIVES:
                long.append((a - 1, b))
        elif b > a and jumps[a - 1] and jumps[b + 1]:
            short.append((a - 1, b))
    # With the pauses between.
    whole = log.runs(repeats)
    long = [(a - 1, b) for a, b in whole if any(a <= k <= b for _, k in long)]
    found = sorted(long + short * (len(short) >= number.DROPOUT_RUNS))
    bad = _marked(x, found)
    # What repeats itself everywhere is coarse.
    if not found or repeats[~bad].mean() > number.STUCK_REPEATS:
        return np.zeros_like(bad)
    # Adding zero leaves no minus before it.
    level = x[found[0][0]] + 0.0
    log.report("torque_dropouts", j, "warning", found, level=level)
    return bad


def _outliers(log, j, x):
    """Find single torques that the rows around contradict."""
    # A median keeps the steps of friction at reversals.
    around = scipy.ndimage.median_filter(x, number.MEDIAN)
    left = np.abs(x - around)
    usual = number.OUTLIER * np.quantile(left, 0.9) / 1.645
    bad = left > max(usual, number.WORST * around.std())
    # Others are noise that the fit averages.
    size = np.sqrt(np.mean(left**2 * bad))
    if size < number.WORST * around.std() or bad.mean() > number.STUCK_REPEATS:
        return np.zeros_like(bad)
    log.report("torque_outliers", j, "warning", log.runs(bad))
    return bad


def _clipped(log, j, x, moving):
    """Find plateaus at the highest or the lowest torque."""
    bad, ends, same = [], [], log.steps(x) == 0
    width = number.PLATEAU * np.ptp(x)
    # Torques that go in steps, with noise, have many values at few levels.
    _, sizes = np.unique(np.floor(x / width), return_counts=True)
    # If a torque seldom repeats a value, one plateau is proof enough; if it often does,
    # it stays at a limit for longer than elsewhere.
    rare, between = same.mean() < 0.25, np.minimum(x.max() - x, x - x.min()) > width
    usual = max((b - a + 2 for a, b in log.runs(same & moving & between)), default=0)
    # No drive has the limit zero: these are sizes, or readings that were lost.
    for level in {x.max(), x.min()} - {0.0}:
        away = np.abs(x - level)
        inside = (away <= width) & moving
        runs = [x for x in log.runs(inside) if x[1] - x[0] + 1 >= number.PLATEAU_RUN]
        most = max((b - a + 1 for a, b in runs), default=0)
        near = ((away > width) & (away <= 6 * width) & moving).sum() / 5
        dense = inside.sum() >= number.DENSITY * max(near, 0.5)
        longer = inside.sum() >= np.quantile(sizes, 0.75) if rare else most >= 5 * usual
        exact = (x[_marked(x, runs)] == level).all() and most >= number.LONG_PLATEAU
        if dense and longer and (len(runs) >= number.PLATEAU_RUNS or (rare and exact)):
            ends.append(level)
            bad += runs
    found = _marked(x, bad)
    if ends:
        where = " and ".join(f"{level:.4g}" for level in sorted(ends))
        if len(ends) == 2 and np.isclose(ends[0], -ends[1], rtol=number.PLATEAU):
            where = f"+-{max(ends):.4g}"
        severity = "warning" if found.mean() > number.MANY_CLIPPED else "note"
        log.report("clipped_torque", j, severity, sorted(bad), where=where)
    return found


# -- positions -------------------------------------------------------------------------


def _positions(log):
    """Find positions that are stuck, or jump."""
    stands = _stands(log) if log.every == 1 else None
    for j in np.flatnonzero(~log.still):
        if stands is not None:
            log.usable[_stuck(log, j, stands)] = False
        jumps = [k for k in _jumps(log.q[:, j], log.parts) if log.usable[k].any()]
        log.findings += _jumping(log.names, j, log.q[:, j], jumps, log.rows)
        log.usable[_marked(log.q, [(max(k - 2, 0), k + 1) for k in jumps])] = False


def _stands(log):
    """Mark rows (n, nv) in which a position keeps its value, but for some noise."""
    width = number.LEAST_STOP
    kept = np.zeros(log.q.shape, dtype=bool)
    for part in log.parts:
        x = log.q[part]
        high = scipy.ndimage.maximum_filter1d(x, width, axis=0)
        travel = high - scipy.ndimage.minimum_filter1d(x, width, axis=0)
        inside = travel <= number.STANDS * np.quantile(travel, 0.99, axis=0)
        # All rows of the windows in which it does.
        kept[part] = scipy.ndimage.maximum_filter1d(inside, width, axis=0, origin=-1)
    return kept


def _stuck(log, j, stands):
    """Find positions that stop within one sample, or lose their noise."""
    x, step = log.q[:, j], log.steps(log.q[:, j])
    moves, speed = ~stands[:, j], np.abs(step)
    change = np.abs(np.diff(step))[moves[1:] & moves[:-1]]
    if not change.size:
        return _marked(x, [])
    usual = number.SUDDEN * np.quantile(change, number.USUAL)
    fast, found, stops = max(usual, 0.5 * np.median(speed[moves])), [], False
    # Third differences are those of the noise. Of a noise that is far above the
    # resolution no value comes twice, at rest or not.
    noise = np.median(np.abs(np.diff(x, n=3, prepend=x[:3]))[moves])
    noisy = noise > number.NOISY * speed[speed > 0].min()
    same, others = (step == 0) & ~log.first, ~log.still
    others[j], repeats = False, same.sum()
    for a, b in log.runs(stands[:, j]):
        if b - a <= number.LEAST_STOP:
            continue
        inside = log.parts[log.label[a]]
        ends = speed[max(a - 1, inside.start) : a + 1], speed[b + 1 : inside.stop][:2]
        sudden = np.concatenate(ends).max(initial=0.0) > fast
        # When several joints stop together, the robot paused.
        pauses = stands[a + 3 : b - 1, others].all(axis=0).any()
        rest = repeats - same[a : b + 1].sum()
        dead = noisy and b - a > number.DEAD_RUN and rest < number.SELDOM * len(x)
        dead = dead and same[a : b + 1].mean() > number.EXACT
        if (sudden or dead) and not pauses:
            found.append((a, b))
            stops = stops or sudden
    if found:
        level = x[max(found, key=lambda run: run[1] - run[0])[0]]
        severity = "error" if stops else "warning"
        if _marked(x, found).mean() <= number.STUCK_SHARE:
            severity = "note"
        log.report("stuck_position", j, severity, found, level=level)
    return _marked(x, [(a, min(b + 1, len(x) - 1)) for a, b in found])


def disorder(names, q, parts):
    """Find rows of positions (n, nv) out of order, or else borders of recordings."""
    found = []
    # The samples of a signal are next to each other.
    q = np.asfortranarray(q)
    for j, x in enumerate(q.T):
        found += _jumping(names, j, x, _jumps(x, parts), range(len(q)))
    borders = [one for one in found if one.severity == "warning"]
    return shuffled_rows(names, q, parts) or borders


def _jumps(x, parts):
    """Rows after steps of a position that its neighbours contradict."""
    jumps, least = [], number.LEAST_JUMP * np.ptp(x)
    for part in parts:
        step = np.diff(x[part])
        # Interpolated, a jump takes two steps.
        bends = np.abs(np.diff(step)).max(initial=0.0)
        if step.size < number.FEWEST_AROUND or bends <= 0.4 * least:
            continue
        # The next steps are left out: an interpolated jump takes two of them.
        near = [step[:-6], step[1:-5], step[2:-4], step[4:-2], step[5:-1], step[6:]]
        usual = np.median(near, axis=0)
        over = np.abs(step[3:-3] - usual)
        # The quantile keeps the scale above zero if the joint stands.
        middle, high = np.quantile(over, [0.5, 0.9])
        scale = max(middle / 0.6745, high / 1.645, np.finfo(float).tiny)
        far = (over > number.OUTLIER * scale) & (over > least)
        far &= over > 2.5 * np.abs(usual)
        jumps += list(part.start + 4 + np.flatnonzero(far))
    return jumps if len(jumps) <= number.MOST_OUTLIERS * x.size else []


def _jumping(names, j, x, jumps, rows):
    """Return the finding on jumps of a position at some rows, in a list."""
    if not jumps:
        return []
    # A single wrong sample is a jump there and back.
    sizes = np.array([x[k] - x[k - 1] for k in jumps])
    severity = "note" if abs(sizes.sum()) < 0.5 * abs(sizes[0]) else "warning"
    facts = {"count": len(jumps), "step": sizes[0], "row": rows[jumps[0]]}
    return [finding("position_jumps", names, j, severity, **facts)]


# -- channels that hold another one ----------------------------------------------------


def _copies(log):
    """Find positions that equal each other, and torques but for a factor."""
    # Joints may well be moved alike.
    for what, values in (("position", log.q), ("torque", log.tau)):
        share = 0 if what == "position" else number.COPY
        centred = values - values.mean(axis=0)
        square, copies = (centred**2).sum(axis=0), set()
        varies = np.flatnonzero((np.ptp(values, axis=0) > 0) & (square > 0))
        for k, j in combinations(varies, 2):
            factor = centred[:, k] @ centred[:, j] / square[k] if share else 1.0
            left = centred[:, j] - factor * centred[:, k]
            if left @ left <= share**2 * square[j] and j not in copies:
                copies.add(j)
                facts = {"first": log.names[k], "second": log.names[j], "what": what}
                log.report(f"copied_{what}", [k, j], "error", factor=factor, **facts)


# Each reports what it finds; later checks leave out samples that it marks.
CHECKS = (
    _wraps,
    _rest,
    _held,
    _lost_rows,
    _constant,
    _torques,
    _positions,
    _copies,
)
