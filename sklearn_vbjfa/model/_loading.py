"""Robot models: a URDF made safe to parse, built by Pinocchio, and asked about.

A description is checked before Pinocchio sees it, since its parser neither limits the
depth of the XML nor says which link is wrong, and what of it does not enter the model
is said in one warning.
"""

import os
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.parsers import expat
from xml.parsers.expat import ExpatError

import numpy as np

from sklearn_vbjfa.physical import body_scales, min_eigenvalue

# A body's smallest pseudo-inertia eigenvalue, in units of its own mass and length,
# below which the body has next to no extension in some direction; and below which a
# warning says so. (What was identified and projected lies between the two.)
_SOLID, _POSSIBLE = 1e-6, 1e-12
# Robots of a hundred joints stay far below.
_DEEPEST, _MOST_ELEMENTS, _MOST_ATTRIBUTES = 100, 200_000, 1000
_MOST_JOINTS = 200
# Kinds of joints that have an axis, and elements that a fixed joint has no use for.
_AXIAL = ("revolute", "continuous", "prismatic")
_MOTION = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")


def import_pinocchio():
    """Import pinocchio, or say in one line how to get it."""
    try:
        import pinocchio
    except ImportError as error:
        raise ImportError(
            "Robot models need Pinocchio, which is not installed: "
            'pip install "sklearn-vbjfa[robot]"'
        ) from error
    return pinocchio


def load_model(model):
    """Return a pinocchio model whose joints all have one degree of freedom.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Path of a URDF file, or a model.

    Returns
    -------
    pinocchio.Model
        A copy of the model given, or the one read from the file. A joint that the
        URDF calls "continuous" is read as a revolute joint without limits, so that
        its position is one angle [rad].

    Raises
    ------
    ImportError
        If pinocchio is not installed.
    FileNotFoundError
        If the file does not exist.
    ValueError
        If a joint has not exactly one degree of freedom, there is no joint, or a link
        has a negative mass.

    Warns
    -----
    UserWarning
        If something in the URDF does not enter the model: a joint that mimics another
        one counts as a joint of its own, and a body without mass or with an inertia
        that no solid body has is completed by a ball (see `solid_bodies`).
    """
    pin = import_pinocchio()
    if isinstance(model, (str, os.PathLike)):
        path = Path(model)
        return _from_description(pin, parse_description(path), path)
    if isinstance(model, pin.Model):
        return _check_joints(model.copy())
    raise TypeError(
        "model must be the path of a URDF file or a pinocchio.Model, got "
        f"{type(model).__name__}."
    )


def load_reduced(path, moving):
    """Return the model of a URDF of which only some joints move.

    Parameters
    ----------
    path : str or os.PathLike
        URDF file.
    moving : sequence of str
        Names of the joints that move, in any order; the others are held at zero, of
        whatever kind they are, and what they carry is one body with its parent.

    Returns
    -------
    pinocchio.Model
        As from `load_model`.
    """
    path = Path(path)
    tree = parse_description(path)
    _hold_others(tree, path, moving)
    return _from_description(import_pinocchio(), tree, path)


def movable_joints(path):
    """Names of the joints of a URDF that are not fixed, in its order."""
    tree = parse_description(Path(path))
    return tuple(
        joint.get("name")
        for joint in tree.getroot().findall("joint")
        if joint.get("type") != "fixed"
    )


def write_reduced(path, target, moving):
    """Write a copy of a URDF in which all but some joints are fixed at zero.

    Parameters
    ----------
    path, target : str or os.PathLike
        Files to read and to write.
    moving : sequence of str
        Names of the joints that move.

    Returns
    -------
    tuple of str
        Names of the joints that were fixed.
    """
    tree = parse_description(Path(path))
    held = _hold_others(tree, Path(path), moving)
    tree.write(target, encoding="utf-8", xml_declaration=True)
    return held


def _check_joints(loaded):
    """Refuse a model with joints of other than one degree of freedom, or none."""
    if loaded.nv == 0:
        raise ValueError(
            "The robot model has no moving joint; expected a tree of revolute or "
            "prismatic joints. Check the joint types in the URDF."
        )
    wrong = [
        f"{loaded.names[i]} ({joint.shortname()}, nq={joint.nq}, nv={joint.nv})"
        for i, joint in enumerate(loaded.joints)
        if i > 0 and (joint.nq, joint.nv) != (1, 1)
    ]
    if wrong:
        raise ValueError(
            "Every joint must have one degree of freedom (nq == nv); got "
            + ", ".join(wrong)
            + ". Fix the base (no floating base), split spherical joints into three "
            "revolute ones, and lock what does not move with "
            "pinocchio.buildReducedModel (command line: --joints)."
        )
    return loaded


