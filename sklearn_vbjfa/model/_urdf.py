"""URDF: what a file says of a tree of joints, and identified robots written as one.

A URDF is a tree by its own rules. Loops are written in extensions of simulators,
which readers ignore, or against the rules, which they refuse without a reason.
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
    Link,
    body_names,
    carriers_of,
    check_kinds,
    describe,
    import_pinocchio,
    in_order,
    joint_names,
)
from sklearn_vbjfa.physical import inertia_matrix

# Kinds of joints that have an axis, and elements that a fixed joint has no use for.
_AXIAL = ("revolute", "continuous", "prismatic")
_MOTION = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")
_TREE = "and only trees of joints can be identified"
# What URDF readers take for no limit.
_UNLIMITED = 1e12


# -- XML -------------------------------------------------------------------------------


def number(value):
    """Text of a number from which the same number is read back."""
    return repr(float(value) + 0.0)  # no -0.0


def numbers(values):
    """Text of several numbers, separated by spaces."""
    return " ".join(map(number, values))


def add_comment(root, note):
    """Put a comment at the top of an element, unless it is empty."""
    if note:
        # Two hyphens would end the comment.
        lines = re.sub("-(?=-)", "- ", note).replace("\n", "\n    ")
        root.insert(0, ElementTree.Comment(f" {lines} "))


def write_tree(tree, target):
    """Write an indented XML tree to a file, or leave the file as it was."""
    ElementTree.indent(tree)
    text = ElementTree.tostring(tree.getroot(), encoding="unicode")
    write_whole(target, f"<?xml version='1.0' encoding='utf-8'?>\n{text}")


def parse_description(path):
    """Read the XML of a robot description, `ElementTree`; refuse what is none."""
    if not path.is_file():
        raise FileNotFoundError(
            f"No robot description at {str(path)!r}; expected the path of a URDF or "
            "MJCF file."
        )
    return parse_text(path.read_bytes(), path)


def parse_text(content, path):
    """Parse the bytes of a description; path : what messages name."""
    try:
        root = ElementTree.fromstring(content)
        ElementTree.tostring(root)  # no deeper than can be written again
    except (ElementTree.ParseError, LookupError, ValueError, RecursionError) as error:
        raise ValueError(
            f"{str(path)!r} is not readable as URDF or MJCF (XML): {error}. "
            "A xacro file must be expanded first: xacro FILE > robot.urdf"
        ) from error
    if any("xacro" in str(one.tag).rpartition("}")[0] for one in root.iter()):
        raise ValueError(
            f"{str(path)!r} is a xacro file; expand it first: xacro FILE > robot.urdf"
        )
    return ElementTree.ElementTree(root)


# -- reading ---------------------------------------------------------------------------


def read_urdf(tree, path):
    """Return what a URDF says of a robot, `Description`; the tree is changed."""
    called, root = repr(str(path)), tree.getroot()
    _check_masses(root, called)
    _check_axes(root, called)
    _check_tree(root, called)
    links = _followers(root, called)
    closures = _closures(root)
    # An attribute that `text_of_tree` adds.
    rotors = {
        joint.get("name"): float(dynamics.get("armature"))
        for joint in _joints(root, *_AXIAL)
        for dynamics in joint.findall("dynamics[@armature]")
    }
    model = _build(root, called)
    for name, armature in rotors.items():
        model.armature[model.joints[model.getJointId(name)].idx_v] = armature
    return Description(
        model=model,
        called=called,
        listed=tuple(joint.get("name") for joint in _joints(root)),
        links=links,
        closures=closures,
    )


def _joints(root, *kinds):
    """Return the elements of joints, of some types alone if any are named."""
    joints = root.findall("joint")
    return [joint for joint in joints if not kinds or joint.get("type") in kinds]


def _followers(root, called):
    """Return joints that follow others, name -> `Link`; fix those of a fixed one."""
    still = {joint.get("name") for joint in _joints(root, "fixed")}
    found, joints = {}, {}
    for joint in _joints(root, *_AXIAL):
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        name, values = joint.get("name"), []
        for key, otherwise in (("multiplier", "1"), ("offset", "0")):
            value = _float(mimic.get(key, otherwise))
            if value is None:
                raise ValueError(
                    f"{called}: joint {name!r} follows another joint with the {key} "
                    f"{mimic.get(key)[:40]!r}, which is not a number; correct the "
                    "description."
                )
            values.append(value)
        leader, joints[name] = mimic.get("joint", ""), joint
        found[name] = Link(leader=leader, multiplier=values[0], offset=values[1])
    while follow := [name for name, link in found.items() if link.leader in still]:
        for name in follow:
            _fix(joints[name])
            still.add(name)
            del found[name]
    return found


def _build(root, called):
    """Build Pinocchio's model, joints in the order of the file."""
    # Shapes, and friction, which is not used and may be anything, are not worth a
    # complaint of the parser.
    for parent in root.findall("link") + root.findall("joint"):
        for tag in ("visual", "collision", "dynamics", "mimic"):
            for one in parent.findall(tag):
                parent.remove(one)
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
    build, said = import_pinocchio().buildModelFromXML, []
    try:
        with _parser_messages(said):
            model = build(text)
    except (ValueError, RuntimeError) as error:
        reason = f" ({said[0]})" if said else ""
        raise ValueError(
            f"Pinocchio cannot build a robot from {called}: {error}{reason}"
        ) from error
    # The parser continues without an inertia that it cannot read.
    lost = [line for line in said if "nerti" in line]
    if lost:
        raise ValueError(f"{called}: {'; '.join(lost)}; correct the description.")
    # Pinocchio sorts the branches by name.
    names = [joint.get("name") for joint in _joints(root)]
    carriers = carriers_of(model)
    return in_order(
        model, _parents_first(filter(carriers.__contains__, names), carriers)
    )


