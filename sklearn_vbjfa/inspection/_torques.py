"""Hypotheses on torques: signs, scale, noise; torques that were not measured."""

from copy import copy
from dataclasses import replace

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._reading import (
    Change,
    Proposal,
    judge,
    most_probable,
    refine,
    times,
)
from sklearn_vbjfa.inspection._sentences import percent
from sklearn_vbjfa.recording import listed_joints

# Factors from each unit to N m.
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


def signs(reading):
    """Return the torques whose signs are wrong: one, some, or all."""
    robot, nv, tau = reading.robot, reading.nv, reading.robot.signals.tau
    tested = robot.explained.tolist()
    if not tested:
        return None
    # Separate fits of each joint first; undecided signs are tested together.
    gain = {j: _sign_odds(robot, j) for j in tested}
    decided = {j for j in tested if gain[j] > number.DECISIVE}
    unclear = {j for j in tested if abs(gain[j]) <= number.DECISIVE}
    sets = [(), decided, *(decided | {j} for j in unclear), decided | unclear]
    scores = {}
    for wrong in dict.fromkeys(map(frozenset, sets)):
        fit = robot.fit(tau=tau @ times(nv, -1.0, list(wrong)), joints=tested)
        opposed = {j for j, power in zip(tested, fit.power) if power < -number.SIGMAS}
        # Friction must not contradict a flipped sign.
        if not opposed & wrong:
            scores[wrong] = fit
    as_is = scores[frozenset()]
    highest = max(x.evidence for x in scores.values())
    near = [x for x, fit in scores.items() if fit.evidence > highest - number.RIVAL]
    # All signs wrong is more probable than all but the undecided ones.
    all_tested = frozenset(tested)
    best = all_tested if all_tested in near else min(near, key=len)
    # With long noise correlation, few independent rows decide, and unreliably.
    if not best or scores[best].fall(as_is) < -number.CLEAR:
        return None
    # On a single joint, a counterbalancing spring is more probable.
    springs = robot.spring_evidence(tested) if len(best) == 1 else -np.inf
    if springs > scores[best].evidence - number.DECISIVE:
        return None
    # Poorly explained joints may contradict that all signs are wrong.
    untested = [j for j in robot.joints.tolist() if j not in tested]
    all_wrong = sum(_sign_odds(robot, j) for j in untested) >= -number.RIVAL
    joints = reading.every if best == all_tested and all_wrong else tuple(sorted(best))
    hidden = [j for j in joints if j not in decided] if joints == reading.every else []
    hidden = listed_joints(reading.names, hidden) if nv > 1 else ""
    note = f" As all that show are wrong, so is the sign of {hidden}." if hidden else ""
    signs, fit = times(nv, -1.0, list(joints)), scores[best]
    odds = fit.evidence - as_is.evidence - np.log(nv) * (len(best) == 1)
    options = {"log_odds": odds, "fall": fit.fall(as_is), "facts": {"also": note}}
    options["remedy"] = {"gains": tuple(np.diagonal(signs).tolist())}
    return Proposal(change=Change(torques=signs), joints=joints, **options)


def _sign_odds(robot, j):
    """Return the log odds of the other sign of one torque, in a separate fit."""
    tau = robot.signals.tau
    return robot.fit(tau=-tau, joints=[j]).evidence - robot.fit(joints=[j]).evidence


def torque_factors(robot, common):
    """Return factors of torques, their errors, which are known, and which positive."""
    # common: one for all joints; unidentifiable factors stay at `robot.sizes`.
    nv, sizes = robot.bodies.nv, robot.sizes
    valid = np.isfinite(sizes) & (sizes > 0)
    factors, columns = np.where(valid, sizes, 1.0), robot.described[:, :, None]
    if common:
        valid &= np.isin(np.arange(nv), robot.joints)
        factors = np.full(nv, np.median(sizes[valid]) if valid.any() else 1.0)
    else:
        columns = columns * np.eye(nv)
        for j in robot.joints:
            # `sizes` include friction; this estimate does not.
            rows = robot.rows[j]
            X = np.column_stack([robot.described[:, j], robot.friction(j)])[rows]
            slope = np.linalg.lstsq(X, robot.signals.tau[rows, j])[0][0]
            factors[j] = slope if slope > 0 else factors[j]
    for _ in range(number.PASSES):
        tau = robot.signals.tau / factors
        fit = robot.fit(tau=tau, mean=np.zeros_like(tau), columns=columns)
        more, error = fit.factors, number.INTERVAL * fit.errors
        # The factor of a joint with little load is not identifiable.
        shown = (more > 2 * error) & (error < 1.0)
        step = np.where(shown | common, more, 1.0)
        factors = factors * step
        if step.min() <= 0 or np.abs(np.log(step)).max() < number.SETTLED:
            break
    return factors, error, shown, more > error


