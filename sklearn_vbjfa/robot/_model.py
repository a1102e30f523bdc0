"""Robot models: loading, and what this package asks of them."""

import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

INERTIAL_NAMES = (
    "m",
    "mc_x",
    "mc_y",
    "mc_z",
    "I_xx",
    "I_xy",
    "I_yy",
    "I_xz",
    "I_yz",
    "I_zz",
)


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
        If a joint has not exactly one degree of freedom, or there is no joint.
    """
    pin = import_pinocchio()
    if isinstance(model, (str, os.PathLike)):
        loaded = _read_urdf(pin, Path(model))
    elif isinstance(model, pin.Model):
        loaded = model.copy()
    else:
        raise TypeError(
            "model must be the path of a URDF file or a pinocchio.Model, got "
            f"{type(model).__name__}."
        )
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
            "pinocchio.buildReducedModel."
        )
    return loaded


def _read_urdf(pin, path):
    if not path.is_file():
        raise FileNotFoundError(
            f"No robot description at {str(path)!r}; expected the path of a URDF file."
        )
    try:
        tree = ElementTree.parse(path)
    except ElementTree.ParseError as error:
        raise ValueError(
            f"{str(path)!r} is not readable as URDF (XML): {error}. "
            "A xacro file must be expanded first."
        ) from error
    for joint in tree.iter("joint"):
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


def is_prismatic(model):
    """Return which joints are prismatic, ndarray of shape (nv,) of bool."""
    return np.array(
        [joint.shortname().startswith("JointModelP") for joint in model.joints[1:]]
    )


def nominal_parameters(model):
    """Inertial parameters in the model, ndarray of shape (nv, 10).

    Pinocchio's order: m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz [kg, kg m,
    kg m^2], about the joint frame.
    """
    return np.array([body.toDynamicParameters() for body in model.inertias[1:]])
