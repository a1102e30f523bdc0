"""Command line: close the loop, simulate, compare methods, list effects and sets."""

import argparse
import os
import signal
import sys

# Longest message [characters].
_LONGEST = 900


def main(argv=None):
    """Run the command line.

    Parameters
    ----------
    argv : list of str, default=None
        Arguments; None takes those of the process.

    Returns
    -------
    int
        Exit code: 0 for success; 2 for bad input, with one line on stderr; 128 plus
        the signal's number if the run was stopped, so 130 for an interrupt.
    """
    from sklearn_vbjfa._cli._input import Stopped, stoppable
    from sklearn_vbjfa.physical._threads import one_blas_thread

    parser = _parser()
    arguments = parser.parse_args(argv)
    try:
        # The matrices are small: threads would only wait for each other.
        with stoppable(), one_blas_thread():
            arguments.run(arguments)
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader (head, less) has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (KeyboardInterrupt, Stopped) as stop:
        number = getattr(stop, "number", signal.SIGINT)
        how = "interrupted" if number == signal.SIGINT else f"stopped ({stop})"
        state = "all files" if arguments.written else "nothing"
        _clear_progress()
        print(
            f"sklearn-vbjfa: {how}, {state} {'were' if arguments.written else 'was'} "
            "written",
            file=sys.stderr,
        )
        return 128 + number
    except MemoryError:
        print(
            "sklearn-vbjfa: not enough memory; give a shorter recording or fewer "
            "effects (--effects)",
            file=sys.stderr,
        )
        return 2
    except (ValueError, OSError, ImportError) as error:
        print(f"sklearn-vbjfa: {one_line(error)}", file=sys.stderr)
        return 2
    return 0


def one_line(message):
    """Return a message as one line, the middle of a long one left out."""
    text = " ".join(str(message).split())
    if len(text) > _LONGEST:
        text = f"{text[: _LONGEST - 300]} ... {text[-300:]}"
    return text


class _Parser(argparse.ArgumentParser):
    """Parser whose refusals are as short as those of a run."""

    def error(self, message):
        super().error(one_line(message))


def _clear_progress():
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)


def _parser():
    from sklearn_vbjfa import __version__
    from sklearn_vbjfa._cli import _close_loop, _identify, _simulate

    parser = _Parser(
        prog="sklearn-vbjfa",
        description="Robot identification with noise in inputs and outputs. Without "
        "a command, close the loop on the recording that comes with the package.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    parser.set_defaults(run=_close_loop.run_demo, written=False)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    _close_loop.add_to(commands)
    _simulate.add_to(commands)
    identify = commands.add_parser(
        "identify",
        help="identify a measured set and compare methods on its held-out part",
        description="Identify a recording and compare methods on its held-out part.",
    )
    identify.add_argument(
        "--data",
        default="demo",
        metavar="NAME",
        help="demo (default) or a measured set; see the command datasets",
    )
    identify.add_argument(
        "--data-home",
        default=None,
        metavar="DIR",
        help="folder of the measured sets, by default scikit-learn's data folder; "
        "missing files are downloaded to it",
    )
    identify.set_defaults(run=_identify.run)
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

    from sklearn_vbjfa.datasets._catalogue import protocols

    rows = []
    for name, protocol in protocols().items():
        summary = (protocol.load.__doc__ or "").strip().splitlines()[0]
        rows.append([name, summary])
    print(tabulate(rows, headers=["name", "recording"]))
