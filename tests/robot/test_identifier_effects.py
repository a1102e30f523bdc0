"""Effects beside the rigid bodies: what the identifier makes of known torques."""

import functools
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

pytest.importorskip("pinocchio")

from sklearn_vbjfa import RobotIdentifier, effects
from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.effects import Effect
from sklearn_vbjfa.robot import _equations, _plan
from tests.effects._arms import (
    arm,
    dahl_in_small_steps,
    inverse_dynamics,
    motion,
    play_sample_by_sample,
    with_changed_body,
)

MODEL = arm("ZYX")
DT = 0.01
T, STATES = motion(3, duration=14.0, dt=DT, seed=1)
Q, V, A = np.split(STATES, 3, axis=1)
LOAD = inverse_dynamics(MODEL, STATES)
VISCOUS = np.array([0.8, 0.5, 0.3])
DECLARED = LOAD + VISCOUS * V
EXACT = {
    "friction": ("viscous",),
    "regressor": LinearRegression(),
    "projector": None,
    "cutoff": None,
    "standstill": None,
    "dt": DT,
}
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


class Cubic(Effect):
    """Cubic spring."""

    name = "cubic"
    coefficients = ("k3",)
    units = (("N m/rad^3", "N/m^3"),)

    def columns(self, motion):
        return motion.q[:, [self.joint]] ** 3


# -- recovery


