"""The ceiling: how much of what remains a function could explain at all.

What a model leaves of the torque may have a cause that no effect of the library
describes, or none that repeats. What even a function that is free to take any form
cannot predict, on other blocks of time and other recordings, no effect with these
signals can.
"""

from dataclasses import dataclass

import numpy as np
from sklearn.utils import check_random_state
from threadpoolctl import threadpool_limits

from sklearn_vbjfa.diagnosis.explain._evidence import SMALLEST_GAIN, compare
from sklearn_vbjfa.diagnosis.explain._findings import Ceiling
from sklearn_vbjfa.diagnosis.explain._flexible import (
    FEWEST_VALUES,
    FlexibleFunction,
    Stretches,
)
from sklearn_vbjfa.diagnosis.explain._whitening import Whitening, memory_seconds

# What a residual may be a function of, each with all that stands before it.
SOURCES = ("speed and load", "state and history", "all joints")
# Earlier speeds, in periods of the cut-off.
_LAGS = (0.5, 1.0, 2.0, 4.0)
# A function is judged where at least this share of the rows lies in its range.
_TRIED = 0.5
# Bins of a map over speed and load, and the quantiles at its edges.
_COLUMNS, _ROWS, _EDGES = 16, 10, (0.005, 0.995)


@dataclass(frozen=True, kw_only=True, eq=False)
class Map:
    """A residual over speed and load, beside the function that is fitted to it."""

    # edges of the map [rad/s or m/s, N m or N]
    speed: tuple
    load: tuple
    # (n_loads, n_speeds): weighted means in equal cells, nan where there is nothing [N
    # m or N]; of the function, as it predicts data that it was not fitted to
    measured: np.ndarray
    function: np.ndarray


def ceilings(model, joints, names, alpha, random_state=None):
    """Return what flexible functions explain of the residuals of some joints."""
    # A `Ceiling` of each with enough data to say, and a `Map` by joint where speed and
    # load explain something. names: of all joints; alpha: level over all joints and
    # functions together; random_state: shuffles the blocks of time, None counts as 0.
    view, found, maps = model.view, [], {}
    if not len(joints):
        return (), maps
    rng = check_random_state(0 if random_state is None else random_state)
    seed = int(rng.randint(2**31 - 1))
    root = view.root.T
    residual = model.residual / np.where(root > 0, root, np.inf)
    seconds, signals = memory_seconds(model), Signals.of(model)
    for j in joints:
        if _values(view, j) < FEWEST_VALUES:
            continue
        # For each joint alone, whatever the others are.
        order = np.random.RandomState(seed)
        trial = _Trial(
            view=view,
            joint=j,
            residual=residual[j],
            stretches=Stretches.of(view, seconds[j], order),
            level=alpha / (len(SOURCES) * len(joints)),
            seed=seed,
        )
        # Trees this small take longer on several threads, on a busy machine a hundred
        # times as long.
        with threadpool_limits(limits=1, user_api="openmp"):
            within, across, first = trial.shares(signals)
        found.append(
            Ceiling(joint=j, joint_name=names[j], within=within, across=across)
        )
        if found[-1].share[0] > 0:
            maps[j] = trial.map(signals, first)
    return tuple(found), maps


