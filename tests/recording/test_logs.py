"""Logs of other tools: column names, presets, mappings, units and error messages."""

import re
from pathlib import Path

import numpy as np
import pytest

from sklearn_vbjfa.datasets import read_recording
from sklearn_vbjfa.recording import RecordingRefused
from tests.recording._logs import EPOCH, GAINS, KINDS, plain
from tests.recording._reading import read, refusal
from tests.recording.test_reader import assert_same, table, write


def rename(names, columns=None):
    """Return the columns under new names."""
    columns = table() if columns is None else columns
    return {names.get(name, name): x for name, x in columns.items()}


# -- logs of tools ---------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_logs_of_tools_are_recognised(arm, tmp_path, kind):
    recording, notes = read(KINDS[kind](arm, tmp_path), urdf=arm.urdf)
    np.testing.assert_allclose(recording.q, arm.q, atol=2e-9)
    gains = np.array(GAINS) if recording.torque_units[0] == "A" else 1.0
    np.testing.assert_allclose(gains * recording.tau, arm.tau, atol=1e-7)
    assert recording.dt == pytest.approx(arm.dt, rel=1e-5)
    assert recording.joint_names == arm.joint_names
    # Other columns of the tool are not signals.
    assert not recording.signals
    format_notes = [x for x in notes if "taken as" in x or "converted" in x]
    assert len(format_notes) == (kind != "plain CSV")
    assert all("\n" not in x for x in notes)


def test_message_stamps_take_precedence_over_receipt_times(arm, tmp_path):
    """The stamps of the recorder are late, and constant here."""
    path = KINDS["rostopic echo -p"](arm, tmp_path)
    late = re.sub(r"(?m)^\d+(?=,)", str(int(EPOCH * 1e9)), path.read_text())
    path.write_text(late)
    recording, _ = read(path, urdf=arm.urdf)
    assert recording.dt == pytest.approx(arm.dt, rel=1e-5)


def test_currents_need_gains(arm, tmp_path):
    path = KINDS["UR RTDE record"](arm, tmp_path)
    recording, notes = read(path, urdf=arm.urdf)
    assert recording.torque_units == 6 * ("A",)
    assert "the torques are recorded in A: give the gains" in notes[-1]
    _, notes = read(path, urdf=arm.urdf, gains="unknown")
    assert not any("recorded in A" in x for x in notes)
    recording, notes = read(path, urdf=arm.urdf, gains=GAINS)
    assert recording.torque_units == 6 * ("N m",)
    np.testing.assert_allclose(recording.tau, arm.tau, atol=1e-7)
    with pytest.raises(ValueError, match=r"2 gain\(s\) for 6 joint\(s\) \(joint_1"):
        read_recording(path, urdf=arm.urdf, gains=(8, 8))
    one, six = (read(path, urdf=arm.urdf, gains=n * (8,))[0].tau for n in (1, 6))
    np.testing.assert_array_equal(one, six)


def test_torques_are_preferred_to_currents(arm, tmp_path):
    path = KINDS["UR RTDE record"](arm, tmp_path)
    header, rows = path.read_text().split("\n", 1)
    names = " ".join(f"actual_current_as_torque_{k}" for k in range(6))
    more = [f"{row} 1 2 3 4 5 6" for row in rows.strip().split("\n")]
    path.write_text("\n".join([f"{header} {names}", *more]))
    recording, _ = read(path, urdf=arm.urdf)
    assert recording.torque_units == 6 * ("N m",)
    np.testing.assert_array_equal(recording.tau[0], np.arange(1, 7))


def test_unrecorded_joints_are_held_at_zero(arm, tmp_path):
    path = KINDS["PlotJuggler"](arm, tmp_path)
    path.write_text(path.read_text().replace("joint_5/", "sensor/"))
    recording, notes = read(path, urdf=arm.urdf)
    assert recording.joint_names == tuple(f"joint_{k}" for k in (1, 2, 3, 4, 6))
    np.testing.assert_allclose(recording.q, arm.q[:, [0, 1, 2, 3, 5]], atol=2e-9)
    text = " ".join(notes)
    assert "joint(s) sensor are not joints of the robot and are left out" in text
    assert "no columns of joint(s) joint_5: held at zero" in text
    path.write_text(path.read_text().replace("sensor/", "Joint_5/"))
    text = " ".join(read(path, urdf=arm.urdf)[1])
    assert "joint_5 (upper and lower case differ in " in text
    assert recording.robot_model().nv == 5
    with pytest.raises(ValueError, match="column 'q_joint_5' is missing"):
        read(path, urdf=arm.urdf, joint_names=["joint_4", "joint_5"])


