"""Joints that stop, stick and break loose, alone and coupled."""

import itertools

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa.model import with_bodies
from sklearn_vbjfa.simulation import simulate
from tests.simulation._machines import random_machine


def all_solutions(M, push, Fc):
    """Return accelerations from rest of every consistent combination of modes."""
    solutions = []
    for modes in itertools.product((-1, 0, 1), repeat=len(push)):
        modes = np.array(modes)
        free = np.flatnonzero(modes)
        a = np.zeros(len(push))
        if free.size:
            rhs = (push - Fc * modes)[free]
            a[free] = np.linalg.solve(M[np.ix_(free, free)], rhs)
        friction = push - M @ a
        held = np.abs(friction) <= Fc * (1 + 1e-9)
        if ((a * modes > 0) | ((modes == 0) & held)).all():
            solutions.append(a)
    return solutions


@pytest.mark.parametrize("n_joints", [2, 3, 4])
def test_breakaway_is_the_unique_consistent_solution(n_joints):
    several = 0
    for seed in range(100):
        rng = np.random.default_rng([n_joints, seed])
        Fc = rng.uniform(0, 30, n_joints)
        robot = random_machine(rng, n_joints, {"coulomb": Fc})
        q, tau = rng.normal(size=n_joints), 40 * rng.normal(size=n_joints)
        model = with_bodies(robot.model, robot.bodies)
        data, none = model.createData(), np.zeros(n_joints)
        bias = pin.rnea(model, data, q, none, none).copy()
        M = np.array(
            [pin.rnea(model, data, q, none, e) - bias for e in np.eye(n_joints)]
        )
        (expected,) = all_solutions(M, tau - bias, Fc)
        a = simulate(robot, tau[None], q)[0, 2 * n_joints :]
        size = 1 + np.abs(expected).max()
        np.testing.assert_allclose(a, expected, rtol=0, atol=1e-9 * size)
        assert ((a == 0) == (expected == 0)).all()
        several += 0 < (expected == 0).sum() < n_joints
    assert several > 20


def test_joints_at_rest_do_not_chatter():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        robot = random_machine(rng, 3, {"viscous": 2.0, "coulomb": 8.0})
        t = 0.01 * np.arange(150)
        tau = 20 * np.sin(np.outer(t, rng.uniform(3, 8, 3)) + rng.uniform(0, 6, 3))
        states = simulate(robot, tau, rng.normal(size=3))
        q, v, a = np.split(states, 3, axis=1)
        rests = v == 0
        assert (a[rests & np.roll(rests, 1, 0) & np.roll(rests, -1, 0)] == 0).all()
        both = rests[1:] & rests[:-1] & (a[1:] == 0) & (a[:-1] == 0)
        assert (q[1:][both] == q[:-1][both]).all()
        # Velocities reverse at most as often as the torques.
        for x, push in zip(v.T, tau.T):
            turns = (np.diff(np.sign(x[x != 0])) != 0).sum()
            assert turns <= 4 * (np.diff(np.sign(push)) != 0).sum() + 4
