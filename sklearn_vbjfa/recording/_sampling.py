"""Sample times by time stamps, and recordings on a uniform time grid."""

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa.recording._drives import COMMANDS
from sklearn_vbjfa.recording._recording import check_dt, labels_of
from sklearn_vbjfa.recording._table import Loss, Table, listed

# Stamps within this share of a period of equidistant times are a steady clock that was
# written with few digits: the samples are taken as they are.
STEADY = 0.02
# A step longer than this many periods is a gap, not bridged by interpolation.
GAP_PERIODS = 5.0
# A slower clock [s] records no motion: stamps in ms or ns come out like that.
_SLOWEST = 1.0
# Relative difference that is refused, between `dt` as given and as stamped, and between
# the periods of segments.
_DT_TOLERANCE = 0.05
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
# Rows are sorted by their stamps if the sum of second differences falls below this
# share.
_SMOOTHER = 0.99
# Beside a given period: beyond the first many of them a sample is missing, beyond the
# second share of one a step is worth a warning. Accelerations go with the square of a
# wrong period: this share of it, and no less than a row over a recording, is refused.
_MISSING, _JITTER, _WRONG_PERIOD = 1.5, 0.1, 0.002


@dataclass(frozen=True, kw_only=True)
class TimeStamps:
    """What the time stamps of one recording tell."""

    dt: float  # sample period [s]
    # whether the stamps are those of a steady clock, but for rounding and gaps, and no
    # row is missing between gaps
    uniform: bool
    # whether the robot was sampled at the time of the stamps, else steadily
    sampled: bool
    late: bool  # whether stamps are irregular while the sampling was steady
    # period in which each row was sampled, from 0 on in each piece between gaps;
    # without meaning if `sampled`
    slots: np.ndarray
    jitter: float  # standard deviation of the steps from the period, gaps left out [s]
    # shortest and longest step, gaps left out [s]
    shortest: float
    longest: float
    doubled: int  # number of stamps equal to the one before
    gaps: np.ndarray  # rows after which more than five periods are missing


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
    _check_order(t, step, where)
    period, whole = _first_period(t, step)
    if period >= _SLOWEST:
        raise ValueError(
            f"time steps by {period:.6g} s at the median, too slow for a motion; t "
            f"must be in seconds, {_other_unit(period)}."
        )
    gaps = _gaps(t, step, period)
    pieces = [slice(a, b) for a, b in zip(np.r_[0, gaps + 1], np.r_[gaps + 1, t.size])]
    steady, own = _steady(t, step, pieces, period)
    sampled = False
    if steady:
        slots = np.concatenate([np.arange(x.stop - x.start) for x in pieces])
    else:
        own, slots, sampled = _when(t, pieces, period, whole, positions, where)
    check_given(own, dt)
    missing = np.delete(np.diff(slots), gaps) > 1
    inside = np.delete(step, gaps)
    off = [np.ptp(t[x] - own * slots[x]) for x in pieces]
    return TimeStamps(
        dt=float(f"{own:.7g}") if dt is None else float(dt),
        uniform=steady and not missing.any(),
        sampled=sampled,
        late=not steady and not sampled and max(off) > 2 * STEADY * own,
        slots=slots,
        jitter=float(np.sqrt(np.mean((inside - own) ** 2))) if inside.size else 0.0,
        shortest=float(inside.min(initial=np.inf)),
        longest=float(inside.max(initial=0.0)),
        doubled=int((step == 0).sum()),
        gaps=gaps,
    )


# -- the period ------------------------------------------------------------------------


def _check_order(t, step, where):
    back = np.flatnonzero(step < 0)
    if back.size:
        row = back[0] + 1
        raise ValueError(
            f"time runs backwards to {t[row]:.9g} s in {where(row)} ({back.size} such "
            "row(s)); sort the rows, or mark separate recordings in a column segment."
        )
    ticks = step[step > 0]
    several = ticks.size < _SOME_TICKS * step.size
    if not ticks.size or (several and np.max(ticks) > _FINE_TICKS * (t[-1] - t[0])):
        raise ValueError(
            f"time repeats {t[0]:.9g} s in all rows or in most of them "
            f"({ticks.size + 1} different stamps in {t.size} rows); write the stamps "
            "with more digits, or leave them out and give dt."
        )


