"""Torque of joints at rest, which only friction with memory predicts."""

import numpy as np
import pytest
from bench_friction_memory import DT as STEP
from bench_friction_memory import record

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from tests.diagnosis._recordings import DT, named
from tests.effects._arms import arm, inverse_dynamics, stops_sample_by_sample

REACH, SIZE = 0.02, 1.5  # displacement [rad] and torque [N m] of one stop


def stop_and_go(rng, moves=24):
    """Positions (n, 1) of a joint that moves, returns slightly and rests."""

    def leg(first, last, seconds):
        s = np.linspace(0, 1, round(seconds / DT))
        return first + (last - first) * (s - np.sin(2 * np.pi * s) / (2 * np.pi))

    q = [0.0]
    for goal in rng.uniform(-1, 1, size=moves):
        back = goal - rng.uniform(0, 0.05) * np.sign(goal - q[-1])
        q += [*leg(q[-1], goal, 1.2), *leg(goal, back, 0.4), *[back] * round(0.8 / DT)]
    return np.array(q)[:, None]


def discovered(q, friction, rng):
    """Search a recording of one joint with a friction torque (n,)."""
    v = np.gradient(q, DT, axis=0)
    states, model = np.hstack([q, v, np.gradient(v, DT, axis=0)]), arm("Y")
    tau = inverse_dynamics(model, states) + 0.5 * v + friction[:, None]
    tau += 0.05 * rng.normal(size=tau.shape)
    loop = EffectDiscovery(
        RobotIdentifier(model, dt=DT), effects=["maxwell_slip", "stribeck"]
    )
    return loop.fit(q + 2e-5 * rng.normal(size=q.shape), tau)


@pytest.mark.parametrize("law", ["memory", "static", "held"])
def test_torque_at_rest_identifies_friction_with_memory(law):
    rng = np.random.default_rng(3)
    q = stop_and_go(rng)
    friction = SIZE * stops_sample_by_sample(q[:, 0], REACH)
    if law != "memory":
        # Any torque within the limits, or on the side of the last motion.
        v = np.gradient(q[:, 0], DT)
        still = np.abs(v) < 1e-9
        rest = np.cumsum(np.diff(still, prepend=False) & still)
        share = rng.uniform(-1 if law == "static" else 0, 1, rest[-1] + 1)
        last = np.maximum.accumulate(np.where(still, 0, np.arange(len(q))))
        friction = SIZE * np.sign(v[last]) * np.where(still, share[rest], 1.0)
    loop = discovered(q, friction, rng)
    assert named(loop) == [("maxwell_slip", 0)] * (law == "memory")
    if law == "memory":
        # Rows at rest count in both errors.
        assert (loop.error_after_ < 0.1 * loop.error_before_).all()
    else:
        assert not loop.possible_


def test_torque_before_the_motion_is_not_fitted():
    t, held = np.arange(0.0, 40.0, DT), round(6.0 / DT)
    motion = 0.5 * np.sin(1.3 * t) + 0.3 * np.sin(2.9 * t)
    q = np.pad((1 - np.exp(-(t**2) / 4)) * motion, (held, 0))[:, None]
    friction = SIZE * stops_sample_by_sample(q[:, 0], REACH)
    friction[:held] = 0.7 * SIZE
    (effect,) = discovered(q, friction, np.random.default_rng(0)).effects_
    assert (effect.name, effect.effect.at_rest) == ("maxwell_slip", False)
    assert effect.parameters["Fc"] == pytest.approx(SIZE, rel=0.01)


def test_friction_with_memory_in_short_motions(tmp_path):
    # The spectrum must stay bounded if the model removes the slow residuals.
    rig, rng, joint, q, tau, _ = record("lugre", 99)
    path, n = tmp_path / "arm.urdf", len(q) // 2
    path.write_text(rig.urdf(rig.described(rng)))
    loop = EffectDiscovery(
        RobotIdentifier(path, dt=STEP), effects=["maxwell_slip"], random_state=0
    )
    assert named(loop.fit(q[:n], tau[:n])) == [("maxwell_slip", joint)]
