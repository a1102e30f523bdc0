"""Changes of positions and time: order, direction, zero, unit, sample period."""

import functools
from dataclasses import replace
from itertools import combinations, pairwise, product

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import (
    Change,
    Proposal,
    clear,
    clear_of_all,
    climbed,
    judged,
    likely,
    most_probable,
    stepped,
    times,
)
from sklearn_vbjfa.inspection._sentences import finding
from sklearn_vbjfa.inspection._torques import of_another
from sklearn_vbjfa.model import is_prismatic

# -- order, direction and coupling -----------------------------------------------------


def orders(reading, what):
    """Return the best order of some channels, by exchanges from the best of starts."""
    same, joints, names = np.arange(reading.nv), reading.robot.joints, reading.names
    starts, moves = [], []
    if what == "torques":
        left = reading.rough_crossed
        rows, columns = scipy.optimize.linear_sum_assignment(left - np.diagonal(left))
        starts = [same.copy()]
        starts[0][joints[rows]] = joints[columns]
    elif what == "positions and torques":
        rolled = range(-number.ROLLED, number.ROLLED + 1)
        starts = [*(np.roll(same, k) for k in rolled), same[::-1]]
        starts += usual_orders(reading)
    for i, j in combinations(joints.tolist(), 2):
        order = same.copy()
        order[[i, j]] = j, i
        moves.append(reordered(order, what))
    change = climbed(reading, moves, [reordered(order, what) for order in starts])
    if not change.joints:
        return None
    moved, comma = list(change.joints), " and " if len(change.joints) == 2 else ", "
    rows = change.torques if change.positions is None else change.positions
    facts = {"what": what, "who": comma.join(names[j] for j in moved)}
    facts["held"] = comma.join(names[k] for k in rows.argmax(axis=0)[moved])
    return judged(reading, change, variants=len(moves), facts=facts)


def reordered(order, what="positions and torques"):
    """Return the change by which the channels of joints have another order (nv,)."""
    rows = np.eye(order.size)[order]
    return Change(**{name: rows for name in what.split(" and ")})


def usual_orders(reading):
    """Return other orders of joints (nv,) that programs give them, and back."""
    # By name, or as Pinocchio has them: branches are sorted by name.
    parents, names = list(reading.model.parents)[1:], reading.names

    def branch(joint):
        children = [k for k, parent in enumerate(parents, 1) if parent == joint]
        children.sort(key=lambda k: names[k - 1])
        return [x for k in children for x in (k - 1, *branch(k))]

    usual = np.argsort(names, kind="stable"), np.array(branch(0))
    orders = [x for order in usual for x in (order, np.argsort(order))]
    return [x for x in orders if (np.diff(x) < 0).any()]


def mirrored(reading, torques):
    """Return joints whose positions, and perhaps torques, have the other sign."""

    def negative(joints):
        sign = times(reading.nv, -1.0, joints)
        return Change(positions=sign, torques=sign if torques else None)

    changes = [negative(j) for j in reading.robot.joints]
    return likely(reading, [*changes, climbed(reading, changes, [negative(None)])])


def coupled(reading):
    """Return the joint whose position contains that of one of the two before it."""
    changes, same, parents = {}, np.eye(reading.nv), list(reading.model.parents)
    for j in reading.robot.joints.tolist():
        before = parents[j + 1], parents[parents[j + 1]]
        alike = [
            i - 1 for i in before if i and reading.slides[i - 1] == reading.slides[j]
        ]
        for i, sign in product(alike, (1.0, -1.0)):
            positions = same.copy()
            positions[j, i] = -sign
            # Torques of the joints, or of such axes: both do the same work.
            for torques in (None, np.linalg.inv(positions).T):
                change = Change(positions=positions, torques=torques)
                changes[change] = j, i, "-+" if sign > 0 else "+-"
    best = likely(reading, changes)
    if best is None:
        return None
    j, i, (minus, plus) = changes[best.change]
    # Motors that turn with two joints share torques, whatever the encoders measure.
    shared = _shared(reading, best.change, j, i)
    if best.fall - shared.fall(reading.robot.now) < clear(best.change):
        return None
    facts = {"name": reading.names[j], "other": reading.names[i], "minus": minus}
    torque = ", and the torque of {other} by that of {other} {plus} that of {name}"
    facts["also"] = torque.format(plus=plus, **facts) * (
        best.change.torques is not None
    )
    return replace(best, joints=(j,), facts=facts)


