import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.diagnosis.explain import measure_band, power_share
from sklearn_vbjfa.diagnosis.search import RecordingView
from sklearn_vbjfa.recording import take_arrays
from tests.diagnosis._recordings import DT
from tests.diagnosis.search._searches import CLEAN, search
from tests.effects._arms import inverse_dynamics


def band_of(recording=CLEAN, **settings):
    torque = recording.torque()
    robot = recording.robot(**settings)
    view = search(torque, [], recording, robot).view
    return measure_band(view, robot.cutoff, len(torque))


def test_share_is_that_of_the_slow_part():
    t = np.arange(2000) / 2000
    slow, fast = 3.0 * np.sin(2 * np.pi * t), 4.0 * np.sin(2 * np.pi * 40 * t)
    raw = np.stack([slow + fast + 7.0, slow, np.full(t.size, 2.0)], axis=1)
    left = np.stack([slow + 7.0, slow, np.full(t.size, 2.0)], axis=1)
    share = power_share(raw, left, np.ones_like(raw))
    assert share[:2] == pytest.approx([9 / 25, 1.0])
    assert np.isnan(share[2])
    scaled = power_share(1e3 * raw, 1e3 * left, np.full_like(raw, 0.5))
    assert scaled[:2] == pytest.approx(share[:2])


@pytest.mark.parametrize(
    ("settings", "decided_by"),
    [({}, "motion"), ({"cutoff": 3.0}, "given"), ({"cutoff": None}, "none")],
)
def test_what_decides(settings, decided_by):
    band = band_of(**settings)
    estimator = CLEAN.robot().fit(CLEAN.position, CLEAN.torque()).state_estimator_
    fastest = np.argmax(estimator.bandwidth_)
    assert band.decided_by == decided_by
    assert (band.fastest, band.bandwidth) == (fastest, estimator.bandwidth_[fastest])
    assert band.smoothed_at == estimator.cutoff_[fastest]
    # Five times the bandwidth, whatever was taken in the end.
    assert band.automatic == pytest.approx(5 * band.bandwidth)
    taken = {"motion": band.automatic, "given": 3.0, "none": np.inf}[decided_by]
    assert band.cutoff == pytest.approx(taken)
    assert band.sample_rate == pytest.approx(1 / DT)


def sines(frequencies, as_states=False):
    """Forty seconds of a sine on each joint, and the band of their fit."""
    t = np.arange(0.0, 40.0, DT)[:, None]
    w = 2 * np.pi * np.asarray(frequencies)
    q, v, a = np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)
    model = CLEAN.model
    torque = inverse_dynamics(model, np.concatenate([q, v, a], axis=1)) + 0.3 * v
    noise = 1e-6 * np.random.default_rng(0).normal(size=q.shape)
    X = np.concatenate([q, v, a], axis=1) if as_states else q + noise
    robot = RobotIdentifier(model, dt=DT, friction=("viscous",)).fit(X, torque)
    groups = np.zeros(len(t), dtype=int)
    measured = take_arrays(
        X, torque, groups, np.ones_like(q), dt=DT, joint_names=robot.joint_names_
    )
    return measure_band(RecordingView(robot, measured), robot.cutoff, len(t))


def test_a_slow_motion_leaves_it_to_the_length_of_the_recording():
    band = sines((0.05, 0.04))
    assert band.decided_by == "length"
    assert band.fastest == 0
    # 36 periods of the cut-off in 40 s
    assert band.cutoff == pytest.approx(0.9)
    assert 0.05 <= band.bandwidth <= 0.1


def test_a_fast_motion_is_not_filtered():
    band = sines((5.0, 1.0))
    assert band.decided_by == "sample rate"
    assert (band.cutoff, band.automatic) == (np.inf, np.inf)
    assert 4.9 <= band.bandwidth <= 5.2


def test_states_are_not_filtered():
    band = sines((0.5, 0.4), as_states=True)
    assert band.decided_by == "states"
    assert band.cutoff == np.inf
    assert np.isnan([band.automatic, band.bandwidth, band.smoothed_at]).all()


def test_shares_are_those_of_the_filtered_signals():
    band = band_of(cutoff=1.0)
    whole = band_of(cutoff=None)
    assert (band.speed_share < band_of(cutoff=4.0).speed_share).all()
    assert (band.torque_share < band_of(cutoff=4.0).torque_share).all()
    assert whole.speed_share == pytest.approx(np.ones(2))
    assert whole.torque_share == pytest.approx(np.ones(2))
