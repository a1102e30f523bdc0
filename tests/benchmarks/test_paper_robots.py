"""The simulated robots of the paper against their own inverse dynamics."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from _paper_robots import make_closed_loop_recording, simulate_tracking

from sklearn_vbjfa.datasets import rigid_torques


@pytest.mark.parametrize("name", ["head", "arm"])
def test_a_better_model_tracks_better(name):
    recording = make_closed_loop_recording(name, duration=1.0, random_state=0)
    plant, (motion,) = recording.plant, recording.motions

    def follow(feedforward):
        options = {"duration": 4.0, "dt": recording.dt, "random_state": 0}
        return simulate_tracking(plant, motion, feedforward, **options)

    true = follow(plant.inverse_dynamics)
    declared = follow(lambda states: rigid_torques(recording.nominal, states))
    nothing = follow(lambda states: 0.0 * states[:, : plant.model.nv])
    for better, worse in ((true, declared), (declared, nothing)):
        assert not better.failure
        for a, b in zip(better.averages(), worse.averages(), strict=True):
            assert 0 < a < b
    assert follow(lambda states: np.full((len(states), 3), np.nan)).failure


def test_a_seed_is_one_robot():
    first = make_closed_loop_recording("head", duration=0.5, random_state=0)
    longer = make_closed_loop_recording(
        "head", duration=1.0, n_recordings=2, random_state=0
    )
    np.testing.assert_array_equal(first.plant.theta(), longer.plant.theta())
    t = np.arange(50) * first.dt
    states = [one.motions[0].states(t) for one in (first, longer)]
    np.testing.assert_array_equal(*states)
