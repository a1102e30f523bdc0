"""Filtered channels of a log, and changes that would undo what was done to them."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.recording import contiguous_groups


@dataclass(frozen=True, kw_only=True)
class Change:
    """A reading of a log that differs from the unchanged log.

    Attributes
    ----------
    positions, torques : ndarray of shape (nv,) or None
        Channel to read for each joint; None for its own.
    factor, offset : float or ndarray of shape (nv,)
        Positions are multiplied by a factor, then an offset is added [rad or m].
    scale : float or ndarray of shape (nv,)
        Torques are multiplied by it.
    period : float
        The sample period is multiplied by it.
    gravity : ndarray of shape (3,) or None
        Gravity of the description [m/s^2]; None for its own.
    lag : int
        Samples by which torques are late.
    """

    positions: np.ndarray | None = None
    torques: np.ndarray | None = None
    factor: object = 1.0
    offset: object = 0.0
    scale: object = 1.0
    period: float = 1.0
    gravity: np.ndarray | None = None
    lag: int = 0

    def signals(self, signals):
        """Return filtered signals that are read in this way."""
        nv = signals.sign.shape[1]
        if not self.moves:
            return self._torques_of(signals)
        states = signals.states.reshape(-1, 3, nv)
        sign, weight = signals.sign, signals.weight
        if self.positions is not None:
            states = states[:, :, self.positions]
            sign, weight = sign[:, self.positions], weight[:, self.positions]
        factor = np.broadcast_to(self.factor, nv)
        states = states * factor / self.period ** np.arange(3)[:, None]
        states[:, 0] += self.offset
        signals = replace(
            signals,
            states=states.reshape(len(states), -1),
            sign=sign * np.sign(factor),
            weight=weight,
        )
        return self._torques_of(signals)

    @property
    def moves(self):
        """Whether it changes the motion."""
        changes = (self.factor, 1.0), (self.offset, 0.0), (self.period, 1.0)
        return self.positions is not None or any(np.any(x != y) for x, y in changes)

    def _torques_of(self, signals):
        tau, nv = signals.tau, signals.sign.shape[1]
        if self.torques is not None:
            tau = tau[:, self.torques]
        if np.any(np.not_equal(self.scale, 1.0)):
            tau = tau * np.broadcast_to(self.scale, nv)[:, None]
        return replace(signals, tau=tau)

    def arrays(self, q, tau, dt):
        """Return positions, torques and period of a log that is changed in this way."""
        q = q if self.positions is None else q[:, self.positions]
        tau = tau if self.torques is None else tau[:, self.torques]
        return q * self.factor + self.offset, tau * self.scale, dt * self.period

    def model(self, model):
        """Return the robot with the gravity of this reading."""
        if self.gravity is None:
            return model
        model = model.copy()
        model.gravity.linear = self.gravity
        return model


@dataclass(frozen=True, kw_only=True)
class Signals:
    """Channels of a log, filtered and decimated."""

    states: np.ndarray  # (n, 3 nv): [q | v | a]
    sign: np.ndarray  # (n, nv): filtered signs of the velocities
    # (n, nv, n_shifts): torques that are read `shifts` samples after the positions
    tau: np.ndarray
    weight: np.ndarray  # (n, nv): 1 where the joint moves and no fault is known, else 0
    row: np.ndarray  # (n,): row of the log in the middle of the filter
    shifts: np.ndarray  # (n_shifts,): samples; the middle one is zero

    @property
    def now(self):
        """Torques as recorded, ndarray of shape (n, nv)."""
        return self.tau[:, :, self.shifts.size // 2]

    def informative(self):
        """Return which joints have enough rows, ndarray of shape (nv,) of bool."""
        return self.weight.sum(axis=0) >= number.FEWEST_ROWS

    def thinned(self, most):
        """Return every k-th row, about `most` of them."""
        k = max(1, len(self.row) // most)
        names = "states", "sign", "tau", "weight", "row"
        return replace(self, **{name: getattr(self, name)[::k] for name in names})


def long_parts(n, groups):
    """Rows of the recordings that are long enough, and where each is among them."""
    parts = contiguous_groups(groups, n)
    parts = [part for part in parts if part.stop - part.start >= number.MIN_SAMPLES]
    rows = [np.arange(part.start, part.stop) for part in parts]
    stops = np.cumsum([0, *map(len, rows)]).tolist()
    found = [slice(a, b) for a, b in pairwise(stops)]
    return np.concatenate([np.zeros(0, dtype=int), *rows]), found


def filtered(q, tau, dt, parts, usable):
    """Filter q, tau (n, nv) of recordings; None if all are shorter than the filter."""
    # usable (n, nv): samples without known faults.
    cutoff, top = _cutoffs(q, dt, parts)
    # Signs and derivatives need less noise than single samples have.
    smooth = _lowpass.design(dt, top, step=1)
    lowpass = _lowpass.design(dt, cutoff)
    step, count = max(1, round(number.SHORTEST_SHIFT / dt)), number.N_SHIFTS
    shifts = step * np.arange(-count, count + 1)
    margin = max(shifts[-1], smooth.half)
    long = [p for p in parts if p.stop - p.start >= 2 * (margin + lowpass.half) + 3]
    if not long:
        return None
    inner = [slice(p.start + margin, p.stop - margin) for p in long]
    states = [
        _states(q[s.start - smooth.half : s.stop + smooth.half], dt, smooth)
        for s in inner
    ]
    v = [x[:, 1] for x in states]
    slow = number.STANDSTILL * np.quantile(np.abs(np.concatenate(v)), 0.995, axis=0)
    pieces = []
    for part, x in zip(inner, states):
        moves = (np.abs(x[:, 1]) > slow) & usable[part]
        shifted = [lowpass(tau[part.start + k : part.stop + k]) for k in shifts]
        pieces.append(
            (
                lowpass(x.reshape(len(x), -1)),
                lowpass(np.sign(x[:, 1])),
                np.stack(shifted, axis=-1),
                lowpass.average(moves.astype(float)) > 0.9,
                part.start + lowpass.centres(len(x)),
            )
        )
    states, sign, torque, weight, row = (np.concatenate(x) for x in zip(*pieces))
    signals = Signals(
        states=states,
        sign=sign,
        tau=torque,
        weight=weight.astype(float),
        row=row,
        shifts=shifts,
    )
    return signals.thinned(number.MOST_ROWS)


def _states(q, dt, smooth):
    """Positions, velocities and accelerations (n, 3, nv) inside the filter's ends."""
    x = scipy.signal.oaconvolve(q, smooth.taps[:, None], mode="valid", axes=0)
    v = np.gradient(x, dt, axis=0)
    return np.stack([x, v, np.gradient(v, dt, axis=0)], axis=1)


