"""The command ``close-loop``: what a robot's model lacks, on screen and in files."""

import csv
import json
import os
import shlex
import sys
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from sklearn_vbjfa._cli import _exit_codes, _input, _options
from sklearn_vbjfa._cli._identify import say_warnings, told
from sklearn_vbjfa._cli._stopping import undisturbed

# The robot, as a description, for MuJoCo, and with all that was identified.
_IDENTIFIED = ("identified.urdf", "identified.xml", "identified.json")
# What a run writes, the page first.
_PAGE = "report.html"
_COLUMNS = ("parameter", "value", "unit", "std", "identifiable", "known")
_COLUMNS += ("description", "description_std", "learned")
_FILES = (_PAGE, "report.json", "parameters.csv", *_IDENTIFIED)


def add_to(commands):
    """Add the command to a parser."""
    parser = commands.add_parser(
        "close-loop",
        help="find what the model of your robot lacks",
        description="Identify a robot from a recording or several, find effects that "
        "its model lacks, add them, and report the error before and after on parts of "
        "the recordings that were set aside. Writes report.html, report.json, "
        "parameters.csv, identified.urdf, identified.xml for MuJoCo, and "
        "identified.json, which the command simulate reads.",
    )
    _options.add_files(parser)
    _options.add_recording(parser)
    _options.add_out(parser, "report", several=True)
    _options.add_model(parser)
    parser.add_argument(
        "--effects",
        default="all",
        metavar="NAMES",
        help="effects to look for, by default all; see the command effects",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="order in which blocks of time are left out for the ceiling; nothing else "
        "is random",
    )
    parser.add_argument(
        "--no-ceiling",
        dest="ceiling",
        action="store_false",
        help="do not measure what functions of any form would explain of what remains; "
        "saves some seconds",
    )
    parser.set_defaults(run=run)


def run(arguments):
    """Close the loop on a user's recording and write the files."""
    from sklearn_vbjfa import effects
    from sklearn_vbjfa.diagnosis import Report
    from sklearn_vbjfa.diagnosis.explain._findings import Provenance
    from sklearn_vbjfa.effects import declarable
    from sklearn_vbjfa.physical import ProjectionError

    files, urdf = _input.sources(arguments.recording), _input.path(arguments.urdf)
    source = _input.named(files)
    out = _input.path(arguments.out) if arguments.out else None
    out = out or _input.default_folder(files)
    _input.check_folder(out)
    if not arguments.force:
        _input.check_overwriting(out, _FILES, (*files, urdf))
    friction = _input.names("--friction", arguments.friction, declarable())
    library = arguments.effects
    if library != "all":
        library = _input.names("--effects", library, effects.available())
    cutoff = _input.cutoff(arguments.cutoff)
    seed = _input.seed(arguments.seed)
    gains = _input.gains(arguments.gain)
    masses = _input.known_masses(arguments.known_mass, gains)
    with (
        tempfile.TemporaryDirectory() as folder,
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        taken = _input.taken(arguments, gains, Path(folder))
        recording, held = taken.recording, taken.held
        _input.check_nyquist(cutoff, recording, source)
        _input.check_gains(gains, masses, taken.urdf)
        signals = _input.signals(arguments.signals, recording, source)
        # Each file once, whatever was typed.
        groups, given = None, tuple(dict.fromkeys(map(str, files)))
        if len(files) > 1:
            # The report calls recordings after their files.
            groups = np.array(recording.group_names, dtype=object)[recording.groups]
        try:
            loop = close(
                recording,
                str(taken.urdf),
                groups=groups,
                friction=friction,
                bodies=arguments.bodies,
                effects=library,
                cutoff=cutoff,
                ceiling=arguments.ceiling,
                seed=seed,
                torque_noise=recording.torque_noise,
                gains="unknown" if gains == "unknown" else None,
                known_masses=masses,
                signals=signals,
            )
        except (ValueError, ProjectionError) as error:
            # The options are valid, so the recording is at fault.
            raise ValueError(f"{source}: {error}") from error
        others = _input.other_joints(taken.urdf, held)
        text = [str(recording), *others, str(loop.report_)]
        arguments.doubts = _doubts(loop, caught)
        try:
            # Before anything is printed, as a reader such as head may end the run.
            provenance = Provenance(
                file=source if len(files) == 1 else given,
                description=str(urdf),
                held=held,
                warnings=told(caught),
                files=tuple(name for name in _FILES if name != _PAGE),
            )
            report = Report(replace(loop.report_.outcome, provenance=provenance))
            with undisturbed():
                written, left_out = _write(loop, report, out)
                arguments.written = True
        except OSError:
            print("\n".join(text))
            raise
    print("\n".join(text))
    lines = [*_left_out_lines(left_out), *_next_motion(report.outcome, out)]
    if lines:
        print("\n" + "\n".join(_input.wrapped(x, sys.stdout) for x in lines))
    names = ", ".join(map(str, written))
    print(f"\n{_input.wrapped(f'written: {names}', sys.stdout)}")
    say_warnings(caught)


def run_demo(arguments):
    """Close the loop on the recording that comes with the package."""
    from sklearn_vbjfa.datasets import load_demo_recording

    recording = load_demo_recording()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        friction = _options.FRICTION.split(",")
        loop = close(recording, recording.urdf, friction=friction)
    arguments.doubts = _doubts(loop, caught)
    print(recording)
    print(loop.report_)
    say_warnings(caught)


def _doubts(loop, caught):
    """Doubts of a report, and of the warnings that came with it."""
    return [*_exit_codes.of_report(loop.report_), *_exit_codes.of_warnings(caught)]


def close(
    recording,
    urdf,
    *,
    friction,
    bodies="prior",
    effects="all",
    cutoff="auto",
    ceiling=True,
    seed=0,
    torque_noise=None,
    gains=None,
    known_masses=None,
    signals=None,
    t=None,
    groups=None,
):
    """Find what a model of a recording lacks, as a fitted `EffectDiscovery`.

    groups : labels of the rows, by default those of the recording.
    """
    from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

    identifier = RobotIdentifier(
        urdf,
        dt=recording.dt,
        friction=friction,
        bodies=bodies,
        cutoff=cutoff,
        torque_noise=torque_noise,
        gains=gains,
        known_masses=known_masses,
    )
    loop = EffectDiscovery(
        identifier, effects=effects, ceiling=ceiling, random_state=seed, verbose=True
    )
    groups = recording.groups if groups is None else groups
    return loop.fit(recording.q, recording.tau, groups, t=t, signals=signals)


def _write(loop, report, out):
    """Write all files or none; each appears complete.

    Returns their paths, and what the descriptions do not have, by their names.
    """
    from sklearn_vbjfa.diagnosis.explain._identified import parameter_values

    texts = {
        _PAGE: report.to_html(),
        "report.json": json.dumps(report.to_dict(), indent=1, allow_nan=False),
    }
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".writing-") as folder:
        for name, text in texts.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        path = Path(folder, "parameters.csv")
        values = parameter_values(loop.identifier_)
        _write_parameters(loop.identifier_, values, path)
        write = loop.identifier_.to_urdf, loop.identifier_.to_mjcf
        left_out = {
            name: to(Path(folder, name)) for name, to in zip(_IDENTIFIED, write)
        }
        loop.identifier_.save(Path(folder, "identified.json"))
        for name in _FILES:
            os.replace(Path(folder, name), out / name)
    return [out / name for name in _FILES], left_out


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
        "A motion that decides what is open: python -m sklearn_vbjfa design --report "
        f"{shlex.quote(str(out))}"
    ]