def test_error_offers_a_mapping_for_differing_joint_names(arm, tmp_path):
    path = KINDS["PlotJuggler"](arm, tmp_path)
    path.write_text(path.read_text().replace("joint_", "axis_"))
    message, recording = read_with_offered_options(path, urdf=arm.urdf)
    assert "q=/axis_states/axis_{i}/position" in message
    np.testing.assert_allclose(recording.q, arm.q, atol=2e-9)


def test_error_offers_a_mapping_for_numbered_joint_names(arm, tmp_path):
    path = KINDS["PlotJuggler"](arm, tmp_path)
    text = path.read_text().replace("/joint_states/joint_", "joint")
    path.write_text(text.replace("/", "_of_"))
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(Path(arm.urdf).read_text().replace("joint_", "joint"))
    message, recording = read_with_offered_options(path, urdf=urdf)
    assert "q={joint}" in message
    np.testing.assert_allclose(recording.q, arm.q, atol=2e-9)


def test_rows_of_other_topics_are_skipped(arm, tmp_path):
    path = KINDS["PlotJuggler"](arm, tmp_path)
    lines = path.read_text().split("\n")
    lines[0] += ",/temperature/data"
    lines[1:-1] = [f"{line}," for line in lines[1:-1]]
    blank = "," * 14
    lines[5:5] = [f"{EPOCH:.6f}{blank}21.5", f"{EPOCH + 1:.6f}{blank}22"]
    path.write_text("\n".join(lines))
    recording, notes = read(path, urdf=arm.urdf)
    np.testing.assert_allclose(recording.q, arm.q, atol=2e-9)
    assert any("2 row(s) lack a number" in x for x in notes)


# -- presets ---------------------------------------------------------------------------


@pytest.mark.parametrize("preset", ["ros", "ur"])
def test_preset_selects_the_column_names_of_a_tool(preset, tmp_path):
    names = {"t": "timestamp"}
    for j in (1, 2):
        names |= {f"q{j}": f"actual_q_{j}", f"tau{j}": f"actual_current_{j}"}
    columns = rename(names)
    columns |= {f"position_{j}": columns[f"v{j}"] for j in (1, 2)}
    columns |= {f"effort_{j}": columns[f"v{j}"] for j in (1, 2)}
    columns["Time"] = columns["timestamp"]
    path = write(tmp_path / "both.csv", columns)
    recording, _ = read(path, preset=preset)
    name = {"ur": "q1", "ros": "v1"}[preset]
    np.testing.assert_allclose(recording.q[:, 0], table()[name], atol=1e-9)


# -- mappings --------------------------------------------------------------------------


@pytest.mark.parametrize("first", [0, 1])
def test_mapping_indices_start_at_0_or_1(tmp_path, first):
    columns = table()
    names = {"t": "clock"}
    for j in (1, 2):
        names |= {f"q{j}": f"ang-{j - 1 + first}", f"tau{j}": f"M{j - 1 + first}x"}
    path = write(tmp_path / "arm.csv", rename(names))
    recording, _ = read(path, columns="q=ang-{i},tau=M{i}x,t=clock")
    assert_same(recording, columns)
    assert recording.dt == pytest.approx(0.01)
    mapping = {"q": "ang-{i}", "tau": "M{i}x", "t": "clock"}
    again, _ = read(path, columns=mapping)
    np.testing.assert_array_equal(again.q, recording.q)


def test_mapping_by_joint_name(tmp_path):
    names = {"q2": "knee.pos", "q1": "hip.pos", "tau1": "hip.load", "tau2": "knee.load"}
    columns = table()
    del columns["v2"]
    path = write(tmp_path / "arm.csv", rename(names | {"v1": "foot.pos"}, columns))
    options = {"joint_names": ["hip", "knee"]}
    recording, notes = read(path, columns="q={joint}.pos,tau={joint}.load", **options)
    assert_same(recording, columns)
    assert any("joint(s) foot are not joints of the robot" in x for x in notes)
    single = "q_hip=hip.pos,q2=knee.pos,tau=hip.load"
    with pytest.raises(ValueError, match="column 'q_knee' is missing"):
        read(path, columns=single, **options)


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ("q=q{i},tau=q{i}", "columns names column 'q1' twice; rename or remove"),
        ("q=q{i},q=v{i}", r"columns has 'q=v\{i\}'; expected CHANNEL=NAME, each"),
        ("torque=tau{i}", "columns has 'torque=tau.*Channels are q, tau, v"),
        ("q", "columns has 'q='; expected CHANNEL=NAME"),
        ("q=angle{i}", r"no column angle\{i\}, which columns asks for; found t, q1"),
    ],
)
def test_invalid_mappings_are_refused(tmp_path, mapping, message):
    path = write(tmp_path / "arm.csv", table())
    with pytest.raises(ValueError, match=message) as caught:
        read_recording(path, columns=mapping)
    assert "\n" not in str(caught.value)


