"""Hypotheses on torques: signs, size, weight, direction of gravity, lag, contact."""

import numpy as np
import scipy

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._contact import contact
from sklearn_vbjfa.inspection._hypotheses import (
    Candidate,
    Hypothesis,
    judged,
    odds,
)
from sklearn_vbjfa.inspection._reading import Change
from sklearn_vbjfa.inspection._sentences import SENTENCES, finding, percent
from sklearn_vbjfa.model import TreeRegressor, nominal_parameters
from sklearn_vbjfa.recording import UNSIGNED, listed_joints

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


def _signs(reading):
    """Return the torques whose signs are wrong: one, some, or all."""
    robot, nv, tau = reading.robot, reading.nv, reading.robot.signals.now
    judge = robot.joints[robot.errors() < number.WORST].tolist()
    if not judge:
        return None

    def fit(wrong):
        return robot.fit(tau=tau * _negative(wrong, nv).scale, joints=judge)

    def score(wrong):
        found = fit(wrong)
        against = {j for j, power in zip(judge, found.power) if power < -number.SURE}
        # A sign that friction contradicts is not a wrong one.
        if not against & wrong:
            scores[frozenset(wrong)] = found

    # Joint by joint, with bodies of their own; those that this leaves open together.
    gain = {j: _of_other_sign(robot, j) for j in judge}
    turned = {j for j in judge if gain[j] > number.DECISIVE}
    unclear = {j for j in judge if abs(gain[j]) <= number.DECISIVE}
    now = fit(())
    scores = {frozenset(): now}
    for wrong in (turned, *(turned | {j} for j in unclear), turned | unclear):
        if wrong and frozenset(wrong) not in scores:
            score(wrong)
    most = max(x.evidence for x in scores.values())
    near = [x for x, one in scores.items() if one.evidence > most - number.RIVAL]
    # That all signs are wrong is likelier than that those are right which do not show.
    every = frozenset(judge)
    best = every if every in near else min(near, key=len)
    if not best:
        return None
    # Joints that are explained too badly to be judged may say that theirs is right.
    others = [j for j in robot.joints.tolist() if j not in judge]
    if sum(_of_other_sign(robot, j) for j in others) < -number.RIVAL:
        every = frozenset()
    joints = reading.every if best == every else tuple(sorted(best))
    hidden = [j for j in joints if j not in turned] if best == every and nv > 1 else []
    also = listed_joints(reading.names, hidden)
    also = f" As all that can be seen are wrong, so is the sign of {also}." * bool(
        hidden
    )
    change = _negative(joints, nv)
    return Candidate(
        change=change,
        joints=joints,
        log_odds=odds(scores[best], now, nv if len(best) == 1 else 1),
        fall=scores[best].fall(now),
        remedy={"gains": tuple(change.scale.tolist())},
        facts={"also": also},
    )


def _of_other_sign(robot, j):
    """Return what the other sign of one torque gains, with bodies of its own."""
    tau = robot.signals.now
    return robot.fit(tau=-tau, joints=[j]).evidence - robot.fit(joints=[j]).evidence


def _negative(joints, nv):
    return Change(scale=np.where(np.isin(np.arange(nv), list(joints)), -1.0, 1.0))


# -- size ------------------------------------------------------------------------------


def _scaled(reading):
    """Return all torques over a factor against the described ones."""
    robot = reading.robot
    sizes = robot.sizes[robot.joints]
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    factor = float(np.median(sizes)) if sizes.size else 1.0
    columns, nothing = robot.described[:, :, None], np.zeros_like(robot.described)
    for _ in range(number.PASSES):
        fit = robot.fit(scale=factor, mean=nothing, columns=columns)
        before, factor = factor, float(fit.factors[0])
        if factor <= 0:
            return None
        if abs(np.log(factor / before)) < number.SETTLED:
            break
    if 1 / number.SCALE < factor < number.SCALE:
        return None
    error = float(fit.errors[0]) / factor
    return Candidate(
        change=Change(scale=1 / factor),
        joints=reading.every,
        log_odds=odds(robot.fit(scale=factor), robot.now),
        facts=_size_facts(factor, error, reading.nv),
    )


