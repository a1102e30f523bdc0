"""How well a simulated robot follows a motion with an identified model in control."""

from dataclasses import dataclass

import numpy as np
from sklearn.utils import check_random_state

from sklearn_vbjfa.datasets._simulation import ClosedLoop, low_gains

# Rows between two looks at whether the robot is still in hand.
_CHUNK = 512
# A joint that goes faster than this times its speed limit counts as run away.
_SPEEDING = 2.0


@dataclass(frozen=True, kw_only=True)
class TrackingResult:
    """How well a motion was followed.

    Parameters
    ----------
    position_rmse : ndarray of shape (nv,)
        Root mean square of desired minus true position [rad or m]; nan if failed.
    velocity_rmse : ndarray of shape (nv,)
        The same of the velocity [rad/s or m/s].
    feedback_rms : ndarray of shape (nv,)
        Root mean square of the feedback command [N m or N].
    failure : str
        What stopped the robot; empty if nothing did.
    duration : float
        How long it ran [s].
    """

    position_rmse: np.ndarray
    velocity_rmse: np.ndarray
    feedback_rms: np.ndarray
    failure: str
    duration: float

    @property
    def failed(self):
        """Whether the robot had to be stopped."""
        return bool(self.failure)

    def averages(self):
        """Position, velocity and feedback, averaged over the joints as in the paper.

        Returns
        -------
        tuple of float
            Averages [rad, rad/s, N m]; nan if failed.
        """
        return tuple(
            float(np.mean(x))
            for x in (self.position_rmse, self.velocity_rmse, self.feedback_rms)
        )


def simulate_tracking(
    plant,
    motion,
    feedforward,
    *,
    duration=20.0,
    dt=1.0 / 480.0,
    gains=None,
    encoder_noise=1e-4,
    settle=1.0,
    substeps=1,
    random_state=None,
) -> TrackingResult:
    """Let a robot follow a motion by feedforward torques and low-gain feedback.

    Computed torque in the form of section 5.2 of [1]_: the identified model says the
    torques of the desired motion, which is noiseless, and the feedback, from noisy
    encoders, does the rest.

    Parameters
    ----------
    plant : Plant
        The robot as it is, such as ``recording.plant``.
    motion : SineMotion
        Desired motion, such as one of ``recording.motions``.
    feedforward : callable or array-like of shape (n, nv)
        Commands to feed forward [N m or N], or what makes them of the desired states
        [q | v | a] of shape (n, 3 * nv), such as ``identifier.predict``.
    duration : float, default=20.0
        Length of the motion [s]; n is ``round(duration / dt)``.
    dt : float, default=1/480
        Period of the controller [s].
    gains : Gains, default=None
        Feedback; None takes low ones.
    encoder_noise : float, default=1e-4
        Standard deviation of the white position noise [rad or m].
    settle : float, default=1.0
        Time at the start that does not count [s]: the robot begins in the desired
        state, but its cables and actuators have yet to follow.
    substeps : int, default=1
        Steps of the integration in a period.
    random_state : int, RandomState instance or None, default=None
        Seed of the noise.

    Returns
    -------
    TrackingResult
        Errors of each joint, and whether the robot had to be stopped: a joint beyond
        its limit or at more than twice its speed limit, or no number at all.

    Raises
    ------
    ValueError
        If the feedforward has another shape than the motion, or there are no samples
        after `settle`.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import (
    ...     make_closed_loop_recording,
    ...     simulate_tracking,
    ... )
    >>> robot = make_closed_loop_recording("head", duration=1.0, random_state=0)
    >>> result = simulate_tracking(
    ...     robot.plant, robot.motions[0], robot.plant.inverse_dynamics,
    ...     duration=3.0, dt=robot.dt, random_state=0,
    ... )
    >>> result.failed, bool(result.averages()[0] < 0.01)
    (False, True)
    """
    rng = check_random_state(random_state)
    n, skipped = round(duration / dt), round(settle / dt)
    if skipped >= n:
        raise ValueError(
            f"duration={duration} s leaves nothing to judge after settle={settle} s."
        )
    nv = plant.model.nv
    states = motion.states(np.arange(n) * dt)
    forward = feedforward(states) if callable(feedforward) else feedforward
    forward = np.asarray(forward, dtype=float)
    if forward.shape != (n, nv):
        raise ValueError(
            f"feedforward must have shape {(n, nv)}, one row of torques a period; got "
            f"{forward.shape}."
        )
    if not np.isfinite(forward).all():
        return _stopped(nv, "feedforward that is no number", 0.0)
    noise = encoder_noise * rng.normal(size=forward.shape)
    gains = low_gains(plant) if gains is None else gains
    loop = ClosedLoop(plant, gains, dt, states[:1], forward[:1], substeps)
    sums = np.zeros((3, nv))
    for first in range(0, n, _CHUNK):
        rows = slice(first, min(first + _CHUNK, n))
        parts = states[rows, :nv], forward[rows], noise[rows]
        answer = loop.run(*(part[:, None] for part in parts))
        q, v, _, command = (part[:, 0] for part in answer)
        row, failure = _first_failure(plant.model, q, v)
        if failure:
            return _stopped(nv, failure, (first + row) * dt)
        counted = slice(max(skipped - first, 0), None)
        errors = (
            q - states[rows, :nv],
            v - states[rows, nv : 2 * nv],
            command - forward[rows],
        )
        sums += [np.sum(error[counted] ** 2, axis=0) for error in errors]
    position, velocity, feedback = np.sqrt(sums / (n - skipped))
    return TrackingResult(
        position_rmse=position,
        velocity_rmse=velocity,
        feedback_rms=feedback,
        failure="",
        duration=n * dt,
    )


def _stopped(nv, failure, time):
    nothing = np.full(nv, np.nan)
    return TrackingResult(
        position_rmse=nothing,
        velocity_rmse=nothing,
        feedback_rms=nothing,
        failure=failure,
        duration=float(time),
    )


def _first_failure(model, q, v):
    """Row and description of the first thing that stops a robot; (0, "") if none."""
    limit = model.velocityLimit
    limit = np.where(limit > 0, _SPEEDING * limit, np.inf)
    # Comparisons that are False for what is no number.
    inside = (q >= model.lowerPositionLimit) & (q <= model.upperPositionLimit)
    slow = np.abs(v) <= limit
    bad = np.flatnonzero(~(inside & slow).all(axis=1))
    if bad.size == 0:
        return 0, ""
    row = int(bad[0])
    joint = int(np.flatnonzero(~(inside & slow)[row])[0])
    name = model.names[joint + 1]
    if not (np.isfinite(q[row]).all() and np.isfinite(v[row]).all()):
        return row, "diverged"
    what = "over speed" if inside[row, joint] else "beyond its limit"
    return row, f"{name} {what}"
