"""Command line of the package."""

import sys

from sklearn_vbjfa._cli._parser import command_line, parse
from sklearn_vbjfa._cli._run import REFUSED, one_line, run, say


def main(argv=None):
    """Run the command line, by default that of the process; return the exit code."""
    arguments = None
    try:
        arguments = parse(list(map(str, sys.argv[1:] if argv is None else argv)))
        from sklearn_vbjfa._core._threads import one_blas_thread

        # The matrices are small: threads would only wait for each other.
        with one_blas_thread():
            return run(arguments)
    except KeyboardInterrupt:
        _refuse("interrupted")
        return 130
    except MemoryError:
        _refuse("not enough memory; give a shorter log or fewer effects (--effects)")
    except (ValueError, OSError, ImportError) as error:
        _refuse(_reason(error), _remedy(error, arguments))
    return REFUSED


def _reason(error):
    """Return the message of an exception."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'output'}: {error.strerror}"
    return getattr(error, "reason", error)


def _remedy(error, arguments):
    """Return the command with the options that an exception offers, if any."""
    options = getattr(error, "options", {})
    return command_line(arguments, options) if options else ""


def _refuse(reason, remedy=""):
    """Print a refusal in one line, with the command that would work."""
    more = f"; this would work: {remedy}" if remedy else ""
    say(f"sklearn-vbjfa: {one_line(reason)}{more}")
