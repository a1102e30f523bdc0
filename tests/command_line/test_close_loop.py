"""The command identify: output files and one-line errors."""

import csv
import functools
import json
import re
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from sklearn_vbjfa import load_identified
from sklearn_vbjfa._cli import main
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.model import load_model
from tests.command_line._running import refused, write_csv
from tests.hostile._case import LINK, URDF

FILES = ["identified.json", "identified.urdf", "identified.xml"]
FILES += ["parameters.csv", "report.html", "report.json"]

refusal = functools.partial(refused, "identify")


def pseudo_inertias(path, nv=2):
    """Return the pseudo-inertias of the bodies of a URDF."""
    model = pinocchio.buildModelFromUrdf(str(path))
    assert model.nv == nv
    return [body.toPseudoInertia().toMatrix() for body in list(model.inertias)[1:]]


def test_files_are_written(urdf, recording, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = write_csv(tmp_path / "swing.csv", recording)
    argv = ["identify", str(source), "--urdf", str(urdf)]
    argv += ["--effects", "spring,load_friction,offset", "--ranges", "ranges.json"]
    assert main(argv) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    lines = captured.out.splitlines()
    assert lines[0] == "Recording 'swing': 3000 samples, 2 joints, dt = 0.005 s"
    assert lines[1].startswith("Spring on joint 1 (shoulder) was missing")
    assert lines[-1].startswith("written: ")
    folder = tmp_path / "swing-report"
    assert sorted(path.name for path in folder.iterdir()) == FILES
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    (effect,) = report["effects"]
    assert (effect["name"], effect["joint"]) == ("spring", 0)
    low, high = effect["intervals"]["k"]
    assert low - (high - low) / 2 < 4.0 < high + (high - low) / 2
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>")
    assert "shoulder" in page
    links = set(re.findall(r'href="([^"]+)"', page))
    inside = {link[1:] for link in links if link.startswith("#")}
    assert inside <= set(re.findall(r'id="([^"]+)"', page))
    assert {link for link in links if link[0] != "#"} == set(FILES) - {"report.html"}
    # torque and residual over time of each joint
    assert page.count('<figure class="wide"') == 2 * 2
    assert report["provenance"]["file"] == str(source)
    assert report["provenance"]["rate"] == pytest.approx(200.0)
    for matrix in pseudo_inertias(folder / "identified.urdf"):
        assert np.linalg.eigvalsh(matrix).min() > 0
    # The saved robot has the spring.
    saved = load_identified(folder / "identified.json")
    assert [(one.name, one.joint) for one in saved.effects_] == [("spring", 0)]
    output = " ".join(captured.out.split())
    assert "ranges for domain randomisation: ranges.json" in output
    ranges = json.loads((tmp_path / "ranges.json").read_text(encoding="utf-8"))
    values = {one["name"]: one for one in ranges["values"]}
    spring = values["shoulder:spring:k"]
    assert spring["lower"] < effect["parameters"]["k"] < spring["upper"]
    # MJCF supports springs, offsets and rotor inertias; URDF does not.
    assert "not complete, see the first lines; identified.json is" in output
    (warning,) = report["provenance"]["warnings"]
    assert re.match(r"identified.urdf has no place for .*spring on", warning)
    assert "identified.xml" not in warning
    assert "identified.urdf has no place for" in page
    root = ElementTree.parse(folder / "identified.xml").getroot()
    joints = {x.get("name"): x for x in root.iter("joint") if x.get("name")}
    assert list(joints) == ["shoulder", "elbow"]
    found = effect["parameters"]["k"]
    assert float(joints["shoulder"].get("stiffness")) == pytest.approx(found)
    # The written URDF loads without warnings.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_model(folder / "identified.urdf")


# Parameters that a URDF does not have.
ADDED_TERMS = ("viscous", "coulomb", "offset", "rotor_inertia")


def test_parameters_are_written_as_a_table(good, urdf, capsys):
    options = ["--effects", "none", "--friction", "none", "--out", "here/there"]
    assert main(["identify", "arm.csv", "--urdf", str(urdf), *options]) == 0
    assert "written: here/there/report.html" in capsys.readouterr().out
    with open("here/there/parameters.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = {row["parameter"] for row in rows}
    assert {"shoulder:m", "elbow:I_zz"} <= names
    # All standard terms, whether declared or not.
    assert {"shoulder:viscous", "elbow:coulomb", "elbow:rotor_inertia"} <= names
    for row in rows:
        assert np.isfinite(float(row["value"])), row
        assert row["unit"], row
        # a spreadsheet would read inf and nan as text
        if row["std"]:
            assert 0 <= float(row["std"]) < np.inf, row
    status = {row["parameter"]: row["identifiable"] for row in rows}
    assert {"yes", "from the description"} <= set(status.values())
    # The torques do not depend on the mass of the shoulder alone.
    assert status["shoulder:m"] == "from the description"
    assert status["elbow:m"] in ("from the description", "in combination")
    for row in rows:
        body = bool(row["description"])
        assert not (body and row["parameter"].endswith(ADDED_TERMS)), row
    text = Path("here/there/identified.urdf").read_text()
    assert "Masses that are not individually identifiable: " in text
    assert all(row["std"] for row in rows if row["identifiable"] == "yes")


def test_shared_drives_are_rows_of_the_parameters(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sides = "left", "right"
    both = {"parent": "base", "origin": 0, "centre": 0.2, "mass": 3}
    arms = [LINK.format(**both | {"name": x, "joint": f"{x}_arm"}) for x in sides]
    text = '<robot name="arms"><link name="base"/>' + "".join(arms) + "</robot>"
    Path("arms.urdf").write_text(text)
    log = make_robot_recording("arms.urdf", duration=8.0, dt=0.01, random_state=0)
    write_csv(tmp_path / "arms.csv", log)
    command = "identify arms.csv --urdf arms.urdf --no-search --out shared"
    main(command.split())
    page = Path("shared/report.html").read_text(encoding="utf-8")
    assert "Joints with the same drive" in page
    with open("shared/parameters.csv", newline="", encoding="utf-8") as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    shared = [row for name, row in rows.items() if name.startswith("arm:")]
    assert shared
    for row in shared:
        term = row["parameter"].partition(":")[2]
        values = [float(rows[f"{side}_arm:{term}"]["value"]) for side in sides]
        assert float(row["value"]) == pytest.approx(np.mean(values))


def test_unknown_gains_of_a_robot_without_masses(tmp_path, recording, urdf, capsys):
    path = tmp_path / "bare.urdf"
    path.write_text(re.sub(r"<inertial>.*?</inertial>", "", URDF, flags=re.DOTALL))
    gains = np.array([2.0, 0.8])
    source = write_csv(tmp_path / "amperes.csv", recording, tau=recording.tau * gains)
    options = ["--gain", "unknown", "--effects", "spring"]
    options += ["--known-mass", "lower=2", "--out", str(tmp_path / "out")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # The known mass does not fix the gains.
        assert main(["identify", str(source), "--urdf", str(path), *options]) == 3
    text = " ".join(capsys.readouterr().out.split())
    assert "Gains are relative to joint" in text
    assert "The mass of lower (2 kg) cannot fix the common gain" in text
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    found = report["robot"]["gains"]
    (first,) = set(found["reference"])
    np.testing.assert_allclose(found["gain"], gains / gains[first], rtol=0.05)
    assert found["common"]["factor"] is None
    with (tmp_path / "out" / "parameters.csv").open(newline="") as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    names = ("shoulder", "elbow")
    for j, name in enumerate(names):
        row = rows[f"{name}:torque_gain:gain"]
        assert float(row["value"]) == found["gain"][j]
        assert (row["std"] == "") == (j == first)
    unit = rows["elbow:m"]["unit"]
    assert unit == f"kg, times the gain of {names[first]}"
    assert "These gains are relative" in (tmp_path / "out/identified.urdf").read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--gain", "8,unknown"], "--gain has an invalid value: '8,unknown'"),
        (["--gain", "-8,0"], "a factor for each joint, finite and not 0, or 'unknown'"),
        (
            ["--gain", "8,8,5"],
            "3 gain(s) for 2 joint(s) (shoulder, elbow); expected one",
        ),
        (["--known-mass", "lower=2"], "give --gain unknown as well"),
        (
            ["--gain", "unknown", "--known-mass", "hand=2"],
            "known_masses names 'hand'; expected one of upper, lower, payload.",
        ),
        (["--gain", "unknown", "--known-mass", "lower=-2"], "got -2.0 for lower"),
        (["--gain", "unknown", "--known-mass", "lower"], "invalid value: 'lower'"),
        (
            ["--gain", "unknown", "--known-mass=lower=1", "--known-mass=lower=2"],
            "--known-mass names a link twice",
        ),
    ],
)
def test_invalid_gains_and_masses_are_refused(good, urdf, options, message, capsys):
    assert message in refusal(capsys, good, "--urdf", urdf, *options)


# A gripper with a mimic joint, and a wheel.
HAND = """
<link name="left"><inertial><mass value="0.2"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="grip" type="prismatic"><parent link="lower"/><child link="left"/>
  <axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="9" velocity="1"/></joint>
<link name="right"/>
<joint name="grip_2" type="prismatic"><parent link="lower"/><child link="right"/>
  <axis xyz="0 -1 0"/><limit lower="0" upper="0.04" effort="9" velocity="1"/>
  <mimic joint="grip"/></joint>
<link name="wheel"/>
<joint name="drive" type="continuous"><parent link="base"/><child link="wheel"/>
  <axis xyz="0 1 0"/></joint>
"""


@pytest.fixture
def with_hand(tmp_path):
    path = tmp_path / "hand.urdf"
    path.write_text(URDF.replace("</robot>", HAND + "</robot>"))
    return path


def test_joints_without_columns_are_named_with_the_option(good, with_hand, capsys):
    line = refusal(capsys, good, "--urdf", with_hand)
    assert "2 column(s) q for 4 joint(s)" in line
    # grip_2 is a mimic joint and needs no column
    assert "grip_2" not in line
    for name in ("shoulder", "elbow", "grip", "drive"):
        assert name in line
    assert "--joints" in line


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ("shoulder,wrist", r"no movable joint 'wrist'; it has shoulder, elbow, grip"),
        ("shoulder", r"2 column\(s\) q for 1 joint\(s\) \(shoulder\); leave out"),
        ("shoulder,elbow,grip", r"2 column\(s\) q for 3 joint\(s\)"),
        ("shoulder,shoulder", "must differ from one another"),
        ("shoulder,,elbow", "no movable joint ''"),
    ],
)
def test_invalid_joints_are_refused(joints, message, good, with_hand, capsys):
    line = refusal(capsys, good, "--urdf", with_hand, "--joints", joints)
    assert re.search(message, line), line


