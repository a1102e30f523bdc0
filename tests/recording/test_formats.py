"""Other formats: compressed text, spreadsheets, MATLAB, npy, LeRobot, JSON."""

import bz2
import datetime
import gzip
import json
import lzma
import sys

import numpy as np
import pytest
from scipy.io import savemat

from sklearn_vbjfa.datasets import read_recording
from sklearn_vbjfa.recording import recordings_in
from tests.recording._lerobot import write_lerobot
from tests.recording._reading import read_text, refusal
from tests.recording.test_reader import DT, N, assert_same, table, write

COMPRESS = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}


# -- compressed text -------------------------------------------------------------------


@pytest.mark.parametrize("ending", COMPRESS)
def test_compressed_text(tmp_path, ending):
    columns = table()
    plain = write(tmp_path / "arm.csv", columns)
    path = tmp_path / f"arm.csv{ending}"
    path.write_bytes(COMPRESS[ending](plain.read_bytes()))
    recording = read_recording(path)
    assert_same(recording, columns)
    assert recording.name == "arm"
    # Line numbers refer to the uncompressed text.
    text = plain.read_text().replace("\n0.01,", "\noff,", 1)
    path.write_bytes(COMPRESS[ending](text.encode()))
    assert "'off' in line 3, column 't' is not a number" in str(refusal(path))


# -- pipes -----------------------------------------------------------------------------


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_standard_input(tmp_path, monkeypatch, pack):
    columns = table()
    path = write(tmp_path / "arm.csv", columns)
    path.write_bytes(pack(path.read_bytes()))
    with path.open("rb") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        recording = read_recording("-")
    assert_same(recording, columns)


def test_truncated_standard_input(tmp_path, monkeypatch):
    content = write(tmp_path / "arm.csv", table()).read_bytes()
    path = tmp_path / "pipe"
    path.write_bytes(content[:-25])
    with path.open("rb") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        with pytest.warns(UserWarning, match="standard input: the last line is cut"):
            assert read_recording("-").n_samples == N - 1
    path.write_bytes(gzip.compress(content)[:-25])
    with path.open("rb") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        with pytest.raises(ValueError, match="standard input: is not a complete gz"):
            read_recording("-")


def test_error_without_pandas_names_the_extra_to_install(tmp_path, monkeypatch):
    path = write(tmp_path / "arm.csv", table())
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r'pip install "sklearn-vbjfa\[robot\]"'):
        read_recording(path)


# -- spreadsheets ----------------------------------------------------------------------


@pytest.fixture
def sheet(tmp_path):
    import openpyxl

    def save(rows, *others):
        book = openpyxl.Workbook()
        for row in rows:
            book.active.append(list(row))
        for other in others:
            extra = book.create_sheet()
            for row in other:
                extra.append(list(row))
        book.save(tmp_path / "arm.xlsx")
        return tmp_path / "arm.xlsx"

    return save


def rows_of(columns):
    return [list(columns), *(list(map(float, row)) for row in zip(*columns.values()))]


def test_spreadsheet_with_text_and_dates(sheet):
    columns = table(1)
    begin = datetime.datetime(2026, 11, 22, 12)
    times = [begin + datetime.timedelta(milliseconds=10 * k) for k in range(N)]
    degrees = np.rad2deg(columns["q1"])
    rows = zip(times, degrees, columns["tau1"], N * ["run"])
    head = [[], ["t", "q1 [°]", "tau1", "mode"]]
    path = sheet([*head, *([x, float(q), float(u), m] for x, q, u, m in rows)])
    recording, notes = read_text(path)
    assert "mode hold no finite numbers" in notes
    assert "converted from °" in notes
    np.testing.assert_allclose(recording.q[:, 0], columns["q1"], atol=1e-9)
    assert recording.dt == pytest.approx(DT)


@pytest.mark.parametrize("before", [[], [[]], [[["note"], ["recorded on Monday"]]]])
def test_first_sheet_with_a_table_is_read(before, sheet):
    columns = table()
    assert_same(read_recording(sheet(*before, rows_of(columns))), columns)


# -- MATLAB ----------------------------------------------------------------------------


