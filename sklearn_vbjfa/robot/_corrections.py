"""Corrections of base, encoders and descriptions by effects of the robot model."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, TorqueGain, cross_axes
from sklearn_vbjfa.model import (
    CorrectedModel,
    import_pinocchio,
    is_prismatic,
    joint_origin,
)

# Of the length of an axis, what may be across the coordinate axis that names it.
_ALONG = 1e-6


@dataclass(frozen=True, kw_only=True)
class TiltCorrection:
    """A base that is not level."""

    # by which gravity is turned in the base's frame [rad]
    roll: float
    pitch: float
    roll_degrees: float
    pitch_degrees: float
    gravity: tuple  # gravity in the base's frame [m/s^2]
    # how the base itself leans, the opposite turn: roll, pitch and yaw of its frame in
    # that of a level base, as a URDF has them [rad, degrees]
    lean_rpy: tuple
    lean_rpy_degrees: tuple


@dataclass(frozen=True, kw_only=True)
class _OfJoint:
    joint: int  # from zero
    joint_name: str


@dataclass(frozen=True, kw_only=True)
class ZeroCorrection(_OfJoint):
    """An encoder whose zero is off."""

    subtract: float  # to subtract from what the encoder reads [rad or m]
    # the same in degrees or mm
    plain: float
    plain_unit: str


@dataclass(frozen=True, kw_only=True)
class AxisCorrection(_OfJoint):
    """A joint whose axis is not where the description has it."""

    # by which it is turned [rad]
    about_x: float
    about_y: float
    about_x_degrees: float
    about_y_degrees: float
    about: tuple  # what these two turns are about, axes of the joint's frame
    # roll, pitch and yaw of the joint's origin in a URDF, before and after [rad]
    old_rpy: tuple
    new_rpy: tuple


@dataclass(frozen=True, kw_only=True)
class GainCorrection(_OfJoint):
    """A torque channel with a wrong gain."""

    gain: float  # to divide what the channel reads by
    percent: float  # what it reads too much [%]


@dataclass(frozen=True, kw_only=True)
class Corrections:
    """What the effects in the model of a fitted robot ask for."""

    tilt: TiltCorrection | None = None  # of the base
    zeros: tuple = ()  # of encoders
    axes: tuple = ()  # of joints; a URDF that is written has them
    # those of torque channels, unless all are unknown: then `ChannelGains` has them
    gains: tuple = ()


class _Turns(CorrectedModel):
    """A robot that keeps the turns that it is corrected by, `base` and `joints`."""

    def __init__(self, robot):
        super().__init__(robot.features_.nominal_)
        self.base, self.joints = np.eye(3), {}
        for effect in robot.effects_:
            if effect.in_model:
                effect.correct(self)

    def tilt(self, rotation):
        """Turn gravity; see `CorrectedModel.tilt`."""
        super().tilt(rotation)
        self.base = rotation @ self.base

    def turn(self, joint, rotation):
        """Turn the placement of a joint; see `CorrectedModel.turn`."""
        super().turn(joint, rotation)
        self.joints[joint] = rotation @ self.joints.get(joint, np.eye(3))


def turned_joints(robot):
    """Return turns of a fitted robot's joint placements, name -> matrix (3, 3)."""
    names = robot.joint_names_
    return {names[joint]: turn for joint, turn in _Turns(robot).joints.items()}


def corrections_of(robot):
    """Say what is to be corrected of a fitted robot, `Corrections`."""
    turned, names = _Turns(robot), robot.joint_names_
    values = {kind: {} for kind in (BaseTilt, JointZero, JointAxis, TorqueGain)}
    for effect in robot.effects_:
        for kind, sums in values.items():
            if isinstance(effect, kind):
                # Small turns add up, of one that was declared and found once more.
                sums[effect.joint] = sums.get(effect.joint, 0.0) + effect.values
    if robot.gains_ is not None:
        values[TorqueGain] = {}

    def each(kind, make):
        return tuple(
            make(robot, turned, int(joint), own, joint_name=names[joint])
            for joint, own in values[kind].items()
        )

    tilts = [_tilt(turned, own) for own in values[BaseTilt].values()]
    return Corrections(
        tilt=tilts[0] if tilts else None,
        zeros=each(JointZero, _zero),
        axes=each(JointAxis, _axis),
        gains=each(TorqueGain, _gain),
    )


