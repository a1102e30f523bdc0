"""Effects that were found, with values and intervals of the final fit."""

from dataclasses import dataclass

import numpy as np
from scipy import special

from sklearn_vbjfa.diagnosis.search._posterior import Evidence
from sklearn_vbjfa.effects import InModel, OfChannel, OfRobot, Shaped

# Why the values of an effect do not let it be reported.
_UNKNOWN = "no parameter of it is known from zero"
# Share of a parameter by which rounding changes it.
_ROUNDING = 1e-10
_UNSURE = "its value is not known well enough to correct anything"

# Share of effects with a warning that are right, in simulated recordings: the noise is
# never quite what the likelihood assumes.
_POSSIBLE = 0.15


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
        most = _POSSIBLE if self.warning else 1.0
        return min(self.evidence.probability, most)

    @property
    def is_determined(self):
        """Whether the interval of a force, torque or stiffness, if any, omits zero."""
        # Where size and shape trade against each other some torque is there all the
        # same.
        own = [x for key, x in self.intervals.items() if "N" in self.units.get(key, "")]
        return not own or any(low > 0 or high < 0 for low, high in own)


def discovered_effects(search, final, names, prismatic):
    """Yield each `DiscoveredEffect`, with the values of the final fit."""
    for finding, effect, estimate in zip(
        search.findings, final.effects, final.effect_estimates
    ):
        values, deviations = named_values(effect, estimate)
        deviations = {key: std for key, std in deviations.items() if std > 0}
        half = float(special.stdtrit(estimate.freedom, 0.95))
        intervals = {
            key: (values[key] - half * std, values[key] + half * std)
            for key, std in deviations.items()
        }
        warning = finding.warning
        if not warning and isinstance(effect, InModel):
            nominal = dict(zip(effect.coefficients, effect.nominal))
            least = {k: search.settings.known * x for k, x in deviations.items()}
            away = (abs(values[k] - nominal.get(k, 0.0)) > least[k] for k in least)
            warning = "" if any(away) else _UNSURE
        elif not warning:
            # The size of a channel's effect is its shape.
            own = estimate if isinstance(effect, OfChannel) else estimate.of_shape()
            warning = "" if _is_known(effect, own, half) else _UNKNOWN
        units = effect.parameter_units(prismatic[effect.joint])
        rivals = (_named(one, effect, names) for one in finding.rivals)
        yield DiscoveredEffect(
            name=effect.name,
            joint=effect.joint,
            joint_name=names[effect.joint],
            scope="robot" if isinstance(effect, OfRobot) else "joint",
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
            warning=warning,
        )


def _named(rival, effect, names):
    """Name a rival of an effect, with its joint if that differs."""
    name = rival.name
    for kind in rival.split_by[:1] if isinstance(rival, Shaped) else ():
        name += f": {getattr(rival, kind)}"
    if rival.joint == effect.joint or isinstance(rival, OfRobot):
        return name
    return f"{name} on {names[rival.joint]}"


def _is_known(effect, estimate, half):
    """Whether a parameter of an effect is known from zero, half deviations or more."""
    # A shape alone is no sign that the effect is there.
    values, deviations = named_values(effect, estimate)
    seen = [key for key, std in deviations.items() if std > 0]
    own = [key for key in seen if key not in effect.shape()] or seen
    away = any(abs(values[key]) > half * deviations[key] for key in own)
    return any(estimate.coef) and (away or not own)


def named_values(effect, estimate):
    """Parameters by name, and their standard deviations (delta method)."""
    covariance, k = estimate.covariance, len(estimate.coef)
    x = np.array(estimate.coef, dtype=float)
    scale = np.sqrt(np.maximum(np.diagonal(covariance)[:k], 0.0))
    # Small compared with the value, where the deviation is not.
    steps = 1e-4 * np.minimum(scale, np.abs(x))
    steps[~(steps > 0)] = 1e-9
    ends = [(x + 0.5 * step, x - 0.5 * step) for step in np.diag(steps)]
    sides = [tuple(map(effect.parameters, both)) for both in ends]
    values, slopes = effect.parameters(x), {}
    for name in values:
        rises = np.array([above[name] - below[name] for above, below in sides])
        rises[abs(rises) < _ROUNDING * abs(values[name])] = 0.0
        slopes[name] = np.r_[rises / steps, np.zeros(len(covariance) - k)]
    for name, slope in zip(estimate.shape, np.eye(len(covariance))[k:]):
        if name not in values:
            values[name], slopes[name] = float(getattr(effect, name)), slope
    deviations = {}
    for name, slope in slopes.items():
        # Of the coefficients that it depends on; nan if one of these is unknown.
        seen = slope != 0
        variance = slope[seen] @ covariance[np.ix_(seen, seen)] @ slope[seen]
        deviations[name] = float(np.sqrt(np.maximum(variance, 0.0)))
    # About the value, of all forms together.
    for weight, other in estimate.forms:
        for key, value in other.items():
            away = np.sqrt(weight) * (value - values[key])
            deviations[key] = float(np.hypot(deviations[key], away))
    for name, value in effect.shape().items():
        values.setdefault(name, value)
    return values, deviations
