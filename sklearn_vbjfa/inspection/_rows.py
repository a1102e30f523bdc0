"""Faults that the rows of a log show without a robot model: a table of checks.

Most are runs of rows in which a channel keeps its value although the robot moves.
"""

from itertools import pairwise

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._sentences import finding, percent


class Rows:
    """Rows of a log, and the faults that checks find in them."""

    # q [rad or m], tau [N m or N] (n, nv); parts: slices of the recordings, which hold
    # all rows; rows (n,): row numbers for messages; revolute (nv,): joints that turn.

    def __init__(self, names, q, tau, dt, parts, rows, revolute=None):
        self.names, self.q, self.tau, self.dt = names, q, tau, dt
        self.parts, self.rows, self.revolute = parts, rows, revolute
        self.findings = []
        if revolute is not None:
            self.q = _unwrapped(self)
        self.label = np.repeat(np.arange(len(parts)), [p.stop - p.start for p in parts])
        self.first = np.isin(np.arange(len(q)), [part.start for part in parts])
        self.usable = np.ones(q.shape, dtype=bool)
        self.lost = np.zeros(len(q), dtype=bool)  # rows that repeat the one before
        self.still = still_joints(self.q, parts)
        self.moving = self.moves(self.q)
        self.held = np.zeros(q.shape[1], dtype=bool)  # torques at a lower rate
        self.every = 1  # rows until all positions are new

    def steps(self, x):
        """Return differences to the row before, zero where a recording begins."""
        step = np.diff(x, axis=0, prepend=x[:1])
        step[self.first] = 0
        return step

    def runs(self, flags):
        """Return first and last row of each run of flags within a recording."""
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


def inspect_rows(names, q, tau, dt, parts, rows, revolute):
    """Inspect each channel; return the `Rows` with findings and sound samples."""
    log = Rows(names, q, tau, dt, parts, rows, revolute)
    for check in CHECKS:
        check(log)
    log.usable[:, log.still] = False
    log.usable[log.lost] = False
    return log


# -- order and wraps -------------------------------------------------------------------


def shuffled_rows(names, q, parts):
    """Find rows of positions (n, nv) that are out of time order; one error or none."""
    # parts: slices of the recordings.
    pieces = [np.asarray(q[part]) for part in parts if part.stop > part.start]
    sizes = np.array([len(x) for x in pieces])
    n = int(sizes.sum()) - len(pieces)
    if n < number.SHORT_RUN:
        return []
    square = sum((np.diff(x, axis=0) ** 2).sum(axis=0) for x in pieces) / n
    variance = sizes @ np.array([x.var(axis=0) for x in pieces]) / sizes.sum()
    moves = variance > number.LEAST_MOTION**2
    least = (square[moves] / (2 * variance[moves])).min(initial=np.inf)
    if not number.SHUFFLED <= least < np.inf:
        return []
    every, facts = range(len(names)), {"change": np.sqrt(2 * least)}
    return [finding("shuffled_rows", names, every, "error", **facts)]


def _unwrapped(log):
    """Find angles that jump by a full turn; return the positions without jumps."""
    # An error: differentiating across a jump gives speeds of hundreds of rad/s.
    turning = np.flatnonzero(log.revolute)
    jumps = {int(j): _turns(log.q[:, j], log.parts) for j in turning}
    jumps = {j: over for j, over in jumps.items() if over.size}
    if not jumps:
        return log.q
    q = log.q.copy()
    for j in jumps:
        for part in log.parts:
            x = np.unwrap(q[part, j])
            # Each recording may begin in another turn.
            q[part, j] = x - 2 * np.pi * np.round(x.mean() / (2 * np.pi))
    rows = np.concatenate(list(jumps.values()))
    facts = {"count": rows.size, "row": log.rows[rows.min()]}
    log.report("wrapped_position", list(jumps), "error", **facts)
    return q


def _turns(x, parts):
    """Return the rows after jumps by a full turn."""
    found, turn = [np.zeros(0, dtype=int)], 2 * np.pi
    for part in parts:
        y = x[part]
        step = np.diff(y)
        over = np.flatnonzero(np.abs(step) > (1 - number.TURN_LEFT) * turn)
        # Steps as large as a turn everywhere are another fault.
        if not 0 < over.size <= 0.05 * step.size or np.ptp(y) > 1.1 * turn:
            continue
        rest = step - turn * np.round(step / turn)
        usual = np.quantile(np.abs(np.delete(step, over)), 0.999)
        # After unwrapping, the steps must match those of the motion.
        over = over[np.abs(rest[over]) <= 3 * usual + 1e-3 * turn]
        found.append(part.start + over + 1)
    return np.concatenate(found)


