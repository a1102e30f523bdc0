"""Known masses fix the gain that all torque channels have in common."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.effects import Payload
from sklearn_vbjfa.robot import FitOptions
from tests.effects._arms import arm, inverse_dynamics, motion
from tests.robot import EXACT

DT = 0.02
ARM = arm("ZYX")
GAINS = np.array([8.0, 5.0, 12.0])
T, STATES = motion(3, duration=20.0, dt=DT, seed=4)
PICKED = 10.0
MASS, CENTRE = 1.5, np.array([0.02, 0.0, 0.1])


def with_ball(model, mass=MASS):
    """Return an arm that carries a point mass, which has no inertia of its own."""
    loaded = model.copy()
    ball = pin.Inertia(mass, CENTRE, np.zeros((3, 3)))
    loaded.inertias[model.nv] = loaded.inertias[model.nv] + ball
    return loaded


def recorded(model=ARM, gains=GAINS, payload=MASS, noise=0.01, seed=0, states=STATES):
    """Compute what channels read while a ball is picked up halfway."""
    exact = inverse_dynamics(model, states)
    if payload:
        after = (T >= PICKED)[:, None]
        loaded = inverse_dynamics(with_ball(model, payload), states)
        exact = np.where(after, loaded, exact)
    exact = exact * gains
    white = np.random.default_rng(seed).normal(size=exact.shape)
    return exact + noise * exact.std(axis=0) * white


def fit(tau, masses, model=ARM, effects=None, states=STATES, bodies="free"):
    if effects is None:
        effects = [Payload(joint=model.nv - 1, instant=PICKED, centre=tuple(CENTRE))]
    options = FitOptions(standstill=None, known_masses=masses)
    given = {**EXACT, "gains": "unknown", "options": options, "bodies": bodies}
    return RobotIdentifier(model, dt=DT, effects=effects, **given).fit(states, tau)


def place(robot, name):
    return robot.parameter_names_.index(name)


def test_a_known_payload_makes_gains_absolute():
    tau = recorded()
    robot = fit(tau, {"payload": MASS})
    found = robot.gains_
    assert found.absolute
    assert_allclose(found.gain, GAINS, rtol=0.03)
    assert np.all(np.abs(found.gain - GAINS) < 3 * found.std)
    dm = place(robot, "joint_3:payload:dm")
    assert_allclose(robot.theta_[dm], MASS, rtol=1e-9)
    (first,) = found.references
    assert_allclose(found.common.factor, found.gain[first])
    assert_allclose(found.common.std, found.std[first], rtol=1e-6)
    assert found.common.masses == {"payload": MASS}
    # In closed form: what the recording has for it, over what it is.
    relative = fit(tau, None)
    assert_allclose(relative.theta_[dm] / MASS, found.common.factor, rtol=1e-9)
    assert_allclose(relative.gains_.gain * found.common.factor, found.gain, rtol=1e-9)


def test_wrong_known_mass_scales_all_bodies():
    for factor in (1.0, 2.0):
        robot = fit(recorded(), {"payload": factor * MASS}, bodies="prior")
        assert_allclose(robot.common_size_, factor, rtol=0.05)
    assert fit(recorded(), None, bodies="prior").common_size_ == 1.0


def test_a_mass_that_turns_does_not():
    robot = fit(recorded(payload=0), {"joint_3": 1.0}, effects=())
    assert not robot.gains_.absolute
    assert robot.gains_.common.masses == {"joint_3": 1.0}


@pytest.mark.parametrize(
    ("gains", "masses", "message"),
    [
        (None, {"payload": 1.0}, "needs gains='unknown'; got gains=None"),
        ("unknown", {"arm": 1.0}, "names 'arm'; expected one of joint_1, .*pay"),
        ("unknown", {"joint_1": -1.0}, r"positive masses \[kg\]; got -1.0 for"),
        ("unknown", {"payload": np.nan}, "got nan for payload"),
    ],
)
def test_other_masses_are_refused(gains, masses, message):
    given = {**EXACT, "options": FitOptions(known_masses=masses)}
    robot = RobotIdentifier(ARM, dt=DT, gains=gains, **given)
    with pytest.raises(ValueError, match=message):
        robot.fit(STATES, recorded())
