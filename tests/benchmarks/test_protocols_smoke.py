"""The frozen protocols run at small size, and measure what they say."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import _manipulations as put
import _protocol_sets as sets
import bench_protocol_emps as emps
import bench_protocol_pairs as pairs
import bench_protocol_truth_put_in as truth
import bench_protocol_tx40 as tx40

from sklearn_vbjfa.datasets import Recording, load_demo_recording

# What comes through a file was jittered on purpose.
pytestmark = pytest.mark.filterwarnings("ignore:.*time stamps are irregular")

HERE = Path(__file__).resolve().parent


@pytest.mark.parametrize("name", ["pairs", "emps", "tx40", "truth_put_in"])
def test_scripts_start_on_their_own(name):
    answer = subprocess.run(
        [sys.executable, str(HERE / f"bench_protocol_{name}.py"), "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=HERE.parent,
    )
    assert "--data-home" in answer.stdout


def part_of(recording, rows):
    """Rows of the demonstration as a plain recording."""
    return Recording(
        name=recording.name,
        q=recording.q[rows],
        tau=recording.tau[rows],
        t=recording.t[rows],
        dt=recording.dt,
        groups=recording.groups[rows],
        group_names=recording.group_names,
        joint_names=recording.joint_names,
        position_units=recording.position_units,
        torque_units=recording.torque_units,
        urdf=recording.urdf,
    )


@pytest.fixture(scope="module")
def demo():
    """Return 8 s of both recordings of the demonstration."""
    recording = load_demo_recording()
    rows = [np.flatnonzero(recording.groups == g)[:1600] for g in (0, 1)]
    return part_of(recording, np.concatenate(rows))


# -- sets and pairs ------------------------------------------------------------------


def test_every_label_is_left_out_once():
    found = sets.pairs(["kp1_a", "kp1_b", "kp2_a"], sets.gain_of_name)
    assert found == [
        ("kp1", ("kp2_a",), ("kp1_a", "kp1_b")),
        ("kp2", ("kp1_a", "kp1_b"), ("kp2_a",)),
    ]
    both_ways = sets.pairs(["A", "B"], sets.own_name)
    assert both_ways == [("A", ("B",), ("A",)), ("B", ("A",), ("B",))]


def test_development_and_confirmation_sets_are_apart():
    by_stage = {
        stage: {n for n, s in sets.PAIRED_SETS.items() if s.stage == stage}
        for stage in sets.STAGES
    }
    assert by_stage["development"] == {"emps", "ur5", "bam_xl330"}
    assert by_stage["confirmation"] == {"kuka_kr300", "dfki_double_pendulum"}


def test_covered_is_a_share_of_the_judged_range():
    fitted = np.array([[0.0, 0.0, 0.0, -1.0], [1.0, 1.0, 1.0, 3.0]])
    judged = np.array([[0.5, 2.0, 0.0, 0.0], [1.5, 3.0, 4.0, 1.0]])
    np.testing.assert_allclose(pairs.covered(fitted, judged), [0.5, 0.0, 0.25, 1.0])


def test_a_joint_that_never_moves_is_not_counted():
    nan = np.full((2, 1), np.nan)
    some = np.array([[0.0], [1.0]])
    scale = pairs.Scale(
        spread=np.ones(1),
        torque={"moves": some, "rests": nan},
        speed={"moves": some, "rests": nan},
    )
    np.testing.assert_array_equal(scale.overlap(("moves", "rests"), ("moves",)), 1.0)
    assert np.isnan(scale.overlap(("moves",), ("rests",))).all()
    assert not (scale.overlap(("moves",), ("rests",)) >= pairs.OVERLAP).any()
    np.testing.assert_array_equal(scale.overlap(("rests",), ("moves",)), 0.0)


@pytest.fixture(scope="module")
def judged_pairs():
    """Judge the demonstration in place of the KR300, both ways."""
    recording = load_demo_recording()
    recording = part_of(recording, slice(None))
    return pairs.run_set("kuka_kr300", recording=recording, effects=["load_friction"])


def test_pairs_are_judged_on_what_was_not_fitted(judged_pairs, demo):
    _, scale, verdicts, failed = judged_pairs
    assert not failed
    assert [v.judged for v in verdicts] == list(demo.group_names)
    for verdict in verdicts:
        assert verdict.effects == ("load_friction 2",)
        # It is there in both recordings, and what remains is noise.
        assert verdict.after[1] < 0.5 * verdict.before[1]
        # The other motion asks for inertias that the fitted one does not show.
        assert np.median(verdict.ratio) == pytest.approx(1.0, abs=0.25)
        np.testing.assert_allclose(
            verdict.after / verdict.reported_after, verdict.ratio
        )
    assert scale.spread.shape == (6,)


def test_intervals_are_those_of_the_report(judged_pairs):
    _, scale, verdicts, _ = judged_pairs
    for verdict in verdicts:
        low, high = verdict.difference
        gain = verdict.reported_after - verdict.reported_before
        assert ((low <= gain) & (gain <= high)).all()
        assert ((verdict.width > 1.0) & (verdict.width < 2.0)).all()
        assert not verdict.surely_worse[1]
        worse = replace(verdict, after=verdict.before + 0.6 * (high - low))
        assert worse.surely_worse.all()
        # Reported in N m: a few per cent of the torque of the set.
        assert (verdict.reported_after < 0.1 * scale.spread).all()


def test_spread_of_the_set_counts_what_moves(demo):
    identifier = sets.PAIRED_SETS["kuka_kr300"].identifier(demo.robot_model(), demo.dt)
    scale = pairs.measure_scale(demo, identifier)
    found = identifier.fit(demo.q, demo.tau, groups=demo.groups).residuals(
        demo.q, demo.tau, groups=demo.groups
    )
    expected = found.rms() / found.normalised_error()
    np.testing.assert_allclose(scale.spread, expected, rtol=1e-6)
    first, second = demo.group_names
    both = scale.overlap((first, second), (first,))
    np.testing.assert_allclose(both, 1.0)
    assert (scale.overlap((first,), (second,)) <= 1.0).all()


def test_section_lists_what_is_not_counted(judged_pairs):
    recording, scale, verdicts, _ = judged_pairs
    narrow = replace(verdicts[0], overlap=np.full((2, 6), 0.79))
    text = "\n".join(
        pairs.section("kuka_kr300", recording, scale, [narrow, verdicts[1]], ["x: y"])
    )
    assert f"{narrow.judged} j1" in text.partition("Not counted")[2]
    assert "Failed: x: y" in text
    total = pairs.summary("kuka_kr300", [narrow, verdicts[1]], scale.spread)
    assert total[1] == "12"
    assert int(total[2]) == verdicts[1].counted.sum()
    worst = 100 * (verdicts[1].after / scale.spread)[verdicts[1].counted].max()
    assert total[5] == f"{worst:.1f}"


# -- EMPS ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def slide():
    """Simulate a slide: M a + Fv v + Fc sign v + offset, two motions."""
    dt, n = 0.001, 6000
    rng = np.random.default_rng(0)
    t = dt * np.arange(n)
    q, tau = [], []
    for frequency in (1.3, 1.7):
        w = 2 * np.pi * np.array([frequency, 2.3 * frequency])
        amplitude = np.array([0.05, 0.02])
        phase = w * t[:, None]
        v = (amplitude * w * np.cos(phase)).sum(axis=1)
        a = -(amplitude * w**2 * np.sin(phase)).sum(axis=1)
        noise = rng.normal(size=(2, n))
        q.append((amplitude * np.sin(phase)).sum(axis=1) + 1e-7 * noise[0])
        force = 95.0 * a + 200.0 * v + 20.0 * np.sign(v) - 3.0
        tau.append(force + 0.5 * noise[1])
    return Recording(
        name="emps",
        q=np.concatenate(q)[:, None],
        tau=np.concatenate(tau)[:, None],
        t=np.tile(t, 2),
        dt=dt,
        groups=np.repeat([0, 1], n),
        group_names=(emps.FITTED, emps.JUDGED),
        joint_names=("slide",),
        position_units=("m",),
        torque_units=("N",),
    )


def test_authors_least_squares_finds_the_slide(slide):
    rows, theta, errors, loop = emps.measure(slide, effects=["spring"])
    np.testing.assert_allclose(theta, [95.0, 200.0, 20.0, -3.0], rtol=0.02, atol=0.3)
    assert max(errors) < 2.0
    assert not loop.effects_
    found = {row[0]: [float(x) for x in row[2:]] for row in rows if row[1] == "theirs"}
    assert max(found["EffectDiscovery, completed model"]) < 2.0


def test_decimation_keeps_the_last_row_of_each_ten():
    n = 24841
    ramp = np.arange(n, dtype=float)
    kept = emps.decimate(ramp)
    assert kept.size == -(-(n - emps.BORDER) // 10)
    # The ripple of the filter, passed in both directions, is 0.05 dB at rest.
    kept = kept[200:-200] * 10 ** (2 * 0.05 / 20)
    np.testing.assert_allclose(np.diff(kept), 10.0, atol=0.01)
    np.testing.assert_allclose((kept + 5) % 10, 5 + (n - 1) % 10, atol=0.05)


def test_authors_figures_are_reproduced(measured_data_home):
    from sklearn_vbjfa.datasets import fetch_emps

    recording = fetch_emps(data_home=measured_data_home, download_if_missing=False)
    parts = [recording.select(name) for name in (emps.FITTED, emps.JUDGED)]
    states = [emps.authors_states(part.q[:, 0], part.dt) for part in parts]
    theta = emps.authors_least_squares(states[0], parts[0].tau[:, 0])
    np.testing.assert_allclose(theta, list(emps.PUBLISHED.values()), atol=5e-4)
    errors = [
        emps.relative_error(part.tau[:, 0], emps.authors_columns(x) @ theta)
        for part, x in zip(parts, states)
    ]
    np.testing.assert_allclose(errors, emps.PUBLISHED_ERRORS, atol=0.005)


# -- TX40 ----------------------------------------------------------------------------


def test_tx40_protocol_on_the_demo(monkeypatch):
    recording = load_demo_recording()
    monkeypatch.setattr(tx40, "FITTED", slice(0, 4000))
    monkeypatch.setattr(tx40, "JUDGED", slice(4000, 8000))
    monkeypatch.setattr(tx40, "COMPARED", np.linspace(100, 3899, 60).astype(int))
    loop = tx40.fit_loop(recording, effects=["load_friction"])
    text = tx40.report(recording, loop)
    assert "FIGAROH, as published" in text
    assert "6.40" in text
    found = tx40.measure(recording, loop)
    before, after = found["declared model"], found["completed by EffectDiscovery"]
    assert after[1] < 0.8 * before[1]
    missed = (recording.tau[4000:] - loop.predict(recording.q[4000:]))[tx40.COMPARED]
    np.testing.assert_allclose(after, np.sqrt((missed**2).mean(axis=0)))
    filtered = tx40.filtered_prediction(
        loop.identifier_, recording.q[4000:], recording.tau[4000:]
    )
    assert filtered.shape == (4000, 6)
    found = loop.identifier_.residuals(recording.q[4000:], recording.tau[4000:])
    np.testing.assert_allclose(filtered[found.index], found.predicted)


def test_figaroh_is_judged_by_the_same_rows(demo, monkeypatch):
    import bench_figaroh

    ran = []

    def run_script(row, python, urdf, parts, settings):
        assert settings.is_file()
        ran.append(row.label)
        held_out = parts[1]
        return bench_figaroh.Outcome(
            predicted=held_out["tau"] - 2.0, said="", seconds=0, seconds_with_import=0
        )

    monkeypatch.setattr(bench_figaroh, "run_script", run_script)
    monkeypatch.setattr(tx40, "JUDGED", slice(1600, 3200))
    monkeypatch.setattr(tx40, "COMPARED", np.arange(10))
    found = tx40.measure_figaroh(demo, "python")
    assert list(found) == ran
    assert all("coupled" in label and "FIGAROH" in label for label in ran)
    for values in found.values():
        np.testing.assert_allclose(values, 2.0)


def test_tx40_rows_are_those_of_the_protocol():
    assert (tx40.FITTED.start, tx40.FITTED.stop) == (0, 24750)
    assert (tx40.JUDGED.start, tx40.JUDGED.stop) == (29250, 45000)
    assert tx40.COMPARED.size == 600
    assert tx40.COMPARED[[0, -1]].tolist() == [100, 15649]


# -- truth put in --------------------------------------------------------------------


def test_gravity_is_rotated_in_a_copy(demo):
    model = demo.robot_model()
    turned = put.rotate_gravity(model, 30.0)
    g = np.linalg.norm(model.gravity.linear)
    np.testing.assert_allclose(model.gravity.linear, [0, 0, -g])
    np.testing.assert_allclose(
        turned.gravity.linear, [0, g * 0.5, -g * np.sqrt(0.75)], atol=1e-12
    )
    np.testing.assert_allclose(
        put.rotate_gravity(model, 30.0, axis=2).gravity.linear, model.gravity.linear
    )


def test_channels_are_changed_in_a_copy():
    q = np.arange(6.0).reshape(3, 2)
    shifted, scaled = put.shift_zero(q, 1, 180.0), put.scale_channel(q, 0, 1.5)
    np.testing.assert_allclose(shifted - q, [[0, np.pi]] * 3)
    np.testing.assert_allclose(scaled[:, 0], 1.5 * q[:, 0])
    np.testing.assert_array_equal(scaled[:, 1], q[:, 1])
    np.testing.assert_array_equal(q, np.arange(6.0).reshape(3, 2))


def test_friction_is_multiplied_along_the_temperature():
    v = np.array([-2.0, -0.001, 0.0, 0.001, 2.0])
    friction = put.friction_of_speed(v, 3.0, 10.0, 0.01)
    np.testing.assert_allclose(friction, [-16.0, -1.003, 0.0, 1.003, 16.0])
    temperature = np.array([20.0, 20.0, 30.0, 45.0, 45.0])
    heated = put.heat_friction(np.zeros((5, 2)), 1, friction, temperature, -0.02)
    np.testing.assert_allclose(heated[:, 0], 0.0)
    np.testing.assert_allclose(heated[:, 1], [0, 0, 0, -0.5 * 1.003, -8.0])


def test_temperature_rises_and_falls():
    temperature = put.made_up_temperature(1001)
    assert temperature[0] == pytest.approx(20.0)
    assert temperature.max() == pytest.approx(45.0)
    assert (np.diff(temperature) > 0).any()
    assert (np.diff(temperature) < 0).any()


def test_jittered_stamps_keep_their_order():
    t = 0.01 * np.arange(5000)
    late = put.jitter_stamps(t, 0.01, 0.2, np.random.default_rng(0)) - t
    assert late.std() == pytest.approx(0.002, rel=0.05)
    assert np.abs(late).max() <= 0.0045 + 1e-9
    assert (np.diff(t + late) > 0).all()


def test_lost_rows_leave_no_gap():
    groups = np.repeat([0, 1], [3000, 2000])
    rows = put.keep_rows(groups, 0.3, np.random.default_rng(0))
    assert 0.7 < rows.size / groups.size < 0.85
    assert set(rows) >= {0, 2999, 3000, 4999}
    assert np.diff(rows).max() == 2


@pytest.fixture(scope="module")
def answers(demo):
    """Put two kinds of faults into the demonstration, and search for one effect."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(truth, "SHIFTS", (4.0,))
        return truth.run_set(
            "ur5", kinds=["zero", "stamps"], recording=demo, effects=["load_friction"]
        )


