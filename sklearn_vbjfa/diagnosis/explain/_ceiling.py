"""The ceiling: how much of what remains a function could explain at all.

What a model leaves of the torque may have a cause that no effect of the library
describes, or none that repeats. What even a function that is free to take any form
cannot predict, on other blocks of time and other recordings, no effect with these
signals can.

Boosted trees can follow any function, and any noise. How many of them are taken and how
far their sum is believed is therefore decided on blocks of time that they were not
fitted to, and what they are worth is measured on others again. Rows next to those that
a function is tried on are left out of its fit, since the residual remembers its past.
"""

import functools
import itertools
from dataclasses import dataclass, field

import numpy as np
from sklearn.utils import check_random_state
from threadpoolctl import threadpool_limits

from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.diagnosis.explain._evidence import (
    SMALLEST_GAIN,
    Whitening,
    compare,
    memory_seconds,
)

# What a residual may be a function of, each with all that stands before it.
SOURCES = ("speed and load", "state and history", "all joints")
# Earlier speeds, in periods of the cut-off.
_LAGS = (0.5, 1.0, 2.0, 4.0)
# A function is judged where at least this share of the rows lies in its range.
_TRIED = 0.5
# Bins of a map over speed and load, and the quantiles at its edges.
_COLUMNS, _ROWS, _EDGES = 16, 10, (0.005, 0.995)


# -- flexible functions ----------------------------------------------------------------

# Folds of interleaved blocks, and most groups of recordings.
_FOLDS = 4
# A block is this many times as long as the residual stays correlated, as far as there
# are this many blocks to a fold; more blocks than the second number tell no more.
_CORRELATION_TIMES = 10.0
_BLOCKS_PER_FOLD = (2, 10)
# Times for which the residual stays correlated that are left out of a fit next to
# what it is tried on, and most of the length of a block.
_GAP_TIMES, _MOST_GAP = 3.0, 0.25
# Trees: enough for a bent surface over two signals, few leaves since rows are noisy.
_TREES, _LEAVES, _LEAF, _BINS, _RATE = 40, 8, 20, 64, 0.15
# Most rows that trees are grown on.
_MOST_ROWS = 3000
# Independent values that a function needs: those of a tree with full leaves.
FEWEST_VALUES = _LEAVES * _LEAF


