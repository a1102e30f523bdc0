"""The command ``design``: an exciting motion to record next."""

import argparse
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import numpy as np

from sklearn_vbjfa import load_identified
from sklearn_vbjfa._cli import _gravity, _input
from sklearn_vbjfa._cli._parser import command_line, option_of
from sklearn_vbjfa._cli._run import Result, render_template
from sklearn_vbjfa._core._runtime import say
from sklearn_vbjfa.design import (
    KnownRobot,
    MotionLimits,
    _summary,
    design_motion,
    read_report,
)

# Options of identify that describe the robot, also for its next recording.
_OPTIONS = ("joints", "base_orientation", "gain", "known_mass", "drive", "friction")

# `KnownRobot` to move; model with its limits; description file, as given or named by a
# report; further joints that are held fixed; sample period.
_Robot = namedtuple("_Robot", "known model file held dt")


def design(arguments, folder):
    if arguments.purpose == "gravity":
        return _gravity.design_poses(arguments, folder)
    if arguments.urdf is None and arguments.report is None:
        raise ValueError(
            "give --urdf FILE (robot description) or --report FOLDER (output of "
            "identify)."
        )
    out = _input.expand(arguments.out or "motion.csv")
    _input.check_file(out, "--out", arguments.force)
    report = {}
    if arguments.report:
        report = read_report(_input.expand(arguments.report))
        robot = _identified(arguments, report, folder)
    else:
        urdf, held = _input.robot(arguments, arguments.joints, folder)
        file = _input.expand(arguments.urdf)
        known = replace(KnownRobot.of(str(urdf)), description=str(file))
        robot = _Robot(known, known.features.model_, str(file), held, 0.01)
    motion = _motion(arguments, robot, report)
    measured = all(0 < x < np.inf for x in robot.known.torque_noise)
    facts = _summary.facts(motion, report)

    def write(folder, notes):
        motion.to_csv(folder / out.name)
        options = report.get("provenance", {}).get("options", {})
        command = _next_command(arguments, robot, options)
        steps = {"out": out, "drive": options.get("drive"), "command": command}
        return [render_template("next_motion.txt.j2", **steps, **facts)]

    facts |= {"robot": Path(robot.file).name, "motion": motion, "measured": measured}
    return Result(
        text=render_template("motion.txt.j2", **facts),
        doubts=_summary.doubts(motion, facts, arguments.effects or ()),
        folder=out.parent,
        files=(out.name,),
        write=write,
    )


def _motion(arguments, robot, report):
    say(f"designing {arguments.duration:g} s for {len(robot.known.joint_names)} joints")
    motion = design_motion(
        robot.known,
        duration=arguments.duration,
        dt=arguments.dt or robot.dt,
        limits=MotionLimits.of(
            robot.model,
            velocity=arguments.velocity,
            acceleration=arguments.acceleration,
            torque=arguments.torque,
        ),
        effects=arguments.effects or (),
        report=report or None,
        random_state=arguments.seed,
    )
    if not motion.within_limits:
        raise ValueError(
            f"no motion within the limits was found: {_summary.exceeded(motion)}; "
            "give a longer --duration or another --seed."
        )
    return motion


def _identified(arguments, data, folder):
    for name in {"urdf", "joints", "base_orientation"} & set(arguments.typed):
        raise ValueError(f"{option_of(name)} is taken from the report; leave it out.")
    report = _input.expand(arguments.report)
    path = (report if report.is_dir() else report.parent) / "identified.json"
    robot = load_identified(path)
    provenance, model = data.get("provenance", {}), robot.features_.nominal_
    file = provenance.get("description") or str(path)
    description = folder / "described.urdf"
    description.write_text(robot.description_, encoding="utf-8")
    if file != str(path) and Path(file).is_file():
        # Mesh paths are relative to the description file.
        description = Path(file)
    if robot.gains_ is not None and not robot.gains_.absolute:
        if arguments.acceleration is arguments.torque is None:
            raise ValueError(
                "torque gains are relative, so the torque limits of the description do "
                "not apply; give --acceleration, or --torque as readings over gains."
            )
        model = model.copy()
        model.effortLimit = np.full(model.nv, np.inf)
    known = replace(KnownRobot.of(robot), description=str(description))
    return _Robot(known, model, file, provenance.get("held"), robot.dt)


def _next_command(arguments, robot, options):
    # options: those of the run that wrote the report.
    typed = {name: options[name] for name in _OPTIONS if name in options}
    typed |= {x: arguments.typed[x] for x in _OPTIONS[:2] if x in arguments.typed}
    if robot.held:
        typed["joints"] = ",".join(robot.known.joint_names)
    typed["urdf"] = "ROBOT.urdf" if robot.file.endswith(".json") else robot.file
    words = argparse.Namespace(
        command="identify", recording=["recording.csv"], typed=typed
    )
    return command_line(words, {})
