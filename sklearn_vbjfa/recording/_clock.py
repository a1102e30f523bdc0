"""Sample times by time stamps, and recordings on a uniform time grid."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from sklearn_vbjfa.recording._drives import COMMANDS
from sklearn_vbjfa.recording._recording import (
    check_dt,
    check_rows_of_time,
    contiguous_groups,
    labels_of,
)
from sklearn_vbjfa.recording._table import Loss, Table, listed

# Stamps within this share of a period of equidistant times are a steady clock that was
# written with few digits: the samples are taken as they are.
STEADY = 0.02
# A step longer than this many periods is a gap, not bridged by interpolation.
GAP_PERIODS = 5.0
# A slower clock [s] records no motion: stamps in ms or ns come out like that.
_SLOWEST = 1.0
# Relative difference that is refused, between `dt` as given and as stamped, and between
# the periods of segments; and below which periods count as one.
_DT_TOLERANCE, SAME_DT = 0.05, 1e-3
# Steps this near to whole periods, nine in ten of them, tell how many rows are missing.
_NEAR, _NEARLY_ALL = 0.15, 0.9
# Rows over which the period is averaged, against late stamps; and over which it is
# compared with that of the rest, by the standard deviation of its ratio.
_WINDOW, _LONG_WINDOW, _CHANGES = 16, 64, 0.08
# Stamps of which fewer change than this must change by small shares of the recording.
_SOME_TICKS, _FINE_TICKS = 0.3, 0.02
# Positions must fit the stamps better by this much, in the sum over the joints of the
# logarithms of their roughness, than they fit a steady sampling.
_CLEARLY = 0.2
# Share of steps over several periods from which rows are missing.
_SEVERAL = 0.1
# Rows are sorted by their stamps if the sum of second differences falls below this
# share.
_SMOOTHER = 0.99
# Fewer samples than this between two gaps cannot be differentiated and held out from.
_MIN_SAMPLES = 16
# The lower quartile of the size of a normal variable, in standard deviations.
_QUARTILE = 0.3186


@dataclass(frozen=True, kw_only=True)
class TimeStamps:
    """What the time stamps of one recording tell."""

    dt: float  # sample period [s]
    # whether the robot was sampled at the time of the stamps, else steadily
    sampled: bool
    late: bool  # whether stamps are irregular while the sampling was steady
    # period in which each row was sampled, from 0 on in each piece between gaps;
    # without meaning if `sampled`
    slots: np.ndarray
    steps: np.ndarray  # between stamps, gaps left out [s]
    gaps: np.ndarray  # rows after which more than five periods are missing

    @property
    def jitter(self):
        """Standard deviation of the steps from the period [s]."""
        return float(np.sqrt(np.mean((self.steps - self.dt) ** 2)))


def inspect_time_stamps(t, dt=None, where=None, positions=None) -> TimeStamps:
    """Return what the stamps t (n_samples,) [s] of one recording tell."""
    # dt [s] is the period if it is known; `where` turns a row (from 0) into words;
    # positions (n_samples, nv) tell whether irregular stamps are the time of sampling,
    # without them a steady sampling is taken. Refuses time that stands still or runs
    # backwards, is not in seconds, contradicts dt, or says nothing of the period.
    t = np.asarray(t, dtype=float)
    where = where or (lambda row: f"row {row}")
    if t.ndim != 1 or t.size < 2:
        raise ValueError(f"t must hold two time stamps or more, got shape {t.shape}.")
    step = np.diff(t)
    back = np.flatnonzero(step < 0)
    if back.size:
        row = back[0] + 1
        raise ValueError(
            f"time runs backwards to {t[row]:.9g} s in {where(row)} ({back.size} such "
            "row(s)); sort the rows, or mark separate recordings in a column segment."
        )
    ticks = step[step > 0]
    few = ticks.size < _SOME_TICKS * step.size
    if not ticks.size or (few and np.max(ticks) > _FINE_TICKS * (t[-1] - t[0])):
        raise ValueError(
            f"time repeats {t[0]:.9g} s in all rows or in most of them "
            f"({ticks.size + 1} different stamps in {t.size} rows); write the stamps "
            "with more digits, or leave them out and give dt."
        )
    period, whole = _first_period(t, step)
    if period >= _SLOWEST:
        raise ValueError(
            f"time steps by {period:.6g} s at the median, too slow for a motion; t "
            "must be in seconds: give its unit (--time-unit ms, us or ns)."
        )
    gaps = _gaps(t, step, period)
    pieces = [slice(a, b) for a, b in zip(np.r_[0, gaps + 1], np.r_[gaps + 1, t.size])]
    # Rows are missing, as of a second source, and stamps are not merely rounded.
    missing = whole and np.mean(step > 1.5 * period) > _SEVERAL
    steady, found = _steady(t, step, pieces, period, rounded=not missing)
    slots, sampled = _counted(pieces), False
    if not steady:
        found, slots, sampled = _when(t, pieces, period, whole, positions, where)
    check_given(found, dt)
    off = [np.ptp(t[x] - found * slots[x]) for x in pieces]
    return TimeStamps(
        dt=float(f"{found:.7g}") if dt is None else float(dt),
        sampled=sampled,
        late=not steady and not sampled and max(off) > 2 * STEADY * found,
        slots=slots,
        steps=np.delete(step, gaps),
        gaps=gaps,
    )


# -- the period ------------------------------------------------------------------------


def _first_period(t, step):
    """Return a first period [s], and whether steps are whole multiples of it."""
    # Without the rows of a second source, steps of two sizes may be equally frequent.
    for share in (0.5, 0.25):
        period = float(np.quantile(step[step > 0], share, method="lower"))
        counts = np.round(step / period)
        near = (np.abs(step / period - counts) < _NEAR) & (counts > 0)
        if near.mean() < _NEARLY_ALL:
            continue
        near &= counts <= GAP_PERIODS
        for _ in range(2):
            count = np.maximum(np.round(step[near] / period), 1.0).sum()
            period = float(step[near].sum() / count)
        return period, True
    m = min(_WINDOW, step.size)
    period = float(np.median(t[m:] - t[:-m])) / m
    # Many rows with one stamp, and then a long step.
    return (period if period > 0 else (t[-1] - t[0]) / step.size), False


def _gaps(t, step, period):
    """Return rows after which rows are missing, not only stamps late."""
    gaps = []
    for row in np.flatnonzero(step > GAP_PERIODS * period):
        excess = step[row] / period - 1.0
        count = int(np.ceil(3 * excess))
        after = t[row + 1 : row + 2 + count] - t[row]
        before = t[row + 1] - t[max(row - count, 0) : row + 1][::-1]
        # Rows that waited come quickly afterwards; those of a packet came before.
        left = [np.min(x / period - np.arange(1, x.size + 1)) for x in (after, before)]
        if min(left) > excess / 3:
            gaps.append(row)
    return np.array(gaps, dtype=int)


def _steady(t, step, pieces, period, rounded=True):
    """Whether stamps are equidistant but for rounding; their period [s]."""
    rows = sum(x.stop - x.start - 1 for x in pieces)
    found = sum(t[x.stop - 1] - t[x.start] for x in pieces) / max(rows, 1)
    if found <= 0:
        return rows < 1, period
    steady = max(2 * STEADY * found, 1.01 * _resolution(t, found) * rounded)
    if np.mean(step == 0) > 1 - _NEARLY_ALL:
        # A clock that ticks more slowly than the robot is sampled.
        steady = max(steady, 1.01 * float(np.median(step[step > 0])))
    late = [t[x] - t[x.start] - found * np.arange(x.stop - x.start) for x in pieces]
    return max(float(np.ptp(x)) for x in late) <= steady, found


def _resolution(t, dt):
    """Return the decimal step to which stamps were rounded [s], 0 for a fine one."""
    for step in 10.0 ** -np.arange(7):
        if step < 0.5 * dt:
            digits = round(-np.log10(step))
            if np.abs(t - np.round(t, digits)).max() < 1e-6 * step:
                return step
            if step < STEADY * dt:
                break
    return 0.0


def check_given(found, dt, what="time steps by", tolerance=_DT_TOLERANCE):
    """Refuse a period that contradicts the stamps, or what else tells it."""
    if dt is not None and abs(found - dt) > tolerance * dt:
        raise ValueError(
            f"{what} {found:.6g} s but dt = {dt:.6g} s; correct one of them, or leave "
            "out dt (a period in s, not in ms or Hz)."
        )


# -- when rows were sampled ------------------------------------------------------------


def _counted(pieces):
    """Count the rows of each piece from 0."""
    return np.concatenate([np.arange(x.stop - x.start) for x in pieces])


def _followed_slots(t, dt, whole):
    """Count periods, following a clock that wanders and stamps that are late."""
    # Stamps at whole periods begin at one; among late ones the first may be the latest.
    start = 1 if whole else min(_WINDOW, t.size)
    phase = float(np.median(t[:start] - dt * np.arange(start)))
    slots = np.empty(t.size, dtype=int)
    slot, delay = -1, 0.0
    for row, stamp in enumerate(t.tolist()):
        found = (stamp - phase) / dt
        slot = max(slot + 1, round(found - delay))
        # The clock of the stamps against that of the rows, averaged.
        delay += 0.1 * (found - slot - delay)
        slots[row] = slot
    return slots - slots[0]


def _when(t, pieces, period, whole, positions, where):
    """Return the period [s], slots, and whether the stamps are the time of sampling."""
    # `whole` tells whether the steps show how many rows are missing.
    followed = []
    for piece in pieces:
        slots, found = None, period
        for _ in range(2):
            slots = _followed_slots(t[piece], found, whole)
            took = t[piece.stop - 1] - t[piece.start]
            found = took / slots[-1] if slots[-1] and took > 0 else found
        followed.append(slots)
    # Late stamps may look like missing rows, also among others that are whole.
    candidates = [_counted(pieces), np.concatenate(followed)]
    if whole:
        candidates.reverse()
    took = sum(t[x.stop - 1] - t[x.start] for x in pieces)
    periods = [took / sum(one[x.stop - 1] for x in pieces) for one in candidates]
    times = [dt * slots for dt, slots in zip(periods, candidates)]
    rough = np.zeros(len(times) + 1)
    if positions is not None:
        rough = _roughness([*times, t], pieces, positions)
    best = int(rough[1] < rough[0] - _CLEARLY)
    if rough[-1] < rough[best] - _CLEARLY:
        return periods[0], candidates[0], True
    dt, slots = periods[best], candidates[best]
    ends = [np.arange(x.start, x.stop, _LONG_WINDOW) for x in pieces]
    rate = np.concatenate([np.diff(t[x]) / np.diff(slots[x]) / dt for x in ends])
    row = np.concatenate([x[:-1] for x in ends])
    if rate.size > 3 and np.std(rate) > _CHANGES:
        slow, fast = row[rate.argmax()], row[rate.argmin()]
        raise ValueError(
            f"time steps by {rate.min() * dt:.4g} s on average after {where(fast)} and "
            f"by {rate.max() * dt:.4g} s after {where(slow)}, and positions do not "
            "follow it; correct t, or mark recordings of other periods in segment."
        )
    return dt, slots, False


def _roughness(times, pieces, positions):
    """Compare the smoothness of positions (n, nv) under several times of their rows."""
    # Returns for each of `times` the sum over the joints of the logarithm of the
    # squared prediction errors; zeros if no joint moves.
    squares = np.zeros((len(times), positions.shape[1]))
    for piece in pieces:
        for k, t in enumerate(times):
            squares[k] += (prediction_errors(t[piece], positions[piece]) ** 2).sum(0)
    moves = (np.ptp(positions, axis=0) > 0) & (squares > 0).all(axis=0)
    return np.log(squares[:, moves]).sum(axis=1)


def prediction_errors(t, values):
    """Return how far values (n, k) are from cubics through their neighbours, (m, k)."""
    # In units of their standard deviation for unit white noise; rows next to equal
    # times t (n,) [s], which must not fall, are left out.
    near = (-2, -1, 1, 2)
    n = t.size - 4
    if n < 1:
        return np.empty((0, values.shape[1]))
    middle = t[2:-2]
    at = np.stack([t[2 + k : 2 + k + n] for k in near]) - middle
    good = (np.diff(at[[0, 1]], axis=0)[0] > 0) & (at[1] < 0) & (at[2] > 0)
    good &= at[3] > at[2]
    at = at[:, good]
    predicted, gain = 0.0, 1.0
    for i, k in enumerate(near):
        weight = np.ones(at.shape[1])
        for j in range(4):
            if j != i:
                weight *= at[j] / (at[j] - at[i])
        predicted = predicted + weight[:, None] * values[2 + k : 2 + k + n][good]
        gain = gain + weight**2
    return (values[2:-2][good] - predicted) / np.sqrt(gain)[:, None]


def _white_noise(rows):
    """Return the standard deviation (nv,) of white noise of (t, torques), or None."""
    # The lower quartile passes over what jumps, as friction does.
    errors = np.abs(np.concatenate([prediction_errors(*one) for one in rows]))
    return np.quantile(errors, 0.25, axis=0) / _QUARTILE if errors.size else None


# -- stamps against a known period -----------------------------------------------------

# Beyond the first many of them a sample is missing, beyond the second share of one a
# step is worth a warning. Accelerations go with the square of a wrong period: this
# share of it, and no less than a row over a recording, is refused.
_MISSING, _JITTER, _WRONG_PERIOD = 1.5, 0.1, 0.002


def check_time_stamps(t, dt, parts):
    """Refuse stamps t (n,) [s] that contradict dt [s], warn of irregular ones."""
    # Nothing is asked of the step from one of the slices `parts` to the next; without t
    # nothing at all, without dt (rows need not be equidistant) only that the stamps
    # rise.
    if t is None:
        return
    time = check_rows_of_time(t, parts[-1].stop)
    dt = None if dt is None else check_dt(dt)
    for part in parts:
        step, start = np.diff(time[part]), part.start
        back = np.flatnonzero(step <= 0)
        if back.size:
            a, b = time[start + back[0] : start + back[0] + 2]
            raise ValueError(
                f"t must rise within a recording; it does not after row "
                f"{listed(start + back)} ({a:.6g} s, then {b:.6g} s). Drop repeated "
                "rows, or begin another recording there (groups)."
            )
        if dt is None or not step.size:
            continue
        # One gap does not make another sample period.
        usual, off = np.median(step), abs(step.sum() - step.size * dt)
        slower = abs(usual - dt) > _WRONG_PERIOD * dt
        slower &= off > max(_WRONG_PERIOD * step.size, 1.0) * dt
        gap = start + np.flatnonzero(step > _MISSING * dt)
        odd = start + np.flatnonzero(np.abs(step / dt - 1) > _JITTER)
        if slower or abs(usual - dt) > _MISSING * dt or gap.size:
            gaps = f"; after row {listed(gap)} samples are missing" if gap.size else ""
            raise ValueError(
                f"The time stamps of the recording from row {start} advance by "
                f"{step.mean():.6g} s a row ({usual:.6g} s in the median, at most "
                f"{step.max():.6g} s), but dt={dt:.6g} s{gaps}. Correct dt, resample, "
                "or begin another recording after each gap (groups)."
            )
        if odd.size:
            warnings.warn(
                f"{odd.size} of {step.size} steps between time stamps differ from "
                f"dt={dt:.6g} s by more than {100 * _JITTER:.0f} % (after row "
                f"{listed(odd)}); rows count as equidistant. Resample, unless "
                "only the stamps are irregular.",
                UserWarning,
                stacklevel=3,
            )


# -- interpolation ---------------------------------------------------------------------


def _local_cubic(t, rows):
    """Cubics with the slopes of parabolas, which no far-off sample can disturb."""
    slope = np.gradient(rows, t, axis=0, edge_order=2)
    return CubicHermiteSpline(t, rows, slope, axis=0)


def interpolate(t, channels, dt: float, cubic=_local_cubic):
    """Interpolate channels (n, ...) at t (n,) [s], from 0 on, on multiples of dt."""
    # Positions "q" follow the cubic that `cubic` builds from stamps and rows; commands
    # hold the value that came last; all else, being noisier, follows straight lines.

    # Rounding of t must not cost the last point.
    grid = dt * np.arange(int(np.floor(t[-1] / dt + STEADY)) + 1)
    query = np.minimum(grid, t[-1])
    resampled = {}
    for key, values in channels.items():
        rows = values.reshape(t.size, -1).astype(float)
        if key == "q" and t.size > 2:
            # A joint that stands does not move by rounding.
            still, first = np.ptp(rows, axis=0) == 0, rows[0]
            rows = np.where(still, first, cubic(t, rows)(query))
        elif key in COMMANDS:
            # Stamps that rounding moves past the grid point count.
            rows = rows[np.searchsorted(t, query + STEADY * dt, side="right") - 1]
        else:
            rows = np.column_stack([np.interp(query, t, x) for x in rows.T])
        resampled[key] = rows.reshape(query.size, *values.shape[1:])
    return grid, resampled


def _merge_doubled(t, channels):
    """Average rows of one stamp: t (n,) [s] that does not fall, channels (n, ...)."""
    # Of commands the last one counts.
    starts = np.flatnonzero(np.r_[True, np.diff(t) > 0])
    count = np.diff(starts, append=t.size)
    merged = {}
    for key, values in channels.items():
        if key in COMMANDS:
            merged[key] = values[starts + count - 1]
            continue
        sums = np.add.reduceat(values.astype(float), starts, axis=0)
        merged[key] = sums / count.reshape(-1, *[1] * (values.ndim - 1))
    return t[starts], merged


def _repeats(channels, n):
    """Whether each of n - 1 rows equals the one before it in every channel."""
    same = np.ones(n - 1, dtype=bool)
    for values in channels.values():
        rows = values.reshape(n, -1)
        same &= (rows[1:] == rows[:-1]).all(axis=1)
    return same


def _channels_of(one):
    """Return what a log or a recording has for every row, by name."""
    found = {"q": one.q, "tau": one.tau, **one.signals}
    return found if one.v is None else found | {"v": one.v}


def _fields(pieces, dt: float) -> dict:
    """Concatenate pieces (name, t, channels) into the array fields of a `Recording`."""

    def together(arrays):
        # A single one is not copied.
        return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)

    names, times, channels = zip(*pieces)
    columns = {key: together([one[key] for one in channels]) for key in channels[0]}
    return {
        "q": columns.pop("q"),
        "tau": columns.pop("tau"),
        "v": columns.pop("v", None),
        "t": together(times),
        "dt": dt,
        "groups": labels_of([t.size for t in times]),
        "group_names": names,
        "signals": columns,
    }


def _pieces(name, parts):
    """Return the parts (t, channels) of a recording, "name [1]", ... if it was cut."""
    several = len(parts) > 1
    return [
        (f"{name} [{k}]" if several else name, *part)
        for k, part in enumerate(parts, start=1)
    ]


def distinct(names):
    """Return names, repeated ones with a number."""
    found, seen = [], {}
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found


def _rows_of(channels, rows):
    """Return rows of all channels; all of them as they are."""
    whole = isinstance(rows, np.ndarray) and rows.size == len(channels["q"])
    return channels if whole else {key: x[rows] for key, x in channels.items()}


# -- logs of measured sets -------------------------------------------------------------

# Fewer samples cannot be differentiated.
_MIN_LOG = 10
# A log is uniform already up to this part of dt: a steady clock with six decimals.
_UNIFORM_RTOL = 1e-3
# A step of a log above this many periods ends a part and starts another one.
_LOG_GAP_PERIODS = 10.0


@dataclass(frozen=True, kw_only=True)
class Log:
    """One recording as read: stamps [s] and channels, first axis time."""

    name: str
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    v: np.ndarray | None = None
    signals: Mapping[str, np.ndarray] = field(default_factory=dict)


def median_period(logs) -> float:
    """Median step between stamps over all logs [s], rounded to 0.1 us."""
    return round(float(np.median(np.concatenate([np.diff(x.t) for x in logs]))), 7)


def join(logs, *, dt: float, resample=True, drop_repeated=False) -> dict:
    """Concatenate logs into the array fields of a `Recording`."""
    # With `resample` each log is put on multiples of dt; one with long gaps becomes
    # several recordings, "name [1]", "name [2]", ...
    pieces = []
    for log in logs:
        parts = [(log.t, _channels_of(log))]
        if resample:
            parts = resample_uniform(*parts[0], dt=dt, drop_repeated=drop_repeated)
        pieces += _pieces(log.name, parts)
    return _fields(pieces, dt)


def resample_uniform(t, channels, *, dt: float, drop_repeated=False):
    """Return grid (n_part,) [s] and channels of a log's parts between long gaps."""
    # A log that is uniform already is left as it is; `drop_repeated` also drops rows
    # equal to the one before in every channel, readings that the logger wrote twice.
    keep = np.r_[True, np.diff(t) > 0]
    if drop_repeated:
        keep[1:] &= ~_repeats(channels, len(t))
    t = t[keep]
    channels = {key: values[keep] for key, values in channels.items()}
    parts = []
    ends = np.flatnonzero(np.diff(t) > _LOG_GAP_PERIODS * dt) + 1
    for rows in np.split(np.arange(len(t)), ends):
        if len(rows) < _MIN_LOG:
            continue
        part = {key: values[rows] for key, values in channels.items()}
        at, grid = t[rows] - t[rows[0]], dt * np.arange(len(rows))
        if np.max(np.abs(at - grid)) >= _UNIFORM_RTOL * dt:
            grid, part = interpolate(at, part, dt, CubicSpline)
        parts.append((grid, part))
    if not parts:
        raise ValueError(
            f"No {_MIN_LOG} samples follow one another with steps below "
            f"{_LOG_GAP_PERIODS * dt:.3g} s; dt = {dt:.3g} s does not suit these "
            "stamps."
        )
    return parts


