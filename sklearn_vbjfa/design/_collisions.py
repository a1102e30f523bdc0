"""How near the links of a robot come to each other, with gradients.

The gradient of a distance follows from the points where two shapes are nearest and from
the normal between them: shapes move rigidly, and to first order the points may be held
on them. That fails only where the nearest points jump, as between parallel faces.
Balls around the shapes give lower bounds for many pairs at once.
"""

import os
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sklearn_vbjfa.model import (
    JointPoses,
    NoShapes,
    import_coal,
    load_model,
    load_shapes,
    position_range,
)

# Random positions that tell which pairs touch wherever the robot is.
_SAMPLES = 200
# Shapes touch if they are nearer than this share of the links' thickness, by which the
# faces of shapes drawn flush miss each other.
_FLUSH = 0.01
# Duality gap [m^2] at which the nearest points are taken as found. With coal's default,
# normals of round shapes are wrong by its root. Of penetrating cylinders the default
# stays: the search there breaks down where it is made finer.
_GAP = 1e-10
# Distances that are found at once in the search for the smallest.
_BATCH = 256


@dataclass(frozen=True)
class Distances:
    """Signed distances of pairs of shapes in the rows of a motion."""

    # (n, n_pairs): minus the depth of penetration [m]; a lower bound if far apart
    distance: np.ndarray
    # (n, n_pairs, nv): by the positions [m/rad, m/m]; zero for pairs far apart
    gradient: np.ndarray
    exact: np.ndarray  # (n, n_pairs): false where pairs are far apart


@dataclass(frozen=True)
class Approach:
    """Two links near each other in one row of a motion."""

    row: int
    first: str
    second: str
    distance: float  # signed [m]

    @property
    def depth(self):
        """How deep one is in the other [m], 0 where they are apart."""
        return max(0.0, -self.distance)


