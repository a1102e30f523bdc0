"""One run of a command: compute, write, print, and decide on the exit code."""

import contextlib
import importlib
import os
import re
import shutil
import sys
import tempfile
import textwrap
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

# -- the skeleton of every command -----------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Done:
    """What a command has found."""

    text: str  # printed
    doubts: tuple = ()  # what stands against using it
    folder: Path | None = None  # where its files go
    # whether the folder had none of them: those that are there now are another run's
    fresh: bool = False
    files: tuple = ()  # their names
    # writes them to a folder, given the warnings; returns lines to print behind `text`
    write: object = None
    page: bool = False  # whether the first of them tells all that a terminal leaves out


def run(arguments):
    """Run the command that arguments name."""
    from sklearn_vbjfa._core._progress import show_progress

    module, _, name = arguments.run.partition(":")
    command = getattr(importlib.import_module(f"sklearn_vbjfa._cli.{module}"), name)
    with (
        tempfile.TemporaryDirectory() as folder,
        warnings.catch_warnings(record=True) as caught,
        show_progress(verbose=not getattr(arguments, "quiet", False)),
    ):
        warnings.simplefilter("always")
        done = command(arguments, Path(folder))
        # Before anything is printed: the reader of the output may leave.
        arguments.doubts = [*done.doubts, *_doubts_of(caught)]
        arguments.page = done.page
        lines = [] if done.write is None else _write(arguments, done, caught)
    print("\n".join([done.text, *(wrapped(line, sys.stdout) for line in lines)]))
    for text in () if done.page else _told(caught):
        say(wrapped(f"note: {text}", sys.stderr))


def _write(arguments, done, caught):
    """Write all files or none, each complete; return what is to be said of them."""
    from sklearn_vbjfa._cli._input import free
    from sklearn_vbjfa._core._progress import stage

    if done.fresh and any((done.folder / name).exists() for name in done.files):
        done = replace(done, folder=free(done.folder))
    try:
        with stage("writing"):
            done.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(
                dir=done.folder, prefix=".writing-"
            ) as folder:
                lines = done.write(Path(folder), _told(caught))
                for name in done.files:
                    os.replace(Path(folder, name), done.folder / name)
            arguments.written = True
    except OSError as error:
        print(done.text)
        if error.filename is None and error.errno is not None:
            # A full disk does not say which.
            raise OSError(error.errno, error.strerror, str(done.folder)) from error
        raise
    moved = filter(None, [getattr(arguments, "moved", "")])
    names = _named_files(done, len(_told(caught)))
    return [*lines, *moved, f"written: {names}"]


def _named_files(done, n_notes):
    """Name the files that are written; beside a page only how many they are."""
    paths = [str(done.folder / name) for name in done.files]
    if not done.page:
        return ", ".join(paths)
    notes = f"; notes: {n_notes}" if n_notes else ""
    return f"{paths[0]} (more{notes}), {len(paths) - 1} files"


@contextlib.contextmanager
def blaming(source, gains=None):
    """Name what was read in a refusal: the options are valid, so it is at fault."""
    # gains: factors that its torques have already, which signs are multiplied with.
    from sklearn_vbjfa.physical import ProjectionError

    try:
        yield
    except (ValueError, ProjectionError) as error:
        refused = ValueError(f"{source}: {getattr(error, 'reason', error)}")
        refused.options = dict(getattr(error, "options", {}))
        signs = refused.options.get("gains")
        if isinstance(signs, tuple) and gains is not None:
            refused.options["gains"] = tuple(a * b for a, b in zip(signs, gains))
        raise refused from error


def _told(caught):
    """Texts of the warnings that concern a user, each once, a tuple of str."""
    from sklearn.exceptions import ConvergenceWarning

    # Convergence of the rivals does not concern the user; the data do.
    return tuple(
        dict.fromkeys(
            " ".join(str(warning.message).split())
            for warning in caught
            if issubclass(warning.category, UserWarning)
            and warning.category is not ConvergenceWarning
        )
    )


# -- exit codes and the doubts that decide between them --------------------------------

# Nothing stands against using the result; nothing was done; done with a stated doubt.
USABLE, REFUSED, DOUBTFUL = 0, 2, 3

# What is shown below the help of every command.
EPILOG = (
    "exit code: 0 without warnings; 2 if nothing was done, with the reason in one line "
    "on stderr; 3 with warnings: something was left out, failed, could not be judged, "
    "or cannot be trusted; 130 for an interrupt"
)

# Doubts that the last line names; all of them are in what was printed before, or on
# the page.
_NAMED = 3
# Characters that the last line has for each if a page has them whole.
_BRIEF = 60


def exit_line(doubts, page=False):
    """Say in a line why the exit code is what it is; in brief if a page says it."""
    named = [" ".join(one.split()).rstrip(".") for one in doubts[:_NAMED]]
    if page:
        named = [brief(one, _BRIEF) for one in named]
    more = len(doubts) - len(named)
    return f"exit code {DOUBTFUL}: {'; '.join(named)}" + (
        f"; and {more} more" if more else ""
    )


def _doubts_of(caught):
    """Texts of the warnings that state a doubt, each once, a list of str."""
    from sklearn_vbjfa.model import DoubtWarning

    texts = [
        str(one.message) for one in caught if issubclass(one.category, DoubtWarning)
    ]
    return list(dict.fromkeys(texts))


# -- terminals -------------------------------------------------------------------------


def say(text):
    """Print to stderr; what nobody can read is no error of its own."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError):
            print(text, file=sys.stderr, flush=True)


def brief(text, width):
    """Return the first clauses of a message, as many as a width [characters] takes."""
    text = " ".join(text.split())
    # A first word with a colon is the name of a file, which says nothing alone.
    ends = [end.start() for end in re.finditer(r"[;:.](?= )", text)]
    ends = [end for end in ends if " " in text[:end]]
    if len(text) <= width or not ends:
        return text
    return text[: max([end for end in ends if end <= width], default=ends[0])]


def wrapped(text, stream):
    """Return a text wrapped to the width of a terminal; as it is for other streams."""
    if stream is None or not stream.isatty():
        return text
    width = shutil.get_terminal_size().columns
    return textwrap.fill(text, max(width, 40), break_on_hyphens=False)
