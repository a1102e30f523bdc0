"""Changes of torques: signs, size, noise; torques that nobody measured."""

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import (
    Change,
    Proposal,
    judged,
    most_probable,
    stepped,
    times,
)
from sklearn_vbjfa.inspection._sentences import percent
from sklearn_vbjfa.recording import listed_joints

# Torque in N m is this many times a number in the unit.
_UNITS = {
    "kgf m": 9.80665,
    "lbf ft": 1.35582,
    "lbf in": 0.112985,
    "kgf cm": 0.0980665,
    "N cm": 0.01,
    "ozf in": 0.00706155,
    "N mm or mN m": 0.001,
    "gf cm": 9.80665e-5,
}

# -- signs -----------------------------------------------------------------------------


def signs(reading):
    """Return the torques whose signs are wrong: one, some, or all."""
    robot, nv, tau = reading.robot, reading.nv, reading.robot.signals.tau
    judge = robot.joints[robot.errors() < number.WORST].tolist()
    if not judge:
        return None
    # Joint by joint, with separate bodies; those that this leaves open together.
    gain = {j: _of_other_sign(robot, j) for j in judge}
    turned = {j for j in judge if gain[j] > number.DECISIVE}
    unclear = {j for j in judge if abs(gain[j]) <= number.DECISIVE}
    sets = [(), turned, *(turned | {j} for j in unclear), turned | unclear]
    scores = {}
    for wrong in dict.fromkeys(map(frozenset, sets)):
        fit = robot.fit(tau=tau @ times(nv, -1.0, list(wrong)), joints=judge)
        against = {j for j, power in zip(judge, fit.power) if power < -number.SURE}
        # A sign that friction contradicts is not a wrong one.
        if not against & wrong:
            scores[wrong] = fit
    now = scores[frozenset()]
    most = max(x.evidence for x in scores.values())
    near = [x for x, one in scores.items() if one.evidence > most - number.RIVAL]
    # That all signs are wrong is likelier than that those are right which do not show.
    every = frozenset(judge)
    best = every if every in near else min(near, key=len)
    # With noise that is correlated for long, few rows decide, and badly.
    if not best or scores[best].fall(now) < -number.CLEAR:
        return None
    # What balances a single joint is likelier a spring.
    springs = robot.with_springs(judge) if len(best) == 1 else -np.inf
    if springs > scores[best].evidence - number.DECISIVE:
        return None
    # Joints that are explained too badly to be judged may say that theirs is right.
    others = [j for j in robot.joints.tolist() if j not in judge]
    all_wrong = sum(_of_other_sign(robot, j) for j in others) >= -number.RIVAL
    joints = reading.every if best == every and all_wrong else tuple(sorted(best))
    hidden = [j for j in joints if j not in turned] if joints == reading.every else []
    hidden = listed_joints(reading.names, hidden) if nv > 1 else ""
    also = f" As all that show are wrong, so is the sign of {hidden}." if hidden else ""
    signs = times(nv, -1.0, list(joints))
    return Proposal(
        change=Change(torques=signs),
        joints=joints,
        log_odds=scores[best].evidence - now.evidence - np.log(nv) * (len(best) == 1),
        fall=scores[best].fall(now),
        remedy={"gains": tuple(np.diagonal(signs).tolist())},
        facts={"also": also},
    )


def _of_other_sign(robot, j):
    """Return what the other sign of one torque gains, with separate bodies."""
    tau = robot.signals.tau
    return robot.fit(tau=-tau, joints=[j]).evidence - robot.fit(joints=[j]).evidence


# -- size ------------------------------------------------------------------------------


def torque_factors(robot, alike):
    """Return factors of torques against the described ones, and their errors."""
    # alike: one for all joints; factors that are not shown stay as sizes say.
    nv, sizes = robot.bodies.nv, robot.sizes
    fine = np.isfinite(sizes) & (sizes > 0)
    factors, columns = np.where(fine, sizes, 1.0), robot.described[:, :, None]
    if alike:
        fine &= np.isin(np.arange(nv), robot.joints)
        factors = np.full(nv, np.median(sizes[fine]) if fine.any() else 1.0)
    else:
        columns = columns * np.eye(nv)
        for j in robot.joints:
            # Friction adds to sizes.
            rows = robot.rows[j]
            X = np.column_stack([robot.described[:, j], robot.plain(j)])[rows]
            load = np.linalg.lstsq(X, robot.signals.tau[rows, j])[0][0]
            factors[j] = load if load > 0 else factors[j]
    for _ in range(number.PASSES):
        tau = robot.signals.tau / factors
        fit = robot.fit(tau=tau, mean=np.zeros_like(tau), columns=columns)
        more, error = fit.factors, number.INTERVAL * fit.errors
        # Of joints that the masses barely load, nothing is shown.
        known = (more > 2 * error) & (error < 1.0)
        step = np.where(known | alike, more, 1.0)
        factors = factors * step
        if step.min() <= 0 or np.abs(np.log(step)).max() < number.SETTLED:
            break
    return factors, error, known, more > error


