"""Columns of data frames, by the names of joints instead of by their places."""

import itertools
import re

from sklearn_vbjfa.recording._signals import OfferedSignals

_NUMBERED = re.compile(r"([a-z]+?)_?(\d+)")
# Prefixes of the quantities of a state, in order.
_STATES = (("q", ""), ("v",), ("a",))
_TORQUE = ("tau",)
# Columns that say when and in which recording, and where they are to be given.
_TIME, _LABEL = "is time: give it as t", "labels recordings: give it as groups"
_NOT_HERE = {"t": _TIME, "time": _TIME, "segment": _LABEL, "group": _LABEL}
_NOT_HERE |= {"groups": _LABEL}


def positions_in_order(X, names):
    """Put a data frame of positions or states into the model's order of joints."""
    # Columns are ``q_<joint>``, ``<joint>``, or ``q1, q2, ...`` (from 0 if there is a
    # ``q0``); of states also ``v_<joint>`` and ``a_<joint>``, or ``v1``, ``a1``. What
    # has no names comes back as it is. Where all positions are there by name, other
    # columns are `columns_beside` them; otherwise a name that is none of these is
    # refused.
    wanted, _ = _divided(X, names)
    if wanted:
        return X[wanted]
    return _in_order(X, names, "X", _STATES)


def columns_beside(X, names):
    """Return what a data frame X holds beside the positions, `OfferedSignals`."""
    # Time, labels of recordings and other channels of joints are no signals; they are
    # among those left out. Empty for what has no names.
    _, rest = _divided(X, names)
    if not rest:
        return OfferedSignals()
    known = {column for found in _channels(list(X.columns), names) for column in found}
    others = {
        column: _NOT_HERE.get(column.lower(), "belongs to a joint")
        for column in X.columns
        if column not in rest and column not in known
    }
    return OfferedSignals(
        columns={name: X[name].to_numpy() for name in rest}, left_out=others
    )


def torques_in_order(y, names):
    """Put a data frame of torques into the model's order of joints."""
    # Columns are ``tau_<joint>``, ``<joint>``, or ``tau1, tau2, ...`` (from 0 if there
    # is a ``tau0``).
    return _in_order(y, names, "y", (("tau", ""),))


def _divided(X, names):
    """Columns of positions or states in order, and columns beside them, two lists."""
    # Both are empty where there is nothing beside them, or positions are not complete.
    columns = getattr(X, "columns", None)
    if columns is None or not all(isinstance(column, str) for column in columns):
        return [], []
    columns = list(columns)
    found = _channels(columns, names)
    channels = [column for quantity in found for column in quantity]
    for prefixes in (*_STATES[1:], _TORQUE):
        channels += _by_joint(columns, names, prefixes)
        channels += _by_number(columns, len(names), prefixes)
    rest = [c for c in columns if c not in channels and c.lower() not in _NOT_HERE]
    if not found[0] or not rest:
        return [], []
    return list(itertools.chain(*found)), rest


def _channels(columns, names):
    """Columns of positions or of states, a list for each quantity; empty for none."""
    found = [
        _by_joint(columns, names, prefixes) or _by_number(columns, len(names), prefixes)
        for prefixes in _STATES
    ]
    return found if all(found) else found[:1]


def _in_order(frame, names, what, kinds):
    """Order columns; `kinds` are the prefixes of each quantity in turn."""
    columns = getattr(frame, "columns", None)
    if columns is None:
        return frame
    columns = list(columns)
    count, rest = divmod(len(columns), len(names))
    # A wrong number of columns is refused elsewhere, as for arrays; as in scikit-learn
    # only text is a name.
    if rest or count not in {1, len(kinds)}:
        return frame
    if not all(isinstance(column, str) for column in columns):
        return frame
    wanted = []
    for prefixes in kinds[:count]:
        found = _by_joint(columns, names, prefixes) or _by_number(
            columns, len(names), prefixes
        )
        if not found:
            expected = [f"{kind[0]}_{name}" for kind in kinds[:count] for name in names]
            strange = [c for c in columns if not _known(c, names, kinds)]
            raise ValueError(
                f"{what} has columns {', '.join(columns)}"
                + (f", of which {', '.join(strange)} name no joint" if strange else "")
                + f" of the robot; expected {', '.join(expected)} in any order (or the "
                "joints' names alone). Rename the columns, or give an array "
                f"({what}.to_numpy()) in the robot's order."
            )
        wanted += found
    return frame if wanted == columns else frame[wanted]


def _by_joint(columns, names, prefixes):
    """Columns of one quantity by joints, empty if some is missing."""
    for prefix in prefixes:
        found = [f"{prefix}_{name}" if prefix else name for name in names]
        if set(found) <= set(columns):
            return found
    return []


def _by_number(columns, nv, prefixes):
    """Columns of one quantity by their numbers, empty if some is missing."""
    numbers = {}
    for column in columns:
        match = _NUMBERED.fullmatch(column)
        if match and match[1] == prefixes[0]:
            numbers[int(match[2])] = column
    first = 0 if 0 in numbers else 1
    if sorted(numbers) != list(range(first, first + nv)):
        return []
    return [numbers[k] for k in sorted(numbers)]


def _known(column, names, kinds):
    return any(
        column in _by_joint([column], [name], prefixes)
        for prefixes in kinds
        for name in names
    )