def _left_out_lines(left_out):
    """Say what descriptions go without, those that go without the same in one line.

    left_out : dict of str to tuple of LeftOut, by the names of the files.
    """
    names = {}
    for name, left in left_out.items():
        if left:
            names.setdefault(_left_out_text(left), []).append(name)
    return [
        f"{' and '.join(files)} {'have' if len(files) > 1 else 'has'} no place for "
        f"{text}; {'they say' if len(files) > 1 else 'it says'} why at the top, and "
        "identified.json has all."
        for text, files in names.items()
    ]


def _left_out_text(left):
    """Count effects and name the largest; torques and forces are not compared."""
    # What is not known is the smallest.
    up = sorted(left, key=lambda one: np.nan_to_num(one.size, nan=-1.0))
    largest = {one.unit: one for one in up}.values()
    told = ", ".join(
        f"{one.name} on {one.joint_name}"
        + ("" if np.isnan(one.size) else f" ({one.size:.2g} {one.unit} rms)")
        for one in largest
    )
    count = "an effect" if len(left) == 1 else f"{len(left)} effects, the largest"
    return f"{count}: {told}"


def _write_parameters(robot, values, path):
    """Write one row per parameter; empty where the data or the description are silent.

    values : what `parameter_values` says of each.
    """
    relative = ""
    if robot.gains_ is not None and not robot.gains_.absolute:
        names = [robot.joint_names_[j] for j in robot.gains_.references]
        relative = " or ".join(names) or "each channel"
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(_COLUMNS)
        for one, std, alone in zip(values, robot.theta_std_, robot.identifiable_):
            unit = one.unit
            if relative and unit.startswith(("N", "kg")):
                unit = f"{unit}, times the gain of {relative}"
            numbers = (one.value, std, one.nominal, one.before, one.learned)
            value, std, nominal, before, learned = (
                repr(float(x)) if np.isfinite(x) else "" for x in numbers
            )
            alone = "yes" if alone else "no"
            row = [one.name, value, unit, std, alone, one.known]
            row += [nominal, before, learned]
            table.writerow(map(_input.no_formula, row))
