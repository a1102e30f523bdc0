"""Positions that models reach on the held-out data, from its commands alone."""

import warnings

import numpy as np

from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.robot._windows import CommandFollower, warn_once

# At most so much of the held-out part is simulated [s]: the beginnings of its
# stretches.
_SIMULATED = 60.0


def commands_alone(models, stretches, recording):
    """Return errors of simulated positions; None without a drive of positions.

    The errors ``before``, ``plain``, ``after`` and, of a robot at its commanded
    positions, ``commands`` are (nv,) root mean squares [rad or m]; nan where a
    simulation did not come to its end, with the reason in ``failed``. Each stretch is
    simulated from its measured first state.
    """
    drive, dt = models.declared.drive, recording.dt
    if drive is None or not drive.of_positions:
        return None
    parts = _beginnings(stretches, dt)
    aim = np.reshape(recording.signals[drive.told], recording.q.shape)
    q, aim = (np.concatenate([x[rows] for rows in parts]) for x in (recording.q, aim))
    known = {"before": models.declared, "plain": models.plain, "after": models.judged}
    reached, failed, left_out = _reached(models, drive, recording, parts)
    slides = is_prismatic(models.judged.features_.model_)
    errors = {name: reached[one] - q for name, one in known.items()}
    errors["commands"] = aim - q
    result = {name: np.sqrt((x**2).mean(axis=0)) for name, x in errors.items()}
    return result | {
        "units": tuple("m" if one else "rad" for one in slides),
        "seconds": len(q) * dt,
        "failed": {name: failed[one] for name, one in known.items() if one in failed},
        "left_out": left_out,  # effects of the completed model that are not simulated
    }


def _beginnings(stretches, dt):
    """Return the beginnings of stretches that are simulated."""
    lengths = [rows.stop - rows.start for rows in stretches]
    most = max(lengths)
    if sum(lengths) * dt > _SIMULATED:
        most = max(int(_SIMULATED / dt / len(lengths)), 2)
    return [slice(x.start, min(x.start + most, x.stop)) for x in stretches]


def _reached(models, drive, recording, parts):
    """Simulate the models: positions, reasons of failure, effects left out."""
    measured = models.judged.robot_.states(recording.inputs, recording.groups)
    found, failed, left_out = {}, {}, ()
    three = dict.fromkeys((models.declared, models.plain, models.judged))
    count = sum(rows.stop - rows.start for rows in parts)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for model in counted(list(three), "closed loop", len(three)):
            found[model] = np.full((count, recording.nv), np.nan)
            try:
                follower = CommandFollower(model.robot_, drive, recording)
                left_out = follower.left_out if model is models.judged else left_out
                states = [
                    follower.run(rows, measured[rows.start], recording.t[rows])
                    for rows in parts
                ]
                found[model] = np.concatenate(states)[:, : recording.nv]
            except ValueError as error:
                failed[model] = str(error)
    warn_once(caught, "models", stacklevel=2)
    return found, failed, left_out
