"""Identified robots as files: readable JSON with the robot description inside."""

import json
import math
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from sklearn_vbjfa._core import _lowpass, write_whole
from sklearn_vbjfa.effects import (
    SPEED,
    CommandDelay,
    Effect,
    EffectRange,
    Follower,
    Shaped,
    available,
    resolve,
)
from sklearn_vbjfa.model._loading import joint_names, load_text
from sklearn_vbjfa.model._trees import in_order, is_prismatic
from sklearn_vbjfa.recording._table import quoted
from sklearn_vbjfa.robot._equations import is_plain
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._gains import ChannelGains, CommonGain, KnownMass
from sklearn_vbjfa.robot._plan import Plan
from sklearn_vbjfa.robot._posterior import BetweenRecordings
from sklearn_vbjfa.robot._robot import IdentifiedRobot
from sklearn_vbjfa.robot._spreads import ColumnMeanSquares, Spread, TorqueSpread
from sklearn_vbjfa.robot._states import StateEstimator

FORMAT = "sklearn_vbjfa identified robot"
VERSION = 1
_URDF_IS = ("that of the robot", "written from a model")
_KNOWN = ("yes", "in combination", "from the description", "no")


# -- writing ---------------------------------------------------------------------------


def write(path, robot):
    """Write an `IdentifiedRobot` as JSON."""
    write_whole(path, f"{readable(_content(robot))}\n")


def _content(robot):
    """Return what a file holds, dicts and lists of plain values."""
    from sklearn_vbjfa import __version__

    features, plan = robot.features_, robot.plan
    nominal = features.nominal_
    kinds = is_prismatic(nominal)
    return {
        "format": FORMAT,
        "version": VERSION,
        "saved_with": robot.package or f"sklearn_vbjfa {__version__}",
        "joints": [
            {
                "name": name,
                "kind": "prismatic" if prismatic else "revolute",
                "standstill": spelled(plan.standstill[j]),
                "standstill_unit": SPEED[int(prismatic)],
                "noise_floor": spelled(robot.noise_floor_[j]),
                "noise_floor_unit": "N" if prismatic else "N m",
                "channel_gain": spelled(features.gains_[j]),
            }
            for j, (name, prismatic) in enumerate(zip(joint_names(nominal), kinds))
        ],
        "gravity": {
            "linear": spelled_all(nominal.gravity.linear),
            "linear_unit": "m/s^2",
            "angular": spelled_all(nominal.gravity.angular),
            "angular_unit": "rad/s^2",
        },
        "friction": list(features.friction_),
        "parameters": _parameters(robot, slice(0, features.n_parameters_)),
        "effects": _effects(robot),
        "unknown_gains": None if robot.gains_ is None else _gains(robot.gains_),
        "fit": _fit(robot),
        "ranges": [_range(one, joint_names(nominal)) for one in robot.effect_ranges_],
        "signals": {
            name: {"lowest": spelled(low), "highest": spelled(high)}
            for name, (low, high) in robot.signal_ends.items()
        },
        "column_powers": _powers(robot),
        "torque_spread": _torque_spread(robot.prediction_covariance),
        "unconstrained": spelled_all(robot.theta_unconstrained_),
        "between_recordings": _between(robot),
        "urdf_is": _URDF_IS[0 if robot.comes_from_urdf else 1],
        "urdf": robot.description_.split("\n"),
    }


def _parameters(robot, rows):
    """Return a slice of the parameters, a list of dict."""
    theta, load = robot.theta_, _load_of_all(robot)
    return [
        {
            "name": robot.parameter_names_[k],
            "value": spelled(theta[k]),
            "unit": robot.parameter_units_[k],
            "std": spelled(robot.theta_std_[k]),
            "identifiable": bool(robot.identifiable_[k]),
            "known": robot.known_[k],
            "in_load": None if load[k] is None else spelled(load[k]),
        }
        for k in range(theta.size)[rows]
    ]


