"""Hypotheses on single joints: order, direction, zero and unit of their channels."""

from itertools import combinations, permutations

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import (
    Candidate,
    Hypothesis,
    every,
    of,
    score_of,
)
from sklearn_vbjfa.inspection._signals import Change
from sklearn_vbjfa.recording import listed_joints


def poor(reading):
    """Whether some torque is fitted badly enough to look for another reading."""
    return bool((reading.now.left > 2 * np.log(number.GOOD_FIT)).any())


def _best(reading, variants, least, moved):
    """Return the best of several changes whose squared errors fall by enough."""
    # least: fall that is asked for; moved: returns the joints that a change concerns.
    now, best = reading.now_in_few, None
    for change in variants:
        score = reading.tried(change, few=True)
        if score is None or score.fall(now) < least(moved(change)):
            continue
        if best is None or score.evidence > best[0].evidence:
            best = score, change
    if best is None:
        return None
    return _candidate(reading, best[1], moved(best[1]), len(variants), least)


def _candidate(reading, change, joints, variants, least, **values):
    """`Candidate` of a change, judged in all rows; None if errors do not fall."""
    score = reading.tried(change)
    if score is None or score.fall(reading.now) < least(joints):
        return None
    return Candidate(
        change=change,
        joints=tuple(int(j) for j in joints),
        log_odds=of(score, reading.now, variants),
        fall=score.fall(reading.now),
        values=values,
    )


def _clear(joints):
    """Fall of log squared errors that a change of some joints must bring."""
    return number.CLEAR_OF_JOINT * max(len(joints), 2)


def _evidence(reading, candidate):
    """Say how much better a reading is."""
    factor = np.exp(candidate.fall / reading.robot.joints.size)
    return (
        f"the squared torque errors fall by the factor {factor:.3g} (log odds "
        f"{candidate.log_odds:.0f})"
    )


# -- order -----------------------------------------------------------------------------


def _moved(change):
    order = change.torques if change.positions is None else change.positions
    return tuple(np.flatnonzero(order != np.arange(order.size)).tolist())


def _pairs(reading):
    """Pairs of joints whose torques, or positions, may be exchanged."""
    # All pairs if there are few; else those in which the torque of each joint follows
    # the motion of the other best, or both of which fit badly.
    joints = reading.few.joints
    pairs, most = list(combinations(range(joints.size), 2)), 2 * joints.size
    left = np.log(reading.few.crossed())
    own = np.diagonal(left)
    crossed = left + left.T - own - own[:, None]
    likely = sorted(pairs, key=lambda pair: crossed[pair])[:most]
    worst = sorted(pairs, key=lambda pair: -min(own[list(pair)]))[:most]
    return [tuple(joints[list(pair)]) for pair in dict.fromkeys([*likely, *worst])]


def exchanged(order, pair):
    """Return an order in which two places are exchanged."""
    order = np.array(order)
    order[list(pair)] = order[list(pair[::-1])]
    return order


def _torque_orders(reading):
    """Return the best order of torques."""
    joints, same = reading.few.joints, np.arange(reading.nv)
    left = np.log(reading.few.crossed())
    rows, columns = scipy.optimize.linear_sum_assignment(left - np.diagonal(left))
    order = same.copy()
    order[joints[rows]] = joints[columns]
    orders = [order, *(exchanged(same, pair) for pair in _pairs(reading))]
    changes = [Change(torques=x) for x in orders if (x != same).any()]
    return _best(reading, changes, _clear, _moved)


def _position_orders(reading):
    """Return the best exchange of two positions."""
    same, slides = np.arange(reading.nv), reading.slides
    pairs = [(a, b) for a, b in _pairs(reading) if slides[a] == slides[b]]
    changes = [Change(positions=exchanged(same, pair)) for pair in pairs]
    return _best(reading, changes, _clear, _moved)


