"""Fit the parameters of a robot to a recording."""

import warnings
from dataclasses import dataclass, field, replace

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils.validation import has_fit_parameter

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa._core._runtime import say
from sklearn_vbjfa.effects import CommandDelay, InModel, TorqueLag
from sklearn_vbjfa.equations._checks import check_count
from sklearn_vbjfa.equations._equations import (
    accumulate,
    build_segments,
    equations,
    excluded_columns,
    is_load_free,
    regressor_rows,
    unexcited_entries,
)
from sklearn_vbjfa.equations._joint_moments import BlockAssignment
from sklearn_vbjfa.equations._motion_facts import estimate_states
from sklearn_vbjfa.equations._plan import effect_indices, needs_load
from sklearn_vbjfa.equations._ranges import effect_ranges, sum_ranges
from sklearn_vbjfa.equations._states import RecordingStates
from sklearn_vbjfa.equations._torque_noise import common_waves, filtered_noise
from sklearn_vbjfa.fit._bodies import BodyPrior
from sklearn_vbjfa.fit._estimate import (
    Estimate,
    PlainEstimate,
    apply_description,
    denoised,
    estimate,
    from_moments,
    identifiable,
    plain_estimate,
    project,
    uninflated_covariance,
)
from sklearn_vbjfa.fit._gains import (
    RelativeGains,
    common_gain,
    gain_indices,
    relative_gains,
    with_gains,
)
from sklearn_vbjfa.fit._output_error import refine
from sklearn_vbjfa.fit._rotor_prior import with_positive_rotors
from sklearn_vbjfa.fit._shared_drives import pool_joint_values
from sklearn_vbjfa.recording import Recording, check_delay, take_rows
from sklearn_vbjfa.robot._channels import ChannelGains
from sklearn_vbjfa.robot._posterior import body_indices, joint_mask, known_parameters
from sklearn_vbjfa.robot._robot import IdentifiedRobot


@dataclass(frozen=True, kw_only=True, eq=False)
class FitData:
    """Recording, states and blocks of rows to which a robot is fitted."""

    recording: Recording
    states: RecordingStates
    blocks: BlockAssignment | None  # of the rows, see `assign_blocks`
    n_jobs: object = None
    # cache of columns that do not depend on the load, see `build_segments`
    load_free: dict = field(default_factory=dict, init=False)

    def segments(self, robot, **changes):
        return build_segments(
            self.recording,
            self.states,
            replace(robot.plan, **changes),
            robot.features_,
            theta=robot.load_parameters,
            cache=self.load_free,
        )

    def instrumental_equations(self, robot):
        """Return the equations of a robot with instruments, a list."""
        # Instruments, with independent noise, are the commanded motion if a feedback
        # law produces the torques, else odd samples (and even ones for regressors).
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
            motions = zip(*[estimator.smooth_halves(q[x], x.start) for x in parts])
        else:
            command = recording.command / feedback[0]
            motions = self.states.full, [estimator.smooth(command[x], 0) for x in parts]
        equation_sets = []
        for motion in motions:
            data = replace(self, states=RecordingStates(full=list(motion)))
            equation_sets.append(equations(data.segments(robot), robot.plan.lowpass))
        # Use an equation only where the joint moves in both measurements.
        x, z = equation_sets
        return [replace(x, weight=np.minimum(x.weight, z.weight), instruments=z.Phi)]

    def moments(self, segments, plan):
        settings = {"n_jobs": self.n_jobs, "blocks": self.blocks}
        return accumulate(segments, plan.lowpass, **settings)


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotFit:
    """A robot with its parameters, and the estimate that they come from."""

    robot: IdentifiedRobot
    estimate: Estimate
    segments: tuple = ()  # of the fitted recording
    criteria: object = None  # of a refinement by simulation
    # estimate whose moments include the derivatives by values in the model, if any
    full_estimate: Estimate | None = None

    @classmethod
    def of(cls, robot, result, identified, segments=()):
        """Give a robot the parameters of an `Estimate`."""
        # identified: (p,), bool; segments: of the recording.
        input_std, output_std = result.noise()
        robot = replace(
            robot,
            output_noise_=output_std,
            noise_floor_=np.hypot(robot.torque_noise_, input_std),
            joint_weights=result.joint_weights,
            identifiable_=identified,
        )
        return cls(robot=robot, estimate=result, segments=segments).with_estimate(
            result
        )

    def with_estimate(self, result, **changes):
        C = result.covariance
        robot = replace(
            self.robot,
            theta_=result.theta,
            theta_unconstrained_=result.theta_unconstrained,
            theta_std_=result.marginal_std,
            # Exactly symmetric, since a file stores one triangle.
            covariance=None if C is None else 0.5 * (C + C.T),
            **changes,
        )
        robot = replace(robot, known_=known_parameters(robot, result))
        return replace(self, robot=robot, estimate=result)

    def squares(self):
        """Return the weighted sum of squared residuals of each joint, (nv,)."""
        theta = self.robot.linear_part(self.estimate.theta_unconstrained)
        return self.estimate.moments.residual_squares(theta)

    def errors(self):
        """Return the RMS of the torque residual of each joint, (nv,)."""
        sums, theta = self.estimate.moments, self.robot.linear_part(self.estimate.theta)
        return np.sqrt(sums.residual_squares(theta) / np.maximum(sums.n, 1.0))

    @property
    def torque_size(self):
        """Common factor of all torques over the description, and its relative error."""
        bodies = self.estimate.bodies
        return (1.0, np.inf) if bodies is None else bodies.torque_size

    def with_ranges(self):
        """Set the ranges of signals on which friction and effects were fitted."""
        robot, load = self.robot, None
        if robot.effects_:
            # Declared friction does not depend on the load.
            loads = (x.loads(robot.plan.lowpass, robot.rigid) for x in self.segments)
            load = sum_ranges(list(loads))
        motion, friction = self.estimate.moments.ranges, robot.features_.friction_
        ranges = effect_ranges(friction, robot.effects_, motion, load)
        return replace(self, robot=replace(robot, effect_ranges_=ranges))

    def with_noise_facts(self, facts):
        """Set the torque noise from the `NoiseFacts` of all recordings."""
        if not facts:
            return self
        plan, (input_std, output_std) = self.robot.plan, self.estimate.noise()
        residual_std = np.hypot(input_std, output_std)
        noise = filtered_noise(facts, plan.dt, plan.cutoff, residual_std)
        floor = np.hypot(noise, input_std)
        attributes = {"torque_noise_": noise, "noise_floor_": floor}
        attributes["waves"] = common_waves(facts)
        return replace(self, robot=replace(self.robot, **attributes))


