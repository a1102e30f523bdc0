"""Parameters of a robot from a recording, as functions from one value to the next."""

import functools
import warnings
from dataclasses import dataclass, replace

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils.validation import has_fit_parameter

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa._core._runtime import say
from sklearn_vbjfa.effects import CommandDelay, InModel, TorqueLag
from sklearn_vbjfa.equations._equations import (
    accumulate,
    build_segments,
    equations,
    excluded_columns,
    is_load_free,
    regressor_rows,
    unexcited_entries,
)
from sklearn_vbjfa.equations._plan import (
    check_count,
    effect_indices,
    needs_load,
    observe,
)
from sklearn_vbjfa.equations._ranges import effect_ranges, sum_ranges
from sklearn_vbjfa.equations._states import RecordingStates
from sklearn_vbjfa.equations._torque_noise import common_waves, filtered_noise
from sklearn_vbjfa.fit._bodies import DESCRIBED
from sklearn_vbjfa.fit._estimate import (
    Estimate,
    PlainEstimate,
    beside_description,
    denoised,
    estimate,
    from_moments,
    identifiable,
    plain_estimate,
    project,
)
from sklearn_vbjfa.fit._gains import (
    common_gain,
    gain_places,
    relative_gains,
    with_gains,
)
from sklearn_vbjfa.fit._output_error import refine
from sklearn_vbjfa.fit._pooling import beside_each_other, with_positive_rotors
from sklearn_vbjfa.recording import Recording, check_delay, take_rows
from sklearn_vbjfa.robot._channels import ChannelGains
from sklearn_vbjfa.robot._posterior import known_parameters
from sklearn_vbjfa.robot._robot import IdentifiedRobot


