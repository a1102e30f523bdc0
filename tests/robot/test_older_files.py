"""Files of identified robots that earlier versions wrote are read, torque for torque.

``older_files`` holds an arm of two joints with load friction, presliding, a delay, a
signal and play, saved by the first commit that wrote such files and by the last one
that wrote version 1, and the torques that each predicted then.
"""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa import load_identified
from sklearn_vbjfa.robot import _model_file

FOLDER = Path(__file__).with_name("older_files")
TORQUES = json.loads((FOLDER / "torques.json").read_text(encoding="utf-8"))
STATES = np.array(TORQUES["states"])
SIGNALS = {"temperature": np.array(TORQUES["temperature"])}
FILES = sorted(set(TORQUES) - {"states", "temperature"})


def file(name):
    return FOLDER / f"{name}.json"


@pytest.mark.parametrize("name", FILES)
def test_torques_are_those_of_the_version_that_saved(name):
    robot = load_identified(file(name))
    torque = robot.predict(STATES, signals=SIGNALS)
    # Another Pinocchio or linear algebra may round otherwise.
    np.testing.assert_allclose(torque, TORQUES[name], rtol=1e-10)


@pytest.mark.parametrize("name", FILES)
def test_saved_again_they_are_of_the_present_version(name, tmp_path):
    robot = load_identified(file(name))
    again = tmp_path / "again.json"
    robot.save(again)
    content = json.loads(again.read_text(encoding="utf-8"))
    assert content["version"] == _model_file.VERSION
    before = json.loads(file(name).read_text(encoding="utf-8"))
    assert content["saved_with"] == before["saved_with"]
    assert content["parameters"] == before["parameters"]
    np.testing.assert_array_equal(
        load_identified(again).predict(STATES, signals=SIGNALS),
        robot.predict(STATES, signals=SIGNALS),
    )


@pytest.mark.parametrize("name", FILES)
def test_they_are_exported_and_followed_state_by_state(name, tmp_path):
    robot = load_identified(file(name))
    robot.to_urdf(tmp_path / "arm.urdf")
    robot.to_mjcf(tmp_path / "arm.xml")
    one = robot.step(*np.split(STATES[0], 3), signals={"temperature": 25.0})
    assert np.isfinite(one).all()


def test_what_the_first_files_did_not_keep_is_said_where_it_is_asked_for():
    robot = load_identified(file("version_1_first"))
    with pytest.raises(ValueError, match="saved by a version that did not keep it"):
        robot.predict(STATES, signals=SIGNALS, return_std=True)
    with pytest.raises(ValueError, match="saved by a version that did not keep it"):
        robot.ranges()


@pytest.mark.parametrize("key", _model_file._LATE)
def test_the_present_version_has_every_key(key, tmp_path):
    load_identified(file("version_1_last")).save(tmp_path / "robot.json")
    content = json.loads((tmp_path / "robot.json").read_text(encoding="utf-8"))
    place = content if key in content else content["fit"]
    del place[key]
    (tmp_path / "robot.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"key '(fit\.)?{key}' is missing"):
        load_identified(tmp_path / "robot.json")
