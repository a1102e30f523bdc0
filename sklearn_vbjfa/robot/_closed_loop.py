"""Parameters from the simulated closed loop: direct and inverse dynamic models.

The robot is simulated with its controller, which keeps it near the measured motion
whatever the parameters. Least squares of the measured torques on the regressor of the
noise-free simulated states, repeated, is DIDIM (Gautier, Janot and Vandanjon, IEEE
Trans. Control Syst. Technol. 21(2), 2013, doi:10.1109/TCST.2012.2185697). The states
hardly depend on the parameters there, so that no sensitivities are needed.
"""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._lowpass import decimate
from sklearn_vbjfa.effects import CommandDelay
from sklearn_vbjfa.recording import Drive, PDDrive
from sklearn_vbjfa.robot._from_commands import law_of
from sklearn_vbjfa.robot._output_error import TOLERANCE, Refined, SimulationCriteria
from sklearn_vbjfa.robot._sensitivities import held_parameters
from sklearn_vbjfa.robot._states import RecordingStates
from sklearn_vbjfa.simulation import SimulationError, simulate_controlled

_MOST_ROUNDS = 20
# A step is halved so many times at most.
_MOST_HALVES = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """A simulated closed loop."""

    theta: np.ndarray  # (p,): of the robot
    states: np.ndarray  # (n, 3 * nv): simulated
    # (nv,): root mean square of simulated minus measured positions [rad or m] and,
    # behind the low-pass of the fit, torques [N m or N]
    positions: np.ndarray
    torques: np.ndarray

    @classmethod
    def of(cls, predictor, theta, recording, states, controller, reference):
        """Simulate all recordings from their measured first states."""
        predictor = replace(predictor, theta_=theta)
        robot, nv = predictor.torque_model(), recording.tau.shape[1]
        plan, simulated = predictor.plan, np.empty((*recording.tau.shape, 3))
        clock = plan.clock(recording)
        kp, kd = controller.law(predictor.joint_names_)
        most = controller.most(predictor.joint_names_)
        errors = []
        simulated = simulated.reshape(-1, 3 * nv)
        for part, own in zip(recording.segments, states.own):
            start = own[slice(0, 1)].reshape(-1)
            q_ref = reference[part]
            v_ref = 0.0 * q_ref
            if controller.feedforward:
                v_ref = np.gradient(q_ref, recording.dt, axis=0)
            control = law_of(kp * q_ref + kd * v_ref, kp, kd, most)
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


def _size(errors):
    return np.sqrt((errors**2).mean(axis=0))


def refine_controlled(
    predictor, found, recording, states, controller, reference, estimate_from
):
    """Refine the parameters of a torque fit with the simulated closed loop."""
    # reference (n, nv): commanded positions; estimate_from: `RecordingStates` ->
    # `Estimate` of the measured torques with the regressor of these states. Steps are
    # halved until the simulated controller's torques come closer to the measured ones,
    # weighted as in the fit. Returns `Refined`.

    def run(theta):
        return Loop.of(predictor, theta, recording, states, controller, reference)

    def value(loop):
        return float(found.joint_weights @ loop.torques**2)

    first = loop = run(predictor.theta_)
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


# -- a controller and its reference ----------------------------------------------------


def check_reference(controller, reference, y, dt, names):
    """Return the reference (n, nv) of a closed loop, refusing what does not suit it."""
    n, nv = y.shape
    if controller is None:
        if reference is not None:
            raise ValueError(
                "reference is given without a controller: set controller to a "
                "PDDrive with criterion='simulation'."
            )
        return None
    if not isinstance(controller, PDDrive):
        raise ValueError(f"controller must be a PDDrive or None; got {controller!r}.")
    controller.law(names)
    controller.updates(dt)
    if reference is None:
        raise ValueError(
            "controller needs the commanded positions: give fit(..., reference=), one "
            f"row per sample, shape ({n}, {nv})."
        )
    reference = np.asarray(reference, dtype=float)
    if reference.ndim == 1 and nv == 1:
        reference = reference[:, None]
    if reference.shape != (n, nv):
        raise ValueError(
            f"reference must hold one row per sample and one column per joint, shape "
            f"({n}, {nv}); got {reference.shape}."
        )
    bad = np.argwhere(~np.isfinite(reference))
    if bad.size:
        raise ValueError(
            f"reference holds {reference[tuple(bad[0])]} in row {bad[0][0]}, joint "
            f"{bad[0][1]}."
        )
    return reference


# -- drives that are told something else than torques ----------------------------------


def check_drive(settings):
    """Refuse a drive that is none, or beside what it cannot be combined with."""
    drive = settings.drive
    if drive is None:
        return
    if not isinstance(drive, Drive):
        raise ValueError(
            "drive must be a PDDrive, CurrentDrive, VoltageDrive or None; got "
            f"{drive!r}. Torques need no drive."
        )
    gains = settings.gains
    if gains is not None and drive.gains is None:
        raise ValueError(
            "drive has gains of its own, and cannot be combined with gains: leave "
            "gains=None."
        )


def delay_of(drive, declared):
    """Return the delay of a drive's commands as declared effects, a tuple."""
    if drive is None or not drive.delayed:
        return ()
    own = [effect for effect in declared if isinstance(effect, CommandDelay)]
    return () if own else (CommandDelay(),)
