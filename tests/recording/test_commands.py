"""Logs of position-controlled robots: command channels by name and by tool."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa.recording import PDDrive, RecordingRefused, parse_drive
from tests.model import _shaped
from tests.recording._lerobot import write_lerobot
from tests.recording._reading import read_text as read
from tests.recording.test_reader import DT, N, write

KP, KD = (20.0, 40.0), (1.0, 2.0)
TEXT = "pd kp=20,40 kd=1,2"
LEGS = ("FR", "FL", "RR", "RL")
MOTORS = ("hip", "thigh", "calf")


def motion(nv=2, n=N, t=None):
    """Return times, positions and commanded positions."""
    t = DT * np.arange(n) if t is None else t
    phases = np.arange(nv)
    q = 0.5 * np.sin(2 * t[:, None] + phases)
    aim = 0.6 * np.sin(2 * t[:, None] + phases + 0.1)
    return t, q, aim


def table(q="q{}", aim="q_desired{}", nv=2, **more):
    """Return the columns of a recording, numbered from one."""
    t, position, command = motion(nv)
    channels = {"t": t}
    channels |= {q.format(j + 1): position[:, j] for j in range(nv)}
    channels |= {aim.format(j + 1): command[:, j] for j in range(nv)}
    return channels | more


def law(recording, kp=KP, kd=KD):
    """Return the PD torque with numerical velocities and commands held for a row."""
    slope = np.gradient(recording.q, recording.dt, axis=0)
    aim = recording.signals["q_desired"]
    held = 0.5 * (aim + np.roll(aim, 1, axis=0))
    return kp * (held - recording.q) - kd * slope


def assert_motion(recording, nv=2):
    _, q, aim = motion(nv)
    assert_allclose(recording.q, q, atol=1e-9)
    assert_allclose(recording.signals["q_desired"], aim, atol=1e-9)


# -- names -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["q_desired_{}", "q_desired[{}]", "Q_Des{}", "position_command_{}"]
)
def test_commands_are_recognised_by_their_names(name, tmp_path):
    path = write(tmp_path / "arm.csv", table(aim=name))
    recording, notes = read(path, drive=TEXT)
    assert_motion(recording)
    assert_allclose(recording.tau[3:-3], law(recording)[3:-3], atol=1e-2)
    assert recording.command is not None
    assert "no desired velocities (v_desired): taken as zero" in notes
    assert ("q_desired = " in notes) == (not name.startswith("q_desired"))


def test_all_drive_channels_are_read(tmp_path):
    rng = np.random.default_rng(0)
    extra = {}
    for kind in ("v", "v_desired_", "tau_ff_", "kp_", "kd_"):
        extra |= {f"{kind}{j}": rng.uniform(1.0, 2.0, N) for j in (1, 2)}
    path = write(tmp_path / "arm.csv", table(**extra, motor=np.arange(N) % 7))
    recording, said = read(path, drive="pd")
    signals = recording.signals
    assert set(signals) == {"q_desired", "v_desired", "tau_ff", "kp", "kd", "motor"}
    command = signals["kp"] * signals["q_desired"] + signals["tau_ff"]
    command += signals["kd"] * signals["v_desired"]
    assert_allclose(PDDrive().commands(recording), command, atol=1e-9)
    assert_allclose(recording.v[:, 0], extra["v1"], atol=1e-9)
    assert "v_desired" not in said


def test_torques_are_skipped_if_a_drive_is_given(tmp_path):
    torques = {f"tau{j}": np.ones(N) for j in (1, 2)}
    path = write(tmp_path / "arm.csv", table(**torques))
    recording, _ = read(path, drive=TEXT)
    assert set(recording.signals) == {"q_desired"}
    # Without a drive, torques are read, and desired positions are plain signals.
    plain, _ = read(path)
    assert_array_equal(plain.tau, 1.0)
    assert set(plain.signals) == {"q_desired1", "q_desired2"}


def test_qd_is_ambiguous(tmp_path):
    path = write(tmp_path / "a.csv", table(aim="qd_{}"))
    with pytest.raises(RecordingRefused, match="no desired positions: expected"):
        read(path, drive=TEXT)
    recording, _ = read(path, drive=TEXT, columns="q_desired=qd_{i}")
    assert_motion(recording)


def test_mapping_of_commands(tmp_path):
    path = write(tmp_path / "a.csv", table(q="angle_{}", aim="wish_{}"))
    mapping = "q=angle_{i},q_desired=wish_{i},t=t"
    recording, _ = read(path, columns=mapping, drive=PDDrive(KP, KD))
    assert_motion(recording)
    with pytest.raises(RecordingRefused) as refused:
        read(write(tmp_path / "b.csv", table(q="pos_{}", aim="cmd_pos_{}")), drive=TEXT)
    options = {"columns": "q=pos_{i},q_desired=cmd_pos_{i}"}
    assert refused.value.options == options
    assert_motion(read(tmp_path / "b.csv", drive=TEXT, **options)[0])


def test_commands_default_to_the_unit_of_the_positions(tmp_path):
    t, q, aim = motion()
    columns = {"t": t} | {f"q{j + 1} [deg]": np.degrees(q[:, j]) for j in (0, 1)}
    columns |= {"q_desired1": np.degrees(aim[:, 0]), "q_desired2 [rad]": aim[:, 1]}
    assert_motion(read(write(tmp_path / "a.csv", columns), drive=TEXT)[0])


@pytest.mark.parametrize("ending", ["npz", "json"])
def test_matrices_with_one_gain_per_joint(ending, tmp_path):
    t, q, aim = motion()
    arrays = {"t": t, "q": q, "q_desired": aim, "v_desired": 0 * q}
    arrays |= {"kp": np.array(KP), "kd": np.array(KD)}
    path = tmp_path / f"arm.{ending}"
    if ending == "npz":
        np.savez(path, **arrays)
    else:
        path.write_text(json.dumps({name: x.tolist() for name, x in arrays.items()}))
    with pytest.raises(RecordingRefused, match="give the drive, drive=") as refused:
        read(path)
    assert refused.value.options == {"drive": "pd"}
    recording, _ = read(path, drive="pd")
    assert_motion(recording)
    assert_array_equal(recording.signals["kp"], [KP] * N)
    assert_allclose(recording.tau[3:-3], law(recording)[3:-3], atol=1e-2)


def test_several_files_are_joined_to_one_recording(tmp_path):
    t, q, aim = motion(n=2 * N)
    second = {"t": t[:N], "q1": q[N:, 0], "q2": q[N:, 1]}
    second |= {"q_desired1": aim[N:, 0], "q_desired2": aim[N:, 1]}
    tables = {"a": table(), "b": second}
    paths = [write(tmp_path / f"{name}.csv", x) for name, x in tables.items()]
    joined, _ = read(paths, drive=TEXT)
    alone = [read(path, drive=TEXT)[0] for path in paths]
    for name in ("tau", "command"):
        parts = [getattr(recording, name) for recording in alone]
        assert_allclose(getattr(joined, name), np.concatenate(parts), atol=1e-12)


# -- time ------------------------------------------------------------------------------


def test_commands_are_held_over_missing_rows(tmp_path):
    t, q, _ = motion(n=200)
    steps = np.repeat(np.arange(20.0), 10)[:, None] * [0.01, 0.02]
    kept = np.delete(np.arange(200), [55, 101])
    columns = {"t": t[kept], "q1": q[kept, 0], "q2": q[kept, 1]}
    columns |= {"q_desired1": steps[kept, 0], "q_desired2": steps[kept, 1]}
    recording, notes = read(write(tmp_path / "a.csv", columns), drive=TEXT)
    assert "2 single sample(s) are missing" in notes
    assert recording.n_samples == 200
    # Commands are held at recorded levels and not interpolated.
    assert_allclose(recording.signals["q_desired"], steps, atol=1e-12)
    assert recording.torque_noise is None


# -- Unitree ---------------------------------------------------------------------------


def unitree(n=N, motors=12, places=20):
    """Return messages with motors numbered as in the SDK; unused places are zero."""
    t, q, aim = motion(motors, n)
    messages = []
    for k in range(n):
        state = [
            {"mode": 1, "q": q[k, j], "dq": 0.1 * j, "tau_est": 9.0, "temperature": 30}
            for j in range(motors)
        ]
        state += [dict.fromkeys(state[0], 0.0)] * (places - motors)
        command = [
            {"mode": 1, "q": aim[k, j], "dq": 0.0, "tau": 0.5, "kp": 20.0, "kd": 1.0}
            for j in range(motors)
        ]
        command += [dict.fromkeys(command[0], 0.0)] * (places - motors)
        messages.append((t[k], state, command))
    return messages


def json_lines(path):
    lines = [
        {
            "t": t,
            "low_state": {"tick": round(1e3 * t), "motor_state": state},
            "low_cmd": {"motor_cmd": command},
        }
        for t, state, command in unitree()
    ]
    path = path.with_suffix(".jsonl")
    path.write_text("\n".join(map(json.dumps, lines)))
    return path


def plotjuggler_table(path, state, command, renamed=None):
    """Write a table with column names made of motor number and channel."""
    renamed = renamed or {}
    columns = {"t": [t for t, *_ in unitree()]}
    for k, pattern in ((1, state), (2, command)):
        for j in range(20):
            for name in unitree()[0][k][j]:
                cells = [float(row[k][j][name]) for row in unitree()]
                columns[pattern.format(j, renamed.get(name, name))] = cells
    return write(path.with_suffix(".csv"), columns)


OLD = {"kp": "Kp", "kd": "Kd", "tau_est": "tauEst"}
LOGS = {
    "lines": json_lines,
    "PlotJuggler": lambda path: plotjuggler_table(
        path, "/lowstate/motor_state[{}]/{}", "/lowcmd/motor_cmd[{}]/{}"
    ),
    "legged": lambda path: plotjuggler_table(
        path, "state.motorState[{}].{}", "motorCmd[{}].{}", OLD
    ),
}


def quadruped(folder):
    """Write a robot whose legs are not in the order of its motors."""
    names = [f"{leg}_{m}" for leg in ("FL", "FR", "RL", "RR") for m in MOTORS]
    joints = (_shaped.joint(f"{name}_joint", "base", name) for name in names)
    return _shaped.write(
        folder, '<link name="base"/>', *map(_shaped.link, names), *joints
    )


@pytest.mark.parametrize("kind", LOGS)
def test_unitree_logs(kind, tmp_path):
    urdf = quadruped(tmp_path)
    recording, notes = read(LOGS[kind](tmp_path / "log"), urdf=urdf, drive="pd")
    assert "taken as motor states and commands of a Unitree robot" in notes
    names = recording.joint_names
    # Motor numbers start with the right front leg.
    _, q, aim = motion(12)
    numbered = [f"{leg}_{m}_joint" for leg in LEGS for m in MOTORS]
    order = [numbered.index(name) for name in names]
    assert_allclose(recording.q, q[:, order], atol=1e-9)
    assert_allclose(recording.v, [0.1 * np.array(order)] * N, atol=1e-9)
    commands = PDDrive().commands(recording)
    assert_allclose(commands, (20.0 * aim + 0.5)[:, order], atol=1e-8)
    assert set(recording.signals) == {"q_desired", "v_desired", "tau_ff", "kp", "kd"}
    # Without a drive, the torques estimated by the motors are read.
    plain, _ = read(LOGS[kind](tmp_path / "log"), urdf=urdf)
    assert_array_equal(plain.tau, 9.0)


# -- LeRobot ---------------------------------------------------------------------------


def test_a_lerobot_data_set_of_servos(tmp_path):
    _, q, aim = motion()
    values = {"action": aim, "observation.state": q}
    info = {"codebase_version": "v3.0", "robot_type": "so101_follower"}
    names = ["shoulder_pan.pos", "gripper.pos"]
    folder = write_lerobot(tmp_path / "set", names, values, ["file-000"], **info)
    recording, notes = read(folder, drive=TEXT)
    assert_motion(recording)
    assert recording.joint_names == ("shoulder_pan", "gripper")
    assert recording.group_names == ("0", "1")
    assert set(recording.signals) == {"q_desired"}
    assert "q_desired = action.shoulder_pan ... action.gripper" in notes


# -- drives from strings ---------------------------------------------------------------


def test_parse_drive():
    text = "pd kp=hip:20,calf:40 kd=1,2.5 delay=0.01 saturation=9"
    assert parse_drive(text).get_params() == {
        **PDDrive().get_params(),
        "kp": {"hip": 20.0, "calf": 40.0},
        "kd": [1.0, 2.5],
        "delay": 0.01,
        "saturation": 9.0,
    }
    assert parse_drive("pd delay=auto kp=none").get_params() == PDDrive().get_params()


BAD = {
    "servo kp=1": "must begin with its kind, one of pd",
    "": "must begin with its kind",
    "pd ki=1": "'ki=1'; expected, each once, NAME=VALUE",
    "pd kp": "'kp'; expected",
    "pd kp= 20": "'kp='; expected",
    "pd kp=1 kp=2": "'kp=2'; expected, each once",
    "pd kp=1,x": "kp=1,x; expected numbers",
    "pd kp=hip:a": "expected numbers, or JOINT:NUMBER",
    "pd kp=hip:1,hip:2": "expected numbers, or JOINT:NUMBER",
}


@pytest.mark.parametrize("text", BAD)
def test_invalid_drive_strings_are_refused(text, tmp_path):
    with pytest.raises(ValueError, match=BAD[text]):
        read(write(tmp_path / "arm.csv", table()), drive=text)


def test_invalid_command_files_are_refused(tmp_path):
    path = write(tmp_path / "a.csv", table())
    with pytest.raises(ValueError, match=r"a\.csv: PDDrive: kp is missing: give kp="):
        read(path, drive="pd")
    with pytest.raises(ValueError, match="leave gains out"):
        read(path, drive=TEXT, gains=(1.0, 1.0))
    columns = table(q_des_1=np.ones(N))
    with pytest.raises(ValueError, match="'q_desired1' and 'q_des_1' could both be"):
        read(write(tmp_path / "b.csv", columns), drive=TEXT)
    columns = table()
    del columns["q_desired2"]
    with pytest.raises(ValueError, match="column 'q_desired2' is missing"):
        read(write(tmp_path / "c.csv", columns), drive=TEXT)
    t, q, aim = motion()
    np.savez(tmp_path / "e.npz", t=t, q=q, q_desired=aim, kp=np.ones(3), kd=1.0)
    with pytest.raises(ValueError, match=r"kp has the shape \(3,\); expected one"):
        read(tmp_path / "e.npz", drive="pd")
