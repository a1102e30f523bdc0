"""Parsing of commands and options, and commands to suggest in messages."""

import argparse
import difflib
import re
import shlex
import tomllib
from functools import lru_cache
from importlib.resources import files

EXIT_CODES = (
    "exit codes: 0 success; 2 nothing was done, for the reason on stderr; 3 finished "
    "with warnings, named in the last line on stderr"
)


class Refused(ValueError):
    """Refused input, with options that would be accepted (None to omit one)."""

    def __init__(self, reason, **options):
        super().__init__(reason)
        self.options = options


# -- values of options -----------------------------------------------------------------
#
# Texts are converted to numbers and names here; values are checked where they are used.


def numbers(text):
    return tuple(map(float, text.split(",")))


def names(text):
    return tuple(name.strip() for name in text.split(","))


def drive(text):
    from sklearn_vbjfa.recording import parse_drive

    try:
        return parse_drive(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix("drive ")) from None


def effects(text, kind="available"):
    """Return names of effects that are available or declarable."""
    from sklearn_vbjfa import effects as library

    chosen, valid = () if text == "none" else names(text), getattr(library, kind)()
    for name in chosen:
        if name not in valid:
            raise argparse.ArgumentTypeError(
                f"does not know {name!r}{_suggestion(name, valid)}; expected names "
                f"with commas between them, of {', '.join(valid)}"
            )
    return chosen


_CONVERSIONS = {x.__name__: x for x in (float, int, numbers, names, drive)} | {
    "factors": lambda text: text if text == "unknown" else numbers(text),
    # The name of a link and its mass [kg].
    "mass": lambda text: (text.rpartition("=")[0], float(text.rpartition("=")[2])),
    "effects": lambda text: text if text == "all" else effects(text),
    "friction": lambda text: effects(text, "declarable"),
}


# -- options and commands --------------------------------------------------------------

_SHORT = {"out": "-o", "quiet": "-q"}
# Attributes and parameters whose names differ from their options.
_DEST = {"for": "purpose"}
_OPTION_OF = {"gains": "gain", "joint_names": "joints", "purpose": "for"}
# Other names of commands.
_ALIASES = {"identify": ["close-loop"]}


@lru_cache
def _tables():
    text = files("sklearn_vbjfa._cli").joinpath("commands.toml").read_text("utf-8")
    tables = tomllib.loads(text)
    return tables["options"], tables["commands"]


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        match = re.search(r"argument COMMAND: invalid choice: '([^']*)'", message)
        if match:
            message = (
                f"{match[1]!r} is not a command{_suggestion(match[1], _tables()[1])}"
            )
        message = re.sub(r"^argument (?:-\w/)?(--[\w-]+): ", r"\1 ", message)
        message = message.replace(" invalid choice: ", " has an invalid value: ")
        raise Refused(f"{message.rstrip('.')}; see {self.prog} -h")


def _suggestion(word, valid):
    matches = difflib.get_close_matches(word, valid, 1, 0.7)
    return f"; did you mean {matches[0]}?" if matches else ""


