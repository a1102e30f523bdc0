"""Does a recording fit the robot: signs, order, units and timing of its channels."""

from itertools import combinations

import numpy as np

from sklearn_vbjfa.robot._channel_fits import (
    FEWEST_ROWS,
    ChannelEquations,
    channel_signals,
    gain,
)
from sklearn_vbjfa.robot._groups import check_dt, contiguous_groups
from sklearn_vbjfa.robot._model import is_prismatic, joint_names, load_model
from sklearn_vbjfa.robot._sample_faults import ChannelFinding, inspect_samples

__all__ = ["ChannelFinding", "inspect_channels"]

# Shorter recordings are not looked at [samples].
_MIN_SAMPLES = 64
# Standard errors that evidence needs.
_SURE = 5.0
# Friction below this share of a torque says nothing of its sign.
_FRICTION_SHARE = 0.1
# Share of the torque that the nominal model must explain to say something.
_NOMINAL_SHARE = 0.5
# Nominal inertias (payload and rotor left out) are not wrong by more than this.
_GEAR_FACTOR = 20.0
# A joint without limits does not turn farther than this within a recording [rad].
_LARGEST_TURN = 25.0
# Positions in degrees run beyond the joint's limits by more than this [rad].
_FAR_BEYOND = 5.0
# Exchanging two channels must lower the squared errors of both by this factor.
_SWAP_GAIN = np.log(4.0)
# No exchange is looked for where all joints are predicted as well as this.
_GOOD_FIT = 0.1
# Rows with which exchanged positions are tried, which is dear.
_SWAP_ROWS = 700
# A delay must lower the squared errors by this factor, and predict as well as this.
_DELAY_GAIN = np.log(2.0)
_DELAY_ERROR = 0.3


def inspect_channels(model, q, tau, dt, groups=None):
    """Look for channels of a recording that cannot be what they are called.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Robot; its inertias may be wrong by half, its friction is not used.
    q : array-like of shape (n_samples, nv)
        Joint positions [rad or m], rows equidistant in time.
    tau : array-like of shape (n_samples, nv)
        Joint torques [N m] or forces [N]; a motor quantity in another unit is welcome
        as far as sign, order and timing are concerned.
    dt : float
        Sample period [s].
    groups : array-like of shape (n_samples,), default=None
        Labels of separate recordings.

    Returns
    -------
    findings : tuple of ChannelFinding
        What was found, errors first; empty if nothing. Kinds:

        - errors: "constant_torque", "torque_sign", "swapped_torques",
          "swapped_positions", "swapped_joints" (both), "position_degrees";
        - warnings: "clipped_torque", "coarse_torque", "gear_factor", "delay",
          "frozen_position", "repeated_rows", "position_jumps", "position_spikes",
          "torque_spikes", "still_joint".

    Notes
    -----
    Every torque is regressed on its joint's rows of the regressor matrix (a prior
    keeps the inertias near multiples of the nominal ones), friction, a spring and the
    rotor's inertia, behind a common low-pass. Errors count in blocks of time that the
    regression has not seen, so that correlated residuals do not pass for evidence. The
    sign shows in the power of friction, which leaves the motion and never feeds it,
    and in the factor of the nominal torque. What is found is put right before the next
    question is asked, so that one fault does not look like another.

    Silence is no certificate: a channel that the motion does not excite, or one that
    is mostly noise, shows nothing.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.robot._channel_checks import inspect_channels
    >>> arm = load_demo_recording()
    >>> tau = arm.tau.copy()
    >>> tau[:, 1] *= -1
    >>> findings = inspect_channels(
    ...     arm.robot_model(), arm.q, tau, arm.dt, arm.groups
    ... )
    >>> [(finding.kind, finding.joints) for finding in findings]
    [('torque_sign', (1,))]
    """
    model = load_model(model)
    q, tau = _check_arrays(model, q, tau)
    dt = check_dt(dt)
    parts = [
        part
        for part in contiguous_groups(groups, q.shape[0])
        if part.stop - part.start >= _MIN_SAMPLES
    ]
    if not parts:
        return ()
    rows = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    stops = np.cumsum([part.stop - part.start for part in parts])
    parts = [slice(int(a), int(b)) for a, b in zip(np.r_[0, stops], stops)]
    names = joint_names(model)
    findings, usable = inspect_samples(names, q[rows], tau[rows], dt, parts, rows)
    signals = channel_signals(q[rows], tau[rows], dt, parts, usable)
    if signals is not None and signals.informative().any():
        for check in (_degrees, _swapped, _signs, _gear_factors):
            found, signals = check(model, names, q, signals)
            findings += found
        findings += _delays(model, names, dt, signals)
    return tuple(sorted(findings, key=lambda finding: finding.severity != "error"))


