"""The robots that come with the package, and others that differ from their model."""

from importlib import resources

import numpy as np

from sklearn_vbjfa.model import is_prismatic, joint_names
from sklearn_vbjfa.physical import inertial_parameters, pseudo_inertia

# Range [rad or m] and speed [per s] where the description gives none, or wider ones.
_DEFAULT_RANGE = 2.5
_DEFAULT_SPEED = 2.5


def packaged_urdf(name: str) -> str:
    """Return the path of a packaged URDF."""
    folder = resources.files("sklearn_vbjfa.datasets").joinpath("robots")
    return str(folder.joinpath(f"{name}.urdf"))


def demo_arm_urdf() -> str:
    """Return the path of the URDF of a made-up six-axis arm."""
    return packaged_urdf("demo_arm")


# -- what a robot can do, and what it takes --------------------------------------------


def joint_range(model):
    """Middle and half width of each joint's range; a default where it is unlimited."""
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    # Halved first: Pinocchio's "no limit" is the largest number there is.
    reach, centre = 0.5 * high - 0.5 * low, 0.5 * high + 0.5 * low
    wide = ~(reach <= _DEFAULT_RANGE)
    return np.where(wide, 0.0, centre), np.where(wide, _DEFAULT_RANGE, reach)


def speed_limit(model):
    """Speed limit (nv,) of each joint; a default where the description gives none."""
    limit = model.velocityLimit
    return np.where((limit > 0) & (limit < 1e3), limit, _DEFAULT_SPEED)


def rigid_torques(model, states):
    """Inverse dynamics of a Pinocchio model for rows [q | v | a]."""
    import pinocchio as pin

    data, rnea = model.createData(), pin.rnea
    q, v, a = np.split(states, 3, axis=1)
    out = np.empty(q.shape)
    for k in range(len(out)):
        out[k] = rnea(model, data, q[k], v[k], a[k])
    return out


# -- robots that differ from their model -----------------------------------------------


def true_inertias(model, perturbation, rng):
    """Draw inertial parameters (nv, 10) near the nominal ones, that some body has."""
    # The pseudo-inertia J of each body is multiplied from both sides by the exponential
    # of a random symmetric matrix: it stays positive definite whatever is drawn.
    from scipy.linalg import expm

    bodies = []
    for inertia in model.inertias[1:]:
        J = pseudo_inertia(inertia.toDynamicParameters())
        E = rng.normal(scale=0.5 * perturbation, size=(4, 4))
        E = 0.5 * (E + E.T)
        length = np.sqrt(max(np.trace(J[:3, :3]) / max(J[3, 3], 1e-12), 1e-12))
        S = np.diag([length, length, length, 1.0])
        T = S @ expm(E) @ np.linalg.inv(S)
        bodies.append(inertial_parameters(T @ J @ T.T))
    return np.array(bodies)


def with_inertias(model, inertial):
    """Copy a model with inertial parameters (nv, 10) of bodies, and without rotors."""
    import pinocchio as pin

    other = model.copy()
    for j, body in enumerate(inertial):
        other.inertias[j + 1] = pin.Inertia.FromDynamicParameters(body)
    # Those of a recording are among its friction.
    other.armature = np.zeros(model.nv)
    return other


def recording_fields(model, n, n_recordings, dt):
    """Fields of a `Recording` that simulations share: n rows of each motion."""
    slides = is_prismatic(model)
    return {
        "t": np.tile(np.arange(n) * dt, n_recordings),
        "dt": float(dt),
        "groups": np.repeat(np.arange(n_recordings), n),
        "group_names": tuple(f"motion_{k + 1}" for k in range(n_recordings)),
        "joint_names": joint_names(model),
        "position_units": tuple("m" if slide else "rad" for slide in slides),
        "torque_units": tuple("N" if slide else "N m" for slide in slides),
        "licence": "BSD-3-Clause",
    }
