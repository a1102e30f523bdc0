"""Rows that are read when they are looked at are those in memory."""

import contextlib
import pickle
import tempfile
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sklearn_vbjfa.datasets import make_robot_recording, read_recording
from sklearn_vbjfa.recording import (
    Shelf,
    StoredRows,
    in_memory,
    on_disk,
    put_together,
    store,
    take_rows,
)
from sklearn_vbjfa.robot._recording_checks import check_weight

N = 20_000
ROWS = np.random.default_rng(0).normal(size=(N, 3))
EVERY = slice(None)
KEYS = {
    "all": EVERY,
    "some": slice(7, 11_000),
    "none": slice(5, 5),
    "from the end": slice(-100, None),
    "every third": slice(1, 5000, 3),
    "a row": 17,
    "the last": -1,
    "a value": (17, 2),
    "a column": (EVERY, 1),
    "columns": (slice(30, 9000), slice(1, 3)),
    "numbers": np.array([3, 4, 5, 19_000, 12, 3]),
    "no numbers": np.empty(0, dtype=int),
    "marks": ROWS[:, 0] > 1.0,
}


def stored():
    """Rows on disk, in three files and a piece that is in memory."""
    one, other = Shelf(), Shelf()
    last, parts = one.put(ROWS[9001:]), [other.put(ROWS[:100]), one.put(ROWS[100:9000])]
    return put_together([*parts, ROWS[9000:9001], last])


@pytest.mark.parametrize("key", KEYS.values(), ids=KEYS.keys())
def test_pieces_are_those_of_an_array(key):
    found = stored()[key]
    assert_array_equal(np.asarray(found), ROWS[key])
    assert np.shape(found) == ROWS[key].shape


def test_a_slice_of_a_slice_is_not_read():
    rows = stored()
    rows._read = None  # nothing can be read
    assert rows[200:400][10:20, 1:].shape == (10, 2)


def test_it_computes_as_an_array_does():
    rows = stored()
    assert_array_equal(2.0 * rows - ROWS, ROWS)
    assert_array_equal(np.abs(rows[:50]), np.abs(ROWS[:50]))
    assert_array_equal(pickle.loads(pickle.dumps(rows[10:20])), ROWS[10:20])
    assert len(rows) == N
    assert rows.ndim == 2
    assert rows.size == ROWS.size


def test_rows_without_room():
    ones = StoredRows.constant(1.0, (10**9, 7))
    assert ones[500:503].shape == (3, 7)
    some = np.asarray(ones[10**8 : 10**8 + 2])
    assert_array_equal(some, np.ones((2, 7)))
    # Sums go through rows of another layout in another order, and are rounded so.
    assert some.strides == np.ones((2, 7)).strides
    clock = StoredRows.clock(10**9, 0.001)
    assert clock[5_000_000] == 5_000_000 * 0.001


def test_arrays_in_memory_stay_there():
    assert isinstance(put_together([ROWS[:3], ROWS[3:]]), np.ndarray)


def test_weights_that_nobody_gave_take_no_memory():
    shape = (10**12, 7)
    ones = check_weight(None, shape)
    assert ones.shape == shape
    parts = [ones[:10], ones[:0], ones[50:]]
    together = put_together(parts)
    assert together.shape == (10**12 - 40, 7)
    assert_array_equal(together[:12], np.ones((12, 7)))
    # but where they differ
    other = np.broadcast_to(2.0, (3, 7))
    assert_array_equal(put_together([ones[:2], other])[:, 0], [1, 1, 2, 2, 2])
    some = np.arange(21.0).reshape(3, 7)
    assert_array_equal(put_together([ones[:1], some])[1:], some)
    nothing = put_together([ones[:0], ones[:0]])
    assert nothing.shape == (0, 7)


@pytest.fixture(scope="module")
def recording():
    pytest.importorskip("pinocchio")
    found = make_robot_recording(duration=3.0, dt=0.01, n_recordings=3, random_state=0)
    # Files have positions alone.
    return replace(found, states=None)


def assert_same(found, expected):
    for name in ("q", "tau", "groups"):
        assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.segments == expected.segments


