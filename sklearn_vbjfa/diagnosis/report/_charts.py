"""Charts with axes: paths for a page, and packed numbers for the library that zooms.

A chart is a frame of WIDTH by HEIGHT that a page stretches to the room there is; texts
stand beside it. Its numbers go along in 16 bits each, from which a picture that is
zoomed is drawn, exported or written as a table.
"""

import base64
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain import extremes
from sklearn_vbjfa.diagnosis.report import _words as words

WIDTH, HEIGHT = 400, 200
# Most steps of an axis.
_STEPS = 5
# Points of a static cloud and of a static curve over time; all are in the data.
_CLOUD, _CURVE = 500, 600
# Values beyond these quantiles are cut off, or a spike would flatten the rest.
_ENDS = (0.002, 0.998)
# Largest 16-bit number; the smallest stands for nothing.
_FULL = 32767


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Something drawn: its class in the style sheet, and path data."""

    kind: str
    path: str


@dataclass(frozen=True, kw_only=True)
class Chart:
    """A frame with axes."""

    title: str
    # what the axes show, with units
    x_label: str
    y_label: str
    # place in per cent from the left or the top, and text
    x_ticks: tuple
    y_ticks: tuple
    shapes: tuple  # from the back to the front


@dataclass(frozen=True, kw_only=True)
class About:
    """What an effect is."""

    formula: str  # what it adds to the torque, as MathML; empty where none is given
    paragraphs: tuple  # in words
    link: str  # address of its page; empty for none


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Charts that belong together, with the numbers behind them."""

    title: str
    charts: tuple  # side by side
    data: dict  # for the library: names, kinds and packed values of the series
    keys: tuple  # class and text of each entry of the legend
    about: About | None = None  # what is unfolded below
    anchor: str = ""  # its place on a page; empty for none


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """Ranges of both axes, and where values lie in the frame."""

    x: tuple
    y: tuple

    def across(self, values):
        low, high = self.x
        return WIDTH * (np.asarray(values, dtype=float) - low) / (high - low)

    def down(self, values):
        low, high = self.y
        share = (np.asarray(values, dtype=float) - low) / (high - low)
        return HEIGHT * (1.0 - np.clip(share, -0.02, 1.02))

    def level(self, value):
        """Path of a horizontal line."""
        return f"M0 {self.down(value):.1f}H{WIDTH}"

    def x_ticks(self):
        return tuple(
            (100 * (value - self.x[0]) / (self.x[1] - self.x[0]), text)
            for value, text in ticks(*self.x)
        )

    def y_ticks(self):
        return tuple(
            (100 * (self.y[1] - value) / (self.y[1] - self.y[0]), text)
            for value, text in ticks(*self.y)
        )


# -- the figures ------------------------------------------------------------------


def effect_figure(curves, *, title, x_label, y_label, about=None, anchor=""):
    """Draw what a model leaves without and with an effect, over the effect's signal."""
    # Two charts on the same axes; anchor: its place on a page, empty for none.
    values = np.r_[curves.without, curves.after, curves.law_mean]
    frame = _Frame(x=_ends(curves.center), y=_range(values))
    way = ", in the direction of motion" if curves.with_motion else ""
    pairs = (
        (f"without the effect{way}", curves.without, "mean-before"),
        (f"with it{way}", curves.after, "mean-after"),
    )
    charts = []
    for k, (name, points, kind) in enumerate(pairs):
        mean, half = curves.mean[k], curves.deviation[k]
        shapes = [
            Shape(kind="zero", path=_zero(frame)),
            Shape(kind="cloud", path=_cloud(frame, curves.x, points)),
            Shape(kind="spread", path=_band(frame, curves.center, mean, half)),
            Shape(kind=kind, path=_line(frame, curves.center, mean)),
        ]
        if k == 0:
            law = _line(frame, curves.center, curves.law_mean)
            shapes.append(Shape(kind="law", path=law))
        charts.append(_chart(frame, name, x_label, y_label, shapes))
    series = (
        ("without: rows", "cloud before", curves.without),
        ("with: rows", "cloud after", curves.after),
        ("without: mean", "mean-before", _at(curves, curves.mean[0])),
        ("with: mean", "mean-after", _at(curves, curves.mean[1])),
        ("fitted law", "law", _at(curves, curves.law_mean)),
    )
    return Figure(
        title=title,
        charts=tuple(charts),
        data=_data(title, x_label, y_label, curves.x, series),
        keys=(
            ("cloud", "rows of the recording"),
            ("spread", "mean ± one standard deviation"),
            ("law", "fitted law"),
        ),
        about=about,
        anchor=anchor,
    )


