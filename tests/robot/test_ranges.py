"""What effects were fitted on, and predictions that leave it."""

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

pytest.importorskip("pinocchio")

from sklearn_vbjfa import RobotIdentifier, effects, load_identified
from sklearn_vbjfa.robot import SignalRanges
from tests.effects._arms import arm, inverse_dynamics, motion

MODEL = arm("ZYX")
DT = 0.01
T, STATES = motion(3, duration=20.0, dt=DT, seed=1)
Q, V, A = np.split(STATES, 3, axis=1)
LOAD = inverse_dynamics(MODEL, STATES)
TORQUE = LOAD + np.array([0.8, 0.5, 0.3]) * V
TORQUE[:, 1] += 3.0 * Q[:, 1]
EXACT = {
    "friction": ("viscous",),
    "regressor": LinearRegression(),
    "projector": None,
    "cutoff": None,
    "standstill": None,
}
SPRING = effects.Spring(joint=1)
RIPPLE = effects.Ripple(joint=1, period=0.3)


def robot(*used, **given):
    return RobotIdentifier(
        MODEL, dt=DT, effects=used, **{"friction": ("viscous",), **given}
    )


def said(fitted, *args, **kwargs):
    """Warnings of a prediction."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fitted.predict(*args, **kwargs)
    return [str(one.message) for one in caught]


def ends(values):
    return values.min(), values.max()


def numbers(fitted):
    return np.array([(r.position, r.speed, r.load) for r in fitted.effect_ranges_])


# -- what is recorded


def test_ranges_are_those_of_the_rows_that_were_fitted():
    weight = np.ones(TORQUE.shape)
    weight[500:, 1] = 0.0
    fitted = robot(SPRING, **EXACT).fit(STATES, TORQUE, sample_weight=weight)
    *friction, spring = fitted.effect_ranges_
    assert [(r.name, r.joint) for r in friction] == [("viscous", j) for j in range(3)]
    assert (spring.name, spring.joint) == ("spring", 1)
    assert spring.depends == ("position",)
    for one in fitted.effect_ranges_:
        rows = slice(0, 500 if one.joint == 1 else None)
        assert_allclose(one.position, ends(Q[rows, one.joint]), rtol=1e-12)
        assert_allclose(one.speed, ends(np.abs(V[rows, one.joint])), rtol=1e-12)
        assert_allclose(one.load, ends(LOAD[rows, one.joint]), rtol=1e-6)


def test_rows_at_rest_are_not_in_the_range():
    fitted = robot(SPRING, **EXACT | {"standstill": 0.5}).fit(STATES, TORQUE)
    for one in fitted.effect_ranges_:
        moves = np.abs(V[:, one.joint]) > 0.5
        assert_allclose(one.position, ends(Q[moves, one.joint]))
        assert one.speed[0] > 0.5


def test_without_effects_the_load_is_not_needed():
    fitted = robot(**EXACT).fit(STATES, TORQUE)
    assert np.isnan([r.load for r in fitted.effect_ranges_]).all()
    assert np.isfinite([(r.position, r.speed) for r in fitted.effect_ranges_]).all()


def test_positions_and_states_give_the_same_ranges():
    given = robot(SPRING, cutoff=8.0).fit(STATES, TORQUE)
    estimated = robot(SPRING, cutoff=8.0).fit(Q, TORQUE)
    # The ends of the recording are left out where the smoother is one-sided.
    assert_allclose(numbers(given), numbers(estimated), atol=0.1)


def test_a_glitch_of_one_sample_is_filtered_before():
    spoilt = STATES.copy()
    spoilt[700, 1] += 50.0
    fitted = robot(SPRING, cutoff=4.0).fit(spoilt, TORQUE)
    clean = robot(SPRING, cutoff=4.0).fit(STATES, TORQUE)
    reach = [r.effect_ranges_[-1].position[1] for r in (fitted, clean)]
    assert reach[0] - reach[1] < 50.0 * 2 * 4.0 * DT * 1.2


@pytest.mark.parametrize("n_jobs", [1, 2])
def test_recordings_add_up(n_jobs):
    groups = np.repeat([0, 1], [800, STATES.shape[0] - 800])
    fitted = robot(SPRING, n_jobs=n_jobs, **EXACT).fit(STATES, TORQUE, groups=groups)
    whole = robot(SPRING, **EXACT).fit(STATES, TORQUE)
    assert_allclose(numbers(fitted), numbers(whole), rtol=1e-9)


def test_ranges_of_disjoint_rows_add_up():
    rng = np.random.default_rng(0)
    x, counts = rng.normal(size=(2, 30, 3)), rng.random((30, 3)) > 0.3
    counts[:, 2] = False
    parts = [slice(0, 1), slice(1, 12), slice(12, 30)]
    total, *others = (SignalRanges.of(x[:, p], counts[p]) for p in parts)
    for one in others:
        total = total + one
    for pairs, values in zip(total.pairs(), x):
        for j in (0, 1):
            assert pairs[j] == ends(values[counts[:, j], j])
        assert np.isnan(pairs[2]).all()


def test_ranges_follow_the_estimator():
    fitted = robot(SPRING, **EXACT).fit(STATES, TORQUE)
    again = pickle.loads(pickle.dumps(fitted))
    assert again.effect_ranges_ == fitted.effect_ranges_
    assert said(again, 2 * STATES) == said(fitted, 2 * STATES) != []
    assert not hasattr(clone(fitted), "effect_ranges_")
    fitted.fit(0.5 * STATES, TORQUE)
    half = numbers(fitted)[:, :2]
    assert_allclose(half, 0.5 * numbers(again)[:, :2])


def test_other_regressors_have_ranges():
    plain = robot(SPRING).fit(Q, TORQUE)
    other = robot(SPRING, regressor=LinearRegression()).fit(Q, TORQUE)
    assert_allclose(numbers(other), numbers(plain))


# -- what is said of a prediction


@pytest.fixture(scope="module")
def fitted():
    return robot(SPRING, friction=("viscous", "coulomb")).fit(Q, TORQUE)


def test_the_motion_of_the_fit_is_inside(fitted):
    assert said(fitted, Q) == []
    assert said(fitted, STATES) == []


@pytest.mark.parametrize("seed", range(3))
def test_the_same_motion_is_inside_where_it_was_not_fitted(seed):
    # A quarter of a random motion, in three stretches.
    _, states = motion(3, duration=60.0, dt=DT, seed=10 + seed)
    rows = np.arange(len(states)) % 2000 < 1500
    groups = np.cumsum(np.r_[0, np.diff(rows.astype(int)) != 0])
    own = robot(SPRING, effects.LoadFriction(joint=0))
    torque = inverse_dynamics(MODEL, states) + states[:, 3:6]
    own.fit(states[rows, :3], torque[rows], groups=groups[rows])
    assert said(own, states[~rows, :3], groups=groups[~rows]) == []


def test_the_warning_names_who_asked(fitted):
    for one in (fitted, fitted.robot_):
        with pytest.warns(UserWarning, match="outside") as told:
            one.predict(5.0 * STATES)
        assert {warning.filename for warning in told} == {__file__}


def test_one_warning_names_joint_and_range(fitted):
    (message,) = said(fitted, 2.0 * Q)
    low, high = fitted.effect_ranges_[-1].position
    assert "joint_2: positions to " in message
    assert f"fitted on {low:.3g} to {high:.3g} rad (spring; " in message
    assert "% of the rows" in message
    for j in range(3):
        assert f"joint_{j + 1}: speeds to" in message
    assert "coulomb" not in message


def test_what_is_held_is_said(fitted):
    (message,) = said(fitted, 2.0 * STATES)
    edge, law = "Held beyond the margin", "Going on by the law"
    assert f"). {edge}: spring. {law}: viscous." in message
    # Only of what is outside.
    slow = STATES * np.repeat([2.0, 1.0, 1.0], 3)
    (message,) = said(fitted, slow)
    assert f"). {edge}: spring." in message
    assert law not in message
    (message,) = said(robot(RIPPLE).fit(Q, TORQUE), slow)
    assert f"). {law}: ripple." in message
    assert edge not in message


# -- torques outside


def springy(states):
    """Torque of `TORQUE` for other states, the spring held beyond the range of `Q`."""
    low, high = ends(Q[:, 1])
    margin = 0.2 * (high - low) + 1e-9 * max(abs(low), abs(high))
    held = np.clip(states[:, 1], low - margin, high + margin)
    own = inverse_dynamics(MODEL, states) + np.array([0.8, 0.5, 0.3]) * states[:, 3:6]
    own[:, 1] += 3.0 * held
    return own


@pytest.mark.filterwarnings("ignore:Predicted outside:UserWarning")
def test_a_spring_is_held_and_declared_friction_is_not(tmp_path):
    far = 2.0 * STATES
    exact = robot(SPRING, **EXACT).fit(STATES, TORQUE)
    assert_allclose(exact.predict(STATES), TORQUE, atol=1e-8)
    assert_allclose(exact.predict(far), springy(far), atol=1e-8)
    # Equal to rounding in the file as well.
    exact.save(tmp_path / "robot.json")
    read = load_identified(tmp_path / "robot.json")
    assert_array_equal(read.predict(far), exact.predict(far))
    one = [read.step(*row.reshape(3, -1)) for row in far[::50]]
    assert_allclose(one, springy(far)[::50], atol=1e-8)


@pytest.mark.filterwarnings("ignore:Predicted outside:UserWarning")
def test_a_ripple_is_followed_beyond_its_range(tmp_path):
    def law(states):
        torque = inverse_dynamics(MODEL, states)
        torque += np.array([0.8, 0.5, 0.3]) * states[:, 3:6]
        torque[:, 1] += 0.7 * np.sin(2 * np.pi / 0.3 * states[:, 1])
        return torque

    far = 2.0 * STATES
    exact = robot(RIPPLE, **EXACT).fit(STATES, law(STATES))
    assert_allclose(exact.predict(far), law(far), atol=1e-7)
    exact.save(tmp_path / "robot.json")
    read = load_identified(tmp_path / "robot.json")
    assert_array_equal(read.predict(far), exact.predict(far))
    one = [read.step(*row.reshape(3, -1)) for row in far[::50]]
    assert_allclose(one, law(far)[::50], atol=1e-7)


def test_a_spring_within_the_margin_follows_its_law_and_nobody_is_warned():
    exact = robot(SPRING, **EXACT).fit(STATES, TORQUE)
    low, high = ends(Q[:, 1])
    rows = STATES[[np.argmin(Q[:, 1]), np.argmax(Q[:, 1])]]
    rows[:, 1] = low - 0.19 * (high - low), high + 0.19 * (high - low)
    law = inverse_dynamics(MODEL, rows) + np.array([0.8, 0.5, 0.3]) * rows[:, 3:6]
    law[:, 1] += 3.0 * rows[:, 1]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_allclose(exact.predict(rows), law, atol=1e-8)
    rows[:, 1] = high + 0.21 * (high - low)
    (message,) = said(exact, rows)
    assert "Held beyond the margin: spring." in message


def test_residuals_of_other_motion_are_those_of_a_prediction():
    far = 2.0 * STATES
    exact = robot(SPRING, **EXACT).fit(STATES, TORQUE)
    found = exact.residuals(far, springy(far), cutoff=None)
    assert_allclose(found.residual, 0.0, atol=1e-8)


def test_the_deviation_of_a_held_torque_is_that_at_the_end():
    noise = 0.1 * np.random.default_rng(0).normal(size=TORQUE.shape)
    fitted = robot(SPRING, bodies="free").fit(STATES, TORQUE + noise)
    low, high = fitted.effect_ranges_[-1].position
    high += 0.2 * (high - low) + 1e-9 * max(abs(low), abs(high))
    rows = STATES[[100, 700, 900]].copy()
    rows[:, 1] = high + np.array([0.0, 0.05, 5.0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torque, std = fitted.predict(rows, return_std=True)
    end = np.tile([high, 1.0], (3, 1))
    phi = np.hstack([fitted.features_.matrices(rows)[:, 1], end])
    known = fitted.robot_.prediction_covariance
    assert_allclose(torque[:, 1], phi @ fitted.theta_, rtol=1e-9)
    told = np.isfinite(np.diagonal(known.covariance))
    C, phi = known.covariance[np.ix_(told, told)], phi[:, told]
    variance = np.einsum("nk,kl,nl->n", phi, C, phi) + known.rest[1]
    assert_allclose(std[:, 1], np.sqrt(variance), rtol=1e-6)
    free = replace(fitted.robot_, effect_ranges_=()).predict(rows, return_std=True)
    assert free[1][2, 1] > 2 * std[2, 1]


def test_a_fit_holds_nothing():
    # Equations of a fit are those of a robot with an effect without `depends`.
    class Everywhere(effects.Spring):
        depends = ()

    rows = slice(0, 1200)
    one, other = (
        robot(effect).fit(Q[rows], TORQUE[rows])
        for effect in (SPRING, Everywhere(joint=1))
    )
    assert_array_equal(one.theta_, other.theta_)


def test_positions_matter_to_the_joint_that_has_the_spring(fitted):
    far = Q.copy()
    far[:, 0] += 10.0
    assert said(fitted, far) == []
    far[:, 1] += 10.0
    (message,) = said(fitted, far)
    assert "joint_2: positions" in message
    assert "100 % of the rows" in message
    assert "speeds" not in message


def test_loads_matter_to_load_friction():
    own = robot(effects.LoadFriction(joint=1), cutoff=5.0).fit(STATES, TORQUE)
    assert said(own, STATES) == []
    # The same speeds with three times the accelerations.
    fast = np.hstack([Q, V, 3 * A])
    (message,) = said(own, fast)
    assert "joint_2: loads to" in message
    assert "N m (load_friction; " in message
    assert "speeds" not in message


def test_a_row_at_a_time(fitted):
    row = STATES[100:101].copy()
    assert said(fitted, row) == []
    row[0, 3:6] = [0.0, 30.0, 0.0]
    (message,) = said(fitted, row)
    assert "joint_2: speeds to 30 rad/s" in message


def test_rest_is_no_speed():
    # One speed only: at rest nothing is asked of viscous friction.
    t = np.arange(0, 4.0, DT)
    ramp = np.column_stack([0.5 * t, np.full_like(t, 0.5), 0 * t])
    own = RobotIdentifier(
        arm("Z"), dt=DT, standstill=0.01, projector=None, friction=("viscous",)
    )
    own.fit(ramp, ramp[:, 1:2] + 0.1 * ramp[:, :1])
    (viscous,) = own.effect_ranges_
    assert_allclose(viscous.speed, (0.5, 0.5))
    assert said(own, ramp) == []
    assert said(own, ramp * [1.0, 0.0, 0.0]) == []
    (message,) = said(own, ramp * [1.0, 0.4, 1.0])
    assert "speeds to 0.2 rad/s, fitted on 0.5 to 0.5 rad/s" in message


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_joint_that_never_reversed_is_known_one_way(way):
    t = np.arange(0, 8.0, DT)
    speed = 1.0 + 0.5 * np.sin(t)
    forth = way * np.column_stack([t - 0.5 * np.cos(t), speed, 0.5 * np.cos(t)])
    own = RobotIdentifier(
        arm("Z"), dt=DT, standstill=0.01, projector=None, friction="coulomb"
    ).fit(forth, forth[:, 1:2] + way * 2.0)
    (coulomb,) = own.effect_ranges_
    assert coulomb.direction == (way, way)
    assert said(own, forth) == []
    assert said(own, 3.0 * forth) == []  # however fast
    (message,) = said(own, -forth)
    first, second = ("forward", "backward")[:: int(-way)]
    assert f"joint_1: {first} motion, fitted on {second} motion only (coul" in message


def test_a_joint_that_reversed_is_known_both_ways(fitted):
    assert {r.direction for r in fitted.effect_ranges_} == {(-1.0, 1.0)}
    assert said(fitted, -STATES) == said(fitted, np.hstack([-Q, V, A]))


def test_a_slider_has_its_own_unit():
    _, states = motion(1, duration=10.0, dt=DT, seed=2)
    own = RobotIdentifier(arm("x"), dt=DT, effects=[effects.Spring()], **EXACT)
    own.fit(states, 2 * states[:, :1] + states[:, 1:2])
    (message,) = said(own, 3 * states)
    assert " m/s, fitted on " in message
    assert " m (spring; " in message


def test_residuals_and_the_fit_itself_say_nothing(recwarn):
    weight = np.ones(TORQUE.shape)
    weight[1000:] = 0.0
    X = Q.copy()
    X[1000:] *= 4.0
    own = robot(SPRING).fit(X, TORQUE, sample_weight=weight)
    own.residuals(X, TORQUE)
    assert not [w for w in recwarn if "outside" in str(w.message)]


def test_ends_of_a_recording_are_not_judged(fitted):
    # A step at the very end is seen from one side only.
    end = Q.copy()
    end[-3:] += 0.5
    assert said(fitted, end) == []


def test_the_order_of_rows_of_a_range_does_not_matter():
    rows = np.random.default_rng(0).permutation(len(STATES))
    one = robot(SPRING, **EXACT).fit(STATES, TORQUE)
    other = robot(SPRING, **EXACT).fit(STATES[rows], TORQUE[rows])
    assert_allclose(numbers(one), numbers(other), rtol=1e-6)


def test_the_unit_of_the_torque_does_not_matter_to_what_is_outside():
    own = [
        robot(effects.LoadFriction(joint=1), cutoff=5.0).fit(STATES, scale * TORQUE)
        for scale in (1.0, 1e3)
    ]
    fast = np.hstack([Q, V, 3 * A])
    one, other = (said(r, fast)[0] for r in own)
    assert one.split("(")[1] == other.split("(")[1]
    ranges = [np.array(r.effect_ranges_[-1].load) for r in own]
    assert_allclose(1e3 * ranges[0], ranges[1], rtol=1e-3)


def test_a_joint_that_never_counts_has_no_range():
    weight = np.ones(TORQUE.shape)
    weight[:, 2] = 0.0
    fitted = robot(**EXACT).fit(STATES, TORQUE, sample_weight=weight)
    assert np.isnan(fitted.effect_ranges_[2].position).all()
    assert replace(fitted.effect_ranges_[2], joint=0).excess("speed", [9.0]) == [0.0]
