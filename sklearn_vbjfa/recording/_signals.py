"""Signals recorded with the motion, and data frames with joint names as columns."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa.recording._drives import COMMANDS, OF_MOTORS
from sklearn_vbjfa.recording._table import quoted

# Squared correlation from which a column duplicates a channel (the rest is noise), and
# from which one that was not requested is excluded, such as a reference or a current.
_COPY, _RELATED = 0.95, 0.8
# Maximum number of columns named in a message.
_MAX_NAMES = 5
# Share of a clock's variance that is not linear in time: jitter and rounding.
_JITTER = 1e-6
# Relative rounding error of equal values.
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
    """Sort findings by severity, worst first; return a tuple."""
    return tuple(sorted(findings, key=lambda f: SEVERITIES.index(f.severity)))


def listed_joints(names, joints):
    """List joints by name, or as "all joints"."""
    if len(joints) == len(names) > 1:
        return "all joints"
    return ", ".join(names[j] for j in joints)


class OfferedSignals(dict):
    """Further columns of a recording by name, which were not requested as signals."""

    @classmethod
    def from_recording(cls, recording):
        """Collect the columns of a file that are not channels of joints."""
        columns = cls()
        for name, values in recording.signals.items():
            if values.ndim == 1:
                columns[name] = values
            elif name not in ("a", *COMMANDS, *OF_MOTORS):
                columns |= {f"{name}{k + 1}": x for k, x in enumerate(values.T)}
        return columns


def as_numbers(values, n_samples):
    """Return a column as floats (n_samples,) and "", or None and its fault."""
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


def _validated(signals, n_samples):
    """Validate a mapping or data frame of signals; return a dict of float arrays."""
    # A data frame is not a Mapping but has items.
    signals = {} if signals is None else signals
    if not hasattr(signals, "items"):
        raise ValueError(
            "signals must be a mapping of names to columns of one value per row, or a "
            f"data frame; got {type(signals).__name__}."
        )
    numbers = {}
    for name, values in signals.items():
        if not isinstance(name, str) or not name:
            raise ValueError(f"signals must have names that are text; got {name!r}.")
        numbers[name], reason = as_numbers(values, n_samples)
        if reason:
            raise ValueError(f"signals: {name!r} {reason}.")
    return numbers


def _requested(effects, signals, offered, n_samples):
    """Return signals given or required by effects, required names, and offered ones."""
    if isinstance(signals, OfferedSignals):
        signals, offered = None, signals
    numbers = _validated(signals, n_samples)
    if twice := numbers.keys() & offered.keys():
        raise ValueError(
            f"signals has {min(twice)!r}, which is a column of X as well; give it once."
        )
    wanted = {x for effect in _signal_effects(effects) for x in effect.recorded}
    for name in sorted(wanted - numbers.keys()):
        if name not in offered:
            raise ValueError(
                f"The signal {name!r}, which an effect needs, is missing; give "
                f"signals={{{name!r}: ...}} with one value per row, or a column of "
                "that name in a data frame X."
            )
        numbers[name], reason = as_numbers(offered[name], n_samples)
        if reason:
            raise ValueError(f"The column {name!r} {reason}.")
    return numbers, wanted, offered


def _signal_effects(effects):
    """Return the effects that depend on recorded signals, see `OfSignals`."""
    return [effect for effect in effects if hasattr(effect, "recorded")]


def signals_for(effects, signals, offered, n_samples):
    """Return the signals that effects use by name, a dict of arrays (n_samples,)."""
    # signals: mapping or `OfferedSignals`; offered: `OfferedSignals` of the same rows.
    used, wanted, offered = _requested(effects, signals, offered, n_samples)
    if wanted or not _signal_effects(effects):
        return used if wanted else {}
    # Custom effects that do not declare their signals receive all of them.
    numbers = {name: as_numbers(x, n_samples)[0] for name, x in offered.items()}
    return used | {name: x for name, x in numbers.items() if x is not None}


def check_useful_signals(signals, recording):
    """Refuse explicitly given signals that carry no information of their own."""
    if isinstance(signals, OfferedSignals):
        return
    for name, values in _validated(signals, recording.n_samples).items():
        reason = fault(values, recording)
        if reason:
            raise ValueError(f"signals: {name!r} {reason}.")


def scan_signals(signals, offered, recording, effects):
    """Choose the signals of a recording that a search for effects may use."""
    # Returns a dict of arrays (n_samples,), and a `ChannelFinding` on excluded offered
    # signals. Unsuitable signals requested by the caller or an effect raise an error.
    n_samples = recording.n_samples
    used, wanted, offered = _requested(effects, signals, offered, n_samples)
    check_useful_signals(used, recording)
    reasons = {}
    for name in [name for name in offered if name not in used]:
        values, reason = as_numbers(offered[name], n_samples)
        reason = reason or fault(values, recording, _RELATED)
        if reason:
            reasons[name] = reason
        else:
            used[name] = values
    users = _signal_effects(effects)
    if users and all(effect.recorded for effect in users):
        # All effects declare their signals: the others are not needed.
        used = {name: used[name] for name in used if name in wanted}
    if not reasons:
        return used, ()
    shown, n_more = [*reasons][:_MAX_NAMES], len(reasons) - _MAX_NAMES
    names = ", ".join(map(repr, shown)) + f" and {n_more} more" * (n_more > 0)
    details = "; ".join(f"{name!r} {reasons[name]}" for name in shown)
    message = f"Column(s) {names} are not used as signals: {details}."
    return used, (ChannelFinding("unusable_signal", (), "note", message),)


def fault(values, recording, share=_COPY):
    """Return why a column (n_samples,) is unsuitable as a signal, "" if suitable."""
    # recording: motion and torques of the same rows; share: squared correlation with a
    # channel from which the column is unsuitable.
    if np.ptp(values) <= _ROUNDING * np.abs(values).max():
        return f"is constant ({values[0]:.6g} in all rows), so that nothing varies"
    t = np.arange(values.size) if recording.t is None else recording.t
    if all(_r_squared(values[x], t[x]) > 1 - _JITTER for x in recording.segments):
        return "is a clock: use t, and the effects of time"
    shared, channel = max(_shared_variances(values, recording), default=(0.0, ""))
    if shared < share:
        return ""
    amount = f"{100 * shared:.3g} % of its variance"
    if shared >= _COPY:
        return f"is the {channel} under another name: {amount}, times a factor"
    return (
        f"follows the {channel}, which has {amount}, as a reference or a current does; "
        "ask for it by name if it is neither"
    )


def _shared_variances(values, recording):
    """Yield the squared correlation of a column with each channel, and its name."""
    q, parts = recording.q, recording.segments
    channels = [("position", q, 0), ("torque", recording.tau, 0)]
    if recording.states is None:
        # Integrate the column rather than differentiate noisy positions.
        channels += [("velocity", q, 1), ("acceleration", q, 2)]
    else:
        v, a = np.split(recording.states, 3, axis=1)[1:]
        channels += [("velocity", v, 0), ("acceleration", a, 0)]
    for what, channel, order in channels:
        column = values
        if order:
            column = np.concatenate([_integral(values[p], order) for p in parts])
            channel = np.vstack([_detrended(channel[p], order) for p in parts])
        for name, other in zip(recording.joint_names, channel.T):
            yield _r_squared(column, other), f"{what} of {name}"


def _integral(x, order):
    """Integrate a column of one recording `order` times, without polynomial trend."""
    # For a constant column, only rounding errors remain, which are set to zero.
    tolerance = _ROUNDING * np.abs(x).max() * float(x.size) ** order
    for _ in range(order):
        x = np.cumsum(x - x.mean())
    residual = _detrended(x, order)
    return np.where(np.abs(residual) > tolerance, residual, 0.0)


def _detrended(x, degree):
    """Subtract a polynomial of time, such as integration constants, from columns."""
    time, degree = np.linspace(-1.0, 1.0, len(x)), min(degree, len(x) - 1)
    trend = np.polynomial.legendre.legfit(time, x, degree)
    return x - np.polynomial.legendre.legval(time, trend).T


def _r_squared(x, y):
    """Return the squared correlation of two columns, zero if one is constant."""
    x, y = x - x.mean(), y - y.mean()
    power = (x @ x) * (y @ y)
    return float((x @ y) ** 2 / power) if power > 0 else 0.0


_NUMBERED = re.compile(r"([a-z]+?)_?(\d+)")
# Columns of time and recording labels, which are separate arguments of `fit`.
_NON_SIGNALS = ("t", "time", "segment", "group", "groups")


def positions_and_signals(X, names):
    """Return positions or states in the model's joint order, and other columns."""
    # Columns of a data frame are ``q_<joint>``, ``<joint>``, or ``q1, ...`` (or from
    # ``q0``); of states also ``v_<joint>`` and ``a_<joint>``, or ``v1``, ``a1``.
    columns, by_kind = _columns_by_kind(X, names, "q")
    if "q" not in by_kind:
        return _refuse_foreign(X, names, "X", "qva"), OfferedSignals()
    kinds = "qva" if {"v", "a"} <= by_kind.keys() else "q"
    channels = {column for group in by_kind.values() for column in group}
    others = [x for x in columns if x not in channels and x.lower() not in _NON_SIGNALS]
    signals = OfferedSignals({name: X[name].to_numpy() for name in others})
    return X[[column for kind in kinds for column in by_kind[kind]]], signals


