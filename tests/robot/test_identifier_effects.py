"""Effects beside the rigid bodies: what the identifier makes of known torques."""

import functools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import RobotIdentifier, effects
from sklearn_vbjfa.equations import _plan
from sklearn_vbjfa.recording import take_arrays
from tests.effects._arms import (
    arm,
    inverse_dynamics,
    lag_step_by_step,
    motion,
    play_sample_by_sample,
    stops_sample_by_sample,
    with_changed_body,
)
from tests.effects._faults import Cubic
from tests.robot import EXACT as STATES_ALONE

MODEL = arm("ZYX")
DT = 0.01
T, STATES = motion(3, duration=14.0, dt=DT, seed=1)
Q, V, A = np.split(STATES, 3, axis=1)
LOAD = inverse_dynamics(MODEL, STATES)
VISCOUS = np.array([0.8, 0.5, 0.3])
DECLARED = LOAD + VISCOUS * V
EXACT = {**STATES_ALONE, "regressor": LinearRegression(), "dt": DT}
NOISE = 0.05 * np.random.default_rng(0).normal(size=DECLARED.shape)


def on_joint(j, torque):
    out = np.zeros_like(DECLARED)
    out[:, j] = torque
    return out


def fit(added, *used, X=STATES, t=None, model=MODEL, **given):
    robot = RobotIdentifier(model, effects=used, **{**EXACT, **given})
    return robot.fit(X, DECLARED + added, t=t)


def coefficients(robot):
    return robot.theta_[robot.features_.n_parameters_ :]


# -- recovery


def payload(delta, instant):
    # A point at its centre of mass.
    import pinocchio as pin

    mass, centre = delta[0], np.array(delta[1:]) / delta[0]
    lump = pin.Inertia(mass, centre, np.zeros((3, 3))).toDynamicParameters()
    heavier = inverse_dynamics(with_changed_body(MODEL, lump), STATES)
    return (heavier - LOAD) * (T >= instant)[:, None]


@functools.cache
def cases():
    """Effect -> (instance, torque by other code, coefficients, tolerance)."""
    q, a, sign = Q[:, 1], A[:, 1], np.sign(V[:, 1])
    w = V[:, 0] + V[:, 1]
    return {
        "coulomb": (effects.Coulomb(1), on_joint(1, 2 * sign), [2.0]),
        "maxwell_slip": (
            effects.MaxwellSlip(1, displacements=(0.05, 0.2)),
            on_joint(
                1, 2 * stops_sample_by_sample(q, 0.05) + stops_sample_by_sample(q, 0.2)
            ),
            [2.0, 1.0],
        ),
        "backlash": (
            effects.Backlash(1, width=0.1),
            on_joint(1, 30 * play_sample_by_sample(q, 0.1) + 1),
            [30.0, 1.0],
        ),
        "spring": (effects.Spring(1), on_joint(1, 8 * (q - 0.25)), [8.0, -2.0]),
        "coupling": (
            effects.Coupling(1, other=0, ratio=1.0),
            on_joint(1, 0.9 * w + 1.1 * np.sign(w) + 0.2 * (A[:, 0] + a)),
            None,
        ),
        "payload": (
            effects.Payload(2, instant=6.0, centre=(0.05, 0.05 / 0.6, 0.1 / 0.6)),
            payload([0.6, 0.03, 0.05, 0.1], 6.0),
            None,
        ),
        "own": (Cubic(1), on_joint(1, 3 * q**3), [3.0]),
    }


@pytest.mark.parametrize("case", cases())
def test_known_torques_are_reproduced_and_coefficients_recovered(case):
    effect, added, truth = cases()[case]
    robot = fit(added, effect)
    assert_allclose(robot.predict(STATES), DECLARED + added, atol=2e-3)
    if truth is not None:
        assert_allclose(coefficients(robot), truth, rtol=2e-3, atol=2e-3)
    missing = fit(added).predict(STATES) - DECLARED - added
    assert np.sqrt(np.mean(missing**2)) > 0.01


def test_elements_that_are_not_there_have_no_size():
    # Rounding would count as an element that nothing is known of.
    bank = effects.MaxwellSlip(1, displacements=tuple(np.geomspace(1e-3, 0.5, 10)))
    friction = 2 * stops_sample_by_sample(Q[:, 1], 0.05)
    found = coefficients(fit(on_joint(1, friction), bank, projector="default"))
    assert (found == 0).any()
    assert found[found > 0].min() > 1e-6


