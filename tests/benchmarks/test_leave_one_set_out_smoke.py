"""Pairs are judged beside least squares, and settings on sets that did not choose."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_leave_one_set_out as bench
from _ledger import Ledger

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording, make_robot_recording

pytestmark = pytest.mark.filterwarnings("ignore:.*time stamps are irregular")


def test_sets_are_ten():
    import bench_measured_sets

    known = {name for names in bench_measured_sets.SETS.values() for name in names}
    assert set(bench.SETS) == known
    assert len(bench.SETS) == 10


def test_pairs_are_judged_and_kept(tmp_path, capsys):
    ledger = Ledger(tmp_path / "results.jsonl", bench.KEYS)
    recording = load_demo_recording()
    asked = {"recording": recording, "effects": ["load_friction"]}
    bench.run_set("kuka_kr300", ["default"], ledger, **asked)
    assert [r["pair"] for r in ledger.results] == list(recording.group_names)
    for result in ledger.results:
        assert "error" not in result
        assert result["effects"] == ["load_friction 2"]
        errors = [np.array(result[x]) for x in ("least_squares", "completed")]
        # it is there in both recordings
        assert errors[1][1] < 0.5 * errors[0][1]
        assert bench.ratio(result, counted=False) == pytest.approx(
            errors[1].mean() / errors[0].mean()
        )
    # what is on file is not run again
    bench.run_set("kuka_kr300", ["default"], ledger, **asked)
    assert len(ledger.results) == 2
    assert "load_friction 2; perhaps nothing" in capsys.readouterr().out
    assert "2 / 0" in bench.report(ledger.results)


def test_a_motion_is_judged_on_its_held_out_part():
    recording = make_robot_recording(duration=12.0, dt=0.01, random_state=0)
    identifier = RobotIdentifier(
        recording.robot_model(), dt=recording.dt, friction=("viscous",), cutoff=5.0
    )
    parts = recording.q, recording.tau, recording.groups
    result = bench.judge_held_out(parts, identifier, effects=["coulomb"])
    assert result["effects"] == result["perhaps"] == []
    assert all(result["counted"])
    # the four terms are all that there is in both
    assert 0.5 < bench.ratio(result) < 2.0


def made_up(settings, name, pair, completed, counted=(True, True), **more):
    """Make the result of a pair; least squares has 40 and 20 %."""
    return {
        "settings": settings,
        "values": [],
        "set": name,
        "pair": pair,
        "least_squares": [0.4, 0.2],
        "completed": list(completed),
        "counted": list(counted),
        "effects": ["ripple 1"],
        "perhaps": ["spring 1", "spring 2"],
        "seconds": 1.0,
        **more,
    }


def test_ratios_are_of_what_counts():
    result = made_up("default", "emps", "A", (0.1, 0.2), (False, True))
    assert bench.ratio(result) == 1.0
    assert bench.ratio(result, counted=False) == pytest.approx(0.5)
    lost = made_up("default", "emps", "A", (0.1, np.nan))
    assert bench.ratio(lost) == pytest.approx(0.25)
    nowhere = made_up("default", "emps", "B", (0.1, 0.2), (False, False))
    assert np.isnan(bench.ratio(nowhere))


def test_settings_are_chosen_on_the_other_sets(monkeypatch):
    monkeypatch.setattr(bench, "SETTINGS", {"default": {}, "wide": {}, "odd": {}})
    results = []
    for name, shares in {
        # wide is best on one set by far, and a little worse on the others
        "emps": {"default": 0.9, "wide": 0.1, "odd": 0.05},
        "ur5": {"default": 0.6, "wide": 0.7, "odd": 0.05},
        "tiago": {"default": 0.6, "wide": 0.7},
    }.items():
        for settings, share in shares.items():
            completed = (0.4 * share, 0.2 * share)
            results.append(made_up(settings, name, "A", completed))
    results.append(made_up("default", "emps", "B", (0.1, 0.1), (False, False)))
    results.append(made_up("wide", "emps", "B", (0.1, 0.1), (False, False)))
    odd = {"error": "ValueError: too short"}
    results.append(made_up("odd", "emps", "B", (), **odd))
    found = bench.ratios(results)
    assert found["default"] == pytest.approx({"emps": 0.9, "ur5": 0.6, "tiago": 0.6})
    # ended in an error on one set, was not run on another
    assert found["odd"]["emps"] == np.inf
    assert np.isnan(found["odd"]["tiago"])
    assert bench.best_on_the_others(found, "emps") == "default"
    assert bench.best_on_the_others(found, "ur5") == "wide"
    assert bench.best_on_the_others({"default": {"emps": 1.0}}, "emps") is None
    rows = {row[0]: row for row in bench.summary(results, found)}
    assert rows["emps"][1:3] == [2, 1]
    assert rows["emps"][5:] == ["0.90", "0.90", "default", "2 / 4"]
    assert rows["ur5"][5:] == ["0.60", "0.70", "wide", "1 / 2"]
    assert rows["mean"][5:7] == ["0.70", "0.77"]
    text = bench.report(results)
    assert "emps, B, odd, failed: ValueError: too short" in text
    assert "(10.0) (10.0)" in text


def test_values_of_settings_are_part_of_the_key(monkeypatch):
    from sklearn_vbjfa import diagnosis

    monkeypatch.setattr(diagnosis, "SearchSettings", SimpleNamespace, raising=False)
    assert bench.arguments_of({}) == {}
    assert bench.arguments_of({"prior": 0.1})["settings"].prior == 0.1
    ledger = Ledger(None, bench.KEYS)
    monkeypatch.setattr(bench, "SETTINGS", {"default": {}, "tight": {"prior": 0.1}})
    task = bench.task_of("tight", "emps", "PULSES")
    values = {"values": task["values"]}
    ledger.add(made_up("tight", "emps", "PULSES", (0.1, 0.1), **values))
    assert not ledger.missing([task])
    assert set(bench.ratios(ledger.results)) == {"tight"}
    monkeypatch.setattr(bench, "SETTINGS", {"default": {}, "tight": {"prior": 0.2}})
    assert ledger.missing([bench.task_of("tight", "emps", "PULSES")])
    assert set(bench.ratios(ledger.results)) == {"tight (prior = 0.1)"}
