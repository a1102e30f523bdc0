"""One run of a command: compute, write, print, and decide on the exit code."""

import contextlib
import importlib
import io
import json
import os
import re
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sklearn_vbjfa._cli._parser import Refused, in_options

# Success; nothing was done; finished with warnings.
USABLE, REFUSED, DOUBTFUL = 0, 2, 3

# Longest message [characters].
_LONGEST = 900
# Warnings that the last line names.
_NAMED = 3
# The first clause of a message, with asides; a file's name may stand before it.
_CLAUSE = re.compile(r"(?:[^;:]*\.\w+: )?\S+(?: (?:\([^)]*\)|.)*?)?(?=[;:.] |$)")
# Age at which unfinished files are those of a killed run [s].
_ABANDONED = 3600.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Done:
    """Result of a command."""

    text: str  # printed
    doubts: tuple | list = ()  # warnings that forbid a use
    data: dict | str | None = None  # printed by --json: a report, or a file's name
    folder: Path | None = None  # of the files
    files: tuple = ()  # their names
    # Writes them to a folder, given the notes; returns further lines to print.
    write: Callable | None = None
    page: bool = False  # whether the first file has everything that is not printed


def run(arguments):
    from sklearn_vbjfa._core._runtime import show_progress
    from sklearn_vbjfa.model import DoubtWarning

    module, _, name = arguments.run.partition(":")
    command = getattr(importlib.import_module(f"sklearn_vbjfa._cli.{module}"), name)
    as_json = getattr(arguments, "json", False)
    with (
        tempfile.TemporaryDirectory() as folder,
        warnings.catch_warnings(record=True) as caught,
        show_progress(verbose=not getattr(arguments, "quiet", False)),
    ):
        warnings.simplefilter("always")
        done = command(arguments, Path(folder))
        if not as_json:
            _print(in_options(done.text))
        lines = _write(done, arguments, _notes(caught)) if done.write else []
    if as_json:
        lines = [json.dumps(done.data, indent=1)]
        if isinstance(done.data, str):
            lines = [(done.folder / done.data).read_text(encoding="utf-8")]
    _print(*lines)
    doubts = [w.message for w in caught if issubclass(w.category, DoubtWarning)]
    doubts = (" ".join(str(one).split()) for one in (*done.doubts, *doubts))
    doubts = list(dict.fromkeys(doubts))
    notes = [text for text in _notes(caught) if text not in doubts[:_NAMED]]
    if notes and done.page:
        notes = [one_line(f"{_named(notes, False)} (page)")]
    for text in notes:
        say(f"note: {text}")
    if not doubts:
        return USABLE
    line = one_line(f"warning: {_named(doubts, done.page)}")
    say(f"{line} (exit code {DOUBTFUL})")
    return DOUBTFUL


def _notes(caught):
    from sklearn.exceptions import ConvergenceWarning

    # Convergence concerns rivals of the model that is reported.
    texts = (
        " ".join(str(warning.message).split())
        for warning in caught
        if issubclass(warning.category, UserWarning)
        and warning.category is not ConvergenceWarning
    )
    return tuple(dict.fromkeys(texts))


# -- files -----------------------------------------------------------------------------


def _write(done, arguments, notes):
    """Write all files or none, each complete; return lines to print."""
    folder = done.folder
    with _reserved(folder) as part:
        there = [name for name in done.files if (folder / name).exists()]
        if there and not arguments.force:
            raise Refused(
                f"another run has written {folder / there[0]}; give another --out, or "
                "--force to replace it"
            )
        lines = done.write(part, notes)
        for name in done.files:
            (part / name).replace(folder / name)
    paths = [str(folder / name) for name in done.files]
    if done.page:
        paths = [f"{paths[0]} (all details)", *done.files[1:]]
    return [*lines, f"written: {', '.join(paths)}"]


@contextlib.contextmanager
def _reserved(folder):
    """Reserve a folder for one run; gives a folder in it for incomplete files."""
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / ".writing"
    if part.is_dir() and time.time() - part.stat().st_mtime > _ABANDONED:
        shutil.rmtree(part)
    try:
        part.mkdir()
    except FileExistsError:
        raise Refused(
            f"another run writes to {folder} (or was killed: delete {part})"
        ) from None
    try:
        yield part
    finally:
        shutil.rmtree(part)
        if is_new and not any(folder.iterdir()):
            folder.rmdir()


# -- text ------------------------------------------------------------------------------


def rendered(template, **values):
    from sklearn_vbjfa.diagnosis.report import environment

    made = environment(is_page=False, package=__package__)
    return made.get_template(template).render(table=_tabulated, **values).rstrip("\n")


def _tabulated(columns):
    from tabulate import tabulate

    words = 1 + ("unit" in columns)
    return tabulate(
        list(zip(*columns.values())),
        headers=[head.strip() for head in columns],
        disable_numparse=True,
        colalign=[*["left"] * words, *["right"] * (len(columns) - words)],
    )


def _named(doubts, page):
    named = [one.rstrip(".") for one in doubts[:_NAMED]]
    if page:
        named = [_CLAUSE.match(one)[0] for one in named]
    if len(doubts) > len(named):
        named.append(f"and {len(doubts) - len(named)} more")
    return "; ".join(named)


def _print(*lines):
    """Print to stdout, which may be closed, as by ``head``, or lack characters."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        print(*lines, sep="\n", end="\n" if lines else "", flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say(text):
    print(in_options(text), file=sys.stderr, flush=True)


def one_line(message):
    """Return a message as one line, without the middle of a huge one."""
    text = " ".join(str(message).split())
    cut = f"{text[:600]} ... {text[-290:]}"
    return text if len(text) <= _LONGEST else cut
