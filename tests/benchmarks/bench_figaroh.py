"""FIGAROH 1.x and this package side by side on two measured robots.

Run ``python tests/benchmarks/bench_figaroh.py --figaroh-python PYTHON [--data-home DIR]
[--write]``, where PYTHON is the interpreter of an environment with FIGAROH (``python -m
venv ENV && ENV/bin/pip install figaroh``). Each user script of ``side_by_side`` runs in
a process and a folder of its own, on one thread, and leaves its prediction of the
held-out torques there; the errors are taken here, in the same way for all.
"""

import ast
import io
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import textwrap
import time
import tokenize
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _report import fixed, parser, publish, rst_table, rst_title
from scipy import signal

from sklearn_vbjfa.datasets import protocols

SCRIPTS = Path(__file__).resolve().parent / "side_by_side"
SETS = ("ur5", "staubli_tx40")
# The user scripts of this package, which run in processes of their own.
ENTERS = (
    "side_by_side.vbjfa_user",
    "side_by_side.vbjfa_user_coupled",
    "side_by_side.vbjfa_user_discovery",
)
# Speeds [rad/s] at or below which a sample counts as standstill for FIGAROH; by the
# protocol on the UR5, some 2 % of the top speeds on the TX40.
STANDSTILL = {"ur5": 0.03, "staubli_tx40": 0.02}
# Everything that either tool imports sooner or later, so that the time after import
# is that of the computation.
MODULES = {
    "figaroh": "figaroh,pinocchio,scipy.signal,pandas,picos,cvxopt",
    "vbjfa": "sklearn_vbjfa,pinocchio,scipy.signal,clarabel,sklearn.linear_model",
}
_START = """
import importlib, json, runpy, sys, time
modules, *sys.argv = sys.argv[1:]
for name in modules.split(","):
    importlib.import_module(name)
started = time.perf_counter()
runpy.run_path(sys.argv[0], run_name="__main__")
with open("seconds.json", "w") as file:
    json.dump(time.perf_counter() - started, file)
"""
_REFUSED = "Reported estimate: none"
_STAGE = "select_stage: physical_fit"
_WIDTH = 100


