"""From nothing to the first report, and from a bag to the page: seconds.

Run as ``python tests/benchmarks/bench_first_report.py [--bags FOLDER] [--write]``. Part
one does in a temporary folder what the README says: clone, environment, install with
the extra robot, ``python -m sklearn_vbjfa``. What pip does hangs on the network and on
its cache, so its time stands apart. Part two gives bags to ``close-loop`` with all
effects: the demonstration written as a bag, and those of the folder with SOURCE.md in
``../shared/data/unisa_bags``. A refusal is followed by the command that it names.
Seconds of a clock depend on what else the machine does; beside them stand those that
its processors were at work for the command.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _report import ROOT, add_root_to_path, parser, publish, rst_table

add_root_to_path()
from sklearn_vbjfa.datasets import load_demo_recording  # noqa: E402
from tests.recording._bags import states, write_ros2  # noqa: E402

# What the commands run.
ENTERS = ("sklearn_vbjfa.__main__",)
BAGS = ROOT.parent / "shared" / "data" / "unisa_bags"
# Bags by what they are: file, description, what its user knows of the efforts.
REAL = {
    "UR10": ("ur10_exciting_trajectory.db3", "ur10_robot.urdf", ["--gain", "unknown"]),
    "Panda": ("panda_exciting_trajectory.db3", "panda.urdf", []),
}
# Refusals that are followed at most.
PATIENCE = 3
# Exit codes of runs that wrote their files.
DONE = (0, 3)


@dataclass(frozen=True)
class Spent:
    """A command that has ended, and the time that it took [s]."""

    code: int
    wall: float
    processors: float
    said: str

    def cells(self):
        """Clock and processors as text."""
        return [f"{self.wall:.1f}", f"{self.processors:.1f}"]


def spend(argv, folder, **environment):
    """Run a command in a folder."""
    begun = time.perf_counter()
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            [str(x) for x in argv],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=said,
            env={**os.environ, **environment},
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall = time.perf_counter() - begun
        said.seek(0)
        return Spent(
            process.returncode, wall, used.ru_utime + used.ru_stime, said.read()
        )


def first_report(folder):
    """Return rows of what a new user types, each with its time."""
    clone = folder / "clone"
    python = folder / "env" / "bin" / "python"
    # The clone's own package, not that of this process; its code is compiled once.
    alone = {"PYTHONPATH": "", "PYTHONDONTWRITEBYTECODE": ""}
    pip = [python, "-m", "pip", "install", "--quiet", ".[robot]"]
    steps = {
        "git clone": ["git", "clone", "--quiet", ROOT, clone],
        "python3 -m venv env": [sys.executable, "-m", "venv", folder / "env"],
        'pip install ".[robot]"': pip,
        "python -m sklearn_vbjfa": [python, "-m", "sklearn_vbjfa"],
        "the same again": [python, "-m", "sklearn_vbjfa"],
    }
    rows = []
    for name, argv in steps.items():
        spent = spend(argv, clone if clone.exists() else folder, **alone)
        if spent.code:
            raise RuntimeError(f"{name} failed: {spent.said[-500:]}")
        name = name if name.startswith("the") else f"``{name}``"
        rows.append([name, *spent.cells()])
    return rows


def bag_to_page(bag, urdf, options, folder):
    """Return the cells of a row: duration, refusals, time, size of the page."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    first = ["close-loop", str(bag), "--urdf", str(urdf), *options, "--out", str(out)]
    argv, wall, processors, refusals = first, 0.0, 0.0, 0
    while True:
        spent = spend([sys.executable, "-m", "sklearn_vbjfa", *argv], folder)
        wall, processors = wall + spent.wall, processors + spent.processors
        found = re.search(r"sklearn_vbjfa (close-loop .*)", spent.said)
        if spent.code in DONE or found is None or refusals == PATIENCE:
            break
        refusals += 1
        argv = shlex.split(found[1])
    if spent.code not in DONE:
        raise RuntimeError(f"{bag} is not read: {spent.said[-500:]}")
    page = (out / "report.html").stat().st_size / 1e3
    recorded = json.loads((out / "report.json").read_text("utf-8"))["recorded"]
    length = f"{recorded['seconds']:.0f} s at {recorded['rate']:.0f} Hz"
    spent = Spent(0, wall, processors, "")
    return [length, refusals, *spent.cells(), f"{page:.0f}"]


def demo_bag(folder):
    """Write the first motion of the demonstration as a bag; the bag and its URDF."""
    recording = load_demo_recording()
    part = recording.segments[0]
    t = recording.dt * np.arange(part.stop - part.start)
    names = recording.joint_names
    bag = states(t, names, recording.q[part], recording.tau[part])
    return write_ros2(folder / "demo", [bag]), recording.urdf


def main():
    """Run the benchmark."""
    arguments = parser(__doc__)
    arguments.add_argument("--bags", type=Path, default=BAGS)
    arguments.add_argument(
        "--no-install", action="store_true", help="leave out clone and install"
    )
    given = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        text = ""
        if not given.no_install:
            text += (
                "From nothing to the first report, by the commands of the README: "
                "seconds of a clock and of the processors. What ``pip`` takes hangs on "
                "the network and its cache.\n\n"
                + rst_table(first_report(folder), ["command", "seconds", "processors"])
                + "\n\n"
            )
        bag, urdf = demo_bag(folder)
        rows = [["demonstration, as a bag", *bag_to_page(bag, urdf, [], folder)]]
        for name, (file, urdf, options) in REAL.items():
            bag, urdf = given.bags / "original" / file, given.bags / urdf
            if bag.is_file():
                rows.append([name, *bag_to_page(bag, urdf, options, folder)])
    heads = ["bag", "recorded", "refusals", "seconds", "processors", "page, kB"]
    text += (
        "From a bag of joint states to the page, all effects searched: "
        "``close-loop BAG --urdf ROBOT``, for the UR10 with ``--gain unknown``. A "
        "refusal is followed by the command that it names; its time counts.\n\n"
        + rst_table(rows, heads)
    )
    publish("first_report", text, write=given.write)


if __name__ == "__main__":
    main()
