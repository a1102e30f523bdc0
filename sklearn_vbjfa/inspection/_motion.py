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
    """What one joint does in a recording, in rad or m and seconds."""

    name: str
    slides: bool  # whether it moves along its axis
    lowest: float
    highest: float
    fastest: float  # speed that it exceeds in half a percent of the time
    reversals: int
    resting: float  # share of the time that it is at rest
    torques: tuple  # lowest and highest torque [unit of the recording]
    loads: tuple  # lowest and highest torque of the described weight [N m or N]
    shows: tuple  # what the motion can show, and what it cannot, with the reason
    hides: tuple


def motion_of(recording, model=None):
    """Return what each joint of a recording does, a tuple of `JointMotion`."""
    # model: of the robot; None is `Recording.robot_model`. Empty if every recording is
    # shorter than the filter that separates the motion from noise.
    model = load_model(recording.robot_model() if model is None else model)
    rows, parts = long_parts(recording.n_samples, recording.groups)
    q, tau = recording.q[rows], recording.tau[rows]
    every = np.ones(q.shape, dtype=bool)
    signals = filtered(q, tau, recording.dt, parts, every) if parts else None
    if signals is None:
        return ()
    v = signals.states[:, model.nv : 2 * model.nv]
    loads, slides = _loads(model, signals.states), is_prismatic(model)
    found = []
    for j, name in enumerate(joint_names(model)):
        low, high = q[:, j].min(), q[:, j].max()
        moving = (signals.weight[:, j] > 0) & (low < high)
        speeds = v[moving, j]
        reversals = int((speeds[1:] * speeds[:-1] < 0).sum())
        channels = high - low, slides[j], loads[:, j], signals.tau[:, j]
        shows, hides = _visible(speeds, reversals, *channels)
        found.append(
            JointMotion(
                name=name,
                slides=bool(slides[j]),
                lowest=float(low),
                highest=float(high),
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
    bodies = nominal_parameters(model)
    loads = TreeRegressor(model).torques(q, still(q), still(q), bodies)
    # What is left about a vertical axis is rounding.
    size = np.abs(loads).max(axis=0)
    loads[:, size < 1e-9 * size.max(initial=0.0)] = 0.0
    return loads


def one_speed(speed):
    """Return the range of speeds (n,), not empty, if they are one only; else None."""
    ends = np.quantile(speed, [0.5 - 0.5 * number.MIDDLE, 0.5 + 0.5 * number.MIDDLE])
    return ends if ends[1] - ends[0] < number.ONE_SPEED * ends.mean() else None


def _visible(speeds, reversals, reach, slides, load, torque):
    """Return what the motion of a joint shows and hides, two tuples of str."""
    if not speeds.size:
        return (), ("everything: it does not move",)
    few, narrow = number.FEW_REVERSALS, reach < number.WIDE_RANGE
    even = one_speed(np.abs(speeds)) is not None
    # Effects, and why they are hidden if they are.
    reasons = {
        "Coulomb friction, separate from offset": "it never reverses" * (not reversals),
        "viscous friction, separate from Coulomb friction": "one speed only" * even,
        "friction with memory, backlash": (
            f"it reverses {reversals} time(s), {few} are needed" * (reversals < few)
        ),
        "position-dependent effects": (
            f"range of {np.degrees(reach):.3g} degrees, at least 60 needed"
            * bool(narrow)
        ),
        "load-dependent friction": _alike(load, torque, slides),
    }
    if slides:
        del reasons["position-dependent effects"]
    shows = tuple(what for what, reason in reasons.items() if not reason)
    hides = tuple(f"{what}: {reason}" for what, reason in reasons.items() if reason)
    return shows, hides


def _alike(load, torque, slides):
    """Return why a load of gravity (n,) shows nothing; "" if it varies enough."""
    spread, size, scale = np.ptp(load), np.abs(load).max(), np.std(torque)
    if size <= 1e-6 * max(scale, 1e-12):
        return "gravity does not load it"
    if spread <= 1e-9 * size:
        # As on a vertical slide.
        return "gravity loads it alike everywhere, accelerations alone vary its load"
    unit = "N" if slides else "N m"
    narrow = spread < number.SAME_LOAD * scale
    return f"its load by gravity varies by {spread:.2g} {unit} only" if narrow else ""
