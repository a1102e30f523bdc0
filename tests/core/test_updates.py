"""One iteration and the coefficients against the literal transcription of the paper."""

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa._core import _updates
from sklearn_vbjfa._core._updates import Prior
from tests.core import _problems
from tests.core._problems import ARD_RATE, ARD_SHAPE
from tests.reference import paper_jfa as ref

# d, N and seed: one, few and many inputs; also fewer samples than features.
SIZES = [(1, 25, 0), (2, 7, 1), (3, 40, 2), (5, 25, 3), (6, 4, 4)]

# Both sides are sums of about 1e3 terms of size 1: 1e-10 leaves a factor of 1e3 for
# the condition of the inverses in the reference.
ONE_STEP = 1e-10


def assert_same_posterior(state, params, rtol):
    """Compare every parameter of the reference with the state."""
    for field in fields(params):
        expected = getattr(params, field.name)
        found = getattr(
            state, {"w_z": "w_z_mean", "w_x": "w_x_mean"}.get(field.name, field.name)
        )
        assert_allclose(found, expected, rtol=rtol, err_msg=field.name)


@pytest.mark.parametrize(("n_features", "n_samples", "seed"), SIZES)
def test_jfa_iteration(n_features, n_samples, seed):
    X, y, _ = _problems.make_data(seed, n_features, n_samples)
    state = _problems.make_state(seed, n_features, ard=False)
    new, value = _problems.iterate(_problems.as_gram(X, y), state, Prior())
    params = _problems.as_jfa_params(state)
    assert_same_posterior(new, ref.jfa_em_step(params, X, y), ONE_STEP)
    assert_allclose(value, ref.jfa_loglik(params, X, y), rtol=ONE_STEP)


@pytest.mark.parametrize(("n_features", "n_samples", "seed"), SIZES)
def test_vb_iteration(n_features, n_samples, seed):
    X, y, _ = _problems.make_data(seed, n_features, n_samples)
    state = _problems.make_state(seed, n_features)
    prior = _problems.make_prior("paper", n_samples, n_features)
    new, value = _problems.iterate(_problems.as_gram(X, y), state, prior)
    params = _problems.as_vb_params(state)
    expected = ref.vb_step(params, X, y, ARD_SHAPE, ARD_RATE)
    assert_same_posterior(new, expected, ONE_STEP)
    assert_allclose(value, ref.elbo(params, X, y, ARD_SHAPE, ARD_RATE), rtol=ONE_STEP)


def test_uncoupled_precision_uses_the_output_loading_only():
    X, y, _ = _problems.make_data(2, 3)
    state = _problems.make_state(2, 3, coupled=False)
    prior = _problems.make_prior("noise", 25, 3)
    new, _ = _problems.iterate(_problems.as_gram(X, y), state, prior)
    # Eqs. 12 and 13 with one loading for each precision: half a count, not one.
    assert new.alpha_shape == ARD_SHAPE + 0.5
    assert_allclose(
        new.alpha_rate, ARD_RATE + (new.w_z_mean**2 + new.w_z_var) / 2, rtol=1e-15
    )


def expected_log_joint(psi_x, new, posterior, prior, X, y):
    """Terms of the bound with psi_x at the old q(Z, T), from the transcription."""
    moments = {**_problems.as_vb_params(new).moments(), "psi_x": psi_x}
    data = sum(ref.data_terms(X, y, posterior, **moments).values())
    ratio = prior.psi_x_mode / psi_x
    # Log-density of log(psi_x) for inverse-gamma psi_x, up to a constant.
    return data + 0.5 * prior.psi_x_weight * (np.log(ratio) - ratio).sum()


@pytest.mark.parametrize("weight", [0.0, 2.5, 100.0])
def test_input_noise_maximises_the_bound_under_its_prior(weight):
    X, y, _ = _problems.make_data(3, 3)
    state = _problems.make_state(3, 3, coupled=False)
    prior = replace(_problems.make_prior("noise", 25, 3), psi_x_weight=weight)
    new, _ = _problems.iterate(_problems.as_gram(X, y), state, prior)
    posterior = ref.posterior_zt(X, y, **_problems.as_vb_params(state).moments())
    best = expected_log_joint(new.psi_x, new, posterior, prior, X, y)
    step = 1e-4
    for m in range(3):
        up, down = new.psi_x.copy(), new.psi_x.copy()
        up[m] *= np.exp(step)
        down[m] *= np.exp(-step)
        above = expected_log_joint(up, new, posterior, prior, X, y)
        below = expected_log_joint(down, new, posterior, prior, X, y)
        # A central difference: truncation n step^2, rounding 1e-13 / step.
        assert abs(above - below) / (2 * step) < 1e-6
        assert max(above, below) < best


def test_input_noise_near_zero_keeps_its_digits():
    # The residual x - w_x t is as small as psi_x; a difference of sums of size n
    # would have lost it at 1e-16 n.
    X, y, _ = _problems.make_data(5, 2, 200, noise=0.0)
    moments = _problems.as_gram(X, y)
    ratios = []
    for psi_x in (1e-6, 1e-9, 1e-12):
        state = replace(_problems.make_state(5, 2, ard=False), psi_x=np.full(2, psi_x))
        held = replace(_problems.iterate(moments, state, Prior())[0], psi_x=state.psi_x)
        ratios.append(_problems.iterate(moments, held, Prior())[0].psi_x / psi_x)
    assert_allclose(ratios[1:], ratios[:-1], rtol=1e-2)


@pytest.mark.parametrize("seed", [0, 1])
def test_coefficients_equal_the_literal_matrices(seed):
    state = _problems.make_state(seed, 5)
    args = state.psi_y, state.psi_z
    noisy = ref.beta_noise_eq27(state.w_z_mean, state.w_x_mean, *args, state.psi_x)
    noiseless = ref.beta_true_eq29(state.w_z_mean, state.w_x_mean, *args)
    assert_allclose(_updates.coefficients_noisy(state), noisy, rtol=1e-10)
    active = np.ones(5, dtype=bool)
    found = _updates.coefficients_noiseless(state, active)
    assert_allclose(found, noiseless, rtol=1e-10)
