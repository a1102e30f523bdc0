"""Several files of one recording, side by side."""

import re

import numpy as np
import pytest

from sklearn_vbjfa.datasets import read_recording
from tests.recording.test_as_they_lie import DOF, assert_same, blocks, read, written


def named(kind, numbers=range(1, DOF + 1)):
    return [f"{kind}{k}" for k in numbers]


def save(path, names, *columns, separator=","):
    return written(path, np.column_stack(columns), separator, separator.join(names))


@pytest.fixture
def two(made, tmp_path):
    """Folder of positions.csv and efforts.csv with the same stamps."""
    folder = tmp_path / "log"
    folder.mkdir()
    save(folder / "positions.csv", ["t", *named("q")], made.t, made.q)
    save(folder / "efforts.csv", ["t", *named("tau")], made.t, made.tau)
    return folder


@pytest.fixture
def five(made, tmp_path):
    """Folder of five tables without names, called after what they hold."""
    folder = tmp_path / "five"
    folder.mkdir()
    known = blocks(made)
    for name, kind in (("q", "q"), ("dq", "v"), ("ddq", "a"), ("tau", "tau")):
        written(folder / f"{name}.txt", known[kind])
    written(folder / "t.txt", made.t)
    return folder


def at(made, t):
    return np.column_stack([np.interp(t, made.t, x) for x in made.tau.T])


def refused(paths, made, **options):
    with pytest.raises(ValueError, match=r"[a-z]") as caught:
        read_recording(paths, urdf=made.urdf, **options)
    return caught.value


def test_a_folder_of_files_of_one_recording_is_joined_with_a_word(two, made):
    recording, notes = read(two, made)
    assert_same(recording, made)
    assert recording.name == "log"
    (note,) = notes
    assert (
        "2 files joined to one recording, by the rows of positions.csv: efforts.csv"
        in note
    )


def test_files_are_joined_where_that_is_asked_for(two, made):
    paths = [two / "positions.csv", two / "efforts.csv"]
    recording, _ = read(paths, made, join=True)
    assert_same(recording, made)
    error = refused(paths, made)
    assert "no torques: expected columns tau1" in str(error)
    assert "files of one recording need join=True" in str(error)


def test_the_names_of_files_name_columns_that_have_none(five, made):
    recording, notes = read(five, made)
    assert_same(recording, made)
    np.testing.assert_allclose(recording.v, blocks(made)["v"], atol=1e-6)
    assert any("t.txt (t), tau.txt (tau)" in x for x in notes)


def test_columns_called_after_joints_are_those_of_the_file(made, tmp_path):
    for name, values in (("positions", made.q), ("motor_currents", made.tau)):
        order = np.random.default_rng(0).permutation(DOF)
        names = ["time", *(f"arm/{made.joint_names[k]}" for k in order)]
        save(tmp_path / f"{name}.csv", names, made.t, values[:, order])
    recording, _ = read(tmp_path, made, gains="unknown")
    assert_same(recording, made)
    assert set(recording.torque_units) == {"A"}


def test_other_stamps_are_interpolated_with_a_word(two, made):
    t = made.t[:-5] + 0.0013
    save(two / "efforts.csv", ["t", *named("tau")], t, at(made, t))
    recording, notes = read(two, made)
    assert recording.n_samples == made.n_samples - 6
    np.testing.assert_allclose(recording.q, made.q[1:-5], atol=1e-7)
    expected = at(made, made.t)[1:-5]
    twice = np.column_stack([np.interp(made.t, t, x) for x in at(made, t).T])[1:-5]
    np.testing.assert_allclose(recording.tau, twice, atol=1e-5)
    assert np.abs(twice - expected).max() > 1e-3
    text = " ".join(notes)
    assert "6 row(s) of positions.csv are not in all files: left out" in text


def test_rows_that_one_file_lacks_are_taken_by_their_stamps(two, made):
    keep = np.r_[0:400, 460:990]
    save(two / "efforts.csv", ["t", *named("tau")], made.t[keep], made.tau[keep])
    recording, notes = read(two, made)
    assert_same(recording, made, keep)
    assert len(recording.group_names) == 2
    text = " ".join(notes)
    assert "70 row(s) of positions.csv" in text


def test_clocks_without_a_common_time_are_refused(two, made):
    save(two / "efforts.csv", ["t", *named("tau")], made.t + 1e3, made.tau)
    assert "no time in common; expected one clock" in str(refused(two, made))


