"""Signals: columns that come with the motion, and data frames by names of joints."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa.recording._drives import COMMANDS, OF_MOTORS
from sklearn_vbjfa.recording._table import quoted

# A column is another channel under a new name if this share of its variance is that
# channel's, but for a factor and an offset: the rest is noise and quantisation.
_COPY = 0.95
# One that nobody asked for is left out at this share already: references and currents
# follow the motion, with a lag and an error. (A slow signal has half of a
# slow position by chance, in a short recording.)
_FOLLOWS = 0.8
# Columns that a message names.
_NAMED = 5
# A clock is linear in time but for this share of its variance: jitter and rounding.
_CLOCK = 1e-6
# Differences of equal values by rounding, as a share of the value.
_ROUNDING = 1e-12


# From worst to least.
SEVERITIES = ("error", "warning", "note")


@dataclass(frozen=True)
class ChannelFinding:
    """A fault of some channels of a recording.

    Attributes
    ----------
    kind : str
        Name of the fault, such as "torque_sign"; see `inspect_channels`.
    joints : tuple of int
        Affected joints, counted from 0.
    severity : {"error", "warning", "note"}
        "error": a fit would be wrong and identify the fault. "warning": a fit may be
        wrong and supports no favourable verdict, but the evidence has another
        explanation or the harm is limited. "note": a fit would be needlessly
        inaccurate, or something cannot be verified.
    message : str
        One line: the channel by name, the evidence in numbers, the remedy.
    value : float, default=nan
        Size of the fault in SI units, where it has one: the lag [s] of a "delay".
    remedy : mapping
        Options of `read_recording` that undo the fault; empty for none.
    rivals : tuple of str
        Other kinds of faults that explain the log nearly as well.
    """

    kind: str
    joints: tuple[int, ...]
    severity: str
    message: str
    value: float = np.nan
    remedy: Mapping = field(default_factory=dict)
    rivals: tuple[str, ...] = ()


def findings_in_order(findings):
    """Return findings as a tuple, worst first."""
    return tuple(sorted(findings, key=lambda f: SEVERITIES.index(f.severity)))


def listed_joints(names, joints):
    """List joints by name, or as "all joints"."""
    if len(joints) == len(names) > 1:
        return "all joints"
    return ", ".join(names[j] for j in joints)


# -- which columns are signals ---------------------------------------------------------


class OfferedSignals(dict):
    """Columns that came with the motion, by name, as read, that nobody asked for."""

    @classmethod
    def from_recording(cls, recording):
        """Take the other columns of a file, one by one, without those of joints."""
        columns = cls()
        for name, values in recording.signals.items():
            if values.ndim == 1:
                columns[name] = values
            elif name not in ("a", *COMMANDS, *OF_MOTORS):
                columns |= {f"{name}{k + 1}": x for k, x in enumerate(values.T)}
        return columns


def as_numbers(values, n_samples):
    """Return a column as floats (n_samples,), and what is wrong with it."""
    # The first is None where the second is not empty.
    values = np.asarray(values)
    if values.shape != (n_samples,):
        return None, (
            f"has the shape {values.shape}; expected one value per row, ({n_samples},)"
        )
    try:
        numbers = None if values.dtype.kind in "MSU" else values.astype(float)
    except (TypeError, ValueError):
        numbers = None
    if numbers is None:
        return None, f"holds {quoted(str(values[0]))} and not numbers"
    gaps = np.flatnonzero(~np.isfinite(numbers))
    if gaps.size:
        return None, (
            f"has gaps: {gaps.size} of {n_samples} values are not finite, the first in "
            f"row {gaps[0]}; interpolate them"
        )
    return numbers, ""


def _given(signals, n_samples):
    """Return signals that were given by name as floats (n_samples,), a dict."""
    # A data frame is no mapping but has items.
    signals = {} if signals is None else signals
    if not hasattr(signals, "items"):
        raise ValueError(
            "signals must be a mapping of names to columns of one value per row, or a "
            f"data frame; got {type(signals).__name__}."
        )
    found = {}
    for name, values in signals.items():
        if not isinstance(name, str) or not name:
            raise ValueError(f"signals must have names that are text; got {name!r}.")
        found[name], reason = as_numbers(values, n_samples)
        if reason:
            raise ValueError(f"signals: {name!r} {reason}.")
    return found


def _asked_for(effects, given, offered, n_samples):
    """Signals given, or asked for by effects, by name; these names; what is offered."""
    if isinstance(given, OfferedSignals):
        given, offered = None, given
    found = _given(given, n_samples)
    if twice := found.keys() & offered.keys():
        raise ValueError(
            f"signals has {min(twice)!r}, which is a column of X as well; give it once."
        )
    wanted = {x for effect in _users(effects) for x in effect.recorded}
    for name in sorted(wanted - found.keys()):
        if name not in offered:
            raise ValueError(
                f"The signal {name!r}, which an effect needs, is missing; give "
                f"signals={{{name!r}: ...}} with one value per row, or a column of "
                "that name in a data frame X."
            )
        found[name], reason = as_numbers(offered[name], n_samples)
        if reason:
            raise ValueError(f"The column {name!r} {reason}.")
    return found, wanted, offered


def _users(effects):
    """Effects of recorded signals, see `OfSignals`."""
    return [effect for effect in effects if hasattr(effect, "recorded")]


def signals_for(effects, given, offered, n_samples):
    """Return the signals that effects use by name, a dict of arrays (n_samples,)."""
    # given: by name, or `OfferedSignals`; offered: `OfferedSignals` of the same rows.
    found, wanted, offered = _asked_for(effects, given, offered, n_samples)
    if wanted or not _users(effects):
        return found if wanted else {}
    # An effect of one's own, of which nobody knows what it uses, takes all.
    read = {name: as_numbers(x, n_samples)[0] for name, x in offered.items()}
    return found | {name: x for name, x in read.items() if x is not None}


def check_useful_signals(given, recording):
    """Refuse signals, given by name, that are not a condition of the robot."""
    if isinstance(given, OfferedSignals):
        return
    for name, values in _given(given, recording.n_samples).items():
        reason = fault(values, recording)
        if reason:
            raise ValueError(f"signals: {name!r} {reason}.")


def scan_signals(given, offered, recording, effects):
    """Choose the signals of a recording that a search for effects may use."""
    # Returns a dict of arrays (n_samples,), and a `ChannelFinding` on those `offered`
    # that are left out. Of those asked for by name, by the caller or by an effect, none
    # is: they are refused.
    n_samples = recording.n_samples
    found, wanted, offered = _asked_for(effects, given, offered, n_samples)
    check_useful_signals(found, recording)
    reasons = {}
    for name in [name for name in offered if name not in found]:
        values, reason = as_numbers(offered[name], n_samples)
        reason = reason or fault(values, recording, _FOLLOWS)
        if reason:
            reasons[name] = reason
        else:
            found[name] = values
    users = _users(effects)
    if users and all(effect.recorded for effect in users):
        # Each names the one that it is meant for.
        found = {name: found[name] for name in found if name in wanted}
    if not reasons:
        return found, ()
    shown, left = [*reasons][:_NAMED], len(reasons) - _NAMED
    names = ", ".join(map(repr, shown)) + f" and {left} more" * (left > 0)
    lines = "; ".join(f"{name!r} {reasons[name]}" for name in shown)
    message = f"Column(s) {names} are not used as signals: {lines}."
    return found, (ChannelFinding("unusable_signal", (), "note", message),)


# -- what is no condition of the robot -------------------------------------------------


def fault(values, recording, share=_COPY):
    """Say why a column (n_samples,) is not a condition of the robot, if it is none."""
    # recording: motion and torques of the same rows; share: of the variance of the
    # column, from which on it is another channel.
    if np.ptp(values) <= _ROUNDING * np.abs(values).max():
        return f"is constant ({values[0]:.6g} in all rows), so that nothing varies"
    t = np.arange(values.size) if recording.t is None else recording.t
    if all(_shared(values[x], t[x]) > 1 - _CLOCK for x in recording.segments):
        return "is a clock: use t, and the effects of time"
    explained, channel = max(_likeness(values, recording), default=(0.0, ""))
    if explained < share:
        return ""
    amount = f"{100 * explained:.3g} % of its variance"
    if explained >= _COPY:
        return f"is the {channel} under another name: {amount}, times a factor"
    return (
        f"follows the {channel}, which has {amount}, as a reference or a current does; "
        "ask for it by name if it is neither"
    )


def _likeness(values, recording):
    """Yield the share of a column's variance that each channel has, and its name."""
    q, parts = recording.q, recording.segments
    channels = [("position", q, 0), ("torque", recording.tau, 0)]
    if recording.states is None:
        # Integrals are smooth where derivatives of positions are not.
        channels += [("velocity", q, 1), ("acceleration", q, 2)]
    else:
        v, a = np.split(recording.states, 3, axis=1)[1:]
        channels += [("velocity", v, 0), ("acceleration", a, 0)]
    for what, channel, order in channels:
        column = values
        if order:
            column = np.concatenate([_integral(values[p], order) for p in parts])
            channel = np.vstack([_without_trend(channel[p], order) for p in parts])
        for name, other in zip(recording.joint_names, channel.T):
            yield _shared(column, other), f"{what} of {name}"


