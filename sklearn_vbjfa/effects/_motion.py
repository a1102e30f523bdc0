"""Signals of recordings, from which effects compute their torques.

A law is written once, for floats and for arrays: `Arrays` and `Floats` provide the
mathematical functions, `State` the signals by joint.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import erf

# Quantile of a joint's speed that counts as its maximum, so that outliers do not.
FAST = 0.995
# Intervals of velocity narrower than this multiple of the noise are neglected.
_NARROW = 1e-3
_TINY = float(np.finfo(float).tiny)
# Signals of a `Motion` that predictions clip to the ranges of the fit.
HELD = {"position": "q", "speed": "v", "load": "load"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """Parameters of the mean sign of the velocity of joints that may be at rest."""

    # The sign of a velocity is its expectation over the true velocity, s(v, a) =
    # E[sign(v + u + e)], u ~ U(-w, w), e ~ N(0, sigma^2), w = v_s / (1 + |a| T / v_s).
    # Without u this is erf(v / (sqrt(2) sigma)). Below the speed v_s a joint may stick;
    # a joint that reverses does not, its velocity changes by abs(a) T within time T.

    # (nv,): v_s, speed up to which a joint may be sticking [rad/s or m/s]
    speed: np.ndarray
    # (nv,): T, shortest time of sticking [s]: the fastest period; 0 if unknown
    time: np.ndarray
    noise: np.ndarray  # (nv,): sigma, of the velocities [rad/s or m/s]
    # (nv,) each: half of the jump of the acceleration where the true velocity changes
    # sign, a corner that smoothing rounds off, and the time over which it does so, see
    # `StateEstimator.rounding` [rad/s^2 or m/s^2, s]
    corner: np.ndarray | float = 0.0
    rounding: np.ndarray | float = 0.0
    # (2, nv): half of the largest change of an estimated position at rest [rad or m],
    # and the same for joints that stop at reversals, else 0: plays through which
    # Coulomb friction and other friction with memory follow the position
    play: np.ndarray | None = None
    span: float = 0.0  # time over which the sign of a sample is averaged [s]

    def plays(self, joint):
        """Return the widths of both plays of a joint [rad or m], two floats."""
        return (0.0, 0.0) if self.play is None else tuple(2 * self.play[:, joint])

    def pick(self, *joints):
        """Return the parameters of one joint, or of the sum of several joint speeds."""
        indices, shape = list(joints), self.speed.shape
        return Rest(
            speed=self.speed[indices].sum(keepdims=True),
            time=self.time[indices].max(keepdims=True),
            noise=np.sqrt((self.noise[indices] ** 2).sum(keepdims=True)),
            corner=np.broadcast_to(self.corner, shape)[indices].sum(keepdims=True),
            rounding=np.broadcast_to(self.rounding, shape)[indices].max(keepdims=True),
            span=self.span,
        )

    def sign(self, v, a):
        """Mean sign of velocities (n, nv) with accelerations (n, nv)."""
        # If abs(a) is less than half the jump, the joint sticks after the reversal.
        v = v + self.rounding * np.clip(a, -self.corner, self.corner)
        change = np.abs(a) * self.time
        # v_s / (1 + change / v_s), zero if v_s is zero
        width = self.speed**2 / np.maximum(self.speed + change, _TINY)
        width = width + 0.5 * self.span * np.abs(a)
        signs = [_mean_sign(*signals) for signals in zip(v.T, width.T, self.noise)]
        return np.column_stack(signs)


def _mean_sign(v, width, noise):
    """Mean sign of one joint's velocities (n,), see `Rest`."""
    if not noise > 0:
        # An empty interval leaves the sign itself.
        inside = np.abs(v) < width
        return np.divide(v, width, out=np.sign(v), where=inside)
    normal_mean = erf(v / (np.sqrt(2) * noise))
    # For an interval much narrower than the noise, the difference is a rounding error.
    wide = width > _NARROW * noise
    w = np.where(wide, width, 1.0)
    interval_mean = (_mean_abs(v + w, noise) - _mean_abs(v - w, noise)) / (2 * w)
    return np.where(wide, interval_mean, normal_mean)