@contextlib.contextmanager
def _parser_messages(said):
    """Collect what the URDF parser, which is compiled code, writes to stderr."""
    try:
        stderr = os.dup(2)
    except OSError:
        # A program without a terminal.
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
            said += dict.fromkeys(errors)


def _parents_first(names, carriers):
    """Return names in the order of the file, carriers before what they carry."""
    found = []
    for name in names:
        chain = []
        while name is not None and name not in found:
            chain.append(name)
            name = carriers[name]
        found += reversed(chain)
    return found


# -- what is not a tree of joints ------------------------------------------------------


def _check_masses(root, called):
    for link in root.findall("link"):
        for mass in link.findall("inertial/mass"):
            value = _float(mass.get("value", "nan"))
            # Of what is not a number the parser says what is wrong.
            if value is not None and value < 0:
                raise ValueError(
                    f"{called}: link {link.get('name')!r} has the mass {value:g} "
                    "kg; correct the description."
                )


def _check_axes(root, called):
    for joint in _joints(root, *_AXIAL):
        axis = joint.find("axis")
        text = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
        try:
            length = float(np.linalg.norm([float(x) for x in text.split()]))
        except ValueError:
            # The parser says what is wrong.
            continue
        if not 1e-6 < length < np.inf:
            raise ValueError(
                f"{called}: joint {joint.get('name')!r} has the axis {text!r}, which "
                "is not a direction; correct the description."
            )


def _check_tree(root, called):
    above = {}
    for joint in _joints(root):
        found = [joint.find(tag) for tag in ("parent", "child")]
        ends = [one.get("link") for one in found if one is not None]
        if len(ends) < 2 or None in ends:
            # The parser says what is missing.
            return
        parent, child = ends
        if child in above:
            raise ValueError(
                f"{called}: link {child!r} has two parent joints, "
                f"{above[child][1]!r} and {joint.get('name')!r}: {_TREE}; remove one."
            )
        above[child] = parent, joint.get("name")
    for link in above:
        _check_ring(link, above, called)


def _closures(root):
    """Return what joins links in extensions of simulators, a tuple of `Closure`."""
    names = {link.get("name") for link in root.findall("link")}
    found = []
    for element in root.iter():
        # Without the namespace of its program.
        tag, where = re.sub(r"^(\{.*\}|.*:)", "", str(element.tag)), ""
        if tag == "gazebo" and element.find("joint") is not None:
            # A whole joint of the simulator, beside those of the robot.
            tag, where, element = "joint", " of <gazebo>", element.find("joint")
        elif tag != "loop_joint":
            continue
        words = [
            word.strip()
            for one in element.iter()
            for word in (*one.attrib.values(), one.text or "")
        ]
        links = tuple(dict.fromkeys(word for word in words if word in names))
        called = f" {element.get('name')!r}" if element.get("name") else ""
        joined = f" between {' and '.join(links)}" if links else ""
        said = f"<{tag}>{called}{where}{joined} closes a loop, {_TREE}"
        found.append(Closure(said, bodies=links))
    return tuple(found)


def hold_in_urdf(tree, names, links, base=None):
    """Fix the joints of a URDF at zero that are not named, a free one in some axes."""
    # links: of those that are named, the joints that still follow others; base: name
    # of the free joint, and rotation (3, 3) of its origin in its own axes.
    for joint in _joints(tree.getroot()):
        name = joint.get("name")
        if base is not None and name == base[0]:
            _turn_origin(joint, base[1])
        if name not in names:
            _fix(joint)
        elif name not in links:
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)


def _fix(joint):
    joint.set("type", "fixed")
    for child in list(joint):
        if child.tag in _MOTION:
            joint.remove(child)


def _float(text):
    """Return the finite number that a text holds, or None."""
    try:
        found = float(text)
    except ValueError:
        return None
    return found if np.isfinite(found) else None


def _check_ring(link, above, called):
    seen = [link]
    while link in above:
        link = above[link][0]
        if link in seen:
            ring = " - ".join([*seen[seen.index(link) :], link])
            raise ValueError(
                f"{called}: links {ring} form a closed loop, {_TREE}; "
                "correct the parent of one joint."
            )
        seen.append(link)


