"""Unexplained residuals, and effects that are not identifiable."""

from dataclasses import dataclass

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._core._autocorrelation import correlation_time
from sklearn_vbjfa._core._linear_systems import or_one, orthonormal_basis
from sklearn_vbjfa.diagnosis.search._held_out import CrossValidatedGain
from sklearn_vbjfa.effects import InModel, OnAllJoints, closure
from sklearn_vbjfa.equations._equations import make_motion

# Factors over the noise floor above which a residual is unexplained: the first if it
# depends on a signal, the second in any case. (Smoothing of the motion alone raises the
# residual by some per cent above the floor.)
ABOVE_FLOOR = (1.1, 1.5)
# Error of torques that follow the description.
WELL = 0.2
# A refit changes the errors of all joints; increases below this factor are tolerated.
WORSE = 1.05
# Number of bins of a signal, significance level of a dependence (before the Bonferroni
# correction for the number of signals), and most signals that are reported.
_BINS, _LEVEL, _SIGNALS = 12, 0.01, 4
# Share of a column's mean square outside the span of the others below which it is not
# identifiable from this recording, and below which no motion identifies it.
_HIDDEN, _IN_SPAN = 1e-3, 1e-6
# Channel faults that leave too little information: their joints are not searched, since
# the search would attribute the fault to an effect.
NO_INFORMATION = ("coarse_torque", "still_joint")
# Prior standard deviation of a free coefficient, relative to the joint's torque.
_FREE_STD = 1e4
# Log-evidence penalty of an effect's scale and value [nats].
_PENALTY = 5.0


def rises(error, other, floor, factor=WORSE):
    """Whether an error exceeds the noise floor, if known, and another error."""
    above = np.isnan(floor) | (error > ABOVE_FLOOR[0] * floor)
    return (error > factor * other) & above


def is_refuted(finding, at_floor, well):
    """Whether a model contradicts a channel finding by small errors of joints (nv,)."""
    # Missing effects may look like mixed torques or another robot.
    good = {"mixed_torques": at_floor, "other_robot": well}.get(finding.kind)
    return good is not None and good[list(finding.joints)].all()


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """How much of a joint's residual a signal explains out of sample."""

    signal: str  # such as "speed of joint 2" or "time"
    share: float  # of the mean square, by bin means fitted to the other folds
    p_value: float  # from the blocks of time, see `CrossValidatedGain`


def dependences(residual, weight, signals, blocks):
    """Return signals (m,) on which a residual (m,) depends, the strongest first."""
    # Signals are filtered like the residual; blocks exceed its correlation time.
    used, matches = weight > 0, []
    for name, signal in signals.items() if used.any() else ():
        inner = np.quantile(signal[used], np.linspace(0, 1, _BINS + 1)[1:-1])
        bins, remaining = np.searchsorted(inner, signal), residual.copy()
        for k in range(blocks.n_folds):
            # Subtract bin means of the other folds.
            fold = blocks.fold == k
            train, test_bins = np.where(fold, 0.0, weight), bins[fold]
            total = np.bincount(bins, train * residual, _BINS)
            count = np.bincount(bins, train, _BINS)
            remaining[fold] -= (total / np.where(count > 0, count, np.inf))[test_bins]
        errors = (blocks.sums(weight * x**2) for x in (residual, remaining))
        cv = CrossValidatedGain.of(*errors)
        if cv.gain > 0 and cv.p_value < _LEVEL / len(signals):
            matches.append(Dependence(signal=name, share=cv.gain, p_value=cv.p_value))
    return tuple(sorted(matches, key=lambda d: -d.share))


def motion_signals(motion, names):
    """Return the signals of all joints, by the names used in reports."""
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
    # Constant signals cannot be binned.
    return signals | {k: x for k, x in motion.signals.items() if np.ptp(x) > 0}


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """Residual of a joint above its noise floor."""

    joint: int  # from zero
    joint_name: str
    # out-of-sample residual and noise floor [N m or N]; the floor is nan if unknown
    rms: float
    floor: float
    # sqrt(rms^2 - floor^2) over the standard deviation of the torque, on the held-out
    # part (on the search part where the held-out error is not above the floor, or that
    # part is too short); of the whole residual if the floor is unknown
    of_torque: float
    signals: tuple[Dependence, ...] = ()  # that it depends on, the strongest first


def unexplained(result, names, sizes, errors, least):
    """Return joints whose residual exceeds the noise floor, with its dependences."""
    # sizes (3, nv): standard deviation and noise floor of the readings, and gains;
    # errors, least (nv,): held-out error and the lower end of its interval, over the
    # deviation; nan where unknown.
    view, listed, (spread, floors, gains) = result.view, [], sizes
    signals = motion_signals(result.motion, names)
    filtered = {key: view.filtered(x[:, None])[:, 0] for key, x in signals.items()}
    weights, residuals = view.equations.weight, _residuals(result)
    for j in np.flatnonzero(weights.any(axis=0)).tolist():
        weight, floor, residual = weights[:, j], float(floors[j]), residuals[j]
        rms = float(np.sqrt((weight * residual**2).sum() / weight.sum()))
        floor_known = not np.isnan(floor)
        if floor_known and rms <= ABOVE_FLOOR[0] * floor:
            continue
        depends_on = dependences(residual, weight, filtered, view.blocks)[:_SIGNALS]
        # A few rows, such as those of a reversal, may double the mean square.
        chance = rms <= ABOVE_FLOOR[1] * floor or least[j] * spread[j] <= floor
        if floor_known and not depends_on and chance:
            continue
        low, searched = np.nan_to_num(floor / spread[j]), rms / spread[j]
        error = float(errors[j]) if errors[j] > low else searched
        listed.append(
            Unexplained(
                joint=j,
                joint_name=names[j],
                rms=rms / gains[j].item(),
                floor=floor / gains[j].item(),
                of_torque=float(np.sqrt(max(error**2 - low**2, 0.0))),
                signals=depends_on,
            )
        )
    return tuple(listed)


