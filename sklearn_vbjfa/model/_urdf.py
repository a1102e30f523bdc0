"""Reading URDF files as trees of joints, and writing identified robots.

URDF requires a tree. Loops are either in extensions of simulators, which readers
ignore, or violate the rules, which readers refuse without a reason.
"""

import contextlib
import os
import re
import tempfile
import xml.etree.ElementTree as ElementTree

import numpy as np

from sklearn_vbjfa._core import write_whole
from sklearn_vbjfa.model._trees import (
    Closure,
    Description,
    Mimic,
    body_names,
    carriers_of,
    check_kinds,
    describe,
    import_pinocchio,
    in_order,
    joint_names,
)
from sklearn_vbjfa.physical import inertia_matrix

# Types of joints that have an axis, and elements that a fixed joint does not need.
_AXIAL = ("revolute", "continuous", "prismatic")
_MOTION = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")
_TREE = "and only trees of joints can be identified"
# Value that URDF readers treat as no limit.
_UNLIMITED = 1e12


# -- XML -------------------------------------------------------------------------------


def number(value):
    """Return the text of a number, without loss of precision."""
    return repr(float(value) + 0.0)  # no -0.0


def numbers(values):
    """Return the text of several numbers, separated by spaces."""
    return " ".join(map(number, values))


def add_comment(root, note):
    """Insert a comment at the top of an element, unless it is empty."""
    if note:
        # Two hyphens would end the comment.
        lines = re.sub("-(?=-)", "- ", note).replace("\n", "\n    ")
        root.insert(0, ElementTree.Comment(f" {lines} "))


def write_tree(tree, target):
    """Write an indented XML tree to a file, atomically."""
    ElementTree.indent(tree)
    text = ElementTree.tostring(tree.getroot(), encoding="unicode")
    write_whole(target, f"<?xml version='1.0' encoding='utf-8'?>\n{text}")


def parse_description(path):
    """Read the XML of a robot description, `ElementTree`; refuse other files."""
    if not path.is_file():
        raise FileNotFoundError(
            f"No robot description at {str(path)!r}; expected the path of a URDF or "
            "MJCF file."
        )
    return parse_text(path.read_bytes(), path)


def parse_text(content, path):
    """Parse the bytes of a description; messages name its path."""
    try:
        root = ElementTree.fromstring(content)
        ElementTree.tostring(root)  # refuses trees that are too deep to be written
    except (ElementTree.ParseError, LookupError, ValueError, RecursionError) as error:
        raise ValueError(
            f"{str(path)!r} is not readable as URDF or MJCF (XML): {error}. "
            "A xacro file must be expanded first: xacro FILE > robot.urdf"
        ) from error
    if any("xacro" in str(element.tag).rpartition("}")[0] for element in root.iter()):
        raise ValueError(
            f"{str(path)!r} is a xacro file; expand it first: xacro FILE > robot.urdf"
        )
    return ElementTree.ElementTree(root)


# -- reading ---------------------------------------------------------------------------


def read_urdf(tree, path):
    """Return the `Description` of a URDF; the tree is modified."""
    label, root = repr(str(path)), tree.getroot()
    _check_masses(root, label)
    _check_axes(root, label)
    _check_tree(root, label)
    mimics = _followers(root, label)
    closures = _closures(root)
    # A non-standard attribute, written by `text_of_tree`.
    rotors = {
        joint.get("name"): float(dynamics.get("armature"))
        for joint in _joints(root, *_AXIAL)
        for dynamics in joint.findall("dynamics[@armature]")
    }
    model = _build(root, label)
    for name, armature in rotors.items():
        model.armature[model.joints[model.getJointId(name)].idx_v] = armature
    return Description(
        model=model,
        label=label,
        listed=tuple(joint.get("name") for joint in _joints(root)),
        mimics=mimics,
        closures=closures,
    )


def _joints(root, *kinds):
    """Return the elements of joints, only of some types if any are given."""
    joints = root.findall("joint")
    return [joint for joint in joints if not kinds or joint.get("type") in kinds]