def test_cases_begin_with_the_recording_as_it_is(answers):
    found, recording = answers
    assert [a.case.kind for a in found] == [truth.UNTOUCHED, "zero", "stamps"]
    assert found[0].names() == [("load_friction", 1)]
    assert found[0].case.q is recording.q
    shift = found[1].case.q - recording.q
    np.testing.assert_allclose(shift[:, truth.JOINT], np.deg2rad(4.0))
    assert found[1].case.value == pytest.approx(np.deg2rad(4.0))
    rows = [truth.row(answer, found[0]) for answer in found]
    assert {len(row) for row in rows} == {len(truth.HEADERS)}
    columns = [truth.HEADERS.index(f"as recorded, {x}") for x in ("before", "after")]
    expected = [f"{x[truth.JOINT]:.3f}" for x in (found[0].before, found[0].after)]
    assert [rows[1][column] for column in columns] == expected
    text = "\n".join(truth.section("ur5", found, recording))
    assert "position 3 shifted by 4 degrees" in text
    assert "joint_zero 3, 0.06981" in text


def test_a_shifted_zero_costs_and_jittered_stamps_do_not(answers):
    found, _ = answers
    error = [np.mean(a.after / a.spread) for a in found]
    assert error[1] > 1.1 * error[0]
    assert error[2] < 1.1 * error[0]


