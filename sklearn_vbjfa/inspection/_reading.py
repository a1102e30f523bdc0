"""A log that is read in one way, its score, and changes judged by the likelihood."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np
import scipy

from sklearn_vbjfa._core import _lowpass, _smoothing
from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._likelihood import Bodies, DescribedRobot, under_gravity
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.recording import contiguous_groups

# -- changes ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """Another reading of a log: linear maps of its channels, a clock, or a gravity."""

    # (nv, nv): joint positions, and torques, from the channels; None: as logged.
    positions: np.ndarray | None = None
    torques: np.ndarray | None = None
    offset: object = 0.0  # float or (nv,): added to the positions [rad or m]
    period: float = 1.0  # factor of the sample period
    gravity: np.ndarray | None = None  # (3,) [m/s^2]; None for that of the description
    lag: int = 0  # samples by which torques are late

    @property
    def moves(self):
        """Whether it changes the motion."""
        other = self.positions is not None or self.period != 1.0
        return other or bool(np.any(self.offset))

    @property
    def joints(self):
        """Joints whose channels it changes, a tuple of int."""
        changed = np.atleast_1d(self.offset) != 0
        for mixed in (self.positions, self.torques):
            if mixed is not None:
                changed = changed | (mixed != np.eye(len(mixed))).any(axis=1)
        return tuple(np.flatnonzero(changed).tolist())

    def then(self, other):
        """Return this change of channels, followed by another one."""
        return Change(
            positions=_product(other.positions, self.positions),
            torques=_product(other.torques, self.torques),
            offset=_mapped(self.offset, other.positions) + other.offset,
            period=self.period * other.period,
        )

    def known(self, values):
        """Read which samples (n, nv) of positions are known, bool or 0 and 1."""
        if self.positions is None:
            return values
        return ((1.0 - values) @ np.abs(self.positions).T == 0).astype(values.dtype)

    def signals(self, signals):
        """Return filtered signals that are read in this way."""
        tau, slope = (_mapped(x, self.torques) for x in (signals.tau, signals.slope))
        signals = replace(signals, tau=tau, slope=slope)
        if not self.moves:
            return signals
        states = _mapped(signals.states.reshape(len(tau), 3, -1), self.positions)
        states = states / self.period ** np.arange(3)[:, None]
        states[:, 0] += self.offset
        sign = signals.sign
        if self.positions is not None:
            sign = sign @ np.sign(self.positions).T
            # Of a sum of positions, that of the filtered speed has to do.
            mixed = (self.positions != 0).sum(axis=1) > 1
            sign[:, mixed] = np.sign(states[:, 1][:, mixed])
        return replace(
            signals,
            states=states.reshape(len(states), -1),
            sign=sign,
            weight=self.known(signals.weight),
        )


def _mapped(values, matrix):
    return values if matrix is None else values * np.ones(len(matrix)) @ matrix.T


def _product(second, first):
    return first if second is None else second if first is None else second @ first


def times(nv, value, joints=None):
    """Return the map (nv, nv) that multiplies some joints' channels, or all."""
    factors = np.ones(nv)
    factors[slice(None) if joints is None else np.array(joints, dtype=int)] = value
    return np.diag(factors)


