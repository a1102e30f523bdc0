"""Output error recovers simulated robots, and its sensitivities are derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.effects import AsymmetricFriction, Ripple, Spring, Stribeck
from sklearn_vbjfa.equations import RecordingStates
from sklearn_vbjfa.fit import (
    Normal,
    Windows,
    deviations,
    propagate,
    run_windows,
    slopes,
)
from sklearn_vbjfa.robot import FitOptions
from sklearn_vbjfa.simulation import simulate, simulate_controlled
from tests._quick import one_in
from tests.effects._arms import arm, inverse_dynamics, motion

DT = 0.01
VISCOUS, COULOMB = np.array([1.5, 0.8, 0.6]), np.array([1.0, 0.7, 0.3])
FRICTION = ("viscous", "coulomb")
# States as they are, all rows, no filter.
EXACT = {
    "dt": DT,
    "friction": FRICTION,
    "cutoff": None,
    "options": FitOptions(standstill=None),
}


def planned(model, duration=12.0, seed=3):
    """Time, states, and torques of the rigid bodies and friction."""
    t, states = motion(model.nv, duration=duration, dt=DT, seed=seed)
    v = states[:, model.nv : 2 * model.nv]
    tau = inverse_dynamics(model, states)
    return t, states, tau + VISCOUS[: model.nv] * v + COULOMB[: model.nv] * np.sign(v)


def identified(model, effects=(), duration=6.0, **given):
    """Fit a robot to its own torques."""
    _, states, tau = planned(model, duration)
    robot = RobotIdentifier(model, effects=effects, **{**EXACT, **given})
    return robot.fit(states, tau), states, tau


def windows_of(robot, states, tau, rows):
    predictor = robot.robot_
    recording = predictor.recording(states, tau)
    own = RecordingStates.of_rows(recording.segments, states)
    return predictor, Windows.of(predictor, recording, own, rows)


# -- sensitivities ---------------------------------------------------------------------

ROBOTS = {
    "pendulum": ("Y", ()),
    "arm": ("ZY", ()),
    "slide": ("zY", ()),
    "springs and ripple": ("ZY", (Spring(1), Ripple(0, period=0.7))),
    "friction of speed": ("ZY", (Stribeck(0, vs=0.3), AsymmetricFriction(1))),
}


def sensitivities(robot, states, tau, rows=60):
    """Positions of windows as a function of parameters, and their derivatives."""
    predictor, windows = windows_of(robot, states, tau, rows)

    def positions(theta, starts=windows.start):
        made = run_windows(replace(predictor, theta_=theta), windows, starts)
        return made[:, :, : predictor.features_.n_joints_]

    made = run_windows(predictor, windows, windows.start)
    nv = predictor.features_.n_joints_
    found = slopes(predictor, windows.part(slice(None)), made.reshape(-1, 3 * nv))
    return predictor, windows, made, propagate(found, made, DT), positions


@pytest.mark.parametrize("case", one_in(5, ROBOTS))
def test_sensitivities_are_derivatives_of_the_simulation(case):
    axes, effects = ROBOTS[case]
    model = arm(axes)
    # The medians of few windows scatter where a joint sticks.
    seconds = 3.0 if case == "pendulum" else 6.0
    robot, states, tau = identified(model, effects, duration=seconds)
    robot.set_parameters(robot.theta_.copy(), robot.known_)
    # Effects of some size, which the torques did not have.
    robot.theta_[robot.features_.n_parameters_ :] = 0.4
    predictor, windows, _, S, positions = sensitivities(robot, states, tau)
    theta, nv = predictor.theta_, model.nv
    p = theta.size
    for k in range(p):
        step = 1e-4 * max(abs(theta[k]), 0.1)
        up, down = theta.copy(), theta.copy()
        up[k] += step
        down[k] -= step
        expected = (positions(up) - positions(down)) / (2 * step)
        own = S[..., k].transpose(1, 0, 2)
        # Where a joint turns round or sticks between two rows, the rule is of order
        # one; nearly all windows agree closely.
        size = max(np.abs(expected).max(), 1e-4)
        gap = np.abs(own - expected).max(axis=(1, 2)) / size
        assert np.median(gap) < 0.03, robot.parameter_names_[k]
        assert np.sqrt(np.mean((own - expected) ** 2)) < 0.05 * size
    for k in range(2 * nv):
        up, down = windows.start.copy(), windows.start.copy()
        up[:, k] += 1e-5
        down[:, k] -= 1e-5
        expected = (positions(theta, up) - positions(theta, down)) / 2e-5
        own = S[..., p + k].transpose(1, 0, 2)
        gap = np.abs(own - expected).max(axis=(1, 2)) / np.abs(expected).max()
        assert np.median(gap) < 0.01


def test_a_joint_that_sticks_has_no_sensitivity():
    model = arm("z", gravity=0.0)
    robot, *_ = identified(model)
    still = np.zeros((50, 3))
    push = np.full((50, 1), 0.5 * COULOMB[0])
    *_, made, S, _ = sensitivities(robot, still, push, rows=50)
    assert_array_equal(made[..., 1:], 0.0)
    # But for where it stands.
    assert_array_equal(S[..., :-2], 0.0)
    assert_array_equal(S[..., -2], 1.0)


def test_a_turn_multiplies_the_sensitivity_by_the_accelerations_after_and_before():
    """A sliding mass m is thrown against force and friction, F = T + C sign(v)."""
    model = arm("z", gravity=0.0)
    robot, _, _ = identified(model)
    m = robot.theta_[0]
    C, push, v0, n = 1.0, -3.0, 0.5, 200
    theta = np.zeros_like(robot.theta_)
    theta[:10], theta[11] = robot.theta_[:10], C
    robot.set_parameters(theta, robot.known_)
    states = np.tile([0.0, v0, 0.0], (n, 1))
    *_, made, S, _ = sensitivities(robot, states, np.full((n, 1), push), rows=n)
    # v0 / (before) is the time until it turns, in which a velocity grows the way by t.
    before, after = (push - C) / m, (push + C) / m
    turn = -v0 / before
    t = DT * np.arange(n)
    expected = np.where(t < turn, t, turn + after / before * (t - turn))
    assert made[0, -1, 1] < 0
    assert_allclose(S[:, 0, 0, -1], expected, atol=0.02 * expected.max())


# -- recovery --------------------------------------------------------------------------


def simulated(model, duration=12.0, seed=3, noise=2e-4, torque_noise=0.0):
    """Noisy positions of a robot that is driven by torques; and its true states."""
    truth, *_ = identified(model)
    t, states, tau = planned(model, duration, seed)
    nv = model.nv
    rng = np.random.default_rng(seed)
    made = np.empty_like(states)
    # Torques hold the motion near the plan for some seconds: start again then.
    groups = np.arange(t.size) // 200
    for g in np.unique(groups):
        rows = groups == g
        start = states[rows][0]
        made[rows] = simulate(
            truth.robot_.torque_model(), tau[rows], start[:nv], start[nv : 2 * nv]
        )
    q = made[:, :nv] + noise * rng.normal(size=(t.size, nv))
    return q, tau + torque_noise * rng.normal(size=tau.shape), groups, truth, made


SETTINGS = {
    "dt": DT,
    "friction": FRICTION,
    "criterion": "simulation",
    "options": FitOptions(window=1.0),
}


@pytest.fixture(scope="module")
def pair():
    """Fit torques, and refine, on the same noisy recording of an arm."""
    q, tau, groups, truth, made = simulated(arm("ZY"), duration=24.0)
    plain = RobotIdentifier(arm("ZY"), dt=DT, friction=FRICTION)
    refined = RobotIdentifier(arm("ZY"), **SETTINGS)
    plain.fit(q, tau, groups)
    return plain, refined.fit(q, tau, groups), truth, made, (q, tau, groups)


def test_the_robot_is_recovered_from_noisy_positions(pair):
    plain, refined, truth, made, _ = pair
    told = refined.criteria_
    # Positions err by little more than the encoders.
    assert (told.position_after < 5e-4).all()
    assert (told.position_after <= told.position_before).all()
    assert told.converged
    exact = truth.predict(made)
    size = exact.std(axis=0)
    errors = [(r.predict(made) - exact).std(axis=0) / size for r in (plain, refined)]
    assert (errors[1] < 0.05).all()
    assert (errors[1] < errors[0] + 0.005).all()


def test_what_is_left_is_within_the_deviations(pair):
    _, refined, truth, _, _ = pair
    known = refined.identifiable_
    off = (refined.theta_ - truth.theta_)[known] / refined.theta_std_[known]
    assert np.isfinite(refined.theta_std_).all()
    assert np.abs(off).max() < 6
    assert np.sqrt(np.mean(off**2)) < 3


def test_the_report_of_errors_is_that_of_simulations(pair):
    plain, refined, _, _, (q, tau, groups) = pair
    told = refined.criteria_
    assert told.window == pytest.approx(1.0)
    assert told.n_windows == 12
    errors = []
    for rows in range(0, q.shape[0], 200):
        states = plain.state_estimator_.transform(q[rows : rows + 200])
        first = rows + (200 % 101) // 2
        start = states[first - rows]
        made = plain.simulate(tau[first : first + 101], start[:2], start[2:4])
        errors.append(made[:, :2] - q[first : first + 101])
    expected = np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))
    assert_allclose(told.position_before, expected, rtol=1e-6)
    # The torque fit minimises the torque errors.
    own, other = (x.residuals(q, tau, groups).rms() for x in (refined, plain))
    assert (own > 0.999 * other).all()


def test_effects_are_refined_and_their_shapes_stay():
    model = arm("z", gravity=0.0)
    t, states, tau = planned(model, 20.0)
    robot, *_ = identified(model)
    spring = 3.0
    tau = tau + spring * states[:, :1]
    truth = robot.robot_.torque_model()
    truth = replace(
        truth, effects=(Spring(0),), coefficients=(np.array([spring, 0.5]),)
    )
    made = simulate(truth, tau, *states[0, :2, None])
    q = made[:, :1] + 1e-4 * np.random.default_rng(0).normal(size=(t.size, 1))
    found = RobotIdentifier(model, effects=[Spring(0)], **SETTINGS).fit(q, tau)
    expected = [*robot.theta_[[0, 10, 11]], spring, 0.5]
    at = [0, 10, 11, 12, 13]
    off = (found.theta_[at] - expected) / found.theta_std_[at]
    assert np.abs(off).max() < 6
    assert_allclose(found.theta_[at], expected, rtol=0.05)
    assert found.criteria_.position_after[0] < 2e-4


def regression_of_windows(rng, W, rows, r):
    """Fit W windows of integrated noise, linear: normal equations and errors (r,)."""
    X, noise = rng.normal(size=(W, rows, r)), rng.normal(size=(W, rows))
    if rows > 1:
        # Errors of a window are integrals, and its sensitivities slow.
        X = np.cumsum(X, axis=1) / np.sqrt(np.arange(1, rows + 1))[:, None]
        noise = np.cumsum(np.cumsum(noise, axis=1), axis=1)
        noise /= np.sqrt(np.mean(noise**2))
    grams = np.einsum("wmi,wmj->wij", X, X) / rows
    slopes = np.einsum("wmi,wm->wi", X, noise) / rows
    H = grams.sum(axis=0)
    error = np.linalg.solve(H, slopes.sum(axis=0))
    nothing = np.empty((W, 0, r))
    normal = Normal(H=H, g=grams @ error - slopes, cross=nothing, step=nothing[:, :, 0])
    return normal, error


@pytest.mark.parametrize(
    ("W", "rows", "r", "least", "most"),
    # Ninety per cent; with a standard error of 1.5 and, from t, up to 5 below.
    [
        (60, 1, 4, 0.86, 0.94),
        (12, 1, 4, 0.83, 0.94),
        (36, 50, 12, 0.86, 0.94),
        # As few windows as directions: too wide rather than too narrow.
        (12, 3, 12, 0.90, 1.0),
        (12, 50, 12, 0.90, 1.0),
        (8, 50, 30, 0.86, 1.0),
    ],
)
def test_deviations_are_those_of_fits_that_are_repeated(W, rows, r, least, most):
    """W / (W - r - 2) is right, not W / (W - r); the floor of three errs upwards."""
    rng = np.random.default_rng(0)
    inside, squares, claimed = [], [], []
    for _ in range(300):
        normal, error = regression_of_windows(rng, W, rows, r)
        std = deviations(normal, np.eye(r), 1e-12, np.ones(r))
        inside.append(np.abs(error) < 1.645 * std)
        squares.append(error**2)
        claimed.append(std**2)
        # By hand: the sandwich, with Student's variance for what remains.
        inverse = np.linalg.inv(normal.H)
        meat = normal.g.T @ normal.g * W / (max(W - r, 3) - 2)
        by_hand = np.sqrt(np.diagonal(inverse @ meat @ inverse))
        assert_allclose(std, by_hand, rtol=1e-5)
    assert least < np.mean(inside) < most
    ratio = np.sqrt(np.mean(claimed) / np.mean(squares))
    assert 0.95 < ratio < (1.15 if W >= 3 * r else 3.0)


# -- closed loop -----------------------------------------------------------------------


def test_a_controlled_mass_follows_the_solution_of_its_equation():
    """Without friction: m q'' = K (q_ref - q) - D q', a step of the reference."""
    model = arm("z", gravity=0.0)
    robot, *_ = identified(model)
    m = robot.theta_[0]
    quiet = robot.robot_.torque_model()
    quiet = replace(quiet, friction=0.0 * quiet.friction)
    K, D = 4.0 * m, 2.0 * m  # poles at -1 +- i sqrt(3)
    t = 1e-3 * np.arange(3000)

    def control(i, q, v):
        return K * (1.0 - q) - D * v

    made = simulate_controlled(quiet, control, np.zeros(1), np.zeros(1), t)
    w = np.sqrt(3.0)
    expected = 1.0 - np.exp(-t) * (np.cos(w * t) + np.sin(w * t) / w)
    # Torques are held for a sample period.
    assert_allclose(made[:, 0], expected, atol=2e-3)


# -- bad input -------------------------------------------------------------------------

BAD = {
    "criterion": ({"criterion": "position"}, "criterion must be 'torque' or"),
    "window": ({"options": FitOptions(window=-1.0)}, "window must be a positive time"),
    "words": ({"options": FitOptions(window="long")}, "window must be a positive time"),
    "long": (
        {"options": FitOptions(window=100.0)},
        "longer than the longest recording",
    ),
    "dt": ({"dt": None}, "give dt in seconds"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    settings, message = BAD[case]
    _, states, tau = planned(arm("ZY"))
    robot = RobotIdentifier(arm("ZY"), **{**SETTINGS, **settings})
    with pytest.raises(ValueError, match=message):
        robot.fit(states, tau)
