"""Channels that are another quantity: counts, velocities, torques without signs."""

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._joints import beyond, limited, limits
from sklearn_vbjfa.inspection._reading import (
    Candidate,
    Hypothesis,
    Reading,
    every,
    of,
)
from sklearn_vbjfa.inspection._scene import fastest, speeds
from sklearn_vbjfa.inspection._signals import Change
from sklearn_vbjfa.model import TreeRegressor, nominal_parameters
from sklearn_vbjfa.recording import UNSIGNED, ChannelFinding, listed_joints

# Rows of a joint with which its first signs are looked for.
_LOOKED_AT = 20_000
# Dry friction to begin with, in root mean squares of the rigid bodies' torque.
_STARTS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, np.inf)
_ROUNDS = 50


def counts(reading):
    """Find positions neither in radians nor in degrees: one error or none."""
    model, names, q, revolute = reading.model, reading.names, reading.q, ~reading.slides
    degrees = np.where(revolute, np.pi / 180, 1.0)
    out, as_degrees = beyond(model, q), beyond(model, q * degrees)
    far = (out > number.FAR_BEYOND) & (as_degrees > 0)
    travel = np.ptp(q, axis=0)
    whole = (q == np.round(q)).all(axis=0) & (travel >= number.FEWEST_COUNTS)
    # Whole degrees are degrees.
    whole &= ~((out > number.FAR_BEYOND) & (as_degrees == 0)) | (travel > 720)
    wrong = far | whole
    # A joint may turn without end, but not at that speed, not even in degrees.
    fast = speeds(reading) * degrees > fastest(model)
    wrong |= fast & (travel * degrees > number.LARGEST_TURN)
    if not wrong.any():
        return []
    joints = tuple(np.flatnonzero(wrong).tolist())
    j = max(joints, key=lambda k: travel[k])
    low, high = q[:, j].min(), q[:, j].max()
    evidence = f"from {low:.4g} to {high:.4g}"
    if whole[j]:
        evidence = f"whole numbers from {low:.6g} to {high:.6g}"
    who = f"The positions of {listed_joints(names, joints)} are"
    if revolute[j]:
        message = (
            f"{who} neither radians nor degrees: {names[j]} has {evidence}, more than "
            "it can move; they look like encoder counts. Convert them to rad (times 2 "
            "pi over the counts of a turn, from the joint's zero)."
        )
    else:
        message = (
            f"{who} not in metres: {names[j]} has {evidence}, more than it can move; "
            "convert encoder counts or millimetres to m."
        )
    # Sines and inertias of such angles are nonsense.
    return [ChannelFinding("position_counts", joints, "error", message)]


def _velocities(reading):
    """Return the positions of which the columns would be velocities."""
    model, q, parts = reading.model, reading.q, reading.parts
    low, high = limits(model)
    free = np.where(reading.slides, number.RANGE_SLIDE, number.RANGE_TURN)
    width = np.where(limited(model), high - low, free)
    # A joint that stays within its range moves to and fro. At rest, or within part of a
    # swing, any signal may be the derivative of any other.
    tiny = np.finfo(float).tiny
    swing = [np.abs(q[p].mean(axis=0)) / (q[p].std(axis=0) + tiny) for p in parts]
    if np.median(swing) > number.LARGEST_MEAN:
        return None
    integral = np.empty_like(q)
    for part in parts:
        x = np.cumsum(q[part], axis=0) * reading.dt
        # Positions are hardly ever centred, so that their integrals diverge.
        if (np.ptp(x, axis=0) > number.RANGE_MARGIN * width).any():
            return None
        integral[part] = x - 0.5 * (x.max(axis=0) + x.min(axis=0))
    integral += np.where(limited(model), 0.5 * (low + high), 0.0)
    known = reading.tau, reading.dt, parts, reading.usable
    other = Reading(model, reading.names, integral, *known)
    if other.tell_nothing() or other.robot.joints.size != reading.robot.joints.size:
        return None
    fall = other.now.fall(reading.now)
    if fall < number.CLEAR * reading.robot.joints.size:
        return None
    return Candidate(
        change=Change(),
        joints=every(reading),
        log_odds=of(other.now, reading.now, 1),
        fall=fall,
    )


def _say_velocities(reading, candidate):
    factor = np.exp(candidate.fall / reading.robot.joints.size)
    return (
        "The columns of positions look like velocities: integrated over time they "
        "stay within the joints' ranges, and the squared torque errors fall by the "
        f"factor {factor:.3g} (log odds {candidate.log_odds:.0f}). Give positions, or "
        "states [q | v | a]."
    )


