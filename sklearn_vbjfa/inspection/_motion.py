"""What the motion of a recording can show, joint by joint, without identifying."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import filtered, long_parts
from sklearn_vbjfa.model import (
    TreeRegressor,
    is_prismatic,
    joint_names,
    load_model,
    nominal_parameters,
)


@dataclass(frozen=True, kw_only=True)
class JointMotion:
    """What one joint does in a recording.

    Attributes
    ----------
    name : str
        Joint.
    slides : bool
        Whether it moves along its axis.
    lowest, highest : float
        Range of its positions [rad or m].
    fastest : float
        Speed that it exceeds in half a percent of the time [rad/s or m/s].
    reversals : int
        How often it turns round.
    resting : float
        Share of the time that it is at rest.
    torques : tuple of float
        Lowest and highest torque [unit of the recording].
    loads : tuple of float
        Lowest and highest torque of gravity by the robot's description [N m or N].
    shows, hides : tuple of str
        What the motion can show, and what it cannot, with the reason.
    """

    name: str
    slides: bool
    lowest: float
    highest: float
    fastest: float
    reversals: int
    resting: float
    torques: tuple
    loads: tuple
    shows: tuple
    hides: tuple


def motion_of(recording, model=None):
    """Return what each joint of a recording does, a tuple of `JointMotion`.

    Parameters
    ----------
    recording : Recording
        Positions and torques.
    model : str, os.PathLike or pinocchio.Model, default=None
        Robot; None is `Recording.robot_model`.

    Returns
    -------
    tuple of JointMotion
        In the order of the joints; empty if every recording is shorter than the filter
        that separates the motion from noise.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.inspection import motion_of
    >>> first = motion_of(load_demo_recording())[0]
    >>> first.name, first.reversals > 10, first.hides
    ('joint_1', True, ('friction that varies with the load: gravity does not load it',))
    """
    model = load_model(recording.robot_model() if model is None else model)
    rows, parts = long_parts(recording.n_samples, recording.groups)
    if not parts:
        return ()
    q, tau = recording.q[rows], recording.tau[rows]
    signals = filtered(q, tau, recording.dt, parts, np.ones(q.shape, dtype=bool))
    if signals is None:
        return ()
    nv = model.nv
    v = signals.states[:, nv : 2 * nv]
    loads = _loads(model, signals.states)
    slides = is_prismatic(model)
    found = []
    for j, name in enumerate(joint_names(model)):
        moving = signals.weight[:, j] > 0
        if np.ptp(q[:, j]) == 0:
            moving = np.zeros_like(moving)
        speeds = v[moving, j]
        reversals = int((speeds[1:] * speeds[:-1] < 0).sum())
        ends = np.quantile(q[:, j], [0.0, 1.0])
        shows, hides = _visible(
            speeds, reversals, ends, slides[j], loads[:, j], signals.now[:, j]
        )
        found.append(
            JointMotion(
                name=name,
                slides=bool(slides[j]),
                lowest=float(ends[0]),
                highest=float(ends[1]),
                fastest=float(np.quantile(np.abs(v[:, j]), 0.995)),
                reversals=reversals,
                resting=float(1 - moving.mean()),
                torques=(float(tau[:, j].min()), float(tau[:, j].max())),
                loads=(float(loads[:, j].min()), float(loads[:, j].max())),
                shows=shows,
                hides=hides,
            )
        )
    return tuple(found)


def _loads(model, states):
    """Return torques of gravity by the nominal inertias, ndarray (n, nv)."""
    q, still = np.ascontiguousarray(states[:, : model.nv]), np.zeros_like
    loads = TreeRegressor(model).torques(
        q, still(q), still(q), nominal_parameters(model)
    )
    # What is left about a vertical axis is rounding.
    size = np.abs(loads).max(axis=0)
    loads[:, size < 1e-9 * size.max(initial=0.0)] = 0.0
    return loads


def one_speed(speed):
    """Return the range of speeds (n,), not empty, if they are one only; else None."""
    ends = np.quantile(speed, [0.5 - 0.5 * number.MIDDLE, 0.5 + 0.5 * number.MIDDLE])
    return ends if ends[1] - ends[0] < number.ONE_SPEED * ends.mean() else None


def _visible(speeds, reversals, ends, slides, load, torque):
    """Return what the motion of a joint shows and hides, two tuples of str."""
    if not speeds.size:
        return (), ("everything: it does not move",)
    shows, hides = [], []

    def put(what, reason):
        (hides if reason else shows).append(f"{what}: {reason}" if reason else what)

    put(
        "Coulomb friction beside an offset",
        "" if reversals else "it never reverses",
    )
    put(
        "viscous beside Coulomb friction",
        "" if one_speed(np.abs(speeds)) is None else "it keeps to one speed",
    )
    put(
        "hysteresis and backlash",
        ""
        if reversals >= number.FEW_REVERSALS
        else f"it reverses {reversals} time(s), {number.FEW_REVERSALS} are needed",
    )
    reach = ends[1] - ends[0]
    if not slides:
        put(
            "what varies with the position",
            ""
            if reach >= number.WIDE_RANGE
            else f"it covers {np.degrees(reach):.3g} of some 60 degrees",
        )
    spread, scale = np.ptp(load), np.std(torque)
    reason = ""
    if np.abs(load).max() <= 1e-6 * max(scale, 1e-12):
        reason = "gravity does not load it"
    elif spread <= 1e-9 * np.abs(load).max():
        # As on a vertical slide.
        reason = "gravity loads it alike everywhere, accelerations alone vary its load"
    elif spread < number.SAME_LOAD * scale:
        unit = "N" if slides else "N m"
        reason = f"its load by gravity varies by {spread:.2g} {unit} only"
    put("friction that varies with the load", reason)
    return tuple(shows), tuple(hides)
