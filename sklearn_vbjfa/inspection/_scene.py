"""Hypotheses on the whole robot: weight, its direction, torque lag, contact."""

from dataclasses import replace

import numpy as np
import scipy

from sklearn_vbjfa._core._linear_systems import orthonormal_basis
from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._likelihood import DescribedRobot
from sklearn_vbjfa.inspection._reading import Change, Proposal, clear_of_all
from sklearn_vbjfa.inspection._sentences import percent


def weightless(reading):
    """Return joints whose torques do not contain the weight of the links."""
    robot = reading.robot
    inertial, moving = robot.under_gravity(np.zeros(3)), robot.floating.described

    def gain(joints):
        """Log odds of no weight on some joints; zero if springs explain it as well."""
        baseline = robot.fit(joints=joints).evidence
        # Without gravity, or with the described weight subtracted.
        fits = robot.fit(inertial, joints=joints), robot.fit(mean=moving, joints=joints)
        best = max(fit.evidence for fit in fits)
        if best - baseline <= number.DECISIVE:
            return 0.0
        # Each further spring costs the prior odds of a fault; a single joint of several
        # may have a counterbalance.
        springs = robot.spring_evidence(joints, turns=len(joints) == 1 < len(loaded))
        springs += number.PRIOR * (len(joints) - 1)
        return best - baseline if best - springs > number.DECISIVE else 0.0

    # A constant weight is not distinguishable from an offset.
    loaded = _loaded(robot, robot.weight - robot.weight.mean(axis=0))
    gains = {j: gain([j]) for j in loaded if j in robot.explained}
    affected, odds = [j for j in gains if gains[j]], sum(gains.values())
    # A joint fit is more decisive, since joints carry the same bodies.
    if len(loaded) > 1 and (joint_gain := gain(loaded)) > odds:
        affected, odds = loaded, joint_gain
    if affected == loaded:
        # As for other hypotheses on all torques, include the joints without load.
        odds = max(odds, gain(robot.joints.tolist()))
    # Mean forces of prismatic joints show a weight in any direction of gravity.
    pull = np.linalg.norm(robot.unit_weights, axis=-1)
    means = [x.mean(axis=0)[reading.slides] for x in (robot.signals.tau, pull)]
    offset, weight = np.linalg.norm(means, axis=1)
    if not affected or offset > number.SLIDE_LOAD * weight > 0:
        return None
    fit = robot.fit(columns=robot.weight[:, :, None], deviation=1.0, joints=affected)
    share, error = 1.0 + fit.factors[0], number.INTERVAL * fit.errors[0]
    if abs(share) + error > number.NO_WEIGHT:
        return None
    heavy = np.abs(robot.weight[:, affected]).max()
    facts = {"share": share, "error": error, "heavy": heavy, "other": ""}
    if len(loaded) == 1:
        facts["other"] = " Or a spring balances it, or the base is mounted otherwise."
    options = {"kind": "no_gravity:joints" * (len(affected) < len(loaded))}
    options["severity"] = "warning" * (len(affected) < max(2, len(loaded)))
    return Proposal(joints=tuple(affected), log_odds=odds, facts=facts, **options)


def weight_factor(reading):
    """Return a factor of the weight of all links, other than zero and one."""
    robot, factor, (least, most) = reading.robot, 1.0, number.NEAR_PERIODS
    for _ in range(number.PASSES):
        X = robot.under_gravity(factor * reading.bodies.gravity)
        fit = robot.fit(X, columns=robot.weight[:, :, None], deviation=1.0)
        factor, error = factor + fit.factors[0], number.INTERVAL * fit.errors[0]
        if abs(fit.factors[0]) < least:
            break
    # A period has the square root of this effect; on a single joint, so has a spring.
    size = 0.5 * abs(np.log(max(factor, number.GOOD_FIT)))
    loaded, gravity = _loaded(robot, robot.weight), factor * reading.bodies.gravity
    if factor < number.GOOD_FIT or size < max(least, error) or len(loaded) < 2:
        return None
    facts = {"share": factor, "error": error, "period": np.sqrt(factor) * reading.dt}
    facts |= {"gain": 1 / factor, "heavy": np.abs(robot.weight[:, loaded]).max()}
    fit, options = robot.fit(robot.under_gravity(gravity)), {"joints": tuple(loaded)}
    odds, fall = fit.evidence - robot.baseline.evidence, fit.fall(robot.baseline)
    # A factor of a single joint is that of its own load.
    if np.sort(robot.baseline.loss - fit.loss)[-2:].min() < number.CLEAR:
        return None
    options |= {"log_odds": odds, "severity": "warning" if size < most else ""}
    options |= {"fall": fall, "change": Change(gravity=9.81 * gravity)}
    return Proposal(facts=facts, **options)


