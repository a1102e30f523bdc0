"""Command line: its commands and options, and how a run ends in words."""

import argparse
import difflib
import os
import re
import shlex
import signal
import sys

from sklearn_vbjfa._cli._run import (
    DOUBTFUL,
    EPILOG,
    REFUSED,
    USABLE,
    exit_line,
    run,
    say,
    wrapped,
)

# Longest message [characters].
_LONGEST = 900

# -- commands and options --------------------------------------------------------------

# What is declared of every joint where no option says so.
FRICTION = "viscous,coulomb,offset,rotor_inertia"
# A designed motion [s], unless an option or a report says otherwise.
DURATION, PERIOD = 20.0, 0.01

# What a recording may be, for the help.
_RECORDING = (
    "TABLES file with columns q1..qn [rad or m], tau1..taun [N m or N] and, "
    "optionally, t [s], segment, and "
    "signals such as a temperature; a bag of ROS 1 or 2, MCAP; the folder of a bag or "
    "of a LeRobot data set; - for standard input"
)
_LIMITS = (
    "limits of {} [{}], one for each joint with commas between them, or one for all"
)
_OUT = "output directory; by default the name of RECORDING{} plus -{}"

# Settings of each argument, which a command may override; `default` is filled in after
# parsing, so that options that were typed are known.
_ARGUMENTS = {
    "recording": {
        "metavar": "RECORDING",
        "help": f"{_RECORDING}; or several such files of one robot, recorded alike, or "
        "a folder of them",
    },
    "--join": {
        "action": "store_const",
        "const": True,
        "help": "RECORDING is several files of one recording side by side, such as "
        "positions.csv torques.csv, or a folder of them",
    },
    "--urdf": {"metavar": "FILE", "help": "description of the robot, URDF or MJCF"},
    "--base-orientation": {
        "metavar": "W,X,Y,Z",
        "help": "orientation of a base that is free in the description (quadruped, "
        "humanoid) and held, a quaternion in the world; by default that of the "
        "description",
    },
    "--joints": {
        "metavar": "NAMES",
        "help": "recorded joints, separated by commas, in the order of the columns "
        "q1..qn; other joints (gripper, wheels) are held at zero; by default all, in "
        "the order of the description",
    },
    "--dt": {"type": float, "metavar": "S", "help": "sample period [s]"},
    "--columns": {
        "metavar": "MAPPING",
        "help": "which columns are which channels, such as "
        '"q=actual_q_{i},tau=actual_current_{i},t=timestamp"; {i} is the number of a '
        "joint from 0 or 1, {joint} its name; a unit may follow: q=pos_{i} [deg]",
    },
    "--preset": {
        "metavar": "TOOL",
        "help": "names as tools write them: ros, ur, franka, lerobot or unitree; by "
        "default they are recognised",
    },
    "--topic": {
        "metavar": "NAME",
        "help": "topic of a bag; by default the only one of joint states",
    },
    "--time-unit": {
        "metavar": "UNIT",
        "help": "unit of time: s, ms, us or ns; by default what its name says, or s",
    },
    "--gain": {
        "metavar": "FACTORS",
        "help": "factors by which the columns of torques become N m or N, one for each "
        "joint, such as 8,8,5; or unknown: they are proportional to the torques (motor "
        "currents), and the factors are identified relative to one of them",
    },
    "--drive": {
        "metavar": "LAW",
        "help": "motor control law, for logs without torques, such as "
        '"pd kp=20,20,40 kd=1,1,2" or "pd kp=hip:20,thigh:20,calf:40 kd=1": RECORDING '
        "then has columns q_desired of each joint in place of tau, also v_desired and "
        "tau_ff, and kp and kd unless they are given here. Further values are "
        "delay=auto (found) or seconds, saturation=, gear=, feedforward=true",
    },
    "--signals": {
        "metavar": "NAMES",
        "help": "other columns of RECORDING that friction and offsets may vary with, "
        "such as temperature,voltage; by default all that hold numbers; none for none",
    },
    "--friction": {
        "default": FRICTION,
        "metavar": "NAMES",
        "help": "what the model of each joint has already: none, or any of "
        "viscous,coulomb,offset,rotor_inertia; by default all four",
    },
    "--known-mass": {
        "action": "append",
        "default": (),
        "metavar": "LINK=KG",
        "help": "with --gain unknown, a mass that fixes the common factor: of a link "
        "with what is fixed to it, or payload=KG of what is picked up or put down; may "
        "be repeated",
    },
    "--bodies": {
        "choices": ("prior", "free", "fixed"),
        "default": "prior",
        "help": "masses and inertias: near those of the description unless the torques "
        "say otherwise (prior), from the torques alone (free), or as described "
        "(fixed); by default prior",
    },
    "--alike": {
        "default": "auto",
        "metavar": "GROUPS",
        "help": "joints with the same drive, whose values are near each other unless "
        'the torques say otherwise: a part of their names for each group, such as "hip '
        'thigh calf", or their names with commas between; auto: joints whose names '
        "differ in leg, side or number alone and whose bodies are equal or mirrored; "
        "none: no joints; by default auto",
    },
    "--cutoff": {
        "default": "auto",
        "metavar": "HZ",
        "help": "cut-off of the low-pass for torques and regressors; by default auto, "
        "from the motion; none for no low-pass",
    },
    "--effects": {"metavar": "NAMES"},
    "--seed": {"type": int, "default": 0},
    "--ranges": {
        "metavar": "FILE",
        "help": "file for the ranges of armature, damping, friction and all else that "
        "was identified, JSON in the words of MuJoCo, Isaac Lab and Genesis, for "
        "domain randomisation; by default none",
    },
    "--out": {"metavar": "DIR"},
    "--quiet": {
        "action": "store_true",
        "help": "suppress progress output",
    },
    "--force": {
        "action": "store_true",
        "help": "write to --out even if it holds files of others, or an input of this "
        "run",
    },
    "--model": {
        "metavar": "FILE",
        "help": "identified robot, as RobotIdentifier.save writes it; nothing is "
        "identified then",
    },
    "--window": {
        "type": float,
        "default": 1.0,
        "metavar": "S",
        "help": "length of a window [s], by default 1",
    },
    "--report": {
        "metavar": "FOLDER",
        "help": "folder that close-loop wrote: what its report.json left open is what "
        "the motion decides, and its identified.json has the robot and the measured "
        "noise",
    },
    "--duration": {
        "type": float,
        "default": DURATION,
        "metavar": "S",
        "help": f"length of the motion [s], by default {DURATION:g}",
    },
    "--start": {
        "metavar": "POSITIONS",
        "help": "positions at which the motion begins and ends [rad or m], one for "
        "each joint with commas between them; by default the best",
    },
    "--velocity": {
        "metavar": "LIMITS",
        "help": _LIMITS.format("velocity", "rad/s or m/s"),
    },
    "--acceleration": {
        "metavar": "LIMITS",
        "help": _LIMITS.format("acceleration", "rad/s^2 or m/s^2"),
    },
    "--torque": {"metavar": "LIMITS", "help": _LIMITS.format("torque", "N m or N")},
    "--scale": {
        "type": float,
        "default": 1.0,
        "metavar": "SHARE",
        "help": "share of the limits of velocity and acceleration that may be used, "
        "such as 0.5 for a first run; by default 1",
    },
}

