"""Pictures of a page as paths: charts with axes, residuals over time, and maps.

A picture is a frame that a page stretches to the room there is; texts stand beside it.
The numbers of a chart go along in 16 bits each, for the library that zooms: from them a
picture that is zoomed is drawn, exported or written as a table.
"""

import base64
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain._drawn import extremes
from sklearn_vbjfa.diagnosis.report import _words as words

WIDTH, HEIGHT = 400, 200
# Most steps of an axis.
_STEPS = 5
# Points of a static cloud and of a static curve over time; all are in the data.
_CLOUD, _CURVE = 500, 600
# Values beyond these quantiles are cut off, or a spike would flatten the rest.
_ENDS = (0.002, 0.998)
# A step of this many usual ones, as between recordings, interrupts a residual.
_BREAK = 1.5
# Shades of either sign in a map.
_SHADES = 6
# Largest 16-bit number; the smallest stands for nothing.
_FULL = 32767


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Something drawn: its class in the style sheet, and path data."""

    kind: str
    path: str
    opacity: float | None = None  # None for that of the style sheet


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
            Shape(kind="zero", path=frame.level(0.0)),
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
        Shape(kind="zero", path=frame.level(0.0)),
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
    chart = _chart(frame, "", x_label, y_label, shapes)
    return Figure(title=title, charts=(chart,), data=data, keys=tuple(keys))


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
        Shape(kind="zero", path=frame.level(0.0)),
        Shape(kind="limit", path="".join(map(frame.level, near))),
        Shape(kind="line-after", path=_line(frame, seconds[rows], values[rows])),
    ]
    series = [(title, "line-after", values)]
    series += [("limit", "limit", np.full(values.size, x)) for x in near]
    keys = [("limit", "limit")] if near else []
    if far:
        told = " and ".join(words.number(x) for x in far)
        keys.append(("limit", f"beyond the picture: {told}"))
    chart = _chart(frame, "", x_label, y_label, shapes)
    data = _data(title, x_label, y_label, seconds, series)
    return Figure(title=title, charts=(chart,), data=data, keys=tuple(keys))


def _chart(frame, title, x_label, y_label, shapes):
    return Chart(
        title=title,
        x_label=x_label,
        y_label=y_label,
        x_ticks=frame.x_ticks(),
        y_ticks=frame.y_ticks(),
        shapes=tuple(shape for shape in shapes if shape.path),
    )


# -- residuals --------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A joint's residual before and after, in a frame."""

    shapes: tuple  # from the back to the front
    limit: float  # torque at the upper edge, the lower one is its negative [N m or N]


def residual_picture(curves, joint, floor):
    """Draw a joint's residual before and after over the untouched part, if any."""
    # curves: "before", "after", "weight" (m, nv), and "seconds" (m,), rising, where it
    # is known; floor [N m or N] may be nan.
    before, after, weight = (
        np.asarray(curves[key], dtype=float)[:, joint]
        for key in ("before", "after", "weight")
    )
    used = (weight > 0) & np.isfinite(before) & np.isfinite(after)
    if used.sum() < 2:
        return None
    sizes = np.abs(np.r_[before[used], after[used]])
    limit = float(np.quantile(sizes, _ENDS[1])) * 1.05
    if not limit > 0:
        return None
    seconds = np.asarray(curves.get("seconds", np.arange(before.size)), dtype=float)
    frame = _Frame(x=(seconds[0], seconds[-1]), y=(-limit, limit))
    draw, look = (_pieces, "line") if before.size <= WIDTH else (_envelope, "area")
    x = frame.across(seconds)
    before, after = (
        Shape(kind=f"{look} {name}", path=draw(x, np.where(used, y, np.nan)))
        for name, values in (("before", before), ("after", after))
        for y in [frame.down(np.clip(values, -limit, limit))]
    )
    zero = Shape(kind="zero", path=frame.level(0.0))
    if not floor > 0:
        return Picture(shapes=(before, zero, after), limit=limit)
    # one standard deviation to each side
    top, bottom = frame.down([min(floor, limit), -min(floor, limit)])
    path = f"M0 {top:.1f}H{WIDTH}V{bottom:.1f}H0Z"
    shapes = (before, Shape(kind="floor", path=path), zero, after)
    return Picture(shapes=shapes, limit=limit)


