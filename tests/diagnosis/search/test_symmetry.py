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
