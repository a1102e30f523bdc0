"""Search for missing effects, with errors on held-out data."""

import warnings
from dataclasses import replace
from functools import wraps
from numbers import Integral, Real

import numpy as np
from sklearn.base import BaseEstimator, clone
from sklearn.utils.validation import check_is_fitted

from sklearn_vbjfa._core._runtime import one_blas_thread, say, show_progress
from sklearn_vbjfa.diagnosis.explain import (
    NO_INFORMATION,
    FinalFit,
    held_out_errors,
    make_outcome,
    motion_statistics,
    split_in_time,
    supported_terms,
    unnamed_torques,
)
from sklearn_vbjfa.diagnosis.report._report import Report
from sklearn_vbjfa.diagnosis.search._branches import (
    branches_of,
    merge_branches,
    tune_branch_shapes,
)
from sklearn_vbjfa.diagnosis.search._posterior import SearchSettings, search
from sklearn_vbjfa.diagnosis.search._stepwise import tune_shapes
from sklearn_vbjfa.diagnosis.search._view import RecordingView, stretches
from sklearn_vbjfa.effects import Sudden, TorqueGain, declarable, resolve
from sklearn_vbjfa.equations._checks import check_weight
from sklearn_vbjfa.equations._plan import check_effects, joints_at_rest
from sklearn_vbjfa.equations._repetition import find_repetition
from sklearn_vbjfa.fit._arguments import check_rows_suffice, checked_arrays
from sklearn_vbjfa.fit._gains import PAYLOAD
from sklearn_vbjfa.fit._identifier import RecordingRegressorMixin, RobotIdentifier
from sklearn_vbjfa.fit._signs import signed
from sklearn_vbjfa.inspection import common_lag, refusal
from sklearn_vbjfa.model import DoubtWarning, joint_names, load_model
from sklearn_vbjfa.recording import (
    OfferedSignals,
    carries_joint_names,
    check_clock,
    check_dt,
    positions_and_signals,
    recording_names,
    scan_signals,
    take_arrays,
    take_rows,
    with_torques_shifted,
)
from sklearn_vbjfa.regression._base import Interval
from sklearn_vbjfa.robot._windows import unfollowed


