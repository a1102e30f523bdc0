"""Joint-torque regressors and inverse dynamics of many samples.

A body is a cloud of points. That of coordinates xi in the frame of its joint is at p +
xi_1 e_1 + xi_2 e_2 + xi_3 e_3, with the origin p and the axes e_k in the world, and
accelerates with a + xi_1 d_1 + xi_2 d_2 + xi_3 d_3. Mass times acceleration and its
moment, summed over the points, are all ten columns of a body's regressor: cross
products of (p, e_1, e_2, e_3) and (a, d_1, d_2, d_3). A joint's torque is its screw
times the forces on what it carries. `_compiled` does this; without Numba Pinocchio's
recursion.
"""

import functools

import numpy as np
from scipy import sparse

from sklearn_vbjfa.model._corrected import inverse_dynamics
from sklearn_vbjfa.model._trees import describe, import_pinocchio

# Root mean square below which an entry of the regressor matrix is the rounding of a
# zero, relative to the largest of its unit in the same torque.
_ROUNDING = 1e-12
# Random states that tell which entries are zero whatever the motion.
_N_PROBES = 32
# Bytes of regressor matrices that are in memory at once for inverse dynamics: few
# enough to stay in the processor's cache.
_CACHE = 1 << 19


def rounding_entries(power):
    """Return which entries (nv, nv, k) of the regressors are the rounding of a zero."""
    # power: mean or summed squares of torque, body, parameter (k >= 10). Where a torque
    # does not depend on a parameter the recursive algorithm leaves some 1e-16, which a
    # regression in standardised columns would take for information. In one torque all
    # masses (first moments, inertias) have one unit and can be compared; friction is
    # never rounding.
    rounding = np.zeros(power.shape, dtype=bool)
    for kind in (slice(0, 1), slice(1, 4), slice(4, 10)):
        largest = power[:, :, kind].max(axis=(1, 2), keepdims=True)
        rounding[:, :, kind] = power[:, :, kind] <= _ROUNDING**2 * largest
    return rounding


@functools.cache
def load_kernel():
    """Return the compiled loop over samples, or None where Numba is not installed."""
    try:
        from sklearn_vbjfa.model._compiled import fill
    except ModuleNotFoundError as error:
        if error.name != "numba":
            raise
        return None
    return fill


def _on_the_axis(tree, j):
    """Give columns of a body as sums of its others and of the carrying body's."""
    # Returns, for each, its number, and the weights (10,) of both bodies' columns. What
    # lies on the axis of a revolute joint does not move in the frame of either body:
    # a point at the origin, a pair of opposite points, and a rod.
    if tree.slides[j] != 0.0 or tree.turns[j] == 0.0:
        return []
    u, r = tree.axes[j], tree.offsets[j]
    w = u @ tree.frames[j]  # the axis in the carrying body
    none = np.zeros(3)
    alike = (
        (_moments(1.0, none, np.zeros((3, 3))), _moments(1.0, r, np.outer(r, r))),
        (
            _moments(0.0, u, np.zeros((3, 3))),
            _moments(0.0, w, np.outer(r, w) + np.outer(w, r)),
        ),
        (_moments(0.0, none, np.outer(u, u)), _moments(0.0, none, np.outer(w, w))),
    )
    found = []
    for own, above in alike:
        number = int(np.argmax(np.abs(own)))
        rest = np.where(np.arange(10) == number, 0.0, own)
        found.append((number, -rest / own[number], above / own[number]))
    return found


def _moments(mass, first, second):
    """Inertial parameters (10,) of moments of mass: of order 0, 1 (3,) and 2 (3, 3)."""
    inertia = np.trace(second) * np.eye(3) - second
    return np.r_[mass, first, inertia[np.tril_indices(3)]]