@dataclass(frozen=True, kw_only=True, eq=False)
class Signals:
    """Signals of all joints behind the low-pass, as functions may take them."""

    # (nv, m, 5): speed, load, sign of the speed, and the sizes of the first times the
    # last
    own: np.ndarray
    # (nv, m, k): position, acceleration, way and time since the last reversal, earlier
    # speeds
    state: np.ndarray

    @classmethod
    def of(cls, model):
        """Take the signals of a `FoundModel`."""
        view, motion = model.view, model.motion
        robot = view.robot
        dt = robot.dt or 1.0
        still = np.maximum(robot.standstill_, 0.0)
        period = 1.0 / robot.cutoff_ if np.isfinite(robot.cutoff_) else view.step
        lags = [max(1, round(lag * period / dt)) for lag in _LAGS]
        own, state = [], []
        for j in range(view.nv):
            v, load, sign = motion.v[:, j], motion.load[:, j], motion.sign(j)[:, 0]
            # What is a function of these at every sample is not one of their means.
            own.append([v, load, sign, np.abs(v), np.abs(load) * sign])
            way, since = since_reversal(motion.q[:, j], v, still[j], view.parts)
            earlier = [_delayed(v, lag, view.parts) for lag in lags]
            state.append([motion.q[:, j], motion.a[:, j], way, dt * since, *earlier])
        # (nv, k, n) to (n, nv, k)
        own, state = (np.moveaxis(np.array(x), 2, 0) for x in (own, state))
        own, state = (np.moveaxis(view.filtered(x), 0, 1) for x in (own, state))
        return cls(own=own, state=state)

    def tables(self, joint):
        """Signals (m, k) of each of `SOURCES` for a joint."""
        first = self.own[joint]
        second = np.concatenate([first, self.state[joint]], axis=1)
        # Positions, accelerations, speeds, loads and their signs: no history.
        others = [k for k in range(self.own.shape[0]) if k != joint]
        third = [x for k in others for x in (self.own[k, :, :3], self.state[k, :, :2])]
        return first, second, np.concatenate([second, *third], axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Trial:
    """The residual of a joint, and how functions are tried on it."""

    view: object
    joint: int
    residual: np.ndarray
    stretches: Stretches
    level: float
    seed: int

    @property
    def weight(self):
        return self.view.equations.weight[:, self.joint]

    def shares(self, signals):
        """Shares on other blocks and on other recordings, and the first function."""
        blocks = self.stretches.other_blocks()
        recordings = self.stretches.other_recordings(self.view.origin)
        within, across, first = [], [], None
        size = np.sqrt(np.average(self.residual**2, weights=self.weight))
        speed_and_load = signals.own[self.joint][:, :2]
        for table in signals.tables(self.joint):
            function = FlexibleFunction(
                signals=table,
                span=speed_and_load,
                target=self.residual / size,
                weight=self.weight / self.weight.max(),
                random_state=self.seed,
            )
            predicted = size * function.out_of_sample(blocks)
            within.append(self.explained(predicted))
            if recordings is None:
                across.append(np.nan)
            else:
                predicted = size * function.out_of_sample(recordings)
                across.append(self.explained(predicted))
            first = predicted if first is None else first
        # What fewer signals explain more of them do as well.
        return *(_rising(x) for x in (within, across)), first

    def explained(self, predicted):
        """Share of the squared residual that a function explains, beyond chance."""
        # In rows where it says something; nan where that is less than half of them.
        view, total = self.view, self.weight.sum()
        weight = np.where(np.isnan(predicted), 0.0, self.weight)
        if weight.sum() < _TRIED * total:
            return np.nan
        left = self.residual - np.nan_to_num(predicted)
        before = view.blocks.sums(weight * self.residual**2)
        after = view.blocks.sums(weight * left**2)
        if not before.sum() > after.sum():
            return 0.0
        root = np.sqrt(weight)[:, None]
        whiten = Whitening.of(view, left[None] * root.T, root)
        white = [
            view.blocks.sums(whiten(r[None] * root.T, [0])[0] ** 2)
            for r in (self.residual, left)
        ]
        case = compare(before, after, white)
        return case.gain if case.significant(self.level, SMALLEST_GAIN) else 0.0

    def map(self, signals, predicted):
        """Measured residual and function over speed and load, `Map`."""
        speed, load = signals.own[self.joint][:, :2].T
        used = (self.weight > 0) & np.isfinite(predicted)
        edges = [np.quantile(x[used], _EDGES) for x in (load, speed)]
        bins = [
            np.linspace(*edge, count + 1)
            for edge, count in zip(edges, (_ROWS, _COLUMNS))
        ]

        def means(values):
            total, count = (
                np.histogram2d(load[used], speed[used], bins, weights=w[used])[0]
                for w in (self.weight * values, self.weight)
            )
            return np.where(count > 0, total / np.where(count > 0, count, 1.0), np.nan)

        return Map(
            load=tuple(edges[0]),
            speed=tuple(edges[1]),
            measured=means(self.residual),
            function=means(predicted),
        )


def _values(view, joint):
    """Count the values of a joint's residual that are independent in its band."""
    weight = view.equations.weight[:, joint]
    per_row = min(2.0 * view.robot.cutoff_ * view.step, 1.0)
    return per_row * weight.sum() / max(weight.max(), np.finfo(float).tiny)


def _rising(shares):
    """Return the largest share so far, tuple of float; nan where it is not known."""
    return tuple(float(x) for x in np.maximum.accumulate(shares))


def since_reversal(q, v, still, parts):
    """Way and samples since a joint last turned round; nan before it first does."""
    # It has turned once it is faster than `still` the other way; until then it may only
    # tremble.
    way, since = (np.full(q.size, np.nan) for _ in range(2))
    for part in parts:
        sign = np.where(np.abs(v[part]) > still, np.sign(v[part]), 0.0)
        moving = np.flatnonzero(sign)
        turned = moving[1:][np.diff(sign[moving]) != 0]
        if turned.size == 0:
            continue
        place = np.arange(sign.size)
        last = np.searchsorted(turned, place, side="right") - 1
        known = last >= 0
        at = turned[last[known]]
        rows = part.start + place[known]
        way[rows] = np.abs(q[rows] - q[part.start + at])
        since[rows] = place[known] - at
    return way, since


def _delayed(signal, rows, parts):
    """Return what a signal was some rows ago; nan where that was not recorded."""
    out = np.full(signal.size, np.nan)
    for part in parts:
        if part.stop - part.start > rows:
            out[part.start + rows : part.stop] = signal[part.start : part.stop - rows]
    return out
