"""Parallel tasks, with results that do not depend on the number of jobs."""

import itertools

from sklearn.utils.parallel import Parallel, delayed

from sklearn_vbjfa.physical import one_blas_thread

# Tasks dispatched at a time: their results are in memory together.
_BATCH = 32


def run(function, tasks, n_jobs):
    # Uses threads unless a `joblib.parallel_config` says otherwise: nearly all time is
    # spent in compiled code, and nothing has to be copied. Each has one BLAS thread:
    # matrices are small, and sums must not depend on the number of threads.
    tasks = iter(tasks)
    with one_blas_thread(), Parallel(n_jobs=n_jobs, prefer="threads") as parallel:
        while batch := list(itertools.islice(tasks, _BATCH)):
            yield from parallel(delayed(function)(*task) for task in batch)