def _joint_orders(reading):
    """Return the best order of joints, by swaps from the best of plain orders."""
    nv, same = reading.nv, np.arange(reading.nv)
    lost = np.median(reading.now_in_few.left) > 2 * np.log(number.NO_FIT)
    if lost and nv <= number.MOST_ORDERS:
        starts = [np.array(order) for order in permutations(range(nv))]
    else:
        shifts = {k % nv for k in range(-number.ROLLED, number.ROLLED + 1)}
        # Programs that do not know the order of the joints sort them by name.
        named = np.argsort(reading.names, kind="stable")
        starts = [np.roll(same, k) for k in sorted(shifts)]
        starts += [same[::-1], named, np.argsort(named)]
    best, order = _highest(reading, starts, reading.now_in_few.evidence, same)
    pairs = _pairs(reading)
    # Each swap puts at least one joint in its place.
    for _ in range(nv):
        tried = [exchanged(order, pair) for pair in pairs]
        better, other = _highest(reading, tried, best + number.RIVAL, None)
        if other is None:
            break
        best, order = better, other
    if (order == same).all():
        return None
    change = Change(positions=order, torques=order)
    return _candidate(reading, change, _moved(change), len(pairs), _clear)


def _highest(reading, orders, best, order):
    """Evidence and order of the best of some orders of joints, if it is above."""
    for other in orders:
        score = reading.tried(Change(positions=other, torques=other), few=True)
        if score is not None and score.evidence > best:
            best, order = score.evidence, other
    return best, order


def _say_order(what, other=""):
    def say(reading, candidate):
        names, joints = reading.names, candidate.joints
        evidence = _evidence(reading, candidate)
        if len(joints) == 2:
            return (
                f"The {what} of {names[joints[0]]} and {names[joints[1]]} appear to be "
                f"swapped{other}: the other way round {evidence}. Exchange the columns."
            )
        change = candidate.change
        order = change.torques if change.positions is None else change.positions
        listed = ", ".join(names[k] for k in np.argsort(order))
        return (
            f"The columns of {what} are in another order{other}: read as {listed} "
            f"{evidence}. Put them into the order of the model, {', '.join(names)}."
        )

    return say


def _several(reading):
    return poor(reading) and reading.few.joints.size > 1


# -- directions ------------------------------------------------------------------------


def _directions(of_torque):
    def propose(reading):
        changes = []
        for j in reading.few.joints:
            sign = np.where(np.arange(reading.nv) == j, -1.0, 1.0)
            changes.append(Change(factor=sign, scale=sign if of_torque else 1.0))
        return _best(reading, changes, _clear, _turned)

    return propose


def _turned(change):
    return tuple(np.flatnonzero(np.asarray(change.factor) < 0).tolist())


def _say_flipped(reading, candidate):
    (j,) = candidate.joints
    return (
        f"{reading.names[j]} turns the other way round in the log than in the model: "
        f"with its position and its torque times -1 "
        f"{_evidence(reading, candidate)}. Multiply both columns by -1, or turn the "
        "axis in the model."
    )


def _say_mirrored(reading, candidate):
    (j,) = candidate.joints
    return (
        f"The position of {reading.names[j]} has the wrong sign: with the other one "
        f"{_evidence(reading, candidate)}. Multiply it by -1."
    )


# -- signs of torques ------------------------------------------------------------------


