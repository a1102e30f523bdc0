"""Hypotheses on time and scene: sample period, lag, gravity's direction, contact."""

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._joints import poor
from sklearn_vbjfa.inspection._likelihood import DescribedRobot
from sklearn_vbjfa.inspection._reading import (
    Candidate,
    Hypothesis,
    Reading,
    every,
    late,
    of,
    score_of,
)
from sklearn_vbjfa.inspection._signals import Change
from sklearn_vbjfa.inspection._torques import as_springs, loaded
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.recording import ChannelFinding

# -- sample period ---------------------------------------------------------------------


def fastest(model):
    """Impossible speeds (nv,) [rad/s or m/s]: five times each limit, given or usual."""
    limit = np.asarray(model.velocityLimit, dtype=float)
    usual = np.where(is_prismatic(model), number.FASTEST_SLIDE, number.FASTEST_TURN)
    known = (limit > 0) & (limit < 1e3)
    return number.TOO_FAST * np.where(known, limit, usual)


def speeds(reading):
    """Speed of each joint that is seldom exceeded, ndarray of shape (nv,)."""
    width, q = number.SPEED_SAMPLES, reading.q
    travel = [np.abs(q[p][width:] - q[p][:-width]) for p in reading.parts]
    fast = np.quantile(np.concatenate(travel), 0.995, axis=0)
    return fast / (width * reading.dt)


def too_fast(reading):
    """Find a sample period at which no robot could move as recorded."""
    speed, limit = speeds(reading), fastest(reading.model)
    j = int(np.argmax(speed / limit))
    if speed[j] <= limit[j]:
        return []
    unit = "m/s" if reading.slides[j] else "rad/s"
    message = (
        f"Implausible speed: with dt={reading.dt:.6g} s {reading.names[j]} moves at "
        f"{speed[j]:.3g} {unit}, and {limit[j]:.3g} would be five times what it can; "
        "give dt as the sample period in seconds, and positions in rad or m."
    )
    # Accelerations are wrong by the square.
    return [ChannelFinding("wrong_dt", every(reading), "error", message)]


def _periods(reading):
    """Return the best other sample period."""
    dt, ratio = reading.dt, (speeds(reading) / fastest(reading.model)).max()
    special = (1e-3, 1 / dt**2) if dt >= number.LONG_PERIOD else ()
    changes = [
        Change(period=period)
        for period in dict.fromkeys([*number.PERIODS, *special])
        if ratio <= period
    ]
    scores = [(reading.tried(change), change) for change in changes]
    scores = [(score, change) for score, change in scores if score is not None]
    best = max(scores, key=lambda x: x[0].evidence, default=None)
    if best is None:
        return None
    score, change = best
    # Another period changes inertia against weight: torques without either look alike.
    robot, moving = reading.robot, reading.robot.pulled(np.zeros(3))
    for rest in (moving, robot.entries - moving):
        rival = score_of(robot, robot.fit(rest))
        if rival.evidence > score.evidence - number.RIVAL:
            return None
    fall, count = score.fall(reading.now), reading.robot.joints.size
    if fall < number.CLEAR_OF_JOINT * count:
        return None
    return Candidate(
        change=change,
        joints=every(reading),
        log_odds=of(score, reading.now, len(changes)),
        fall=fall,
    )


def _say_period(reading, candidate):
    dt, period = reading.dt, candidate.change.period
    factor = np.exp(candidate.fall / reading.robot.joints.size)
    return (
        f"dt={dt:.6g} s is inconsistent with the motion: with a period of "
        f"{dt * period:.2g} s the squared torque errors fall by the factor "
        f"{factor:.3g} (log odds {candidate.log_odds:.0f}){_other_units(dt)}; dt is "
        "the sample period in seconds."
    )


def _other_units(dt):
    if dt < number.LONG_PERIOD:
        return ""
    unit = "milliseconds or " if dt < 100 else ""
    return f"; it looks like {unit}a rate in Hz: give {dt / 1e3:.6g} or {1 / dt:.6g}"


def crawling(reading):
    """Find a motion so slow that its time may be in another unit."""
    speed, limit = speeds(reading), fastest(reading.model)
    j = int(np.argmax(speed / limit))
    share = number.TOO_FAST * speed[j] / limit[j]
    if share >= number.TOO_SLOW or reading.dt < number.LONG_PERIOD:
        return []
    unit = "m/s" if reading.slides[j] else "rad/s"
    message = (
        f"dt={reading.dt:.6g} s is inconsistent with the motion: the fastest joint, "
        f"{reading.names[j]}, moves at {speed[j]:.2g} {unit}, {share:.1g} of what it "
        f"can{_other_units(reading.dt)}; dt is the sample period in seconds."
    )
    # Hardly moving for hours may be on purpose.
    return [ChannelFinding("wrong_dt", every(reading), "doubt", message)]


