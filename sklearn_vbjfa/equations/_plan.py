"""Requirements on a recording, and choices of its filter and standstill speeds."""

import itertools
import warnings
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np
from joblib import Parallel, delayed
from sklearn.base import clone

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa._core._runtime import counted, one_blas_thread
from sklearn_vbjfa.effects import (
    Bank,
    CommandDelay,
    Effect,
    InModel,
    Rest,
    TorqueLag,
)
from sklearn_vbjfa.equations._ranges import EffectRange
from sklearn_vbjfa.equations._states import RecordingStates, StateEstimator
from sklearn_vbjfa.inspection import finding
from sklearn_vbjfa.model import DoubtWarning, is_prismatic, joint_names
from sklearn_vbjfa.recording import (
    Drive,
    check_clock,
    check_cutoff,
    check_dt,
    listed,
    with_torques_shifted,
)


def in_parallel(function, tasks, n_jobs):
    # Uses threads unless a `joblib.parallel_config` sets another backend: compiled code
    # takes nearly all the time, and nothing is copied. Each has one BLAS thread:
    # matrices are small, and sums must not depend on the number of threads.
    settings = {"prefer": "threads", "return_as": "generator"}
    with one_blas_thread():
        yield from Parallel(n_jobs, **settings)(delayed(function)(*x) for x in tasks)


