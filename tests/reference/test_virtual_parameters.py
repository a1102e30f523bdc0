"""Virtual parameters of eq. 30: the map, its derivatives, its inverse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sklearn_vbjfa.physical import (
    PhysicalProjector,
    ProjectionError,
    is_consistent,
)
from sklearn_vbjfa.physical._pseudo_inertia import spatial_inertia
from tests.physical._problems import metric, parameters_of, point_masses, robot
from tests.reference import descent_projector
from tests.reference.descent_projector import DescentProjector
from tests.reference.virtual_parameters import (
    inertial_from_virtual,
    virtual_curvature,
    virtual_from_inertial,
    virtual_jacobian,
)

seeds = st.integers(0, 2**31 - 1)
properties = settings(derandomize=True, deadline=None, max_examples=30)


@properties
@given(seeds)
def test_map_is_the_parallel_axis_theorem(seed):
    v = np.random.default_rng(seed).normal(size=10)
    mass, centre = v[0] ** 2, v[1:4]
    U = np.zeros((3, 3))
    U[np.triu_indices(3)] = v[4:]
    inertia = U.T @ U + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    rows, columns = [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    expected = np.r_[mass, mass * centre, inertia[rows, columns]]
    np.testing.assert_allclose(inertial_from_virtual(v), expected, rtol=0, atol=1e-12)


@properties
@given(seeds)
def test_round_trip_from_consistent_parameters(seed):
    phi = parameters_of(*point_masses(np.random.default_rng(seed)))
    np.testing.assert_allclose(
        inertial_from_virtual(virtual_from_inertial(phi)), phi, rtol=1e-12, atol=1e-13
    )


@properties
@given(seeds)
def test_round_trip_from_virtual_parameters(seed):
    v = np.random.default_rng(seed).normal(size=10)
    # A factor and its negative give the same body: the inverse returns the positive.
    v[[0, 4, 7, 9]] = np.abs(v[[0, 4, 7, 9]]) + 0.1
    np.testing.assert_allclose(
        virtual_from_inertial(inertial_from_virtual(v)), v, rtol=1e-6, atol=1e-7
    )


@properties
@given(seeds)
def test_any_virtual_parameters_give_a_body_of_the_set(seed):
    v = np.random.default_rng(seed).normal(size=(20, 10))
    assert is_consistent(inertial_from_virtual(v), "eq30", margin=-1e-12).all()


@properties
@given(seeds)
def test_jacobian_is_the_central_difference(seed):
    v = np.random.default_rng(seed).normal(size=10)
    step = 1e-5
    # The map is of degree four: the central difference errs by O(step^2).
    numerical = np.column_stack(
        [
            (inertial_from_virtual(v + step * e) - inertial_from_virtual(v - step * e))
            / (2 * step)
            for e in np.eye(10)
        ]
    )
    np.testing.assert_allclose(virtual_jacobian(v), numerical, rtol=1e-7, atol=1e-8)


@properties
@given(seeds)
def test_curvature_is_the_difference_of_the_gradient(seed):
    rng = np.random.default_rng(seed)
    v, gradient = rng.normal(size=(2, 10))
    step = 1e-5
    numerical = np.column_stack(
        [
            (virtual_jacobian(v + step * e) - virtual_jacobian(v - step * e)).T
            @ gradient
            / (2 * step)
            for e in np.eye(10)
        ]
    )
    np.testing.assert_allclose(
        virtual_curvature(v, gradient), numerical, rtol=1e-6, atol=1e-7
    )


def test_printed_first_line_of_eq30_is_false():
    # The paper prints theta_1 = theta_1 hat.  With the other lines as printed, a point
    # mass of 4 kg at 1 m would then have the mass 2 and the first moment 4.
    v = np.array([2.0, 1.0, 0, 0, 0, 0, 0, 0, 0, 0])
    phi = inertial_from_virtual(v)
    assert phi[0] == 4.0
    printed = phi.copy()
    printed[0] = v[0]
    assert printed[1] / printed[0] != v[1]
    assert phi[1] / phi[0] == v[1]


def test_map_and_derivatives_broadcast():
    rng = np.random.default_rng(0)
    v, gradient = rng.normal(size=(2, 4, 3, 10))
    np.testing.assert_allclose(
        inertial_from_virtual(v)[2, 1], inertial_from_virtual(v[2, 1])
    )
    np.testing.assert_allclose(virtual_jacobian(v)[2, 1], virtual_jacobian(v[2, 1]))
    np.testing.assert_allclose(
        virtual_curvature(v, gradient)[2, 1], virtual_curvature(v[2, 1], gradient[2, 1])
    )


@pytest.mark.parametrize(
    ("phi", "message"),
    [
        ([-1, 0, 0, 0, 1, 0, 1, 0, 0, 1], "positive masses alone; the smallest mass"),
        ([1, 2, 0, 0, 1, 0, 1, 0, 0, 1], "inertia at the centre of mass is positive"),
    ],
)
def test_inconsistent_parameters_have_no_virtual_ones(phi, message):
    with pytest.raises(ValueError, match=message):
        virtual_from_inertial(np.array(phi, dtype=float))


def test_wrong_shape_is_named():
    with pytest.raises(ValueError, match=r"10 virtual parameters.*shape \(11,\)"):
        inertial_from_virtual(np.ones(11))


# -- the minimisation in them


def inconsistent_robot(rng, n_bodies):
    theta = robot(rng, n_bodies)
    return theta + 0.5 * rng.normal(size=theta.size) * (np.abs(theta) + 0.2)


@settings(properties, max_examples=6)
@given(seeds, st.sampled_from([1.0, 1e4]))
def test_virtual_parameters_reach_the_convex_optimum(seed, condition):
    rng = np.random.default_rng(seed)
    theta = inconsistent_robot(rng, 2)
    A = metric(rng, theta.size, condition)
    rows = theta[None]
    (virtual,) = DescentProjector("eq30", metric=A).fit_transform(rows)
    (convex,) = PhysicalProjector("eq30", metric=A).fit_transform(rows)
    squared = [(x - theta) @ A @ (x - theta) for x in (virtual, convex)]
    assert squared[0] == pytest.approx(squared[1], rel=1e-5)
    np.testing.assert_allclose(virtual, convex, atol=1e-2)
    M = spatial_inertia(virtual.reshape(2, 11)[:, :10])
    assert (np.linalg.eigvalsh(M)[:, 0] > 0).all()


def test_unfinished_descent_raises(monkeypatch):
    monkeypatch.setattr(descent_projector, "_STEPS", 1)
    rows = inconsistent_robot(np.random.default_rng(0), 3)[None]
    projector = DescentProjector("eq30").fit(rows)
    with pytest.raises(ProjectionError, match=r"virtual parameters of eq\. 30 failed"):
        projector.transform(rows)