@dataclass(frozen=True, kw_only=True, eq=False)
class Recipe:
    """Settings of the estimation, and the initial gains of unknown channels."""

    regressor: object = None
    joint_weights: object = "auto"
    projector: object = "default"
    bodies: str = "free"
    body_prior: BodyPrior | None = None
    gains: object = None
    relative: RelativeGains | None = None  # where the iteration of the gains begins
    masses: dict  # known masses [kg] by body name
    shared_drives: tuple = ()  # groups of joints with the same drive

    def fit_moments(self, robot, moments, rows=(), segments=()):
        # rows: the equations, if the regressor needs more than second moments.
        n_required = len(robot.parameter_names_)
        if self.body_prior is not None and np.isinf(robot.plan.cutoff):
            # Independent rows (poses) need not determine the described parameters.
            n_required -= self.body_prior.indices.size
        check_count(moments, robot.standstill_, n_required)
        zeros = _zero_entries(robot, moments)
        result = estimate(
            moments.zeroed(zeros),
            self.regressor,
            joint_weights=self.joint_weights,
            rows=[piece.zeroed(zeros) for piece in rows],
            described=self.body_prior is not None,
        )
        if self.body_prior is not None:
            result = apply_description(result, self.body_prior, self.bodies)
        if self.shared_drives:
            result = pool_joint_values(result, self.shared_drives, robot)
        if self.body_prior is not None:
            result = with_positive_rotors(result, robot)
        result = _with_load_uncertainty(result, robot)
        excluded = excluded_columns(robot.features_, robot.effects_)
        result = _zero_excluded(result, excluded)
        say("consistent bodies")
        result = project(result, self.projector, robot.features_, robot.effects_)
        result = _zero_excluded(result, excluded)
        # Which parameters the equations determine individually.
        free = self.bodies != "fixed" or ~result.from_description
        determined = identifiable(result.metric, free)
        return RobotFit.of(robot, result, determined, segments)

    def fit_data(self, robot, data):
        """Fit a robot to its recording, in parallel if second moments suffice."""
        segments, rows = data.segments(robot), ()
        if not from_moments(self.regressor):
            if has_fit_parameter(self.regressor, "instruments"):
                rows = data.instrumental_equations(robot)
            else:
                rows = [equations(segments, robot.plan.lowpass)]
        moments = data.moments(segments, robot.plan)
        return self.fit_moments(robot, moments, rows, segments)