# Quantile of the speeds that defines a joint's top speed, robust to outliers.
_TOP_QUANTILE = 0.995
# Parallel filtering after Gautier: the cut-off is five times the bandwidth of the
# motion, high enough for friction at reversals, low enough to reject vibration.
CUTOFF_PER_BANDWIDTH = 5.0
# Lower limits of the cut-off [Hz], and in units of the sampling rate: few robots
# vibrate below it, and friction of slow motion with reversals would be lost.
_LOWEST_CUTOFF, _LOWEST_SHARE = 5.0, 0.25
# Fewest periods of the cut-off in the longest recording, as the filter must be short.
SHORTEST_CUTOFF_PERIODS = 36.0
# Share of the states' cut-off up to which their smoother, whose gain falls with the
# sixth power, attenuates by less than 5 %.
_PASSBAND_SHARE = 0.6
# Below this fraction of its top speed a joint counts as standing still: its friction
# may then take any value inside the stiction band.
STANDSTILL_SHARE = 0.02
# A joint also stands still below the first share of the fastest joint's speed, which
# is rounding, or if it never moves by more than so many deviations of encoder noise.
_ROUNDING, _NOISE = 1e-9, 5.0
# Half of the largest change of the position of a joint at rest, over the standard
# deviation of its noise: about 4 for noise in a thousand rows, and as much for the
# overshoot of smoothing, whose cut-off makes both errors alike.
_PLAY = 8.0
# A joint that reverses without stopping is below the standstill speed for as long as
# between one and three times that speed; one that stops, longer by this factor.
_STOP_RATIO = 1.2
# Fits until the load in the effects' columns agrees with the parameters: the load is
# mostly gravity and inertia, which a first fit without those effects estimates well.
_LOAD_PASSES = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Settings that turn a recording into equations."""

    dt: float | None  # [s]
    # estimator of states from positions; None if states are given
    state_estimator: StateEstimator | None
    cutoff: float  # of the low-pass of regressor and torques [Hz]
    # (nv,): speeds at or below which equations are masked; negative masks none
    standstill: np.ndarray
    effects: tuple[Effect, ...] = ()  # effects that add columns to the regressor
    # whether the regressor accepts a measured covariance of the input noise
    corrects_noise: bool = False
    # (nv,): whether a joint stops at reversals, where its friction is unknown
    stops: np.ndarray | None = None
    # (nv,): period of a sine of the motion's top speed and acceleration [s]
    fastest_period: np.ndarray | None = None
    # first and last time of the rows [s], if effects need the clock
    time: tuple[float, float] | None = None
    # whether the columns of effects in the model (`InModel`) are derivatives by their
    # values; zeros otherwise, as the model contains the values
    tangents: bool = False
    # for each effect, range to which its motion is clipped, or None; empty for a fit
    ranges: tuple[EffectRange | None, ...] = ()
    # (nv,): half of the acceleration jump when a joint reverses [rad/s^2 or m/s^2], see
    # `corners`; None if unknown
    corners: np.ndarray | None = None
    # joints with unmasked rows at rest, in addition to those with friction with memory
    resting: tuple[int, ...] = ()

    @cached_property
    def lowpass(self):
        return _lowpass.design(self.dt or 1.0, self.cutoff)

    def clock(self, recording):
        """Return the time of each row [s], from stamps only if effects need them."""
        t = recording.t if self.timed else None
        return check_clock(t, recording.n_samples, recording.dt)

    @property
    def delay(self):
        """Delay [s] of the commands that the torques follow."""
        return sum(e.delay for e in self.effects if isinstance(e, CommandDelay))

    @property
    def lag(self):
        """Lag [s] of all recorded torques; None if it is not declared."""
        return next((e.lag for e in self.effects if isinstance(e, TorqueLag)), None)

    def with_delays(self, recording):
        delayed = replace(recording, tau=recording.torques(self.delay))
        return with_torques_shifted(delayed, self.lag)

    @property
    def timed(self):
        """Whether effects need the clock."""
        return any("time" in effect.needs for effect in self.effects)

    def passes(self):
        # Effects in the model have no columns in a fit; they are corrected afterwards.
        if not needs_load(e for e in self.effects if not isinstance(e, InModel)):
            return [self]
        plain = tuple(e for e in self.effects if "load" not in e.needs)
        return [replace(self, effects=plain)] + (_LOAD_PASSES - 1) * [self]

    @property
    def mask_speeds(self):
        """Speeds (nv,) at or below which equations are masked, none if negative."""
        # Friction with memory defines the torque of a joint at rest.
        return np.where(self._used_at_rest, -1.0, self.standstill)

    @property
    def _used_at_rest(self):
        """Joints (nv,), bool, whose equations at rest are used."""
        out = np.zeros(self.standstill.size, dtype=bool)
        out[[e.joint for e in self.effects if isinstance(e, Bank)]] = True
        out[list(self.resting)] = True
        return out

    @property
    def fit_rest(self):
        """`Rest` of the velocities of a fit, None if their signs need no averaging."""
        # A fit masks joints that may be at rest, except those with memory.
        reversals, zeros = self._reversals(self.state_estimator), 0.0 * self.standstill
        speed = np.where(self._used_at_rest, np.maximum(self.standstill, 0.0), 0.0)
        play = self._play(self.state_estimator) * self._used_at_rest
        if not (reversals or speed.any() or play.any()):
            return None
        facts = {"time": self._rest_times, "noise": zeros, "play": play}
        return Rest(speed=speed, **facts, **reversals)

    def _reversals(self, estimator):
        """Return the arguments of `Rest` that describe reversals, for an estimator."""
        if self.corners is None or estimator is None:
            return {}
        rounding = estimator.rounding()
        return {"corner": self.corners, "rounding": rounding, "span": self.dt}

    def prediction_rest(self, estimator=None):
        """Return the `Rest`, for mean velocity signs, of an estimator's velocities."""
        # estimator: None for known velocities: a joint is at rest where the velocities
        # of the fit do not exceed their noise. Negative speeds mask nothing.
        speed, reversals = np.maximum(self.standstill, 0.0), self._reversals(estimator)
        noise = 0.0 * speed
        if estimator is not None:
            noise = estimator.noise(1)
        elif self.state_estimator is not None:
            least = _NOISE * self.state_estimator.noise(1)
            speed = np.where(least > 0, np.minimum(least, speed), speed)
        play = self._play(self.state_estimator or estimator)
        facts = {"time": self._rest_times, "noise": noise, "play": play}
        return Rest(speed=speed, **facts, **reversals)

    def _play(self, estimator):
        """Return `Rest.play` (2, nv) of the positions of an estimator, or None."""
        if estimator is None:
            return np.zeros((2, self.standstill.size))
        # Errors of coarse positions are larger, but no noise at rest.
        rate = 2 * np.pi * np.minimum(estimator.cutoff_, 0.5 / estimator.dt)
        most = np.maximum(self.standstill, 0.0) / rate
        play = np.minimum(_PLAY * estimator.noise(0, at_rest=True), most)
        return np.array([play, play * (False if self.stops is None else self.stops)])

    @property
    def _rest_times(self):
        """Shortest times (nv,) for which a joint rests [s], see `Rest`."""
        if not np.isfinite(self.cutoff) and self.fastest_period is not None:
            # unknown for rows of a running robot
            return self.fastest_period
        return np.full(self.standstill.size, CUTOFF_PER_BANDWIDTH / self.cutoff)


