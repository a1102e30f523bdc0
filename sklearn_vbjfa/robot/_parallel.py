"""Parallel tasks, with results that do not depend on the number of jobs."""

import itertools
from contextlib import contextmanager
from contextvars import ContextVar

from sklearn.utils.parallel import Parallel, delayed

from sklearn_vbjfa.physical import one_blas_thread

# Tasks dispatched at a time: their results are in memory together.
_BATCH = 32
# What runs a list of tasks in place of joblib: (function, tasks) -> results.
_elsewhere = ContextVar("elsewhere", default=None)


@contextmanager
def run_elsewhere(workers):
    """Let a callable (function, tasks) -> results do the tasks of this context."""
    token = _elsewhere.set(workers)
    try:
        yield
    finally:
        _elsewhere.reset(token)


def run(function, tasks, n_jobs):
    """Yield ``function(*task)`` for each task, in order."""
    # Uses threads unless a `joblib.parallel_config` says otherwise: nearly all time is
    # spent in compiled code, and nothing has to be copied. Each has one BLAS thread:
    # matrices are small, and sums must not depend on the number of threads.
    tasks, workers = iter(tasks), _elsewhere.get()
    if workers is not None:
        while batch := list(itertools.islice(tasks, _BATCH)):
            yield from workers(function, batch)
        return
    with one_blas_thread(), Parallel(n_jobs=n_jobs, prefer="threads") as parallel:
        while batch := list(itertools.islice(tasks, _BATCH)):
            yield from parallel(delayed(function)(*task) for task in batch)
