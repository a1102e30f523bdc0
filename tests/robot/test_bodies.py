"""Bodies around their description, against closed forms, quadrature and true robots."""

import warnings

import numpy as np
import pinocchio as pin
import pytest
from scipy import integrate

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.fit import DESCRIBED, BodyPrior, around, little_learned
from sklearn_vbjfa.model import DoubtWarning
from tests.effects._arms import arm, inverse_dynamics, motion
from tests.robot import EXACT

TERMS = ("viscous", "coulomb", "offset", "rotor_inertia")
DT = 0.01


def a_robot(masses=(3.0, 2.0, 1.0)):
    """Arm of three joints whose links are boxes."""
    model, length = pin.Model(), 0.4
    for j, (kind, mass) in enumerate(zip("ZYX", masses)):
        shift = np.zeros(3) if j == 0 else np.array([0.0, 0.1, length])
        joint = getattr(pin, f"JointModelR{kind}")()
        index = model.addJoint(j, joint, pin.SE3(np.eye(3), shift), f"joint_{j + 1}")
        box = pin.Inertia.FromBox(mass, 0.1, 0.15, length)
        centre = pin.SE3(np.eye(3), np.array([0.03, 0.02, 0.5 * length]))
        model.appendBodyToJoint(index, centre.act(box), pin.SE3.Identity())
    return model


def scaled(model, factor, joint=None):
    """Return a description whose bodies, or one, are so many times as heavy."""
    out = model.copy()
    for k in range(model.nv):
        if joint in (None, k):
            vector = factor * model.inertias[k + 1].toDynamicParameters()
            out.inertias[k + 1] = pin.Inertia.FromDynamicParameters(vector)
    return out


def recorded(model, amplitude=1.0):
    """Positions and torques of a true robot, friction and rotors included."""
    _, states = motion(3, duration=30.0, dt=DT, size=1.5 * amplitude, top=1.4)
    q, v, a = np.split(states, 3, axis=1)
    tau = inverse_dynamics(model, states)
    tau += 0.5 * v + 0.8 * np.sign(v) + 0.3 + 0.05 * a
    white = np.random.default_rng(0).standard_normal(tau.shape)
    return q, tau + 0.02 * tau.std(axis=0) * white


def fitted(model, recording, **settings):
    return RobotIdentifier(model, dt=DT, friction=TERMS, **settings).fit(*recording)


def bodies(robot):
    return robot.theta_.reshape(robot.features_.n_joints_, -1)[:, :10]


@pytest.fixture(scope="module")
def recording():
    return recorded(a_robot())


def test_without_torques_a_body_is_as_described():
    own = BodyPrior.of(a_robot(), 14)
    found = around(own, np.zeros((42, 42)), np.zeros(42))
    np.testing.assert_allclose(found.theta[own.indices], own.centre, rtol=1e-12)
    # A half-Cauchy scale up to one has a mean square of its own.
    grid = np.geomspace(1e-4, 1.0, 100001)
    prior = 1.0 / (1.0 + (grid / DESCRIBED) ** 2)
    mean = integrate.trapezoid(prior * grid**2, grid) / integrate.trapezoid(prior, grid)
    size = np.sqrt(mean * (np.linalg.inv(own.root) ** 2).sum(axis=2))
    np.testing.assert_allclose(found.prior_std[own.indices], size, rtol=5e-3)
    assert np.isnan(found.prior_std).sum() == 12
    std = np.sqrt(np.diagonal(found.covariance))
    assert little_learned(std, found.prior_std)[own.indices].all()
    assert not found.departures
    # Nothing tells the friction.
    assert np.isinf(np.diagonal(found.covariance)[10:14]).all()


