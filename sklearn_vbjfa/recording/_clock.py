"""Sample times of a recording: period, missing rows and gaps, from its time stamps."""

import warnings
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.recording._recording import check_dt, check_rows_of_time
from sklearn_vbjfa.recording._table import listed

# Stamps within this share of a period of equidistant times are a steady clock that was
# written with few digits: the samples are taken as they are.
STEADY = 0.02
# A step longer than this many periods is a gap, not bridged by interpolation.
GAP_PERIODS = 5.0
# Relative difference that is refused between `dt` as given and as stamped.
DT_TOLERANCE = 0.05
# A slower clock [s] records no motion: stamps in ms or ns come out like that.
_SLOWEST = 1.0
# Steps this near to whole periods, nine in ten of them, show how many rows are missing.
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


@dataclass(frozen=True, kw_only=True)
class TimeStamps:
    """Sample times of one recording, as its stamps and positions show them."""

    dt: float  # sample period [s]
    sampled: bool  # True if the stamps are the times of sampling, False if it is steady
    late: bool  # True if stamps are irregular although the sampling was steady
    # period in which each row was sampled, from 0 on in each piece between gaps;
    # without meaning if `sampled`
    slots: np.ndarray
    steps: np.ndarray  # between stamps, gaps left out [s]
    gaps: np.ndarray  # rows after which more than five periods are missing

    @property
    def jitter(self):
        """Standard deviation of the steps from the period [s]."""
        return float(np.sqrt(np.mean((self.steps - self.dt) ** 2)))


def inspect_time_stamps(
    t, dt=None, where="row {}".format, positions=None, tolerance=DT_TOLERANCE
):
    """Return the `TimeStamps` of one recording with the stamps t (n_samples,) [s]."""
    # dt [s] is the period if it is known, up to a tolerance; `where` names a row (from
    # 0) in messages; positions (n_samples, nv) show whether irregular stamps are the
    # times of sampling, without them a steady sampling is assumed.
    t = np.asarray(t, dtype=float)
    if t.ndim != 1 or t.size < 2:
        raise ValueError(f"t must hold two time stamps or more, got shape {t.shape}.")
    step = np.diff(t)
    _check_rise(t, step, where)
    period, whole = _first_period(t, step)
    if dt is None and period >= _SLOWEST:
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
        found, slots, sampled = _irregular(t, pieces, period, whole, positions)
        if not sampled:
            _check_period(t, pieces, slots, found, where)
    check_given(found, dt, tolerance=tolerance)
    off = [np.ptp(t[x] - found * slots[x]) for x in pieces]
    return TimeStamps(
        dt=float(f"{found:.7g}") if dt is None else float(dt),
        sampled=sampled,
        late=not steady and not sampled and max(off) > 2 * STEADY * found,
        slots=slots,
        steps=np.delete(step, gaps),
        gaps=gaps,
    )


def _check_rise(t, step, where):
    """Refuse time that runs backwards or stands still."""
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


def check_given(found, dt, what="time steps by", tolerance=DT_TOLERANCE):
    """Refuse a period found in a file that contradicts the one that was given."""
    if dt is not None and abs(found - dt) > tolerance * dt:
        raise ValueError(
            f"{what} {found:.6g} s but dt = {dt:.6g} s; correct one of them, or leave "
            "out dt (a period in s, not in ms or Hz)."
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


def _steady(t, step, pieces, period, rounded):
    """Return whether stamps are equidistant but for rounding, and their period [s]."""
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


def _counted(pieces):
    """Count the rows of each piece from 0."""
    return np.concatenate([np.arange(x.stop - x.start) for x in pieces])


# -- irregular stamps ------------------------------------------------------------------


def _irregular(t, pieces, period, whole, positions):
    """Return the period [s], slots, and whether the stamps are the times of sampling.

    Three hypotheses are compared by the roughness of the positions: the rows are
    equidistant, some rows are missing, or the robot was sampled at the stamps. `whole`
    tells whether the steps show how many rows are missing.
    """
    followed = np.concatenate([_slots_of_piece(t[x], period, whole) for x in pieces])
    candidates = [_counted(pieces), followed]
    if whole:
        candidates.reverse()
    took = sum(t[x.stop - 1] - t[x.start] for x in pieces)
    periods = [took / sum(one[x.stop - 1] for x in pieces) for one in candidates]
    best = 0
    if positions is not None:
        times = [dt * slots for dt, slots in zip(periods, candidates)]
        rough = _roughness([*times, t], pieces, positions)
        best = int(rough[1] < rough[0] - _CLEARLY)
        if rough[-1] < rough[best] - _CLEARLY:
            return periods[0], candidates[0], True
    return periods[best], candidates[best], False


def _slots_of_piece(t, period, whole):
    """Return the periods in which rows without a gap were sampled."""
    slots = np.arange(t.size)
    for _ in range(2):
        slots = _followed_slots(t, period, whole)
        took = t[-1] - t[0]
        period = took / slots[-1] if slots[-1] and took > 0 else period
    return slots


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


def _check_period(t, pieces, slots, dt, where):
    """Refuse rows whose period changes within the recording."""
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


def _roughness(times, pieces, positions):
    """Return the sums over the joints of the log squared prediction errors."""
    # One sum for each of `times` of the rows (n,); zeros if no joint moves.
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
    at = np.stack([t[2 + k : 2 + k + n] for k in near]) - t[2:-2]
    good = (at[0] < at[1]) & (at[1] < 0) & (at[2] > 0) & (at[3] > at[2])
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


# -- stamps of arrays ------------------------------------------------------------------

# Accelerations go with the square of a wrong period: this share of it, and no less than
# a row over a recording, is refused. Steps are irregular beyond the second share.
_WRONG_PERIOD, _JITTER = 0.002, 0.1


def check_time_stamps(t, dt, parts):
    """Refuse stamps t (n,) [s] that contradict dt [s], warn of irregular ones."""
    # Nothing is asked of the step from one of the slices `parts` to the next; without
    # dt (rows need not be equidistant) only that the stamps rise.
    if t is None:
        return
    time = check_rows_of_time(t, parts[-1].stop)
    for part in parts:
        stamps, first = time[part], part.start
        back = first + np.flatnonzero(np.diff(stamps) <= 0)
        if back.size:
            a, b = time[back[0] : back[0] + 2]
            raise ValueError(
                f"t must rise within a recording; it does not after row {listed(back)} "
                f"({a:.6g} s, then {b:.6g} s). Drop repeated rows, or begin another "
                "recording there (groups)."
            )
        if dt is None or stamps.size < 2:
            continue
        tolerance = max(_WRONG_PERIOD, 1 / stamps.size)
        found = inspect_time_stamps(stamps, check_dt(dt), tolerance=tolerance)
        missing = first + np.flatnonzero(np.diff(found.slots) != 1)
        if missing.size:
            raise ValueError(
                f"t lacks samples after row {listed(missing)}: steps are at most "
                f"{np.diff(stamps).max():.6g} s, but dt={dt:.6g} s. Resample, or begin "
                "another recording after each gap (groups)."
            )
        odd = first + np.flatnonzero(np.abs(found.steps / dt - 1) > _JITTER)
        if odd.size:
            warnings.warn(
                f"{odd.size} of {found.steps.size} steps between time stamps differ "
                f"from dt={dt:.6g} s by more than {100 * _JITTER:.0f} % (after row "
                f"{listed(odd)}); rows count as equidistant. Resample, unless only the "
                "stamps are irregular.",
                UserWarning,
                stacklevel=3,
            )
