"""Alike joints, against closed forms, quadrature and robots whose truth is known."""

import numpy as np
import pinocchio as pin
import pytest
from scipy import integrate

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.fit import DESCRIBED, SCALES, _shared_drives
from sklearn_vbjfa.robot import FitOptions
from tests.effects._arms import inverse_dynamics, motion

LEGS = ("FL", "FR", "RL", "RR")
TERMS = ("viscous", "coulomb", "offset", "rotor_inertia")
# Viscous and Coulomb friction and rotor inertia of hips and calves.
DRIVES = np.array([[0.3, 0.5, 0.02], [0.2, 0.3, 0.01]])
DT = 0.01


def a_quadruped(legs=LEGS, names="{leg}_{part}_joint", kinds=("RX", "RY")):
    """Robot with legs of two joints, left and right mirrored, whose base is held."""
    model, length = pin.Model(), 0.3
    for leg in legs:
        side = -1.0 if leg.endswith("R") else 1.0
        parent = 0
        for kind, part, mass in zip(kinds, ("hip", "calf"), (1.5, 0.6)):
            shift = [0.0, 0.1 * side, 0.0 if part == "hip" else -length]
            joint = getattr(pin, f"JointModel{kind}")()
            at = pin.SE3(np.eye(3), np.array(shift))
            parent = model.addJoint(parent, joint, at, names.format(leg=leg, part=part))
            box = pin.Inertia.FromBox(mass, 0.06, 0.04, length)
            centre = pin.SE3(np.eye(3), np.array([0.02, 0.015 * side, -0.5 * length]))
            model.appendBodyToJoint(parent, centre.act(box), pin.SE3.Identity())
    return model


def drives(model):
    """Return true values (nv, 3) of the joints, which are those of their kind."""
    return DRIVES[[int("calf" in name) for name in list(model.names)[1:]]]


def recorded(model, true):
    """Positions and torques of a robot with some drives (nv, 3)."""
    _, states = motion(model.nv, dt=DT, size=1.5, top=1.5)
    q, v, a = np.split(states, 3, axis=1)
    tau, rng = inverse_dynamics(model, states), np.random.default_rng([0, 5])
    sign = rng.choice([-1.0, 1.0], model.nv)
    tau += true[:, 0] * v + true[:, 1] * np.sign(v) + 0.1 * sign + true[:, 2] * a
    return q, tau + 0.05 * tau.std(axis=0) * rng.standard_normal(tau.shape)


def fitted(model, recording, alike="auto", **settings):
    settings = {"friction": TERMS, "cutoff": 8.0, **settings}
    options = FitOptions(alike=alike)
    return RobotIdentifier(model, dt=DT, options=options, **settings).fit(*recording)


def found_drives(robot):
    return robot.theta_.reshape(robot.features_.n_joints_, -1)[:, [10, 11, 13]]


def value_of(robot, group, parameter):
    (one,) = [x for x in robot.alike_ if (x.group, x.parameter) == (group, parameter)]
    return one


@pytest.fixture(scope="module")
def model():
    return a_quadruped()


@pytest.fixture(scope="module")
def recording(model):
    return recorded(model, drives(model))


def test_two_values_are_as_near_as_the_integral_over_their_scatter_has_them():
    y, S = np.array([1.2, 0.8]), np.diag([0.02, 0.03])
    problem = _shared_drives._AlikeProblem(y, S, (np.arange(2),))
    mean, covariance = problem.solve(problem.sites())
    grid = np.geomspace(SCALES[0], SCALES[-1], 20001)
    # The difference over the square root of two is normal with the scatter.
    d, v = (y[0] - y[1]) / np.sqrt(2), S.trace() / 2
    density = np.exp(-0.5 * d**2 / (v + grid**2)) / np.sqrt(v + grid**2)
    density /= 1.0 + (grid / DESCRIBED) ** 2
    of_scale = np.array([d * grid**2, v * grid**2]) / (v + grid**2)
    total = integrate.trapezoid(density, grid)
    first = integrate.trapezoid(density * of_scale[0], grid) / total
    second = integrate.trapezoid(density * (of_scale[0] ** 2 + of_scale[1]), grid)
    along = np.array([1.0, -1.0]) / np.sqrt(2)
    assert along @ mean == pytest.approx(first, rel=2e-3)
    variance = second / total - first**2
    assert along @ covariance @ along == pytest.approx(variance, rel=5e-3)


