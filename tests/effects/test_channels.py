"""Filters of the torque channels against closed forms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.base import clone

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import Motion, low_pass, smooth

DT = 0.002
T = DT * np.arange(4000)
STILL = np.zeros((T.size, 1))


def motion_with_load(load, **channels):
    return Motion(q=STILL, v=STILL, a=STILL, t=T, load=load[:, None], **channels)


def filter_torque(effect, torque, **channels):
    """Return the torque as filtered by the channel that an effect describes."""
    scale = getattr(effect, effect.continuous[0])
    return torque + scale * effect.columns(motion_with_load(torque, **channels))[:, 0]


@pytest.mark.parametrize("frequency", [0.5, 3.0, 11.0])
@pytest.mark.parametrize("constant", [0.004, 0.05])
def test_lag_response_to_a_sine(frequency, constant):
    w = 2 * np.pi * frequency
    # y' = (sin(w t) - y) / T from y(0) = 0
    steady = (np.sin(w * T) - w * constant * np.cos(w * T)) / (1 + (w * constant) ** 2)
    transient = np.exp(-T / constant) * w * constant / (1 + (w * constant) ** 2)
    effect = effects.TorqueFilter(kind="lag", time_constant=constant)
    response = filter_torque(effect, np.sin(w * T))
    # Linear interpolation of the sine has an error of at most (w dt)^2 / 8.
    assert_allclose(response, steady + transient, atol=(w * DT) ** 2 / 8 + 1e-12)


@pytest.mark.parametrize("frequency", [0.5, 3.0, 11.0])
@pytest.mark.parametrize("constant", [0.004, 0.03])
def test_smoothing_attenuates_a_sine_without_phase_shift(frequency, constant):
    w = 2 * np.pi * frequency
    effect = effects.TorqueFilter(kind="smooth", time_constant=constant)
    inside = slice(100, -100)
    response = filter_torque(effect, np.sin(w * T))[inside]
    expected = np.exp(-0.5 * (w * constant) ** 2) * np.sin(w * T)[inside]
    # The truncation at four standard deviations omits 6e-5 of the weights.
    assert_allclose(response, expected, atol=1e-3)


def test_a_coefficient_gives_the_time_constant_to_first_order():
    """The response is linear in T for a lag and in T^2 for smoothing."""
    w = 2 * np.pi * 0.2
    tone = np.sin(w * T)
    inside = slice(1000, -1000)
    for kind in ("lag", "smooth"):
        truth = effects.TorqueFilter(kind=kind, time_constant=0.012)
        effect = clone(truth).set_params(time_constant=0.01)
        change = (filter_torque(truth, tone) - tone)[inside]
        column = effect.columns(motion_with_load(tone))[inside, 0]
        coef = column @ change / (column @ column)
        assert effect.plausible([coef])
        assert effect.parameters([coef])["time_constant"] == pytest.approx(0.012, 0.01)


@pytest.mark.parametrize("kind", ["lag", "smooth"])
def test_filtered_positions_need_the_inverse_filter(kind):
    """Filtering the compensated torque restores it up to terms of third order."""
    errors = []
    for frequency in (0.4, 0.8):
        tone = np.sin(2 * np.pi * frequency * T)
        effect = effects.TorqueFilter(kind=kind, of="position", time_constant=0.05)
        restored = {"lag": low_pass, "smooth": smooth}[kind](
            filter_torque(effect, tone), DT, 0.05
        )
        errors.append(np.abs(restored - tone)[800:-800].max())
    assert errors[0] < 0.01
    # (w T)^3 of the lag, (w T)^6 of the average
    order = {"lag": 3, "smooth": 6}[kind]
    assert np.log2(errors[1] / errors[0]) == pytest.approx(order, abs=0.5)


def test_jerk_is_the_derivative_of_the_acceleration():
    w = 2 * np.pi * 1.5
    a = np.cos(w * T)[:, None]
    motion = Motion(q=STILL, v=STILL, a=a, t=T)
    column = effects.Jerk().columns(motion)[:, 0]
    assert_allclose(column[1:-1], -w * np.sin(w * T)[1:-1], atol=w**3 * DT**2 / 4)
