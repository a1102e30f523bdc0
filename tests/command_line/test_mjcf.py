"""MJCF descriptions and mimic joints on the command line."""

import re
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio
import pytest

from sklearn_vbjfa._cli._identify import _limits
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.model import joint_names, load_model
from tests.command_line._running import refused, run, write_csv
from tests.effects._arms import inverse_dynamics

# A planar arm with a gripper, whose second finger follows the first, and a free body.
HAND = """
<body name="left" pos="0.3 0.02 0">
  <joint name="grip" type="slide" axis="0 1 0" range="0 0.04"/>
  <inertial pos="0 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/></body>
<body name="right" pos="0.3 -0.02 0">
  <joint name="grip_2" type="slide" axis="0 -1 0"/>
  <inertial pos="0 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/></body>
"""
FOLLOW = '<equality><joint joint1="grip_2" joint2="grip"/></equality>'
ROBOT = """<mujoco model="arm">
<default><default class="big"><joint axis="0 1 0" damping="0.7" armature="0.1"
  range="-170 170"/></default></default>
<worldbody>
<body name="upper" childclass="big"><joint name="shoulder"/>
  <inertial pos="0.2 0 0" mass="3" diaginertia="0.01 0.05 0.05"/>
  <body name="lower" pos="0.4 0 0"><joint name="elbow"/>
    <inertial pos="0.15 0 0" mass="2" diaginertia="0.01 0.05 0.05"/>{hand}</body></body>
{more}</worldbody>
<actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>{after}</mujoco>
"""
PLAIN = ROBOT.format(hand="", more="", after="")
BALL = '<body name="ball"><freejoint name="loose"/><geom size="0.1"/></body>'


@pytest.fixture
def write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def to_file(text, name="arm.xml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return to_file


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(PLAIN)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return make_robot_recording(
            str(path), duration=15.0, n_harmonics=8, random_state=0
        )


@pytest.fixture
def table(recording, tmp_path):
    return write_csv(tmp_path / "swing.csv", recording)


def test_identify_from_mjcf_writes_all_files(write, table, recording, capsys):
    path = write(PLAIN)
    argv = ["identify", table, "--urdf", path, "--effects", "none"]
    code, out, err = run(capsys, *argv)
    assert code == 0
    assert err.startswith("note: The robot description 'arm.xml': not taken over")
    page = Path("swing-report/report.html").read_text(encoding="utf-8")
    assert "The robot description &#39;arm.xml&#39;: not taken over" in page
    assert "held at" not in out
    names = ("shoulder", "elbow")
    urdf = pinocchio.buildModelFromUrdf("swing-report/identified.urdf")
    assert tuple(urdf.names)[1:] == names
    root = ElementTree.parse("swing-report/identified.xml").getroot()
    assert root.tag == "mujoco"
    assert [one.get("name") for one in root.findall(".//body/joint")] == list(names)
    with pytest.warns(UserWarning, match="not taken over"):
        reloaded = load_model("swing-report/identified.xml")
    # URDF has no rotor inertias; the bodies are the same.
    assert (reloaded.armature > 0).all()
    reloaded.armature = np.zeros(2)
    states = np.random.default_rng(0).normal(size=(10, 6))
    found, expected = (inverse_dynamics(x, states) for x in (reloaded, urdf))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    # The written file is a valid description.
    written = "swing-report/identified.xml"
    code, out, _ = run(capsys, "inspect", table, "--urdf", written)
    assert code == 0
    assert "none detected" in out


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_held_joints_of_mjcf(write, table, capsys):
    path = write(ROBOT.format(hand=HAND, more=BALL, after=FOLLOW))
    code, _, err = run(capsys, "inspect", table, "--urdf", path)
    assert code == 2
    assert "loose (JointModelFreeFlyer" in err
    assert "--joints" in err
    joints = ["--joints", "shoulder,elbow"]
    argv = ["identify", table, "--urdf", path, *joints, "--effects", "none"]
    code, out, _ = run(capsys, *argv)
    assert code == 0
    assert "held at zero" not in out
    page = Path("swing-report/report.html").read_text(encoding="utf-8")
    assert re.search("grip,\\s*grip_2,\\s*loose", page)
    for name in ("identified.urdf", "identified.xml"):
        model = load_model(f"swing-report/{name}")
        assert joint_names(model) == ("shoulder", "elbow")


def test_limits_exceeded_by_the_recording_are_replaced():
    model = SimpleNamespace(velocityLimit=np.ones(2), effortLimit=np.array([500, 5.0]))
    features = SimpleNamespace(nominal_=model, gains_=np.ones(2))
    robot = SimpleNamespace(features_=features, gains_=None)
    recorded = SimpleNamespace(q=np.zeros((9, 2)), tau=np.full((9, 2), 90.0), dt=0.1)
    assert list(_limits(robot, recorded)) == ["--torque", "500,90"]
    # A reading is a gain times the torque, which `design` limits.
    features.gains_ = np.array([2.0, 0.5])
    for absolute, limits in ((True, "500,180"), (False, "45,180")):
        robot.gains_ = SimpleNamespace(absolute=absolute)
        assert list(_limits(robot, recorded)) == ["--torque", limits]


def test_a_robot_without_limits_and_a_log_with_custom_columns(write, recording, capsys):
    """The printed command has limits; a second log needs no --columns."""
    path, names = write(PLAIN), recording.joint_names
    q, tau = recording.q, recording.tau + [2.0, 0.0] * np.sin(3 * recording.q)
    head = ",".join([f"{n}_pos" for n in names] + [f"{n}_torque" for n in names])
    np.savetxt("log.csv", np.hstack([q, tau]), delimiter=",", header=head, comments="")
    options = ["--columns", "q={joint}_pos,tau={joint}_torque", "--effects", "spring"]
    log = ["log.csv", "--dt", recording.dt]
    _, out, _ = run(capsys, "identify", *log, "--urdf", path, *options)
    (command,) = re.findall("sklearn_vbjfa (design .*)", out)
    assert command.count(",") == 2
    assert run(capsys, *command.split(), "--duration", 4)[0] != 2
    assert run(capsys, "simulate", *log, "--model", "log-report")[0] != 2
    # If the report has no columns (gravity compensation), they are requested.
    Path("log-report/report.json").write_text('{"purpose": "gravity"}')
    line = refused("simulate", capsys, *log, "--model", "log-report")
    assert "expected columns q1" in line
