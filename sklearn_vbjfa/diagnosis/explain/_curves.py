"""What pictures of a finished search need of the recording, thinned."""

import itertools
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.effects import RotorInertia

# Most points of a cloud, and of a curve over time (lowest and highest of each
# interval), and of all of them together, which have to fit into one page.
_CLOUD, _CURVE, _TOGETHER = 1500, 2000, 20_000
# Bins that may be needed to follow a law, the fewest first, and rows in one to count.
_BINS, _FEWEST = (24, 48, 96, 192), 8
# Share of the law's variance that may be lost between the bins.
_LOST = 0.05
# Quantiles at the ends of a signal: beyond them the bins would be empty.
_ENDS = (0.001, 0.999)
# Rows that are farther apart than this many usual steps have something between them.
_GAP = 2.5
# Most points of a friction curve.
_DOTS = 400
# Rows of an autocorrelation.
_LAGS = 40
# Kinds of a signal that the state of a joint has.
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
    """Torques of a joint without and with an effect, over the effect's own signal."""

    # The other parameters are those of the completed model.

    joint: int  # whose torque is shown, from zero
    kind: str  # what is on the horizontal axis, as in `Effect.seen_over`
    signal: str  # name of the recorded one; empty for others
    unit: str  # of the horizontal axis; empty where it is not known
    with_motion: bool  # whether torques count in the direction of the motion
    # (k,): points of the cloud, x rising: what the model leaves without and with the
    # effect [N m or N]
    x: np.ndarray
    without: np.ndarray
    after: np.ndarray
    law: np.ndarray  # (k,): torque of the effect there
    center: np.ndarray  # (n_bins,): middle of the bins in which there is something
    # (2, n_bins): weighted mean and deviation there, without and with the effect
    mean: np.ndarray
    deviation: np.ndarray
    law_mean: np.ndarray  # (n_bins,): mean of the effect's torque


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueCurves:
    """Measured and predicted torque, or position, of a joint over time."""

    joint: int  # from zero
    seconds: np.ndarray  # (k,): or the number of the row where time is not known
    # (k,): behind the low-pass; predicted by the declared and by the completed model,
    # both fitted to the search part [N m or N; rad or m]. They are nan where rows are
    # missing
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    counts: np.ndarray  # (k,): whether the joint moves, so that errors count there


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionCurves:
    """Friction of a joint over its speed, measured and of both models."""

    joint: int  # from zero
    # over speed, with what all else of the completed model leaves of the measured
    # torque as what is "without the effect": the effect is the friction of each model
    before: EffectCurves | None
    after: EffectCurves


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualCurves:
    """Residual of a joint on the held-out part, over its torque and its own past."""

    joint: int  # from zero
    # (k,): predicted by the completed model, and what it leaves [N m or N]
    predicted: np.ndarray
    residual: np.ndarray
    lags: np.ndarray  # (l,): [s], or rows
    correlation: np.ndarray  # (l,): autocorrelation
    chance: float  # that of white noise, with a probability of 90 %


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeLine:
    """The recording from its beginning to its end."""

    torques: tuple  # of each joint
    borders: tuple  # where recordings after the first begin [s]
    untouched: tuple  # stretches that the search did not look at [s]
    in_seconds: bool  # whether times are known; else they count rows