def _cutoffs(q, dt, parts):
    """Cut-offs [Hz] of all signals, above the motion, and of the states."""
    longest = max(part.stop - part.start for part in parts)
    size = 2 ** int(np.ceil(np.log2(longest)))
    power = np.zeros((size // 2 + 1, q.shape[1]))
    for part in parts:
        x = np.diff(q[part], axis=0)
        x = (x - x.mean(axis=0)) * np.hanning(len(x))[:, None]
        power += np.abs(np.fft.rfft(x, n=size, axis=0)) ** 2
    # Differences of white noise have a power that rises with the square of the
    # frequency; the motion has none in the upper half.
    rise = np.sin(np.pi * np.arange(len(power)) / size)[:, None] ** 2
    high = slice(len(power) // 2, None)
    noise = rise * (power[high].sum(axis=0) / rise[high].sum())
    tiny = np.finfo(float).tiny
    power = scipy.ndimage.uniform_filter1d(power, number.BINS, axis=0)
    total = np.cumsum(np.maximum(power - number.ABOVE_NOISE * noise, 0.0), axis=0)
    share = total / np.maximum(total[-1], tiny)
    # The velocity of a joint at rest is noise.
    fast = np.ptp(q, axis=0) > 1e-3 * np.ptp(q)
    if not fast.any():
        fast[:] = True
    bandwidth = (share[:, fast] < 0.9).sum(axis=0).max(initial=1) / (size * dt)
    # Where the motion is below the noise, accelerations are nothing else.
    ratio = np.mean(power[1:, fast] / np.maximum(noise[1:, fast], tiny), axis=1)
    above = np.flatnonzero(ratio > number.ABOVE_NOISE)
    top = (above[-1] + 1 if above.size else 0) / (size * dt)
    least = number.CUTOFF_PERIODS / (longest * dt)
    cutoff = max(number.CUTOFF_PER_BANDWIDTH * bandwidth, least)
    top = np.clip(number.SMOOTH * top, number.SMOOTH * bandwidth, 2 * cutoff)
    return float(cutoff), float(max(top, least))
