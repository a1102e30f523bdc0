"""The identifier finds tilts, zeros, axes and gains of a robot that has them."""

import copy
import pickle
import re
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import optimize
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LinearRegression

pin = pytest.importorskip("pinocchio")

from sklearn_vbjfa import RobotIdentifier  # noqa: E402
from sklearn_vbjfa.effects import (  # noqa: E402
    BaseTilt,
    Coulomb,
    Delay,
    JointAxis,
    JointZero,
    Spring,
    TorqueGain,
)
from sklearn_vbjfa.robot import (  # noqa: E402
    ModelValues,
    _fit,
    joint_moments,
)
from tests.effects._arms import arm, inverse_dynamics, motion  # noqa: E402
from tests.effects._faults import faulty, measured  # noqa: E402

DT = 0.02
VISCOUS = np.array([0.8, 0.5, 0.3, 0.4, 0.6, 0.2])
# States as they are, all rows, no filter and no projection.
EXACT = {
    "friction": ("viscous",),
    "projector": None,
    "cutoff": None,
    "standstill": None,
    "dt": DT,
}
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
    robot = RobotIdentifier(model, effects=effects, **{**EXACT, **given})
    return robot.fit(states, tau, sample_weight=weight, groups=groups)


def values(robot):
    """Values of the effects in the model, as the instances hold them."""
    found = [e.values for e in robot.effects_ if e.in_model]
    return np.concatenate(found)


def own(robot, parameters):
    return parameters[robot.features_.n_parameters_ :]


def assert_same(robot, reference, share=0.01):
    """Compare values by their deviations."""
    std = own(reference, reference.theta_std_)
    assert np.all(np.abs(values(robot) - values(reference)) < share * std)