@pytest.mark.parametrize("kind", ["lag", "smooth"])
def test_filters_act_on_all_of_the_torque(kind):
    """On the friction that is an effect as well; sample by sample in another code."""
    T_lag = 0.03
    whole = DECLARED[:, 1] + 4 * np.sign(V[:, 1])
    if kind == "lag":
        passed = lag_step_by_step(whole, DT, T_lag)
    else:
        weights = np.exp(-0.5 * ((T[:, None] - T) / T_lag) ** 2)
        passed = weights @ whole / weights.sum(axis=1)
    added = on_joint(1, passed - DECLARED[:, 1])
    used = effects.Coulomb(1), effects.TorqueFilter(1, kind, time_constant=T_lag)
    robot = fit(added, *used)
    Fc, found = coefficients(robot)
    assert Fc == pytest.approx(4, rel=0.01)
    assert used[1].parameters([found])["time_constant"] == pytest.approx(T_lag, 0.02)
    # At the ends a mean over what is there is not that of a torque that stays.
    middle = slice(20, -20)
    error = (robot.predict(STATES) - DECLARED - added)[middle, 1]
    assert np.std(error) < 0.02 * np.std((passed - whole)[middle])
    # The states of another motion need no torque of their own.
    assert np.isfinite(robot.predict(STATES[300:600], t=T[300:600])).all()


# Share of the load that the second joint loses, and its torque.
MU = 0.15
OF_LOAD = on_joint(1, MU * np.abs(LOAD[:, 1]) * np.sign(V[:, 1]))


def test_load_friction_is_a_fixed_point(monkeypatch):
    robot = fit(OF_LOAD, effects.LoadFriction(1))
    assert coefficients(robot)[0] == pytest.approx(MU, rel=0.01)
    assert_allclose(robot.predict(STATES), DECLARED + OF_LOAD, atol=0.05)
    monkeypatch.setattr(_plan, "_LOAD_PASSES", 9)
    settled = fit(OF_LOAD, effects.LoadFriction(1))
    assert coefficients(settled)[0] == pytest.approx(MU, rel=1e-3)
    assert coefficients(robot)[0] == pytest.approx(coefficients(settled)[0], rel=0.01)


def test_the_load_follows_a_gain_that_is_found():
    gain, noise = 1.1, 0.1 * NOISE
    tau = (DECLARED + OF_LOAD) * [1.0, gain, 1.0] + noise
    used = effects.LoadFriction(1), effects.TorqueGain(1)
    robot = RobotIdentifier(MODEL, effects=used, **EXACT).fit(STATES, tau)
    found = coefficients(robot)
    assert found[1] == pytest.approx(gain, rel=0.01)
    assert found[0] == pytest.approx(MU, rel=0.02)
    left = robot.predict(STATES) - tau
    assert (np.std(left, axis=0) < 1.05 * np.std(noise, axis=0)).all()


def test_a_fit_after_another_has_its_load():
    late = RobotIdentifier(MODEL, effects=(effects.LoadFriction(1),), **EXACT)

    def after(fitted):
        names, load = alone.joint_names_, fitted.robot_
        recording = take_arrays(STATES, DECLARED + OF_LOAD, dt=DT, joint_names=names)
        return clone(late).fit_without_inspection(recording, previous=load)

    alone = clone(late).fit(STATES, DECLARED + OF_LOAD)
    # The fit without it is the first pass, that with another plain effect nearly.
    assert_array_equal(after(fit(OF_LOAD)).theta_, alone.theta_)
    near = after(fit(OF_LOAD, effects.Coulomb(1))).theta_
    assert_allclose(near, alone.theta_, rtol=0.01, atol=0.01)
    # Of a fit that has it already the load is better.
    again = after(alone)
    errors = [abs(coefficients(one)[0] / MU - 1) for one in (again, alone)]
    assert errors[0] < 0.3 * errors[1]
    # Once only.
    again.fit(STATES, DECLARED + OF_LOAD)
    assert_array_equal(again.theta_, alone.theta_)


