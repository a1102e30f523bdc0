"""The whole chain on a simulated arm, whose truth is known."""

import numpy as np
import pinocchio as pin
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.equations import _equations
from sklearn_vbjfa.equations._plan import resolve_standstill
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
    """Mean squared error over the torque's variance, joint by joint."""
    return np.mean((robot.predict(X) - torque) ** 2, axis=0) / torque.var(axis=0)


# -- recovery


def test_predicts_another_motion_and_is_a_possible_robot(identified, new_motion):
    # Some 850 filtered equations a joint for 12 parameters each, 5 % of torque noise
    # of which the filter passes a tenth of the band: 0.05^2 / 10 * 12 / 850 = 4e-6
    # and a few times that, since the motions differ.
    error = squared_error(identified, new_motion.states, new_motion.tau_clean)
    assert np.all(error < 1e-4)
    assert np.all(identified.min_eigenvalues_ > 0)
    assert np.all(identified.theta_.reshape(6, 12)[:, 10:] >= 0)


def test_one_body_alone_does_not_set_the_size_of_all():
    # Its hand is heard best, and its mass is another way than described.
    recording = make_robot_recording(duration=20, random_state=3)
    robot = identify(recording)
    assert robot.common_size_ == pytest.approx(1.0, abs=0.3)
    masses = robot.theta_.reshape(6, 12)[:, 0] / recording.inertial[:, 0]
    assert (np.abs(np.log(masses)) < 0.5).all()


def test_noiseless_states_and_torques_give_the_torque_exactly(simulated, new_motion):
    robot = RobotIdentifier(
        simulated.urdf, friction=FRICTION, options=FitOptions(standstill=None)
    )
    robot.fit(simulated.states, simulated.tau_clean, groups=simulated.groups)
    # relevance determination may drop what explains less than about 1e-5
    error = squared_error(robot, new_motion.states, new_motion.tau_clean)
    assert np.all(error < 1e-9)
    plain = robot.set_params(projector=None, regressor=LinearRegression())
    plain.fit(simulated.states, simulated.tau_clean, groups=simulated.groups)
    error = squared_error(plain, new_motion.states, new_motion.tau_clean)
    assert np.all(error < 1e-18)


def test_groups_of_a_query_are_kept_apart(identified, simulated):
    parts = [simulated.q[simulated.groups == k][:500] for k in (0, 1)]
    groups = np.repeat([0, 1], 500)
    together = identified.predict(np.concatenate(parts), groups=groups)
    blind = identified.predict(np.concatenate(parts))
    apart = np.concatenate([identified.predict(part) for part in parts])
    # the cut-offs are those of the fit in both, so nothing else differs
    np.testing.assert_allclose(together, apart, rtol=1e-8, atol=1e-8)
    assert np.abs(blind - apart)[495:505].max() > 1.0


# -- what the data determine


def test_identifiable_is_what_random_motions_determine(identified, simulated):
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
    # Columns that are zero but for rounding count for nothing.
    seen = size > 1e-10 * size.max()
    _, values, directions = np.linalg.svd(rows[:, seen] / size[seen])
    null = directions[np.sum(values > 1e-10 * values[0]) :]
    expected = np.zeros(72, dtype=bool)
    expected[seen] = np.sum(null**2, axis=0) < 1e-12
    np.testing.assert_array_equal(identified.identifiable_, expected)
    # 36 base parameters of a six-axis arm (the first axis vertical) and 12 of friction
    assert np.sum(values > 1e-10 * values[0]) == 36 + 12


def test_what_no_torque_depends_on_comes_from_the_model(identified, simulated):
    # The first body turns about a vertical axis: of its ten only I_zz is felt.
    nominal = nominal_parameters(load_model(simulated.urdf))[0]
    first = identified.theta_[:10]
    assert np.all(identified.from_description_[:9])
    free = identify(simulated, bodies="free")
    assert np.all(np.isinf(free.theta_std_[:9]))
    # the anchor is the model scaled as a whole, and consistency holds it together
    np.testing.assert_allclose(first[0] / nominal[0], 1.0, atol=0.6)
    # and rounding alone never passes for information
    assert np.abs(identified.theta_unconstrained_).max() < 100
    weighed = np.diagonal(identified.estimate_.metric)[:9]
    np.testing.assert_array_equal(weighed, 0.0)


