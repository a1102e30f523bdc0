"""Regressor matrices of rigid-body dynamics, and the bodies of joints that follow."""

import copy
import re

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_vbjfa.effects import (
    InFiles,
    InModel,
    Motion,
    OnAllJoints,
    check_declared,
    declared,
    declared_columns,
)
from sklearn_vbjfa.model import (
    CorrectedModel,
    TreeRegressor,
    describe,
    description_text,
    is_prismatic,
    joint_names,
    load_folded,
)
from sklearn_vbjfa.model._dynamics import body_columns
from sklearn_vbjfa.model._mjcf import FollowingJoint
from sklearn_vbjfa.model._trees import ChainJoint, Tree
from sklearn_vbjfa.physical import INERTIAL_NAMES

_MASS, _MOMENT = ("kg", "kg"), ("kg m", "kg m")
_INERTIA = ("kg m^2", "kg m^2")


class Follower(OnAllJoints):
    """Body of a joint that follows another joint (mimic), declared automatically."""

    # joint: leading joint; the body loads all joints that carry it. of: name of the
    # following joint. chain: joints from the base to the body, as a `ChainJoint` each,
    # from the description, uncorrected by effects. gravity: in the axes of the base.

    name = "follower"
    label = "body of a joint that follows another joint"
    formula = r"A^{\mathsf T}\Phi_f(Aq + b, A\dot q, A\ddot q)\,\pi_f"
    coefficients = INERTIAL_NAMES
    units = (_MASS,) + (_MOMENT,) * 3 + (_INERTIA,) * 6
    loads = True
    files = InFiles(urdf="", mjcf="")

    def __init__(self, joint=0, of="", chain=(), gravity=(0.0, 0.0, -9.81)):
        super().__init__(joint)
        self.of = of
        self.chain = chain
        self.gravity = gravity

    def prefix(self, joint_name):
        return self.of

    def tree(self):
        """Return the joints from the base to the body as a `Tree`."""
        links = [ChainJoint(*row) for row in self.chain]
        count = len(links)
        slides = np.array([link.slides for link in links], dtype=float)
        offsets = np.array([link.place for link in links])
        offsets[0] = 0.0
        base = np.zeros((count, 3))
        base[0] = -np.asarray(self.gravity)
        return Tree(
            parents=np.arange(count) - 1,
            offsets=offsets,
            frames=np.array([np.reshape(link.frame, (3, 3)).T for link in links]),
            axes=np.array([link.axis for link in links]),
            turns=1.0 - slides,
            slides=slides,
            base=base,
            base_angular=np.zeros(3),
            leads=np.array([link[:3] for link in links], dtype=float),
        )

    def columns(self, motion):
        tree = self.tree()
        joints, (rate, offset) = tree.leads[:, 0].astype(int), tree.leads.T[1:]
        states = [rate * x[:, joints] for x in (motion.q, motion.v, motion.a)]
        states[0] += offset
        out = np.zeros((motion.q.shape[0], motion.n_joints, len(INERTIAL_NAMES)))
        for joint, factor, body in zip(joints, rate, body_columns(tree, *states)):
            out[:, joint] += factor * body
        return out

    def bodies(self, coef):
        """Bodies (n, 10) of its tree; only the last one has mass."""
        return np.vstack([np.zeros((len(self.chain) - 1, len(coef))), coef])

    def simulated(self, table, *coef):
        return True


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
        The loaded model; within `RobotIdentifier`, corrected by its effects.
    nominal_ : pinocchio.Model
        The loaded model without corrections.
    followers_ : tuple
        Bodies of the joints that follow others, which are not among the joints.
    gains_ : ndarray of shape (nv,)
        Ratio of channel reading to torque of the joint: 1 unless an effect corrects it.
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
        """Load the model alone, without checking states."""
        folded = load_folded(self.model)
        self.model_ = self.nominal_ = folded.model
        self.followers_, self._folded = folded.followers, folded
        self.gains_ = np.ones(self.model_.nv)
        self.friction_ = check_declared(self.friction)
        self.n_joints_ = self.model_.nv
        per_joint = len(INERTIAL_NAMES) + len(self.friction_)
        self.n_parameters_ = self.n_joints_ * per_joint
        names, units = [], []
        for name, prismatic in zip(joint_names(self.model_), is_prismatic(self.model_)):
            columns = INERTIAL_NAMES + self.friction_
            names += [f"{name}:{column}" for column in columns]
            units += ["kg"] + 3 * ["kg m"] + 6 * ["kg m^2"]
            pairs = [declared(column).units[0] for column in self.friction_]
            units += [pair[int(prismatic)] for pair in pairs]
        self.parameter_names_ = tuple(names)
        self.parameter_units_ = tuple(units)
        self._set_regressor()
        return self

    def corrected(self, effects):
        """Return the features of the robot corrected by effects."""
        # The gains of channels are in `gains_`, not in the matrices.
        corrections = [effect for effect in effects if isinstance(effect, InModel)]
        if not corrections and self.model_ is self.nominal_:
            return self
        robot = CorrectedModel(self.nominal_)
        for effect in corrections:
            effect.correct(robot)
        features = copy.copy(self)
        features.model_, features.gains_ = robot.model, robot.gains
        features._set_regressor()
        return features

    @property
    def description(self):
        """URDF of the robot before it was corrected."""
        return description_text(self._folded)

    def _set_regressor(self):
        self._regressor = TreeRegressor(self.model_)
        # Index of each element among the entries of `support_`, -1 for none.
        support = self.support_
        self.n_entries_ = np.count_nonzero(support)
        index = np.where(support, np.cumsum(support).reshape(support.shape) - 1, -1)
        index = index.reshape(self.n_joints_, self.n_joints_, -1)
        joints = np.arange(self.n_joints_)
        self._body_indices = np.ascontiguousarray(index[:, :, :10])
        # Indices of the friction columns, (nv, n_friction).
        self.declared_indices_ = index[joints, joints, 10:]

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

    def matrices(self, X):
        """Regressor matrices (n, nv, p) of validated states (n, 3 nv)."""
        out = np.zeros((X.shape[0], self.n_joints_ * self.n_parameters_))
        out[:, np.flatnonzero(self.support_)] = self.entries(X)
        return out.reshape(X.shape[0], self.n_joints_, -1)

    def declared(self, X, rest=None):
        """Friction columns of all joints, (n, nv, n_friction)."""
        nv = self.n_joints_
        return declared_columns(self.friction_, X[:, nv : 2 * nv], X[:, 2 * nv :], rest)

    def entries(self, X, rest=None, declared=None, out=None):
        """Entries of ``np.nonzero(support_)`` alone, (n, n_entries)."""
        # rest: `Rest`, replaces velocity signs by their means; declared: friction
        # columns, if computed already; out: array to fill, may have more rows.
        if out is None:
            out = np.empty((X.shape[0], self.n_entries_))
        self._regressor.entries(X, self._body_indices, out)
        declared = self.declared(X, rest) if declared is None else declared
        out[:, self.declared_indices_.ravel()] = declared.reshape(len(out), -1)
        return out

    def body(self, X, joint):
        """Columns of the body of a joint, (n, nv, 10), of states (n, 3 nv)."""
        tree, states = describe(self.model_), np.split(X, 3, axis=1)
        columns = np.stack(body_columns(tree, *states, joint), axis=1)
        return columns * self._regressor.support[:, joint]

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