def unloaded_slides(reading):
    """Return prismatic joints whose forces lack a weight that is constant."""
    robot, lacking = reading.robot, {}
    for j in robot.joints[reading.slides[robot.joints]].tolist():
        rows, load = robot.rows[j], robot.weight[:, j].mean()
        force = robot.signals.tau[rows, j]
        offset = np.linalg.lstsq(robot.friction(j)[rows, :4], force)[0][3]
        # In another unit, a weight would still exceed the other forces.
        least = max(number.SLIDE_LOAD * force.std(), abs(offset) / number.NO_WEIGHT)
        if abs(load) > least and abs(offset) < force.std():
            lacking[j] = f"{reading.names[j]} {load:.3g} N"
    if not lacking or reading.gains is not None:
        return None
    kind, facts = "no_gravity:slides", {"each": ", ".join(lacking.values())}
    return Proposal(joints=tuple(lacking), log_odds=np.inf, kind=kind, facts=facts)


def gravity_only(reading):
    """Return torques that contain only the weight of the links."""
    robot = reading.robot
    columns = np.stack([robot.floating.described, robot.weight], axis=-1)
    fit = robot.fit(mean=np.zeros_like(robot.floating.described), columns=columns)
    error = number.INTERVAL * fit.errors
    inertia, weight = fit.factors
    unclear = abs(inertia) + error[0] > number.NO_WEIGHT or weight < error[1]
    # Torques of a gravity model contain no friction.
    if unclear or (fit.power > number.SIGMAS).any():
        return None
    weight_only = robot.fit(robot.regressor - robot.under_gravity(np.zeros(3)))
    if weight_only.loss.max() > 2 * np.log(number.GOOD_FIT):
        return None
    facts = {"part": inertia, "error": error[0]}
    odds = weight_only.evidence - robot.baseline.evidence
    return Proposal(joints=reading.every, log_odds=odds, facts=facts)


def base_orientation(reading):
    """Return a base orientation that differs from the description."""
    # start, pull (3,): described and estimated gravity, in units of g.
    robot, start, chosen = reading.robot, reading.bodies.gravity, reading.robot.baseline
    size, pull = np.linalg.norm(start), start
    # Components of gravity that are not identifiable stay as described, or are zero.
    any_pull = {"columns": robot.unit_weights, "deviation": 1.0}
    fit = robot.fit(**any_pull)
    if np.linalg.norm(fit.factors) < 0.5 * number.TURNED * size:
        return None
    full, shown = start + fit.factors, fit.errors < 0.5
    no_weight = robot.fit(robot.under_gravity(np.zeros(3)), **any_pull)
    candidates = [full, no_weight.factors, *np.eye(3), *-np.eye(3)]
    variants = len(candidates)
    for _ in range(number.PASSES):
        candidates = [size * x / max(np.linalg.norm(x), 1e-300) for x in candidates]
        fits = [robot.fit(robot.under_gravity(x)) for x in candidates]
        best = int(np.argmax([fit.evidence for fit in fits]))
        if fits[best].evidence < chosen.evidence + number.SETTLED:
            break
        pull, chosen = candidates[best], fits[best]
        full = pull + robot.fit(robot.under_gravity(pull), **any_pull).factors
        candidates = [full]
    # On a single joint, a spring that overcompensates the weight has the same effect.
    heavy = 1 / number.AS_HEAVY < np.linalg.norm(full) / size < number.AS_HEAVY
    loaded = _loaded(robot, robot.unit_weights @ pull)
    odds = chosen.evidence - robot.baseline.evidence - np.log(variants)
    springs = robot.springs > odds - number.FAR_ODDS
    # Offsets must not hide it; components that are not shown may have either sign.
    largest = np.abs(robot.unit_weights @ pull).max(axis=0)[loaded]

    def offsets(pull):
        residual = (robot.signals.tau - robot.unit_weights @ pull).mean(axis=0)[loaded]
        return np.square(residual / largest).sum()

    pull = min(pull, np.where(shown, pull, -pull), key=offsets)
    hidden = offsets(pull) > max(offsets(np.zeros(3)), number.GOOD_FIT**2)
    if not heavy or len(loaded) < 2 or springs or hidden:
        return None
    improvement = chosen.fall(robot.baseline)
    angle = float(np.arccos(np.clip(pull @ start / size**2, -1, 1)))
    facts = {"angle": np.degrees(angle)}
    facts["pull"] = ", ".join(f"{x:.2f}" for x in pull / size)
    is_clear = angle > number.TURNED and improvement >= number.CLEAR * len(loaded)
    options = {"log_odds": odds, "fall": improvement, "clear": is_clear, "facts": facts}
    change = Change(gravity=9.81 * pull)
    return Proposal(change=change, joints=reading.every, **options)


