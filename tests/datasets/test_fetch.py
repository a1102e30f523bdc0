"""Measured sets: from the public file to the array, and to the right physics."""

import importlib.metadata
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from sklearn_vbjfa import datasets
from sklearn_vbjfa.datasets import (
    CATALOGUE,
    Access,
    DataFiles,
    _measured,
    find_file,
    remote_files,
)
from sklearn_vbjfa.model import build_model
from sklearn_vbjfa.robot import PDDrive

# name -> (samples of each recording, joints, period [s])
CONTENT = {
    "bam_xl330": (
        [1129, 376, 1129, 1128, 1128, 376, 1129, 1129, 1128, 376, 1128, 1129],
        1,
        0.0053169,
    ),
    "dfki_double_pendulum": (
        [5000, 4999] + [5000] * 4 + [2999, 5000, 5000],
        2,
        0.0020001,
    ),
    "emps": ([24841, 24841], 1, 0.001),
    "franka_panda": ([20984], 7, 0.001),
    "kuka_kr300": ([2501, 2501], 6, 0.004),
    "kuka_lbr_med7": ([1647], 7, 0.01),
    "staubli_tx40": ([45000], 6, 0.0002),
    "tflex_1dof": ([130716], 1, 0.001),
    "tiago": ([5872], 8, 0.0099959),
    "unitree_go2": (
        [4781, 4697, 4697, 4698, 4699, 4697, 4701, 4699, 4697, 4699],
        12,
        0.005,
    ),
    "ur5": ([4475, 2605, 2482, 2831, 10264, 3470, 1964, 2707], 6, 0.008),
}


@pytest.fixture
def fetch(measured_data_home):
    def call(dataset, **options):
        loader = getattr(datasets, f"fetch_{dataset}")
        return loader(
            data_home=measured_data_home, download_if_missing=False, **options
        )

    return call


@pytest.fixture
def original(measured_data_home):
    """Local copies of the public files of a set, by path in the repository."""

    def find(dataset, suffix=""):
        folder = measured_data_home / dataset
        files = {x.path: find_file(x, folder) for x in remote_files(dataset)}
        return {path: x for path, x in files.items() if path.endswith(suffix)}

    return find


@pytest.fixture
def converted(measured_data_home):
    """Load arrays of the conversion that was made independently of the package."""

    def load(dataset, name):
        with np.load(measured_data_home / dataset / f"{name}.npz") as arrays:
            return dict(arrays)

    return load


def test_the_content_of_every_set_is_tested():
    assert set(CONTENT) == set(CATALOGUE)


@pytest.mark.parametrize("dataset", sorted(CONTENT))
def test_content(fetch, dataset):
    recording = fetch(dataset)
    n_samples, nv, dt = CONTENT[dataset]
    assert recording.name == dataset
    assert recording.q.shape == recording.tau.shape == (sum(n_samples), nv)
    assert recording.dt == pytest.approx(dt, abs=1e-12)
    np.testing.assert_array_equal(np.bincount(recording.groups), n_samples)
    inside = np.diff(recording.groups) == 0
    np.testing.assert_allclose(np.diff(recording.t)[inside], dt, rtol=1e-6)
    np.testing.assert_array_equal(recording.t[1:][~inside], 0)
    assert recording.tau.std(axis=0).min() > 0
    for text in ("source", "licence", "citation", "description"):
        assert getattr(recording, text)


@pytest.mark.filterwarnings("ignore:The robot description 'go2.xml'")
@pytest.mark.parametrize("dataset", sorted(CONTENT))
def test_robot_model_has_the_recorded_joints(fetch, dataset):
    pytest.importorskip("pinocchio")
    recording = fetch(dataset)
    model = recording.robot_model()
    assert model.nq == model.nv == recording.nv
    assert tuple(model.names)[1:] == recording.joint_names


@pytest.mark.parametrize(
    ("dataset", "tolerance"),
    [
        # The servo shows one count, 0.024 rad/s, at standstill.
        ("bam_xl330", 0.35),
        ("dfki_double_pendulum", 0.15),
        ("franka_panda", 0.15),
        ("tiago", 0.15),
        ("ur5", 0.15),
    ],
)
def test_velocity_is_that_of_the_positions(fetch, dataset, tolerance):
    # Joint order, units and time base of two channels recorded separately.
    recording = fetch(dataset)
    for label in range(len(recording.group_names)):
        part = recording.select(label)
        travel = np.cumsum(part.v, axis=0) * part.dt
        moving = np.ptp(part.q, axis=0) > 0.1
        for q, integral in zip(part.q.T[moving], travel.T[moving]):
            assert np.ptp(q - integral) < tolerance * np.ptp(q)


