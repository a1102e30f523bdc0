"""Pictures of a report as inline SVG, coloured by the page that holds them."""

import numpy as np

_WIDTH, _HEIGHT = 360, 110
# Residuals beyond this quantile are cut off, or a spike would flatten the rest.
_QUANTILE = 0.998


def residual_picture(curves, joint, floor):
    """Draw a joint's residual before and after over the untouched part.

    Parameters
    ----------
    curves : dict of str to ndarray
        ``"before"``, ``"after"``, ``"weight"``, ``"torque"``: arrays (m, nv).
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
    grey, colour = (
        _shape(np.where(used, values, np.nan), limit, kind)
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


def _shape(values, limit, kind):
    """Draw a line, or the envelope of one with more points than the picture has."""
    y = _HEIGHT / 2 * (1 - np.clip(values / limit, -1, 1))
    if y.size <= _WIDTH:
        x = np.linspace(0, _WIDTH, y.size)
        return f'<path class="line {kind}" d="{_path(x, y)}"/>'
    label = np.arange(y.size) * _WIDTH // y.size
    starts = np.flatnonzero(np.r_[True, np.diff(label) > 0])
    top = np.fmin.reduceat(y, starts)
    bottom = np.fmax.reduceat(y, starts)
    pieces = []
    seen = np.isfinite(top)
    for run in np.split(np.arange(seen.size), np.flatnonzero(np.diff(seen)) + 1):
        if seen[run[0]]:
            x = np.r_[run, run[-1] + 1, run[-1] + 1, run[::-1]]
            edge = np.r_[
                top[run] - 0.4, top[run[-1]] - 0.4, bottom[run[-1]], bottom[run[::-1]]
            ]
            pieces.append(_path(x, edge) + "Z")
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
