"""Curves for the pictures of a finished search, thinned."""

import itertools
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.effects import RotorInertia

# Most points of a cloud, of a curve over time, and of all of them together on a page.
_CLOUD, _CURVE, _TOGETHER = 1500, 2000, 20_000
# Bins that may be needed to follow a law, the fewest first, and rows in one to count.
_BINS, _FEWEST = (24, 48, 96, 192), 8
# Share of the law's variance that may be lost between the bins.
_LOST = 0.05
# Quantiles at the ends of a signal: beyond them the bins would be empty.
_ENDS = (0.001, 0.999)
# Rows that are farther apart than this many usual steps have something between them.
_GAP = 2.5
# Most points of a friction or residual curve, and rows of an autocorrelation.
_DOTS, _LAGS = 400, 40
# Signals of a joint by their kind, and units of kinds on joints that turn and slide.
_OF_STATE = {"position": "q", "speed": "v", "acceleration": "a", "load": "load"}
_UNITS = {
    "position": ("rad", "m"),
    "speed": ("rad/s", "m/s"),
    "acceleration": ("rad/s^2", "m/s^2"),
    "load": ("N m", "N"),
    "": ("N m", "N"),
    "time": ("s", "s"),
    "signal": ("", ""),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectCurves:
    """Torques of a joint without and with an effect, over the effect's signal."""

    joint: int  # whose torque is shown, from zero
    kind: str  # what is on the horizontal axis, as in `Effect.seen_over`
    signal: str  # name of the recorded one; empty for others
    unit: str  # of the horizontal axis; empty where it is not known
    with_motion: bool  # whether torques count in the direction of the motion
    # (k,): points of a cloud, x rising: residuals of the completed model without and
    # with the effect, and its torque [N m or N]
    x: np.ndarray
    without: np.ndarray
    after: np.ndarray
    law: np.ndarray
    center: np.ndarray  # (n_bins,): middle of the bins that hold enough rows
    # (2, n_bins): weighted mean and deviation there, without and with the effect
    mean: np.ndarray
    deviation: np.ndarray
    law_mean: np.ndarray  # (n_bins,): mean of the effect's torque


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionCurves:
    """Friction of a joint over its speed, of both models: it is the effect there."""

    joint: int  # from zero
    before: EffectCurves | None
    after: EffectCurves


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualCurves:
    """Residual of a joint on the held-out part, over its torque and its own past."""

    joint: int  # from zero
    # (k,): torque predicted by the completed model, and the residual [N m or N]
    predicted: np.ndarray
    residual: np.ndarray
    lags: np.ndarray  # (l,): [s], or rows
    correlation: np.ndarray  # (l,): autocorrelation
    chance: float  # that of white noise, with a probability of 90 %


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueCurves:
    """Measured and predicted torque, or position, of a joint over time."""

    joint: int  # from zero
    seconds: np.ndarray  # (k,): or numbers of rows
    # (k,): filtered; predicted by the declared and by the completed model, both fitted
    # to the search part [N m or N; rad or m]; nan where rows are missing
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    counts: np.ndarray  # (k,): whether the joint moves, so that errors count there


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeLine:
    """The recording from its beginning to its end."""

    torques: tuple  # of each joint
    borders: tuple  # where recordings after the first begin [s]
    held_out: tuple  # stretches that the search did not look at [s]
    in_seconds: bool  # whether times are known; else they count rows


def cloud_size(count):
    """Most points of a cloud, of which there are `count`."""
    return min(_CLOUD, _TOGETHER // max(count, 1))


def curve_size(count):
    """Most points of a curve over time, of which there are `count`."""
    return min(_CURVE, _TOGETHER // max(count, 1))


def _evenly(rows, most):
    """At most so many of some rows, evenly."""
    return rows[np.linspace(0, rows.size - 1, min(rows.size, most)).astype(int)]


# -- effects and friction --------------------------------------------------------------


def effect_curves(final):
    """Curves of each effect that a final fit has, a tuple of EffectCurves or None."""
    # None where there are too few rows to draw.
    torques, after = final.effect_torques(), final.residuals()[1]
    return tuple(
        _of_effect(final, effect, own, after, cloud_size(len(torques)))
        for effect, own in zip(final.effects, torques)
    )


def _of_effect(final, effect, own, after, most):
    """Curves of one effect with its torque (m, nv)."""
    view, motion = final.view, final.motion
    residual, weight, joint = after.residual, after.weight, effect.joint
    if effect.scope == "robot":
        # Where it is largest relative to the residual.
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (weight * own**2).sum(axis=0) / (weight * residual**2).sum(axis=0)
        joint = int(np.argmax(np.where(np.isfinite(share), share, 0.0)))
    kind = effect.seen_over
    if kind in _OF_STATE:
        x = view.filtered(getattr(motion, _OF_STATE[kind])[:, [joint]])[:, 0]
    elif kind == "time":
        x = view.clock[view.index]
    elif kind == "signal":
        x = view.filtered(motion.signals[effect.recorded[0]][:, None])[:, 0]
    else:
        x = own[:, joint]
    used = (weight[:, joint] > 0) & np.isfinite(x)
    way = np.ones(x.size)
    if effect.with_motion:
        way = np.sign(view.filtered(motion.v[:, [joint]])[:, 0])
    law, with_it = (way * values[:, joint] for values in (own, residual))
    return curves_over(
        x[used],
        with_it[used],
        law[used],
        weight[used, joint],
        joint=joint,
        kind=kind,
        signal=effect.recorded[0] if kind == "signal" else "",
        unit=_UNITS[kind][int(motion.prismatic[joint])],
        with_motion=bool(effect.with_motion),
        most=most,
    )


def curves_over(x, after, law, weight, *, most=_CLOUD, **named):
    """Curves of an effect from rows (m,); None of too few."""
    if x.size < _BINS[0] or not np.ptp(x) > 0:
        return None
    low, high = np.quantile(x, _ENDS)
    if not high > low:
        low, high = x.min(), x.max()
    label, n = _bins(x, law, weight, low, high)
    kept = np.bincount(label, minlength=n) >= _FEWEST
    if not kept.any():
        return None
    edges, without = np.linspace(low, high, n + 1), after + law

    def mean(values):
        return _bin_means(label, weight, values, n)[kept]

    means = np.array([mean(without), mean(after)])
    squares = np.array([mean(without**2), mean(after**2)])
    rows = _evenly(np.argsort(x, kind="stable"), most)
    return EffectCurves(
        x=x[rows],
        without=without[rows],
        after=after[rows],
        law=law[rows],
        center=(0.5 * (edges[1:] + edges[:-1]))[kept],
        mean=means,
        deviation=np.sqrt(np.maximum(squares - means**2, 0.0)),
        law_mean=mean(law),
        **named,
    )


def _bin_means(label, weight, values, n):
    """Weighted means of values in n bins; zero in an empty one."""
    total = np.bincount(label, weight, n)
    sums = np.bincount(label, weight * values, n)
    return sums / np.where(total > 0, total, 1.0)


def _bins(x, law, weight, low, high):
    """Bin of each row, and how many there are: no more than the law needs."""
    labels, lost = [], []
    for n in _BINS:
        label = np.clip((n * (x - low) / (high - low)).astype(int), 0, n - 1)
        inside = law - _bin_means(label, weight, law, n)[label]
        labels.append(label)
        lost.append((weight * inside**2).sum())
    # What even the finest bins lose is no function of the signal.
    spare = _LOST * (weight * (law - np.average(law, weights=weight)) ** 2).sum()
    k = next(k for k, left in enumerate(lost) if left <= lost[-1] + spare)
    return labels[k], _BINS[k]


def friction_curves(declared, final):
    """Friction curves of each joint that moves, a tuple of FrictionCurves."""
    view, motion, after = final.view, final.motion, final.residuals()[1]
    given = dict(zip(declared.parameter_names_, declared.theta_))
    names, theta = final.identifier.parameter_names_, final.identifier.theta_
    before = np.array([given.get(name, 0.0) for name in names])
    torques = zip(final.effects, final.effect_torques())
    own = [torque for effect, torque in torques if is_friction(effect)]
    most, found = min(_DOTS, cloud_size(after.weight.shape[1])), []
    for j, columns in enumerate(friction_columns(final.declared)):
        Phi = view.equations.Phi[:, j, columns]
        laws = [Phi @ theta[columns] + sum(torque[:, j] for torque in own)]
        laws.append(Phi @ before[columns])
        x = view.filtered(motion.v[:, [j]])[:, 0]
        used = (after.weight[:, j] > 0) & np.isfinite(x)
        completed, simple = (
            curves_over(
                x[used],
                after.residual[used, j],
                law[used],
                after.weight[used, j],
                joint=j,
                kind="speed",
                signal="",
                unit=_UNITS["speed"][int(motion.prismatic[j])],
                with_motion=False,
                most=most,
            )
            for law in laws
        )
        if completed is not None:
            found.append(FrictionCurves(joint=j, before=simple, after=completed))
    return tuple(found)


def friction_columns(identifier):
    """Parameters of a fitted identifier that are friction, of each joint an array."""
    features = identifier.features_
    width = features.n_parameters_ // features.n_joints_
    terms = [k for k, x in enumerate(features.friction_) if x != RotorInertia.name]
    terms = np.array(terms, dtype=int) + width - len(features.friction_)
    found = [j * width + terms for j in range(features.n_joints_)]
    at = features.n_parameters_
    for effect in identifier.effects_:
        count = len(effect.coefficients)
        if is_friction(effect):
            found[effect.joint] = np.r_[found[effect.joint], at : at + count]
        at += count
    return found


def is_friction(effect):
    """Whether the torque of an effect opposes the motion."""
    of_speed = effect.seen_over == "speed" or "direction" in effect.depends
    return effect.with_motion or of_speed


# -- residuals -------------------------------------------------------------------------


def residual_curves(after, dt):
    """Residuals over predictions and over lags, a tuple of `ResidualCurves`."""
    index = after.index - after.index[0]
    step = int(np.median(np.diff(index))) if index.size > 1 else 1
    grid, found = index // step, []
    for j in range(after.weight.shape[1]):
        rows = np.flatnonzero(after.weight[:, j] > 0)
        if rows.size < _FEWEST:
            continue
        line = np.zeros(2 ** int(np.ceil(np.log2(2 * (grid[-1] + 1)))))
        line[grid[rows]] = after.residual[rows, j]
        power = np.fft.irfft(np.abs(np.fft.rfft(line)) ** 2)
        lags, shown = np.arange(min(_LAGS, rows.size)), _evenly(rows, _DOTS)
        found.append(
            ResidualCurves(
                joint=j,
                predicted=after.predicted[shown, j],
                residual=after.residual[shown, j],
                lags=lags * step * (1.0 if dt is None else dt),
                correlation=power[lags] / (power[0] or 1.0),
                chance=1.645 / np.sqrt(rows.size),
            )
        )
    return tuple(found)


# -- torques over time -----------------------------------------------------------------


def time_line(searched, held_out, clock, begins):
    """Torques over time of two models before and after, `TimeLine`."""
    # searched, held_out: pairs of their residuals on the two parts of the recording
    index = np.concatenate([searched[0].index, held_out[0].index])
    order = np.argsort(index, kind="stable")
    fresh = np.repeat([False, True], [x[0].index.size for x in (searched, held_out)])
    index, fresh = index[order], fresh[order]
    seconds = np.arange(index[-1] + 1) if clock is None else clock
    seconds = seconds[index].astype(float)

    def series(which, name):
        pair = searched[which], held_out[which]
        return np.concatenate([getattr(part, name) for part in pair])[order]

    step = float(np.median(np.diff(seconds))) if seconds.size > 1 else 1.0
    starts = np.searchsorted(index, np.asarray(begins)[1:])
    starts = starts[starts < index.size]
    # Nothing is known between recordings, and between search and held-out part.
    gaps = np.union1d(np.flatnonzero(np.diff(seconds) > _GAP * step) + 1, starts)
    change = np.diff(np.r_[False, fresh, False].astype(int))
    ends = zip(np.flatnonzero(change > 0), np.flatnonzero(change < 0))
    return TimeLine(
        torques=over_time(
            seconds,
            gaps,
            series(0, "torque"),
            series(0, "predicted"),
            series(1, "predicted"),
            series(0, "weight") > 0,
            step,
        ),
        borders=tuple(seconds[starts].tolist()),
        held_out=tuple(
            (float(seconds[a]), float(seconds[b - 1] + step)) for a, b in ends
        ),
        in_seconds=clock is not None,
    )


def over_time(seconds, gaps, measured, before, after, counts, step):
    """Thin what was measured and predicted, (n, nv); `TorqueCurves` of each joint."""
    measured, before, after = (
        np.insert(values, gaps, np.nan, axis=0) for values in (measured, before, after)
    )
    counts = np.insert(counts, gaps, False, axis=0)
    seconds = np.insert(seconds, gaps, seconds[gaps] - 0.5 * step)
    # Unknown predictions leave no gap.
    left = np.where(counts & np.isfinite(after), measured - after, 0.0)
    # Half of the points are those of the residual.
    half, torques = curve_size(measured.shape[1]) // 2, []
    for j in range(measured.shape[1]):
        rows = np.union1d(extremes(measured[:, j], half), extremes(left[:, j], half))
        torques.append(
            TorqueCurves(
                joint=j,
                seconds=seconds[rows],
                measured=measured[rows, j],
                before=before[rows, j],
                after=after[rows, j],
                counts=counts[rows, j],
            )
        )
    return tuple(torques)


def extremes(values, most):
    """Rows of the lowest and highest value of each interval of a curve (n,)."""
    # Rows that are nan, which interrupt it, are among them; `most` are there otherwise.
    n = values.size
    if n <= most:
        return np.arange(n)
    known = np.isfinite(values)
    low, high = np.where(known, values, np.inf), np.where(known, values, -np.inf)
    edges = np.linspace(0, n, most // 2 + 1).astype(int)
    rows = [
        at
        for a, b in itertools.pairwise(edges)
        for at in (a + np.argmin(low[a:b]), a + np.argmax(high[a:b]))
    ]
    return np.union1d(rows, np.flatnonzero(~known))
