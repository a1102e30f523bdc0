"""The command ``identify``: the robot, effects missing from its model, the files."""

import json
import shlex
import time
from dataclasses import replace

from sklearn_vbjfa._cli import _gravity, _input
from sklearn_vbjfa._cli._parser import Refused
from sklearn_vbjfa._cli._robot_files import ROBOT_FILES, write_robot
from sklearn_vbjfa._cli._run import Done

# The report as a page and as data, and the robot.
_FILES = ("report.html", "report.json", *ROBOT_FILES)


def identify(arguments, folder):
    """Identify a robot from a recording, search for effects, and write the files."""
    if arguments.purpose == "gravity":
        return _gravity.correct(arguments, folder)
    from sklearn_vbjfa.diagnosis import Report

    library = "all" if arguments.effects is None else arguments.effects
    if arguments.no_search and arguments.effects:
        raise Refused(
            "--no-search leaves out --effects; give one of them", effects=None
        )
    out = _input.output_folder(arguments, "report")
    ranges = arguments.ranges and _input.expanded(arguments.ranges)
    if ranges:
        _input.check_file(ranges, "--ranges", arguments.force)
    settings = _input.settings(arguments)
    loaded = _input.load(arguments, folder)
    signals = loaded.signals(arguments.signals)
    files = tuple(dict.fromkeys(map(str, _input.paths(arguments))))
    with _input.blaming(loaded.source, loaded.gains):
        loop = search(
            loaded.recording,
            str(loaded.urdf),
            effects=() if arguments.no_search else library,
            signals=signals,
            several=_input.is_several(arguments),
            **settings,
        )

    def write(folder, notes):
        lacking = write_robot(loop.identifier_, folder)
        outcome, more = loop.report_.outcome, {}
        if loop.report_.has_open_questions:
            words = ["python", "-m", "sklearn_vbjfa", "design", "--report", str(out)]
            more["command"] = shlex.join(words)
        more |= {
            "file": files[0] if len(files) == 1 else files,
            "description": str(_input.expanded(arguments.urdf)),
            "held": loaded.held,
            "warnings": (*notes, *lacking),
            "files": _FILES[1:],
            "date": time.strftime("%Y-%m-%d"),
        }
        provenance = outcome.provenance | more
        report = Report(replace(outcome, provenance=provenance))
        text = json.dumps(report.to_dict(), indent=1, allow_nan=False)
        folder.joinpath("report.html").write_text(report.to_html(), encoding="utf-8")
        folder.joinpath("report.json").write_text(text, encoding="utf-8")
        lines = [f"The motion for it: {more['command']}"] if "command" in more else []
        if lacking:
            lines.append("only identified.json has every effect (page)")
        if ranges:
            loop.identifier_.ranges().save(ranges)
            lines.append(f"ranges for domain randomisation: {ranges}")
        return lines

    # Joints that are named by the user leave the others out on purpose.
    others = [] if arguments.joints else loaded.other_joints()
    return Done(
        text="\n".join([str(loaded.recording), *others, str(loop.report_)]),
        doubts=loop.report_.warnings,
        data="report.json",
        folder=out,
        files=_FILES,
        write=write,
        page=True,
    )


def identify_demo(arguments, folder):
    """Identify the robot of the recording that comes with the package."""
    from sklearn_vbjfa.datasets import load_demo_recording

    recording = load_demo_recording()
    loop = search(recording, recording.urdf)
    return Done(text=f"{recording}\n{loop.report_}", doubts=loop.report_.warnings)


def search(
    recording,
    urdf,
    *,
    effects="all",
    signals=None,
    several=False,
    options=None,
    **settings,
):
    """Return the `EffectDiscovery` of a recording, fitted."""
    # several: whether recordings have names, which the report uses.
    from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
    from sklearn_vbjfa.fit import FitOptions

    identifier = RobotIdentifier(
        urdf,
        dt=recording.dt,
        options=replace(options or FitOptions(), torque_noise=recording.torque_noise),
        n_jobs=-1,
        **settings,
    )
    loop = EffectDiscovery(identifier, effects=effects)
    if several or identifier.drive is not None:
        return loop.fit_recording(recording, signals)
    positions = recording.q
    if recording.joints_named:
        from pandas import DataFrame

        positions = DataFrame(
            positions, columns=[f"q_{x}" for x in recording.joint_names]
        )
    return loop.fit(positions, recording.tau, recording.groups, signals=signals)