@dataclass(frozen=True, kw_only=True)
class Contestant:
    """One row of the table: a user script and what it is started with.

    `stage` is the estimate that FIGAROH reports, "fit" or "physical_fit"; a `long` one
    runs once; what a `quoted` one says goes into the guide.
    """

    label: str
    files: tuple[str, ...]
    arguments: tuple[str, ...] = ()
    stage: str = ""
    long: bool = False
    quoted: bool = False

    @property
    def tool(self):
        return self.files[0].split("_")[0]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a user script left behind: prediction, output, seconds, text of a file."""

    predicted: np.ndarray
    said: str
    seconds: float
    seconds_with_import: float
    kept: str | None = None


def contestants(name, cutoff, dt):
    """Rows of one robot, in order."""
    # scipy.signal.decimate passes 0.8 of the new Nyquist frequency.
    same_band = max(1, round(0.8 / (2 * cutoff * dt)))

    def figaroh(words, decimation=10, stage="fit", extra=(), quoted=False):
        return Contestant(
            label=f"FIGAROH, {words}",
            files=("figaroh_user.py", *extra),
            arguments=(str(decimation), str(STANDSTILL[name])),
            stage=stage,
            quoted=quoted,
        )

    rows = [
        Contestant(label="RobotIdentifier", files=("vbjfa_user.py",), quoted=True),
        Contestant(
            label="EffectDiscovery",
            files=("vbjfa_user_discovery.py",),
            long=True,
            quoted=True,
        ),
        figaroh("base parameters, decimation 10"),
        figaroh(f"base parameters, decimation {same_band}", same_band),
        figaroh("physical fit, decimation 10", stage="physical_fit", quoted=True),
    ]
    if name == "ur5":
        by_joint = ("figaroh_user_by_joint.py",)
        rows += [
            figaroh("base parameters, standing joints out", extra=by_joint),
            figaroh(
                "physical fit, standing joints out",
                stage="physical_fit",
                extra=by_joint,
            ),
        ]
    else:
        coupled = ("figaroh_user_coupled.py",)
        rows += [
            Contestant(
                label="RobotIdentifier, coupled wrist",
                files=("vbjfa_user_coupled.py",),
            ),
            figaroh("base parameters, coupled wrist", extra=coupled),
            figaroh("physical fit, coupled wrist", stage="physical_fit", extra=coupled),
        ]
    return rows


def count_lines(text, suffix):
    """Lines that are neither blank nor comment nor docstring.

    Parameters
    ----------
    text : str
        Contents of a file.
    suffix : {".py", ".yaml", ".json"}
        Its kind.
    """
    if suffix != ".py":
        lines = (line.strip() for line in text.splitlines())
        return sum(bool(line) and not line.startswith("#") for line in lines)
    code = set()
    skipped = {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in skipped:
            code.update(range(token.start[0], token.end[0] + 1))
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, kinds) and ast.get_docstring(node) is not None:
            code -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(code)


def user_lines(contestant, name):
    """Lines of the scripts and of the settings that a user writes for one robot."""
    settings = "figaroh_{}.yaml" if contestant.tool == "figaroh" else "vbjfa_{}.json"
    files = [SCRIPTS / file for file in (*contestant.files, settings.format(name))]
    return [count_lines(f.read_text(encoding="utf-8"), f.suffix) for f in files]


def speeds(part, sos):
    """Absolute speeds [rad/s], (n_samples, nv), of smoothed positions."""
    result = np.empty_like(part["q"])
    for rows in recordings(part):
        smooth = signal.sosfiltfilt(sos, part["q"][rows], axis=0)
        result[rows] = np.abs(np.gradient(smooth, part["dt"], axis=0))
    return result


def recordings(part):
    """Row numbers of each recording."""
    return [np.flatnonzero(part["groups"] == x) for x in np.unique(part["groups"])]


def held_out_error(predicted, part, fitted, cutoff, standstill):
    """Root mean square of the torque residual over the deviation of the torque.

    Measured and predicted torque pass the same filter, a Butterworth low-pass of order
    4 in both directions. Left out are samples of a joint that stands still and those
    within 2 / `cutoff` of the ends of a recording.

    Parameters
    ----------
    predicted : ndarray of shape (n_samples, nv)
        Prediction for the rows of `part` [N m].
    part, fitted : mapping
        Held-out and fitted part: q, tau (n_samples, nv), groups (n_samples,) and dt.
    cutoff : float
        Cut-off [Hz].
    standstill : float or "auto"
        Speed [rad/s]; ``"auto"``: 2 % of the 99.5th percentile of each joint's speed
        in the fitted part.

    Returns
    -------
    error : ndarray of shape (nv,)
        Share of the standard deviation.
    counts : ndarray of shape (nv,)
        Samples that count.
    """
    sos = signal.butter(4, cutoff, fs=1 / part["dt"], output="sos")
    if isinstance(standstill, str):
        standstill = 0.02 * np.quantile(speeds(fitted, sos), 0.995, axis=0)
    counted = speeds(part, sos) > standstill
    torque = np.empty_like(part["tau"])
    residual = np.empty_like(torque)
    margin = round(2 / cutoff / part["dt"])
    for rows in recordings(part):
        torque[rows] = signal.sosfiltfilt(sos, part["tau"][rows], axis=0)
        missed = part["tau"][rows] - predicted[rows]
        residual[rows] = signal.sosfiltfilt(sos, missed, axis=0)
        counted[rows[:margin]] = counted[rows[len(rows) - margin :]] = False
    error = [
        np.sqrt(np.mean(missed[which] ** 2)) / true[which].std()
        for missed, true, which in zip(residual.T, torque.T, counted.T)
    ]
    return np.array(error), counted.sum(axis=0)


def load(name, data_home):
    """Return protocol, recording and the fitted and held-out part of one set."""
    protocol = protocols()[name]
    recording = protocol.load(data_home=data_home)
    parts = [
        {
            "q": recording.q[rows],
            "tau": recording.tau[rows],
            "groups": recording.groups[rows],
            "dt": recording.dt,
        }
        for rows in protocol.split(recording)
    ]
    return protocol, recording, *parts


def write_description(source, target):
    """Copy a URDF without its shapes: FIGAROH asks for the mesh files they name."""
    tree = ET.parse(source)
    for link in tree.getroot().iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    tree.write(target, encoding="utf-8", xml_declaration=True)


def run_script(contestant, python, urdf, parts, settings, kept=None):
    """Run one user script in a folder and a process of its own.

    Parameters
    ----------
    contestant : Contestant
        What to run.
    python : str
        Interpreter.
    urdf : str
        Robot description.
    parts : tuple of mapping
        Fitted and held-out part.
    settings : Path
        Settings file of the tool for this robot.
    kept : str, default=None
        Name of a file that the script may leave.
    """
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        write_description(urdf, folder / "robot.urdf")
        for key, part in zip(("fitted", "held_out"), parts):
            arrays = {k: part[k] for k in ("q", "tau", "groups", "dt")}
            np.savez(folder / f"{key}.npz", **arrays)
        text = settings.read_text(encoding="utf-8")
        if contestant.stage == "fit":
            text = text.replace(_STAGE, "select_stage: fit")
        (folder / f"settings{settings.suffix}").write_text(text, encoding="utf-8")
        for file in contestant.files:
            shutil.copy(SCRIPTS / file, folder)
        one_thread = dict.fromkeys(
            ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
        )
        command = [python, "-c", _START, MODULES[contestant.tool]]
        started = time.perf_counter()
        answer = subprocess.run(
            [*command, contestant.files[-1], *contestant.arguments],
            cwd=folder,
            env={**os.environ, **one_thread, "MPLBACKEND": "Agg", "PYTHONUTF8": "1"},
            capture_output=True,
            encoding="utf-8",
            check=False,
        )
        seconds = time.perf_counter() - started
        if answer.returncode != 0:
            last = answer.stderr.strip().splitlines()[-1]
            raise RuntimeError(f"{contestant.label} ended with an error: {last}")
        left = kept is not None and (folder / kept).exists()
        return Outcome(
            kept=(folder / kept).read_text(encoding="utf-8") if left else None,
            predicted=np.load(folder / "predicted.npy"),
            said=answer.stdout,
            seconds=json.loads((folder / "seconds.json").read_text(encoding="utf-8")),
            seconds_with_import=seconds,
        )


def measure(name, data_home, pythons, repeats, chosen=contestants):
    """Paragraphs of one robot: errors and times, lines to write, and what was said."""
    protocol, recording, fitted, held_out = load(name, data_home)
    entries = chosen(name, protocol.cutoff, recording.dt)
    runs = {row.label: [] for row in entries}
    # Round by round, so that what else the machine does hits all alike.
    for number in range(repeats):
        for row in entries:
            if number == 0 or not row.long:
                suffix = "yaml" if row.tool == "figaroh" else "json"
                outcome = run_script(
                    row,
                    pythons[row.tool],
                    recording.urdf,
                    (fitted, held_out),
                    SCRIPTS / f"{row.tool}_{name}.{suffix}",
                )
                runs[row.label].append(outcome)
                print(row.label, f"{outcome.seconds:.1f} s", file=sys.stderr)
    rows, lines, quotes = [], [], []
    for row in entries:
        first = runs[row.label][0]
        error, counts = held_out_error(
            first.predicted, held_out, fitted, protocol.cutoff, protocol.standstill
        )
        refused = [x.strip() for x in first.said.splitlines() if _REFUSED in x]
        if refused:
            # What it predicts then is the estimate of another row.
            error = np.full_like(error, np.nan)
            quotes.append(f"What {row.label} says: ``{refused[0]}``")
        seconds = np.min(
            [[run.seconds, run.seconds_with_import] for run in runs[row.label]], axis=0
        )
        percent = 100 * error
        rows.append(
            [row.label, *fixed(percent), *fixed([percent.mean()]), *fixed(seconds)]
        )
        script, *additions, setting = user_lines(row, name)
        total = script + sum(additions) + setting
        lines.append([row.label, script, sum(additions), setting, total])
        if row.quoted:
            quotes += [f"What {row.label} says:", quotation(first.said)]
    joints = [f"j{j + 1}" for j in range(recording.nv)]
    split = protocol.describe(recording)
    return [
        rst_title(name, "~"),
        f"{recording}. {split[0].upper()}{split[1:]}. Filter of the comparison: "
        f"{protocol.cutoff:g} Hz; samples that count: "
        f"{', '.join(str(n) for n in counts)}.",
        rst_table(
            rows, ["error [%]", *joints, "mean", "s", "s with import"], n_labels=1
        ),
        rst_table(lines, ["lines", "script", "addition", "settings", "sum"]),
        *quotes,
    ]


def quotation(said):
    """Literal block of the lines of an output that judge the model."""
    lines = said.strip().splitlines()
    if "QUALITY REPORT" in said:
        # Of FIGAROH's report: the held-out part, the estimate and the insights.
        start = next(i for i, line in enumerate(lines) if "Validation (" in line)
        lines = [
            *(line for line in lines[:start] if "Reported estimate" in line),
            *(line for line in lines[start:] if set(line.strip()) != {"="}),
        ]
    wrapped = [
        piece
        for line in textwrap.dedent("\n".join(lines)).splitlines()
        for piece in textwrap.wrap(line, _WIDTH, subsequent_indent="    ") or [""]
    ]
    return ".. code-block:: text\n\n" + textwrap.indent("\n".join(wrapped), "    ")


def figaroh_versions(python):
    """Versions in FIGAROH's environment, or one line that says what is missing."""
    ask = (
        "import importlib.metadata as m, platform; print('Python', "
        "platform.python_version(), *(n + ' ' + m.version(n) for n in "
        "('figaroh', 'pin', 'numpy', 'scipy', 'picos', 'cvxopt')), sep='|')"
    )
    try:
        answer = subprocess.run(
            [python, "-c", ask], capture_output=True, text=True, check=True
        )
    except FileNotFoundError:
        raise SystemExit(
            f"No interpreter at {python}; make one with: python -m venv ENV && "
            "ENV/bin/pip install figaroh."
        ) from None
    except subprocess.CalledProcessError as error:
        last = error.stderr.strip().splitlines()[-1]
        raise SystemExit(
            f"{python} has no FIGAROH ({last}); install it there: pip install figaroh."
        ) from None
    word, *versions = answer.stdout.strip().split("|")
    return f"{word} {', '.join(versions)}"


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--figaroh-python", required=True, metavar="PYTHON")
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument("--data", nargs="*", default=SETS, choices=SETS)
    arguments.add_argument("--repeats", type=int, default=3)
    arguments = arguments.parse_args(argv)
    versions = figaroh_versions(arguments.figaroh_python)
    pythons = {"figaroh": arguments.figaroh_python, "vbjfa": sys.executable}
    paragraphs = []
    for name in arguments.data:
        try:
            paragraphs += measure(name, arguments.data_home, pythons, arguments.repeats)
        except OSError as error:
            raise SystemExit(f"The recording {name} is absent: {error}") from None
    text = "\n\n".join(
        [
            f"FIGAROH's environment: {versions}; ours as below, {platform.machine()}.",
            *paragraphs,
        ]
    )
    publish("figaroh", text, write=arguments.write)


if __name__ == "__main__":
    main()