def torque_figure(torques, line, *, title, y_label):
    """Draw measured and predicted torque over time."""
    seconds = torques.seconds
    # The declared model on top, or the completed one would hide where they agree.
    values = (torques.measured, torques.after, torques.before)
    frame = _Frame(x=_ends(seconds), y=_range(np.concatenate(values)))
    x_label = "time [s]" if line.in_seconds else "row"
    rows = extremes(torques.measured, _CURVE)
    kinds = ("measured", "line-after", "line-before")
    shapes = [
        Shape(kind="untouched", path=_spans(frame, line.untouched)),
        Shape(kind="zero", path=_zero(frame)),
    ]
    shapes += [
        Shape(kind=kind, path=_line(frame, seconds[rows], own[rows]))
        for kind, own in zip(kinds, values)
    ]
    shapes.append(Shape(kind="border", path=_verticals(frame, line.borders)))
    names = ("measured", "completed model", "declared model")
    data = _data(title, x_label, y_label, seconds, tuple(zip(names, kinds, values)))
    data["spans"] = [list(map(_short, span)) for span in line.untouched]
    data["borders"] = [_short(x) for x in line.borders]
    keys = [*zip(kinds, names), ("untouched", "untouched part")]
    if line.borders:
        keys.append(("border", "next recording"))
    return Figure(
        title=title,
        charts=(_chart(frame, "", x_label, y_label, shapes),),
        data=data,
        keys=tuple(keys),
    )


def line_figure(seconds, values, *, title, y_label, levels=()):
    """Draw one signal (n,) over time [s] between levels that it keeps to."""
    # Levels that would leave the signal less than a quarter of the height are not
    # drawn, but said.
    low, high = float(values.min()), float(values.max())
    size = max(high - low, max(abs(low), abs(high))) or 1.0
    near = [x for x in levels if low - 3 * size <= x <= high + 3 * size]
    far = [x for x in levels if x not in near]
    ends = min(low, 0.0, *near), max(high, 0.0, *near)
    room = 0.06 * (ends[1] - ends[0]) or 1.0
    frame = _Frame(x=_ends(seconds), y=(ends[0] - room, ends[1] + room))
    x_label = "time [s]"
    rows = extremes(values, _CURVE)
    shapes = [
        Shape(kind="zero", path=_zero(frame)),
        Shape(kind="limit", path="".join(map(frame.level, near))),
        Shape(kind="line-after", path=_line(frame, seconds[rows], values[rows])),
    ]
    series = [(title, "line-after", values)]
    series += [("limit", "limit", np.full(values.size, x)) for x in near]
    keys = [("limit", "limit")] if near else []
    if far:
        told = " and ".join(words.number(x) for x in far)
        keys.append(("limit", f"beyond the picture: {told}"))
    return Figure(
        title=title,
        charts=(_chart(frame, "", x_label, y_label, shapes),),
        data=_data(title, x_label, y_label, seconds, series),
        keys=tuple(keys),
    )


def _chart(frame, title, x_label, y_label, shapes):
    return Chart(
        title=title,
        x_label=x_label,
        y_label=y_label,
        x_ticks=frame.x_ticks(),
        y_ticks=frame.y_ticks(),
        shapes=tuple(shape for shape in shapes if shape.path),
    )