def _size_facts(factor, error, n_joints):
    # error: standard error of the logarithm.
    low, high = (factor * np.exp(x * number.INTERVAL * error) for x in (-1.0, 1.0))
    units = " or ".join(name for name, x in _UNITS.items() if low < 1 / x < high)
    unknown = ', or --gain unknown (Python: gains="unknown")' if n_joints > 1 else ""
    return {
        "factor": factor,
        "low": low,
        "high": high,
        "what": "motor currents, or in another unit"
        if factor < 1
        else "in another unit",
        "inside": f" ({units} would be inside)" if units else "",
        "gain": 1 / factor,
        "unknown": unknown,
    }


def size_message(factor, error, n_joints):
    """Say that all torques are so many times the described ones."""
    return SENTENCES["torque_unit"].format(**_size_facts(factor, error, n_joints))


def _scaled_each(reading):
    """Return torques of which one has another factor than the rest, or all have."""
    robot, nv = reading.robot, reading.nv
    columns = np.einsum("nj,jk->njk", robot.described, np.eye(nv))
    factors = np.where(np.isfinite(robot.sizes) & (robot.sizes > 0), robot.sizes, 1.0)
    for _ in range(number.PASSES):
        tau = robot.signals.now / factors
        fit = robot.fit(tau=tau, mean=np.zeros_like(tau), columns=columns)
        error = number.INTERVAL * fit.errors
        # Of joints that the masses hardly load, nothing is shown.
        known = (fit.factors > 2 * error) & (error < 1.0)
        more = np.where(known, fit.factors, 1.0)
        factors = factors * more
        if np.abs(np.log(more)).max() < number.SETTLED:
            break
    # Far from those of others, a factor may be uncertain.
    shown = np.flatnonzero(fit.factors > error)
    if not shown.size:
        return None
    logs = np.log(factors[shown])
    others = [np.delete(logs, k) for k in range(logs.size)]
    middle = np.array([np.median(x) if x.size else 0.0 for x in others])
    away = np.abs(logs - middle) > np.log(number.SINGLE)
    one = int(np.argmax(np.abs(logs) * away))
    # Of two joints, it is the one whose torque is farther from the described one.
    if away.sum() == 1 or (away.any() and shown.size == 2):
        # A doubt and not an error: a description with invented inertias looks the same.
        j = int(shown[one])
        change = Change(scale=np.where(np.arange(nv) == j, 1 / factors[j], 1.0))
        ratio = 1 / factors[j]
        ratio = f"{ratio:.3g}" if ratio > 1 else f"1/{1 / ratio:.3g}"
        facts = {"factor": factors[j], "ratio": ratio}
        return judged(reading, change, variants=nv, kind="gear_factor", facts=facts)
    if known.sum() < 2:
        return None
    logs = np.log(factors[known])
    # The factors of many hold two that are off by chance.
    ordered = np.sort(logs)[1:-1] if logs.size > 3 else np.sort(logs)
    if np.ptp(ordered) < np.log(number.SCALE):
        return None
    change = Change(scale=1 / np.where(known, factors, np.exp(logs.mean())))
    each = ", ".join(
        f"{reading.names[j]} {factors[j]:.2g}" for j in np.flatnonzero(known)
    )
    return judged(reading, change, joints=reading.every, facts={"each": each})


def _silent(reading):
    """Return a torque that does not follow a motion that should load it."""
    robot = reading.robot
    sizes = robot.sizes
    # Nor does it follow the motion of another joint, as if they were exchanged.
    least = 2 * np.log(number.UNRELATED)
    follows = (reading.rough_crossed < least).any(axis=0)
    follows = set(reading.few.joints[follows].tolist())
    for j, error in zip(robot.joints, robot.errors()):
        if j in follows:
            continue
        others = [k for k in robot.joints if k != j and np.isfinite(sizes[k])]
        usual = min(np.median(sizes[others]), 1.0) if others else 1.0
        if sizes[j] < number.SILENT * usual and error > number.UNRELATED:
            facts = {"size": sizes[j]}
            return Candidate(joints=(int(j),), log_odds=np.inf, facts=facts)
    return None


