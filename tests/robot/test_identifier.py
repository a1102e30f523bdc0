"""RobotIdentifier on a simulated arm with known parameters."""

import numpy as np
import pinocchio as pin
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.equations import _equations
from sklearn_vbjfa.equations._motion_facts import resolve_standstill
from sklearn_vbjfa.model import load_model, nominal_parameters
from sklearn_vbjfa.robot import FitOptions
from tests.effects._arms import inverse_dynamics
from tests.simulation._machines import wheel

FRICTION = ("viscous", "coulomb")


def identify(recording, torque=None, **settings):
    settings = {"dt": recording.dt, "friction": FRICTION, **settings}
    robot = RobotIdentifier(recording.urdf, **settings)
    return robot.fit(
        recording.q,
        recording.tau if torque is None else torque,
        groups=recording.groups,
    )


def squared_error(robot, X, torque):
    """Return the mean squared error over the torque's variance per joint."""
    return np.mean((robot.predict(X) - torque) ** 2, axis=0) / torque.var(axis=0)


# -- recovery


def test_predictions_generalise_and_bodies_are_consistent(identified, new_motion):
    # About 850 filtered equations per joint for 12 parameters; the filter passes a
    # tenth of the band of 5 % torque noise: 0.05^2 / 10 * 12 / 850 = 4e-6, and a few
    # times that because the motions differ.
    error = squared_error(identified, new_motion.states, new_motion.tau_clean)
    assert np.all(error < 1e-4)
    assert np.all(identified.min_eigenvalues_ > 0)
    assert np.all(identified.theta_.reshape(6, 12)[:, 10:] >= 0)


def test_common_scale_is_not_set_by_a_single_body():
    # The last body has the strongest signal, and its mass deviates most.
    recording = make_robot_recording(duration=20, random_state=3)
    robot = identify(recording)
    assert robot.common_size_ == pytest.approx(1.0, abs=0.3)
    masses = robot.theta_.reshape(6, 12)[:, 0] / recording.inertial[:, 0]
    assert (np.abs(np.log(masses)) < 0.5).all()


def test_fit_is_exact_without_noise(simulated, new_motion):
    robot = RobotIdentifier(
        simulated.urdf, friction=FRICTION, options=FitOptions(standstill=None)
    )
    robot.fit(simulated.states, simulated.tau_clean, groups=simulated.groups)
    # Relevance determination may drop columns that explain less than about 1e-5.
    error = squared_error(robot, new_motion.states, new_motion.tau_clean)
    assert np.all(error < 1e-9)
    plain = robot.set_params(projector=None, regressor=LinearRegression())
    plain.fit(simulated.states, simulated.tau_clean, groups=simulated.groups)
    error = squared_error(plain, new_motion.states, new_motion.tau_clean)
    assert np.all(error < 1e-18)


def test_predict_filters_groups_separately(identified, simulated):
    parts = [simulated.q[simulated.groups == k][:500] for k in (0, 1)]
    groups = np.repeat([0, 1], 500)
    together = identified.predict(np.concatenate(parts), groups=groups)
    blind = identified.predict(np.concatenate(parts))
    apart = np.concatenate([identified.predict(part) for part in parts])
    # Both use the cut-offs of the fit, so only the grouping differs.
    np.testing.assert_allclose(together, apart, rtol=1e-8, atol=1e-8)
    assert np.abs(blind - apart)[495:505].max() > 1.0


# -- identifiability


def test_identifiable_matches_random_excitation(identified, simulated):
    model = load_model(simulated.urdf)
    data = model.createData()
    rng = np.random.default_rng(3)
    rows = []
    for _ in range(200):
        q, v, a = rng.normal(size=(3, 6))
        inertial = pin.computeJointTorqueRegressor(model, data, q, v, a)
        block = np.zeros((6, 6, 12))
        block[:, :, :10] = inertial.reshape(6, 6, 10)
        block[range(6), range(6), 10] = v
        block[range(6), range(6), 11] = np.sign(v)
        rows.append(block.reshape(6, 72))
    rows = np.concatenate(rows)
    size = np.linalg.norm(rows, axis=0)
    # Columns of rounding errors count as zero.
    nonzero = size > 1e-10 * size.max()
    _, values, directions = np.linalg.svd(rows[:, nonzero] / size[nonzero])
    null = directions[np.sum(values > 1e-10 * values[0]) :]
    expected = np.zeros(72, dtype=bool)
    expected[nonzero] = np.sum(null**2, axis=0) < 1e-12
    np.testing.assert_array_equal(identified.identifiable_, expected)
    # 36 base parameters of a six-axis arm (the first axis vertical) and 12 of friction
    assert np.sum(values > 1e-10 * values[0]) == 36 + 12


