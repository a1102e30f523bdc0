"""EffectDiscovery with recorded signals: named signals and their rivals."""

import re

import numpy as np
import pytest

from sklearn_vbjfa import EffectDiscovery
from sklearn_vbjfa.effects import Signal
from tests._quick import one_in
from tests.diagnosis._recordings import named, record
from tests.diagnosis.report._pages import text_of

ARM = record("ZY", duration=30.0, seed=2)
SHARE = ARM.t / ARM.t[-1]
LIBRARY = ["spring", "signal", "drift"]
FRICTION, DECREASE = 2.0, 0.4
RAMP = 25 + 20 * SHARE**1.5
CYCLES = 35 - 10 * np.cos(2.5 * np.pi * SHARE)


def heated(temperature):
    """Simulate Coulomb friction on joint 1 that falls by 40 % from 25 to 45 degrees."""

    def friction(r):
        return FRICTION * (1 - DECREASE * (temperature - 25) / 20) * np.sign(r.v[:, 0])

    return ARM.torque(joint_1=friction)


def discover(torque, signals, effects=LIBRARY, recording=ARM):
    discovery = EffectDiscovery(recording.robot(), effects=effects, random_state=0)
    return discovery.fit(recording.position, torque, signals=signals)


def signal_effect(discovery):
    (match,) = (effect for effect in discovery.effects_ if effect.name == "signal")
    return match


@pytest.fixture(scope="module", name="warm")
def fixture_warm():
    return discover(heated(CYCLES), {"temperature": CYCLES})


@pytest.fixture(scope="module", name="pair")
def fixture_pair():
    gain = 3 * CYCLES + 100
    return discover(heated(CYCLES), {"temperature": CYCLES, "kp": gain})


def test_temperature_dependent_friction_is_found(warm):
    assert named(warm) == [("signal", 0)]
    effect = signal_effect(warm)
    assert effect.parameters["signal"] == "temperature"
    assert effect.parameters["of"] == "coulomb"
    low, high = effect.intervals["k"]
    assert low < -FRICTION * DECREASE / 20 < high
    assert high - low < 0.2 * FRICTION * DECREASE / 20
    assert effect.units["k"] == "N m per unit of temperature"
    assert warm.error_after_[0] < 0.2 * warm.error_before_[0]


def test_friction_refers_to_the_reference_value_of_the_signal(warm):
    values = warm.report_.outcome.facts_of("parameter")
    (coulomb,) = (value for value in values if value.name == "joint_1:coulomb")
    reference = signal_effect(warm).parameters["reference"]
    low, high = coulomb.interval
    assert low < FRICTION * (1 - DECREASE * (reference - 25) / 20) < high


def test_an_equivalent_drift_is_a_rival():
    """The temperature rises exponentially, as a drift does."""
    warming = 45 - 20 * np.exp(-SHARE / 0.7)
    loop = discover(heated(warming), {"temperature": warming})
    assert named(loop) == [("signal", 0)]
    assert "drift" in signal_effect(loop).rivals


def test_irrelevant_signals_are_not_named():
    torque = ARM.torque(
        joint_1=lambda r: FRICTION * np.sign(r.v[:, 0]),
        joint_2=lambda r: 2.0 * r.q[:, 1],
    )
    signals = {"temperature": RAMP, "tool": np.sign(CYCLES - 35), "supply": CYCLES}
    loop = discover(torque, signals)
    assert named(loop) == [("spring", 1)]


@pytest.mark.parametrize("seed", one_in(3, [20, 22, 25]))
def test_random_walk_signals_are_not_named(seed):
    """Random walks correlate by chance, but not on held-out data."""
    recording = record("ZY", duration=30.0, seed=seed, noise=0.1)
    rng = np.random.default_rng(seed + 1000)
    n = recording.t.size
    signals = {f"s{k}": np.cumsum(rng.normal(size=n)) for k in range(5)}
    wander = np.cumsum(rng.normal(size=(n, 2)), axis=0)
    torque = recording.torque() + 0.1 * wander / wander.std(axis=0)
    loop = discover(torque, signals, recording=recording)
    assert not [effect for effect in loop.effects_ if effect.name == "signal"]


def test_the_varying_friction_term_is_named():
    open_ = (np.floor(6 * SHARE) % 2).astype(float)

    def torque(r):
        return 0.8 * open_ * r.v[:, 1]

    loop = discover(ARM.torque(joint_2=torque), {"gripper": open_, "supply": CYCLES})
    effect = signal_effect(loop)
    assert (effect.joint, effect.parameters["of"]) == (1, "viscous")
    assert effect.parameters["signal"] == "gripper"
    low, high = effect.intervals["k"]
    assert low < 0.8 < high
    assert "(viscous, gripper)" in text_of(loop.report_)


def test_proportional_signals_are_rivals(pair):
    assert named(pair) == [("signal", 0)]
    effect = signal_effect(pair)
    (other,) = {"temperature", "kp"} - {effect.parameters["signal"]}
    assert effect.rivals[0] == f"signal: {other}"
    slope = -FRICTION * DECREASE / 20 / {"temperature": 3, "kp": 1}[other]
    low, high = effect.intervals["k"]
    factor = 3 if effect.parameters["signal"] == "kp" else 1
    assert low < -FRICTION * DECREASE / 20 / factor < high
    assert slope < 0
    for text in (" ".join(str(pair.report_).split()), text_of(pair.report_)):
        assert re.search(rf"indistinguishable from\b.*\b{other}\b", text, re.DOTALL)


def test_a_prediction_needs_the_signal(warm):
    X = ARM.position[:400]
    with pytest.raises(ValueError, match="signal 'temperature', which an effect needs"):
        warm.predict(X)
    cold, hot = (
        warm.predict(X, signals={"temperature": np.full(400, degrees)})
        for degrees in (25.0, 45.0)
    )
    moves = np.abs(ARM.v[:400, 0]) > 0.3
    change = (hot - cold)[moves, 0] * np.sign(ARM.v[:400, 0][moves])
    np.testing.assert_allclose(change, -FRICTION * DECREASE, rtol=0.1)
    np.testing.assert_array_equal(cold[:, 1], hot[:, 1])
    score = warm.score(X, heated(CYCLES)[:400], signals={"temperature": CYCLES[:400]})
    assert score > 0.95


def test_report_lists_the_signals(pair, warm):
    outcome = pair.report_.to_dict()
    assert outcome["provenance"]["settings"]["signals"] == ["temperature", "kp"]
    assert "temperature, kp" in text_of(pair.report_)
    text = text_of(warm.report_)
    assert "(coulomb, temperature)" in text
    assert "N m per unit of temperature" in text
    assert not [row for row in outcome["not_identifiable"] if row["name"] == "signal"]


def test_an_effect_can_be_restricted_to_one_signal():
    signals = {"temperature": CYCLES, "kp": 3 * CYCLES + 100}
    library = ["spring", Signal(signal="kp")]
    effect = signal_effect(discover(heated(CYCLES), signals, library))
    assert effect.parameters["signal"] == "kp"
    assert not [rival for rival in effect.rivals if "temperature" in rival]
    message = "signal 'x', which an effect needs, is missing"
    for recorded in (signals, None):
        with pytest.raises(ValueError, match=message):
            discover(heated(CYCLES), recorded, [Signal(signal="x")])
