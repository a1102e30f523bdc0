"""Commands and options, their values, and the command that would have worked."""

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
    """Input that is refused, with options that would be accepted, None to omit one."""

    def __init__(self, reason, **options):
        super().__init__(reason)
        self.options = options


# -- values of options -----------------------------------------------------------------
#
# Texts become numbers and names here; what these may be is checked where they are used.


def numbers(text):
    """Return the numbers in a comma-separated list."""
    return tuple(map(float, text.split(",")))


def names(text):
    """Return the names in a comma-separated list."""
    return tuple(name.strip() for name in text.split(","))


def drive(text):
    """Return a motor control law."""
    from sklearn_vbjfa.recording import parse_drive

    try:
        return parse_drive(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix("drive ")) from None


def effects(text, kind="available"):
    """Return names of effects that are available or declarable."""
    from sklearn_vbjfa import effects as library

    found, known = () if text == "none" else names(text), getattr(library, kind)()
    for name in found:
        if name not in known:
            raise argparse.ArgumentTypeError(
                f"does not know {name!r}{_suggestion(name, known)}; expected names "
                f"with commas between them, of {', '.join(known)}"
            )
    return found


_CONVERSIONS = {x.__name__: x for x in (float, int, numbers, names, drive)} | {
    "factors": lambda text: text if text == "unknown" else numbers(text),
    # The name of a link and its mass [kg].
    "mass": lambda text: (text.rpartition("=")[0], float(text.rpartition("=")[2])),
    "effects": lambda text: text if text == "all" else effects(text),
    "friction": lambda text: effects(text, "declarable"),
}


# -- options and commands --------------------------------------------------------------

_SHORT = {"out": "-o", "quiet": "-q"}
# Values that are not called as their options.
_DEST = {"for": "purpose"}
_OPTION_OF = {"gains": "gain", "joint_names": "joints", "purpose": "for"}
# Other names of commands.
_ALIASES = {"identify": ["close-loop"]}


@lru_cache
def _tables():
    text = files("sklearn_vbjfa._cli").joinpath("commands.toml").read_text("utf-8")
    found = tomllib.loads(text)
    return found["options"], found["commands"]


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are exceptions."""

    def error(self, message):
        """Refuse the command line."""
        found = re.search(r"argument COMMAND: invalid choice: '([^']*)'", message)
        if found:
            message = (
                f"{found[1]!r} is not a command{_suggestion(found[1], _tables()[1])}"
            )
        message = re.sub(r"^argument (?:-\w/)?(--[\w-]+): ", r"\1 ", message)
        message = message.replace(" invalid choice: ", " has an invalid value: ")
        raise Refused(f"{message.rstrip('.')}; see {self.prog} -h")


def _suggestion(word, known):
    near = difflib.get_close_matches(word, known, 1, 0.7)
    return f"; did you mean {near[0]}?" if near else ""


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
        added = commands.add_parser(
            name,
            aliases=_ALIASES.get(name, []),
            help=command["help"],
            usage=f"{parser.prog} {name} {command['usage']}",
            description=command["description"],
            epilog=EXIT_CODES,
        )
        added.set_defaults(run=command["run"], command=name, parser=added)
        _add_options(added, command)
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
    """Return the values of a command line; ``typed`` has the texts that were given."""
    # argparse takes a list that begins with a minus, -1,1, for an option.
    text = re.sub("\0(--[a-z-]+)\0(?=-[.\\d])", "\0\\1=", "\0".join(["", *words]))
    parser = _parser()
    arguments, more = parser.parse_known_args(text.split("\0")[1:])
    parser = getattr(arguments, "parser", parser)
    groups = _tables()[1].get(arguments.command, {"groups": {}})["groups"]
    names = " ".join(groups.values()).split()
    unknown = [word for word in more if word.startswith("-") and word != "-"]
    if hasattr(arguments, "recording") and not unknown:
        # argparse leaves files over that follow an option.
        arguments.recording += more
    elif more:
        option = (unknown or more)[0].partition("=")[0]
        parser.error(
            f"unrecognized arguments: {' '.join(unknown or more)}"
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
        return [_value(parser, name, one) for one in text]
    try:
        return _CONVERSIONS[option["value"]](text)
    except argparse.ArgumentTypeError as error:
        parser.error(f"--{name} {error}")
    except ValueError:
        parser.error(f"--{name} has an invalid value: {text!r}")


def spelled(name):
    """Return the spelling of an option by the name of its value."""
    return f"--{_OPTION_OF.get(name, name).replace('_', '-')}"


# Parameters in messages: with a value, or alone in brackets.
_PARAMETER = re.compile(
    r"(?<![-\w])(columns|gains|bodies|joint_names|join)="
    r"""(?:(["'])(?P<text>.*?)\2|(?P<number>[-+\w.]*\w))"""
    r"|(?<=\()(columns|gains|joint_names)(?=\))"
)


def in_options(message):
    """Return a message with options in place of parameters of Python."""

    def option(match):
        key, text = match[1] or match[5], match["text"] or match["number"] or ""
        words = [spelled(key), text and shlex.quote(text)]
        return " ".join(words[: 1 if text in ("", "True") else 2])

    message = str(message).replace("drive=CurrentDrive(", "--drive 'current ")
    message = message.replace("signed=False)", "signed=no'")
    return _PARAMETER.sub(option, message)


def command_line(arguments, options):
    """Return a command with some options in place of those given."""
    # The gains are those of the drive.
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
    return command_of(*words)


def command_of(*words):
    """Return a command of the package with the words that follow its name."""
    return shlex.join(["python", "-m", "sklearn_vbjfa", *words])


def _as_text(value):
    if isinstance(value, tuple):
        return ",".join(map(_as_text, value))
    return value if isinstance(value, str) else f"{value:.15g}"