def _zero_entries(robot, moments):
    """Return the entries (nv, p) that are not excited or that effects exclude."""
    zeros = unexcited_entries(moments, robot.features_.n_parameters_)
    zeros[:, excluded_columns(robot.features_, robot.effects_)] = True
    return zeros


def _with_load_uncertainty(result, robot):
    """Add the uncertainty of the load to that of coefficients which multiply it."""
    # To first order, a relative error of the load is minus that of the coefficient.
    if result.covariance is None or not needs_load(robot.effects_):
        return result
    C, ratio = uninflated_covariance(result)
    theta, slope, nv = result.theta, np.eye(len(C)), robot.features_.n_joints_
    at, load = body_indices(robot).ravel(), np.zeros(len(C))
    load[at] = theta[at]
    products = result.moments.products(load)
    n_rigid = robot.features_.n_parameters_
    for effect, indices in effect_indices(robot.effects_, n_rigid):
        row = products[effect.acts_on(nv)].sum(axis=0)
        if effect.needs == ("load",) and row @ load > 0:
            relative = row[at] / (row @ load)
            slope[np.ix_(indices, at)] = -np.outer(theta[indices], relative)
    std = np.sqrt(np.diagonal((slope * ratio) @ C @ (slope * ratio).T))
    std = np.where(np.isfinite(result.std), std, result.std)
    C = np.where(np.isfinite(result.covariance), slope @ C @ slope.T, np.inf)
    return replace(result, std=std, covariance=C)


def _zero_excluded(result, excluded):
    """Set the coefficients of excluded columns, which are zero in the fit, to zero."""
    theta, unconstrained = result.theta.copy(), result.theta_unconstrained.copy()
    theta[excluded] = unconstrained[excluded] = 0.0
    return replace(result, theta=theta, theta_unconstrained=unconstrained)


# -- passes of a fit -------------------------------------------------------------------


def fit_robot(recipe, robot, data, previous):
    """Fit a robot to a recording, iterating loads, gains and effects in the model."""
    # previous: a fitted robot whose load initialises the first pass, or None.
    if recipe.gains is not None:
        relative = _initial_gains(recipe, robot, data)
        recipe = replace(recipe, relative=relative)
        robot = _with_effects(robot, with_gains(robot.effects_, relative.gains))
    load, passes = _initial_load(previous, robot), robot.plan.passes()
    if load is not None:
        # The load of a robot fitted with the same effects needs one pass only.
        previous_effects, effects = (
            {(effect.key(), len(effect.coefficients)) for effect in model.effects_}
            for model in (previous, robot)
        )
        passes = passes[-1:] if previous_effects >= effects else passes[1:]
    fit = run_passes(recipe, robot, data, passes, load)
    corrected = without_command_ripple(fit.robot, data)
    if corrected is not None:
        data, plan, load = corrected, fit.robot.plan, fit.robot.load_parameters
        fit = run_passes(recipe, robot, data, [plan], load)
    corners = velocity_corners(fit.robot, data)
    if corners is not None:
        fit = _fit_with_corners(recipe, fit, data, corners)
    return fit.with_ranges()


def _fit_with_corners(recipe, smooth, data, corners):
    # smooth: the fit without corners. The corners (nv,) assume free other joints; in a
    # stiff loop with a low cut-off their error may exceed the correction. Joints whose
    # residual grows are not corrected.
    robot, load, fits = smooth.robot, smooth.robot.load_parameters, [smooth]
    joints = np.ones(corners.size, dtype=bool)
    while joints.any() and len(fits) < _MAX_CORNER_FITS:
        plan = replace(robot.plan, corners=np.where(joints, corners, 0.0))
        fits.append(run_passes(recipe, robot, data, [plan], load))
        worse = joints & (fits[-1].squares() > smooth.squares())
        if not worse.any():
            return _inflate_covariance(fits[-1], smooth)
        joints &= ~worse
    return _inflate_covariance(smooth, fits[-1])


