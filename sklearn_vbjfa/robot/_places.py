"""Values in a JSON file that know their place, so that what is wrong can be named."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sklearn_vbjfa.recording import quoted

# What JSON has no number for.
_SPELLED = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
# Width of a line that a list or an object of plain values stays on.
_WIDTH = 240


@dataclass(frozen=True, kw_only=True)
class Place:
    """A value in a file."""

    path: str
    at: str  # where the value is, such as ``parameters[3].value``
    value: object  # what the JSON holds

    def wrong(self, what):
        """Return the error that says what is wrong with the value."""
        where = f"key {self.at!r} " if self.at else "it "
        return ValueError(f"{self.path!r}: {where}{what}.")

    def __getitem__(self, key):
        """Return the value of a key of an object, a `Place`."""
        if not isinstance(self.value, dict):
            raise self.wrong("must hold an object")
        at = f"{self.at}.{key}" if self.at else key
        if key not in self.value:
            raise Place(path=self.path, at=at, value=None).wrong("is missing")
        return Place(path=self.path, at=at, value=self.value[key])

    @property
    def absent(self):
        """Whether it is null."""
        return self.value is None

    def items(self, n=None):
        """Return the values of a list, of n values where that is given."""
        if not isinstance(self.value, list):
            raise self.wrong("must hold a list")
        if n is not None and len(self.value) != n:
            raise self.wrong(f"must hold {n} values, not {len(self.value)}")
        return [
            Place(path=self.path, at=f"{self.at}[{k}]", value=value)
            for k, value in enumerate(self.value)
        ]

    def keys(self):
        """Return the keys of an object, a list of str."""
        if not isinstance(self.value, dict):
            raise self.wrong("must hold an object")
        return list(self.value)

    def number(self, *, finite=False):
        """Return a float; "nan", "inf" and "-inf" stand for what they say."""
        value = self.value
        if isinstance(value, str):
            value = _SPELLED.get(value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.wrong(f"must hold a number, not {quoted(self.value)}")
        try:
            value = float(value)
        except OverflowError:
            raise self.wrong("holds a number that is too large") from None
        if finite and not math.isfinite(value):
            raise self.wrong(f"must hold a finite number, not {quoted(self.value)}")
        return value

    def numbers(self, n=None, *, finite=False):
        """Return the numbers of a list, ndarray."""
        return np.array([one.number(finite=finite) for one in self.items(n)], float)

    def text(self):
        """Return a str."""
        if not isinstance(self.value, str):
            raise self.wrong(f"must hold a text, not {quoted(self.value)}")
        return self.value

    def texts(self, n=None):
        """Return the texts of a list, a tuple of str."""
        return tuple(one.text() for one in self.items(n))

    def one_of(self, known):
        """Return a text that is one of several."""
        if self.text() not in known:
            raise self.wrong(
                f"must be one of {', '.join(known)}; it is {quoted(self.value)}"
            )
        return self.value

    def truth(self):
        """Return a bool."""
        if not isinstance(self.value, bool):
            raise self.wrong(f"must hold true or false, not {quoted(self.value)}")
        return self.value


def read_place(path):
    """Read a JSON file, a `Place`; ValueError if it is not JSON."""
    name = str(path)
    try:
        text = Path(path).read_text(encoding="utf-8")
        return Place(
            path=name, at="", value=json.loads(text, parse_constant=_no_number)
        )
    except FileNotFoundError:
        raise FileNotFoundError(f"There is no file {name!r}.") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name!r} is not JSON: {error}.") from error


def _no_number(name):
    raise ValueError(f"it holds {name} for a number, JSON has none of that name")


def spelled(value):
    """Return a float as JSON can hold it: those that are no number as texts."""
    value = float(value)
    if math.isnan(value):
        return "nan"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def spelled_all(values):
    """Return the numbers of an array as nested lists that JSON can hold."""
    if np.ndim(values) == 0:
        return spelled(values)
    return [spelled_all(value) for value in values]


def readable(value, indent=0):
    """Write JSON with one line for each list or object of plain values."""
    # Floats are written so that the same ones are read.
    if not isinstance(value, (dict, list)) or not value:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    inner = value.values() if isinstance(value, dict) else value
    if not any(isinstance(one, (dict, list)) for one in inner):
        line = json.dumps(value, ensure_ascii=False, allow_nan=False)
        if len(line) <= _WIDTH:
            return line
    pad = " " * (indent + 1)
    if isinstance(value, dict):
        lines = [
            f"{json.dumps(key, ensure_ascii=False)}: {readable(one, indent + 1)}"
            for key, one in value.items()
        ]
        ends = "{}"
    else:
        lines, ends = [readable(one, indent + 1) for one in value], "[]"
    body = f",\n{pad}".join(lines)
    return f"{ends[0]}\n{pad}{body}\n{' ' * indent}{ends[1]}"
