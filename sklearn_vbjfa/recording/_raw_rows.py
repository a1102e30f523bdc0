"""Faults of a log that only its rows as written show, before any resampling."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._layout import kind_of

# Rows of a second source are this share of all, ...
_LEAST_SHARE, _MOST_SHARE = 0.02, 0.9
# ... come in this many places and in runs no longer than this in the median.
_PLACES, _RUN = 10, 3
# Highest values of integers with a sign that were read without, and of the magnitude
# beside a bit that is the sign.
_WORDS = {8: "int8", 16: "int16", 32: "int32"}
_SIGN_BITS = (10, 11, 15)
# Values of either sign fill no more than this share of what a register holds.
_FILLED = 0.45


def without_second_source(table, layout, notes):
    """Leave out rows whose torques are all zero amid others while joints move."""
    columns = {
        kind: [
            table.columns[role.column]
            for name, role in layout.roles.items()
            if kind_of(name) == kind
        ]
        for kind in ("q", "tau")
    }
    if not all(columns.values()) or any(
        x.dtype.kind not in "iuf" for values in columns.values() for x in values
    ):
        return table
    empty = np.all([x == 0 for x in columns["tau"]], axis=0)
    share = empty.mean() if empty.size else 0.0
    if not _LEAST_SHARE < share < _MOST_SHARE:
        return table
    edges = np.flatnonzero(np.diff(np.r_[0, empty.astype(int), 0]))
    first, last = edges[::2], edges[1::2]
    inside = (first > 0) & (last < empty.size)
    if inside.sum() < _PLACES or np.median((last - first)[inside]) > _RUN:
        return table
    before, after = first[inside] - 1, last[inside]
    moves = np.any([x[after] != x[before] for x in columns["q"]], axis=0)
    if moves.mean() < 0.5:
        return table
    rows = np.flatnonzero(~empty)
    notes.append(
        f"{empty.sum()} row(s) ({100 * share:.0f} %) in which all torques are exactly "
        "zero while joints move are left out: a second source writes to the same log."
    )
    return replace(
        table,
        columns={name: values[rows] for name, values in table.columns.items()},
        where=lambda row: table.where(rows[row]),
    )


def refuse_codes(table, column, values):
    """Refuse integers whose sign was lost: two's complement, or a bit for the sign."""
    if not values.size or values.min() < 0 or (values != np.round(values)).any():
        return
    for bits, name in _WORDS.items():
        half, whole = 2.0 ** (bits - 1), 2.0**bits
        high = values[values >= half]
        low = values[values < half]
        if not (high.size and low.size and high.max() < whole):
            continue
        if max(low.max(), whole - high.min()) < 2 * _FILLED * half and _crosses(
            values, whole, half
        ):
            raise ValueError(
                f"{table.path}: the values of column {column!r} lie from 0 to "
                f"{low.max():.0f} and from {high.min():.0f} to {high.max():.0f}: "
                f"integers of {bits} bits whose sign was lost. Subtract {whole:.0f} "
                f'from those above {half - 1:.0f} (NumPy: x.astype("{name}")).'
            )
    for bit in _SIGN_BITS:
        sign = 2.0**bit
        high, low = values[values >= sign], values[values < sign]
        if not (high.size and low.size and high.max() < 2 * sign):
            continue
        if max(low.max(), high.max() - sign) < _FILLED * sign and low.max() > 0:
            raise ValueError(
                f"{table.path}: the values of column {column!r} lie from 0 to "
                f"{low.max():.0f} and from {high.min():.0f} to {high.max():.0f}: bit "
                f"{bit} is their sign. Replace those from {sign:.0f} on by "
                f"{sign:.0f} - x."
            )


def _crosses(values, whole, half):
    """Whether values step from near zero to near the end of the register."""
    step = np.abs(np.diff(values))
    return bool((step > half).any()) and values.max() > whole - half
