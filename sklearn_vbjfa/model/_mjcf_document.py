"""MJCF as a document: files that it includes, classes of defaults, angles and turns.

What MuJoCo's compiler makes of the text before it comes to bodies and joints, as its
XML reference has it: https://mujoco.readthedocs.io/en/stable/XMLreference.html
"""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.model._pinocchio import import_pinocchio

# Files that one robot may include, and bodies inside bodies.
_MOST_FILES, DEEPEST = 100, 300
# Attributes of which an element has at most one: what its axes are.
_TURNS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
_MAIN = "main"
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
            raise ValueError(
                f"{self.what} has {key}={_short(text)}, where {wanted} must be"
            )
        return found

    def number(self, key, otherwise=0.0):
        """Return an attribute as one number."""
        return float(self.numbers(key, [otherwise], 1)[0])

    def truth(self, key, otherwise):
        """Return an attribute that is "true" or "false"; "auto" is `otherwise`."""
        text = self.text(key, "auto")
        if text not in ("true", "false", "auto"):
            raise ValueError(
                f"{self.what} has {key}={_short(text)}, where true or false must be"
            )
        return otherwise if text == "auto" else text == "true"

    def direction(self, key, otherwise, size=3):
        """Return an attribute as a vector of length 1."""
        vector = self.numbers(key, otherwise, size)
        length = np.linalg.norm(vector)
        if not length > _SHORTEST:
            raise ValueError(
                f"{self.what} has {key}={_short(self.text(key))}, which is no direction"
            )
        return vector / length


class Document:
    """An MJCF file with all that it includes; the tree of `root` is changed."""

    # parse: function of a path to an `ElementTree`; degrees: whether angles are given
    # in them.

    def __init__(self, root, path, parse):
        self._root, self._path, self._parse = root, path, parse
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
        target = self._path.parent / name
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
                f"<compiler> has eulerseq={_short(order)}, where three of x, y, z "
                "must be"
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
        raise ValueError(f"{attributes.what} has xyaxes that are no two directions")
    x = x / lengths[0]
    y = y - (x @ y) * x
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def _short(text):
    """Quote a text, cut where it is long."""
    text = "" if text is None else str(text)
    return repr(text if len(text) <= 60 else f"{text[:57]}...")
