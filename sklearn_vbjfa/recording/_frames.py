"""Data frames that a caller gives, by the names of joints instead of their places."""

import re

from sklearn_vbjfa.recording._signals import OfferedSignals

_NUMBERED = re.compile(r"([a-z]+?)_?(\d+)")
# Columns that say when and in which recording, and where they are to be given.
_NOT_HERE = dict.fromkeys(("t", "time"), "is time: give it as t")
_NOT_HERE |= dict.fromkeys(
    ("segment", "group", "groups"), "labels recordings: give it as groups"
)


def positions_in_order(X, names):
    """Put a data frame of positions or states into the model's order of joints."""
    # Columns are ``q_<joint>``, ``<joint>``, or ``q1, q2, ...`` (from 0 if there is a
    # ``q0``); of states also ``v_<joint>`` and ``a_<joint>``, or ``v1``, ``a1``. What
    # has no names comes back as it is; other columns are `columns_beside` them.
    found = _by_kind(_columns_of(X), names, "q")
    return X[_states(found)] if "q" in found else _foreign(X, names, "X", "qva")


def carries_names(X, names):
    """Return whether columns of a data frame carry the names of joints."""
    found = set(map(str, _columns_of(X)))
    return any(name in found or f"q_{name}" in found for name in names)


def columns_beside(X, names):
    """Return the other columns of a data frame X, `OfferedSignals`."""
    # Time, labels of recordings and other channels of joints are no signals; they are
    # among those left out. Empty for what has no names.
    columns = _columns_of(X)
    found = _by_kind(columns, names, "q")
    channels = {column for group in found.values() for column in group}
    rest = [x for x in columns if x not in channels and x.lower() not in _NOT_HERE]
    if "q" not in found or not rest:
        return OfferedSignals()
    others = {
        column: _NOT_HERE.get(column.lower(), "belongs to a joint")
        for column in columns
        if column not in rest and column not in _states(found)
    }
    return OfferedSignals(
        columns={name: X[name].to_numpy() for name in rest}, left_out=others
    )


def torques_in_order(y, names):
    """Put a data frame of torques into the model's order of joints."""
    # Columns are ``tau_<joint>``, ``<joint>``, or ``tau1, tau2, ...`` (from 0 if there
    # is a ``tau0``).
    columns = _columns_of(y)
    found = _by_kind(columns, names, "tau")
    if "tau" in found and len(columns) == len(names):
        return y[found["tau"]]
    return _foreign(y, names, "y", ("tau",))


def _columns_of(frame):
    """Names of the columns of a data frame; as in scikit-learn only text is one."""
    columns = list(getattr(frame, "columns", ()))
    return columns if all(isinstance(column, str) for column in columns) else []


def _by_kind(columns, names, bare):
    """Return the columns of each kind in order, as far as all joints have one."""
    # bare: the kind of columns that have the names of joints alone.
    found = {}
    numbered = [(_NUMBERED.fullmatch(column), column) for column in columns]
    for kind in ("q", "v", "a", "tau"):
        spelled = [[f"{kind}_{name}" for name in names]]
        if kind == bare:
            spelled.append(list(names))
        numbers = {int(x[2]): column for x, column in numbered if x and x[1] == kind}
        first = 0 if 0 in numbers else 1
        if sorted(numbers) == list(range(first, first + len(names))):
            spelled.append([numbers[k] for k in sorted(numbers)])
        complete = [x for x in spelled if set(x) <= set(columns)]
        found |= {kind: complete[0]} if complete else {}
    return found


def _states(found):
    """Return the columns of states if all are there, else those of positions."""
    kinds = ("q", "v", "a") if {"v", "a"} <= found.keys() else ("q",)
    return [column for kind in kinds for column in found[kind]]


def _foreign(frame, names, what, kinds):
    """Refuse columns of which not all are joints'; the number is checked elsewhere."""
    columns = _columns_of(frame)
    count, rest = divmod(len(columns), len(names))
    if rest or count not in {1, len(kinds)}:
        return frame
    expected = [f"{kind}_{name}" for kind in kinds[:count] for name in names]
    strange = [x for x in columns if x not in (*expected, *names)]
    raise ValueError(
        f"{what} has columns {', '.join(columns)}"
        + (f", of which {', '.join(strange)} name no joint" if strange else "")
        + f" of the robot; expected {', '.join(expected)} in any order (or the joints' "
        "names alone). Rename the columns, or give an array "
        f"({what}.to_numpy()) in the robot's order."
    )
