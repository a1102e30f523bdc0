"""Regressors, inverse dynamics and their derivatives for many samples.

A body is a set of mass points. The point with coordinates xi in the joint's frame is at
p + xi_1 e_1 + xi_2 e_2 + xi_3 e_3, with the origin p and the axes e_k in the world, and
has the acceleration a + xi_1 d_1 + xi_2 d_2 + xi_3 d_3. Mass times acceleration and its
moment, summed over the points, give all ten columns of a body's regressor: cross
products of (p, e_1, e_2, e_3) and (a, d_1, d_2, d_3). A joint's torque is its screw
times the wrenches of the bodies that it carries.

Consider a rotation of a joint, with all bodies it carries, by an angle about an axis
through it, or a shift: torques are of second degree in the cosine and sine of the
angle, or in the shift. Central differences are exact for a shift, and for a small angle
up to its square.
"""

import numpy as np

from sklearn_vbjfa.model._trees import describe, import_pinocchio

# Root mean square below which an entry of the regressor matrix is a rounding error,
# relative to the largest entry of the same unit and torque.
_ROUNDING = 1e-12
# Random states for finding the entries that are zero in every motion.
_N_PROBES = 32
# Angle of central differences [rad]; rounding and its square are as small.
_ANGLE = 1e-5


class TorqueDerivatives:
    """Derivatives of torques with respect to joint placements and gravity."""

    # q, v, a (n, nv); inertial (nv, 10); nominal: model before any corrections, with
    # gravity `nominal_gravity` (3,); axes (nv, 3): of the joints in their own frames.

    def __init__(self, model, q, v, a, inertial, nominal=None):
        self._model, self._nominal = model, model if nominal is None else nominal
        self._tree, self._inertial = describe(model), inertial
        self.axes = self._tree.axes
        self.nominal_gravity = self._nominal.gravity.linear.copy()
        self._states = np.hstack([q, v, a])

    def by_turn(self, joint, rotations):
        """Differentiate by rotations (3, k) of a joint in its axes, (n, nv, k)."""
        # The rotation is about the nominal origin, so that it also rotates the shift by
        # which the zero of a prismatic joint was corrected.
        corrected, nominal = (
            model.jointPlacements[joint + 1].translation
            for model in (self._model, self._nominal)
        )
        shift, derivatives = self.rotation(joint).T @ (corrected - nominal), []
        for vector in np.transpose(rotations):
            derivative = self._by_angle(joint, vector)
            if shift.any():
                derivative = derivative + self._by_shift(joint, np.cross(vector, shift))
            derivatives.append(derivative)
        return np.stack(derivatives, axis=2)

    def by_position(self, joint):
        """Differentiate by the position of a joint, ndarray of shape (n, nv)."""
        axis, derivative = self.axes[joint], 0.0
        turns, slides = self._tree.turns[joint], self._tree.slides[joint]
        if turns:
            derivative = derivative + turns * self._by_angle(joint, axis)
        if slides:
            derivative = derivative + slides * self._by_shift(joint, axis)
        return derivative

    def by_gravity(self):
        """Differentiate by the vector of gravity, ndarray of shape (n, nv, 3)."""
        # Torques at rest under unit gravity along each axis.
        nv = self._tree.parents.size
        states, derivatives = self._states.copy(), []
        states[:, nv:] = 0.0
        root = 1.0 * (self._tree.parents < 0)[:, None]
        for axis in np.eye(3):
            tree = self._tree.changed(base=-root * axis, base_angular=np.zeros(3))
            derivatives.append(torques_of(tree, states, self._inertial))
        return np.stack(derivatives, axis=2)

    def _by_angle(self, joint, vector):
        """Differentiate by a rotation of a joint, vector (3,) in its axes, (n, nv)."""
        exp3, frame = import_pinocchio().exp3, self._tree.frames[joint]
        turned = [exp3(x * vector).T @ frame for x in (_ANGLE, -_ANGLE)]
        torques = [self._torques("frames", joint, x) for x in turned]
        return _combine(torques, (0.5 / _ANGLE, -0.5 / _ANGLE))

    def _by_shift(self, joint, vector):
        """Differentiate by a shift of a joint, vector (3,) in its axes, (n, nv)."""
        offset, shift = self._tree.offsets[joint], vector @ self._tree.frames[joint]
        torques = [self._torques("offsets", joint, offset + x) for x in (shift, -shift)]
        return _combine(torques, (0.5, -0.5))

    def _torques(self, name, joint, value):
        """Compute torques (n, nv) with a changed value of one joint in the tree."""
        values = getattr(self._tree, name).copy()
        values[joint] = value
        tree = self._tree.changed(**{name: values})
        return torques_of(tree, self._states, self._inertial)

    def rotation(self, joint):
        """Axes of a joint's placement in its parent, ndarray of shape (3, 3)."""
        return self._model.jointPlacements[joint + 1].rotation

    def nominal_rotation(self, joint):
        """Return these axes in the model before corrections."""
        return self._nominal.jointPlacements[joint + 1].rotation


def _combine(torques, weights):
    """Return the weighted sum of torques (n, nv), with rounding errors set to zero."""
    # A regression with scaled columns would use rounding errors of constant torques.
    total = sum(weight * torque for weight, torque in zip(weights, torques))
    largest = np.max([np.abs(torque).max(axis=0) for torque in torques], axis=0)
    largest = largest * np.abs(weights).max()
    return np.where(np.abs(total).max(axis=0) > _ROUNDING * largest, total, 0.0)


