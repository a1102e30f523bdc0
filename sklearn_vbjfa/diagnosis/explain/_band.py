"""The band in which errors are taken: what decided it, and how much lies in it."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.robot._plan import CUTOFF_PER_BANDWIDTH, resolve_cutoff


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """The band of a fit, and what lies in it."""

    cutoff: float  # of regressor and torques [Hz]; infinity if nothing is filtered
    # bandwidth of the motion; length of the recording, of which the filter may be a
    # small part only; the user, with a frequency or with None; states that were given,
    # which are not filtered; or a motion too fast for the sample rate to be filtered
    decided_by: str
    # what the motion asks for [Hz]; infinity for none, nan if the states were given
    automatic: float
    # frequency below which 99 % of the power of the fastest joint's velocity lies [Hz];
    # nan if the states were given
    bandwidth: float
    fastest: int  # that joint, from zero
    # cut-off of its states [Hz], where its motion meets the encoder noise unless it was
    # given; infinity where nothing is smoothed
    smoothed_at: float
    # (nv,): share of the power (about the mean) of velocity and torque that the
    # low-pass lets through, while the joint moves; nan for a joint that does not
    speed_share: np.ndarray
    torque_share: np.ndarray
    sample_rate: float  # [Hz]; nan if unknown


def measure_band(view, tau, longest):
    """Describe the band of a fitted declared model, as a `Band`."""
    # view: `RecordingView` of the part that was searched; tau (n, nv): its torques as
    # recorded [N m or N]; longest: rows of its longest piece.
    robot = view.robot
    estimator, nv = robot.state_estimator_, view.nv
    bandwidth, fastest, smoothed_at, automatic = np.nan, 0, np.nan, np.nan
    if estimator is not None:
        fastest = int(np.argmax(estimator.bandwidth_))
        bandwidth = float(estimator.bandwidth_[fastest])
        smoothed_at = float(estimator.cutoff_[fastest])
        automatic = resolve_cutoff("auto", longest, robot.dt, estimator)
    velocity = view.states[:, nv : 2 * nv]
    weight = view.equations.weight
    return Band(
        cutoff=float(robot.cutoff_),
        decided_by=_decided_by(robot, bandwidth),
        automatic=automatic,
        bandwidth=bandwidth,
        fastest=fastest,
        smoothed_at=smoothed_at,
        speed_share=power_share(velocity[view.index], view.filtered(velocity), weight),
        torque_share=power_share(tau[view.index], view.equations.tau, weight),
        sample_rate=np.nan if robot.dt is None else 1.0 / robot.dt,
    )


def _decided_by(robot, bandwidth):
    """Say what the cut-off of a fitted identifier follows from."""
    finite = np.isfinite(robot.cutoff_)
    if not isinstance(robot.cutoff, str):
        return "given" if finite else "none"
    if robot.state_estimator_ is None:
        return "states"
    if not finite:
        return "sample rate"
    motion = CUTOFF_PER_BANDWIDTH * bandwidth
    return "motion" if np.isclose(robot.cutoff_, motion) else "length"


def power_share(raw, filtered, weight):
    """Share of the power of signals (m, nv) that is left of them behind a filter."""
    # Their power is about their mean; weight (m, nv) tells which rows count. nan for a
    # constant signal.
    with np.errstate(divide="ignore", invalid="ignore"):
        total = weight.sum(axis=0)
        mean = (weight * raw).sum(axis=0) / total
        power = (weight * (raw - mean) ** 2).sum(axis=0)
        lost = (weight * (raw - filtered) ** 2).sum(axis=0)
        return np.where(power > 0, np.clip(1.0 - lost / power, 0.0, 1.0), np.nan)