def _shared(reading, change, j, i):
    """`BodyFit` as logged, with shared torques, friction and rotor of two joints."""
    robot, nv, signals = reading.robot, reading.nv, change.signals(reading.signals)
    axis = signals.states[:, nv + j], signals.states[:, 2 * nv + j], signals.sign[:, j]
    acting = np.zeros((len(axis[0]), nv, 10))
    for first, joint, other in ((0, j, i), (5, i, j)):
        columns = *axis, robot.described[:, joint], robot.signals.tau[:, other]
        size = np.sqrt((robot.signals.tau[:, joint] ** 2).mean())
        for k, x in enumerate(columns, start=first):
            acting[:, joint, k] = size * x / np.sqrt((x**2).mean())
    return robot.fit(columns=acting, deviation=number.WIDE)


# -- zeros -----------------------------------------------------------------------------


def zeros(reading, few):
    """Return the zeros of all joints that fit best, or of few of them."""
    # Of joints whose zero does not matter, such as vertical ones, it stays.
    free, nv = np.flatnonzero(~reading.slides), reading.nv

    def moved_by(x, j):
        return Change(offset=x * np.eye(nv)[j])

    def refined(change, joints):
        steps = [functools.partial(moved_by, j=j) for j in joints]
        change, errors = stepped(reading, change, steps)
        return change.offset + np.zeros(nv), errors

    moves = [moved_by(x, j) for j, x in product(free, number.ANGLES)]
    if not few:
        # Zeros of neighbours make up for each other.
        pairs = product(pairwise(free), number.ANGLES, number.ANGLES)
        moves += [moved_by(x, j).then(moved_by(y, k)) for (j, k), x, y in pairs]
    step = number.CLEAR_OF_JOINT if few else number.SETTLED
    place, errors = refined(climbed(reading, moves, step=step), free)
    if few:
        # Less is an effect, or a link that differs, or not shown.
        shown = free[np.abs(place[free]) > np.maximum(number.FAR_ZERO, 3 * errors)]
        place = np.where(np.isin(reading.every, shown), place, 0.0)
        place, _ = refined(Change(offset=place), shown)
    place = np.where(reading.slides, 0.0, (place + np.pi) % (2 * np.pi) - np.pi)
    moved = tuple(np.flatnonzero(np.abs(place) > number.MOVED).tolist())
    if not moved:
        return None
    facts = {"values": ", ".join(f"{reading.names[j]} {place[j]:+.2f}" for j in moved)}
    least = clear_of_all(reading)
    if few:
        # Each brings what a single one must bring.
        least = max(least, number.CLEAR_OF_JOINT) * len(moved)
    variants = len(moves) ** (few * len(moved))
    args = {"joints": moved, "variants": variants, "facts": facts}
    found = judged(reading, Change(offset=place), least, **args)
    # Where bodies are free and friction is large, errors hardly fall.
    if found is None or found.clear or found.fall < 0.5 * number.CLEAR:
        return found
    far = reading.robot.surpasses(found.log_odds)
    return replace(found, clear=far and not of_another(reading.changed(found.change)))


# -- units -----------------------------------------------------------------------------


def _limits(model):
    """Lowest and highest positions (nv,), and which joints have limits."""
    # Pinocchio's "no limit" is the largest number there is.
    low = np.maximum(model.lowerPositionLimit, -1e6)
    high = np.minimum(model.upperPositionLimit, 1e6)
    return low, high, (high - low < number.LARGEST_TURN) & (high > low)


def _beyond(model, q):
    """How far each joint moves beyond its limits [rad or m], ndarray of shape (nv,)."""
    low, high, limited = _limits(model)
    # Another zero of the joint or a nominal limit is no proof.
    margin = 0.125 * (high - low)
    outside = np.maximum(q.max(axis=0) - high, low - q.min(axis=0)) - margin
    turned = np.ptp(q, axis=0) - number.LARGEST_TURN
    return np.maximum(np.where(limited, outside, turned), 0.0)


