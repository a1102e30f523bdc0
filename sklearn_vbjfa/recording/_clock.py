"""Sample times: comparison of time stamps with a regular grid."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from sklearn_vbjfa.recording._layout import channel_unit, is_exact, refuse_ambiguous
from sklearn_vbjfa.recording._recording import check_dt, contiguous_groups
from sklearn_vbjfa.recording._table import (
    SLOWEST,
    TIME_UNITS,
    RecordingRefused,
    imported,
    listed,
    quoted,
    unit_of_steps,
    usual_step,
)

# Deviation from a regular grid that rounding explains, as a share of the period.
STEADY = 0.02
# A step longer than this many periods is a gap, across which nothing is interpolated.
GAP_PERIODS = 5.0
# Relative difference between the given `dt` and that of the stamps that is refused.
DT_TOLERANCE = 0.05
# Relative difference below which periods are equal.
SAME_DT = 1e-3
# Length of the moving average of time stamps [rows], largest deviation from it that
# determines the number of missing rows, and deviation of a varying period [periods].
_WINDOW, _SMALL, _LARGE = 64, 0.25, 0.5
# Without a period that fits the steps, more than this share of gaps is refused.
_MAX_GAPS = 0.02
# Sampling was irregular if stamps reduce the log squared prediction error of positions,
# summed over joints, by this.
_MIN_GAIN = 0.2


@dataclass(frozen=True, kw_only=True)
class TimeStamps:
    """Sample times of one recording, estimated from time stamps and positions."""

    dt: float  # sample period [s]
    # "" for regular stamps; "sampled" at irregular times, or regularly, stamped "late"
    irregular: str
    # sample index of each row between gaps, from 0; meaningless if "sampled"
    slots: np.ndarray
    steps: np.ndarray  # steps between stamps, without gaps [s]
    gaps: np.ndarray  # rows that precede a gap


def inspect_time_stamps(
    t, dt=None, where="row {}".format, positions=None, tolerance=DT_TOLERANCE
):
    """Analyse the stamps t (n_samples,) [s] of one recording, return `TimeStamps`."""
    # dt: known period [s], up to a relative tolerance; where: names a row (from 0) in
    # messages; positions (n_samples, nv): decide whether sampling was irregular.
    t = np.asarray(t, dtype=float)
    if t.ndim != 1 or t.size < 2:
        raise ValueError(f"t must hold two time stamps or more, got shape {t.shape}.")
    if positions is not None and rows_alternate(positions):
        raise ValueError("rows of several robots in turn; write one file for each.")
    _check_increasing(t, where)
    step = np.diff(t)
    period, counts = _estimate_period(step)
    is_gap = step > GAP_PERIODS * period
    pieces = contiguous_groups(np.r_[0, np.cumsum(is_gap)], t.size)
    slots = np.r_[0, np.cumsum(counts)]
    for piece in pieces:
        slots[piece] -= slots[piece.start]
    mean_dt = float(step[~is_gap].sum() / counts[~is_gap].sum())
    irregular, grid = "", mean_dt * slots
    if max(np.ptp((t - grid)[x]) for x in pieces) > 2 * STEADY * mean_dt:
        irregular = _classify_jitter(t, grid, pieces, positions, mean_dt)
    if dt is not None and abs(mean_dt - dt) > tolerance * dt:
        raise ValueError(
            f"time steps by {mean_dt:.6g} s but dt = {dt:.6g} s; correct one of them, "
            "or leave out dt (a period in s, not in ms or Hz)."
        )
    return TimeStamps(
        dt=float(f"{mean_dt:.7g}") if dt is None else float(dt),
        irregular=irregular,
        slots=slots,
        steps=step[~is_gap],
        gaps=np.flatnonzero(is_gap),
    )


def _check_increasing(t, where):
    step = np.diff(t)
    for invalid, text in ((step < 0, "runs backwards to"), (step == 0, "repeats")):
        if invalid.any():
            row = int(np.argmax(invalid)) + 1
            raise ValueError(
                f"time {text} {t[row]:.9g} s in {where(row)} ({invalid.sum()} of "
                f"{t.size} rows): sort the rows, write more digits, mark recordings in "
                "a column segment, or leave the stamps out and give dt."
            )


def _estimate_period(step):
    """Return the period of steps [s], and the number of periods in each step."""
    ones, median = np.ones(step.size, dtype=int), float(np.median(step))
    scatter = _scatter(step, median, ones)
    # If rows of a second source were removed, two step sizes may be equally frequent.
    for share in (0.5, 0.25):
        period = float(np.quantile(step, share, method="lower"))
        counts = np.maximum(np.rint(step / period).astype(int), 1)
        if _scatter(step, period, counts) < min(_SMALL, scatter):
            return period, counts
    # The number of missing rows cannot be determined.
    if scatter > _SMALL and np.mean(step > GAP_PERIODS * median) > _MAX_GAPS:
        raise ValueError(
            f"time steps by {step.min():.4g} to {step.max():.4g} s, without a period; "
            "correct t, or leave it out and give dt if rows are equidistant."
        )
    return median, ones


def _scatter(step, period, counts):
    """Return the standard deviation of stamps from their moving average [periods]."""
    is_gap = step > GAP_PERIODS * period
    period_mean = step[~is_gap].sum() / counts[~is_gap].sum()
    deviation = np.cumsum(np.where(is_gap, 0.0, step - period_mean * counts))
    return np.std(deviation - uniform_filter1d(deviation, _WINDOW)) / period_mean


def _classify_jitter(t, grid, pieces, positions, period):
    """Return "sampled" for samples taken at the stamps, "late" for delayed stamps."""
    if positions is not None:
        # Positions are smoother as a function of the true sample times.
        stamp_error, grid_error = (
            sum(
                (prediction_errors(x[y], positions[y]) ** 2).sum(axis=0) for y in pieces
            )
            for x in (t, grid)
        )
        moves = (np.ptp(positions, axis=0) > 0) & (stamp_error > 0) & (grid_error > 0)
        if np.log(stamp_error[moves] / grid_error[moves]).sum() < -_MIN_GAIN:
            return "sampled"
    for piece in pieces:
        lag = t[piece] - grid[piece]
        # A cubic trend allows for clock drift.
        trend = np.polynomial.Polynomial.fit(grid[piece], lag, min(3, lag.size - 1))
        wander = np.std(uniform_filter1d(lag - trend(grid[piece]), _WINDOW))
        if wander > _LARGE * period:
            raise ValueError(
                f"time wanders by {wander:.4g} s about steps of {period:.4g} s, and "
                "positions do not follow it: rows are missing, or the period changes. "
                "Correct t, mark periods in a column segment, or give dt in its place."
            )
    return "late"


def prediction_errors(t, values):
    """Return errors (m, k) of cubic interpolation of values (n, k) from neighbours."""
    # Divided by their standard deviation for unit white noise. t (n,) [s] increases.
    n = t.size - 4
    if n < 1:
        return np.empty((0, values.shape[1]))
    neighbours = [slice(k, k + n) for k in (0, 1, 3, 4)]
    offsets = [t[x] - t[2:-2] for x in neighbours]
    predicted, gain = 0.0, 1.0
    for i, rows in enumerate(neighbours):
        others = offsets[:i] + offsets[i + 1 :]
        weight = np.prod([x / (x - offsets[i]) for x in others], axis=0)
        predicted = predicted + weight[:, None] * values[rows]
        gain = gain + weight**2
    return (values[2:-2] - predicted) / np.sqrt(gain)[:, None]


# Rows alternate if the mean squared step is this many times that over two or three rows
# on all joints with this standard deviation [rad or m]; fewest rows of the test.
_ALTERNATING, _LEAST_MOTION, _ENOUGH = 2.0, 0.01, 16


def rows_alternate(q):
    """Whether rows (n, nv) of several robots alternate: each follows an earlier one."""
    moving = [x for x in q.T if x.size >= _ENOUGH and x.std() > _LEAST_MOTION]
    sizes = [[np.square(x[k:] - x[:-k]).mean() for x in moving] for k in (1, 2, 3)]
    step, *others = np.array(sizes)
    return bool(moving) and any((step > _ALTERNATING * x).all() for x in others)


# Samples of a window over which a slower source is regular, share of such windows,
# difference from whole rows, and least factor of its typical over its smallest step.
_SAMPLES, _REGULAR, _BEAT, _STEP = 32, 0.9, 0.05, 4.0


def rows_per_sample(t, q):
    """Return the rows (n, m) per sample of a slower regular source; 1 without one."""
    # t (n,): times of the rows; q: channels of the source, which is ahead of them.
    size, step = np.abs(np.diff(q, axis=0)), np.diff(t)
    new = np.r_[0, 1 + np.flatnonzero((size > 0).any(axis=1))]
    if not 3 * _SAMPLES < new.size < t.size or step.min() <= 0:
        return 1.0
    first, last = new[:-_SAMPLES], new[_SAMPLES:]
    travel = np.abs(q[last] - q[first]).max(axis=1)
    # At rest, samples may be equal.
    span = (t[last] - t[first])[travel >= np.median(travel)] / np.median(step)
    rows, size = span.mean() / _SAMPLES, np.ma.masked_equal(size, 0)
    regular = np.abs(span - _SAMPLES * rows) <= 1 + STEADY
    fine = (np.ma.median(size, axis=0) > _STEP * size.min(axis=0)).any()
    known = fine and rows > 1 + _BEAT and regular.mean() >= _REGULAR
    return float(rows if abs(rows - np.rint(rows)) > _BEAT else np.rint(rows)) ** known


def source_samples(t, q):
    """Find the samples of a regular source in rows (n, nv) that repeat some of them."""
    # Returns the first row and the time of each sample, and the period, or None.
    rate = rows_per_sample(t, q)
    if not rate % 1:
        return None
    row = np.median(np.diff(t))
    new = np.r_[0, 1 + np.flatnonzero((np.diff(q, axis=0) != 0).any(axis=1))]
    # If positions stay equal, rows are taken at the same rate.
    number = np.ceil((np.diff(t[new], append=t[-1]) / row - 1) / rate - STEADY)
    number = np.maximum(number, 1).astype(int)
    offset = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
    times = np.repeat(t[new], number) + (rate * offset - STEADY) * row
    rows, index = np.unique(np.searchsorted(t, times), return_index=True)
    period = np.polyfit(index, t[rows], 1)[0]
    return rows, t[0] + period * index, period


# Largest bend of a straight line as a share of the median bend of the channel, and log
# odds against chance of rows that lie on one in all channels.
_STRAIGHT, _NO_CHANCE = 0.1, 25.0


def filled_gaps(q, tau):
    """List first and last rows of gaps that were filled by straight lines."""
    # q, tau (n, nv): all channels of a recording.
    inside, odds, least = np.ones(len(q), dtype=bool), 0.0, []
    inside[[0, -1]] = False
    for x in (*q.T, *tau.T):
        step = np.diff(x, prepend=x[0])
        bend = np.diff(step, append=0.0)
        # Rounding bends a line by up to twice the resolution.
        resolution = np.abs(step[step != 0]).min(initial=np.inf)
        least.append(max(_STRAIGHT * np.median(np.abs(bend)), 2 * resolution))
        straight = np.abs(bend) <= least[-1]
        inside &= straight
        # Bends of noise alternate; those of a smooth or coarse channel prove nothing.
        if least[-1] > 2 * resolution and (bend[1:] * bend[:-1] < 0).mean() > 0.5:
            odds -= np.log(max(straight.mean(), 1e-300))
    # Measured rows before and after each run.
    ends = np.flatnonzero(np.diff(inside)).reshape(-1, 2) + [0, 1]
    size = ends[:, 1] - ends[:, 0]
    ends = ends[(size > GAP_PERIODS) & (odds * size > _NO_CHANCE)]
    travel = [np.abs(x[ends[:, 1]] - x[ends[:, 0]]) for x in (q, tau)]
    moves = (np.hstack(travel) > least).reshape(*ends.shape, q.shape[1]).any(axis=2)
    return (ends[moves.all(axis=1)] + [1, -1]).tolist()


# Relative error of the period that is refused, but at least one row per recording:
# accelerations change with its square. The second is a relative tolerance of steps.
_PERIOD_TOLERANCE, _STEP_TOLERANCE = 0.002, 0.1


def check_time_stamps(t, dt, parts):
    """Refuse stamps t (n,) [s] that contradict dt [s], warn of irregular ones."""
    # parts: slices, each checked for itself. Without dt, stamps only have to increase.
    for part in parts if t is not None else ():
        part_t, first = np.asarray(t[part], dtype=float), part.start
        _check_increasing(part_t, lambda k, first=first: f"row {first + k}")
        if dt is None or part_t.size < 2:
            continue
        tolerance = max(_PERIOD_TOLERANCE, 1 / part_t.size)
        stamps = inspect_time_stamps(part_t, check_dt(dt), tolerance=tolerance)
        missing = first + np.flatnonzero(np.diff(stamps.slots) != 1)
        if missing.size:
            raise ValueError(
                f"t lacks samples after row {listed(missing)}: steps are at most "
                f"{np.diff(part_t).max():.6g} s, but dt={dt:.6g} s. Resample, or begin "
                "another recording after each gap (groups)."
            )
        if np.abs(stamps.steps / dt - 1).max() > _STEP_TOLERANCE:
            warnings.warn(
                f"steps between time stamps from row {first} on vary from "
                f"{stamps.steps.min():.6g} to {stamps.steps.max():.6g} s, dt={dt:.6g} "
                "s; rows count as equidistant. Resample, unless only the stamps are "
                "irregular.",
                UserWarning,
                stacklevel=3,
            )


# Maximum share of rows with missing values that are dropped.
_MAX_HOLES = 0.1
# Least share and number of runs of zero-torque rows of a second source, and their
# largest median length.
_MIN_SHARE, _MIN_RUNS, _MAX_RUN = 0.02, 10, 3
# Fill values are not zero, occur at least this often, differ from all others by this
# many of their ranges, and the others have more distinct values than the last number.
_COUNT, _SPANS, _MIN_LEVELS = 3, 3.0, 16


def remove_odd_rows(table, layout, options, notes):
    """Remove rows without numbers and rows of a second source.

    Returns the table and the sample indices of its rows on a regular clock.
    """
    q, tau = layout.select("q"), layout.select("tau") if options.drive is None else ()
    columns, n = [x.column for x in (*q, *tau, *layout.select("v", "a"))], len(q + tau)
    frame, all_rows = table.frame[columns], np.arange(len(table.frame))
    if not columns or any(x.kind not in "iuf" for x in frame.dtypes):
        return table, all_rows
    values = frame.to_numpy(float, copy=True)
    fillers = [
        f"{filler:g} in column {column!r}"
        for column, x in zip(columns, values.T)
        for filler in _replace_fillers(x)
    ]
    holes = np.isnan(values)
    empty = holes[:, :n].all(axis=1)
    incomplete = holes.any(axis=1) & ~empty
    few = incomplete.sum() <= _MAX_HOLES * (~empty).sum()
    # Rows of other topics contain neither positions nor torques.
    dropped = empty | incomplete if few else empty
    if empty.all():
        return table, all_rows
    if dropped.any():
        row = int(np.argmax(dropped))
        notes.append(
            f"{dropped.sum()} row(s) lack a number, the first in {table.where(row)}, "
            f"column {columns[int(np.argmax(holes[row]))]!r}: left out."
        )
    if fillers:
        text = f"{listed(fillers)} is far from all other values, as where nothing was "
        if not few:
            raise ValueError(
                f"{table.path}: {text}measured ({incomplete.sum()} rows); remove these "
                "rows, or write nan."
            )
        notes.append(f"{text}measured: taken as missing.")
    rows = np.flatnonzero(~dropped)
    second = _second_source_rows(values[rows, : len(q)], values[rows, len(q) : n])
    if second.any():
        notes.append(
            f"{second.sum()} row(s) ({100 * second.mean():.0f} %) in which all torques "
            "are exactly zero while joints move are left out: a second source writes "
            "to the same log."
        )
        rows = rows[~second]
    if rows.size == len(table.frame):
        return table, all_rows
    # Removed rows of other topics or of a second source are not missing samples.
    lost = not second.any() and rows.size >= (1 - _MAX_HOLES) * len(table.frame)
    table = replace(table, frame=table.frame.iloc[rows])
    return table, rows if lost else all_rows[: rows.size]


def _replace_fillers(x):
    """Replace fill values of missing data in a column by nan, and yield them."""
    finite = x[~np.isnan(x)]
    ends = finite.min(initial=np.inf), finite.max(initial=-np.inf)
    others = finite[(finite > ends[0]) & (finite < ends[1])]
    if others.size <= _MIN_LEVELS:
        return
    low, high = others.min(), others.max()
    for level in ends:
        gap = max(low - level, level - high)
        if not level or gap <= _SPANS * (high - low) or (x == level).sum() < _COUNT:
            continue
        # np.unique is slow for long channels and therefore comes last.
        if np.unique(others).size > _MIN_LEVELS:
            x[x == level] = np.nan
            yield level


def _second_source_rows(q, tau):
    """Return a mask of isolated rows with all torques zero while joints move."""
    zero = (tau == 0).all(axis=1)
    no_rows = np.zeros(zero.size, dtype=bool)
    if not tau.size or zero.mean() <= _MIN_SHARE:
        return no_rows
    runs = contiguous_groups(zero, zero.size)[1:-1]
    ends = np.array([(x.start, x.stop) for x in runs if zero[x.start]])
    if len(ends) < _MIN_RUNS or np.median(np.ptp(ends, axis=1)) > _MAX_RUN:
        return no_rows
    moves = (q[ends[:, 1]] != q[ends[:, 0] - 1]).any(axis=1)
    return zero if moves.mean() >= 0.5 else no_rows


_DAY = 86400 * 10**9  # [ns]
# Rows are static poses if the mean squared step exceeds this share of the variance.
_MIN_POSE_STEP = 0.1


def read_time(table, layout, options, q):
    """Return time stamps (n_rows,) [s] and the role of their column, or None twice."""
    roles = layout.select("t")
    exact = any(is_exact(x) for x in roles)
    if options.dt is not None and not (layout.certain or exact):
        # The period is given; other columns named like time are not trusted.
        return None, None
    if len(roles) > 1 and not layout.what:
        if exact:
            refuse_ambiguous(table, roles[0].column, roles[1].column)
        raise RecordingRefused(
            f"{table.path}: columns {listed([x.column for x in roles])} could all be "
            f"time; give columns='t={roles[0].column}', or another of them.",
            {"columns": f"t={roles[0].column}"},
        )
    for role in roles:
        t = _read_stamps(table, role, options, q)
        # Known logs may contain a column of constant time stamps.
        if np.ptp(t) > 0 or role is roles[-1]:
            return t, role
    return None, None


def _read_stamps(table, role, options, q):
    """Return the time stamps of a column [s]."""
    dates = nanoseconds(table, role.column)
    if dates is not None:
        return 1e-9 * (dates - dates[0])
    values, unit = table.values(role.column), channel_unit(table, role)
    if values.dtype.kind == "O":
        raise ValueError(
            f"{table.path}: column {role.column!r} holds {quoted(str(values[0]))}; "
            "expected seconds, dates (2024-03-30T23:59:50.125) or times of day "
            "(23:59:50.125)."
        )
    seconds = table.numbers(role.column)
    factor = TIME_UNITS.get(options.time_unit, 1.0 if unit is None else unit.factor)
    step = usual_step(seconds)
    name = options.time_unit or role.unit
    # A column that increases by one counts rows.
    if options.dt is not None and step == 1.0 and not name:
        return options.dt * seconds
    period, likely, name = factor * step, unit_of_steps(step), name or "s"
    size = q.var(axis=0).mean()
    if period > SLOWEST and (np.diff(q, axis=0) ** 2).mean() > _MIN_POSE_STEP * size:
        # Static poses: the time between them has no effect.
        return (options.dt or period) * np.arange(len(q))
    plausible = step in (0.0, 1.0) or unit_of_steps(period) == "s"
    # Stamps with too few digits repeat, and their steps are not the period.
    plausible |= 2 * (np.diff(seconds) == 0).sum() > seconds.size
    if not plausible and likely not in ("", name):
        raise RecordingRefused(
            f"{table.path}: time steps by {period:.4g} s at the median, too "
            f"{'slow for a motion' if period > 1 else 'fast for a robot'}; column "
            f"{role.column!r} cannot be in {name}, in {likely} this would be a period "
            f"of {step * TIME_UNITS[likely]:.4g} s.",
            {"time_unit": likely},
        )
    # Stamps in seconds keep their origin, so that messages quote them as in the file.
    return seconds if factor == 1.0 else factor * (seconds - seconds[0])


def nanoseconds(table, column):
    """Return dates or times of day as integers [ns], None for other columns."""
    pandas, values = imported(table.path, "pandas"), table.frame[column]
    if values.dtype.kind != "M":
        if values.dtype.kind in "biuf" or not isinstance(values.iloc[0], str):
            return None
        text = values.astype(str).str.replace(",", ".")
        if text.str.fullmatch(r"\d{1,2}:\d\d:\d\d(\.\d*)?").all():
            t = pandas.to_timedelta(text).to_numpy().astype("m8[ns]").astype("int64")
            return t + _DAY * np.cumsum(np.diff(t, prepend=t[0]) < -_DAY // 2)
        values = pandas.to_datetime(text, format="ISO8601", utc=True, errors="coerce")
    if values.isna().any():
        return None
    return values.dt.as_unit("ns").astype("int64").to_numpy()
