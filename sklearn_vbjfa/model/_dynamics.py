"""Regressors, inverse dynamics and their derivatives of many samples.

A body is a cloud of points. That of coordinates xi in the frame of its joint is at p +
xi_1 e_1 + xi_2 e_2 + xi_3 e_3, with the origin p and the axes e_k in the world, and
accelerates with a + xi_1 d_1 + xi_2 d_2 + xi_3 d_3. Mass times acceleration and its
moment, summed over the points, are all ten columns of a body's regressor: cross
products of (p, e_1, e_2, e_3) and (a, d_1, d_2, d_3). A joint's torque is its screw
times the forces on what it carries.

Turn what a joint carries by a small angle about an axis u through the joint. In the
frame that turns with it nothing of it has moved; what it is carried by moves otherwise:
angular velocity, angular acceleration and acceleration of the joint change by

    dw = w × u,  ddw = dot(w) × u,  dA = A × u,

so that a point at x of velocity V(x) has another acceleration, by Coriolis' theorem

    dA(x) = alpha + beta × x + 2 dw × V(x),  beta = ddw + w × dw,
    alpha = dA - beta × p - 2 dw × V(p).

The forces that this takes, summed over all that a joint carries, need five sums over
its mass, of 1, x, V, x x' and V x', and are linear in alpha, beta and dw. Joints that
carry the turned one feel its force turned as well. For a shift along u, alpha = dot(w)
× u + w × (w × u) and beta = dw = 0. In spatial notation the derivative by a joint's own
position is in Carpentier and Mansard (doi:10.15607/RSS.2018.XIV.038).
"""

import functools

import numpy as np

from sklearn_vbjfa.model._trees import (
    describe,
    import_compiled,
    import_pinocchio,
)

# Root mean square below which an entry of the regressor matrix is the rounding of a
# zero, relative to the largest of its unit in the same torque.
_ROUNDING = 1e-12
# Random states that tell which entries are zero whatever the motion.
_N_PROBES = 32
# Samples that go through together: few enough to stay in the processor's cache, and
# more than calls cost.
_ROWS = 2048


def cross(x, y):
    """Cross product of vectors, arrays of shape (3, ...)."""
    out = np.empty((3, *np.broadcast_shapes(x.shape[1:], y.shape[1:])))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        np.subtract(x[i] * y[j], x[j] * y[i], out=out[k])
    return out


def dot(x, y):
    """Scalar product of vectors (3, ...)."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def _times(A, x):
    """Products of matrices (3, 3, ...) and vectors (3, ...), or several (3, k, ...)."""
    A = A if x.ndim < A.ndim else A[:, :, None]
    out = A[:, 0] * x[0]
    out += A[:, 1] * x[1]
    out += A[:, 2] * x[2]
    return out


def mixed(A, axes):
    """Products of a matrix (m, 3) and the second index of axes (3, 3, n)."""
    # Not by `matmul`, which adds few samples up in another order than many.
    out = A[:, 0, None] * axes[:, :1]
    out += A[:, 1, None] * axes[:, 1:2]
    out += A[:, 2, None] * axes[:, 2:]
    return out


def _outer(x, y):
    """Matrices x y' (3, 3, ...) of vectors (3, ...)."""
    return x[:, None] * y[None]


def _matrices(A, B):
    """Products of matrices (3, 3, ...)."""
    return np.stack([_times(A, B[:, k]) for k in range(3)], axis=1)


def _skew(x):
    """Matrices (3, 3, ...) that take y to x cross y."""
    zero = np.zeros_like(x[0])
    return np.array([[zero, -x[2], x[1]], [x[2], zero, -x[0]], [-x[1], x[0], zero]])


def _trace(A):
    """Traces of matrices (3, 3, ...)."""
    return A[0, 0] + A[1, 1] + A[2, 2]


