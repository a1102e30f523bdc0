"""Results in a file of JSON lines, so that a long study can be run in pieces."""

import json
import os
from pathlib import Path

from _report import code

UNKNOWN = {"commit": "a commit that was not noted", "files": {}}


def note(path):
    """Keep the code as it is beside a file of results, and return its commit."""
    now, beside = code(), Path(f"{path}.code")
    if now not in _lines(beside):
        with beside.open("a", encoding="utf-8") as file:
            file.write(json.dumps(now) + "\n")
    return now["commit"]


def noted(paths, commits):
    """Return the code at some commits, as it was kept beside files of results.

    A commit with changes that were not committed may stand for several states.
    """
    found = []
    for path in paths:
        kept = _lines(Path(f"{path}.code"))
        found += [one for one in kept if one["commit"] in commits and one not in found]
    there = {one["commit"] for one in found}
    found += [{**UNKNOWN, "commit": c} for c in commits if c and c not in there]
    return found + ([UNKNOWN] if None in commits else [])


def _lines(path):
    """Values of a file of JSON lines."""
    found = []
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:  # a run that was stopped may have left half a line
                found.append(json.loads(line))
            except json.JSONDecodeError:
                continue
    return found


class Ledger:
    """Results by key, each written to a file as soon as it is there.

    A result in a file holds the commit that it was made at, under "commit".

    Parameters
    ----------
    path : str, os.PathLike, sequence of these or None
        File; what it holds already is not made again. Of several the first is written
        to and the others are only read, so that processes can share a study, each with
        a file of its own. None keeps results in memory.
    keys : sequence of str
        Fields that tell one result from another.

    Attributes
    ----------
    results : list of dict
        Results in the order in which they came.
    """

    def __init__(self, path, keys):
        if path is None or isinstance(path, str | os.PathLike):
            path = [] if path is None else [path]
        self.paths = [Path(one) for one in path]
        self.path = self.paths[0] if self.paths else None
        self.keys = tuple(keys)
        self.results = [] if self.path is None else _lines(self.path)
        for other in self.paths[1:]:
            self.results += self.missing(_lines(other))

    def key(self, result):
        """Key of a result, a tuple."""
        return tuple(_frozen(result[name]) for name in self.keys)

    def missing(self, tasks):
        """Tasks, dicts with the keys, of which there is no result."""
        done = {self.key(result) for result in self.results}
        return [task for task in tasks if self.key(task) not in done]

    def of(self, tasks):
        """Results of the tasks that are done, in the order of the tasks."""
        found = {self.key(result): result for result in self.results}
        return [found[self.key(task)] for task in tasks if self.key(task) in found]

    def add(self, result):
        """Take a result down."""
        if self.path is None:
            self.results.append(result)
        else:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            result = {**result, "commit": note(self.path)}
            self.results.append(result)
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(result) + "\n")

    def states(self, tasks=None):
        """Return the code that results were made with, those of some tasks or all."""
        if self.path is None:
            return [code()]
        made = self.results if tasks is None else self.of(tasks)
        return noted(self.paths, list(dict.fromkeys(r.get("commit") for r in made)))


def _frozen(value):
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


def results_of(function, tasks, jobs):
    """Yield what a function makes of each task, as soon as it is there.

    Parameters
    ----------
    function : callable
        Takes a task; importable, as it runs in processes of its own.
    tasks : sequence
        Tasks.
    jobs : int
        Number of processes.
    """
    if jobs == 1:
        yield from map(function, tasks)
        return
    from joblib import Parallel, delayed

    calls = (delayed(function)(task) for task in tasks)
    yield from Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)
