"""Input of the command line, checked or refused: arguments and files."""

import contextlib
import errno
import itertools
import math
import os
import sys
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sklearn_vbjfa._cli import spelled
from sklearn_vbjfa._cli._run import blaming

# How a cell begins that a spreadsheet computes.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
# Fewer consecutive samples show nothing.
_MIN_SAMPLES = 64
# Warnings about channels that are left out of what was asked for.
_LEFT_OUT = ("coarse_torque", "still_joint")


class Refused(ValueError):
    """An argument that is refused, with options that would be accepted."""

    def __init__(self, reason, options=None):
        super().__init__(reason)
        self.options = options or {}


def refuse_given(arguments, names, why):
    """Refuse the first of some options that is given."""
    for name in names:
        if name in arguments.given:
            raise ValueError(f"{spelled(name)} {why}.")


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedRecording:
    """A recording, of one file or several, and its robot."""

    recording: object
    urdf: object  # description in which the joints that were not recorded are fixed
    source: object  # what to call what was read
    held: tuple = ()  # those joints
    gains: object = None  # what was said of the channels of torque
    drive: object = None  # `Drive` that torques were made by
    bodies: str = "prior"  # what is taken of the bodies that are described

    def check(self, chosen):
        """Refuse settings that the recording and its robot cannot show."""
        _check_nyquist(chosen["cutoff"], self.recording, self.source)
        _check_gains(chosen["gains"], chosen["known_masses"], self.urdf)

    def findings(self):
        """Look for faults of the channels; factors that are unknown are none."""
        from sklearn_vbjfa.inspection import OF_SIZE, inspect_channels

        one = self.recording
        known = one.q, one.tau, one.dt, one.groups
        found = inspect_channels(str(self.urdf), *known, drive=self.drive)
        motor = any(unit not in ("N m", "N") for unit in self.recording.torque_units)
        known = self.drive is None or self.drive.gains is None
        allowed = ("torque_unit",) if self.bodies == "free" else ()
        if motor or self.gains == "unknown" or not known:
            allowed = OF_SIZE
        return [one for one in found if one.kind not in allowed]

    def check_channels(self):
        """Refuse channels that are not what they are called, warn of doubtful ones."""
        from sklearn_vbjfa.inspection import refusal
        from sklearn_vbjfa.model import DoubtWarning

        findings = self.findings()
        measured = self.drive is None and self.gains != "unknown"
        units = self.recording.torque_units if measured else ()
        with blaming(self.source, self.gains):
            wrong = refusal(findings, units)
            if wrong is not None:
                raise wrong
        for message in channel_doubts(findings):
            warnings.warn(f"{self.source}: {message}", DoubtWarning, stacklevel=2)

    def signals(self, text):
        """Return the signals that were asked for, by name; None takes what there is."""
        from sklearn_vbjfa.recording._columns import OfferedSignals

        offered = OfferedSignals.of_file(self.recording)
        if text is None:
            return offered
        if text.strip() == "none":
            return None
        known, n = offered.names, self.recording.n_samples
        if not known:
            raise ValueError(
                f"--signals has {text!r}, but {self.source} holds no columns beside "
                "time, positions, velocities, accelerations and torques."
            )
        found = names("--signals", text, known)
        try:
            return {name: offered.column(name, n) for name in found}
        except ValueError as error:
            raise ValueError(f"{self.source}: {error}") from None

    def other_joints(self):
        """Say which joints are held, and which follow others; a list of lines."""
        from sklearn_vbjfa.model import _loading

        lines = [f"held at zero: {', '.join(self.held)}"] if self.held else []
        follow = [body.name for body in _loading.load_folded(self.urdf).followers]
        if follow:
            lines.append(f"follow other joints, without columns: {', '.join(follow)}")
        return lines


