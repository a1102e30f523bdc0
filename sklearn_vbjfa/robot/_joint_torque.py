"""One parameter vector from the torques of all joints, as a scikit-learn regressor.

Metadata routing from a fit to the regressor of its equations.
"""

from dataclasses import replace

import numpy as np
from sklearn import get_config
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.utils.metadata_routing import (
    MetadataRouter,
    MethodMapping,
    get_routing_for_object,
)
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa._core._lowpass import averaging, decimate
from sklearn_vbjfa.recording._recording import check_cutoff, check_dt, contiguous_groups
from sklearn_vbjfa.regression._joint_factor import BaseJointFactorRegressor
from sklearn_vbjfa.regression._vbjfa import VBJFARegressor
from sklearn_vbjfa.robot import _joint_moments
from sklearn_vbjfa.robot._joint_moments import (
    block_precisions,
    combine,
    combined_noise,
    joint_statistics,
    noise_weights,
)

# What the rows of the equations have, too; their instruments go along without asking.
_FORWARDED = ("groups", "sample_weight")


class ForwardingMixin:
    """Metadata routing of a meta-estimator that makes equations out of samples."""

    def get_metadata_routing(self):
        """Get the metadata routing of this object.

        Returns
        -------
        sklearn.utils.metadata_routing.MetadataRouter
            What the estimator itself requests, and its regressor where that requests
            `groups` or `sample_weight` by name.
        """
        router = MetadataRouter(owner=self).add_self_request(self)
        # A regressor that requests nothing would, as "not set", draw in what this
        # estimator was told to ignore.
        if self.regressor is not None and _requested(self.regressor):
            router.add(regressor=self.regressor, method_mapping=_fit_to_fit())
        return router

    def _forwarded(self, values):
        """Return what the regressor's `fit` requests, as keyword arguments.

        Parameters
        ----------
        values : dict of str to ndarray of shape (n_equations,)
            Groups and weights of the equations, as far as there are any.
        """
        if not get_config()["enable_metadata_routing"]:
            return {}
        requested = _requested(self.regressor_) & set(values)
        if not requested:
            return {}
        router = MetadataRouter(owner=self)
        router.add(regressor=self.regressor_, method_mapping=_fit_to_fit())
        params = {name: values[name] for name in requested}
        return dict(router.route_params(caller="fit", params=params)["regressor"].fit)


def labels_of_equations(labels, counted):
    """Repeat each piece's label for its equations.

    Parameters
    ----------
    labels : list
        One label a piece of the recording.
    counted : list of ndarray of shape (n_rows, nv), bool
        Which equations of each piece count.

    Returns
    -------
    ndarray of shape (n_equations,)
        Labels.
    """
    return np.repeat(np.asarray(labels), [int(keep.sum()) for keep in counted])


def _fit_to_fit():
    return MethodMapping().add(caller="fit", callee="fit")


def _requested(regressor):
    routing = get_routing_for_object(regressor)
    return set(routing.consumes("fit", _FORWARDED))


# Rows of a block of constant noise: 2.5 periods of the cut-off.
_BLOCK_ROWS = 10
# Student's t has a deviation from three degrees of freedom on.
_LEAST_FREEDOM = 3.0
# A filtered row counts when at least this share of the filter's neighbourhood counts.
_MASK_SHARE = 0.5


