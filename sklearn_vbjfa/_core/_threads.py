"""One thread for the linear algebra: many small factorisations wait for others."""

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
    # The number of threads belongs to the process: of overlapping holders the first one
    # sets and lifts it, or the limit could stay behind for good.
    if not _held.acquire(blocking=False):
        yield
        return
    try:
        with _controller().limit(limits=1, user_api="blas"):
            yield
    finally:
        _held.release()
