"""From positions and torques to a physically consistent rigid-body model."""

import os
import warnings

import numpy as np
from scipy import linalg
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.physical import PhysicalProjector, body_scales, min_eigenvalue
from sklearn_vbjfa.robot import _friction
from sklearn_vbjfa.robot._anchor import consistent_anchor
from sklearn_vbjfa.robot._features import RigidBodyFeatures, rounding_entries
from sklearn_vbjfa.robot._groups import check_cutoff, check_dt, contiguous_groups
from sklearn_vbjfa.robot._joint_statistics import residual_squares
from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor, filter_weight
from sklearn_vbjfa.robot._model import joint_names
from sklearn_vbjfa.robot._residuals import TorqueResiduals
from sklearn_vbjfa.robot._states import StateEstimator
from sklearn_vbjfa.robot._torque_noise import torque_noise
from sklearn_vbjfa.robot._urdf import write_urdf

# Parallel filtering after Gautier: the low-pass lies at five times the bandwidth of
# the motion, high enough for the friction at reversals, low enough for what shakes.
_CUTOFF_PER_BANDWIDTH = 5.0
# ... but its length must stay a small part of the shortest recording.
_SHORTEST_CUTOFF_PERIODS = 36.0
# Below this share of a joint's (99.5th percentile of) speed it counts as standing
# still: its friction may then take any value inside the band of stiction.
_STANDSTILL_SHARE = 0.02
# The state cut-off of least acceleration error, times this: what smoothing takes from
# the motion biases the parameters however long the recording, while noise averages
# out and is corrected for.
_LIGHTER_SMOOTHING = 1.25
# Periods of the state cut-off at both ends in which the smoother sees one side only.
_EDGE_PERIODS = 1.0
# Rows of the feature matrix that are in memory at once.
_CHUNK_BYTES = 64 << 20
# Directions of parameter space that the data determine less than this, relative to
# the best determined one in scaled columns, count as not identifiable.
_IDENTIFIABLE = 1e-9


