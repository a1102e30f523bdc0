"""Faults of whole logs: kind and size; no findings in logs without faults."""

import re

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa.datasets import load_demo_recording, make_robot_recording
from sklearn_vbjfa.inspection import inspect_channels
from tests._quick import one_in
from tests.effects._arms import arm, inverse_dynamics, motion
from tests.model.test_followers import joint, link


@pytest.fixture(scope="module")
def log():
    """One recording of the demonstration arm, its model and gravity torques."""
    recording = load_demo_recording().select(0)
    model = recording.robot_model()
    data = model.createData()
    weight = [pin.computeGeneralizedGravity(model, data, q).copy() for q in recording.q]
    return recording, model, np.array(weight)


def faults_of(log, q=None, tau=None, model=None):
    """Return the kinds of the findings that are not notes, and all findings."""
    recording, described, _ = log
    q, tau = recording.q if q is None else q, recording.tau if tau is None else tau
    findings = inspect_channels(model or described, q, tau, recording.dt)
    return [x.kind for x in findings if x.severity != "note"], findings


def replaced(channels, rows, joints, values):
    """Return a copy of channels (n, nv) with some values replaced."""
    channels = channels.copy()
    channels[rows, joints] = values
    return channels


def filled(x):
    """Return channels (n, nv) with straight lines over a gap."""
    rows = np.delete(np.arange(len(x)), GAP)
    return np.transpose([np.interp(np.arange(len(x)), rows, y[rows]) for y in x.T])