def _loaded(robot, weight):
    """List the joints with a considerable load among weights (n, nv)."""
    heavy = np.abs(weight).max(axis=0)
    return [int(j) for j in robot.joints if heavy[j] > 0.1 * heavy.max()]


def large_lag(reading):
    """Return a lag of all torques that is far from zero."""
    robot, rows = reading.robot, reading.signals.row
    if len(reading.parts) > 1:
        return None
    pairs = [(robot.signals.tau[:, j], robot.described[:, j]) for j in robot.joints]
    pairs = [[(x - x.mean()) / max(x.std(), 1e-300) for x in pair] for pair in pairs]
    total = np.sum([scipy.signal.correlate(*pair) for pair in pairs], axis=0)
    lags = np.arange(1 - rows.size, rows.size)
    total[2 * np.abs(lags) > rows.size] = -np.inf
    lag = round(float(lags[np.argmax(total)] * np.median(np.diff(rows))))
    proposal = torque_lag(reading, lag) if lag else None
    # Other faults make torques resemble those of another time a little.
    return proposal if proposal and proposal.fall > clear_of_all(reading) else None


def torque_lag(reading, n_whole=0):
    """Return a lag or a low-pass that is common to all torques."""
    robot_before = _robot_in_motion(reading, reading)
    after = reading.apply(Change(lag=n_whole)) if n_whole else reading
    if after.is_uninformative():
        return None
    for _ in range(number.MOVES):
        robot = robot_before if after is reading else _robot_in_motion(reading, after)
        signals = robot.signals
        fit = robot.fit(columns=-signals.slope[:, :, None])
        fraction, error = float(fit.factors[0]), float(fit.errors[0])
        samples = n_whole + fraction
        if not abs(samples) > number.LEAST_LAG * error:
            return None
        if abs(fraction) < number.SAMPLE:
            break
        n_whole += round(fraction)
        after = reading.apply(Change(lag=n_whole))
        if after.is_uninformative():
            return None
    else:
        return None
    shifted = robot.fit(tau=signals.tau + fraction * signals.slope)
    baseline = robot.fit(tau=reading.signals.tau)
    gain, changes = shifted.evidence - baseline.evidence, shifted.loss - baseline.loss
    drifts = _drift(reading, robot, shifted)
    if drifts is not None:
        return drifts
    # Friction with memory looks like a lag of one joint, but not of the others.
    most_harm = number.HARM * max(1.0, -changes.sum())
    if changes.size < 2 or (changes < 0).mean() <= 0.5 or changes.max() >= most_harm:
        return None
    # Only a lag is corrected; a filter must be more probable by far.
    # The inverse of a first-order filter adds its time constant times the derivative.
    tau, slope = robot_before.signals.tau, samples * robot_before.signals.slope
    constants = number.CONSTANTS if samples > 0 else ()
    best = (robot_before.fit(tau=tau + x * slope).evidence for x in constants)
    lowpass_gain = max(best, default=-np.inf) - robot_before.baseline.evidence
    lowpass = lowpass_gain > gain + number.DECISIVE
    seconds = samples * reading.dt
    facts = {"size": 1e3 * abs(seconds), "late": "late" if seconds > 0 else "early"}
    facts |= {"error": 1e3 * number.INTERVAL * error * reading.dt}
    kind = "torque_lowpass" if lowpass else "delay:alone" * reading.alone
    options = {"log_odds": lowpass_gain if lowpass else gain, "kind": kind}
    options |= {"fall": -changes.sum()}
    return Proposal(joints=reading.every, value=seconds, facts=facts, **options)


def _robot_in_motion(reading, after):
    """Return the robot with the rows whose whole filter window is in motion."""
    # Near standstill, friction changes sign before or after the velocity.
    cache, signals = (reading.robot.times, reading.robot.regressor), after.signals
    signals_moving = replace(signals, weight=signals.throughout)
    robot = DescribedRobot(reading.bodies, signals_moving, *cache)
    if robot.joints.size < reading.robot.joints.size:
        return DescribedRobot(reading.bodies, signals, *cache)
    return robot


