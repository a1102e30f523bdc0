"""Results in a file of JSON lines, so that a long study can be run in pieces."""

import json
from pathlib import Path


class Ledger:
    """Results by key, each written to a file as soon as it is there.

    Parameters
    ----------
    path : str, os.PathLike or None
        File; what it holds already is not made again. None keeps results in memory.
    keys : sequence of str
        Fields that tell one result from another.

    Attributes
    ----------
    results : list of dict
        Results in the order in which they came.
    """

    def __init__(self, path, keys):
        self.path = None if path is None else Path(path)
        self.keys = tuple(keys)
        self.results = []
        if self.path is not None and self.path.exists():
            # a run that was stopped may have left half a line
            for line in self.path.read_text(encoding="utf-8").splitlines():
                try:
                    self.results.append(json.loads(line))
                except json.JSONDecodeError:
                    continue

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
        self.results.append(result)
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(result) + "\n")


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
