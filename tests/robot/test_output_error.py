"""Output-error estimation: sensitivities, recovery of simulated robots, bad input."""

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
# Unfiltered states, all rows.
EXACT = {
    "dt": DT,
    "friction": FRICTION,
    "cutoff": None,
    "options": FitOptions(standstill=None),
}


def planned_motion(model, duration=12.0, seed=3):
    """Return times, states, and torques of rigid bodies and friction."""
    t, states = motion(model.nv, duration=duration, dt=DT, seed=seed)
    v = states[:, model.nv : 2 * model.nv]
    tau = inverse_dynamics(model, states)
    return t, states, tau + VISCOUS[: model.nv] * v + COULOMB[: model.nv] * np.sign(v)


def identified(model, effects=(), duration=6.0, **settings):
    """Fit a robot to exact torques."""
    _, states, tau = planned_motion(model, duration)
    robot = RobotIdentifier(model, effects=effects, **{**EXACT, **settings})
    return robot.fit(states, tau), states, tau


def windows_of(robot, states, tau, rows):
    predictor = robot.robot_
    recording = predictor.recording(states, tau)
    row_states = RecordingStates.of_rows(recording.segments, states)
    return predictor, Windows.of(predictor, recording, row_states, rows)


# -- sensitivities ---------------------------------------------------------------------

ROBOTS = {
    "pendulum": ("Y", ()),
    "arm": ("ZY", ()),
    "slide": ("zY", ()),
    "springs and ripple": ("ZY", (Spring(1), Ripple(0, period=0.7))),
    "friction of speed": ("ZY", (Stribeck(0, vs=0.3), AsymmetricFriction(1))),
}


def sensitivities(robot, states, tau, rows=60):
    """Return positions of windows as a function of parameters, and derivatives."""
    predictor, windows = windows_of(robot, states, tau, rows)

    def positions(theta, starts=windows.start):
        runs = run_windows(replace(predictor, theta_=theta), windows, starts)
        return runs[:, :, : predictor.features_.n_joints_]

    runs = run_windows(predictor, windows, windows.start)
    nv = predictor.features_.n_joints_
    found = slopes(predictor, windows.part(slice(None)), runs.reshape(-1, 3 * nv))
    return (predictor, windows, runs, propagate(found, runs, DT), positions)


@pytest.mark.parametrize("case", one_in(5, ROBOTS))
def test_sensitivities_are_derivatives_of_the_simulation(case):
    axes, effects = ROBOTS[case]
    model = arm(axes)
    # Medians over few windows scatter if a joint sticks.
    seconds = 3.0 if case == "pendulum" else 6.0
    robot, states, tau = identified(model, effects, duration=seconds)
    robot.set_parameters(robot.theta_.copy(), robot.known_)
    # Effects that the torques did not have.
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
        actual = S[..., k].transpose(1, 0, 2)
        # Reversals and sticking between two rows have errors of first order; nearly
        # all windows agree closely.
        size = max(np.abs(expected).max(), 1e-4)
        error = np.abs(actual - expected).max(axis=(1, 2)) / size
        assert np.median(error) < 0.03, robot.parameter_names_[k]
        assert np.sqrt(np.mean((actual - expected) ** 2)) < 0.05 * size
    for k in range(2 * nv):
        up, down = windows.start.copy(), windows.start.copy()
        up[:, k] += 1e-5
        down[:, k] -= 1e-5
        expected = (positions(theta, up) - positions(theta, down)) / 2e-5
        actual = S[..., p + k].transpose(1, 0, 2)
        error = np.abs(actual - expected).max(axis=(1, 2)) / np.abs(expected).max()
        assert np.median(error) < 0.01


def test_sticking_joint_has_zero_sensitivity():
    model = arm("z", gravity=0.0)
    robot, *_ = identified(model)
    still = np.zeros((50, 3))
    push = np.full((50, 1), 0.5 * COULOMB[0])
    *_, states, S, _ = sensitivities(robot, still, push, rows=50)
    assert_array_equal(states[..., 1:], 0.0)
    # Except to the initial position.
    assert_array_equal(S[..., :-2], 0.0)
    assert_array_equal(S[..., -2], 1.0)


