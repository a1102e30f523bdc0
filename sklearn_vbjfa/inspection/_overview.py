"""What a recording is and what it can show, joint by joint, without identifying.

Friction shows in both directions and at several speeds, weight in several poses, what
depends on the load under several loads: the motion alone tells, with the robot's
nominal inertias for the loads.
"""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.inspection._rivals import channel_signals, long_parts
from sklearn_vbjfa.model import (
    is_prismatic,
    joint_names,
    load_model,
    nominal_parameters,
)
from sklearn_vbjfa.robot._features import RigidBodyFeatures

# A joint has one speed if this share of its moving time, about the middle, lies in a
# range of this share of the speed: speeds that are even in it deviate by a tenth of
# their mean, and Coulomb friction, which is the line through them at no speed at all,
# is ten times less certain than the friction at that speed.
_MIDDLE, _ONE_SPEED = 0.8, np.sqrt(12.0) / 10.0
# What saturates after a reversal must have done so in either direction several times.
_FEW_REVERSALS = 10
# Range of positions below which what varies with them looks like a spring [rad].
_WIDE = np.radians(60.0)
# Loads that vary by less than this share of the torque cannot tell friction with the
# load from friction without.
_SAME_LOAD = 0.1


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
    signals = channel_signals(q, tau, recording.dt, parts, np.ones(q.shape, dtype=bool))
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
    features = RigidBodyFeatures(model, friction=()).fit(states[:1])
    still = np.zeros_like(states)
    still[:, : model.nv] = states[:, : model.nv]
    return features.matrices(still) @ nominal_parameters(model).ravel()


def one_speed(speed):
    """Return the range of speeds (n,), not empty, if they are one only; else None."""
    ends = np.quantile(speed, [0.5 - 0.5 * _MIDDLE, 0.5 + 0.5 * _MIDDLE])
    return ends if ends[1] - ends[0] < _ONE_SPEED * ends.mean() else None


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
        if reversals >= _FEW_REVERSALS
        else f"it reverses {reversals} time(s), {_FEW_REVERSALS} are needed",
    )
    reach = ends[1] - ends[0]
    if not slides:
        put(
            "what varies with the position",
            ""
            if reach >= _WIDE
            else f"it covers {np.degrees(reach):.3g} of some 60 degrees",
        )
    spread, scale = np.ptp(load), np.std(torque)
    reason = ""
    if np.abs(load).max() <= 1e-6 * max(scale, 1e-12):
        reason = "gravity does not load it"
    elif spread <= 1e-9 * np.abs(load).max():
        # As on a vertical slide.
        reason = "gravity loads it alike everywhere, accelerations alone vary its load"
    elif spread < _SAME_LOAD * scale:
        reason = f"its load by gravity varies by {spread:.2g} only"
    put("friction that varies with the load", reason)
    return tuple(shows), tuple(hides)