class Clearance:
    """Distances between the links of a robot that may meet."""

    # Links next to each other, or fixed together, are not looked at, nor are shapes
    # that overlap in most positions (or are nearer than `margin` [m], which will be
    # kept): that is how they were drawn. Meshes stand for their convex hulls; what
    # stands around the robot is not known. pairs, ignored: links that are looked at
    # (once for each two shapes), and those that overlap; near: distance [m] up to which
    # distances are exact by default, the thickness of a typical link, which is how far
    # ahead a motion has to turn aside; at_once: pairs times rows in memory.

    at_once = 200_000

    def __init__(self, model, shapes, margin=0.0):
        self._coal = import_coal()
        self._poses = JointPoses(model)
        self._shapes = shapes.shapes
        self._bodies = np.array([shape.joint for shape in self._shapes])
        self._axes = np.array([shape.axes for shape in self._shapes])
        self._origins = np.array([shape.origin for shape in self._shapes])
        boxes = [shape.geometry.aabb_local for shape in self._shapes]
        ends = np.array([[box.min_, box.max_] for box in boxes]).reshape(-1, 2, 3)
        halves = 0.5 * (ends[:, 1] - ends[:, 0])
        middles = np.einsum("nij,nj->ni", self._axes, ends.mean(axis=1))
        self._centres = middles + self._origins
        self._radii = np.linalg.norm(halves, axis=1)
        self.near = float(np.median(halves.min(axis=1)))
        candidates = [
            (i, j)
            for i, j in combinations(range(len(self._shapes)), 2)
            if self._bodies[i] != self._bodies[j] and not shapes.neighbours[i, j]
        ]
        self._look_at(candidates)
        share = self._share_within(model, max(margin, _FLUSH * self.near))
        self.ignored = tuple(
            dict.fromkeys(pair for pair, often in zip(self.pairs, share) if often > 0.5)
        )
        self._look_at([x for x, often in zip(candidates, share) if often <= 0.5])

    @classmethod
    def of(cls, robot, *, model=None, package_dirs=(), margin=0.0):
        """Take the shapes from a URDF; None if there are none, and why in words."""
        # model: with the joints that move, by default all; package_dirs: folders of
        # packages of meshes, beside that of the URDF and those above it.
        if not isinstance(robot, (str, os.PathLike)):
            return None, (
                "A robot that is given as a model has no collision geometry; give the "
                "path of its URDF to keep its links apart."
            )
        if model is None:
            model = load_model(robot)
        try:
            return cls(model, load_shapes(robot, model, package_dirs), margin), ""
        except NoShapes as reason:
            return None, str(reason)

    def __call__(self, q, within=None):
        """Return the signed distances of all pairs at q (n, nv), with gradients."""
        # Exact up to `within` [m]; further away a lower bound, which is larger than
        # this.
        q = self._positions(q)
        within = self.near if within is None else within
        poses = self._poses(q)
        distance = self._bounds(poses)
        exact = distance <= within
        gradient = np.zeros((*distance.shape, q.shape[1]))
        rows, pairs = np.nonzero(exact)
        found = self._nearest_points(poses, rows, pairs)
        distance[rows, pairs] = found.distance
        gradient[rows, pairs] = self._gradients(poses, rows, pairs, found)
        return Distances(distance, gradient, exact)

    def nearest(self, q):
        """Return where two links are nearest, or deepest in each other, or None."""
        best, where = np.inf, None
        for start, poses in self._pieces(q):
            bounds = self._bounds(poses)
            order = np.argsort(bounds, axis=None)
            for batch in np.array_split(order, np.arange(_BATCH, len(order), _BATCH)):
                rows, pairs = np.unravel_index(batch, bounds.shape)
                if len(batch) == 0 or bounds[rows[0], pairs[0]] >= best:
                    break
                found = self._nearest_points(poses, rows, pairs).distance
                k = found.argmin()
                if found[k] < best:
                    best = float(found[k])
                    where = (start + int(rows[k]), *self.pairs[pairs[k]])
        return None if where is None else Approach(*where, best)

    def smallest(self, q):
        """Return the smallest signed distance [m] in a motion, inf if none can meet."""
        nearest = self.nearest(q)
        return np.inf if nearest is None else nearest.distance

    def _look_at(self, candidates):
        """Take pairs of numbers of shapes as those that are looked at."""
        numbers = np.array(candidates, dtype=int).reshape(-1, 2)
        self._first, self._second = numbers.T
        shapes, distance = self._shapes, self._coal.ComputeDistance
        self.pairs = tuple((shapes[i].link, shapes[j].link) for i, j in candidates)
        self._compute = [
            distance(shapes[i].geometry, shapes[j].geometry) for i, j in candidates
        ]
        self._requests = [self._request(shapes[i], shapes[j]) for i, j in candidates]
        # Joints that carry the one and not the other change their distance.
        carries = self._poses.carries.astype(float)
        first, second = self._bodies[self._first], self._bodies[self._second]
        self._moves = carries[second] - carries[first]

    def _request(self, first, second):
        """How finely coal looks for the nearest points of two shapes."""
        request, cylinder = self._coal.DistanceRequest(), self._coal.Cylinder
        request.gjk_tolerance = _GAP
        if not any(isinstance(x.geometry, cylinder) for x in (first, second)):
            request.epa_tolerance = _GAP
        return request

    def _share_within(self, model, margin):
        """In which share of the positions a robot can take each pair is that near."""
        lower, upper = position_range(model)
        random = np.random.default_rng(0).random((_SAMPLES, model.nv))
        neutral = np.clip(0.0, lower, upper)
        q = np.vstack([neutral, lower + (upper - lower) * random])
        count = np.zeros(len(self.pairs))
        for _, poses in self._pieces(q):
            rows, pairs = np.nonzero(self._bounds(poses) < margin)
            touch = self._nearest_points(poses, rows, pairs).distance < margin
            count += np.bincount(pairs[touch], minlength=len(count))
        return count / len(q)

    def _positions(self, q):
        """Check positions (n, nv)."""
        q, nv = np.asarray(q, dtype=float), self._poses.carries.shape[1]
        if q.ndim != 2 or q.shape[1] != nv:
            raise ValueError(f"q must have the shape (n, {nv}), got {q.shape}.")
        if not np.isfinite(q).all():
            raise ValueError("q has entries that are not finite.")
        return q

    def _pieces(self, q):
        """Yield number of the first row and poses, of pieces of a motion."""
        q = self._positions(q)
        step = max(1, self.at_once // max(1, len(self.pairs)))
        for start in range(0, len(q), step):
            yield start, self._poses(q[start : start + step])

    def _bounds(self, poses):
        """Lower bounds of the distances (n, n_pairs), of balls around the shapes."""
        turned = np.einsum("nbij,bj->nbi", poses.axes[:, self._bodies], self._centres)
        centres = turned + poses.origins[:, self._bodies]
        way = centres[:, self._first] - centres[:, self._second]
        apart = np.linalg.norm(way, axis=-1)
        return apart - self._radii[self._first] - self._radii[self._second]

    def _nearest_points(self, poses, rows, pairs):
        """Have coal find where pairs of shapes are nearest, one by one."""
        frame, distance = self._coal.Transform3s, np.empty(len(rows))
        normal, point = np.empty((2, len(rows), 3))
        axes, origins = [], []
        for shapes in (self._first[pairs], self._second[pairs]):
            carrier = poses.axes[rows, self._bodies[shapes]]
            axes.append(carrier @ self._axes[shapes])
            moved = np.einsum("nij,nj->ni", carrier, self._origins[shapes])
            origins.append(moved + poses.origins[rows, self._bodies[shapes]])
        result = self._coal.DistanceResult()
        for k, pair in enumerate(pairs):
            result.clear()
            distance[k] = self._compute[pair](
                frame(axes[0][k], origins[0][k]),
                frame(axes[1][k], origins[1][k]),
                self._requests[pair],
                result,
            )
            normal[k], point[k] = result.normal, result.getNearestPoint1()
        return _Nearest(distance, normal, point)

    def _gradients(self, poses, rows, pairs, found):
        """Return derivatives of distances by the positions, (k, nv)."""
        # A joint that carries a body moves its nearest point p by (linear + angular x
        # p). Both nearest points lie on the normal, so that either stands for both.
        lever = np.cross(found.point, found.normal)
        along = np.einsum("kji,ki->kj", poses.linear[rows], found.normal)
        along += np.einsum("kji,ki->kj", poses.angular[rows], lever)
        return self._moves[pairs] * along


@dataclass(frozen=True)
class _Nearest:
    """Distances (k,), normals (k, 3) from first to second, points (k, 3) on first."""

    distance: np.ndarray
    normal: np.ndarray
    point: np.ndarray