def _inflate_covariance(fit, other):
    """Inflate the covariance by part of the corner correction, from two fits."""
    # The correction assumes Coulomb friction that reverses instantly, and free other
    # joints. Its error has the same sign in all joints, so the scatter of the residual
    # between blocks of time does not reveal it.
    result, std, covariance = fit.estimate, fit.estimate.std, fit.estimate.covariance
    step = _CORNER_ERROR * (
        result.theta_unconstrained - other.estimate.theta_unconstrained
    )
    step = np.where(std > 0, step, 0.0)
    if covariance is not None:
        covariance = covariance + np.outer(step, step)
    changes = {"std": np.hypot(std, step), "covariance": covariance}
    return fit.with_estimate(replace(result, **changes))


def run_passes(recipe, robot, data, passes, load):
    """Fit a robot with each plan in turn, then iterate the values in the model."""
    for plan in passes:
        trial = replace(robot, plan=plan, load_parameters=load)
        fit = recipe.fit_data(trial, data)
        load = fit.robot.next_load_parameters()
    if any(isinstance(effect, InModel) for effect in robot.effects_):
        fit = iterate_corrections(recipe, fit, data)
    return fit


def _with_effects(robot, effects):
    plan = replace(robot.plan, effects=effects)
    return replace(robot, features_=robot.features_.corrected(effects), plan=plan)


def _initial_load(previous, robot):
    """Return the load parameters of a robot fitted before; None if unknown."""
    in_model = any(isinstance(effect, InModel) for effect in robot.effects_)
    if previous is None or in_model or not needs_load(robot.effects_):
        return None
    if previous.features_.friction_ != robot.features_.friction_:
        return None
    pieces = previous.split(previous.theta_)
    by_key = {effect.key(): values for effect, values in zip(previous.effects_, pieces)}
    loads = []
    for effect in filter(is_load_free, robot.effects_):
        k = len(effect.coefficients)
        values = by_key.get(effect.key(), np.zeros(k))
        # A bank with another number of elements has the same total friction.
        loads.append(values if values.size == k else np.full(k, values.sum() / k))
    return np.concatenate([previous.bodies(previous.theta_).ravel(), *loads])


def _initial_gains(recipe, robot, data):
    first_pass = replace(robot, plan=robot.plan.passes()[0])
    moments = data.moments(data.segments(first_pass), first_pass.plan)
    units = [] if isinstance(recipe.gains, str) else list(recipe.gains)
    return relative_gains(
        moments.zeroed(_zero_entries(first_pass, moments)),
        [robot.joint_names_.index(name) for name in units],
    )


def iterate_corrections(recipe, fit, data):
    fit, values = _correct_values(recipe, fit, data)
    for effect in fit.robot.effects_:
        if isinstance(effect, CommandDelay):
            check_delay(effect.delay, data.recording)
    relative, common = recipe.relative, None
    if relative is not None:
        common, gain_covariance = common_gain(
            recipe.masses, fit.robot, relative, values.estimate
        )
        if common.factor is not None:
            gains = common.factor * fit.robot.features_.gains_
            robot = _with_effects(fit.robot, with_gains(fit.robot.effects_, gains))
            load = robot.load_parameters / common.factor
            fit = recipe.fit_data(replace(robot, load_parameters=load), data)
    robot, result, indices = fit.robot, fit.estimate, values.indices
    arrays = result.theta, result.theta_unconstrained, result.std, robot.identifiable_
    theta, unconstrained, std, identified = map(np.copy, arrays)
    present_values = [x.values for x in robot.effects_ if isinstance(x, InModel)]
    theta[indices] = unconstrained[indices] = np.concatenate(present_values)
    covariance = result.covariance
    # Values and parameters were estimated with the same prior on the bodies.
    if result.bodies is None or not _changes_bodies(robot):
        std, covariance = values.add_uncertainty(std, covariance)
    std[indices] = values.std
    gains = None
    if relative is not None:
        columns = gain_indices(robot.effects_, robot.features_.n_parameters_)
        if common.factor is not None:
            # The error of the gain of a reference is that of the common factor.
            std[columns[relative.references]] = 0.0
            units = robot.parameter_units_
            std = common.widened(theta, std, units, columns, gain_covariance)
        # All parameters of a joint depend on its gain.
        vague = relative.vague(theta[columns], std[columns])
        lost = joint_mask(robot, vague)
        std[lost], std[columns[vague]], identified[lost] = np.inf, np.nan, False
        gain_std = std[columns]
        if common.factor is None:
            gain_std[relative.references] = 0.0
        gains = ChannelGains(
            joint_names=robot.joint_names_,
            gain=theta[columns],
            std=gain_std,
            reference=relative.reference,
            common=common,
        )
    identified[indices] = np.isfinite(std[indices])
    changes = {"theta": theta, "theta_unconstrained": unconstrained, "std": std}
    corrected = replace(result, **changes, covariance=covariance)
    fit = fit.with_estimate(corrected, identifiable_=identified, gains_=gains)
    moments, weight = values.moments, result.joint_weights
    metric = denoised(moments.total(weight), moments.total_noise(weight))
    full = replace(result, metric=metric, moments=moments.in_stretches())
    return replace(fit, segments=data.segments(fit.robot), full_estimate=full)