class EffectDiscovery(RecordingRegressorMixin, BaseEstimator):
    """Find effects that are missing from a robot model.

    The estimator fits the declared model, adds viscous and Coulomb friction, offset and
    rotor inertia on every joint, and searches for the most probable set of further
    effects. Errors are measured on held-out data; then the model is fitted to all data.

    Parameters
    ----------
    identifier : RobotIdentifier
        Declared model: robot, friction and filter settings.
    effects : "all", or list of str or Effect, default="all"
        Effects to search for: names as `effects.available` lists them, or custom ones.
    test_size : float, default=0.25
        Share of the motion that is held out, standstill excluded; up to 0.4 if a joint
        would move too little in it.
    alpha : float, default=0.05
        Reported effects need a posterior probability of ``1 - alpha``. It is also the
        level of the test for contradicting recordings.
    max_effects : int or None, default=None
        Maximum number of effects to add.
    settings : SearchSettings or None, default=None
        Further constants of the search.
    random_state : int, RandomState instance or None, default=None
        Without effect: the search is deterministic.
    verbose : int, default=0
        If not 0, show :ref:`progress bars <progress>` on terminals.

    Attributes
    ----------
    effects_ : tuple of DiscoveredEffect
        Reported effects, those that reduce the cross-validated error the most first,
        each with `name`, `joint` (from zero), natural `log_odds`, `probability`,
        `rivals` (effects that could replace it within three nats), `parameters`,
        `units` and `intervals` (90 %). The values are those of `identifier_`.
    possible_ : tuple of DiscoveredEffect
        Effects that are more probable than not, part of the completed model; `warning`
        is the reason why they are not reported.
    error_before_, error_plain_, error_after_ : ndarray of shape (nv,)
        RMS of the held-out torque residual over `torque_std_`, of the declared model,
        with the four friction terms, and with the effects; `report_` has intervals.
    torque_std_ : ndarray of shape (nv,)
        Standard deviation of the filtered torque of each joint in motion [unit of y].
    unexplained_ : tuple of Unexplained
        Joints with a residual above the noise floor, its share of the torque, and the
        signals on which it depends.
    not_identifiable_ : tuple of NotIdentifiable
        Effects that are not identifiable for this robot or from this recording.
    identifier_, validation_model_ : RobotIdentifier
        Completed model, fitted to all data and to the search data, respectively.
    declared_, baseline_ : RobotIdentifier
        Declared model without and with the friction terms, fitted to the search data.
    torque_lag_ : float
        Common delay of all torque channels [s], part of the models; 0 if none.
    joint_names_ : tuple of str
        Joints in the order of the columns of X and y.
    report_ : Report
        Report of all results: ``print(search.report_)``, `to_dict`, `to_html`.
    n_features_in_ : int
        Number of columns of X.

    Notes
    -----
    "Search for effects" in the documentation describes the prior [1]_ and all rules.

    Robots with more than seven joints are searched branch by branch, without couplings
    between branches, unless `max_effects`, custom effects or declared effects are used.
    With a `PDDrive`, delays, filters, jerk and elasticity are excluded. Recordings of
    more than 20,000 rows are searched on a subset of the samples.

    References
    ----------
    .. [1] N. Polson, J. Scott, "On the half-Cauchy prior for a global scale parameter",
       Bayesian Analysis 7(4), 2012. :doi:`10.1214/12-BA730`

    Examples
    --------
    >>> from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
    >>> from sklearn_vbjfa.datasets import make_robot_recording
    >>> recording = make_robot_recording(
    ...     duration=20, dt=0.01, undeclared={"load_friction": (1, 0.2)}, random_state=0
    ... )
    >>> robot = RobotIdentifier(recording.robot_model(), dt=0.01, friction=("viscous",))
    >>> loop = EffectDiscovery(robot, effects=["load_friction"])
    >>> loop = loop.fit(recording.q, recording.tau)
    >>> [(effect.name, effect.joint) for effect in loop.effects_]
    [('load_friction', 1)]
    """

    _parameter_constraints = {  # noqa: RUF012
        "identifier": [RobotIdentifier],
        "effects": "no_validation",
        "test_size": [Interval(Real, 0, 1, closed="neither")],
        "alpha": [Interval(Real, 0, 1, closed="neither")],
        "max_effects": [Interval(Integral, 0, None, closed="left"), None],
        "settings": [SearchSettings, None],
        "random_state": ["random_state"],
        "verbose": ["verbose"],
    }

    def __init__(
        self,
        identifier,
        *,
        effects="all",
        test_size=0.25,
        alpha=0.05,
        max_effects=None,
        settings=None,
        random_state=None,
        verbose=0,
    ):
        self.identifier = identifier
        self.effects = effects
        self.test_size = test_size
        self.alpha = alpha
        self.max_effects = max_effects
        self.settings = settings
        self.random_state = random_state
        self.verbose = verbose

    @one_blas_thread()
    def fit(self, X, y, groups=None, sample_weight=None, t=None, signals=None):
        """Search for effects.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions [rad or m], or states [q | v | a].
        y : array-like of shape (n_samples, nv)
            Joint torques [N m] or forces [N].
        groups, sample_weight, t : array-like, default=None
            Labels of recordings, weights and time [s], as for `RobotIdentifier.fit`.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Recorded signals, such as a temperature, by name (or a data frame):
            candidates for what friction and offsets vary with (`effects.Signal`), as
            are columns of a data frame X that are not a channel of a joint.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If a parameter is invalid, the recording is too short, a channel is faulty
            (of the wrong sign, for example), or one of `signals` cannot be used.

        Warns
        -----
        DoubtWarning
            If a channel may be wrong, such as torques in an unexpected unit.
        """
        library = self._check_parameters()
        whole, columns = self._recording(X, y, groups, sample_weight, t)
        drive = self.identifier.drive
        if drive is not None:
            commanded, signals = drive.split_signals(whole.tau, signals)
            whole = drive.driven(replace(whole, signals=commanded))
        names = recording_names(groups, [part.start for part in whole.segments])
        named = carries_joint_names(X, self.joint_names_)
        whole = replace(whole, joints_named=named, group_names=names)
        self._fit(whole, library, signals, columns)
        for fault in self.report_.outcome.findings["channels"]:
            if fault.severity == "warning":
                warnings.warn(fault.message, DoubtWarning, stacklevel=3)
        return self

    @one_blas_thread()
    def fit_recording(self, recording, signals=None):
        """Search for effects in a `Recording`.

        Parameters
        ----------
        recording : Recording
            Of the identifier's robot; with a `drive`, the result of its ``driven``.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            As for `fit`.

        Returns
        -------
        self : object
            Fitted estimator.
        """
        library = self._check_parameters()
        arrays = recording.inputs, recording.tau, recording.groups, recording.weight
        whole, _ = self._recording(*arrays, None)
        kept = "v command feedback torque_units joints_named group_names"
        whole = replace(whole, **{x: getattr(recording, x) for x in kept.split()})
        return self._fit(whole, library, signals, OfferedSignals())

    def _fit(self, whole, library, signals, columns):
        """Search in a checked recording with its signals, and set the results."""
        check_rows_suffice(self.identifier, whole)
        declared = check_effects(self.identifier.effects, whole.nv)
        drive = self.identifier.drive
        if drive is not None and drive.unsigned and whole.command is None:
            # The fitted rows determine the torque signs of the others.
            part = split_in_time(self.identifier, whole, self.test_size).searched(whole)
            fitted = clone(self.identifier).fit_without_inspection(part)
            whole = signed(fitted.robot_, whole)
        signals, unusable = scan_signals(signals, columns, whole, (*library, *declared))
        whole = replace(whole, signals=signals)
        with show_progress(self.verbose):
            outcome, self._expectation = self._run(whole, library, unusable)
        for name in ("effects", "possible", "unexplained", "not_identifiable"):
            setattr(self, f"{name}_", outcome.findings[name])
        for name in ("before", "plain", "after"):
            setattr(self, f"error_{name}_", outcome.column(name))
        self.report_ = Report(outcome)
        return self

    def _check_parameters(self):
        """Check the parameters, and return the library of effects to search."""
        self._validate_params()
        declared = self.identifier
        if declared.criterion != "torque":
            raise ValueError(
                f'identifier must have criterion="torque"; got {declared.criterion!r}. '
                'Refine later: loop.identifier_.set_params(criterion="simulation").'
            )
        library = resolve(self.effects)
        if declared.used_gains is not None:
            # Unknown gains are declared on every channel.
            library = [e for e in library if not isinstance(e, TorqueGain)]
        drive = declared.drive
        if drive is None or not drive.uses_positions:
            return library
        # Effects that its simulation cannot include would bias the other parameters.
        excluded = {e.name: unfollowed(e) for e in library if unfollowed(e)}
        if excluded and not isinstance(self.effects, str):
            names = "; ".join(f"{name} ({why})" for name, why in excluded.items())
            message = f"Not available with {type(drive).__name__}: {names}."
            warnings.warn(message, UserWarning, stacklevel=4)
        return [e for e in library if e.name not in excluded]

    def _recording(self, X, y, groups, sample_weight, t):
        """Return a `Recording` with time, and the other columns of X."""
        self.joint_names_ = names = joint_names(load_model(self.identifier.model))
        X, y, columns = checked_arrays(self, names, X, y)
        weight = check_weight(sample_weight, y.shape)
        dt = check_dt(self.identifier.dt)
        t = check_clock(t, X.shape[0], dt)
        recording = take_arrays(X, y, groups, weight, t, dt=dt, joint_names=names)
        return recording, columns

    def _run(self, whole, library, unusable):
        """Search, validate and fit the completed model; return an `Outcome`."""
        say("channels")
        channels, late, std = self._inspect(whole)
        if late:
            whole = with_torques_shifted(whole, self.torque_lag_)
        say("declared model")
        split = split_in_time(self.identifier, whole, self.test_size)
        training = split.searched(whole)
        self._fit_declared(training)
        say("search")
        lowpass = self.baseline_.robot_.plan.lowpass
        repetition = find_repetition(whole.q, whole.t, whole.segments)
        chosen, pieces = stretches(training.segments, split.moving[split.rows], lowpass)
        thinned = replace(split, rows=split.rows[chosen], pieces=pieces)
        settings = {"origin": whole.groups[thinned.rows], "repetition": repetition}
        searched = _without_joints(thinned.searched(whole), channels)
        result = self._search(searched, settings, library)
        masses = self.identifier.fit_options.known_masses or ()
        if PAYLOAD not in masses and {*result.changes} & {*repetition.begins.tolist()}:
            # A change between recordings would depend on their order, except for that
            # of a known mass, whose sign is not used.
            library = [e for e in library if not isinstance(e, Sudden)]
            result = self._search(searched, settings, library)
        say("held-out judgement")
        model, torques = self.baseline_, ()
        if result.effects:
            model = self._fit_with(result.effects, model, training)
        if isinstance(self.effects, str) and self.identifier.drive is None:
            fit = FinalFit(self.baseline_, model, result.view)
            torques = unnamed_torques(fit, result.settings)
        self.validation_model_ = model.extended_by(torques)
        del training  # a copy of most rows
        judged = held_out_errors(self, result, split, thinned, whole)
        self.torque_std_ = judged["columns"]["spread"]
        say("final model")
        rows, pieces = stretches(whole.segments, split.moving, lowpass)
        sample = _without_joints(take_rows(whole, rows, pieces), channels)
        settings = settings | {"origin": whole.groups[rows], "all_samples": True}
        final = self._fit_final(result, model, whole, sample, settings)
        self.identifier_ = final.identifier.extended_by(supported_terms(final, torques))
        say("explaining")
        channels = (*channels, *unusable)
        results = make_outcome(self, result, final, judged, channels, whole)
        for name in ("declared_", "baseline_", "validation_model_", "identifier_"):
            setattr(self, name, getattr(self, name).extended_by(late, std))
        return results

    def _inspect(self, whole):
        """Return channel findings, and the lag of all torques as effects with std."""
        channels = self.identifier.findings(whole)
        measured = self.identifier.drive is None and self.identifier.gains is None
        fault = refusal(channels, whole.torque_units if measured else ())
        if fault is not None:
            raise fault
        late, std = self.identifier.lag_from(whole, common_lag(channels))
        self.torque_lag_ = sum((effect.lag for effect in late), 0.0)
        return channels, late, std

    def _fit_declared(self, training):
        """Fit the declared model, and with the declarable friction terms."""
        declared = clone(self.identifier)
        declared.fit_without_inspection(training, compare=False)
        self.declared_ = self.baseline_ = declared
        if set(declarable()) - set(declared.features_.friction_):
            # Do not duplicate friction terms that are declared on single joints.
            kept = tuple(
                effect
                for effect in self.identifier.effects
                if effect.name not in declarable() or any(effect.shape().values())
            )
            new = clone(self.identifier).set_params(friction=declarable(), effects=kept)
            self.baseline_ = new.fit_without_inspection(training, compare=False)

    def _search(self, recording, view_settings, library):
        """Search the robot, or each branch of a robot with many joints."""
        robot = self.baseline_.robot_
        settings = SearchSettings() if self.settings is None else self.settings
        view = RecordingView(robot, recording, **view_settings)
        branches = branches_of(self.baseline_, library, self.max_effects)
        used = [b for b in branches if view.precision[b.joints].any()]
        if len(branches) == 1 or not used:
            library = library if used else ()
            return search(view, library, settings, self.alpha, self.max_effects)
        # The branches share the prior expectation of the number of effects.
        share = replace(settings, expected=settings.expected / len(used))
        views = (branch.view(robot, recording, **view_settings) for branch in used)
        results = [search(v, library, share, self.alpha) for v in views]
        theta = robot.linear_part(self.baseline_.theta_unconstrained_)
        return merge_branches(view, view.motion_of(theta), used, results)

    def _fit_with(self, effects, start, recording, **settings):
        """Fit the baseline model with effects, starting from the values of a model."""
        baseline = self.baseline_
        settings["effects"] = (*baseline.effects_, *effects)
        if baseline.gains_ is not None:
            # Keep the reference channels of the gains.
            names = baseline.joint_names_
            settings["gains"] = tuple(names[j] for j in baseline.gains_.references)
        model, previous = clone(baseline).set_params(**settings), start.robot_
        return model.fit_without_inspection(recording, compare=False, previous=previous)

    def _fit_final(self, result, start, whole, sample, view_settings):
        """Fit the completed model to all data, in the validated frequency band."""
        band, options, judged = {}, self.identifier.fit_options, self.validation_model_
        if isinstance(self.identifier.cutoff, str):
            band["cutoff"] = judged.cutoff_ if np.isfinite(judged.cutoff_) else None
        if isinstance(options.standstill, str):
            band["options"] = replace(options, standstill=judged.standstill_)
        data = self.baseline_.robot_, sample
        view = RecordingView(*data, **view_settings)
        view = view.with_rest(joints_at_rest(result.effects))
        if result.branches:
            effects = tune_branch_shapes(
                result, lambda b: b.view(*data, **view_settings)
            )
        else:
            effects = tune_shapes(view, result.effects, result.settings)
        model = self._fit_with(effects, start, whole, **band)
        return FinalFit(self.baseline_, model, view, sample.n_samples / whole.n_samples)

    @wraps(RobotIdentifier.predict)
    def predict(self, X, groups=None, t=None, signals=None):
        check_is_fitted(self)
        return self.identifier_.predict(X, groups=groups, t=t, signals=signals)

    def expected_error(self, X, groups=None, t=None, signals=None):
        """Predict the error of the completed model on another motion.

        The error on held-out data is increased for motion beyond that of the fit, and
        for the variation of friction, gains, offsets and load between recordings.

        Parameters
        ----------
        X, groups, t, signals : array-like
            The motion, as for `predict`.

        Returns
        -------
        error : ndarray of shape (nv,)
            Median RMS error over `torque_std_` of the fit, not of X; nan if unknown.
        interval : ndarray of shape (2, nv)
            Bounds of the 90 % prediction interval.
        """
        predicted = self.predict(X, groups, t, signals)
        robot, gains = self.identifier_, self.identifier_.features_.gains_
        X, _ = positions_and_signals(X, self.joint_names_)
        states = np.asarray(robot.robot_.states(X, groups))
        speeds = np.abs(np.split(states, 3, axis=1)[1])
        moving = (speeds > np.maximum(robot.standstill_, 0.0)).astype(float)
        torques = predicted / gains, moving, self.torque_std_ / np.abs(gains)
        motion = motion_statistics(robot, states, *torques)
        error, low, high = self._expectation.of(motion)[:, :-1]
        return error, np.stack([low, high])


def _without_joints(recording, channels):
    """Set the weights of joints to zero whose channels carry too little information."""
    weight = recording.weight.astype(float)
    for finding in channels:
        if finding.severity == "warning" and finding.kind in NO_INFORMATION:
            weight[:, list(finding.joints)] = 0.0
    return replace(recording, weight=weight)