def test_every_case_is_made(demo):
    identifier = sets.MANIPULATED_SETS["ur5"].identifier(demo.robot_model(), demo.dt)
    identifier.fit(demo.q, demo.tau, groups=demo.groups)
    found = list(truth.cases(demo, identifier))
    assert {case.kind for case in found} == {truth.UNTOUCHED, *truth.EXPECTED}
    assert len(found) == 1 + 3 + 3 + 4 + 1 + 1 + 1
    heated = next(case for case in found if case.kind == "temperature")
    change = heated.tau - demo.tau
    assert np.abs(np.delete(change, heated.joint, axis=1)).max() == 0.0
    assert heated.signals["temperature"].shape == (demo.n_samples,)
    assert heated.value < 0
    rows = found[-1]
    assert rows.tau.shape == demo.tau.shape
    # Interpolated where a row was lost, as recorded elsewhere.
    same = (np.abs(rows.tau - demo.tau) < 1e-9).all(axis=1)
    assert 0.9 < same.mean() < 0.98


class Named:
    """An effect as the report gives it."""

    def __init__(self, name, joint, **parameters):
        self.name, self.joint, self.parameters = name, joint, parameters


@pytest.mark.parametrize(
    ("kind", "joint", "value", "effects", "expected"),
    [
        ("zero", 2, 0.07, [Named("joint_zero", 2, zero=-0.071)], "named"),
        ("zero", 2, 0.07, [Named("joint_zero", 2, zero=0.03)], "named, value off"),
        ("zero", 2, 0.07, [Named("joint_zero", 1, zero=0.07)], "misnamed"),
        ("zero", 2, 0.07, [Named("load_friction", 1)], "not named"),
        ("gain", 2, 1.25, [Named("torque_gain", 2, gain=1.24)], "named"),
        ("gain", 2, 1.25, [Named("torque_gain", 2, gain=1.0)], "named, value off"),
        ("tilt", None, 0.05, [Named("base_tilt", 0, roll=0.04, pitch=0.03)], "named"),
        ("temperature", 1, -0.2, [Named("signal", 1)], "named"),
        ("rows", None, np.nan, [Named("load_friction", 1)], "nothing added"),
        ("rows", None, np.nan, [], "names gone"),
        ("rows", None, np.nan, [Named("spring", 0)], "other names"),
    ],
)
def test_verdicts(kind, joint, value, effects, expected):
    empty = np.zeros((0, 1))
    same = {"q": empty, "tau": empty, "groups": empty[:, 0], "model": None}
    reference = truth.Answer(
        case=truth.Case(kind=truth.UNTOUCHED, label="", **same),
        effects=(Named("load_friction", 1),),
    )
    case = truth.Case(kind=kind, label="", joint=joint, value=value, **same)
    answer = truth.Answer(case=case, effects=tuple(effects))
    assert truth.verdict(answer, reference)[0] == expected


def test_a_refused_recording_is_a_row(demo):
    identifier = sets.MANIPULATED_SETS["ur5"].identifier(demo.robot_model(), demo.dt)
    case = truth.Case(
        kind="gain",
        label="joint 3 cut off",
        q=demo.q,
        tau=put.scale_channel(demo.tau, 2, 0.0),
        groups=demo.groups,
        model=demo.robot_model(),
        joint=2,
        value=0.0,
    )
    answer = truth.close(case, identifier)
    assert "constant" in answer.message
    assert truth.verdict(answer, answer)[0] == "refused"
    assert answer.message in truth.row(answer, answer)
    assert len(truth.row(answer, answer)) == len(truth.HEADERS)


def test_totals_count_verdicts():
    text = truth.totals([("zero", "named"), ("zero", "misnamed"), ("zero", "named")])
    last = next(line for line in text.splitlines() if line.startswith("zero"))
    assert last.split() == ["zero", "joint_zero", "2", "1"]
