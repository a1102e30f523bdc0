"""Unexplained residuals, and effects that are not identifiable."""

from dataclasses import dataclass, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import or_one, orthonormal_basis
from sklearn_vbjfa.diagnosis.search._blocks import memory_time
from sklearn_vbjfa.diagnosis.search._held_out import CrossValidatedGain
from sklearn_vbjfa.effects import InModel, OnAllJoints, closure
from sklearn_vbjfa.equations._equations import make_motion

# A residual this far above its noise floor is unexplained: by the first factor if it
# varies with a signal, by the second in any case. (What smoothing takes from the motion
# leaves some per cent above the floor.)
ABOVE_FLOOR = (1.1, 1.5)
# Bins of a signal, the level of a dependence, shared out among the signals
# (Bonferroni), and how many of these are reported.
_BINS, _LEVEL, _SIGNALS = 12, 0.01, 4
# Share of a column's power outside the span of the others below which it cannot be
# seen in this recording, and below which no motion can show it.
_UNSEEN, _IN_SPAN = 1e-3, 1e-6
# Faults of channels that carry too little information: these are reported and not
# searched, since the search would find the fault.
NO_INFORMATION = ("coarse_torque", "still_joint")
# Prior deviation, in torques of the joint, that leaves a coefficient free.
_LOOSE = 1e4
# Nats that a scale and a value cost an effect.
_OCCAM = 5.0


# -- signals that a residual varies with -----------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """How much of a joint's residual a signal explains out of sample."""

    signal: str  # such as "speed of joint 2" or "time"
    share: float  # of the mean square, by a step function fitted to other blocks
    p_value: float  # from the blocks of time, see `CrossValidatedGain`


def dependences(residual, weight, signals, blocks):
    """Signals (m,) by name that a residual (m,) depends on, the strongest first."""
    # They are filtered as the residual is. Blocks are longer than its memory.
    used, found = weight > 0, []
    for name, signal in signals.items() if used.any() else ():
        inner = np.quantile(signal[used], np.linspace(0, 1, _BINS + 1)[1:-1])
        bins, left = np.searchsorted(inner, signal), residual.copy()
        for k in range(blocks.n_folds):
            # Means of the bins in the other folds.
            own = blocks.fold == k
            kept, known = np.where(own, 0.0, weight), bins[own]
            total = np.bincount(bins, kept * residual, _BINS)
            count = np.bincount(bins, kept, _BINS)
            left[own] -= (total / np.where(count > 0, count, np.inf))[known]
        errors = (blocks.sums(weight * x**2) for x in (residual, left))
        own = CrossValidatedGain.of(*errors)
        if own.gain > 0 and own.p_value < _LEVEL / len(signals):
            found.append(Dependence(signal=name, share=own.gain, p_value=own.p_value))
    return tuple(sorted(found, key=lambda d: -d.share))


def motion_signals(motion, names):
    """Signals of all joints by the name under which they are reported."""
    kinds = {"position": motion.q, "speed": motion.v, "acceleration": motion.a}
    kinds["load"] = motion.load
    signals = {
        f"{kind} of {name}": values[:, j]
        for j, name in enumerate(names)
        for kind, values in kinds.items()
        if values is not None
    }
    if motion.t is not None:
        signals["time"] = motion.t
    # A constant has no bins.
    return signals | {k: x for k, x in motion.signals.items() if np.ptp(x) > 0}


# -- residuals above the noise floor ---------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """Residual of a joint above its noise floor."""

    joint: int  # from zero
    joint_name: str
    # out-of-sample residual and noise floor [N m or N]; the floor is nan if unknown
    rms: float
    floor: float
    # root mean square above the floor over the deviation of the torque, on the held-out
    # part (on the search part where the held-out one shows nothing above the floor, or
    # is too short); of the whole residual if the floor is unknown
    of_torque: float
    signals: tuple[Dependence, ...] = ()  # that it varies with, the strongest first


def unexplained(found, names, spread, floors, errors, least):
    """Joints above their floor in what a search found, with signals they vary with."""
    # spread, floors (nv,): [N m or N]; errors, least (nv,): on the held-out part and
    # the lower end of its interval, over the spread. They are nan where unknown.
    view, listed = found.view, []
    signals = motion_signals(found.motion, names)
    seen = {key: view.filtered(value[:, None])[:, 0] for key, value in signals.items()}
    weights, residuals = view.equations.weight, _residuals(found)
    for j in np.flatnonzero(weights.any(axis=0)).tolist():
        weight, floor, residual = weights[:, j], float(floors[j]), residuals[j]
        rms = float(np.sqrt((weight * residual**2).sum() / weight.sum()))
        known = not np.isnan(floor)
        if known and rms <= ABOVE_FLOOR[0] * floor:
            continue
        signs = dependences(residual, weight, seen, view.blocks)[:_SIGNALS]
        # A few moments of a recording, such as a reversal, may double its mean square.
        chance = rms <= ABOVE_FLOOR[1] * floor or least[j] * spread[j] <= floor
        if known and not signs and chance:
            continue
        low, searched = np.nan_to_num(floor / spread[j]), rms / spread[j]
        error = float(errors[j]) if errors[j] > low else searched
        listed.append(
            Unexplained(
                joint=j,
                joint_name=names[j],
                rms=rms,
                floor=floor,
                of_torque=float(np.sqrt(max(error**2 - low**2, 0.0))),
                signals=signs,
            )
        )
    return tuple(listed)