def test_a_wrong_sign_suggests_gains(urdf, recording, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = write_csv("arm.csv", recording, tau=recording.tau * [0.5, -0.5])
    line = refusal(capsys, source, "--urdf", urdf)
    assert line.endswith(" --gain 1,-1")
    # Given factors are kept; unknown gains have no sign.
    line = refusal(capsys, source, "--urdf", urdf, "--gain", "2,2")
    assert line.endswith(" --gain 2,-2")
    line = refusal(capsys, source, "--urdf", urdf, "--gain", "unknown")
    assert "this would work" not in line
    # The suggested option works, also with a negative first factor.
    whole = write_csv("whole.csv", recording, tau=-recording.tau)
    assert main(["inspect", whole, "--urdf", str(urdf), "--gain=-1,-1"]) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "no robot", "not readable as URDF"),
        (lambda text: '<robot name="arm"/>', "No link elements found"),
        (lambda text: '<robot name="a"><link name="b"/></robot>', "no moving joint"),
        (
            lambda text: text.replace('child link="lower"', 'child link="hand"'),
            r"child link \[hand\] of joint \[elbow\] not found",
        ),
        # the parser continues and gives the link no inertia
        (
            lambda text: text.replace('mass value="3"', 'mass value="heavy"'),
            r"mass \[heavy\] is not a float.*correct the description",
        ),
    ],
)
def test_invalid_descriptions_are_refused(change, message, good, tmp_path, capfd):
    robot = tmp_path / "arm.urdf"
    robot.write_text(change(URDF))
    line = refusal(capfd, good, "--urdf", robot)
    assert line.count(str(robot)) == 1
    assert re.search(message, line), line


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--effects spring,rust", "--effects does not know 'rust'; expected.*ripple"),
        ("--effects ,", "--effects does not know ''"),
        ("--friction sticky", "--friction does not know 'sticky'; expected.*viscous"),
        ("--dt -0.005", "dt must be .*; got -0.005"),
        ("--dt nan", "dt must be .*; got nan"),
        ("--dt 0.01", "time steps by 0.005 s but dt = 0.01 s; correct one of them"),
        ("--bodies none", "--bodies has an invalid value: 'none'.*prior.*free.*fixed"),
        ("--friction none,viscous", "--friction does not know 'none'"),
        ("--dt low", "--dt has an invalid value: 'low'"),
        ("--out arm.csv", "arm.csv is not a folder"),
    ],
)
def test_invalid_options_are_refused(options, message, good, urdf, capsys):
    line = refusal(capsys, good, "--urdf", urdf, *options.split())
    assert re.search(message, line), line
    assert [path.name for path in good.parent.iterdir()] == ["arm.csv"]


