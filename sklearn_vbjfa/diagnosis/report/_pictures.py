"""Residuals over time, and over speed and load, as the paths of pictures."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words

WIDTH, HEIGHT = 360, 110
# Residuals beyond this quantile are cut off, or a spike would flatten the rest.
_QUANTILE = 0.998
# A step of this many usual ones, as between recordings, interrupts a line.
_BREAK = 1.5
# Most steps of a time axis.
_TICKS = 5
# Shades of either sign in a map.
_SHADES = 6


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A joint's residual before and after, in a frame of WIDTH by HEIGHT."""

    kind: str  # whether the paths are lines, or envelopes of more points than fit
    # path data
    before: str
    after: str
    # noise floor, one standard deviation to each side: (top, height); empty if unknown
    band: tuple
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
    limit = float(np.quantile(sizes, _QUANTILE)) * 1.05
    if not limit > 0:
        return None
    seconds = np.asarray(curves.get("seconds", np.arange(before.size)), dtype=float)
    x = WIDTH * (seconds - seconds[0]) / (seconds[-1] - seconds[0])
    draw = _line if before.size <= WIDTH else _envelope
    band = ()
    if floor > 0:
        top = HEIGHT / 2 * (1 - min(floor / limit, 1.0))
        band = (top, HEIGHT - 2 * top)
    paths = {}
    for key, values in (("before", before), ("after", after)):
        y = HEIGHT / 2 * (1 - np.clip(values / limit, -1, 1))
        paths[key] = draw(x, np.where(used, y, np.nan))
    kind = "line" if draw is _line else "area"
    return Picture(kind=kind, **paths, band=band, limit=limit)


@dataclass(frozen=True, kw_only=True)
class MapPicture:
    """Two maps, each a frame of WIDTH by HEIGHT; load rises upwards."""

    # for each shade: sign (``"up"`` or ``"down"``), opacity and path data
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
                found.append((name, k / _SHADES, path))
    return tuple(found)


def time_axis(curves):
    """Return the ticks below a picture, (place in per cent, text); () if unknown."""
    seconds = np.asarray(curves.get("seconds", ()), dtype=float)
    if seconds.size < 2:
        return ()
    length = seconds[-1] - seconds[0]
    power = 10.0 ** np.floor(np.log10(length / _TICKS))
    # The finest of 1, 2, 5, 10, ... with no more ticks than there is room for.
    step = next(
        k * power for k in (1, 2, 5, 10) if length / (k * power) <= _TICKS + 1e-9
    )
    ticks = step * np.arange(int(length / step + 1e-9) + 1)
    # The end says the unit; a tick close to it would be overwritten.
    ticks = ticks[ticks < length - 0.75 * step]
    return (
        *((100 * tick / length, words.number(tick, 4)) for tick in ticks),
        (100.0, f"{words.number(length)} s"),
    )


def _line(x, y):
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
            at, up, down = column[run], top[run] - 0.4, bottom[run]
            outline = np.r_[at, at[-1] + 1, at[-1] + 1, at[::-1]]
            edge = np.r_[up, up[-1], down[-1], down[::-1]]
            pieces.append(_path(outline, edge) + "Z")
    return "".join(pieces)


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
