"""Capsules around points, and distances of segments."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from sklearn_vbjfa.design import capsule_around, segment_distances


def distance_to_segment(points, ends):
    start, along = ends[0], ends[1] - ends[0]
    share = (points - start) @ along / max(along @ along, 1e-300)
    nearest = start + np.clip(share, 0, 1)[:, None] * along
    return np.linalg.norm(points - nearest, axis=1)


@pytest.mark.parametrize("seed", range(8))
def test_a_capsule_holds_its_points_and_touches_one(seed):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = rng.normal(size=(30, 3)) * rng.uniform(0.01, 1.0, size=3) @ turn
    points += rng.normal(size=3)
    capsule = capsule_around(points, swept=0.3)
    away = distance_to_segment(points, capsule.ends)
    assert away.max() == pytest.approx(capsule.radius - 0.3, rel=1e-9)


def test_the_capsule_of_a_rod_is_hardly_larger():
    angles = np.linspace(0, 2 * np.pi, 40)
    rim = 0.1 * np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.vstack([np.column_stack([rim, np.full(40, z)]) for z in (-1, 1)])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    for placed in (points, points @ turn):
        capsule = capsule_around(placed)
        assert capsule.radius == pytest.approx(0.1, rel=0.02)
        assert np.linalg.norm(np.diff(capsule.ends, axis=0)) == pytest.approx(2, 0.02)


def test_a_point_has_a_capsule_without_size():
    capsule = capsule_around(np.array([[1.0, 2.0, 3.0]]), swept=0.5)
    np.testing.assert_allclose(capsule.ends, [[1, 2, 3], [1, 2, 3]], atol=1e-15)
    assert capsule.radius == 0.5


def test_distances_of_segments_are_those_of_least_squares():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 60, 2, 3))
    # Points, parallel and crossing ones among them.
    first[:10, 1], second[5:15, 1] = first[:10, 0], second[5:15, 0]
    second[20:30, 1] = second[20:30, 0] + 0.7 * (first[20:30, 1] - first[20:30, 0])
    second[30:35, 0] = first[30:35].mean(axis=1)
    second[30:35, 1] = 2 * second[30:35, 0] - second[30:35, 1]
    found = segment_distances(first, second)
    for (a, b), (c, d), distance in zip(first, second, found):
        best = lsq_linear(np.column_stack([b - a, c - d]), c - a, (0, 1), tol=1e-14)
        assert distance == pytest.approx(np.sqrt(2 * best.cost), abs=1e-6)
    np.testing.assert_allclose(segment_distances(second, first), found, atol=1e-12)
