"""Writing identified bodies, friction and axes into a robot description."""

import os
import xml.etree.ElementTree as ElementTree

import numpy as np

from sklearn_vbjfa.model._loading import import_pinocchio, joint_names
from sklearn_vbjfa.model._xml import add_comment, number, numbers, write_tree
from sklearn_vbjfa.physical import inertia_matrix


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


def _set_inertial(link, phi):
    mass, com, inertia = body_about_com(phi)
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ElementTree.SubElement(link, "inertial")
    origin = ElementTree.SubElement(inertial, "origin")
    origin.set("xyz", numbers(com))
    origin.set("rpy", "0 0 0")
    ElementTree.SubElement(inertial, "mass").set("value", number(mass))
    tensor = ElementTree.SubElement(inertial, "inertia")
    for name, i, j in (
        ("ixx", 0, 0),
        ("ixy", 0, 1),
        ("ixz", 0, 2),
        ("iyy", 1, 1),
        ("iyz", 1, 2),
        ("izz", 2, 2),
    ):
        tensor.set(name, number(inertia[i, j]))


def _turn_origin(joint, rotation):
    """Turn the origin of a joint, and with it what the joint carries."""
    rpy = import_pinocchio().rpy
    origin = joint.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(joint, "origin")
        origin.set("xyz", "0 0 0")
    given = np.array(origin.get("rpy", "0 0 0").split(), dtype=float)
    turned = rpy.matrixToRpy(rpy.rpyToMatrix(given) @ rotation)
    origin.set("rpy", numbers(turned))


def write_urdf(
    source,
    target,
    model,
    parameters,
    friction,
    note="",
    turned=None,
    followers=None,
):
    """Write a copy of a URDF with other inertias and friction."""
    # parameters (nv, 10 + n_friction) [kg, kg m, kg m^2]; friction: their names, of
    # which "viscous" and "coulomb" have a place in URDF; note: comment at the top;
    # turned: rotation matrices (3, 3) of joints' origins, in their own axes; followers:
    # bodies (10,) of joints that follow others, by name.
    followers = {} if followers is None else followers
    if is_text(source):
        tree, like = ElementTree.ElementTree(ElementTree.fromstring(source)), None
    else:
        tree, like = ElementTree.parse(source), source
    root = tree.getroot()
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
        if name in followers:
            # Its friction is felt as that of its leader.
            continue
        values = dict(zip(friction, row[10:]))
        dynamics = joint.find("dynamics")
        if dynamics is None:
            dynamics = ElementTree.SubElement(joint, "dynamics")
        dynamics.set("damping", number(values.get("viscous", 0.0)))
        dynamics.set("friction", number(values.get("coulomb", 0.0)))
    write_tree(tree, target, like)


def is_text(source):
    """Whether a description is given as its text, and not as a path."""
    return isinstance(source, str) and source.lstrip().startswith("<")


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


def write_identified(
    source,
    path,
    model,
    bodies,
    friction,
    min_eigenvalues,
    note="",
    turned=None,
    followers=None,
):
    """Write a URDF as `write_urdf`, or say why there can be none of these bodies."""
    if not isinstance(source, (str, os.PathLike)):
        raise ValueError(
            "to_urdf needs the URDF that the robot came from: give its path as "
            "`model` (a pinocchio.Model does not keep the links' shapes)."
        )
    check_possible(model, min_eigenvalues, "a URDF")
    write_urdf(source, path, model, bodies, friction, note, turned, followers)
