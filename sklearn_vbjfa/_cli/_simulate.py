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
from sklearn_vbjfa.diagnosis.explain import parameter_values
from sklearn_vbjfa.effects import CommandDelay
from sklearn_vbjfa.fit import signed
from sklearn_vbjfa.inspection import refusal
from sklearn_vbjfa.recording import OfferedSignals, take_rows

_TABLE = "simulation.csv"
# Share of every recording that is identified; the rest is simulated.
_SHARE = 0.7
# Sample periods may differ by this share.
_JITTER = 0.01
_OF_IDENTIFICATION: tuple[str, ...] = ("urdf", "base_orientation", "friction")
_OF_IDENTIFICATION += ("bodies", "cutoff", "known_mass", "shared_drives")
# The robot, and the one whose bodies are those of the description.
_ROBOT, _DESCRIBED = "simulated", "as described"


@dataclass(kw_only=True, eq=False)
class _Simulation:
    """Windows of a recording, simulated."""

    recording: object
    rows: np.ndarray  # of the recording, that the windows are cut from
    times: np.ndarray | None  # of these rows; None counts from the fit of the robot
    robot: object
    signals: object  # of these rows
    summary: list
    drive: object = None  # that the robot follows commands by; None for torques
    windows: dict = field(default_factory=dict)  # simulated windows, by robot
    whole: list = field(default_factory=list)  # the same of each whole recording
    note: str = ""  # why the described robot is not simulated

    @property
    def failures(self):
        """Messages on whole recordings that were not simulated to their end."""
        return [
            f"{label}: {failure.message}"
            for one in self.whole
            for label, result in one.items()
            for failure in result.failures
        ]

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


def simulate(arguments, folder):
    """Simulate windows of a recording, print their errors and write them."""
    _check(arguments)
    out = _input.output_folder(arguments, "simulation")
    prepare = _identified if arguments.model is None else _saved
    task = prepare(arguments, folder)
    with _input.blaming(_input.named(arguments)):
        run = _drive if task.drive is None else _follow
        run(task, arguments.window)
    shown = _shown(task, arguments.window)

    def write(folder, notes):
        path = folder / _TABLE
        path.write_text(errors_table(task), encoding="utf-8", newline="")
        return [""]

    windows = task.windows[_ROBOT]
    doubts = [f"{shown['failures']} failed"] if windows.failures else []
    doubts += task.failures
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
                f"{spelled(name)} belongs to an identification, and the robot of "
                "--model is identified; give one of the two."
            )


# -- robots ----------------------------------------------------------------------------


def _saved(arguments, folder):
    """Take a saved robot and the whole recording."""
    robot = load_identified(_input.expanded(arguments.model))
    joints = arguments.joints
    names, source = robot.joint_names_, _input.named(arguments)
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
    if drive is not None:
        late = _command_delay(robot) if drive.waits is None else drive.waits
        late = "an unknown time" if late is None else f"{1e3 * late:.3g} ms"
        given = "" if drive.waits is None else ", as given,"
        summary.append(f"commands act {late}{given} after they are logged")
    return _Simulation(
        recording=recording,
        rows=np.arange(recording.n_samples),
        times=None,
        robot=robot,
        signals=loaded.signals(arguments.signals),
        summary=summary,
        drive=drive,
    )


def _saved_gains(arguments, robot):
    """Return the gains of a recording for a saved robot, "unknown" for its own."""
    relative = robot.gains_ is not None
    if relative and arguments.gain not in (None, "unknown"):
        raise ValueError(
            f"{arguments.model} was identified with unknown gains, so that its torques "
            "are what the channels read; leave --gain out."
        )
    if arguments.gain == "unknown" and not relative:
        raise ValueError(
            f"--gain unknown belongs to an identification, and {arguments.model} was "
            "identified from torques in N m or N; give the factors to them."
        )
    return "unknown" if relative else arguments.gain


def _check_channels(loaded):
    """Refuse channels that are not what they are called; warn of doubtful ones."""
    from sklearn_vbjfa.model import DoubtWarning

    findings = loaded.findings()
    measured = loaded.drive is None and loaded.gains != "unknown"
    wrong = refusal(findings, loaded.recording.torque_units if measured else ())
    if wrong is not None:
        with _input.blaming(loaded.source, loaded.gains):
            raise wrong
    for message in _input.channel_doubts(findings):
        warnings.warn(f"{loaded.source}: {message}", DoubtWarning, stacklevel=2)