def test_an_exact_shape_does_not_make_a_mass_exact():
    own, A = BodyPrior.of(a_robot(), 14), np.zeros((42, 42))
    for k, (root, indices) in enumerate(zip(own.root, own.indices)):
        size = root @ own.centre[k] * (k == 0)
        seen = np.eye(10) - np.outer(size, size) / max(size @ size, 1e-9)
        A[np.ix_(indices, indices)] = 1e8 * root.T @ seen @ root
    found = around(own, A, A @ own.vector(42))
    assert np.sqrt(found.covariance[0, 0]) > 0.04 * own.centre[0, 0]


def test_equations_that_contradict_each_other_give_finite_bodies():
    prior, right = BodyPrior.of(a_robot(), 10), np.random.default_rng(1).normal(size=30)
    assert 0.5 < around(prior, 1e-18 * np.eye(30), right).common_size < 2


def test_values_that_the_motion_does_not_tell_apart_are_near_the_truth():
    # A gentle motion: rotor inertia and that of the link beyond it go together.
    gentle = recorded(a_robot(), amplitude=0.15)
    wrong = scaled(a_robot(), 1.15, joint=1)
    away = {}
    for way in ("prior", "free"):
        robot = fitted(wrong, gentle, bodies=way)
        away[way] = np.abs(robot.theta_[13::14] / 0.05 - 1.0).mean()
    assert away["prior"] < 0.5 * away["free"]


@pytest.mark.parametrize("joint", [1, 2])
def test_a_body_that_weighs_ten_times_as_much_is_said_and_the_others_do_not_suffer(
    joint, recording
):
    right = fitted(a_robot(), recording)
    wrong = fitted(scaled(a_robot(), 0.1, joint=joint), recording)
    assert not right.mass_deviations_
    first = wrong.mass_deviations_[0]
    own = first.bodies.index(f"joint_{joint + 1}")
    assert first.log_odds > 3
    assert first.factors[own] > 3
    rotors = [r.theta_.reshape(3, -1)[:, 10:] for r in (right, wrong)]
    np.testing.assert_allclose(*rotors, rtol=0.05, atol=0.01)


def test_a_link_without_inertia_in_the_description_has_a_body(recording):
    missing = a_robot()
    missing.inertias[2] = pin.Inertia.Zero()
    mass = bodies(fitted(missing, recording))[:, 0]
    assert mass[2] == pytest.approx(1.0, abs=0.1)
    assert mass[1] > 0.5


def test_a_counterweight_is_found_on_its_link():
    real, weight = a_robot(), pin.Inertia.FromSphere(3.0, 0.05)
    real.appendBodyToJoint(2, weight, pin.SE3(np.eye(3), np.array([0, 0, -0.3])))
    robot = fitted(a_robot(), recorded(real))
    assert [one.bodies for one in robot.mass_deviations_] == [("joint_2",)]
    mass, std = bodies(robot)[:, 0], robot.theta_std_.reshape(3, -1)[:, 0]
    np.testing.assert_array_less(np.abs(mass - [3.0, 5.0, 1.0])[1:], 3.0 * std[1:])
    assert robot.robot_.known_[14] != "from the description"


@pytest.mark.parametrize("factor", [0.6, 1.5])
def test_a_last_body_that_differs_is_not_another_unit(recording, factor):
    q, tau = recording
    wrong = scaled(a_robot(), factor, joint=2)
    one, unit = fitted(wrong, (q, tau)), fitted(a_robot(), (q, tau / factor))
    np.testing.assert_allclose(bodies(one)[:, 0], [3.0, 2.0, 1.0], rtol=0.1)
    assert one.common_size_ == pytest.approx(1.0, abs=0.05)
    assert unit.common_size_ == pytest.approx(1.0 / factor, rel=0.05)


