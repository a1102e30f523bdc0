"""Findings of faulty channels: kinds, joints, severities; no false findings."""

import re

import numpy as np
import pytest

from sklearn_vbjfa import datasets
from sklearn_vbjfa.datasets import make_robot_recording

pytest.importorskip("pinocchio")

from sklearn_vbjfa.inspection import ChannelFinding, inspect_channels, inspect_recording
from tests._quick import one_in
from tests.effects._arms import inverse_dynamics
from tests.inspection.test_hypotheses import chain

# Documented properties of the measured sets: the currents of the last three joints of
# TIAGo take about forty values.
TRUE_FINDINGS = {
    "franka_panda": {("delay", tuple(range(7)))},
    "tiago": {("coarse_torque", (j,)) for j in (5, 6, 7)},
}
MEASURED = sorted(set(datasets.SETS) - {"unitree_go2"})


@pytest.fixture(scope="module")
def arm():
    """Simulate an arm with known parameters."""
    recording = make_robot_recording(random_state=3, duration=16.0)
    return recording, recording.robot_model()


def found(findings):
    return {(finding.kind, finding.joints) for finding in findings}


def inspect(arm, q=None, tau=None):
    recording, model = arm
    q = recording.q if q is None else q
    tau = recording.tau if tau is None else tau
    findings = inspect_channels(model, q, tau, recording.dt)
    for finding in findings:
        assert isinstance(finding, ChannelFinding)
        assert finding.severity in {"error", "warning", "note"}
        assert "\n" not in finding.message
        if len(finding.joints) < recording.nv:
            for j in finding.joints:
                assert recording.joint_names[j] in finding.message
    return findings


def only(findings, kind, joints, severity):
    assert found(findings) == {(kind, joints)}, findings
    assert findings[0].severity == severity
    return findings[0].message


@pytest.mark.parametrize("seed", range(2))
def test_simulated_recordings_have_no_findings(seed):
    recording = make_robot_recording(random_state=seed, n_recordings=2, duration=10.0)
    model = recording.robot_model()
    for groups in (recording.groups, None)[: 1 + (seed == 0)]:
        rows = slice(None) if groups is not None else slice(0, 2000)
        findings = inspect_channels(
            model, recording.q[rows], recording.tau[rows], recording.dt, groups
        )
        assert findings == ()


def test_load_friction_in_a_motion_of_one_frequency_is_no_fault():
    """Another zero, orientation or sample period would explain it in part."""
    model, rng = chain(("a", "RY", 0), ("b", "RY", 1)), np.random.default_rng(0)
    angle = 1.445 * 0.01 * np.arange(3000)[:, None] + [0.0, 0.7]
    sine, cosine = 1.2 * np.sin(angle), 1.2 * np.cos(angle)
    q, v, a = sine, 1.445 * cosine, -(1.445**2) * sine
    load = inverse_dynamics(model, np.hstack([q, v, a]))
    tau = load + (1.0 + 0.25 * np.abs(load)) * np.tanh(v / 0.002) + 3 * v + 0.4 * a
    tau += 0.02 * tau.std(axis=0) * rng.normal(size=q.shape)
    findings = inspect_channels(model, q + 2e-5 * rng.normal(size=q.shape), tau, 0.01)
    assert {finding.severity for finding in findings} <= {"note"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"perturbation": 0.5, "torque_noise": 0.2, "encoder_noise": 1e-3},
        {"friction": ("viscous", "coulomb", "offset", "rotor_inertia")},
        {"friction": ()},
        {"duration": 10.0, "dt": 0.01},
    ],
    ids=str,
)
def test_many_simulated_recordings_have_no_findings(seed, options):
    recording = make_robot_recording(random_state=seed, **options)
    assert inspect_recording(recording) == ()


