"""The identifier finds tilts, zeros, axes and gains of a robot that has them."""

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
    """Torques of a robot with faults, with white noise."""
    exact = measured(model, states, truth, VISCOUS[: model.nv])
    return exact + noise * np.random.default_rng(seed).normal(size=exact.shape)


def idle(truth):
    """Return the same effects with values that correct nothing."""
    return [type(effect)(joint=effect.joint) for effect in truth]


def fit(model, effects, tau, states=STATES, weight=None, groups=None, **given):
    robot = RobotIdentifier(model, effects=effects, **{**EXACT, "dt": DT, **given})
    return robot.fit(states, tau, sample_weight=weight, groups=groups)


def values(robot):
    """Values of the effects in the model, as the instances hold them."""
    found = [e.values for e in robot.effects_ if isinstance(e, InModel)]
    return np.concatenate(found)


def own(robot, parameters):
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
def test_values_are_found_without_noise(case):
    model, truth = FAULTS[case]
    robot = fit(model, idle(truth), torques(model, truth))
    expected = np.concatenate([e.values for e in truth])
    assert_allclose(values(robot), expected, atol=1e-6)
    assert_array_equal(own(robot, robot.theta_), values(robot))
    assert own(robot, robot.identifiable_).all()
    assert [e.name for e in robot.effects_] == [e.name for e in truth]
    # Wherever it moves, the model is the robot that was measured.
    there = torques(model, truth, ELSEWHERE)
    assert_allclose(robot.predict(ELSEWHERE), there, atol=1e-6 * np.abs(there).max())


# -- noise


def literal_regressor(model, effects, states):
    """Regressor matrices (n, nv, 11 nv) of the robot with faults, by Pinocchio."""
    other, shifts, gains = faulty(model, effects)
    q, v, a = np.split(states, 3, axis=1)
    friction = v[:, :, None, None] * np.eye(model.nv)[:, :, None]
    Phi = np.concatenate([by_sample(other, q - shifts, v, a), friction], axis=3)
    return gains[:, None] * Phi.reshape(*Phi.shape[:2], -1)


def literal_least_squares(model, truth, tau, states):
    """Fit bodies and values: values, their standard errors, and the columns there.

    For given values the bodies are found by linear least squares, all joints of equal
    weight; derivatives by the values are differences.
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
    found = optimize.least_squares(residual, start, jac="3-point", **exact)
    theta, made = bodies(found.x), []
    for step in 1e-6 * np.eye(start.size):
        change = columns(found.x + step) @ theta - columns(found.x - step) @ theta
        made.append(change / 2e-6)
    J = np.column_stack([columns(found.x), *made])
    size = np.linalg.norm(J, axis=0)
    size = np.where(size > 1e-10 * size.max(), size, np.inf)
    inverse = np.linalg.pinv(J / size, rcond=1e-8) / size[:, None]
    freedom = tau.size - np.linalg.matrix_rank(J / size, tol=1e-7)
    std = np.sqrt(2 * found.cost / freedom * (inverse**2).sum(axis=1))
    # Columns of rounding alone are none.
    J[:, np.isinf(size)] = 0.0
    return found.x, std[-start.size :], J.reshape(*tau.shape, -1)


def with_values(effects, x):
    out, at = [], 0
    for effect in effects:
        width = len(effect.coefficients)
        out.append(effect.with_values(x[at : at + width]))
        at += width
    return out


@pytest.mark.parametrize(
    "truth",
    [
        [BaseTilt(0, 0.07, -0.1)],
        [JointZero(1, 0.1), TorqueGain(2, 1.3)],
        [JointAxis(1, 0.05, -0.1)],
    ],
)
def test_values_are_those_of_nonlinear_least_squares(truth):
    states = STATES[::2]
    tau = torques(ARM, truth, states, noise=0.2)
    expected, std, columns = literal_least_squares(ARM, truth, tau, states)
    given = {
        "options": FitOptions(standstill=None, joint_weights=None),
        "input_noise": None,
    }
    robot = fit(ARM, idle(truth), tau, states, **given)
    # A value stays within a tenth of its standard error.
    assert np.all(np.abs(values(robot) - expected) < 0.12 * std)
    # Noise in blocks of time varies by chance, and the deviations with it.
    assert_allclose(own(robot, robot.theta_std_), std, rtol=0.5)
    # Without blocks, where there is nothing left to correct, they are the same.
    moments = sum_moments([piece_moments(columns, tau, np.ones_like(tau))])
    found = ModelValues.of(moments, with_values(truth, expected), 33, None)
    assert_allclose(found.std, std, rtol=1e-4)
    assert np.all(np.abs(found.step) < 0.02 * std)
    assert found.converged()


TRUTH = [BaseTilt(0, 0.07, -0.1), TorqueGain(1, 1.3)]
NOISY = torques(ARM, TRUTH, noise=0.2)


# -- what no recording shows, and what is implausible


@pytest.mark.parametrize(
    ("used", "seen"),
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
def test_what_does_not_show_stays_and_has_no_deviation(used, seen):
    tau = torques(ARM, [], noise=0.1)
    robot = fit(ARM, used, tau)
    hidden = np.delete(np.arange(values(robot).size), seen)
    start = np.concatenate([e.values for e in used])
    assert_array_equal(values(robot)[hidden], start[hidden])
    assert np.isnan(own(robot, robot.theta_std_)[hidden]).all()
    assert not own(robot, robot.identifiable_)[hidden].any()
    assert np.isfinite(own(robot, robot.theta_std_)[seen]).all()
    assert own(robot, robot.identifiable_)[seen].all()
    # The torque is as well known as ever.
    there = torques(ARM, [], ELSEWHERE)
    assert np.abs(robot.predict(ELSEWHERE) - there).max() < 0.2


@pytest.mark.parametrize("truth", [JointZero(1, 0.6), TorqueGain(1, 4.0)])
def test_values_that_run_away_stop(truth):
    robot = fit(ARM, idle([truth]), torques(ARM, [truth], noise=0.1))
    low, high = robot.effects_[0].bounds()
    assert np.all((low < values(robot)) & (values(robot) < high))


# -- odd robots


@pytest.mark.parametrize("effect", [BaseTilt(), JointZero(), JointAxis()])
def test_of_one_joint_nothing_shows(effect):
    """What a single body does about its axis, another body does."""
    model = arm("Y")
    _, states = motion(1, duration=6.0, dt=DT, seed=1)
    robot = fit(model, [effect], torques(model, [], states, 0.05), states)
    assert np.isnan(own(robot, robot.theta_std_)).all()
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
def test_what_cannot_be_is_refused(effects, message):
    with pytest.raises(ValueError, match=message):
        fit(ARM, effects, NOISY)
