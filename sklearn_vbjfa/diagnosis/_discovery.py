"""Search for missing effects, with errors on held-out data."""

import warnings
from dataclasses import replace
from functools import wraps
from numbers import Integral, Real

import numpy as np
from sklearn.base import BaseEstimator, clone
from sklearn.utils.validation import check_is_fitted

from sklearn_vbjfa._core._progress import say, show_progress
from sklearn_vbjfa._core._threads import one_blas_thread
from sklearn_vbjfa.diagnosis.explain import (
    NO_INFORMATION,
    FinalFit,
    judge,
    make_outcome,
    motions_of,
    split_in_time,
    that_help,
    unnamed_torques,
)
from sklearn_vbjfa.diagnosis.report._report import Report
from sklearn_vbjfa.diagnosis.search._branches import (
    branches_of,
    put_together,
    tuned_apart,
)
from sklearn_vbjfa.diagnosis.search._path import remembering, tuned_on
from sklearn_vbjfa.diagnosis.search._posterior import SearchSettings, search
from sklearn_vbjfa.diagnosis.search._view import RecordingView, stretches
from sklearn_vbjfa.effects import TorqueGain, declarable, resolve
from sklearn_vbjfa.equations._plan import check_effects
from sklearn_vbjfa.equations._recording_checks import check_weight
from sklearn_vbjfa.fit._arguments import checked_arrays
from sklearn_vbjfa.fit._identifier import RecordingRegressorMixin, RobotIdentifier
from sklearn_vbjfa.fit._signs import signed
from sklearn_vbjfa.inspection import refusal
from sklearn_vbjfa.model import DoubtWarning, joint_names, load_model
from sklearn_vbjfa.recording import (
    OfferedSignals,
    carries_names,
    check_clock,
    check_dt,
    find_repetition,
    positions_and_signals,
    survey,
    take_arrays,
    take_rows,
    with_torques_shifted,
)
from sklearn_vbjfa.regression._base import Interval
from sklearn_vbjfa.robot._robot import IdentifiedRobot
from sklearn_vbjfa.robot._windows import unfollowed


