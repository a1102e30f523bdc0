"""Faults visible in the samples of a log alone, without a robot model."""

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.recording import ChannelFinding, listed_joints

# -- all of them -----------------------------------------------------------------------


def inspect_samples(names, q, tau, dt, parts, rows, revolute):
    """Inspect each channel without a robot model."""
    # q [rad or m], tau [N m or N] (n, nv); parts: slices of the recordings; rows (n,):
    # row numbers for messages; revolute (nv,), bool. Returns findings, the fault-free
    # samples (n, nv), bool, and the unwrapped positions.
    usable = np.ones(q.shape, dtype=bool)
    findings, q = wrapped_positions(names, q, revolute, parts, rows)
    still = still_joints(q, parts)
    usable[:, still] = False
    if still.all():
        findings.append(nothing_moves(names, q))
    else:
        findings += [_still_joint(names[j], j, q[:, j]) for j in np.flatnonzero(still)]
    moving = _moving(q, parts)
    lost, finding = repeated_rows(names, q, tau, dt, moving, parts, rows)
    findings += finding
    finding, held = held_channels(names, q, tau, dt, lost, parts, still)
    findings += finding
    constant = ~still & (np.ptp(tau, axis=0) == 0)
    usable[:, constant] = False
    findings += _constant(names, np.flatnonzero(constant), tau)
    switched = two_values(names, ~still, tau)
    findings += switched
    coarse = []
    for j in np.flatnonzero(~still & ~constant):
        lost_torque, bad = _dropouts(names[j], j, tau[:, j], dt, moving, parts, lost)
        if not (lost_torque or held[1, j]):
            moves = _moving(q[:, [j]], parts) & ~lost
            lost_torque, bad = _stuck(names[j], j, tau[:, j], dt, moves, parts)
        finding, clipped = _clipped(names[j], j, tau[:, j], moving & ~bad, parts)
        rough = _coarse(names[j], j, tau[:, j], moving, parts, held[1, j])
        # A coarse torque stays on its highest value as on any other.
        finding = rough or lost_torque + finding
        coarse += [j] if rough else []
        # What is said of all torques together is not said of each again.
        findings += [] if switched else finding
        usable[:, j] &= ~bad & ~clipped & (not rough)
    for j in np.flatnonzero(~still):
        known = lost
        if not held[0, j]:
            finding, bad = _frozen(names[j], j, q[:, j], dt, parts, lost, rows)
            findings += finding
            usable[bad] = False  # a wrong position spoils every torque
            # Lost samples are followed by a jump, which is already reported.
            known = lost | bad
        finding, jumps = _outliers(names[j], j, "position", q[:, j], parts, known, rows)
        findings += finding
        usable[jumps] = False
        finding, bad = _outliers(names[j], j, "torque", tau[:, j], parts, lost, rows)
        findings += [] if switched or j in coarse else finding
        usable[:, j] &= ~bad
    usable[lost] = False
    return findings, usable, q


