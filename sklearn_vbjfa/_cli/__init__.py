"""Command line of the package."""

import sys

from sklearn_vbjfa._cli._parser import command_line, parse
from sklearn_vbjfa._cli._run import REFUSED, one_line, run, say


def main(argv=None):
    """Run the command line, by default that of the process; return the exit code."""
    arguments = None
    try:
        arguments = parse(list(map(str, sys.argv[1:] if argv is None else argv)))
        from sklearn_vbjfa._core._runtime import one_blas_thread

        # Matrices are small, so that further BLAS threads only add overhead.
        with one_blas_thread():
            return run(arguments)
    except KeyboardInterrupt:
        say("sklearn-vbjfa: interrupted")
        return 130
    except MemoryError:
        reason = "not enough memory; give a shorter log or fewer effects (--effects)"
        options = {}
    except (ValueError, OSError, ImportError) as error:
        reason = getattr(error, "reason", error)
        if isinstance(error, OSError) and error.strerror:
            reason = f"{error.filename or 'output'}: {error.strerror}"
        options = getattr(error, "options", {})
    line = f"sklearn-vbjfa: {one_line(reason)}"
    if options and hasattr(arguments, "recording"):
        from sklearn_vbjfa._cli._input import checked

        options = checked(arguments, options)
    if options:
        line += f"; this would work: {command_line(arguments, options)}"
    say(line)
    return REFUSED
