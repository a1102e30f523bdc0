"""MJCF as a document: included files, classes of defaults, turns, and masses.

What MuJoCo's compiler makes of the text before it comes to bodies and joints, as its
XML reference has it: https://mujoco.readthedocs.io/en/stable/XMLreference.html. The
volumes and moments of inertia of solid primitives are textbook formulas.
"""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.model._trees import import_pinocchio

# Files that one robot may include, and bodies inside bodies.
_MOST_FILES, DEEPEST = 100, 300
# Attributes of which an element has at most one: what its axes are.
_TURNS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
_MAIN = "main"
_DENSITY = 1000.0
# Shapes without mass, and how many sizes the others have.
_FLAT = ("plane", "hfield")
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
# The shortest vector that MuJoCo takes for a direction.
_SHORTEST = 1e-10


@dataclass(frozen=True, kw_only=True, eq=False)
class Attributes:
    """Attributes of one element, its classes of defaults included."""

    what: str  # the element, for messages
    # what it has itself and what its class gives it
    own: dict
    default: dict

    def text(self, key, otherwise=None):
        """Return an attribute as it is written."""
        return self.own.get(key, self.default.get(key, otherwise))

    def numbers(self, key, otherwise=None, size=None, least=None):
        """Return an attribute as finite numbers, ndarray; `otherwise` without it."""
        # size: how many there must be; least: how many there must be at least.
        text = self.text(key)
        if text is None:
            return None if otherwise is None else np.array(otherwise, dtype=float)
        try:
            found = np.array([float(x) for x in text.split()])
        except ValueError:
            found = np.array([np.nan])
        wanted = "finite numbers" if size is None else f"{size} finite number(s)"
        enough = found.size == size if size is not None else found.size >= (least or 1)
        if not enough or not np.isfinite(found).all():
            raise ValueError(f"{self.what} has {key}={_short(text)}, expected {wanted}")
        return found

    def number(self, key, otherwise=0.0):
        """Return an attribute as one number."""
        return float(self.numbers(key, [otherwise], 1)[0])

    def truth(self, key, otherwise):
        """Return an attribute that is "true" or "false"; "auto" is `otherwise`."""
        text = self.text(key, "auto")
        if text not in ("true", "false", "auto"):
            raise ValueError(
                f"{self.what} has {key}={_short(text)}, expected true or false"
            )
        return otherwise if text == "auto" else text == "true"

    def direction(self, key, otherwise, size=3):
        """Return an attribute as a vector of length 1."""
        vector = self.numbers(key, otherwise, size)
        length = np.linalg.norm(vector)
        if not length > _SHORTEST:
            raise ValueError(
                f"{self.what} has {key}={_short(self.text(key))}, "
                "which is not a direction"
            )
        return vector / length


