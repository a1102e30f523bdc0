"""Reading tables: formats, columns, units, time stamps and error messages."""

import csv as csv_module
import re
import warnings

import numpy as np
import pytest

from sklearn_vbjfa.datasets import make_robot_recording, read_recording
from tests.recording._reading import read, refusal

N = 60
DT = 0.01


def table(nv=2, n=N, dt=DT):
    """Return the columns of a smooth recording."""
    t = dt * np.arange(n)
    columns = {"t": t}
    for j in range(1, nv + 1):
        columns[f"q{j}"] = np.sin(2 * t + j)
        columns[f"v{j}"] = 2 * np.cos(2 * t + j)
        columns[f"tau{j}"] = j * np.cos(3 * t)
    return columns


def write(path, columns, separator=",", head=""):
    rows = [separator.join(columns)]
    for row in zip(*columns.values()):
        cells = (x if isinstance(x, str) else f"{x:.10g}" for x in row)
        rows.append(separator.join(cells))
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def csv(tmp_path):
    return lambda columns, **options: write(tmp_path / "arm.csv", columns, **options)


def assert_same(recording, columns, nv=2, atol=1e-9):
    for kind, values in (("q", recording.q), ("tau", recording.tau)):
        expected = np.column_stack([columns[f"{kind}{j + 1}"] for j in range(nv)])
        np.testing.assert_allclose(values, expected, atol=atol)


# -- formats ---------------------------------------------------------------------------


@pytest.mark.parametrize("separator", [",", ";", "\t", " ", "|"])
def test_csv_separators(csv, separator):
    columns = table()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recording = read_recording(csv(columns, separator=separator))
    assert_same(recording, columns)
    np.testing.assert_allclose(recording.v[:, 0], columns["v1"], atol=1e-9)
    assert recording.dt == pytest.approx(DT)
    assert recording.name == "arm"
    assert recording.joint_names == ("joint_1", "joint_2")
    assert recording.position_units == ("rad", "rad")
    assert recording.torque_units == ("N m", "N m")


def test_commented_header(tmp_path):
    columns = table(1)
    path = tmp_path / "arm.txt"
    np.savetxt(path, np.column_stack(list(columns.values())), header=" ".join(columns))
    assert_same(read_recording(path), columns, nv=1)


@pytest.mark.parametrize("matrices", [True, False])
def test_npz(tmp_path, matrices):
    columns = table()
    arrays = columns
    if matrices:
        arrays = {
            kind: np.column_stack([columns[f"{kind}1"], columns[f"{kind}2"]])
            for kind in ("q", "tau", "v")
        }
        arrays |= {"dt": DT, "joint_names": np.array(["hip", "knee"])}
    np.savez(tmp_path / "leg.npz", **arrays)
    recording = read_recording(tmp_path / "leg.npz")
    assert_same(recording, columns)
    assert recording.v.shape == (N, 2)
    assert recording.dt == pytest.approx(DT)
    if matrices:
        assert recording.joint_names == ("hip", "knee")


@pytest.mark.parametrize("kind", ["parquet", "feather"])
def test_parquet_and_feather(kind, tmp_path):
    import pandas

    columns = table()
    path = tmp_path / f"arm.{kind}"
    frame = pandas.DataFrame(columns)
    getattr(frame, f"to_{kind}")(path)
    assert_same(read_recording(path), columns)
    frame.loc[0, "q2"] = None
    getattr(frame, f"to_{kind}")(path)
    with pytest.warns(
        UserWarning, match="lack a number, the first in row 1, column 'q"
    ):
        assert read_recording(path).n_samples == N - 1


def test_quoted_numbers(tmp_path):
    columns = table(1)
    path = tmp_path / "arm.csv"
    with path.open("w", newline="") as file:
        writer = csv_module.writer(file, quoting=csv_module.QUOTE_ALL)
        writer.writerow([*columns, "what, where"])
        writer.writerows(zip(*columns.values(), ["run, fast"] * N))
    with pytest.warns(UserWarning, match=r"column\(s\) what, where hold no"):
        assert_same(read_recording(path), columns, nv=1)


