"""Parameters from the simulated closed loop: direct and inverse dynamic models.

The robot is simulated with its controller, which keeps it near the measured motion
whatever the parameters. The simulated states are free of noise; least squares of the
measured torques on the regressor matrix that they give, repeated, is DIDIM [1]_. The
states hardly depend on the parameters there, which is why no sensitivities are needed.

References
----------
.. [1] M. Gautier, A. Janot, P.-O. Vandanjon, "A new closed-loop output error method for
   parameter identification of robot dynamics", IEEE Trans. Control Syst. Technol.
   21(2), 2013. :doi:`10.1109/TCST.2012.2185697`
"""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._lowpass import decimate
from sklearn_vbjfa.robot._output_error import (
    TOLERANCE,
    Refined,
    SimulationCriteria,
)
from sklearn_vbjfa.robot._sensitivities import held_parameters
from sklearn_vbjfa.robot._states import RecordingStates
from sklearn_vbjfa.simulation import SimulationError, simulate_controlled

_MOST_ROUNDS = 20
# A step is halved so many times at most.
_MOST_HALVES = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """A simulated closed loop.

    Attributes
    ----------
    theta : ndarray of shape (p,)
        Parameters of the robot.
    states : ndarray of shape (n, 3 * nv)
        Simulated states.
    positions, torques : ndarray of shape (nv,)
        Root mean square of simulated minus measured positions [rad or m] and, behind
        the low-pass of the fit, torques [N m or N].
    """

    theta: np.ndarray
    states: np.ndarray
    positions: np.ndarray
    torques: np.ndarray

    @classmethod
    def of(cls, predictor, theta, recording, states, controller, reference):
        """Simulate all recordings from their measured first states."""
        predictor = replace(predictor, theta=theta)
        robot, nv = predictor.torque_model(), recording.tau.shape[1]
        plan, simulated = predictor.plan, np.empty((*recording.tau.shape, 3))
        clock = plan.clock(recording)
        errors = []
        simulated = simulated.reshape(-1, 3 * nv)
        for part, own in zip(recording.segments, states.own):
            start = own[slice(0, 1)].reshape(-1)
            q_ref = reference[part]
            v_ref = np.gradient(q_ref, recording.dt, axis=0)
            control = _follow(controller, q_ref, v_ref)
            n = part.stop - part.start
            t = recording.dt * np.arange(n)
            if plan.timed:
                t = clock[part]
            simulated[part], tau = simulate_controlled(
                robot,
                control,
                start[:nv],
                start[nv : 2 * nv],
                t,
                {name: x[part] for name, x in recording.signals.items()},
                controller.updates(recording.dt),
            )
            errors.append(decimate(plan.lowpass, tau - recording.tau[part]))
        return cls(
            theta=theta,
            states=simulated,
            positions=_size(simulated[:, :nv] - recording.q),
            torques=_size(np.concatenate(errors)),
        )


def _follow(controller, q_ref, v_ref):
    """Let a controller follow a reference (n, nv), which goes straight between rows."""

    def at(values, row):
        i = min(int(row), len(values) - 2)
        return values[i] + (row - i) * (values[i + 1] - values[i])

    def control(row, q, v):
        return controller.torque(at(q_ref, row), at(v_ref, row), q, v)

    return control


def _size(errors):
    return np.sqrt((errors**2).mean(axis=0))


def refine_controlled(
    predictor, found, recording, states, controller, reference, estimate_from
):
    """Refine the parameters of a torque fit with the simulated closed loop.

    reference (n, nv) : commanded positions; estimate_from : `RecordingStates` ->
    `Estimate` of the measured torques with the regressor of these states. Steps are
    halved until the torques of the simulated controller come closer to the measured
    ones, weighted as in the fit. Returns `Refined`.
    """

    def run(theta):
        return Loop.of(predictor, theta, recording, states, controller, reference)

    def value(loop):
        return float(found.joint_weights @ loop.torques**2)

    first = loop = run(predictor.theta)
    held = held_parameters(predictor)
    unconstrained, std = found.theta_unconstrained, found.std
    taken, converged = 0, False
    for _ in range(_MOST_ROUNDS):
        own = RecordingStates.of_rows(recording.segments, loop.states)
        asked = estimate_from(own)
        change = np.where(held, 0.0, asked.theta - loop.theta)
        trial = None
        for half in range(_MOST_HALVES + 1):
            try:
                trial = run(loop.theta + 0.5**half * change)
            except SimulationError:
                continue
            if value(trial) < value(loop):
                break
            trial = None
        if trial is None:
            converged = True
            break
        fell = value(loop) - value(trial)
        loop, taken = trial, taken + 1
        unconstrained, std = asked.theta_unconstrained, asked.std
        std = np.where(held, found.std, std)
        if fell < TOLERANCE * value(loop):
            converged = True
            break
    lengths = [part.stop - part.start for part in recording.segments]
    criteria = SimulationCriteria(
        position_before=first.positions,
        position_after=loop.positions,
        torque_before=first.torques,
        torque_after=loop.torques,
        n_windows=len(lengths),
        window=(max(lengths) - 1) * recording.dt,
        n_iterations=taken,
        converged=converged,
    )
    return Refined(
        theta=loop.theta, unconstrained=unconstrained, std=std, criteria=criteria
    )
