"""What the benchmarks share: versions, tables, and writing them for the guide."""

import argparse
import datetime
import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path

from tabulate import tabulate

import sklearn_vbjfa

ROOT = Path(__file__).resolve().parents[2]
TABLES = ROOT / "docs" / "tables"
# The packages whose versions go below every table; pin where robots are in play.
PACKAGES = ("numpy", "scipy", "scikit-learn", "clarabel", "pin", "numba", "cvxopt")


def add_root_to_path():
    """Make the folder of tests importable when a benchmark runs as a script."""
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))


def environment():
    """One line: date, versions, number of processors."""
    versions = [f"Python {platform.python_version()}"]
    for name in PACKAGES:
        try:
            versions.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    today = datetime.datetime.now(datetime.timezone.utc).date().isoformat()
    return f"{today}; {', '.join(versions)}; {os.cpu_count()} CPUs, not idle otherwise"


def commit():
    """Short name of the version of the package, "+" where files differ from it."""
    folder = Path(sklearn_vbjfa.__file__).parent
    ask = ["git", "-C", str(folder), "describe", "--always", "--dirty=+"]
    ask.append("--exclude=*")
    try:
        answer = subprocess.run(ask, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return answer.stdout.strip()


def rst_table(rows, headers, n_labels=1):
    """Table that both a terminal and the guide can show; cells are strings.

    The first `n_labels` columns are words, the others numbers.
    """
    cells = [[str(cell) for cell in row] for row in rows]
    align = ["left"] * n_labels + ["right"] * (len(headers) - n_labels)
    return tabulate(
        cells, headers=headers, tablefmt="rst", disable_numparse=True, colalign=align
    )


def fixed(values, digits=1):
    """Numbers with the same digits; a dash for what does not exist."""
    return [f"{v:.{digits}f}" if v == v else "–" for v in values]


def rst_title(text, mark="-"):
    """Section title of the guide."""
    return f"{text}\n{mark * len(text)}"


def parser(description):
    """Arguments of every benchmark."""
    arguments = argparse.ArgumentParser(description=description)
    arguments.add_argument(
        "--write", action="store_true", help="write docs/tables for the guide"
    )
    return arguments


def publish(name, text, *, write, command=None):
    """Print a report; write it to docs/tables/NAME.rst if asked to.

    The command that made it is that of the benchmark of the same name unless given.
    """
    command = command or f"python tests/benchmarks/bench_{name}.py"
    text = f"{text.rstrip()}\n\nMade by ``{command}``, {environment()}.\n"
    print(text)
    if write:
        TABLES.mkdir(parents=True, exist_ok=True)
        (TABLES / f"{name}.rst").write_text(text, encoding="utf-8")
