"""Every benchmark runs at small size and says what its numbers mean."""

import json
import platform
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import _report
import numpy as np
import pytest

HERE = Path(__file__).resolve().parent


def residuals(scale, index, tau):
    """Residuals of a given size, with the interface of TorqueResiduals."""
    from sklearn_vbjfa.robot import TorqueResiduals

    return TorqueResiduals(
        index=index,
        torque=tau,
        predicted=tau - scale * np.cos(7.0 * np.arange(index.size))[:, None],
        weight=np.ones(tau.shape),
    )


@pytest.mark.parametrize(
    "name",
    [
        "conditioning",
        "dask",
        "discovery",
        "errors_in_variables",
        "exports",
        "false_alarms",
        "feedforward",
        "friction_none",
        "growth",
        "identification",
        "interval_coverage",
        "iterations",
        "kernels",
        "known_noise",
        "leave_one_set_out",
        "likelihood",
        "long_recordings",
        "loop_time",
        "measured_robots",
        "measured_sets",
        "noise_floor",
        "paper_robots",
        "projection",
        "recording_files",
        "regression_coverage",
        "rest",
        "simulated_arms",
        "single_effects",
        "speed",
        "states",
        "step",
        "synthetic",
        "torque_coverage",
        "whole_robots",
    ],
)
def test_scripts_start_on_their_own(name):
    script = HERE / f"bench_{name}.py"
    answer = subprocess.run(
        [sys.executable, str(script), "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=HERE.parent,
    )
    assert "--write" in answer.stdout


def test_measured_robots_on_the_demo(monkeypatch):
    pytest.importorskip("pinocchio")
    import bench_measured_robots as bench

    load = bench.load

    def short(name, data_home):
        *settings, parts = load(name, data_home)
        return *settings, [tuple(x[:1600] for x in part) for part in parts]

    monkeypatch.setattr(bench, "load", short)
    paragraphs, summary = bench.measure("demo", None, [bench.OURS, "VB"])
    text = "\n\n".join(paragraphs)
    assert "Smallest pseudo-inertia eigenvalue" in text
    assert summary[0] == "demo"
    # 5 % of torque noise, less behind the low-pass, and 8 s to learn from.
    assert float(summary[1]) < 10.0


def test_a_killed_worker_changes_nothing_in_the_table_of_dask():
    pytest.importorskip("distributed")
    import bench_dask as bench

    way = "2 workers, one killed"
    text = bench.report(2, {way: bench.WAYS[way]})
    assert text.count(way) == text.count("yes") == 2


def test_differences_are_relative_to_the_largest():
    pytest.importorskip("distributed")
    import bench_dask as bench

    one, other = (
        SimpleNamespace(theta_=np.array([x, -200.0]), torque_noise_=np.array([y]))
        for x, y in ((1.0, 4.0), (3.0, 5.0))
    )
    assert bench.differences(one, other) == [0.01, 0.2]


def test_bootstrap_finds_a_difference_and_its_interval():
    pytest.importorskip("pinocchio")
    import bench_measured_robots as bench

    rng = np.random.default_rng(0)
    n, dt = 4000, 0.01
    index = np.arange(0, n, 4)
    tau = rng.normal(size=(index.size, 1))
    part = (None, None, np.repeat([0, 1], n // 2))
    ours, other = residuals(0.1, index, tau), residuals(0.2, index, tau)
    difference, low, high, n_blocks = bench.block_bootstrap(ours, other, part, dt)
    assert n_blocks == 40
    expected = -0.1 * np.sqrt(0.5) / tau.std()
    np.testing.assert_allclose(difference, expected, rtol=0.01)
    assert low <= difference <= high
    assert high < 0


def test_bootstrap_gives_no_interval_for_one_block():
    pytest.importorskip("pinocchio")
    import bench_measured_robots as bench

    index = np.arange(50)
    tau = np.sin(index)[:, None]
    part = (None, None, np.zeros(50, dtype=int))
    *_, high, n_blocks = bench.block_bootstrap(
        residuals(0.1, index, tau), residuals(0.2, index, tau), part, 0.01
    )
    assert n_blocks == 1
    assert np.isnan(high).all()


def test_coupling_columns_find_a_coupled_friction():
    pytest.importorskip("pinocchio")
    import _coupling

    from sklearn_vbjfa import RobotIdentifier
    from sklearn_vbjfa.datasets import make_robot_recording

    friction = ("viscous", "coulomb")
    recording = make_robot_recording(
        duration=10.0,
        dt=0.01,
        n_recordings=2,
        encoder_noise=0.0,
        torque_noise=1e-3,
        friction=friction,
        random_state=0,
    )
    v = recording.states[:, 6:12]
    size = 3.0 * recording.tau[:, 4].std()
    coupled = size * np.sign(v[:, 4] + v[:, 5])
    tau = recording.tau.copy()
    tau[:, 4:] += coupled[:, None]
    parts = []
    for label in (0, 1):
        rows = recording.groups == label
        parts.append((recording.q[rows], tau[rows], recording.groups[rows]))
    identifier = RobotIdentifier(
        recording.robot_model(), dt=recording.dt, friction=friction, cutoff=10.0
    )
    identifier.fit(*parts[0][:2])
    joints, values = _coupling.study(identifier, *parts)
    errors = {name: 100 * error[_coupling.FIFTH] for name, error in joints.items()}
    zero, first, hindsight, with_columns = errors.values()
    assert zero >= 99.9
    assert with_columns < 0.25 * first
    assert hindsight <= first
    assert values["friction on v5 + v6, mean size [N m]"] == pytest.approx(
        size, rel=0.1
    )


def test_projection_at_small_size():
    pytest.importorskip("cvxopt")
    pytest.importorskip("clarabel")
    import bench_projection as bench

    row = bench.measure(1, n_problems=2)
    assert abs(row[4]) < 1e-6
    assert "cvxopt" in bench.report(sizes=(1,), n_problems=1)
    text = bench.report_forms(sizes=(2,), n_problems=1)
    assert "rotated cone" in text
    assert "package" in text


def test_speed_at_small_size():
    import bench_speed as bench

    text = bench.report(n_samples=300, n_features=12, rounds=1, wide=(20, 50))
    for name in bench.models():
        assert name in text


def test_tables_are_written_where_the_guide_looks(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(_report, "TABLES", tmp_path)
    _report.publish("speed", "text", write=False)
    assert not list(tmp_path.iterdir())
    _report.publish("speed", "text", write=True)
    written = (tmp_path / "speed.rst").read_text()
    assert written.startswith("text\n\nMade by ``python tests/benchmarks/bench_speed")
    assert f"at {_report.commit()}, " in written
    assert "numpy" in written
    made = json.loads((tmp_path / "speed.json").read_text())
    assert made["script"] == "tests/benchmarks/bench_speed.py"
    (state,) = made["states"]
    assert state["commit"] == _report.commit()
    files = state["files"]
    whole = _report.code()["files"]
    assert files == {path: whole[path] for path in files}
    assert "sklearn_vbjfa/regression/_vbjfa.py" in files
    # the estimators of robots are on the way of other scripts
    assert not any(path.startswith("sklearn_vbjfa/robot/") for path in files)
    states = [dict(state, commit=c) for c in ("1a2b3c4", "5d6e7f8+")]
    _report.publish("speed", "text", write=True, states=states)
    assert " at 1a2b3c4 and 5d6e7f8+, " in (tmp_path / "speed.rst").read_text()
    assert json.loads((tmp_path / "speed.json").read_text())["states"] == states
    assert written in capsys.readouterr().out
    guide = (_report.ROOT / "docs" / "benchmarks.rst").read_text()
    assert "tables/speed.rst" in guide


def test_coverage_of_correlated_inputs_at_small_size():
    import bench_regression_coverage as bench

    rows, shares = bench.study_blocks(8, cells=[("0.15", 600, 30.0)])
    assert len(rows[0]) == 11
    assert shares.shape == (1, 3, 2)
    # 40 coefficients that are not zero, for noisy queries and unknown noise, with a
    # deviation of 5 %. A noise that is taken for half its bound alone holds 50 %.
    assert np.all(shares[0, [0, 2], 0] > 0.75)


def test_known_noise_keeps_the_coefficients_when_nuclei_are_lost():
    import bench_known_noise as bench

    rows = bench.coefficients(draws=4)
    found = {
        (name, nuclei): [float(cell.split()[0]) for cell in cells]
        for name, nuclei, _, *cells in rows
    }
    for name in ("texture", "smoothness"):
        (plain, known), (few_plain, few_known) = (
            found[name, nuclei] for nuclei in ("all", "1 in 4")
        )
        assert known > plain
        assert few_plain < 0.85 * plain
        assert abs(few_known - known) < 0.15 * known
    (alike, _, cleaner) = bench.held_out(draws=1)
    assert float(alike[2]) == pytest.approx(float(alike[1]), abs=0.1)
    assert float(alike[3]) > float(alike[1])
    assert float(cleaner[2]) < float(cleaner[1])


def test_synthetic_study_at_small_size():
    import bench_synthetic as bench

    errors, relevance = bench.run(
        1, cells=[(5.0, 30)], with_rivals=False, n_samples=400
    )
    cell = errors[(5.0, 30)]
    assert cell["oracle"][0] < cell["VB-JFA"][0] < 0.2
    assert relevance[(5.0, 30)]["VB-JFA"].shape == (1, 2)


def test_simulated_arms_at_small_size():
    pytest.importorskip("pinocchio")
    import bench_simulated_arms as bench

    results = bench.run(bench.grid(small=True), duration=10.0)
    table, summary = bench.tables(results)
    assert results[0][1]["ours"] < 3 * results[0][1]["oracle"]
    assert "ours / oracle: median" in summary
    assert "best LS" in table


def test_measured_noise_beats_least_squares_on_noisy_regressors():
    pytest.importorskip("pinocchio")
    import bench_errors_in_variables as bench

    results = bench.run_condition(
        1e-3, 10.0, duration=15.0, names=["VB, noise measured", "least squares"]
    )
    assert results["VB, noise measured"][0] < 0.5 * results["least squares"][0]


def test_state_estimator_beats_differences_with_the_best_cutoff():
    import bench_states as bench

    methods = ("penalised quintic spline, auto", "Butterworth + differences, oracle")
    errors = [
        np.mean(
            [
                bench.error_of(
                    *bench.METHODS[name], *bench.motion(100.0, 4.0, 1e-3, seed), 4.0
                )
                for seed in range(2)
            ]
        )
        for name in methods
    ]
    assert errors[0] < 0.6 * errors[1]


def test_noise_floor_of_the_demo_is_its_residual(monkeypatch):
    pytest.importorskip("pinocchio")
    import bench_noise_floor as bench

    load = bench.load

    def short(name, data_home):
        *settings, parts = load(name, data_home)
        return *settings, [tuple(x[:1600] for x in part) for part in parts]

    monkeypatch.setattr(bench, "load", short)
    rows = bench.measure("demo", None)
    assert len(rows) == 6
    assert all(len(row) == len(bench.HEADERS) for row in rows)
    # 8 s of noise are what was fitted, but on joint 2, whose friction has a part in
    # proportion to the load that the model lacks.
    ratio = [float(row[-1]) for row in rows]
    assert ratio.pop(1) > 2.0
    np.testing.assert_allclose(ratio, 1.0, atol=0.35)


def test_floor_of_known_noise():
    pytest.importorskip("pinocchio")
    import bench_noise_floor as bench

    found = bench.measure_simulated(
        range(1), ("demo_arm",), ("declared",), ("white", "step 1")
    )
    for ratio, residual in found.values():
        np.testing.assert_allclose(ratio, 1.0, atol=0.25)
        # the truth of the benchmark is what the fit leaves
        np.testing.assert_allclose(residual, 1.0, atol=0.25)
    assert "step 1" in bench.simulated_table(found)


def test_rest_is_told_from_motion_by_the_truth():
    pytest.importorskip("pinocchio")
    import bench_rest as bench

    found = bench.measure(range(1), ("demo_arm",), ("fine",), ("sign",))
    assert [kind for *_, kind in found] == list(bench.MOTIONS)
    figures = np.array(list(found.values()))
    # What never rests has no error at rest.
    assert np.isnan(figures[0, [1, 3, 5, 6, 7]]).all()
    assert np.isfinite(figures[1:]).all()
    # On the true states reversals keep their sign; creeping into a rest and out of it
    # does not, which costs some of a friction that turns at once.
    assert figures[0, 4] < 1.0
    assert np.all(figures[1:, 4] < 6.0)
    # At rest hardly more is missed than nobody can know.
    assert np.all(figures[1:, 1] < 1.6 * figures[1:, 6])
    # At rest nobody knows friction, and its mean is at most what the truth misses.
    np.testing.assert_allclose(figures[1:, 5], figures[1:, 6], rtol=0.2)


def test_only_known_noise_is_identified():
    import bench_identification as bench

    few, many = (bench.run(n, n_trials=3) for n in (500, 20_000))
    for found in (few, many):
        assert set(found) == {"paper", "default", "known variances", "known covariance"}
    split = {name: np.median(values[:, 0]) for name, values in many.items()}
    assert split["known variances"] == pytest.approx(1.0)
    # The mean of what the data permit, whose upper end is near the truth here.
    assert 0.4 < split["default"] < 0.6
    query = {name: np.median(values[:, 3]) for name, values in many.items()}
    before = np.median(few["known variances"][:, 3])
    assert query["known variances"] < 0.2 * before
    assert query["known variances"] < query["default"] < 0.5 * query["paper"]


def test_paper_robots_at_small_size():
    pytest.importorskip("pinocchio")
    import bench_paper_robots as bench

    rows, per_sample = bench.run("head", duration=6.0, tracked=2.0, names=[bench.OURS])
    assert list(rows) == ["URDF, not identified", bench.OURS, "the robot itself"]
    feedback = {label: figures[2] for label, (figures, *_) in rows.items()}
    assert feedback["the robot itself"] < feedback[bench.OURS]
    assert feedback[bench.OURS] < feedback["URDF, not identified"]
    text = "\n".join(bench.section("head", [rows, rows], [per_sample], duration=6.0))
    assert "Head: 6 s, smoothing automatic, 2 drawn" in text
    assert "torque missed [%]" in text


def test_a_model_from_a_file_controls_as_the_fitted_one():
    pytest.importorskip("pinocchio")
    import bench_paper_robots as bench

    from sklearn_vbjfa.effects import LoadFriction, Presliding

    recording = bench.record("head", 0, duration=6.0)
    effects = [LoadFriction(joint=1), Presliding(joint=0)]
    model = bench.identify(recording, {"effects": effects}).model
    read = bench.read_back(model)
    states = recording.motions[0].states(np.arange(0.0, 2.0, recording.dt))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for X in (recording.q, states):
            expected, torque = model.predict(X), read.predict(X)
            assert np.abs(torque - expected).max() < 1e-12 * expected.std(axis=0).max()
        fitted, reason = bench.control(recording, model.predict, 2.0)
        again, same = bench.control(recording, read.predict, 2.0)
    assert same == reason
    np.testing.assert_allclose(again, fitted, rtol=1e-9)


def test_paper_robots_are_compared_by_their_feedback():
    pytest.importorskip("pinocchio")
    import bench_paper_robots as bench

    def draw(**feedback):
        return {
            label: (np.array([0.0, 0.0, value, 0.0]), "", None)
            for label, value in feedback.items()
        }

    full = {"ridge": 2.0, "LASSO": np.nan, bench.OURS: 1.8, bench.COMPLETED: 0.45}
    text = bench.comparison([draw(**full), draw(**full)])
    assert f"{bench.OURS}: -10.0 % feedback against ridge" in text
    assert f"{bench.COMPLETED}: 0.25 of the best" in text
    assert bench.comparison([draw(ridge=1.0)]) == ""


def test_feedforward_on_the_demo(monkeypatch):
    pytest.importorskip("pinocchio")
    import bench_feedforward as bench

    load = bench.load

    def short(name, data_home):
        recording, identifier, rows = load(name, data_home)
        return recording, identifier, [part[:1600] for part in rows]

    monkeypatch.setattr(bench, "load", short)
    rows, note, recording = bench.measure("demo", None, effects=["offset"])
    mean = {label: np.mean(share) for label, share in rows.items()}
    fitted = f"{bench.URDF}, scale and friction fitted"
    assert mean[bench.IDENTIFIED] < mean[fitted] < mean[bench.URDF]
    assert mean[bench.URDF] < mean[bench.NOTHING] == 1.0
    # The model lacks nothing.
    assert mean[bench.IDENTIFIED] < 0.1
    text = "\n".join(bench.section("demo", rows, note, recording))
    assert "Found in the fitted part" in text


def test_what_feedforward_leaves_counts_what_moves():
    pytest.importorskip("pinocchio")
    import bench_feedforward as bench

    torque = np.array([[2.0, 1.0], [2.0, 1.0], [9.0, 1.0]])
    weight = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    left = bench.left_for_feedback(torque, torque - [[1.0, 1.0]], weight)
    np.testing.assert_allclose(left, [0.5, np.nan])


def test_discovery_judges_a_drawn_case():
    pytest.importorskip("pinocchio")
    import bench_discovery as bench
    from _undeclared import draw_cases

    (case,) = draw_cases(
        1, 1, (5.0, 6.0), 1, kinds=("load_friction",), declared=("viscous",)
    )
    verdict = bench.judge(case.simulate(duration=20, rate=50))
    assert verdict.named
    assert verdict.parameter_errors[0] < 0.15
    assert bench.row("load_friction", [verdict], "97 %")[2] == "100 %"


x86 = pytest.mark.skipif(
    platform.machine().lower() not in {"x86_64", "amd64"},
    reason="names kernels of OpenBLAS for x86-64",
)


@x86
def test_kernels_of_the_demo(tmp_path):
    pytest.importorskip("pinocchio")
    import bench_kernels as bench

    fits = [
        bench.fit_under(name, "demo", None, tmp_path)
        for name in ("Haswell", "Prescott")
    ]
    _, _, torque = bench.differences(fits)
    assert torque <= bench.TARGET
    # Another kernel adds up in another order: equal to the bit would be the same one.
    assert torque > 0


@x86
def test_kernel_that_did_not_take_effect_is_refused(monkeypatch, tmp_path):
    pytest.importorskip("pinocchio")
    import bench_kernels as bench

    monkeypatch.setitem(bench.KERNELS, "Haswell", ("Prescott",))
    with pytest.raises(RuntimeError, match="did not take effect"):
        bench.fit_under("Haswell", "demo", None, tmp_path)


def test_likelihood_of_the_solvers():
    import bench_likelihood as bench

    fast, plain = (bench.measure(1e3, solver, 0) for solver in bench.SOLVERS)
    assert fast[1] == 1.0
    assert abs(fast[2]) < 1e-9 < plain[2]
    assert fast[4] < 1e-6 < plain[4]


def test_false_alarms_compares_two_versions(tmp_path, monkeypatch):
    pytest.importorskip("pinocchio")
    import bench_false_alarms as bench

    monkeypatch.setattr(bench, "RESIDUALS", {"white": bench.white})
    path = tmp_path / "verdicts.jsonl"
    asked = {"residuals": ["white"], "joints": (1,)}
    made = bench.study(1, 2, results=path, **asked)
    assert bench.read(path) == made
    # What is on file is not made again.
    assert bench.study(1, 2, results=path, **asked) == made
    assert bench.study(1, 2, results=[tmp_path / "other.jsonl", path], **asked) == made
    null, effect = made
    assert null["names"] == null["perhaps"] == []
    assert effect["truth"][0] == "viscous_quadratic"
    assert effect["found"]
    assert [(e["joint"], e["right"]) for e in effect["names"]] == [(0, True)]
    wrong = {"name": "ripple", "joint": 0, "probability": 0.7, "right": False}
    old = [dict(null, names=[wrong]), dict(effect, found=False)]
    for row in bench.rows(made, old):
        assert row[2:6] == [1, "0.0", "0.0", "100.0"]
        assert row[6:] == [1, "100.0", "100.0", 1, "0.0", "100.0"]
    used = [row for row in bench.by_kind(made, old) if row[1]]
    assert used == [["viscous_quadratic", 1, "100.0", "0.0", "100.0"]]
    failed = dict(null, seed=3, error="ValueError: too short")
    text = bench.report([dict(null, perhaps=[wrong]), effect, failed])
    cells = [line.split() for line in text.splitlines()]
    assert ["perhaps,", "0.7", "to", "0.8", "1", "70", "0"] in cells
    assert "Ended in an error: white, 40 s, seed 3, null: ValueError" in text
    # it does not count as a recording without a name
    assert bench.rows([null, failed])[0][2] == 1


def test_false_alarms_of_six_joints(monkeypatch):
    pytest.importorskip("pinocchio")
    import bench_false_alarms as bench
    from _undeclared_span import DeclaredSpan

    monkeypatch.setitem(bench.DURATIONS, 6, 20.0)
    null = bench.recording("white", 6, 0, False)
    assert null.q.shape == null.tau.shape == (2000, 6)
    made = bench.recording("white", 6, 0, True)
    assert made.truth[0] == bench.KINDS[6][0]
    added = made.tau - null.tau
    assert np.flatnonzero(added.any(axis=0)).tolist() == [made.joint]
    coarse = bench.recording(bench.COARSE, 6, 0, False).tau
    for column in coarse.T:
        steps = np.unique(np.diff(np.unique(column)).round(9))
        np.testing.assert_allclose(steps / steps[0], np.round(steps / steps[0]))
    rng = np.random.default_rng([0, 0, 20])
    nominal, _, _, states, _, plain = bench.arm(6, rng)
    span = DeclaredSpan(nominal, states, bench.PLAIN, plain.std(axis=0))
    # nothing is missing, but for the sign of the speed, which turns at once
    assert span.share(plain) < 0.05


@pytest.mark.parametrize("joints", [1, 6])
def test_residuals_of_false_alarms_are_what_they_say(joints):
    """Mean square one over many draws; correlation times of the AR(1) ones."""
    pytest.importorskip("pinocchio")
    import bench_false_alarms as bench

    dt = bench.DT[joints]
    lag = round(0.5 / dt)
    for name, draw in bench.RESIDUALS.items():
        squares, lagged = [], []
        for seed in range(60):
            rng = np.random.default_rng(seed)
            t = np.arange(0, bench.DURATIONS[joints], dt)
            phase = rng.uniform(0, 6)
            q = -0.5 * np.cos(2.0 * t + phase) - np.cos(3.3 * t) / 3.3
            v = np.sin(2.0 * t + phase) + np.sin(3.3 * t)
            x = draw(bench.Seen(t, q, v, 1.0 + 3.0 * q), rng)
            assert x.shape == t.shape
            squares.append(np.mean(x**2))
            lagged.append(np.mean(x[lag:] * x[:-lag]))
        # Four standard errors; slow residuals scatter.
        error = 4 * np.std(squares) / np.sqrt(len(squares))
        assert np.mean(squares) == pytest.approx(1.0, abs=max(error, 0.02)), name
        if name.startswith("AR(1)"):
            constant = float(name.split(", ")[1].removesuffix(" s"))
            expected = np.exp(-0.5 / constant)
            error = 4 * np.std(lagged) / np.sqrt(len(lagged))
            assert np.mean(lagged) == pytest.approx(expected, abs=error), name


def test_calibration_says_how_much_is_right():
    from _perhaps import calibration, counts, stated, undecided

    effects = [
        SimpleNamespace(name="ripple", joint=0, probability=0.55),
        SimpleNamespace(name="spring", joint=1, probability=0.59),
        SimpleNamespace(name="spring", joint=0),
    ]
    loop = SimpleNamespace(perhaps_=effects)
    perhaps = stated(undecided(loop), wrong=[("spring", 1)])
    assert [e["right"] for e in perhaps] == [True, False, True]
    assert undecided(SimpleNamespace()) == ()
    made = {"perhaps": perhaps}
    assert counts([made, {}]) == ["2", "1"]
    cells = [line.split() for line in calibration([made]).splitlines()]
    assert ["perhaps,", "0.5", "to", "0.6", "2", "57", "50"] in cells
    assert ["perhaps,", "0.6", "to", "0.7", "0", "–", "–"] in cells
    assert ["perhaps,", "not", "stated", "1", "–", "100"] in cells
    assert ["named", "0", "–", "–"] in cells


def test_interval_coverage_at_small_size():
    pytest.importorskip("pinocchio")
    import bench_interval_coverage as bench

    cells = [
        *bench.parameters(1, 0, robots=(("Z", 20.0),)),
        *bench.effects(1, 0, chosen=("spring",), duration=40.0),
        *bench.errors(1, 0, durations=(40.0,), noises=("white",)),
    ]
    assert [cell.trials for cell in cells] == [1] * 7
    assert all(cell.width for cell in cells)
    text = bench.report(cells)
    assert "spring: q0" in text
    assert "Pooled: parameters" in text