def _residuals(found):
    """Residuals of the joints (nv, m) [N m or N], zero in rows that do not count."""
    return found.residual / or_one(found.view.root.T)


def memory_seconds(found):
    """How long the residual of a joint stays correlated at most [s]."""
    view = found.view
    # The low-pass does not correlate rows further apart than half a period of its
    # cut-off.
    stride = max(1, int(np.ceil(0.5 / (view.robot.cutoff_ * view.step) - 1e-9)))
    known = view.starts, view.step, stride
    pairs = zip(_residuals(found), view.root.T > 0)
    return max((memory_time(*pair, *known) for pair in pairs), default=0.0)


# -- effects that are not identifiable -------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class NotIdentifiable:
    """An effect that this data cannot show."""

    name: str
    joint: int  # from zero
    joint_name: str
    # "span": of the declared columns whatever the motion; "excitation": in this
    # recording; "signal": it needs one that is missing
    reason: str
    remedy: str = ""  # what to record


def not_identifiable(found, names):
    """Effects of the library that this robot or this recording cannot show."""
    # A robot that was searched branch by branch is asked branch by branch.
    parts = [(branch.joints, own) for branch, own in found.branches]
    listed = []
    for joints, own in parts or [(range(len(names)), found)]:
        for effect, reason, remedy in _of_model(own):
            j = joints[effect.joint]
            about = {"name": effect.name, "joint": j, "joint_name": names[j]}
            listed.append(NotIdentifiable(reason=reason, remedy=remedy, **about))
    return tuple(sorted(listed, key=lambda one: one.joint))


def _of_model(found):
    """Yield what a robot searched as a whole cannot show, with reason and remedy."""
    view, motion = found.view, found.motion
    probe, known = _probe(found), {e.key() for e in view.robot.effects_}
    for joint in np.flatnonzero(view.precision > 0).tolist():
        library = [clone(e).set_params(joint=joint) for e in found.library]
        held = [e for e in found.effects if e.joint == joint]
        contained = (closure(e, found.library) | {e.name} for e in held)
        present = set(view.declared).union(*contained)
        missing = {e.name: e for e in library if e.name not in present}
        for one in (e for e in missing.values() if e.key() not in known):
            remedy = one.applies(motion)
            if remedy.startswith("needs"):
                yield one, "signal", remedy
            elif not remedy and _is_hidden(one, found, missing):
                spanned = _in_span(one, *probe)
                yield (one, "span", "") if spanned else (one, "excitation", one.record)


def _is_hidden(effect, found, missing):
    """Whether no shape of an effect is visible beyond those that it contains."""
    # missing: effects by name that the joint has not.
    fit, simpler, asked = found.fit, missing.keys() & set(effect.contains), []
    for family in found.families[effect.joint]:
        name = family.effects[0].name
        if name == effect.name or name in simpler:
            if family.columns.load is not None:
                columns = found.fit.problem.shaped(family.columns.effects)
                family = replace(family, columns=columns)
            if name == effect.name:
                asked.append(family)
            else:
                fit = fit.beside(family.member(0, _LOOSE))
    for family in asked:
        groups = fit.groups(family.columns)
        left = np.diagonal(groups.H, axis1=1, axis2=2)[family.at]
        least = _UNSEEN * groups.own[family.at]
        if isinstance(effect, InModel):
            # At its largest plausible value it would not be reported.
            away = np.max(np.abs(np.array(effect.bounds()) - effect.nominal), axis=0)
            needed = found.needed + np.log(max(found.n_candidates, 1))
            left, least = 0.5 * left[0] * away**2, needed + _OCCAM
        if (left > least).any():
            return False
    return bool(asked)


def _probe(found):
    """Basis of the regressor, and signals, of random states that excite everything."""
    view = found.view
    features, nv = view.robot.features_, view.nv
    n = 20 * features.n_parameters_ // nv + 200
    # Whole turns, whatever the recording did: what a small motion hides is no property
    # of the robot.
    scale = np.repeat([np.pi, 2.0, 10.0], nv)
    states = np.random.default_rng(0).uniform(-1, 1, size=(n, 3 * nv)) * scale
    inertial = (view.back @ found.fit.theta)[: features.n_parameters_]
    motion = make_motion(features, states, None, [slice(0, n)], inertial)
    # Corrections of the robot are fitted together with its parameters.
    corrections = [
        effect.in_all(effect.columns(motion), motion.n_joints)
        for effect in (*view.robot.effects_, *found.effects)
        if isinstance(effect, InModel) and effect.of_bodies
    ]
    Phi = np.concatenate([features.matrices(states), *corrections], axis=2)
    return orthonormal_basis(Phi.reshape(-1, Phi.shape[2])), motion


def _in_span(effect, basis, motion):
    """Whether columns of the state alone lie in the regressor's span."""
    others = isinstance(effect, OnAllJoints) or effect.needs or effect.shape()
    if others and not isinstance(effect, InModel):
        return False
    target = effect.in_all(effect.columns(motion), motion.n_joints)
    target = target.reshape(-1, target.shape[-1])
    rest = target - basis @ (basis.T @ target)
    return bool(np.all((rest**2).sum(0) <= _IN_SPAN * (target**2).sum(0)))