def _signs(reading):
    """Return the torques whose signs are wrong: one, some, or all."""
    nv, robot, now = reading.nv, reading.robot, reading.now
    tau, whole = robot.signals.now, every(reading)

    def tried(wrong):
        fit = robot.fit(tau=tau * _negative(wrong, nv).scale)
        against = robot.joints[fit.power < -number.SURE]
        # A sign that friction contradicts is not a wrong one.
        return None if {*wrong} & {*against} else score_of(robot, fit)

    judged = robot.joints[robot.errors() < number.WORST].tolist()
    scores, seen = {(): now, whole: tried(whole)}, {}
    for start in ((), whole):
        gains = {}
        for j in judged:
            which = tuple(sorted({*start} ^ {j}))
            scores[which] = tried(which)
            if scores[which] is not None and scores[start] is not None:
                gains[j] = scores[which].evidence - scores[start].evidence
        turned = {j for j, gain in gains.items() if gain > number.DECISIVE}
        # Of joints that are not judged, one that is right says nothing.
        rest = {*start} & {*judged} if turned else {*start}
        which = tuple(sorted(rest ^ turned))
        if which not in scores:
            scores[which] = tried(which)
        seen[start] = {j for j, gain in gains.items() if abs(gain) > number.DECISIVE}
    scores = {which: score for which, score in scores.items() if score is not None}
    most = max(score.evidence for score in scores.values())
    near = [x for x, score in scores.items() if score.evidence > most - number.RIVAL]
    # That all signs are wrong is likelier than that those are right which do not show.
    best = whole if whole in near else min(near, key=len)
    if not best:
        return None
    hidden = [j for j in best if j not in seen[whole]] if best == whole else []
    return Candidate(
        change=_negative(best, nv),
        joints=best,
        log_odds=of(scores[best], now, nv if len(best) == 1 else 1),
        fall=scores[best].fall(now),
        values={"hidden": hidden if nv > 1 else []},
    )


def _negative(joints, nv):
    return Change(scale=np.where(np.isin(np.arange(nv), list(joints)), -1.0, 1.0))


def _say_sign(reading, candidate):
    names, joints, hidden = reading.names, candidate.joints, candidate.values["hidden"]
    many = len(joints) > 1
    also = (
        f" The sign of {listed_joints(names, hidden)} cannot be seen in this motion; "
        "as all that can be seen are wrong, it is taken to be wrong too."
        if hidden
        else ""
    )
    return (
        f"The torque{'s' if many else ''} of {listed_joints(names, joints)} "
        f"{'have' if many else 'has'} the wrong sign: with the other one friction, "
        f"weight and inertia agree with the description (log odds "
        f"{candidate.log_odds:.0f}).{also} Multiply {'them' if many else 'it'} by -1."
    )


def _gains(reading, candidate):
    """Factors of the torques that undo a fault, as an option."""
    scale = np.broadcast_to(candidate.change.scale, reading.nv)
    return {"gains": tuple(float(f"{x:.6g}") for x in scale)}


# -- zeros -----------------------------------------------------------------------------


def _zero(reading):
    """Return the best other zero of one joint."""
    changes = []
    for j in np.flatnonzero(~reading.slides):
        for angle in number.OFFSETS:
            changes.append(
                Change(offset=np.where(np.arange(reading.nv) == j, angle, 0))
            )
    found = _best(reading, changes, _clear_zero(reading), _shifted)
    return found and refined(reading, found)


def _clear_zero(reading):
    count = reading.robot.joints.size
    return lambda joints: max(number.CLEAR * count, _clear(joints))


def _shifted(change):
    return tuple(np.flatnonzero(change.offset).tolist())


def _say_zero(reading, candidate):
    (j,) = candidate.joints
    angle = np.rad2deg(candidate.change.offset[j])
    return (
        f"The zero of {reading.names[j]} appears to be off by about {-angle:.0f} "
        f"degrees: with {angle:+.0f} degrees added to its position "
        f"{_evidence(reading, candidate)}. Add them, or, if the robot is mounted in "
        "another way or carries a tool, correct the model."
    )


def _begins_at_zero(reading):
    # A log that begins at the zero of the description looks the same.
    q = reading.q
    return bool((np.abs(q[0]) <= number.AT_ZERO * np.ptp(q, axis=0)).all())


