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
    climb,
    judge,
    most_likely,
    most_probable,
    refine,
    times,
)
from sklearn_vbjfa.inspection._sentences import finding
from sklearn_vbjfa.inspection._torques import other_robot
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.recording import listed_joints


def orders(reading, what):
    """Return the best order of some channels, by exchanges from the best start."""
    identity, joints, names = np.arange(reading.nv), reading.robot.joints, reading.names
    starts, moves = [], []
    if what == "torques":
        cost = reading.cross_scores
        rows, columns = scipy.optimize.linear_sum_assignment(cost - np.diagonal(cost))
        starts = [identity.copy()]
        starts[0][joints[rows]] = joints[columns]
    elif what == "positions and torques":
        shifts = range(-number.SHIFTS, number.SHIFTS + 1)
        starts = [*(np.roll(identity, k) for k in shifts), identity[::-1]]
        starts += usual_orders(reading)
    for i, j in combinations(joints.tolist(), 2):
        order = identity.copy()
        order[[i, j]] = j, i
        moves.append(reordered(order, what))
    change = climb(reading, moves, [reordered(order, what) for order in starts])
    if not change.joints:
        return None
    moved, comma = list(change.joints), " and " if len(change.joints) == 2 else ", "
    rows = change.torques if change.positions is None else change.positions
    facts = {"what": what, "who": comma.join(names[j] for j in moved)}
    facts["held"] = comma.join(names[k] for k in rows.argmax(axis=0)[moved])
    return judge(reading, change, variants=len(moves), facts=facts)


def reordered(order, what="positions and torques"):
    """Return the change that reorders channels by an order (nv,)."""
    rows = np.eye(order.size)[order]
    return Change(**{name: rows for name in what.split(" and ")})


def usual_orders(reading):
    """Return common orders of joints (nv,) that differ, and their inverses."""
    # By name, Pinocchio's (depth first, branches by name), or pairs of limbs exchanged.
    parents, names = list(reading.model.parents)[1:], reading.names

    def branch(joint):
        children = [k for k, parent in enumerate(parents, 1) if parent == joint]
        children.sort(key=lambda k: names[k - 1])
        return [x for k in children for x in (k - 1, *branch(k))]

    usual = [np.argsort(names, kind="stable"), np.array(branch(0))]
    for joint in set(parents):
        limbs = [[k, *branch(k + 1)] for k, x in enumerate(parents) if x == joint]
        for size in set(map(len, limbs)):
            same = np.array([x for x in limbs if len(x) == size])
            usual.append(np.arange(reading.nv))
            usual[-1][same] = same[np.minimum(np.arange(len(same)) ^ 1, len(same) - 1)]
    orders = np.unique([x for y in usual for x in (y, np.argsort(y))], axis=0)
    return [x for x in orders if (np.diff(x) < 0).any()]


def flipped(reading, torques):
    """Return joints whose positions, and optionally torques, have a wrong sign."""

    def negative(joints):
        sign = times(reading.nv, -1.0, joints)
        return Change(positions=sign, torques=sign if torques else None)

    changes = [negative(j) for j in reading.robot.joints]
    return most_likely(reading, [*changes, climb(reading, changes, [negative(None)])])


def coupled_axes(reading):
    """Return the joint whose position contains that of its parent or grandparent."""
    changes, identity, parents = {}, np.eye(reading.nv), list(reading.model.parents)
    slides = reading.slides
    for j in reading.robot.joints.tolist():
        ancestors = parents[j + 1], parents[parents[j + 1]]
        same_kind = [i - 1 for i in ancestors if i and slides[i - 1] == slides[j]]
        for i, sign in product(same_kind, (1.0, -1.0)):
            positions = identity.copy()
            positions[j, i] = -sign
            # Torques of the joints, or of the coupled axes (virtual work).
            for torques in (None, np.linalg.inv(positions).T):
                change = Change(positions=positions, torques=torques)
                changes[change] = j, i, "-+" if sign > 0 else "+-"
    best = most_likely(reading, changes)
    if best is None:
        return None
    j, i, (minus, plus) = changes[best.change]
    # Motors that act on two joints share torques, whatever the encoders measure.
    shared_torques = _fit_shared_torques(reading, best.change, j, i)
    if best.fall - shared_torques.fall(reading.robot.baseline) < clear(best.change):
        return None
    facts = {"name": reading.names[j], "other": reading.names[i], "minus": minus}
    torque = ", and the torque of {other} by that of {other} {plus} that of {name}"
    is_shared = best.change.torques is not None
    facts["also"] = torque.format(plus=plus, **facts) * is_shared
    return replace(best, joints=(j,), facts=facts)