FAULTS = {
    "tilt": (ARM, [BaseTilt(0, 0.07, -0.1)]),
    "large tilt": (ARM, [BaseTilt(0, -0.24, 0.2)]),
    "zero": (ARM, [JointZero(1, 0.15)]),
    "zero of a slide": (SLIDING, [JointZero(1, 0.1)]),
    "axis": (ARM, [JointAxis(1, 0.05, -0.1)]),
    "axis of the last joint": (ARM, [JointAxis(2, 0.1, 0.05)]),
    "axis of a slide": (SLIDING, [JointAxis(1, 0.05, -0.1)]),
    "gain": (ARM, [TorqueGain(1, 1.6)]),
    "gain of a half": (ARM, [TorqueGain(2, 0.5)]),
    "two gains": (ARM, [TorqueGain(0, 2.0), TorqueGain(2, 0.5)]),
    "tilt and zero": (ARM, [BaseTilt(0, 0.07, -0.1), JointZero(1, 0.1)]),
    "axis and zero of one joint": (ARM, [JointZero(1, 0.1), JointAxis(1, 0.05, -0.1)]),
    "gain and zero of one joint": (ARM, [TorqueGain(1, 0.6), JointZero(1, -0.1)]),
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


@pytest.mark.parametrize("case", FAULTS)
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


def test_five_gains_are_found():
    model = arm("ZYYXYZ")
    _, states = motion(6, duration=12.0, dt=DT, seed=3)
    gains = [0.5, 2.0, 0.7, 1.4, 1.1]
    truth = [TorqueGain(j, gain) for j, gain in enumerate(gains)]
    robot = fit(model, idle(truth), torques(model, truth, states), states)
    assert_allclose(values(robot), gains, atol=1e-6)


def test_the_corrected_model_is_the_robot_that_was_measured():
    truth = [BaseTilt(0, 0.07, -0.1), JointZero(1, 0.1), JointAxis(2, 0.05, 0.05)]
    robot = fit(ARM, idle(truth), torques(ARM, truth))
    _, shifts, _ = faulty(ARM, truth)
    corrected = robot.features_.model_
    for i in range(1, 4):
        corrected.inertias[i] = ARM.inertias[i]
    true = ELSEWHERE - np.r_[shifts, np.zeros(6)]
    expected = inverse_dynamics(faulty(ARM, truth)[0], true)
    assert_allclose(inverse_dynamics(corrected, ELSEWHERE), expected, atol=1e-6)


def test_what_a_fit_starts_from_and_what_it_was_given_do_not_matter():
    truth = [JointZero(1, 0.1), TorqueGain(2, 1.3)]
    tau = torques(ARM, truth, noise=0.05)
    given = [JointZero(1, -0.05), TorqueGain(2, 0.9)]
    before = copy.deepcopy([e.get_params() for e in given])
    there = fit(ARM, given, tau)
    here = fit(ARM, idle(truth), tau)
    assert [e.get_params() for e in given] == before
    assert_same(there, here, 0.2)
    assert there.effects_[0] is not given[0]
    # Fitted again from where it arrived nothing moves.
    again = fit(ARM, here.effects_, tau)
    assert_array_equal(values(again), values(here))


# -- noise


@pytest.mark.parametrize(
    "truth",
    [
        [BaseTilt(0, 0.07, -0.1)],
        # Alone as well as beside the gain.
        pytest.param([JointZero(1, 0.1)], marks=pytest.mark.slow),
        [JointAxis(2, 0.05, 0.05)],
        pytest.param([TorqueGain(1, 1.15)], marks=pytest.mark.slow),
        [TorqueGain(2, 0.8), JointZero(1, 0.05)],
    ],
)
def test_values_of_noisy_positions_are_within_their_intervals(truth):
    """By default settings; what the noise leaves is what the deviation says."""
    _, states = motion(3, duration=24.0, dt=DT, seed=2)
    expected = np.concatenate([e.values for e in truth])
    scores = []
    for seed in range(4):
        tau = torques(ARM, truth, states, 0.1, seed)
        rng = np.random.default_rng(100 + seed)
        q = states[:, :3] + 2e-5 * rng.normal(size=(states.shape[0], 3))
        robot = RobotIdentifier(
            ARM, dt=DT, effects=idle(truth), projector=None, friction=("viscous",)
        )
        robot.fit(q, tau)
        scores.append((values(robot) - expected) / own(robot, robot.theta_std_))
    scores = np.abs(scores)
    assert scores.max() < 4.0
    assert 0.2 < np.sqrt(np.mean(scores**2)) < 2.0


def literal_regressor(model, effects, states):
    """Regressor matrices (n, nv, 11 nv) of the robot with faults, by Pinocchio."""
    other, shifts, gains = faulty(model, effects)
    data, nv = other.createData(), model.nv
    Phi = np.zeros((states.shape[0], nv, nv, 11))
    for i, row in enumerate(states - np.r_[shifts, np.zeros(2 * nv)]):
        block = pin.computeJointTorqueRegressor(other, data, *row.reshape(3, nv))
        Phi[i, :, :, :10] = block.reshape(nv, nv, 10)
        Phi[i, range(nv), range(nv), 10] = row[nv : 2 * nv]
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
    given = {"joint_weights": None, "input_noise": None}
    robot = fit(ARM, idle(truth), tau, states, **given)
    # A value stays within a tenth of its standard error.
    assert np.all(np.abs(values(robot) - expected) < 0.12 * std)
    # Noise in blocks of time varies by chance, and the deviations with it.
    assert_allclose(own(robot, robot.theta_std_), std, rtol=0.5)
    # Without blocks, where there is nothing left to correct, they are the same.
    moments = joint_moments(columns, tau, np.ones_like(tau))
    found = ModelValues.of(moments, with_values(truth, expected), 33, None)
    assert_allclose(found.std, std, rtol=1e-4)
    assert np.all(np.abs(found.step) < 0.02 * std)
    assert found.stay()


def test_deviations_allow_for_residuals_correlated_in_time():
    truth = [JointZero(1, 0.1)]
    exact = torques(ARM, truth)
    white = np.random.default_rng(3).normal(size=exact.shape)
    slow = np.apply_along_axis(np.convolve, 0, white, np.ones(20) / np.sqrt(20), "same")
    stds = [
        fit(ARM, idle(truth), exact + 0.1 * noise).theta_std_[-1]
        for noise in (white, slow)
    ]
    assert stds[1] > 1.5 * stds[0]


# -- what must not matter, and what must


TRUTH = [BaseTilt(0, 0.07, -0.1), TorqueGain(1, 1.3)]
NOISY = torques(ARM, TRUTH, noise=0.2)


@pytest.fixture(scope="module")
def reference():
    return fit(ARM, idle(TRUTH), NOISY)


def test_a_weight_of_two_is_a_row_twice():
    rng = np.random.default_rng(0)
    twice = rng.random(T.size) < 0.3
    rows = np.repeat(np.arange(T.size), 1 + twice)
    given = {"joint_weights": None, "input_noise": None, "bodies": "free"}
    weighted = fit(ARM, idle(TRUTH), NOISY, weight=1.0 + twice, **given)
    repeated = fit(ARM, idle(TRUTH), NOISY[rows], STATES[rows], **given)
    plain = fit(ARM, idle(TRUTH), NOISY, **given)
    assert_same(weighted, repeated, 1e-6)
    assert np.abs(values(plain) - values(repeated)).max() > 1e-6
    # A weight of nothing leaves a row out.
    some = fit(ARM, idle(TRUTH), NOISY, weight=1.0 * twice, **given)
    only = fit(ARM, idle(TRUTH), NOISY[twice], STATES[twice], **given)
    assert_same(some, only, 1e-6)


def test_the_order_of_recordings_and_of_effects_does_not_matter(reference):
    half = T.size // 2
    groups = np.repeat([0, 1], [half, T.size - half])
    turned = np.r_[half : T.size, 0:half]
    one = fit(ARM, idle(TRUTH), NOISY, groups=groups)
    other = fit(ARM, idle(TRUTH), NOISY[turned], STATES[turned], groups=groups[turned])
    assert_same(other, one, 1e-3)
    swapped = fit(ARM, idle(TRUTH)[::-1], NOISY)
    assert_allclose(np.roll(values(swapped), -1), values(reference), atol=1e-6)


def test_units_of_torque_do_not_matter_to_values(reference):
    robot = fit(ARM, idle(TRUTH), 1000.0 * NOISY)
    assert_same(robot, reference, 1e-3)
    std = own(reference, reference.theta_std_)
    assert_allclose(own(robot, robot.theta_std_), std, rtol=1e-3)


def test_the_unit_of_one_channel_is_its_gain(reference):
    tau = NOISY.copy()
    tau[:, 1] *= 1.5
    robot = fit(ARM, idle(TRUTH), tau)
    std = own(reference, reference.theta_std_)
    assert_allclose(values(robot)[:2], values(reference)[:2], atol=0.1 * std[0])
    assert_allclose(values(robot)[2], 1.5 * values(reference)[2], atol=0.15 * std[2])
    assert_allclose(own(robot, robot.theta_std_)[2], 1.5 * std[2], rtol=0.01)


def test_the_number_of_jobs_does_not_matter(reference):
    assert_array_equal(fit(ARM, idle(TRUTH), NOISY, n_jobs=2).theta_, reference.theta_)


# -- the model as found


def test_predictions_are_those_of_the_corrected_robot(reference):
    other, shifts, gains = faulty(ARM, reference.effects_)
    bodies = reference.theta_[: reference.features_.n_parameters_].reshape(3, -1)
    data, expected = other.createData(), []
    for row in ELSEWHERE - np.r_[shifts, np.zeros(6)]:
        Phi = pin.computeJointTorqueRegressor(other, data, *row.reshape(3, 3))
        friction = bodies[:, 10] * row[3:6]
        expected.append(gains * (Phi @ bodies[:, :10].ravel() + friction))
    found = reference.predict(ELSEWHERE)
    assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    there = measured(ARM, ELSEWHERE, TRUTH, VISCOUS[:3])
    residuals = reference.residuals(ELSEWHERE, there)
    assert_allclose(residuals.torque - residuals.predicted, there - found, atol=1e-9)
    assert np.abs(there - found).max() < 0.1


def test_parameters_are_named_and_have_units(reference):
    names = reference.parameter_names_[-3:]
    assert names == (
        "base_tilt:roll",
        "base_tilt:pitch",
        "joint_2:torque_gain:gain",
    )
    assert reference.parameter_units_[-3:] == ("rad", "rad", "1")
    assert reference.theta_.size == len(reference.parameter_names_)
    assert_array_equal(reference.theta_unconstrained_[-3:], reference.theta_[-3:])


def test_copies_predict_the_same(reference):
    expected = reference.predict(ELSEWHERE)
    again = pickle.loads(pickle.dumps(reference))
    assert_array_equal(again.predict(ELSEWHERE), expected)
    assert [e.get_params() for e in again.effects_] == [
        e.get_params() for e in reference.effects_
    ]
    fresh = clone(reference)
    assert not hasattr(fresh, "theta_")
    # The effects that were given have the values that they were given with.
    assert [e.values.tolist() for e in fresh.effects] == [[0.0, 0.0], [1.0]]
    assert_array_equal(fresh.fit(STATES, NOISY).predict(ELSEWHERE), expected)


def test_a_second_fit_forgets_the_first():
    robot = fit(ARM, idle(TRUTH), NOISY)
    robot.set_params(effects=())
    robot.fit(STATES, torques(ARM, []))
    assert_allclose(robot.predict(ELSEWHERE), torques(ARM, [], ELSEWHERE), atol=1e-8)
    assert_array_equal(robot.features_.gains_, 1.0)


@pytest.mark.parametrize(
    ("beside", "torque"),
    [
        (Coulomb(1), lambda tau: 2.0 * np.sign(STATES[:, [4]]) * [0, 1, 0]),
        (Spring(0), lambda tau: 8.0 * STATES[:, [0]] * [1, 0, 0]),
        (
            Delay(2, delay=DT),
            lambda tau: np.vstack([0 * tau[:1], tau[:-1] - tau[1:]]) * [0, 0, 1],
        ),
    ],
    ids=["coulomb", "spring", "delay"],
)
def test_other_effects_are_found_beside_them(beside, torque):
    """A channel's gain is on all that passes the channel."""
    truth = [JointZero(1, 0.1), TorqueGain(0, 1.3)]
    plain = measured(ARM, STATES, truth[:1], VISCOUS[:3])
    tau = (plain + torque(plain)) * faulty(ARM, truth)[2]
    robot = fit(ARM, [*idle(truth), beside], tau)
    if isinstance(beside, Delay):
        # Its column is made of the model of the fit before, edges aside.
        assert_allclose(values(robot), [0.1, 1.3], atol=5e-3)
        assert robot.theta_[-1] == pytest.approx(DT, rel=0.05)
        return
    assert_allclose(values(robot), [0.1, 1.3], atol=1e-6)
    assert robot.effects_[-1].get_params() == beside.get_params()
    assert_allclose(robot.predict(STATES), tau, atol=1e-5)
    assert robot.theta_[35] == pytest.approx({1: 2.0, 0: 8.0}[beside.joint], abs=1e-5)


def test_signs_of_standstill_masks_and_filters_do_not_hinder():
    """The whole chain on positions, projected."""
    truth = [BaseTilt(0, 0.07, -0.1)]
    robot = RobotIdentifier(ARM, dt=DT, effects=idle(truth), friction=("viscous",))
    robot.fit(STATES[:, :3], torques(ARM, truth, noise=0.1))
    assert_allclose(values(robot), [0.07, -0.1], atol=5e-3)
    assert robot.min_eigenvalues_.min() >= 0
    assert_array_equal(own(robot, robot.theta_), values(robot))
    there = torques(ARM, truth, ELSEWHERE)
    error = robot.predict(ELSEWHERE) - there
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(there**2))