EVERY, HALF = slice(None), slice(2000, None)
GAP, WRONG = slice(1000, 1200), np.r_[100:4000:80, 101:4000:800]
# Expected kinds, joints of the first finding (None: not checked), and a function of
# positions, torques and gravity torques that returns positions and torques.
FAULTS = {
    "turns": ("position_turns", None, lambda q, y, w: (q / (2 * np.pi), y)),
    "degrees": ("position_degrees", (4,), lambda q, y, w: (
        replaced(q, EVERY, 4, np.rad2deg(q[:, 4])), y)),
    "degrees, another zero": ("position_degrees position_zero", None, lambda q, y, w: (
        np.rad2deg(q + [0, 2.5, 0, 0, 0, 0]), y)),
    "mirrored": ("position_sign", (3,), lambda q, y, w: (
        replaced(q, EVERY, 3, -q[:, 3]), y)),
    "robot mirrored": ("flipped_joint", None, lambda q, y, w: (-q, -y)),
    "frozen": ("stuck_position", (3,), lambda q, y, w: (
        replaced(q, HALF, 3, q[2000, 3]), y)),
    "copied": ("copied_position copied_torque", (0, 1), lambda q, y, w: (
        replaced(q, EVERY, 1, q[:, 0]), replaced(y, EVERY, 1, y[:, 0]))),
    "weightless": ("no_gravity", (1, 2), lambda q, y, w: (q, y - w)),
    "half the weight": ("weight_factor", (1, 2), lambda q, y, w: (q, y - 0.5 * w)),
    "weight added": ("weight_factor", (1, 2), lambda q, y, w: (q, y + w)),
    "some weightless": ("no_gravity", (1, 2), lambda q, y, w: (
        q, y - w * [0, 1, 1, 0, 0, 0])),
    "one weightless": ("no_gravity", (1,), lambda q, y, w: (
        q, y - w * [0, 1, 0, 0, 0, 0])),
    "weight alone": ("constant_torque gravity_only", None, lambda q, y, w: (q, w)),
    "mixed": ("mixed_torques", (2,), lambda q, y, w: (
        q, replaced(y, EVERY, 2, y[:, 2] + 0.5 * y[:, 1]))),
    "positions": ("motion_as_torque", None, lambda q, y, w: (q, q)),
    "noisy velocities, another unit": ("motion_as_torque", None, lambda q, y, w: (
        q, np.random.default_rng(0).normal(50 * np.gradient(q, 0.005, axis=0), 1.0))),
    "accelerations": ("motion_as_torque", None, lambda q, y, w: (
        q, np.gradient(np.gradient(q, 0.005, axis=0), 0.005, axis=0))),
    "noise": ("silent_torque", (4,), lambda q, y, w: (
        q, replaced(y, EVERY, 4, np.random.default_rng(0).normal(0, 0.05, len(y))))),
    "never written": ("constant_torque", None, lambda q, y, w: (q, 1e-310 * y)),
    "outliers": ("torque_outliers", (2,), lambda q, y, w: (
        q, replaced(y, slice(None, None, 50), 2, y[::50, 2] + 20 * y[:, 2].std()))),
    "lost readings": ("torque_dropouts", (2,), lambda q, y, w: (
        q, replaced(y, slice(None, None, 50), 2, 0.0))),
    "one sign lost": ("unsigned_torque", (2,), lambda q, y, w: (
        q, replaced(y, EVERY, 2, np.maximum(y[:, 2], 0.0)))),
    "overflow": ("wrapped_torque", (1,), lambda q, y, w: (
        q, replaced(y, EVERY, 1, (y[:, 1] + 110.0) % 220.0 - 110.0))),
    "backwards": ("driving_friction", None, lambda q, y, w: (q[::-1], y[::-1])),
    "blocks": ("shuffled_rows position_jumps", (0,), lambda q, y, w: (
        q.reshape(40, -1, 6)[::-1].reshape(-1, 6), y)),
    "two zeros": ("position_zero", (1, 4), lambda q, y, w: (
        q + np.isin(np.arange(6), [1, 4]) * np.pi / 2, y)),
    "scaled copy": ("copied_torque", (1, 4), lambda q, y, w: (
        q, replaced(y, EVERY, 4, 3.0 - 2.5 * y[:, 1]))),
    "filled gap": ("interpolated_rows", None, lambda q, y, w: (filled(q), filled(y))),
    "wrong positions": ("", None, lambda q, y, w: (
        replaced(q, WRONG, 2, q[WRONG, 2] + 0.3 * np.cos(WRONG)), y)),
    "rows of zeros": ("empty_rows", None, lambda q, y, w: (
        replaced(q, GAP, EVERY, 0.0), replaced(y, GAP, EVERY, 0.0))),
    "before the log": ("empty_rows", None, lambda q, y, w: (
        replaced(q, slice(100), EVERY, 0.0), replaced(y, slice(100), EVERY, 0.0))),
    "drives off": ("empty_rows", None, lambda q, y, w: (
        replaced(q, HALF, EVERY, q[2000]), replaced(y, HALF, EVERY, 1e-3 * y[HALF]))),
    "half of the rate": ("wrong_dt", None, lambda q, y, w: (
        *(x[np.r_[:2000, 2000:4000:2]] for x in (q, y)),)),
    "a sign from a row on": ("torque_sign", (1,), lambda q, y, w: (
        q, replaced(y, HALF, 1, -y[HALF, 1]))),
    "degrees from a row on": ("position_degrees", None, lambda q, y, w: (
        replaced(q, HALF, EVERY, np.rad2deg(q[HALF])), y)),
    "two sources": ("empty_rows", None, lambda q, y, w: (
        q, replaced(y, slice(None, None, 3), EVERY, 0.0))),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_single_fault_is_the_only_finding(log, name):
    expected, joints, function = FAULTS[name]
    recording, _, weight = log
    q, tau = function(recording.q, recording.tau, weight)
    kinds, findings = faults_of(log, q=q, tau=tau)
    assert kinds == expected.split()
    if joints is not None:
        assert findings[0].joints == joints
    if " row on" in name:
        begins = re.match(r"From about row (\d+) on: ", findings[0].message)[1]
        assert abs(int(begins) - 2000) < 100


@pytest.mark.parametrize("factor", one_in(2, [10.197, 8.8507, 1e-3, 4.0, 0.2]))
def test_interval_of_a_common_torque_factor_contains_it(log, factor):
    kinds, found = faults_of(log, tau=factor * log[0].tau)
    assert kinds == ["torque_unit"]
    shown = found[0].message.split("(")[1].split(")")[0]
    low, high = map(float, shown.split(" to "))
    assert low < factor < high


def test_slow_torque_noise_is_no_wrong_sign():
    log = make_robot_recording(
        duration=60.0, dt=0.01, frequency=0.9, torque_noise=0.0, random_state=4
    )
    walk = np.random.default_rng(4).normal(size=log.tau.shape).cumsum(axis=0)
    tau = log.tau + 0.05 * walk / walk.std(axis=0) * log.tau.std(axis=0)
    findings = inspect_channels(log.robot_model(), log.q, tau, log.dt)
    assert [x.kind for x in findings if x.severity != "note"] == []


def test_no_torque_unit_is_reported_without_enough_excitation():
    model = chain(("first", "RY", 0), ("second", "RY", 1))
    log = make_robot_recording(
        model, duration=12.0, dt=0.01, frequency=0.4, random_state=8
    )
    findings = inspect_channels(model, np.rad2deg(log.q), log.tau, log.dt)
    assert "torque_unit" not in {x.kind for x in findings}


def findings_of_four(axes, seed, offset, change=lambda k, q, tau: (q, tau)):
    """Return the findings of four recordings, each changed by a function."""
    rng, described, actual = np.random.default_rng(seed), arm(axes), arm(axes)
    for i in range(1, actual.njoints):
        body = actual.inertias[i]
        mass = body.mass * np.exp(0.25 * rng.normal())
        lever = body.lever + 0.04 * rng.normal(size=3)
        actual.inertias[i] = pin.Inertia(mass, lever, body.inertia)
    logs, nv = [], actual.nv
    for k in range(4):
        _, states = motion(nv, duration=25.0, dt=0.02, seed=10 * seed + k, size=1.0)
        states[:, :nv] += rng.uniform(-1, 1, nv)
        load = inverse_dynamics(actual, states)
        noise = offset * rng.normal(size=nv) + 0.02 * rng.normal(size=load.shape)
        noise += 0.15 * np.sign(states[:, nv : 2 * nv])
        logs.append(change(k, states[:, :nv], load + load.std(axis=0) * noise))
    groups = np.repeat(range(4), [len(q) for q, _ in logs])
    q, tau = map(np.concatenate, zip(*logs))
    findings = inspect_channels(described, q, tau, 0.02, groups=groups)
    return [x for x in findings if x.severity != "note"]


@pytest.mark.parametrize("seed", [1, 4])
def test_torque_offsets_may_differ_between_recordings(seed):
    assert findings_of_four("ZY", seed, offset=0.5) == []


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("torque_sign", lambda q, tau: (q, tau * [1, -1, 1])),
        ("swapped_torques", lambda q, tau: (q, tau[:, [0, 2, 1]])),
        ("torque_unit", lambda q, tau: (q, 10.2 * tau)),
        ("flipped_joint", lambda q, tau: (q * [1, 1, -1], tau * [1, 1, -1])),
        ("delay", lambda q, tau: (q, np.roll(tau, 5, axis=0))),
    ],
)
def test_a_fault_of_one_recording_names_the_recording(kind, change):
    change_last = lambda k, *log: change(*log) if k == 3 else log  # noqa: E731
    (finding,) = findings_of_four("ZYY", 3, 0.05, change_last)
    assert (finding.kind, finding.message[:18]) == (kind, "Recording 3 alone:")
    assert finding.remedy == {}
    # A fit corrects a common delay, but not that of one recording.
    assert finding.severity != "note"


