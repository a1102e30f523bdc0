"""A flexible function of signals, fitted to some stretches of time, judged on others.

Boosted trees can follow any function, and any noise. How many of them are taken and how
far their sum is believed is therefore decided on blocks of time that they were not
fitted to, and what they are worth is measured on others again. Rows next to those that
a function is tried on are left out of its fit, since the residual remembers its past.
"""

import functools
import itertools
from dataclasses import dataclass, field

import numpy as np

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
