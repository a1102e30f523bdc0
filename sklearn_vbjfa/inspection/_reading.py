"""A log that is read in one way: changes, filtered channels, and its score."""

import functools
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._likelihood import (
    Bodies,
    DescribedRobot,
    under_gravity,
)
from sklearn_vbjfa.model import described_torques, is_prismatic
from sklearn_vbjfa.recording import COMMANDS, contiguous_groups


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

    @property
    def moves(self):
        """Whether it changes the motion."""
        changes = (self.factor, 1.0), (self.offset, 0.0), (self.period, 1.0)
        return self.positions is not None or any(np.any(x != y) for x, y in changes)

    @property
    def joints(self):
        """Joints that it changes, a tuple of int."""
        nv = max(
            np.size(x)
            for x in (self.positions, self.torques, self.factor)
            + (self.offset, self.scale)
            if x is not None
        )
        same, moved = np.arange(nv), np.zeros(nv, dtype=bool)
        for order in (self.positions, self.torques):
            moved |= False if order is None else order != same
        for value, usual in (self.factor, 1.0), (self.offset, 0.0), (self.scale, 1.0):
            moved |= np.not_equal(value, usual)
        return tuple(np.flatnonzero(moved).tolist())

    def signals(self, signals):
        """Return filtered signals that are read in this way."""
        nv, tau = signals.sign.shape[1], signals.tau
        tau = tau if self.torques is None else tau[:, self.torques]
        if np.any(np.not_equal(self.scale, 1.0)):
            tau = tau * np.broadcast_to(self.scale, nv)[:, None]
        if not self.moves:
            return replace(signals, tau=tau)
        states = signals.states.reshape(-1, 3, nv)
        sign, weight = signals.sign, signals.weight
        if self.positions is not None:
            states = states[:, :, self.positions]
            sign, weight = sign[:, self.positions], weight[:, self.positions]
        factor = np.broadcast_to(self.factor, nv)
        states = states * factor / self.period ** np.arange(3)[:, None]
        states[:, 0] += self.offset
        return replace(
            signals,
            states=states.reshape(len(states), -1),
            sign=sign * np.sign(factor),
            weight=weight,
            tau=tau,
        )

    def arrays(self, q, tau, dt):
        """Return positions, torques and period of a log that is changed in this way."""
        q = q if self.positions is None else q[:, self.positions]
        tau = tau if self.torques is None else tau[:, self.torques]
        return q * self.factor + self.offset, tau * self.scale, dt * self.period


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
    return thinned(parts, 1) if parts else (np.zeros(0, dtype=int), [])


def thinned(parts, k):
    """Every k-th row of recordings, and where each is among these."""
    rows = [np.arange(part.start, part.stop, k) for part in parts]
    stops = np.cumsum([0, *map(len, rows)]).tolist()
    return np.concatenate(rows), [slice(a, b) for a, b in pairwise(stops)]


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


