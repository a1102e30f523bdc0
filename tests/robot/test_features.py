"""Regressor matrices: the identity Phi theta = inverse dynamics, layout, names."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sklearn_vbjfa import RigidBodyFeatures
from sklearn_vbjfa.datasets import demo_arm_urdf
from tests.effects._arms import inverse_dynamics
from tests.model._robots import random_tree

ALL = ("viscous", "coulomb", "offset", "rotor_inertia")
properties = settings(derandomize=True, deadline=None, max_examples=40)


def states_of(rng, model, n=4):
    return rng.normal(size=(n, 3 * model.nv))


def assert_torques(Phi, theta, expected):
    # Sums of some hundred products: 1e-10 of the largest torque is far above their
    # rounding and far below any term that might be missing.
    tau = Phi.reshape(expected.shape[0], -1, theta.size) @ theta
    atol = 1e-10 * np.abs(expected).max()
    np.testing.assert_allclose(tau, expected, rtol=0, atol=atol)


@properties
@given(seed=st.integers(0, 2**31 - 1), n_joints=st.integers(1, 7))
def test_inverse_dynamics_of_random_trees(seed, n_joints):
    rng = np.random.default_rng(seed)
    model, bodies = random_tree(rng, n_joints)
    states = states_of(rng, model)
    Phi = RigidBodyFeatures(model, friction=()).fit_transform(states)
    assert_torques(Phi, bodies.ravel(), inverse_dynamics(model, states))


@properties
@given(
    seed=st.integers(0, 2**31 - 1),
    friction=st.permutations(ALL).flatmap(
        lambda names: st.integers(0, 4).map(lambda k: tuple(names[:k]))
    ),
)
def test_friction_columns(seed, friction):
    rng = np.random.default_rng(seed)
    model, bodies = random_tree(rng, 4)
    states = states_of(rng, model)
    _, v, a = np.split(states, 3, axis=1)
    signals = dict(zip(ALL, (v, np.sign(v), np.ones_like(v), a)))
    coefficients = rng.normal(size=(4, len(friction)))
    expected = inverse_dynamics(model, states)
    for k, name in enumerate(friction):
        expected = expected + coefficients[:, k] * signals[name]
    theta = np.hstack([bodies, coefficients]).ravel()
    features = RigidBodyFeatures(model, friction=friction)
    assert_torques(features.fit_transform(states), theta, expected)


def test_what_a_torque_does_not_depend_on_is_exactly_zero():
    # Not 1e-16: a regression in standardised columns would take that for information.
    rng = np.random.default_rng(6)
    states = rng.normal(size=(200, 18))
    Phi = RigidBodyFeatures(demo_arm_urdf(), friction=()).fit_transform(states)
    size = np.abs(Phi.reshape(200, 6, 6, 10)).max(axis=0)
    for j in range(6):
        for k in range(j):
            np.testing.assert_array_equal(size[j, k], 0.0)  # a body below the joint
    # The first axis is vertical: nothing of its body but I_zz is felt.
    np.testing.assert_array_equal(size[:, 0, :9], 0.0)
    assert size[0, 0, 9] > 1
    # the second turns about y at a distance: its m c_y is not felt by itself
    assert size[1, 1, 2] == 0.0
    assert size[size > 0].min() > 1e-6