def _commanded(reading):
    """Return commanded torques whose order of magnitude contradicts the model."""
    sizes = reading.robot.sizes
    joints = [int(j) for j in reading.robot.joints if np.isfinite(sizes[j])]
    middle = float(np.median(sizes[joints])) if joints else 1.0
    if 1 / number.COMMANDED < middle < number.COMMANDED:
        return None
    return Candidate(
        change=Change(scale=1 / middle),
        joints=tuple(joints),
        log_odds=np.inf,
        kind="gear_factor:commanded",
        facts={"factor": middle, "numbers": reading.drive.numbers},
    )


def _beyond_limits(reading):
    """Return torques that are many times the limits of the description."""
    limit = np.asarray(reading.model.effortLimit, dtype=float)
    known = (limit > 0) & (limit < number.NO_LIMIT)
    most = np.quantile(np.abs(reading.tau), 0.995, axis=0)[known] / limit[known]
    # Limits that are all alike are invented.
    alike = np.unique(limit[known]).size < 2
    if alike or np.median(most) < number.BEYOND_LIMITS:
        return None
    return Candidate(
        joints=tuple(np.flatnonzero(known).tolist()),
        log_odds=np.inf,
        kind="torque_unit:limits",
        facts={"most": np.median(most)},
    )


def _of_another(reading):
    """Return torques that neither follow nor reach those of the description."""
    robot = reading.robot
    size, left = np.nanmedian(robot.sizes[robot.joints]), np.exp(0.5 * robot.now.left)
    small = size < 1 / number.SCALE and np.median(left) > number.OF_ANOTHER
    if not small and (left > number.UNFOLLOWED).sum() < max(2, left.size / 3):
        return None
    facts = {"size": size, "share": percent(np.median(left))}
    return Candidate(joints=reading.every, log_odds=np.inf, facts=facts)


# -- weight ----------------------------------------------------------------------------


def _loaded(robot, weight):
    """Joints that weights (n, nv) load, and the largest weight."""
    heavy = np.abs(weight).max(axis=0)
    return [int(j) for j in robot.joints if heavy[j] > 0.1 * heavy.max()], heavy.max()


def _as_springs(robot):
    """Return the evidence for springs between all joints, the weight as described."""
    # In a small motion the lack of weight, or its turn, is linear in the positions.
    nv, tau = robot.signals.now.shape[1], robot.signals.now
    q = robot.signals.states[:, :nv]
    q = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-300)
    columns = np.einsum("ni,jk->njik", q, np.eye(nv) * np.sqrt((tau**2).mean(axis=0)))
    columns = columns.reshape(len(q), nv, nv * nv)
    return robot.fit(columns=columns, deviation=1.0).evidence


def _weightless(reading):
    """Return torques without the weight of the links."""
    robot, down, share, scale = reading.robot, reading.bodies.pull, 1.0, 1.0
    moving, weight = robot.moving, robot.weight
    columns, nothing = np.stack([moving, weight], axis=-1), np.zeros_like(moving)
    for _ in range(number.PASSES):
        entries = robot.pulled(share * down)
        fit = robot.fit(entries, scale=scale, mean=nothing, columns=columns)
        error = number.INTERVAL * fit.errors
        # What may be N m is, and slow motion does not show the scale.
        part = float(fit.factors[0])
        shown = part > 2 * error[0]
        scale = part if shown and not 1 / number.SCALE < part < number.SCALE else 1.0
        before, share = share, float(fit.factors[1]) / scale
        if share - error[1] / scale > number.NO_WEIGHT:
            return None
        if abs(share - before) < number.SETTLED * error[1] / scale:
            break
    # Slow motion may ask for another inertia, though the weight is there in N m.
    there = fit.factors[1] > max(error[1], 1 / number.SCALE)
    if there or abs(share) + error[1] / scale > number.NO_WEIGHT:
        return None
    # Without any weight, or with that of the description taken off.
    added = robot.fit(mean=scale * moving, scale=scale)
    without = robot.fit(robot.pulled(0 * down), scale=scale)
    best = max(without, added, key=lambda fit: fit.evidence)
    # As little weight have torques in another unit, if inertia does not show that.
    small = robot.fit(scale=share).evidence if share > 0 and not shown else -np.inf
    if max(_as_springs(robot), small) > best.evidence - number.RIVAL:
        return None
    now = max(robot.now.evidence, robot.fit(scale=scale).evidence)
    joints, heavy = _loaded(robot, weight)
    # What balances a single joint is likelier a spring.
    severity, other = "error", ""
    if len(joints) < 2:
        severity, other = "doubt", " Or a spring balances it."
    facts = {"share": share, "error": error[1] / scale, "heavy": heavy, "other": other}
    return Candidate(
        joints=tuple(joints),
        log_odds=best.evidence - now + number.PRIOR,
        severity=severity,
        facts=facts,
    )


