"""Effects whose value is part of the model: columns, values, corrections."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.base import clone

from sklearn_vbjfa.effects import (
    BaseTilt,
    InModel,
    JointAxis,
    JointZero,
    Motion,
    OnAllJoints,
    TorqueGain,
)
from sklearn_vbjfa.model import CorrectedModel, TorqueDerivatives
from tests.effects._arms import arm, inverse_dynamics, motion
from tests.effects._faults import measured

STEP = 1e-5


def columns(model, states, effects, effect):
    """Columns of one of several effects, in what the channels read."""
    robot = CorrectedModel(model)
    for one in effects:
        one.correct(robot)
    nv = model.nv
    q, v, a = states[:, :nv], states[:, nv : 2 * nv], states[:, 2 * nv :]
    inertial = np.array([b.toDynamicParameters() for b in model.inertias[1:]])
    found = effect.columns(
        Motion(
            q=q,
            v=v,
            a=a,
            load=inverse_dynamics(robot.model, states),
            derivatives=TorqueDerivatives(robot.model, q, v, a, inertial, model),
        )
    )
    if isinstance(effect, OnAllJoints):
        return found * robot.gains[:, None]
    out = np.zeros((*q.shape, found.shape[1]))
    out[:, effect.joint] = robot.gains[effect.joint] * found
    return out


def wall(axes, gravity):
    """Make an arm with another gravity vector."""
    model = arm(axes)
    model.gravity.linear = np.array(gravity, dtype=float)
    return model


CASES = {
    "tilt": (arm("ZYX"), [BaseTilt(0, 0.1, -0.2)]),
    "tilt on a wall, x": (wall("ZYX", [9.81, 0, 0]), [BaseTilt(0, 0.1, -0.2)]),
    "tilt on a wall, y": (wall("XYZ", [0, -9.81, 0]), [BaseTilt(0, 0.1, -0.2)]),
    "tilt of a base at an angle": (
        wall("ZYX", [3.0, 2.0, -9.0]),
        [BaseTilt(0, 0.1, 0.2)],
    ),
    "zero": (arm("ZYX"), [JointZero(1, 0.2)]),
    "zero of a slide": (arm("ZyX"), [JointZero(1, 0.2)]),
    "axis about z": (arm("ZYZ"), [JointAxis(2, 0.1, -0.15)]),
    "axis about y": (arm("ZYX"), [JointAxis(1, 0.1, -0.15)]),
    "axis about x": (arm("XYX"), [JointAxis(0, 0.1, -0.15)]),
    "axis of a slide": (arm("ZyX"), [JointAxis(1, 0.1, -0.15)]),
    "gain": (arm("ZYX"), [TorqueGain(1, 1.3)]),
    "axis and zero": (arm("ZYX"), [JointAxis(1, 0.1, -0.15), JointZero(1, 0.2)]),
    "axis and zero of a slide": (
        arm("ZyX"),
        [JointZero(1, 0.2), JointAxis(1, 0.1, -0.15)],
    ),
    "everything": (
        wall("ZYX", [0.5, 0.3, -9.81]),
        [
            TorqueGain(1, 1.3),
            JointZero(1, 0.2),
            BaseTilt(0, -0.1, 0.15),
            JointAxis(1, 0.1, 0.1),
            JointAxis(0, 0.05, -0.1),
            JointZero(2, -0.2),
            TorqueGain(2, 0.7),
        ],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_columns_are_derivatives_at_the_current_values(case):
    model, faults = CASES[case]
    _, states = motion(3, duration=0.5, dt=0.02, seed=4)
    for i, effect in enumerate(faults):
        derivatives = columns(model, states, faults, effect)
        for k, name in enumerate(effect.coefficients):
            torques = []
            for step in (STEP, -STEP):
                perturbed = [*faults]
                perturbed[i] = clone(effect).set_params(
                    **{name: getattr(effect, name) + step}
                )
                torques.append(measured(model, states, perturbed))
            expected = (torques[0] - torques[1]) / (2 * STEP)
            size = np.abs(expected).max()
            assert size > 0.1
            assert_allclose(derivatives[:, :, k], expected, atol=1e-7 * size)


@pytest.mark.parametrize("case", CASES)
def test_corrected_models_follow_the_documented_conventions(case):
    model, faults = CASES[case]
    _, states = motion(3, duration=0.3, dt=0.02, seed=4)
    robot = CorrectedModel(model)
    for effect in faults:
        effect.correct(robot)
    torques = robot.gains * inverse_dynamics(robot.model, states)
    assert_allclose(torques, measured(model, states, faults), atol=1e-10)


def test_gain_scales_the_whole_torque():
    q = np.linspace(0.0, 1.0, 5)[:, None] * np.ones(2)
    load, torque = 3.0 + q, 7.0 - q
    signals = Motion(q=q, v=q, a=q, load=load, torque=torque)
    expected = torque[:, [1]] / 1.25
    assert_allclose(TorqueGain(1, 1.25).columns(signals), expected)


# -- values

ALL = [
    BaseTilt(0, 0.1, -0.2),
    JointZero(1, 0.2),
    JointAxis(1, 0.1, -0.15),
    TorqueGain(1, 1.3),
]


@pytest.mark.parametrize("effect", ALL)
def test_coefficients_are_corrections_of_the_values(effect):
    k = len(effect.coefficients)
    assert isinstance(effect, InModel)
    assert len(effect.values) == len(effect.nominal) == k
    step = 0.01 * np.arange(1, k + 1)
    updated = effect.linearised_at(step)
    assert_allclose(updated.values, effect.values + step)
    assert updated is not effect
    assert_allclose(effect.linearised_at(np.zeros(k)).values, effect.values)
    assert_allclose(effect.with_values(step).values, step)
    names = effect.coefficients
    assert all(isinstance(getattr(updated, name), float) for name in names)
    # Parameters are values and not corrections.
    assert effect.parameters(effect.values) == dict(zip(names, effect.values))
    assert updated.key() == effect.key()
    assert updated.joint == effect.joint
    assert pickle.loads(pickle.dumps(updated)).get_params() == updated.get_params()


@pytest.mark.parametrize(
    ("effect", "low", "high"),
    [
        (BaseTilt(), -np.deg2rad(15), np.deg2rad(15)),
        (JointZero(), -np.deg2rad(15), np.deg2rad(15)),
        (JointAxis(), -np.deg2rad(10), np.deg2rad(10)),
        (TorqueGain(), 0.4, 2.5),
        (TorqueGain(limit=5.0), 0.2, 5.0),
    ],
)
def test_bounds(effect, low, high):
    assert_allclose(effect.bounds()[0], low)
    assert_allclose(effect.bounds()[1], high)
    nominal = np.array(effect.nominal)
    for end, inside in ((low, 1), (high, -1)):
        margin = 1e-6 * inside
        assert effect.natural(end - nominal + margin)
        assert effect.plausible(end - nominal + margin)
        for k in range(nominal.size):
            # One value outside the bounds is enough.
            outside = np.zeros(nominal.size)
            outside[k] = end - nominal[k] - margin
            assert not effect.natural(outside)
    # Bounds apply to the corrected value.
    almost = effect.with_values(np.full(nominal.size, high - 0.01))
    assert almost.natural(np.full(nominal.size, 0.005))
    assert not almost.natural(np.full(nominal.size, 0.02))


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (BaseTilt(roll=np.nan), "roll of base_tilt must be a finite number; got nan"),
        (JointZero(zero=[0.1]), "zero of joint_zero must be a finite number"),
        (JointAxis(about_y=np.inf), "about_y of joint_axis must be a finite number"),
        (TorqueGain(gain=0.0), r"gain of torque_gain must be positive; got 0\.0"),
        (TorqueGain(gain=-1.1), "gain of torque_gain must be positive"),
    ],
)
def test_invalid_values_are_refused(effect, message):
    with pytest.raises(ValueError, match=message):
        effect.check()