@pytest.mark.parametrize("factor", [1e6, 1e-6])
def test_torques_in_another_unit_are_the_robot_in_that_unit(
    identified, simulated, new_motion, factor
):
    other = identify(simulated, factor * simulated.tau)
    unit = np.abs(identified.theta_.reshape(6, 12)).max(axis=0)
    unit = np.maximum(unit, 1e-12)
    for name, rtol in (("theta_unconstrained_", 1e-8), ("theta_", 1e-4)):
        got = getattr(other, name).reshape(6, 12) / factor / unit
        expected = getattr(identified, name).reshape(6, 12) / unit
        np.testing.assert_allclose(got, expected, rtol=0, atol=rtol)
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


@pytest.mark.parametrize(("times", "cutoff"), [(5, 5.0), (10, 3.0)])
def test_slow_motion_is_filtered_at_the_lowest_cutoff(simulated, times, cutoff):
    # The same positions at a lower rate are slower.
    slow = identify(simulated, dt=times * simulated.dt)
    assert slow.state_estimator_.bandwidth_.max() < 0.6
    assert slow.cutoff_ == pytest.approx(cutoff)


def test_automatic_standstill_is_two_per_cent_of_the_speed(identified, simulated):
    speed = np.abs(simulated.states[:, 6:12])
    fast = np.quantile(speed, 0.995, axis=0)
    np.testing.assert_allclose(identified.standstill_, 0.02 * fast, rtol=0.02)


def test_a_joint_whose_speed_is_rounding_stands_still():
    fast = np.array([3.0, 1e-30])
    assert (resolve_standstill("auto", fast) > fast).tolist() == [False, True]


@pytest.mark.parametrize("noise", [1e-5, 1e-3])
def test_noise_of_a_joint_at_rest_is_no_motion(simulated, noise):
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
def test_standing_samples_are_left_out(simulated, cutoff):
    # While a joint stands, stiction holds: its torque may be anything.
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
    # what is left is exact; the projection of exact parameters moves them by rounding
    assert np.all(masked.normalised_error() < 1e-5)
    everything = (
        clone(robot)
        .set_params(options=FitOptions(standstill=None))
        .fit(states, tau, groups=groups)
    )
    np.testing.assert_array_equal(everything.standstill_, -1.0)
    np.testing.assert_array_less(
        robot.estimate_.moments.n_rows, everything.estimate_.moments.n_rows
    )
    spoiled = everything.residuals(simulated.states, simulated.tau_clean)
    assert spoiled.normalised_error().max() > 0.01


# -- residuals


def test_residuals_are_filtered_torques_against_filtered_predictions(
    identified, simulated
):
    found = identified.residuals(simulated.q, simulated.tau, groups=simulated.groups)
    lowpass = identified.robot_.plan.lowpass
    states = identified.state_estimator_.transform(simulated.q, groups=simulated.groups)
    at = found.index[100]
    window = slice(at - lowpass.half, at + lowpass.half + 1)
    np.testing.assert_allclose(
        found.torque[100], lowpass.taps @ simulated.tau[window], rtol=1e-10
    )
    np.testing.assert_allclose(
        found.predicted[100],
        lowpass.taps @ identified.predict(states[window]),
        rtol=1e-8,
    )
    np.testing.assert_array_equal(found.residual, found.torque - found.predicted)
    # 5 % of white torque noise of which 2 * 5.1 Hz of 100 Hz pass
    expected = simulated.torque_noise * np.sqrt(2 * identified.cutoff_ * simulated.dt)
    np.testing.assert_allclose(found.rms(), expected, rtol=0.25)
    squares = found.residual[:, 3] ** 2 * found.weight[:, 3]
    rms = np.sqrt(squares.sum() / found.weight[:, 3].sum())
    assert found.rms()[3] == pytest.approx(rms)
    mean = np.average(found.torque[:, 3], weights=found.weight[:, 3])
    spread = np.average((found.torque[:, 3] - mean) ** 2, weights=found.weight[:, 3])
    assert found.normalised_error()[3] == pytest.approx(rms / np.sqrt(spread))


