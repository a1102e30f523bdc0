"""Interpretations of a log: filtered signals, changes, and their likelihood."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise, product

import numpy as np
import scipy

from sklearn_vbjfa._core import _lowpass, _smoothing
from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._likelihood import Bodies, DescribedRobot, under_gravity
from sklearn_vbjfa.model import is_prismatic


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """Correction of a log: linear maps of its channels, sample period, or gravity."""

    # (nv, nv): maps from logged to joint positions and torques; None: as logged.
    positions: np.ndarray | None = None
    torques: np.ndarray | None = None
    offset: object = 0.0  # float or (nv,): added to the positions [rad or m]
    period: float = 1.0  # factor of the sample period
    gravity: np.ndarray | None = None  # (3,) [m/s^2]; None: that of the description
    lag: int = 0  # delay of the torques [samples]

    @property
    def changes_motion(self):
        other = self.positions is not None or self.period != 1.0
        return other or bool(np.any(self.offset))

    @property
    def joints(self):
        """Joints whose channels it changes, a tuple of int."""
        is_changed = np.atleast_1d(self.offset) != 0
        for matrix in (self.positions, self.torques):
            if matrix is not None:
                is_changed = is_changed | (matrix != np.eye(len(matrix))).any(axis=1)
        return tuple(np.flatnonzero(is_changed).tolist())

    def then(self, other):
        """Return this change of channels followed by a second one."""
        return Change(
            positions=_compose(other.positions, self.positions),
            torques=_compose(other.torques, self.torques),
            offset=_map(self.offset, other.positions) + other.offset,
            period=self.period * other.period,
        )

    def map_usable(self, values):
        """Map masks (n, nv) of usable samples, bool or 0 and 1, like the positions."""
        if self.positions is None:
            return values
        return ((1.0 - values) @ np.abs(self.positions).T == 0).astype(values.dtype)

    def signals(self, signals):
        """Return filtered signals after this change."""
        tau, slope = (_map(x, self.torques) for x in (signals.tau, signals.slope))
        signals = replace(signals, tau=tau, slope=slope)
        if not self.changes_motion:
            return signals
        states = _map(signals.states.reshape(len(tau), 3, -1), self.positions)
        states = states / self.period ** np.arange(3)[:, None]
        states[:, 0] += self.offset
        sign = signals.sign
        if self.positions is not None:
            sign = sign @ np.sign(self.positions).T
            # The sign of a sum of speeds is approximated by that of the filtered sum.
            is_sum = (self.positions != 0).sum(axis=1) > 1
            sign[:, is_sum] = np.sign(states[:, 1][:, is_sum])
        states = states.reshape(len(states), -1)
        weight = self.map_usable(signals.weight)
        return replace(signals, states=states, sign=sign, weight=weight)


def _map(values, matrix):
    return values if matrix is None else values * np.ones(len(matrix)) @ matrix.T


def _compose(second, first):
    return first if second is None else second if first is None else second @ first


def times(nv, value, joints=None):
    """Return the matrix (nv, nv) that scales the channels of some or all joints."""
    factors = np.ones(nv)
    factors[slice(None) if joints is None else np.array(joints, dtype=int)] = value
    return np.diag(factors)


@dataclass(frozen=True)
class Signals:
    """Channels of a log, filtered and decimated."""

    states: np.ndarray  # (n, 3 nv): [q | v | a]
    sign: np.ndarray  # (n, nv): filtered signs of the velocities
    tau: np.ndarray  # (n, nv)
    slope: np.ndarray  # (n, nv): change of the torques per sample
    weight: np.ndarray  # (n, nv): 1 where the joint moves without known fault, else 0
    throughout: np.ndarray  # (n, nv): 1 if so in the whole filter window, else 0
    row: np.ndarray  # (n,): row of the log at the centre of the filter
    recording: np.ndarray  # (n,): index of the recording
    few: int = number.FEWEST_ROWS  # least number of rows of a joint

    def informative(self):
        """Return which joints have enough moving rows, ndarray (nv,) of bool."""
        return self.weight.sum(axis=0) >= self.few

    def subsample(self, n_rows):
        """Return every k-th row, about `n_rows` in all."""
        return self.select_rows(slice(None, None, max(1, len(self.row) // n_rows)))

    def select_rows(self, rows):
        arrays = (getattr(self, x.name)[rows] for x in fields(self)[:-1])
        return Signals(*arrays, self.few)


def subsample(parts, k=1, least=0):
    """Every k-th row of long recordings, and the slice of each recording in these."""
    long = [part for part in parts if part.stop - part.start >= least]
    rows = [np.arange(part.start, part.stop, k) for part in long]
    stops = np.cumsum([0, *map(len, rows)]).tolist()
    parts = [slice(a, b) for a, b in pairwise(stops)]
    return np.concatenate([np.arange(0), *rows]), parts


def filter_signals(q, tau, dt, parts, usable):
    """Filter q, tau (n, nv) of recordings; None if all are shorter than the filter."""
    # usable (n, nv): samples without known faults.
    cutoff, top = _cutoffs(q, dt, parts)
    # Positions are smoothed before differentiation and taking signs.
    smooth, lowpass = _lowpass.design(dt, top, step=1), _lowpass.design(dt, cutoff)
    half = smooth.half
    least = 2 * (half + lowpass.half) + 3
    inner = [
        slice(p.start + half, p.stop - half) for p in parts if p.stop - p.start >= least
    ]
    if not inner:
        return None
    # Joint by joint, which needs less memory.
    joints = zip(q.T, tau.T, usable.T)
    joints = [_joint_signals(*x, dt, inner, smooth, lowpass) for x in joints]
    q, v, a, *channels = np.stack(joints, axis=2)
    row = np.concatenate([p.start + lowpass.centres(p.stop - p.start) for p in inner])
    recording = np.searchsorted([p.stop for p in parts], row, side="right")
    return Signals(np.hstack([q, v, a]), *channels, row, recording)


def _joint_signals(q, tau, usable, dt, parts, smooth, lowpass):
    """Return filtered q, v, a, sign(v), torque, its slope and both weights, (8, n)."""
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
        moving_share = lowpass.average(moves.astype(float))
        weight = moving_share > number.MOVING, moving_share > number.THROUGHOUT
        pieces.append([*lowpass(np.column_stack(signals)).T, *weight])
    return np.concatenate(pieces, axis=1)


def _cutoffs(q, dt, parts):
    """Return cut-offs [Hz] of the low-pass of all signals and of the states."""
    longest = max(part.stop - part.start for part in parts)
    # A joint at rest has only noise.
    fast = np.ptp(q, axis=0) > 1e-3 * np.ptp(q)
    moving = q[:, fast] if fast.any() else q
    spectra = _smoothing.acceleration_spectra([moving[part] for part in parts], dt)
    top, noise = _smoothing.choose_cutoff(*spectra, dt)
    frequency, power, gain, _ = spectra
    bandwidths = [
        _smoothing.velocity_bandwidth(frequency, x, gain, variance, most, 0.9)
        for x, variance, most in zip(power.T, noise, top)
    ]
    # A far larger one is that of coloured noise.
    bandwidth = min(max(bandwidths), number.BANDWIDTHS * np.median(bandwidths))
    lowest = number.CUTOFF_PERIODS / (longest * dt)
    cutoff = max(number.CUTOFF_PER_BANDWIDTH * bandwidth, lowest)
    top = np.clip(top.max(), number.SMOOTH * bandwidth, 2 * cutoff)
    return float(cutoff), float(max(top, lowest))


@dataclass(eq=False)
class Reading:
    """A log under one interpretation, its filtered signals and its described robot."""

    folded: object  # `Folded`
    names: tuple
    q: np.ndarray
    tau: np.ndarray
    dt: float
    parts: list  # slices of the recordings
    usable: np.ndarray  # (n, nv): samples without known faults
    drive: object = None  # drive that generated the torques; None if measured
    named: bool = False  # whether columns carry the joints' names
    feedback: np.ndarray | None = None  # as in `Recording`
    gains: object = None  # as in `RobotIdentifier`; None: torques have a known size
    recordings: tuple = ("0",)  # names of the recordings
    alone: bool = False  # whether it is one of several recordings
    poses: Signals | None = None  # poses and slow motion, in place of filtered rows

    def __post_init__(self):
        self.model, self.nv = self.folded.model, self.folded.model.nv
        self.slides, self.every = is_prismatic(self.model), tuple(range(self.nv))
        # Whether the torques are computed from position commands.
        self.commanded = self.drive is not None and self.drive.uses_positions
        self.measured, self.turns = not self.commanded, not self.slides.all()
        self.moves = self.measured and self.poses is None

    @functools.cached_property
    def signals(self):
        """Filtered signals; None if the log is too short."""
        channels = self.q, self.tau, self.dt, self.parts, self.usable
        signals = self.poses or filter_signals(*channels)
        n_rows = number.MOST_ENTRIES // (10 * self.nv**2)
        n_rows = int(np.clip(n_rows, number.LEAST_ROWS, number.MOST_ROWS))
        return None if signals is None else signals.subsample(n_rows)

    @functools.cached_property
    def bodies(self):
        return Bodies(self.folded)

    @functools.cached_property
    def robot(self):
        return DescribedRobot(self.bodies, self.signals)

    @property
    def poor(self):
        """Whether some torque fits badly enough to test other interpretations."""
        return bool((self.robot.baseline.loss > 2 * np.log(number.GOOD_FIT)).any())

    @property
    def weighs(self):
        """Whether measured torques should contain a weight by the description."""
        return self.measured and not self.bodies.weightless

    @property
    def several(self):
        """Whether several joints are compared with the description."""
        return self.robot.joints.size > 1

    @property
    def zeroed(self):
        """Whether all positions begin at zero, as if set there at power-up."""
        # A log that begins at the zero of the description is not distinguishable.
        near = np.abs(self.q[0]) <= number.AT_ZERO * np.ptp(self.q, axis=0)
        return self.measured and bool(near.all())

    def select_parts(self, numbers, alone=False):
        rows, parts = subsample([self.parts[k] for k in numbers])
        channels = {x: getattr(self, x)[rows] for x in ("q", "tau", "usable")}
        channels["recordings"] = tuple(self.recordings[k] for k in numbers)
        return replace(self, **channels, parts=parts, alone=alone)

    def is_uninformative(self):
        """Whether torques or description allow no comparison."""
        if self.signals is None or not self.signals.informative().any():
            return True
        return self.bodies.massless or not self.robot.joints.size

    def score(self, change):
        """Return a cheap score: sum over joints of the log unexplained share."""
        # The described bodies are fixed up to a factor of their inertial torque and
        # one of their weight.
        signals = change.signals(self._rough_signals)
        return _loss(self.bodies, signals, self.robot.joints, signals.tau).sum()

    @functools.cached_property
    def _rough_signals(self):
        """Signals of fewer rows where there are many joints."""
        return self.signals.subsample(max(number.LEAST_ROUGH, number.ROUGH // self.nv))

    @functools.cached_property
    def cross_scores(self):
        """Rough scores of each motion with each torque, (n_joints, n_joints)."""
        signals, joints = self._rough_signals, self.robot.joints
        costs = [_loss(self.bodies, signals, joints, x[:, None]) for x in signals.tau.T]
        return np.column_stack([costs[j] for j in joints])

    def fit_change(self, change):
        """Return the `BodyFit` after a change, None if it has other usable joints."""
        robot = self.robot_after(change)
        return robot.fit() if robot.joints.size == self.robot.joints.size else None

    def robot_after(self, change):
        """Return the described robot for the signals after a change."""
        signals = change.signals(self.signals)
        regressor = None if change.changes_motion else self.robot.regressor
        if change.gravity is not None:
            regressor = self.robot.under_gravity(change.gravity / 9.81)
        return DescribedRobot(self.bodies, signals, self.robot.times, regressor)

    def apply(self, change):
        """Return the log after a change; its signals are filtered again."""
        q = _map(self.q, change.positions) + change.offset
        tau, usable = _map(self.tau, change.torques), change.map_usable(self.usable)
        dt, robot = self.dt * change.period, self.folded
        if change.gravity is not None:
            robot = replace(robot, full=under_gravity(robot.full, change.gravity))
        if change.lag:
            tau, usable = tau.copy(), usable.copy()
            first, last = max(0, -change.lag), max(0, change.lag)
            for part in self.parts:
                tau[part] = np.roll(tau[part], -change.lag, axis=0)
                usable[part][:first] = False
                usable[part][len(tau[part]) - last :] = False
        after = replace(self, folded=robot, q=q, tau=tau, dt=dt, usable=usable)
        return replace(after, poses=self.poses and change.signals(self.poses))


def _loss(robot, signals, joints, tau):
    """Log of the share of torques (n, nv or 1) that the description leaves."""
    nv, weight = robot.nv, signals.weight[:, joints].T
    v, a = (x[:, joints] for x in np.split(signals.states, 3, axis=1)[1:])
    bodies = [x[:, joints] for x in robot.described(signals.states)]
    X = np.stack([*bodies, v, signals.sign[:, joints], a, np.ones_like(v)], axis=-1)
    X = X.swapaxes(0, 1) * weight[:, :, None]
    y = np.broadcast_to(tau, (len(v), nv))[:, joints].T * weight
    count = np.maximum(weight.sum(axis=1), 1.0)
    total = ((y - y.sum(axis=1)[:, None] / count[:, None]) ** 2 * weight).sum(axis=1)
    y = y - X[:, :, :2].sum(axis=-1)
    gram = X.swapaxes(1, 2) @ X
    square = np.einsum("jkk->jk", gram)
    share = np.r_[number.ROUGH_PRIOR, number.ROUGH_PRIOR, np.full(4, 1e-6)]
    penalty = square * share + 1e-300
    gram = gram + np.eye(6) * penalty[:, None]
    theta = np.linalg.solve(gram, X.swapaxes(1, 2) @ y[:, :, None])
    residual = ((y[:, :, None] - X @ theta) ** 2).sum(axis=(1, 2))
    # Deviations of both factors from one count as errors.
    residual += (theta[:, :2, 0] ** 2 * penalty[:, :2]).sum(axis=1)
    return np.log(np.maximum(residual / np.maximum(total, 1e-300), 1e-12))


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A change that a hypothesis proposes, with the facts of its message.

    If `clear` is false, it is more probable than the unchanged log, but leaves errors
    too large to report it; then no less probable change is reported either.
    """

    joints: tuple
    log_odds: float  # against the log as it is, before the prior odds
    change: Change | None = None  # which corrects the fault
    fall: float = 0.0  # sum over joints of the fall of the log squared errors
    clear: bool = True
    kind: str = ""  # key of the message; by default the hypothesis's name
    severity: str = ""  # by default the hypothesis's
    value: float = np.nan
    remedy: Mapping | None = None
    facts: Mapping = field(default_factory=dict)


