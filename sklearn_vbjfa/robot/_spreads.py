"""How large the torques of friction and effects are, and how well they are known."""

import warnings
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.effects import (
    MARGIN,
    OUTLIERS,
    POSITION,
    ROUNDING,
    SPEED,
    TORQUE,
)
from sklearn_vbjfa.model._dynamics import rounding_entries
from sklearn_vbjfa.model._loading import nominal_parameters
from sklearn_vbjfa.model._trees import body_names
from sklearn_vbjfa.physical import body_scales, min_eigenvalue

# Time outside the fit, as a share of its duration, from which a prediction says so.
_MARGIN = 0.1


def time_outside_text(effects, time, t):
    """Name the effects of time that are predicted outside the time of the fit."""
    # time: first and last time of the fit [s]; t (n,): of the rows. A list of str.
    margin = _MARGIN * (time[1] - time[0])
    ways = {"beyond": t.max() - time[1], "before": time[0] - t.min()}
    names = dict.fromkeys(effect.name for effect in effects)
    return [
        f"Effects of time ({', '.join(names)}): predicted up to {seconds:.3g} s "
        f"{where} the time of the fit"
        for where, seconds in ways.items()
        if names and seconds > margin
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueSpread:
    """How far measured torques may be from predicted ones, in the band of the fit."""

    # (p, p): infinite on the diagonal where nothing tells a parameter
    covariance: np.ndarray
    # (nv,): variance of the noise of the positions in the residual [(N m or N)^2]
    through: np.ndarray
    # (nv,): variance of all else in it: noise of torques, what the model lacks
    rest: np.ndarray

    @classmethod
    def of_estimate(cls, found):
        """Take what an `Estimate` has; None where its regressor has no covariance."""
        if found.covariance is None:
            return None
        finite, moments = np.isfinite(np.diagonal(found.covariance)), found.moments
        fitted = found.covariance[np.ix_(finite, finite)]
        through, rest = found.noise()
        # A fit takes part of the noise for its own: residuals of its rows are smaller,
        # in the mean by the variance of what is predicted in them.
        known = np.where(finite & finite[:, None], found.covariance, 0.0)
        taken = np.array(
            [np.vdot(one, known[np.ix_(own, own)]) for own, one in moments.parts]
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            taken = np.where(moments.n > 0, taken / moments.n, 0.0)
        made = cls(covariance=fitted, through=through**2, rest=rest**2 + taken)
        return made.of(found.covariance)

    def of(self, covariance):
        """Return it with another covariance (p, p) of the parameters."""
        # Symmetric to the last bit, of which a file holds one half.
        return replace(self, covariance=0.5 * (covariance + covariance.T))

    def std(self, rows, *, noiseless):
        """Deviations (n, nv) for `RegressorRows`, with noise of positions or not."""
        # Infinite where a row asks for a parameter that nothing tells.
        finite = np.isfinite(np.diagonal(self.covariance))
        fitted = self.covariance[np.ix_(finite, finite)]
        variance = self.rest if noiseless else self.rest + self.through
        made = []
        for Phi in rows.blocks():
            own = Phi[:, :, finite]
            spread = np.einsum("njk,njk->nj", own @ fitted, own) + variance
            asked = (Phi != 0) & ~finite & ~_rounding(Phi, rows.n_rigid)
            made.append(np.where(asked.any(axis=2), np.inf, spread))
        return np.sqrt(np.maximum(np.concatenate(made), 0.0))


def _rounding(Phi, n_rigid):
    """Entries (nv, p) of matrices (n, nv, p) that are the rounding of a zero."""
    nv = Phi.shape[1]
    found = np.zeros(Phi.shape[1:], dtype=bool)
    power = (Phi[:, :, :n_rigid] ** 2).sum(axis=0).reshape(nv, nv, -1)
    found[:, :n_rigid] = rounding_entries(power).reshape(nv, -1)
    return found


# -- which parameters are measured -----------------------------------------------------

# A mass is known if its deviation, and what the projection moves it by, are below this
# share of it: a body that may as well have half or no mass was not weighed.
_KNOWN = 0.5


@dataclass(frozen=True, kw_only=True)
class BodyMass:
    """Mass of a body that a joint moves."""

    joint: int  # from zero
    name: str  # of the body
    mass: float  # of the fitted robot [kg]
    std: float  # [kg]; nan or infinite where there is none
    nominal: float  # of the robot description [kg]
    known: str  # whether the recording determines it, see `known_parameters`


def min_eigenvalues(bodies):
    """Smallest pseudo-inertia eigenvalues (nv,) of bodies (nv, k), in own scales."""
    mass, length = body_scales(bodies[:, :10])
    return min_eigenvalue(bodies[:, :10], mass_scale=mass, length_scale=length)


def known_parameters(robot, found):
    """State which parameters of a robot its recording determines, by an `Estimate`."""
    # "yes": by itself, as well as its standard deviation says. "in combination":
    # torques depend on it, but only together with others; its value agrees with them
    # and with the robot description, but is one of many. "from the description": the
    # torques say little beyond it (`from_description_`). "no": no torque depends on it,
    # or it is a mass whose deviation, with what the projection moved it by, is over
    # half its value.
    # Values of effects in the model have no columns of their own.
    seen = (np.diagonal(found.metric) > 0) | robot.identifiable_
    state = np.where(robot.identifiable_, "yes", "in combination").astype(object)
    state[~seen] = "no"
    masses = _masses(robot)
    moved = robot.theta_ - robot.theta_unconstrained_
    doubt = np.hypot(np.nan_to_num(robot.theta_std_, posinf=np.inf), moved)
    with np.errstate(invalid="ignore"):
        vague = ~(doubt[masses] <= _KNOWN * robot.theta_[masses])
    vague &= robot.identifiable_[masses]
    state[masses[vague]] = "no"
    silent = (state == "no") & np.isfinite(found.prior_std)
    state[silent | found.from_description] = "from the description"
    return tuple(state)


def _masses(robot):
    """Return where the masses are among the parameters, (nv,)."""
    nv = robot.features_.n_joints_
    return np.arange(nv) * (robot.features_.n_parameters_ // nv)


def body_masses(robot):
    known = robot.robot_.known_
    model = robot.features_.model_
    nominal = nominal_parameters(model)[:, 0]
    return tuple(
        BodyMass(
            joint=joint,
            name=name,
            mass=float(robot.theta_[at]),
            std=float(robot.theta_std_[at]),
            nominal=float(nominal[joint]),
            known=known[at],
        )
        for joint, (name, at) in enumerate(zip(body_names(model), _masses(robot)))
    )


def note_of_masses(robot):
    """Name the bodies of an identified robot whose mass is not identified."""
    names = [body.name for body in body_masses(robot) if body.known != "yes"]
    if not names:
        return ""
    return (
        f"The recording does not determine the masses of {', '.join(names)}: their "
        "inertias agree with the torques, but are not measured one by one."
    )


_UNITS = {"position": POSITION, "speed": SPEED, "load": TORQUE}
_WAYS = ("forward motion", "backward motion")
_PLURALS = {"position": "positions", "speed": "speeds", "load": "loads"}


def signals_outside_text(fitted, signals):
    """Name the recorded signals that leave their fitted range, a list of str."""
    # fitted: `ends` of each in the fit; effects are straight lines in a signal.
    said = []
    for name, (low, high) in fitted.items():
        values = signals[name]
        margin = MARGIN * (high - low) + ROUNDING * max(abs(low), abs(high))
        excess = np.maximum(low - values, values - high)
        share = float((excess > margin).mean())
        if share > OUTLIERS:
            reached = values[np.argmax(excess)]
            said.append(
                f"The recorded signal {name}: to {reached:.3g}, fitted on {low:.3g} to "
                f"{high:.3g} ({100 * share:.2g} % of the rows)"
            )
    return said


def outside_text(found, names, prismatic):
    """Say what lies outside the ranges of a fit; `found` are `OutsideRange`."""
    said = []
    for one in found:
        share = round(100 * one.share, 0 if one.share > 0.02 else 1)
        rows = f"({', '.join(one.names)}; {share:g} % of the rows)"
        if one.quantity == "direction":
            way, other = _WAYS if one.reached > 0 else _WAYS[::-1]
            said.append(f"{names[one.joint]}: {way}, fitted on {other} only {rows}")
            continue
        unit = _UNITS[one.quantity][int(prismatic[one.joint])]
        low, high = one.fitted
        said.append(
            f"{names[one.joint]}: {_PLURALS[one.quantity]} to {one.reached:.3g} {unit},"
            f" fitted on {low:.3g} to {high:.3g} {unit} {rows}"
        )
    return ". ".join(filter(None, ["; ".join(said), held_text(found)]))


def held_text(found, label=str):
    """Name the effects that are held and those that are extrapolated."""
    # label: name of an effect -> what to call it.
    found = [one for one in found if one.quantity != "direction"]
    held = [name for one in found for name in one.held]
    others = [name for one in found for name in one.names if name not in one.held]
    texts = {"Held constant beyond the margin": held, "Extrapolated": others}
    return ". ".join(
        f"{what}: {', '.join(label(name) for name in dict.fromkeys(names))}"
        for what, names in texts.items()
        if names
    )


def warn_outside(messages, stacklevel):
    """Warn of a prediction outside the range of the fit, once for all that is said."""
    if messages:
        warnings.warn(
            f"Prediction outside the range of the fit. {'. '.join(messages)}.",
            UserWarning,
            stacklevel=stacklevel + 1,
        )
