"""Recursive second moments with forgetting, for a running robot.

A control loop has no time to allocate arrays. The moments are updated in place, one
triangle of each matrix, with the weight of the past as a scalar factor: a new row costs
one symmetric rank-one update per joint, however long the memory.
"""

import numpy as np
from scipy.linalg import blas

from sklearn_vbjfa.effects import declared_columns
from sklearn_vbjfa.robot._equations import RegressorRows
from sklearn_vbjfa.robot._estimate import from_moments
from sklearn_vbjfa.robot._features import refuse_followers
from sklearn_vbjfa.robot._joint_moments import JointMoments, joint_moments
from sklearn_vbjfa.robot._ranges import SignalRanges
from sklearn_vbjfa.robot._recording_checks import check_weight, check_widths

# Up to this many rows are added one by one, more of them as a block.
_FEW = 8
# Weight of the past below which it is multiplied into the sums.
_FADED = 1e-100


class OnlineMoments:
    """Second moments of a robot's equations with exponential forgetting."""

    # forgetting: factor by which each new row scales the weight of earlier ones.

    def __init__(self, features, forgetting):
        self._features = features
        self._rows = RegressorRows(features, np.empty((0, 3 * features.n_joints_)))
        nv, p = self._rows.support.shape
        self.forgetting = forgetting
        self._weight = 1.0
        self._n, self._n_rows, self._yy = np.zeros(nv), np.zeros(nv, int), np.zeros(nv)
        self._g, self._G = np.zeros((nv, p)), np.zeros((nv, p, p))
        self._zero = ~self._rows.support
        self._lowest, self._highest = np.full((2, 3, nv), [[[np.inf]], [[-np.inf]]])
        self._prepare()

    def _prepare(self):
        self._one = self._features.one_by_one()
        nv, p = self._g.shape
        # From the first column that a joint's torque depends on to the last.
        used = [np.flatnonzero(~row) for row in self._zero]
        self._used = [slice(int(k[0]), int(k[-1]) + 1) for k in used]
        self._triangles = []
        for G, k in zip(self._G, self._used):
            # Column-major, as BLAS expects; dsyr updates the lower triangle.
            self._triangles.append(np.zeros((k.stop - k.start,) * 2, order="F"))
            self._triangles[-1][:] = G[k, k]
        self._Phi = np.zeros((nv, p))
        self._bodies = self._Phi.reshape(nv, nv, -1)[:, :, :10]

    def __getstate__(self):
        """Leave out Pinocchio objects and buffers."""
        state = {**self.__dict__, "_G": self._full()}
        for name in ("_one", "_triangles", "_used", "_Phi", "_bodies"):
            del state[name]
        return state

    def __setstate__(self, state):
        """Restore them."""
        self.__dict__.update(state)
        self._prepare()

    def add(self, X, y, weight, standstill):
        """Add rows X (n, 3 nv), y (n, nv), weight (n, nv) in time order."""
        # Rows of a joint at or below its standstill speed (nv,) do not count.
        nv = y.shape[1]
        weight = weight * (np.abs(X[:, nv : 2 * nv]) > standstill)
        motion = np.empty((X.shape[0], 3, nv))
        motion[:, :2] = X[:, : 2 * nv].reshape(-1, 2, nv)
        np.sign(motion[:, 1], out=motion[:, 2])
        np.abs(motion[:, 1], out=motion[:, 1])
        counts = weight[:, None] > 0
        if X.shape[0] > _FEW:
            self._reach(
                motion.min(axis=0, where=counts, initial=np.inf),
                motion.max(axis=0, where=counts, initial=-np.inf),
            )
            self._add_many(X, y, weight)
            return
        for row, own in zip(motion, counts):
            self._reach(row, row, own)
        for x, tau, w in zip(X, y, weight):
            self._add_one(x, tau, w)

    def _reach(self, lowest, highest, where=True):
        """Widen the ranges of each joint's signals (3, nv), which do not fade."""
        np.minimum(self._lowest, lowest, out=self._lowest, where=where)
        np.maximum(self._highest, highest, out=self._highest, where=where)

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
        """Regressor matrix (nv, p) of one row, in a reused buffer."""
        # Uses Pinocchio itself: for one row a call of the compiled loop is no faster.
        nv = self._n.size
        q, v, a = x[:nv], x[nv : 2 * nv], x[2 * nv :]
        self._bodies[:] = self._one(q, v, a)
        columns = declared_columns(self._features.friction_, v[None], a[None])
        diagonal = np.arange(nv)
        self._Phi.reshape(nv, nv, -1)[diagonal, diagonal, 10:] = columns[0]
        self._Phi[self._zero] = 0.0
        return self._Phi

    def _add_many(self, X, y, weight):
        n = X.shape[0]
        age = self.forgetting ** np.arange(n - 1.0, -1.0, -1.0)
        self._fade(self.forgetting**n)
        Phi = self._features.matrices(X)
        new = joint_moments(Phi, y, weight * age[:, None])
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
        """Assemble matrices (nv, p, p) from their triangles, without the weight."""
        G = np.zeros(self._G.shape)
        for full, k, triangle in zip(G, self._used, self._triangles):
            lower = np.tril(triangle)
            full[k, k] = lower + np.tril(triangle, -1).T
        return G

    def moments(self):
        """Return the moments of all rows so far."""
        return JointMoments(
            n=self._weight * self._n,
            n_rows=self._n_rows.copy(),
            G=self._weight * self._full(),
            g=self._weight * self._g,
            yy=self._weight * self._yy,
            ranges=SignalRanges(
                lowest=self._lowest.copy(), highest=self._highest.copy()
            ),
        )


def check_online(identifier, effects):
    """Reject settings of an identifier that online updates do not support."""
    forgetting = identifier.forgetting
    refuse_followers(effects, "partial_fit", "use fit")
    if not (np.ndim(forgetting) == 0 and 0 < forgetting <= 1):
        raise ValueError(
            "forgetting must be a number in (0, 1], the weight that a row keeps with "
            f"each further one; got {forgetting!r}."
        )
    asked = {
        "effects": len(effects) > 0,
        "regressor": not from_moments(identifier.regressor),
    }
    refused = [name for name, is_asked in asked.items() if is_asked]
    if refused:
        raise ValueError(
            f"partial_fit does not support {', '.join(refused)}: it keeps second "
            "moments of the rigid bodies and their friction only. Use effects=() "
            "and a VBJFARegressor or JFARegressor."
        )


def check_rows(names, X, y, sample_weight):
    """Validate rows, fast enough for a control loop; return X, y, weight."""
    X, y = np.atleast_2d(np.asarray(X, dtype=float), np.asarray(y, dtype=float))
    nv = len(names)
    if y.shape[0] != X.shape[0] and y.size == X.shape[0] * nv:
        y = y.reshape(X.shape[0], nv)
    if X.ndim != 2 or X.shape[1] != 3 * nv:
        raise ValueError(
            f"partial_fit needs states [q | v | a], {3 * nv} columns for {nv} "
            f"joint(s), since positions cannot be differentiated row by row; got an "
            f"array of shape {X.shape}."
        )
    if y.shape != (X.shape[0], nv):
        check_widths(names, X, y)
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
        weight = check_weight(sample_weight, y.shape)
    return X, y, weight
