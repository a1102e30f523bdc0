"""The commands that only tell: ``identify``, ``inspect``, ``effects``, ``datasets``."""

import contextlib
import sys
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._cli import READING, _input
from sklearn_vbjfa._cli._run import Done, blaming, wrapped

_OF_RECORDING: tuple[str, ...] = (
    *READING,
    "friction",
    "bodies",
    "alike",
    "cutoff",
    "urdf",
)
_OF_RECORDING += ("base_orientation",)
_OF_SETS = ("data", "data_home")
# Which method is the declared model of close-loop, by what is taken of the bodies.
_DECLARED = {"prior": " (its declared model is VB + description)"}
_TOO_SHORT = "too short for a look at the motion"


def list_effects(arguments, folder):
    """List the library of effects."""
    from sklearn_vbjfa.effects import resolve

    rows = [[one.name, _summary(type(one)), one.visible] for one in resolve("all")]
    heads = ["name", "effect", "shows if the recording has"]
    return _listed(rows, heads, [None, 46, 34])


def list_datasets(arguments, folder):
    """List the measured sets."""
    from sklearn_vbjfa.datasets._measured import protocols

    rows = [[name, _summary(one.load, ".")] for name, one in protocols().items()]
    return _listed(rows, ["name", "recording"], [None, 56])


def _summary(described, stop=""):
    """Return the first line of a docstring, which ends with `stop`."""
    line = (described.__doc__ or "").strip().splitlines()[0]
    return line.rstrip(".") + stop


def _listed(rows, headers, widths):
    from tabulate import tabulate

    return Done(text=tabulate(rows, headers=headers, maxcolwidths=widths))


# -- methods compared ------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class _Task:
    """What is identified."""

    recording: object
    parts: tuple  # what of it is fitted, and what is held out: (q, tau, labels) each
    told: str  # the same in words
    identifier: object  # settings that all methods share
    source: object = None  # files that were read, named
    held: tuple = ()  # joints of the description that were not recorded
    followed: object = None  # robot fitted with its drive, that of the ranges


def identify(arguments, folder):
    """Identify a recording and compare methods on its held-out part."""
    from sklearn_vbjfa.robot._comparison import compare_methods

    _check(arguments)
    ranges = _input.ranges_file(arguments)
    task = (_own if arguments.recording else _of_catalogue)(arguments, folder)
    own = bool(arguments.recording)
    # A measured set is not at fault; it is judged by its protocol.
    with blaming(task.source) if own else contextlib.nullcontext():
        results, fitted = compare_methods(task.identifier, *task.parts, of_both=own)
    done = Done(
        text=_report(task, results, fitted),
        doubts=method_doubts(results, fitted.joint_names_),
    )
    if ranges is None:
        return done

    def write(folder, warned):
        (task.followed or fitted).ranges().save(folder / ranges.name)
        return []

    return replace(done, folder=ranges.parent, files=(ranges.name,), write=write)


def _check(arguments):
    """Refuse options that do not go together."""
    if not arguments.recording:
        _input.refuse_given(
            arguments,
            _OF_RECORDING,
            "needs a RECORDING; without one, a measured set is identified (--data), by "
            "default the recording that comes with the package",
        )
        return
    _input.refuse_given(
        arguments, _OF_SETS, "is for the measured sets; leave it or RECORDING out"
    )
    if arguments.urdf is None:
        raise ValueError("give --urdf FILE, the description of the robot.")


def _of_catalogue(arguments, folder):
    """Load a measured set, or the recording that comes with the package."""
    from sklearn_vbjfa import RobotIdentifier
    from sklearn_vbjfa.datasets import protocols

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
        recording = protocol.load(data_home=home and _input.expanded(home))
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        friction=protocol.friction,
        cutoff=protocol.cutoff,
        standstill=protocol.standstill,
    )
    parts = [
        (recording.q[rows], recording.tau[rows], recording.groups[rows])
        for rows in protocol.split(recording)
    ]
    return _Task(
        recording=recording,
        parts=tuple(parts),
        told=protocol.describe(recording),
        identifier=identifier,
    )


def _own(arguments, folder):
    """Read a recording of one's own."""
    from sklearn.base import clone

    from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
    from sklearn_vbjfa.diagnosis.explain import split_in_time

    settings, taken = _input.settings(arguments), _input.taken(arguments, folder)
    recording, drive = taken.recording, settings.pop("drive", None)
    taken.check(settings)
    taken.check_channels()
    identifier = RobotIdentifier(
        str(taken.urdf),
        dt=recording.dt,
        torque_noise=recording.torque_noise,
        **settings,
    )
    # What close-loop does not touch is held out here, so that both say the same of the
    # declared model.
    robot, share = None, EffectDiscovery(identifier).test_size
    with blaming(taken.source):
        told = clone(identifier).set_params(drive=drive)
        split = split_in_time(told, recording, share)
        if drive is not None:
            recording, robot = _at_delay(recording, split, drive, told)
    if drive is not None and recording.nv > 1:
        identifier.set_params(gains=drive.gains)
    parts = [part(recording) for part in (split.searched, split.untouched)]
    seconds, count = parts[1].n_samples * recording.dt, len(split.stretches)
    return _Task(
        recording=recording,
        parts=tuple((part.q, part.tau, part.groups) for part in parts),
        told=(
            f"held out: {seconds:.3g} s in {count} stretch{'es' if count > 1 else ''}, "
            "those of close-loop, which leaves out the rows right beside what it fits"
            f"{_DECLARED.get(settings['bodies'], '')}"
        ),
        identifier=identifier,
        source=taken.source,
        held=taken.held,
        followed=robot,
    )


