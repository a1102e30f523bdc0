"""Columns of a file, cut at segments and gaps and put on a uniform time grid."""

import numpy as np

from sklearn_vbjfa.recording._stamps import (
    GAP_PERIODS,
    inspect_time_stamps,
    interpolate,
    merge_doubled,
    prediction_errors,
)
from sklearn_vbjfa.recording._table import Table

# Fewer samples than this between two gaps cannot be differentiated.
_MIN_SAMPLES = 10
# Relative difference between the periods of segments that is refused, and below which
# they count as one.
_DT_TOLERANCE, _SAME_DT = 0.05, 1e-3
# The lower quartile of the size of a normal variable, in standard deviations.
_QUARTILE = 0.3186


def on_grid(table: Table, t, labels, dt, channels, notes):
    """Cut at segments and gaps, put on a uniform grid.

    Parameters
    ----------
    table : Table
        File, for messages.
    t : ndarray of shape (n_rows,) or None
        Stamps [s].
    labels : ndarray of shape (n_rows,) or None
        Labels of segments.
    dt : float or None
        Sample period [s], if it is known.
    channels : dict of str to ndarray of shape (n_rows, ...)
        Values, those of "q" and "tau" among them.
    notes : list of str
        What was found is added to it.

    Returns
    -------
    dict
        The array fields of a `Recording`.
    """
    segments = _segments(labels, table.n_rows)
    if t is None:
        parts = [
            (name, dt * np.arange(rows.size), {k: x[rows] for k, x in channels.items()})
            for name, rows in segments
        ]
        return _join(parts, dt)
    segments = _without_doubles(t, segments, channels, notes)
    stamps = _inspected(table, t, segments, dt, channels["q"])
    if dt is None:
        dt = _common_period(table, stamps)
    _describe(table, stamps, segments, dt, notes)
    parts, short, single, merged, noise = [], 0, 0, 0, []
    for (name, rows), checked in zip(segments, stamps):
        pieces = np.split(np.arange(rows.size), checked.gaps + 1)
        long = [x for x in pieces if x.size >= min(_MIN_SAMPLES, rows.size)]
        short += len(pieces) - len(long)
        for number, piece in enumerate(long, start=1):
            values = {k: x[rows[piece]] for k, x in channels.items()}
            label = name if len(long) == 1 else f"{name} [{number}]"
            if checked.sampled:
                before = piece.size
                at, values = merge_doubled(t[rows[piece]], values)
                at = at - at[0]
                merged += before - at.size
            else:
                slots = checked.slots[piece]
                # What late stamps make of the period is no other period.
                unsure = 3 * checked.jitter / rows.size
                same = abs(checked.dt - dt) < max(_SAME_DT * dt, unsure)
                own = dt if same else checked.dt
                at = own * (slots - slots[0])
                single += int(slots[-1] - slots[0]) + 1 - piece.size
            if at.size == round(at[-1] / dt) + 1 and not checked.sampled and own == dt:
                grid = dt * np.arange(at.size)
            else:
                noise.append((at, values["tau"]))
                grid, values = interpolate(at, values, dt)
            parts.append((label, grid, values))
    _count(notes, short, single, merged)
    if not parts:
        raise ValueError(
            f"{table.path}: no {_MIN_SAMPLES} samples follow one another without a gap "
            f"of more than {GAP_PERIODS:g} periods of {dt:.4g} s; check column t."
        )
    fields = _join(parts, dt)
    if noise:
        fields["torque_noise"] = _white_noise(noise)
    return fields


def _without_doubles(t, segments, channels, notes):
    """Leave out rows that repeat the one before in every channel and in time."""
    again = np.diff(t) == 0
    for values in channels.values():
        if again.any():
            rows = values.reshape(t.size, -1)
            again &= (rows[1:] == rows[:-1]).all(axis=1)
    again = np.r_[False, again]
    kept, count = [], 0
    for name, rows in segments:
        own = again[rows]
        own[0] = False
        count += int(own.sum())
        kept.append((name, rows[~own]))
    if count:
        notes.append(f"{count} row(s) are there twice and were left out once.")
    return kept


