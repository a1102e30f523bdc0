"""Whole robots are what their truth says, and the figures count what they say."""

from dataclasses import replace
from types import SimpleNamespace

import _ledger
import numpy as np
import pytest
from _ledger import Ledger, results_of

pytest.importorskip("pinocchio")

import _undeclared_whole as whole
import bench_friction_none
import bench_whole_robots as bench
from _undeclared_robots import inverse_dynamics


@pytest.fixture(scope="module")
def robot():
    return whole.whole_robot(3, duration=12.0)


def test_robot_has_friction_everywhere_and_three_further_effects(robot):
    names = [(e.name, e.joint) for e in robot.truth]
    assert len(set(names)) == len(names)
    for j in range(whole.NV):
        assert {("viscous", j), ("coulomb", j)} <= set(names)
    rest = [name for name, _ in names[2 * whole.NV :]]
    slow = [name for name in rest if name in whole.SLOW]
    assert 1 <= len(slow) <= 3
    assert len(rest) - len(slow) == len(set(rest) - set(whole.SLOW)) == 3
    assert all(e.visible == (e.distinct >= whole.VISIBLE) for e in robot.truth)


def test_channels_are_quantised_and_their_noise_remembers(robot):
    steps = robot.q / (2 * np.pi / 2**17)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.unique(robot.groups).tolist() == [0, 1]
    noise = whole.coloured_noise((200_000, 1), 0.8, np.random.default_rng(0))[:, 0]
    assert noise.std() == pytest.approx(1.0, rel=0.03)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.8, abs=0.01)


def test_motions_differ_within_the_same_limits(robot):
    q, v, _ = np.split(robot.states, 3, axis=1)
    first = robot.q[robot.groups == 0]
    assert np.abs(v).max() <= 3.0 + 1e-9
    assert np.abs(q - first).max() > 0.3
    reach = np.maximum(np.abs(first - first.mean(axis=0)).max(axis=0), 0.1)
    assert np.all(np.abs(q - first.mean(axis=0)).max(axis=0) < 3 * reach)


def test_the_same_seed_gives_the_same_robot(robot):
    again = whole.whole_robot(3, duration=12.0)
    np.testing.assert_array_equal(again.tau, robot.tau)
    assert again.truth == robot.truth


def test_errors_are_those_of_a_wrong_torque(robot):
    class Off:
        def predict(self, states):
            wrong = np.zeros(robot.tau_clean.shape)
            wrong[:, 2] = 0.05 * robot.tau_clean[:, 2].std()
            still = np.abs(states[:, whole.NV]) <= bench.MOVING
            wrong[still, 0] = 10.0 * robot.tau_clean[:, 0].std()
            return robot.tau_clean + wrong

    moving, every = bench.prediction_errors(Off(), robot)
    np.testing.assert_allclose(moving, [0, 0, 0.05, 0, 0, 0], atol=1e-12)
    assert every[0] > 0.1
    assert every[2] == pytest.approx(0.05)
    # the motion to judge is rigid bodies with what is in the truth, and nothing else
    states = np.split(robot.states, 3, axis=1)
    bodies = inverse_dynamics(robot.model, *states)
    assert bodies.shape == robot.tau_clean.shape


def effect(name, joint, *intervals):
    named = {f"p{i}": interval for i, interval in enumerate(intervals)}
    return SimpleNamespace(name=name, joint=joint, intervals=named)


def entry(name, joint, robot, visible=True, contains=()):
    some = robot.truth[0]
    return some._replace(name=name, joint=joint, visible=visible, contains=contains)


def test_names_are_judged(robot):
    truth = [
        entry("spring", 0, robot, contains=("offset",)),
        entry("coulomb", 1, robot),
        entry("spring", 1, robot),
        entry("ripple", 2, robot),
        entry("ripple", 3, robot, visible=False),
    ]
    found = [
        effect("spring", 0, (1.0, 2.0)),
        effect("backlash", 1, (0.5, 1.0), (0.001, 0.01)),
        effect("ripple", 3, (-1.0, 1.0)),
        effect("stribeck", 4, (1.0, 2.0)),
    ]
    missed, extra, right = bench.judge_names(truth, found)
    # Coulomb friction, which every model has, is neither found nor missed
    assert missed == [("ripple", 2)]
    assert extra == [("backlash", 1), ("stribeck", 4)]
    assert right == 2
    # a compound that may as well be the plain effect does not count for it
    found[1] = effect("backlash", 1, (0.5, 1.0), (-0.001, 0.01))
    missed, extra, right = bench.judge_names(truth, found)
    assert missed == [("ripple", 2), ("spring", 1)]
    assert extra == [("backlash", 1), ("stribeck", 4)]


def test_sets_of_several_starts_are_compared():
    def result(start, *found):
        return {"seed": 0, "start": start, "found": [[*x, []] for x in found]}

    viscous = [("viscous", j) for j in range(whole.NV)]
    one = result("none", *viscous, ("ripple", 2))
    two = result("viscous", ("ripple", 2))
    assert bench.differences([one, two]) == []
    assert bench.same_sets([one, two]) == (1, 1, 1)
    three = result("viscous+coulomb", ("ripple", 2), ("presliding", 0))
    assert bench.differences([two, three]) == [("presliding", 0)]
    # a spring beside a counterbalance is a difference that is let pass
    gas = ("counterbalance", 0)
    four, five = result("viscous", gas), result("viscous", gas, ("spring", 0))
    assert bench.same_sets([four, five]) == (1, 0, 1)
    assert bench.same_sets([three, four]) == (1, 0, 0)


