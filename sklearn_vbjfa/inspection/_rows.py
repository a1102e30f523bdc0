"""Channels that hold something else than they should, seen without a robot model."""

import numpy as np

from sklearn_vbjfa.recording import ChannelFinding, listed_joints
from sklearn_vbjfa.recording._faults import runs

# Torques below this are none [N m or N].
_NOTHING = 1e-9
# A stop of a joint within one sample takes this many times its usual acceleration and
# lasts this many samples; all of them are this share of the recording.
_SUDDEN, _LEAST_STOP, _STUCK_SHARE = 3.5, 10, 0.03
_USUAL = 0.99
# A torque that is a derivative of the position agrees with it to this share.
_SAME = 0.02


def unlike_channels(names, q, tau, dt, parts):
    """Find copies of channels, encoders that stop, and torques that are speeds."""
    findings = _copies(names, q, "position") + _copies(names, tau, "torque")
    findings += _never_written(names, tau)
    for j in range(len(names)):
        findings += _stuck_encoder(names, j, q, dt, parts)
    return findings + _derivatives(names, q, tau, dt, parts)


def _copies(names, values, kind):
    """Find channels that equal another one in every row."""
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
    empty = tuple(np.flatnonzero((size > 0) & (size < _NOTHING)).tolist())
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
    fast = max(_SUDDEN * np.quantile(change, _USUAL), 0.5 * np.median(speed))
    found = []
    for part in parts:
        step = np.abs(np.diff(q[part, j]))
        for first, last in zip(*runs(step == 0)):
            around = np.r_[step[max(first - 2, 0) : first], step[last + 1 : last + 3]]
            if last - first > _LEAST_STOP and around.max(initial=0.0) > fast:
                found.append((part.start + first, last - first + 2))
    rows = sum(length for _, length in found)
    if rows < _STUCK_SHARE * len(q):
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
    if not moves.any() or (left[moves] > _SAME).any():
        return []
    every = tuple(range(len(names)))
    message = (
        "The torques are the velocities of the joints to "
        f"{100 * left[moves].max():.1g} %: the wrong columns were taken. Give those of "
        "the torques (--columns)."
    )
    return [ChannelFinding("velocity_as_torque", every, "error", message)]
