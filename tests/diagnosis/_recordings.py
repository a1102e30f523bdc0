"""Small simulated recordings with known missing effects."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from tests.effects._arms import arm, inverse_dynamics, motion

DT = 0.02
VISCOUS = (0.8, 0.5, 0.3, 0.4)


@dataclass(frozen=True, eq=False)
class Recording:
    """Noisy positions and torques, and the exact signals."""

    model: object
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    load: np.ndarray
    position: np.ndarray
    noise: np.ndarray

    def torque(self, **effects):
        """Return the measured torque; keyword joint_1 adds the torque of a function."""
        nv = self.q.shape[1]
        torque = self.load + np.array(VISCOUS[:nv]) * self.v + self.noise
        for name, effect in effects.items():
            torque[:, int(name[-1]) - 1] += effect(self)
        return torque

    def robot(self, **options):
        """Make the declared model."""
        options = {"dt": DT, "friction": ("viscous",), **options}
        return RobotIdentifier(self.model, **options)

    def discover(self, torque, effects="all", groups=None, robot=None, t=None, **extra):
        """Search the recording for effects."""
        discovery = EffectDiscovery(
            self.robot() if robot is None else robot,
            effects=effects,
            **{"random_state": 0, **extra},
        )
        return discovery.fit(self.position, torque, groups=groups, t=t)


def record(axes="ZY", duration=24.0, noise=0.05, seed=0, encoder=2e-5, size=1.0):
    """Simulate the declared model; `noise` is the torque noise [N m]."""
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
    """Return name and joint of each reported effect."""
    return sorted((effect.name, effect.joint) for effect in loop.effects_)


@dataclass(frozen=True, eq=False)
class Searched:
    """Recordings that a session fixture searches once."""

    parts: tuple
    torques: tuple
    library: tuple
    labels: tuple = (0,)
    friction: tuple = ("viscous",)

    @property
    def position(self):
        """Positions of all recordings, (n, nv)."""
        return np.concatenate([part.position for part in self.parts])

    @property
    def torque(self):
        """Torques of all recordings, (n, nv)."""
        return np.concatenate(self.torques)

    @property
    def groups(self):
        """Label of each row."""
        return np.repeat(self.labels, [part.t.size for part in self.parts])

    def robot(self, **options):
        """Make the declared model."""
        return self.parts[0].robot(friction=self.friction, **options)

    def search(self, torque=None):
        """Search the recordings, or the same motion with another torque."""
        discovery = EffectDiscovery(self.robot(), effects=self.library, random_state=0)
        torque = self.torque if torque is None else torque
        return discovery.fit(self.position, torque, groups=self.groups)


_ARM = record("ZY", seed=0, duration=20.0)
# A spring of 4 N m/rad with its equilibrium at -0.25 rad.
SPRINGY = Searched(
    (_ARM,),
    (_ARM.torque(joint_1=lambda r: 4.0 * r.q[:, 0] + 1.0),),
    ("spring", "ripple"),
)
_CLEAN = record("ZY", seed=3)
COMPLETE = Searched((_CLEAN,), (_CLEAN.torque(),), ("spring", "ripple", "coupling"))
_PAIR = tuple(record("ZY", seed=seed) for seed in (11, 12))
TWO_MOTIONS = Searched(
    _PAIR,
    tuple(part.torque() for part in _PAIR),
    ("spring", "load_friction"),
    ("slow", "fast"),
    ("viscous", "coulomb"),
)