def time_axis(curves):
    """Return the ticks below a residual, (place in per cent, text); () if unknown."""
    seconds = np.asarray(curves.get("seconds", ()), dtype=float)
    if seconds.size < 2:
        return ()
    length = seconds[-1] - seconds[0]
    # The end says the unit; a tick close to it would be overwritten.
    last = length - 0.75 * _step(length)
    return (
        *((100 * at / length, text) for at, text in ticks(0.0, length) if at < last),
        (100.0, f"{words.number(length)} s"),
    )


def _pieces(x, y):
    """Path of a line, interrupted where much time passes between two samples."""
    steps = np.diff(x)
    breaks = np.flatnonzero(steps > _BREAK * np.median(steps)) + 1
    return "".join(map(_path, np.split(x, breaks), np.split(y, breaks)))


def _envelope(x, y):
    """Outline of a line with more points than the picture has columns."""
    label = np.minimum(x.astype(int), WIDTH - 1)
    starts = np.flatnonzero(np.r_[True, np.diff(label) > 0])
    column = label[starts]
    top = np.fmin.reduceat(y, starts)
    bottom = np.fmax.reduceat(y, starts)
    seen = np.isfinite(top)
    # Neither where nothing counts nor where nothing was recorded.
    ends = np.flatnonzero((np.diff(seen) != 0) | (np.diff(column) > 1)) + 1
    pieces = []
    for run in np.split(np.arange(seen.size), ends):
        if seen[run[0]]:
            at, up, down = column[run], top[run] - 0.7, bottom[run]
            outline = np.r_[at, at[-1] + 1, at[-1] + 1, at[::-1]]
            edge = np.r_[up, up[-1], down[-1], down[::-1]]
            pieces.append(_path(outline, edge) + "Z")
    return "".join(pieces)


# -- maps -------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class MapPicture:
    """Two maps, each in a frame; load rises upwards."""

    # of each shade: "up" or "down"
    measured: tuple
    function: tuple
    limit: float  # torque that has the full colour [N m or N]


def map_picture(drawn):
    """Draw a residual over speed and load beside the function that explains it."""
    sizes = np.abs(drawn.measured[np.isfinite(drawn.measured)])
    # A few cells with little in them would leave the others pale.
    limit = float(np.quantile(sizes, 0.95)) if sizes.size else 0.0
    limit = limit if limit > 0 else 1.0
    return MapPicture(
        measured=_shades(drawn.measured / limit),
        function=_shades(drawn.function / limit),
        limit=limit,
    )


def _shades(values):
    """Cells of like values (n_loads, n_speeds) as one path for each shade."""
    height, width = HEIGHT / values.shape[0], WIDTH / values.shape[1]
    shade = np.ceil(np.clip(np.abs(values), 0, 1) * _SHADES)
    found = []
    for name, sign in (("up", 1), ("down", -1)):
        for k in range(1, _SHADES + 1):
            cells = np.argwhere((shade == k) & (np.sign(values) == sign))
            path = "".join(
                f"M{column * width:.1f} {HEIGHT - (row + 1) * height:.1f}"
                f"h{width:.1f}v{height:.1f}h-{width:.1f}z"
                for row, column in cells
            )
            if path:
                found.append(Shape(kind=name, path=path, opacity=k / _SHADES))
    return tuple(found)


# -- axes -------------------------------------------------------------------------


def ticks(low, high):
    """Return round values between two ends with their texts, a tuple of pairs."""
    step = _step(high - low)
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    # without the sign of a zero
    values = (step * np.arange(first, last + 1) + 0.0).tolist()
    return tuple((value, words.number(value, 4)) for value in values)


def _step(length):
    """Return the finest of 1, 2, 5, 10, ... with no more steps than there is room."""
    power = 10.0 ** np.floor(np.log10(length / _STEPS))
    steps = (k * power for k in (1, 2, 5, 10))
    return next(step for step in steps if length / step <= _STEPS + 1e-9)


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
    return _path(frame.across(x), frame.down(y))


def _path(x, y):
    """Path data; points that are nan interrupt the line."""
    out, pen = [], "M"
    for a, b in zip(x, y):
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
