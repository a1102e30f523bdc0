"""Several files of one robot as one recording: names, periods, mismatches."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest

from sklearn_vbjfa.datasets import read_recording
from sklearn_vbjfa.model import DoubtWarning
from tests.recording.test_reader import N, table, write


@pytest.fixture
def runs_folder(tmp_path, monkeypatch):
    """Change into a folder that contains the folder runs."""
    monkeypatch.chdir(tmp_path)
    Path("runs").mkdir()
    return tmp_path


def motion(phase, **options):
    """Return the columns of another motion of the same robot."""
    columns = table(**options)
    for j in (1, 2):
        columns[f"q{j}"] = columns[f"q{j}"] + phase * np.sin(5 * columns["t"])
    return columns


def files(**tables):
    """Write each table to a file in the folder runs."""
    return [str(write(Path(f"runs/{name}.csv"), x)) for name, x in tables.items()]


def read(paths, **options):
    """Return the recording and each warning with whether it is a DoubtWarning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(paths, **options)
    return recording, [(str(x.message), x.category is DoubtWarning) for x in caught]


def segments(columns, *labels):
    """Label equal parts of a table."""
    return columns | {"segment": np.repeat(labels, len(columns["t"]) // len(labels))}


def error_of(paths, message, **options):
    """Return the one line of the error, which must contain the message."""
    with pytest.raises(ValueError, match=re.escape(message)) as error:
        read_recording(paths, **options)
    (line,) = str(error.value).splitlines()
    return line


def test_recordings_are_named_after_their_files(runs_folder):
    tables = {"slow": motion(0.1), "fast": motion(0.2)}
    paths = files(**tables)
    recording, notes = read(paths)
    assert notes == []
    assert recording.name == "runs"
    assert recording.group_names == ("slow", "fast")
    assert recording.description == "Read from slow.csv, fast.csv."
    for path, name in zip(paths, ("slow", "fast")):
        alone, part = read_recording(path), recording.select(name)
        for key in ("q", "tau", "v", "t"):
            np.testing.assert_array_equal(getattr(part, key), getattr(alone, key))
    assert read_recording(paths[:1]).group_names == ("slow",)


def test_recordings_in_one_file_keep_their_names(runs_folder):
    gap = motion(0.3, n=3 * N)
    gap = {name: np.delete(column, slice(N, 2 * N)) for name, column in gap.items()}
    paths = files(two=segments(motion(0.1), "up", "down"), one=motion(0.2), gap=gap)
    recording, notes = read(paths)
    assert recording.group_names == ("two up", "two down", "one", "gap [1]", "gap [2]")
    assert recording.select("two down").n_samples == N // 2
    ((note, doubt),) = notes
    assert note.startswith("runs/gap.csv: 1 gap(s) of 5 periods or more")
    assert doubt


def test_signals_missing_in_one_file_are_left_out(runs_folder):
    n = np.arange(N)
    tables = {
        "a": motion(0.1) | {"warm": 1.0 * n, "volt": 2.0 * n, "state": 3.0 * n},
        "b": motion(0.2) | {"warm": 5.0 * n, "state": ["run"] * N, "load": 4.0 * n},
    }
    recording, notes = read(files(**tables))
    assert list(recording.signals) == ["warm"]
    np.testing.assert_array_equal(recording.signals["warm"], np.r_[n, 5 * n])
    missing = "column(s) volt, state, load are not in all files and are left out."
    assert (missing, False) in notes


def part_of(columns, start, stop):
    return {name: column[start:stop] for name, column in columns.items()}


def test_samples_of_two_recordings_are_refused(runs_folder):
    long = noisy(0.01)
    # Each sample is written twice.
    held = {name: np.repeat(x, 2) for name, x in long.items()} | {
        "t": 0.01 * np.arange(4000)
    }
    for a, b, lines in (
        (
            long,
            long,
            "line 2 to line 2001: the same samples as {}, line 2 to line 2001",
        ),
        (
            part_of(long, 0, 1200),
            part_of(long, 500, 2000),
            "line 2 to line 701: the same samples as {}, line 502 to line 1201",
        ),
        (held, part_of(held, 1000, 4000), "line 2 to line 3000: the same samples as"),
    ):
        paths = files(a=a, b=b)
        line = error_of(paths, f"runs/b.csv, {lines.format('runs/a.csv')}")
        assert line.endswith("delete them in one file, or leave that file out.")
    half = part_of(long, 0, 1000)
    twice = {name: np.r_[x, x] for name, x in half.items()} | {"t": long["t"]}
    error_of(files(a=segments(twice, "x", "y")), "runs/a.csv, line 1002 to line 2001")


def test_recordings_may_rest_at_the_same_place(runs_folder):
    rest = {name: np.full(200, x[0]) for name, x in noisy(0.01).items()}
    x = [
        {k: np.r_[rest[k], column] for k, column in noisy(0.01, seed).items()}
        | {"t": 0.01 * np.arange(2200)}
        for seed in (0, 1)
    ]
    assert read_recording(files(a=x[0], b=x[1])).n_samples == 4400


def noisy(dt, seed=0, n=2000):
    """Return the columns of two joints with a torque noise of 0.1."""
    t, rng = dt * np.arange(n), np.random.default_rng(seed)
    q = np.sin(np.outer(t, [2.0, 3.0]))
    tau = np.cos(np.outer(t, [2.0, 3.0])) + 0.1 * rng.normal(size=q.shape)
    return {"t": t} | {
        f"{name}{j + 1}": x[:, j]
        for name, x in (("q", q), ("tau", tau))
        for j in (0, 1)
    }


def test_nearly_equal_periods_are_resampled(runs_folder):
    paths = files(a=noisy(0.01), b=noisy(0.01, 1), c=noisy(0.010047, 2))
    recording = read_recording(paths)
    assert recording.dt == pytest.approx(0.01)
    part = recording.select("c")
    assert part.n_samples == 2009  # 1999 periods of 10.047 ms
    np.testing.assert_allclose(part.q[:, 0], np.sin(2 * part.t), atol=1e-6)
    # Interpolated torques have less noise than measured ones.
    np.testing.assert_allclose(recording.torque_noise, 0.1, rtol=0.1)
    assert read_recording(paths[:2]).torque_noise is None


def test_noise_before_interpolation_is_pooled_over_files(runs_folder):
    x = {name: noisy(0.01, seed) for seed, name in enumerate("abc")}
    for name, rows in (("b", [500]), ("c", [700, 900])):
        x[name] = {key: np.delete(column, rows) for key, column in x[name].items()}
    x["c"] |= {key: 3 * x["c"][key] for key in ("tau1", "tau2")}
    paths = files(**x)
    alone = [read_recording(path).torque_noise for path in paths[1:]]
    noise = read_recording(paths).torque_noise
    np.testing.assert_allclose(noise, np.sqrt(np.mean(np.square(alone), axis=0)))


def test_different_periods_are_refused(runs_folder):
    paths = files(a=noisy(0.01), b=noisy(0.01005), c=noisy(0.005))
    line = error_of(paths, "runs/c.csv has a sample period of 0.005 s")
    assert "runs/b.csv one of 0.01005 s: resample" in line


def without(columns, *names):
    return {key: column for key, column in columns.items() if key not in names}


DIFFERENT = {
    "joints": (
        motion(0.1),
        motion(0.2) | {"q3": np.ones(N), "v3": np.ones(N), "tau3": np.ones(N)},
        {},
        "has the joint names joint_1, joint_2 and {} joint_1, joint_2, joint_3",
    ),
    "units of positions": (
        without(motion(0.1), "v1", "v2"),
        {
            name.replace("q2", "q2 [mm]").replace("tau2", "tau2 [N]"): column
            for name, column in without(motion(0.2), "v1", "v2").items()
        },
        {},
        "has the position units rad, rad and {} rad, m",
    ),
    "currents": (
        motion(0.1),
        {f"{k} [A]" if "tau" in k else k: x for k, x in motion(0.2).items()},
        {"gains": "unknown"},
        "has the torque units N m, N m and {} A, A",
    ),
}


@pytest.mark.parametrize("kind", DIFFERENT)
def test_mismatching_files_are_refused(kind, runs_folder):
    first, second, options, message = DIFFERENT[kind]
    paths = files(a=first, b=motion(0.3), odd=second)
    if kind == "units of positions":
        paths = files(a=first, odd=second)
    message = f"runs/a.csv {message.format('runs/odd.csv')}; expected "
    line = error_of(paths, message, **options)
    assert line.startswith(message)
    assert "correct one of them" in line