def _inspected(table, t, segments, dt, positions):
    """Return what the stamps of each segment tell."""
    stamps = []
    for _, rows in segments:
        if rows.size < 2:
            raise ValueError(
                f"{table.path}: the segment at {table.where(rows[0])} has one row "
                "only; give it another label, or remove it."
            )
        try:
            stamps.append(
                inspect_time_stamps(
                    t[rows],
                    dt,
                    lambda k, rows=rows: table.where(rows[k]),
                    positions[rows],
                )
            )
        except ValueError as error:
            raise ValueError(f"{table.path}: {error}") from None
    return stamps


def _common_period(table, stamps):
    """Return the period of all segments [s]."""
    periods = [x.dt for x in stamps]
    dt = float(np.median(periods))
    if max(periods) - min(periods) > 2 * _DT_TOLERANCE * dt:
        raise ValueError(
            f"{table.path}: segments have periods of {min(periods):.6g} to "
            f"{max(periods):.6g} s; put those of one period into one file."
        )
    return dt


def _describe(table, stamps, segments, dt, notes):
    """Say in words what is irregular."""
    for what, said in (
        (
            [x for x in stamps if x.sampled],
            "the positions say that the robot was sampled at these times; all is "
            "interpolated on a uniform grid",
        ),
        (
            [x for x in stamps if x.late],
            "the positions do not follow them, so that only the stamps are irregular "
            "and not the sampling; rows are taken as equidistant",
        ),
    ):
        if what:
            jitter = max(x.jitter for x in what)
            shortest = min(x.shortest for x in what)
            longest = max(x.longest for x in what)
            notes.append(
                f"time stamps are irregular (steps of {shortest:.4g} to {longest:.4g} "
                f"s, standard deviation {100 * jitter / dt:.2g} % of the period of "
                f"{dt:.4g} s): {said}."
            )
    count = sum(x.doubled for x in stamps if not x.sampled)
    if count:
        notes.append(
            f"{count} stamp(s) repeat the one before; the rows are taken as "
            "equidistant."
        )
    count = sum(x.gaps.size for x in stamps)
    if count:
        k = next(k for k, x in enumerate(stamps) if x.gaps.size)
        row = segments[k][1][stamps[k].gaps[0]]
        notes.append(
            f"{count} gap(s) of more than {GAP_PERIODS:g} periods in time, the first "
            f"after {table.where(row)}: the recording is split there."
        )


def _count(notes, short, single, merged):
    """Say what was left out, put in or joined."""
    if short:
        notes.append(
            f"{short} piece(s) of fewer than {_MIN_SAMPLES} samples between gaps are "
            "left out."
        )
    if single:
        notes.append(f"{single} single sample(s) are missing and were interpolated.")
    if merged:
        notes.append(f"{merged} row(s) repeat a stamp and were averaged with it.")


def _white_noise(pieces):
    """Return the standard deviation of white noise (nv,) of what is not on a grid.

    The lower quartile passes over what jumps, as friction does.
    """
    errors = np.abs(np.concatenate([prediction_errors(*piece) for piece in pieces]))
    if not errors.size:
        return None
    return np.quantile(errors, 0.25, axis=0) / _QUARTILE


def _segments(labels, n_rows):
    """Return (name, rows) of each run of equal labels, names made unique."""
    if labels is None:
        return [("recording", np.arange(n_rows))]
    borders = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    runs, seen = [], {}
    for rows in np.split(np.arange(n_rows), borders):
        label = labels[rows[0]]
        is_whole = labels.dtype.kind == "f" and float(label).is_integer()
        text = str(int(label) if is_whole else label)
        seen[text] = seen.get(text, 0) + 1
        runs.append((text if seen[text] == 1 else f"{text} ({seen[text]})", rows))
    return runs


def _join(parts, dt):
    """Concatenate (name, t, channels) into the array fields of a Recording."""
    tables = [channels for _, _, channels in parts]
    columns = {key: np.concatenate([x[key] for x in tables]) for key in tables[0]}
    return {
        "q": columns.pop("q"),
        "tau": columns.pop("tau"),
        "v": columns.pop("v", None),
        "t": np.concatenate([t for _, t, _ in parts]),
        "dt": dt,
        "groups": np.repeat(np.arange(len(parts)), [len(t) for _, t, _ in parts]),
        "group_names": tuple(name for name, _, _ in parts),
        "signals": columns,
    }
