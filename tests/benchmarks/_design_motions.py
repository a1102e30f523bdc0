"""Limits of a motion, and random periodic motions that touch them.

Nothing here uses the code of the package: what is judged must not make its own rivals.
"""

import functools
import warnings
from dataclasses import dataclass

import numpy as np
from _undeclared_robots import inverse_dynamics

# Amplitudes of the k-th harmonic fall with k to the power of one of these, so that
# there are wide slow motions and short quick ones among the rivals.
SLOPES = (0.0, 1.0, 2.0)
# Looks at a motion in a period of its highest harmonic; a peak between them is 0.5 %
# higher at most.
LOOKS = 32
# Centres lie in this share of the range.
CENTRES = 0.5
# Harmonics of one motion that are tried, with new centres, until gravity is held.
ATTEMPTS = 50
# Amplitude of a harmonic over the largest one below which it is none.
ABSENT = 1e-4
# Looks at a period when harmonics are counted.
HARMONIC_LOOKS = 2048


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of a motion.

    Parameters
    ----------
    position : ndarray of shape (nv, 2)
        Lower and upper limits [rad or m].
    velocity, acceleration, torque : ndarray of shape (nv,)
        Largest sizes [rad/s, rad/s^2, N m, or those of a slide].
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray

    def part(self, *, range_share, speed_share, acceleration_share):
        """Take shares of the range, of speed and of acceleration."""
        middle = self.position.mean(axis=1)
        half = 0.5 * range_share * np.diff(self.position, axis=1)[:, 0]
        return Limits(
            np.column_stack([middle - half, middle + half]),
            speed_share * self.velocity,
            acceleration_share * self.acceleration,
            self.torque,
        )

    def of_package(self):
        """Make the limits that the package takes."""
        from sklearn_vbjfa.design import MotionLimits

        return MotionLimits(
            position=self.position,
            velocity=self.velocity,
            acceleration=self.acceleration,
            torque=self.torque,
        )

    def margins(self, q, v, a, tau):
        """Smallest distance to each limit over that limit, dict of (nv,).

        Of positions it is the distance to the nearer end over half the range.
        """
        low, high = self.position.T
        half = 0.5 * (high - low)
        return {
            "position": (np.minimum(q - low, high - q) / half).min(axis=0),
            "velocity": 1.0 - np.abs(v).max(axis=0) / self.velocity,
            "acceleration": 1.0 - np.abs(a).max(axis=0) / self.acceleration,
            "torque": 1.0 - np.abs(tau).max(axis=0) / self.torque,
        }


@dataclass(frozen=True, eq=False)
class Series:
    """Finite Fourier series in every joint.

    Parameters
    ----------
    centre : ndarray of shape (nv,)
        Mean positions.
    cosines, sines : ndarray of shape (nv, n_harmonics)
        Coefficients of the harmonics 1, 2, ...
    period : float
        Period [s].
    """

    centre: np.ndarray
    cosines: np.ndarray
    sines: np.ndarray
    period: float

    def at(self, t):
        """Return q, v and a at the times t, each of shape (n, nv)."""
        w = 2.0 * np.pi / self.period * np.arange(1, self.cosines.shape[1] + 1)
        c, s = np.cos(np.outer(t, w)), np.sin(np.outer(t, w))
        A, B = self.cosines.T, self.sines.T
        q = self.centre + c @ A + s @ B
        v = c @ (w[:, None] * B) - s @ (w[:, None] * A)
        a = -c @ (w[:, None] ** 2 * A) - s @ (w[:, None] ** 2 * B)
        return q, v, a

    def scaled(self, factor):
        """Multiply the amplitudes by a factor, one for all joints or one for each."""
        factor = np.broadcast_to(factor, self.centre.shape)[:, None]
        return Series(
            self.centre, factor * self.cosines, factor * self.sines, self.period
        )