def _load_of_all(robot):
    """Value of each parameter in the load of the effects; None where it has none."""
    n = robot.theta_.size
    if robot.load_parameters is None:
        return n * [None]
    part_of = np.ones(n, dtype=bool)
    at = robot.features_.n_parameters_
    for effect in robot.effects_:
        part_of[at : at + len(effect.coefficients)] = is_plain(effect)
        at += len(effect.coefficients)
    values = iter(robot.load_parameters)
    return [next(values) if own else None for own in part_of]


def _effects(robot):
    """Return the effects, a list of dict."""
    names, kinds = robot.joint_names_, is_prismatic(robot.features_.model_)
    at, found = robot.features_.n_parameters_, []
    spreads = robot.coefficient_covariances
    for effect, spread in zip(robot.effects_, spreads):
        rows = slice(at, at + len(effect.coefficients))
        at = rows.stop
        settings = _settings(effect)
        units = effect.parameter_units(kinds[effect.joint])
        found.append(
            {
                "name": effect.name,
                "of_library": of_library(effect),
                "joint": names[effect.joint],
                "shape": settings,
                "shape_units": {key: units[key] for key in settings if key in units},
                "parameters": _parameters(robot, rows),
                "spread": {
                    "of": list(spread.shape),
                    "covariance": spelled_all(spread.covariance),
                },
            }
        )
    return found


def of_library(effect):
    """Whether an effect is one that the library has under its name."""
    return effect.name in available() and type(effect) is type(_of_name(effect.name))


def _of_name(name):
    (found,) = resolve([name])
    return found


def _settings(effect):
    """Return what an effect is set to, beside its joint, as plain values."""
    settings = effect.get_params(deep=False)
    settings.pop("joint")
    found = {}
    for key, value in settings.items():
        plain = _plain(value)
        if plain is _NOT_PLAIN:
            raise ValueError(
                f"{key} of the effect {effect.name!r} is {value!r}, and only numbers, "
                "texts, true, false, None and tuples of these can be saved."
            )
        found[key] = plain
    return found


_NOT_PLAIN = object()


def _plain(value):
    """Return a value as JSON has it, or `_NOT_PLAIN`."""
    # Texts stay texts, so that numbers that JSON lacks are objects.
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        told = spelled(value)
        return {"number": told} if isinstance(told, str) else told
    if isinstance(value, (tuple, list)):
        plain = [_plain(one) for one in value]
        return _NOT_PLAIN if any(one is _NOT_PLAIN for one in plain) else plain
    return _NOT_PLAIN


def _gains(gains):
    common = gains.common
    return {
        "gain": spelled_all(gains.gain),
        "std": spelled_all(gains.std),
        "relative_to": [gains.joint_names[j] for j in gains.reference],
        "common": {
            "factor": None if common.factor is None else spelled(common.factor),
            "std": spelled(common.std),
            "p_value": spelled(common.p_value),
            "masses": [
                {
                    "name": mass.name,
                    "mass": spelled(mass.mass),
                    "mass_unit": "kg",
                    "found": spelled(mass.found),
                    "std": spelled(mass.std),
                    "shown": bool(mass.shown),
                    "used": bool(mass.used),
                }
                for mass in common.masses
            ],
        },
    }


def _fit(robot):
    """Return how the fit smoothed and filtered, a dict."""
    plan, states = robot.plan, robot.plan.state_estimator
    period, cutoff = plan.fastest_period, robot.state_cutoff
    return {
        "dt": None if plan.dt is None else spelled(plan.dt),
        "dt_unit": "s",
        "cutoff": spelled(plan.cutoff),
        "cutoff_unit": "Hz",
        "time": None if plan.time is None else spelled_all(plan.time),
        "time_unit": "s",
        "fastest_period": None if period is None else spelled_all(period),
        "fastest_period_unit": "s",
        "corners": None if plan.corners is None else spelled_all(plan.corners),
        "corners_unit": "rad/s^2 or m/s^2",
        "state_cutoff": _state_cutoff(cutoff),
        "state_cutoff_unit": "Hz",
        "states": None
        if states is None
        else {
            "cutoff": spelled_all(states.cutoff_),
            "cutoff_unit": "Hz",
            "noise_variance": spelled_all(states.noise_variance_),
            "noise_variance_unit": "rad^2 or m^2",
            "bandwidth": spelled_all(states.bandwidth_),
            "bandwidth_unit": "Hz",
        },
    }