@pytest.mark.parametrize("name", one_in(20, MEASURED))
def test_measured_recordings_have_only_true_findings(measured_data_home, name):
    recording = getattr(datasets, f"fetch_{name}")(
        data_home=measured_data_home, download_if_missing=False
    )
    findings = inspect_recording(recording)
    reported = found(x for x in findings if x.kind != "unverified")
    assert reported == TRUE_FINDINGS.get(name, set())
    half, torques = recording.n_samples // 2, set(recording.torque_units) <= {"N m"}
    arrays, model = (
        (recording.q, recording.tau, recording.groups),
        recording.robot_model(),
    )
    gains = None if torques else "unknown"
    for rows in (slice(None, half), slice(half, None)):
        q, tau, groups = (x[rows] for x in arrays)
        findings += inspect_channels(model, q, tau, recording.dt, groups, gains=gains)
    assert all(finding.severity == "note" for finding in findings)


def test_an_unobservable_torque_sign_follows_the_others(arm):
    q, tau = arm[0].q.copy(), -arm[0].tau
    # The torque of the last joint is noise, so that its sign is not observable.
    tau[:, 5] = np.random.default_rng(0).normal(size=len(tau))
    message = only(inspect(arm, q=q, tau=tau), "torque_sign", tuple(range(6)), "error")
    assert "so is the sign of joint_6" in message
    # One correct sign shows that not all are wrong.
    tau[:, 1] *= -1
    assert not {1, 5} & {j for f in inspect(arm, q=q, tau=tau) for j in f.joints}


def test_clipped_torque(arm):
    tau = arm[0].tau.copy()
    limit = 0.6 * np.abs(tau[:, 1]).max()
    tau[:, 1] = np.clip(tau[:, 1], -limit, limit)
    share = np.mean(np.abs(arm[0].tau[:, 1]) >= limit)
    assert share > 0.02
    message = only(inspect(arm, tau=tau), "clipped_torque", (1,), "warning")
    match = re.search(f"clipped at \\+-{limit:.4g}: (.*) % of its samples", message)
    # Short runs are not counted.
    assert 0.8 * share < 0.01 * float(match[1]) < 1.01 * share


@pytest.mark.parametrize("phase", [0.0, 0.5, 1.0])
def test_the_peak_of_a_coarse_or_noisy_torque_is_not_clipped(arm, phase):
    # The peak of a sine lies between two steps or on one.
    tau, rows = arm[0].tau.copy(), np.arange(len(arm[0].tau))
    whole = (15 + phase) * np.sin(0.01 * rows)
    noise = 0.02 * np.random.default_rng(0).normal(size=rows.size)
    for limit in (20, 9):
        clipped = 0.3 * np.clip(whole, -limit, limit)
        for tau[:, 1] in (0.3 * np.round(clipped / 0.3), clipped + noise):
            kinds = {one.kind for one in inspect(arm, tau=tau)}
            assert ("clipped_torque" in kinds) == (limit == 9)


def test_torque_dropouts_to_zero(arm):
    tau = arm[0].tau.copy()
    rows = np.concatenate([np.arange(k, k + 30) for k in range(200, 3000, 400)])
    tau[rows, 3] = 0.0
    message = only(inspect(arm, tau=tau), "torque_dropouts", (3,), "warning")
    assert "up to 0.15 s" in message
    times = int(message.split(" time(s)")[0].split()[-1])
    # Some dropouts begin or end where the torque is near zero.
    assert 4 <= times <= 7


def test_torque_dropouts_at_a_constant_value(arm):
    tau = arm[0].tau.copy()
    tau[1500:2300, 3] = tau[1500, 3]
    message = only(inspect(arm, tau=tau), "torque_dropouts", (3,), "warning")
    assert f"stays at {tau[1500, 3]:.4g} " in message
    # Including pauses.
    assert "1 time(s) while the robot moves (" in message
    assert "up to 4 s" in message
    # The torque may be constant at rest, such as with the brake on.
    q = arm[0].q.copy()
    q[1500:2300, 3] = q[1500, 3]
    q[2300:, 3] += q[1500, 3] - q[2300, 3]
    found = inspect(arm, q=q, tau=tau)
    assert "torque_dropouts" not in {one.kind for one in found}