def draw_series(limits, period, n_harmonics, rng):
    """Draw a series that stands still at the start, as wide as its joints can go.

    Each joint touches its nearest limit of position, speed or acceleration; the
    torques are not looked at.
    """
    nv = len(limits.velocity)
    k = np.arange(1, n_harmonics + 1)
    slope = rng.choice(SLOPES, size=(nv, 1))
    cosines, sines = rng.normal(size=(2, nv, n_harmonics)) / k**slope
    # No speed and no acceleration at t = 0: sum of k B and sum of k^2 A are zero. What
    # is taken away follows the amplitudes, so that their slope stays.
    size = 1.0 / k ** (2 * slope)
    sines = sines - size * k * ((sines @ k) / (size @ k**2.0))[:, None]
    cosines = cosines - size * k**2 * ((cosines @ k**2) / (size @ k**4.0))[:, None]
    low, high = limits.position.T
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    centre = middle + CENTRES * half * rng.uniform(-1.0, 1.0, size=nv)
    shape = Series(np.zeros(nv), cosines, sines, period)
    q, v, a = shape.at(_looks(period, n_harmonics))
    room = np.min(
        [
            (high - centre) / q.max(axis=0),
            (centre - low) / -q.min(axis=0),
            limits.velocity / np.abs(v).max(axis=0),
            limits.acceleration / np.abs(a).max(axis=0),
        ],
        axis=0,
    )
    return Series(centre, cosines, sines, period).scaled(room)


def _looks(period, n_harmonics):
    n = LOOKS * n_harmonics
    return period * np.arange(n) / n


def rigid(model):
    """Return the torque of a model's rigid bodies, as `random_motion` takes it."""
    return functools.partial(inverse_dynamics, model)


def identified(identifier):
    """Return the torque of an identified robot, as `random_motion` takes it."""

    def torque(q, v, a):
        # quicker than the recording that it was fitted to, and meant to be
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            return identifier.predict(np.hstack([q, v, a]))

    return torque


def random_motion(torque, limits, period, n_harmonics, rng):
    """Draw a random motion that touches its limits, that of the torque included.

    Parameters
    ----------
    torque : callable
        (q, v, a) -> torques (n, nv) of the robot.
    limits : Limits
        Limits.
    period : float
        Period [s].
    n_harmonics : int
        Number of harmonics, at least three.
    rng : numpy.random.Generator
        Source of everything random.

    Returns
    -------
    Series
        Motion; each joint is at a limit of position, speed or acceleration, or all are
        shrunk together until one is at that of its torque.
    """
    looks = _looks(period, n_harmonics)

    def load(motion):
        return np.max(np.abs(torque(*motion.at(looks))) / limits.torque)

    for _ in range(ATTEMPTS):
        motion = draw_series(limits, period, n_harmonics, rng)
        if load(motion) <= 1.0:
            return motion
        still = np.zeros((1, motion.centre.size))
        held = torque(motion.centre[None], still, still)
        if np.any(np.abs(held) > 0.9 * limits.torque):
            continue
        low, high = 0.0, 1.0
        for _ in range(8):
            middle = 0.5 * (low + high)
            if load(motion.scaled(middle)) > 1.0:
                high = middle
            else:
                low = middle
        if low > 0.0:
            return motion.scaled(low)
    raise ValueError(f"No random motion within the limits in {ATTEMPTS} attempts.")


def top_harmonic(motion, period):
    """Highest harmonic of a periodic motion: its rivals have as many as it has.

    `motion` has ``at(t)``, as `Series`; `period` is in s.
    """
    q, _, _ = motion.at(np.arange(HARMONIC_LOOKS) * period / HARMONIC_LOOKS)
    share = np.abs(np.fft.rfft(q - q.mean(axis=0), axis=0)).max(axis=1)
    return int(np.flatnonzero(share > ABSENT * share.max())[-1])


class Designed:
    """A designed motion, executed as a `Series` is.

    Parameters
    ----------
    motion : DesignedMotion
        Motion of the package.
    """

    def __init__(self, motion):
        self.motion = motion

    def at(self, t):
        """Return q, v and a at the times t, each of shape (n, nv)."""
        return np.split(np.asarray(self.motion.states(t)), 3, axis=1)