def soft_torque(j, stiffness):
    """Torques with the link behind the motor by tau / k, to first order in 1 / k."""
    lag = [LOAD[:, j]]
    for _ in range(2):
        lag.append(np.gradient(lag[-1], DT))
    states = STATES.copy()
    states[:, [j, 3 + j, 6 + j]] -= np.column_stack(lag) / stiffness
    return inverse_dynamics(MODEL, states) - LOAD


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
    q, v, a, sign = Q[:, 1], V[:, 1], A[:, 1], np.sign(V[:, 1])
    c = np.array([2.0, -1.0, 0.5, 0.7, 1.5])
    harmonics = [np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q), 1 + 0 * q]
    w = V[:, 0] + V[:, 1]
    return {
        "coulomb": (effects.Coulomb(1), on_joint(1, 2 * sign), [2.0]),
        "smooth coulomb": (
            effects.Coulomb(1, smoothing=0.1),
            on_joint(1, 2 * np.tanh(v / 0.1)),
            [2.0],
        ),
        "asymmetric": (
            effects.AsymmetricFriction(1),
            on_joint(1, np.where(v > 0, 1.0, 1.0) + 0.4 * np.abs(v)),
            [1.0, 0.4],
        ),
        "stribeck": (
            effects.Stribeck(1, vs=0.2),
            on_joint(1, 1.5 * sign * np.exp(-np.abs(v) / 0.2)),
            [1.5],
        ),
        "quadratic": (
            effects.ViscousQuadratic(1),
            on_joint(1, -0.3 * v * abs(v)),
            [-0.3],
        ),
        "presliding": (
            effects.Presliding(1, displacement=0.05),
            on_joint(1, 2 * dahl_in_small_steps(q, 0.05, 20)),
            [2.0],
        ),
        "backlash": (
            effects.Backlash(1, width=0.1),
            on_joint(1, 30 * play_sample_by_sample(q, 0.1) + 1),
            [30.0, 1.0],
        ),
        "offset": (effects.Offset(1), on_joint(1, 1.2), [1.2]),
        "spring": (effects.Spring(1), on_joint(1, 8 * (q - 0.25)), [8.0, -2.0]),
        "counterbalance": (
            effects.Counterbalance(1),
            on_joint(1, c @ np.array(harmonics)),
            None,
        ),
        "ripple": (
            effects.Ripple(1, period=0.3),
            on_joint(1, 0.8 * np.cos(2 * np.pi * q / 0.3 - 1.1)),
            [0.8 * np.cos(1.1), 0.8 * np.sin(1.1)],
        ),
        "rotor": (effects.RotorInertia(2), on_joint(2, 0.1 * A[:, 2]), None),
        "coupling": (
            effects.Coupling(1, other=0, of="sum"),
            on_joint(1, 0.9 * w + 1.1 * np.sign(w) + 0.2 * (A[:, 0] + a)),
            None,
        ),
        "drift": (
            effects.Drift(1, of="coulomb", time_constant=5.0),
            on_joint(1, 2 * sign * np.exp(-T / 5)),
            [2.0],
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
    left = np.sqrt(np.mean(missing**2))
    # A rotor's inertia about this joint may hide in the links', nothing else does.
    assert left > 0.01 or case == "rotor"


def test_payload_is_recovered_with_its_first_moments():
    delta = [0.6, 0.03, 0.05, 0.1]
    effect = effects.Payload(2, instant=6.0).linearised_at(np.r_[delta, 0.0])
    robot = fit(payload(delta, 6.0), effect)
    at = robot.features_.n_parameters_
    seen = robot.identifiable_[at:]
    assert seen.any()
    truth = np.r_[delta, 0.0]
    assert_allclose(coefficients(robot)[seen], truth[seen], rtol=1e-6, atol=1e-8)
    early = robot.predict(STATES[:300])
    assert_allclose(early, DECLARED[:300], atol=1e-6)


def test_elastic_joint_gives_its_stiffness():
    k = 5000.0
    robot = fit(soft_torque(1, k), effects.Elastic(1))
    inside = slice(20, -20)
    assert 1 / coefficients(robot)[0] == pytest.approx(k, rel=0.02)
    error = robot.predict(STATES) - DECLARED - soft_torque(1, k)
    assert np.abs(error[inside]).max() < 0.05 * np.abs(soft_torque(1, k)).max()


@pytest.mark.parametrize("late", [0.02, -0.02])
def test_delay_of_the_load(late):
    shift = round(late / DT)
    lagged = LOAD.copy()
    lagged[:, 1] = np.interp(T - late, T, LOAD[:, 1])
    robot = fit(lagged - LOAD, effects.Delay(1, delay=late))
    assert coefficients(robot)[0] == pytest.approx(late, rel=0.05)
    middle = slice(abs(shift), T.size - abs(shift))
    error = (robot.predict(STATES) - lagged - VISCOUS * V)[middle, 1]
    assert np.std(error) < 0.1 * np.std((lagged - LOAD)[middle, 1])


@pytest.mark.parametrize("kind", ["lag", "smooth"])
def test_filters_act_on_all_of_the_torque(kind):
    """On the friction that is an effect as well; sample by sample in another code."""
    T_lag = 0.03
    whole = DECLARED[:, 1] + 4 * np.sign(V[:, 1])
    if kind == "lag":
        fine = DT / 200
        times = np.arange(0, T.size * 200 - 199) * fine
        x = np.interp(times, T, whole)
        y = np.empty_like(x)
        y[0] = x[0]
        for i in range(1, x.size):
            y[i] = y[i - 1] + fine / T_lag * (0.5 * (x[i - 1] + x[i]) - y[i - 1])
        passed = y[::200]
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


def test_jerk_of_late_positions():
    rate = np.gradient(A[:, 1], DT)
    robot = fit(on_joint(1, 0.02 * rate), effects.Jerk(1))
    assert coefficients(robot)[0] == pytest.approx(0.02, rel=1e-3)
    assert_allclose(
        robot.predict(STATES)[:, 1], DECLARED[:, 1] + 0.02 * rate, atol=1e-3
    )


def test_load_friction_is_a_fixed_point(monkeypatch):
    mu = 0.15
    added = on_joint(1, mu * np.abs(LOAD[:, 1]) * np.sign(V[:, 1]))
    robot = fit(added, effects.LoadFriction(1))
    assert coefficients(robot)[0] == pytest.approx(mu, rel=0.01)
    assert_allclose(robot.predict(STATES), DECLARED + added, atol=0.05)
    monkeypatch.setattr(_plan, "_LOAD_PASSES", 9)
    settled = fit(added, effects.LoadFriction(1))
    assert coefficients(settled)[0] == pytest.approx(mu, rel=1e-3)
    assert coefficients(robot)[0] == pytest.approx(coefficients(settled)[0], rel=0.01)


def test_a_fit_after_another_has_its_load():
    mu = 0.15
    added = on_joint(1, mu * np.abs(LOAD[:, 1]) * np.sign(V[:, 1]))
    late = RobotIdentifier(MODEL, effects=(effects.LoadFriction(1),), **EXACT)

    def after(fitted):
        return clone(late).begin_with(fitted).fit(STATES, DECLARED + added)

    alone = clone(late).fit(STATES, DECLARED + added)
    # The fit without it is the first pass; with another plain effect it is not.
    assert_array_equal(after(fit(added)).theta_, alone.theta_)
    assert_array_equal(after(fit(added, effects.Coulomb(1))).theta_, alone.theta_)
    # Of a fit that has it already the load is better.
    again = after(alone)
    errors = [abs(coefficients(one)[0] / mu - 1) for one in (again, alone)]
    assert errors[0] < 0.3 * errors[1]
    # Once only.
    again.fit(STATES, DECLARED + added)
    assert_array_equal(again.theta_, alone.theta_)


def test_load_friction_takes_plain_effects_along():
    sign = np.sign(V[:, 1])
    added = on_joint(1, (0.15 * np.abs(LOAD[:, 1]) + 1.5) * sign)
    robot = fit(added, effects.LoadFriction(1), effects.Coulomb(1))
    assert_allclose(coefficients(robot), [0.15, 1.5], rtol=0.01)


def test_noise_and_filters_leave_the_coefficients_where_they_are():
    """Positions in, default settings: projected, filtered, masked."""
    rng = np.random.default_rng(4)
    sign = np.sign(V[:, 1])
    added = on_joint(1, 2 * sign) + on_joint(0, 4 * Q[:, 0]) + NOISE
    robot = RobotIdentifier(
        MODEL,
        dt=DT,
        effects=(effects.Coulomb(1), effects.Spring(0)),
        friction=("viscous",),
    )
    robot.fit(Q + 1e-5 * rng.normal(size=Q.shape), DECLARED + added)
    coulomb, k, c = coefficients(robot)
    assert coulomb == pytest.approx(2.0, rel=0.03)
    assert k == pytest.approx(4.0, rel=0.03)
    assert abs(c) < 0.1
    assert np.all(robot.min_eigenvalues_ > 0)
    deviation = robot.theta_std_[-3:]
    assert np.all(deviation > 0)
    assert np.all(deviation < 0.2)


def test_slider_and_joint_have_units_of_their_own():
    model = arm("zY")
    _, states = motion(2, duration=8.0, seed=2, size=0.3)
    torque = inverse_dynamics(model, states)
    torque[:, 0] += 5 * np.sign(states[:, 2])
    torque[:, 1] += 2 * np.sign(states[:, 3])
    robot = RobotIdentifier(
        model, effects=(effects.Coulomb(0), effects.Coulomb(1)), **EXACT
    ).fit(states, torque)
    assert robot.parameter_names_[-2:] == ("joint_1:coulomb:Fc", "joint_2:coulomb:Fc")
    assert robot.parameter_units_[-2:] == ("N", "N m")
    assert_allclose(robot.theta_[-2:], [5, 2], rtol=1e-6)


# -- one number, whichever way it is asked


SEVERAL = (
    effects.Coulomb(1),
    effects.LoadFriction(0),
    effects.Presliding(2, displacement=0.03),
    effects.Payload(2, instant=6.0),
    effects.Drift(1, of="offset", time_constant=6.0),
)
MIXED = (
    on_joint(1, 2 * np.sign(V[:, 1]) + 3 * np.exp(-T / 6))
    + on_joint(0, 0.1 * np.abs(LOAD[:, 0]) * np.sign(V[:, 0]))
    + NOISE
)


@pytest.fixture(scope="module")
def several():
    return fit(MIXED, *SEVERAL)


def test_names_units_and_parameters_are_as_many(several):
    count = sum(len(e.coefficients) for e in SEVERAL)
    p = several.features_.n_parameters_ + count
    assert several.theta_.shape == (p,)
    assert several.theta_unconstrained_.shape == (p,)
    assert several.theta_std_.shape == (p,)
    assert several.identifiable_.shape == (p,)
    assert len(several.parameter_names_) == len(several.parameter_units_) == p
    assert len(set(several.parameter_names_)) == p
    assert several.parameter_names_[-count:] == (
        "joint_2:coulomb:Fc",
        "joint_1:load_friction:mu",
        "joint_3:presliding:Fp",
        "joint_3:payload:dm",
        "joint_3:payload:dmcx",
        "joint_3:payload:dmcy",
        "joint_3:payload:dmcz",
        "joint_3:payload:d",
        "joint_2:drift:D",
    )


def test_residuals_are_of_the_prediction(several):
    found = several.residuals(STATES, DECLARED + MIXED)
    assert_array_equal(found.index, np.arange(T.size))
    assert_allclose(found.predicted, several.predict(STATES), atol=1e-9)
    assert_allclose(found.residual, DECLARED + MIXED - found.predicted, atol=1e-9)


def test_filtered_residuals_are_of_the_filtered_prediction():
    robot = fit(MIXED, *SEVERAL, cutoff=4.0)
    found = robot.residuals(STATES, DECLARED + MIXED)
    lowpass = _lowpass.design(DT, 4.0)
    assert found.index.size < T.size / 2
    assert_allclose(found.predicted, lowpass(robot.predict(STATES)), atol=1e-8)


@pytest.mark.parametrize("cutoff", [None, 4.0])
def test_pieces_do_not_matter(monkeypatch, cutoff):
    whole = fit(MIXED, *SEVERAL, cutoff=cutoff)
    predicted = whole.predict(STATES)
    residual = whole.residuals(STATES, DECLARED + MIXED).residual
    monkeypatch.setattr(_equations, "CHUNK_BYTES", 1 << 16)
    monkeypatch.setattr(_equations, "_LOAD_BYTES", 1 << 16)
    pieces = fit(MIXED, *SEVERAL, cutoff=cutoff)
    assert_allclose(pieces.predict(STATES), predicted, atol=1e-7)
    again = pieces.residuals(STATES, DECLARED + MIXED).residual
    assert_allclose(again, residual, atol=1e-7)


def test_order_does_not_matter(several):
    other = fit(MIXED, *SEVERAL[::-1])
    assert sorted(other.parameter_names_) == sorted(several.parameter_names_)
    place = [other.parameter_names_.index(n) for n in several.parameter_names_]
    assert_allclose(other.predict(STATES), several.predict(STATES), atol=1e-6)
    free = several.identifiable_
    assert_allclose(
        other.theta_[place][free], several.theta_[free], rtol=1e-4, atol=1e-6
    )


def test_recordings_are_separate():
    """Hysteresis starts anew with each recording, in fit and in query."""
    half = T.size // 2
    groups = np.r_[np.zeros(half), np.ones(T.size - half)]
    q = Q[:, 1]
    z = [dahl_in_small_steps(x, 0.2, 20) for x in (q[:half], q[half:])]
    added = on_joint(1, 4 * np.concatenate(z))
    robot = RobotIdentifier(MODEL, effects=(effects.Presliding(1, 0.2),), **EXACT)
    robot.fit(STATES, DECLARED + added, groups=groups)
    assert coefficients(robot)[0] == pytest.approx(4.0, rel=1e-3)
    together = robot.predict(STATES, groups=groups)
    assert_allclose(together, DECLARED + added, atol=5e-3)
    assert_allclose(together[half:], robot.predict(STATES[half:]), atol=1e-9)
    assert np.abs(robot.predict(STATES) - together)[half : half + 20].max() > 0.1


def test_query_in_two_parts_is_the_whole_where_nothing_is_remembered():
    robot = fit(MIXED, effects.Coulomb(1), effects.Spring(0))
    both = np.concatenate([robot.predict(STATES[:500]), robot.predict(STATES[500:])])
    assert_allclose(both, robot.predict(STATES), atol=1e-9)


# -- the clock


def test_fit_and_query_share_one_clock():
    drift = effects.Drift(1, of="offset", time_constant=5.0)
    added = on_joint(1, 2 * np.exp(-T / 5))
    robot = fit(added, drift, t=T)
    assert coefficients(robot)[0] == pytest.approx(2.0, rel=1e-6)
    counted = fit(added, drift)
    assert_allclose(counted.theta_, robot.theta_, rtol=1e-9, atol=1e-9)
    later = slice(700, None)
    assert_allclose(
        robot.predict(STATES[later], t=T[later]), (DECLARED + added)[later], atol=1e-6
    )
    restarted = robot.predict(STATES[later]) - robot.predict(STATES[later], t=T[later])
    assert_allclose(
        restarted,
        on_joint(1, 2 * np.exp(-T / 5))[: T.size - 700]
        - on_joint(1, 2 * np.exp(-T / 5))[later],
        atol=1e-6,
    )
    found = robot.residuals(STATES[later], (DECLARED + added)[later], t=T[later])
    assert np.abs(found.residual).max() < 1e-6


def test_clock_may_start_anywhere():
    drift = effects.Drift(1, of="offset", time_constant=5.0)
    added = on_joint(1, 2 * np.exp(-T / 5))
    robot = fit(added, drift, t=T + 10)
    assert coefficients(robot)[0] == pytest.approx(2 * np.exp(10 / 5), rel=1e-6)
    assert_allclose(robot.predict(STATES, t=T + 10), DECLARED + added, atol=1e-6)


# -- projection


def test_projection_moves_the_effects_along():
    """Of all coefficients beside the projected bodies the best are taken."""
    robot = fit(8 * NOISE + MIXED, *SEVERAL[:3], projector="default")
    p = robot.features_.n_parameters_
    assert np.all(robot.min_eigenvalues_ > 0)
    assert np.abs(robot.theta_ - robot.theta_unconstrained_)[:p].max() > 1e-6
    metric = robot.estimator_.metric_
    change = robot.theta_ - robot.theta_unconstrained_
    scale = np.sqrt(np.diagonal(metric)) * np.sqrt(change @ metric @ change)
    assert np.abs((metric @ change)[p:] / scale[p:]).max() < 1e-6
    assert np.all(robot.robot_.bodies(robot.theta_)[:, 10] >= 0)


def test_projection_of_a_consistent_robot_changes_no_torque():
    added = on_joint(1, 2 * np.sign(V[:, 1]))
    robot = fit(added, effects.Coulomb(1), projector="default")
    assert np.all(robot.min_eigenvalues_ > 0)
    assert_allclose(robot.predict(STATES), DECLARED + added, atol=0.02)
    assert coefficients(robot)[0] == pytest.approx(2.0, rel=0.01)


# -- without effects


def test_no_effects_are_as_before(several):
    plain = RobotIdentifier(MODEL, **EXACT).fit(STATES, DECLARED + MIXED)
    for empty in ((), []):
        robot = RobotIdentifier(MODEL, effects=empty, **EXACT)
        robot.fit(STATES, DECLARED + MIXED)
        assert robot.effects_ == ()
        assert_array_equal(robot.theta_, plain.theta_)
        assert robot.parameter_names_ == plain.parameter_names_
        assert robot.theta_.size == robot.features_.n_parameters_
    p = plain.theta_.size
    assert several.parameter_names_[:p] == plain.parameter_names_


def test_friction_and_effects_of_the_same_kind_are_one_model():
    torque = DECLARED + MIXED
    declared = RobotIdentifier(MODEL, **{**EXACT, "friction": ("viscous", "coulomb")})
    declared.fit(STATES, torque)
    beside = tuple(e(j) for e in (effects.Viscous, effects.Coulomb) for j in range(3))
    robot = RobotIdentifier(MODEL, effects=beside, **{**EXACT, "friction": ()})
    robot.fit(STATES, torque)
    assert robot.theta_.size == declared.theta_.size
    assert_allclose(robot.predict(STATES), declared.predict(STATES), atol=1e-7)


# -- settings


def test_scikit_learn_contract(several):
    robot = RobotIdentifier(MODEL, effects=SEVERAL, **EXACT)
    twin = clone(robot)
    assert [e.get_params() for e in twin.effects] == [e.get_params() for e in SEVERAL]
    assert all(a is not b for a, b in zip(several.effects_, SEVERAL))
    again = pickle.loads(pickle.dumps(several))
    assert_array_equal(again.predict(STATES[:50]), several.predict(STATES[:50]))


@pytest.mark.parametrize(
    "given", ["coulomb", effects.Coulomb, effects.Coulomb(), ["coulomb"]]
)
def test_one_effect_may_be_given_by_itself(given):
    if given is effects.Coulomb:
        given = (given,)
    robot = RobotIdentifier(MODEL, effects=given, **EXACT)
    robot.fit(STATES, DECLARED + on_joint(0, 2 * np.sign(V[:, 0])))
    assert [e.name for e in robot.effects_] == ["coulomb"]
    assert robot.theta_[-1] == pytest.approx(2.0, rel=1e-6)


def test_one_kind_may_act_twice_with_other_shapes():
    added = on_joint(
        1, np.cos(2 * np.pi * Q[:, 1] / 0.3) + np.cos(2 * np.pi * Q[:, 1] / 0.5)
    )
    robot = fit(added, effects.Ripple(1, 0.3), effects.Ripple(1, 0.5))
    assert_allclose(coefficients(robot), [1, 0, 1, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["stiction"], "Unknown effect 'stiction'"),
        ([effects.Coulomb(3)], "names joint 3 for coulomb; expected 0 to 2"),
        ([effects.Coulomb(-1)], "names joint -1 for coulomb"),
        ([effects.Coulomb(1), effects.Coulomb(1)], "holds coulomb on joint 1 twice"),
        ([3], "names of the library, classes or instances of Effect; got 3"),
    ],
)
def test_bad_effects_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        RobotIdentifier(MODEL, effects=given, **EXACT).fit(STATES, DECLARED)


def test_a_clock_that_runs_backwards_is_refused():
    with pytest.raises(ValueError, match="t must rise"):
        fit(0 * DECLARED, effects.Drift(1), t=T[::-1])


@pytest.mark.parametrize(
    ("effect", "given"),
    [
        (effects.Drift(1), {"dt": None}),
        (effects.Delay(1), {"dt": None}),
        (effects.Coupling(1, other=5), {}),
        (effects.Payload(0, instant=3.0), {}),
    ],
    ids=["drift without clock", "delay without clock", "no such joint", "first body"],
)
def test_effects_that_cannot_be_are_refused(effect, given):
    with pytest.raises(ValueError, match=effect.name):
        fit(0 * DECLARED, effect, **given)


# -- plain terms that effects hold


def test_an_effect_with_a_constant_takes_the_offset_of_its_joint():
    """The data know the sum; it is the spring's, with its own standard error."""
    offset = np.array([0.7, -0.4, 0.2])
    torque = DECLARED + offset
    torque[:, 1] += 3.0 * (Q[:, 1] - 0.3)
    friction = ("viscous", "offset")
    asked = {**EXACT, "friction": friction}
    robot = RobotIdentifier(MODEL, effects=[effects.Spring(1)], **asked)
    robot.fit(STATES, torque)
    names = robot.parameter_names_
    values = dict(zip(names, robot.theta_))
    assert values["joint_2:spring:c"] == pytest.approx(-0.4 - 0.9, rel=1e-6)
    assert values["joint_2:offset"] == 0.0
    known = dict(zip(names, robot.identifiable_))
    assert known["joint_2:spring:c"]
    assert not known["joint_2:offset"]
    # Elsewhere an offset is an offset.
    for j in (1, 3):
        assert values[f"joint_{j}:offset"] == pytest.approx(offset[j - 1], abs=1e-6)
    plain = RobotIdentifier(
        MODEL,
        effects=[effects.Offset(0), effects.Spring(1), effects.Offset(2)],
        **{**EXACT, "friction": ("viscous",)},
    ).fit(STATES, torque)
    assert_allclose(robot.predict(STATES), plain.predict(STATES), atol=1e-7)


def test_the_first_of_two_effects_with_a_constant_has_it_all():
    torque = DECLARED.copy()
    torque[:, 1] += 0.4 + 0.3 * np.abs(V[:, 1]) + 2.0 * (Q[:, 1] - 0.5)
    pair = [effects.Spring(1), effects.AsymmetricFriction(1)]
    for friction in (("viscous",), ("viscous", "offset")):
        for given, first in (
            (pair, "spring:c"),
            (pair[::-1], "asymmetric_friction:dFc"),
        ):
            robot = RobotIdentifier(
                MODEL, effects=given, **{**EXACT, "friction": friction}
            )
            robot.fit(STATES, torque)
            values = dict(zip(robot.parameter_names_, robot.theta_))
            own = {
                k: v for k, v in values.items() if k.endswith((":c", "dFc", "offset"))
            }
            assert own.pop(f"joint_2:{first}") == pytest.approx(-0.6, rel=1e-6)
            assert np.abs(list(own.values())).max() < 1e-6
            assert values["joint_2:spring:k"] == pytest.approx(2.0, rel=1e-6)


def test_only_a_counterbalance_of_harmonics_has_a_constant():
    assert effects.Counterbalance(form="harmonics").constant == "e"
    assert effects.Counterbalance(form="linkage").constant == ""
