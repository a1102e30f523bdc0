"""Dry friction of a joint that hardly moves: the mean of the sign of its velocity."""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """What is known of the speed of joints that may be standing."""

    # The sign of a velocity is its mean over what the true velocity may be, s(v, a) =
    # E[sign(v + u + e)], u ~ U(-w, w), e ~ N(0, sigma^2), w = v_s / (1 + |a| T / v_s).
    # Without u this is erf(v / (sqrt(2) sigma)). Below the speed v_s a joint may be
    # sticking, and friction may have any value of its band. A joint that turns round
    # passes those speeds without standing: with the acceleration a it changes its speed
    # by abs(a) T in the time T, and the more times v_s that is, the narrower is the
    # interval.

    # (nv,): v_s, at or below which a joint may be standing [rad/s or m/s]
    speed: np.ndarray
    # (nv,): T, for which a joint stands at least [s]: the fastest period; 0 if unknown
    time: np.ndarray
    noise: np.ndarray  # (nv,): sigma, of the velocities [rad/s or m/s]

    def pick(self, *joints):
        """Return what holds for a joint, or for the sum of the speeds of several."""
        own = list(joints)
        return Rest(
            speed=self.speed[own].sum(keepdims=True),
            time=self.time[own].max(keepdims=True),
            noise=np.sqrt((self.noise[own] ** 2).sum(keepdims=True)),
        )

    def sign(self, v, a, smoothing=0.0):
        """Mean sign of velocities (n, nv) with accelerations (n, nv)."""
        # That of tanh(v / smoothing) where a speed is given.
        passed = np.abs(a) * self.time
        # vs / (1 + passed / vs), and zero where vs is
        width = self.speed**2 / np.maximum(self.speed + passed, _TINY)
        mean = _mean_sign if not smoothing > 0 else _mean_tanh(smoothing)
        columns = [mean(*column) for column in zip(v.T, width.T, self.noise)]
        return np.column_stack(columns)


_TINY = np.finfo(float).tiny


def _mean_sign(v, width, noise):
    """Mean sign of one joint's velocities (n,), see `Rest`."""
    if not noise > 0:
        # Where the interval is empty this is the sign.
        inside = np.abs(v) < width
        return np.divide(v, width, out=np.sign(v), where=inside)
    plain = erf(v / (np.sqrt(2) * noise))
    # An interval that is narrow beside the noise changes nothing, and a difference of
    # its ends would be one of rounding.
    wide = width > 1e-3 * noise
    w = np.where(wide, width, 1.0)
    spread = (_mean_size(v + w, noise) - _mean_size(v - w, noise)) / (2 * w)
    return np.where(wide, spread, plain)


def _mean_size(v, noise):
    """Mean of abs(v + e) for normal e, whose derivative is the mean sign."""
    x = v / (np.sqrt(2) * noise)
    return v * erf(x) + noise * np.sqrt(2 / np.pi) * np.exp(-(x**2))


def _mean_tanh(smoothing):
    """Return the mean of tanh(v / smoothing) in place of that of the sign."""

    def mean(v, width, noise):
        # tanh(v / s) has the slope of a mean sign under noise of sqrt(2 / pi) s: the
        # noise of the velocity adds to it as variances do.
        s = np.sqrt(smoothing**2 + 0.5 * np.pi * noise**2)
        wide = width > 1e-3 * s
        w = np.where(wide, width, 1.0)
        spread = s * (_log_cosh((v + w) / s) - _log_cosh((v - w) / s)) / (2 * w)
        return np.where(wide, spread, np.tanh(v / s))

    return mean


def _log_cosh(x):
    x = np.abs(x)
    return x + np.log1p(np.exp(-2 * x)) - np.log(2)


def mean_sign(v, a, rest, smoothing=0.0):
    """Sign of velocities (n, nv), or tanh; its mean where a `Rest` is given."""
    if rest is not None:
        return rest.sign(v, a, smoothing)
    return np.tanh(v / smoothing) if smoothing > 0 else np.sign(v)