# -- columns ---------------------------------------------------------------------------


@pytest.mark.parametrize("pattern", ["{}_{}", "{}[{}]", "{}.{}", "{}({})"])
@pytest.mark.parametrize("first", [0, 1])
def test_spellings_of_joint_numbers(csv, pattern, first):
    columns = table()
    renamed = {"T": columns["t"]}
    for kind in ("q", "tau"):
        for j in (1, 2):
            renamed[pattern.format(kind, j - 1 + first)] = columns[f"{kind}{j}"]
    assert_same(read_recording(csv(renamed, separator=";")), columns)


def test_more_than_nine_joints_are_in_numeric_order(csv):
    columns = table(11)
    order = sorted(columns)  # q1, q10, q11, q2, ...
    recording = read_recording(csv({name: columns[name] for name in order}))
    assert_same(recording, columns, nv=11)


def test_columns_named_after_joints(csv):
    columns = table()
    renamed = {
        "tau_knee": columns["tau2"],
        "q_knee": columns["q2"],
        "q_hip": columns["q1"],
        "tau_hip": columns["tau1"],
        "t": columns["t"],
    }
    recording = read_recording(csv(renamed), joint_names=["hip", "knee"])
    assert_same(recording, columns)
    assert recording.joint_names == ("hip", "knee")
    del renamed["tau_hip"]
    with pytest.raises(ValueError, match=r"arm\.csv: column 'tau_hip' is missing"):
        read_recording(csv(renamed), joint_names=["hip", "knee"])


def test_other_columns_are_signals(csv):
    columns = table(1)
    columns |= {"a1": np.ones(N), "current": np.arange(N), "mode": ["run"] * N}
    columns["volts"] = [24.0] * (N - 1) + [""]
    with pytest.warns(UserWarning, match=r"\(s\) mode, volts hold no finite numbers"):
        recording = read_recording(csv(columns))
    assert set(recording.signals) == {"a", "current"}
    np.testing.assert_array_equal(recording.signals["current"], np.arange(N))


def test_columns_follow_the_joints_of_the_urdf(csv, tmp_path):
    arm = make_robot_recording(duration=1.0, random_state=0)
    columns = {f"q_{name}": x for name, x in zip(arm.joint_names, arm.q.T)}
    columns |= {f"tau_{name}": x for name, x in zip(arm.joint_names, arm.tau.T)}
    shuffled = dict(sorted(columns.items()))
    recording = read_recording(csv(shuffled), dt=arm.dt, urdf=arm.urdf)
    np.testing.assert_allclose(recording.q, arm.q, atol=1e-9)
    assert recording.joint_names == arm.joint_names
    assert recording.robot_model().nv == 6
    # A subset of the joints, numbered in an order unlike the model's.
    last, first = arm.joint_names[4], arm.joint_names[1]
    names = [f"{kind}_{name}" for kind in ("q", "tau") for name in (last, first)]
    path = csv(dict(zip(("q1", "q2", "tau1", "tau2"), map(columns.get, names))))
    keywords = {"dt": arm.dt, "urdf": arm.urdf}
    recording = read_recording(path, **keywords, joint_names=[last, first])
    np.testing.assert_allclose(recording.q, arm.q[:, [1, 4]], atol=1e-9)
    assert tuple(recording.robot_model().names)[1:] == (first, last)
    with pytest.raises(ValueError, match=r"2 column\(s\) q for 6 joint"):
        read_recording(path, **keywords)
    with pytest.raises(ValueError, match="no movable joint 'nose'"):
        read_recording(path, **keywords, joint_names=["nose", last])


# -- errors ----------------------------------------------------------------------------


def drop(name):
    return lambda columns: columns.pop(name)


