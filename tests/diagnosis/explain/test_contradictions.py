import numpy as np
import pytest

from sklearn_vbjfa import EffectDiscovery
from sklearn_vbjfa.diagnosis.explain import FinalFit, RecordingMoments, contradictions
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.recording import take_arrays
from tests.diagnosis._recordings import TWO_MOTIONS, record
from tests.effects._arms import inverse_dynamics, last_body_regressor

FRICTION = ("viscous", "coulomb")
PAIR = TWO_MOTIONS.parts
FOUR = tuple(record("ZY", seed=seed, duration=16.0) for seed in (13, 14, 15, 16))
THREE = tuple(record("ZYX", seed=seed, duration=16.0) for seed in (13, 14, 15))


def unchanged(k, torque, r):
    return torque


def compare(recordings, disturb=unchanged, bodies="free", idle=(), numbers=range(4)):
    """Find contradictions between recordings of an arm, with disturbed torques."""
    X = np.concatenate([part.position for part in recordings])
    y = [disturb(k, part.torque(), part) for k, part in enumerate(recordings)]
    groups = np.repeat(range(len(recordings)), list(map(len, y)))
    y, robot = np.concatenate(y), recordings[0].robot(friction=FRICTION, bodies=bodies)
    weight = 1.0 - np.outer(np.isin(groups, idle), np.arange(y.shape[1]) == 1)
    robot.fit(X, y, groups, sample_weight=weight)
    names = {"dt": robot.dt, "joint_names": robot.joint_names_}
    measured = take_arrays(X, y, groups, weight, **names)
    view = RecordingView(robot, measured, origin=np.array(numbers)[groups])
    fit, spread = FinalFit(robot, robot, view), np.ones(y.shape[1])
    return fit, contradictions(RecordingMoments.of(fit), spread, 0.05)


def second_only(change):
    """Disturb the second recording only."""
    return lambda k, torque, r: change(torque, r) if k == 1 else torque


gain = second_only(lambda torque, r: torque * [1.0, 1.2])
flipped = second_only(lambda torque, r: torque * [1.0, -1.0])
offset = second_only(lambda torque, r: torque + [0.0, 0.7])
friction = second_only(lambda torque, r: torque + 0.8 * np.sign(r.v))
joint_friction = second_only(lambda torque, r: torque + [0.0, 0.8] * np.sign(r.v))


def test_recordings_of_one_robot_agree():
    seeds = [(seed, seed + 50) for seed in range(20, 26)]
    pairs = [[record("ZY", seed=k, duration=16.0) for k in pair] for pair in seeds]
    # A single recording cannot contradict another.
    for recordings in (PAIR[:1], PAIR, FOUR, *pairs):
        assert compare(recordings)[1] == ()


@pytest.mark.parametrize("recordings", [PAIR, FOUR])
@pytest.mark.parametrize(
    ("disturb", "cause", "value"),
    [
        (gain, "gain", 1.2),
        (flipped, "gain", -1.0),
        (offset, "offset", 0.7),
        (joint_friction, "friction", np.nan),
    ],
)
def test_recording_and_cause_are_reported(recordings, disturb, cause, value):
    _, (contradiction,) = compare(recordings, disturb)
    assert (contradiction.cause, contradiction.joint) == (cause, 1)
    # With two recordings, more friction in one equals less in the other.
    if len(recordings) > 2 or cause != "friction":
        assert contradiction.recording == 1
    assert contradiction.value == pytest.approx(value, rel=0.03, nan_ok=True)
    assert contradiction.p_value < 0.05
    assert not contradiction.alone > np.sqrt(0.5) * contradiction.together


def keys(matches):
    return {(x.cause, x.recording, x.joint) for x in matches}


@pytest.mark.parametrize("joint", range(3))
def test_the_deviating_recording_need_not_fit_itself(joint):
    """No bodies explain the torques of all joints if one has another gain."""
    disturb = second_only(lambda torque, r: torque * 1.15 ** (np.arange(3) == joint))
    # Of another recording, no rows were searched.
    _, found = compare(THREE, disturb, bodies="prior", numbers=(0, 2, 3))
    assert keys(found) == {("gain", 2, joint)}


