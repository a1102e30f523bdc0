"""Random serial chains written as URDF."""

import numpy as np
import pinocchio as pin
from sklearn.utils import check_random_state

from sklearn_vbjfa.design import best_drawn, pose
from tests.effects._arms import inverse_dynamics

_AXES = ("0 0 1", "0 1 0", "0.6 0 0.8", "0 1 0", "1 0 0", "0 1 0", "0 0 1")


def _body(name, rng, size):
    """Return a link with a physically consistent random inertia."""
    mass = size**3 * rng.uniform(1.0, 3.0)
    centre = size * rng.uniform(-0.05, 0.05, size=3) + size * np.array([0, 0, 0.1])
    x, y, z = size**5 * rng.uniform(0.01, 0.02, size=3)
    return (
        f'<link name="{name}"><inertial><origin xyz="{centre[0]} {centre[1]} '
        f'{centre[2]}"/><mass value="{mass}"/><inertia ixx="{y + z}" ixy="0" ixz="0" '
        f'iyy="{x + z}" iyz="0" izz="{x + y}"/></inertial></link>'
    )


def chain(folder, kinds, *, seed=0, effort=40.0, velocity=2.0, reach=1.5, name="chain"):
    """Write a chain of joints such as ("revolute", "prismatic"); return its path."""
    rng = np.random.default_rng(seed)
    parts = ['<link name="base"/>']
    parent = "base"
    for k, kind in enumerate(kinds):
        link = f"link_{k + 1}"
        limit = f'effort="{effort}" velocity="{velocity}"'
        if kind != "continuous":
            limit += f' lower="-{reach}" upper="{reach}"'
        parts.append(_body(link, rng, 1.0))
        parts.append(
            f'<joint name="{name}_{k + 1}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{link}"/><origin xyz="0.05 0 0.2" rpy="0.1 0.2 0"/>'
            f'<axis xyz="{_AXES[k]}"/><limit {limit}/></joint>'
        )
        parent = link
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}">{"".join(parts)}</robot>', encoding="utf-8")
    return path


def posed(model, *, random_state=0, **kwargs):
    """Return the problem of a design."""
    settings = {"duration": 4.0, "dt": 0.02, "limits": None, "effects": ()}
    settings |= {"report": None} | kwargs
    rng = check_random_state(random_state)
    return pose(model, rng=rng, **settings)


def problem_of(model, **kwargs):
    """Return the problem of a design and its initial motion."""
    rng = check_random_state(kwargs.pop("random_state", 0))
    problem = posed(model, random_state=rng, **kwargs)
    return problem, best_drawn(problem, rng)[0]


def swung(path, frequencies, n, third=0.0):
    """Return positions and torques at 100 Hz, with viscous friction.

    Sines of given frequencies [Hz] and third harmonics of amplitude `third` [rad].
    """
    w = 2 * np.pi * np.array(frequencies)
    phase = 0.01 * np.outer(np.arange(n), w)
    q = 0.8 * np.sin(phase) + third * np.sin(3 * phase)
    v = w * (0.8 * np.cos(phase) + 3 * third * np.cos(3 * phase))
    a = -(w**2) * (0.8 * np.sin(phase) + 9 * third * np.sin(3 * phase))
    model = pin.buildModelFromUrdf(str(path))
    return q, inverse_dynamics(model, np.hstack([q, v, a])) + 0.5 * v
