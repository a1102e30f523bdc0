"""The motion of which effects are functions.

A law is written once, for floats and for arrays: `Arrays` and `Floats` have the
functions that it is made of, `State` the signals by joint.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import erf

# Speeds are scaled by this quantile of a joint's speed: its fastest, without outliers.
FAST = 0.995
# An interval of speeds below this share of the noise is none.
_NARROW = 1e-3
_TINY = float(np.finfo(float).tiny)
# Signals of a motion that a fit holds within the ranges that it has seen.
HELD = {"position": "q", "speed": "v", "load": "load"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """Speed of joints that may be at rest."""

    # The sign of a velocity is its mean over what the true velocity may be, s(v, a) =
    # E[sign(v + u + e)], u ~ U(-w, w), e ~ N(0, sigma^2), w = v_s / (1 + |a| T / v_s).
    # Without u this is erf(v / (sqrt(2) sigma)). Below the speed v_s a joint may stick;
    # one that turns round passes those speeds without standing, by abs(a) T in time T.

    # (nv,): v_s, at or below which a joint may be standing [rad/s or m/s]
    speed: np.ndarray
    # (nv,): T, for which a joint stands at least [s]: the fastest period; 0 if unknown
    time: np.ndarray
    noise: np.ndarray  # (nv,): sigma, of the velocities [rad/s or m/s]
    # (nv,) each: half of the jump of the acceleration where the true velocity turns, of
    # which the estimated one rounds the corner, and the time over which it does so, see
    # `StateEstimator.rounding` [rad/s^2 or m/s^2, s]
    corner: np.ndarray | float = 0.0
    rounding: np.ndarray | float = 0.0
    span: float = 0.0  # time around a row over which its sign is averaged [s]

    def pick(self, *joints):
        """Return the part of a joint, or of the sum of the speeds of several."""
        own, shape = list(joints), self.speed.shape
        return Rest(
            speed=self.speed[own].sum(keepdims=True),
            time=self.time[own].max(keepdims=True),
            noise=np.sqrt((self.noise[own] ** 2).sum(keepdims=True)),
            corner=np.broadcast_to(self.corner, shape)[own].sum(keepdims=True),
            rounding=np.broadcast_to(self.rounding, shape)[own].max(keepdims=True),
            span=self.span,
        )

    def sign(self, v, a):
        """Mean sign of velocities (n, nv) with accelerations (n, nv)."""
        # Where the jump is larger than the acceleration can be, the joint stays.
        v = v + self.rounding * np.clip(a, -self.corner, self.corner)
        passed = np.abs(a) * self.time
        # vs / (1 + passed / vs), and zero where vs is
        width = self.speed**2 / np.maximum(self.speed + passed, _TINY)
        width = width + 0.5 * self.span * np.abs(a)
        columns = [_mean_sign(*column) for column in zip(v.T, width.T, self.noise)]
        return np.column_stack(columns)


def _mean_sign(v, width, noise):
    """Mean sign of one joint's velocities (n,), see `Rest`."""
    if not noise > 0:
        # Where the interval is empty this is the sign.
        inside = np.abs(v) < width
        return np.divide(v, width, out=np.sign(v), where=inside)
    plain = erf(v / (np.sqrt(2) * noise))
    # An interval that is narrow beside the noise changes nothing, and a difference of
    # its ends would be one of rounding.
    wide = width > _NARROW * noise
    w = np.where(wide, width, 1.0)
    spread = (_mean_size(v + w, noise) - _mean_size(v - w, noise)) / (2 * w)
    return np.where(wide, spread, plain)