# -- names and checks of the columns ---------------------------------------------------

# Scalers reach their target up to rounding, unscaled columns of different units do not.
_EXACT = 1e-6
# With so few rows any statistic may be exact by chance.
_FEW_VALUES = 3


def parameter_names_of(names, nv):
    """Derive the names of the p parameters from those of the nv * p columns."""
    # Columns are named like "tau_joint_1/joint_2:m", with any prefix, as of
    # `ColumnTransformer`. None if none is of `RigidBodyFeatures`, ValueError if mixed.
    names = [] if names is None else [str(name) for name in names]
    if not any(re.search("(^|__)tau_.+/.+:", name) for name in names):
        return None
    # The first column is the mass of the body of the first joint.
    first = re.fullmatch(r"((?:.*__)?tau_(.+)/)\2:m", names[0])
    if first is not None:
        blocks = np.array(names, dtype=object).reshape(nv, -1)
        parameters = [name[len(first[1]) :] for name in blocks[0]]
        heads = [block[0].removesuffix(parameters[0]) for block in blocks]
        of_joints = all(re.fullmatch("(.*__)?tau_.+/", head) for head in heads)
        if of_joints and names == [x + name for x in heads for name in parameters]:
            return tuple(parameters)
    raise ValueError(
        "Columns of RigidBodyFeatures were removed, renamed or reordered before this "
        f"regressor ({len(names)} for {nv} joints). Select columns inside the "
        "regressor: make_pipeline(SelectFromModel(...), Lasso())."
    )


