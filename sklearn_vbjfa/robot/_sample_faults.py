"""Faults of single channels that their samples show: no robot model is asked."""

import numpy as np

from sklearn_vbjfa.robot._channel_finding import ChannelFinding
from sklearn_vbjfa.robot._logger_faults import (
    held_channels,
    repeated_rows,
    runs,
    wrapped_positions,
)

# A joint whose travel is below this many standard deviations of its own noise rests.
_STILL_TRAVEL = 12.0
# A torque is coarse if rounding makes errors of this share of its spread.
_COARSE = 0.05
# Clipping: samples within this share of the channel's range of an extreme value, ...
_PLATEAU = 1e-3
# ... in runs of at least so many, in at least so many places, ...
_PLATEAU_RUN = 5
_PLATEAU_RUNS = 3
# (or one of so many equal samples, in a channel that does not repeat itself)
_LONG_PLATEAU = 12
# ... and denser by this factor than the torques next to the extreme value. Of a sine
# without noise, whose extremes are flat, 3.4 times as many lie there.
_PLATEAU_DENSITY = 8.0
# Repeated positions are a dropout if the motion around them covers so many standard
# deviations of the noise and the step after them is so many times the others (an
# encoder's quantum at low speed is as large as the steps around it).
_FROZEN_TRAVEL = 6.0
_FROZEN_STEP = 2.5
_FROZEN_RUN = 3
# ... share of the joint's speed that counts as moving.
_FROZEN_SPEED = 0.02
# Steps and spikes, in robust standard deviations of what the neighbours leave open.
_OUTLIER = 25.0
# ... of so many samples together at least.
_FEWEST_AROUND = 16
# ... and of the channel's range.
_LEAST_JUMP = 0.003
# More than this share of outliers is no fault of single samples, but noise.
_MOST_OUTLIERS = 0.01


def inspect_samples(names, q, tau, dt, parts, rows, revolute):
    """Look at every channel by itself.

    Parameters
    ----------
    names : sequence of str
        Joints.
    q, tau : ndarray of shape (n, nv)
        Positions [rad or m] and torques [N m or N].
    dt : float
        Sample period [s].
    parts : list of slice
        Recordings, which together cover all rows.
    rows : ndarray of shape (n,) of int
        Numbers of the rows, for messages.
    revolute : ndarray of shape (nv,) of bool
        Which joints turn.

    Returns
    -------
    findings : list of ChannelFinding
        Faults.
    usable : ndarray of shape (n, nv), bool
        Samples of each joint that no fault concerns.
    q : ndarray of shape (n, nv)
        Positions, unwrapped.
    """
    usable = np.ones(q.shape, dtype=bool)
    findings, q = wrapped_positions(names, q, revolute, parts, rows)
    still = _still(q, parts)
    for j in np.flatnonzero(still):
        usable[:, j] = False
        findings.append(_still_joint(names[j], j, q[:, j]))
    moving = _moving(q, parts)
    lost, finding = repeated_rows(names, q, tau, dt, moving, parts, rows)
    findings += finding
    finding, held = held_channels(names, q, tau, dt, lost, parts, still)
    findings += finding
    for j in np.flatnonzero(~still):
        if np.ptp(tau[:, j]) == 0:
            usable[:, j] = False
            findings.append(_constant(names[j], j, tau[:, j]))
            continue
        finding, bad = _clipped(names[j], j, tau[:, j], moving, parts)
        coarse = _coarse(names[j], j, tau[:, j], moving, parts, held[1, j])
        findings += finding + coarse
        usable[:, j] &= ~bad & (not coarse)
    for j in np.flatnonzero(~still):
        known = lost
        if not held[0, j]:
            finding, bad = _frozen(names[j], j, q[:, j], dt, parts, lost, rows)
            findings += finding
            usable[bad] = False  # a wrong position spoils every torque
            # Where samples were lost there is a jump behind them, which is known.
            known = lost | bad
        finding, jumps = _outliers(names[j], j, "position", q[:, j], parts, known, rows)
        findings += finding
        usable[jumps] = False
        finding, bad = _outliers(names[j], j, "torque", tau[:, j], parts, lost, rows)
        findings += finding
        usable[:, j] &= ~bad
    usable[lost] = False
    return findings, usable, q


