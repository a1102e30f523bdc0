"""Whether numbers have the units that they should: positions, torques and time."""

import numpy as np

from sklearn_vbjfa.inspection._hypotheses import (
    DECISIVE,
    INTERVAL,
    PRIOR,
    RIVAL,
    lag,
    log_odds_of,
    lowpass_gain,
    zeros,
)
from sklearn_vbjfa.inspection._likelihood import without_mass
from sklearn_vbjfa.inspection._rivals import (
    NOMINAL_SHARE,
    SURE,
    ChannelEquations,
    channel_signals,
    fits_of,
    fits_to,
    gain,
    total,
)
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.recording import UNSIGNED, ChannelFinding, listed_joints
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._signs import most_explaining, signed_columns
from sklearn_vbjfa.robot._states import StateEstimator

# Nominal inertias of one joint (without payload and rotor) are not wrong by more.
_GEAR_FACTOR = 20.0
# What is found of torques whose unit is not N m or N, or not known.
OF_SIZE = ("torque_unit", "torque_factors", "gear_factor")
# A torque is noise if it is less than this share of the described one, and its relative
# error above this.
_SILENT, _UNRELATED = 0.1, 0.9
# Commanded torques of all joints together are asked for one order of magnitude.
_COMMANDED = 10.0
# A joint without limits does not turn farther than this within a recording [rad].
_LARGEST_TURN = 25.0
# Signs must lower the squared error of a torque of one sign by this factor, and both
# must be had by this share of the rows.
_SIGN_GAIN, _RARE = 2.0, 0.02
# A joint turns round between speeds of at least this share of its fastest.
_STANDS = 0.05
# Positions in degrees run beyond the joint's limits by more than this [rad].
_FAR_BEYOND = 5.0
# Another reading of the positions must lower the squared errors by this factor.
_UNIT_GAIN = np.log(2.0)
# Encoder counts are whole numbers that span at least this range.
_FEWEST_COUNTS = 25.0
# Integrated velocities stay within this multiple of a joint's range; where the model
# has no limits, the range is taken to be this many radians or metres.
_RANGE_MARGIN = 1.25
_RANGE_TURN, _RANGE_SLIDE = 4 * np.pi, 5.0
# ... and have means of at most this share of their standard deviation.
_LARGEST_MEAN = 0.5
# A joint without a speed limit does not move faster than this [rad/s, m/s] ...
_FASTEST_TURN = 60.0
_FASTEST_SLIDE = 10.0
# ... nor any joint faster than its limit by this factor.
_TOO_FAST = 5.0
# Samples over which speeds are taken, lest encoder noise pass for motion.
_SPEED_SAMPLES = 5
# A robot that is slower than its limits by this factor hardly moves ...
_TOO_SLOW = 0.01
# ... and motions are seldom sampled at that period [s]; 5 kHz read as ms are 0.2.
_LONG_PERIOD = 0.15
# The inertia of a joint, with its rotor, is less than this many times the nominal one.
_LARGEST_INERTIA = 400.0
# Rows with which other sample periods are tried, and the factors.
_FEW_ROWS = 900
PERIODS = (1e-3, 1e-2, 0.1, 10.0, 100.0, 1000.0)
# Another period must lower the squared errors of all joints by this factor.
_PERIOD_GAIN = np.log(2.0)
# Positions begin at zero within this share of their range, and a zero is another one
# from this angle on [rad].
_AT_ZERO, _MOVED = 1e-3, 0.05
# A lag is told from none if it is this many times its deviation; longer lags than the
# shifts of the signals are followed by this many moves.
_LEAST_LAG = 3.0
_MOST_MOVES = 6


# -- positions -------------------------------------------------------------------------