# -- a user's file ---------------------------------------------------------------------


def sorted_by_time(table: Table, t, channels, notes):
    """Sort rows that are out of order in time, where that makes one smooth motion."""
    # Two recordings, one after the other, would be mixed: they stay as they are, to be
    # refused.
    back = int((np.diff(t) < 0).sum())
    if not back:
        return t, channels, table
    order = np.argsort(t, kind="stable")
    late = np.diff(t[order])
    q, n = channels["q"], t.size
    rough = [np.abs(np.diff(x, n=2, axis=0)).sum() for x in (q, q[order])]
    # A motion that is reversed is as smooth.
    smoother = rough[1] < _SMOOTHER * rough[0]
    if not (late.all() and late.max() <= GAP_PERIODS * np.median(late) and smoother):
        return t, channels, table
    notes.append(
        f"rows are not in the order of time (in {back} places of {n} it goes back): "
        "they were sorted by it."
    )
    channels = {key: x[order] for key, x in channels.items()}
    return t[order], channels, table.take(order)


def on_grid(table: Table, t, labels, dt, channels, notes):
    """Cut a file at segments and gaps, return the array fields of a `Recording`."""
    # Stamps t [s] and labels of segments, (n_rows,) or None; dt [s] or None for that of
    # the stamps; channels (n_rows, ...), "q" and "tau" among them. What was found goes
    # to `notes`.
    runs = [np.arange(table.n_rows)[x] for x in contiguous_groups(labels, table.n_rows)]
    names = ["recording"]
    if labels is not None:
        names = distinct(str(labels[rows[0]]).removesuffix(".0") for rows in runs)
    if t is None:
        times = [dt * np.arange(rows.size) for rows in runs]
        parts = [_rows_of(channels, rows) for rows in runs]
        return _fields(list(zip(names, times, parts)), dt)
    runs = _without_doubles(t, runs, channels, notes)
    stamps = [_inspected(table, t, rows, dt, channels["q"]) for rows in runs]
    if dt is None:
        dt = float(np.median([x.dt for x in stamps]))
        low, high = min(x.dt for x in stamps), max(x.dt for x in stamps)
        if high - low > 2 * _DT_TOLERANCE * dt:
            raise ValueError(
                f"{table.path}: segments have periods of {low:.6g} to {high:.6g} s; "
                "put those of one period into one file."
            )
    notes += _irregularities(table, stamps, runs, dt)
    pieces, off_grid, short, single, merged = [], [], 0, 0, 0
    for name, rows, checked in zip(names, runs, stamps):
        parts = np.split(np.arange(rows.size), checked.gaps + 1)
        long = [x for x in parts if x.size >= min(_MIN_SAMPLES, rows.size)]
        short += len(parts) - len(long)
        put = []
        for part in long:
            values = _rows_of(channels, rows[part])
            at, values, same = _placed(t[rows[part]], values, checked, part, dt)
            if checked.sampled:
                merged += part.size - at.size
            else:
                single += int(np.ptp(checked.slots[part])) + 1 - part.size
            if not same:
                off_grid.append((at, values["tau"]))
                at, values = interpolate(at, values, dt)
            put.append((at, values))
        pieces += _pieces(name, put)
    if short:
        text = f"{short} piece(s) of fewer than {_MIN_SAMPLES} samples between gaps"
        notes.append(Loss(f"{text} are left out."))
    if single:
        notes.append(f"{single} single sample(s) are missing and were interpolated.")
    if merged:
        notes.append(f"{merged} row(s) repeat a stamp and were averaged with it.")
    if not pieces:
        raise ValueError(
            f"{table.path}: no {_MIN_SAMPLES} samples follow one another without a gap "
            f"of more than {GAP_PERIODS:g} periods of {dt:.4g} s; check column t."
        )
    fields = _fields(pieces, dt)
    if off_grid:
        fields["torque_noise"] = _white_noise(off_grid)
    return fields