def load(arguments, folder, *, assumed=None):
    """Read a recording and its robot; what is written of the robot goes to `folder`."""
    # assumed: gains of the channels where none are given.
    urdf, joints = expanded(arguments.urdf), joint_names(arguments.joints)
    known = gains(arguments.gain)
    if arguments.drive is not None:
        assumed = None
    urdf, held = robot(urdf, joints, folder, arguments.base_orientation)
    recording = read(arguments, urdf, joints, known or assumed)
    urdf, held = _hold_others(urdf, recording, held, folder)
    source = named(sources(arguments.recording))
    return LoadedRecording(
        recording=recording,
        urdf=urdf,
        source=source,
        held=tuple(held),
        gains=known,
        drive=drive(arguments.drive),
        bodies=getattr(arguments, "bodies", "prior"),
    )


def settings(arguments):
    """Return what is to be identified, settings of `RobotIdentifier`."""
    from sklearn_vbjfa.effects import declarable

    known, factors = declarable(), gains(arguments.gain)
    masses = getattr(arguments, "known_mass", ())
    follows = drive(arguments.drive)
    chosen = {} if follows is None else {"drive": follows}
    return chosen | {
        "friction": names("--friction", arguments.friction, known),
        "bodies": arguments.bodies,
        "alike": None if arguments.alike == "none" else arguments.alike,
        "cutoff": cutoff(arguments.cutoff),
        # factors that are known are in the recording that is read with them
        "gains": "unknown" if factors == "unknown" else None,
        "known_masses": known_masses(masses, factors),
    }


def drive(text):
    """Return the drive that the robot follows, None for torques."""
    from sklearn_vbjfa.recording import parse_drive

    try:
        return None if text is None else parse_drive(text)
    except ValueError as error:
        raise ValueError(f"--{error}") from None


def followed(follows, robot, recording):
    """Return a recording with the torques that the drive of a fitted robot made."""
    from sklearn_vbjfa.robot import signed

    late = command_delay(robot)
    follows = follows if late is None else replaced(follows, delay=late)
    driven = follows.driven(replace(recording, command=None))
    if follows.unsigned:
        driven = signed(getattr(robot, "robot_", robot), driven)
    return driven


def command_delay(robot):
    """Return how late the commands of a fitted robot act [s], None if not found."""
    from sklearn_vbjfa.effects import CommandDelay

    late = [x.delay for x in robot.effects_ if isinstance(x, CommandDelay)]
    return late[0] if late else None


def replaced(follows, **given):
    """Return a drive with other numbers."""
    from sklearn.base import clone

    return clone(follows).set_params(**given)


def said_delay(robot):
    """Say how late the commands of a fitted robot act, "" for nothing found."""
    from sklearn_vbjfa.diagnosis.explain._identified import parameter_values
    from sklearn_vbjfa.diagnosis.report import delay_sentence

    rows = [one for one in parameter_values(robot) if one.name == "drive:delay"]
    return " ".join(delay_sentence(one.value, one.interval) for one in rows)


def library(text):
    """Return the names of the effects to look for, or "all"."""
    from sklearn_vbjfa import effects

    return text if text == "all" else names("--effects", text, effects.available())


def free_folder(arguments, default, names):
    """Return the folder for files, refused if it holds what is not to be lost."""
    # names: what a run writes to it.
    out = expanded(arguments.out or default)
    check_folder(out)
    if arguments.force or not out.is_dir():
        return out
    # Hidden files are those of folders and editors.
    held = {path.name for path in out.iterdir() if not path.name.startswith(".")}
    foreign, there = sorted(held.difference(names)), sorted(held.intersection(names))
    if foreign:
        more = f" and {len(foreign) - 3} more" if len(foreign) > 3 else ""
        raise Refused(
            f"{out} holds {', '.join(foreign[:3])}{more}, which no run has written; "
            "give a folder of its own, or --force to write beside what is there",
            {"out": str(free(out / "report"))},
        )
    if not there:
        return out
    other = free(out)
    if arguments.out is None:
        # Said when they are written: a refusal is one line.
        arguments.moved = (
            f"{out} has the files of an earlier run, which stay (--force replaces them)"
        )
        return other
    raise Refused(
        f"{out} has {there[0]} of an earlier run; give another folder, or --force to "
        "replace it",
        {"out": str(other)},
    )


