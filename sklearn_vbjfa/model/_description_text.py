"""A robot as the text of a URDF: that of its file, or one written from its tree."""

import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from sklearn_vbjfa.model._loading import (
    body_names,
    import_pinocchio,
    is_urdf,
    joint_names,
    load_quietly,
    load_text,
    parse_description,
)
from sklearn_vbjfa.model._regressor import describe
from sklearn_vbjfa.model._urdf import is_text

# What URDF readers take for no limit, as `load_model` writes it.
_UNLIMITED = 1e12
# Distance of two models by rounding alone [m, and of the axes' components].
_ROUNDING = 1e-9


def description_text(source, model):
    """Return the URDF of a robot as a text, XML without declaration."""
    # A URDF is read again, with its references to meshes and without comments; of MJCF
    # and a model the URDF is written. ValueError if the file describes another robot by
    # now.
    if not isinstance(source, (str, os.PathLike)):
        return text_of_tree(model)
    path = Path(source)
    if is_urdf(path):
        root = parse_description(path).getroot()
        ElementTree.indent(root)
        text = ElementTree.tostring(root, encoding="unicode")
        now = load_text(text, path)
    else:
        robot = load_quietly(path)
        text, now = text_of_tree(robot.full, robot.links), robot.model
    if not alike(now, model):
        raise ValueError(
            f"The robot description {str(path)!r} is another one than when the robot "
            "was identified; put the old file back, or identify again."
        )
    return text


def urdf_to_fill(source):
    """Return what the URDF of an identified robot is a copy of."""
    # The source itself; of MJCF the text of a URDF with the same joints.
    if is_text(source) or not isinstance(source, (str, os.PathLike)):
        return source
    if is_urdf(source):
        return source
    robot = load_quietly(source)
    return text_of_tree(robot.full, robot.links)


def alike(one, other):
    """Whether two models have the same joints in the same places, but for rounding."""
    if sorted(joint_names(one)) != sorted(joint_names(other)):
        return False
    one = in_order(one, joint_names(other))
    if list(one.parents) != list(other.parents):
        return False
    first, second = (describe(m, _parents(m)) for m in (one, other))
    placed = [
        np.abs(a.translation - b.translation).max()
        for a, b in zip(one.jointPlacements, other.jointPlacements)
    ]
    apart = [
        np.abs(getattr(first, name) - getattr(second, name)).max()
        for name in ("frames", "axes", "turns", "slides")
    ]
    return max(placed + apart) < _ROUNDING


def in_order(model, names):
    """Return a model with its joints in another order, parents before children."""
    # Readers of URDF put branches of a tree in an order of their own.
    own = joint_names(model)
    if tuple(names) == own:
        return model
    if sorted(names) != sorted(own):
        raise ValueError(
            f"the joints {', '.join(names)} are not those of the robot description, "
            f"{', '.join(own)}"
        )
    made = import_pinocchio().Model()
    made.name, made.gravity = model.name, model.gravity
    numbers = {0: 0}
    for name in names:
        old = model.getJointId(name)
        if model.parents[old] not in numbers:
            raise ValueError(f"joint {name} comes before the one that carries it")
        at = model.joints[old].idx_q
        numbers[old] = made.addJoint(
            numbers[model.parents[old]],
            model.joints[old],
            model.jointPlacements[old],
            name,
            model.effortLimit[[at]],
            model.velocityLimit[[at]],
            model.lowerPositionLimit[[at]],
            model.upperPositionLimit[[at]],
        )
        made.inertias[numbers[old]] = model.inertias[old]
        made.armature[numbers[old] - 1] = model.armature[old - 1]
    frames = {0: 0}
    for old, frame in enumerate(list(model.frames)[1:], 1):
        moved = frame.copy()
        moved.parentJoint = numbers[frame.parentJoint]
        moved.parentFrame = frames[frame.parentFrame]
        # The inertias of the joints have those of the frames already.
        frames[old] = made.addFrame(moved, False)
    return made


def text_of_tree(model, followers=None):
    """Write the URDF of a tree of revolute and prismatic joints, with its followers."""
    # One link a joint, of the name of its body, without shapes. Gravity has no place in
    # it.
    pin = import_pinocchio()
    tree = describe(model, _parents(model))
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    links = _link_names(model)
    root = ElementTree.Element("robot", name=model.name or "robot")
    ElementTree.SubElement(root, "link", name=links[0])
    for j, name in enumerate(joint_names(model)):
        _check_kind(model, j, tree)
        slides = not tree.turns[j]
        link = ElementTree.SubElement(root, "link", name=links[j + 1])
        _add_inertial(link, model.inertias[j + 1])
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
        if followers and name in followers:
            _add_mimic(joint, followers[name])
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _add_mimic(joint, link):
    """Write that a joint follows another one."""
    _add(joint, "mimic", multiplier=link.multiplier, offset=link.offset)
    joint.find("mimic").set("joint", link.leader)


def _parents(model):
    """Numbers of the joints that carry each joint, -1 for none, (nv,)."""
    return np.array([int(k) - 1 for k in model.parents][1:])


def _link_names(model):
    """Names of the base and of the bodies, all different."""
    bodies = body_names(model)
    if len(set(bodies)) < len(bodies):
        bodies = tuple(f"{name}_link" for name in joint_names(model))
    base = "base_link"
    while base in bodies:
        base = f"{base}_"
    return (base, *bodies)


def _check_kind(model, j, tree):
    """Refuse a joint that is neither revolute, about its frame, nor prismatic."""
    pin = import_pinocchio()
    data, one = model.createData(), np.eye(model.nv)[j]
    pin.forwardKinematics(model, data, np.zeros(model.nq), one)
    motion = data.v[j + 1]
    turns = tree.axes[j] if tree.turns[j] else np.zeros(3)
    slides = np.zeros(3) if tree.turns[j] else tree.axes[j]
    other = np.r_[motion.angular - turns, motion.linear - slides]
    if np.abs(other).max() > _ROUNDING:
        raise ValueError(
            f"Joint {model.names[j + 1]} ({model.joints[j + 1].shortname()}) is "
            "neither revolute nor prismatic, and URDF has no name for it."
        )


def _add_inertial(link, inertia):
    """Write the inertia of a body; nothing without mass."""
    if not inertia.mass > 0:
        return
    inertial = ElementTree.SubElement(link, "inertial")
    _add(inertial, "origin", xyz=inertia.lever, rpy=np.zeros(3))
    _add(inertial, "mass", value=inertia.mass)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.inertia
    _add(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)


def _rpy(rotation):
    """Roll, pitch and yaw of a rotation matrix, as close as rounding allows."""
    return import_pinocchio().rpy.matrixToRpy(rotation)


def _add(parent, tag, **numbers):
    """Add an element whose attributes are numbers, written so that they come back."""
    element = ElementTree.SubElement(parent, tag)
    for name, values in numbers.items():
        limited = np.clip(np.atleast_1d(values), -_UNLIMITED, _UNLIMITED)
        element.set(name, " ".join(repr(float(x)) for x in limited))