def test_parameters_without_effect_come_from_the_model(identified, simulated):
    # The first axis is vertical: only I_zz of its body affects the torque.
    nominal = nominal_parameters(load_model(simulated.urdf))[0]
    first = identified.theta_[:10]
    assert np.all(identified.from_description_[:9])
    free = identify(simulated, bodies="free")
    assert np.all(np.isinf(free.theta_std_[:9]))
    # The prior is the scaled model, and consistency keeps it close.
    np.testing.assert_allclose(first[0] / nominal[0], 1.0, atol=0.6)
    # Rounding errors are not taken for information.
    assert np.abs(identified.theta_unconstrained_).max() < 100
    weighed = np.diagonal(identified.estimate_.metric)[:9]
    np.testing.assert_array_equal(weighed, 0.0)


@pytest.mark.parametrize("factor", [1e6, 1e-6])
def test_parameters_scale_with_the_torque_unit(
    identified, simulated, new_motion, factor
):
    other = identify(simulated, factor * simulated.tau)
    unit = np.abs(identified.theta_.reshape(6, 12)).max(axis=0)
    unit = np.maximum(unit, 1e-12)
    for name, rtol in (("theta_unconstrained_", 1e-8), ("theta_", 1e-4)):
        actual = getattr(other, name).reshape(6, 12) / factor / unit
        expected = getattr(identified, name).reshape(6, 12) / unit
        np.testing.assert_allclose(actual, expected, rtol=0, atol=rtol)
    np.testing.assert_allclose(
        other.predict(new_motion.states) / factor,
        identified.predict(new_motion.states),
        rtol=0,
        atol=1e-6 * new_motion.tau_clean.std(),
    )
    np.testing.assert_array_equal(other.identifiable_, identified.identifiable_)


def test_order_and_names_of_recordings_do_not_matter(identified, simulated):
    order = np.argsort(-simulated.groups, kind="stable")
    names = np.where(simulated.groups[order] == 1, "late", "early")
    robot = clone(identified)
    robot.fit(simulated.q[order], simulated.tau[order], groups=names)
    np.testing.assert_allclose(robot.theta_, identified.theta_, rtol=1e-6, atol=1e-8)
    assert robot.cutoff_ == pytest.approx(identified.cutoff_, rel=1e-12)


# -- settings


def test_automatic_cutoff_is_five_bandwidths(identified):
    bandwidth = identified.state_estimator_.bandwidth_.max()
    assert 0.8 < bandwidth < 1.2  # the motion goes up to 1 Hz
    assert identified.cutoff_ == pytest.approx(5 * bandwidth)


@pytest.mark.parametrize(("times", "cutoff"), [(5, 5.0), (10, 2.5)])
def test_slow_motion_is_filtered_at_the_lowest_cutoff(simulated, times, cutoff):
    # The same positions at a lower sampling rate are a slower motion.
    slow = identify(simulated, dt=times * simulated.dt)
    assert slow.state_estimator_.bandwidth_.max() < 0.6
    assert slow.cutoff_ == pytest.approx(cutoff)


def test_automatic_standstill_is_two_per_cent_of_the_speed(identified, simulated):
    speed = np.abs(simulated.states[:, 6:12])
    fast = np.quantile(speed, 0.995, axis=0)
    np.testing.assert_allclose(identified.standstill_, 0.02 * fast, rtol=0.02)


def test_speeds_of_rounding_errors_count_as_standstill():
    fast = np.array([3.0, 1e-30])
    assert (resolve_standstill("auto", fast) > fast).tolist() == [False, True]


