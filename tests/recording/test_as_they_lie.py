"""Logs as they lie: without names, as messages, cut, out of order, with objects."""

import json
import struct

import numpy as np
import pandas as pd
import pytest
from openpyxl import Workbook
from scipy.io import savemat

from tests.recording import _reading
from tests.recording._reading import refusal

DOF = 6


def blocks(made):
    """Return what a logger has of each joint, by kind."""
    v = np.gradient(made.q, made.dt, axis=0)
    warm = 30 + np.cumsum(np.full(made.q.shape, 1e-3), axis=0)
    a = np.gradient(v, made.dt, axis=0)
    return {"q": made.q, "v": v, "a": a, "tau": made.tau, "warm": warm}


def numbers(made, order, time=True):
    """Return the matrix of a table without names."""
    known = blocks(made)
    parts = [known[kind] for kind in order]
    return np.column_stack([made.t, *parts] if time else parts)


def written(path, matrix, separator=" ", header=""):
    np.savetxt(path, matrix, "%.9g", delimiter=separator, header=header, comments="")
    return path


def refused(path, made, **options):
    return refusal(path, urdf=made.urdf, **options)


def read(path, made, **options):
    """Read with the robot; the recording and the notes."""
    return _reading.read(path, urdf=made.urdf, **options)


def assert_same(recording, made, rows=slice(None)):
    np.testing.assert_allclose(recording.q, made.q[rows], atol=1e-7)
    np.testing.assert_allclose(recording.tau, made.tau[rows], rtol=1e-6, atol=1e-6)


# -- without names ---------------------------------------------------------------------


def test_columns_without_names_are_taken_by_their_places_alone(made, tmp_path):
    matrix = numbers(made, ("q", "v", "a", "tau", "warm"))
    path = written(tmp_path / "log.txt", matrix)
    error = refused(path, made)
    assert not error.options
    assert "has no names of columns" in error.reason
    assert 'columns="t=1,q=2-7' in error.reason
    recording, _ = read(path, made, columns="t=1,q=2-7,v=8-13,tau=20-25")
    assert_same(recording, made)
    # What nobody has named is not a condition of the robot.
    assert not recording.signals
    error = refused(path, made, columns="t=1,q=2-7,tau=28-33")
    assert "has no column 28-33" in error.reason


@pytest.mark.parametrize(
    "ending", ["csv", "npy", "npz", "mat", "json", "jsonl", "xlsx"]
)
def test_every_format_may_lack_the_names(ending, made, tmp_path):
    matrix, path = numbers(made, ("q", "tau")), tmp_path / f"log.{ending}"
    if ending == "csv":
        # As a data frame writes columns that have none.
        header = ",".join(map(str, range(13)))
        written(path, matrix, ",", header)
    elif ending == "npy":
        np.save(path, matrix)
    elif ending == "npz":
        np.savez(path, matrix)
    elif ending == "mat":
        savemat(path, {"data": matrix})
    elif ending == "json":
        path.write_text(json.dumps(matrix.tolist()))
    elif ending == "jsonl":
        path.write_text("\n".join(map(json.dumps, matrix.tolist())))
    else:
        book = Workbook()
        for row in matrix.tolist():
            book.active.append(row)
        book.save(path)
    assert "has no names of columns" in refused(path, made).reason
    recording, _ = read(path, made, columns="t=1,q=2-7,tau=8-13")
    assert_same(recording, made)


# -- JSON ------------------------------------------------------------------------------


def messages(made):
    """Return the recording as messages of ROS."""
    return [
        {
            "header": {"stamp": {"sec": 5 + int(t), "nanosec": round(t % 1 * 1e9)}},
            "name": list(made.joint_names),
            "position": q.tolist(),
            "velocity": [],
            "effort": tau.tolist(),
        }
        for t, q, tau in zip(made.t, made.q, made.tau)
    ]


@pytest.mark.parametrize("lines", [True, False])
def test_messages_of_ros_as_json(lines, made, tmp_path):
    path = tmp_path / "states.json"
    found = messages(made)
    path.write_text("\n".join(map(json.dumps, found)) if lines else json.dumps(found))
    recording, notes = read(path, made)
    assert_same(recording, made)
    assert any("taken as /joint_states as arrays or JSON" in x for x in notes)


def test_records_inside_of_an_object(made, tmp_path):
    path = tmp_path / "log.json"
    records = [
        {"timestamp": t, "q": q.tolist(), "tau": tau.tolist()}
        for t, q, tau in zip(made.t.tolist(), made.q, made.tau)
    ]
    path.write_text(json.dumps({"robot": "arm", "kp": 100, "entries": records}))
    recording, notes = read(path, made)
    assert_same(recording, made)
    assert any("the records are those of 'entries'" in x for x in notes)


