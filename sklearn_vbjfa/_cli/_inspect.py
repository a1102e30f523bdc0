"""The commands ``inspect`` and ``effects``."""

import sys

import numpy as np

from sklearn_vbjfa._cli import _input
from sklearn_vbjfa._cli._run import Done, wrapped

_TOO_SHORT = "too short to examine the motion"


def list_effects(arguments, folder):
    """List the library of effects."""
    from tabulate import tabulate

    from sklearn_vbjfa.effects import resolve

    rows = [
        [one.name, type(one).__doc__.splitlines()[0].rstrip("."), one.visible]
        for one in resolve("all")
    ]
    heads = ["name", "effect", "shows if the recording has"]
    return Done(text=tabulate(rows, headers=heads, maxcolwidths=[None, 46, 34]))


def inspect(arguments, folder):
    """Read a recording and describe it."""
    from sklearn_vbjfa.inspection import motion_of

    # A current is as good as a torque here: nothing is identified.
    loaded = _input.load(arguments, folder, assumed="unknown")
    loaded.signals(arguments.signals)
    recording, findings = loaded.recording, loaded.findings()
    motions = motion_of(recording, str(loaded.urdf))
    faults = _faults(recording, findings, arguments.drive)
    text = [
        *_properties(recording, loaded.other_joints()),
        "",
        *(_table(recording, motions) if motions else [_TOO_SHORT]),
        "",
        "Faults",
        *(faults or ["- none that the robot description shows"]),
        "",
        "Identifiable from this motion",
        *_by_joint(motions, "shows"),
        "Not identifiable from this motion, or poorly",
        *_by_joint(motions, "hides"),
    ]
    doubts = [] if motions else [_TOO_SHORT]
    data = {
        "samples": recording.n_samples,
        "dt": recording.dt,
        "joint_names": list(recording.joint_names),
        "recordings": list(map(str, recording.group_names)),
        "held": list(loaded.held),
        "faults": faults,
        "findings": [
            {"kind": one.kind, "severity": one.severity, "message": one.message}
            | {"joints": [int(j) for j in one.joints]}
            for one in findings
        ],
        "identifiable": {one.name: list(one.shows) for one in motions},
        "not_identifiable": {one.name: list(one.hides) for one in motions},
    }
    return Done(
        text="\n".join(text),
        data=data,
        doubts=[*doubts, *_input.channel_doubts(findings)],
    )


def _properties(recording, others):
    """Return lines on the recording; others: lines on joints without columns."""
    lengths = np.bincount(recording.groups) * recording.dt
    parts = [f"{x} {n:.4g} s" for x, n in zip(recording.group_names, lengths)]
    duration = f"{recording.n_samples * recording.dt:.4g} s"
    rate = f"{1 / recording.dt:.6g} Hz"
    lines = [
        str(recording),
        wrapped(f"{duration} at {rate}: {', '.join(parts)}", sys.stdout),
    ]
    if recording.signals:
        names = [name for name in recording.signals if name != "a"]
        lines.append(f"other columns: {', '.join(names) or 'none'}")
    if recording.torque_noise is not None:
        lines.append("rows were interpolated on a uniform grid")
    return [*lines, *others]


def _table(recording, motions):
    """Return the lines of a table with the motion of each joint."""
    from tabulate import tabulate

    rows = []
    for motion, unit in zip(motions, recording.torque_units):
        scale, name = (1e3, "mm") if motion.slides else (180 / np.pi, "deg")
        rows.append(
            [
                motion.name,
                f"{scale * motion.lowest:.4g} to {scale * motion.highest:.4g} {name}",
                f"{scale * motion.fastest:.3g} {name}/s",
                str(motion.reversals),
                f"{100 * motion.resting:.0f} %",
                f"{motion.torques[0]:.3g} to {motion.torques[1]:.3g} {unit}",
                f"{motion.loads[0]:.3g} to {motion.loads[1]:.3g} "
                f"{'N' if motion.slides else 'N m'}",
            ]
        )
    heads = ["joint", "position", "speed", "reversals", "at rest", "torque", "gravity"]
    align = ("left", *["right"] * (len(heads) - 1))
    table = tabulate(rows, headers=heads, disable_numparse=True, colalign=align)
    return table.splitlines()


def _faults(recording, findings, drive):
    """Return a line for each fault of the channels."""
    lines = [f"- {x.severity}: {x.message}" for x in findings]
    units = _input.motor_units(recording)
    if units and drive is None:
        unknown = ", or --gain unknown" if recording.nv > 1 else ""
        lines.append(
            f"- torques are recorded in {units[0]}: identify needs the factors to N m "
            f"(--gain){unknown}"
        )
    return lines


def _by_joint(motions, attribute):
    """Return a line for each effect of an attribute, with its joints."""
    joints = {}
    for motion in motions:
        for effect in getattr(motion, attribute):
            joints.setdefault(effect, []).append(motion.name)
    lines = []
    for effect, names in joints.items():
        every = len(names) == len(motions) > 1
        lines.append(f"- {'all joints' if every else ', '.join(names)}: {effect}")
    return lines or ["- nothing"]