class TreeRegressor:
    """Joint-torque regressors and inverse dynamics of a tree of joints."""

    # model: of a fixed base and joints of one degree of freedom each, see `load_model`;
    # compiled: by Numba, several times as fast as Pinocchio called for each sample;
    # None does so where Numba is installed; support (nv, nv, 10): entries that are not
    # zero in every motion.

    def __init__(self, model, compiled=None):
        self.nv = model.nv
        self.compiled = compiled
        self._model = model
        self._tree = describe(model)
        carried = np.eye(self.nv, dtype=bool)
        for i, parent in enumerate(self._tree.parents):
            if parent >= 0:
                carried[:, i] |= carried[:, parent]
        # Pinocchio's recursion in body frames leaves exact zeros where the torque does
        # not depend on a parameter; in world axes they are the rounding of
        # differences, which have no scale to be judged by.
        states = np.random.default_rng(0).normal(size=(_N_PROBES, 3 * self.nv))
        one = self.one_by_one()
        probes = np.array([one(*np.split(row, 3)) for row in states])
        zeros = rounding_entries(np.mean(probes**2, axis=0))
        self.support = carried[:, :, None] & ~zeros

    def dependent(self):
        """Find entries that are sums of others in every motion.

        Returns the entries (nv, nv, 10), bool, and by torque the matrix that makes them
        of the torque's other entries in the support, both in the order of `np.nonzero`.
        """
        # Mass on a joint's axis is a mass of the carrying body as well: none of the
        # torques can tell whose a body's mass, its first moment along the axis and the
        # second moment of a rod on it are, see `_on_the_axis`.
        last = [_on_the_axis(self._tree, j) for j in range(self.nv)]
        which = np.zeros((self.nv, 10), dtype=bool)
        for j, ways in enumerate(last):
            which[j, [number for number, *_ in ways]] = True
        dependent = self.support & which
        matrices = []
        for i in range(self.nv):
            kept, made = self.support[i] & ~which, dependent[i]
            known = np.zeros((self.nv, 10, np.count_nonzero(kept)))
            known[kept] = np.eye(known.shape[2])
            for j, ways in enumerate(last):
                parent = self._tree.parents[j]
                for number, own, above in ways:
                    if made[j, number]:
                        known[j, number] = own @ known[j]
                        known[j, number] += above @ known[parent] if parent >= 0 else 0
            matrices.append(known[made])
        return dependent, matrices

    def one_by_one(self):
        """Return Pinocchio's function of (q, v, a), each (nv,), to (nv, nv, 10)."""
        # What it returns is overwritten by the next call; it is not for several
        # threads.
        compute = import_pinocchio().computeJointTorqueRegressor
        model, data, shape = (
            self._model,
            self._model.createData(),
            (self.nv, self.nv, 10),
        )
        return lambda q, v, a: compute(model, data, q, v, a).reshape(shape)

    def __call__(self, q, v, a, out=None):
        """Compute (n, nv, nv, k), the torque of a joint by parameters of a body."""
        # q, v, a (n, nv); out: C-contiguous with k >= 10, whose columns after the tenth
        # become zero. Parameters are m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
        n, nv = q.shape[0], self.nv
        if out is None:
            out = np.empty((n, nv, nv, 10))
        k = out.shape[-1]
        if out.shape != (n, nv, nv, k) or k < 10 or not out.flags.c_contiguous:
            raise ValueError(
                f"out must be C-contiguous, of shape ({n}, {nv}, {nv}, at least 10); "
                f"got shape {out.shape}."
            )
        out[...] = 0.0
        places = np.arange(nv * nv * k).reshape(nv, nv, k)[:, :, :10]
        places = np.where(self.support, places, -1)
        self.entries(q, v, a, places, out.reshape(n, nv * nv * k).T)
        return out

    def entries(self, q, v, a, places, out):
        """Compute single entries of the regressor matrices, samples last."""
        # places (nv, nv, 10): row of `out` (n_entries, n) for each torque, body and
        # parameter, -1 for none, as it must be outside the support. Rows without an
        # entry are left alone.
        kernel = None if self.compiled is False else load_kernel()
        if kernel is not None:
            kernel(q, v, a, self._tree, places, out)
            return
        if self.compiled:
            raise ImportError(
                "A compiled regressor needs Numba: pip install sklearn-vbjfa[fast]."
            )
        one, used = self.one_by_one(), places >= 0
        matrices = np.empty((q.shape[0], *places.shape))
        for matrix, *sample in zip(matrices, q, v, a):
            matrix[...] = one(*sample)
        out[places[used]] = matrices[:, used].T

    def torques(self, q, v, a, inertial):
        """Compute inverse dynamics (n, nv), without friction and rotors."""
        # inertial (nv, 10): as the regressor's columns; they need not belong to any
        # body.
        if self.compiled is False or load_kernel() is None:
            inertial = np.reshape(inertial, (self.nv, 10))
            return inverse_dynamics(self._tree, q, v, a, inertial)
        count = np.count_nonzero(self.support)
        places = np.full(self.support.shape, -1)
        places[self.support] = np.arange(count)
        # Each torque is a sum over its entries, of which a robot of many branches has
        # few.
        joint, *parameter = np.nonzero(self.support)
        values = np.reshape(inertial, (self.nv, 10))[tuple(parameter)]
        sums = sparse.csr_array(
            (values, (joint, np.arange(count))), shape=(self.nv, count)
        )
        torque = np.empty(q.shape)
        size = max(1, _CACHE // (8 * max(count, 1)))
        for begin in range(0, q.shape[0], size):
            rows = slice(begin, min(begin + size, q.shape[0]))
            entries = np.empty((count, rows.stop - begin))
            self.entries(q[rows], v[rows], a[rows], places, entries)
            torque[rows] = (sums @ entries).T
        return torque
