"""Gravity compensation: ``identify --for gravity`` and ``design --for gravity``."""

import json
import shlex

import numpy as np

from sklearn_vbjfa._cli import _input
from sklearn_vbjfa._cli._robot_files import ROBOT_FILES, write_robot
from sklearn_vbjfa._cli._run import Done


def correct(arguments, folder):
    """Correct the masses of a description by poses, and write the files."""
    from sklearn_vbjfa.gravity import correct_gravity

    out = _input.output_folder(arguments, "report")
    loaded = _input.load(arguments, folder)
    with _input.blaming(loaded.source, loaded.gains):
        found = correct_gravity(loaded.recording, str(loaded.urdf))
    data = _data(found)

    def write(folder, notes):
        lacking = write_robot(found.identifier, folder)
        text = json.dumps(data | {"warnings": [*notes, *lacking]}, indent=1)
        folder.joinpath("report.json").write_text(text, encoding="utf-8")
        return []

    worse = np.nansum(found.error_after**2) >= np.nansum(found.error_before**2)
    doubts = ["the correction does not improve held-out poses: use the description"]
    return Done(
        text="\n".join([str(loaded.recording), *_lines(data)]),
        doubts=doubts if worse else [],
        data=data,
        folder=out,
        files=("report.json", *ROBOT_FILES),
        write=write,
    )


def _data(found):
    """Return the report as data."""
    rows = zip(
        found.error_before, found.error_after, found.interval, found.next_interval[-1]
    )
    keys = ("described", "corrected", "interval", "interval_after_next")
    rows = (np.where(np.isfinite(row), row, None).tolist() for row in rows)
    named = zip(found.identifier.joint_names_, found.friction_known, found.gravity)
    joints = [
        {"joint": name, "friction_known": bool(known), "gravity": float(size)}
        | dict(zip(keys, row))
        for (name, known, size), row in zip(named, rows)
    ]
    links = [
        {"links": one.bodies, "factors": one.factors, "stds": one.stds}
        for one in found.identifier.mass_deviations_
    ]
    return {
        "purpose": "gravity",
        "samples": found.samples.n_samples,
        "joints": joints,
        "links": links,
        "payload": found.payload,
        "next_poses": found.next_poses.tolist(),
    }


def _lines(data):
    """Return the lines of the report."""
    lines = [
        f"Gravity torque from {data['samples']} poses and stretches of slow motion.",
        "Errors of the torque at held-out samples [N m or N], 90 % intervals of the "
        "gravity torque:",
        f"  {'joint':20} described  corrected  interval  friction",
    ]
    for one in data["joints"]:
        numbers = (one[key] for key in ("described", "corrected", "interval"))
        cells = ["-" if x is None else f"{x:.3g}" for x in numbers]
        known = "known" if one["friction_known"] else "assumed (one direction)"
        said = f"{cells[0]:>9}  {cells[1]:>9}  ±{cells[2]:>7}  {known}"
        lines.append(
            f"  {one['joint']:20} {said if one['gravity'] else 'no gravity torque'}"
        )
    for one in data["links"]:
        masses = " or ".join(
            f"{link} {factor:.2f} ± {std:.2f}"
            for link, factor, std in zip(one["links"], one["factors"], one["stds"])
        )
        lines.append(f"Mass over the described mass, link of joint: {masses}")
    if data["payload"] is not None:
        mass, std = data["payload"]
        lines.append(
            "Alternative: the description is right and the last link carries "
            f"{mass:.3g} ± {std:.2g} kg more."
        )
    widest = max(data["joints"], key=lambda one: one["interval"] or 0.0)
    return [
        *lines,
        f"Next: {len(data['next_poses'])} more poses narrow the interval of "
        f"{widest['joint']} from ±{widest['interval']:.2g} to "
        f"±{widest['interval_after_next']:.2g}; next_poses in report.json lists them.",
        "Use for: gravity compensation. Not for: feedforward and simulation (inertias "
        "follow the masses, friction in motion is not identified).",
    ]


def design_poses(arguments, folder):
    """Choose poses for gravity compensation, and write them in their order."""
    import pandas as pd

    from sklearn_vbjfa.gravity import gravity_poses
    from sklearn_vbjfa.model import joint_names, load_model

    if arguments.urdf is None:
        raise ValueError("--for gravity needs --urdf FILE, the robot description.")
    out = _input.expanded(arguments.out or "poses.csv")
    _input.check_file(out, "--out", arguments.force)
    described = _input.expanded(arguments.urdf)
    urdf, _ = _input.robot(arguments, described, arguments.joints, folder)
    q, hold = gravity_poses(str(urdf), arguments.poses, random_state=arguments.seed)
    names = [f"q_{name}" for name in joint_names(load_model(str(urdf)))]
    table = pd.DataFrame(q, columns=names).assign(hold=hold)

    def write(folder, notes):
        table.to_csv(folder / out.name, index=False)
        return []

    command = ["identify", "LOG", "--urdf", arguments.urdf, "--for", "gravity"]
    return Done(
        text=f"{arguments.poses} poses, each reached from both sides: way points and "
        "the seconds to stay there.\nMove slowly from one to the next, record q and "
        f"tau, then: {shlex.join(['python', '-m', 'sklearn_vbjfa', *command])}",
        folder=out.parent,
        files=(out.name,),
        write=write,
    )
