"""The closed loop on the held-out part: models driven by commands alone."""

import warnings
from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.diagnosis.explain._curves import TimeLine, over_time
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.robot._from_commands import Follower
from sklearn_vbjfa.robot._windows import tell_once

# At most so much of the held-out part is simulated [s]: the beginnings of its
# stretches.
_MOST = 60.0


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandsAlone:
    """Positions that models reach on the held-out part, told its commands alone."""

    # (nv,): root mean square of simulated minus measured positions [rad or m], of the
    # declared model, with the plain terms, and of the completed one; nan where a
    # simulation did not come to its end
    before: np.ndarray
    plain: np.ndarray
    after: np.ndarray
    told: np.ndarray  # (nv,): the same of commanded minus measured positions
    units: tuple  # "rad" or "m"
    seconds: float  # that each model was simulated [s]
    n_stretches: int  # each from its measured first state on
    failed: dict = field(default_factory=dict)  # why, by the name of the error
    left_out: tuple = ()  # effects of the completed model that are not simulated


def commands_alone(models, stretches, recording):
    """Simulate `Models` on held-out stretches; None without a drive of positions.

    Returns `CommandsAlone`, and the `TimeLine` of the positions with the stretches one
    after the other.
    """
    drive = models.declared.drive
    if drive is None or not drive.of_positions:
        return None, None
    dt, nv = recording.dt, recording.nv
    lengths = [rows.stop - rows.start for rows in stretches]
    most = max(lengths)
    if sum(lengths) * dt > _MOST:
        most = max(int(_MOST / dt / len(lengths)), 2)
    parts = [slice(x.start, min(x.start + most, x.stop)) for x in stretches]
    measured, _ = models.judged.robot_.query(recording.inputs, recording.groups)
    known = {"before": models.declared, "plain": models.plain, "after": models.judged}
    found, failed, left_out = {}, {}, ()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for model in counted(list(dict.fromkeys(known.values())), "closed loop"):
            try:
                follower = Follower(model.robot_, drive, recording)
                if model is models.judged:
                    left_out = follower.left_out
                states = [
                    follower.run(rows, measured[rows.start], recording.t[rows])
                    for rows in parts
                ]
                found[model] = np.concatenate(states)[:, :nv]
            except ValueError as error:
                found[model], failed[model] = None, str(error)
    tell_once(caught, "models", stacklevel=2)
    q = np.concatenate([recording.q[rows] for rows in parts])
    aim = np.reshape(recording.signals[drive.told], recording.q.shape)
    aim = np.concatenate([aim[rows] for rows in parts])
    reached = {
        name: np.full(q.shape, np.nan) if found[one] is None else found[one]
        for name, one in known.items()
    }
    result = CommandsAlone(
        **{name: _size(x - q) for name, x in reached.items()},
        told=_size(aim - q),
        units=tuple(
            "m" if slides else "rad"
            for slides in is_prismatic(models.judged.features_.model_)
        ),
        seconds=len(q) * dt,
        n_stretches=len(parts),
        failed={name: failed[one] for name, one in known.items() if one in failed},
        left_out=left_out,
    )
    return result, _line(parts, q, reached, dt)


def _size(errors):
    return np.sqrt((errors**2).mean(axis=0))


def _line(parts, q, reached, dt):
    """Positions over time, `TimeLine`, the stretches one after the other."""
    starts = np.cumsum([rows.stop - rows.start for rows in parts])[:-1]
    torques = over_time(
        dt * np.arange(len(q)),
        starts,
        q,
        reached["before"],
        reached["after"],
        np.ones(q.shape, dtype=bool),
        dt,
    )
    return TimeLine(
        torques=torques,
        borders=tuple((dt * starts).tolist()),
        untouched=(),
        in_seconds=True,
    )
