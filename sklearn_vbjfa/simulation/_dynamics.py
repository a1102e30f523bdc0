"""Accelerations of an identified robot under given torques."""

from typing import NamedTuple

import numpy as np

from sklearn_vbjfa.model import describe, with_bodies
from sklearn_vbjfa.model._trees import concatenate_trees
from sklearn_vbjfa.simulation._terms import TermTable


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
    # that sticks, or that has none. signals: (name, t) -> value of what was recorded
    # beside the motion; values (5, nv), mass (nv, nv): what was found last, and the
    # inertias with rotors; compiled: module of compiled functions.

    def __init__(self, robot, signals=None):
        # Numba takes a second to import.
        from sklearn_vbjfa.simulation import _compiled

        self._signals = signals
        self.terms = terms = TermTable(robot)
        self.n_joints = robot.n_joints
        every = [(-np.inf, robot.bodies)]
        for instant, change in terms.payloads:
            bodies = every[-1][1].copy()
            bodies[-1] += change
            every.append((instant, bodies))
        self._tree = concatenate_trees([describe(robot.model), *terms.trees])
        self._loaded = []
        for instant, bodies in every:
            # Bodies without a mass are refused.
            with_bodies(robot.model, bodies)
            self._loaded.append((instant, np.vstack([bodies, *terms.following])))
        # Times [s] at which the bodies change.
        self.instants = tuple(instant for instant, _ in every[1:])
        self._load_bodies = np.zeros_like(self._loaded[0][1])
        self._load_bodies[: self.n_joints] = (robot.load or robot).bodies
        self.set_bodies(-np.inf)
        self._loads = terms.of_load
        self.compiled = _compiled
        self._set(np.zeros((5, self.n_joints)), None)
        self._remembers = bool(terms.remembers.any())
        self.start(np.zeros(self.n_joints))

    # -- what changes with time and with what was done before --------------------------

    def start(self, q):
        """Begin a motion at positions q (nv,), with the memory of a joint at rest."""
        self._table = table = self.terms.table(q)
        self._own = table.kinds, table.joints, table.numbers, table.memory

    def set_time(self, t):
        """Set torques that change with time to what they are at t [s]."""
        if self.terms.is_timed:
            self.terms.set_levels(self._own[2], t, self._signals)

    def set_bodies(self, t):
        """Set the bodies to what they are at t [s]."""
        bodies = [own for own in self._loaded if t >= own[0]][-1][1]
        self._robot = self._tree, bodies, self.terms.armature, self._load_bodies
        self._plain = tuple(self._tree), *self._robot[1:]

    def remember(self, q, v):
        """Move memory on to a state q, v (nv,), to which no joint turned round."""
        if self._remembers:
            self.compiled.remember(*self._own, q, v)

    # -- accelerations -----------------------------------------------------------------

    def _set(self, found, mass):
        self.values, self.found, self.mass = found, StateSolution(*found), mass

    def accelerate(self, q, v, tau, mode, stuck):
        """Find the accelerations (nv,) under true torques tau, by modes of friction."""
        # mode (nv,): signs of dry friction; stuck (nv,): joints that stick.
        nv, (tree, bodies, armature, loaded) = self.n_joints, self._robot
        M, h = np.empty((nv, nv)), np.empty(nv)
        self.compiled.bodies_at(q, v, tree, bodies, armature, M, h)
        ML, hL = M, h
        if self._loads:
            ML, hL = np.empty((nv, nv)), np.empty(nv)
            self.compiled.bodies_at(q, v, tree, loaded, np.zeros(nv), ML, hL)
        out, state = np.empty((5, nv)), (ML, hL, tau, q, v, mode, stuck)
        self.compiled.accelerate(M, h, *state, self._table, self.found.a, out)
        self._set(out, M)
        return self.found.a

    def explicit_step(self, q, v, a, *step):
        """Do a compiled step; (q, v, a, error) at its end."""
        # Arguments are those of `explicit_step` in `_compiled`, but the robot.
        own = *step, (*self._robot, self._table)
        q, v, error, found, mass = self.compiled.explicit_step(q, v, a, *own)
        self._set(found, mass)
        return q, v, self.found.a, error

    def smooth_steps(self, q, v, *rest):
        """Do compiled steps; see `smooth_steps` in `_compiled`."""
        own = *self._plain, tuple(self._table)
        q, v, found, mass, *rest = self.compiled.smooth_steps(q, v, *rest, *own)
        self._set(found, mass)
        return q, v, *rest
