"""Fits on a cluster of processes, one of which dies, against fits in memory."""

import os
import re
import shutil
import signal
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import Ridge

pytest.importorskip("pinocchio")
pytest.importorskip("distributed")

import dask.array as da
import distributed

from sklearn_vbjfa import (
    EffectDiscovery,
    JFARegressor,
    RobotIdentifier,
    VBJFARegressor,
)
from sklearn_vbjfa._cli import main
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.diagnosis import _discovery
from sklearn_vbjfa.distributed import _passes as passes
from sklearn_vbjfa.distributed import fit_array, fit_recordings
from sklearn_vbjfa.inspection import _inspect
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import StoredRows, _stored, take_rows
from tests.recording._bags import states, write_ros2

FITTED = (
    "cutoff_",
    "standstill_",
    "torque_noise_",
    "noise_floor_",
    "theta_unconstrained_",
    "theta_",
)


@pytest.fixture(scope="module")
def cluster():
    """Two processes of one thread; started once, since that takes seconds."""
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
    """One file a recording, but the last two in one."""
    for k in range(3):
        own = recording.groups == k if k < 2 else recording.groups >= 2
        more = {"segment": recording.groups[own]} if k == 2 else {}
        np.savez(
            folder / f"{k}.npz",
            q=recording.q[own],
            tau=recording.tau[own],
            dt=recording.dt,
            **more,
        )
    return folder


@pytest.fixture
def folder(recording, tmp_path):
    return save(recording, tmp_path)


def robot(recording, **settings):
    return RobotIdentifier(
        recording.urdf, dt=recording.dt, **{"friction": ("viscous",), **settings}
    )


def in_memory(recording, **settings):
    return robot(recording, **settings).fit(
        recording.q, recording.tau, groups=recording.groups
    )


def assert_same(found, expected):
    for name in FITTED:
        values, reference = getattr(found, name), getattr(expected, name)
        size = np.abs(reference).max()
        # rounding, three digits of it in parameters that the data hardly tell apart
        assert_allclose(values, reference, rtol=0, atol=1e-10 * size, err_msg=name)
    free = expected.identifiable_
    values, reference = found.theta_std_[free], expected.theta_std_[free]
    assert_allclose(values, reference, rtol=1e-6, err_msg="theta_std_")
    apart = found.theta_ - expected.theta_
    metric = expected.estimator_.metric_
    torque = expected.theta_ @ metric @ expected.theta_
    assert abs(apart @ metric @ apart) <= 1e-18 * torque
    for name in ("n", "n_rows", "yy", "g", "G", "noise"):
        values = getattr(found.estimator_.statistics_, name)
        reference = getattr(expected.estimator_.statistics_, name)
        if reference is None:
            assert values is None
            continue
        size = np.abs(reference).max()
        assert_allclose(values, reference, rtol=0, atol=1e-10 * size, err_msg=name)


# -- recordings


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"cutoff": 4.0, "state_cutoff": 6.0, "standstill": 0.01},
        {"cutoff": None, "input_noise": None, "standstill": None},
    ],
)
def test_files_are_the_recordings_in_memory(recording, folder, settings):
    found = fit_recordings(robot(recording, **settings), folder)
    expected = in_memory(recording, **settings)
    assert_same(found, expected)
    for one, other in zip(found.effect_ranges_, expected.effect_ranges_):
        assert_allclose(one.position, other.position, rtol=1e-9)
        assert_allclose(one.speed, other.speed, rtol=1e-6, atol=1e-9)
    assert found.n_features_in_ == 6
    assert found.predict(recording.q[:50]).shape == (50, 6)


def test_a_list_of_files_in_any_order(recording, folder):
    files = sorted(folder.iterdir())[::-1]
    assert_same(fit_recordings(robot(recording), files), in_memory(recording))


def dying(function, marker):
    """Let the process that is first to finish a task die before it can tell."""

    def run(*arguments, **named):
        result = function(*arguments, **named)
        try:
            marker.touch(exist_ok=False)
        except FileExistsError:
            return result
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError("the process must have died")

    return run


def test_a_worker_that_dies_changes_nothing(
    monkeypatch, cluster, recording, folder, tmp_path_factory
):
    marker = tmp_path_factory.mktemp("killed") / "marker"
    workers = set(cluster.scheduler_info()["workers"])
    monkeypatch.setattr(passes, "_moments", dying(passes._moments, marker))
    found = fit_recordings(robot(recording), folder)
    assert marker.exists()
    assert_same(found, in_memory(recording))
    # the nanny has put another process in its place, at another address
    cluster.wait_for_workers(2, timeout=600)
    assert set(cluster.scheduler_info()["workers"]) != workers


# -- the loop


def loop(recording):
    """Return a loop that looks for one effect on each joint."""
    return EffectDiscovery(robot(recording), effects=["spring"])


