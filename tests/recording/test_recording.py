"""Recording: validation, selection, models of single-joint test benches."""

import numpy as np
import pytest

from sklearn_vbjfa.datasets import Recording


def make_recording(**changes):
    rng = np.random.default_rng(0)
    fields = {
        "name": "bench",
        "q": rng.normal(size=(9, 2)),
        "tau": rng.normal(size=(9, 2)),
        "v": rng.normal(size=(9, 2)),
        "t": 0.1 * np.array([0, 1, 2, 0, 1, 2, 3, 0, 1]),
        "dt": 0.1,
        "groups": np.array([0, 0, 0, 1, 1, 1, 1, 2, 2]),
        "group_names": ("slow", "fast", "rest"),
        "joint_names": ("a", "b"),
        "position_units": ("rad", "m"),
        "torque_units": ("N m", "N"),
        "signals": {"temperature": np.arange(9.0)},
    }
    return Recording(**{**fields, **changes})


def test_select_keeps_rows_and_renumbers_labels():
    recording = make_recording()
    kept = recording.select("rest", 0, "rest")
    rows = [0, 1, 2, 7, 8]
    assert kept.group_names == ("slow", "rest")
    np.testing.assert_array_equal(kept.groups, [0, 0, 0, 1, 1])
    for name in ("q", "v", "tau", "t"):
        np.testing.assert_array_equal(
            getattr(kept, name), getattr(recording, name)[rows]
        )
    np.testing.assert_array_equal(kept.signals["temperature"], rows)
    assert make_recording(v=None).select(1).v is None


@pytest.mark.parametrize("entry", ["Fast", 3, -1])
def test_select_refuses_unknown_recordings(entry):
    with pytest.raises(
        ValueError, match=r"choose from the names .* or the labels 0 to 2"
    ):
        make_recording().select(entry)


@pytest.mark.parametrize(
    "changes",
    [
        {"dt": 0.0},
        {"dt": np.nan},
        {"dt": "fast"},
        {"q": np.zeros(9)},
        {"q": [[0.0]]},
        {"tau": np.zeros((8, 2))},
        {"v": np.zeros((9, 1))},
        {"t": np.zeros(8)},
        {"tau": np.full((9, 2), np.nan)},
        {"joint_names": ("a",)},
        {"torque_units": ("N",)},
        {"signals": {"x": np.zeros(8)}},
        {"groups": np.zeros(8, int)},
        {"groups": np.array([0, 1, 2] * 3)},
        {"groups": np.zeros(9, int)},
        {"groups": np.repeat([0.0, 1.0, 2.0], 3)},
        {"group_names": ("a", "a", "b")},
    ],
)
def test_inconsistent_fields_are_refused_by_name(changes):
    (name,) = changes
    with pytest.raises(ValueError, match=name) as caught:
        make_recording(**changes)
    assert "must" in str(caught.value)


def test_missing_description_suggests_a_remedy():
    with pytest.raises(FileNotFoundError, match=r"dataclasses\.replace"):
        make_recording().robot_model()


@pytest.mark.parametrize(
    ("name", "joints", "q", "gravity"),
    [
        ("emps", ("slide",), [0.1], [0.0]),
        ("tflex_1dof", ("hinge",), [0.3], [0.0]),
        ("bam_xl330", ("servo",), [0.3], [0.49 * 9.81 * 0.1 * np.sin(0.3)]),
    ],
)
def test_gravity_of_the_single_joint_models(name, joints, q, gravity):
    import pinocchio as pin

    recording = make_recording(
        name=name,
        q=np.zeros((9, 1)),
        tau=np.zeros((9, 1)),
        v=None,
        joint_names=joints,
        position_units=("rad",),
        torque_units=("N",),
    )
    model = recording.robot_model()
    torque = pin.computeGeneralizedGravity(model, model.createData(), np.array(q))
    np.testing.assert_allclose(torque, gravity, atol=1e-12)


def test_double_pendulum_model_has_the_published_dynamics():
    import pinocchio as pin

    recording = make_recording(
        name="dfki_double_pendulum", joint_names=("shoulder", "elbow")
    )
    model = recording.robot_model()
    q, a = np.array([0.4, -0.7]), np.array([1.3, 0.6])
    # Published Lagrange equations, with inertias about the joints.
    m1, m2, l1, r1, r2 = 0.5593806151425046, 0.6043459469186889, 0.3, 0.3, 0.18377686083
    i1, i2 = 0.053470810264216295, 0.02392374528789766
    coupling = i2 + m2 * l1 * r2 * np.cos(q[1])
    mass = np.array([[i1 + m2 * l1**2 - i2 + 2 * coupling, coupling], [coupling, i2]])
    tip = m2 * r2 * np.sin(q.sum())
    gravity = 9.81 * np.array([(m1 * r1 + m2 * l1) * np.sin(q[0]) + tip, tip])
    torque = pin.rnea(model, model.createData(), q, np.zeros(2), a)
    np.testing.assert_allclose(torque, mass @ a + gravity, rtol=1e-9)
