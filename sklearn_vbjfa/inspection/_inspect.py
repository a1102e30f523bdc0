"""Hypotheses about faults of a log, in one table, compared by likelihood."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection import _positions as positions
from sklearn_vbjfa.inspection import _scene as scene
from sklearn_vbjfa.inspection import _torques as torques
from sklearn_vbjfa.inspection._likelihood import DescribedRobot
from sklearn_vbjfa.inspection._positions import implausible_speed
from sklearn_vbjfa.inspection._reading import Reading, long_parts, thinned
from sklearn_vbjfa.inspection._rows import CHECKS, Rows, shuffled_rows
from sklearn_vbjfa.inspection._sentences import finding
from sklearn_vbjfa.model import joint_names, load_folded, movable_joints
from sklearn_vbjfa.recording import (
    ChannelFinding,
    RecordingRefused,
    bridged,
    check_dt,
    contiguous_groups,
    in_order,
    recording_names,
)


@dataclass(frozen=True)
class Hypothesis:
    """One row of the table; its sentence, with the remedy, is that of its name."""

    name: str
    severity: str
    propose: Callable  # returns the best `Proposal` for a reading, or None
    needs: str = ""  # properties of a reading that can show it
    # When it is looked for: before all others, which it precludes; always; only if
    # torques agree badly with the description or another hypothesis is probable; after
    # all others; or if nothing was found.
    when: str = "always"
    prior: float = number.PRIOR  # log odds against the log as it is
    # Other masses or springs that may explain as much, of `DescribedRobot`.
    surpasses: str = ""

    def candidate(self, reading):
        """Return the best candidate and its log odds if it is probable, or None."""
        applies = all(getattr(reading, name) for name in self.needs.split())
        found = self.propose(reading) if applies else None
        odds = found.log_odds + self.prior if found else -np.inf
        if odds <= number.DECISIVE:
            return None
        others = (getattr(reading.robot, name) for name in self.surpasses.split())
        if any(found.log_odds < one for one in others):
            return None
        return found, odds

    def finding(self, reading, candidate, odds, rivals=()):
        """Return the finding; rivals: names of hypotheses that are as probable."""
        evidence = f"log odds {odds:.0f}"
        if candidate.fall > 0.01 * reading.nv:
            fall = np.exp(candidate.fall / reading.robot.joints.size)
            evidence = f"squared errors fall by the factor {fall:.3g}, {evidence}"
        return finding(
            candidate.kind or self.name,
            reading.names,
            candidate.joints,
            candidate.severity or self.severity,
            value=candidate.value,
            remedy=candidate.remedy,
            rivals=rivals,
            evidence=evidence,
            **candidate.facts,
        )


# fmt: off
TABLE = (
    Hypothesis("position_counts", "error", positions.counts, when="first"),
    Hypothesis("motion_as_torque", "error", torques.of_motion, when="first"),
    Hypothesis("unsigned_torque", "error", torques.unsigned, when="first"),
    # -- positions and time
    Hypothesis("position_unit", "error", positions.units, "turns"),
    Hypothesis("position_unit:gear", "warning", positions.gear, "turns",
               surpasses="invented"),
    Hypothesis("position_zeros", "error", partial(positions.zeros, few=False),
               "zeroed"),
    Hypothesis("swapped_torques", "error", partial(positions.orders, what="torques"),
               "several", "poor"),
    Hypothesis("swapped_positions", "error",
               partial(positions.orders, what="positions"), "several", "poor"),
    Hypothesis("swapped_joints", "error",
               partial(positions.orders, what="positions and torques"), "several",
               "poor"),
    Hypothesis("flipped_joint", "error", partial(positions.mirrored, torques=True),
               when="poor"),
    Hypothesis("position_sign", "error", partial(positions.mirrored, torques=False),
               when="poor"),
    Hypothesis("coupled_position", "error", positions.coupled, "several", "poor"),
    # A warning: another mounting or tool looks the same, with a wrong geometry only.
    Hypothesis("position_zero", "warning", partial(positions.zeros, few=True),
               when="poor", surpasses="invented springs"),
    Hypothesis("wrong_dt", "error", positions.periods, surpasses="invented"),
    # -- torques
    Hypothesis("torque_sign", "error", torques.signs, "measured"),
    Hypothesis("torque_unit", "warning", torques.scaled, surpasses="loaded"),
    Hypothesis("torque_factors", "warning", torques.scaled_each, "measured",
               surpasses="loaded"),
    Hypothesis("mixed_torques", "warning", torques.mixed, "measured several", "poor",
               surpasses="invented springs"),
    Hypothesis("computed_torque", "warning", torques.computed, "measured"),
    Hypothesis("silent_torque", "error", torques.silent, "measured"),
    # -- scene
    Hypothesis("no_gravity", "error", scene.weightless, "weighs"),
    Hypothesis("gravity_only", "error", scene.weight_alone, "weighs"),
    Hypothesis("base_orientation", "error", scene.turned, "weighs"),
    Hypothesis("external_force", "warning", scene.contact, "measured", "poor"),
    Hypothesis("delay", "note", scene.late, "measured", "last"),
    Hypothesis("torque_unit", "warning", torques.beyond_limits, "measured", "last"),
    Hypothesis("other_robot", "warning", torques.of_another, "measured poor",
               "nothing else"),
)
# fmt: on


__all__ = ["ChannelFinding", "inspect_channels", "inspect_recording"]

# What is found of torques whose unit is not N m or N, or not known.
_OF_SIZE = ("torque_unit", "torque_factors", "gear_factor", "other_robot")
# What changes the speeds of a log.
_OF_SPEED = ("position_unit", "wrong_dt")


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
        The page on log formats explains them.

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
        # With the joints that follow others.
        model = urdf
    robot = recording.robot_model() if model is None else model
    gains = None if _are_torques(recording.torque_units) else "unknown"
    return inspect_as(recording, robot, gains=gains)


def inspect_as(recording, model, **settings):
    """Inspect a recording under settings of `inspect_channels`."""
    return inspect_channels(
        model,
        recording.q,
        bridged(recording).tau,
        recording.dt,
        np.asarray(recording.group_names)[recording.groups],
        named=recording.joints_named,
        weight=recording.weight,
        **settings,
    )


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


def common_lag(findings):
    """Return the lag [s] of all torques in all recordings, zero for none."""
    return sum(x.value for x in findings if (x.kind, x.severity) == ("delay", "note"))


def contradicted(tau, errors, size):
    """Whether a fit contradicts the description, so that its log is inspected."""
    # tau (n, nv); errors (nv,): what the fit leaves of it; size: factor of all torques
    # against the description, and its relative error.
    factor, error = size
    scale = np.abs(np.log(max(factor, 1e-300)))
    far = scale > max(np.log(number.SCALE), number.DECISIVE * error)
    # Rows without torques, amid the others, look like smaller torques.
    empty = (tau == 0).all(axis=1).any()
    return bool(far or empty or (errors > number.WORST * np.std(tau, axis=0)).any())


def inspect_channels(
    model,
    q,
    tau,
    dt,
    groups=None,
    *,
    drive=None,
    gains=None,
    bodies="prior",
    named=False,
    weight=None,
):
    """Inspect channels that are given as arrays; see `inspect_recording`."""
    # q, tau (n_samples, nv): as of a `Recording`, or a motor quantity for torques.
    # drive, gains, bodies: as of `RobotIdentifier`. Of commands only the order of
    # magnitude is judged; with gains to identify no size of torques is a fault, with
    # free bodies no factor of all. named: whether channels carry the joints' names;
    # weight (n_samples, nv): zero for samples that do not count.
    model, dt = load_folded(model).still, check_dt(dt)
    # Channels one after another: they are looked at one by one.
    q, tau = (np.asarray(x, dtype=float, order="F") for x in (q, tau))
    names = joint_names(model)
    if q.shape != tau.shape or q.shape[1:] != (model.nv,):
        raise ValueError(
            f"q and tau must both have shape (n_samples, {model.nv}), one column for "
            f"each of {', '.join(names)}; got {q.shape} and {tau.shape}."
        )
    every = contiguous_groups(groups, len(q))
    shuffled = shuffled_rows(names, q, every)
    rows, parts = long_parts(len(q), groups)
    if shuffled or not parts:
        return in_order(shuffled)
    if len(rows) < len(q):
        q, tau = q[rows], tau[rows]
    log = Rows(model, names, q, tau, dt, parts, rows)
    if weight is not None:
        log.usable &= weight[rows] > 0
        log.counted &= log.usable.any(axis=1)
    for check in CHECKS:
        check(log)
    log.usable[:, log.still] = False
    if "copied_position" in {one.kind for one in log.findings}:
        return in_order(log.findings)
    q, tau, usable = log.q, log.tau, log.usable
    if log.every > 1:
        # Positions that were held are compared at the rate that they have.
        rows, parts = thinned(parts, log.every)
        q, tau, usable = q[rows], tau[rows], usable[rows]
    dt *= log.every
    reading = Reading(model, names, q, tau, dt, parts, usable, drive, named)
    called = recording_names(groups, [x.start for x in every])
    long = [part.stop - part.start >= number.MIN_SAMPLES for part in every]
    called = list(itertools.compress(called, long))
    found = _of_recordings(reading, called)
    unknown = set(_OF_SIZE) if gains is not None else set()
    if bodies == "free":
        unknown.add("torque_unit")
    if drive is not None and drive.unsigned:
        unknown.add("unsigned_torque")
    if any(one.severity != "note" for one in log.findings):
        # Which robot it is cannot be said of rows that are wrong.
        unknown.add("other_robot")
    found = [one for one in found if one.kind not in unknown]
    return in_order(log.findings + found)


def _compared(reading):
    """Return what the description of the robot shows of a log."""
    # Such positions allow no further question, nor do torques without signs.
    for hypothesis, found in _proposed(reading, "first"):
        return [hypothesis.finding(reading, *found)]
    if reading.tell_nothing():
        return implausible_speed(reading) + _unverified(reading)
    findings, reading = _examined(reading)
    if reading is None:
        return findings
    findings = findings or implausible_speed(reading)
    others = []
    if not any(one.severity == "error" for one in findings):
        others = _proposed(reading, "last")
    others = others or ([] if findings else _proposed(reading, "nothing else"))
    findings += [x.finding(reading, *y) for x, y in others]
    return findings + _unverified(reading)


def _of_recordings(reading, names):
    """Return what is found in recordings that agree, and in each that does not."""
    apart = [] if reading.tell_nothing() else reading.apart()
    rest = sorted(set(range(len(reading.parts))) - set(apart))
    alone = {k: _compared(reading.of_recordings([k], alone=True)) for k in apart}
    each = [(k, x) for k, own in alone.items() for x in own if x.kind != "unverified"]
    if not apart or (not rest and len({k for k, _ in each}) == len(apart)):
        return _compared(reading)
    found = _compared(reading.of_recordings(rest)) if rest else _unverified(reading)
    # What all have in common a fit may correct, but not what a single one has.
    return found + [
        replace(
            one,
            severity="error" if one.severity == "error" else "warning",
            message=f"Recording {names[k]} alone: {one.message}",
            remedy={},
        )
        for k, one in each
    ]


def _examined(reading):
    """Apply the most probable hypothesis until none is probable."""
    # Returns findings and the repaired log, None if it cannot be repaired.
    findings = []
    for _ in range(reading.nv + 3):
        proposed = _proposed(reading, "always")
        if reading.poor or proposed:
            proposed += _proposed(reading, "poor")
        proposed.sort(key=lambda one: -one[1][1])
        unclear = -np.inf
        for hypothesis, (candidate, odds) in proposed:  # noqa: B007
            if not candidate.clear:
                unclear = max(unclear, odds)
                continue
            if candidate.change and odds < unclear - number.RIVAL:
                # Something else is the matter.
                continue
            after = candidate.change and reading.changed(candidate.change)
            if after is None or _is_better(after, reading.robot):
                break
        else:
            break
        rivals = [
            (one.kind or other.name).partition(":")[0]
            for other, (one, its_odds) in proposed
            if other is not hypothesis and odds - its_odds < number.RIVAL
        ]
        findings.append(hypothesis.finding(reading, candidate, odds, rivals))
        if after is None:
            return findings, None
        reading = after
    return findings, reading


def _proposed(reading, when):
    """Return hypotheses that are probable, each with its candidate and log odds."""
    # At impossible speeds only what changes them is asked.
    fast = any(one.severity == "error" for one in implausible_speed(reading))
    fast = fast and when != "first"
    rows = [x for x in TABLE if x.when == when and (not fast or x.name in _OF_SPEED)]
    found = [(one, one.candidate(reading)) for one in rows]
    return [pair for pair in found if pair[1] is not None]


def _is_better(log, before):
    """Whether a log that was repaired agrees better with the description."""
    if log.tell_nothing():
        return False
    robot = DescribedRobot(log.bodies, log.signals, before.times)
    return robot.now.evidence > before.now.evidence


def _unverified(reading):
    """Say what the description cannot show in this motion."""
    reason = ""
    if reading.bodies.massless:
        reason = "massless"
    elif reading.tell_nothing() or len(reading.signals.row) < number.ENOUGH_ROWS:
        return []
    elif reading.bodies.weightless:
        reason = "weightless"
    elif not reading.commanded and _size_assumed(reading.robot):
        reason = "size"
    elif not reading.named and _order_assumed(reading):
        reason = "order"
    args = reading.names, reading.every, "note"
    return [finding(f"unverified:{reason}", *args)] if reason else []


def _size_assumed(robot):
    """Whether torques of any size fit the described bodies as well."""
    columns = robot.described[:, :, None]
    fit = robot.fit(mean=np.zeros_like(robot.described), columns=columns)
    return abs(fit.factors[0]) < number.INTERVAL * fit.errors[0]


def _order_assumed(reading):
    """Whether another usual order of joints fits as well as that of the description."""
    now, orders = reading.robot.now, positions.usual_orders(reading)
    fits = (reading.tried(positions.reordered(order)) for order in orders)
    return any(
        fit.fall(now) > -number.CLEAR or fit.evidence > now.evidence - number.RIVAL
        for fit in fits
        if fit is not None
    )
