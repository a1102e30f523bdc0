"""Single effects have the size asked for, and are judged by name and joint."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import _undeclared as undeclared
import bench_single_effects as bench
from _undeclared_hysteresis import first_order_lag, two_sided_average
from scipy.stats import binom

SHORT = {"duration": 20.0, "rate": 100.0}


@pytest.mark.parametrize("kind", ["spring", "delay", "jerk", "torque_filter"])
def test_exact_size_is_that_outside_the_declared_span(kind):
    recording = undeclared.simulate([kind], size=2.0, seed=4, exact=True, **SHORT)
    (entry,), (torque,) = recording.truth, recording.contributions
    assert recording.visible
    assert 1.6 <= entry.outside <= 2.5
    residual = recording.span().residual(torque)
    rows = residual.reshape(-1, recording.tau.shape[1])
    # the share is of all joints, the torque of one
    assert np.sqrt(np.mean(rows**2, axis=0).sum()) == pytest.approx(
        entry.outside, rel=0.05
    )


def test_a_lag_and_an_average_of_a_sine():
    t = np.arange(0.0, 20.0, 0.01)
    w, T = 2.0 * np.pi * 0.5, 0.05
    x = np.sin(w * t)
    middle = slice(500, 1500)
    gain, phase = 1.0 / np.hypot(1.0, w * T), np.arctan(w * T)
    lag = first_order_lag(x, 0.01, T)
    np.testing.assert_allclose(
        lag[middle], gain * np.sin(w * t - phase)[middle], atol=1e-4
    )
    average = two_sided_average(x, 0.01, T)
    np.testing.assert_allclose(average[middle], gain**2 * x[middle], atol=3e-4)


def test_jerk_is_the_inertia_times_the_third_derivative():
    recording = undeclared.simulate(["jerk"], size=2.0, seed=4, exact=True, **SHORT)
    (entry,), (torque,) = recording.truth, recording.contributions
    a = np.split(recording.states, 3, axis=1)[2][:, entry.joint]
    first = recording.groups == 0
    slope = np.gradient(a[first], recording.dt)[100:-100]
    # the lag is a few milliseconds, the motion a second: to first order a derivative
    part = torque[first, entry.joint][100:-100]
    assert abs(np.corrcoef(slope, part)[0, 1]) > 0.9
    assert np.sign(slope @ part) == np.sign(entry.parameters["J"])


def effect(name, joint, rivals=()):
    return SimpleNamespace(name=name, joint=joint, rivals=rivals)


def test_names_and_rivals_are_judged_on_their_joint():
    entries = [
        SimpleNamespace(name="spring", joint=0, contains=("offset",)),
        SimpleNamespace(name="ripple", joint=1, contains=()),
    ]
    recording = SimpleNamespace(truth=entries)
    found = [effect("spring", 0), effect("offset", 0), effect("drift", 1, ("ripple",))]
    assert bench.judge(recording, found) == ([True, True], [False, True], [])
    found = [effect("spring", 1), effect("offset", 1)]
    assert bench.judge(recording, found) == (
        [False, False],
        [False, False],
        [("offset", 1), ("spring", 1)],
    )


def test_lower_bound_is_the_share_that_rarely_gives_as_many():
    bound = bench.lower_bound(9, 10)
    assert binom.sf(8, 10, bound) == pytest.approx(0.1)
    assert bench.lower_bound(10, 10) == pytest.approx(0.1**0.1)
    assert bench.lower_bound(0, 10) == 0.0


def test_tasks_are_told_apart_and_a_part_is_a_sample():
    tasks = bench.tasks_of(bench.STUDIES, bench.KINDS, tuple(bench.SIZES), 0, 2, 5)
    keys = {repr([task[key] for key in bench.KEYS]) for task in tasks}
    assert len(keys) == len(tasks) == 2 * len(bench.KINDS) * 4 + 3 * 5
    again = bench.tasks_of(["two"], bench.KINDS, (), 0, 2, 5)
    assert again == [task for task in tasks if task["study"] == "two"]


def test_one_effect_is_found_and_the_table_counts_it():
    task = {"study": "single", "kinds": ["ripple"], "sizes": [6.0], "seed": 0}
    result = bench.run(
        task, {"robot": "demo", **SHORT}, effects=["ripple"], max_effects=1
    )
    assert result["named"] == [True]
    assert [e["right"] for e in result["names"]] == [True]
    assert result["perhaps"] == []
    result["perhaps"] = [
        {"name": "spring", "joint": 0, "probability": 0.85, "right": False}
    ]
    hidden = {**task, "seed": 1, "visible": False, "truth": [["ripple", 0, 0.1]]}
    nothing = {"study": "none", "visible": True, "extra": [["spring", 1]]}
    nothing |= {"kinds": [], "sizes": [], "seed": 0}
    text = bench.report([result, hidden, nothing])
    assert "1 of 1" in text
    assert "0 %" in text.split("Several, and none")[1]
    assert "not of this size" in bench.line(hidden)
    assert "; perhaps spring 1;" in bench.line(result)
    assert "named; found ripple" in bench.line(result)
    cells = [row.split() for row in text.splitlines()]
    # one case named, also counting what is perhaps, which is wrong
    assert next(row for row in cells if row[:1] == ["6"])[-4:] == ["1", "0", "1", "1"]
    assert ["perhaps,", "0.8", "to", "0.9", "1", "85", "0"] in cells