def _fit_shared_torques(reading, change, j, i):
    """Fit the unchanged log, with shared torques, friction and rotor of two joints."""
    robot, nv, signals = reading.robot, reading.nv, change.signals(reading.signals)
    axis = signals.states[:, nv + j], signals.states[:, 2 * nv + j], signals.sign[:, j]
    torques = np.zeros((len(axis[0]), nv, 10))
    for first, joint, other in ((0, j, i), (5, i, j)):
        columns = *axis, robot.described[:, joint], robot.signals.tau[:, other]
        size = np.sqrt((robot.signals.tau[:, joint] ** 2).mean())
        for k, x in enumerate(columns, start=first):
            # A link without mass has no described torque.
            torques[:, joint, k] = size * x / (np.sqrt((x**2).mean()) or 1.0)
    return robot.fit(columns=torques, deviation=number.WIDE)


# Units of angles, with their symbols and factors to that of the positions.
_UNITS = ("", "", 1.0), ("degrees", "deg", np.pi / 180), ("turns", "rev", 2 * np.pi)


def misread_commands(reading):
    """Return commands whose unit, order or direction differs from the positions."""
    if reading.feedback is None or reading.signals is None:
        return None
    joints, diagonal = np.array(reading.every), np.eye(reading.nv, dtype=bool)
    factors = np.array([np.where(reading.slides, 1.0, x) for *_, x in _UNITS])
    factors = np.vstack([factors, -factors])
    loss = np.log(np.maximum(_unexplained(reading, factors), number.LEAST_NOISE))
    changes = (factors < 0) + 1.0 * (np.abs(factors) != 1)
    cost = loss + number.CLEAR_OF_JOINT * (changes[:, :, None] + ~diagonal)
    # Robots may not follow: changed commands must also be far better than none.
    cost[0][diagonal] = np.minimum(cost[0][diagonal], 0.0)
    _, order = scipy.optimize.linear_sum_assignment(cost.min(axis=0))
    best = cost.argmin(axis=0)[joints, order]
    tracking = loss[:, joints, joints]
    # Robots that barely follow have the unit of the others if it is far more probable.
    unit = (best % len(_UNITS)).max()
    far = tracking[0] - tracking[unit] > number.DECISIVE
    faults = {"command_unit": far | (best % len(_UNITS) > 0)}
    faults["swapped_commands"] = order != joints
    faults["command_sign"] = factors[best, joints] < 0
    # Beyond the resonance of soft gains, positions oppose right commands.
    poor = np.ones(reading.nv, dtype=bool)
    if not reading.is_uninformative():
        least = 2 * np.log(number.GOOD_FIT)
        poor[reading.robot.joints] = reading.robot.baseline.loss > least
    kind = next((x for x, wrong in faults.items() if (wrong & poor).any()), None)
    if kind is None:
        return None
    moved = np.flatnonzero(faults[kind])
    fall = np.exp((tracking[0] - loss[best, joints, order])[moved].mean())
    text = f"squared tracking errors fall by the factor {fall:.3g}"
    facts = {"evidence": text, "what": "commands (q_desired)", "unit": _UNITS[unit][0]}
    facts["held"] = listed_joints(reading.names, order[moved])
    facts["given"] = unit_remedy(reading, "q_desired", _UNITS[unit][1], moved)
    joints = tuple(moved.tolist())
    return Proposal(joints=joints, log_odds=np.inf, kind=kind, facts=facts)