HYPOTHESES = (
    Hypothesis(
        name="velocity_as_position",
        severity="error",
        applies=lambda reading: not reading.commanded,
        propose=_velocities,
        message=_say_velocities,
        repairs=False,
    ),
)


# -- torques without signs -------------------------------------------------------------


def unsigned_torques(reading):
    """Find torques of which only sizes were logged."""
    tau, signals = reading.tau, reading.signals
    # Where they are, all of one sign are: what loads a joint little shows nothing.
    one_way = (tau >= 0).all(axis=0) | (tau <= 0).all(axis=0)
    one_way = np.flatnonzero(one_way & (np.ptp(tau, axis=0) > 0)).tolist()
    if not one_way or signals is None:
        return []
    regressor, bodies = TreeRegressor(reading.model), nominal_parameters(reading.model)
    explanations = signed_columns(regressor, signals.states, bodies)
    found = False
    for j in one_way:
        columns, sizes = explanations[j], np.abs(signals.now[:, j])
        made = columns @ most_explaining(columns, sizes)
        plain = columns @ np.linalg.lstsq(columns, sizes)[0]
        left = ((sizes - np.abs(made)) ** 2).sum(), ((sizes - plain) ** 2).sum()
        least = min((made < 0).mean(), (made > 0).mean())
        found |= number.SIGN_GAIN * left[0] < left[1] and least > number.RARE
    if not found:
        return []
    often = max(_reversals(signals.states[:, reading.nv + j]) for j in one_way)
    message = (
        f"The torques of {listed_joints(reading.names, one_way)} have one sign only, "
        f"although a joint reverses {often} times, and with signs that change the "
        "motion explains them better: their signs were not logged, as of unsigned "
        f'currents. Give --drive "{UNSIGNED}", which finds the signs (Python: '
        "drive=CurrentDrive(signed=False))."
    )
    remedy = {"drive": UNSIGNED}
    joints = tuple(one_way)
    return [ChannelFinding("unsigned_torque", joints, "error", message, remedy=remedy)]


def _reversals(speed):
    """How often a joint turns round, from its speeds (n,)."""
    moving = speed[np.abs(speed) > number.STANDS * np.abs(speed).max()]
    return int((moving[1:] * moving[:-1] < 0).sum())


def signed_columns(regressor, states, bodies):
    """Make the columns that torques may consist of, nv arrays (n, 5)."""
    # regressor: with a method `torques` of bodies (nv, 10). Rigid bodies, dry and
    # viscous friction, inertia, and an offset.
    q, v, a = map(np.ascontiguousarray, np.split(states, 3, axis=1))
    rigid = regressor.torques(q, v, a, np.ascontiguousarray(bodies))
    one = np.ones_like(v)
    columns = rigid, np.sign(v), v, a, one
    return [np.column_stack([x[:, j] for x in columns]) for j in range(v.shape[1])]


def most_explaining(columns, sizes):
    """Coefficients of columns with which signs explain most of sizes (n,), by EM."""
    # columns: see `signed_columns`. A few thousand rows tell as much as all.
    some = slice(None, None, max(len(sizes) // _LOOKED_AT, 1))
    columns, sizes = columns[some], sizes[some]
    # All of them but the offset are positive by nature: with the other sign of all,
    # a torque has the same size.
    unit = np.sqrt((columns[:, 0] ** 2).mean()) or 1.0
    both = np.column_stack([columns, -columns[:, -1]])
    size = np.sqrt((both**2).sum(axis=0))
    both = both / np.where(size > 0, size, 1.0)
    found = []
    for share in _STARTS:
        start = columns[:, 1] if np.isinf(share) else columns[:, 0]
        if 0 < share < np.inf:
            start = start + share * unit * columns[:, 1]
        signs = np.where(start < 0, -1.0, 1.0)
        for _ in range(_ROUNDS):
            coef = scipy.optimize.nnls(both, signs * sizes)[0] / np.where(
                size > 0, size, 1.0
            )
            coef = np.append(coef[:-2], coef[-2] - coef[-1])
            new = np.where(columns @ coef < 0, -1.0, 1.0)
            if (new == signs).all():
                break
            signs = new
        found.append((((signs * sizes - columns @ coef) ** 2).sum(), len(found), coef))
    return min(found)[2]