def counts(model, names, q, ratio):
    """Find positions (n, nv) neither in radians nor in degrees: one error or none."""
    # `ratio` (nv,) are the speeds over the fastest possible.
    revolute = ~is_prismatic(model)
    degrees = np.where(revolute, np.pi / 180, 1.0)
    beyond, as_degrees = _beyond(model, q), _beyond(model, q * degrees)
    far = (beyond > _FAR_BEYOND) & (as_degrees > 0)
    travel = np.ptp(q, axis=0)
    whole = (q == np.round(q)).all(axis=0) & (travel >= _FEWEST_COUNTS)
    # Whole degrees are degrees.
    whole &= ~((beyond > _FAR_BEYOND) & (as_degrees == 0)) | (travel > 720)
    wrong = far | whole
    # A joint may turn without end, but not at that speed, not even in degrees.
    wrong |= (ratio * degrees > 1.0) & (travel * degrees > _LARGEST_TURN)
    if not wrong.any():
        return []
    joints = tuple(int(k) for k in np.flatnonzero(wrong))
    j = max(joints, key=lambda k: travel[k])
    if whole[j]:
        evidence = f"whole numbers from {q[:, j].min():.6g} to {q[:, j].max():.6g}"
    else:
        evidence = f"from {q[:, j].min():.4g} to {q[:, j].max():.4g}"
    unit = "rad" if revolute[j] else "m"
    other = "radians nor degrees" if revolute[j] else "metres"
    return [
        ChannelFinding(
            "position_counts",
            joints,
            "error",  # Sines and inertias of such angles are nonsense.
            f"The positions of {listed_joints(names, joints)} are neither {other}: "
            f"{names[j]} has {evidence}, more than it can move; they look like encoder "
            f"counts: convert them to {unit} (times 2 pi over the counts of a turn, "
            "from the joint's zero)."
            if revolute[j]
            else f"The positions of {listed_joints(names, joints)} are not in metres: "
            f"{names[j]} has {evidence}, more than it can move; convert encoder "
            f"counts or millimetres to {unit}.",
        )
    ]


def position_units(model, names, q, signals):
    """Find positions (n, nv) in degrees or turns; also return factors (nv,) to rad."""
    revolute = ~is_prismatic(model)
    same = np.ones(model.nv)
    if not revolute.any():
        return [], same
    beyond = _beyond(model, q) * revolute
    far = (beyond > _FAR_BEYOND) & _limited(model)
    many = np.count_nonzero(beyond > 0.1) > 0.5 * np.count_nonzero(revolute)
    tried = []
    if far.any() or many:
        tried = [(revolute, np.pi / 180, "degrees", "deg")]
        if far.any() and not far[revolute].all():
            tried.append((far, np.pi / 180, "degrees", "deg"))
    elif not beyond.any():
        tried = [(revolute, 2 * np.pi, "turns", "rev")]
    found = []
    for joints, unit, called, short in tried:
        factor = np.where(joints, unit, 1.0)
        # Of a joint without limits any angle may be right.
        if (_beyond(model, q * factor) * joints > 0).any():
            continue
        log_odds = log_odds_of(model, signals.scaled(factor), signals)
        found.append((log_odds, factor, called, short))
    if not found:
        return [], same
    log_odds, factor, called, short = max(found, key=lambda x: x[0])
    if log_odds < (-DECISIVE if far.any() else DECISIVE):
        return [], same
    which = tuple(int(k) for k in np.flatnonzero(factor != 1.0))
    j = max(which, key=lambda k: np.ptp(q[:, k]))
    column = "{i}" if len(which) == np.count_nonzero(revolute) else str(j + 1)
    message = (
        f"The positions of {listed_joints(names, which)} look like {called}: "
        f"{names[j]} runs from {q[:, j].min():.4g} to {q[:, j].max():.4g}, and in "
        f"{called} they explain the torques better (log odds {log_odds:.0f}). Give the "
        f'mapping "q=q{column} [{short}]" with the names of your columns (columns=, or '
        "--columns)."
    )
    return [ChannelFinding(f"position_{called}", which, "error", message)], factor


def _limits(model):
    # Pinocchio's "no limit" is the largest number there is.
    low = np.maximum(model.lowerPositionLimit, -1e6)
    high = np.minimum(model.upperPositionLimit, 1e6)
    return low, high


def _limited(model):
    """Return which joints have limits, ndarray of shape (nv,), bool."""
    low, high = _limits(model)
    return (high - low < _LARGEST_TURN) & (high > low)


def _beyond(model, q):
    """How far each joint moves beyond its limits [rad or m], ndarray of shape (nv,)."""
    low, high = _limits(model)
    # Another zero of the joint or a nominal limit is no proof.
    margin = 0.125 * (high - low)
    outside = np.maximum(q.max(axis=0) - high, low - q.min(axis=0)) - margin
    turned = np.ptp(q, axis=0) - _LARGEST_TURN
    return np.maximum(np.where(_limited(model), outside, turned), 0.0)