def test_velocity_sensitivity_jumps_at_a_reversal():
    """A sliding mass m reverses under a force T and friction C sign(v)."""
    model = arm("z", gravity=0.0)
    robot, _, _ = identified(model)
    m = robot.theta_[0]
    C, push, v0, n = 1.0, -3.0, 0.5, 200
    theta = np.zeros_like(robot.theta_)
    theta[:10], theta[11] = robot.theta_[:10], C
    robot.set_parameters(theta, robot.known_)
    states = np.tile([0.0, v0, 0.0], (n, 1))
    *_, runs, S, _ = sensitivities(robot, states, np.full((n, 1), push), rows=n)
    # Until the reversal at v0 / before, positions change by t times the velocity.
    before, after = (push - C) / m, (push + C) / m
    reversal = -v0 / before
    t = DT * np.arange(n)
    expected = np.where(t < reversal, t, reversal + after / before * (t - reversal))
    assert runs[0, -1, 1] < 0
    assert_allclose(S[:, 0, 0, -1], expected, atol=0.02 * expected.max())


# -- recovery --------------------------------------------------------------------------


def simulated(model, duration=12.0, seed=3, noise=2e-4, torque_noise=0.0):
    """Return noisy positions of a torque-driven robot, and its true states."""
    truth, *_ = identified(model)
    t, states, tau = planned_motion(model, duration, seed)
    nv = model.nv
    rng = np.random.default_rng(seed)
    true = np.empty_like(states)
    # The motion drifts from the plan within seconds: restart regularly.
    groups = np.arange(t.size) // 200
    for g in np.unique(groups):
        rows = groups == g
        start = states[rows][0]
        true[rows] = simulate(
            truth.robot_.torque_model(), tau[rows], start[:nv], start[nv : 2 * nv]
        )
    q = true[:, :nv] + noise * rng.normal(size=(t.size, nv))
    return (q, tau + torque_noise * rng.normal(size=tau.shape), groups, truth, true)


SETTINGS = {
    "dt": DT,
    "friction": FRICTION,
    "criterion": "simulation",
    "options": FitOptions(window=1.0),
}


@pytest.fixture(scope="module")
def fitted_pair():
    """Fit by torque error and by output error to the same recording of an arm."""
    q, tau, groups, truth, true = simulated(arm("ZY"), duration=24.0)
    plain = RobotIdentifier(arm("ZY"), dt=DT, friction=FRICTION)
    refined = RobotIdentifier(arm("ZY"), **SETTINGS)
    plain.fit(q, tau, groups)
    return plain, refined.fit(q, tau, groups), truth, true, (q, tau, groups)


def test_output_error_recovers_the_robot(fitted_pair):
    plain, refined, truth, true, _ = fitted_pair
    criteria = refined.criteria_
    # Position errors are little larger than the encoder noise.
    assert (criteria.position_after < 5e-4).all()
    assert (criteria.position_after <= criteria.position_before).all()
    assert criteria.converged
    exact = truth.predict(true)
    size = exact.std(axis=0)
    errors = [(r.predict(true) - exact).std(axis=0) / size for r in (plain, refined)]
    assert (errors[1] < 0.05).all()
    assert (errors[1] < errors[0] + 0.005).all()


def test_errors_are_within_the_standard_errors(fitted_pair):
    _, refined, truth, _, _ = fitted_pair
    known = refined.identifiable_
    off = (refined.theta_ - truth.theta_)[known] / refined.theta_std_[known]
    assert np.isfinite(refined.theta_std_).all()
    assert np.abs(off).max() < 6
    assert np.sqrt(np.mean(off**2)) < 3


def test_reported_errors_match_simulations(fitted_pair):
    plain, refined, _, _, (q, tau, groups) = fitted_pair
    criteria = refined.criteria_
    assert criteria.window == pytest.approx(1.0)
    assert criteria.n_windows == 12
    errors = []
    for rows in range(0, q.shape[0], 200):
        states = plain.state_estimator_.transform(q[rows : rows + 200])
        first = rows + (200 % 101) // 2
        start = states[first - rows]
        positions = plain.simulate(tau[first : first + 101], start[:2], start[2:4])
        errors.append(positions[:, :2] - q[first : first + 101])
    expected = np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))
    assert_allclose(criteria.position_before, expected, rtol=1e-6)
    # The torque fit minimises the torque errors.
    new, old = (x.residuals(q, tau, groups).rms() for x in (refined, plain))
    assert (new > 0.999 * old).all()


