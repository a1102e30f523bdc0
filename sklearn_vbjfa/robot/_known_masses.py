"""What a known mass says of the common gain of all torque channels.

With a common gain a the recording determines a theta and not theta. A known mass, or a
sum of several, is one linear equation in theta, which fixes a exactly if the recording
determines it. Torques show a link's own mass only where it is moved along its joint,
but every motion against gravity shows the mass of something that is picked up.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, stats

from sklearn_vbjfa.effects import Payload
from sklearn_vbjfa.model._loading import body_names
from sklearn_vbjfa.robot._estimate import LOST
from sklearn_vbjfa.robot._gains import HALF_WIDTH

PAYLOAD = "payload"
# Known masses disagree if chance alone would do so less often.
_CHANCE = 0.01


@dataclass(frozen=True, kw_only=True)
class KnownMass:
    """A mass that was given, and what the recording makes of it."""

    name: str  # body, or "payload"
    mass: float  # as given [kg]
    # what the recording has for it, in units of the reference channel; nan for nothing
    found: float
    std: float  # its standard deviation
    shown: bool  # whether the recording determines it by itself
    used: bool = False  # whether it is part of what fixes the common gain


@dataclass(frozen=True, kw_only=True)
class CommonGain:
    """What fixes the common factor of all gains."""

    # gain of the reference channel [recorded unit / (N m or N)]; None where nothing
    # fixes it. Parameters were divided by it
    factor: float | None = None
    std: float = float("nan")  # nan where nothing fixes it
    masses: tuple = ()  # those that were given
    # probability of masses that disagree as much by chance; nan for a single one
    p_value: float = float("nan")

    @property
    def agree(self):
        """Whether the known masses agree with one another, as far as is known."""
        return not self.p_value < _CHANCE

    def given_up(self):
        """Return the same with nothing that is fixed."""
        return CommonGain(masses=tuple(replace(m, used=False) for m in self.masses))

    def widened(self, theta, std, units, gains, covariance):
        """Deviations (p,) of parameters with that of the common gain."""
        # theta: parameters in kg and N m (p,); std: deviations of the same with the
        # factor as it is, gains relative to a reference; units: of the parameters;
        # gains: places of gains among them; covariance: see `common_gain`.
        power = np.array([_power(unit) for unit in units])
        power[gains] = 1
        # A parameter is what it was in relative units times this power of the factor.
        scale = float(self.factor) ** power
        std = np.where(np.isin(np.arange(std.size), gains), std * scale, std)
        share = self.std / self.factor
        both = 2 * power * theta / self.factor * scale * covariance
        return np.sqrt(np.maximum(std**2 + (power * theta * share) ** 2 + both, 0.0))


def _power(unit):
    """Return how a parameter of some unit depends on the gain of torques."""
    if unit.startswith(("N", "kg")):
        return -1
    return int(unit.endswith(("N", "(N m)")))


def check_masses(masses, gains, model):
    """Return known masses as a dict; reject what is no mass of the robot's bodies."""
    # masses: dict of str to float [kg], or None; gains: the identifier's parameter.
    if masses is None or not len(masses):
        return {}
    if gains is None:
        raise ValueError(
            "known_masses fixes the common gain of all torque channels and needs "
            "gains='unknown'; got gains=None."
        )
    names = (*body_names(model), PAYLOAD)
    for name, mass in masses.items():
        if name not in names:
            raise ValueError(
                f"known_masses names {name!r}; expected one of {', '.join(names)}."
            )
        if not (np.isscalar(mass) and np.isfinite(mass) and mass > 0):
            raise ValueError(
                f"known_masses must hold positive masses [kg]; got {mass!r} for {name}."
            )
    return {name: float(mass) for name, mass in masses.items()}


def mass_places(masses, model, effects, n_rigid):
    """Where known masses are among the parameters, a list of (name, mass, place)."""
    # A payload that is picked up and put down is there twice.
    bodies, found = body_names(model), []
    for name, mass in masses.items():
        if name in bodies:
            found.append((name, mass, bodies.index(name) * (n_rigid // model.nv)))
    at = n_rigid
    for effect in effects:
        if isinstance(effect, Payload) and PAYLOAD in masses:
            found.append((PAYLOAD, masses[PAYLOAD], at))
        at += len(effect.coefficients)
    return found


def common_gain(masses, places, theta, estimate):
    """Find the common gain that known masses ask for."""
    # Returns a `CommonGain`, and the covariance (p,) of its factor with the parameters
    # in units of the reference channel, or None if nothing fixes it. Every sum of known
    # masses that the recording determines is one equation; all of them are weighted by
    # how well they are known. masses: dict of str to float; places: their
    # `mass_places`; theta: parameters of the fit (p,); estimate: `PlainEstimate` of the
    # same, with the relative gains beside them.
    missing = tuple(
        KnownMass(name=name, mass=mass, found=np.nan, std=np.nan, shown=False)
        for name, mass in masses.items()
        if name not in {name for name, _, _ in places}
    )
    if not places:
        return CommonGain(masses=missing), None
    names, given, at = zip(*places)
    at = np.array(at)
    # What is put down is a change by minus its mass.
    sign = np.where(np.array(names) == PAYLOAD, np.sign(theta[at]), 1.0)
    given, own = np.array(given), theta[at] * sign
    covariance = estimate.covariance[np.ix_(at, at)] * np.outer(sign, sign)
    told = tuple(
        KnownMass(
            name=name,
            mass=float(mass),
            found=float(found),
            std=float(np.sqrt(variance)) if shown else np.nan,
            shown=bool(shown),
        )
        for name, mass, found, variance, shown in zip(
            names, given, own, np.diagonal(covariance), estimate.known[at]
        )
    )
    # Of magnitudes, as the masses that are given.
    sums = _determined(estimate.eigen, at) * sign[:, None]
    y, x = given @ sums, own @ sums
    V = sums.T @ covariance @ sums
    nothing = CommonGain(masses=told + missing), None
    if not y.size:
        return nothing
    inverse = linalg.pinvh(V)
    information = float(y @ inverse @ y)
    if not information > 0:
        return nothing
    weight = inverse @ y / information
    factor, std = float(weight @ x), 1.0 / np.sqrt(information)
    rest = x - factor * y
    excess = float(rest @ inverse @ rest)
    p_value = float(stats.chi2.sf(excess, y.size - 1)) if y.size > 1 else np.nan
    # A mass that may as well be none says nothing of the scale.
    if not factor > HALF_WIDTH * std:
        return nothing
    share = np.abs(sums @ weight)
    told = tuple(
        replace(one, used=bool(own > LOST * share.max()))
        for one, own in zip(told, share)
    )
    common = CommonGain(factor=factor, std=std, masses=told + missing, p_value=p_value)
    return common, estimate.covariance[:, at] @ (sums @ weight * sign)


def _determined(eigen, at):
    """Find sums of parameters at k places that the data determine, (k, number)."""
    # Those whose direction has nothing in the null space of the Gram matrix.
    outside = eigen.null_space[at]
    values, vectors = linalg.eigh(outside @ outside.T)
    return vectors[:, values <= LOST] * eigen.scale[at][:, None]
