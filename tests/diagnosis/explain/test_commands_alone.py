"""Positions of the held-out part from commands alone, of the models of a search."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa.diagnosis.explain import Models, _commands, commands_alone
from sklearn_vbjfa.simulation import SimulationError
from tests.robot.test_drives import DT, KD, KP, PDDrive, identify, told

STRETCHES = (slice(300, 400), slice(700, 760))
DRIVE = PDDrive(KP, KD, period=1e-3)


@pytest.fixture(scope="module")
def recording():
    """Gains of the log; a clock, as a search has it."""
    made = told(0.011, duration=6.0)
    return replace(made, t=made.clock())


@pytest.fixture(scope="module")
def models(recording):
    simple = identify(recording, DRIVE, friction=("viscous",))
    whole = identify(recording, DRIVE)
    return Models(declared=simple, plain=whole, judged=whole)


def size(errors):
    return np.sqrt((errors**2).mean(axis=0))


@pytest.fixture(scope="module")
def found(models, recording):
    return commands_alone(models, STRETCHES, recording)


def test_errors_are_those_of_follow_on_the_held_out_rows_alone(
    found, models, recording
):
    one = found
    rows = np.concatenate([np.arange(x.start, x.stop) for x in STRETCHES])
    aim = recording.signals["q_desired"]
    assert_allclose(one["commands"], size((aim - recording.q)[rows]))
    for robot, name in ((models.declared, "before"), (models.judged, "after")):
        # begins at every 100th row
        states = robot.follow(recording, window=100 * DT)
        assert_allclose(one[name], size((states[:, :3] - recording.q)[rows]), rtol=1e-6)
    assert_allclose(one["plain"], one["after"])
    assert (one["after"] < 0.02 * one["commands"]).all()
    assert one["before"].mean() > 3 * one["after"].mean()
    assert one["units"] == ("rad", "rad", "rad")
    assert one["seconds"] == pytest.approx(160 * DT)
    assert (one["failed"], one["left_out"]) == ({}, ())


def test_a_model_that_diverges_has_no_error_and_a_reason(
    models, recording, monkeypatch
):
    run, simple = _commands.CommandFollower.run, models.declared.robot_.theta_

    def diverges(self, rows, start, t):
        if self._model.friction.shape[1] < 2:
            raise SimulationError("It diverges.")
        return run(self, rows, start, t)

    assert simple.size < models.judged.theta_.size
    monkeypatch.setattr(_commands.CommandFollower, "run", diverges)
    one = commands_alone(models, STRETCHES, recording)
    assert one["failed"] == {"before": "It diverges."}
    assert np.isnan(one["before"]).all()
    assert np.isfinite(one["after"]).all()


def test_without_commands_of_positions_there_is_nothing(models, recording):
    bare = replace(models, declared=identify(recording, DRIVE).set_params(drive=None))
    assert commands_alone(bare, STRETCHES, recording) is None