def missing_weight(reading):
    """Return the common factor of torques that contain no weight of the links."""
    # Without gravity, or with the described weight subtracted.
    robot, subtracted = reading.robot.floating, copy(reading.robot)
    subtracted.described = robot.described
    best = most_probable(common_scale(reading, x) for x in (robot, subtracted))
    if best is None:
        return None
    # Or in another unit, with a weight that pulls in another direction.
    columns = np.dstack([reading.robot.unit_weights, robot.described])
    fit = robot.fit(columns=columns, mean=0 * robot.described, spread=best.value)
    unit = max(float(np.linalg.norm(fit.factors[:3])), 1e-300)
    error = number.INTERVAL * float(fit.errors[:3].max()) / unit
    X = reading.robot.under_gravity(fit.factors[:3] / unit)
    turned = robot.fit(X, mean=unit * (X @ robot.bodies.parameters), spread=unit)
    odds = turned.evidence - reading.robot.baseline.evidence
    if odds < best.log_odds + number.RIVAL or error > 1:
        return best
    low, high = unit * np.exp([-error, error])
    facts = best.facts | {"factor": unit, "low": low, "high": high, "gain": 1 / unit}
    options = {"kind": "torque_unit", "severity": "warning", "facts": facts}
    change = Change(torques=times(reading.nv, 1 / unit))
    return replace(best, change=change, value=unit, log_odds=odds, **options)


def common_scale(reading, weightless=None):
    """Return the common factor of all torques against the described ones."""
    # weightless: `DescribedRobot` of torques that contain no weight of the links.
    robot = weightless or reading.robot
    factors, error, shown, positive = torque_factors(robot, common=True)
    factor, error = float(factors[0]), float(error[0])
    # A factor far from one needs less precision.
    shown |= positive & (number.SIGMAS * error < abs(np.log(max(factor, 1e-300))))
    limit = number.COMMANDED if reading.commanded else number.SCALE
    if not shown or factor <= 0 or 1 / limit < factor < limit:
        return None
    low, high = factor * np.exp([-error, error])
    units = _matching_units(factor, error)
    baseline = reading.robot.baseline.evidence
    fit = robot.fit(mean=factor * robot.described, spread=factor)
    log_odds, kind = fit.evidence - baseline, ""
    change = Change(torques=times(reading.nv, 1 / factor))
    if weightless:
        # As for the weight alone, springs may explain that it is missing.
        scaled = reading.robot_after(change)
        springs = max(scaled.springs, 0.0) + scaled.baseline.evidence
        if log_odds + baseline - springs <= number.DECISIVE:
            return None
        change, kind = None, "no_gravity:unit"
    facts = {"factor": factor, "low": low, "high": high, "gain": 1 / factor}
    facts["inside"] = f" ({units} would be inside)" if units else ""
    facts["unknown"] = ', or gains="unknown"' * (reading.nv > 1 and not reading.poses)
    facts["free"] = "correct the description" if reading.poses else 'use bodies="free"'
    kind = "gear_factor:commanded" if reading.commanded else kind
    options = {"kind": kind, "value": factor, "facts": facts}
    return Proposal(change=change, joints=reading.every, log_odds=log_odds, **options)


def _matching_units(factor, error):
    """Return units that match a factor of torques within its error [log]."""
    near = (name for name, x in _UNITS.items() if abs(np.log(factor * x)) < error < 1)
    return " or ".join(near)