def _followers(root, label):
    """Return followers, name -> `Mimic`; fix followers of fixed joints."""
    fixed = {joint.get("name") for joint in _joints(root, "fixed")}
    mimics, joints = {}, {}
    for joint in _joints(root, *_AXIAL):
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        name, values = joint.get("name"), []
        for key, default in (("multiplier", "1"), ("offset", "0")):
            value = _float(mimic.get(key, default))
            if value is None:
                raise ValueError(
                    f"{label}: joint {name!r} follows another joint with the {key} "
                    f"{mimic.get(key)[:40]!r}, which is not a number; correct the "
                    "description."
                )
            values.append(value)
        leader, joints[name] = mimic.get("joint", ""), joint
        mimics[name] = Mimic(leader=leader, multiplier=values[0], offset=values[1])
    while follow := [name for name, mimic in mimics.items() if mimic.leader in fixed]:
        for name in follow:
            _fix(joints[name])
            fixed.add(name)
            del mimics[name]
    return mimics


def _build(root, label):
    """Build a Pinocchio model with the joints in the order of the file."""
    # Shapes and friction are removed, so that the parser reports no errors in them.
    for parent in root.findall("link") + root.findall("joint"):
        for tag in ("visual", "collision", "dynamics", "mimic"):
            for element in parent.findall(tag):
                parent.remove(element)
    for joint in _joints(root, "continuous"):
        joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is None:
            limit = ElementTree.SubElement(joint, "limit")
            limit.set("effort", "1e12")
            limit.set("velocity", "1e12")
        limit.set("lower", "-1e12")
        limit.set("upper", "1e12")
    text = ElementTree.tostring(root, encoding="unicode")
    build, messages = import_pinocchio().buildModelFromXML, []
    try:
        with _parser_messages(messages):
            model = build(text)
    except (ValueError, RuntimeError) as error:
        reason = f" ({messages[0]})" if messages else ""
        raise ValueError(
            f"Pinocchio cannot build a robot from {label}: {error}{reason}"
        ) from error
    # The parser skips an inertia that it cannot read.
    errors = [line for line in messages if "nerti" in line]
    if errors:
        raise ValueError(f"{label}: {'; '.join(errors)}; correct the description.")
    # Pinocchio sorts the branches by name.
    names = [joint.get("name") for joint in _joints(root)]
    carriers = carriers_of(model)
    return in_order(
        model, _parents_first(filter(carriers.__contains__, names), carriers)
    )


@contextlib.contextmanager
def _parser_messages(messages):
    """Collect the messages that the compiled URDF parser writes to stderr."""
    try:
        stderr = os.dup(2)
    except OSError:
        # The process has no stderr.
        yield
        return
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            file.seek(0)
            text = file.read().decode("utf-8", "replace")
            lines = [" ".join(line.split()) for line in text.splitlines()]
            errors = [x[len("Error: ") :] for x in lines if x.startswith("Error: ")]
            messages += dict.fromkeys(errors)


def _parents_first(names, carriers):
    ordered = []
    for name in names:
        chain = []
        while name is not None and name not in ordered:
            chain.append(name)
            name = carriers[name]
        ordered += reversed(chain)
    return ordered


# -- closed loops and invalid elements -------------------------------------------------


def _check_masses(root, label):
    for link in root.findall("link"):
        for mass in link.findall("inertial/mass"):
            value = _float(mass.get("value", "nan"))
            # The parser reports values that are not numbers.
            if value is not None and value < 0:
                raise ValueError(
                    f"{label}: link {link.get('name')!r} has the mass {value:g} "
                    "kg; correct the description."
                )


def _check_axes(root, label):
    for joint in _joints(root, *_AXIAL):
        axis = joint.find("axis")
        text = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
        try:
            length = float(np.linalg.norm([float(x) for x in text.split()]))
        except ValueError:
            # The parser reports the error.
            continue
        if not 1e-6 < length < np.inf:
            raise ValueError(
                f"{label}: joint {joint.get('name')!r} has the axis {text!r}, which "
                "is not a direction; correct the description."
            )


def _check_tree(root, label):
    parents = {}
    for joint in _joints(root):
        tags = [joint.find(tag) for tag in ("parent", "child")]
        ends = [element.get("link") for element in tags if element is not None]
        if len(ends) < 2 or None in ends:
            # The parser reports missing elements.
            return
        parent, child = ends
        if child in parents:
            raise ValueError(
                f"{label}: link {child!r} has two parent joints, "
                f"{parents[child][1]!r} and {joint.get('name')!r}: {_TREE}; remove one."
            )
        parents[child] = parent, joint.get("name")
    for link in parents:
        _check_cycle(link, parents, label)


