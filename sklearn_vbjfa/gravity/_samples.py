"""Samples of a recording in which inertia is small: poses and slow motion."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.effects import stops
from sklearn_vbjfa.model import nominal_parameters
from sklearn_vbjfa.robot import StateEstimator

# Length [s] over which samples are averaged, and how much longer a pose must be held.
_WINDOW = 0.2
# A joint is at rest below this share of its fastest speed.
_REST = 0.02
# Largest torque of inertia and Coriolis effects, as a share of the gravity torque; it
# is subtracted as described.
_DYNAMIC = 0.2
# Way after which the friction of a joint opposes the motion in full, as a share of the
# range of the recording.
_WAY = 0.003
_FULL = 0.9
# Speed [rad/s or m/s] that stands for a direction: its Coriolis torques are nothing.
_DIRECTION = 1e-4


def static_samples(recording, features):
    """Return one row for each pose, and for each window of slow motion."""
    # In place of the velocity `states` has the direction in which each joint came to
    # its pose: the Coulomb column of the identifier is then the friction that holds it.
    # Weights are zero where that direction is unknown.
    nv, inertial = features.n_joints_, nominal_parameters(features.model_)
    states = recording.states
    if states is None:
        states = StateEstimator(recording.dt).fit_transform(
            recording.q, groups=recording.groups
        )
    q, v, a = states[:, :nv], states[:, nv : 2 * nv], states[:, 2 * nv :]
    gravity = features.torques(q, 0 * v, 0 * a, inertial)
    dynamic = features.torques(q, v, a, inertial) - gravity
    size = np.sqrt((gravity**2).mean(axis=0))
    most = _DYNAMIC * np.maximum(size, 0.1 * size.max())
    slow = (np.abs(dynamic) <= most).all(axis=1)
    still = np.abs(v) <= _REST * np.percentile(np.abs(v), 99.5, axis=0)
    length = max(1, round(_WINDOW / recording.dt)) if recording.dt else 1
    spans = [
        span
        for part in recording.segments
        for span in _spans(slow[part], still[part].all(axis=1), part.start, length)
    ]
    if not spans:
        raise ValueError(
            "The recording holds neither poses nor slow motion: gravity needs poses "
            f"that are held for {2 * _WINDOW:g} s, or motion whose torque is at least "
            f"{1 - _DYNAMIC:.0%} gravity and friction. Record poses, or identify the "
            "robot from this motion without --for gravity."
        )
    way = np.maximum(_WAY * np.ptp(q, axis=0), np.finfo(float).tiny)
    came = np.concatenate([_came_from(q[part], way) for part in recording.segments])
    pose, tau, side = (
        np.array([x[a:b].mean(axis=0) for a, b in spans])
        for x in (q, recording.tau - dynamic, came)
    )
    labels, numbers = np.unique(
        [recording.groups[a] for a, _ in spans], return_inverse=True
    )
    known = np.abs(side) >= _FULL
    way = np.sign(side) * known
    # Friction from one side only is part of the offset.
    way *= (way > 0).any(axis=0) & (way < 0).any(axis=0)
    return replace(
        recording,
        q=pose,
        tau=tau,
        states=np.hstack([pose, _DIRECTION * way, 0 * pose]),
        weight=known.astype(float),
        groups=numbers,
        group_names=tuple(recording.group_names[label] for label in labels),
        t=None,
        v=None,
        dt=None,
        signals={},
    )


def _spans(slow, still, start, length):
    """Find (first, end) of the poses and of the windows of slow motion of a part."""
    found = []
    edges = np.flatnonzero(np.diff(np.r_[0, still, 0]))
    for a, b in edges.reshape(-1, 2):
        if b - a >= 2 * length:
            # The first half of a window settles.
            found.append((start + a + length // 2, start + b))
    moving = slow & ~still
    for a in range(0, len(slow) - length + 1, length):
        if moving[a : a + length].all():
            found.append((start + a, start + a + length))
    return sorted(found)


def _came_from(q, way):
    """State of friction that opposes the last motion in full after a way, (n, nv)."""
    return np.column_stack([stops(x, np.array([d]))[:, 0] for x, d in zip(q.T, way)])
