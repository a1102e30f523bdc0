"""Commands and options, their values, and the command that would have worked."""

import argparse
import difflib
import math
import re
import shlex
from typing import NamedTuple

# Declared in the model of every joint unless --friction says otherwise.
FRICTION = ("viscous", "coulomb", "offset", "rotor_inertia")
# A designed motion [s].
DURATION, PERIOD = 20.0, 0.01

EXIT_CODES = (
    "exit codes: 0 the result can be used; 2 nothing was done, for the reason on "
    "stderr; 3 finished with a warning that forbids a use, named in the last line on "
    "stderr"
)


class Refused(ValueError):
    """Input that is refused.

    Parameters
    ----------
    reason : str
        What is wrong, and what to do.
    **options : str, float, tuple, True or None
        Options that would be accepted in place of those given, by their names; None
        for one to leave out.
    """

    def __init__(self, reason, **options):
        super().__init__(reason)
        self.options = options


# -- values of options -----------------------------------------------------------------


class _Typed(NamedTuple):
    """Value of an option that was typed."""

    text: str
    value: object


def _read_by(convert):
    """Return the argparse type of a conversion; keeps the text with the value."""

    def read(text):
        try:
            return _Typed(text, convert(text))
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error).rstrip(".")) from None

    return read


def number(text):
    """Return the number that a text is, nan for none."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan


def _positive(unit, *words):
    """Return the conversion to a positive number; some words are kept."""

    def convert(text):
        value = number(text)
        if text not in words and not 0 < value < math.inf:
            others = "".join(f" or {word}" for word in words)
            raise ValueError(f"must be a positive number of {unit}{others}; got {text}")
        return text if text in words else value

    return convert


def _numbers(text):
    """Return the numbers in a comma-separated list, a tuple of float."""
    values = tuple(map(number, text.split(",")))
    if any(map(math.isnan, values)):
        raise ValueError(f"must be numbers with commas between them; got {text!r}")
    return values


def _cutoff(text):
    value = _positive("Hz", "auto", "none")(text)
    return None if value == "none" else value


def _share(text):
    if not 0 < number(text) <= 1:
        raise ValueError(f"must be above 0 and at most 1; got {text}")
    return float(text)


def _count(text):
    if not (text.isdecimal() and int(text) > 0):
        raise ValueError(f"must be a positive integer; got {text}")
    return int(text)


def _one_of(*words):
    """Return the conversion that accepts some words."""

    def convert(text):
        if text not in words:
            raise ValueError(f"must be {' or '.join(words)}; got {text!r}")
        return text

    return convert


def _seed(text):
    if not (text.isdecimal() and int(text) < 2**32):
        raise ValueError(f"must be an integer from 0 to 2**32 - 1; got {text}")
    return int(text)


def _gains(text):
    """Return factors of the torque channels, or "unknown"."""
    if text == "unknown":
        return text
    values = tuple(map(number, text.split(",")))
    if not all(math.isfinite(x) and x != 0 for x in values):
        raise ValueError(
            "must be a factor to N m or N for each joint, such as 8,8,5, or unknown "
            f"for all channels together; got {text!r}"
        )
    return values


def _mass(text):
    name, _, kilograms = text.rpartition("=")
    if not (name and 0 < number(kilograms) < math.inf):
        raise ValueError(
            f"must be LINK=KG or payload=KG with a positive mass in kg; got {text!r}"
        )
    return name, float(kilograms)


def _drive(text):
    from sklearn_vbjfa.recording import parse_drive

    try:
        return parse_drive(text)
    except ValueError as error:
        raise ValueError(str(error).removeprefix("drive ")) from None


def _distinct(text):
    """Return the names in a comma-separated list, each once."""
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise ValueError(f"has an empty name in {text!r}")
    for k, name in enumerate(names):
        if name in names[:k]:
            raise ValueError(f"has {name} twice; name it once")
    return names


def _known(text, known):
    """Return the names in a comma-separated list, all of them known."""
    names = () if text == "none" else _distinct(text)
    for name in names:
        if name not in known:
            raise ValueError(
                f"does not know {name!r}{_suggestion(name, known)}; expected names "
                f"with commas between them, of {', '.join(known)}"
            )
    return names


def _effects(text):
    from sklearn_vbjfa import effects

    return text if text == "all" else _known(text, effects.available())


def _friction(text):
    from sklearn_vbjfa.effects import declarable

    return _known(text, declarable())


# -- options and commands --------------------------------------------------------------

# Options with a value, and their help.
_OPTIONS = {
    "--columns MAPPING": 'names of the columns, such as "q=actual_q_{i},tau='
    'actual_current_{i},t=timestamp"; {i} is the number of a joint from 0 or 1, '
    "{joint} its name; a unit may follow: q=pos_{i} [deg]",
    "--preset TOOL": "naming scheme of a tool: ros, ur, franka, lerobot or unitree "
    "(default: detected)",
    "--topic NAME": "topic of a bag (default: the only one of joint states)",
    "--dt S": "sample period [s] (default: from t; of a designed motion that of the "
    f"report, or {PERIOD:g})",
    "--time-unit UNIT": "unit of t: s, ms, us or ns (default: from its name, or s)",
    "--signals NAMES": "other columns that friction and offsets may vary with, such as "
    "temperature,voltage, or none (default: all that hold numbers)",
    "--gain FACTORS": "factors from the torque columns to N m or N, one for each "
    "joint, such as 8,8,5; or unknown for motor currents, whose factors are then "
    "identified relative to one of them",
    "--drive LAW": "motor control law, for logs without torques, such as "
    '"pd kp=20,20,40 kd=1,1,2" or "pd kp=hip:20,thigh:20,calf:40 kd=1": LOG then has '
    "columns q_desired of each joint in place of tau, and v_desired, tau_ff, kp and kd "
    "where they exist. Further values: delay=auto or seconds, saturation=, gear=, "
    "feedforward=true",
    "--urdf FILE": "robot description, URDF or MJCF",
    "--joints NAMES": "joints that are used, separated by commas, in the order of the "
    "columns q1..qn; others (gripper, wheels) are held at zero (default: all, in the "
    "order of the description)",
    "--base-orientation W,X,Y,Z": "orientation in the world of a base that is free in "
    "the description, a quaternion (default: that of the description)",
    "--model FILE": "identified robot, the identified.json of identify; nothing is "
    "identified then",
    "--report FOLDER": "folder that identify wrote: the motion decides what its report "
    "left open, for its identified robot and measured noise",
    "--friction NAMES": "terms that the model of each joint has from the start: none, "
    "or any of viscous,coulomb,offset,rotor_inertia (default: all four)",
    "--bodies PRIOR": "masses and inertias: prior (default): near the description "
    "unless the torques disagree; free: from the torques alone; fixed: as described",
    "--shared-drives GROUPS": "joints with equal drives: a part of their names for "
    'each group, such as "hip thigh calf", or their names with commas between; none; '
    "or auto (default): joints whose names differ in leg, side or number alone and "
    "whose bodies are equal or mirrored",
    "--known-mass LINK=KG": "with --gain unknown, a mass that fixes the common factor: "
    "of a link, or payload=KG of an object that is picked up; may be repeated",
    "--cutoff HZ": "cut-off frequency of the low-pass for torques and regressors, or "
    "none (default: auto, from the motion)",
    "--window S": "length of a window [s] (default: 1)",
    "--duration S": f"length of the motion [s] (default: {DURATION:g})",
    "--velocity LIMITS": "limits of velocity [rad/s or m/s], one for each joint with "
    "commas between them, or one for all",
    "--acceleration LIMITS": "limits of acceleration [rad/s^2 or m/s^2]",
    "--torque LIMITS": "limits of torque [N m or N]",
    "--scale SHARE": "share of the limits of velocity and acceleration that may be "
    "used, such as 0.5 for a first run (default: 1)",
    "--seed N": "seed of the initial motions (default: 0)",
    "--for PURPOSE": "gravity: correct the masses of the description by held poses and "
    "slow motion alone (identify), or choose poses for that (design)",
    "--poses N": "number of poses of --for gravity (default: 20)",
    "--ranges FILE": "JSON file for the ranges of identified armature, damping, "
    "friction and other values, for domain randomisation in MuJoCo, Isaac Lab or "
    "Genesis",
    "--out DIR": "output folder (default: the name of LOG plus -report or -simulation)",
    "--out FILE": "file for the motion (default: motion.csv)",
    "--effects NAMES": "effects to look for, all (default of identify) or none; see "
    "the command effects",
}
# Options without one.
_FLAGS = {
    "--join": "the files are channels of one recording, such as positions.csv and "
    "torques.csv",
    "--no-search": "identify the model as declared, without a search for missing "
    "effects",
    "--force": "write to --out even if it exists",
    "--json": "print the report as JSON and nothing else",
    "--quiet": "suppress progress output",
}
_SHORT = {"--out": "-o", "--quiet": "-q"}
_READ_BY = {
    "--acceleration": _numbers,
    "--base-orientation": _numbers,
    "--bodies": _one_of("prior", "free", "fixed"),
    "--cutoff": _cutoff,
    "--drive": _drive,
    "--dt": _positive("seconds"),
    "--duration": _positive("seconds"),
    "--effects": _effects,
    "--for": _one_of("gravity"),
    "--friction": _friction,
    "--gain": _gains,
    "--joints": _distinct,
    "--known-mass": _mass,
    "--poses": _count,
    "--scale": _share,
    "--seed": _seed,
    "--signals": _distinct,
    "--torque": _numbers,
    "--velocity": _numbers,
    "--window": _positive("seconds"),
}
# Filled in after parsing, so that options that were typed are known.
_DEFAULTS = {
    "bodies": "prior",
    "cutoff": "auto",
    "duration": DURATION,
    "friction": FRICTION,
    "poses": 20,
    "scale": 1.0,
    "seed": 0,
    "shared_drives": "auto",
    "window": 1.0,
}

_LOG = {
    "log format": "--columns --preset --topic --dt --time-unit --join --signals",
    "torques": "--gain --drive",
}
_ROBOT = {"robot": "--urdf --joints --base-orientation"}
_MODEL = {"model": "--friction --bodies --shared-drives --known-mass --cutoff"}


class _Command(NamedTuple):
    """A command: its help, its options in groups, and the function that runs it."""

    help: str
    description: str
    groups: dict
    run: str
    usage: str = ""
    n_logs: str = ""  # as argparse has it


COMMANDS = {
    "identify": _Command(
        "identify a robot and find effects missing from its model",
        "Identify a robot from one or several recordings, find effects that its model "
        "lacks, and report the error on held-out data before and after. Writes "
        "report.html, report.json, parameters.csv, identified.urdf, identified.xml for "
        "MuJoCo, and identified.json, which the command simulate reads.",
        _ROBOT
        | _LOG
        | _MODEL
        | {
            "search": "--effects --no-search --for",
            "output": "--out=DIR --force --ranges --json --quiet",
        },
        "_identify:identify",
        "LOG [LOG ...] --urdf FILE [options]",
        "+",
    ),
    "inspect": _Command(
        "check a log: format, channel faults, excitation",
        "Check a log: its format as detected, faults of its channels, and the effects "
        "that its motion excites. Nothing is identified or written.",
        _ROBOT | _LOG | {"output": "--json --quiet"},
        "_inspect:inspect",
        "LOG [LOG ...] --urdf FILE [options]",
        "+",
    ),
    "simulate": _Command(
        "simulate the identified robot from recorded torques or commands",
        "Simulate the identified robot from recorded torques, in windows that begin at "
        "measured states, and print the deviation from the measured motion. With "
        "--drive, simulate it from recorded commands alone, in windows and over whole "
        "recordings. The first 70 % of every recording are identified and the rest is "
        "simulated; with --model, the whole recording. Writes simulation.csv.",
        {"robot": f"{_ROBOT['robot']} --model"}
        | _LOG
        | _MODEL
        | {"output": "--window --out=DIR --force --quiet"},
        "_simulate:simulate",
        "LOG (--urdf FILE | --model FILE) [options]",
        "+",
    ),
    "design": _Command(
        "design an exciting trajectory",
        "Design a periodic motion within the limits of the robot that determines its "
        "model best; with the folder of a report, the one that decides what the report "
        "left open. Writes the motion as CSV (t, then q_, v_ and a_ of each joint, in "
        "SI units). Takes a minute or two.",
        {
            "robot": f"{_ROBOT['robot']} --report",
            "motion": "--duration --dt --velocity --acceleration --torque --scale "
            "--effects --seed --for --poses",
            "output": "--out=FILE --force --quiet",
        },
        "_design:design",
        "(--urdf FILE | --report FOLDER) [options]",
    ),
    "effects": _Command(
        "list the library of effects",
        "List the library of effects.",
        {},
        "_inspect:list_effects",
    ),
}
# Other names of commands.
_ALIASES = {"identify": ["close-loop"]}


def _add_options(parser, command):
    """Add the options of a command in their groups."""
    from sklearn_vbjfa.recording.formats import TABLES

    if command.n_logs:
        parser.add_argument(
            "recording",
            metavar="LOG",
            nargs=command.n_logs,
            help=f"{TABLES} file with columns q1..qn [rad or m], tau1..taun [N m or N] "
            "and, optionally, t [s], segment, and signals such as a temperature; a bag "
            "of ROS 1 or 2, MCAP; the folder of a bag or of a LeRobot data set; - for "
            "standard input; or several files of one robot, or a folder of them",
        )
    for title, names in command.groups.items():
        group = parser.add_argument_group(title)
        for name in names.split():
            _add_option(group, *name.split("="))


def _add_option(group, name, metavar=""):
    """Add an option to a group."""
    names = [*filter(None, [_SHORT.get(name)]), name]
    if name in _FLAGS:
        group.add_argument(*names, action="store_true", help=_FLAGS[name])
        return
    (key,) = [x for x in _OPTIONS if x.startswith(f"{name} {metavar}")]
    group.add_argument(
        *names,
        action="append" if name == "--known-mass" else None,
        type=_read_by(_READ_BY.get(name, str)),
        metavar=key.partition(" ")[2],
        dest={"--for": "purpose"}.get(name),
        help=_OPTIONS[key],
    )


# -- the command line ------------------------------------------------------------------


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are exceptions."""

    def error(self, message):
        """Refuse the command line."""
        found = re.search(r"argument COMMAND: invalid choice: '([^']*)'", message)
        if found:
            message = f"{found[1]!r} is not a command{_suggestion(found[1], COMMANDS)}"
        message = re.sub(r"^argument (?:-\w/)?(--[\w-]+): ", r"\1 ", message)
        raise Refused(f"{message}; see {self.prog} -h")