def _static(reading):
    """Return torques that hold nothing but the weight of the links."""
    robot = reading.robot
    columns = np.stack([robot.moving, robot.weight], axis=-1)
    fit = robot.fit(mean=np.zeros_like(robot.moving), columns=columns)
    error = number.INTERVAL * fit.errors
    part, weight = fit.factors
    # Or exactly the described weight, though the motion needs more.
    exact = _share_beside(robot, robot.weight).max() < number.COMPUTED
    exact &= _share_beside(robot, robot.described).max() > 2 * number.COMPUTED
    # A model has no friction either.
    rubs = (fit.power > number.SURE).any()
    slow = abs(part) + error[0] > number.NO_WEIGHT or weight < error[1]
    if (slow or rubs) and not exact:
        return None
    still = robot.fit(robot.entries - robot.pulled(np.zeros(3)))
    return Candidate(
        joints=reading.every,
        log_odds=np.inf if exact else odds(still, robot.now),
        facts={"part": part, "error": 0.0 if exact else error[0]},
    )


def _share_beside(robot, torques):
    """Return how far each torque is from others (n, nv), in its deviations."""
    left, rows, now = robot.signals.now - torques, robot.rows, robot.signals.now
    return np.sqrt(
        [
            np.mean(left[rows[j], j] ** 2) / (now[rows[j], j].var() + 1e-300)
            for j in robot.joints
        ]
    )


def _computed(reading):
    """Return torques that are those of the description: no friction, no noise."""
    robot = reading.robot
    share = _share_beside(robot, robot.described)
    # A single joint may well be without friction.
    if share.size < 2 or share.max() > number.COMPUTED:
        return None
    facts = {"share": percent(share.max())}
    return Candidate(joints=reading.every, log_odds=np.inf, facts=facts)


def _turned(reading):
    """Return another orientation of the base than described."""
    robot, start = reading.robot, reading.bodies.pull
    usual = np.linalg.norm(start)

    def fitted(pull):
        entries = robot.pulled(pull)
        return robot.fit(entries, mean=robot.moving, columns=robot.by_gravity)

    fit = fitted(start)
    if np.linalg.norm(fit.factors - start) < 0.5 * number.TURNED * usual:
        return None
    axes = usual * np.vstack([np.eye(3), -np.eye(3)])
    pull, turned = _best_pull(robot, start, [fit.factors, *axes])
    for _ in range(number.PASSES):
        fit = fitted(pull)
        pull, better = _best_pull(robot, pull, [fit.factors])
        if better.evidence < turned.evidence + number.SETTLED:
            break
        turned = better
    # What the motion does not show of the direction stays as described.
    values, turn = np.linalg.eigh(fit.covariance)
    shown = turn[:, values < number.UNSHOWN**2]
    found, hidden = shown @ (shown.T @ fit.factors), start - shown @ (shown.T @ start)
    size, rest = np.linalg.norm(found), np.linalg.norm(hidden)
    if rest > 1e-6 * usual:
        hidden = hidden / rest * np.sqrt(max(usual**2 - size**2, 0.0))
        size = max(size, usual)
    pull = found + hidden
    pull = pull * usual / np.linalg.norm(pull)
    angle = float(np.arccos(np.clip(pull @ start / usual**2, -1, 1)))
    # A spring that more than balances a single joint looks the same.
    if (
        not 1 / number.AS_HEAVY < size / usual < number.AS_HEAVY
        or len(_loaded(robot, robot.by_gravity @ pull)[0]) < 2
    ):
        return None
    turned = robot.fit(robot.pulled(pull))
    shown = ", ".join(f"{x:.2f}" for x in pull / usual)
    if _as_springs(robot) > turned.evidence - number.RIVAL:
        return None
    return Candidate(
        change=Change(gravity=9.81 * pull),
        joints=reading.every,
        log_odds=odds(turned, robot.now),
        clear=angle > number.TURNED,
        facts={"angle": np.degrees(angle), "pull": shown},
    )


