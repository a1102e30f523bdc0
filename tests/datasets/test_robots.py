"""The head and the arm of the paper: trees with plausible bodies."""

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

from sklearn_vbjfa.datasets import load_arm_model, load_head_model  # noqa: E402
from sklearn_vbjfa.physical import (  # noqa: E402
    body_scales,
    is_consistent,
    min_eigenvalue,
)

ROBOTS = [(load_head_model, 7, (0, 1, 2, 3, 4, 3, 6))]
ROBOTS += [(load_arm_model, 10, (0, 1, 2, 3, 4, 5, 6, 7, 7, 7))]


@pytest.mark.parametrize(("load", "nv", "parents"), ROBOTS)
def test_robots_are_trees_of_the_size_said(load, nv, parents):
    model = load()
    assert (model.nq, model.nv) == (nv, nv)
    assert tuple(model.parents)[1:] == parents
    assert load() is not load()


@pytest.mark.parametrize(("load", "nv", "parents"), ROBOTS)
def test_bodies_are_consistent_and_not_on_the_edge(load, nv, parents):
    bodies = np.array([body.toDynamicParameters() for body in load().inertias[1:]])
    assert is_consistent(bodies).all()
    mass, length = body_scales(bodies)
    # a rod of 9 cm by 2 cm, the thinnest finger, has 8e-3
    assert min_eigenvalue(bodies, mass_scale=mass, length_scale=length).min() > 5e-3
    assert bodies[:, 0].min() > 0.05
    assert bodies[:, 0].max() < 5.0


@pytest.mark.parametrize(("load", "nv", "parents"), ROBOTS)
def test_limits_contain_the_zero_and_the_load(load, nv, parents):
    model = load()
    assert (model.lowerPositionLimit < 0).all()
    assert (model.upperPositionLimit > 0).all()
    assert (model.velocityLimit > 0).all()
    data = model.createData()
    rng = np.random.default_rng(0)
    for _ in range(50):
        q = rng.uniform(model.lowerPositionLimit, model.upperPositionLimit)
        weight = pin.computeGeneralizedGravity(model, data, q)
        assert (np.abs(weight) < 0.5 * model.effortLimit).all()
