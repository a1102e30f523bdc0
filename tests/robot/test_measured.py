"""Measured robots: known parameters, possible bodies, held-out errors."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.robot import FitOptions
from tests.benchmarks._protocols import protocols

# One bench and one robot are in the quick tests.
QUICK = ("emps", "ur5")
SETS = [
    name if name in QUICK else pytest.param(name, marks=pytest.mark.slow)
    for name in protocols()
    if name != "demo"
]


@pytest.fixture(scope="module")
def evaluate(measured_data_home):
    """Identify a set by its protocol; return the robot and its held-out errors."""
    done = {}

    def run(name, bodies="prior"):
        if (name, bodies) in done:
            return done[name, bodies]
        protocol = protocols()[name]
        try:
            recording = protocol.load(
                data_home=measured_data_home, download_if_missing=False
            )
        except FileNotFoundError as error:
            pytest.skip(str(error))
        train, test = protocol.split(recording)
        assert not set(train) & set(test)
        robot = RobotIdentifier(
            recording.robot_model(),
            dt=recording.dt,
            friction=protocol.friction,
            cutoff=protocol.cutoff,
            options=FitOptions(standstill=protocol.standstill),
            bodies=bodies,
        )
        robot.fit(recording.q[train], recording.tau[train], recording.groups[train])
        # what projector=None would have left
        plain = copy.copy(robot)
        plain.set_parameters(robot.theta_unconstrained_, robot.known_)
        held_out = recording.q[test], recording.tau[test], recording.groups[test]
        ours, unprojected = (
            model.residuals(*held_out).normalised_error() for model in (robot, plain)
        )
        found = SimpleNamespace(robot=robot, error=ours, plain=unprojected)
        done[name, bodies] = found
        return found

    return run


def test_mass_of_the_positioning_system(evaluate):
    # 95.1 kg is the benchmark's own value (least squares with known filters).
    emps = evaluate("emps")
    assert emps.robot.parameter_names_[0] == "slide:m"
    assert emps.robot.theta_[0] == pytest.approx(95.1, rel=0.01)
    viscous, coulomb, _ = emps.robot.theta_[10:13]
    assert viscous > 0
    assert coulomb > 0
    # reached today: 4.4 %
    assert emps.error[0] <= 0.052
    # one sliding mass: its centre and its inertia are not felt
    names = np.array(emps.robot.parameter_names_)
    assert list(names[emps.robot.identifiable_]) == [
        "slide:m",
        "slide:viscous",
        "slide:coulomb",
        "slide:offset",
    ]


@pytest.mark.parametrize("name", SETS)
def test_every_robot_becomes_possible_at_little_cost(evaluate, name):
    ours = evaluate(name)
    assert np.all(ours.robot.min_eigenvalues_ > 0)
    features = ours.robot.features_
    bodies = ours.robot.theta_[: features.n_parameters_]
    bodies = bodies.reshape(features.n_joints_, -1)
    friction = features.parameter_names_[10 : bodies.shape[1]]
    for k, column in enumerate(friction):
        if not column.endswith("offset"):
            assert np.all(bodies[:, 10 + k] >= 0), column
    # The error that consistency adds, in shares of the error that was there: reached
    # today at most 3.8 % (Panda); on KR300, LBR and UR5 consistency lowers the error.
    assert np.nanmean(ours.error) < 1.05 * np.nanmean(ours.plain)
    assert np.isfinite(ours.robot.theta_).all()
    # no parameter that is rounding blown up
    assert np.abs(ours.robot.theta_unconstrained_).max() < 1e6


@pytest.mark.slow
def test_held_out_errors_of_the_ur5(evaluate):
    # The figures that a least-squares fit of the same recordings is known for, in % of
    # each torque's deviation. Reached today: 9.2 8.5 10.2 17.7 14.7 17.6, that is,
    # better on all joints but the third, which is 2.8 % worse. The bound is 4 % above
    # the figures: it guards what is reached and claims no more.
    known = np.array([10.5, 9.2, 9.9, 19.8, 15.1, 18.3])
    error = 100 * evaluate("ur5", "free").error
    np.testing.assert_array_less(error, 1.04 * known)


# Two per cent are aimed at. The torques of the TIAGo are currents in units that differ
# from joint to joint, which no size of all bodies makes up for; a run of the quadruped
# is fifteen seconds of one motion, whose next seconds the free bodies know.
COSTS = {"tiago": 1.10, "unitree_go2": 1.04}


@pytest.mark.parametrize("name", SETS)
def test_a_description_costs_little_torque(evaluate, name):
    prior, free = evaluate(name), evaluate(name, "free")
    most = COSTS.get(name, 1.02)
    assert np.nanmean(prior.error) < most * np.nanmean(free.error)


@pytest.mark.slow
def test_consistency_rescues_what_the_motion_does_not_excite(evaluate):
    # The KR300 is fitted to one motion and tested on another: unconstrained, the
    # directions that the first hardly excites take the second to absurd torques.
    ours = evaluate("kuka_kr300", "free")
    assert np.all(ours.error < 0.25)
    assert ours.plain.max() > 0.5
