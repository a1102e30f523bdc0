"""Faults put into recordings of real robots."""

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import datasets
from sklearn_vbjfa.inspection import inspect_channels


@pytest.fixture(scope="module")
def measured(measured_data_home):
    """Load model, positions, torques and sample period of a measured set by name."""
    cache = {}

    def load(name):
        if name not in cache:
            fetch = getattr(datasets, f"fetch_{name}")
            log = fetch(data_home=measured_data_home, download_if_missing=False)
            rows = np.flatnonzero(log.groups == log.groups[0])[:12000]
            cache[name] = log.robot_model(), log.q[rows], log.tau[rows], log.dt
        return cache[name]

    return load


def without_gravity(model, q, tau):
    """Subtract the gravity torques of the description."""
    data = model.createData()
    return tau - [pin.computeGeneralizedGravity(model, data, x).copy() for x in q]


def with_value(nv, j, value, usual):
    """Return values (nv,), all `usual` except for joint `j`."""
    return np.where(np.arange(nv) == j, value, usual)


def pushed(tau):
    """Add the torques of a temporary contact."""
    tau, n = tau.copy(), len(tau)
    tau[n // 3 : n // 2] += 2 * tau.std(axis=0)
    return tau


CURRENTS = [0.08, 0.045, 0.013, 0.12, 0.015, 0.13, 0.2]
# Data set, change of positions and torques, kind of the finding and its joints (None:
# all; empty: not checked).
FAULTS = {
    "zero of the elbow": ("ur5", lambda m, q, y: (
        q + with_value(6, 2, 2.2, 0), y), "position_zero", (2,)),
    "zeros at power-up": ("ur5", lambda m, q, y: (q - q[0], y), "position_zeros", ()),
    "zeros at power-up, seven joints": ("franka_panda", lambda m, q, y: (
        q - q[0], y), "position_zeros", ()),
    "torque of a motor": ("franka_panda", lambda m, q, y: (
        q, y / with_value(7, 1, 109, 1)), "gear_factor", (1,)),
    "torque of a vertical joint's motor": ("ur5", lambda m, q, y: (
        q, y / with_value(6, 0, 100, 1)), "gear_factor", (0,)),
    "currents": ("franka_panda", lambda m, q, y: (
        q, y * CURRENTS), "torque_factors", None),
    "currents, two joints held up": ("kuka_lbr_med7", lambda m, q, y: (
        q, y * CURRENTS), "torque_factors", None),
    "no weight": ("kuka_lbr_med7", lambda m, q, y: (
        q, without_gravity(m, q, y)), "no_gravity", (1, 3)),
    "contact": ("franka_panda", lambda m, q, y: (q, pushed(y)), "external_force", None),
    "contact, coupled wrist": ("staubli_tx40", lambda m, q, y: (
        q, pushed(y)), "external_force", None),
}  # fmt: skip


@pytest.mark.parametrize("case", FAULTS)
def test_faults_put_into_measured_logs_are_found(measured, case):
    name, change, kind, joints = FAULTS[case]
    model, q, tau, dt = measured(name)
    findings = inspect_channels(model, *change(model, q, tau), dt)
    findings = [x for x in findings if x.severity != "note"]
    assert [x.kind for x in findings] == [kind]
    if joints != ():
        assert findings[0].joints == (joints or tuple(range(model.nv)))


WHOLE = dict.fromkeys(["ur5", "franka_panda", "staubli_tx40"]).items()
PARTS = ("kuka_kr300", 833), ("franka_panda", 10271)


@pytest.mark.parametrize(("name", "stop"), [*WHOLE, *PARTS])
def test_measured_logs_have_no_faults(measured, name, stop):
    model, q, tau, dt = measured(name)
    groups = stop and np.searchsorted([4916, 9858], np.arange(stop), side="right")
    findings = inspect_channels(model, q[:stop], tau[:stop], dt, groups)
    assert [x.kind for x in findings if x.severity != "note"] == []


def test_sign_of_wrist_position_or_torque_is_ambiguous(measured):
    model, q, tau, dt = measured("ur5")
    (finding,) = inspect_channels(model, q * with_value(6, 5, -1, 1), tau, dt)
    assert {finding.kind, *finding.rivals} == {"torque_sign", "position_sign"}


def test_the_description_of_another_robot_has_no_wrong_zeros(measured):
    model, log = measured("ur5")[0], datasets.load_demo_recording().select(0)
    findings = inspect_channels(model, log.q, log.tau, log.dt)
    assert [x.kind for x in findings if x.severity != "note"] == ["other_robot"]
