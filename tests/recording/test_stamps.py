"""Irregular time stamps: jitter, lost or repeated rows, gaps and drifting clocks."""

import numpy as np
import pytest

from sklearn_vbjfa.recording import read_recording
from tests.benchmarks._protocols import protocols
from tests.recording._reading import read_text

DT = 0.004
N = 3000
NOISE = 1e-4


def motion(t):
    """Return positions of two joints with amplitudes of some tenths of a radian."""
    return np.column_stack(
        [0.5 * np.sin(3 * t) + 0.1 * np.sin(11 * t), 0.3 * np.cos(5 * t)]
    )


def jittered(share, rng, n=N):
    return DT * (np.arange(n) + np.clip(share * rng.standard_normal(n), -0.45, 0.45))


def save(path, t, q, tau, dt=None, **arrays):
    np.savez(path, t=t, q=q, tau=tau, **arrays)
    return read_text(path, dt=dt)


@pytest.fixture
def read_stamps(tmp_path):
    """Read positions with time stamps and random torques."""
    tau = np.random.default_rng(7).standard_normal((2 * N, 2))
    return lambda t, q, dt=None: save(tmp_path / "a.npz", t, q, tau[: len(q)], dt)


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2, 0.3, 0.4])
def test_positions_distinguish_late_stamps_from_late_samples(share, read_stamps):
    rng = np.random.default_rng(0)
    t = jittered(share, rng)
    noise = NOISE * rng.standard_normal((N, 2))
    q = motion(DT * np.arange(N)) + noise
    written, notes = read_stamps(t, q)
    assert "rows are taken as equidistant" in notes
    np.testing.assert_array_equal(written.q, q)
    assert written.dt == pytest.approx(DT, rel=1e-3)
    sampled, notes = read_stamps(t, motion(t) + noise)
    assert "the robot was sampled at these times" in notes
    assert sampled.dt == pytest.approx(DT, rel=0.01)


@pytest.mark.parametrize("share", [0.01, 0.05, 0.1])
@pytest.mark.parametrize("jitter", [0.0, 0.02, 0.05])
def test_lost_rows_are_counted(share, jitter, read_stamps):
    rng = np.random.default_rng(2)
    keep = np.flatnonzero(rng.random(N) >= share)
    keep = np.r_[0, keep[(keep > 0) & (keep < N - 1)], N - 1]
    recording, _ = read_stamps(jittered(jitter, rng)[keep], motion(DT * keep))
    assert recording.n_samples == N
    np.testing.assert_allclose(recording.q[keep], motion(DT * keep), atol=1e-9)
    assert recording.dt == pytest.approx(DT, rel=3e-5)


def test_lost_rows_are_interpolated_and_others_unchanged(tmp_path):
    rng = np.random.default_rng(3)
    keep = np.setdiff1d(np.arange(N), [40, 41, 90, 2000])
    t = DT * np.arange(N)
    q, tau = motion(t), rng.standard_normal((N, 2))
    recording, notes = save(tmp_path / "a.npz", t[keep], q[keep], tau[keep])
    assert "4 single sample(s) are missing and were interpolated" in notes
    np.testing.assert_allclose(recording.q[keep], q[keep], atol=1e-12)
    np.testing.assert_allclose(recording.tau[keep], tau[keep], atol=1e-12)
    np.testing.assert_allclose(recording.q, q, atol=1e-6)
    # A gap that straight lines fill is left out.
    for x in (*q.T, *tau.T):
        x[1000:1100] = np.linspace(x[999], x[1100], 102)[1:-1]
    recording, notes = save(tmp_path / "b.npz", t, q, tau)
    assert "100 row(s)" in notes
    assert [x.stop - x.start for x in recording.segments] == [1000, N - 1100]


def test_noise_is_measured_before_interpolation(tmp_path):
    rng = np.random.default_rng(4)
    sigma = np.array([0.5, 2.0])
    t = jittered(0.3, rng)
    # Jumps of dry friction are not noise.
    clean = 9 * np.sign(np.cos(3 * t))[:, None] + [1.0, 20.0] * np.sin(2 * t)[:, None]
    tau = clean + sigma * rng.standard_normal((N, 2))
    recording, notes = save(tmp_path / "a.npz", t, motion(t), tau)
    assert "the robot was sampled at these times" in notes
    np.testing.assert_allclose(recording.torque_noise, sigma, rtol=0.05)
    # Interpolation to the regular grid reduces the noise.
    left = np.abs(np.diff(recording.tau, n=5, axis=0))
    left = np.quantile(left, 0.25, axis=0) / 0.3186 / np.sqrt(252)
    assert (left < 0.85 * sigma).all()
    steady, notes = save(tmp_path / "b.npz", DT * np.arange(N), motion(t), tau)
    assert (steady.torque_noise, notes) == (None, "")


