"""Known masses fix the gain that all torque channels have in common."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

pin = pytest.importorskip("pinocchio")

from sklearn_vbjfa import RobotIdentifier  # noqa: E402
from sklearn_vbjfa._core._linear_systems import scaled_eigen  # noqa: E402
from sklearn_vbjfa.effects import LoadFriction, Payload  # noqa: E402
from sklearn_vbjfa.robot._estimate import IDENTIFIABLE, PlainEstimate  # noqa: E402
from sklearn_vbjfa.robot._gains import common_gain  # noqa: E402
from tests.effects._arms import arm, inverse_dynamics, motion  # noqa: E402

DT = 0.02
EXACT = {
    "friction": ("viscous",),
    "projector": None,
    "cutoff": None,
    "standstill": None,
    "dt": DT,
}
ARM = arm("ZYX")
GAINS = np.array([8.0, 5.0, 12.0])
T, STATES = motion(3, duration=20.0, dt=DT, seed=4)
PICKED = 10.0
MASS, CENTRE = 1.5, np.array([0.02, 0.0, 0.1])


def recorded(model=ARM, gains=GAINS, payload=MASS, noise=0.01, seed=0, states=STATES):
    """Compute what channels read while a ball is picked up halfway."""
    exact = inverse_dynamics(model, states)
    if payload:
        loaded = model.copy()
        # A point mass: nothing of its own inertia.
        ball = pin.Inertia(payload, CENTRE, np.zeros((3, 3)))
        loaded.inertias[model.nv] = loaded.inertias[model.nv] + ball
        after = (T >= PICKED)[:, None]
        exact = np.where(after, inverse_dynamics(loaded, states), exact)
    exact = exact * gains
    white = np.random.default_rng(seed).normal(size=exact.shape)
    return exact + noise * exact.std(axis=0) * white


def fit(tau, masses, model=ARM, effects=None, states=STATES, **given):
    if effects is None:
        effects = [Payload(joint=model.nv - 1, instant=PICKED, centre=tuple(CENTRE))]
    robot = RobotIdentifier(
        model, effects=effects, gains="unknown", known_masses=masses, **EXACT, **given
    )
    return robot.fit(states, tau)


def place(robot, name):
    return robot.parameter_names_.index(name)


def test_a_known_payload_makes_gains_absolute():
    tau = recorded()
    robot = fit(tau, {"payload": MASS})
    found = robot.gains_
    assert found.absolute
    assert_allclose(found.gain, GAINS, rtol=0.03)
    assert np.all(np.abs(found.gain - GAINS) < 3 * found.std)
    dm = place(robot, "joint_3:payload:dm")
    assert_allclose(robot.theta_[dm], MASS, rtol=1e-9)
    (first,) = found.references
    assert_allclose(found.common.factor, found.gain[first])
    assert_allclose(found.common.std, found.std[first], rtol=1e-6)
    (used,) = found.common.masses
    assert (used.name, used.mass) == ("payload", MASS)
    assert used.used
    assert used.shown
    # In closed form: what the recording has for it, over what it is.
    relative = fit(tau, None)
    assert_allclose(relative.theta_[dm] / MASS, found.common.factor, rtol=1e-9)
    assert_allclose(relative.gains_.gain * found.common.factor, found.gain, rtol=1e-9)


@pytest.mark.parametrize(
    "effects",
    [
        [Payload(joint=2, instant=PICKED, centre=tuple(CENTRE))],
        [
            Payload(joint=2, instant=PICKED, centre=tuple(CENTRE)),
            LoadFriction(joint=1),
        ],
    ],
)
def test_predictions_are_the_same_in_kg(effects):
    tau = recorded()
    asked = tau, None, ARM, effects
    relative, absolute = fit(*asked), fit(tau, {"payload": MASS}, ARM, effects)
    difference = absolute.predict(STATES, t=T) - relative.predict(STATES, t=T)
    assert np.abs(difference).max() < 1e-8 * tau.std()
    rows = absolute.residuals(STATES, tau, t=T).predicted
    assert_allclose(rows, relative.residuals(STATES, tau, t=T).predicted, rtol=1e-7)


def test_what_is_put_down_counts_as_well():
    tau = recorded()[::-1]
    states = STATES[::-1] * np.repeat([1, -1, 1], 3)
    robot = fit(tau, {"payload": MASS}, states=states)
    assert_allclose(robot.gains_.gain, GAINS, rtol=0.05)
    assert_allclose(robot.theta_[place(robot, "joint_3:payload:dm")], -MASS, rtol=1e-9)


@pytest.mark.slow
def test_deviations_are_those_of_repeated_recordings():
    """Also of parameters whose error the common gain has a part in."""
    found = [
        fit(recorded(seed=seed, noise=0.02), {"payload": MASS}, joint_weights=None)
        for seed in range(24)
    ]
    names = found[0].parameter_names_
    told = [
        names.index(name)
        for name in (
            *(f"joint_{j}:torque_gain:gain" for j in (1, 2, 3)),
            "joint_2:viscous",
            "joint_3:mc_y",
            "joint_3:payload:dmcz",
        )
    ]
    assert all(found[0].identifiable_[told])
    values = np.array([robot.theta_[told] for robot in found])
    std = np.sqrt(np.mean([robot.theta_std_[told] ** 2 for robot in found], axis=0))
    ratio = values.std(axis=0, ddof=1) / std
    # Of 24 draws a deviation is known to 15 %.
    assert np.all((ratio > 0.55) & (ratio < 1.5)), ratio


def test_a_mass_that_slides_fixes_the_scale():
    model = arm("ZYx")
    tau = recorded(model, payload=0)
    mass = model.inertias[3].mass
    robot = fit(tau, {"joint_3": mass}, model, effects=())
    assert_allclose(robot.gains_.gain, GAINS, rtol=0.03)
    assert_allclose(robot.theta_[place(robot, "joint_3:m")], mass, rtol=1e-9)
    assert robot.theta_std_[place(robot, "joint_3:m")] < 1e-4 * mass


def test_a_mass_that_turns_does_not():
    robot = fit(recorded(payload=0), {"joint_3": 1.0}, effects=())
    (mass,) = robot.gains_.common.masses
    assert not robot.gains_.absolute
    assert (mass.shown, mass.used) == (False, False)
    assert np.isnan(mass.std)


def test_a_sum_of_masses_is_enough():
    """A slider that carries a pendulum weighs both, and neither by itself."""
    model = arm("zY")
    _, states = motion(2, duration=20.0, dt=DT, seed=4)
    gains, names = np.array([6.0, 9.0]), ("joint_1", "joint_2")
    tau = recorded(model, gains, 0, states=states)
    masses = {name: model.inertias[j + 1].mass for j, name in enumerate(names)}
    both = fit(tau, masses, model, (), states)
    assert_allclose(both.gains_.gain, gains, rtol=0.03)
    assert all(m.used and not m.shown for m in both.gains_.common.masses)
    for name in names:
        alone = fit(tau, {name: masses[name]}, model, (), states)
        assert not alone.gains_.absolute


def test_masses_that_disagree_are_told():
    model = arm("ZYx")
    tau, mass = recorded(model), model.inertias[3].mass
    agreed = fit(tau, {"joint_3": mass, "payload": MASS}, model).gains_.common
    assert agreed.agree
    assert agreed.p_value > 0.01
    wrong = fit(tau, {"joint_3": mass, "payload": 2 * MASS}, model).gains_.common
    assert not wrong.agree


def test_a_payload_that_is_not_there_fixes_nothing():
    robot = fit(recorded(payload=0), {"payload": MASS}, effects=())
    (mass,) = robot.gains_.common.masses
    assert np.isnan(mass.found)
    assert not robot.gains_.absolute


def test_known_masses_are_weighted_by_what_they_are_known_to():
    std = np.array([0.1, 0.2])
    plain = PlainEstimate(
        theta=np.array([20.0, 33.0]),
        covariance=np.diag(std**2),
        known=np.ones(2, dtype=bool),
        eigen=scaled_eigen(np.diag(1 / std**2), IDENTIFIABLE),
    )
    given = {"a": 2.0, "b": 3.0}
    places = [("a", 2.0, 0), ("b", 3.0, 1)]
    common, covariance = common_gain(given, places, plain.theta, plain)
    # Two measurements of the factor, 10 +- 0.05 and 11 +- 0.067.
    weight = np.array([2.0, 3.0]) ** 2 / std**2
    expected = weight @ [10.0, 11.0] / weight.sum()
    assert_allclose(common.factor, expected)
    assert_allclose(common.std, weight.sum() ** -0.5)
    share = weight / weight.sum() / [2.0, 3.0]
    assert_allclose(covariance, std**2 * share)
    assert common.p_value < 1e-6


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"gains": None}, "needs gains='unknown'; got gains=None"),
        ({"known_masses": {"arm": 1.0}}, "names 'arm'; expected one of joint_1, .*pay"),
        ({"known_masses": {"joint_1": -1.0}}, r"positive masses \[kg\]; got -1.0 for"),
        ({"known_masses": {"payload": np.nan}}, "got nan for payload"),
    ],
)
def test_other_masses_are_refused(given, message):
    given = {"gains": "unknown", "known_masses": {"payload": 1.0}, **given}
    robot = RobotIdentifier(ARM, **EXACT, **given)
    with pytest.raises(ValueError, match=message):
        robot.fit(STATES, recorded())


def test_sizes_of_what_files_leave_out_are_in_true_units(tmp_path):
    """They are in N m once a known mass makes the gains absolute."""
    robot = RobotIdentifier(
        ARM,
        effects=[Payload(joint=2, instant=PICKED, centre=tuple(CENTRE))],
        gains="unknown",
        known_masses={"payload": MASS},
        **EXACT | {"projector": "default"},
    )
    robot.fit(STATES, recorded())
    (left,) = robot.to_mjcf(tmp_path / "robot.xml")
    # What the payload adds, on the joint where it adds most.
    loaded = ARM.copy()
    loaded.inertias[3] += pin.Inertia(MASS, CENTRE, np.zeros((3, 3)))
    added = inverse_dynamics(loaded, STATES) - inverse_dynamics(ARM, STATES)
    added[T < PICKED] = 0.0
    assert left.name == "payload"
    assert_allclose(left.size, np.sqrt(np.mean(added**2, axis=0)).max(), rtol=0.05)
    # A gain as an effect adds (g - 1) times the torque of the robot.
    torque = np.sqrt(np.mean((recorded(noise=0.0) / GAINS) ** 2, axis=0))
    powers = robot.robot_.powers.effects
    sizes = {
        effect.joint: np.sqrt(own[effect.joint, 0, 0])
        for effect, own in zip(robot.effects_, powers)
        if effect.name == "torque_gain"
    }
    assert sorted(sizes) == [0, 1, 2]
    assert_allclose([sizes[j] for j in range(3)], torque, rtol=0.05)
