"""Robots with a free base, which is held, on the command line."""

import json
import re
import warnings

import numpy as np
import pytest

from sklearn_vbjfa import load_model
from sklearn_vbjfa._cli import main
from sklearn_vbjfa.datasets import make_robot_recording
from tests.command_line import _running
from tests.model._legs import JOINTS, legs_mjcf

ON_ITS_SIDE = (1.0, 1.0, 0.0, 0.0)
OPTION = ["--base-orientation", "1,1,0,0"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a robot and a recording of it lying on its side."""
    folder = tmp_path_factory.mktemp("legs")
    (folder / "legs.xml").write_text(legs_mjcf())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        held = load_model(folder / "legs.xml", ON_ITS_SIDE)
    log = make_robot_recording(held, duration=15.0, dt=0.01, random_state=0)
    heads = ["t", *(f"q_{name}" for name in JOINTS), *(f"tau_{x}" for x in JOINTS)]
    columns = np.column_stack([log.t, log.q, log.tau])
    np.savetxt(
        folder / "legs.csv", columns, delimiter=",", header=",".join(heads), comments=""
    )
    return folder


@pytest.fixture
def run(folder, monkeypatch, tmp_path, capsys):
    """Return the exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    files = [str(folder / "legs.csv"), "--urdf", str(folder / "legs.xml")]

    def call(command, *options):
        return _running.run(capsys, command, *files, *options)

    return call


@pytest.mark.slow
def test_identify_uses_the_given_orientation(run, tmp_path):
    argv = ("identify", "--effects", "none", "--out", "out")
    # The default orientation contradicts the recording.
    code, _, err = run(*argv)
    assert code == 2
    assert re.search(r"gravity pulls along .-?0.00, -1.00, -?0.00. of the base", err)
    code, out, err = run(*argv, *OPTION)
    assert code == 0, err
    assert "held at zero" not in out
    report = json.loads((tmp_path / "out/report.json").read_text())
    (note,) = [x for x in report["provenance"]["warnings"] if "root leaves free" in x]
    assert note.startswith(
        "The robot description 'legs.xml': the base, which root leaves free, is held "
        "turned by rpy 90 0 0 degrees (base_orientation or --base-orientation turns it"
    )
    # Torque noise of 5 %.
    assert max(one["after"] for one in report["errors"]) < 0.08


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,1,0", "must be a quaternion of four finite numbers w, x, y, z"),
        ("1,1,0,up", "--base-orientation has an invalid value: '1,1,0,up'"),
    ],
)
def test_invalid_orientations_are_refused(run, text, message):
    code, out, err = run("inspect", "--base-orientation", text)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert message in line


def test_a_motion_is_designed_for_the_orientation(folder, tmp_path, capsys):
    urdf = str(folder / "legs.xml")
    limits = ["--velocity", "3", "--acceleration", "3", "--torque", "1"]
    argv = ["design", "--urdf", urdf, *limits, "--joints", "L_calf", "--duration", "4"]
    shares = []
    for more in ([], OPTION):
        out = ["--out", str(tmp_path / f"{len(more)}.csv")]
        assert main([*argv, *more, *out]) in (0, 3)
        printed = capsys.readouterr().out
        shares.append(int(re.search(r"\(L_calf\) .* (\d+) %$", printed, re.M)[1]))
    # Stretched out, the calf needs 0.35 N m; on its side it swings about the vertical.
    assert shares[0] > 30 > 2 * shares[1]
    assert " --joints L_calf --base-orientation 1,1,0,0" in printed
