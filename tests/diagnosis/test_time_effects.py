"""Effects of time in the loop: which are named, and what is said of the time after."""

import numpy as np
import pytest

from tests._quick import checkered, one_in
from tests.diagnosis._recordings import named, record

ONE = record("ZY", duration=30.0, seed=2)
LENGTH = 30.0
FRICTION = 1.5
LIBRARY = ["coulomb", "drift", "offset"]


def close(change, recording=ONE, library=LIBRARY, **given):
    """Close the loop where the Coulomb friction of joint 1 changes with time."""

    def friction(r):
        return (FRICTION + change(r.t / LENGTH)) * np.sign(r.v[:, 0])

    return recording.discover(recording.torque(joint_1=friction), library, **given)


@pytest.fixture(scope="module")
def warming():
    return close(lambda s: 2.0 * np.exp(-s / 0.5))


# -- what is a drift and what is not


@pytest.mark.parametrize("share", one_in(2, [0.3, 0.8]))
def test_a_drift_that_lasts_is_named(share):
    loop = close(lambda s: np.exp(-s / share))
    assert named(loop) == [("drift", 0)]
    (drift,) = (e for e in loop.effects_ if e.name == "drift")
    low, high = drift.intervals["time_constant"]
    assert low - 0.2 * share * LENGTH < share * LENGTH < high + 0.2 * share * LENGTH


@pytest.mark.parametrize("share", one_in(2, [0.06, 0.04]))
def test_what_faded_within_the_first_seconds_is_a_drift_if_anything(share):
    recording = record("ZY", duration=LENGTH, seed=4)
    loop = close(lambda s: 3.0 * np.exp(-s / share), recording)
    found = (*loop.effects_, *loop.possible_)
    assert {effect.name for effect in found} <= {"drift"}


@pytest.mark.parametrize(("phase", "periods"), checkered([0.0, 0.25], [2.0, 1.0]))
def test_what_comes_and_goes_is_no_drift(periods, phase):
    loop = close(lambda s: 0.5 * np.cos(2 * np.pi * (periods * s + phase)))
    assert loop.effects_ == ()


# -- the time after the recording


def test_the_motion_after_the_recording_is_predicted(warming):
    later = warming.predict(ONE.position, t=ONE.t + LENGTH)
    moves = np.abs(ONE.v[:, 0]) > 0.3
    # Much less of it is left than in the recording.
    whole = warming.predict(ONE.position)
    assert np.abs(later - whole)[moves, 0].max() > 1.0


@pytest.mark.slow
def test_a_payload_stays():
    from tests.effects._arms import inverse_dynamics, with_changed_body

    body = np.array([0.8, 0.0, 0.1, 0.2, 0.06, 0.0, 0.04, 0.0, 0.0, 0.04])
    states = np.hstack([ONE.q, ONE.v, ONE.a])
    more = inverse_dynamics(with_changed_body(ONE.model, body), states) - ONE.load
    torque = ONE.torque() + more * (ONE.t >= 12.0)[:, None]
    loop = ONE.discover(torque, ["payload", "offset"])
    (payload,) = loop.effects_
    assert payload.name == "payload"
    now, later = (loop.predict(ONE.position, t=ONE.t + s) for s in (0.0, LENGTH))
    before, after = ONE.t < 11.9, ONE.t > 12.1
    np.testing.assert_allclose(later[after], now[after], rtol=1e-9)
    errors = np.abs(later - now - more)[before]
    assert errors.mean() < 0.05 * np.abs(more[before]).mean()
