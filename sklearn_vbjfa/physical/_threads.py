"""Linear algebra on one thread.

NumPy and SciPy bring a copy of the BLAS each, with threads of its own that keep a
processor busy while they wait. Where a computation goes back and forth between them, as
the projection does, it takes five to fifty times as long on a machine with something
else to do. Its matrices are too small to share anyway.
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
    """Limit the BLAS to one thread; usable as a decorator."""
    # The number of threads belongs to the process. If each of two overlapping holders
    # restored what it had found, the limit could stay behind for good; so the first one
    # alone sets and lifts it.
    if not _held.acquire(blocking=False):
        yield
        return
    try:
        with _controller().limit(limits=1, user_api="blas"):
            yield
    finally:
        _held.release()
