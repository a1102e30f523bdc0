"""Joint-torque regressors and inverse dynamics of many samples.

A body is a cloud of points. That of coordinates xi in the frame of its joint is at p +
xi_1 e_1 + xi_2 e_2 + xi_3 e_3, with the origin p and the axes e_k in the world, and
accelerates with a + xi_1 d_1 + xi_2 d_2 + xi_3 d_3. Mass times acceleration and its
moment, summed over the points, are all ten columns of a body's regressor: cross
products of (p, e_1, e_2, e_3) and (a, d_1, d_2, d_3). A joint's torque is its screw
times the forces on what it carries.
"""

import numpy as np

from sklearn_vbjfa.model._corrected import cross, dot, links_of, mixed
from sklearn_vbjfa.model._trees import describe, import_pinocchio

# Root mean square below which an entry of the regressor matrix is the rounding of a
# zero, relative to the largest of its unit in the same torque.
_ROUNDING = 1e-12
# Random states that tell which entries are zero whatever the motion.
_N_PROBES = 32
# Samples whose torques are computed together: few enough to stay in the processor's
# cache.
_ROWS = 2048


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


class TreeRegressor:
    """Joint-torque regressors and inverse dynamics of a tree of joints."""

    # model: of a fixed base and joints of one degree of freedom each, see `load_model`;
    # support (nv, nv, 10): entries that are not zero in every motion.

    def __init__(self, model):
        self.nv = model.nv
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
        for begin in range(0, q.shape[0], _ROWS):
            rows = slice(begin, begin + _ROWS)
            links = links_of(self._tree, q[rows], v[rows], a[rows])
            forces, moments = _forces_and_moments(links)
            for i, link in enumerate(links):
                body, parameter = np.nonzero(places[i] >= 0)
                torque = dot(link.moment[:, None], moments[:, body, parameter])
                light = parameter < 4
                pulled = forces[:, body[light], parameter[light]]
                torque[light] += dot(link.force[:, None], pulled)
                out[places[i, body, parameter], rows] = torque

    def torques(self, q, v, a, inertial):
        """Compute inverse dynamics (n, nv), without friction and rotors."""
        # inertial (nv, 10): as the regressor's columns; they need not belong to any
        # body.
        inertial = np.reshape(inertial, (self.nv, 10))
        torque = np.empty(q.shape)
        for begin in range(0, q.shape[0], _ROWS):
            rows = slice(begin, begin + _ROWS)
            links = links_of(self._tree, q[rows], v[rows], a[rows])
            # Force and moment of all that each joint carries.
            carried = list(map(_wrench, links, inertial))
            for j in range(self.nv - 1, -1, -1):
                (force, moment), parent = carried[j], self._tree.parents[j]
                link = links[j]
                torque[rows, j] = dot(link.force, force) + dot(link.moment, moment)
                if parent >= 0:
                    carried[parent][0] += force
                    carried[parent][1] += moment
        return torque


def _forces_and_moments(links):
    """Return forces (3, nv, 4, n) by m and mc, and moments (3, nv, 10, n)."""
    p, field, w, dw = (
        np.stack([getattr(link, name) for link in links], axis=1)[:, :, None]
        for name in ("origin", "field", "spin", "gain")
    )
    axes = np.stack([link.axes for link in links], axis=1)
    # Accelerations of the tips of the axes relative to the origin.
    tips = cross(dw, axes) + cross(w, cross(w, axes))
    moments = np.empty((3, len(links), 10, p.shape[-1]))
    moments[:, :, :1] = cross(p, field)
    moments[:, :, 1:4] = cross(p, tips) + cross(axes, field)
    # A moment of inertia sums the squares of the other two coordinates, a product of
    # inertia is a mixed second moment times minus one.
    squares = cross(axes, tips)
    moments[:, :, (4, 6, 9)] = 0.5 * squares.sum(axis=2, keepdims=True) - squares
    first, second = (0, 0, 1), (1, 2, 2)
    moments[:, :, (5, 7, 8)] = cross(tips[:, :, first], axes[:, :, second])
    moments[:, :, (5, 7, 8)] += cross(tips[:, :, second], axes[:, :, first])
    return np.concatenate([field, tips], axis=2), moments


def _wrench(link, body):
    """Force and moment about the world's origin (3, n) that a body (10,) takes."""
    xx, xy, yy, xz, yz, zz = body[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    # Accelerations (3, 3, n) of the tips of the body's axes relative to its origin.
    w, dw = link.spin[:, None], link.gain[:, None]
    d = cross(dw, link.axes) + cross(w, cross(w, link.axes))
    force = body[0] * link.field + mixed(body[None, 1:4], d)[:, 0]
    arm = mixed(body[None, 1:4], link.axes)[:, 0]
    turned = cross(link.axes, mixed(second, d)).sum(axis=1)
    return [force, cross(link.origin, force) + cross(arm, link.field) + turned]
