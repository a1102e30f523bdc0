"""The command ``simulate``: the identified robot in motion, and the measured motion."""

import csv
import io
import warnings
from dataclasses import dataclass, field, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa._cli import _input
from sklearn_vbjfa._cli._parser import Refused, spelled
from sklearn_vbjfa._cli._run import Done, rendered
from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.diagnosis import simulate_windows
from sklearn_vbjfa.effects import CommandDelay
from sklearn_vbjfa.fit import signed
from sklearn_vbjfa.inspection import refusal
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import OfferedSignals, take_rows
from sklearn_vbjfa.robot import follow_windows

_TABLE = "simulation.csv"
# Share of every recording that is identified; the rest is simulated.
_SHARE = 0.7
# Sample periods may differ by this share.
_JITTER = 0.01
_OF_IDENTIFICATION: tuple[str, ...] = ("urdf", "base_orientation", "friction")
_OF_IDENTIFICATION += ("bodies", "cutoff", "known_mass", "shared_drives")
# The robot, and the one whose bodies are those of the description.
_ROBOT, _DESCRIBED = "simulated", "as described"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Task:
    """A robot, and the rows that it is simulated on."""

    robot: object
    recording: object  # all of it
    rows: np.ndarray  # of the recording, that the windows are cut from
    times: np.ndarray | None  # of these rows; None counts from the fit of the robot
    signals: object  # of these rows
    drive: object  # that the robot follows commands by; None for torques
    summary: list

    def place(self, windows, k):
        """Return the recording of a window, and its times since the start of that."""
        recording = self.recording
        row = self.rows[windows.starts[k]]
        label = recording.groups[row]
        begin = (row - recording.segments[label].start) * recording.dt
        names = recording.group_names
        # A single one is called after its file.
        name = recording.name if len(names) == 1 else names[label]
        return name, begin, begin + windows.t[k, -1] - windows.t[k, 0]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Results:
    """Simulated windows by robot, and the same of each whole recording."""

    windows: dict
    whole: list = field(default_factory=list)
    note: str = ""  # why the described robot is not simulated

    @property
    def failures(self):
        """Messages on whole recordings that were not simulated to their end."""
        pairs = (pair for one in self.whole for pair in one.items())
        return [f"{label}: {x.message}" for label, own in pairs for x in own.failures]


def simulate(arguments, folder):
    """Simulate windows of a recording, print their errors and write them."""
    _check(arguments)
    out = _input.output_folder(arguments, "simulation")
    prepare = _identified if arguments.model is None else _saved
    task = prepare(arguments, folder)
    with _input.blaming(_input.named(arguments)):
        run = _from_torques if task.drive is None else _from_commands
        results = run(task, arguments.window)
    shown = _shown(task, results, arguments.window)

    def write(folder, notes):
        path = folder / _TABLE
        path.write_text(errors_table(task, results), encoding="utf-8", newline="")
        return [""]

    windows = results.windows[_ROBOT]
    doubts = [f"{shown['failures']} failed"] if windows.failures else []
    doubts += results.failures
    doubts += [f"{shown['away']} joints ran away"] if shown["away"] else []
    doubts += [] if windows.clearly_better.all() else [windows.verdict()]
    text = rendered("simulation.txt.j2", **shown)
    return Done(text=text, doubts=doubts, folder=out, files=(_TABLE,), write=write)


def _check(arguments):
    """Refuse options that exclude one another."""
    if arguments.model is None and arguments.urdf is None:
        raise ValueError(
            "give --urdf FILE, the description of the robot, or --model FILE, an "
            "identified robot."
        )
    if len(arguments.recording) > 1 and not arguments.join:
        raise Refused(
            f"simulate takes one recording, got {len(arguments.recording)} files; "
            "--join if they are one",
            join=True,
        )
    for name in _OF_IDENTIFICATION if arguments.model else ():
        if name in arguments.typed:
            raise ValueError(
                f"{spelled(name)} cannot be combined with --model: that robot is "
                "identified."
            )


