"""Command line: close the loop, simulate, compare methods, list effects and sets."""

import argparse
import contextlib
import os
import re
import shlex
import shutil
import signal
import sys
import textwrap

from sklearn_vbjfa._cli import _exit_codes
from sklearn_vbjfa._cli._stopping import (
    Stopped,
    ignore_stops,
    open_streams,
    stoppable,
    stopped_by,
)

# Longest message [characters].
_LONGEST = 900


def main(argv=None):
    """Run the command line; return its exit code, see `_exit_codes`."""
    # 0 if the result can be used; 2 if nothing was done, with one line on stderr; 3 if
    # it was done with a doubt, which is stated; 128 plus the signal's number if the run
    # was stopped, so 130 for an interrupt.
    arguments = None
    try:
        with stoppable():
            # Imports take a second, in which a run may be stopped as well.
            arguments = _arguments(argv)
            from sklearn_vbjfa.physical import one_blas_thread

            # The matrices are small: threads would only wait for each other.
            with one_blas_thread():
                arguments.run(arguments)
            _flush()
    except BrokenPipeError:
        # The reader (head, less) has seen enough.
        _no_more_output()
    except (KeyboardInterrupt, Stopped) as stop:
        return _tell_stop(getattr(stop, "number", signal.SIGINT), arguments)
    except MemoryError:
        _tell(
            "not enough memory; give a shorter recording or fewer effects (--effects)"
        )
        return _given_up(arguments)
    except (ValueError, OSError, ImportError) as error:
        if stopped_by() is not None:
            return _tell_stop(stopped_by(), arguments)
        line = one_line(_in_words(error, arguments))
        command = _command(argv, getattr(error, "options", None))
        _say(line, command or _content(error))
        return _given_up(arguments)
    if arguments is None or not arguments.doubts:
        return _exit_codes.USABLE
    _note(_exit_codes.line(arguments.doubts))
    return _exit_codes.DOUBTFUL


def _given_up(arguments):
    """Return the exit code of a run that could not go on to its end."""
    is_written = arguments is not None and arguments.written
    return _exit_codes.DOUBTFUL if is_written else _exit_codes.REFUSED


def _in_words(error, arguments):
    """Return what a refusal says, without what only concerns callers of a function."""
    done = arguments is not None and arguments.written
    written = "; all files were written" if done else ""
    if isinstance(error, OSError) and error.strerror:
        # Writing to a stream names no file.
        what = error.filename or "the standard output"
        return f"{what}: {error.strerror}{written}"
    return f"{getattr(error, 'reason', error)}{written}"


# Options of the command line, by the arguments of `read_recording`.
_OPTIONS = {
    "acceleration": "--acceleration",
    "base_orientation": "--base-orientation",
    "columns": "--columns",
    "dt": "--dt",
    "duration": "--duration",
    "gains": "--gain",
    "joint_names": "--joints",
    "out": "--out",
    "preset": "--preset",
    "scale": "--scale",
    "start": "--start",
    "time_unit": "--time-unit",
    "topic": "--topic",
    "torque": "--torque",
    "velocity": "--velocity",
}


def _command(argv, options):
    """Say which command would work, given the options to add; "" for none."""
    if not options:
        return ""
    words, changed = [], {_OPTIONS[key]: value for key, value in options.items()}
    given = iter(sys.argv[1:] if argv is None else argv)
    for word in given:
        option = str(word).partition("=")[0]
        if option not in changed:
            words.append(str(word))
        elif "=" not in str(word):
            next(given, None)
    for option, value in changed.items():
        if isinstance(value, tuple):
            value = ",".join(x if isinstance(x, str) else f"{x:.15g}" for x in value)
        elif isinstance(value, float):
            value = f"{value:.15g}"
        if value is not None:
            # A list that begins with a minus would be taken for an option.
            minus = str(value).startswith("-")
            words += [f"{option}={value}"] if minus else [option, value]
    return f"python -m sklearn_vbjfa {shlex.join(words)}"


def _content(error):
    """Say what a file would have to hold; "" for nothing."""
    content = getattr(error, "content", "")
    return f"a file with {content}" if content else ""


def _tell_stop(number, arguments):
    """Say that a signal has stopped the run; the exit code."""
    name = signal.Signals(number).name
    how = "interrupted" if number == signal.SIGINT else f"stopped ({name})"
    written = arguments is not None and arguments.written
    _clear_progress()
    _tell(f"{how}, {'all files were' if written else 'nothing was'} written")
    return 128 + number


