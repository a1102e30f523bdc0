"""Tables of other tools: title lines, an index column, no header, mixed units."""

import re

import numpy as np
import pytest

from sklearn_vbjfa.datasets import read_recording
from sklearn_vbjfa.recording import RecordingRefused
from tests.model._shaped import joint, link
from tests.model._shaped import write as write_robot
from tests.recording._logs import KINDS
from tests.recording._reading import read
from tests.recording.test_reader import DT, assert_same, table, write


def assert_table(recording):
    assert_same(recording, table(), atol=1e-8)
    assert recording.dt == pytest.approx(DT)


@pytest.fixture
def urdf(tmp_path):
    return write_robot(
        tmp_path,
        *map(link, ("base", "l1", "l2")),
        joint("shoulder", "base", "l1", axis="0 1 0"),
        joint("lift", "l1", "l2", kind="prismatic"),
    )


def table_lines(separator=","):
    """Lines of the table, the header first."""
    columns = {name: table()[name] for name in ("t", "q1", "q2", "tau1", "tau2")}
    lines = [separator.join(columns)]
    return lines + [
        separator.join(f"{x:.10g}" for x in row) for row in zip(*columns.values())
    ]


@pytest.mark.parametrize(
    "titles",
    [
        ["Scope Project"],
        ["Name,Scope 3", "Date,2024-05-01", ""],
        ["one,two,three", "4 words,of,it"],
    ],
)
def test_title_lines_above_the_header(titles, tmp_path):
    lines = table_lines()
    path = tmp_path / "arm.csv"
    path.write_text("\n".join([*titles, *lines, ""]))
    recording, notes = read(path)
    assert_table(recording)
    assert f"the names of the columns are in line {len(titles) + 1}." in notes[-1]
    # Line numbers in messages refer to the file.
    first = len(titles) + 2
    lines[2] = lines[2].replace(",", ",off", 1)
    path.write_text("\n".join([*titles, *lines, ""]))
    with pytest.raises(ValueError, match=rf"'off.*in line {first + 1}, column 'q1'"):
        read(path)


def test_row_of_units_below_the_header(tmp_path):
    header, *lines = table_lines(";")
    units = "[ms];[deg];rad;mNm;Nm"
    scaled = []
    for line in lines:
        t, q, *others = map(float, line.split(";"))
        row = (1e3 * t, np.rad2deg(q), others[0], 1e3 * others[1], others[2])
        scaled.append(";".join(f"{x:.10g}" for x in row))
    path = tmp_path / "arm.csv"
    path.write_text("\n".join(["Export 7", header, units, *scaled, ""]))
    recording, notes = read(path)
    assert_table(recording)
    assert any("converted from deg, mNm" in x for x in notes)


def test_index_column_of_a_data_frame(tmp_path):
    path = tmp_path / "arm.csv"
    header, *lines = table_lines()
    numbered = [f"{k},{line}" for k, line in enumerate(lines)]
    path.write_text("\n".join([f",{header}", *numbered, ""]))
    recording, notes = read(path)
    assert_table(recording)
    assert not recording.signals
    assert "the first column has no name and counts the rows" in notes[-1]
    # A column that does not number the rows needs a name.
    path.write_text("\n".join([f",{header}", *(f"7,{line}" for line in lines)]))
    with pytest.raises(ValueError, match="column 1 has no name in line 1; name it"):
        read(path)
    path.write_text("\n".join([header.replace(",q2", ",", 1), *lines]))
    with pytest.raises(ValueError, match="column 3 has no name in line 1"):
        read(path)


def test_joint_names_must_not_change_between_rows(arm, tmp_path):
    path = KINDS["ros2 topic echo --csv"](arm, tmp_path)
    _, notes = read(path, urdf=arm.urdf)
    assert "/joint_states as a table: q = position_5 ... position_0" in notes[0]
    lines = path.read_text().splitlines()
    lines[::2] = [re.sub("(joint_.),(joint_.)", r"\2,\1", x) for x in lines[::2]]
    path.write_text("\n".join(lines))
    with pytest.raises(ValueError, match="names of the joints change from row to row"):
        read(path)


def test_units_may_differ_between_joints(tmp_path, urdf):
    columns = table()
    renamed = {
        "time [ms]": 1e3 * columns["t"],
        "shoulder.ActPos [deg]": np.rad2deg(columns["q1"]),
        "lift.ActPos [mm]": 1e3 * columns["q2"],
        "shoulder.ActTorque [mNm]": 1e3 * columns["tau1"],
        "lift.ActTorque [N]": columns["tau2"],
    }
    path = write(tmp_path / "arm.csv", renamed)
    with pytest.raises(RecordingRefused) as caught:
        read_recording(path, urdf=urdf)
    assert caught.value.options == {"columns": "q={joint}.ActPos,tau={joint}.ActTorque"}
    recording, _ = read(path, urdf=urdf, **caught.value.options)
    assert_table(recording)
    assert recording.torque_units == ("N m", "N")


def test_per_mille_is_a_tenth_of_per_cent(tmp_path):
    t = 0.01 * np.arange(100)
    torques = []
    for unit, share in (("%", 1.0), ("‰", 10.0), ("permille", 10.0)):
        path = tmp_path / "x.csv"
        data = np.column_stack([t, np.sin(t), share * (3 + np.cos(t))])
        head = f"t,q1,tau1 [{unit}]"
        np.savetxt(path, data, delimiter=",", header=head, comments="", encoding="utf8")
        torques.append(read_recording(path, gains=[2.0]).tau[:, 0])
    for tau in torques:
        np.testing.assert_allclose(tau, 2.0 * (3 + np.cos(t)), rtol=1e-12)
