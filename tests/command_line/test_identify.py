"""The command identify on a recording of one's own."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa._cli import main
from sklearn_vbjfa._cli._identify import method_doubts
from sklearn_vbjfa.datasets import Protocol, read_recording
from sklearn_vbjfa.diagnosis.explain import split_in_time
from sklearn_vbjfa.robot import compare_methods
from tests.hostile._case import URDF, N, cells, clean_text, columns


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "arm.csv").write_text(clean_text())
    (tmp_path / "arm.urdf").write_text(URDF)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def identify(capsys, *argv):
    """Return exit code, stdout and stderr."""
    code = main(["identify", *argv])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def rows_of(text):
    """Numbers of the rows of methods, by their names."""
    found = {}
    for line in text.splitlines():
        words = line.rsplit(maxsplit=3)
        if len(words) == 4 and words[1].replace(".", "").isdecimal():
            found[words[0].strip()] = [float(x) for x in words[1:]]
    return found


def test_what_close_loop_holds_out_of_ones_own_recording_is_held_out(folder, capsys):
    code, out, err = identify(capsys, "arm.csv", "--urdf", "arm.urdf")
    assert code == 0, err
    assert "s in 1 stretch, those of close-loop" in out
    rows = rows_of(out)
    assert len(rows) == 15

    recording = read_recording("arm.csv", urdf="arm.urdf")
    identifier = RobotIdentifier("arm.urdf", dt=recording.dt)
    split = split_in_time(identifier, recording, EffectDiscovery(identifier).test_size)
    own = split.searched(recording), split.untouched(recording)
    parts = [(part.q, part.tau, part.groups) for part in own]
    (result,), _ = compare_methods(identifier, *parts, names=["WLS"], of_both=True)
    np.testing.assert_allclose(rows["WLS"][:2], 100 * result.error, atol=0.051)
    # Nothing is written.
    assert {path.name for path in folder.iterdir()} == {"arm.csv", "arm.urdf"}


def test_the_declared_model_is_as_wrong_as_in_close_loop(folder, capsys):
    """A torque that is clipped in one part only: any other part has another error."""
    table = columns()
    first = np.arange(N) < 0.6 * N
    most = np.quantile(np.abs(table["tau1"]), 0.5)
    clipped = np.clip(table["tau1"], -most, most)
    table["tau1"] = np.where(first, clipped, table["tau1"])
    text = "\n".join(",".join(row) for row in cells(table)) + "\n"
    (folder / "arm.csv").write_text(text)
    recording = read_recording("arm.csv", urdf="arm.urdf")
    identifier = RobotIdentifier("arm.urdf", dt=recording.dt)
    loop = EffectDiscovery(identifier, effects=[])
    loop.fit_recording(recording)
    _, out, _ = identify(capsys, "arm.csv", "--urdf", "arm.urdf")
    error = rows_of(out)["VB + description"][0]
    # But for the rows next to what is fitted.
    assert error == pytest.approx(100 * loop.error_before_[0], rel=0.05)
    # The last 30 %, which were held out once, have another one.
    parts = [
        (recording.q[rows], recording.tau[rows], recording.groups[rows])
        for rows in Protocol().split(recording)
    ]
    (other,), _ = compare_methods(identifier, *parts, names=["VB + description"])
    assert abs(100 * other.error[0] - error) > 0.1 * error


def test_a_joint_that_is_predicted_worse_than_by_its_mean_is_a_doubt():
    result = SimpleNamespace(
        message="", error=np.array([0.1, 1.2]), n_inconsistent=0, name="ours"
    )
    assert method_doubts([result], ("shoulder", "elbow")) == [
        "do not trust the model of elbow: it predicts the held-out torque worse than "
        "its mean does"
    ]


def test_it_is_read_like_by_the_other_commands(folder, capsys):
    text = clean_text()
    plain = identify(capsys, "arm.csv", "--urdf", "arm.urdf", "--friction", "none")
    for name in ("q", "tau"):
        text = text.replace(f"{name}1", f"axis 1 {name}").replace(
            f"{name}2", f"axis 2 {name}"
        )
    (folder / "arm.csv").write_text(text.replace("t,", "clock,", 1))
    mapping = "q=axis {i} q,tau=axis {i} tau,t=clock"
    argv = ["arm.csv", "--urdf", "arm.urdf", "--friction", "none"]
    code, out, err = identify(capsys, *argv, "--columns", mapping)
    assert code == 0, err
    assert "friction: none" in out
    assert rows_of(out) == rows_of(plain[1])


def test_swapped_channels_are_refused(folder, capsys):
    text = clean_text().replace("tau1,tau2", "tau2,tau1", 1)
    (folder / "arm.csv").write_text(text)
    code, out, err = identify(capsys, "arm.csv", "--urdf", "arm.urdf")
    assert (code, out) == (2, "")
    assert "arm.csv" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["arm.csv"], "give --urdf FILE"),
        (["--urdf", "arm.urdf"], "--urdf needs a RECORDING"),
        (["--gain", "8,8"], "--gain needs a RECORDING"),
        (["--columns", "q=a{i}"], "--columns needs a RECORDING"),
        (["--friction", "none"], "--friction needs a RECORDING"),
        (["arm.csv", "--urdf", "arm.urdf", "--data", "demo"], "--data is for the"),
        (["none.csv", "--urdf", "arm.urdf"], "none.csv: no such file"),
    ],
)
def test_options_that_do_not_go_together(argv, message, folder, capsys):
    code, out, err = identify(capsys, *argv)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert message in line


def test_ranges_are_written_where_they_are_asked_for(folder, capsys):
    import json

    asked = "arm.csv", "--urdf", "arm.urdf", "--ranges", "ranges.json"
    code, out, err = identify(capsys, *asked)
    assert code == 0, err
    assert "written: ranges.json" in out
    content = json.loads((folder / "ranges.json").read_text())
    assert content["format"] == "sklearn_vbjfa ranges"
    words = {one["mujoco"] for joint in content["joints"] for one in joint["values"]}
    assert {"damping", "frictionloss"} <= words
    # It is not written over.
    code, out, err = identify(capsys, *asked)
    assert code == 2
    assert "ranges.json exists; give another --ranges" in err
    assert "--ranges ranges-2.json" in err


@pytest.mark.parametrize(
    ("where", "message"),
    [(".", "is a folder, where"), ("no/ranges.json", "no is not a folder")],
)
def test_ranges_that_cannot_be_written(where, message, folder, capsys):
    code, _, err = identify(capsys, "arm.csv", "--urdf", "arm.urdf", "--ranges", where)
    assert code == 2
    assert message in err