def _integral(x, order):
    """Integrate a column of one recording so often, without constants."""
    # What is constant in a recording leaves nothing but rounding.
    tiny = _ROUNDING * np.abs(x).max() * float(x.size) ** order
    for _ in range(order):
        x = np.cumsum(x - x.mean())
    left = _without_trend(x, order)
    return np.where(np.abs(left) > tiny, left, 0.0)


def _without_trend(x, degree):
    """Take a polynomial of time, as of constants of integration, off columns."""
    time, degree = np.linspace(-1.0, 1.0, len(x)), min(degree, len(x) - 1)
    trend = np.polynomial.legendre.legfit(time, x, degree)
    return x - np.polynomial.legendre.legval(time, trend).T


def _shared(x, y):
    """Squared correlation of two columns; zero where one is constant."""
    x, y = x - x.mean(), y - y.mean()
    power = (x @ x) * (y @ y)
    return float((x @ y) ** 2 / power) if power > 0 else 0.0


_NUMBERED = re.compile(r"([a-z]+?)_?(\d+)")
# Columns that say when and in which recording: arguments of their own.
_NOT_HERE = ("t", "time", "segment", "group", "groups")


def positions_and_signals(X, names):
    """Return positions or states in the model's order of joints, and other columns."""
    # Columns of a data frame are ``q_<joint>``, ``<joint>``, or ``q1, q2, ...`` (from 0
    # if there is a ``q0``); of states also ``v_<joint>`` and ``a_<joint>``, or ``v1``,
    # ``a1``. Time, labels of recordings and other channels of joints are no signals.
    columns, found = _by_kind(X, names, "q")
    if "q" not in found:
        return _foreign(X, names, "X", "qva"), OfferedSignals()
    kinds = "qva" if {"v", "a"} <= found.keys() else "q"
    channels = {column for group in found.values() for column in group}
    rest = [x for x in columns if x not in channels and x.lower() not in _NOT_HERE]
    signals = OfferedSignals({name: X[name].to_numpy() for name in rest})
    return X[[column for kind in kinds for column in found[kind]]], signals