def test_a_ledger_goes_on_where_it_stopped(tmp_path):
    path = tmp_path / "results.jsonl"
    tasks = [{"kinds": ["a", "b"], "seed": seed} for seed in range(3)]
    ledger = Ledger(path, ("kinds", "seed"))
    ledger.add({**tasks[0], "value": 1.5})
    with path.open("a") as file:
        file.write('{"kinds": ["a"')
    again = Ledger(path, ("kinds", "seed"))
    assert again.missing(tasks) == tasks[1:]
    (kept,) = again.of(tasks)
    assert kept == {**tasks[0], "value": 1.5, "commit": kept["commit"]}


def test_a_ledger_knows_the_code_of_every_result(tmp_path, monkeypatch):
    path = tmp_path / "results.jsonl"
    tasks = [{"seed": seed} for seed in range(4)]
    path.write_text('{"seed": 0}\n')  # from before commits were noted
    first, second = (
        {"commit": c, "files": {"sklearn_vbjfa/_core/_a.py": d}}
        for c, d in (("1a2b3c4", "x"), ("5d6e7f8", "y"))
    )
    for task, code in zip(tasks[1:], (first, first, second), strict=True):
        monkeypatch.setattr(_ledger, "code", lambda code=code: code)
        Ledger(path, ("seed",)).add(task)
    ledger = Ledger(path, ("seed",))
    assert [r.get("commit") for r in ledger.results[1:]] == [
        "1a2b3c4",
        "1a2b3c4",
        "5d6e7f8",
    ]
    assert ledger.states(tasks[1:3]) == [first]
    assert ledger.states(tasks[2:]) == [first, second]
    assert ledger.states() == [first, second, _ledger.UNKNOWN]
    ledger.path.with_name("results.jsonl.code").unlink()
    assert ledger.states(tasks[3:]) == [{"commit": "5d6e7f8", "files": {}}]
    assert Ledger(None, ("seed",)).states() == [second]


def test_a_ledger_of_several_files_writes_to_the_first(tmp_path, monkeypatch):
    paths = [tmp_path / name for name in ("a.jsonl", "b.jsonl")]
    tasks = [{"seed": seed} for seed in range(3)]
    codes = [{"commit": name, "files": {}} for name in ("1a2b3c4", "5d6e7f8")]
    for path, own, code in zip(paths, (tasks[:2], tasks[1:]), codes, strict=True):
        monkeypatch.setattr(_ledger, "code", lambda code=code: code)
        for task in own:
            Ledger(path, ("seed",)).add(task)
    both = Ledger(paths, ("seed",))
    assert both.missing(tasks) == []
    # what both have is taken from the first
    assert [r["commit"] for r in both.results] == ["1a2b3c4", "1a2b3c4", "5d6e7f8"]
    assert both.states() == codes
    both.add({"seed": 3})
    assert len(Ledger(paths[0], ("seed",)).results) == 3
    assert len(Ledger(paths[1], ("seed",)).results) == 2


def test_tasks_run_in_processes():
    assert sorted(results_of(abs, [-1, 2, -3], jobs=2)) == [1, 2, 3]


def test_whole_robot_from_one_start(monkeypatch):
    robot = whole.whole_robot(0, duration=6.0)
    monkeypatch.setattr(bench, "whole_robot", lambda seed, duration: robot)
    task = {"seed": 0, "start": "viscous+coulomb"}
    result = bench.run(task, effects=["load_friction"], max_effects=1)
    assert len(result["errors"]) == whole.NV
    assert result["right"] + len(result["extra"]) == len(result["found"])
    assert result["perhaps"] == []
    assert len(result["names"]) == len(result["found"])
    missed = {"name": "ripple", "joint": 3, "probability": 0.6, "right": True}
    result["missed"].append(["ripple", 3])
    result["perhaps"].append(missed)
    assert "start viscous+coulomb: worst error" in bench.line(result)
    assert "perhaps ripple 4;" in bench.line(result)
    text = bench.report([result], ["viscous+coulomb"], range(1))
    assert "target 95 %" in text
    assert "of these perhaps: 1" in text


def test_no_declared_friction_on_a_short_recording(monkeypatch):
    recording = bench_friction_none.draw(0, duration=6.0)
    thin = replace(recording.select(0), tau_clean=recording.tau_clean[:1200])
    discovery = bench_friction_none.EffectDiscovery
    monkeypatch.setattr(
        bench_friction_none,
        "EffectDiscovery",
        lambda identifier, **given: discovery(
            identifier, effects=["viscous"], max_effects=2, **given
        ),
    )
    result = {"case": 0, **bench_friction_none.judge(thin)}
    # six joints have Coulomb friction that was not looked for
    assert result["above"]
    assert "of 1 recordings" in bench_friction_none.report([result])
