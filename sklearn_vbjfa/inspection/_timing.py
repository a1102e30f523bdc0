"""Whether a recording is as fast as its robot, and its torques in step with motion."""

import numpy as np

from sklearn_vbjfa.inspection._rivals import (
    SURE,
    ChannelEquations,
    fits_of,
    gain,
    total,
)
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.recording import ChannelFinding, listed_joints

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
_FACTORS = (1e-3, 1e-2, 0.1, 10.0, 100.0, 1000.0)
# Another period must lower the squared errors of all joints by this factor.
_PERIOD_GAIN = np.log(2.0)
# A delay must lower the squared errors by this factor, and the relative error to this.
_DELAY_GAIN = np.log(2.0)
_DELAY_ERROR = 0.3


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
    for factor in (*_FACTORS, *special):
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
    fits = fits_of(ChannelEquations(model, signals), signals)
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


def delays(model, names, dt, signals):
    """Find torques that are out of step with the positions: one warning or none."""
    equations = ChannelEquations(model, signals)
    middle = signals.shifts.size // 2
    step = signals.shifts[1] - signals.shifts[0]
    known, clear = {}, {}
    for j in np.flatnonzero(signals.informative()):
        fit = equations.fit(j, signals.tau[:, j])
        best = int(np.argmin(fit.error))
        if fit.error[best] > _DELAY_ERROR:
            continue
        inside = 0 < best < signals.shifts.size - 1
        known[j] = (
            best - middle + (_vertex(fit.error[best - 1 : best + 2]) if inside else 0)
        )
        better, better_t = gain(fit.log_error[:, best], fit.log_error[:, middle])
        if inside and better > _DELAY_GAIN and better_t > SURE:
            clear[j] = known[j], better, better_t
    if not clear:
        return []
    common = float(np.median([x[0] for x in clear.values()]))
    agree = [j for j in clear if abs(clear[j][0] - common) <= 1.0]
    others = [j for j in known if j not in agree]
    # Either all joints are equally late, or some are and the others are in step: the
    # lag of elasticity or hysteresis differs from joint to joint.
    if abs(common) < 0.75 or not (
        len(agree) > len(known) / 2 or all(abs(known[j]) < 1.0 for j in others)
    ):
        return []
    samples = common * step
    reduction = np.exp(np.median([clear[j][1] for j in agree]))
    who = listed_joints(names, agree)
    way = "late" if samples > 0 else "early"
    return [
        ChannelFinding(
            "delay",
            tuple(int(j) for j in agree),
            "warning",
            f"The torque of {who} is {abs(samples):.2g} samples "
            f"({1e3 * abs(samples) * dt:.3g} ms) {way} against the positions: shifted, "
            f"the squared torque errors fall by the factor {reduction:.2g}; shift the "
            "torque columns by as much, or record both with one clock.",
        )
    ]


def _vertex(error):
    """Offset of the minimum of a parabola through three squared errors."""
    low, middle, high = np.asarray(error) ** 2
    bend = low - 2 * middle + high
    return 0.5 * (low - high) / bend if bend > 0 else 0.0
