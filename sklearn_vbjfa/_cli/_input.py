"""Recordings, robots and output folders of the command line, loaded or refused."""

import contextlib
import itertools
import shlex
import tempfile
from pathlib import Path

from sklearn_vbjfa import datasets
from sklearn_vbjfa._cli._parser import Refused, command_line, parse
from sklearn_vbjfa.fit import FitOptions
from sklearn_vbjfa.inspection import inspect_as
from sklearn_vbjfa.model import load_model, load_reduced, movable_joints, write_reduced
from sklearn_vbjfa.model._loading import load_folded
from sklearn_vbjfa.physical import ProjectionError
from sklearn_vbjfa.recording import common_folder, expand

# How a cell begins that a spreadsheet computes.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


# -- recordings ------------------------------------------------------------------------


def load(arguments, folder, *, assumed=None):
    """Return a recording, its robot, and joints that are held without columns."""
    # folder: for derived descriptions; assumed: gains of the torque channels if none
    # are given.
    urdf, held = robot(arguments, arguments.joints, folder)
    gains = arguments.gain or (assumed if arguments.drive is None else None)
    recording = read(arguments, urdf, arguments.joints, gains)
    if set(recording.joint_names) != set(movable_joints(urdf)):
        # Joints without columns.
        urdf, more = _reduced(urdf, recording.joint_names, folder)
        held = (*held, *more)
    return recording, urdf, held


def findings(arguments, recording, urdf, gains):
    """Return the faults of the channels; unknown factors are none."""
    drive = arguments.drive
    if drive is not None:
        gains = drive.gains
    elif gains != "unknown":
        gains = "unknown" if motor_units(recording) else None
    return inspect_as(recording, str(urdf), drive=drive, gains=gains)


def other_joints(urdf, held):
    """Return lines on joints that are held, and on those that follow others."""
    wrong = "what stands elsewhere makes zeros, masses and effects of others wrong"
    lines = [f"held at zero: {', '.join(held)} ({wrong})"] if held else []
    follow = [body.name for body in load_folded(urdf).followers]
    if follow:
        lines.append(f"follow other joints, without columns: {', '.join(follow)}")
    return lines


def settings(arguments):
    given = arguments.known_mass or ()
    if given and arguments.gain != "unknown":
        raise ValueError(
            "--known-mass fixes the common factor of channels with unknown gains: "
            "give --gain unknown as well."
        )
    if len(dict(given)) < len(given):
        raise ValueError("--known-mass names a link twice; name it once.")
    return {
        "friction": arguments.friction,
        "bodies": arguments.bodies,
        "drive": arguments.drive,
        # The recording is read with factors that are known.
        "gains": "unknown" if arguments.gain == "unknown" else None,
        "options": FitOptions(known_masses=dict(given) or None),
    }


def paths(arguments):
    return tuple(map(expand, arguments.recording))


def named(arguments):
    """Return a name of what is read, for messages: the file, or the first of them."""
    first, *others = paths(arguments)
    return f"{first} and {len(others)} more" if others else str(first)


def motor_units(recording):
    """Return the units of torque channels that are not N m or N, such as A."""
    return [unit for unit in recording.torque_units if unit not in ("N m", "N")]


@contextlib.contextmanager
def blaming(arguments, *given):
    """Name what was read in a refusal: the options are valid, so it is at fault."""
    # given: further arguments of `read`, with which it was read.
    try:
        yield
    except (ValueError, ProjectionError) as error:
        options = dict(getattr(error, "options", {}))
        signs, gains = options.get("gains"), arguments.gain
        if isinstance(signs, tuple) and gains is not None:
            options["gains"] = tuple(a * b for a, b in zip(signs, gains))
        if options:
            other = parse(shlex.split(command_line(arguments, options))[3:])
            try:
                read(other, *given)
            except ValueError:
                # They contradict the log.
                options = {}
        reason = f"{named(arguments)}: {getattr(error, 'reason', error)}"
        raise Refused(reason, **options) from error