def _parser():
    from sklearn_vbjfa import __version__

    parser = _Parser(
        prog="sklearn-vbjfa",
        description="Identify a robot from a log and find effects missing from its "
        "model. Without a command: a demonstration.",
        epilog=EXIT_CODES,
    )
    parser.add_argument("--version", action="version", version=__version__)
    parser.set_defaults(run="_identify:identify_demo", command=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for name, command in _tables()[1].items():
        subparser = commands.add_parser(
            name,
            aliases=_ALIASES.get(name, []),
            help=command["help"],
            usage=f"{parser.prog} {name} {command['usage']}",
            description=command["description"],
            epilog=EXIT_CODES,
        )
        subparser.set_defaults(run=command["run"], command=name, parser=subparser)
        _add_options(subparser, command)
    return parser


def _add_options(parser, command):
    from sklearn_vbjfa.recording.formats import TABLES

    if command["usage"].startswith("LOG"):
        parser.add_argument(
            "recording",
            metavar="LOG",
            nargs="+",
            help=f"{TABLES} file with columns q1..qn [rad or m], tau1..taun [N m or N] "
            "and, optionally, t [s], segment, and signals such as a temperature; a bag "
            "of ROS 1 or 2, MCAP; the folder of a bag or of a LeRobot data set; - for "
            "standard input; or several files of one robot, or a folder of them",
        )
    for title, names in command["groups"].items():
        group = parser.add_argument_group(title)
        for name in names.split():
            option = _tables()[0][name]
            kind = {"action": "store_true"}
            if "metavar" in option:
                kind = {key: option.get(key) for key in ("metavar", "choices")}
                kind["action"] = option.get("action", "store")
            flags = [x for x in (_SHORT.get(name), f"--{name}") if x]
            text = command.get("texts", {}).get(name, option["help"])
            group.add_argument(*flags, dest=_dest(name), help=text, **kind)


def _dest(name):
    return _DEST.get(name, name.replace("-", "_"))


def parse(words):
    """Return the values of a command line, and the texts as typed (``typed``)."""
    # argparse would interpret a list such as -1,1 as an option.
    text = re.sub("\0(--[a-z-]+)\0(?=-[.\\d])", "\0\\1=", "\0".join(["", *words]))
    parser = _parser()
    arguments, remaining = parser.parse_known_args(text.split("\0")[1:])
    parser = getattr(arguments, "parser", parser)
    groups = _tables()[1].get(arguments.command, {"groups": {}})["groups"]
    names = " ".join(groups.values()).split()
    unknown = [x for x in remaining if x.startswith("-") and x != "-"]
    if hasattr(arguments, "recording") and not unknown:
        # argparse does not assign files that follow an option.
        arguments.recording += remaining
    elif remaining:
        option = (unknown or remaining)[0].partition("=")[0]
        parser.error(
            f"unrecognized arguments: {' '.join(unknown or remaining)}"
            f"{_suggestion(option, [f'--{name}' for name in names])}"
        )
    texts = {_dest(name): getattr(arguments, _dest(name)) for name in names}
    arguments.typed = {dest: text for dest, text in texts.items() if text}
    for name, text in zip(names, texts.values()):
        setattr(arguments, _dest(name), _value(parser, name, text))
    return arguments


def _value(parser, name, text):
    option = _tables()[0][name]
    if text is None:
        default = option.get("default")
        return tuple(default) if isinstance(default, list) else default
    if "value" not in option:
        return text
    if isinstance(text, list):
        return [_value(parser, name, item) for item in text]
    try:
        return _CONVERSIONS[option["value"]](text)
    except argparse.ArgumentTypeError as error:
        parser.error(f"--{name} {error}")
    except ValueError:
        parser.error(f"--{name} has an invalid value: {text!r}")


def option_of(name):
    """Return the option of a parameter, such as ``--gain`` of ``gains``."""
    return f"--{_OPTION_OF.get(name, name).replace('_', '-')}"


# Parameters in messages: with a value, or in parentheses without one.
_PARAMETER = re.compile(
    r"(?<![-\w])(columns|gains|bodies|joint_names|join)="
    r"""(?:(["'])(?P<text>.*?)\2|(?P<number>[-+\w.]*\w))"""
    r"|(?<=\()(columns|gains|joint_names)(?=\))"
)


def with_options(message):
    """Replace the Python parameters in a message by command line options."""

    def option(match):
        key, text = match[1] or match[5], match["text"] or match["number"] or ""
        words = [option_of(key), text and shlex.quote(text)]
        return " ".join(words[: 1 if text in ("", "True") else 2])

    message = str(message).replace("drive=CurrentDrive(", "--drive 'current ")
    message = message.replace("signed=False)", "signed=no'")
    return _PARAMETER.sub(option, message)


def command_line(arguments, options):
    """Return the command of some arguments, with replaced options."""
    # A drive has its own gains.
    options = {"gains": None} | options if "drive" in options else options
    texts = {option_of(name): text for name, text in arguments.typed.items()}
    texts |= {option_of(name): value for name, value in options.items()}
    words = [arguments.command, *getattr(arguments, "recording", ())]
    for option, value in texts.items():
        for item in value if isinstance(value, list) else [value]:
            text = "" if item in (None, True) else _as_text(item)
            if item is True:
                words.append(option)
            elif text.startswith("-"):
                # argparse would interpret it as an option.
                words.append(f"{option}={text}")
            elif text:
                words += [option, text]
    return shell_line(*words)


def shell_line(*words):
    return shlex.join(["python", "-m", "sklearn_vbjfa", *words])


def _as_text(value):
    if isinstance(value, tuple):
        return ",".join(map(_as_text, value))
    return value if isinstance(value, str) else f"{value:.15g}"
