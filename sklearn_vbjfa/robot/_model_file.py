"""Identified robots as files: readable JSON with the robot description inside."""

import functools
import json
import math
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
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
from sklearn_vbjfa.equations._equations import is_plain
from sklearn_vbjfa.equations._features import Follower, RigidBodyFeatures
from sklearn_vbjfa.equations._plan import check_effects
from sklearn_vbjfa.equations._states import StateEstimator
from sklearn_vbjfa.model._loading import load_text
from sklearn_vbjfa.model._trees import in_order
from sklearn_vbjfa.recording._table import quoted
from sklearn_vbjfa.robot._robot import IdentifiedRobot

FORMAT = "sklearn_vbjfa identified robot"
VERSION = 1
# The beginning of a file, by the types of its values.
_HEAD: dict[str, object] = dict.fromkeys(
    ("joints", "friction", "parameters"), tuple[str, ...]
) | {"gravity": np.ndarray}
# Fields that follow from the others, and what is saved of a fitted `StateEstimator`.
_NOT_SAVED = frozenset({"features_", "source", "_stepper"})
_OF_STATES = ("cutoff_", "noise_variance_", "bandwidth_")
# What JSON has no number for.
_SPELLED = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
# A list of numbers and words like "nan".
_PLAIN_LIST = re.compile(r'\[\s+(?:[-+.\w]+|"-?\w+")(?:,\s+(?:[-+.\w]+|"-?\w+"))*\s+\]')
_WORDS = {float: "a number", int: "a whole number", str: "a text"}
_WORDS |= {bool: "true or false", list: "a list", dict: "an object"}
# Shapes of values: numbers of joints, of parameters, of ranges of effects, ...
_SHAPES = {
    "p": "theta_ theta_unconstrained_ theta_std_ identifiable_ known_",
    "ranges": "effect_ranges_",
    "load": "load_parameters",
    "nv": "noise_floor_ torque_noise_ output_noise_ joint_weights plan.standstill "
    "plan.fastest_period plan.corners gains_.gain gains_.std gains_.reference "
    "prediction_covariance.through prediction_covariance.rest",
    "p p": "prediction_covariance.covariance",
    "k": "recording_variance.places recording_variance.size",
    "scales k": "recording_variance.weights",
}


class _Wrong(ValueError):
    """A key with a wrong value; the file is added where it is known."""

    def __init__(self, at, what):
        super().__init__(f"key {at!r} {what}")


# -- robots ----------------------------------------------------------------------------


def write(path, robot):
    """Write an `IdentifiedRobot` as JSON."""
    from sklearn_vbjfa import __version__

    robot = replace(
        robot,
        text=robot.description_,
        from_urdf=robot.comes_from_urdf,
        package=robot.package or f"sklearn_vbjfa {__version__}",
    )
    gravity = robot.features_.nominal_.gravity
    head = {
        "format": FORMAT,
        "version": VERSION,
        "joints": robot.joint_names_,
        "friction": robot.features_.friction_,
        "gravity": np.r_[gravity.linear, gravity.angular],
        "parameters": robot.parameter_names_,
        "units": robot.parameter_units_,
    }
    try:
        text = readable(encode(head) | encode(robot))
    except TypeError as error:
        raise ValueError(
            f"an effect has a parameter that cannot be saved, {error}; expected "
            "numbers, texts, true, false, None and tuples of these."
        ) from error
    write_whole(path, f"{text}\n")


def read(path, effects=()):
    """Read an `IdentifiedRobot`; ValueError for missing or wrong keys."""
    # effects: classes of those that are not in the library.
    classes, name = _classes(effects), str(path)
    try:
        text = Path(path).read_text(encoding="utf-8")
        content = json.loads(text, parse_constant=_refuse)
    except FileNotFoundError:
        raise FileNotFoundError(f"There is no file {name!r}.") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name!r} is not JSON: {error}.") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(
            f"{name!r} is not an identified robot: its key 'format' is not "
            f"{FORMAT!r}. Files of that format are written by RobotIdentifier.save."
        )
    try:
        return _robot_of(content, name, classes)
    except _Wrong as error:
        raise ValueError(f"{name!r}: {error}.") from error
    except RecursionError:
        raise ValueError(f"{name!r}: it is nested too deeply.") from None


