"""Effects of the robot model in words and units of those who have to mend them."""

import math
from dataclasses import dataclass

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, TorqueGain

# One of a SI unit in the unit that is read off an instrument.
_UNITS = {"rad": (180.0 / math.pi, "degrees"), "m": (1e3, "mm")}


@dataclass(frozen=True, kw_only=True)
class Plain:
    """A parameter in a plain unit."""

    value: float
    interval: tuple | None  # 90 %
    unit: str  # "degrees", "mm" or "%"


def in_model(outcome, effect):
    """Whether an effect that was found is part of the robot model."""
    known = outcome.library.get(effect.name)
    return known is not None and known.in_model


def plain_values(effect):
    """Return the parameters of an effect in the model, symbol -> `Plain`."""
    found = {}
    for name, value in effect.parameters.items():
        if name == "gain":
            scale, shift, unit = 100.0, 1.0, "%"
        elif effect.units.get(name) in _UNITS:
            (scale, unit), shift = _UNITS[effect.units[name]], 0.0
        else:
            continue
        interval = effect.intervals.get(name)
        if interval is not None:
            interval = tuple(scale * (float(end) - shift) for end in interval)
        found[name] = Plain(
            value=scale * (float(value) - shift), interval=interval, unit=unit
        )
    return found


def statement(outcome, effect):
    """Say what was found of the robot model, in a sentence without a full stop."""
    values = plain_values(effect)
    joint = words.joint_label(outcome.joint_names, effect.joint)
    told = outcome.library[effect.name].text
    if told:
        first, second = _about(outcome, effect)
        texts = {
            name: _too_much(one) if name == "gain" else _text(one)
            for name, one in values.items()
        }
        unit = next(iter(values.values())).unit
        return told.format(joint=joint, first=first, second=second, unit=unit, **texts)
    # One of a user's own.
    label = words.effect_label(outcome, effect.name, effect.parameters)
    parts = [f"{name} = {_text(one)} {one.unit}" for name, one in values.items()]
    told = ", ".join([label, *parts])
    return told if effect.scope == "robot" else f"{joint}: {told}"


def value_cells(effect):
    """Write each parameter in its plain unit, a tuple of str."""
    return tuple(
        f"{_too_much(plain)}"
        if name == "gain"
        else f"{name.replace('_', ' ')} {_text(plain)} {plain.unit}"
        for name, plain in plain_values(effect).items()
    )


def _text(plain):
    """Write a value with half its interval, without the unit."""
    return words.with_error(plain.value, plain.interval)


def _too_much(plain):
    """Write a gain as what is read too much or too little."""
    way = "too much" if plain.value >= 0 else "too little"
    interval = plain.interval
    if plain.value < 0 and interval is not None:
        interval = (-interval[1], -interval[0])
    return f"{words.with_error(abs(plain.value), interval, '%')} {way}"


def _about(outcome, effect):
    """Return what a turned axis is turned about."""
    for one in outcome.corrections.axes:
        if one.joint == effect.joint:
            return one.about
    return "first cross axis", "second cross axis"


# -- what to do -------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """What to do about an effect of the robot model."""

    name: str
    joint: int  # from zero; 0 for what belongs to none
    text: str


def remedies(outcome):
    """Say what to do about each effect in the completed model, a tuple of `Remedy`."""
    # Those that were declared are among them.
    found = outcome.corrections
    told = [
        Remedy(name=BaseTilt.name, joint=0, text=_level(t)) for t in [found.tilt] if t
    ]
    for name, own, text in (
        (JointZero.name, found.zeros, _subtract),
        (JointAxis.name, found.axes, _turn),
        (TorqueGain.name, found.gains, _divide),
    ):
        for one in own:
            joint = words.joint_label(outcome.joint_names, one.joint)
            told.append(Remedy(name=name, joint=one.joint, text=text(one, joint)))
    # Nobody mends a robot on a possible, nor on what may as well be nothing.
    open_ = {(one.name, one.joint) for one in outcome.possible}
    return tuple(
        one
        for one in told
        if (one.name, one.joint) not in open_ and not _may_be_nothing(outcome, one)
    )


def _may_be_nothing(outcome, remedy):
    """Whether every interval of what a remedy is for holds the value of no fault."""
    joint = outcome.joint_names[remedy.joint] if outcome.joint_names else ""
    begins = f"{joint}:{remedy.name}:", f"{remedy.name}:"
    known = [one for one in outcome.parameters if one.name.startswith(begins)]
    return bool(known) and all(
        one.interval[0]
        <= (1.0 if one.name.endswith(":gain") else 0.0)
        <= one.interval[1]
        for one in known
    )


def _level(tilt):
    """Say what to do about a base that is not level."""
    roll, pitch, _ = tilt.lean_rpy_degrees
    return (
        "level the base, which leans the opposite way (roll "
        f"{_hundredths(roll)}, pitch {_hundredths(pitch)} degrees), or mount it so in "
        f"the robot description (rpy {_rpy(tilt.lean_rpy)})"
    )


def _subtract(zero, joint):
    """Say what to do about a zero."""
    off = f"{_hundredths(zero.plain)} {zero.plain_unit}"
    return f"subtract {off} from what the encoder of {joint} reads"


def _turn(axis, joint):
    """Say what to do about an axis."""
    return (
        f"take the rpy of the origin of {joint} from the URDF that is written "
        f"({_rpy(axis.new_rpy)} instead of {_rpy(axis.old_rpy)})"
    )


def _divide(gain, joint):
    """Say what to do about the gain of a channel."""
    return f"divide the torque of {joint} by {gain.gain:.4g}"


def _hundredths(value):
    """Write an angle in degrees or a length in mm."""
    return f"{value:.2f}"


def _rpy(angles):
    """Write three angles [rad] as a URDF has them, to a thousandth of a degree."""
    # Without the sign of a zero.
    return f'"{" ".join(f"{round(angle, 5) + 0.0:.5f}" for angle in angles)}"'
