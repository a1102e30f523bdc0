"""Settings that turn a recording into equations: filter, standstill, effects."""

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.effects import Bank, CommandDelay, Effect, InModel, Rest, TorqueLag
from sklearn_vbjfa.equations._motion_facts import NOISE_DEVIATIONS
from sklearn_vbjfa.equations._ranges import EffectRange
from sklearn_vbjfa.equations._states import StateEstimator
from sklearn_vbjfa.model import is_prismatic, joint_names
from sklearn_vbjfa.recording import (
    check_clock,
    check_cutoff,
    check_dt,
    with_torques_shifted,
)

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
# Half of the largest change of the position of a joint at rest, over the standard
# deviation of its noise: about 4 for noise in a thousand rows, and as much for the
# overshoot of smoothing, whose cut-off makes both errors alike.
_PLAY = 8.0
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
        out[[*joints_at_rest(self.effects), *self.resting]] = True
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
            least = NOISE_DEVIATIONS * self.state_estimator.noise(1)
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


def joints_at_rest(effects):
    """Return the joints whose samples at rest are fitted, a set of int."""
    return {e.joint for e in effects if isinstance(e, Bank) and e.at_rest}


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