def cloud_size(count):
    """Most points of a cloud, of which there are `count`."""
    return min(_CLOUD, _TOGETHER // max(count, 1))


def curve_size(count):
    """Most points of a curve over time, of which there are `count`."""
    return min(_CURVE, _TOGETHER // max(count, 1))


def effect_curves(final):
    """Curves of each effect that a final fit has, a tuple of EffectCurves or None."""
    # None where there are too few rows to draw.
    torques = final.effect_torques()
    if not torques:
        return ()
    after = final.residuals()[1]
    return tuple(
        _of_effect(final, effect, own, after, cloud_size(len(torques)))
        for effect, own in zip(final.effects, torques)
    )


def _of_effect(final, effect, own, after, most):
    """Curves of one effect with its torque (m, nv); a cloud of at most `most`."""
    view, motion = final.view, final.motion
    residual, weight = after.residual, after.weight
    joint = effect.joint
    if effect.scope == "robot":
        joint = _most_of(own, residual, weight)
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


def _most_of(own, residual, weight):
    """Joint on which a torque (m, nv) is largest relative to the residual."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (weight * own**2).sum(axis=0) / (weight * residual**2).sum(axis=0)
    return int(np.argmax(np.where(np.isfinite(share), share, 0.0)))


def curves_over(x, after, law, weight, *, most=_CLOUD, **named):
    """Curves of an effect from rows (m,); None of too few."""
    if x.size < _BINS[0] or not np.ptp(x) > 0:
        return None
    low, high = np.quantile(x, _ENDS)
    if not high > low:
        low, high = x.min(), x.max()
    label, n = _bins(x, law, weight, low, high)
    count = np.bincount(label, minlength=n)
    kept = count >= _FEWEST
    if not kept.any():
        return None
    edges = np.linspace(low, high, n + 1)

    def mean(values):
        total = np.bincount(label, weight, n)
        sums = np.bincount(label, weight * values, n)
        return (sums / np.where(total > 0, total, 1.0))[kept]

    pair = after + law, after
    means = np.array([mean(values) for values in pair])
    squares = np.array([mean(values**2) for values in pair])
    rows = np.argsort(x, kind="stable")
    rows = rows[np.linspace(0, x.size - 1, min(x.size, most)).astype(int)]
    return EffectCurves(
        x=x[rows],
        without=pair[0][rows],
        after=after[rows],
        law=law[rows],
        center=(0.5 * (edges[1:] + edges[:-1]))[kept],
        mean=means,
        deviation=np.sqrt(np.maximum(squares - means**2, 0.0)),
        law_mean=mean(law),
        **named,
    )


def _bins(x, law, weight, low, high):
    """Bin of each row, and how many there are: no more than the law needs."""
    lost = []
    for n in _BINS:
        label = np.clip((n * (x - low) / (high - low)).astype(int), 0, n - 1)
        total = np.bincount(label, weight, n)
        sums = np.bincount(label, weight * law, n)
        inside = law - (sums / np.where(total > 0, total, 1.0))[label]
        lost.append((weight * inside**2).sum())
    # What even the finest bins lose is no function of the signal.
    spare = _LOST * (weight * (law - np.average(law, weights=weight)) ** 2).sum()
    n = next(k for k, left in zip(_BINS, lost) if left <= lost[-1] + spare)
    return np.clip((n * (x - low) / (high - low)).astype(int), 0, n - 1), n


def friction_curves(declared, final):
    """Friction curves of each joint that moves, a tuple of FrictionCurves."""
    view, motion, after = final.view, final.motion, final.residuals()[1]
    given = dict(zip(declared.parameter_names_, declared.theta_))
    names, theta = final.identifier.parameter_names_, final.identifier.theta_
    before = np.array([given.get(name, 0.0) for name in names])
    torques = zip(final.effects, final.effect_torques())
    own = [torque for effect, torque in torques if is_friction(effect)]
    most = min(_DOTS, cloud_size(after.weight.shape[1]))
    found = []
    for j, columns in enumerate(friction_columns(final.declared)):
        Phi = view.equations.Phi[:, j, columns]
        law = Phi @ theta[columns] + sum(torque[:, j] for torque in own)
        x = view.filtered(motion.v[:, [j]])[:, 0]
        used = (after.weight[:, j] > 0) & np.isfinite(x)
        completed, simple = (
            curves_over(
                x[used],
                after.residual[used, j],
                values[used],
                after.weight[used, j],
                joint=j,
                kind="speed",
                signal="",
                unit=_UNITS["speed"][int(motion.prismatic[j])],
                with_motion=False,
                most=most,
            )
            for values in (law, Phi @ before[columns])
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
    """Whether the torque of an effect is against the motion."""
    return (
        effect.with_motion
        or effect.seen_over == "speed"
        or "direction" in effect.depends
    )


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
        lags = np.arange(min(_LAGS, rows.size))
        shown = rows[np.linspace(0, rows.size - 1, min(rows.size, _DOTS)).astype(int)]
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


def time_line(searched, untouched, clock, begins):
    """Torques over time of two models before and after, `TimeLine`."""
    # searched, untouched: pairs of their residuals on the two parts of the recording
    index = np.concatenate([searched[0].index, untouched[0].index])
    order = np.argsort(index, kind="stable")
    fresh = np.repeat([False, True], [x[0].index.size for x in (searched, untouched)])
    index, fresh = index[order], fresh[order]
    seconds = np.arange(index[-1] + 1) if clock is None else clock
    seconds = seconds[index].astype(float)

    def series(which, name):
        pair = searched[which], untouched[which]
        return np.concatenate([getattr(part, name) for part in pair])[order]

    step = float(np.median(np.diff(seconds))) if seconds.size > 1 else 1.0
    starts = np.searchsorted(index, np.asarray(begins)[1:])
    starts = starts[starts < index.size]
    # Nothing is known between recordings, and between search and held-out part.
    gaps = np.union1d(np.flatnonzero(np.diff(seconds) > _GAP * step) + 1, starts)
    before, after = series(0, "predicted"), series(1, "predicted")
    counts = series(0, "weight") > 0
    known = series(0, "torque"), before, after, counts
    return TimeLine(
        torques=over_time(seconds, gaps, *known, step),
        borders=tuple(seconds[starts].tolist()),
        untouched=_stretches(seconds, fresh, step),
        in_seconds=clock is not None,
    )


def over_time(seconds, gaps, measured, before, after, counts, step):
    """Thin what was measured and predicted, (n, nv); `TorqueCurves` of each joint."""
    measured, before, after = (
        np.insert(values, gaps, np.nan, axis=0) for values in (measured, before, after)
    )
    counts = np.insert(counts, gaps, False, axis=0)
    seconds = np.insert(seconds, gaps, seconds[gaps] - 0.5 * step)
    # A model of which nothing is known leaves no gap.
    left = np.where(counts & np.isfinite(after), measured - after, 0.0)
    torques = []
    for j in range(measured.shape[1]):
        # Half of them are those of the residual; rows that do not count are no gaps.
        own = measured[:, j], left[:, j]
        half = curve_size(measured.shape[1]) // 2
        rows = np.union1d(*(extremes(values, half) for values in own))
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


def _stretches(seconds, chosen, step):
    """Intervals of time in which rows are chosen, a tuple of (begin, end)."""
    change = np.diff(np.r_[False, chosen, False].astype(int))
    return tuple(
        (float(seconds[a]), float(seconds[b - 1] + step))
        for a, b in zip(np.flatnonzero(change > 0), np.flatnonzero(change < 0))
    )