def separate_scales(reading):
    """Return the torque whose factor differs from the others, or separate factors."""
    factors, error, shown, positive = torque_factors(reading.robot, common=False)
    # Far from the others, a factor may be uncertain. If too large, it must be positive,
    # since friction and rotors add to torques. An extreme one needs no fall of errors.
    joints = reading.robot.explained
    logs = np.log(factors[joints])
    without_each = [np.delete(logs, k) for k in range(logs.size)]
    medians = np.array([np.median(x) if x.size else 0.0 for x in without_each])
    off, single = logs - medians, np.log(number.SINGLE)
    least = number.POSED_SCALE if reading.poses else number.SCALE**2
    limits = np.where(shown[joints], np.log(least), single)
    is_off = (off < -limits) | (off > limits) & positive[joints]
    clear = number.CLEAR if reading.poses else number.CLEAR_OF_JOINT
    required = np.where(np.abs(off) > single, -np.inf, clear)
    outliers = list(zip(joints[is_off].tolist(), required[is_off]))
    # Factors that are not shown are replaced by the ratio to the others.
    factors[joints] = np.where(positive[joints], factors[joints], np.exp(off))
    proposals = [_scale_one(reading, j, factors[j], error[j], x) for j, x in outliers]
    remaining = shown & ~np.isin(np.arange(shown.size), joints[is_off])
    logs = np.sort(np.log(factors[remaining]))
    # Among many factors, the smallest and the largest may be off by chance.
    central = logs[1:-1] if logs.size > 4 else logs
    if logs.size > 1 and np.ptp(central) > np.log(number.SCALE):
        factors = np.where(shown, factors, np.exp(logs.mean()))
        change = Change(torques=np.diag(1 / factors))
        each = [f"{reading.names[j]} {factors[j]:.2g}" for j in np.flatnonzero(shown)]
        args = {"joints": reading.every, "facts": {"each": ", ".join(each)}}
        proposals.append(judge(reading, change, number.CLEAR * reading.nv, **args))
    return most_probable(proposals)


def _scale_one(reading, j, factor, error, required):
    """Return a joint whose torque has a factor against the described one."""
    change = Change(torques=times(reading.nv, 1 / factor, j))
    step = [lambda x: Change(torques=times(reading.nv, np.exp(x), j))]
    change, _ = refine(reading, change, step)
    factor = 1 / change.torques[j, j]
    # Only a warning: invented inertias of the description have the same effect.
    units = _matching_units(factor, error)
    units = units or "torque of the motor, a current, or another unit"
    facts = {"factor": factor, "ratio": 1 / factor, "units": units}
    options = {"variants": reading.nv, "kind": "gear_factor", "facts": facts}
    best = judge(reading, change, required, **options)
    # Springs, too, explain a torque that the described bodies do not.
    far = best and best.log_odds > reading.robot.springs + number.FAR_ODDS
    return best if far else None


def beyond_limits(reading):
    """Return torques that exceed the limits of the description many times."""
    limit = np.asarray(reading.model.effortLimit, dtype=float)
    limited = (limit > 0) & (limit < number.NO_LIMIT)
    ratios = np.quantile(np.abs(reading.tau), 0.995, axis=0)[limited] / limit[limited]
    # Identical limits of all joints are placeholders.
    identical = np.unique(limit[limited]).size < 2
    if identical or np.median(ratios) < number.BEYOND_LIMITS:
        return None
    joints, kind = tuple(np.flatnonzero(limited).tolist()), "torque_unit:limits"
    facts = {"most": np.median(ratios)}
    return Proposal(joints=joints, log_odds=np.inf, kind=kind, facts=facts)


def driving_friction(reading):
    """Return the joints whose friction accelerates them by the torques."""
    # Early torques, and third derivatives of the positions, have the same effect.
    robot, signals, nv = reading.robot, reading.robot.signals, reading.nv
    jerk = np.gradient(signals.states[:, 2 * nv :], axis=0)
    jerk *= signals.tau.std(axis=0) / np.maximum(jerk.std(axis=0), 1e-99)
    columns = jerk[:, :, None] * np.eye(nv), -signals.slope[:, :, None]
    fits = robot.baseline, robot.fit(columns=np.concatenate(columns, axis=2))
    # Friction must be larger than unmodelled torque, such as of elastic joints.
    n = np.array([robot.rows[j].size for j in robot.joints]) / robot.times[robot.joints]
    drives = np.all([fit.power < -number.SIGMAS - np.sqrt(n) for fit in fits], axis=0)
    no_brake = (robot.baseline.power < number.SIGMAS).all()
    reverse = "the rows are in reverse order of time, or " * bool(no_brake)
    joints, facts = tuple(robot.joints[drives].tolist()), {"reverse": reverse}
    return Proposal(joints=joints, log_odds=np.inf, facts=facts) if joints else None