def test_effect_coefficients_are_refined():
    model = arm("z", gravity=0.0)
    t, states, tau = planned_motion(model, 20.0)
    robot, *_ = identified(model)
    spring = 3.0
    tau = tau + spring * states[:, :1]
    truth = robot.robot_.torque_model()
    truth = replace(
        truth, effects=(Spring(0),), coefficients=(np.array([spring, 0.5]),)
    )
    response = simulate(truth, tau, *states[0, :2, None])
    q = response[:, :1] + 1e-4 * np.random.default_rng(0).normal(size=(t.size, 1))
    refined = RobotIdentifier(model, effects=[Spring(0)], **SETTINGS).fit(q, tau)
    expected = [*robot.theta_[[0, 10, 11]], spring, 0.5]
    indices = [0, 10, 11, 12, 13]
    error = (refined.theta_[indices] - expected) / refined.theta_std_[indices]
    assert np.abs(error).max() < 6
    assert_allclose(refined.theta_[indices], expected, rtol=0.05)
    assert refined.criteria_.position_after[0] < 2e-4


def regression_of_windows(rng, W, rows, r):
    """Return normal equations and errors (r,) of a linear fit of W noisy windows."""
    X, noise = rng.normal(size=(W, rows, r)), rng.normal(size=(W, rows))
    if rows > 1:
        # Errors within a window are integrated, and sensitivities vary slowly.
        X = np.cumsum(X, axis=1) / np.sqrt(np.arange(1, rows + 1))[:, None]
        noise = np.cumsum(np.cumsum(noise, axis=1), axis=1)
        noise /= np.sqrt(np.mean(noise**2))
    grams = np.einsum("wmi,wmj->wij", X, X) / rows
    slopes = np.einsum("wmi,wm->wi", X, noise) / rows
    H = grams.sum(axis=0)
    error = np.linalg.solve(H, slopes.sum(axis=0))
    empty = np.empty((W, 0, r))
    normal = Normal(H=H, g=grams @ error - slopes, cross=empty, step=empty[:, :, 0])
    return normal, error


@pytest.mark.parametrize(
    ("W", "rows", "r", "least", "most"),
    # Nominal 90 %, with a standard error of 1.5 % and up to 5 % less from Student's t.
    [
        (60, 1, 4, 0.86, 0.94),
        (12, 1, 4, 0.83, 0.94),
        (36, 50, 12, 0.86, 0.94),
        # As many directions as windows: intervals are conservative.
        (12, 3, 12, 0.90, 1.0),
        (12, 50, 12, 0.90, 1.0),
        (8, 50, 30, 0.86, 1.0),
    ],
)
def test_standard_errors_match_repeated_fits(W, rows, r, least, most):
    """The factor is W / (W - r - 2) and not W / (W - r); its floor is conservative."""
    rng = np.random.default_rng(0)
    inside, squares, claimed = [], [], []
    for _ in range(300):
        normal, error = regression_of_windows(rng, W, rows, r)
        std = deviations(normal, np.eye(r), 1e-12, np.ones(r))
        inside.append(np.abs(error) < 1.645 * std)
        squares.append(error**2)
        claimed.append(std**2)
        # Sandwich covariance with the variance of Student's t.
        inverse = np.linalg.inv(normal.H)
        meat = normal.g.T @ normal.g * W / (max(W - r, 3) - 2)
        by_hand = np.sqrt(np.diagonal(inverse @ meat @ inverse))
        assert_allclose(std, by_hand, rtol=1e-5)
    assert least < np.mean(inside) < most
    ratio = np.sqrt(np.mean(claimed) / np.mean(squares))
    assert 0.95 < ratio < (1.15 if W >= 3 * r else 3.0)


# -- closed loop -----------------------------------------------------------------------


def test_controlled_mass_follows_the_analytic_solution():
    """Step response without friction: m q'' = K (q_ref - q) - D q'."""
    model = arm("z", gravity=0.0)
    robot, *_ = identified(model)
    m = robot.theta_[0]
    frictionless = robot.robot_.torque_model()
    frictionless = replace(frictionless, friction=0.0 * frictionless.friction)
    K, D = 4.0 * m, 2.0 * m  # poles at -1 +- i sqrt(3)
    t = 1e-3 * np.arange(3000)

    def control(i, q, v):
        return K * (1.0 - q) - D * v

    states = simulate_controlled(frictionless, control, np.zeros(1), np.zeros(1), t)
    w = np.sqrt(3.0)
    expected = 1.0 - np.exp(-t) * (np.cos(w * t) + np.sin(w * t) / w)
    # The tolerance covers torques held for a sample period.
    assert_allclose(states[:, 0], expected, atol=2e-3)


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
    _, states, tau = planned_motion(arm("ZY"))
    robot = RobotIdentifier(arm("ZY"), **{**SETTINGS, **settings})
    with pytest.raises(ValueError, match=message):
        robot.fit(states, tau)
