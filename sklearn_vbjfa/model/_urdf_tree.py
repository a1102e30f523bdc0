"""What a URDF says beside a tree of links: loops, which its readers drop or refuse.

A URDF is a tree by its own rules. Loops are told in extensions of simulators, which
readers leave out in silence, or against the rules, which they refuse without a reason.
"""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np

from sklearn_vbjfa.model._pinocchio import import_pinocchio
from sklearn_vbjfa.model._xml import numbers

# Elements of simulators that join two links of the tree once more.
_CLOSURES = (
    "loop_joint",
    "ball_constraint",
    "linear_bushing_rpy",
    "weld_constraint",
    "distance_constraint",
)
_TREE = "and only trees of joints can be identified"
_REMEDY = (
    "take out the joint that closes it, or hold what is not recorded at zero: name the "
    "joints that are (--joints in the command line, joint_names in Python)"
)


def check_tree(tree, path):
    """Refuse a URDF whose joints close a loop, naming the links."""
    # A link hangs on two joints, links hang on each other in a ring, or an extension
    # joins two links that move against each other.
    root = tree.getroot()
    above = {}
    for joint in root.findall("joint"):
        parent, child = (_link(joint.find(tag)) for tag in ("parent", "child"))
        if parent is None or child is None:
            # The parser says what is missing.
            return
        if child in above:
            raise ValueError(
                f"{str(path)!r}: link {child!r} hangs on two joints, "
                f"{above[child][1]!r} and {joint.get('name')!r}: that is a loop, "
                f"{_TREE}; take one of them out."
            )
        above[child] = parent, joint.get("name"), joint.get("type") == "fixed"
    for link in above:
        _check_ring(link, above, path)
    carriers = {
        link.get("name"): _carrier(link.get("name"), above)
        for link in root.findall("link")
    }
    # Frames of Drake, which bushings name.
    at = {frame.get("name"): frame.get("link") for frame in root.findall("frame")}
    for element in root.iter():
        closure = _closure(element)
        if closure is None:
            continue
        names = [at.get(name, name) for name in _words(closure)]
        links = [name for name in dict.fromkeys(names) if name in carriers]
        if len(links) < 2 or len({carriers[name] for name in links}) > 1:
            joined = f" between {' and '.join(links)}" if links else ""
            raise ValueError(
                f"{str(path)!r}: {_called(closure)}{joined} closes a loop, {_TREE}; "
                f"{_REMEDY}."
            )


def carriers(tree):
    """Name of the moving joint that carries each moving joint; None for the base."""
    above, joints = {}, []
    for joint in tree.getroot().findall("joint"):
        parent, child = (_link(joint.find(tag)) for tag in ("parent", "child"))
        moves = joint.get("type") != "fixed"
        above[child] = parent, joint.get("name"), not moves
        if moves:
            joints.append((joint.get("name"), parent))
    found = {}
    for name, link in joints:
        seen = set()
        while link in above and above[link][2] and link not in seen:
            seen.add(link)
            link = above[link][0]
        found[name] = above[link][1] if link in above else None
    return found


def turn_base(tree, name, turn=None):
    """Turn the link that a joint carries; return the joint, and its axes (3, 3)."""
    # turn: axes of the base in the world; None for those of the file.
    joints = {
        _link(joint.find("child")): joint for joint in tree.getroot().findall("joint")
    }
    own = next(joint for joint in joints.values() if joint.get("name") == name)
    above, link, seen = np.eye(3), _link(own.find("parent")), set()
    while link in joints and link not in seen:
        seen.add(link)
        above = _turned(joints[link]) @ above
        link = _link(joints[link].find("parent"))
    if turn is not None:
        origin = own.find("origin")
        if origin is None:
            origin = ElementTree.SubElement(own, "origin")
        angles = import_pinocchio().rpy.matrixToRpy(above.T @ turn)
        origin.set("rpy", numbers(angles))
    return own, above @ _turned(own)


def _turned(joint):
    """Rotation (3, 3) of the origin of a joint, none where it cannot be read."""
    origin = joint.find("origin")
    text = "0 0 0" if origin is None else origin.get("rpy", "0 0 0")
    try:
        angles = np.array([float(x) for x in text.split()])
    except ValueError:
        angles = np.empty(0)
    # The parser says what is wrong.
    if angles.shape != (3,) or not np.isfinite(angles).all():
        return np.eye(3)
    return import_pinocchio().rpy.rpyToMatrix(angles)


def _link(element):
    """Name of the link that a <parent> or <child> names."""
    return None if element is None else element.get("link")


def _check_ring(link, above, path):
    """Refuse links that hang on each other."""
    seen = [link]
    while link in above:
        link = above[link][0]
        if link in seen:
            ring = " - ".join([*seen[seen.index(link) :], link])
            raise ValueError(
                f"{str(path)!r}: the links {ring} hang on each other in a ring, {_TREE}"
                "; correct the parent of one joint."
            )
        seen.append(link)


def _plain(tag):
    """Tag of an element without the namespace of its program."""
    return re.sub(r"^(\{.*\}|.*:)", "", str(tag))


def _closure(element):
    """Return the element that joins links outside the tree, if this has or is one."""
    tag = _plain(element.tag)
    if tag in _CLOSURES:
        return element
    # A whole joint of the simulator, beside those of the robot.
    return element.find("joint") if tag == "gazebo" else None


def _words(element):
    """Texts and attributes of all that is in an element."""
    return [
        word.strip()
        for one in element.iter()
        for word in (*one.attrib.values(), one.text or "")
    ]


def _called(element):
    """How messages call an element."""
    tag, name = _plain(element.tag), element.get("name")
    where = " of <gazebo>" if tag == "joint" else ""
    return f"<{tag}>{f' {name!r}' if name else ''}{where}"


def _carrier(link, above):
    """Return the link of the same rigid body next to the joint that moves it."""
    while link in above and above[link][2]:
        link = above[link][0]
    return link
