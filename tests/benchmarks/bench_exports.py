"""Robots written as URDF and MJCF and read back: torques by other programs.

Run ``python tests/benchmarks/bench_exports.py [--states N] [--write]``.

Ten robots of ``example-robot-data``: arms, two-armed robots, a hand, a quadruped and
humanoids with their base held; among their joints continuous, prismatic and mimicking
ones. Bodies are random clouds of eight point masses, viscous and Coulomb friction,
rotor inertia, an offset and a spring of each joint are random as well; two pairs of
neighbouring joints rub and are geared together.

Truth: Pinocchio's recursive Newton-Euler algorithm on those bodies, plus the friction
by its definition, in random states within the joint limits, accelerations up to
30 rad/s^2 and speeds from 0.1 to 3 rad/s (m/s^2, m/s).

- URDF: read by Pinocchio's own parser, damping and friction from ``<dynamics>``;
  compared without what the file says that it leaves out.
- MJCF: ``mj_inverse`` of MuJoCo, less the forces of the motors without control; with
  everything, and without dry friction (``mjDSBL_FRICTIONLOSS``).

Error: the largest over all joints and states, over the spread of the joint's torque.
The seed of robot k is k.
"""

import importlib.metadata
import tempfile
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from _report import add_root_to_path, parser, publish, rst_table

add_root_to_path()

from sklearn_vbjfa.effects import Coupling, Spring  # noqa: E402
from sklearn_vbjfa.model import (  # noqa: E402
    import_pinocchio,
    is_prismatic,
    load_reduced,
)
from sklearn_vbjfa.physical import min_eigenvalue  # noqa: E402
from sklearn_vbjfa.robot._exports import to_mjcf, to_urdf  # noqa: E402
from sklearn_vbjfa.simulation import TorqueModel  # noqa: E402
from tests.model._mujoco import drive_torques  # noqa: E402
from tests.model._robots import random_body  # noqa: E402

ROBOTS = (
    "ur_description/urdf/ur10_robot.urdf",
    "kinova_description/robots/kinova.urdf",
    "xarm_description/urdf/xarm7.urdf",
    "baxter_description/urdf/baxter.urdf",
    "pr2_description/urdf/pr2.urdf",
    "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "anymal_c_simple_description/urdf/anymal.urdf",
    "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "talos_data/robots/talos_full_v2.urdf",
    "romeo_description/urdf/romeo.urdf",
)
FRICTION = ("viscous", "coulomb", "offset", "rotor_inertia")
HEADERS = [
    "robot",
    "joints",
    "of these continuous",
    "prismatic",
    "mimicking",
    "URDF",
    "MJCF, no dry friction",
    "MJCF",
]