def _check_arrays(model, q, tau):
    """Return positions and torques as finite arrays (n_samples, nv)."""
    arrays = []
    for name, values in (("q", q), ("tau", tau)):
        array = np.asarray(values, dtype=float)
        if array.ndim != 2 or array.shape[1] != model.nv:
            raise ValueError(
                f"{name} must have shape (n_samples, {model.nv}), one column for each "
                f"of {', '.join(joint_names(model))}; got {array.shape}."
            )
        if not np.isfinite(array).all():
            row, column = np.argwhere(~np.isfinite(array))[0]
            raise ValueError(
                f"{name} must be finite, got {array[row, column]} in row {row} for "
                f"{joint_names(model)[column]}; interpolate or drop that row."
            )
        arrays.append(array)
    if len(arrays[0]) != len(arrays[1]):
        raise ValueError(
            f"q and tau must have equally many rows, got {len(arrays[0])} and "
            f"{len(arrays[1])}."
        )
    return arrays


def _fits(equations, signals):
    """Fit of every informative joint with the torques as recorded."""
    now = signals.now
    return {
        int(j): equations.fit(j, now[:, [j]])
        for j in np.flatnonzero(signals.informative())
    }


def _total(fits):
    """Logarithms of squared errors by block, mean over joints."""
    return np.mean([fit.log_error[:, 0] for fit in fits.values()], axis=0)


# -- unit of the positions -------------------------------------------------------------


def _degrees(model, names, q, signals):
    revolute = ~is_prismatic(model)
    if not revolute.any():
        return [], signals
    factor = np.where(revolute, np.pi / 180, 1.0)
    beyond = [_beyond(model, q * unit) * revolute for unit in (1.0, factor)]
    far = (beyond[0] > _FAR_BEYOND) & (beyond[1] == 0.0)
    # One joint somewhat beyond its limits may be another joint's channel.
    many = np.count_nonzero(beyond[0] > 0.1) > 0.5 * np.count_nonzero(revolute)
    if not (far.any() or many):
        return [], signals
    scaled = signals.scaled(factor)
    fits = [_fits(ChannelEquations(model, x), x) for x in (scaled, signals)]
    better, better_t = gain(_total(fits[0]), _total(fits[1]))
    worse = better < -0.1 and better_t < -3
    prefers = better > _DELAY_GAIN and better_t > _SURE
    if worse or not (prefers or far.any()):
        return [], signals
    j = int(np.argmax(beyond[0]))
    found = ChannelFinding(
        "position_degrees",
        tuple(int(k) for k in np.flatnonzero(revolute)),
        "error",
        f"The positions look like degrees: {names[j]} runs from {q[:, j].min():.4g} to "
        f"{q[:, j].max():.4g}, {beyond[0][j]:.3g} rad more than it can, and read as "
        f"degrees the squared torque errors change by the factor "
        f"{np.exp(-better):.2g}; multiply the positions of revolute joints by pi/180.",
    )
    return [found], scaled


