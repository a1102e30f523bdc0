"""The explicit maximum of EM: least squares, a fixed point, and never exceeded."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa._core import _solver, _updates
from sklearn_vbjfa._core._moments import from_data, standardise
from sklearn_vbjfa._core._solver import at_highest_likelihood
from sklearn_vbjfa._core._updates import Prior
from tests.core import _problems
from tests.core.test_solver import solve_plainly


def moments_of(seed, d, n=200, correlation=0.0):
    rng = np.random.default_rng([seed, 7])
    X = rng.normal(size=(n, d)) + 3 * correlation * rng.normal(size=(n, 1))
    y = X @ rng.normal(size=d) + rng.normal(size=n)
    return standardise(from_data(X, y), centred=True).moments


def value(moments, state, prior):
    return _problems.iterate(moments, state, prior)[1]


@pytest.mark.parametrize("correlation", [0.0, 1.0, 30.0])
@pytest.mark.parametrize("noise", [None, 0.0, 1e-3, 0.3])
def test_em_stays_at_the_maximum_and_below_it(noise, correlation):
    moments = moments_of(0, 4, correlation=correlation)
    fixed = None if noise is None else np.full(4, max(noise, np.finfo(float).eps))
    prior = Prior(psi_x_fixed=fixed)
    start = _solver.start(moments, prior, np.full(4, 0.3))
    state = at_highest_likelihood(moments, start, prior)
    c = np.linalg.solve(moments.S, moments.xy)
    s = moments.residual(c)[1] / moments.n
    if noise is not None and c**2 @ fixed / (1 - noise) > s:
        # Known input noise that implies too much output noise.
        assert state is None
        return
    top = value(moments, state, prior)
    new = state
    for _ in range(20):
        new, reached = _problems.iterate(moments, new, prior)
    assert reached == pytest.approx(top, rel=0, abs=1e-9 * abs(top))
    # EM from the same start does not exceed it in many iterations.
    long = solve_plainly(moments, start, prior, max_iter=500, tol=0.0)
    assert long.history[-1] <= top + 1e-9 * abs(top)
    assert_allclose(_updates.coefficients_noisy(state), c, rtol=1e-6)
    # Known noise and signs are kept, and variances are positive.
    if noise is not None:
        assert_allclose(state.psi_x, fixed)
    assert (state.w_x_mean > 0).all()
    assert min(state.psi_y, state.psi_z.min(), state.psi_x.min()) > 0


def test_excessive_input_noise_is_reduced_by_one_factor():
    moments = moments_of(1, 4, correlation=30.0)
    start = _problems.make_state(0, 4, ard=False)
    state = at_highest_likelihood(moments, start, Prior())
    factors = (state.psi_x / state.w_x_mean**2) / (start.psi_x / start.w_x_mean**2)
    assert_allclose(factors, factors[0], rtol=1e-9)
    assert factors[0] < 0.5
    # The share of the output noise that comes from the inputs is unchanged.
    shares = []
    for one in (start, state):
        V = one.psi_x + one.w_x_mean**2
        via_inputs = _updates.coefficients_noisy(one) ** 2 @ (
            V * one.psi_x / (V - one.psi_x)
        )
        shares.append(via_inputs / (via_inputs + one.psi_y + one.psi_z.sum()))
    assert shares[0] == pytest.approx(shares[1], rel=1e-9)