def _unexplained(reading, factors):
    """Share of each position's variance that each command leaves, (m, nv, nv)."""
    # factors (m, nv): of all commands, for each position.
    (kp, kd), signals = reading.feedback, reading.signals
    q, v, _ = np.split(signals.states, 3, axis=1)
    command = q + (signals.tau + kd * v) / np.where(kp > 0, kp, np.inf)
    error = factors[:, None, :, None] * command[:, None] - q[:, :, None]
    error -= error.mean(axis=1, keepdims=True)
    # Positions follow late, to first order by their speed times the delay.
    v, variance = v[:, :, None], np.maximum(q.var(axis=0), 1e-300)[:, None]
    late = (error * v).mean(axis=1) / np.maximum((v**2).mean(axis=0), 1e-300)
    error -= np.clip(late, 0.0, number.LATE_COMMAND)[:, None] * v
    return (error**2).mean(axis=1) / variance


def zeros(reading, few):
    """Return the best zeros of all joints, or corrections of few of them."""
    # Zeros that do not affect the torques, such as of vertical axes, are kept.
    rotary, nv = np.flatnonzero(~reading.slides), reading.nv

    def moved_by(x, j):
        return Change(offset=x * np.eye(nv)[j])

    def refined(start, joints):
        steps = [functools.partial(moved_by, j=j) for j in joints]
        start, errors = refine(reading, start, steps)
        return start.offset + np.zeros(nv), errors

    moves = [moved_by(x, j) for j, x in product(rotary, number.ANGLES)]
    if not few:
        # Zeros of neighbouring joints compensate each other.
        pairs = product(pairwise(rotary), number.ANGLES, number.ANGLES)
        moves += [moved_by(x, j).then(moved_by(y, k)) for (j, k), x, y in pairs]
    step = number.CLEAR_OF_JOINT if few else number.SETTLED
    offset, errors = refined(climb(reading, moves, step=step), rotary)
    if few:
        # Smaller corrections may be an effect, a different link, or not identifiable.
        least = number.POSED_ZERO if reading.poses else number.FAR_ZERO
        shown = rotary[np.abs(offset[rotary]) > np.maximum(least, 3 * errors)]
        offset = np.where(np.isin(reading.every, shown), offset, 0.0)
        offset, _ = refined(Change(offset=offset), shown)
    offset = np.where(reading.slides, 0.0, (offset + np.pi) % (2 * np.pi) - np.pi)
    moved = tuple(np.flatnonzero(np.abs(offset) > number.LEAST_ZERO).tolist())
    if not moved:
        return None
    facts = {"values": ", ".join(f"{reading.names[j]} {offset[j]:+.2f}" for j in moved)}
    required = clear_of_all(reading)
    if few:
        # Each zero must bring the fall that a single one must bring.
        required = max(required, number.CLEAR_OF_JOINT) * len(moved)
    variants = len(moves) ** (few * len(moved))
    options = {"joints": moved, "variants": variants, "facts": facts}
    best = judge(reading, Change(offset=offset), required, **options)
    # As bodies are fitted as well, errors fall only a little if friction is large.
    if best is None or best.clear or best.fall < 0.5 * number.CLEAR:
        return best
    far = reading.robot.surpasses(best.log_odds)
    return replace(best, clear=far and not other_robot(reading.apply(best.change)))


def _limits(model):
    """Return lowest and highest positions (nv,), and which joints have limits."""
    # Pinocchio's "no limit" is the largest float.
    low = np.maximum(model.lowerPositionLimit, -1e6)
    high = np.minimum(model.upperPositionLimit, 1e6)
    return low, high, (high - low < number.LARGEST_TURN) & (high > low)


def _excess(model, q):
    """Return how far each joint moves beyond its limits [rad or m], (nv,)."""
    low, high, limited = _limits(model)
    # The margin allows for another zero of the joint or a nominal limit.
    margin = 0.125 * (high - low)
    excess = np.maximum(q.max(axis=0) - high, low - q.min(axis=0)) - margin
    turns = np.ptp(q, axis=0) - number.LARGEST_TURN
    return np.maximum(np.where(limited, excess, turns), 0.0)


def _outside(model, q):
    """Return which joints are beyond their limits, whatever the zeros of some."""
    outside, (low, high, limited) = _excess(model, q) > 0, _limits(model)
    if 3 * np.count_nonzero(outside) >= outside.size:
        return outside
    return outside & (np.ptp(q, axis=0) > limited * (high - low))


