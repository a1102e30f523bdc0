"""The robot as USD: the stage, read back, is the robot."""

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")
pytest.importorskip("pxr")

from pxr import Usd, UsdPhysics  # noqa: E402

from sklearn_vbjfa.effects import (  # noqa: E402
    BaseTilt,
    JointAxis,
    JointZero,
    Offset,
    RotorInertia,
    Spring,
    Stribeck,
    TorqueGain,
)
from sklearn_vbjfa.physical import min_eigenvalue  # noqa: E402
from sklearn_vbjfa.robot import PDDrive  # noqa: E402
from sklearn_vbjfa.robot._exports import servo_of, to_usd  # noqa: E402
from tests.model.test_mjcf import rigid  # noqa: E402
from tests.robot.test_drives import KD, KP, NAMES, real, told  # noqa: E402
from tests.robot.test_exports import robot_of  # noqa: E402


def turn(value):
    """Rotation matrix of a quaternion of USD."""
    x, y, z = value.GetImaginary()
    return pin.Quaternion(value.GetReal(), x, y, z).normalized().matrix()


def read(path):
    """Read a stage as a model, its joints, drives and gravity; nothing of the writer.

    Joints are in the order of the file; armature, dry and viscous friction as columns.
    """
    stage = Usd.Stage.Open(str(path))
    model, at, joints, own = pin.Model(), {}, [], []
    scene = next(UsdPhysics.Scene(x) for x in stage.Traverse() if x.IsA("PhysicsScene"))
    gravity = np.array(scene.GetGravityDirectionAttr().Get())
    model.gravity.linear = gravity * scene.GetGravityMagnitudeAttr().Get()
    for prim in stage.Traverse():
        turns = prim.IsA(UsdPhysics.RevoluteJoint)
        if not turns and not prim.IsA(UsdPhysics.PrismaticJoint):
            continue
        kind = UsdPhysics.RevoluteJoint if turns else UsdPhysics.PrismaticJoint
        joint = kind(prim)
        (first,), (second,) = (
            rel.GetTargets() for rel in (joint.GetBody0Rel(), joint.GetBody1Rel())
        )
        frames = [
            pin.SE3(turn(rot.Get()), np.array(pos.Get(), dtype=float))
            for rot, pos in (
                (joint.GetLocalRot0Attr(), joint.GetLocalPos0Attr()),
                (joint.GetLocalRot1Attr(), joint.GetLocalPos1Attr()),
            )
        ]
        assert joint.GetAxisAttr().Get() == "X"
        parent, seen = at.get(first, (0, pin.SE3.Identity()))
        joint_model = pin.JointModelRX() if turns else pin.JointModelPX()
        index = model.addJoint(parent, joint_model, seen * frames[0], prim.GetName())
        place = frames[1].inverse()
        at[second] = index, place
        mass = UsdPhysics.MassAPI(stage.GetPrimAtPath(second))
        axes = turn(mass.GetPrincipalAxesAttr().Get())
        inertia = axes @ np.diag(np.array(mass.GetDiagonalInertiaAttr().Get())) @ axes.T
        com = np.array(mass.GetCenterOfMassAttr().Get(), dtype=float)
        body = pin.Inertia(mass.GetMassAttr().Get(), com, inertia)
        model.appendBodyToJoint(index, body, place)
        along = "angular" if turns else "linear"
        assert (
            f"PhysxJointAxisAPI:{along}"
            in prim.GetMetadata("apiSchemas").GetAddedOrExplicitItems()
        )
        degree = np.pi / 180 if turns else 1.0
        words = ("armature", "dynamicFrictionEffort", "viscousFrictionCoefficient")
        values = [
            prim.GetAttribute(f"physxJointAxis:{along}:{word}").Get() for word in words
        ]
        own.append([values[0], values[1], values[2] / degree])
        drive = UsdPhysics.DriveAPI(prim, along)
        limits = joint.GetLowerLimitAttr().Get(), joint.GetUpperLimitAttr().Get()
        gains = drive.GetStiffnessAttr().Get(), drive.GetDampingAttr().Get()
        joints.append(
            {
                "name": prim.GetName(),
                "limits": degree * np.array(limits),
                "gains": np.array(gains) / degree,
                "most": drive.GetMaxForceAttr().Get(),
            }
        )
    return model, joints, np.array(own)


def written(robot, path, servo=None):
    return to_usd(path, robot, min_eigenvalue(robot.bodies), servo=servo)