@dataclass(frozen=True, kw_only=True, eq=False)
class FitData:
    """What a robot is fitted to."""

    recording: Recording
    states: RecordingStates
    numbering: object  # of the rows, see `assign_blocks`
    n_jobs: object = None

    @functools.cached_property
    def _kept(self):
        """Columns that no load changes, see `build_segments`."""
        return {}

    def segments(self, robot, **changes):
        plan = replace(robot.plan, **changes)
        return build_segments(
            self.recording,
            self.states,
            plan,
            robot.features_,
            theta=robot.load_parameters,
            cache=self._kept,
        )

    def instrumented(self, robot):
        """Equations of a robot, with instruments free of their noise, a list."""
        # The commanded motion, where a drive makes its torque of it (what commands add
        # to the torque, in units of the positions), else odd samples beside even ones.
        recording, estimator = self.recording, robot.plan.state_estimator
        if estimator is None:
            raise ValueError(
                "a regressor that takes instruments needs positions, whose even and "
                "odd samples are two measurements; got states. Pass positions, or "
                "another regressor."
            )
        feedback, parts = recording.feedback, recording.segments
        if feedback is None or not (feedback[0] > 0).all():
            q = recording.q
            both = zip(*[estimator.smooth_halves(q[x], x.start) for x in parts])
        else:
            command = recording.command / feedback[0]
            both = self.states.full, [estimator.smooth(command[x], 0) for x in parts]
        pieces = []
        for own in both:
            made = replace(self, states=RecordingStates(full=list(own)))
            pieces.append(equations(made.segments(robot), robot.plan.lowpass))
        # An equation counts only where the joint moves in both.
        x, z = pieces
        return [replace(x, weight=np.minimum(x.weight, z.weight), instruments=z.Phi)]

    def moments(self, made, plan):
        how = {"n_jobs": self.n_jobs, "numbering": self.numbering}
        return accumulate(made, plan.lowpass, **how)


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotFit:
    """A robot with its parameters, and what they were estimated from."""

    robot: IdentifiedRobot
    found: Estimate
    made: tuple = ()  # segments of the recording that was fitted
    criteria: object = None  # of a refinement by simulation
    # with the derivatives by values in the model as columns, where there are such
    tangents: Estimate | None = None

    @classmethod
    def of(cls, robot, found, shown, made=()):
        """Give a robot the parameters of an `Estimate`, of which some are `shown`."""
        through, rest = found.noise()
        features, ranges = robot.features_, found.moments.ranges
        robot = replace(
            robot,
            output_noise_=rest,
            noise_floor_=np.hypot(robot.torque_noise_, through),
            joint_weights=found.joint_weights,
            effect_ranges_=effect_ranges(features.friction_, robot.effects_, ranges),
            identifiable_=shown,
        )
        return cls(robot=robot, found=found, made=made).with_estimate(found)

    def with_estimate(self, found, **changes):
        C = found.covariance
        robot = replace(
            self.robot,
            theta_=found.theta,
            theta_unconstrained_=found.theta_unconstrained,
            theta_std_=found.std,
            # Symmetric to the last bit, of which a file holds one half.
            covariance=None if C is None else 0.5 * (C + C.T),
            **changes,
        )
        robot = replace(robot, known_=known_parameters(robot, found))
        return replace(self, robot=robot, found=found)

    def squares(self):
        """Weighted sums of squared residuals of the joints, (nv,)."""
        theta = self.robot.linear_part(self.found.theta_unconstrained)
        return self.found.moments.residual_squares(theta)

    def errors(self):
        """Root mean squares (nv,) of what the parameters leave of the torques."""
        moments, theta = self.found.moments, self.robot.linear_part(self.found.theta)
        return np.sqrt(moments.residual_squares(theta) / np.maximum(moments.n, 1.0))

    @property
    def torque_size(self):
        """Factor of all torques against the description, and its relative error."""
        bodies = self.found.bodies
        return (1.0, np.inf) if bodies is None else bodies.torque_size

    def with_loads(self):
        # Declared friction does not depend on the load; without effects it is not
        # needed.
        robot = self.robot
        if not robot.effects_:
            return self
        inertial = robot.inertial()
        torques = functools.partial(robot.features_.torques, inertial=inertial)
        load = sum_ranges([one.loads(robot.plan.lowpass, torques) for one in self.made])
        ranges = effect_ranges(
            robot.features_.friction_,
            robot.effects_,
            motion=self.found.moments.ranges,
            load=load,
        )
        return replace(self, robot=replace(robot, effect_ranges_=ranges))

    def with_noise_facts(self, facts):
        """Return the fit with the torque noise by `NoiseFacts` of all recordings."""
        if not facts:
            return self
        plan, (through, rest) = self.robot.plan, self.found.noise()
        left = np.hypot(through, rest)
        noise = filtered_noise(facts, plan.dt, plan.cutoff, left)
        floor = np.hypot(noise, through)
        found = {"torque_noise_": noise, "noise_floor_": floor}
        found["waves"] = common_waves(facts)
        return replace(self, robot=replace(self.robot, **found))


@dataclass(frozen=True, kw_only=True, eq=False)
class Recipe:
    """How parameters are estimated from equations, whatever robot makes them."""

    regressor: object = None
    joint_weights: object = "auto"
    projector: object = "default"
    bodies: str = "free"
    description: object = None  # that bodies are near, a `BodyPrior`
    gains: object = None
    masses: dict  # known ones [kg], by names of bodies
    alike: tuple = ()  # groups of joints with the same drive

    def of_moments(self, robot, moments, rows=(), made=()):
        # rows: the equations themselves, where second moments do not suffice.
        wanted = len(robot.parameter_names_)
        if self.description is not None and np.isinf(robot.plan.cutoff):
            # Independent rows, as poses are, need not determine what is described.
            wanted -= self.description.places.size
        check_count(moments, robot.standstill_, wanted)
        zeros = _unneeded_entries(robot, moments)
        found = estimate(
            moments.zeroed(zeros),
            self.regressor,
            joint_weights=self.joint_weights,
            rows=[one.zeroed(zeros) for one in rows],
            described=self.description is not None,
        )
        if self.description is not None:
            found = beside_description(found, self.description, self.bodies)
        if self.alike:
            found = beside_each_other(found, self.alike, robot)
        if self.description is not None:
            found = with_positive_rotors(found, robot)
        held = excluded_columns(robot.features_, robot.effects_)
        found = _without(found, held)
        say("consistent bodies")
        found = project(found, self.projector, robot.features_, robot.effects_)
        found = _without(found, held)
        return RobotFit.of(robot, found, self._shown(found), made)

    def of_source(self, robot, source):
        """Fit a robot to its recording, in parallel where second moments suffice."""
        made, rows = source.segments(robot), ()
        if not from_moments(self.regressor):
            if has_fit_parameter(self.regressor, "instruments"):
                rows = source.instrumented(robot)
            else:
                rows = [equations(made, robot.plan.lowpass)]
        return self.of_moments(robot, source.moments(made, robot.plan), rows, made)

    def _shown(self, found):
        """Parameters (p,), bool, that equations determine one by one."""
        if self.bodies != "fixed":
            return found.identifiable
        rest = ~found.from_description
        shown = np.zeros(rest.size, dtype=bool)
        shown[rest] = identifiable(found.metric[np.ix_(rest, rest)])
        return shown


