"""What the command ``simulate`` tells: errors, windows that failed, pictures."""

import csv
import importlib
import io
import os
import re
import textwrap
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa._cli._input import no_formula

# Most pictures, and most windows that failed and are named.
_MOST_PICTURES, _MOST_NAMED = 12, 5
_WIDTH = 80  # characters of a line
_RESOLUTION = 120  # dots per inch


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulated:
    """Windows of a recording, simulated."""

    recording: object
    rows: np.ndarray  # of the recording that the windows are cut from
    windows: dict  # the same windows of each robot, by its label
    told: str  # what was identified, some lines


# -- what is said ----------------------------------------------------------------------


def _scales(windows):
    """Factors (nv,) to degrees and mm, and these units."""
    slides = windows.prismatic
    units = tuple("mm" if sliding else "degrees" for sliding in slides)
    return np.where(slides, 1e3, 180 / np.pi), units


def errors_text(simulated, seconds):
    """Errors joint by joint, and what became of the windows."""
    windows = simulated.windows
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
        str(simulated.recording),
        simulated.told,
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
        who = f"{label}: " if len(windows) > 1 else ""
        lines += ["", *_verdict(who, own)]
        if own.failures:
            lines.append(who + _failed(simulated, own))
        if own.run_away.any():
            lines.append(who + _run_away(simulated, own))
    return "\n".join(lines)


def doubts_of(simulated):
    """Say what stands against the simulation, a list of str."""
    # Of two models it is the last one that is handed on; a window that fails is left
    # out of the errors of both.
    windows = simulated.windows
    last = list(windows.values())[-1]
    failed = [own for own in windows.values() if own.failures]
    doubts = [f"{_failed_count(own)} failed" for own in failed]
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


def _verdict(who, windows):
    """Say whether a model was needed for its errors, lines of a terminal."""
    told = f"{who}{windows.verdict()} (windows compared one by one, mean of their "
    told += "errors, Student's t at 5 %"
    if windows.failed.any():
        told += "; a window that failed counts as the worst error of these two"
    return textwrap.wrap(f"{told})", _WIDTH)


def _failed(simulated, windows):
    """Name windows that were not simulated to their end, and why."""
    count = len(windows.failures)
    told = [f"{_failed_count(windows)} failed:"]
    for one in windows.failures[:_MOST_NAMED]:
        told.append(f"- {_placed(simulated, windows, one.window)}: {one.message}")
    return _ended(told, count)


def _failed_count(windows):
    return f"{len(windows.failures)} of {windows.n_windows} windows"


def _away_count(windows):
    return f"in {windows.run_away.any(axis=1).sum()} of {windows.n_windows} windows"


def _run_away(simulated, windows):
    """Name windows in which joints ran away."""
    away = windows.run_away
    numbers = np.flatnonzero(away.any(axis=1))
    told = [
        f"{_away_count(windows)} joints ran away, farther off than stays and goes on "
        "in any:"
    ]
    for k in numbers[:_MOST_NAMED]:
        names = [n for n, out in zip(windows.joint_names, away[k]) if out]
        told.append(f"- {_placed(simulated, windows, k)}: {', '.join(names)}")
    return _ended(told, numbers.size)


def _ended(told, count):
    """Join the lines of a list, of which only the first are named."""
    if count > _MOST_NAMED:
        told.append(f"- and {count - _MOST_NAMED} more; see simulation.csv")
    return "\n".join(told)


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
    windows = simulated.windows
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
            name, begin, end = _place(simulated, own, k)
            for j, joint in enumerate(own.joint_names):
                row = [label, name, f"{begin:.6g}", f"{end:.6g}", joint, units[j]]
                numbers = errors[k, j], speeds[k, j], stays[k, j], goes_on[k, j]
                row += ["" if np.isnan(x) else f"{x:.6g}" for x in numbers]
                table.writerow(map(no_formula, [*row, why.get(k, "")]))
    return file.getvalue()


def pictures(simulated):
    """Draw each recording; name -> PNG file, and what is to be said of the others."""
    windows = simulated.windows
    from sklearn_vbjfa.diagnosis import SimulationDisplay

    # Files are drawn, no windows opened.
    os.environ.setdefault("MPLBACKEND", "Agg")
    pyplot = importlib.import_module("matplotlib.pyplot")
    one = next(iter(windows.values()))
    labels = simulated.recording.groups[simulated.rows[one.starts]]
    found = {}
    shown = np.unique(labels)
    for label in shown[:_MOST_PICTURES]:
        own = {name: w.select(labels == label) for name, w in windows.items()}
        display = SimulationDisplay(windows=own).plot()
        file = io.BytesIO()
        display.figure_.savefig(file, format="png", dpi=_RESOLUTION)
        pyplot.close(display.figure_)
        name = re.sub(r"[^\w-]+", "_", _name(simulated.recording, label))[:60]
        name = f"{name}.png"
        if name in found:
            name = f"{label + 1}_{name}"
        found[name] = file.getvalue()
    left = ""
    if shown.size > _MOST_PICTURES:
        left = f" (pictures of {_MOST_PICTURES} of {shown.size} recordings)"
    return found, left
