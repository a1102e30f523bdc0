"""Identification of base tilts, joint zeros, axes and torque gains."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import optimize

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.effects import BaseTilt, InModel, JointAxis, JointZero, TorqueGain
from sklearn_vbjfa.equations import piece_moments, sum_moments
from sklearn_vbjfa.fit import ModelValues
from sklearn_vbjfa.robot import FitOptions
from tests._quick import one_in
from tests.effects._arms import arm, motion
from tests.effects._faults import faulty, measured
from tests.model._trees import by_sample
from tests.robot import EXACT

DT = 0.02
VISCOUS = np.array([0.8, 0.5, 0.3, 0.4, 0.6, 0.2])
ARM, SLIDING = arm("ZYX"), arm("ZyX")
T, STATES = motion(3, duration=6.0, dt=DT, seed=1)
_, ELSEWHERE = motion(3, duration=3.0, dt=DT, seed=9)


def torques(model, truth, states=STATES, noise=0.0, seed=0):
    """Return torques of a robot with faults, with white noise."""
    exact = measured(model, states, truth, VISCOUS[: model.nv])
    return exact + noise * np.random.default_rng(seed).normal(size=exact.shape)


def nominal(truth):
    """Return the same effects with their nominal values."""
    return [type(effect)(joint=effect.joint) for effect in truth]


def fit(model, effects, tau, states=STATES, weight=None, groups=None, **keywords):
    robot = RobotIdentifier(model, effects=effects, **{**EXACT, "dt": DT, **keywords})
    return robot.fit(states, tau, sample_weight=weight, groups=groups)


def values(robot):
    """Return the values of the fitted effects of the model."""
    parts = [e.values for e in robot.effects_ if isinstance(e, InModel)]
    return np.concatenate(parts)


def effect_part(robot, parameters):
    return parameters[robot.features_.n_parameters_ :]


FAULTS = {
    "tilt": (ARM, [BaseTilt(0, 0.07, -0.1)]),
    "zero": (ARM, [JointZero(1, 0.15)]),
    "axis": (ARM, [JointAxis(1, 0.05, -0.1)]),
    "axis of a slide": (SLIDING, [JointAxis(1, 0.05, -0.1)]),
    "gain": (ARM, [TorqueGain(1, 1.6)]),
    "axis and zero of one joint": (ARM, [JointZero(1, 0.1), JointAxis(1, 0.05, -0.1)]),
    "everything": (
        ARM,
        [
            JointAxis(2, 0.05, 0.05),
            BaseTilt(0, 0.07, -0.1),
            TorqueGain(0, 1.4),
            JointZero(1, 0.1),
        ],
    ),
}


@pytest.mark.parametrize("case", one_in(4, FAULTS))
def test_values_are_exact_without_noise(case):
    model, truth = FAULTS[case]
    robot = fit(model, nominal(truth), torques(model, truth))
    expected = np.concatenate([e.values for e in truth])
    assert_allclose(values(robot), expected, atol=1e-6)
    assert_array_equal(effect_part(robot, robot.theta_), values(robot))
    assert effect_part(robot, robot.identifiable_).all()
    assert [e.name for e in robot.effects_] == [e.name for e in truth]
    # Predictions for another motion match the measured robot.
    tau = torques(model, truth, ELSEWHERE)
    assert_allclose(robot.predict(ELSEWHERE), tau, atol=1e-6 * np.abs(tau).max())


def literal_regressor(model, effects, states):
    """Return regressors (n, nv, 11 nv) of the robot with faults, by Pinocchio."""
    other, shifts, gains = faulty(model, effects)
    q, v, a = np.split(states, 3, axis=1)
    friction = v[:, :, None, None] * np.eye(model.nv)[:, :, None]
    Phi = np.concatenate([by_sample(other, q - shifts, v, a), friction], axis=3)
    return gains[:, None] * Phi.reshape(*Phi.shape[:2], -1)


def literal_least_squares(model, truth, tau, states):
    """Fit bodies and values; return values, their standard errors, and the columns.

    For given values, the bodies follow from linear least squares with equal joint
    weights; derivatives by the values are central differences.
    """
    start = np.concatenate([e.values for e in truth])

    def columns(x):
        Phi = literal_regressor(model, with_values(truth, x), states)
        return Phi.reshape(tau.size, -1)

    def bodies(x):
        Phi = columns(x)
        size = np.linalg.norm(Phi, axis=0)
        size = np.where(size > 1e-10 * size.max(), size, np.inf)
        return np.linalg.lstsq(Phi / size, tau.ravel(), rcond=1e-8)[0] / size

    def residual(x):
        return columns(x) @ bodies(x) - tau.ravel()

    exact = dict.fromkeys(("ftol", "xtol", "gtol"), 1e-12)
    solution = optimize.least_squares(residual, start, jac="3-point", **exact)
    theta, derivatives = bodies(solution.x), []
    for step in 1e-6 * np.eye(start.size):
        change = columns(solution.x + step) @ theta - columns(solution.x - step) @ theta
        derivatives.append(change / 2e-6)
    J = np.column_stack([columns(solution.x), *derivatives])
    size = np.linalg.norm(J, axis=0)
    size = np.where(size > 1e-10 * size.max(), size, np.inf)
    inverse = np.linalg.pinv(J / size, rcond=1e-8) / size[:, None]
    freedom = tau.size - np.linalg.matrix_rank(J / size, tol=1e-7)
    std = np.sqrt(2 * solution.cost / freedom * (inverse**2).sum(axis=1))
    # Columns of rounding errors count as zero.
    J[:, np.isinf(size)] = 0.0
    return solution.x, std[-start.size :], J.reshape(*tau.shape, -1)


def with_values(effects, x):
    out, start = [], 0
    for effect in effects:
        width = len(effect.coefficients)
        out.append(effect.with_values(x[start : start + width]))
        start += width
    return out


@pytest.mark.parametrize(
    "truth",
    [
        [BaseTilt(0, 0.07, -0.1)],
        [JointZero(1, 0.1), TorqueGain(2, 1.3)],
        [JointAxis(1, 0.05, -0.1)],
    ],
)
def test_values_match_nonlinear_least_squares(truth):
    states = STATES[::2]
    tau = torques(ARM, truth, states, noise=0.2)
    expected, std, columns = literal_least_squares(ARM, truth, tau, states)
    settings = {
        "options": FitOptions(standstill=None, joint_weights=None),
        "input_noise": None,
    }
    robot = fit(ARM, nominal(truth), tau, states, **settings)
    # A value stays within a tenth of its standard error.
    assert np.all(np.abs(values(robot) - expected) < 0.12 * std)
    # Block-wise noise estimates scatter, and the standard errors with them.
    assert_allclose(effect_part(robot, robot.theta_std_), std, rtol=0.5)
    # At convergence and without blocks, the standard errors agree.
    moments = sum_moments([piece_moments(columns, tau, np.ones_like(tau))])
    estimate = ModelValues.of(moments, with_values(truth, expected), 33, None)
    assert_allclose(estimate.std, std, rtol=1e-4)
    assert np.all(np.abs(estimate.step) < 0.02 * std)
    assert estimate.converged()


TRUTH = [BaseTilt(0, 0.07, -0.1), TorqueGain(1, 1.3)]
NOISY = torques(ARM, TRUTH, noise=0.2)


@pytest.mark.parametrize(
    ("effects", "identifiable"),
    [
        ([JointZero(2)], []),
        ([JointZero(0)], []),
        ([TorqueGain(0), TorqueGain(1), TorqueGain(2)], []),
        ([BaseTilt(), JointAxis(0)], []),
        ([JointZero(2, 0.1), JointZero(1)], [1]),
    ],
    ids=["last joint", "vertical", "all gains", "twice", "one of two"],
)
@pytest.mark.filterwarnings("error")
def test_unidentifiable_values_keep_their_start(effects, identifiable):
    tau = torques(ARM, [], noise=0.1)
    robot = fit(ARM, effects, tau)
    hidden = np.delete(np.arange(values(robot).size), identifiable)
    start = np.concatenate([e.values for e in effects])
    assert_array_equal(values(robot)[hidden], start[hidden])
    assert np.isnan(effect_part(robot, robot.theta_std_)[hidden]).all()
    assert not effect_part(robot, robot.identifiable_)[hidden].any()
    assert np.isfinite(effect_part(robot, robot.theta_std_)[identifiable]).all()
    assert effect_part(robot, robot.identifiable_)[identifiable].all()
    # Torque predictions stay accurate.
    expected = torques(ARM, [], ELSEWHERE)
    assert np.abs(robot.predict(ELSEWHERE) - expected).max() < 0.2


@pytest.mark.parametrize("truth", [JointZero(1, 0.6), TorqueGain(1, 4.0)])
def test_values_stay_within_their_bounds(truth):
    robot = fit(ARM, nominal([truth]), torques(ARM, [truth], noise=0.1))
    low, high = robot.effects_[0].bounds()
    assert np.all((low < values(robot)) & (values(robot) < high))


@pytest.mark.parametrize("effect", [BaseTilt(), JointZero(), JointAxis()])
def test_corrections_of_a_single_joint_are_not_identifiable(effect):
    """For a single joint, the correction is equivalent to another body."""
    model = arm("Y")
    _, states = motion(1, duration=6.0, dt=DT, seed=1)
    robot = fit(model, [effect], torques(model, [], states, 0.05), states)
    assert np.isnan(effect_part(robot, robot.theta_std_)).all()
    assert_array_equal(values(robot), effect.values)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([BaseTilt(), BaseTilt()], "base_tilt on joint 0 twice"),
        ([BaseTilt(joint=1)], "one effect of the whole robot"),
        ([JointZero(7)], "joint"),
        ([TorqueGain(1, gain=-2.0)], "must be positive"),
        ([JointAxis(1, about_x=np.nan)], "must be a finite number"),
    ],
)
def test_invalid_effects_are_refused(effects, message):
    with pytest.raises(ValueError, match=message):
        fit(ARM, effects, NOISY)
