"""Robot models: read from a description or built, and written as text for saved files.

One warning lists the contents of a description that are not part of the model.
"""

import os
import warnings
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np

from sklearn_vbjfa._core import write_whole
from sklearn_vbjfa.model._mjcf_reading import read_mjcf
from sklearn_vbjfa.model._trees import (
    Description,
    carriers_of,
    check_joints,
    fold,
    foldable,
    hold_base,
    import_pinocchio,
    joint_names,
    nominal_parameters,
    rotation_of,
    solid_bodies,
    with_extension,
)
from sklearn_vbjfa.model._urdf import (
    hold_in_urdf,
    parse_description,
    parse_text,
    read_urdf,
    text_of_tree,
    write_tree,
)

# Least pseudo-inertia eigenvalue without warning, in units of a body's mass and length.
# (Identified and projected bodies lie between this and the limit of solid bodies.)
_CONSISTENT = 1e-12
# Masses and levers of the double pendulum's links.
_M1, _R1 = 0.5593806151425046, 0.3
_M2, _R2 = 0.6043459469186889, 0.18377686083653508
# Beginning of the warning about contents that are not part of the model.
_WARNING = "The robot description"


def load_model(model, base_orientation=None):
    """Return a pinocchio model whose joints all have one degree of freedom.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Path of a URDF or MJCF file, or a model.
    base_orientation : array-like of 4 floats, default=None
        Orientation in the world of a base that is free, a quaternion w, x, y, z; by
        default that of the description. A single free joint that carries all other
        joints, as in a quadruped or a humanoid, is fixed: the base does not move, and
        gravity has the direction that belongs to this orientation.

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
        joints close a loop, a link has a negative mass, or the orientation is not a
        quaternion or that of a base that is not free.

    Warns
    -----
    UserWarning
        If contents of the file are not part of the model: a body without mass or with
        an inertia that no solid body has is replaced by the nearest solid one, springs,
        damping, friction and tendons of an MJCF file are ignored, and a joint that
        follows another and carries joints that do not counts as a separate joint.
        Bodies that other mimic joints move are fixed at the pose where their leaders
        are at zero. The orientation of a fixed base is reported.

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
    """Load a model as `load_model` does; return it as `Folded`, with followers."""
    pin = import_pinocchio()
    if isinstance(model, (str, os.PathLike)):
        path = Path(model)
        return _build(parse_description(path), path, base=base_orientation)
    if isinstance(model, pin.Model):
        description = Description(model=model.copy(), label=f"The model {model.name!r}")
        robot, messages = hold_base(description, base_orientation)
        _warn(messages, model.name, stacklevel=4)
        return fold(check_joints(robot.model), {})
    raise TypeError(
        "model must be the path of a URDF or MJCF file or a pinocchio.Model, got "
        f"{type(model).__name__}."
    )


def load_reduced(path, moving, base_orientation=None):
    """Load a model as `load_model` does, in which only some joints move."""
    # The others are fixed at zero, and their bodies are joined to those of the parents.
    # A follower of a moving joint is treated as in `load_model`, unless it is named.
    path = Path(path)
    return _build(parse_description(path), path, moving, base_orientation).still


def movable_joints(path):
    """Names of the joints that are neither fixed nor follow others, in file order."""
    # With followers that cannot be folded (`load_model`), without a base's free joint.
    path = Path(path)
    robot, _ = hold_base(_read(parse_description(path), path), None)
    folded = foldable(carriers_of(robot.model), robot.mimics, robot.label)
    return tuple(name for name in robot.in_file_order if name not in folded)


def write_reduced(path, target, moving, base_orientation=None):
    """Write a copy of a description in which only some joints are not fixed at zero."""
    # The copy of an MJCF file is a URDF with its bodies and joints. Returns the fixed
    # joints, without that of a free base.
    path = Path(path)
    tree = parse_description(path)
    is_mjcf = _is_mjcf(tree, path)
    whole = _read(tree, path)
    robot, _ = hold_base(whole, base_orientation)
    reduced = robot.with_moving(moving)
    if is_mjcf:
        reduced.check()
        standard = import_pinocchio().Model().gravity.linear
        if not np.allclose(reduced.model.gravity.linear, standard):
            raise ValueError(
                f"{reduced.label} has another gravity than {standard} m/s^2, which a "
                "copy without the held joints would lose; take them out of the file "
                "itself."
            )
        write_whole(target, text_of_tree(reduced.model, reduced.mimics))
    else:
        tree, base = parse_description(path), None
        if base_orientation is not None:
            (name,) = whole.free
            placement = whole.model.jointPlacements[whole.model.getJointId(name)]
            base = name, placement.rotation.T @ rotation_of(base_orientation)
        hold_in_urdf(tree, reduced.names, reduced.mimics, base)
        write_tree(tree, target)
    return tuple(name for name in robot.in_file_order if name not in reduced.names)


def description_text(folded):
    """Return the URDF of a robot as text, XML without declaration."""
    return folded.text or text_of_tree(folded.full, folded.mimics)


def load_text(text, path):
    """Return the model of a saved URDF as `load_folded` does, without warning."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", _WARNING, UserWarning)
        return _build(parse_text(text.encode(), path), Path(path)).model


