"""What effects of the robot model ask for: of its base, its encoders, its files."""

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
class ZeroCorrection:
    """An encoder whose zero is off."""

    joint: int  # from zero
    joint_name: str
    subtract: float  # to subtract from what the encoder reads [rad or m]
    # the same in degrees or mm
    plain: float
    plain_unit: str


@dataclass(frozen=True, kw_only=True)
class AxisCorrection:
    """A joint whose axis is not where the description has it."""

    joint: int  # from zero
    joint_name: str
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
class GainCorrection:
    """A torque channel with a wrong gain."""

    joint: int  # from zero
    joint_name: str
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

    def __init__(self, nominal):
        super().__init__(nominal)
        self.base, self.joints = np.eye(3), {}

    def tilt(self, rotation):
        """Turn gravity; see `CorrectedModel.tilt`."""
        super().tilt(rotation)
        self.base = rotation @ self.base

    def turn(self, joint, rotation):
        """Turn the placement of a joint; see `CorrectedModel.turn`."""
        super().turn(joint, rotation)
        self.joints[joint] = rotation @ self.joints.get(joint, np.eye(3))


def _turns(robot):
    turned = _Turns(robot.features_.nominal_)
    for effect in robot.effects_:
        if effect.in_model:
            effect.correct(turned)
    return turned


def turned_joints(robot):
    """Return turns of a fitted robot's joint placements, name -> matrix (3, 3)."""
    names = robot.joint_names_
    return {names[joint]: turn for joint, turn in _turns(robot).joints.items()}


def corrections_of(robot):
    """Say what is to be corrected of a fitted robot, `Corrections`."""
    turned, values = _turns(robot), {}
    for effect in robot.effects_:
        if isinstance(effect, TorqueGain) and robot.gains_ is not None:
            continue
        for kind in (BaseTilt, JointZero, JointAxis, TorqueGain):
            if isinstance(effect, kind):
                # Small turns add up, of one that was declared and found once more.
                own = values.setdefault(kind, {})
                own[effect.joint] = own.get(effect.joint, 0.0) + effect.values
    tilts = [_tilt(turned, *own) for own in values.get(BaseTilt, {}).values()]
    return Corrections(
        tilt=tilts[0] if tilts else None,
        zeros=tuple(
            _zero(robot, joint, float(own[0]))
            for joint, own in values.get(JointZero, {}).items()
        ),
        axes=tuple(
            _axis(robot, turned, joint, *own)
            for joint, own in values.get(JointAxis, {}).items()
        ),
        gains=tuple(
            _gain(robot, joint, float(turned.gains[joint]))
            for joint in values.get(TorqueGain, {})
        ),
    )


def _tilt(turned, roll, pitch):
    lean = import_pinocchio().rpy.matrixToRpy(turned.base.T)
    return TiltCorrection(
        roll=float(roll),
        pitch=float(pitch),
        roll_degrees=float(np.degrees(roll)),
        pitch_degrees=float(np.degrees(pitch)),
        gravity=_floats(turned.model.gravity.linear),
        lean_rpy=_floats(lean),
        lean_rpy_degrees=_floats(np.degrees(lean)),
    )


def _zero(robot, joint, off):
    slides = is_prismatic(robot.features_.nominal_)[joint]
    return ZeroCorrection(
        joint=int(joint),
        joint_name=robot.joint_names_[joint],
        subtract=off,
        plain=1e3 * off if slides else float(np.degrees(off)),
        plain_unit="mm" if slides else "degrees",
    )


def _axis(robot, turned, joint, about_x, about_y):
    rpy = import_pinocchio().rpy.matrixToRpy
    origin = joint_origin(robot.features_.nominal_, joint)
    return AxisCorrection(
        joint=int(joint),
        joint_name=robot.joint_names_[joint],
        about_x=float(about_x),
        about_y=float(about_y),
        about_x_degrees=float(np.degrees(about_x)),
        about_y_degrees=float(np.degrees(about_y)),
        about=tuple(map(_axis_name, cross_axes(turned.axis(joint)))),
        old_rpy=_floats(rpy(origin)),
        new_rpy=_floats(rpy(origin @ turned.joints[joint])),
    )


def _gain(robot, joint, gain):
    return GainCorrection(
        joint=int(joint),
        joint_name=robot.joint_names_[joint],
        gain=gain,
        percent=100.0 * (gain - 1.0),
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
    found = corrections_of(robot)
    lines = []
    if found.tilt is not None:
        roll, pitch, yaw = found.tilt.lean_rpy
        lines.append(
            "The base of the recorded robot was not level: gravity is turned in its "
            f"frame by roll {found.tilt.roll_degrees:.4g} and pitch "
            f"{found.tilt.pitch_degrees:.4g} degrees, and the base leans the opposite "
            f'way (rpy="{roll:.6g} {pitch:.6g} {yaw:.6g}" in a level frame). Level it, '
            "or simulate with gravity "
            f"{' '.join(f'{x:.6g}' for x in found.tilt.gravity)} m/s^2 in its frame: "
            "this file has a level base."
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