def test_joints_may_lack_data_in_the_last_recording():
    assert keys(compare(FOUR, offset, idle=[3])[1]) == {("offset", 1, 1)}


def test_model_errors_neither_cause_nor_hide_contradictions():
    def fault(k, torque, recording):
        unmodelled = np.sin(5 * recording.q) * np.sign(recording.v)
        return torque + 0.03 * torque.std(axis=0) * unmodelled

    def with_offset(k, torque, recording):
        return fault(k, torque, recording) + [0.0, 0.12 * torque[:, 1].std() * (k == 1)]

    assert compare(FOUR, fault)[1] == ()
    pair = [record("ZY", seed=k, duration=20.0, size=22 / k) for k in (22, 44)]
    assert compare(pair, lambda k, torque, r: torque + r.q**3)[1] == ()
    assert keys(compare(FOUR, with_offset)[1]) == {("offset", 1, 1)}


def torque_of(recording, body):
    """Torque of a body attached to the last link."""
    states = np.hstack([recording.q, recording.v, recording.a])
    return last_body_regressor(recording.model, states) @ body


BALL = np.array([0.6, 0.05, 0.02, 0.12, 0.02, 0.0, 0.02, 0.0, 0.0, 0.02])


def test_a_payload_in_one_recording_is_found():
    found = compare(FOUR, second_only(lambda torque, r: torque + torque_of(r, BALL)))[1]
    assert {x[:2] for x in keys(found)} == {("payload", 1)}


@pytest.mark.parametrize("zero", [0.06, -0.04])
def test_a_shifted_encoder_zero_in_one_recording_is_found(zero):
    states = np.hstack([FOUR[1].q - [0.0, zero], FOUR[1].v, FOUR[1].a])
    change = inverse_dynamics(FOUR[1].model, states) - FOUR[1].load
    found = compare(FOUR, second_only(lambda torque, r: torque + change))[1]
    assert {(x.recording, x.cause, x.of) for x in found} == {(1, "zero", 1)}
    assert [x.value for x in found] == pytest.approx(len(found) * [zero], rel=0.05)


def discovered(torques, names, effects):
    """Search the recordings called by some names, in their order."""
    parts = {name: FOUR["abcd".index(name)] for name in names}
    robot = FOUR[0].robot(friction=FRICTION)
    groups = np.repeat([*names], [part.t.size for part in parts.values()])
    X = np.concatenate([part.position for part in parts.values()])
    y = np.concatenate([torques(name, part) for name, part in parts.items()])
    loop = EffectDiscovery(robot, effects=effects).fit(X, y, groups=groups)
    differing = loop.report_.outcome.findings["contradictions"]
    return loop, {(names[x.recording], x.cause, x.joint) for x in differing}


def test_the_order_of_recordings_does_not_decide():
    def torques(name, part):
        return part.torque() + (name == "c") * torque_of(part, BALL)

    for names in ("abc", "acb", "cab"):
        loop, differing = discovered(torques, names, ["payload", "spring"])
        assert loop.effects_ == ()
        assert {x[:2] for x in differing} == {("c", "payload")}


def test_effects_on_joints_that_differ_between_recordings_are_only_possible():
    def torques(name, part):
        return part.torque() + 4.0 * part.q + [0.0, 0.7 * (name == "b")]

    loop, differing = discovered(torques, "abcd", ["spring"])
    assert differing == {("b", "offset", 1)}
    (spring,), (possible,) = loop.effects_, loop.possible_
    assert [(x.name, x.joint) for x in (spring, possible)] == [
        ("spring", 0),
        ("spring", 1),
    ]
    assert "contradict" in possible.warning


def test_a_heavier_last_link_is_reported_as_payload():
    model = FOUR[0].model
    last = 0.3 * model.inertias[model.nv].toDynamicParameters()
    heavier = second_only(lambda torque, r: torque + torque_of(r, last))
    matches = compare(FOUR, heavier, bodies="prior")[1]
    # Its mass is not identifiable on this arm.
    facts = {(x.cause, x.recording, np.isnan(x.value)) for x in matches}
    assert facts == {("payload", 1, True)}


