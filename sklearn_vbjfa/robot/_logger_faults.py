"""Faults of whole rows: what loggers, clocks and conversions of angles do.

No robot model is asked, but for which joints turn.
"""

import numpy as np

from sklearn_vbjfa.robot._channel_finding import ChannelFinding, listed

# Rows in the order of time resemble the row before; of shuffled ones the mean squared
# step is twice the variance. Seven tenths of that is a correlation of 0.3.
_SHUFFLED = 0.7
# ... of a joint that moves at all [rad or m]: noise at rest has no order either.
_LEAST_MOTION = 0.01
# Runs of equal labels in shuffled rows: so many more than labels, and so short.
_RUNS_PER_LABEL = 4
_SHORT_RUN = 16
# A jump is a whole turn if this share of a turn is left at most.
_TURN_LEFT = 0.15
# Rows written twice that are worth a word; more are doubtful.
_FEWEST_REPEATED = 3
_REPEATED_SHARE = 0.002
_MANY_REPEATED = 0.1
# The logger is frozen if so many rows are equal, while a joint moves at this share of
# its speed in the samples right before and right behind.
_FROZEN_ROWS = 5
_FROZEN_SPEED = 0.1
_FROZEN_BESIDE = 3
# Steps that are this multiple of the channel's resolution are no rounding; at least so
# many of them, and this share of all, tell the rate of a channel.
_STEP = 4.0
_FEWEST_STEPS = 20
_STEP_SHARE = 0.3
_SAME_RATE = 0.8


# -- rows that are not in the order of time --------------------------------------------


def shuffled_rows(names, q, parts, labels=None):
    """Find rows that are not in the order of time.

    Parameters
    ----------
    names : sequence of str
        Joints.
    q : ndarray of shape (n, nv)
        Positions.
    parts : list of slice
        Recordings.
    labels : array-like of shape (n,), default=None
        Labels of the recordings.

    Returns
    -------
    list of ChannelFinding
        One error, or none.
    """
    if labels is not None:
        runs_ = len(parts)
        if runs_ >= _RUNS_PER_LABEL * len(set(np.asarray(labels).tolist())) and (
            q.shape[0] < _SHORT_RUN * runs_
        ):
            return [
                _shuffled(
                    names,
                    f"the label of the recording (groups) changes {runs_ - 1} times in "
                    f"{q.shape[0]} rows",
                )
            ]
    n, square = 0, np.zeros(q.shape[1])
    for part in parts:
        n += part.stop - part.start - 1
        square += (np.diff(q[part], axis=0) ** 2).sum(axis=0)
    spread = np.array([q[part].var(axis=0) for part in parts if part.stop > part.start])
    sizes = [part.stop - part.start for part in parts if part.stop > part.start]
    variance = np.average(spread, axis=0, weights=sizes)
    moves = variance > _LEAST_MOTION**2
    if n < _SHORT_RUN or not moves.any():
        return []
    ratio = (square / n)[moves] / (2 * variance[moves])
    if ratio.min() < _SHUFFLED:
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
        "error",  # Neither velocities nor accelerations can be had.
        f"The rows are not in the order of time: {evidence}; give whole recordings as "
        "logged, split them by time and not at random (shuffle=False), or sort them "
        "by their time stamps.",
    )


# -- wrapped angles --------------------------------------------------------------------


def wrapped_positions(names, q, revolute, parts, rows):
    """Find angles that jump by a whole turn, and put them together again.

    Parameters
    ----------
    names : sequence of str
        Joints.
    q : ndarray of shape (n, nv)
        Positions [rad], perhaps in degrees.
    revolute : ndarray of shape (nv,) of bool
        Which joints turn.
    parts : list of slice
        Recordings.
    rows : ndarray of shape (n,) of int
        Numbers of the rows, for messages.

    Returns
    -------
    findings : list of ChannelFinding
        Errors: a derivative across a jump is a wrong speed of hundreds of rad/s.
    unwrapped : ndarray of shape (n, nv)
        Positions without the jumps.
    """
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
    """First row behind a jump by a whole turn, and the number of such jumps."""
    first, count = 0, 0
    for part in parts:
        y = x[part]
        if not (1 - _TURN_LEFT) * turn < np.ptp(y) < 1.1 * turn:
            continue
        step = np.diff(y)
        over = np.flatnonzero(np.abs(step) > (1 - _TURN_LEFT) * turn)
        # Steps as large as a turn everywhere are another fault.
        if not over.size or over.size > 0.05 * step.size:
            continue
        rest = step - turn * np.round(step / turn)
        usual = np.quantile(np.abs(np.delete(step, over)), 0.999)
        # Without the turn the steps must be those of the motion.
        over = over[np.abs(rest[over]) <= 3 * usual + 1e-3 * turn]
        if over.size and not count:
            first = part.start + int(over[0]) + 1
        count += over.size
    return first, count


# -- rows written again ----------------------------------------------------------------


def runs(flags):
    """Return first and last index of every run of True, two ndarrays of int."""
    edges = np.diff(np.r_[0, np.asarray(flags, dtype=np.int8), 0])
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1


