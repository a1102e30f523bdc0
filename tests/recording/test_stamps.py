"""Irregular stamps: late or sampled, rows lost or twice, gaps, packets, clocks."""

import numpy as np
import pytest

from sklearn_vbjfa.recording import inspect_time_stamps, read_recording
from tests.benchmarks._protocols import protocols
from tests.recording._reading import read_text

DT = 0.004
N = 3000
NOISE = 1e-4


def motion(t):
    """Positions of two joints, which move by some tenths of a radian."""
    return np.column_stack(
        [0.5 * np.sin(3 * t) + 0.1 * np.sin(11 * t), 0.3 * np.cos(5 * t)]
    )


def late(share, rng, n=N):
    return DT * (np.arange(n) + np.clip(share * rng.standard_normal(n), -0.45, 0.45))


def save(path, t, q, tau, **more):
    np.savez(path, t=t, q=q, tau=tau, **more)
    return read_text(path)


def test_stamps_are_judged():
    dt, t = 0.01, 0.01 * np.arange(100)
    steady = inspect_time_stamps(t)
    assert steady.irregular == ""
    np.testing.assert_array_equal(steady.slots, np.arange(100))
    assert steady.gaps.size == 0
    assert steady.dt == pytest.approx(dt)
    lossy = inspect_time_stamps(np.delete(t, [30, 60, *range(70, 80)]))
    assert lossy.slots[67] == 69
    assert lossy.dt == pytest.approx(dt)
    np.testing.assert_array_equal(lossy.gaps, [67])
    assert lossy.steps.max() == pytest.approx(2 * dt)
    with pytest.raises(ValueError, match="time repeats 0 s in row 1"):
        inspect_time_stamps([0.0, 0.0])
    with pytest.raises(ValueError, match="two time stamps or more"):
        inspect_time_stamps([0.0])


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2, 0.3, 0.4])
def test_positions_tell_late_stamps_from_late_samples(share):
    rng = np.random.default_rng(0)
    t = late(share, rng)
    noise = NOISE * rng.standard_normal((N, 2))
    written = inspect_time_stamps(t, positions=motion(DT * np.arange(N)) + noise)
    assert written.irregular == "late"
    np.testing.assert_array_equal(written.slots, np.arange(N))
    assert written.dt == pytest.approx(DT, rel=1e-3)
    sampled = inspect_time_stamps(t, positions=motion(t) + noise)
    assert sampled.irregular == "sampled"
    assert sampled.dt == pytest.approx(DT, rel=0.01)


@pytest.mark.parametrize("share", [0.01, 0.05, 0.1])
@pytest.mark.parametrize("jitter", [0.0, 0.02, 0.05])
def test_lost_rows_are_counted(share, jitter):
    rng = np.random.default_rng(2)
    keep = np.flatnonzero(rng.random(N) >= share)
    keep = np.r_[0, keep[(keep > 0) & (keep < N - 1)], N - 1]
    t = late(jitter, rng)[keep]
    checked = inspect_time_stamps(t, positions=motion(DT * keep))
    assert checked.gaps.size == 0
    np.testing.assert_array_equal(checked.slots, keep)
    assert checked.dt == pytest.approx(DT, rel=3e-5)


def test_lost_rows_are_put_in_and_the_others_kept(tmp_path):
    rng = np.random.default_rng(3)
    keep = np.setdiff1d(np.arange(N), [40, 41, 90, 2000])
    t = DT * np.arange(N)
    q, tau = motion(t), rng.standard_normal((N, 2))
    recording, said = save(tmp_path / "a.npz", t[keep], q[keep], tau[keep])
    assert "4 single sample(s) are missing and were interpolated" in said
    np.testing.assert_allclose(recording.q[keep], q[keep], atol=1e-12)
    np.testing.assert_allclose(recording.tau[keep], tau[keep], atol=1e-12)
    np.testing.assert_allclose(recording.q, q, atol=1e-6)


def test_noise_is_measured_before_interpolation(tmp_path):
    rng = np.random.default_rng(4)
    size = np.array([0.5, 2.0])
    t = late(0.3, rng)
    # Jumps of dry friction are no noise.
    clean = 9 * np.sign(np.cos(3 * t))[:, None] + [1.0, 20.0] * np.sin(2 * t)[:, None]
    tau = clean + size * rng.standard_normal((N, 2))
    recording, said = save(tmp_path / "a.npz", t, motion(t), tau)
    assert "the robot was sampled at these times" in said
    np.testing.assert_allclose(recording.torque_noise, size, rtol=0.05)
    # What is left on the grid is less.
    left = np.abs(np.diff(recording.tau, n=5, axis=0))
    left = np.quantile(left, 0.25, axis=0) / 0.3186 / np.sqrt(252)
    assert (left < 0.85 * size).all()
    steady, said = save(tmp_path / "b.npz", DT * np.arange(N), motion(t), tau)
    assert steady.torque_noise is None
    assert said == ""


