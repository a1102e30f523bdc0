"""A robot as the text of a URDF: what is built from it is the same robot."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sklearn_vbjfa.model import (
    description_text,
    in_order,
    joint_names,
    load_folded,
    load_text,
)
from tests.effects._arms import inverse_dynamics
from tests.model._robots import random_body
from tests.model._trees import ALIGNED, OBLIQUE, build, make_joint


def with_bodies(model, rng):
    for j in range(model.nv):
        body = pin.Inertia.FromDynamicParameters(random_body(rng))
        model.inertias[j + 1] = body
    return model


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 99),
    kinds=st.lists(st.sampled_from(ALIGNED + OBLIQUE), min_size=1, max_size=6),
)
def test_a_written_tree_is_the_same_robot(seed, kinds):
    rng = np.random.default_rng(seed)
    model = with_bodies(build(rng, kinds), rng)
    read = in_order(
        load_text(description_text(load_folded(model)), "x.json"), joint_names(model)
    )
    read.gravity = model.gravity
    assert joint_names(read) == joint_names(model)
    states = rng.normal(size=(5, 3, model.nv))
    expected = inverse_dynamics(model, states)
    np.testing.assert_allclose(
        inverse_dynamics(read, states), expected, atol=1e-12 * np.abs(expected).max()
    )


def test_branches_in_another_order():
    rng = np.random.default_rng(3)
    model = pin.Model()
    joints = {}
    for name, parent in [("z", None), ("y", "z"), ("b", None), ("a", "y"), ("c", "b")]:
        number = joints.get(parent, 0)
        placed = pin.SE3(np.eye(3), rng.normal(size=3))
        joints[name] = model.addJoint(number, make_joint("RX", rng), placed, name)
    with_bodies(model, rng)
    read = load_text(description_text(load_folded(model)), "x.json")
    assert joint_names(read) == joint_names(model)
    ordered = in_order(read, joint_names(model))
    assert joint_names(ordered) == joint_names(model)
    states = rng.normal(size=(5, 3, 5))
    np.testing.assert_allclose(
        inverse_dynamics(ordered, states), inverse_dynamics(model, states)
    )
    # The frames are carried by the same joints as before.
    carried = {f.name: read.names[f.parentJoint] for f in read.frames}
    assert {f.name: ordered.names[f.parentJoint] for f in ordered.frames} == carried
    with pytest.raises(ValueError, match="not those of the robot"):
        in_order(read, ("b", "c", "z", "y", "q"))
    with pytest.raises(ValueError, match="a comes before"):
        in_order(read, ("a", "b", "c", "z", "y"))
