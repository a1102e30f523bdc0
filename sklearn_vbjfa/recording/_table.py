"""Tables read from files, names and units of their columns, and error classes."""

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
from typing import Any, NamedTuple

import numpy as np

# Maximum size of an unpacked file [byte]: some hours of a robot at 1 kHz.
MAX_BYTES = 1 << 30
# Maximum number of list entries, and of characters of a name or cell, in messages.
_MAX_ENTRIES, _MAX_LENGTH = 20, 60
# Names of text columns that list joint names, numbers removed.
NAMES_TITLE = re.compile(r"(.*[^a-z])?names?[^a-z]*", re.IGNORECASE)


class Loss(str):
    """A note on a loss or on doubtful channels, which forbids a clean exit."""

    __slots__ = ()


class RecordingRefused(ValueError):
    """Error for a file that cannot be read, with options that would read it.

    Attributes
    ----------
    reason : str
        Why the file is refused, without the options.
    options : dict of str to str, tuple or None
        Arguments of `read_recording` to change; None for one to leave out. Empty if
        none is known.
    """

    def __init__(self, reason, options=None):
        self.reason = reason.removesuffix(".")
        self.options = dict(options or {})
        offers = [f"{key}={value!r}" for key, value in self.options.items()]
        offer = f"; try {', '.join(offers)}" if offers else ""
        super().__init__(f"{self.reason}{offer}.")


class NotATable(RecordingRefused):
    """Error for a file that contains no table of numbers, such as prose."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns of a file, of equal length, with numbers or text.

    The index of the frame contains the row numbers used in messages.
    """

    path: Path  # as shown in messages
    name: str = ""  # of the recording, if it differs from the file name
    frame: Any  # a data frame
    place: str = "row {}"  # format of a row number in messages
    # single values, and arrays whose length is not the number of rows
    scalars: Mapping[str, np.ndarray] = field(default_factory=dict)
    # joints if the columns are certain to be named q_<joint> and tau_<joint>
    joints: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def nameless(self) -> bool:
        """Whether columns have no names, only their numbers, from "1" on."""
        return all(name.isdecimal() for name in self.frame)

    def values(self, name) -> np.ndarray:
        """Return a column as an array of numbers, dates, or objects for text."""
        return self.frame[name].to_numpy()

    def numbers(self, name) -> np.ndarray:
        """Return a column as finite floats; an error names the first invalid cell."""
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
                f"column {name!r} ({bad.size} such cells in it); remove those "
                "rows; interpolated values would bias the fit."
            )
        return values

    def with_dates(self) -> "Table":
        """Merge time stamps in columns such as s, ms and us to a column of dates."""
        pandas, frame = imported(self.path, "pandas"), self.frame.copy(deep=False)
        columns = {x.lower(): x for x in frame if frame[x].dtype.kind in "iuf"}
        clocks = _CONFIG["clocks"].items()
        endings = [(end, *part) for end, parts in clocks for part in parts.items()]
        for name, (end, rest, unit) in itertools.product(columns, endings):
            whole, part = columns[name], columns.get(name.removesuffix(end) + rest)
            if not name.endswith(end) or part not in frame:
                continue
            # Otherwise, two columns hold the same time in different units.
            seconds, fraction = self.frame[whole], TIME_UNITS[unit] * frame[part]
            if seconds.mod(1).max() == 0 and fraction.max() <= 1:
                date = pandas.to_datetime(frame[whole], unit="s", errors="coerce")
                date += pandas.to_timedelta(frame.pop(part), unit=unit)
                frame[whole] = date
        return replace(self, frame=frame)

    def where(self, row) -> str:
        """Return the location of a row for messages."""
        return self.place.format(self.frame.index[row])


@contextlib.contextmanager
def parsing(path, what, remedy):
    """Convert any exception of a parser on a damaged file to one clear ValueError."""
    try:
        yield
    except (RecordingRefused, ImportError):
        raise
    except Exception as error:
        # rosbags prints the arguments of an error as a tuple.
        reason = re.sub(r"\(['\"](.*?)['\"],\)", r"\1", " ".join(str(error).split()))
        reason = reason.rstrip(".")[:200] or type(error).__name__
        raise ValueError(
            f"{path}: is not a complete {what} ({reason}); {remedy}"
        ) from error


def check_size(path, size):
    """Refuse files that would fill the memory when unpacked."""
    if size > MAX_BYTES:
        raise RecordingRefused(
            f"{path}: is too large to be read at once, {size / (1 << 30):.1f} GiB of "
            f"at most {MAX_BYTES / (1 << 30):.0f}; save a shorter recording."
        )


def no_rows(path):
    """Return the error for a file without data."""
    return NotATable(f"{path}: is empty, no rows of data; expected one per sample")


def check_names(path, names, what):
    """Raise an error if a name occurs twice."""
    ((first, count),) = Counter(names).most_common(1)
    if count > 1:
        times, remedy = "twice", "rename or remove one of them"
        if count > 2:
            times, remedy = f"{count} times", "write one header line of different names"
        raise RecordingRefused(
            f"{path}: {what} column {quoted(first)} {times}; {remedy}."
        )


