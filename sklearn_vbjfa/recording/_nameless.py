"""Tables without names of columns: what their columns are, as far as numbers tell.

Nothing is taken from that: a refusal says what was found and prints the mapping, for
the user to check. Columns are called by their places, from 1.
"""

import numpy as np

from sklearn_vbjfa.recording._layout import TURNS
from sklearn_vbjfa.recording._sampling import prediction_errors
from sklearn_vbjfa.recording._table import RecordingRefused, Table

# A clock is this near to a straight line, as a share of what it rises.
_STRAIGHT = 0.02
# A block is the derivative of another, or the same, if the squared correlation with its
# integral, or with it, is above this in the middle of the joints.
_DERIVATIVE, _SAME = 0.9, 0.98
# Rows that are looked at.
_ROWS = 20_000


def refusal(table: Table, asked, names):
    """Return the refusal of a table without names, with the mapping that it offers."""
    count = len(table.columns)
    said = f"{table.path}: has no names of columns, only {count} columns of numbers"
    if not names:
        return RecordingRefused(
            f"{said}; say by their places which they are, such as "
            'columns="t=1,q=2-7,tau=8-13", or give the description of the robot.'
        )
    n = len(names)
    clock, blocks = _blocks(table, n)
    if not blocks:
        return RecordingRefused(
            f"{said}, which are not time and a few times the {n} joint(s) of the robot"
            f"; say by their places which they are, such as columns="
            f'"t=1,q={_range(2, n)},tau={_range(2 + n, n)}"; joint_names says which '
            "joints were recorded (command line: --joints)."
        )
    found, evidence = _roles(table, clock, blocks)
    k = len(blocks)
    counted = f"{'time and ' if clock else ''}{k} times the {n} joint(s) of the robot"
    if "tau" not in found:
        return RecordingRefused(
            f"{said}, {counted}, of which none looks like torques ({evidence}); say "
            "by their places which they are, such as "
            f'columns="t=1,q={_range(2, n)},tau={_range(2 + n, n)}".'
        )
    mapping = {"t": clock} if clock else {}
    mapping |= {kind: _range(*block) for kind, block in found.items()}
    first, number = found["q"]
    places = [str(first + j) for j in range(number)]
    if max(np.abs(table.columns[x]).max() for x in places) > TURNS:
        mapping["q"] += " [deg]"
    columns = ",".join(f"{kind}={place}" for kind, place in mapping.items())
    options = {"columns": columns}
    if clock:
        unit = unit_of_clock(table.columns[clock])
        options |= {"time_unit": unit} if unit not in ("", "s") else {}
    elif not asked.timed:
        evidence += (
            f'; no column rises like time: give columns="{columns}" and the sample '
            "period dt in seconds"
        )
        options = {}
    return RecordingRefused(
        f"{said}: {counted}, and by their numbers {evidence}; check that before you "
        "use it.",
        options,
    )


def clock_of(table: Table):
    """Return the column that rises like time, None for none."""
    found = [x for x, values in table.columns.items() if is_clock(values)]
    # What goes up by one counts rows.
    found.sort(key=lambda x: np.median(np.diff(table.columns[x])) == 1.0)
    return found[0] if found else None


def unit_of_clock(values):
    """Return the unit in which the steps of a clock are those of a robot."""
    from sklearn_vbjfa.recording._channels import unit_of_steps, usual_step

    return unit_of_steps(usual_step(values))


def is_clock(values):
    """Whether a column rises steadily, at steps that are those of a robot."""
    if values.dtype.kind not in "iuf" or values.size < 3:
        return False
    step = np.diff(values.astype(float))
    if not ((step >= 0).all() and step.sum() > 0) or not unit_of_clock(values):
        return False
    line = np.linspace(values[0], values[-1], values.size)
    return bool(np.abs(values - line).max() <= _STRAIGHT * (values[-1] - values[0]))


def _range(first, n):
    """Write places as a mapping has them."""
    return str(first) if n == 1 else f"{first}-{first + n - 1}"


def _blocks(table, n):
    """Return the clock, and (first place, n) of the blocks of n columns beside it."""
    numbers = all(x.dtype.kind in "biuf" for x in table.columns.values())
    clock, count = clock_of(table), len(table.columns)
    if not numbers:
        return clock, []
    for own in filter(None, [clock, "none"]):
        begin, end = 1, count
        if own == str(1):
            begin = 2
        elif own == str(count):
            end = count - 1
        elif own != "none":
            continue
        if (end - begin + 1) % n == 0 and end - begin + 1 >= 2 * n:
            firsts = range(begin, end + 1, n)
            return (None if own == "none" else own), [(x, n) for x in firsts]
    return clock, []