def _moving(q, parts):
    """Return the samples at which any joint moves, (n,), bool."""
    moving = np.zeros(q.shape[0], dtype=bool)
    for part in parts:
        x = q[part]
        width = max(2, min(20, x.shape[0] // 8))
        travel = np.zeros(x.shape)
        travel[width:-width] = np.abs(x[2 * width :] - x[: -2 * width])
        high = np.maximum(np.quantile(travel, 0.99, axis=0), 1e-300)
        moving[part] = (travel > 0.02 * high).any(axis=1)
    return moving


def runs(flags):
    """Return first and last index of every run of True, two ndarrays of int."""
    edges = np.diff(np.r_[0, np.asarray(flags, dtype=np.int8), 0])
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1


# -- rows out of time order ------------------------------------------------------------


def shuffled_rows(names, q, parts, labels=None):
    """Find rows of positions (n, nv) that are out of time order; one error or none."""
    # parts: slices of the recordings; labels (n,): their names, if any.
    if labels is not None:
        runs_ = len(parts)
        different = {labels[part.start] for part in parts if part.stop > part.start}
        if runs_ >= number.RUNS_PER_LABEL * len(different) and (
            q.shape[0] < number.SHORT_RUN * runs_
        ):
            return [
                _shuffled(
                    names,
                    f"the label of the recording (groups) changes {runs_ - 1} times in "
                    f"{q.shape[0]} rows",
                )
            ]
    n, square, spread = 0, np.zeros(q.shape[1]), []
    for part in parts:
        x = np.asarray(q[part])
        n += part.stop - part.start - 1
        square += (np.diff(x, axis=0) ** 2).sum(axis=0)
        spread += [x.var(axis=0)] if len(x) else []
    sizes = [part.stop - part.start for part in parts if part.stop > part.start]
    variance = np.average(spread, axis=0, weights=sizes)
    moves = variance > number.LEAST_MOTION**2
    if n < number.SHORT_RUN or not moves.any():
        return []
    ratio = (square / n)[moves] / (2 * variance[moves])
    if ratio.min() < number.SHUFFLED:
        return []
    return [
        _shuffled(
            names,
            f"positions differ from row to row by {np.sqrt(ratio.min() * 2):.2g} times "
            "their spread",
        )
    ]


def _shuffled(names, evidence):
    return ChannelFinding(
        "shuffled_rows",
        tuple(range(len(names))),
        "error",  # Velocities and accelerations are meaningless.
        f"The rows are not in the order of time: {evidence}; give whole recordings as "
        "logged, split them by time and not at random (shuffle=False), or sort them "
        "by their time stamps.",
    )


# -- wrapped angles --------------------------------------------------------------------


def wrapped_positions(names, q, revolute, parts, rows):
    """Find angles (n, nv) that jump by a full turn, and unwrap them."""
    # Returns errors (differentiating across a jump gives speeds of hundreds of rad/s)
    # and the unwrapped positions. revolute (nv,), bool; rows (n,): row numbers for
    # messages.
    findings = []
    unwrapped = q
    for j in np.flatnonzero(revolute):
        for turn, name in ((2 * np.pi, "2 pi"), (360.0, "360")):
            first, count = _turns(q[:, j], turn, parts)
            if not count:
                continue
            if unwrapped is q:
                unwrapped = q.copy()
            for part in parts:
                x = np.unwrap(q[part, j], period=turn)
                # Each recording may begin in another turn.
                unwrapped[part, j] = x - turn * np.round(x.mean() / turn)
            period = "" if turn < 7 else ", period=360"
            findings.append(
                ChannelFinding(
                    "wrapped_position",
                    (int(j),),
                    "error",
                    f"The position of {names[j]} is wrapped: it jumps by {name} "
                    f"{count} time(s), first to row {rows[first]}; unwrap it, "
                    f"q[:, {j}] = numpy.unwrap(q[:, {j}]{period}), each recording for "
                    "itself.",
                )
            )
            break
    return findings, unwrapped


def _turns(x, turn, parts):
    """First row after a jump by a full turn, and the number of such jumps."""
    first, count = 0, 0
    for part in parts:
        y = x[part]
        if not (1 - number.TURN_LEFT) * turn < np.ptp(y) < 1.1 * turn:
            continue
        step = np.diff(y)
        over = np.flatnonzero(np.abs(step) > (1 - number.TURN_LEFT) * turn)
        # Steps as large as a turn everywhere are another fault.
        if not over.size or over.size > 0.05 * step.size:
            continue
        rest = step - turn * np.round(step / turn)
        usual = np.quantile(np.abs(np.delete(step, over)), 0.999)
        # After unwrapping, the steps must match those of the motion.
        over = over[np.abs(rest[over]) <= 3 * usual + 1e-3 * turn]
        if over.size and not count:
            first = part.start + int(over[0]) + 1
        count += over.size
    return first, count


# -- duplicated rows -------------------------------------------------------------------


def repeated_rows(names, q, tau, dt, moving, parts, rows):
    """Find rows that the logger duplicated while the robot moved; moving (n,), bool."""
    # Returns the lost rows (n,), bool, and findings: intervals in which the logger was
    # frozen, and other duplicated rows.
    same = np.zeros(q.shape[0], dtype=bool)
    for part in parts:
        table = np.hstack([q[part], tau[part]])
        same[part][1:] = (np.diff(table, axis=0) == 0).all(axis=1)
    frozen, findings = _frozen_rows(names, q, dt, same, parts, rows)
    same = same & moving & ~frozen
    count = np.count_nonzero(same)
    share = count / q.shape[0]
    if count < max(number.FEWEST_REPEATED, number.REPEATED_SHARE * q.shape[0]):
        return frozen, findings
    findings.append(
        ChannelFinding(
            "repeated_rows",
            tuple(range(q.shape[1])),
            # A few are recognisable from the motion around them; many make the speed
            # and the sample period wrong.
            "doubt" if share > number.MANY_REPEATED else "warning",
            f"{count} rows ({100 * share:.2g} %) equal the row before them in "
            f"every position and torque, the first is row {rows[np.argmax(same)]}: the "
            "logger wrote old values again; drop them and resample on the time stamps.",
        )
    )
    return frozen | same, findings


def _frozen_rows(names, q, dt, same, parts, rows):
    """Find intervals in which every channel is constant amid a motion."""
    frozen = np.zeros(q.shape[0], dtype=bool)
    steps = np.concatenate([np.abs(np.diff(q[part], axis=0)) for part in parts])
    speed = number.HELD_SPEED * np.quantile(steps, 0.995, axis=0)
    found, seconds = [], 0.0
    for part in parts:
        x = q[part]
        for a, b in zip(*runs(same[part])):
            # Samples a - 1 to b are equal.
            before, behind = a - 1 - number.FROZEN_BESIDE, b + 1 + number.FROZEN_BESIDE
            for_good = b + 1 == x.shape[0]
            if (
                b - a + 2 < number.FROZEN_ROWS
                or before < 0
                or (behind >= x.shape[0] and not for_good)
            ):
                continue
            into = (x[a - 1] - x[before]) / number.FROZEN_BESIDE
            fast = np.abs(into) > speed
            if not for_good:
                out = (x[behind] - x[b + 1]) / number.FROZEN_BESIDE
                fast &= (np.abs(out) > speed) & (into * out > 0)
            if fast.any():
                found.append((part.start + a - 1, b - a + 2))
                frozen[part.start + a : part.start + b + 1] = True
                seconds += (b - a + 1) * dt
    if not found:
        return frozen, []
    first = found[0][0]
    longest = max(length for _, length in found)
    finding = ChannelFinding(
        "frozen_recording",
        tuple(range(len(names))),
        # Speeds and accelerations are wrong at the ends of the interval only, but by so
        # much that an effect may be found in them; the rest of the recording is sound.
        "doubt",
        f"All channels stand still {len(found)} time(s) in the middle of the motion "
        f"({seconds:.3g} s together, the longest {longest} rows, the first from row "
        f"{rows[first]} on): the logger was frozen; drop these rows and split the "
        "recording there (groups).",
    )
    return frozen, [finding]


# -- channels at a lower rate ----------------------------------------------------------


def held_channels(names, q, tau, dt, lost, parts, skip):
    """Find positions or torques that were updated at a lower rate than the rows."""
    # A held channel lags by half its period and changes in steps, which looks like
    # delay, elasticity and friction at reversals, but it still shows the recorded
    # motion: a doubt. Returns findings, and which positions and torques are held, (2,
    # nv). Rows `lost` (n,) and joints `skip` (nv,) are ignored.
    findings = []
    held = np.zeros((2, q.shape[1]), dtype=bool)
    for i, (what, channels) in enumerate((("position", q), ("torque", tau))):
        rates = {
            int(j): rate
            for j in np.flatnonzero(~skip)
            if (rate := _repetition(channels[:, j], lost, parts)) is not None
        }
        if not rates:
            continue
        k = round(float(np.median(list(rates.values()))))
        joints = tuple(rates)
        other = "torques" if what == "position" else "positions"
        findings.append(
            ChannelFinding(
                f"held_{what}",
                joints,
                "doubt",
                f"The {what} of {listed_joints(names, joints)} has a new value only "
                f"every {k} rows ({1e3 * k * dt:.3g} ms) while the {other} change in "
                f"every one: it is late by {0.5e3 * (k - 1) * dt:.3g} ms and goes in "
                f"steps; keep one row for each new {what} (and dt={k * dt:.6g}), or "
                "record it at the full rate.",
            )
        )
        held[i, list(joints)] = True
    return findings, held


def _repetition(x, lost, parts):
    """Rows per new value, None if every row of every recording has one."""
    found = [k for part in parts if (k := _period(x[part][~lost[part]])) is not None]
    return float(np.median(found)) if found else None


def _period(y):
    """Rows per new value of a single recording, None if every row has one."""
    change = np.flatnonzero(np.diff(y) != 0)
    if change.size <= number.FEWEST_STEPS:
        return None
    steps = np.abs(y[change + 1] - y[change])[1:]
    gaps = np.diff(change)
    # A quantised signal changes by its resolution and is constant where it is slow;
    # steps of several quanta within one row cannot follow rows without any.
    fast = steps >= number.STEP * np.quantile(steps, 0.02)
    if fast.sum() < max(number.FEWEST_STEPS, number.STEP_SHARE * steps.size):
        return None
    k = np.median(gaps[fast])
    # If the rates have no integer ratio, some gaps are longer or shorter by a row.
    regular = (np.abs(gaps[fast] - k) <= 1) & (gaps[fast] >= 2)
    return float(k) if np.mean(regular) >= number.SAME_RATE else None


# -- channels without information ------------------------------------------------------


def still_joints(q, parts):
    """Joints at rest throughout, but for the noise of their positions, (nv,), bool."""
    noise = np.zeros(q.shape[1])
    count = 0
    for part in parts:
        d = np.diff(q[part], n=3, axis=0)
        noise += (d**2).sum(axis=0)
        count += d.shape[0]
    # The third difference of white noise has 20 times its variance.
    noise = np.sqrt(noise / max(20 * count, 1))
    travel = np.array(
        [np.ptp(q[part], axis=0) for part in parts if part.stop - part.start]
    ).max(axis=0)
    return travel <= number.STILL_TRAVEL * noise


def _still_joint(name, j, x):
    return ChannelFinding(
        "still_joint",
        (int(j),),
        "warning",
        f"{name} never moves: its position stays within {np.ptp(x):.3g} of "
        f"{x.mean():.4g}, which is its noise; its own parameters cannot be identified, "
        "lock it in the model or record a motion of it.",
    )


def at_rest(q, parts):
    """Whether nothing moves, in rows whose order nobody has looked at."""
    # Rows out of order look like noise as well, but like more of it.
    return bool(
        still_joints(q, parts).all() and q.std(axis=0).max() <= number.LEAST_MOTION
    )


def nothing_moves(names, q):
    """Return the finding that every joint is at rest."""
    most = int(np.argmax(np.ptp(q, axis=0)))
    return ChannelFinding(
        "still_joint",
        tuple(range(len(names))),
        "error",
        f"No joint moves: each position stays within its noise, that of {names[most]} "
        f"within {np.ptp(q[:, most]):.3g} of {q[:, most].mean():.4g}; expected a "
        "motion that excites the joints to be identified. Check the position columns.",
    )


def levels(tau):
    """Lowest, second highest and highest value of each torque, ndarray (3, nv)."""
    # The second is the lowest where a torque has no third value. Levels of levels are
    # those of all rows together.
    low, high = tau.min(axis=0), tau.max(axis=0)
    return np.stack([low, np.where(tau < high, tau, low).max(axis=0), high])


def two_values(names, moves, tau):
    """Find torques that tell two values only, of all joints that move: one or none."""
    # moves (nv,): which joints move; tau (n, nv), or their `levels`. Where one joint's
    # torque shows more, those of others are merely coarse.
    low, second, high = levels(tau)
    joints = np.flatnonzero(moves & (low < high))
    if not joints.size or (moves & (low < second)).any():
        return []
    j = joints[0]
    who = listed_joints(names, joints)
    return [
        ChannelFinding(
            "two_torques",
            tuple(int(k) for k in joints),
            "error",
            f"The torque of {who} has two values only ({low[j]:.6g} and {high[j]:.6g}"
            f"{f' of {names[j]}' if joints.size > 1 else ''}): such a channel holds a "
            "direction or a switch and no torque; record the torques themselves.",
        )
    ]


def _constant(names, joints, tau):
    """Find torques that are constant while their joints move, all in one."""
    if not joints.size:
        return []
    # No minus before zero.
    values = " or ".join(dict.fromkeys(f"{tau[0, j] + 0.0:.6g}" for j in joints))
    named = ", ".join(names[j] for j in joints)
    if joints.size == 1:
        text = (
            f"The torque of {named} is constant ({values}) while the joint moves: the "
            "channel carries no information; record it, or lock the joint in the model."
        )
    else:
        text = (
            f"The torques of {named} are constant ({values}) while the joints move: "
            "their channels carry no information; record them, or lock the joints in "
            "the model."
        )
    numbers = tuple(int(j) for j in joints)
    return [ChannelFinding("constant_torque", numbers, "error", text)]


def _coarse(name, j, x, moving, parts, held):
    """Find a torque too coarsely quantised to show its shape."""
    step = np.abs(np.concatenate([np.diff(x[p])[moving[p][1:]] for p in parts]))
    changes = step[step > 0]
    if changes.size == 0:
        return []
    same = 1.0 - changes.size / step.size
    # If the torque mostly stays on one quantisation level, a typical change is one
    # step; if it is sampled so slowly that it passes several, the smallest change is. A
    # held value is far from the next one, whatever the resolution.
    typical = same >= 0.5 and not held
    size = np.median(changes) if typical else np.quantile(changes, 0.02)
    rounding = size / np.sqrt(12) / max(x[moving].std(), np.finfo(float).tiny)
    if rounding < number.COARSE:
        return []
    return [
        ChannelFinding(
            "coarse_torque",
            (int(j),),
            "warning",
            f"The torque of {name} goes in steps of {size:.3g}, its spread is "
            f"{x[moving].std():.3g}, and it stays the same in {100 * same:.0f} % of "
            "its rows while the robot moves: its resolution is too coarse to tell "
            "much; leave it out of the fit, or record it finer.",
        )
    ]


# -- clipping --------------------------------------------------------------------------


def _clipped(name, j, x, moving, parts):
    """Find plateaus at the maximum or the minimum."""
    bad = np.zeros(x.shape, dtype=bool)
    spread = np.ptp(x)
    # If a torque hardly ever repeats a value, one plateau is proof enough.
    repeats = [a for a in (np.diff(x[part]) == 0 for part in parts)]
    rare = np.mean(np.concatenate(repeats)) < 0.25
    ends = []
    for sign in (1, -1):
        y = sign * x
        level = y.max()
        if level == 0:
            # No drive has that limit: these are sizes, or readings that were lost.
            continue
        width = number.PLATEAU * spread
        flags = (y >= level - width) & moving
        beside = (y < level - width) & (y >= level - 6 * width)
        lengths = []
        found = np.zeros(x.shape, dtype=bool)
        for part in parts:
            first, last = runs(flags[part])
            for a, b in zip(first, last):
                if b - a + 1 >= number.PLATEAU_RUN:
                    lengths.append(b - a + 1)
                    found[part.start + a : part.start + b + 1] = True
        density = flags.sum() / max((beside & moving).sum() / 5, 0.5)
        exact = (x == sign * level)[found].all() and max(lengths, default=0) >= (
            number.LONG_PLATEAU
        )
        enough = len(lengths) >= number.PLATEAU_RUNS or (rare and exact)
        if enough and density >= number.DENSITY:
            ends.append((sign * level, found.sum(), max(lengths)))
            bad |= found
    if not ends:
        return [], bad
    levels_ = [level for level, _, _ in ends]
    where = " and ".join(f"{level:.4g}" for level in levels_)
    if len(ends) == 2 and np.isclose(levels_[0], -levels_[1], rtol=number.PLATEAU):
        where = f"+-{levels_[0]:.4g}"
    share = sum(n for _, n, _ in ends) / x.size
    finding = ChannelFinding(
        "clipped_torque",
        (int(j),),
        "doubt" if share > number.MANY_CLIPPED else "warning",
        f"The torque of {name} is clipped at {where}: {_percent(share)} of its samples "
        f"lie there, up to {max(n for _, _, n in ends)} in a row, and hide what the "
        "joint needed. Record with a wider range, or a slower motion.",
    )
    return [finding], bad


# -- dropouts --------------------------------------------------------------------------


def _dropouts(name, j, x, dt, moving, parts, lost):
    """Find torques that are exactly zero for a while between values far from it."""
    bad = np.zeros(x.shape, dtype=bool)
    # Torques that pass zero slowly stay there, but do not jump there and back.
    steps = np.concatenate([np.abs(np.diff(x[part])) for part in parts])
    usual = np.median(steps[steps > 0]) if steps.any() else 0.0
    least = max(number.DROPOUT_STEP * usual, number.LEAST_DROPOUT * x.std())
    lengths, sure = [], 0
    for part in parts:
        y = x[part]
        for a, b in zip(*runs((y == 0) & moving[part] & ~lost[part])):
            if b - a + 1 < number.DROPOUT_RUN or a == 0 or b + 1 == y.size:
                continue
            far = sorted(np.abs([y[a - 1], y[b + 1]]) > least)
            if far[1]:
                sure += far[0]
                lengths.append(b - a + 1)
                bad[part.start + a : part.start + b + 1] = True
    if sure < number.DROPOUT_RUNS:
        return [], np.zeros(x.shape, dtype=bool)
    share = bad.sum() / x.size
    finding = ChannelFinding(
        "torque_dropouts",
        (int(j),),
        "doubt",
        f"The torque of {name} drops to exactly 0 and back {len(lengths)} times while "
        f"the robot moves ({_percent(share)} of its samples, up to "
        f"{max(lengths) * dt:.3g} s): the drive's readings were lost. Remove these "
        "rows, or record again.",
    )
    return [finding], bad


def _stuck(name, j, x, dt, moves, parts):
    """Find torques that stay at one value for long while their joint moves (n,)."""
    bad = np.zeros(x.shape, dtype=bool)
    repeats = np.zeros(x.shape, dtype=bool)
    for part in parts:
        repeats[part.start + 1 : part.stop] = np.diff(x[part]) == 0
    ends = x.min(), x.max()
    longest = 0
    for part in parts:
        for a, b in zip(*runs((repeats & moves)[part])):
            # The highest and the lowest value are those of a limit.
            if b - a + 2 >= number.STUCK_RUN and x[part.start + b] not in ends:
                bad[part.start + a - 1 : part.start + b + 1] = True
                longest = max(longest, b - a + 2)
    # What repeats elsewhere as well is coarse.
    if not bad.any() or repeats[~bad].mean() > number.STUCK_REPEATS:
        return [], np.zeros(x.shape, dtype=bool)
    finding = ChannelFinding(
        "torque_dropouts",
        (int(j),),
        "doubt",
        f"The torque of {name} stays at {x[bad][0]:.4g} while the joint moves "
        f"({_percent(bad.mean())} of its samples, up to {longest * dt:.3g} s): the "
        "drive's readings were lost. Remove these rows, or record again.",
    )
    return [finding], bad


def _percent(share):
    """Write a share in per cent."""
    return f"{100 * share:.2g} %"


def _frozen(name, j, x, dt, parts, lost, rows):
    """Find positions that are constant amid a motion."""
    bad = np.zeros(x.shape, dtype=bool)
    first_row, longest, places = None, 0, 0
    # Slower motion is settling, which proceeds in steps.
    speeds = np.concatenate([np.abs(np.diff(x[part])) for part in parts])
    creep = number.FROZEN_SPEED * np.quantile(speeds, 0.995)
    for part in parts:
        y = x[part]
        step = np.diff(y)
        noise = np.median(np.abs(np.diff(y, n=3))) / (0.6745 * np.sqrt(20))
        starts, stops = runs(step == 0)
        for a, b in zip(starts, stops):
            length = b - a + 1  # steps without change; samples a .. b + 1 are equal
            width = max(length, 4)
            before, after = a - width, b + 2 + width
            if length < number.FROZEN_RUN or before < 0 or after >= y.size:
                continue
            if lost[part][a + 1 : b + 2].all():
                bad[part.start + b + 1 : part.start + b + 3] = True
                continue
            left = (y[a] - y[before]) / width
            right = (y[after] - y[b + 2]) / width
            if left * right <= 0 or min(abs(left), abs(right)) < creep:
                continue
            # After stiction or a pause the motion resumes where it stopped; after lost
            # samples the position has moved on.
            travel = min(abs(left), abs(right)) * length
            caught_up = np.sign(left) * step[b + 1]
            usual = np.abs(np.r_[step[before:a], step[b + 2 : after]]).max()
            if travel > number.FROZEN_TRAVEL * noise and caught_up > max(
                0.5 * travel, number.FROZEN_STEP * usual
            ):
                bad[part.start + a : part.start + b + 3] = True
                places += 1
                if length > longest:
                    longest, first_row = length, part.start + a
    if places == 0:
        return [], bad
    finding = ChannelFinding(
        "frozen_position",
        (int(j),),
        "warning",
        f"The position of {name} is frozen {places} time(s) in the middle of a "
        f"motion, the longest for {longest + 1} samples ({longest * dt:.3g} s) from "
        f"row {rows[first_row]} on: samples were lost; leave these rows out or split "
        "the recording there (groups).",
    )
    return [finding], bad


# -- spikes and jumps ------------------------------------------------------------------


def position_jumps(names, q, parts):
    """Find jumps of positions (n, nv), as between concatenated recordings."""
    # These are the findings of `inspect_samples` of the kind "position_jumps".
    found = []
    for j in _steps_off(q, parts):
        nothing, rows = np.zeros(q.shape[0], dtype=bool), np.arange(q.shape[0])
        x = np.concatenate([np.asarray(q[part])[:, j] for part in parts])
        found += _outliers(names[j], j, "position", x, parts, nothing, rows)[0]
    return [finding for finding in found if finding.kind == "position_jumps"]


def _steps_off(q, parts):
    """Joints with steps that are large enough to be a jump; a fast pre-check."""
    low, high, bends = [], [], [np.zeros(q.shape[1])]
    for part in parts:
        x = np.asarray(q[part])
        low.append(x.min(axis=0))
        high.append(x.max(axis=0))
        if len(x) > 3:
            bends.append([np.abs(np.diff(own, 2)).max() for own in x.T])
    travel = np.max(high, axis=0) - np.min(low, axis=0)
    # Interpolated, a jump takes two steps.
    return np.flatnonzero(np.max(bends, axis=0) > 0.4 * number.LEAST_JUMP * travel)


def _outliers(name, j, what, x, parts, known, rows):
    """Find single samples, and position steps, inconsistent with their neighbours."""
    bad = np.zeros(x.shape, dtype=bool)
    # A torque may ring; a position is smooth.
    least = (0.05 if what == "torque" else number.LEAST_JUMP) * np.ptp(x)
    spikes, jumps = [], []
    for part in parts:
        if part.stop - part.start < number.FEWEST_AROUND:
            continue
        lone = _spikes(x[part], least)
        spikes += list(part.start + np.flatnonzero(lone & ~known[part]))
        if what == "position":
            behind = _jumps(x[part], least)
            # A spike is two steps, too.
            wide = np.convolve(lone, np.ones(5), mode="same") > 0
            jumps += list(part.start + np.flatnonzero(behind & ~wide & ~known[part]))
    total = len(spikes) + len(jumps)
    if total == 0 or total > number.MOST_OUTLIERS * x.size:
        return [], bad
    for row in spikes:
        bad[max(row - 1, 0) : row + 2] = True
    for row in jumps:
        bad[max(row - 2, 0) : row + 2] = True
    findings = []
    if spikes:
        findings.append(
            ChannelFinding(
                f"{what}_spikes",
                (int(j),),
                "warning",
                f"The {what} of {name} has {len(spikes)} single-sample spike(s), the "
                f"first of {x[spikes[0]]:.4g} in row {rows[spikes[0]]}, that the "
                "samples around contradict; interpolate them or give them no weight.",
            )
        )
    if jumps:
        step = x[jumps[0]] - x[jumps[0] - 1]
        findings.append(
            ChannelFinding(
                "position_jumps",
                (int(j),),
                "doubt",
                f"The position of {name} jumps {len(jumps)} time(s), first by "
                f"{step:.3g} to row {rows[jumps[0]]}, which its speed before and after "
                "contradicts: samples were lost; split the recording there (groups).",
            )
        )
    return findings, bad


def _spikes(y, least):
    """Find samples far from the two before and the two after them."""
    lone = np.zeros(y.size, dtype=bool)
    base = 0.5 * (y[:-4] + y[4:])
    peak = y[2:-2] - base
    beside = np.maximum(np.abs(y[1:-3] - base), np.abs(y[3:-1] - base))
    size = np.abs(peak)
    lone[2:-2] = (
        (size > number.OUTLIER * _scale(peak)) & (beside < 0.25 * size) & (size > least)
    )
    return lone


def _jumps(y, least):
    """Find samples that follow a step too large for the motion."""
    behind = np.zeros(y.size, dtype=bool)
    step = np.diff(y)
    # The next steps are left out: an interpolated jump takes two of them.
    near = [step[:-6], step[1:-5], step[2:-4], step[4:-2], step[5:-1], step[6:]]
    usual = np.median(near, axis=0)
    over = step[3:-3] - usual
    behind[4:-3] = (
        (np.abs(over) > number.OUTLIER * _scale(over))
        & (np.abs(over) > least)
        & (np.abs(over) > 2.5 * np.abs(usual))
    )
    return behind


def _scale(x):
    """Robust standard deviation; the quantile keeps it nonzero with standstill."""
    return max(
        np.median(np.abs(x)) / 0.6745,
        np.quantile(np.abs(x), 0.9) / 1.645,
        np.finfo(float).tiny,
    )


# -- channels that hold something else -------------------------------------------------


def unlike_channels(names, q, tau, dt, parts):
    """Find copies of channels, encoders that stop, and torques that are speeds."""
    findings = _copies(names, q, "position") + _copies(names, tau, "torque")
    findings += _never_written(names, tau)
    for j in range(len(names)):
        findings += _stuck_encoder(names, j, q, dt, parts)
    return findings + _derivatives(names, q, tau, dt, parts)


def _copies(names, values, kind):
    """Find channels that equal each other in every row."""
    moving = np.flatnonzero(np.ptp(values, axis=0) > 0)
    found = []
    for place, j in enumerate(moving):
        same = [k for k in moving[:place] if np.array_equal(values[:, j], values[:, k])]
        if same:
            found.append(
                ChannelFinding(
                    f"copied_{kind}",
                    (int(same[0]), int(j)),
                    "error",
                    f"The {kind} of {names[j]} equals that of {names[same[0]]} in "
                    "every row: one channel was logged twice. Log the other one, or "
                    "leave the joint out (--joints).",
                )
            )
    return found


def _never_written(names, tau):
    """Find torques that are zero for all purposes."""
    size = np.abs(tau).max(axis=0)
    empty = tuple(np.flatnonzero((size > 0) & (size < number.NOTHING)).tolist())
    if not empty:
        return []
    return [
        ChannelFinding(
            "constant_torque",
            empty,
            "error",
            f"The torques of {listed_joints(names, empty)} are zero for all purposes "
            f"(largest {size[list(empty)].max():.2g}): nothing was written there. Log "
            "the measured torques or currents.",
        )
    ]


def _stuck_encoder(names, j, q, dt, parts):
    """Find a position that stops within one sample in the middle of a motion."""
    steps = [np.diff(q[p, j]) for p in parts]
    moves = [(x[1:] != 0) & (x[:-1] != 0) for x in steps]
    change = np.concatenate([np.abs(np.diff(x))[m] for x, m in zip(steps, moves)])
    speed = np.concatenate([np.abs(x[x != 0]) for x in steps])
    if not change.size:
        return []
    fast = max(
        number.SUDDEN * np.quantile(change, number.USUAL), 0.5 * np.median(speed)
    )
    found = []
    for part in parts:
        step = np.abs(np.diff(q[part, j]))
        for first, last in zip(*runs(step == 0)):
            around = np.r_[step[max(first - 2, 0) : first], step[last + 1 : last + 3]]
            if last - first > number.LEAST_STOP and around.max(initial=0.0) > fast:
                found.append((part.start + first, last - first + 2))
    rows = sum(length for _, length in found)
    if rows < number.STUCK_SHARE * len(q):
        return []
    first = found[0][0]
    return [
        ChannelFinding(
            "stuck_position",
            (j,),
            "error",
            f"The position of {names[j]} stays at {q[first, j]:.4g} from row {first} "
            f"on, and stops or starts within one sample; {rows} rows "
            f"({rows * dt:.3g} s) are like that: the encoder was stuck, or at the end "
            "of its range. Leave these rows out.",
        )
    ]


def _derivatives(names, q, tau, dt, parts):
    """Find torques that are velocities."""
    speed, torque = [], []
    for part in parts:
        if part.stop - part.start > 2:
            speed.append(np.gradient(q[part], dt, axis=0)[1:-1])
            torque.append(tau[part][1:-1])
    if not speed:
        return []
    v, y = np.concatenate(speed), np.concatenate(torque)
    moves = (np.ptp(v, axis=0) > 0) & (np.ptp(y, axis=0) > 0)
    left = np.sqrt(
        ((y - v) ** 2).mean(axis=0) / np.maximum((v**2).mean(axis=0), 1e-300)
    )
    if not moves.any() or (left[moves] > number.SAME).any():
        return []
    every = tuple(range(len(names)))
    message = (
        "The torques are the velocities of the joints to "
        f"{100 * left[moves].max():.1g} %: the wrong columns were taken. Give those of "
        "the torques (--columns)."
    )
    return [ChannelFinding("velocity_as_torque", every, "error", message)]
