"""Nominal robot models of the measured sets.

A set comes with a URDF of its own, has one in a public collection, or is simple enough
to be built here from what its publishers say of it.
"""

import importlib
import importlib.metadata
import importlib.util
import sys
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pinocchio as pin

# File inside the example-robot-data collection, module of robot_descriptions.
_PUBLIC_DESCRIPTIONS = {
    "franka_panda": ("panda_description/urdf/panda.urdf", "panda_description"),
    "tiago": ("tiago_description/robots/tiago.urdf", "tiago_description"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "ur5_description"),
}


def find_description(dataset: str, folder: Path) -> str | None:
    """Find the URDF of a set in its folder or in example-robot-data."""
    path, _ = _PUBLIC_DESCRIPTIONS[dataset]
    candidates = [folder / Path(path).name]
    # The collection is found without importing it, as that loads Pinocchio.
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    candidates += [Path(x.locate()) for x in files if str(x).endswith(path)]
    candidates.append(Path(sys.prefix, "share/example-robot-data/robots", path))
    for candidate in candidates:
        if candidate.is_file():
            return str(candidate.resolve())
    return None


def kr300_description() -> str:
    """Path of the nominal KR300 model, which the package brings along."""
    package = resources.files("sklearn_vbjfa.datasets")
    return str(package.joinpath("robots", "kr300_nominal.urdf"))


def build_model(name: str, urdf: str | None, joint_names: Sequence[str]) -> "pin.Model":
    """Build the model of a recording; see `Recording.robot_model`."""
    try:
        import pinocchio as pin
    except ImportError as error:
        raise ImportError(
            'robot_model needs Pinocchio: pip install "sklearn-vbjfa[robot]"'
        ) from error

    if urdf is None and name in _BUILDERS:
        model = _BUILDERS[name](pin)
    else:
        from sklearn_vbjfa.model._loading import load_reduced

        model = load_reduced(urdf or _from_robot_descriptions(name), joint_names)
    names = list(model.names)[1:]
    if names != list(joint_names) or model.nq != model.nv:
        raise ValueError(
            f"The model of {name!r} must have the joints {tuple(joint_names)} with one "
            f"degree of freedom each, got {tuple(names)} with nq = {model.nq} and "
            f"nv = {model.nv}; use a description with the recorded joints."
        )
    return model


def _from_robot_descriptions(name: str) -> str:
    """Ask the robot_descriptions package, which may download, for a URDF."""
    if name not in _PUBLIC_DESCRIPTIONS:
        raise FileNotFoundError(
            f"Recording {name!r} comes without a robot description; set its urdf "
            "field with dataclasses.replace(recording, urdf=path), or fetch it with "
            "download_if_missing=True."
        )
    path, module = _PUBLIC_DESCRIPTIONS[name]
    if importlib.util.find_spec("robot_descriptions") is None:
        raise FileNotFoundError(
            f"No {Path(path).name} for {name!r}: pip install example-robot-data and "
            f"fetch again, or put the file into the folder of the set in data_home."
        )
    return importlib.import_module(f"robot_descriptions.{module}").URDF_PATH


def _chain(pin, names, joints, placements, inertias) -> "pin.Model":
    """Build a serial chain; placements are in the parent joint."""
    model = pin.Model()
    parent = 0
    for name, joint, placement, inertia in zip(names, joints, placements, inertias):
        parent = model.addJoint(parent, joint, placement, name)
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        model.addBodyFrame(f"{name}_link", parent, pin.SE3.Identity(), 0)
    return model


def _point_mass(pin, mass, lever) -> "pin.Inertia":
    """Mass [kg] hanging `lever` [m] below the joint."""
    return _rod(pin, mass, lever, 0.0)


def _rod(pin, mass, lever, inertia) -> "pin.Inertia":
    """Link with centre of mass `lever` below and inertia about it [kg m^2]."""
    return pin.Inertia(mass, np.array([0.0, 0.0, -lever]), inertia * np.eye(3))


def _emps(pin) -> "pin.Model":
    """Horizontal slide; the moving mass is the one published with the data."""
    joints, placements = [pin.JointModelPX()], [pin.SE3.Identity()]
    return _chain(pin, ["slide"], joints, placements, [_point_mass(pin, 95.1, 0.0)])


def _tflex(pin) -> "pin.Model":
    """Hinge about the vertical; the inertia of 1 is a placeholder."""
    joints, placements = [pin.JointModelRZ()], [pin.SE3.Identity()]
    return _chain(pin, ["hinge"], joints, placements, [_rod(pin, 1.0, 0.0, 1.0)])


def _xl330(pin) -> "pin.Model":
    """Load of 0.49 kg at 0.10 m on a horizontal axis, hanging at zero."""
    joints, placements = [pin.JointModelRY()], [pin.SE3.Identity()]
    return _chain(pin, ["servo"], joints, placements, [_point_mass(pin, 0.49, 0.1)])


def _double_pendulum(pin) -> "pin.Model":
    """Two links on parallel horizontal axes, hanging straight at zero."""
    # Parameters of the file model_parameters_A.0_model_2.0.yml of the publishers;
    # their inertias are about the joint.
    links = [
        # mass [kg], lever of the centre of mass [m], inertia about the joint
        (0.5593806151425046, 0.3, 0.053470810264216295),
        (0.6043459469186889, 0.18377686083653508, 0.02392374528789766),
    ]
    inertias = [_rod(pin, m, r, inertia - m * r**2) for m, r, inertia in links]
    elbow = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3]))
    return _chain(
        pin,
        ["shoulder", "elbow"],
        [pin.JointModelRX(), pin.JointModelRX()],
        [pin.SE3.Identity(), elbow],
        inertias,
    )


_BUILDERS = {
    "bam_xl330": _xl330,
    "dfki_double_pendulum": _double_pendulum,
    "emps": _emps,
    "tflex_1dof": _tflex,
}
