"""Outside range and margin, torques are clamped or follow their law."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import LoadFriction, Spring, ViscousQuadratic
from sklearn_vbjfa.equations import EffectRange
from sklearn_vbjfa.simulation import Stepper, simulate
from tests.effects._faults import Cubic
from tests.model.test_mjcf import rigid
from tests.simulation._machines import slider
from tests.simulation._random_robots import (
    random_motion,
    random_predictor,
    with_effects,
)
from tests.simulation.test_stepper import step_torques

DEPENDENT = [
    name
    for name in effects.available()
    if set(effects.resolve([name])[0].depends) - {"direction"}
    and not effects.resolve([name])[0].files.simulation
]


class ClampedCubic(Cubic):
    """Effect that is clamped outside the range of its positions."""

    depends = ("position",)


def range_of(effect, position=(-0.2, 0.25), speed=(0.05, 0.7), load=(-1.5, 2.0)):
    return EffectRange(
        name=effect.name,
        joint=effect.joint,
        position=position,
        speed=speed,
        load=load,
        depends=effect.depends,
    )


def widen(low, high, share):
    """Return the ends of a range, widened on both sides by a share of its width."""
    margin = share * (high - low) + 1e-9 * max(abs(low), abs(high))
    return low - margin, high + margin


def clamped(predictor, **ends):
    """Return the predictor with clamped effects and no standstill."""
    nv = predictor.features_.n_joints_
    unknown = range_of(Spring(), *3 * [(np.nan, np.nan)])
    effect_ranges = (range_of(effect, **ends) for effect in predictor.effects_)
    declared = nv * len(predictor.features_.friction_) * [unknown]
    plan = replace(predictor.plan, standstill=np.full(nv, -1.0))
    return replace(predictor, plan=plan, effect_ranges_=(*declared, *effect_ranges))


def torques(predictor, X):
    return predictor.torques(predictor.prepare(X))


# Margin as a share of the width, and the torque as a function of the clamped signal,
# its ends, and the sign of the velocity. Speeds have both signs and twice the width.
LAWS = [
    (Spring(1), [3.0, 0.4], 0.2, lambda x, ends, s: 3.0 * np.clip(x, *ends) + 0.4),
    (ClampedCubic(1), [3.0], 0.2, lambda x, ends, s: 3.0 * np.clip(x, *ends) ** 3),
    (
        ViscousQuadratic(1),
        [0.8],
        2 * 0.2,
        lambda x, ends, s: 0.8 * s * np.minimum(abs(x), ends[1]) ** 2,
    ),
    (
        LoadFriction(1),
        [0.1],
        0.2,
        # The larger absolute end of the load counts for both signs.
        lambda x, ends, s: 0.1 * s * np.minimum(abs(x), np.abs(ends).max()),
    ),
]


@pytest.mark.parametrize(("effect", "coef", "share", "law"), LAWS)
def test_predictions_are_clamped_outside_the_range(effect, coef, share, law):
    rng = np.random.default_rng(4)
    bare, of_load = random_predictor(rng, 3, []), "load" in effect.needs
    free = with_effects(bare, (effect,), coef, () if of_load else coef)
    X = random_motion(rng, 3)
    (quantity, *_) = effect.depends
    # Rigid-body torques that load the joint, by Pinocchio.
    bodies = free.bodies(free.load_parameters[: free.features_.n_parameters_])
    model = free.features_.model_.copy()
    model.armature = np.zeros(model.nv)
    load = rigid(model, bodies[:, :10].copy(), X)[:, 1]
    values = {"position": X[:, 1], "speed": X[:, 4], "load": load}[quantity]
    own = abs(values) if quantity == "speed" else values
    ends = np.quantile(own, [0.45, 0.6])
    own = clamped(free, **{quantity: tuple(ends)})
    ends = widen(*ends, share)
    bare = replace(own, theta_=np.r_[own.theta_[: -len(coef)], np.zeros(len(coef))])
    added = torques(own, X) - torques(bare, X)
    expected = law(values, ends, np.sign(X[:, 4]))
    assert_allclose(added[:, 1], expected, rtol=0, atol=1e-11)
    assert_array_equal(added[:, [0, 2]], 0.0)
    low, high = own.effect_ranges_[-1].ends(quantity)
    inside = (values >= low) & (values <= high)
    assert 10 < inside.sum() < len(X) - 10
    unclamped = torques(replace(own, effect_ranges_=()), X)
    assert_array_equal(torques(own, X)[inside], unclamped[inside])
    assert np.abs(torques(own, X) - unclamped)[~inside].max() > 1e-3


@pytest.mark.parametrize("name", DEPENDENT)
@pytest.mark.parametrize("seed", range(3))
def test_single_steps_equal_batch_torques(name, seed):
    rng = np.random.default_rng(seed)
    predictor = clamped(random_predictor(rng, 3, [name, "load_friction"]))
    X = random_motion(rng, 3)
    stepper = Stepper(predictor.torque_model())
    assert_allclose(step_torques(stepper, X), torques(predictor, X), atol=1e-11)


@pytest.mark.parametrize("k", [50.0, 2e4])
@pytest.mark.parametrize(("relative_step", "error"), [(0.01, 1e-6), (1.2, 3e-5)])
def test_clamped_spring_is_a_constant_force(k, relative_step, error):
    # Steps between rows are explicit, or implicit if long; the kink at the end is no
    # event and reduces the order of the step across it.
    mass, v0 = 2.0, 1.5
    rate = np.sqrt(k / mass)
    end, dt = 0.5 * v0 / rate, relative_step / rate
    fitted = end / (1.4 + 1e-9)
    assert widen(-fitted, fitted, 0.2) == pytest.approx((-end, end), rel=1e-15)
    ranges = (range_of(Spring(), position=(-fitted, fitted)),)
    robot = slider(mass, effects=[(Spring(), [k, 0.0])], ranges=ranges, dt=dt)
    t = np.arange(0.0, 2.5 / rate, dt)
    states = simulate(robot, np.zeros((t.size, 1)), [0.0], [v0])
    end_time = np.arcsin(end * rate / v0) / rate
    end_speed = np.sqrt(v0**2 - (rate * end) ** 2)
    later = t - end_time
    q = np.where(
        later < 0,
        v0 / rate * np.sin(rate * t),
        end + end_speed * later - 0.5 * k * end / mass * later**2,
    )
    assert (later < 0).any()
    assert (later > 0).sum() > 1
    assert_allclose(states[:, 0], q, rtol=0, atol=error * q.max())
    assert_allclose(states[later > 0, 2], -k * end / mass, rtol=1e-12)