def _other_unit(period):
    """Return the unit of stamps with this period."""
    units = (
        ("milliseconds", "ms", 1e-3),
        ("microseconds", "us", 1e-6),
        ("nanoseconds", "ns", 1e-9),
    )
    for name, unit, factor in units:
        if period * factor < 0.1:
            return (
                f"in {name} this would be a period of {period * factor:.4g} s: "
                f"give the unit (--time-unit {unit}), or multiply t by {factor:g}"
            )
    return "which these are not"


def _first_period(t, step):
    """Return a first period [s], and whether steps are whole multiples of it."""
    some = step[step > 0]
    usual = float(np.median(some))
    counts = np.round(step / usual)
    near = (np.abs(step / usual - counts) < _NEAR) & (counts > 0)
    if near.mean() >= _NEARLY_ALL:
        return _whole_period(step[near & (counts <= GAP_PERIODS)], usual), True
    m = min(_WINDOW, step.size)
    period = float(np.median(t[m:] - t[:-m])) / m
    # Many rows with one stamp, and then a long step.
    return (period if period > 0 else (t[-1] - t[0]) / step.size), False


def _whole_period(step, period):
    """Average the period over steps of one or several of them [s]."""
    for _ in range(2):
        period = float(step.sum() / np.maximum(np.round(step / period), 1.0).sum())
    return period


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


def _steady(t, step, pieces, period):
    """Whether stamps are equidistant but for rounding; their period [s]."""
    rows = sum(x.stop - x.start - 1 for x in pieces)
    if rows < 1:
        return True, period
    own = sum(t[x.stop - 1] - t[x.start] for x in pieces) / rows
    if own <= 0:
        return False, period
    steady = max(2 * STEADY * own, 1.01 * _resolution(t, own))
    if np.mean(step == 0) > 1 - _NEARLY_ALL:
        # A clock that ticks more slowly than the robot is sampled.
        steady = max(steady, 1.01 * float(np.median(step[step > 0])))
    worst = 0.0
    for piece in pieces:
        late = t[piece] - t[piece.start] - own * np.arange(piece.stop - piece.start)
        worst = max(worst, float(np.ptp(late)))
    return worst <= steady, own


def _resolution(t, dt):
    """Return the decimal step to which stamps were rounded [s], 0 for a fine one."""
    for digits in range(7):
        step = 10.0**-digits
        if step < 0.5 * dt:
            if np.abs(t - np.round(t, digits)).max() < 1e-6 * step:
                return step
            if step < STEADY * dt:
                break
    return 0.0


def check_given(own, dt, what="time steps by", tolerance=_DT_TOLERANCE):
    """Refuse a period that contradicts the stamps, or what else tells it."""
    if dt is None or abs(own - dt) <= tolerance * dt:
        return
    meant = ""
    if abs(1 / dt - own) <= _DT_TOLERANCE * own:
        meant = f" ({dt:.6g} Hz is a period of {1 / dt:.6g} s)"
    elif abs(dt / 1e3 - own) <= _DT_TOLERANCE * own:
        meant = f" ({dt:.6g} ms are {dt / 1e3:.6g} s)"
    raise ValueError(
        f"{what} {own:.6g} s but dt = {dt:.6g} s{meant}; correct one of them, "
        "or leave out dt."
    )


# -- when rows were sampled ------------------------------------------------------------


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
        slots, own = None, period
        for _ in range(2):
            slots = _followed_slots(t[piece], own, whole)
            took = t[piece.stop - 1] - t[piece.start]
            own = took / slots[-1] if slots[-1] and took > 0 else own
        followed.append(slots)
    # Late stamps may look like missing rows, also among others that are whole.
    plain = np.concatenate([np.arange(x.stop - x.start) for x in pieces])
    candidates = [plain, np.concatenate(followed)]
    if whole:
        candidates.reverse()
    periods = [_average_period(t, pieces, slots) for slots in candidates]
    times = [dt * slots for dt, slots in zip(periods, candidates)]
    rough = np.zeros(len(times) + 1)
    if positions is not None:
        rough = _roughness([*times, t], pieces, positions)
    best = int(rough[1] < rough[0] - _CLEARLY)
    if rough[-1] < rough[best] - _CLEARLY:
        return periods[0], candidates[0], True
    _check_rate(t, pieces, periods[best], candidates[best], where)
    return periods[best], candidates[best], False


