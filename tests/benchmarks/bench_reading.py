"""What reading a text file takes here, and what it would take with pandas.

Run as ``python tests/benchmarks/bench_reading.py [--write]``; pandas has to be there. A
file of time and six joints is read by each in a process of its own: seconds of the
processor with the import, and the most memory beyond that of NumPy alone (by Linux).
Megabytes installed are those of pandas and of what comes with it.
"""

import importlib.metadata
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from _report import ROOT, parser, publish, rst_table

# What the processes run of the package.
ENTERS = ("sklearn_vbjfa.recording._reader",)
ROWS = 200_000
# Distributions that come with pandas alone.
WITH_IT = ("pandas", "python-dateutil", "six", "tzdata", "pytz")
READERS = {
    "``read_recording``": "from sklearn_vbjfa.datasets import read_recording\n"
    "found = read_recording(path).q",
    "``pandas.read_csv``": "import pandas\nfound = pandas.read_csv(path).to_numpy()",
    "``numpy.loadtxt``": "found = np.loadtxt(path, delimiter=',', skiprows=1)",
}
_RUN = r"""
import json, re, sys, time
import numpy as np
path, code = sys.argv[1:]
def highest():
    with open("/proc/self/status") as file:
        return int(re.search(r"VmHWM:\s+(\d+)", file.read())[1])
before = highest()
begun = time.process_time()
exec(code)
seconds = time.process_time() - begun
most = highest() - before
print(json.dumps([seconds, most / 1e3]))
"""


def megabytes(names):
    """Return what the files of the distributions take that are installed."""
    found = {x.metadata["Name"]: x for x in importlib.metadata.distributions()}
    paths = [
        found[name].locate_file(path)
        for name in names
        if name in found
        for path in found[name].files or ()
    ]
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


def measure(path, code):
    """Return seconds and megabytes of the best of three processes."""
    run = [sys.executable, "-c", _RUN, str(path), code]
    done = [
        json.loads(
            subprocess.run(run, check=True, capture_output=True, cwd=ROOT).stdout
        )
        for _ in range(3)
    ]
    return min(done)


def main(argv=None):
    arguments = parser(__doc__).parse_args(argv)
    t = 1e-3 * np.arange(ROWS)
    motion = np.sin(np.outer(t, np.arange(1, 13)))
    header = ",".join(["t", *(f"{x}{j}" for x in ("q", "tau") for j in range(1, 7))])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        np.savetxt(
            path,
            np.column_stack([t, motion]),
            "%.9g",
            delimiter=",",
            header=header,
            comments="",
        )
        size = path.stat().st_size / 1e6
        rows = [
            [name, *(f"{x:.{n}f}" for x, n in zip(measure(path, code), (1, 0)))]
            for name, code in READERS.items()
        ]
    heads = ["reader", "processor seconds", "MB of memory"]
    text = "\n\n".join(
        [
            f"{ROWS:,} rows of 13 columns, {size:.0f} MB of text, the best of three.",
            rst_table(rows, heads),
            f"Installed, pandas takes {megabytes(WITH_IT):.0f} MB.",
        ]
    )
    publish("reading", text, write=arguments.write)


if __name__ == "__main__":
    main()
