"""One recording whose channels are split over several files."""

import re

import numpy as np
import pytest

from sklearn_vbjfa.datasets import read_recording
from tests.recording.test_as_they_lie import DOF, assert_same, channels, read, save_txt


def names_of(kind, numbers=range(1, DOF + 1)):
    return [f"{kind}{k}" for k in numbers]


def save(path, names, *columns, separator=","):
    return save_txt(path, np.column_stack(columns), separator, separator.join(names))


@pytest.fixture
def split(arm, tmp_path):
    """Folder with positions.csv and efforts.csv, with the same stamps."""
    folder = tmp_path / "log"
    folder.mkdir()
    save(folder / "positions.csv", ["t", *names_of("q")], arm.t, arm.q)
    save(folder / "efforts.csv", ["t", *names_of("tau")], arm.t, arm.tau)
    return folder


@pytest.fixture
def matrices(arm, tmp_path):
    """Folder of five tables without column names, named after their channel."""
    folder = tmp_path / "five"
    folder.mkdir()
    values = channels(arm)
    for name, kind in (("q", "q"), ("dq", "v"), ("ddq", "a"), ("tau", "tau")):
        save_txt(folder / f"{name}.txt", values[kind])
    save_txt(folder / "t.txt", arm.t)
    return folder


def tau_at(arm, t):
    return np.column_stack([np.interp(t, arm.t, x) for x in arm.tau.T])


def error_of(paths, arm, **options):
    with pytest.raises(ValueError, match=r"[a-z]") as caught:
        read_recording(paths, urdf=arm.urdf, **options)
    return caught.value


def test_files_of_one_recording_in_a_folder_are_joined_with_a_note(split, arm):
    recording, notes = read(split, arm)
    assert_same(recording, arm)
    assert recording.name == "log"
    (note,) = notes
    assert (
        "2 files joined to one recording, by the rows of positions.csv: efforts.csv"
        in note
    )


def test_join_option_joins_files(split, arm):
    paths = [split / "positions.csv", split / "efforts.csv"]
    recording, _ = read(paths, arm, join=True)
    assert_same(recording, arm)
    error = error_of(paths, arm)
    assert "no torques: expected columns tau1" in str(error)
    assert "files of one recording need join=True" in str(error)


def test_file_names_name_unnamed_columns(matrices, arm):
    recording, notes = read(matrices, arm)
    assert_same(recording, arm)
    np.testing.assert_allclose(recording.v, channels(arm)["v"], atol=1e-6)
    assert any("t.txt (t), tau.txt (tau)" in x for x in notes)


def test_file_name_gives_the_channel_of_columns_named_after_joints(arm, tmp_path):
    for name, values in (("positions", arm.q), ("motor_currents", arm.tau)):
        order = np.random.default_rng(0).permutation(DOF)
        names = ["time", *(f"arm/{arm.joint_names[k]}" for k in order)]
        save(tmp_path / f"{name}.csv", names, arm.t, values[:, order])
    recording, _ = read(tmp_path, arm, gains="unknown")
    assert_same(recording, arm)
    assert set(recording.torque_units) == {"A"}


def test_different_stamps_are_interpolated_with_a_note(split, arm):
    t = arm.t[:-5] + 0.0013
    save(split / "efforts.csv", ["t", *names_of("tau")], t, tau_at(arm, t))
    recording, notes = read(split, arm)
    assert recording.n_samples == arm.n_samples - 6
    np.testing.assert_allclose(recording.q, arm.q[1:-5], atol=1e-7)
    expected = tau_at(arm, arm.t)[1:-5]
    tau = np.column_stack([np.interp(arm.t, t, x) for x in tau_at(arm, t).T])[1:-5]
    np.testing.assert_allclose(recording.tau, tau, atol=1e-5)
    assert np.abs(tau - expected).max() > 1e-3
    text = " ".join(notes)
    assert "6 row(s) of positions.csv are not in all files: left out" in text


def test_rows_missing_in_one_file_are_matched_by_stamps(split, arm):
    keep = np.r_[0:400, 460:990]
    save(split / "efforts.csv", ["t", *names_of("tau")], arm.t[keep], arm.tau[keep])
    recording, notes = read(split, arm)
    assert_same(recording, arm, keep)
    assert len(recording.group_names) == 2
    text = " ".join(notes)
    assert "70 row(s) of positions.csv" in text


def test_clocks_without_a_common_time_are_refused(split, arm):
    save(split / "efforts.csv", ["t", *names_of("tau")], arm.t + 1e3, arm.tau)
    assert "no time in common; expected one clock" in str(error_of(split, arm))


