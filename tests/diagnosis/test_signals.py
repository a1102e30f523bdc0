"""Recorded signals in the loop: which are named, what they cannot be told from."""

import re

import numpy as np
import pytest

from sklearn_vbjfa import EffectDiscovery
from sklearn_vbjfa.effects import Signal
from tests._quick import one_in
from tests.diagnosis._recordings import named, record
from tests.diagnosis.report._pages import text_of

ONE = record("ZY", duration=30.0, seed=2)
SHARE = ONE.t / ONE.t[-1]
LIBRARY = ["spring", "signal", "drift"]
FRICTION, FALL = 2.0, 0.4
RAMP = 25 + 20 * SHARE**1.5
CYCLES = 35 - 10 * np.cos(2.5 * np.pi * SHARE)


def heated(temperature):
    """Torques whose Coulomb friction on joint 1 falls by 40 % from 25 to 45 degrees."""

    def friction(r):
        return FRICTION * (1 - FALL * (temperature - 25) / 20) * np.sign(r.v[:, 0])

    return ONE.torque(joint_1=friction)


def close(torque, signals, effects=LIBRARY, recording=ONE):
    loop = EffectDiscovery(recording.robot(), effects=effects, random_state=0)
    return loop.fit(recording.position, torque, signals=signals)


def the_signal(loop):
    (found,) = (effect for effect in loop.effects_ if effect.name == "signal")
    return found


@pytest.fixture(scope="module", name="warm")
def fixture_warm():
    return close(heated(CYCLES), {"temperature": CYCLES})


@pytest.fixture(scope="module", name="both")
def fixture_both():
    gain = 3 * CYCLES + 100
    return close(heated(CYCLES), {"temperature": CYCLES, "kp": gain})


# -- what is named


def test_friction_that_falls_with_temperature_is_named(warm):
    assert named(warm) == [("signal", 0)]
    found = the_signal(warm)
    assert found.parameters["signal"] == "temperature"
    assert found.parameters["of"] == "coulomb"
    low, high = found.intervals["k"]
    assert low < -FRICTION * FALL / 20 < high
    assert high - low < 0.2 * FRICTION * FALL / 20
    assert found.units["k"] == "N m per unit of temperature"
    assert warm.error_after_[0] < 0.2 * warm.error_before_[0]


def test_the_friction_is_that_of_the_reference(warm):
    values = warm.report_.outcome.facts_of("parameter")
    (coulomb,) = (one for one in values if one.name == "joint_1:coulomb")
    reference = the_signal(warm).parameters["reference"]
    low, high = coulomb.interval
    assert low < FRICTION * (1 - FALL * (reference - 25) / 20) < high


def test_a_drift_that_explains_as_much_is_its_rival():
    """A robot that warms up as a drift does; nothing of the signal is tuned."""
    warming = 45 - 20 * np.exp(-SHARE / 0.7)
    loop = close(heated(warming), {"temperature": warming})
    assert named(loop) == [("signal", 0)]
    assert "drift" in the_signal(loop).rivals


def test_a_signal_that_nothing_varies_with_is_not_named():
    torque = ONE.torque(
        joint_1=lambda r: FRICTION * np.sign(r.v[:, 0]),
        joint_2=lambda r: 2.0 * r.q[:, 1],
    )
    signals = {"temperature": RAMP, "tool": np.sign(CYCLES - 35), "supply": CYCLES}
    loop = close(torque, signals)
    assert named(loop) == [("spring", 1)]


@pytest.mark.parametrize("seed", one_in(3, [20, 22, 25]))
def test_torques_that_wander_are_no_matter_of_signals_that_wander(seed):
    """Two slow curves resemble each other by chance; later they part."""
    recording = record("ZY", duration=30.0, seed=seed, noise=0.1)
    rng = np.random.default_rng(seed + 1000)
    n = recording.t.size
    signals = {f"s{k}": np.cumsum(rng.normal(size=n)) for k in range(5)}
    wander = np.cumsum(rng.normal(size=(n, 2)), axis=0)
    torque = recording.torque() + 0.1 * wander / wander.std(axis=0)
    loop = close(torque, signals, recording=recording)
    assert not [effect for effect in loop.effects_ if effect.name == "signal"]


def test_what_varies_is_named():
    open_ = (np.floor(6 * SHARE) % 2).astype(float)

    def torque(r):
        return 0.8 * open_ * r.v[:, 1]

    loop = close(ONE.torque(joint_2=torque), {"gripper": open_, "supply": CYCLES})
    found = the_signal(loop)
    assert (found.joint, found.parameters["of"]) == (1, "viscous")
    assert found.parameters["signal"] == "gripper"
    low, high = found.intervals["k"]
    assert low < 0.8 < high
    assert "(viscous, gripper)" in text_of(loop.report_)


# -- rivals


def test_signals_that_go_together_are_rivals(both):
    assert named(both) == [("signal", 0)]
    found = the_signal(both)
    (other,) = {"temperature", "kp"} - {found.parameters["signal"]}
    assert found.rivals[0] == f"signal: {other}"
    slope = -FRICTION * FALL / 20 / {"temperature": 3, "kp": 1}[other]
    low, high = found.intervals["k"]
    factor = 3 if found.parameters["signal"] == "kp" else 1
    assert low < -FRICTION * FALL / 20 / factor < high
    assert slope < 0
    for said in (" ".join(str(both.report_).split()), text_of(both.report_)):
        assert re.search(rf"indistinguishable from\b.*\b{other}\b", said, re.DOTALL)


# -- the model that is handed over


def test_a_prediction_needs_the_signal(warm):
    X = ONE.position[:400]
    with pytest.raises(ValueError, match="signal 'temperature', which an effect needs"):
        warm.predict(X)
    cold, hot = (
        warm.predict(X, signals={"temperature": np.full(400, degrees)})
        for degrees in (25.0, 45.0)
    )
    moves = np.abs(ONE.v[:400, 0]) > 0.3
    change = (hot - cold)[moves, 0] * np.sign(ONE.v[:400, 0][moves])
    np.testing.assert_allclose(change, -FRICTION * FALL, rtol=0.1)
    np.testing.assert_array_equal(cold[:, 1], hot[:, 1])
    score = warm.score(X, heated(CYCLES)[:400], signals={"temperature": CYCLES[:400]})
    assert score > 0.95


def test_the_report_names_the_signals(both, warm):
    outcome = both.report_.to_dict()
    assert outcome["provenance"]["settings"]["signals"] == ["temperature", "kp"]
    assert "temperature, kp" in text_of(both.report_)
    said = text_of(warm.report_)
    assert "(coulomb, temperature)" in said
    assert "N m per unit of temperature" in said
    assert not [one for one in outcome["not_identifiable"] if one["name"] == "signal"]


# -- what the search is given


def test_an_effect_may_name_the_one_that_it_is_meant_for():
    signals = {"temperature": CYCLES, "kp": 3 * CYCLES + 100}
    meant = ["spring", Signal(signal="kp")]
    found = the_signal(close(heated(CYCLES), signals, meant))
    assert found.parameters["signal"] == "kp"
    assert not [rival for rival in found.rivals if "temperature" in rival]
    message = "signal 'x', which an effect needs, is missing"
    for known in (signals, None):
        with pytest.raises(ValueError, match=message):
            close(heated(CYCLES), known, [Signal(signal="x")])
