"""Rows of a log as they are: blank, of a second source, with coded values."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import Table

# Rows of a second source are this share of all, ...
_LEAST_SHARE, _MOST_SHARE = 0.02, 0.9
# ... come in this many places and in runs no longer than this in the median.
_PLACES, _RUN = 10, 3
# Bits of integers whose sign was lost, and bits that are the sign.
_REGISTERS, _SIGN_BITS = (8, 16, 32), (10, 11, 15)
# Values of either sign fill no more than this share of a register.
_FILLED = 0.45


def _matrix(table, roles):
    """Return columns as a matrix of numbers, None if there are none."""
    values = [table.values(role.column) for role in roles]
    if not values or any(x.dtype.kind not in "iuf" for x in values):
        return None
    return np.column_stack(values).astype(float)


def without_blank_rows(table: Table, used, notes) -> Table:
    """Leave out rows without any number in the columns used: of other topics."""
    values = _matrix(table, used)
    blank = np.zeros(1, bool) if values is None else np.isnan(values).all(axis=1)
    if not blank.any() or blank.all():
        return table
    notes.append(f"{blank.sum()} row(s) without any position or torque are left out.")
    return table.take(np.flatnonzero(~blank))


def with_commands_held(table: Table, commands, notes) -> Table:
    """Hold commands that have separate rows until the next one comes."""
    known = table.frame[[role.column for role in commands]]
    known = known.select_dtypes("number").dropna(axis=1, how="all")
    known = known.loc[:, known.isna().any()]
    if known.empty:
        return table
    rows = int(known.notna().sum().max())
    begin = int(known.notna().to_numpy().argmax(axis=0).max())
    frame = table.frame.assign(**known.ffill())
    notes.append(
        f"commands stand in {rows} of {table.n_rows} rows: each holds until the next "
        f"one comes{f'; {begin} row(s) before the first are left out' * (begin > 0)}."
    )
    return replace(table, frame=frame.iloc[begin:])


def without_second_source(table: Table, positions, torques, notes) -> Table:
    """Leave out rows whose torques are all zero amid others while joints move."""
    q, tau = _matrix(table, positions), _matrix(table, torques)
    if q is None or tau is None:
        return table
    empty = (tau == 0).all(axis=1)
    if not _LEAST_SHARE < empty.mean() < _MOST_SHARE:
        return table
    edges = np.flatnonzero(np.diff(np.r_[0, empty.astype(int), 0]))
    first, last = edges[::2], edges[1::2]
    inside = (first > 0) & (last < empty.size)
    if inside.sum() < _PLACES or np.median((last - first)[inside]) > _RUN:
        return table
    moves = (q[last[inside]] != q[first[inside] - 1]).any(axis=1)
    if moves.mean() < 0.5:
        return table
    notes.append(
        f"{empty.sum()} row(s) ({100 * empty.mean():.0f} %) in which all torques are "
        "exactly zero while joints move are left out: a second source writes to the "
        "same log."
    )
    return table.take(np.flatnonzero(~empty))


def refuse_codes(table: Table, column, values):
    """Refuse integers whose sign was lost: two's complement, or a bit for the sign."""
    if not values.size or values.min() < 0 or (values != np.round(values)).any():
        return
    for bits in _REGISTERS:
        half, whole = 2.0 ** (bits - 1), 2.0**bits
        high, low = _parted(values, half, whole)
        step = np.abs(np.diff(values))
        if high.size and max(low.max(), whole - high.min()) < 2 * _FILLED * half:
            # Values step from near zero to near the end of the register.
            if (step > half).any():
                raise ValueError(
                    f"{_ranges(table, column, low, high)}: integers of {bits} bits "
                    f"whose sign was lost. Subtract {whole:.0f} from those above "
                    f'{half - 1:.0f} (NumPy: x.astype("int{bits}")).'
                )
    for bit in _SIGN_BITS:
        sign = 2.0**bit
        high, low = _parted(values, sign, 2 * sign)
        if (
            high.size
            and 0 < low.max()
            and max(low.max(), high.max() - sign) < (_FILLED * sign)
        ):
            raise ValueError(
                f"{_ranges(table, column, low, high)}: bit {bit} is their sign. "
                f"Replace those from {sign:.0f} on by {sign:.0f} - x."
            )


def _parted(values, half, whole):
    """Return values above and below the half of a range; none if they are no codes."""
    high, low = values[values >= half], values[values < half]
    known = high.size and low.size and high.max() < whole
    return (high, low) if known else (high[:0], low[:0])


def _ranges(table, column, low, high):
    return (
        f"{table.path}: the values of column {column!r} lie from 0 to {low.max():.0f} "
        f"and from {high.min():.0f} to {high.max():.0f}"
    )