class _MovedLink:
    """A joint and its body in some samples: vectors (3, n) in the world's axes."""

    # `base`, `placed`: origin of the joint before it moves, and its axes there (3, 3,
    # n) by columns; `origin`, `axes`: those of the body; `axis`: about or along which
    # it moves; `spin`, `gain`: angular velocity and acceleration of the body, `speed`
    # and `field`: velocity and acceleration of its origin, less gravity; with `_above`
    # those of what carries it, at `base`.

    def __init__(self, q, v, a, tree, j, above):
        n = q.size
        turns, slides = tree.turns[j], tree.slides[j]
        if above is None:
            axes = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, n))
            self.spin_above = np.zeros((3, n))
            self.gain_above = np.repeat(tree.base_angular[:, None], n, axis=1)
            self.base, self._swing = np.zeros((3, n)), np.zeros((3, n))
            self.field_above = np.repeat(tree.base[j][:, None], n, axis=1)
        else:
            axes, w, dw = above.axes, above.spin, above.gain
            arm = mixed(tree.offsets[j][None], axes)[:, 0]
            self.spin_above, self.gain_above = w, dw
            self.base = above.origin + arm
            self._swing = swing = cross(w, arm)
            self.field_above = above.field + cross(dw, arm) + cross(w, swing)
        # Rows of `frames` are the axes of the joint in those of its parent.
        self.placed = mixed(tree.frames[j], axes)
        direction = tree.axes[j]
        self.axis = mixed(direction[None], self.placed)[:, 0]
        angle, about = turns * q, _skew(direction)
        self.axes = (
            self.placed
            + np.sin(angle) * mixed(about.T, self.placed)
            + (1 - np.cos(angle)) * mixed((about @ about).T, self.placed)
        )
        w, dw = self.spin_above, self.gain_above
        across = cross(w, self.axis)
        self.origin, self.field, self._slide = self.base, self.field_above, None
        if slides:
            shift, along = slides * q * self.axis, slides * v * self.axis
            swing = cross(w, shift)
            self.origin = self.base + shift
            self._slide = swing + along
            self.field = (
                self.field_above
                + cross(dw, shift)
                + cross(w, swing)
                + 2 * cross(w, along)
                + slides * a * self.axis
            )
        self._above = above
        self.spin = w + turns * v * self.axis
        self.gain = dw + turns * a * self.axis + turns * v * across
        # The torque is `moment` times the moment about the origin plus `force` times
        # the force.
        self.moment = turns * self.axis
        self.force = slides * self.axis + turns * cross(self.origin, self.axis)

    @functools.cached_property
    def speed_above(self):
        """Velocity of what carries the joint, at `base`, (3, n)."""
        return self._swing if self._above is None else self._above.speed + self._swing

    @property
    def speed(self):
        """Velocity of the body's origin, (3, n)."""
        slide = self._slide
        return self.speed_above if slide is None else self.speed_above + slide

    def turned(self):
        """Change of motion (9, 3, n), see above, for turns about the placed axes."""
        u = self.placed
        w, dw, p = self.spin_above, self.gain_above, self.base
        spin = cross(w[:, None], u)
        beta = cross(dw[:, None], u) + cross(w[:, None], spin)
        alpha = cross(self.field_above[:, None], u) - cross(beta, p[:, None])
        alpha -= 2 * cross(spin, self.speed_above[:, None])
        return np.concatenate([alpha, beta, spin])

    def shifted(self):
        """Change of motion (9, 3, n) for shifts along the placed axes."""
        w, dw, u = self.spin_above[:, None], self.gain_above[:, None], self.placed
        out = np.zeros((9, *u.shape[1:]))
        out[:3] = cross(dw, u) + cross(w, cross(w, u))
        return out