class CorrectedModel:
    """A robot model with corrections, in any order; `nominal` is not changed."""

    # gains (nv,): reading of each torque channel over the torque; base (3, 3), turns:
    # rotations of gravity and, by joint, of placements; axes (nv, 3): directions of the
    # joints in their own frames; nominal_gravity (3,): gravity of the description.

    def __init__(self, nominal):
        self._nominal = nominal
        self.model = nominal.copy()
        self.gains = np.ones(nominal.nv)
        self.base, self.turns = np.eye(3), {}
        self._tree = describe(nominal)
        self.axes = self._tree.axes
        self.nominal_gravity = nominal.gravity.linear.copy()

    def tilt(self, rotation):
        """Rotate gravity by a matrix (3, 3)."""
        gravity = self.model.gravity.copy()
        gravity.linear = rotation @ gravity.linear
        self.model.gravity, self.base = gravity, rotation @ self.base

    def turn(self, joint, rotation):
        """Rotate the placement of a joint, with all bodies it carries, by a matrix."""
        # In the nominal frame: an earlier correction of the zero is rotated as well.
        placement = self.model.jointPlacements[joint + 1]
        nominal = self._nominal.jointPlacements[joint + 1]
        in_parent = nominal.rotation @ rotation @ nominal.rotation.T
        arm = in_parent @ (placement.translation - nominal.translation)
        placement.translation = nominal.translation + arm
        placement.rotation = in_parent @ placement.rotation
        self.turns[joint] = rotation @ self.turns.get(joint, np.eye(3))

    def move_zero(self, joint, zero):
        """Move a joint's zero to where its encoder reads `zero` [rad or m]."""
        pin, tree = import_pinocchio(), self._tree
        placement = self.model.jointPlacements[joint + 1]
        axis = self.axes[joint]
        shift = -zero * tree.slides[joint] * (placement.rotation @ axis)
        placement.translation = placement.translation + shift
        rotation = pin.exp3(-zero * tree.turns[joint] * axis)
        placement.rotation = placement.rotation @ rotation

    def read(self, joint, gain):
        """Multiply the reading of a joint's torque channel by `gain`."""
        self.gains[joint] *= gain


def rounding_entries(power):
    """Return which entries (nv, nv, k) of the regressors are rounding errors."""
    # power: mean or summed squares by torque, body, parameter (k >= 10). If a torque
    # does not depend on a parameter, the recursive algorithm leaves some 1e-16, which a
    # regression with standardised columns would use. Within a torque, all masses (first
    # moments, inertias) have the same unit and can be compared.
    rounding = np.zeros(power.shape, dtype=bool)
    for kind in (slice(0, 1), slice(1, 4), slice(4, 10)):
        largest = power[:, :, kind].max(axis=(1, 2), keepdims=True)
        rounding[:, :, kind] = power[:, :, kind] <= _ROUNDING**2 * largest
    return rounding


class TreeRegressor:
    """Joint-torque regressors and inverse dynamics of a tree of joints."""

    # model: fixed base and joints of one degree of freedom each, see `load_model`;
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
        # not depend on a parameter; in world axes these are rounding errors of
        # differences, which have no scale for comparison.
        states = np.random.default_rng(0).normal(size=(_N_PROBES, 3 * self.nv))
        regressor = self.single_state()
        probes = np.array([regressor(*np.split(row, 3)) for row in states])
        zeros = rounding_entries(np.mean(probes**2, axis=0))
        self.support = carried[:, :, None] & ~zeros

    def single_state(self):
        """Return Pinocchio's function of (q, v, a), each (nv,), to (nv, nv, 10)."""
        # Not thread-safe: each call overwrites the result of the previous one.
        compute = import_pinocchio().computeJointTorqueRegressor
        model, data = self._model, self._model.createData()
        shape = self.nv, self.nv, 10
        return lambda q, v, a: compute(model, data, q, v, a).reshape(shape)

    def __call__(self, q, v, a):
        """Compute regressors (n, nv, nv, 10), torques of joints by body parameters."""
        # q, v, a (n, nv); parameters m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
        out = np.zeros((len(q), self.support.size))
        indices = np.arange(self.support.size).reshape(self.support.shape)
        indices = np.where(self.support, indices, -1)
        self.entries(np.hstack([q, v, a]), indices, out)
        return out.reshape(-1, *self.support.shape)

    def entries(self, states, indices, out):
        """Compute single entries of the regressor matrices of states (n, 3 nv)."""
        # indices (nv, nv, 10): columns of `out` by torque, body, parameter; -1 if none,
        # required outside the support. Other columns of `out` (n, n_columns) are kept.
        fill_rows(states, self._tree, indices, out)

    def torques(self, q, v, a, inertial):
        """Compute inverse dynamics (n, nv), without friction and rotors."""
        # inertial (nv, 10): ordered as the columns; need not be physically consistent.
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


def fill_rows(states, tree, indices, out):
    """Write entries of regressor matrices, see `fill` in `_kernel`."""
    # All arrays have the same layout, because Numba compiles once for each layout.
    states, indices = np.ascontiguousarray(states), np.ascontiguousarray(indices)
    _kernel().fill(states, tree, indices, out)


def body_columns(tree, q, v, a, body=-1):
    """Return a body's columns (n, 10) in the torque of each joint of a tree."""
    nv = tree.parents.size
    indices = np.full((nv, nv, 10), -1)
    indices[:, body] = np.arange(10 * nv).reshape(nv, 10)
    out = np.zeros((len(q), 10 * nv))
    fill_rows(np.hstack([q, v, a]), tree, indices, out)
    return np.split(out, nv, axis=1)
