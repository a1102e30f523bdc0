"""Changes of positions and time: order, direction, zero, unit, sample period."""

from dataclasses import replace
from itertools import combinations, permutations, product

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import (
    Change,
    best_of,
    clear,
    clear_of_all,
    judged,
    most_probable,
)
from sklearn_vbjfa.inspection._sentences import finding
from sklearn_vbjfa.inspection._torques import torque_factors
from sklearn_vbjfa.model import is_prismatic

# -- order, direction and coupling -----------------------------------------------------


def torque_orders(reading):
    """Return the best order of the torques."""
    joints, left = reading.robot.joints, reading.rough_crossed
    rows, columns = scipy.optimize.linear_sum_assignment(left - np.diagonal(left))
    order = np.arange(reading.nv)
    order[joints[rows]] = joints[columns]
    return _best_order(reading, "torques", _pairs(reading), [order])


def position_orders(reading):
    """Return the best order of the positions of joints of one kind."""
    slides = reading.slides
    pairs = [(a, b) for a, b in _pairs(reading) if slides[a] == slides[b]]
    return _best_order(reading, "positions", pairs)


def joint_orders(reading):
    """Return the best order of positions and torques."""
    nv, same = reading.nv, np.arange(reading.nv)
    lost = np.median(reading.robot.now.left) > 2 * np.log(number.NO_FIT)
    if lost and nv <= number.MOST_ORDERS:
        starts = [np.array(order) for order in permutations(range(nv))]
    else:
        shifts = {k % nv for k in range(-number.ROLLED, number.ROLLED + 1)}
        starts = [np.roll(same, k) for k in sorted(shifts)]
        starts += [same[::-1], *usual_orders(reading)]
    what = "positions and torques"
    return _best_order(reading, what, _pairs(reading), starts)


def _best_order(reading, what, pairs, starts=()):
    """Return the best order of some channels, by swaps from the best of starts."""
    order, best, names = np.arange(reading.nv), reading.rough().sum(), reading.names
    starts = [*starts, *(_exchanged(order, pair) for pair in pairs)]
    # Each swap puts at least one joint in its place.
    for _ in range(reading.nv + 1 if starts else 0):
        left = [reading.rough(reordered(x, what)).sum() for x in starts]
        least = int(np.argmin(left))
        if left[least] > best - number.CLEAR:
            break
        best, order = left[least], starts[least]
        starts = [_exchanged(order, pair) for pair in pairs]
    change = reordered(order, what)
    if not change.joints:
        return None
    pair = len(change.joints) == 2
    facts = {"what": what, "order": ", ".join(names[k] for k in np.argsort(order))}
    facts |= {"pair": " and ".join(names[j] for j in change.joints)}
    kind = f"swapped_{what.replace('positions and torques', 'joints')}"
    known = {"kind": f"{kind}:pair" if pair else kind, "facts": facts}
    return judged(reading, change, clear(change), variants=len(pairs), **known)


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


def _pairs(reading):
    """Pairs of joints that may be exchanged, the likelier ones if there are many."""
    joints, left = reading.robot.joints, reading.rough_crossed
    pairs, most = list(combinations(range(joints.size), 2)), number.MOST_PAIRS
    own = np.diagonal(left)
    crossed = left + left.T - own - own[:, None]
    likely = sorted(pairs, key=lambda pair: crossed[pair])[:most]
    worst = sorted(pairs, key=lambda pair: -min(own[list(pair)]))[:most]
    return [tuple(joints[list(pair)]) for pair in dict.fromkeys([*likely, *worst])]


def _exchanged(order, pair):
    order = np.array(order)
    order[list(pair)] = order[list(pair[::-1])]
    return order


def mirrored(reading, *, torques=False):
    """Return the joint whose position, or also torque, has the other sign."""
    changes = []
    for j in reading.robot.joints:
        sign = np.where(np.arange(reading.nv) == j, -1.0, 1.0)
        changes.append(Change(factor=sign, scale=sign if torques else 1.0))
    return best_of(reading, changes)


def flipped(reading):
    """Return the joint whose position and torque have the other sign."""
    return mirrored(reading, torques=True)


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
    best = best_of(reading, list(changes))
    if best is None:
        return None
    j, i, (minus, plus) = changes[best.change]
    # Motors that turn with two joints share friction, whatever the encoders measure.
    shared = _friction_of(reading, best.change, j, i)
    if best.fall - shared.fall(reading.robot.now) < clear(best.change):
        return None
    facts = {"name": reading.names[j], "other": reading.names[i]}
    facts |= {"minus": minus, "plus": plus}
    kind = "" if best.change.torques is None else "coupled_position:torques"
    return replace(best, joints=(j,), kind=kind, facts=facts)