# -- signals ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Signals:
    """Channels of a log, filtered and decimated."""

    states: np.ndarray  # (n, 3 nv): [q | v | a]
    sign: np.ndarray  # (n, nv): filtered signs of the velocities
    tau: np.ndarray  # (n, nv)
    slope: np.ndarray  # (n, nv): change of the torques from sample to sample
    weight: np.ndarray  # (n, nv): 1 where the joint moves and no fault is known, else 0
    throughout: np.ndarray  # (n, nv): 1 where it does so in the whole low-pass, else 0
    row: np.ndarray  # (n,): row of the log in the middle of the filter
    recording: np.ndarray  # (n,): which recording it is of

    def informative(self):
        """Return which joints have enough rows, ndarray of shape (nv,) of bool."""
        return self.weight.sum(axis=0) >= number.FEWEST_ROWS

    def thinned(self, most):
        """Return every k-th row, about `most` of them."""
        return self.taken(slice(None, None, max(1, len(self.row) // most)))

    def taken(self, rows):
        return Signals(**{x.name: getattr(self, x.name)[rows] for x in fields(self)})


def long_parts(n, groups):
    """Rows of the recordings that are long enough, and where each is among them."""
    parts = contiguous_groups(groups, n)
    return thinned([x for x in parts if x.stop - x.start >= number.MIN_SAMPLES], 1)


def thinned(parts, k):
    """Every k-th row of recordings, and where each is among these."""
    rows = [np.arange(part.start, part.stop, k) for part in parts]
    stops = np.cumsum([0, *map(len, rows)]).tolist()
    parts = [slice(a, b) for a, b in pairwise(stops)]
    return np.concatenate([np.arange(0), *rows]), parts


def filtered(q, tau, dt, parts, usable):
    """Filter q, tau (n, nv) of recordings; None if all are shorter than the filter."""
    # usable (n, nv): samples without known faults.
    cutoff, top = _cutoffs(q, dt, parts)
    # Signs and derivatives need less noise than single samples have.
    smooth, lowpass = _lowpass.design(dt, top, step=1), _lowpass.design(dt, cutoff)
    half = smooth.half
    least = 2 * (half + lowpass.half) + 3
    inner = [
        slice(p.start + half, p.stop - half) for p in parts if p.stop - p.start >= least
    ]
    if not inner:
        return None
    # Joint by joint, which takes less memory.
    joints = [
        _joint_signals(*one, dt, inner, smooth, lowpass)
        for one in zip(q.T, tau.T, usable.T)
    ]
    *states, sign, tau, slope, weight, throughout = np.stack(joints, axis=2)
    row = np.concatenate([p.start + lowpass.centres(p.stop - p.start) for p in inner])
    return Signals(
        states=np.concatenate(states, axis=1),
        sign=sign,
        tau=tau,
        slope=slope,
        weight=weight,
        throughout=throughout,
        row=row,
        recording=np.searchsorted([p.stop for p in parts], row, side="right"),
    )


def _joint_signals(q, tau, usable, dt, parts, smooth, lowpass):
    """Filter q, v, a, the sign of v, torque, its slope and both weights, (8, n)."""
    half, states = smooth.half, []
    for part in parts:
        x = q[part.start - half : part.stop + half]
        x = scipy.signal.oaconvolve(x, smooth.taps, "valid")
        v = np.gradient(x, dt)
        states.append((x, v, np.gradient(v, dt)))
    speed = np.abs(np.concatenate([v for _, v, _ in states]))
    slow, pieces = number.STANDSTILL * np.quantile(speed, 0.995), []
    for part, (x, v, a) in zip(parts, states):
        torque = tau[part]
        signals = x, v, a, np.sign(v), torque, np.gradient(torque)
        moves = (np.abs(v) > slow) & usable[part]
        share = lowpass.average(moves.astype(float))
        weight = share > number.MOVING, share > number.THROUGHOUT
        pieces.append([*lowpass(np.column_stack(signals)).T, *weight])
    return np.concatenate(pieces, axis=1)


def _cutoffs(q, dt, parts):
    """Cut-offs [Hz] of all signals, above the motion, and of the states."""
    longest = max(part.stop - part.start for part in parts)
    # The velocity of a joint at rest is noise.
    fast = np.ptp(q, axis=0) > 1e-3 * np.ptp(q)
    moving = q[:, fast] if fast.any() else q
    frequency, power, gain = _smoothing.acceleration_spectra(
        [moving[part] for part in parts], dt
    )
    top, noise = _smoothing.choose_cutoff(frequency, power, gain, dt)
    bandwidth = max(
        _smoothing.velocity_bandwidth(frequency, x, gain, variance, most, 0.9)
        for x, variance, most in zip(power.T, noise, top)
    )
    least = number.CUTOFF_PERIODS / (longest * dt)
    cutoff = max(number.CUTOFF_PER_BANDWIDTH * bandwidth, least)
    top = np.clip(top.max(), number.SMOOTH * bandwidth, 2 * cutoff)
    return float(cutoff), float(max(top, least))


# -- readings --------------------------------------------------------------------------


@dataclass(eq=False)
class Reading:
    """A log, its filtered signals and the described robot in its motion."""

    model: object
    names: tuple
    q: np.ndarray
    tau: np.ndarray
    dt: float
    parts: list  # slices of the recordings
    usable: np.ndarray  # (n, nv): samples without known faults
    drive: object = None  # what made the torques
    named: bool = False  # whether columns carry the joints' names
    alone: bool = False  # whether it is one of several recordings

    def __post_init__(self):
        self.nv, self.every = self.model.nv, tuple(range(self.model.nv))
        self.slides = is_prismatic(self.model)
        # Whether torques are what motors were commanded.
        self.commanded = self.drive is not None and self.drive.uses_positions
        self.measured, self.turns = not self.commanded, not self.slides.all()

    @functools.cached_property
    def signals(self):
        """Filtered signals; None if the log is too short."""
        found = filtered(self.q, self.tau, self.dt, self.parts, self.usable)
        most = number.MOST_ENTRIES // (10 * self.nv**2)
        most = int(np.clip(most, number.LEAST_ROWS, number.MOST_ROWS))
        return None if found is None else found.thinned(most)

    @functools.cached_property
    def bodies(self):
        return Bodies(self.model)

    @functools.cached_property
    def robot(self):
        return DescribedRobot(self.bodies, self.signals)

    @property
    def poor(self):
        """Whether some torque agrees badly enough to look for another reading."""
        return bool((self.robot.now.left > 2 * np.log(number.GOOD_FIT)).any())

    @property
    def weighs(self):
        """Whether measured torques contain a weight by the description."""
        return self.measured and not self.bodies.weightless

    @property
    def several(self):
        """Whether several joints are judged."""
        return self.robot.joints.size > 1

    @property
    def zeroed(self):
        """Whether all positions begin at zero, as if set there at power-up."""
        # A log that begins at the zero of the description looks the same.
        near = np.abs(self.q[0]) <= number.AT_ZERO * np.ptp(self.q, axis=0)
        return self.measured and bool(near.all())

    def of_recordings(self, numbers, alone=False):
        rows, parts = thinned([self.parts[k] for k in numbers], 1)
        channels = {x: getattr(self, x)[rows] for x in ("q", "tau", "usable")}
        return replace(self, **channels, parts=parts, alone=alone)

    def apart(self):
        """List recordings that agree far worse than others, or with other masses."""
        recordings = self.robot.signals.recording
        every = np.unique(recordings).tolist()
        several = 1 < len(every) <= number.MANY
        return [k for k in every if several and self.robot.is_apart(recordings == k)]

    def tell_nothing(self):
        """Whether torques or description are such that nothing can be compared."""
        if self.signals is None or not self.signals.informative().any():
            return True
        return self.bodies.massless or not self.robot.joints.size

    def rough(self, change):
        """Log of what described torques leave of all torques, a cheap score."""
        # The bodies are as described, but for the size of their motion's and their
        # weight's torque.
        signals = change.signals(self._roughly)
        return _left(self.bodies, signals, self.robot.joints, signals.tau).sum()

    @functools.cached_property
    def _roughly(self):
        """Signals of fewer rows where there are many joints."""
        return self.signals.thinned(max(number.LEAST_ROUGH, number.ROUGH // self.nv))

    @functools.cached_property
    def rough_crossed(self):
        """Scores of each joint's motion and each torque, (n_joints, n_joints)."""
        signals, joints = self._roughly, self.robot.joints
        every = [_left(self.bodies, signals, joints, x[:, None]) for x in signals.tau.T]
        return np.column_stack([every[j] for j in joints])

    def tried(self, change):
        """`BodyFit` of a change that keeps the description; None if it fails."""
        other = self.robot_at(change)
        return other.fit() if other.joints.size == self.robot.joints.size else None

    def robot_at(self, change):
        """Return the described robot in the motion of a change."""
        signals = change.signals(self.signals)
        entries = None if change.moves else self.robot.entries
        return DescribedRobot(self.bodies, signals, self.robot.times, entries)

    def changed(self, change):
        """Return the log after a change, filtered again."""
        q = _mapped(self.q, change.positions) + change.offset
        tau, usable = _mapped(self.tau, change.torques), change.known(self.usable)
        dt, model = self.dt * change.period, self.model
        if change.gravity is not None:
            model = under_gravity(model, change.gravity)
        if change.lag:
            tau, usable = _late(tau, change.lag, self.parts, usable)
        return replace(self, model=model, q=q, tau=tau, dt=dt, usable=usable)


def _left(robot, signals, joints, tau):
    """Log of the share of torques (n, nv or 1) that the described ones leave."""
    nv, weight = robot.nv, signals.weight[:, joints].T
    v, a = (x[:, joints] for x in np.split(signals.states, 3, axis=1)[1:])
    bodies = [x[:, joints] for x in robot.described(signals.states)]
    X = np.stack([*bodies, v, signals.sign[:, joints], a, np.ones_like(v)], axis=-1)
    X = X.swapaxes(0, 1) * weight[:, :, None]
    y = np.broadcast_to(tau, (len(v), nv))[:, joints].T * weight
    count = np.maximum(weight.sum(axis=1), 1.0)
    size = ((y - y.sum(axis=1)[:, None] / count[:, None]) ** 2 * weight).sum(axis=1)
    y = y - X[:, :, :2].sum(axis=-1)
    gram = X.swapaxes(1, 2) @ X
    square = np.einsum("jkk->jk", gram)
    share = np.r_[number.ROUGH_PRIOR, number.ROUGH_PRIOR, np.full(4, 1e-6)]
    penalty = square * share + 1e-300
    gram = gram + np.eye(6) * penalty[:, None]
    found = np.linalg.solve(gram, X.swapaxes(1, 2) @ y[:, :, None])
    left = ((y[:, :, None] - X @ found) ** 2).sum(axis=(1, 2))
    # What their sizes depart from the described ones counts as an error.
    left += (found[:, :2, 0] ** 2 * penalty[:, :2]).sum(axis=1)
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


# -- the search for a change -----------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A change that a hypothesis proposes, with the facts of its sentence.

    One that is not clear explains the torques better than the unchanged log, but leaves
    errors that are too large to report it; no less probable one is reported either.
    """

    joints: tuple
    log_odds: float  # against the log as it is, before the prior odds
    change: Change | None = None  # which undoes what was done
    fall: float = 0.0  # sum over joints of the fall of the log squared errors
    clear: bool = True
    kind: str = ""  # of the sentence and the severity, if not the hypothesis's
    severity: str = ""
    value: float = np.nan
    remedy: Mapping | None = None
    facts: Mapping = field(default_factory=dict)


def judged(reading, change, least=None, *, variants=1, **others):
    """Return the `Proposal` of a change, clear if squared errors fall by `least`."""
    # variants: changes of which one is right.
    fit, now = reading.tried(change), reading.robot.now
    if fit is None or not (change.joints or change.moves):
        return None
    least = clear(change) if least is None else least
    return Proposal(
        **{"joints": change.joints, "change": change} | others,
        log_odds=fit.evidence - now.evidence - np.log(max(variants, 1)),
        fall=fit.fall(now),
        clear=fit.fall(now) >= least,
    )


def likely(reading, changes):
    """Return the most probable of some changes that a rough score prefers."""
    changes = list(changes)
    gain = reading.rough(Change()) - np.array([reading.rough(x) for x in changes])
    # What the motion cannot tell from the log as it is may be a rival.
    best = np.argsort(-gain)[: number.MOST_LIKELY]
    best = [changes[k] for k in best if gain[k] > -number.SETTLED]
    return most_probable(judged(reading, x, variants=len(changes)) for x in best)


def climbed(reading, moves, starts=(), step=number.CLEAR):
    """Return the change at the end of a climb from a start or a move by more moves."""
    # step: fall of the rough score that each must bring.
    end, score, tried = Change(), reading.rough(Change()), [*starts, *moves]
    while tried:
        scores = [reading.rough(change) for change in tried]
        best = int(np.argmin(scores))
        if scores[best] > score - step:
            break
        end, score = tried[best], scores[best]
        tried = [end.then(move) for move in moves]
    return end


def most_probable(candidates):
    """Return the candidate of the greatest odds; None if there is none."""
    found = [one for one in candidates if one is not None]
    return max(found, key=lambda one: one.log_odds, default=None)


def stepped(reading, change, steps):
    """Improve a change by Gauss-Newton along steps; also their standard errors."""
    # steps: functions of a number, each to a change that follows.
    best, errors = reading.tried(change), np.full(len(steps), np.inf)
    for _ in range(number.PASSES if best is not None and steps else 0):
        robot = reading.robot_at(change)
        ends = [
            [_missing(reading, change.then(make(x))) for make in steps]
            for x in (number.SLOPE, -number.SLOPE)
        ]
        columns = -np.subtract(*ends).transpose(1, 2, 0) / (2 * number.SLOPE)
        fit = robot.fit(columns=columns, deviation=number.STEP_OF_ZERO)
        errors, after = fit.errors, change
        for make, x in zip(steps, fit.factors):
            after = after.then(make(x))
        fit = reading.tried(after)
        if fit is None or fit.evidence < best.evidence + 0.1:
            break
        best, change = fit, after
    return change, errors


def _missing(reading, change):
    """Torques (n, nv) that the described bodies leave."""
    signals, bodies = change.signals(reading.signals), reading.bodies
    return signals.tau - sum(bodies.described(signals.states))


def clear(change):
    """Fall of log squared errors that a change of some joints must bring."""
    return number.CLEAR_OF_JOINT * len(change.joints)


def clear_of_all(reading):
    """Fall of log squared errors that a change of the whole log must bring."""
    return number.CLEAR * reading.robot.joints.size