class Reading:
    """A log, its filtered signals and the described robot in its motion."""

    # usable (n, nv): samples without known faults; drive: what made the torques;
    # gravity (3,): if it is not that of the description.

    def __init__(
        self, model, names, q, tau, dt, parts, usable, *, drive=None, gravity=None
    ):
        self.model = model if gravity is None else under_gravity(model, gravity)
        self.names, self.drive = tuple(names), drive
        self.q, self.tau, self.dt = q, tau, dt
        self.parts, self.usable = parts, usable

    @property
    def nv(self):
        """Number of joints."""
        return self.model.nv

    @property
    def commanded(self):
        """Whether torques are what motors were commanded."""
        return self.drive is not None and self.drive.told in COMMANDS

    @property
    def every(self):
        """All joints."""
        return tuple(range(self.nv))

    def usual_orders(self):
        """Return other orders of joints (nv,) that programs give them, and back."""
        # By name, or as Pinocchio has them: branches are sorted by name.
        parents, names = list(self.model.parents)[1:], self.names

        def branch(joint):
            children = [k for k, parent in enumerate(parents, 1) if parent == joint]
            children.sort(key=lambda k: names[k - 1])
            return [x for k in children for x in (k - 1, *branch(k))]

        usual = np.argsort(names, kind="stable"), np.array(branch(0))
        orders = [x for order in usual for x in (order, np.argsort(order))]
        return [x for x in orders if (np.diff(x) < 0).any()]

    @functools.cached_property
    def slides(self):
        """Which joints are prismatic, (nv,) of bool."""
        return is_prismatic(self.model)

    @functools.cached_property
    def signals(self):
        """Filtered signals; None if the log is too short."""
        return filtered(self.q, self.tau, self.dt, self.parts, self.usable)

    @functools.cached_property
    def bodies(self):
        """Bodies of the description."""
        return Bodies(self.model)

    @functools.cached_property
    def robot(self):
        """The described robot in the motion."""
        return DescribedRobot(self.bodies, self.signals)

    @functools.cached_property
    def few(self):
        """The described robot in fewer rows, for hypotheses with many variants."""
        few = DescribedRobot(self.bodies, self.signals, most=number.MOST_TRIED)
        # Short motions have no rows to spare.
        same = np.array_equal(few.joints, self.robot.joints)
        return few if same else self.robot

    @property
    def poor(self):
        """Whether some torque agrees badly enough to look for another reading."""
        return bool((self.robot.now.left > 2 * np.log(number.GOOD_FIT)).any())

    def tell_nothing(self):
        """Whether torques or description are such that nothing can be compared."""
        if self.signals is None or not self.signals.informative().any():
            return True
        return self.bodies.massless or not self.robot.joints.size

    def rough(self, change=None):
        """Log of what described torques leave of each joint's torque, (n_joints,)."""
        # A cheap score for the choice of changes: the bodies are as described, but for
        # the size of their motion's and their weight's torque.
        if change is None:
            return np.diagonal(self.rough_crossed)
        signals = change.signals(self._roughly)
        return _left(self.model, signals, self.few.joints, signals.now)

    @functools.cached_property
    def _roughly(self):
        """Signals of fewer rows where there are many joints."""
        return self.few.signals.thinned(
            max(number.LEAST_ROUGH, number.ROUGH // self.nv)
        )

    @functools.cached_property
    def rough_crossed(self):
        """Of each joint's motion and each torque, (n_joints, n_joints)."""
        signals, joints = self._roughly, self.few.joints
        every = [_left(self.model, signals, joints, x[:, None]) for x in signals.now.T]
        return np.column_stack([every[j] for j in joints])

    def tried(self, change, *, few=False, least=-np.inf):
        """`Fit` of a change that keeps the description; None if it fails."""
        other, base = self.robot_at(change, few=few), self.few if few else self.robot
        return other.fit(least=least) if other.joints.size == base.joints.size else None

    def robot_at(self, change, *, few=False):
        """Return the described robot in the motion of a change."""
        base = self.few if few else self.robot
        most = len(base.signals.row)
        signals = change.signals(base.signals)
        entries = None if change.moves else base.entries
        return DescribedRobot(self.bodies, signals, base.times, most, entries)

    def changed(self, change):
        """Return the log after a change, filtered again."""
        q, tau, dt = change.arrays(self.q, self.tau, self.dt)
        usable = self.usable
        if change.positions is not None:
            usable = usable[:, change.positions]
        if change.lag:
            tau, usable = _late(tau, change.lag, self.parts, usable)
        return Reading(
            self.model,
            self.names,
            q,
            tau,
            dt,
            self.parts,
            usable,
            drive=self.drive,
            gravity=change.gravity,
        )


def _left(model, signals, joints, tau):
    """Log of the share of torques (n, nv or 1) that the described ones leave."""
    nv, weight = model.nv, signals.weight[:, joints].T
    states = np.split(signals.states, 3, axis=1)
    v, a = (x[:, joints] for x in states[1:])
    bodies = [x[:, joints] for x in described_torques(model, *states)]
    X = np.stack([*bodies, v, signals.sign[:, joints], a, np.ones_like(v)], axis=-1)
    X = X.swapaxes(0, 1) * weight[:, :, None]
    y = np.broadcast_to(tau, (len(v), nv))[:, joints].T * weight
    count = np.maximum(weight.sum(axis=1), 1.0)
    size = ((y - y.sum(axis=1)[:, None] / count[:, None]) ** 2 * weight).sum(axis=1)
    y = y - X[:, :, :2].sum(axis=-1)
    gram = X.swapaxes(1, 2) @ X
    share = np.array([number.ROUGH_PRIOR, number.ROUGH_PRIOR, 1e-6, 1e-6, 1e-6, 1e-6])
    gram += np.eye(6) * (np.einsum("jkk->jk", gram) * share + 1e-300)[:, None]
    found = np.linalg.solve(gram, X.swapaxes(1, 2) @ y[:, :, None])
    left = ((y[:, :, None] - X @ found) ** 2).sum(axis=(1, 2))
    # What their sizes depart from the described ones counts as an error.
    left += (found[:, :2, 0] ** 2 * np.einsum("jkk->jk", gram)[:, :2]).sum(
        axis=1
    ) * number.ROUGH_PRIOR
    return np.log(np.maximum(left / np.maximum(size, 1e-300), 1e-12))


def _late(tau, samples, parts, usable):
    """Torques that are read some samples later, and the samples that remain usable."""
    tau, usable = tau.copy(), usable.copy()
    first, last = max(0, -samples), max(0, samples)
    for part in parts:
        tau[part] = np.roll(tau[part], -samples, axis=0)
        usable[part][:first] = False
        usable[part][len(tau[part]) - last :] = False
    return tau, usable