# -- missing channels ------------------------------------------------------------------

UNKNOWN_NAMES = [
    {"t": "ts_ms", "q": "joint_pos_{}", "tau": "motorTorque{}"},
    {"t": "time", "q": "axis{}.position", "tau": "axis{}.current"},
    {"t": "t", "q": "meas_angle[{}]", "tau": "meas_effort[{}]"},
    {"t": "time", "q": "axisQMsr{}", "tau": "measuredTorque{}"},
    {"t": "ms", "q": "ax{}_pos", "tau": "ax{}_cur"},
    {"t": "stamps", "q": "ax{}_pos", "tau": "ax{}_cur"},
    {"t": "t", "q": "q_deg{} [deg]", "tau": "torque_mNm{} [mNm]"},
]


@pytest.mark.parametrize("names", UNKNOWN_NAMES)
def test_error_offers_options_that_work(tmp_path, names):
    columns = table()
    scale = 1e3 if names["t"].endswith(("ms", "stamps")) else 1.0
    renamed = {names["t"]: scale * columns["t"], "cmd_pos_1": columns["v1"]}
    for j in (1, 2):
        units = (180 / np.pi, 1e3) if "deg" in names["q"] else (1.0, 1.0)
        renamed[names["q"].format(j).split()[0]] = units[0] * columns[f"q{j}"]
        renamed[names["tau"].format(j).split()[0]] = units[1] * columns[f"tau{j}"]
    path = write(tmp_path / "arm.csv", renamed, separator=";")
    with pytest.raises(RecordingRefused) as caught:
        read_recording(path)
    text = str(caught.value)
    assert "no positions: expected" in text
    assert "no torques: expected" in text
    assert f"nearest: {names['q'].format('{i}')}" in text
    assert "try columns=" in text
    assert "\n" not in text
    assert ("gains" in caught.value.options) == ("cur" in names["tau"])
    recording, _ = read(path, **caught.value.options)
    assert_same(recording, columns)
    assert recording.dt == pytest.approx(0.01)


def test_periodic_columns_do_not_number_joints(tmp_path):
    columns = rename({"q1": "a1", "q2": "a2", "tau1": "b1", "tau2": "b2"})
    rows = np.arange(columns.pop("t").size) % 20
    path = write(tmp_path / "arm.csv", columns | {"part": 50 * rows})
    assert "no positions: expected" in str(refusal(path))
    path = write(path, columns | {"count": rows})
    assert "no time: expected" in str(refusal(path, columns="q=a{i},tau=b{i}"))


def test_commanded_positions_give_a_warning(tmp_path):
    columns = rename({"q1": "axisQCmd1", "q2": "axisQCmd2"})
    path = write(tmp_path / "arm.log", columns)
    recording, notes = read(path, columns="q=axisQCmd{i}")
    assert_same(recording, table())
    assert any("'axisQCmd1' seems to be commanded" in x for x in notes)


# -- units -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "pattern", ["{} [{}]", "{} ({})", "{}[{}]", "{}_{}", "{} / {}"]
)
def test_units_in_column_names(tmp_path, pattern):
    columns = table()
    scaled = {pattern.format("t", "ms"): 1e3 * columns["t"]}
    for j in (1, 2):
        scaled[pattern.format(f"q{j}", "deg")] = np.rad2deg(columns[f"q{j}"])
        scaled[pattern.format(f"v{j}", "rpm")] = columns[f"v{j}"] * 30 / np.pi
        scaled[pattern.format(f"tau{j}", "mNm")] = 1e3 * columns[f"tau{j}"]
    recording, notes = read(write(tmp_path / "arm.csv", scaled, separator=";"))
    assert_same(recording, columns, atol=1e-8)
    np.testing.assert_allclose(recording.v[:, 0], columns["v1"], atol=1e-8)
    assert recording.dt == pytest.approx(0.01)
    assert any("converted from deg, mNm, rpm" in x for x in notes)