FRICTION, SLOPE = 3.0, -0.06


@pytest.fixture(scope="module")
def warm(urdf, tmp_path_factory):
    """Two joints, 15 s; Coulomb friction of the shoulder falls with temperature."""
    arm = make_robot_recording(str(urdf), duration=15.0, dt=0.01, random_state=0)
    temperature = 30 + 10 * np.sin(0.8 * arm.t)
    tau = arm.tau.copy()
    speed = np.sign(np.gradient(arm.q[:, 0], arm.dt))
    tau[:, 0] += (FRICTION + SLOPE * (temperature - 30)) * speed
    path = tmp_path_factory.mktemp("warm") / "warm.csv"
    columns = {
        "t": arm.t,
        "q1": arm.q[:, 0],
        "q2": arm.q[:, 1],
        "tau1": tau[:, 0],
        "tau2": tau[:, 1],
        "temperature": temperature,
        "gain": 2 * temperature + 7,
        "fixed": np.full(arm.n_samples, 24.0),
        "current": tau[:, 0] / 5.5,
        "state": np.where(arm.t > 5, "run", "start"),
        "hole": np.where(arm.t > 5, temperature, np.nan),
    }
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(columns)
        table.writerows(zip(*columns.values()))
    return path


def identify(warm, urdf, out, *more):
    argv = ["identify", str(warm), "--urdf", str(urdf), "--out", str(out)]
    argv += ["--effects", "offset,signal,drift", *more]
    assert main(argv) == 0
    return json.loads((out / "report.json").read_text(encoding="utf-8"))


def test_columns_of_a_file_are_candidates(warm, urdf, tmp_path, capsys):
    # Some columns cannot be used.
    report = identify(warm, urdf, tmp_path / "out")
    (effect,) = report["effects"]
    assert effect["name"] == "signal"
    factor = {"temperature": 1, "gain": 2}[effect["parameters"]["signal"]]
    low, high = effect["intervals"]["k"]
    assert low < SLOPE / factor < high
    assert [x for x in effect["rivals"] if x in {"signal: gain", "signal: temperature"}]
    assert report["provenance"]["settings"]["signals"] == ["temperature", "gain"]
    output = " ".join(capsys.readouterr().out.split())
    assert output.count("are not used as signals.") == 1
    (message,) = [x["message"] for x in report["channels"] if "signals" in x["message"]]
    for reason in ("'fixed' is constant", "'current' is the torque of"):
        assert reason in message
