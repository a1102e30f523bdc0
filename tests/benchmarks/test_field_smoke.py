"""The field's comparison: what it counts, splits and says of places; peers run."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_field as field

from sklearn_vbjfa.datasets import load_demo_recording, protocols


@pytest.fixture(scope="module")
def demo():
    """Return protocol, recording and the two parts of the demo."""
    recording, protocol = load_demo_recording(), protocols()["demo"]
    parts = [
        {
            "q": recording.q[rows],
            "tau": recording.tau[rows],
            "groups": recording.groups[rows],
            "dt": recording.dt,
        }
        for rows in protocol.split(recording)
    ]
    return protocol, recording, *parts


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("peer", [field.OURS, "LinearRegression", "Huber"])
def test_peers_predict_the_part_that_is_held_out(demo, peer):
    task = {"set": "demo", "peer": peer}
    torques, seconds, lines, consistent, named = field.torques_of(task, *demo)
    held_out = demo[3]
    assert torques.shape == held_out["tau"].shape
    missed = (torques - held_out["tau"]).std(axis=0)
    assert (missed < 0.5 * held_out["tau"].std(axis=0)).all()
    assert seconds > 0
    assert lines > 5
    assert consistent == "yes" or peer != field.OURS
    assert named == "nothing"


def test_halves_are_the_first_and_second_of_every_recording():
    part = {"q": np.arange(10.0)[:, None], "groups": np.repeat([0, 1], [4, 6]), "dt": 1}
    first, second = field.halves(part)
    np.testing.assert_array_equal(first["q"][:, 0], [0, 1, 4, 5, 6])
    np.testing.assert_array_equal(second["q"][:, 0], [2, 3, 7, 8, 9])


def test_it_says_where_the_package_is_not_first():
    def one(name, peer, error):
        return {"set": name, "peer": peer, "error": error}

    behind = [one("a", field.OURS, 5.0), one("a", "PLS", 4.0)]
    first = [one("b", field.OURS, 5.0), one("b", "PLS", 4.996)]
    said = field.places([*behind, *first])
    assert "a (PLS 4.00 %, 5.00 %)" in said
    assert "b (" not in said


def test_settings_of_figaroh_name_the_joints_of_the_set(demo, tmp_path):
    protocol, recording = demo[:2]
    from dataclasses import replace

    fixed = replace(protocol, cutoff=4.0)
    path = field.figaroh_settings(fixed, recording, "demo", tmp_path)
    text = Path(path).read_text(encoding="utf-8")
    assert all(f"- {name}\n" in text for name in recording.joint_names)
    assert "cutoff_frequency: 6\n" in text
    assert "shoulder" not in text


def test_a_peer_that_is_not_run_says_why():
    table = field.table_of("x", [{"peer": "FIGAROH", "failure": "no URDF"}])
    assert "not run: no URDF" in table