def _zeros(reading):
    """Return the zeros of all joints that fit best."""
    # Of joints whose zero does not matter, such as vertical ones, it stays.
    free = np.flatnonzero(~reading.slides)
    if not free.size:
        return None
    place, best = np.zeros(reading.nv), reading.now_in_few
    for j in [*free, *free]:
        for angle in number.ANGLES:
            tried = place + np.where(np.arange(reading.nv) == j, angle, 0.0)
            score = reading.tried(Change(offset=tried), few=True)
            if score is not None and score.evidence > best.evidence + number.RIVAL:
                best, place = score, tried
    place = _stepped(reading, place, free)
    offset = np.where(reading.slides, 0.0, (place + np.pi) % (2 * np.pi) - np.pi)
    moved = np.flatnonzero(np.abs(offset) > number.MOVED)
    if not moved.size:
        return None
    count = reading.robot.joints.size
    return _candidate(
        reading, Change(offset=offset), moved, 1, lambda joints: number.CLEAR * count
    )


def refined(reading, candidate):
    """Return a candidate whose offset of one joint is the best one nearby."""
    (j,) = candidate.joints
    offset = _stepped(reading, candidate.change.offset, [j])
    return (
        _candidate(
            reading,
            Change(offset=offset),
            (j,),
            reading.nv * len(number.OFFSETS),
            _clear_zero(reading),
        )
        or candidate
    )


def _stepped(reading, place, joints):
    """Move zeros (nv,) of some joints by Gauss-Newton steps."""
    best = reading.tried(Change(offset=place))
    for _ in range(number.PASSES):
        robot = reading.robot_at(Change(offset=place))
        step = robot.fit(
            columns=_slopes(robot, joints), deviation=number.STEP_OF_ZERO
        ).factors
        tried = place.copy()
        tried[list(joints)] += step
        score = reading.tried(Change(offset=tried))
        if score is None or score.evidence < best.evidence + 0.1:
            break
        best, place = score, tried
    return place


def _slopes(robot, joints):
    """Return derivatives (n, nv, m) of the described torques by the zeros of joints."""
    bodies, ends = robot.bodies, []
    for sign in (1.0, -1.0):
        for j in joints:
            offset = np.where(np.arange(bodies.nv) == j, sign * number.SLOPE, 0.0)
            states = Change(offset=offset).signals(robot.signals).states
            ends.append(bodies.torques(bodies.whole(states)))
    high, low = np.split(np.stack(ends, axis=-1), 2, axis=-1)
    return (high - low) / (2 * number.SLOPE)


def _say_zeros(reading, candidate):
    offset = candidate.change.offset
    values = ", ".join(f"{reading.names[j]} {offset[j]:+.2f}" for j in candidate.joints)
    return (
        "All positions begin at zero, and the torques require other zeros (log odds "
        f"{candidate.log_odds:.0f}): the encoders were set to zero at power-up. Add to "
        f"the positions, about [rad]: {values}."
    )


# -- units -----------------------------------------------------------------------------


def limits(model):
    """Lowest and highest positions of joints (nv,)."""
    # Pinocchio's "no limit" is the largest number there is.
    low = np.maximum(model.lowerPositionLimit, -1e6)
    return low, np.minimum(model.upperPositionLimit, 1e6)


def limited(model):
    """Which joints have limits, ndarray of shape (nv,), bool."""
    low, high = limits(model)
    return (high - low < number.LARGEST_TURN) & (high > low)


def beyond(model, q):
    """How far each joint moves beyond its limits [rad or m], ndarray of shape (nv,)."""
    low, high = limits(model)
    # Another zero of the joint or a nominal limit is no proof.
    margin = 0.125 * (high - low)
    outside = np.maximum(q.max(axis=0) - high, low - q.min(axis=0)) - margin
    turned = np.ptp(q, axis=0) - number.LARGEST_TURN
    return np.maximum(np.where(limited(model), outside, turned), 0.0)


