"""Whether a log fits the robot: one table of hypotheses, the most probable first."""

import numpy as np

from sklearn_vbjfa.inspection import _joints, _scene, _torques, _units
from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection._likelihood import DescribedRobot
from sklearn_vbjfa.inspection._reading import Reading, every, score_of
from sklearn_vbjfa.inspection._samples import (
    inspect_samples,
    shuffled_rows,
    unlike_channels,
)
from sklearn_vbjfa.inspection._signals import Change, long_parts
from sklearn_vbjfa.inspection._units import counts, unsigned_torques
from sklearn_vbjfa.model import is_prismatic, joint_names, load_model
from sklearn_vbjfa.recording import (
    COMMANDS,
    ChannelFinding,
    RecordingRefused,
    check_dt,
    contiguous_groups,
    in_order,
)

__all__ = ["ChannelFinding", "inspect_channels", "inspect_recording"]

# What was done to a log, and what is looked for once nothing else is found.
TABLE = (
    *_units.HYPOTHESES,
    *_joints.HYPOTHESES,
    *_torques.HYPOTHESES,
    *_scene.HYPOTHESES,
)
LAST = _scene.LAST
# What is found of torques whose unit is not N m or N, or not known.
OF_SIZE = ("torque_unit", "torque_factors", "gear_factor")


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
        Findings, the worst first. Kinds:

        - errors, which a search for effects would find instead of effects:
          "shuffled_rows", "wrapped_position", "position_degrees", "position_turns",
          "position_counts", "position_sign", "position_zeros" of all joints,
          "velocity_as_position", "copied_position", "copied_torque",
          "stuck_position", "wrong_dt", "constant_torque", "two_torques" if no torque
          has more than two values, "still_joint" if no joint moves,
          "unsigned_torque" if only sizes were logged, "torque_sign", "flipped_joint"
          (both signs), "swapped_torques", "swapped_positions", "swapped_joints"
          (both), "velocity_as_torque", "silent_torque", "no_gravity", "gravity_only",
          "base_orientation";
        - doubts, which rule out a favourable verdict: "torque_unit" if all torques are
          another multiple of N m, or the masses of the robot are wrong;
          "torque_factors" if each joint has a multiple; "gear_factor",
          "computed_torque", "external_force", "position_zero", "frozen_recording",
          "held_position", "held_torque", "torque_dropouts", "clipped_torque" of more
          than few samples, "repeated_rows" if there are many, "wrong_dt" if the motion
          is merely slower than a robot's, "position_jumps";
        - warnings: "clipped_torque", "coarse_torque", "delay", "torque_lowpass",
          "frozen_position", "repeated_rows", "position_spikes", "torque_spikes",
          "still_joint", and "unverified" for what this motion of this description
          cannot show.

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
    revolute = ~is_prismatic(model)
    findings, usable, q = inspect_samples(names, q, tau, dt, parts, rows, revolute)
    findings += unlike_channels(names, q, tau, dt, parts)
    if _names(findings, "velocity_as_torque", "copied_position"):
        return in_order(findings)
    commanded = drive is not None and drive.told in COMMANDS
    reading = Reading(model, names, q, tau, dt, parts, usable, commanded=commanded)
    unsigned = drive is not None and drive.unsigned
    return in_order(findings + _compared(reading, unsigned))


def _compared(reading, unsigned):
    """Return what the description of the robot shows of a log."""
    # Such positions allow no further question, nor do torques without signs.
    found = counts(reading)
    if found:
        return found
    without = unsigned_torques(reading)
    if without:
        return [] if unsigned else without
    if reading.tell_nothing():
        return _scene.too_fast(reading) + _unverified(reading)
    findings, reading = _examined(reading)
    if reading is None:
        return findings
    if not findings:
        findings = _scene.too_fast(reading) or _scene.crawling(reading)
    if not any(one.severity == "error" for one in findings):
        findings += _last(reading)
    return findings + _unverified(reading)


def _examined(reading):
    """Apply the most probable hypothesis until none is probable."""
    # Returns findings and the repaired log, None if it cannot be repaired.
    findings = []
    for _ in range(reading.nv + 3):
        best = _most_probable(reading)
        if best is None:
            break
        hypothesis, candidate, after = best
        findings.append(hypothesis.finding(reading, candidate))
        if after is None:
            return findings, None
        reading = after
    return findings, reading


def _most_probable(reading):
    """Return the best hypothesis, its candidate and the repaired log; None if none."""
    proposed = [
        (hypothesis, candidate)
        for hypothesis in TABLE
        if hypothesis.applies(reading)
        and (candidate := hypothesis.propose(reading)) is not None
        and candidate.log_odds > number.DECISIVE
    ]
    for hypothesis, candidate in sorted(proposed, key=lambda x: -x[1].log_odds):
        if not hypothesis.repairs:
            return hypothesis, candidate, None
        after = reading.changed(candidate.change)
        if _scores_better(reading, after):
            return hypothesis, candidate, after
    return None


def _scores_better(before, after):
    """Whether a log that was repaired agrees better with the description."""
    if after.tell_nothing():
        return False
    robot = DescribedRobot(after.bodies, after.signals, before.robot.times)
    return score_of(robot).evidence > before.now.evidence


def _last(reading):
    """Return what is looked for in a log that has the right channels."""
    found = []
    for hypothesis in LAST:
        if hypothesis.applies(reading):
            candidate = hypothesis.propose(reading)
            if candidate is not None and candidate.log_odds > number.DECISIVE:
                found.append(hypothesis.finding(reading, candidate))
    return found


def _unverified(reading):
    """Say what the description cannot show in this motion."""
    why = ""
    if reading.bodies.massless:
        why = "a body of the description has no mass"
    elif reading.signals is None or not reading.signals.informative().any():
        return []
    elif reading.bodies.weightless:
        why = "gravity loads no joint of the description"
    if why:
        message = (
            f"The size and the signs of the torques, the zeros and the direction of "
            f"gravity cannot be verified from this motion: {why}."
        )
        return [ChannelFinding("unverified", every(reading), "warning", message)]
    return _assumed_order(reading)


def _assumed_order(reading):
    """Say that an order of joints is assumed if the one by name fits as well."""
    order = np.argsort(reading.names, kind="stable")
    if (order == np.arange(reading.nv)).all():
        return []
    for other in (order, np.argsort(order)):
        score = reading.tried(Change(positions=other, torques=other))
        if score is None or reading.now.evidence - score.evidence > number.RIVAL:
            continue
        message = (
            "The columns are assumed to be in the order of the description "
            f"({', '.join(reading.names)}): in the order of the names the torques "
            "agree as well."
        )
        return [ChannelFinding("unverified", every(reading), "warning", message)]
    return []


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
