"""Recordings, robots and output folders of the command line."""

import contextlib
import itertools
import shlex
import tempfile
import warnings
from pathlib import Path

from sklearn_vbjfa import datasets
from sklearn_vbjfa._cli._parser import Refused, command_line, parse
from sklearn_vbjfa.fit import FitOptions
from sklearn_vbjfa.inspection import inspect_as
from sklearn_vbjfa.model import load_model, load_reduced, movable_joints, write_reduced
from sklearn_vbjfa.model._loading import load_folded
from sklearn_vbjfa.physical import ProjectionError
from sklearn_vbjfa.recording import common_folder, expand

# First characters of cells that a spreadsheet evaluates as formulas.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def load(arguments, folder, *, assumed=None):
    """Return a recording, its robot description, and the joints locked at zero."""
    # folder: for derived descriptions; assumed: gains of the torque channels by
    # default.
    urdf, locked = robot(arguments, arguments.joints, folder)
    gains = arguments.gain or (assumed if arguments.drive is None else None)
    recording = read(arguments, urdf, arguments.joints, gains)
    if set(recording.joint_names) != set(movable_joints(urdf)):
        # Joints without columns are locked.
        urdf, more = _reduced(urdf, recording.joint_names, folder)
        locked = (*locked, *more)
    return recording, urdf, locked


def findings(arguments, recording, urdf, gains):
    """Return the faults of the channels; unknown gains are not a fault."""
    drive = arguments.drive
    if drive is not None:
        gains = drive.gains
    elif gains != "unknown":
        gains = "unknown" if motor_units(recording) else None
    return inspect_as(recording, str(urdf), drive=drive, gains=gains)


def other_joints(urdf, locked):
    """Return lines on joints that are locked, and on joints that follow others."""
    effect = "other positions bias the zeros, masses and effects of other joints"
    lines = [f"held at zero: {', '.join(locked)} ({effect})"] if locked else []
    mimics = [body.name for body in load_folded(urdf).followers]
    if mimics:
        lines.append(f"follow other joints, without columns: {', '.join(mimics)}")
    return lines


def settings(arguments):
    masses = arguments.known_mass or ()
    if masses and arguments.gain != "unknown":
        raise ValueError(
            "--known-mass fixes the common factor of channels with unknown gains: "
            "give --gain unknown as well."
        )
    if len(dict(masses)) < len(masses):
        raise ValueError("--known-mass names a link twice; name it once.")
    return {
        "friction": arguments.friction,
        "bodies": arguments.bodies,
        "drive": arguments.drive,
        # Known gains were already applied when the recording was read.
        "gains": "unknown" if arguments.gain == "unknown" else None,
        "options": FitOptions(known_masses=dict(masses) or None),
    }


def paths(arguments):
    return tuple(map(expand, arguments.recording))


def log_name(arguments):
    """Return the name of the input for messages: the first file and their number."""
    first, *others = paths(arguments)
    return f"{first} and {len(others)} more" if others else str(first)


def motor_units(recording):
    """Return the units of torque channels that are not N m or N, such as A."""
    return [unit for unit in recording.torque_units if unit not in ("N m", "N")]


@contextlib.contextmanager
def naming_input(arguments):
    """Name the recording in errors: options are valid, so that it is at fault."""
    try:
        yield
    except (ValueError, ProjectionError) as error:
        options = dict(getattr(error, "options", {}))
        signs, gains = options.get("gains"), arguments.gain
        if isinstance(signs, tuple) and gains is not None:
            options["gains"] = tuple(a * b for a, b in zip(signs, gains))
        reason = f"{log_name(arguments)}: {getattr(error, 'reason', error)}"
        raise Refused(reason, **options) from error


def checked(arguments, options):
    """Return options that read a log, with those of later errors, or {}."""
    # Standard input cannot be read again, `out` does not concern reading, `simulate`
    # reads with the options of a report.
    urdf = getattr(arguments, "urdf", None)
    fixed = {"-", "out"} & {*arguments.recording, *options}
    while options and urdf and not fixed:
        other = parse(shlex.split(command_line(arguments, options))[3:])
        assumed = "unknown" if other.command == "inspect" else None
        try:
            with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
                warnings.simplefilter("ignore")
                load(other, Path(folder), assumed=assumed)
            break
        except ValueError as error:
            more = getattr(error, "options", {})
            options = {} if more.keys() <= options.keys() else options | more
    return options


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
            f"{log_name(arguments)}: the torques are recorded in {units[0]}; give the "
            "factors to N m, torque constant times gear ratio, one for each of "
            f"{', '.join(recording.joint_names)}"
            f"{', or have them identified' if several else ''} (--gain)",
            **({"gains": "unknown"} if several else {}),
        )
    return recording


def robot(arguments, joints, folder):
    """Check a description; return one with other joints fixed, and their names."""
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
    # Each repeated reduction gets another file name.
    reduced = folder / (f"held-{urdf.name}" if urdf.parent == folder else urdf.name)
    return reduced, tuple(write_reduced(urdf, reduced, moving, base))


def output_folder(arguments, what):
    """Return the output folder, or refuse it before the computation starts."""
    # what: suffix of the default name.
    out = expand(arguments.out) if arguments.out else _default_folder(arguments, what)
    check_folder(out)
    # Hidden files, of file managers and editors, are ignored.
    files = sorted(x.name for x in out.iterdir()) if out.is_dir() else []
    files = [name for name in files if not name.startswith(".")]
    if not files or arguments.force:
        return out
    others = (out.with_name(f"{out.name}-{k}") for k in itertools.count(2))
    other = next(x for x in others if not x.exists())
    if arguments.out is None:
        return other
    raise Refused(
        f"{out} holds {', '.join(files[:3])}{' and more' if files[3:] else ''}; give "
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
    folder = next(x for x in (out, *out.parents) if x.exists() or x.is_symlink())
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder; give another --out.")
    try:
        # Only an attempt detects missing permissions and read-only file systems.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(
            f"{folder} cannot be written to ({error.strerror}); give another folder."
        ) from error


def check_file(out, option, force):
    if out.is_dir() or (out.exists() and not force):
        raise ValueError(
            f"{out} exists; give another file for {option}, or --force to replace a "
            "file."
        )
    check_folder(out.parent)


def escape_formula(cell):
    """Return a table cell that a spreadsheet does not evaluate as a formula."""
    # Cells that begin like a formula are prefixed by an apostrophe.
    text = str(cell)
    return f"'{text}" if text.startswith(_FORMULA) else text
