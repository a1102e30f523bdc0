"""Small regressions of single torque channels, judged by errors in unseen blocks.

The checks that need a robot model compare such regressions: of the recording as it is,
and of the same recording read in another way.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.model import nominal_parameters
from sklearn_vbjfa.recording._recording import contiguous_groups
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._plan import STANDSTILL_SHARE
from sklearn_vbjfa.robot._states import StateEstimator

# Shorter recordings are skipped [samples].
MIN_SAMPLES = 64
# Standard errors that evidence needs.
SURE = 5.0
# Share of the torque that the nominal model must explain to count as evidence.
NOMINAL_SHARE = 0.5


def fits_of(equations, signals):
    """Fit informative joints' torques as recorded, joint -> `ChannelFit`."""
    now = signals.now
    return {
        int(j): equations.fit(j, now[:, [j]])
        for j in np.flatnonzero(signals.informative())
    }


def fits_to(model, signals):
    """Fit informative joints' torques by the equations of a model."""
    return fits_of(ChannelEquations(model, signals), signals)


def total(fits):
    """Logarithms of squared errors by block, ndarray (n_blocks,), mean over joints."""
    # An error above that of the torque's mean counts as the latter: how much worse it
    # is says nothing, and is no evidence for what predicts the torque a little less
    # badly.
    return np.mean(
        [np.minimum(fit.log_error[:, 0], fit.log_variance) for fit in fits.values()],
        axis=0,
    )


# The cut-off is this multiple of the frequency below which 90 % of the velocity's power
# lies: noise of a fast encoder must not pass for motion.
_CUTOFF_PER_BANDWIDTH = 7.0
# ... but the filter must remain short compared with the longest recording.
_CUTOFF_PERIODS = 36.0
# Shifts between positions and torques that are tried, to either side.
_N_SHIFTS = 10
_SHORTEST_SHIFT = 0.002  # s
# Equations in use; more cost time without adding evidence.
_MOST_ROWS = 2500
# Blocks of time, whose errors are nearly independent.
N_BLOCKS = 10
# With fewer moving samples a joint is not judged.
FEWEST_ROWS = 60
# Relative error of the nominal inertias: the prior of the regressions.
_NOMINAL_ERROR = 0.5
# A nominal torque below this share of what such errors cause is no evidence: the
# inertias cancel in it, as in a balanced wrist.
_LEAST_NOMINAL = 0.15