def make_plan(identifier, effects, lengths, estimator, facts):
    # lengths: rows of each recording; facts: `MotionFacts` of all recordings.
    dt, drive = identifier.dt, identifier.drive
    cutoff = resolve_cutoff(identifier.cutoff, max(lengths), dt, estimator, drive)
    return Plan(
        dt=dt,
        state_estimator=estimator,
        cutoff=cutoff,
        standstill=facts.standstill(identifier.fit_options.standstill, estimator),
        stops=facts.stops,
        effects=effects,
        corrects_noise=corrects_noise(identifier.regressor),
        fastest_period=facts.period,
    )


def corrects_noise(regressor):
    """Whether a regressor accepts a measured covariance of the input noise."""
    return regressor is None or (
        getattr(regressor, "latent", None) == "correlated"
        and regressor.input_noise is None
    )


# -- effects ---------------------------------------------------------------------------


def check_effects(effects, nv, friction=()):
    """Return copies of the effects as a tuple, rejecting invalid ones."""
    # friction: names of the terms that all joints have
    effects, keys = (effects,) if isinstance(effects, (str, Effect)) else effects, []
    for effect in effects:
        if not isinstance(effect, Effect):
            raise ValueError(
                "effects must hold instances of Effect, each with its joint, such as "
                f"effects.Spring(joint=1); got {effect!r}."
            )
        effect.check()
        effect.check_joints(nv)
        shape, (name, joint, *_) = effect.shape(), effect.key()
        keys.append((effect.key(), tuple(sorted(shape.items()))))
        declared = name in friction and not any(shape.values())
        if declared or keys.count(keys[-1]) > 1:
            reason = ", which friction declares on all joints" if declared else " twice"
            raise ValueError(f"effects holds {name} on joint {joint}{reason}.")
    return tuple(map(clone, effects))


def needs_load(effects):
    """Whether effects depend on the parameters, through the load."""
    return any("load" in effect.needs for effect in effects)


def parameter_names(features, effects):
    """Names and units of the parameters of a robot, two tuples of str."""
    joints, kinds = joint_names(features.model_), is_prismatic(features.model_)
    names, units = list(features.parameter_names_), list(features.parameter_units_)
    for effect in effects:
        kind = int(kinds[effect.joint])
        prefix = effect.prefix(joints[effect.joint])
        names += [f"{prefix}:{c}" for c in effect.coefficients]
        units += [unit[kind] for unit in effect.units]
    return tuple(names), tuple(units)


def effect_indices(effects, first):
    """Pair effects with the ranges of their coefficients among the parameters."""
    # first: index of the first one, after those of the features.
    widths = (len(effect.coefficients) for effect in effects)
    ends = itertools.accumulate(widths, initial=first)
    return list(zip(effects, itertools.starmap(range, itertools.pairwise(ends))))


# -- statistics of recordings ----------------------------------------------------------


def n_fastest(n):
    """Return how many of n speeds lie at or above the top-speed quantile."""
    return n - int(np.floor(_TOP_QUANTILE * (n - 1)))


