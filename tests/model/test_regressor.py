"""Batched regressors and inverse dynamics against Pinocchio's, sample by sample."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sklearn_vbjfa._core._compiler import compiler
from sklearn_vbjfa.model import TreeRegressor
from tests.model._trees import ALIGNED, OBLIQUE, OTHERS, build, by_sample


def carried(model):
    """Whether a joint (first axis) carries a body."""
    found = np.zeros((model.nv, model.nv), dtype=bool)
    for body, path in enumerate(list(model.supports)[1:]):
        found[[j - 1 for j in path if j > 0], body] = True
    return found


def motion(rng, n, nv):
    return rng.uniform(-5.0, 5.0, size=(3, n, nv))


def assert_equal_by_unit(actual, expected, tolerance=1e-10):
    """Compare with the largest entry of the same unit in the same torque."""
    for kind in (slice(0, 1), slice(1, 4), slice(4, 10)):
        error = np.abs(actual - expected)[..., kind].max(axis=(0, 2, 3), initial=0.0)
        size = np.abs(expected)[..., kind].max(axis=(0, 2, 3), initial=1.0)
        assert np.all(error <= tolerance * size)


trees = st.lists(st.sampled_from(ALIGNED + OBLIQUE + OTHERS), min_size=1, max_size=9)
seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=20, deadline=None)
@given(kinds=trees, seed=seeds, n=st.integers(0, 12))
def test_regressor_of_random_trees(kinds, seed, n):
    rng = np.random.default_rng(seed)
    model = build(rng, kinds)
    states = motion(rng, n, model.nv)
    regressor = TreeRegressor(model)
    Phi = regressor(*states)
    assert Phi.shape == (n, model.nv, model.nv, 10)
    assert_equal_by_unit(Phi, by_sample(model, *states).reshape(Phi.shape))
    assert not Phi[:, ~carried(model)].any()
    halves = [
        regressor(*(x[rows] for x in states)) for rows in np.s_[: n // 2, n // 2 :]
    ]
    np.testing.assert_allclose(Phi, np.concatenate(halves), rtol=1e-10, atol=1e-10)


@settings(max_examples=20, deadline=None)
@given(kinds=trees, seed=seeds, n=st.integers(0, 12))
def test_torques_of_random_trees(kinds, seed, n):
    rng = np.random.default_rng(seed)
    model = build(rng, kinds)
    bodies = pin.Model(model)
    for i in range(1, model.njoints):
        bodies.inertias[i] = pin.Inertia.Random()
    inertial = np.array([b.toDynamicParameters() for b in bodies.inertias[1:]])
    states = motion(rng, n, model.nv)
    regressor = TreeRegressor(model)
    data = bodies.createData()
    expected = np.array([pin.rnea(bodies, data, *x) for x in zip(*states)])
    torque = regressor.torques(*states, inertial)
    assert torque.shape == (n, model.nv)
    size = np.abs(expected).max(initial=1.0)
    expected = expected.reshape(n, model.nv)
    np.testing.assert_allclose(torque, expected, atol=1e-10 * size)
    # No mass distribution has these.
    inertial = rng.normal(size=(model.nv, 10))
    expected = np.einsum("njic,ic->nj", regressor(*states), inertial)
    torque = regressor.torques(*states, inertial)
    size = np.abs(expected).max(initial=1.0)
    np.testing.assert_allclose(torque, expected, atol=1e-10 * size)


@pytest.mark.parametrize("size", [1, 3, 8, 9, 64])
def test_neighbours_of_a_sample_do_not_matter_to_the_last_bit(size):
    rng = np.random.default_rng(10)
    model = build(rng, ["RZ", "RevoluteUnaligned", "PX", "HY"])
    states = motion(rng, 70, 4)
    regressor = TreeRegressor(model)
    parts = [regressor(*(x[i : i + size] for x in states)) for i in range(0, 70, size)]
    np.testing.assert_array_equal(np.concatenate(parts), regressor(*states))


def test_machine_code_belongs_to_the_sources_that_it_calls(tmp_path):
    source, names = tmp_path / "called.py", []
    for text in ("one = 1", "one = 2", "one = 1"):
        source.write_text(text)

        def function(x):
            return x

        names.append(compiler(source)(function).py_func.__qualname__)
    assert names[0] == names[2] != names[1]