def load_text(text, path):
    """Return the model of a URDF that was read before.

    What of it does not enter the model was said then.

    Parameters
    ----------
    text : str
        XML without declaration.
    path : str or os.PathLike
        File that messages name.

    Returns
    -------
    pinocchio.Model
        As from `load_model`.
    """
    pin, path = import_pinocchio(), Path(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return _from_description(pin, _parsed(text.encode(), path), path)


def parse_description(path):
    """Read the XML of a robot description, `ElementTree`; refuse what is none."""
    if not path.is_file():
        raise FileNotFoundError(
            f"No robot description at {str(path)!r}; expected the path of a URDF file."
        )
    return _parsed(path.read_bytes(), path)


def _parsed(content, path):
    """Parse the bytes of a description; path : what messages name."""
    try:
        _check_structure(content)
        return ElementTree.ElementTree(ElementTree.fromstring(content))
    except (ElementTree.ParseError, ExpatError, LookupError, ValueError) as error:
        raise ValueError(
            f"{str(path)!r} is not readable as URDF (XML): {error}. "
            "A xacro file must be expanded first."
        ) from error


def _check_structure(content):
    """Refuse XML that is no robot's, before a parser makes a tree of it.

    Parsers call themselves once a level: a file of some hundred kilobytes can overrun
    the stack of the process.
    """
    depth, elements = 0, 0

    def start(name, attributes):
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if depth > _DEEPEST:
            raise ValueError(f"elements are nested more than {_DEEPEST} deep")
        if elements > _MOST_ELEMENTS:
            raise ValueError(f"there are more than {_MOST_ELEMENTS} elements")
        if len(attributes) > _MOST_ATTRIBUTES:
            raise ValueError(f"<{name}> has more than {_MOST_ATTRIBUTES} attributes")

    def end(name):
        nonlocal depth
        depth -= 1

    def entity(name, *rest):
        raise ValueError(
            f"it declares the entity {name[:40]!r}, write what it stands for"
        )

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.EntityDeclHandler = entity
    parser.Parse(content, True)


def _hold_others(tree, path, moving):
    """Fix all joints of a URDF but some; return the names of those fixed."""
    joints = {
        joint.get("name"): joint
        for joint in tree.getroot().findall("joint")
        if joint.get("type") != "fixed"
    }
    unknown = [name for name in moving if name not in joints]
    if unknown:
        raise ValueError(
            f"{str(path)!r}: the robot has no movable joint {unknown[0]!r}; it has "
            f"{', '.join(joints) or 'none'}."
        )
    held = tuple(name for name in joints if name not in moving)
    for name in held:
        joints[name].set("type", "fixed")
        for child in list(joints[name]):
            if child.tag in _MOTION:
                joints[name].remove(child)
    return held


def _from_description(pin, tree, path):
    """Build and check a model; say what of its description does not enter it."""
    _check_masses(tree, path)
    _check_axes(tree, path)
    loaded = _check_joints(_build(pin, tree, path))
    left_out = _left_out(tree, loaded)
    if left_out:
        warnings.warn(
            f"The robot description {path.name!r}: {'; '.join(left_out)}.",
            UserWarning,
            stacklevel=3,
        )
    return loaded


def _check_masses(tree, path):
    for link in tree.getroot().findall("link"):
        for mass in link.findall("inertial/mass"):
            try:
                value = float(mass.get("value", "nan"))
            except ValueError:
                # The parser says what is wrong.
                continue
            if value < 0:
                raise ValueError(
                    f"{str(path)!r}: link {link.get('name')!r} has the mass {value:g} "
                    "kg; correct the description."
                )


def _check_axes(tree, path):
    """Refuse joints without direction, and more joints than robots have."""
    moving = [
        joint
        for joint in tree.getroot().findall("joint")
        if joint.get("type") in _AXIAL
    ]
    if len(moving) > _MOST_JOINTS:
        raise ValueError(
            f"{str(path)!r}: the robot has {len(moving)} moving joints, at most "
            f"{_MOST_JOINTS} can be identified; hold the others (--joints)."
        )
    for joint in moving:
        axis = joint.find("axis")
        text = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
        try:
            length = float(np.linalg.norm([float(x) for x in text.split()]))
        except ValueError:
            # The parser says what is wrong.
            continue
        if not 1e-6 < length < np.inf:
            raise ValueError(
                f"{str(path)!r}: joint {joint.get('name')!r} has the axis {text!r}, "
                "which is no direction; correct the description."
            )


def _left_out(tree, model):
    """Sentences on what of a description does not enter the model."""
    names = joint_names(model)
    found = []
    followers = [
        joint.get("name")
        for joint in tree.getroot().findall("joint")
        if joint.get("name") in names and joint.find("mimic") is not None
    ]
    if followers:
        found.append(
            f"that {', '.join(followers)} mimic(s) another joint is not modelled, each "
            "counts as a joint with a torque of its own (to hold such joints at zero, "
            "leave them out of joint_names or --joints)"
        )
    possible = solid_bodies(nominal_parameters(model), _POSSIBLE)
    wrong = [name for name, good in zip(names, possible) if not good]
    if wrong:
        found.append(
            f"what {', '.join(wrong)} move(s) has no mass or an inertia that no solid "
            "body has, a ball stands for it where the recording cannot tell (correct "
            "the inertial element of its link)"
        )
    return found


def _build(pin, tree, path):
    for link in tree.getroot().findall("link"):
        # Shapes do not enter the model, and are not worth a complaint of the parser.
        for shape in link.findall("visual") + link.findall("collision"):
            link.remove(shape)
    for joint in tree.getroot().findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit")
                limit.set("effort", "1e12")
                limit.set("velocity", "1e12")
            limit.set("lower", "-1e12")
            limit.set("upper", "1e12")
    text = ElementTree.tostring(tree.getroot(), encoding="unicode")
    try:
        return pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise ValueError(
            f"Pinocchio cannot build a robot from {str(path)!r}: {error}"
        ) from error


def joint_names(model):
    """Names of the moving joints, in Pinocchio's order."""
    return tuple(model.names)[1:]


def body_names(model):
    """Names of the bodies that the joints move, in Pinocchio's order.

    Of several links that are fixed to each other, the one next to the joint; the
    joint's own name where the description names none.
    """
    body = import_pinocchio().FrameType.BODY
    found = {}
    for frame in model.frames:
        if frame.type == body:
            found.setdefault(frame.parentJoint, frame.name)
    return tuple(found.get(j, name) for j, name in enumerate(model.names))[1:]


def is_prismatic(model):
    """Return which joints are prismatic, ndarray of shape (nv,) of bool."""
    return np.array(
        [joint.shortname().startswith("JointModelP") for joint in model.joints[1:]]
    )


def joint_origin(model, joint):
    """Axes (3, 3) of a joint's origin in the link that carries it, as a URDF has them.

    Links that are fixed to each other are one body of the model, in whose axes the
    placement is; that of the carrying link is among its frames. A model without frames
    has the body's axes.
    """
    pin = import_pinocchio()
    placed = model.jointPlacements[joint + 1].rotation
    name = model.names[joint + 1]
    if not model.existFrame(name, pin.FrameType.JOINT):
        return placed.copy()
    own = model.frames[model.getFrameId(name, pin.FrameType.JOINT)]
    link = model.frames[own.parentFrame]
    if link.parentJoint != model.parents[joint + 1]:
        return placed.copy()
    return link.placement.rotation.T @ placed


def nominal_parameters(model):
    """Inertial parameters in the model, ndarray of shape (nv, 10).

    Pinocchio's order: m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz [kg, kg m,
    kg m^2], about the joint frame.
    """
    return np.array([body.toDynamicParameters() for body in model.inertias[1:]])


def solid_bodies(bodies, least=_SOLID):
    """Return which bodies have mass and extension, ndarray of shape (nv,) of bool.

    Parameters
    ----------
    bodies : ndarray of shape (nv, 10)
        Inertial parameters.
    least : float
        Least eigenvalue of the pseudo-inertia, in units of the body's mass and length.
    """
    mass, size = body_scales(bodies)
    return min_eigenvalue(bodies, mass_scale=mass, length_scale=size) > least