# -- identified robots -----------------------------------------------------------------


def body_about_com(phi):
    """Mass, centre of mass and inertia about it, from ten inertial parameters."""
    mass = phi[0]
    if not mass > 0:
        raise ValueError(
            f"A body has the mass {mass:.6g}: only physically consistent parameters "
            'can be written into a description. Use projector="default".'
        )
    com = phi[1:4] / mass
    # parallel axes
    shift = mass * (com @ com * np.eye(3) - np.outer(com, com))
    return mass, com, inertia_matrix(phi) - shift


def _turn_origin(joint, rotation):
    """Turn the origin of a joint, and with it what the joint carries."""
    origin = joint.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(joint, "origin")
        origin.set("xyz", "0 0 0")
    given = np.array(origin.get("rpy", "0 0 0").split(), dtype=float)
    turned = import_pinocchio().rpy.rpyToMatrix(given) @ rotation
    origin.set("rpy", numbers(_rpy(turned)))


def write_urdf(text, target, model, parameters, note="", turned=None, followers=None):
    """Write a URDF with other inertias and friction, from its text."""
    # parameters (nv, 12): inertial ones [kg, kg m, kg m^2], viscous and Coulomb
    # friction; note: comment at the top; turned: rotation matrices (3, 3) of joints'
    # origins; followers: bodies (10,) of joints that follow others, by name.
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
    rows = [*zip(names, parameters), *followers.items()]
    for name, row in rows:
        joint = joints[name]
        child = joint.find("child").get("link")
        # What is fixed to the link is one body with it: its inertia is in the sum.
        moved = [child]
        for link in moved:
            for inertial in links[link].findall("inertial"):
                links[link].remove(inertial)
            moved += fixed_children.get(link, [])
        _add_inertial(links[child], *body_about_com(row[:10]))
        if turned and name in turned:
            _turn_origin(joint, turned[name])
        if name in followers:
            # Its friction is felt as that of its leader.
            continue
        dynamics = joint.find("dynamics")
        if dynamics is None:
            dynamics = ElementTree.SubElement(joint, "dynamics")
        dynamics.set("damping", number(row[10]))
        dynamics.set("friction", number(row[11]))
    write_tree(ElementTree.ElementTree(root), target)


def check_possible(model, min_eigenvalues, kind):
    """Refuse bodies that cannot exist, which no description may hold."""
    # min_eigenvalues (nv,): of the pseudo-inertias, positive where a body can exist.
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
    # One link a joint, of the name of its body, without shapes. Gravity has no place in
    # it.
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
        endless = not (low > -_UNLIMITED or high < _UNLIMITED)
        kind = "prismatic" if slides else "continuous" if endless else "revolute"
        joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
        placed = data.liMi[j + 1]
        _add(joint, "origin", xyz=placed.translation, rpy=_rpy(placed.rotation))
        ElementTree.SubElement(joint, "parent", link=links[model.parents[j + 1]])
        ElementTree.SubElement(joint, "child", link=links[j + 1])
        _add(joint, "axis", xyz=tree.axes[j])
        limits = {"effort": model.effortLimit[j], "velocity": model.velocityLimit[j]}
        if kind != "continuous":
            limits = {"lower": low, "upper": high} | limits
        _add(joint, "limit", **limits)
        if model.armature[j] > 0:
            # No attribute of URDF, whose readers ignore it; see `read_urdf`.
            _add(joint, "dynamics", damping=0.0, armature=model.armature[j])
        if followers and name in followers:
            follows = followers[name]
            mimic = {"multiplier": follows.multiplier, "offset": follows.offset}
            _add(joint, "mimic", **mimic).set("joint", follows.leader)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _link_names(model):
    """Names of the base and of the bodies, all different."""
    bodies = body_names(model)
    if len(set(bodies)) < len(bodies):
        bodies = tuple(f"{name}_link" for name in joint_names(model))
    base = "base_link"
    while base in bodies:
        base = f"{base}_"
    return (base, *bodies)


def _add_inertial(link, mass, com, inertia):
    """Write the inertia of a body, about its centre of mass."""
    inertial = ElementTree.SubElement(link, "inertial")
    _add(inertial, "origin", xyz=com, rpy=np.zeros(3))
    _add(inertial, "mass", value=mass)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    _add(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)


def _rpy(rotation):
    """Roll, pitch and yaw of a rotation matrix, as close as rounding allows."""
    return import_pinocchio().rpy.matrixToRpy(rotation)


def _add(parent, tag, **attributes):
    """Add an element whose attributes are numbers, written so that they come back."""
    element = ElementTree.SubElement(parent, tag)
    for name, values in attributes.items():
        element.set(
            name, numbers(np.clip(np.atleast_1d(values), -_UNLIMITED, _UNLIMITED))
        )
    return element