def test_unresampled_values_are_those_recorded(fetch, converted):
    panda, raw = (
        fetch("franka_panda", resample=False),
        converted("franka_panda", "exciting_traj_1"),
    )
    for name in ("t", "q", "v", "tau"):
        np.testing.assert_array_equal(getattr(panda, name), raw[name])
    ur5 = fetch("ur5", resample=False).select("No1")
    raw = converted("ur5", "Movement_No1")
    np.testing.assert_array_equal(ur5.t, raw["t"])
    np.testing.assert_array_equal(ur5.q, raw["q_actual"])
    tiago = fetch("tiago", rows="all", resample=False)
    np.testing.assert_array_equal(tiago.q, converted("tiago", "tiago_dynamic")["q"])


def test_originals_equal_conversion_of_one_joint_benches(
    original, converted, measured_data_home
):
    (local,) = original("tflex_1dof").values()
    raw = _measured.tflex_arrays(local)
    _assert_same_arrays(raw, converted("tflex_1dof", "TFlexADRC_RN20"))

    for local in original("bam_xl330").values():
        raw = _measured.xl330_arrays(local)
        name = f"xl330_kp{raw['kp']}_{raw['trajectory']}"
        _assert_same_arrays(raw, converted("bam_xl330", name))


def test_originals_equal_conversion_of_the_double_pendulum(original, converted):
    for path, local in original("dfki_double_pendulum").items():
        name = path.removeprefix("data/experiment_records/").removesuffix(".csv")
        expected = converted("dfki_double_pendulum", name.replace("/", "__"))
        raw = _measured.dfki_arrays(local)
        assert list(raw) == expected["columns"].tolist()
        np.testing.assert_array_equal(
            np.column_stack(list(raw.values())), expected["data"]
        )


def test_originals_equal_conversion_of_the_arms(original, converted):
    files = original("ur5")
    folders = {str(Path(path).parent) for path in files}
    assert len(folders) == 8
    for folder in folders:
        parts = {
            Path(p).stem: x for p, x in files.items() if p.startswith(f"{folder}/")
        }
        raw = _measured.ur5_arrays(parts)
        _assert_same_arrays(raw, converted("ur5", Path(folder).parent.name))

    raw = _measured.tx40_arrays(original("staubli_tx40", ".csv"))
    expected = converted("staubli_tx40", "tx40")
    assert expected.pop("dt") == CATALOGUE["staubli_tx40"].dt
    _assert_same_arrays(raw, expected)

    for path, local in original("kuka_kr300").items():
        raw = _measured.kr300_arrays(local)
        _assert_same_arrays(raw, converted("kuka_kr300", f"traj_{path.split()[3]}"))

    raw = _measured.franka_arrays(original("franka_panda"))
    _assert_same_arrays(raw, converted("franka_panda", "exciting_traj_1"))

    (local,) = original("kuka_lbr_med7", ".csv").values()
    raw = _measured.lbr_arrays(local)
    _assert_same_arrays(raw, converted("kuka_lbr_med7", "measurements"))

    raw = _measured.tiago_arrays(original("tiago"))
    expected = converted("tiago", "tiago_dynamic")
    assert tuple(expected.pop("joint_names")) == CATALOGUE["tiago"].joint_names
    _assert_same_arrays(raw, expected)


def _assert_same_arrays(raw, expected):
    assert set(raw) == set(expected)
    for key, values in expected.items():
        np.testing.assert_array_equal(raw[key], values, err_msg=key)


def test_emps_gives_the_published_mass(fetch):
    emps = fetch("emps").select("DATA_EMPS")
    _, v, a, tau = (x[100:17389, 0] for x in _filtered(emps, 60.0))
    design = np.column_stack([a, v, np.sign(v), np.ones_like(a)])
    mass, viscous, dry, _ = np.linalg.lstsq(design, tau, rcond=None)[0]
    assert mass == pytest.approx(95.1, rel=0.01)
    assert viscous == pytest.approx(203.5, rel=0.05)
    assert dry == pytest.approx(20.4, rel=0.05)


