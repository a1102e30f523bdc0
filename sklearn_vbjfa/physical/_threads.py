"""Linear algebra on one thread.

NumPy and SciPy bring a copy of the BLAS each, and each copy has threads of its own,
which keep a processor busy while they wait for work.  Where a computation goes back
and forth between the two, their threads get in each other's way: on a machine with
something else to do the projection then takes five to fifty times as long as on one
thread.  Its matrices, a few hundred rows at most, are too small to share anyway.
"""

import threading
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController

_held = threading.Lock()


@cache
def _controller():
    """Find the loaded libraries; once, since the search takes milliseconds."""
    return ThreadpoolController()


@contextmanager
def one_blas_thread():
    """Limit the BLAS to one thread; usable as a decorator.

    The number of threads belongs to the process.  If each of two overlapping holders
    restored what it had found, the limit could stay behind for good; so the first one
    alone sets and lifts it.  Another Python thread that is still computing then goes
    on with more threads, slower but no different.
    """
    if not _held.acquire(blocking=False):
        yield
        return
    try:
        with _controller().limit(limits=1, user_api="blas"):
            yield
    finally:
        _held.release()