def _mean_abs(v, noise):
    """Mean of abs(v + e) for normal e; its derivative is the mean sign."""
    x = v / (np.sqrt(2) * noise)
    return v * erf(x) + noise * np.sqrt(2 / np.pi) * np.exp(-(x**2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Signals of one or several recordings at the full sample rate."""

    q: np.ndarray  # (n, nv): positions [rad or m], with velocities and accelerations
    v: np.ndarray
    a: np.ndarray
    t: np.ndarray | None = None  # (n,): time [s], increasing over all recordings
    load: np.ndarray | None = None  # (n, nv): torques of the rigid bodies [N m or N]
    torque: np.ndarray | None = None  # (n, nv): torques of the whole model
    parts: tuple = ()  # slices of the recordings; effects are reset between them
    prismatic: np.ndarray | None = None  # (nv,), bool
    rigid: Callable | None = None  # (q, v, a) -> torques (n, nv) of the rigid bodies
    # joint at the end of a branch -> regressor of its body, () -> (n, nv, 10)
    end_bodies: Mapping | None = None
    # of the rigid-body torques by the geometry, `TorqueDerivatives`; see `InModel`
    derivatives: object | None = None
    bandwidth: float = np.inf  # highest frequency of the fit [Hz]
    # start times of the recordings [s], if their first rows are not included
    begins: tuple | None = None
    # for the mean sign of velocities; None for the sign itself, as in a fit, where
    # equations of joints that may be sticking are masked
    rest: Rest | None = None
    # first time of the fit [s]: effects of time are constant before it
    since: float | None = None
    signals: Mapping = field(default_factory=dict)  # (n,) by name
    command: np.ndarray | None = None  # (n, nv): commanded torques, `CommandDelay`
    # joint -> positions of its reversals before each part, (k,); None if unknown
    before: Callable | None = None
    # (nv, n_waves): peaks above the low-pass, in periods per position [1/rad or 1/m]
    waves: np.ndarray | None = None
    _speeds: dict = field(default_factory=dict, repr=False)

    def __post_init__(self):
        if not self.parts:
            object.__setattr__(self, "parts", (slice(0, self.q.shape[0]),))
        if self.prismatic is None:
            object.__setattr__(self, "prismatic", np.zeros(self.q.shape[1], bool))

    n_joints = property(lambda self: self.q.shape[1])

    @property
    def later(self):
        """Start times of all recordings but the first [s]."""
        starts = self.begins or [self.t[part.start] for part in self.parts]
        return np.asarray(starts[1:], dtype=float)

    def speed(self, joint):
        """Largest speed of a joint without outliers [rad/s or m/s]."""
        if joint not in self._speeds:
            self._speeds[joint] = float(np.quantile(np.abs(self.v[:, joint]), FAST))
        return self._speeds[joint]

    def range(self, joint):
        """Range of a joint's positions [rad or m]."""
        return float(np.ptp(self.q[:, joint]))

    def derivative(self, signal):
        """Differentiate columns (n, ...) with respect to time in each recording."""
        out = np.zeros_like(signal)
        for part in self.parts:
            if part.stop - part.start > 2:
                out[part] = np.gradient(signal[part], self.t[part], axis=0)
        return out


class Arrays:
    """Mathematical functions of arrays (n,) for `Effect.law`."""

    exp, cos, sin, sqrt, sign_of = np.exp, np.cos, np.sin, np.sqrt, np.sign

    def __init__(self, rest):
        self.rest = rest

    def sign(self, *joints):
        """Return (v, a) -> mean sign of a joint velocity, or of a sum of velocities."""
        if self.rest is None:
            return lambda v, a: np.sign(v)
        rest = self.rest.pick(*joints)
        return lambda v, a: rest.sign(v[:, None], a[:, None])[:, 0]


class Floats:
    """The same functions of floats of one state, whose velocities are noise-free."""

    exp, cos, sin, sqrt = math.exp, math.cos, math.sin, math.sqrt

    @staticmethod
    def sign_of(x):
        return (x > 0) - (x < 0)

    def __init__(self, rest):
        self.rest = rest

    def sign(self, *joints) -> Callable:
        """Return (v, a) -> mean sign of a velocity, as `Arrays.sign`."""
        rest = None if self.rest is None else self.rest.pick(*joints)
        speed = 0.0 if rest is None else float(rest.speed[0])
        time = 0.0 if rest is None else float(rest.time[0])
        square = speed * speed

        def sign(v, a):
            width = square / max(speed + abs(a) * time, _TINY)
            if -width < v < width:
                return v / width
            return 1.0 if v > 0 else -1.0 if v < 0 else v

        return sign


@dataclass(slots=True)
class State:
    """Signals by joint: floats of one state, or arrays (n,) from `rows_of`."""

    q: list = field(default_factory=list)
    v: list = field(default_factory=list)
    a: list = field(default_factory=list)
    # [s]; clipped_t is never before the first time of the fit
    t: float | None = None
    clipped_t: float | None = None
    # torques of the rigid bodies and of the whole model, for load-dependent effects
    load: list | None = None
    torque: list | None = None
    signals: dict = field(default_factory=dict)  # recorded signals by name


def rows_of(motion):
    """Return the signals of a `Motion` as a `State` of arrays."""
    load, torque, clipped_t = motion.load, motion.torque, motion.t
    if clipped_t is not None and motion.since is not None:
        clipped_t = np.maximum(clipped_t, motion.since)
    return State(
        q=motion.q.T,
        v=motion.v.T,
        a=motion.a.T,
        t=motion.t,
        clipped_t=clipped_t,
        load=None if load is None else load.T,
        torque=None if torque is None else torque.T,
        signals=motion.signals,
    )
