"""The command close-loop: files from a recording, one line for what is wrong."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import threading
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_vbjfa import EffectDiscovery, load_identified
from sklearn_vbjfa._cli import main
from sklearn_vbjfa._cli._close_loop import left_out_lines, write_parameters
from sklearn_vbjfa._cli._run import STOPS
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.model import load_model
from sklearn_vbjfa.robot import Departure, LeftOut

pinocchio = pytest.importorskip("pinocchio")

FILES = ["identified.json", "identified.urdf", "identified.xml"]
FILES += ["parameters.csv", "report.html", "report.json"]
LINK = """
<link name="{name}"><inertial><origin xyz="{centre} 0 0"/><mass value="{mass}"/>
  <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{name}"/>
  <origin xyz="{origin} 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="100" velocity="10"/>
</joint>"""
UPPER = {"name": "upper", "joint": "shoulder", "parent": "base", "origin": 0}
LOWER = {"name": "lower", "joint": "elbow", "parent": "upper", "origin": 0.4}
URDF = (
    '<robot name="arm"><link name="base"/>'
    + LINK.format(**UPPER, centre=0.2, mass=3)
    + LINK.format(**LOWER, centre=0.15, mass=2)
    + "</robot>"
)


@pytest.fixture(scope="module")
def urdf(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(URDF)
    return path


@pytest.fixture(scope="module")
def recording(urdf):
    """Two joints, 15 s; a spring on the shoulder is missing in the model."""
    return make_robot_recording(
        str(urdf),
        duration=15.0,
        n_harmonics=8,
        undeclared={"spring": (0, 4.0)},
        random_state=0,
    )


def write_csv(path, recording, *, q=None, tau=None, t=True, rows=slice(None)):
    """Write columns t, q1, ..., tau1, ...; q and tau replace those recorded."""
    q = recording.q if q is None else q
    tau = recording.tau if tau is None else tau
    names = [f"q{k + 1}" for k in range(q.shape[1])]
    names += [f"tau{k + 1}" for k in range(tau.shape[1])]
    table = np.hstack([q, tau])
    if t:
        names, table = ["t", *names], np.column_stack([recording.t, table])
    header = ",".join(names)
    np.savetxt(path, table[rows], fmt="%.8g", delimiter=",", header=header, comments="")
    return path


def write_npz(path, recording):
    np.savez(path, q=recording.q, tau=recording.tau, dt=recording.dt)
    return path


@pytest.fixture
def good(tmp_path, recording, monkeypatch):
    """Path of a recording without fault, in the working folder."""
    monkeypatch.chdir(tmp_path)
    return write_csv(tmp_path / "arm.csv", recording)


def refusal(capsys, *argv):
    """Return the one line on stderr."""
    assert main(["close-loop", *map(str, argv)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    assert line.startswith("sklearn-vbjfa: ")
    return line


def identified(path, nv=2):
    """Load a URDF; the pseudo-inertias of its bodies."""
    model = pinocchio.buildModelFromUrdf(str(path))
    assert model.nv == nv
    return [body.toPseudoInertia().toMatrix() for body in list(model.inertias)[1:]]


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_files_are_written(kind, urdf, recording, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = tmp_path / f"swing.{kind}"
    {"csv": write_csv, "npz": write_npz}[kind](source, recording)
    argv = ["close-loop", str(source), "--urdf", str(urdf)]
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
    assert report["schema_version"] == 11
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
    # a spring is seen over the position, and each joint has its torque over time, its
    # friction and the spectrum of its residual
    assert page.count('<figure class="wide"') == 1 + 3 * 2
    assert re.search(r'class="x-name">position of [^<]*shoulder[^<]* \[rad\]<', page)
    assert report["provenance"]["file"] == str(source)
    assert report["recorded"]["rate"] == pytest.approx(200.0)
    for matrix in identified(folder / "identified.urdf"):
        assert np.linalg.eigvalsh(matrix).min() > 0
    # The robot without its data, its spring included.
    saved = load_identified(folder / "identified.json")
    assert [(one.name, one.joint) for one in saved.effects_] == [("spring", 0)]
    told = " ".join(captured.out.split())
    assert "ranges for domain randomisation: ranges.json" in told
    ranges = json.loads((tmp_path / "ranges.json").read_text(encoding="utf-8"))
    values = {one["parameter"]: one for one in ranges["joints"][0]["values"]}
    spring = values["shoulder:spring:k"]
    assert spring["mujoco"] == "stiffness"
    assert spring["low"] < effect["parameters"]["k"] < spring["high"]
    # MuJoCo has springs, offsets and the inertia of rotors, URDF has none of them.
    assert "only identified.json has every effect (page)" in told
    (left,) = report["provenance"]["warnings"]
    assert re.match(
        r"identified.urdf has no place for \d effects, the largest: spring on", left
    )
    assert "identified.xml" not in left
    assert "identified.urdf has no place for" in page
    root = ElementTree.parse(folder / "identified.xml").getroot()
    joints = {x.get("name"): x for x in root.iter("joint") if x.get("name")}
    assert list(joints) == ["shoulder", "elbow"]
    found = effect["parameters"]["k"]
    assert float(joints["shoulder"].get("stiffness")) == pytest.approx(found)
    # What was identified is a description to begin with.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_model(folder / "identified.urdf")


# Parameters that no description has.
OWN = ("viscous", "coulomb", "offset", "rotor_inertia")


def test_parameters_are_a_table(good, urdf, capsys):
    options = ["--effects", "spring", "--friction", "none", "--out", "here/there"]
    assert main(["close-loop", "arm.csv", "--urdf", str(urdf), *options]) == 0
    assert "written: here/there/report.html" in capsys.readouterr().out
    with open("here/there/parameters.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = {row["parameter"] for row in rows}
    assert {"shoulder:m", "elbow:I_zz"} <= names
    # All plain terms, whatever is declared.
    assert {"shoulder:viscous", "elbow:coulomb", "elbow:rotor_inertia"} <= names
    for row in rows:
        assert np.isfinite(float(row["value"])), row
        assert row["identifiable"] in ("yes", "no"), row
        assert row["unit"], row
        # a spreadsheet would read inf and nan as text
        if row["std"]:
            assert 0 <= float(row["std"]) < np.inf, row
    assert {row["identifiable"] for row in rows} == {"yes", "no"}
    assert {"yes", "from the description"} <= {row["known"] for row in rows}
    told = {row["parameter"]: row["known"] for row in rows}
    # No joint feels a weight on a vertical axis, or that of a single link.
    assert told["shoulder:m"] == "from the description"
    assert told["elbow:m"] in ("from the description", "in combination")
    for row in rows:
        body = bool(row["description"])
        assert body == bool(row["learned"]) == bool(row["description_std"]), row
        assert not (body and row["parameter"].endswith(OWN)), row
        if body:
            assert 0.0 <= float(row["learned"]) <= 1.0, row
    text = Path("here/there/identified.urdf").read_text()
    assert "does not determine the masses of" in text
    assert all(row["std"] for row in rows if row["identifiable"] == "yes")


def test_what_mujoco_has_no_place_for_is_said(good, urdf, recording, capsys):
    made = make_robot_recording(
        str(urdf),
        duration=15.0,
        undeclared={"load_friction": (0, 0.4)},
        random_state=1,
    )
    write_csv(good, made)
    options = ["--effects", "load_friction"]
    assert main(["close-loop", str(good), "--urdf", str(urdf), *options]) == 0
    assert "only identified.json has every effect" in capsys.readouterr().out
    report = json.loads(Path("arm-report/report.json").read_text(encoding="utf-8"))
    assert re.search(
        r"identified.urdf has no place for 4 effects, the largest: load_friction on "
        r"shoulder \([^;]*\), identified.xml for an effect; they say why",
        " ".join(report["provenance"]["warnings"]),
    )
    text = Path("arm-report/identified.xml").read_text(encoding="utf-8")
    assert "load_friction" in text[: text.index("-->")]


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        ([1.234], "an effect: e0 on j0 (1.2 N m rms);"),
        ([0.5, 3.0], "2 effects, the largest: e1 on j1 (3 N m rms);"),
        ([0.5, 3.0, 0.1], "3 effects, the largest: e2 on j2 (0.1 N rms), e1 on j1 (3"),
        ([np.nan], "an effect: e0 on j0;"),
        ([np.nan, 0.2], "2 effects, the largest: e1 on j1 (0.2 N m rms);"),
    ],
)
def test_a_description_says_how_much_it_goes_without(sizes, expected):
    left = [
        LeftOut(
            name=f"e{k}",
            joint=k,
            joint_name=f"j{k}",
            size=size,
            unit="N" if k == 2 else "N m",
            reason="why",
        )
        for k, size in enumerate(sizes)
    ]
    (line,) = left_out_lines({"robot.urdf": (), "robot.xml": left})
    assert line.startswith(f"robot.xml has no place for {expected}")
    more = {"robot.urdf": [*left, left[0]], "robot.xml": left}
    (line,) = left_out_lines(more)
    assert line.startswith("robot.urdf has no place for ")
    count = "an effect" if len(sizes) == 1 else f"{len(sizes)} effects"
    assert f", robot.xml for {count}; they say why at the top, and" in line
    assert not left_out_lines({"robot.urdf": ()})


def value(name, value, unit, known, *described):
    nominal, before, learned = described or (np.nan,) * 3
    return SimpleNamespace(
        name=name,
        value=value,
        unit=unit,
        known=known,
        nominal=nominal,
        before=before,
        learned=learned,
    )


def test_undetermined_parameters_have_no_deviation(tmp_path):
    robot = SimpleNamespace(
        theta_=np.array([1.0, 0.1 + 0.2]),
        theta_std_=np.array([np.inf, 0.25]),
        identifiable_=np.array([False, True]),
        gains_=None,
        alike_=[
            SimpleNamespace(
                group="hip",
                parameter="viscous",
                joints=("a", "b"),
                value=0.5,
                std=0.25,
                unit="N m s/rad",
                scatter=0.125,
                apart=[Departure(("c",), (2.0,), (0.5,), 9.0)],
            )
        ],
    )
    path = tmp_path / "parameters.csv"
    mass = value("a,b:m", 1.0, "kg", "from the description", 2.0, 0.4, 0.75)
    values = mass, value("a:viscous", 0.1 + 0.2, "N m s/rad", "yes")
    write_parameters(robot, values, path)
    assert path.read_text().splitlines() == [
        "parameter,value,unit,std,identifiable,known,description,description_std,"
        "learned,scatter",
        '"a,b:m",1.0,kg,,no,from the description,2.0,0.4,0.75,',
        "a:viscous,0.30000000000000004,N m s/rad,0.25,yes,yes,,,,",
        "hip:viscous,0.5,N m s/rad,0.25,yes,yes,,,,0.125",
        "c:viscous over the other hip joints,2.0,times,0.5,yes,yes,,,,",
    ]
    pandas = pytest.importorskip("pandas")
    table = pandas.read_csv(path)
    assert table["std"].dtype == float
    assert table["std"].isna().tolist() == [True, False, False, False]
    np.testing.assert_array_equal(table["value"][:2], robot.theta_)
    assert (table["identifiable"] == "yes").tolist() == [False, True, True, True]


def test_alike_joints_are_rows_of_the_parameters(good, urdf, capsys):
    options = ["--effects", "none", "--out", "shared"]
    command = ["close-loop", "arm.csv", "--urdf", str(urdf), *options]
    assert main([*command, "--alike", "shoulder,elbow"]) == 0
    page = Path("shared/report.html").read_text(encoding="utf-8")
    assert "the shoulder/elbow joints" in page
    with open("shared/parameters.csv", newline="", encoding="utf-8") as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    shared = [row for name, row in rows.items() if name.startswith("shoulder/elbow:")]
    assert shared
    for row in shared:
        term = row["parameter"].partition(":")[2]
        own = [float(rows[f"{j}:{term}"]["value"]) for j in ("shoulder", "elbow")]
        assert float(row["value"]) == pytest.approx(np.mean(own))
    assert main([*command, "--alike", "wrist", "--force"]) == 2
    assert "'wrist', which matches 0 joint(s)" in capsys.readouterr().err


def test_options_reach_the_estimators(good, urdf, monkeypatch):
    seen = {}

    def fit(self, *arguments, **given):
        seen.update(self.get_params(deep=True))
        raise ValueError("seen")

    monkeypatch.setattr(EffectDiscovery, "fit", fit)
    options = "--friction viscous --effects coulomb,spring --cutoff none --seed 7"
    main(["close-loop", str(good), "--urdf", str(urdf), *options.split()])
    assert seen["identifier__friction"] == ("viscous",)
    assert seen["effects"] == ("coulomb", "spring")
    assert seen["identifier__cutoff"] is None
    assert seen["random_state"] == 7
    main(["close-loop", str(good), "--urdf", str(urdf), "--cutoff", "8"])
    assert seen["identifier__cutoff"] == 8.0
    assert seen["effects"] == "all"


@pytest.mark.slow
def test_what_is_to_be_corrected_is_in_all_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    roll, pitch, gain = np.deg2rad(4.0), np.deg2rad(2.0), 1.15
    arm = make_robot_recording(
        duration=20.0,
        dt=0.01,
        frequency=1.0,
        base_tilt=(roll, pitch),
        torque_gain={1: gain},
        random_state=2,
    )
    write_csv(tmp_path / "arm.csv", arm)
    options = ["--effects", "base_tilt,torque_gain", "--out", "out"]
    assert main(["close-loop", "arm.csv", "--urdf", arm.urdf, *options]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "the base is not level: gravity is turned by roll" in text
    assert "joint 2: the torque channel reads 1" in text
    report = json.loads(Path("out/report.json").read_text(encoding="utf-8"))
    told = report["corrections"]
    assert told["tilt"]["roll"] == pytest.approx(roll, abs=0.01)
    assert told["tilt"]["pitch"] == pytest.approx(pitch, abs=0.01)
    (channel,) = told["gains"]
    assert channel["joint_name"] == "joint_2"
    assert channel["gain"] == pytest.approx(gain, abs=0.02)
    assert (told["zeros"], told["axes"]) == ([], [])
    by_name = {effect["name"]: effect for effect in report["effects"]}
    assert set(by_name) == {"base_tilt", "torque_gain"}
    found = by_name["base_tilt"]
    assert found["scope"] == "robot"
    assert found["parameters"]["roll"] == told["tilt"]["roll"]
    low, high = found["plain"]["roll"]["interval"]
    assert low < told["tilt"]["roll_degrees"] < high
    # The files are of one model.
    with open("out/parameters.csv", newline="", encoding="utf-8") as file:
        rows = {row["parameter"]: float(row["value"]) for row in csv.DictReader(file)}
    assert rows["base_tilt:roll"] == pytest.approx(told["tilt"]["roll"], rel=1e-9)
    assert rows["joint_2:torque_gain:gain"] == pytest.approx(channel["gain"], rel=1e-9)
    written = Path("out/identified.urdf").read_text(encoding="utf-8")
    assert f"of joint_2 reads by {channel['gain']:.5g}" in written
    assert "The base of the recorded robot was not level" in written
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert "What to do next" in page


def test_an_interrupted_run_leaves_nothing(good, urdf, monkeypatch, capsys):
    def fit(self, *arguments, **given):
        raise KeyboardInterrupt

    monkeypatch.setattr(EffectDiscovery, "fit", fit)
    assert main(["close-loop", str(good), "--urdf", str(urdf)]) == 130
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "sklearn-vbjfa: interrupted, nothing was written\n"
    assert [path.name for path in good.parent.iterdir()] == ["arm.csv"]


# -- gains -----------------------------------------------------------------------------


def test_unknown_gains_of_a_robot_without_masses(tmp_path, recording, urdf, capsys):
    path = tmp_path / "bare.urdf"
    path.write_text(re.sub(r"<inertial>.*?</inertial>", "", URDF, flags=re.DOTALL))
    gains = np.array([2.0, 0.8])
    source = write_csv(tmp_path / "amperes.csv", recording, tau=recording.tau * gains)
    options = ["--gain", "unknown", "--effects", "spring"]
    options += ["--known-mass", "lower=2", "--out", str(tmp_path / "out")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # The mass does not help.
        assert main(["close-loop", str(source), "--urdf", str(path), *options]) == 3
    text = " ".join(capsys.readouterr().out.split())
    assert "Gains are relative to joint" in text
    assert "The mass of lower (2 kg) cannot fix the common gain" in text
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    found = report["gains"]
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
        (["--gain", "8,unknown"], "--gain must be a factor to N m or N for each joint"),
        (["--gain", "8,0"], "such as 8,8,5, or unknown, for all channels together"),
        (
            ["--gain", "8,8,5"],
            "3 gain(s) for 2 joint(s) (shoulder, elbow); expected one",
        ),
        (["--known-mass", "lower=2"], "give --gain unknown as well"),
        (
            ["--gain", "unknown", "--known-mass", "hand=2"],
            "does not know 'hand'; expected one of upper, lower, payload.",
        ),
        (["--gain", "unknown", "--known-mass", "lower=-2"], "got 'lower=-2'"),
        (["--gain", "unknown", "--known-mass", "lower"], "LINK=KG or payload=KG"),
        (
            ["--gain", "unknown", "--known-mass=lower=1", "--known-mass=lower=2"],
            "--known-mass has lower twice",
        ),
    ],
)
def test_other_gains_and_masses_are_refused(good, urdf, options, message, capsys):
    assert message in refusal(capsys, good, "--urdf", urdf, *options)


def test_one_joint_has_no_unknown_gain(tmp_path, capsys):
    path = tmp_path / "one.urdf"
    base = '<robot name="arm"><link name="base"/>'
    path.write_text(base + LINK.format(**UPPER, centre=0.2, mass=3) + "</robot>")
    one = make_robot_recording(str(path), duration=5.0, random_state=0)
    source = write_csv(tmp_path / "one.csv", one)
    line = refusal(capsys, source, "--urdf", path, "--gain", "unknown")
    assert "the gain of the only one" in line


def test_a_recording_in_amperes_needs_gains(tmp_path, recording, urdf, capsys):
    source = write_csv(tmp_path / "amperes.csv", recording)
    text = source.read_text().replace("tau1,tau2", "tau1 [A],tau2 [A]", 1)
    source.write_text(text)
    line = refusal(capsys, source, "--urdf", urdf)
    assert "the torques are recorded in A; give the factors to N m" in line
    assert line.endswith(f"--urdf {urdf} --gain unknown")


# -- joints ----------------------------------------------------------------------------

# A gripper, one finger of which follows the other, and a wheel.
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


def test_more_joints_than_columns_are_named_with_the_option(good, with_hand, capsys):
    line = refusal(capsys, good, "--urdf", with_hand)
    assert "2 column(s) q for 4 joint(s)" in line
    # grip_2 follows grip and has no column of its own
    assert "grip_2" not in line
    for name in ("shoulder", "elbow", "grip", "drive"):
        assert name in line
    assert "--joints" in line


def test_joints_that_are_not_named_are_held_at_zero(
    good, recording, urdf, with_hand, capsys
):
    def values(report):
        with open(f"{report}/parameters.csv", newline="", encoding="utf-8") as file:
            return {
                row["parameter"]: (row["value"], row["std"])
                for row in csv.DictReader(file)
            }

    common = ["--effects", "spring"]
    joints = ["--joints", "shoulder,elbow"]
    argv = ["close-loop", str(good), "--urdf", str(with_hand), *joints, *common]
    assert main([*argv, "--out", "held"]) == 0
    captured = capsys.readouterr()
    # Who names the joints knows the others: they are on the page.
    assert "held at zero" not in captured.out
    assert captured.err == ""
    report = json.loads(Path("held/report.json").read_text(encoding="utf-8"))
    assert report["provenance"]["held"] == ["grip", "grip_2", "drive"]
    assert main([*argv[:3], str(urdf), *common, "--out", "plain"]) == 0
    held, plain = values("held"), values("plain")
    assert list(held) == list(plain)
    for name, (value, std) in plain.items():
        # what the recording tells does not depend on what the model had there
        if std and "elbow:I" not in name:
            np.testing.assert_allclose(
                float(held[name][0]), float(value), atol=1.0 * float(std)
            )
    identified("held/identified.urdf")
    mode = os.stat("held/identified.urdf").st_mode
    assert mode & 0o777 == with_hand.stat().st_mode & 0o666


def test_joints_are_in_the_order_of_the_columns(good, recording, urdf, capsys):
    q, tau = recording.q[:, ::-1], recording.tau[:, ::-1]
    write_csv(good.parent / "turned.csv", recording, q=q, tau=tau)
    common = ["--urdf", str(urdf), "--effects", "spring", "--out"]
    assert main(["close-loop", str(good), *common, "a"]) == 0
    options = ["--joints", "elbow,shoulder"]
    assert main(["close-loop", "turned.csv", *options, *common, "b"]) == 0
    captured = capsys.readouterr()
    assert "held at" not in captured.out
    for name in ("parameters.csv", "identified.urdf"):
        with open(f"a/{name}") as one, open(f"b/{name}") as other:
            assert one.read() == other.read()


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ("shoulder,wrist", r"no movable joint 'wrist'; it has shoulder, elbow, grip"),
        ("shoulder", r"2 column\(s\) q for 1 joint\(s\) \(shoulder\); leave out"),
        ("shoulder,elbow,grip", r"2 column\(s\) q for 3 joint\(s\)"),
        ("shoulder,shoulder", "--joints has shoulder twice"),
        ("shoulder,,elbow", "--joints has an empty name"),
    ],
)
def test_joints_that_cannot_be(joints, message, good, with_hand, capsys):
    line = refusal(capsys, good, "--urdf", with_hand, "--joints", joints)
    assert re.search(message, line), line


# -- stopping --------------------------------------------------------------------------

# Runs the command and says on stdout when the search has begun, or a file was written;
# then it waits until the standard input ends, which is after the signal.
STOPPABLE = """
import os, signal, sys