class JointTorqueRegressor(ForwardingMixin, RegressorMixin, BaseEstimator):
    """Estimate one parameter vector from the torques of all joints.

    The last step of a pipeline that begins with `RigidBodyFeatures`: takes the wide
    rows apart into one equation per joint and sample, weights the joints by their
    noise, fits any linear scikit-learn regressor to all equations together, and
    projects the parameters on physically consistent ones.

    Parameters
    ----------
    regressor : estimator, default=None
        Linear regressor, such as `VBJFARegressor`, `sklearn.linear_model.LassoCV` or
        `sklearn.cross_decomposition.PLSRegression`; a pipeline of scaler and
        regressor will do. It is fitted without intercept (an offset is a column of
        its own), to columns and torques of unit mean square. None is
        ``VBJFARegressor(latent="correlated", query="noiseless")``: Bayesian regression
        with automatic relevance determination.
    projector : PhysicalProjector, default=None
        Transformer of parameter vectors; None does not project. Where its `metric` is
        None the weighted Gram matrix of the fit is used (eq. 35 of [1]_).
    joint_weights : "auto", None or array-like of shape (nv,), default="auto"
        Weights of the joints' equations [1 / torque squared]. ``"auto"``: the inverse
        of each joint's residual variance, by iterated weighted least squares; None:
        one for all.
    dt : float, default=None
        Sample period [s]; needed with `cutoff`.
    cutoff : float, default=None
        Cut-off [Hz] of a zero-phase low-pass that features and torques both pass
        (parallel filtering: filtering the torque alone leaves a residual at every
        reversal that looks like friction). None filters nothing. The filter's length
        is lost at both ends of each recording.
    decimation : int, default=None
        Keep every so-manieth filtered sample; None keeps four per period of the
        cut-off.
    block_noise : bool, default=False
        Whether the noise of each joint may differ between blocks of time (ten
        filtered rows, 2.5 periods of the cut-off): a Student t with four degrees of
        freedom, so that stretches in which the model fails count less.

    Attributes
    ----------
    theta_ : ndarray of shape (p,)
        Parameters.
    theta_unconstrained_ : ndarray of shape (p,)
        Parameters before the projection.
    theta_std_ : ndarray of shape (p,)
        Standard deviations of `theta_unconstrained_` for independent rows; within
        `RobotIdentifier`, which knows their order, for residuals that are correlated
        in time. nan where the regressor does not tell.
    joint_weights_ : ndarray of shape (nv,)
        Weights of the joints.
    n_rows_ : ndarray of shape (nv,)
        Number of equations of each joint.
    block_factors_ : list of ndarray of shape (n_rows, nv) or None
        Relative precision of each row's noise, piece by piece of the recording.
    regressor_, projector_ : estimator
        The fitted regressor and projector (None without).
    metric_ : ndarray of shape (p, p)
        Weighted Gram matrix of the equations, without the input noise's share where
        that was measured.
    input_noise_ : ndarray of shape (p, p) or None
        Covariance of the input noise in a weighted equation, where it was measured.
    lowpass_ : Lowpass
        The filter.
    n_features_in_ : int
        nv * p.

    See Also
    --------
    RobotIdentifier : The whole chain in one estimator.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Notes
    -----
    `sample_weight` multiplies the equations, whether the regressor takes weights or
    not. With metadata routing enabled (`sklearn.set_config`) a regressor that requests
    `sample_weight` gets the weights of the equations instead, and one that requests
    `groups`, such as ``LassoCV(cv=GroupKFold())``, the label of each equation's
    recording.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import LinearRegression
    >>> from sklearn_vbjfa import JointTorqueRegressor
    >>> rng = np.random.default_rng(0)
    >>> Phi = rng.normal(size=(50, 2, 3))  # two joints, three parameters
    >>> tau = Phi @ [1.0, 2.0, 3.0]
    >>> model = JointTorqueRegressor(LinearRegression())
    >>> model.fit(Phi.reshape(50, 6), tau).theta_.round(6)
    array([1., 2., 3.])
    """

    def __init__(
        self,
        regressor=None,
        projector=None,
        joint_weights="auto",
        *,
        dt=None,
        cutoff=None,
        decimation=None,
        block_noise=False,
    ):
        self.regressor = regressor
        self.projector = projector
        self.joint_weights = joint_weights
        self.dt = dt
        self.cutoff = cutoff
        self.decimation = decimation
        self.block_noise = block_noise

    def __sklearn_tags__(self):
        """Tags of a regressor with one or several outputs."""
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        tags.target_tags.single_output = True
        return tags

    def fit(self, X, y, groups=None, sample_weight=None, instruments=None):
        """Fit the parameters.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv * p)
            Regressor matrices, joints outermost, rows in the order of time.
        y : array-like of shape (n_samples, nv) or (n_samples,)
            Joint torques.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings; nothing is filtered across their borders.
        sample_weight : array-like of shape (n_samples,) or (n_samples, nv), \
                default=None
            Weights of samples, or of each joint's equations; zero leaves one out.
            With a low-pass, a filtered row gets the weights' average over the
            filter's length, or zero where less than half of that counts.
        instruments : array-like of shape (n_samples, nv * p), default=None
            Second, independent measurement of X for a regressor that takes
            `instruments`.

        Returns
        -------
        self : object
            Fitted estimator.
        """
        X, y = validate_data(
            self, X, y, dtype=np.float64, multi_output=True, y_numeric=True
        )
        self._one_output = y.ndim == 1
        tau = y.reshape(X.shape[0], -1).astype(float)
        nv = tau.shape[1]
        if X.shape[1] % nv:
            raise ValueError(
                f"y has {nv} joints, so that the number of columns of X must be a "
                f"multiple of {nv}; got {X.shape[1]}."
            )
        weight = self._check_weight(sample_weight, tau.shape)
        if instruments is not None:
            instruments = np.asarray(instruments, dtype=float)
            if instruments.shape != X.shape:
                raise ValueError(
                    f"instruments must have the shape of X, {X.shape}; got "
                    f"{instruments.shape}."
                )
        lowpass = self._begin()
        labels = None if groups is None else np.asarray(groups)
        for part in contiguous_groups(groups, X.shape[0]):
            Phi = X[part].reshape(-1, nv, X.shape[1] // nv)
            Z = None if instruments is None else instruments[part].reshape(Phi.shape)
            self._accumulate(
                decimate(lowpass, Phi),
                decimate(lowpass, tau[part]),
                filter_weight(lowpass, weight[part]),
                None if Z is None else decimate(lowpass, Z),
            )
            if labels is not None:
                # one for each piece that was kept, which a short one is not
                new = len(self._rows) - len(self._labels)
                self._labels += [labels[part.start]] * new
        return self._finish()

    @staticmethod
    def _check_weight(sample_weight, shape):
        if sample_weight is None:
            return np.ones(shape)
        weight = np.asarray(sample_weight, dtype=float)
        if weight.shape not in {shape, shape[:1]}:
            raise ValueError(
                f"sample_weight must have the shape {shape[:1]} or {shape}; got "
                f"{weight.shape}."
            )
        if not np.isfinite(weight).all() or weight.min() < 0:
            raise ValueError("sample_weight must be finite and not negative.")
        if not weight.any():
            raise ValueError(
                "Sample weights must contain at least one non-zero number."
            )
        return weight if weight.ndim == 2 else np.repeat(weight[:, None], shape[1], 1)

    # The three stages are apart so that a recording can come in pieces.

    def _begin(self):
        """Design the filter and forget what was accumulated."""
        self._stats = None
        self._rows = []
        self._labels = []
        regressor = self.regressor
        if regressor is None:
            regressor = VBJFARegressor(latent="correlated", query="noiseless")
        self.regressor_ = clone(regressor)
        self._from_statistics = isinstance(self.regressor_, BaseJointFactorRegressor)
        if self.cutoff is None:
            self.lowpass_ = _lowpass.design(1.0, np.inf, self.decimation)
        else:
            dt = check_dt(self.dt)
            cutoff = check_cutoff(self.cutoff, dt, "cutoff")
            self.lowpass_ = _lowpass.design(dt, cutoff, self.decimation)
        return self.lowpass_

    def _accumulate(
        self, Phi, tau, weight, instruments=None, difference=None, *, parts=None
    ):
        """Take in filtered rows (n, nv, p), (n, nv), (n, nv), and keys of blocks."""
        if Phi.shape[0] == 0:
            return
        stats = joint_statistics(Phi, tau, weight, difference, parts)
        self._stats = stats if self._stats is None else self._stats + stats
        if self.block_noise or not self._from_statistics:
            self._rows.append((Phi, tau, weight, instruments, difference, parts))

    def _forget(self, entries):
        """Set entries (nv, p) of all regressor matrices to zero."""
        for rows in self._rows:
            rows[0][:, entries] = 0.0
        keep = ~entries
        both = keep[:, :, None] * keep[:, None, :]
        noise = self._stats.noise
        self._stats = replace(
            self._stats,
            G=self._stats.G * both,
            g=self._stats.g * keep,
            noise=None if noise is None else noise * both,
        )

    def _finish(self):
        """Weight the joints, fit, project."""
        stats = self._stats
        if stats is None or not stats.n.any():
            raise ValueError(
                "No equation is left to fit: every sample was masked, or the "
                "recordings are shorter than the low-pass filter "
                f"({2 * self.lowpass_.half + 1} samples). Raise the cut-off or give "
                "longer recordings."
            )
        self.block_factors_ = None
        if self.block_noise:
            stats = self._weight_blocks()
        self.joint_weights_ = self._resolve_weights(stats)
        self.n_rows_ = stats.n_rows
        total = combine(stats, self.joint_weights_)
        self.input_noise_ = combined_noise(stats, self.joint_weights_)
        self.metric_ = total.S_xx.copy()
        if self.input_noise_ is not None:
            self.metric_ = _denoised(total, self.input_noise_)
        if self._from_statistics:
            theta, std = self._fit_from_statistics(total)
        else:
            theta, std = self._fit_rows(total)
        self.theta_unconstrained_ = theta
        self.theta_std_ = std * self._correlation(stats, theta)
        self.statistics_ = replace(stats, blocks=None)
        self.theta_ = self._project(theta)
        del self._stats, self._rows, self._labels
        return self

    def _correlation(self, stats, theta):
        """Return what residuals correlated in time do to the deviations, factors (p,).

        Of the distribution of the estimate, Student's t with the freedom that the
        blocks leave: its deviation is a little larger than that of a normal one.
        """
        if stats.blocks is None or not np.isfinite(theta).all():
            return np.ones(theta.size)
        found = _joint_moments.variance(stats, self.joint_weights_, theta)
        freedom = np.maximum(found.freedom, _LEAST_FREEDOM)
        factor = np.sqrt(found.factor * freedom / (freedom - 2.0))
        # What no equation determines stays as it is.
        return np.where(np.isfinite(factor), factor, 1.0)

    def _weight_blocks(self):
        """Weight the rows by the precision of their blocks; return statistics."""
        blocks, first = [], 0
        for Phi, *_ in self._rows:
            block = first + np.arange(Phi.shape[0]) // _BLOCK_ROWS
            first = int(block[-1]) + 1
            blocks.append(block)
        pieces = [row[:3] for row in self._rows]
        self.block_factors_ = block_precisions(pieces, blocks)
        self._rows = [
            (Phi, tau, w * factor, *others)
            for (Phi, tau, w, *others), factor in zip(self._rows, self.block_factors_)
        ]
        total = None
        for (Phi, tau, weight, _, *others), (_, _, plain) in zip(self._rows, pieces):
            stats = joint_statistics(Phi, tau, weight, *others)
            # The factors re-weight the samples; their number stays what it is.
            stats = replace(stats, n=plain.sum(axis=0))
            total = stats if total is None else total + stats
        return total

    def _resolve_weights(self, stats):
        nv = stats.n.size
        if self.joint_weights is None:
            return np.where(stats.n > 0, 1.0, 0.0)
        if isinstance(self.joint_weights, str):
            if self.joint_weights != "auto":
                raise ValueError(
                    "joint_weights must be 'auto', None or an array of shape "
                    f"({nv},); got {self.joint_weights!r}."
                )
            return noise_weights(stats)
        weight = np.asarray(self.joint_weights, dtype=float)
        if weight.shape != (nv,) or not np.isfinite(weight).all() or weight.min() < 0:
            raise ValueError(
                f"joint_weights must hold {nv} finite, non-negative numbers; got "
                f"{self.joint_weights!r}."
            )
        return np.where(stats.n > 0, weight, 0.0)

    def _fit_from_statistics(self, total):
        self.regressor_.set_params(fit_intercept=False)
        measured = self.input_noise_
        takes_covariance = getattr(self.regressor_, "latent", None) == "correlated"
        if takes_covariance and self.regressor_.input_noise is None:
            # What was measured, or else nothing: rigid-body regressors are far too
            # correlated for an assumed noise.
            noise = 0.0 if measured is None else measured
            # The parameters are those of the motion without its noise.
            self.regressor_.set_params(input_noise=noise, query="noiseless")
        self.regressor_._validate_params()
        self.regressor_._fit_statistics(total)
        return self.regressor_.coef_.copy(), self.regressor_.coef_std_.copy()

    def _stacked(self, which, scale):
        """All joints' equations as one matrix (which=0) or vector (which=1)."""
        out = []
        root = np.sqrt(self.joint_weights_)
        for rows in self._rows:
            values, keep = rows[which], rows[2] > 0
            if which == 1:
                out.append((values * root)[keep])
            else:
                out.append((values * root[:, None])[keep] / scale)
        return np.concatenate(out)

    def _fit_rows(self, total):
        """Fit any scikit-learn regressor to the stacked, scaled equations."""
        n = total.n_samples
        scale = np.sqrt(np.diagonal(total.S_xx) / n)
        scale = np.where(scale > 0, scale, 1.0)
        y_scale = np.sqrt(total.S_yy / n) or 1.0
        A = self._stacked(0, scale)
        b = self._stacked(1, None) / y_scale
        weight = np.concatenate([rows[2][rows[2] > 0] for rows in self._rows])
        fit_params = {}
        forwarded = {"sample_weight": weight / weight.mean()}
        if self._labels:
            counted = [rows[2] > 0 for rows in self._rows]
            forwarded["groups"] = labels_of_equations(self._labels, counted)
        forwarded = self._forwarded(forwarded)
        if "sample_weight" not in forwarded and not np.all(weight == weight[0]):
            # Weights go into the rows: not every regressor takes sample_weight.
            root = np.sqrt(weight / weight.mean())
            A, b = A * root[:, None], b * root
        if self._rows[0][3] is not None:
            Z = self._stacked(3, scale)
            fit_params["instruments"] = Z
        parameters = self.regressor_.get_params(deep=True)
        names = {name.split("__")[-1] for name in parameters}
        intercepts = [n for n in parameters if n.split("__")[-1] == "fit_intercept"]
        self.regressor_.set_params(**dict.fromkeys(intercepts, False))
        if not intercepts or "steps" in names:
            # What always centres (PLS, a scaler in a pipeline) sees each equation
            # with its mirror image: the means are zero and nothing is lost.
            A, b = _mirror(A), _mirror(b)
            fit_params = {k: _mirror(v) for k, v in fit_params.items()}
            forwarded = {k: np.repeat(v, 2) for k, v in forwarded.items()}
        self.regressor_.fit(A, b, **fit_params, **forwarded)
        theta = self._read_coefficients(A[:50])
        std = getattr(self.regressor_, "coef_std_", None)
        unit = y_scale / scale
        std = np.full(theta.shape, np.nan) if std is None else np.ravel(std) * unit
        return theta * unit, std

    def _read_coefficients(self, sample):
        """Coefficients by asking for predictions: right for pipelines as well."""
        p = sample.shape[1]
        probe = np.vstack([np.zeros((1, p)), np.eye(p)])
        answer = np.ravel(self.regressor_.predict(probe))
        coef = answer[1:] - answer[0]
        direct = np.ravel(self.regressor_.predict(sample)) - answer[0]
        size = np.abs(sample) @ np.abs(coef) + np.abs(answer[0])
        if np.any(np.abs(direct - sample @ coef) > 1e-6 * size + 1e-300):
            raise ValueError(
                "regressor must be linear in its inputs, since its coefficients are "
                f"the parameters; got {type(self.regressor_).__name__}."
            )
        return coef

    def _project(self, theta):
        self.projector_ = None
        if self.projector is None:
            return theta.copy()
        self.projector_ = clone(self.projector)
        if getattr(self.projector_, "metric", False) is None:
            self.projector_.set_params(metric=self.metric_)
        return self.projector_.fit(theta[None]).transform(theta[None])[0]

    def predict(self, X):
        """Predict the joint torques.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv * p)
            Regressor matrices.

        Returns
        -------
        ndarray of shape (n_samples, nv), or (n_samples,) if y had one dimension
            Torques.
        """
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        tau = X.reshape(X.shape[0], -1, self.theta_.size) @ self.theta_
        return tau[:, 0] if self._one_output else tau


def _denoised(total, noise):
    """Gram matrix without the input noise's share (X_t' X_t of eq. 35), projected.

    Directions in which the noise exceeds the signal keep nothing.
    """
    scale = np.sqrt(np.diagonal(total.S_xx))
    unit = np.where(scale > 0, scale, 1.0)
    signal = (total.S_xx - total.n_samples * noise) / np.outer(unit, unit)
    values, vectors = np.linalg.eigh(0.5 * (signal + signal.T))
    clean = (vectors * np.maximum(values, 0.0)) @ vectors.T
    # by the scale and not the unit: a column of zeros stays one to the last bit
    return clean * np.outer(scale, scale)


def _mirror(rows):
    """Each row followed by its negative: pairs stay together in any block split."""
    return np.stack([rows, -rows], axis=1).reshape(-1, *rows.shape[1:])


def filter_weight(lowpass, weight):
    """Count filtered rows as independent samples; zero where too little counts."""
    smoother = averaging(lowpass)
    average = decimate(smoother, weight)
    full = decimate(smoother, (weight > 0).astype(float))
    # A tie must not depend on the order in which the taps were summed.
    counts = full > _MASK_SHARE - 1e-9
    return np.where(counts, lowpass.efficiency * average, 0.0)