class Document:
    """An MJCF file with all that it includes; the tree of `root` is changed."""

    # parse: function of a path to an `ElementTree`; degrees: whether angles are given
    # in them.

    def __init__(self, root, path, parse):
        self.path = path
        self._root, self._parse = root, parse
        self._files = {path.resolve()}
        self._include(root)
        self.compiler = self.merged("compiler")
        self._defaults = {_MAIN: {}}
        for section in root.findall("default"):
            self._read_defaults(section, _MAIN, {}, 0)
        angle = self.compiler.text("angle", "degree")
        if angle not in ("degree", "radian"):
            raise ValueError(f"<compiler> has angle={_short(angle)}")
        self.degrees = angle == "degree"
        if self.compiler.text("coordinate", "local") != "local":
            raise ValueError(
                "<compiler> has coordinate='global', which MuJoCo gave up in version "
                "2.3.4; load the file with an older one and save it "
                "(mujoco.mj_saveLastXML)"
            )

    @property
    def name(self):
        """Name of the robot."""
        return self._root.get("model", "robot")

    def sections(self, tag):
        """Elements of a tag right below the root."""
        return self._root.findall(tag)

    def merged(self, tag):
        """Attributes of all elements of a tag below the root; the last one counts."""
        own = {}
        for element in self._root.findall(tag):
            own |= element.attrib
        return Attributes(what=f"<{tag.rpartition('/')[2]}>", own=own, default={})

    def _include(self, element, depth=0):
        """Put the content of included files in the place of what names them."""
        if depth > DEEPEST:
            raise ValueError(f"elements are nested more than {DEEPEST} deep")
        children = []
        for child in list(element):
            if child.tag == "include":
                children += self._included(child.get("file", ""), depth)
            else:
                self._include(child, depth + 1)
                children.append(child)
        element[:] = children

    def _included(self, name, depth):
        """Read the elements of an included file."""
        target = self.path.parent / name
        if not name or not target.is_file():
            raise ValueError(
                f"it includes {_short(name)}, and there is no file {str(target)!r}"
            )
        if target.resolve() in self._files:
            raise ValueError(f"it includes {_short(name)} twice")
        if len(self._files) > _MOST_FILES:
            raise ValueError(f"it includes more than {_MOST_FILES} files")
        self._files.add(target.resolve())
        root = self._parse(target).getroot()
        self._include(root, depth)
        return list(root)

    def _read_defaults(self, section, name, inherited, depth):
        """Read a class of defaults and those in it, which inherit from it."""
        if depth > DEEPEST:
            raise ValueError(f"<default> elements are nested more than {DEEPEST} deep")
        name = section.get("class", name if depth == 0 else None)
        if name is None:
            raise ValueError("a <default> inside another one has no class")
        known = self._defaults.get(name, {}) if depth == 0 else {}
        own = {tag: dict(values) for tag, values in (inherited | known).items()}
        for element in section:
            if element.tag != "default":
                own.setdefault(element.tag, {}).update(element.attrib)
        self._defaults[name] = own
        if depth == 0:
            # The outermost class is what elements without a class have, whatever its
            # name.
            self._defaults[_MAIN] = own
        for element in section.findall("default"):
            self._read_defaults(element, None, own, depth + 1)

    def attributes(self, element, childclass=None):
        """Return the attributes of an element; `childclass` is given by its body."""
        name = element.get("class", childclass) or _MAIN
        what = f"<{element.tag}> {element.get('name', '')!r}".replace(" ''", "")
        if name not in self._defaults:
            raise ValueError(f"{what} is of a class {_short(name)} without <default>")
        return Attributes(
            what=what,
            own=dict(element.attrib),
            default=self._defaults[name].get(element.tag, {}),
        )

    def angle(self, value):
        """Turn an angle of the file into radians."""
        return np.deg2rad(value) if self.degrees else value

    def placement(self, attributes):
        """Return where an element is, and its axes, pinocchio.SE3."""
        pin = import_pinocchio()
        place = attributes.numbers("pos", np.zeros(3), 3)
        return pin.SE3(self.rotation(attributes), place)

    def rotation(self, attributes):
        """Return the axes of an element, by columns, ndarray (3, 3)."""
        pin = import_pinocchio()
        given = [key for key in _TURNS if key in attributes.own]
        if len(given) > 1:
            raise ValueError(
                f"{attributes.what} has {' and '.join(given)}, of which there can be "
                "one"
            )
        given = given or [key for key in _TURNS if key in attributes.default]
        if not given:
            return np.eye(3)
        key = given[-1]
        if key == "quat":
            w, x, y, z = attributes.direction(key, None, 4)
            return pin.Quaternion(w, x, y, z).matrix()
        if key == "axisangle":
            *axis, angle = attributes.numbers(key, None, 4)
            length = np.linalg.norm(axis)
            if not length > _SHORTEST:
                raise ValueError(f"{attributes.what} has an axisangle without axis")
            return pin.exp3(self.angle(angle) * np.array(axis) / length)
        if key == "xyaxes":
            return _from_axes(attributes)
        if key == "zaxis":
            return rotation_of_z(attributes.direction(key, None))
        return self._from_angles(attributes.numbers(key, None, 3))

    def _from_angles(self, angles):
        """Return the rotation of three Euler angles in the order of the compiler."""
        order = self.compiler.text("eulerseq", "xyz")
        if len(order) != 3 or set(order.lower()) - set("xyz"):
            raise ValueError(
                f"<compiler> has eulerseq={_short(order)}, expected three of x, y, z"
            )
        pin, turned = import_pinocchio(), np.eye(3)
        for letter, angle in zip(order, self.angle(angles)):
            axis = np.eye(3)["xyz".index(letter.lower())]
            one = pin.exp3(float(angle) * axis)
            # Small letters turn about the axes that have turned along.
            turned = turned @ one if letter.islower() else one @ turned
        return turned