SEVERAL = (
    effects.Coulomb(1),
    effects.LoadFriction(0),
    effects.MaxwellSlip(2, displacements=(0.03,)),
    effects.Payload(2, instant=6.0),
    effects.Drift(1, of="offset", time_constant=6.0),
)
MIXED = (
    on_joint(1, 2 * np.sign(V[:, 1]) + 3 * np.exp(-T / 6))
    + on_joint(0, 0.1 * np.abs(LOAD[:, 0]) * np.sign(V[:, 0]))
    + NOISE
)


# -- projection


def test_projection_moves_the_effects_along():
    """Of all coefficients beside the projected bodies the best are taken."""
    robot = fit(8 * NOISE + MIXED, *SEVERAL[:3], projector="default")
    p = robot.features_.n_parameters_
    assert np.all(robot.min_eigenvalues_ > 0)
    assert np.abs(robot.theta_ - robot.theta_unconstrained_)[:p].max() > 1e-6
    metric = robot.estimate_.metric
    change = robot.theta_ - robot.theta_unconstrained_
    scale = np.sqrt(np.diagonal(metric)) * np.sqrt(change @ metric @ change)
    assert np.abs((metric @ change)[p:] / scale[p:]).max() < 1e-6
    assert np.all(robot.robot_.bodies(robot.theta_)[:, 10] >= 0)


# -- settings


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([effects.Coulomb(3)], "names joint 3 for coulomb; expected 0 to 2"),
        ([effects.Coulomb(-1)], "names joint -1 for coulomb"),
        ([effects.Coulomb(1), effects.Coulomb(1)], "holds coulomb on joint 1 twice"),
        ("maxwell_slip", "instances of Effect, each with its joint.*'maxwell_slip'"),
        ([effects.Viscous(1)], "viscous on joint 1, which friction declares"),
    ],
)
def test_bad_effects_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        RobotIdentifier(MODEL, effects=given, **EXACT).fit(STATES, DECLARED)


def test_an_effect_with_a_constant_takes_the_offset_of_its_joint():
    """The data know the sum; it is the spring's."""
    offset = np.array([0.7, -0.4, 0.2])
    added = offset + on_joint(1, 3.0 * (Q[:, 1] - 0.3))
    robot = fit(added, effects.Spring(1), friction=("viscous", "offset"))
    values = dict(zip(robot.parameter_names_, robot.theta_))
    assert values["joint_2:spring:c"] == pytest.approx(-0.4 - 0.9, rel=1e-6)
    assert values["joint_2:offset"] == 0.0
    for j in (1, 3):
        assert values[f"joint_{j}:offset"] == pytest.approx(offset[j - 1], abs=1e-6)
    # A spring over two joints takes that of the other one, and no spring's constant.
    way = np.array([0.0, 1.0, -0.5])
    added = added + 2.0 * (Q @ way - 0.6)[:, None] * way
    both = effects.CouplingSpring(1, 2, ratio=0.5), effects.Spring(1)
    robot = fit(added, *both, friction=("viscous", "offset"))
    assert robot.theta_[-4:] == pytest.approx([2.0, -1.6, 3.0, -0.9], abs=1e-6)
    assert both[0].parameters([3.0, -0.6]) == {"k": 3.0, "q0": pytest.approx(0.2)}


def test_friction_with_memory_takes_the_place_of_coulomb_and_holds_at_rest():
    """A joint that stops keeps the torque with which it stopped."""
    stop = T > 0.7 * T[-1]
    states = STATES.copy()
    states[stop, :3] = states[np.argmax(stop) - 1, :3]
    states[stop, 3:] = 0.0
    q = states[:, 1]
    bank = effects.MaxwellSlip(1, displacements=(0.02, 0.2))
    held = 2 * stops_sample_by_sample(q, 0.02) + stops_sample_by_sample(q, 0.2)
    robot = RobotIdentifier(MODEL, friction=("viscous", "coulomb"), effects=[bank])
    tau = inverse_dynamics(MODEL, states) + on_joint(1, held)
    robot.fit(states, tau)
    assert robot.predict(states)[stop] == pytest.approx(tau[stop], abs=1e-6)
    found = dict(zip(robot.parameter_names_, robot.theta_))
    assert found["joint_2:coulomb"] == pytest.approx(0.0, abs=1e-6)
    assert robot.theta_[-2:] == pytest.approx([2.0, 1.0], abs=1e-6)
    # Sizes are not negative, whatever the torques are.
    robot.fit(states, tau - 2 * on_joint(1, held))
    assert (robot.theta_[-2:] >= 0).all()