@pytest.mark.parametrize(
    "bodies", ["prior", pytest.param("fixed", marks=pytest.mark.slow)]
)
def test_a_fit_asks_for_the_unit_of_torques_that_are_too_small(recording, bodies):
    model, (q, tau) = a_robot(), recording
    robot = RobotIdentifier(model, dt=DT, bodies=bodies)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DoubtWarning)
        robot.fit(q, tau)
        robot.fit(q, 0.5 * tau)
        # Said: the masses of the description do not count, or the unit is not known.
        RobotIdentifier(model, dt=DT, bodies="free").fit(q, tau / 9)
        RobotIdentifier(model, dt=DT, gains="unknown").fit(q, tau / 9)
    with pytest.warns(DoubtWarning, match="they are motor currents") as caught:
        robot.fit(q, tau / 9)
    assert caught[0].filename == __file__


def test_fixed_bodies_are_those_of_the_description(recording):
    robot = fitted(a_robot(), recording, bodies="fixed")
    expected = BodyPrior.of(a_robot(), 14).centre
    np.testing.assert_array_equal(bodies(robot), expected)
    np.testing.assert_allclose(robot.theta_.reshape(3, -1)[:, 10], 0.5, rtol=0.05)
    assert robot.from_description_.reshape(3, -1)[:, :10].all()


def test_fixed_bodies_do_not_give_way_to_friction_that_cannot_be(recording):
    q, tau = recording
    model, v = a_robot(), np.gradient(q, DT, axis=0)
    robot = fitted(model, (q, tau - 1.0 * v), bodies="fixed")
    expected = [body.toDynamicParameters() for body in model.inertias[1:]]
    np.testing.assert_allclose(bodies(robot), expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(robot.theta_.reshape(3, -1)[:, 10], 0.0, atol=1e-6)
    raw = robot.theta_unconstrained_.reshape(3, -1)[:, 10]
    np.testing.assert_allclose(raw, -0.5, rtol=0.1)


@pytest.mark.parametrize("way", ["prior", "free", "fixed"])
def test_a_body_without_mass_is_given_none(way):
    model = a_robot()
    model.inertias[1] = pin.Inertia.Zero()
    robot = fitted(model, recorded(model), bodies=way)
    assert not robot.mass_deviations_
    assert 0 < bodies(robot)[0, 0] < 0.01
    assert abs(robot.theta_[13] - 0.05) < max(0.01, 3 * robot.theta_std_[13])
    assert way != "prior" or robot.theta_std_[0] > 0.1


@pytest.mark.parametrize("joint", [1, 2])
def test_a_body_that_the_description_lacks_is_identified(recording, joint):
    robot = fitted(scaled(a_robot(), 0.0, joint), recording, bodies="free")
    change = robot.theta_.reshape(3, -1)[:, 10:] - [0.5, 0.8, 0.3, 0.05]
    assert (np.abs(change) < 3 * robot.theta_std_.reshape(3, -1)[:, 10:]).all()


def test_projection_with_axes_that_are_parallel_within_rounding():
    model, (_, states) = arm("YY"), motion(2, duration=8.0, dt=DT, seed=1, top=0.6)
    for placement in model.jointPlacements:
        placement.rotation = pin.exp3(1e-9 * np.array([1.0, -1.0, 1.0]))
    tau = inverse_dynamics(model, states)
    tau += 0.01 * tau.std(axis=0) * np.random.default_rng(0).normal(size=tau.shape)
    settings = {**EXACT, "projector": "default", "bodies": "free"}
    robot = RobotIdentifier(model, dt=DT, **settings).fit(states, tau)
    assert (robot.residuals(states, tau).normalised_error() < 0.02).all()


def test_a_description_without_masses_leaves_the_bodies_free(recording):
    prior = fitted(scaled(a_robot(), 0.0), recording)
    free = fitted(scaled(a_robot(), 0.0), recording, bodies="free")
    np.testing.assert_array_equal(prior.theta_, free.theta_)
    assert not prior.from_description_.any()


def test_what_cannot_be_is_refused(recording):
    with pytest.raises(ValueError, match="bodies must be one of 'prior', 'free'"):
        fitted(a_robot(), recording, bodies="loose")
