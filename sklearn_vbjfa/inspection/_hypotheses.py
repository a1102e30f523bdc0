"""What may have been done to all channels of a log, scored by one likelihood.

Each hypothesis changes what is compared with the described robot: the unit of the
positions, the scale of the torques, the pull of gravity, or a lag. The best one is
reported if its log odds against the log as it is exceed a threshold.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.inspection._likelihood import DescribedRobot, without_mass
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.recording import ChannelFinding, listed_joints
from sklearn_vbjfa.robot._features import RigidBodyFeatures

# Prior log odds of any hypothesis against the log as it is, posterior log odds from
# which it is reported, and log odds within which two are rivals.
PRIOR = -np.log(100.0)
DECISIVE = 5.0
RIVAL = 3.0
# Standard errors of a 90 % interval.
INTERVAL = 1.645
# Torques of all joints together are not this many times the described ones by chance.
_SCALE = 2.5
# Factors of single joints differ from this ratio on.
_DIFFERENT = 2.5
# A factor of gravity below this is none.
_NO_WEIGHT = 0.3
# A base is turned by more than this [rad], and pulls as gravity does to this factor.
_TURNED, _AS_HEAVY = np.radians(20.0), 1.5
# Zeros that are tried, deviation of the prior of a step from there, and the half step
# of derivatives [rad].
_ANGLES = np.radians([-120.0, -80.0, -40.0, 40.0, 80.0, 120.0, 180.0])
_STEP, _SLOPE = 0.5, 1e-4
# Other zeros must lower the squared errors of all joints by this [log].
_CLEAR = np.log(2.0)
# Time constants of a low-pass that are tried, over the lag.
_CONSTANTS = (0.7, 1.0, 1.4)
# A common lag must not raise the squared error of any joint by more than this [log].
_HARM = 0.1
_PASSES = 6
# Torque in N m is this many times a number in the unit.
_UNITS = {
    "kgf m": 9.80665,
    "lbf ft": 1.35582,
    "lbf in": 0.112985,
    "kgf cm": 0.0980665,
    "N cm": 0.01,
    "ozf in": 0.00706155,
    "N mm or mN m": 0.001,
    "gf cm": 9.80665e-5,
}


def _as_it_is(x):
    return x


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """A reading of the log, its log odds, and what it makes of model and signals."""

    finding: ChannelFinding
    log_odds: float
    # what model and signals are if it is right
    model: Callable = _as_it_is
    signals: Callable = _as_it_is


def explained(model, names, signals, rivals=None):
    """Return findings about the whole log, and model and signals as they should be."""
    # rivals: yields signals in which something else is corrected.
    robot = DescribedRobot(model, signals)
    if not (robot.joints.size and robot.size) or without_mass(model):
        return [], model, signals
    now = robot.fit().evidence
    made = [
        one(robot, now, names)
        for one in (_scaled, _scaled_each, _weightless, _static, _turned)
    ]
    found = [x for x in made if x is not None and x.log_odds > DECISIVE]
    if not found:
        return [], model, signals
    best = max(found, key=lambda x: x.log_odds)
    for other in rivals(signals) if rivals is not None else ():
        evidence = DescribedRobot(model, other, robot.times).fit().evidence
        if evidence - now + PRIOR > best.log_odds + RIVAL:
            return [], model, signals
    return [best.finding], best.model(model), best.signals(signals)


def log_odds_of(model, signals, other):
    """Log odds of one reading of the signals against another one, of any scale."""
    # None at all if it does not lower the squared errors by half.
    if without_mass(model):
        return 0.0
    right, now = DescribedRobot(model, signals), DescribedRobot(model, other)
    right.times = now.times = np.minimum(right.times, now.times)
    one, two = _any_scale(right), _any_scale(now)
    if np.log(one.noise.mean() / two.noise.mean()) > -_CLEAR:
        return min(one.evidence - two.evidence, 0.0)
    return one.evidence - two.evidence + PRIOR


def _any_scale(robot):
    """`Fit` to torques that may be in any unit."""
    now, factor = robot.fit(), _factor(robot)[0]
    scaled = robot.fit(scale=factor) if factor > 0 else now
    return max(now, scaled, key=lambda fit: fit.evidence)


def _factor(robot):
    """Factor of all torques against the described ones, and its relative error."""
    factor, nothing = 1.0, np.zeros_like(robot.signals.now)
    columns = (robot.described @ robot.bodies)[:, :, None]
    for _ in range(_PASSES):
        fit = robot.fit(scale=abs(factor), mean=nothing, columns=columns)
        factor = float(fit.factors[0])
        if factor <= 0:
            return 0.0, np.inf
    return factor, float(np.sqrt(fit.covariance[0, 0])) / factor


def zeros(model, signals):
    """Return zeros (nv,) [rad] of all joints that fit best, and their log odds."""
    # Of joints whose zero does not matter, such as vertical ones, it stays.
    free = np.flatnonzero(~is_prismatic(model))
    if not free.size:
        return np.zeros(model.nv), 0.0
    place, robot = np.zeros(model.nv), DescribedRobot(model, signals)
    times, begun = robot.times, robot.fit()
    best = begun
    for j in [*free, *free]:
        for angle in _ANGLES:
            tried = place.copy()
            tried[j] += angle
            other = DescribedRobot(model, signals.shifted(tried), times)
            fit = other.fit()
            if fit.evidence > best.evidence + RIVAL:
                best, place, robot = fit, tried, other
    for _ in range(_PASSES):
        step = robot.fit(columns=_slopes(robot, free), deviation=_STEP).factors
        tried = place.copy()
        tried[free] += step
        other = DescribedRobot(model, signals.shifted(tried), times)
        fit = other.fit()
        if fit.evidence < best.evidence + 0.1:
            break
        best, place, robot = fit, tried, other
    if np.log(best.noise / begun.noise).mean() > -_CLEAR:
        return np.zeros(model.nv), 0.0
    turned = (place + np.pi) % (2 * np.pi) - np.pi
    return np.where(is_prismatic(model), 0.0, turned), float(
        best.evidence - begun.evidence + PRIOR
    )


def _slopes(robot, joints):
    """Return derivatives (n, nv, m) of the described torques by the zeros of joints."""
    features = RigidBodyFeatures(robot.model, friction=()).load()
    bodies = robot.bodies.reshape(-1, 10)
    ends = []
    for sign in (1.0, -1.0):
        for j in joints:
            offset = np.zeros(robot.model.nv)
            offset[j] = sign * _SLOPE
            states = robot.signals.shifted(offset).states
            ends.append(features.torques(*np.split(states, 3, axis=1), bodies))
    high, low = np.split(np.stack(ends, axis=-1), 2, axis=-1)
    return (high - low) / (2 * _SLOPE)


def _every(names):
    return tuple(range(len(names)))


def _scaled(robot, now, names):
    """All torques times a factor."""
    factor, error = _factor(robot)
    if factor == 0.0 or 1 / _SCALE < factor < _SCALE:
        return None
    log_odds = robot.fit(scale=factor).evidence - now + PRIOR
    low, high = (factor * np.exp(x * INTERVAL * error) for x in (-1.0, 1.0))
    inside = [name for name, x in _UNITS.items() if low < 1 / x < high]
    unit = f" ({' or '.join(inside)} would be inside)" if inside else ""
    what = (
        "motor currents, or in another unit than N m"
        if factor < 1
        else "in another unit than N m"
    )
    unknown = ', or --gain unknown (Python: gains="unknown")' if len(names) > 1 else ""
    message = (
        f"All torques together are {factor:.3g} ({low:.2g} to {high:.2g}) times what "
        f"the described masses require: they are {what}{unit}, or the described masses "
        f"are wrong. Give the factor to N m (--gain {1 / factor:.3g}){unknown}; if "
        'they are N m, use --bodies free (Python: bodies="free").'
    )
    return Hypothesis(
        finding=ChannelFinding("torque_unit", _every(names), "doubt", message),
        log_odds=log_odds,
        signals=lambda signals: replace(signals, tau=signals.tau / factor),
    )


def _scaled_each(robot, now, names):
    """Torques of which each joint has a factor of its own."""
    nv, torque = robot.model.nv, robot.described @ robot.bodies
    columns = np.zeros((*torque.shape, nv))
    columns[:, np.arange(nv), np.arange(nv)] = torque
    factors = np.ones(nv)
    for _ in range(_PASSES):
        tau = robot.signals.now / factors
        fit = robot.fit(tau=tau, mean=np.zeros_like(tau), columns=columns)
        error = INTERVAL * np.sqrt(np.diag(fit.covariance))
        # Of joints that the masses hardly load, nothing is said.
        known = (fit.factors > 2 * error) & (error < 1.0)
        factors = factors * np.where(known, fit.factors, 1.0)
    if known.sum() < 2:
        return None
    factors = np.where(known, factors, np.exp(np.log(factors[known]).mean()))
    # Of many, a single one that is off is another finding.
    ordered = np.sort(factors[known])
    ordered = ordered[1:-1] if ordered.size > 3 else ordered
    if ordered[-1] < _DIFFERENT * ordered[0]:
        return None
    rows = np.array([r.size for r in robot.rows]) / robot.times
    own = robot.joints
    scaled = robot.fit(tau=robot.signals.now / factors)
    log_odds = scaled.evidence - rows[own] @ np.log(factors[own]) - now + PRIOR
    each = ", ".join(f"{names[j]} {factors[j]:.2g}" for j in np.flatnonzero(known))
    message = (
        "The torques have different factors against what the described masses require "
        f"({each}): motor currents, or shares of each joint's rated torque. Give the "
        'factors to N m (--gain), or --gain unknown (Python: gains="unknown").'
    )
    return Hypothesis(
        finding=ChannelFinding("torque_factors", _every(names), "doubt", message),
        log_odds=log_odds,
        signals=lambda signals: replace(
            signals, tau=signals.tau / factors[None, :, None]
        ),
    )


def _weightless(robot, now, names):
    """Torques without the weight of the links."""
    down, moving, weight = robot.pull, robot.moving, robot.weight
    columns, share, scale = np.stack([moving, weight], axis=-1), 1.0, 1.0
    for _ in range(_PASSES):
        fit = robot.fit(
            robot.pulled(share * down),
            scale=scale,
            mean=np.zeros_like(moving),
            columns=columns,
        )
        error = INTERVAL * np.sqrt(np.diag(fit.covariance))
        # Slow motion does not show the scale: it is that of N m then.
        shown = fit.factors[0] > 2 * error[0]
        scale = float(fit.factors[0]) if shown else 1.0
        share = float(fit.factors[1]) / scale
    least = _NO_WEIGHT if shown else 0.1 * _NO_WEIGHT
    if abs(share) + error[1] / scale > least:
        return None
    # Without any weight, or with that of the description taken off.
    added = robot.signals.now + scale * weight
    without = max(
        robot.fit(robot.pulled(0 * down), scale=scale).evidence,
        robot.fit(tau=added, scale=scale).evidence,
    )
    log_odds = without - max(now, robot.fit(scale=scale).evidence) + PRIOR
    loaded, heavy = _loaded(robot, weight)
    # What balances a single joint is likelier a spring.
    alone = len(loaded) < 2
    severity, other = ("doubt", " Or a spring balances it.") if alone else ("error", "")
    message = (
        f"The torques contain no weight of the links: the factor of gravity is "
        f"{share:.2f} ± {error[1] / scale:.2f} (described weight: up to "
        f"{heavy:.3g} N m on {listed_joints(names, loaded)}). "
        "Controllers that compensate gravity report such torques: log the full torque, "
        f"or add the weight.{other}"
    )
    return Hypothesis(
        finding=ChannelFinding("no_gravity", tuple(loaded), severity, message),
        log_odds=log_odds,
        model=lambda model: _with_gravity(model, np.zeros(3)),
    )


def _loaded(robot, weight):
    """Joints that weights (n, nv) load, and the largest weight."""
    heavy = np.abs(weight).max(axis=0)
    return [int(j) for j in robot.joints if heavy[j] > 0.1 * heavy.max()], heavy.max()


def _static(robot, now, names):
    """Torques that hold nothing but the weight of the links."""
    moving, weight = robot.moving, robot.weight
    columns = np.stack([moving, weight], axis=-1)
    fit = robot.fit(mean=np.zeros_like(moving), columns=columns)
    error = INTERVAL * np.sqrt(np.diag(fit.covariance))
    if not (abs(fit.factors[0]) + error[0] < _NO_WEIGHT and fit.factors[1] > error[1]):
        return None
    still = robot.fit(robot.described - robot.motion).evidence
    message = (
        "The torques contain the weight of the links alone: the factor of their "
        f"inertia is {fit.factors[0]:.2f} ± {error[0]:.2f}. A model of gravity was "
        "logged, not a measurement: log the torques or currents of the motors."
    )
    return Hypothesis(
        finding=ChannelFinding("gravity_only", _every(names), "error", message),
        log_odds=still - now + PRIOR,
    )


def _with_gravity(model, gravity):
    """Return a copy of a model under another gravity (3,) [m/s^2]."""
    model = model.copy()
    model.gravity.linear = gravity
    return model


def _turned(robot, now, names):
    """Another orientation of the base than described."""
    columns = np.stack([one @ robot.bodies for one in robot.gravity], axis=-1)
    moving = robot.moving
    pull = start = robot.pull
    for _ in range(_PASSES):
        fit = robot.fit(robot.pulled(pull), mean=moving, columns=columns)
        pull = fit.factors
    size = float(np.linalg.norm(pull))
    if not 1 / _AS_HEAVY < size * 9.81 / robot.size < _AS_HEAVY:
        return None
    # A spring that more than balances a single joint looks the same.
    if len(_loaded(robot, columns @ pull)[0]) < 2:
        return None
    # What the motion does not show of the direction stays as described.
    if np.sqrt(np.diag(fit.covariance)).max() > 0.5:
        return None
    angle = float(
        np.arccos(np.clip(pull @ start / size / np.linalg.norm(start), -1, 1))
    )
    if angle < _TURNED:
        return None
    pull *= np.linalg.norm(start) / size
    log_odds = robot.fit(robot.pulled(pull)).evidence - now + PRIOR
    shown = ", ".join(f"{x:.2f}" for x in pull / np.linalg.norm(pull))
    message = (
        f"By the torques, gravity pulls along ({shown}) of the base frame, "
        f"{np.degrees(angle):.0f} degrees from the description: the base is mounted in "
        "another orientation, as on a wall or a ceiling. Turn it in the description."
    )
    return Hypothesis(
        finding=ChannelFinding("base_orientation", _every(names), "error", message),
        log_odds=log_odds,
        model=lambda model: _with_gravity(model, 9.81 * pull),
    )


def lag(model, signals):
    """Return the lag [samples] common to all torques, its deviation and the gain."""
    # Positive if torques are late. The gain is that of the evidence; the deviation is
    # infinite where the lag exceeds the shifts.
    robot = DescribedRobot(model, signals)
    shifts, middle = signals.shifts, signals.shifts.size // 2
    fits = [robot.fit(tau=x) for x in robot.signals.tau.transpose(2, 0, 1)]
    evidence = np.array([one.evidence for one in fits])
    best = int(np.argmax(evidence))
    gain = float(evidence[best] - evidence[middle])
    step = float(shifts[1] - shifts[0])
    if best in (0, shifts.size - 1) and fits[best].noise.size > 1:
        return float(shifts[best]), np.inf, gain
    change = np.log(fits[best].noise / fits[middle].noise)
    shared = change.size > 1 and (change < 0).mean() > 0.5 and change.max() < _HARM
    if best != middle and not shared:
        return 0.0, 1.0, 0.0
    if not 0 < best < shifts.size - 1:
        return 0.0, 1.0, 0.0
    vertex, spread = _peak(evidence[best - 1 : best + 2])
    return step * (best - middle + vertex), step * spread, gain


def lowpass_gain(model, signals, samples):
    """Gain of the evidence by a low-pass of all torques, of some time constants."""
    # What a filter of first order let through is made undone by its derivative.
    robot = DescribedRobot(model, signals)
    tau, middle = robot.signals.tau, signals.shifts.size // 2
    step = float(signals.shifts[1] - signals.shifts[0])
    slope = (tau[:, :, middle + 1] - tau[:, :, middle - 1]) / (2 * step)
    now = robot.fit().evidence
    made = [tau[:, :, middle] + part * samples * slope for part in _CONSTANTS]
    return float(max(robot.fit(tau=y).evidence for y in made) - now)


def _peak(values):
    """Place of the maximum of a parabola through three values, and its deviation."""
    low, middle, high = values
    bend = low - 2 * middle + high
    if bend >= 0:
        return 0.0, 1.0
    return float(0.5 * (low - high) / bend), float(1 / np.sqrt(-bend))
