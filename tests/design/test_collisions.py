"""Distances between links: closed forms, gradients, and pairs of links."""

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("coal")

from sklearn_vbjfa.design import Clearance
from sklearn_vbjfa.model import load_model
from tests.model._shaped import BALL, CUBE, arm, joint, link, two_bars, write


def clearance_of(path, **kwargs):
    clearance, reason = Clearance.of(path, load_model(path), **kwargs)
    assert reason == ""
    return clearance


def arm_with_mesh(folder, **kwargs):
    (folder / "cube.obj").write_text(CUBE, encoding="utf-8")
    return arm(folder, mesh="cube.obj", **kwargs)


def positions(n, nv, seed=0):
    return np.random.default_rng(seed).uniform(-3, 3, size=(n, nv))


def test_balls_have_the_distance_of_their_centres(tmp_path):
    clearance = clearance_of(two_bars(tmp_path))
    assert clearance.pairs == (("base", "lower"),)
    q = positions(200, 2)
    distance, gradient = clearance(q, within=np.inf)
    apart = np.sqrt(0.5**2 + 0.4**2 + 2 * 0.5 * 0.4 * np.cos(q[:, 1]))
    np.testing.assert_allclose(distance[:, 0], apart - 0.4, atol=1e-12)
    slope = -0.5 * 0.4 * np.sin(q[:, 1]) / apart
    np.testing.assert_allclose(gradient[:, 0, 1], slope, atol=1e-12)
    np.testing.assert_allclose(gradient[:, 0, 0], 0, atol=1e-12)
    # Both in penetration and apart.
    assert (distance < 0).sum() > 20
    assert (distance > 0).sum() > 20


def test_distances_are_those_of_pinocchio(tmp_path):
    path = arm(tmp_path)
    clearance, model = clearance_of(path), load_model(path)
    geometry = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION)
    geometry.addAllCollisionPairs()
    links = [model.frames[x.parentFrame].name for x in geometry.geometryObjects]
    q = positions(30, 6)
    found, _ = clearance(q, within=np.inf)
    data, placed = model.createData(), geometry.createData()
    for row in range(len(q)):
        pin.computeDistances(model, data, geometry, placed, q[row])
        expected = {}
        for pair, result in zip(geometry.collisionPairs, placed.distanceResults):
            names = links[pair.first], links[pair.second]
            expected.setdefault(names, []).append(result.min_distance)
        for names in set(clearance.pairs):
            here = [found[row, i] for i, x in enumerate(clearance.pairs) if x == names]
            assert sorted(here) == pytest.approx(sorted(expected[names]), abs=1e-5)


def test_gradients_are_those_of_finite_differences(tmp_path):
    clearance = clearance_of(arm_with_mesh(tmp_path))
    q, step = positions(100, 6), 1e-5
    distance, gradient = clearance(q, within=np.inf)
    change = np.empty_like(gradient)
    bend = np.zeros_like(distance)
    for k in range(6):
        more = clearance(q + step * np.eye(6)[k], within=np.inf)[0]
        less = clearance(q - step * np.eye(6)[k], within=np.inf)[0]
        change[..., k] = (more - less) / (2 * step)
        bend = np.maximum(bend, np.abs(more - 2 * distance + less) / step)
    error = np.abs(change - gradient).max(axis=2)
    # Where the nearest points jump, the distance has a kink.
    smooth = bend < 1e-2
    assert smooth.mean() > 0.9
    apart, inside = smooth & (distance > 0), smooth & (distance < 0)
    assert apart.sum() > 300
    assert inside.sum() > 15
    assert error[apart].max() < 1e-3
    # Depths of cylinders are accurate to 1 um, their normals to its square root.
    assert np.quantile(error[inside], 0.9) < 2e-3
    assert error[inside].max() < 0.1
    # Distance increases out of penetration.
    size = np.abs(gradient[inside]).max(axis=1)
    agree = np.einsum("ij,ij->i", change[inside], gradient[inside])
    assert (agree[size > 0.05] > 0).all()


def test_neighbouring_links_are_not_checked(tmp_path):
    clearance = clearance_of(arm(tmp_path))
    order = ["base", "one", "two", "three", "four", "five", "hand"]
    expected = {
        (a, b) for i, a in enumerate(order) for j, b in enumerate(order) if j > i + 1
    }
    assert set(clearance.pairs) | set(clearance.ignored) == expected


def wrist(folder, *, radius):
    """Write a wrist of three intersecting axes; first and third body overlap."""
    return write(
        folder,
        link("base", (BALL.format(0.05), "0 0 -0.5", "0 0 0")),
        link("one", (BALL.format(radius), "0 0 0", "0 0 0")),
        link("two"),
        link("three", (BALL.format(radius), "0 0 0.1", "0 0 0")),
        joint("j1", "base", "one"),
        joint("j2", "one", "two", axis="0 1 0"),
        joint("j3", "two", "three", axis="1 0 0"),
    )


def test_links_drawn_into_each_other_are_ignored(tmp_path):
    clearance = clearance_of(wrist(tmp_path, radius=0.06))
    assert clearance.ignored == (("one", "three"),)
    assert clearance.pairs == (("base", "three"),)


def test_without_shapes_there_is_a_reason(tmp_path):
    model = load_model(two_bars(tmp_path))
    clearance, reason = Clearance.of(model, model)
    assert clearance is None
    assert "path of its URDF" in reason
    path = write(tmp_path, link("a"), link("b"), joint("j", "a", "b"))
    clearance, reason = Clearance.of(path, load_model(path))
    assert clearance is None
    assert "no collision geometry" in reason
    path = arm(tmp_path, mesh="package://arm/hand.stl")
    clearance, reason = Clearance.of(path, load_model(path))
    assert clearance is None
    assert "'package://arm/hand.stl' of link 'hand'" in reason
