"""Tasks at the same time, with results that do not depend on how many."""

import itertools

from sklearn.utils.parallel import Parallel, delayed

from sklearn_vbjfa.physical._threads import one_blas_thread

# Tasks that are handed out at a time: their results are in memory together.
_BATCH = 32


def run(function, tasks, n_jobs):
    """Yield ``function(*task)`` of tasks, in their order.

    Threads, unless a `joblib.parallel_config` says otherwise: nearly all of the time
    is spent in compiled code, and nothing has to be copied. On one BLAS thread each,
    since the matrices are small and sums must not depend on how many there are.
    """
    tasks = iter(tasks)
    with one_blas_thread(), Parallel(n_jobs=n_jobs, prefer="threads") as parallel:
        while batch := list(itertools.islice(tasks, _BATCH)):
            yield from parallel(delayed(function)(*task) for task in batch)
