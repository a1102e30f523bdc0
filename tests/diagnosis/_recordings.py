"""Small simulated recordings whose missing effects are known."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from tests.effects._arms import arm, inverse_dynamics, motion

DT = 0.02
VISCOUS = (0.8, 0.5, 0.3, 0.4)


@dataclass(frozen=True, eq=False)
class Recording:
    """Positions and torques with noise, and the exact signals."""

    model: object
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    load: np.ndarray
    position: np.ndarray
    noise: np.ndarray

    def torque(self, **effects):
        """Measured torque with functions (self) -> torque of joint_1, joint_2, ..."""
        nv = self.q.shape[1]
        torque = self.load + np.array(VISCOUS[:nv]) * self.v + self.noise
        for name, effect in effects.items():
            torque[:, int(name[-1]) - 1] += effect(self)
        return torque

    def robot(self, **given):
        """Make the declared model."""
        given = {"dt": DT, "friction": ("viscous",), **given}
        return RobotIdentifier(self.model, **given)

    def discover(self, torque, effects="all", groups=None, robot=None, t=None, **given):
        """Close the loop."""
        loop = EffectDiscovery(
            self.robot() if robot is None else robot,
            effects=effects,
            **{"random_state": 0, **given},
        )
        return loop.fit(self.position, torque, groups=groups, t=t)


def record(axes="ZY", duration=24.0, noise=0.05, seed=0, encoder=2e-5, size=1.0):
    """Simulate the declared model alone; `noise` is that of the torques [N m]."""
    model = arm(axes)
    nv = model.nv
    t, states = motion(nv, duration=duration, dt=DT, seed=seed, size=size)
    rng = np.random.default_rng(100 + seed)
    q, v, a = np.split(states, 3, axis=1)
    return Recording(
        model=model,
        t=t,
        q=q,
        v=v,
        a=a,
        load=inverse_dynamics(model, states),
        position=q + encoder * rng.normal(size=q.shape),
        noise=noise * rng.normal(size=q.shape),
    )


def named(loop):
    """Names and joints of what was found."""
    return sorted((effect.name, effect.joint) for effect in loop.effects_)
