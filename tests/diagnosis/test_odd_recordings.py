"""Verdicts on recordings with pauses, rest, changes or faulty channels."""

import numpy as np
import pytest
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.inspection import ChannelFinding
from tests._quick import one_in
from tests.diagnosis._recordings import TWO_MOTIONS, named, record
from tests.diagnosis.report._pages import text_of
from tests.effects._arms import arm, inverse_dynamics

DT = 0.02
MODEL = arm("ZY")
VISCOUS, COULOMB = np.array([0.8, 0.5]), np.array([0.6, 0.4])
PLAIN = ["spring", "offset", "payload", "load_friction"]
ARM = record("ZY")


def motion(t, pace):
    """States (n, 6) along a path with a pace (n, 2) between 0 and 1 for each joint."""
    smooth = np.hanning(51) / np.hanning(51).sum()
    pace = np.column_stack([np.convolve(x, smooth, mode="same") for x in pace.T])
    at = np.cumsum(pace, axis=0) * DT
    slope = np.gradient(pace, DT, axis=0)
    q, v, a = (np.zeros_like(pace) for _ in range(3))
    for size, w, phase in ((0.7, [2.1, 2.9], 0.3), (0.4, [4.7, 3.7], 1.1)):
        w = np.array(w)
        q += size * np.sin(w * at + phase)
        v += size * w * np.cos(w * at + phase) * pace
        a += size * w * np.cos(w * at + phase) * slope
        a -= size * w**2 * np.sin(w * at + phase) * pace**2
    return np.hstack([q, v, a])


def measure(t, pace, seed=0, extra=None, friction=1.0):
    """Simulate positions and torques; static friction varies in its range."""
    rng = np.random.default_rng(seed)
    states = motion(t, pace)
    q, v, _ = np.split(states, 3, axis=1)
    stuck = 0.5 * np.sin(0.05 * np.arange(t.size))[:, None] * np.ones(2)
    direction = np.where(np.abs(v) > 1e-4, np.sign(v), stuck)
    torque = inverse_dynamics(MODEL, states)
    torque += friction * (VISCOUS * v + COULOMB * direction)
    if extra is not None:
        torque = torque + extra(q, v)
    noise = rng.normal(size=(2, *q.shape))
    return q + 2e-5 * noise[0], torque + 0.05 * noise[1]


def close(q, tau, effects=PLAIN, groups=None):
    robot = RobotIdentifier(MODEL, dt=DT, friction=("viscous", "coulomb"))
    return EffectDiscovery(robot, effects=effects).fit(q, tau, groups=groups)


def pauses(t, *moving):
    """Pace: 1 in the given intervals of each joint, else 0."""
    pace = np.zeros((t.size, 2))
    for j, intervals in enumerate(moving):
        for low, high in intervals:
            pace[(t >= low) & (t < high), j] = 1.0
    return pace


def seconds(length):
    return np.arange(round(length / DT)) * DT


def elbow_spring(q, v):
    return np.column_stack([0.0 * q[:, 0], 4.0 * q[:, 1]])


@pytest.mark.parametrize("step", one_in(4, [0.3, 0.05, 0.2, 0.5]))
def test_coarse_torques_are_reported_and_searched(step):
    """Quantised torques with a missing spring; `step` is relative to their std."""
    t = seconds(40.0)
    q, tau = measure(t, pauses(t, [(1, 39)], [(1, 39)]), extra=elbow_spring)
    size = step * tau.std(axis=0)
    coarse = size * np.round(tau / size)
    loop = close(q, coarse)
    assert named(loop) == [("spring", 1)]
    assert ("steps of" in text_of(loop.report_)) == (step >= 0.2)


def test_unit_of_errors_of_a_coarse_channel_is_that_of_the_whole_recording():
    t = seconds(40.0)
    q, tau = measure(t, pauses(t, [(0, 40)], [(0, 40)]))
    size = 2.0 * tau.std(axis=0)
    coarse = size * np.round(tau / size)
    coarse[t < 8.0] += 2.0 * size  # before the held-out parts
    loop = close(q, coarse)
    assert not loop.report_.outcome.column("searched").any()
    np.testing.assert_allclose(loop.torque_std_, coarse.std(axis=0), rtol=0.1)


def assert_complete(loop):
    assert loop.effects_ == ()
    assert loop.report_.status == "nothing", loop.report_.headline
    assert all(v.status == "floor" for v in loop.report_.joints)


@pytest.mark.slow
def test_rest_at_the_end_of_the_recording():
    t = seconds(60.0)
    q, tau = measure(t, pauses(t, [(2, 38)], [(2, 38)]), extra=elbow_spring)
    loop = close(q, tau)
    assert named(loop) == [("spring", 1)]
    assert loop.report_.status == "complete"
    # Relative to the torque in motion, although the end is at rest.
    assert np.all(loop.error_after_ < 0.1)


@pytest.mark.slow
def test_friction_that_differs_between_recordings():
    """The second recording has a third less friction; something must be missing."""
    t = seconds(30.0)
    pace = pauses(t, [(1, 29)], [(1, 29)])
    parts = measure(t, pace), measure(t, 0.9 * pace, seed=1, friction=0.66)
    q, tau = (np.concatenate(x) for x in zip(*parts))
    groups = np.repeat([0, 1], t.size)
    loop = close(q, tau, effects=[*PLAIN, "drift"], groups=groups)
    assert loop.report_.status not in ("nothing", "complete") or {
        e.name for e in loop.effects_
    } == {"drift"}
    assert "payload" not in {e.name for e in loop.effects_}


