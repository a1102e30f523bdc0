"""Derivatives by the geometry against differences of Pinocchio's inverse dynamics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

pin = pytest.importorskip("pinocchio")

from sklearn_vbjfa.model import TorqueDerivatives  # noqa: E402
from tests.model._trees import ALIGNED, OBLIQUE, build, by_sample  # noqa: E402

KINDS = (*ALIGNED, *OBLIQUE, "HY", "HelicalUnaligned")
STEP = 1e-5

trees = st.lists(st.sampled_from(KINDS), min_size=1, max_size=6)
seeds = st.integers(0, 2**32 - 1)


def torques(model, states, inertial):
    """Torques (n, nv) of bodies that need not be possible."""
    Phi = by_sample(model, *states)
    return np.einsum("njic,ic->nj", Phi, inertial)


def by_difference(model, states, inertial, change):
    """Differentiate by a number that `change` (model, positions, number) puts in."""
    made = []
    for number in (STEP, -STEP):
        q, v, a = (x.copy() for x in states)
        other = model.copy()
        change(other, q, number)
        made.append(torques(other, (q, v, a), inertial))
    return (made[0] - made[1]) / (2 * STEP)


def turn(joint, axis):
    def change(model, q, angle):
        placement = model.jointPlacements[joint + 1]
        placement.rotation = placement.rotation @ pin.exp3(angle * np.eye(3)[axis])

    return change


def move(joint):
    def change(model, q, shift):
        q[:, joint] += shift

    return change


def pull(axis):
    def change(model, q, size):
        model.gravity.linear = model.gravity.linear + size * np.eye(3)[axis]

    return change


def problem(kinds, seed, n=3, parents=None):
    """Tree, states and bodies that no mass distribution has."""
    rng = np.random.default_rng(seed)
    model = build(rng, kinds, parents)
    states = rng.uniform(-2.0, 2.0, size=(3, n, model.nv))
    return model, states, rng.normal(size=(model.nv, 10))


def assert_near(found, expected, size):
    assert found.shape == expected.shape
    assert_allclose(found, expected, atol=1e-7 * size)


@settings(max_examples=60, deadline=None)
@given(kinds=trees, seed=seeds)
def test_of_random_trees_are_those_of_differences(kinds, seed):
    model, states, inertial = problem(kinds, seed)
    made = TorqueDerivatives(model, *states, inertial)
    expected = {
        "turn": [
            np.stack(
                [by_difference(model, states, inertial, turn(j, k)) for k in range(3)],
                axis=2,
            )
            for j in range(model.nv)
        ],
        "position": [
            by_difference(model, states, inertial, move(j)) for j in range(model.nv)
        ],
        "gravity": np.stack(
            [by_difference(model, states, inertial, pull(k)) for k in range(3)], axis=2
        ),
    }
    size = max(np.abs(x).max() for x in [*expected["turn"], *expected["position"], 1.0])
    for j in range(model.nv):
        assert_near(made.by_turn(j), expected["turn"][j], size)
        assert_near(made.by_position(j), expected["position"][j], size)
    assert_near(made.by_gravity(), expected["gravity"], size)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("parents", [[0, 1, 2], [0, 1, 1], [0, 0, 2]])
def test_by_position_is_pinocchios_at_every_place(kind, parents):
    """With possible bodies, against the analytic derivatives."""
    rng = np.random.default_rng(len(kind))
    for place in range(3):
        kinds = [*rng.choice(KINDS, size=3)]
        kinds[place] = kind
        model, states, _ = problem(kinds, place, parents=parents)
        for i in range(1, model.njoints):
            model.inertias[i] = pin.Inertia.Random()
        inertial = np.array([b.toDynamicParameters() for b in model.inertias[1:]])
        made = TorqueDerivatives(model, *states, inertial)
        data = model.createData()
        for i, state in enumerate(zip(*states)):
            pin.computeRNEADerivatives(model, data, *state)
            size = np.abs(data.dtau_dq).max() + 1.0
            for j in range(3):
                assert_allclose(
                    made.by_position(j)[i], data.dtau_dq[:, j], atol=1e-10 * size
                )


def test_a_base_that_turns_is_part_of_gravity():
    model, states, inertial = problem(["RZ", "PX", "RevoluteUnaligned", "HY"], 4)
    model.gravity = pin.Motion(np.random.default_rng(4).normal(size=6))
    made = TorqueDerivatives(model, *states, inertial)
    for j in range(4):
        found = made.by_position(j)
        expected = by_difference(model, states, inertial, move(j))
        assert_near(found, expected, np.abs(expected).max() + 1.0)
        for k in range(3):
            expected = by_difference(model, states, inertial, turn(j, k))
            assert_near(
                made.by_turn(j)[:, :, k], expected, np.abs(expected).max() + 1.0
            )


@settings(max_examples=20, deadline=None)
@given(kinds=trees, seed=seeds, factor=st.floats(-10.0, 10.0))
def test_are_linear_in_the_bodies(kinds, seed, factor):
    model, states, one = problem(kinds, seed)
    other = np.random.default_rng(seed + 1).normal(size=one.shape)

    def made(inertial):
        found = TorqueDerivatives(model, *states, inertial)
        turns = [found.by_turn(j) for j in range(model.nv)]
        positions = [found.by_position(j)[:, :, None] for j in range(model.nv)]
        return np.concatenate([*turns, *positions, found.by_gravity()], axis=2)

    size = (np.abs(made(one)).max() + np.abs(made(other)).max()) * 10 + 1.0
    assert_allclose(
        made(one + factor * other), made(one) + factor * made(other), atol=1e-12 * size
    )


def test_torque_is_linear_in_gravity():
    """What gravity does is its derivative times gravity, at rest."""
    model, (q, v, a), inertial = problem(["RX", "PZ", "RevoluteUnaligned"], 3)
    still = (q, 0 * v, 0 * a)
    made = TorqueDerivatives(model, *still, inertial)
    held = made.by_gravity() @ model.gravity.linear
    assert_allclose(held, torques(model, still, inertial), atol=1e-12)


def test_joints_of_another_branch_feel_nothing():
    model, states, inertial = problem(["RX", "RY", "PZ", "RZ"], 1, parents=[0, 1, 0, 3])
    made = TorqueDerivatives(model, *states, inertial)
    for joint, strangers in ((0, [2, 3]), (1, [2, 3]), (2, [0, 1]), (3, [0, 1])):
        assert_array_equal(made.by_turn(joint)[:, strangers], 0.0)
        assert_array_equal(made.by_position(joint)[:, strangers], 0.0)
        assert np.abs(made.by_turn(joint)).max() > 0.1


def test_pieces_of_a_motion_do_not_depend_on_each_other():
    # More samples than go through together.
    model, states, inertial = problem(["RX", "PY", "RZ"], 2, n=1500)
    whole = TorqueDerivatives(model, *states, inertial)
    rows = slice(900, 1300)
    piece = TorqueDerivatives(model, *(x[rows] for x in states), inertial)
    for j in range(3):
        for by in ("by_turn", "by_position"):
            found, expected = getattr(piece, by)(j), getattr(whole, by)(j)[rows]
            assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    assert_allclose(piece.by_gravity(), whole.by_gravity()[rows], atol=1e-12)


def test_knows_the_robot_before_and_after():
    model, states, inertial = problem(["RX", "PY"], 5)
    other = model.copy()
    turn(1, 0)(other, None, 0.1)
    other.gravity.linear = np.array([1.0, 2.0, 3.0])
    made = TorqueDerivatives(other, *states, inertial, model)
    assert_array_equal(made.rotation(1), other.jointPlacements[2].rotation)
    assert_array_equal(made.nominal_rotation(1), model.jointPlacements[2].rotation)
    assert_array_equal(made.nominal_gravity, model.gravity.linear)
    assert_allclose(made.axis(0), [1.0, 0.0, 0.0])
    assert_allclose(made.axis(1), [0.0, 1.0, 0.0])
    alone = TorqueDerivatives(other, *states, inertial)
    assert_array_equal(alone.nominal_rotation(1), alone.rotation(1))
    assert_array_equal(alone.nominal_gravity, other.gravity.linear)
