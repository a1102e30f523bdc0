"""The models beside the servo are what they say: two ways to read them agree."""

import numpy as np
import pytest

pytest.importorskip("numba")

from _servo_models import DUTY, PUBLISHED, swing, voltage


@pytest.mark.parametrize("name", PUBLISHED)
def test_voltages_are_those_that_made_the_motion(name):
    """Of the inverse model along a motion that the forward model has made."""
    p, dt, supply, gain = PUBLISHED[name], 1e-3, 7.4, 200.0
    t = dt * np.arange(4000)
    goal = 0.8 * np.sin(2 * np.pi * 0.6 * t)
    q = swing(p, goal, gain, supply, 0.0, 3.0, dt, 20)
    v = np.gradient(q, dt)
    a = np.gradient(v, dt)
    told = supply * np.clip(DUTY * gain * (goal - q), -1, 1)
    moving = (np.abs(v) > 0.3) & (t > 0.5)
    found = voltage(p, q, v, a)
    assert np.abs(found - told)[moving].mean() < 0.01 * told[moving].std()


def test_friction_holds_a_servo_that_is_told_little():
    p = PUBLISHED["M1"]
    goal = np.full(500, 0.01)
    q = swing(p, goal, 100.0, 7.4, 0.0, 0.0, 1e-3, 4)
    assert np.abs(q).max() < 1e-9