# Lengths [s], whether the motion is the same, joint that moves in the first one only.
ODD = {
    "of 5 s": ([5.0], False, None),
    "the same ten times": ([25.0] * 10, True, None),
    "of twenty minutes and of ten seconds": ([1200.0, 10.0], False, None),
    "a joint that moves in one of four": ([25.0] * 4, False, 1),
}


@pytest.mark.parametrize(("lengths", "same", "joint"), ODD.values(), ids=ODD)
def test_expected_error_for_unusual_sets_of_recordings(lengths, same, joint):
    recordings = []
    for number, length in enumerate([*lengths, 25.0]):
        last = number == len(lengths)
        kind = 0 if same and not last else number
        pace = np.full((round(length / DT), 2), 1.0 - 0.07 * kind)
        if joint is not None and number and not last:
            pace[:, joint] = 0.0
        recordings.append(measure(seconds(length), pace, seed=kind))
    q, tau = (np.concatenate(x) for x in zip(*recordings[:-1]))
    groups = np.repeat(np.arange(len(lengths)), [len(x) for x, _ in recordings[:-1]])
    loop = close(q, tau, groups=groups)
    *_, following = loop.report_.outcome.facts_of("next recording")
    error = loop.identifier_.residuals(*recordings[-1]).rms() / loop.torque_std_
    assert not loop.effects_
    assert not loop.report_.outcome.findings["contradictions"]
    # Ten copies of one recording underestimate the error slightly.
    low, high = following.interval
    assert 0.95 * low <= error.mean() <= high


def test_a_wrong_torque_unit_comes_first(two_motions):
    assert_complete(two_motions)
    report = TWO_MOTIONS.search(TWO_MOTIONS.torque * [1.0, 1e-3]).report_
    assert report.status == "faulty"
    assert report.headline.startswith("Fix the recording first. ")
    # The described masses decide which channel is wrong.
    (channel,) = report.outcome.findings["channels"]
    assert (channel.kind, channel.joints) == ("gear_factor", (1,))


def test_columns_are_matched_by_joint_names(two_motions):
    import pandas

    fitted, q, tau = two_motions, TWO_MOTIONS.position, TWO_MOTIONS.torque
    groups, loop = TWO_MOTIONS.groups, clone(fitted)
    names = ["joint_2", "joint_1"]
    X = pandas.DataFrame(q[:, ::-1], columns=[f"q_{name}" for name in names])
    y = pandas.DataFrame(tau[:, ::-1], columns=[f"tau_{name}" for name in names])
    by_name = loop.fit(X, y, groups=groups)
    np.testing.assert_allclose(by_name.error_after_, fitted.error_after_, rtol=1e-9)
    np.testing.assert_allclose(by_name.predict(X[:300]), fitted.predict(q[:300]))
    assert by_name.score(X, y, groups=groups) > 0.99
    with pytest.raises(ValueError, match="q_elbow"):
        loop.fit(X.rename(columns={"q_joint_2": "q_elbow"}), y, groups=groups)


@pytest.fixture(params=["other_robot", "mixed_torques"])
def other(monkeypatch, request):
    """Patch the channel findings: torques of another robot, or of other joints."""
    note = ChannelFinding(request.param, (0, 1), "warning", "Torques of others.")
    monkeypatch.setattr(RobotIdentifier, "findings", lambda *_: (note,))
    return note


@pytest.mark.parametrize("library", [(), ["spring", "offset"]])
@pytest.mark.parametrize("ripple", [0.0, 0.3])
def test_explained_torques_clear_the_wrong_robot_finding(library, ripple, other):
    torque = ARM.torque(
        joint_1=lambda r: 9.0 * r.q[:, 0] + ripple * np.sin(30.0 * r.q[:, 0])
    )
    outcome = ARM.discover(torque, library).report_.outcome
    # Mixed torques explain a few per cent, too.
    cleared = library and (not ripple or other.kind == "other_robot")
    assert outcome.findings["channels"] == (() if cleared else (other,))


def test_wrong_robot_finding_stays_without_error_estimates(other):
    t = DT * np.arange(1500)
    loop = close(*measure(t, pauses(t, [(0, 0.6)], [(0, 0.6)])), effects=())
    assert not loop.report_.outcome.column("enough").any()
    assert loop.report_.outcome.findings["channels"] == (other,)


@pytest.mark.parametrize("turns", ["before the velocity", "after it"])
def test_friction_of_stopping_joints_causes_no_false_positives(turns):
    t, rng = DT * np.arange(3000), np.random.default_rng(0)
    wanted = motion(t, np.ones((t.size, 2)))[:, 2:4]
    v = np.sign(wanted) * np.maximum(np.abs(wanted) - 0.3, 0.0)
    q, noise = np.cumsum(v, axis=0) * DT, rng.normal(size=(2, *v.shape))
    tau = inverse_dynamics(MODEL, np.hstack([q, v, np.gradient(v, DT, axis=0)]))
    rest = np.sign(np.gradient(wanted, axis=0)) * (-1 if turns == "after it" else 1)
    direction = np.where(np.abs(wanted) < 0.3, rest, np.sign(wanted))
    tau += VISCOUS * v + 3.0 * COULOMB * direction
    effects = ["delay", "jerk", "torque_filter", "stribeck"]
    assert named(close(q + 2e-5 * noise[0], tau + 0.05 * noise[1], effects)) == []