def sprung(recording):
    """Return the recording of a robot with a spring on joint 2, which nothing says."""
    tau = recording.tau.copy()
    tau[:, 1] += 4.0 * recording.q[:, 1]
    return replace(recording, tau=tau)


def assert_same_loop(found, expected):
    assert [repr(e) for e in found.effects_] == [repr(e) for e in expected.effects_]
    for name in ("error_before_", "error_after_", "torque_spread_"):
        assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9)
    values, reference = found.identifier_.theta_, expected.identifier_.theta_
    assert_allclose(values, reference, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def closed(recording):
    own = sprung(recording)
    found = loop(own).fit(own.q, own.tau, groups=own.groups)
    assert [(e.name, e.joint) for e in found.effects_] == [("spring", 1)]
    return found


def test_the_loop_of_files_is_that_in_memory(cluster, recording, tmp_path, closed):
    source = save(sprung(recording), tmp_path)
    assert_same_loop(fit_recordings(loop(recording), source), closed)


@pytest.mark.parametrize("sizes", [(1, 1, 1, 1), (3, 1), (4,)])
def test_the_loop_does_not_know_the_files(recording, tmp_path, closed, sizes):
    own, labels = sprung(recording), list(recording.group_names)
    for k, size in enumerate(sizes):
        part = own.select(*labels[:size])
        del labels[:size]
        known = {"q": part.q, "tau": part.tau, "segment": part.groups}
        np.savez(tmp_path / f"{k}.npz", dt=part.dt, **known)
    found = fit_recordings(loop(recording), tmp_path)
    assert_same_loop(found, closed)
    assert str(found.report_) == str(closed.report_)


def test_the_loop_holds_a_piece_of_the_files_at_a_time(
    recording, tmp_path, monkeypatch
):
    source = save(sprung(recording), tmp_path)
    most, read = [], StoredRows.__array__

    def watched(rows, dtype=None, copy=None):
        if rows.ndim == 2:
            most.append(len(rows))
        return read(rows, dtype, copy)

    monkeypatch.setattr(StoredRows, "__array__", watched)
    monkeypatch.setattr(_discovery, "in_memory", in_pieces)
    monkeypatch.setattr(_inspect, "_AT_ONCE", 1)
    monkeypatch.setattr(_stored, "_AT_ONCE", 1000)
    fit_recordings(loop(recording), source)
    # The longest file holds two recordings.
    assert 0 < max(most) <= 2 * max(p.stop - p.start for p in recording.segments)


def in_pieces(recording):
    """Take a recording into memory by its segments."""
    if not recording.stored:
        return recording
    rows = np.arange(recording.n_samples)
    return take_rows(recording, rows, np.asarray(recording.groups))


def test_the_loop_does_not_notice_a_worker_that_dies(
    monkeypatch, cluster, recording, tmp_path_factory, closed
):
    source = save(sprung(recording), tmp_path_factory.mktemp("files"))
    for name in ("_load", "_alone"):
        marker = tmp_path_factory.mktemp("killed") / "marker"
        with monkeypatch.context() as patch:
            patch.setattr(passes, name, dying(getattr(passes, name), marker))
            found = fit_recordings(loop(recording), source)
        assert marker.exists()
        assert_same_loop(found, closed)
        cluster.wait_for_workers(2, timeout=600)


@pytest.fixture
def command(recording, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = sprung(recording).select(0)
    np.savez("arm.npz", q=own.q, tau=own.tau, dt=own.dt)
    return ["close-loop", "arm.npz", "--urdf", str(recording.urdf)]


def test_the_command_shares_its_work_out(command, capsys):
    short = ["--effects", "spring"]
    found = {}
    for name, more in (("alone", []), ("shared", ["--workers", "1"])):
        assert main([*command, *short, *more, "--out", name]) == 0
        told = capsys.readouterr().out.replace(name, "out")
        # What the workers cannot do is a note on the page.
        found[name] = re.sub(r" \(more; notes: \d+\)", " (more)", told)
    assert found["shared"] == found["alone"]


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("0", "at least one process; got 0"),
        ("tcp://127.0.0.1:1", "no Dask scheduler answers at 'tcp://127.0.0.1:1'"),
    ],
)
def test_workers_that_cannot_be_are_refused(command, capsys, where, message):
    assert main([*command, "--workers", where]) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.out == ""


def test_an_estimator_of_another_kind_is_refused(recording, folder):
    with pytest.raises(TypeError, match="RobotIdentifier or an EffectDiscovery"):
        fit_recordings(VBJFARegressor(), folder)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"regressor": Ridge()}, "does not support regressor"),
        ({"dt": 0.02}, r"npz: its dt is 0\.01 s but dt = 0\.02 s"),
    ],
)
def test_what_cannot_be_is_refused(recording, folder, settings, message):
    with pytest.raises(ValueError, match=message):
        fit_recordings(robot(recording).set_params(**settings), folder)


