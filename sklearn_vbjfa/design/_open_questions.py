"""What a report leaves open, as effects that the next motion has to part."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

from sklearn.base import clone

from sklearn_vbjfa.effects import resolve

# How much what the report names counts, and all else that a joint might have.
_ASKED, _POSSIBLE = 1.0, 0.2
# Effects whose columns follow the robot's geometry or what lies in time: the motion is
# not bent for them, and what it shows of them is reported afterwards.
_NOT_STEERED: tuple[str, ...] = (
    "base_tilt",
    "joint_zero",
    "joint_axis",
    "payload",
    "drift",
    "signal",
)
_NOT_STEERED += ("torque_gain", "delay", "torque_filter", "jerk", "elastic")
# Effects that any joint may have, in forms that a motion can tell apart.
_COMMON = (
    "viscous",
    "coulomb",
    "asymmetric_friction",
    "stribeck",
    "viscous_quadratic",
    "load_friction",
    "spring",
    "ripple",
    "rotor_inertia",
    "offset",
)


@dataclass(frozen=True, eq=False)
class OpenEffect:
    """An effect that the robot may have."""

    effect: object  # at its joint
    weight: float  # how much it matters whether it is there
    why: str  # who asks: "report", "caller" or "library"
    # whether the model has it, and the next recording has to confirm it
    doubted: bool = False


def is_steered(effect):
    """Whether a motion is bent for an effect: it is one of the joint's own torque."""
    return effect.name not in _NOT_STEERED


def read_report(report):
    """Return a report, its search or what its file holds as a dict of `to_dict`."""
    if isinstance(report, (str, os.PathLike)):
        return _read_folder(Path(report))
    report = getattr(report, "report_", report)
    if hasattr(report, "to_dict"):
        return report.to_dict()
    if isinstance(report, dict) and "effects" in report:
        return report
    raise TypeError(
        "report must be a fitted EffectDiscovery, its report_, or the folder that "
        f"identify wrote; got {type(report).__name__}."
    )


def _read_folder(path):
    """Read report.json of a folder."""
    file = path / "report.json" if path.is_dir() else path
    if not file.is_file():
        raise FileNotFoundError(
            f"No report at {str(file)!r}; expected the folder that identify wrote, "
            "with report.json in it."
        )
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{str(file)!r} is not readable as JSON: {error}.") from error
    if not isinstance(found, dict) or not {"effects", "joint_names"} <= set(found):
        raise ValueError(
            f"{str(file)!r} is not a report of identify: it lacks 'effects' or "
            "'joint_names'."
        )
    return found


def asked_effects(effects, nv):
    """Return `OpenEffect`s declared by hand: names and classes count for all joints."""
    found = []
    if isinstance(effects, str) or not hasattr(effects, "__iter__"):
        effects = (effects,)
    for one in effects:
        (effect,) = resolve((one,))
        if not is_steered(effect):
            raise ValueError(
                f"No motion is designed for {effect.name!r}: it follows the robot's "
                "geometry, the time or the whole torque, and shows in any motion that "
                "shows the rest. Leave it out of effects."
            )
        everywhere = isinstance(one, (str, type))
        for joint in range(nv) if everywhere else [effect.joint]:
            if not 0 <= joint < nv:
                raise ValueError(
                    f"{effect.name} is on joint {joint}, counted from zero; the robot "
                    f"has {nv} joints."
                )
            placed = clone(effect).set_params(joint=joint)
            found.append(OpenEffect(placed, _ASKED, "caller"))
    return found


def open_effects(data, names):
    """Return what a report leaves open, and then what else the joints may have."""
    _check_joints(data, names)
    weights = {}
    completed = _completed(data)
    doubted = {(found["name"], found["joint"]) for found in completed}
    weights |= dict.fromkeys(doubted, _ASKED)
    trials = [trial for one in completed for trial in one.get("trials", ())]
    weights |= {(one["name"], one["joint"]): _ASKED for one in trials}
    for one in data.get("hidden", ()):
        if one["reason"] == "excitation":
            weights.setdefault((one["name"], one["joint"]), _ASKED)
    above = {one["joint"] for one in data.get("unexplained", ())}
    for joint in range(len(names)):
        for name in _COMMON:
            weight = _ASKED if joint in above else _POSSIBLE
            weights.setdefault((name, joint), weight)
    shapes = _tuned(data)
    found = []
    for (name, joint), weight in weights.items():
        if name in _NOT_STEERED:
            continue
        effect = _made(name, joint, shapes.get((name, joint), {}))
        if effect is not None:
            why = "report" if weight == _ASKED else "library"
            found.append(OpenEffect(effect, weight, why, (name, joint) in doubted))
    return sorted(found, key=lambda one: -one.weight)


def _check_joints(data, names):
    """Refuse the report of a different robot."""
    reported = list(data["joint_names"])
    if reported != list(names):
        raise ValueError(
            f"The report is of joints {', '.join(reported)}; the robot has "
            f"{', '.join(names)}. Give the robot that the report was made with."
        )


def _completed(data):
    """Effects of the completed model of a report."""
    return (*data["effects"], *data.get("possible", ()))


def _tuned(data):
    """Shapes that the search tuned, by effect and joint."""
    shapes = {}
    for one in _completed(data):
        for trial in one.get("trials", ()):
            shapes[trial["name"], trial["joint"]] = trial["shape"]
        shapes[one["name"], one["joint"]] = one.get("parameters") or {}
    return shapes


def _made(name, joint, shape):
    """Make an effect of the library; None for one's own class, which is not known."""
    try:
        (effect,) = resolve((name,))
    except ValueError:
        return None
    known = {
        k: v for k, v in shape.items() if k in effect.get_params() and v is not None
    }
    return clone(effect).set_params(joint=joint, **known)
