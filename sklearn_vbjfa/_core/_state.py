"""Parameters and expectations of the JFA models, as immutable records."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class State:
    """Everything that one iteration changes.

    Loadings are Gaussian with diagonal covariance; zero variances are point
    estimates (JFA). All quantities are in standardised units.

    Attributes
    ----------
    w_z_mean, w_z_var : ndarray of shape (n_features,)
        Posterior mean and variance of the loadings t -> z. [eqs. 8, 9]
    w_x_mean, w_x_var : ndarray of shape (n_features,)
        Posterior mean and variance of the loadings t -> x. [eqs. 10, 11]
    alpha_shape : float
        Shape of the Gamma posterior of each precision. [eq. 12]
    alpha_rate : ndarray of shape (n_features,)
        Its rate. [eq. 13]
    psi_y : float
        Output-noise variance. [eq. 14]
    psi_z, psi_x : ndarray of shape (n_features,)
        Variances of the hidden z given t, and of the input noise. [eqs. 15, 16]
    """

    w_z_mean: np.ndarray
    w_z_var: np.ndarray
    w_x_mean: np.ndarray
    w_x_var: np.ndarray
    alpha_shape: float
    alpha_rate: np.ndarray
    psi_y: float
    psi_z: np.ndarray
    psi_x: np.ndarray

    @property
    def E_alpha(self):
        """Posterior mean of the precisions."""
        return self.alpha_shape / self.alpha_rate


@dataclass(frozen=True, kw_only=True)
class HiddenExpectations:
    """Sample sums of the posterior moments of z and t, and what they are made of.

    Attributes
    ----------
    S_zt, S_tt, S_xt : ndarray of shape (n_features,)
        sum over samples of <z_m t_m>, <t_m^2>, x_m <t_m>.
    S_rr : float
        sum over samples of <(y - 1'z)^2>.
    S_xe, S_ee : ndarray of shape (n_features,), float
        sum of x_m e and e^2, with e = y - coef'x.
    coef : ndarray of shape (n_features,)
        Coefficient of E[y | x] for noisy x in this state.
    y_var : float
        Variance of y given x.
    x_var : ndarray of shape (n_features,)
        Marginal variance of x.
    t_precision : ndarray of shape (n_features,)
        Prior precision of t, raised by the uncertainty of the loadings.
    t_gain, t_step : ndarray of shape (n_features,)
        <t_m> = t_gain_m x_m + t_step_m e / y_var.
    t_var : ndarray of shape (n_features,)
        Posterior variance of t_m.
    """

    S_zt: np.ndarray
    S_tt: np.ndarray
    S_xt: np.ndarray
    S_rr: float
    S_xe: np.ndarray
    S_ee: float
    coef: np.ndarray
    y_var: float
    x_var: np.ndarray
    t_precision: np.ndarray
    t_gain: np.ndarray
    t_step: np.ndarray
    t_var: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Prior:
    """What is assumed before the data.

    Attributes
    ----------
    ard : bool
        Loadings have ARD priors (VB-JFA); otherwise they are point estimates (JFA).
    coupled : bool
        alpha_m is shared by w_zm and w_xm, as in the paper; otherwise it is the
        precision of w_zm alone and w_xm is a point estimate.
    ard_shape, ard_rate : float
        Gamma prior of the precisions.
    psi_x_fixed : ndarray of shape (n_features,) or None
        Known input-noise variances (standardised); None estimates them.
    psi_x_weight : float
        Weight, in samples, of the inverse-gamma prior on psi_x; 0 is no prior.
    psi_x_mode : ndarray of shape (n_features,) or None
        Mode of that prior (standardised).
    """

    ard: bool = False
    coupled: bool = True
    ard_shape: float = 1e-6
    ard_rate: float = 1e-6
    psi_x_fixed: np.ndarray | None = None
    psi_x_weight: float = 0.0
    psi_x_mode: np.ndarray | None = None
