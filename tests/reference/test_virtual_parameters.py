"""Virtual parameters of eq. 30: the map, and non-convexity of eq. 35 in them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sklearn_vbjfa.physical import is_consistent
from tests.physical._problems import parameters_of, point_masses
from tests.reference.virtual_parameters import (
    inertial_from_virtual,
    virtual_from_inertial,
)

seeds = st.integers(0, 2**31 - 1)
properties = settings(derandomize=True, deadline=None, max_examples=30)


@properties
@given(seeds)
def test_eq30_encodes_a_body(seed):
    points, masses = point_masses(np.random.default_rng(seed))
    phi = parameters_of(points, masses)
    virtual = virtual_from_inertial(phi)
    np.testing.assert_allclose(virtual[0] ** 2, masses.sum())
    np.testing.assert_allclose(virtual[1:4], masses @ points / masses.sum())
    np.testing.assert_allclose(
        inertial_from_virtual(virtual), phi, rtol=1e-12, atol=1e-13
    )
    # The paper prints theta_1 = theta_1 hat: the root of the mass instead of the mass.
    assert abs(virtual[0] - phi[0]) > 1e-3
    # A factor and its negative give the same body.
    np.testing.assert_allclose(
        inertial_from_virtual(virtual * [-1, 1, 1, 1, *[-1] * 6]), phi, atol=1e-12
    )


@properties
@given(seeds)
def test_any_virtual_parameters_give_a_consistent_body(seed):
    v = np.random.default_rng(seed).normal(size=(20, 10))
    assert is_consistent(inertial_from_virtual(v), "eq30", margin=-1e-12).all()
    # The paper calls masses strictly positive.
    assert not inertial_from_virtual(np.zeros(10)).any()


def test_projection_is_not_convex_in_virtual_parameters():
    # Two bodies with equal first moment: m c = 1 is a curved set of (sqrt(m), c).
    light = np.array([1.0, 1.0, 0, 0, 1, 0, 0, 1, 0, 1])
    heavy = np.array([2.0, 0.25, 0, 0, 1, 0, 0, 1, 0, 1])
    target = inertial_from_virtual(light)

    def objective(virtual, weights):
        return 0.5 * weights @ (inertial_from_virtual(virtual) - target) ** 2

    first_moment = np.eye(10)[1]
    assert objective(light, first_moment) == objective(heavy, first_moment) == 0.0
    # sqrt(m) = 1.5 and c = 0.625 give m c = 1.40625.
    middle = 0.5 * (light + heavy)
    assert objective(middle, first_moment) == pytest.approx(0.5 * 0.40625**2)
    # The same with a weight on every parameter.
    weights = first_moment + 1e-3
    chord = 0.5 * (objective(light, weights) + objective(heavy, weights))
    assert objective(middle, weights) > chord + 0.05