@pytest.mark.parametrize(
    "given",
    [
        {"regressor": LinearRegression()},
        {"input_noise": None},
        {"joint_weights": [1.0, 2.0, 0.5]},
        {"friction": ("viscous", "coulomb", "offset")},
    ],
    ids=lambda given: next(iter(given)),
)
def test_settings_of_the_fit_do_not_hinder(given):
    """The values come from moments, whatever estimates the bodies."""
    robot = fit(ARM, idle(TRUTH), NOISY, **given)
    std = own(robot, robot.theta_std_)
    expected = np.concatenate([e.values for e in TRUTH])
    assert np.all(np.abs(values(robot) - expected) < 4 * std)
    assert np.all(std < 0.05)
    there = measured(ARM, ELSEWHERE, TRUTH, VISCOUS[:3])
    assert np.abs(robot.predict(ELSEWHERE) - there).max() < 0.02 * np.abs(there).max()


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
def test_what_does_not_show_stays_and_has_no_deviation(used, seen):
    tau = torques(ARM, [], noise=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
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


@pytest.mark.parametrize(
    ("truth", "said"),
    [
        (
            JointZero(1, 0.6),
            r"zero of joint_zero on joint_2 \(0\.259\) reached",
        ),
        (TorqueGain(1, 4.0), r"gain of torque_gain on joint_2 \(2\.4"),
    ],
)
def test_values_that_run_away_stop_and_are_told(truth, said):
    tau = torques(ARM, [truth], noise=0.1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        robot = fit(ARM, idle([truth]), tau)
    (one,) = [w for w in caught if issubclass(w.category, UserWarning)]
    assert re.search(said, str(one.message))
    low, high = robot.effects_[0].bounds()
    assert np.all((low < values(robot)) & (values(robot) < high))


def test_what_has_not_settled_is_told(monkeypatch):
    monkeypatch.setattr("sklearn_vbjfa.robot._fit.MOST_CORRECTIONS", 1)
    truth = [TorqueGain(1, 2.0)]
    with pytest.warns(ConvergenceWarning, match="torque_gain still moved by more than"):
        fit(ARM, idle(truth), torques(ARM, truth, noise=0.1))


def test_a_larger_range_is_given_with_the_gain():
    truth = [TorqueGain(1, 4.0)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot = fit(ARM, [TorqueGain(1, limit=5.0)], torques(ARM, truth, noise=0.1))
    assert values(robot)[0] == pytest.approx(4.0, abs=0.05)
    assert robot.effects_[0].limit == 5.0


# -- odd robots


@pytest.mark.parametrize("effect", [BaseTilt(), JointZero(), JointAxis()])
def test_of_one_joint_nothing_shows(effect):
    """What a single body does about its axis, another body does."""
    model = arm("Y")
    _, states = motion(1, duration=6.0, dt=DT, seed=1)
    robot = fit(model, [effect], torques(model, [], states, 0.05), states)
    assert np.isnan(own(robot, robot.theta_std_)).all()
    assert_array_equal(values(robot), effect.values)


def test_of_one_joint_there_is_no_gain():
    model = arm("Y")
    _, states = motion(1, duration=6.0, dt=DT, seed=1)
    with pytest.raises(ValueError, match="torque_gain on joint 0: the only joint"):
        fit(model, [TorqueGain()], torques(model, [], states), states)


def test_a_description_without_masses_is_enough():
    """The bodies are estimated with the values."""
    truth = [BaseTilt(0, 0.07, -0.1), JointZero(1, 0.1)]
    empty = ARM.copy()
    for i in range(1, 4):
        empty.inertias[i] = pin.Inertia.Zero()
    robot = fit(empty, idle(truth), torques(ARM, truth))
    assert_allclose(values(robot), [0.07, -0.1, 0.1], atol=1e-6)


def test_a_description_without_gravity_has_no_tilt():
    model = arm("ZYX", gravity=0.0)
    with pytest.raises(ValueError, match=r"base_tilt on joint 0: .* has no gravity"):
        fit(model, [BaseTilt()], torques(model, []))
    # What moves shows all the same.
    truth = [JointZero(1, 0.1)]
    robot = fit(model, idle(truth), torques(model, truth))
    assert_allclose(values(robot), [0.1], atol=1e-6)


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


# -- one correction


def moved(effect, step, std):
    """Return what a fit says of one effect."""
    return ModelValues(
        effects=(Coulomb(0), effect),
        places=np.arange(len(step)) + 1,
        step=np.array(step),
        std=np.array(std),
    )


def test_a_correction_stays_within_what_is_plausible():
    start = JointAxis(1, 0.1, 0.0)
    free = moved(start, [0.02, -0.05], [1.0, 1.0]).corrected()[1]
    assert_allclose(free.values, [0.12, -0.05])
    # Nine tenths of the way to the bound, in the direction of the correction.
    _, high = start.bounds()
    short = moved(start, [1.0, -0.5], [1.0, 1.0]).corrected()[1]
    share = 0.9 * (high[0] - 0.1)
    assert_allclose(short.values, [0.1 + share, -0.5 * share])
    # Started outside, a value may come back and not go on.
    outside = JointZero(1, 0.5)
    assert_allclose(moved(outside, [0.1], [1.0]).corrected()[1].values, [0.5])
    assert_allclose(moved(outside, [-0.4], [1.0]).corrected()[1].values, [0.1])


@pytest.mark.parametrize(
    ("value", "step", "std", "stays"),
    [
        (0.1, 0.0009, 0.01, True),
        (0.1, -0.0009, 0.01, True),
        (0.1, 0.0011, 0.01, False),
        (0.1, -0.0011, 0.01, False),
        (0.1, 0.0, np.nan, True),
        (0.1, 1e-14, 1e-15, True),  # rounding
        (0.1, 1e-6, 1e-15, False),
        (0.26, 0.1, 0.01, True),  # at the end, outwards
        (0.26, -0.1, 0.01, False),
        (-0.26, -0.1, 0.01, True),
        (-0.26, 0.1, 0.01, False),
    ],
)
def test_a_value_stays_within_a_tenth_of_its_standard_error(value, step, std, stays):
    assert _fit.STAYS == 0.1
    assert moved(JointZero(1, value), [step], [std]).stay() is stays