def put(name, row, value):
    def change(columns):
        columns[name] = np.array(columns[name], dtype=object)
        columns[name][row] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (drop("q2"), "column 'q2' is missing beside q1; every joint needs one"),
        (drop("t"), r"no time: expected a column t \[s\]"),
        (put("tau2", 4, "inf"), "line 6, column 'tau2'"),
        (put("q1", 4, "off"), "'off' in line 6, column 'q1' is not a number"),
        (lambda x: x.update(q_2=x["q2"]), "columns 'q2' and 'q_2' could both be meant"),
        (lambda x: x.update(T=x["q2"]), "columns 't' and 'T' could both be meant"),
        (put("tau2", 4, "1e13"), r"1e\+13 in line 6, column 'tau2', is implausible"),
        (put("tau2", 4, "1_0"), "'1_0' in line 6, column 'tau2' is not a number"),
        (put("tau2", 0, '"1,234.5"'), "write numbers without separators of thousands"),
        (put("t", 7, 0.001), r"time runs backwards to 0\.001 s in line 9"),
    ],
)
def test_bad_cells_and_columns_give_one_line_errors(csv, change, message):
    columns = table()
    change(columns)
    assert re.search(message, str(refusal(csv(columns))))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no rows of data"),
        ("t,q1,tau1\n", "only a header"),
        ("0,1,2\n1,2,3\n", "has no names of columns"),
        ("t,q1,t,tau1,t\n0,1,0,2,0\n", "'t' 3 times; write one header line of"),
        ("t,,tau1\n0,1,2\n", "column 2 has no name in line 1"),
        ("t,q1,tau1\n0,1,2\n0.1,1\n", "line 3 has 2 cells, the header names 3"),
        ("t,q1,tau1\n0,0,1,0,2,0\n", "decimal commas need ;"),
        ("t,q1,tau1\n0,1,\0\n", "is binary, not text"),
        ("t,angle,tau1\n0,1,2\n", "no positions: expected columns q1, q2"),
        ("t,q1,force\n0,1,2\n", "no torques: expected columns tau1, tau2"),
        ("t,q1,q3,tau1\n0,1,2,3\n", "column 'q2' is missing beside q1, q3"),
        ("t,q1,tau1,segment,Segment,SEGMENT\n0,1,2,3,3,3\n", "'segment' and 'Segment'"),
        ("t,q1,tau1,segment\n0,1,2,a\n0,1,2,b\n", "two time stamps or more"),
    ],
)
def test_bad_headers_give_one_line_errors(tmp_path, text, message):
    path = tmp_path / "arm.csv"
    path.write_text(text)
    error = str(refusal(path))
    assert error.startswith(f"{path}: ")
    assert message in error


def test_unreadable_files_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.csv: no such file"):
        read_recording(tmp_path / "none.csv")
    for name, content, message in (
        ("arm.ulg", b"", "unknown ending '.ulg'"),
        ("arm.npz", b"no archive", "is not a complete npz file"),
        ("arm.csv", b"\xff\xfeq", "truncated data"),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            read_recording(path)
    for shape in ((4, 1), (5, 2, 2)):
        np.savez(tmp_path / "short.npz", q=np.zeros((5, 1)), tau=np.zeros(shape))
        message = f"'tau' has the shape {shape}, others have 5 rows"
        with pytest.raises(ValueError, match=re.escape(message)):
            read_recording(tmp_path / "short.npz", dt=DT)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dt": 0.02}, r"steps by 0\.01 s but dt = 0\.02 s"),
        ({"dt": -1}, "dt must be the sample period"),
        ({"joint_names": ["hip"]}, r"2 column\(s\) q for 1 joint"),
        ({"joint_names": ["hip", "hip"]}, "must differ"),
        ({"joint_names": "hip"}, "must be several names"),
    ],
)
def test_contradicting_arguments_are_refused(csv, options, message):
    with pytest.raises(ValueError, match=message):
        read_recording(csv(table()), **options)


# -- time ------------------------------------------------------------------------------


def test_segment_column_separates_recordings(csv):
    columns = table(1)
    columns["segment"] = ["slow"] * 20 + ["fast"] * 25 + ["slow"] * 15
    columns["t"][20:] -= columns["t"][20]  # the clock restarts
    recording = read_recording(csv(columns))
    assert recording.group_names == ("slow", "fast", "slow (2)")
    np.testing.assert_array_equal(np.bincount(recording.groups), [20, 25, 15])
    assert_same(recording, columns, nv=1)
    columns.pop("t")
    columns["segment"] = np.repeat([3, 7, 9], 20)
    recording = read_recording(csv(columns), dt=DT)
    assert recording.group_names == ("3", "7", "9")
    np.testing.assert_allclose(recording.t[20:40], DT * np.arange(20))


