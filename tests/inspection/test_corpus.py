"""A corpus of recordings with wrong channels: all are answered, grave ones gravely.

Small robots and short recordings; the same on measured robots where these are there.
"""

import numpy as np
import pytest

from sklearn_vbjfa import datasets
from sklearn_vbjfa.datasets import make_robot_recording

pytest.importorskip("pinocchio")

from sklearn_vbjfa.inspection import inspect_channels
from sklearn_vbjfa.model import is_prismatic
from tests._quick import checkered, one_in
from tests.inspection._channel_faults import FAULTS, visible
from tests.model._robots import random_tree

CASES = 4
# What the samples show by themselves needs no luck with the motion.
SAMPLES = [name for name, fault in FAULTS.items() if fault.seen_by == "samples"]
OF_ALL = ("degrees", "encoder counts, all joints")
MEASURED = ("staubli_tx40", "ur5", "franka_panda")


def chain(rng, axes):
    """Chain of links that lie along the way from joint to joint, as in an arm."""
    import pinocchio as pin

    model = pin.Model()
    for j, axis in enumerate(axes):
        joint = getattr(pin, f"JointModel{axis}")()
        shift = np.array([0.0, 0.0, 0.3]) + 0.05 * rng.normal(size=3)
        number = model.addJoint(j, joint, pin.SE3(np.eye(3), shift), f"joint_{j}")
        link = pin.Inertia.FromBox(4.0 / (1 + j), 0.08, 0.1, 0.3)
        centre = pin.SE3(np.eye(3), np.array([0.02, 0.03, 0.15]))
        model.appendBodyToJoint(number, link, centre)
    return model


def robot(seed):
    """Make one of several small robots and a sound recording of it."""
    rng = np.random.default_rng([seed, 12])
    if seed % 2:
        model = chain(
            rng, [("RY", "RX", "RY"), ("RZ", "RY", "RX", "RY")][seed % 4 // 2]
        )
    else:
        model, _ = random_tree(rng, 2 + seed % 3, ("RX", "RY", "RZ", "PZ"))
    recording = make_robot_recording(
        model,
        duration=float(rng.uniform(6, 10)),
        dt=float(rng.choice([0.005, 0.01])),
        frequency=float(rng.uniform(0.6, 1.2)),
        encoder_noise=float(10 ** rng.uniform(-5, -4)),
        torque_noise=float(rng.uniform(0.01, 0.1)),
        random_state=seed,
    )
    return model, recording.q, recording.tau, recording.dt


def joint_for(model, fault, rng):
    """Draw a joint that can have a fault, None if there is none."""
    revolute = np.flatnonzero(~is_prismatic(model))
    if fault.revolute and not revolute.size:
        return None
    return int(rng.choice(revolute if fault.revolute else np.arange(model.nv)))


def inspected(model, q, tau, dt, groups=None):
    """Inspect a recording; every finding is well formed."""
    findings = inspect_channels(model, q, tau, dt, groups)
    order = ["error", "doubt", "warning"]
    ranks = [order.index(finding.severity) for finding in findings]
    assert ranks == sorted(ranks)
    for finding in findings:
        assert "\n" not in finding.message
        assert len(finding.message) > 40
        assert set(finding.joints) <= set(range(model.nv))
        assert finding.joints
    return findings


def graves(findings):
    return {f.kind for f in findings if f.severity in {"error", "doubt"}}


@pytest.mark.parametrize("name", one_in(5, FAULTS))
def test_every_fault_is_noticed(name):
    fault = FAULTS[name]
    seen, named, can = 0, 0, 0
    for seed in range(CASES):
        model, q, tau, dt = robot(seed)
        rng = np.random.default_rng([seed, 13])
        j = joint_for(model, fault, rng)
        if j is None or (name in OF_ALL and is_prismatic(model).any()):
            continue
        state = rng.bit_generator.state
        shown = visible(model, fault, q, tau, dt, j, rng)
        rng.bit_generator.state = state
        kinds = graves(inspected(model, *fault.put(q, tau, dt, j, rng)))
        # What is named was visible, whatever was thought.
        shown = shown or bool(kinds & fault.kinds)
        can += shown
        seen += shown and bool(kinds)
        named += bool(kinds & fault.kinds)
    assert can >= 1
    # One is the luck of the motion, where the model has to show it.
    assert seen >= can - (name not in SAMPLES)
    assert named >= can - 1


@pytest.mark.parametrize("seed", one_in(3, range(15)))
def test_sound_recordings_have_none(seed):
    assert not graves(inspected(*robot(100 + seed)))


@pytest.mark.parametrize("seed", one_in(3, range(30)))
def test_two_faults_at_once(seed):
    rng = np.random.default_rng([seed, 14])
    model, q, tau, dt = robot(200 + seed)
    first, second = rng.choice(list(FAULTS), 2, replace=False)
    for name in (first, second):
        j = joint_for(model, FAULTS[name], rng)
        q, tau, dt = FAULTS[name].put(q, tau, dt, j or 0, rng)
    kinds = graves(inspected(model, q, tau, dt))
    if {first, second} & set(SAMPLES):
        assert kinds, (first, second)


@pytest.mark.parametrize(
    ("name", "seed"),
    checkered(["wrapped angle", "frozen logger", "positions held"], range(3)),
)
def test_faults_of_one_recording_of_two(name, seed):
    """What is wrong in one of several recordings is wrong."""
    rng = np.random.default_rng([seed, 15])
    model, q, tau, dt = robot(401 + seed)
    j = joint_for(model, FAULTS[name], rng)
    wrong_q, wrong_tau, _ = FAULTS[name].put(q, tau, dt, j, rng)
    q, tau = np.vstack([q, wrong_q]), np.vstack([tau, wrong_tau])
    groups = np.repeat([0, 1], len(wrong_q))
    assert graves(inspected(model, q, tau, dt, groups)) & FAULTS[name].kinds


# -- measured robots -------------------------------------------------------------------


def put_into(measured_data_home, name, faults):
    """Put faults into a stretch of a measured set; return those not noticed."""
    recording = getattr(datasets, f"fetch_{name}")(
        data_home=measured_data_home, download_if_missing=False
    )
    model = recording.robot_model()
    # Seconds of motion, whatever the rate.
    count = max(4000, round(4.0 / recording.dt))
    rows = np.flatnonzero(recording.groups == 0)[:count]
    q, tau = recording.q[rows], recording.tau[rows]
    missed = []
    for label in faults:
        rng = np.random.default_rng(3)
        j = joint_for(model, FAULTS[label], rng)
        wrong = FAULTS[label].put(q, tau, recording.dt, j, rng)
        if not graves(inspected(model, *wrong)):
            missed.append(label)
    return missed


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The robot description")
def test_faults_of_a_measured_robot(measured_data_home):
    some = ["encoder counts, one joint", "dt in ms", "wrapped angle"]
    assert put_into(measured_data_home, "ur5", some) == []


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The robot description")
@pytest.mark.parametrize("name", MEASURED)
def test_faults_of_measured_robots(measured_data_home, name):
    missed = put_into(measured_data_home, name, FAULTS)
    assert not set(missed) & set(SAMPLES)