def test_several_contradictions_are_found():
    def friction_and_offset(k, torque, recording):
        return friction(k, torque, recording) + [0.0, 0.7 * (k == 2)]

    found = keys(compare(FOUR, friction_and_offset)[1])
    assert found == {("friction", 1, 0), ("friction", 1, 1), ("offset", 2, 1)}
    offsets = (0.6, -0.5, 0.3, -0.7)
    matches = compare(FOUR, lambda k, torque, r: torque + [0.0, offsets[k]])[1]
    assert keys(matches) == {("offset", k, 1) for k in range(4)}
    for x in matches:
        assert x.value == pytest.approx(offsets[x.recording], rel=0.05)


def test_contradiction_errors_match_separate_fits():
    fit, result = compare(PAIR, gain)
    view, origin = fit.view, fit.view.origin
    worst = max(result, key=lambda x: x.together)
    rows_of_worst = np.flatnonzero(origin == worst.recording)
    motion = view.equations.weight[rows_of_worst].sum(axis=1).cumsum()
    thirds = np.split(rows_of_worst, np.searchsorted(3 * motion / motion[-1], [1, 2]))
    Phi, tau = view.equations.Phi, view.equations.tau
    weight = view.equations.weight * view.precision
    size = np.linalg.norm(Phi.reshape(-1, Phi.shape[2]), axis=0)

    def squares(kept):
        total = 0.0
        for third in thirds:
            out = np.isin(np.arange(origin.size), third)
            rows = kept & ~out
            root = np.sqrt(weight[rows])[:, :, None]
            A = (Phi[rows] * root).reshape(-1, Phi.shape[2]) / np.maximum(size, 1e-9)
            b = (tau[rows] * root[:, :, 0]).ravel()
            theta = np.linalg.lstsq(A, b, rcond=1e-7)[0] / np.maximum(size, 1e-9)
            residual = tau[out, worst.joint] - Phi[out, worst.joint] @ theta
            total += (view.equations.weight[out, worst.joint] * residual**2).sum()
        return total

    mean = view.equations.weight[rows_of_worst, worst.joint].sum()
    alone = np.sqrt(squares(origin == worst.recording) / mean)
    together = np.sqrt(squares(np.ones(origin.size, dtype=bool)) / mean)
    assert worst.alone == pytest.approx(alone, rel=1e-3)
    assert worst.together == pytest.approx(together, rel=1e-3)


def test_report_names_the_contradicting_recording(two_motions):
    torques = [gain(k, torque, None) for k, torque in enumerate(TWO_MOTIONS.torques)]
    loop = TWO_MOTIONS.search(np.concatenate(torques))
    texts = str(loop.report_), loop.report_.to_html()
    text, page = (" ".join(x.split()) for x in texts)
    assert "Recordings slow and fast contradict each other" in text
    assert "times as large in recording fast accounts for the difference (p" in page
    data = loop.report_.to_dict()
    assert data["provenance"]["recordings"] == ["slow", "fast"]
    assert data["contradictions"][0]["cause"] == "gain"
    assert two_motions.report_.to_dict()["contradictions"] == []
    assert "contradict" not in str(two_motions.report_)
    assert "Limits of the recordings" not in two_motions.report_.to_html()


@pytest.mark.slow
def test_repeated_motions_are_left_out_together():
    q = np.concatenate([PAIR[k].position for k in (0, 1, 0)])
    rng = np.random.default_rng(0)
    tau = np.concatenate([PAIR[k].torque() for k in (0, 1, 0)])
    tau += 0.01 * rng.standard_normal(tau.shape)
    groups = np.repeat(np.arange(3), [len(PAIR[k].t) for k in (0, 1, 0)])
    robot = PAIR[0].robot(friction=FRICTION)

    def expected(*recordings):
        rows = np.isin(groups, recordings)
        loop = EffectDiscovery(robot, effects=[])
        loop.fit(q[rows], tau[rows], groups=groups[rows])
        outcome = loop.report_.outcome
        (*_, mean) = outcome.facts_of("next recording")
        return outcome.provenance["left_out"], mean.source

    assert expected(0, 1, 2) == (2, "partly measured")
    assert expected(0, 2) == (0, "assumed")
