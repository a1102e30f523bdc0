"""The command ``design``: the motion to record next, as a file and a page."""

import contextlib
import csv
import io
import json
import math
import os
import shlex
import sys
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sklearn_vbjfa._cli import _exit_codes, _input, _options
from sklearn_vbjfa._cli._identify import say_warnings
from sklearn_vbjfa._cli._stopping import undisturbed

# Without an option, and without a report that says how it was recorded.
_DURATION, _DT = 20.0, 0.01
# Columns of a file of limits beside the joint.
_LIMITS = ("lower", "upper", "velocity", "acceleration", "torque")
# Descriptions whose joints lie farther apart [m, or cosines] are of different robots.
_APART = 1e-4


def add_to(commands):
    """Add the command to a parser."""
    parser = commands.add_parser(
        "design",
        help="design the motion to record next",
        description="Design a periodic motion within the limits of the robot that "
        "determines its model best; with the folder of a report, the one that decides "
        "what the report left open. Writes the motion as CSV (t, then q_, v_ and a_ of "
        "each joint, in SI units) and a page beside it. Takes a minute or two.",
    )
    parser.add_argument(
        "--urdf",
        default=None,
        metavar="FILE",
        help="description of the robot; with --report, by default that of the report",
    )
    _options.add_base(parser)
    parser.add_argument(
        "--report",
        default=None,
        metavar="FOLDER",
        help="folder that close-loop wrote: what its report.json left open is what the "
        "motion decides, and its identified.json has the robot and the measured noise",
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=_DURATION,
        metavar="S",
        help=f"length of the motion [s], by default {_DURATION:g}",
    )
    parser.add_argument(
        "--out",
        default="motion.csv",
        metavar="FILE",
        help="file for the motion, by default motion.csv; the page goes beside it with "
        "the ending .html",
    )
    parser.add_argument("--force", action="store_true", help="replace files that exist")
    parser.add_argument(
        "--dt",
        type=float,
        default=None,
        metavar="S",
        help=f"sample period [s], by default that of the report, or {_DT:g}",
    )
    parser.add_argument(
        "--joints",
        default=None,
        metavar="NAMES",
        help="joints that move, separated by commas; others (gripper, wheels) are held "
        "at zero; by default all",
    )
    parser.add_argument(
        "--start",
        default=None,
        metavar="POSITIONS",
        help="positions at which the motion begins and ends [rad or m], one for each "
        "joint with commas between them; by default the best",
    )
    parser.add_argument(
        "--limits",
        default=None,
        metavar="FILE",
        help="limits in place of those of the description: CSV or JSON with joint and "
        "any of lower, upper, velocity, acceleration, torque, in SI units",
    )
    for name, unit in (
        ("velocity", "rad/s or m/s"),
        ("acceleration", "rad/s^2 or m/s^2"),
        ("torque", "N m or N"),
    ):
        parser.add_argument(
            f"--{name}",
            default=None,
            metavar="LIMITS",
            help=f"limits of {name} [{unit}], one for each joint with commas between "
            "them, or one for all",
        )
    parser.add_argument(
        "--scale",
        type=float,
        default=1.0,
        metavar="SHARE",
        help="share of the limits of velocity and acceleration that may be used, such "
        "as 0.5 for a first run; by default 1",
    )
    parser.add_argument(
        "--effects",
        default=None,
        metavar="NAMES",
        help="effects that the motion shall show and tell apart on every joint; see "
        "the command effects",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="draws the motions of which the best is improved",
    )
    parser.set_defaults(run=run)


class LimitsRefused(ValueError):
    """Limits in a file that do not do, with the content, a line, of one that would."""

    def __init__(self, reason, content):
        super().__init__(reason)
        self.content = content


@dataclass(frozen=True, kw_only=True, eq=False)
class _Robot:
    """The robot that is to move."""

    known: object
    model: object  # its description, joints in its own order
    name: str
    file: str  # description that was given, or that a report tells
    held: tuple = ()  # joints that are held
    dt: float | None = None  # sample period of its recordings so far [s]
    # whether its torques are in units of a channel, not in N m or N
    is_relative: bool = False


