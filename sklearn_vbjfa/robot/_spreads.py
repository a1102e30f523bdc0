"""Which parameters are known, and where predictions leave the fit."""

import numpy as np

from sklearn_vbjfa.effects import POSITION, SPEED, TORQUE
from sklearn_vbjfa.model._trees import body_names
from sklearn_vbjfa.physical import body_scales, min_eigenvalue
from sklearn_vbjfa.robot._posterior import body_places

# -- which parameters are measured -----------------------------------------------------

# A mass is known if its deviation, and what the projection moves it by, are below this
# share of it: a body that may as well have half or no mass was not weighed.
_KNOWN = 0.5


def min_eigenvalues(bodies):
    """Smallest pseudo-inertia eigenvalues (nv,) of bodies (nv, k), in own scales."""
    mass, length = body_scales(bodies[:, :10])
    return min_eigenvalue(bodies[:, :10], mass_scale=mass, length_scale=length)


def known_parameters(robot, found):
    """State which parameters of a robot its recording determines, by an `Estimate`."""
    # "yes": by itself, as well as its standard deviation says. "in combination": only
    # with others; its value is one of many that agree. "from the description": the
    # torques say little beyond it. "no": no torque depends on it, or it is a mass whose
    # deviation, with what the projection moved it by, is over half its value.
    seen = (np.diagonal(found.metric) > 0) | robot.identifiable_
    state = np.where(robot.identifiable_, "yes", "in combination").astype(object)
    state[~seen] = "no"
    masses = body_places(robot)[: robot.features_.n_joints_, 0]
    moved = robot.theta_ - robot.theta_unconstrained_
    doubt = np.hypot(np.nan_to_num(robot.theta_std_, posinf=np.inf), moved)
    with np.errstate(invalid="ignore"):
        vague = ~(doubt[masses] <= _KNOWN * robot.theta_[masses])
    vague &= robot.identifiable_[masses]
    state[masses[vague]] = "no"
    silent = (state == "no") & np.isfinite(found.prior_std)
    state[silent | found.from_description] = "from the description"
    return tuple(state)


def note_of_masses(robot):
    """Name the bodies whose mass, or whose inertia, is not identified."""
    bodies, lines = body_names(robot.features_.model_), []
    known = np.array(robot.robot_.known_)[body_places(robot)[: len(bodies)]]
    if names := [name for name, own in zip(bodies, known) if own[0] != "yes"]:
        lines.append(
            f"Masses that are not individually identifiable: {', '.join(names)}; the "
            "values of all bodies together reproduce the torques."
        )
    described = (known[:, 4:] == "from the description").all(axis=1)
    if described.any():
        names = [name for name, one in zip(bodies, described) if one]
        lines.append(f"Inertias from the description: {', '.join(names)}.")
    return " ".join(lines)


_UNITS = {"position": POSITION, "speed": SPEED, "load": TORQUE}
_WAYS = ("forward motion", "backward motion")
_PLURALS = {"position": "positions", "speed": "speeds", "load": "loads"}


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
    return ". ".join(filter(None, ["; ".join(said), _held_text(found)]))


def _held_text(found):
    """Name the effects that are held and those that are extrapolated."""
    found = [one for one in found if one.quantity != "direction"]
    held = [name for one in found for name in one.held]
    others = [name for one in found for name in one.names if name not in one.held]
    texts = {"Held constant beyond the margin": held, "Extrapolated": others}
    return ". ".join(
        f"{what}: {', '.join(dict.fromkeys(names))}"
        for what, names in texts.items()
        if names
    )