def units(reading):
    """Return positions in degrees, turns, or another unit, such as those of motors."""
    revolute, q, model = ~reading.slides, reading.q, reading.model
    out = _beyond(model, q) * revolute
    far = (out > number.FAR_BEYOND) & _limits(model)[2]
    many = np.count_nonzero(out > 0.1) > 0.5 * np.count_nonzero(revolute)
    degrees = "degrees", "deg", np.pi / 180
    tried = [(revolute, *degrees)] if reading.poor else []
    if far.any() or many:
        tried = [(x, *degrees) for x in (revolute, far) if x.any()]
    elif not out.any() and (_speeds(reading) < _fastest(model)).all():
        tried.append((revolute, "turns", "rev", 2 * np.pi))
    # Limits that are exceeded by far are evidence as well, and turns of many joints.
    known = 2 * number.DECISIVE * (far.any() or many)
    least, found = -np.inf if far.any() else clear_of_all(reading), []
    for joints, unit, short, factor in tried:
        change = Change(positions=times(reading.nv, factor, np.flatnonzero(joints)))
        # Of a joint without limits any angle may be right.
        if (_beyond(model, q @ change.positions) * joints > 0).any():
            continue
        one = judged(reading, change, least, kind=f"position_{unit}")
        if one is None:
            continue
        j = max(one.joints, key=lambda k: np.ptp(q[:, k]))
        every = len(one.joints) == np.count_nonzero(revolute)
        own = "q_{joint}" if reading.named else "q{i}"
        given = f'give columns="q={own} [{short}]" with the names of your columns'
        if reading.alone or not every:
            given = f"add the unit to their names in the header: 'q{j + 1} [{short}]'"
        facts = {"unit": unit, "given": given}
        facts |= {"name": reading.names[j], "low": q[:, j].min(), "high": q[:, j].max()}
        found.append(replace(one, log_odds=one.log_odds + known, facts=facts))
    best = most_probable(found)
    if best is None or best.log_odds + number.PRIOR < number.DECISIVE:
        return best
    return _with_ratios(reading, best)


def _with_ratios(reading, best):
    """Return positions in a unit as those of motors if joints have other factors."""
    joints, after = list(best.joints), reading.changed(best.change)
    if after.tell_nothing():
        return best
    nv, starts = reading.nv, [_factor(x, joints, reading.nv) for x in number.RATIOS]
    moves = [_factor(x, j, nv) for x, j in product(number.RATIOS, joints)]
    more = climbed(after, moves, starts, number.SETTLED)
    steps = [functools.partial(_factor, j=j, nv=nv) for j in joints]
    more, errors = stepped(after, _factor(0.0, joints, nv).then(more), steps)
    one, known = judged(after, more, clear_of_all(after)), errors < number.KNOWN_RATIO
    if one is None or not one.clear or one.log_odds + number.PRIOR < number.DECISIVE:
        return best
    each = [j for j, seen in zip(joints, known) if seen]
    if not each:
        # Neither that unit nor any factor, such as where the time is wrong.
        return None
    each = _each(reading, best.change.then(more), each, errors[known])
    facts = dict(best.facts) | {"each": each}
    return replace(best, kind="position_unit", change=None, facts=facts)


def gear(reading):
    """Return the joint whose position has another factor, and by power its torque."""
    # Where positions do not matter, such as of slides, the masses look the same.
    turning = [int(j) for j in reading.robot.joints if not reading.slides[j]]
    changes = {}
    for x, j in product(number.RATIOS, turning):
        # A wrong gear keeps the power; or the position alone is wrong.
        for geared in (False, True):
            make = functools.partial(_factor, j=j, nv=reading.nv, geared=geared)
            changes[make(x)] = make
    best = likely(reading, changes) if changes else None
    if best is None:
        return None
    change, (error,) = stepped(reading, best.change, [changes[best.change]])
    (j,) = best.joints
    # Less is an effect, or a link that differs, or not shown.
    if abs(np.log(change.positions[j, j])) < max(number.OF_GEAR, 3 * error):
        return None
    power = ", and multiply the torque by it" * (change.torques is not None)
    facts = {"each": _each(reading, change, [j], [error]), "power": power}
    return judged(reading, change, variants=len(changes), facts=facts)


def _factor(x, j, nv, geared=False):
    """Return the change by a factor of joints' positions, exp(x), or gear ratios."""
    torques = times(nv, np.exp(-x), j) if geared else None
    return Change(positions=times(nv, np.exp(x), j), torques=torques)


def _each(reading, change, joints, errors):
    """List how much of each joint's position is a radian or metre of the joint."""
    ratios = 1 / np.diagonal(change.positions)[joints]
    return ", ".join(
        f"{reading.names[j]} {x:.3g} ± {number.INTERVAL * error * x:.1g}"
        for j, x, error in zip(joints, ratios, errors)
    )


