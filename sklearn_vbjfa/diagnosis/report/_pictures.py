"""Figures of a page as SVG paths: charts with axes."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words

WIDTH, HEIGHT = 400, 200
# Maximum number of tick intervals of an axis.
_STEPS = 5
# Values beyond these quantiles by more than a share of their range are clipped: an
# outlier would compress the other values.
_LIMITS, _MARGIN = (0.01, 0.99), 0.5


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Charts with a common title and legend."""

    title: str
    charts: tuple  # each a `Plot`, side by side
    keys: tuple  # style class and text of each legend entry
    note: str = ""  # on clipped values
    stacked: bool = False  # charts below one another, with a common axis


class Plot:
    """A frame with axes and shapes."""

    # x, y: ranges of the axes; labels: quantities with units; shapes: pairs of a style
    # class and path data, from back to front.

    def __init__(self, x, y, x_label, y_label, title=""):
        self.x, self.y, self.shapes = x, y, []
        self.x_label, self.y_label, self.title = x_label, y_label, title

    def across(self, values):
        low, high = self.x
        return WIDTH * (np.asarray(values, dtype=float) - low) / (high - low)

    def down(self, values):
        low, high = self.y
        share = (np.asarray(values, dtype=float) - low) / (high - low)
        return HEIGHT * (1.0 - np.clip(share, -0.02, 1.02))

    def add(self, kind, path):
        """Add a shape, unless there is nothing to draw."""
        if path:
            self.shapes.append((kind, path))

    def zero(self):
        self.add("zero", f"M0 {self.down(0.0):.1f}H{WIDTH}")

    def line(self, kind, x, y):
        out, pen = [], "M"
        for a, b in zip(self.across(x), self.down(y)):
            out += [f"{pen}{a:.1f} {b:.1f}"] if np.isfinite(b) else []
            pen = "L" if np.isfinite(b) else "M"
        self.add(kind, "".join(out))

    def cloud(self, x, y):
        inside = (x >= self.x[0]) & (x <= self.x[1])
        points = zip(self.across(x[inside]), self.down(y[inside]))
        self.add("cloud", "".join(f"M{a:.1f} {b:.1f}h0" for a, b in points))

    def band(self, half):
        up, down = self.down([half, -half])
        self.add("floor", f"M0 {up:.1f}H{WIDTH}V{down:.1f}H0Z")

    def clipping_note(self, curves):
        """Describe the extremes of clipped values; empty without any."""
        values = np.concatenate([curve[np.isfinite(curve)] for curve in curves])
        low, high = np.min(values, initial=0.0), np.max(values, initial=0.0)
        texts = [words.number(low)] if low < self.y[0] else []
        texts += [words.number(high)] if high > self.y[1] else []
        return f"Cut off: values to {' and '.join(texts)}." if texts else ""


def torques(outcome, curves):
    """Draw measured and predicted torque over time, and both residuals below."""
    joint, seconds = outcome.errors[curves.joint], curves.seconds
    floor = joint.floor * joint.spread
    # The prediction of the declared model is drawn last, to show where both agree; its
    # residual is drawn first.
    lines = (curves.measured, curves.after, curves.before)
    upper = dict(zip(("measured", "line-after", "line-before"), lines))
    lower = {
        kind: np.where(curves.counts, curves.measured - upper[kind], np.nan)
        for kind in ("line-before", "line-after")
    }
    quantity, charts, notes = "force" if joint.unit == "N" else "torque", [], []
    time = "held-out time, its stretches joined [s]"
    for name, lines in ((quantity, upper), ("residual", lower)):
        values, label = list(lines.values()), f"{name} [{joint.unit}]"
        plot = Plot(ends_of(seconds), range_of(np.concatenate(values)), time, label)
        if lines is lower and floor > 0:
            plot.band(floor)
        plot.zero()
        for kind, y in lines.items():
            plot.line(kind, seconds, y)
        notes.append(plot.clipping_note(values))
        charts.append(plot)
    keys = list(zip(upper, ("measured", "completed model", "declared model")))
    if floor > 0:
        keys.append(("floor", "noise floor, one standard deviation"))
    return Figure(
        title=words.joint_label(outcome.robot["joints"], curves.joint),
        charts=tuple(charts),
        keys=tuple(keys),
        note="; ".join(filter(None, notes)),
        stacked=True,
    )


def residuals(outcome, curves):
    """Draw the residual over the predicted torque, and its autocorrelation."""
    unit = outcome.errors[curves.joint].unit
    x, y = curves.predicted, curves.residual
    cloud = Plot(ends_of(x), range_of(y), f"predicted [{unit}]", f"residual [{unit}]")
    cloud.zero()
    cloud.cloud(x, y)
    x, y = curves.lags, curves.correlation
    lags = Plot(ends_of(x), range_of(y), "lag [s]", "autocorrelation [1]")
    lags.band(curves.chance)
    lags.zero()
    lags.line("mean-after", x, y)
    return Figure(
        title=words.joint_label(outcome.robot["joints"], curves.joint),
        charts=(cloud, lags),
        keys=(
            ("cloud", "rows in which the joint moves"),
            ("mean-after", "autocorrelation"),
            ("floor", "white noise, 90 %"),
        ),
    )


def ticks(low, high):
    """Return round values between two limits with their labels, a tuple of pairs."""
    power = 10.0 ** np.floor(np.log10((high - low) / _STEPS))
    steps = (k * power for k in (1, 2, 5, 10))
    step = next(step for step in steps if (high - low) / step <= _STEPS + 1e-9)
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    # Adding zero removes the sign of a negative zero.
    values = (step * np.arange(first, last + 1) + 0.0).tolist()
    return tuple((value, words.number(value, 4)) for value in values)


def ends_of(values):
    low, high = float(np.min(values)), float(np.max(values))
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def range_of(values):
    """Return the limits of a vertical axis: all values but outliers, and zero."""
    values = values[np.isfinite(values)]
    low, high = np.quantile(values, _LIMITS) if values.size else (0.0, 0.0)
    excess = _MARGIN * (high - low)
    low = min(max(float(low - excess), float(np.min(values, initial=0.0))), 0.0)
    high = max(min(float(high + excess), float(np.max(values, initial=0.0))), 0.0)
    if not high > low:
        return -1.0, 1.0
    margin = 0.06 * (high - low)
    return low - margin, high + margin