def _without_doubles(t, runs, channels, notes):
    """Leave out rows that repeat the one before in every channel and in time."""
    again = np.r_[False, np.diff(t) == 0]
    if again.any():
        again[1:] &= _repeats(channels, t.size)
    again[[rows[0] for rows in runs]] = False
    if again.any():
        notes.append(f"{again.sum()} row(s) are there twice and were left out once.")
    return [rows[~again[rows]] for rows in runs]


def _inspected(table, t, rows, dt, positions):
    """Return what the stamps of a segment tell."""
    if rows.size < 2:
        raise ValueError(
            f"{table.path}: the segment at {table.where(rows[0])} has one row "
            "only; give it another label, or remove it."
        )
    try:
        return inspect_time_stamps(
            t[rows], dt, lambda k: table.where(rows[k]), positions[rows]
        )
    except ValueError as error:
        raise ValueError(f"{table.path}: {error}") from None


def _placed(t, values, checked, part, dt):
    """Return times of the rows `part` of a segment, rows, and whether they fit."""
    if checked.sampled:
        at, values = _merge_doubled(t, values)
        return at - at[0], values, False
    slots = checked.slots[part] - checked.slots[part[0]]
    # Late stamps alone do not make another period.
    unsure = 3 * checked.jitter / checked.slots.size
    same = abs(checked.dt - dt) < max(SAME_DT * dt, unsure)
    at = (dt if same else checked.dt) * slots
    return at, values, same and slots[-1] + 1 == slots.size