@pytest.mark.parametrize("digits", [3, 4, 6])
def test_rounded_stamps_give_a_regular_clock(csv, digits):
    columns = table(1, n=3000, dt=1 / 300)
    columns["t"] = np.round(columns["t"], digits)
    recording, notes = read(csv(columns))
    # Stamps rounded to milliseconds are too coarse; the positions decide.
    assert ["the sampling was regular" in x for x in notes] == [True] * (digits == 3)
    assert recording.dt == pytest.approx(1 / 300, rel=1e-3)
    assert_same(recording, columns, nv=1)


def test_single_missing_samples_are_interpolated_and_gaps_split(csv):
    columns = table(1, n=300)
    keep = np.ones(300, dtype=bool)
    keep[[50, 51, 90]] = False  # bridged
    keep[150:170] = False  # a gap
    keep[173:180] = False  # another: three samples between two gaps
    columns = {name: x[keep] for name, x in columns.items()}
    with pytest.warns(UserWarning, match="arm.csv: ") as caught:
        recording = read_recording(csv(columns))
    text = " ".join(str(w.message) for w in caught)
    assert "2 gap(s) of 5 periods or more in time, the first after line 148" in text
    assert "1 piece(s) of fewer than 16 samples" in text
    assert "3 single sample(s) are missing and were interpolated" in text
    assert "irregular" not in text
    np.testing.assert_array_equal(np.bincount(recording.groups), [150, 120])
    expected = np.r_[np.arange(150), np.arange(180, 300)] * DT
    np.testing.assert_allclose(recording.q[:, 0], np.sin(2 * expected + 1), atol=1e-5)


@pytest.mark.parametrize(
    "nothing", ["", "nan", "NaN", "NA", "null", "None", "-", "#REF!", "-1.#IND00"]
)
@pytest.mark.parametrize("stamped", [True, False])
def test_rows_with_missing_numbers_are_skipped(csv, nothing, stamped):
    columns = table(n=300)
    put("tau2", 40, nothing)(columns)
    put("q1", 90, nothing)(columns)
    full = table(n=300)
    if not stamped:
        del columns["t"]
    with pytest.warns(
        UserWarning, match=r"2 row\(s\) lack a number, the first in line"
    ):
        recording = read_recording(csv(columns), dt=DT)
    assert recording.n_samples == 300
    np.testing.assert_allclose(recording.q[:, 0], full["q1"], atol=1e-5)
    # A column with many missing values is refused.
    for row in range(100, 180):
        put("tau2", row, nothing)(columns)
    with pytest.raises(ValueError, match="nan or nothing in line"):
        read_recording(csv(columns), dt=DT)


def test_velocities_of_some_joints_are_left_out(csv):
    columns = table(n=300)
    drop("v1")(columns)
    recording, notes = read(csv(columns))
    assert (recording.v, len(notes)) == (None, 1)
    assert "column(s) v of some joints only are left out" in notes[0]


def test_rows_of_a_second_source_without_torques_are_skipped(csv):
    columns = table(n=300)
    second = slice(2, None, 3)
    expected = {name: np.delete(x, np.s_[second]) for name, x in columns.items()}
    for j in (1, 2):
        columns[f"tau{j}"][second] = 0.0
    # Only the stamps of the first source are regular.
    late = 0.4 * DT * (np.arange(300) % 3 == 2)
    columns["t"] = 0.5 * DT * (2 * (np.arange(300) // 3) + np.arange(300) % 3) + late
    expected["t"] = np.delete(columns["t"], np.s_[second])
    with pytest.warns(UserWarning, match=r"100 row\(s\) \(33 %\) in which all torques"):
        recording = read_recording(csv(columns))
    assert recording.dt == pytest.approx(0.5 * DT)
    assert_same(recording, expected)