class _Mass:
    """Sums over the mass that a joint carries, and the wrench that moves it."""

    # `m`, `x`, `v`, `xx`, `vx`: sums of 1, x, V, x x' and V x'; `force`, `moment`:
    # those that its motion takes, about the world's origin.

    def __init__(self, link, inertial):
        m, first = inertial[0], inertial[1:4]
        xx, xy, yy, xz, yz, zz = inertial[4:]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        p, R, w = link.origin, link.axes, link.spin
        arm = np.einsum("kin,i->kn", R, first)
        self.m = np.full(p.shape[1], m)
        self.x = arm + m * p
        self.xx = np.einsum("ain,ij,bjn->abn", R, second, R, optimize=True)
        mixed = _outer(p, arm)
        self.xx = self.xx + mixed + mixed.transpose(1, 0, 2) + m * _outer(p, p)
        # V(x) = v0 + w x
        v0 = link.speed - cross(w, p)
        self.v = m * v0 + cross(w, self.x)
        self.vx = _outer(v0, self.x) + _matrices(_skew(w), self.xx)
        # A(x) = a0 + M x
        M = _skew(link.gain) + _outer(w, w) - dot(w, w) * np.eye(3)[:, :, None]
        a0 = link.field - _times(M, p)
        self.force = m * a0 + _times(M, self.x)
        B = _matrices(M, self.xx)
        axial = np.stack([B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1]])
        self.moment = cross(self.x, a0) + axial

    def __iadd__(self, other):
        """Add what another joint carries."""
        for name in ("m", "x", "v", "xx", "vx", "force", "moment"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        return self

    def torque_by_motion(self, link):
        """Differentiate a joint's torque by (alpha, beta, delta omega), (9, n)."""
        f, n = link.force, link.moment
        return np.concatenate(
            [
                self.m * f + cross(n, self.x),
                cross(self.x, f) + _trace(self.xx) * n - _times(self.xx, n),
                2 * cross(self.v, f)
                + 2 * _trace(self.vx) * n
                - 2 * _times(self.vx.transpose(1, 0, 2), n),
            ]
        )

    def wrench(self, change):
        """Force and moment (3, k, n) that changes of motion (9, k, n) take."""
        alpha, beta, spin = change[:3], change[3:6], change[6:]
        m, x, v = self.m[None, None], self.x[:, None], self.v[:, None]
        force = m * alpha + cross(beta, x) + 2 * cross(spin, v)
        xx, vx = self.xx[:, :, None], self.vx[:, :, None]
        moment = cross(x, alpha) + _trace(xx) * beta - _times(xx, beta)
        moment += 2 * _trace(vx) * spin - 2 * _times(vx, spin)
        return force, moment


def links_of(tree, q, v, a):
    """Return the `_MovedLink` of each joint, of samples (n, nv)."""
    q, v, a = (np.ascontiguousarray(x.T) for x in (q, v, a))
    links = []
    for j, parent in enumerate(tree.parents):
        above = links[parent] if parent >= 0 else None
        links.append(_MovedLink(q[j], v[j], a[j], tree, j, above))
    return links


class TorqueDerivatives:
    """Derivatives of a robot's torques by its joints' placements, and by gravity."""

    # q, v, a (n, nv); inertial (nv, 10); nominal: the robot before it was corrected, if
    # it was.

    def __init__(self, model, q, v, a, inertial, nominal=None):
        self._model, self._nominal = model, model if nominal is None else nominal
        self._tree = describe(model)
        self._parents = self._tree.parents
        self._motion = q, v, a
        self._inertial = inertial

    @functools.cached_property
    def _made(self):
        """Derivatives by turns and shifts (n, nv, nv, 3), and gravity (n, nv, 3)."""
        # The first joint is the one whose torque changes, the second the one moved.
        # Shifts are left out where no joint slides.
        n, nv = self._motion[0].shape
        shape = (n, nv, nv, 3)
        shifts = np.zeros(shape if self._tree.slides.any() else (n, 0))
        made = np.zeros(shape), shifts, np.empty((n, nv, 3))
        for begin in range(0, n, _ROWS):
            rows = slice(begin, min(begin + _ROWS, n))
            self._fill(rows, *(one[rows] for one in made))
        return made

    def _fill(self, rows, turns, shifts, gravity):
        """Write the derivatives of some samples."""
        tree, parents = self._tree, self._parents
        links = links_of(tree, *(x[rows] for x in self._motion))
        masses = list(map(_Mass, links, self._inertial))
        for j in range(len(parents) - 1, -1, -1):
            if parents[j] >= 0:
                masses[parents[j]] += masses[j]
        by_motion = [mass.torque_by_motion(link) for mass, link in zip(masses, links)]
        for j, one in enumerate(by_motion):
            gravity[:, j] = -one[:3].T
        slides = bool(tree.slides.any())
        for k, link in enumerate(links):
            change = link.turned()
            kinds = [change, link.shifted()] if slides else [change]
            change = np.concatenate(kinds, axis=1)
            for j in self._carried(k):
                torque = np.einsum("in,ikn->nk", by_motion[j], change)
                turns[:, j, k] = torque[:, :3]
                if slides:
                    shifts[:, j, k] = torque[:, 3:]
            self._fill_above(k, links, masses[k], change, turns, shifts)

    def _fill_above(self, k, links, mass, change, turns, shifts):
        """Write the derivatives of the joints that carry joint k."""
        j = self._parents[k]
        if j < 0:
            return
        force, moment = mass.wrench(change)
        p, F = links[k].base, mass.force
        about = (mass.moment - cross(p, F))[:, None]
        u = links[k].placed
        lean = cross(u, F[:, None])
        force[:, :3] += lean
        moment[:, :3] += cross(u, about) + cross(p[:, None], lean)
        if change.shape[1] > 3:
            moment[:, 3:] += cross(u, F[:, None])
        while j >= 0:
            link = links[j]
            torque = dot(link.moment[:, None], moment) + dot(link.force[:, None], force)
            turns[:, j, k] = torque[:3].T
            if change.shape[1] > 3:
                shifts[:, j, k] = torque[3:].T
            j = self._parents[j]

    def _carried(self, k):
        """Joints that joint k carries, itself first."""
        found = [k]
        for j in range(k + 1, len(self._parents)):
            if self._parents[j] in found:
                found.append(j)
        return found

    def by_turn(self, joint):
        """Differentiate by turns of a joint about its axes, (n, nv, 3) [N m/rad]."""
        # The axes go through the origin that the robot had before it was corrected:
        # with its axis turns the way by which the zero of a slide was moved.
        turns = self._made[0][:, :, joint]
        if not self._tree.slides[joint]:
            return turns
        here, before = (
            one.jointPlacements[joint + 1].translation
            for one in (self._model, self._nominal)
        )
        way = self.rotation(joint).T @ (here - before)
        return turns + self._made[1][:, :, joint] @ np.cross(np.eye(3), way).T

    def by_position(self, joint):
        """Differentiate by the position of a joint, ndarray of shape (n, nv)."""
        tree = self._tree
        turns, shifts, _ = self._made
        moved = tree.turns[joint] * (turns[:, :, joint] @ tree.axes[joint])
        if tree.slides[joint]:
            along = shifts[:, :, joint] @ tree.axes[joint]
            moved = moved + tree.slides[joint] * along
        return moved

    def by_gravity(self):
        """Differentiate by the vector of gravity, ndarray of shape (n, nv, 3)."""
        return self._made[2]

    def axis(self, joint):
        """Direction of a joint in its own frame, ndarray of shape (3,)."""
        return self._tree.axes[joint]

    def rotation(self, joint):
        """Axes of a joint's placement in what carries it, ndarray of shape (3, 3)."""
        return self._model.jointPlacements[joint + 1].rotation

    def nominal_rotation(self, joint):
        """Return the same before the robot was corrected."""
        return self._nominal.jointPlacements[joint + 1].rotation

    @property
    def nominal_gravity(self):
        """Gravity before the robot was corrected, ndarray of shape (3,)."""
        return self._nominal.gravity.linear


class CorrectedModel:
    """A robot model that takes corrections, in any order; `nominal` is left alone."""

    # gains (nv,): what each torque channel reads, over the torque.

    def __init__(self, nominal):
        self._nominal = nominal
        self.model = nominal.copy()
        self.gains = np.ones(nominal.nv)
        self._tree = describe(nominal)

    @property
    def nominal_gravity(self):
        """Gravity of the description, ndarray (3,) [m/s^2]."""
        return self._nominal.gravity.linear.copy()

    def axis(self, joint):
        """Direction of a joint in its own frame, ndarray (3,)."""
        return self._tree.axes[joint]

    def tilt(self, rotation):
        """Turn gravity by a matrix (3, 3)."""
        gravity = self.model.gravity.copy()
        gravity.linear = rotation @ gravity.linear
        self.model.gravity = gravity

    def turn(self, joint, rotation):
        """Turn the placement of a joint, with all it carries, by a matrix (3, 3)."""
        # The matrix counts in the frame of the description: a zero that was moved
        # before is moved along the turned axis.
        placement = self.model.jointPlacements[joint + 1]
        nominal = self._nominal.jointPlacements[joint + 1]
        turned = nominal.rotation @ rotation @ nominal.rotation.T
        arm = turned @ (placement.translation - nominal.translation)
        placement.translation = nominal.translation + arm
        placement.rotation = turned @ placement.rotation

    def move_zero(self, joint, zero):
        """Put a joint's zero where its encoder reads `zero` [rad or m]."""
        pin, tree = import_pinocchio(), self._tree
        placement = self.model.jointPlacements[joint + 1]
        axis = tree.axes[joint]
        shift = -zero * tree.slides[joint] * (placement.rotation @ axis)
        placement.translation = placement.translation + shift
        turn = pin.exp3(-zero * tree.turns[joint] * axis)
        placement.rotation = placement.rotation @ turn

    def read(self, joint, gain):
        """Let the torque channel of a joint read `gain` times what it reads."""
        self.gains[joint] *= gain


# -- regressors ------------------------------------------------------------------------


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

    def __call__(self, q, v, a):
        """Compute (n, nv, nv, 10), the torque of a joint by parameters of a body."""
        # q, v, a (n, nv). Parameters are m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz,
        # Izz.
        out = np.zeros((len(q), self.support.size))
        places = np.arange(self.support.size).reshape(self.support.shape)
        places = np.where(self.support, places, -1)
        self.entries(np.hstack([q, v, a]), places, out)
        return out.reshape(-1, *self.support.shape)

    def entries(self, states, places, out):
        """Compute single entries of the regressor matrices of states (n, 3 nv)."""
        # places (nv, nv, 10): column of `out` (n, n_columns) for each torque, body and
        # parameter, -1 for none, as it must be outside the support. Columns without an
        # entry are left alone.
        fill_rows(states, self._tree, places, out)

    def torques(self, q, v, a, inertial):
        """Compute inverse dynamics (n, nv), without friction and rotors."""
        # inertial (nv, 10): as the regressor's columns; they need not belong to any
        # body.
        bodies = np.ascontiguousarray(np.reshape(inertial, (self.nv, 10)), dtype=float)
        states, out = np.ascontiguousarray(np.hstack([q, v, a])), np.empty(q.shape)
        _kernel().torques(states, self._tree, bodies, out)
        return out


def _kernel():
    return import_compiled("sklearn_vbjfa.model._kernel")


def fill_rows(states, tree, places, out):
    """Write entries of regressor matrices, see `fill` in `_kernel`."""
    # Arrays of one layout: for each other one the kernel would be compiled again.
    states, places = np.ascontiguousarray(states), np.ascontiguousarray(places)
    _kernel().fill(states, tree, places, out)


def last_body_columns(tree, q, v, a):
    """Columns (n, 10) of the last body in the torque of each joint of a `Tree`."""
    nv = tree.parents.size
    places = np.full((nv, nv, 10), -1)
    places[:, -1] = np.arange(10 * nv).reshape(nv, 10)
    out = np.zeros((len(q), 10 * nv))
    fill_rows(np.hstack([q, v, a]), tree, places, out)
    return np.split(out, nv, axis=1)