@pytest.mark.parametrize(
    ("dataset", "options", "joints"),
    [
        ("dfki_double_pendulum", {"which": "long"}, [0, 1]),
        ("franka_panda", {}, [1, 2, 3, 4]),
        ("kuka_lbr_med7", {"which": "fast"}, [1, 3]),
        ("kuka_lbr_med7", {"which": "slow"}, [1, 2, 3]),
        ("ur5", {}, [1]),
    ],
)
def test_gravity_explains_loaded_joints(fetch, dataset, options, joints):
    pin = pytest.importorskip("pinocchio")
    recording = fetch(dataset, **options)
    model = recording.robot_model()
    data = model.createData()
    rows = slice(None, None, 10)
    gravity = np.array(
        [
            pin.computeGeneralizedGravity(model, data, q).copy()
            for q in recording.q[rows]
        ]
    )
    for joint in joints:
        tau = recording.tau[rows, joint]
        assert np.corrcoef(gravity[:, joint], tau)[0, 1] > 0.9
        # The nominal payload is uncertain, the scale is not.
        assert 0.7 < np.polyfit(gravity[:, joint], tau, 1)[0] < 1.6


@pytest.mark.filterwarnings("ignore:The robot description 'go2.xml'")
@pytest.mark.parametrize(
    ("dataset", "options", "select", "cutoff", "min_speed", "limits"),
    [
        ("kuka_kr300", {}, ["A", "B"], 12.0, 0.02, [0.1] * 6),
        ("staubli_tx40", {}, [0], 25.0, 0.1, [0.05, 0.055, 0.071, 0.075, 0.11, 0.1]),
        ("franka_panda", {}, [0], 10.0, 0.0, [0.1, 0.02, 0.03, 0.04, 0.1, 0.05]),
        ("ur5", {}, ["No6"], 8.0, 0.03, [0.08, 0.06, 0.08, 0.25, 0.2, 0.3]),
        ("tiago", {}, [0], 5.0, 0.02, [1.0, 0.25, 0.3, 0.25, 0.2]),
        ("unitree_go2", {}, ["run_0"], 10.0, 0.1, [0.2] * 12),
    ],
)
def test_rigid_body_regression_explains_the_torque(
    fetch, dataset, options, select, cutoff, min_speed, limits
):
    # A wrong sign, zero, unit or joint order leaves far more behind.
    recording = fetch(dataset, **options).select(*select)
    residual, viscous, dry = _regression(recording, cutoff, min_speed)
    n_joints = len(limits)
    assert (residual[:n_joints] < limits).all(), residual
    good = slice(1 if dataset == "tiago" else 0, min(n_joints, 5))
    assert (dry[good] > 0).all(), dry
    assert (viscous[good] > 0).all(), viscous


def test_xl330_voltage_is_that_of_a_pendulum(fetch):
    servo = fetch("bam_xl330").select("kp100_sin_sin", "kp400_sin_sin", "kp800_sin_sin")
    q, v, a, tau = (x[:, 0] for x in _filtered(servo, 12.0))
    moving = np.abs(v) > 0.05
    design = np.column_stack([a, np.sin(q), v, np.sign(v), np.ones_like(a)])[moving]
    inertia, gravity, viscous, dry, _ = np.linalg.lstsq(design, tau[moving])[0]
    assert min(viscous, dry) > 0
    # g / l = 98 s^-2 for the load alone; rotor and arm make it less.
    assert 60 < gravity / inertia < 98


def test_xl330_free_swing_is_set_apart(fetch):
    powered, every = fetch("bam_xl330"), fetch("bam_xl330", include_free_swing=True)
    assert powered.signals["torque_enable"].all()
    free = [name for name in every.group_names if name.endswith("_free")]
    assert free == [f"kp{kp}_lift_and_drop_free" for kp in (100, 400, 800)]
    swing = every.select(*free)
    assert not swing.signals["torque_enable"].any()
    assert not swing.tau.any()
    rest = [name for name in every.group_names if name not in free]
    assert tuple(rest) == powered.group_names


def test_tflex_speed_is_the_derivative_of_the_angle(fetch):
    tflex = fetch("tflex_1dof")
    slope = np.gradient(tflex.q[:, 0], tflex.dt) @ tflex.v[:, 0] / np.sum(tflex.v**2)
    assert slope == pytest.approx(1.0, abs=2e-3)


