"""Saving and loading of identified robots, and errors for bad files."""

import json
import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from sklearn.linear_model import Ridge

from sklearn_vbjfa import IdentifiedRobot, RobotIdentifier, load_identified
from sklearn_vbjfa._core import write_whole
from sklearn_vbjfa.effects import (
    BaseTilt,
    Counterbalance,
    Delay,
    Drift,
    Effect,
    JointAxis,
    JointZero,
    LoadFriction,
    MaxwellSlip,
    Payload,
    Signal,
    TorqueGain,
)
from sklearn_vbjfa.robot import FitOptions

DT = 0.01


class Stiffening(Effect):
    """Stiffening spring with parameters of all types that a file can hold."""

    name = "stiffening"
    coefficients = ("k3",)
    units = (("N m/rad^3", "N/m^3"),)

    def __init__(self, joint=0, power=3, limits=(-np.inf, 2.5), label="a", odd=True):
        super().__init__(joint)
        self.power = power
        self.limits = limits
        self.label = label
        self.odd = odd

    def columns(self, motion):
        return motion.q[:, [self.joint]] ** self.power


def fit(recording, signals=None, states=False, **settings):
    settings = {"friction": ("viscous",), **settings}
    robot = RobotIdentifier(recording.urdf, dt=DT, **settings)
    X = recording.states if states else recording.q
    return robot.fit(X, recording.tau, groups=recording.groups, signals=signals)


EFFECTS = [
    LoadFriction(joint=1),
    Counterbalance(joint=2, form="linkage"),
    MaxwellSlip(joint=3, loaded=(0.02,)),
    Drift(joint=0, of="offset", time_constant=5.0),
    Delay(joint=4, delay=0.003),
    Payload(joint=5, instant=7.0, centre=(0.0, 0.1, 0.0)),
    Signal(joint=2, signal="warmth", of="viscous", reference=0.3),
]
IN_MODEL = [BaseTilt(), JointZero(joint=2), JointAxis(joint=3), TorqueGain(joint=1)]
ROBOTS = {
    "plain": {"friction": ("viscous", "coulomb")},
    "effects": {"effects": EFFECTS},
    "in model": {"effects": IN_MODEL},
    "gains": {"gains": "unknown", "options": FitOptions(known_masses={"elbow": 4.0})},
    "states": {
        "friction": ("coulomb",),
        "regressor": Ridge(),
        "options": FitOptions(standstill=None),
    },
}


