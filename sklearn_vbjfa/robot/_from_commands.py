"""A robot under its drive, simulated from commands alone."""

import warnings

import numpy as np

from sklearn_vbjfa.effects import OfChannel
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording._drives import velocity_lags
from sklearn_vbjfa.robot._equations import delayed_command_torque
from sklearn_vbjfa.simulation import simulate_controlled

# Why an effect of a torque channel is not simulated under a drive.
_AT_ONCE = "torques of the drive act at once"
# Drives set their torque at least so often, in simulation [s].
_DRIVE_PERIOD = 1e-3


def unfollowed(effect):
    """Why a simulation under a drive goes without an effect; "" if it does not."""
    return effect.not_simulated or (_AT_ONCE if isinstance(effect, OfChannel) else "")


class Follower:
    """A robot under its drive, told the commands of a recording and nothing else."""

    # robot: `IdentifiedRobot`.

    def __init__(self, robot, drive, recording):
        made, names = drive.driven(recording), recording.joint_names
        self._command = delayed_command_torque(made, robot.effects_)
        self._gains = [
            np.broadcast_to(x, self._command.shape) for x in drive.law(names, recording)
        ]
        self._most = drive.most(names)
        self._model, self._dt = robot.torque_model(), recording.dt
        self._updates = drive.updates(recording.dt, _DRIVE_PERIOD)
        self._lags = np.maximum(velocity_lags(recording), 0.0)
        self._signals = {k: x for k, x in recording.signals.items() if x.ndim == 1}
        # effects that a simulation goes without, in words
        self.left_out = tuple(
            f"{one.name} on {names[one.joint]} ({unfollowed(one)})"
            for one in robot.effects_
            if unfollowed(one)
        )

    def tell_left_out(self, stacklevel):
        """Warn of effects that a simulation goes without."""
        if self.left_out:
            warnings.warn(
                f"The simulation leaves out {'; '.join(self.left_out)}.",
                DoubtWarning,
                stacklevel=stacklevel + 1,
            )

    def run(self, rows, start, t):
        """Simulate rows, a slice, from a state (3 nv,) on; t (n,) is their time."""
        nv = self._command.shape[1]
        kp, kd = (x[rows] for x in self._gains)
        law = law_of(self._command[rows], kp, kd, self._most)
        states, _ = simulate_controlled(
            self._model,
            _seen_late(law, self._lags, self._dt, self._updates),
            start[:nv],
            start[nv : 2 * nv],
            t,
            {name: x[rows] for name, x in self._signals.items()},
            self._updates,
        )
        return states


def follow(robot, drive, recording, window=None):
    """Simulate a robot from its commands, from the states of a recording on."""
    # robot: `IdentifiedRobot`; window: length [s] after which it starts from the
    # recorded state again, None for whole recordings. Returns states (n, 3 nv).
    follower, clock = Follower(robot, drive, recording), recording.clock()
    follower.tell_left_out(stacklevel=3)
    measured, _ = robot.query(recording.inputs, recording.groups)
    length = recording.n_samples
    if window is not None:
        length = max(round(window / recording.dt), 2)
    parts = [
        slice(first, min(first + length, part.stop))
        for part in recording.segments
        for first in range(part.start, part.stop, length)
    ]
    found = [follower.run(rows, measured[rows.start], clock[rows]) for rows in parts]
    return np.concatenate(found)


def _seen_late(control, lags, dt, updates):
    """Let a controller see velocities that are late by lags (nv,) [s]."""
    if not lags.any():
        return control
    back, past, joints = lags * updates / dt, [], np.arange(lags.size)

    def late(row, q, v):
        past.append(np.array(v))
        ago = np.clip(len(past) - 1 - back, 0.0, None)
        first = ago.astype(int)
        second = np.minimum(first + 1, len(past) - 1)
        known = np.array(past[int(first.min()) :])
        first, second, share = first - first.min(), second - first.min(), ago % 1.0
        seen = known[first, joints]
        return control(row, q, seen + share * (known[second, joints] - seen))

    return late


def law_of(command, kp, kd, most):
    """Let a drive follow commands (n, nv) that go straight between rows."""
    kp, kd = (np.broadcast_to(x, command.shape) for x in (kp, kd))

    def control(row, q, v):
        i = min(int(row), len(command) - 1)
        j = min(i + 1, len(command) - 1)
        asked = command[i] + (row - i) * (command[j] - command[i])
        return np.clip(asked - kp[i] * q - kd[i] * v, -most, most)

    return control
