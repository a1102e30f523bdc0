"""EffectDiscovery with effects of time, and predictions after the recording."""

import numpy as np
import pytest

from tests._quick import checkered, one_in
from tests.diagnosis._recordings import named, record

ARM = record("ZY", duration=30.0, seed=2)
LENGTH = 30.0
FRICTION = 1.5
LIBRARY = ["coulomb", "drift", "offset"]


def discover(change, recording=ARM, library=LIBRARY, **options):
    """Search a recording in which the Coulomb friction of joint 1 changes."""

    def friction(r):
        return (FRICTION + change(r.t / LENGTH)) * np.sign(r.v[:, 0])

    return recording.discover(recording.torque(joint_1=friction), library, **options)


@pytest.fixture(scope="module")
def warming():
    return discover(lambda s: 2.0 * np.exp(-s / 0.5))


@pytest.mark.parametrize("share", one_in(2, [0.3, 0.8]))
def test_slow_drifts_are_found(share):
    loop = discover(lambda s: np.exp(-s / share))
    assert named(loop) == [("drift", 0)]
    (drift,) = (e for e in loop.effects_ if e.name == "drift")
    low, high = drift.intervals["time_constant"]
    assert low - 0.2 * share * LENGTH < share * LENGTH < high + 0.2 * share * LENGTH


@pytest.mark.parametrize("share", one_in(2, [0.06, 0.04]))
def test_fast_drifts_cause_no_other_effects(share):
    recording = record("ZY", duration=LENGTH, seed=4)
    loop = discover(lambda s: 3.0 * np.exp(-s / share), recording)
    reported = (*loop.effects_, *loop.possible_)
    assert {effect.name for effect in reported} <= {"drift"}


@pytest.mark.parametrize(("phase", "periods"), checkered([0.0, 0.25], [2.0, 1.0]))
def test_periodic_changes_are_no_drift(periods, phase):
    loop = discover(lambda s: 0.5 * np.cos(2 * np.pi * (periods * s + phase)))
    assert loop.effects_ == ()


def test_prediction_after_the_recording(warming):
    later = warming.predict(ARM.position, t=ARM.t + LENGTH)
    moves = np.abs(ARM.v[:, 0]) > 0.3
    # The drift has decayed after the recording.
    whole = warming.predict(ARM.position)
    assert np.abs(later - whole)[moves, 0].max() > 1.0


@pytest.mark.slow
def test_payload_is_kept_after_the_recording():
    from tests.effects._arms import inverse_dynamics, with_changed_body

    body = np.array([0.8, 0.0, 0.1, 0.2, 0.06, 0.0, 0.04, 0.0, 0.0, 0.04])
    states = np.hstack([ARM.q, ARM.v, ARM.a])
    more = inverse_dynamics(with_changed_body(ARM.model, body), states) - ARM.load
    torque = ARM.torque() + more * (ARM.t >= 12.0)[:, None]
    loop = ARM.discover(torque, ["payload", "offset"])
    (payload,) = loop.effects_
    assert payload.name == "payload"
    now, later = (loop.predict(ARM.position, t=ARM.t + s) for s in (0.0, LENGTH))
    before, after = ARM.t < 11.9, ARM.t > 12.1
    np.testing.assert_allclose(later[after], now[after], rtol=1e-9)
    errors = np.abs(later - now - more)[before]
    assert errors.mean() < 0.05 * np.abs(more[before]).mean()