def _changes_bodies(robot):
    return any(isinstance(x, InModel) and x.of_bodies for x in robot.effects_)


def _correct_values(recipe, fit, data):
    """Iterate the values in the model; return the last fit and its `ModelValues`."""
    # Equations with derivative columns also serve the next fit, which omits these
    # columns and takes the load of the fit before.
    corrected, factors, last_step, had_converged = fit.robot, 1.0, 0.0, False
    loaded = needs_load(corrected.effects_)
    for iteration in range(MAX_CORRECTIONS):
        robot = replace(corrected, load_parameters=fit.robot.next_load_parameters())
        segments = data.segments(robot, tangents=True)
        moments = data.moments(segments, robot.plan)
        if iteration and loaded:
            fit = _refit(recipe, robot, data, moments)
        zeros = _zero_entries(robot, moments)
        n_rigid = robot.features_.n_parameters_
        if recipe.relative is not None:
            gains = gain_indices(robot.effects_, n_rigid)
            zeros[:, gains[recipe.relative.fixed]] = True
        # A prior on the bodies would keep a value of the geometry where it is.
        bodies = None if _changes_bodies(robot) else fit.estimate.bodies
        values = ModelValues.of(
            moments.zeroed(zeros),
            robot.effects_,
            n_rigid=n_rigid,
            joint_weights=recipe.joint_weights,
            bodies=bodies,
        )
        # The load lags one fit behind the values.
        if values.converged() and (had_converged or not (loaded and iteration)):
            break
        had_converged = values.converged()
        factors, last_step = values.step_factors(factors, last_step), values.step
        corrected = _with_effects(robot, values.corrected(factors))
    else:
        names = [x.name for x in values.effects if isinstance(x, InModel)]
        warnings.warn(
            f"The values of {', '.join(dict.fromkeys(names))} did not converge in "
            f"{MAX_CORRECTIONS} corrections (nearly equal columns). Declare fewer.",
            ConvergenceWarning,
            stacklevel=6,
        )
    if iteration and not loaded:
        fit = _refit(recipe, robot, data, moments)
    robot = replace(fit.robot, load_parameters=fit.robot.next_load_parameters())
    return replace(fit, robot=robot), values


def _refit(recipe, robot, data, moments):
    """Fit a corrected robot to moments that include derivative columns."""
    if not from_moments(recipe.regressor):
        return recipe.fit_data(robot, data)
    value_columns = robot.linear_part(np.ones(moments.g.shape[1])) == 0.0
    linear_moments = moments.zeroed(np.broadcast_to(value_columns, moments.g.shape))
    return recipe.fit_moments(robot, linear_moments, segments=data.segments(robot))


# -- refinement by simulation ----------------------------------------------------------


def refine_fit(recipe, fit, data, window):
    robot = fit.robot
    # Here values of effects in the model have no columns.
    result = recipe.fit_data(robot, data).estimate
    result = replace(result, std=robot.theta_std_)
    motion = data.recording, data.states
    result, criteria = refine(robot, result, *motion, window, recipe.projector)
    fit = RobotFit.of(robot, result, robot.identifiable_, fit.segments)
    return replace(fit, criteria=criteria)


# -- values of effects that are part of the robot model, by Gauss and Newton -----------

# The torque is linear in the parameters of the bodies, but not in a base tilt or a
# channel gain. The derivatives with respect to such values are further columns: least
# squares fits all parameters, the regressor is evaluated again at the new values, until
# no value moves by more than a tenth of its standard error. There is no prior on the
# steps, since it would hold each value where it began.


