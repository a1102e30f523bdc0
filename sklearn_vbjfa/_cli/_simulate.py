"""The command ``simulate``: the identified robot in motion, beside the measured one."""

import importlib.util
import os
import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sklearn_vbjfa._cli import _close_loop, _exit_codes, _input, _options
from sklearn_vbjfa._cli._identify import say_warnings
from sklearn_vbjfa._cli._simulated import (
    Simulated,
    doubts_of,
    errors_table,
    errors_text,
    pictures,
)
from sklearn_vbjfa._cli._stopping import undisturbed

# What a run writes beside pictures.
_TABLE = "simulation.csv"
# Share of every recording that is identified; the rest is simulated.
_SHARE = 0.7
# Sample periods may differ by this share.
_JITTER = 0.01
# Options of an identification, and what they are where none is given.
_DEFAULTS = {
    "friction": _options.FRICTION,
    "bodies": "prior",
    "effects": "none",
    "cutoff": "auto",
}
_OF_IDENTIFICATION = ("urdf", "base_orientation", *_DEFAULTS, "known_mass")
_OF_RECORDING = (
    *_options.OF_READING,
    "urdf",
    "base_orientation",
    "model",
    "signals",
)


def add_to(commands):
    """Add the command to a parser."""
    parser = commands.add_parser(
        "simulate",
        help="simulate the identified robot beside the measured motion",
        description="Drive the identified robot by the measured torques, over windows "
        "that begin at measured states, and print how far it gets from the measured "
        "motion. The first 70 % of every recording are identified and windows of the "
        "rest are simulated; with --model, windows of the whole recording. Without "
        "RECORDING, the one that comes with the package. Writes simulation.csv and, "
        "with matplotlib, a picture of each recording.",
    )
    _options.add_optional_files(parser, several=False)
    parser.add_argument(
        "--model",
        default=None,
        metavar="FILE",
        help="identified robot, as RobotIdentifier.save writes it; nothing is "
        "identified then",
    )
    parser.add_argument(
        "--window",
        type=float,
        default=1.0,
        metavar="S",
        help="length of a window [s], by default 1",
    )
    _options.add_recording(parser)
    _options.add_out(parser, "simulation")
    _options.add_model(parser)
    parser.add_argument(
        "--effects",
        metavar="NAMES",
        help="effects to look for, or all; the completed model is then simulated "
        "beside the declared one. By default none; see the command effects",
    )
    parser.set_defaults(run=run, **dict.fromkeys(_DEFAULTS))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Task:
    """What is simulated.

    Attributes
    ----------
    recording : Recording
        Recording.
    rows : ndarray of int
        Rows of it.
    robots : dict of str to RobotIdentifier or IdentifiedRobot
        Robots by their labels.
    signals : object
        What was recorded beside these rows.
    told : str
        What was identified, a line.
    """

    recording: object
    rows: np.ndarray
    robots: dict
    signals: object
    told: str


