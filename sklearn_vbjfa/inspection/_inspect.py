"""Table of hypotheses about faults of a log, compared by their likelihood."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection import _positions as positions
from sklearn_vbjfa.inspection import _scene as scene
from sklearn_vbjfa.inspection import _torques as torques
from sklearn_vbjfa.inspection._likelihood import DescribedRobot
from sklearn_vbjfa.inspection._positions import implausible_speed
from sklearn_vbjfa.inspection._reading import Change, Reading, subsample
from sklearn_vbjfa.inspection._rows import CHECKS, Rows, shuffled_rows, wrong_states
from sklearn_vbjfa.inspection._sentences import finding
from sklearn_vbjfa.model import joint_names, load_folded, movable_joints
from sklearn_vbjfa.recording import (
    ChannelFinding,
    RecordingRefused,
    bridged,
    check_dt,
    contiguous_groups,
    findings_in_order,
    recording_names,
)


@dataclass(frozen=True)
class Hypothesis:
    """A possible fault of a log; its message is the entry of its name in SENTENCES."""

    name: str
    severity: str
    propose: Callable  # returns the best `Proposal` for a reading, or None
    needs: str = ""  # properties of `Reading` that must be true
    # When it is tested: before all others ("first": a match ends the inspection);
    # "always"; if torques fit the description poorly or another hypothesis is probable
    # ("poor"); after all others ("last"); or if nothing was found ("nothing else").
    when: str = "always"
    prior: float = number.PRIOR  # log odds against the unchanged log
    surpasses: str = ""  # log odds to exceed, properties of `DescribedRobot`

    def candidate(self, reading, fast=False):
        """Return the best candidate and its log odds if it is probable, or None."""
        # fast: whether speeds are implausible, so that the rivals do not explain them.
        applies = all(getattr(reading, name) for name in self.needs.split())
        proposal = self.propose(reading) if applies else None
        odds = proposal.log_odds + self.prior if proposal else -np.inf
        if odds <= number.DECISIVE:
            return None
        robot, far = reading.robot, {"one_joint": number.FAR_ODDS}
        limits = {x: getattr(robot, x) + far.get(x, 0) for x in self.surpasses.split()}
        rivals = [x for x, least in limits.items() if proposal.log_odds < least]
        if rivals == ["one_joint"]:
            # An effect on one joint may accompany a fault, but not replace it.
            after = reading.robot_after(proposal.change or Change())
            best, other = (x.baseline.evidence + x.one_joint for x in (after, robot))
            rivals *= int(best - other + self.prior <= number.DECISIVE)
        return None if rivals and not fast else (proposal, odds)

    def finding(self, reading, candidate, odds, rivals=()):
        """Return the finding; rivals: names of nearly as probable hypotheses."""
        evidence = f"log odds {odds:.0f}"
        if candidate.fall > 0.01 * reading.nv:
            fall = np.exp(candidate.fall / reading.robot.joints.size)
            evidence = f"squared errors fall by the factor {fall:.3g}, {evidence}"
        severity = candidate.severity or self.severity
        # Refusing a log without a fault is worse than missing a fault, and errors in a
        # motion are correlated, unlike those of poses.
        if severity == "error" and odds <= number.FAR_ODDS and not reading.poses:
            severity = "warning"
        facts = {"value": candidate.value, "remedy": candidate.remedy, "rivals": rivals}
        facts |= {"evidence": evidence, **candidate.facts}
        arguments = reading.names, candidate.joints, severity
        return finding(candidate.kind or self.name, *arguments, **facts)


# fmt: off
TABLE = (
    Hypothesis("position_counts", "error", positions.encoder_counts, when="first"),
    Hypothesis("commands", "error", positions.misread_commands, when="first"),
    Hypothesis("motion_as_torque", "error", torques.motion_as_torque, when="first"),
    Hypothesis("unsigned_torque", "error", torques.unsigned, when="first"),
    # -- positions and time
    Hypothesis("position_unit", "error", positions.units, "turns",
               surpasses="invented"),
    Hypothesis("position_unit:gear", "warning", positions.gear_factor, "turns"),
    Hypothesis("position_zeros", "error", partial(positions.zeros, few=False),
               "zeroed"),
    *(Hypothesis(name, "error", partial(positions.orders, what=what), "several", "poor",
                 surpasses="one_joint")
      for name, what in (("swapped_torques", "torques"),
                         ("swapped_positions", "positions"),
                         ("swapped_joints", "positions and torques"))),
    Hypothesis("flipped_joint", "error", partial(positions.flipped, torques=True),
               when="poor"),
    Hypothesis("position_sign", "error", partial(positions.flipped, torques=False),
               when="poor"),
    Hypothesis("coupled_position", "error", positions.coupled_axes, "several", "poor"),
    # Only a warning: another mounting or tool has the same effect on the torques.
    Hypothesis("position_zero", "warning", partial(positions.zeros, few=True),
               when="poor", surpasses="unmodelled"),
    Hypothesis("wrong_dt", "error", positions.periods,
               surpasses="invented load_friction one_joint"),
    # -- torques
    Hypothesis("torque_sign", "error", torques.signs, "measured"),
    Hypothesis("torque_unit", "warning", torques.common_scale, surpasses="loaded"),
    Hypothesis("torque_factors", "warning", torques.separate_scales, "measured",
               surpasses="loaded"),
    Hypothesis("mixed_torques", "warning", torques.mixed_torques, "measured several",
               "poor", surpasses="invented springs one_joint"),
    Hypothesis("computed_torque", "warning", torques.computed_torque, "measured"),
    Hypothesis("silent_torque", "error", torques.silent_torque, "measured"),
    # -- scene
    Hypothesis("no_gravity", "error", scene.weightless, "weighs"),
    Hypothesis("gravity_only", "error", scene.gravity_only, "weighs moves"),
    Hypothesis("no_gravity", "error", torques.missing_weight, "weighs",
               prior=2 * number.PRIOR, surpasses="springs load_friction one_joint"),
    Hypothesis("weight_factor", "error", scene.weight_factor, "weighs moves",
               prior=2 * number.PRIOR, surpasses="loaded springs one_joint"),
    Hypothesis("base_orientation", "error", scene.base_orientation, "weighs",
               surpasses="load_friction one_joint"),
    Hypothesis("external_force", "warning", scene.external_force, "moves", "poor"),
    Hypothesis("delay", "note", scene.large_lag, "moves", "poor"),
    Hypothesis("delay", "note", scene.torque_lag, "moves", "last"),
    Hypothesis("no_gravity", "warning", scene.unloaded_slides, "weighs moves", "last"),
    Hypothesis("driving_friction", "error", torques.driving_friction, "moves", "last"),
    Hypothesis("torque_unit", "warning", torques.beyond_limits, "measured", "last"),
    Hypothesis("other_robot", "warning", torques.other_robot, "measured poor",
               "nothing else"),
)
# fmt: on


__all__ = ["ChannelFinding", "inspect_channels", "inspect_recording"]

# Findings that are expected if the unit of the torques is unknown or not N m or N.
_SCALE_KINDS = ("torque_unit", "torque_factors", "gear_factor", "other_robot")
# Units of torques and forces; arrays have the unit "".
_TORQUES = {"N m", "N", ""}
# Hypotheses that change the speeds of a log.
_SPEED_KINDS = ("position_unit", "wrong_dt")


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
        Findings, the worst first. An "error" is what a search for effects would find
        instead of effects; a "warning" rules out a favourable verdict; a "note" is
        harmless, or says what this motion of this robot cannot show ("unverified").

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
    urdf = recording.urdf
    if model is None and urdf and movable_joints(urdf) == recording.joint_names:
        # The URDF also contains the mimic joints.
        model = urdf
    robot = recording.robot_model() if model is None else model
    gains = None if _TORQUES.issuperset(recording.torque_units) else "unknown"
    return inspect_as(recording, robot, gains=gains)


def inspect_as(recording, model, **settings):
    """Inspect a recording with the settings of `inspect_channels`."""
    if recording.dt is None:
        # Without dt, states may be in any order.
        return ()
    groups = np.asarray(recording.group_names)[recording.groups]
    channels = recording.q, bridged(recording).tau, recording.dt, groups
    settings |= {"named": recording.joints_named, "weight": recording.weight}
    settings["timed"] = recording.t is not None
    settings["feedback"], wrong = recording.feedback, tuple(wrong_states(recording))
    grave = any(x.severity == "error" for x in wrong)
    return wrong if grave else wrong + inspect_channels(model, *channels, **settings)


def refusal(findings, units=()):
    """Return a `RecordingRefused` for the errors among findings, or None."""
    # units: of measured torques, whose signs `gains` can correct; empty for a drive.
    errors = [x for x in findings if x.severity == "error"]
    if not errors:
        return None
    options = dict(errors[0].remedy) if len(errors) == 1 else {}
    if "gains" in options and not (units and _TORQUES.issuperset(units)):
        options = {}
    return RecordingRefused(" ".join(x.message for x in errors), options)


def common_lag(findings):
    """Return the lag [s] that all torques have in all recordings, or zero."""
    return sum(x.value for x in findings if (x.kind, x.severity) == ("delay", "note"))


def inspect_channels(
    model, q, tau, dt, groups=None, *, bodies="prior", weight=None, timed=False, **known
):
    """Inspect channels that are given as arrays; see `inspect_recording`."""
    # tau: may be a motor quantity; bodies: as in `RobotIdentifier`; weight (n_samples,
    # nv): zero for samples to ignore; timed: whether messages give times, since rows
    # may be interpolated; known: further fields of `Reading`.
    robot, dt, poses = load_folded(model), check_dt(dt), known.get("poses")
    names, (q, tau) = joint_names(robot.model), (np.asarray(x, float) for x in (q, tau))
    if q.shape != tau.shape or q.shape[1:] != (len(names),):
        raise ValueError(
            f"q and tau must both have shape (n_samples, {len(names)}), one column for "
            f"each of {', '.join(names)}; got {q.shape} and {tau.shape}."
        )
    single = poses is not None and len(poses.row) == len(q)
    groups = None if single else groups
    all_parts = contiguous_groups(groups, len(q))
    shuffled = [] if single else shuffled_rows(names, q, all_parts)
    rows, parts = subsample(all_parts, least=1 if single else number.MIN_SAMPLES)
    if shuffled or not parts:
        return findings_in_order(shuffled)
    # Column-major order, since channels are processed one by one.
    q, tau = (np.asfortranarray(x[rows]) for x in (q, tau))
    recordings = recording_names(groups, rows[[part.start for part in parts]])

    def place(row):
        if not timed:
            return f"row {rows[row]}"
        k = next(k for k, part in enumerate(parts) if row < part.stop)
        origin = f"in {recordings[k]}" if len(parts) > 1 else "after the start"
        return f"{(row - parts[k].start) * dt:.6g} s {origin}"

    log = Rows(robot, names, q, tau, dt, parts, place)
    if weight is not None:
        log.usable &= weight[rows] > 0
        log.counted &= log.usable.any(axis=1)
    for check in () if single else CHECKS:
        check(log)
    log.usable[:, log.still & (not single)] = False
    refused = {"copied_position", "shuffled_rows"} & {x.kind for x in log.findings}
    if refused or log.every % 1:
        return findings_in_order(log.findings)
    q, tau, usable = log.q, log.tau, log.usable
    if log.every > 1:
        # Held positions are compared at their update rate.
        rows, parts = subsample(parts, log.every)
        q, tau, usable = q[rows], tau[rows], usable[rows]
    dt *= log.every
    known["recordings"] = recordings
    reading = Reading(robot, names, q, tau, dt, parts, usable, **known)
    if len(parts) > 1 or any(x.severity == "error" for x in log.findings):
        findings = _compare_recordings(reading)
    else:
        findings = _compare_parts(reading, [k // log.every for k in log.jumps], place)
    excluded = {
        *(() if reading.gains is None else _SCALE_KINDS),
        "torque_unit" if bodies == "free" else "",
        "unsigned_torque" if getattr(reading.drive, "unsigned", False) else "",
        # Faulty rows do not show whether the log is of another robot.
        "other_robot" if any(x.severity != "note" for x in log.findings) else "",
    }
    findings = [x for x in findings if x.kind not in excluded]
    return findings_in_order(log.findings + findings)


def _compare(reading):
    """Return findings by the robot description, and the corrected log or None."""
    # Positions in counts or torques without signs allow no further test.
    for hypothesis, match in _probable(reading, "first"):
        return [hypothesis.finding(reading, *match)], None
    if reading.is_uninformative():
        return implausible_speed(reading) + _unverified(reading), None
    findings, reading = _apply_hypotheses(reading)
    if reading is None:
        return findings, None
    findings = findings or implausible_speed(reading)
    grave = any(x.severity == "error" for x in findings)
    matches = [] if grave else _probable(reading, "last")
    matches = matches or ([] if findings else _probable(reading, "nothing else"))
    findings += [x.finding(reading, *y) for x, y in matches]
    return findings + _unverified(reading), reading


def _compare_parts(reading, jumps, place):
    """Return findings of a log, or of its parts if only these explain the torques."""
    # jumps: rows at which positions jump and parts begin, by default one row.
    findings, after = _compare(reading)
    if after is None or not after.poor:
        return findings
    starts = [0]
    for k in sorted(jumps) or [_row_of_change(reading)]:
        # Joints jump together, or one after the other.
        starts += [k] * (k - starts[-1] >= number.MIN_SAMPLES)
    starts.append(len(reading.q))
    parts = [slice(*ends) for ends in pairwise(starts)]
    split = replace(reading, parts=parts, recordings=len(parts) * reading.recordings)
    each = [split.select_parts([k], alone=True) for k in range(len(parts))]
    # All must fit far better than the whole log, and those without a fault well.
    most, well = after.robot.baseline.loss.mean() - number.CLEAR, number.WORST
    if not any(_leaves_less(part, most, well) for part in each):
        return findings
    compared = [_compare(part) for part in each]
    wrong = [[x for x in found if x.kind != "unverified"] for found, _ in compared]
    explains = any(wrong)
    for faulty, (_, part) in zip(wrong, compared):
        near = np.inf if faulty else well
        explains &= bool(faulty and not part) or _leaves_less(part, most, near)
    if not explains:
        return findings
    names = [f"Up to about {place(starts[1])}"]
    names += [f"From about {place(k)} on" for k in starts[1:-1]]
    return [_of_part(x, name) for xs, name in zip(wrong, names) for x in xs]


def _leaves_less(part, most, well):
    """Whether mean log errors are below `most`, and all relative ones below `well`."""
    if part is None or part.is_uninformative():
        return False
    loss = part.robot.baseline.loss
    return bool(loss.mean() < most and loss.max() < 2 * np.log(well))


def _row_of_change(reading):
    """Return the row from which on other parameters explain the torques best."""
    rows, best = reading.signals.row, 0
    step = n = rows.size

    def gain(k):
        whole, (_, before), (_, after) = reading.robot.losses(np.arange(n) < k)
        return (n * whole - k * before - (n - k) * after).sum()

    while step > 1:
        step = max(1, step // 8)
        tested = range(max(0, best - 8 * step), min(n, best + 8 * step), step)
        best = max(tested, key=gain)
    return int(rows[best])


def _of_part(finding, name):
    """Return a finding on a part of the log or on one of its recordings."""
    # A fit may correct a fault of the whole log, but not one of a part.
    severity = "error" if finding.severity == "error" else "warning"
    message = f"{name}: {finding.message}"
    return replace(finding, severity=severity, message=message, remedy={})


def _compare_recordings(reading):
    """Return findings of the consistent recordings, and of each deviating one."""
    labels = [] if reading.is_uninformative() else reading.robot.signals.recording
    found = np.unique(labels).tolist()
    several = 1 < len(found) <= number.MANY
    outliers = [k for k in found if several and reading.robot.deviates(labels == k)]
    others = sorted(set(range(len(reading.parts))) - set(outliers))
    if outliers:
        rest = reading.robot.signals.select_rows(np.isin(labels, others))
        others = others if rest.informative().any() else []
    alone = {k: _compare(reading.select_parts([k], alone=True))[0] for k in outliers}
    pairs = [(k, x) for k, xs in alone.items() for x in xs if x.kind != "unverified"]
    lags = [x for x in pairs if x[1].severity == "note" and _is_common(reading, *x)]
    pairs = [pair for pair in pairs if pair not in lags]
    all_wrong = not others and len({k for k, _ in pairs}) == len(outliers)
    if not outliers or all_wrong or (lags and not pairs):
        return _compare(reading)[0]
    rest = reading.select_parts(others) if others else None
    names = [f"Recording {x} alone" for x in reading.recordings]
    found = _compare(rest)[0] if others else _unverified(reading)
    return found + [_of_part(x, names[k]) for k, x in pairs]


def _is_common(reading, k, late):
    """Whether a lag of one recording alone is as probable for all of them."""
    signals = reading.robot.signals
    shift = late.value / reading.dt * signals.slope
    shifts = shift, shift * (signals.recording == k)[:, None]
    each, alone = (reading.robot.fit(tau=signals.tau + x).evidence for x in shifts)
    return each > alone - number.RIVAL


def _apply_hypotheses(reading):
    """Apply the most probable hypothesis until none is probable."""
    # Returns findings and the corrected log, None if it cannot be corrected.
    findings = []
    for _ in range(reading.nv + 3):
        proposed = _probable(reading, "always")
        if reading.poor or proposed:
            proposed += _probable(reading, "poor")
        proposed.sort(key=lambda match: -match[1][1])
        best_unclear = -np.inf
        for hypothesis, (candidate, odds) in proposed:  # noqa: B007
            if not candidate.clear:
                best_unclear = max(best_unclear, odds)
                continue
            if candidate.change and odds < best_unclear - number.RIVAL:
                # An inconclusive hypothesis is far more probable.
                continue
            after = candidate.change and reading.apply(candidate.change)
            if after is None:
                break
            if not after.is_uninformative():
                robot = DescribedRobot(after.bodies, after.signals, reading.robot.times)
                if robot.baseline.evidence > reading.robot.baseline.evidence:
                    break
        else:
            break
        rivals = []
        for rival, (match, other_odds) in proposed:
            # At equal errors only the prior of the bodies decides, which is uncertain.
            equal = 0 < candidate.fall < match.fall + 1
            most = number.FAR_ODDS if equal else number.RIVAL
            if rival is not hypothesis and odds - other_odds < most:
                rivals.append((match.kind or rival.name).partition(":")[0])
        findings.append(hypothesis.finding(reading, candidate, odds, rivals))
        if after is None:
            return findings, None
        reading = after
    return findings, reading


def _probable(reading, when):
    """Return probable hypotheses, each with its candidate and log odds."""
    # At implausible speeds, only hypotheses that change the speeds are tested.
    fast = any(x.severity == "error" for x in implausible_speed(reading))
    fast = fast and when != "first"
    rows = [x for x in TABLE if x.when == when and (not fast or x.name in _SPEED_KINDS)]
    matches = [(row, row.candidate(reading, fast)) for row in rows]
    return [pair for pair in matches if pair[1] is not None]


def _unverified(reading):
    """Return a note on a property that this motion cannot verify, in a list."""
    reason = ""
    if reading.bodies.massless:
        reason = "massless"
    elif reading.is_uninformative() or len(reading.signals.row) < number.ENOUGH_ROWS:
        return []
    elif reading.bodies.weightless:
        reason = "weightless"
    elif not reading.commanded and _is_scale_ambiguous(reading.robot):
        reason = "size" if reading.gains is None else ""
    elif not reading.named and _is_order_ambiguous(reading):
        reason = "order"
    arguments = reading.names, reading.every, "note"
    return [finding(f"unverified:{reason}", *arguments)] if reason else []


def _is_scale_ambiguous(robot):
    """Whether the motion does not determine the scale of the torques."""
    torques = robot.described[:, :, None]
    fit = robot.fit(mean=np.zeros_like(robot.described), columns=torques)
    return abs(fit.factors[0]) < number.INTERVAL * fit.errors[0]


def _is_order_ambiguous(reading):
    """Whether another common joint order fits as well as that of the description."""
    baseline, orders = reading.robot.baseline, positions.usual_orders(reading)
    changes = sorted(map(positions.reordered, orders), key=reading.score)
    fits = filter(None, map(reading.fit_change, changes[: number.MOST_LIKELY]))
    least = baseline.evidence - number.RIVAL
    return any(x.fall(baseline) > -number.CLEAR or x.evidence > least for x in fits)
