"""Derivatives by the geometry against differences of Pinocchio's inverse dynamics."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from sklearn_vbjfa.model import TorqueDerivatives
from tests.effects._arms import Derivatives
from tests.model._trees import ALIGNED, OBLIQUE, build, by_sample

KINDS = (*ALIGNED, *OBLIQUE, "HY", "HelicalUnaligned")
STEP = 1e-5

trees = st.lists(st.sampled_from(KINDS), min_size=1, max_size=6)
seeds = st.integers(0, 2**32 - 1)


def assert_near(found, expected, size):
    assert found.shape == expected.shape
    assert_allclose(found, expected, atol=1e-7 * size)


@settings(max_examples=25, deadline=None)
@given(kinds=trees, seed=seeds)
def test_of_random_trees_are_those_of_differences(kinds, seed):
    rng = np.random.default_rng(seed)
    model = build(rng, kinds)
    states = rng.uniform(-2.0, 2.0, size=(3, 3, model.nv))
    # Bodies that no mass distribution has.
    inertial = rng.normal(size=(model.nv, 10))

    def torques(model, states):
        Phi = by_sample(model, *np.split(states, 3, axis=1))
        return np.einsum("njic,ic->nj", Phi, inertial)

    made = TorqueDerivatives(model, *states, inertial)
    literal = Derivatives(model, np.hstack(states), STEP, torques)
    turns = [literal.by_turn(j, np.eye(3)) for j in range(model.nv)]
    positions = [literal.by_position(j) for j in range(model.nv)]
    size = max(np.abs(x).max() for x in [*turns, *positions, 1.0])
    for j in range(model.nv):
        assert_near(made.by_turn(j, np.eye(3)), turns[j], size)
        assert_near(made.by_position(j), positions[j], size)
    assert_near(made.by_gravity(), literal.by_gravity(), size)
