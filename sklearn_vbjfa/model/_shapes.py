"""Collision shapes of a robot's links from a URDF, and their placements.

Meshes are replaced by their convex hulls: signed distances of convex shapes are suited
to optimisation, also for penetration, and fast to compute.
"""

import re
import xml.etree.ElementTree as ElementTree
from itertools import combinations
from pathlib import Path

import numpy as np

from sklearn_vbjfa.model._trees import import_pinocchio
from sklearn_vbjfa.model._urdf import parse_description

# File names with a package and a path in it.
_IN_PACKAGE = re.compile(r"(?:package|model)://([^/]+)/(.+)")
# Attributes of coal's shapes that hold sizes.
_SIZES = ("radius", "halfLength", "halfSide")


class NoShapes(ValueError):
    """A robot has no shapes for the computation of distances, with the reason."""


def import_coal():
    """Import coal, Pinocchio's collision library, or raise an error with the remedy."""
    # Pinocchio 3.3, the oldest supported version, provides it under no other name.
    try:
        import coal
    except ImportError as error:
        raise NoShapes(
            f"Pinocchio {import_pinocchio().__version__} comes without the collision "
            "library coal, so distances between links are unknown: pip install "
            "--upgrade pin brings both."
        ) from error
    return coal


def load_shapes(path, model):
    """Read the collision shapes of a URDF as convex shapes on the bodies of a model.

    Returns a pinocchio.GeometryModel, whose collision pairs are those of links that are
    not next to each other.
    """
    # Raises NoShapes if there are none. Bodies of fixed joints are placed as in the
    # model. Packages of meshes are searched in the folder of the URDF and its parents.
    pin, coal = import_pinocchio(), import_coal()
    path = Path(path)
    tree = parse_description(path)
    links = _links_with_shapes(tree, path)
    missing = [x for x in links if not model.existFrame(x, pin.FrameType.BODY)]
    if missing:
        raise NoShapes(
            f"The model has no link {missing[0]!r} of {path.name!r}, its collision "
            "shapes belong to another robot."
        )
    _find_meshes(tree, path)
    geometry = _build(pin, tree, path, model)
    shapes = geometry.geometryObjects
    shape_links = [model.frames[x.parentFrame].name for x in shapes]
    unread = [name for name in links if links.count(name) > shape_links.count(name)]
    if unread:
        raise NoShapes(
            f"Pinocchio cannot read the collision geometry of link {unread[0]!r} in "
            f"{path.name!r}; correct its <collision>."
        )
    for shape, link in zip(shapes, shape_links):
        shape.geometry = _convex(coal, shape, link, path)
    adjacent = _neighbours(tree, shape_links)
    for i, j in combinations(range(len(shapes)), 2):
        if shapes[i].parentJoint != shapes[j].parentJoint and not adjacent(i, j):
            geometry.addCollisionPair(pin.CollisionPair(i, j))
    return geometry


def _links_with_shapes(tree, path):
    links = [
        link.get("name")
        for link in tree.getroot().findall("link")
        for _ in link.findall("collision/geometry")
    ]
    if not links:
        raise NoShapes(
            f"The robot description {path.name!r} has no collision geometry (no "
            "<collision> in any link), so distances between links are unknown."
        )
    return links


def _find_meshes(tree, path):
    """Insert the paths of meshes into a description; refuse missing meshes."""
    folders = list(path.resolve().parents)
    for link in tree.getroot().findall("link"):
        for mesh in link.findall("collision/geometry/mesh"):
            name = mesh.get("filename", "")
            file = _mesh_file(name, folders)
            if file is None:
                raise NoShapes(
                    f"The mesh {name!r} of link {link.get('name')!r} was not found in "
                    f"{str(folders[0])!r} or a folder above it; put the folder of its "
                    "package there."
                )
            mesh.set("filename", f"file://{file}")


def _mesh_file(name, folders):
    """Return the path of a mesh named in a URDF, None if there is no such file."""
    match = _IN_PACKAGE.fullmatch(name)
    if match:
        package, inner = match.groups()
        # The package is in or is one of the folders, which may have been renamed.
        candidates = [folder / package / inner for folder in folders]
        candidates += [folder / inner for folder in folders]
    else:
        candidates = [folders[0] / name.removeprefix("file://")]
    return next((x for x in candidates if name and x.is_file()), None)


def _build(pin, tree, path, model):
    """Read the shapes of a description with Pinocchio."""
    for link in tree.getroot().findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    text = ElementTree.tostring(tree.getroot(), encoding="unicode")
    try:
        return pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as error:
        # The part of coal's message that does not refer to its source code.
        message = " ".join(str(error).rpartition("message:")[2].split())
        raise NoShapes(
            f"Pinocchio cannot read the collision geometry of {path.name!r}: {message}"
        ) from error


def _convex(coal, shape, link, path):
    """Return the geometry of a pinocchio.GeometryObject, meshes as convex hulls."""
    geometry = shape.geometry
    if isinstance(geometry, coal.BVHModelBase):
        geometry = _hull(coal, np.array(geometry.vertices()), shape.meshPath)
    sizes = [getattr(geometry, size, 0.0) for size in _SIZES]
    if any(np.min(size) < 0 for size in sizes):
        raise NoShapes(
            f"The collision geometry of link {link!r} in {path.name!r} has a negative "
            "size."
        )
    geometry.computeLocalAABB()
    return geometry


def _hull(coal, points, mesh):
    """Return the convex hull of points (n, 3) as a shape of coal."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        # QJ perturbs the points, so that flat meshes get a volume.
        hull = ConvexHull(points, qhull_options="QJ")
    except (QhullError, ValueError) as error:
        raise NoShapes(
            f"The mesh {mesh!r} has no convex hull, it has {len(points)} points; "
            "correct the file."
        ) from error
    number = np.zeros(len(points), dtype=int)
    number[hull.vertices] = np.arange(len(hull.vertices))
    corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in points[hull.vertices]:
        corners.append(point)
    for triangle in hull.simplices:
        triangles.append(coal.Triangle(*(int(number[k]) for k in triangle)))
    return coal.Convex(corners, triangles)


def _neighbours(tree, links):
    """Return a function: whether links i, j are of one body or adjacent bodies."""
    parents = {
        joint.find("child").get("link"): (
            joint.find("parent").get("link"),
            joint.get("type") == "fixed",
        )
        for joint in tree.getroot().findall("joint")
    }

    def body(link):
        while parents.get(link, (None, False))[1]:
            link = parents[link][0]
        return link

    bodies = [body(link) for link in links]
    carriers = [body(parents[x][0]) if x in parents else None for x in bodies]
    return lambda i, j: (
        bodies[i] == bodies[j] or carriers[i] == bodies[j] or carriers[j] == bodies[i]
    )