def _refuse(name):
    raise ValueError(f"it holds {name} for a number, JSON has none of that name")


def _robot_of(content, name, classes):
    if content.get("version") != VERSION:
        raise _Wrong(
            "version",
            f"is {quoted(content.get('version'))}, and this release reads version "
            f"{VERSION}: identify the robot again",
        )
    head = {key: decode(_value(content, key), kind, key) for key, kind in _HEAD.items()}
    values = _decode_fields(content, IdentifiedRobot, "", classes)
    _check_shape("gravity", head["gravity"], (6,))
    try:
        model = in_order(load_text(values["text"], name), head["joints"])
    except ValueError as error:
        raise _Wrong("text", f"holds no such robot: {error}") from error
    motion = model.gravity.copy()
    motion.linear, motion.angular = np.split(head["gravity"], 2)
    model.gravity = motion
    try:
        features = RigidBodyFeatures(model, head["friction"]).load()
    except ValueError as error:
        raise _Wrong("friction", f"is invalid: {error}") from error
    try:
        effects = check_effects(values["plan"].effects, model.nv)
    except ValueError as error:
        raise _Wrong("plan.effects", f"is invalid: {error}") from error
    robot = IdentifiedRobot(features_=features.corrected(effects), **values)
    if head["parameters"] != robot.parameter_names_:
        raise _Wrong(
            "parameters",
            "must hold the names of the parameters of the joints, the friction and the "
            "effects in their order",
        )
    _check_sizes(robot)
    return robot


def _check_sizes(robot):
    """Refuse values that do not suit the joints, the friction and the effects."""
    features, between = robot.features_, robot.recording_variance
    plain = (e for e in robot.effects_ if is_plain(e))
    sizes = {
        "nv": features.n_joints_,
        "p": len(robot.parameter_names_),
        "ranges": features.n_joints_ * len(features.friction_) + len(robot.effects_),
        "load": features.n_parameters_ + sum(len(e.coefficients) for e in plain),
    }
    if between is not None:
        sizes |= {"k": between.places.size, "scales": between.scales.size}
    for dimensions, keys in _SHAPES.items():
        for key in keys.split():
            value = functools.reduce(_part, key.split("."), robot)
            if value is not None:
                shape = tuple(sizes[name] for name in dimensions.split())
                _check_shape(key, value, shape)
    for key in ("theta_", "theta_unconstrained_"):
        value = getattr(robot, key)
        if value is None or not np.isfinite(value).all():
            raise _Wrong(key, "must hold finite numbers")


def _part(value, key):
    return None if value is None else getattr(value, key)


def _check_shape(key, value, shape):
    found = (len(value),) if isinstance(value, tuple) else np.shape(value)
    if found != shape:
        raise _Wrong(key, f"must hold values of shape {shape}, not {found}")


# -- effects ---------------------------------------------------------------------------


def _classes(effects):
    if isinstance(effects, (type, Effect)):
        effects = (effects,)
    # What a robot has without a search in the library.
    found = {
        one.name: one for one in (Follower, CommandDelay, TorqueLag, UnnamedTorque)
    }
    for one in effects:
        kind = one if isinstance(one, type) else type(one)
        if not issubclass(kind, Effect):
            raise ValueError(
                f"effects must hold classes of effects, such as MyEffect; got {one!r}."
            )
        found[kind.name] = kind
    return found


def _of_library(name):
    """Return the class that the library has under a name, None without."""
    return type(resolve([name])[0]) if name in available() else None


def _encode_effect(effect):
    shape = effect.get_params(deep=False)
    shape.pop("joint")
    return {
        "name": effect.name,
        "of_library": type(effect) is _of_library(effect.name),
        "joint": effect.joint,
        "shape": encode(shape),
    }


def _decode_setting(value):
    if isinstance(value, list):
        return tuple(map(_decode_setting, value))
    return _SPELLED.get(value, value) if isinstance(value, str) else value


def _decode_effect(value, at, classes):
    kinds = {"name": str, "of_library": bool, "joint": int, "shape": dict}
    name, of_library, joint, shape = (
        decode(_value(value, key, at), kind, f"{at}.{key}")
        for key, kind in kinds.items()
    )
    kind = _of_library(name) if of_library else classes.get(name)
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


