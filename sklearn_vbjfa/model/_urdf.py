"""Writing identified bodies, friction and axes into a robot description."""

import os
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from sklearn_vbjfa.model._loading import import_pinocchio, joint_names
from sklearn_vbjfa.physical import inertia_matrix


def _body(phi):
    """Mass, centre of mass and inertia about it, from ten inertial parameters."""
    mass = phi[0]
    if not mass > 0:
        raise ValueError(
            f"A body has the mass {mass:.6g}: only physically consistent parameters "
            'can be written as URDF. Use projector="default".'
        )
    com = phi[1:4] / mass
    # parallel axes
    shift = mass * (com @ com * np.eye(3) - np.outer(com, com))
    return mass, com, inertia_matrix(phi) - shift


def _set_inertial(link, phi):
    mass, com, inertia = _body(phi)
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ElementTree.SubElement(link, "inertial")
    origin = ElementTree.SubElement(inertial, "origin")
    origin.set("xyz", " ".join(repr(float(c)) for c in com))
    origin.set("rpy", "0 0 0")
    ElementTree.SubElement(inertial, "mass").set("value", repr(float(mass)))
    tensor = ElementTree.SubElement(inertial, "inertia")
    for name, i, j in (
        ("ixx", 0, 0),
        ("ixy", 0, 1),
        ("ixz", 0, 2),
        ("iyy", 1, 1),
        ("iyz", 1, 2),
        ("izz", 2, 2),
    ):
        tensor.set(name, repr(float(inertia[i, j])))


def _turn_origin(joint, rotation):
    """Turn the origin of a joint, and with it what the joint carries."""
    rpy = import_pinocchio().rpy
    origin = joint.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(joint, "origin")
        origin.set("xyz", "0 0 0")
    given = np.array(origin.get("rpy", "0 0 0").split(), dtype=float)
    turned = rpy.matrixToRpy(rpy.rpyToMatrix(given) @ rotation)
    origin.set("rpy", " ".join(repr(float(angle)) for angle in turned))


def write_urdf(source, target, model, parameters, friction, note="", turned=None):
    """Write a copy of a URDF with other inertias and friction.

    Parameters
    ----------
    source, target : str or os.PathLike
        Files to read and to write.
    model : pinocchio.Model
        Model of the source.
    parameters : ndarray of shape (nv, 10 + n_friction)
        Inertial parameters [kg, kg m, kg m^2] and friction of each joint.
    friction : tuple of str
        Names of the friction columns; "viscous" and "coulomb" go to the joint's
        dynamics, others have no place in URDF.
    note : str, default=""
        Comment at the top of the robot.
    turned : mapping of str to ndarray of shape (3, 3), default=None
        Joints whose origin is turned, in its own axes, by a rotation matrix.
    """
    tree = ElementTree.parse(source)
    root = tree.getroot()
    if note:
        # Two hyphens would end the comment.
        lines = note.replace("--", "- -").replace("\n", "\n    ")
        root.insert(0, ElementTree.Comment(f" {lines} "))
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    links = {link.get("name"): link for link in root.findall("link")}
    names = joint_names(model)
    missing = [name for name in names if name not in joints]
    if missing:
        raise ValueError(f"The URDF has no joint named {', '.join(missing)}.")
    moving = set(names)
    fixed_children = {}
    for joint in joints.values():
        if joint.get("name") not in moving:
            parent = joint.find("parent").get("link")
            fixed_children.setdefault(parent, []).append(
                joint.find("child").get("link")
            )
    for name, row in zip(names, parameters):
        joint = joints[name]
        child = joint.find("child").get("link")
        _set_inertial(links[child], row[:10])
        # What is fixed to the link is one body with it: its inertia is in the sum.
        waiting = list(fixed_children.get(child, []))
        while waiting:
            link = waiting.pop()
            for inertial in links[link].findall("inertial"):
                links[link].remove(inertial)
            waiting += fixed_children.get(link, [])
        if turned and name in turned:
            _turn_origin(joint, turned[name])
        values = dict(zip(friction, row[10:]))
        dynamics = joint.find("dynamics")
        if dynamics is None:
            dynamics = ElementTree.SubElement(joint, "dynamics")
        dynamics.set("damping", repr(float(values.get("viscous", 0.0))))
        dynamics.set("friction", repr(float(values.get("coulomb", 0.0))))
    ElementTree.indent(tree)
    target = Path(target)
    # Written beside the target and moved: an interrupted run leaves no half of a file.
    handle, temporary = tempfile.mkstemp(dir=target.parent, suffix=".urdf")
    try:
        with os.fdopen(handle, "wb") as file:
            tree.write(file, encoding="utf-8", xml_declaration=True)
        # A temporary file is private; the description is as readable as its source.
        os.chmod(temporary, Path(source).stat().st_mode & 0o666)
        os.replace(temporary, target)
    except BaseException:
        os.unlink(temporary)
        raise


def write_identified(
    source, path, model, bodies, friction, min_eigenvalues, note="", turned=None
):
    """Write a URDF with identified bodies, or say why there can be none.

    Parameters
    ----------
    source : str, os.PathLike or other
        Robot description that the robot came from.
    path : str or os.PathLike
        File to write.
    model : pinocchio.Model
        Robot.
    bodies : ndarray of shape (nv, 10 + len(friction))
        Inertial parameters and friction of each joint.
    friction : tuple of str
        Names of the friction columns.
    min_eigenvalues : ndarray of shape (nv,)
        Smallest pseudo-inertia eigenvalue of each body, positive where it can exist.
    note : str, default=""
        What a reader of the file has to know, written into it as a comment.
    turned : mapping of str to ndarray of shape (3, 3), default=None
        Joints whose origin is turned, see `write_urdf`.
    """
    if not isinstance(source, (str, os.PathLike)):
        raise ValueError(
            "to_urdf needs the URDF that the robot came from: give its path as "
            "`model` (a pinocchio.Model does not keep the links' shapes)."
        )
    if (min_eigenvalues <= 0).any():
        names = joint_names(model)
        bad = [name for name, low in zip(names, min_eigenvalues) if low <= 0]
        raise ValueError(
            f"The bodies of {', '.join(bad)} are not physically consistent, and a "
            'URDF must be: identify with projector="default".'
        )
    write_urdf(source, path, model, bodies, friction, note, turned)
