"""Unexplained residuals and effects that are not identifiable."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy import special, stats
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.explain._split import FEWEST_VALUES
from sklearn_vbjfa.diagnosis.search._blocks import FEWEST, Bridge, fit_memory
from sklearn_vbjfa.diagnosis.search._posterior import Found
from sklearn_vbjfa.effects import closure
from sklearn_vbjfa.inspection import one_speed
from sklearn_vbjfa.model._trees import is_prismatic
from sklearn_vbjfa.robot._equations import make_motion

# What takes less than this off a joint's squared error is not worth telling.
SMALLEST_GAIN = 0.02


def p_value(before, after):
    """One-sided test over blocks that the second errors are the smaller ones."""
    # Wilcoxon's signed ranks keep a few difficult blocks from deciding, but with a
    # dozen blocks they cannot reach the level that a hundred candidates ask for,
    # however clear the case; Student's t of the log ratios can. The smaller p-value
    # counts, twice, as two tests were made.
    if before.size < 3:
        return 1.0
    ranks = stats.wilcoxon(before - after, alternative="greater").pvalue
    # A block that is fitted exactly would decide alone.
    tiny = 1e-6 * before.mean()
    ratio = np.log((before + tiny) / (after + tiny))
    error = ratio.std(ddof=1) / np.sqrt(ratio.size)
    t = ratio.mean() / error if error > 0 else np.copysign(np.inf, ratio.mean())
    mean = special.stdtr(ratio.size - 1, -t)
    return float(min(1.0, 2 * np.fmin(ranks, mean)))


# -- rows without their memory ---------------------------------------------------------


class Whitening:
    """Rows of all joints without what the residuals' past predicts."""

    # residual (nv, m): scaled by the root (m, nv) of the weights, which is zero for a
    # row that is left out; starts: first rows of the recordings; step [s]; cutoff: of
    # the low-pass that the rows have passed [Hz]; memory: of each joint.

    @classmethod
    def of(cls, view, residual, root=None):
        """Take the memory out of residuals of a view, with its weights unless given."""
        root = view.root if root is None else root
        return cls(residual, root, view.starts, view.step, view.robot.cutoff_)

    def __init__(self, residual, root, starts, step, cutoff=np.inf):
        # Rows further apart than half a period of the cut-off are as good as not
        # correlated by the low-pass.
        self._stride = max(1, int(np.ceil(0.5 / (cutoff * step) - 1e-9)))
        self._root, self._starts = root, np.asarray(starts)
        self._used = root > 0
        self._gaps = [Bridge.of(used, self._starts) for used in self._used.T]
        self.memory = []
        for j, own in enumerate(residual):
            used = self._used[:, j]
            values = np.where(used, own / np.where(used, root[:, j], 1.0), 0.0)
            self.memory.append(
                fit_memory(values, used, self._starts, step, self._stride)
            )

    def __call__(self, rows, joints):
        """Whiten rows (nj, m, ...) of joints, scaled by the root of the weights."""
        # Missing rows are bridged by straight lines, in torques and columns alike, so
        # that what explains the one explains the other; before its first row a
        # recording counts as constant.
        out = np.empty_like(rows)
        for i, j in enumerate(joints):
            shape = (-1,) + (1,) * (rows.ndim - 2)
            phi, root = self.memory[j].phi, self._root[:, j]
            x = rows[i] / np.where(root > 0, root, 1.0).reshape(shape)
            if self._gaps[j] is not None:
                x = self._gaps[j](x)
            out[i] = x
            edges = [*self._starts, x.shape[0]]
            for a, b in itertools.pairwise(edges):
                for k, coefficient in enumerate(phi, start=1):
                    past = min(k * self._stride, b - a)
                    out[i, a + past : b] -= coefficient * x[a : b - past]
                    out[i, a : a + past] -= coefficient * x[a]
            out[i] *= root.reshape(shape)
        return out


def memory_seconds(model):
    """How long the residual of each joint of a model stays correlated, list [s]."""
    return [m.time for m in Whitening.of(model.view, model.residual).memory]


# -- signals that a residual varies with -----------------------------------------------

