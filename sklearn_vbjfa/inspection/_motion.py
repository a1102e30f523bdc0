"""What the motion of a recording can show, joint by joint, without identifying."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import filtered, long_parts
from sklearn_vbjfa.model import is_prismatic, joint_names, load_model


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
    shows: tuple  # what the motion can show, and what it cannot, with the reason
    hides: tuple


def motion_of(recording, model=None):
    """Return what each joint of a recording does, a tuple of `JointMotion`."""
    # model: of the robot; None is `Recording.robot_model`. Empty if every recording is
    # shorter than the filter that separates the motion from noise.
    model = load_model(recording.robot_model() if model is None else model)
    rows, parts = long_parts(recording.n_samples, recording.groups)
    q, tau = recording.q, recording.tau
    if len(rows) < len(q):
        q, tau = q[rows], tau[rows]
    every = np.ones(q.shape, dtype=bool)
    signals = filtered(q, tau, recording.dt, parts, every) if parts else None
    if signals is None:
        return ()
    v = signals.states[:, model.nv : 2 * model.nv]
    slides, found = is_prismatic(model), []
    for j, name in enumerate(joint_names(model)):
        low, high = q[:, j].min(), q[:, j].max()
        moving = (signals.weight[:, j] > 0) & (low < high)
        speeds = v[moving, j]
        reversals = int((speeds[1:] * speeds[:-1] < 0).sum())
        shows, hides = _visible(speeds, reversals, high - low, slides[j])
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
                shows=shows,
                hides=hides,
            )
        )
    return tuple(found)


def one_speed(speed):
    """Return the range of speeds (n,), not empty, if they are one only; else None."""
    ends = np.quantile(speed, [0.5 - 0.5 * number.MIDDLE, 0.5 + 0.5 * number.MIDDLE])
    return ends if ends[1] - ends[0] < number.ONE_SPEED * ends.mean() else None


def _visible(speeds, reversals, reach, slides):
    """Return what the motion of a joint shows and hides, two tuples of str."""
    if not speeds.size:
        return (), ("everything (it does not move)",)
    few, narrow = number.FEW_REVERSALS, reach < number.WIDE_RANGE
    even = one_speed(np.abs(speeds)) is not None
    # Effects, and why they are hidden if they are.
    reasons = {
        "Coulomb friction, separate from offset": "it never reverses" * (not reversals),
        "viscous friction, separate from Coulomb friction": "one speed only" * even,
        "friction with memory, backlash": (
            f"too few reversals: {reversals}, at least {few} needed" * (reversals < few)
        ),
        "position-dependent effects": (
            f"range of {np.degrees(reach):.3g} degrees, at least 60 needed"
            * bool(narrow)
        ),
    }
    if slides:
        del reasons["position-dependent effects"]
    shows = tuple(what for what, reason in reasons.items() if not reason)
    hides = tuple(f"{what} ({reason})" for what, reason in reasons.items() if reason)
    return shows, hides