def _suggestion(word, known):
    near = difflib.get_close_matches(word, known, 1, 0.7)
    return f"; did you mean {near[0]}?" if near else ""


def _parser():
    from sklearn_vbjfa import __version__

    parser = _Parser(
        prog="sklearn-vbjfa",
        description="Robot identification with noise in inputs and outputs. Without a "
        "command, identify the robot of the recording that comes with the package.",
        epilog=EXIT_CODES,
    )
    parser.add_argument("--version", action="version", version=__version__)
    parser.set_defaults(run="_identify:identify_demo", command=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for name, command in COMMANDS.items():
        added = commands.add_parser(
            name,
            aliases=_ALIASES.get(name, []),
            help=command.help,
            usage=f"{parser.prog} {name} {command.usage}",
            description=command.description,
            epilog=EXIT_CODES,
        )
        _add_options(added, command)
        added.set_defaults(run=command.run, command=name, parser=added)
    return parser


def parse(words):
    """Parse the words of a command line.

    Parameters
    ----------
    words : list of str
        Command line without the name of the program.

    Returns
    -------
    argparse.Namespace
        Values by name; ``typed`` has the texts of the options that were given.
    """
    arguments, more = _parser().parse_known_args(words)
    command = getattr(arguments, "parser", None)
    unknown = [word for word in more if word.startswith("-") and word != "-"]
    if hasattr(arguments, "recording") and not unknown:
        # argparse leaves files over that follow an option.
        arguments.recording += more
    elif more:
        option = (unknown or more)[0].partition("=")[0]
        groups = COMMANDS[arguments.command].groups if command else {}
        near = _suggestion(option, " ".join(groups.values()).split())
        (command or _parser()).error(
            f"unrecognized arguments: {' '.join(unknown or more)}{near}"
        )
    arguments.typed = {}
    for name, value in list(vars(arguments).items()):
        if isinstance(value, _Typed):
            arguments.typed[name] = value.text
            setattr(arguments, name, value.value)
        elif isinstance(value, list) and value and isinstance(value[0], _Typed):
            arguments.typed[name] = [one.text for one in value]
            setattr(arguments, name, [one.value for one in value])
        elif value is True:
            arguments.typed[name] = True
        elif value is None and name in _DEFAULTS:
            setattr(arguments, name, _DEFAULTS[name])
    return arguments


def spelled(name):
    """Return the spelling of an option by the name of its value."""
    # `read_recording` calls some otherwise.
    others = {"gains": "gain", "joint_names": "joints", "purpose": "for"}
    name = others.get(name, name)
    return f"--{name.replace('_', '-')}"


def command_line(arguments, options):
    """Return a command with some options in place of those given."""
    # A drive has gains of its own.
    options = {"gains": None} | options if "drive" in options else options
    texts = {spelled(name): text for name, text in arguments.typed.items()}
    texts |= {spelled(name): value for name, value in options.items()}
    words = [arguments.command, *getattr(arguments, "recording", ())]
    for option, value in texts.items():
        for one in value if isinstance(value, list) else [value]:
            text = "" if one in (None, True) else _as_text(one)
            if one is True:
                words.append(option)
            elif text.startswith("-"):
                # It would be taken for an option.
                words.append(f"{option}={text}")
            elif text:
                words += [option, text]
    return shlex.join(["python", "-m", "sklearn_vbjfa", *words])


def _as_text(value):
    """Return the spelling of the value of an option."""
    if isinstance(value, tuple):
        return ",".join(map(_as_text, value))
    return value if isinstance(value, str) else f"{value:.15g}"