def _beyond(model, q):
    """How far each joint runs beyond what it can [rad or m], ndarray (nv,)."""
    # Pinocchio's "no limit" is the largest number there is.
    low = np.maximum(model.lowerPositionLimit, -1e6)
    high = np.minimum(model.upperPositionLimit, 1e6)
    limited = (high - low < _LARGEST_TURN) & (high > low)
    # Another zero of the joint or a nominal limit is no proof.
    margin = 0.125 * (high - low)
    outside = np.maximum(q.max(axis=0) - high, low - q.min(axis=0)) - margin
    turned = np.ptp(q, axis=0) - _LARGEST_TURN
    return np.maximum(np.where(limited, outside, turned), 0.0)


# -- order of the channels -------------------------------------------------------------


def _swapped(model, names, q, signals):
    found = []
    for _ in range(model.nv // 2):
        best = _best_swap(model, signals)
        if best is None:
            break
        kind, pair, score, better_t = best
        # Exchanged positions concern every joint, exchanged torques two.
        better = score if kind == "torques" else 2 * score / model.nv
        order = np.arange(model.nv)
        order[list(pair)] = pair[::-1]
        signals = signals.permuted(
            order, positions=kind != "torques", torques=kind != "positions"
        )
        what = "positions and torques" if kind == "joints" else kind
        # With friction alone to go by the two cannot be told apart.
        other = {"torques": " (or their positions)", "positions": " (or their torques)"}
        found.append(
            ChannelFinding(
                f"swapped_{kind}",
                pair,
                "error",
                f"The {what} of {names[pair[0]]} and {names[pair[1]]} look exchanged"
                f"{other.get(kind, '')}: the other way round the squared torque errors "
                f"fall by the factor {np.exp(better):.3g} ({better_t:.0f} standard "
                "errors); exchange the columns.",
            )
        )
    return found, signals


def _best_swap(model, signals):
    """Return kind, pair, gain as of two joints and its standard errors, or None."""
    equations = ChannelEquations(model, signals)
    fits = _fits(equations, signals)
    if all(fit.error[0] < _GOOD_FIT for fit in fits.values()):
        return None
    candidates = []
    for pair in combinations(sorted(fits), 2):
        weight = signals.weight[:, pair[0]] * signals.weight[:, pair[1]]
        if weight.sum() < FEWEST_ROWS:
            continue
        crossed, straight = [], []
        for a, b in (pair, pair[::-1]):
            crossed.append(equations.fit(a, signals.now[:, [b]], weight))
            straight.append(equations.fit(a, signals.now[:, [a]], weight))
        better, better_t = gain(
            np.mean([fit.log_error[:, 0] for fit in crossed], axis=0),
            np.mean([fit.log_error[:, 0] for fit in straight], axis=0),
        )
        # Each torque must fit its new place better than its old one.
        each = [
            gain(crossed[1 - k].log_error[:, 0], straight[k].log_error[:, 0])[0]
            for k in (0, 1)
        ]
        if better > _SWAP_GAIN and better_t > _SURE and min(each) > 0:
            candidates.append(("torques", pair, better, better_t))
    best = max(candidates, key=lambda x: x[2], default=None)
    if best is not None:
        a, b = best[1]
        fits |= {
            a: equations.fit(a, signals.now[:, [b]]),
            b: equations.fit(b, signals.now[:, [a]]),
        }
        if all(fit.error[0] < _GOOD_FIT for fit in fits.values()):
            return best
    candidates += _position_swaps(model, signals, fits)
    return max(candidates, key=lambda x: x[2], default=None)


def _position_swaps(model, signals, fits):
    few = signals.thinned(_SWAP_ROWS)
    straight = _total(_fits(ChannelEquations(model, few), few))
    found = []
    prismatic = is_prismatic(model)
    for pair in combinations(sorted(fits), 2):
        if prismatic[pair[0]] != prismatic[pair[1]]:
            continue
        order = np.arange(model.nv)
        order[list(pair)] = pair[::-1]
        exchanged = few.permuted(order, positions=True, torques=False)
        equations = ChannelEquations(model, exchanged)
        for kind in ("positions", "joints"):
            trial = exchanged.permuted(order, positions=False, torques=kind == "joints")
            crossed = {j: equations.fit(j, trial.now[:, [j]]) for j in fits}
            better, better_t = gain(_total(crossed), straight)
            # Of all joints, two of which changed.
            if better > 2 * _SWAP_GAIN / model.nv and better_t > _SURE:
                found.append((kind, pair, better * model.nv / 2, better_t))
    return found


# -- sign and size of the torques ------------------------------------------------------


def _signs(model, names, q, signals):
    equations = ChannelEquations(model, signals)
    found = []
    sign = np.ones(model.nv)
    for j, fit in _fits(equations, signals).items():
        scale, scale_t, share = equations.nominal_scale(j)
        friction = fit.power_t * (fit.friction > _FRICTION_SHARE)
        rigid = scale_t * (share > _NOMINAL_SHARE)
        # Neither witness may say the contrary.
        says = min(friction, rigid)
        if says > -_SURE or max(friction, rigid) > 2.0:
            continue
        sign[j] = -1.0
        evidence = []
        if friction < -_SURE:
            evidence.append(
                f"friction would feed {-fit.power:.3g} W into the motion "
                f"({-fit.power_t:.0f} standard errors)"
            )
        if rigid < -_SURE:
            evidence.append(
                f"it follows {scale:.2g} times the model's torque "
                f"({-scale_t:.0f} standard errors)"
            )
        found.append(
            ChannelFinding(
                "torque_sign",
                (j,),
                "error",
                f"The torque of {names[j]} has the wrong sign: "
                f"{' and '.join(evidence)}; multiply it by -1.",
            )
        )
    return found, signals.signed(sign)


def _gear_factors(model, names, q, signals):
    equations = ChannelEquations(model, signals)
    found = []
    for j in np.flatnonzero(signals.informative()):
        scale, scale_t, share = equations.nominal_scale(j)
        if scale_t < _SURE or share < _NOMINAL_SHARE:
            continue
        if 1 / _GEAR_FACTOR < scale < _GEAR_FACTOR:
            continue
        factor = f"{1 / scale:.3g}" if scale < 1 else f"1/{scale:.3g}"
        found.append(
            ChannelFinding(
                "gear_factor",
                (int(j),),
                "warning",
                f"The torque of {names[j]} is {scale:.3g} times what the model's "
                f"inertias ask for ({scale_t:.0f} standard errors from zero): motor "
                "side instead of joint side, or a current or voltage? Multiply by the "
                f"gear ratio (about {factor} would fit).",
            )
        )
    return found, signals


# -- timing ----------------------------------------------------------------------------


def _delays(model, names, dt, signals):
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
        if inside and better > _DELAY_GAIN and better_t > _SURE:
            clear[j] = known[j], better, better_t
    if not clear:
        return []
    common = float(np.median([x[0] for x in clear.values()]))
    agree = [j for j in clear if abs(clear[j][0] - common) <= 1.0]
    others = [j for j in known if j not in agree]
    # All joints late alike, or some of them and the others in time: what elasticity
    # or hysteresis does differs from joint to joint.
    if abs(common) < 0.75 or not (
        len(agree) > len(known) / 2 or all(abs(known[j]) < 1.0 for j in others)
    ):
        return []
    samples = common * step
    reduction = np.exp(np.median([clear[j][1] for j in agree]))
    everyone = len(agree) == len(names) > 1
    who = "all joints" if everyone else ", ".join(names[j] for j in agree)
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
    """Offset of the smallest of a parabola through three squared errors."""
    low, middle, high = np.asarray(error) ** 2
    bend = low - 2 * middle + high
    return 0.5 * (low - high) / bend if bend > 0 else 0.0