def test_a_torque_at_rest_that_arrives_late_is_no_dropout():
    recording = make_robot_recording(random_state=3, duration=4.0, dt=4e-4)
    rest, late = np.zeros(1000, dtype=int), np.zeros(150, dtype=int)
    q = recording.q[np.r_[rest, : recording.n_samples]]
    tau = recording.tau[np.r_[rest, late, : recording.n_samples - late.size]]
    findings = inspect_channels(recording.robot_model(), q, tau, recording.dt)
    assert "torque_dropouts" not in {recording.kind for recording in findings}


def test_frozen_positions(arm):
    q = arm[0].q.copy()
    fast = np.flatnonzero(np.abs(arm[0].states[:, 6 + 2]) > 0.5)
    start = fast[fast > 1000][0]
    q[start : start + 20, 2] = q[start, 2]
    message = only(inspect(arm, q=q), "stuck_position", (2,), "note")
    assert "for 0.1 s (20 rows" in message
    assert f"the first at row {start})" in message


def test_repeated_rows(arm):
    q, tau = arm[0].q.copy(), arm[0].tau.copy()
    rows = 100 + 40 * np.arange(60)
    q[rows], tau[rows] = q[rows - 1], tau[rows - 1]
    message = only(inspect(arm, q=q, tau=tau), "repeated_rows", tuple(range(6)), "note")
    assert message.startswith("60 rows")


def test_samples_of_zero_weight_are_ignored(arm):
    recording, model = arm
    tau, weight = recording.tau.copy(), np.ones(recording.tau.shape)
    tau[300:420], weight[300:420] = tau[300], 0.0
    signals = recording.q, tau, recording.dt
    assert inspect_channels(model, *signals)
    assert not inspect_channels(model, *signals, weight=weight)


def test_spikes(arm):
    q = arm[0].q.copy()
    q[777, 3] += 0.1
    assert "row 777" in only(inspect(arm, q=q), "position_jumps", (3,), "note")


def test_channels_without_information(arm):
    q, tau = arm[0].q.copy(), arm[0].tau.copy()
    tau[:, 4] = 1.5
    only(inspect(arm, tau=tau), "constant_torque", (4,), "error")
    # Several joints share one finding.
    tau[:, 2] = -0.0
    (finding,) = inspect(arm, tau=tau)
    assert finding.joints == (2, 4)
    said = "joint_3, joint_5 are constant (0 or 1.5) while the joints"
    assert said in finding.message
    q[:, 5] = 0.2 + 1e-4 * np.random.default_rng(0).normal(size=len(q))
    findings = inspect(arm, q=q)
    assert ("still_joint", (5,)) in found(findings)


def test_bad_input_is_refused(arm):
    recording, model = arm
    q, tau = recording.q, recording.tau
    with pytest.raises(ValueError, match=r"must both have shape \(n_samples, 6\)"):
        inspect_channels(model, q[:, :5], tau, recording.dt)
    with pytest.raises(ValueError, match="must both have shape"):
        inspect_channels(model, q, tau[1:], recording.dt)
    with pytest.raises(ValueError, match="dt must be"):
        inspect_channels(model, q, tau, 0.0)


@pytest.mark.parametrize("n", [5, 63, 64, 100])
def test_short_recordings_have_no_findings(arm, n):
    recording, model = arm
    findings = inspect_channels(model, recording.q[:n], recording.tau[:n], recording.dt)
    assert findings == ()


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_robot_at_rest_is_an_error(arm, noise):
    recording, model = arm
    q = 0.3 + noise * np.random.default_rng(0).normal(size=recording.q.shape)
    (finding,) = inspect_channels(model, q, recording.tau, recording.dt)
    assert (finding.kind, finding.joints) == ("still_joint", tuple(range(6)))
    assert finding.severity == "error"
    assert "No joint moves" in finding.message
    # One joint that moves is enough.
    q[:, 2] = recording.q[:, 2]
    findings = inspect_channels(model, q, recording.tau, recording.dt)
    still = [f for f in findings if f.kind == "still_joint"]
    assert [f.joints for f in still] == [(0,), (1,), (3,), (4,), (5,)]
    assert {f.severity for f in still} == {"warning"}