@pytest.mark.parametrize("rows", [True, False])
def test_joints_are_known_by_the_names_beside_them(rows, made, tmp_path):
    path, order = tmp_path / "log.json", [3, 0, 5, 1, 4, 2]
    known = list(zip(np.array(made.joint_names), made.q.T, made.tau.T))
    known = [known[j] for j in order]
    if rows:
        found = [
            {"t": t, "m": [{"id": x, "pos": q[k], "tau": y[k]} for x, q, y in known]}
            for k, t in enumerate(made.t)
        ]
    else:
        found = [{"id": x, "pos": [*q], "tau": [*y]} for x, q, y in known]
        found = {"t": [*made.t], "m": found}
    path.write_text(json.dumps(found))
    options = refused(path, made).options
    assert options == {"columns": "q=m[{i}].pos,tau=m[{i}].tau"}
    assert_same(read(path, made, **options)[0], made)


def test_frames_of_pandas(made, tmp_path):
    path, frame = tmp_path / "log.json", pd.DataFrame({"t": made.t})
    for j, (q, tau) in enumerate(zip(made.q.T, made.tau.T), start=1):
        frame[f"q{j}"], frame[f"tau{j}"] = q, tau
    for orient in ("split", "records", "columns"):
        frame.to_json(path, orient=orient, double_precision=15)
        assert_same(read(path, made)[0], made)
    path.write_text(json.dumps({"columns": ["t", "q1", "q1"], "data": [[0, 1, 2]]}))
    assert "column 'q1' twice" in str(refusal(path))
    path.write_text(json.dumps({"columns": ["t", "q1"], "data": [[0.0]]}))
    assert "is not a complete frame of pandas" in str(refusal(path))


def assert_cut(path, text, made):
    """Read what lacks its end: all but the last row, with a word."""
    path.write_text(text)
    recording, notes = read(path, made)
    assert_same(recording, made, slice(0, made.n_samples - 1))
    assert any("the last line is cut" in x for x in notes)


def test_the_last_line_of_json_may_be_cut(made, tmp_path):
    text = "\n".join(map(json.dumps, messages(made)))
    assert_cut(tmp_path / "log.jsonl", text[:-30], made)


# -- text that is cut or out of order --------------------------------------------------


@pytest.fixture
def text(made):
    names = ["t", *(f"{x}{k + 1}" for x in ("q", "tau") for k in range(DOF))]
    rows = numbers(made, ("q", "tau"))
    return ",".join(names), [",".join(f"{x:.7f}" for x in row) for row in rows]


@pytest.mark.parametrize("cut", [100, 40, 9, 8, 3])
def test_a_last_line_that_is_cut_is_left_out_with_a_word(cut, made, text, tmp_path):
    assert_cut(tmp_path / "log.csv", "\n".join([text[0], *text[1]])[:-cut], made)


def test_two_recordings_one_behind_the_other_are_not_mixed(made, text, tmp_path):
    path = tmp_path / "log.csv"
    again = [
        f"{k / 250 + 0.002:.7f},{x.split(',', 1)[1]}" for k, x in enumerate(text[1])
    ]
    path.write_text("\n".join([text[0], *text[1], *again]) + "\n")
    assert "time runs backwards" in str(refused(path, made))


# -- MATLAB ----------------------------------------------------------------------------


def element(kind, content):
    """Return an element of a file of MATLAB's version 5."""
    padded = content + b"\0" * (-len(content) % 8)
    return struct.pack("<II", kind, len(content)) + padded


def opaque():
    """Return a variable of a class of MATLAB's own, as tables are saved."""
    flags = element(6, struct.pack("<II", 17, 0))
    names = [element(1, x) for x in (b"T", b"MCOS", b"table")]
    inner = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 1, 1))
    inner += element(1, b"") + element(6, struct.pack("<I", 7))
    return element(14, flags + b"".join(names) + element(14, inner))


@pytest.mark.parametrize("compressed", [True, False])
def test_matlab_with_an_object_beside_arrays(compressed, made, tmp_path):
    path = tmp_path / "log.mat"
    arrays = {"t": made.t, "q": made.q, "tau": made.tau, "tau_max": np.ones(DOF)}
    savemat(path, arrays, do_compression=compressed)
    path.write_bytes(path.read_bytes() + opaque())
    assert_same(read(path, made)[0], made)
