"""The command ``close-loop``: what a robot's model lacks, on screen and in files."""

import csv
import json
import shlex
from dataclasses import replace

import numpy as np

from sklearn_vbjfa._cli import FRICTION, _input
from sklearn_vbjfa._cli._run import Done, blaming

# What a run writes, the page first.
_PAGE = "report.html"
_FILES: tuple[str, ...] = (_PAGE, "report.json", "parameters.csv")
# The robot, as a description, for MuJoCo, and with all that was identified.
_FILES += ("identified.urdf", "identified.xml", "identified.json")
_COLUMNS: tuple[str, ...] = (
    "parameter",
    "value",
    "unit",
    "std",
    "identifiable",
    "known",
)
_COLUMNS += ("description", "description_std", "learned", "scatter")
# Verdicts on a joint that answer nothing, or say not to trust the model.
_NO_ANSWER = ("no data", "few", "unknown", "failed", "worse")


def run(arguments, folder):
    """Close the loop on a user's recording and write the files."""
    files, urdf = _input.sources(arguments.recording), _input.expanded(arguments.urdf)
    source, default = _input.named(files), _input.default_folder(files)
    out = _input.free_folder(arguments, default, _FILES)
    ranges = _input.ranges_file(arguments)
    settings, library = _input.settings(arguments), _input.library(arguments.effects)
    loaded = _input.load(arguments, folder)
    recording = loaded.recording
    loaded.check(settings)
    signals = loaded.signals(arguments.signals)
    with blaming(source, loaded.gains):
        loop = close(
            recording,
            str(loaded.urdf),
            effects=library,
            torque_noise=recording.torque_noise,
            signals=signals,
            several=_input.is_several(arguments),
            **settings,
        )
    # Who names the joints knows the others.
    others = [] if arguments.joints else loaded.other_joints()

    def write(folder, warned):
        # Each file once, whatever was typed.
        given = tuple(dict.fromkeys(map(str, files)))
        file, description = source if len(files) == 1 else given, str(urdf)
        left_out = left_out_lines(_write_robot(loop.identifier_, folder))
        report = _report(loop, (*warned, *left_out), file, description, loaded.held)
        _write_report(report, folder)
        lines = _next_motion(report.outcome, out)
        if left_out:
            lines.append("only identified.json has every effect (page)")
        if ranges is not None:
            loop.identifier_.ranges().save(ranges)
            lines.append(f"ranges for domain randomisation: {ranges}")
        return lines

    return Done(
        text="\n".join([str(recording), *others, str(loop.report_)]),
        doubts=report_doubts(loop.report_),
        folder=out,
        fresh=not arguments.force,
        files=_FILES,
        write=write,
        page=True,
    )


def run_demo(arguments, folder):
    """Close the loop on the recording that comes with the package."""
    from sklearn_vbjfa.datasets import load_demo_recording

    recording = load_demo_recording()
    loop = close(recording, recording.urdf, friction=FRICTION.split(","))
    text = f"{recording}\n{loop.report_}"
    return Done(text=text, doubts=report_doubts(loop.report_))


def report_doubts(report):
    """Doubts that a report states, a list of str."""
    from sklearn_vbjfa.diagnosis.report import contradiction, gain_warnings, words

    outcome = report.outcome
    texts = {}
    for one in report.joints:
        if one.status in _NO_ANSWER:
            texts.setdefault(one.text, []).append(one.joint)
    names = outcome.joint_names
    joints = [
        f"{text} ({words.joint_list(names, labels, 0)})"
        for text, labels in texts.items()
    ]
    # What the recording itself is doubted for comes first, what is left out last.
    doubted = [one for one in outcome.channels if one.severity != "warning"]
    others = [one for one in outcome.channels if one.severity == "warning"]
    return [
        *filter(None, [contradiction(outcome)]),
        *_input.channel_doubts(doubted),
        *joints,
        *gain_warnings(outcome),
        *_input.channel_doubts(others),
    ]


def close(
    recording,
    urdf,
    *,
    friction,
    bodies="prior",
    alike="auto",
    effects="all",
    cutoff="auto",
    torque_noise=None,
    gains=None,
    known_masses=None,
    signals=None,
    t=None,
    drive=None,
    several=False,
):
    """Find what a model of a recording lacks, as a fitted `EffectDiscovery`."""
    # signals: by name, or those offered; drive: what the recording was read with;
    # several: whether it is of several files.
    from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

    identifier = RobotIdentifier(
        urdf,
        dt=recording.dt,
        friction=friction,
        bodies=bodies,
        alike=alike,
        cutoff=cutoff,
        torque_noise=torque_noise,
        gains=gains,
        known_masses=known_masses,
        drive=drive,
        n_jobs=-1,
    )
    loop = EffectDiscovery(identifier, effects=effects)
    if several or drive is not None:
        # The report calls recordings after their files.
        return loop.fit_recording(recording, signals)
    return loop.fit(recording.q, recording.tau, recording.groups, t=t, signals=signals)


