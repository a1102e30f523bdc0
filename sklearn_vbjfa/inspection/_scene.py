"""What acts on the whole robot: weight and its direction, a lag, a contact."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa._core._linear_systems import orthonormal_basis
from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._likelihood import DescribedRobot
from sklearn_vbjfa.inspection._reading import Change, Proposal
from sklearn_vbjfa.inspection._sentences import percent

# -- weight ----------------------------------------------------------------------------


def weightless(reading):
    """Return joints whose torques do not contain the weight of the links."""
    robot = reading.robot
    nothing, moving = robot.pulled(np.zeros(3)), robot.moving

    def gain(joints):
        """Log odds of no weight on some joints; zero if springs do nearly as well."""
        now = robot.fit(joints=joints).evidence
        # Without any weight, or with that of the description taken off.
        made = robot.fit(nothing, joints=joints), robot.fit(mean=moving, joints=joints)
        most = max(one.evidence for one in made)
        if most - now <= number.DECISIVE:
            return 0.0
        # Springs on several joints are as rare as other faults of each; a single joint
        # may have a counterbalance.
        springs = robot.with_springs(joints, turns=len(joints) == 1 < len(loaded))
        springs += number.PRIOR * (len(joints) - 1)
        return most - now if most - springs > number.DECISIVE else 0.0

    # A weight that does not vary is like an offset.
    loaded = _loaded(robot, robot.weight - robot.weight.mean(axis=0))
    each = {j: gain([j]) for j in loaded}
    lost, odds = [j for j in loaded if each[j]], sum(each.values())
    # Together joints show more, since they carry the same bodies.
    if len(loaded) > 1 and (whole := gain(loaded)) > odds:
        lost, odds = loaded, whole
    if lost == loaded:
        # Other joints agree, as with any other hypothesis on all torques.
        odds = max(odds, gain(robot.joints.tolist()))
    # Slides hold a weight in whatever direction gravity pulls.
    pull = np.linalg.norm(robot.by_gravity, axis=-1)
    held, weight = (
        np.linalg.norm(x.mean(axis=0)[reading.slides])
        for x in (robot.signals.tau, pull)
    )
    if not lost or held > number.HELD * weight > 0:
        return None
    columns = np.stack([moving, robot.weight], axis=-1)
    mean = np.zeros_like(moving)
    fit = robot.fit(nothing, mean=mean, columns=columns, joints=lost)
    # A controller takes off the described weight, whatever the bodies weigh.
    taken = robot.fit(columns=robot.weight[:, :, None], deviation=1.0, joints=lost)
    shares = fit.factors[1], 1.0 + taken.factors[0]
    errors = number.INTERVAL * np.array([fit.errors[1], taken.errors[0]])
    share, error = min(zip(shares, errors), key=lambda one: abs(one[0]))
    if abs(share) + error > number.NO_WEIGHT:
        return None
    heavy = np.abs(robot.weight[:, lost]).max()
    facts = {"share": share, "error": error, "heavy": heavy, "other": ""}
    some = abs(share) > max(2 * error, number.GOOD_FIT)
    facts["part"] = "only a part of the weight" if some else "no weight"
    if len(loaded) == 1:
        facts["other"] = " Or a spring balances it, or the base is mounted otherwise."
    return Proposal(
        joints=tuple(lost),
        log_odds=odds,
        kind="no_gravity:joints" if len(lost) < len(loaded) else "",
        severity="warning" if len(lost) < max(2, len(loaded)) else "",
        facts=facts,
    )


def weight_alone(reading):
    """Return torques that hold nothing but the weight of the links."""
    robot = reading.robot
    columns = np.stack([robot.moving, robot.weight], axis=-1)
    fit = robot.fit(mean=np.zeros_like(robot.moving), columns=columns)
    error = number.INTERVAL * fit.errors
    part, weight = fit.factors
    slow = abs(part) + error[0] > number.NO_WEIGHT or weight < error[1]
    # A model has no friction either.
    if slow or (fit.power > number.SURE).any():
        return None
    still = robot.fit(robot.entries - robot.pulled(np.zeros(3))).evidence
    facts = {"part": part, "error": error[0]}
    odds = still - robot.now.evidence
    return Proposal(joints=reading.every, log_odds=odds, facts=facts)


def turned(reading):
    """Return another orientation of the base than described."""
    robot, start, found = reading.robot, reading.bodies.pull, reading.robot.now
    usual, pull = np.linalg.norm(start), start
    # What the motion does not show of the direction stays as described, or is zero.
    free = {"columns": robot.by_gravity, "deviation": 1.0}
    fit = robot.fit(**free)
    if np.linalg.norm(fit.factors) < 0.5 * number.TURNED * usual:
        return None
    whole, shown = start + fit.factors, fit.errors < 0.5
    still = robot.fit(robot.pulled(np.zeros(3)), **free)
    tried = [whole, still.factors, *np.eye(3), *-np.eye(3)]
    variants = len(tried)
    for _ in range(number.PASSES):
        tried = [usual * x / max(np.linalg.norm(x), 1e-300) for x in tried]
        fits = [robot.fit(robot.pulled(x)) for x in tried]
        best = int(np.argmax([one.evidence for one in fits]))
        if fits[best].evidence < found.evidence + number.SETTLED:
            break
        pull, found = tried[best], fits[best]
        whole = pull + robot.fit(robot.pulled(pull), **free).factors
        tried = [whole]
    # A spring that more than balances a single joint looks the same.
    heavy = 1 / number.AS_HEAVY < np.linalg.norm(whole) / usual < number.AS_HEAVY
    loaded = _loaded(robot, robot.by_gravity @ pull)
    odds = found.evidence - robot.now.evidence - np.log(variants)
    springs = robot.springs > odds - number.DECISIVE
    # Nor is it a weight that only offsets would hide: that of slides may have a sign.
    largest = np.abs(robot.by_gravity @ pull).max(axis=0)[loaded]

    def offsets(pull):
        left = (robot.signals.tau - robot.by_gravity @ pull).mean(axis=0)[loaded]
        return np.square(left / largest).sum()

    pull = min(pull, np.where(shown, pull, -pull), key=offsets)
    hidden = offsets(pull) > max(offsets(np.zeros(3)), number.GOOD_FIT**2)
    if not heavy or len(loaded) < 2 or springs or hidden:
        return None
    fall = found.fall(robot.now)
    angle = float(np.arccos(np.clip(pull @ start / usual**2, -1, 1)))
    return Proposal(
        change=Change(gravity=9.81 * pull),
        joints=reading.every,
        log_odds=odds,
        fall=fall,
        clear=angle > number.TURNED and fall >= number.CLEAR * len(loaded),
        facts={
            "angle": np.degrees(angle),
            "pull": ", ".join(f"{x:.2f}" for x in pull / usual),
        },
    )


def _loaded(robot, weight):
    """List the joints that weights (n, nv) load."""
    heavy = np.abs(weight).max(axis=0)
    return [int(j) for j in robot.joints if heavy[j] > 0.1 * heavy.max()]


# -- lag -------------------------------------------------------------------------------


def late(reading):
    """Return a lag common to all torques, or a low-pass of them."""
    first, whole, after = _moving(reading, reading), 0, reading
    for _ in range(number.MOVES):
        robot = first if after is reading else _moving(reading, after)
        signals = robot.signals
        fit = robot.fit(columns=-signals.slope[:, :, None])
        rest, error = float(fit.factors[0]), float(fit.errors[0])
        samples = whole + rest
        if not abs(samples) > number.LEAST_LAG * error:
            return None
        if abs(rest) < number.SAMPLE:
            break
        whole += round(rest)
        after = reading.changed(Change(lag=whole))
        if after.tell_nothing():
            return None
    then = robot.fit(tau=signals.tau + rest * signals.slope)
    now = robot.fit(tau=reading.signals.tau)
    gain, change = then.evidence - now.evidence, then.left - now.left
    drifts = _drift(reading, robot, then)
    if drifts is not None:
        return drifts
    # Friction with memory looks like a lag of its joint, and others get worse.
    harm = number.HARM * max(1.0, -change.sum())
    if change.size < 2 or (change < 0).mean() <= 0.5 or change.max() >= harm:
        return None
    # Of the two, a lag is what is corrected; a filter has to be the likelier by far.
    filtered = _lowpass(first, samples) if samples > 0 else -np.inf
    lowpass = filtered > gain + number.DECISIVE
    seconds = samples * reading.dt
    facts = {"size": 1e3 * abs(seconds), "late": "late" if seconds > 0 else "early"}
    facts |= {"error": 1e3 * number.INTERVAL * error * reading.dt}
    return Proposal(
        joints=reading.every,
        log_odds=filtered if lowpass else gain,
        kind="torque_lowpass" if lowpass else "delay:alone" * reading.alone,
        value=seconds,
        facts=facts,
    )


def _moving(reading, after):
    """Return the robot of a shifted reading in rows whose whole low-pass moves."""
    # Friction turns before or after the velocity where a joint stops.
    known, signals = (reading.robot.times, reading.robot.entries), after.signals
    moving = replace(signals, weight=signals.throughout)
    robot = DescribedRobot(reading.bodies, moving, *known)
    if robot.joints.size < reading.robot.joints.size:
        return DescribedRobot(reading.bodies, signals, *known)
    return robot


def _drift(reading, robot, steady):
    """Return a lag that grows with the time."""
    # robot: of torques that are read later by what is whole of the lag; steady:
    # `BodyFit` with a lag that stays the same.
    signals = robot.signals
    since = (signals.row - signals.row.mean()) / np.ptp(signals.row)
    columns = -np.stack([signals.slope, since[:, None] * signals.slope], axis=-1)
    fit = robot.fit(columns=columns)
    total, error = float(fit.factors[1]), float(fit.errors[1])
    if len(reading.parts) > 1 or abs(total) < max(number.LEAST_LAG * error, 1.0):
        return None
    found = robot.fit(tau=signals.tau - columns @ fit.factors)
    # Every joint shares the clock.
    if (found.left - steady.left).max() > 0 or found.fall(steady) < number.CLEAR:
        return None
    share = total / np.ptp(signals.row)
    facts = {"ahead": "fast" if share > 0 else "slow", "share": percent(abs(share))}
    facts |= {"size": 1e3 * abs(total) * reading.dt}
    args = {"kind": "delay:drift", "severity": "warning", "facts": facts}
    odds = found.evidence - robot.fit(tau=reading.signals.tau).evidence
    return Proposal(joints=reading.every, log_odds=odds, value=share, **args)


def _lowpass(robot, samples):
    """Gain of the evidence by a low-pass of all torques, of some time constants."""
    # What a filter of first order let through is undone by its derivative.
    now, slope = robot.signals.tau, robot.signals.slope
    made = [now + part * samples * slope for part in number.CONSTANTS]
    return max(robot.fit(tau=y).evidence for y in made) - robot.now.evidence


# -- contact ---------------------------------------------------------------------------


def contact(reading):
    """Return an interval in which something else acts, with torques that are even."""
    robot, rows = reading.robot, reading.signals.row
    place, inside = _pushed(robot), np.zeros(rows.size, dtype=bool)
    # Within the recording in which its middle lies.
    stops = [part.stop for part in reading.parts]
    k = int(np.searchsorted(stops, rows[sum(place) // 2], side="right"))
    first, last = reading.parts[k].start, stops[k] - 1
    step, edges = rows.size // number.CONTACT_ENDS, np.searchsorted(rows, (first, last))
    # What lasts from the beginning, or to the end, may be a payload, which effects say.
    if (np.abs(edges - place) <= step).any():
        return None
    inside[slice(*place)] = True
    # A contact makes what is left correlated for as long as it lasts.
    times = robot.correlation_times(inside[:, None].astype(float))
    times = np.minimum(robot.times, times)
    robot = DescribedRobot(robot.bodies, robot.signals, times, robot.entries)
    size = robot.signals.tau[:, robot.joints].std(axis=0)
    columns = np.eye(reading.nv) * inside[:, None, None]
    fit, now = robot.fit(columns=columns, deviation=size.max()), robot.now
    torques = (columns @ fit.factors)[inside][:, robot.joints]
    push = np.sqrt((torques**2).mean(axis=0)) / (size * np.exp(0.5 * fit.left))
    felt = push > number.CONTACT
    # Friction of a single joint varies.
    few = felt.sum() < min(robot.joints.size, 2)
    odds = fit.evidence - now.evidence - np.log(rows.size)
    if few or fit.fall(now) < number.CLEAR_OF_JOINT or not robot.surpasses(odds):
        return None
    # A force on a link loads most of the joints before it.
    farthest = int(robot.joints[felt][-1])
    before = np.array(reading.model.supports[farthest + 1])[1:] - 1
    if felt[np.isin(robot.joints, before)].mean() < 0.5:
        return None
    ends = np.clip(rows[np.minimum(place, rows.size - 1)], first, last) - first
    begin, end = ends * reading.dt
    where = "after the start" if len(stops) == 1 else f"of recording {k + 1}"
    joints = robot.joints[felt]
    each = zip(joints, torques.mean(axis=0)[felt], reading.slides[joints])
    pushes = [
        f"{reading.names[j]} {torque:+.2g} {'N' if slides else 'N m'}"
        for j, torque, slides in each
    ]
    return Proposal(
        joints=tuple(joints.tolist()),
        log_odds=odds,
        facts={"begin": begin, "end": end, "where": where, "pushes": ", ".join(pushes)},
    )


def _pushed(robot):
    """Rows between which even torques explain most of what free bodies leave."""
    n, fall = len(robot.signals.tau), 0.0
    ends = np.arange(0, n + 1, max(1, n // number.CONTACT_ENDS))
    long = ends - ends[:, None]
    first, last = np.nonzero((long >= n // number.SHORTEST_CONTACT) & (long <= n // 2))
    first, last = ends[first], ends[last]
    for j in robot.joints:
        # Of the torque, and of one that is even between the rows, what is left.
        basis, moves = orthonormal_basis(robot.free(j)), robot.signals.weight[:, j] > 0
        y = robot.signals.tau[:, j] * moves
        y = y - basis @ (basis.T @ y)
        sums = np.vstack([np.zeros(len(basis.T) + 2), np.c_[basis, y, moves]])
        *bases, product, rows = np.diff(sums.cumsum(axis=0)[[first, last]], axis=0)[0].T
        size = np.maximum(rows - np.square(bases).sum(axis=0), 1.0)
        share = product**2 / size / max(y @ y, 1e-300)
        fall = fall - np.log1p(-np.minimum(share, 1.0 - np.finfo(float).eps))
    k = int(np.argmax(fall))
    return first[k], last[k]