def test_rows_with_repeated_stamps_are_skipped(tmp_path):
    rng, t = np.random.default_rng(6), DT * np.arange(N)
    rows = np.sort(np.r_[np.arange(N), rng.choice(N, 60, replace=False)])
    tau = rng.standard_normal((N, 2))
    recording, notes = save(tmp_path / "a.npz", t[rows], motion(t[rows]), tau[rows])
    assert "60 row(s) have the stamp of the one before: left out" in notes
    np.testing.assert_array_equal(recording.tau, tau)
    # Stamps with so few digits are refused.
    with pytest.raises(ValueError, match=r"time repeats .* leave the stamps out"):
        save(tmp_path / "b.npz", np.round(t, 2), motion(t), tau)
    bursts = t[np.arange(N) // 8 * 8] + np.arange(N) % 8 * 1e-4
    with pytest.raises(ValueError, match=r"come in bursts.* give dt \(0\.00\d* s"):
        save(tmp_path / "c.npz", bursts, motion(t), tau)


@pytest.mark.parametrize("rows", [1.1, 1.6, 2.5])
def test_rows_that_repeat_samples_of_a_slower_source_are_left_out(read_stamps, rows):
    sample = np.floor(np.arange(N) / rows + 1e-9)
    recording, notes = read_stamps(DT * np.arange(N), motion(rows * DT * sample))
    assert "row(s) repeat samples of a source with a period of" in notes
    assert recording.dt == pytest.approx(rows * DT, rel=1e-4)
    expected = motion(rows * DT * np.arange(len(recording.q)))
    np.testing.assert_array_less(np.abs(recording.q - expected), 1e-9)


def test_random_time_steps_are_refused(read_stamps):
    steps = DT * np.random.default_rng(1).lognormal(0, 1, N)
    with pytest.raises(ValueError, match=r"time steps by .* without a period"):
        read_stamps(np.cumsum(steps), motion(DT * np.arange(N)))


def test_clock_drift_loses_no_rows(read_stamps):
    t = DT * np.arange(N)
    recording, notes = read_stamps(t + 0.02 * t * (t / t[-1] - 1), motion(t))
    np.testing.assert_array_equal(recording.q, motion(t))
    assert "sampled at these times" not in notes
    assert recording.dt == pytest.approx(DT, rel=1e-6)


IRREGULAR = {
    "period": lambda rng: np.cumsum(np.repeat([DT, 1.25 * DT], N // 2)),
    "rows": lambda rng: np.delete(jittered(0.3, rng, N + 60), rng.choice(N, 60, False)),
}


@pytest.mark.parametrize("case", IRREGULAR)
def test_stamps_without_a_regular_clock_are_refused(case, read_stamps):
    t = IRREGULAR[case](np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"rows are missing, or the period changes"):
        read_stamps(t, motion(DT * np.arange(N)))


@pytest.mark.parametrize("dt", [4.0, 250.0])
def test_period_in_another_unit_is_refused(dt, read_stamps):
    with pytest.raises(ValueError, match=r"0\.004 s but dt = .* not in ms or Hz"):
        read_stamps(DT * np.arange(N), motion(DT * np.arange(N)), dt)


def test_row_numbers_as_stamps_use_the_given_period(tmp_path):
    path = tmp_path / "arm.csv"
    path.write_text("t,q1,tau1\n" + "".join(f"{k},{k / 9},1\n" for k in range(40)))
    assert read_recording(path, dt=DT).dt == DT


def test_stamps_of_static_poses_may_be_irregular(tmp_path):
    path, rng = tmp_path / "poses.csv", np.random.default_rng(0)
    t, q = np.cumsum(rng.uniform(3.0, 9.0, 40)), rng.normal(size=40)
    rows = "".join(f"{a},{b},1\n" for a, b in zip(t, q))
    path.write_text(f"t,q1,tau1\n{rows}")
    assert read_recording(path).dt == pytest.approx(np.median(np.diff(t)))


@pytest.mark.parametrize("name", ["ur5", "kuka_lbr_med7", "bam_xl330", "emps"])
def test_measured_recordings(name, measured_data_home, tmp_path):
    protocol = protocols()[name]
    data = protocol.load(data_home=measured_data_home)
    sizes = np.bincount(data.groups)
    t = data.dt * np.concatenate([np.arange(n) for n in sizes])
    rng, common = np.random.default_rng(0), {"segment": data.groups}
    recording, notes = save(tmp_path / "a.npz", t, data.q, data.tau, **common)
    assert notes == ""
    np.testing.assert_array_equal(recording.q, data.q)
    for share in (0.1, 0.3):
        jitter = np.clip(share * rng.standard_normal(t.size), -0.45, 0.45)
        noisy = t + data.dt * jitter
        recording, notes = save(tmp_path / "b.npz", noisy, data.q, data.tau, **common)
        assert "the sampling was regular" in notes
        np.testing.assert_array_equal(recording.q, data.q)
        np.testing.assert_array_equal(recording.tau, data.tau)
    # About every fifth row: the robot was sampled at the stamped times.
    rows = []
    for start, n in zip(np.cumsum(sizes) - sizes, sizes):
        steps = np.arange(2, n - 2, 5)
        jitter = np.clip(0.3 * rng.standard_normal(steps.size), -0.4, 0.4)
        rows.append(start + steps + np.rint(5 * jitter).astype(int))
    rows = np.concatenate(rows)
    kept = (x[rows] for x in (t, data.q, data.tau))
    recording, notes = save(tmp_path / "c.npz", *kept, segment=data.groups[rows])
    assert "the positions say that the robot was sampled at these times" in notes
    assert recording.dt == pytest.approx(5 * data.dt, rel=0.01)