def on_one_grid(recordings, names, dt):
    """Concatenate files whose periods are nearly dt [s], and name the others."""
    # names: of the recordings in them, one after the other. Returns the array fields of
    # a `Recording`, and the positions of the files that were interpolated.
    pieces, names, moved, noise = [], iter(names), [], []
    for k, one in enumerate(recordings):
        channels, off_grid = _channels_of(one), []
        for rows in one.segments:
            values, t = _rows_of(channels, rows), np.arange(rows.stop - rows.start)
            if abs(one.dt - dt) >= SAME_DT * dt:
                off_grid.append((one.dt * t, values["tau"]))
                t, values = interpolate(one.dt * t, values, dt)
            else:
                t = dt * t
            pieces.append((next(names), t, values))
        moved += [k] * bool(off_grid)
        # That of the torques as they came, where they were interpolated before.
        size = one.torque_noise
        if size is None and off_grid:
            size = _white_noise(off_grid)
        if size is not None:
            noise.append((one.n_samples, size))
    fields = _fields(pieces, dt)
    if noise:
        share, power = zip(*((n, size**2) for n, size in noise))
        fields["torque_noise"] = np.sqrt(np.average(power, axis=0, weights=share))
    return fields, moved


def _irregularities(table, stamps, runs, dt):
    """Say in words what is irregular."""
    sampled = "the positions say that the robot was sampled at these times; all is "
    sampled += "interpolated on a uniform grid"
    late = (
        "the positions do not follow them, so that only the stamps are irregular and "
    )
    late += "not the sampling; rows are taken as equidistant"
    for what, said in (("sampled", sampled), ("late", late)):
        odd = [x for x in stamps if getattr(x, what)]
        if odd:
            jitter = max(x.jitter for x in odd)
            steps = np.concatenate([x.steps for x in odd])
            yield (
                f"time stamps are irregular (steps of {steps.min():.4g} to "
                f"{steps.max():.4g} s, standard deviation {100 * jitter / dt:.2g} % of "
                f"the period of {dt:.4g} s): {said}."
            )
    count = sum(int((x.steps == 0).sum()) for x in stamps if not x.sampled)
    if count:
        yield (
            f"{count} stamp(s) repeat the one before; the rows are taken as "
            "equidistant."
        )
    gaps = [rows[x.gaps] for rows, x in zip(runs, stamps) if x.gaps.size]
    if gaps:
        yield Loss(
            f"{sum(x.size for x in gaps)} gap(s) of more than {GAP_PERIODS:g} periods "
            f"in time, the first after {table.where(gaps[0][0])}: the recording is "
            "split there."
        )