def test_a_recording_on_disk_is_that_in_memory(recording):
    kept = on_disk(recording, Shelf())
    assert kept.stored
    assert not recording.stored
    assert_same(kept, recording)
    assert_same(in_memory(kept), recording)
    assert not in_memory(kept).stored


@pytest.mark.parametrize("sizes", [(1, 1, 1), (2, 1), (3,)])
def test_many_recordings_are_one(recording, sizes):
    names, parts = list(recording.group_names), []
    for size in sizes:
        parts.append(recording.select(*names[:size]))
        del names[:size]
    warm = [
        replace(one, signals={"heat": one.q[:, 0], f"own {k}": one.q[:, 1]})
        for k, one in enumerate(parts)
    ]
    found = store(warm)
    assert_same(found, recording)
    assert_array_equal(found.signals["heat"], recording.q[:, 0])
    assert len(found.signals) == 1 + (len(sizes) == 1)


def test_slices_of_a_stored_recording_are_read_later(recording):
    slices = [slice(3, 50), slice(60, 290), slice(310, 420)]
    rows = np.concatenate([np.arange(s.start, s.stop) for s in slices])
    labels = np.repeat(np.arange(3), [s.stop - s.start for s in slices])
    found = take_rows(on_disk(recording, Shelf()), slices, range(3))
    assert found.stored
    expected = take_rows(recording, rows, labels)
    assert_same(found, expected)
    assert_same(take_rows(recording, slices, range(3)), expected)


def test_files_that_are_kept_on_disk(recording, tmp_path):
    files = []
    for k, name in enumerate(recording.group_names):
        part = recording.select(name)
        files.append(tmp_path / f"{k}.npz")
        # The last one has a period that differs a little: it is interpolated.
        np.savez(files[-1], q=part.q, tau=part.tau, dt=0.01 * (1 + 0.002 * (k == 2)))
    with pytest.warns(UserWarning, match="interpolated to the sample period"):
        found = read_recording(files, stored=True)
    with pytest.warns(UserWarning, match="interpolated to the sample period"):
        expected = read_recording(files)
    assert found.stored
    assert_same(found, expected)
    assert found.group_names == expected.group_names
    assert_array_equal(found.torque_noise, expected.torque_noise)


def test_a_copy_among_stored_files_is_taken_once(recording, tmp_path):
    part = recording.select(0)
    files = [tmp_path / f"{k}.npz" for k in range(2)]
    for file in files:
        np.savez(file, q=part.q, tau=part.tau, dt=0.01)
    with pytest.warns(UserWarning, match="copy of"):
        assert read_recording(files, stored=True).n_samples == part.n_samples


# -- a disk without room ---------------------------------------------------------------


@contextlib.contextmanager
def room_for(size):
    """Let no file become larger than so many bytes."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("n", [40, 4000])
def test_rows_without_room_are_refused_when_they_are_put(n):
    # Few rows fit into a buffer, and would fail when they are read.
    shelf = Shelf()
    kept = shelf.put(ROWS[:8])
    with (
        pytest.raises(OSError, match="TMPDIR name a folder with room") as error,
        room_for(8 * 3 * (n - 1)),
    ):
        shelf.put(ROWS[:n])
    assert error.value.filename == tempfile.gettempdir()
    assert len(kept) == 8


def test_a_folder_that_cannot_be_is_named(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "file"))
    with pytest.raises(OSError, match="TMPDIR name a folder") as error:
        Shelf().put(ROWS)
    assert error.value.filename == str(tmp_path / "file")


def test_a_full_disk_is_no_fault_of_a_file(recording, tmp_path):
    files = [tmp_path / f"{k}.npz" for k in range(3)]
    for k, file in enumerate(files):
        part = recording.select(k)
        np.savez(file, q=part.q, tau=part.tau, dt=0.01)
    with (
        pytest.raises(OSError, match="let the environment variable TMPDIR"),
        room_for(3 * recording.select(0).q.nbytes),
    ):
        read_recording(files, stored=True, on_bad_files="warn")