def test_a_counterbalance_of_a_single_joint_is_no_wrong_sign():
    model, made, weight, _ = built(["RY"], seed=0)
    kinds, _ = faults_of((made, model, weight), tau=made.tau - 20 * weight)
    assert kinds == []
    kinds, _ = faults_of((made, model, weight), tau=-made.tau)
    assert kinds == ["torque_sign"]


@pytest.mark.parametrize(
    "down",
    [pytest.param((0, 0, 1), marks=pytest.mark.slow), (1, 0, 0), (0, 0.34, -0.94)],
    ids=["ceiling", "wall", "tilted"],
)
def test_a_base_in_another_orientation(log, down):
    recording, model, weight = log
    turned = model.copy()
    turned.gravity.linear = 9.81 * np.array(down, dtype=float)
    data = turned.createData()
    other = [pin.computeGeneralizedGravity(turned, data, q).copy() for q in recording.q]
    kinds, found = faults_of(log, tau=recording.tau - weight + np.array(other))
    assert kinds == ["base_orientation"]
    shown = found[0].message.split("(")[1].split(")")[0]
    assert [float(x) for x in shown.split(", ")] == pytest.approx(down, abs=0.1)


GANTRY, SCARA = ("PX", "PY", "PZ", "RY"), ("RZ", "RZ", "PZ", "RZ")
PALLETISER = ("RZ", "RY", "RY", "RX", "RY")
SEVEN = ("RZ", "RY", "RZ", "RY", "RZ", "RY", "RZ")