def run(arguments):
    """Simulate windows of a recording, print their errors and write the files."""
    from sklearn_vbjfa.robot._windows import simulate_windows

    _check(arguments)
    source = _input.path(arguments.recording or "demo")
    out = _input.path(arguments.out or f"{source.stem or 'recording'}-simulation")
    _input.check_folder(out)
    if not arguments.force:
        given = (arguments.urdf, arguments.model)
        inputs = (source, *map(_input.path, filter(None, given)))
        _input.check_overwriting(out, (_TABLE,), inputs, (".png",))
    draws = importlib.util.find_spec("matplotlib") is not None
    with (
        tempfile.TemporaryDirectory() as folder,
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        task = _task(arguments, source, Path(folder))
        recording, rows = task.recording, task.rows
        # Saved models have a clock of their own.
        times = None if arguments.model else recording.clock()[rows]
        part = recording.q[rows], recording.tau[rows], recording.groups[rows]
        windows, first = {}, None
        try:
            for label, robot in task.robots.items():
                windows[label] = simulate_windows(
                    robot,
                    *part,
                    times,
                    window=arguments.window,
                    signals=task.signals,
                    beside=first,
                )
                first = first or windows[label]
        except ValueError as error:
            raise ValueError(f"{source}: {error}") from error
        found = Simulated(
            recording=recording, rows=rows, windows=windows, told=task.told
        )
        text = errors_text(found, arguments.window)
        arguments.doubts = [*doubts_of(found), *_exit_codes.of_warnings(caught)]
        files = {_TABLE: errors_table(found).encode("utf-8")}
        left = ""
        if draws:
            drawn, left = pictures(found)
            files |= drawn
        try:
            with undisturbed():
                _write(files, out)
                arguments.written = True
        except OSError:
            print(text)
            raise
    print(text)
    names = ", ".join(str(out / name) for name in files)
    print(f"\n{_input.wrapped(f'written: {names}{left}', sys.stdout)}")
    say_warnings(caught)
    if not draws:
        _say_no_pictures()


def _say_no_pictures():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.warn(
            "no pictures were drawn, as matplotlib is not installed; install it with "
            'pip install "sklearn-vbjfa[plot]".',
            UserWarning,
            stacklevel=2,
        )
    say_warnings(caught)


def _check(arguments):
    """Refuse options that do not go together, and fill in the others."""
    if arguments.recording is None:
        _options.refuse_given(
            arguments,
            _OF_RECORDING,
            "needs a RECORDING; without one, the recording that comes with the package "
            "is simulated",
        )
    elif arguments.model is None and arguments.urdf is None:
        raise ValueError(
            "give --urdf FILE, the description of the robot, or --model FILE, an "
            "identified robot."
        )
    if arguments.model is not None:
        _options.refuse_given(
            arguments,
            _OF_IDENTIFICATION,
            "belongs to an identification, and the robot of --model is identified; "
            "give one of the two",
        )
    if not 0 < arguments.window < np.inf:
        raise ValueError(
            f"--window must be a positive number of seconds; got {arguments.window:g}."
        )
    for name, value in _DEFAULTS.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, value)


# -- robots ----------------------------------------------------------------------------


def _task(arguments, source, folder):
    """Read the recording and the model, or identify one."""
    if arguments.model is not None:
        return _saved(arguments, source, folder)
    return _identified(arguments, source, folder)


def _saved(arguments, source, folder):
    """Take a saved robot and the whole recording."""
    from sklearn_vbjfa import load_identified

    robot = load_identified(_input.path(arguments.model))
    names = robot.joint_names_
    joints = _input.joint_names(arguments.joints)
    if joints and set(joints) != set(names):
        raise ValueError(
            f"--joints must name the joints of {arguments.model} ({', '.join(names)}) "
            f"in the order of the columns; got {', '.join(joints)}."
        )
    urdf = folder / "robot.urdf"
    urdf.write_text(robot.description_, encoding="utf-8")
    gains = _saved_gains(arguments, robot)
    recording = _input.read(arguments, urdf, joints or names, gains, identified=False)
    if robot.dt is not None and abs(recording.dt - robot.dt) > _JITTER * robot.dt:
        raise ValueError(
            f"{source}: is sampled every {recording.dt:.6g} s, and {arguments.model} "
            f"was identified at {robot.dt:.6g} s; resample the recording to that "
            "period, or identify from this one."
        )
    _input.check_channels(recording, urdf, gains, source)
    effects = ", ".join(
        f"{effect.name} on {names[effect.joint]}" for effect in robot.effects_
    )
    return _Task(
        recording=recording,
        rows=np.arange(recording.n_samples),
        robots={"simulated": robot},
        signals=_input.signals(arguments.signals, recording, source),
        told=f"model: {arguments.model}, effects: {effects or 'none'}",
    )


def _saved_gains(arguments, robot):
    """Return the gains of a recording for a saved robot, "unknown" for its own."""
    gains = _input.gains(arguments.gain)
    if robot.gains_ is None:
        if gains == "unknown":
            raise ValueError(
                f"--gain unknown belongs to an identification, and {arguments.model} "
                "was identified from torques in N m or N; give the factors to them."
            )
        return gains
    if gains not in (None, "unknown"):
        raise ValueError(
            f"{arguments.model} was identified with unknown gains, so that its torques "
            "are what the channels read; leave --gain out."
        )
    return "unknown"