def _units(reading):
    """Return positions in degrees or turns."""
    revolute, q, model = ~reading.slides, reading.q, reading.model
    out = beyond(model, q) * revolute
    far = (out > number.FAR_BEYOND) & limited(model)
    many = np.count_nonzero(out > 0.1) > 0.5 * np.count_nonzero(revolute)
    tried = []
    if far.any() or many:
        tried = [(revolute, np.pi / 180, "degrees", "deg")]
        if far.any() and not far[revolute].all():
            tried.append((far, np.pi / 180, "degrees", "deg"))
    elif not out.any():
        tried = [(revolute, 2 * np.pi, "turns", "rev")]
    found = []
    for joints, unit, called, short in tried:
        factor = np.where(joints, unit, 1.0)
        # Of a joint without limits any angle may be right.
        if (beyond(model, q * factor) * joints > 0).any():
            continue
        which, values = np.flatnonzero(joints), {"unit": called, "short": short}
        change = Change(factor=factor)
        score = reading.tried(change)
        if score is None:
            continue
        log_odds = of(score, reading.now, 1)
        # Limits that are exceeded by far are evidence as well.
        log_odds += 2 * number.DECISIVE if far.any() else 0.0
        fall = score.fall(reading.now)
        if not far.any() and fall < number.CLEAR * reading.robot.joints.size:
            continue
        values["name"] = f"position_{called}"
        found.append(
            Candidate(
                change=change,
                joints=tuple(which.tolist()),
                log_odds=log_odds,
                fall=fall,
                values=values,
            )
        )
    return max(found, key=lambda x: x.log_odds, default=None)


def _say_unit(reading, candidate):
    q, which, called = reading.q, candidate.joints, candidate.values["unit"]
    j = max(which, key=lambda k: np.ptp(q[:, k]))
    whole = len(which) == np.count_nonzero(~reading.slides)
    column = "{i}" if whole else str(j + 1)
    return (
        f"The positions of {listed_joints(reading.names, which)} look like {called}: "
        f"{reading.names[j]} runs from {q[:, j].min():.4g} to {q[:, j].max():.4g}, and "
        f"in {called} they explain the torques better (log odds "
        f"{candidate.log_odds:.0f}). Give the mapping "
        f'"q=q{column} [{candidate.values["short"]}]" with the names of your columns '
        "(columns=, or --columns)."
    )


HYPOTHESES = (
    Hypothesis(
        name="position_unit",
        severity="error",
        applies=lambda reading: not reading.slides.all(),
        propose=_units,
        message=_say_unit,
    ),
    Hypothesis(
        name="position_zeros",
        severity="error",
        applies=lambda reading: not reading.commanded and _begins_at_zero(reading),
        propose=_zeros,
        message=_say_zeros,
    ),
    Hypothesis(
        name="swapped_torques",
        severity="error",
        applies=_several,
        propose=_torque_orders,
        message=_say_order("torques", " (or their positions)"),
    ),
    Hypothesis(
        name="swapped_positions",
        severity="error",
        applies=_several,
        propose=_position_orders,
        message=_say_order("positions", " (or their torques)"),
    ),
    Hypothesis(
        name="swapped_joints",
        severity="error",
        applies=_several,
        propose=_joint_orders,
        message=_say_order("positions and torques"),
    ),
    Hypothesis(
        name="flipped_joint",
        severity="error",
        applies=poor,
        propose=_directions(of_torque=True),
        message=_say_flipped,
    ),
    Hypothesis(
        name="position_sign",
        severity="error",
        applies=poor,
        propose=_directions(of_torque=False),
        message=_say_mirrored,
    ),
    Hypothesis(
        name="torque_sign",
        severity="error",
        applies=lambda reading: True,
        propose=_signs,
        message=_say_sign,
        remedy=_gains,
    ),
    # A doubt: another mounting or tool looks the same, with a wrong geometry only.
    Hypothesis(
        name="position_zero",
        severity="doubt",
        applies=poor,
        propose=_zero,
        message=_say_zero,
    ),
)
