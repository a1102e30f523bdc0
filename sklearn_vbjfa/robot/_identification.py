"""The steps of an identification, without the public estimator around them.

`RobotIdentifier` checks its arguments and runs these steps on recordings in memory; on
a running robot (`partial_fit`) and on recordings on several machines other parts bring
the statistics, and the steps from there on are the same. They are a class since all of
them read the estimator's parameters and set its attributes.
"""

import itertools

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._base import BaseJointFactorRegressor
from sklearn_vbjfa.effects._rest import Rest
from sklearn_vbjfa.robot import _friction, _torque_noise
from sklearn_vbjfa.robot._consistency import (
    identifiable,
    min_eigenvalues,
    project_beside,
)
from sklearn_vbjfa.robot._effect_columns import (
    RegressorRows,
    check_effects,
    effect_names,
    make_motion,
)
from sklearn_vbjfa.robot._equations import (
    Stretch,
    accumulate,
    edge_rows,
    filtered_equations,
    numbered_parts,
    run,
    unexcited_entries,
)
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._groups import check_dt
from sklearn_vbjfa.robot._joint_statistics import split_residual
from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor
from sklearn_vbjfa.robot._model import joint_names
from sklearn_vbjfa.robot._motion_facts import MotionFacts, merge_all, n_fastest
from sklearn_vbjfa.robot._recording_checks import CUTOFF_PER_BANDWIDTH, check_count
from sklearn_vbjfa.robot._residuals import collect_residuals
from sklearn_vbjfa.robot._states import SplineStates, fit_states, smooth_to

# Filtered rows of the feature matrix that are in memory at once.
_CHUNK_BYTES = 32 << 20


def smooth_recording(x, start, estimator, keep, *, halves):
    """States of one recording by splines, and what all have to know of it.

    Parameters
    ----------
    x : ndarray of shape (n, nv)
        Positions.
    start : int
        Number of its first row, for messages.
    estimator : StateEstimator
        Fitted estimator.
    keep : int
        `n_fastest` of all recordings.
    halves : bool
        Whether to make states from the even and from the odd samples as well.

    Returns
    -------
    states : SplineStates
        States.
    halves : tuple of SplineStates or None
        States from the even and from the odd samples.
    facts : MotionFacts
        Range and speeds.
    """
    n = x.shape[0]
    states = SplineStates(estimator._splines(x, start), n)
    both = None
    if halves:
        both = tuple(SplineStates(s, n) for s in estimator._half_splines(x, start))
    rows = slice(None)
    positions, speeds = states.derivative(rows, 0), states.derivative(rows, 1)
    return states, both, MotionFacts.of(positions, speeds, keep)