def _friction_of(reading, change, j, i):
    """`Fit` with friction and rotor of a changed axis on two joints, as logged."""
    robot, nv, signals = reading.robot, reading.nv, change.signals(reading.signals)
    axis = signals.states[:, nv + j], signals.states[:, 2 * nv + j], signals.sign[:, j]
    acting = np.zeros((len(axis[0]), nv, 6))
    for place, joint in enumerate((j, i)):
        size = np.sqrt((robot.signals.tau[:, joint] ** 2).mean())
        for k, x in enumerate(axis):
            acting[:, joint, 3 * place + k] = size * x / np.sqrt((x**2).mean())
    return robot.fit(columns=acting, deviation=number.WIDE)


# -- zeros -----------------------------------------------------------------------------


def zeros(reading, *, few=False):
    """Return the zeros of all joints that fit best, or of few of them."""
    # Of joints whose zero does not matter, such as vertical ones, it stays.
    free, nv = np.flatnonzero(~reading.slides), reading.nv
    groups = (free,) * (2 * nv if free.size else 0)
    least = number.CLEAR_OF_JOINT if few else number.SETTLED
    place = _searched(reading, _offset, np.zeros(nv), groups, number.ANGLES, least)
    place, errors = _stepped(reading, _offset, place, free)
    if few:
        # Less is an effect, or a link that differs, or not shown.
        shown = free[np.abs(place[free]) > np.maximum(number.FAR_ZERO, 3 * errors)]
        place = np.where(np.isin(reading.every, shown), place, 0.0)
        place, _ = _stepped(reading, _offset, place, shown)
    place = np.where(reading.slides, 0.0, (place + np.pi) % (2 * np.pi) - np.pi)
    moved = tuple(np.flatnonzero(np.abs(place) > number.MOVED).tolist())
    if not moved:
        return None
    facts = {"values": ", ".join(f"{reading.names[j]} {place[j]:+.2f}" for j in moved)}
    tried = len(number.ANGLES) * nv
    least = clear_of_all(reading)
    if few:
        # Each brings what a single one must bring.
        least = max(least, number.CLEAR_OF_JOINT) * len(moved)
    args = {"joints": moved, "variants": tried ** (few * len(moved)), "facts": facts}
    return judged(reading, _offset(place), least, **args)


def zero(reading):
    """Return other zeros of one joint or of some."""
    return zeros(reading, few=True)


def _offset(place):
    return Change(offset=place)


def _searched(reading, made, place, groups, values, least=number.SETTLED):
    """Add values to parameters (nv,), each to the best joint of a group, by a score."""
    # made: the change of parameters; least: fall of the score by one of them.
    best, eye = reading.rough(made(place)).sum(), np.eye(reading.nv)
    for joints in groups:
        tried = [place + value * eye[j] for j in joints for value in values]
        left = [reading.rough(made(x)).sum() for x in tried]
        if min(left) < best - least:
            best, place = min(left), tried[int(np.argmin(left))]
        elif len(joints) > 1:
            break
    return place


def _stepped(reading, made, place, joints):
    """Move parameters (nv,) of some joints by Gauss-Newton steps; also their errors."""
    best, errors = reading.tried(made(place)), np.full(len(joints), np.inf)
    for _ in range(number.PASSES if best is not None and len(joints) else 0):
        robot = reading.robot_at(made(place))
        columns = _slopes(reading, made, place, joints)
        step = robot.fit(columns=columns, deviation=number.STEP_OF_ZERO)
        tried, errors = place.copy(), step.errors
        tried[list(joints)] += step.factors
        fit = reading.tried(made(tried))
        if fit is None or fit.evidence < best.evidence + 0.1:
            break
        best, place = fit, tried
    return place, errors


def _slopes(reading, made, place, joints):
    """Return derivatives (n, nv, m) of the described torques by parameters."""
    bodies, ends = reading.bodies, []
    for step in (number.SLOPE, -number.SLOPE):
        for j in joints:
            change = made(place + step * np.eye(reading.nv)[j])
            states = change.signals(reading.signals).states
            ends.append(bodies.torques(bodies.whole(states)))
    high, low = np.split(np.stack(ends, axis=-1), 2, axis=-1)
    return (high - low) / (2 * number.SLOPE)


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
    tried = [(revolute, "degrees", "deg", np.pi / 180)] if reading.poor else []
    if far.any() or many:
        tried = [
            (x, "degrees", "deg", np.pi / 180)
            for x in ([revolute, far] if 0 < far.sum() < revolute.sum() else [revolute])
        ]
    elif not out.any() and (_speeds(reading) < _fastest(model)).all():
        tried.append((revolute, "turns", "rev", 2 * np.pi))
    # Limits that are exceeded by far are evidence as well.
    known, least = (2 * number.DECISIVE, -np.inf) if far.any() else (0.0, None)
    least, found = clear_of_all(reading) if least is None else least, []
    for joints, unit, short, factor in tried:
        change = Change(factor=np.where(joints, factor, 1.0))
        # Of a joint without limits any angle may be right.
        if (_beyond(model, q * change.factor) * joints > 0).any():
            continue
        one = judged(reading, change, least, kind=f"position_{unit}")
        if one is None:
            continue
        j = max(one.joints, key=lambda k: np.ptp(q[:, k]))
        whole = len(one.joints) == np.count_nonzero(revolute)
        facts = {"unit": unit, "short": short, "column": "{i}" if whole else str(j + 1)}
        facts |= {"name": reading.names[j], "low": q[:, j].min(), "high": q[:, j].max()}
        found.append(replace(one, log_odds=one.log_odds + known, facts=facts))
    best = most_probable(found)
    return None if best is None else _with_ratios(reading, best)