def scaled(reading):
    """Return all torques over a factor against the described ones."""
    factors, error, known, _ = torque_factors(reading.robot, alike=True)
    factor, error = float(factors[0]), float(error[0])
    least = number.COMMANDED if reading.commanded else number.SCALE
    if not known or factor <= 0 or 1 / least < factor < least:
        return None
    low, high = factor * np.exp([-error, error])
    units, robot = _units_inside(factor, error), reading.robot
    facts = {"factor": factor, "low": low, "high": high, "gain": 1 / factor}
    facts["inside"] = f" ({units} would be inside)" if units else ""
    facts["unknown"] = ', or gains="unknown"' if reading.nv > 1 else ""
    facts["numbers"] = reading.drive.numbers if reading.commanded else ""
    return Proposal(
        change=Change(torques=times(reading.nv, 1 / factor)),
        joints=reading.every,
        log_odds=robot.fit(scale=factor).evidence - robot.now.evidence,
        kind="gear_factor:commanded" if reading.commanded else "",
        value=factor,
        facts=facts,
    )


def _units_inside(factor, error):
    """Units that a factor of torques, with its error [log], may be; none if unknown."""
    near = (name for name, x in _UNITS.items() if abs(np.log(factor * x)) < error < 1)
    return " or ".join(near)


def scaled_each(reading):
    """Return torques of which one has another factor than the rest, or all have."""
    factors, error, known, seen = torque_factors(reading.robot, alike=False)
    # Far from those of others, a factor may be uncertain; what friction or a rotor adds
    # to a torque does not make it far too small. A description is wrong by less,
    # and a joint that it explains badly is no evidence.
    joints = reading.robot.joints
    logs = np.log(factors[joints])
    others = [np.delete(logs, k) for k in range(logs.size)]
    middle = np.array([np.median(x) if x.size else 0.0 for x in others])
    off, single = logs - middle, np.log(number.SINGLE)
    limits = np.where(known[joints], 2 * np.log(number.SCALE), single)
    away = (off < -limits) | (off > limits) & seen[joints]
    least = np.where(np.abs(off) > single, -np.inf, number.CLEAR_OF_JOINT)
    far = list(zip(joints[away].tolist(), least[away]))
    # What is not shown is as large as others are.
    factors[joints] = np.where(seen[joints], factors[joints], np.exp(off))
    found = [_scaled_one(reading, j, factors[j], error[j], x) for j, x in far]
    rest = known & ~np.isin(np.arange(known.size), joints[away])
    logs = np.sort(np.log(factors[rest]))
    # The factors of many hold two that are off by chance.
    most = logs[1:-1] if logs.size > 4 else logs
    if logs.size > 1 and np.ptp(most) > np.log(number.SCALE):
        factors = np.where(known, factors, np.exp(logs.mean()))
        change = Change(torques=np.diag(1 / factors))
        each = [f"{reading.names[j]} {factors[j]:.2g}" for j in np.flatnonzero(known)]
        facts = {"each": ", ".join(each)}
        args = {"joints": reading.every, "facts": facts}
        found.append(judged(reading, change, number.CLEAR * reading.nv, **args))
    return most_probable(found)


def _scaled_one(reading, j, factor, error, least):
    """Return the torque of a joint over a factor against the described one."""
    change = Change(torques=times(reading.nv, 1 / factor, j))
    step = [lambda x: Change(torques=times(reading.nv, np.exp(x), j))]
    change, _ = stepped(reading, change, step)
    factor = 1 / change.torques[j, j]
    # No error: a description with invented inertias looks the same.
    units = _units_inside(factor, error)
    units = units or "torque of the motor, a current, or another unit"
    facts = {"factor": factor, "ratio": 1 / factor, "units": units}
    args = {"variants": reading.nv, "kind": "gear_factor", "facts": facts}
    return judged(reading, change, least, **args)