def built(axes, gravity=(0.0, 0.0, -9.81), *, seed=2, perturbation=0.1):
    """Return robot, recording, gravity torques, and torques under other gravity."""
    model = chain(*((f"joint_{j + 1}", kind, j) for j, kind in enumerate(axes)))
    log = make_robot_recording(
        model, duration=15.0, dt=0.01, perturbation=perturbation, random_state=seed
    )
    data, tilted = model.createData(), model.copy()
    tilted.gravity.linear = np.array(gravity)
    weight, rotated = (
        np.array([pin.computeGeneralizedGravity(x, data, q).copy() for q in log.q])
        for x in (model, tilted)
    )
    return model, log, weight, log.tau - weight + rotated


def test_prismatic_joints_show_missing_or_rotated_gravity():
    for axes in (SCARA, GANTRY):
        model, made, w, _ = built(axes)
        assert faults_of((made, model, w), tau=made.tau - w)[0] == ["no_gravity"]
    *made, tau = built(GANTRY, (6.0, 5.0, -6.0))
    assert faults_of((made[1], model, w), tau=tau)[0] == ["base_orientation"]
    model, made, weight, tau = built(PALLETISER, (0.0, 0.0, 9.81), perturbation=0)
    kinds = ["base_orientation", "torque_unit"]
    assert faults_of((made, model, weight), tau=10 * tau)[0] == kinds


def test_an_effect_on_one_joint_may_accompany_a_fault_of_the_whole_log():
    model, made, weight, _ = built(GANTRY)
    stiffness = made.tau.std(axis=0) / made.q.std(axis=0) * [0, 0, 0, 0.5]
    assert faults_of((made, model, weight), tau=made.tau + stiffness * made.q)[0] == []
    model, made, _, _ = built(("RX", "RY", "RY"), seed=1)
    found = inspect_channels(model, made.q, made.tau * [1, 1.3, 1], 0.8 * made.dt)
    assert found[0].kind == "wrong_dt"


@pytest.mark.parametrize("gravity", [(-7.8, 6.0, 0.1), (9.81, 0.0, 0.0)])
def test_base_orientation_with_an_unloaded_prismatic_joint(gravity):
    model, made, weight, tau = built(SCARA, gravity)
    kinds, _ = faults_of((made, model, weight), tau=tau)
    assert kinds == ["base_orientation"]


@pytest.mark.parametrize(("axes", "unit"), [(PALLETISER, 1), (SEVEN, 100)])
def test_missing_gravity_is_not_reported_as_wrong_sample_period(axes, unit):
    model, made, weight, _ = built(axes, seed=3, perturbation=0.3)
    tau = unit * (made.tau - weight)
    assert faults_of((made, model, weight), tau=tau)[0] == ["no_gravity"]


def test_swapped_positions_of_prismatic_and_revolute_joints():
    model, made, weight, _ = built(GANTRY)
    kinds, found = faults_of((made, model, weight), q=made.q[:, [0, 3, 2, 1]])
    assert (kinds, found[0].joints) == (["swapped_positions"], (1, 3))


def test_a_force_constant_up_to_rounding_is_not_coarse():
    model, made, weight, _ = built(GANTRY)
    found = inspect_channels(model, made.q, weight, made.dt)
    assert {one.kind for one in found} <= {"constant_torque", "unverified"}
    assert found[0].joints == (0, 1, 2)


def test_encoders_that_were_zeroed_at_power_up(log):
    q = log[0].q
    kinds, found = faults_of(log, q=q - q[0])
    assert kinds == ["position_zeros"]
    offsets = found[0].message.split("[rad]: ")[1][:-1].split(", ")
    offsets = dict(x.split() for x in offsets)
    assert float(offsets["joint_4"]) == pytest.approx(q[0, 3], abs=0.1)