# -- rest and whole rows ---------------------------------------------------------------


def _noise(q, parts):
    """Deviations (nv,) of the white noise of positions."""
    bends = [np.diff(q[part], n=3, axis=0) for part in parts]
    # The third difference of white noise has 20 times its variance.
    count = max(20 * sum(map(len, bends)), 1)
    return np.sqrt(sum((x**2).sum(axis=0) for x in bends) / count)


def still_joints(q, parts):
    """Joints at rest throughout, but for the noise of their positions, (nv,), bool."""
    parts = [part for part in parts if part.stop > part.start]
    travel = np.max([np.ptp(q[part], axis=0) for part in parts], axis=0)
    return travel <= number.STILL_TRAVEL * _noise(q, parts)


def at_rest(q, parts):
    """Whether nothing moves, in rows whose order nobody has examined."""
    # Rows out of order look like noise as well, but like more of it.
    still = still_joints(q, parts).all()
    return bool(still and q.std(axis=0).max() <= number.LEAST_MOTION)


def nothing_moves(names, q):
    """Return the finding that every joint is at rest."""
    most = int(np.argmax(np.ptp(q, axis=0)))
    facts = {"name": names[most], "range": np.ptp(q[:, most])}
    facts |= {"mean": q[:, most].mean()}
    return finding("still_joint:all", names, range(len(names)), "error", **facts)


def _rest(log):
    """Name joints that never move."""
    if log.still.all():
        log.findings.append(nothing_moves(log.names, log.q))
        return
    for j in np.flatnonzero(log.still):
        x = log.q[:, j]
        facts = {"range": np.ptp(x), "mean": x.mean()}
        log.report("still_joint", j, "warning", **facts)


def _held(log):
    """Find channels that have new values at a lower rate."""
    # They lag by half a period and change in steps, which looks like delay, elasticity
    # and friction at reversals, but they show the recorded motion: a warning.
    rates = {}
    for what, channels in (("position", log.q), ("torque", log.tau)):
        rates[what] = np.zeros(len(log.names))
        for j in np.flatnonzero(~log.still):
            rates[what][j] = _rate(log, channels[:, j])
        joints = np.flatnonzero(rates[what])
        if joints.size:
            k = round(float(np.median(rates[what][joints])))
            facts = {"k": k, "late": 500 * (k - 1) * log.dt, "dt": k * log.dt}
            log.report(f"held_{what}", joints, "warning", what=what, **facts)
    log.held = rates["torque"] > 0
    moving = rates["position"][~log.still]
    if moving.size and moving.all():
        log.every = round(float(np.median(moving)))


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


def _repeated_rows(log):
    """Find rows that equal the row before in every channel amid a motion."""
    if log.every > 1:
        return
    step = np.abs(log.steps(log.q))
    same = (log.steps(np.hstack([log.q, log.tau])) == 0).all(axis=1) & ~log.first
    usual, found = np.quantile(step, 0.995, axis=0), []
    for a, b in log.runs(same):
        # Rows a - 1 to b are equal.
        begins, ends = not log.together(a - 2, b), not log.together(a, b + 1)
        long = b - a + 2 >= number.FROZEN_ROWS and begins != ends
        beside = b + 1 if begins and long else a - 1
        if long and (step[beside] > number.SUDDEN * usual).any():
            # Nothing was logged yet, or any more: a jump separates them.
            found.append((a - 1, b + begins))
        elif _amid_motion(log, a, b, number.HELD_SPEED * usual):
            found.append((a, b))
    count = sum(b - a + 1 for a, b in found)
    longest = max((b - a + 2 for a, b in found), default=0)
    few = count < max(number.FEWEST_REPEATED, number.REPEATED_SHARE * len(log.q))
    if not found or (few and longest < number.FROZEN_ROWS):
        return
    log.lost |= _marked(log.lost, found)
    # A few are recognisable from the motion around them; many make the speed and the
    # sample period wrong.
    many = longest >= number.FROZEN_ROWS or count > number.MANY_REPEATED * len(log.q)
    every = range(len(log.names))
    log.report("repeated_rows", every, "warning" if many else "note", found)


