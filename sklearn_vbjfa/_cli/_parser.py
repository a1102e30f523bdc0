"""Commands and options, their values, and the command that would have worked."""

import argparse
import difflib
import math
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


def number(text):
    """Return the number that a text is, nan for none."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan


def _is_positive(value):
    return 0 < value < math.inf


def _value(expected, convert, holds=lambda value: True, words=()):
    """Return the conversion of a text to a value that holds; some words are kept."""

    def read(text):
        if text in words:
            return text
        try:
            value = convert(text)
        except ValueError:
            value = math.nan
        if value != value or not holds(value):
            shown = (
                text if text == "nan" or number(text) == number(text) else repr(text)
            )
            raise ValueError(f"must be {expected}; got {shown}")
        return value

    return read


def _positive(unit, *words):
    others = "".join(f" or {word}" for word in words)
    return _value(f"a positive number of {unit}{others}", float, _is_positive, words)


def _one_of(*words):
    return _value(" or ".join(words), str, words.__contains__)


def _floats(text):
    return tuple(map(float, text.split(",")))


def _mass(text):
    name, _, kilograms = text.rpartition("=")
    return name, float(kilograms)


def _cutoff(text):
    value = _positive("Hz", "auto", "none")(text)
    return None if value == "none" else value


def _drive(text):
    from sklearn_vbjfa.recording import parse_drive

    try:
        return parse_drive(text)
    except ValueError as error:
        raise ValueError(str(error).removeprefix("drive ")) from None


def _names(text):
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
    names = () if text == "none" else _names(text)
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


# Conversions of the texts of values, by the names that the table of options has.
_CONVERSIONS = {
    "bodies": _one_of("prior", "free", "fixed"),
    "count": _value("a positive integer", int, _is_positive),
    "cutoff": _cutoff,
    "drive": _drive,
    "effects": _effects,
    "factors": _value(
        "a factor to N m or N for each joint, such as 8,8,5, or unknown for all "
        "channels together",
        _floats,
        lambda values: all(math.isfinite(x) and x != 0 for x in values),
        ("unknown",),
    ),
    "friction": _friction,
    "mass": _value(
        "LINK=KG or payload=KG with a positive mass in kg",
        _mass,
        lambda pair: pair[0] and _is_positive(pair[1]),
    ),
    "names": _names,
    "numbers": _value("numbers with commas between them", _floats),
    "purpose": _one_of("gravity"),
    "seconds": _positive("seconds"),
    "seed": _value("an integer from 0 to 2**32 - 1", int, lambda x: 0 <= x < 2**32),
    "share": _value("above 0 and at most 1", float, lambda x: 0 < x <= 1),
    "text": str,
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
    """Return the tables of options and of commands, by name."""
    text = files("sklearn_vbjfa._cli").joinpath("commands.toml").read_text("utf-8")
    found = tomllib.loads(text)
    return found["options"], found["commands"]


class _Keep(argparse.Action):
    """Convert the text of an option; the text itself is kept in ``typed``."""

    def __call__(self, parser, namespace, text, option_string=None):
        """Set the value of the option."""
        typed, value = namespace.typed, True
        if self.nargs != 0:
            name = self.option_strings[-1]
            try:
                kind = _tables()[0][name[2:]].get("value", "text")
                value = _CONVERSIONS[kind](text)
            except ValueError as error:
                parser.error(f"{name} {str(error).rstrip('.')}")
        if self.dest == "known_mass":
            value = [*(getattr(namespace, self.dest) or []), value]
            text = [*typed.get(self.dest, []), text]
        setattr(namespace, self.dest, value)
        typed[self.dest] = True if self.nargs == 0 else text


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
        raise Refused(f"{message}; see {self.prog} -h")


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
        added.set_defaults(run=command["run"], command=name, parser=added, typed={})
        _add_options(added, command)
    return parser


def _add_options(parser, command):
    """Add the options of a command in their groups."""
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
            metavar = option.get("metavar")
            default = option.get("default", None if metavar else False)
            group.add_argument(
                *filter(None, [_SHORT.get(name)]),
                f"--{name}",
                action=_Keep,
                nargs=None if metavar else 0,
                metavar=metavar,
                dest=_DEST.get(name, name.replace("-", "_")),
                default=tuple(default) if isinstance(default, list) else default,
                help=option["help"],
            )


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
        groups = _tables()[1][arguments.command]["groups"] if command else {}
        known = [f"--{name}" for name in " ".join(groups.values()).split()]
        (command or _parser()).error(
            f"unrecognized arguments: {' '.join(unknown or more)}"
            f"{_suggestion(option, known)}"
        )
    return arguments


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
    return shlex.join(["python", "-m", "sklearn_vbjfa", *words])


def _as_text(value):
    """Return the spelling of the value of an option."""
    if isinstance(value, tuple):
        return ",".join(map(_as_text, value))
    return value if isinstance(value, str) else f"{value:.15g}"