def _at_delay(recording, split, drive, identifier):
    """Make torques of commands at the delay of the fitted part; return its robot."""
    # All methods get the same torques.
    robot = identifier.fit_inspected(split.searched(recording))
    return _input.followed(drive, robot, recording), robot


def _report(task, results, fitted):
    from tabulate import tabulate

    recording, names = task.recording, fitted.joint_names_
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
        wrapped(
            f"{task.told}; {cutoff}, standstill masked; friction: "
            f"{', '.join(task.identifier.friction) or 'none'}",
            sys.stdout,
        ),
        *([f"held at zero: {', '.join(task.held)}"] if task.held else []),
        *_said_of_commands(task.followed),
        "",
        "held-out torque error [% of the torque's standard deviation]",
        table,
        "",
        wrapped(_consistency(results, len(names)), sys.stdout),
    ]
    return "\n".join(lines + _failed(results))


def _said_of_commands(robot):
    """Say how late commands act, a list of lines."""
    said = "" if robot is None else _input.said_delay(robot)
    return [f"no torque was measured: {said}"] if said else []


def _failed(results):
    """Name the methods that failed, and why."""
    return [f"{r.name} failed: {r.message}" for r in results if r.message]


def method_doubts(results, joints):
    """Name methods that failed, joints without an error, and bodies that cannot be."""
    ours = results[0]
    doubts = _failed(results)
    blank = [] if ours.message else np.flatnonzero(~np.isfinite(ours.error))
    if len(blank):
        doubts.append(f"no error of {', '.join(joints[j] for j in blank)}")
    doubts += [
        f"do not trust the model of {joints[j]}: it predicts the held-out torque worse "
        "than its mean does"
        for j in np.flatnonzero(ours.error >= 1.0)
    ]
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


# -- a recording described -------------------------------------------------------------


def inspect(arguments, folder):
    """Read a recording and describe it."""
    from sklearn_vbjfa.inspection import motion_of

    # A current is as good as a torque here: nothing is identified.
    taken = _input.taken(arguments, folder, assumed="unknown")
    taken.signals(arguments.signals)
    recording, findings = taken.recording, taken.findings()
    motions = motion_of(recording, str(taken.urdf))
    text = [
        *_what(recording, taken.other_joints()),
        "",
        *_table(recording, motions),
        "",
        *_wrong(recording, findings, arguments.drive),
        "",
        *_shown(motions),
    ]
    doubts = [*([] if motions else [_TOO_SHORT]), *_input.channel_doubts(findings)]
    return Done(text="\n".join(text), doubts=doubts)


def _what(recording, others):
    """Say what the data are; others : lines on joints without columns."""
    lengths = np.bincount(recording.groups) * recording.dt
    listed = [
        f"{name} {length:.4g} s" for name, length in zip(recording.group_names, lengths)
    ]
    lines = [
        str(recording),
        wrapped(
            f"{recording.n_samples * recording.dt:.4g} s at {1 / recording.dt:.6g} Hz: "
            f"{', '.join(listed)}",
            sys.stdout,
        ),
    ]
    if recording.signals:
        names = [name for name in recording.signals if name != "a"]
        lines.append(f"signals beside the motion: {', '.join(names) or 'none'}")
    if recording.torque_noise is not None:
        lines.append("rows were interpolated on a uniform grid")
    return [*lines, *others]


def _table(recording, motions):
    """Tabulate what each joint does."""
    from tabulate import tabulate

    if not motions:
        return [_TOO_SHORT]
    rows = []
    for motion, unit in zip(motions, recording.torque_units):
        scale, name = (1e3, "mm") if motion.slides else (180 / np.pi, "deg")
        rows.append(
            [
                motion.name,
                f"{scale * motion.lowest:.4g} to {scale * motion.highest:.4g} {name}",
                f"{scale * motion.fastest:.3g} {name}/s",
                str(motion.reversals),
                f"{100 * motion.resting:.0f} %",
                f"{motion.torques[0]:.3g} to {motion.torques[1]:.3g} {unit}",
                f"{motion.loads[0]:.3g} to {motion.loads[1]:.3g} "
                f"{'N' if motion.slides else 'N m'}",
            ]
        )
    heads = ["joint", "position", "speed", "reversals", "at rest", "torque"]
    table = tabulate(
        rows,
        headers=[*heads, "of it gravity"],
        disable_numparse=True,
        colalign=("left", *6 * ["right"]),
    )
    return table.splitlines()


def _wrong(recording, findings, drive):
    """Say what is wrong with the channels."""
    odd = [unit for unit in recording.torque_units if unit not in ("N m", "N")]
    lines = ["What is wrong with it"]
    lines += [f"- {x.severity}: {x.message}" for x in findings]
    if odd and drive is None:
        lines.append(
            f"- torques are recorded in {odd[0]}: close-loop needs the factors to N m "
            f"(--gain){', or --gain unknown' if recording.nv > 1 else ''}"
        )
    return lines if len(lines) > 1 else [*lines, "- nothing that the robot would show"]


def _shown(motions):
    """Say what the motion can show and what it cannot, joints with the same in one."""
    lines = []
    for head, of in (
        ("What it can show", lambda motion: motion.shows),
        ("What it can hardly show, or not at all", lambda motion: motion.hides),
    ):
        joints = {}
        for motion in motions:
            for what in of(motion):
                joints.setdefault(what, []).append(motion.name)
        lines.append(head)
        for what, names in joints.items():
            every = len(names) == len(motions) > 1
            lines.append(f"- {'all joints' if every else ', '.join(names)}: {what}")
        if not joints:
            lines.append("- nothing")
    return lines
