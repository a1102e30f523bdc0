"""Recordings with undeclared effects are what their truth says."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import _undeclared as undeclared
from _undeclared_hysteresis import lugre, maxwell_slip, pieces, play
from _undeclared_mimics import mimics
from _undeclared_robots import inverse_dynamics, is_prismatic

SHORT = {"duration": 20.0, "rate": 100.0}
EVERY = (*undeclared.LIBRARY, *undeclared.OUTSIDE)


def declared_fit(recording, *extra):
    """Share of the clean torque that declared and other columns leave, whitened."""
    others = [np.zeros_like(recording.tau_clean), *extra]
    return recording.span().share(recording.tau_clean, others)


@pytest.mark.parametrize("kind", EVERY)
def test_declared_columns_and_the_effect_explain_the_torque(kind):
    recording = undeclared.simulate([kind], seed=3, declared=None, **SHORT)
    (entry,) = recording.truth
    assert entry.name == kind
    assert entry.in_library == (kind in undeclared.LIBRARY)
    assert entry.visible
    assert declared_fit(recording, *recording.contributions) < 1e-6
    assert declared_fit(recording) > 1e-3


@pytest.mark.parametrize("kind", EVERY)
def test_size_is_as_asked(kind):
    recording = undeclared.simulate([kind], size=2.0, seed=5, declared=None, **SHORT)
    (entry,), (torque,) = recording.truth, recording.contributions
    rms = np.sqrt(np.mean(torque**2, axis=0)) / recording.torque_noise
    assert rms.max() == pytest.approx(entry.size)
    if kind in ("elastic", "delay"):
        assert entry.size <= 8.0
        assert entry.size >= 0.5
    else:
        assert 1.999 <= entry.size <= 8.001
        assert entry.outside >= 0.99
    if kind not in ("payload", "elastic"):
        assert np.argmax(rms) == entry.joint
        assert np.count_nonzero(rms) == 1
        assert entry.felt_by == (entry.joint,)


def test_a_seed_gives_one_recording():
    one, two, other = (
        undeclared.simulate(["coulomb", "delay"], seed=seed, **SHORT)
        for seed in (1, 1, 2)
    )
    assert one.truth == two.truth
    np.testing.assert_array_equal(one.q, two.q)
    np.testing.assert_array_equal(one.tau, two.tau)
    assert one.tau.shape != other.tau.shape or not np.array_equal(one.tau, other.tau)


def test_a_clean_recording_is_explained():
    recording = undeclared.simulate([], seed=0, declared=None, **SHORT)
    assert recording.truth == ()
    assert declared_fit(recording) < 1e-6


@pytest.mark.parametrize("robot", undeclared.ROBOTS)
def test_robots_and_noise(robot):
    recording = undeclared.simulate(
        ["ripple"], robot=robot, encoder_noise=3e-4, n_recordings=2, seed=1, **SHORT
    )
    n, nv = recording.q.shape
    assert 2 <= nv <= 7
    assert n == 2000
    assert np.unique(recording.groups).tolist() == [0, 1]
    assert is_prismatic(recording.model).any() == (robot == "prismatic")
    noise = recording.q - recording.states[:, :nv]
    np.testing.assert_allclose(noise.std(axis=0), recording.encoder_noise, rtol=0.1)
    noise = recording.tau - recording.tau_clean
    np.testing.assert_allclose(noise.std(axis=0), recording.torque_noise, rtol=0.1)
    for body in recording.inertial:
        assert body[0] > 0
    for rows in pieces(recording.groups):
        v = recording.states[rows, nv : 2 * nv]
        assert np.all(np.sum(v[1:] * v[:-1] < 0, axis=0) >= 1)


def test_states_are_derivatives_of_each_other_with_an_elastic_joint():
    recording = undeclared.simulate(["elastic"], seed=0, **SHORT)
    nv, rows = recording.model.nv, pieces(recording.groups)[0]
    q, v, a = np.split(recording.states[rows], 3, axis=1)
    h = recording.dt
    stencil = np.array([1, -8, 0, 8, -1]) / (12 * h)
    for x, slope in ((q, v), (v, a)):
        found = sum(c * x[k : len(x) - 4 + k] for k, c in enumerate(stencil))
        error = np.abs(found - slope[2:-2]).max(axis=0)
        assert np.all(error < 0.02 * np.abs(slope).max(axis=0))
    joint = recording.truth[0].joint
    assert 8.0 <= recording.truth[0].parameters["frequency"] <= 20.0
    assert 0 <= joint < nv


def test_several_effects_stay_apart():
    recording = undeclared.simulate(3, seed=4, size=(1.0, 3.0, 5.0), **SHORT)
    assert recording.visible
    for entry in recording.truth:
        assert entry.distinct >= 0.5 * entry.outside
    assert len({(entry.name, entry.joint) for entry in recording.truth}) == 3


def test_parameters_give_the_torque_back():
    recording = undeclared.simulate(
        ["coulomb", "spring", "ripple"], seed=2, declared=("viscous",), **SHORT
    )
    q, *_ = np.split(recording.states, 3, axis=1)
    found = dict(zip((e.name for e in recording.truth), recording.truth))
    torque = dict(zip(found, recording.contributions))
    entry = found["coulomb"]
    np.testing.assert_allclose(
        np.abs(torque["coulomb"]).max(), entry.parameters["Fc"], rtol=1e-3
    )
    entry, j = found["spring"], found["spring"].joint
    expected = entry.parameters["k"] * (q[:, j] - entry.parameters["q0"])
    np.testing.assert_allclose(torque["spring"][:, j], expected)
    entry, j = found["ripple"], found["ripple"].joint
    angle = 2 * np.pi * q[:, j] / entry.parameters["period"]
    expected = entry.parameters["A"] * np.cos(angle + entry.parameters["phase"])
    np.testing.assert_allclose(torque["ripple"][:, j], expected)


def test_payload_is_a_point_mass_on_the_last_body():
    import pinocchio as pin

    recording = undeclared.simulate(["payload"], seed=6, **SHORT)
    (entry,), (torque,) = recording.truth, recording.contributions
    p = entry.parameters
    states = np.split(recording.states, 3, axis=1)
    model = recording.model.copy()
    before = inverse_dynamics(model, *states)
    point = np.array([p["x"], p["y"], p["z"]])
    model.inertias[model.njoints - 1] += pin.Inertia(p["mass"], point, np.zeros((3, 3)))
    change = inverse_dynamics(model, *states) - before
    late = recording.t >= p["instant"]
    np.testing.assert_allclose(torque[late], change[late], atol=1e-9)
    assert not torque[~late].any()


@pytest.mark.parametrize(
    "kind", ["coulomb", "stribeck", "load_friction", "spring", "rotor_inertia"]
)
def test_an_effect_resembles_itself_most(kind):
    recording = undeclared.simulate([kind], seed=8, **SHORT)
    shares = mimics(recording, 0)
    # compound effects hold the plain one, so they may be as good
    assert shares[kind] > 0.9
    assert shares[kind] >= shares["offset"]
    assert all(-1e-9 <= share <= 1 + 1e-9 for share in shares.values())


def test_hidden_rotor_inertia_is_marked():
    # about the first axis it is the inertia of the first body
    recording = undeclared.simulate(
        ["rotor_inertia"], joints=[0], seed=0, robot="demo", **SHORT
    )
    assert not recording.truth[0].visible
    assert recording.truth[0].outside < 1e-6


def test_cases_are_even_over_the_kinds():
    n = len(undeclared.LIBRARY)
    cases = undeclared.draw_cases(3 * n, 2, (0.5, 10.0), seed=0)
    names = [kind for case in cases for kind in case.kinds]
    counts = [names.count(kind) for kind in undeclared.LIBRARY]
    assert min(counts) >= 5
    assert max(counts) <= 7
    sizes = np.array([case.size for case in cases])
    assert sizes.min() >= 0.5
    assert sizes.max() <= 10.0
    assert all(len(set(case.kinds)) == 2 for case in cases)
    assert cases == undeclared.draw_cases(3 * n, 2, (0.5, 10.0), seed=0)
    recording = cases[0].simulate(**SHORT)
    assert tuple(entry.name for entry in recording.truth) == cases[0].kinds


def test_hysteresis_saturates_and_reverses_over_the_displacement():
    q = np.concatenate([np.linspace(0, 1, 2000), np.linspace(1, 0, 2000)])
    dt = 1e-3
    v = np.gradient(q, dt)
    bristles = lugre(v, dt, displacement=0.02, lag=0.0, rise=0.0, speed=0.1)
    springs = maxwell_slip(q, np.array([0.01, 0.03]), np.array([1.0, 0.5]))
    for friction in (bristles, springs):
        assert friction[1900] == pytest.approx(1.0, abs=1e-6)
        assert friction[-100] == pytest.approx(-1.0, abs=1e-6)
        # it has not turned yet a thousandth after the reversal
        assert friction[2002] > 0.5
    # the slope after the start is one over the displacement
    assert bristles[10] == pytest.approx(q[10] / 0.02, rel=0.2)
    follower = play(q, 0.2)
    assert follower[1999] == pytest.approx(0.9)
    assert follower[2200] == pytest.approx(0.9)
    assert follower[-1] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("kinds", "declared"), [(["coulomb"], ("coulomb",)), (["gremlins"], ())]
)
def test_what_cannot_be_undeclared_is_refused(kinds, declared):
    with pytest.raises(ValueError, match="expected undeclared effects"):
        undeclared.simulate(kinds, declared=declared)
