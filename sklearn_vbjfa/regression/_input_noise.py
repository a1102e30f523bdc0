"""Input noise as the user gives it: validated, and for standardised columns."""

import warnings

import numpy as np
from sklearn.utils import check_array

from sklearn_vbjfa._core._correlated import direct_share
from sklearn_vbjfa._core._linear_systems import or_one, scaled_eigen

# A covariance lies outside of the noise's own span by more than this share: rounding.
_OF_RANGE = 1e-6


def resolve_input_noise(input_noise, n_features):
    """Validate the user's input noise; return None, a fraction, (d,) or (d, d)."""
    if input_noise is None:
        return None
    value = np.asarray(input_noise, dtype=float)
    if not np.isfinite(value).all():
        raise ValueError("input_noise must be finite, got NaN or infinity.")
    if value.ndim == 0:
        if not 0 <= value < 1:
            raise ValueError(
                f"input_noise as a number is a fraction of each input's variance in "
                f"[0, 1), got {float(value):.6g}; give variances as an array."
            )
        return float(value)
    if value.shape == (n_features,):
        if value.min() < 0:
            raise ValueError(
                f"input_noise variances must not be negative, got {value.min():.6g} "
                f"for feature {int(value.argmin())}; give 0 for an exact input."
            )
        return value
    if value.shape == (n_features, n_features):
        scale = np.sqrt(np.abs(np.diagonal(value)))
        unit = np.outer(scale, scale)
        if (np.abs(value - value.T) > 1e-8 * unit).any():
            raise ValueError("input_noise as a covariance must be symmetric.")
        scale = or_one(scale)
        smallest = scaled_eigen(0.5 * (value + value.T), scale=scale).values[0]
        if smallest < -1e-8 or (np.diagonal(value) < 0).any():
            raise ValueError(
                "input_noise as a covariance must be positive semidefinite, got a "
                f"smallest eigenvalue of {smallest:.3g} in units of its diagonal."
            )
        return 0.5 * (value + value.T)
    raise ValueError(
        f"input_noise must be a fraction, variances of shape ({n_features},) or a "
        f"covariance of shape ({n_features}, {n_features}) for {n_features} features, "
        f"got an array of shape {value.shape}."
    )


def standard_noise(noise, data):
    """Noise covariance (d, d) of the standardised active columns; None is unknown."""
    if noise is None:
        return None
    if np.ndim(noise) == 0:
        return noise * np.eye(data.x_scale.size)
    full = np.diag(noise) if np.ndim(noise) == 1 else noise
    unit = np.outer(data.x_scale, data.x_scale)
    return full[np.ix_(data.active, data.active)] / unit


def resolve_cross_noise(cross, noise, data):
    """Validate a covariance of the noise of inputs and output; standardised (d,)."""
    if cross is None:
        return None
    value = check_array(cross, ensure_2d=False, input_name="input_output_noise")
    if value.shape != data.active.shape:
        raise ValueError(
            f"input_output_noise must hold {data.active.size} covariances, one for "
            f"each input; got an array of shape {value.shape}."
        )
    if noise is None:
        raise ValueError(
            "input_output_noise needs the noise of the inputs as well: give "
            "input_noise as variances or a covariance."
        )
    psi = standard_noise(noise, data)
    cross = value[data.active] / (data.x_scale * (data.y_scale or 1.0))
    off = np.abs(psi @ direct_share(psi, cross) - cross)
    bad = np.flatnonzero(off > _OF_RANGE * np.abs(cross).max(initial=0.0))
    if bad.size:
        raise ValueError(
            "input_output_noise must be a covariance with noise that the inputs have; "
            f"for input {np.flatnonzero(data.active)[bad[0]]} input_noise says that "
            "there is none. Give its variance in input_noise, or zero here."
        )
    return cross


def noise_shares(noise, data, names):
    """Shares (n_active,) of the inputs' variances that are noise, None if unknown."""
    # A share of 1 marks an input that holds no signal beyond its noise; the user is
    # warned of it.
    if noise is None:
        return None
    n_active = data.x_scale.shape[0]
    if np.ndim(noise) == 0:
        return np.full(n_active, noise)
    if np.ndim(noise) == 2:
        off = noise - np.diag(np.diagonal(noise))
        if np.any(off):
            raise ValueError(
                "input_noise with covariances between inputs needs "
                'latent="correlated"; with independent latents give the variances '
                "alone, of shape (n_features,)."
            )
        noise = np.diagonal(noise)
    share = noise[data.active] / data.x_scale**2
    full = np.flatnonzero(data.active)[share >= 1.0]
    if full.size:
        shown = ", ".join(str(names[i]) for i in full[:10])
        warnings.warn(
            f"input_noise is at least the whole variance of {full.size} input(s) "
            f"({shown}): they hold no signal beyond noise and get the coefficient 0. "
            "Check the units of input_noise (variances, not standard deviations).",
            UserWarning,
            stacklevel=6,
        )
    return np.minimum(share, 1.0)