def _state_cutoff(cutoff):
    if cutoff is None or isinstance(cutoff, str):
        return cutoff
    return [
        None if one is None else spelled(one)
        for one in np.ravel(np.asarray(cutoff, dtype=object))
    ]


def _range(one, names):
    found = {
        field.name: getattr(one, field.name)
        for field in fields(one)
        if field.name not in {"joint", "depends"}
    }
    found = {
        key: spelled_all(value) if isinstance(value, tuple) else value
        for key, value in found.items()
    }
    return {
        "name": found.pop("name"),
        "joint": names[one.joint],
        "depends": list(one.depends),
    } | found


def _powers(robot):
    """Return how large columns were in the fit; None where that is not known."""
    powers, names = robot.powers, robot.joint_names_
    if powers is None:
        return None
    return {
        "friction": spelled_all(powers.friction),
        "effects": [
            [
                {"joint": name, "products": spelled_all(own)}
                for name, own in zip(names, block)
                if not (own == 0).all()
            ]
            for block in powers.effects
        ],
    }


def _torque_spread(spread):
    """Return what deviations of torques are made of; None where that is not known."""
    if spread is None:
        return None
    return {
        "covariance": [
            spelled_all(row[: k + 1]) for k, row in enumerate(spread.covariance)
        ],
        "through": spelled_all(spread.through),
        "rest": spelled_all(spread.rest),
    }


def _between(robot):
    """Return how far values are off from recording to recording; None without."""
    between = robot.recording_variance
    if between is None:
        return None
    names, units = robot.parameter_names_, robot.parameter_units_
    return {
        "recordings": between.count,
        "scales": spelled_all(between.scales),
        "parameters": [
            {
                "name": names[k],
                "size": spelled(between.size[i]),
                "unit": units[k],
                "weights": spelled_all(between.weights[:, i]),
            }
            for i, k in enumerate(between.places)
        ],
    }


# -- reading ---------------------------------------------------------------------------


def read(path, effects=()):
    """Read an `IdentifiedRobot`; ValueError for what is missing or wrong."""
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
    return _read_robot(file, _classes(effects))


def _classes(effects):
    """Return classes of effects by their names."""
    if isinstance(effects, (type, Effect)):
        effects = (effects,)
    # A robot declares its followers and the delay of its commands; the library has
    # none to search for.
    found = {one.name: one for one in (Follower, CommandDelay)}
    for one in effects:
        kind = one if isinstance(one, type) else type(one)
        if not issubclass(kind, Effect):
            raise ValueError(
                f"effects must hold classes of effects, such as MyEffect; got {one!r}."
            )
        found[kind.name] = kind
    return found


def _read_robot(file, classes):
    model = _nominal(file)
    names = joint_names(model)
    effects, parameters, spreads = _read_effects(file["effects"], names, classes)
    friction = file["friction"]
    try:
        features = RigidBodyFeatures(model, friction.texts()).load()
    except ValueError as error:
        raise friction.wrong(f"is of no use: {error}") from error
    features = features.corrected(effects)
    rows = file["parameters"].items() + parameters
    robot = IdentifiedRobot(
        features_=features,
        plan=_plan(file, effects),
        theta_=np.array([row["value"].number() for row in rows]),
        load_parameters=_load(rows),
        effect_ranges_=tuple(
            _read_range(one, names)
            for one in file["ranges"].items(
                len(names) * len(features.friction_) + len(effects)
            )
        ),
        signal_ends={
            name: (
                file["signals"][name]["lowest"].number(),
                file["signals"][name]["highest"].number(),
            )
            for name in file["signals"].keys()
        },
        coefficient_covariances=spreads,
        state_cutoff=_read_state_cutoff(file["fit"]["state_cutoff"]),
        powers=_read_powers(file, names, features, effects),
        prediction_covariance=_read_torque_spread(file, features, effects),
        text="\n".join(file["urdf"].texts()),
        from_urdf=file["urdf_is"].one_of(_URDF_IS) == _URDF_IS[0],
        theta_std_=np.array([row["std"].number() for row in rows]),
        identifiable_=np.array([row["identifiable"].truth() for row in rows], bool),
        known_=tuple(row["known"].one_of(_KNOWN) for row in rows),
        noise_floor_=np.array(
            [j["noise_floor"].number() for j in file["joints"].items()]
        ),
        gains_=_read_gains(file["unknown_gains"], names),
        package=file["saved_with"].text(),
    )
    _check_names(file, rows, robot)
    return replace(
        robot,
        recording_variance=_read_between(file, robot.parameter_names_),
        theta_unconstrained_=file["unconstrained"].numbers(len(rows), finite=True),
    )