@pytest.mark.parametrize("noise", [1e-5, 1e-3])
def test_encoder_noise_at_rest_is_not_motion(simulated, noise):
    model, rng = load_model(simulated.urdf), np.random.default_rng(0)
    states = np.array(simulated.states)
    states[:, [2, 8, 14]] = 0.3, 0.0, 0.0
    tau = inverse_dynamics(model, states)
    q = states[:, :6] + noise * rng.standard_normal(tau.shape)
    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt, friction=FRICTION)
    robot.fit(q, tau, groups=simulated.groups)
    assert np.all(robot.theta_.reshape(6, 12)[2, 10:] < 1e-5)
    others = np.arange(6) != 2
    assert np.all(squared_error(robot, states, tau)[others] < 1e-3)


@pytest.mark.parametrize("cutoff", [None, 10.0])
def test_standstill_samples_are_excluded(simulated, cutoff):
    # During standstill, stiction makes the torque arbitrary.
    rest = np.zeros((300, 18))
    rest[:, :6] = simulated.states[0, :6]
    states = np.concatenate([simulated.states, rest])
    tau = np.concatenate(
        [simulated.tau_clean, np.linspace(0, 40, 300 * 6).reshape(-1, 6)]
    )
    groups = np.append(simulated.groups, np.full(300, 2))
    settings = {"dt": simulated.dt, "friction": FRICTION, "cutoff": cutoff}
    robot = RobotIdentifier(simulated.urdf, regressor=LinearRegression(), **settings)
    masked = robot.fit(states, tau, groups=groups).residuals(states, tau, groups=groups)
    standing = masked.index >= 3200
    assert standing.sum() > 50
    np.testing.assert_array_equal(masked.weight[standing], 0.0)
    # The remaining rows are exact; projection changes exact parameters by rounding.
    assert np.all(masked.normalised_error() < 1e-5)
    unmasked = (
        clone(robot)
        .set_params(options=FitOptions(standstill=None))
        .fit(states, tau, groups=groups)
    )
    np.testing.assert_array_equal(unmasked.standstill_, -1.0)
    np.testing.assert_array_less(
        robot.estimate_.moments.n_rows, unmasked.estimate_.moments.n_rows
    )
    corrupted = unmasked.residuals(simulated.states, simulated.tau_clean)
    assert corrupted.normalised_error().max() > 0.01


# -- residuals


def test_residuals_compare_filtered_torques_and_predictions(identified, simulated):
    errors = identified.residuals(simulated.q, simulated.tau, groups=simulated.groups)
    lowpass = identified.robot_.plan.lowpass
    states = identified.state_estimator_.transform(simulated.q, groups=simulated.groups)
    row = errors.index[100]
    window = slice(row - lowpass.half, row + lowpass.half + 1)
    np.testing.assert_allclose(
        errors.torque[100], lowpass.taps @ simulated.tau[window], rtol=1e-10
    )
    np.testing.assert_allclose(
        errors.predicted[100],
        lowpass.taps @ identified.predict(states[window]),
        rtol=1e-8,
    )
    np.testing.assert_array_equal(errors.residual, errors.torque - errors.predicted)
    # 5 % white torque noise, of which 2 * 5.1 Hz of 100 Hz pass.
    expected = simulated.torque_noise * np.sqrt(2 * identified.cutoff_ * simulated.dt)
    np.testing.assert_allclose(errors.rms(), expected, rtol=0.25)
    squares = errors.residual[:, 3] ** 2 * errors.weight[:, 3]
    rms = np.sqrt(squares.sum() / errors.weight[:, 3].sum())
    assert errors.rms()[3] == pytest.approx(rms)
    mean = np.average(errors.torque[:, 3], weights=errors.weight[:, 3])
    power = np.average((errors.torque[:, 3] - mean) ** 2, weights=errors.weight[:, 3])
    assert errors.normalised_error()[3] == pytest.approx(rms / np.sqrt(power))