class IdentificationSteps:
    """What `RobotIdentifier` does between its arguments and its attributes."""

    def _load_robot(self):
        """Load the model and name what will be identified."""
        self.features_ = RigidBodyFeatures(self.model, friction=self.friction)._load()
        self._nv = self.features_.n_joints_
        self.joint_names_ = joint_names(self.features_._model)
        self.effects_ = check_effects(self.effects, self._nv)
        names, units = effect_names(self.effects_, self.features_._model)
        self.parameter_names_ = self.features_.parameter_names_ + names
        self.parameter_units_ = self.features_.parameter_units_ + units
        self._load_theta = None
        self._active_effects = ()

    # -- states ----------------------------------------------------------------

    def _fit_states(self, X, groups, parts, periods):
        """States and halves of all recordings, and what is known of the motion.

        Where positions are given both are lists of `SplineStates`, one a recording;
        where states are given, or a mean period is, arrays of all rows. The halves are
        None where the noise is not asked for.
        """
        self.state_estimator_ = None
        if X.shape[1] == self._nv:
            source = (X, groups) if periods is None else periods.both_starts()
            self.state_estimator_ = self._new_state_estimator(*source)
        if periods is not None:
            even, odd = periods.states(self.state_estimator_)
            # smoothing is linear: these are the states of the mean
            halves = None if self.input_noise is None else (even, odd)
            states = 0.5 * (even + odd)
        elif self.state_estimator_ is None:
            states, halves = X, None
        else:
            return self._smooth(X, parts)
        v = states[:, self._nv : 2 * self._nv]
        keep = n_fastest(states.shape[0])
        return states, halves, MotionFacts.of(states[:, : self._nv], v, keep)

    def _smooth(self, X, parts):
        keep, halves = n_fastest(X.shape[0]), self.input_noise is not None
        tasks = [
            (X[part], part.start, self.state_estimator_, keep, halves) for part in parts
        ]
        made = list(run(_smooth_task, tasks, self.n_jobs))
        states, halves, facts = zip(*made)
        halves = None if halves[0] is None else tuple(map(list, zip(*halves)))
        return list(states), halves, merge_all(facts, keep)

    def _halves(self, X, groups):
        """States from the even and from the odd samples, where the noise is asked."""
        if self.input_noise is None or self.state_estimator_ is None:
            return None
        return self.state_estimator_.split_transform(X, groups=groups)

    def _new_state_estimator(self, X, groups):
        return fit_states(check_dt(self.dt), self.state_cutoff, X, groups)

    def _states(self, X, groups, *, in_band=False):
        """States of a query; `in_band` smooths to the band that was identified."""
        return self._states_and_rest(X, groups, in_band=in_band)[0]

    def _states_and_rest(self, X, groups, *, in_band=False):
        """States of a query, and the `Rest` that tells the signs of their speeds."""
        if X.shape[1] == 3 * self._nv:
            return X, self._rest(np.zeros(self._nv))
        estimator = self.state_estimator_
        if estimator is None:
            estimator = self._new_state_estimator(X, groups)
        if in_band:
            estimator = smooth_to(estimator, self.cutoff_)
        states = estimator.transform(X, groups=groups)
        return states, self._rest(estimator._velocity_noise())

    def _rest(self, noise):
        """Return what tells the signs of velocities with this noise (nv,)."""
        time = np.full(self._nv, CUTOFF_PER_BANDWIDTH / self.cutoff_)
        if not np.isfinite(self.cutoff_):
            # rows of a running robot do not tell it either
            time = getattr(self, "_fastest_period", time)
        # What masks nothing is negative.
        return Rest(speed=np.maximum(self.standstill_, 0.0), time=time, noise=noise)

    # -- equations -------------------------------------------------------------

    def _corrects_noise(self):
        """Whether the regressor takes a measured covariance of the input noise."""
        return self.regressor is None or (
            getattr(self.regressor, "latent", None) == "correlated"
            and self.regressor.input_noise is None
        )

    def _filtered(self, states, y, weight, parts, lowpass, halves=None, t=None, **kw):
        """Yield the equations of what moves, see `filtered_equations`."""
        stretches = self._stretches(states, y, weight, parts, halves, t, **kw)
        return filtered_equations(stretches, lowpass, chunk_bytes=_CHUNK_BYTES)

    def _stretches(
        self, states, y, weight, parts, halves=None, t=None, *, ends=True, rest=None
    ):
        """Join recordings and their regressor matrices, ready for the low-pass.

        States are arrays of all rows, or lists of one entry a recording. A `Rest` is
        for comparing; what is fitted is masked at rest.
        """
        average = halves is not None and self._corrects_noise()
        rows = [None] * len(parts)
        if not average:
            rows = self._rows_by_part(states, parts, t, rest)
        both = [None] * len(parts)
        if halves is not None:
            both = list(zip(*[self._rows_by_part(half, parts, t) for half in halves]))
        smoother = self.state_estimator_ if ends else None
        return [
            Stretch(
                first=part.start,
                states=own,
                rows=row,
                halves=pair,
                torque=y[part],
                weight=weight[part],
                standstill=self.standstill_,
                edge=edge_rows(part.stop - part.start, smoother),
                number=number,
            )
            for number, (part, own, row, pair) in enumerate(
                zip(parts, _each(states, parts), rows, both)
            )
        ]

    def _rows_by_part(self, states, parts, t, rest=None):
        if self._active_effects:
            # Effects look at all recordings together (time, largest speeds).
            whole = states
            if isinstance(states, list):
                whole = np.concatenate([own[:] for own in states])
            rows = self._rows(whole, parts, t, rest)
            return [rows.part(part) for part in parts]
        return [
            RegressorRows(self.features_, own, rest=rest)
            for own in _each(states, parts)
        ]

    def _rows(self, states, parts, t, rest=None):
        """Regressor matrices of states, with the effects' columns."""
        motion, effects = None, self._active_effects
        if effects:
            signals = states, t, parts, self._load_theta, self.cutoff_
            motion = make_motion(self.features_, *signals, rest)
        return RegressorRows(self.features_, states, effects, motion, rest)

    # -- estimation ------------------------------------------------------------

    def _takes_statistics(self):
        """Whether second moments are all that the regressor needs."""
        known = self.regressor is None or isinstance(
            self.regressor, BaseJointFactorRegressor
        )
        return known and not self.block_noise

    def _new_estimator(self):
        self.estimator_ = JointTorqueRegressor(
            None if self.regressor is None else clone(self.regressor),
            joint_weights=self.joint_weights,
            block_noise=self.block_noise,
            dt=self.dt,
            cutoff=self.cutoff_ if np.isfinite(self.cutoff_) else None,
        )
        self.estimator_._begin()

    def _fit_stretches(self, stretches, lowpass):
        """Estimate from recordings, in parallel where statistics are all it takes."""
        if not self._takes_statistics():
            return self._fit_equations(
                filtered_equations(stretches, lowpass, chunk_bytes=_CHUNK_BYTES),
                numbered_parts(stretches, lowpass, chunk_bytes=_CHUNK_BYTES),
            )
        stats = accumulate(
            stretches, lowpass, chunk_bytes=_CHUNK_BYTES, n_jobs=self.n_jobs
        )
        return self._fit_statistics(stats)

    def _fit_equations(self, pieces, parts=None):
        """Estimate from filtered (index, Phi, tau, weight), which may be a stream.

        Without `numbered_parts` the equations count as independent.
        """
        self._new_estimator()
        for (_, *equations), own in zip(pieces, parts or itertools.repeat(None)):
            self.estimator_._accumulate(*equations, parts=own)
        return self._estimate()

    def _fit_statistics(self, stats):
        """Estimate from the second moments of all equations."""
        self._new_estimator()
        self.estimator_._stats = stats
        return self._estimate()

    def _estimate(self):
        stats = self.estimator_._stats
        check_count(stats, self.standstill_, len(self.parameter_names_))
        self.estimator_._forget(unexcited_entries(stats, self.features_.n_parameters_))
        self.estimator_._finish()
        self._constrain()
        return self

    def _constrain(self):
        """Project, and derive what the data determine."""
        self.theta_unconstrained_ = self.estimator_.theta_unconstrained_
        self.theta_std_ = self.estimator_.theta_std_
        metric = self.estimator_.metric_
        self.identifiable_ = identifiable(metric)
        self.theta_ = self.theta_unconstrained_
        self.projector_ = None
        if self.projector is not None:
            self.projector_, self.theta_ = project_beside(
                self.projector,
                self.features_._model,
                self.theta_unconstrained_,
                metric,
                _friction.check_names(self.friction),
            )
        self.min_eigenvalues_ = min_eigenvalues(self._bodies())
        noise = split_residual(self.estimator_.statistics_, self.theta_)
        self.input_noise_torque_, self.output_noise_ = noise
        self.noise_floor_ = np.hypot(self.torque_noise_, self.input_noise_torque_)

    # -- noise of the torques --------------------------------------------------

    def _noise_facts(self, X, y, t=None):
        """Return what one recording says of the noise of its torques, or None."""
        if not _torque_noise.seen(self.dt, self.cutoff_):
            return None
        states = self._states(X, None, in_band=True)
        residual = y - self.predict(states, t=t)
        return _torque_noise.noise_facts(residual, y, states, self.dt, self.cutoff_)

    def _tell_noise(self, facts):
        """Set the floor from the `_noise_facts` of all recordings."""
        facts = [found for found in facts if found is not None]
        if facts:
            self.torque_noise_ = _torque_noise.filtered_noise(
                facts, self.dt, self.cutoff_
            )
        self.noise_floor_ = np.hypot(self.torque_noise_, self.input_noise_torque_)

    def _bodies(self):
        """Parameters of the features, (nv, 10 + number of friction columns)."""
        return self.theta_[: self.features_.n_parameters_].reshape(self._nv, -1)

    def _residuals_of(self, pieces):
        return collect_residuals(pieces, self.theta_)


def _smooth_task(x, start, estimator, keep, halves):
    return smooth_recording(x, start, estimator, keep, halves=halves)


def _each(states, parts):
    """States of each recording, out of an array of all rows unless they are that."""
    return states if isinstance(states, list) else [states[part] for part in parts]