def _of_joints(file, key):
    """Return a number of each joint, (nv,)."""
    return np.array([joint[key].number() for joint in file["joints"].items()])


def _nominal(file):
    """Build the model of the description, with its joints in the order of the file."""
    urdf = "\n".join(file["urdf"].texts())
    names = tuple(joint["name"].text() for joint in file["joints"].items())
    try:
        model = in_order(load_text(urdf, file.path), names)
    except ValueError as error:
        raise file["urdf"].wrong(f"holds no such robot: {error}") from error
    for joint, prismatic in zip(file["joints"].items(), is_prismatic(model)):
        kind = ("revolute", "prismatic")[int(prismatic)]
        if joint["kind"].text() != kind:
            raise joint["kind"].wrong(f"is not that of the description, {kind}")
    gravity = model.gravity.copy()
    gravity.linear = file["gravity"]["linear"].numbers(3, finite=True)
    gravity.angular = file["gravity"]["angular"].numbers(3, finite=True)
    model.gravity = gravity
    return model


def _read_effects(place, names, classes):
    """Return effects, the places of their parameters, and their spreads."""
    effects, rows, spreads = [], [], []
    for one in place.items():
        effect = _read_effect(one, names, classes)
        own = one["parameters"].items(len(effect.coefficients))
        shape = one["spread"]["of"].texts()
        size = len(own) + len(shape)
        covariance = [
            row.numbers(size) for row in one["spread"]["covariance"].items(size)
        ]
        effects.append(effect)
        rows += own
        spreads.append(
            Spread(shape=shape, covariance=np.array(covariance).reshape(size, size))
        )
    return tuple(effects), rows, tuple(spreads)


def _read_effect(place, names, classes):
    name = place["name"].text()
    if place["of_library"].truth():
        if name not in available():
            raise place["name"].wrong(
                f"is {name!r}, which the library of this release does not have"
            )
        kind = type(_of_name(name))
    elif name in classes:
        kind = classes[name]
    else:
        raise place["name"].wrong(
            f"is {name!r}, an effect that is not in the library: give its class, "
            "load_identified(path, effects=[...])"
        )
    joint = names.index(place["joint"].one_of(names))
    shape = {key: _value(place["shape"][key]) for key in place["shape"].keys()}
    try:
        effect = kind(joint=joint, **shape)
        effect.check()
    except (TypeError, ValueError) as error:
        raise place["shape"].wrong(f"does not suit {name!r}: {error}") from error
    for key in effect.partners if isinstance(effect, Shaped) else ():
        partner = getattr(effect, key)
        if partner == joint or partner not in range(len(names)):
            raise place["shape"][key].wrong(
                f"must be another joint, counted from zero; it is {partner!r}"
            )
    return effect


def _value(place):
    """Return a parameter of an effect, lists as tuples."""
    if isinstance(place.value, list):
        return tuple(_value(one) for one in place.items())
    if isinstance(place.value, dict):
        return place["number"].number()
    return place.value


def _load(rows):
    """Return the parameters in the load of the effects; None without."""
    told = [row["in_load"] for row in rows]
    values = [one.number() for one in told if not one.absent]
    return np.array(values) if values else None