def findings_of_kind(findings, kind):
    """Joints and severities of the findings of one kind."""
    return [(f.joints, f.severity) for f in findings if f.kind == kind]


def add_pause(x):
    """Insert a pause with smooth deceleration and acceleration."""
    stop = 1200
    ramp = np.cumsum(0.5 * (1 + np.cos(np.linspace(0, np.pi, 200))))
    back = np.cumsum(0.5 * (1 - np.cos(np.linspace(0, np.pi, 200))))
    clock = np.r_[np.arange(stop), stop + ramp, np.full(100, stop + ramp[-1])]
    clock = np.r_[clock, clock[-1] + back]
    clock = np.r_[clock, np.arange(clock[-1] + 1, len(x))]
    return np.column_stack([np.interp(clock, np.arange(len(x)), y) for y in x.T])


def test_a_robot_that_pauses_is_not_frozen(arm):
    """Without noise all rows of a pause are equal; the motion decelerates before it."""
    recording, model = arm
    slow, tau = map(add_pause, (recording.states[:, :6], recording.tau_clean))
    findings = inspect_channels(model, slow, tau, recording.dt)
    assert not findings_of_kind(findings, "repeated_rows")


@pytest.mark.parametrize("noise", [0.0, 2e-5])
def test_a_joint_that_pauses_alone_is_not_stuck(arm, noise):
    """The encoder works, with a resolution or with noise."""
    recording, model = arm
    q = add_pause(recording.states[:, :6])
    n, rng = len(q), np.random.default_rng(0)
    q[: len(recording.q), [0, 1, 2, 4, 5]] = recording.states[:n, [0, 1, 2, 4, 5]]
    q = q[: len(recording.q)] + noise * rng.normal(size=(len(q), 6))[: len(recording.q)]
    q = q if noise else np.round(q, 5)
    findings = inspect_channels(model, q, recording.tau[: len(q)], recording.dt)
    assert not findings_of_kind(findings, "stuck_position")


def test_coarse_torque_depends_on_step_relative_to_standard_deviation():
    recording = make_robot_recording(
        random_state=3, duration=6.0, dt=0.001, torque_noise=0.001
    )
    model = recording.robot_model()
    for share, found in ((1 / 40, []), (1 / 2, ["note"]), (2, ["warning"])):
        tau = recording.tau.copy()
        step = share * tau[:, 1].std()
        tau[:, 1] = step * np.round(tau[:, 1] / step)
        # The share of zero differences does not matter.
        assert np.mean(np.diff(tau[:, 1]) == 0) > 0.5
        findings = inspect_channels(model, recording.q, tau, recording.dt)
        assert [x.severity for x in findings if x.kind == "coarse_torque"] == found


def test_encoder_counts_of_a_joint_without_limits():
    model = chain(("wheel", "RY", 0))
    t = 0.01 * np.arange(3000)
    turning = 6.0 * t + np.sin(2 * t)
    rng = np.random.default_rng(0)
    tau = np.cos(turning) + 0.2 + 0.01 * rng.normal(size=t.size)
    sound = inspect_channels(model, turning[:, None], tau[:, None], 0.01)
    assert not {f.severity for f in sound} & {"error", "warning"}
    counts = np.round(turning * 4096 / (2 * np.pi))
    findings = inspect_channels(model, counts[:, None], tau[:, None], 0.01)
    assert findings_of_kind(findings, "position_counts") == [((0,), "error")]


def test_zero_of_a_vertical_first_axis_is_not_reported(arm):
    q = arm[0].q.copy()
    q[:, 0] += np.pi / 2
    assert inspect(arm, q=q) == ()