# A value has converged if a correction is below this share of its standard error ...
CONVERGED = 0.1
# ... or, due to rounding, below this share of its plausible range.
_ROUNDING = 1e-10
# Maximum number of corrections of one fit.
MAX_CORRECTIONS = 12
# Share of the distance to the bound that a correction beyond the bound covers.
_SHORTENED = 0.9
# A value within this share of its range from a bound counts as at the bound.
_BOUND_MARGIN = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelValues:
    """Corrections of the values of effects that are part of the robot model."""

    effects: tuple  # all effects of the fit
    indices: np.ndarray  # of these values among the parameters
    # corrections of the values; zero if not identifiable
    step: np.ndarray
    std: np.ndarray  # of the values; nan if not identifiable
    # of all parameters, with the corrections at the indices of the values
    estimate: PlainEstimate | None = None
    moments: object = None  # of the equations, derivative columns included

    @classmethod
    def of(cls, moments, effects, n_rigid, joint_weights, bodies=None):
        # Columns of the moments: `n_rigid` of the features, then those of the effects,
        # derivative columns included; bodies: as for `plain_estimate`.
        spans = effect_indices(effects, n_rigid)
        indices = [
            index for effect, at in spans if isinstance(effect, InModel) for index in at
        ]
        solution = plain_estimate(moments, joint_weights, bodies)
        identified = solution.identifiable[indices]
        return cls(
            effects=tuple(effects),
            indices=np.array(indices),
            step=np.where(identified, solution.theta[indices], 0.0),
            std=np.where(identified, solution.std[indices], np.nan),
            estimate=solution,
            moments=moments,
        )

    def converged(self):
        """Return whether no value moves by more than a tenth of its standard error."""
        # A value at a bound has converged if its step points outwards.
        in_model = [effect for effect in self.effects if isinstance(effect, InModel)]
        low, high = (np.concatenate(x) for x in zip(*[e.bounds() for e in in_model]))
        with np.errstate(invalid="ignore"):
            tolerance = np.maximum(CONVERGED * self.std, _ROUNDING * (high - low))
            moves = np.abs(self.step) > tolerance
        margin = _BOUND_MARGIN * (high - low)
        values = np.concatenate([effect.values for effect in in_model])
        below, above = values < low + margin, values > high - margin
        outward = (below & (self.step < 0)) | (above & (self.step > 0))
        return not (moves & ~outward).any()

    def add_uncertainty(self, std, covariance):
        """Propagate the uncertainty of the values to deviations and covariance."""
        # The other parameters were estimated at fixed values; they vary with them,
        # since their columns are correlated.
        std, identified = std.copy(), np.isfinite(self.std)
        # Parameters fixed to the description do not vary.
        columns, others = self.indices[identified], std > 0
        others[self.indices] = False
        value_covariance = self.estimate.covariance[np.ix_(columns, columns)]
        inverse = self.estimate.eigen.inverse()[:, columns]
        slope = np.linalg.solve(inverse[columns], inverse[others].T).T
        variance = np.einsum("ik,kl,il->i", slope, value_covariance, slope)
        std[others] = np.hypot(std[others], np.sqrt(variance))
        if covariance is not None:
            covariance = covariance.copy()
            covariance[np.ix_(others, others)] += slope @ value_covariance @ slope.T
            covariance[self.indices] = covariance[:, self.indices] = 0.0
            # Values that are not identifiable have infinite variance.
            covariance[self.indices, self.indices] = np.inf
            covariance[np.ix_(columns, columns)] = value_covariance
            cross_covariance = slope @ value_covariance
            covariance[np.ix_(others, columns)] = cross_covariance
            covariance[np.ix_(columns, others)] = cross_covariance.T
        return std, covariance

    def step_factors(self, factor, last_step):
        """Return step factors (k,), doubled while steps keep direction and size."""
        # Noise in a derivative, such as that of a recorded torque, shortens the steps.
        persistent = np.abs(self.step) > 0.5 * np.abs(last_step)
        return np.where(persistent & (self.step * last_step > 0), 2.0 * factor, 1.0)

    def corrected(self, factor):
        """Return the effects with corrected values within their plausible range."""
        effects, start = [], 0
        for effect in self.effects:
            if isinstance(effect, InModel):
                part = slice(start, start + len(effect.coefficients))
                step = (factor * self.step)[part]
                start += len(effect.coefficients)
                effect = effect.linearised_at(_bounded_step(effect, step))
            effects.append(effect)
        return tuple(effects)


