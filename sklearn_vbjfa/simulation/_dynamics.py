"""Accelerations of an identified robot under given torques."""

from typing import NamedTuple

import numpy as np

from sklearn_vbjfa.model import describe, import_pinocchio
from sklearn_vbjfa.simulation._terms import TermTable


def import_compiled():
    """Return the module of compiled functions."""
    try:
        from sklearn_vbjfa.simulation import _compiled
    except ImportError as error:
        if error.name != "numba":
            raise
        raise ImportError(
            "Simulations need Numba, which is not installed: "
            'pip install "sklearn-vbjfa[robot]".'
        ) from error
    return _compiled


def with_bodies(model, bodies, armature=None):
    """Return a copy of a model with other bodies (nv, 10) and rotor inertias (nv,)."""
    pin = import_pinocchio()
    out = model.copy()
    for j, body in enumerate(bodies):
        if not body[0] > 0:
            raise ValueError(
                f"The body of {model.names[j + 1]} has the mass {body[0]:.6g} kg: only "
                "physically consistent parameters can be simulated. Identify with "
                'projector="default".'
            )
        out.inertias[j + 1] = pin.Inertia.FromDynamicParameters(body)
    out.armature = np.zeros(model.nv) if armature is None else np.asarray(armature)
    return out


def without_limits(model):
    """Return a copy of a model whose joints may go anywhere."""
    out = model.copy()
    out.lowerPositionLimit = np.full(model.nv, -np.inf)
    out.upperPositionLimit = np.full(model.nv, np.inf)
    return out


class StateSolution(NamedTuple):
    """What is found at one state, of each joint (nv,)."""

    a: np.ndarray  # accelerations
    needed: np.ndarray  # dry friction that would hold a joint that sticks
    limit: np.ndarray  # largest dry friction
    # derivatives of the smooth torques by the joint's own position and velocity
    by_position: np.ndarray
    by_velocity: np.ndarray


class ForwardDynamics:
    """Accelerations of a `TorqueModel`, with its friction, one state at a time."""

    # Dry friction acts by modes: -1 or 1 for a joint that slides that way, 0 for one
    # that sticks, whose acceleration is zero, or that has none. signals: (name, t) ->
    # value of what was recorded beside the motion; power: of all torques that need not
    # dissipate [W], such as of drives and springs; mass (nv, nv): rotors included;
    # compiled: module of compiled functions.

    def __init__(self, robot, signals=None):
        pin = import_pinocchio()
        self._pin, self._signals = pin, signals
        known = {} if signals is None else signals.at(0.0)
        self.terms = terms = TermTable(robot, known)
        self.n_joints = robot.n_joints
        every = [(-np.inf, robot.bodies)]
        for instant, change in terms.payloads:
            bodies = every[-1][1].copy()
            bodies[-1] += change
            every.append((instant, bodies))
        self._loaded = [
            (instant, bodies, with_bodies(robot.model, bodies, terms.armature))
            for instant, bodies in every
        ]
        self.model = self._loaded[0][2]
        self._data = self.model.createData()
        self._load_bodies = robot.bodies if robot.load is None else robot.load.bodies
        self._tree = describe(self.model)
        self._set_robot(robot.bodies)
        self._loads = terms.of_load
        self.compiled = import_compiled()
        self.found = StateSolution(*np.zeros((5, self.n_joints)))
        self.power, self.mass, self._time = 0.0, None, 0.0
        self._remembers = bool(terms.remembers.any())
        self.start(np.zeros(self.n_joints))

    # -- what changes with time and with what was done before --------------------------

    @property
    def changes(self):
        """Whether its torques change with time."""
        return self.terms.is_timed or self.terms.others is not None

    @property
    def instants(self):
        """Times [s] at which its bodies change, tuple of float."""
        return tuple(instant for instant, _, _ in self._loaded[1:])

    def start(self, q):
        """Begin a motion at positions q (nv,), with the memory of a joint at rest."""
        self._table = table = self.terms.table(q)
        self._own = table.kinds, table.joints, table.numbers, table.memory

    def set_time(self, t):
        """Set torques that change with time to what they are at t [s]."""
        self._time = t
        if self.terms.is_timed:
            self.terms.set_levels(self._own[2], t, self._signals)

    def set_bodies(self, t):
        """Set the bodies to what they are at t [s]."""
        _, bodies, model = [own for own in self._loaded if t >= own[0]][-1]
        if model is not self.model:
            self.model, self._data = model, model.createData()
            self._set_robot(bodies)

    def _set_robot(self, bodies):
        self._robot = self._tree, bodies, self.terms.armature, self._load_bodies

    def remember(self, q, v):
        """Move memory on to a state q, v (nv,), to which no joint turned round."""
        if self._remembers:
            self.compiled.remember(*self._own, q, v)

    def potential_energy(self, q):
        """Potential energy of the bodies at positions q (nv,) [J]."""
        return self._pin.computePotentialEnergy(self.model, self._data, q)

    def kinetic_energy(self, v):
        """Kinetic energy by the inertia matrix found last [J]."""
        return 0.5 * float(v @ self.mass @ v)

    # -- accelerations -----------------------------------------------------------------

    def accelerate(self, q, v, tau, mode, stuck):
        """Find the accelerations (nv,) under true torques tau, by modes of friction."""
        # mode (nv,): signs of dry friction; stuck (nv,): joints that stick.
        nv, (tree, bodies, armature, loaded) = self.n_joints, self._robot
        M, h = np.empty((nv, nv)), np.empty(nv)
        self.compiled.bodies_at(q, v, tree, bodies, armature, M, h)
        self.mass, ML, hL = M, M, h
        if self._loads:
            ML, hL = np.empty((nv, nv)), np.empty(nv)
            self.compiled.bodies_at(q, v, tree, loaded, np.zeros(nv), ML, hL)
        torque = np.zeros(nv)
        if self.terms.others is not None:
            known = {} if self._signals is None else self._signals.at(self._time)
            torque = self.terms.others.torque(q, v, self._time, known)
        out, state = np.empty((5, nv)), (ML, hL, tau, q, v, mode, stuck)
        power = self.compiled.accelerate(
            M, h + torque, *state, self._table, self.found.a, out
        )
        self.found, self.power = StateSolution(*out), power - float(torque @ v)
        return self.found.a

    def explicit_step(self, q, v, a, power, *step):
        """Do a compiled step; (q, v, work, (a, power), error) at its end."""
        # Arguments are those of `explicit_step` in `_compiled`, but the robot.
        own = *step, *self._robot, self._table
        q, v, work, self.power, error, found, self.mass = self.compiled.explicit_step(
            q, v, a, power, *own
        )
        self.found = StateSolution(*found)
        return q, v, work, (self.found.a, self.power), error