def ranges_file(arguments):
    """Return the path of --ranges, refused before the work begins; None for none."""
    if arguments.ranges is None:
        return None
    out = expanded(arguments.ranges)
    if out.is_dir() or (out.exists() and not arguments.force):
        raise Refused(
            f"{out} exists; give another --ranges", {"ranges": str(free(out))}
        )
    if not out.parent.is_dir():
        raise Refused(
            f"{out.parent} is not a folder, where --ranges writes {out.name}",
            {"ranges": str(free(Path(out.name)))},
        )
    _check_room(out.parent, "--ranges")
    return out


def robot(urdf, joints, folder, base_orientation=None):
    """Check a description; write one to `folder` with the unrecorded joints fixed."""
    # base_orientation: of a free base, a text. Returns the path to use and the names of
    # the fixed joints.
    from sklearn_vbjfa.model import (
        load_model,
        load_reduced,
        movable_joints,
        write_reduced,
    )

    if not urdf.is_file():
        raise FileNotFoundError(f"{urdf}: no such robot description; give --urdf FILE.")
    said, base = [], _quaternion(base_orientation)
    try:
        with _parser_messages(said):
            if joints:
                load_reduced(urdf, joints, base)
            else:
                load_model(urdf, base)
    except ValueError as error:
        where = "" if repr(str(urdf)) in str(error) else f"{urdf}: "
        reason = f" ({said[0]})" if said else ""
        raise ValueError(f"{where}{error}{reason}") from error
    # The parser continues without an inertia that it cannot read.
    lost = [line for line in said if "nerti" in line]
    if lost:
        raise ValueError(f"{urdf}: {'; '.join(lost)}; correct the description.")
    if not joints and base is None:
        return urdf, ()
    reduced, joints = folder / urdf.name, joints or movable_joints(urdf)
    held = write_reduced(urdf, reduced, joints, base)
    # Files written from this copy get the permissions of the original.
    reduced.chmod(urdf.stat().st_mode & 0o666)
    return reduced, held


def _quaternion(text):
    """Return the numbers in a comma-separated list, None for None."""
    if text is None:
        return None
    found = numbers(text)
    if any(map(math.isnan, found)):
        raise ValueError(
            f"--base-orientation must be four numbers W,X,Y,Z, got {text!r}."
        )
    return found


def number(text):
    """Return the number that a text is, nan for none."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan


def numbers(text):
    """Return the numbers in a comma-separated list; a single nan where one is none."""
    found = [number(x) for x in text.split(",")]
    return [math.nan] if any(map(math.isnan, found)) else found


def joint_names(text):
    """Return the names in a comma-separated list, none for None."""
    if text is None:
        return ()
    found = tuple(name.strip() for name in text.split(","))
    if not all(found):
        raise ValueError(
            f"--joints has an empty name in {text!r}; expected names of the URDF's "
            "joints with commas between them, in the order of the columns."
        )
    _refuse_twice("--joints", found)
    return found


@contextlib.contextmanager
def _parser_messages(said):
    """Collect what the URDF parser, which is compiled code, writes to stderr."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as file:
        stderr = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            file.seek(0)
            text = file.read().decode("utf-8", "replace")
            lines = [" ".join(line.split()) for line in text.splitlines()]
            errors = [x[len("Error: ") :] for x in lines if x.startswith("Error: ")]
            said += dict.fromkeys(errors)


def is_several(arguments):
    """Whether a recording is in several files."""
    from sklearn_vbjfa.recording import tables_in

    files = sources(arguments.recording)
    return len(files) > 1 or len(tables_in(files[0])) > 1


