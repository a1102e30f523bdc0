"""Regressors, inverse dynamics and their derivatives of many samples.

A body is a cloud of points. That of coordinates xi in the frame of its joint is at p +
xi_1 e_1 + xi_2 e_2 + xi_3 e_3, with the origin p and the axes e_k in the world, and
accelerates with a + xi_1 d_1 + xi_2 d_2 + xi_3 d_3. Mass times acceleration and its
moment, summed over the points, are all ten columns of a body's regressor: cross
products of (p, e_1, e_2, e_3) and (a, d_1, d_2, d_3). A joint's torque is its screw
times the forces on what it carries.

Turn a joint, with all it carries, by an angle about an axis through it, or shift it:
positions, and angular velocities times positions twice, are of second degree in the
cosine and sine of the angle, or in the shift. Torques at a few angles and shifts give
the exact derivative.
"""

import numpy as np

from sklearn_vbjfa.model._trees import describe, import_pinocchio

# Root mean square below which an entry of the regressor matrix is the rounding of a
# zero, relative to the largest of its unit in the same torque.
_ROUNDING = 1e-12
# Random states that tell which entries are zero whatever the motion.
_N_PROBES = 32


class TorqueDerivatives:
    """Derivatives of a robot's torques by its joints' placements, and by gravity."""

    # q, v, a (n, nv); inertial (nv, 10); nominal: the robot before it was corrected, if
    # it was, of which `nominal_gravity` (3,) is. axes (nv, 3): directions of the joints
    # in their own frames.

    def __init__(self, model, q, v, a, inertial, nominal=None):
        self._model, self._nominal = model, model if nominal is None else nominal
        self._tree, self._inertial = describe(model), inertial
        self.axes = self._tree.axes
        self.nominal_gravity = self._nominal.gravity.linear.copy()
        self._states = np.hstack([q, v, a])

    def by_turn(self, joint, turns):
        """Differentiate by turns (3, k) of a joint in its axes, (n, nv, k)."""
        # The axes go through the origin that the robot had before it was corrected:
        # with its axis turns the way by which the zero of a slide was moved.
        here, before = (
            one.jointPlacements[joint + 1].translation
            for one in (self._model, self._nominal)
        )
        way, found = self.rotation(joint).T @ (here - before), []
        for vector in np.transpose(turns):
            moved = self._by_angle(joint, vector)
            if way.any():
                moved = moved + self._by_shift(joint, np.cross(vector, way))
            found.append(moved)
        return np.stack(found, axis=2)

    def by_position(self, joint):
        """Differentiate by the position of a joint, ndarray of shape (n, nv)."""
        axis, moved = self.axes[joint], 0.0
        turns, slides = self._tree.turns[joint], self._tree.slides[joint]
        if turns:
            moved = moved + turns * self._by_angle(joint, axis)
        if slides:
            moved = moved + slides * self._by_shift(joint, axis)
        return moved

    def by_gravity(self):
        """Differentiate by the vector of gravity, ndarray of shape (n, nv, 3)."""
        # The torques that hold a unit of it.
        nv = self._tree.parents.size
        still, found = self._states.copy(), []
        still[:, nv:] = 0.0
        root = 1.0 * (self._tree.parents < 0)[:, None]
        for axis in np.eye(3):
            tree = self._tree.changed(base=-root * axis, base_angular=np.zeros(3))
            found.append(torques_of(tree, still, self._inertial))
        return np.stack(found, axis=2)

    def _by_angle(self, joint, vector):
        """By a turn of a joint by a vector (3,) in its placement, (n, nv)."""
        # Of b_1 sin x + b_2 sin 2x, the odd part, the derivative is b_1 + 2 b_2.
        turn, frame = import_pinocchio().exp3, self._tree.frames[joint]
        size = np.linalg.norm(vector)
        axis = vector / (size or 1.0)

        def turned(angle):
            return self._changed("frames", joint, turn(angle * axis).T @ frame)

        angles = np.pi * np.array([0.5, -0.5, 0.25, -0.25])
        weights = size * np.array([1.0, -1.0, 1.0, -1.0])
        weights[:2] *= 0.5 - np.sqrt(0.5)
        return _combined(list(map(turned, angles)), weights)

    def _by_shift(self, joint, vector):
        """By a shift of a joint by a vector (3,) in its placement, (n, nv)."""
        place, way = self._tree.offsets[joint], vector @ self._tree.frames[joint]
        ends = [self._changed("offsets", joint, place + one) for one in (way, -way)]
        return _combined(ends, (0.5, -0.5))

    def _changed(self, name, joint, value):
        """Torques (n, nv) with another value of a joint in the tree."""
        values = getattr(self._tree, name).copy()
        values[joint] = value
        tree = self._tree.changed(**{name: values})
        return torques_of(tree, self._states, self._inertial)

    def rotation(self, joint):
        """Axes of a joint's placement in what carries it, ndarray of shape (3, 3)."""
        return self._model.jointPlacements[joint + 1].rotation

    def nominal_rotation(self, joint):
        """Return the same before the robot was corrected."""
        return self._nominal.jointPlacements[joint + 1].rotation


def _combined(torques, weights):
    """Weighted sum of torques (n, nv); what is rounding of a zero is zero."""
    # A joint's torque that does not change would be information in a regression in
    # scaled columns.
    found = sum(weight * one for weight, one in zip(weights, torques))
    largest = np.max([np.abs(one).max(axis=0) for one in torques], axis=0)
    largest = largest * np.abs(weights).max()
    return np.where(np.abs(found).max(axis=0) > _ROUNDING * largest, found, 0.0)


class CorrectedModel:
    """A robot model that takes corrections, in any order; `nominal` is left alone."""

    # gains (nv,): what each torque channel reads, over the torque; base (3, 3), turns:
    # by which gravity and, by joint, placements were turned; axes (nv, 3): directions
    # of the joints in their own frames; nominal_gravity (3,): of the description.

    def __init__(self, nominal):
        self._nominal = nominal
        self.model = nominal.copy()
        self.gains = np.ones(nominal.nv)
        self.base, self.turns = np.eye(3), {}
        self._tree = describe(nominal)
        self.axes = self._tree.axes
        self.nominal_gravity = nominal.gravity.linear.copy()

    def tilt(self, rotation):
        """Turn gravity by a matrix (3, 3)."""
        gravity = self.model.gravity.copy()
        gravity.linear = rotation @ gravity.linear
        self.model.gravity, self.base = gravity, rotation @ self.base

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
        self.turns[joint] = rotation @ self.turns.get(joint, np.eye(3))

    def move_zero(self, joint, zero):
        """Put a joint's zero where its encoder reads `zero` [rad or m]."""
        pin, tree = import_pinocchio(), self._tree
        placement = self.model.jointPlacements[joint + 1]
        axis = self.axes[joint]
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
    # masses (first moments, inertias) have one unit and can be compared.
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
        model, data = self._model, self._model.createData()
        shape = self.nv, self.nv, 10
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
        return torques_of(self._tree, np.hstack([q, v, a]), inertial)


def _kernel():
    # Numba takes a second to import.
    from sklearn_vbjfa.model import _kernel

    return _kernel


def torques_of(tree, states, inertial):
    """Compute torques (n, nv) of bodies (nv, 10) in states (n, 3 nv) of a `Tree`."""
    nv = tree.parents.size
    bodies = np.ascontiguousarray(np.reshape(inertial, (nv, 10)), dtype=float)
    states, out = np.ascontiguousarray(states), np.empty((len(states), nv))
    _kernel().torques(states, tree, bodies, out)
    return out


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
