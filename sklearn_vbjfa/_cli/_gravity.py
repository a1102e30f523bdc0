"""Gravity compensation: ``identify --for gravity`` and ``design --for gravity``."""

import json
import math
import shlex

import numpy as np

from sklearn_vbjfa import load_identified
from sklearn_vbjfa._cli import _input
from sklearn_vbjfa._cli._robot_files import ROBOT_FILES, write_robot
from sklearn_vbjfa._cli._run import Done
from sklearn_vbjfa.model import joint_names, load_model
from sklearn_vbjfa.robot._channels import HALF_WIDTH

# Joints in the report: its columns, and fields of `GravityCorrection`.
_COLUMNS = {
    "described": "error_before",
    "corrected": "error_after",
    "interval": "interval",
    "gravity": "gravity",
    "friction_known": "friction_known",
}
# Poses that the next command asks for where it is open how many are enough.
_MORE = 20


def correct(arguments, folder):
    """Correct the masses of a description by poses, and write the files."""
    from sklearn_vbjfa.gravity import correct_gravity

    out = _input.output_folder(arguments, "report")
    loaded = _input.load(arguments, folder)
    with _input.blaming(loaded.source, loaded.gains):
        found = correct_gravity(loaded.recording, str(loaded.urdf))
    words = ["--urdf", arguments.urdf, "--report", str(out), "--for", "gravity"]
    words += ["--poses", str(found.poses_enough or _MORE)]
    data = _data(found)
    data["command"] = shlex.join(["python", "-m", "sklearn_vbjfa", "design", *words])

    def write(folder, notes):
        lacking = write_robot(found.identifier, folder)
        text = json.dumps(data | {"warnings": [*notes, *lacking]}, indent=1)
        folder.joinpath("report.json").write_text(text, encoding="utf-8")
        return []

    doubts = ["the correction does not improve held-out samples: use the description"]
    return Done(
        text="\n".join([str(loaded.recording), *_lines(data)]),
        doubts=[] if found.improves else doubts,
        data=data,
        folder=out,
        files=("report.json", *ROBOT_FILES),
        write=write,
    )


def _data(found):
    """Return the report as data; numbers that are not known are None."""
    columns = {key: getattr(found, name).tolist() for key, name in _COLUMNS.items()}
    joints = [
        {
            "joint": name,
            **{k: None if math.isnan(x[j]) else x[j] for k, x in columns.items()},
        }
        for j, name in enumerate(found.identifier.joint_names_)
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
        "poses_enough": found.poses_enough,
    }


def _lines(data):
    """Return the lines of the report."""
    from tabulate import tabulate

    rows = []
    for one in data["joints"]:
        row = [one[x] for x in ("described", "corrected", "interval")]
        row = ["unknown" if x is None else f"{x:.3g}" for x in row]
        row.append("known" if one["friction_known"] else "assumed (one direction)")
        rows.append([one["joint"], *(row if one["gravity"] else ["no gravity torque"])])
    heads = ["joint", "described", "corrected", "90 % interval, ±", "friction"]
    lines = [
        f"Gravity torque from {data['samples']} poses and windows of slow motion: "
        "errors at held-out samples [N m or N].",
        *tabulate(rows, heads, tablefmt="plain", disable_numparse=True).splitlines(),
    ]
    for one in data["links"]:
        masses = " or ".join(
            f"{link} {factor:.2f} ± {HALF_WIDTH * std:.2f}"
            for link, factor, std in zip(one["links"], one["factors"], one["stds"])
        )
        lines.append(f"Mass (identified / described), link of joint: {masses}")
    if data["payload"] is not None:
        mass, std = data["payload"]
        lines.append(
            "Alternative: the description is right and the last link carries "
            f"{mass:.3g} ± {HALF_WIDTH * std:.2g} kg more."
        )
    more = data["poses_enough"]
    return [
        *lines,
        "Use for: gravity compensation. Not for: feedforward and simulation (inertias "
        "follow the masses).",
        "These poses are enough: no interval exceeds the noise of one pose."
        if more == 0
        else f"{more or 'More than 100'} more poses are enough (intervals within the "
        f"noise of one pose). The best: {data['command']}",
    ]


def design_poses(arguments, folder):
    """Choose poses for gravity compensation, and write them in their order."""
    from sklearn_vbjfa.gravity import gravity_poses

    if arguments.urdf is None:
        raise ValueError("--for gravity needs --urdf FILE, the robot description.")
    out = _input.expanded(arguments.out or "poses.csv")
    _input.check_file(out, "--out", arguments.force)
    fitted, joints = None, arguments.joints
    if arguments.report:
        fitted = load_identified(_input.expanded(arguments.report) / "identified.json")
        joints = fitted.joint_names_
    urdf, _ = _input.robot(arguments, _input.expanded(arguments.urdf), joints, folder)
    n, seed = arguments.poses, arguments.seed
    q, hold = gravity_poses(str(urdf), n, fitted=fitted, random_state=seed)
    names = [f"q_{name}" for name in joint_names(load_model(str(urdf)))]

    def write(folder, notes):
        heads, table = ",".join([*names, "hold"]), np.c_[q, hold]
        np.savetxt(folder / out.name, table, "%.9g", ",", header=heads, comments="")
        return []

    words = ["identify", "LOG", "--urdf", arguments.urdf, "--for", "gravity"]
    return Done(
        text=f"{n} poses, each reached from both sides: way points and the seconds to "
        "stay there.\nMove slowly from one to the next, record q and tau, then: "
        + shlex.join(["python", "-m", "sklearn_vbjfa", *words]),
        folder=out.parent,
        files=(out.name,),
        write=write,
    )
