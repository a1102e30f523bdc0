"""The commands ``inspect``, ``effects`` and ``datasets``."""

import re

import numpy as np
from tabulate import tabulate

from sklearn_vbjfa._cli import _input
from sklearn_vbjfa._cli._parser import with_options
from sklearn_vbjfa._cli._run import Result, render_template
from sklearn_vbjfa.datasets import SETS
from sklearn_vbjfa.effects import resolve
from sklearn_vbjfa.inspection import motion_of

_TOO_SHORT = "too short to examine the motion"


def list_effects(arguments, folder):
    # Citation marks are removed.
    titles = [re.sub(r" ?\[\d+\]_", "", type(x).__doc__) for x in resolve("all")]
    titles = [text.splitlines()[0].rstrip(".") for text in titles]
    rows = [[x.name, text, x.record] for x, text in zip(resolve("all"), titles)]
    heads = ["name", "effect", "what to record"]
    return Result(text=tabulate(rows, headers=heads, maxcolwidths=[None, 46, 34]))


def list_datasets(arguments, folder):
    heads = ["function of sklearn_vbjfa.datasets", "content", "joints", "licence"]
    rows = [
        [
            f"fetch_{name}",
            entry["text"].split("\n")[0].removeprefix("Load ").rstrip("."),
            len(entry["joint_names"]),
            entry["licence"],
        ]
        for name, entry in SETS.items()
    ]
    return Result(text=tabulate(rows, headers=heads, maxcolwidths=[None, 30, None, 14]))


def inspect(arguments, folder):
    # Currents suffice, since nothing is identified.
    recording, urdf, locked = _input.load(arguments, folder, assumed="unknown")
    findings = _input.findings(arguments, recording, urdf, arguments.gain)
    motions = motion_of(recording, str(urdf))
    faults = [f"{x.severity}: {with_options(x.message)}" for x in findings]
    units = _input.motor_units(recording)
    if units and arguments.drive is None:
        unknown = ", or --gain unknown" if recording.nv > 1 else ""
        faults.append(
            f"torques are recorded in {units[0]}: identify needs the factors to N m "
            f"(--gain){unknown}"
        )
    names, lengths = recording.group_names, np.bincount(recording.groups) * recording.dt
    text = render_template(
        "inspection.txt.j2",
        recording=recording,
        duration=f"{sum(lengths):.4g} s at {1 / recording.dt:.6g} Hz",
        parts=[f"{x} {s:.4g} s" for x, s in zip(names, lengths)] * (len(names) > 1),
        others=_input.other_joints(urdf, locked),
        motion=_columns(motions, recording.torque_units),
        too_short=_TOO_SHORT,
        faults=faults,
        shows=_by_joint(motions, "shows"),
        hides=_by_joint(motions, "hides"),
    )
    data = {
        "samples": recording.n_samples,
        "dt": recording.dt,
        "joint_names": list(recording.joint_names),
        "recordings": list(map(str, names)),
        "held": list(locked),
        "faults": faults,
        "identifiable": {joint.name: list(joint.shows) for joint in motions},
        "not_identifiable": {joint.name: list(joint.hides) for joint in motions},
    }
    doubts = [x.message for x in findings if x.severity != "note"]
    return Result(text=text, data=data, doubts=[_TOO_SHORT] * (not motions) + doubts)


def _columns(motions, units):
    columns = {}
    for motion, unit in zip(motions, units):
        scale, name = (1e3, "mm") if motion.slides else (180 / np.pi, "deg")
        low, high = scale * motion.lowest, scale * motion.highest
        for head, cell in {
            "joint": motion.name,
            "position": f"{low:.4g} to {high:.4g} {name}",
            "speed": f"{scale * motion.fastest:.3g} {name}/s",
            "reversals": str(motion.reversals),
            "at rest": f"{100 * motion.resting:.0f} %",
            "torque": f"{motion.torques[0]:.3g} to {motion.torques[1]:.3g} {unit}",
        }.items():
            columns.setdefault(head, []).append(cell)
    return columns


def _by_joint(motions, attribute):
    joints = {}
    for motion in motions:
        for effect in getattr(motion, attribute):
            joints.setdefault(effect, []).append(motion.name)
    n_joints = len(motions) if len(motions) > 1 else None
    return [
        f"{'all joints' if len(names) == n_joints else ', '.join(names)}: {effect}"
        for effect, names in joints.items()
    ]
