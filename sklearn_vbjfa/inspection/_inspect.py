"""Whether a log fits the robot: one table of hypotheses, the most probable first."""

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection import _positions, _torques
from sklearn_vbjfa.inspection._likelihood import DescribedRobot
from sklearn_vbjfa.inspection._reading import Change, Reading, long_parts, thinned
from sklearn_vbjfa.inspection._rows import inspect_rows, shuffled_rows
from sklearn_vbjfa.inspection._sentences import finding
from sklearn_vbjfa.model import is_prismatic, joint_names, load_model
from sklearn_vbjfa.recording import (
    ChannelFinding,
    RecordingRefused,
    check_dt,
    contiguous_groups,
    in_order,
)

__all__ = ["ChannelFinding", "inspect_channels", "inspect_recording"]

# What was done to a log, and what is looked for once nothing else is found.
TABLE = (*_positions.HYPOTHESES, *_torques.HYPOTHESES)
# What is found of torques whose unit is not N m or N, or not known.
OF_SIZE = ("torque_unit", "torque_factors", "gear_factor", "other_robot")


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
    options = dict(errors[0].remedy) if len(errors) == 1 else {}
    if "gains" in options and not (units and _are_torques(units)):
        options = {}
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
        Findings, the worst first. An "error" is what a search for effects would find
        instead of effects; a "doubt" rules out a favourable verdict; a "warning" is
        harmless, or says what this motion of this robot cannot show ("unverified").

    Notes
    -----
    After a common low-pass, the torques of all joints are fitted together: by the
    described bodies, whose parameters may be off by half, and by friction, rotor and
    offset of each joint. Friction takes power out of the motion. Each hypothesis
    changes channels, time or gravity, and the marginal likelihood gives its odds
    against the unchanged log; correlated residuals count as fewer rows. The most
    probable hypothesis is applied to the log, accepted if the changed log scores
    better, and the next one is looked for, so that one fault does not look like
    another.

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
    q, tau = _check_arrays(model, q, tau)
    names = joint_names(model)
    shuffled = shuffled_rows(names, q, contiguous_groups(groups, len(q)), groups)
    rows, parts = long_parts(len(q), groups)
    if shuffled or not parts:
        return in_order(shuffled)
    q, tau = q[rows], tau[rows]
    log = inspect_rows(names, q, tau, dt, parts, rows, ~is_prismatic(model))
    if _names(log.findings, "motion_as_torque", "copied_position"):
        return in_order(log.findings)
    # Positions that were held are compared at the rate that they have.
    rows, parts = thinned(parts, log.every)
    q, tau, usable = (x[rows] for x in (log.q, tau, log.usable))
    dt *= log.every
    reading = Reading(model, names, q, tau, dt, parts, usable, drive=drive)
    found = _compared(reading)
    if any(one.severity != "warning" for one in log.findings):
        # Which robot it is cannot be said of rows that are wrong.
        found = [one for one in found if one.kind != "other_robot"]
    return in_order(log.findings + found)


def _compared(reading):
    """Return what the description of the robot shows of a log."""
    # Such positions allow no further question, nor do torques without signs.
    found = _positions.counts(reading)
    if found:
        return found
    without = _torques.unsigned_torques(reading)
    if without:
        return [] if reading.drive is not None and reading.drive.unsigned else without
    if reading.tell_nothing():
        return _positions.implausible_speed(reading) + _unverified(reading)
    findings, reading = _examined(reading)
    if reading is None:
        return findings
    findings = findings or _positions.implausible_speed(reading)
    if not any(one.severity == "error" for one in findings):
        for hypothesis in _torques.LAST:
            candidate = hypothesis.candidate(reading)
            if candidate is not None:
                findings.append(hypothesis.finding(reading, candidate))
    candidate = None if findings else _torques.OTHER.candidate(reading)
    if candidate is not None:
        findings = [_torques.OTHER.finding(reading, candidate)]
    return findings + _unverified(reading)


def _examined(reading):
    """Apply the most probable hypothesis until none is probable."""
    # Returns findings and the repaired log, None if it cannot be repaired.
    findings = []
    for _ in range(reading.nv + 3):
        proposed = [x for x in TABLE if not x.if_poor]
        proposed = _proposed(reading, proposed)
        if reading.poor or proposed:
            proposed += _proposed(reading, [x for x in TABLE if x.if_poor])
        proposed.sort(key=lambda pair: -pair[1].log_odds)
        for hypothesis, candidate in proposed:
            after = reading.changed(candidate.change) if hypothesis.repairs else None
            if after is None or _scores_better(reading, after):
                break
        else:
            break
        if not candidate.clear:
            if hypothesis.unclear:
                findings.append(hypothesis.warning(reading, candidate))
            break
        rivals = [
            (one.kind or other.name).partition(":")[0]
            for other, one in proposed
            if other is not hypothesis
            and candidate.log_odds - one.log_odds < number.RIVAL
        ]
        findings.append(hypothesis.finding(reading, candidate, rivals))
        if after is None:
            return findings, None
        reading = after
    return findings, reading


def _proposed(reading, hypotheses):
    """Return hypotheses that are probable, each with its candidate."""
    found = [(one, one.candidate(reading)) for one in hypotheses]
    return [(one, candidate) for one, candidate in found if candidate is not None]


def _scores_better(before, after):
    """Whether a log that was repaired agrees better with the description."""
    if after.tell_nothing():
        return False
    robot = DescribedRobot(after.bodies, after.signals, before.robot.times)
    return robot.now.evidence > before.robot.now.evidence


def _unverified(reading):
    """Say what the description cannot show in this motion."""
    if reading.bodies.massless:
        return [_warning(reading, "unverified:massless")]
    if reading.tell_nothing() or len(reading.signals.row) < number.ENOUGH_ROWS:
        return []
    found = []
    if reading.bodies.weightless:
        found.append(_warning(reading, "unverified:weightless"))
    elif not reading.commanded and _size_assumed(reading.robot):
        found.append(_warning(reading, "unverified:size"))
    elif _order_assumed(reading):
        found.append(_warning(reading, "unverified:order"))
    return found


def _warning(reading, kind, **facts):
    return finding(kind, reading.names, reading.every, "warning", **facts)


def _size_assumed(robot):
    """Whether torques of any size fit the described bodies as well."""
    columns = robot.described[:, :, None]
    fit = robot.fit(mean=np.zeros_like(robot.described), columns=columns)
    return abs(fit.factors[0]) < number.INTERVAL * fit.errors[0]


def _order_assumed(reading):
    """Whether another usual order of joints fits as well as that of the description."""
    now = reading.robot.now
    for order in reading.usual_orders():
        fit = reading.tried(Change(positions=order, torques=order))
        as_well = fit is not None and fit.fall(now) > -number.CLEAR
        if as_well or (fit is not None and fit.evidence > now.evidence - number.RIVAL):
            return True
    return False


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