def _plan(file, effects):
    fit = file["fit"]
    dt = None if fit["dt"].absent else fit["dt"].number(finite=True)
    if dt is not None and not dt > 0:
        raise fit["dt"].wrong("must be greater than zero")
    cutoff = fit["cutoff"].number()
    try:
        lowpass = _lowpass.design(dt or 1.0, cutoff)
    except (ValueError, ZeroDivisionError) as error:
        raise fit["cutoff"].wrong(f"is of no use: {error}") from error
    nv = len(file["joints"].items())
    period, time = fit["fastest_period"], fit["time"]
    corners = fit["corners"]
    return Plan(
        dt=dt,
        state_estimator=None
        if fit["states"].absent
        else _states(fit["states"], dt, nv),
        cutoff=cutoff,
        lowpass=lowpass,
        standstill=_of_joints(file, "standstill"),
        effects=effects,
        fastest_period=None if period.absent else period.numbers(nv),
        time=None if time.absent else tuple(map(float, time.numbers(2))),
        corners=None if corners.absent else corners.numbers(nv),
    )


def _states(place, dt, nv):
    """Return the fitted `StateEstimator` of positions."""
    if dt is None:
        raise place.wrong("needs fit.dt")
    cutoffs = place["cutoff"].numbers(nv)
    given = [c if np.isfinite(c) else None for c in cutoffs]
    estimator = StateEstimator(dt, cutoff=given)
    estimator.n_features_in_ = nv
    estimator.cutoff_ = cutoffs
    estimator.noise_variance_ = place["noise_variance"].numbers(nv)
    estimator.bandwidth_ = place["bandwidth"].numbers(nv)
    return estimator


def _read_state_cutoff(place):
    if place.absent or isinstance(place.value, str):
        return place.value
    found = [None if one.absent else one.number() for one in place.items()]
    return found[0] if len(found) == 1 else found


def _read_range(place, names):
    ends = {
        key: tuple(map(float, place[key].numbers(2)))
        for key in ("position", "speed", "load", "direction")
    }
    return EffectRange(
        name=place["name"].text(),
        joint=names.index(place["joint"].one_of(names)),
        depends=tuple(
            one.one_of(("position", "speed", "load", "direction"))
            for one in place["depends"].items()
        ),
        curved=place["curved"].truth(),
        **ends,
    )


def _read_powers(file, names, features, effects):
    place = file["column_powers"]
    if place.absent:
        return None
    nv, k = len(names), len(features.friction_)
    friction = [row.numbers(k) for row in place["friction"].items(nv)]
    found = []
    for effect, told in zip(effects, place["effects"].items(len(effects))):
        size = len(effect.coefficients)
        block = np.zeros((nv, size, size))
        for one in told.items():
            rows = [row.numbers(size) for row in one["products"].items(size)]
            block[names.index(one["joint"].one_of(names))] = rows
        found.append(block)
    return ColumnMeanSquares(
        friction=np.array(friction).reshape(nv, k), effects=tuple(found)
    )


def _read_between(file, names):
    place = file["between_recordings"]
    if place.absent:
        return None
    own = place["parameters"].items()
    scales = place["scales"].numbers(finite=True)
    weights = [one["weights"].numbers(scales.size, finite=True) for one in own]
    return BetweenRecordings(
        count=int(place["recordings"].number(finite=True)),
        places=np.array([names.index(one["name"].one_of(names)) for one in own], int),
        size=np.array([one["size"].number(finite=True) for one in own]),
        weights=np.reshape(weights, (len(own), scales.size)).T,
        scales=scales,
    )


def _read_torque_spread(file, features, effects):
    place = file["torque_spread"]
    if place.absent:
        return None
    nv = features.n_joints_
    p = features.n_parameters_ + sum(len(one.coefficients) for one in effects)
    covariance = np.zeros((p, p))
    for k, row in enumerate(place["covariance"].items(p)):
        covariance[k, : k + 1] = covariance[: k + 1, k] = row.numbers(k + 1)
    return TorqueSpread(
        covariance=covariance,
        through=place["through"].numbers(nv),
        rest=place["rest"].numbers(nv),
    )


