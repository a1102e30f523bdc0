"""What is done to recordings of measured robots is found as in simulated ones."""

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import datasets
from sklearn_vbjfa.inspection import inspect_channels


@pytest.fixture(scope="module")
def measured(measured_data_home):
    """Model, positions, torques and sample period of a measured set, by its name."""
    known = {}

    def load(name):
        if name not in known:
            fetch = getattr(datasets, f"fetch_{name}")
            one = fetch(data_home=measured_data_home, download_if_missing=False)
            rows = np.flatnonzero(one.groups == one.groups[0])[:12000]
            known[name] = one.robot_model(), one.q[rows], one.tau[rows], one.dt
        return known[name]

    return load


def weightless(model, q, tau):
    """Torques less the described weight."""
    data = model.createData()
    return tau - [pin.computeGeneralizedGravity(model, data, x).copy() for x in q]


def one_changed(nv, j, value, usual):
    """Values (nv,) of which one is another."""
    return np.where(np.arange(nv) == j, value, usual)


def pushed(tau):
    """Torques with those of a contact."""
    tau, n = tau.copy(), len(tau)
    tau[n // 3 : n // 2] += 2 * tau.std(axis=0)
    return tau


CURRENTS = [0.08, 0.045, 0.013, 0.12, 0.015, 0.13, 0.2]
# Set, what is done to its model, positions and torques, kind of the first finding and
# joints of it; None for all.
DONE = {
    "zero of the elbow": ("ur5", lambda m, q, y: (
        q + one_changed(6, 2, 2.2, 0), y), "position_zero", (2,)),
    "zeros at power-up": ("ur5", lambda m, q, y: (q - q[0], y), "position_zeros", ()),
    "zeros at power-up, seven joints": ("franka_panda", lambda m, q, y: (
        q - q[0], y), "position_zeros", ()),
    "torque of a motor": ("franka_panda", lambda m, q, y: (
        q, y / one_changed(7, 1, 109, 1)), "gear_factor", (1,)),
    "torque of a vertical joint's motor": ("ur5", lambda m, q, y: (
        q, y / one_changed(6, 0, 100, 1)), "gear_factor", (0,)),
    "currents": ("franka_panda", lambda m, q, y: (
        q, y * CURRENTS), "torque_factors", None),
    "currents, two joints held up": ("kuka_lbr_med7", lambda m, q, y: (
        q, y * CURRENTS), "torque_factors", None),
    "no weight": ("kuka_lbr_med7", lambda m, q, y: (
        q, weightless(m, q, y)), "no_gravity", (1, 3)),
    "contact": ("franka_panda", lambda m, q, y: (q, pushed(y)), "external_force", None),
    "contact, coupled wrist": ("staubli_tx40", lambda m, q, y: (
        q, pushed(y)), "external_force", None),
}  # fmt: skip


@pytest.mark.parametrize("case", DONE)
def test_what_is_done_to_a_measured_log_is_found(measured, case):
    name, done, kind, joints = DONE[case]
    model, q, tau, dt = measured(name)
    found = inspect_channels(model, *done(model, q, tau), dt)
    found = [x for x in found if x.severity != "note"]
    assert [x.kind for x in found] == [kind]
    if joints != ():
        assert found[0].joints == (joints or tuple(range(model.nv)))


@pytest.mark.parametrize("name", ["ur5", "franka_panda", "staubli_tx40"])
def test_a_measured_log_is_sound(measured, name):
    found = inspect_channels(*measured(name))
    assert [x.kind for x in found if x.severity != "note"] == []


def test_a_mirrored_wrist_may_be_its_torque(measured):
    model, q, tau, dt = measured("ur5")
    (found,) = inspect_channels(model, q * one_changed(6, 5, -1, 1), tau, dt)
    assert {found.kind, *found.rivals} == {"torque_sign", "position_sign"}


def test_the_description_of_another_robot_has_no_wrong_zeros(measured):
    model, log = measured("ur5")[0], datasets.load_demo_recording().select(0)
    found = inspect_channels(model, log.q, log.tau, log.dt)
    assert [x.kind for x in found if x.severity != "note"] == ["other_robot"]