@dataclass(frozen=True, kw_only=True)
class ChannelSignals:
    """Filtered and decimated signals."""

    states: np.ndarray  # (n, 3 * nv): filtered states [q | v | a]
    sign: np.ndarray  # (n, nv): filtered signs of the velocities
    # (n, nv, n_shifts): filtered torques, read `shifts` samples after the positions
    tau: np.ndarray
    weight: np.ndarray  # (n, nv): 1 where the joint moves and no fault is known, else 0
    block: np.ndarray  # (n,): block of time of each row
    shifts: np.ndarray  # (n_shifts,): samples; the middle one is zero

    @property
    def now(self):
        """Torques as recorded, ndarray of shape (n, nv)."""
        return self.tau[:, :, self.shifts.size // 2]

    def informative(self):
        """Return which joints have enough rows, ndarray of shape (nv,) of bool."""
        return self.weight.sum(axis=0) >= FEWEST_ROWS

    def scaled(self, factor):
        """Return the signals with positions multiplied by factors (nv,)."""
        return replace(self, states=self.states * np.tile(factor, 3))

    def permuted(self, order, *, positions, torques):
        """Return the signals with the channel `order[j]` (nv,) read for joint j."""
        signals = self
        if positions:
            n = self.states.shape[0]
            states = self.states.reshape(n, 3, -1)[:, :, order].reshape(n, -1)
            signals = replace(
                signals,
                states=states,
                sign=self.sign[:, order],
                weight=self.weight[:, order],
            )
        if torques:
            signals = replace(signals, tau=self.tau[:, order])
        return signals

    def signed(self, sign):
        """Return the signals with torques multiplied by signs (nv,)."""
        return replace(self, tau=self.tau * sign[:, None])

    def flipped(self, sign):
        """Return the signals with joints reversed where their sign (nv,) is -1."""
        return replace(
            self.signed(sign),
            states=self.states * np.tile(sign, 3),
            sign=self.sign * sign,
        )

    def shifted(self, offset):
        """Return the signals with offsets (nv,) added to the positions."""
        still = np.zeros_like(offset)
        return replace(self, states=self.states + np.r_[offset, still, still])

    def retimed(self, factor):
        """Return the signals with a sample period that is shorter by a factor."""
        nv = self.sign.shape[1]
        scale = np.repeat([1.0, factor, factor**2], nv)
        return replace(self, states=self.states * scale)

    def thinned(self, most):
        """Return every k-th row, about `most` of them."""
        k = max(1, self.block.size // most)
        rows = {
            name: getattr(self, name)[::k]
            for name in ("states", "sign", "tau", "weight", "block")
        }
        return replace(self, **rows)


def long_parts(n, groups):
    """Rows of the recordings that are long enough, and where each is among them."""
    parts = contiguous_groups(groups, n)
    parts = [part for part in parts if part.stop - part.start >= MIN_SAMPLES]
    rows = [np.arange(part.start, part.stop) for part in parts]
    stops = np.cumsum([0, *map(len, rows)]).tolist()
    found = [slice(a, b) for a, b in pairwise(stops)]
    return np.concatenate([np.zeros(0, dtype=int), *rows]), found


def channel_signals(q, tau, dt, parts, usable):
    """Filter q, tau (n, nv) of recordings; None if all are shorter than the filter."""
    # `usable` (n, nv) marks samples without known faults.
    n, nv = q.shape
    labels = np.repeat(np.arange(len(parts)), [p.stop - p.start for p in parts])
    states = StateEstimator(dt).fit(q, groups=labels).transform(q, groups=labels)
    v = states[:, nv : 2 * nv]
    lowpass = _lowpass.design(dt, _cutoff(v, dt, parts))
    shifts = max(1, round(_SHORTEST_SHIFT / dt)) * np.arange(-_N_SHIFTS, _N_SHIFTS + 1)
    slow = STANDSTILL_SHARE * np.quantile(np.abs(v), 0.995, axis=0)
    weight = ((np.abs(v) > slow) & usable).astype(float)
    pieces = []
    for part in parts:
        start, stop = part.start + shifts[-1], part.stop - shifts[-1]
        if stop - start < 2 * lowpass.half + 1:
            continue
        inner = slice(start, stop)
        shifted = [lowpass(tau[start + k : stop + k]) for k in shifts]
        pieces.append(
            (
                lowpass(states[inner]),
                lowpass(np.sign(v[inner])),
                np.stack(shifted, axis=-1),
                lowpass.average(weight[inner]),
            )
        )
    if not pieces:
        return None
    states, sign, torque, weight = (np.concatenate(x) for x in zip(*pieces))
    n = states.shape[0]
    signals = ChannelSignals(
        states=states,
        sign=sign,
        tau=torque,
        weight=(weight > 0.9).astype(float),
        block=np.arange(n) * N_BLOCKS // n,
        shifts=shifts,
    )
    return signals.thinned(_MOST_ROWS)


def _cutoff(v, dt, parts):
    """Cut-off [Hz] above the motion."""
    longest = max(part.stop - part.start for part in parts)
    size = 2 ** int(np.ceil(np.log2(longest)))
    power = np.zeros((size // 2 + 1, v.shape[1]))
    for part in parts:
        tapered = v[part] * np.hanning(part.stop - part.start)[:, None]
        power += np.abs(np.fft.rfft(tapered, n=size, axis=0)) ** 2
    total = np.cumsum(power, axis=0)
    share = total / np.maximum(total[-1], np.finfo(float).tiny)
    # The velocity of a joint at rest is noise.
    fast = np.ptp(v, axis=0) > 1e-3 * np.ptp(v)
    bandwidth = (share[:, fast] < 0.9).sum(axis=0).max(initial=1) / (size * dt)
    return float(
        max(_CUTOFF_PER_BANDWIDTH * bandwidth, _CUTOFF_PERIODS / (longest * dt))
    )


@dataclass(frozen=True, kw_only=True)
class ChannelErrors:
    """Errors of one torque channel, for several versions of the torque."""

    # (n_blocks, n_versions): logarithm of the mean squared error of each block,
    # predicted from the others; nan for blocks without rows
    log_error: np.ndarray
    log_variance: float  # of the torque


@dataclass(frozen=True, kw_only=True)
class ChannelFit(ChannelErrors):
    """Fit of one torque channel, for several versions of the torque."""

    # (n_versions,): root mean squared error in unseen blocks, over the torque's
    # deviation
    error: np.ndarray
    friction: float  # root mean square of the friction found, relative to the torque's
    power: float  # mean power that friction takes out of the motion [W]
    power_t: float  # the same in standard errors


class ChannelEquations:
    """Regressors of every joint's torque, from a model and its filtered recording."""

    # Of the regressor only the entries that some motion makes nonzero are kept: on a
    # robot of many branches they are few. Another reading of the channels of the same
    # robot may take over the features of an earlier one.

    def __init__(self, model, signals, features=None):
        if features is None:
            features = RigidBodyFeatures(model, friction=()).load()
        self.features = features
        self._support = [np.flatnonzero(row) for row in features.support_]
        self._edges = np.cumsum([0, *(own.size for own in self._support)])
        self._entries = features.entries(signals.states)
        self._parameters = nominal_parameters(model).ravel()
        self._nominal = self._torques(self._entries)
        self._at_rest = None
        # What is left of a torque that is zero in every motion is rounding.
        size = np.abs(self._nominal).max(axis=0)
        self._nominal[:, size < 1e-9 * size.max(initial=0.0)] = 0.0
        self._spread = body_spread(model)
        self._signals = signals

    def sizes(self):
        """Median deviation of each torque over that of the nominal robot's, (nv,)."""
        ours, nominal = (
            np.median(np.abs(x - np.median(x, axis=0)), axis=0)
            for x in (self._signals.now, self._nominal)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(nominal > 0, ours / nominal, np.nan)

    def _rigid(self, j):
        """Regressor of a joint's torque (n, k), without columns that are zero."""
        return self._entries[self._edges[j] : self._edges[j + 1]].T

    def _torques(self, entries):
        """Nominal torques from the entries of the regressor, (n, nv)."""
        return np.column_stack(
            [
                self._parameters[own] @ entries[start:stop]
                for own, start, stop in zip(self._support, self._edges, self._edges[1:])
            ]
        )

    def weight(self, j):
        """Weights of a joint's rows, ndarray of shape (n,)."""
        return self._signals.weight[:, j]

    def fit(self, j, torque, weight=None):
        """Fit a joint's torque (n, n_versions) by friction, spring, drive, inertias."""
        # Friction and spread are reported for the middle version; weight (n,): instead
        # of the joint's own.
        w = self.weight(j) if weight is None else weight
        middle = torque.shape[1] // 2
        y = torque[:, middle]
        friction, moments = self._moments(j, torque, w)
        theta, without = moments.solve(middle)
        log_error, error = moments.errors(without)
        power, power_t = _power(friction, theta, without, middle, w)
        found = friction @ theta[:2, middle]
        spread = max(_spread_of(y, w), np.finfo(float).tiny)
        return ChannelFit(
            error=error / spread,
            log_error=log_error,
            log_variance=2 * np.log(spread),
            friction=_rms(found, w) / max(_rms(y, w), np.finfo(float).tiny),
            power=power,
            power_t=power_t,
        )

    def least_errors(self, j, torque):
        """`ChannelErrors` below which those of `fit` of a version do not fall."""
        # At a third of the work, as nothing is fitted again without a block.
        w = self.weight(j)
        spread = max(_spread_of(torque[:, 0], w), np.finfo(float).tiny)
        _, moments = self._moments(j, torque, w)
        return ChannelErrors(
            log_error=moments.least_errors(), log_variance=2 * np.log(spread)
        )

    def _moments(self, j, torque, w):
        """Columns of friction (n, 2), and the regression of `fit`."""
        free = self._columns(j)
        # The torque may have any unit: the prior is scaled to its size.
        rigid, expected = self._drawn(j, w)
        y = torque[:, torque.shape[1] // 2]
        rigid *= _rms(y, w) / max(expected, np.finfo(float).tiny)
        moments = _Moments(free, rigid, torque, w, self._signals.block)
        return free[:, :2], moments

    def inertia_scale(self, j):
        """Regress the torque on nominal gravity and on the nominal rest, separately."""
        # Returns the factor of the nominal torque at rest and the same in standard
        # errors, and the factor of the rest of it and its standard error.
        n = self._signals.block.size
        w = self.weight(j)
        friction = self._columns(j)[:, :2]
        gravity = self._gravity()[:, j]
        motion = self._nominal[:, j] - gravity
        q = self._signals.states[:, j]
        rest = np.column_stack([friction, np.ones(n), q, np.sin(q), np.cos(q)])
        columns = np.column_stack([gravity, motion, rest])
        y = self._signals.now[:, [j]]
        block = self._signals.block
        none = np.zeros((n, 0))
        theta, without = _Moments(columns, none, y, w, block).solve(0)
        errors = [_jackknife_error(without[:, k, 0]) for k in (0, 1)]
        return (
            float(theta[0, 0]),
            float(theta[0, 0] / errors[0]),
            float(theta[1, 0]),
            float(errors[1]),
        )

    def _gravity(self):
        """Nominal torques of the robot at rest, ndarray of shape (n, nv)."""
        if self._at_rest is None:
            nv = self._signals.sign.shape[1]
            still = self._signals.states.copy()
            still[:, nv:] = 0.0
            self._at_rest = self._torques(self.features.entries(still))
        return self._at_rest

    def _drawn(self, j, w):
        """Columns in units of the prior, and the torque that it expects of them."""
        # What inertias drawn from it cause is the root of the sum of their squares.
        rigid = self._rigid(j) * self._spread[self._support[j]]
        return rigid, np.sqrt((w @ rigid**2).sum() / w.sum())

    def _columns(self, j):
        """Columns of friction, and of other torques beside the links (n, 2 + 6)."""
        n, nv = self._signals.sign.shape
        q, v, a = self._signals.states[:, j::nv].T
        # A spring or a counterbalance must not pass for gravity of the wrong sign.
        others = [self._nominal[:, j], np.ones(n), a, q, np.sin(q), np.cos(q)]
        return np.column_stack([v, self._signals.sign[:, j], *others])

    def nominal_scale(self, j, *, rotor=False):
        """Regress the torque on the nominal one, friction and a spring."""
        # rotor: whether the joint's acceleration has a column of its own; a geared
        # rotor may have many times the inertia of a light link. Returns the factor of
        # the nominal torque, the same in standard errors, and the share that it
        # explains of what friction and spring leave.
        n, nv = self._signals.sign.shape
        w = self.weight(j)
        y = self._signals.now[:, [j]]
        nominal = self._nominal[:, j]
        if _rms(nominal, w) <= _LEAST_NOMINAL * self._drawn(j, w)[1]:
            return 0.0, 0.0, 0.0
        friction = self._columns(j)[:, :2]
        q = self._signals.states[:, j]
        rest = np.column_stack([friction, np.ones(n), q])
        if rotor:
            rest = np.column_stack([rest, self._signals.states[:, 2 * nv + j]])
        with_nominal = np.column_stack([nominal, rest])
        none = np.zeros((n, 0))
        block = self._signals.block
        theta, without = _Moments(with_nominal, none, y, w, block).solve(0)
        alone, _ = _Moments(rest, none, y, w, block).solve(0)
        left = _rms((y - with_nominal @ theta)[:, 0], w)
        before = _rms((y - rest @ alone)[:, 0], w)
        scale = theta[0, 0]
        error = _jackknife_error(without[:, 0, 0])
        share = 1.0 - (left / max(before, np.finfo(float).tiny)) ** 2
        return float(scale), float(scale / error), float(share)


class _Moments:
    """Ridge regression with all blocks and with each block left out."""

    # Rows count if they have weight, and are in the order of their blocks.

    def __init__(self, free, rigid, torque, weight, block):
        rows = np.flatnonzero(weight > 0)
        self._design = np.hstack([free, rigid])[rows]
        self._n_free = free.shape[1]
        # In place, as the rows are a copy.
        own = self._design[:, : self._n_free]
        scale = np.sqrt((own**2).sum(axis=0) / rows.size)
        scale[scale == 0] = 1.0
        own /= scale
        self._scale = np.r_[scale, np.ones(rigid.shape[1])]
        self._torque = torque[rows]
        edges = np.searchsorted(block[rows], np.arange(N_BLOCKS + 1))
        self._rows = [slice(a, b) for a, b in pairwise(edges)]
        self._count = np.diff(edges)

    def _regularised(self, middle, G, g):
        """Add the prior to G (p, p) of all rows; solve it for g (p,) of a version."""
        # The prior is in units of the parameters; its weight follows the noise of that
        # version.
        y = self._torque[:, middle]
        spread = np.var(y)
        variance = 0.1 * spread
        total = G.copy()
        ridge = total.reshape(-1)[:: g.size + 1]
        ridge[: self._n_free] += 1e-8 * y.size
        diagonal = np.diagonal(G)[self._n_free :]
        for _ in range(3 if diagonal.size else 1):
            ridge[self._n_free :] = diagonal + max(variance, 1e-9 * spread + 1e-300)
            theta = np.linalg.solve(total, g)
            left = y - self._design @ theta
            variance = left @ left / y.size
        return total, theta

    def solve(self, middle):
        """Return theta (p, m), and thetas (n_blocks, p, m) with a block left out."""
        pieces = [(self._design[rows], self._torque[rows]) for rows in self._rows]
        own = np.array([A.T @ A for A, _ in pieces])
        own_g = np.array([A.T @ y for A, y in pieces])
        g = own_g.sum(axis=0)
        G, _ = self._regularised(middle, own.sum(axis=0), g[:, middle])
        theta = np.linalg.solve(G, g)
        without = np.linalg.solve(G - own, g - own_g)
        return theta / self._scale[:, None], without / self._scale[:, None]

    def errors(self, without):
        """Return log mean squared errors by blocks, and the overall root."""
        left = [
            self._torque[rows] - self._design[rows] @ (theta * self._scale[:, None])
            for rows, theta in zip(self._rows, without)
        ]
        squares = self._squares(np.concatenate(left))
        known = np.isfinite(squares[:, 0])
        total = np.average(squares[known], axis=0, weights=self._count[known])
        return np.log(np.maximum(squares, np.finfo(float).tiny)), np.sqrt(total)

    def least_errors(self):
        """Return log mean squared errors (n_blocks, 1) of the fit to all blocks."""
        # Those of `errors` do not fall below them: a block's residuals without it are
        # these, times the inverse of I - H, where H is its block of the hat matrix and
        # has eigenvalues from 0 to below 1.
        design, torque = self._design, self._torque
        _, theta = self._regularised(0, design.T @ design, design.T @ torque[:, 0])
        left = torque - design @ theta[:, None]
        squares = self._squares(left)
        return np.log(np.maximum(squares, np.finfo(float).tiny))

    def _squares(self, left):
        """Mean squares of residuals (n, m) by blocks; nan with fewer than 3 rows."""
        squares = np.array([(left[rows] ** 2).sum(axis=0) for rows in self._rows])
        few = self._count < 3
        return np.where(few, np.nan, squares.T / np.where(few, 1, self._count)).T


def gain(better, worse):
    """Mean of worse - better, log errors by block, and the same in standard errors."""
    difference = worse - better
    difference = difference[np.isfinite(difference)]
    if difference.size < 4:
        return 0.0, 0.0
    error = difference.std(ddof=1) / np.sqrt(difference.size)
    mean = float(difference.mean())
    return mean, mean / max(error, 1e-3)


def _power(columns, theta, without, middle, w):
    """Power that friction dissipates, in W and in standard errors."""
    v = columns[:, 0]
    moments = np.average(columns * v[:, None], axis=0, weights=w)
    power = float(moments @ theta[:2, middle])
    error = _jackknife_error(without[:, :2, middle] @ moments)
    return power, power / error


def _jackknife_error(values):
    n = values.size
    return max(
        np.sqrt((n - 1) / n * np.sum((values - values.mean()) ** 2)),
        np.finfo(float).tiny,
    )


def _rms(x, w):
    return float(np.sqrt(w @ x**2 / w.sum()))


def _spread_of(x, w):
    return _rms(x - w @ x / w.sum(), w)


def body_spread(model):
    """Prior standard deviations of all inertial parameters, ndarray (10 nv,)."""
    parameters = nominal_parameters(model)
    mass = np.maximum(parameters[:, 0], 0.02 * parameters[:, 0].max() + 1e-12)
    trace = parameters[:, [4, 6, 9]].sum(axis=1)
    length = np.maximum(np.sqrt(np.maximum(0.5 * trace / mass, 0.0)), 0.05)
    columns = [mass] + 3 * [mass * length] + 6 * [mass * length**2]
    return _NOMINAL_ERROR * np.column_stack(columns).ravel()