def _unneeded_entries(robot, moments):
    """Entries of the regressor (nv, p) that nothing excites or effects hold."""
    zeros = unexcited_entries(moments, robot.features_.n_parameters_)
    zeros[:, excluded_columns(robot.features_, robot.effects_)] = True
    return zeros


def _without(found, held):
    """Return an estimate whose held columns, zero in the fit, have no coefficient."""
    theta, unconstrained = found.theta.copy(), found.theta_unconstrained.copy()
    theta[held] = unconstrained[held] = 0.0
    return replace(found, theta=theta, theta_unconstrained=unconstrained)


# -- the course of a fit ---------------------------------------------------------------


def fit_robot(recipe, robot, source, before=None):
    """Fit a robot to a recording: loads, gains and effects in the model settle."""
    # before: a fitted robot whose load the first pass may begin with, or None.
    relative = None
    if recipe.gains is not None:
        relative = _first_gains(recipe, robot, source)
        robot = _at(robot, with_gains(robot.effects_, relative.gains))
    load, passes = _load_of(before, robot), robot.plan.passes()
    if load is not None:
        # One that was fitted beside the same effects is the robot's.
        beside, own = (
            {(effect.key(), len(effect.coefficients)) for effect in one.effects_}
            for one in (before, robot)
        )
        passes = passes[-1:] if beside >= own else passes[1:]
    fit = run_passes(recipe, robot, source, relative, passes, load)
    steady = without_steps(fit.robot, source)
    if steady is not None:
        source, plan, load = steady, fit.robot.plan, fit.robot.load_parameters
        fit = run_passes(recipe, robot, source, relative, [plan], load)
    turned = with_corners(fit.robot, source)
    if turned is not None:
        fit = _with_turned(recipe, turned, source, relative, fit)
    return fit.with_loads()


def _with_turned(recipe, turned, source, relative, rounded):
    # The jump is that of a joint whose others are free, smoothed once: in a stiff loop,
    # behind a low cut-off, it may be off by more than what it corrects.
    load, fits = rounded.robot.load_parameters, [rounded]
    better = np.ones(turned.plan.standstill.size, dtype=bool)
    while better.any() and len(fits) < _MOST_TURNED:
        plan = replace(turned.plan, corners=np.where(better, turned.plan.corners, 0.0))
        robot = replace(turned, plan=plan)
        fits.append(run_passes(recipe, robot, source, relative, [plan], load))
        worse = better & (fits[-1].squares() > rounded.squares())
        if not worse.any():
            return _in_doubt(fits[-1], rounded)
        better &= ~worse
    return _in_doubt(rounded, fits[-1])


def _in_doubt(fit, other):
    """Add to what is not known a share of what corners moved, from another fit."""
    # They follow from dry friction that turns at once, at a joint whose others are
    # free. No drive is quite so, and all joints are off the same way, so that nothing
    # of it shows in how the residual scatters.
    found = fit.found
    std = found.std
    moved = DESCRIBED * (found.theta_unconstrained - other.found.theta_unconstrained)
    moved = np.where(std > 0, moved, 0.0)
    covariance = found.covariance
    if covariance is not None:
        covariance = covariance + np.outer(moved, moved)
    changed = {"std": np.hypot(std, moved), "covariance": covariance}
    return fit.with_estimate(replace(found, **changed))