def _with_ratios(reading, best):
    """Return positions in a unit as those of motors if joints have other factors."""
    joints, change = list(best.joints), best.change
    after = reading.changed(change)
    if after.tell_nothing():
        return best
    scale = float(torque_factors(after.robot, alike=True)[0][0])
    if 0 < scale < 1 / number.SCALE or scale > number.SCALE:
        # The unit of the torques is another one, too.
        after = after.changed(Change(scale=1 / scale))

    def made(logs):
        return Change(factor=np.exp(logs))

    among, starts = np.isin(reading.every, joints), number.RATIOS
    place = min((x * among for x in starts), key=lambda x: after.rough(made(x)).sum())
    place = _searched(after, made, place, 2 * [[j] for j in joints], starts)
    near = after.changed(made(place))
    if near.tell_nothing():
        return best
    steps, errors = _stepped(near, made, np.zeros(reading.nv), joints)
    logs, errors = (place + steps)[joints], number.INTERVAL * errors
    known = errors < number.KNOWN_RATIO
    away = np.abs(logs) - errors > number.OF_UNIT
    if not (known & away).any():
        return best
    each = [
        f"{reading.names[j]} {1 / (change.factor[j] * np.exp(x)):.3g}"
        f" ± {e / (change.factor[j] * np.exp(x)):.1g}"
        for j, x, e, seen in zip(joints, logs, errors, known)
        if seen
    ]
    facts = dict(best.facts) | {"each": ", ".join(each)}
    return replace(best, kind="position_unit", change=None, facts=facts)


def counts(reading):
    """Find positions neither in radians nor in degrees: one error or none."""
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
        return []
    j = max(joints, key=lambda k: travel[k])
    facts = {"name": names[j], "low": q[:, j].min(), "high": q[:, j].max()}
    facts |= {"numbers": "whole numbers" if whole[j] else "values"}
    # Sines and inertias of such angles are nonsense.
    turns = "radians or degrees", "encoder counts", "rad"
    other = turns if revolute[j] else ("metres", "millimetres or encoder counts", "m")
    facts |= dict(zip(("units", "guess", "unit"), other))
    return [finding("position_counts", names, joints, "error", **facts)]


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
    speed, limit = _speeds(reading), _fastest(reading.model)
    j, dt = int(np.argmax(speed / limit)), reading.dt
    slow = number.TOO_FAST * speed[j] < number.TOO_SLOW * limit[j]
    if speed[j] > limit[j]:
        kind, severity = "wrong_dt:fast", "error"  # accelerations by the square
    elif slow and dt >= number.LONG_PERIOD:
        kind, severity = "wrong_dt:slow", "warning"  # such a motion may be on purpose
    else:
        return []
    facts = {"dt": dt, "name": reading.names[j], "other": _other_units(dt)}
    facts |= {"speed": speed[j], "limit": limit[j]}
    facts |= {"unit": "m/s" if reading.slides[j] else "rad/s"}
    return [finding(kind, reading.names, reading.every, severity, **facts)]


def periods(reading):
    """Return the best other sample period."""
    dt, robot, least = reading.dt, reading.robot, clear_of_all(reading)
    special = (1e-3, 1 / dt**2) if dt >= number.LONG_PERIOD else ()
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
    if found is None:
        return None
    # Another period changes inertia against weight: torques without either look alike.
    moving = robot.pulled(np.zeros(3))
    rivals = [robot.fit(rest).evidence for rest in (moving, robot.entries - moving)]
    if max(rivals) - robot.now.evidence > found.log_odds - number.RIVAL:
        return None
    period = dt * found.change.period
    remedy = {"dt": float(f"{period:.6g}")}
    facts = {"dt": dt, "period": period, "other": _other_units(dt)}
    return replace(found, remedy=remedy, facts=facts)


def _other_units(dt):
    if dt < number.LONG_PERIOD:
        return ""
    unit = "milliseconds or " if dt < 100 else ""
    return f"; it looks like {unit}a rate in Hz: give {dt / 1e3:.6g} or {1 / dt:.6g}"
