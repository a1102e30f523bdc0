"""Irregular logs: unnamed columns, JSON messages, truncated files, MATLAB objects."""

import itertools
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


def channels(arm):
    """Return the channels of a logger (n, DOF), by kind."""
    v = np.gradient(arm.q, arm.dt, axis=0)
    temperature = 30 + np.cumsum(np.full(arm.q.shape, 1e-3), axis=0)
    a = np.gradient(v, arm.dt, axis=0)
    return {"q": arm.q, "v": v, "a": a, "tau": arm.tau, "warm": temperature}


def matrix_of(arm, order, time=True):
    """Return the matrix of a table without column names."""
    values = channels(arm)
    parts = [values[kind] for kind in order]
    return np.column_stack([arm.t, *parts] if time else parts)


def save_txt(path, matrix, separator=" ", header=""):
    np.savetxt(path, matrix, "%.9g", delimiter=separator, header=header, comments="")
    return path


def error_of(path, arm, **options):
    return refusal(path, urdf=arm.urdf, **options)


def read(path, arm, **options):
    """Read with the robot model; return the recording and the notes."""
    return _reading.read(path, urdf=arm.urdf, **options)


def assert_same(recording, arm, rows=slice(None)):
    np.testing.assert_allclose(recording.q, arm.q[rows], atol=1e-7)
    np.testing.assert_allclose(recording.tau, arm.tau[rows], rtol=1e-6, atol=1e-6)


def test_unnamed_columns_need_a_mapping_by_position(arm, tmp_path):
    matrix = matrix_of(arm, ("q", "v", "a", "tau", "warm"))
    path = save_txt(tmp_path / "log.txt", matrix)
    error = error_of(path, arm)
    assert not error.options
    assert "has no names of columns" in error.reason
    assert 'columns="t=1,q=2-7' in error.reason
    recording, _ = read(path, arm, columns="t=1,q=2-7,v=8-13,tau=20-25")
    assert_same(recording, arm)
    # Unnamed columns are not signals.
    assert not recording.signals
    error = error_of(path, arm, columns="t=1,q=2-7,tau=28-33")
    assert "has no column 28-33" in error.reason
    few = error_of(save_txt(tmp_path / "few.txt", matrix[:, :8]), arm).reason
    assert "8 columns are too few for positions and torques of 6 joints" in few


@pytest.mark.parametrize(
    "ending", ["csv", "npy", "npz", "mat", "json", "jsonl", "xlsx"]
)
def test_every_format_may_lack_column_names(ending, arm, tmp_path):
    matrix, path = matrix_of(arm, ("q", "tau")), tmp_path / f"log.{ending}"
    if ending == "csv":
        # The header that pandas writes for unnamed columns.
        header = ",".join(map(str, range(13)))
        save_txt(path, matrix, ",", header)
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
    assert "has no names of columns" in error_of(path, arm).reason
    recording, _ = read(path, arm, columns="t=1,q=2-7,tau=8-13")
    assert_same(recording, arm)


def messages(arm):
    """Return the recording as ROS JointState messages."""
    return [
        {
            "header": {"stamp": {"sec": 5 + int(t), "nanosec": round(t % 1 * 1e9)}},
            "name": list(arm.joint_names),
            "position": q.tolist(),
            "velocity": [],
            "effort": tau.tolist(),
        }
        for t, q, tau in zip(arm.t, arm.q, arm.tau)
    ]


@pytest.mark.parametrize("lines", [True, False])
@pytest.mark.parametrize("publishers", [1, 2])
def test_ros_messages_as_json(lines, publishers, arm, tmp_path):
    path, keys = tmp_path / "states.json", ("name", "position", "effort")
    parts = itertools.product(messages(arm), range(publishers))
    states = [x | {key: x[key][k::publishers] for key in keys} for x, k in parts]
    path.write_text("\n".join(map(json.dumps, states)) if lines else json.dumps(states))
    recording, notes = read(path, arm)
    assert_same(recording, arm)
    assert any("taken as /joint_states as arrays or JSON" in x for x in notes)