def run_passes(recipe, robot, source, relative, passes, load):
    """Fit a robot until the loads and the values of its effects in the model stay."""
    for plan in passes:
        own = replace(robot, plan=plan, load_parameters=load)
        fit = recipe.of_source(own, source)
        load = fit.robot.parameters_of_load()
    if any(isinstance(effect, InModel) for effect in robot.effects_):
        fit = iterate_corrections(recipe, fit, source, relative)
    return fit


def _at(robot, effects):
    plan = replace(robot.plan, effects=effects)
    return replace(robot, features_=robot.features_.corrected(effects), plan=plan)


def _load_of(before, robot):
    """Load of a robot fitted before, also beside other effects; None if unknown."""
    if before is None or not needs_load(robot.effects_):
        return None
    if any(isinstance(effect, InModel) for effect in robot.effects_):
        return None
    if before.features_.friction_ != robot.features_.friction_:
        return None
    pieces = before.split(before.theta_)
    known = {effect.key(): own for effect, own in zip(before.effects_, pieces)}
    plain = []
    for effect in filter(is_load_free, robot.effects_):
        k = len(effect.coefficients)
        own = known.get(effect.key(), np.zeros(k))
        # The elements of another bank have the same friction together.
        plain.append(own if own.size == k else np.full(k, own.sum() / k))
    return np.concatenate([before.bodies(before.theta_).ravel(), *plain])


def _first_gains(recipe, robot, source):
    first = replace(robot, plan=robot.plan.passes()[0])
    moments = source.moments(source.segments(first), first.plan)
    units = [] if isinstance(recipe.gains, str) else list(recipe.gains)
    return relative_gains(
        moments.zeroed(_unneeded_entries(first, moments)),
        [robot.joint_names_.index(name) for name in units],
    )


def iterate_corrections(recipe, fit, source, relative):
    # relative: `RelativeGains` to begin with, or None.
    fit, values = _corrected(recipe, fit, source, relative)
    for effect in fit.robot.effects_:
        if isinstance(effect, CommandDelay):
            check_delay(effect.delay, source.recording)
    common = None
    if relative is not None:
        common, covariance = common_gain(
            recipe.masses, fit.robot, relative, values.estimate
        )
        if common.factor is not None:
            gains = common.factor * fit.robot.features_.gains_
            robot = _at(fit.robot, with_gains(fit.robot.effects_, gains))
            load = robot.load_parameters / common.factor
            fit = recipe.of_source(replace(robot, load_parameters=load), source)
    robot, found, own = fit.robot, fit.found, values.indices
    theta, unconstrained, std, shown = (
        one.copy()
        for one in (found.theta, found.theta_unconstrained, found.std)
        + (robot.identifiable_,)
    )
    held = [one.values for one in robot.effects_ if isinstance(one, InModel)]
    theta[own] = unconstrained[own] = np.concatenate(held)
    covariance_of_all = found.covariance
    # Both were estimated beside the same bodies.
    if found.bodies is None or not _of_bodies(robot):
        std, covariance_of_all = values.beside(std, covariance_of_all)
    std[own] = values.std
    gains = None
    if relative is not None:
        places = gain_places(robot.effects_, robot.features_.n_parameters_)
        if common.factor is not None:
            # What is one relative to itself is the factor.
            std[places[relative.references]] = 0.0
            units = robot.parameter_units_
            std = common.widened(theta, std, units, places, covariance)
        own_std = std[places]
        if common.factor is None:
            own_std[relative.references] = 0.0
        gains = ChannelGains(
            joint_names=robot.joint_names_,
            gain=theta[places],
            std=own_std,
            reference=relative.reference,
            common=common,
        )
    shown[own] = np.isfinite(std[own])
    corrected = replace(
        found,
        theta=theta,
        theta_unconstrained=unconstrained,
        std=std,
        covariance=covariance_of_all,
    )
    fit = fit.with_estimate(corrected, identifiable_=shown, gains_=gains)
    moments, weight = values.moments, found.joint_weights
    metric = denoised(moments.total(weight), moments.total_noise(weight))
    tangents = replace(found, metric=metric, moments=moments.in_stretches())
    return replace(fit, made=source.segments(fit.robot), tangents=tangents)