def velocities(model, names, q, tau, dt, parts, usable, signals):
    """Find velocities in the columns q (n, nv) of positions: one error or none."""
    # `usable` (n, nv) marks samples without known faults, `signals` is the filtered
    # recording.
    low, high = _limits(model)
    free = np.where(is_prismatic(model), _RANGE_SLIDE, _RANGE_TURN)
    width = np.where(_limited(model), high - low, free)
    # A joint that stays within its range moves to and fro. At rest, or within part of a
    # swing, any signal may be the derivative of any other.
    swing = np.array(
        [np.abs(q[p].mean(axis=0)) / _tiny(q[p].std(axis=0)) for p in parts]
    )
    if np.median(swing) > _LARGEST_MEAN:
        return []
    integral = np.empty_like(q)
    for part in parts:
        integral[part] = np.cumsum(q[part], axis=0) * dt
        integral[part] -= 0.5 * (
            integral[part].max(axis=0) + integral[part].min(axis=0)
        )
        # Positions are hardly ever centred, so that their integrals diverge.
        if (np.ptp(integral[part], axis=0) > _RANGE_MARGIN * width).any():
            return []
    integral += np.where(_limited(model), 0.5 * (low + high), 0.0)
    other = channel_signals(integral, tau, dt, parts, usable)
    if other is None:
        return []
    fits = [fits_to(model, x) for x in (other, signals)]
    joints = set(fits[0]) & set(fits[1])
    if not joints:
        return []
    better, better_t = gain(*(total({j: fit[j] for j in joints}) for fit in fits))
    if not (better > _UNIT_GAIN and better_t > SURE):
        return []
    return [
        ChannelFinding(
            "velocity_as_position",
            tuple(range(len(names))),
            "error",
            "The columns of positions look like velocities: integrated over time they "
            "stay within the joints' ranges, and the squared torque errors fall by the "
            f"factor {np.exp(better):.3g} ({better_t:.0f} standard errors); give "
            "positions, or states [q | v | a].",
        )
    ]


def _tiny(x):
    return np.maximum(x, np.finfo(float).tiny)


# -- torques ---------------------------------------------------------------------------


def gear_factors(model, names, signals):
    """Find torques of single joints of another size than the model's."""
    # These are doubts and not errors: factors that differ between joints would be
    # compensated by spurious effects, but a description with invented inertias looks
    # the same.
    if without_mass(model):
        return []
    equations, sizes = ChannelEquations(model, signals), {}
    for j in map(int, np.flatnonzero(signals.informative())):
        scale, scale_t, share = equations.nominal_scale(j)
        if scale_t < SURE or share < NOMINAL_SHARE:
            continue
        if scale >= _GEAR_FACTOR:
            # The rotor behind a gear may be many times its link.
            scale, scale_t, _ = equations.nominal_scale(j, rotor=True)
            if scale_t < SURE:
                continue
        sizes[j] = scale
    return [
        _gear_factor(names, j, scale)
        for j, scale in sizes.items()
        if not 1 / _GEAR_FACTOR < scale < _GEAR_FACTOR
    ]


def silent_torques(model, names, signals):
    """Find torques that do not follow a motion that should load them: noise."""
    if without_mass(model):
        return []
    equations = ChannelEquations(model, signals)
    sizes = equations.sizes()
    silent = [
        j
        for j, fit in fits_of(equations, signals).items()
        if sizes[j] < _SILENT and fit.error[0] > _UNRELATED
    ]
    return [
        ChannelFinding(
            "silent_torque",
            (j,),
            "error",
            f"The torque of {names[j]} does not follow the motion and is "
            f"{sizes[j]:.2g} times what the description requires: only noise was "
            "recorded. Check the cable or the column, or leave the joint out "
            "(--joints).",
        )
        for j in silent
    ]


def _gear_factor(names, j, scale):
    """Return the finding that one torque is of another size."""
    factor = f"{1 / scale:.3g}" if scale < 1 else f"1/{scale:.3g}"
    return ChannelFinding(
        "gear_factor",
        (j,),
        "doubt",
        f"The torque of {names[j]} is {scale:.3g} times what the masses of the robot "
        "description ask for: torque of the motor instead of the joint, a current, or "
        f"another unit? Multiply it by the gear ratio (about {factor} would fit).",
    )


def commanded_sizes(model, names, signals, drive):
    """Find commanded torques of another order of magnitude than the model's."""
    joints = np.flatnonzero(signals.informative())
    sizes = ChannelEquations(model, signals).sizes()[joints]
    joints, sizes = joints[np.isfinite(sizes)], sizes[np.isfinite(sizes)]
    middle = float(np.median(sizes)) if sizes.size else 1.0
    if 1 / _COMMANDED < middle < _COMMANDED:
        return []
    j = joints[int(np.argmin(np.abs(np.log(sizes / middle))))]
    return [
        ChannelFinding(
            "gear_factor",
            tuple(int(k) for k in joints),
            "doubt",
            f"The commanded torques are {middle:.2g} times those of the described "
            f"robot, in the median over the joints (such as {names[j]}): check "
            f"{drive.numbers}.",
        )
    ]