# -- robots ----------------------------------------------------------------------------


def _saved(arguments, folder):
    """Take a saved robot and the whole recording."""
    robot = load_identified(_input.expanded(arguments.model))
    names, joints = robot.joint_names_, arguments.joints
    if joints and set(joints) != set(names):
        raise ValueError(
            f"--joints must name the joints of {arguments.model} ({', '.join(names)}) "
            f"in the order of the columns; got {', '.join(joints)}."
        )
    own_units = robot.gains_ is not None
    if (
        arguments.gain not in (None, "unknown")
        if own_units
        else arguments.gain == "unknown"
    ):
        units = "the units of its channels" if own_units else "N m or N"
        raise ValueError(
            f"{arguments.model} was identified with torques in {units}; "
            f"{'leave --gain out' if own_units else 'give the factors (--gain)'}."
        )
    urdf = folder / "robot.urdf"
    urdf.write_text(robot.description_, encoding="utf-8")
    gains = "unknown" if own_units else arguments.gain
    recording = _input.read(arguments, urdf, joints or names, gains, identified=False)
    source = _input.named(arguments)
    if robot.dt is not None and abs(recording.dt - robot.dt) > _JITTER * robot.dt:
        raise ValueError(
            f"{source}: is sampled every {recording.dt:.6g} s, and {arguments.model} "
            f"was identified at {robot.dt:.6g} s; resample the recording to that "
            "period, or identify from this one."
        )
    loaded = _input.LoadedRecording(
        recording=recording,
        urdf=urdf,
        source=source,
        gains=gains,
        drive=arguments.drive,
    )
    _check_channels(loaded)
    effects = [f"{effect.name} on {names[effect.joint]}" for effect in robot.effects_]
    summary = [f"model: {arguments.model}, effects: {', '.join(effects) or 'none'}"]
    recording, drive = _commanded(arguments.drive, robot, recording)
    return _Task(
        robot=robot,
        recording=recording,
        rows=np.arange(recording.n_samples),
        times=None,
        signals=loaded.signals(arguments.signals),
        drive=drive,
        summary=[*summary, *_delay_line(drive, robot)],
    )


def _identified(arguments, folder):
    """Identify the first part of every recording, for the rest."""
    settings, loaded = _input.settings(arguments), _input.load(arguments, folder)
    _check_channels(loaded)
    recording, drive = loaded.recording, arguments.drive
    parts = recording.segments
    borders = [p.start + round(_SHARE * (p.stop - p.start)) for p in parts]
    first = np.concatenate([np.arange(p.start, b) for p, b in zip(parts, borders)])
    rest = np.concatenate([np.arange(b, p.stop) for p, b in zip(parts, borders)])
    noise = recording.torque_noise
    settings["options"] = replace(settings["options"], torque_noise=noise)
    robot = RobotIdentifier(str(loaded.urdf), dt=recording.dt, **settings)
    part = _rows_of(recording, first)
    if drive is None:
        part = replace(part, t=recording.clock()[first])
    with _input.blaming(loaded.source, loaded.gains):
        robot.fit_inspected(part)
    recording, drive = _commanded(drive, robot, recording)
    held = [f"held at zero: {', '.join(loaded.held)}"] if loaded.held else []
    return _Task(
        robot=robot,
        recording=recording,
        rows=rest,
        times=recording.clock()[rest],
        signals=_at(loaded.signals(arguments.signals), rest),
        drive=drive,
        summary=[
            *held,
            *_delay_line(drive, robot),
            f"first {100 * _SHARE:g} % of every recording identified, the rest "
            "simulated",
            f"friction: {', '.join(settings['friction']) or 'none'}",
        ],
    )