def _drift(reading, robot, steady):
    """Return a lag that changes linearly with time (clock drift)."""
    # robot: with torques shifted by the integer lag; steady: `BodyFit` with a constant
    # lag.
    signals = robot.signals
    elapsed = (signals.row - signals.row.mean()) / np.ptp(signals.row)
    columns = -np.stack([signals.slope, elapsed[:, None] * signals.slope], axis=-1)
    fit = robot.fit(columns=columns)
    total, error = float(fit.factors[1]), float(fit.errors[1])
    if len(reading.parts) > 1 or abs(total) < max(number.LEAST_LAG * error, 1.0):
        return None
    drifting = robot.fit(tau=signals.tau - columns @ fit.factors)
    # Every joint shares the clock.
    if (drifting.loss - steady.loss).max() > 0 or drifting.fall(steady) < number.CLEAR:
        return None
    share = total / np.ptp(signals.row)
    facts = {"ahead": "fast" if share > 0 else "slow", "share": percent(abs(share))}
    facts |= {"size": 1e3 * abs(total) * reading.dt}
    options = {"kind": "delay:drift", "severity": "warning", "facts": facts}
    odds = drifting.evidence - robot.fit(tau=reading.signals.tau).evidence
    return Proposal(joints=reading.every, log_odds=odds, value=share, **options)


def external_force(reading):
    """Return an interval in which an external force adds constant torques."""
    robot, rows = reading.robot, reading.signals.row
    interval, inside = _contact_interval(robot), np.zeros(rows.size, dtype=bool)
    # Limit it to the recording that contains its middle.
    stops = [part.stop for part in reading.parts]
    k = int(np.searchsorted(stops, rows[sum(interval) // 2], side="right"))
    first, last = reading.parts[k].start, stops[k] - 1
    step, edges = rows.size // number.CONTACT_ENDS, np.searchsorted(rows, (first, last))
    # At the beginning or the end, it may be a payload, which the search identifies.
    if (np.abs(edges - interval) <= step).any():
        return None
    inside[slice(*interval)] = True
    # A contact correlates residuals for its whole duration.
    times = robot.correlation_times(inside[:, None].astype(float))
    times = np.minimum(robot.times, times)
    robot = DescribedRobot(robot.bodies, robot.signals, times, robot.regressor)
    size = robot.signals.tau[:, robot.joints].std(axis=0)
    columns = np.eye(reading.nv) * inside[:, None, None]
    fit, baseline = robot.fit(columns=columns, deviation=size.max()), robot.baseline
    torques = (columns @ fit.factors)[inside][:, robot.joints]
    ratios = np.sqrt((torques**2).mean(axis=0)) / (size * np.exp(0.5 * fit.loss))
    pushed = ratios > number.CONTACT
    # On a single joint, a change of friction is as probable.
    few = pushed.sum() < min(robot.joints.size, 2)
    odds = fit.evidence - baseline.evidence - np.log(rows.size)
    if few or fit.fall(baseline) < number.CLEAR_OF_JOINT or not robot.surpasses(odds):
        return None
    # A force on a link loads most joints between it and the base.
    farthest = int(robot.joints[pushed][-1])
    supports = np.array(reading.model.supports[farthest + 1])[1:] - 1
    if pushed[np.isin(robot.joints, supports)].mean() < 0.5:
        return None
    ends = np.clip(rows[np.minimum(interval, rows.size - 1)], first, last) - first
    begin, end = ends * reading.dt
    where = f"of recording {reading.recordings[k]}"
    where = where if len(stops) > 1 else "after the start"
    joints = robot.joints[pushed]
    units = np.where(reading.slides[joints], "N", "N m")
    each = zip(joints, torques.mean(axis=0)[pushed], units)
    forces = [f"{reading.names[j]} {x:+.2g} {unit}" for j, x, unit in each]
    facts = {"begin": begin, "end": end, "where": where, "pushes": ", ".join(forces)}
    return Proposal(joints=tuple(joints.tolist()), log_odds=odds, facts=facts)


def _contact_interval(robot):
    """Return the rows between which constant torques explain most of the residuals."""
    n, gain = len(robot.signals.tau), 0.0
    ends = np.arange(0, n + 1, max(1, n // number.CONTACT_ENDS))
    span = ends - ends[:, None]
    first, last = np.nonzero((span >= n // number.SHORTEST_CONTACT) & (span <= n // 2))
    first, last = ends[first], ends[last]
    for j in robot.joints:
        # Project the torque and the indicator of the interval onto the residual space.
        basis, mask = orthonormal_basis(robot.design(j)), robot.signals.weight[:, j] > 0
        y = robot.signals.tau[:, j] * mask
        y = y - basis @ (basis.T @ y)
        sums = np.vstack([np.zeros(len(basis.T) + 2), np.c_[basis, y, mask]])
        *bases, product, rows = np.diff(sums.cumsum(axis=0)[[first, last]], axis=0)[0].T
        size = np.maximum(rows - np.square(bases).sum(axis=0), 1.0)
        share = product**2 / size / max(y @ y, 1e-300)
        gain = gain - np.log1p(-np.minimum(share, 1.0 - np.finfo(float).eps))
    k = int(np.argmax(gain))
    return first[k], last[k]
