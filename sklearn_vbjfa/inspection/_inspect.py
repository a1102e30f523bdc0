"""Whether a recording fits the robot: signs, order, units and timing of channels."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.inspection._geometry import (
    misplaced,
    torque_signs,
    unseen_signs,
)
from sklearn_vbjfa.inspection._hypotheses import explained
from sklearn_vbjfa.inspection._rivals import channel_signals, long_parts
from sklearn_vbjfa.inspection._rows import unlike_channels
from sklearn_vbjfa.inspection._units import (
    OF_SIZE,
    PERIODS,
    commanded_sizes,
    common_lag,
    counts,
    gear_factors,
    moved_zeros,
    position_units,
    sample_periods,
    silent_torques,
    too_fast,
    unsigned_torques,
    velocities,
)
from sklearn_vbjfa.model import (
    is_prismatic,
    joint_names,
    load_model,
    nominal_parameters,
)
from sklearn_vbjfa.recording import (
    COMMANDS,
    UNSIGNED,
    ChannelFinding,
    RecordingRefused,
    check_dt,
    contiguous_groups,
    in_order,
    inspect_samples,
    shuffled_rows,
)
from sklearn_vbjfa.robot._features import RigidBodyFeatures

__all__ = ["ChannelFinding", "inspect_channels", "inspect_recording"]


def inspect_recording(recording, model=None):
    """Look for channels of a recording that cannot be what their names say.

    Parameters
    ----------
    recording : Recording
        Positions and torques.
    model : str, os.PathLike or pinocchio.Model, default=None
        Robot; None is `Recording.robot_model`.

    Returns
    -------
    findings : tuple of ChannelFinding
        Findings, the worst first; see `inspect_channels`.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.inspection import inspect_recording
    >>> recording = load_demo_recording()
    >>> inspect_recording(recording)
    ()
    >>> wrong = recording.tau.copy()
    >>> wrong[:, 1] *= -1.0
    >>> [f.kind for f in inspect_recording(replace(recording, tau=wrong))]
    ['torque_sign']
    """
    robot = recording.robot_model() if model is None else model
    found = inspect_channels(
        robot, recording.q, recording.tau, recording.dt, recording.groups
    )
    if _are_torques(recording.torque_units):
        return found
    return tuple(one for one in found if one.kind not in OF_SIZE)


def _are_torques(units):
    """Whether channels of torque are torques or forces, not quantities of a motor."""
    # Arrays have no units.
    return all(unit in ("N m", "N", "") for unit in units)


def refusal(findings, units=()):
    """Return a `RecordingRefused` for errors among findings, or None."""
    # units: of measured torques, whose signs factors can turn; none for a drive.
    errors = [one for one in findings if one.severity == "error"]
    if not errors:
        return None
    kinds, options = {one.kind for one in errors}, {}
    if kinds == {"unsigned_torque"}:
        options = {"drive": UNSIGNED}
    elif kinds == {"torque_sign"} and units and _are_torques(units):
        wrong = {j for one in errors for j in one.joints}
        options = {"gains": tuple(-1 if j in wrong else 1 for j in range(len(units)))}
    return RecordingRefused(" ".join(one.message for one in errors), options)


def inspect_channels(model, q, tau, dt, groups=None, *, drive=None):
    """Look for channels of a recording that cannot be what their names say.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Robot; its inertias may be wrong by half, and its friction is not used.
    q : array-like of shape (n_samples, nv)
        Joint positions [rad or m], rows equidistant in time.
    tau : array-like of shape (n_samples, nv)
        Joint torques [N m] or forces [N]. A motor quantity in another unit will do for
        the checks of sign, order and timing.
    dt : float
        Sample period [s].
    groups : array-like of shape (n_samples,), default=None
        Labels of separate recordings.
    drive : Drive, default=None
        What made the torques: of commanded positions a "gear_factor" is then one of
        ten in the median over the joints, and no delay is looked for, as a fit finds
        it; of sizes of currents the signs are not missing.

    Returns
    -------
    findings : tuple of ChannelFinding
        Findings, the worst first. Kinds:

        - errors, which a search for effects would find instead of effects:
          "shuffled_rows", "wrapped_position", "position_degrees", "position_counts",
          "velocity_as_position", "wrong_dt", "constant_torque", "two_torques" if no
          torque has more than two values, "still_joint" if no joint moves,
          "unsigned_torque" if only sizes were logged, "torque_sign", "flipped_joint"
          (both signs), "swapped_torques",
          "swapped_positions", "swapped_joints" (both), "joint_order" (three joints or
          more);
        - doubts, which rule out a favourable verdict: "torque_unit" if all torques are
          so small that they are motor currents, or in another unit than N m, or the
          masses of the robot are wrong; "gear_factor", "position_zero",
          "frozen_recording", "held_position", "held_torque", "torque_dropouts",
          "clipped_torque" of more than few samples, "repeated_rows" if there are many,
          "wrong_dt" if the motion is merely slower than a robot's, "position_jumps";
        - warnings: "clipped_torque", "coarse_torque", "delay", "frozen_position",
          "repeated_rows", "position_spikes", "torque_spikes", "still_joint".

    Notes
    -----
    After a common low-pass, every torque is regressed on its joint's rows of the
    regressor matrix (a prior keeps the inertias near multiples of the nominal ones),
    friction, a spring and the rotor's inertia. Errors count in blocks of time that the
    regression has not seen, so that correlated residuals do not pass for evidence. The
    sign shows in the power of friction, which leaves the motion and never feeds it,
    and in the factor of the nominal torque. Each fault is corrected before the next
    question is asked, so that one fault does not look like another.

    An empty result is not a certificate: a channel that the motion does not excite, or
    one that is mostly noise, shows nothing. Undetectable in principle are the zero of
    a joint with a vertical axis or of the last joint (whose link may be mounted in any
    way), and both signs of a joint that gravity does not load.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.inspection import inspect_channels
    >>> arm = load_demo_recording()
    >>> tau = arm.tau.copy()
    >>> tau[:, 1] *= -1
    >>> findings = inspect_channels(
    ...     arm.robot_model(), arm.q, tau, arm.dt, arm.groups
    ... )
    >>> [(finding.kind, finding.joints) for finding in findings]
    [('torque_sign', (1,))]
    """
    model, dt = load_model(model), check_dt(dt)
    findings, right = _inspected(model, q, tau, dt, groups, drive)
    if not right:
        findings += unseen_signs(joint_names(model), findings)
    return in_order(findings)


def _inspected(model, q, tau, dt, groups, drive):
    """Return findings, and whether a sign of a torque is seen to be right."""
    q, tau = _check_arrays(model, q, tau)
    names = joint_names(model)
    shuffled = shuffled_rows(names, q, contiguous_groups(groups, len(q)), groups)
    rows, parts = long_parts(len(q), groups)
    if shuffled or not parts:
        return shuffled, False
    q, tau = q[rows], tau[rows]
    revolute = ~is_prismatic(model)
    findings, usable, q = inspect_samples(names, q, tau, dt, parts, rows, revolute)
    findings += unlike_channels(names, q, tau, dt, parts)
    if _names(findings, "velocity_as_torque", "copied_position"):
        return findings, False
    impossible, ratio = too_fast(model, names, q, dt, parts)
    findings += counts(model, names, q, ratio)
    # Such positions allow no further question.
    if _names(findings, "position_counts"):
        return findings, False
    found = unsigned_torques(model, names, q, tau, dt, parts)
    if found:
        # Neither do torques without signs.
        known = drive is not None and drive.unsigned
        return findings if known else findings + found, False
    signals = channel_signals(q, tau, dt, parts, usable)
    if signals is None or not signals.informative().any():
        return findings + impossible, False
    found, factor = position_units(model, names, q, signals)
    if found:
        q, signals = q * factor, signals.scaled(factor)
        impossible, ratio = too_fast(model, names, q, dt, parts)
    else:
        found = velocities(model, names, q, tau, dt, parts, usable, signals)
    findings += found
    if _names(findings, "velocity_as_position"):
        return findings, False
    commanded = drive is not None and drive.told in COMMANDS
    whole = []
    if not commanded:
        whole, model, signals = explained(
            model, names, signals, lambda x: _corrected(model, names, ratio, x)
        )
        if not whole:
            whole, signals = moved_zeros(model, names, q, signals)
        findings += whole
    if not whole:
        findings += impossible or sample_periods(model, names, dt, ratio, signals)
    # This cannot be corrected, and would show in everything that follows.
    if _names(findings, "wrong_dt"):
        return findings, False
    found, signals = misplaced(model, names, signals)
    findings += found
    found, right, signals = torque_signs(model, names, signals)
    findings = _mirrored(names, findings, found)
    if commanded:
        return findings + commanded_sizes(model, names, signals, drive), right
    findings += gear_factors(model, names, signals)
    findings += silent_torques(model, names, signals)
    if not _severe(findings):
        findings += common_lag(
            model, names, dt, lambda k: _shifted(q, tau, dt, parts, usable, k)
        )
    return findings, right


def _mirrored(names, findings, signs):
    """Join findings: a joint turned round whose torque has its sign is one position."""
    turned = {x.joints for x in findings if x.kind == "flipped_joint"}
    both = turned & {x.joints for x in signs if x.kind == "torque_sign"}
    message = (
        "The position of {} has the wrong sign: with the other one it agrees with the "
        "torques of all joints; multiply it by -1."
    )
    joined = [
        ChannelFinding("position_sign", j, "error", message.format(names[j[0]]))
        for j in sorted(both)
    ]
    return joined + [x for x in [*findings, *signs] if x.joints not in both]


def _corrected(model, names, ratio, signals):
    """Yield signals with faults of single channels, or of the period, corrected."""
    for factor in PERIODS:
        if ratio.max() * factor < 1.0:
            yield signals.retimed(factor)
    _, signals = misplaced(model, names, signals)
    yield torque_signs(model, names, signals)[2]


def _severe(findings):
    """Whether positions and torques are not what a lag could be looked for in."""
    return any(one.severity == "error" for one in findings)


def _shifted(q, tau, dt, parts, usable, samples):
    """Signals of torques that are read some samples later; None if none are left."""
    if samples:
        first, last = max(0, -samples), max(0, samples)
        tau, q, usable = tau.copy(), q, usable.copy()
        for part in parts:
            tau[part] = np.roll(tau[part], -samples, axis=0)
            usable[part][:first], usable[part][len(tau[part]) - last :] = False, False
    return channel_signals(q, tau, dt, parts, usable)


def _names(findings, *kinds):
    return any(finding.kind in kinds for finding in findings)


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


# -- what a recording can show, joint by joint, without identifying -------------------

# A joint has one speed if this share of its moving time, about the middle, lies in a
# range of this share of the speed: speeds that are even in it deviate by a tenth of
# their mean, and Coulomb friction, which is the line through them at no speed at all,
# is ten times less certain than the friction at that speed.
_MIDDLE, _ONE_SPEED = 0.8, np.sqrt(12.0) / 10.0
# What saturates after a reversal must have done so in either direction several times.
_FEW_REVERSALS = 10
# Range of positions below which what varies with them looks like a spring [rad].
_WIDE = np.radians(60.0)
# Loads that vary by less than this share of the torque cannot tell friction with the
# load from friction without.
_SAME_LOAD = 0.1


@dataclass(frozen=True, kw_only=True)
class JointMotion:
    """What one joint does in a recording.

    Attributes
    ----------
    name : str
        Joint.
    slides : bool
        Whether it moves along its axis.
    lowest, highest : float
        Range of its positions [rad or m].
    fastest : float
        Speed that it exceeds in half a percent of the time [rad/s or m/s].
    reversals : int
        How often it turns round.
    resting : float
        Share of the time that it is at rest.
    torques : tuple of float
        Lowest and highest torque [unit of the recording].
    loads : tuple of float
        Lowest and highest torque of gravity by the robot's description [N m or N].
    shows, hides : tuple of str
        What the motion can show, and what it cannot, with the reason.
    """

    name: str
    slides: bool
    lowest: float
    highest: float
    fastest: float
    reversals: int
    resting: float
    torques: tuple
    loads: tuple
    shows: tuple
    hides: tuple


def motion_of(recording, model=None):
    """Return what each joint of a recording does, a tuple of `JointMotion`.

    Parameters
    ----------
    recording : Recording
        Positions and torques.
    model : str, os.PathLike or pinocchio.Model, default=None
        Robot; None is `Recording.robot_model`.

    Returns
    -------
    tuple of JointMotion
        In the order of the joints; empty if every recording is shorter than the filter
        that separates the motion from noise.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.inspection import motion_of
    >>> first = motion_of(load_demo_recording())[0]
    >>> first.name, first.reversals > 10, first.hides
    ('joint_1', True, ('friction that varies with the load: gravity does not load it',))
    """
    model = load_model(recording.robot_model() if model is None else model)
    rows, parts = long_parts(recording.n_samples, recording.groups)
    if not parts:
        return ()
    q, tau = recording.q[rows], recording.tau[rows]
    signals = channel_signals(q, tau, recording.dt, parts, np.ones(q.shape, dtype=bool))
    if signals is None:
        return ()
    nv = model.nv
    v = signals.states[:, nv : 2 * nv]
    loads = _loads(model, signals.states)
    slides = is_prismatic(model)
    found = []
    for j, name in enumerate(joint_names(model)):
        moving = signals.weight[:, j] > 0
        if np.ptp(q[:, j]) == 0:
            moving = np.zeros_like(moving)
        speeds = v[moving, j]
        reversals = int((speeds[1:] * speeds[:-1] < 0).sum())
        ends = np.quantile(q[:, j], [0.0, 1.0])
        shows, hides = _visible(
            speeds, reversals, ends, slides[j], loads[:, j], signals.now[:, j]
        )
        found.append(
            JointMotion(
                name=name,
                slides=bool(slides[j]),
                lowest=float(ends[0]),
                highest=float(ends[1]),
                fastest=float(np.quantile(np.abs(v[:, j]), 0.995)),
                reversals=reversals,
                resting=float(1 - moving.mean()),
                torques=(float(tau[:, j].min()), float(tau[:, j].max())),
                loads=(float(loads[:, j].min()), float(loads[:, j].max())),
                shows=shows,
                hides=hides,
            )
        )
    return tuple(found)


def _loads(model, states):
    """Return torques of gravity by the nominal inertias, ndarray (n, nv)."""
    features = RigidBodyFeatures(model, friction=()).fit(states[:1])
    still = np.zeros_like(states)
    still[:, : model.nv] = states[:, : model.nv]
    loads = features.matrices(still) @ nominal_parameters(model).ravel()
    # What is left about a vertical axis is rounding.
    size = np.abs(loads).max(axis=0)
    loads[:, size < 1e-9 * size.max(initial=0.0)] = 0.0
    return loads


def one_speed(speed):
    """Return the range of speeds (n,), not empty, if they are one only; else None."""
    ends = np.quantile(speed, [0.5 - 0.5 * _MIDDLE, 0.5 + 0.5 * _MIDDLE])
    return ends if ends[1] - ends[0] < _ONE_SPEED * ends.mean() else None


def _visible(speeds, reversals, ends, slides, load, torque):
    """Return what the motion of a joint shows and hides, two tuples of str."""
    if not speeds.size:
        return (), ("everything: it does not move",)
    shows, hides = [], []

    def put(what, reason):
        (hides if reason else shows).append(f"{what}: {reason}" if reason else what)

    put(
        "Coulomb friction beside an offset",
        "" if reversals else "it never reverses",
    )
    put(
        "viscous beside Coulomb friction",
        "" if one_speed(np.abs(speeds)) is None else "it keeps to one speed",
    )
    put(
        "hysteresis and backlash",
        ""
        if reversals >= _FEW_REVERSALS
        else f"it reverses {reversals} time(s), {_FEW_REVERSALS} are needed",
    )
    reach = ends[1] - ends[0]
    if not slides:
        put(
            "what varies with the position",
            ""
            if reach >= _WIDE
            else f"it covers {np.degrees(reach):.3g} of some 60 degrees",
        )
    spread, scale = np.ptp(load), np.std(torque)
    reason = ""
    if np.abs(load).max() <= 1e-6 * max(scale, 1e-12):
        reason = "gravity does not load it"
    elif spread <= 1e-9 * np.abs(load).max():
        # As on a vertical slide.
        reason = "gravity loads it alike everywhere, accelerations alone vary its load"
    elif spread < _SAME_LOAD * scale:
        unit = "N" if slides else "N m"
        reason = f"its load by gravity varies by {spread:.2g} {unit} only"
    put("friction that varies with the load", reason)
    return tuple(shows), tuple(hides)
