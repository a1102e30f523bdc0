"""Measured sets: from the public file to the array, and to the right physics."""

import hashlib
import importlib.metadata
import shutil
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote

import numpy as np
import pytest

from sklearn_vbjfa import datasets
from sklearn_vbjfa.datasets import SETS, _measured, remote_files
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
def converted(measured_data_home):
    """Load arrays of the conversion that was made independently of the package."""

    def load(dataset, name):
        (file,) = (measured_data_home / dataset).glob(f"{name}.npz")
        with np.load(file) as arrays:
            return dict(arrays)

    return load


@pytest.mark.parametrize("dataset", sorted(CONTENT))
def test_content(fetch, dataset):
    assert set(CONTENT) == set(SETS)
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
    recording = fetch(dataset)
    model = recording.robot_model()
    assert model.nq == model.nv == recording.nv
    assert tuple(model.names)[1:] == recording.joint_names


def test_values_are_those_of_an_independent_conversion(fetch, converted):
    panda = fetch("franka_panda", resample=False)
    raw = converted("franka_panda", "exciting_traj_1")
    for name in ("t", "q", "v", "tau"):
        np.testing.assert_array_equal(getattr(panda, name), raw[name])
    ur5 = fetch("ur5", resample=False)
    for name in ur5.group_names:
        part, raw = ur5.select(name), converted("ur5", f"Movement_{name}*")
        np.testing.assert_array_equal(part.t, raw["t"])
        np.testing.assert_array_equal(part.q, raw["q_actual"])
        np.testing.assert_array_equal(part.signals["i_actual"], raw["i_actual"])
    tiago, rows = fetch("tiago", resample=False), slice(921, 6791)
    raw = converted("tiago", "tiago_dynamic")
    assert tuple(raw["joint_names"]) == tiago.joint_names
    np.testing.assert_array_equal(tiago.q, raw["q"][rows])
    np.testing.assert_array_equal(tiago.signals["effort"], raw["effort"][rows])
    servo = fetch("bam_xl330", resample=False)
    for name in servo.group_names:
        part, raw = servo.select(name), converted("bam_xl330", f"xl330_{name}")
        powered = raw["torque_enable"] == 1
        np.testing.assert_array_equal(part.q[:, 0], raw["position"][powered])
        np.testing.assert_array_equal(part.signals["duty"], raw["pwm_duty"][powered])
    pendulum = fetch("dfki_double_pendulum", resample=False)
    for name in pendulum.group_names:
        file = f"design_A.0__20220815__sys_id__{name}"
        raw, part = converted("dfki_double_pendulum", file), pendulum.select(name)
        columns = dict(zip(raw["columns"].tolist(), raw["data"].T))
        for key, values in (("pos", part.q), ("vel", part.v), ("tau", part.tau)):
            for joint in (1, 2):
                expected = columns[f"{key}_meas{joint}"]
                np.testing.assert_array_equal(values[:, joint - 1], expected)


def test_ur5_gains_scale_the_torque(fetch):
    ur5 = fetch("ur5", resample=False)
    gains = [12.63, 12.63, 12.63, 9.31, 9.31, 9.31]
    np.testing.assert_allclose(ur5.tau, ur5.signals["i_actual"] * gains)


@pytest.mark.parametrize("dataset", sorted(SETS))
def test_absent_set_is_refused_in_one_line(dataset, tmp_path):
    loader = getattr(datasets, f"fetch_{dataset}")
    with pytest.raises(FileNotFoundError) as info:
        loader(data_home=tmp_path, download_if_missing=False)
    where = SETS[dataset].get("source", "https://raw.githubusercontent.com/")
    for part in (where, str(tmp_path / dataset)):
        assert part in str(info.value)
    assert "\n" not in str(info.value)


@pytest.fixture
def serve(monkeypatch):
    """Serve bytes by their paths in place of the public server; list the requests."""
    servers = []

    def start(answers):
        requests = []

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                path = unquote(self.path).lstrip("/")
                requests.append(path)
                self.send_response(200 if path in answers else 404)
                body = answers.get(path, b"")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *args):
                pass

        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        servers.append(server)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        monkeypatch.setattr(_measured, "_BASE_ADDRESS", address)
        return requests

    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


def published(dataset, home):
    """Return what the public server answers for a set that is on disk."""
    by_digest = {
        hashlib.sha256(content).hexdigest(): content
        for content in (x.read_bytes() for x in home.rglob("*") if x.is_file())
    }
    files = remote_files(dataset).values()
    return {unquote(address): by_digest[sha256] for address, sha256 in files}


@pytest.mark.parametrize("dataset", ["emps", "kuka_kr300"])
def test_download_to_recording(dataset, measured_data_home, serve, fetch, tmp_path):
    answers = published(dataset, measured_data_home / dataset)
    requests = serve(answers)
    loader = getattr(datasets, f"fetch_{dataset}")
    downloaded, local = loader(data_home=tmp_path), fetch(dataset)
    np.testing.assert_array_equal(downloaded.q, local.q)
    np.testing.assert_array_equal(downloaded.tau, local.tau)
    loader(data_home=tmp_path)
    assert sorted(requests) == sorted(answers)


def test_downloads_with_a_wrong_checksum_are_refused(serve, tmp_path):
    serve({unquote(address): b"edited" for address, _ in remote_files("emps").values()})
    with pytest.raises(OSError, match="Cannot download") as info:
        datasets.fetch_emps(data_home=tmp_path)
    assert "\n" not in str(info.value)
    assert not [x for x in tmp_path.rglob("*") if x.is_file()]


def test_go2_torques_follow_from_its_control_law(fetch, converted):
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
        commands = PDDrive().commands(part)
        aim = 4 * [20.0, 20.0, 40.0] * part.signals["q_desired"]
        np.testing.assert_allclose(commands, aim, atol=1e-12)
        # Sums of 0.005 in single precision.
        np.testing.assert_allclose(part.t, raw["t"], atol=0.006)


@pytest.fixture
def undescribed(measured_data_home, tmp_path):
    """Load TIAGo from a folder without its description."""
    original = measured_data_home / "tiago" / "original"
    shutil.copytree(original, tmp_path / "tiago" / "original")
    return lambda: datasets.fetch_tiago(data_home=tmp_path)


def test_description_comes_from_example_robot_data(monkeypatch, tmp_path, undescribed):
    urdf = tmp_path / "robots" / "tiago_description" / "robots" / "tiago.urdf"
    urdf.parent.mkdir(parents=True)
    urdf.write_text("<robot/>")

    class Entry(str):
        def locate(self):
            return str(self)

    monkeypatch.setattr(importlib.metadata, "files", lambda name: [Entry(urdf)])
    assert undescribed().urdf == str(urdf)