def _roles(table, clock, blocks):
    """Say which block is which kind of channel, and by what that shows."""
    rows = slice(0, _ROWS)
    values = {
        block: np.column_stack(
            [table.columns[str(block[0] + j)][rows].astype(float) for j in range(n)]
        )
        for block, n in ((x, x[1]) for x in blocks)
    }
    moving = [x for x in blocks if np.ptp(values[x], axis=0).any()]
    derived = {
        (one, other): _likeness(values[one], np.cumsum(values[other], axis=0), 1)
        for one in moving
        for other in moving
        if one != other
    }
    of = {
        one: max(own, key=lambda x, one=one: derived[one, x])
        for one in moving
        if (own := [x for x in moving if derived.get((one, x), 0) > _DERIVATIVE])
    }
    first = [x for x in moving if x in of and x not in of.values()]
    evidence = [f"column {clock} rises like time"] if clock else []
    if first:
        q = first[0]
    else:
        q = min(moving, key=lambda x: _roughness(values[x]), default=None)
    if q is None:
        return {}, "nothing moves"
    found = {"q": q}
    rest = [x for x in moving if x != q]
    if q in of and len(rest) > 1:
        found["v"] = of[q]
        rest.remove(of[q])
        evidence.append(f"{_range(*of[q])} are the derivatives of {_range(*q)}")
    else:
        evidence.append(f"{_range(*q)} are the smoothest")
    alike = [q, *([found["v"]] if "v" in found else [])]
    copies = [
        x
        for x in rest
        if any(_likeness(values[x], values[y], 0) > _SAME for y in alike)
    ]
    rest = [x for x in rest if x not in copies]
    if copies:
        evidence.append(
            f"{' and '.join(_range(*x) for x in copies)} follow them, as references do"
        )
    rates = [x for x in rest if "v" in found and x == of.get(found["v"])]
    if rates and len(rest) > 1:
        rest.remove(rates[0])
        evidence.append(
            f"{_range(*rates[0])} are those of {_range(*found['v'])} (left out)"
        )
    if rest:
        shares = {x: _explained(values[q], values[x]) for x in rest}
        found["tau"] = max(rest, key=shares.get)
        last = f"{_range(*found['tau'])} are what is left"
        if len(rest) > 1:
            others = " and ".join(_range(*x) for x in rest if x != found["tau"])
            last = f"{_range(*found['tau'])} go with the motion, better than {others}"
        evidence.append(last)
    return found, ", ".join(evidence)


def _likeness(one, other, degree):
    """Return the squared correlation of columns, positive ones, in the middle."""
    # Polynomials of time of a degree count for nothing: constants of an integration.
    time = np.linspace(-1.0, 1.0, len(one))[:, None] ** np.arange(degree + 1)
    one, other = (
        x - time @ np.linalg.lstsq(time, x, rcond=None)[0] for x in (one, other)
    )
    size = (one**2).sum(axis=0) * (other**2).sum(axis=0)
    moves = size > 0
    if not moves.any():
        return 0.0
    product = np.maximum((one * other).sum(axis=0), 0.0)[moves]
    return float(np.median(product**2 / size[moves]))


def _roughness(values):
    """Return how far columns are from being smooth, in the middle of the joints."""
    t = np.arange(len(values), dtype=float)
    errors, spread = prediction_errors(t, values), values.std(axis=0)
    moves = spread > 0
    return float(np.median(errors.std(axis=0)[moves] / spread[moves]))


def _explained(q, values):
    """Return the share of columns that a simple function of the motion explains."""
    v = np.gradient(q, axis=0)
    a = np.gradient(v, axis=0)
    time = np.linspace(-1.0, 1.0, len(q))[:, None] ** np.arange(4)
    parts = [time[:, :1], np.sin(q), np.cos(q), v, np.sign(v), a]
    motion = np.column_stack(parts)
    motion = motion / np.maximum(np.abs(motion).max(axis=0), 1e-300)
    # What warms up drifts with time, as slow positions may.
    power = [
        (values - x @ np.linalg.lstsq(x, values, rcond=None)[0]).var(axis=0)
        for x in (motion, time)
    ]
    spread = values.var(axis=0)
    moves = spread > 0
    return float(np.median((power[1] - power[0])[moves] / spread[moves]))
