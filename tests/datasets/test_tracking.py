"""Control with a model: the true one needs no feedback, a wild one stops the robot."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa.datasets import make_closed_loop_recording
from sklearn_vbjfa.datasets._plant import draw_motion, rigid_torques
from sklearn_vbjfa.datasets._tracking import simulate_tracking


@pytest.fixture(scope="module", params=["head", "arm"])
def recording(request):
    return make_closed_loop_recording(request.param, duration=0.5, random_state=0)


def track(recording, feedforward, **options):
    rng = np.random.RandomState(7)
    motion = draw_motion(recording.nominal, 1.0, 3, rng)
    settings = {"duration": 4.0, "dt": recording.dt, "random_state": 0, **options}
    return simulate_tracking(recording.plant, motion, feedforward, **settings)


def test_the_true_model_needs_no_feedback(recording):
    plant, dt = recording.plant, recording.dt
    result = track(
        recording,
        lambda states: plant.command(plant.inverse_dynamics(states), dt),
        encoder_noise=0.0,
    )
    assert not result.failed
    assert result.duration == pytest.approx(4.0)
    # What is left is the integration of the motion.
    assert (result.feedback_rms < 1e-3 * plant.torque_size).all()
    assert (result.position_rmse < 2e-5).all()
    finer = track(
        recording,
        lambda states: plant.command(plant.inverse_dynamics(states), dt),
        encoder_noise=0.0,
        substeps=4,
    )
    # With finer steps the commands, held for a period, are not exact between samples.
    assert (finer.feedback_rms < 2e-2 * plant.torque_size).all()
    assert (finer.position_rmse < 3e-4).all()


def test_a_better_model_tracks_better(recording):
    plant, nominal = recording.plant, recording.nominal
    true = track(recording, plant.inverse_dynamics)
    declared = track(recording, lambda states: rigid_torques(nominal, states))
    nothing = track(recording, lambda states: 0.0 * states[:, : nominal.nv])
    for better, worse in ((true, declared), (declared, nothing)):
        for a, b in zip(better.averages(), worse.averages()):
            assert 0 < a < b
    n = round(4.0 / recording.dt)
    as_array = track(recording, np.zeros((n, nominal.nv)))
    np.testing.assert_array_equal(as_array.position_rmse, nothing.position_rmse)


def test_a_wild_model_stops_the_robot(recording):
    plant = recording.plant
    for wild, reason in (
        (lambda states: -4.0 * plant.inverse_dynamics(states), "limit|speed"),
        (lambda states: np.full((len(states), plant.model.nv), np.nan), "no number"),
    ):
        result = track(recording, wild)
        assert result.failed
        assert np.isnan(result.averages()).all()
        assert np.isnan(result.feedback_rms).all()
        assert result.duration < 4.0
        assert any(part in result.failure for part in reason.split("|"))


def test_a_controller_that_is_too_slow_diverges(recording):
    plant = recording.plant
    result = track(recording, plant.inverse_dynamics, dt=0.2, duration=40.0)
    assert result.failed


def test_wrong_shapes(recording):
    with pytest.raises(ValueError, match="feedforward must have shape"):
        track(recording, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="leaves nothing to judge"):
        track(recording, recording.plant.inverse_dynamics, settle=4.0)