def _bounded_step(effect, step):
    low, high = effect.bounds()
    room = np.where(step > 0, high, low) - effect.values
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(step == 0, np.inf, room / np.where(step == 0, 1.0, step))
    return step if share.min() >= 1 else _SHORTENED * max(share.min(), 0.0) * step


# -- lag of all torques ----------------------------------------------------------------

# Number of blocks of rows that are tested, their minimum length in rows and in lengths
# of the low-pass, and standard deviations of a lag that require a full inspection.
_BLOCKS, _BLOCK_ROWS, _BLOCK_FILTERS, _LAG_DEVIATIONS = 4, 1000, 10, 4.0


def suggests_lag(recipe, fit, data):
    """Return whether an excerpt suggests that all torques lag, or lead."""
    robot, recording = fit.robot, data.recording
    plan, effects = robot.plan, (*robot.effects_, TorqueLag())
    length = max(_BLOCK_ROWS, 2 * _BLOCK_FILTERS * plan.lowpass.half)
    rows = []
    for part in recording.segments:
        starts = np.linspace(part.start, part.stop - length, _BLOCKS).astype(int)
        if part.stop - part.start > _BLOCKS * length:
            rows += [slice(at, at + length) for at in starts.tolist()]
        elif part.stop - part.start > length:
            rows.append(part)
    rows = rows[:: max(len(rows) // _BLOCKS, 1)] or list(recording.segments)[:_BLOCKS]
    excerpt = take_rows(recording, rows, range(len(rows)))
    states, _ = estimate_states(excerpt, plan.state_estimator, False, data.n_jobs)
    robot = replace(robot, plan=replace(plan, effects=effects))
    data = replace(data, recording=excerpt, states=states, blocks=None)
    moments = data.moments(data.segments(robot, tangents=True), plan)
    if moments is None:
        return False
    zeros = _zero_entries(robot, moments)
    values = ModelValues.of(
        moments.zeroed(zeros),
        effects,
        n_rigid=robot.features_.n_parameters_,
        joint_weights=recipe.joint_weights,
    )
    return bool(np.abs(values.step[-1]) > _LAG_DEVIATIONS * values.std[-1])


# -- velocity reversals with dry friction (corners), and steps of commands -------------

# Number of poses at which the inertia of a joint is evaluated.
_N_POSES = 64
# A ripple is corrected if it is equivalent to this delay or more, in sample periods.
_MIN_RIPPLE_DELAY = 5e-4
# Maximum number of fits with corners, including the one without, and error of the
# correction as a share of what it changes.
_MAX_CORNER_FITS, _CORNER_ERROR = 3, 0.2
# Frequency grid of the integral, in cut-off frequencies; the truncation is 1e-3.
_LOWEST, _HIGHEST, _COUNT = 0.1, 1e3, 4000


def velocity_corners(robot, data):
    """Return `Plan.corners` (nv,) of a fitted robot; None without corners."""
    # Requires a known control law: an unknown controller may compensate the jump.
    plan = robot.plan
    estimator, feedback = plan.state_estimator, data.recording.feedback
    if feedback is None or estimator is None:
        return None
    terms, inertia = _joint_dynamics(robot, data)
    recording = data.recording
    command = recording.command + recording.torques(plan.delay) - recording.tau
    arguments = data.states.full, plan, robot.features_
    rows = regressor_rows(recording, *arguments, theta=robot.load_parameters)
    torques = [np.concatenate([x.effects(robot.theta_) for x in rows]), command]
    from_effects, from_commands = _torque_jumps(torques, robot, data)
    dry = terms["coulomb"] + from_effects
    if not dry.any():
        return None
    # Feedforward of friction compensates the jump.
    dry = np.maximum(dry - from_commands, 0.0)
    damping = feedback[1] + np.maximum(terms["viscous"], 0.0)
    rows = zip(dry, inertia, damping, feedback[0], estimator.cutoff_)
    return np.array([equivalent_corner(*row) for row in rows])


def without_command_ripple(robot, data):
    """Remove the ripple due to steps of commands from the data; None if it is small."""
    # A joint responds to each step of a zero-order-hold command with a ripple that
    # sampled positions hide: the double integral of a sawtooth B1, by the Bernoulli
    # polynomials B3 and, for the damping, B4, times the slope of the command.
    recording, dt = data.recording, data.recording.dt
    if recording.feedback is None or robot.plan.state_estimator is None:
        return None
    terms, inertia = _joint_dynamics(robot, data)
    phase = robot.plan.delay / dt % 1.0
    cubic = phase * (phase - 0.5) * (phase - 1.0) * dt**3 / 6.0
    quartic = ((phase * (phase - 1.0)) ** 2 - 1.0 / 30.0) * dt**4 / 24.0
    inertia = np.where(inertia > 0, inertia, np.inf)
    stiffness, damping = recording.feedback
    losses = damping + np.maximum(terms["viscous"], 0.0)
    amplitude = (cubic + losses / inertia * quartic) / inertia
    if (stiffness * np.abs(amplitude) < _MIN_RIPPLE_DELAY * dt).all():
        return None
    parts, clock = recording.segments, recording.clock
    position, speed = (
        amplitude
        * _smoothing.interpolate(recording.command, parts, clock, robot.plan.delay, k)
        for k in (1, 2)
    )
    recording = replace(
        recording,
        q=recording.q - position,
        tau=recording.tau + stiffness * position + damping * speed,
    )
    halves = data.states.halves is not None
    states, _ = estimate_states(
        recording, robot.plan.state_estimator, halves, data.n_jobs
    )
    return replace(data, recording=recording, states=states)


def equivalent_corner(dry, inertia, damping, stiffness, cutoff):
    """Return half of an acceleration jump that smoothing rounds off as much."""
    # As much as the response of the joint and its drive to a step of 2 dry: the part of
    # its velocity at the reversal that the smoother removes.
    if not (np.isfinite(cutoff) and inertia > 0 and dry > 0):
        return 0.0
    x = np.geomspace(_LOWEST, _HIGHEST, _COUNT)
    omega = 2 * np.pi * cutoff * x
    removed = x**10 / (1 + x**10)
    response = 1.0 / (inertia * omega**2 - stiffness - 1j * damping * omega)
    rounded = 2 * dry / np.pi * np.trapezoid(removed * response.real, omega)
    return max(rounded, 0.0) / _smoothing.rounding(cutoff)


def _torque_jumps(torques, robot, data):
    """Return half of the jump (nv,) of each torque (n, nv) at velocity reversals."""
    # Least squares on the sign of the velocity, after subtracting smoothed signals.
    estimator, groups = robot.plan.state_estimator, data.recording.groups
    nv = data.recording.nv
    speed = np.concatenate([states[slice(None)] for states in data.states.full])
    signs = np.sign(speed.reshape(len(speed), -1)[:, nv : 2 * nv])
    signs, *torques = (
        x - estimator.transform(x, groups=groups)[:, :nv] for x in (signs, *torques)
    )
    power = (signs**2).sum(axis=0)
    power = np.where(power > 0, power, 1.0)
    return [(torque * signs).sum(axis=0) / power for torque in torques]


def _joint_dynamics(robot, data):
    """Return friction (nv,) by name, and inertia (nv,) with all other joints free."""
    # The inertia is the mean over poses. The mass matrix comes from inverse dynamics,
    # since fitted bodies need not be physically consistent.
    nv = data.recording.nv
    terms = dict.fromkeys(("coulomb", "viscous", "rotor_inertia"), np.zeros(nv))
    terms |= dict(zip(robot.features_.friction_, robot.bodies(robot.theta_)[:, 10:].T))
    rotors = np.diag(np.maximum(terms["rotor_inertia"], 0.0))
    a, inertias = np.vstack([np.zeros(nv), np.eye(nv)]), []
    for states in data.states.full:
        for i in np.unique(np.linspace(0, states.shape[0] - 1, _N_POSES).astype(int)):
            q = np.tile(states[slice(i, i + 1)].reshape(-1)[:nv], (nv + 1, 1))
            at_rest, *columns = robot.rigid(q, 0.0 * a, a)
            mass_matrix = np.array(columns) - at_rest + rotors
            inertias.append(1.0 / np.diagonal(np.linalg.pinv(mass_matrix)))
    return terms, np.mean(inertias, axis=0)
