"""Other methods are judged on the rows that the loop left untouched."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_loop_time
import bench_measured_sets as bench

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording

QUICK = {"effects": ["coulomb"], "max_effects": 1}


def test_sets_are_ten_and_apart():
    from sklearn_vbjfa.datasets._catalogue import protocols

    development, confirmation = map(set, bench.SETS.values())
    assert not development & confirmation
    assert development | confirmation == set(protocols()) - {"demo"}


def test_methods_are_judged_beside_the_loop():
    recording = make_robot_recording(duration=12.0, dt=0.01, random_state=0)
    identifier = RobotIdentifier(recording.robot_model(), dt=recording.dt, cutoff=5.0)
    parts = recording.q, recording.tau, recording.groups
    result = bench.judge_set(*parts, identifier, names=("WLS", "PLS"), **QUICK)
    errors = result["errors"]
    assert list(errors) == ["declared", "completed", "WLS", "PLS"]
    assert all(np.all(np.isfinite(x)) for x in errors.values())
    # least squares has what the declared model has, but for its projection
    np.testing.assert_allclose(errors["WLS"], errors["declared"], rtol=0.5)
    text = bench.report([{"set": "made up", **result}])
    assert "completed better in the mean than" in text
    assert "1 of 1" in text or "0 of 1" in text


def test_rows_that_are_not_the_loops_are_refused(monkeypatch):
    recording = make_robot_recording(duration=12.0, dt=0.01, random_state=0)
    identifier = RobotIdentifier(recording.robot_model(), dt=recording.dt, cutoff=5.0)
    parts = recording.q, recording.tau, recording.groups
    split_of = bench.split_of
    monkeypatch.setattr(bench, "split_of", lambda *x: split_of(*x)[::-1])
    with pytest.raises(RuntimeError, match="not the same rows"):
        bench.judge_set(*parts, identifier, names=("WLS",), **QUICK)


def test_loop_time_of_a_small_robot():
    case = bench_loop_time.many(seconds=6.0, arms=1)
    assert case.q.shape == (1200, 6)
    label, settings = bench_loop_time.ceilings()[0]
    found = bench_loop_time.measure(case, **QUICK, **settings)
    loop, seconds, processor, channels = found
    assert 0 < channels < seconds
    assert processor > 0
    cells = bench_loop_time.row("one arm", label, case, *found)
    assert cells[2] == 6
    assert len(cells) == len(bench_loop_time.HEADERS)
    # the strange torques are there, and have no name
    assert len(loop.unexplained_) == 6
