"""Gravity compensation: ``identify --for gravity`` and ``design --for gravity``."""

import json
import shlex

import numpy as np

from sklearn_vbjfa._cli import _input
from sklearn_vbjfa._cli._robot_files import ROBOT_FILES, write_robot
from sklearn_vbjfa._cli._run import Done
from sklearn_vbjfa.robot._channels import HALF_WIDTH


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
    columns = {
        "joint": found.identifier.joint_names_,
        "friction_known": found.friction_known,
        "gravity": found.gravity,
        "described": found.error_before,
        "corrected": found.error_after,
        "interval": found.interval,
        "interval_after_next": found.next_interval,
    }
    # Numbers that are not known are null in JSON.
    columns = {
        k: [x if x == x else None for x in np.asarray(v).tolist()]
        for k, v in columns.items()
    }
    links = [
        {"links": one.bodies, "factors": one.factors, "stds": one.stds}
        for one in found.identifier.mass_deviations_
    ]
    return {
        "purpose": "gravity",
        "samples": found.samples.n_samples,
        "joints": [dict(zip(columns, row)) for row in zip(*columns.values())],
        "links": links,
        "payload": found.payload,
        "next_poses": found.next_poses.tolist(),
    }


def _lines(data):
    """Return the lines of the report."""
    from tabulate import tabulate

    rows = []
    for one in data["joints"]:
        known = "known" if one["friction_known"] else "assumed (one direction)"
        row = [one["joint"], one["described"], one["corrected"], one["interval"], known]
        rows.append(row if one["gravity"] else [one["joint"], "no gravity torque"])
    heads = ["joint", "described", "corrected", "90 % interval, ±", "friction"]
    lines = [
        f"Gravity torque from {data['samples']} poses and stretches of slow motion: "
        "errors at held-out samples [N m or N].",
        *tabulate(rows, heads, tablefmt="plain", floatfmt=".3g").splitlines(),
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
    widest = max(data["joints"], key=lambda one: one["interval"] or 0.0)
    return [
        *lines,
        f"Next: {len(data['next_poses'])} more poses (next_poses in report.json) "
        f"reduce the 90 % interval of {widest['joint']} from ±{widest['interval']:.2g} "
        f"to ±{widest['interval_after_next']:.2g}.",
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