def _is_mjcf(tree, path):
    tag = tree.getroot().tag
    if tag not in ("robot", "mujoco"):
        raise ValueError(
            f"{str(path)!r} is not a robot description: its outermost element is "
            f"<{tag[:60]}>; expected <robot> (URDF) or <mujoco> (MJCF)."
        )
    return tag == "mujoco"


def _read(tree, path):
    if _is_mjcf(tree, path):
        return read_mjcf(path, tree.getroot().get("model", "robot"))
    return read_urdf(tree, path)


def _build(tree, path, moving=None, base=None):
    """Build and check a robot, `Folded`; warn about contents that are not modelled."""
    # moving: joints that are not fixed, None for all; base: orientation of a free base.
    is_urdf = not _is_mjcf(tree, path)
    text = ElementTree.tostring(tree.getroot(), "unicode") if is_urdf else None
    robot, messages = hold_base(_read(tree, path), base)
    if moving is not None:
        robot = robot.with_moving(moving)
    robot.check()
    mimics = robot.mimics
    folded = foldable(carriers_of(robot.model), mimics, robot.label)
    result = replace(fold(robot.model, folded), text=text)
    separate = [name for name in mimics if name not in folded]
    messages = [*messages, *robot.left_out]
    _warn([*messages, *_left_out(separate, result.full)], path.name)
    for built in (result.model, result.still):
        with_extension(built, _CONSISTENT)
    return result


def _warn(messages, name, stacklevel=5):
    """Emit one warning about contents of a robot that are not modelled."""
    if messages:
        text = f"{_WARNING} {name!r}: {'; '.join(messages)}."
        warnings.warn(text, UserWarning, stacklevel=stacklevel)


def _left_out(mimics, model):
    """Return messages about contents of a description that are not modelled."""
    # mimics: followers that could not be folded
    names = joint_names(model)
    messages = []
    if mimics:
        messages.append(
            f"that {', '.join(mimics)} follow(s) another joint and carries joints that "
            "do not is not modelled, each counts as a joint with a separate torque"
        )
    consistent = solid_bodies(nominal_parameters(model), _CONSISTENT)
    wrong = [name for name, good in zip(names, consistent) if not good]
    if wrong:
        messages.append(
            f"the body of {', '.join(wrong)} has no mass, or an inertia that no solid "
            "body can have; where the recording does not determine it, next to none or "
            "the nearest solid body is used (correct the inertial element of its link, "
            "unless it is between joints of one body)"
        )
    return messages


# -- nominal models of the measured sets -----------------------------------------------


def build_model(name, urdf, joint_names):
    """Build the model of a recording; see `Recording.robot_model`."""
    pin = import_pinocchio()
    if urdf is None and name in _CHAINS:
        model, parent = pin.Model(), 0
        for joint, joint_type, distance, mass, lever, moment in _CHAINS[name]:
            placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, -distance]))
            joint_type = getattr(pin, f"JointModel{joint_type}")()
            parent = model.addJoint(parent, joint_type, placement, joint)
            centre = np.array([0.0, 0.0, -lever])
            inertia = pin.Inertia(mass, centre, moment * np.eye(3))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            model.addBodyFrame(f"{joint}_link", parent, pin.SE3.Identity(), 0)
    elif urdf is None:
        raise FileNotFoundError(
            f"Recording {name!r} comes without a robot description. Of a measured set, "
            "pip install example-robot-data and fetch it again, or put the URDF into "
            "its folder in data_home; else set the field urdf with "
            "dataclasses.replace(recording, urdf=path)."
        )
    else:
        model = load_reduced(urdf, joint_names)
    names = list(model.names)[1:]
    if names != list(joint_names) or model.nq != model.nv:
        raise ValueError(
            f"The model of {name!r} must have the joints {tuple(joint_names)} with one "
            f"degree of freedom each, got {tuple(names)} with nq = {model.nq} and "
            f"nv = {model.nv}; use a description with the recorded joints."
        )
    return model


# Serial chains: joint, type, distance below the previous joint [m]; mass [kg], centre
# of mass below the joint [m], and moment of inertia about the centre [kg m^2].
_CHAINS = {
    # A load on a horizontal axis.
    "bam_xl330": [("servo", "RY", 0.0, 0.49, 0.1, 0.0)],
    # From the publishers' model_parameters_A.0_model_2.0.yml, with inertias about the
    # joint.
    "dfki_double_pendulum": [
        ("shoulder", "RX", 0.0, _M1, _R1, 0.053470810264216295 - _M1 * _R1**2),
        ("elbow", "RX", 0.3, _M2, _R2, 0.02392374528789766 - _M2 * _R2**2),
    ],
    # A horizontal slide; the moving mass is the one published with the data.
    "emps": [("slide", "PX", 0.0, 95.1, 0.0, 0.0)],
    # A hinge about the vertical; the moment is a placeholder.
    "tflex_1dof": [("hinge", "RZ", 0.0, 1.0, 0.0, 1.0)],
}