def test_units_of_a_prismatic_joint(tmp_path):
    columns = table(1)
    scaled = {"t_us": 1e6 * columns["t"], "q1 [mm]": 1e3 * columns["q1"]}
    scaled["tau1 [kN]"] = 1e-3 * columns["tau1"]
    recording, _ = read(write(tmp_path / "slide.csv", scaled))
    assert_same(recording, columns, nv=1, atol=1e-8)
    assert recording.position_units == ("m",)
    assert recording.torque_units == ("N",)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("q1 [furlong]", r"column 'q1 \[furlong\]' is in 'furlong', which is not a"),
        ("q1 [mm]", r"column 'q1 \[mm\]' is in mm, but joint_1 turns; expected rad"),
        (
            "tau1 [kN]",
            r"column 'tau1 \[kN\]' is in kN, but joint_1 turns; expected N m",
        ),
        ("t [weeks]", "not a known unit of t; expected s, ms, us or ns"),
    ],
)
def test_invalid_units_are_refused(arm, tmp_path, name, message):
    path = plain(arm, tmp_path)
    bare = name.partition(" ")[0]
    text = path.read_text()
    pattern = rf"(^|,){bare},"
    path.write_text(re.sub(pattern, lambda m: f"{m[1]}{name},", text, count=1))
    with pytest.raises(ValueError, match=message):
        read_recording(path, urdf=arm.urdf)