def test_clocks_in_other_units_are_refused_unless_the_unit_is_named(two, made):
    names, path = named("tau"), two / "efforts.csv"
    save(path, ["t", *names], 1e3 * made.t, made.tau)
    message = str(refused(two, made))
    assert "the times span" in message
    assert "write both in one unit, or the unit into the name" in message
    save(path, ["t_ms", *names], 1e3 * made.t, made.tau)
    assert_same(read(two, made)[0], made)


def test_rows_without_stamps_need_the_same_number(five, made):
    written(five / "tau.txt", made.tau[:-1])
    message = str(refused(five, made, join=True))
    assert re.search("has 999 rows and .* has 1000.* cut both", message)


def test_a_channel_in_two_files_is_refused_unless_it_is_the_same(two, made):
    again = two / "more.csv"
    save(again, ["t", *named("q")], made.t, made.q)
    assert_same(read(two, made)[0], made)
    save(again, ["t", *named("q")], made.t, made.q + 0.1)
    message = str(refused(two, made, join=True))
    assert "'q1' is in positions.csv and in another file" in message or (
        "'q1' is in more.csv and in another file" in message
    )


def test_signals_of_another_file_come_with_it(two, made):
    heat = 20 + made.t[::10]
    save(two / "heat.csv", ["t", "temperature"], made.t[::10], heat)
    recording, _ = read(two, made)
    found = recording.signals["temperature"]
    np.testing.assert_allclose(found, 20 + recording.t, atol=1e-6)


def test_a_folder_of_recordings_is_not_joined(made, tmp_path):
    for k in range(2):
        names = ["t", *named("q"), *named("tau")]
        save(tmp_path / f"run{k}.csv", names, made.t, made.q + 0.01 * k, made.tau)
    recording, notes = read(tmp_path, made)
    assert recording.group_names == ("run0", "run1")
    assert recording.n_samples == 2 * made.n_samples
    assert any("taken as a folder of 2 recordings, one a file" in x for x in notes)
    assert "is in run1.csv and in another" in str(refused(tmp_path, made, join=True))


def test_recordings_that_need_a_mapping_are_not_joined(made, tmp_path):
    for k in range(2):
        matrix = np.column_stack([made.t, made.q + 0.01 * k, made.tau])
        written(tmp_path / f"run{k}.txt", matrix)
    recording, _ = read(tmp_path, made, columns="t=1,q=2-7,tau=8-13")
    assert len(recording.group_names) == 2


@pytest.mark.parametrize("columns", ["channels", "joints", "numbers"])
def test_velocities_of_a_file_of_their_own(columns, made, tmp_path):
    known = blocks(made)
    for kind, name in (("q", "positions"), ("v", "velocities"), ("tau", "torques")):
        names = {"channels": named(kind), "joints": made.joint_names}
        names["numbers"] = named("joint")
        save(tmp_path / f"{name}.csv", ["t", *names[columns]], made.t, known[kind])
    recording, _ = read(tmp_path, made)
    assert_same(recording, made)
    np.testing.assert_allclose(recording.v, known["v"], atol=1e-6)


def test_files_of_a_folder_that_are_no_tables_are_left_out_with_a_note(two, made):
    (two / "README.txt").write_text("The arm of the lab\nrecorded on a cold day\n")
    (two / "config.json").write_text('{"kp": [20, 40], "robot": "arm"}')
    (two / "video.mp4").write_bytes(b"\0\1\2")
    (two / "arm.md").write_text("gain: 3")
    recording, notes = read(two, made)
    assert_same(recording, made)
    (note,) = (x for x in notes if "no tables of numbers in" in x)
    for name in ("README.txt", "config.json", "video.mp4", "arm.md"):
        assert name in note


def test_a_broken_file_among_many_is_named(made, tmp_path):
    rows = slice(0, 40)
    for k in range(30):
        names, q = ["t", *named("q"), *named("tau")], made.q[rows] + 0.001 * k
        save(tmp_path / f"run{k:02}.csv", names, made.t[rows], q, made.tau[rows])
    assert len(read(tmp_path, made)[0].group_names) == 30
    broken = tmp_path / "run17.csv"
    lines = broken.read_text().splitlines()
    lines[9] = lines[9][:30]
    broken.write_text("\n".join(lines) + "\n")
    assert f"{broken}: line 10 has" in str(refused(tmp_path, made))
