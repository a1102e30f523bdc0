"""Delays that are none: what the mirror image explains as well."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa.diagnosis.search._symmetry import refuse_symmetric
from tests.diagnosis._recordings import record
from tests.diagnosis.search._searches import search

FAST = record("ZY", seed=4, duration=40.0, noise=0.02)


def shifted(torque, seconds):
    t = FAST.t
    out = torque.copy()
    out[:, 1] = np.interp(t - seconds, t, torque[:, 1])
    return out


def averaged(torque, seconds):
    """Mean over a window around each sample."""
    n = round(seconds / (FAST.t[1] - FAST.t[0])) | 1
    out = torque.copy()
    out[:, 1] = np.convolve(torque[:, 1], np.ones(n) / n, mode="same")
    return out


def tried(torque, *names):
    now = search(torque, names, FAST)
    now.accept(())
    candidates, _ = now.try_joint(1, now.model)
    return candidates


def test_half_of_what_is_saved_is_the_border():
    assert not refuse_symmetric(1.0, 0.5)
    assert refuse_symmetric(1.0, 0.51)
    assert not refuse_symmetric(1.0, -0.2)


@pytest.mark.parametrize("late", [0.02, -0.02])
def test_a_delay_has_a_direction(late):
    found = tried(shifted(FAST.torque(), late), "delay")
    assert np.sign(found["delay"].effect.delay) == np.sign(late)
    assert found["delay"].evidence.gain > 0.5


def test_a_smoothed_torque_is_not_late():
    torque = averaged(FAST.torque(), 0.1)
    found = tried(torque, "delay", "torque_filter")
    assert "delay" not in found
    kind = found["torque_filter"].effect
    assert (kind.kind, kind.of) == ("smooth", "torque")
    assert found["torque_filter"].evidence.gain > 0.3


def test_a_direction_is_taken_once():
    """Beside a delay of one signal none of the other is tried."""
    torque = shifted(FAST.torque(), 0.02)
    now = search(torque, ["delay"], FAST)
    now.accept(())
    (effect,) = (c.effect for c in now.try_joint(1, now.model)[0].values())
    now.accept([effect])
    assert now.try_joint(1, now.model)[0] == {}


def lagged(torque, time_constant):
    """Euler steps of a low-pass of the first order, fine enough not to matter."""
    n, dt = 50, FAST.t[1] - FAST.t[0]
    fine = np.interp(np.arange(0, FAST.t.size - 1 + 1e-9, 1 / n), *_samples(torque))
    passed = np.empty_like(fine)
    passed[0] = fine[0]
    share = dt / n / time_constant
    for i in range(1, fine.size):
        passed[i] = passed[i - 1] + share * (fine[i] - passed[i - 1])
    out = torque.copy()
    out[:, 1] = passed[::n]
    return out


def _samples(torque):
    return np.arange(FAST.t.size), torque[:, 1]


CHANNELS = ["coulomb", "presliding", "delay", "torque_filter", "jerk"]


def test_a_short_lag_is_called_a_delay_and_a_long_one_a_filter():
    loop = FAST.discover(lagged(FAST.torque(), 0.015), CHANNELS)
    (effect,) = loop.effects_
    assert (effect.name, effect.joint) == ("delay", 1)
    assert effect.parameters["delay"] == pytest.approx(0.015, rel=0.2)
    loop = FAST.discover(lagged(FAST.torque(), 0.06), CHANNELS)
    (effect,) = loop.effects_
    assert (effect.name, effect.joint) == ("torque_filter", 1)
    assert effect.parameters["kind"] == "lag"
    assert effect.parameters["of"] == "torque"
    assert effect.parameters["time_constant"] == pytest.approx(0.06, rel=0.1)


def test_a_smoothed_torque_is_named():
    loop = FAST.discover(averaged(FAST.torque(), 0.3), CHANNELS)
    (effect,) = loop.effects_
    assert (effect.name, effect.joint) == ("torque_filter", 1)
    assert effect.parameters["kind"] == "smooth"
    # A mean over 0.3 s leaves half of the power at 0.443 / 0.3 s.
    assert effect.parameters["cutoff"] == pytest.approx(0.443 / 0.3, rel=0.15)