def beyond_limits(reading):
    """Return torques that are many times the limits of the description."""
    limit = np.asarray(reading.model.effortLimit, dtype=float)
    known = (limit > 0) & (limit < number.NO_LIMIT)
    most = np.quantile(np.abs(reading.tau), 0.995, axis=0)[known] / limit[known]
    # Limits that are all alike are invented.
    alike = np.unique(limit[known]).size < 2
    if alike or np.median(most) < number.BEYOND_LIMITS:
        return None
    return Proposal(
        joints=tuple(np.flatnonzero(known).tolist()),
        log_odds=np.inf,
        kind="torque_unit:limits",
        facts={"most": np.median(most)},
    )


def mixed(reading):
    """Return the torques of two joints that contain each other's, as of cables."""
    robot, parents, fits = reading.robot, list(reading.model.parents), []
    joints, tau = robot.joints.tolist(), robot.signals.tau
    for j in joints:
        before = {parents[j + 1] - 1, parents[parents[j + 1]] - 1}
        for i in before.intersection(joints):
            mean, columns = robot.described.copy(), np.zeros((*tau.shape, 4))
            mean[:, [i, j]] = 0.0
            for k, (own, other) in enumerate(((i, j), (j, i))):
                columns[:, own, 2 * k] = robot.described[:, own]
                columns[:, own, 2 * k + 1] = tau[:, other]
            fits.append((robot.fit(mean=mean, columns=columns, deviation=1.0), i, j))
    if not fits:
        return None
    fit, i, j = max(fits, key=lambda one: one[0].evidence)
    torques, each, names = np.eye(reading.nv), [], reading.names
    for k, (own, other) in enumerate(((i, j), (j, i))):
        size, share = fit.factors[2 * k : 2 * k + 2]
        known = abs(share) > 3 * fit.errors[2 * k + 1] + number.OF_GEAR
        # Friction that two drives share looks alike, with little of the own torque.
        if known and 1 / number.SCALE < abs(size) < number.SCALE:
            torques[own, [own, other]] = 1 / size, -share / size
            sign = "-" if share / size > 0 else "+"
            less = f"{1 / size:.3g} {names[own]} {sign} {abs(share / size):.3g}"
            each.append(f"{names[own]}: {less} {names[other]}")
    change, facts = Change(torques=torques), {"each": "; ".join(each)}
    return judged(reading, change, variants=2 * reading.nv, facts=facts)


# -- torques that nobody measured ------------------------------------------------------


def silent(reading):
    """Return a torque that does not follow a motion that should load it."""
    robot = reading.robot
    sizes = robot.sizes
    # Nor does it follow the motion of another joint, as if they were exchanged.
    least = 2 * np.log(number.UNRELATED)
    follows = robot.joints[(reading.rough_crossed < least).any(axis=0)]
    for j, error in zip(robot.joints, robot.errors()):
        others = [k for k in robot.joints if k != j and np.isfinite(sizes[k])]
        usual = min(np.median(sizes[others]), 1.0) if others else 1.0
        small = sizes[j] < number.SILENT * usual and error > number.UNRELATED
        if small and j not in follows:
            facts = {"size": sizes[j]}
            return Proposal(joints=(int(j),), log_odds=np.inf, facts=facts)
    return None


def of_another(reading):
    """Return torques that neither follow nor reach those of the description."""
    robot = reading.robot
    size, left = np.nanmedian(robot.sizes[robot.joints]), np.exp(0.5 * robot.now.left)
    small = size < 1 / number.SCALE and np.median(left) > number.OF_ANOTHER
    if not small and (left > number.UNFOLLOWED).sum() < max(2, left.size / 3):
        return None
    facts = {"size": size, "share": percent(np.median(left))}
    return Proposal(joints=reading.every, log_odds=np.inf, facts=facts)


def computed(reading):
    """Return torques that are those of the description to rounding."""
    robot, tau = reading.robot, reading.robot.signals.tau
    left = tau - robot.described
    pairs = [(left[rows, j], tau[rows, j]) for j, rows in enumerate(robot.rows)]
    pairs = [pairs[j] for j in robot.joints]
    most = max(np.sqrt(np.mean(x**2) / (y.var() + 1e-300)) for x, y in pairs)
    # A single joint may well be without friction.
    if len(pairs) < 2 or most > number.COMPUTED:
        return None
    facts = {"share": percent(most)}
    return Proposal(joints=reading.every, log_odds=np.inf, facts=facts)