def matrices():
    columns = table()
    return columns, {
        "t": columns["t"],
        "q": np.column_stack([columns["q1"], columns["q2"]]),
        "tau": np.column_stack([columns["tau1"], columns["tau2"]]),
    }


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("compressed", [False, True])
def test_matlab(tmp_path, turned, inside, compressed):
    columns, arrays = matrices()
    if turned:
        arrays = {name: x.T for name, x in arrays.items()}
    path = tmp_path / "arm.mat"
    content = {"log": arrays} if inside else arrays
    savemat(path, content, do_compression=compressed)
    assert_same(read_recording(path), columns)


def test_unsupported_matlab_version_is_refused(tmp_path):
    path = tmp_path / "arm.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + bytes(900))
    message = str(refusal(path))
    assert "is not a complete MATLAB file of version 5 to 7.2" in message
    assert "save(FILE, 't', 'q', 'tau', '-v7')" in message


# -- npy -------------------------------------------------------------------------------


def test_npy_with_named_fields(tmp_path):
    columns, arrays = matrices()
    kinds = [("t", float), ("q", float, 2), ("tau", float, 2)]
    record = np.zeros(N, kinds)
    for name, x in arrays.items():
        record[name] = x
    np.save(tmp_path / "arm.npy", record)
    assert_same(read_recording(tmp_path / "arm.npy"), columns)


# -- LeRobot ---------------------------------------------------------------------------


@pytest.fixture
def lerobot(tmp_path):
    def save(nested=False):
        names = ["hip.pos", "knee.pos"]
        names = {"motors": names} if nested else names
        _, arrays = matrices()
        values = {"observation.state": arrays["q"], "action": arrays["q"] + 0.1}
        values["observation.effort"] = arrays["tau"]
        files = [f"episode_{k:06d}" for k in range(2)]
        info = {"codebase_version": "v2.1"}
        return write_lerobot(tmp_path / "set", names, values, files, **info)

    return save