def check_as_computed(X):
    """Reject columns that a scaler has changed."""
    V = X[:, X.max(axis=0) > X.min(axis=0)]
    if V.shape[0] <= _FEW_VALUES or V.shape[1] < 2:
        return
    extremes = V.min(axis=0), V.max(axis=0)
    standardised = (np.abs(V.std(axis=0) - 1.0) <= _EXACT).all()
    if standardised or max(map(np.ptp, extremes)) <= _EXACT * np.abs(V).max():
        equal = "a standard deviation of 1" if standardised else "one range"
        raise ValueError(
            f"X is not as RigidBodyFeatures computes it: all {V.shape[1]} columns that "
            f"vary have {equal}, as scalers leave them. All joints share one parameter "
            "vector in SI units, so that no scaler or PCA can stand between the "
            "features and JointTorqueRegressor. Leave it out (columns get unit mean "
            "square inside), or put it into the regressor: "
            "JointTorqueRegressor(make_pipeline(StandardScaler(), Lasso()))."
        )


# -- bodies of joints that follow others -----------------------------------------------


def with_followers(effects, features):
    """Return effects for the bodies of followers, and then the declared effects."""
    # The followers of the robot replace those among the declared effects.
    declared = tuple(x for x in effects if not isinstance(x, Follower))
    followers = [
        Follower(joint=x.leader, of=x.name, chain=x.chain, gravity=x.gravity)
        for x in features.followers_
    ]
    return (*followers, *declared)


def body_torques(features, effects, bodies, q, v, a):
    """Torques (n, nv) of bodies (n_bodies, 10) of joints, then of `Follower`s."""
    torques = features.torques(q, v, a, bodies[: features.n_joints_])
    motion, followers = Motion(q=q, v=v, a=a), [x for x in effects if x.loads]
    for effect, body in zip(followers, bodies[features.n_joints_ :]):
        torques += effect.columns(motion) @ body
    return torques


def follower_parameters(effects, coefficients):
    """Return the inertial parameters (10,) of followers, by the joints' names."""
    # effects, coefficients: all effects of a robot with their estimated coefficients.
    pairs = zip(effects, coefficients)
    return {effect.of: np.asarray(values) for effect, values in pairs if effect.loads}


def following_joints(robot):
    """Return the followers of a `TorqueModel` for MJCF, a tuple of `FollowingJoint`."""
    pairs = zip(robot.effects, robot.coefficients)
    followers = [pair for pair in pairs if pair[0].loads]
    # Carriers before the bodies they carry: their chain to the base is shorter.
    followers.sort(key=lambda pair: len(pair[0].chain))
    carriers = {tuple(effect.chain): effect.of for effect, _ in followers}
    joints = []
    for effect, body in followers:
        *above, last = (ChainJoint(*row) for row in effect.chain)
        carrier = carriers.get(tuple(effect.chain[:-1]))
        if carrier is None and above:
            carrier = robot.joint_names[above[-1].joint]
        joints.append(FollowingJoint(effect.of, carrier, last, np.asarray(body)))
    return tuple(joints)


def nominal_followers(features):
    """Inertial parameters of the followers in the description, (n, 10)."""
    return np.reshape([body.parameters for body in features.followers_], (-1, 10))
