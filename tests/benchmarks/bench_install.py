"""What an installation takes: seconds, megabytes, and which packages they are.

Run as ``python tests/benchmarks/bench_install.py [--write]``. In a temporary folder the
package is installed from this checkout by pip, first alone and then with the extra
robot, each in an environment of its own; further extras are added to the second one by
one. Seconds hang on the network and on what pip has in its cache; megabytes are those
of all files, with the compiled ones of Python, without the environment itself.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from _report import ROOT, add_root_to_path, parser, publish, rst_table

add_root_to_path()
# What is installed is what the package imports.
ENTERS = ("sklearn_vbjfa.__main__",)
EXTRAS = ("plot", "fast", "parquet", "bags", "excel", "mujoco", "dask")
# Packages of fewer megabytes are one row.
SMALL = 5.0
# Sizes of the distributions of an environment in MB: what their files take.
SIZES = """
import importlib.metadata, json
found = {}
for one in importlib.metadata.distributions():
    paths = [one.locate_file(path) for path in one.files or ()]
    found[one.metadata["Name"]] = sum(
        path.stat().st_size for path in paths if path.is_file()
    ) / 1e6
print(json.dumps(found))
"""


class Environment:
    """A virtual environment."""

    def __init__(self, folder):
        self.python = folder / "bin" / "python"
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        self.before = self.sizes()

    def install(self, what):
        """Install from the checkout; return the seconds that it takes."""
        begun = time.perf_counter()
        pip = [self.python, "-I", "-m", "pip", "install", "--quiet", what]
        subprocess.run(pip, check=True, cwd=ROOT)
        return time.perf_counter() - begun

    def sizes(self):
        """Return megabytes by distribution, without what an environment begins with."""
        done = subprocess.run(
            [self.python, "-I", "-c", SIZES], check=True, capture_output=True, text=True
        )
        found = json.loads(done.stdout)
        return {
            name: size
            for name, size in found.items()
            if name not in getattr(self, "before", ())
        }


def by_size(sizes):
    """Return rows of packages, largest first, small ones as one."""
    large = {name: size for name, size in sizes.items() if size >= SMALL}
    rest = {name: size for name, size in sizes.items() if size < SMALL}
    rows = [
        [name, f"{size:.0f}"]
        for name, size in sorted(large.items(), key=lambda x: -x[1])
    ]
    return [*rows, [f"{len(rest)} smaller ones", f"{sum(rest.values()):.0f}"]]


def measure(folder):
    """Return rows of what is installed, and megabytes by package with the robot."""
    rows = []

    def told(name, seconds, sizes, before):
        new = sum(sizes.values()) - sum(before.values())
        rows.append([name, f"{seconds:.0f}", f"{new:.0f}", len(sizes) - len(before)])

    alone, robot = (Environment(folder / name) for name in ("alone", "robot"))
    told("``.``", alone.install("."), alone.sizes(), {})
    told('``".[robot]"``', robot.install(".[robot]"), robot.sizes(), {})
    packages = robot.sizes()
    for extra in EXTRAS:
        before = robot.sizes()
        seconds = robot.install(f".[robot,{extra}]")
        told(f"and then ``{extra}``", seconds, robot.sizes(), before)
    return rows, packages


def main(argv=None):
    arguments = parser(__doc__).parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        rows, packages = measure(Path(folder))
    heads = ["pip install", "seconds", "MB", "packages"]
    text = "\n\n".join(
        [
            "Each extra is added to what stands above it.",
            rst_table(rows, heads),
            'Packages of ``".[robot]"`` by size:',
            rst_table(by_size(packages), ["package", "MB"]),
        ]
    )
    publish("install", text, write=arguments.write)


if __name__ == "__main__":
    main()