def _average_period(t, pieces, slots):
    """Average the period over pieces [s]."""
    ends = [x for x in pieces if x.stop - x.start > 1]
    took = sum(t[x.stop - 1] - t[x.start] for x in ends)
    count = sum(int(slots[x.stop - 1] - slots[x.start]) for x in ends)
    return took / count


def _check_rate(t, pieces, dt, slots, where):
    """Refuse stamps whose period changes."""
    rates, rows = [], []
    for piece in pieces:
        ends = np.arange(piece.start, piece.stop, _LONG_WINDOW)
        if ends.size > 1:
            rates.append(np.diff(t[ends]) / np.diff(slots[ends]) / dt)
            rows.append(ends[:-1])
    if rates:
        rate, row = np.concatenate(rates), np.concatenate(rows)
        if rate.size > 3 and np.std(rate) > _CHANGES:
            slow, fast = row[rate.argmax()], row[rate.argmin()]
            raise ValueError(
                f"time steps by {rate.min() * dt:.4g} s on average after "
                f"{where(fast)} and by {rate.max() * dt:.4g} s after {where(slow)}, "
                "and the positions do not follow these stamps; correct t, or mark "
                "recordings of different periods in a column segment."
            )


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


# -- stamps against a known period ----------------------------------------------------


def check_time_stamps(t, dt, parts):
    """Refuse stamps t (n,) [s] that contradict dt [s], warn of irregular ones."""
    # Nothing is asked of the step from one of the slices `parts` to the next; without t
    # nothing at all, without dt (rows need not be equidistant) only that the stamps
    # rise.
    if t is None:
        return
    time = np.asarray(t, dtype=float)
    n = parts[-1].stop
    if time.shape != (n,):
        raise ValueError(
            f"t must hold one time per row, shape ({n},); got {time.shape}."
        )
    if not np.isfinite(time).all():
        raise ValueError(
            f"t must be finite; row {np.flatnonzero(~np.isfinite(time))[0]} is not."
        )
    inside = np.ones(n - 1, dtype=bool)
    inside[[part.stop - 1 for part in parts[:-1]]] = False
    rows = np.flatnonzero(inside)
    step = np.diff(time)[rows]
    back = rows[step <= 0]
    if back.size:
        raise ValueError(
            f"t must rise within a recording; it does not after {_first(back)} "
            f"({time[back[0]]:.6g} s, then {time[back[0] + 1]:.6g} s). Drop repeated "
            "rows, or begin another recording there (groups)."
        )
    if dt is None:
        return
    dt = check_dt(dt)
    for part in parts:
        count = part.stop - part.start - 1
        took = time[part.stop - 1] - time[part.start]
        # One gap does not make another sample period.
        usual = np.median(np.diff(time[part])) if count else dt
        if abs(usual - dt) > _MISSING * dt or (
            abs(usual - dt) > _WRONG_PERIOD * dt
            and abs(took - count * dt) > max(_WRONG_PERIOD * count, 1.0) * dt
        ):
            raise ValueError(
                f"The time stamps of the recording from row {part.start} advance by "
                f"{took / count:.6g} s a row ({usual:.6g} s in the median), but "
                f"dt={dt:.6g} s. Correct dt, or resample onto equidistant times."
            )
    gap = rows[step > _MISSING * dt]
    if gap.size:
        raise ValueError(
            f"Samples are missing: the time stamps step by up to {step.max():.6g} s, "
            f"with dt={dt:.6g} s, {gap.size} times by more than {_MISSING} dt (after "
            f"{_first(gap)}). Resample onto equidistant times, or begin another "
            "recording after each gap (groups)."
        )
    off = np.abs(step / dt - 1)
    irregular = rows[off > _JITTER]
    if irregular.size:
        warnings.warn(
            f"{irregular.size} of {step.size} steps between time stamps differ from "
            f"dt={dt:.6g} s by more than {100 * _JITTER:.0f} %, at most by "
            f"{100 * off.max():.0f} % (after {_first(irregular)}); rows count as "
            "equidistant. "
            "Resample, unless only the stamps are irregular and not the sampling.",
            UserWarning,
            stacklevel=3,
        )