@dataclass(frozen=True, kw_only=True)
class MotionFacts:
    """Statistics of a motion: range of positions, top speeds, stops."""

    n: int
    # (nv,): range of the positions [rad or m]
    lowest: np.ndarray
    highest: np.ndarray
    # (nv,): largest range in one recording
    travel: np.ndarray
    # (k, nv): largest speeds of each joint [rad/s or m/s], in any order
    fastest: np.ndarray
    # (2, nv): number of slow phases between faster motion, and number of stops
    slow: np.ndarray
    # (nv,): `_fastest_period` [s], if all states were available together
    period: np.ndarray | None = None

    @classmethod
    def of(cls, positions, velocities, keep, n_jobs=None):
        """Statistics of the positions and velocities (n, nv) of one recording."""
        # `keep` is `n_fastest` of all recordings together.
        joints = in_parallel(_speeds, ((v, keep) for v in velocities.T), n_jobs)
        fastest, slow = map(np.transpose, zip(*joints))
        lowest, highest = positions.min(axis=0), positions.max(axis=0)
        ranges = {"lowest": lowest, "highest": highest, "travel": highest - lowest}
        return cls(n=positions.shape[0], fastest=fastest, slow=slow, **ranges)

    def merge(self, other, keep):
        return MotionFacts(
            n=self.n + other.n,
            lowest=np.minimum(self.lowest, other.lowest),
            highest=np.maximum(self.highest, other.highest),
            travel=np.maximum(self.travel, other.travel),
            fastest=_largest(np.concatenate([self.fastest, other.fastest]), keep),
            slow=self.slow + other.slow,
        )

    def fast(self):
        """Return the 99.5th percentiles of the speeds (nv,) over all samples."""
        return _top_quantile(self.fastest, self.n)

    @property
    def stops(self):
        """Joints (nv,), bool, that stop in more than half of their reversals."""
        return 2 * self.slow[1] > self.slow[0]

    def standstill(self, setting, estimator):
        """Return the speeds (nv,) of `resolve_standstill`, by an estimator or None."""
        limit = resolve_standstill(setting, self.fast())
        if estimator is None or not isinstance(setting, str):
            return limit
        still = self.travel <= _NOISE * np.sqrt(estimator.noise_variance_)
        return np.where(still & ~still.all(), self.fastest.max(axis=0), limit)


def _fastest_period(facts, accelerations):
    """Return periods (nv,) [s] of sines of the joints' top speed and acceleration."""
    # 2 pi times top speed over top acceleration; zero without acceleration.
    speed = facts.fast()
    acceleration = _top_quantile(_largest(accelerations, n_fastest(facts.n)), facts.n)
    out = np.zeros_like(speed)
    return np.divide(2 * np.pi * speed, acceleration, out=out, where=acceleration > 0)


def estimate_states(recording, estimator, halves, n_jobs):
    """Estimate the states of a recording, and the statistics of its motion."""
    # estimator: None if states are given; halves: also from even and odd samples.
    if estimator is not None:
        keep = n_fastest(recording.n_samples)
        return smooth_recording(recording, estimator, halves, keep, n_jobs)
    states = RecordingStates.of_rows(recording.segments, recording.states)
    X = states.full[0] if len(states.full) == 1 else np.concatenate(states.full)
    q, v, a = np.split(X, 3, axis=1)
    keep = n_fastest(X.shape[0])
    parts = [MotionFacts.of(q[x], v[x], keep, n_jobs) for x in recording.segments]
    facts = reduce(lambda x, y: x.merge(y, keep), parts)
    return states, replace(facts, period=_fastest_period(facts, a))


