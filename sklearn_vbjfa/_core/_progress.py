"""Progress bars of long runs, drawn by tqdm on terminals alone."""

import contextlib
import contextvars
import os
import sys

# The bars under way, the outermost first; None where nothing is shown. Threads that a
# stage starts have contexts without bars: their caller counts for them.
_BARS = contextvars.ContextVar("sklearn_vbjfa_bars", default=None)


@contextlib.contextmanager
def show_progress(verbose=1):
    """Show the stages within a ``with`` on stderr if that is a terminal."""
    silenced = os.environ.get("TQDM_DISABLE", "") not in ("", "0")
    terminal = sys.stderr is not None and sys.stderr.isatty()
    if not verbose or silenced or not terminal or _BARS.get() is not None:
        yield
        return
    token = _BARS.set([])
    try:
        yield
    finally:
        _BARS.reset(token)


@contextlib.contextmanager
def stage(text, total=None, unit="it"):
    """Name what is done within a ``with``, of `total` units; yields ``step(count)``."""
    bars = _BARS.get()
    if bars is None:
        yield _ignore
        return
    from tqdm import tqdm

    counted_form = "{desc}: {n_fmt} of {total_fmt} {unit} |{bar:20}| {elapsed}"
    with tqdm(
        desc=text,
        total=total,
        unit=unit,
        file=sys.stderr,
        disable=False,
        leave=False,
        dynamic_ncols=True,
        bar_format="{desc}{postfix} {elapsed}"
        if total is None
        else counted_form + "<{remaining}{postfix}",
    ) as bar:
        bars.append(bar)
        try:
            yield bar.update
        finally:
            bars.remove(bar)


def counted(items, text, unit="it", sizes=None):
    """Yield items, in a stage that counts them, or their sizes."""
    sizes = len(items) * [1] if sizes is None else sizes
    with stage(text, sum(sizes), unit) as step:
        for item, size in zip(items, sizes):
            yield item
            step(size)


def say(note):
    """Add a note to the innermost stage."""
    for bar in (_BARS.get() or [])[-1:]:
        bar.set_postfix_str(note)


def _ignore(count=1):
    """Take a step that nobody sees."""
