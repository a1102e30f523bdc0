"""Identified robots as JSON files, with the robot description."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import UnionType
from typing import get_args, get_origin, get_type_hints

import numpy as np

from sklearn_vbjfa._core import write_whole
from sklearn_vbjfa.effects import (
    CommandDelay,
    Effect,
    TorqueLag,
    UnnamedTorque,
    available,
    resolve,
)
from sklearn_vbjfa.equations._features import Follower, RigidBodyFeatures
from sklearn_vbjfa.equations._plan import check_effects
from sklearn_vbjfa.equations._states import StateEstimator
from sklearn_vbjfa.model._loading import load_text
from sklearn_vbjfa.model._trees import in_order
from sklearn_vbjfa.recording._table import quoted

FORMAT = "sklearn_vbjfa identified robot"
VERSION = 1
# Fields that follow from others, and saved attributes of a fitted `StateEstimator`.
_NOT_SAVED = frozenset({"features_", "source", "waves", "_stepper"})
_OF_STATES = ("cutoff_", "noise_variance_", "rest_variance_", "bandwidth_")
# Numbers that JSON does not have.
_SPELLED = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
# A list of numbers and words like "nan".
_PLAIN_LIST = re.compile(r'\[\s+(?:[-+.\w]+|"-?\w+")(?:,\s+(?:[-+.\w]+|"-?\w+"))*\s+\]')
_WORDS = {float: "a number", int: "a whole number", str: "a text"}
_WORDS |= {bool: "true or false", list: "a list", dict: "an object"}


class _Wrong(ValueError):
    """A key with a wrong value; `read` adds the name of the file."""

    def __init__(self, at, what):
        super().__init__(f"key {at!r} {what}")


# -- robots ----------------------------------------------------------------------------


def write(path, robot):
    from sklearn_vbjfa import __version__

    robot = replace(robot, text=robot.description_)
    gravity = robot.features_.nominal_.gravity
    head = {
        "format": FORMAT,
        "version": VERSION,
        "package": f"sklearn_vbjfa {__version__}",
        "joints": robot.joint_names_,
        "friction": robot.features_.friction_,
        "gravity": np.r_[gravity.linear, gravity.angular],
        "parameters": robot.parameter_names_,
        "units": robot.parameter_units_,
    }
    try:
        text = readable(_encode(head) | _encode(robot))
    except TypeError as error:
        raise ValueError(
            f"an effect has a parameter that cannot be saved, {error}; expected "
            "numbers, texts, true, false, None and tuples of these."
        ) from error
    write_whole(path, f"{text}\n")


def read(path, kind, effects=()):
    """Read an `IdentifiedRobot`; ValueError for missing or wrong keys."""
    # kind: its class; effects: classes of effects that are not in the library.
    name = str(path)
    # Effects that the search does not try.
    further = (Follower, CommandDelay, TorqueLag, UnnamedTorque)
    classes = {effect.name: effect for effect in (*further, *effects)}
    try:
        text = Path(path).read_text(encoding="utf-8")
        content = json.loads(text, parse_constant=_refuse)
    except FileNotFoundError:
        raise FileNotFoundError(f"There is no file {name!r}.") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(
            f"{name!r} is not JSON: {error}; expected a saved robot (identified.json)."
        ) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(
            f"{name!r} is not an identified robot: its key 'format' is not "
            f"{FORMAT!r}. Files of that format are written by RobotIdentifier.save."
        )
    try:
        return _robot_of(content, name, kind, classes)
    except (_Wrong, RecursionError) as error:
        raise ValueError(f"{name!r}: {error}.") from error


def _refuse(name):
    raise ValueError(f"it holds {name} for a number, JSON has none of that name")


def _robot_of(content, name, kind, classes):
    if content.get("version") != VERSION:
        raise _Wrong(
            "version",
            f"is {quoted(content.get('version'))}, and this release reads version "
            f"{VERSION}: identify the robot again",
        )
    names = tuple[str, ...]
    joints, friction, parameters, gravity = (
        _decode(_value(content, key), kind, key)
        for key, kind in (("joints", names), ("friction", names))
        + (("parameters", names), ("gravity", np.ndarray))
    )
    values, at = _decode_fields(content, kind, "", classes), "text"
    try:
        model = in_order(load_text(values["text"], name), joints)
        at = "gravity"
        motion = model.gravity.copy()
        motion.linear, motion.angular = gravity.reshape(2, 3)
        model.gravity, at = motion, "friction"
        features, at = RigidBodyFeatures(model, friction).load(), "plan.effects"
        features = features.corrected(check_effects(values["plan"].effects, model.nv))
    except ValueError as error:
        raise _Wrong(at, f"is invalid: {error}") from error
    robot = kind(features_=features, **values)
    if parameters != robot.parameter_names_:
        raise _Wrong(
            "parameters",
            "must hold the names of the parameters of the joints, the friction and the "
            "effects in their order",
        )
    for key in ("theta_", "theta_unconstrained_", "theta_std_", "identifiable_"):
        array = getattr(robot, key)
        if np.shape(array) != (len(parameters),):
            raise _Wrong(key, f"must hold {len(parameters)} values, one per parameter")
        if key != "theta_std_" and not np.isfinite(array).all():
            raise _Wrong(key, "must hold finite numbers")
    n_ranges = features.n_joints_ * len(features.friction_) + len(robot.effects_)
    if len(robot.effect_ranges_) != n_ranges:
        raise _Wrong("effect_ranges_", f"must hold {n_ranges} ranges")
    return robot


# -- effects ---------------------------------------------------------------------------


def _decode_setting(value):
    """Convert lists to tuples, and "nan" and "inf" to numbers."""
    if isinstance(value, list):
        return tuple(map(_decode_setting, value))
    return _SPELLED.get(value, value) if isinstance(value, str) else value


def _decode_effect(value, at, classes):
    name, joint, shape = (
        _decode(_value(value, key, at), kind, f"{at}.{key}")
        for key, kind in (("name", str), ("joint", int), ("shape", dict))
    )
    kind = classes.get(name)
    if kind is None and name in available():
        kind = type(resolve([name])[0])
    if kind is None:
        raise _Wrong(
            f"{at}.name",
            f"is {name!r}, which the library of this release does not have: give its "
            "class, load_identified(path, effects=[...])",
        )
    try:
        effect = kind(joint=joint, **{k: _decode_setting(x) for k, x in shape.items()})
        effect.check()
    except (TypeError, ValueError) as error:
        raise _Wrong(f"{at}.shape", f"does not suit {name!r}: {error}") from error
    return effect


# -- values of declared types ----------------------------------------------------------


def _encode(value):
    """Convert a value for JSON: dataclasses to objects, arrays to lists."""
    if isinstance(value, Effect):
        shape = value.get_params(deep=False)
        joint = shape.pop("joint")
        return {"name": value.name, "joint": joint, "shape": _encode(shape)}
    if isinstance(value, StateEstimator):
        return {name: _encode(getattr(value, name)) for name in ("dt", *_OF_STATES)}
    if is_dataclass(value):
        return {name: _encode(getattr(value, name)) for name in _saved(type(value))}
    if isinstance(value, Mapping):
        return {key: _encode(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (tuple, list)):
        return [_encode(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value


def _decode(value, kind, at, classes=None):
    """Convert a value that `_encode` wrote back to its type; refuse others."""
    # at: path in the file, such as ``plan.effects[3]``; classes: of effects by name.
    origin, options = get_origin(kind), get_args(kind)
    if origin is UnionType:
        # A value or None.
        return None if value is None else _decode(value, options[0], at, classes)
    if origin is Mapping:
        parts = _plain(value, dict, at).items()
        return {k: _decode(x, options[1], f"{at}.{k}", classes) for k, x in parts}
    if origin is tuple:
        parts = enumerate(_plain(value, list, at))
        items = tuple(_decode(x, options[0], f"{at}[{k}]", classes) for k, x in parts)
        if options[1] is not Ellipsis and len(items) != len(options):
            raise _Wrong(at, f"must hold {len(options)} values")
        return items
    if kind is Effect:
        return _decode_effect(value, at, classes)
    if kind is StateEstimator:
        return _decode_states(value, at)
    if is_dataclass(kind):
        return kind(**_decode_fields(value, kind, at, classes))
    if kind is np.ndarray:
        return _array(value, at)
    if kind is float:
        value = _SPELLED.get(value, value) if isinstance(value, str) else value
        value = float(value) if type(value) is int and abs(value) < 2**63 else value
    return _plain(value, kind, at)


def _decode_fields(value, kind, at, classes):
    hints, before = get_type_hints(kind), f"{at}." if at else ""
    return {
        name: _decode(_value(value, name, at), hints[name], f"{before}{name}", classes)
        for name in _saved(kind)
    }


def _saved(kind):
    names = [field.name for field in fields(kind) if field.init]
    return [name for name in names if name not in _NOT_SAVED]


def _decode_states(value, at):
    attributes = {
        name: np.atleast_1d(_array(_value(value, name, at), f"{at}.{name}"))
        for name in _OF_STATES
    }
    cutoffs = [c if np.isfinite(c) else None for c in attributes["cutoff_"]]
    dt = _decode(_value(value, "dt", at), float, f"{at}.dt")
    estimator = StateEstimator(dt, cutoffs)
    vars(estimator).update(attributes, n_features_in_=len(cutoffs))
    return estimator


def _value(value, key, at=""):
    if key not in _plain(value, dict, at):
        raise _Wrong(f"{at}.{key}" if at else key, "is missing")
    return value[key]


def _plain(value, kind, at):
    if type(value) is not kind:
        raise _Wrong(at, f"must hold {_WORDS[kind]}, not {quoted(value)}")
    return value


def _array(value, at):
    try:
        array = np.array(_decode_setting(value))
    except ValueError:
        raise _Wrong(at, "must hold rows of the same length") from None
    if array.dtype.kind not in "bif":
        raise _Wrong(at, "must hold numbers")
    return array


def readable(value):
    """Return JSON text with each list of plain values on a line."""
    # Floats are written with all their digits.
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, indent=1)
    return _PLAIN_LIST.sub(lambda match: " ".join(match[0].split()), text)