@pytest.mark.parametrize("seed", range(4))
def test_the_stage_is_the_robot(tmp_path, seed):
    """Trees with oblique axes and sliding joints, a tilted base, turned joints."""
    nv = 5
    robot = robot_of(
        [(RotorInertia(1), [0.4]), (BaseTilt(0), [0.0, 0.0])],
        seed,
        nv,
        [
            ("viscous", np.arange(1.0, 1 + nv)),
            ("coulomb", 0.1 * np.arange(nv)),
            ("rotor_inertia", 0.2 * np.arange(nv)),
        ],
        axes=("RX", "RY", "PZ", "RevoluteUnaligned"),
    )
    robot.model.gravity.linear = np.random.default_rng(seed).normal(size=3) * 5
    assert written(robot, tmp_path / "robot.usda") == ()
    model, _, own = read(tmp_path / "robot.usda")
    states = np.random.default_rng(1).normal(size=(50, 3 * nv))
    expected = rigid(robot.model, robot.bodies, states)
    data = model.createData()
    found = np.array([pin.rnea(model, data, *row.reshape(3, nv)) for row in states])
    # Numbers of the schemas have six digits.
    assert (np.abs(found - expected).max(axis=0) < 2e-5 * expected.std(axis=0)).all()
    armature = 0.2 * np.arange(nv)
    armature[1] += 0.4
    columns = [armature, 0.1 * np.arange(nv), np.arange(1.0, 1 + nv)]
    np.testing.assert_allclose(own, np.transpose(columns), rtol=1e-6, atol=1e-9)


def test_what_has_no_place_is_listed(tmp_path):
    robot = robot_of(
        [
            (Offset(0), [1.0]),
            (Spring(1), [3.0, 0.2]),
            (Stribeck(2, vs=0.1), [0.4]),
            (TorqueGain(3, gain=1.2), [1.2]),
        ]
    )
    left = written(robot, tmp_path / "robot.usda")
    assert {one.name for one in left} == {
        "offset",
        "spring",
        "stribeck",
        "torque_gain",
    }
    text = (tmp_path / "robot.usda").read_text()
    assert all(str(one) in text for one in left)


@pytest.mark.parametrize(
    "effect", [JointZero(1, zero=0.2), JointAxis(1, about_x=0.1), BaseTilt(roll=0.1)]
)
def test_corrections_of_the_model_are_in_its_frames(tmp_path, effect):
    """The corrected model is what is written, and nothing is left of it."""
    robot = robot_of([(effect, effect.values)])
    assert written(robot, tmp_path / "robot.usda") == ()


def test_gains_are_those_of_degrees_and_the_delay_is_left_out(tmp_path):
    recording = told(0.01)
    drive = PDDrive(KP, KD, saturation=[5.0, np.inf, 7.0])
    robot = real(recording, PDDrive(KP, KD))
    (left,) = robot.to_usd(tmp_path / "arm.usda", drive=drive)
    assert left.name == "command_delay"
    _, joints, _ = read(tmp_path / "arm.usda")
    assert [one["name"] for one in joints] == list(NAMES)
    gains = [one["gains"] for one in joints]
    np.testing.assert_allclose(gains, np.transpose([KP, KD]), rtol=1e-6)
    assert [one["most"] for one in joints] == [5.0, np.inf, 7.0]


def test_limits_are_those_of_the_description(tmp_path):
    robot = robot_of([], axes=("RX", "PZ"))
    robot.model.lowerPositionLimit[:] = -0.5
    robot.model.upperPositionLimit[:] = [0.7, np.inf, 0.7, 0.7]
    written(robot, tmp_path / "robot.usda")
    _, joints, _ = read(tmp_path / "robot.usda")
    limits = [one["limits"] for one in joints]
    free = [-np.inf, np.inf]
    expected = [[-0.5, 0.7], free, [-0.5, 0.7], [-0.5, 0.7]]
    np.testing.assert_allclose(limits, expected, rtol=1e-6)


def test_a_stage_can_be_written_again_and_referred_to(tmp_path):
    robot = robot_of([])
    servo = servo_of(PDDrive(2.0, 0.1), robot.joint_names, 0.0)
    path = tmp_path / "robot.usd"
    for _ in range(2):
        written(robot, path, servo)
    assert [one.name for one in tmp_path.iterdir()] == ["robot.usd"]
    stage = Usd.Stage.CreateInMemory()
    other = stage.DefinePrim("/here")
    other.GetReferences().AddReference(str(path))
    kinds = [x for x in stage.Traverse() if x.IsA(UsdPhysics.Joint)]
    assert len(kinds) == robot.n_joints + 1
    roots = [x for x in stage.Traverse() if x.HasAPI(UsdPhysics.ArticulationRootAPI)]
    assert [x.GetPath() for x in roots] == ["/here"]
    assert not any(x.IsA(UsdPhysics.Scene) for x in stage.Traverse())


def test_other_endings_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"called \.usd, \.usda, \.usdc"):
        written(robot_of([]), tmp_path / "robot.xml")