# Options with a short name beside theirs.
_SHORT = {"--quiet": ("-q",)}
# How a recording is read, and what is identified of it, in the order of the help.
READING = (
    "join",
    "joints",
    "dt",
    "columns",
    "preset",
    "topic",
    "time_unit",
    "gain",
    "drive",
)
_READ = (
    "--join --base-orientation --joints --dt --columns --preset --topic --time-unit "
)
_READ += "--gain --drive"
_IDENTIFIED = "--friction --known-mass --bodies --alike --cutoff"
_REQUIRED = {"recording": {"nargs": "+"}}

_WITH_URDF = ("close-loop", "inspect")

# Command -> where it is done, its arguments, what is different of them, and its help.
_COMMANDS = {
    "close-loop": {
        "run": "_close_loop:run",
        "aliases": ["identify"],
        "arguments": f"recording --urdf {_READ} --signals --out --force --ranges "
        f"{_IDENTIFIED} --effects --quiet",
        "overrides": {
            **_REQUIRED,
            "--out": {"help": _OUT.format(", or of the folder of several,", "report")},
            "--effects": {
                "default": "all",
                "help": "effects to look for, by default all; see the command effects",
            },
        },
        "help": "find effects missing from the robot model",
        "description": "Identify a robot from a recording or several, find effects "
        "that its model lacks, add them, and report the error before and after on "
        "parts of the recordings that were set aside. Writes report.html, report.json, "
        "parameters.csv, identified.urdf, identified.xml for MuJoCo, and "
        "identified.json, which the command simulate reads.",
    },
    "inspect": {
        "run": "_inspect:inspect",
        "arguments": f"recording --urdf {_READ} --signals --quiet",
        "overrides": _REQUIRED,
        "help": "check a log: format, channel faults, excitation",
        "description": "Check a log: its format as detected, faults of its channels, "
        "and the effects that its motion excites. Nothing is identified or written.",
    },
    "simulate": {
        "run": "_simulate:run",
        "arguments": f"recording --urdf --model --window {_READ} --signals --out "
        f"--force {_IDENTIFIED} --effects --quiet",
        "overrides": {
            "recording": {"nargs": "*", "help": _RECORDING},
            "--out": {"help": _OUT.format("", "simulation")},
            "--effects": {
                "default": "none",
                "help": "effects to look for, or all; the completed model is then "
                "simulated beside the declared one. By default none; see the command "
                "effects",
            },
        },
        "help": "simulate the identified robot from recorded torques or commands",
        "description": "Drive the identified robot by the measured torques, over "
        "windows that begin at measured states, and print how far it gets from the "
        "measured motion. A robot whose --drive is told positions is told the recorded "
        "ones and nothing else, over windows and whole recordings. The first 70 % of "
        "every recording are identified and windows of the rest are simulated; with "
        "--model, windows of the whole recording. Without RECORDING, the one that "
        "comes with the package. Writes simulation.csv.",
    },
    "design": {
        "run": "_design:run",
        "arguments": "--urdf --base-orientation --report --duration --out --force --dt "
        "--joints --start --velocity --acceleration --torque --scale "
        "--effects --seed --quiet",
        "overrides": {
            "--urdf": {
                "help": "description of the robot, where no report has an identified "
                "one"
            },
            "--out": {
                "default": "motion.csv",
                "metavar": "FILE",
                "help": "file for the motion, by default motion.csv",
            },
            "--force": {"help": "replace a file that exists"},
            "--dt": {
                "help": "sample period [s], by default that of the report, or "
                f"{PERIOD:g}"
            },
            "--joints": {
                "help": "joints that move, separated by commas; others (gripper, "
                "wheels) are held at zero; by default all"
            },
            "--effects": {
                "help": "effects that the motion shall show and tell apart on every "
                "joint; see the command effects"
            },
            "--seed": {"help": "draws the motions of which the best is improved"},
        },
        "help": "design an exciting trajectory",
        "description": "Design a periodic motion within the limits of the robot that "
        "determines its model best; with the folder of a report, the one that decides "
        "what the report left open. Writes the motion as CSV (t, then q_, v_ and a_ of "
        "each joint, in SI units). Takes a minute or two.",
    },
    "effects": {"run": "_inspect:list_effects", "help": "list the library of effects"},
}


