"""What the benchmarks share: versions, tables, and writing them for the guide."""

import argparse
import datetime
import functools
import importlib.metadata
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

from tabulate import tabulate

import sklearn_vbjfa

ROOT = Path(__file__).resolve().parents[2]
TABLES = ROOT / "docs" / "tables"
PACKAGE = Path(sklearn_vbjfa.__file__).parent
# The packages whose versions go below every table; pin where robots are in play.
PACKAGES = ("numpy", "scipy", "scikit-learn", "clarabel", "pin", "numba", "cvxopt")

sys.path.append(str(ROOT / "docs" / "_ext"))

import provenance  # noqa: E402


def _stamps():
    """When the files of the package were last written, and their sizes."""
    found = ((path, path.stat()) for path in PACKAGE.rglob("*.py"))
    return {path: (seen.st_mtime_ns, seen.st_size) for path, seen in found}


# As it was when the script began: what is written later was perhaps not what ran.
_BEGAN = _stamps()


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
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    return f"{today}; {', '.join(versions)}; {os.cpu_count()} CPUs, not idle otherwise"


def commit():
    """Short name of the version of the package, "+" where its files differ from it."""

    def ask(*words):
        command = ["git", "-C", str(PACKAGE), *words]
        answer = subprocess.run(command, capture_output=True, text=True, check=True)
        return answer.stdout.strip()

    try:
        name = ask("rev-parse", "--short", "HEAD")
        differs = ask("status", "--porcelain", "--", ".")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{name}+" if differs or _stamps() != _BEGAN else name


@functools.cache
def code():
    """Commit and digests of the package's files, as ``provenance.state`` has them.

    A file that was written since the script began has no digest: it is not known what
    of it ran.
    """
    now = _stamps()
    written = {path for path in now if now[path] != _BEGAN.get(path)}
    texts = provenance.sources(ROOT, [provenance.PACKAGE], PACKAGE)
    found = provenance.state(commit(), texts)
    for path in written:
        name = f"{provenance.PACKAGE}/{path.relative_to(PACKAGE).as_posix()}"
        found["files"][name] = "written while it ran"
    return found


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


def publish(name, text, *, write, command=None, states=None):
    """Print a report; write it to docs/tables/NAME.rst if asked to.

    The command that made it is that of the benchmark of the same name unless given.
    Beside the table, NAME.json says which files of the package its script enters and
    how they were; `states` are those of results that were kept (``Ledger.states``),
    the code as it is unless given.
    """
    command = command or f"python tests/benchmarks/bench_{name}.py"
    commits = provenance.commits_of(states) if states else commit()
    text = f"{text.rstrip()}\n\nMade by ``{command}`` at {commits}, {environment()}.\n"
    print(text)
    if write:
        script = re.search(r"tests/benchmarks/\w+\.py", command)[0]
        files = provenance.entered(script, provenance.sources(ROOT, package=PACKAGE))
        TABLES.mkdir(parents=True, exist_ok=True)
        (TABLES / f"{name}.rst").write_text(text, encoding="utf-8")
        provenance.write(name, script, states or [code()], files, folder=TABLES)