def judge(reading, change, required=None, *, variants=1, **attributes):
    """Return the `Proposal` of a change; clear if errors fall by `required` [log]."""
    # variants: number of alternatives tested, which reduces the log odds.
    fit, baseline = reading.fit_change(change), reading.robot.baseline
    if fit is None or not (change.joints or change.changes_motion):
        return None
    required = clear(change) if required is None else required
    odds = fit.evidence - baseline.evidence - np.log(max(variants, 1))
    attributes = {"joints": change.joints, "change": change} | attributes
    fall = fit.fall(baseline)
    return Proposal(log_odds=odds, fall=fall, clear=fall >= required, **attributes)


def most_likely(reading, changes):
    """Return the most probable of the changes with the best rough scores."""
    changes = list(changes)
    gain = reading.score(Change()) - np.array([reading.score(x) for x in changes])
    # Changes that score as well as the unchanged log are kept as rivals.
    candidates = np.argsort(-gain)[: number.MOST_LIKELY]
    candidates = [changes[k] for k in candidates if gain[k] > -number.SETTLED]
    return most_probable(judge(reading, x, variants=len(changes)) for x in candidates)


def climb(reading, moves, starts=(), step=number.CLEAR):
    """Combine moves greedily, from the best start or move, and return the change."""
    # step: least fall of the rough score per move.
    current, score, candidates = Change(), reading.score(Change()), [*starts, *moves]
    while candidates:
        scores = [reading.score(change) for change in candidates]
        best = int(np.argmin(scores))
        if scores[best] > score - step:
            break
        current, score = candidates[best], scores[best]
        candidates = [current.then(move) for move in moves]
    return current