class _Parser(argparse.ArgumentParser):
    """Parser that shows the exit codes, and suggests a command or an option."""

    def __init__(self, **settings):
        super().__init__(epilog=EPILOG, **settings)

    def error(self, message):
        """End with exit code 2 and one line."""
        found = re.search(r"invalid choice: '([^']*)'", message)
        if found and "COMMAND" in message:
            message = f"{found[1]!r} is not a command{_suggestion(found[1], _COMMANDS)}"
        self.exit(REFUSED, f"{self.prog}: {one_line(message)}; see {self.prog} -h\n")


def _suggestion(word, known):
    near = difflib.get_close_matches(word, known, 1, 0.7)
    return f"; did you mean {near[0]}?" if near else ""


def _parser():
    from sklearn_vbjfa import __version__

    parser = _Parser(
        prog="sklearn-vbjfa",
        description="Robot identification with noise in inputs and outputs. Without "
        "a command, close the loop on the recording that comes with the package.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    parser.set_defaults(run="_close_loop:run_demo", command=None, defaults={})
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for name, command in _COMMANDS.items():
        _add(commands, name, **command)
    return parser


def _add(commands, name, *, run, arguments="", overrides=None, **texts):
    """Add a command with its arguments to a parser."""
    from sklearn_vbjfa.recording import formats

    command, defaults = commands.add_parser(name, **texts), {}
    for argument in arguments.split():
        settings = _ARGUMENTS[argument] | (overrides or {}).get(argument, {})
        default = settings.pop("default", None)
        settings["help"] = settings["help"].replace("TABLES", formats.TABLES)
        action = command.add_argument(*_SHORT.get(argument, ()), argument, **settings)
        if default is not None:
            defaults[action.dest] = default
    command.set_defaults(run=run, command=name, defaults=defaults)


def _parse(words):
    """Parse the words of a command line."""
    parser = _parser()
    arguments, more = parser.parse_known_args(words)
    parser.prog = " ".join(filter(None, [parser.prog, arguments.command]))
    files = getattr(arguments, "recording", None)
    unknown = [word for word in more if word.startswith("-") and word != "-"]
    if isinstance(files, list) and not unknown:
        # Recordings after an option, which argparse leaves over.
        files += more
    elif more:
        option = (unknown or more)[0].partition("=")[0]
        known = _COMMANDS.get(arguments.command, {}).get("arguments", "").split()
        near = _suggestion(option, known)
        parser.error(f"unrecognized arguments: {' '.join(unknown or more)}{near}")
    values = vars(arguments)
    if values.get("urdf", "") is None and arguments.command in _WITH_URDF:
        parser.error("give --urdf FILE, the description of the robot")
    arguments.given = {name for name in values if values[name] not in (None, [])}
    for name, value in arguments.defaults.items():
        if values[name] is None:
            values[name] = value
    arguments.written, arguments.doubts, arguments.page = False, (), False
    return arguments


def spelled(name):
    """Return an option as it is typed, by the name of its argument."""
    # read_recording calls some otherwise
    name = {"gains": "gain", "joint_names": "joints"}.get(name, name)
    return f"--{name.replace('_', '-')}"


# -- a run and its end -----------------------------------------------------------------


def main(argv=None):
    """Run the command line; return its exit code, see `EPILOG`."""
    words = list(map(str, sys.argv[1:] if argv is None else argv))
    arguments = argparse.Namespace(written=False, doubts=(), page=False)
    try:
        try:
            arguments = _parse(words)
            from sklearn_vbjfa.physical._solver import one_blas_thread

            # The matrices are small: threads would only wait for each other.
            with one_blas_thread():
                run(arguments)
        finally:
            print(end="", flush=True)
    except BrokenPipeError:
        # The reader (head, less) has left: what follows goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        _tell("interrupted")
        return 128 + signal.SIGINT
    except MemoryError:
        _tell(
            "not enough memory; give a shorter recording or fewer effects (--effects)"
        )
        return _given_up(arguments)
    except (ValueError, OSError, ImportError) as error:
        _refuse(one_line(_in_words(error, arguments)), _remedy(error, words))
        return _given_up(arguments)
    if not arguments.doubts:
        return USABLE
    last = exit_line(arguments.doubts, arguments.page)
    say(wrapped(one_line(f"note: {last}"), sys.stderr))
    return DOUBTFUL


def _given_up(arguments):
    """Return the exit code of a run that ended before its end."""
    return DOUBTFUL if arguments.written else REFUSED


def _in_words(error, arguments):
    """Return the message of a refusal."""
    written = "; all files were written" if arguments.written else ""
    if isinstance(error, OSError) and error.strerror:
        # Writing to a stream names no file.
        what = error.filename or "the standard output"
        return f"{what}: {error.strerror}{written}"
    return f"{getattr(error, 'reason', error)}{written}"


def _remedy(error, words):
    """Return the command with the options of an error in place of those typed."""
    options = {spelled(k): v for k, v in getattr(error, "options", {}).items()}
    if not options:
        return ""
    if "--drive" in options:
        # A drive has gains of its own.
        options["--gain"] = None
    kept, rest = [], iter(words)
    for word in rest:
        option = word.partition("=")[0]
        if option not in options:
            kept.append(word)
        elif "=" not in word:
            next(rest, None)
    for option, value in options.items():
        if value is True:
            kept.append(option)
        elif value is not None:
            # A list that begins with a minus would be taken for an option.
            kept.append(f"{option}={_typed(value)}")
    return f"python -m sklearn_vbjfa {shlex.join(kept)}"


def _typed(value):
    """Return the value of an option as it is typed."""
    if isinstance(value, tuple):
        return ",".join(map(_typed, value))
    return value if isinstance(value, str) else f"{value:.15g}"


def _refuse(message, remedy):
    """Print a refusal in one line, wrapped on a terminal except for the command."""
    if not remedy:
        _tell(wrapped(message, sys.stderr))
    elif sys.stderr is not None and sys.stderr.isatty():
        _tell(wrapped(f"{message}; this would work:", sys.stderr) + f"\n{remedy}")
    else:
        _tell(f"{message}; this would work: {remedy}")


def _tell(message):
    """Print a message under the name of the program."""
    say(f"sklearn-vbjfa: {message}")


def one_line(message):
    """Return a message as one line, without the middle of a huge one."""
    text = " ".join(str(message).split())
    if len(text) > _LONGEST:
        left = len(text) - _LONGEST
        begin, end = text[: _LONGEST - 300], text[-300:]
        text = f"{begin} (and {left} characters more) {end}"
    return text
