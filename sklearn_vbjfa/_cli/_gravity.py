"""Gravity compensation: ``identify --for gravity`` and ``design --for gravity``."""

import json
from dataclasses import asdict

import numpy as np

from sklearn_vbjfa import load_identified
from sklearn_vbjfa._cli import _input
from sklearn_vbjfa._cli._parser import Refused, option_of, shell_line
from sklearn_vbjfa._cli._robot_files import ROBOT_FILES, write_robot
from sklearn_vbjfa._cli._run import Result, render_template
from sklearn_vbjfa.model import joint_names, load_model


def correct(arguments, folder):
    import pandas as pd

    from sklearn_vbjfa.gravity import correct_gravity

    unused = {"friction", "bodies", "known_mass", "effects", "no_search", "ranges"}
    unused |= {"gain"} if arguments.gain == "unknown" else set()
    if unused := dict.fromkeys(sorted(unused & set(arguments.typed))):
        names = ", ".join(map(option_of, unused))
        raise Refused(f"--for gravity finds only masses; leave out {names}", **unused)
    out = _input.output_folder(arguments, "report")
    recording, urdf, _ = _input.load(arguments, folder)
    with _input.naming_input(arguments):
        result = correct_gravity(recording, str(urdf))
    robot, enough = result.identifier, result.poses_enough
    words = ["--urdf", arguments.urdf, "--report", str(out), "--for", "gravity"]
    words += [] if enough is None else ["--poses", str(max(enough, 1))]
    loaded = result.gravity > 0
    failed = loaded & (result.error_after >= result.gravity)
    # Friction, if known, holds a joint whose gravity torque is smaller.
    held = np.maximum(result.gravity_before, result.gravity) < result.friction
    unchecked = failed & held & result.friction_known & (failed < loaded).any()
    failed &= ~unchecked
    friction = np.where(result.friction_known, "known", "assumed (one direction)")
    joints = pd.DataFrame(
        {
            "joint": robot.joint_names_,
            "gravity described": result.gravity_before,
            "gravity corrected": result.gravity,
            "interval": result.interval,
            "error described": result.error_before,
            "error corrected": result.error_after,
            "friction": np.where(loaded, friction, "no gravity torque"),
        }
    )
    data = {
        "purpose": "gravity",
        "samples": result.n_samples,
        # Unknown numbers become null.
        "joints": json.loads(joints.to_json(orient="records", double_precision=15)),
        "links": [asdict(link) for link in robot.mass_deviations_],
        "common_size": robot.common_size_,
        "payload": result.payload,
        "unchecked": joints["joint"][unchecked].tolist(),
        "poses_enough": enough,
        "command": shell_line("design", *words),
    }
    doubts = [x.message for x in result.findings if x.severity == "warning"]
    if not np.nansum(result.error_after**2) < np.nansum(result.error_before**2):
        doubts.append("held-out samples do not improve: use the description")
    if failed.any():
        names = ", ".join(joints["joint"][failed])
        doubts.append(f"error above the gravity torque: {names}")

    def write(folder, notes):
        report = data | {"warnings": [*notes, *write_robot(robot, folder)]}
        text = json.dumps(report, indent=1)
        folder.joinpath("report.json").write_text(text, encoding="utf-8")
        return []

    table = joints.to_string(index=False, float_format="{:.3g}".format)
    facts = data | {"recording": recording, "rows": table, "reasons": doubts}
    return Result(
        text=render_template("gravity.txt.j2", **facts),
        doubts=doubts,
        data=data,
        folder=out,
        files=("report.json", *ROBOT_FILES),
        write=write,
    )


def design_poses(arguments, folder):
    from sklearn_vbjfa.gravity import gravity_poses

    out = _input.expand(arguments.out or "poses.csv")
    _input.check_file(out, "--out", arguments.force)
    fitted, joints = None, arguments.joints
    if arguments.report:
        fitted = load_identified(_input.expand(arguments.report) / "identified.json")
        joints = fitted.joint_names_
    urdf, _ = _input.robot(arguments, joints, folder)
    n, seed = arguments.poses, arguments.seed
    q, hold = gravity_poses(str(urdf), n, fitted=fitted, random_state=seed)

    def write(folder, notes):
        names = [f"q_{name}" for name in joint_names(load_model(str(urdf)))]
        heads, table = ",".join([*names, "hold"]), np.c_[q, hold]
        np.savetxt(folder / out.name, table, "%.9g", ",", header=heads, comments="")
        return []

    return Result(
        text=f"Poses: {n}, each reached from both sides, with the seconds to stay "
        "there.\nMove slowly from one to the next, record q and tau, then: "
        + shell_line("identify", "LOG", "--urdf", arguments.urdf, "--for", "gravity"),
        folder=out.parent,
        files=(out.name,),
        write=write,
    )
