"""Data, states and their conversion to the reference, for tests of the core."""

import numpy as np
from scipy import signal

from sklearn_vbjfa._core._moments import square_root
from sklearn_vbjfa._core._solver import IndependentProblem
from sklearn_vbjfa._core._updates import LatentState, Prior
from tests.reference import paper_jfa as ref

ARD_SHAPE, ARD_RATE = 0.3, 0.7  # arbitrary, far from the defaults


def make_data(seed, n_features, n_samples=25, noise=0.4):
    """Return centred, unscaled X and y with noise in both, and the coefficients."""
    rng = np.random.default_rng(seed)
    scale = rng.uniform(0.5, 2.0, n_features)
    t = rng.normal(size=(n_samples, n_features))
    coef = rng.normal(size=n_features)
    y = t @ coef + 0.3 * rng.normal(size=n_samples)
    X = (t + noise * rng.normal(size=t.shape)) * scale
    return X - X.mean(axis=0), y - y.mean(), coef / scale


def coloured(rng, shape, rho):
    """AR(1) noise of unit variance."""
    white = rng.normal(size=shape)
    white[0] /= np.sqrt(1 - rho**2)
    return signal.lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], white, axis=0)


def as_gram(X, y):
    """Return moments of the rows, neither centred nor scaled."""
    return square_root(float(len(y)), X.T @ X, X.T @ y, float(y @ y))


def make_state(seed, n_features, *, ard=True, coupled=True):
    """Return an arbitrary state, of either model."""
    rng = np.random.default_rng([seed, 1])
    variance = rng.uniform(0.05, 0.5, (2, n_features))
    return LatentState(
        w_z_mean=rng.choice([-1, 1], n_features) * rng.uniform(0.3, 1.5, n_features),
        w_z_var=variance[0] * ard,
        w_x_mean=rng.choice([-1, 1], n_features) * rng.uniform(0.3, 1.5, n_features),
        w_x_var=variance[1] * (ard and coupled),
        alpha_shape=float(rng.uniform(0.8, 3.0)),
        alpha_rate=rng.uniform(0.5, 3.0, n_features),
        psi_y=float(rng.uniform(0.2, 1.0)),
        psi_z=rng.uniform(0.2, 1.0, n_features),
        psi_x=rng.uniform(0.2, 1.0, n_features),
    )


def make_prior(model, n_samples, n_features):
    """Return the prior of a model by name: "jfa", "paper" or "noise"."""
    if model == "jfa":
        return Prior()
    if model == "paper":
        return Prior(ard=True, ard_shape=ARD_SHAPE, ard_rate=ARD_RATE)
    return Prior(
        ard=True,
        coupled=False,
        ard_shape=ARD_SHAPE,
        ard_rate=ARD_RATE,
        psi_x_weight=0.1 * n_samples,
        psi_x_mode=np.full(n_features, 0.2),
    )


def iterate(moments, state, prior):
    """Do one iteration; return the new state and the bound of the old one."""
    problem = IndependentProblem(moments, prior)
    point = problem.evaluate(state)
    return problem.update(point), point.value


def noise_of(state):
    return {name: getattr(state, name) for name in ("psi_y", "psi_z", "psi_x")}


def as_jfa_params(state):
    """Convert the state to point estimates of the reference."""
    return ref.JFAParams(w_z=state.w_z_mean, w_x=state.w_x_mean, **noise_of(state))


def as_vb_params(state):
    """Convert the state to posteriors of the reference."""
    shape = np.full(state.alpha_rate.size, state.alpha_shape)
    names = "w_z_mean", "w_z_var", "w_x_mean", "w_x_var", "alpha_rate"
    values = {name: getattr(state, name) for name in names}
    return ref.VBParams(alpha_shape=shape, **values, **noise_of(state))