def most_probable(candidates):
    """Return the candidate of the greatest odds; None if there is none."""
    return max(filter(None, candidates), key=lambda x: x.log_odds, default=None)


def refine(reading, change, steps):
    """Refine a change by Gauss-Newton along steps; also their standard errors."""
    # steps: functions from a step size to the change to append.
    best, errors = reading.fit_change(change), np.full(len(steps), np.inf)
    for _ in range(4 * number.PASSES if best is not None and steps else 0):
        robot = reading.robot_after(change)
        after = [
            change.then(make(x)).signals(reading.signals)
            for x, make in product((number.SLOPE, -number.SLOPE), steps)
        ]
        residuals = [x.tau - reading.bodies.torques(x.states) for x in after]
        residuals = np.split(np.array(residuals), 2)
        columns = -np.subtract(*residuals).transpose(1, 2, 0) / (2 * number.SLOPE)
        fit = robot.fit(columns=columns, deviation=number.STEP_OF_ZERO)
        errors, updated = fit.errors, change
        for make, x in zip(steps, fit.factors):
            updated = updated.then(make(x))
        fit = reading.fit_change(updated)
        if fit is None or fit.evidence < best.evidence + 0.1:
            break
        best, change = fit, updated
    return change, errors


def clear(change):
    """Return the least fall of log squared errors of a change of some joints."""
    return number.CLEAR_OF_JOINT * len(change.joints)


def clear_of_all(reading):
    """Return the least fall of log squared errors of a change of the whole log."""
    return number.CLEAR * reading.robot.joints.size
