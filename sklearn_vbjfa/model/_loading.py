"""Robot models: a description made safe to parse, built by Pinocchio, and asked about.

A URDF is checked before Pinocchio sees it, since its parser neither limits the depth
of the XML nor says which link is wrong; `sklearn_vbjfa.model._mjcf_reading` reads MJCF.
What of a description does not enter the model is said in one warning.
"""

import os
import warnings
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from xml.parsers import expat
from xml.parsers.expat import ExpatError

import numpy as np

from sklearn_vbjfa.model import _base, _mjcf_reading, _urdf_tree
from sklearn_vbjfa.model._followers import Folded, Link, fold, foldable
from sklearn_vbjfa.model._pinocchio import import_pinocchio
from sklearn_vbjfa.physical import body_scales, min_eigenvalue

# A body's smallest pseudo-inertia eigenvalue, in units of its own mass and length,
# below which the body has next to no extension in some direction; and below which a
# warning says so. (What was identified and projected lies between the two.)
_SOLID, _POSSIBLE = 1e-6, 1e-12
# How the one warning of what does not enter the model begins.
_LEFT_OUT = "The robot description"
# Robots of a hundred joints stay far below.
_DEEPEST, _MOST_ELEMENTS, _MOST_ATTRIBUTES = 100, 200_000, 1000
_MOST_JOINTS = 200
# Kinds of joints that have an axis, and elements that a fixed joint has no use for.
_AXIAL = ("revolute", "continuous", "prismatic")
_MOTION = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")


def load_model(model, base_orientation=None):
    """Return a pinocchio model whose joints all have one degree of freedom.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Path of a URDF or MJCF file, or a model.
    base_orientation : array-like of 4 floats, default=None
        Orientation in the world of a base that is free, a quaternion w, x, y, z; by
        default that of the description. A free joint that is the only one and carries
        all other joints, as of a quadruped or a humanoid, is held: the base stands
        still, and gravity pulls as it does in this orientation.

    Returns
    -------
    pinocchio.Model
        A copy of the model given, or the one read from the file. A joint that the
        URDF calls "continuous" is read as a revolute joint without limits, so that
        its position is one angle [rad]. Joints of an MJCF file are in the order of
        MuJoCo's coordinates.

    Raises
    ------
    ImportError
        If pinocchio is not installed.
    FileNotFoundError
        If the file does not exist.
    ValueError
        If another joint has not exactly one degree of freedom, there is no joint,
        joints close a loop, a link has a negative mass, or the orientation is no
        quaternion or that of a base that is not free.

    Warns
    -----
    UserWarning
        If something in the file does not enter the model: a body without mass or with
        an inertia that no solid body has is completed by a ball (see `solid_bodies`),
        joints have none of the springs, damping, friction and tendons of an MJCF file,
        and a joint that follows another one and carries joints that do not counts as a
        joint of its own. What other joints that follow move is held where it is while
        their leaders are at zero. A base that is held is named with its orientation.

    See Also
    --------
    sklearn_vbjfa.effects.BaseTilt : Identifies by how much a base is not level.

    Examples
    --------
    >>> import pinocchio
    >>> from sklearn_vbjfa import load_model
    >>> humanoid = pinocchio.buildSampleModelHumanoid()
    >>> robot = load_model(humanoid, [1, 1, 0, 0])  # lies on its side
    >>> humanoid.nv - robot.nv
    6
    """
    return load_folded(model, base_orientation).still


def load_folded(model, base_orientation=None):
    """As `load_model`, without the joints that follow others, and with their bodies."""
    pin = import_pinocchio()
    if isinstance(model, (str, os.PathLike)):
        path = Path(model)
        tree = parse_description(path)
        return _from_description(pin, tree, path, base=base_orientation)
    if isinstance(model, pin.Model):
        held, said = _held_model(pin, model, base_orientation)
        _warn(said, model.name, stacklevel=4)
        return Folded.without(_check_joints(held))
    raise TypeError(
        "model must be the path of a URDF or MJCF file or a pinocchio.Model, got "
        f"{type(model).__name__}."
    )


def load_reduced(path, moving, base_orientation=None):
    """As `load_model`, of a description of which only some joints move."""
    # The others are held at zero, and what they carry is one body with its parent. A
    # joint that follows one that moves is as in `load_model`, unless it is named.
    path, pin = Path(path), import_pinocchio()
    tree = parse_description(path)
    return _from_description(pin, tree, path, moving, base_orientation).still