def run(arguments):
    """Design a motion, print what it decides and write the files."""
    from sklearn_vbjfa import design, effects

    _check(arguments)
    out = _input.path(arguments.out)
    _check_out(out, arguments.force)
    seed = _input.seed(arguments.seed)
    asked = ()
    if arguments.effects is not None:
        asked = _input.names("--effects", arguments.effects, effects.available())
    report = None if arguments.report is None else _input.path(arguments.report)
    found = None if report is None else design.read_report(report)
    with (
        tempfile.TemporaryDirectory() as folder,
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        robot = _robot(arguments, report, found, Path(folder))
        names = robot.known.joint_names
        limits, file_of_limits = _limits(arguments, robot)
        start = _numbers("--start", arguments.start, names, positive=False)
        dt = arguments.dt or _period(robot, found)
        with _progress(f"designing {arguments.duration:g} s for {len(names)} joints"):
            motion = design.design_motion(
                robot.known,
                duration=arguments.duration,
                dt=dt,
                limits=limits,
                effects=asked,
                report=found,
                start=start,
                random_state=seed,
            )
        if not motion.within_limits:
            raise ValueError(
                f"no motion within the limits was found: {design.exceeded(motion)}; "
                "give another --start, a longer --duration or another --seed."
            )
        noise = np.array(robot.known.torque_noise)
        background = design.Background(
            robot=robot.name,
            description=robot.file,
            report="" if report is None else str(report),
            found=found,
            measured=np.isfinite(noise) & (noise > 0),
            seed=seed,
            settings=_settings(arguments, file_of_limits, limits),
            held=robot.held,
            file=out.name,
            commands=_next(arguments, robot, found),
        )
        text = design.summary(motion, background)
        arguments.doubts = [
            *design.undecided(motion),
            *design.unseen(motion, asked),
            *_exit_codes.of_warnings(caught),
        ]
        try:
            with undisturbed():
                written = _write(motion, design.page(motion, background), out)
                arguments.written = True
        except OSError:
            print("\n".join(text))
            raise
    print("\n".join(text))
    print("\nNext:")
    for step in background.commands:
        print(f"  {_input.wrapped(step, sys.stdout)}")
    print(f"written: {', '.join(map(str, written))}")
    say_warnings(caught)


@contextlib.contextmanager
def _progress(text):
    """Show on a terminal what takes its time."""
    shows = sys.stderr is not None and sys.stderr.isatty()
    if shows:
        print(f"{text} ...", end="", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        if shows:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


# -- what is given ---------------------------------------------------------------------


def _check(arguments):
    """Refuse numbers that are none, and a run without a robot."""
    if arguments.urdf is None and arguments.report is None:
        raise ValueError(
            "give --urdf FILE, the description of the robot, or --report FOLDER, what "
            "close-loop wrote of it."
        )
    if not 0 < arguments.duration < math.inf:
        raise _input.Refused(
            "--duration must be a positive number of seconds; got "
            f"{arguments.duration:g}",
            {"duration": f"{_DURATION:g}"},
        )
    if arguments.dt is not None and not 0 < arguments.dt < math.inf:
        raise _input.Refused(
            f"--dt must be a positive number of seconds; got {arguments.dt:g}",
            {"dt": f"{_DT:g}"},
        )
    if not 0 < arguments.scale <= 1:
        raise _input.Refused(
            "--scale must be a share of the limits, above 0 and at most 1; got "
            f"{arguments.scale:g}",
            {"scale": "0.5"},
        )


def _check_out(out, force):
    """Refuse, before the work begins, a file that cannot be or that there is."""
    if out.is_dir():
        raise _input.Refused(
            f"{out} is a folder, where --out must name a file",
            {"out": str(_input.free(out / "motion.csv"))},
        )
    page = _page_of(out)
    if page == out:
        raise _input.Refused(
            f"{out} is where the page goes; --out names the file of the motion",
            {"out": str(_input.free(out.with_suffix(".csv")))},
        )
    for folder in out.parents:
        if folder.exists():
            if not folder.is_dir():
                other = folder.with_name(f"{folder.stem}-motion{out.suffix}")
                raise _input.Refused(
                    f"{folder} is a file, where --out needs a folder",
                    {"out": str(_input.free(other))},
                )
            if not os.access(folder, os.W_OK):
                raise ValueError(f"{folder} cannot be written to; give another --out.")
            break
    there = [str(path) for path in (out, page) if path.exists()]
    if there and not force:
        both = len(there) > 1
        raise _input.Refused(
            f"{' and '.join(there)} exist{'' if both else 's'}; give another --out, or "
            f"--force to replace {'them' if both else 'it'}",
            {"out": str(_input.free(out, page.suffix))},
        )


def _page_of(out):
    """Return where the page goes."""
    return out.with_suffix(".html")


def _numbers(option, text, names, *, positive=True):
    """Return a number for each joint (nv,), None for None; one stands for all."""
    if text is None:
        return None
    try:
        found = np.array([float(x) for x in text.split(",")])
    except ValueError:
        found = np.full(1, np.nan)
    n = len(names)
    if positive and found.size == 1:
        found = np.full(n, found[0])
    kind = "positive numbers" if positive else "positions"
    every = f"one for each of {', '.join(names)}, with commas between them"
    if found.size != n and np.isfinite(found).all():
        raise ValueError(
            f"{option} has {found.size} numbers, and {n} joints move; expected {kind}, "
            f"{every}."
        )
    if not (np.isfinite(found).all() and (not positive or (found > 0).all())):
        example = ",".join(["1"] * n) if positive else ",".join(["0"] * n)
        raise ValueError(
            f"{option} must be {kind}, {every}, such as {example}; got {text!r}."
        )
    return found


# -- the robot -------------------------------------------------------------------------


def _robot(arguments, report, found, folder):
    """Take the identified robot of a report, or the one that is described."""
    identified = None
    if report is not None:
        identified = (report if report.is_dir() else report.parent) / "identified.json"
    if identified is not None and identified.is_file():
        return _identified(arguments, identified, found, folder)
    if arguments.urdf is None:
        raise ValueError(
            f"{identified} does not exist, which holds the robot of the report; give "
            "its description by --urdf FILE."
        )
    return _described(arguments, found, folder)


def _described(arguments, found, folder):
    """Take a robot of which only the description is known."""
    from sklearn_vbjfa.design import KnownRobot

    given, joints = _input.path(arguments.urdf), _input.joint_names(arguments.joints)
    if not joints and found is not None:
        # Those that close-loop held have no place in its report.
        joints = tuple(found["joint_names"])
    urdf, held = _input.robot(given, joints, folder, arguments.base_orientation)
    known = replace(KnownRobot.of(str(urdf)), description=str(given))
    return _Robot(
        known=known,
        model=known.features.model_,
        name=given.name,
        file=str(given),
        held=tuple(held),
    )


def _identified(arguments, path, found, folder):
    """Take a robot from the file that close-loop wrote."""
    from sklearn_vbjfa import load_identified
    from sklearn_vbjfa.design import KnownRobot

    _options.refuse_given(
        arguments, ("base_orientation",), f"is that of {path}; leave it out"
    )
    robot = load_identified(path)
    names, model = robot.joint_names_, robot.features_.nominal_
    joints = _input.joint_names(arguments.joints)
    if joints and set(joints) != set(names):
        raise ValueError(
            f"--joints must name the joints of {path} ({', '.join(names)}); got "
            f"{', '.join(joints)}. Leave it out, or run close-loop with these joints."
        )
    told = (found.get("provenance") or {}) if found else {}
    file, held = told.get("description") or str(path), tuple(told.get("held") or ())
    description = folder / "described.urdf"
    description.write_text(robot.description_, encoding="utf-8")
    if arguments.urdf is not None:
        description = _input.path(arguments.urdf)
        file = str(description)
        model = _agreeing(description, model, path)
    elif file != str(path) and Path(file).is_file():
        # Meshes lie beside the file itself.
        description = Path(file)
    gains = robot.gains_
    is_relative = gains is not None and not gains.absolute
    if is_relative:
        model = _without_torque_limits(model)
    return _Robot(
        known=replace(KnownRobot.of(robot), description=str(description)),
        model=model,
        name=Path(file).name,
        file=file,
        held=held,
        dt=robot.dt,
        is_relative=is_relative,
    )


def _without_torque_limits(model):
    """Return a copy of a model with no limits of torque."""
    model = model.copy()
    model.effortLimit = np.full(model.nv, np.inf)
    return model


def _agreeing(urdf, model, path):
    """Return the model of a description, refused if it is of another robot."""
    from sklearn_vbjfa.model import joint_names, load_reduced, movable_joints

    names = joint_names(model)
    if not urdf.is_file():
        raise FileNotFoundError(f"{urdf}: no such robot description; give --urdf FILE.")
    movable = movable_joints(urdf)
    missing = [name for name in names if name not in movable]
    if missing:
        raise ValueError(
            f"{urdf} has no joint {missing[0]}, which {path} was identified with; it "
            f"has {', '.join(movable)}. Leave --urdf out, or give the description that "
            "close-loop was run with."
        )
    own = load_reduced(urdf, names)
    order = joint_names(own)
    for j, name in enumerate(names, 1):
        k = order.index(name) + 1
        # What holds a joint may come from elsewhere where others are held.
        ours, theirs = own.jointPlacements[k], model.jointPlacements[j]
        apart = np.abs(ours.homogeneous - theirs.homogeneous).max()
        turned = own.joints[k].shortname() != model.joints[j].shortname()
        if turned or apart > _APART:
            what = "its axis" if turned else f"its place, by {apart:.3g}"
            raise ValueError(
                f"{urdf} is not the robot of {path}: {name} differs in {what}. Leave "
                "--urdf out, or give the description that close-loop was run with."
            )
    return own


def _period(robot, found):
    """Sample period of the recordings so far, or a usual one [s]."""
    rate = ((found or {}).get("recorded") or {}).get("rate")
    return robot.dt or (1.0 / rate if rate else _DT)


# -- limits ----------------------------------------------------------------------------


def _limits(arguments, robot):
    """Collect the limits, joints in the order of the robot; and what was read."""
    from sklearn_vbjfa.design import MotionLimits, MotionRefused
    from sklearn_vbjfa.model import joint_names

    names, described = robot.known.joint_names, joint_names(robot.model)
    given = {name: np.full(len(names), np.nan) for name in _LIMITS}
    source = ""
    if arguments.limits is not None:
        path = _input.path(arguments.limits)
        source = str(path)
        given = _read_limits(path, names, robot.model)
    for option in ("velocity", "acceleration", "torque"):
        numbers = _numbers(f"--{option}", getattr(arguments, option), names)
        given[option] = given[option] if numbers is None else numbers
    free = np.isnan(given["acceleration"]) & np.isnan(given["torque"])
    if robot.is_relative and free.any():
        raise _input.Refused(
            "the gains of the torque channels are relative, so that the description's "
            "limits of torque in N m or N do not hold; give --acceleration, or "
            "--torque in the units of the channels",
            {"acceleration": tuple(2 * np.array(robot.model.velocityLimit))},
        )
    # Limits of the description are in its own order.
    order = [names.index(name) for name in described]
    back = [described.index(name) for name in names]
    position = np.column_stack([given["lower"], given["upper"]])[order]
    more = {name: given[name][order] for name in _LIMITS[2:]}
    try:
        found = MotionLimits.of(robot.model, position=position, **more)
    except MotionRefused as refused:
        options = {
            name: tuple(np.array(values)[back].tolist())
            for name, values in refused.options.items()
        }
        (option,) = options
        raise _input.Refused(
            refused.reason.replace(
                "Give limits=MotionLimits(...) with torques above that, or "
                "accelerations",
                "Give those of the drives by --torque, or --acceleration",
            ).replace(
                "Give limits=MotionLimits(...) with velocities",
                "Give those of the robot by --velocity",
            ),
            options,
        ) from refused
    except ValueError as error:
        raise LimitsRefused(
            f"{f'{source}: ' if source else ''}{error}".removesuffix(".").replace(
                "limits=MotionLimits(...)", "--limits FILE"
            ),
            _template(names, robot.model, given),
        ) from error
    return (
        MotionLimits(
            found.position[back],
            arguments.scale * found.velocity[back],
            arguments.scale * found.acceleration[back],
            found.torque[back],
        ),
        source,
    )


def _read_limits(path, names, model):
    """Read limits of joints from CSV or JSON, dict of str to ndarray (nv,)."""
    # What is not given is nan.
    content = _template(names, model)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise LimitsRefused(f"{path} is not a text file: {error}", content) from None
    except FileNotFoundError:
        raise LimitsRefused(f"{path}: no such file of limits", content) from None
    rows = _rows(path, text, content)
    found = {name: np.full(len(names), np.nan) for name in _LIMITS}
    seen = set()
    for row in rows:
        joint = str(row.pop("joint", "")).strip()
        if joint not in names:
            raise LimitsRefused(
                f"{path} has limits of {joint!r}; the joints that move are "
                f"{', '.join(names)}",
                content,
            )
        if joint in seen:
            raise LimitsRefused(f"{path} has limits of {joint} twice", content)
        seen.add(joint)
        for key, cell in row.items():
            if key not in found:
                raise LimitsRefused(
                    f"{path} has {key!r}; expected joint and any of "
                    f"{', '.join(_LIMITS)}",
                    content,
                )
            if cell is None or not str(cell).strip():
                continue
            try:
                value = float(cell)
            except (TypeError, ValueError):
                value = math.nan
            sign_is_free = key in ("lower", "upper")
            if math.isnan(value) or not (sign_is_free or value > 0):
                kind = "a number" if sign_is_free else "a positive number"
                raise LimitsRefused(
                    f"{path} has {key} {cell!r} of {joint}; expected {kind}", content
                )
            found[key][names.index(joint)] = value
    return found


def _rows(path, text, content):
    """Rows of a file of limits, dicts with the key joint."""
    if text.lstrip()[:1] in ("{", "["):
        try:
            found = json.loads(text)
        except json.JSONDecodeError as error:
            raise LimitsRefused(
                f"{path} is not readable as JSON: {error}", content
            ) from error
        if isinstance(found, dict):
            found = [
                {"joint": name, **row} if isinstance(row, dict) else row
                for name, row in found.items()
            ]
        if not all(isinstance(row, dict) for row in found):
            raise LimitsRefused(f"{path} must hold limits by joints", content)
        return found
    table = list(csv.reader(io.StringIO(text)))
    table = [[cell.strip() for cell in row] for row in table if any(row)]
    heads = table[0] if table else []
    if "joint" not in heads:
        raise LimitsRefused(
            f"{path} has no column joint; expected joint,{','.join(_LIMITS)}", content
        )
    for k, row in enumerate(table[1:], 2):
        if len(row) != len(heads):
            raise LimitsRefused(
                f"{path} has {len(row)} cells in row {k} and {len(heads)} columns",
                content,
            )
    return [dict(zip(heads, row)) for row in table[1:]]


def _template(names, model, given=None):
    """Return the content of a file of limits that would do, JSON in one line."""
    # Limits that the description lacks are left as they were given, or guessed: half a
    # turn to each side, through half of the range in a second, and ten times that speed
    # in a second.
    from sklearn_vbjfa.model import joint_names

    described = joint_names(model)
    rows = {}
    for j, name in enumerate(names):
        k = described.index(name)
        low, high = model.lowerPositionLimit[k], model.upperPositionLimit[k]
        if not (np.isfinite([low, high]).all() and low < high and high - low < 1e3):
            low, high = -1.0, 1.0
        speed, torque = model.velocityLimit[k], model.effortLimit[k]
        if not 0 < speed < 1e9:
            speed = 0.5 * (high - low)
        row = {
            "lower": low,
            "upper": high,
            "velocity": speed,
            "acceleration": 2 * speed,
        }
        if 0 < torque < 1e9:
            row["torque"] = torque
        for key in row if given is not None else ():
            value = given[key][j]
            if np.isfinite(value) and key not in ("lower", "upper"):
                row[key] = value
        rows[name] = {key: float(f"{value:.4g}") for key, value in row.items()}
    return json.dumps(rows)


# -- what is told and written ----------------------------------------------------------


def _settings(arguments, file_of_limits, limits):
    """Return what was asked for, as rows of the provenance."""
    own = [
        f"--{name} {getattr(arguments, name)}"
        for name in ("velocity", "acceleration", "torque")
        if getattr(arguments, name) is not None
    ]
    source = ", ".join([file_of_limits or "of the description", *own])
    scale = f"{arguments.scale:.0%} of those of velocity and acceleration"
    if arguments.scale < 1 and np.isinf(limits.acceleration).any():
        scale += " (some joints have none of acceleration; their torque limits them)"
    rows = (
        ("Limits", source),
        ("Scale", "" if arguments.scale == 1 else scale),
        ("Effects asked for", arguments.effects or ""),
        ("Start", arguments.start or "chosen"),
    )
    return tuple(rows)


def _next(arguments, robot, found):
    """Say what to do with the motion: sentences, and a command to type."""
    told = ((found or {}).get("provenance") or {}).get("file") or "before.csv"
    words = ["python", "-m", "sklearn_vbjfa", "close-loop"]
    if robot.file.endswith(".json"):
        urdf = "ROBOT.urdf"
    else:
        urdf = robot.file
    options = []
    if robot.held:
        options += ["--joints", ",".join(robot.known.joint_names)]
    if arguments.base_orientation is not None:
        options += ["--base-orientation", arguments.base_orientation]
    like = ""
    if found is not None:
        before = [told] if isinstance(told, str) else told
        # What came through a pipe is not there any more.
        before = ["before.csv" if file == "-" else file for file in before]
        words += before
        like = f", with the columns of {before[0]}, and give both to close-loop"
    step = f"Run {arguments.out} and record q and tau while it runs{like}."
    words += ["recording.csv"]
    return (step, shlex.join([*words, "--urdf", urdf, *options]))


def _write(motion, page, out):
    """Write both files or none; each appears complete. Returns their paths."""
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".writing-") as folder:
        table, text = Path(folder, "motion"), Path(folder, "page")
        motion.to_csv(table)
        text.write_text(page, encoding="utf-8")
        os.replace(text, _page_of(out))
        os.replace(table, out)
    return out, _page_of(out)