def test_tx40_motor_and_joint_power_agree(fetch):
    tx40 = fetch("staubli_tx40")
    motor = np.sum(
        np.diff(tx40.signals["q_motor"], axis=0) * tx40.signals["tau_motor"][1:]
    )
    joint = np.sum(np.diff(tx40.q, axis=0) * tx40.tau[1:])
    assert joint == pytest.approx(motor, rel=1e-9)
    # Joint 4 alone turns against its motor; 5 drags motor 6 along.
    q_motor = tx40.signals["q_motor"]
    np.testing.assert_allclose(q_motor[:, 3], -48 * tx40.q[:, 3], atol=1e-9)
    np.testing.assert_allclose(q_motor[:, 5], 32 * tx40.q[:, 4:].sum(axis=1), atol=1e-9)


def test_tx40_friction_is_that_published(fetch):
    tx40 = fetch("staubli_tx40")
    # The robot starts upright, which is the zero of the model.
    np.testing.assert_allclose(tx40.q[0], 0, atol=1e-4)
    _, viscous, dry = _regression(tx40, 25.0, 0.1)
    published = [8.05, 5.53, 1.97, 1.11, 1.86, 0.65]
    np.testing.assert_allclose(viscous, published, rtol=0.05)
    np.testing.assert_allclose(dry[:5], [7.14, 8.26, 6.34, 2.48, 3.03], rtol=0.05)


def test_kr300_second_encoders_agree_with_the_motors(fetch):
    kr300 = fetch("kuka_kr300")
    assert np.abs(kr300.signals["q_link"] - kr300.q[:, :3]).max() < np.deg2rad(0.3)
    np.testing.assert_allclose(
        kr300.tau[:, 3], 221 * kr300.signals["torque_motor"][:, 3]
    )
    for joint in range(6):
        ff = kr300.signals["tau_ff"][:, joint]
        assert np.corrcoef(ff, kr300.tau[:, joint])[0, 1] > 0.6