def _residuals(result):
    """Return residuals (nv, m) [N m or N], zero in rows of zero weight."""
    return result.residual / or_one(result.view.root.T)


def memory_seconds(result):
    """Return the longest correlation time of the residuals of all joints [s]."""
    view = result.view
    # The low-pass correlates rows within half a period of its cut-off frequency.
    stride = max(1, int(np.ceil(0.5 / (view.robot.cutoff_ * view.step) - 1e-9)))
    residual = _residuals(result).T
    return correlation_time(residual, view.root, view.step, view.starts, stride)


@dataclass(frozen=True, kw_only=True)
class NotIdentifiable:
    """An effect that is not identifiable from this data."""

    name: str
    joint: int  # from zero
    joint_name: str
    # "span": in the span of the declared columns for any motion; "excitation": in this
    # recording; "signal": a signal that it needs is missing
    reason: str
    remedy: str = ""  # what to record


def not_identifiable(result, names):
    """Return effects of the library that are not identifiable, by joint."""
    # Branches that were searched separately are examined separately.
    parts = [(branch.joints, part) for branch, part in result.branches]
    listed = []
    for joints, part in parts or [(range(len(names)), result)]:
        for effect, reason, remedy in _hidden_effects(part):
            j = joints[effect.joint]
            about = {"name": effect.name, "joint": j, "joint_name": names[j]}
            listed.append(NotIdentifiable(reason=reason, remedy=remedy, **about))
    return tuple(sorted(listed, key=lambda hidden: hidden.joint))


def _hidden_effects(result):
    """Yield the effects that one search cannot identify, with reason and remedy."""
    view, motion = result.view, result.motion
    probe, fitted = _probe(result), {e.key() for e in view.robot.effects_}
    for joint in np.flatnonzero(view.precision > 0).tolist():
        library = [clone(e).set_params(joint=joint) for e in result.library]
        selected = [e for e in result.effects if e.joint == joint]
        contained = (closure(e, result.library) | {e.name} for e in selected)
        present = set(view.declared).union(*contained)
        missing = {e.name: e for e in library if e.name not in present}
        for e in (e for e in missing.values() if e.key() not in fitted):
            remedy = e.applies(motion)
            if remedy.startswith("needs"):
                yield e, "signal", remedy
            elif not remedy and _is_hidden(e, result, missing):
                spanned = _in_span(e, *probe)
                yield (e, "span", "") if spanned else (e, "excitation", e.record)


def _is_hidden(effect, result, missing):
    """Whether the declared columns and contained effects span every shape."""
    # missing: effects, by name, that the model of the joint does not contain.
    fit, simpler, tested = result.fit, missing.keys() & set(effect.contains), []
    for columns in result.candidates[effect.joint]:
        name = columns.effects[0].name
        if name == effect.name or name in simpler:
            if columns.load is not None:
                columns = result.fit.problem.columns(columns.effects)
            if name == effect.name:
                tested.append(columns)
            else:
                fit = fit.with_member(columns.member(0, _FREE_STD))
    for columns in tested:
        groups = fit.groups(columns)
        remaining = np.diagonal(groups.H, axis1=1, axis2=2)
        least = _HIDDEN * groups.norms
        if isinstance(effect, InModel):
            # Hidden if not even its largest plausible value would be reported.
            reach = np.max(np.abs(np.array(effect.bounds()) - effect.nominal), axis=0)
            needed = result.needed + np.log(max(result.n_candidates, 1))
            remaining, least = 0.5 * remaining[0] * reach**2, needed + _PENALTY
        if (remaining > least).any():
            return False
    return bool(tested)


def _probe(result):
    """Return a basis of the regressor, and the motion, of fully exciting states."""
    view = result.view
    features, nv = view.robot.features_, view.nv
    n = 20 * features.n_parameters_ // nv + 200
    # Full revolutions, since the span for any motion depends on no recording.
    scale = np.repeat([np.pi, 2.0, 10.0], nv)
    states = np.random.default_rng(0).uniform(-1, 1, size=(n, 3 * nv)) * scale
    inertial = (view.back @ result.fit.theta)[: features.n_parameters_]
    motion = make_motion(features, states, [slice(0, n)], theta=inertial)
    # Corrections of the robot model are fitted together with its parameters.
    corrections = [
        effect.in_all(effect.columns(motion), motion.n_joints)
        for effect in (*view.robot.effects_, *result.effects)
        if isinstance(effect, InModel) and effect.of_bodies
    ]
    Phi = np.concatenate([features.matrices(states), *corrections], axis=2)
    return orthonormal_basis(Phi.reshape(-1, Phi.shape[2])), motion


def _in_span(effect, basis, motion):
    """Whether the columns of an effect lie in the span of the regressor."""
    excluded = isinstance(effect, OnAllJoints) or effect.needs or effect.shape()
    if excluded and not isinstance(effect, InModel):
        return False
    target = effect.in_all(effect.columns(motion), motion.n_joints)
    target = target.reshape(-1, target.shape[-1])
    remainder = target - basis @ (basis.T @ target)
    return bool(np.all((remainder**2).sum(0) <= _IN_SPAN * (target**2).sum(0)))