# -- axes -------------------------------------------------------------------------


def ticks(low, high):
    """Return round values between two ends with their texts, a tuple of pairs."""
    power = 10.0 ** np.floor(np.log10((high - low) / _STEPS))
    step = next(
        k * power for k in (1, 2, 5, 10) if (high - low) / (k * power) <= _STEPS + 1e-9
    )
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    values = step * np.arange(first, last + 1)
    return tuple((float(v), words.number(float(v) + 0.0, 4)) for v in values)


def _ends(values):
    low, high = float(np.min(values)), float(np.max(values))
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _range(values):
    """Find the ends of a vertical axis: all but the farthest values, and zero."""
    values = values[np.isfinite(values)]
    low, high = np.quantile(values, _ENDS) if values.size else (0.0, 0.0)
    low, high = min(float(low), 0.0), max(float(high), 0.0)
    if not high > low:
        return -1.0, 1.0
    room = 0.06 * (high - low)
    return low - room, high + room


# -- paths ------------------------------------------------------------------------


def _line(frame, x, y):
    """Path of a line; it is interrupted where a value is nan."""
    out, pen = [], "M"
    for a, b in zip(frame.across(x), frame.down(y)):
        if np.isfinite(b):
            out.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(out)


def _cloud(frame, x, y):
    """Dots, as strokes of no length."""
    rows = np.linspace(0, x.size - 1, min(x.size, _CLOUD)).astype(int)
    inside = (x[rows] >= frame.x[0]) & (x[rows] <= frame.x[1])
    places = zip(frame.across(x[rows][inside]), frame.down(y[rows][inside]))
    return "".join(f"M{a:.1f} {b:.1f}h0" for a, b in places)


def _band(frame, x, mean, half):
    """Outline of a band."""
    up = [f"{a:.1f} {b:.1f}" for a, b in zip(frame.across(x), frame.down(mean + half))]
    low = zip(frame.across(x), frame.down(mean - half))
    down = [f"{a:.1f} {b:.1f}" for a, b in low]
    return f"M{'L'.join([*up, *down[::-1]])}Z"


def _zero(frame):
    return frame.level(0.0)


def _spans(frame, spans):
    """Rectangles over the whole height."""
    return "".join(
        f"M{a:.1f} 0H{b:.1f}V{HEIGHT}H{a:.1f}Z"
        for a, b in (frame.across(np.clip(span, *frame.x)) for span in spans)
    )


def _verticals(frame, places):
    return "".join(f"M{a:.1f} 0V{HEIGHT}" for a in frame.across(list(places)))


# -- numbers ----------------------------------------------------------------------


def _at(curves, values):
    """Means of the bins at the points of the cloud, a straight line between them."""
    return np.interp(curves.x, curves.center, values, left=np.nan, right=np.nan)


def _data(title, x_label, y_label, x, series):
    """Numbers of a figure as JSON has them."""
    return {
        "title": title,
        "xLabel": x_label,
        "yLabel": y_label,
        "x": base64.b64encode(np.asarray(x, dtype="<f4").tobytes()).decode("ascii"),
        "series": [
            {"name": name, "kind": kind, **packed(values)}
            for name, kind, values in series
        ],
    }


def packed(values):
    """Pack values (n,) into 16 bits each: their scale, and the numbers in base 64."""
    values = np.asarray(values, dtype=float)
    finite = np.isfinite(values)
    scale = float(np.max(np.abs(values), where=finite, initial=0.0)) / _FULL or 1.0
    whole = np.where(
        finite, np.round(np.where(finite, values, 0.0) / scale), -_FULL - 1
    )
    return {
        "scale": scale,
        "y": base64.b64encode(whole.astype("<i2").tobytes()).decode("ascii"),
    }


def _short(value):
    return float(f"{value:.6g}")