# Started in the background or under nohup, the tests leave these ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

from sklearn_vbjfa import EffectDiscovery, load_identified
from sklearn_vbjfa._cli import main

when, argv = sys.argv[1], sys.argv[2:]
fit, replace = EffectDiscovery.fit, os.replace

def slow_fit(self, *arguments, **given):
    print("now", flush=True)
    sys.stdin.read()
    return fit(self, *arguments, **given)

def slow_replace(source, target, **given):
    replace(source, target, **given)
    # Libraries that keep caches (compiled kernels, fonts) replace files of their own.
    if "arm-report" in os.fspath(target):
        print("now", flush=True)
        sys.stdin.read()

if when == "search":
    EffectDiscovery.fit = slow_fit
else:
    os.replace = slow_replace
sys.exit(main(argv))
"""


def stop(argv, when, number):
    """Send a signal at a moment; exit code, stderr."""
    process = subprocess.Popen(
        [sys.executable, "-c", STOPPABLE, when, *map(str, argv)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout.readline() == "now\n"
        process.send_signal(number)
        _, err = process.communicate(timeout=600)
    finally:
        process.kill()
    return process.returncode, err


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_run_that_is_stopped_in_the_search_leaves_nothing(name, good, urdf):
    number = getattr(signal, name)
    argv = ["close-loop", good, "--urdf", urdf, "--effects", "spring"]
    code, err = stop(argv, "search", number)
    assert code == 128 + number
    how = "interrupted" if name == "SIGINT" else f"stopped ({name})"
    assert err == f"sklearn-vbjfa: {how}, nothing was written\n"
    assert sorted(path.name for path in good.parent.iterdir()) == ["arm.csv"]


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_run_that_is_stopped_while_it_writes_writes_all(good, urdf):
    argv = ["close-loop", good, "--urdf", urdf, "--effects", "spring"]
    code, err = stop(argv, "write", signal.SIGTERM)
    assert code == 128 + signal.SIGTERM
    assert err == "sklearn-vbjfa: stopped (SIGTERM), all files were written\n"
    folder = good.parent / "arm-report"
    assert sorted(path.name for path in folder.iterdir()) == FILES
    json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert (folder / "report.html").read_text(encoding="utf-8").endswith("</html>\n")
    identified(folder / "identified.urdf")


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_run_that_is_killed_leaves_no_half_a_file(good, urdf):
    argv = ["close-loop", good, "--urdf", urdf, "--effects", "spring"]
    code, _ = stop(argv, "write", signal.SIGKILL)
    assert code == -signal.SIGKILL
    for path in (good.parent / "arm-report").glob("[!.]*"):
        assert path.name in FILES
        assert path.stat().st_size > 100


def test_signals_are_left_to_a_program_that_calls_main(capsys):
    before = [signal.getsignal(number) for number in STOPS]
    assert main(["effects"]) == 0
    assert [signal.getsignal(number) for number in STOPS] == before
    codes = []
    thread = threading.Thread(target=lambda: codes.append(main(["effects"])))
    thread.start()
    thread.join()
    assert codes == [0]


# -- refusals: the file ----------------------------------------------------------------


def test_missing_files(good, urdf, capsys):
    assert "none.csv: no such file" in refusal(capsys, "none.csv", "--urdf", urdf)
    line = refusal(capsys, good, "--urdf", "none.urdf")
    assert "none.urdf: no such robot description; give --urdf FILE." in line
    Path("empty").mkdir()
    assert "is a folder; give a file" in refusal(capsys, "empty", "--urdf", urdf)


FAULTS = {
    "nan": (
        lambda r: {"q": np.where(np.arange(3000)[:, None] == 98, np.nan, r.q)},
        r"line 100, column 'q1'.*interpolate them or remove",
    ),
    "one joint": (
        lambda r: {"q": r.q[:, :1], "tau": r.tau[:, :1]},
        r"1 column\(s\) q for 2 joint\(s\) \(shoulder, elbow\)",
    ),
    "three joints": (
        lambda r: {"q": r.q[:, [0, 1, 1]], "tau": r.tau[:, [0, 1, 1]]},
        r"3 column\(s\) q for 2 joint\(s\).*leave out surplus columns",
    ),
    "fewer torques": (
        lambda r: {"tau": r.tau[:, :1]},
        r"2 column\(s\) q \(q1, q2\) and 1 column\(s\) tau \(tau1\)",
    ),
    "no time step": (lambda r: {"t": False}, r"no column t and no dt; add time stamps"),
    "degrees": (
        lambda r: {"q": np.rad2deg(r.q)},
        r"degrees: shoulder runs.*multiply the positions",
    ),
    "sign": (
        lambda r: {"tau": r.tau * [1.0, -1.0]},
        r"torque of elbow has the wrong sign.*multiply it by -1",
    ),
    "swapped": (
        lambda r: {"tau": r.tau[:, ::-1]},
        r"torques of shoulder and elbow look exchanged.*exchange the columns",
    ),
    "short": (
        lambda r: {"rows": slice(40)},
        r"the longest recording has 40 samples.*record some tens of seconds",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_a_recording(fault, urdf, recording, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    change, message = FAULTS[fault]
    source = write_csv(tmp_path / "arm.csv", recording, **change(recording))
    line = refusal(capsys, source, "--urdf", urdf)
    assert f"{source}: " in line
    assert re.search(message, line), line
    assert not (tmp_path / "arm-report").exists()


def test_a_wrong_sign_offers_the_gains_that_turn_it(
    urdf, recording, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    source = write_csv("arm.csv", recording, tau=recording.tau * [0.5, -0.5])
    line = refusal(capsys, source, "--urdf", urdf)
    assert line.endswith(" --gain 1,-1")
    # Factors that were given stay, and those of unknown gains have no sign.
    line = refusal(capsys, source, "--urdf", urdf, "--gain", "2,2")
    assert line.endswith(" --gain 2,-2")
    line = refusal(capsys, source, "--urdf", urdf, "--gain", "unknown")
    assert line.endswith("multiply it by -1")
    # What is offered works, and so do factors of which the first is negative.
    whole = write_csv("whole.csv", recording, tau=-recording.tau)
    assert main(["inspect", whole, "--urdf", str(urdf), "--gain", "-1,-1"]) == 0


def test_no_positions(good, urdf, capsys):
    good.write_text(good.read_text().replace("q1,q2", "angle1,angle2", 1))
    line = refusal(capsys, good, "--urdf", urdf)
    assert "expected columns q1, q2, ... (nearest: angle{i}); found t, angle1" in line
    assert line.endswith(f"--urdf {urdf} --columns 'q=angle{{i}}'")


def test_text_that_is_no_utf8(good, urdf, capsys):
    good.write_bytes(good.read_bytes().replace(b"tau2", b"tau2,\x81", 1))
    assert "save it as CSV in UTF-8" in refusal(capsys, good, "--urdf", urdf)


def halve(content):
    return content[: len(content) // 2]


def flip_a_byte(content):
    content = bytearray(content)
    content[3000] ^= 255
    return bytes(content)


@pytest.mark.parametrize(
    "damage", [halve, flip_a_byte, lambda content: b"hello", lambda content: b""]
)
def test_damaged_npz(damage, urdf, recording, tmp_path, capsys):
    source = write_npz(tmp_path / "arm.npz", recording)
    source.write_bytes(damage(source.read_bytes()))
    line = refusal(capsys, source, "--urdf", urdf)
    assert (
        f"{source}: is not a complete npz file; save it anew with numpy.savez." in line
    )


def test_one_array_is_no_npz(urdf, recording, tmp_path, capsys):
    with (tmp_path / "arm.npz").open("wb") as file:
        np.save(file, recording.q)
    line = refusal(capsys, tmp_path / "arm.npz", "--urdf", urdf)
    assert "is not a complete npz file" in line


# -- refusals: the robot ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "no robot", "not readable as URDF"),
        (lambda text: text[:200], "not readable as URDF"),
        (lambda text: '<robot name="arm"/>', "No link elements found"),
        (lambda text: "<sdf/>", "outermost element is <sdf>"),
        (lambda text: '<robot name="a"><link name="b"/></robot>', "no moving joint"),
        (
            lambda text: text.replace('child link="lower"', 'child link="hand"'),
            r"child link \[hand\] of joint \[elbow\] not found",
        ),
        # the parser reads on and gives the link no inertia
        (
            lambda text: text.replace('mass value="3"', 'mass value="heavy"'),
            r"mass \[heavy\] is not a float.*correct the description",
        ),
    ],
)
def test_faults_of_a_robot(change, message, good, tmp_path, capfd):
    robot = tmp_path / "arm.urdf"
    robot.write_text(change(URDF))
    line = refusal(capfd, good, "--urdf", robot)
    assert line.count(str(robot)) == 1
    assert re.search(message, line), line


# -- refusals: the options -------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            "--effects spring,rust",
            "--effects does not know 'rust'; expected.*ripple",
        ),
        ("--effects ,", "--effects does not know ','"),
        ("--effects spring,spring", "--effects has spring twice; name it once"),
        ("--friction sticky", "--friction does not know 'sticky'; expected.*viscous"),
        ("--dt -0.005", "dt must be a positive number of seconds, got -0.005"),
        ("--dt nan", "dt must be a positive number of seconds, got nan"),
        ("--dt 0.01", "time steps by 0.005 s but dt = 0.01 s; correct one of them"),
        ("--cutoff 150", "--cutoff must be below 100 Hz, half the sample rate of"),
        ("--cutoff 0", "--cutoff must be a positive frequency in Hz, auto or none"),
        ("--cutoff inf", "--cutoff must be a positive frequency in Hz, auto or none"),
        ("--cutoff low", "--cutoff must be a positive frequency in Hz, auto or none"),
        ("--seed -1", "--seed must be from 0 to 2"),
        ("--out arm.csv", "arm.csv is a file, where --out must name a folder"),
        ("--out arm.csv/below", "arm.csv is a file, where --out must name a folder"),
    ],
)
def test_options_that_cannot_be(options, message, good, urdf, capsys):
    line = refusal(capsys, good, "--urdf", urdf, *options.split())
    assert re.search(message, line), line
    assert [path.name for path in good.parent.iterdir()] == ["arm.csv"]


@pytest.mark.parametrize("options", [[], ["--dt", "fast"], ["--seed", "x"]])
def test_wrong_usage(options, good, urdf, capsys):
    argv = ["close-loop", str(good), *options]
    if options:
        argv += ["--urdf", str(urdf)]
    with pytest.raises(SystemExit) as stop:
        main(argv)
    assert stop.value.code == 2
    assert "usage: sklearn-vbjfa close-loop" in capsys.readouterr().err


# -- signals


FRICTION, SLOPE = 3.0, -0.06


@pytest.fixture(scope="module")
def warm(urdf, tmp_path_factory):
    """Two joints, 15 s; Coulomb friction of the shoulder falls as it gets warmer."""
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


def closed(warm, urdf, out, *more, code=0):
    argv = ["close-loop", str(warm), "--urdf", str(urdf), "--out", str(out)]
    argv += ["--effects", "offset,signal,drift", *more]
    assert main(argv) == code
    return json.loads((out / "report.json").read_text(encoding="utf-8"))


def test_columns_of_a_file_are_candidates(warm, urdf, tmp_path, capsys):
    # Some columns cannot be used.
    report = closed(warm, urdf, tmp_path / "out", code=3)
    (effect,) = report["effects"]
    assert effect["name"] == "signal"
    factor = {"temperature": 1, "gain": 2}[effect["parameters"]["signal"]]
    low, high = effect["intervals"]["k"]
    assert low < SLOPE / factor < high
    assert [x for x in effect["rivals"] if x in {"signal: gain", "signal: temperature"}]
    assert report["settings"]["signals"] == ["temperature", "gain"]
    said = " ".join(capsys.readouterr().out.split())
    # A terminal names two channels, the page all.
    assert said.count("is not used as a signal.") == 2
    assert re.search(r"Channel: \d more \(page\)\.", said)
    messages = " ".join(one["message"] for one in report["channels"])
    for reason in (
        "'fixed' is not used as a signal: it is constant",
        "'current' is not used as a signal: it is the torque of",
        "'state' is not used as a signal: it holds 'start' and not numbers",
        "'hole' is not used as a signal: it has gaps",
    ):
        assert reason in messages


def test_signals_are_chosen_by_name(warm, urdf, tmp_path, capsys):
    report = closed(warm, urdf, tmp_path / "one", "--signals", "temperature")
    assert report["settings"]["signals"] == ["temperature"]
    (effect,) = report["effects"]
    assert effect["parameters"]["signal"] == "temperature"
    assert report["channels"] == []
    nothing = closed(warm, urdf, tmp_path / "none", "--signals", "none")
    assert nothing["settings"]["signals"] == []
    assert not any(effect["name"] == "signal" for effect in nothing["effects"])
    assert nothing["channels"] == []
    capsys.readouterr()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("temprature", "--signals does not know 'temprature'; expected names with"),
        ("", "--signals does not know ''"),
        ("gain,gain", "--signals has gain twice"),
        ("temperature,fixed", "'fixed' is constant (24 in all rows)"),
        ("current", "'current' is the torque of"),
        ("state", "The column 'state' holds 'start' and not numbers"),
        ("hole", "The column 'hole' has gaps"),
    ],
)
def test_signals_that_cannot_be_are_refused_in_one_line(
    warm, urdf, tmp_path, monkeypatch, capsys, names, message
):
    monkeypatch.chdir(tmp_path)
    line = refusal(capsys, warm, "--urdf", urdf, "--signals", names)
    assert message in line
    assert list(tmp_path.iterdir()) == []


def test_a_file_without_other_columns_has_no_signals(good, urdf, capsys):
    line = refusal(capsys, good, "--urdf", urdf, "--signals", "temperature")
    assert "holds no columns beside time" in line
