"""Each effect acts alike in columns, single steps, simulations and saved files."""

import warnings

import numpy as np
import pinocchio as pin
import pytest

from sklearn_vbjfa import RobotIdentifier, effects, load_identified
from sklearn_vbjfa.effects import Motion
from sklearn_vbjfa.physical import min_eigenvalue
from sklearn_vbjfa.robot import to_mjcf
from sklearn_vbjfa.simulation import ForwardDynamics, Stepper, recorded, why_left_out
from tests._quick import one_in
from tests.model._mujoco import drive_torques
from tests.simulation._machines import machine, point
from tests.simulation._random_robots import DT, random_motion, random_predictor, without

LIBRARY = effects.available()
NV = 3


def two_rows(rng, way):
    """Return two states without accelerations, reversals or standstill in between."""
    v = way * rng.choice([-1.0, 1.0], size=NV) * rng.uniform(2.0, 4.0, size=NV)
    q = rng.normal(size=NV) + 0.37 * np.outer([0.0, 1.0], v)
    return np.hstack([q, [v, v], np.zeros((2, NV))])


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", LIBRARY)
def test_columns_match_steps_and_forward_dynamics(name, seed, way):
    """Forward dynamics are the inverse of the torques from the columns."""
    # Seeded by the name, which does not depend on the order of the library.
    rng = np.random.default_rng([seed, *name.encode()])
    predictor = random_predictor(rng, NV, [name])
    if not predictor.effects_:
        return  # Not applicable to a prismatic joint.
    (effect,) = predictor.effects_
    if isinstance(effect, effects.OfChannel) or effect.files.simulation:
        # The effect is not part of the simulation.
        bare = without(predictor, [0])
    else:
        bare = predictor
    X, t = two_rows(rng, way), np.array([0.9, 0.9 + DT])
    signals = {name: rng.normal(size=2) for name in getattr(effect, "recorded", ())}
    model, tau = bare.torque_model(), 5.0 * rng.normal(size=NV)
    dynamics = ForwardDynamics(model, recorded(signals, t))
    dynamics.start(X[0, :NV])
    dynamics.set_bodies(t[1])
    dynamics.set_time(t[1])
    q, v, _ = np.split(X[1], 3)
    a = dynamics.accelerate(q, v, tau / model.gains, np.sign(v), np.zeros(NV, bool))
    X[1, 2 * NV :] = a
    inputs = signals if bare is predictor else {}
    expected = bare.torques(bare.prepare(X, t=t, signals=inputs))[1]
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-9 * np.abs(tau).max())
    if not why_left_out(effect):
        expected = predictor.torques(predictor.prepare(X, t=t, signals=signals))
        stepper = Stepper(predictor.torque_model())
        for k, x in enumerate(X):
            row = {name: values[k] for name, values in signals.items()}
            torque = stepper.step(*np.split(x, 3), t[k], row)
            np.testing.assert_allclose(torque, expected[k], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("name", one_in(3, LIBRARY))
def test_torques_after_saving(name, simulated, tmp_path):
    """A saved robot predicts and steps as the fitted one."""
    (effect,) = effects.resolve(name)
    nv, n = simulated.q.shape[1], 600
    settings = {"payload": {"joint": nv - 1, "instant": 2.0}}
    settings["signal"] = {"signal": "warmth"}
    effect.set_params(**settings.get(name, {}))
    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt, effects=[effect])
    robot.set_params(friction=[x for x in effects.declarable() if x != name])
    signals = {"warmth": np.sin(np.arange(n))} if name == "signal" else None
    t = simulated.dt * np.arange(n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        robot.fit(simulated.q[:n], simulated.tau[:n], t=t, signals=signals)
        robot.save(tmp_path / "robot.json")
        loaded = load_identified(tmp_path / "robot.json")
        X = random_motion(np.random.default_rng(0), nv, 60)
        warm = None if signals is None else {"warmth": np.arange(60.0)}
        t = simulated.dt * np.arange(60)
        expected = robot.predict(X, t=t, signals=warm)
        np.testing.assert_array_equal(loaded.predict(X, t=t, signals=warm), expected)
    if why_left_out(effect):
        assert [entry.name for entry in loaded.left_out_] == [name]
        return
    for k, x in enumerate(X):
        row = None if warm is None else {"warmth": warm["warmth"][k]}
        torque = loaded.step(*np.split(x, 3), t=t[k], signals=row)
        np.testing.assert_allclose(torque, expected[k], rtol=1e-9, atol=1e-9)


def alone(effect, coef):
    """Return two joints without and with an effect, states, and the effect's torque."""
    model = pin.Model()
    for j, joint in enumerate((pin.JointModelRY(), pin.JointModelRZ())):
        model.addJoint(j, joint, pin.SE3.Identity(), f"joint_{j}")
    bodies = [point(1.0 + j, (0.1, 0.2, 0.3), inertia=0.1) for j in range(2)]
    friction = {"viscous": 0.5, "coulomb": 0.4, "rotor_inertia": 0.3}
    rng = np.random.default_rng(0)
    X = rng.normal(size=(40, 6))
    X[np.abs(X) < 0.1] = 0.5
    motion = Motion(q=X[:, :2], v=X[:, 2:4], a=X[:, 4:])
    torque = np.zeros((40, 2))
    torque[:, effect.joint] = effect.columns(motion) @ coef
    bare = machine(model, bodies, friction)
    return bare, machine(model, bodies, friction, [(effect, coef)]), X, torque


OF_STATE = [
    name
    for name, effect in zip(LIBRARY, effects.resolve())
    if not (effect.needs or isinstance(effect, (effects.OnAllJoints, effects.InModel)))
]


@pytest.mark.parametrize("name", OF_STATE)
def test_mjcf_contains_an_effect_or_reports_its_omission(name, tmp_path):
    pytest.importorskip("mujoco")
    (effect,) = effects.resolve(name)
    coef = 0.2 * (1.0 + np.arange(len(effect.coefficients)))
    bare, robot, X, torque = alone(effect, coef)
    smallest = min_eigenvalue(robot.bodies)
    torques = []
    for k, model in enumerate((bare, robot)):
        omitted = to_mjcf(tmp_path / f"{k}.xml", model, smallest)
        torques.append(drive_torques(tmp_path / f"{k}.xml", X))
    added = torques[1] - torques[0]
    if not omitted:
        np.testing.assert_allclose(added, torque, rtol=0, atol=1e-9)
        return
    assert [(entry.name, entry.joint) for entry in omitted] == [(name, effect.joint)]
    # The file holds only some of the effect's terms.
    parts = {
        name: column * weight
        for name, column, weight in zip(
            effect.coefficients,
            effect.columns(Motion(q=X[:, :2], v=X[:, 2:4], a=X[:, 4:])).T,
            coef,
        )
    }
    exported = [parts[name] for _, name in effect.files.places]
    expected = np.zeros_like(torque)
    expected[:, effect.joint] = sum(exported) if exported else 0.0
    if effect.files.parameter == "coulomb":
        total = effect.in_file(coef).sum()
        expected[:, effect.joint] = total * np.sign(X[:, 2 + effect.joint])
    np.testing.assert_allclose(added, expected, rtol=0, atol=1e-9)
