"""Position-controlled robots on the command line: --drive and invalid input."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from sklearn_vbjfa._cli import main
from sklearn_vbjfa.datasets import make_robot_recording

KP, KD, DELAY = np.array([60.0, 30.0]), np.array([2.0, 1.0]), 0.008
LAW = "pd kp=shoulder:60,elbow:30 kd=2,1"
FEW = ("--effects", "none", "--quiet")


@pytest.fixture(scope="module")
def commanded(urdf):
    """Columns of an arm with delayed commands; no torque was measured."""
    log = make_robot_recording(
        str(urdf), duration=15.0, n_harmonics=8, encoder_noise=1e-5, random_state=0
    )
    # A command is held until the next one, which adds half a row on average.
    later = log.t + DELAY + 0.5 * log.dt
    q, tau = (CubicSpline(log.t, x) for x in (log.q, log.tau))
    desired = q(later) + (tau(later) + KD * q(later, 1)) / KP
    columns = {"t": log.t}
    for j, name in enumerate(log.joint_names):
        columns[f"q_{name}"] = log.q[:, j]
        columns[f"q_desired_{name}"] = desired[:, j]
    # splines end where the recording does
    return {name: x[:-4] for name, x in columns.items()}


@pytest.fixture
def run(commanded, urdf, tmp_path, monkeypatch, capsys):
    """Run a command on changed columns; return exit code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def call(command, *options, drive=LAW, robot=("--urdf", str(urdf)), **changed):
        columns = {**commanded, **changed}
        table = np.column_stack([x for x in columns.values() if x is not None])
        header = ",".join(name for name, x in columns.items() if x is not None)
        np.savetxt("arm.csv", table, "%.9g", ",", header=header, comments="")
        argv = [command, "arm.csv", *robot, *options]
        code = main([*argv, *(() if drive is None else ("--drive", drive))])
        captured = capsys.readouterr()
        return code, *(" ".join(x.split()) for x in captured)

    return call


def delay_in(text):
    """Return the printed delay and its half width [ms]."""
    found = re.search(r"Commands act ([\d.]+) \+- ([\d.]+) ms after they are", text)
    return tuple(map(float, found.groups()))


def test_identification_from_commands(run, tmp_path):
    code, out, err = run("identify", *FEW)
    assert code == 0, err
    delay, half = delay_in(out)
    assert abs(delay - 1e3 * DELAY) < max(2 * half, 0.2)
    assert half < 1.0
    assert err.startswith("note: ")
    assert "no desired velocities (v_desired): taken as zero" in err
    assert "report.html (all details), report.json, " in out
    page = (tmp_path / "arm-report/report.html").read_text()
    assert "No torque was measured: torques are computed from the commands" in page
    assert page.count("no desired velocities (v_desired): taken as zero") == 1
    report = json.loads((tmp_path / "arm-report/report.json").read_text())
    known = {"delay": None, "saturated": [0.0, 0.0], "v_desired": False}
    assert report["robot"]["drive"] == {"kind": "PDDrive", **known}
    with open("arm-report/parameters.csv", newline="") as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    row = rows["drive:delay"]
    assert row["unit"] == "s"
    assert 1e3 * float(row["value"]) == pytest.approx(delay, abs=half)
    assert "Commands act" in page


@pytest.mark.slow
def test_positions_are_simulated_from_commands_only(run, commanded):
    run("identify", *FEW)
    model = ("--model", "arm-report/identified.json")
    code, out, err = run("simulate", "--out", "first", "--quiet", robot=model)
    assert code == 0, err
    assert "driven by the recorded commands alone" in out
    assert "clearly better than a robot at its commanded positions" in out
    for joint in ("shoulder", "elbow"):
        found = re.search(rf"{joint} mrad ([\d.]+) ([\d.]+)", out)
        simulated, desired = map(float, found.groups())
        assert simulated < 3.0
        error = commanded[f"q_desired_{joint}"] - commanded[f"q_{joint}"]
        assert desired == pytest.approx(1e3 * np.sqrt(np.mean(error**2)), rel=0.15)
    # A given delay replaces the identified one.
    options = ("--out", "second", "--quiet")
    _, out, _ = run("simulate", *options, robot=model, drive=f"{LAW} delay=-0.01")
    assert float(re.search(r"shoulder mrad ([\d.]+)", out)[1]) > 6.0
    code, out, err = run("simulate", "--quiet", robot=model, drive="pd kp=60,30")
    assert (code, out) == (2, "")
    assert "kd is missing: give kd=" in err


