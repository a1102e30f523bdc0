"""EffectDiscovery on recordings with temporary effects and coloured noise."""

import numpy as np
import pytest
from scipy.signal import lfilter

from sklearn_vbjfa.diagnosis.explain import _split
from tests._quick import one_in
from tests.diagnosis._recordings import named, record

ONE = record("Y", seed=0, duration=24.0)
ARM = record("ZY", seed=2, duration=30.0)
# The search uses the first three quarters.
SEARCHED = 18.0
GRAVITY = 9.81


@pytest.fixture(autouse=True)
def one_held_out_segment(monkeypatch):
    """Hold out one segment, at the end of the recording."""
    # Per test, so that shared session fixtures are not affected.
    monkeypatch.setattr(_split, "_STRETCHES", 1)


def ripple(r):
    return np.cos(9.0 * r.q[:, 0])


def coulomb(r):
    return np.sign(r.v[:, 0])


def load(r, begin, end=np.inf):
    """Torque of a mass on the arm between two instants."""
    active = (r.t > begin) & (r.t < end)
    return 0.06 * GRAVITY * np.sin(r.q[:, 0]) * active


def discover(torque, library, **options):
    return ONE.discover(ONE.torque(joint_1=torque), library, **options)


def names(loop):
    return [e.name for e in loop.effects_]


def test_a_counterbalance_is_not_named_spring():
    loop = discover(
        lambda r: 3.0 * np.sin(2 * r.q[:, 0] + 0.8), ["spring", "counterbalance"]
    )
    assert names(loop) == ["counterbalance"]


def test_an_offset_is_reported_as_equilibrium_of_the_spring():
    loop = discover(lambda r: 2.0 * (r.q[:, 0] + 1.0), ["spring", "offset", "coulomb"])
    (spring,) = loop.effects_
    assert spring.name == "spring"
    assert spring.parameters["k"] == pytest.approx(2.0, rel=0.05)
    assert spring.parameters["q0"] == pytest.approx(-1.0, rel=0.1)
    low, high = spring.intervals["q0"]
    assert low < -1.0 < high
    assert 0.5 * (low + high) == pytest.approx(spring.parameters["q0"])


def test_effects_are_replaced_after_a_better_one_is_added():
    """Friction looks quadratic while a spring is missing."""
    loop = discover(
        lambda r: 2.0 * r.q[:, 0] + 0.5 * np.cos(9.0 * r.q[:, 0]),
        ["viscous_quadratic", "spring", "ripple"],
    )
    assert sorted(names(loop)) == ["ripple", "spring"]


def test_temporary_ripple_is_not_named():
    loop = discover(lambda r: 2.0 * ripple(r) * (r.t < 0.6 * SEARCHED), ["ripple"])
    assert names(loop) == []


@pytest.mark.parametrize("begin", one_in(2, [14.0, 9.0]))
def test_payloads_are_found_with_their_instant(begin):
    loop = discover(lambda r: load(r, begin), ["payload"])
    assert names(loop) == ["payload"]
    assert loop.effects_[0].parameters["instant"] == pytest.approx(begin, abs=0.2)


@pytest.mark.parametrize("times", one_in(2, [(5.0, 11.5), (14.0, 16.0)]))
def test_payloads_that_are_put_down_again_are_found(times):
    begin, end = times
    loop = discover(lambda r: 3.0 * load(r, begin, end), ["payload"])
    assert names(loop) == ["payload"]
    found = loop.effects_[0].parameters
    assert found["instant"] == pytest.approx(begin, abs=0.2)
    assert found["until"] == pytest.approx(end, abs=0.2)
    assert loop.error_after_[0] < 0.01


@pytest.mark.slow
def test_a_temporary_spring_is_not_named():
    """Quadratic friction acts throughout the recording."""
    first = ARM.t < 0.75 * ARM.t[-1] / 3
    torque = ARM.torque(joint_2=lambda r: 0.4 * r.v[:, 1] * np.abs(r.v[:, 1]))
    torque[first, 0] += 4.0 * ARM.q[first, 0]
    loop = ARM.discover(torque, ["spring", "viscous_quadratic"])
    assert named(loop) == [("viscous_quadratic", 1)]


@pytest.mark.slow
def test_alpha_is_the_required_error_probability():
    """The probability of the effect lies between the two levels."""

    def torque(r):
        return 0.01 * ripple(r)

    first = discover(torque, ["ripple"], alpha=0.4)
    (effect,) = (*first.effects_, *first.possible_)
    assert 0.5 < effect.evidence.probability < 0.9999
    error = 1 - effect.evidence.probability
    sure = discover(torque, ["ripple"], alpha=min(2 * error, 0.45))
    unsure = discover(torque, ["ripple"], alpha=error / 2)
    assert names(sure) == ["ripple"]
    assert names(unsure) == []
    (possible,) = unsure.possible_
    assert possible.evidence.probability == pytest.approx(effect.evidence.probability)
    assert possible.warning
    # The completed model is the same.
    assert (sure.error_after_ == unsure.error_after_).all()


def test_unexplained_power_matches_the_vibration():
    """A vibration and white noise, both of known amplitude."""
    size = 0.1
    loop = discover(lambda r: size * np.sqrt(2) * np.sin(10.7 * r.t), ["coulomb"])
    (residual,) = loop.unexplained_
    assert residual.rms**2 == pytest.approx(size**2 + residual.floor**2, rel=0.15)
    # The floor is the expected noise, from which one recording deviates.
    share = 1 - (residual.floor / residual.rms) ** 2
    assert share == pytest.approx(size**2 / residual.rms**2, abs=0.15)


SLOW = ["drift", "payload", "ripple", "viscous_quadratic", "spring"]


def slow_noise():
    keep, rng = np.exp(-0.02 / 5.0), np.random.default_rng(3)
    steps = np.r_[0.0, np.sqrt(1 - keep**2) * rng.normal(size=ONE.t.size - 1)]
    return lfilter([1.0], [1.0, -keep], steps)


def test_slow_noise_causes_no_false_positives():
    noise = slow_noise()
    assert names(discover(lambda r: noise, SLOW)) == []


def test_slow_noise_does_not_hide_fast_effects():
    noise = slow_noise()
    # RMS: half of the noise.
    size = 0.5 * np.sqrt(2)
    loop = discover(lambda r: noise + size * ripple(r), SLOW)
    assert names(loop) == ["ripple"]
    low, high = loop.effects_[0].intervals["A"]
    assert low < size < high
    assert low > 0