# -- time -----------------------------------------------------------------------------


def unsigned_torques(model, names, q, tau, dt, parts):
    """Find torques of which only sizes were logged."""
    # Where they are, all of one sign are: what loads a joint little shows nothing.
    one_way = (tau >= 0).all(axis=0) | (tau <= 0).all(axis=0)
    one_way = np.flatnonzero(one_way & (np.ptp(tau, axis=0) > 0)).tolist()
    if not one_way:
        return []
    labels = np.repeat(np.arange(len(parts)), [p.stop - p.start for p in parts])
    rows = np.concatenate([np.arange(p.start, p.stop) for p in parts])
    states = StateEstimator(dt).fit_transform(q[rows], groups=labels)
    explanations = signed_columns(RigidBodyFeatures(model).load(), states)
    found = []
    for j in one_way:
        columns, sizes = explanations[j], np.abs(tau[rows, j])
        own = columns @ most_explaining(columns, sizes)
        plain = columns @ np.linalg.lstsq(columns, sizes)[0]
        left = ((sizes - np.abs(own)) ** 2).sum(), ((sizes - plain) ** 2).sum()
        least = min((own < 0).mean(), (own > 0).mean())
        if _SIGN_GAIN * left[0] < left[1] and least > _RARE:
            found.append(left[1] / left[0])
    if not found:
        return []
    often = max(_reversals(states[:, model.nv + j]) for j in one_way)
    return [
        ChannelFinding(
            kind="unsigned_torque",
            joints=tuple(one_way),
            severity="error",
            message=f"The torques of {listed_joints(names, one_way)} have one sign "
            f"only, although a joint reverses {often} times, and with signs that "
            "change the motion explains them better: their signs were not logged, as "
            "of unsigned currents. Give "
            f'--drive "{UNSIGNED}", which finds the signs (Python: '
            "drive=CurrentDrive(signed=False)).",
        )
    ]


def _reversals(speed):
    """How often a joint turns round, from its speeds (n,)."""
    moving = speed[np.abs(speed) > _STANDS * np.abs(speed).max()]
    return int((moving[1:] * moving[:-1] < 0).sum())


def fastest(model):
    """Impossible speeds (nv,) [rad/s or m/s]: five times each limit, given or usual."""
    limit = np.asarray(model.velocityLimit, dtype=float)
    unlimited = np.where(is_prismatic(model), _FASTEST_SLIDE, _FASTEST_TURN)
    known = (limit > 0) & (limit < 1e3)
    return _TOO_FAST * np.where(known, limit, unlimited)


def too_fast(model, names, q, dt, parts):
    """Find an impossibly short dt; also return the speeds (nv,) over `fastest`."""
    speed = _speeds(q, dt, parts)
    ratio = speed / fastest(model)
    j = int(np.argmax(ratio))
    if ratio[j] <= 1.0:
        return [], ratio
    unit = "m/s" if is_prismatic(model)[j] else "rad/s"
    found = ChannelFinding(
        "wrong_dt",
        tuple(range(len(names))),
        "error",  # Accelerations are wrong by the square.
        f"No robot is as fast: with dt={dt:.6g} s {names[j]} moves at {speed[j]:.3g} "
        f"{unit}, and {fastest(model)[j]:.3g} would be five times what it can; give dt "
        "as the sample period in seconds, and positions in rad or m.",
    )
    return [found], ratio


def _speeds(q, dt, parts):
    """Speed of each joint that is seldom exceeded, ndarray of shape (nv,)."""
    width = _SPEED_SAMPLES
    travel = [np.abs(q[p][width:] - q[p][:-width]) for p in parts]
    return np.quantile(np.concatenate(travel), 0.995, axis=0) / (width * dt)


def sample_periods(model, names, dt, ratio, signals):
    """Find a dt in another unit, from speeds (nv,) over `fastest` and torques."""
    j = int(np.argmax(ratio))
    unit = "m/s" if is_prismatic(model)[j] else "rad/s"
    crawls = ratio.max() * _TOO_FAST < _TOO_SLOW and dt >= _LONG_PERIOD
    found = None
    if not without_mass(model):
        found = _other_period(model, signals, ratio, dt)
    if found is None and crawls:
        found = _inertia_too_large(model, names, signals)
    if found is None and not crawls:
        return []
    evidence = found or (
        f"the fastest joint, {names[j]}, moves at "
        f"{ratio[j] * fastest(model)[j]:.2g} {unit}, "
        f"{_TOO_FAST * ratio[j]:.1g} of what it can"
    )
    units = (
        f"; it looks like {'milliseconds or ' if dt < 100 else ''}a rate in Hz: give "
        f"{dt / 1e3:.6g} or {1 / dt:.6g}"
        if dt >= _LONG_PERIOD
        else ""
    )
    return [
        ChannelFinding(
            "wrong_dt",
            tuple(range(len(names))),
            # Hardly moving for hours may be on purpose.
            "error" if found else "doubt",
            f"dt={dt:.6g} s does not go with the motion: {evidence}{units}; dt is the "
            "sample period in seconds.",
        )
    ]