def _report(loop, warned, file, description, held):
    """Return the report, with what was read and what is written."""
    from sklearn_vbjfa.diagnosis import Report
    from sklearn_vbjfa.diagnosis.explain._outcome import Provenance

    provenance = Provenance(
        file=file,
        description=description,
        held=held,
        warnings=warned,
        files=tuple(name for name in _FILES if name != _PAGE),
    )
    return Report(replace(loop.report_.outcome, provenance=provenance))


def _write_report(report, folder):
    """Write the page and the same as data."""
    text = json.dumps(report.to_dict(), indent=1, allow_nan=False)
    folder.joinpath(_PAGE).write_text(report.to_html(), encoding="utf-8")
    folder.joinpath("report.json").write_text(text, encoding="utf-8")


def _write_robot(robot, folder):
    """Write the robot; return what its descriptions lack, by their names."""
    from sklearn_vbjfa.diagnosis.explain._identified import parameter_values

    write_parameters(robot, parameter_values(robot), folder / "parameters.csv")
    robot.save(folder / "identified.json")
    return {
        "identified.urdf": robot.to_urdf(folder / "identified.urdf"),
        "identified.xml": robot.to_mjcf(folder / "identified.xml"),
    }


def _next_motion(outcome, out):
    """Name the command that designs the motion for what is open, a list of str."""
    is_open = (
        outcome.unexplained
        or any(effect.rivals for effect in outcome.effects)
        or any(one.reason == "excitation" for one in outcome.hidden)
    )
    if not is_open:
        return []
    return [
        "The motion for it: python -m sklearn_vbjfa design --report "
        f"{shlex.quote(str(out))}"
    ]


def left_out_lines(left_out):
    """Say in a line what descriptions go without, the largest of the first; or none."""
    # left_out: dict of str to tuple of LeftOut, by the names of the files.
    names = {}
    for name, left in left_out.items():
        if left:
            names.setdefault(_left_out_texts(left), []).append(name)
    parts = []
    for (count, largest), files in names.items():
        place = f"{'have' if len(files) > 1 else 'has'} no place for {count}{largest}"
        place = f"for {count}" if parts else place
        parts.append(f"{' and '.join(files)} {place}")
    if not parts:
        return []
    who = "they say" if sum(map(len, names.values())) > 1 else "it says"
    line = f"{', '.join(parts)}; {who} why at the top, and identified.json has all."
    return [line]


def _left_out_texts(left):
    """Count effects, and name the largest; torques and forces are not compared."""
    # What is not known is the smallest.
    up = sorted(left, key=lambda one: np.nan_to_num(one.size, nan=-1.0))
    largest = {one.unit: one for one in up}.values()
    named = ", ".join(
        f"{one.name} on {one.joint_name}"
        + ("" if np.isnan(one.size) else f" ({one.size:.2g} {one.unit} rms)")
        for one in largest
    )
    if len(left) == 1:
        return "an effect", f": {named}"
    return f"{len(left)} effects", f", the largest: {named}"


def write_parameters(robot, values, path):
    """Write one row per parameter; empty where data or description are silent."""
    # values: what `parameter_values` says of each. What alike joints share comes last.
    from sklearn_vbjfa.diagnosis.explain._identified import alike_values

    relative = ""
    if robot.gains_ is not None and not robot.gains_.absolute:
        names = [robot.joint_names_[j] for j in robot.gains_.references]
        relative = " or ".join(names) or "each channel"

    def cells(one, std, alone, scatter=np.nan):
        unit = one.unit
        if relative and unit.startswith(("N", "kg")):
            unit = f"{unit}, times the gain of {relative}"
        numbers = (one.value, std, one.nominal, one.before, one.learned, scatter)
        value, std, *rest = (repr(float(x)) if np.isfinite(x) else "" for x in numbers)
        row = [one.name, value, unit, std, "yes" if alone else "no", one.known, *rest]
        return map(_input.no_formula, row)

    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(_COLUMNS)
        for one, std, alone in zip(values, robot.theta_std_, robot.identifiable_):
            table.writerow(cells(one, std, alone))
        for one, std, scatter in alike_values(robot.alike_):
            table.writerow(cells(one, std, True, scatter))
