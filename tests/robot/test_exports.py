"""What of an identified robot goes into URDF and MJCF, and what is said of the rest."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier, effects
from sklearn_vbjfa.physical import min_eigenvalue
from sklearn_vbjfa.robot import to_mjcf
from sklearn_vbjfa.robot._exports import without_place
from tests.model._mujoco import drive_torques, moving_states
from tests.model._robots import random_tree
from tests.model.test_mjcf import assert_same, rigid
from tests.simulation._machines import machine


def torques(robot, states):
    """Torques of a robot by the definition of its effects, one by one."""
    motion = effects.Motion(
        **dict(zip("qva", np.split(states, 3, axis=1))), t=0.01 * np.arange(len(states))
    )
    found = rigid(robot.model, robot.bodies, states)
    for name, column in zip(robot.friction_names, robot.friction.T):
        plain = effects.declared_columns((name,), motion.v, motion.a)
        found += column * plain[:, :, 0]
    for effect, coef in zip(robot.effects, robot.coefficients):
        found += effect.in_all(effect.columns(motion), robot.n_joints) @ coef
    return found


def test_all_that_mjcf_can_hold_is_exact(tmp_path):
    """Declared and found coefficients add up; nothing is left out."""
    rng = np.random.default_rng(0)
    robot = machine(
        *random_tree(rng, 4, ("RX", "RY", "RZ")),
        effects=[
            (effects.Viscous(1), [0.4]),
            (effects.Coulomb(1), [0.7]),
            (effects.Coulomb(2), [-0.2]),
            (effects.Offset(0), [1.5]),
            (effects.Offset(3), [-0.5]),
            (effects.RotorInertia(2), [0.3]),
            (effects.Spring(0), [5.0, 2.0]),
            (effects.Spring(1), [-4.0, 1.0]),
            (effects.AsymmetricFriction(3), [0.6, 0.0]),
            (effects.CouplingSpring(1, 3, ratio=-0.7), [6.0, 0.9]),
            (effects.CouplingSpring(0, 2, ratio=0.4), [-2.0, 0.5]),
        ],
        friction={
            "viscous": [1.0, 2.0, 3.0, 4.0],
            "coulomb": 0.5,
            "offset": [0.1, 0.2, 0.3, 0.4],
            "rotor_inertia": [0.2, 0.1, 0.3, 0.2],
        },
    )
    path = tmp_path / "robot.xml"
    assert to_mjcf(path, robot, min_eigenvalue(robot.bodies)) == ()
    states = moving_states(np.random.default_rng(5), 200, robot.n_joints)
    assert_same(drive_torques(path, states), torques(robot, states))


def test_what_a_file_lacks_on_several_joints_changes_its_motion():
    class OnBoth(effects.OnAllJoints):
        coefficients = ("k",)

    assert without_place(OnBoth(), np.ones(1)) == [1.0]
    # No simulation has it, of the robot or of the file.
    assert without_place(effects.Elastic(), np.ones(1)) == [0.0]


@pytest.fixture(scope="module")
def robot(moved):
    """Identify a robot with effects of the model, and with others."""
    robot = RobotIdentifier(
        moved.urdf,
        dt=moved.dt,
        friction=("viscous", "coulomb", "offset", "rotor_inertia"),
        effects=[
            effects.BaseTilt(),
            effects.JointZero(2),
            effects.JointAxis(3),
            effects.TorqueGain(1),
            effects.Spring(4),
            effects.Stribeck(0, vs=0.3),
        ],
    )
    return robot.fit(moved.q, moved.tau)


def without(robot, names):
    """Copy of a fitted identifier without coefficients of effects."""
    other = RobotIdentifier(robot.model, friction=("viscous",))
    other.__dict__.update(robot.__dict__)
    other.set_parameters(robot.theta_.copy(), robot.known_)
    for k, parameter in enumerate(robot.parameter_names_):
        if any(f":{name}:" in parameter for name in names):
            other.theta_[k] = 0.0
    return other


@pytest.mark.filterwarnings("ignore:.*outside.*:UserWarning")
@pytest.mark.parametrize("given", ["path", "model"])
def test_mujoco_computes_what_predict_does(given, robot, moved, tmp_path):
    """Gains, a leaning base, an encoder's zero and a turned axis are in the file."""
    path = tmp_path / "identified.xml"
    if given == "model":
        robot = without(robot, [])
        robot.model = moved.robot_model()
    left = robot.to_mjcf(path)
    assert sum(one.name == "stribeck" for one in left) == 1
    states = moving_states(np.random.default_rng(0), 200, 6)
    plain = without(robot, ["stribeck"])
    dropped = {(one.name, one.joint) for one in left} - {("stribeck", 0)}
    for name, joint in dropped:
        # Negative coefficients of what no joint does by itself.
        at = robot.parameter_names_.index(f"{robot.joint_names_[joint]}:{name}")
        assert plain.theta_[at] < 0
        plain.theta_[at] = 0.0
    # That of the first joint is fitted again to what is left out of it.
    found, expected = drive_torques(path, states), plain.predict(states)
    assert_same(found[:, 1:], expected[:, 1:], 1e-6)
    text = path.read_text()
    assert 'ref="0.05' in text
    assert "joint_2 reads 1.1" in text


def test_friction_that_was_found_is_in_the_urdf(moved, tmp_path):
    """What a search adds counts as what was declared."""
    added = [effects.Coulomb(2), effects.Viscous(3), effects.Coulomb(4)]
    robot = RobotIdentifier(moved.urdf, dt=moved.dt, friction=(), effects=added)
    robot.fit(moved.q, moved.tau)
    path = tmp_path / "identified.urdf"
    left = {(one.name, one.joint) for one in robot.to_urdf(path)}
    values = dict(zip(robot.parameter_names_, robot.theta_))
    by_name = {j.get("name"): j for j in ElementTree.parse(path).findall("joint")}
    for joint, name in enumerate(robot.joint_names_):
        dynamics = by_name[name].find("dynamics")
        for kind, key, c in ("viscous", "damping", "Fv"), ("coulomb", "friction", "Fc"):
            total = values.get(f"{name}:{kind}:{c}", 0.0)
            assert float(dynamics.get(key)) == max(total, 0.0)
            assert ((kind, joint) in left) == (total < 0)


def test_impossible_bodies_are_not_written(moved, tmp_path):
    robot = RobotIdentifier(
        moved.urdf, dt=moved.dt, projector=None, friction=("viscous",), bodies="free"
    )
    robot.fit(moved.q, moved.tau)
    with pytest.raises(ValueError, match="not physically consistent, and an MJCF file"):
        robot.to_mjcf(tmp_path / "out.xml")
    message = r'joint_1.*not physically.*projector="default"'
    with pytest.raises(ValueError, match=message):
        robot.to_urdf(tmp_path / "out.urdf")
    assert not list(tmp_path.iterdir())
