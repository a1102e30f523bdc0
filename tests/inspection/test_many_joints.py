"""Robots of many joints: what is examined of all exchanges, and no fit made twice."""

from itertools import combinations

import numpy as np
import pytest

from sklearn_vbjfa.datasets import make_robot_recording

pytest.importorskip("pinocchio")

import pinocchio as pin

from sklearn_vbjfa.inspection import (
    ChannelEquations,
    _geometry,
    channel_signals,
    fits_of,
    inspect_channels,
)
from tests._quick import checkered
from tests.model._robots import random_tree

AXES = ("RY", "RX", "RZ", "RY")


def arms(count, axes=AXES):
    """Several arms on one base, on parts of a robot that do not move each other."""
    rng = np.random.default_rng(7)
    model = pin.Model()
    for arm in range(count):
        last = 0
        for j, axis in enumerate(axes):
            place = pin.SE3(np.eye(3), np.r_[0.0, 0.0, 0.3] + 0.1 * rng.normal(size=3))
            joint = getattr(pin, f"JointModel{axis}")()
            last = model.addJoint(last, joint, place, f"arm_{arm}_joint_{j}")
            link = pin.Inertia.FromBox(4.0 / (1 + j), 0.08, 0.1, 0.3)
            centre = pin.SE3(np.eye(3), np.array([0.05, 0.03, 0.15]))
            model.appendBodyToJoint(last, link, centre)
    return model


def recorded(model, seed=0):
    return make_robot_recording(
        model, duration=12.0, dt=0.01, torque_noise=0.02, random_state=seed
    )


def signals_of(recording):
    usable = np.ones(recording.q.shape, dtype=bool)
    parts = [slice(0, len(recording.q))]
    return channel_signals(
        recording.q, recording.tau, recording.dt, parts, usable
    ).thinned(500)


@pytest.fixture(scope="module")
def three_arms():
    model = arms(3)
    return model, recorded(model)


@pytest.mark.parametrize("seed", range(3))
def test_a_torque_depends_on_the_joints_on_its_chain_alone(seed):
    rng = np.random.default_rng(seed)
    model, _ = random_tree(rng, 7, ("RX", "RY", "RZ", "PZ"))
    data = model.createData()
    state = rng.normal(size=(3, model.nv))
    before = pin.rnea(model, data, *state).copy()
    depends = np.zeros((model.nv, model.nv), dtype=bool)
    for k in range(model.nv):
        moved = state.copy()
        moved[:, k] += [0.3, 0.2, 0.1]
        depends[:, k] = np.abs(pin.rnea(model, data, *moved) - before) > 1e-12
    for j, reads in enumerate(_geometry._reads(model)):
        assert set(np.flatnonzero(depends[j])) <= set(reads)
        # on other branches nothing is read
        on = {i - 1 for k in model.subtrees[j + 1] for i in model.supports[k]} - {-1}
        assert set(reads) == on


def test_fits_that_are_kept_are_those_made_anew(three_arms):
    model, recording = three_arms
    signals = signals_of(recording)
    joints = list(range(model.nv))
    trial = _geometry._Trial(model, signals, joints)
    rng = np.random.default_rng(0)
    offset, sign = np.zeros(model.nv), np.ones(model.nv)
    offset[5], sign[9] = 0.7, -1.0
    ways = [
        {"kind": kind, "order": rng.permutation(model.nv)}
        for kind in ("swapped_positions", "swapped_joints", "swapped_torques")
    ]
    swap = _geometry._exchanged(np.arange(model.nv), (1, 6))
    ways += [{"kind": "swapped_joints", "order": swap}]
    ways += [{"kind": "flipped_joint", "sign": sign}]
    ways += [{"kind": "position_zero", "offset": offset}]
    for way in [*ways, *ways[::-1]]:
        correction = _geometry.Correction(joints=(), **way)
        right = correction.put_right(signals)
        anew = fits_of(ChannelEquations(model, right), right)
        kept = trial._errors(correction)
        assert kept.keys() == anew.keys()
        for j, fit in anew.items():
            np.testing.assert_allclose(kept[j].log_error, fit.log_error)
        # what rules a correction out before there are such fits
        new = _geometry._Trial(model, signals, joints)
        least = new._errors(correction, ChannelEquations.least_errors)
        assert least.keys() == anew.keys()
        for j, fit in anew.items():
            np.testing.assert_allclose(least[j].log_variance, fit.log_variance)
            assert (least[j].log_error <= fit.log_error + 1e-9).all()
    # one joint of one arm leaves the other two arms alone
    known = trial._known[ChannelEquations.fit]
    count = len(known)
    other = offset.copy()
    other[5] = -0.7
    trial._errors(_geometry.Correction(joints=(), kind="position_zero", offset=other))
    assert len(known) == count + len(AXES)


def test_most_corrections_are_ruled_out_by_one_fit_to_all_blocks(three_arms):
    model, recording = three_arms
    trial = _geometry._Trial(model, signals_of(recording), list(range(model.nv)))
    assert trial.directions() == trial.zeros() == []
    made = len(trial._known[ChannelEquations.fit]) - model.nv
    # Directions and seven zeros of each joint, each read by the four joints of its arm.
    assert len(trial._known[ChannelEquations.least_errors]) == model.nv * (1 + 7) * 4
    assert made < model.nv * (1 + 7) * 4 / 3


@pytest.mark.parametrize("count", [1, 3])
def test_few_pairs_for_each_joint_all_of_few_joints(three_arms, count):
    model, recording = three_arms
    signals = signals_of(recording)
    equations = ChannelEquations(model, signals)
    joints = list(range(len(AXES) * count))
    pairs = _geometry._likely(equations, signals, joints)
    everything = list(combinations(joints, 2))
    assert set(pairs) <= set(everything)
    assert len(pairs) == min(len(everything), 3 * len(joints))
    if count == 1:
        assert pairs == everything


@pytest.mark.parametrize("pair", [(1, 6), (4, 11)])
def test_exchanged_torques_are_the_likeliest(three_arms, pair):
    model, recording = three_arms
    signals = signals_of(recording)
    order = _geometry._exchanged(np.arange(model.nv), pair)
    for torques in (True, False):
        wrong = signals.permuted(order, positions=not torques, torques=torques)
        equations = ChannelEquations(model, wrong)
        likely = _geometry._likely(equations, wrong, list(range(model.nv)))
        assert likely[0] == pair


@pytest.mark.parametrize(
    ("pair", "kind"), checkered([(1, 6), (8, 10)], ["torques", "positions", "joints"])
)
def test_exchanged_channels_of_many_joints_are_found(three_arms, pair, kind):
    model, recording = three_arms
    order = _geometry._exchanged(np.arange(model.nv), pair)
    q, tau = recording.q, recording.tau
    q = q[:, order] if kind != "torques" else q
    tau = tau[:, order] if kind != "positions" else tau
    findings = inspect_channels(model, q, tau, recording.dt)
    errors = [(f.kind, f.joints) for f in findings if f.severity == "error"]
    assert errors == [(f"swapped_{kind}", pair)]


def test_nothing_is_found_in_many_sound_joints(three_arms):
    model, recording = three_arms
    assert inspect_channels(model, recording.q, recording.tau, recording.dt) == ()
