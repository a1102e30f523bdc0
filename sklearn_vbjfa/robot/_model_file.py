"""Identified robots as files: readable JSON with the robot description inside."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import get_args, get_origin, get_type_hints

import numpy as np

from sklearn_vbjfa._core import write_whole
from sklearn_vbjfa.effects import (
    CommandDelay,
    Effect,
    Follower,
    Shaped,
    TorqueLag,
    available,
    resolve,
)
from sklearn_vbjfa.model._loading import load_text
from sklearn_vbjfa.model._trees import in_order
from sklearn_vbjfa.recording._table import quoted
from sklearn_vbjfa.robot._equations import is_plain
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._robot import IdentifiedRobot
from sklearn_vbjfa.robot._states import StateEstimator

FORMAT = "sklearn_vbjfa identified robot"
VERSION = 1


# What follows from the rest, or is of no use elsewhere.
_NOT_SAVED = frozenset({"features_", "source", "_stepper"})


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
    write_whole(path, f"{readable(encode(head) | encode(robot))}\n")


def read(path, effects=()):
    """Read an `IdentifiedRobot`; ValueError for missing or wrong keys."""
    # effects: classes of those that are not in the library.
    file = read_place(path)
    if not isinstance(file.value, dict) or file.value.get("format") != FORMAT:
        raise ValueError(
            f"{file.path!r} is not an identified robot: its key 'format' is not "
            f"{FORMAT!r}. Files of that format are written by RobotIdentifier.save."
        )
    version = file["version"].value
    if version != VERSION:
        raise file["version"].wrong(
            f"is {quoted(version)}, and this release reads version {VERSION}: identify "
            "the robot again, or install the release that wrote it"
        )
    classes = _classes(effects)
    try:
        values = decode_fields(file, IdentifiedRobot, classes)
        friction = decode(file["friction"], tuple[str, ...])
    except RecursionError:
        raise file.wrong("is nested too deeply") from None
    try:
        features = RigidBodyFeatures(_nominal(file), friction).load()
    except ValueError as error:
        raise file["friction"].wrong(f"is of no use: {error}") from error
    _check_joints(file["plan"]["effects"], values["plan"].effects, features.n_joints_)
    features = features.corrected(values["plan"].effects)
    robot = IdentifiedRobot(features_=features, **values)
    _check(file, robot)
    return robot


def _nominal(file):
    """Build the model of the description, with its joints in the order of the file."""
    urdf, joints = decode(file["text"], str), decode(file["joints"], tuple[str, ...])
    try:
        model = in_order(load_text(urdf, file.path), joints)
    except ValueError as error:
        raise file["text"].wrong(f"holds no such robot: {error}") from error
    values = file["gravity"].array((6,))
    gravity = model.gravity.copy()
    gravity.linear, gravity.angular = np.split(values, 2)
    model.gravity = gravity
    return model


def _check_joints(place, effects, nv):
    """Refuse effects of joints that the robot does not have."""
    for one, effect in zip(place.items(), effects):
        if effect.joint not in range(nv):
            raise one["joint"].wrong(f"must be one of the {nv} joints, from zero")
        for key in effect.partners if isinstance(effect, Shaped) else ():
            partner = getattr(effect, key)
            if partner == effect.joint or partner not in range(nv):
                raise one["shape"][key].wrong(
                    f"must be another joint, counted from zero; it is {partner!r}"
                )


def _check(file, robot):
    """Refuse values that do not suit the joints, the friction and the effects."""
    names = decode(file["parameters"], tuple[str, ...])
    if names != robot.parameter_names_:
        raise file["parameters"].wrong(
            "must hold the names of the parameters of the joints, the friction and the "
            "effects in their order"
        )
    nv, m, p = len(robot.joint_names_), len(robot.features_.friction_), len(names)
    widths = [len(effect.coefficients) for effect in robot.effects_]
    file["known_"].items(p)
    file["effect_ranges_"].items(nv * m + len(widths))
    file["coefficient_covariances"].items(len(widths))
    for key in ("theta_", "theta_unconstrained_"):
        file[key].array((p,))
    for key in ("theta_std_", "identifiable_"):
        file[key].array((p,), finite=False)
    plain = np.array([is_plain(effect) for effect in robot.effects_], bool)
    load = robot.features_.n_parameters_ + int(np.sum(np.array(widths)[plain]))
    shapes = {
        "load_parameters": (load,),
        "noise_floor_": (nv,),
        "torque_noise_": (nv,),
        "output_noise_": (nv,),
        "joint_weights": (nv,),
        "plan.standstill": (nv,),
        "plan.fastest_period": (nv,),
        "plan.corners": (nv,),
        "gains_.gain": (nv,),
        "gains_.std": (nv,),
        "gains_.reference": (nv,),
        "powers.friction": (nv, m),
        "prediction_covariance.covariance": (p, p),
        "prediction_covariance.through": (nv,),
        "prediction_covariance.rest": (nv,),
    }
    for k, width in enumerate(widths):
        size = width + len(robot.coefficient_covariances[k].shape)
        shapes[f"coefficient_covariances.{k}.covariance"] = size, size
        shapes[f"powers.effects.{k}"] = nv, width, width
    between = robot.recording_variance
    if between is not None:
        k, m = between.places.size, between.scales.size
        shapes["recording_variance.size"] = (k,)
        shapes["recording_variance.weights"] = m, k
    for key, shape in shapes.items():
        place = file.part(key)
        if place is not None:
            place.array(shape, finite=False)
    for key, n in (("recording_variance.places", p), ("gains_.reference", nv)):
        place = file.part(key)
        if place is not None and not np.isin(place.numbers(), np.arange(n)).all():
            raise place.wrong(f"must hold whole numbers from 0 to {n - 1}")
    _check_plan(file["plan"], robot.plan)


def _check_plan(place, plan):
    """Refuse an invalid sample period or cut-off."""
    if plan.dt is not None and not 0 < plan.dt < math.inf:
        raise place["dt"].wrong("must be greater than zero")
    try:
        found = plan.lowpass
    except (ValueError, ZeroDivisionError) as error:
        raise place["cutoff"].wrong(f"is of no use: {error}") from error
    if not np.isfinite(found.taps).all():
        raise place["cutoff"].wrong("is of no use")


# -- how positions were smoothed -------------------------------------------------------

_OF_STATES = ("cutoff_", "noise_variance_", "bandwidth_")


def _encode_states(estimator):
    """Return a fitted `StateEstimator` as a dict."""
    values = {name: encode(getattr(estimator, name)) for name in _OF_STATES}
    return {"dt": estimator.dt} | values


def _decode_states(place):
    """Return a fitted `StateEstimator`."""
    cutoffs = place["cutoff_"].numbers()
    given = [c if np.isfinite(c) else None for c in np.ravel(cutoffs)]
    estimator = StateEstimator(place["dt"].number(), cutoff=given)
    estimator.n_features_in_ = len(given)
    for name in _OF_STATES:
        setattr(estimator, name, place[name].array((len(given),), finite=False))
    return estimator


# -- effects ---------------------------------------------------------------------------


def _classes(effects):
    """Return classes of effects by their names."""
    if isinstance(effects, (type, Effect)):
        effects = (effects,)
    # A robot declares its followers, the delay of its commands and the lag of its
    # torques; the library has none to search for.
    found = {one.name: one for one in (Follower, CommandDelay, TorqueLag)}
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
    """Return what an effect is set to, a dict."""
    shape = effect.get_params(deep=False)
    shape.pop("joint")
    for key, value in shape.items():
        if not _is_setting(value):
            raise ValueError(
                f"{key} of the effect {effect.name!r} is {value!r}, and only numbers, "
                "texts, true, false, None and tuples of these can be saved."
            )
    return {
        "name": effect.name,
        "of_library": type(effect) is _of_library(effect.name),
        "joint": effect.joint,
        "shape": {key: _encode_setting(value) for key, value in shape.items()},
    }


def _is_setting(value):
    """Whether a file can hold a parameter of an effect."""
    if isinstance(value, (tuple, list)):
        return all(map(_is_setting, value))
    return value is None or isinstance(value, (bool, int, float, str, np.generic))


def _encode_setting(value):
    """Return a parameter of an effect as JSON has it."""
    if isinstance(value, (tuple, list)):
        return [_encode_setting(one) for one in value]
    plain = encode(value)
    # Texts stay texts, so that numbers that JSON lacks are objects.
    changed = isinstance(plain, str) and not isinstance(value, str)
    return {"number": plain} if changed else plain


def _decode_setting(place):
    """Return a parameter of an effect, lists as tuples."""
    if isinstance(place.value, list):
        return tuple(_decode_setting(one) for one in place.items())
    if isinstance(place.value, dict):
        return place["number"].number()
    return place.value


def _decode_effect(place, classes):
    """Return an effect."""
    name = decode(place["name"], str)
    if decode(place["of_library"], bool):
        kind = _of_library(name)
        if kind is None:
            raise place["name"].wrong(
                f"is {name!r}, which the library of this release does not have"
            )
    elif name in classes:
        kind = classes[name]
    else:
        raise place["name"].wrong(
            f"is {name!r}, an effect that is not in the library: give its class, "
            "load_identified(path, effects=[...])"
        )
    joint = decode(place["joint"], int)
    shape = {key: _decode_setting(one) for key, one in place["shape"].parts().items()}
    try:
        effect = kind(joint=joint, **shape)
        effect.check()
    except (TypeError, ValueError) as error:
        raise place["shape"].wrong(f"does not suit {name!r}: {error}") from error
    return effect


# -- values of declared types ----------------------------------------------------------

# What JSON has no number for.
_SPELLED = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
_WORDS = {bool: "true or false", int: "a whole number", str: "a text"}
# Width of a line that a list or an object of plain values stays on.
_WIDTH = 240


def encode(value):
    """Return a value as JSON has it: dataclasses as objects, arrays as lists."""
    if isinstance(value, Effect):
        return _encode_effect(value)
    if isinstance(value, StateEstimator):
        return _encode_states(value)
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


def decode(place, kind, classes=None):
    """Return the value of a type that `encode` wrote; ValueError if it is another."""
    # classes: of effects that are not in the library, by name.
    origin, options = get_origin(kind), get_args(kind)
    if origin is UnionType:
        return _decode_one_of(place, options, classes)
    if origin is Mapping:
        parts = place.parts()
        return {key: decode(one, options[1], classes) for key, one in parts.items()}
    if origin is tuple:
        n = None if options[1] is Ellipsis else len(options)
        return tuple(decode(one, options[0], classes) for one in place.items(n))
    if kind is Effect:
        return _decode_effect(place, classes)
    if kind is StateEstimator:
        return _decode_states(place)
    if is_dataclass(kind):
        values = decode_fields(place, kind, classes)
        try:
            return kind(**values)
        except ValueError as error:
            raise place.wrong(f"is of no use: {error}") from error
    if kind is np.ndarray:
        return place.numbers()
    if kind is float:
        return place.number()
    if type(place.value) is not kind:
        raise place.wrong(f"must hold {_WORDS[kind]}, not {quoted(place.value)}")
    return place.value


def decode_fields(place, kind, classes):
    """Return the values of a dataclass by the names of its fields."""
    hints = get_type_hints(kind)
    return {name: decode(place[name], hints[name], classes) for name in _saved(kind)}


def _saved(kind):
    """Return the names of the fields of a dataclass that a file holds."""
    names = [field.name for field in fields(kind) if field.init]
    return [name for name in names if name not in _NOT_SAVED]


def _decode_one_of(place, kinds, classes):
    """Return a value of one of several types, the first that it suits."""
    if place.value is None and NoneType in kinds:
        return None
    *others, last = (kind for kind in kinds if kind is not NoneType)
    for kind in others:
        try:
            return decode(place, kind, classes)
        except ValueError:
            continue
    return decode(place, last, classes)


@dataclass(frozen=True, kw_only=True)
class Place:
    """A value in a file."""

    path: str
    at: str  # where the value is, such as ``parameters[3].value``
    value: object  # what the JSON holds

    def wrong(self, what):
        """Return the error that says what is wrong with the value."""
        where = f"key {self.at!r} " if self.at else "it "
        return ValueError(f"{self.path!r}: {where}{what}.")

    def parts(self):
        """Return the values of an object by their keys."""
        if not isinstance(self.value, dict):
            raise self.wrong("must hold an object")
        before = f"{self.at}." if self.at else ""
        return {
            key: Place(path=self.path, at=f"{before}{key}", value=value)
            for key, value in self.value.items()
        }

    def __getitem__(self, key):
        """Return the value of a key of an object, a `Place`."""
        parts = self.parts()
        if key not in parts:
            at = f"{self.at}.{key}" if self.at else key
            raise Place(path=self.path, at=at, value=None).wrong("is missing")
        return parts[key]

    def part(self, keys):
        """Return the value at keys with dots between them; None at or below null."""
        place = self
        for key in keys.split("."):
            place = place.items()[int(key)] if key.isdigit() else place[key]
            if place.value is None:
                return None
        return place

    def items(self, n=None):
        """Return the values of a list, of n values where that is given."""
        if not isinstance(self.value, list):
            raise self.wrong("must hold a list")
        if n is not None and len(self.value) != n:
            raise self.wrong(f"must hold {n} values, not {len(self.value)}")
        return [
            Place(path=self.path, at=f"{self.at}[{k}]", value=value)
            for k, value in enumerate(self.value)
        ]

    def number(self):
        """Return a float; "nan", "inf" and "-inf" are read as these values."""
        value = self.value
        if isinstance(value, str):
            value = _SPELLED.get(value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.wrong(f"must hold a number, not {quoted(self.value)}")
        try:
            return float(value)
        except OverflowError:
            raise self.wrong("holds a number that is too large") from None

    def numbers(self):
        """Return the numbers, or the truths, of lists within lists, ndarray."""
        if isinstance(self.value, list) and self.value:
            if all(isinstance(one, bool) for one in self.value):
                return np.array(self.value)
        nested = self._nested()
        try:
            return np.array(nested, int if _whole(nested) else float)
        except (ValueError, OverflowError):
            raise self.wrong("must hold rows of the same length") from None

    def array(self, shape, *, finite=True):
        """Return the numbers of an array of this shape."""
        found = self.numbers()
        if found.shape != shape:
            raise self.wrong(f"must hold numbers of shape {shape}, not {found.shape}")
        if finite and not np.isfinite(found).all():
            raise self.wrong("must hold finite numbers")
        return found

    def _nested(self):
        """Return the numbers as nested lists, whole ones as they are."""
        if isinstance(self.value, list):
            return [one._nested() for one in self.items()]
        number = self.number()
        return self.value if type(self.value) is int else number


def _whole(nested):
    """Whether all numbers of nested lists are whole, and there are any."""
    if isinstance(nested, list):
        return bool(nested) and all(map(_whole, nested))
    return isinstance(nested, int)


def read_place(path):
    """Read a JSON file, a `Place`; ValueError if it is not JSON."""
    name = str(path)
    try:
        text = Path(path).read_text(encoding="utf-8")
        return Place(
            path=name, at="", value=json.loads(text, parse_constant=_no_number)
        )
    except FileNotFoundError:
        raise FileNotFoundError(f"There is no file {name!r}.") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name!r} is not JSON: {error}.") from error


def _no_number(name):
    raise ValueError(f"it holds {name} for a number, JSON has none of that name")


def readable(value, indent=0):
    """Write JSON with one line for each list or object of plain values."""
    # Floats are written so that the same ones are read.
    if not isinstance(value, (dict, list)) or not value:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    inner = value.values() if isinstance(value, dict) else value
    if not any(isinstance(one, (dict, list)) for one in inner):
        line = json.dumps(value, ensure_ascii=False, allow_nan=False)
        if len(line) <= _WIDTH:
            return line
    pad = " " * (indent + 1)
    if isinstance(value, dict):
        lines = [
            f"{json.dumps(key, ensure_ascii=False)}: {readable(one, indent + 1)}"
            for key, one in value.items()
        ]
        ends = "{}"
    else:
        lines, ends = [readable(one, indent + 1) for one in value], "[]"
    body = f",\n{pad}".join(lines)
    return f"{ends[0]}\n{pad}{body}\n{' ' * indent}{ends[1]}"