def _closures(root):
    """Return loop closures in extensions of simulators, a tuple of `Closure`."""
    names = {link.get("name") for link in root.findall("link")}
    closures = []
    for element in root.iter():
        # Remove the namespace.
        tag, location = re.sub(r"^(\{.*\}|.*:)", "", str(element.tag)), ""
        if tag == "gazebo" and element.find("joint") is not None:
            # A joint that only the simulator adds.
            tag, location, element = "joint", " of <gazebo>", element.find("joint")
        elif tag != "loop_joint":
            continue
        words = [
            word.strip()
            for child in element.iter()
            for word in (*child.attrib.values(), child.text or "")
        ]
        links = tuple(dict.fromkeys(word for word in words if word in names))
        label = f" {element.get('name')!r}" if element.get("name") else ""
        joined = f" between {' and '.join(links)}" if links else ""
        message = f"<{tag}>{label}{location}{joined} closes a loop, {_TREE}"
        closures.append(Closure(message, bodies=links))
    return tuple(closures)


def hold_in_urdf(tree, names, mimics, base=None):
    """Fix the unnamed joints of a URDF at zero, a free joint with given axes."""
    # mimics: named joints that are still followers; base: name of the free joint, and
    # rotation (3, 3) of its origin in its own axes.
    for joint in _joints(tree.getroot()):
        name = joint.get("name")
        if base is not None and name == base[0]:
            _rotate_origin(joint, base[1])
        if name not in names:
            _fix(joint)
        elif name not in mimics:
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)


def _fix(joint):
    joint.set("type", "fixed")
    for child in list(joint):
        if child.tag in _MOTION:
            joint.remove(child)


