"""Effects that the search reports for simulated recordings."""

import ast
from pathlib import Path

import numpy as np
import pytest

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis import SearchSettings
from sklearn_vbjfa.diagnosis.search import _stepwise
from tests.diagnosis._recordings import record
from tests.diagnosis.search._searches import (
    CLEAN,
    coulomb,
    found,
    search,
    spring,
    stribeck,
)
from tests.diagnosis.search.test_own_effects import custom
from tests.effects._arms import lag_step_by_step


def test_a_complete_model_needs_no_effects():
    result = search(CLEAN.torque(), ["coulomb", "spring", "offset"]).run()
    assert result.effects == ()
    assert result.findings == ()
    assert result.needed == pytest.approx(np.log(19.0))


def test_found_effects_are_probable_and_reduce_the_error():
    torque = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(4.0, 1.0))
    result = search(torque, ["coulomb", "spring", "offset"]).run()
    assert sorted(found(result)) == [("coulomb", 1), ("spring", 0)]
    for finding in result.findings:
        assert finding.evidence.log_odds > result.needed
        assert finding.evidence.probability > 0.95
        assert finding.evidence.gain > 0.5


def test_stribeck_requires_the_right_sign():
    """Friction that decreases towards standstill is no Stribeck friction."""
    rising = CLEAN.torque(joint_2=stribeck(0.6))
    falling = CLEAN.torque(joint_2=stribeck(-0.6))
    friction = ("viscous", "coulomb")
    for torque, expected in ((rising, [("stribeck", 1)]), (falling, [])):
        robot = CLEAN.robot(friction=friction)
        assert found(search(torque, ["stribeck"], robot=robot).run()) == expected


def test_quadratic_friction_is_not_combined_with_negative_viscous_friction():
    def torque(r):
        v = r.v[:, 1]
        return (1.0 + 1.0 / (1.0 + (v / 0.3) ** 2)) * np.sign(v) - 0.45 * v

    robot = CLEAN.robot(friction=("viscous", "coulomb"))
    now = search(CLEAN.torque(joint_2=torque), ["viscous_quadratic"], robot=robot)
    assert not found(now.run())


def test_simple_effects_are_preferred_to_general_ones():
    torque = CLEAN.torque(joint_2=coulomb(1.0))
    now = search(torque, ["stribeck", "maxwell_slip", "asymmetric_friction", "coulomb"])
    assert found(now.run()) == [("coulomb", 1)]


def test_a_constant_is_no_spring():
    result = search(CLEAN.torque(joint_1=spring(0.0, 1.0)), ["spring", "offset"]).run()
    assert found(result) == [("offset", 0)]


def test_effects_below_min_gain_are_left_out():
    long = record("Y", seed=0, duration=600.0)
    for min_gain, expected in ((0.02, 0), (0.001, 1)):
        settings = SearchSettings(min_gain=min_gain)
        torque = long.torque(joint_1=spring(0.01))
        result = search(torque, ["spring"], long, settings=settings).run()
        assert len(result.effects) == expected


def test_selection_of_shapes_causes_no_false_positives():
    """The best period fits the noise; the evidence averages over all periods."""
    noisy = record("Y", seed=1, duration=24.0, noise=0.5)
    assert search(noisy.torque(), ["ripple"], noisy).run().findings == ()


# -- directions


FAST = record("ZY", seed=4, duration=40.0, noise=0.02)
CHANNELS = ["coulomb", "maxwell_slip", "delay", "torque_filter", "jerk"]


def on_joint_2(torque, function):
    out = torque.copy()
    out[:, 1] = function(torque[:, 1])
    return out


def shifted(torque, seconds):
    return on_joint_2(torque, lambda x: np.interp(FAST.t - seconds, FAST.t, x))


def averaged(torque, seconds):
    """Return the moving average around each sample."""
    n = round(seconds / (FAST.t[1] - FAST.t[0])) | 1
    return on_joint_2(torque, lambda x: np.convolve(x, np.ones(n) / n, mode="same"))


def lagged(torque, time_constant):
    dt = FAST.t[1] - FAST.t[0]
    return on_joint_2(torque, lambda x: lag_step_by_step(x, dt, time_constant))


