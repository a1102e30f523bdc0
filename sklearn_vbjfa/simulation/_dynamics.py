"""Accelerations of an identified robot under given torques."""

from typing import NamedTuple

import numpy as np

from sklearn_vbjfa.model import describe, with_bodies
from sklearn_vbjfa.model._trees import concatenate_trees
from sklearn_vbjfa.simulation._terms import TermTable


class StateSolution(NamedTuple):
    """Results of forward dynamics at one state, by joint (nv,)."""

    a: np.ndarray  # accelerations
    needed: np.ndarray  # dry friction needed to hold a sticking joint
    limit: np.ndarray  # largest dry friction
    # derivatives of the smooth torques by the joint's own position and velocity
    by_position: np.ndarray
    by_velocity: np.ndarray


def _all_bodies(robot, parameters):
    """Bodies (n, 10) of all joints of a `TorqueModel`, by its parameters or `Load`."""
    pairs = zip(robot.effects, parameters.coefficients)
    rows = [effect.bodies(coef) for effect, coef in pairs if effect.loads]
    return np.vstack([parameters.bodies, *rows])


class ForwardDynamics:
    """Accelerations of a `TorqueModel`, with its friction, one state at a time."""

    # Modes of dry friction: -1 or 1 (direction) for a sliding joint, 0 for one that
    # sticks, or has no dry friction. signals: (name, t) -> value of a recorded
    # signal; values (5, nv), solution: last results, as array and `StateSolution`; mass
    # (nv, nv): inertia matrix with rotors; compiled: module of compiled functions.

    def __init__(self, robot, signals=None):
        # Numba takes a second to import.
        from sklearn_vbjfa.simulation import _compiled

        self._signals = signals
        self.terms = terms = TermTable(robot)
        self.n_joints = robot.n_joints
        followers = (effect.tree() for effect in robot.effects if effect.loads)
        self._tree = concatenate_trees([describe(robot.model), *followers])
        bodies, self._timed_bodies = _all_bodies(robot, robot), []
        for instant, joint, change in [(-np.inf, 0, 0.0), *terms.payloads]:
            bodies[joint] += change
            # Rejects bodies without mass.
            with_bodies(robot.model, bodies[: self.n_joints])
            self._timed_bodies.append((instant, bodies.copy()))
        # Times [s] at which the bodies change.
        self.instants = tuple(instant for instant, _ in self._timed_bodies[1:])
        self._load_bodies = _all_bodies(robot, robot.load or robot)
        self.set_bodies(-np.inf)
        self._loads = terms.of_load
        self.compiled = _compiled
        self._set(np.zeros((5, self.n_joints)), None)
        self._remembers = bool(terms.has_memory.any())
        self.start(np.zeros(self.n_joints))

    def start(self, q):
        """Begin a motion at positions q (nv,), with the memory of a joint at rest."""
        self._table = table = self.terms.table(q)
        self._term_arrays = table.kinds, table.joints, table.numbers, table.memory

    def set_time(self, t):
        """Set torques that change with time to what they are at t [s]."""
        if self.terms.is_timed:
            self.terms.set_levels(self._term_arrays[2], t, self._signals)

    def set_bodies(self, t):
        bodies = [pair for pair in self._timed_bodies if t >= pair[0]][-1][1]
        self._robot = self._tree, bodies, self.terms.armature, self._load_bodies
        self._robot_arrays = tuple(self._tree), *self._robot[1:]

    def remember(self, q, v):
        """Update the memory to a state q, v (nv,), reached without a reversal."""
        if self._remembers:
            self.compiled.remember(*self._term_arrays, q, v)

    def _set(self, values, mass):
        self.values, self.solution, self.mass = values, StateSolution(*values), mass

    def accelerate(self, q, v, tau, mode, stuck):
        """Compute the accelerations (nv,) under true torques, for modes of friction."""
        # tau, mode, stuck (nv,): true torques, signs of dry friction, sticking joints.
        nv, (tree, bodies, armature, loaded) = self.n_joints, self._robot
        M, h = np.empty((nv, nv)), np.empty(nv)
        self.compiled.bodies_at(q, v, tree, bodies, armature, M, h)
        ML, hL = M, h
        if self._loads:
            ML, hL = np.empty((nv, nv)), np.empty(nv)
            self.compiled.bodies_at(q, v, tree, loaded, np.zeros(nv), ML, hL)
        out, state = np.empty((5, nv)), (ML, hL, tau, q, v, mode, stuck)
        self.compiled.accelerate(M, h, *state, self._table, self.solution.a, out)
        self._set(out, M)
        return self.solution.a

    def explicit_step(self, q, v, a, *step):
        """Take a compiled step; return (q, v, a, error) at its end."""
        # Arguments are those of `explicit_step` in `_compiled`, without the robot.
        arguments = *step, (*self._robot, self._table)
        q, v, error, values, mass = self.compiled.explicit_step(q, v, a, *arguments)
        self._set(values, mass)
        return q, v, self.solution.a, error

    def smooth_steps(self, q, v, *rest):
        """Take compiled steps; see `smooth_steps` in `_compiled`."""
        robot = *self._robot_arrays, tuple(self._table)
        q, v, values, mass, *rest = self.compiled.smooth_steps(q, v, *rest, *robot)
        self._set(values, mass)
        return q, v, *rest
