"""Discovered effects, with values and intervals of the final fit."""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy import special
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._posterior import Evidence
from sklearn_vbjfa.effects import Bank, InModel, OfChannel, OfRobot, Shaped, closure

# Warnings on effects whose values are too uncertain for them to be reported.
_UNKNOWN = "its size is not significantly different from zero"
# Rounding error of a parameter (relative, or of zero), largest logarithm of a width.
_ROUNDING, _MAX_LOG = 1e-10, 99.0
# Range of position noise over its deviation, in which presliding is not resolved.
_RESOLVED = 6.0
_UNSURE = "its value is not known well enough to correct anything"
_DIFFERING = "the recordings contradict each other on this joint"
_RISING = "the held-out error rose"

# Share of effects with a warning that are true, in simulated recordings: their noise
# never follows the likelihood exactly.
_POSSIBLE = 0.15


@dataclass(frozen=True, kw_only=True)
class DiscoveredEffect:
    """An effect missing from the declared model."""

    name: str  # of its class, in the library or custom
    joint: int  # from zero
    joint_name: str
    parameters: dict  # coefficients (nan if not excited), shape parameters
    units: dict
    # 90 %: Student's t, from the variance between blocks of time; none for shape
    # parameters that were not tuned, parameters that are not excited, and instants
    intervals: dict
    # the same of coefficients, if the shape were known
    intervals_given_shape: dict = field(default_factory=dict)
    evidence: Evidence  # posterior odds, and cross-validated gain
    rivals: tuple = ()  # effects that this data cannot distinguish from it, by name
    trials: tuple = ()  # the same, each a dict with name, joint and shape
    effect: object = None  # the transformer
    scope: str = "joint"  # or "robot"; its joint is the first one then
    warning: str = ""  # why it is only possible; empty for one that is reported

    @property
    def log_odds(self):
        """Logarithm of the posterior odds that the declared model lacked it [nats]."""
        return self.evidence.log_odds

    @property
    def probability(self):
        """Probability that the declared model lacked it."""
        # Posterior, or the probability that it lowers the error of held-out folds, if
        # that is smaller; see `Evidence`.
        return min(self.evidence.probability, _POSSIBLE if self.warning else 1.0)

    @property
    def is_determined(self):
        """Whether a size, if it is known for a given shape, is known without it."""
        # Correlated size and shape parameters do not put the torque itself in question.
        both = self.intervals, self.intervals_given_shape
        pairs = ([ends[k] for k in _sizes(self.units) & ends.keys()] for ends in both)
        known, given_shape = (any(low * high > 0 for low, high in x) for x in pairs)
        searched = self.effect is None or self.effect.shape()
        return known or not given_shape or not searched


def _sizes(units):
    """Return the names of forces, stiffnesses, masses and inertias, a set."""
    return {name for name, unit in units.items() if "N" in unit or "kg" in unit}


def discovered_effects(result, final, names, prismatic, contradicting, rising, hidden):
    """Yield each `DiscoveredEffect`, with the values of the final fit."""
    # contradicting: joints on which recordings contradict each other; rising (nv,):
    # increase of the held-out error, at most zero if tolerated; hidden: effects that
    # are not identifiable.
    hidden = {(x.name, x.joint) for x in hidden if x.reason == "excitation"}
    found = zip(result.findings, final.effects, final.effect_estimates)
    for finding, effect, estimate in found:
        values, deviations = named_values(effect, estimate)
        unknown = [key for key, std in deviations.items() if math.isnan(std)]
        values |= {k: math.nan for k in unknown if abs(values[k]) < _ROUNDING}
        deviations = {key: std for key, std in deviations.items() if std > 0}
        given_shape = named_values(effect, estimate.given_shape())
        units = effect.parameter_units(prismatic[effect.joint])
        warning = finding.warning
        if not warning and isinstance(effect, InModel):
            nominal = dict(zip(effect.coefficients, effect.nominal))
            least = {k: result.settings.known * x for k, x in deviations.items()}
            departs = (abs(values[k] - nominal.get(k, 0.0)) > least[k] for k in least)
            warning = "" if any(departs) else _UNSURE
        elif not warning:
            # The magnitude of a channel effect is a shape parameter.
            own_shape = isinstance(effect, OfChannel)
            size, std = (values, deviations) if own_shape else given_shape
            known = {key for key in std if std[key] > 0}
            # Other shapes, and the phase of a size, do not show that the effect exists.
            tested = known & _sizes(units) or known - effect.shape().keys() or known
            # The largest of several exceeds its own interval more often by chance.
            level = special.stdtrit(estimate.freedom, 1 - 0.05 / max(len(tested), 1))
            significant = any(abs(size[key]) > level * std[key] for key in tested)
            exists = any(estimate.coef) and (significant or not tested)
            warning = "" if exists else _UNKNOWN
        acted = effect.acts_on(len(names))
        warning = warning or _DIFFERING * (not contradicting.isdisjoint(acted))
        warning = warning or _RISING * bool(rising[acted].sum() > 0)
        rivals = (*finding.rivals, *_containing(effect, finding, result, hidden))
        yield DiscoveredEffect(
            name=effect.name,
            joint=effect.joint,
            joint_name=names[effect.joint],
            scope="robot" if isinstance(effect, OfRobot) else "joint",
            parameters=values,
            units={key: units.get(key, "") for key in values},
            intervals=_intervals(effect, estimate, values, deviations),
            intervals_given_shape=_intervals(effect, estimate, *given_shape),
            evidence=finding.evidence,
            rivals=tuple(dict.fromkeys(_rival_name(r, effect, names) for r in rivals)),
            trials=tuple(
                {"name": r.name, "joint": r.joint, "shape": r.shape()} for r in rivals
            ),
            effect=effect,
            warning=warning,
        )


