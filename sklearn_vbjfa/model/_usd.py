"""Writing an identified robot as USD, for Isaac Sim: an articulation of UsdPhysics.

Armature and friction of joints are attributes of PhysX, by their names: their schema
comes with Isaac Sim and not with OpenUSD, which keeps what it does not know. Units are
those of the file: m, kg, and, as the schemas have it, degrees of joints that turn.
"""

import os
import uuid
from pathlib import Path

import numpy as np

from sklearn_vbjfa.model._mjcf import UNLIMITED
from sklearn_vbjfa.model._trees import (
    body_names,
    describe,
    import_pinocchio,
    is_prismatic,
    joint_names,
)
from sklearn_vbjfa.model._urdf import body_about_com

_ENDINGS = (".usd", ".usda", ".usdc")


def write_usd(path, model, bodies, dynamics, *, note="", servo=None):
    """Write a robot as USD."""
    # model: its zeros are those of the joints; bodies (nv, 10); dynamics: its armature,
    # damping and frictionloss; servo: `Servo` of motors that have one.
    path = Path(path)
    if path.suffix.lower() not in _ENDINGS:
        raise ValueError(
            f"{str(path)!r}: a USD file is called {', '.join(_ENDINGS)}; .usda is text."
        )
    try:
        from pxr import Usd
    except ImportError as error:
        raise ImportError("Writing USD needs OpenUSD: pip install usd-core") from error
    # OpenUSD keeps files that it has written under their names.
    temporary = path.with_name(f"part{uuid.uuid4().hex}{path.suffix}")
    try:
        stage = Usd.Stage.CreateNew(str(temporary))
        _fill(stage, _Robot(model, bodies, dynamics, servo), note)
        stage.GetRootLayer().Save()
        del stage
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _fill(stage, robot, note):
    """Add the robot, which others may refer to, and a scene with its gravity."""
    from pxr import Gf, UsdGeom, UsdPhysics

    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/robot")
    stage.SetDefaultPrim(root.GetPrim())
    stage.GetRootLayer().comment = note
    UsdPhysics.ArticulationRootAPI.Apply(root.GetPrim())
    scene = UsdPhysics.Scene.Define(stage, "/physicsScene")
    gravity = robot.model.gravity.linear
    size = float(np.linalg.norm(gravity))
    scene.CreateGravityMagnitudeAttr(size)
    scene.CreateGravityDirectionAttr(Gf.Vec3f(*(gravity / (size or 1.0)).tolist()))
    base = UsdGeom.Xform.Define(stage, "/robot/base").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(base)
    # The base is held: its mass counts nothing, and has to be some.
    known = UsdPhysics.MassAPI.Apply(base)
    known.CreateMassAttr(1.0)
    known.CreateDiagonalInertiaAttr(Gf.Vec3f(1.0))
    UsdGeom.Scope.Define(stage, "/robot/joints")
    held = UsdPhysics.FixedJoint.Define(stage, "/robot/joints/base_is_held")
    held.CreateBody1Rel().SetTargets([base.GetPath()])
    for j in range(robot.model.nv):
        robot.add_body(stage, j)
    for j in range(robot.model.nv):
        robot.add_joint(stage, j)


