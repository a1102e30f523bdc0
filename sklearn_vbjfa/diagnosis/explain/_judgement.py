"""The errors on the held-out part, which is looked at here and only once."""

import copy
import warnings
from dataclasses import dataclass, field, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.diagnosis.explain._curves import Spectra, TimeLine, over_time
from sklearn_vbjfa.diagnosis.explain._gaps import SMALLEST_GAIN, memory_seconds
from sklearn_vbjfa.diagnosis.explain._intervals import (
    FinalFit,
    added_effects,
    error_intervals,
    quantile,
)
from sklearn_vbjfa.diagnosis.explain._split import FEWEST_VALUES
from sklearn_vbjfa.diagnosis.search._branches import root_joints
from sklearn_vbjfa.effects import Shaped
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.model._trees import body_names
from sklearn_vbjfa.robot._equations import TorqueResiduals, torque_spread
from sklearn_vbjfa.robot._estimate import estimate, from_moments, project
from sklearn_vbjfa.robot._identifier import RobotIdentifier
from sklearn_vbjfa.robot._windows import Follower, tell_once

# At most so much of the held-out part is simulated [s]: the beginnings of its
# stretches.
_SIMULATED = 60.0


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandsAlone:
    """Positions that models reach on the held-out data, from its commands alone."""

    # (nv,): root mean square of simulated minus measured positions [rad or m], of the
    # declared model, with the plain terms, and of the completed one; nan where a
    # simulation did not come to its end
    before: np.ndarray
    plain: np.ndarray
    after: np.ndarray
    told: np.ndarray  # (nv,): the same of commanded minus measured positions
    units: tuple  # "rad" or "m"
    seconds: float  # that each model was simulated [s]
    n_stretches: int  # each from its measured first state on
    failed: dict = field(default_factory=dict)  # why, by the name of the error
    left_out: tuple = ()  # effects of the completed model that are not simulated


def commands_alone(models, stretches, recording):
    """Return `CommandsAlone` and the `TimeLine` of its positions; None without."""
    drive = models.declared.drive
    if drive is None or not drive.of_positions:
        return None, None
    dt, nv = recording.dt, recording.nv
    lengths = [rows.stop - rows.start for rows in stretches]
    most = max(lengths)
    if sum(lengths) * dt > _SIMULATED:
        most = max(int(_SIMULATED / dt / len(lengths)), 2)
    parts = [slice(x.start, min(x.start + most, x.stop)) for x in stretches]
    measured, _ = models.judged.robot_.query(recording.inputs, recording.groups)
    known = {"before": models.declared, "plain": models.plain, "after": models.judged}
    found, failed, left_out = {}, {}, ()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for model in counted(list(dict.fromkeys(known.values())), "closed loop"):
            try:
                follower = Follower(model.robot_, drive, recording)
                if model is models.judged:
                    left_out = follower.left_out
                states = [
                    follower.run(rows, measured[rows.start], recording.t[rows])
                    for rows in parts
                ]
                found[model] = np.concatenate(states)[:, :nv]
            except ValueError as error:
                found[model], failed[model] = None, str(error)
    tell_once(caught, "models", stacklevel=2)
    q = np.concatenate([recording.q[rows] for rows in parts])
    aim = np.reshape(recording.signals[drive.told], recording.q.shape)
    aim = np.concatenate([aim[rows] for rows in parts])
    reached = {
        name: np.full(q.shape, np.nan) if found[one] is None else found[one]
        for name, one in known.items()
    }
    result = CommandsAlone(
        **{name: _size(x - q) for name, x in reached.items()},
        told=_size(aim - q),
        units=tuple(
            "m" if slides else "rad"
            for slides in is_prismatic(models.judged.features_.model_)
        ),
        seconds=len(q) * dt,
        n_stretches=len(parts),
        failed={name: failed[one] for name, one in known.items() if one in failed},
        left_out=left_out,
    )
    return result, _line(parts, q, reached, dt)


def _size(errors):
    return np.sqrt((errors**2).mean(axis=0))