@pytest.mark.parametrize("seconds", one_in(2, [0.05, 0.01, -0.02, 1.5]))
def test_a_lag_of_all_torques(log, seconds):
    recording, model, _ = log
    k = round(seconds / recording.dt)
    q, tau = recording.q, recording.tau
    q, tau = (q[k:], tau[:-k]) if k > 0 else (q[:k], tau[-k:])
    (finding,) = inspect_channels(model, q, tau, recording.dt)
    assert (finding.kind, finding.severity) == ("delay", "note")
    words = finding.message.split()
    assert float(words[3]) == pytest.approx(1e3 * abs(seconds), abs=1.0)
    assert ("late" if seconds > 0 else "early") in words


def test_an_encoder_that_fails_at_standstill(log):
    """It fails while its joint is at rest; the missing noise shows it."""
    q = log[0].q.copy()
    step = np.abs(np.diff(q[:, 3]))
    stop = 1000 + int(np.argmin(np.convolve(step[1000:3000], np.ones(20), "valid")))
    q[stop:, 3] = q[stop, 3]
    kinds, found = faults_of(log, q=q)
    assert "stuck_position" in kinds
    assert found[0].joints == (3,)


@pytest.mark.parametrize("torques", [False, True])
def test_coupled_axes(log, torques):
    """The third encoder measures the sum of two joints; its motor acts on both."""
    q, tau = log[0].q.copy(), log[0].tau.copy()
    q[:, 2] += q[:, 1]
    tau[:, 1] -= torques * tau[:, 2]
    kinds, found = faults_of(log, q=q, tau=tau)
    assert (kinds, found[0].joints) == (["coupled_position"], (2,))
    assert "that of joint_3 - that of joint_2" in found[0].message
    assert ("torque of joint_2" in found[0].message) == torques


@pytest.mark.parametrize("factor", [*one_in(2, [0.5, 2.0]), 4.0, 1.05])
def test_a_wrong_sample_period_is_found(log, factor):
    recording, model, _ = log
    signals = recording.q, recording.tau, factor * recording.dt
    (finding,) = inspect_channels(model, *signals)
    assert finding.kind == "wrong_dt"
    rel = 0.005 if factor == 1.05 else None
    assert dict(finding.remedy)["dt"] == pytest.approx(recording.dt, rel=rel)


def test_torques_in_percent_of_rated_torque(log):
    rated = np.array([200, 200, 120, 60, 40, 20.0])
    kinds, found = faults_of(log, tau=100 * log[0].tau / rated)
    assert kinds == ["torque_factors"]
    assert 'gains="unknown"' in found[0].message


@pytest.mark.parametrize("joint", [2, 4])
@pytest.mark.parametrize("factor", [0.1, 8.85, 100.0])
def test_the_torque_of_one_joint_in_another_unit(log, joint, factor):
    units = np.where(np.arange(6) == joint, factor, 1.0)
    kinds, found = faults_of(log, tau=log[0].tau * units)
    assert (kinds, found[0].joints) == (["gear_factor"], (joint,))
    ratio = float(found[0].message.split("about ")[1].split()[0])
    assert ratio * factor == pytest.approx(1, abs=0.15)


def assert_contact(kinds, found, times=(6.0, 9.0)):
    assert kinds == ["external_force"]
    interval = found[0].message.split("From ")[1].split(" s after")[0].split(" to ")
    assert [float(x) for x in interval] == pytest.approx(times, abs=0.5)


@pytest.mark.parametrize(("rows", "times"), [(4000, (6.0, 9.0)), (2000, (2.0, 5.0))])
def test_a_contact_is_named_with_its_time(log, rows, times):
    recording = log[0]
    begin, end = (round(t / recording.dt) for t in times)
    tau = recording.tau[:rows].copy()
    tau[begin:end] += 1.5 * tau.std(axis=0)
    assert_contact(*faults_of(log, q=recording.q[:rows], tau=tau), times)
    # A permanent change is a payload.
    tau[end:] = tau[end:] + 1.5 * recording.tau[:rows].std(axis=0)
    assert "external_force" not in faults_of(log, q=recording.q[:rows], tau=tau)[0]


@pytest.mark.slow
def test_a_force_on_a_link_is_named_with_its_time(log):
    """The contact torques follow from the Jacobian and vary with the pose."""
    recording, model, _ = log
    rows = slice(*(round(t / recording.dt) for t in (6.0, 9.0)))
    data, tau = model.createData(), recording.tau.copy()
    for row in range(rows.start, rows.stop):
        pin.computeJointJacobians(model, data, recording.q[row])
        frame = pin.LOCAL_WORLD_ALIGNED
        jacobian = pin.getJointJacobian(model, data, model.nv, frame)
        tau[row] += 40.0 * jacobian[2]
    assert_contact(*faults_of(log, tau=tau))