def _amid_motion(log, a, b, least):
    """Whether a joint moves faster than `least` (nv,) up to row a - 1 and from b on."""
    near = number.BESIDE
    if not log.together(a - 1 - near, b):
        return False
    into = (log.q[a - 1] - log.q[a - 1 - near]) / near
    fast = np.abs(into) > least
    if log.together(b, b + 1 + near):
        out = (log.q[b + 1 + near] - log.q[b + 1]) / near
        fast &= (np.abs(out) > least) & (into * out > 0)
    elif log.together(b, b + 1):
        return False
    return bool(fast.any())


# -- torques ---------------------------------------------------------------------------


def _constant(log):
    """Find torques that are constant, or nothing, while their joints move."""
    nothing = np.abs(log.tau).max(axis=0) < number.NOTHING
    joints = np.flatnonzero(~log.still & ((np.ptp(log.tau, axis=0) == 0) | nothing))
    if joints.size:
        values = (0.0 if nothing[j] else log.tau[0, j] for j in joints)
        values = " or ".join(dict.fromkeys(f"{x:.6g}" for x in values))
        named = ", ".join(log.names[j] for j in joints)
        log.report("constant_torque", joints, "error", named=named, values=values)
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
    repeats, step = log.steps(x) == 0, np.abs(log.steps(x))
    moves = log.moves(log.q[:, [j]]) & ~log.lost
    # Torques that pass zero slowly stay there, but do not jump there and back.
    usual = np.median(step[step > 0]) if step.any() else 0.0
    jump = max(number.DROPOUT_STEP * usual, number.LEAST_DROPOUT * x.std())
    zeros = [
        (a, b, np.abs(x[[a - 1, b + 1]]) > jump)
        for a, b in log.runs((x == 0) & log.moving & ~log.lost)
        if b - a >= 2 and log.together(a - 1, b + 1)
    ]
    found = [(a, b) for a, b, jumps in zeros if jumps.any()]
    if sum(jumps.all() for *_, jumps in zeros) < number.DROPOUT_RUNS:
        # What repeats itself everywhere is coarse, and the ends are those of a limit.
        found = [
            (a - 1, b)
            for a, b in log.runs(repeats & moves & ~log.first)
            if b - a + 2 >= number.STUCK_RUN and x[b] not in (x.min(), x.max())
        ]
    bad = _marked(x, found)
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
    bad, ends = [], []
    width = number.PLATEAU * np.ptp(x)
    # If a torque seldom repeats a value, one plateau is proof enough.
    rare = (log.steps(x) == 0).mean() < 0.25
    # No drive has the limit zero: these are sizes, or readings that were lost.
    for level in {x.max(), x.min()} - {0.0}:
        away = np.abs(x - level)
        runs = log.runs((away <= width) & moving)
        runs = [(a, b) for a, b in runs if b - a + 1 >= number.PLATEAU_RUN]
        long = max((b - a + 1 for a, b in runs), default=0)
        near = ((away > width) & (away <= 6 * width) & moving).sum() / 5
        dense = ((away <= width) & moving).sum() >= number.DENSITY * max(near, 0.5)
        exact = (x[_marked(x, runs)] == level).all() and long >= number.LONG_PLATEAU
        if dense and (len(runs) >= number.PLATEAU_RUNS or (rare and exact)):
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


def _marked(x, runs):
    """Mark runs of rows (first, last), ndarray (n,) of bool."""
    marked = np.zeros(x.shape, dtype=bool)
    for a, b in runs:
        marked[a : b + 1] = True
    return marked


# -- positions -------------------------------------------------------------------------


def _positions(log):
    """Find positions that are stuck, or jump."""
    stands = _stands(log) if log.every == 1 else None
    for j in np.flatnonzero(~log.still):
        if stands is not None:
            log.usable[_stuck(log, j, stands)] = False
        log.usable[_jumps(log, j)] = False


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
    others[j] = False
    for a, b in log.runs(stands[:, j] & ~log.lost):
        if b - a <= number.LEAST_STOP:
            continue
        inside = log.parts[log.label[a]]
        ends = speed[max(a - 1, inside.start) : a + 1], speed[b + 1 : inside.stop][:2]
        sudden = np.concatenate(ends).max(initial=0.0) > fast
        # When several joints stop together, the robot paused.
        pauses = stands[a + 3 : b - 1, others].all(axis=0).any()
        rest = same.sum() - same[a : b + 1].sum()
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


