"""Logs of nine tools, logs as they lie, two real bags: what it takes to get them in.

Run as ``python tests/benchmarks/bench_logs.py [--bags FOLDER] [--write]``. One
simulated robot is written as each tool writes it (`tests.recording._logs` says by which
names) and given to ``close-loop`` with nothing but its URDF. A refusal that names a
command that would work is followed; one that names none ends the attempt.
Bags: those of the folder with SOURCE.md in ``../shared/data/unisa_bags``.
"""

import contextlib
import io
import json
import re
import shlex
import tempfile
import time
from pathlib import Path

import numpy as np
from _report import ROOT, add_root_to_path, parser, publish, rst_table

add_root_to_path()
from sklearn_vbjfa._cli import main as command_line  # noqa: E402
from sklearn_vbjfa.datasets import make_robot_recording  # noqa: E402
from tests.recording._logs import AS_THEY_LIE, KINDS  # noqa: E402

BAGS = ROOT.parent / "shared" / "data" / "unisa_bags"
REAL = {
    "bag of an UR10 (ROS 2)": ("ur10_exciting_trajectory.db3", "ur10_robot.urdf"),
    "bag of a Panda (ROS 2)": ("panda_exciting_trajectory.db3", "panda.urdf"),
}
# Refusals that are followed at most.
PATIENCE = 4
# A report without the search: what counts is how the data get in.
QUICK = ("--effects", "none", "--cutoff", "10")


def attempt(argv):
    """Run the command line; exit code, and what it says on stderr."""
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        try:
            code = command_line(argv)
        except SystemExit as end:
            code = end.code
    return code, said.getvalue()


def remedy(message):
    """Return the arguments of the command that a refusal names; None for none."""
    found = re.search(r"sklearn_vbjfa (close-loop .*)", message)
    return None if found is None else shlex.split(found[1].rstrip("."))


def get_in(paths, urdf, folder):
    """Follow refusals until the data are in; a row, and the errors of the report."""
    paths = paths if isinstance(paths, list) else [paths]
    path, out = paths[0], folder / f"{paths[0].name}-report"
    first = ["close-loop", *map(str, paths), "--urdf", str(urdf), *QUICK]
    first += ["--out", str(out)]
    argv, refusals, took = first, 0, time.perf_counter()
    while True:
        code, said = attempt(argv)
        if code in (0, 3) or refusals == PATIENCE:
            break
        refusals += 1
        argv = remedy(said)
        print(f"{path.name}: {said.strip()}")
        if argv is None:
            break
    took = time.perf_counter() - took
    if code not in (0, 3):
        return ["not in", refusals, code, "–", f"{took:.1f}"], None
    print(f"{path.name}: in; {said.strip()[:800]}")
    report = json.loads((out / "report.json").read_text("utf-8"))
    added = [shlex.quote(word) for word in argv if word not in first]
    options = f"``{' '.join(added)}``" if added else "–"
    row = ["in", refusals, code, options, f"{took:.1f}"]
    return row, np.array(report["error_before"])


def study(duration, bags):
    """Return rows of the table."""
    made = make_robot_recording(duration=duration, dt=0.004, random_state=0)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        errors = {}
        for name, write in {**KINDS, **AS_THEY_LIE}.items():
            row, errors[name] = get_in(write(made, folder), made.urdf, folder)
            same = "–"
            if errors[name] is not None and errors["plain CSV"] is not None:
                off = np.abs(errors[name] / errors["plain CSV"] - 1).max()
                same = "yes" if off < 0.01 else f"off by {100 * off:.0f} %"
            rows.append([name, *row, same])
        for name, (bag, urdf) in REAL.items():
            if (bags / urdf).is_file():
                row, _ = get_in(bags / "original" / bag, bags / urdf, folder)
                rows.append([name, *row, "–"])
    return rows


def main():
    """Run the benchmark."""
    arguments = parser(__doc__)
    arguments.add_argument("--duration", type=float, default=12.0)
    arguments.add_argument("--bags", type=Path, default=BAGS)
    given = arguments.parse_args()
    rows = study(given.duration, given.bags)
    headers = [
        "log",
        "",
        "refusals",
        "exit code",
        "options to add",
        "seconds",
        "same errors",
    ]
    text = (
        "The command ``close-loop LOG --urdf ROBOT`` on logs as tools write them, "
        f"and as they lie, a simulated robot of six joints, {given.duration:g} s at "
        "250 Hz, and two measured bags. A refusal is followed by the command that it "
        "names. Exit "
        "code 3: a doubt is stated, as that the torques are in another unit. Last "
        "column: whether the errors of the report are those of the plain file, to "
        "1 %.\n\n"
    )
    publish("logs", text + rst_table(rows, headers, 2), write=given.write)


if __name__ == "__main__":
    main()