def _best_pull(robot, pull, others):
    """Return the direction of gravity of most evidence, as large, and its fit."""
    usual = np.linalg.norm(pull)
    pulls = [pull, *(usual * x / max(np.linalg.norm(x), 1e-300) for x in others)]
    fits = [robot.fit(robot.pulled(x)) for x in pulls]
    best = int(np.argmax([one.evidence for one in fits]))
    return pulls[best], fits[best]


# -- lag -------------------------------------------------------------------------------


def _lag(reading):
    """Return a lag common to all torques, or a low-pass of them."""
    first, error = _slope(reading.robot)
    if not abs(first) > number.LEAST_LAG * error:
        return None
    samples, gained, after = 0.0, 0.0, reading
    for _ in range(number.MOVES):
        if after.tell_nothing():
            return None
        more, spread, gain = _shift(after.robot)
        samples, gained = samples + more, gained + gain
        if np.isfinite(spread):
            break
        after = reading.changed(Change(lag=round(samples)))
    if not abs(samples) > number.LEAST_LAG * spread:
        return None
    seconds, error = samples * reading.dt, number.INTERVAL * spread * reading.dt
    filtered = samples > 0 and _lowpass(reading.robot, samples)
    # Of the two, a lag is what is corrected; a filter has to be the likelier by far.
    lowpass = filtered and filtered > gained + number.DECISIVE
    return Candidate(
        change=Change(lag=round(samples)),
        joints=reading.every,
        log_odds=(filtered if lowpass else gained) + number.PRIOR,
        kind="torque_lowpass" if lowpass else "delay",
        value=seconds,
        facts={
            "size": 1e3 * abs(seconds),
            "error": 1e3 * error,
            "late": "late" if seconds > 0 else "early",
        },
    )


def _slopes(robot):
    """Return derivatives (n, nv) of the torques by the sample."""
    shifts, tau = robot.signals.shifts, robot.signals.tau
    middle = shifts.size // 2
    return (tau[..., middle + 1] - tau[..., middle - 1]) / (2.0 * shifts[middle + 1])


def _slope(robot):
    """Return a small lag [samples] common to all torques, and its error."""
    fit = robot.fit(columns=-_slopes(robot)[:, :, None])
    return float(fit.factors[0]), float(fit.errors[0])


def _shift(robot):
    """Return the lag [samples] common to all torques, its deviation and the gain."""
    # Positive if torques are late. The gain is that of the evidence; the deviation is
    # infinite where the lag exceeds the shifts.
    shifts, middle = robot.signals.shifts, robot.signals.shifts.size // 2
    fits = [robot.fit(tau=x) for x in np.moveaxis(robot.signals.tau, -1, 0)]
    evidence = np.array([one.evidence for one in fits])
    best = int(np.argmax(evidence))
    gain = float(evidence[best] - evidence[middle])
    step = float(shifts[1] - shifts[0])
    change = fits[best].left - fits[middle].left
    harm = number.HARM * max(1.0, -change.sum())
    shared = change.size > 1 and (change < 0).mean() > 0.5 and change.max() < harm
    # Friction with memory looks like a lag of its joint, and others get worse.
    if best != middle and not shared:
        return 0.0, 1.0, 0.0
    if best in (0, shifts.size - 1):
        return float(shifts[best]), np.inf, gain
    low, high, after = evidence[best - 1 : best + 2]
    bend = low - 2 * high + after
    if bend >= 0:
        return step * (best - middle), step, gain
    vertex, spread = 0.5 * (low - after) / bend, 1 / np.sqrt(-bend)
    # The top lies between shifts.
    gain += 0.25 * (after - low) * vertex
    return step * (best - middle + vertex), step * spread, gain


