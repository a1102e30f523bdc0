"""Corrections of base, encoders and descriptions by effects of the robot model."""

import math
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.effects import (
    BaseTilt,
    InModel,
    JointAxis,
    JointZero,
    TorqueGain,
    cross_axes,
)
from sklearn_vbjfa.model import (
    CorrectedModel,
    import_pinocchio,
    is_prismatic,
    joint_origin,
)

# Tolerance for an axis to be called by the name of a coordinate axis.
_ALONG = 1e-6


@dataclass(frozen=True, kw_only=True)
class Correction:
    """Correction of base, encoder or description by an effect in the model."""

    name: str  # of the effect
    joint: int  # from zero
    joint_name: str
    # A tilt: the turn of gravity ("roll", "pitch") and the opposite lean of the base
    # ("lean_degrees", "lean_rpy" [rad]), and "gravity" in the base's frame [m/s^2]. A
    # zero: what to "subtract" from the encoder [rad or m], the same "plain" in a
    # "unit". An axis: its "turns" in degrees "about" which axes, and "old_rpy" and
    # "new_rpy" of the joint's origin [rad]. A gain: the "gain" to divide by.
    values: dict


def _corrected(robot):
    corrected = CorrectedModel(robot.features_.nominal_)
    for effect in robot.effects_:
        if isinstance(effect, InModel):
            effect.correct(corrected)
    return corrected


def turned_joints(robot):
    """Return rotations of a robot's joint placements, name -> matrix (3, 3)."""
    names = robot.joint_names_
    return {names[joint]: turn for joint, turn in _corrected(robot).turns.items()}


def corrections_of(robot):
    """Return the corrections of a fitted robot, a tuple of `Correction`."""
    turned, names = _corrected(robot), robot.joint_names_
    sums = {}
    for effect in robot.effects_:
        if effect.name in _VALUES:
            # Add small rotations of a declared effect that was found again.
            key = effect.name, effect.joint
            sums[key] = sums.get(key, 0.0) + effect.values
    return tuple(
        Correction(
            name=name,
            joint=joint,
            joint_name=names[joint],
            values=_VALUES[name](robot, turned, joint, values),
        )
        for (name, joint), values in sums.items()
        # Unknown gains are in `ChannelGains`.
        if robot.gains_ is None or name != TorqueGain.name
    )


def _tilt(robot, turned, joint, values):
    roll, pitch = np.degrees(values).tolist()
    lean = import_pinocchio().rpy.matrixToRpy(turned.base.T)
    return {
        "roll": roll,
        "pitch": pitch,
        "lean_degrees": _floats(np.degrees(lean)),
        "lean_rpy": _floats(lean),
        "gravity": _floats(turned.model.gravity.linear),
    }


def _zero(robot, turned, joint, values):
    off = float(values[0])
    slides = is_prismatic(robot.features_.nominal_)[joint]
    plain, unit = (1e3 * off, "mm") if slides else (math.degrees(off), "degrees")
    return {"subtract": off, "plain": plain, "unit": unit}


def _axis(robot, turned, joint, values):
    rpy = import_pinocchio().rpy.matrixToRpy
    origin = joint_origin(robot.features_.nominal_, joint)
    return {
        "turns": tuple(np.degrees(values).tolist()),
        "about": tuple(map(_axis_name, cross_axes(turned.axes[joint]))),
        "old_rpy": _floats(rpy(origin)),
        "new_rpy": _floats(rpy(origin @ turned.turns[joint])),
    }


_VALUES = {
    BaseTilt.name: _tilt,
    JointZero.name: _zero,
    JointAxis.name: _axis,
    TorqueGain.name: lambda _, turned, j, __: {"gain": float(turned.gains[j])},
}


def _floats(values):
    return tuple(map(float, values))


def _axis_name(direction):
    k = int(np.argmax(np.abs(direction)))
    if direction[k] > 1.0 - _ALONG:
        return f"{'xyz'[k]} axis"
    return f"axis ({', '.join(f'{x:.4g}' for x in direction)})"


# Notes in a URDF by effect.
_NOTES = {
    BaseTilt.name: "The base of the recorded robot was not level: gravity is turned "
    "in its frame by roll {roll:.4g} and pitch {pitch:.4g} degrees. Level it, or "
    "simulate with gravity {gravity[0]:.6g} {gravity[1]:.6g} {gravity[2]:.6g} m/s^2 in "
    "its frame: this file has a level base.",
    JointZero.name: "Subtract {plain:.4g} {unit} ({subtract:.6g} rad or m) from what "
    "the encoder of {joint} reads: this file has the zeros of the description.",
    JointAxis.name: "The axis of {joint} was turned by {turns[0]:.4g} degrees about "
    "the {about[0]} and {turns[1]:.4g} degrees about the {about[1]} of its frame: the "
    "rpy of its origin has it.",
    TorqueGain.name: "Divide the torque that the channel of {joint} reads by "
    "{gain:.5g}: inertias and friction in this file are those of the true torque.",
}


def note_of_corrections(robot):
    return [
        _NOTES[correction.name].format(joint=correction.joint_name, **correction.values)
        for correction in corrections_of(robot)
    ]