def test_a_drive_that_is_another_one_keeps_its_value(model):
    true = drives(model)
    joint = list(model.names).index("RL_calf_joint") - 1
    true[joint, 2] *= 3.0
    robot = fitted(model, recorded(model, true))
    assert found_drives(robot)[joint, 2] == pytest.approx(0.03, rel=0.15)
    scatter = [value_of(robot, x, "rotor_inertia").scatter for x in ("calf", "hip")]
    assert scatter[0] > 0.4 > 0.2 > scatter[1]


def test_offsets_are_not_shared(model, recording):
    robot = fitted(model, recording)
    offsets = robot.theta_.reshape(8, -1)[:, 12]
    assert np.ptp(offsets) > 0.15
    assert not any("offset" in one.parameter for one in robot.alike_)


def test_the_posterior_has_what_is_shared(model, recording):
    free = fitted(model, recording, alike=None)
    robot = fitted(model, recording)
    own = list(value_of(robot, "calf", "rotor_inertia").indices)
    assert np.all(robot.theta_std_[own] < free.theta_std_[own])
    bodies = robot.estimate_.bodies
    precision, centre = bodies.weighted_prior, bodies.centre
    along = precision[np.ix_(own, own)]
    # The mean is free, the differences are not.
    assert along @ np.ones(4) == pytest.approx(0.0, abs=1e-6 * np.abs(along).max())
    assert np.linalg.eigvalsh(along)[1] > 0
    assert np.ptp(centre[own]) < np.ptp(free.theta_[own])
    # Nothing else is known worse for it.
    assert np.all(robot.theta_std_ <= (1 + 1e-9) * free.theta_std_)


def groups_of(model, alike="auto", **settings):
    robot = RobotIdentifier(
        model, dt=DT, options=FitOptions(alike=alike), **settings
    ).build_model()
    return dict(robot._shared_drives)


def test_names_and_bodies_make_a_group():
    assert groups_of(a_quadruped()) == {"hip": (0, 2, 4, 6), "calf": (1, 3, 5, 7)}
    numbered = a_quadruped(("1", "2"), "leg{leg}_{part}")
    assert groups_of(numbered) == {"leg hip": (0, 2), "leg calf": (1, 3)}
    camel = a_quadruped(("Left", "Right"), "{leg}{part}")
    assert set(groups_of(camel)) == set()
    heavy = a_quadruped()
    heavy.inertias[1].mass *= 1.01
    assert groups_of(heavy)["hip"] == (2, 4, 6)


def test_joints_of_one_chain_are_no_group():
    model = a_quadruped(("L",), kinds=("RX", "RX"))
    for k in (1, 2):
        model.names[k] = f"joint_{k}"
        model.inertias[k] = model.inertias[1]
    assert groups_of(model) == {}


def test_sharing_may_be_left_out_and_nothing_else_is_taken():
    assert groups_of(a_quadruped(), None) == {}
    with pytest.raises(ValueError, match="alike must be 'auto' or None; got 'hip'"):
        groups_of(a_quadruped(), "hip")


def values(rng, n=4, noise=0.1, factor=1.0):
    """Draw values of alike joints and what is known of them."""
    scatter = np.abs(0.1 * rng.standard_normal())
    x = 1.0 + scatter * rng.standard_normal(n)
    x[0] *= factor
    S = np.diag(noise**2 * np.exp(0.5 * rng.standard_normal(n)))
    y = rng.multivariate_normal(x, S)
    inverse = np.linalg.inv(S)
    unit = np.sqrt((inverse.sum(axis=0) @ y / inverse.sum()) ** 2 + 1 / inverse.sum())
    problem = _shared_drives._AlikeProblem(y / unit, S / unit**2, (np.arange(n),))
    mean, covariance = problem.solve(problem.sites())
    std = unit * np.sqrt(np.diagonal(covariance))
    return x, y, unit * mean, std


def test_intervals_hold_the_truth():
    rng = np.random.default_rng(0)
    drawn = [values(rng) for _ in range(150)]
    x, y, mean, std = (np.array([d[k] for d in drawn]) for k in range(4))
    assert 0.86 < (np.abs(mean - x) < 1.645 * std).mean() < 0.94
    assert ((mean - x) ** 2).mean() < 0.8 * ((y - x) ** 2).mean()