def test_clocks_in_different_units_need_a_named_unit(split, arm):
    names, path = names_of("tau"), split / "efforts.csv"
    save(path, ["t", *names], 1e3 * arm.t, arm.tau)
    message = str(error_of(split, arm))
    assert "the times span" in message
    assert "write both in one unit, or the unit into the name" in message
    save(path, ["t_ms", *names], 1e3 * arm.t, arm.tau)
    assert_same(read(split, arm)[0], arm)


def test_files_without_stamps_need_equal_row_counts(matrices, arm):
    save_txt(matrices / "tau.txt", arm.tau[:-1])
    message = str(error_of(matrices, arm, join=True))
    assert re.search("has 999 rows and .* has 1000.* cut both", message)


def test_a_channel_in_two_files_must_be_identical(split, arm):
    duplicate = split / "more.csv"
    save(duplicate, ["t", *names_of("q")], arm.t, arm.q)
    assert_same(read(split, arm)[0], arm)
    save(duplicate, ["t", *names_of("q")], arm.t, arm.q + 0.1)
    message = str(error_of(split, arm, join=True))
    assert "'q1' is in positions.csv and in another file" in message or (
        "'q1' is in more.csv and in another file" in message
    )


def test_signals_of_another_file_are_interpolated(split, arm):
    temperature = 20 + arm.t[::10]
    save(split / "heat.csv", ["t", "temperature"], arm.t[::10], temperature)
    recording, _ = read(split, arm)
    signal = recording.signals["temperature"]
    np.testing.assert_allclose(signal, 20 + recording.t, atol=1e-6)


def test_a_folder_of_recordings_is_not_joined(arm, tmp_path):
    for k in range(2):
        names = ["t", *names_of("q"), *names_of("tau")]
        save(tmp_path / f"run{k}.csv", names, arm.t, arm.q + 0.01 * k, arm.tau)
    recording, notes = read(tmp_path, arm)
    assert recording.group_names == ("run0", "run1")
    assert recording.n_samples == 2 * arm.n_samples
    assert any("taken as a folder of 2 recordings, one a file" in x for x in notes)
    assert "is in run1.csv and in another" in str(error_of(tmp_path, arm, join=True))


def test_recordings_that_need_a_mapping_are_not_joined(arm, tmp_path):
    for k in range(2):
        matrix = np.column_stack([arm.t, arm.q + 0.01 * k, arm.tau])
        save_txt(tmp_path / f"run{k}.txt", matrix)
    recording, _ = read(tmp_path, arm, columns="t=1,q=2-7,tau=8-13")
    assert len(recording.group_names) == 2


@pytest.mark.parametrize("columns", ["channels", "joints", "numbers"])
def test_velocities_in_a_separate_file(columns, arm, tmp_path):
    values = channels(arm)
    for kind, name in (("q", "positions"), ("v", "velocities"), ("tau", "torques")):
        names = {"channels": names_of(kind), "joints": arm.joint_names}
        names["numbers"] = names_of("joint")
        save(tmp_path / f"{name}.csv", ["t", *names[columns]], arm.t, values[kind])
    recording, _ = read(tmp_path, arm)
    assert_same(recording, arm)
    np.testing.assert_allclose(recording.v, values["v"], atol=1e-6)


def test_non_tables_in_a_folder_are_skipped_with_a_note(split, arm):
    (split / "README.txt").write_text("The arm of the lab\nrecorded on a cold day\n")
    (split / "config.json").write_text('{"kp": [20, 40], "robot": "arm"}')
    (split / "video.mp4").write_bytes(b"\0\1\2")
    (split / "arm.md").write_text("gain: 3")
    (split / "empty.csv").write_text("")
    recording, notes = read(split, arm)
    assert_same(recording, arm)
    (note,) = (x for x in notes if "no tables of numbers in" in x)
    for name in ("README.txt", "config.json", "video.mp4", "arm.md"):
        assert name in note


def test_a_broken_file_among_many_is_named(arm, tmp_path):
    rows = slice(0, 40)
    for k in range(30):
        names, q = ["t", *names_of("q"), *names_of("tau")], arm.q[rows] + 0.001 * k
        save(tmp_path / f"run{k:02}.csv", names, arm.t[rows], q, arm.tau[rows])
    assert len(read(tmp_path, arm)[0].group_names) == 30
    broken = tmp_path / "run17.csv"
    lines = broken.read_text().splitlines()
    lines[9] = lines[9][:30]
    broken.write_text("\n".join(lines) + "\n")
    assert f"{broken}: line 10 has" in str(error_of(tmp_path, arm))