def rotation_of_z(direction):
    """Return the smallest turn that takes the z axis to a direction, (3, 3)."""
    pin, z = import_pinocchio(), np.array([0.0, 0.0, 1.0])
    axis = np.cross(z, direction)
    sine = np.linalg.norm(axis)
    if sine < _SHORTEST:
        # Half a turn about x, or none.
        return np.diag([1.0, 1.0, 1.0] if direction[2] > 0 else [1.0, -1.0, -1.0])
    return pin.exp3(np.arctan2(sine, direction[2]) * axis / sine)


def _from_axes(attributes):
    """Return the rotation of which the x axis and one towards y are given."""
    x, y = attributes.numbers("xyaxes", None, 6).reshape(2, 3)
    lengths = np.linalg.norm(x), np.linalg.norm(np.cross(x, y))
    if not min(lengths) > _SHORTEST:
        raise ValueError(f"{attributes.what} has xyaxes that are not two directions")
    x = x / lengths[0]
    y = y - (x @ y) * x
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def _short(text):
    """Quote a text, cut where it is long."""
    text = "" if text is None else str(text)
    return repr(text if len(text) <= 60 else f"{text[:57]}...")


# -- masses ----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Masses:
    """What a body consists of."""

    inertia: object  # in the body's axes; zero without mass
    # whether something of it has a mass that is not known, a mesh or a shell
    unknown: bool


def masses_of(document, body, shapes):
    """Return the `Masses` of a body."""
    # shapes: its geoms, and where the frames around them are in the body.
    how = document.compiler.text("inertiafromgeom", "auto")
    if how not in ("auto", "true", "false"):
        raise ValueError(f"<compiler> has inertiafromgeom={how[:60]!r}")
    inertial = body.find("inertial")
    if how == "false" or (how == "auto" and inertial is not None):
        return _given(document, inertial)
    low, high = document.compiler.numbers("inertiagrouprange", [0, 5], 2)
    counted = [
        (attributes, frame)
        for attributes, frame in shapes
        if low <= attributes.number("group") <= high
        and attributes.text("type", "sphere") not in _FLAT
    ]
    if not counted:
        return _given(document, inertial)
    return _of_shapes(document, counted)


def _given(document, element):
    """Return what an <inertial> says."""
    pin = import_pinocchio()
    if element is None:
        return Masses(inertia=pin.Inertia.Zero(), unknown=False)
    attributes = document.attributes(element)
    mass = attributes.number("mass")
    if mass < 0:
        raise ValueError(f"a body has the mass {mass:g} kg")
    placed = document.placement(attributes)
    full = attributes.numbers("fullinertia", None, 6)
    if full is not None:
        xx, yy, zz, xy, xz, yz = full
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        placed.rotation = np.eye(3)
    else:
        inertia = np.diag(attributes.numbers("diaginertia", np.zeros(3), 3))
    turned = placed.rotation @ inertia @ placed.rotation.T
    return Masses(
        inertia=_bounded(document, pin.Inertia(mass, placed.translation, turned)),
        unknown=False,
    )