def test_ur5_gains_scale_the_torque(fetch):
    ur5 = fetch("ur5", gains=[1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(ur5.tau, ur5.signals["i_actual"] * np.arange(1, 7))
    with pytest.raises(ValueError, match="gains must hold six finite numbers"):
        datasets.fetch_ur5(gains=[1, 2])


@pytest.mark.parametrize(
    ("dataset", "options", "message"),
    [
        ("dfki_double_pendulum", {"which": "all"}, "which must be 'short'"),
        ("kuka_lbr_med7", {"which": "medium"}, "which must be 'fast', 'slow' or 'all'"),
        ("tiago", {"rows": "upstream"}, "rows must be 'exciting' or 'all'"),
    ],
)
def test_unknown_options_are_refused(dataset, options, message):
    with pytest.raises(ValueError, match=message):
        getattr(datasets, f"fetch_{dataset}")(**options)


@pytest.mark.parametrize("dataset", sorted(CATALOGUE))
def test_absent_set_is_refused_in_one_line(dataset, tmp_path):
    loader = getattr(datasets, f"fetch_{dataset}")
    where = CATALOGUE[dataset].source or "https://raw.githubusercontent.com/"
    with pytest.raises(FileNotFoundError, match=re.escape(where)) as info:
        loader(data_home=tmp_path, download_if_missing=False)
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("dataset", ["bam_xl330", "emps", "kuka_kr300", "ur5"])
def test_download_to_recording(dataset, measured_data_home, serve, fetch, tmp_path):
    answers = {}
    for remote in remote_files(dataset):
        content = find_file(remote, measured_data_home / dataset).read_bytes()
        path = f"{remote.repository}/{remote.commit}/{remote.path}"
        answers[path] = (200, content, len(content))
    requests = serve(answers)
    loader = getattr(datasets, f"fetch_{dataset}")
    downloaded, local = loader(data_home=tmp_path), fetch(dataset)
    np.testing.assert_array_equal(downloaded.q, local.q)
    np.testing.assert_array_equal(downloaded.tau, local.tau)
    loader(data_home=tmp_path)
    assert len(requests) == len(answers)


def test_slow_lbr_recording_is_not_downloaded(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"put it at .*which='fast'"):
        datasets.fetch_kuka_lbr_med7(data_home=tmp_path, which="slow")


def test_lbr_recordings_can_be_joined(fetch, converted):
    lbr = fetch("kuka_lbr_med7", which="all")
    assert lbr.group_names == ("measurements", "measurements_with_ext_tau_1")
    raw = converted("kuka_lbr_med7", "measurements_with_ext_tau_1")
    np.testing.assert_array_equal(lbr.select(1).tau, -raw["tau"])


def test_go2_is_told_what_the_law_of_its_motors_says(fetch, converted):
    go2 = fetch("unitree_go2")
    assert go2.group_names == tuple(f"run_{k}" for k in range(10))
    for label in (0, 9):
        part, raw = go2.select(label), converted("unitree_go2", f"run_{label}")
        np.testing.assert_array_equal(part.q, raw["q"])
        np.testing.assert_array_equal(part.v, raw["v"])
        spring = 4 * [20.0, 20.0, 40.0] * (part.signals["q_desired"] - part.q)
        damper = 4 * [1.0, 1.0, 2.0] * (part.signals["v_desired"] - part.v)
        np.testing.assert_allclose(part.tau, spring + damper, atol=1e-12)
        np.testing.assert_array_equal(part.signals["q_desired"], raw["q_desired"])
        assert not part.signals["v_desired"].any()
        driven = PDDrive().driven(part)
        aim = 4 * [20.0, 20.0, 40.0] * part.signals["q_desired"]
        np.testing.assert_allclose(driven.command, aim, atol=1e-12)
        # Sums of 0.005 in single precision.
        np.testing.assert_allclose(part.t, raw["t"], atol=0.006)


def test_go2_speeds_are_those_of_its_positions(fetch):
    # They have an offset, so that their integrals drift.
    go2 = fetch("unitree_go2").select("run_3")
    slope = np.gradient(go2.q, go2.dt, axis=0)
    for j in range(12):
        assert np.polyfit(go2.v[:, j], slope[:, j], 1)[0] == pytest.approx(1, abs=0.05)
        assert np.corrcoef(go2.v[:, j], slope[:, j])[0, 1] > 0.95


@pytest.mark.filterwarnings("ignore:The robot description 'go2.xml'")
def test_go2_hangs_level_in_the_order_of_its_legs(fetch):
    pytest.importorskip("pinocchio")
    go2 = fetch("unitree_go2")
    model = go2.robot_model()
    hips = np.array([model.jointPlacements[k].translation for k in (1, 4, 7, 10)])
    front, left = [1, 1, -1, -1], [1, -1, 1, -1]
    np.testing.assert_array_equal(np.sign(hips[:, :2]), np.transpose([front, left]))
    for k in (1, 4, 7, 10):
        np.testing.assert_allclose(model.jointPlacements[k].rotation, np.eye(3))
    np.testing.assert_allclose(model.gravity.linear, [0, 0, -9.81])
    with pytest.warns(UserWarning, match="the base, which base_joint leaves free, is"):
        go2.robot_model()


def test_go2_says_where_its_files_come_from(tmp_path):
    with pytest.raises(FileNotFoundError, match="put the files of the set there") as no:
        datasets.fetch_unitree_go2(data_home=tmp_path)
    said = str(no.value)
    for part in (tmp_path / "unitree_go2", "github.com/RX-00", "fetch_unitree_go2"):
        assert str(part) in said
    assert "\n" not in said
    assert "not downloaded" in said


def test_go2_without_its_description(measured_data_home, tmp_path):
    pytest.importorskip("pinocchio")
    (tmp_path / "unitree_go2").mkdir()
    run = measured_data_home / "unitree_go2" / "run_4.npz"
    shutil.copy(run, tmp_path / "unitree_go2")
    go2 = datasets.fetch_unitree_go2(data_home=tmp_path)
    assert (go2.group_names, go2.urdf) == (("run_4",), None)
    with pytest.raises(FileNotFoundError, match=r"dataclasses\.replace"):
        go2.robot_model()


def test_published_urdf_may_be_absent(measured_data_home, tmp_path, original):
    pytest.importorskip("pinocchio")
    (local,) = original("kuka_lbr_med7", ".csv").values()
    (tmp_path / "kuka_lbr_med7").mkdir()
    shutil.copy(local, tmp_path / "kuka_lbr_med7")
    lbr = datasets.fetch_kuka_lbr_med7(data_home=tmp_path, download_if_missing=False)
    assert lbr.urdf is None
    with pytest.raises(FileNotFoundError, match="download_if_missing=True"):
        lbr.robot_model()


def test_description_comes_from_example_robot_data(monkeypatch, tmp_path):
    urdf = tmp_path / "robots" / "ur_description" / "urdf" / "ur5_robot.urdf"
    urdf.parent.mkdir(parents=True)
    urdf.write_text("<robot/>")

    class Entry(str):
        def locate(self):
            return str(self)

    monkeypatch.setattr(importlib.metadata, "files", lambda name: [Entry(urdf)])
    assert CATALOGUE["ur5"].urdf(DataFiles("ur5", Access(tmp_path))) == str(urdf)


def test_description_without_any_source(monkeypatch, tmp_path):
    pytest.importorskip("pinocchio")

    def not_installed(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "files", not_installed)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert CATALOGUE["tiago"].urdf(DataFiles("tiago", Access(tmp_path))) is None
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FileNotFoundError, match="pip install example-robot-data"):
        build_model("tiago", None, ("torso_lift_joint",))


def test_description_comes_from_robot_descriptions(monkeypatch, fetch):
    pytest.importorskip("pinocchio")
    ur5 = fetch("ur5")
    package = SimpleNamespace(URDF_PATH=ur5.urdf)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: True)
    monkeypatch.setattr(importlib, "import_module", lambda name: package)
    assert build_model("ur5", None, ur5.joint_names).nv == 6