def counts(reading):
    """Return positions neither in radians nor in degrees."""
    model, names, q, revolute = reading.model, reading.names, reading.q, ~reading.slides
    degrees = np.where(revolute, np.pi / 180, 1.0)
    far, as_degrees = _beyond(model, q) > number.FAR_BEYOND, _beyond(model, q * degrees)
    travel = np.ptp(q, axis=0)
    whole = (q == np.round(q)).all(axis=0) & (travel >= number.FEWEST_COUNTS)
    # Whole degrees are degrees.
    whole &= ~(far & (as_degrees == 0)) | (travel > 720)
    # A joint may turn without end, but not at that speed, not even in degrees.
    fast = _speeds(reading) * degrees > _fastest(model)
    fast &= travel * degrees > number.LARGEST_TURN
    joints = np.flatnonzero((far & (as_degrees > 0)) | whole | fast)
    if not joints.size:
        return None
    j = max(joints, key=lambda k: travel[k])
    facts = {"name": names[j], "low": q[:, j].min(), "high": q[:, j].max()}
    facts |= {"numbers": "whole numbers" if whole[j] else "values"}
    # Sines and inertias of such angles are nonsense.
    turns = "radians or degrees", "encoder counts, mrad", "rad"
    other = turns if revolute[j] else ("metres", "millimetres or encoder counts", "m")
    facts |= dict(zip(("units", "guess", "unit"), other))
    return Proposal(joints=tuple(joints), log_odds=np.inf, facts=facts)


# -- sample period ---------------------------------------------------------------------


def _fastest(model):
    """Impossible speeds (nv,) [rad/s or m/s]: five times each limit, given or usual."""
    limit = np.asarray(model.velocityLimit, dtype=float)
    usual = np.where(is_prismatic(model), number.FASTEST_SLIDE, number.FASTEST_TURN)
    known = (limit > 0) & (limit < 1e3)
    return number.TOO_FAST * np.where(known, limit, usual)


def _speeds(reading):
    """Speed of each joint that is seldom exceeded, ndarray of shape (nv,)."""
    width, q = number.SPEED_SAMPLES, reading.q
    travel = [np.abs(q[p][width:] - q[p][:-width]) for p in reading.parts]
    return np.quantile(np.concatenate(travel), 0.995, axis=0) / (width * reading.dt)


def implausible_speed(reading):
    """Find a sample period at which no robot moves as recorded, or barely any."""
    speed, limit, dt = _speeds(reading), _fastest(reading.model), reading.dt
    j = int(np.argmax(speed / limit))
    slow = number.TOO_FAST * speed[j] < number.TOO_SLOW * limit[j]
    if speed[j] > limit[j]:
        kind, severity = "wrong_dt:fast", "error"  # accelerations by the square
    elif slow and dt >= number.LONG_PERIOD:
        kind, severity = "wrong_dt:slow", "warning"  # such a motion may be on purpose
    else:
        return []
    facts = {"dt": dt, "name": reading.names[j], "speed": speed[j], "limit": limit[j]}
    facts |= {"unit": "m/s" if reading.slides[j] else "rad/s"}
    return [finding(kind, reading.names, reading.every, severity, **facts)]


def periods(reading):
    """Return the best other sample period."""
    dt, robot, least = reading.dt, reading.robot, clear_of_all(reading)
    # A rate in Hz is the inverse of a period.
    special = (1 / dt**2,) if dt >= number.LONG_PERIOD else ()
    fast = number.TOO_FAST * (_speeds(reading) / _fastest(reading.model)).max()
    changes = [
        Change(period=x)
        for x in dict.fromkeys([*number.PERIODS, *special])
        if fast <= number.PLAUSIBLE * x
    ]
    found = most_probable(
        judged(reading, x, least, variants=len(changes), joints=reading.every)
        for x in changes
    )
    if found is None or found.log_odds + number.PRIOR <= number.DECISIVE:
        return None
    # Another period changes inertia against weight: torques with another weight, of the
    # weight alone, or with that of springs look alike.
    weight = robot.weight[:, :, None]
    rivals = (
        robot.fit(columns=weight, deviation=1.0),
        robot.fit(robot.entries - robot.pulled(np.zeros(3))),
    )
    best = max(one.evidence for one in rivals) - robot.now.evidence
    if max(best, robot.springs) > found.log_odds - number.RIVAL:
        return None
    period = dt * found.change.period
    remedy = {"dt": float(f"{period:.6g}")}
    return replace(found, remedy=remedy, facts={"dt": dt, "period": period})
