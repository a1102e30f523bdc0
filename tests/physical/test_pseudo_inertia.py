"""Inertial parameters as matrices: definitions, inverses, units."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sklearn_vbjfa.physical import (
    body_scales,
    inertial_parameters,
    is_consistent,
    pseudo_inertia,
)
from sklearn_vbjfa.physical._pseudo_inertia import (
    constraint_matrix,
    parameter_units,
    spatial_inertia,
)
from tests.physical._problems import literal_matrix, parameters_of, point_masses

seeds = st.integers(0, 2**31 - 1)
properties = settings(derandomize=True, deadline=None, max_examples=30)


@properties
@given(seeds)
def test_pseudo_inertia_of_point_masses_is_the_sum_of_outer_products(seed):
    points, masses = point_masses(np.random.default_rng(seed))
    homogeneous = np.c_[points, np.ones(len(points))]
    direct = sum(m * np.outer(r, r) for m, r in zip(masses, homogeneous))
    np.testing.assert_allclose(
        pseudo_inertia(parameters_of(points, masses)), direct, rtol=0, atol=1e-13
    )


@properties
@given(seeds)
def test_spatial_inertia_is_the_kinetic_energy_of_the_point_masses(seed):
    rng = np.random.default_rng(seed)
    points, masses = point_masses(rng)
    angular, linear = rng.normal(size=(2, 3))
    velocity = linear + np.cross(angular, points)
    energy = np.sum(masses * np.sum(velocity**2, axis=1))
    M = spatial_inertia(parameters_of(points, masses))
    motion = np.r_[angular, linear]
    assert motion @ M @ motion == pytest.approx(energy, rel=1e-12)


@properties
@given(seeds)
def test_inertial_parameters_undo_pseudo_inertia(seed):
    phi = np.random.default_rng(seed).normal(size=(3, 2, 10))
    np.testing.assert_allclose(
        inertial_parameters(pseudo_inertia(phi)), phi, rtol=0, atol=1e-14
    )


@pytest.mark.parametrize("constraint", ["pseudo-inertia", "eq30"])
def test_constraint_matrix_is_the_literal_one(constraint):
    phi = np.random.default_rng(0).normal(size=(5, 10))
    literal = [literal_matrix(row, constraint) for row in phi]
    np.testing.assert_allclose(constraint_matrix(phi, constraint), literal, atol=1e-15)


def test_triangle_inequality_distinguishes_the_two_sets():
    phi = [2.0, 0, 0, 0, 1, 0, 1, 0, 0, 3]
    assert is_consistent(phi, "eq30")
    assert not is_consistent(phi, "pseudo-inertia")


@properties
@given(seeds)
def test_eq30_set_is_positive_mass_and_inertia_at_the_centre_of_mass(seed):
    rng = np.random.default_rng(seed)
    phi = parameters_of(*point_masses(rng))
    phi = phi + 0.3 * rng.normal(size=10) * np.abs(phi)
    centre = phi[1:4] / phi[0]
    x, y, z = centre
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    at_centre = literal_matrix(phi, "eq30")[:3, :3] + phi[0] * skew @ skew
    expected = phi[0] > 0 and np.linalg.eigvalsh(at_centre)[0] > 0
    assert is_consistent(phi, "eq30") == expected


@properties
@given(
    seeds, st.floats(1e-6, 1e6, allow_nan=False), st.floats(1e-3, 1e3, allow_nan=False)
)
def test_body_scales_are_covariant(seed, mass_unit, length_unit):
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=(4, 10))
    mass_scale, length_scale = body_scales(phi)
    mass_scaled, length_scaled = body_scales(
        phi * parameter_units(mass_unit, length_unit)
    )
    np.testing.assert_allclose(mass_scaled, mass_unit * mass_scale, rtol=1e-10)
    np.testing.assert_allclose(length_scaled, length_unit * length_scale, rtol=1e-10)


def test_body_scales_do_not_depend_on_the_frame():
    rng = np.random.default_rng(3)
    points, masses = point_masses(rng)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotated = parameters_of(points @ rotation.T, masses)
    original = parameters_of(points, masses)
    np.testing.assert_allclose(
        body_scales([rotated]), body_scales([original]), rtol=1e-12
    )