def test_records_nested_in_an_object(arm, tmp_path):
    path = tmp_path / "log.json"
    records = [
        {"timestamp": t, "q": q.tolist(), "tau": tau.tolist()}
        for t, q, tau in zip(arm.t.tolist(), arm.q, arm.tau)
    ]
    path.write_text(json.dumps({"robot": "arm", "kp": 100, "entries": records}))
    recording, notes = read(path, arm)
    assert_same(recording, arm)
    assert any("the records are those of 'entries'" in x for x in notes)


@pytest.mark.parametrize("rows", [True, False])
def test_joints_are_ordered_by_the_ids_in_json(rows, arm, tmp_path):
    path, order = tmp_path / "log.json", [3, 0, 5, 1, 4, 2]
    joints = list(zip(np.array(arm.joint_names), arm.q.T, arm.tau.T))
    joints = [joints[j] for j in order]
    if rows:
        records = [
            {"t": t, "m": [{"id": x, "pos": q[k], "tau": y[k]} for x, q, y in joints]}
            for k, t in enumerate(arm.t)
        ]
    else:
        records = [{"id": x, "pos": [*q], "tau": [*y]} for x, q, y in joints]
        records = {"t": [*arm.t], "m": records}
    path.write_text(json.dumps(records))
    options = error_of(path, arm).options
    assert options == {"columns": "q=m[{i}].pos,tau=m[{i}].tau"}
    assert_same(read(path, arm, **options)[0], arm)


def test_json_of_pandas_data_frames(arm, tmp_path):
    path, frame = tmp_path / "log.json", pd.DataFrame({"t": arm.t})
    for j, (q, tau) in enumerate(zip(arm.q.T, arm.tau.T), start=1):
        frame[f"q{j}"], frame[f"tau{j}"] = q, tau
    for orient in ("split", "records", "columns"):
        frame.to_json(path, orient=orient, double_precision=15)
        assert_same(read(path, arm)[0], arm)
    path.write_text(json.dumps({"columns": ["t", "q1", "q1"], "data": [[0, 1, 2]]}))
    assert "column 'q1' twice" in str(refusal(path))
    path.write_text(json.dumps({"columns": ["t", "q1"], "data": [[0.0]]}))
    assert "is not a complete frame of pandas" in str(refusal(path))


def assert_cut(path, text, arm):
    """Check that a truncated text is read without its last row, with a note."""
    path.write_text(text)
    recording, notes = read(path, arm)
    assert_same(recording, arm, slice(0, arm.n_samples - 1))
    assert any("the last line is cut" in x for x in notes)


def test_a_truncated_last_json_line_is_skipped(arm, tmp_path):
    text = "\n".join(map(json.dumps, messages(arm)))
    assert_cut(tmp_path / "log.jsonl", text[:-30], arm)


@pytest.fixture
def text(arm):
    names = ["t", *(f"{x}{k + 1}" for x in ("q", "tau") for k in range(DOF))]
    rows = matrix_of(arm, ("q", "tau"))
    return ",".join(names), [",".join(f"{x:.7f}" for x in row) for row in rows]


@pytest.mark.parametrize("cut", [100, 40, 9, 8, 3])
def test_a_truncated_last_line_is_skipped_with_a_note(cut, arm, text, tmp_path):
    assert_cut(tmp_path / "log.csv", "\n".join([text[0], *text[1]])[:-cut], arm)


def element(kind, content):
    """Return a data element of a MATLAB 5 file."""
    padded = content + b"\0" * (-len(content) % 8)
    return struct.pack("<II", kind, len(content)) + padded


def opaque():
    """Return a variable of a MATLAB class, as tables are saved."""
    flags = element(6, struct.pack("<II", 17, 0))
    names = [element(1, x) for x in (b"T", b"MCOS", b"table")]
    inner = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 1, 1))
    inner += element(1, b"") + element(6, struct.pack("<I", 7))
    return element(14, flags + b"".join(names) + element(14, inner))


@pytest.mark.parametrize("compressed", [True, False])
def test_matlab_objects_are_skipped(compressed, arm, tmp_path):
    path = tmp_path / "log.mat"
    arrays = {"t": arm.t, "q": arm.q, "tau": arm.tau, "tau_max": np.ones(DOF)}
    savemat(path, arrays, do_compression=compressed)
    path.write_bytes(path.read_bytes() + opaque())
    assert_same(read(path, arm)[0], arm)