def test_torques_of_the_description(log):
    recording, model, _ = log
    v = np.gradient(recording.q, recording.dt, axis=0)
    states = np.hstack([recording.q, v, np.gradient(v, recording.dt, axis=0)])
    tau = inverse_dynamics(model, states)
    assert faults_of(log, tau=tau)[0] == ["computed_torque"]
    one = np.where(np.arange(model.nv) == 1, tau, recording.tau)
    assert [x.joints for x in faults_of(log, tau=one)[1]] == [(1,)]


def chain(*joints):
    """Build a robot of joints, each given by name, type and parent."""
    model = pin.Model()
    for name, kind, parent in joints:
        placement = pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.1]) * parent)
        joint = getattr(pin, f"JointModel{kind}")()
        joint_id = model.addJoint(parent, joint, placement, name)
        body = pin.Inertia.FromBox(2.0, 0.1, 0.1, 0.1)
        centre = pin.SE3(np.eye(3), np.array([0.2, 0.02, 0.05]))
        model.appendBodyToJoint(joint_id, body, centre)
    return model


def simulated(model):
    made = make_robot_recording(model, duration=10.0, dt=0.01, random_state=0)
    return made.q, made.tau, made.dt


def test_torque_unit_from_effort_limits_without_gravity():
    model = chain(("x", "PX", 0), ("y", "PY", 1))
    model.effortLimit = np.array([300.0, 200.0])
    q, tau, dt = simulated(model)
    (finding,) = inspect_channels(model, q, tau, dt)
    assert (finding.kind, finding.severity) == ("unverified", "note")
    tau = tau * 3000.0 / np.abs(tau).max(axis=0)
    assert "torque_unit" in {x.kind for x in inspect_channels(model, q, tau, dt)}


def test_the_size_of_torques_is_verified_unless_gains_are_identified():
    model = chain(("joint_0", "RZ", 0), ("joint_1", "RZ", 1))
    (finding,) = inspect_channels(model, *simulated(model))
    assert "cannot be verified, nor the zeros" in finding.message
    model = chain(("lift", "PZ", 0), ("turn", "RZ", 1))
    (finding,) = inspect_channels(model, *simulated(model))
    assert "size of the torques cannot be verified" in finding.message
    assert inspect_channels(model, *simulated(model), gains="unknown") == ()


def test_order_of_identical_branches_is_unverified():
    for first, other in (("right", "left"), ("left", "right")):
        arms = ((first, "RY", 0), (f"{first}_2", "RX", 1))
        model = chain(*arms, (other, "RY", 0), (f"{other}_2", "RX", 3))
        (finding,) = inspect_channels(model, *simulated(model))
        assert (finding.kind, finding.severity) == ("unverified", "note")
        assert "assumed to be in the order of the description" in finding.message
        assert inspect_channels(model, *simulated(model), named=True) == ()


def test_faults_are_found_with_a_massless_body():
    model = chain(("x", "RX", 0), ("y", "RY", 1), ("z", "RX", 2))
    model.inertias[1] = pin.Inertia.FromSphere(1e-6, 0.01)
    q, tau, dt = simulated(model)
    model.inertias[1] = pin.Inertia.Zero()
    assert not inspect_channels(model, q, tau, dt)
    for factors, kind in ((10, "torque_unit"), ([1, -1, 1], "torque_sign")):
        assert inspect_channels(model, q, tau * factors, dt)[0].kind == kind
    model.inertias[2] = model.inertias[3] = pin.Inertia.Zero()
    (finding,) = inspect_channels(model, q, 10 * tau, dt)
    assert "no body of the description has mass" in finding.message


@pytest.mark.parametrize("axes", [("PX", "RZ"), ("RX", "RY", "RX")])
def test_a_missing_body_is_no_fault(axes):
    model = chain(*((f"{k}", axis, k) for k, axis in enumerate(axes)))
    log = simulated(model)
    model.inertias[len(axes)] = pin.Inertia.Zero()
    assert not [x for x in inspect_channels(model, *log) if x.severity != "note"]