def imported(path, module):
    """Import a module required to read a file; an error tells how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0].replace("_", "-")
        raise ImportError(
            f"{path}: reading it needs {package}: pip install "
            f'"sklearn-vbjfa[{_CONFIG["extras"][package]}]"'
        ) from error


def quoted(value):
    """Return the repr of a value, truncated if long."""
    text = repr(value)
    n_more = len(text) - _MAX_LENGTH
    return f"{text[:_MAX_LENGTH]} and {n_more} characters more" if n_more > 0 else text


def listed(names):
    """Join names with commas, truncated if there are many."""
    names = [x if len(x) <= _MAX_LENGTH else quoted(x) for x in map(str, names)]
    if len(names) > _MAX_ENTRIES:
        names[_MAX_ENTRIES - 1 :] = [f"and {len(names) - _MAX_ENTRIES + 1} more"]
    return ", ".join(names)


# Channels of joints, and the measured channel whose unit a command shares.
KINDS = ("q", "tau", "v", "a")
MEASURED = {"q_desired": "q", "v_desired": "v", "tau_ff": "tau"}
# Units of time that an option accepts, in seconds.
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "days": 86400.0}
# Plausible sample periods of a moving robot [s].
_FASTEST, SLOWEST = 2e-5, 1.0
# Units, words and presets, see ``names.toml``.
_CONFIG = tomllib.loads(
    resources.files("sklearn_vbjfa.recording").joinpath("names.toml").read_text("utf-8")
)


class Unit(NamedTuple):
    """A unit: its base unit and its size in that unit."""

    base: str
    factor: float


_UNITS = {
    kind: {
        spelling: Unit(base, size)
        for base, sizes in bases.items()
        for spellings, size in sizes.items()
        for spelling in spellings.split()
    }
    for kind, bases in _CONFIG["units"].items()
}
# Endings of the units of velocities and accelerations.
_RATES = {"v": ("/s", "/sec", "ps"), "a": ("/s^2", "/s2", "/s²", "/s/s", "ps2")}
EXPECTED = _CONFIG["expected"]
# A name with a last part that may be a unit.
LAST_PART = re.compile(r"(.*?)[_ .]([A-Za-z°µμ%][A-Za-z0-9^/²]*)")
_IN_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^][]*)\]|\(([^()]*)\)|\s/\s*(\S+))")


def unit_of(kind: str, text: str) -> Unit | None:
    """Return the unit of a channel of a kind (q, v, a, tau, t), None if unknown."""
    compact = re.sub(r"[\s*·.⋅]|(?<=N)-(?=m)", "", text.strip())
    kind = MEASURED.get(kind, kind)
    for suffix in _RATES.get(kind, ()):
        if compact.lower().endswith(suffix):
            return unit_of("q", compact[: -len(suffix)])
    units = _UNITS.get(kind, {})
    # Case distinguishes milli from mega and ampere from atto, but not words.
    key = compact.lower() if len(compact) > 2 or compact == "NM" else compact
    return units.get(compact) or units.get(key)


def split_unit(name: str) -> tuple[str, str]:
    """Split a name into the name proper and the unit in brackets at its end, or ""."""
    match = _IN_BRACKETS.fullmatch(name)
    if match is None:
        return name, ""
    unit = next(x for x in match.groups()[1:] if x is not None).strip()
    # In q[1] and pos_[{joint}] the brackets contain the joint, not a unit.
    if not match[1] or unit.isdecimal() or "{" in unit:
        return name, ""
    return match[1], unit


def usual_step(t):
    """Return the median of the positive steps of a clock, 0 if there is none."""
    # Sort first, since rows may be out of order.
    step = np.diff(np.sort(t))
    step = step[step > 0]
    return float(np.median(step)) if step.size else 0.0


def unit_of_steps(step):
    """Return the unit of time for which a step is a plausible period, or ""."""
    units = (x for x, size in TIME_UNITS.items() if _FASTEST < step * size < SLOWEST)
    return next(units, "")


COMMAND_NAMES = {kind: words.split() for kind, words in _CONFIG["commands"].items()}
_KIND_OF = {word: x for x, words in _CONFIG["words"].items() for word in words.split()}
# Minimum similarity of a misspelled word to one of these.
_CUTOFF = 0.85


def kinds_in(name):
    """Return the kinds of channel that words of a name denote, even if misspelled."""
    text = re.sub(r"\{\w+\}", " ", split_unit(name)[0])
    text = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", text)
    words = [x.lower() for x in re.findall(r"[^\W\d_]+", text)]
    close = [difflib.get_close_matches(x, _KIND_OF, 1, _CUTOFF) for x in words]
    return {_KIND_OF[word] for (word,) in filter(None, close)}


def channels_in(name):
    """Return the channels that a name denotes; torque and current are both "tau"."""
    return {"tau" if x in ("torque", "current") else x for x in kinds_in(name)}


def is_current(name):
    """Return whether a name denotes a motor current and not a torque."""
    kinds = kinds_in(name)
    return "current" in kinds and "torque" not in kinds


PRESETS = _CONFIG["presets"]