@pytest.fixture(scope="module", params=ROBOTS)
def fitted(request, simulated):
    """Return a robot and further inputs of its predictions."""
    given = {}
    if request.param == "effects":
        given["signals"] = {"warmth": np.sin(np.arange(len(simulated.q)) / 300.0)}
    settings = {"states": request.param == "states", **ROBOTS[request.param]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return fit(simulated, **given, **settings), given


@pytest.fixture(scope="module")
def saved(identified, tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "arm.json"
    identified.save(path)
    return path


def predict_noted(robot, X, **options):
    """Return predicted torques and warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torque = robot.predict(X, **options)
    return torque, [str(warning.message) for warning in caught]


def test_loaded_robot_equals_the_fitted_one(fitted, simulated, tmp_path):
    robot, options = fitted
    path = tmp_path / "robot.json"
    robot.save(path)
    loaded = load_identified(path)
    assert isinstance(loaded, IdentifiedRobot)
    queries = [simulated.states, 1.5 * simulated.states]
    if robot.dt is not None:
        queries.append(simulated.q)
    for X in queries:
        for groups in (None, simulated.groups):
            keywords = {"groups": groups} | options
            expected, notes = predict_noted(robot, X, **keywords)
            torque, other = predict_noted(loaded, X, **keywords)
            np.testing.assert_array_equal(torque, expected)
            assert other == notes
    other = tmp_path / "again.json"
    loaded.save(other)
    assert other.read_bytes() == path.read_bytes()
    names = """
        joint_names_ parameter_names_ parameter_units_ theta_ theta_std_ identifiable_
        min_eigenvalues_ noise_floor_ standstill_ cutoff_ dt
    """
    for name in names.split():
        np.testing.assert_equal(getattr(loaded, name), getattr(robot, name), name)
    assert repr(loaded.effects_) == repr(robot.effects_)
    np.testing.assert_equal(
        [vars(r) for r in loaded.effect_ranges_],
        [vars(r) for r in robot.effect_ranges_],
    )
    if robot.gains_ is not None:
        for name in ("joint_names", "gain", "std", "reference"):
            actual, expected = (getattr(r.gains_, name) for r in (loaded, robot))
            np.testing.assert_array_equal(actual, expected)
        # Compare texts, as nan is unequal to itself.
        assert repr(loaded.gains_.common) == repr(robot.gains_.common)
    if (robot.min_eigenvalues_ > 0).all():
        robot.to_urdf(tmp_path / "one.urdf")
        loaded.to_urdf(tmp_path / "two.urdf")
        written = [(tmp_path / f"{n}.urdf").read_text() for n in ("one", "two")]
        assert written[0] == written[1]


def test_custom_effects(simulated, tmp_path):
    effects = [Stiffening(joint=2, power=np.int64(3), label="b", odd=False)]
    robot = fit(simulated, effects=effects)
    path = tmp_path / "robot.json"
    robot.save(path)
    with pytest.raises(ValueError, match=r"effects\[0\]\.name.*effects=\[\.\.\.\]"):
        load_identified(path)
    loaded = load_identified(path, effects=[Stiffening])
    (effect,) = loaded.effects_
    assert effect.get_params() == robot.effects_[0].get_params()
    np.testing.assert_array_equal(
        predict_noted(loaded, simulated.q)[0], predict_noted(robot, simulated.q)[0]
    )
    robot.effects_[0].set_params(label=object())
    with pytest.raises(ValueError, match="an effect has a parameter that cannot be"):
        robot.save(tmp_path / "other.json")
    assert os.listdir(tmp_path) == ["robot.json"]


def test_guide_documents_all_keys(saved):
    guide = (Path(__file__).parents[2] / "docs" / "simulation.rst").read_text()
    content = json.loads(saved.read_text())
    for key in [*content, *content["plan"]]:
        assert f"``{key}``" in guide, key


# -- bad input -------------------------------------------------------------------------


def changed(saved, tmp_path, change):
    """Write a file with changed content."""
    content = json.loads(saved.read_text())
    change(content)
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(content))
    return path


def assign(*keys, value=None):
    """Return a change of an entry; without a value, the entry is deleted."""

    def change(content):
        for key in keys[:-1]:
            content = content[key]
        if value is None:
            del content[keys[-1]]
        else:
            content[keys[-1]] = value

    return change


def effect(name="ripple", joint=0, **shape):
    """Return the entry of an effect in a file."""
    return [{"name": name, "joint": joint, "shape": shape}]


DEEP = json.loads("[" * 400 + "0.0" + "]" * 400)
BAD = {
    "another format": (assign("format", value="x"), "'format'"),
    "newer": (assign("version", value=3), "'version' is 3, and"),
    "version is not a number": (assign("version", value="1"), "'version' is"),
    "no URDF": (assign("text"), "'text' is missing"),
    "no parameters": (assign("theta_"), "'theta_' is missing"),
    "no number": (assign("theta_", 3, value="much"), "'theta_' must hold numbers"),
    "no cut-off": (
        assign("plan", "cutoff", value="much"),
        r"'plan\.cutoff' must hold a number, not 'much'",
    ),
    "nan": (assign("theta_", 5, value="nan"), "'theta_' must hold finite numbers"),
    "another parameter": (
        assign("parameters", 0, value="joint_2:m"),
        "'parameters' must hold the names of the parameters",
    ),
    "too few": (assign("theta_", -1), "'theta_' must hold 72 values, one per"),
    "no object": (assign("plan", value=[]), "'plan' must hold an object"),
    "too deep": (assign("theta_", value=DEEP), "rows of the same|recursion"),
    "broken URDF": (assign("text", value="<robot"), "'text' is invalid"),
    "another joint": (
        assign("joints", 1, value="elbow"),
        "'text' is invalid: the joints joint_1, elbow",
    ),
    "unknown friction": (
        assign("friction", value=["sticky"]),
        "'friction' is invalid: .*sticky",
    ),
    "effect": (
        assign("plan", "effects", value=effect("ripples")),
        r"'plan\.effects\[0\]\.name' is 'ripples', which the library",
    ),
    "shape": (
        assign("plan", "effects", value=effect(periods=3)),
        r"'plan\.effects\[0\]\.shape' does not suit 'ripple'",
    ),
    "joint of an effect": (
        assign("plan", "effects", value=effect(joint=6)),
        r"'plan\.effects' is invalid: .*joint 6 for ripple; expected 0 to 5",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_invalid_content_is_named(case, saved, tmp_path):
    change, message = BAD[case]
    path = changed(saved, tmp_path, change)
    with pytest.raises(ValueError, match=message) as caught:
        load_identified(path)
    assert "changed.json" in str(caught.value)
    assert "\n" not in str(caught.value).strip()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not JSON"),
        (b"{", "is not JSON"),
        (b"\xff\xfe", "is not JSON"),
        (b"[1, 2", "is not JSON"),
        (b"[" * 100_000, "is not JSON"),
        (b'{"format": NaN}', "is not JSON: it holds NaN"),
        (b"[]", "is not an identified robot"),
        (b"3", "is not an identified robot"),
    ],
)
def test_other_files_are_refused(content, message, tmp_path):
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        load_identified(path)
    assert "bad.json" in str(caught.value)


def test_missing_file_and_missing_folder(identified, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no file .*missing\.json"):
        load_identified(tmp_path / "missing.json")
    with pytest.raises(FileNotFoundError, match=r"no folder .*nowhere"):
        identified.save(tmp_path / "nowhere" / "robot.json")


def test_files_are_written_atomically(tmp_path, monkeypatch):
    path = tmp_path / "file.json"
    write_whole(path, "first")

    def fail(*_):
        raise OSError("the disk is full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="full"):
        write_whole(path, "second")
    assert path.read_text() == "first"
    assert os.listdir(tmp_path) == ["file.json"]