def test_two_clocks_of_different_speed(log):
    recording = log[0]
    t = recording.dt * np.arange(recording.n_samples)
    late = [np.interp(0.997 * t, t, x) for x in recording.tau.T]
    kinds, found = faults_of(log, tau=np.transpose(late))
    assert kinds == ["delay"]
    assert "fast" in found[0].message
    assert found[0].value == pytest.approx(0.003, rel=0.3)


@pytest.mark.parametrize("power", [0, -1])
def test_gear_ratios_near_the_factor_of_degrees(log, power):
    ratios = np.array([50.0, 55.0, 60.0, 65.0, 60.0, 50.0])
    kinds, found = faults_of(log, q=ratios * log[0].q, tau=ratios**power * log[0].tau)
    assert kinds == ["position_unit"]
    assert ("multiply their torques" in found[0].message) == bool(power)
    each = re.findall(r"joint_(\d) ([\d.e+]+) ± ([\d.]*\d)", found[0].message)
    assert len(each) >= 4
    for j, ratio, error in each:
        assert abs(float(ratio) - ratios[int(j) - 1]) < 3 * float(error) + 1


@pytest.mark.parametrize("power", [0, -1])
@pytest.mark.parametrize("size", [1.5, 1.05, 0.97])
def test_wrong_gear_ratio_of_one_joint(log, size, power):
    ratio = np.array([1, 1, size, 1, 1, 1])
    kinds, found = faults_of(log, q=ratio * log[0].q, tau=ratio**power * log[0].tau)
    assert (kinds, found[0].joints) == (["position_unit"], (2,))
    value, error = re.search(r"joint_3 (\S+) ± (\S+)", found[0].message).groups()
    assert abs(float(value) - size) < 2 * float(error)
    assert ("multiply the torque" in found[0].message) == bool(power)


def test_a_wrong_gain_of_a_torque_is_no_gear_ratio():
    model, states = arm("ZY"), motion(2)[1]
    tau = [1, 0.8] * (inverse_dynamics(model, states) + 0.5 * np.sign(states[:, 2:4]))
    noise = np.random.default_rng(0).normal(size=tau.shape) * tau.std(axis=0)
    found = inspect_channels(model, states[:, :2], tau + 0.01 * noise, 0.01)
    assert "position_unit" not in [x.kind for x in found]


def test_wrong_gear_ratio_with_dominant_drive_torques():
    # All torques agree with the description within a few per cent.
    size = {"viscous": 5.0, "coulomb": 6.0, "rotor_inertia": 2.0}
    friction = {name: np.full(6, x) for name, x in size.items()}
    settings = {"perturbation": 0, "torque_noise": 0.01, "friction": friction}
    recording = make_robot_recording(duration=20, **settings, random_state=1)
    wrist = recording.q * [1, 1, 1, 1, 2, 1]
    kinds, found = faults_of((recording, recording.robot_model(), None), q=wrist)
    assert (kinds, found[0].joints) == (["position_unit"], (4,))


def test_a_follower_loads_the_chain_of_its_leader(tmp_path):
    path, rates = tmp_path / "arm.urdf", np.array([[1, 0], [0, 1], [0, 1.5]])
    parts = [link(name, mass) for name, mass in (("a", 2.0), ("b", 3.0), ("c", 3.0))]
    mimic = 'joint="j2" multiplier="1.5" offset="0.2"'
    parts += joint("j1", "base", "a", axis="0 0 1"), joint("j2", "a", "b")
    parts += [joint("j3", "b", "c", mimic=mimic)]
    path.write_text(f'<robot name="r"><link name="base"/>{"".join(parts)}</robot>')
    _, states = motion(2, duration=15.0, dt=0.01, seed=0, size=1.0)
    full = np.hstack([x @ rates.T for x in np.split(states, 3, axis=1)])
    full[:, 2] += 0.2
    tau = inverse_dynamics(pin.buildModelFromUrdf(str(path)), full) @ rates
    tau += 0.01 * tau.std(axis=0) * np.random.default_rng(0).normal(size=tau.shape)
    tau += 0.05 * tau.std(axis=0) * np.sign(states[:, 2:4])
    findings = inspect_channels(str(path), states[:, :2], tau, 0.01)
    assert [x.kind for x in findings if x.severity != "note"] == []
