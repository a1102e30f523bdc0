"""Torques computed step by step equal those of the whole recording."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import Stateful
from sklearn_vbjfa.simulation import Stepper
from tests.simulation._random_robots import (
    DT,
    random_motion,
    random_predictor,
    with_effects,
    without,
)

LIBRARY = effects.available()


def batch_torques(predictor, X, t=None, signals=None):
    """Return the torques of all rows at once."""
    used = {n for e in predictor.effects_ for n in getattr(e, "recorded", ())}
    used_signals = {name: x for name, x in (signals or {}).items() if name in used}
    return predictor.torques(predictor.prepare(X, t=t, signals=used_signals))


def step_torques(stepper, X, t=None, signals=None):
    """Return the torques row by row."""
    nv = X.shape[1] // 3
    torques = []
    for k, x in enumerate(X):
        row = {name: values[k] for name, values in (signals or {}).items()}
        time = None if t is None else t[k]
        torques.append(stepper.step(x[:nv], x[nv : 2 * nv], x[2 * nv :], time, row))
    return np.array(torques)


def check(predictor, X, t=None, signals=None):
    """Compare both without effects that need future samples."""
    stepper = Stepper(predictor.torque_model())
    future = [
        k
        for k, effect in enumerate(predictor.effects_)
        if effect.name in ("delay", "torque_filter", "elastic", "jerk")
    ]
    omitted = [(x.name, x.joint) for x in stepper.left_out_]
    assert omitted == [
        (predictor.effects_[k].name, predictor.effects_[k].joint) for k in future
    ]
    expected = batch_torques(without(predictor, future), X, t, signals)
    actual = step_torques(stepper, X, t, signals)
    size = expected.std(axis=0).max()
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-12 * size)
    stepper.reset()
    np.testing.assert_array_equal(step_torques(stepper, X, t, signals), actual)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 99),
    nv=st.integers(1, 5),
    names=st.lists(st.sampled_from(LIBRARY), max_size=8, unique=True),
    timed=st.booleans(),
)
def test_random_robots_with_random_effects(seed, nv, names, timed):
    rng = np.random.default_rng(seed)
    since = float(rng.choice([0.0, 3.0, -1.0]))
    predictor = random_predictor(rng, nv, names, since=since)
    X = random_motion(rng, nv)
    # Before, during and after the fit.
    t = since - 0.5 + DT * np.arange(len(X)) if timed else None
    signals = {"warmth": np.sin(np.arange(len(X)) / 30.0)}
    check(predictor, X, t, signals)


def test_reset_starts_a_recording():
    rng = np.random.default_rng(2)
    predictor = random_predictor(rng, 2, ["maxwell_slip", "backlash"])
    X = random_motion(rng, 2, 120)
    groups = np.repeat([0, 1], [50, 70])
    t = DT * np.arange(len(X))
    expected = predictor.torques(predictor.prepare(X, groups, t))
    stepper = Stepper(predictor.torque_model())
    assert stepper.left_out_ == ()
    first = step_torques(stepper, X[:50], t[:50])
    stepper.reset()
    second = step_torques(stepper, X[50:], t[50:])
    np.testing.assert_allclose(
        np.vstack([first, second]), expected, atol=1e-12 * expected.std()
    )


class Summed(Stateful):
    """Custom effect with a memory: the distance travelled."""

    name = "summed"
    coefficients = ("s",)
    units = (("N m/rad", "N/m"),)

    def columns(self, motion):
        steps = [
            np.cumsum(np.abs(np.diff(motion.q[part, self.joint], prepend=0.0)))
            for part in motion.parts
        ]
        return np.concatenate(steps)[:, None]


class Remembering(Summed):
    """The same effect with a law for single steps."""

    columns = Summed.columns

    def law(self, maths):
        before, total = 0.0, 0.0

        def torque(state):
            nonlocal before, total
            q = state.q[self.joint]
            total, before = total + abs(q - before), q
            return (total,)

        return torque


def with_effect(rng, effect):
    """Return a predictor with a custom effect and a hysteresis."""
    predictor = random_predictor(rng, 3, ["maxwell_slip"])
    return with_effects(predictor, (effect,), *rng.normal(size=(2, 1)))


def test_custom_effect_with_a_step_law():
    rng = np.random.default_rng(3)
    predictor = with_effect(rng, Remembering(joint=2))
    check(predictor, random_motion(rng, 3))


def test_custom_effect_without_a_step_law_is_left_out():
    rng = np.random.default_rng(4)
    predictor = with_effect(rng, Summed(joint=1))
    stepper = Stepper(predictor.torque_model())
    (omitted,) = stepper.left_out_
    assert (omitted.name, omitted.joint) == ("summed", 1)
    assert "law" in omitted.reason
    X = random_motion(rng, 3)
    expected = batch_torques(without(predictor, [1]), X)
    np.testing.assert_allclose(step_torques(stepper, X), expected, atol=1e-11)


@pytest.fixture
def stepper():
    names = ["drift", "signal"]
    return Stepper(random_predictor(np.random.default_rng(0), 2, names).torque_model())


def test_invalid_states_are_named(stepper):
    fine, warm = np.zeros(2), {"warmth": 0.0}
    stepper.step(fine, fine, fine, signals=warm)
    with pytest.raises(ValueError, match=r"shape \(2,\); got \(2,\), \(3,\)"):
        stepper.step(fine, np.zeros(3), fine, signals=warm)
    with pytest.raises(ValueError, match=r"State 1 .* finite: .* a=\[0.0, nan\]"):
        stepper.step(fine, fine, [0.0, np.nan], signals=warm)
    with pytest.raises(ValueError, match=r"q=\[inf, 0.0\]"):
        stepper.step([np.inf, 0.0], fine, fine, signals=warm)
    # Large but finite values are accepted.
    stepper.step([1e308, 1e308], fine, fine, signals=warm)


def test_time_must_increase(stepper):
    fine, warm = np.zeros(2), {"warmth": 0.0}
    stepper.step(fine, fine, fine, 1.0, warm)
    for t in (1.0, 0.5, np.nan):
        with pytest.raises(ValueError, match=r"got (1\.0|0\.5|nan) after 1\.0"):
            stepper.step(fine, fine, fine, t, warm)
    stepper.reset()
    stepper.step(fine, fine, fine, 0.5, warm)
    stepper.reset()
    with pytest.raises(ValueError, match="got nan"):
        stepper.step(fine, fine, fine, np.nan, warm)
