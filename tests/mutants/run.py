"""Wrong changes of the package, and whether the tests notice them.

Each entry of ``mutants.toml`` changes one line of a file for the worse, and names the
test that must fail then. This script makes each change in a copy of the package and
runs that test there. It ends with 1 if a change survives or no longer applies, or if a
test that is named fails without the change.
"""

import argparse
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

TABLE = Path(__file__).resolve().with_name("mutants.toml")
ROOT = TABLE.parents[2]
# What the tests need of a checkout, and what no copy needs.
_PARTS = ("sklearn_vbjfa", "tests", "pyproject.toml")
_LEFT_OUT = shutil.ignore_patterns("__pycache__")
# A test that takes longer does not answer [s].
_LONGEST = 600.0


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """A change of one line."""

    name: str
    test: str  # that must fail
    file: str  # that it changes, from the root of the repository
    before: str  # once in the file
    after: str

    def applied(self, text):
        """Return the text of its file with the change made; refuse what is not it."""
        count = text.count(self.before)
        if count != 1:
            raise ValueError(
                f"{self.name} no longer applies: its lines are {count} times in "
                f"{self.file}, expected once. Write it anew, or remove it if what it "
                "broke is gone."
            )
        return text.replace(self.before, self.after)


def mutants(table=TABLE):
    """Read all of a table."""
    entries = tomllib.loads(table.read_text(encoding="utf-8"))
    return [Mutant(name=name, **entry) for name, entry in entries.items()]


def copied(source, place):
    """Copy what the tests need of a checkout; return the folder."""
    place.mkdir()
    for part in _PARTS:
        if (source / part).is_dir():
            shutil.copytree(source / part, place / part, ignore=_LEFT_OUT)
        else:
            shutil.copy2(source / part, place / part)
    return place


def run(root, tests):
    """Run tests of a checkout; return pytest's exit code and its last line."""
    # The folder that pytest is started in comes first on the path.
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-x", "--tb=line"]
    command += ["-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(
            command,
            cwd=root,
            env=os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            timeout=_LONGEST * len(tests),
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None, f"no answer in {_LONGEST * len(tests):g} s"
    said = (done.stdout + done.stderr).strip().splitlines()
    return done.returncode, said[-1] if said else "nothing was said"


def judged(mutant, root):
    """Make a change in a copy, run its test, and undo it; return what became of it."""
    path = root / mutant.file
    try:
        changed = mutant.applied(path.read_text(encoding="utf-8"))
    except ValueError as error:
        return str(error)
    kept = path.with_name(path.name + ".kept")
    # With its time: a stale module in the cache of Python or Numba would be believed.
    shutil.copy2(path, kept)
    try:
        path.write_text(changed, encoding="utf-8")
        _forget_compiled(path)
        code, said = run(root, [mutant.test])
    finally:
        kept.replace(path)
        _forget_compiled(path)
    if code == 1:
        return ""
    return "survives" if code == 0 else f"pytest ended with {code}: {said}"


def _forget_compiled(path):
    """Forget machine code that was made of a module together with others."""
    imported = re.compile(rf"^(from|import) .*\b{path.stem}\b", re.MULTILINE)
    compiled = path.parent.glob("_compiled*.py")
    if any(imported.search(one.read_text(encoding="utf-8")) for one in compiled):
        for index in path.parent.glob("__pycache__/*.nbi"):
            index.unlink()


def judge_all(chosen, jobs, source=ROOT):
    """Judge mutants, so many at a time; yield each with its verdict and its seconds.

    The tests that they name must pass without them: RuntimeError if one does not.
    """
    with tempfile.TemporaryDirectory() as folder:
        first = copied(source, Path(folder) / "0")
        code, said = run(first, sorted({mutant.test for mutant in chosen}))
        if code != 0:
            raise RuntimeError(f"Without a change the tests do not pass: {said}")
        free = queue.SimpleQueue()
        free.put(first)
        for k in range(1, jobs):
            # With what has been compiled so far.
            free.put(Path(shutil.copytree(first, Path(folder) / str(k))))

        def judge(mutant):
            root, begin = free.get(), time.monotonic()
            try:
                return mutant, judged(mutant, root), time.monotonic() - begin
            finally:
                free.put(root)

        with ThreadPoolExecutor(jobs) as pool:
            yield from pool.map(judge, chosen)


def main(arguments=None):
    """Judge the mutants and print what became of them; return the exit code."""
    parser = argparse.ArgumentParser(
        description="Change the package for the worse, line by line, and see whether "
        "the tests notice."
    )
    parser.add_argument("names", nargs="*", help="parts of names; all without any")
    parser.add_argument("--jobs", type=int, default=2, help="at a time (default: 2)")
    parser.add_argument("--table", type=Path, default=TABLE, help="of the changes")
    asked = parser.parse_args(arguments)
    chosen = [
        mutant
        for mutant in mutants(asked.table)
        if not asked.names or any(name in mutant.name for name in asked.names)
    ]
    if not chosen:
        parser.error(f"nothing in {asked.table} has such a name")
    width, left = max(len(mutant.name) for mutant in chosen), 0
    try:
        for mutant, wrong, seconds in judge_all(chosen, asked.jobs):
            left += bool(wrong)
            told = wrong or f"killed by {mutant.test}"
            print(f"{mutant.name:<{width}} {seconds:5.1f} s  {told}", flush=True)
    except RuntimeError as error:
        print(error)
        return 1
    print(f"{len(chosen) - left} of {len(chosen)} killed")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