def _identified(arguments, folder):
    """Identify the first part of every recording, for the rest."""
    settings, loaded = _input.settings(arguments), _input.load(arguments, folder)
    _check_channels(loaded)
    signals, recording = loaded.signals(arguments.signals), loaded.recording
    first, rest = [], []
    for part in recording.segments:
        border = part.start + round(_SHARE * (part.stop - part.start))
        first += range(part.start, border)
        rest += range(border, part.stop)
    first, rest = np.array(first), np.array(rest)
    noise, drive = recording.torque_noise, arguments.drive
    settings["options"] = replace(settings["options"], torque_noise=noise)
    robot = RobotIdentifier(str(loaded.urdf), dt=recording.dt, **settings)
    part = _rows_of(recording, first)
    if drive is None:
        part = replace(part, t=recording.clock()[first])
    with _input.blaming(loaded.source, loaded.gains):
        robot.fit_inspected(part)
    summary = [f"held at zero: {', '.join(loaded.held)}"] if loaded.held else []
    recording, drive = _commanded(drive, robot, recording)
    if delay := _said_delay(robot):
        summary.append(f"no torque was measured: {delay}")
    return _Simulation(
        recording=recording,
        rows=rest,
        times=recording.clock()[rest],
        robot=robot,
        signals=_at(signals, rest),
        summary=[
            *summary,
            f"first {100 * _SHARE:g} % of every recording identified, the rest "
            "simulated",
            f"friction: {', '.join(settings['friction']) or 'none'}",
        ],
        drive=drive,
    )


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


# -- drives ----------------------------------------------------------------------------


def _commanded(drive, robot, recording):
    """Return a recording for a simulation, and the drive that follows its commands."""
    # The drive is None where the torques of the recording take its place.

    if drive is not None and drive.of_positions:
        if _command_delay(robot) is not None:
            # The delay is that of the fit.
            drive = clone(drive).set_params(delay="auto")
        return recording, drive
    if drive is not None and drive.unsigned:
        recording = signed(getattr(robot, "robot_", robot), recording)
    return recording, None


def _command_delay(robot):
    """Return the delay of the commands of a fitted robot [s], None if not found."""
    late = [x.delay for x in robot.effects_ if isinstance(x, CommandDelay)]
    return late[0] if late else None


def _said_delay(robot):
    """Return a sentence on the delay of the commands, "" for nothing found."""
    from sklearn_vbjfa.diagnosis.report import sentence

    rows = [one for one in parameter_values(robot) if one.name == "drive:delay"]
    return " ".join(f"{sentence('delay', x.value, x.interval)}." for x in rows)


# -- simulation ------------------------------------------------------------------------


def _drive(task, seconds):
    """Simulate windows of the rows from torques."""
    part = _rows_of(task.recording, task.rows)
    task.windows[_ROBOT] = simulate_windows(
        task.robot,
        part.q,
        part.tau,
        part.groups,
        task.times,
        window=seconds,
        signals=task.signals,
    )


def _follow(task, seconds):
    """Simulate whole recordings and windows from commands alone."""
    from sklearn_vbjfa.robot import follow_windows

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
            task.note = f"{_DESCRIBED}: left out. {error}"
    *task.whole, task.windows = found
    for one, rows in zip(task.whole, part.segments):
        for label, result in one.items():
            one[label] = replace(result, starts=result.starts + rows.start)


# -- text ------------------------------------------------------------------------------


def _shown(task, seconds):
    """Return what the template of the text shows."""
    robot, count = task.windows[_ROBOT], task.windows[_ROBOT].n_windows
    complete = ~np.any([result.failed for result in task.windows.values()], axis=0)
    away = robot.run_away.any(axis=1)
    shown = {
        "recording": str(task.recording),
        "summary": task.summary,
        "seconds": seconds,
        "windows": _window_errors(task.windows, complete),
        "whole": _whole_errors(task.whole) if task.whole else {},
        "complete": int(complete.sum()),
        "count": count,
        "notes": [task.note, *(f"whole recordings: {x}" for x in task.failures)],
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
        columns[label] = _cells(np.sqrt(_mean(errors**2)))
        if label in windows:
            # Heads differ in blanks where two robots are simulated.
            columns[f"median{' ' * len(columns)}"] = _cells(_mean(errors, np.median))
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


def _mean(errors, mean=np.mean):
    """Return a mean over windows, nan without any."""
    return mean(errors, axis=0) if len(errors) else np.full(errors.shape[1], np.nan)


def _cells(numbers):
    return ["none" if np.isnan(x) else f"{x:#.3g}".rstrip(".") for x in numbers]


def errors_table(task):
    """Return a table with one row per window and joint, as CSV."""
    first = next(iter(task.windows.values()))
    scale, units = first.scales
    file = io.StringIO(newline="")
    table = csv.writer(file, lineterminator="\n")
    heads = ["model", "recording", "from_s", "to_s", "joint", "unit"]
    heads += ["position_error", "velocity_error_per_s"]
    heads += [name.replace(" ", "_") for name in first.rivals]
    table.writerow([*heads, "failed"])
    # Whole recordings follow their windows.
    for label, result in (
        pair for each in (task.windows, *task.whole) for pair in each.items()
    ):
        errors = [result.errors, result.velocity_errors]
        errors += [rival.errors for rival in result.rivals.values()]
        errors = scale * np.array(errors)
        messages = {one.window: one.message for one in result.failures}
        for k in range(result.n_windows):
            name, begin, end = task.place(result, k)
            for j, joint in enumerate(result.joint_names):
                row = [label, name, f"{begin:.6g}", f"{end:.6g}", joint, units[j]]
                row += ["" if np.isnan(x) else f"{x:.6g}" for x in errors[:, k, j]]
                table.writerow(map(_input.no_formula, [*row, messages.get(k, "")]))
    return file.getvalue()
