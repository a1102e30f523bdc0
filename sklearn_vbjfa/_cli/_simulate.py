"""The command ``simulate``: the identified robot in motion, beside the measured one."""

import csv
import importlib
import importlib.util
import io
import os
import re
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sklearn_vbjfa._cli import _close_loop, _input, _options
from sklearn_vbjfa._cli._identify import say_warnings
from sklearn_vbjfa._cli._stopping import undisturbed

# What a run writes beside pictures.
_TABLE = "simulation.csv"
# Share of every recording that is identified; the rest is simulated.
_SHARE = 0.7
# Sample periods may differ by this share.
_JITTER = 0.01
# Most pictures, and most windows that failed and are named.
_MOST_PICTURES, _MOST_NAMED = 12, 5
_RESOLUTION = 120  # dots per inch
# Options of an identification, and what they are where none is given.
_DEFAULTS = {"friction": "viscous,coulomb", "effects": "none", "cutoff": "auto"}
_OF_IDENTIFICATION = ("urdf", *_DEFAULTS, "gain", "known_mass")
_OF_RECORDING = ("urdf", "model", "joints", "dt", "signals")


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
    parser.add_argument(
        "recording",
        nargs="?",
        default=None,
        metavar="RECORDING",
        help="CSV, npz or parquet file with columns q1..qn [rad or m], tau1..taun "
        "[N m or N] and, optionally, t [s], segment, and signals such as a temperature",
    )
    parser.add_argument(
        "--urdf", default=None, metavar="FILE", help="description of the robot"
    )
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
    parser.add_argument(
        "--out",
        default=None,
        metavar="DIR",
        help="folder for the files; by default the name of RECORDING plus -simulation",
    )
    _options.add_force(parser)
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
        try:
            windows = {
                label: simulate_windows(
                    robot,
                    *part,
                    times,
                    window=arguments.window,
                    signals=task.signals,
                )
                for label, robot in task.robots.items()
            }
        except ValueError as error:
            raise ValueError(f"{source}: {error}") from error
        text = _report(task, windows, arguments.window)
        files = {_TABLE: _table(task, windows).encode("utf-8")}
        left = ""
        if draws:
            pictures, left = _pictures(task, windows)
            files |= pictures
        try:
            with undisturbed():
                _write(files, out)
                arguments.written = True
        except OSError:
            print(text)
            raise
    print(text)
    print(f"\nwritten: {', '.join(str(out / name) for name in files)}{left}")
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
    given = {
        name
        for name in (*_OF_IDENTIFICATION, *_OF_RECORDING)
        if getattr(arguments, name) not in (None, [])
    }
    if arguments.recording is None:
        for name in _OF_RECORDING:
            if name in given:
                raise ValueError(
                    f"{_option(name)} needs a RECORDING; without one, the recording "
                    "that comes with the package is simulated."
                )
    elif arguments.model is None and arguments.urdf is None:
        raise ValueError(
            "give --urdf FILE, the description of the robot, or --model FILE, an "
            "identified robot."
        )
    if arguments.model is not None:
        for name in _OF_IDENTIFICATION:
            if name in given:
                raise ValueError(
                    f"{_option(name)} belongs to an identification, and the robot of "
                    "--model is identified; give one of the two."
                )
    if not 0 < arguments.window < np.inf:
        raise ValueError(
            f"--window must be a positive number of seconds; got {arguments.window:g}."
        )
    for name, value in _DEFAULTS.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, value)


def _option(name):
    return f"--{name.replace('_', '-')}"


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
    recording = _input.read(source, arguments.dt, urdf, joints or names)
    if robot.dt is not None and abs(recording.dt - robot.dt) > _JITTER * robot.dt:
        raise ValueError(
            f"{source}: is sampled every {recording.dt:.6g} s, and {arguments.model} "
            f"was identified at {robot.dt:.6g} s; resample the recording to that "
            "period, or identify from this one."
        )
    _check_channels(recording, urdf, source)
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


