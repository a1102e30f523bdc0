"""Progress of long runs: one line on a terminal, drawn by tqdm."""

import contextlib
import contextvars
import sys

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