@pytest.mark.parametrize("encoder_noise", [1e-4, 1e-3])
def test_noise_floor_is_what_noise_alone_leaves(encoder_noise):
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
        robot.torque_noise_,
        recording.torque_noise * np.sqrt(taps @ taps),
        rtol=0.15,
    )
    found = robot.residuals(recording.q, recording.tau, groups=recording.groups)
    # Coulomb friction at reversals is not in the floor, parameters fitted to it are.
    np.testing.assert_allclose(found.rms() / robot.noise_floor_, 1.0, atol=0.2)
    # the same without the inputs' share, which is that of the encoders alone
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


def test_one_joint_takes_a_flat_torque():
    from tests.model._robots import swing

    recording = make_robot_recording(swing(), duration=10.0, dt=0.01, random_state=0)
    robot = RobotIdentifier(swing(), dt=0.01, friction=FRICTION)
    robot.fit(recording.q, recording.tau[:, 0])
    column = clone(robot).fit(recording.q, recording.tau)
    np.testing.assert_array_equal(robot.theta_, column.theta_)
    assert np.all(robot.min_eigenvalues_ > 0)


# -- noise


def test_noise_of_encoders_is_what_exact_torques_leave():
    # A wheel of inertia 0.5 and viscous friction: tau = 0.5 a + 0.2 v.
    dt, t = 0.005, 0.005 * np.arange(8000)
    w = 2 * np.pi * np.array([0.7, 1.9])
    q = np.sin(np.outer(t, w)).sum(axis=1)
    tau = 0.2 * np.cos(np.outer(t, w)) @ w - 0.5 * np.sin(np.outer(t, w)) @ w**2
    read = q + 1e-4 * np.random.default_rng(0).normal(size=q.size)
    robot = RobotIdentifier(wheel().model, dt=dt).fit(read[:, None], tau[:, None])
    left = robot.residuals(read[:, None], tau[:, None]).rms()
    # Accelerations are wrong by what the smoother lets through of the encoders' noise.
    np.testing.assert_allclose(robot.estimate_.noise()[0], left, rtol=0.15)
    assert robot.output_noise_[0] < 0.6 * left[0]


def test_torque_noise_is_what_passes_the_low_pass(simulated):
    # White noise up to the cut-off, but for the slope of the filter.
    cutoff, noise = 5.0, np.linspace(0.1, 0.6, 6)
    options = FitOptions(torque_noise=noise)
    robot = identify(simulated, cutoff=cutoff, options=options)
    expected = noise * np.sqrt(2 * cutoff * simulated.dt)
    np.testing.assert_allclose(robot.torque_noise_, expected, rtol=0.06)


def test_bodies_of_fewer_rows_are_nearly_those_of_all(monkeypatch):
    recording = make_robot_recording(duration=20.0, dt=0.002, random_state=0)
    robot = RobotIdentifier(recording.robot_model(), dt=recording.dt)
    every = clone(robot).fit(recording.q, recording.tau)
    monkeypatch.setattr(_equations, "_MANY_ROWS", 1000)
    fewer = clone(robot).fit(recording.q, recording.tau)
    told = every.theta_std_ > 0
    away = np.abs(fewer.theta_ - every.theta_)[told] / every.theta_std_[told]
    assert 0 < away.max() < 0.5
    one, other = (
        known.residuals(recording.q, recording.tau).predicted
        for known in (fewer, every)
    )
    assert (np.abs(one - other).max(axis=0) < 2e-3 * other.std(axis=0)).all()