def movable_joints(path):
    """Names of the joints that are neither fixed nor follow others, in file order."""
    # Those that follow others are listed if they cannot be folded, see `load_model`; a
    # free joint that is held there is not.
    path = Path(path)
    tree = parse_description(path)
    if _is_mjcf(tree, path):
        robot, _ = _mjcf_robot(tree, path)
        names = [joint.name for joint in robot.joints]
        carriers, links = _mjcf_reading.carriers(robot), robot.links
    else:
        _hold_base(tree, path)
        _fix_followers(tree, path)
        names = [
            joint.get("name")
            for joint in tree.getroot().findall("joint")
            if joint.get("type") != "fixed"
        ]
        carriers, links = _urdf_tree.carriers(tree), _mimics(tree, path)
    folded = foldable(carriers, links, path)
    return tuple(name for name in names if name not in folded)


def write_reduced(path, target, moving, base_orientation=None):
    """Write a copy of a description in which all but some joints are fixed at zero."""
    # Of an MJCF file the copy has the bodies and joints alone. Returns the joints that
    # were fixed, without that of a free base.
    path = Path(path)
    tree = parse_description(path)
    if _is_mjcf(tree, path):
        robot, _ = _mjcf_robot(tree, path, base_orientation)
        names = [joint.name for joint in robot.joints]
        reduced = _held_mjcf(robot, path, moving)
        _mjcf_reading.check_tree(reduced, path)
        _mjcf_reading.write_robot(reduced, target)
        still = [joint.name for joint in reduced.joints]
        return tuple(name for name in names if name not in still)
    _hold_base(tree, path, base_orientation)
    held = _hold_others(tree, path, moving)
    tree.write(target, encoding="utf-8", xml_declaration=True)
    return held


def _is_mjcf(tree, path):
    """Whether a description is one of MuJoCo and no URDF, by its root."""
    tag = tree.getroot().tag
    if tag not in ("robot", "mujoco"):
        raise ValueError(
            f"{str(path)!r} is no robot description: its outermost element is "
            f"<{tag[:60]}>; expected <robot> (URDF) or <mujoco> (MJCF)."
        )
    return tag == "mujoco"


def _mjcf_robot(tree, path, base=None):
    """Read what an MJCF file describes, `MjcfRobot`, and hold its base; what to say."""
    # base: orientation of a free base, None for that of the file.
    robot = _mjcf_reading.read_mjcf(tree.getroot(), path, parse_description)
    free = [joint.name for joint in robot.joints if joint.kind == "free"]
    name = _base.free_root(free, _mjcf_reading.carriers(robot))
    _base.check_free(name, base, repr(str(path)))
    if name is None:
        return robot, []
    turn = None if base is None else _base.rotation_of(base)
    robot, turn = _mjcf_reading.hold_base(robot, name, turn)
    return robot, [_base.said_of(name, turn)]


def _hold_base(tree, path, base=None):
    """Fix the free joint at the root of a URDF; what to say of it."""
    kinds = {
        joint.get("name"): joint.get("type")
        for joint in tree.getroot().findall("joint")
    }
    free = [name for name, kind in kinds.items() if kind == "floating"]
    name = _base.free_root(free, _urdf_tree.carriers(tree))
    _base.check_free(name, base, repr(str(path)))
    if name is None:
        return []
    turn = None if base is None else _base.rotation_of(base)
    joint, turn = _urdf_tree.turn_base(tree, name, turn)
    _fix(joint)
    return [_base.said_of(name, turn)]


def _held_model(pin, model, base=None):
    """Return a copy of a model without a free joint at its root; what to say of it."""
    names, joints = list(model.names), model.joints
    carriers = {
        name: names[above] if above else None
        for name, above in zip(names[1:], model.parents.tolist()[1:])
    }
    free = [
        name
        for name, joint in zip(names, joints)
        if joint.shortname() == "JointModelFreeFlyer"
    ]
    name = _base.free_root(free, carriers)
    _base.check_free(name, base, f"The model {model.name!r}")
    if name is None:
        return model.copy(), []
    at = names.index(name)
    placed = model.jointPlacements[at].rotation
    turn = placed if base is None else _base.rotation_of(base)
    q = pin.neutral(model)
    first = joints[at].idx_q + 3
    q[first : first + 4] = pin.Quaternion(placed.T @ turn).coeffs()
    return pin.buildReducedModel(model, [at], q), [_base.said_of(name, turn)]


def _held_mjcf(robot, path, moving):
    """Hold the joints of an MJCF robot that neither move nor follow those that do."""
    _check_known(moving, [joint.name for joint in robot.joints], path)
    # A follower that is named has columns and a torque of its own.
    links = {name: link for name, link in robot.links.items() if name not in moving}
    follow = _folded_by(moving, _mjcf_reading.carriers(robot), links, path)
    return replace(
        _mjcf_reading.held(robot, {*moving, *follow}),
        followers=tuple(one for one in robot.followers if one.name in follow),
    )