def mixed_torques(reading):
    """Return two joints whose torques are mixed, as by cables or a differential."""
    robot, parents, fits = reading.robot, list(reading.model.parents), []
    joints, tau = robot.joints.tolist(), robot.signals.tau
    for j in joints:
        before = {parents[j + 1] - 1, parents[parents[j + 1]] - 1}
        for i in before.intersection(joints):
            mean, columns = robot.described.copy(), np.zeros((*tau.shape, 4))
            mean[:, [i, j]] = 0.0
            for k, (joint, other) in enumerate(((i, j), (j, i))):
                columns[:, joint, 2 * k] = robot.described[:, joint]
                columns[:, joint, 2 * k + 1] = tau[:, other]
            fits.append((robot.fit(mean=mean, columns=columns, deviation=1.0), i, j))
    if not fits:
        return None
    fit, i, j = max(fits, key=lambda row: row[0].evidence)
    torques, each, names = np.eye(reading.nv), [], reading.names
    for k, (joint, other) in enumerate(((i, j), (j, i))):
        size, share = fit.factors[2 * k : 2 * k + 2]
        clear_share = abs(share) > 3 * fit.errors[2 * k + 1] + number.SILENT
        # Friction shared by two drives has the same effect, but a small own factor.
        if clear_share and 1 / number.SCALE < abs(size) < number.SCALE:
            torques[joint, [joint, other]] = 1 / size, -share / size
            sign = "-" if share / size > 0 else "+"
            terms = f"{1 / size:.3g} {names[joint]} {sign} {abs(share / size):.3g}"
            each.append(f"{names[joint]}: {terms} {names[other]}")
    change, facts = Change(torques=torques), {"each": "; ".join(each)}
    return judge(reading, change, variants=2 * reading.nv, facts=facts)


def silent_torque(reading):
    """Return a torque that does not follow the motion that should load it."""
    robot = reading.robot
    sizes = robot.sizes
    # A torque that follows the motion of another joint was exchanged instead.
    threshold = 2 * np.log(number.UNRELATED)
    follows = robot.joints[(reading.cross_scores < threshold).any(axis=0)]
    for j, error in zip(robot.joints, robot.errors()):
        others = [k for k in robot.joints if k != j and np.isfinite(sizes[k])]
        typical = min(np.median(sizes[others]), 1.0) if others else 1.0
        is_small = sizes[j] < number.SILENT * typical and error > number.UNRELATED
        if is_small and j not in follows:
            return Proposal(joints=(int(j),), log_odds=np.inf, facts={"size": sizes[j]})
    return None


def other_robot(reading):
    """Return torques that are unrelated to, or far smaller than, the described ones."""
    robot = reading.robot
    size = np.nanmedian(robot.sizes[robot.joints])
    left = np.exp(0.5 * robot.baseline.loss)
    is_small = size < 1 / number.SCALE and np.median(left) > number.UNEXPLAINED
    if not is_small and (left > number.UNFOLLOWED).sum() < max(2, left.size / 3):
        return None
    facts = {"size": size, "share": percent(np.median(left))}
    return Proposal(joints=reading.every, log_odds=np.inf, facts=facts)


def computed_torque(reading):
    """Return torques that equal the described ones (a model was logged)."""
    robot, tau, rows = reading.robot, reading.robot.signals.tau, reading.robot.rows
    residual, shares = tau - robot.described, {}
    for j in robot.joints:
        x, y = residual[rows[j], j], tau[rows[j], j]
        shares[j] = np.sqrt(np.mean(x**2) / (y.var() + 1e-300))
    computed = [j for j in shares if shares[j] <= number.COMPUTED]
    # The torque of a robot with a single joint may have negligible friction.
    if len(shares) < 2 or not computed:
        return None
    facts = {"share": percent(max(shares[j] for j in computed))}
    return Proposal(joints=computed, log_odds=np.inf, facts=facts)


