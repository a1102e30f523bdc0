"""Range, speed and identifiable effects of each joint's motion, without a fit."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import filter_signals, subsample
from sklearn_vbjfa.inspection._rows import still_joints
from sklearn_vbjfa.model import is_prismatic, joint_names, load_model


@dataclass(frozen=True, kw_only=True)
class JointMotion:
    """Motion of one joint in a recording, in rad or m and seconds."""

    name: str
    slides: bool  # whether it is prismatic
    lowest: float
    highest: float
    fastest: float  # 99.5 % quantile of the absolute speed
    reversals: int
    resting: float  # share of samples at rest
    torques: tuple  # lowest and highest torque [unit of the recording]
    shows: tuple  # identifiable effects
    hides: tuple  # effects that are not identifiable, each with the reason


def motion_of(recording, model=None):
    """Return the `JointMotion` of each joint of a recording, a tuple."""
    # model: None is `Recording.robot_model`. The tuple is empty if every recording is
    # shorter than the low-pass filter.
    model = load_model(recording.robot_model() if model is None else model)
    rows, parts = subsample(recording.segments, least=number.MIN_SAMPLES)
    q, tau = recording.q[rows], recording.tau[rows]
    usable = np.ones(q.shape, dtype=bool)
    signals = filter_signals(q, tau, recording.dt, parts, usable) if parts else None
    if signals is None:
        return ()
    v = signals.states[:, model.nv : 2 * model.nv]
    slides, still, motions = is_prismatic(model), still_joints(q, parts), []
    for j, name in enumerate(joint_names(model)):
        low, high = q[:, j].min(), q[:, j].max()
        moving = (signals.weight[:, j] > 0) & ~still[j]
        speeds = v[moving, j]
        reversals = int((speeds[1:] * speeds[:-1] < 0).sum())
        shows, hides = _visible(speeds, reversals, high - low, slides[j])
        facts = {"lowest": float(low), "highest": float(high), "reversals": reversals}
        facts["fastest"] = float(np.quantile(np.abs(v[:, j]), 0.995))
        facts |= {"resting": float(1 - moving.mean()), "shows": shows, "hides": hides}
        facts["torques"] = float(tau[:, j].min()), float(tau[:, j].max())
        motions.append(JointMotion(name=name, slides=bool(slides[j]), **facts))
    return tuple(motions)


def one_speed(speed):
    """Return the range of speeds (n,), not empty, if it is narrow; else None."""
    ends = np.quantile(speed, [0.5 - 0.5 * number.CENTRAL, 0.5 + 0.5 * number.CENTRAL])
    return ends if ends[1] - ends[0] < number.ONE_SPEED * ends.mean() else None


def _visible(speeds, reversals, reach, slides):
    """Return effects that a motion shows and hides, two tuples of str."""
    if not speeds.size:
        return (), ("everything (it does not move)",)
    few, narrow = number.FEW_REVERSALS, bool(reach < number.WIDE_RANGE)
    rare = f"too few reversals: {reversals}, at least {few} needed" * (reversals < few)
    small = f"range of {np.degrees(reach):.3g} degrees, at least 60 needed" * narrow
    even = one_speed(np.abs(speeds)) is not None
    # Effect -> reason why it is not identifiable; empty if it is.
    reasons = {
        "Coulomb friction, separate from offset": "it never reverses" * (not reversals),
        "viscous friction, separate from Coulomb friction": "one speed only" * even,
        "friction with memory, backlash": rare,
        "position-dependent effects": small,
    }
    if slides:
        del reasons["position-dependent effects"]
    shows = tuple(name for name, reason in reasons.items() if not reason)
    hides = tuple(f"{name} ({reason})" for name, reason in reasons.items() if reason)
    return shows, hides
