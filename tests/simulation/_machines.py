"""Machines with known dynamics, as `TorqueModel`s."""

import numpy as np
import pinocchio as pin

from sklearn_vbjfa.simulation import TorqueModel
from tests.model._robots import random_tree
from tests.physical._problems import parameters_of

GRAVITY = 9.81


def machine(model, bodies, friction=None, effects=(), **other):
    """Make a `TorqueModel`; friction is a dict of names to values of the joints.

    effects : pairs of an effect and its coefficients.
    """
    friction = {} if friction is None else friction
    columns = [np.broadcast_to(values, model.nv) for values in friction.values()]
    other = {"gains": np.ones(model.nv), "dt": 0.01} | other
    return TorqueModel(
        model=model,
        bodies=np.asarray(bodies, dtype=float),
        friction_names=tuple(friction),
        friction=np.column_stack(columns) if columns else np.zeros((model.nv, 0)),
        effects=tuple(effect for effect, _ in effects),
        coefficients=tuple(np.array(coef, dtype=float) for _, coef in effects),
        **other,
    )


def point(mass, centre=(0.0, 0.0, 0.0), inertia=0.0):
    """Return the ten inertial parameters of a point mass with a rotational inertia."""
    rotational = inertia * np.array([0, 0, 0, 0, 1, 0, 1, 0, 0, 1])
    return parameters_of(np.array([centre]), [mass]) + rotational


def slider(mass=2.0, friction=None, effects=(), **other):
    """Return a mass on a horizontal rail."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    return machine(model, [point(mass)], friction, effects, **other)


def wheel(inertia=0.5, friction=None, effects=(), **other):
    """Return a balanced wheel about a vertical axis."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "wheel")
    return machine(model, [point(1.0, inertia=inertia)], friction, effects, **other)


def pendulum(mass=1.5, length=0.4, inertia=0.02, friction=None, effects=(), **other):
    """Return a pendulum that hangs down at q = 0."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "pendulum")
    body = point(mass, (0.0, 0.0, -length), inertia)
    return machine(model, [body], friction, effects, **other)


class Arm:
    """Two links in a vertical plane, with dynamics in closed form.

    Both joints turn about y; at q = 0 the arm hangs down. Angles are relative.
    """

    lengths = (0.5, 0.4)
    centres = (0.3, 0.2)
    masses = (2.0, 1.0)
    inertias = (0.05, 0.02)

    def model(self, gravity=GRAVITY):
        """Return the Pinocchio model."""
        out = pin.Model()
        out.gravity.linear = np.array([0.0, 0.0, -gravity])
        out.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "shoulder")
        elbow = pin.SE3(np.eye(3), np.array([0.0, 0.0, -self.lengths[0]]))
        out.addJoint(1, pin.JointModelRY(), elbow, "elbow")
        return out

    def robot(self, friction=None, effects=(), gravity=GRAVITY, **other):
        """Return the `TorqueModel` of the arm."""
        bodies = [
            point(m, (0.0, 0.0, -c), i)
            for m, c, i in zip(self.masses, self.centres, self.inertias)
        ]
        return machine(self.model(gravity), bodies, friction, effects, **other)

    def mass(self, q, payload=0.0):
        """Return the inertia matrix with a point mass at the end of the arm."""
        (m1, m2), (c1, c2), (I1, I2) = self.masses, self.centres, self.inertias
        l1, l2 = self.lengths
        moment = m2 * c2 + payload * l2
        far = I2 + m2 * c2**2 + payload * l2**2
        cross = l1 * moment * np.cos(q[1])
        near = I1 + m1 * c1**2 + (m2 + payload) * l1**2
        return np.array([[near + far + 2 * cross, far + cross], [far + cross, far]])

    def bias(self, q, v, payload=0.0, gravity=GRAVITY):
        """Return centrifugal, Coriolis and gravity torques."""
        (m1, m2), (c1, c2) = self.masses, self.centres
        l1, l2 = self.lengths
        moment = m2 * c2 + payload * l2
        s = l1 * moment * np.sin(q[1])
        both = gravity * moment * np.sin(q[0] + q[1])
        first = gravity * (m1 * c1 + (m2 + payload) * l1) * np.sin(q[0])
        return np.array(
            [-s * (2 * v[0] + v[1]) * v[1] + first + both, s * v[0] ** 2 + both]
        )


def random_machine(rng, n_joints, friction=None, effects=(), **other):
    """Return a tree of random bodies on revolute and prismatic joints."""
    model, bodies = random_tree(rng, n_joints)
    return machine(model, bodies, friction, effects, **other)