def test_sources_without_recordings_are_refused(recording, tmp_path):
    with pytest.raises(FileNotFoundError, match="No recording in"):
        fit_recordings(robot(recording), tmp_path)
    with pytest.raises(FileNotFoundError, match="is not a folder"):
        fit_recordings(robot(recording), tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="at least one file"):
        fit_recordings(robot(recording), [])


def test_torques_of_two_values_in_all_files_are_refused(recording, tmp_path):
    signs = replace(recording, tau=np.where(recording.tau > 0, 1.0, -1.0))
    with pytest.raises(ValueError, match="all joints has two values only"):
        fit_recordings(robot(recording), save(signs, tmp_path))


# -- bad files


def add_other_robot(recording, path):
    q = np.random.default_rng(0).normal(size=(100, 2))
    np.savez(path, q=q, tau=q, dt=recording.dt)
    return "2 column"


def add_broken(recording, path):
    np.savez(path, q=recording.q, tau=recording.tau, dt=recording.dt)
    path.write_bytes(path.read_bytes().replace(b"PK\x01\x02", b"PK\x00\x00"))
    return "is not a complete npz file"


def add_cut(recording, path):
    np.savez(path, q=recording.q, tau=recording.tau, dt=recording.dt)
    path.write_bytes(path.read_bytes()[:-2000])
    return "is not a complete npz file"


def add_slow(recording, path):
    np.savez(path, q=recording.q, tau=recording.tau, dt=2 * recording.dt)
    return "its dt is 0.02 s but dt = 0.01 s"


BAD = [add_other_robot, add_broken, add_cut, add_slow]


def model_of(robot, recording):
    """Let a robot be given as a model, of which workers know the joints alone."""
    return robot.set_params(model=recording.robot_model())


@pytest.mark.parametrize("add", BAD)
@pytest.mark.parametrize("as_model", [False, True])
def test_a_bad_file_is_named(recording, folder, add, as_model):
    reason = add(recording, folder / "1b.npz")
    own = robot(recording)
    if as_model:
        own = model_of(own, recording)
    for estimator in (own, EffectDiscovery(own)):
        with pytest.raises(ValueError, match=r"1b\.npz.*") as error:
            fit_recordings(estimator, folder)
        assert as_model or reason in str(error.value)


def test_bad_files_are_left_out_and_copies_taken_once(recording, folder, tmp_path):
    reasons = [add(recording, folder / f"0{k}.npz") for k, add in enumerate(BAD)]
    shutil.copy(folder / "1.npz", folder / "4.npz")
    files = [*sorted(folder.iterdir()), folder / ".." / folder.name / "0.npz"]
    with pytest.warns(DoubtWarning) as caught:
        found = fit_recordings(robot(recording), files, on_bad_files="warn")
    caught = [one for one in caught if one.category is DoubtWarning]
    *told, copies = [str(one.message) for one in caught]
    assert len(told) == len(BAD)
    for k, (text, reason) in enumerate(zip(told, reasons)):
        assert text.startswith(f"{folder / f'0{k}.npz'} is left out: ")
        assert reason in text
    assert f"{folder / '4.npz'} is a copy of {folder / '1.npz'}" in copies
    assert "0.npz is a copy of" in copies
    assert {one.filename for one in caught} == {__file__}
    assert_same(found, in_memory(recording))


def test_the_loop_leaves_bad_files_out_and_takes_copies_once(
    recording, tmp_path, closed
):
    source = save(sprung(recording), tmp_path)
    for k, add in enumerate(BAD):
        add(recording, source / f"0{k}.npz")
    shutil.copy(source / "2.npz", source / "4.npz")
    with pytest.warns(DoubtWarning) as caught:
        found = fit_recordings(loop(recording), source, on_bad_files="warn")
    told = [str(x.message) for x in caught if x.category is DoubtWarning]
    assert [text.split(": ")[0].rpartition("/")[2] for text in told] == [
        *(f"0{k}.npz is left out" for k in range(len(BAD))),
        "2.npz",
    ]
    assert_same_loop(found, closed)


@pytest.mark.parametrize("make", [robot, loop])
def test_bad_files_alone_are_refused(recording, tmp_path, make):
    add_broken(recording, tmp_path / "a.npz")
    add_slow(recording, tmp_path / "b.npz")
    with pytest.raises(ValueError, match=r"a\.npz: is not a complete npz file"):
        fit_recordings(make(recording), tmp_path, on_bad_files="warn")
    with pytest.raises(ValueError, match='on_bad_files must be "raise" or "warn"'):
        fit_recordings(make(recording), tmp_path, on_bad_files="skip")
    with pytest.raises(FileNotFoundError, match=r"c\.npz: no such file"):
        fit_recordings(make(recording), [tmp_path / "c.npz"], on_bad_files="warn")


