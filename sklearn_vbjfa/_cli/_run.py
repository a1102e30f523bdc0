"""Execution of a command: computation, files, output and exit code."""

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

from sklearn_vbjfa._cli._parser import Refused, with_options

# Exit codes: success; nothing was done; finished with warnings.
SUCCESS, REFUSED, WARNED = 0, 2, 3

# Maximum length of a message [characters].
_MAX_LENGTH = 900
# Maximum number of warnings in the last line.
_N_NAMED = 3
# First clause of a message, with parentheses; a file name may precede it.
_CLAUSE = re.compile(r"([^;:]*(\.\w+| alone): )?\S+( (\([^)]*\)|.)*?)?(?=[;:.] |$)")
# Age from which unfinished files are attributed to a killed run [s].
_MAX_AGE = 3600.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    text: str  # to print
    doubts: tuple | list = ()  # warnings that forbid a use
    data: dict | str | None = None  # for --json: a report, or the name of its file
    folder: Path | None = None  # output folder
    files: tuple = ()  # names of the files
    # Writes the files to a folder, given the notes; returns further lines to print.
    write: Callable | None = None
    page: bool = False  # whether the first file is a page with all details


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
        result = command(arguments, Path(folder))
        if not as_json:
            _print(with_options(result.text))
        lines = _write(result, arguments, _notes(caught)) if result.write else []
    if as_json:
        lines = [json.dumps(result.data, indent=1)]
        if isinstance(result.data, str):
            lines = [(result.folder / result.data).read_text(encoding="utf-8")]
    _print(*lines)
    doubts = [w.message for w in caught if issubclass(w.category, DoubtWarning)]
    doubts = (" ".join(str(x).split()) for x in (*result.doubts, *doubts))
    doubts = list(dict.fromkeys(doubts))
    notes = [text for text in _notes(caught) if text not in doubts[:_N_NAMED]]
    if notes and result.page:
        notes = [one_line(f"{_listed(notes, False)} (page)")]
    for text in notes:
        say(f"note: {text}")
    if not doubts:
        return SUCCESS
    line = one_line(f"warning: {_listed(doubts, result.page)}")
    say(f"{line} (exit code {WARNED})")
    return WARNED


def _notes(caught):
    from sklearn.exceptions import ConvergenceWarning

    # Convergence warnings concern rivals of the reported model.
    texts = (
        " ".join(str(warning.message).split())
        for warning in caught
        if issubclass(warning.category, UserWarning)
        and warning.category is not ConvergenceWarning
    )
    return tuple(dict.fromkeys(texts))


def _write(result, arguments, notes):
    """Write all files completely, or none; return lines to print."""
    folder = result.folder
    with _reserve(folder) as part:
        taken = [name for name in result.files if (folder / name).exists()]
        if taken and not arguments.force:
            raise Refused(
                f"another run has written {folder / taken[0]}; give another --out, or "
                "--force to replace it"
            )
        lines = result.write(part, notes)
        written = [name for name in result.files if (part / name).exists()]
        for name in written:
            (part / name).replace(folder / name)
        for name in {*result.files}.difference(written):
            (folder / name).unlink(missing_ok=True)
    paths = [str(folder / name) for name in written]
    if result.page:
        paths = [f"{paths[0]} (all details)", *written[1:]]
    return [*lines, f"written: {', '.join(paths)}"]


@contextlib.contextmanager
def _reserve(folder):
    """Reserve a folder for one run; yield a subfolder for incomplete files."""
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / ".writing"
    if part.is_dir() and time.time() - part.stat().st_mtime > _MAX_AGE:
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


def render_template(template, **values):
    from sklearn_vbjfa.diagnosis.report import environment

    jinja = environment(is_page=False, package=__package__)
    return jinja.get_template(template).render(table=_table, **values).rstrip("\n")


def _table(columns):
    from tabulate import tabulate

    n_texts = 1 + ("unit" in columns)
    return tabulate(
        list(zip(*columns.values())),
        headers=[head.strip() for head in columns],
        disable_numparse=True,
        colalign=[*["left"] * n_texts, *["right"] * (len(columns) - n_texts)],
    )


def _listed(doubts, page):
    texts = [text.rstrip(".") for text in doubts[:_N_NAMED]]
    if page:
        texts = [_CLAUSE.match(text)[0] for text in texts]
    if len(doubts) > len(texts):
        texts.append(f"and {len(doubts) - len(texts)} more")
    return "; ".join(texts)


def _print(*lines):
    """Print to stdout, which may be closed (``head``) or lack characters."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        print(*lines, sep="\n", end="\n" if lines else "", flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say(text):
    print(with_options(text), file=sys.stderr, flush=True)


def one_line(message):
    """Return a message as one line; long ones are shortened in the middle."""
    text = " ".join(str(message).split())
    short = f"{text[:600]} ... {text[-290:]}"
    return text if len(text) <= _MAX_LENGTH else short
