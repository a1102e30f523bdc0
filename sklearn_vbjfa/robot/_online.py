"""A robot that is running: second moments that forget, row by row.

A control loop has no time for arrays that are made anew. The moments are kept in place,
one triangle of each matrix, and the weight of the past is a number beside them: a new
row is one symmetric rank-one update a joint, whatever the length of the memory.
"""

import numpy as np
from scipy.linalg import blas

from sklearn_vbjfa.effects import _declared as _friction
from sklearn_vbjfa.model._loading import import_pinocchio
from sklearn_vbjfa.robot._equations import RegressorRows
from sklearn_vbjfa.robot._joint_moments import JointStatistics, joint_statistics
from sklearn_vbjfa.robot._joint_torque import JointTorqueRegressor
from sklearn_vbjfa.robot._plan import check_widths, resolve_standstill

# Up to this many rows are taken in one by one, more of them together.
_FEW = 8
# The weight of the past at which it is multiplied into the sums.
_FADED = 1e-100


class OnlineStatistics:
    """Second moments of a robot's equations, in which a row counts by its age.

    Parameters
    ----------
    features : RigidBodyFeatures
        Loaded features.
    forgetting : float
        Weight that every row keeps with each further one.
    """

    def __init__(self, features, forgetting):
        self._features = features
        self._rows = RegressorRows(features, np.empty((0, 3 * features.n_joints_)))
        nv, p = self._rows.support.shape
        self.forgetting = forgetting
        self._weight = 1.0
        self._n, self._n_rows, self._yy = np.zeros(nv), np.zeros(nv, int), np.zeros(nv)
        self._g, self._G = np.zeros((nv, p)), np.zeros((nv, p, p))
        self._zero = ~self._rows.support
        self._prepare()

    def _prepare(self):
        self._data = self._features._model.createData()
        self._compute = import_pinocchio().computeJointTorqueRegressor
        nv, p = self._g.shape
        # From the first column that a joint's torque depends on to the last.
        used = [np.flatnonzero(~row) for row in self._zero]
        self._used = [slice(int(k[0]), int(k[-1]) + 1) for k in used]
        self._triangles = []
        for G, k in zip(self._G, self._used):
            # BLAS counts columns first; it updates the lower triangle of this.
            self._triangles.append(np.zeros((k.stop - k.start,) * 2, order="F"))
            self._triangles[-1][:] = G[k, k]
        self._Phi = np.zeros((nv, p))
        self._bodies = self._Phi.reshape(nv, nv, -1)[:, :, :10]

    def __getstate__(self):
        """Leave out what Pinocchio keeps for itself."""
        state = {**self.__dict__, "_G": self._full()}
        for name in ("_data", "_compute", "_triangles", "_used", "_Phi", "_bodies"):
            del state[name]
        return state

    def __setstate__(self, state):
        """Make it again."""
        self.__dict__.update(state)
        self._prepare()

    def add(self, X, y, weight):
        """Take in rows.

        Parameters
        ----------
        X : ndarray of shape (n, 3 * nv)
            States, in the order of time.
        y : ndarray of shape (n, nv)
            Torques.
        weight : ndarray of shape (n, nv)
            Weights besides those of age.
        """
        if X.shape[0] > _FEW:
            self._add_many(X, y, weight)
            return
        for x, tau, w in zip(X, y, weight):
            self._add_one(x, tau, w)

    def _add_one(self, x, tau, w):
        self._fade(self.forgetting)
        w = w / self._weight
        Phi = self._regressor(x)
        weighted = w * tau
        self._n += w
        self._n_rows += w > 0
        self._yy += weighted * tau
        self._g += weighted[:, None] * Phi
        for row, k, share, triangle in zip(
            Phi, self._used, w.tolist(), self._triangles
        ):
            blas.dsyr(share, row[k], lower=1, a=triangle, overwrite_a=1)

    def _regressor(self, x):
        """Regressor matrix (nv, p) of one row, in memory that is used again.

        For one row Pinocchio is faster than what spreads its work over many.
        """
        nv = self._n.size
        q, v, a = x[:nv], x[nv : 2 * nv], x[2 * nv :]
        bodies = self._compute(self._features._model, self._data, q, v, a)
        self._bodies[:] = bodies.reshape(nv, nv, 10)
        columns = _friction.columns(self._features._friction, v[None], a[None])
        diagonal = np.arange(nv)
        self._Phi.reshape(nv, nv, -1)[diagonal, diagonal, 10:] = columns[0]
        self._Phi[self._zero] = 0.0
        return self._Phi

    def _add_many(self, X, y, weight):
        n = X.shape[0]
        age = self.forgetting ** np.arange(n - 1.0, -1.0, -1.0)
        self._fade(self.forgetting**n)
        Phi = self._features._compute(X)
        new = joint_statistics(Phi, y, weight * age[:, None])
        self._n += new.n / self._weight
        self._n_rows += (weight > 0).sum(axis=0)
        self._yy += new.yy / self._weight
        self._g += new.g / self._weight
        for G, k, triangle in zip(new.G, self._used, self._triangles):
            triangle += G[k, k] / self._weight

    def _fade(self, factor):
        self._weight *= factor
        if self._weight < _FADED:
            for sums in (self._n, self._yy, self._g, *self._triangles):
                sums *= self._weight
            self._weight = 1.0

    def _full(self):
        """Matrices (nv, p, p) out of their triangles, without the weight."""
        G = np.zeros(self._G.shape)
        for full, k, triangle in zip(G, self._used, self._triangles):
            lower = np.tril(triangle)
            full[k, k] = lower + np.tril(triangle, -1).T
        return G

    def statistics(self):
        """Return the moments of all rows so far."""
        return JointStatistics(
            n=self._weight * self._n,
            n_rows=self._n_rows.copy(),
            G=self._weight * self._full(),
            g=self._weight * self._g,
            yy=self._weight * self._yy,
        )


