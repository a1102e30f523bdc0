"""Torques state by state are those of the whole recording."""

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


def asked(predictor, X, t=None, signals=None):
    """Torques of all rows at once."""
    used = {n for one in predictor.effects_ for n in getattr(one, "recorded", ())}
    own = {name: x for name, x in (signals or {}).items() if name in used}
    return predictor.torques(predictor.prepare(X, t=t, signals=own))


def stepped(stepper, X, t=None, signals=None):
    """Torques row by row."""
    nv = X.shape[1] // 3
    found = []
    for k, x in enumerate(X):
        own = {name: values[k] for name, values in (signals or {}).items()}
        when = None if t is None else t[k]
        found.append(stepper.step(x[:nv], x[nv : 2 * nv], x[2 * nv :], when, own))
    return np.array(found)


def check(predictor, X, t=None, signals=None):
    """Compare both, without what only the whole recording can have."""
    stepper = Stepper(predictor.torque_model())
    future = [
        k
        for k, effect in enumerate(predictor.effects_)
        if effect.name in ("delay", "torque_filter", "elastic", "jerk")
    ]
    told = [(one.name, one.joint) for one in stepper.left_out_]
    assert told == [
        (predictor.effects_[k].name, predictor.effects_[k].joint) for k in future
    ]
    expected = asked(without(predictor, future), X, t, signals)
    found = stepped(stepper, X, t, signals)
    spread = expected.std(axis=0).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * spread)
    stepper.reset()
    np.testing.assert_array_equal(stepped(stepper, X, t, signals), found)


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


def test_reset_begins_a_recording():
    rng = np.random.default_rng(2)
    predictor = random_predictor(rng, 2, ["maxwell_slip", "backlash"])
    X = random_motion(rng, 2, 120)
    groups = np.repeat([0, 1], [50, 70])
    t = DT * np.arange(len(X))
    expected = predictor.torques(predictor.prepare(X, groups, t))
    stepper = Stepper(predictor.torque_model())
    assert stepper.left_out_ == ()
    first = stepped(stepper, X[:50], t[:50])
    stepper.reset()
    second = stepped(stepper, X[50:], t[50:])
    np.testing.assert_allclose(
        np.vstack([first, second]), expected, atol=1e-12 * expected.std()
    )


class Summed(Stateful):
    """Effect of one's own with a memory: the distance travelled."""

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
    """The same, state by state as well."""

    columns = Summed.columns

    def law(self, maths):
        before, total = 0.0, 0.0

        def torque(state):
            nonlocal before, total
            q = state.q[self.joint]
            total, before = total + abs(q - before), q
            return (total,)

        return torque


def with_effect(rng, own):
    """Return a predictor with an effect of one's own, beside a hysteresis."""
    predictor = random_predictor(rng, 3, ["maxwell_slip"])
    return with_effects(predictor, (own,), *rng.normal(size=(2, 1)))


def test_effects_of_ones_own():
    rng = np.random.default_rng(3)
    predictor = with_effect(rng, Remembering(joint=2))
    check(predictor, random_motion(rng, 3))


def test_a_memory_that_cannot_be_stepped_is_left_out():
    rng = np.random.default_rng(4)
    predictor = with_effect(rng, Summed(joint=1))
    stepper = Stepper(predictor.torque_model())
    (left,) = stepper.left_out_
    assert (left.name, left.joint) == ("summed", 1)
    assert "law" in left.reason
    X = random_motion(rng, 3)
    expected = asked(without(predictor, [1]), X)
    np.testing.assert_allclose(stepped(stepper, X), expected, atol=1e-11)


# -- bad input -------------------------------------------------------------------------


@pytest.fixture
def stepper():
    names = ["drift", "signal"]
    return Stepper(random_predictor(np.random.default_rng(0), 2, names).torque_model())


def test_bad_states_are_named(stepper):
    fine, warm = np.zeros(2), {"warmth": 0.0}
    stepper.step(fine, fine, fine, signals=warm)
    with pytest.raises(ValueError, match=r"shape \(2,\); got \(2,\), \(3,\)"):
        stepper.step(fine, np.zeros(3), fine, signals=warm)
    with pytest.raises(ValueError, match=r"State 1 .* finite: .* a=\[0.0, nan\]"):
        stepper.step(fine, fine, [0.0, np.nan], signals=warm)
    with pytest.raises(ValueError, match=r"q=\[inf, 0.0\]"):
        stepper.step([np.inf, 0.0], fine, fine, signals=warm)
    # Large, and finite.
    stepper.step([1e308, 1e308], fine, fine, signals=warm)


def test_time_goes_on(stepper):
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