def _check_channels(loaded):
    """Refuse channels that are not what they are called; warn of doubtful ones."""
    findings = loaded.findings()
    measured = loaded.drive is None and loaded.gains != "unknown"
    wrong = refusal(findings, loaded.recording.torque_units if measured else ())
    if wrong is not None:
        with _input.blaming(loaded.source, loaded.gains):
            raise wrong
    for message in _input.channel_warnings(findings):
        warnings.warn(f"{loaded.source}: {message}", DoubtWarning, stacklevel=2)


def _commanded(drive, robot, recording):
    """Return a recording for a simulation, and the drive that follows its commands."""
    # The drive is None where the torques of the recording take its place.
    if drive is not None and drive.of_positions:
        if _delay_of(robot) is not None:
            # The delay is that of the fit.
            drive = clone(drive).set_params(delay="auto")
        return recording, drive
    if drive is not None and drive.unsigned:
        recording = signed(getattr(robot, "robot_", robot), recording)
    return recording, None


def _delay_of(robot):
    """Return the delay of the commands of a fitted robot [s], None if not found."""
    late = [x.delay for x in robot.effects_ if isinstance(x, CommandDelay)]
    return late[0] if late else None


def _delay_line(drive, robot):
    """Return a line on the delay of the commands, in a list."""
    if drive is None:
        return []
    late = _delay_of(robot) if drive.waits is None else drive.waits
    if late is None:
        return ["commands act an unknown time after they are logged"]
    given = "" if drive.waits is None else ", as given,"
    return [f"commands act {1e3 * late:.3g} ms{given} after they are logged"]


def _rows_of(recording, rows):
    """Return a recording of some rows of a recording."""
    return take_rows(recording, rows, recording.groups[rows])


def _at(signals, rows):
    """Return signals at some rows."""
    if signals is None:
        return None
    if isinstance(signals, OfferedSignals):
        columns = {name: x[rows] for name, x in signals.columns.items()}
        return OfferedSignals(columns=columns, left_out=signals.left_out)
    return {name: x[rows] for name, x in signals.items()}


# -- simulation ------------------------------------------------------------------------


def _from_torques(task, seconds):
    """Simulate windows of the rows from torques."""
    part = _rows_of(task.recording, task.rows)
    known = {"window": seconds, "signals": task.signals}
    found = simulate_windows(
        task.robot, part.q, part.tau, part.groups, task.times, **known
    )
    return _Results(windows={_ROBOT: found})


def _from_commands(task, seconds):
    """Simulate whole recordings and windows from commands alone."""
    robot, part = task.robot.robot_, _rows_of(task.recording, task.rows)
    times = robot.clock(None, part.n_samples) if task.times is None else task.times
    cuts = [(np.arange(rows.start, rows.stop), None) for rows in part.segments]
    cuts.append((np.arange(part.n_samples), seconds))

    def run(robot, cut, beside=None):
        rows, window = cut
        return follow_windows(
            robot,
            task.drive,
            _rows_of(part, rows),
            times[rows],
            window=window,
            signals=_at(task.signals, rows),
            beside=beside,
        )

    found = [
        {_ROBOT: run(task.robot, cut)} for cut in counted(cuts, "simulating", "parts")
    ]
    note = ""
    # Torques in units of their channel are not those of a description.
    if robot.gains_ is None:
        try:
            described = robot.described()
            both = [
                {_DESCRIBED: run(described, cut, one[_ROBOT]), **one}
                for cut, one in zip(cuts, found)
            ]
            failed = [x for one in both for x in one[_DESCRIBED].failures]
            if failed:
                raise ValueError(failed[0].message)
            found = both
        except ValueError as error:
            note = f"{_DESCRIBED}: left out. {error}"
    *whole, windows = found
    # Rows of a whole recording are counted in all of them.
    whole = [
        {label: replace(x, starts=x.starts + rows.start) for label, x in one.items()}
        for one, rows in zip(whole, part.segments)
    ]
    return _Results(windows=windows, whole=whole, note=note)


# -- text ------------------------------------------------------------------------------


