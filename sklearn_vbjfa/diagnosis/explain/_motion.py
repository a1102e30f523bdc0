"""What the motion of a recording leaves open, whatever the torques are.

Friction shows in both directions and at several speeds, weight in several poses. A
joint that has one of each only leaves coefficients that cannot be told apart, and
nothing in the residual says so: the fit is as good with one as with the other.
"""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis.explain._split import FEWEST_VALUES
from sklearn_vbjfa.inspection import one_speed
from sklearn_vbjfa.model._loading import is_prismatic

# Share of a column's power outside the span of others below which it cannot be seen.
_UNSEEN = 1e-3
# Rows that show which way a link hangs.
_POSES = 400


@dataclass(frozen=True, kw_only=True)
class MotionLimit:
    """What a joint does not do in any recording.

    Attributes
    ----------
    kind : {"one way", "one speed", "one pose"}
        It never reverses; it always has the same speed; its link always hangs the same
        way.
    joint : int
        Joint, from zero.
    recordings : tuple of int
        Recordings in which it moves, from zero.
    low, high : float
        Range of its velocity, speed or position that it keeps to [rad or m, s].
    """

    kind: str
    joint: int
    recordings: tuple
    low: float
    high: float


def motion_limits(view):
    """Return the `MotionLimit` of each joint of a recording, a tuple.

    view : `RecordingView` of all recordings.
    """
    found = []
    for joint in range(view.nv):
        rows = np.flatnonzero(view.equations.weight[:, joint] > 0)
        if not rows.size or view.precision[joint] == 0:
            continue
        recordings = tuple(int(k) for k in np.unique(view.origin[rows]))
        for kind, ends in (
            ("one way", _one_way(view, joint, rows)),
            ("one speed", _one_speed(view, joint, rows)),
            ("one pose", _one_pose(view, joint, rows)),
        ):
            if ends is not None:
                found.append(
                    MotionLimit(
                        kind=kind,
                        joint=joint,
                        recordings=recordings,
                        low=float(ends[0]),
                        high=float(ends[1]),
                    )
                )
    return tuple(found)


def _velocity(view, joint, rows):
    """Return velocities of a joint while it moves."""
    v = view.states[view.index[rows], view.nv + joint]
    return v[np.abs(v) > max(view.robot.standstill_[joint], 0.0)]


def _one_way(view, joint, rows):
    """Return the range of the velocity of a joint that never reverses, or None."""
    v = _velocity(view, joint, rows)
    if not v.size:
        return None
    rarer = min((v > 0).sum(), (v < 0).sum())
    share = rarer / v.size
    # The power of the velocity's sign about its mean, and how many values it is of.
    band = min(view.robot.cutoff_, 0.5 / (view.robot.dt or 1.0))
    values = 2.0 * band * rarer * view.step
    if rarer and (4 * share * (1 - share) >= _UNSEEN and values >= FEWEST_VALUES):
        return None
    common = v[v > 0] if (v > 0).sum() > rarer else v[v < 0]
    return np.quantile(common, [0.0, 1.0])


def _one_speed(view, joint, rows):
    """Return the range of the speed of a joint that has one only, or None."""
    speed = np.abs(_velocity(view, joint, rows))
    if not speed.size:
        return None
    return one_speed(speed)


def _one_pose(view, joint, rows):
    """Return the range of the position of a joint whose link always hangs alike."""
    features, nv = view.robot.features_, view.nv
    if is_prismatic(features.model_)[joint]:
        return None
    chosen = view.index[rows[:: max(1, rows.size // _POSES)]]
    states = np.zeros((chosen.size, 3 * nv))
    states[:, :nv] = view.states[chosen, :nv]
    first = joint * (features.n_parameters_ // nv)
    # At rest: torques of the first moments of the link are those of its weight.
    weight = features.matrices(states)[:, joint, first + 1 : first + 4]
    power = (weight**2).sum()
    if not power > 0:
        # Gravity does not act about a vertical axis.
        return None
    varying = ((weight - weight.mean(axis=0)) ** 2).sum()
    if varying >= _UNSEEN * power:
        return None
    return np.quantile(states[:, joint], [0.0, 1.0])
