"""Pictures of a report as inline SVG, coloured by the page that holds them."""

import numpy as np

from sklearn_vbjfa.diagnosis import _report_words as words

_WIDTH, _HEIGHT = 360, 110
# Residuals beyond this quantile are cut off, or a spike would flatten the rest.
_QUANTILE = 0.998
# A step of this many usual ones, as between recordings, interrupts a line.
_BREAK = 1.5
# Most steps of a time axis.
_TICKS = 5


def residual_picture(curves, joint, floor):
    """Draw a joint's residual before and after over the untouched part.

    Parameters
    ----------
    curves : dict of str to ndarray
        ``"before"``, ``"after"``, ``"weight"``, ``"torque"``: arrays (m, nv);
        ``"seconds"``, where it is known: (m,), rising.
    joint : int
        Joint, from zero.
    floor : float
        Noise floor over the standard deviation of the torque; may be nan.

    Returns
    -------
    svg : str
        Picture; empty if there is nothing to draw.
    limit : float
        Torque at its upper edge, the lower one is its negative [N m or N].
    """
    before, after = (
        np.asarray(curves[key], dtype=float)[:, joint] for key in ("before", "after")
    )
    used = np.asarray(curves["weight"], dtype=float)[:, joint] > 0
    used &= np.isfinite(before) & np.isfinite(after)
    if used.sum() < 2:
        return "", np.nan
    sizes = np.abs(np.r_[before[used], after[used]])
    limit = float(np.quantile(sizes, _QUANTILE)) * 1.05
    if not limit > 0:
        return "", np.nan
    torque = np.asarray(curves["torque"], dtype=float)[used, joint]
    band = _band(floor * torque.std(), limit)
    x = _places(curves, before.size)
    grey, colour = (
        _shape(x, np.where(used, values, np.nan), limit, kind)
        for values, kind in ((before, "before"), (after, "after"))
    )
    middle = _HEIGHT / 2
    svg = (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" preserveAspectRatio="none" '
        f'aria-hidden="true">{grey}{band}'
        f'<path class="zero" d="M0 {middle}H{_WIDTH}"/>{colour}</svg>'
    )
    return svg, limit


def _band(half, limit):
    """Noise floor as a band of one standard deviation to each side."""
    if not np.isfinite(half) or half <= 0:
        return ""
    top = _HEIGHT / 2 * (1 - min(half / limit, 1.0))
    height = _HEIGHT - 2 * top
    return (
        f'<rect class="floor" x="0" width="{_WIDTH}" y="{top:.1f}" '
        f'height="{height:.1f}"/>'
    )


def time_axis(curves):
    """Return the seconds below a picture as HTML; empty if they are not known."""
    seconds = np.asarray(curves.get("seconds", ()), dtype=float)
    if seconds.size < 2:
        return ""
    length = seconds[-1] - seconds[0]
    power = 10.0 ** np.floor(np.log10(length / _TICKS))
    # The finest of 1, 2, 5, 10, ... with no more ticks than there is room for.
    step = next(
        k * power for k in (1, 2, 5, 10) if length / (k * power) <= _TICKS + 1e-9
    )
    ticks = step * np.arange(int(length / step + 1e-9) + 1)
    # The end says the unit; a tick close to it would be overwritten.
    ticks = ticks[ticks < length - 0.75 * step]
    places = [(100 * tick / length, words.number(tick, 4)) for tick in ticks]
    places.append((100.0, f"{words.number(length)} s"))
    spans = "".join(
        f'<span style="left:{place:.1f}%">{text}</span>' for place, text in places
    )
    return f'<div class="axis">{spans}</div>'


def _places(curves, count):
    """Horizontal places of the samples, in proportion to time where it is known."""
    seconds = np.asarray(curves.get("seconds", np.arange(count)), dtype=float)
    return _WIDTH * (seconds - seconds[0]) / (seconds[-1] - seconds[0])


def _shape(x, values, limit, kind):
    """Draw a line, or the envelope of one with more points than the picture has."""
    y = _HEIGHT / 2 * (1 - np.clip(values / limit, -1, 1))
    if y.size <= _WIDTH:
        steps = np.diff(x)
        breaks = np.flatnonzero(steps > _BREAK * np.median(steps)) + 1
        runs = zip(np.split(x, breaks), np.split(y, breaks))
        path = "".join(_path(*run) for run in runs)
        return f'<path class="line {kind}" d="{path}"/>'
    label = np.minimum(x.astype(int), _WIDTH - 1)
    starts = np.flatnonzero(np.r_[True, np.diff(label) > 0])
    column = label[starts]
    top = np.fmin.reduceat(y, starts)
    bottom = np.fmax.reduceat(y, starts)
    pieces = []
    seen = np.isfinite(top)
    # Neither where nothing counts nor where nothing was recorded.
    ends = np.flatnonzero((np.diff(seen) != 0) | (np.diff(column) > 1)) + 1
    for run in np.split(np.arange(seen.size), ends):
        if seen[run[0]]:
            at = column[run]
            edge = np.r_[
                top[run] - 0.4, top[run[-1]] - 0.4, bottom[run[-1]], bottom[run[::-1]]
            ]
            outline = np.r_[at, at[-1] + 1, at[-1] + 1, at[::-1]]
            pieces.append(_path(outline, edge) + "Z")
    return f'<path class="area {kind}" d="{"".join(pieces)}"/>'


def _path(x, y):
    """Return path data; points that are nan interrupt the line."""
    out, pen = [], "M"
    for a, b in zip(x, y):
        if np.isfinite(b):
            out.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(out)