def carries_joint_names(X, names):
    """Return whether columns of a data frame contain joint names."""
    return any(x in _column_names(X) for name in names for x in (name, f"q_{name}"))


def torques_in_order(y, names):
    """Return a data frame of torques in the model's joint order."""
    # Columns are ``tau_<joint>``, ``<joint>``, or ``tau1, ...`` (or from ``tau0``).
    columns, by_kind = _columns_by_kind(y, names, "tau")
    if "tau" in by_kind and len(columns) == len(names):
        return y[by_kind["tau"]]
    return _refuse_foreign(y, names, "y", ("tau",))


def _column_names(frame):
    """Return the column names of a data frame, [] unless all are strings."""
    columns = list(getattr(frame, "columns", ()))
    return columns if all(isinstance(column, str) for column in columns) else []


def _columns_by_kind(frame, names, bare):
    """Return all column names, and the columns of each complete kind in joint order."""
    # bare: the kind of columns that are named by joints alone.
    columns, by_kind = _column_names(frame), {}
    numbered = [(_NUMBERED.fullmatch(column), column) for column in columns]
    for kind in ("q", "v", "a", "tau"):
        alternatives = [[f"{kind}_{name}" for name in names]]
        if kind == bare:
            alternatives.append(list(names))
        numbers = {int(x[2]): column for x, column in numbered if x and x[1] == kind}
        first = 0 if 0 in numbers else 1
        if sorted(numbers) == list(range(first, first + len(names))):
            alternatives.append([numbers[k] for k in sorted(numbers)])
        complete = [x for x in alternatives if set(x) <= set(columns)]
        by_kind |= {kind: complete[0]} if complete else {}
    return columns, by_kind


def _refuse_foreign(frame, names, what, kinds):
    """Refuse unknown names if the number of columns fits; it is checked elsewhere."""
    columns = _column_names(frame)
    count, remainder = divmod(len(columns), len(names))
    if remainder or count not in {1, len(kinds)}:
        return frame
    expected = [f"{kind}_{name}" for kind in kinds[:count] for name in names]
    raise ValueError(
        f"{what} has columns {', '.join(columns)}; expected {', '.join(expected)}, or "
        f"the joints' names alone; or an array ({what}.to_numpy()) in their order."
    )
