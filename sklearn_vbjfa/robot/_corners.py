"""When joints turn round, by estimated velocities whose corners are rounded."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa.robot._equations import delayed_command_torque, regressor_rows

# Rows at which the inertia of a joint is looked at.
_ROWS = 64
# Frequencies of the integral, in cut-offs: what lies beyond is a share of 1e-3.
_LOWEST, _HIGHEST, _COUNT = 0.1, 1e3, 4000


def with_corners(robot, source):
    """Return a fitted robot whose plan knows its corners, None where there are none."""
    # Of drives whose law is known. Torques that are measured belong to controllers
    # which nothing is known of, and may take the jump away.
    plan, features = robot.plan, robot.features_
    estimator, feedback = plan.state_estimator, source.recording.feedback
    if feedback is None or estimator is None:
        return None
    nothing = np.zeros(source.recording.nv)
    terms = dict(zip(features.friction_, robot.bodies(robot.theta_)[:, 10:].T))
    command = delayed_command_torque(source.recording, robot.effects_)
    torques = [_of_effects(robot, source), command]
    further, commanded = _jumps_of(torques, robot, source)
    dry = terms.get("coulomb", nothing) + further
    if not dry.any():
        return None
    # Friction that is commanded ahead takes the jump away.
    dry = np.maximum(dry - commanded, 0.0)
    damping = feedback[1] + np.maximum(terms.get("viscous", 0.0), 0.0)
    rotors = np.maximum(terms.get("rotor_inertia", nothing), 0.0)
    inertia = _inertias(robot, rotors, source.states)
    jumps = [
        jump(*own) for own in zip(dry, inertia, damping, feedback[0], estimator.cutoff_)
    ]
    return replace(robot, plan=replace(plan, corners=np.array(jumps)))


def jump(dry, inertia, damping, stiffness, cutoff):
    """Half of the jump of an acceleration that rounds a velocity as the drive does."""
    if not (np.isfinite(cutoff) and inertia > 0 and dry > 0):
        return 0.0
    x = np.geomspace(_LOWEST, _HIGHEST, _COUNT)
    omega = 2 * np.pi * cutoff * x
    lost = x**10 / (1 + x**10)
    answer = 1.0 / (inertia * omega**2 - stiffness - 1j * damping * omega)
    late = 2 * dry / np.pi * np.trapezoid(lost * answer.real, omega)
    return max(late, 0.0) / _smoothing.rounding(cutoff)


def _of_effects(robot, source):
    """Torques (n, nv) of the effects of a fitted robot along its motion."""
    known = source.recording, source.states.own, robot.plan, robot.features_
    made = regressor_rows(*known, theta=robot.load_parameters)
    return np.concatenate([rows.effects(robot.theta_) for rows in made])


def _jumps_of(torques, robot, source):
    """Half of the jump (nv,) that each of some torques (n, nv) makes at turns."""
    # Of what the smoother leaves out of it, the part that goes with what it leaves out
    # of the signs.
    estimator, groups = robot.plan.state_estimator, source.recording.groups
    nv = source.recording.nv
    speed = np.concatenate([own[slice(None)] for own in source.states.own])
    signs = np.sign(speed.reshape(len(speed), -1)[:, nv : 2 * nv])
    signs, *torques = (
        x - estimator.transform(x, groups=groups)[:, :nv] for x in (signs, *torques)
    )
    power = (signs**2).sum(axis=0)
    power = np.where(power > 0, power, 1.0)
    return [(torque * signs).sum(axis=0) / power for torque in torques]


def _inertias(robot, rotors, states):
    """Inertia (nv,) of each joint while all others are free, in the mean of poses."""
    # Columns of the inertia matrix are torques that accelerations ask for: bodies that
    # were fitted need not be physical.
    nv = rotors.size
    a, found = np.vstack([np.zeros(nv), np.eye(nv)]), []
    for own in states.own:
        for i in np.unique(np.linspace(0, own.shape[0] - 1, _ROWS).astype(int)):
            q = np.tile(own[slice(i, i + 1)].reshape(-1)[:nv], (nv + 1, 1))
            still, *columns = robot.features_.torques(q, 0.0 * a, a, robot.inertial())
            mass = np.array(columns) - still + np.diag(rotors)
            found.append(1.0 / np.diagonal(np.linalg.pinv(mass)))
    return np.mean(found, axis=0)
