"""The command ``simulate``: simulation of a saved robot against a recording."""

import json
import shlex
import warnings
from dataclasses import replace

import numpy as np

from sklearn_vbjfa import load_identified
from sklearn_vbjfa._cli import _input
from sklearn_vbjfa._cli._parser import Refused, command_line, parse
from sklearn_vbjfa._cli._run import Result, render_template
from sklearn_vbjfa.diagnosis import simulate_windows
from sklearn_vbjfa.diagnosis.explain import ABOVE_FLOOR, WELL, is_refuted
from sklearn_vbjfa.equations._states import fit_states
from sklearn_vbjfa.fit import signed
from sklearn_vbjfa.inspection import refusal
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import OfferedSignals
from sklearn_vbjfa.robot import follow_windows

_TABLE = "simulation.csv"
# Options by which a log is read; one given replaces its group.
_OPTIONS = [{"columns", "preset"}, {"gain", "drive"}]
_OPTIONS += [{x} for x in ("topic", "dt", "time_unit", "join", "joints")]


def simulate(arguments, folder):
    """Simulate windows of a recording; print and write their errors."""
    if arguments.model is None:
        raise ValueError("give --model FILE, the identified.json of identify.")
    out = _input.output_folder(arguments, "simulation")
    path = _input.expand(arguments.model)
    robot = load_identified(path / "identified.json" if path.is_dir() else path)
    recording, arguments, taken, findings = _recording(arguments, robot, folder)
    if (dt := recording.dt) != robot.dt:
        estimator = fit_states(dt, "auto", recording.q, recording.groups)
        plan = replace(robot.plan, dt=dt, state_estimator=estimator)
        robot = replace(robot, plan=plan)
    with _input.naming_input(arguments):
        if arguments.drive is None and findings:
            # The model may hold effects that the description lacks.
            residuals = robot.residuals_of(recording)
            at_floor = residuals.rms() <= ABOVE_FLOOR[1] * robot.noise_floor_
            good = at_floor, at_floor | (residuals.normalised_error() < WELL)
            findings = [x for x in findings if not is_refuted(x, *good)]
        for finding in findings:
            message = f"{_input.log_name(arguments)}: {finding.message}"
            warnings.warn(message, DoubtWarning, stacklevel=2)
        windows = _windows(arguments, robot, recording)
    # Recording of each window, and its begin and end in it [s].
    places, names = [], recording.group_names
    for row, t in zip(windows.starts, windows.t):
        label = recording.groups[row]
        begin = (row - recording.segments[label].start) * recording.dt
        name = recording.name if len(names) == 1 else names[label]
        places.append((name, begin, begin + t[-1] - t[0]))
    verdict, failed = windows.verdict(), ""
    for k, message in [*windows.failures.items()][:1]:
        name, begin, end = places[k]
        failed = (
            f"{len(windows.failures)} of {windows.n_windows} windows failed, the first "
            f"at {name}, {begin:.3f} to {end:.3f} s: {message}"
        )
    text = render_template(
        "simulation.txt.j2",
        recording=recording,
        taken=taken,
        seconds=arguments.window,
        windows=windows,
        errors=_error_columns(windows),
        verdict=verdict,
        failures=failed,
    )

    def write(folder, notes):
        path = folder / _TABLE
        path.write_text(errors_table(windows, places), encoding="utf-8", newline="")
        return [""]

    unclear = "" if windows.clearly_better.all() else verdict
    doubts = [line for line in (failed, unclear) if line]
    return Result(text=text, doubts=doubts, folder=out, files=(_TABLE,), write=write)


def _recording(arguments, robot, folder):
    """Return the recording, arguments, options of the report, and warnings."""
    names, has_gains = robot.joint_names_, robot.gains_ is not None
    urdf = folder / "robot.urdf"
    urdf.write_text(robot.description_, encoding="utf-8")
    taken = _options_of_report(arguments)
    arguments = parse(shlex.split(command_line(arguments, taken))[3:])
    given = arguments.gain not in (None, "unknown")
    if given if has_gains else arguments.gain == "unknown":
        units = "the units of its channels" if has_gains else "N m or N"
        raise ValueError(
            f"{arguments.model} was identified with torques in {units}; "
            f"{'leave --gain out' if has_gains else 'give the factors (--gain)'}."
        )
    gains = "unknown" if has_gains else arguments.gain
    try:
        recording = _input.read(arguments, urdf, arguments.joints or names, gains)
    except ValueError as error:
        reason = f"{error}{' (read with the options of the report)' if taken else ''}"
        raise Refused(reason, **getattr(error, "options", {})) from error
    source = _input.log_name(arguments)
    if set(recording.joint_names) != set(names):
        raise ValueError(
            f"{source}: has the joints {', '.join(recording.joint_names)}; expected "
            f"those of {arguments.model}: {', '.join(names)}."
        )
    findings = _input.findings(arguments, recording, urdf, gains)
    measured = arguments.drive is None and not has_gains
    refused = refusal(findings, recording.torque_units if measured else ())
    if refused is not None:
        with _input.naming_input(arguments):
            raise refused
    findings = [finding for finding in findings if finding.severity != "note"]
    return recording, arguments, taken, findings


def _options_of_report(arguments):
    """Return the options of the report of a saved robot that are not given."""
    path = _input.expand(arguments.model)
    path = (path if path.is_dir() else path.parent) / "report.json"
    if not path.is_file():
        return {}
    # Reports of gravity compensation have no provenance.
    provenance = json.loads(path.read_text(encoding="utf-8")).get("provenance", {})
    wanted = [x for x in _OPTIONS if x.isdisjoint(arguments.typed)]
    options = provenance.get("options", {}).items()
    return {x: text for x, text in options if x in set().union(*wanted)}


def _windows(arguments, robot, recording):
    drive, signals = arguments.drive, OfferedSignals.from_recording(recording)
    settings = {"window": arguments.window, "signals": signals}
    if drive is not None and drive.uses_positions:
        return follow_windows(robot, drive, recording, **settings)
    if drive is not None and drive.unsigned:
        recording = signed(robot, recording)
    arrays = recording.q, recording.tau, recording.groups
    return simulate_windows(robot, *arrays, **settings)


def _error_columns(windows):
    scale, units = windows.scales
    complete = ~windows.failed
    columns = {"": windows.joint_names, "unit": units}
    for head, model in ({"simulated": windows} | windows.rivals).items():
        rms = np.full(len(units), np.nan)
        if complete.any():
            rms = scale * np.sqrt(np.mean(model.errors[complete] ** 2, axis=0))
        columns[head] = ["none" if x != x else f"{x:#.3g}".rstrip(".") for x in rms]
    return columns


def errors_table(windows, places):
    import pandas as pd

    (n, nv), (scale, units) = windows.errors.shape, windows.scales
    names, begins, ends = zip(*places)
    failures = [windows.failures.get(k, "") for k in range(n)]
    columns = {
        "recording": np.repeat([*map(_input.escape_formula, names)], nv),
        "from_s": np.repeat(begins, nv),
        "to_s": np.repeat(ends, nv),
        "joint": np.tile([*map(_input.escape_formula, windows.joint_names)], n),
        "unit": np.tile(units, n),
    }
    for name, model in ({"position_error": windows} | windows.rivals).items():
        columns[name.replace(" ", "_")] = (scale * model.errors).ravel()
    columns["failed"] = np.repeat([*map(_input.escape_formula, failures)], nv)
    table = pd.DataFrame(columns)
    return table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