def _of_bodies(robot):
    return any(
        isinstance(effect, InModel) and effect.of_bodies for effect in robot.effects_
    )


def _corrected(recipe, fit, source, relative):
    """Correct a robot step by step; the last fit and its `ModelValues`."""
    # The equations with the derivatives by the values are, without these, those of the
    # next fit: its load is that of the fit before.
    corrected, factor, before, stayed = fit.robot, 1.0, 0.0, False
    loaded = needs_load(corrected.effects_)
    for number in range(MOST_CORRECTIONS):
        robot = replace(corrected, load_parameters=fit.robot.parameters_of_load())
        made = source.segments(robot, tangents=True)
        moments = source.moments(made, robot.plan)
        if number and loaded:
            fit = _fitted_again(recipe, robot, source, moments)
        zeros = _unneeded_entries(robot, moments)
        n_rigid = robot.features_.n_parameters_
        if relative is not None:
            zeros[:, gain_places(robot.effects_, n_rigid)[relative.held]] = True
        # Beside bodies that are held, a value of the geometry would stay where it is.
        bodies = None if _of_bodies(robot) else fit.found.bodies
        values = ModelValues.of(
            moments.zeroed(zeros),
            robot.effects_,
            n_rigid=n_rigid,
            joint_weights=recipe.joint_weights,
            bodies=bodies,
        )
        # The load follows the values one fit later.
        if values.stay() and (stayed or not (loaded and number)):
            break
        stayed = values.stay()
        factor, before = values.longer(factor, before), values.step
        corrected = _at(robot, values.corrected(factor))
    else:
        names = [
            effect.name for effect in values.effects if isinstance(effect, InModel)
        ]
        warnings.warn(
            f"The values of {', '.join(dict.fromkeys(names))} did not converge in "
            f"{MOST_CORRECTIONS} corrections (nearly equal columns). Declare fewer.",
            ConvergenceWarning,
            stacklevel=6,
        )
    if number and not loaded:
        fit = _fitted_again(recipe, robot, source, moments)
    robot = replace(fit.robot, load_parameters=fit.robot.parameters_of_load())
    return replace(fit, robot=robot), values


def _fitted_again(recipe, robot, source, moments):
    """Fit a corrected robot to moments that have derivatives by its values as well."""
    if not from_moments(recipe.regressor):
        return recipe.of_source(robot, source)
    held = robot.linear_part(np.ones(moments.g.shape[1])) == 0.0
    plain = moments.zeroed(np.broadcast_to(held, moments.g.shape))
    return recipe.of_moments(robot, plain, made=source.segments(robot))


# -- refinement by simulation ----------------------------------------------------------


def refine_fit(recipe, fit, source, window):
    robot = fit.robot
    # Values of effects in the model have no columns there.
    found = recipe.of_source(robot, source).found
    found = replace(found, std=robot.theta_std_)
    recorded = source.recording, source.states
    found, criteria = refine(robot, found, *recorded, window, recipe.projector)
    ranges = robot.effect_ranges_
    fit = RobotFit.of(robot, found, robot.identifiable_, fit.made)
    robot = replace(fit.robot, effect_ranges_=ranges)
    return replace(fit, robot=robot, criteria=criteria)


# -- values of effects that are part of the robot model, by Gauss and Newton -----------

# The torque is linear in the parameters of the bodies and not in a tilt of the base or
# the gain of a channel. With the derivatives by these values as columns, all are fitted
# by least squares and the regressor is made anew, until no value moves by more than a
# tenth of its standard error. A prior would hold each value where it began.


