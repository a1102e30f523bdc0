"""The bound: its value, its climb, and its gradient at a fixed point."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from sklearn_vbjfa._core import _solver
from sklearn_vbjfa._core._updates import (
    bound,
    data_bound,
    expect_hidden,
    prior_bound,
)
from tests.core import _problems
from tests.core._problems import ARD_RATE, ARD_SHAPE
from tests.reference import paper_jfa as ref

MODELS = ["jfa", "paper", "noise"]


def bound_at(moments, state, prior):
    """Bound with q(Z, T) at its optimum."""
    return bound(moments, state, expect_hidden(moments, state), prior)


@pytest.mark.parametrize("n_features", [1, 3, 6])
def test_parts_equal_those_of_the_reference(n_features):
    X, y, _ = _problems.make_data(n_features, n_features)
    state = _problems.make_state(n_features, n_features)
    params = _problems.as_vb_params(state)
    hidden = expect_hidden(_problems.as_gram(X, y), state)
    posterior = ref.posterior_zt(X, y, **params.moments())
    data = sum(ref.data_terms(X, y, posterior, **params.moments()).values())
    # 25 samples in sums of size 1e2: rounding 1e-14, times the reference's inverses.
    assert_allclose(data_bound(_problems.as_gram(X, y), hidden), data, rtol=1e-10)
    prior = _problems.make_prior("paper", 25, n_features)
    expected = sum(ref.prior_terms(params, ARD_SHAPE, ARD_RATE).values())
    assert_allclose(prior_bound(state, prior), expected, rtol=1e-10)


@settings(max_examples=12, derandomize=True, deadline=None)
@given(
    model=st.sampled_from(MODELS),
    n_features=st.integers(1, 6),
    n_samples=st.integers(3, 40),
    seed=st.integers(0, 2**20),
    known=st.booleans(),
)
def test_bound_never_falls(model, n_features, n_samples, seed, known):
    X, y, _ = _problems.make_data(seed, n_features, n_samples)
    moments = _problems.as_gram(X, y)
    state = _problems.make_state(
        seed, n_features, ard=model != "jfa", coupled=model == "paper"
    )
    prior = _problems.make_prior(model, n_samples, n_features)
    if known:
        prior = replace(prior, psi_x_fixed=np.full(n_features, 0.1))
        state = replace(state, psi_x=prior.psi_x_fixed)
    values = []
    for _ in range(60):
        state, value = _problems.iterate(moments, state, prior)
        values.append(value)
    # Rounding of a sum of n terms of the size of the bound, nothing of the algorithm.
    slack = 1e-12 * np.abs(values).max()
    if state.psi_y > 1e-6 and state.psi_x.min() > 1e-6:
        assert np.diff(values).min() >= -slack
    else:
        # A variance that vanishes multiplies the rounding of its residual.
        allowed = _solver.rounding_of_bound(values[-1], n_samples, state.psi_y)
        assert np.diff(values).min() >= -allowed


def perturbed(state, name, index, step):
    """Return the state with one entry moved: variances and rates by a factor."""
    value = np.atleast_1d(np.array(getattr(state, name), dtype=float))
    if name.endswith("mean"):
        value[index] += step
    else:
        value[index] *= np.exp(step)
    return replace(state, **{name: value if value.size > 1 else float(value[0])})


@pytest.mark.parametrize("model", MODELS)
def test_gradient_vanishes_at_a_fixed_point(model):
    X, y, _ = _problems.make_data(11, 3, 80)
    moments = _problems.as_gram(X, y)
    prior = _problems.make_prior(model, 80, 3)
    state = _problems.make_state(11, 3, ard=model != "jfa", coupled=model == "paper")
    if model != "jfa":
        # The variational bound rises, ever slower, as psi_y goes to zero with the
        # sum of psi_y and psi_z kept; starting there leaves the rest to converge.
        state = replace(state, psi_y=1e-9)
    solution = _solver.solve(moments, state, prior, max_iter=20_000, tol=1e-13)
    assert solution.status == "converged"
    state = solution.state
    names = ["w_z_mean", "w_x_mean", "psi_z", "psi_x", "psi_y"]
    if model != "jfa":
        names += ["w_z_var", "alpha_rate"]
    if model == "paper":
        names += ["w_x_var"]
    step = 1e-4
    for name in names:
        for index in range(np.size(getattr(state, name))):
            above = bound_at(moments, perturbed(state, name, index, step), prior)
            below = bound_at(moments, perturbed(state, name, index, -step), prior)
            # The loop stops at a gain of 80e-13, whose square root is the gradient
            # that is left along a direction of unit curvature. A thousandth of a
            # sample's worth; at the start it is tens of samples.
            assert abs(above - below) / (2 * step) < 1e-3, (name, index)
