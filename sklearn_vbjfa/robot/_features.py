"""Regressor matrices of rigid-body dynamics, as a scikit-learn transformer."""

import copy

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa.effects import check_declared, declared_columns, declared_unit
from sklearn_vbjfa.model._corrected import CorrectedModel
from sklearn_vbjfa.model._derivatives import TorqueDerivatives
from sklearn_vbjfa.model._loading import is_prismatic, joint_names, load_folded
from sklearn_vbjfa.model._regressor import TreeRegressor
from sklearn_vbjfa.physical._pseudo_inertia import INERTIAL_NAMES


class RigidBodyFeatures(TransformerMixin, BaseEstimator):
    """Joint-torque regressor matrix of a robot, one row per sample.

    The equations of motion are linear in the inertial and friction parameters,
    tau = Phi(q, v, a) theta (eq. 1 of [1]_). This transformer turns states into Phi.
    Each joint's torque is a block of columns, so that there is one row per sample.

    Parameters
    ----------
    model : str, os.PathLike or pinocchio.Model
        Path of a URDF or MJCF file, or a model; a tree of one-degree-of-freedom
        joints.
    friction : tuple of {"viscous", "coulomb", "offset", "rotor_inertia"}, \
            default=("viscous",)
        Additional columns for each joint: v, sign(v), 1, a. The default gives the
        paper's 11 parameters per degree of freedom.

    Attributes
    ----------
    n_joints_ : int
        Number of joints, nv.
    n_parameters_ : int
        Length p of theta, nv * (10 + number of friction columns).
    parameter_names_ : tuple of str
        Names of the entries of theta, such as "joint_1:m" or "joint_2:viscous".
    parameter_units_ : tuple of str
        Their units.
    model_ : pinocchio.Model
        The loaded model; within `RobotIdentifier`, as its effects correct it.
    nominal_ : pinocchio.Model
        The loaded model, not corrected.
    followers_ : tuple
        Bodies of the joints that follow others, which are not among the joints.
    gains_ : ndarray of shape (nv,)
        What each torque channel reads over the torque: 1 unless an effect says so.
    friction_ : tuple of str
        Names of the friction columns.
    support_ : ndarray of shape (nv, p), bool
        Entries of a regressor matrix that are nonzero in some motion.
    n_features_in_ : int
        3 nv.

    See Also
    --------
    StateEstimator : Estimates states from joint positions.
    JointTorqueRegressor : Estimates theta from these features.

    Notes
    -----
    For each joint, in Pinocchio's order, theta holds the ten inertial parameters of
    the body it moves (m, m c_x, m c_y, m c_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the
    joint frame) [kg, kg m, kg m^2], then the joint's friction coefficients. Entry
    ``j * p + k`` of a row is the derivative of joint torque j with respect to
    parameter k.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> import numpy as np
    >>> import pinocchio
    >>> from sklearn_vbjfa import RigidBodyFeatures
    >>> model = pinocchio.buildSampleModelManipulator()
    >>> features = RigidBodyFeatures(model)
    >>> states = np.zeros((4, 3 * model.nv))
    >>> features.fit_transform(states).shape == (4, model.nv * 11 * model.nv)
    True
    """

    def __init__(self, model, friction=("viscous",)):
        self.model = model
        self.friction = friction

    def fit(self, X, y=None):
        """Load the model and check the states.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 * nv)
            States [q | v | a] [rad or m, and time derivatives].
        y : None
            Ignored.

        Returns
        -------
        self : object
            Fitted transformer.
        """
        self.load()
        X = validate_data(self, X, dtype=np.float64)
        self._check_width(X)
        return self

    def load(self):
        """Load the model alone, without checking states.

        Returns
        -------
        self : object
            Fitted transformer.
        """
        folded = load_folded(self.model)
        self.model_ = self.nominal_ = folded.model
        self.followers_ = folded.followers
        self.gains_ = np.ones(self.model_.nv)
        self.friction_ = check_declared(self.friction)
        self.n_joints_ = self.model_.nv
        per_joint = len(INERTIAL_NAMES) + len(self.friction_)
        self.n_parameters_ = self.n_joints_ * per_joint
        names, units = [], []
        kinds = is_prismatic(self.model_)
        for name, prismatic in zip(joint_names(self.model_), kinds):
            columns = INERTIAL_NAMES + self.friction_
            names += [f"{name}:{column}" for column in columns]
            units += ["kg"] + 3 * ["kg m"] + 6 * ["kg m^2"]
            units += [declared_unit(column, prismatic) for column in self.friction_]
        self.parameter_names_ = tuple(names)
        self.parameter_units_ = tuple(units)
        self._set_regressor()
        return self

    def corrected(self, effects):
        """Return features of the robot as some effects correct it.

        Parameters
        ----------
        effects : iterable of Effect
            Those that are no `ModelEffect` correct nothing.

        Returns
        -------
        RigidBodyFeatures
            Features of the corrected model; what channels read is in `gains_`, and
            not yet in their matrices.
        """
        corrections = [effect for effect in effects if effect.in_model]
        if not corrections and self.model_ is self.nominal_:
            return self
        robot = CorrectedModel(self.nominal_)
        for effect in corrections:
            effect.correct(robot)
        found = copy.copy(self)
        found.model_, found.gains_ = robot.model, robot.gains
        found._set_regressor()
        return found

    def derivatives(self, q, v, a, inertial):
        """Differentiate the torques of bodies (nv, 10) by the robot's geometry."""
        return TorqueDerivatives(self.model_, q, v, a, inertial, self.nominal_)

    def _set_regressor(self):
        """Make the regressor of the model, and number its entries."""
        self._regressor = TreeRegressor(self.model_)
        # Which of the entries is which.
        support = self.support_
        self._n_entries = np.count_nonzero(support)
        places = np.where(support, np.cumsum(support).reshape(support.shape) - 1, -1)
        self._places = places.reshape(self.n_joints_, self.n_joints_, -1)

    def _check_width(self, X):
        nv = self.n_joints_
        if X.shape[1] != 3 * nv:
            raise ValueError(
                f"The robot has {nv} joints, so that states [q | v | a] have "
                f"{3 * nv} columns; got {X.shape[1]}. "
                + (
                    "These look like positions alone: use StateEstimator first."
                    if X.shape[1] == nv
                    else f"Joints in order: {', '.join(joint_names(self.model_))}."
                )
            )

    def transform(self, X):
        """Compute the regressor matrices.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 * nv)
            States [q | v | a].

        Returns
        -------
        ndarray of shape (n_samples, nv * p)
            Regressor matrices, joints outermost.
        """
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        return self.matrices(X).reshape(X.shape[0], -1)

    def matrices(self, X, rest=None):
        """Regressor matrices (n, nv, p) of validated states (n, 3 nv).

        With `rest`, a `Rest`, velocity signs are replaced by their means.
        """
        nv, n = self.n_joints_, X.shape[0]
        q, v, a = X[:, :nv], X[:, nv : 2 * nv], X[:, 2 * nv :]
        Phi = np.empty((n, nv, nv, 10 + len(self.friction_)))
        self._regressor(q, v, a, out=Phi)
        diagonal = np.arange(nv)
        Phi[:, diagonal, diagonal, 10:] = declared_columns(self.friction_, v, a, rest)
        return Phi.reshape(n, nv, self.n_parameters_)

    def entries(self, X, rest=None):
        """Compute the entries of `support_` alone, samples last.

        Parameters
        ----------
        X : ndarray of shape (n_samples, 3 * nv)
            States [q | v | a].
        rest : Rest or None, default=None
            Signs of velocities are their means with it.

        Returns
        -------
        ndarray of shape (n_entries, n_samples)
            Entries in the order of ``np.nonzero(support_)``.
        """
        nv = self.n_joints_
        q, v, a = X[:, :nv], X[:, nv : 2 * nv], X[:, 2 * nv :]
        out = np.empty((self._n_entries, X.shape[0]))
        self._regressor.entries(q, v, a, self._places[:, :, :10], out)
        diagonal = np.arange(nv)
        columns = declared_columns(self.friction_, v, a, rest)
        out[self._places[diagonal, diagonal, 10:]] = columns.transpose(1, 2, 0)
        return out

    def one_by_one(self):
        """Return a function of one state (q, v, a), for control loops.

        It computes the bodies' regressor matrix (nv, nv, 10); see `TreeRegressor`.
        """
        return self._regressor.one_by_one()

    def torques(self, q, v, a, inertial):
        """Rigid-body torques (n, nv) of bodies (nv, 10), without friction."""
        return self._regressor.torques(q, v, a, inertial)

    @property
    def support_(self):
        """Entries of a regressor matrix nonzero in some motion, (nv, p), bool."""
        nv = self.n_joints_
        entries = np.zeros((nv, nv, self.n_parameters_ // nv), dtype=bool)
        entries[:, :, :10] = self._regressor.support
        entries[np.arange(nv), np.arange(nv), 10:] = True
        return entries.reshape(nv, -1)

    def get_feature_names_out(self, input_features=None):
        """Names of the columns, such as "tau_joint_1/joint_2:m".

        Parameters
        ----------
        input_features : None
            Ignored.

        Returns
        -------
        ndarray of shape (nv * p,) of object
            Names.
        """
        check_is_fitted(self)
        return np.array(
            [
                f"tau_{joint}/{parameter}"
                for joint in joint_names(self.model_)
                for parameter in self.parameter_names_
            ],
            dtype=object,
        )
