"""The field's comparison: what it counts, splits and says of places; peers run."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import _field_peers as peers
import bench_field as field

from sklearn_vbjfa.datasets import load_demo_recording, protocols


@pytest.fixture(scope="module")
def demo():
    """Return the case of the demo."""
    recording, protocol = load_demo_recording(), protocols()["demo"]
    fitted, held_out = (
        field.part_of(recording, rows) for rows in protocol.split(recording)
    )
    return peers.Case(
        name="demo",
        cutoff=protocol.cutoff,
        standstill=protocol.standstill,
        recording=recording,
        fitted=fitted,
        held_out=held_out,
    )


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("peer", [peers.OURS, "LinearRegression", "Huber"])
def test_peers_predict_and_simulate_the_part_that_is_held_out(demo, peer):
    found = peers.answer(demo, demo.fitted, peer)
    held_out = demo.held_out
    assert found.predicted.shape == held_out["tau"].shape
    missed = (found.predicted - held_out["tau"]).std(axis=0)
    assert (missed < 0.5 * held_out["tau"].std(axis=0)).all()
    assert found.seconds > 0
    assert found.lines > 5
    assert found.consistent == "yes" or peer != peers.OURS
    assert found.named == "nothing"
    errors = field.position_errors(demo, found)
    own, goes_on, failed = field.position_figures(errors)
    # Bodies that are not consistent may run away, and count as who has no model.
    assert own < 0.5 * goes_on or peer != peers.OURS
    assert np.isfinite(own)
    assert failed == 0 or peer != peers.OURS


@pytest.mark.parametrize("gains", [None, 40.0])
def test_sysid_finds_the_joint_that_moved(gains):
    """A pendulum of MuJoCo, driven by torques, or by commands that act late."""
    mujoco = pytest.importorskip("mujoco")
    pytest.importorskip("absl")
    from _commanded_rivals import numbers_of, vectors
    from _commanded_robots import Gains, mjcf
    from _simulated_models import pendulum

    model = pendulum((1.0, 0.3, 0.02, 0.5))
    terms = [[0.05, 0.4, 0.3, -0.2]]
    truth = numbers_of(model, terms, 0.0, vectors(model))
    drive = None if gains is None else Gains(kp=np.array([gains]), kd=np.array([2.0]))
    step, late = 2e-3, 0 if gains is None else 5
    made = mujoco.MjModel.from_xml_string(mjcf(model, truth, drive, step))
    data, t = mujoco.MjData(made), step * np.arange(2000)
    told = (3.0 if gains is None else 0.5) * np.sin(2 * t + 0.3 * t**2)[:, None]
    q = np.empty((len(t), 1))
    size = 1.0 if gains is None else 1 / gains
    for k in range(len(t)):
        q[k] = data.qpos
        # Offset -0.2: the actuator has 0.2 N m more.
        data.ctrl[:] = told[max(k - late, 0)] + 0.2 * size
        mujoco.mj_step(made, data)
    most = {"armature": 0.2, "damping": 2.0, "frictionloss": 1.0, "bias": 1.0}
    found, values = peers.sysid_user().identify(
        mjcf(model, replace(truth, armature=truth.armature + 0.1), drive, step),
        [(t, told, q, np.zeros(1))],
        {word: np.array([limit]) for word, limit in most.items()},
        bodies=False,
        delay=None if gains is None else 0.025,
        iterations=20,
    )
    got = [x[0] for x in peers.friction_of(found, values).values()]
    np.testing.assert_allclose(got, terms[0], rtol=0.1)
    if gains is not None:
        # Sensors are a step behind the state.
        assert values["delay"].value[0] == pytest.approx(late * step, abs=1.5 * step)


def test_the_bodies_that_sysid_found_are_read_back():
    mujoco = pytest.importorskip("mujoco")
    pytest.importorskip("absl")
    from _commanded_rivals import numbers_of, vectors
    from _commanded_robots import mjcf
    from bench_bodies import leg

    model = leg(np.random.default_rng(1))
    numbers = numbers_of(model, np.ones((3, 4)), 0.0, vectors(model))
    made = mujoco.MjModel.from_xml_string(mjcf(model, numbers))
    found = peers.sysid_user().dynamic_parameters(made)
    np.testing.assert_allclose(found, vectors(model), atol=1e-12)


def test_failed_and_runaway_windows_count_as_the_worst_of_who_has_no_model():
    stays, goes_on = np.array([[1.0], [3.0]]), np.array([[2.0], [4.0]])
    own = np.array([[np.nan], [1e6]])
    error, rival, failed = field.position_figures(np.array([own, stays, goes_on]))
    np.testing.assert_allclose([error, rival], [200.0, 150.0])
    assert failed == 1


def test_halves_are_the_first_and_second_of_every_recording():
    column = np.arange(10.0)[:, None]
    part = {"q": column, "tau": column, "groups": np.repeat([0, 1], [4, 6]), "dt": 1}
    first, second = field.halves(part)
    np.testing.assert_array_equal(first["q"][:, 0], [0, 1, 4, 5, 6])
    np.testing.assert_array_equal(second["q"][:, 0], [2, 3, 7, 8, 9])


def test_recordings_with_commands_stay_whole_in_halves():
    recording = load_demo_recording()
    part = field.part_of(recording, np.arange(recording.n_samples), commands=True)
    first, second = field.halves(part)
    assert first["recording"].group_names == recording.group_names[:1]
    assert second["recording"].group_names == recording.group_names[1:]
    assert len(first["q"]) + len(second["q"]) == recording.n_samples


def test_it_says_where_the_package_is_not_first():
    def one(name, peer, error):
        return {"set": name, "peer": peer, "error": error}

    behind = [one("a", peers.OURS, 5.0), one("a", "PLS", 4.0)]
    first = [one("b", peers.OURS, 5.0), one("b", "PLS", 4.996)]
    said = field.places([*behind, *first])
    assert "behind a rival on 1 of 2 sets: a (PLS 4.00 %, 5.00 %)" in said
    assert "b (" not in said
    table = field.summary([*behind, *first])
    assert "PLS" in table


def test_settings_of_figaroh_name_the_joints_of_the_set(demo, tmp_path):
    path = peers.figaroh_settings(replace(demo, cutoff=4.0), tmp_path)
    text = path.read_text(encoding="utf-8")
    assert all(f"- {name}\n" in text for name in demo.recording.joint_names)
    assert "cutoff_frequency: 6\n" in text
    assert "shoulder" not in text


def test_a_peer_that_is_not_run_says_why():
    table = field.table_of("x", [{"peer": "FIGAROH", "failure": "no URDF"}])
    assert "not run: no URDF" in table
    done = {"error": 1.0, "scatter": np.nan, "consistent": "no", "seconds": 1.0}
    done |= {"lines": 3, "named": "nothing", "positions_failure": "no mass"}
    table = field.table_of("x", [{"peer": "PLS", **done}, {"peer": "ridge", **done}])
    assert "No positions (PLS, ridge): no mass" in table
    assert field.shown([7.2e10, 3.0, np.nan]) == ["7e+10", "3.00", "–"]


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_half_that_cannot_be_fitted_costs_the_scatter_alone(demo, monkeypatch):
    def answer(case, part, peer, python):
        if part is not demo.fitted:
            raise ValueError("too little motion")
        return peers.answer(case, part, peer)

    monkeypatch.setattr(field, "load", lambda *_: replace(demo, cutoff=10.0))
    monkeypatch.setattr(field, "answer", answer)
    result = field.run({"set": "demo", "peer": peers.OURS, "data_home": None})
    assert np.isnan(result["scatter"])
    assert result["scatter_failure"] == "too little motion"
    assert np.isfinite(result["error"])
