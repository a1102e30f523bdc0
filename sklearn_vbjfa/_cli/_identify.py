"""The command ``identify``: held-out errors of several methods on one recording."""

import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sklearn_vbjfa._cli import _exit_codes, _input, _options

# What is identified of a recording of one's own, where no option says so.
_DEFAULTS = {"friction": _options.FRICTION, "bodies": "prior", "cutoff": "auto"}
_OF_RECORDING = (*_options.OF_READING, *_DEFAULTS, "urdf", "base_orientation")
_OF_SETS = ("data", "data_home")


def add_to(commands):
    """Add the command to a parser."""
    parser = commands.add_parser(
        "identify",
        help="identify a recording and compare methods on its held-out part",
        description="Identify a recording and compare the torque errors of fifteen "
        "methods on the part of it that was held out: of your own recording the last "
        "30 % (of each, if it holds several). Without RECORDING, the one that comes "
        "with the package, or a measured set. Nothing is written.",
    )
    _options.add_optional_files(parser)
    parser.add_argument(
        "--data",
        default=None,
        metavar="NAME",
        help="demo (default) or a measured set; see the command datasets",
    )
    parser.add_argument(
        "--data-home",
        default=None,
        metavar="DIR",
        help="folder of the measured sets, by default scikit-learn's data folder; "
        "missing files are downloaded to it",
    )
    _options.add_recording(parser, signals=False)
    _options.add_friction(parser)
    _options.add_bodies(parser)
    _options.add_cutoff(parser)
    parser.set_defaults(run=run, **dict.fromkeys(_DEFAULTS))


def run(arguments):
    """Identify a recording and compare methods on its held-out part."""
    from sklearn_vbjfa.robot._comparison import compare_methods

    _check(arguments)
    with (
        tempfile.TemporaryDirectory() as folder,
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        if not arguments.recording:
            task = _of_catalogue(arguments)
        else:
            task = _own(arguments, Path(folder))
        train, test = task.protocol.split(task.recording)
        try:
            results, fitted = compare_methods(
                task.identifier,
                _part(task.recording, train),
                _part(task.recording, test),
                on_progress=_progress(),
            )
        except ValueError as error:
            if not arguments.recording:
                raise
            # The options are valid, so the recording is at fault.
            source = _input.named(_input.sources(arguments.recording))
            raise ValueError(f"{source}: {error}") from error
    arguments.doubts = [
        *_doubts(results, fitted.joint_names_),
        *_exit_codes.of_warnings(caught),
    ]
    print(_report(task, results, fitted))
    say_warnings(caught)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Task:
    """What is identified.

    Attributes
    ----------
    recording : Recording
        Recording.
    protocol : Protocol
        What of it is fitted, and what is held out.
    identifier : RobotIdentifier
        Settings that all methods share.
    held : tuple of str
        Joints of the description that were not recorded.
    """

    recording: object
    protocol: object
    identifier: object
    held: tuple = ()


def _check(arguments):
    """Refuse options that do not go together, and fill in the others."""
    if not arguments.recording:
        _options.refuse_given(
            arguments,
            _OF_RECORDING,
            "needs a RECORDING; without one, a measured set is identified (--data), by "
            "default the recording that comes with the package",
        )
    else:
        _options.refuse_given(
            arguments, _OF_SETS, "is for the measured sets; leave it or RECORDING out"
        )
        if arguments.urdf is None:
            raise ValueError("give --urdf FILE, the description of the robot.")
    for name, value in _DEFAULTS.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, value)


def _of_catalogue(arguments):
    """Load a measured set, or the recording that comes with the package."""
    from sklearn_vbjfa import RobotIdentifier
    from sklearn_vbjfa.datasets._catalogue import protocols

    known, name = protocols(), arguments.data or "demo"
    if name not in known:
        raise ValueError(
            f"no recording is called {name!r}; expected one of {', '.join(known)}."
        )
    protocol = known[name]
    if name == "demo":
        recording = protocol.load()
    else:
        home = arguments.data_home
        recording = protocol.load(data_home=home and _input.path(home))
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        friction=protocol.friction,
        cutoff=protocol.cutoff,
        standstill=protocol.standstill,
    )
    return _Task(recording=recording, protocol=protocol, identifier=identifier)


def _own(arguments, folder):
    """Read a recording of one's own."""
    from sklearn_vbjfa import RobotIdentifier
    from sklearn_vbjfa.datasets._catalogue import Protocol
    from sklearn_vbjfa.effects import declarable

    source = _input.named(_input.sources(arguments.recording))
    friction = _input.names("--friction", arguments.friction, declarable())
    cutoff = _input.cutoff(arguments.cutoff)
    gains = _input.gains(arguments.gain)
    taken = _input.taken(arguments, gains, folder)
    _input.check_nyquist(cutoff, taken.recording, source)
    _input.check_gains(gains, None, taken.urdf)
    _input.check_channels(taken.recording, taken.urdf, gains, source)
    identifier = RobotIdentifier(
        str(taken.urdf),
        dt=taken.recording.dt,
        friction=friction,
        bodies=arguments.bodies,
        cutoff=cutoff,
        torque_noise=taken.recording.torque_noise,
        gains="unknown" if gains == "unknown" else None,
    )
    return _Task(
        recording=taken.recording,
        protocol=Protocol(friction=friction, cutoff=cutoff),
        identifier=identifier,
        held=taken.held,
    )


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


def _report(task, results, fitted):
    from tabulate import tabulate

    recording, protocol = task.recording, task.protocol
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
        _input.wrapped(
            f"{protocol.describe(recording)}; {cutoff}, standstill masked; friction: "
            f"{', '.join(protocol.friction) or 'none'}",
            sys.stdout,
        ),
        *([f"held at zero: {', '.join(task.held)}"] if task.held else []),
        "",
        "held-out torque error [% of the torque's standard deviation]",
        table,
        "",
        _input.wrapped(_consistency(results, len(names)), sys.stdout),
    ]
    return "\n".join(lines + _failed(results))


def _failed(results):
    """Name the methods that failed, and why."""
    return [f"{r.name} failed: {r.message}" for r in results if r.message]


def _doubts(results, joints):
    """Name methods that failed, joints without an error, and bodies that cannot be."""
    ours = results[0]
    doubts = _failed(results)
    blank = [] if ours.message else np.flatnonzero(~np.isfinite(ours.error))
    if len(blank):
        doubts.append(f"no error of {', '.join(joints[j] for j in blank)}")
    if ours.n_inconsistent:
        doubts.append(f"{ours.n_inconsistent} bodies are not physically consistent")
    return doubts


def _overall(result):
    finite = np.isfinite(result.error)
    return 100 * float(np.mean(result.error[finite])) if finite.any() else np.nan


def _consistency(results, n_bodies):
    from sklearn_vbjfa.robot._comparison import PROJECTED

    ours = results[0]
    plain = [r for r in results if r.name not in PROJECTED and not r.message]
    broken = {r.n_inconsistent for r in plain}
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
