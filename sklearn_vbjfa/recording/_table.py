"""A file's content as a data frame, names and units of its columns, and refusals."""

import contextlib
import difflib
import importlib
import itertools
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

# Bytes that a file may hold when unpacked: some hours of a robot at 1 kHz.
LARGEST = 1 << 30
# Entries of a list, and characters of a name or cell, that messages quote at most.
_ENTRIES, _CHARACTERS = 20, 60


class Loss(str):
    """A note on a part of a recording, or of its robot, that is left out."""

    __slots__ = ()


class RecordingRefused(ValueError):
    """A file that is not read, maybe with other options that read it.

    Attributes
    ----------
    reason : str
        Why the file is refused, without the options.
    options : dict of str to str, tuple or None
        The options, by the names of `read_recording`; None for one to leave out. Empty
        if none would do.
    """

    def __init__(self, reason, options=None):
        self.reason = reason.removesuffix(".")
        self.options = dict(options or {})
        offers = [f"{key}={value!r}" for key, value in self.options.items()]
        offer = f"; try {', '.join(offers)}" if offers else ""
        super().__init__(f"{self.reason}{offer}.")


class NotATable(RecordingRefused):
    """A file that holds no table of numbers at all, such as a text to be read."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Named columns of equal length, numbers or text, out of a file.

    The index of the frame has the number by which messages call each row.
    """

    path: Path  # as messages name it
    name: str = ""  # of the recording, if not that of the file
    frame: Any  # a data frame
    place: str = "row {}"  # a row in messages
    # single values, and arrays of another length
    scalars: Mapping[str, np.ndarray] = field(default_factory=dict)
    # joints whose columns are called q_<joint> and tau_<joint> for certain
    joints: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def nameless(self) -> bool:
        """Whether columns are called by their places, from "1" on."""
        return all(name.isdecimal() for name in self.frame)

    def values(self, name) -> np.ndarray:
        """Return a column: numbers, dates, or text as objects."""
        return self.frame[name].to_numpy()

    def numbers(self, name) -> np.ndarray:
        """Return a column as finite floats; an error names the wrong cell."""
        values = self.values(name)
        if values.dtype.kind not in "biuf":
            raise ValueError(
                f"{self.path}: column {name!r} holds {quoted(str(values[0]))} and not "
                "numbers; correct or rename it."
            )
        with np.errstate(over="ignore"):
            values = values.astype(float)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise ValueError(
                f"{self.path}: {values[bad[0]]} or nothing in {self.where(bad[0])}, "
                f"column {name!r} ({bad.size} such cells in it); interpolate them or "
                "remove those rows."
            )
        return values

    def with_dates(self) -> "Table":
        """Return the table with one column of dates for stamps that have two."""
        pandas, frame = imported(self.path, "pandas"), self.frame.copy(deep=False)
        numbers = [name for name in frame if frame[name].dtype.kind in "iuf"]
        for name, (end, rests) in itertools.product(numbers, _NAMES["clocks"].items()):
            for rest, unit in rests.items() if name.endswith(end) else ():
                other = name.removesuffix(end) + rest
                if other in numbers:
                    date = pandas.to_datetime(frame[name], unit="s", errors="coerce")
                    date += pandas.to_timedelta(frame.pop(other), unit=unit)
                    frame[name] = date
        return replace(self, frame=frame)

    def where(self, row) -> str:
        """Name a row in words."""
        return self.place.format(self.frame.index[row])


# -- files that are damaged, too large or empty, packages that are missing -------------


@contextlib.contextmanager
def parsing(path, what, remedy):
    """Turn whatever a parser raises on a damaged file into one refusal."""
    try:
        yield
    except (RecordingRefused, ImportError):
        raise
    except Exception as error:
        # rosbags quotes what an error held as a tuple.
        reason = re.sub(r"\(['\"](.*?)['\"],\)", r"\1", " ".join(str(error).split()))
        reason = reason.rstrip(".")[:200] or type(error).__name__
        raise ValueError(
            f"{path}: is not a complete {what} ({reason}); {remedy}"
        ) from error


def check_size(path, size):
    """Refuse what is packed small and fills the memory."""
    if size > LARGEST:
        raise RecordingRefused(
            f"{path}: is too large to be read at once, {size / (1 << 30):.1f} GiB of "
            f"at most {LARGEST / (1 << 30):.0f}; save a shorter recording."
        )


def no_rows(path):
    """Return the refusal of a file without data."""
    what = "is empty, no rows of data; expected one per sample"
    return RecordingRefused(f"{path}: {what}")


def check_names(path, names, what):
    """Refuse a name that comes twice."""
    ((first, count),) = Counter(names).most_common(1)
    if count > 1:
        raise RecordingRefused(
            f"{path}: {what} column {quoted(first)} twice; rename or remove one of "
            "them."
        )