def begin(identifier):
    """Prepare an identifier for rows of a running robot; return the statistics."""
    known = getattr(identifier, "standstill_", None)
    identifier._load_robot()
    _check(identifier)
    automatic = isinstance(identifier.standstill, str)
    if not automatic or known is None:
        if automatic and identifier.standstill == "auto":
            raise ValueError(
                "standstill='auto' needs the speeds of a whole recording, which "
                "partial_fit does not have: fit a recording first, or give standstill "
                "as speeds [rad/s or m/s], or as None."
            )
        known = resolve_standstill(identifier.standstill, np.zeros(identifier._nv))
    identifier.standstill_ = known
    identifier.cutoff_, identifier.state_estimator_ = np.inf, None
    identifier.torque_noise_ = np.full(identifier._nv, np.nan)
    return OnlineStatistics(identifier.features_, float(identifier.forgetting))


def _check(identifier):
    forgetting = identifier.forgetting
    if not (np.ndim(forgetting) == 0 and 0 < forgetting <= 1):
        raise ValueError(
            "forgetting must be a number in (0, 1], the weight that a row keeps with "
            f"each further one; got {forgetting!r}."
        )
    asked = {
        "effects": len(identifier.effects_) > 0,
        "period": identifier.period is not None,
        "block_noise": bool(identifier.block_noise),
        "regressor": not identifier._takes_statistics(),
    }
    refused = [name for name, is_asked in asked.items() if is_asked]
    if refused:
        raise ValueError(
            f"partial_fit cannot do with {', '.join(refused)}: it keeps second moments "
            "of the rigid bodies and their friction only. Use effects=(), period=None, "
            "block_noise=False and a VBJFARegressor or JFARegressor."
        )


def check_rows(identifier, X, y, sample_weight):
    """Validate rows as fast as a control loop needs it; return X, y, weight."""
    X, y = np.atleast_2d(np.asarray(X, dtype=float), np.asarray(y, dtype=float))
    nv = identifier._nv
    if y.shape[0] != X.shape[0] and y.size == X.shape[0] * nv:
        y = y.reshape(X.shape[0], nv)
    if X.ndim != 2 or X.shape[1] != 3 * nv:
        raise ValueError(
            f"partial_fit needs states [q | v | a], {3 * nv} columns for {nv} "
            f"joint(s), since positions cannot be differentiated row by row; got an "
            f"array of shape {X.shape}."
        )
    if y.shape != (X.shape[0], nv):
        check_widths(identifier.joint_names_, X, y)
        raise ValueError(
            f"y must hold torques of shape {(X.shape[0], nv)}; got {y.shape}."
        )
    if not (np.isfinite(X).all() and np.isfinite(y).all()):
        raise ValueError(
            "X and y must be finite, got NaN or infinity; leave such rows out."
        )
    if sample_weight is None:
        weight = np.ones(y.shape)
    else:
        weight = JointTorqueRegressor._check_weight(sample_weight, y.shape)
    moves = np.abs(X[:, nv : 2 * nv]) > identifier.standstill_
    return X, y, weight * moves