def _folded_by(moving, carriers, links, path):
    """Names of the followers that joints which move lead, if they can be folded."""
    # carriers, links: as for `foldable`, of all joints, whose mistakes it refuses.
    foldable(carriers, links, path)
    follow = set(links)
    while True:
        # What is held is one body with the joint that carries it, and leads nothing.
        left = {*moving, *follow}
        own = {name: links[name] for name in follow if links[name].leader in left}
        if len(own) == len(follow):
            above = {name: _next(carriers, name, left) for name in left}
            own = foldable(above, own, path)
        if len(own) == len(follow):
            return follow
        follow = set(own)


def _next(carriers, name, joints):
    """Return the nearest joint of some that carries a joint; None for the base."""
    name = carriers[name]
    while name is not None and name not in joints:
        name = carriers[name]
    return name


def _mimics(tree, path):
    """Joints of a URDF that follow others, name -> `Link`."""
    found = {}
    for joint in tree.getroot().findall("joint"):
        mimic = joint.find("mimic")
        if mimic is None or joint.get("type") not in _AXIAL:
            continue
        name, numbers = joint.get("name"), []
        for key, otherwise in (("multiplier", "1"), ("offset", "0")):
            try:
                number = float(mimic.get(key, otherwise))
            except ValueError:
                number = np.nan
            if not np.isfinite(number):
                raise ValueError(
                    f"{str(path)!r}: joint {name!r} follows another one with the {key} "
                    f"{mimic.get(key)[:40]!r}, which is no number; correct the "
                    "description."
                )
            numbers.append(number)
        leader = mimic.get("joint", "")
        found[name] = Link(leader=leader, multiplier=numbers[0], offset=numbers[1])
    return found


def is_urdf(source):
    """Whether a robot comes from a URDF file, whose text can be written again."""
    if not isinstance(source, (str, os.PathLike)):
        return False
    path = Path(source)
    return not _is_mjcf(parse_description(path), path)


def _check_joints(loaded):
    """Refuse a model with joints of other than one degree of freedom, or none."""
    if loaded.nv == 0:
        raise ValueError(
            "The robot model has no moving joint; expected a tree of revolute or "
            "prismatic joints. Check the joint types in the description."
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
            + ". A free joint is held only if there is no other one and it carries all "
            "other joints. Split spherical joints into three revolute ones, and lock "
            "what does not move with pinocchio.buildReducedModel (command line: "
            "--joints)."
        )
    return loaded


def load_text(text, path):
    """Return the model of a URDF that was read before, as `load_folded`, in silence."""
    pin, path = import_pinocchio(), Path(path)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", _LEFT_OUT, UserWarning)
        return _from_description(pin, _parsed(text.encode(), path), path).model


def load_quietly(path):
    """Return the robot of a file, as `load_folded`, of which everything was said."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", _LEFT_OUT, UserWarning)
        return load_folded(path)


def parse_description(path):
    """Read the XML of a robot description, `ElementTree`; refuse what is none."""
    if not path.is_file():
        raise FileNotFoundError(
            f"No robot description at {str(path)!r}; expected the path of a URDF or "
            "MJCF file."
        )
    return _parsed(path.read_bytes(), path)


def _parsed(content, path):
    """Parse the bytes of a description; path : what messages name."""
    try:
        _check_structure(content)
        return ElementTree.ElementTree(ElementTree.fromstring(content))
    except (ElementTree.ParseError, ExpatError, LookupError, ValueError) as error:
        raise ValueError(
            f"{str(path)!r} is not readable as URDF or MJCF (XML): {error}. "
            "A xacro file must be expanded first."
        ) from error


def _check_structure(content):
    """Refuse XML that is no robot's, before a parser makes a tree of it."""
    # Parsers call themselves once a level: a file of some hundred kilobytes can overrun
    # the stack of the process.
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
    """Fix all joints of a URDF but some and their followers; names of those fixed."""
    joints = {
        joint.get("name"): joint
        for joint in tree.getroot().findall("joint")
        if joint.get("type") != "fixed"
    }
    _check_known(moving, joints, path)
    for name in moving:
        # A follower that is named has columns and a torque of its own.
        for mimic in joints[name].findall("mimic"):
            joints[name].remove(mimic)
    links = _mimics(tree, path)
    follow = _folded_by(moving, _urdf_tree.carriers(tree), links, path)
    held = tuple(name for name in joints if name not in {*moving, *follow})
    for name in held:
        _fix(joints[name])
    return held


def _still(tree):
    """Names of the joints of a URDF that are fixed."""
    return {
        joint.get("name")
        for joint in tree.getroot().findall("joint")
        if joint.get("type") == "fixed"
    }


