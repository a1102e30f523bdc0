"""Shapes of a robot's links, as a URDF gives them for collisions, and their places.

Meshes are replaced by their convex hulls: signed distances of convex shapes are what an
optimiser can follow, in penetration too, and they are quick.
"""

import re
import xml.etree.ElementTree as ElementTree
from itertools import combinations
from pathlib import Path

import numpy as np

from sklearn_vbjfa.model._trees import import_pinocchio
from sklearn_vbjfa.model._urdf import parse_description

# Prefixes after which a package's name and a path in it follow.
_IN_PACKAGE = re.compile(r"(?:package|model)://([^/]+)/(.+)")
# What coal calls the sizes of its shapes.
_SIZES = ("radius", "halfLength", "halfSide")


class NoShapes(ValueError):
    """A robot has no shapes whose distances can be taken; the message says why."""


def import_coal():
    """Import coal, the collision library that comes with Pinocchio, or say how."""
    # By its own name: Pinocchio 3.3, the oldest that is taken, has no other for it.
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
    # NoShapes where there are none. What held joints carry is where the model has it.
    # Packages of meshes are looked for in the folder of the URDF and in its parents.
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
    read = [model.frames[x.parentFrame].name for x in shapes]
    unread = [name for name in links if links.count(name) > read.count(name)]
    if unread:
        raise NoShapes(
            f"Pinocchio cannot read the collision geometry of link {unread[0]!r} in "
            f"{path.name!r}; correct its <collision>."
        )
    for shape, link in zip(shapes, read):
        shape.geometry = _convex(coal, shape, link, path)
    near = _neighbours(tree, read)
    for i, j in combinations(range(len(shapes)), 2):
        if shapes[i].parentJoint != shapes[j].parentJoint and not near(i, j):
            geometry.addCollisionPair(pin.CollisionPair(i, j))
    return geometry


def _links_with_shapes(tree, path):
    """Name of the link of each collision shape; refuse a robot without any."""
    found = [
        link.get("name")
        for link in tree.getroot().findall("link")
        for _ in link.findall("collision/geometry")
    ]
    if not found:
        raise NoShapes(
            f"The robot description {path.name!r} has no collision geometry (no "
            "<collision> in any link), so distances between links are unknown."
        )
    return found


def _find_meshes(tree, path):
    """Write where the meshes are into a description; refuse one that is missing."""
    folders = list(path.resolve().parents)
    for link in tree.getroot().findall("link"):
        for mesh in link.findall("collision/geometry/mesh"):
            name = mesh.get("filename", "")
            found = _mesh_file(name, folders)
            if found is None:
                raise NoShapes(
                    f"The mesh {name!r} of link {link.get('name')!r} was not found in "
                    f"{str(folders[0])!r} or a folder above it; put the folder of its "
                    "package there."
                )
            mesh.set("filename", f"file://{found}")


def _mesh_file(name, folders):
    """Path of a mesh as a URDF names it, None where there is none."""
    packaged = _IN_PACKAGE.fullmatch(name)
    if packaged:
        package, rest = packaged.groups()
        # A package, or a folder of packages; the folder of a package may have been
        # renamed, but what is in it keeps its place.
        candidates = [folder / package / rest for folder in folders]
        candidates += [folder / rest for folder in folders]
    else:
        candidates = [folders[0] / name.removeprefix("file://")]
    return next((x for x in candidates if name and x.is_file()), None)


def _build(pin, tree, path, model):
    """Have Pinocchio read the shapes of a description."""
    for link in tree.getroot().findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    text = ElementTree.tostring(tree.getroot(), encoding="unicode")
    try:
        return pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as error:
        # Of what coal says, that which is not about its own source.
        said = " ".join(str(error).rpartition("message:")[2].split())
        raise NoShapes(
            f"Pinocchio cannot read the collision geometry of {path.name!r}: {said}"
        ) from error


def _convex(coal, shape, link, path):
    """Return the geometry of a pinocchio.GeometryObject, a hull of a mesh."""
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
        # A flat mesh has no volume; jostling its points gives it one.
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
    """Return whether links i, j are one body of the description, or side by side."""
    joints = tree.getroot().findall("joint")
    above = {
        joint.find("child").get("link"): (
            joint.find("parent").get("link"),
            joint.get("type") == "fixed",
        )
        for joint in joints
    }

    def body(link):
        while above.get(link, (None, False))[1]:
            link = above[link][0]
        return link

    bodies = [body(link) for link in links]
    carriers = [body(above[x][0]) if x in above else None for x in bodies]
    return lambda i, j: (
        bodies[i] == bodies[j] or carriers[i] == bodies[j] or carriers[j] == bodies[i]
    )
