"""Rows of a table that are no samples: blank ones, and those of a second source."""

from dataclasses import replace

import numpy as np

# Rows that lack a number are left out up to this share of all.
_LACKING = 0.1
# Rows of a second source are this share of all, ...
_LEAST_SHARE, _MOST_SHARE = 0.02, 0.9
# ... come in this many places and in runs no longer than this in the median.
_PLACES, _RUN = 10, 3


def without_odd_rows(table, layout, options, notes):
    """Leave out rows without numbers and of a second source.

    Returns the table, and the places of its rows if those between them are samples that
    are missing.
    """
    n, q, tau = table.n_rows, layout.of("q"), layout.of("tau")
    if options.drive is not None:
        table, tau = _with_commands_held(table, layout, options, notes), ()
    roles = [*q, *tau, *layout.of("v"), *layout.of("a")]
    values = _matrix(table, [*q, *tau])
    keep = ~np.isnan(values).all(axis=1)
    if not keep.any():
        return table, None
    if not keep.all():
        notes.append(
            f"{(~keep).sum()} row(s) without any position or torque are left out."
        )
    holes = np.isnan(np.column_stack([values, _matrix(table, roles[len(q + tau) :])]))
    lacking = holes.any(axis=1) & keep
    if 0 < lacking.sum() <= _LACKING * keep.sum():
        row = int(np.argmax(lacking))
        column = roles[int(np.argmax(holes[row]))].column
        notes.append(
            f"{lacking.sum()} row(s) lack a number, the first in {table.where(row)}, "
            f"column {column!r}: left out."
        )
        keep &= ~lacking
    second = _second_source(values[:, : len(q)], values[:, len(q) :], keep)
    if second.any():
        notes.append(
            f"{second.sum()} row(s) ({100 * second.sum() / keep.sum():.0f} %) in which "
            "all torques are exactly zero while joints move are left out: a second "
            "source writes to the same log."
        )
        keep &= ~second
    if keep.all():
        return table, None
    rows = np.flatnonzero(keep)
    # Rows of other topics, and of a second source, are no samples that are missing.
    lost = table.n_rows == n and not second.any() and rows.size >= (1 - _LACKING) * n
    return table.take(rows), rows if lost else None


def _matrix(table, roles):
    """Return columns as a matrix, without numbers (n_rows, 0)."""
    values = [table.values(role.column) for role in roles]
    if not values or any(x.dtype.kind not in "iuf" for x in values):
        return np.zeros((table.n_rows, 0))
    return np.column_stack(values).astype(float)


def _with_commands_held(table, layout, options, notes):
    """Hold commands that have separate rows until the next one comes."""
    kinds = [kind for kind in options.recorded if kind != "tau"]
    known = table.frame[[role.column for role in layout.of(*kinds)]]
    known = known.select_dtypes("number").dropna(axis=1, how="all")
    known = known.loc[:, known.isna().any()]
    if known.empty:
        return table
    rows = int(known.notna().sum().max())
    begin = int(known.notna().to_numpy().argmax(axis=0).max())
    notes.append(
        f"commands stand in {rows} of {table.n_rows} rows: each holds until the next "
        f"one comes{f'; {begin} row(s) before the first are left out' * (begin > 0)}."
    )
    return replace(table, frame=table.frame.assign(**known.ffill()).iloc[begin:])


def _second_source(q, tau, keep):
    """Return rows whose torques are all zero amid others while joints move."""
    empty = (tau == 0).all(axis=1)[keep]
    none = np.zeros(keep.size, dtype=bool)
    if not tau.size or not _LEAST_SHARE < empty.mean() < _MOST_SHARE:
        return none
    edges = np.flatnonzero(np.diff(np.r_[0, empty.astype(int), 0]))
    first, last = edges[::2], edges[1::2]
    inside = (first > 0) & (last < empty.size)
    if inside.sum() < _PLACES or np.median((last - first)[inside]) > _RUN:
        return none
    q = q[keep]
    moves = (q[last[inside]] != q[first[inside] - 1]).any(axis=1)
    if moves.mean() >= 0.5:
        none[keep] = empty
    return none