def carries_joint_names(X, names):
    """Return whether columns of a data frame carry the names of joints."""
    return any(x in _columns_of(X) for name in names for x in (name, f"q_{name}"))


def torques_in_order(y, names):
    """Put a data frame of torques into the model's order of joints."""
    # Columns are ``tau_<joint>``, ``<joint>``, or ``tau1, tau2, ...`` (from 0 if there
    # is a ``tau0``).
    columns, found = _by_kind(y, names, "tau")
    if "tau" in found and len(columns) == len(names):
        return y[found["tau"]]
    return _foreign(y, names, "y", ("tau",))


def _columns_of(frame):
    """Names of the columns of a data frame; as in scikit-learn only text is one."""
    columns = list(getattr(frame, "columns", ()))
    return columns if all(isinstance(column, str) for column in columns) else []


def _by_kind(frame, names, bare):
    """Return all columns, and those of each kind in order if all joints have one."""
    # bare: the kind of columns that have the names of joints alone.
    columns, found = _columns_of(frame), {}
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
    return columns, found


def _foreign(frame, names, what, kinds):
    """Refuse columns of which not all are joints'; the number is checked elsewhere."""
    columns = _columns_of(frame)
    count, rest = divmod(len(columns), len(names))
    if rest or count not in {1, len(kinds)}:
        return frame
    expected = [f"{kind}_{name}" for kind in kinds[:count] for name in names]
    raise ValueError(
        f"{what} has columns {', '.join(columns)}; expected {', '.join(expected)} in "
        "any order (or the joints' names alone). Rename the columns, or give an array "
        f"({what}.to_numpy()) in the robot's order."
    )