def _shown(task, results, seconds):
    """Return what the template of the text shows."""
    robot, count = results.windows[_ROBOT], results.windows[_ROBOT].n_windows
    complete = ~np.any([own.failed for own in results.windows.values()], axis=0)
    away = robot.run_away.any(axis=1)
    shown = {
        "recording": str(task.recording),
        "summary": task.summary,
        "seconds": seconds,
        "windows": _window_errors(results.windows, complete),
        "whole": _whole_errors(results.whole) if results.whole else {},
        "complete": int(complete.sum()),
        "count": count,
        "notes": [results.note, *(f"whole recordings: {x}" for x in results.failures)],
        "verdict": robot.verdict(),
        "failures": "",
        "away": f"in {away.sum()} of {count} windows" if away.any() else "",
        "rivals": robot.rivals,
    }

    def placed(k):
        name, begin, end = task.place(robot, k)
        return f"{name}, {begin:.3f} to {end:.3f} s"

    if robot.failures:
        first = robot.failures[0]
        shown["failures"] = f"{len(robot.failures)} of {count} windows"
        shown["first_failure"] = f"{placed(first.window)}: {first.message}"
    if away.any():
        k = np.flatnonzero(away)[0]
        joints = ", ".join(np.array(robot.joint_names)[robot.run_away[k]])
        shown["first_away"] = f"{joints} at {placed(k)}"
    return shown


def _window_errors(windows, complete):
    """Columns of the errors over windows, by their heads."""
    first = next(iter(windows.values()))
    scale, units = first.scales
    columns = {"": first.joint_names, "unit": units}
    for label, result in (windows | first.rivals).items():
        errors = result.errors[complete] * scale
        if not len(errors):
            errors = np.full((1, len(units)), np.nan)
        columns[label] = _cells(np.sqrt(np.mean(errors**2, axis=0)))
        if label in windows:
            # Heads differ in blanks where two robots are simulated.
            median = f"median{' ' * len(columns)}"
            columns[median] = _cells(np.median(errors, axis=0))
    return columns


def _whole_errors(whole):
    """Columns of the errors over whole recordings, by their heads."""
    first = next(iter(whole[0].values()))
    scale, units = first.scales
    columns = {"": first.joint_names, "unit": units}
    found = [one | next(iter(one.values())).rivals for one in whole]
    sizes = [next(iter(one.values())).t.size for one in whole]
    for label in found[0]:
        # One that failed has no error, and neither have all together.
        squares = [one[label].errors[0] ** 2 for one in found]
        columns[label] = _cells(scale * np.sqrt(np.average(squares, 0, weights=sizes)))
    return columns


def _cells(numbers):
    return ["none" if np.isnan(x) else f"{x:#.3g}".rstrip(".") for x in numbers]


def errors_table(task, results):
    """Return a table with one row per window and joint, as CSV."""
    first = next(iter(results.windows.values()))
    scale, units = first.scales
    file = io.StringIO(newline="")
    table = csv.writer(file, lineterminator="\n")
    heads = ["model", "recording", "from_s", "to_s", "joint", "unit"]
    heads += ["position_error", "velocity_error_per_s"]
    heads += [name.replace(" ", "_") for name in first.rivals]
    table.writerow([*heads, "failed"])
    # Whole recordings follow their windows.
    for own in (results.windows, *results.whole):
        for label, result in own.items():
            errors = [result.errors, result.velocity_errors]
            errors += [rival.errors for rival in result.rivals.values()]
            errors = scale * np.array(errors)
            messages = {one.window: one.message for one in result.failures}
            for k in range(result.n_windows):
                name, begin, end = task.place(result, k)
                place = [label, name, f"{begin:.6g}", f"{end:.6g}"]
                for j, joint in enumerate(result.joint_names):
                    cells = ["" if np.isnan(x) else f"{x:.6g}" for x in errors[:, k, j]]
                    row = [*place, joint, units[j], *cells, messages.get(k, "")]
                    table.writerow(map(_input.no_formula, row))
    return file.getvalue()