@pytest.mark.parametrize(
    ("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9), ("days", 1 / 86400)]
)
def test_time_unit_option(tmp_path, unit, factor):
    columns = table()
    columns["t"] = factor * columns["t"]
    path = write(tmp_path / "arm.csv", columns)
    with pytest.raises(
        ValueError, match=f"in {unit} this would .*try time_unit='{unit}'"
    ):
        read_recording(path)
    recording, _ = read(path, time_unit=unit)
    assert recording.dt == pytest.approx(0.01)
    with pytest.raises(ValueError, match="time_unit must be one of s, ms, us, ns"):
        read_recording(path, time_unit="h")


@pytest.mark.parametrize("unit", [None, "ms"])
def test_a_time_unit_is_offered_only_if_it_fits_all_files(tmp_path, unit):
    columns = table() | {"t": 1e3 * table()["t"]}
    paths = [write(tmp_path / "a.csv", table()), write(tmp_path / "b.csv", columns)]
    with pytest.raises(RecordingRefused, match="other files are not so") as refused:
        read_recording(paths, time_unit=unit)
    assert not refused.value.options
    paths[0] = write(tmp_path / "c.csv", columns)
    with pytest.raises(RecordingRefused, match="time_unit='ms'"):
        read_recording(paths[::-1])
    # A file that is readable in no unit gets its own message.
    whole = paths[0].read_text()
    named = whole.replace("tau", "b")
    for text, reason in [("", "is empty"), (whole[:99], "line 3"), (named, "no tor")]:
        paths[0].write_text(text)
        with pytest.raises(ValueError, match=f"c.csv: .*{reason}"):
            read_recording(paths[::-1])


@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
@pytest.mark.parametrize("mark", ["T", " "])
def test_iso_time_stamps(tmp_path, mark, zone):
    columns = table()
    # The stamps cross midnight.
    stamps = np.datetime64("2026-11-22T23:59:59.9", "ns") + np.round(
        1e9 * columns["t"]
    ).astype("m8[ns]")
    text = [f"{x}".replace("T", mark)[:26] + zone for x in stamps]
    path = write(tmp_path / "arm.csv", {**columns, "t": text})
    recording, _ = read(path)
    assert recording.dt == pytest.approx(0.01)
    text[7] = "later"
    path = write(tmp_path / "arm.csv", {**columns, "t": text})
    with pytest.raises(ValueError, match=r"column 't' holds .* expected seconds"):
        read_recording(path)


def test_times_of_day_may_cross_midnight(tmp_path):
    columns = table()
    t = 86399.9 + columns["t"]
    text = [
        f"{int(x // 3600) % 24:02}:{int(x // 60) % 60:02}:{x % 60:07.4f}" for x in t
    ]
    recording, notes = read(write(tmp_path / "arm.csv", {**columns, "t": text}))
    assert_same(recording, columns)
    assert recording.dt == pytest.approx(0.01)
    assert not notes


def test_ambiguous_time_columns_need_a_choice(tmp_path):
    columns = table()
    renamed = {"time": columns["t"], "timestamp": 5 * columns["t"]}
    renamed |= {name: x for name, x in columns.items() if name != "t"}
    path = write(tmp_path / "arm.csv", renamed)
    with pytest.raises(RecordingRefused, match="could all be time") as caught:
        read_recording(path)
    recording, _ = read(path, **caught.value.options)
    assert recording.dt == pytest.approx(0.01)
    # With a sample period, the columns of time are plain signals.
    recording, _ = read(path, dt=0.01)
    assert set(recording.signals) == {"time", "timestamp"}


def test_joints_named_like_units(tmp_path):
    columns = table()
    new = {"t": columns["t"]}
    for j, name in ((1, "m"), (2, "deg")):
        new |= {f"q_{name}": columns[f"q{j}"], f"tau[{name}]": columns[f"tau{j}"]}
    path = write(tmp_path / "arm.csv", new)
    assert_same(read(path, joint_names=["m", "deg"])[0], columns)


# -- options that error messages offer -------------------------------------------------


def read_with_offered_options(path, **options):
    """Read a file with the options offered by its error; return message, recording."""
    with pytest.raises(RecordingRefused) as caught:
        read_recording(path, **options)
    assert caught.value.options, str(caught.value)
    for name in caught.value.options:
        assert f"{name}=" in str(caught.value)
    return str(caught.value), read(path, **options | caught.value.options)[0]


@pytest.mark.parametrize("name", ["i{}", "current{}", "motor_amps_{}"])
def test_columns_named_like_currents_are_read_as_currents(name, tmp_path):
    path = write(
        tmp_path / "arm.csv", rename({f"tau{k}": name.format(k) for k in (1, 2)})
    )
    mapping = f"tau={name.format('{i}')}"
    message, recording = read_with_offered_options(path)
    assert f"columns='{mapping}', gains='unknown'" in message
    assert recording.torque_units == ("A", "A")
    with pytest.warns(UserWarning, match="recorded in A: give the gains"):
        read_recording(path, columns=mapping)
    # A unit in the mapping takes precedence.
    labelled = read_recording(path, columns=f"{mapping} [Nm]")
    assert labelled.torque_units == ("N m", "N m")


# -- values and rows that are not samples ----------------------------------------------


def test_sentinel_values_are_treated_as_missing(tmp_path):
    columns = table(n=400)
    columns["tau1"] = columns["tau1"].copy()
    columns["tau1"][[7, 90, 91, 300]] = -999.0
    recording, notes = read(write(tmp_path / "arm.csv", columns))
    assert np.abs(recording.tau).max() < 100
    assert any("-999 in column 'tau1'" in line for line in notes)


def _as_12_bit_codes(columns):
    counts = np.round(columns["tau1"] / np.abs(columns["tau1"]).max() * 400)
    return columns | {"tau1": counts % 4096}


def _as_scaled_codes(columns):
    return columns | {"tau1": _as_12_bit_codes(columns)["tau1"] / 10}


@pytest.mark.parametrize(
    ("late", "dt"),
    [((0.002,), None), ((0.005,), None), ((0.002, 0.005), None), ((0.0,), 0.01)],
)
def test_rows_of_robots_in_turn_are_refused_with_any_stamps(tmp_path, late, dt):
    columns = table(n=400)
    others = [columns | {"t": columns["t"] + x} for x in late]
    for k, other in enumerate(others):
        other |= {f"q{j}": 1.0 - 0.4 * k - columns[f"q{j}"] for j in (1, 2)}
    rows = {
        k: np.column_stack([x, *(y[k] for y in others)]) for k, x in columns.items()
    }
    rows = {name: values.ravel() for name, values in rows.items()}
    with pytest.raises(ValueError, match="rows of several robots in turn"):
        read_recording(write(tmp_path / "arm.csv", rows), dt=dt)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_as_12_bit_codes, "subtract 4096 from those from 2048 on"),
        (_as_scaled_codes, r"subtract 409\.6 from those from 204\.8 on"),
    ],
)
def test_wrapped_codes_are_refused(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        read_recording(write(tmp_path / "arm.csv", change(table(n=400))), dt=0.01)


@pytest.mark.filterwarnings("error")
def test_an_empty_column_is_refused_without_a_warning(tmp_path):
    empty = table(n=100) | {"tau2": ["" for _ in range(100)]}
    with pytest.raises(ValueError, match="column 'tau2'"):
        read_recording(write(tmp_path / "arm.csv", empty))