def test_rows_with_the_stamp_of_the_one_before_are_left_out(tmp_path):
    rng = np.random.default_rng(6)
    rows = np.sort(np.r_[np.arange(N), rng.choice(N, 60, replace=False)])
    t = DT * np.arange(N)
    tau = rng.standard_normal((N, 2))
    recording, said = save(tmp_path / "a.npz", t[rows], motion(t[rows]), tau[rows])
    assert "60 row(s) have the stamp of the one before: left out" in said
    np.testing.assert_array_equal(recording.tau, tau)
    # Stamps of so few digits say little.
    with pytest.raises(ValueError, match=r"time repeats .* leave the stamps out"):
        save(tmp_path / "b.npz", np.round(t, 2), motion(t), tau)


def test_steps_of_all_sizes_are_refused():
    steps = DT * np.random.default_rng(1).lognormal(0, 1, N)
    with pytest.raises(ValueError, match=r"time steps by .* without a period"):
        inspect_time_stamps(np.cumsum(steps), positions=motion(DT * np.arange(N)))


@pytest.mark.parametrize("share", [-0.02, 0.02])
def test_a_drifting_clock_loses_no_row(share):
    t = DT * np.arange(N)
    drifting = t + share * t * (t / t[-1] - 1)
    checked = inspect_time_stamps(drifting, positions=motion(t))
    np.testing.assert_array_equal(checked.slots, np.arange(N))
    assert checked.irregular != "sampled"
    assert checked.dt == pytest.approx(DT, rel=1e-6)


WANDERING = {
    "period": lambda rng: np.cumsum(np.repeat([DT, 1.25 * DT], N // 2)),
    "often": lambda rng: np.cumsum(np.tile(np.repeat([DT, 1.25 * DT], 50), N // 100)),
    "rows": lambda rng: np.delete(late(0.3, rng, N + 60), rng.choice(N, 60, False)),
}


@pytest.mark.parametrize("case", WANDERING)
def test_stamps_that_show_no_regular_clock_are_refused(case):
    t = WANDERING[case](np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"rows are missing, or the period changes"):
        inspect_time_stamps(t, positions=motion(DT * np.arange(N)))


@pytest.mark.parametrize("dt", [4.0, 250.0])
def test_a_period_in_another_unit_is_refused(dt):
    with pytest.raises(ValueError, match=r"0\.004 s but dt = .* not in ms or Hz"):
        inspect_time_stamps(DT * np.arange(N), dt)


def test_counts_of_rows_take_the_period_that_is_given(tmp_path):
    path = tmp_path / "arm.csv"
    path.write_text("t,q1,tau1\n" + "".join(f"{k},{k / 9},1\n" for k in range(40)))
    assert read_recording(path, dt=DT).dt == DT


def test_stamps_of_poses_need_no_period(tmp_path):
    path, rng = tmp_path / "poses.csv", np.random.default_rng(0)
    t, q = np.cumsum(rng.uniform(3.0, 9.0, 40)), rng.normal(size=40)
    rows = "".join(f"{a},{b},1\n" for a, b in zip(t, q))
    path.write_text(f"t,q1,tau1\n{rows}")
    assert read_recording(path).dt == pytest.approx(np.median(np.diff(t)))


@pytest.mark.parametrize("name", ["ur5", "kuka_lbr_med7", "bam_xl330", "emps"])
def test_measured_recordings(name, measured_data_home, tmp_path):
    protocol = protocols()[name]
    made = protocol.load(data_home=measured_data_home)
    sizes = np.bincount(made.groups)
    t = made.dt * np.concatenate([np.arange(n) for n in sizes])
    rng = np.random.default_rng(0)
    common = {"segment": made.groups}
    recording, said = save(tmp_path / "a.npz", t, made.q, made.tau, **common)
    assert said == ""
    np.testing.assert_array_equal(recording.q, made.q)
    for share in (0.1, 0.3):
        jitter = np.clip(share * rng.standard_normal(t.size), -0.45, 0.45)
        shaken = t + made.dt * jitter
        recording, said = save(tmp_path / "b.npz", shaken, made.q, made.tau, **common)
        assert "the sampling was regular" in said
        np.testing.assert_array_equal(recording.q, made.q)
        np.testing.assert_array_equal(recording.tau, made.tau)
    # Every fifth row or so: the robot was sampled when the stamps say.
    rows = []
    for start, n in zip(np.cumsum(sizes) - sizes, sizes):
        steps = np.arange(2, n - 2, 5)
        jitter = np.clip(0.3 * rng.standard_normal(steps.size), -0.4, 0.4)
        rows.append(start + steps + np.rint(5 * jitter).astype(int))
    rows = np.concatenate(rows)
    common = {"segment": made.groups[rows]}
    recording, said = save(
        tmp_path / "c.npz", t[rows], made.q[rows], made.tau[rows], **common
    )
    assert "the positions say that the robot was sampled at these times" in said
    assert recording.dt == pytest.approx(5 * made.dt, rel=0.01)