def _other_period(model, signals, ratio, dt):
    """Evidence that the torques fit the motion at another period, or None."""
    few = signals.thinned(_FEW_ROWS)
    now = total_or_none(model, few)
    if now is None:
        return None
    special = (1e3, dt**2) if dt >= _LONG_PERIOD else ()
    best = None
    for factor in (*PERIODS, *special):
        if ratio.max() * factor > 1.0:
            continue
        trial = total_or_none(model, few.retimed(factor))
        better, better_t = gain(trial, now)
        if (
            better > _PERIOD_GAIN
            and better_t > SURE
            and (best is None or better > best[1])
        ):
            best = factor, better, better_t
    if best is None:
        return None
    factor, better, better_t = best
    return (
        f"with a period of {dt / factor:.2g} s the squared torque errors fall by the "
        f"factor {np.exp(better):.3g} ({better_t:.0f} standard errors)"
    )


def total_or_none(model, signals):
    """Total errors of the fits; None if no joint is informative."""
    fits = fits_to(model, signals)
    return total(fits) if fits else None


def _inertia_too_large(model, names, signals):
    """Evidence that a joint would need an impossible inertia, or None."""
    equations = ChannelEquations(model, signals)
    for j in np.flatnonzero(signals.informative()):
        gravity, gravity_t, motion, error = equations.inertia_scale(int(j))
        if gravity_t > SURE and motion - SURE * error > _LARGEST_INERTIA * gravity:
            return (
                f"{names[j]} would have {motion / gravity:.2g} times the inertia of "
                f"the model, beside its weight"
            )
    return None


def common_lag(model, names, dt, signals_after):
    """Find a lag common to all torques: one warning or none."""
    # signals_after: makes signals of torques that are read some samples later.
    samples, gained = 0.0, 0.0
    for _ in range(_MOST_MOVES):
        signals = signals_after(round(samples))
        if signals is None:
            return []
        more, spread, gain_of = lag(model, signals)
        samples, gained = samples + more, gained + gain_of
        if np.isfinite(spread):
            break
    log_odds = gained + PRIOR
    if not (log_odds > DECISIVE and abs(samples) > _LEAST_LAG * spread):
        return []
    every = tuple(range(len(names)))
    filtered = samples > 0 and lowpass_gain(model, signals_after(0), samples)
    if filtered and filtered > gained + RIVAL:
        message = (
            f"All torques look filtered, by a low-pass with a time constant of about "
            f"{1e3 * samples * dt:.2g} ms (log odds {filtered + PRIOR:.0f}): log them "
            "before the filter, or with a higher cut-off frequency."
        )
        return [ChannelFinding("torque_lowpass", every, "warning", message)]
    seconds, error = samples * dt, INTERVAL * spread * dt
    way = "late" if samples > 0 else "early"
    message = (
        f"All torques are {1e3 * abs(seconds):.3g} ± {1e3 * error:.2g} ms {way} "
        f"against the positions (log odds {log_odds:.0f}): two clocks, or a delay of "
        "the torques. The search shifts them by this lag."
    )
    found = ChannelFinding("delay", every, "warning", message, value=seconds)
    return [found]


def moved_zeros(model, names, q, signals):
    """Find encoders that were set to zero where the robot stood when the log began."""
    # A log that begins at the zero of the description looks the same.
    begins = np.abs(q[0]) <= _AT_ZERO * np.ptp(q, axis=0)
    if not begins.all() or without_mass(model):
        return [], signals
    offset, log_odds = zeros(model, signals)
    moved = tuple(np.flatnonzero(np.abs(offset) > _MOVED).tolist())
    if log_odds < DECISIVE or not moved:
        return [], signals
    values = ", ".join(f"{names[j]} {offset[j]:+.2f}" for j in moved)
    message = (
        "All positions begin at zero, and the torques ask for other zeros (log odds "
        f"{log_odds:.0f}): the encoders were set to zero at power-up. Add to the "
        f"positions, about [rad]: {values}."
    )
    found = ChannelFinding("position_zeros", moved, "error", message)
    return [found], signals.shifted(offset)