# Changes to the commands of both joints, and the message.
MISREAD = {
    "degrees": (np.degrees, "(q_desired) of all joints are in degrees"),
    "sign": (lambda q: q * [1, -1], "(q_desired) of elbow have the wrong sign"),
    "order": (lambda q: q[:, ::-1], "of all joints appear to be swapped"),
}


@pytest.mark.parametrize("fault", MISREAD)
def test_commands_inconsistent_with_positions_are_refused(fault, run, commanded):
    change, message = MISREAD[fault]
    names = "q_desired_shoulder", "q_desired_elbow"
    commands = change(np.column_stack([commanded[name] for name in names])).T
    columns = dict(zip(names, commands))
    code, out, err = run("identify", *FEW, **columns)
    assert (code, out) == (2, "")
    assert message in err
    if fault == "degrees":
        option = re.search("--columns '(.*?)'", err)[1]
        code, _, err = run("inspect", "--columns", option, **columns)
        assert code == 0, err


CONSTANTS = {"shoulder": 4.0, "elbow": 2.5}


@pytest.fixture(scope="module")
def currents(urdf):
    """Columns of the same arm with motor currents [A]."""
    log = make_robot_recording(str(urdf), duration=15.0, n_harmonics=8, random_state=0)
    columns = {"t": log.t}
    for j, name in enumerate(log.joint_names):
        columns[f"q_{name}"] = log.q[:, j]
        columns[f"current_{name}"] = log.tau[:, j] / CONSTANTS[name]
    return columns


@pytest.mark.parametrize(
    ("command", "signed"), [("identify", "false"), ("inspect", "true")]
)
def test_currents_as_a_drive(command, signed, run, commanded, currents):
    columns = {name: None for name in commanded} | currents
    if signed == "false":
        columns |= {x: np.abs(columns[x]) for x in columns if x.startswith("current")}
    law = f"current torque_constant=shoulder:4,elbow:2.5 signed={signed}"
    options = {"identify": FEW, "inspect": ()}[command]
    code, _, err = run(command, *options, drive=law, **columns)
    assert code in (0, 3), err
    if command == "identify":
        page = Path("arm-report/report.html").read_text(encoding="utf-8")
        assert "torques are computed from the input of the motor" in page
        with open("arm-report/report.json") as file:
            stds = [one["spread"] for one in json.load(file)["errors"]]
        sizes = [currents[f"current_{x}"].std() * CONSTANTS[x] for x in CONSTANTS]
        assert stds == pytest.approx(sizes, rel=0.2)


REFUSED = {
    "no drive": (
        {"drive": None},
        "no torques: expected columns tau1, tau2, ...; if the motors follow commands, "
        "give the drive",
    ),
    "no kind": ({"drive": "kp=20 kd=1"}, "--drive must begin with its kind, one of pd"),
    "no commands": (
        {"q_desired_shoulder": None, "q_desired_elbow": None},
        "no desired positions: expected columns q_desired1",
    ),
    "delay": ({"drive": f"{LAW} delay=soon"}, "delay must be 'auto' or a time in s"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_commands_are_refused_in_one_line(case, run):
    changes, message = REFUSED[case]
    code, out, err = run("identify", *FEW, **changes)
    assert (code, out) == (2, "")
    assert message in err


def test_the_refusal_suggests_an_option(run):
    _, _, err = run("identify", drive=None)
    assert '--drive "pd kp=... kd=..."' in err
    gains = {f"k{x}_{j}": np.ones(2996) for x in "pd" for j in ("shoulder", "elbow")}
    _, _, err = run("identify", drive=None, **gains)
    assert err.endswith("--drive pd")


@pytest.mark.parametrize("factor", [180 / np.pi, np.pi / 180])
def test_gains_in_other_units_give_a_warning(factor, run):
    kp, kd = factor * KP, factor * KD
    law = f"pd kp={kp[0]},{kp[1]} kd={kd[0]},{kd[1]}"
    code, out, err = run("inspect", drive=law)
    assert code == 3
    assert re.search("times those of the described robot: check", out)
    assert re.search(r"[Cc]heck kp \[N m/rad\] and kd", out + err)
