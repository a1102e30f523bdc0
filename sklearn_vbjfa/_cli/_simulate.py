"""The command ``simulate``: the identified robot in motion, beside the measured one."""

import csv
import io
import textwrap
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._cli import READING, _close_loop, _input
from sklearn_vbjfa._cli._run import Done, blaming

# What a run writes.
_TABLE = "simulation.csv"
# Share of every recording that is identified; the rest is simulated.
_SHARE = 0.7
# Sample periods may differ by this share.
_JITTER = 0.01
_OF_IDENTIFICATION: tuple[str, ...] = (
    "urdf",
    "base_orientation",
    "friction",
    "bodies",
    "effects",
)
_OF_IDENTIFICATION += ("cutoff", "known_mass", "alike")
_OF_RECORDING = (*READING, "urdf", "base_orientation", "model", "signals")
# What a robot is called whose bodies are those of the description.
_DESCRIBED = "as described"
_WIDTH = 80  # characters of a line


def run(arguments, folder):
    """Simulate windows of a recording, tell their errors and write the files."""
    _check(arguments)
    files = _input.sources(arguments.recording or "demo")
    source, default = _input.named(files), _input.default_folder(files, "simulation")
    out = _input.free_folder(arguments, default, (_TABLE,))
    take = _identified if arguments.model is None else _saved
    task = take(arguments, source, folder)
    with blaming(source):
        found = _simulated(task, arguments.window, timed=arguments.model is None)
    text = errors_text(found, arguments.window)

    def write(folder, warned):
        table = errors_table(found)
        folder.joinpath(_TABLE).write_text(table, encoding="utf-8", newline="")
        return [""]

    return Done(
        text=text,
        doubts=doubts_of(found),
        folder=out,
        fresh=not arguments.force,
        files=(_TABLE,),
        write=write,
    )