def smooth_recording(recording, estimator, halves, keep, n_jobs):
    """Smooth the positions of a recording, segment by segment, `n_jobs` at a time."""
    # halves: also from the even and odd samples; keep: `n_fastest` of all samples.
    # Returns `RecordingStates` and `MotionFacts`.
    parts = recording.segments
    tasks = ((recording.q[part], part.start, estimator, halves, keep) for part in parts)
    results = in_parallel(_smooth_segment, tasks, n_jobs)
    full, by_half, facts = [], ([], []), None
    for states, pair, new in counted(results, "states", len(parts)):
        full.append(states)
        for half, half_states in zip(by_half, pair or ()):
            half.append(half_states)
        # Merging at once keeps only the fastest rows of all segments in memory.
        facts = new if facts is None else facts.merge(new, keep)
    return RecordingStates(full=full, halves=by_half if halves else None), facts


def _smooth_segment(x, start, estimator, halves, keep):
    states = estimator.smooth(x, start)
    pair = estimator.smooth_halves(x, start) if halves else None
    positions, speeds = (states.derivative(slice(None), order) for order in range(2))
    return states, pair, MotionFacts.of(positions, speeds, keep)


def _speeds(v, keep):
    """Return the top speeds of a joint (n,), and its counts of `_count_stops`."""
    v = np.ascontiguousarray(v)
    fastest = _largest_of(v, keep)
    limit = STANDSTILL_SHARE * _top_quantile(fastest[:, None], v.size)[0]
    return fastest, _count_stops(v, limit)