def motion_as_torque(reading):
    """Return torques that are positions, velocities or accelerations."""
    if reading.signals is None or reading.poses:
        return None
    robot, nv, tau = reading.robot, reading.nv, reading.signals.tau
    for k, what in enumerate(("positions", "velocities", "accelerations")):
        motion, factors, unexplained = reading.signals.states[:, k * nv :], [], []
        for j in robot.joints:
            x, y = (values[robot.rows[j], j] for values in (motion, tau))
            correlation = np.corrcoef(x, y)[0, 1]
            factors.append(correlation * y.std() / x.std())
            unexplained.append(np.sqrt(1.0 - min(correlation**2, 1.0)))
        # A single rotor without friction has torques proportional to its acceleration.
        is_several = len(factors) > 1
        factor = np.median(factors) if is_several else 1.0
        deviations = np.abs(np.array(factors) / factor - 1.0)
        limit = number.GOOD_FIT if is_several else number.SAME
        if factors and deviations.max() <= number.SAME and max(unexplained) <= limit:
            facts = {"what": what, "factor": factor, "share": percent(max(unexplained))}
            return Proposal(joints=reading.every, log_odds=np.inf, facts=facts)
    return None


def unsigned(reading):
    """Return torques of which only absolute values were logged."""
    tau, signals = reading.tau, reading.signals
    # If any is found unsigned, so are all of one sign: small loads show nothing.
    one_way = (tau >= 0).all(axis=0) | (tau <= 0).all(axis=0)
    one_way = np.flatnonzero(one_way & reading.usable.any(axis=0)).tolist()
    if not one_way or signals is None:
        return None
    moving, weight = reading.bodies.described(signals.states)
    explanations = signed_columns(signals.states, moving + weight)
    is_unsigned = False
    for j in one_way:
        columns, sizes = explanations[j], np.abs(signals.tau[:, j])
        design = np.column_stack([columns, weight[:, j]])
        fitted = design @ np.linalg.lstsq(design, sizes)[0]
        residual = ((sizes - fitted) ** 2).sum()
        if residual < number.GOOD_FIT**2 * sizes.var() * sizes.size:
            continue
        result = columns @ most_explaining(columns, sizes)
        share = min((result < 0).mean(), (result > 0).mean())
        signed = ((sizes - np.abs(result)) ** 2).sum()
        is_unsigned |= number.SIGN_GAIN * signed < residual and share > number.MINORITY
    remedy = {"drive": "current signed=no"}
    result = Proposal(joints=tuple(one_way), log_odds=np.inf, remedy=remedy)
    return result if is_unsigned else None


def signed_columns(states, rigid):
    """Return the regressors of each torque up to its sign, nv arrays (n, 5)."""
    # Torques (n, nv) of rigid bodies, dry and viscous friction, inertia, and an offset.
    v, a = np.split(states, 3, axis=1)[1:]
    return np.stack([rigid, np.sign(v), v, a, np.ones_like(v)], axis=-1).swapaxes(0, 1)


def most_explaining(columns, sizes):
    """Fit coefficients of columns to absolute values (n,), with unknown signs."""
    # Alternates between signs and `signed_columns` coefficients, on a subset of rows.
    subset = slice(None, None, max(len(sizes) // number.SIGN_ROWS, 1))
    columns, sizes = columns[subset], sizes[subset]
    # All coefficients but the offset are nonnegative: the negative of a torque has the
    # same absolute values.
    unit = np.sqrt((columns[:, 0] ** 2).mean()) or 1.0
    extended = np.column_stack([columns, -columns[:, -1]])
    norms = np.sqrt((extended**2).sum(axis=0))
    norms = np.where(norms > 0, norms, 1.0)
    fits = []
    for share in number.DRY_STARTS:
        start = columns[:, 1] if np.isinf(share) else columns[:, 0]
        if 0 < share < np.inf:
            start = start + share * unit * columns[:, 1]
        signs = np.where(start < 0, -1.0, 1.0)
        for _ in range(number.SIGN_ROUNDS):
            coef = scipy.optimize.nnls(extended / norms, signs * sizes)[0] / norms
            coef = np.append(coef[:-2], coef[-2] - coef[-1])
            new = np.where(columns @ coef < 0, -1.0, 1.0)
            if (new == signs).all():
                break
            signs = new
        fits.append((((signs * sizes - columns @ coef) ** 2).sum(), len(fits), coef))
    return min(fits)[2]