# Bins of a signal, and those of time: coarse enough to be filled, fine enough to bend.
_BINS = 12


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """How much of a joint's residual a signal explains out of sample."""

    signal: str  # such as "v of joint 2" or "time"
    # share of the mean square that a step function of it explains in other blocks
    share: float
    # p-value from the blocks of time, in rows without what the residual remembers of
    # its past once the step function is taken off, see `Whitening`
    p_value: float


def dependences(residual, weight, signals, view, level=0.01):
    """Signals (m,) by name that a residual (m,) depends on, the strongest first."""
    # They are filtered as the residual is; the level is shared out among them
    # (Bonferroni).
    used = weight > 0
    if not used.any():
        return ()
    found = []
    for name, signal in signals.items():
        inner = np.quantile(signal[used], np.linspace(0, 1, _BINS + 1)[1:-1])
        bins = np.searchsorted(inner, signal)
        gain, p_value = _step_function(residual, weight, bins, view)
        if gain > 0 and p_value < level / len(signals):
            found.append(Dependence(signal=name, share=gain, p_value=p_value))
    return tuple(sorted(found, key=lambda d: -d.share))


def _step_function(residual, weight, bins, view):
    """Out-of-sample gain of a step function, and its p-value over blocks."""
    blocks = view.blocks
    total = np.bincount(bins, weight * residual, _BINS)
    count = np.bincount(bins, weight, _BINS)
    fit = np.zeros_like(residual)
    for k in range(blocks.n_folds):
        rows = blocks.fold == k
        part = np.bincount(bins[rows], (weight * residual)[rows], _BINS)
        n = np.bincount(bins[rows], weight[rows], _BINS)
        rest = count - n
        mean = np.where(rest > 0, (total - part) / np.where(rest > 0, rest, 1.0), 0.0)
        fit[rows] = mean[bins[rows]]
    before = blocks.sums(weight * residual**2)
    after = blocks.sums(weight * (residual - fit) ** 2)
    if before.sum() == 0 or after.sum() >= before.sum():
        return 0.0, 1.0
    root = np.sqrt(weight)[:, None]
    whiten = Whitening.of(view, (residual - fit)[None] * root.T, root)
    y = whiten(residual[None] * root.T, [0])[0]
    columns = (bins[:, None] == np.arange(_BINS)) * root
    A = whiten(columns[None], [0])[0]
    left = y.copy()
    for k in range(blocks.n_folds):
        rows = blocks.fold == k
        coef = np.linalg.lstsq(A[~rows], y[~rows], rcond=1e-10)[0]
        left[rows] -= A[rows] @ coef
    gain = float((before - after).sum() / before.sum())
    # Blocks without the residual's memory are independent: the p-value is theirs.
    first, second = blocks.sums(y**2), blocks.sums(left**2)
    used = first != second
    if (first - second).sum() <= 0:
        return gain, 1.0
    return gain, p_value(first[used], second[used])


def motion_signals(motion, names):
    """Signals of all joints by the name under which they are reported."""
    signals = {}
    for j, name in enumerate(names):
        signals[f"position of {name}"] = motion.q[:, j]
        signals[f"speed of {name}"] = motion.v[:, j]
        signals[f"acceleration of {name}"] = motion.a[:, j]
        if motion.load is not None:
            signals[f"load of {name}"] = motion.load[:, j]
    if motion.t is not None:
        signals["time"] = motion.t
    # What does not vary has no bins.
    return signals | {k: x for k, x in motion.signals.items() if np.ptp(x) > 0}