class EffectDiscovery(RecordingRegressorMixin, BaseEstimator):
    """Find effects that are missing from a robot model.

    The estimator fits the declared model, adds viscous and Coulomb friction, offset and
    rotor inertia on every joint, and searches for the most probable set of further
    effects. Effects with sufficient posterior probability that also improve the
    prediction of held-out motion are reported; less probable ones are listed as
    possible. The errors of all models are measured on held-out data, and the completed
    model is then fitted to all data.

    Parameters
    ----------
    identifier : RobotIdentifier
        Declared model: robot, friction and filter settings.
    effects : "all", or list of str or Effect, default="all"
        Effects to search for: names of the library (see
        `sklearn_vbjfa.effects.available`), or custom effects.
    test_size : float, default=0.25
        Share of the motion that is held out: both ends of each of several recordings,
        or several intervals of a single one, standstill excluded. It is increased up to
        0.4 if a joint would move too little in it.
    alpha : float, default=0.05
        Accepted probability that an effect is reported for a complete model: effects
        need a posterior probability of ``1 - alpha``. It is also the level of the test
        for contradicting recordings.
    max_effects : int or None, default=None
        Maximum number of effects to add.
    settings : SearchSettings or None, default=None
        Further constants of the search, see `sklearn_vbjfa.diagnosis.SearchSettings`.
    random_state : int, RandomState instance or None, default=None
        Without effect: the search is deterministic.
    verbose : int, default=0
        If not 0, show :ref:`progress bars <progress>` on terminals.

    Attributes
    ----------
    effects_ : tuple of DiscoveredEffect
        Reported effects, those that reduce the cross-validated error the most first,
        each with `name`, `joint` (from zero), `log_odds` (natural
        logarithm of the posterior odds), `probability`, `rivals` (effects that could
        replace it within three nats), `parameters`, `units` and `intervals` (90 %). The
        values are those of `identifier_`.
    possible_ : tuple of DiscoveredEffect
        Effects that are more probable than not but not reported; `warning` is the
        reason. They are part of `identifier_` and `validation_model_`.
    error_before_, error_plain_, error_after_ : ndarray of shape (nv,)
        RMS of the torque residual on the held-out data over `torque_std_`, of the
        declared model, with the four friction terms, and with the effects. The
        ``intervals`` of ``report_.outcome.errors`` contain the error over the next
        50 s of the same motion in 90 % of cases.
    torque_std_ : ndarray of shape (nv,)
        Standard deviation of the low-pass filtered torque of each joint while the robot
        moves [N m or N].
    unexplained_ : tuple of Unexplained
        Joints with a residual above the noise floor, its share of the torque, and the
        signals on which it depends.
    not_identifiable_ : tuple of NotIdentifiable
        Effects that are not identifiable for this robot or from this recording.
    identifier_, validation_model_ : RobotIdentifier
        Completed model, fitted to all data, and fitted to the search data, whose errors
        are reported.
    declared_, baseline_ : RobotIdentifier
        Declared model, and the same with the four friction terms, fitted to the search
        data.
    torque_lag_ : float
        Common delay of all torque channels [s], found first and removed; 0 if none.
    joint_names_ : tuple of str
        Joints in the order of the columns of X and y.
    report_ : Report
        Report of all results: ``print(search.report_)``, `to_dict`, `to_html`.
    n_features_in_ : int
        Number of columns of X.

    See Also
    --------
    sklearn_vbjfa.effects : The library of effects.

    Notes
    -----
    A candidate is an effect on a joint. Its posterior odds are a Bayes factor, with a
    half-Cauchy prior for the scale of its coefficients [1]_, times the prior odds (the
    expected number of effects over the number of candidates); the evidence is
    discounted by its scatter between blocks of time. Effects are reported if their
    probability is at least ``1 - alpha``, if they reduce the cross-validated squared
    error significantly and by at least 2 %, and if the interval of a parameter excludes
    zero. The documentation describes all rules in "Search for effects".

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
    ...     duration=20.0,
    ...     dt=0.01,
    ...     undeclared={"load_friction": (1, 0.2)},
    ...     random_state=0,
    ... )
    >>> robot = RobotIdentifier(
    ...     recording.robot_model(), dt=recording.dt, friction=("viscous",)
    ... )
    >>> loop = EffectDiscovery(robot, effects=["load_friction"], random_state=0)
    >>> loop = loop.fit(recording.q, recording.tau)
    >>> [(effect.name, effect.joint) for effect in loop.effects_]
    [('load_friction', 1)]
    >>> bool((loop.error_after_ < loop.error_before_).all())
    True
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
    def fit(
        self,
        X,
        y,
        groups=None,
        sample_weight=None,
        t=None,
        signals=None,
    ):
        """Search for effects.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions [rad or m], uniformly sampled; or states [q | v | a].
            Columns of a data frame are matched by joint name.
        y : array-like of shape (n_samples, nv)
            Joint torques [N m] or forces [N]; as X.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights; zero leaves a sample out.
        t : array-like of shape (n_samples,), default=None
            Time [s], rising over all recordings; None counts the identifier's `dt`.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Recorded signals, such as a temperature, by name (or a
            data frame): candidates for what friction and offsets vary with
            (`effects.Signal`). Columns of a data frame X that are not a channel of a
            joint are candidates as well; of these, the report names those that cannot
            be used.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If a parameter is invalid, the recording is too short for blocks of time,
            a channel is faulty (constant, of the wrong sign, swapped, in degrees), or
            one of `signals` is (constant, not finite, a position, velocity, torque or
            time by another name).

        Warns
        -----
        DoubtWarning
            If a channel may be wrong, such as torques in an unexpected unit.
        """
        library = self._check_parameters()
        whole, beside = self._recording(X, y, groups, sample_weight, t)
        drive = self.identifier.drive
        if drive is not None:
            commanded, signals = drive.taken(whole.tau, signals)
            whole = drive.driven(replace(whole, signals=commanded))
        whole = replace(whole, joints_named=carries_names(X, self.joint_names_))
        self._fit(whole, library, signals, beside, _names(whole, groups))
        for found in self.report_.outcome.findings["channels"]:
            if found.severity == "warning":
                warnings.warn(found.message, DoubtWarning, stacklevel=3)
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
        known = recording.groups, recording.weight, None
        whole, _ = self._recording(recording.inputs, recording.tau, *known)
        whole = replace(
            whole,
            command=recording.command,
            feedback=recording.feedback,
            torque_units=recording.torque_units,
            joints_named=recording.joints_named,
        )
        names = tuple(map(str, recording.group_names))
        return self._fit(whole, library, signals, OfferedSignals(), names)

    def _fit(self, whole, library, signals, beside, names):
        """Search in a checked recording with its signals, and set the results."""
        declared = check_effects(self.identifier.effects, whole.nv)
        drive = self.identifier.drive
        if drive is not None and drive.unsigned and whole.command is None:
            # Signs of rows that are not fitted follow from what was.
            split = split_in_time(self.identifier, whole, self.test_size)
            part = split.searched(whole)
            fitted = clone(self.identifier).fit_inspected(part)
            whole = signed(fitted.robot_, whole)
        signals, unusable = survey(signals, beside, whole, (*library, *declared))
        whole = replace(whole, signals=signals)
        with show_progress(self.verbose):
            outcome, self._expectation = self._close(whole, library, unusable, names)
        for name in ("effects", "possible", "unexplained", "not_identifiable"):
            setattr(self, f"{name}_", outcome.findings[name])
        for name in ("before", "plain", "after"):
            setattr(self, f"error_{name}_", outcome.column(name))
        self.torque_std_ = outcome.column("spread")
        self.report_ = Report(outcome)
        return self

    # -- what was given ----------------------------------------------------------------

    def _check_parameters(self):
        """Check what was given; return the library to search."""
        self._validate_params()
        given = self.identifier
        if given.criterion != "torque":
            raise ValueError(
                'identifier must have criterion="torque"; the search needs torque '
                f"residuals. Got {given.criterion!r}. Refine the result "
                'afterwards: loop.identifier_.set_params(criterion="simulation").'
            )
        library = resolve(self.effects)
        if given.asked_gains is not None:
            # They are declared on every channel.
            library = [one for one in library if not isinstance(one, TorqueGain)]
        if given.drive is None or not given.drive.of_positions:
            return library
        # Effects that its simulation cannot have would change the values of the others.
        left = {one.name: unfollowed(one) for one in library if unfollowed(one)}
        if left and not isinstance(self.effects, str):
            names = "; ".join(f"{name} ({why})" for name, why in left.items())
            kind = type(given.drive).__name__
            message = f"Not available with {kind}: {names}."
            warnings.warn(message, UserWarning, stacklevel=4)
        return [one for one in library if one.name not in left]

    def _recording(self, X, y, groups, sample_weight, t):
        """Make a `Recording` with a clock of the arguments of a fit; other columns."""
        self.joint_names_ = names = joint_names(load_model(self.identifier.model))
        X, y, columns = checked_arrays(self, names, X, y)
        weight = check_weight(sample_weight, y.shape)
        dt = check_dt(self.identifier.dt)
        clock = check_clock(t, X.shape[0], dt)
        given = {"dt": dt, "joint_names": names}
        return take_arrays(X, y, groups, weight, clock, **given), columns

    # -- stages ------------------------------------------------------------------------

    def _close(self, whole, library, unusable, names):
        """Close the loop on a checked recording; return what `make_outcome` does."""
        say("channels")
        channels = () if whole.states is not None else self._inspected(whole)
        silent = [j for f in channels if f.kind in NO_INFORMATION for j in f.joints]
        self.torque_lag_ = 0.0
        for found in (x.value for x in channels if x.kind == "delay"):
            again = clone(self.identifier).fit_inspected(whole, found, compare=False)
            self.torque_lag_ = again.torque_lag_
            whole = with_torques_shifted(whole, self.torque_lag_)
        say("declared model")
        split = split_in_time(self.identifier, whole, self.test_size)
        part = split.searched(whole)
        self.declared_ = clone(self.identifier).fit_inspected(part, compare=False)
        self.baseline_ = self.declared_
        if set(declarable()) - set(self.declared_.features_.friction_):
            # Plain terms that are declared as effects of single joints would be twice.
            own = tuple(
                effect
                for effect in self.identifier.effects
                if effect.name not in declarable() or any(effect.shape().values())
            )
            plain = {"friction": declarable(), "effects": own}
            plain = clone(self.identifier).set_params(**plain)
            self.baseline_ = plain.fit_inspected(part, compare=False)
        known = {
            "begins": tuple(whole.t[rows.start] for rows in whole.segments),
            "repetition": find_repetition(whole.q, whole.t, whole.segments),
        }
        near = split.narrowed(*self._seen(part, split.moving[split.rows]))
        seen = part if near is split else near.searched(whole)
        say("search")
        given = {"origin": whole.groups[near.rows], **known}
        found = self._search(seen, silent, given, library)
        say("held-out judgement")
        named = self.baseline_
        if found.effects:
            named = self._with(found.effects, named, part)
        unnamed = self._unnamed(found, named)
        self.validation_model_ = named.beside(unnamed)
        # Copies of most rows are not needed any more.
        del part, seen
        judged = judge(self, found, split, near, whole)
        say("final model")
        final = self._hand_over(found, named, whole, split.moving, silent, known)
        self.identifier_ = final.identifier.beside(that_help(final, unnamed))
        channels = (*channels, *unusable)
        say("explaining")
        return make_outcome(self, found, final, judged, channels, whole, names)

    def _inspected(self, whole):
        """Return the findings on the channels; raise if one of them is wrong."""
        findings = self.identifier.findings(whole)
        measured = self.identifier.drive is None and self.identifier.gains is None
        wrong = refusal(findings, whole.torque_units if measured else ())
        if wrong is not None:
            raise wrong
        return findings

    def _seen(self, recording, moving):
        """Return the rows of a recording that are looked at, and their stretches."""
        return stretches(recording.segments, moving, self.baseline_.robot_.plan.lowpass)

    def _search(self, part, silent, given, library):
        """Search the robot, or its branches one by one where there are many joints."""
        settings = SearchSettings() if self.settings is None else self.settings
        view = RecordingView(self.baseline_, part, silent, **given)
        branches = branches_of(self.baseline_, library, self.max_effects)
        if len(branches) == 1 and view.precision.any():
            return search(view, library, settings, self.alpha, self.max_effects)
        heard = [b for b in branches if view.precision[b.joints].any()]
        # As many effects are expected of all branches together as of one robot.
        share = replace(settings, expected=settings.expected / max(len(heard), 1))
        found = []
        for branch in heard:
            alone = branch.view(self.baseline_.robot_, part, silent, **given)
            found.append(search(alone, library, share, self.alpha))
        if not found:
            return search(view, (), settings, self.alpha)
        theta = self.baseline_.theta_unconstrained_
        motion = view.motion_of(self.baseline_.robot_.linear_part(theta))
        return put_together(view, motion, heard, found)

    def _with(self, effects, begin, recording, **settings):
        """Fit the model with the plain terms and effects; begin: where values start."""
        plain = self.baseline_
        settings["effects"] = (*plain.effects_, *effects)
        if plain.gains_ is not None:
            # Channels that were the units of gains stay that.
            names = plain.joint_names_
            settings["gains"] = tuple(names[j] for j in plain.gains_.references)
        again = clone(plain).set_params(**settings)
        return again.fit_inspected(recording, compare=False, before=begin.robot_)

    def _unnamed(self, found, named):
        """Find the joint torque beyond the effects; none where few were looked for."""
        if not isinstance(self.effects, str) or self.identifier.drive is not None:
            return ()
        fit = FinalFit(self.baseline_, named, found.view)
        return unnamed_torques(fit, found.settings)

    def _hand_over(self, found, begin, whole, moving, silent, known):
        """Fit the completed model to all data, in the band that was judged."""
        band = {}
        if isinstance(self.identifier.cutoff, str):
            cutoff = self.validation_model_.cutoff_
            band["cutoff"] = cutoff if np.isfinite(cutoff) else None
        options = self.identifier.fit_options
        if isinstance(options.standstill, str):
            standstill = self.validation_model_.standstill_
            band["options"] = replace(options, standstill=standstill)
        rows, pieces = self._seen(whole, moving)
        seen = whole
        if rows.size < whole.n_samples:
            seen = take_rows(whole, rows, pieces)
        origin = whole.groups[rows]
        given = {"origin": origin, "all_samples": True, **known}
        view = RecordingView(self.baseline_, seen, silent, **given)
        view = view.with_rest(remembering(found.effects))
        if found.branches:
            known = self.baseline_.robot_, seen, silent
            effects = tuned_apart(found, lambda b: b.view(*known, **given))
        else:
            effects = tuned_on(view, found.effects, found.settings)
        named = self._with(effects, begin, whole, **band)
        share = seen.n_samples / whole.n_samples
        return FinalFit(self.baseline_, named, view, share)

    # -- predictions -------------------------------------------------------------------

    @wraps(IdentifiedRobot.predict)
    def predict(self, X, groups=None, t=None, signals=None):
        check_is_fitted(self)
        return self.identifier_.predict(X, groups=groups, t=t, signals=signals)

    def expected_error(self, X, groups=None, t=None, signals=None):
        """Predict the error of the completed model on another motion.

        It is the error on held-out data, larger for speeds, accelerations and loads
        beyond those of the fit, and what friction, gains, offsets and the load differ
        by between recordings. The report has the same for motion like the fitted.

        Parameters
        ----------
        X, groups, t, signals : array-like
            Positions or states of the motion, as for `predict`.

        Returns
        -------
        error : ndarray of shape (nv,)
            Median of the RMS error over `torque_std_`; nan for a joint without an error
            on held-out data.
        interval : ndarray of shape (2, nv)
            Ends between which it is in nine of ten recordings.
        """
        predicted = self.predict(X, groups, t, signals)
        robot, spread = self.identifier_, self.torque_std_
        X, _ = positions_and_signals(X, self.joint_names_)
        states = np.asarray(robot.robot_.states(X, groups))
        speeds = np.abs(np.split(states, 3, axis=1)[1])
        moving = (speeds > np.maximum(robot.standstill_, 0.0)).astype(float)
        motion = motions_of(robot, states, predicted, moving, spread)
        error, low, high = self._expectation.of(motion)[:, :-1]
        return error, np.stack([low, high])


def _names(whole, groups):
    """Return what each recording is called: its label, or its number from 1."""
    labels = range(1, len(whole.segments) + 1)
    if groups is not None:
        given = [np.asarray(groups)[rows.start] for rows in whole.segments]
        if given != list(range(len(given))):
            labels = given
    return tuple(str(label) for label in labels)