def _tilt(turned, values):
    lean = import_pinocchio().rpy.matrixToRpy(turned.base.T)
    roll, pitch = values.tolist()
    return TiltCorrection(
        roll=roll,
        pitch=pitch,
        roll_degrees=float(np.degrees(roll)),
        pitch_degrees=float(np.degrees(pitch)),
        gravity=_floats(turned.model.gravity.linear),
        lean_rpy=_floats(lean),
        lean_rpy_degrees=_floats(np.degrees(lean)),
    )


def _zero(robot, turned, joint, values, joint_name):
    off = float(values[0])
    slides = is_prismatic(robot.features_.nominal_)[joint]
    return ZeroCorrection(
        joint=joint,
        joint_name=joint_name,
        subtract=off,
        plain=1e3 * off if slides else float(np.degrees(off)),
        plain_unit="mm" if slides else "degrees",
    )


def _axis(robot, turned, joint, values, joint_name):
    rpy = import_pinocchio().rpy.matrixToRpy
    origin = joint_origin(robot.features_.nominal_, joint)
    (about_x, about_y), degrees = values.tolist(), np.degrees(values).tolist()
    return AxisCorrection(
        joint=joint,
        joint_name=joint_name,
        about_x=about_x,
        about_y=about_y,
        about_x_degrees=degrees[0],
        about_y_degrees=degrees[1],
        about=tuple(map(_axis_name, cross_axes(turned.axis(joint)))),
        old_rpy=_floats(rpy(origin)),
        new_rpy=_floats(rpy(origin @ turned.joints[joint])),
    )


def _gain(robot, turned, joint, values, joint_name):
    gain = float(turned.gains[joint])
    percent = 100.0 * (gain - 1.0)
    return GainCorrection(
        joint=joint, joint_name=joint_name, gain=gain, percent=percent
    )


def _floats(values):
    return tuple(map(float, values))


def _axis_name(direction):
    """Name an axis of a frame (3,)."""
    k = int(np.argmax(np.abs(direction)))
    if direction[k] > 1.0 - _ALONG:
        return f"{'xyz'[k]} axis"
    return f"axis ({', '.join(f'{x:.4g}' for x in direction)})"


def note_of_corrections(robot):
    """Say what an identified robot asks for that a URDF cannot hold; a list of str."""
    found, lines = corrections_of(robot), []
    if found.tilt is not None:
        rpy = " ".join(f"{x:.6g}" for x in found.tilt.lean_rpy)
        gravity = " ".join(f"{x:.6g}" for x in found.tilt.gravity)
        lines.append(
            "The base of the recorded robot was not level: gravity is turned in its "
            f"frame by roll {found.tilt.roll_degrees:.4g} and pitch "
            f"{found.tilt.pitch_degrees:.4g} degrees, and the base leans the opposite "
            f'way (rpy="{rpy}" in a level frame). Level it, or simulate with gravity '
            f"{gravity} m/s^2 in its frame: this file has a level base."
        )
    lines += [
        f"Subtract {one.plain:.4g} {one.plain_unit} ({one.subtract:.6g} "
        f"{'m' if one.plain_unit == 'mm' else 'rad'}) from what the encoder of "
        f"{one.joint_name} reads: this file has the zeros of the description."
        for one in found.zeros
    ]
    lines += [
        f"Divide the torque that the channel of {one.joint_name} reads by "
        f"{one.gain:.5g}: inertias and friction in this file are those of the true "
        "torque."
        for one in found.gains
    ]
    lines += [
        f"The axis of {one.joint_name} was turned by {one.about_x_degrees:.4g} degrees "
        f"about the {one.about[0]} and {one.about_y_degrees:.4g} degrees about the "
        f"{one.about[1]} of its frame: the rpy of its origin has it."
        for one in found.axes
    ]
    return lines
