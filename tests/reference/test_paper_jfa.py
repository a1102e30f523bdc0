"""The reference against oracles with other formulas, and misprints of the paper."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats
from scipy.special import gammaln, logsumexp

from tests.reference import paper_jfa as ref

N_FEATURES = [1, 2, 3, 5]
SEEDS = [0, 1, 2]


def make_data(seed, n_features, n_samples=25):
    """Centred samples of a linear model with noise in inputs and output."""
    rng = np.random.default_rng(seed)
    t = rng.normal(size=(n_samples, n_features))
    X = t * rng.uniform(0.5, 2.0, n_features)
    X += 0.4 * rng.normal(size=X.shape)
    y = t @ rng.normal(size=n_features) + 0.3 * rng.normal(size=n_samples)
    return X - X.mean(axis=0), y - y.mean()


def make_jfa_params(seed, n_features):
    rng = np.random.default_rng([seed, 1])
    return ref.JFAParams(
        w_z=rng.choice([-1, 1], n_features) * rng.uniform(0.3, 1.5, n_features),
        w_x=rng.choice([-1, 1], n_features) * rng.uniform(0.3, 1.5, n_features),
        psi_y=rng.uniform(0.2, 1.0),
        psi_z=rng.uniform(0.2, 1.0, n_features),
        psi_x=rng.uniform(0.2, 1.0, n_features),
    )


def make_vb_params(seed, n_features):
    rng = np.random.default_rng([seed, 2])
    point = make_jfa_params(seed, n_features)
    return ref.VBParams(
        w_z_mean=point.w_z,
        w_z_var=rng.uniform(0.05, 0.5, n_features),
        w_x_mean=point.w_x,
        w_x_var=rng.uniform(0.05, 0.5, n_features),
        alpha_shape=rng.uniform(0.8, 3.0, n_features),
        alpha_rate=rng.uniform(0.5, 3.0, n_features),
        psi_y=point.psi_y,
        psi_z=point.psi_z,
        psi_x=point.psi_x,
    )


def with_posterior(seed, n_features):
    """Return data, parameters, and the q(Z, T) that follows from them."""
    X, y = make_data(seed, n_features)
    params = make_vb_params(seed, n_features)
    return X, y, params, ref.posterior_zt(X, y, **params.moments())


def assert_same_posterior(actual, desired, rtol=1e-9):
    assert_allclose(actual.E_z, desired.E_z, rtol=rtol, atol=rtol)
    assert_allclose(actual.E_t, desired.E_t, rtol=rtol, atol=rtol)
    assert_allclose(actual.covariance(), desired.covariance(), rtol=rtol, atol=rtol)


# -- E-step ----------------------------------------------------------------------------


def condition_on_pseudo_observation(params, X, y):
    """Oracle for q(Z, T) with uncertain loadings, and for its part of the bound.

    The variances of w_z and w_x add -t^2 (w_z_var / psi_z + w_x_var / psi_x) / 2 to the
    exponent. A pseudo-observation u_m = 0 with u_m | t_m ~ Normal(c_m t_m, 1) adds the
    same, up to sqrt(2 pi), so q(Z, T) is a conditional of one dense Gaussian.
    """
    n_samples, n_features = X.shape
    point = ref.JFAParams(
        w_z=params.w_z_mean,
        w_x=params.w_x_mean,
        psi_y=params.psi_y,
        psi_z=params.psi_z,
        psi_x=params.psi_x,
    )
    scale = np.sqrt(params.w_z_var / params.psi_z + params.w_x_var / params.psi_x)
    n_joint = 3 * n_features + 1
    lift = np.vstack([np.eye(n_joint), np.zeros((n_features, n_joint))])
    lift[n_joint:, :n_features] = np.diag(scale)
    Sigma = lift @ ref.joint_covariance(point) @ lift.T
    Sigma[n_joint:, n_joint:] += np.eye(n_features)
    t, z = np.arange(n_features), np.arange(n_features, 2 * n_features)
    observed = np.arange(2 * n_features, n_joint + n_features)
    gain, cov = ref.condition_gaussian(Sigma, np.concatenate([z, t]), observed)
    values = np.column_stack([X, y, np.zeros((n_samples, n_features))])
    means = values @ gain.T
    log_density = stats.multivariate_normal.logpdf(
        values, np.zeros(len(observed)), Sigma[np.ix_(observed, observed)]
    )
    posterior = ref.Posterior(
        E_z=means[:, :n_features],
        E_t=means[:, n_features:],
        Sigma_zz=cov[:n_features, :n_features],
        Sigma_zt=cov[:n_features, n_features:],
        Sigma_tt=cov[n_features:, n_features:],
    )
    bound = log_density.sum() + 0.5 * n_samples * n_features * ref.LOG_2PI
    return posterior, bound


@pytest.mark.parametrize("n_features", N_FEATURES)
@pytest.mark.parametrize("uncertain", [0.0, 1.0])
@pytest.mark.parametrize("log_psi", [-2.0, 0.0, 2.0])
def test_posterior_is_a_conditional_gaussian(log_psi, uncertain, n_features):
    X, y = make_data(n_features, n_features)
    params = make_vb_params(n_features, n_features)
    scale = 10.0**log_psi
    params = replace(
        params,
        w_z_var=uncertain * params.w_z_var,
        w_x_var=uncertain * params.w_x_var,
        psi_z=scale * params.psi_z,
        psi_x=params.psi_x / scale,
    )
    literal = ref.posterior_zt(X, y, **params.moments())
    dense, bound = condition_on_pseudo_observation(params, X, y)
    assert_same_posterior(literal, dense)
    terms = ref.data_terms(X, y, literal, **params.moments())
    assert_allclose(sum(terms.values()), bound, rtol=1e-10)


def test_eq19_printed_is_false():
    X, y = make_data(0, 3)
    params = make_vb_params(0, 3)
    params = replace(params, w_z_var=np.zeros(3), w_x_var=np.zeros(3))
    dense, _ = condition_on_pseudo_observation(params, X, y)
    printed = ref.posterior_zt(
        X, y, cross_covariance=ref.sigma_zt_printed, **params.moments()
    )
    assert_allclose(printed.Sigma_zt, -dense.Sigma_zt, rtol=1e-9)
    assert np.abs(dense.Sigma_zt).min() > 1e-3
    # Eq. 24 contains Sigma_tz written out, with the correct plus sign.
    assert_allclose(printed.E_t, dense.E_t, rtol=1e-9)
    assert np.abs(printed.E_z - dense.E_z).max() > 0.1


def test_eq19_printed_breaks_em():
    X, y = make_data(0, 3)
    params = make_jfa_params(0, 3)
    for _ in range(20):
        params = ref.jfa_em_step(params, X, y)
    before = ref.jfa_loglik(params, X, y)
    right = ref.jfa_em_step(params, X, y)
    wrong = ref.jfa_em_step(params, X, y, cross_covariance=ref.sigma_zt_printed)
    assert ref.jfa_loglik(right, X, y) > before
    assert ref.jfa_loglik(wrong, X, y) < before - 1.0


# -- Joint factor analysis -------------------------------------------------------------


def test_joint_covariance_by_hand():
    params = make_jfa_params(3, 2)
    Sigma = ref.joint_covariance(params)
    var_z = params.w_z**2 + params.psi_z
    assert_allclose(Sigma[:2, :2], np.eye(2))
    assert_allclose(
        np.diag(Sigma),
        [1.0, 1.0, *var_z, *(params.w_x**2 + params.psi_x), var_z.sum() + params.psi_y],
    )
    assert_allclose(Sigma[4:6, 6], params.w_x * params.w_z)
    assert_allclose(Sigma[2:4, 6], var_z)
    assert_allclose(Sigma[2:4, 4:6], np.diag(params.w_x * params.w_z))


@pytest.mark.parametrize("name", ["w_z", "w_x", "psi_y", "psi_z", "psi_x"])
def test_em_step_is_stationary(name):
    X, y = make_data(1, 3)
    old = make_jfa_params(1, 3)
    posterior = ref.posterior_zt(X, y, **old.moments())

    def objective(params):
        return sum(ref.data_terms(X, y, posterior, **params.moments()).values())

    assert np.abs(gradient(objective, old, name)).max() > 0.1
    new = ref.jfa_em_step(old, X, y)
    assert_allclose(gradient(objective, new, name), 0.0, atol=1e-5)


# -- The variational bound -------------------------------------------------------------

# A stronger prior than the paper's 1e-6, so that its terms matter.
ARD = {"ard_shape": 1.5, "ard_rate": 0.7}
LOG_SCALE = {"w_z_var", "w_x_var", "alpha_shape", "alpha_rate"}


def gradient(objective, params, name, step=1e-5):
    """Central differences in one field; variances and rates on the log scale."""
    value = np.asarray(getattr(params, name), dtype=float)
    on_log_scale = name in LOG_SCALE or name.startswith("psi")
    slopes = np.empty(value.shape)
    for index in np.ndindex(value.shape):
        sides = []
        for delta in (step, -step):
            moved = value.copy()
            moved[index] = (
                moved[index] * np.exp(delta) if on_log_scale else moved[index] + delta
            )
            sides.append(objective(replace(params, **{name: moved[()]})))
        slopes[index] = (sides[0] - sides[1]) / (2.0 * step)
    return slopes


def test_prior_terms_by_integration():
    params = make_vb_params(4, 1)
    terms = ref.prior_terms(params, **ARD)
    q_alpha = stats.gamma(params.alpha_shape[0], scale=1.0 / params.alpha_rate[0])
    p_alpha = stats.gamma(ARD["ard_shape"], scale=1.0 / ARD["ard_rate"])
    assert_allclose(terms["entropy_alpha"], q_alpha.entropy(), rtol=1e-8)
    assert_allclose(terms["log_p_alpha"], q_alpha.expect(p_alpha.logpdf), rtol=1e-7)
    nodes, weights = np.polynomial.hermite_e.hermegauss(20)
    for which in ("w_z", "w_x"):
        q_w = stats.norm(
            getattr(params, f"{which}_mean")[0],
            np.sqrt(getattr(params, f"{which}_var")[0]),
        )
        w = q_w.mean() + q_w.std() * nodes

        def expected_log_p(alpha, w=w):
            log_p = stats.norm.logpdf(w, 0.0, 1.0 / np.sqrt(alpha))
            return weights @ log_p / weights.sum()

        assert_allclose(
            terms[f"log_p_{which}"], q_alpha.expect(expected_log_p), rtol=1e-7
        )
        assert_allclose(terms[f"entropy_{which}"], q_w.entropy(), rtol=1e-10)


@pytest.mark.parametrize("n_features", [1, 3])
def test_posterior_zt_maximises_the_bound(n_features):
    X, y, params, best = with_posterior(2, n_features)
    top = ref.elbo(params, X, y, **ARD)
    assert_allclose(ref.elbo(params, X, y, **ARD, posterior=best), top, rtol=1e-14)
    rng = np.random.default_rng(7)
    for name in ("E_z", "E_t", "Sigma_zz", "Sigma_tt", "Sigma_zt"):
        value = getattr(best, name)
        step = 1e-3 * rng.normal(size=value.shape)
        step = 0.5 * (step + step.T) if name in ("Sigma_zz", "Sigma_tt") else step
        values = [
            ref.elbo(
                params, X, y, **ARD, posterior=replace(best, **{name: value + moved})
            )
            for moved in (step, -step)
        ]
        assert max(values) < top
        # A maximum: both decreases agree to first order.
        assert abs(values[0] - values[1]) < 0.1 * (2 * top - sum(values))


BLOCKS = {
    "w_z": ("w_z_mean", "w_z_var"),
    "w_x": ("w_x_mean", "w_x_var"),
    "alpha": ("alpha_shape", "alpha_rate"),
    "psi_y": ("psi_y",),
    "psi_z": ("psi_z",),
    "psi_x": ("psi_x",),
}


def update_block(block, params, posterior, X, y, ard_shape, ard_rate):
    """Update one block of parameters and keep the others."""
    E_alpha = params.alpha_shape / params.alpha_rate
    w_z = {"w_z_mean": params.w_z_mean, "w_z_var": params.w_z_var}
    w_x = {"w_x_mean": params.w_x_mean, "w_x_var": params.w_x_var}
    if block == "w_z":
        new = ref.update_w_z(posterior, X, y, psi_z=params.psi_z, E_alpha=E_alpha)
    elif block == "w_x":
        new = ref.update_w_x(posterior, X, y, psi_x=params.psi_x, E_alpha=E_alpha)
    elif block == "alpha":
        new = ref.update_alpha(**w_z, **w_x, ard_shape=ard_shape, ard_rate=ard_rate)
    elif block == "psi_y":
        new = (ref.update_psi_y(posterior, X, y),)
    elif block == "psi_z":
        new = (ref.update_psi_z(posterior, X, y, **w_z),)
    else:
        new = (ref.update_psi_x(posterior, X, y, **w_x),)
    return replace(params, **dict(zip(BLOCKS[block], new)))


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("n_features", [1, 3])
def test_each_block_update_is_stationary(n_features, block):
    X, y, params, posterior = with_posterior(3, n_features)
    objective = partial(ref.elbo, X=X, y=y, **ARD, posterior=posterior)
    new = update_block(block, params, posterior, X, y, **ARD)
    for name in BLOCKS[block]:
        assert np.abs(gradient(objective, params, name)).max() > 0.05
        assert_allclose(gradient(objective, new, name), 0.0, atol=1e-5)
    assert objective(new) > objective(params)


# -- One feature: the bound against the evidence by integration over w_z and w_x -------


def log_prior_w(squares, n_loadings, ard_shape, ard_rate):
    """Log of the integral over alpha of prod Normal(w; 0, 1/alpha) Gamma(alpha)."""
    shape = ard_shape + 0.5 * n_loadings
    return (
        -0.5 * n_loadings * ref.LOG_2PI
        + ard_shape * np.log(ard_rate)
        - gammaln(ard_shape)
        + gammaln(shape)
        - shape * np.log(ard_rate + 0.5 * squares)
    )


def log_evidence(X, y, psi_y, psi_z, psi_x, ard_shape, ard_rate, n_grid):
    """Log p(X, y) and log p(X) given the noise variances, by the trapezoidal rule.

    The integrand is smooth and vanishes before the ends; for such integrands the
    trapezoidal rule converges faster than any power of the spacing.
    """
    # The likelihood sets the scale of both loadings; a factor of 8 covers the tails.
    w_x = 8.0 * X.std() * np.linspace(-1.0, 1.0, n_grid)[:, None]
    w_z = 8.0 * y.std() * np.linspace(-1.0, 1.0, n_grid)[None, :]
    var_x, cov, var_y = w_x**2 + psi_x, w_x * w_z, w_z**2 + psi_z + psi_y
    determinant = var_x * var_y - cov**2
    squares = X @ X * var_y - 2.0 * (X @ y) * cov + y @ y * var_x
    log_joint = (
        log_prior_w(w_x**2 + w_z**2, 2, ard_shape, ard_rate)
        - len(y) * (ref.LOG_2PI + 0.5 * np.log(determinant))
        - 0.5 * squares / determinant
    )
    log_inputs = (
        log_prior_w(w_x**2, 1, ard_shape, ard_rate)
        - 0.5 * len(y) * (ref.LOG_2PI + np.log(var_x))
        - 0.5 * (X @ X) / var_x
    )
    log_dx, log_dz = np.log(np.diff(w_x[:2, 0])[0]), np.log(np.diff(w_z[0, :2])[0])
    edges = (log_joint[0], log_joint[-1], log_joint[:, 0], log_joint[:, -1])
    assert max(edge.max() for edge in edges) < log_joint.max() - 15.0
    return logsumexp(log_joint) + log_dx + log_dz, logsumexp(log_inputs) + log_dx


def fit_fixed_noise(params, X, y, ard_shape, ard_rate, n_iter):
    for _ in range(n_iter):
        posterior = ref.posterior_zt(X, y, **params.moments())
        for block in ("w_z", "w_x", "alpha"):
            params = update_block(block, params, posterior, X, y, ard_shape, ard_rate)
    return params


@pytest.mark.parametrize("seed", SEEDS)
def test_bound_is_below_the_evidence(seed):
    X, y = make_data(seed, 1, n_samples=20)
    params = make_vb_params(seed, 1)
    noise = {"psi_y": params.psi_y, "psi_z": params.psi_z[0], "psi_x": params.psi_x[0]}
    evidence, _ = log_evidence(X[:, 0], y, **noise, **ARD, n_grid=801)
    coarse, _ = log_evidence(X[:, 0], y, **noise, **ARD, n_grid=401)
    # Halving the spacing shows the accuracy of the quadrature: better than 1e-6 nats.
    assert_allclose(evidence, coarse, atol=1e-6)
    start = ref.elbo(params, X, y, **ARD)
    fitted = fit_fixed_noise(params, X, y, **ARD, n_iter=60)
    best = ref.elbo(fitted, X, y, **ARD)
    assert start < best < evidence
    # The posterior has two mirrored modes and q covers one: at least log 2 below.
    # The factorised q costs another 0.8 to 1.3 nats; missing constants would exceed it.
    assert np.log(2.0) < evidence - best < 2.5


def test_bound_is_on_the_joint_density_not_on_y_given_X():
    # The paper calls the bounded quantity log p(y | X); eq. 6 also has log p(x | t).
    X, y = make_data(0, 1, n_samples=20)
    X = 0.1 * X
    params = make_vb_params(0, 1)
    params = replace(
        params,
        w_x_mean=0.1 * params.w_x_mean,
        w_x_var=0.01 * params.w_x_var,
        psi_x=0.01 * params.psi_x,
    )
    noise = {"psi_y": params.psi_y, "psi_z": params.psi_z[0], "psi_x": params.psi_x[0]}
    joint, inputs = log_evidence(X[:, 0], y, **noise, **ARD, n_grid=801)
    bound = ref.elbo(fit_fixed_noise(params, X, y, **ARD, n_iter=60), X, y, **ARD)
    assert joint - inputs < bound < joint


# -- Misprints of eqs. 5 and 6 ---------------------------------------------------------


@pytest.mark.parametrize("block", ["w_z", "w_x", "alpha"])
def test_eq5_printed_is_false(block):
    # With p(w_z | alpha) twice and no p(w_x | alpha), none of the paper's updates
    # maximises the bound.
    X, y, params, posterior = with_posterior(3, 2)
    new = update_block(block, params, posterior, X, y, **ARD)
    right = partial(ref.elbo, X=X, y=y, **ARD, posterior=posterior)
    printed = partial(ref.elbo_eq5_printed, X=X, y=y, **ARD, posterior=posterior)
    for name in BLOCKS[block]:
        assert_allclose(gradient(right, new, name), 0.0, atol=1e-5)
        assert np.abs(gradient(printed, new, name)).min() > 1e-3


def test_eq5_printed_bound_falls():
    # From the optimum of the printed bound in q(w_x), eqs. 10-11 decrease it.
    X, y, params, posterior = with_posterior(3, 2)
    mean, var = ref.update_w_x(posterior, X, y, psi_x=params.psi_x, E_alpha=0.0)
    params = replace(params, w_x_mean=mean, w_x_var=var)
    new = update_block("w_x", params, posterior, X, y, **ARD)
    right = partial(ref.elbo, X=X, y=y, **ARD, posterior=posterior)
    printed = partial(ref.elbo_eq5_printed, X=X, y=y, **ARD, posterior=posterior)
    assert right(new) > right(params) + 1e-3
    assert printed(new) < printed(params) - 1e-3


@pytest.mark.parametrize("ard", [1e-6, 1.5])
def test_eq6_printed_is_false(ard):
    # p(alpha_m) with both loadings counts one prior twice; eqs. 12-13 count it once.
    X, y, params, posterior = with_posterior(3, 2)
    arguments = {"X": X, "y": y, "ard_shape": ard, "ard_rate": ard}
    new = update_block("alpha", params, posterior, **arguments)
    right = partial(ref.elbo, **arguments, posterior=posterior)
    printed = partial(ref.elbo_eq6_printed, **arguments, posterior=posterior)
    for name in BLOCKS["alpha"]:
        assert_allclose(gradient(right, new, name), 0.0, atol=1e-5)
        assert np.abs(gradient(printed, new, name)).min() > 1e-2


# -- Regression vectors ----------------------------------------------------------------


def expected_y_given_x(params):
    """Slope of E[y | x] from the dense joint Gaussian."""
    n_features = len(params.w_z)
    x = np.arange(2 * n_features, 3 * n_features)
    Sigma = ref.joint_covariance(params)
    return ref.condition_gaussian(Sigma, np.array([3 * n_features]), x)[0][0]


@pytest.mark.parametrize("n_features", N_FEATURES)
@pytest.mark.parametrize("seed", SEEDS)
def test_eq27_is_the_conditional_expectation(seed, n_features):
    params = make_jfa_params(seed, n_features)
    expected = expected_y_given_x(params)
    literal = ref.beta_noise_eq27(**vars(params))
    assert_allclose(literal, expected, rtol=1e-9)
    closed = params.w_z * params.w_x / (params.w_x**2 + params.psi_x)
    assert_allclose(closed, expected, rtol=1e-9)


def eq27(params):
    noise, names = (params.psi_y, params.psi_z, params.psi_x), ("w_z_var", "w_x_var")
    variances = {name: getattr(params, name) for name in names}
    return ref.beta_noise_eq27(params.w_z_mean, params.w_x_mean, *noise, **variances)


def test_eq27_with_second_moments():
    params = make_vb_params(0, 3)
    literal = eq27(params)
    # The slope of sum_m <z_m> in x if y is unknown, i.e. infinitely noisy.
    noisy = {**params.moments(), "psi_y": 1e9}
    slope = [
        ref.posterior_zt(row[None], np.zeros(1), **noisy).E_z.sum() for row in np.eye(3)
    ]
    assert_allclose(literal, slope, rtol=1e-6)


@pytest.mark.parametrize("n_features", N_FEATURES)
@pytest.mark.parametrize("seed", SEEDS)
def test_eq29_is_the_limit_without_input_noise(seed, n_features):
    params = make_jfa_params(seed, n_features)
    literal = ref.beta_true_eq29(params.w_z, params.w_x, params.psi_y, params.psi_z)
    closed = params.w_z / params.w_x
    assert_allclose(literal, closed, rtol=1e-9)
    for scale, rtol in ((1e-3, 0.05), (1e-6, 5e-5)):
        quiet = replace(params, psi_x=scale * params.psi_x)
        assert_allclose(expected_y_given_x(quiet), closed, rtol=rtol)
        assert np.all(np.abs(expected_y_given_x(quiet)) < np.abs(closed))
    # y = sum_m w_zm t_m at the noiseless input x_m = w_xm t_m.
    t = np.random.default_rng(seed).normal(size=n_features)
    assert_allclose(literal @ (params.w_x * t), params.w_z @ t, rtol=1e-9)


def test_eq29_is_not_the_limit_with_second_moments():
    # The limit of eq. 27 is eq. 29 only with point estimates (section 3.3), because
    # the variance of w_x does not vanish with psi_x.
    params = make_vb_params(0, 3)
    limit = eq27(replace(params, psi_x=1e-8 * params.psi_x))
    second_moment = params.w_x_mean**2 + params.w_x_var
    assert_allclose(limit, params.w_z_mean * params.w_x_mean / second_moment, rtol=1e-5)
    ratio = limit / (params.w_z_mean / params.w_x_mean)
    assert np.all(ratio < 0.99)


@pytest.mark.parametrize("seed", SEEDS)
def test_eq28_corrected_is_the_conditional_expectation(seed):
    params = make_jfa_params(seed, 3)
    corrected = ref.beta_jfa_eq28(params.w_z, params.w_x, params.psi_x)
    assert_allclose(corrected, expected_y_given_x(params), rtol=1e-9)
    # The extra terms that the paper finds in eq. 27 cancel: both vectors are equal.
    assert_allclose(corrected, ref.beta_noise_eq27(**vars(params)), rtol=1e-9)


def test_eq28_printed_is_false():
    params = make_jfa_params(0, 3)
    printed = ref.beta_jfa_eq28_printed(params.w_z, params.w_x, params.psi_x)
    error = np.abs(printed / expected_y_given_x(params) - 1.0)
    assert error.min() > 0.01
    # It has no consistent units: with x in other units, beta must scale inversely.
    units = np.array([10.0, 0.1, 3.0])
    arguments = (params.w_z, units * params.w_x, units**2 * params.psi_x)
    right = ref.beta_jfa_eq28(*arguments) * units
    wrong = ref.beta_jfa_eq28_printed(*arguments) * units
    assert_allclose(right, ref.beta_jfa_eq28(params.w_z, params.w_x, params.psi_x))
    assert np.abs(wrong / printed - 1.0).min() > 0.01
