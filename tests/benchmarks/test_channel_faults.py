"""The benchmark of wrong channels runs at small size, and its faults are faults."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_channel_faults as bench

from tests.inspection._channel_faults import FAULTS, visible


def test_every_fault_changes_the_recording():
    _, q, tau, dt = bench.simulated(0)
    for name, fault in FAULTS.items():
        wrong_q, wrong_tau, wrong_dt = fault.put(
            q, tau, dt, 1, np.random.default_rng(0)
        )
        assert wrong_q.shape == q.shape, name
        assert wrong_tau.shape == tau.shape, name
        same = np.array_equal(wrong_q, q) and np.array_equal(wrong_tau, tau)
        assert not same or wrong_dt != dt, name


def test_gravity_shows_a_zero_only_about_a_horizontal_axis():
    from sklearn_vbjfa.datasets import load_demo_recording

    arm = load_demo_recording()
    fault = FAULTS["zero off by 90 degrees"]
    can = [
        visible(
            arm.robot_model(),
            fault,
            arm.q[:2000],
            arm.tau[:2000],
            arm.dt,
            j,
            np.random.default_rng(0),
        )
        for j in (0, 1)
    ]
    assert can == [False, True]


def test_the_study_counts_every_case():
    faults = {name: FAULTS[name] for name in ("sign of one torque", "degrees")}
    counts = bench.study(2, faults)
    assert all(sum(c[v] for v in bench.VISIBLE) == 2 for c in counts.values())
    assert counts["degrees"]["seen"] == 2


def test_parts_of_a_recording_cover_it():
    from sklearn_vbjfa.datasets import load_demo_recording

    arm = load_demo_recording()
    parts = list(bench.parts_of(arm))
    assert len(parts) == 1 + 2 * 3
    halves = np.concatenate([rows for name, rows, _ in parts if "half" in name])
    assert np.array_equal(np.sort(halves), np.arange(arm.n_samples))


def test_the_table_is_made():
    text = bench.report(None, 1, 1)
    assert "velocities as positions" in text
    assert "Simulated: " in text