def read(arguments, urdf, joints, gains, *, identified=True):
    """Read a recording that is long enough."""
    # identified: whether gains that are unknown can be identified.
    from sklearn_vbjfa.datasets import read_recording
    from sklearn_vbjfa.recording import RecordingRefused

    files = sources(arguments.recording)
    source = named(files)
    try:
        recording = read_recording(
            files[0] if len(files) == 1 else files,
            dt=arguments.dt,
            urdf=str(urdf),
            joint_names=joints or None,
            columns=arguments.columns,
            preset=arguments.preset,
            topic=arguments.topic,
            gains=gains,
            time_unit=arguments.time_unit,
            drive=drive(arguments.drive),
            join=bool(arguments.join),
        )
    except RecordingRefused as error:
        if identified or error.options.get("gains") != "unknown":
            raise
        raise ValueError(
            f"{error.reason}; give the factors to N m as well (--gain), one for each "
            "joint."
        ) from error
    motor = [x for x in recording.torque_units if x not in ("N m", "N")]
    if motor and gains is None and arguments.drive is None:
        one = recording.nv == 1 or not identified
        raise RecordingRefused(
            f"{source}: the torques are recorded in {motor[0]}; give the factors to N "
            "m, torque constant times gear ratio, one for each of "
            f"{', '.join(recording.joint_names)}"
            f"{'' if one else ', or have them identified'} (--gain)",
            {} if one else {"gains": "unknown"},
        )
    longest = max(rows.stop - rows.start for rows in recording.segments)
    if longest < _MIN_SAMPLES:
        raise ValueError(
            f"{source}: the longest recording has {longest} samples in a row "
            f"({longest * recording.dt:.3g} s), too few; record some tens of seconds "
            "of motion."
        )
    ends = [
        [x.min(axis=0), x.max(axis=0)]
        for x in (np.asarray(recording.q[rows]) for rows in recording.segments)
    ]
    if not np.ptp(np.concatenate(ends), axis=0).any():
        raise ValueError(
            f"{source}: no joint moves in any row; expected a motion. Check the "
            "columns of positions."
        )
    return recording


def _hold_others(urdf, recording, held, folder):
    """Fix the joints without columns; return the description and all held joints."""
    from sklearn_vbjfa.model import movable_joints, write_reduced

    moving = recording.joint_names
    if set(moving) == set(movable_joints(urdf)):
        return urdf, held
    reduced = folder / f"held-{urdf.name}"
    more = write_reduced(urdf, reduced, moving)
    reduced.chmod(urdf.stat().st_mode & 0o666)
    return reduced, (*held, *more)


def channel_doubts(findings):
    """Messages of the findings on channels that are doubts, a list of str."""
    return [
        one.message
        for one in findings
        if one.severity != "warning" or one.kind in _LEFT_OUT
    ]


def expanded(text):
    """Return a path in which ~ is the home folder, as shells have it."""
    from sklearn_vbjfa.recording import expanded

    return expanded(text)


def sources(given):
    """Return the paths of one or several files, a tuple."""
    return tuple(map(expanded, [given] if isinstance(given, str) else given))


def named(paths):
    """Name what was read, for messages: one file, or the first of several."""
    more = len(paths) - 1
    return f"{paths[0]}{f' and {more} more' if more else ''}"


def no_formula(cell):
    """Return a cell of a table that a spreadsheet does not take for a formula."""
    # One that begins like a formula gets an apostrophe in front, unless it is a number.
    text = str(cell)
    is_formula = text.startswith(_FORMULA) and math.isnan(number(text))
    return f"'{text}" if is_formula else text


def free(wanted):
    """Return a path, with a number after its stem if there is something already."""
    # Of a folder a point in the name begins no ending.
    stem, suffix = wanted.stem, wanted.suffix
    if wanted.is_dir():
        stem, suffix = wanted.name, ""
    more = (wanted.with_name(f"{stem}-{k}{suffix}") for k in itertools.count(2))
    return next(x for x in itertools.chain([wanted], more) if not x.exists())


def check_folder(out, needs="must name a folder", ending="-report"):
    """Refuse, before the work begins, a folder that cannot be written to."""
    # ending: of the name of another one.
    for folder in (out, *out.parents):
        if folder.exists():
            if not folder.is_dir():
                other = free(folder.with_name(f"{folder.stem}{ending}"))
                raise Refused(
                    f"{folder} is a file, where --out {needs}",
                    {"out": str(other)},
                )
            _check_room(folder)
            return


def _check_room(folder, option="--out"):
    """Refuse, before the work begins, a folder that takes no files."""
    # Rights, a read-only or special file system: trying knows.
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        none = error.errno == errno.ENOENT
        reason = "it takes no files" if none else error.strerror
        raise ValueError(
            f"{folder} cannot be written to ({reason}); give another {option}."
        ) from error


