"""A base that is free in the description: held, in whatever orientation."""

import warnings

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import RigidBodyFeatures, load_model
from sklearn_vbjfa.model import (
    joint_names,
    load_reduced,
    movable_joints,
    nominal_parameters,
    write_reduced,
)
from tests.model._legs import JOINTS, legs_mjcf, legs_model, legs_urdf

HALF = np.sqrt(0.5)
# A quarter turn about x, and any turn; lengths do not matter.
ON_ITS_SIDE = (HALF, HALF, 0.0, 0.0)
ASKEW = (1.4, 0.6, -0.8, 1.0)


def turned(orientation):
    """Rotation (3, 3) of a quaternion, by the formula of Rodrigues."""
    w, *xyz = np.asarray(orientation) / np.linalg.norm(orientation)
    cross = np.cross(np.eye(3), xyz)
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def torques(model, q, v, a):
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(q, v, a)])


@pytest.fixture(params=["mjcf", "urdf", "model"])
def legs(request, tmp_path):
    """Return the same robot as a file of either kind, and as a model."""
    if request.param == "model":
        return legs_model()
    path = tmp_path / f"legs.{'xml' if request.param == 'mjcf' else 'urdf'}"
    path.write_text(legs_mjcf() if request.param == "mjcf" else legs_urdf())
    return path


@pytest.fixture
def states():
    return np.random.default_rng(0).normal(size=(3, 8, 6))


@pytest.mark.filterwarnings("ignore:.*the base, which root")
@pytest.mark.parametrize("orientation", [ON_ITS_SIDE, ASKEW])
def test_torques_are_those_of_gravity_turned_by_hand(legs, states, orientation):
    held, by_hand = load_model(legs, orientation), load_model(legs)
    assert joint_names(held) == JOINTS
    gravity = by_hand.gravity.copy()
    gravity.linear = turned(orientation).T @ gravity.linear
    by_hand.gravity = gravity
    rows = np.hstack(states)
    Phi, expected = (
        RigidBodyFeatures(model, friction=()).fit_transform(rows)
        for model in (held, by_hand)
    )
    np.testing.assert_allclose(Phi, expected, atol=1e-11)
    theta = nominal_parameters(held).ravel()
    # The model whose base is free, with a base that does not move.
    free = legs_model()
    base = pin.Quaternion(turned(orientation)).coeffs()
    nothing = np.zeros((8, 6))
    q = np.hstack([np.zeros((8, 3)), np.tile(base, (8, 1)), states[0]])
    v, a = (np.hstack([nothing, x]) for x in states[1:])
    np.testing.assert_allclose(
        Phi.reshape(8, 6, -1) @ theta, torques(free, q, v, a)[:, 6:], atol=1e-11
    )


@pytest.mark.filterwarnings("ignore:.*the base, which root")
def test_the_orientation_of_the_file_holds_unless_another_is_given(write, states):
    angles = (0.3, -0.2, 0.5)
    rpy = " ".join(map(str, angles))
    quat = pin.Quaternion(pin.rpy.rpyToMatrix(*angles))
    expected = torques(load_model(legs_model(), quat.coeffs()[[3, 0, 1, 2]]), *states)
    quat = " ".join(map(str, quat.coeffs()[[3, 0, 1, 2]]))
    askew = torques(load_model(legs_model(), ASKEW), *states)
    # The stand of a URDF may be turned as well, about the same axes here.
    for text in (legs_mjcf(quat), legs_urdf(rpy), legs_urdf(mount=rpy)):
        path = write(text)
        np.testing.assert_allclose(torques(load_model(path), *states), expected)
        np.testing.assert_allclose(torques(load_model(path, ASKEW), *states), askew)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("text", [legs_mjcf(), legs_urdf()], ids=["mjcf", "urdf"])
def test_a_reduced_file_has_a_base_that_stands(write, tmp_path, text):
    path = write(text)
    assert movable_joints(path) == JOINTS
    target = tmp_path / f"held{path.suffix}"
    assert write_reduced(path, target, JOINTS[:3], ASKEW) == JOINTS[3:]
    written = load_model(target)
    with pytest.warns(UserWarning, match="held turned by rpy"):
        reduced = load_reduced(path, JOINTS[:3], ASKEW)
    assert joint_names(written) == joint_names(reduced) == JOINTS[:3]
    states = np.random.default_rng(1).normal(size=(3, 4, 3))
    np.testing.assert_allclose(torques(written, *states), torques(reduced, *states))
    with pytest.raises(ValueError, match="no movable joint 'root'; it has L_hip, L_th"):
        load_reduced(path, ["root", *JOINTS])


FLOATS = 'name="L_calf" type="floating"'
BALL = '<body><freejoint name="loose"/><geom size="0.1"/></body>'
HINGE = '<joint name="turn" axis="0 0 1"/>'


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (legs_mjcf(more=BALL), [r"root .JointModelF", r"loose .JointModelF"]),
        (
            legs_urdf().replace('name="L_calf" type="revolute"', FLOATS),
            [r"root \(JointModelFreeFlyer", r"L_calf \(JointModelFreeFlyer"],
        ),
    ],
    ids=["a second body", "two free joints"],
)
def test_other_free_joints_are_refused(write, text, named):
    path = write(text)
    with pytest.raises(ValueError, match="held only if there is no other one") as error:
        load_model(path)
    for one in named:
        error.match(one)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "orientation", ["level", (1, 0, 0), (0, 0, 0, 0), (1, np.nan, 0, 0), np.eye(3)]
)
def test_refuses_what_is_no_orientation(legs, orientation):
    with pytest.raises(ValueError, match="must be a quaternion of four finite numbers"):
        load_model(legs, orientation)


def test_refuses_the_orientation_of_a_base_that_is_not_free(write):
    for robot in (write(legs_urdf(kind=None)), write(legs_mjcf(base=HINGE))):
        with pytest.raises(ValueError, match="leave base_orientation out") as error:
            load_model(robot, ON_ITS_SIDE)
        assert robot.name in str(error.value)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        held = load_model(legs_model())
    with pytest.raises(ValueError, match=r"^The model .* has no free joint that alone"):
        load_model(held, ON_ITS_SIDE)