# A value stays where a correction is smaller than this share of its standard error.
STAYS = 0.1
# ... or than this share of the range of plausible values, which is rounding.
_ROUNDING = 1e-10
# Corrections of one fit.
MOST_CORRECTIONS = 12
# Of a correction that would lead out of the plausible values, this share of the way.
_SHORT = 0.9
# A value is at the end of its range where it is within this share of it.
_END = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelValues:
    """What a fit says of the values of effects that are in the model."""

    effects: tuple  # all effects of the fit
    indices: np.ndarray  # where those values are among the parameters
    # corrections of the values; zero where the recording does not show them
    step: np.ndarray
    std: np.ndarray  # of the values; nan where the recording does not show them
    # estimate of everything, with corrections in the places of the values
    estimate: PlainEstimate | None = None
    moments: object = None  # of the equations, with derivatives by the values

    @classmethod
    def of(cls, moments, effects, n_rigid, joint_weights, bodies=None):
        # Columns of the moments are those of the features, `n_rigid` of them, and then
        # those of the effects, with derivatives by the values; bodies: as for
        # `plain_estimate`.
        every = effect_indices(effects, n_rigid)
        places = [
            place for effect, at in every if isinstance(effect, InModel) for place in at
        ]
        found = plain_estimate(moments, joint_weights, bodies)
        shown = found.known[places]
        return cls(
            effects=tuple(effects),
            indices=np.array(places),
            step=np.where(shown, found.theta[places], 0.0),
            std=np.where(shown, found.std[places], np.nan),
            estimate=found,
            moments=moments,
        )

    def stay(self):
        """Whether no value moves by more than a tenth of its standard error."""
        # One at the end of what is plausible stays where it would go on outwards.
        own = [effect for effect in self.effects if isinstance(effect, InModel)]
        low, high = (np.concatenate(x) for x in zip(*[e.bounds() for e in own]))
        with np.errstate(invalid="ignore"):
            least = np.maximum(STAYS * self.std, _ROUNDING * (high - low))
            moves = np.abs(self.step) > least
        below, above = (np.concatenate(x) for x in zip(*map(_at_bounds, own)))
        out = (below & (self.step < 0)) | (above & (self.step > 0))
        return not (moves & ~out).any()

    def beside(self, std, covariance):
        """Add to deviations (p,) and a covariance what the values leave unknown."""
        # The others were estimated with the values as found, and move with them, as
        # their columns are alike.
        std, shown = std.copy(), np.isfinite(self.std)
        # What is held as described does not move.
        own, rest = self.indices[shown], std > 0
        rest[self.indices] = False
        within = self.estimate.covariance[np.ix_(own, own)]
        inverse = self.estimate.eigen.inverse()[:, own]
        slope = np.linalg.solve(inverse[own], inverse[rest].T).T
        moved = np.einsum("ik,kl,il->i", slope, within, slope)
        std[rest] = np.hypot(std[rest], np.sqrt(moved))
        if covariance is not None:
            covariance = covariance.copy()
            covariance[np.ix_(rest, rest)] += slope @ within @ slope.T
            covariance[self.indices] = covariance[:, self.indices] = 0.0
            # Of a value that the recording does not show nothing is known.
            covariance[self.indices, self.indices] = np.inf
            covariance[np.ix_(own, own)] = within
            across = slope @ within
            covariance[np.ix_(rest, own)] = across
            covariance[np.ix_(own, rest)] = across.T
        return std, covariance

    def longer(self, factor, before):
        """Factors (k,) of the steps, twice those of the last if these lead on."""
        # Noise in a derivative, such as that of a recorded torque, shortens the steps.
        leads_on = np.abs(self.step) > 0.5 * np.abs(before)
        return np.where(leads_on & (self.step * before > 0), 2.0 * factor, 1.0)

    def corrected(self, factor):
        """Return the effects with corrected values, within those that are plausible."""
        found, at = [], 0
        for effect in self.effects:
            if isinstance(effect, InModel):
                own = slice(at, at + len(effect.coefficients))
                step = (factor * self.step)[own]
                at += len(effect.coefficients)
                effect = effect.linearised_at(_within(effect, step))
            found.append(effect)
        return tuple(found)