class _Robot:
    """Bodies and joints of a robot, with the names of their prims."""

    def __init__(self, model, bodies, dynamics, servo):
        pin = import_pinocchio()
        self.model, self._bodies, self._dynamics = model, bodies, dynamics
        self._servo, self._shape = servo, describe(model)
        self._slides = is_prismatic(model)
        names = joint_names(model)
        both = (self._shape.turns != 0) & (self._shape.slides != 0)
        if both.any():
            wrong = ", ".join(name for name, helical in zip(names, both) if helical)
            raise ValueError(
                f"USD has no helical joint, which {wrong} would be: only revolute and "
                "prismatic joints can be written."
            )
        self._joints = _prims(names)
        bodies = [body or joint for body, joint in zip(body_names(model), names)]
        # The base and the scope of the joints have the first two names.
        self._links = _prims(["base", "joints", *bodies])[2:]
        data = model.createData()
        pin.forwardKinematics(model, data, np.zeros(model.nq))
        self._places = [data.oMi[j + 1] for j in range(model.nv)]

    def _link(self, j):
        """Path of the body that a joint moves; -1 is the base."""
        return "/robot/base" if j < 0 else f"/robot/{self._links[j]}"

    def add_body(self, stage, j):
        """Add the body that a joint moves, where it is at the zeros of the joints."""
        from pxr import Gf, UsdGeom, UsdPhysics

        link = UsdGeom.Xform.Define(stage, self._link(j))
        place = self._places[j]
        link.AddTranslateOp().Set(Gf.Vec3d(*place.translation.tolist()))
        link.AddOrientOp().Set(_turn(place.rotation))
        UsdPhysics.RigidBodyAPI.Apply(link.GetPrim())
        mass, com, inertia = body_about_com(self._bodies[j])
        principal, axes = np.linalg.eigh(inertia)
        axes[:, 0] *= np.linalg.det(axes)
        known = UsdPhysics.MassAPI.Apply(link.GetPrim())
        known.CreateMassAttr(float(mass))
        known.CreateCenterOfMassAttr(Gf.Vec3f(*com.tolist()))
        known.CreateDiagonalInertiaAttr(Gf.Vec3f(*principal.tolist()))
        known.CreatePrincipalAxesAttr(_turn(axes))

    def add_joint(self, stage, j):
        """Add a joint with its limits, drive, armature and friction."""
        from pxr import Gf, Sdf, UsdPhysics

        kind = UsdPhysics.PrismaticJoint
        if not self._slides[j]:
            kind = UsdPhysics.RevoluteJoint
        joint = kind.Define(stage, f"/robot/joints/{self._joints[j]}")
        parent, place = int(self._shape.parents[j]), self.model.jointPlacements[j + 1]
        joint.CreateBody0Rel().SetTargets([self._link(parent)])
        joint.CreateBody1Rel().SetTargets([self._link(j)])
        # Both bodies see the joint's frame, whose x is the axis.
        ahead = _along(self._shape.axes[j])
        joint.CreateAxisAttr("X")
        joint.CreateLocalPos0Attr(Gf.Vec3f(*place.translation.tolist()))
        joint.CreateLocalRot0Attr(_turn(place.rotation @ ahead))
        joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        joint.CreateLocalRot1Attr(_turn(ahead))
        degree = 1.0 if self._slides[j] else np.pi / 180.0
        low, high = (
            float(x[j])
            for x in (self.model.lowerPositionLimit, self.model.upperPositionLimit)
        )
        if low < high and max(-low, high) < UNLIMITED:
            joint.CreateLowerLimitAttr(low / degree)
            joint.CreateUpperLimitAttr(high / degree)
        prim = joint.GetPrim()
        along = "linear" if self._slides[j] else "angular"
        drive = UsdPhysics.DriveAPI.Apply(prim, along)
        if self._servo is not None:
            drive.CreateStiffnessAttr(float(self._servo.kp[j]) * degree)
            drive.CreateDampingAttr(float(self._servo.kd[j]) * degree)
            if np.isfinite(self._servo.most[j]):
                drive.CreateMaxForceAttr(float(self._servo.most[j]))
        prim.AddAppliedSchema(f"PhysxJointAxisAPI:{along}")
        dynamics = self._dynamics
        for name, value in (
            ("armature", dynamics.armature[j]),
            ("staticFrictionEffort", dynamics.frictionloss[j]),
            ("dynamicFrictionEffort", dynamics.frictionloss[j]),
            ("viscousFrictionCoefficient", dynamics.damping[j] * degree),
        ):
            full = f"physxJointAxis:{along}:{name}"
            kept = prim.CreateAttribute(full, Sdf.ValueTypeNames.Float, custom=False)
            kept.Set(float(value))


def _prims(names):
    """Names of prims, which have letters and digits only and differ."""
    from pxr import Tf

    plain = []
    for name in map(Tf.MakeValidIdentifier, names):
        while name in plain:
            name += "_"
        plain.append(name)
    return plain


def _turn(rotation):
    """Quaternion of a rotation matrix (3, 3)."""
    from pxr import Gf

    turn = import_pinocchio().Quaternion(np.ascontiguousarray(rotation))
    return Gf.Quatf(*map(float, (turn.w, turn.x, turn.y, turn.z)))


def _along(axis):
    """Rotation (3, 3) whose first column is an axis of length 1."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    second = np.cross(axis, other)
    second /= np.linalg.norm(second)
    return np.column_stack([axis, second, np.cross(axis, second)])