def position_jumps(names, q, parts):
    """Find jumps of positions (n, nv), as between concatenated recordings."""
    pieces = [np.asarray(q[part]) for part in parts if part.stop > part.start]
    whole = np.concatenate(pieces)
    bends = [np.abs(np.diff(x, 2, axis=0)).max(axis=0, initial=0.0) for x in pieces]
    # Interpolated, a jump takes two steps.
    least = 0.4 * number.LEAST_JUMP * np.ptp(whole, axis=0)
    joints = np.flatnonzero(np.max(bends, axis=0) > least)
    if not joints.size:
        return []
    stops = np.cumsum([0, *map(len, pieces)])
    parts = [slice(a, b) for a, b in pairwise(stops)]
    log = Rows(names, whole, whole, 1.0, parts, np.arange(len(whole)))
    for j in joints:
        _jumps(log, j)
    return [one for one in log.findings if one.severity == "warning"]


def _jumps(log, j):
    """Find steps of a position that its neighbours contradict."""
    x, jumps, least = log.q[:, j], [], number.LEAST_JUMP * np.ptp(log.q[:, j])
    for part in log.parts:
        step = np.diff(x[part])
        if step.size < number.FEWEST_AROUND:
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
    jumps = [k for k in jumps if not log.lost[k] and log.usable[k].any()]
    if not 0 < len(jumps) <= number.MOST_OUTLIERS * x.size:
        return _marked(x, [])
    # A single wrong sample is a jump there and back.
    sizes = np.array([x[k] - x[k - 1] for k in jumps])
    back = abs(sizes.sum()) < 0.5 * abs(sizes[0])
    facts = {"count": len(jumps), "step": sizes[0], "row": log.rows[jumps[0]]}
    log.report("position_jumps", j, "note" if back else "warning", **facts)
    return _marked(x, [(max(k - 2, 0), k + 1) for k in jumps])


# -- channels that hold another one ----------------------------------------------------


def _copies(log):
    """Find positions that equal each other, and torques but for a factor."""
    for kind, values in (("position", log.q), ("torque", log.tau)):
        centred = values - values.mean(axis=0)
        varies = (np.ptp(values, axis=0) > 0) & ((centred**2).sum(axis=0) > 0)
        moving = np.flatnonzero(varies)
        for place, j in enumerate(moving):
            for k in moving[:place]:
                x, y = centred[:, k], centred[:, j]
                # Joints may well be moved alike.
                of_torque = kind == "torque"
                factor = x @ y / (x @ x) if of_torque else 1.0
                left, share = y - factor * x, number.COPY if of_torque else 0.0
                if left @ left <= share**2 * (y @ y):
                    facts = {"first": log.names[k], "second": log.names[j]}
                    facts |= {"what": kind, "factor": factor}
                    log.report(f"copied_{kind}", [k, j], "error", **facts)
                    break


def _motion_as_torque(log):
    """Find torques that are positions, velocities or accelerations."""
    inner = [part for part in log.parts if part.stop - part.start > 2]
    whole = [log.q[part] for part in inner]
    y = np.concatenate([log.tau[part] for part in inner])
    for what in ("positions", "velocities", "accelerations"):
        x = np.concatenate(whole)
        moves = (np.ptp(x, axis=0) > 0) & (np.ptp(y, axis=0) > 0)
        size = np.maximum((x**2).mean(axis=0), 1e-300)
        left = np.sqrt(((y - x) ** 2).mean(axis=0) / size)
        if moves.any() and (left[moves] <= number.SAME).all():
            facts = {"what": what, "share": percent(left[moves].max())}
            every = range(len(log.names))
            log.report("motion_as_torque", every, "error", **facts)
            return
        whole = [np.gradient(piece, log.dt, axis=0) for piece in whole]


# Each reports what it finds, and marks samples that no later check uses.
CHECKS = (
    _rest,
    _held,
    _repeated_rows,
    _constant,
    _torques,
    _positions,
    _copies,
    _motion_as_torque,
)
