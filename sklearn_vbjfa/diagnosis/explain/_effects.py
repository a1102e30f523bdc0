"""Effects that were found, with values and intervals of the final fit."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain._final import quantile
from sklearn_vbjfa.diagnosis.search._posterior import Evidence
from sklearn_vbjfa.effects import EffectRange, Shaped

# Why the values of an effect do not let it be reported.
_UNKNOWN = "no parameter of it is known from zero"
_UNSURE = "its value is not known well enough to correct anything"


@dataclass(frozen=True, kw_only=True)
class DiscoveredEffect:
    """An effect that the declared model lacked."""

    name: str  # of its class, in the library or a custom one
    joint: int  # from zero
    joint_name: str
    parameters: dict  # coefficients and shape parameters
    units: dict
    # 90 %: Student's t, from the scatter of the residuals between blocks of time; none
    # for a shape parameter that was not tuned, for what the recording does not excite,
    # and for an instant
    intervals: dict
    evidence: Evidence  # posterior odds, and the gain on stretches that were not fitted
    # effects that this data cannot distinguish from it
    rivals: tuple = ()
    trials: tuple = ()  # the same, each a dict with name, joint and shape
    effect: object = None  # the transformer
    scope: str = "joint"  # or "robot"; its joint is the first one then
    # positions, speeds and loads of its joint that it was fitted on
    ranges: EffectRange | None = None
    warning: str = ""  # why it is only possible; empty for one that is reported

    @property
    def log_odds(self):
        """Logarithm of the posterior odds that the declared model lacked it [nats]."""
        return self.evidence.log_odds

    @property
    def probability(self):
        """Probability that the declared model lacked it."""
        # The posterior one, or the probability that it lowers the error on stretches of
        # time that were not fitted, if that is less.
        return self.evidence.probability


def discovered_effects(search, final, names, prismatic):
    """Yield each `DiscoveredEffect`, with the values of the final fit."""
    # Effects of the declared model come first.
    count = len(final.effects)
    ranges = final.identifier.effect_ranges_[-count:] if count else ()
    for finding, effect, estimate, fitted in zip(
        search.findings, final.effects, final.effect_estimates, ranges
    ):
        values, deviations = named_values(effect, estimate)
        half = quantile(estimate.freedom)
        deviations = {key: std for key, std in deviations.items() if std > 0}
        intervals = {
            key: (values[key] - half * std, values[key] + half * std)
            for key, std in deviations.items()
        }
        units = effect.parameter_units(prismatic[effect.joint])
        rivals = (named_beside(r, finding.effect, names) for r in finding.rivals)
        warning = finding.warning
        if not warning and effect.in_model:
            warning = _insignificant(effect, values, deviations, search.settings.known)
        elif not warning:
            warning = _unknown(effect, estimate.coef, intervals)
        yield DiscoveredEffect(
            name=effect.name,
            joint=effect.joint,
            joint_name=names[effect.joint],
            scope=effect.scope,
            parameters=values,
            units={key: units.get(key, "") for key in values},
            intervals=intervals,
            evidence=finding.evidence,
            rivals=tuple(dict.fromkeys(rivals)),
            trials=tuple(
                {"name": r.name, "joint": r.joint, "shape": r.shape()}
                for r in finding.rivals
            ),
            effect=effect,
            ranges=fitted,
            warning=warning,
        )


def named_beside(effect, chosen, names):
    """Name a rival of an effect, with its joint if that differs."""
    name, apart = effect.name, effect.split_by if isinstance(effect, Shaped) else ()
    if apart:
        name += f": {getattr(effect, apart[0])}"
    if effect.joint == chosen.joint or effect.scope == "robot":
        return name
    return f"{name} on {names[effect.joint]}"


def _insignificant(effect, values, deviations, known):
    """Return a warning if no value of an effect in the model is known from nominal."""
    nominal = dict(zip(effect.model_parameters, effect.nominal))
    away = (
        abs(values[k] - nominal.get(k, 0.0)) > known * deviations[k] for k in deviations
    )
    return "" if any(away) else _UNSURE


def _unknown(effect, coef, intervals):
    """Return a warning if no coefficient of an effect is known from zero."""
    # A shape alone is no sign that the effect is there.
    own = [key for key in intervals if key not in effect.shape()] or list(intervals)
    away = any(intervals[key][0] > 0.0 or intervals[key][1] < 0.0 for key in own)
    return "" if any(coef) and (away or not own) else _UNKNOWN


def named_values(effect, estimate):
    """Parameters by name, and their standard deviations (delta method)."""
    covariance, k = estimate.covariance, len(estimate.coef)
    known = np.array(estimate.coef, dtype=float), covariance[:k, :k]
    values, deviations = _propagated(effect.parameters, *known)
    for name, slope in zip(estimate.shape, np.eye(len(covariance))[k:]):
        if name not in values:
            values[name] = float(getattr(effect, name))
            deviations[name] = _deviation(slope, covariance)
    # About the value, of all forms together.
    for weight, other in estimate.forms:
        for key, value in other.items():
            away = np.sqrt(weight) * (value - values[key])
            deviations[key] = float(np.hypot(deviations[key], away))
    shape = {k: x for k, x in effect.shape().items() if k not in values}
    return values | shape, deviations


def _propagated(function, x, covariance):
    """Values of a function of x (k,), by name, and their standard deviations."""
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    # Small compared with the value, where the deviation is not.
    steps = 1e-4 * np.minimum(scale, np.abs(x))
    steps[~(steps > 0)] = 1e-9
    values = function(x)
    sides = [(function(x + 0.5 * s), function(x - 0.5 * s)) for s in np.diag(steps)]
    deviations = {}
    for name in values:
        rises = np.array([above[name] - below[name] for above, below in sides])
        deviations[name] = _deviation(rises / steps, covariance)
    return values, deviations


def _deviation(slope, covariance):
    """Deviation of a value with some derivatives; nan if one of these is unknown."""
    seen = slope != 0
    own = covariance[np.ix_(seen, seen)]
    return float(np.sqrt(np.maximum(slope[seen] @ own @ slope[seen], 0.0)))
