"""One thread for the linear algebra, and progress on a terminal."""

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
    """Find the loaded libraries, once: the search takes milliseconds."""
    return ThreadpoolController()


@contextmanager
def one_blas_thread():
    """Limit the BLAS to one thread; usable as a decorator."""
    # The number of threads belongs to the process: of overlapping calls only the first
    # sets and restores it, or the limit could remain for good.
    if not _held.acquire(blocking=False):
        yield
        return
    try:
        with _controller().limit(limits=1, user_api="blas"):
            yield
    finally:
        _held.release()


# The progress line, if any. Other threads have no line: their caller shows progress.
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
    """Show a text in the progress line."""
    line = _LINE.get()
    if line is not None:
        line.set_description_str(text)


def counted(items, text, total):
    """Yield `total` items and show the number of each in the progress line."""
    for k, item in enumerate(items):
        say(f"{text}: {k + 1} of {total}")
        yield item