def descriptions():
    """Paths of the robots that are installed, name in the collection -> path."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return {}
    found = {}
    for file in files:
        for name in ROBOTS:
            if str(file).endswith(f"robots/{name}") and Path(file.locate()).is_file():
                found[name] = str(Path(file.locate()).resolve())
    return {name: found[name] for name in ROBOTS if name in found}


def draw(path, seed):
    """Draw an identified robot with the geometry of a description.

    Parameters
    ----------
    path : str
        URDF.
    seed : int
        Seed.

    Returns
    -------
    TorqueModel
        Robot.
    """
    rng = np.random.default_rng(seed)
    with warnings.catch_warnings():
        # Of bodies without mass, which are drawn here.
        warnings.simplefilter("ignore", UserWarning)
        # All are named: what mimics another joint is one of its own.
        joints = ElementTree.parse(path).findall("joint")
        names = [j.get("name") for j in joints if j.get("type") != "fixed"]
        model = load_reduced(path, names)
    nv = model.nv
    uses = [
        (Spring(j), np.array([rng.uniform(1.0, 9.0), rng.normal()])) for j in range(nv)
    ]
    parents = [int(k) - 1 for k in model.parents][1:]
    slides = is_prismatic(model)
    pairs = [
        (parents[j], j)
        for j in range(nv)
        if parents[j] >= 0 and slides[j] == slides[parents[j]]
    ]
    for low, high in pairs[:2]:
        # Friction and inertia of one motor at the sum of two speeds.
        coef = rng.uniform(0.1, 0.5, size=3)
        uses += [(Coupling(low, high, "sum"), coef), (Coupling(high, low, "sum"), coef)]
    return TorqueModel(
        model=model,
        bodies=np.array([random_body(rng) for _ in range(nv)]),
        friction_names=FRICTION,
        friction=np.column_stack(
            [
                rng.uniform(0.1, 5.0, size=nv),
                rng.uniform(0.1, 5.0, size=nv),
                rng.normal(size=nv),
                rng.uniform(0.01, 1.0, size=nv),
            ]
        ),
        effects=tuple(effect for effect, _ in uses),
        coefficients=tuple(coef for _, coef in uses),
        gains=np.ones(nv),
    )


def states_of(robot, n, rng):
    """Random states (n, 3 nv) within the limits, sums of coupled speeds not small."""
    nv = robot.n_joints
    low = np.maximum(robot.model.lowerPositionLimit, -np.pi)
    high = np.minimum(robot.model.upperPositionLimit, np.pi)
    free = ~(low < high)
    low, high = np.where(free, -np.pi, low), np.where(free, np.pi, high)
    q = rng.uniform(low, high, size=(n, nv))
    # Neighbours move in the same direction.
    v = rng.uniform(0.1, 3.0, size=(n, nv)) * rng.choice([-1, 1], size=(n, 1))
    a = rng.uniform(-30.0, 30.0, size=(n, nv))
    return np.hstack([q, v, a])


def smooth_and_dry(robot, states):
    """Torques of a robot by definition: rigid bodies, what a URDF has, and the rest.

    Parameters
    ----------
    robot : TorqueModel
        Robot.
    states : ndarray of shape (n, 3 * nv)
        States.

    Returns
    -------
    dict of str to ndarray of shape (n, nv)
        "rigid", "viscous", "dry" of joints, "rest" of smooth, "rest_dry".
    """
    pin = import_pinocchio()
    model, nv = robot.model.copy(), robot.n_joints
    for j, body in enumerate(robot.bodies):
        model.inertias[j + 1] = pin.Inertia.FromDynamicParameters(body)
    data = model.createData()
    q, v, a = np.split(states, 3, axis=1)
    viscous, coulomb, offset, rotor = robot.friction.T
    rest, rest_dry = offset + rotor * a, np.zeros_like(v)
    for effect, coef in zip(robot.effects, robot.coefficients):
        j = effect.joint
        if isinstance(effect, Spring):
            rest[:, j] += coef[0] * q[:, j] + coef[1]
        else:
            w, dw = v[:, j] + v[:, effect.other], a[:, j] + a[:, effect.other]
            rest[:, j] += coef[0] * w + coef[2] * dw
            rest_dry[:, j] += coef[1] * np.sign(w)
    return {
        "rigid": np.array([pin.rnea(model, data, *x.reshape(3, nv)) for x in states]),
        "viscous": viscous * v,
        "dry": coulomb * np.sign(v),
        "rest": rest,
        "rest_dry": rest_dry,
    }


def urdf_torques(path, states, names):
    """Torques of a URDF by Pinocchio's own parser and its ``<dynamics>``.

    Parameters
    ----------
    path : str or os.PathLike
        File.
    states : ndarray of shape (n, 3 * nv)
        States, joints in the order of `names`.
    names : sequence of str
        Joints.

    Returns
    -------
    ndarray of shape (n, nv)
        Torques.
    """
    pin = import_pinocchio()
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    joints = {j.get("name"): j for j in ElementTree.parse(path).findall("joint")}
    dynamics = [joints[name].find("dynamics") for name in names]
    damping, friction = (
        np.array([float(one.get(key)) for one in dynamics])
        for key in ("damping", "friction")
    )
    order = [model.joints[model.getJointId(name)].idx_v for name in names]
    found = []
    for row in states:
        q, v, a = (np.zeros(model.nv) for _ in range(3))
        for own, values in zip((q, v, a), row.reshape(3, -1)):
            own[order] = values
        # A continuous joint has the cosine and the sine of its angle.
        place = pin.integrate(model, pin.neutral(model), q)
        own = pin.rnea(model, data, place, v, a)[order]
        speed = row.reshape(3, -1)[1]
        found.append(own + damping * speed + friction * np.sign(speed))
    return np.array(found)


def worst(found, expected):
    """Largest error over the spread of a joint's torque."""
    return float((np.abs(found - expected) / expected.std(axis=0)).max())


def run(name, path, seed, n_states):
    """Write a robot both ways, read it back, and compare; a row of the table.

    Parameters
    ----------
    name : str
        Name in the collection.
    path : str
        URDF.
    seed, n_states : int
        Seed, and number of states.

    Returns
    -------
    row : list of str
        Row of `HEADERS`.
    errors : dict of str to float
        "urdf", "smooth", "mjcf".
    """
    robot = draw(path, seed)
    states = states_of(robot, n_states, np.random.default_rng(seed))
    truth = smooth_and_dry(robot, states)
    solid = min_eigenvalue(robot.bodies)
    with tempfile.TemporaryDirectory() as folder:
        urdf, mjcf = Path(folder, "robot.urdf"), Path(folder, "robot.xml")
        to_urdf(urdf, path, robot, solid)
        left = to_mjcf(mjcf, robot, solid)
        if left:
            raise AssertionError(f"left out of {name}: {', '.join(map(str, left))}")
        smooth = truth["rigid"] + truth["viscous"] + truth["rest"]
        errors = {
            "urdf": worst(
                urdf_torques(urdf, states, robot.joint_names),
                truth["rigid"] + truth["viscous"] + truth["dry"],
            ),
            "smooth": worst(drive_torques(mjcf, states, friction=False), smooth),
            "mjcf": worst(
                drive_torques(mjcf, states),
                smooth + truth["dry"] + truth["rest_dry"],
            ),
        }
    joints = {j.get("name"): j for j in ElementTree.parse(path).findall("joint")}
    moving = [joints[one] for one in robot.joint_names]
    row = [
        Path(name).stem,
        str(robot.n_joints),
        str(sum(j.get("type") == "continuous" for j in moving)),
        str(sum(j.get("type") == "prismatic" for j in moving)),
        str(sum(j.find("mimic") is not None for j in moving)),
        *(f"{error:.0e}" for error in errors.values()),
    ]
    return row, errors


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--states", type=int, default=200)
    arguments = arguments.parse_args(argv)
    found = descriptions()
    rows = [
        run(name, path, ROBOTS.index(name), arguments.states)[0]
        for name, path in found.items()
    ]
    version = importlib.metadata.version("mujoco")
    text = (
        f"{len(rows)} robots, {arguments.states} states each, MuJoCo {version}.\n\n"
        f"{rst_table(rows, HEADERS)}"
    )
    publish("exports", text, write=arguments.write)


if __name__ == "__main__":
    main()