# -- base ------------------------------------------------------------------------------


def _turned(reading):
    """Return another orientation of the base than described."""
    robot = reading.robot
    start = pull = robot.bodies.pull
    for _ in range(number.PASSES):
        entries = robot.pulled(pull)
        fit = robot.fit(entries, mean=robot.moving, columns=robot.by_gravity)
        pull = fit.factors
    size, usual = np.linalg.norm(pull), np.linalg.norm(start)
    if not 1 / number.AS_HEAVY < size / usual < number.AS_HEAVY:
        return None
    # A spring that more than balances a single joint looks the same.
    if len(loaded(robot, robot.by_gravity @ pull)[0]) < 2:
        return None
    # What the motion does not show of the direction stays as described.
    if fit.errors.max() > number.UNSHOWN:
        return None
    angle = float(np.arccos(np.clip(pull @ start / size / usual, -1, 1)))
    if angle < number.TURNED:
        return None
    pull = pull * usual / size
    turned = robot.fit(robot.pulled(pull))
    if as_springs(robot) > turned.evidence - number.RIVAL:
        return None
    score = score_of(robot, turned)
    return Candidate(
        change=Change(gravity=9.81 * pull),
        joints=every(reading),
        log_odds=of(score, reading.now, 1),
        values={"angle": np.degrees(angle)},
    )


def _say_turned(reading, candidate):
    pull = candidate.change.gravity
    shown = ", ".join(f"{x:.2f}" for x in pull / np.linalg.norm(pull))
    return (
        f"By the torques, gravity pulls along ({shown}) of the base frame, "
        f"{candidate.values['angle']:.0f} degrees from the description: the base is "
        "mounted in another orientation, as on a wall or a ceiling. Turn it in the "
        "description."
    )


# -- lag -------------------------------------------------------------------------------


def _lag(reading):
    """Return a lag common to all torques, or a low-pass of them."""
    samples, gained, after = 0.0, 0.0, reading
    for _ in range(number.MOVES):
        if after.signals is None:
            return None
        more, spread, gain = _shift(after.robot)
        samples, gained = samples + more, gained + gain
        if np.isfinite(spread):
            break
        after = _later(reading, round(samples))
    log_odds = gained + number.PRIOR
    if not abs(samples) > number.LEAST_LAG * spread:
        return None
    values = {"seconds": samples * reading.dt, "error": spread * reading.dt}
    filtered = samples > 0 and _lowpass(reading.robot, samples)
    if filtered and filtered > gained + number.RIVAL:
        log_odds, values["name"] = filtered + number.PRIOR, "torque_lowpass"
    return Candidate(
        change=Change(lag=round(samples)),
        joints=every(reading),
        log_odds=log_odds,
        values=values,
    )


def _later(reading, samples):
    """Return the log with torques that are read some samples later."""
    tau, usable = late(reading.tau, samples, reading.parts, reading.usable)
    known = reading.q, tau, reading.dt, reading.parts, usable
    return Reading(reading.model, reading.names, *known)


def _shift(robot):
    """Return the lag [samples] common to all torques, its deviation and the gain."""
    # Positive if torques are late. The gain is that of the evidence; the deviation is
    # infinite where the lag exceeds the shifts.
    shifts, middle = robot.signals.shifts, robot.signals.shifts.size // 2
    fits = [robot.fit(tau=x) for x in robot.signals.tau.transpose(2, 0, 1)]
    evidence = np.array([one.evidence for one in fits])
    best = int(np.argmax(evidence))
    gain = float(evidence[best] - evidence[middle])
    step = float(shifts[1] - shifts[0])
    if best in (0, shifts.size - 1) and fits[best].noise.size > 1:
        return float(shifts[best]), np.inf, gain
    change = np.log(fits[best].noise / fits[middle].noise)
    shared = (
        change.size > 1 and (change < 0).mean() > 0.5 and change.max() < number.HARM
    )
    if (best != middle and not shared) or not 0 < best < shifts.size - 1:
        return 0.0, 1.0, 0.0
    low, high, after = evidence[best - 1 : best + 2]
    bend = low - 2 * high + after
    if bend >= 0:
        return step * (best - middle), step, gain
    vertex, spread = 0.5 * (low - after) / bend, 1 / np.sqrt(-bend)
    return step * (best - middle + vertex), step * spread, gain


def _lowpass(robot, samples):
    """Gain of the evidence by a low-pass of all torques, of some time constants."""
    # What a filter of first order let through is made undone by its derivative.
    tau, middle = robot.signals.tau, robot.signals.shifts.size // 2
    step = float(robot.signals.shifts[1] - robot.signals.shifts[0])
    slope = (tau[:, :, middle + 1] - tau[:, :, middle - 1]) / (2 * step)
    made = [tau[:, :, middle] + part * samples * slope for part in number.CONSTANTS]
    best = max(robot.fit(tau=y).evidence for y in made)
    return float(best - robot.fit().evidence)


