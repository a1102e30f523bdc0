"""Collision shapes of a URDF: what is read, where it is, and what is said if not."""

import sys

import numpy as np
import pytest

pytest.importorskip("coal")

from sklearn_vbjfa.model import NoShapes, load_model, load_reduced, load_shapes
from tests.model._shaped import CUBE, MESH, arm, joint, link, two_bars, write


def with_mesh(folder, name, scale=1.0):
    return write(
        folder,
        link("base", (MESH.format(name, scale), "0 0 0", "0 0 0")),
        link("upper"),
        joint("shoulder", "base", "upper"),
    )


def reason(path, **kwargs):
    with pytest.raises(NoShapes) as raised:
        load_shapes(path, load_model(path), **kwargs)
    return str(raised.value)


def pairs_of(geometry, model):
    """Links of the shapes, and names of the pairs that are looked at."""
    links = [model.frames[x.parentFrame].name for x in geometry.geometryObjects]
    pairs = geometry.collisionPairs
    return links, {frozenset((links[x.first], links[x.second])) for x in pairs}


def test_neighbours_share_a_joint_or_are_fixed_together(tmp_path):
    path = arm(tmp_path)
    model = load_model(path)
    links, pairs = pairs_of(load_shapes(path, model), model)
    # Without shape, "six" is fixed to the hand.
    order = ["base", "one", "two", "three", "four", "five", "hand"]
    assert set(links) == set(order)
    apart = {
        frozenset((a, b))
        for i, a in enumerate(order)
        for j, b in enumerate(order)
        if abs(i - j) > 1
    }
    assert pairs == apart


def test_held_joints_hand_their_shapes_down_but_stay_joints(tmp_path):
    path = arm(tmp_path)
    model = load_reduced(path, ["j1", "j2", "j4", "j5", "j6"])
    held = load_shapes(path, model)
    links, pairs = pairs_of(held, model)
    assert frozenset(("two", "three")) not in pairs
    assert frozenset(("two", "four")) in pairs
    joints = [shape.parentJoint for shape in held.geometryObjects]
    bodies = dict(zip(links, joints))
    assert bodies["two"] == bodies["three"] == 2
    assert bodies["hand"] == 5


def test_a_mesh_is_its_convex_hull_in_the_scale_of_the_description(tmp_path):
    # A dent in a cube, which the hull fills.
    (tmp_path / "cube.obj").write_text(
        CUBE + "\nv 0 0 0.1\nf 2 4 9\nf 4 8 9\nf 8 6 9\nf 6 2 9\n", encoding="utf-8"
    )
    path = with_mesh(tmp_path, "cube.obj", 0.2)
    (shape,) = load_shapes(path, load_model(path)).geometryObjects
    assert shape.geometry.num_points == 8
    corners = [shape.geometry.point(k) for k in range(8)]
    np.testing.assert_allclose(np.abs(corners), 0.1)


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("cube.obj", "robot/urdf/cube.obj"),
        ("package://robot/my größe.obj", "robot/my größe.obj"),
        ("package://other/meshes/cube.obj", "other/meshes/cube.obj"),
        # The folder of the package has another name.
        ("package://arm_description/meshes/cube.obj", "robot/meshes/cube.obj"),
    ],
)
def test_meshes_are_found_beside_the_description_and_above(tmp_path, name, place):
    folder = tmp_path / "robot/urdf"
    folder.mkdir(parents=True)
    path = with_mesh(folder, name)
    assert name in reason(path)
    mesh = tmp_path / place
    mesh.parent.mkdir(parents=True, exist_ok=True)
    mesh.write_text(CUBE, encoding="utf-8")
    assert len(load_shapes(path, load_model(path)).geometryObjects) == 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("version https://git-lfs", "cannot read the collision geometry"),
        ("v nan 0 0\nv 1 0 0\nv 1 1 0\nv 1 1 1\nf 1 2 3\nf 2 3 4", "no convex hull"),
    ],
)
def test_files_that_are_no_meshes_are_refused(tmp_path, content, said):
    (tmp_path / "hand.obj").write_text(content, encoding="utf-8")
    found = reason(with_mesh(tmp_path, "hand.obj"))
    assert said in found
    assert "hand.obj" in found
    assert "\n" not in found


def test_a_pinocchio_without_coal_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "coal", None)
    assert "comes without the collision library coal" in reason(two_bars(tmp_path))