def _of_shapes(document, shapes):
    """Add up the masses of a body's shapes."""
    pin = import_pinocchio()
    total, unknown = pin.Inertia.Zero(), False
    for attributes, frame in shapes:
        kind = attributes.text("type", "sphere")
        mass = attributes.numbers("mass", None, 1)
        if mass is not None and mass[0] == 0:
            continue
        if mass is None and attributes.number("density", _DENSITY) == 0:
            continue
        shell = attributes.truth("shellinertia", False)
        if kind not in _SIZES or attributes.text("mesh") is not None or shell:
            unknown = True
            continue
        total += _shape(document, attributes, kind).se3Action(frame)
    return Masses(inertia=_bounded(document, total), unknown=unknown)


def _shape(document, attributes, kind):
    """Return the inertia of one primitive in the axes around it."""
    pin = import_pinocchio()
    placed = document.placement(attributes)
    size = attributes.numbers("size", None, least=1)
    ends = attributes.numbers("fromto", None, 6)
    size = np.zeros(0) if size is None else size
    if ends is not None:
        begin, end = ends.reshape(2, 3)
        way = end - begin
        half = np.linalg.norm(way) / 2
        placed.translation = (begin + end) / 2
        placed.rotation = rotation_of_z(way / (2 * half)) if half > 0 else np.eye(3)
        across = size[:1]
        wide = kind in ("box", "ellipsoid")
        size = np.r_[across, across, half] if wide else np.r_[across, half]
    needed = _SIZES[kind]
    if size.size < needed or not (size[:needed] > 0).all():
        raise ValueError(
            f"{attributes.what} is a {kind}, whose size must be {needed} positive "
            "number(s)"
        )
    volume, moments = _solid(kind, *size[:needed])
    mass = attributes.numbers("mass", None, 1)
    mass = attributes.number("density", _DENSITY) * volume if mass is None else mass[0]
    if mass < 0:
        raise ValueError(f"{attributes.what} has the mass {mass:g} kg")
    turned = placed.rotation @ np.diag(mass * moments) @ placed.rotation.T
    return pin.Inertia(float(mass), placed.translation, turned)


def _solid(kind, *size):
    """Volume of a primitive, and its moments of inertia over its mass, (3,)."""
    if kind == "sphere":
        (r,) = size
        return 4 / 3 * np.pi * r**3, np.full(3, 0.4 * r**2)
    if kind in ("box", "ellipsoid"):
        squares = np.square(size)
        box = kind == "box"
        volume = (8 if box else 4 / 3 * np.pi) * np.prod(size)
        return volume, (squares.sum() - squares) / (3 if box else 5)
    r, h = size
    volume = 2 * np.pi * r**2 * h
    across, along = r**2 / 4 + h**2 / 3, r**2 / 2
    if kind == "capsule":
        # A cylinder, and a ball in two halves that are h away from the middle.
        ball = 4 / 3 * np.pi * r**3
        share = ball / (volume + ball)
        volume += ball
        across += share * (0.4 * r**2 + h**2 + 0.75 * h * r - across)
        along += share * (0.4 * r**2 - along)
    return volume, np.array([across, across, along])


def _bounded(document, inertia):
    """Apply what the compiler asks of masses and moments of inertia."""
    compiler = document.compiler
    least_mass = compiler.number("boundmass")
    least = compiler.number("boundinertia")
    balance = compiler.truth("balanceinertia", False)
    if not (least_mass or least or balance):
        return inertia
    mass = max(inertia.mass, least_mass)
    principal, axes = np.linalg.eigh(inertia.inertia)
    principal = np.maximum(principal, least)
    if balance and principal[0] + principal[1] < principal[2]:
        principal[:] = principal.mean()
    turned = axes @ np.diag(principal) @ axes.T
    return import_pinocchio().Inertia(float(mass), inertia.lever, turned)