def units(reading):
    """Return positions in degrees, turns, or motor positions."""
    revolute, q, model = ~reading.slides, reading.q, reading.model
    beyond = _excess(model, q) * revolute
    far = (beyond > number.FAR_BEYOND) & _limits(model)[2]
    many = np.count_nonzero(beyond > 0.1) > 0.5 * np.count_nonzero(revolute)
    _, degrees, turns = _UNITS
    options = [(revolute, *degrees)] if reading.poor else []
    if far.any() or many:
        options = [(x, *degrees) for x in (revolute, far) if x.any()]
    elif not beyond.any() and (_speeds(reading) < _too_fast(model)).all():
        options.append((revolute, *turns))
    # Positions far beyond a limit, or beyond those of most joints, are evidence, too.
    extra = 2 * number.DECISIVE * (far.any() or many)
    required, matches = -np.inf if far.any() else clear_of_all(reading), []
    for joints, unit, symbol, factor in options:
        scaling = functools.partial(_scaling, np.log(factor), np.flatnonzero(joints))
        change = scaling(reading.nv)
        # The converted positions must be within the limits.
        if (_outside(model, q @ change.positions) & joints).any():
            continue
        match = judge(reading, change, required, kind=f"position_{unit}")
        sizes = reading.robot_after(change).sizes
        if reading.gains is None and np.nanquantile(sizes, 1 / 3) < 1 / number.SCALE:
            # Positions and torques of motors have the power of those of the joints.
            change = scaling(reading.nv, geared=True)
            geared = judge(reading, change, required, kind="position_unit:motor")
            match = most_probable([match, geared])
        if match is None:
            continue
        j = max(match.joints, key=lambda k: np.ptp(q[:, k]))
        facts = {"unit": unit, "given": unit_remedy(reading, "q", symbol, match.joints)}
        facts |= {"name": reading.names[j], "low": q[:, j].min(), "high": q[:, j].max()}
        matches.append(replace(match, log_odds=match.log_odds + extra, facts=facts))
    best = most_probable(matches)
    if best is None or best.log_odds + number.PRIOR < number.DECISIVE:
        return best
    return _with_ratios(reading, best) or (best if far.any() else None)


def unit_remedy(reading, channel, symbol, joints):
    """Return how to give the unit of a channel of some joints."""
    same_kind = reading.slides == reading.slides[joints[0]]
    if reading.alone or len(joints) < np.count_nonzero(same_kind):
        name = f"{channel}{joints[0] + 1} [{symbol}]"
        return f"add the unit to their names in the header: {name!r}"
    column = f"{channel}={channel}" + ("_{joint}" if reading.named else "{i}")
    return f'give columns="{column} [{symbol}]" with the names of your columns'


def _with_ratios(reading, best):
    """Return positions in a unit as motor positions if joints have other factors."""
    joints, change, after = list(best.joints), best.change, reading.apply(best.change)
    geared = change.torques is not None
    best = replace(best, change=None) if geared else best
    scaling = functools.partial(_scaling, nv=reading.nv, geared=geared)
    # With another zero, ratios would be wrong.
    if after.is_uninformative() or _excess(reading.model, after.q)[joints].any():
        return best
    starts = [scaling(x, joints) for x in number.RATIOS]
    moves = [scaling(x, j) for x, j in product(number.RATIOS, joints)]
    ratios = climb(after, moves, starts, number.SETTLED)
    steps = [functools.partial(scaling, j=j) for j in joints]
    ratios, errors = refine(after, scaling(0.0, joints).then(ratios), steps)
    fit, known = judge(after, ratios, clear_of_all(after)), errors < number.KNOWN_RATIO
    if fit is None or not fit.clear or fit.log_odds + number.PRIOR < number.DECISIVE:
        return best
    determined = [j for j, precise in zip(joints, known) if precise]
    if not determined:
        # Neither that unit nor a factor, for instance if the sample period is wrong.
        return None
    determined = _ratios(reading, change.then(ratios), determined, errors[known])
    facts = dict(best.facts) | {"each": determined}
    facts["power"] = ", and multiply their torques by them" * geared
    return replace(best, kind="position_unit", change=None, facts=facts)