def _first(rows):
    """Name the first few of some rows."""
    return f"row {listed(rows)}"


# Fewer samples than this between two gaps cannot be differentiated and held out from.
_MIN_SAMPLES = 16
# Of the logs of measured sets: cannot be differentiated.
_MIN_LOG = 10
# A log is uniform already up to this part of dt: a steady clock with six decimals.
_UNIFORM_RTOL = 1e-3
# A step of a log above this many periods ends a part and starts another one.
_LOG_GAP_PERIODS = 10.0
# Relative difference between the periods of segments below which they count as one.
SAME_DT = 1e-3
# The lower quartile of the size of a normal variable, in standard deviations.
_QUARTILE = 0.3186


@dataclass(frozen=True)
class _Piece:
    """A part of a recording with its own time axis: name, stamps [s], channels."""

    name: str
    t: np.ndarray
    channels: Mapping[str, np.ndarray]


def _channels_of(one):
    """Return what a log or a recording has for every row, by name."""
    own = {"q": one.q, "tau": one.tau, **one.signals}
    return own if one.v is None else own | {"v": one.v}


def together(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return arrays end to end; a single one is not copied."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _fields(pieces: Sequence[_Piece], dt: float) -> dict:
    """Concatenate pieces into the array fields of a `Recording`."""
    columns = {
        key: together([piece.channels[key] for piece in pieces])
        for key in pieces[0].channels
    }
    return {
        "q": columns.pop("q"),
        "tau": columns.pop("tau"),
        "v": columns.pop("v", None),
        "t": together([piece.t for piece in pieces]),
        "dt": dt,
        "groups": labels_of([len(x.t) for x in pieces]),
        "group_names": tuple(piece.name for piece in pieces),
        "signals": columns,
    }


def _numbered(name: str, number: int, count: int) -> str:
    """Name the parts of a recording that was cut: "name [1]", "name [2]", ..."""
    return name if count == 1 else f"{name} [{number}]"


# -- interpolation ---------------------------------------------------------------------


def local_cubic(t: np.ndarray, rows: np.ndarray) -> Callable:
    """Cubics with the slopes of parabolas, which no far-off sample can disturb."""
    from scipy.interpolate import CubicHermiteSpline

    slope = np.gradient(rows, t, axis=0, edge_order=2)
    return CubicHermiteSpline(t, rows, slope, axis=0)


def interpolate(
    t: np.ndarray,
    channels: Mapping[str, np.ndarray],
    dt: float,
    cubic: Callable = local_cubic,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
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


def _repeats(channels: Mapping[str, np.ndarray], n: int) -> np.ndarray:
    """Whether each of n - 1 rows equals the one before it in every channel."""
    same = np.ones(n - 1, dtype=bool)
    for values in channels.values():
        rows = values.reshape(n, -1)
        same &= (rows[1:] == rows[:-1]).all(axis=1)
    return same


def merge_doubled(t, channels):
    """Average rows of one stamp: t (n,) [s] that does not fall, channels (n, ...)."""
    # Of commands the last one counts.
    starts = np.flatnonzero(np.r_[True, np.diff(t) > 0])
    if starts.size == t.size:
        return t, dict(channels)
    count = np.diff(starts, append=t.size)
    merged = {}
    for key, values in channels.items():
        if key in COMMANDS:
            merged[key] = values[starts + count - 1]
            continue
        sums = np.add.reduceat(values.astype(float), starts, axis=0)
        merged[key] = sums / count.reshape(-1, *[1] * (values.ndim - 1))
    return t[starts], merged


# -- logs of measured sets -------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Log:
    """One recording as read: stamps [s] and channels, first axis time."""

    name: str
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    v: np.ndarray | None = None
    signals: Mapping[str, np.ndarray] = field(default_factory=dict)


def median_period(logs: Iterable[Log]) -> float:
    """Median step between stamps over all logs [s], rounded to 0.1 us."""
    return round(float(np.median(np.concatenate([np.diff(x.t) for x in logs]))), 7)


def join(
    logs: Sequence[Log],
    *,
    dt: float,
    resample: bool = True,
    drop_repeated: bool = False,
) -> dict:
    """Concatenate logs into the array fields of a `Recording`."""
    # With `resample` each log is put on multiples of dt; one with long gaps becomes
    # several recordings, "name [1]", "name [2]", ...
    pieces = []
    for log in logs:
        channels = _channels_of(log)
        parts = [(log.t, channels)]
        if resample:
            parts = resample_uniform(
                log.t, channels, dt=dt, drop_repeated=drop_repeated
            )
        for number, (t, part) in enumerate(parts, start=1):
            pieces.append(_Piece(_numbered(log.name, number, len(parts)), t, part))
    return _fields(pieces, dt)


def resample_uniform(
    t: np.ndarray,
    channels: Mapping[str, np.ndarray],
    *,
    dt: float,
    drop_repeated: bool = False,
) -> list[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Return grid (n_part,) [s] and channels of a log's parts between long gaps."""
    # A log that is uniform already is left as it is; `drop_repeated` also drops rows
    # equal to the one before in every channel, readings that the logger wrote twice.
    step = np.diff(t)
    if np.any(step < 0):
        raise ValueError(
            "Time stamps must not decrease, they do after row "
            f"{np.flatnonzero(step < 0)[0]}; sort the rows or split the log there."
        )
    keep = np.r_[True, step > 0]
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
            from scipy.interpolate import CubicSpline

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


@dataclass
class _Tally:
    """What was left out, put in or joined, and what was measured before that."""

    short: int = 0
    single: int = 0
    merged: int = 0
    off_grid: list = field(default_factory=list)

    def notes(self):
        """Say it in words."""
        if self.short:
            yield Loss(
                f"{self.short} piece(s) of fewer than {_MIN_SAMPLES} samples between "
                "gaps are left out."
            )
        if self.single:
            yield f"{self.single} single sample(s) are missing and were interpolated."
        if self.merged:
            yield f"{self.merged} row(s) repeat a stamp and were averaged with it."

    def white_noise(self):
        """Return the standard deviation (nv,) of white noise off the grid."""
        # The lower quartile passes over what jumps, as friction does.
        errors = [prediction_errors(t, torques) for t, torques in self.off_grid]
        errors = np.abs(np.concatenate(errors))
        return np.quantile(errors, 0.25, axis=0) / _QUARTILE if errors.size else None


def in_order(table: Table, t, channels, notes):
    """Sort rows that are out of order in time, where that makes one smooth motion."""
    # Two recordings, one after the other, would be mixed: they stay as they are, to be
    # refused.
    back = int((np.diff(t) < 0).sum())
    if not back:
        return t, channels, table
    order = np.argsort(t, kind="stable")
    late = np.diff(t[order])
    if not late.all() or late.max() > GAP_PERIODS * np.median(late):
        return t, channels, table
    q, n = channels["q"], t.size
    rough = [np.abs(np.diff(x, n=2, axis=0)).sum() for x in (q, q[order])]
    # A motion that is reversed is as smooth.
    if not rough[1] < _SMOOTHER * rough[0]:
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
    segments = _segments(labels, table.n_rows)
    if t is None:
        pieces = [
            _Piece(name, dt * np.arange(rows.size), _rows_of(channels, rows))
            for name, rows in segments
        ]
        return _fields(pieces, dt)
    segments = _without_doubles(t, segments, channels, notes)
    stamps = _inspected(table, t, segments, dt, channels["q"])
    if dt is None:
        dt = _common_period(table, stamps)
    notes += _irregularities(table, stamps, segments, dt)
    pieces, tally = [], _Tally()
    for (name, rows), checked in zip(segments, stamps):
        parts = np.split(np.arange(rows.size), checked.gaps + 1)
        long = [x for x in parts if x.size >= min(_MIN_SAMPLES, rows.size)]
        tally.short += len(parts) - len(long)
        for number, part in enumerate(long, start=1):
            label = _numbered(name, number, len(long))
            values = _rows_of(channels, rows[part])
            grid, values = _put(t[rows[part]], values, checked, part, dt, tally)
            pieces.append(_Piece(label, grid, values))
    notes += tally.notes()
    if not pieces:
        raise ValueError(
            f"{table.path}: no {_MIN_SAMPLES} samples follow one another without a gap "
            f"of more than {GAP_PERIODS:g} periods of {dt:.4g} s; check column t."
        )
    fields = _fields(pieces, dt)
    if tally.off_grid:
        fields["torque_noise"] = tally.white_noise()
    return fields


def on_one_grid(recordings, names, dt):
    """Concatenate files whose periods are nearly dt [s], and name the others."""
    # names: of the recordings in them, one after the other. Returns the array fields of
    # a `Recording`, and the positions of the files that were interpolated.
    pieces, names, moved, noise = [], iter(names), [], []
    for k, one in enumerate(recordings):
        channels = _channels_of(one)
        tally = _Tally()
        for rows in one.segments:
            values = _rows_of(channels, rows)
            n = rows.stop - rows.start
            t = dt * np.arange(n)
            if abs(one.dt - dt) >= SAME_DT * dt:
                own = one.dt * np.arange(n)
                tally.off_grid.append((own, values["tau"]))
                t, values = interpolate(own, values, dt)
            pieces.append(_Piece(next(names), t, values))
        if tally.off_grid:
            moved.append(k)
        # That of the torques as they came, where they were interpolated before.
        own = one.torque_noise
        if own is None and tally.off_grid:
            own = tally.white_noise()
        if own is not None:
            noise.append((one.n_samples, own))
    fields = _fields(pieces, dt)
    if noise:
        share, power = zip(*((n, own**2) for n, own in noise))
        fields["torque_noise"] = np.sqrt(np.average(power, axis=0, weights=share))
    return fields, moved


def _rows_of(channels, rows):
    """Return rows of all channels; all of them as they are."""
    whole = isinstance(rows, np.ndarray) and rows.size == len(channels["q"])
    return channels if whole else {key: x[rows] for key, x in channels.items()}


def _put(t, values, checked, part, dt, tally):
    """Put rows `part` of a segment on the grid: as they are, if they lie on it."""
    if checked.sampled:
        at, values = merge_doubled(t, values)
        tally.merged += t.size - at.size
        at = at - at[0]
    else:
        slots = checked.slots[part]
        # Late stamps alone do not make another period.
        unsure = 3 * checked.jitter / checked.slots.size
        same = abs(checked.dt - dt) < max(SAME_DT * dt, unsure)
        at = (dt if same else checked.dt) * (slots - slots[0])
        missing = int(slots[-1] - slots[0]) + 1 - part.size
        tally.single += missing
        if same and at.size == round(at[-1] / dt) + 1:
            return dt * np.arange(at.size), values
    tally.off_grid.append((at, values["tau"]))
    return interpolate(at, values, dt)


def _segments(labels, n_rows):
    """Return (name, rows) of each run of equal labels, names made unique."""
    if labels is None:
        return [("recording", np.arange(n_rows))]
    borders = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    runs = np.split(np.arange(n_rows), borders)
    texts = []
    for label in labels[[rows[0] for rows in runs]]:
        is_whole = labels.dtype.kind == "f" and float(label).is_integer()
        texts.append(str(int(label) if is_whole else label))
    return list(zip(distinct(texts), runs))


def distinct(names):
    """Return names, repeated ones with a number."""
    found, seen = [], {}
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found


def _without_doubles(t, segments, channels, notes):
    """Leave out rows that repeat the one before in every channel and in time."""
    again = np.diff(t) == 0
    if again.any():
        again &= _repeats(channels, t.size)
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


def _irregularities(table, stamps, segments, dt):
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
            yield (
                f"time stamps are irregular (steps of {shortest:.4g} to {longest:.4g} "
                f"s, standard deviation {100 * jitter / dt:.2g} % of the period of "
                f"{dt:.4g} s): {said}."
            )
    count = sum(x.doubled for x in stamps if not x.sampled)
    if count:
        yield (
            f"{count} stamp(s) repeat the one before; the rows are taken as "
            "equidistant."
        )
    count = sum(x.gaps.size for x in stamps)
    if count:
        k = next(k for k, x in enumerate(stamps) if x.gaps.size)
        row = segments[k][1][stamps[k].gaps[0]]
        yield Loss(
            f"{count} gap(s) of more than {GAP_PERIODS:g} periods in time, the first "
            f"after {table.where(row)}: the recording is split there."
        )