@dataclass(frozen=True, kw_only=True, eq=False)
class Fold:
    """Rows that a function is judged on, and what it is fitted to."""

    test: np.ndarray  # (m,): rows that it is judged on
    train: np.ndarray  # (m,): rows that it is fitted to
    # rows of that for a first fit, and others of it that decide how many trees are
    # taken
    trials: tuple


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretches:
    """Rows in interleaved blocks of time, with gaps between fitted and judged ones."""

    label: np.ndarray  # (m,): fold of each row
    gap: int  # rows next to those of a fold that are not fitted either

    @classmethod
    def of(cls, view, seconds, random_state):
        """Divide the rows of a `RecordingView` whose residual is correlated so long."""
        m = view.index.size
        total = m * view.step
        length = max(1.0 / view.robot.cutoff_, view.step)
        fewest, most = (_FOLDS * count for count in _BLOCKS_PER_FOLD)
        wanted = total / max(_CORRELATION_TIMES * seconds, 2.0 * length)
        count = int(np.clip(wanted, fewest, most))
        edges = np.r_[view.starts, m]
        block = np.empty(m, dtype=int)
        first = 0
        for a, b in itertools.pairwise(edges):
            own = min(max(1, round(count * (b - a) / m)), b - a)
            block[a:b] = first + np.arange(b - a) * own // (b - a)
            first += own
        # In no regular order, which a periodic motion could follow.
        order = [random_state.permutation(_FOLDS) for _ in range(first // _FOLDS + 1)]
        gap = max(min(_GAP_TIMES * seconds, _MOST_GAP * total / first), length)
        return cls(
            label=np.concatenate(order)[block],
            gap=min(int(np.ceil(gap / view.step)), m),
        )

    def near(self, fold):
        """Rows of a fold and those next to them, (m,) bool."""
        inside = np.cumsum(np.r_[0, self.label == fold])
        place = np.arange(self.label.size)
        low = np.maximum(place - self.gap, 0)
        high = np.minimum(place + self.gap + 1, self.label.size)
        return inside[high] > inside[low]

    def other_blocks(self):
        """Judge each fold by functions fitted to the others, list of Fold."""
        near = [self.near(k) for k in range(_FOLDS)]
        return [
            Fold(
                test=self.label == k,
                train=~near[k],
                trials=tuple(
                    (~(near[k] | near[j]), (self.label == j) & ~near[k])
                    for j in range(_FOLDS)
                    if j != k
                ),
            )
            for k in range(_FOLDS)
        ]

    def other_recordings(self, origin):
        """Judge each recording by functions fitted to the others, list of Fold."""
        # None if there is only one. Of many, several are left out together. What is
        # fitted to one alone is first tried on blocks of it.
        _, number = np.unique(origin, return_inverse=True)
        count = int(number.max()) + 1
        if count == 1:
            return None
        groups = min(count, _FOLDS)
        group = number * groups // count
        folds = []
        for k in range(groups):
            test = group == k
            if groups > 2:
                trials = [
                    (~test & (group != j), group == j) for j in range(groups) if j != k
                ]
            else:
                trials = [
                    (~test & ~self.near(j), ~test & (self.label == j))
                    for j in range(_FOLDS)
                ]
            folds.append(Fold(test=test, train=~test, trials=tuple(trials)))
        return folds


@dataclass(frozen=True, kw_only=True, eq=False)
class FlexibleFunction:
    """Boosted trees of some signals."""

    signals: np.ndarray  # (m, k): what it is a function of; nan where unknown
    span: np.ndarray  # (m, r): signals outside whose range a function says nothing
    target: np.ndarray  # (m,): what it should be
    weight: np.ndarray  # (m,): rows of weight zero do not count
    random_state: int
    _stages: dict = field(default_factory=dict, repr=False)

    def out_of_sample(self, folds):
        """Predict the rows of all folds by functions fitted to others, (m,)."""
        # nan where a function would have to leave its range, or there is none.
        out = np.full(self.target.size, np.nan)
        for fold in folds:
            if not fold.train[self._rows].any():
                continue
            test = np.flatnonzero(fold.test & self._reached(fold.train))
            out[test] = 0.0
            count, share = self._believed(fold.trials)
            trees = self._grown(fold.train, count) if count and test.size else None
            if trees is not None:
                out[test] = share * trees.predict(self._ranks[test])
        return out

    def _reached(self, train):
        """Rows that count, with all signals in the range that was fitted, (m,) bool."""
        fitted = self.span[self._rows[train[self._rows]]]
        inside = (self.span >= fitted.min(axis=0)) & (self.span <= fitted.max(axis=0))
        return inside.all(axis=1) & (self.weight > 0)

    def _believed(self, trials):
        """How many trees to take, and which share of their sum; 0 for nothing."""
        product, square = np.zeros(_TREES), np.zeros(_TREES)
        for train, valid in trials:
            stages = self._stages_of(train)
            if stages is not None:
                used = (valid & self._reached(train))[self._rows]
                weight = self.weight[self._rows[used]]
                product += stages[:, used] @ (weight * self.target[self._rows[used]])
                square += stages[:, used] ** 2 @ weight
        share = np.clip(product / np.where(square > 0, square, np.inf), 0.0, 1.0)
        saved = (2.0 * product - share * square) * share
        best = int(np.argmax(saved))
        return (best + 1, float(share[best])) if saved[best] > 0 else (0, 0.0)

    @functools.cached_property
    def _ranks(self):
        """Signals as ranks in steps, so that no unit matters; -1 where unknown."""
        # All functions share the steps, which the trees would look for each time.
        out = np.full(self.signals.shape, -1.0)
        for signal, ranks in zip(self.signals.T, out.T):
            known = np.isfinite(signal)
            counted = signal[self._rows][known[self._rows]]
            if counted.size:
                edges = np.quantile(counted, np.linspace(0, 1, _BINS + 1)[1:-1])
                ranks[known] = np.searchsorted(edges, signal[known])
        return out

    @functools.cached_property
    def _rows(self):
        """Rows that count, thinned."""
        rows = np.flatnonzero(self.weight > 0)
        return rows[:: -(-rows.size // _MOST_ROWS) or 1]

    def _stages_of(self, train):
        """Predict the thinned rows with one tree, two, ...; kept, as folds share it."""
        key = train.tobytes()
        if key not in self._stages:
            trees = self._grown(train, _TREES)
            if trees is not None:
                trees = np.array([*trees.staged_predict(self._ranks[self._rows])])
            self._stages[key] = trees
        return self._stages[key]

    def _grown(self, train, count):
        """Grow trees on some of the rows; None on too few for a leaf on each side."""
        # Loads a hundred modules of scikit-learn that nothing else here needs.
        from sklearn.ensemble import HistGradientBoostingRegressor

        rows = self._rows[train[self._rows]]
        trees = HistGradientBoostingRegressor(
            learning_rate=_RATE,
            max_iter=count,
            max_leaf_nodes=_LEAVES,
            min_samples_leaf=_LEAF,
            # One for each of the ranks.
            max_bins=_BINS + 1,
            # Its own early stopping holds out single rows, which their neighbours know.
            early_stopping=False,
            random_state=self.random_state,
        )
        if rows.size < 2 * _LEAF:
            return None
        return trees.fit(self._ranks[rows], self.target[rows], self.weight[rows])


# -- what they explain -----------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Ceiling:
    """How much of a joint's residual a function of any form explains."""

    # Of its own speed and load; of its own state and history; of the states and loads
    # of all joints. Each includes the signals of the one before.

    joint: int  # from zero
    joint_name: str
    # shares of the squared residual that functions fitted to other blocks of time
    # explain; zero where that is no more than chance
    within: tuple
    # same of functions fitted to other recordings, as far as these reach the joint's
    # speeds and loads; nan if that is less than half of the time, or for one recording
    across: tuple
    # what repeats: the smaller of those that are known
    share: tuple = field(init=False)

    def __post_init__(self):
        share = tuple(map(float, np.fmin(self.within, self.across)))
        object.__setattr__(self, "share", share)


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
    for j in counted(joints, "ceiling", "joints"):
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
        dt = view.dt or 1.0
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