def _at_bounds(effect):
    """Which values are at their lower and at their upper bounds, two arrays (k,)."""
    low, high = effect.bounds()
    # A gain has more room above 1 than below.
    below, above = effect.nominal - low, high - effect.nominal
    near = 2 * _END
    return effect.values < low + near * below, effect.values > high - near * above


def _within(effect, step):
    low, high = effect.bounds()
    room = np.where(step > 0, high, low) - effect.values
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(step == 0, np.inf, room / np.where(step == 0, 1.0, step))
    return step if share.min() >= 1 else _SHORT * max(share.min(), 0.0) * step


# -- lag of all torques ----------------------------------------------------------------

# Blocks of rows that are looked at, their length, in rows and in lengths of the
# low-pass, and deviations from which on a lag is looked for in earnest.
_BLOCKS, _BLOCK_ROWS, _BLOCK_FILTERS, _SUSPECT = 4, 1000, 10, 4.0


def seems_late(recipe, fit, source):
    """Whether a few rows of a recording suggest that all torques are late, or early."""
    robot, recording = fit.robot, source.recording
    plan, effects = robot.plan, (*robot.effects_, TorqueLag())
    length = max(_BLOCK_ROWS, 2 * _BLOCK_FILTERS * plan.lowpass.half)
    rows = [
        slice(int(at), int(at) + length)
        for part in recording.segments
        for at in np.linspace(part.start, part.stop - length, _BLOCKS)
        if part.stop - part.start > length
    ]
    rows = rows[:: max(len(rows) // _BLOCKS, 1)] or list(recording.segments)[:_BLOCKS]
    some = take_rows(recording, rows, range(len(rows)))
    states, _ = observe(some, plan.state_estimator, False, source.n_jobs)
    robot = replace(robot, plan=replace(plan, effects=effects))
    few = replace(source, recording=some, states=states, numbering=None)
    moments = few.moments(few.segments(robot, tangents=True), plan)
    if moments is None:
        return False
    zeros = _unneeded_entries(robot, moments)
    values = ModelValues.of(
        moments.zeroed(zeros),
        effects,
        n_rigid=robot.features_.n_parameters_,
        joint_weights=recipe.joint_weights,
    )
    return bool(np.abs(values.step[-1]) > _SUSPECT * values.std[-1])


# -- corners and steps -----------------------------------------------------------------

# Rows at which the inertia of a joint is looked at.
_ROWS = 64
# Of a sample period: delay that a ripple may look like without a new fit.
_LEAST_RIPPLE = 5e-4
# Fits with corners, the one without included.
_MOST_TURNED = 3
# Frequencies of the integral, in cut-offs: what lies beyond is a share of 1e-3.
_LOWEST, _HIGHEST, _COUNT = 0.1, 1e3, 4000


def with_corners(robot, source):
    """Return a fitted robot whose plan knows its corners, None where there are none."""
    # Of drives whose law is known. Torques that are measured belong to controllers
    # which nothing is known of, and may take the jump away.
    plan = robot.plan
    estimator, feedback = plan.state_estimator, source.recording.feedback
    if feedback is None or estimator is None:
        return None
    terms, inertia = _joints_of(robot, source)
    recording = source.recording
    command = recording.command + recording.torques(plan.delay) - recording.tau
    own = source.states.full, plan, robot.features_
    rows = regressor_rows(recording, *own, theta=robot.load_parameters)
    torques = [np.concatenate([x.effects(robot.theta_) for x in rows]), command]
    further, commanded = _jumps_of(torques, robot, source)
    dry = terms["coulomb"] + further
    if not dry.any():
        return None
    # Friction that is commanded ahead takes the jump away.
    dry = np.maximum(dry - commanded, 0.0)
    damping = feedback[1] + np.maximum(terms["viscous"], 0.0)
    jumps = [
        jump(*own) for own in zip(dry, inertia, damping, feedback[0], estimator.cutoff_)
    ]
    return replace(robot, plan=replace(plan, corners=np.array(jumps)))


def without_steps(robot, source):
    """Return a source whose torques are free of the response to steps of commands."""
    # A joint answers each step of a held command by a ripple, which sampled positions
    # hide: the double integral of a sawtooth B1, by the Bernoulli polynomials B3 and,
    # for the damping, B4, times the slope of the command. None where it is too small.
    recording, dt = source.recording, source.recording.dt
    if recording.feedback is None or robot.plan.state_estimator is None:
        return None
    terms, inertia = _joints_of(robot, source)
    phase = robot.plan.delay / dt % 1.0
    third = phase * (phase - 0.5) * (phase - 1.0) * dt**3 / 6.0
    fourth = ((phase * (phase - 1.0)) ** 2 - 1.0 / 30.0) * dt**4 / 24.0
    inertia = np.where(inertia > 0, inertia, np.inf)
    stiffness, damping = recording.feedback
    losses = damping + np.maximum(terms["viscous"], 0.0)
    size = (third + losses / inertia * fourth) / inertia
    if (stiffness * np.abs(size) < _LEAST_RIPPLE * dt).all():
        return None
    parts, clock = recording.segments, recording.clock
    position, speed = (
        size
        * _smoothing.interpolate(recording.command, parts, clock, robot.plan.delay, k)
        for k in (1, 2)
    )
    recording = replace(
        recording,
        q=recording.q - position,
        tau=recording.tau + stiffness * position + damping * speed,
    )
    halves = source.states.halves is not None
    states, _ = observe(recording, robot.plan.state_estimator, halves, source.n_jobs)
    return replace(source, recording=recording, states=states)


def jump(dry, inertia, damping, stiffness, cutoff):
    """Half of the jump of an acceleration that rounds a velocity as the drive does."""
    if not (np.isfinite(cutoff) and inertia > 0 and dry > 0):
        return 0.0
    x = np.geomspace(_LOWEST, _HIGHEST, _COUNT)
    omega = 2 * np.pi * cutoff * x
    lost = x**10 / (1 + x**10)
    answer = 1.0 / (inertia * omega**2 - stiffness - 1j * damping * omega)
    late = 2 * dry / np.pi * np.trapezoid(lost * answer.real, omega)
    return max(late, 0.0) / _smoothing.rounding(cutoff)


def _jumps_of(torques, robot, source):
    """Half of the jump (nv,) that each of some torques (n, nv) makes at turns."""
    # Of what the smoother leaves out of it, the part that goes with what it leaves out
    # of the signs.
    estimator, groups = robot.plan.state_estimator, source.recording.groups
    nv = source.recording.nv
    speed = np.concatenate([own[slice(None)] for own in source.states.full])
    signs = np.sign(speed.reshape(len(speed), -1)[:, nv : 2 * nv])
    signs, *torques = (
        x - estimator.transform(x, groups=groups)[:, :nv] for x in (signs, *torques)
    )
    power = (signs**2).sum(axis=0)
    power = np.where(power > 0, power, 1.0)
    return [(torque * signs).sum(axis=0) / power for torque in torques]


def _joints_of(robot, source):
    """Friction (nv,) by name, and inertia (nv,) of each joint while others are free."""
    # The inertia is the mean of poses. Columns of the inertia matrix are torques that
    # accelerations ask for: bodies that were fitted need not be physical.
    nv, features = source.recording.nv, robot.features_
    terms = dict.fromkeys(("coulomb", "viscous", "rotor_inertia"), np.zeros(nv))
    terms |= dict(zip(features.friction_, robot.bodies(robot.theta_)[:, 10:].T))
    rotors = np.diag(np.maximum(terms["rotor_inertia"], 0.0))
    a, found = np.vstack([np.zeros(nv), np.eye(nv)]), []
    for own in source.states.full:
        for i in np.unique(np.linspace(0, own.shape[0] - 1, _ROWS).astype(int)):
            q = np.tile(own[slice(i, i + 1)].reshape(-1)[:nv], (nv + 1, 1))
            still, *columns = features.torques(q, 0.0 * a, a, robot.inertial())
            mass = np.array(columns) - still + rotors
            found.append(1.0 / np.diagonal(np.linalg.pinv(mass)))
    return terms, np.mean(found, axis=0)
