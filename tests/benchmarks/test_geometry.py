"""Faults are what their conventions say, and what is told apart can be told apart."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import _undeclared_arms as arms
import _undeclared_faults as faults
import _undeclared_geometry as geometry
import _undeclared_told_apart as told_apart
import bench_geometry as bench
import bench_geometry_time as times
import bench_geometry_truth_put_in as put_in
import pinocchio as pin
from _undeclared_faults import Fault
from scipy.stats import norm
from test_protocols_smoke import part_of

from sklearn_vbjfa.datasets import load_demo_recording

SHORT = {"duration": 12.0, "rate": 100.0}


def pendulum(mass=2.0, length=0.5):
    """Build a mass on a rod that hangs down at zero and turns about y."""
    model = pin.Model()
    index = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "swing")
    body = pin.Inertia(mass, np.array([0.0, 0.0, -length]), np.zeros((3, 3)))
    model.appendBodyToJoint(index, body, pin.SE3.Identity())
    return model


def still_torque(model, q, *wrong):
    q = np.atleast_2d(np.asarray(q, dtype=float))
    none = np.zeros_like(q)
    return faults.rigid_torque(model, q, none, none, wrong)[0]


# -- conventions ---------------------------------------------------------------------


def test_a_tilted_pendulum_hangs_off_its_zero():
    model, m, g, length = pendulum(), 2.0, 9.81, 0.5
    for q, pitch in ((0.0, 0.1), (0.3, -0.2)):
        tilt = Fault("base_tilt", 0, (0.0, pitch))
        # gravity turned by the pitch is the joint turned back by it
        expected = m * g * length * np.sin(q - pitch)
        np.testing.assert_allclose(still_torque(model, [q], tilt), expected)
    roll = Fault("base_tilt", 0, (0.25, 0.0))
    expected = m * g * length * np.sin(0.3) * np.cos(0.25)
    np.testing.assert_allclose(still_torque(model, [0.3], roll), expected)


def test_tilt_is_roll_then_pitch_of_the_base():
    model = pendulum()
    tilted = faults.with_faults(model, [Fault("base_tilt", 0, (0.1, -0.2))])
    R = pin.rpy.rpyToMatrix(0.1, -0.2, 0.0)
    np.testing.assert_allclose(tilted.gravity.linear, R @ model.gravity.linear)
    np.testing.assert_allclose(model.gravity.linear, [0, 0, -9.81])


def test_an_encoder_with_a_zero_reads_too_much():
    model = pendulum()
    zero = Fault("joint_zero", 0, (0.07,))
    read = np.array([0.4])
    expected = 2.0 * 9.81 * 0.5 * np.sin(0.4 - 0.07)
    np.testing.assert_allclose(still_torque(model, read, zero), expected)
    np.testing.assert_allclose(faults.zeros_of([zero], 1), [0.07])


def test_a_wrong_axis_turns_what_the_joint_carries():
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    far = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addJoint(first, pin.JointModelRY(), far, "second")
    a = 0.2
    wrong = faults.with_faults(model, [Fault("joint_axis", 0, (0.0, a))])
    data = wrong.createData()
    pin.forwardKinematics(wrong, data, np.zeros(2), np.array([1.0, 0.0]))
    # turned about y: z leans to x, and what was at x is lower
    np.testing.assert_allclose(data.v[1].angular, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(
        data.oMi[1].rotation @ data.v[1].angular, [np.sin(a), 0, np.cos(a)]
    )
    np.testing.assert_allclose(data.oMi[2].translation, [np.cos(a), 0, -np.sin(a)])
    # of a joint about y the axes across are x and z, in this order
    np.testing.assert_array_equal(arms.axes_across(model, 1), np.eye(3)[[0, 2]])


def test_axes_across_are_square_to_any_axis():
    model = arms.arm("skewed", np.random.default_rng(0))
    assert [arms.is_aligned(model, j) for j in range(6)] == [1, 1, 0, 1, 0, 1]
    across = arms.axes_across(model, 2)
    axis = model.joints[3].extract().axis
    np.testing.assert_allclose(across @ across.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(across @ axis, 0.0, atol=1e-12)


@pytest.mark.parametrize("name", arms.ARMS)
def test_arms_are_built_as_said(name):
    model = arms.arm(name, np.random.default_rng(1))
    assert model.nv == len(arms.ARMS[name][0])
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nv))
    first = data.oMi[1].rotation @ arms_axis(model, 0)
    horizontal = name in ("on a wall", "shoulder")
    assert (abs(first[2]) < 1e-9) == horizontal
    assert all(
        np.linalg.eigvalsh(body.inertia).min() > 0 for body in model.inertias[1:]
    )


def arms_axis(model, joint):
    return np.cross(*arms.axes_across(model, joint))


# -- recordings ----------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["tilt", "zero", "axis", "gain", "two"])
def test_right_geometry_explains_the_torque_and_the_declared_does_not(kind):
    recording = geometry.simulate(kind, seed=(0, 7), arm_name="shoulder", **SHORT)
    assert recording.visible
    assert len(recording.truth) == (2 if kind == "two" else 1)
    teller = recording.teller()
    known = [fault.key for fault in recording.faults]
    right = teller.explain(known, start=recording.faults)
    assert right.distance < 1e-6
    assert teller.explain([]).rms >= geometry.VISIBLE
    # from no knowledge of the values
    found = teller.explain(known)
    for fault, true in zip(found.faults, recording.faults):
        np.testing.assert_allclose(fault.values, true.values, atol=1e-5)
    for entry in recording.truth:
        assert entry.size >= geometry.LEAST


def test_the_joint_moves_and_the_encoder_adds_its_zero():
    recording = geometry.simulate("zero", seed=(0, 1), arm_name="staubli", **SHORT)
    (fault,) = recording.faults
    model, q, tau = recording.put_right()
    assert model.gravity == recording.model.gravity
    shift = np.median(recording.q - q, axis=0)
    expected = np.zeros(6)
    expected[fault.joint] = fault.values[0]
    np.testing.assert_allclose(shift, expected, atol=1e-12)
    np.testing.assert_array_equal(tau, recording.tau)
    noise = recording.q - recording.states[:, :6]
    assert np.abs(noise).max() < 1e-3


def test_a_gain_scales_friction_and_all():
    recording = geometry.simulate("gain", seed=(0, 1), arm_name="ur", **SHORT)
    (fault,) = recording.faults
    _, _, tau = recording.put_right()
    ratio = recording.tau / tau
    expected = np.ones(6)
    expected[fault.joint] = fault.values[0]
    np.testing.assert_allclose(ratio, np.tile(expected, (len(tau), 1)))


def test_all_gains_but_one_are_scaled():
    recording = geometry.simulate("gains", seed=(0, 1), **SHORT)
    nv = recording.model.nv
    gains = faults.gains_of(recording.faults, nv)
    assert gains[recording.reference] == 1.0
    assert np.sum(gains != 1.0) == geometry.SCALED
    assert len(recording.truth) == nv - 1
    assert np.all((gains >= 0.5) & (gains <= 2.0))


def test_friction_falls_with_the_temperature():
    recording = geometry.simulate("signal", seed=(0, 1), arm_name="ur", **SHORT)
    (entry,) = recording.truth
    warm = recording.signals["temperature"]
    assert warm[-100:].mean() > warm[:100].mean() + 5
    torque = recording.further[:, entry.joint]
    # the fall is a share of the friction, which opposes the motion
    v = recording.states[:, 6 + entry.joint]
    assert np.all(torque * v <= 1e-12)
    # nothing is missing when cold
    first, last = torque[: len(torque) // 20], torque[-len(torque) // 4 :]
    assert np.abs(first).max() < 0.5 * np.abs(last).max()
    assert first[0] == 0.0
    others = np.delete(recording.further, entry.joint, axis=1)
    assert not others.any()


def test_a_seed_gives_one_recording():
    one, two, other = (
        geometry.simulate("axis", seed=(seed, 2), **SHORT) for seed in (0, 0, 1)
    )
    assert one.truth == two.truth
    np.testing.assert_array_equal(one.tau, two.tau)
    assert one.truth != other.truth


# -- what can be told apart ------------------------------------------------------------


def teller_of(name, *wrong):
    """Return what a short motion of an arm with given faults tells."""
    rng = np.random.default_rng(5)
    body = geometry._robot(rng, name, **SHORT)
    read, clean = geometry._channels(body, wrong, np.zeros_like(body.q))
    return told_apart.Teller(
        body.nominal,
        np.hstack([read, body.v, body.a]),
        clean,
        geometry.NOISE * clean.std(axis=0),
        geometry.FRICTION,
    )


def test_what_a_vertical_first_axis_hides_and_shows():
    # neither the zero of a vertical first axis nor the last joint's changes a torque
    for joint in (0, 5):
        hidden = teller_of("staubli", Fault("joint_zero", joint, (0.07,)))
        assert hidden.explain([]).rms < 1e-6
    shown = teller_of("on a wall", Fault("joint_zero", 0, (0.07,)))
    assert shown.explain([]).rms > geometry.VISIBLE
    # a common gain is another size of everything
    gains = [Fault("torque_gain", j, (1.3,)) for j in range(6)]
    assert teller_of("ur", *gains).explain([]).rms < 1e-6


def test_a_tilt_is_the_first_axis_of_an_upright_arm():
    tilt = Fault("base_tilt", 0, (0.05, -0.03))
    rivals = teller_of("ur", tilt).rivals(tilt)
    assert set(rivals) == {("joint_axis", 0)}
    # on a wall the first joint's zero is a part of it only
    assert ("joint_zero", 0) not in teller_of("on a wall", tilt).rivals(tilt)
    turn = Fault("base_tilt", 0, (0.05, 0.0))
    zero = Fault("joint_zero", 0, (0.05,))
    wall = teller_of("on a wall", zero)
    assert ("base_tilt", 0) in wall.rivals(zero)
    assert turn.parameters == {"roll": 0.05, "pitch": 0.0}


def test_distance_is_in_units_of_the_noise():
    tilt = Fault("base_tilt", 0, (0.05, -0.03))
    teller = teller_of("ur", tilt)
    near = teller.explain([]).distance
    teller.noise = 3.0 * teller.noise
    teller.y = teller.y / 3.0
    assert teller.explain([]).distance == pytest.approx(near / 3.0)
    # half of the distance away the likelihoods are equal
    assert norm.cdf(-0.5 * told_apart.SEPARATE) == pytest.approx(told_apart.CONFUSED)


def test_standard_errors_are_those_of_repeated_noise():
    zero = Fault("joint_zero", 2, (0.05,))
    teller = teller_of("staubli", zero)
    (std,) = teller.explain([zero.key], start=[zero]).std
    rng, clean, values = np.random.default_rng(0), teller.y, []
    for _ in range(30):
        # noise of the rows that are looked at, as strong as that of all of them
        teller.y = clean + rng.normal(size=clean.size) / teller.weight
        values.append(teller.explain([zero.key], start=[zero]).faults[0].values[0])
    assert np.std(values) == pytest.approx(std[0], rel=0.4)
    assert np.mean(values) == pytest.approx(0.05, abs=4 * std[0] / np.sqrt(30))


@pytest.mark.parametrize("script", [bench, put_in, times])
def test_scripts_say_what_they_take(script, capsys):
    with pytest.raises(SystemExit) as stopped:
        script.main(["--help"])
    assert stopped.value.code == 0
    assert "--write" in capsys.readouterr().out


# -- judging -------------------------------------------------------------------------


def effect(name, joint, rivals=(), intervals=None, **parameters):
    return SimpleNamespace(
        name=name,
        joint=joint,
        rivals=rivals,
        parameters=parameters,
        intervals=intervals or {},
        evidence=SimpleNamespace(gain=0.5),
        log_odds=14.0,
    )


@pytest.fixture(scope="module")
def tilted():
    return geometry.simulate("tilt", seed=(0, 0), arm_name="ur", **SHORT)


def test_names_of_the_class_count(tilted):
    (entry,) = tilted.truth
    assert ("joint_axis", 0) in entry.rivals
    named, by_class, faulty, others, standing = bench.judge(
        tilted, [effect("base_tilt", 0), effect("offset", 1)]
    )
    assert (named, by_class, faulty, others) == ([True], [False], [], [("offset", 1)])
    assert standing[("base_tilt", 0)].parameters == pytest.approx(entry.parameters)
    named, by_class, faulty, _, standing = bench.judge(
        tilted, [effect("joint_axis", 0)]
    )
    assert (named, by_class, faulty) == ([True], [True], [])
    # R is the tilt, and the axis of an upright arm leans the other way
    roll, pitch = entry.parameters.values()
    assert standing[("joint_axis", 0)].values == pytest.approx([-roll, -pitch], rel=0.1)
    # the two of them are one too many
    both = [effect("base_tilt", 0), effect("joint_axis", 0)]
    assert bench.judge(tilted, both)[2] == [("joint_axis", 0)]


def test_wrong_names_are_counted(tilted):
    found = [effect("joint_zero", 3), effect("spring", 2, ("ripple",))]
    named, _, faulty, others, standing = bench.judge(tilted, found)
    assert (named, faulty, others) == ([False], [("joint_zero", 3)], [("spring", 2)])
    assert standing == {}
    by_rival = bench.judge(tilted, [effect("offset", 3, ("base_tilt",))])
    assert by_rival[:4] == ([True], [True], [], [])


def test_rivals_are_on_their_own_joint_or_on_one_that_is_named():
    rivals = ("ripple", "joint_axis on joint_5", "base_tilt")
    pairs = bench.rivals_of(effect("spring", 2, rivals), ["joint_4", "joint_5"])
    assert pairs == [("ripple", 2), ("joint_axis", 1), ("base_tilt", 0)]


def test_intervals_are_judged(tilted):
    (entry,) = tilted.truth
    true = entry.parameters
    good = {name: (x - 0.01, x + 0.01) for name, x in true.items()}
    bad = {**good, "pitch": (true["pitch"] + 0.01, true["pitch"] + 0.02)}
    found = [effect("base_tilt", 0, (), good, **true)]
    standing = bench.judge(tilted, found)[4]
    rows = bench.judge_values(tilted, found, standing)
    assert [row["inside"] for row in rows] == [True, True]
    found = [effect("base_tilt", 0, (), bad, **true)]
    rows = bench.judge_values(tilted, found, standing)
    assert [row["inside"] for row in rows] == [True, False]
    # no interval where the recording tells the value is a miss
    found = [effect("base_tilt", 0, (), {}, **true)]
    rows = bench.judge_values(tilted, found, standing)
    assert [row["inside"] for row in rows] == [False, False]


def test_a_case_is_judged_from_end_to_end():
    given = {"arm_name": "ur", **SHORT}
    task = {"kind": "tilt", "seed": 0}
    result = bench.run(task, given, effects=["offset"], max_effects=1)
    assert result["named"] == [False]
    assert not result["wrong_faults"]
    ratio = np.array(result["before"]) / np.array(result["floor"])
    # the right geometry has nothing left of what the tilt does
    assert ratio.max() > 1.5
    assert "MISSED" in bench.line(result)
    hidden = {**result, "seed": 1, "visible": False}
    assert "not visible" in bench.line(hidden)
    text = bench.report([result, hidden])
    assert "offset 1" in text or "nothing 1" in text
    tasks = bench.tasks_of(["tilt", "none"], 3, 2)
    assert [task["seed"] for task in tasks] == [3, 3, 4, 4]


def test_a_tilt_is_named_and_valued():
    given = {"arm_name": "ur", **SHORT}
    task = {"kind": "tilt", "seed": 0}
    result = bench.run(task, given, effects=["base_tilt", "offset"], max_effects=1)
    assert result["named"] == [True]
    assert not result["wrong_faults"]
    assert not result["wrong_others"]
    for row in result["values"]:
        assert row["value"] == pytest.approx(row["true"], abs=np.deg2rad(0.3))
    ratio = np.array(result["after"]) / np.array(result["floor"])
    assert ratio.max() < 1.3
    assert ": named" in bench.line(result)


def test_gains_of_all_channels_are_fitted():
    given = {"arm_name": "ur", **SHORT}
    result = bench.run({"kind": "gains", "seed": 0}, given)
    gains = result["gains"]
    assert len(gains) == 5
    # 12 s leave the gains open to one or two per cent
    off = [abs(gain["value"] / gain["true"] - 1.0) for gain in gains]
    assert max(off) < 0.1
    text = bench.report([result])
    assert f"{100 * np.median(off):.2f} %" in text
    assert f"of {len(gains)} gains" in bench.line(result)


# -- real recordings -------------------------------------------------------------------


@pytest.fixture(scope="module")
def demo():
    recording = load_demo_recording()
    rows = [np.flatnonzero(recording.groups == g)[:1200] for g in (0, 1)]
    return part_of(recording, np.concatenate(rows))


def test_what_is_put_in_is_what_should_be_said(demo):
    model = demo.robot_model()
    for label, fault, change in (put_in._tilted(4.0, 1), put_in._tilted(2.0, 0)):
        turned, _, _ = change(model, demo.q, demo.tau)
        # with what should be said of it, the model that is handed over is right again
        righted = faults.with_faults(turned, [fault])
        np.testing.assert_allclose(
            righted.gravity.linear, model.gravity.linear, atol=1e-12
        )
        assert "degrees" in label
    _, fault, change = put_in._shifted(1)
    _, q, _ = change(model, demo.q, demo.tau)
    shift = faults.zeros_of([fault], demo.nv)
    np.testing.assert_allclose(q - demo.q, np.tile(shift, (len(q), 1)), atol=1e-12)


def test_faults_are_put_in_and_judged(demo, monkeypatch):
    frozen = replace(put_in.MANIPULATED_SETS["ur5"], friction=("viscous", "coulomb"))
    monkeypatch.setitem(put_in.MANIPULATED_SETS, "ur5", frozen)
    results = put_in.run_set(
        "ur5", recording=demo, limit=1, effects=["offset"], max_effects=1
    )
    assert results[0]["label"] == put_in.UNTOUCHED
    assert results[1]["fault"][0] == "base_tilt"
    assert results[1]["seen"] > 0
    text = put_in.report({"ur5": results})
    assert "gravity of the model rotated by 2 degrees about x" in text


def test_zeros_are_ordered_by_what_shows(demo):
    model = demo.robot_model()
    nv = demo.nv
    v = np.gradient(demo.q, demo.dt, axis=0)
    a = np.gradient(v, demo.dt, axis=0)
    states = np.hstack([demo.q, v, a])
    rest = 0.1 * demo.tau.std(axis=0)
    declared = ("viscous", "rotor_inertia")
    seen = put_in.visibility(model, states, demo.tau, declared, rest)
    chosen = put_in.cases(model, seen)
    zeros = [c for c in chosen if c.fault.name == "joint_zero"]
    assert [c.seen for c in zeros] == sorted((c.seen for c in zeros), reverse=True)
    assert zeros[-1].expected == "hidden"
    assert zeros[-1].fault.joint in (0, nv - 1)
    assert sum(c.fault.name == "base_tilt" for c in chosen) == 4


@pytest.mark.parametrize(
    ("found", "own", "expected", "hidden", "text"),
    [
        ([("joint_zero", 2, [0.11])], [], "shown", False, "named"),
        ([("joint_zero", 2, [-0.1])], [], "shown", False, "named, value off"),
        ([("joint_zero", 2, [0.14])], [0.04], "shown", False, "named"),
        ([("joint_zero", 1, [0.1])], [], "shown", False, "misnamed"),
        ([("offset", 1, [])], [], "shown", False, "not named"),
        ([], [], "hidden", True, "invisible"),
        ([], [], "hidden", False, "not named, not called invisible"),
        ([("joint_zero", 1, [0.1])], [], "hidden", True, "named though hidden"),
        ([], [], "either", False, "not named"),
    ],
)
def test_verdicts(found, own, expected, hidden, text):
    named = [
        {"name": name, "joint": joint, "values": values, "rivals": []}
        for name, joint, values in found
    ]
    before = [{"name": "joint_zero", "joint": 2, "values": own, "rivals": []}]
    case = {
        "fault": Fault("joint_zero", 2, (0.1,)),
        "expected": expected,
        "hidden": hidden,
    }
    answer = {"message": "", "found": named}
    reference = {"found": before if own else []}
    said, right = put_in.verdict(case, answer, reference)
    assert said == text
    good = {"named", "invisible"} | ({"not named"} if expected == "either" else set())
    assert right == (text in good)


def test_time_is_compared():
    recording = times.load("demo", seconds=6.0)
    row = times.row("demo", recording, old=["coulomb"], new=["coulomb", "offset"])
    assert len(row) == len(times.HEADERS)
    assert float(row[times.HEADERS.index("ratio")]) > 0
    assert not set(times.without()) & set(times.NEW)