def position_jumps(names, q, parts, rows):
    """Find steps of positions that are no motion, as where recordings meet.

    Parameters
    ----------
    names : sequence of str
        Joints.
    q : ndarray of shape (n, nv)
        Positions.
    parts : list of slice
        Recordings.
    rows : ndarray of shape (n,) of int
        Numbers of the rows, for messages.

    Returns
    -------
    list of ChannelFinding
        Those findings of `inspect_samples` of the kind "position_jumps".
    """
    nothing = np.zeros(q.shape[0], dtype=bool)
    found = []
    for j in range(q.shape[1]):
        if _steps_off(q[:, j], parts):
            found += _outliers(names[j], j, "position", q[:, j], parts, nothing, rows)[
                0
            ]
    return [finding for finding in found if finding.kind == "position_jumps"]


def _steps_off(x, parts):
    """Whether a step is large enough to be a jump; far quicker than to look closer."""
    # Interpolated, a jump takes two steps.
    least = 0.4 * _LEAST_JUMP * np.ptp(x)
    for part in parts:
        step = np.diff(x[part])
        if step.size > 2 and (np.abs(np.diff(step)) > least).any():
            return True
    return False


# -- nothing in the channel ------------------------------------------------------------


def _still(q, parts):
    """Joints that rest throughout, ndarray of shape (nv,) of bool."""
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
    return travel <= _STILL_TRAVEL * noise


def _still_joint(name, j, x):
    return ChannelFinding(
        "still_joint",
        (int(j),),
        "warning",
        f"{name} never moves: its position stays within {np.ptp(x):.3g} of "
        f"{x.mean():.4g}, which is its noise; its own parameters cannot be identified, "
        "lock it in the model or record a motion of it.",
    )


def _constant(name, j, x):
    return ChannelFinding(
        "constant_torque",
        (int(j),),
        "error",
        f"The torque of {name} is constant ({x[0]:.6g}) while the joint moves: the "
        "channel carries no information; record it, or lock the joint in the model.",
    )


def _coarse(name, j, x, moving, parts, held):
    """Find a torque whose resolution leaves little of its shape."""
    step = np.abs(np.concatenate([np.diff(x[p])[moving[p][1:]] for p in parts]))
    changes = step[step > 0]
    if changes.size == 0:
        return []
    same = 1.0 - changes.size / step.size
    # Where the torque mostly stands still between two values of its grid, a change is
    # one step of it; where it is sampled so seldom that it passes several, the
    # smallest is. What is held is far from its next value, whatever its grid.
    typical = same >= 0.5 and not held
    size = np.median(changes) if typical else np.quantile(changes, 0.02)
    rounding = size / np.sqrt(12) / max(x[moving].std(), np.finfo(float).tiny)
    if rounding < _COARSE:
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