def _say_lag(reading, candidate):
    seconds, log_odds = candidate.values["seconds"], candidate.log_odds
    if "name" in candidate.values:
        return (
            "All torques look filtered, by a low-pass with a time constant of about "
            f"{1e3 * seconds:.2g} ms (log odds {log_odds:.0f}): log them before the "
            "filter, or with a higher cut-off frequency."
        )
    error = number.INTERVAL * candidate.values["error"]
    return (
        f"All torques are {1e3 * abs(seconds):.3g} ± {1e3 * error:.2g} ms "
        f"{'late' if seconds > 0 else 'early'} against the positions (log odds "
        f"{log_odds:.0f}): two clocks, or a delay of the torques. The search shifts "
        "them by this lag."
    )


# -- contact ---------------------------------------------------------------------------


def _contact(reading):
    """Return an interval in which something else acts on the robot."""
    robot = reading.few
    n, rows = len(robot.signals.row), robot.signals.row
    size = np.sqrt(robot.variance.max())

    def fitted(place, robot):
        return robot.fit(columns=_pushes(robot, place), deviation=size)

    def best_of(places):
        places = [(max(a, 0), min(b, n)) for a, b in places if b - a > 2]
        return max(places, key=lambda place: fitted(place, robot).evidence)

    widths = [n // part for part in number.CONTACT_PARTS]
    place = best_of(
        (a, a + width) for width in widths for a in range(0, n, max(width // 2, 1))
    )
    for part in (2, 4, 8, 16):
        a, b = place
        moves = np.array([-1, 0, 1]) * max((b - a) // part, 1)
        place = best_of((a + k, b + m) for k in moves for m in moves)
    # A contact makes what is left correlated for as long as it lasts.
    inside = _pushes(robot, place).any(axis=(1, 2)).astype(float)
    times = np.minimum(robot.times, robot.correlation_times(inside[:, None]))
    known = reading.bodies, robot.signals, times
    robot = DescribedRobot(*known, entries=robot.entries)
    fit = fitted(place, robot)
    score, now = score_of(robot, fit), score_of(robot)
    push = np.abs(fit.factors[robot.joints]) / np.sqrt(fit.noise)
    felt = robot.joints[push > number.CONTACT]
    # A force on a link loads the joints before it; friction of a single one varies.
    if felt.size < min(robot.joints.size, 2):
        return None
    if score.fall(now) < number.CLEAR_OF_JOINT:
        return None
    begin, end = (rows[min(k, n - 1)] * reading.dt for k in place)
    return Candidate(
        change=Change(),
        joints=tuple(felt.tolist()),
        log_odds=of(score, now, n),
        values={
            "begin": begin,
            "end": end,
            "push": {int(j): fit.factors[j] for j in felt},
        },
    )


def _pushes(robot, place):
    """Columns (n, nv, nv) of torques that act on each joint in an interval."""
    nv, n = robot.bodies.nv, len(robot.signals.row)
    columns = np.zeros((n, nv, nv))
    columns[slice(*place), range(nv), range(nv)] = 1.0
    return columns


def _say_contact(reading, candidate):
    values = candidate.values
    pushes = ", ".join(
        f"{reading.names[j]} {push:+.2g} {'N' if reading.slides[j] else 'N m'}"
        for j, push in values["push"].items()
    )
    return (
        f"From {values['begin']:.1f} to {values['end']:.1f} s after the start "
        f"something else acts on the robot ({pushes}; log odds "
        f"{candidate.log_odds:.0f}): a contact, a load, or an external force. Leave "
        "this interval out."
    )


HYPOTHESES = (
    Hypothesis(
        name="wrong_dt",
        severity="error",
        applies=lambda reading: True,
        propose=_periods,
        message=_say_period,
        remedy=lambda reading, candidate: {
            "dt": float(f"{reading.dt * candidate.change.period:.6g}")
        },
    ),
    Hypothesis(
        name="base_orientation",
        severity="error",
        applies=lambda reading: not (reading.commanded or reading.bodies.weightless),
        propose=_turned,
        message=_say_turned,
    ),
)
# Looked for once nothing else is found.
LAST = (
    Hypothesis(
        name="external_force",
        severity="doubt",
        applies=lambda reading: not reading.commanded and poor(reading),
        propose=_contact,
        message=_say_contact,
        repairs=False,
    ),
    Hypothesis(
        name="delay",
        severity="warning",
        applies=lambda reading: not reading.commanded,
        propose=_lag,
        message=_say_lag,
        repairs=False,
    ),
)