class RobotIdentifier(RegressorMixin, BaseEstimator):
    """Identify a robot: joint positions and torques in, rigid-body model out.

    The whole chain: states from positions, regressor matrices, parallel low-pass of
    regressors and torques, standstill masked, weighted estimation of one parameter
    vector, projection on physically consistent ones.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Path of a URDF file, or a model; a tree of one-degree-of-freedom joints. Its
        inertias serve to complete what the data cannot tell, see `theta_`.
    dt : float, default=None
        Sample period [s]; needed unless states are given and nothing is filtered.
    friction : tuple of {"viscous", "coulomb", "offset", "rotor_inertia"}, \
            default=("viscous",)
        Further columns of each joint.
    regressor : estimator, default=None
        Linear regressor, see `JointTorqueRegressor`; None is
        ``VBJFARegressor(latent="correlated", input_noise=0.0)``.
    projector : "default", PhysicalProjector or None, default="default"
        Projection of the parameters; None leaves them as estimated.
    cutoff : "auto", float or None, default="auto"
        Cut-off [Hz] of the low-pass that regressors and torques pass. ``"auto"``:
        five times the bandwidth of the motion (the frequency below which 99 % of the
        power of the velocity lies, the fastest joint), as in Gautier's practice;
        without positions (states given) nothing is filtered. None filters nothing.
    state_cutoff : "auto", float, array-like of shape (nv,) or None, default="auto"
        Cut-off [Hz] of `StateEstimator`. ``"auto"``: 1.25 times the one of least
        acceleration error; smoothing bias does not average out, noise does.
    standstill : "auto", float, array-like of shape (nv,) or None, default="auto"
        Speed [rad/s or m/s] at or below which a joint's equations are left out.
        ``"auto"``: 2 % of the 99.5th percentile of its speed in the recordings of the
        fit. None masks nothing.
    joint_weights : "auto", None or array-like of shape (nv,), default="auto"
        Weights of the joints' equations, see `JointTorqueRegressor`.
    block_noise : bool, default=False
        Whether stretches of time in which the model fails count less, see
        `JointTorqueRegressor`.
    input_noise : "auto" or None, default="auto"
        ``"auto"``: where positions are given, the noise of the regressors is measured
        by making them from the even and from the odd samples separately, whose white
        encoder noise is independent, and a regressor that takes a noise covariance
        (the default one) corrects for it. None takes the regressors as exact.

    Attributes
    ----------
    theta_ : ndarray of shape (p,)
        Parameters, physically consistent if projected. Directions that the data do not
        determine are completed from the model's inertias, scaled to the data.
    theta_unconstrained_ : ndarray of shape (p,)
        Parameters before the projection.
    theta_std_ : ndarray of shape (p,)
        Posterior standard deviations of `theta_unconstrained_`, for independent
        residuals; nan where the regressor does not tell.
    parameter_names_, parameter_units_ : tuple of str
        Names ("joint_1:m") and units of the parameters.
    identifiable_ : ndarray of shape (p,), bool
        Parameters that the data determine on their own, not only in combinations.
    joint_names_ : tuple of str
        Joints in Pinocchio's order, the order of the columns of X and y.
    min_eigenvalues_ : ndarray of shape (nv,)
        Smallest eigenvalue of each body's pseudo-inertia matrix in units of the
        body's mass and length scale; positive for a physically consistent body.
    noise_floor_ : ndarray of shape (nv,)
        Standard deviation of `residuals` to expect from noise alone, if the model
        lacked nothing [N m or N]: input noise through the parameters, and the white
        noise of the torque sensors, measured above the band of the fit.
    torque_noise_ : ndarray of shape (nv,)
        The torque sensors' part of it [N m or N]; nan where nothing lies above the
        band.
    input_noise_torque_ : ndarray of shape (nv,)
        The input noise's part of it [N m or N].
    output_noise_ : ndarray of shape (nv,)
        Standard deviation of what input noise does not explain of the residual of the
        fit [N m or N]; above `torque_noise_` by what the model lacks.
    cutoff_ : float
        Cut-off of the low-pass in use [Hz]; infinity without.
    standstill_ : ndarray of shape (nv,)
        Speeds at or below which samples are left out.
    state_estimator_ : StateEstimator or None
        None if the fit got states.
    features_ : RigidBodyFeatures
        Features.
    estimator_ : JointTorqueRegressor
        Estimation of the parameters.
    n_features_in_ : int
        nv or 3 nv.

    Notes
    -----
    The feature matrix is made and reduced to second moments piece by piece and never
    held as a whole (unless `regressor` needs the equations themselves).

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> recording = load_demo_recording()
    >>> robot = RobotIdentifier(recording.robot_model(), dt=recording.dt)
    >>> robot = robot.fit(recording.q, recording.tau, groups=recording.groups)
    >>> bool((robot.min_eigenvalues_ > 0).all())
    True
    """

    def __init__(
        self,
        model,
        *,
        dt=None,
        friction=("viscous",),
        regressor=None,
        projector="default",
        cutoff="auto",
        state_cutoff="auto",
        standstill="auto",
        joint_weights="auto",
        block_noise=False,
        input_noise="auto",
    ):
        self.model = model
        self.dt = dt
        self.friction = friction
        self.regressor = regressor
        self.projector = projector
        self.cutoff = cutoff
        self.state_cutoff = state_cutoff
        self.standstill = standstill
        self.joint_weights = joint_weights
        self.block_noise = block_noise
        self.input_noise = input_noise

    def __sklearn_tags__(self):
        """Tags of a regressor with several outputs."""
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        tags.target_tags.single_output = True
        return tags

    def fit(self, X, y, groups=None, sample_weight=None):
        """Identify the robot.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions [rad or m], rows equidistant in time; or states
            [q | v | a].
        y : array-like of shape (n_samples, nv)
            Joint torques [N m] or forces [N].
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings; nothing is differentiated or filtered
            across their borders.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights; zero leaves a sample (of one joint) out.

        Returns
        -------
        self : object
            Fitted estimator.
        """
        self.features_ = RigidBodyFeatures(self.model, friction=self.friction)._load()
        self._nv = self.features_.n_joints_
        self.joint_names_ = joint_names(self.features_._model)
        self.parameter_names_ = self.features_.parameter_names_
        self.parameter_units_ = self.features_.parameter_units_
        X, y = self._validate(X, y)
        parts = contiguous_groups(groups, X.shape[0])
        states = self._fit_states(X, groups)
        self._check_channels(states, y)
        self.cutoff_ = self._resolve_cutoff(parts)
        self.standstill_ = self._resolve_standstill(states)
        weight = JointTorqueRegressor._check_weight(sample_weight, y.shape)
        lowpass = _lowpass.design(self.dt or 1.0, self.cutoff_)
        self._check_length(parts, lowpass)
        self.torque_noise_ = torque_noise(
            [y[part] for part in parts], self.dt, self.cutoff_
        )
        halves = self._halves(X, groups)
        return self._fit_equations(
            self._filtered(states, y, weight, parts, lowpass, halves)
        )

    def _halves(self, X, groups):
        """States from the even and from the odd samples, where the noise is asked."""
        if self.input_noise not in ("auto", None):
            raise ValueError(
                "input_noise must be 'auto' (measured from the recording) or None "
                f"(taken as zero); got {self.input_noise!r}."
            )
        if self.input_noise is None or self.state_estimator_ is None:
            return None
        return self.state_estimator_.split_transform(X, groups=groups)

    def _fit_equations(self, pieces):
        """Estimate from filtered (index, Phi, tau, weight), which may be a stream."""
        self.estimator_ = JointTorqueRegressor(
            None if self.regressor is None else clone(self.regressor),
            joint_weights=self.joint_weights,
            block_noise=self.block_noise,
            dt=self.dt,
            cutoff=self.cutoff_ if np.isfinite(self.cutoff_) else None,
        )
        self.estimator_._begin()
        for _, *equations in pieces:
            self.estimator_._accumulate(*equations)
        self._check_count(self.estimator_._stats)
        self.estimator_._forget(self._rounding_columns(self.estimator_._stats))
        self.estimator_._finish()
        self._constrain()
        return self

    # -- input -----------------------------------------------------------------

    def _validate(self, X, y):
        nv = self._nv
        X, y = validate_data(
            self, X, y, dtype=np.float64, multi_output=True, y_numeric=True
        )
        y = np.asarray(y, dtype=float).reshape(X.shape[0], -1)
        if X.shape[1] not in {nv, 3 * nv}:
            raise ValueError(
                f"The robot has {nv} joint(s) ({', '.join(self.joint_names_)}), so X "
                f"must have {nv} columns of positions or {3 * nv} of states "
                f"[q | v | a]; got {X.shape[1]}. Leave out channels of locked joints, "
                "or lock joints that were not recorded with "
                "pinocchio.buildReducedModel."
            )
        if y.shape[1] != nv:
            raise ValueError(
                f"The robot has {nv} joint(s) ({', '.join(self.joint_names_)}), so y "
                f"must have {nv} column(s) of torques; got {y.shape[1]}."
            )
        return X, y

    def _fit_states(self, X, groups):
        if X.shape[1] == 3 * self._nv and X.shape[1] != self._nv:
            self.state_estimator_ = None
            return X
        dt = check_dt(self.dt)
        estimator = StateEstimator(dt, cutoff=self.state_cutoff).fit(X, groups=groups)
        if isinstance(self.state_cutoff, str):
            lighter = np.minimum(_LIGHTER_SMOOTHING * estimator.cutoff_, 1 / (3 * dt))
            lighter = np.where(np.isfinite(estimator.cutoff_), lighter, np.inf)
            estimator = StateEstimator(
                dt, cutoff=[c if np.isfinite(c) else None for c in lighter]
            ).fit(X, groups=groups)
        self.state_estimator_ = estimator
        return estimator.transform(X, groups=groups)

    def _states(self, X, groups, *, in_band=False):
        """States of a query; `in_band` smooths to the band that was identified."""
        if X.shape[1] == 3 * self._nv:
            return X
        estimator = self.state_estimator_
        if estimator is None:
            estimator = StateEstimator(check_dt(self.dt), cutoff=self.state_cutoff)
            estimator.fit(X, groups=groups)
        if in_band:
            cutoffs = np.minimum(estimator.cutoff_, self.cutoff_)
            estimator = clone(estimator).set_params(
                cutoff=[c if np.isfinite(c) else None for c in cutoffs]
            )
            estimator.fit(X, groups=groups)
        return estimator.transform(X, groups=groups)

    def _check_channels(self, states, y):
        """Refuse dead torque channels, name joints that do not move."""
        nv, names = self._nv, self.joint_names_
        still = [names[j] for j in range(nv) if not np.ptp(states[:, j]) > 0]
        if len(still) == nv:
            raise ValueError(
                "No joint moves in this recording; expected a motion that excites the "
                "joints to be identified. Check the position columns."
            )
        dead = [
            names[j]
            for j in range(nv)
            if not np.ptp(y[:, j]) > 0 and names[j] not in still
        ]
        if dead:
            raise ValueError(
                f"The torque of {', '.join(dead)} is constant while the joint moves: "
                "a channel without information cannot be fitted. Check the recording, "
                "or lock the joint in the model with pinocchio.buildReducedModel."
            )
        if still:
            warnings.warn(
                f"{', '.join(still)} never move(s) in this recording: the torque there "
                "is left out (stiction may have any value), friction is not "
                "identifiable, and inertial parameters only as far as other joints "
                "feel them.",
                UserWarning,
                stacklevel=3,
            )

    def _resolve_cutoff(self, parts):
        if isinstance(self.cutoff, str):
            if self.cutoff != "auto":
                raise ValueError(
                    f"cutoff must be 'auto', a frequency in Hz, or None; got "
                    f"{self.cutoff!r}."
                )
            if self.state_estimator_ is None:
                return np.inf
            bandwidth = self.state_estimator_.bandwidth_.max()
            length = max(part.stop - part.start for part in parts) * self.dt
            cutoff = max(
                _CUTOFF_PER_BANDWIDTH * bandwidth, _SHORTEST_CUTOFF_PERIODS / length
            )
            return float(cutoff) if cutoff < 0.4 / self.dt else np.inf
        if self.cutoff is None:
            return np.inf
        return check_cutoff(self.cutoff, check_dt(self.dt), "cutoff")

    def _resolve_standstill(self, states):
        nv = self._nv
        if self.standstill is None:
            return np.full(nv, -1.0)
        if isinstance(self.standstill, str):
            if self.standstill != "auto":
                raise ValueError(
                    "standstill must be 'auto', a speed, or None; got "
                    f"{self.standstill!r}."
                )
            speed = np.abs(states[:, nv : 2 * nv])
            return _STANDSTILL_SHARE * np.quantile(speed, 0.995, axis=0)
        value = np.asarray(self.standstill, dtype=float)
        if value.shape not in {(), (nv,)} or not (value >= 0).all():
            raise ValueError(
                f"standstill must be one non-negative speed or {nv} of them; got "
                f"{self.standstill!r}."
            )
        return np.broadcast_to(value, (nv,)).copy()

    def _check_length(self, parts, lowpass):
        need = 2 * lowpass.half + 1
        short = [p for p in parts if p.stop - p.start < need]
        if len(short) == len(parts):
            longest = max(p.stop - p.start for p in parts)
            raise ValueError(
                f"The low-pass at {self.cutoff_:.4g} Hz is {need} samples long and "
                f"the longest recording has {longest}; give a longer recording or a "
                "higher cutoff (None for no low-pass)."
            )
        if short:
            rows = ", ".join(str(p.start) for p in short[:5])
            warnings.warn(
                f"{len(short)} of {len(parts)} recordings (from row {rows}) are "
                f"shorter than the low-pass filter ({need} samples) and are left out.",
                UserWarning,
                stacklevel=3,
            )

    def _check_count(self, stats):
        if stats is None or not stats.n.any():
            raise ValueError(
                "Every sample is masked as standstill; lower `standstill` (now "
                f"{np.array2string(self.standstill_, precision=3)}) or pass None."
            )
        count, p = int(stats.n_rows.sum()), len(self.parameter_names_)
        if count < p:
            raise ValueError(
                f"{count} equations (joints times filtered, moving samples) are fewer "
                f"than the {p} parameters; record for longer, or raise `cutoff`."
            )

    # -- computation -----------------------------------------------------------

    def _rounding_columns(self, stats):
        """Return which entries (nv, p) of the regressor matrices are rounding alone.

        The features leave out what is zero in every motion; where a joint does not
        move in this recording there is more.
        """
        nv = self._nv
        power = np.diagonal(stats.G, axis1=1, axis2=2).reshape(nv, nv, -1)
        return rounding_entries(power).reshape(nv, -1)

    def _filtered(self, states, y, weight, parts, lowpass, halves=None):
        """Yield (index, Phi, tau, weight) behind the low-pass, piece by piece.

        With states from the `halves` of the samples also None (instruments) and the
        difference of their regressor matrices.
        """
        nv, p = self._nv, self.features_.n_parameters_
        moving = np.abs(states[:, nv : 2 * nv]) > self.standstill_
        weight = weight * moving * self._away_from_ends(parts, y.shape[0])[:, None]
        per_row = 8 * nv * p
        for part in parts:
            n = part.stop - part.start
            centres = lowpass.centres(n)
            rows = max(_CHUNK_BYTES // per_row, 4 * lowpass.half, lowpass.step)
            count = max(1, rows // lowpass.step)
            for first in range(0, centres.size, count):
                chosen = centres[first : first + count]
                start = part.start + chosen[0] - lowpass.half
                stop = part.start + chosen[-1] + lowpass.half + 1
                piece = slice(start, stop)
                equations = (
                    part.start + chosen,
                    lowpass(self.features_._compute(states[piece])),
                    lowpass(y[piece]),
                    filter_weight(lowpass, weight[piece]),
                )
                if halves is not None:
                    even, odd = (self.features_._compute(h[piece]) for h in halves)
                    equations += (None, lowpass(even - odd))
                yield equations

    def _away_from_ends(self, parts, n):
        """Rows whose states rest on samples on both sides, ndarray (n,) of bool."""
        inside = np.ones(n, dtype=bool)
        if self.state_estimator_ is None:
            return inside
        slowest = self.state_estimator_.cutoff_.min()
        if not np.isfinite(slowest):
            return inside
        for part in parts:
            # At most a tenth of a short recording.
            length = part.stop - part.start
            edge = min(int(_EDGE_PERIODS / (slowest * self.dt)), length // 20)
            inside[part.start : part.start + edge] = False
            inside[part.stop - edge : part.stop] = False
        return inside

    def _constrain(self):
        """Project, and derive what the data determine."""
        self.theta_unconstrained_ = self.estimator_.theta_unconstrained_
        self.theta_std_ = self.estimator_.theta_std_
        metric = self.estimator_.metric_
        self.identifiable_ = _identifiable(metric)
        per_joint = self.features_.n_parameters_ // self._nv
        self.projection_ = None
        theta = self.theta_unconstrained_
        if self.projector is not None:
            theta = self._project(theta, metric, per_joint)
        self.theta_ = theta
        self.min_eigenvalues_ = _min_eigenvalues(theta, per_joint)
        self._split_residual()

    def _split_residual(self):
        """Split the residual into what input noise explains and the rest."""
        stats = self.estimator_.statistics_
        n = np.where(stats.n > 0, stats.n, np.nan)
        theta = self.theta_
        through = np.zeros(self._nv)
        if stats.noise is not None:
            through = np.einsum("i,jik,k->j", theta, stats.noise, theta) / n
            through = np.maximum(through, 0.0)  # rounding
        self.input_noise_torque_ = np.sqrt(through)
        rest = residual_squares(stats, theta) / n - through
        self.output_noise_ = np.sqrt(np.maximum(rest, 0.0))
        self.noise_floor_ = np.sqrt(self.torque_noise_**2 + through)

    def _project(self, theta, metric, per_joint):
        if isinstance(self.projector, str) and self.projector != "default":
            raise ValueError(
                "projector must be 'default', a PhysicalProjector or None; got "
                f"{self.projector!r}."
            )
        default = isinstance(self.projector, str)
        projector = PhysicalProjector() if default else clone(self.projector)
        names = _friction.check_names(self.friction)
        nonnegative = [
            j * per_joint + 10 + k
            for j in range(self._nv)
            for k, name in enumerate(names)
            if _friction.nonnegative(name)
        ]
        settings = {
            "metric": metric,
            "parameters_per_joint": per_joint,
            "nonnegative": nonnegative,
            "anchor": consistent_anchor(
                self.features_._model, theta, metric, per_joint
            ),
        }
        unset = {"metric": None, "parameters_per_joint": "auto", "anchor": None}
        unset["nonnegative"] = "auto"
        given = projector.get_params()
        projector.set_params(
            **{
                key: value
                for key, value in settings.items()
                if key in given and (default or _is_unset(given[key], unset[key]))
            }
        )
        self.projector_ = projector.fit(theta[None])
        return self.projector_.transform(theta[None])[0]

    def predict(self, X, groups=None):
        """Predict the joint torques.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions, which are smoothed up to the cut-off of the fit (above
            it nothing was identified); or states [q | v | a], which count as
            noiseless and are taken as they are.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.

        Returns
        -------
        ndarray of shape (n_samples, nv)
            Joint torques [N m] or forces [N], friction included.
        """
        check_is_fitted(self)
        X = self._validate_query(X)
        states = self._states(X, groups, in_band=True)
        rows = max(1, _CHUNK_BYTES // (8 * self._nv * self.theta_.size))
        return np.concatenate(
            [
                self.features_._compute(states[i : i + rows]) @ self.theta_
                for i in range(0, states.shape[0], rows)
            ]
        )

    def _validate_query(self, X):
        # Positions and states are both welcome, whichever the fit got.
        X = check_array(X, dtype=np.float64)
        return self._check_query_width(X)

    def _check_query_width(self, X):
        if X.shape[1] not in {self._nv, 3 * self._nv}:
            raise ValueError(
                f"X must have {self._nv} columns of positions or {3 * self._nv} of "
                f"states; got {X.shape[1]}."
            )
        return X

    def residuals(self, X, y, groups=None, sample_weight=None):
        """Compare with a recording, behind the low-pass and mask of the fit.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions, or states.
        y : array-like of shape (n_samples, nv)
            Measured torques.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights; zero leaves a sample out.

        Returns
        -------
        TorqueResiduals
            Filtered torques, predictions and weights.
        """
        check_is_fitted(self)
        X = self._validate_query(X)
        y = check_array(y, dtype=np.float64, ensure_2d=False).reshape(X.shape[0], -1)
        if y.shape[1] != self._nv:
            raise ValueError(
                f"y must have {self._nv} column(s) of torques; got {y.shape[1]}."
            )
        parts = contiguous_groups(groups, X.shape[0])
        weight = JointTorqueRegressor._check_weight(sample_weight, y.shape)
        lowpass = _lowpass.design(self.dt or 1.0, self.cutoff_)
        self._check_length(parts, lowpass)
        return self._residuals_of(
            self._filtered(self._states(X, groups), y, weight, parts, lowpass)
        )

    def _residuals_of(self, pieces):
        found = [(i, tau, Phi @ self.theta_, w) for i, Phi, tau, w, *_ in pieces]
        index, torque, predicted, weight = (np.concatenate(x) for x in zip(*found))
        return TorqueResiduals(
            index=index, torque=torque, predicted=predicted, weight=weight
        )

    def to_urdf(self, path):
        """Write the robot description with the identified inertias and friction.

        Parameters
        ----------
        path : str or os.PathLike
            File to write.

        Raises
        ------
        ValueError
            If the identifier was given a `pinocchio.Model`, which keeps no URDF, or
            the parameters are not physically consistent.
        """
        check_is_fitted(self)
        if not isinstance(self.model, (str, os.PathLike)):
            raise ValueError(
                "to_urdf needs the URDF that the robot came from: give its path as "
                "`model` (a pinocchio.Model does not keep the links' shapes)."
            )
        if (self.min_eigenvalues_ <= 0).any():
            bad = [
                name
                for name, low in zip(self.joint_names_, self.min_eigenvalues_)
                if low <= 0
            ]
            raise ValueError(
                f"The bodies of {', '.join(bad)} are not physically consistent, and a "
                'URDF must be: identify with projector="default".'
            )
        write_urdf(
            self.model,
            path,
            self.features_._model,
            self.theta_.reshape(self._nv, -1),
            _friction.check_names(self.friction),
        )


def _is_unset(value, unset):
    return value is None if unset is None else isinstance(value, str) and value == unset


def _identifiable(metric):
    """Parameters whose unit vector lies in the span that the data determine."""
    scale = np.sqrt(np.diagonal(metric))
    moved = scale > 0
    result = np.zeros(scale.size, dtype=bool)
    if not moved.any():
        return result
    unit = scale[moved]
    values, vectors = linalg.eigh(metric[np.ix_(moved, moved)] / np.outer(unit, unit))
    null = vectors[:, values < _IDENTIFIABLE * values[-1]]
    result[moved] = (null**2).sum(axis=1) < 1e-6
    return result


def _min_eigenvalues(theta, per_joint):
    """Smallest pseudo-inertia eigenvalue of each body, in the bodies' own scales."""
    bodies = theta.reshape(-1, per_joint)[:, :10]
    mass, length = body_scales(bodies)
    return min_eigenvalue(bodies, mass_scale=mass, length_scale=length)
