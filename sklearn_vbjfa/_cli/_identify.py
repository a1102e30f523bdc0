"""The command ``identify``: held-out errors of several methods on one recording."""

import sys
import warnings

import numpy as np

from sklearn_vbjfa._cli import _input


def run(arguments):
    """Identify a recording and compare methods on its held-out part."""
    from sklearn_vbjfa import RobotIdentifier
    from sklearn_vbjfa.datasets._catalogue import protocols
    from sklearn_vbjfa.robot._comparison import compare_methods

    known = protocols()
    if arguments.data not in known:
        raise ValueError(
            f"no recording is called {arguments.data!r}; expected one of "
            f"{', '.join(known)}."
        )
    protocol = known[arguments.data]
    if arguments.data == "demo":
        recording = protocol.load()
    else:
        recording = protocol.load(data_home=arguments.data_home)
    train, test = protocol.split(recording)
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        friction=protocol.friction,
        cutoff=protocol.cutoff,
        standstill=protocol.standstill,
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        results, fitted = compare_methods(
            identifier,
            _part(recording, train),
            _part(recording, test),
            on_progress=_progress(),
        )
    print(_report(recording, protocol, results, fitted))
    say_warnings(caught)


def _part(recording, rows):
    return recording.q[rows], recording.tau[rows], recording.groups[rows]


def _progress():
    """Name each method while it runs, on a terminal only."""
    if not sys.stderr.isatty():
        return None

    def show(name):
        print(f"\r\033[K{name} ...", end="", file=sys.stderr, flush=True)

    return show


def say_warnings(caught):
    """Show warnings as notes on stderr, each once."""
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)
    for text in told(caught):
        print(_input.wrapped(f"note: {text}", sys.stderr), file=sys.stderr)


def told(caught):
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


def _report(recording, protocol, results, fitted):
    from tabulate import tabulate

    names = fitted.joint_names_
    percent = [
        [result.name, *(100 * result.error), _overall(result)] for result in results
    ]
    table = tabulate(
        percent,
        headers=["method", *names, "mean"],
        floatfmt=".1f",
        missingval="failed",
    )
    cutoff = (
        f"low-pass {fitted.cutoff_:.3g} Hz"
        if np.isfinite(fitted.cutoff_)
        else "no low-pass"
    )
    lines = [
        f"{recording}",
        f"{protocol.describe(recording)}; {cutoff}, standstill masked; friction: "
        f"{', '.join(protocol.friction)}",
        "",
        "held-out torque error [% of the torque's standard deviation]",
        table,
        "",
        _consistency(results, len(names)),
    ]
    failed = [f"{r.name} failed: {r.message}" for r in results if r.message]
    return "\n".join(lines + failed)


def _overall(result):
    finite = np.isfinite(result.error)
    return 100 * float(np.mean(result.error[finite])) if finite.any() else np.nan


def _consistency(results, n_bodies):
    ours = results[0]
    broken = {r.n_inconsistent for r in results[1:] if not r.message}
    spread = f"{min(broken)}" if len(broken) == 1 else f"{min(broken)} to {max(broken)}"
    state = (
        f"all {n_bodies} bodies physically consistent"
        if ours.n_inconsistent == 0
        else f"{ours.n_inconsistent} of {n_bodies} bodies NOT physically consistent"
    )
    return (
        f"physical consistency: {ours.name}: {state} (smallest pseudo-inertia "
        f"eigenvalue {ours.min_eigenvalue:.2g}, in units of each body's mass and "
        f"length); without projection {spread} of {n_bodies} bodies are impossible."
    )