def _float(text):
    """Return the finite number in a text, or None."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _check_cycle(link, parents, label):
    path = [link]
    while link in parents:
        link = parents[link][0]
        if link in path:
            cycle = " - ".join([*path[path.index(link) :], link])
            raise ValueError(
                f"{label}: links {cycle} form a closed loop, {_TREE}; "
                "correct the parent of one joint."
            )
        path.append(link)


# -- identified robots -----------------------------------------------------------------


def body_about_com(phi):
    """Return mass, centre of mass and inertia about it, from ten parameters."""
    mass = phi[0]
    if not mass > 0:
        raise ValueError(
            f"A body has the mass {mass:.6g}: only physically consistent parameters "
            'can be written into a description. Use projector="default".'
        )
    com = phi[1:4] / mass
    # parallel-axis theorem
    shift = mass * (com @ com * np.eye(3) - np.outer(com, com))
    return mass, com, inertia_matrix(phi) - shift


def _rotate_origin(joint, rotation):
    """Rotate the origin of a joint, and all bodies that it carries."""
    origin = joint.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(joint, "origin")
        origin.set("xyz", "0 0 0")
    angles = np.array(origin.get("rpy", "0 0 0").split(), dtype=float)
    rotated = import_pinocchio().rpy.rpyToMatrix(angles) @ rotation
    origin.set("rpy", numbers(_rpy(rotated)))


def write_urdf(text, target, model, parameters, note="", turned=None, followers=None):
    """Write a URDF with new inertias and friction, from its text."""
    # parameters (nv, 12): inertial parameters [kg, kg m, kg m^2], viscous and Coulomb
    # friction; note: comment at the top; turned: rotation matrices (3, 3) of joint
    # origins by name; followers: bodies (10,) of followers by name.
    followers = {} if followers is None else followers
    root = ElementTree.fromstring(text)
    add_comment(root, note)
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    links = {link.get("name"): link for link in root.findall("link")}
    names = joint_names(model)
    missing = [name for name in (*names, *followers) if name not in joints]
    if missing:
        raise ValueError(f"The URDF has no joint named {', '.join(missing)}.")
    fixed_children = {}
    for joint in joints.values():
        if joint.get("type") == "fixed":
            parent = joint.find("parent").get("link")
            fixed_children.setdefault(parent, []).append(
                joint.find("child").get("link")
            )
    for name, row in [*zip(names, parameters), *followers.items()]:
        joint = joints[name]
        child = joint.find("child").get("link")
        # The inertia includes that of all links that are fixed to this one.
        joined = [child]
        for link in joined:
            for inertial in links[link].findall("inertial"):
                links[link].remove(inertial)
            joined += fixed_children.get(link, [])
        _add_inertial(links[child], *body_about_com(row[:10]))
        if turned and name in turned:
            _rotate_origin(joint, turned[name])
        if name in followers:
            # Its friction is included in that of its leader.
            continue
        dynamics = joint.find("dynamics")
        if dynamics is None:
            dynamics = ElementTree.SubElement(joint, "dynamics")
        dynamics.set("damping", number(row[10]))
        dynamics.set("friction", number(row[11]))
    write_tree(ElementTree.ElementTree(root), target)


def check_possible(model, min_eigenvalues, kind):
    """Refuse bodies that are not physically consistent."""
    # min_eigenvalues (nv,): of the pseudo-inertias, positive for consistent bodies.
    if (min_eigenvalues <= 0).any():
        names = joint_names(model)
        bad = [name for name, low in zip(names, min_eigenvalues) if low <= 0]
        raise ValueError(
            f"The bodies of {', '.join(bad)} are not physically consistent, and {kind} "
            'must be: identify with projector="default".'
        )


# -- robots without a file -------------------------------------------------------------


def text_of_tree(model, followers=None):
    """Write the URDF of a tree of revolute and prismatic joints, with its followers."""
    # One link for each joint, named as its body, without shapes. URDF has no gravity.
    pin = import_pinocchio()
    tree = describe(model)
    check_kinds(model, tree)
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    links = _link_names(model)
    root = ElementTree.Element("robot", name=model.name or "robot")
    ElementTree.SubElement(root, "link", name=links[0])
    for j, name in enumerate(joint_names(model)):
        slides = not tree.turns[j]
        link = ElementTree.SubElement(root, "link", name=links[j + 1])
        body = model.inertias[j + 1]
        if body.mass > 0:
            _add_inertial(link, body.mass, body.lever, body.inertia)
        low, high = model.lowerPositionLimit[j], model.upperPositionLimit[j]
        unlimited = not (low > -_UNLIMITED or high < _UNLIMITED)
        kind = "prismatic" if slides else "continuous" if unlimited else "revolute"
        joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
        placement = data.liMi[j + 1]
        _add(joint, "origin", xyz=placement.translation, rpy=_rpy(placement.rotation))
        ElementTree.SubElement(joint, "parent", link=links[model.parents[j + 1]])
        ElementTree.SubElement(joint, "child", link=links[j + 1])
        _add(joint, "axis", xyz=tree.axes[j])
        limits = {"effort": model.effortLimit[j], "velocity": model.velocityLimit[j]}
        if kind != "continuous":
            limits = {"lower": low, "upper": high} | limits
        _add(joint, "limit", **limits)
        if model.armature[j] > 0:
            # Not part of URDF, readers ignore it; see `read_urdf`.
            _add(joint, "dynamics", damping=0.0, armature=model.armature[j])
        if followers and name in followers:
            follows = followers[name]
            mimic = {"multiplier": follows.multiplier, "offset": follows.offset}
            _add(joint, "mimic", **mimic).set("joint", follows.leader)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _link_names(model):
    bodies = body_names(model)
    if len(set(bodies)) < len(bodies):
        bodies = tuple(f"{name}_link" for name in joint_names(model))
    base = "base_link"
    while base in bodies:
        base = f"{base}_"
    return (base, *bodies)


def _add_inertial(link, mass, com, inertia):
    inertial = ElementTree.SubElement(link, "inertial")
    _add(inertial, "origin", xyz=com, rpy=np.zeros(3))
    _add(inertial, "mass", value=mass)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    _add(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)


def _rpy(rotation):
    return import_pinocchio().rpy.matrixToRpy(rotation)


def _add(parent, tag, **attributes):
    element = ElementTree.SubElement(parent, tag)
    for name, values in attributes.items():
        element.set(
            name, numbers(np.clip(np.atleast_1d(values), -_UNLIMITED, _UNLIMITED))
        )
    return element