def encode(value):
    """Return a value as JSON has it: dataclasses as objects, arrays as lists."""
    if isinstance(value, Effect):
        return _encode_effect(value)
    if isinstance(value, StateEstimator):
        return {name: encode(getattr(value, name)) for name in ("dt", *_OF_STATES)}
    if is_dataclass(value):
        return {name: encode(getattr(value, name)) for name in _saved(type(value))}
    if isinstance(value, Mapping):
        return {key: encode(one) for key, one in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (tuple, list)):
        return [encode(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value


def decode(value, kind, at, classes=None):
    """Return the value of a type that `encode` wrote; refuse another."""
    # at: where it is, such as ``plan.effects[3]``; classes: of effects, by name.
    origin, options = get_origin(kind), get_args(kind)
    if origin is UnionType:
        return _decode_one_of(value, options, at, classes)
    if origin is Mapping:
        parts = _plain(value, dict, at).items()
        return {k: decode(one, options[1], f"{at}.{k}", classes) for k, one in parts}
    if origin is tuple:
        parts = enumerate(_plain(value, list, at))
        found = tuple(decode(x, options[0], f"{at}[{k}]", classes) for k, x in parts)
        if options[1] is not Ellipsis:
            _check_shape(at, found, (len(options),))
        return found
    if kind is Effect:
        return _decode_effect(value, at, classes)
    if kind is StateEstimator:
        return _decode_states(value, at)
    if is_dataclass(kind):
        return kind(**_decode_fields(value, kind, at, classes))
    if kind is np.ndarray:
        return _array(value, at)
    return _number(value, at) if kind is float else _plain(value, kind, at)


def _decode_fields(value, kind, at, classes):
    hints, before = get_type_hints(kind), f"{at}." if at else ""
    return {
        name: decode(_value(value, name, at), hints[name], f"{before}{name}", classes)
        for name in _saved(kind)
    }


def _saved(kind):
    names = [field.name for field in fields(kind) if field.init]
    return [name for name in names if name not in _NOT_SAVED]


def _decode_one_of(value, kinds, at, classes):
    if value is None and NoneType in kinds:
        return None
    *others, last = (kind for kind in kinds if kind is not NoneType)
    for kind in others:
        try:
            return decode(value, kind, at, classes)
        except _Wrong:
            continue
    return decode(value, last, at, classes)


def _decode_states(value, at):
    found = {
        name: np.atleast_1d(_array(_value(value, name, at), f"{at}.{name}"))
        for name in _OF_STATES
    }
    for name, own in found.items():
        _check_shape(f"{at}.{name}", own, found["cutoff_"].shape)
    cutoffs = [c if np.isfinite(c) else None for c in found["cutoff_"]]
    estimator = StateEstimator(_number(_value(value, "dt", at), f"{at}.dt"), cutoffs)
    vars(estimator).update(found, n_features_in_=len(cutoffs))
    return estimator


def _value(value, key, at=""):
    if key not in _plain(value, dict, at):
        raise _Wrong(f"{at}.{key}" if at else key, "is missing")
    return value[key]


def _plain(value, kind, at):
    if type(value) is not kind:
        raise _Wrong(at, f"must hold {_WORDS[kind]}, not {quoted(value)}")
    return value


def _number(value, at):
    """Return a float; "nan", "inf" and "-inf" are read as these values."""
    found = _SPELLED.get(value) if isinstance(value, str) else value
    if isinstance(found, int) and not isinstance(found, bool):
        found = float(found) if abs(found) < 2**63 else None
    return _plain(value if found is None else found, float, at)


def _array(value, at):
    if isinstance(value, list) and value and all(type(one) is bool for one in value):
        return np.array(value)
    numbers = _numbers(value, at)
    try:
        return np.array(numbers)
    except ValueError:
        raise _Wrong(at, "must hold rows of the same length") from None


def _numbers(value, at):
    if isinstance(value, list):
        return [_numbers(one, f"{at}[{k}]") for k, one in enumerate(value)]
    number = _number(value, at)
    return value if type(value) is int else number


def readable(value):
    """Return JSON text with each list of plain values on a line."""
    # Floats are written so that the same ones are read.
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, indent=1)
    return _PLAIN_LIST.sub(lambda found: " ".join(found[0].split()), text)