def names(option, text, known):
    """Return the known names in a comma-separated list; "none" gives none."""
    found = tuple(name.strip() for name in text.split(",") if name.strip())
    if found == ("none",):
        return ()
    unknown = [name for name in found if name not in known]
    if unknown or not found:
        raise ValueError(
            f"{option} does not know {unknown[0] if unknown else text!r}; expected "
            f"names with commas between them, of {', '.join(known)}."
        )
    _refuse_twice(option, found)
    return found


def _refuse_twice(option, found):
    twice = [name for k, name in enumerate(found) if name in found[:k]]
    if twice:
        raise ValueError(f"{option} has {twice[0]} twice; name it once.")


def gains(text):
    """Return factors of the channels of torque, "unknown", or None."""
    if text in (None, "unknown"):
        return text
    found = tuple(numbers(text))
    if not all(math.isfinite(x) and x != 0 for x in found):
        raise ValueError(
            "--gain must be a factor to N m or N for each joint, such as 8,8,5, or "
            f"unknown, for all channels together; got {text!r}. Where one factor is "
            "unknown all are, as only their ratios are identified."
        )
    return found


def known_masses(texts, gains):
    """Return masses [kg] by name from arguments NAME=KG; None for none."""
    if texts and gains != "unknown":
        raise ValueError(
            "--known-mass fixes the common factor of channels with unknown gains: "
            "give --gain unknown as well."
        )
    found = {}
    for text in texts:
        name, equals, kilograms = text.rpartition("=")
        mass = number(kilograms)
        if not (equals and name and 0 < mass < math.inf):
            raise ValueError(
                "--known-mass must be LINK=KG or payload=KG with a positive mass in "
                f"kg; got {text!r}."
            )
        if name in found:
            raise ValueError(f"--known-mass has {name} twice; name it once.")
        found[name] = mass
    return found or None


def _check_gains(gains, masses, urdf):
    """Refuse unknown gains of a robot that cannot show them, and unknown links."""
    from sklearn_vbjfa.model import body_names, load_model

    if gains != "unknown":
        return
    model = load_model(urdf)
    if model.nv == 1:
        raise ValueError(
            "--gain unknown needs several joints that move the same bodies: the gain "
            f"of the only one in {urdf} is in every parameter."
        )
    known = (*body_names(model), "payload")
    for name in masses or {}:
        if name not in known:
            raise ValueError(
                f"--known-mass does not know {name!r}; expected one of "
                f"{', '.join(known)}."
            )


def cutoff(text):
    """Return the cut-off frequency [Hz], "auto", or None for no low-pass."""
    if text in ("auto", "none"):
        return None if text == "none" else text
    frequency = number(text)
    if not 0 < frequency < math.inf:
        raise ValueError(
            f"--cutoff must be a positive frequency in Hz, auto or none; got {text}."
        )
    return frequency


def _check_nyquist(frequency, recording, source):
    """Refuse a cut-off at or above the Nyquist frequency."""
    highest = 0.5 / recording.dt
    if isinstance(frequency, float) and frequency >= highest:
        raise ValueError(
            f"--cutoff must be below {highest:.4g} Hz, half the sample rate of "
            f"{source}; got {frequency:g}."
        )


def seed(number):
    """Return a seed that NumPy accepts."""
    if not 0 <= number < 2**32:
        raise ValueError(f"--seed must be from 0 to 2**32 - 1; got {number}.")
    return number


def default_folder(paths, what="report"):
    """Folder for the files of a run if none is named."""
    # It is called after the recording, or after the folder that holds several.
    from sklearn_vbjfa.recording import common_folder

    folder = common_folder(paths) if len(paths) > 1 else ""
    if folder:
        return Path(f"{folder}-{what}")
    source = paths[0].resolve() if paths[0].is_dir() else paths[0]
    name = source.stem if source.name != "-" else "stdin"
    if source.suffix in (".gz", ".bz2", ".xz"):
        name = Path(name).stem
    return Path(f"{name or 'recording'}-{what}")
