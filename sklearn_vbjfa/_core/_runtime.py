"""Long runs: one thread for the linear algebra, and progress on a terminal."""

import contextlib
import contextvars
import sys
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


# -- progress --------------------------------------------------------------------------

# The line that is shown, if any. Threads have contexts without it: their caller counts
# for them.
_LINE = contextvars.ContextVar("sklearn_vbjfa_line", default=None)


@contextlib.contextmanager
def show_progress(verbose=1):
    """Show what a ``with`` does on stderr if that is a terminal."""
    terminal = sys.stderr is not None and sys.stderr.isatty()
    if not (verbose and terminal) or _LINE.get() is not None:
        yield
        return
    from tqdm import tqdm

    form = {"bar_format": "{desc} {elapsed}", "leave": False, "dynamic_ncols": True}
    with tqdm(file=sys.stderr, **form) as line:
        token = _LINE.set(line)
        try:
            yield
        finally:
            _LINE.reset(token)


def say(text):
    """Say in the line what is done."""
    line = _LINE.get()
    if line is not None:
        line.set_description_str(text)


def counted(items, text, total):
    """Yield items, of which there are `total`, and show the number of each."""
    for k, item in enumerate(items):
        say(f"{text}: {k + 1} of {total}")
        yield item
