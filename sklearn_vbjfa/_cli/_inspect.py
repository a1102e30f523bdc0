"""The commands ``inspect`` and ``effects``."""

import sys

import numpy as np

from sklearn_vbjfa._cli import _input
from sklearn_vbjfa._cli._run import Done, wrapped

_TOO_SHORT = "too short for a look at the motion"


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


# -- a recording described -------------------------------------------------------------


def inspect(arguments, folder):
    """Read a recording and describe it."""
    from sklearn_vbjfa.inspection import motion_of

    # A current is as good as a torque here: nothing is identified.
    loaded = _input.load(arguments, folder, assumed="unknown")
    loaded.signals(arguments.signals)
    recording, findings = loaded.recording, loaded.findings()
    motions = motion_of(recording, str(loaded.urdf))
    text = [
        *_what(recording, loaded.other_joints()),
        "",
        *_table(recording, motions),
        "",
        *_wrong(recording, findings, arguments.drive),
        "",
        *_shown(motions),
    ]
    doubts = [*([] if motions else [_TOO_SHORT]), *_input.channel_doubts(findings)]
    return Done(text="\n".join(text), doubts=doubts)


def _what(recording, others):
    """Say what the data are; others : lines on joints without columns."""
    lengths = np.bincount(recording.groups) * recording.dt
    listed = [
        f"{name} {length:.4g} s" for name, length in zip(recording.group_names, lengths)
    ]
    lines = [
        str(recording),
        wrapped(
            f"{recording.n_samples * recording.dt:.4g} s at {1 / recording.dt:.6g} Hz: "
            f"{', '.join(listed)}",
            sys.stdout,
        ),
    ]
    if recording.signals:
        names = [name for name in recording.signals if name != "a"]
        lines.append(f"signals beside the motion: {', '.join(names) or 'none'}")
    if recording.torque_noise is not None:
        lines.append("rows were interpolated on a uniform grid")
    return [*lines, *others]


def _table(recording, motions):
    """Tabulate what each joint does."""
    from tabulate import tabulate

    if not motions:
        return [_TOO_SHORT]
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
    heads = ["joint", "position", "speed", "reversals", "at rest", "torque"]
    table = tabulate(
        rows,
        headers=[*heads, "of it gravity"],
        disable_numparse=True,
        colalign=("left", *6 * ["right"]),
    )
    return table.splitlines()


def _wrong(recording, findings, drive):
    """Say what is wrong with the channels."""
    odd = [unit for unit in recording.torque_units if unit not in ("N m", "N")]
    lines = ["What is wrong with it"]
    lines += [f"- {x.severity}: {x.message}" for x in findings]
    if odd and drive is None:
        lines.append(
            f"- torques are recorded in {odd[0]}: close-loop needs the factors to N m "
            f"(--gain){', or --gain unknown' if recording.nv > 1 else ''}"
        )
    return lines if len(lines) > 1 else [*lines, "- nothing that the robot would show"]


def _shown(motions):
    """Say what the motion can show and what it cannot, joints with the same in one."""
    lines = []
    for head, of in (
        ("What it can show", lambda motion: motion.shows),
        ("What it can hardly show, or not at all", lambda motion: motion.hides),
    ):
        joints = {}
        for motion in motions:
            for what in of(motion):
                joints.setdefault(what, []).append(motion.name)
        lines.append(head)
        for what, names in joints.items():
            every = len(names) == len(motions) > 1
            lines.append(f"- {'all joints' if every else ', '.join(names)}: {what}")
        if not joints:
            lines.append("- nothing")
    return lines