def _line(parts, q, reached, dt):
    """Positions over time, `TimeLine`, the stretches one after the other."""
    starts = np.cumsum([rows.stop - rows.start for rows in parts])[:-1]
    torques = over_time(
        dt * np.arange(len(q)),
        starts,
        q,
        reached["before"],
        reached["after"],
        np.ones(q.shape, dtype=bool),
        dt,
    )
    return TimeLine(
        torques=torques,
        borders=tuple((dt * starts).tolist()),
        untouched=(),
        in_seconds=True,
    )


# The wider band reaches this many times as far as that of the fit, and at least to
# the frequency [Hz] at which controllers act.
_WIDER, _CONTROL = 4.0, 10.0
# Share of the sample rate up to which it may reach.
_HIGHEST = 0.4


# -- what physically consistent parameters cost ----------------------------------------

# What is freed is to blame if most of the distance goes with it.
_MOST = 0.5
# Of bodies that can be freed with nearly the same effect, this many are named; more are
# no answer, as neighbouring bodies stand in for each other.
_AS_GOOD, _NAMED = 0.9, 2


@dataclass(frozen=True, kw_only=True)
class Pushed:
    """A body, or a joint's friction, that the constraints hold back."""

    joint: int  # from zero
    name: str  # of the body that the joint moves
    kind: str  # whose constraint it is
    # share of the distance between the estimate and the consistent parameters, in the
    # metric of the fit, that goes if this constraint alone is lifted
    share: float
    # what the constraints move most of it, in standard deviations, among what the data
    # determine by itself; empty if they leave all of that in its interval
    parameter: str = ""
    unit: str = ""
    # its values without and with the constraints; nan without a parameter
    free: float = np.nan
    held: float = np.nan
    # by how many standard deviations it moves; nan without a parameter
    deviations: float = np.nan


@dataclass(frozen=True, kw_only=True, eq=False)
class ConsistencyCost:
    """Errors on held-out data with and without physically consistent parameters."""

    # (nv,): error of the completed model with `theta_unconstrained_` and with `theta_`,
    # over the spread of the torque
    free: np.ndarray
    held: np.ndarray
    # (2, nv): 90 % interval of held minus free, over the next 50 s of the same motion
    interval: np.ndarray
    # (nv,): difference where it is above 0 by more than its interval, and as large as
    # what an effect has to save to be named; 0 elsewhere, nan where unknown
    cost: np.ndarray
    # the most costly first; empty where the constraints cost nothing or no single one
    # of them does
    pushed: tuple = ()
    # joint, from zero, without whose torques the others need most of the constraints no
    # more
    channel: int | None = None
    # share of the distance that goes without them; nan without a channel
    channel_share: float = np.nan

    @property
    def costs(self):
        """Joints whose error the constraints raise by more than chance, (nv,), bool."""
        return self.cost > 0


def without_constraints(robot):
    """Copy a fitted identifier, which predicts with its unconstrained parameters."""
    other = copy.copy(robot)
    other.theta_ = robot.theta_unconstrained_
    return other


def cost_of(robot, untouched, searched, spread, step):
    """Price of the constraints of a fitted identifier, a `ConsistencyCost`."""
    free, held = (part.relative_error(spread) for part in untouched)
    interval = error_intervals(untouched, searched, spread, step)["difference"]
    with np.errstate(invalid="ignore"):
        material = free**2 < (1.0 - SMALLEST_GAIN) * held**2
        cost = np.where((interval[0] > 0) & material, held - free, 0.0)
    cost[~np.isfinite(held - free)] = np.nan
    found = ConsistencyCost(free=free, held=held, interval=interval, cost=cost)
    if not found.costs.any():
        return found
    channel, share = _channel(robot)
    return replace(found, pushed=_pushed(robot), channel=channel, channel_share=share)


def _distance(metric, theta, other):
    """Squared distance of two vectors of parameters in a metric."""
    moved = other - theta
    return float(moved @ metric @ moved)