def _read_gains(place, names):
    if place.absent:
        return None
    common, nv = place["common"], len(names)
    return ChannelGains(
        joint_names=names,
        gain=place["gain"].numbers(nv),
        std=place["std"].numbers(nv),
        reference=np.array(
            [names.index(one.one_of(names)) for one in place["relative_to"].items(nv)]
        ),
        common=CommonGain(
            factor=None if common["factor"].absent else common["factor"].number(),
            std=common["std"].number(),
            p_value=common["p_value"].number(),
            masses=tuple(
                KnownMass(
                    name=one["name"].text(),
                    mass=one["mass"].number(),
                    found=one["found"].number(),
                    std=one["std"].number(),
                    shown=one["shown"].truth(),
                    used=one["used"].truth(),
                )
                for one in common["masses"].items()
            ),
        ),
    )


def _check_names(file, rows, robot):
    """Refuse parameters that are not those of the joints, friction and effects."""
    n = robot.features_.n_parameters_
    file["parameters"].items(n)
    for row, name in zip(rows, robot.parameter_names_):
        if row["name"].text() != name:
            raise row["name"].wrong(
                f"is {row['name'].value!r} where {name!r} is expected, of joints, "
                "friction and effects in their order"
            )
    theta = robot.theta_
    if not np.isfinite(theta).all():
        raise rows[int(np.argmin(np.isfinite(theta)))]["value"].wrong(
            "must hold a finite number"
        )


# -- reading with the place of what is wrong -------------------------------------------

# What JSON has no number for.
_SPELLED = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
# Width of a line that a list or an object of plain values stays on.
_WIDTH = 240


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

    def __getitem__(self, key):
        """Return the value of a key of an object, a `Place`."""
        if not isinstance(self.value, dict):
            raise self.wrong("must hold an object")
        at = f"{self.at}.{key}" if self.at else key
        if key not in self.value:
            raise Place(path=self.path, at=at, value=None).wrong("is missing")
        return Place(path=self.path, at=at, value=self.value[key])

    @property
    def absent(self):
        """Whether it is null."""
        return self.value is None

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

    def keys(self):
        """Return the keys of an object, a list of str."""
        if not isinstance(self.value, dict):
            raise self.wrong("must hold an object")
        return list(self.value)

    def number(self, *, finite=False):
        """Return a float; "nan", "inf" and "-inf" stand for what they say."""
        value = self.value
        if isinstance(value, str):
            value = _SPELLED.get(value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.wrong(f"must hold a number, not {quoted(self.value)}")
        try:
            value = float(value)
        except OverflowError:
            raise self.wrong("holds a number that is too large") from None
        if finite and not math.isfinite(value):
            raise self.wrong(f"must hold a finite number, not {quoted(self.value)}")
        return value

    def numbers(self, n=None, *, finite=False):
        """Return the numbers of a list, ndarray."""
        return np.array([one.number(finite=finite) for one in self.items(n)], float)

    def text(self):
        """Return a str."""
        if not isinstance(self.value, str):
            raise self.wrong(f"must hold a text, not {quoted(self.value)}")
        return self.value

    def texts(self, n=None):
        """Return the texts of a list, a tuple of str."""
        return tuple(one.text() for one in self.items(n))

    def one_of(self, known):
        """Return a text that is one of several."""
        if self.text() not in known:
            raise self.wrong(
                f"must be one of {', '.join(known)}; it is {quoted(self.value)}"
            )
        return self.value

    def truth(self):
        """Return a bool."""
        if not isinstance(self.value, bool):
            raise self.wrong(f"must hold true or false, not {quoted(self.value)}")
        return self.value


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


def spelled(value):
    """Return a float as JSON can hold it: those that are not numbers as texts."""
    value = float(value)
    if math.isnan(value):
        return "nan"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def spelled_all(values):
    """Return the numbers of an array as nested lists that JSON can hold."""
    if np.ndim(values) == 0:
        return spelled(values)
    return [spelled_all(value) for value in values]


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