def program():
    """Run the command line as a program of its own; return the exit code of `main`."""
    try:
        open_streams()
        return main()
    except KeyboardInterrupt:
        # Before or after a run takes care of it.
        _tell("interrupted")
        return 128 + signal.SIGINT
    finally:
        ignore_stops()


def _arguments(argv):
    """Parse arguments; what a parser prints may meet a reader that has left."""
    try:
        given = sys.argv[1:] if argv is None else argv
        parser = _parser()
        arguments, more = parser.parse_known_args(_joined(list(map(str, given))))
        files = getattr(arguments, "recording", None)
        options = [word for word in more if word.startswith("-") and word != "-"]
        if isinstance(files, list) and not options:
            # Recordings behind an option, which argparse leaves over.
            files += more
        elif more:
            parser.error(f"unrecognized arguments: {' '.join(more)}")
        return arguments
    finally:
        _flush()


def _joined(words):
    """Join options and the lists of numbers behind them that begin with a minus."""
    found = []
    for word in words:
        if found and found[-1] == "--start" and re.match(r"-\.?\d", word):
            found[-1] += f"={word}"
        else:
            found.append(word)
    return found


def _flush():
    # A process without a standard output has none.
    if sys.stdout is not None:
        sys.stdout.flush()


def _no_more_output():
    """Let what is still printed go nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _say(message, command=""):
    """Print a refusal: one line, which a terminal gets wrapped but for a command."""
    if command:
        message += "; this would work:"
    if sys.stderr is not None and sys.stderr.isatty():
        width = max(shutil.get_terminal_size().columns, 40)
        name = "sklearn-vbjfa: "
        lines = textwrap.fill(
            message, width, initial_indent=name, break_on_hyphens=False
        )
        message = "\n".join(filter(None, [lines.removeprefix(name), command]))
    elif command:
        message += f" {command}"
    _tell(message)


def _tell(message):
    """Print a message to stderr; one that nobody can read is no error of its own."""
    with contextlib.suppress(OSError):
        print(f"sklearn-vbjfa: {message}", file=sys.stderr, flush=True)


def _note(text):
    """Print a note to stderr, which a terminal gets wrapped."""
    from sklearn_vbjfa._cli._input import wrapped

    if sys.stderr is None:
        return
    with contextlib.suppress(OSError):
        text = one_line(f"note: {text}")
        print(wrapped(text, sys.stderr), file=sys.stderr, flush=True)


def one_line(message):
    """Return a message as one line; of a huge one the middle is left out, and said."""
    text = " ".join(str(message).split())
    if len(text) > _LONGEST:
        left = len(text) - _LONGEST
        begin, end = text[: _LONGEST - 300], text[-300:]
        text = f"{begin} (and {left} characters more) {end}"
    return text


class _Parser(argparse.ArgumentParser):
    """Parser that tells the exit codes, whose refusals are as short as a run's."""

    def __init__(self, **given):
        super().__init__(epilog=_exit_codes.EPILOG, **given)

    def error(self, message):
        super().error(one_line(message))


def _clear_progress():
    if sys.stderr is not None and sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)


def _parser():
    from sklearn_vbjfa import __version__
    from sklearn_vbjfa._cli import (
        _close_loop,
        _design,
        _identify,
        _inspect,
        _simulate,
    )

    parser = _Parser(
        prog="sklearn-vbjfa",
        description="Robot identification with noise in inputs and outputs. Without "
        "a command, close the loop on the recording that comes with the package.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    parser.set_defaults(run=_close_loop.run_demo, written=False, doubts=())
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    _close_loop.add_to(commands)
    _inspect.add_to(commands)
    _simulate.add_to(commands)
    _design.add_to(commands)
    _identify.add_to(commands)
    effects = commands.add_parser("effects", help="list the library of effects")
    effects.set_defaults(run=_effects)
    datasets = commands.add_parser("datasets", help="list the measured sets")
    datasets.set_defaults(run=_datasets)
    return parser


def _effects(arguments):
    from tabulate import tabulate

    from sklearn_vbjfa.effects import resolve

    rows = []
    for effect in resolve("all"):
        summary = (type(effect).__doc__ or "").strip().splitlines()[0]
        rows.append([effect.name, summary.rstrip("."), effect.visible])
    print(
        tabulate(
            rows,
            headers=["name", "effect", "shows if the recording has"],
            maxcolwidths=[None, 46, 34],
        )
    )


def _datasets(arguments):
    from tabulate import tabulate

    from sklearn_vbjfa.datasets import protocols

    rows = []
    for name, protocol in protocols().items():
        summary = (protocol.load.__doc__ or "").strip().splitlines()[0]
        rows.append([name, summary])
    print(tabulate(rows, headers=["name", "recording"], maxcolwidths=[None, 56]))