def test_bags_among_the_files_are_read(recording, folder):
    pytest.importorskip("rosbags")
    part = recording.select(recording.group_names[0])
    (folder / "0.npz").unlink()
    t = recording.dt * np.arange(part.n_samples)
    said = states(t, recording.joint_names, part.q, part.tau)
    write_ros2(folder / "0", [said])
    assert_same(fit_recordings(robot(recording), folder), in_memory(recording))


# -- files that change


@pytest.mark.parametrize("name", ["_spectra", "_summarise", "_moments", "_noise"])
@pytest.mark.parametrize("other", [False, True])
def test_a_file_that_changes_between_passes_is_refused(
    recording, folder, monkeypatch, name, other
):
    made, path = getattr(passes, name), folder / "1.npz"

    def late(load, source, *rest):
        if other:
            add_other_robot(recording, path)
        else:
            rows = slice(0, 300)
            q, tau = recording.q[rows], 1.2 * recording.tau[rows]
            np.savez(path, q=q, tau=tau, dt=recording.dt)
        return made(load, source, *rest)

    monkeypatch.setattr(passes, name, late)
    with pytest.raises(ValueError, match=r"1\.npz has changed since it was first read"):
        fit_recordings(robot(recording), folder, on_bad_files="warn")


def test_copies_of_a_file_may_have_other_times(recording, folder, monkeypatch):
    made = passes._spectra

    def elsewhere(load, source, *rest):
        os.utime(source.path, (0, 0))
        return made(load, source, *rest)

    monkeypatch.setattr(passes, "_spectra", elsewhere)
    assert_same(fit_recordings(robot(recording), folder), in_memory(recording))


# -- arrays


def rows(n=1000):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n, 4)) + [0.0, 10.0, -3.0, 0.5]
    y = X @ [1.0, -2.0, 0.5, 0.0] + 0.1 * rng.normal(size=n)
    return X, y, rng.uniform(0.0, 2.0, n)


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize(
    "model", [JFARegressor(input_noise=0.1), VBJFARegressor(input_noise=0.0)]
)
@pytest.mark.parametrize("chunks", [(100, 4), ((1, 99, 900), (2, 2)), (1000, 1)])
def test_arrays_are_the_rows_in_memory(model, chunks, weighted):
    X, y, weight = rows()
    arrays = [da.from_array(X, chunks=chunks), da.from_array(y, chunks=137)]
    if weighted:
        weight[:100] = 0.0  # a block without weight
        arrays.append(da.from_array(weight, chunks=250))
    found = fit_array(model.__class__(**model.get_params()), *arrays)
    whole = model.__class__(**model.get_params())
    whole.fit(X, y, sample_weight=weight if weighted else None)
    for name in ("n_rows", "n_samples", "x_mean", "y_mean", "S_xx", "S_xy", "S_yy"):
        expected = getattr(whole.statistics_, name)
        atol = 1e-10 * np.abs(expected).max()
        assert_allclose(getattr(found.statistics_, name), expected, rtol=0, atol=atol)
    assert_allclose(found.coef_, whole.coef_, rtol=0, atol=1e-8)
    assert_array_equal(found.predict(X[:3]).shape, (3,))


def test_arrays_on_the_cluster(cluster):
    X, y, _ = rows()
    found = fit_array(
        JFARegressor(input_noise=0.1),
        da.from_array(X, chunks=(100, 4)),
        da.from_array(y, chunks=100),
    )
    whole = JFARegressor(input_noise=0.1).fit(X, y)
    assert_allclose(found.coef_, whole.coef_, rtol=0, atol=1e-8)


def test_bad_arrays_are_refused():
    X, y, weight = rows()
    blocks = da.from_array(X, chunks=(100, 4)), da.from_array(y, chunks=100)
    with pytest.raises(TypeError, match="X must be a Dask array, got ndarray"):
        fit_array(JFARegressor(), X, blocks[1])
    with pytest.raises(TypeError, match="VBJFARegressor or JFARegressor"):
        fit_array(Ridge(), *blocks)
    with pytest.raises(ValueError, match="y must have the shape"):
        fit_array(JFARegressor(), blocks[0], blocks[1][:-1])
    with pytest.raises(ValueError, match="NaN"):
        fit_array(JFARegressor(), da.where(blocks[0] > 11, np.nan, blocks[0]), y_of(y))
    with pytest.raises(ValueError, match="at least 2 rows"):
        fit_array(JFARegressor(), *blocks, da.zeros_like(blocks[1]))
    with pytest.raises(ValueError, match=r"[Nn]egative"):
        fit_array(JFARegressor(), *blocks, -da.from_array(weight, chunks=100))


def y_of(y):
    return da.from_array(y, chunks=100)
