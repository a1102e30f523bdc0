"""Capsules around shapes: lower bounds of distances, for many pairs at once.

The distance of two capsules is that of two line segments less two radii. Links are long
and thin, which a capsule follows and a sphere does not.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a line segment."""

    ends: np.ndarray  # (2, 3) [m]
    radius: float  # [m]

    @property
    def volume(self):
        """Volume [m^3]."""
        length = np.linalg.norm(self.ends[1] - self.ends[0])
        return np.pi * self.radius**2 * (length + 4 / 3 * self.radius)


def capsule_around(points, swept=0.0):
    """Return a small capsule that holds balls of radius `swept` about points (n, 3)."""
    # Of capsules along the coordinates and along the principal axes, that of least
    # volume.
    centred = points - points.mean(axis=0)
    principal = np.linalg.eigh(centred.T @ centred)[1]
    along = [_along(axis, points) for axis in (*np.eye(3), *principal.T)]
    best = min(along, key=lambda capsule: capsule.volume)
    return Capsule(best.ends, best.radius + swept)


def _along(axis, points):
    """Return the capsule around points whose segment has a given direction."""
    place = points @ axis
    aside = points - np.outer(place, axis)
    centre = (aside.min(axis=0) + aside.max(axis=0)) / 2
    # The box need not be square to the axis; the centre has to be.
    centre -= (centre @ axis) * axis
    away = np.linalg.norm(aside - centre, axis=1)
    radius = away.max()
    # The round ends reach beyond the segment by what the radius leaves.
    beyond = np.sqrt(np.maximum(radius**2 - away**2, 0.0))
    first, last = (place + beyond).min(), (place - beyond).max()
    if first > last:
        first = last = (first + last) / 2
    return Capsule(centre + np.outer([first, last], axis), float(radius))


def segment_distances(first, second):
    """Return the distances (...) between line segments (..., 2, 3), or points."""
    # Ericson, Real-Time Collision Detection, Morgan Kaufmann 2005, section 5.1.9.
    tiny = np.finfo(float).tiny
    u = first[..., 1, :] - first[..., 0, :]
    v = second[..., 1, :] - second[..., 0, :]
    apart = first[..., 0, :] - second[..., 0, :]
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    ua, va = _dot(u, apart), _dot(v, apart)
    # The nearest points of the two lines, then each held on its segment in turn.
    across = np.maximum(uu * vv - uv**2, tiny)
    s = np.clip((uv * va - ua * vv) / across, 0.0, 1.0)
    t = np.clip((uv * s + va) / np.maximum(vv, tiny), 0.0, 1.0)
    s = np.clip((uv * t - ua) / np.maximum(uu, tiny), 0.0, 1.0)
    gap = apart + s[..., None] * u - t[..., None] * v
    return np.sqrt(_dot(gap, gap))


def _dot(x, y):
    return np.einsum("...i,...i->...", x, y)