def _filtered(recording, cutoff):
    """Zero-phase q, v, a, tau of all recordings, without 0.3 s at the ends."""
    b, a = butter(4, 2 * cutoff * recording.dt)
    trim = int(0.3 / recording.dt)
    parts = []
    for label in range(len(recording.group_names)):
        rows = recording.groups == label
        q, tau = (filtfilt(b, a, x[rows], axis=0) for x in (recording.q, recording.tau))
        v = np.gradient(q, recording.dt, axis=0)
        acceleration = np.gradient(v, recording.dt, axis=0)
        parts.append([x[trim:-trim] for x in (q, v, acceleration, tau)])
    return [np.concatenate(x) for x in zip(*parts, strict=True)]


def _regression(recording, cutoff, min_speed):
    """Weighted least squares on moving samples: relative residual, Fv, Fc."""
    pin = pytest.importorskip("pinocchio")
    model = recording.robot_model()
    data, nv = model.createData(), model.nv
    step = max(1, recording.n_samples // 1500)
    q, v, a, tau = (x[::step] for x in _filtered(recording, cutoff))
    blocks = []
    for row in range(len(q)):
        body = pin.computeJointTorqueRegressor(model, data, q[row], v[row], a[row])
        friction = [np.diag(x) for x in (v[row], np.sign(v[row]), np.ones(nv), a[row])]
        # Counterbalance of the KR300's axis 2; without effect elsewhere.
        angle = q[row, 1] * np.array([1, 1, 2, 2]) + np.array([0, 1, 0, 1]) * np.pi / 2
        balance = np.zeros((nv, 4))
        balance[1] = np.sin(angle)
        # Both wrist motors of the TX40 move with joint 5 or 6.
        wrist = np.zeros((nv, 3))
        if recording.name == "staubli_tx40":
            wrist[4] = a[row, 5], v[row, 5], np.sign(v[row, 4] + v[row, 5])
            wrist[5] = a[row, 4], v[row, 4], np.sign(v[row, 4] + v[row, 5])
        blocks.append(np.hstack([body, *friction, balance, wrist]))
    design, moving = np.stack(blocks), np.abs(v) > min_speed
    scale = np.array([tau[moving[:, j], j].std() for j in range(nv)])
    weight = np.broadcast_to(1 / scale, tau.shape)[moving]
    matrix = design[moving] * weight[:, None]
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0] = 1
    theta = np.linalg.lstsq(matrix / norms, tau[moving] * weight, rcond=1e-6)[0] / norms
    residual = tau - design @ theta
    relative = [residual[moving[:, j], j].std() / scale[j] for j in range(nv)]
    return np.array(relative), theta[10 * nv : 11 * nv], theta[11 * nv : 12 * nv]
