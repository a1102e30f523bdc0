"""The search by itself: what it names in recordings whose torques are known."""

import ast
from pathlib import Path

import numpy as np
import pytest

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis import SearchSettings
from sklearn_vbjfa.diagnosis.search import _path
from tests.diagnosis._recordings import record
from tests.diagnosis.search._searches import (
    CLEAN,
    coulomb,
    found,
    search,
    spring,
    stribeck,
)
from tests.diagnosis.search.test_own_effects import own
from tests.effects._arms import lag_step_by_step


def test_a_clean_recording_needs_nothing():
    nothing = search(CLEAN.torque(), ["coulomb", "spring", "offset"]).run()
    assert nothing.effects == ()
    assert nothing.findings == ()
    assert nothing.needed == pytest.approx(np.log(19.0))


def test_what_is_found_is_sure_and_saves_most():
    torque = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(4.0, 1.0))
    now = search(torque, ["coulomb", "spring", "offset"]).run()
    assert sorted(found(now)) == [("coulomb", 1), ("spring", 0)]
    for finding in now.findings:
        assert finding.evidence.log_odds > now.needed
        assert finding.evidence.probability > 0.95
        assert finding.evidence.gain > 0.5


def test_what_has_the_wrong_sign_is_something_else():
    """Friction that falls towards standstill is no Stribeck friction."""
    rising = CLEAN.torque(joint_2=stribeck(0.6))
    falling = CLEAN.torque(joint_2=stribeck(-0.6))
    friction = ("viscous", "coulomb")
    for torque, expected in ((rising, [("stribeck", 1)]), (falling, [])):
        robot = CLEAN.robot(friction=friction)
        assert found(search(torque, ["stribeck"], robot=robot).run()) == expected


def test_a_fall_with_speed_is_no_quadratic_friction_beside_one_that_drives():
    def torque(r):
        v = r.v[:, 1]
        return (1.0 + 1.0 / (1.0 + (v / 0.3) ** 2)) * np.sign(v) - 0.45 * v

    robot = CLEAN.robot(friction=("viscous", "coulomb"))
    now = search(CLEAN.torque(joint_2=torque), ["viscous_quadratic"], robot=robot)
    assert not found(now.run())


def test_the_plain_effect_comes_before_what_contains_it():
    torque = CLEAN.torque(joint_2=coulomb(1.0))
    now = search(torque, ["stribeck", "maxwell_slip", "asymmetric_friction", "coulomb"])
    assert found(now.run()) == [("coulomb", 1)]


def test_a_constant_is_no_spring():
    now = search(CLEAN.torque(joint_1=spring(0.0, 1.0)), ["spring", "offset"]).run()
    assert found(now) == [("offset", 0)]


def test_what_saves_next_to_nothing_is_not_in_the_model():
    """However probable it is: a name asks for twice as much."""
    long = record("Y", seed=0, duration=600.0)
    for worth, expected in ((0.02, 0), (0.001, 1)):
        settings = SearchSettings(min_gain=worth)
        torque = long.torque(joint_1=spring(0.01))
        now = search(torque, ["spring"], long, settings=settings).run()
        assert len(now.effects) == expected


def test_the_best_of_many_shapes_is_not_named_in_noise():
    """Its best period helps on all rows: averaged over all it is improbable."""
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
    """Mean over a window around each sample."""
    n = round(seconds / (FAST.t[1] - FAST.t[0])) | 1
    return on_joint_2(torque, lambda x: np.convolve(x, np.ones(n) / n, mode="same"))


def lagged(torque, time_constant):
    dt = FAST.t[1] - FAST.t[0]
    return on_joint_2(torque, lambda x: lag_step_by_step(x, dt, time_constant))


@pytest.mark.parametrize("late", [0.02, -0.02])
def test_a_delay_has_a_direction(late):
    now = search(shifted(FAST.torque(), late), ["delay"], FAST).run()
    assert found(now) == [("delay", 1)]
    value = now.effects[0].parameters(now.fit.coefficients(0))["delay"]
    assert value == pytest.approx(late, rel=0.1)
    assert now.findings[0].evidence.gain > 0.5


def test_a_smoothed_torque_is_not_late():
    torque = averaged(FAST.torque(), 0.1)
    assert found(search(torque, ["delay"], FAST).run()) == []
    now = search(torque, ["delay", "torque_filter"], FAST).run()
    assert found(now) == [("torque_filter", 1)]
    assert (now.effects[0].kind, now.effects[0].of) == ("smooth", "torque")


@pytest.mark.slow
def test_a_short_lag_is_one_or_a_delay_and_nothing_else():
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
        # A mean over 0.3 s leaves half of the power at 0.443 / 0.3 s.
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


# -- effects that stand for each other

# Slow signals that nothing has.
SIGNAL = np.sin(2 * np.pi * 0.31 * CLEAN.t)
OTHER = np.sin(2 * np.pi * 0.23 * CLEAN.t + 0.5)


def given(kind, signal):
    """Make an effect whose column is a signal (n,) of the recording."""
    return own(kind, lambda motion, joint: signal[: motion.q.shape[0], None])


def torque_of(signal):
    return CLEAN.torque(joint_1=lambda r: signal[: r.t.size])


def test_one_in_place_of_two():
    """Two that together are the third."""
    library = [
        given("first", SIGNAL),
        given("second", OTHER),
        given("whole", SIGNAL + OTHER),
    ]
    assert found(search(torque_of(SIGNAL + OTHER), library).run()) == [("whole", 0)]
    # Where both are needed they are named: any two of the three are the same model.
    now = search(torque_of(SIGNAL - OTHER), library).run()
    assert len(found(now)) == 2


@pytest.mark.parametrize("shares", [(0.12, 0.2), (0.18, 0.14)])
def test_gear_loss_is_no_wrong_gain_beside_load_friction(shares):
    """The load by a share is what the direction of power makes of the loss."""

    def loss(recording):
        load, v = recording.load[:, 1], recording.v[:, 1]
        return np.where(load * v > 0, *shares) * np.abs(load) * np.sign(v)

    recording = record("YXY", seed=3)
    robot = recording.robot(projector=None, input_noise=None)
    library = ("load_friction", "gear_loss", "torque_gain")
    run = search(recording.torque(joint_2=loss), library, recording, robot)
    assert found(run.run()) == [("gear_loss", 1)]


def test_no_effect_is_named_in_the_search():
    """What must be known of an effect is read off its class."""
    # A signal is also what an effect may need, in plain English; a delay of a channel
    # a finding of its own; and recordings may differ by an offset or a payload.
    names = set(effects.available()) - {"signal", "delay", "offset", "payload"}
    for path in Path(_path.__file__).parents[1].rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        texts = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)}
        assert not texts & names, path.name
