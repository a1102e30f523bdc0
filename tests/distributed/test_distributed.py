"""Fits on a cluster of processes against fits in memory."""

import os
import signal
from dataclasses import replace

import distributed
import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.linear_model import Ridge

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa import distributed as passes
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.distributed import fit_recordings
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.robot import FitOptions
from tests.robot import test_streaming


@pytest.fixture(scope="module")
def cluster():
    """Start two processes of one thread, once, since this takes seconds."""
    with (
        distributed.LocalCluster(
            processes=True, n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as local,
        distributed.Client(local) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def recording():
    return make_robot_recording(
        duration=16.0, dt=0.01, frequency=1.0, n_recordings=4, random_state=1
    )


def save(recording, folder):
    """Write one file per recording; the last two recordings share one file."""
    for k in range(3):
        rows = recording.groups == k if k < 2 else recording.groups >= 2
        more = {"segment": recording.groups[rows]} if k == 2 else {}
        arrays = {"q": recording.q[rows], "tau": recording.tau[rows], **more}
        np.savez(folder / f"{k}.npz", dt=recording.dt, **arrays)
    return folder


@pytest.fixture
def folder(recording, tmp_path):
    return save(recording, tmp_path)


def robot(recording, **settings):
    return RobotIdentifier(
        recording.urdf, dt=recording.dt, **{"friction": ("viscous",), **settings}
    )


def in_memory(recording, **settings):
    arrays = recording.q, recording.tau, recording.groups
    return robot(recording, **settings).fit(*arrays)


def assert_same(found, expected):
    test_streaming.assert_same(found, expected)
    for name in ("theta_unconstrained_", "theta_"):
        values, reference = getattr(found, name), getattr(expected, name)
        size = np.abs(reference).max()
        # Rounding errors, amplified by poor conditioning.
        assert_allclose(values, reference, rtol=0, atol=1e-10 * size, err_msg=name)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"cutoff": 4.0, "options": FitOptions(state_cutoff=6.0, standstill=0.01)},
        {"cutoff": None, "input_noise": None, "options": FitOptions(standstill=None)},
    ],
)
def test_fit_from_files_equals_fit_in_memory(recording, folder, settings):
    found = fit_recordings(robot(recording, **settings), folder)
    expected = in_memory(recording, **settings)
    assert_same(found, expected)
    for one, other in zip(found.effect_ranges_, expected.effect_ranges_):
        assert_allclose(one.position, other.position, rtol=1e-9)
        assert_allclose(one.speed, other.speed, rtol=1e-6, atol=1e-9)
    assert found.n_features_in_ == 6
    assert found.predict(recording.q[:50]).shape == (50, 6)


def test_channels_are_inspected(recording, tmp_path):
    late = replace(recording, tau=np.roll(recording.tau, 3, axis=0))
    found, expected = fit_recordings(robot(late), save(late, tmp_path)), in_memory(late)
    assert_allclose(found.theta_, expected.theta_, rtol=1e-4, atol=1e-6)
    assert found.torque_lag_ == pytest.approx(0.03, abs=1e-3)
    sign = np.where(recording.groups == 1, -1.0, 1.0)[:, None]
    other = save(replace(recording, tau=sign * recording.tau), tmp_path)
    with pytest.warns(DoubtWarning, match=r"Recording .*1\.npz alone: .*wrong sign"):
        fit_recordings(robot(recording), other)


def dying(function, marker):
    """Kill the first process that finishes a task before it returns the result."""

    def run(*arguments, **named):
        result = function(*arguments, **named)
        try:
            marker.touch(exist_ok=False)
        except FileExistsError:
            return result
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError("the process must have died")

    return run


def test_killed_worker_does_not_change_the_fit(
    monkeypatch, cluster, recording, folder, tmp_path_factory
):
    marker = tmp_path_factory.mktemp("killed") / "marker"
    workers = set(cluster.scheduler_info()["workers"])
    monkeypatch.setattr(passes, "_moments", dying(passes._moments, marker))
    found = fit_recordings(robot(recording), folder)
    assert marker.exists()
    assert_same(found, in_memory(recording))
    # The nanny has replaced the killed process.
    cluster.wait_for_workers(2, timeout=600)
    assert set(cluster.scheduler_info()["workers"]) != workers


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"regressor": Ridge()}, "nor a regressor that needs rows"),
        ({"dt": 0.02}, r"npz: its dt is 0\.01 s but dt = 0\.02 s"),
    ],
)
def test_settings_that_need_all_rows_are_refused(recording, folder, settings, message):
    with pytest.raises(ValueError, match=message):
        fit_recordings(robot(recording).set_params(**settings), folder)


def test_sources_without_recordings_are_refused(recording, tmp_path):
    for source in (tmp_path / "elsewhere", []):
        with pytest.raises(FileNotFoundError, match="a folder that contains"):
            fit_recordings(robot(recording), source)


def add_other_robot(recording, path):
    q = np.random.default_rng(0).normal(size=(100, 2))
    np.savez(path, q=q, tau=q, dt=recording.dt)


def add_cut(recording, path):
    np.savez(path, q=recording.q, tau=recording.tau, dt=recording.dt)
    path.write_bytes(path.read_bytes()[:-2000])


@pytest.mark.parametrize("add", [add_other_robot, add_cut])
@pytest.mark.parametrize("as_model", [False, True])
def test_a_bad_file_is_named(recording, folder, add, as_model):
    add(recording, folder / "1b.npz")
    identifier = robot(recording)
    if as_model:
        # Workers use the joints of the model.
        identifier.set_params(model=recording.robot_model())
    with pytest.raises(ValueError, match=r"1b\.npz"):
        fit_recordings(identifier, folder)
