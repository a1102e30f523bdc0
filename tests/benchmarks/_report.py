"""Shared by the benchmarks: arguments, results in files, tables and their origin."""

import argparse
import datetime
import functools
import importlib.metadata
import json
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

from tabulate import tabulate

import sklearn_vbjfa

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = Path(sklearn_vbjfa.__file__).parent
# The packages whose versions go below every table.
PACKAGES = ("numpy", "scipy", "scikit-learn", "clarabel", "pin", "numba", "cvxopt")

sys.path.append(str(ROOT / "docs" / "_ext"))

import recorded  # noqa: E402

# -- arguments -------------------------------------------------------------------------


def parser(description, *, data=False, out=False, jobs=False, seeds=None):
    """Arguments of a benchmark."""
    arguments = argparse.ArgumentParser(description=description.splitlines()[0])
    arguments.add_argument("--write", action="store_true", help="write docs/tables")
    arguments.add_argument("--quick", action="store_true", help="a small run")
    if data:
        arguments.add_argument("--data-home", help="folder of the measured sets")
    if out:
        arguments.add_argument(
            "--out",
            nargs="+",
            metavar="FILE",
            help="results as JSON lines, the first to continue, the others to read",
        )
    if jobs:
        arguments.add_argument("--jobs", type=int, default=1, help="processes")
    if seeds is not None:
        arguments.add_argument(
            "--seeds", nargs=2, type=int, default=seeds, metavar=("FIRST", "LAST")
        )
    return arguments


# -- results ---------------------------------------------------------------------------


class Ledger:
    """Results by key, each written to the first of several JSON-lines files at once."""

    def __init__(self, paths, keys):
        self.paths = [Path(path) for path in paths or ()]
        self.keys = tuple(keys)
        self.results = []
        for path in self.paths:
            self.results += self.missing(_lines(path))

    def key(self, result):
        return tuple(_frozen(result[name]) for name in self.keys)

    def missing(self, tasks):
        """Tasks, dicts with the keys, that have no result."""
        done = {self.key(result) for result in self.results}
        return [task for task in tasks if self.key(task) not in done]

    def of(self, tasks):
        """Results of the tasks that are done, in the order of the tasks."""
        found = {self.key(result): result for result in self.results}
        return [found[self.key(task)] for task in tasks if self.key(task) in found]

    def add(self, result):
        """Keep a result, with the commit that it was made at."""
        result = {**result, "commit": commit()}
        self.results.append(result)
        if self.paths:
            with self.paths[0].open("a", encoding="utf-8") as file:
                file.write(json.dumps(result) + "\n")

    def commits(self, tasks=None):
        """Return the commits of the results, or of those of some tasks."""
        made = self.results if tasks is None else self.of(tasks)
        return list(dict.fromkeys(r.get("commit") or "unknown" for r in made))


def _frozen(value):
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


def _lines(path):
    """Values of a file of JSON lines, the last of which may be cut."""
    found = []
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                found.append(json.loads(line))
            except json.JSONDecodeError:
                continue
    return found


def results_of(function, tasks, jobs=1):
    """Yield the result of each task as soon as it is computed."""
    if jobs == 1:
        yield from map(function, tasks)
        return
    from joblib import Parallel, delayed

    calls = (delayed(function)(task) for task in tasks)
    yield from Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)


def run_study(function, tasks, keys, *, out=None, jobs=1, line=None):
    """Compute the missing results of a study; return its ledger."""
    ledger = Ledger(out, keys)
    for result in results_of(function, ledger.missing(tasks), jobs):
        ledger.add(result)
        if line is not None:
            print(line(result), flush=True)
    return ledger


# -- tables ----------------------------------------------------------------------------


def environment():
    """One line: date, versions, number of processors."""
    versions = [f"Python {platform.python_version()}"]
    for name in PACKAGES:
        try:
            versions.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    return f"{today}; {', '.join(versions)}; {os.cpu_count()} CPUs, not idle otherwise"


@functools.cache
def commit():
    """Commit of the package, with "+" where its files differ from it."""

    def ask(*words):
        command = ["git", "-C", str(PACKAGE), *words]
        answer = subprocess.run(command, capture_output=True, text=True, check=True)
        return answer.stdout.strip()

    try:
        name = ask("rev-parse", "--short", "HEAD")
        return f"{name}+" if ask("status", "--porcelain", "--", ".") else name
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def rst_table(rows, headers, n_labels=1):
    """Table whose first `n_labels` columns are words, the others numbers."""
    cells = [[str(cell) for cell in row] for row in rows]
    align = ["left"] * n_labels + ["right"] * (len(headers) - n_labels)
    return tabulate(
        cells, headers=headers, tablefmt="rst", disable_numparse=True, colalign=align
    )


def fixed(values, digits=1):
    """Numbers with the same digits; a dash for nan."""
    return [f"{v:.{digits}f}" if v == v else "–" for v in values]


def rst_title(text, mark="-"):
    """Section title."""
    return f"{text}\n{mark * len(text)}"


def publish(name, text, arguments, *, command="", commits=None):
    """Print a report; with ``--write`` keep it in docs/tables."""
    command = f"python tests/benchmarks/bench_{command or name + '.py'}"
    commits = commits or [commit()]
    made = f"Made by ``{command}`` at {' and '.join(commits)}, {environment()}."
    text = f"{text.rstrip()}\n\n{made}\n"
    print(text)
    if arguments.write and not arguments.quick:
        script = re.search(r"tests/benchmarks/\w+\.py", command)[0]
        names = [module.split(".") for module in sys.modules]
        rooms = {x[1] for x in names if x[0] == "sklearn_vbjfa" and len(x) > 2}
        recorded.write(name, text, script, commits, sorted(rooms))
