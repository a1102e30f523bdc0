"""Shapes of a robot's links, as a URDF gives them for collisions, and their places.

Meshes are replaced by their convex hulls: signed distances of convex shapes are what an
optimiser can follow, in penetration too, and they are quick.
"""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sklearn_vbjfa.model._corrected import links_of
from sklearn_vbjfa.model._trees import describe, import_pinocchio
from sklearn_vbjfa.model._xml import parse_description

# Prefixes after which a package's name and a path in it follow.
_IN_PACKAGE = re.compile(r"(?:package|model)://([^/]+)/(.+)")
# What coal calls the sizes of its shapes.
_SIZES = ("radius", "halfLength", "halfSide")


class NoShapes(ValueError):
    """A robot has no shapes whose distances can be taken; the message says why."""


@dataclass(frozen=True)
class CollisionShape:
    """A convex shape on a body of the robot."""

    link: str  # link of the URDF that it belongs to
    joint: int  # number of the body that carries it; 0 is the base
    # (3, 3): its place in the frame of that body; directions by columns, [m]
    axes: np.ndarray
    origin: np.ndarray
    # box, sphere, capsule, cylinder or convex polyhedron, in its own frame
    geometry: object


@dataclass(frozen=True)
class RobotShapes:
    """The shapes of a robot, and which of them are neighbours."""

    shapes: tuple  # in the order of the URDF
    # (n_shapes, n_shapes): links fixed together, or with one joint of the description
    # between them
    neighbours: np.ndarray


def import_coal():
    """Import coal, the collision library that comes with Pinocchio, or say how."""
    # By its own name: Pinocchio 3.3, the oldest that is taken, has no other for it.
    try:
        import coal
    except ImportError as error:
        raise NoShapes(
            f"Pinocchio {import_pinocchio().__version__} comes without the collision "
            "library coal, distances between links are not known: pip install "
            "--upgrade pin brings both."
        ) from error
    return coal


def load_shapes(path, model, package_dirs=()):
    """Read the collision shapes of a URDF onto the bodies of a model."""
    # NoShapes where there are none. What held joints carry is where the model has it.
    # Packages of meshes are looked for in package_dirs, in the folder of the URDF and
    # in its parents.
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
    _find_meshes(tree, path, package_dirs)
    geometry = _build(pin, tree, path, model)
    read = [model.frames[x.parentFrame].name for x in geometry.geometryObjects]
    unread = [name for name in links if links.count(name) > read.count(name)]
    if unread:
        raise NoShapes(
            f"Pinocchio cannot read the collision geometry of link {unread[0]!r} in "
            f"{path.name!r}; correct its <collision>."
        )
    shapes = tuple(
        _shape(coal, found, link, path)
        for found, link in zip(geometry.geometryObjects, read)
    )
    return RobotShapes(shapes, _neighbours(tree, read))


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
            "<collision> in any link), distances between links are not known."
        )
    return found


def _find_meshes(tree, path, package_dirs):
    """Write where the meshes are into a description; refuse one that is missing."""
    given = [Path(folder).resolve() for folder in package_dirs]
    folders = given + list(path.resolve().parents)
    for link in tree.getroot().findall("link"):
        for mesh in link.findall("collision/geometry/mesh"):
            name = mesh.get("filename", "")
            found = _mesh_file(name, folders, path.resolve().parent)
            if found is None:
                searched = [repr(str(x)) for x in (*given, path.resolve().parent)]
                raise NoShapes(
                    f"The mesh {name!r} of link {link.get('name')!r} was not found in "
                    f"{', '.join(searched)} or a folder above it; put the "
                    "folder of its package there."
                )
            mesh.set("filename", f"file://{found}")


def _mesh_file(name, folders, beside):
    """Path of a mesh as a URDF names it, None where there is none."""
    packaged = _IN_PACKAGE.fullmatch(name)
    if packaged:
        package, rest = packaged.groups()
        # A package, or a folder of packages; the folder of a package may have been
        # renamed, but what is in it keeps its place.
        candidates = [folder / package / rest for folder in folders]
        candidates += [folder / rest for folder in folders]
    else:
        candidates = [beside / name.removeprefix("file://")]
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


def _shape(coal, found, link, path):
    """Return the `CollisionShape` of a pinocchio.GeometryObject."""
    geometry = found.geometry
    if isinstance(geometry, coal.BVHModelBase):
        geometry = _hull(coal, np.array(geometry.vertices()), found.meshPath)
    sizes = [getattr(geometry, size, 0.0) for size in _SIZES]
    if any(np.min(size) < 0 for size in sizes):
        raise NoShapes(
            f"The collision geometry of link {link!r} in {path.name!r} has a negative "
            "size."
        )
    geometry.computeLocalAABB()
    return CollisionShape(
        link=link,
        joint=found.parentJoint,
        axes=found.placement.rotation.copy(),
        origin=found.placement.translation.copy(),
        geometry=geometry,
    )


def _hull(coal, points, mesh):
    """Return the convex hull of points (n, 3) as a shape of coal."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        try:
            hull = ConvexHull(points)
        except QhullError:
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
    """Whether links are one body of the description, or next to each other."""
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
    near = np.eye(len(links), dtype=bool)
    for i, a in enumerate(bodies):
        for j, b in enumerate(bodies):
            near[i, j] = a == b or carriers[i] == b or carriers[j] == a
    return near


# -- where they are --------------------------------------------------------------------


@dataclass(frozen=True)
class Poses:
    """Frames of the bodies in the world, for each row of positions."""

    # (n, nv + 1, 3, 3): directions by columns; the first body is the base
    axes: np.ndarray
    origins: np.ndarray  # (n, nv + 1, 3) [m]
    # (n, nv, 3): motion of each joint at unit speed, as a screw about the origin of the
    # world: a point p that it carries moves with linear + angular x p
    linear: np.ndarray
    angular: np.ndarray


class JointPoses:
    """Forward kinematics of a model whose joints have one degree of freedom each."""

    # carries (nv + 1, nv): which joints move a body; the first body is the base.

    def __init__(self, model):
        self._tree = describe(model)
        self._starts = [x.translation.copy() for x in model.jointPlacements[1:]]
        self.carries = np.zeros((model.nv + 1, model.nv), dtype=bool)
        for j, parent in enumerate(self._tree.parents):
            if parent >= 0:
                self._starts[j] = self._starts[parent]
            self.carries[j + 1] = self.carries[parent + 1]
            self.carries[j + 1, j] = True

    def __call__(self, q):
        """Return the `Poses` of positions (n, nv) [rad, m]."""
        n, nv = q.shape
        axes, origins = np.empty((n, nv + 1, 3, 3)), np.zeros((n, nv + 1, 3))
        linear, angular = np.empty((2, n, nv, 3))
        axes[:, 0], still = np.eye(3), np.zeros_like(q)
        for j, link in enumerate(links_of(self._tree, q, still, still)):
            # Links count from the first joint of their branch.
            start = self._starts[j]
            axes[:, j + 1] = link.axes.transpose(2, 0, 1)
            origins[:, j + 1] = link.origin.T + start
            angular[:, j] = link.moment.T
            linear[:, j] = link.force.T + np.cross(start, angular[:, j])
        return Poses(axes, origins, linear, angular)