def _lowpass(robot, samples):
    """Gain of the evidence by a low-pass of all torques, of some time constants."""
    # What a filter of first order let through is undone by its derivative.
    now, slope = robot.signals.now, _slopes(robot)
    made = [now + part * samples * slope for part in number.CONSTANTS]
    return max(robot.fit(tau=y).evidence for y in made) - robot.now.evidence


# -- torques without signs -------------------------------------------------------------


def unsigned_torques(reading):
    """Find torques of which only sizes were logged."""
    tau, signals = reading.tau, reading.signals
    # Where they are, all of one sign are: what loads a joint little shows nothing.
    one_way = (tau >= 0).all(axis=0) | (tau <= 0).all(axis=0)
    one_way = np.flatnonzero(one_way & reading.usable.any(axis=0)).tolist()
    if not one_way or signals is None:
        return []
    regressor, bodies = TreeRegressor(reading.model), nominal_parameters(reading.model)
    explanations = signed_columns(regressor, signals.states, bodies)
    still = signals.states.copy()
    still[:, reading.nv :] = 0.0
    weights = signed_columns(regressor, still, bodies)
    found = False
    for j in one_way:
        columns, sizes = explanations[j], np.abs(signals.now[:, j])
        more = np.column_stack([columns, weights[j][:, 0]])
        plain = more @ np.linalg.lstsq(more, sizes)[0]
        left = ((sizes - plain) ** 2).sum()
        if left < number.GOOD_FIT**2 * sizes.var() * sizes.size:
            continue
        made = columns @ most_explaining(columns, sizes)
        least = min((made < 0).mean(), (made > 0).mean())
        signed = ((sizes - np.abs(made)) ** 2).sum()
        found |= number.SIGN_GAIN * signed < left and least > number.RARE
    if not found:
        return []
    drive = {"drive": UNSIGNED}
    args = "unsigned_torque", reading.names, one_way, "error"
    return [finding(*args, remedy=drive, **drive)]


def signed_columns(regressor, states, bodies):
    """Make the columns that torques may consist of, nv arrays (n, 5)."""
    # regressor: with a method `torques` of bodies (nv, 10). Rigid bodies, dry and
    # viscous friction, inertia, and an offset.
    q, v, a = map(np.ascontiguousarray, np.split(states, 3, axis=1))
    rigid = regressor.torques(q, v, a, np.ascontiguousarray(bodies))
    columns = rigid, np.sign(v), v, a, np.ones_like(v)
    return [np.column_stack([x[:, j] for x in columns]) for j in range(v.shape[1])]


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


def _measured(reading):
    return not reading.commanded


def _poor_measured(reading):
    return _measured(reading) and reading.poor


def _measured_weight(reading):
    return not (reading.commanded or reading.bodies.weightless)


HYPOTHESES = (
    Hypothesis("torque_sign", "error", _signs),
    Hypothesis("torque_unit", "doubt", _scaled, _measured),
    Hypothesis("torque_factors", "doubt", _scaled_each, _measured),
    Hypothesis("gear_factor", "doubt", _commanded, lambda reading: reading.commanded),
    Hypothesis("no_gravity", "error", _weightless, _measured_weight, repairs=False),
    Hypothesis("gravity_only", "error", _static, _measured_weight, repairs=False),
    Hypothesis("base_orientation", "error", _turned, _measured_weight),
    Hypothesis("computed_torque", "doubt", _computed, _measured, repairs=False),
    Hypothesis("silent_torque", "error", _silent, _measured, repairs=False),
)
# Looked for once nothing else is found.
LAST = (
    Hypothesis("external_force", "doubt", contact, _poor_measured, repairs=False),
    Hypothesis("delay", "warning", _lag, _measured, repairs=False),
    Hypothesis("torque_unit", "doubt", _beyond_limits, _measured, repairs=False),
)
# If there is no other finding.
OTHER = Hypothesis("other_robot", "doubt", _of_another, _poor_measured, repairs=False)