@pytest.mark.parametrize("nested", [False, True])
def test_a_lerobot_data_set(lerobot, nested):
    folder = lerobot(nested=nested)
    with pytest.warns(UserWarning, match="taken as a LeRobot data set"):
        recording = read_recording(folder)
    assert_same(recording, table())
    assert recording.joint_names == ("hip", "knee")
    assert recording.group_names == ("0", "1")
    assert not recording.signals
    episode = folder / "data" / "chunk-000" / "episode_000001.parquet"
    with pytest.warns(UserWarning, match="taken as a LeRobot data set"):
        recording = read_recording(episode)
    np.testing.assert_allclose(recording.q[:, 0], table()["q1"][N // 2 :], atol=1e-9)


def test_recordings_in_a_folder(lerobot, tmp_path):
    (tmp_path / "notes.md").write_text("no recording")
    (tmp_path / "bag").mkdir()
    for name in ("b.csv", "a.npz", "c.mcap", ".hidden.csv", "bag/one.db3"):
        (tmp_path / name).write_text("")
    (tmp_path / "empty").mkdir()
    data_set = lerobot()
    names = [path.name for path in recordings_in(tmp_path)]
    assert names == ["a.npz", "b.csv", "bag", "c.mcap", "set"]
    assert recordings_in(data_set) == [data_set]


# -- JSON ------------------------------------------------------------------------------


def records_of(columns):
    return [dict(zip(columns, map(float, row))) for row in zip(*columns.values())]


@pytest.mark.parametrize("kind", ["columns", "arrays", "arrays inside", "records"])
def test_json(kind, tmp_path):
    columns, arrays = matrices()
    arrays = {name: x.tolist() for name, x in arrays.items()}
    content = {
        "columns": {name: x.tolist() for name, x in columns.items()},
        "arrays": arrays,
        "arrays inside": {"log": arrays},
        "records": records_of(columns),
    }
    path = tmp_path / "arm.json"
    path.write_text(json.dumps(content[kind], indent=1))
    assert_same(read_recording(path), columns)


@pytest.mark.parametrize("ending", [".jsonl", ".ndjson", ".json", ".jsonl.gz"])
def test_json_lines(ending, tmp_path):
    text = "\n".join(map(json.dumps, records_of(table()))) + "\n"
    path = tmp_path / f"arm{ending}"
    path.write_bytes(COMPRESS.get(f".{ending.split('.')[-1]}", bytes)(text.encode()))
    assert_same(read_recording(path), table())


# -- lists within cells, recordings within a list --------------------------------------


@pytest.mark.parametrize("names", ["['hip', 'knee']", "hip;knee"])
def test_lists_of_joint_states_in_csv_cells(names, tmp_path):
    columns, arrays = matrices()
    lines = ["time,name,position,effort"]
    for t, q, tau in zip(arrays["t"], arrays["q"], arrays["tau"]):
        lines.append(f"""{t:.6f},"{names}","{list(q)}","{list(tau)}\"""")
    path = tmp_path / "arm.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.warns(UserWarning, match="taken as /joint_states as a table"):
        recording = read_recording(path)
    assert_same(recording, columns)
    assert recording.joint_names == ("hip", "knee")


@pytest.mark.parametrize("separator", [",", ", ", " "])
def test_lists_in_csv_cells_are_columns(separator, tmp_path):
    columns, arrays = matrices()
    names = ("q", "tau")
    lines = [",".join(("t", *names))]
    for k in range(N):
        cells = [separator.join(f"{x:.12g}" for x in arrays[name][k]) for name in names]
        lines.append(",".join([f"{arrays['t'][k]:.12g}", *(f'"[{x}]"' for x in cells)]))
    path = tmp_path / "arm.csv"
    path.write_text("\n".join(lines) + "\n")
    assert_same(read_recording(path), columns)
    # A row truncated within a list is skipped.
    path.write_text("\n".join(lines)[:-3])
    with pytest.warns(UserWarning, match="the last line is cut"):
        assert read_recording(path).n_samples == N - 1
    lines[1] = lines[1].replace(f"{separator}", f"{separator}7{separator}", 1)
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match=r"cells|lists|entries"):
        read_recording(path)


def test_rows_of_bracketed_lists_need_a_mapping(tmp_path):
    columns = table()
    lines = [
        f"({q1:.12g} {q2:.12g}) 1 ({tau1:.12g} {tau2:.12g}) 1"
        for q1, q2, tau1, tau2 in zip(
            *(columns[x] for x in ("q1", "q2", "tau1", "tau2"))
        )
    ]
    path = tmp_path / "arm.txt"
    path.write_text("\n".join(lines) + "\n")
    assert "no names of columns; give the places of its 6 columns" in str(refusal(path))
    recording = read_recording(path, columns="q=1-2,tau=4-5", dt=DT)
    assert_same(recording, columns)


def test_recordings_of_different_lengths_are_refused(tmp_path):
    columns = table()
    trials = [
        {"kind": kind, **{key: columns[key][:n].tolist() for key in ("q1", "tau1")}}
        for kind, n in (("chirp", N), ("step", N - 20), ("ramp", N - 30))
    ]
    path = tmp_path / "arm.json"
    path.write_text(json.dumps({"config": {"limits": [-1, 1]}, "data": trials}))
    assert "'data' has 3 records with arrays of different lengths" in str(refusal(path))


@pytest.mark.parametrize(
    ("seconds", "rest", "count"),
    [
        ("header.stamp.secs", "header.stamp.nsecs", 10**9),
        ("sec", "nanosec", 10**9),
        ("ZeitInSec", "ZeitInNanoSec", 10**9),
        ("stamp_s", "stamp_us", 10**6),
    ],
)
def test_seconds_and_fractions_in_two_columns(seconds, rest, count, tmp_path):
    columns = table()
    stamps = np.round((1_700_000_000.25 + columns.pop("t")) * count).astype(int)
    clock = {seconds: stamps // count, rest: stamps % count}
    path = write(tmp_path / "arm.csv", clock | columns)
    with pytest.warns(UserWarning, match=f"t = {seconds}"):
        recording = read_recording(path)
    assert recording.dt == pytest.approx(DT)
    assert not recording.signals
    assert "no finite" not in read_text(write(path, clock | table()))[1]


def test_seconds_and_fractions_in_three_columns(tmp_path):
    us = np.arange(0, N * 5500, 5500)
    clock = {"sec": us // 10**6, "msec": us // 1000 % 1000, "usec": us % 1000}
    columns = {name: x for name, x in table().items() if name != "t"} | clock
    recording = read_recording(write(tmp_path / "arm.csv", columns))
    assert recording.dt == pytest.approx(0.0055)