def _identified(arguments, source, folder):
    """Identify the first part of every recording, for the rest."""
    from sklearn_vbjfa import effects
    from sklearn_vbjfa.datasets import load_demo_recording
    from sklearn_vbjfa.effects import _declared
    from sklearn_vbjfa.physical import ProjectionError

    friction = _input.names("--friction", arguments.friction, _declared.available())
    library = arguments.effects
    if library != "all":
        library = _input.names("--effects", library, effects.available())
    cutoff = _input.cutoff(arguments.cutoff)
    joints = _input.joint_names(arguments.joints)
    gains = _input.gains(arguments.gain)
    masses = _input.known_masses(arguments.known_mass, gains)
    signals, held = None, ()
    if arguments.recording is None:
        recording = load_demo_recording()
        urdf = recording.urdf
    else:
        urdf, held = _input.robot(_input.path(arguments.urdf), joints, folder)
        recording = _input.read(source, arguments.dt, urdf, joints)
        _check_channels(recording, urdf, source)
        signals = _input.signals(arguments.signals, recording, source)
    _input.check_nyquist(cutoff, recording, source)
    _input.check_gains(gains, masses, urdf)
    first, rest = _parts(recording)
    settings = {
        "friction": friction,
        "cutoff": cutoff,
        "torque_noise": recording.torque_noise,
        "gains": gains,
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


def _check_channels(recording, urdf, source):
    """Refuse channels that cannot be what their names say."""
    from sklearn_vbjfa.inspection import inspect_recording

    findings = inspect_recording(recording, urdf)
    errors = [found.message for found in findings if found.severity == "error"]
    if errors:
        raise ValueError(f"{source}: {' '.join(errors)}")


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
    return {"declared": loop.declared_, "completed": loop.identifier_}


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


# -- what is said ----------------------------------------------------------------------


def _scales(windows):
    """Factors (nv,) to degrees and mm, and these units."""
    slides = windows.prismatic
    units = tuple("mm" if sliding else "degrees" for sliding in slides)
    return np.where(slides, 1e3, 180 / np.pi), units


def _report(task, windows, seconds):
    """Errors joint by joint, and what became of the windows."""
    one = next(iter(windows.values()))
    whole = ~np.any([own.failed for own in windows.values()], axis=0)
    scale, units = _scales(one)
    rivals = {"stays": one.staying(), "goes on": one.going_on()}
    positions, velocities = {"": one.joint_names, "unit": units}, {}
    velocities |= {"": one.joint_names, "unit": [f"{unit}/s" for unit in units]}
    for label, own in (windows | rivals).items():
        errors = own.errors[whole] * scale
        positions[label] = _numbers(_rms(errors))
        if label in windows:
            # Heads differ in blanks where two models are simulated.
            head = f"median{' ' * list(windows).index(label)}"
            positions[head] = _numbers(_median(errors))
        velocities[label] = _numbers(_rms(own.velocity_errors[whole] * scale))
    which = "all" if whole.all() else f"{whole.sum()} of"
    lines = [
        str(task.recording),
        task.told,
        "",
        f"position error over windows of {seconds:g} s, root mean square",
        _tabulated(positions),
        "",
        "velocity error",
        _tabulated(velocities),
        "",
        f"{which} {whole.size} windows, each from the measured state at its start and "
        "driven by the",
        "measured torques. median: of the windows' position errors; stays, goes on: a",
        "robot that stays where it was, and one that keeps its velocity.",
    ]
    for label, own in windows.items():
        if own.failures:
            lines.append(_failed(task, label if len(windows) > 1 else "", own))
    return "\n".join(lines)


def _tabulated(columns):
    """Write columns of text, the first two of them words, as a table."""
    from tabulate import tabulate

    return tabulate(
        list(zip(*columns.values())),
        headers=[head.strip() for head in columns],
        disable_numparse=True,
        colalign=("left", "left", *["right"] * (len(columns) - 2)),
    )


def _rms(errors):
    """Root mean square over windows, (nv,); nan without any."""
    if not len(errors):
        return np.full(errors.shape[1], np.nan)
    return np.sqrt(np.mean(errors**2, axis=0))


def _median(errors):
    """Median over windows, (nv,); nan without any."""
    if not len(errors):
        return np.full(errors.shape[1], np.nan)
    return np.median(errors, axis=0)


def _numbers(values):
    """Write errors, none of which is negative, with three digits."""
    return ["none" if np.isnan(x) else f"{x:#.3g}".rstrip(".") for x in values]


def _failed(task, label, windows):
    """Name windows that were not simulated to their end, and why."""
    count = len(windows.failures)
    who = f"{label}: " if label else ""
    lines = [f"{who}{count} of {windows.n_windows} windows failed:"]
    for one in windows.failures[:_MOST_NAMED]:
        name, begin, end = _place(task, windows, one.window)
        lines.append(f"- {name}, {begin:.3f} to {end:.3f} s: {one.message}")
    if count > _MOST_NAMED:
        lines.append(f"- and {count - _MOST_NAMED} more; see simulation.csv")
    return "\n".join(lines)


def _place(task, windows, k):
    """Return the recording of a window, and its times since the start of that [s]."""
    recording = task.recording
    row = task.rows[windows.starts[k]]
    label = recording.groups[row]
    begin = (row - recording.segments[label].start) * recording.dt
    length = windows.t[k, -1] - windows.t[k, 0]
    return _name(recording, label), begin, begin + length


def _name(recording, label):
    """Name of one of the recordings; that of the file if it holds a single one."""
    names = recording.group_names
    return recording.name if len(names) == 1 else names[label]


# -- files -----------------------------------------------------------------------------


def _table(task, windows):
    """Return a table with one row per window and joint, as CSV."""
    one = next(iter(windows.values()))
    scale, units = _scales(one)
    stays, goes_on = one.staying().errors * scale, one.going_on().errors * scale
    file = io.StringIO(newline="")
    table = csv.writer(file, lineterminator="\n")
    heads = ["model", "recording", "from_s", "to_s", "joint", "unit"]
    heads += ["position_error", "velocity_error_per_s", "stays", "goes_on", "failed"]
    table.writerow(heads)
    for label, own in windows.items():
        errors, speeds = own.errors * scale, own.velocity_errors * scale
        why = {one.window: one.message for one in own.failures}
        for k in range(own.n_windows):
            name, begin, end = _place(task, own, k)
            for j, joint in enumerate(own.joint_names):
                row = [label, name, f"{begin:.6g}", f"{end:.6g}", joint, units[j]]
                numbers = errors[k, j], speeds[k, j], stays[k, j], goes_on[k, j]
                row += ["" if np.isnan(x) else f"{x:.6g}" for x in numbers]
                table.writerow(map(_input.no_formula, [*row, why.get(k, "")]))
    return file.getvalue()


def _pictures(task, windows):
    """Draw each recording; name -> PNG file, and what is to be said of the others."""
    from sklearn_vbjfa.diagnosis import SimulationDisplay

    # Files are drawn, no windows opened.
    os.environ.setdefault("MPLBACKEND", "Agg")
    pyplot = importlib.import_module("matplotlib.pyplot")
    one = next(iter(windows.values()))
    labels = task.recording.groups[task.rows[one.starts]]
    found = {}
    shown = np.unique(labels)
    for label in shown[:_MOST_PICTURES]:
        own = {name: w.select(labels == label) for name, w in windows.items()}
        display = SimulationDisplay(windows=own).plot()
        file = io.BytesIO()
        display.figure_.savefig(file, format="png", dpi=_RESOLUTION)
        pyplot.close(display.figure_)
        name = re.sub(r"[^\w-]+", "_", _name(task.recording, label))[:60]
        name = f"{name}.png"
        if name in found:
            name = f"{label + 1}_{name}"
        found[name] = file.getvalue()
    left = ""
    if shown.size > _MOST_PICTURES:
        left = f" (pictures of {_MOST_PICTURES} of {shown.size} recordings)"
    return found, left


def _write(files, out):
    """Write all files or none; each appears complete."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".writing-") as folder:
        for name, content in files.items():
            Path(folder, name).write_bytes(content)
        for name in files:
            os.replace(Path(folder, name), out / name)