def gear_factor(reading):
    """Return the joint whose position, or position and torque, has a gear factor."""
    # Factors of prismatic positions are not distinguishable from other masses.
    robot, scaling = reading.robot, functools.partial(_scaling, nv=reading.nv)
    revolute = [int(j) for j in robot.joints if not reading.slides[j]]
    # A wrong gear ratio preserves power; otherwise only the position is wrong.
    grid = list(product(number.RATIOS, revolute, (False, True)))
    changes = {scaling(x, j, geared=geared): (x, j) for x, j, geared in grid}
    best = most_likely(reading, changes) if reading.poor else None
    starts = [changes[best.change]] if best else []
    # Factors near one are estimated together, and the clearest one is tested.
    steps = [functools.partial(scaling, j=j) for j in revolute]
    near, errors = refine(reading, scaling(0.0, revolute), steps)
    logs = np.log(np.diagonal(near.positions)[revolute])
    clearest = max(zip(np.abs(logs) / errors, logs, revolute), default=(0.0,))
    starts += [clearest[1:]] if clearest[0] > 3 else []
    found = []
    for (x, j), geared in product(starts, (False, True)):
        step = functools.partial(scaling, j=j, geared=geared)
        change, (error,) = refine(reading, step(x), [step])
        facts = {"power": ", and multiply the torque by it" * geared}
        facts["each"] = _ratios(reading, change, [j], [error])
        if abs(np.log(change.positions[j, j])) > max(number.LEAST_GEAR, 3 * error):
            found.append(judge(reading, change, variants=len(changes), facts=facts))
    best = most_probable(found)
    if best is None:
        return None
    # Other masses, springs, losses, or wrong gains of torques may have the same effect.
    pair, gains = (robot, reading.robot_after(best.change)), np.eye(reading.nv)
    fits = [x.fit(columns=x.described[:, :, None] * gains, deviation=1.0) for x in pair]
    odds = best.log_odds - robot.unmodelled
    odds = min(odds, fits[1].evidence - fits[0].evidence)
    explains_all = pair[1].baseline.loss.max() < 2 * np.log(number.SAME)
    certain = sum((odds > number.FAR_ODDS, best.clear, explains_all)) > 1
    return replace(best, clear=True) if certain and odds > number.RIVAL else None


def _scaling(x, j, nv, geared=False):
    """Return the change that scales joints' positions, or gear ratios, by exp(x)."""
    torques = times(nv, np.exp(-x), j) if geared else None
    return Change(positions=times(nv, np.exp(x), j), torques=torques)


def _ratios(reading, change, joints, errors):
    """List the logged position per radian or metre of each joint, with its error."""
    ratios = 1 / np.diagonal(change.positions)[joints]
    each = zip(joints, ratios, number.INTERVAL * np.array(errors) * ratios)
    return ", ".join(f"{reading.names[j]} {x:.3g} ± {y:.1g}" for j, x, y in each)


def encoder_counts(reading):
    """Return positions that are neither in radians nor in degrees."""
    model, names, q, revolute = reading.model, reading.names, reading.q, ~reading.slides
    degrees = np.where(revolute, np.pi / 180, 1.0)
    far, as_degrees = _excess(model, q) > number.FAR_BEYOND, _excess(model, q * degrees)
    if 3 * np.count_nonzero(far) > 2 * far.size:
        # Among other degrees, some may have another zero.
        as_degrees = as_degrees * _outside(model, q * degrees)
    travel = np.ptp(q, axis=0)
    whole = (q == np.round(q)).all(axis=0) & (travel >= number.FEWEST_COUNTS)
    # Whole numbers within the limits in degrees are degrees.
    whole &= ~(far & (as_degrees == 0)) | (travel > 720)
    # A continuous joint may turn far, but not at an implausible speed even in degrees.
    fast = _speeds(reading) * degrees > _too_fast(model)
    fast &= travel * degrees > number.LARGEST_TURN
    joints = np.flatnonzero((far & (as_degrees > 0)) | whole | fast)
    if not joints.size:
        return None
    j = max(joints, key=lambda k: travel[k])
    facts = {"name": names[j], "low": q[:, j].min(), "high": q[:, j].max()}
    facts |= {"numbers": "whole numbers" if whole[j] else "values"}
    # No log odds are computed: regressors of such angles are meaningless.
    angles = "radians or degrees", "encoder counts, mrad", "rad"
    texts = angles if revolute[j] else ("metres", "millimetres or encoder counts", "m")
    facts |= dict(zip(("units", "guess", "unit"), texts))
    return Proposal(joints=tuple(joints), log_odds=np.inf, facts=facts)


