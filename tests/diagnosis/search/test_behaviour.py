"""What the loop names and what it leaves, on recordings with a story."""

import numpy as np
import pytest
from scipy.signal import lfilter

from sklearn_vbjfa.diagnosis.explain import _split
from tests._quick import one_in
from tests.diagnosis._recordings import named, record

ONE = record("Y", seed=0, duration=24.0)
ARM = record("ZY", seed=2, duration=30.0)
# The search sees the first three quarters.
SEARCHED = 18.0
GRAVITY = 9.81


@pytest.fixture(autouse=True)
def at_the_end(monkeypatch):
    """One held-out stretch, at the end: stories are told by what is before it."""
    # For each test alone, so that shared searches are made before, without it.
    monkeypatch.setattr(_split, "_STRETCHES", 1)


def ripple(r):
    return np.cos(9.0 * r.q[:, 0])


def coulomb(r):
    return np.sign(r.v[:, 0])


def carried(r, begin, end=np.inf):
    """Torque of a mass on the arm between two times."""
    there = (r.t > begin) & (r.t < end)
    return 0.06 * GRAVITY * np.sin(r.q[:, 0]) * there


def close(torque, library, **given):
    return ONE.discover(ONE.torque(joint_1=torque), library, **given)


def names(loop):
    return [e.name for e in loop.effects_]


# -- what stands for what


def test_a_counterbalance_over_most_of_the_range_is_no_spring():
    loop = close(
        lambda r: 3.0 * np.sin(2 * r.q[:, 0] + 0.8), ["spring", "counterbalance"]
    )
    assert names(loop) == ["counterbalance"]


def test_an_offset_that_a_spring_holds_is_the_spring_s():
    """Whatever was fitted on the joint before: all of the constant is told with it."""
    loop = close(lambda r: 2.0 * (r.q[:, 0] + 1.0), ["spring", "offset", "coulomb"])
    (spring,) = loop.effects_
    assert spring.name == "spring"
    assert spring.parameters["k"] == pytest.approx(2.0, rel=0.05)
    assert spring.parameters["q0"] == pytest.approx(-1.0, rel=0.1)
    low, high = spring.intervals["q0"]
    assert low < -1.0 < high
    assert 0.5 * (low + high) == pytest.approx(spring.parameters["q0"])


def test_what_looked_like_another_effect_while_one_was_missing_is_replaced():
    """Coulomb friction looks quadratic while a spring is missing."""
    loop = close(
        lambda r: 2.0 * r.q[:, 0] + 0.5 * np.cos(9.0 * r.q[:, 0]),
        ["viscous_quadratic", "spring", "ripple"],
    )
    assert sorted(names(loop)) == ["ripple", "spring"]


# -- what holds only for a while


def test_what_is_there_for_a_while_only_has_no_name():
    loop = close(lambda r: 2.0 * ripple(r) * (r.t < 0.6 * SEARCHED), ["ripple"])
    assert names(loop) == []


@pytest.mark.parametrize("begin", one_in(2, [14.0, 9.0]))
def test_late_loads_are_named_with_their_instant(begin):
    loop = close(lambda r: carried(r, begin), ["payload"])
    assert names(loop) == ["payload"]
    assert loop.effects_[0].parameters["instant"] == pytest.approx(begin, abs=0.2)


@pytest.mark.parametrize("begin", one_in(2, [14.0, 9.0]))
def test_late_loads_that_are_put_down_are_none(begin):
    middle = 0.5 * (begin + SEARCHED)
    assert names(close(lambda r: carried(r, begin, middle), ["payload"])) == []


@pytest.mark.slow
def test_a_spring_of_the_first_third_is_none():
    """Beside friction, which is there throughout."""
    first = ARM.t < 0.75 * ARM.t[-1] / 3
    torque = ARM.torque(joint_2=lambda r: 0.4 * r.v[:, 1] * np.abs(r.v[:, 1]))
    torque[first, 0] += 4.0 * ARM.q[first, 0]
    loop = ARM.discover(torque, ["spring", "viscous_quadratic"])
    assert named(loop) == [("viscous_quadratic", 1)]


# -- odds


@pytest.mark.slow
def test_alpha_is_the_probability_that_a_name_needs():
    """The same recording at two levels, between which its probability lies."""

    def torque(r):
        return 0.01 * ripple(r)

    found = close(torque, ["ripple"], alpha=0.4)
    (effect,) = (*found.effects_, *found.possible_)
    assert 0.5 < effect.evidence.probability < 0.9999
    doubt = 1 - effect.evidence.probability
    sure = close(torque, ["ripple"], alpha=min(2 * doubt, 0.45))
    unsure = close(torque, ["ripple"], alpha=doubt / 2)
    assert names(sure) == ["ripple"]
    assert names(unsure) == []
    (possible,) = unsure.possible_
    assert possible.evidence.probability == pytest.approx(effect.evidence.probability)
    # By its odds, or by what it saves elsewhere.
    assert possible.warning
    # The model that is handed over is the same.
    assert (sure.error_after_ == unsure.error_after_).all()


# -- what is left


def test_the_unexplained_share_is_that_of_the_mean_square():
    """A vibration of known size over white noise of known size."""
    size = 0.1
    loop = close(lambda r: size * np.sqrt(2) * np.sin(10.7 * r.t), ["coulomb"])
    (rest,) = loop.unexplained_
    assert rest.rms**2 == pytest.approx(size**2 + rest.floor**2, rel=0.15)
    # the noise of one recording is not quite its expectation, which is the floor
    share = 1 - (rest.floor / rest.rms) ** 2
    assert share == pytest.approx(size**2 / rest.rms**2, abs=0.15)


SLOW = ["drift", "payload", "ripple", "viscous_quadratic", "spring"]


def slow_noise():
    keep, rng = np.exp(-0.02 / 5.0), np.random.default_rng(3)
    steps = np.r_[0.0, np.sqrt(1 - keep**2) * rng.normal(size=ONE.t.size - 1)]
    return lfilter([1.0], [1.0, -keep], steps)


def test_slow_noise_makes_no_slow_effects():
    noise = slow_noise()
    assert names(close(lambda r: noise, SLOW)) == []


def test_slow_noise_does_not_hide_fast_effects():
    noise = slow_noise()
    # Half of the noise.
    size = 0.5 * np.sqrt(2)
    found = close(lambda r: noise + size * ripple(r), SLOW)
    assert names(found) == ["ripple"]
    low, high = found.effects_[0].intervals["A"]
    assert low < size < high
    assert low > 0


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.3, 3.0])
def test_alpha_is_the_share_of_recordings_that_get_a_name_they_should_not(memory):
    """The whole library, residuals of any memory: at most chance above 5 %."""
    count, wrong = 40, 0
    for seed in range(count):
        recording = record("ZY", seed=seed, duration=20.0)
        rng = np.random.default_rng(1000 + seed)
        noise = 0.05 * rng.normal(size=recording.noise.shape)
        if memory:
            keep = np.exp(-0.02 / memory)
            noise = lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], noise, axis=0)
        torque = recording.torque() + noise
        wrong += bool(recording.discover(torque).effects_)
    # Six or more of 40 come up in less than 2 % of the cases at 5 %.
    assert wrong <= 5