def _count_stops(v, limit):
    """Count slow phases of a joint between faster motion, and those with a stop."""
    # v (n,): linear between samples; limit: standstill speed.
    low, high = np.minimum(v[:-1], v[1:]), np.maximum(v[:-1], v[1:])
    near = (low < 3 * limit) & (high > -3 * limit) & (limit > 0)
    near |= (low == high) & (np.abs(low) == 3 * limit)
    edges = np.flatnonzero(np.diff(near))[int(near[:1].any()) :] + 1
    rows = np.flatnonzero(near)
    ends = np.searchsorted(rows, edges[: edges.size // 2 * 2].reshape(-1, 2).T)
    low, high, counts = low[rows], high[rows], []
    for speed in (limit, 3 * limit):
        inside = np.maximum(np.minimum(high, speed) - np.maximum(low, -speed), 0.0)
        share = (np.abs(low) <= speed).astype(float)
        np.divide(inside, high - low, out=share, where=high != low)
        counts.append(np.diff(np.r_[0.0, np.cumsum(share)][ends], axis=0)[0])
    below, slow = counts
    return below.size, np.count_nonzero(2 * below > _STOP_RATIO * (slow - below))


def _largest(values, keep):
    """Largest magnitudes of values (n, k), at most `keep` by column, in any order."""
    return np.transpose([_largest_of(x, keep) for x in values.T])


def _largest_of(values, keep):
    sizes = np.abs(values)
    if sizes.size <= keep:
        return sizes
    # A tenth of the values gives a threshold that about twice as many exceed.
    sample = sizes[::10]
    place = max(sample.size - keep // 5 - 2, 0)
    above = sizes[sizes >= np.partition(sample, place)[place]]
    above = above if above.size >= keep else sizes
    return np.partition(above, above.size - keep)[above.size - keep :]


def _top_quantile(largest, n):
    """Return the 99.5th percentiles (k,) of n magnitudes from the largest of them."""
    position = _TOP_QUANTILE * (n - 1)
    below = int(np.floor(position))
    # ascending; the first has rank `below` among all n
    top = np.sort(largest, axis=0)[-(n - below) :]
    return np.quantile(top[:2], position - below, axis=0)


def cutoff_of(bandwidth, dt):
    """Return the cut-off of the low-pass [Hz] for motion up to a frequency [Hz]."""
    least = min(_LOWEST_CUTOFF, _LOWEST_SHARE / dt)
    return max(CUTOFF_PER_BANDWIDTH * bandwidth, least)


def resolve_cutoff(cutoff, longest, dt, state_estimator, drive):
    """Return the cut-off of the low-pass [Hz], infinity for none."""
    # A drive with position feedback turns the full band of the positions into torque;
    # the smoothed states contain it only in their passband.
    if not isinstance(cutoff, str):
        return np.inf if cutoff is None else check_cutoff(cutoff, check_dt(dt))
    if cutoff != "auto":
        raise ValueError(
            f"cutoff must be 'auto', a frequency in Hz, or None; got {cutoff!r}."
        )
    if state_estimator is None:
        return np.inf
    frequency = cutoff_of(state_estimator.bandwidth_.max(), dt)
    if drive is not None and drive.uses_positions:
        frequency = min(frequency, _PASSBAND_SHARE * state_estimator.cutoff_.min())
    frequency = max(frequency, SHORTEST_CUTOFF_PERIODS / (longest * dt))
    return float(frequency) if frequency < 0.4 / dt else np.inf


def resolve_standstill(standstill, fast):
    """Return the speeds (nv,) at or below which a joint counts as standing still."""
    # fast (nv,): 99.5th percentiles of the speeds of the joints.
    nv = fast.size
    if standstill is None:
        return np.full(nv, -1.0)
    if isinstance(standstill, str):
        if standstill != "auto":
            raise ValueError(
                f"standstill must be 'auto', a speed, or None; got {standstill!r}."
            )
        return np.maximum(STANDSTILL_SHARE * fast, _ROUNDING * fast.max(initial=0.0))
    value = np.asarray(standstill, dtype=float)
    if value.shape not in {(), (nv,)} or not (value >= 0).all():
        raise ValueError(
            f"standstill must be one non-negative speed or {nv} of them; got "
            f"{standstill!r}."
        )
    return np.broadcast_to(value, (nv,)).copy()


# -- requirements on a recording; each error says how to meet them ---------------------

# Sample period [s] too long for any robot; sample period too long if the fastest joint
# is slower than this speed [rad/s or m/s], as with a time that is not in seconds.
_SLOWEST_PERIOD, _SLOW_PERIOD, _SLOW_SPEED = 1.0, 0.05, 0.02
# Largest ratio of a speed to the robot's limit (degrees instead of radians give 57 and
# are reported elsewhere); the limit if there is none, or a larger one [rad/s or m/s].
_TOO_FAST, _LARGEST_SPEED, _NO_LIMIT = 300.0, 100.0, 1e4


def check_widths(names, X, y=None):
    nv = len(names)
    robot = f"The robot has {nv} joint(s) ({', '.join(names)}), so "
    if X.shape[1] not in {nv, 3 * nv}:
        raise ValueError(
            f"{robot}X must have {nv} columns of positions or {3 * nv} of states "
            f"[q | v | a]; got {X.shape[1]}. Leave out channels of locked joints, or "
            "lock joints that were not recorded with pinocchio.buildReducedModel."
        )
    if y is not None and y.shape[1] != nv:
        raise ValueError(
            f"{robot}y must have {nv} column(s) of torques; got {y.shape[1]}."
        )


def check_speed(dt, fast, model):
    """Reject a sample period dt [s] at which the robot could not move as recorded."""
    # A period in ms or Hz changes the speeds by a factor of a thousand. fast (nv,):
    # 99.5th percentiles of the speeds [rad/s or m/s]; model: for velocity limits.
    top = float(np.max(fast, initial=0.0))
    if dt is None or not top > 0:
        return
    limit = np.asarray(model.velocityLimit, dtype=float)
    limit = np.where((limit > 0) & (limit < _NO_LIMIT), limit, _LARGEST_SPEED)
    if dt >= _SLOWEST_PERIOD or (dt >= _SLOW_PERIOD and top < _SLOW_SPEED):
        raise ValueError(
            f"dt={dt:.6g} s is too slow for a motion: the fastest joint would move at "
            f"{top:.2g} rad/s or m/s. dt is in seconds."
        )
    if float(np.max(fast / limit)) > _TOO_FAST:
        raise ValueError(
            f"dt={dt:.6g} s is too short for this motion: the fastest joint would "
            f"move at {top:.2g} rad/s or m/s, far more than the robot allows. Give "
            "times in seconds (not minutes)."
        )


def check_input_noise(input_noise):
    if input_noise not in ("auto", None):
        raise ValueError(
            "input_noise must be 'auto' (measured from the recording) or None "
            f"(taken as zero); got {input_noise!r}."
        )


def check_channels(names, positions, torques):
    """Reject torques without information, warn of joints that do not move."""
    # positions, torques (n, nv): at least their lowest and highest values.
    moves = np.ptp(positions, axis=0) > 0
    if not moves.any():
        raise ValueError(
            "No joint moves in this recording; expected a motion that excites the "
            "joints to be identified. Check the position columns."
        )
    flat = ~(np.ptp(torques, axis=0) > 0)
    dead = [name for name, bad in zip(names, flat & moves) if bad]
    if dead:
        raise ValueError(
            f"The torque of {', '.join(dead)} is constant: nothing was measured, or a "
            "brake held. Check the recording, or leave the joint out (joint_names)."
        )
    for j in np.flatnonzero(~moves):
        # Same message as in `inspect_channels`, so that it is shown once.
        facts = {"range": 0.0, "mean": positions[0, j]}
        still = finding("still_joint", names, j, "warning", **facts)
        warnings.warn(still.message, DoubtWarning, stacklevel=5)


def check_length(parts, lowpass, cutoff, names):
    """Reject recordings all shorter than the filter; warn of some if named."""
    need = 2 * lowpass.half + 1
    short = [p for p in parts if p.stop - p.start < need]
    if len(short) == len(parts):
        longest = max(p.stop - p.start for p in parts)
        raise ValueError(
            f"The low-pass at {cutoff:.4g} Hz is {need} samples long and the longest "
            f"stretch to be fitted has {longest}; give a longer recording or a higher "
            "cutoff (None for no low-pass)."
        )
    left_out = [name for name, p in zip(names, parts) if p in short]
    if left_out:
        warnings.warn(
            f"{len(short)} of {len(parts)} recordings ({listed(left_out)}) are "
            f"shorter than the low-pass filter ({need} samples) and are left out.",
            DoubtWarning,
            stacklevel=5,
        )


def check_count(moments, standstill, n_parameters):
    """Reject a fit with all samples masked or fewer equations than parameters."""
    if moments is None or not moments.n.any():
        raise ValueError(
            "Every sample is masked as standstill; lower `standstill` (now "
            f"{np.array2string(standstill, precision=3)}) or pass None."
        )
    count = int(moments.n_rows.sum())
    if count < n_parameters:
        raise ValueError(
            f"{count} equations (joints times filtered, moving samples) are fewer "
            f"than the {n_parameters} parameters; record for longer, or raise "
            "`cutoff`."
        )


def check_weight(sample_weight, shape):
    """Return validated weights for torques of this shape (n, nv); ones for None."""
    if sample_weight is None:
        # Allocated weights would take as much memory as the torques.
        return np.broadcast_to(1.0, shape)
    weight = np.asarray(sample_weight, dtype=float)
    if weight.shape not in {shape, shape[:1]}:
        raise ValueError(
            f"sample_weight must have the shape {shape[:1]} or {shape}; got "
            f"{weight.shape}."
        )
    if not np.isfinite(weight).all() or weight.min() < 0:
        raise ValueError("sample_weight must be finite and not negative.")
    if not weight.any():
        raise ValueError("Sample weights must contain at least one non-zero number.")
    return weight if weight.ndim == 2 else np.repeat(weight[:, None], shape[1], 1)


def check_drive(identifier):
    drive = identifier.drive
    if drive is None:
        return
    if not isinstance(drive, Drive):
        raise ValueError(
            "drive must be a PDDrive, CurrentDrive, VoltageDrive or None; got "
            f"{drive!r}. Torques need no drive."
        )
    if identifier.gains is not None and drive.gains is None:
        raise ValueError(
            "drive has gains, and cannot be combined with gains: leave gains=None."
        )