def repeated_rows(names, q, tau, dt, moving, parts, rows):
    """Find rows that the logger wrote again while the robot moved.

    Parameters
    ----------
    names : sequence of str
        Joints.
    q, tau : ndarray of shape (n, nv)
        Positions and torques.
    dt : float
        Sample period [s].
    moving : ndarray of shape (n,) of bool
        Samples at which some joint moves.
    parts : list of slice
        Recordings.
    rows : ndarray of shape (n,) of int
        Numbers of the rows, for messages.

    Returns
    -------
    lost : ndarray of shape (n,) of bool
        Rows written again.
    findings : list of ChannelFinding
        Stretches in which the logger stood still, and other repeated rows.
    """
    same = np.zeros(q.shape[0], dtype=bool)
    for part in parts:
        table = np.hstack([q[part], tau[part]])
        same[part][1:] = (np.diff(table, axis=0) == 0).all(axis=1)
    frozen, findings = _frozen_rows(names, q, dt, same, parts, rows)
    same = same & moving & ~frozen
    count = np.count_nonzero(same)
    share = count / q.shape[0]
    if count < max(_FEWEST_REPEATED, _REPEATED_SHARE * q.shape[0]):
        return frozen, findings
    findings.append(
        ChannelFinding(
            "repeated_rows",
            tuple(range(q.shape[1])),
            # Some are told from the motion around them; many make its speed and the
            # sample period wrong.
            "doubt" if share > _MANY_REPEATED else "warning",
            f"{count} rows ({100 * share:.2g} %) equal the row before them in "
            f"every position and torque, the first is row {rows[np.argmax(same)]}: the "
            "logger wrote old values again; drop them and resample on the time stamps.",
        )
    )
    return frozen | same, findings


def _frozen_rows(names, q, dt, same, parts, rows):
    """Find stretches in which every channel stands still in the middle of a motion."""
    frozen = np.zeros(q.shape[0], dtype=bool)
    steps = np.concatenate([np.abs(np.diff(q[part], axis=0)) for part in parts])
    speed = _FROZEN_SPEED * np.quantile(steps, 0.995, axis=0)
    found, seconds = [], 0.0
    for part in parts:
        x = q[part]
        for a, b in zip(*runs(same[part])):
            # Samples a - 1 to b are equal.
            before, behind = a - 1 - _FROZEN_BESIDE, b + 1 + _FROZEN_BESIDE
            for_good = b + 1 == x.shape[0]
            if (
                b - a + 2 < _FROZEN_ROWS
                or before < 0
                or (behind >= x.shape[0] and not for_good)
            ):
                continue
            into = (x[a - 1] - x[before]) / _FROZEN_BESIDE
            fast = np.abs(into) > speed
            if not for_good:
                out = (x[behind] - x[b + 1]) / _FROZEN_BESIDE
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
        # Speeds and accelerations are wrong at the borders only, but there by so much
        # that an effect may be found in them; the rest of the recording is sound.
        "doubt",
        f"All channels stand still {len(found)} time(s) in the middle of the motion "
        f"({seconds:.3g} s together, the longest {longest} rows, the first from row "
        f"{rows[first]} on): the logger was frozen; drop these rows and split the "
        "recording there (groups).",
    )
    return frozen, [finding]


# -- channels at a lower rate ----------------------------------------------------------


def held_channels(names, q, tau, dt, lost, parts, skip):
    """Find positions or torques that were written at a lower rate than the rows.

    Parameters
    ----------
    names : sequence of str
        Joints.
    q, tau : ndarray of shape (n, nv)
        Positions and torques.
    dt : float
        Sample period [s].
    lost : ndarray of shape (n,) of bool
        Rows written again as a whole, which do not count.
    parts : list of slice
        Recordings.
    skip : ndarray of shape (nv,) of bool
        Joints that do not move.

    Returns
    -------
    findings : list of ChannelFinding
        Doubts: a held channel is late by half of its period and goes in steps, which
        passes for delay, elasticity and friction at reversals. It is still the motion
        that was recorded, so the rest of a fit is not wrong.
    held : ndarray of shape (2, nv) of bool
        Which positions, and which torques, are held.
    """
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
                f"The {what} of {listed(names, joints)} has a new value only every "
                f"{k} rows ({1e3 * k * dt:.3g} ms) while the {other} change in every "
                f"one: it is late by {0.5e3 * (k - 1) * dt:.3g} ms and goes in steps; "
                f"keep one row for each new {what} (and dt={k * dt:.6g}), or record "
                "it at the full rate.",
            )
        )
        held[i, list(joints)] = True
    return findings, held


def _repetition(x, lost, parts):
    """Rows for one new value, None if every row of every recording has one."""
    found = [k for part in parts if (k := _period(x[part][~lost[part]])) is not None]
    return float(np.median(found)) if found else None


def _period(y):
    """Rows for one new value of a single recording, None for one."""
    change = np.flatnonzero(np.diff(y) != 0)
    if change.size <= _FEWEST_STEPS:
        return None
    steps = np.abs(y[change + 1] - y[change])[1:]
    gaps = np.diff(change)
    # An encoder or a converter that rounds goes by its resolution, and stands still
    # where the signal is slow; steps of several of them within one row cannot follow
    # upon rows without any.
    fast = steps >= _STEP * np.quantile(steps, 0.02)
    if fast.sum() < max(_FEWEST_STEPS, _STEP_SHARE * steps.size):
        return None
    k = np.median(gaps[fast])
    # Where the rate is no whole multiple, some gaps are longer or shorter by a row.
    regular = (np.abs(gaps[fast] - k) <= 1) & (gaps[fast] >= 2)
    return float(k) if np.mean(regular) >= _SAME_RATE else None