def concerned(robot):
    """Joints of the branch that most of the cost stems from, list of int."""
    # The branches of a robot share no parameter: what is constrained or measured on
    # one cannot be most of the cost unless the branch is. All joints if there is but
    # one.
    projector, theta = robot.projector_, robot.theta_unconstrained_
    covered = projector.n_features_in_
    root = root_joints(robot.features_.model_)
    if np.unique(root).size == 1:
        return list(range(root.size))
    moved = robot.theta_[:covered] - theta[:covered]
    each = moved * (projector.metric_ @ moved)
    per_joint = robot.features_.n_parameters_ // robot.features_.n_joints_
    of_joint = np.minimum(np.arange(covered) // per_joint, root.size - 1)
    share = np.bincount(root[of_joint], each) / max(each.sum(), np.finfo(float).tiny)
    return [j for j in range(root.size) if share[root[j]] >= _MOST]


def _pushed(robot):
    """Bodies and friction whose constraint alone is most of the cost."""
    projector, theta = robot.projector_, robot.theta_unconstrained_
    covered = projector.n_features_in_
    whole = _distance(projector.metric_, theta[:covered], robot.theta_[:covered])
    if not whole > 0:
        return ()
    per_joint = robot.features_.n_parameters_ // robot.features_.n_joints_
    starts, signs = projector.body_starts_, projector.nonnegative_
    found = []
    for joint in concerned(robot):
        own = slice(joint * per_joint, (joint + 1) * per_joint)
        friction = signs[(signs >= own.start) & (signs < own.stop)]
        lifted = []
        # A robot needs a body; of a single one the whole cost is its own.
        if starts.size > 1:
            others = starts[starts != own.start]
            lifted.append(("body", {"body_starts": others, "nonnegative": signs}))
        else:
            found.append(_moved(robot, joint, "body", 1.0))
        if (theta[friction] < 0).any():
            kept = np.setdiff1d(signs, friction)
            lifted.append(("friction", {"body_starts": starts, "nonnegative": kept}))
        for kind, constraints in lifted:
            freed = _lift(projector, theta[:covered], constraints)
            left = _distance(projector.metric_, theta[:covered], freed) / whole
            found.append(_moved(robot, joint, kind, 1.0 - left))
    if not found:
        return ()
    found.sort(key=lambda one: -one.share)
    least = max(_MOST, _AS_GOOD * found[0].share)
    named = tuple(one for one in found if one.share >= least)
    return named if len(named) <= _NAMED else ()


def _lift(projector, theta, constraints):
    """Project a vector with fewer constraints than a fitted projector has."""
    scales = {}
    if "body_starts" in constraints:
        kept = np.isin(projector.body_starts_, constraints["body_starts"])
        scales = {
            "mass_scale": projector.mass_scale_[kept],
            "length_scale": projector.length_scale_[kept],
        }
    options = replace(projector.options, **constraints, **scales)
    other = clone(projector).set_params(options=options)
    return other.fit(theta[None]).transform(theta[None])[0]


def _moved(robot, joint, kind, share):
    """Describe what the constraints move most of a body or of a joint's friction."""
    per_joint = robot.features_.n_parameters_ // robot.features_.n_joints_
    start = joint * per_joint
    if kind == "body":
        own = np.arange(start, start + 10)
    else:
        own = np.arange(start + 10, start + per_joint)
    std = robot.theta_std_[own]
    moved = np.abs(robot.theta_ - robot.theta_unconstrained_)[own]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(robot.identifiable_[own] & (std > 0), moved / std, -1.0)
    best = int(np.argmax(ratio))
    name = body_names(robot.features_.model_)[joint]
    found = Pushed(joint=joint, name=name, kind=kind, share=share)
    if not ratio[best] > quantile(np.inf):
        return found
    at = own[best]
    return replace(
        found,
        parameter=robot.parameter_names_[at].rpartition(":")[2],
        unit=robot.parameter_units_[at],
        free=float(robot.theta_unconstrained_[at]),
        held=float(robot.theta_[at]),
        deviations=float(ratio[best]),
    )


def _channel(robot):
    """Joint without whose torques most constraints are not needed, and how much."""
    # (None, nan) if no joint stands out: its share has to be most of the cost, and
    # what is left without it less than half of what is left without any other.

    # The fit is repeated without the torques of each joint in turn.
    moments = robot.estimator_.statistics_
    weights = robot.estimator_.joint_weights_
    others = [j for j in concerned(robot) if weights[j] > 0]
    if not others or np.count_nonzero(weights > 0) < 2:
        return None, np.nan
    regressor = robot.regressor if from_moments(robot.regressor) else None

    def distance(weight):
        found = estimate(moments, regressor, joint_weights=weight)
        held = project(found, robot.projector, robot.features_, robot.effects_)
        return _distance(found.metric, found.theta, held.theta)

    whole, left = distance(weights), np.where(weights > 0, 1.0, np.inf)
    if not whole > 0:
        return None, np.nan
    for joint in others:
        weight = weights.copy()
        weight[joint] = 0.0
        left[joint] = distance(weight) / whole
    first, second = np.argsort(left)[:2]
    if left[first] < min(1.0 - _MOST, 0.5 * left[second]):
        return int(first), float(1.0 - left[first])
    return None, np.nan


# -- errors on the held-out part ------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Models:
    """The models of a loop, fitted to the search part."""

    # as declared, with the four plain terms, and with the effects as well
    declared: RobotIdentifier
    plain: RobotIdentifier
    judged: RobotIdentifier


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """Errors of the models of a loop on the held-out part."""

    # residuals of the declared model, with the plain terms, and of the completed one
    before: TorqueResiduals
    plain: TorqueResiduals
    after: TorqueResiduals
    # before and after on the search part, to which the models were fitted
    searched: tuple
    # (nv,): root mean squares after in a wider band [N m or N]; nan where there is none
    wide: np.ndarray
    wide_cutoff: float  # where that band ends [Hz]; nan where there is none
    # (nv,): spread of the torque in the moving time of the recording [N m or N]
    spread: np.ndarray
    # those of the errors before and after and their difference, see `error_intervals`;
    # "plain" and "added" are the error with the plain terms and what the effects add to
    # it
    intervals: dict
    seconds: np.ndarray  # (nv,): held-out time in which each joint moves [s]
    enough: np.ndarray  # (nv,): whether that is enough for an error
    n_stretches: int  # untouched ones
    # those left out since something jumps in them, the search cannot say when
    n_undecided: int
    guard: float  # time left out next to the search part [s]
    # what consistent parameters cost; None if they were not made consistent
    cost: ConsistencyCost | None
    spectra: tuple = ()  # of the residuals before and after, see `SpectrumCurves`
    # where the held-out part leaves what the completed model was fitted on
    outside: tuple = ()
    looked_at: int = 0  # see `RecordedMotion`
    # positions from commands alone, and the `TimeLine` of them; None without such
    alone: CommandsAlone | None = None
    positions: TimeLine | None = None

    @property
    def errors(self):
        """Errors before, plain and after over the torque's spread, ndarray (3, nv)."""
        parts = self.before, self.plain, self.after
        return np.array([part.relative_error(self.spread) for part in parts])


def judge(models, found, split, near, whole, commanded):
    """Judge the `Models` of a loop on the held-out part of a recording."""
    # They were fitted to the rows of the search, `found` is what it found there; near:
    # the split with those of these rows that it looked at; commanded: the recording
    # with the channels of its drive.
    completed = models.judged
    model, dt = found.model, completed.dt
    memory = max(memory_seconds(model), default=0.0)
    # Of a memory without end nothing is far enough.
    guard = int(min(memory / dt, whole.n_samples))
    shaped = [e for e in found.effects if isinstance(e, Shaped)]
    instants = [getattr(e, name) for e in shaped for name in e.jumping]
    count = len(split.stretches)
    kept = split.decided(whole.t, instants).guarded(guard)
    rows, rest = kept.stretches, kept.untouched(whole)

    three = models.declared, models.plain, completed
    wide_cutoff = _wide(completed.cutoff_, dt)
    bands = ["fit", wide_cutoff] if np.isfinite(wide_cutoff) else ["fit"]
    each, roots, of_all = {}, {}, None
    told, wide = (), np.full(whole.nv, np.nan)
    for one in dict.fromkeys(three):
        behind = one.robot_.residuals_behind(rest, bands)
        each[one] = _numbered(behind[0], rows)
        # Of the wide band, as large as a long recording, only sums are kept.
        for part in (_numbered(own, rows) for own in behind[1:]):
            if of_all is None:
                of_all = Spectra(part, dt, completed.cutoff_, wide_cutoff)
            roots[one] = of_all.of(part)
            if one is completed:
                wide = part.rms()
        del behind
    before, plain, after = (each[one] for one in three)
    step = model.view.step
    added = added_effects(completed, len(found.effects))
    fit = FinalFit(models.plain, completed, model.view.corrected(()), added)
    seen = near.searched_parts
    of_plain, of_completed = (_numbered(one, seen) for one in fit.residuals())
    of_declared = of_plain
    if models.declared is not models.plain:
        own = _numbered(models.declared.robot_.residuals_of(near.searched(whole)), seen)
        of_declared = replace(own, weight=of_plain.weight)
    searched = of_declared, of_completed
    fitted = of_plain
    if near is not split:
        fitted = models.plain.robot_.measured(split.searched(whole))
        # A joint whose channel carries no information counts nowhere here.
        heard = model.view.root.any(axis=0)
        fitted = replace(fitted, weight=fitted.weight * heard)
    spread = torque_spread(fitted, before)
    intervals = error_intervals((before, after), searched, spread, step)
    beyond = error_intervals((plain, after), (of_plain, of_completed), spread, step)
    intervals |= {"plain": beyond["before"], "added": beyond["difference"]}
    if of_all is not None:
        told = of_all.curves(roots[models.declared], roots[completed])
    # Rows in which a joint moves throughout have its largest weight.
    full = np.maximum(before.weight.max(axis=0), np.finfo(float).tiny)
    seconds = (before.weight / full).sum(axis=0) * step
    cutoff = min(completed.cutoff_, 0.5 / dt)
    cost = None
    if completed.projector_ is not None:
        free = without_constraints(completed).robot_.residuals_of(rest)
        of_free = fit.residuals_of(completed.theta_unconstrained_)
        cost = cost_of(
            completed,
            (_numbered(free, rows), after),
            (_numbered(of_free, seen), of_completed),
            spread,
            step,
        )
    alone, positions = commands_alone(models, rows, commanded)
    return Judgement(
        before=before,
        plain=plain,
        after=after,
        searched=searched,
        wide=wide,
        wide_cutoff=wide_cutoff,
        spread=spread,
        intervals=intervals,
        seconds=seconds,
        enough=2.0 * cutoff * seconds >= FEWEST_VALUES,
        n_stretches=len(kept.stretches),
        n_undecided=count - len(kept.stretches),
        guard=float(guard * dt),
        cost=cost,
        outside=completed.robot_.outside_of(rest),
        spectra=told,
        looked_at=_looked_at(model.view, split),
        alone=alone,
        positions=positions,
    )


def _looked_at(view, split):
    """Count the samples that a view has of the search part; 0 if all."""
    there = sum(part.stop - part.start for part in split.searched_parts)
    seen = view.states.shape[0]
    return seen if seen < there else 0


def _numbered(part, slices):
    """Count the rows of residuals of some slices in the whole recording."""
    edges = np.cumsum([0, *(s.stop - s.start for s in slices)])
    own = np.searchsorted(edges, part.index, side="right") - 1
    starts = np.array([s.start for s in slices])
    return TorqueResiduals(
        index=part.index - edges[own] + starts[own],
        torque=part.torque,
        predicted=part.predicted,
        weight=part.weight,
    )


def _wide(cutoff, dt):
    """End of the wider band [Hz]; nan where there is no room for it."""
    wide = min(max(_WIDER * cutoff, _CONTROL), _HIGHEST / dt)
    return wide if np.isfinite(cutoff) and wide > 1.1 * cutoff else np.nan
