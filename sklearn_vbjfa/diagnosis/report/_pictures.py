"""Pictures of a page as paths: charts with axes."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain._curves import extremes
from sklearn_vbjfa.diagnosis.report import _words as words

WIDTH, HEIGHT = 400, 200
# Most steps of an axis.
_STEPS = 5
# Points of a cloud and of a curve over time.
_CLOUD, _CURVE = 200, 480
# Points of a cloud of which each joint has one.
_FEW = 120
# Values farther than a share of their range beyond these quantiles are cut off, or a
# spike would flatten the rest.
_MOST, _REACH = (0.01, 0.99), 0.5


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

    formula: str  # what it adds to the torque, LaTeX; empty where none is given
    paragraphs: tuple  # in words
    link: str  # address of its page; empty for none


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Charts that belong together."""

    title: str
    charts: tuple  # side by side
    keys: tuple  # class and text of each entry of the legend
    note: str = ""  # what is not in the frame
    about: About | None = None  # what is unfolded below
    anchor: str = ""  # its place on a page; empty for none
    stacked: bool = False  # charts below one another, on one axis


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
    return Figure(
        title=title,
        charts=tuple(charts),
        keys=(
            ("cloud", "rows of the recording"),
            ("spread", "mean ± one standard deviation"),
            ("law", "fitted law"),
        ),
        about=about,
        anchor=anchor,
    )


def torque_figure(
    torques,
    line,
    floor,
    *,
    title,
    y_labels,
    x_label="",
    border="",
    finer=1.0,
    from_zero=True,
):
    """Draw measured and predicted torque over time, and both residuals below."""
    seconds, counts = torques.seconds, torques.counts
    # The declared model on top, or the completed one would hide where they agree.
    values = (torques.measured, torques.after, torques.before)
    kinds = ("measured", "line-after", "line-before")
    left = [
        np.where(counts, finer * (torques.measured - own), np.nan)
        for own in (torques.before, torques.after)
    ]
    x_label = x_label or ("time [s]" if line.in_seconds else "row")
    rows = np.union1d(
        extremes(torques.measured, _CURVE // 2),
        extremes(np.nan_to_num(left[1]), _CURVE // 2),
    )
    x, charts, beyond = _ends(seconds), [], []
    # What the declared model leaves goes behind what the completed one does.
    for own, names, y_label in (
        (values, kinds, y_labels[0]),
        (left, kinds[:0:-1], y_labels[1]),
    ):
        zero = from_zero or own is left
        frame = _Frame(x=x, y=_range(np.concatenate(own), zero))
        beyond.append(_beyond(frame, own))
        shapes = [Shape(kind="held-out", path=_spans(frame, line.held_out))]
        if own is left and floor > 0:
            edges = frame.down([floor, -floor])
            path = f"M0 {edges[0]:.1f}H{WIDTH}V{edges[1]:.1f}H0Z"
            shapes.append(Shape(kind="floor", path=path))
        if zero:
            shapes.append(Shape(kind="zero", path=frame.level(0.0)))
        shapes += [
            Shape(kind=kind, path=_line(frame, seconds[rows], one[rows]))
            for kind, one in zip(names, own)
        ]
        shapes.append(Shape(kind="border", path=_verticals(frame, line.borders)))
        charts.append(_chart(frame, "", x_label, y_label, shapes))
    names = ("measured", "completed model", "declared model")
    keys = list(zip(kinds, names))
    if line.held_out:
        keys.append(("held-out", "held-out part"))
    if floor > 0:
        keys.append(("floor", "noise floor, one standard deviation"))
    if line.borders:
        keys.append(("border", border or "next recording"))
    return Figure(
        title=title,
        charts=tuple(charts),
        keys=tuple(keys),
        note="; ".join(filter(None, beyond)),
        stacked=True,
    )


def friction_figure(curves, *, title, y_label):
    """Draw the friction of a joint over its speed, measured and of both models."""
    before, after = curves.before, curves.after
    frame = _Frame(x=_ends(after.x), y=_range(np.r_[after.without, after.law]))
    x_label = f"speed [{after.unit}]"
    lines = [("mean-after", "completed model", after.center, after.law_mean)]
    if before is not None:
        # The declared model may have too little friction for a curve.
        lines.append(("law", "declared model", before.center, before.law_mean))
    shapes = [
        Shape(kind="zero", path=frame.level(0.0)),
        Shape(kind="zero", path=_verticals(frame, [0.0])),
        Shape(kind="cloud", path=_cloud(frame, after.x, after.without)),
    ]
    # The mean jumps with the sign of the speed.
    shapes += [
        Shape(
            kind=kind,
            path="".join(_line(frame, x[way], y[way]) for way in (x < 0, x > 0)),
        )
        for kind, _, x, y in lines
    ]
    keys = [("cloud", "measured"), *(line[:2] for line in lines)]
    return Figure(
        title=title,
        charts=(_chart(frame, "", x_label, y_label, shapes),),
        keys=tuple(keys),
        note=_beyond(frame, [after.without]),
    )


def residual_figure(curves, *, title, unit):
    """Draw a residual over the predicted torque, and its autocorrelation."""
    x, y = curves.predicted, curves.residual
    frame = _Frame(x=_ends(x), y=_range(y))
    cloud = [
        Shape(kind="zero", path=frame.level(0.0)),
        Shape(kind="cloud", path=_cloud(frame, x, y, _FEW)),
    ]
    charts = [_chart(frame, "", f"predicted [{unit}]", f"residual [{unit}]", cloud)]
    frame = _Frame(x=_ends(curves.lags), y=_range(curves.correlation))
    up, down = frame.down([curves.chance, -curves.chance])
    lines = [
        Shape(kind="floor", path=f"M0 {up:.1f}H{WIDTH}V{down:.1f}H0Z"),
        Shape(kind="zero", path=frame.level(0.0)),
        Shape(kind="mean-after", path=_line(frame, curves.lags, curves.correlation)),
    ]
    charts.append(_chart(frame, "", "lag [s]", "autocorrelation [1]", lines))
    keys = (
        ("cloud", "rows in which the joint moves"),
        ("mean-after", "autocorrelation"),
    )
    keys += (("floor", "white noise, 90 %"),)
    return Figure(title=title, charts=tuple(charts), keys=keys)


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


def _range(values, zero=True):
    """Find the ends of a vertical axis: all but outliers, and zero unless it is not."""
    values = values[np.isfinite(values)]
    low, high = np.quantile(values, _MOST) if values.size else (0.0, 0.0)
    reach = _REACH * (high - low)
    ends = {"initial": 0.0} if zero or not values.size else {}
    low = max(float(low - reach), float(np.min(values, **ends)))
    high = min(float(high + reach), float(np.max(values, **ends)))
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
    if not high > low:
        return -1.0, 1.0
    room = 0.06 * (high - low)
    return low - room, high + room


def _beyond(frame, curves):
    """Say how far what is cut off goes beyond a frame; empty if nothing is."""
    values = np.concatenate([own[np.isfinite(own)] for own in curves])
    ends = np.min(values, initial=0.0), np.max(values, initial=0.0)
    far = [
        words.number(x)
        for x, cut in zip(ends, (ends[0] < frame.y[0], ends[1] > frame.y[1]))
        if cut
    ]
    return f"Cut off: values to {' and '.join(far)}." if far else ""


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


def _cloud(frame, x, y, most=_CLOUD):
    """Dots, as strokes of no length."""
    rows = np.linspace(0, x.size - 1, min(x.size, most)).astype(int)
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
