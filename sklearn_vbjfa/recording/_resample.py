"""Put logs with irregular time stamps on a uniform time grid."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline

# A steady clock written with six decimals is uniform up to this part of dt.
_UNIFORM_RTOL = 1e-3
# Fewer samples than this between two gaps cannot be differentiated.
_MIN_SAMPLES = 10


@dataclass(frozen=True, kw_only=True)
class Log:
    """One recording as read: stamps [s] and channels, first axis time."""

    name: str
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    v: np.ndarray | None = None
    signals: Mapping[str, np.ndarray] = field(default_factory=dict)


def resample_uniform(
    t: np.ndarray,
    channels: Mapping[str, np.ndarray],
    *,
    dt: float,
    cubic: Sequence[str] = ("q",),
    drop_repeated: bool = False,
    max_gap: float = 10.0,
) -> list[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Interpolate channels on a uniform grid, without bridging long gaps.

    Parameters
    ----------
    t : ndarray of shape (n_samples,)
        Time stamps [s], non-decreasing.
    channels : mapping of str to ndarray of shape (n_samples, ...)
        Values at the stamps.
    dt : float
        Period of the grid [s].
    cubic : sequence of str, default=("q",)
        Channels interpolated by a cubic spline; the others are linear.
    drop_repeated : bool, default=False
        Also drop a row equal to the one before in every channel: a reading
        that the logger wrote twice.
    max_gap : float, default=10.0
        A step above `max_gap * dt` ends a part and starts another one.

    Returns
    -------
    parts : list of (ndarray of shape (n_part,), dict)
        Grid from 0 on [s] and channels of each part that has at least 10
        samples. A log that is uniform already is returned as it is.

    Raises
    ------
    ValueError
        If the stamps decrease or no part is long enough.
    """
    step = np.diff(t)
    if np.any(step < 0):
        raise ValueError(
            "Time stamps must not decrease, they do after row "
            f"{np.flatnonzero(step < 0)[0]}; sort the rows or split the log there."
        )
    keep = np.concatenate([[True], step > 0])
    if drop_repeated:
        repeated = np.ones(len(t) - 1, dtype=bool)
        for values in channels.values():
            rows = values.reshape(len(t), -1)
            repeated &= np.all(rows[1:] == rows[:-1], axis=1)
        keep[1:] &= ~repeated
    t = t[keep]
    channels = {key: values[keep] for key, values in channels.items()}

    parts = []
    ends = np.flatnonzero(np.diff(t) > max_gap * dt) + 1
    for rows in np.split(np.arange(len(t)), ends):
        if len(rows) < _MIN_SAMPLES:
            continue
        part = {key: values[rows] for key, values in channels.items()}
        parts.append(_interpolate(t[rows] - t[rows[0]], part, dt, cubic))
    if not parts:
        raise ValueError(
            f"No {_MIN_SAMPLES} samples follow one another with steps below "
            f"{max_gap * dt:.3g} s; dt = {dt:.3g} s does not suit these stamps."
        )
    return parts


def _interpolate(
    t: np.ndarray, channels: dict[str, np.ndarray], dt: float, cubic: Sequence[str]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Interpolate channels (n_samples, ...) of one part on multiples of dt."""
    if np.max(np.abs(t - dt * np.arange(len(t)))) < _UNIFORM_RTOL * dt:
        return dt * np.arange(len(t)), channels
    # The rounding of t must not cost the last point.
    grid = dt * np.arange(int(np.floor(t[-1] / dt + _UNIFORM_RTOL)) + 1)
    query = np.minimum(grid, t[-1])
    resampled = {}
    for key, values in channels.items():
        if key in cubic:
            resampled[key] = CubicSpline(t, values, axis=0)(query)
        else:
            rows = values.reshape(len(t), -1)
            columns = [np.interp(query, t, column) for column in rows.T]
            resampled[key] = np.stack(columns, axis=1).reshape(
                (len(grid), *values.shape[1:])
            )
    return grid, resampled


def median_period(logs: Iterable[Log]) -> float:
    """Median step between stamps over all logs [s], rounded to 0.1 us."""
    return round(float(np.median(np.concatenate([np.diff(x.t) for x in logs]))), 7)


def join(
    logs: Sequence[Log],
    *,
    dt: float,
    resample: bool = True,
    drop_repeated: bool = False,
) -> dict:
    """Concatenate logs into the array fields of a `Recording`.

    With `resample`, each log is put on multiples of `dt`; a log with long
    gaps becomes several recordings, "name [1]", "name [2]", ...
    """
    names, times, tables = [], [], []
    for log in logs:
        channels = {"q": log.q, "tau": log.tau, **log.signals}
        if log.v is not None:
            channels["v"] = log.v
        parts = [(log.t, channels)]
        if resample:
            parts = resample_uniform(
                log.t, channels, dt=dt, drop_repeated=drop_repeated
            )
        for number, (t, part) in enumerate(parts, start=1):
            names.append(log.name if len(parts) == 1 else f"{log.name} [{number}]")
            times.append(t)
            tables.append(part)
    columns = {key: np.concatenate([x[key] for x in tables]) for key in tables[0]}
    return {
        "q": columns.pop("q"),
        "tau": columns.pop("tau"),
        "v": columns.pop("v", None),
        "t": np.concatenate(times),
        "dt": dt,
        "groups": np.repeat(np.arange(len(times)), [len(t) for t in times]),
        "group_names": tuple(names),
        "signals": columns,
    }