@pytest.mark.parametrize("encoder_noise", [1e-4, 1e-3])
def test_noise_floor_matches_the_residual_of_noise_alone(encoder_noise):
    recording = make_robot_recording(
        duration=16.0,
        dt=0.01,
        frequency=1.0,
        n_recordings=2,
        encoder_noise=encoder_noise,
        random_state=1,
    )
    robot = identify(recording)
    taps = robot.robot_.plan.lowpass.taps
    # The quietest quarter of 16 bands of a spectrum, each of some 100 ordinates.
    np.testing.assert_allclose(
        robot.torque_noise_, recording.torque_noise * np.sqrt(taps @ taps), rtol=0.15
    )
    residuals = robot.residuals(recording.q, recording.tau, groups=recording.groups)
    # The floor omits Coulomb friction at reversals and includes parameter errors.
    np.testing.assert_allclose(residuals.rms() / robot.noise_floor_, 1.0, atol=0.2)
    # Without input noise, only the torque noise remains.
    exact = identify(recording, input_noise=None)
    np.testing.assert_array_equal(exact.estimate_.noise()[0], 0.0)
    np.testing.assert_allclose(exact.noise_floor_, exact.torque_noise_, rtol=1e-12)
    assert (robot.noise_floor_ > robot.torque_noise_).all()
    np.testing.assert_allclose(
        robot.noise_floor_**2,
        robot.torque_noise_**2 + robot.estimate_.noise()[0] ** 2,
        rtol=1e-12,
    )


# -- robots of other kinds


def test_single_joint_accepts_one_dimensional_torque():
    from tests.model._robots import swing

    recording = make_robot_recording(swing(), duration=10.0, dt=0.01, random_state=0)
    robot = RobotIdentifier(swing(), dt=0.01, friction=FRICTION)
    robot.fit(recording.q, recording.tau[:, 0])
    column = clone(robot).fit(recording.q, recording.tau)
    np.testing.assert_array_equal(robot.theta_, column.theta_)
    assert np.all(robot.min_eigenvalues_ > 0)


# -- noise


def test_input_noise_matches_the_residual_of_exact_torques():
    # A wheel of inertia 0.5 and viscous friction: tau = 0.5 a + 0.2 v.
    dt, t = 0.005, 0.005 * np.arange(8000)
    w = 2 * np.pi * np.array([0.7, 1.9])
    q = np.sin(np.outer(t, w)).sum(axis=1)
    tau = 0.2 * np.cos(np.outer(t, w)) @ w - 0.5 * np.sin(np.outer(t, w)) @ w**2
    encoder = q + 1e-4 * np.random.default_rng(0).normal(size=q.size)
    robot = RobotIdentifier(wheel().model, dt=dt).fit(encoder[:, None], tau[:, None])
    residual = robot.residuals(encoder[:, None], tau[:, None]).rms()
    # The residual is the encoder noise in the accelerations that passes the smoother.
    np.testing.assert_allclose(robot.estimate_.noise()[0], residual, rtol=0.15)
    assert robot.output_noise_[0] < 0.6 * residual[0]


def test_torque_noise_is_scaled_by_the_low_pass(simulated):
    # White noise up to the cut-off, except for the filter's finite slope.
    cutoff, noise = 5.0, np.linspace(0.1, 0.6, 6)
    options = FitOptions(torque_noise=noise)
    robot = identify(simulated, cutoff=cutoff, options=options)
    expected = noise * np.sqrt(2 * cutoff * simulated.dt)
    np.testing.assert_allclose(robot.torque_noise_, expected, rtol=0.06)


def test_subsampled_rows_give_nearly_the_same_fit(monkeypatch):
    recording = make_robot_recording(duration=20.0, dt=0.002, random_state=0)
    robot = RobotIdentifier(recording.robot_model(), dt=recording.dt)
    every = clone(robot).fit(recording.q, recording.tau)
    monkeypatch.setattr(_equations, "_MANY_ROWS", 1000)
    fewer = clone(robot).fit(recording.q, recording.tau)
    fitted = every.theta_std_ > 0
    change = np.abs(fewer.theta_ - every.theta_)[fitted] / every.theta_std_[fitted]
    assert 0 < change.max() < 0.5
    subset, full = (
        model.residuals(recording.q, recording.tau).predicted
        for model in (fewer, every)
    )
    assert (np.abs(subset - full).max(axis=0) < 2e-3 * full.std(axis=0)).all()
