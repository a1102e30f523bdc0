"""Other methods are judged on the rows that the loop held out."""

import importlib
import re

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_long_recordings
import bench_loop_time
import bench_measured_sets as bench
from _ledger import Ledger

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording

QUICK = {"effects": ["coulomb"], "max_effects": 1}


def test_sets_are_ten_and_apart():
    from sklearn_vbjfa.datasets import protocols

    development, confirmation = map(set, bench.SETS.values())
    assert not development & confirmation
    # The Go2 came after the protocol of the ten was frozen.
    later = {"demo", "unitree_go2"}
    assert development | confirmation == set(protocols()) - later


def test_methods_are_judged_beside_the_loop():
    recording = make_robot_recording(duration=12.0, dt=0.01, random_state=0)
    identifier = RobotIdentifier(
        recording.robot_model(), dt=recording.dt, friction=bench.DECLARED, cutoff=5.0
    )
    parts = recording.q, recording.tau, recording.groups
    result = bench.judge_set(*parts, identifier, names=("WLS", "PLS"), **QUICK)
    errors = result["errors"]
    assert list(errors) == ["declared", "four terms", "completed", "WLS", "PLS"]
    assert all(np.all(np.isfinite(x)) for x in errors.values())
    # least squares has the four terms as well, but no projection
    np.testing.assert_allclose(errors["WLS"], errors["four terms"], rtol=0.5)
    assert (np.array(errors["four terms"]) < errors["declared"]).all()
    text = bench.report([{"set": "made up", **result}])
    assert "completed better than" in text


def test_who_is_better_than_the_completed_model_is_said():
    errors = {
        "declared": [0.5, 0.3],
        "four terms": [0.1, 0.3],
        "completed": [0.2, 0.22],
        "LASSO": [0.205, 0.214],
    }
    more = {"failures": {}, "effects": [], "cutoff": 5.0, "seconds": 1.0}
    text = bench.report([{"set": "made up", "errors": errors, **more}])
    assert "Better than the completed model (21.0 %) in the mean of made up" in text
    assert "made up: four terms (20.0 %)." in text
    cells = [line.split() for line in text.splitlines()]
    assert ["declared", "1", "of", "1", "2", "of", "2"] in cells
    # better in the mean by less than a per cent, on one joint of two
    assert ["LASSO", "0", "of", "1", "1", "of", "2"] in cells


def test_rows_that_are_not_the_loops_are_refused(monkeypatch):
    recording = make_robot_recording(duration=12.0, dt=0.01, random_state=0)
    identifier = RobotIdentifier(
        recording.robot_model(), dt=recording.dt, friction=bench.DECLARED, cutoff=5.0
    )
    parts = recording.q, recording.tau, recording.groups
    split_of = bench.split_of
    monkeypatch.setattr(bench, "split_of", lambda *x: split_of(*x)[::-1])
    with pytest.raises(RuntimeError, match="not the same rows"):
        bench.judge_set(*parts, identifier, names=("WLS",), **QUICK)


def test_loop_time_of_a_small_robot():
    case = bench_loop_time.many(seconds=6.0, arms=1)
    assert case.q.shape == (1200, 6)
    found = bench_loop_time.measure(case, **QUICK)
    loop, seconds, processor, channels = found
    assert 0 < channels < seconds
    assert processor > 0
    cells = bench_loop_time.row("one arm", case, *found)
    assert cells[1] == 6
    assert len(cells) == len(bench_loop_time.HEADERS)
    # the strange torques are there, and have no name
    assert len(loop.unexplained_) == 6


def test_long_recordings_of_small_robots():
    cases = bench_long_recordings.QUICK
    ledger = Ledger(None, ("case",))
    text = bench_long_recordings.report(cases, list(cases), ledger)
    assert text.count("stribeck") == len(cases)
    # two lengths of one robot are needed
    assert "to the power" not in text


def test_growth_is_that_of_a_power_and_is_drawn(monkeypatch):
    cases, lengths = bench_long_recordings.CASES, bench_long_recordings.LENGTHS
    ledger = Ledger(None, ("case",))
    stages = dict.fromkeys([*bench_long_recordings.STAGES, "rest"], 0.0)
    for name, (arms, rows) in cases.items():
        power = {"seconds": 1e-3 * rows, "gigabytes": 0.01 * rows**0.5}
        if name not in lengths:
            power = {"seconds": sum(arms) ** 1.5, "gigabytes": 0.1 * sum(arms)}
        more = {"processor": 1.0, "named": [], "error": [0.1, 0.1], "stages": stages}
        ledger.add({"case": name, **power, **more})
    # what is fixed shows in the smallest, which are not asked
    for figures in ledger.results:
        if figures["case"] in ("7 joints, 1 min", "3 joints"):
            figures |= {"seconds": 1e9, "gigabytes": 1e9}
    text = bench_long_recordings.report(cases, [], ledger)
    said = [line for line in text.splitlines() if "to the power" in line]
    assert [re.findall(r"of (\d\.\d+)", line) for line in said] == [
        ["1.00", "0.50"],
        ["1.50", "1.00"],
    ]
    # the picture has both
    monkeypatch.syspath_prepend(bench_long_recordings.PICTURE.parent)
    drawing = importlib.import_module(bench_long_recordings.PICTURE.stem)
    axes = drawing.draw(drawing.figures_of(text), drawing.with_powers(text)).axes
    labels = [words.get_text() for axis in axes for words in axis.texts]
    powers = [re.search(r"\{(.*)\}", label)[1] for label in labels]
    assert powers == ["1.00", "0.50", "1.50", "1.00"]
    assert [len(line.get_xdata()) for line in axes[1].lines] == [4, 4]
