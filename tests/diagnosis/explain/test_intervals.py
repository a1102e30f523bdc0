"""Intervals: how often they hold the truth, from both sides."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.diagnosis.explain import (
    NEXT_SECONDS,
    EffectEstimate,
    error_intervals,
    named_values,
)
from sklearn_vbjfa.effects import AsymmetricFriction, Stribeck
from sklearn_vbjfa.equations import TorqueResiduals
from sklearn_vbjfa.robot import FitOptions
from tests.core._problems import coloured
from tests.diagnosis._recordings import named, record
from tests.effects._arms import arm, inverse_dynamics, motion

NV, DT = 2, 0.1


# -- errors


TORQUE = 3.0
SPREAD = np.full(NV, TORQUE)


def residuals(rng, seconds, size=1.0, rho=0.0, share=1.0, torque=TORQUE):
    """Residuals of a stretch; the torque is slow noise itself."""
    m = round(seconds / DT)
    predicted = torque * coloured(rng, (m, NV), 0.8)
    return TorqueResiduals(
        index=np.arange(m),
        torque=predicted + size * coloured(rng, (m, NV), rho),
        predicted=predicted,
        weight=(rng.uniform(size=(m, NV)) < share).astype(float),
    )


def intervals_of(parts, others=None):
    others = parts if others is None else others
    searched, held_out = zip(parts, others)
    return error_intervals(later(held_out), searched, SPREAD, DT)


def later(parts):
    """Count the rows of stretches behind all others."""
    return tuple(replace(part, index=part.index + 10**6) for part in parts)


@pytest.mark.parametrize(
    ("seconds", "rho", "share"), [(50.0, 0.0, 1.0), (20.0, 0.9, 1.0), (30.0, 0.5, 0.4)]
)
def test_ninety_per_cent_of_the_next_errors(seconds, rho, share):
    """In white and in slow residuals, and where a joint mostly stands still."""
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(300):
        settings = {"rho": rho, "share": share}
        searched = residuals(rng, 3 * seconds, **settings)
        held_out = residuals(rng, seconds, **settings)
        found = intervals_of((searched, held_out))["after"]
        error = residuals(rng, NEXT_SECONDS, **settings).relative_error(SPREAD)
        inside.append((found[0] < error) & (error < found[1]))
    # 600 intervals, 1.2 % for one standard deviation
    assert 0.87 < np.mean(inside) < 0.93


def test_ninety_per_cent_of_the_next_differences():
    rng = np.random.default_rng(1)
    inside = []

    def both(seconds):
        before = residuals(rng, seconds, size=1.0, rho=0.5)
        smaller = before.torque - 0.6 * before.residual
        return before, replace(before, predicted=smaller)

    for _ in range(300):
        searched, held_out, then = both(90.0), both(30.0), both(NEXT_SECONDS)
        found = error_intervals(later(held_out), searched, SPREAD, DT)
        low, high = found["difference"]
        gain = then[1].relative_error(SPREAD) - then[0].relative_error(SPREAD)
        inside.append((low < gain) & (gain < high))
    assert 0.87 < np.mean(inside) < 0.93


def test_the_order_of_time_decides_and_not_that_of_the_parts():
    """An held-out stretch in the middle of a residual that grows."""
    rng = np.random.default_rng(2)
    whole = residuals(rng, 200.0)
    growing = replace(
        whole,
        torque=whole.predicted + np.linspace(0.1, 2.0, 2000)[:, None] * whole.residual,
    )

    def rows(chosen):
        return TorqueResiduals(
            index=growing.index[chosen],
            torque=growing.torque[chosen],
            predicted=growing.predicted[chosen],
            weight=growing.weight[chosen],
        )

    middle = np.isin(np.arange(2000) // 500, [1])
    parts = rows(~middle), rows(middle)
    searched, held_out = zip(parts, parts)
    found = error_intervals(held_out, searched, SPREAD, DT)["after"]
    # The same rows told in another order.
    turned = [rows(np.flatnonzero(~middle)[::-1]), rows(middle)]
    again = error_intervals((turned[1],) * 2, (turned[0],) * 2, SPREAD, DT)["after"]
    assert_allclose(found, again, rtol=1e-9)
    # Growth is slow variation, which a shuffled order would not show.
    shuffled = rng.permutation(2000)
    mixed = [replace(part, index=shuffled[part.index]) for part in parts]
    other = error_intervals((mixed[1],) * 2, (mixed[0],) * 2, SPREAD, DT)["after"]
    assert np.all(np.log(found[1] / found[0]) > 1.5 * np.log(other[1] / other[0]))


def test_intervals_lie_around_the_errors():
    rng = np.random.default_rng(0)
    parts = residuals(rng, 60.0), residuals(rng, 20.0)
    found = intervals_of(parts)
    error = parts[1].relative_error(SPREAD)
    low, high = found["after"]
    assert np.all((low < error) & (error < high))
    assert_allclose(low * high, error**2)


# -- effects, through the loop

STEP = 0.02
STATES = {
    "friction": ("viscous",),
    "dt": STEP,
    "cutoff": None,
    "options": FitOptions(standstill=None),
}


def pendulum(seed, rho=0.0, duration=60.0):
    """States of one joint, torques with an undeclared spring, and columns."""
    model = arm("Z")
    _, states = motion(1, duration=duration, dt=STEP, seed=seed)
    q, v, a = states.T
    rng = np.random.default_rng(seed)
    tau = inverse_dynamics(model, states)[:, 0] + 0.8 * v + 0.3 * np.sign(v)
    tau = tau + 0.6 * (q - 0.5) + 0.05 * coloured(rng, v.size, rho)
    columns = np.column_stack([a, v, np.sign(v), np.ones_like(v), q])
    return model, states, tau[:, None], columns


def loop_on(model, states, tau, effects=("spring",)):
    loop = EffectDiscovery(RobotIdentifier(model, **STATES), effects=list(effects))
    return loop.fit(states, tau)


@pytest.mark.slow
def test_half_widths_are_those_of_ninety_per_cent():
    """States without noise, white residuals: least squares knows what to expect."""
    ratios = []
    for seed in range(6):
        model, states, tau, columns = pendulum(seed)
        (effect,) = loop_on(model, states, tau).effects_
        covariance = 0.05**2 * np.linalg.inv(columns.T @ columns)
        # The constant is the spring's, which holds the offset: k (q - q0).
        coef = covariance @ columns.T @ tau[:, 0] / 0.05**2
        k, q0 = coef[4], -coef[3] / coef[4]
        slopes = {"k": [0.0, 1.0], "q0": [-1.0 / k, -q0 / k]}
        for name, own in (("k", k), ("q0", q0)):
            slope = np.array(slopes[name])
            expected = np.sqrt(slope @ covariance[3:, 3:] @ slope)
            assert effect.parameters[name] == pytest.approx(own, abs=0.01 * expected)
            low, high = effect.intervals[name]
            assert 0.5 * (low + high) == pytest.approx(effect.parameters[name])
            ratios.append(0.5 * (high - low) / expected)
    # 1.645, and a few per cent for the freedom of forty blocks; a scatter of 13 %.
    # 80 % would have 1.28 and 95 % have 1.96, with the same few per cent.
    for own in (ratios[::2], ratios[1::2]):
        assert 1.5 < np.mean(own) < 1.9


def test_a_variance_that_is_not_known_is_no_variance_of_nothing():
    """It is that of what depends on it, and of nothing else."""
    covariance = np.array([[4.0, np.nan], [np.nan, np.nan]])
    estimate = EffectEstimate(
        coef=np.array([2.0, 1.0]), shape=(), covariance=covariance, freedom=20.0
    )
    values, found = named_values(AsymmetricFriction(0), estimate)
    # Names of coefficients are their parameters here.
    assert list(values.values()) == [2.0, 1.0]
    first, second = found.values()
    assert first == pytest.approx(2.0)
    assert np.isnan(second)


def test_slow_residuals_widen_the_intervals():
    widths = {}
    for rho in (0.0, 0.9):
        model, states, tau, _ = pendulum(3, rho)
        (effect,) = loop_on(model, states, tau).effects_
        low, high = effect.intervals["k"]
        widths[rho] = high - low
    # a slow signal would have sqrt(19)
    assert 1.5 < widths[0.9] / widths[0.0] < 5.0


def test_centres_are_those_of_the_completed_model():
    """Also where the projection moves them: viscous friction that would drive."""
    recording = record("ZY", duration=40.0, seed=1)
    tau = recording.torque(
        quadratic_1=lambda r: (0.3 * np.abs(r.v[:, 0]) - 0.9) * r.v[:, 0],
        spring_2=lambda r: 0.8 * (r.q[:, 1] - 0.2),
    )
    loop = recording.discover(tau, ["viscous_quadratic", "spring"])
    assert named(loop) == [("spring", 1), ("viscous_quadratic", 0)]
    robot = loop.identifier_
    at, offset, k, c = (
        list(robot.parameter_names_).index(name)
        for name in ("joint_1:viscous_quadratic:F2", "joint_2:offset")
        + ("joint_2:spring:k", "joint_2:spring:c")
    )
    assert abs(robot.theta_[at] - robot.theta_unconstrained_[at]) > 1e-3
    found = {effect.name: effect for effect in loop.effects_}
    assert found["viscous_quadratic"].parameters["F2"] == robot.theta_[at]
    assert found["spring"].parameters["k"] == robot.theta_[k]
    assert robot.theta_[offset] == pytest.approx(0.0, abs=1e-9)
    q0 = -robot.theta_[c] / robot.theta_[k]
    assert found["spring"].parameters["q0"] == pytest.approx(q0)
    for effect in loop.effects_:
        for key, (low, high) in effect.intervals.items():
            assert 0.5 * (low + high) == pytest.approx(effect.parameters[key])


def test_of_two_effects_with_a_constant_one_is_told_with_it():
    """Spring and asymmetric friction on one joint: the data know one constant."""
    recording = record("ZY", seed=0)
    torque = recording.torque(
        joint_2=lambda r: 0.4 + 0.3 * np.abs(r.v[:, 1]) + 2.0 * (r.q[:, 1] - 0.5)
    )
    loop = recording.discover(torque, ["asymmetric_friction", "spring"])
    assert sorted(e.name for e in loop.effects_) == ["asymmetric_friction", "spring"]
    by_name = {e.name: e for e in loop.effects_}
    known = {
        (name, key) for name, effect in by_name.items() for key in effect.intervals
    }
    constants = {("spring", "q0"), ("asymmetric_friction", "dFc")}
    ((name, key),) = known & constants
    low, high = by_name[name].intervals[key]
    truth = {"q0": 0.3, "dFc": -0.6}[key]
    assert low - 0.5 * (high - low) < truth < high + 0.5 * (high - low)
    ((other, lost),) = constants - {(name, key)}
    assert by_name[other].parameters[lost] == pytest.approx(0.0, abs=1e-9)


def test_forms_widen_the_interval_by_how_far_their_values_are():
    known = {"coef": np.array([0.3]), "shape": ("vs",), "freedom": 30.0}
    known["covariance"] = np.diag([0.03, 0.04]) ** 2
    effect = Stribeck(vs=0.2)
    alone = named_values(effect, EffectEstimate(**known))[1]
    forms = ((0.25, {"Fs": 0.22, "vs": 0.26}),)
    both = named_values(effect, EffectEstimate(**known, forms=forms))[1]
    assert_allclose(alone["Fs"], 0.03, rtol=1e-6)
    assert_allclose(both["Fs"], np.sqrt(0.03**2 + 0.25 * 0.08**2), rtol=1e-6)
    assert_allclose(both["vs"], np.sqrt(0.04**2 + 0.25 * 0.06**2), rtol=1e-6)


@pytest.mark.parametrize("seen", [True, False])
def test_a_coefficient_is_known_better_at_a_shape(seen):
    # A deep and narrow dip is as a shallow and wide one: by both, a dip is there.
    covariance = np.linalg.inv([[900.0, 850.0], [850.0, 900.0]])
    if not seen:
        covariance[1] = covariance[:, 1] = np.nan
    known = {"coef": np.array([0.15]), "shape": ("vs",), "freedom": 30.0}
    estimate = EffectEstimate(**known, covariance=covariance, forms=((0.5, {}),))
    own = named_values(Stribeck(vs=0.2), estimate.given_shape())[1]
    wanted = 1 / 30.0 if seen else np.sqrt(covariance[0, 0])
    assert_allclose(own["Fs"], wanted, rtol=1e-6)