# -- motion in place of torques --------------------------------------------------------


def of_motion(reading):
    """Return torques that are positions, velocities or accelerations."""
    if reading.signals is None:
        return None
    robot, nv, tau = reading.robot, reading.nv, reading.signals.tau
    for k, what in enumerate(("positions", "velocities", "accelerations")):
        motion, factors, left = reading.signals.states[:, k * nv :], [], []
        for j in robot.joints:
            x, y = (values[robot.rows[j], j] for values in (motion, tau))
            alike = np.corrcoef(x, y)[0, 1]
            factors.append(alike * y.std() / x.std())
            left.append(np.sqrt(1.0 - min(alike**2, 1.0)))
        # A single rotor without friction has such a torque.
        several = len(factors) > 1
        factor = np.median(factors) if several else 1.0
        apart = np.abs(np.array(factors) / factor - 1.0)
        most = number.GOOD_FIT if several else number.SAME
        if factors and apart.max() <= number.SAME and max(left) <= most:
            facts = {"what": what, "factor": factor, "share": percent(max(left))}
            return Proposal(joints=reading.every, log_odds=np.inf, facts=facts)
    return None


# -- torques without signs -------------------------------------------------------------


def unsigned(reading):
    """Return torques of which only sizes were logged."""
    tau, signals = reading.tau, reading.signals
    # Where they are, all of one sign are: what loads a joint little shows nothing.
    one_way = (tau >= 0).all(axis=0) | (tau <= 0).all(axis=0)
    one_way = np.flatnonzero(one_way & reading.usable.any(axis=0)).tolist()
    if not one_way or signals is None:
        return None
    moving, weight = reading.bodies.described(signals.states)
    explanations = signed_columns(signals.states, moving + weight)
    found = False
    for j in one_way:
        columns, sizes = explanations[j], np.abs(signals.tau[:, j])
        more = np.column_stack([columns, weight[:, j]])
        plain = more @ np.linalg.lstsq(more, sizes)[0]
        left = ((sizes - plain) ** 2).sum()
        if left < number.GOOD_FIT**2 * sizes.var() * sizes.size:
            continue
        made = columns @ most_explaining(columns, sizes)
        least = min((made < 0).mean(), (made > 0).mean())
        signed = ((sizes - np.abs(made)) ** 2).sum()
        found |= number.SIGN_GAIN * signed < left and least > number.RARE
    remedy = {"drive": "current signed=no"}
    made = Proposal(joints=tuple(one_way), log_odds=np.inf, remedy=remedy)
    return made if found else None


def signed_columns(states, rigid):
    """Make the columns that torques may consist of, nv arrays (n, 5)."""
    # Torques (n, nv) of rigid bodies, dry and viscous friction, inertia, and an offset.
    v, a = np.split(states, 3, axis=1)[1:]
    columns = rigid, np.sign(v), v, a, np.ones_like(v)
    return np.stack(columns, axis=-1).swapaxes(0, 1)


def most_explaining(columns, sizes):
    """Coefficients of columns with which signs explain most of sizes (n,), by EM."""
    # columns: see `signed_columns`. A few thousand rows tell as much as all.
    some = slice(None, None, max(len(sizes) // number.LOOKED_AT, 1))
    columns, sizes = columns[some], sizes[some]
    # All of them but the offset are positive by nature: with the other sign of all,
    # a torque has the same size.
    unit = np.sqrt((columns[:, 0] ** 2).mean()) or 1.0
    both = np.column_stack([columns, -columns[:, -1]])
    size = np.sqrt((both**2).sum(axis=0))
    size = np.where(size > 0, size, 1.0)
    found = []
    for share in number.DRY_STARTS:
        start = columns[:, 1] if np.isinf(share) else columns[:, 0]
        if 0 < share < np.inf:
            start = start + share * unit * columns[:, 1]
        signs = np.where(start < 0, -1.0, 1.0)
        for _ in range(number.SIGN_ROUNDS):
            coef = scipy.optimize.nnls(both / size, signs * sizes)[0] / size
            coef = np.append(coef[:-2], coef[-2] - coef[-1])
            new = np.where(columns @ coef < 0, -1.0, 1.0)
            if (new == signs).all():
                break
            signs = new
        found.append((((signs * sizes - columns @ coef) ** 2).sum(), len(found), coef))
    return min(found)[2]