def _too_fast(model):
    """Return implausible speeds (nv,) [rad/s or m/s]: five times the (usual) limit."""
    limit = np.asarray(model.velocityLimit, dtype=float)
    usual = np.where(is_prismatic(model), number.FASTEST_SLIDE, number.FASTEST_TURN)
    is_given = (limit > 0) & (limit < 1e3)
    return number.TOO_FAST * np.where(is_given, limit, usual)


def _speeds(reading):
    """Return the 99.5 % quantile of each joint's speed, ndarray of shape (nv,)."""
    width, q = min(number.SPEED_SAMPLES, len(reading.q) - 1), reading.q
    travel = [np.abs(q[p][width:] - q[p][:-width]) for p in reading.parts]
    return np.quantile(np.concatenate(travel), 0.995, axis=0) / (width * reading.dt)


def implausible_speed(reading):
    """Report a sample period at which the motion is implausibly fast or slow."""
    speed, limit, dt = _speeds(reading), _too_fast(reading.model), reading.dt
    j = int(np.argmax(speed / limit))
    is_slow = number.TOO_FAST * speed[j] < number.TOO_SLOW * limit[j]
    if speed[j] > limit[j]:
        kind, severity = "wrong_dt:fast", "error"
    elif is_slow and not reading.poses and dt >= number.LONG_PERIOD:
        kind, severity = "wrong_dt:slow", "warning"  # it may be intentional
    else:
        return []
    facts = {"dt": dt, "name": reading.names[j], "speed": speed[j], "limit": limit[j]}
    facts |= {"unit": "m/s" if reading.slides[j] else "rad/s"}
    return [finding(kind, reading.names, reading.every, severity, **facts)]


def periods(reading):
    """Return the best other sample period."""
    dt, robot, required = reading.dt, reading.robot, clear_of_all(reading)
    # A rate in Hz is the inverse of a period.
    factors = [1 / dt**2] if dt >= number.LONG_PERIOD else []
    factors += [*number.PERIODS, *(1 / x for x in number.PERIODS)]
    least = number.TOO_FAST * (_speeds(reading) / _too_fast(reading.model)).max()
    changes = [Change(period=x) for x in factors if least <= number.PLAUSIBLE * x]
    usual = min(changes, key=reading.score, default=Change())
    # Bodies absorb a small deviation of a single joint, but not of several.
    near, (error,) = refine(reading, usual, [lambda x: Change(period=np.exp(x))])
    (least, most), deviation = number.NEAR_PERIODS, abs(np.log(near.period))
    candidates = (near if deviation > max(least, 3 * error) else Change()), usual
    joints = {"joints": reading.every}
    proposal, usual = (judge(reading, x, required, **joints) for x in candidates)
    if usual and usual.log_odds > getattr(proposal, "log_odds", 0.0) - number.RIVAL:
        proposal = usual
    if not (proposal and proposal.clear):
        return None
    # The weight alone and springs have a similar effect.
    weight_only = robot.fit(robot.regressor - robot.floating.regressor)
    least = weight_only.evidence - robot.baseline.evidence + number.FAR_ODDS
    if proposal.log_odds < max(least, robot.springs + number.RIVAL):
        return None
    period = dt * proposal.change.period
    remedy, facts = {"dt": float(f"{period:.6g}")}, {"dt": dt, "period": period}
    severity = "warning" if deviation < most else ""
    return replace(proposal, severity=severity, remedy=remedy, facts=facts)
