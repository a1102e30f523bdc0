"""Distances between the links of a robot, with gradients.

The gradient of a distance follows from the nearest points of two shapes and the normal
between them: to first order the points are fixed to the shapes. The exception are
points that jump, as between parallel faces. Bounding spheres give lower bounds.
"""

import os

import numpy as np

from sklearn_vbjfa.model import (
    NoShapes,
    import_coal,
    import_pinocchio,
    load_shapes,
    position_range,
)

# Random positions to find the pairs that overlap in most positions.
_SAMPLES = 200
# Shapes touch if they are nearer than this share of the links' thickness: the tolerance
# for faces that are drawn flush.
_FLUSH = 0.01
# Duality gap [m^2] of the nearest points. With coal's default, normals of round shapes
# are wrong by its square root. Penetrating cylinders keep the default, since the search
# fails for a smaller one.
_GAP = 1e-10


class Clearance:
    """Distances between the links of a robot that may collide."""

    # Adjacent links, links fixed together and shapes that overlap in most positions are
    # left out. Meshes are replaced by their convex hulls. pairs: links that are checked
    # (once for each pair of shapes); ignored: links that overlap; near: distance [m] up
    # to which distances are exact.

    def __init__(self, model, geometry, margin=0.0):
        self._pin, self._coal = import_pinocchio(), import_coal()
        self._model, self._data, self._geometry = model, model.createData(), geometry
        self._placed = geometry.createData()
        boxes = [shape.geometry.aabb_local for shape in geometry.geometryObjects]
        ends = np.array([[box.min_, box.max_] for box in boxes])
        halves = 0.5 * (ends[:, 1] - ends[:, 0])
        self._middles, self._radii = ends.mean(axis=1), np.linalg.norm(halves, axis=1)
        self.near = float(np.median(halves.min(axis=1)))
        self._select([(pair.first, pair.second) for pair in geometry.collisionPairs])
        often = self._share_within(max(margin, _FLUSH * self.near)) > 0.5
        overlap = [pair for pair, drawn in zip(self.pairs, often) if drawn]
        self.ignored = tuple(dict.fromkeys(overlap))
        self._select([x for x, drawn in zip(self._shapes, often) if not drawn])

    @classmethod
    def of(cls, robot, model, margin=0.0):
        """Take the shapes from a URDF; None if there are none, and the reason."""
        # model: with the moving joints only.
        if not isinstance(robot, (str, os.PathLike)):
            return None, (
                "A robot that is given as a model has no collision geometry; give the "
                "path of its URDF to keep its links apart."
            )
        try:
            return cls(model, load_shapes(robot, model), margin), ""
        except NoShapes as reason:
            return None, str(reason)

    def __call__(self, q, within=None):
        """Return the signed distances of all pairs at q (n, nv), with gradients."""
        # (n, n_pairs) [m], negative for penetration, and (n, n_pairs, nv) by the
        # positions. Exact up to `within` [m]; above it a lower bound without gradient.
        within = self.near if within is None else within
        distance = np.empty((len(q), len(self.pairs)))
        gradient = np.zeros((*distance.shape, self._model.nv))
        for row, x in enumerate(q):
            distance[row] = self._place(x)
            for k in np.flatnonzero(distance[row] <= within):
                result = self._measure(k)
                distance[row, k] = result.min_distance
                gradient[row, k] = self._gradient(k, result)
        return distance, gradient

    def nearest(self, q):
        """Smallest signed distance [m] at q (n, nv), and its links; inf for none."""
        best, links = np.inf, ()
        for x in q:
            bounds = self._place(x)
            for k in np.argsort(bounds):
                if bounds[k] >= best:
                    break
                distance = self._measure(k).min_distance
                if distance < best:
                    best, links = float(distance), self.pairs[k]
        return best, links

    def _select(self, shapes):
        """Select the pairs of shapes, by their numbers, that are checked."""
        self._shapes, objects = shapes, self._geometry.geometryObjects
        self._first, self._second = np.array(shapes, dtype=int).reshape(-1, 2).T
        frames = self._model.frames
        links = [frames[shape.parentFrame].name for shape in objects]
        self.pairs = tuple((links[i], links[j]) for i, j in shapes)
        self._compute = []
        for i, j in shapes:
            first, second = objects[i].geometry, objects[j].geometry
            request, cylinder = self._coal.DistanceRequest(), self._coal.Cylinder
            request.gjk_tolerance = _GAP
            if not (isinstance(first, cylinder) or isinstance(second, cylinder)):
                request.epa_tolerance = _GAP
            self._compute.append((self._coal.ComputeDistance(first, second), request))

    def _share_within(self, margin):
        """Share of the reachable positions in which each pair is within a margin."""
        lower, upper = position_range(self._model)
        random = np.random.default_rng(0).random((_SAMPLES, self._model.nv))
        neutral = np.clip(0.0, lower, upper)
        q = np.vstack([neutral, lower + (upper - lower) * random])
        return (self(q, margin)[0] < margin).mean(axis=0)

    def _place(self, q):
        """Place the shapes; return lower bounds of the distances (n_pairs,)."""
        self._pin.computeJointJacobians(self._model, self._data, q)
        self._pin.updateGeometryPlacements(
            self._model, self._data, self._geometry, self._placed
        )
        places = zip(self._placed.oMg, self._middles)
        centres = np.array([place.act(middle) for place, middle in places])
        apart = np.linalg.norm(centres[self._first] - centres[self._second], axis=1)
        return apart - self._radii[self._first] - self._radii[self._second]

    def _measure(self, pair):
        # Not by Pinocchio, whose result depends on the previous nearest points.
        places = [self._placed.oMg[shape] for shape in self._shapes[pair]]
        frame, result = self._coal.Transform3s, self._coal.DistanceResult()
        compute, request = self._compute[pair]
        compute(*(frame(x.rotation, x.translation) for x in places), request, result)
        return result

    def _gradient(self, pair, result):
        """Return the derivatives of a distance by the positions, (nv,)."""
        # Both nearest points lie on the normal, so that either can be used.
        moves = np.zeros((6, self._model.nv))
        for sign, shape in zip((-1, 1), self._shapes[pair]):
            joint = self._geometry.geometryObjects[shape].parentJoint
            if joint:
                moves += sign * self._pin.getJointJacobian(
                    self._model, self._data, joint, self._pin.WORLD
                )
        lever = np.cross(result.getNearestPoint1(), result.normal)
        return result.normal @ moves[:3] + lever @ moves[3:]
