"""The command ``identify``: identification and search for missing effects."""

import json
import shutil
import time
import warnings
from dataclasses import replace

import numpy as np

from sklearn_vbjfa._cli import _gravity, _input
from sklearn_vbjfa._cli._parser import Refused, shell_line, with_options
from sklearn_vbjfa._cli._robot_files import ROBOT_FILES, write_robot
from sklearn_vbjfa._cli._run import Result
from sklearn_vbjfa.design._motion import known_limits
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import OfferedSignals

# Report as page and data, and files of the robot.
_FILES = ("report.html", "report.json", *ROBOT_FILES)


def identify(arguments, folder):
    """Identify a robot from a recording, search for effects, and write the files."""
    if arguments.purpose == "gravity":
        return _gravity.correct(arguments, folder)
    from sklearn_vbjfa.diagnosis import Report
    from sklearn_vbjfa.diagnosis.report import SECONDS

    if arguments.no_search and arguments.effects:
        raise Refused("--no-search and --effects exclude each other", effects=None)
    effects = () if arguments.no_search else arguments.effects
    effects = "all" if effects is None else effects
    out = _input.output_folder(arguments, "report")
    ranges = arguments.ranges and _input.expand(arguments.ranges)
    if ranges:
        _input.check_file(ranges, "--ranges", arguments.force)
    settings = _input.settings(arguments)
    recording, urdf, locked = _input.load(arguments, folder)
    with _input.naming_input(arguments):
        loop = discover(recording, str(urdf), effects=effects, **settings)
    robot = folder / "robot"
    incomplete, export = _write_robot(loop.identifier_, robot)
    outcome = loop.report_.outcome
    provenance = _provenance(arguments, robot) | {"export": export, "held": locked}
    if loop.report_.has_open_questions:
        words = ["--report", str(out), "--duration", str(SECONDS)]
        words += _limits(loop.identifier_, recording)
        provenance["command"] = shell_line("design", *words)
    channels = [
        replace(finding, message=with_options(finding.message))
        for finding in outcome.findings["channels"]
    ]
    outcome = replace(
        outcome,
        provenance=outcome.provenance | provenance,
        findings=outcome.findings | {"channels": channels},
    )
    printed = Report(outcome)

    def write(folder, notes):
        shutil.copytree(robot, folder, dirs_exist_ok=True)
        shown = {finding.message for finding in channels}
        notes = [x for x in map(with_options, notes) if x not in shown]
        extra = {"warnings": (*notes, *incomplete)}
        report = Report(replace(outcome, provenance=outcome.provenance | extra))
        text = json.dumps(report.to_dict(), indent=1, allow_nan=False)
        folder.joinpath("report.html").write_text(report.to_html(), encoding="utf-8")
        folder.joinpath("report.json").write_text(text, encoding="utf-8")
        command, lines = provenance.get("command"), []
        if command:
            hint = ", limits as recorded where the description has none, or lower ones"
            lines.append(f"Next motion{hint * ('--torque' in command)}: {command}")
        if incomplete:
            names = " and ".join(line.partition(" ")[0] for line in incomplete)
            lines.append(
                f"{names}: not complete, see the first lines; identified.json is"
            )
        if ranges:
            ranges.parent.mkdir(parents=True, exist_ok=True)
            loop.identifier_.ranges().save(ranges)
            lines.append(f"ranges for domain randomisation: {ranges}")
        return lines

    # With --joints the user excludes the other joints on purpose.
    others = [] if arguments.joints else _input.other_joints(urdf, locked)
    return Result(
        text="\n".join([str(recording), *others, str(printed)]),
        doubts=printed.warnings,
        data="report.json",
        folder=out,
        files=_FILES,
        write=write,
        page=True,
    )


def _write_robot(robot, folder):
    """Write the files of a robot; return incomplete ones, and warnings on them."""
    folder.mkdir()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        incomplete = write_robot(robot, folder)
    for warning in caught:
        warnings.warn(warning.message, stacklevel=3)
    doubts = (x.message for x in caught if issubclass(x.category, DoubtWarning))
    return incomplete, tuple(map(str, doubts))


def _provenance(arguments, robot):
    """Return the files, the options and the date of an identification, a dict."""
    files = tuple(dict.fromkeys(map(str, _input.paths(arguments))))
    return {
        "file": files[0] if len(files) == 1 else files,
        "description": str(_input.expand(arguments.urdf)),
        "options": dict(arguments.typed),
        "files": ("report.json", *(x for x in ROBOT_FILES if (robot / x).exists())),
        "date": time.strftime("%Y-%m-%d"),
    }


def _limits(robot, recording):
    """Yield options with recorded limits, for those that the description lacks."""
    model, gains = robot.features_.nominal_, robot.gains_
    steps = np.abs(np.diff(recording.q, axis=0)) / recording.dt
    # Jumps between recordings are few, and above the quantile.
    # A design limits torques, not the readings of their channels.
    signals = steps, recording.tau / robot.features_.gains_
    speed, torque = (np.quantile(np.abs(x), 0.99, axis=0) for x in signals)
    effort = known_limits(model.effortLimit)
    placeholder = (effort < torque) | (gains is not None and not gains.absolute)
    effort = np.where(placeholder, np.inf, effort)
    pair = known_limits(model.velocityLimit), speed
    for name, (limit, peak) in {"velocity": pair, "torque": (effort, torque)}.items():
        if np.isinf(limit).any():
            peak = np.where(peak > 0, peak, peak.max())
            values = np.where(np.isinf(limit), peak, limit)
            yield from (f"--{name}", ",".join(f"{x:.3g}" for x in values))


def identify_demo(arguments, folder):
    from sklearn_vbjfa.datasets import load_demo_recording

    # Logs do not contain exact states.
    recording = replace(load_demo_recording(), states=None)
    loop = discover(recording, recording.urdf)
    return Result(text=f"{recording}\n{loop.report_}", doubts=loop.report_.warnings)


def discover(recording, urdf, *, effects="all", options=None, **settings):
    from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
    from sklearn_vbjfa.fit import FitOptions

    identifier = RobotIdentifier(
        urdf,
        dt=recording.dt,
        options=replace(options or FitOptions(), torque_noise=recording.torque_noise),
        n_jobs=-1,
        **settings,
    )
    return EffectDiscovery(identifier, effects=effects).fit_recording(
        recording, OfferedSignals.from_recording(recording)
    )