@pytest.mark.parametrize("delay", [0.02, -0.02])
def test_delays_and_leads_are_found(delay):
    result = search(shifted(FAST.torque(), delay), ["delay"], FAST).run()
    assert found(result) == [("delay", 1)]
    value = result.effects[0].parameters(result.fit.coefficients(0))["delay"]
    assert value == pytest.approx(delay, rel=0.1)
    assert result.findings[0].evidence.gain > 0.5


def test_a_smoothed_torque_is_no_delay():
    torque = averaged(FAST.torque(), 0.1)
    assert found(search(torque, ["delay"], FAST).run()) == []
    result = search(torque, ["delay", "torque_filter"], FAST).run()
    assert found(result) == [("torque_filter", 1)]
    assert (result.effects[0].kind, result.effects[0].of) == ("smooth", "torque")


@pytest.mark.slow
def test_a_short_lag_is_named_delay_or_filter():
    loop = FAST.discover(lagged(FAST.torque(), 0.015), CHANNELS)
    (effect,) = loop.effects_
    assert effect.joint == 1
    value = {"delay": "delay", "torque_filter": "time_constant"}[effect.name]
    assert effect.parameters[value] == pytest.approx(0.015, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("smoothed", "kind", "name", "value"),
    [
        (lambda tau: lagged(tau, 0.06), "lag", "time_constant", 0.06),
        # Half-power frequency of a moving average over 0.3 s.
        (lambda tau: averaged(tau, 0.3), "smooth", "cutoff", 0.443 / 0.3),
    ],
    ids=["lag", "mean"],
)
def test_a_smoothed_torque_is_a_filter(smoothed, kind, name, value):
    loop = FAST.discover(smoothed(FAST.torque()), CHANNELS)
    (effect,) = (e for e in loop.effects_ if e.name == "torque_filter")
    assert effect.joint == 1
    assert effect.parameters["of"] == "torque"
    assert effect.parameters["kind"] == kind
    assert effect.parameters[name] == pytest.approx(value, rel=0.1)


# -- equivalent effects

# Slow signals unrelated to the robot.
SIGNAL = np.sin(2 * np.pi * 0.31 * CLEAN.t)
OTHER = np.sin(2 * np.pi * 0.23 * CLEAN.t + 0.5)


def signal_effect(kind, signal):
    """Define an effect whose column is a signal (n,)."""
    return custom(kind, lambda motion, joint: signal[: motion.q.shape[0], None])


def torque_of(signal):
    return CLEAN.torque(joint_1=lambda r: signal[: r.t.size])


def test_one_effect_replaces_two():
    """The third column is the sum of the other two."""
    library = [
        signal_effect("first", SIGNAL),
        signal_effect("second", OTHER),
        signal_effect("whole", SIGNAL + OTHER),
    ]
    assert found(search(torque_of(SIGNAL + OTHER), library).run()) == [("whole", 0)]
    # If both are needed, two are named; any two of the three are equivalent.
    result = search(torque_of(SIGNAL - OTHER), library).run()
    assert len(found(result)) == 2


@pytest.mark.parametrize("shares", [(0.12, 0.2), (0.18, 0.14)])
def test_gear_loss_is_not_named_torque_gain(shares):
    """Losses that depend on the direction of power resemble a wrong gain."""

    def loss(recording):
        load, v = recording.load[:, 1], recording.v[:, 1]
        return np.where(load * v > 0, *shares) * np.abs(load) * np.sign(v)

    recording = record("YXY", seed=3)
    robot = recording.robot(projector=None, input_noise=None)
    library = ("load_friction", "gear_loss", "torque_gain")
    run = search(recording.torque(joint_2=loss), library, recording, robot)
    assert found(run.run()) == [("gear_loss", 1)]


def test_diagnosis_code_contains_no_effect_names():
    """Properties of effects are attributes of their classes."""
    # These four words also have other meanings in the package (reasons, channel
    # findings, contradictions between recordings).
    names = set(effects.available()) - {"signal", "delay", "offset", "payload"}
    for path in Path(_stepwise.__file__).parents[1].rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        texts = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)}
        assert not texts & names, path.name