def imported(path, module):
    """Import a module that a file needs, or say how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0].replace("_", "-")
        raise ImportError(
            f"{path}: reading it needs {package}: pip install "
            f'"sklearn-vbjfa[{_NAMES["extras"][package]}]"'
        ) from error


# -- what a file holds, quoted ---------------------------------------------------------


def quoted(value):
    """Write a value as Python does; of a long one the beginning."""
    text = repr(value)
    left = len(text) - _CHARACTERS
    return f"{text[:_CHARACTERS]} and {left} characters more" if left > 0 else text


def listed(names):
    """List names with commas; of many the first."""
    names = [x if len(x) <= _CHARACTERS else quoted(x) for x in map(str, names)]
    if len(names) > _ENTRIES:
        names[_ENTRIES - 1 :] = [f"and {len(names) - _ENTRIES + 1} more"]
    return ", ".join(names)


# Channels of joints, and which of them a command has the unit of.
KINDS = ("q", "tau", "v", "a")
MEASURED = {"q_desired": "q", "v_desired": "v", "tau_ff": "tau"}
# What one may write for a time, where a unit is asked for, in seconds.
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "days": 86400.0}
# Periods of robots that move [s].
_FASTEST, SLOWEST = 2e-5, 1.0
# Units, words and presets.
_NAMES = tomllib.loads(
    resources.files("sklearn_vbjfa.recording").joinpath("names.toml").read_text("utf-8")
)


class Unit(NamedTuple):
    """A unit: its base and its size in it."""

    base: str
    factor: float


_UNITS = {
    kind: {
        spelling: Unit(base, size)
        for base, sizes in bases.items()
        for spellings, size in sizes.items()
        for spelling in spellings.split()
    }
    for kind, bases in _NAMES["units"].items()
}
# How units of derivatives of positions end.
_RATES = {"v": ("/s", "/sec", "ps"), "a": ("/s^2", "/s2", "/s²", "/s/s", "ps2")}
EXPECTED = _NAMES["expected"]
# The last part of a name, which may be a unit.
LAST_PART = re.compile(r"(.*?)[_ .]([A-Za-z°µμ%][A-Za-z0-9^/²]*)")
_IN_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^][]*)\]|\(([^()]*)\)|\s/\s*(\S+))")


def unit_of(kind: str, text: str) -> Unit | None:
    """Return the unit of a channel of a kind (q, v, a, tau, t), None if unknown."""
    plain = re.sub(r"[\s*·.⋅]|(?<=N)-(?=m)", "", text.strip())
    kind = MEASURED.get(kind, kind)
    for end in _RATES.get(kind, ()):
        if plain.lower().endswith(end):
            return unit_of("q", plain[: -len(end)])
    known = _UNITS.get(kind, {})
    # Capitals matter for milli and mega, ampere and atto; words may have any.
    words = plain.lower() if len(plain) > 2 or plain == "NM" else plain
    return known.get(plain) or known.get(words)


def split_unit(name: str) -> tuple[str, str]:
    """Return a name without the unit in brackets at its end, and that unit."""
    match = _IN_BRACKETS.fullmatch(name)
    if match is None:
        return name, ""
    unit = next(x for x in match.groups()[1:] if x is not None).strip()
    # Of q[1] and pos(elbow) these are the joints.
    if not match[1] or unit.isdecimal() or "{" in unit:
        return name, ""
    return match[1], unit


# -- units of time ---------------------------------------------------------------------


def usual_step(t):
    """Return the middle one of the steps by which a clock rises, 0 without any."""
    # Of rows that are out of order as if they were sorted.
    step = np.diff(np.sort(t))
    step = step[step > 0]
    return float(np.median(step)) if step.size else 0.0


def unit_of_steps(step):
    """Return the unit of time in which steps are those of a robot, "" for none."""
    known = (x for x, size in TIME_UNITS.items() if _FASTEST < step * size < SLOWEST)
    return next(known, "")


# -- words -----------------------------------------------------------------------------

COMMAND_NAMES = {kind: words.split() for kind, words in _NAMES["commands"].items()}
_KIND_OF = {word: x for x, words in _NAMES["words"].items() for word in words.split()}
# The least similarity of a word to one of these.
_SIMILAR = 0.85


def kinds_in(name):
    """Return the kinds that the words of a name mean, also misspelled, a set of str."""
    text = re.sub(r"\{\w+\}", " ", split_unit(name)[0])
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    words = [x.lower() for x in re.findall(r"[^\W\d_]+", text)]
    near = [difflib.get_close_matches(x, _KIND_OF, 1, _SIMILAR) for x in words]
    return {_KIND_OF[word] for (word,) in filter(None, near)}


def channels_in(name):
    """Return the kinds that a name means; torques and currents are both "tau"."""
    return {"tau" if x in ("torque", "current") else x for x in kinds_in(name)}


def is_current(name):
    """Return whether a name says that it is a motor's current, and no torque."""
    kinds = kinds_in(name)
    return "current" in kinds and "torque" not in kinds


# What a known log may lack; see ``names.toml``.
_LACKING = {"v": "", "commands": {}, "motors": [], "segment": ""}
PRESETS = {
    name: [SimpleNamespace(**_LACKING | log) for log in logs]
    for name, logs in _NAMES["presets"].items()
}