def read(arguments, urdf, joints, gains):
    files = paths(arguments)
    recording = datasets.read_recording(
        files[0] if len(files) == 1 else files,
        dt=arguments.dt,
        urdf=str(urdf),
        joint_names=joints or None,
        columns=arguments.columns,
        preset=arguments.preset,
        topic=arguments.topic,
        gains=gains,
        time_unit=arguments.time_unit,
        drive=arguments.drive,
        join=arguments.join,
    )
    units = motor_units(recording)
    if units and gains is None and arguments.drive is None:
        several = recording.nv > 1
        raise Refused(
            f"{named(arguments)}: the torques are recorded in {units[0]}; give the "
            "factors to N m, torque constant times gear ratio, one for each of "
            f"{', '.join(recording.joint_names)}"
            f"{', or have them identified' if several else ''} (--gain)",
            **({"gains": "unknown"} if several else {}),
        )
    return recording


# -- robots ----------------------------------------------------------------------------


def robot(arguments, joints, folder):
    """Check a description; return one in which other joints are fixed, and these."""
    if arguments.urdf is None:
        raise ValueError("give --urdf FILE, the robot description (URDF or MJCF).")
    urdf = expand(arguments.urdf)
    if not urdf.is_file():
        raise FileNotFoundError(f"{urdf}: no such robot description; give --urdf FILE.")
    base = arguments.base_orientation
    try:
        if joints:
            load_reduced(urdf, joints, base)
        else:
            load_model(urdf, base)
    except ValueError as error:
        where = "" if repr(str(urdf)) in str(error) else f"{urdf}: "
        raise ValueError(f"{where}{error}") from error
    if not joints and base is None:
        return urdf, ()
    return _reduced(urdf, joints or movable_joints(urdf), folder, base)


def _reduced(urdf, moving, folder, base=None):
    # With a part of its name for each time.
    reduced = folder / (f"held-{urdf.name}" if urdf.parent == folder else urdf.name)
    return reduced, tuple(write_reduced(urdf, reduced, moving, base))


# -- output ----------------------------------------------------------------------------


def output_folder(arguments, what):
    """Return the folder for files, refused before the work if it cannot take them."""
    # what: end of its name if none is given.
    out = expand(arguments.out) if arguments.out else _default_folder(arguments, what)
    check_folder(out)
    # Hidden files are those of folders and editors.
    held = sorted(x.name for x in out.iterdir()) if out.is_dir() else []
    held = [name for name in held if not name.startswith(".")]
    if not held or arguments.force:
        return out
    others = (out.with_name(f"{out.name}-{k}") for k in itertools.count(2))
    other = next(x for x in others if not x.exists())
    if arguments.out is None:
        return other
    raise Refused(
        f"{out} holds {', '.join(held[:3])}{' and more' if held[3:] else ''}; give "
        "another --out, or --force to write to it",
        out=str(other),
    )


def _default_folder(arguments, what):
    files = paths(arguments)
    source, folder = files[0], common_folder(files) if len(files) > 1 else ""
    if folder:
        return Path(f"{folder}-{what}")
    source = source.resolve() if source.is_dir() else source
    name = "stdin" if source.name == "-" else source.stem
    if source.suffix in (".gz", ".bz2", ".xz"):
        name = Path(name).stem
    return Path(f"{name or 'recording'}-{what}")


def check_folder(out):
    there = next(x for x in (out, *out.parents) if x.exists() or x.is_symlink())
    if not there.is_dir():
        raise ValueError(f"{there} is not a folder; give another --out.")
    try:
        # Rights, a read-only or special file system: trying knows.
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise ValueError(
            f"{there} cannot be written to ({error.strerror}); give another folder."
        ) from error


def check_file(out, option, force):
    """Refuse a file that cannot be written, or that there is already."""
    if out.is_dir() or (out.exists() and not force):
        raise ValueError(
            f"{out} exists; give another file for {option}, or --force to replace a "
            "file."
        )
    check_folder(out.parent)


def no_formula(cell):
    """Return a cell of a table that a spreadsheet does not take for a formula."""
    # One that begins like a formula gets an apostrophe in front.
    text = str(cell)
    return f"'{text}" if text.startswith(_FORMULA) else text
