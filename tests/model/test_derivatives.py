"""Derivatives by the geometry against differences of Pinocchio's inverse dynamics."""

import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from sklearn_vbjfa.model import TorqueDerivatives
from tests.model._trees import ALIGNED, OBLIQUE, build, by_sample

KINDS = (*ALIGNED, *OBLIQUE, "HY", "HelicalUnaligned")
STEP = 1e-5

trees = st.lists(st.sampled_from(KINDS), min_size=1, max_size=6)
seeds = st.integers(0, 2**32 - 1)


def torques(model, states, inertial):
    """Torques (n, nv) of bodies that need not be possible."""
    Phi = by_sample(model, *states)
    return np.einsum("njic,ic->nj", Phi, inertial)


def by_difference(model, states, inertial, change):
    """Differentiate by a number that `change` (model, positions, number) puts in."""
    made = []
    for number in (STEP, -STEP):
        q, v, a = (x.copy() for x in states)
        other = model.copy()
        change(other, q, number)
        made.append(torques(other, (q, v, a), inertial))
    return (made[0] - made[1]) / (2 * STEP)


def turn(joint, axis):
    def change(model, q, angle):
        placement = model.jointPlacements[joint + 1]
        placement.rotation = placement.rotation @ pin.exp3(angle * np.eye(3)[axis])

    return change


def move(joint):
    def change(model, q, shift):
        q[:, joint] += shift

    return change


def pull(axis):
    def change(model, q, size):
        model.gravity.linear = model.gravity.linear + size * np.eye(3)[axis]

    return change


def problem(kinds, seed, n=3, parents=None):
    """Tree, states and bodies that no mass distribution has."""
    rng = np.random.default_rng(seed)
    model = build(rng, kinds, parents)
    states = rng.uniform(-2.0, 2.0, size=(3, n, model.nv))
    return model, states, rng.normal(size=(model.nv, 10))


def assert_near(found, expected, size):
    assert found.shape == expected.shape
    assert_allclose(found, expected, atol=1e-7 * size)


@settings(max_examples=25, deadline=None)
@given(kinds=trees, seed=seeds)
def test_of_random_trees_are_those_of_differences(kinds, seed):
    model, states, inertial = problem(kinds, seed)
    made = TorqueDerivatives(model, *states, inertial)
    expected = {
        "turn": [
            np.stack(
                [by_difference(model, states, inertial, turn(j, k)) for k in range(3)],
                axis=2,
            )
            for j in range(model.nv)
        ],
        "position": [
            by_difference(model, states, inertial, move(j)) for j in range(model.nv)
        ],
        "gravity": np.stack(
            [by_difference(model, states, inertial, pull(k)) for k in range(3)], axis=2
        ),
    }
    size = max(np.abs(x).max() for x in [*expected["turn"], *expected["position"], 1.0])
    for j in range(model.nv):
        assert_near(made.by_turn(j, np.eye(3)), expected["turn"][j], size)
        assert_near(made.by_position(j), expected["position"][j], size)
    assert_near(made.by_gravity(), expected["gravity"], size)