def _identified(arguments, source, folder):
    """Identify the first part of every recording, for the rest."""
    from sklearn_vbjfa import effects
    from sklearn_vbjfa.datasets import load_demo_recording
    from sklearn_vbjfa.effects import declarable
    from sklearn_vbjfa.physical import ProjectionError

    friction = _input.names("--friction", arguments.friction, declarable())
    library = arguments.effects
    if library != "all":
        library = _input.names("--effects", library, effects.available())
    cutoff = _input.cutoff(arguments.cutoff)
    gains = _input.gains(arguments.gain)
    masses = _input.known_masses(arguments.known_mass, gains)
    signals, held = None, ()
    if arguments.recording is None:
        recording = load_demo_recording()
        urdf = recording.urdf
    else:
        taken = _input.taken(arguments, gains, folder)
        recording, urdf, held = taken.recording, taken.urdf, taken.held
        _input.check_channels(recording, urdf, gains, source)
        signals = _input.signals(arguments.signals, recording, source)
    _input.check_nyquist(cutoff, recording, source)
    _input.check_gains(gains, masses, urdf)
    first, rest = _parts(recording)
    settings = {
        "friction": friction,
        "bodies": arguments.bodies,
        "cutoff": cutoff,
        "torque_noise": recording.torque_noise,
        "gains": "unknown" if gains == "unknown" else None,
        "known_masses": masses,
    }
    part, known = _rows_of(recording, first), {}
    known |= {"t": recording.clock()[first], "signals": _at(signals, first)}
    try:
        robots = _robots(part, str(urdf), library, known, settings)
    except (ValueError, ProjectionError) as error:
        raise ValueError(f"{source}: {error}") from error
    told = (
        f"first {100 * _SHARE:g} % of every recording identified, the rest simulated\n"
        f"friction: {', '.join(friction) or 'none'}"
    )
    if held:
        told = f"held at zero: {', '.join(held)}\n{told}"
    if "completed" in robots:
        found = robots["completed"].effects_
        names = recording.joint_names
        listed = ", ".join(f"{one.name} on {names[one.joint]}" for one in found)
        told += f"; completed by: {listed or 'nothing'}"
    return _Task(
        recording=recording,
        rows=rest,
        robots=robots,
        signals=_at(signals, rest),
        told=told,
    )


def _robots(recording, urdf, library, known, settings):
    """Identify the declared robot, and complete it if effects are to be looked for.

    known : dict of the times and signals of the rows.
    """
    from sklearn_vbjfa import RobotIdentifier

    if not library:
        robot = RobotIdentifier(urdf, dt=recording.dt, **settings)
        robot.fit(recording.q, recording.tau, groups=recording.groups, t=known["t"])
        return {"simulated": robot}
    loop = _close_loop.close(
        recording, urdf, effects=library, ceiling=False, **known, **settings
    )
    robots = {"declared": loop.declared_}
    if loop.added_:
        robots["four plain terms"] = loop.plain_
    return {**robots, "completed": loop.identifier_}


def _parts(recording):
    """Rows that are identified and rows that are simulated."""
    first, rest = [], []
    for part in recording.segments:
        border = part.start + round(_SHARE * (part.stop - part.start))
        first.append(np.arange(part.start, border))
        rest.append(np.arange(border, part.stop))
    return np.concatenate(first), np.concatenate(rest)


def _rows_of(recording, rows):
    """Make a recording of some rows of another."""
    from sklearn_vbjfa.recording._recording import take_rows

    return take_rows(recording, rows, recording.groups[rows])


def _at(signals, rows):
    """Signals at some rows."""
    from sklearn_vbjfa.recording._signals import OfferedSignals

    if signals is None:
        return None
    if isinstance(signals, OfferedSignals):
        columns = {name: x[rows] for name, x in signals.columns.items()}
        return OfferedSignals(columns=columns, left_out=signals.left_out)
    return {name: x[rows] for name, x in signals.items()}


# -- files -----------------------------------------------------------------------------


def _write(files, out):
    """Write all files or none; each appears complete."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".writing-") as folder:
        for name, content in files.items():
            Path(folder, name).write_bytes(content)
        for name in files:
            os.replace(Path(folder, name), out / name)