def _intervals(effect, estimate, values, deviations):
    """Return the intervals of parameters, from their standard deviations."""
    half, intervals = float(special.stdtrit(estimate.freedom, 0.95)), {}
    resolved = _RESOLVED * estimate.position_noise
    for key, std in deviations.items():
        value, width = values[key], half * std
        if width > 0:
            intervals[key] = value - width, value + width
            if value > 0 and key in getattr(effect, "positive", ()):
                # On the logarithm, so that the interval is positive.
                factor = math.exp(min(width / value, _MAX_LOG))
                intervals[key] = value / factor, value * factor
            if key == "half" and value < resolved:
                most = min(value + width, max(*effect.displacements, *effect.falling))
                intervals[key] = 0.0, max(most, resolved)
    return intervals


def _containing(effect, finding, result, hidden):
    """Yield effects that contain an effect, and that the motion does not excite."""
    # They explain as much, and only their further parameter makes them less probable.
    known = {rival.name for rival in finding.rivals}
    for other in result.library:
        unexcited = (other.name, effect.joint) in hidden and other.name not in known
        if unexcited and effect.name in closure(other, result.library):
            yield clone(other).set_params(joint=effect.joint)


def _rival_name(rival, effect, names):
    """Name a rival of an effect, with its joint if that differs."""
    name = rival.name
    for kind in rival.split_by[:1] if isinstance(rival, Shaped) else ():
        name += f": {getattr(rival, kind)}"
    here = rival.joint == effect.joint or isinstance(rival, OfRobot)
    return name if here else f"{name} on {names[rival.joint]}"


def named_values(effect, estimate):
    """Return parameters and their standard deviations (delta method), by name."""
    covariance, k = estimate.covariance.copy(), len(estimate.coef)
    covariance[:k, :k] += estimate.of_prior
    x = np.array(estimate.coef, dtype=float)
    scale = np.sqrt(np.maximum(np.diagonal(covariance)[:k], 0.0))
    # Also small relative to the value, which may be below its standard deviation.
    steps = 1e-4 * np.minimum(scale, np.abs(x))
    steps[~(steps > 0)] = 1e-9
    ends = [(x + 0.5 * step, x - 0.5 * step) for step in np.diag(steps)]
    pairs = [tuple(map(effect.parameters, pair)) for pair in ends]
    values, slopes = effect.parameters(x), {}
    for name in values:
        differences = np.array([above[name] - below[name] for above, below in pairs])
        differences[abs(differences) < _ROUNDING * abs(values[name])] = 0.0
        slopes[name] = np.r_[differences / steps, np.zeros(len(covariance) - k)]
    for name, slope in zip(estimate.shape, np.eye(len(covariance))[k:]):
        if name not in values:
            values[name], slopes[name] = float(getattr(effect, name)), slope
    deviations = {}
    for name, slope in slopes.items():
        # nan only if a coefficient that it depends on has an unknown variance.
        used = slope != 0
        variance = slope[used] @ covariance[np.ix_(used, used)] @ slope[used]
        deviations[name] = float(np.sqrt(np.maximum(variance, 0.0)))
    # Add the variance between the averaged forms, about the reported value.
    for weight, parameters in estimate.forms:
        for key, value in parameters.items():
            deviation = np.sqrt(weight) * (value - values[key])
            deviations[key] = float(np.hypot(deviations[key], deviation))
    if isinstance(effect, Bank) and "half" in values:
        between = effect.spacing * values["half"]
        deviations["half"] = float(np.hypot(deviations["half"], between))
    return values | {k: values.get(k, x) for k, x in effect.shape().items()}, deviations
