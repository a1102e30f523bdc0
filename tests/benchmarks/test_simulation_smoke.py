"""The benchmarks of the simulation run at small size, and measure what they say."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_simulation_accuracy as accuracy
import bench_simulation_speed as speed
import bench_simulation_windows as windows
from _protocol_sets import PAIRED_SETS
from _report import commit

from sklearn_vbjfa.datasets import make_robot_recording

HERE = Path(__file__).resolve().parent


@pytest.fixture
def simulator():
    """Skip where the package has no simulator."""
    return pytest.importorskip("sklearn_vbjfa.simulation._simulate")


@pytest.mark.parametrize("name", ["accuracy", "speed", "windows"])
def test_scripts_start_on_their_own(name):
    answer = subprocess.run(
        [sys.executable, str(HERE / f"bench_simulation_{name}.py"), "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=HERE.parent,
    )
    assert "--write" in answer.stdout


def test_commit_is_told():
    assert commit()


# -- windows ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording():
    """Return two recordings of 6 s of the demonstration arm."""
    return make_robot_recording(
        duration=6.0,
        dt=0.01,
        n_recordings=2,
        undeclared={"load_friction": (1, 0.3)},
        random_state=0,
    )


def test_no_row_is_both_fitted_and_judged(recording, monkeypatch):
    first, second = recording.group_names
    monkeypatch.setattr(windows, "UR5_FITTED", (second,))
    (ur5,) = windows.splits_of("ur5", recording)
    assert [name for name, _ in ur5.judged] == [first]
    assert ur5.clock[600] == 0.0
    monkeypatch.setattr(windows, "FITTED", slice(0, 300))
    monkeypatch.setattr(windows, "JUDGED", slice(400, 600))
    (tx40,) = windows.splits_of("staubli_tx40", recording)
    # The clock of the fit goes on.
    assert tx40.clock[400] == pytest.approx(4.0)
    both = windows.splits_of("dfki_double_pendulum", recording)
    assert [split.label for split in both] == [first, second]
    for split in (ur5, tx40, *both):
        judged = np.concatenate([np.r_[rows] for _, rows in split.judged])
        assert not set(judged) & set(split.fitted)


def test_sets_are_those_of_the_protocols():
    from bench_protocol_tx40 import FITTED, JUDGED

    assert (windows.FITTED, windows.JUDGED) == (FITTED, JUDGED)
    assert windows.FROZEN["ur5"] is PAIRED_SETS["ur5"]
    for stage in ("development", "confirmation"):
        stages = {windows.FROZEN[name].stage for name in windows.STAGES[stage]}
        assert stages == {stage}
    assert len(windows.STAGES["all"]) == 4


def test_windows_follow_one_another():
    stretches = [("a", slice(10, 41)), ("b", slice(50, 61)), ("c", slice(70, 90))]
    cut = windows.windows(stretches, 0.1, seconds=1.0, margin=0.2)
    assert cut == [
        ("a", slice(12, 23)),
        ("a", slice(22, 33)),
        # 13 rows are needed for the margin and ten periods
        ("c", slice(72, 83)),
    ]


def test_trivial_rivals_by_hand(recording):
    (split, _) = windows.splits_of("dfki_double_pendulum", recording)
    found = windows.judge(recording, split, recording.states, {}, seconds=0.5)
    q, v = recording.states[10:61, :6], recording.states[10, 6:12]
    # encoder noise is 0.1 mrad
    expected = np.sqrt(((recording.q[10:61] - q[0]) ** 2).mean(axis=0))
    np.testing.assert_allclose(found["errors"][windows.STAYS][0], expected)
    path = q[0] + 0.01 * np.outer(np.arange(51), v)
    expected = np.sqrt(((recording.q[10:61] - path) ** 2).mean(axis=0))
    np.testing.assert_allclose(found["errors"][windows.GOES_ON][0], expected)
    assert found["starts"][:2] == [pytest.approx(0.1), pytest.approx(0.6)]


def result_of(errors, **others):
    """Return the result of one split with errors (windows, joints) in radians."""
    return {
        "set": "ur5",
        "judged": "some",
        "units": ["rad", "rad"],
        "fitted": ["No4"],
        "effects": [["load_friction", 1]],
        "fit_commit": "abc",
        "commit": "abc",
        "recordings": ["No8", "No8", "No9"],
        "starts": [0.1, 1.1, 0.1],
        "failures": {windows.DECLARED: [[1, "ValueError: it diverges"]]},
        "seconds": {windows.DECLARED: 0.1, windows.COMPLETED: 0.2},
        "errors": {k: np.deg2rad(x).tolist() for k, x in errors.items()},
        **others,
    }


def test_a_failed_window_counts_as_the_worst_trivial_error():
    nan = np.nan
    result = result_of(
        {
            windows.STAYS: [[1.0, 2.0], [3.0, 0.0], [0.0, 5.0]],
            windows.GOES_ON: [[2.0, 2.0], [0.0, 1.0], [4.0, 0.0]],
            windows.DECLARED: [[1.0, 1.0], [nan, nan], [9.0, 1.0]],
            windows.COMPLETED: [[1.0, 1.0], [1.0, 1.0], [1.0, 4.0]],
        }
    )
    found = windows.figures([result])
    expected = [[1.0, 1.0], [4.0, 5.0], [9.0, 1.0]]
    np.testing.assert_allclose(found.errors[windows.DECLARED], expected)
    assert found.failed[windows.DECLARED] == 1
    assert found.run_away == {
        windows.STAYS: 0,
        windows.GOES_ON: 0,
        windows.DECLARED: 1,
        windows.COMPLETED: 0,
    }
    np.testing.assert_allclose(found.difference, [0.0, -3.5, -2.5])
    assert windows.better(found)
    text = windows.report({"ur5": [result]})
    assert "on 1 of 1 sets (asked for: 3 of 4)" in text
    assert "declared: 1 failed, first No8 from 1.10 s (ValueError: it diverges)" in text
    row = next(x for x in text.splitlines() if x.startswith("ur5") and "yes" in x)
    assert row.split()[1:5] == ["3", "3.50", "1.50", "-2.00"]
    # Three windows do not tell 1.5 from the 2 of the one that stays.
    assert "both trivial rivals on 0 of 1 sets, declared on 0" in text
    row = windows.verdict("ur5", found)
    assert row[:6] == ["ur5", "3", "1.83", "1.50", "3.50", "1.50"]
    assert row[6:] == ["–", "no", "no", windows.GOES_ON]


def test_better_than_both_trivial_rivals_has_to_be_clear():
    rng = np.random.default_rng(0)
    stays, goes_on = 3.0 + rng.uniform(size=(2, 40, 2))
    small = 1.0 + rng.uniform(size=(40, 2))
    # As good as one rival in the mean, far better than the other.
    even = goes_on + rng.normal(scale=0.3, size=(40, 2))
    errors = {
        windows.STAYS: 2.0 * stays,
        windows.GOES_ON: goes_on,
        windows.DECLARED: even - (even - goes_on).mean(),
        windows.COMPLETED: small,
    }
    found = windows.figures([result_of(errors)])
    assert not windows.shown(found, windows.DECLARED)
    assert windows.shown(found, windows.COMPLETED)
    assert windows.verdict("ur5", found)[-3:] == ["no", "yes", windows.COMPLETED]
    three = {label: x[:3] for label, x in errors.items()}
    three[windows.COMPLETED] = [[0.0, 0.0], [3.3, 3.3], [0.0, 0.0]]
    found = windows.figures([result_of(three)])
    assert windows.better(found)
    assert not windows.shown(found, windows.COMPLETED)


def test_interval_is_wider_where_neighbours_are_alike():
    rng = np.random.default_rng(0)
    white = rng.normal(size=125)
    low, high = windows.interval(white)
    width = 2 * 1.645 * white.std() / np.sqrt(125)
    assert high - low == pytest.approx(width, rel=0.15)
    assert low < white.mean() < high
    alike = np.repeat(rng.normal(size=25), 5)
    half = windows.interval(alike)
    naive = 2 * 1.645 * alike.std() / np.sqrt(125)
    assert half[1] - half[0] > 1.6 * naive
    np.testing.assert_allclose(windows.interval(np.full(3, 2.0)), 2.0)


def literal_simulation(model):
    """Return a simulator without friction: Pinocchio's accelerations, Heun's steps."""
    import pinocchio as pin

    data = model.createData()

    def run(tau, q0, v0, t):
        states = np.empty((len(tau), 3 * model.nv))
        q, v = q0.copy(), v0.copy()
        for i, torque in enumerate(tau):
            a = pin.aba(model, data, q, v, torque).copy()
            states[i] = np.concatenate([q, v, a])
            if i + 1 == len(tau):
                return states
            dt = t[i + 1] - t[i]
            ahead = pin.aba(model, data, q + dt * v, v + dt * a, tau[i + 1]).copy()
            q = q + dt * v + 0.5 * dt**2 * a
            v = v + 0.5 * dt * (a + ahead)
        return states

    return run


def test_the_robot_itself_beats_the_rivals():
    plain = make_robot_recording(
        duration=3.0,
        dt=0.002,
        n_recordings=2,
        friction=(),
        perturbation=0.0,
        encoder_noise=0.0,
        torque_noise=0.0,
        random_state=0,
    )

    def fails(tau, q0, v0, t):
        raise ValueError("it diverges")

    models = {
        windows.DECLARED: literal_simulation(plain.robot_model()),
        windows.COMPLETED: fails,
        windows.BARE: lambda tau, q0, v0, t: np.full((len(tau), 18), np.inf),
    }
    split = windows.splits_of("dfki_double_pendulum", plain)[0]
    found = windows.judge(plain, split, plain.states, models, seconds=0.25)
    itself = np.array(found["errors"][windows.DECLARED])
    assert itself.shape == (11, 6)
    assert itself.max() < 0.02 * np.max(found["errors"][windows.STAYS])
    assert not found["failures"][windows.DECLARED]
    for label in (windows.COMPLETED, windows.BARE):
        assert np.isnan(found["errors"][label]).all()
        assert [k for k, _ in found["failures"][label]] == list(range(11))
    assert found["failures"][windows.COMPLETED][0][1] == "ValueError: it diverges"


def test_friction_beside_the_bodies_of_a_description():
    friction = {"viscous": np.full(6, 2.0), "coulomb": np.full(6, 3.0)}
    made = make_robot_recording(
        duration=8.0,
        dt=0.01,
        friction=friction,
        perturbation=0.0,
        torque_noise=0.0,
        encoder_noise=1e-6,
        random_state=0,
    )
    identifier = PAIRED_SETS["ur5"].identifier(made.robot_model(), made.dt)
    rows = np.arange(made.n_samples)
    declared = identifier.fit(made.q, made.tau)
    found = windows.fitted_friction(declared, made, rows, made.robot_model())
    np.testing.assert_allclose(found[:, 0], 2.0, rtol=0.05)
    np.testing.assert_allclose(found[:, 1], 3.0, rtol=0.05)
    np.testing.assert_allclose(found[:, 2:], 0.0, atol=0.05)


def test_a_set_from_fit_to_table(simulator, monkeypatch, tmp_path):
    from dataclasses import replace

    from sklearn_vbjfa import RobotIdentifier

    if not hasattr(RobotIdentifier, "simulate"):
        pytest.skip("RobotIdentifier has no simulate")
    recording = make_robot_recording(
        duration=9.0,
        dt=0.008,
        frequency=1.0,
        n_recordings=2,
        undeclared={"load_friction": (1, 0.2)},
        random_state=0,
    )
    frozen = replace(
        PAIRED_SETS["dfki_double_pendulum"],
        load=lambda data_home: recording,
        standstill="auto",
    )
    monkeypatch.setitem(windows.FROZEN, "dfki_double_pendulum", frozen)
    monkeypatch.setattr(windows, "EffectDiscovery", quick_discovery)
    (task, _) = windows.tasks_of(["dfki_double_pendulum"], None)
    result = windows.run(task, models=str(tmp_path))
    assert result["effects"] == [["load_friction", 1]]
    found = windows.figures([result])
    assert len(found.difference) == 8
    assert set(found.errors) == {
        *windows.TRIVIAL,
        windows.DECLARED,
        windows.COMPLETED,
        windows.BARE,
        windows.RUBBED,
    }
    completed = found.by_window(windows.COMPLETED).mean()
    assert completed < found.by_window(windows.STAYS).mean()
    # the bodies of the robot differ from those of its description
    assert completed < found.by_window(windows.BARE).mean()
    assert len(list(tmp_path.iterdir())) == 1
    assert "completed" in windows.report({"dfki_double_pendulum": [result]})
    # kept models are not fitted again
    monkeypatch.setattr(windows, "fit", None)
    monkeypatch.setattr(windows, "SECONDS", 4.0)
    again = windows.run(task, models=str(tmp_path))
    assert again["effects"] == result["effects"]


def quick_discovery(identifier, **settings):
    """Search for one effect only."""
    from sklearn_vbjfa import EffectDiscovery

    return EffectDiscovery(
        identifier, effects=["load_friction"], max_effects=1, **settings
    )


# -- accuracy --------------------------------------------------------------------------


def test_a_mass_on_a_spring_by_hand():
    places = accuracy.turning_points(1.0, 50.0, 0.4, 0.1)
    expected = [0.1, -0.084, 0.068, -0.052, 0.036, -0.02, 0.004]
    np.testing.assert_allclose(places, expected, atol=1e-12)
    half = np.pi * np.sqrt(1.0 / 50.0)
    t = half * np.array([0.0, 0.5, 1.0, 2.0, 6.5])
    found = accuracy.on_a_spring(t, 1.0, 50.0, 0.4, 0.1)
    # half way it passes the middle that friction shifts by Fc / k
    expected = [0.1, 0.008, -0.084, 0.068, 0.004]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_two_links_are_those_of_pinocchio():
    import pinocchio as pin

    truth = accuracy.TwoLinks(viscous=(0.0, 0.0), rise=(0.0, 0.0))
    links = [(*x, truth.length) for x in zip(truth.mass, truth.lever, truth.inertia)]
    model = accuracy.pendulum(*links)
    data, rng = model.createData(), np.random.default_rng(0)
    for _ in range(5):
        q, v, a = rng.normal(size=(3, 2))
        M, force = truth.equations(0.0, np.r_[q, v])
        expected = pin.rnea(model, data, q, v, a)
        np.testing.assert_allclose(M @ a - force, expected, atol=1e-12)


def test_two_links_stick_and_break_away():
    truth = accuracy.TwoLinks()
    t = 0.01 * np.arange(301)
    q = truth.solve(t, np.array([0.9, -0.4]), np.zeros(2))
    at_rest = np.abs(np.diff(q, axis=0)) < 1e-12
    for j in range(2):
        change = np.flatnonzero(np.diff(at_rest[:, j].astype(int)))
        assert change.size >= 1, f"joint {j} neither sticks nor breaks away"
    # half the tolerance away from any instant, the answer is the same
    fine = truth.solve(np.linspace(0.0, 3.0, 601), np.array([0.9, -0.4]), np.zeros(2))
    np.testing.assert_allclose(fine[::2], q, atol=1e-9)


def test_two_links_keep_their_energy():
    truth = accuracy.TwoLinks(
        viscous=(0.0, 0.0), dry=(0.0, 0.0), torque=(0.0, 0.0), rise=(0.0, 0.0)
    )
    model = accuracy.pendulum(
        *[(*x, truth.length) for x in zip(truth.mass, truth.lever, truth.inertia)]
    )
    import pinocchio as pin

    t = np.linspace(0.0, 2.0, 2001)
    q = accuracy._smooth(truth, t, np.array([0.9, -0.4]), np.zeros(2))
    v = np.gradient(q, t, axis=0, edge_order=2)
    data = model.createData()
    total = [pin.computeMechanicalEnergy(model, data, *x) for x in zip(q, v)]
    assert np.ptp(total[1:-1]) < 1e-3


def test_a_failed_case_is_a_row():
    def fails():
        raise ValueError("it diverges")

    (answer,) = accuracy.case("made up", 0.01, fails)
    assert accuracy.row(answer)[1] == "ValueError: it diverges"
    assert accuracy.row(answer)[4] == "failed"
    (answer,) = accuracy.case("made up", 0.01, lambda: ([("x", "m", 2.0, 1.0)], 1e-6))
    cells = accuracy.row(answer)
    assert len(cells) == len(accuracy.HEADERS)
    assert cells[4:] == ["2.0e+00", "1", "no", "1.0"]


@pytest.mark.parametrize("name", [n for n in accuracy.CASES if "joints" not in n])
def test_simulated_motion_is_that_of_the_references(name, simulator):
    # no unit is far from one, and the instants of sticking are within a row
    for answer in accuracy.run([name], periods=(0.005,)):
        assert not answer.message
        assert answer.error < 1e-3, answer


def test_energy_of_a_chain(simulator):
    figures, work = accuracy.energy(0.002, 2, seconds=0.2)
    (_, _, error, asked) = figures[0]
    assert error < asked
    assert work > 0


# -- speed -----------------------------------------------------------------------------


def test_torques_are_those_of_the_recording():
    recording = make_robot_recording(
        duration=1.0, dt=0.01, undeclared={"load_friction": (1, 0.2)}, random_state=0
    )
    from sklearn_vbjfa import effects

    robot = speed.torque_model(
        recording.robot_model(),
        bodies=recording.inertial,
        friction=recording.friction,
        effects={effects.LoadFriction(joint=1): (0.2,)},
        dt=0.01,
    )
    q, v, a = np.split(recording.states, 3, axis=1)
    found = speed.torques(robot, q, v, a)
    # that robot's friction is rounded off at a reversal
    moving = (np.abs(v) > 0.2).all(axis=1)
    assert moving.sum() > 50
    np.testing.assert_allclose(found[moving], recording.tau_clean[moving], atol=1e-9)
    assert robot.load.coefficients[0].size == 0


def test_speed_of_a_short_motion(simulator):
    found = speed.measure(seconds=1.0, rounds=1)
    rows = speed.rows_of(found, numba=True)
    assert [row[0] for row in rows] == [speed.FRICTION, speed.FIVE]
    for row in rows:
        assert len(row) == len(speed.HEADERS)
    for figures in found.values():
        assert 0.0 < figures["windows"]
        assert figures["error"] < 0.05


def test_a_robot_that_fails_is_a_row():
    rows = speed.rows_of({"made up": {"message": "ValueError: no"}}, numba=False)
    assert rows == [["made up", "no", "ValueError: no", "–", "–", "–", "–"]]


def test_met_counts_the_slower():
    figures = {"windows": 30.0, "whole": 19.0, "error": 0.001}
    (row,) = speed.rows_of({"made up": figures}, numba=True)
    assert row[-2] == "no"
    (row,) = speed.rows_of({"made up": figures}, numba=False)
    assert row[-2] == "yes"


def test_every_effect_can_be_declared():
    from sklearn_vbjfa.effects import available

    found = speed.every_effect(7)
    left = {"viscous", "coulomb", "signal"}
    assert {effect.name for effect in found} == set(available()) - left
    coupling = next(effect for effect in found if effect.name == "coupling")
    assert coupling.other != coupling.joint


def test_single_states_are_timed_where_robots_step():
    import sklearn_vbjfa

    robot = getattr(sklearn_vbjfa, "IdentifiedRobot", None)
    rows = speed.step_rows(rounds=1)
    assert [row[0] for row in rows] == (
        list(speed.STEPS) if hasattr(robot, "step") else []
    )
    assert all(len(row) == len(speed.STEP_HEADERS) for row in rows)