def _fix_followers(tree, path):
    """Fix the joints of a URDF that follow a fixed one: they do not move either."""
    while True:
        still, links = _still(tree), _mimics(tree, path)
        follow = [name for name, link in links.items() if link.leader in still]
        if not follow:
            return
        for joint in tree.getroot().findall("joint"):
            if joint.get("name") in follow:
                _fix(joint)


def _fix(joint):
    """Fix a joint of a URDF at zero."""
    joint.set("type", "fixed")
    for child in list(joint):
        if child.tag in _MOTION:
            joint.remove(child)


def _check_known(moving, names, path):
    """Refuse names that are no joints of a description."""
    unknown = [name for name in moving if name not in names]
    if unknown:
        raise ValueError(
            f"{str(path)!r}: the robot has no movable joint {unknown[0]!r}; it has "
            f"{', '.join(map(str, names)) or 'none'}."
        )


def _from_description(pin, tree, path, moving=None, base=None):
    """Build and check a robot, `Folded`; say what of it does not enter the model."""
    # moving: joints that are not held, None for all; base: orientation of a free base.
    if _is_mjcf(tree, path):
        robot, held = _mjcf_robot(tree, path, base)
        if moving is not None:
            robot = _held_mjcf(robot, path, moving)
        _check_number(len(robot.joints), path)
        _mjcf_reading.check_tree(robot, path)
        links, said = robot.links, [*held, *robot.left_out()]
        folded = foldable(_mjcf_reading.carriers(robot), links, path)
        full, between = _mjcf_reading.to_pinocchio(robot), robot.massless
    else:
        said = _hold_base(tree, path, base)
        if moving is not None:
            _hold_others(tree, path, moving)
        _check_masses(tree, path)
        _check_axes(tree, path)
        _urdf_tree.check_tree(tree, path)
        _fix_followers(tree, path)
        links, between = _mimics(tree, path), ()
        folded = foldable(_urdf_tree.carriers(tree), links, path)
        full = _build(pin, tree, path)
    found = fold(_check_joints(full), folded)
    apart = [name for name in links if name not in folded]
    _warn([*said, *_left_out(apart, full, between)], path.name)
    return found


def _warn(said, name, stacklevel=5):
    """Say in one warning what of a robot does not enter the model."""
    if said:
        text = f"{_LEFT_OUT} {name!r}: {'; '.join(said)}."
        warnings.warn(text, UserWarning, stacklevel=stacklevel)


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
    _check_number(len(moving), path)
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


def _check_number(n_joints, path):
    """Refuse more joints than robots have."""
    if n_joints > _MOST_JOINTS:
        raise ValueError(
            f"{str(path)!r}: the robot has {n_joints} moving joints, at most "
            f"{_MOST_JOINTS} can be identified; hold the others (--joints)."
        )


def _left_out(mimics, model, between=()):
    """Sentences on what of a description does not enter the model."""
    # mimics: joints that are to follow others and could not be folded; between: those
    # that move another joint and nothing else.
    names = joint_names(model)
    found = []
    if mimics:
        found.append(
            f"that {', '.join(mimics)} follow(s) another joint and carries joints that "
            "do not is not modelled, each counts as a joint with a torque of its own "
            "(to hold such joints at zero, leave them out of joint_names or --joints)"
        )
    possible = solid_bodies(nominal_parameters(model), _POSSIBLE)
    wrong = [name for name, good in zip(names, possible) if not good]
    between = [name for name in wrong if name in between]
    wrong = [name for name in wrong if name not in between]
    if between:
        found.append(
            f"between {', '.join(between)} and the next joint of the same body is no "
            "mass, a ball stands for it where the recording cannot tell"
        )
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
    """Names of the bodies that the joints move, in Pinocchio's order."""
    # Of several links that are fixed to each other, the one next to the joint; the
    # joint's own name where the description names none.
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
    """Axes (3, 3) of a joint's origin in its carrying link, as a URDF has them."""
    # Links that are fixed to each other are one body of the model, in whose axes the
    # placement is; that of the carrying link is among its frames. A model without
    # frames has the body's axes.
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
    """Inertial parameters (nv, 10) in the model, about the joint frames."""
    # Pinocchio's order: m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz [kg, kg m, kg
    # m^2].
    return np.array([body.toDynamicParameters() for body in model.inertias[1:]])


def solid_bodies(bodies, least=_SOLID):
    """Return which bodies (nv, 10) have mass and extension, (nv,) of bool."""
    # least: eigenvalue of the pseudo-inertia, in units of the body's mass and length.
    solid = bodies[:, 0] > 0
    mass, size = body_scales(bodies[solid])
    smallest = min_eigenvalue(bodies[solid], mass_scale=mass, length_scale=size)
    solid[solid] = smallest > least
    return solid