def _check(arguments):
    """Refuse options that do not go together."""
    if not arguments.recording:
        _input.refuse_given(
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
    if len(arguments.recording) > 1 and not arguments.join:
        raise _input.Refused(
            f"simulate takes one recording, got {len(arguments.recording)} files; "
            "--join if they are one",
            {"join": True},
        )
    if arguments.model is not None:
        _input.refuse_given(
            arguments,
            _OF_IDENTIFICATION,
            "belongs to an identification, and the robot of --model is identified; "
            "give one of the two",
        )
    if not 0 < arguments.window < np.inf:
        raise ValueError(
            f"--window must be a positive number of seconds; got {arguments.window:g}."
        )


# -- robots ----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class _Task:
    """What is simulated."""

    recording: object
    rows: np.ndarray  # of the recording
    robots: dict  # by their labels
    signals: object  # what was recorded beside these rows
    summary: str  # what was identified, a line
    drive: object = None  # that the robots are told positions by; None for torques


def _windows_of(robots, *recording, by=None, **settings):
    """Simulate the same windows by several robots, of each label its windows."""
    from sklearn_vbjfa._core._progress import counted
    from sklearn_vbjfa.diagnosis import simulate_windows

    found, by = {}, by or simulate_windows
    for label in counted(robots, "simulating", "robots"):
        first = next(iter(found.values()), None)
        found[label] = by(robots[label], *recording, beside=first, **settings)
    return found


def _simulated(task, seconds, *, timed):
    """Simulate the same windows of the rows by each robot, as `Simulated`."""
    recording, rows = task.recording, task.rows
    # Saved models have a clock of their own.
    times = recording.clock()[rows] if timed else None
    known = {"recording": recording, "rows": rows, "summary": task.summary}
    if task.drive is not None:
        return Simulated(**known, **_followed(task, times, seconds))
    part = recording.q[rows], recording.tau[rows], recording.groups[rows], times
    windows = _windows_of(task.robots, *part, window=seconds, signals=task.signals)
    return Simulated(**known, windows=windows)


def _followed(task, times, seconds):
    """Simulate windows, and all rows, from commands alone; fields of `Simulated`."""
    from sklearn_vbjfa.robot import follow_windows

    part, one = _rows_of(task.recording, task.rows), next(iter(task.robots.values()))
    if times is None:
        times = one.robot_.clock(None, part.n_samples)
    cuts = [
        (
            _rows_of(part, np.arange(rows.start, rows.stop)),
            times[rows],
            {"window": None, "signals": _at(task.signals, rows)},
        )
        for rows in part.segments
    ]
    cuts.append((part, times, {"window": seconds, "signals": task.signals}))
    found = [
        _windows_of(task.robots, task.drive, *one, by=follow_windows, **settings)
        for *one, settings in cuts
    ]
    left = ""
    # Torques that have a unit of their own are not those of a description.
    if len(task.robots) == 1 and one.robot_.gains_ is None:
        try:
            found = _with_described(one.robot_, task.drive, cuts, found)
        except ValueError as error:
            left = f"{_DESCRIBED}: left out. {error}"
    *whole, windows = found
    whole = tuple(
        {
            label: replace(result, starts=result.starts + rows.start)
            for label, result in each.items()
        }
        for each, rows in zip(whole, part.segments)
    )
    return {"windows": windows, "whole": whole, "left": left}


def _with_described(robot, drive, cuts, found):
    """Put the robot of the description first, in the same windows of each cut."""
    from sklearn_vbjfa.robot import follow_windows

    described, both = robot.described(), []
    for (*part, settings), windows in zip(cuts, found):
        beside = next(iter(windows.values()))
        own = follow_windows(described, drive, *part, beside=beside, **settings)
        if own.failures:
            raise ValueError(own.failures[0].message)
        both.append({_DESCRIBED: own, **windows})
    return both


def _saved(arguments, source, folder):
    """Take a saved robot and the whole recording."""
    from sklearn_vbjfa import load_identified

    robot = load_identified(_input.expanded(arguments.model))
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
    drive = _input.drive(arguments.drive)
    loaded = _input.LoadedRecording(
        recording=recording, urdf=urdf, source=source, gains=gains, drive=drive
    )
    loaded.check_channels()
    effects = ", ".join(
        f"{effect.name} on {names[effect.joint]}" for effect in robot.effects_
    )
    summary = f"model: {arguments.model}, effects: {effects or 'none'}"
    if drive is not None:
        recording, drive = _commanded(drive, robot, recording)
    if drive is not None:
        late = _input.command_delay(robot)
        late = (
            f"{1e3 * late:.3g} ms" if late is not None else "a time that is not known"
        )
        if drive.waits is not None:
            late = f"{1e3 * drive.waits:.3g} ms, as given,"
        summary += f"\ncommands act {late} after they are logged"
    return _Task(
        recording=recording,
        rows=np.arange(recording.n_samples),
        robots={"simulated": robot},
        signals=loaded.signals(arguments.signals),
        summary=summary,
        drive=drive,
    )


def _commanded(drive, robot, recording):
    """Return a recording for a simulation, and the drive that is told its commands."""
    # The drive is None where the recording's torques take its place.
    if not drive.of_positions:
        return _input.followed(drive, robot, recording), None
    if _input.command_delay(robot) is not None:
        # The delay is that of the fit.
        drive = _input.replaced(drive, delay="auto")
    # Of all rows: parts of it have commands from before they begin.
    return drive.driven(replace(recording, command=None)), drive


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
    from sklearn_vbjfa.datasets import load_demo_recording

    settings, library = _input.settings(arguments), _input.library(arguments.effects)
    signals = None
    if not arguments.recording:
        demo = load_demo_recording()
        loaded = _input.LoadedRecording(recording=demo, urdf=demo.urdf, source=source)
    else:
        loaded = _input.load(arguments, folder)
        loaded.check_channels()
        signals = loaded.signals(arguments.signals)
    loaded.check(settings)
    recording = loaded.recording
    first, rest = _parts(recording)
    part = _rows_of(recording, first)
    known = {"t": recording.clock()[first], "signals": _at(signals, first)}
    settings["torque_noise"] = recording.torque_noise
    with blaming(source, loaded.gains):
        robots = _robots(part, str(loaded.urdf), library, known, settings)
    late, drive = "", settings.get("drive")
    if drive is not None:
        last = list(robots.values())[-1]
        recording, drive = _commanded(drive, last, recording)
        said = _input.said_delay(last)
        late = f"no torque was measured: {said}\n" if said else ""
    summary = late + (
        f"first {100 * _SHARE:g} % of every recording identified, the rest simulated\n"
        f"friction: {', '.join(settings['friction']) or 'none'}"
    )
    if loaded.held:
        summary = f"held at zero: {', '.join(loaded.held)}\n{summary}"
    if "completed" in robots:
        found = robots["completed"].effects_
        names = recording.joint_names
        listed = ", ".join(f"{one.name} on {names[one.joint]}" for one in found)
        summary += f"; completed by: {listed or 'nothing'}"
    return _Task(
        recording=recording,
        rows=rest,
        robots=robots,
        signals=_at(signals, rest),
        summary=summary,
        drive=drive,
    )


def _robots(recording, urdf, library, known, settings):
    """Identify the declared robot, and complete it if effects are to be looked for."""
    # known: dict of the times and signals of the rows.
    from sklearn_vbjfa import RobotIdentifier

    if not library:
        robot = RobotIdentifier(urdf, dt=recording.dt, **settings)
        if robot.drive is None:
            recording = replace(recording, t=known["t"])
        return {"simulated": robot.fit_inspected(recording)}
    loop = _close_loop.close(recording, urdf, effects=library, **known, **settings)
    robots = {"declared": loop.declared_}
    if loop.added_:
        robots["four plain terms"] = loop.baseline_
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
    from sklearn_vbjfa.recording import take_rows

    return take_rows(recording, rows, recording.groups[rows])


def _at(signals, rows):
    """Signals at some rows."""
    from sklearn_vbjfa.recording import OfferedSignals

    if signals is None:
        return None
    if isinstance(signals, OfferedSignals):
        columns = {name: x[rows] for name, x in signals.columns.items()}
        return OfferedSignals(columns=columns, left_out=signals.left_out)
    return {name: x[rows] for name, x in signals.items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulated:
    """Windows of a recording, simulated."""

    recording: object
    rows: np.ndarray  # of the recording that the windows are cut from
    windows: dict  # the same windows of each robot, by its label
    summary: str  # what was identified, some lines
    # the same of each recording as a whole, where commands alone drove the robots
    whole: tuple = ()
    left: str = ""  # what is not simulated, and why; empty for nothing


# -- what is said ----------------------------------------------------------------------


def errors_text(simulated, seconds):
    """Errors joint by joint, and what became of the windows."""
    windows = simulated.windows
    one = next(iter(windows.values()))
    whole = ~np.any([result.failed for result in windows.values()], axis=0)
    scale, units = one.scales
    positions = {"": one.joint_names, "unit": units}
    for label, result in (windows | one.rivals).items():
        errors = result.errors[whole] * scale
        positions[label] = _over_windows(errors, _rms)
        if label in windows:
            # Heads differ in blanks where two models are simulated.
            head = f"median{' ' * list(windows).index(label)}"
            positions[head] = _over_windows(errors, _median)
    which = "all" if whole.all() else f"{whole.sum()} of"
    lines = [
        str(simulated.recording),
        simulated.summary,
        "",
        f"position error over windows of {seconds:g} s, root mean square",
        _tabulated(positions),
        "",
        *_over_all(simulated),
        *_said_windows(simulated, f"{which} {whole.size} windows"),
    ]
    if simulated.left:
        lines += textwrap.wrap(simulated.left, _WIDTH)
    for text in [text for one in simulated.whole for text in _ended(one)]:
        lines += textwrap.wrap(f"whole recordings: {text}", _WIDTH)
    for label, result in windows.items():
        if label == _DESCRIBED:
            continue
        who = f"{label}: " if len(windows) > 1 else ""
        lines += ["", *_verdict(who, result)]
        if result.failures:
            lines += textwrap.wrap(who + _failed(simulated, result), _WIDTH)
        if result.run_away.any():
            lines += textwrap.wrap(who + _run_away(simulated, result), _WIDTH)
    return "\n".join(lines)


def _said_windows(simulated, count):
    """Say what windows are, and the columns of the table, lines of a terminal."""
    summary = f"{count}, each from the measured state at its start and "
    if simulated.whole:
        summary += (
            "told the recorded commands alone. median: of the windows' position "
            "errors; as told: a robot that is where it is told to be."
        )
    else:
        summary += (
            "driven by the measured torques. median: of the windows' position errors; "
            "stays, goes on: a robot that stays where it was, and one that keeps its "
            "velocity."
        )
    return textwrap.wrap(summary, _WIDTH)


def _over_all(simulated):
    """Tabulate errors over whole recordings, where these are simulated; lines."""
    if not simulated.whole:
        return []
    found = [
        {**result, **next(iter(result.values())).rivals} for result in simulated.whole
    ]
    counts = [next(iter(result.values())).t.size for result in simulated.whole]
    scale, units = next(iter(simulated.windows.values())).scales
    columns = {"": next(iter(found[0].values())).joint_names, "unit": units}
    for label in found[0]:
        # One that failed has no error, and neither have all together.
        squares = [result[label].errors[0] ** 2 for result in found]
        errors = scale * np.sqrt(np.average(squares, axis=0, weights=counts))
        columns[label] = _over_windows(errors[None], _rms)
    return [
        "over whole recordings, from their first states on",
        _tabulated(columns),
        "",
    ]


def doubts_of(simulated):
    """Say what stands against the simulation, a list of str."""
    # Of two models it is the last one that is handed on; a window that fails is left
    # out of the errors of both.
    windows = simulated.windows
    last = list(windows.values())[-1]
    failed = [result for result in windows.values() if result.failures]
    doubts = [f"{_failed_count(result)} failed" for result in failed]
    doubts += [text for one in simulated.whole for text in _ended(one)]
    if last.run_away.any():
        doubts.append(f"{_away_count(last)} joints ran away")
    return doubts if last.clearly_better.all() else [*doubts, last.verdict()]


def _tabulated(columns):
    """Write columns of text, the first two of them words, as a table."""
    from tabulate import tabulate

    return tabulate(
        list(zip(*columns.values())),
        headers=[head.strip() for head in columns],
        disable_numparse=True,
        colalign=("left", "left", *["right"] * (len(columns) - 2)),
    )


def _over_windows(errors, mean):
    """Write a mean of errors (n_windows, nv) for each joint, "none" without any."""
    found = mean(errors) if len(errors) else np.full(errors.shape[1], np.nan)
    # none is negative
    return ["none" if np.isnan(x) else f"{x:#.3g}".rstrip(".") for x in found]


def _rms(errors):
    return np.sqrt(np.mean(errors**2, axis=0))


def _median(errors):
    return np.median(errors, axis=0)


def _verdict(who, windows):
    """Say whether a model was needed for its errors, lines of a terminal."""
    summary = f"{who}{windows.verdict()} (windows compared one by one, mean of their "
    summary += "errors, Student's t at 5 %"
    if windows.failed.any():
        summary += "; a window that failed counts as the worst error of these"
    return textwrap.wrap(f"{summary})", _WIDTH)


def _failed(simulated, windows):
    """Say how many windows were not simulated to their end, and why the first was."""
    first = windows.failures[0]
    return (
        f"{_failed_count(windows)} failed (see {_TABLE}), the first at "
        f"{_placed(simulated, windows, first.window)}: {first.message}"
    )


def _ended(windows):
    """Say which whole recordings were not simulated to their end, a list of str."""
    # windows: of one recording as a whole, by label.
    return [
        f"{label}: {one.message}"
        for label, result in windows.items()
        for one in result.failures
    ]


def _failed_count(windows):
    return f"{len(windows.failures)} of {windows.n_windows} windows"


def _away_count(windows):
    return f"in {windows.run_away.any(axis=1).sum()} of {windows.n_windows} windows"


def _run_away(simulated, windows):
    """Say in how many windows joints ran away, and which in the first of them."""
    k = np.flatnonzero(windows.run_away.any(axis=1))[0]
    joints = ", ".join(np.array(windows.joint_names)[windows.run_away[k]])
    return (
        f"{_away_count(windows)} joints ran away, farther off than "
        f"{' and '.join(windows.rivals)} in any, first {joints} at "
        f"{_placed(simulated, windows, k)}"
    )


def _placed(simulated, windows, k):
    """Say where a window is."""
    name, begin, end = _place(simulated, windows, k)
    return f"{name}, {begin:.3f} to {end:.3f} s"


def _place(simulated, windows, k):
    """Return the recording of a window, and its times since the start of that [s]."""
    recording = simulated.recording
    row = simulated.rows[windows.starts[k]]
    label = recording.groups[row]
    begin = (row - recording.segments[label].start) * recording.dt
    length = windows.t[k, -1] - windows.t[k, 0]
    return _name(recording, label), begin, begin + length


def _name(recording, label):
    """Name of one of the recordings; that of the file if it holds a single one."""
    names = recording.group_names
    return recording.name if len(names) == 1 else names[label]


# -- files -----------------------------------------------------------------------------


def errors_table(simulated):
    """Return a table with one row per window and joint, as CSV."""
    one = next(iter(simulated.windows.values()))
    scale, units = one.scales
    rivals = list(one.rivals)
    file = io.StringIO(newline="")
    table = csv.writer(file, lineterminator="\n")
    heads = ["model", "recording", "from_s", "to_s", "joint", "unit"]
    heads += ["position_error", "velocity_error_per_s"]
    table.writerow([*heads, *(name.replace(" ", "_") for name in rivals), "failed"])
    # Whole recordings come behind their windows.
    rows = [
        (label, one)
        for each in (simulated.windows, *simulated.whole)
        for label, one in each.items()
    ]
    for label, result in rows:
        numbers = [result.errors, result.velocity_errors]
        numbers += [rival.errors for rival in result.rivals.values()]
        numbers = scale * np.array(numbers)
        why = {one.window: one.message for one in result.failures}
        for k in range(result.n_windows):
            name, begin, end = _place(simulated, result, k)
            for j, joint in enumerate(result.joint_names):
                row = [label, name, f"{begin:.6g}", f"{end:.6g}", joint, units[j]]
                row += ["" if np.isnan(x) else f"{x:.6g}" for x in numbers[:, k, j]]
                table.writerow(map(_input.no_formula, [*row, why.get(k, "")]))
    return file.getvalue()