# A joint whose residual is this far above its noise floor has something unexplained:
# by the first factor if it varies with a signal, by the second in any case. (What
# smoothing takes from the motion leaves some per cent above the floor.)
ABOVE_FLOOR = (1.1, 1.5)
# Share of a column's power outside the span of the others below which it cannot be
# seen in this recording, and below which no motion can show it.
_UNSEEN, _IN_SPAN = 1e-3, 1e-6
# Columns are equal if this share of what the model leaves of them is outside others.
_EQUAL = 1e-3
# Prior deviation, in torques of the joint, that leaves a coefficient free.
_LOOSE = 1e4
# Nats that a scale and a value of its own cost an effect.
_OCCAM = 5.0


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """Residual of a joint above the noise that is unexplained."""

    joint: int  # from zero
    joint_name: str
    # out-of-sample residual and noise floor [N m or N]; the floor is nan if unknown
    rms: float
    floor: float
    share: float  # share of the residual's mean square above the floor
    # root mean square of what is above the floor over the spread of the torque, on the
    # held-out part (on the search part where the held-out one shows nothing above the
    # floor, or is too short); of the whole residual, if the floor is unknown
    of_torque: float
    # signals that it varies with, the strongest first
    signals: tuple[Dependence, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """An effect that this data cannot show."""

    name: str
    joint: int  # from zero
    joint_name: str
    # it lies in the span of the declared columns whatever the motion; it does so in
    # this recording; it needs a signal that is not there; or it shows, but only
    # together with another effect
    reason: str
    remedy: str = ""  # what to record; the name of the other effect


def unexplained(model, names, spread, floors, errors):
    """Joints above their floor, with the signals that the rest varies with."""
    # Of a `FoundModel`; spread and noise floors (nv,) in N m or N, nan where unknown,
    # and the errors on the held-out part over the spread, nan where there is none.
    view = model.view
    residual = model.residual / np.where(view.root.T > 0, view.root.T, np.inf)
    signals = motion_signals(model.motion, names)
    seen = {key: view.filtered(value[:, None])[:, 0] for key, value in signals.items()}
    found = []
    for j, name in enumerate(names):
        weight = view.equations.weight[:, j]
        total = weight.sum()
        if total == 0:
            continue
        rms = float(np.sqrt((weight * residual[j] ** 2).sum() / total))
        floor = float(floors[j])
        known = not np.isnan(floor)
        if known and rms <= ABOVE_FLOOR[0] * floor:
            continue
        signs = dependences(residual[j], weight, seen, view)[:4]
        if known and not signs and rms <= ABOVE_FLOOR[1] * floor:
            continue
        found.append(
            Unexplained(
                joint=j,
                joint_name=name,
                rms=rms,
                floor=floor,
                share=float(1 - (floor / rms) ** 2) if known else 1.0,
                of_torque=_above(floor / spread[j], rms / spread[j], float(errors[j])),
                signals=signs,
            )
        )
    return tuple(found)


def _above(floor, searched, untouched):
    """Share of the torque above the floor: of the held-out part, if it shows one."""
    floor = np.nan_to_num(floor)
    error = untouched if untouched > floor else searched
    return float(np.sqrt(max(error**2 - floor**2, 0.0)))


def too_short(model, seconds):
    """Joints whose residual is too few independent values, with its memory [s]."""
    blocks = model.view.spans
    total = blocks.length * blocks.n_blocks
    for j, time in enumerate(seconds):
        if model.view.precision[j] > 0 and FEWEST * time > total:
            yield j, float(time)


def hidden(found, names):
    """Effects of the library that this robot or this recording cannot show."""
    # A robot that was searched branch by branch is asked branch by branch.
    if not found.branches:
        return _hidden(found, names)
    told = []
    for branch, own in found.branches:
        for one in _hidden(own, [names[j] for j in branch.joints]):
            told.append(replace(one, joint=branch.joints[one.joint]))
    return tuple(sorted(told, key=lambda one: one.joint))


def _hidden(found, names):
    """Effects that a robot or a branch that was searched as a whole cannot show."""
    model = found.model
    probe = _probe(model)
    not_seen, in_model = [], []
    declared = {effect.key() for effect in model.view.robot.effects_}
    for j, name in enumerate(names):
        if model.view.precision[j] == 0:
            continue
        unseen = _Unseen.on(j, found)
        for effect in found.library:
            one = clone(effect).set_params(joint=j)
            if one.name in unseen.present or one.key() in declared:
                continue
            reason, remedy = "signal", one.applies(model.motion)
            if not remedy:
                if not unseen.hides(one):
                    if one.in_model:
                        in_model.append(one)
                    continue
                structural = _in_span(one, *probe)
                reason = "span" if structural else "excitation"
                remedy = "" if structural else one.visible
            elif not remedy.startswith("needs"):
                continue
            not_seen.append(
                Hidden(
                    name=one.name,
                    joint=j,
                    joint_name=name,
                    reason=reason,
                    remedy=remedy,
                )
            )
    for one, other in inseparable(found, in_model):
        not_seen.append(
            Hidden(
                name=one.name,
                joint=one.joint,
                joint_name=names[one.joint],
                reason="together",
                remedy=named_beside(other, one, names),
            )
        )
    return tuple(sorted(not_seen, key=lambda one: one.joint))


def inseparable(found, effects):
    """Pairs of effects in the model that are only jointly identifiable."""
    # Nothing is left of the columns of the first beside those of the second, which
    # comes before it in precedence or in the list.
    model = found.model
    order = sorted(effects, key=lambda one: one.precedence if one.in_model else 0)
    before = []
    for one in order:
        own = _family(model, one)
        alone = model.fit.groups(own).H[0]
        for other, fit in before:
            beside = fit.groups(own).H[0]
            if (np.diagonal(beside) <= _EQUAL * np.diagonal(alone)).all():
                yield one, other
                break
        before.append((one, model.fit.beside(own.member(0, _LOOSE))))


def _family(model, effect):
    """Family of an effect in the search's equations, None where nothing is to try."""
    return model.fit.problem.family(effect, model.motion)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Unseen:
    """What may hide effects on a joint: the model and simpler effects."""

    found: Found  # what was found
    present: set  # effects that the joint has, with what they contain
    missing: tuple  # those of the library that it lacks
    # the model with some of these beside it, by their places
    fits: dict

    @classmethod
    def on(cls, joint, found):
        """Collect what a joint has and lacks."""
        model, library = found.model, found.library
        held = [e for e in model.effects if e.joint == joint]
        present = set(model.view.declared).union(
            *({e.name} | closure(e, library) for e in held)
        )
        own = [clone(effect).set_params(joint=joint) for effect in library]
        missing = tuple(
            e for e in own if e.name not in present and not e.applies(model.motion)
        )
        known = {"present": present, "missing": missing}
        return cls(found=found, fits={(): model.fit}, **known)

    def _beside(self, places):
        """Fit of the model with further effects at some places."""
        if places not in self.fits:
            fit = self._beside(places[:-1])
            own = _family(self.found.model, self.missing[places[-1]])
            if own is not None:
                fit = fit.beside(own.member(0, _LOOSE))
            self.fits[places] = fit
        return self.fits[places]

    def hides(self, effect):
        """Whether no shape of an effect is visible beyond those that it contains."""
        model = self.found.model
        family = _family(model, effect)
        if family is None:
            return False
        if effect.in_model:
            # At its largest plausible value it would not be named.
            groups = model.fit.groups(family)
            away = np.max(np.abs(np.array(effect.bounds()) - effect.nominal), axis=0)
            worth = 0.5 * np.diagonal(groups.H[0]) * away**2
            needed = self.found.needed + np.log(max(self.found.n_candidates, 1))
            return bool(not (worth > needed + _OCCAM).any())
        plain = (i for i, e in enumerate(self.missing) if e.name in effect.contains)
        groups = self._beside(tuple(plain)).groups(family)
        left = np.diagonal(groups.H, axis1=1, axis2=2)
        share = left / np.where(groups.own > 0, groups.own, np.inf)
        return not share.max() > _UNSEEN


def _probe(model):
    """Regressor and signals of random states, which excite everything there is."""
    view = model.view
    features, nv = view.robot.features_, view.nv
    rng = np.random.default_rng(0)
    n = 20 * features.n_parameters_ // nv + 200
    # Whole turns, whatever the recording did: what a small motion hides is no property
    # of the robot.
    scale = np.repeat([np.pi, 2.0, 10.0], nv)
    states = rng.uniform(-1, 1, size=(n, 3 * nv)) * scale
    inertial = (view.back @ model.fit.theta)[: features.n_parameters_]
    motion = make_motion(features, states, None, [slice(0, n)], inertial)
    # What corrects the robot already is fitted beside its parameters.
    found = [
        effect.columns(motion) if effect.whole_robot else _on_joint(effect, motion)
        for effect in (*view.robot.effects_, *model.effects)
        if effect.in_model and effect.of_bodies
    ]
    return np.concatenate([features.matrices(states), *found], axis=2), motion


def _on_joint(effect, motion):
    """Columns of an effect of one joint in the torques of all, (n, nv, k)."""
    own = effect.columns(motion)
    columns = np.zeros((*motion.q.shape, own.shape[-1]))
    columns[:, effect.joint] = own
    return columns


def _in_span(effect, Phi, motion):
    """Whether columns of the state alone lie in the regressor's span."""
    linear = not (effect.needs or effect.shape())
    if not effect.in_model and (effect.whole_robot or not linear):
        return False
    columns = effect.columns(motion)
    scale = np.sqrt((Phi**2).sum(axis=(0, 1)))
    A = Phi / np.where(scale > 0, scale, 1.0)
    target = columns if effect.whole_robot else _on_joint(effect, motion)
    flat, target = A.reshape(-1, A.shape[2]), target.reshape(-1, columns.shape[-1])
    solution, *_ = np.linalg.lstsq(flat, target, rcond=1e-10)
    rest = target - flat @ solution
    return bool(np.all((rest**2).sum(0) <= _IN_SPAN * (target**2).sum(0)))


def named_beside(effect, chosen, names):
    """Name an effect beside another, with its joint where that is a different one."""
    if effect.joint == chosen.joint or effect.scope == "robot":
        return effect.told_beside(chosen)
    return f"{effect.told_beside(chosen)} on {names[effect.joint]}"


# -- what joints do in no recording ----------------------------------------------------

# Rows that show which way a link hangs.
_POSES = 400


@dataclass(frozen=True, kw_only=True)
class MotionLimit:
    """What a joint does not do in any recording."""

    # it never reverses; it always has the same speed; its link always hangs the same
    # way
    kind: str
    joint: int  # from zero
    recordings: tuple  # recordings in which it moves, from zero
    # range of its velocity, speed or position that it keeps to [rad or m, s]
    low: float
    high: float


def motion_limits(view):
    """Return the `MotionLimit` of each joint of a recording, a tuple."""
    found = []
    for joint in range(view.nv):
        rows = np.flatnonzero(view.equations.weight[:, joint] > 0)
        if not rows.size or view.precision[joint] == 0:
            continue
        recordings = tuple(int(k) for k in np.unique(view.origin[rows]))
        for kind, ends in (
            ("one way", _one_way(view, joint, rows)),
            ("one speed", _one_speed(view, joint, rows)),
            ("one pose", _one_pose(view, joint, rows)),
        ):
            if ends is not None:
                found.append(
                    MotionLimit(
                        kind=kind,
                        joint=joint,
                        recordings=recordings,
                        low=float(ends[0]),
                        high=float(ends[1]),
                    )
                )
    return tuple(found)


def _velocity(view, joint, rows):
    """Return velocities of a joint while it moves."""
    v = view.states[view.index[rows], view.nv + joint]
    return v[np.abs(v) > max(view.robot.standstill_[joint], 0.0)]


def _one_way(view, joint, rows):
    """Return the range of the velocity of a joint that never reverses, or None."""
    v = _velocity(view, joint, rows)
    if not v.size:
        return None
    rarer = min((v > 0).sum(), (v < 0).sum())
    share = rarer / v.size
    # The power of the velocity's sign about its mean, and how many values it is of.
    band = min(view.robot.cutoff_, 0.5 / (view.robot.dt or 1.0))
    values = 2.0 * band * rarer * view.step
    if rarer and (4 * share * (1 - share) >= _UNSEEN and values >= FEWEST_VALUES):
        return None
    common = v[v > 0] if (v > 0).sum() > rarer else v[v < 0]
    return np.quantile(common, [0.0, 1.0])


def _one_speed(view, joint, rows):
    """Return the range of the speed of a joint that has one only, or None."""
    speed = np.abs(_velocity(view, joint, rows))
    if not speed.size:
        return None
    return one_speed(speed)


def _one_pose(view, joint, rows):
    """Return the range of the position of a joint whose link always hangs alike."""
    features, nv = view.robot.features_, view.nv
    if is_prismatic(features.model_)[joint]:
        return None
    chosen = view.index[rows[:: max(1, rows.size // _POSES)]]
    states = np.zeros((chosen.size, 3 * nv))
    states[:, :nv] = view.states[chosen, :nv]
    first = joint * (features.n_parameters_ // nv)
    # At rest: torques of the first moments of the link are those of its weight.
    weight = features.matrices(states)[:, joint, first + 1 : first + 4]
    power = (weight**2).sum()
    if not power > 0:
        # Gravity does not act about a vertical axis.
        return None
    varying = ((weight - weight.mean(axis=0)) ** 2).sum()
    if varying >= _UNSEEN * power:
        return None
    return np.quantile(states[:, joint], [0.0, 1.0])