def _moving(q, parts):
    """Return at which samples any joint moves, ndarray of shape (n,) of bool."""
    moving = np.zeros(q.shape[0], dtype=bool)
    for part in parts:
        x = q[part]
        width = max(2, min(20, x.shape[0] // 8))
        travel = np.zeros(x.shape)
        travel[width:-width] = np.abs(x[2 * width :] - x[: -2 * width])
        high = np.maximum(np.quantile(travel, 0.99, axis=0), 1e-300)
        moving[part] = (travel > 0.02 * high).any(axis=1)
    return moving


def _clipped(name, j, x, moving, parts):
    """Find plateaus at the largest or the smallest value."""
    bad = np.zeros(x.shape, dtype=bool)
    spread = np.ptp(x)
    # Where a torque hardly ever repeats itself, one plateau is proof enough.
    repeats = [a for a in (np.diff(x[part]) == 0 for part in parts)]
    rare = np.mean(np.concatenate(repeats)) < 0.25
    ends = []
    for sign in (1, -1):
        y = sign * x
        level = y.max()
        flags = (y >= level - _PLATEAU * spread) & moving
        beside = (y < level - _PLATEAU * spread) & (y >= level - 6 * _PLATEAU * spread)
        lengths = []
        found = np.zeros(x.shape, dtype=bool)
        for part in parts:
            first, last = runs(flags[part])
            for a, b in zip(first, last):
                if b - a + 1 >= _PLATEAU_RUN:
                    lengths.append(b - a + 1)
                    found[part.start + a : part.start + b + 1] = True
        density = flags.sum() / max((beside & moving).sum() / 5, 0.5)
        exact = (x == sign * level)[found].all() and max(lengths, default=0) >= (
            _LONG_PLATEAU
        )
        enough = len(lengths) >= _PLATEAU_RUNS or (rare and exact)
        if enough and density >= _PLATEAU_DENSITY:
            ends.append((sign * level, found.sum(), max(lengths)))
            bad |= found
    if not ends:
        return [], bad
    where = " and ".join(f"{level:.5g}" for level, _, _ in ends)
    count = sum(n for _, n, _ in ends)
    finding = ChannelFinding(
        "clipped_torque",
        (int(j),),
        "warning",
        f"The torque of {name} is clipped at {where}: {count} samples "
        f"({100 * count / x.size:.2g} %) lie on that value, up to "
        f"{max(n for _, _, n in ends)} in a row; give those samples no weight, or "
        "record with a wider range.",
    )
    return [finding], bad


# -- dropouts --------------------------------------------------------------------------


def _frozen(name, j, x, dt, parts, lost, rows):
    """Find positions that stand still in the middle of a motion."""
    bad = np.zeros(x.shape, dtype=bool)
    first_row, longest, places = None, 0, 0
    # Slower than this is settling, which goes in steps.
    speeds = np.concatenate([np.abs(np.diff(x[part])) for part in parts])
    creep = _FROZEN_SPEED * np.quantile(speeds, 0.995)
    for part in parts:
        y = x[part]
        step = np.diff(y)
        noise = np.median(np.abs(np.diff(y, n=3))) / (0.6745 * np.sqrt(20))
        starts, stops = runs(step == 0)
        for a, b in zip(starts, stops):
            length = b - a + 1  # steps without change; samples a .. b + 1 are equal
            width = max(length, 4)
            before, after = a - width, b + 2 + width
            if length < _FROZEN_RUN or before < 0 or after >= y.size:
                continue
            if lost[part][a + 1 : b + 2].all():
                bad[part.start + b + 1 : part.start + b + 3] = True
                continue
            left = (y[a] - y[before]) / width
            right = (y[after] - y[b + 2]) / width
            if left * right <= 0 or min(abs(left), abs(right)) < creep:
                continue
            # Stiction and a motion that pauses go on from where they stopped; after
            # lost samples the position has moved on meanwhile.
            travel = min(abs(left), abs(right)) * length
            caught_up = np.sign(left) * step[b + 1]
            usual = np.abs(np.r_[step[before:a], step[b + 2 : after]]).max()
            if travel > _FROZEN_TRAVEL * noise and caught_up > max(
                0.5 * travel, _FROZEN_STEP * usual
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


def _outliers(name, j, what, x, parts, known, rows):
    """Find single samples, and steps of the position, that the others contradict."""
    bad = np.zeros(x.shape, dtype=bool)
    # A torque may ring; a position is smooth.
    least = (0.05 if what == "torque" else _LEAST_JUMP) * np.ptp(x)
    spikes, jumps = [], []
    for part in parts:
        if part.stop - part.start < _FEWEST_AROUND:
            continue
        lone = _spikes(x[part], least)
        spikes += list(part.start + np.flatnonzero(lone & ~known[part]))
        if what == "position":
            behind = _jumps(x[part], least)
            # A spike is two steps, too.
            wide = np.convolve(lone, np.ones(5), mode="same") > 0
            jumps += list(part.start + np.flatnonzero(behind & ~wide & ~known[part]))
    total = len(spikes) + len(jumps)
    if total == 0 or total > _MOST_OUTLIERS * x.size:
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
    """Find samples far from what those two before and behind them say."""
    lone = np.zeros(y.size, dtype=bool)
    base = 0.5 * (y[:-4] + y[4:])
    peak = y[2:-2] - base
    beside = np.maximum(np.abs(y[1:-3] - base), np.abs(y[3:-1] - base))
    size = np.abs(peak)
    lone[2:-2] = (
        (size > _OUTLIER * _scale(peak)) & (beside < 0.25 * size) & (size > least)
    )
    return lone


def _jumps(y, least):
    """Find samples that lie a step from the one before that is no motion."""
    behind = np.zeros(y.size, dtype=bool)
    step = np.diff(y)
    # The next steps are left out: an interpolated jump takes two of them.
    near = [step[:-6], step[1:-5], step[2:-4], step[4:-2], step[5:-1], step[6:]]
    usual = np.median(near, axis=0)
    over = step[3:-3] - usual
    behind[4:-3] = (
        (np.abs(over) > _OUTLIER * _scale(over))
        & (np.abs(over) > least)
        & (np.abs(over) > 2.5 * np.abs(usual))
    )
    return behind


def _scale(x):
    """Robust standard deviation; the quantile keeps standstill from making it zero."""
    return max(
        np.median(np.abs(x)) / 0.6745,
        np.quantile(np.abs(x), 0.9) / 1.645,
        np.finfo(float).tiny,
    )