def _mean_size(v, noise):
    """Mean of abs(v + e) for normal e, whose derivative is the mean sign."""
    x = v / (np.sqrt(2) * noise)
    return v * erf(x) + noise * np.sqrt(2 / np.pi) * np.exp(-(x**2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Signals of one or several recordings, all at the full sample rate."""

    q: np.ndarray  # (n, nv): positions [rad or m], with velocities and accelerations
    v: np.ndarray
    a: np.ndarray
    t: np.ndarray | None = None  # (n,): time [s], rising over all recordings
    load: np.ndarray | None = None  # (n, nv): torques of the rigid bodies [N m or N]
    torque: np.ndarray | None = None  # (n, nv): torques of the whole model
    parts: tuple = ()  # slices: recordings, across whose borders there is no memory
    prismatic: np.ndarray | None = None  # (nv,), bool
    rigid: Callable | None = None  # (q, v, a) -> torques (n, nv) of the rigid bodies
    # () -> regressor of the last body's inertial parameters, (n, nv, 10)
    last_body: Callable | None = None
    # of the rigid bodies' torques by the robot's geometry; see `InModel`
    derivatives: object | None = None
    bandwidth: float = np.inf  # highest frequency that will be looked at [Hz]
    # when recordings begin [s], if their first rows are left out here
    begins: tuple | None = None
    # for the mean sign of velocities; None takes the sign itself, as a fit does, whose
    # equations are masked where a joint may be standing
    rest: Rest | None = None
    # first time of the fit [s]: before it an effect of time is as it was then
    since: float | None = None
    signals: Mapping = field(default_factory=dict)  # (n,) by name, in their own units
    command: np.ndarray | None = None  # (n, nv): torques by commands, `CommandDelay`
    # joint -> where it turned before each part, (k,); None if unknown
    before: Callable | None = None
    # (nv, n_waves): waves of the position [1/rad or 1/m] that stand out above the band
    waves: np.ndarray | None = None
    _speeds: dict = field(default_factory=dict, repr=False)

    def __post_init__(self):
        if not self.parts:
            object.__setattr__(self, "parts", (slice(0, self.q.shape[0]),))
        if self.prismatic is None:
            object.__setattr__(self, "prismatic", np.zeros(self.q.shape[1], bool))

    @property
    def n_joints(self):
        return self.q.shape[1]

    @property
    def later(self):
        """When recordings begin [s], but for the first."""
        starts = self.begins or [self.t[part.start] for part in self.parts]
        return np.asarray(starts[1:], dtype=float)

    def speed(self, joint):
        """Fastest speed of a joint, outliers aside [rad/s or m/s]."""
        if joint not in self._speeds:
            self._speeds[joint] = float(np.quantile(np.abs(self.v[:, joint]), FAST))
        return self._speeds[joint]

    def range(self, joint):
        """Range of a joint's positions [rad or m]."""
        return float(np.ptp(self.q[:, joint]))

    def derivative(self, signal):
        """Differentiate columns (n, ...) in time, recording by recording."""
        out = np.zeros_like(signal)
        for part in self.parts:
            if part.stop - part.start > 2:
                out[part] = np.gradient(signal[part], self.t[part], axis=0)
        return out


# -- what laws are made of -----------------------------------------------------------


class Arrays:
    """Functions of signals (n,) of a recording; see `Effect.law`."""

    exp, cos, sin, sqrt, sign_of = np.exp, np.cos, np.sin, np.sqrt, np.sign

    def __init__(self, rest):
        self.rest = rest

    def sign(self, *joints):
        """Return (v, a) -> mean sign of the speed of a joint, or of a sum of speeds."""
        if self.rest is None:
            return lambda v, a: np.sign(v)
        rest = self.rest.pick(*joints)
        return lambda v, a: rest.sign(v[:, None], a[:, None])[:, 0]


class Floats:
    """The same of the numbers of one state, whose velocities have no noise."""

    exp, cos, sin, sqrt = math.exp, math.cos, math.sin, math.sqrt

    @staticmethod
    def sign_of(x):
        return (x > 0) - (x < 0)

    def __init__(self, rest):
        self.rest = rest

    def sign(self, *joints) -> Callable:
        """Return (v, a) -> mean sign of a speed, as `Arrays.sign`."""
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
    """One state: floats by joint; or, of `rows_of`, signals (n,) by joint."""

    q: list = field(default_factory=list)
    v: list = field(default_factory=list)
    a: list = field(default_factory=list)
    # [s]; known_t is not earlier than the fit
    t: float | None = None
    known_t: float | None = None
    # torques of the rigid bodies and of the whole model for effects of the load
    load: list | None = None
    torque: list | None = None
    signals: dict = field(default_factory=dict)  # what is recorded beside the motion


def rows_of(motion):
    """Return the signals of a `Motion` as those of a `State`."""
    load, torque, known_t = motion.load, motion.torque, motion.t
    if known_t is not None and motion.since is not None:
        known_t = np.maximum(known_t, motion.since)
    return State(
        q=motion.q.T,
        v=motion.v.T,
        a=motion.a.T,
        t=motion.t,
        known_t=known_t,
        load=None if load is None else load.T,
        torque=None if torque is None else torque.T,
        signals=motion.signals,
    )
