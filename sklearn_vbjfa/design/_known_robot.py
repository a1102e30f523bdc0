"""Properties of a robot before the design of a motion: model, parameters and noise."""

import os
import warnings
from dataclasses import dataclass

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.effects import RotorInertia, resolve
from sklearn_vbjfa.model import joint_names, nominal_parameters
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._plan import CUTOFF_PER_BANDWIDTH, STANDSTILL_SHARE

# Friction of a robot of which only the description is known.
_FRICTION = ("viscous", "coulomb")
# Noise of a torque that nobody has measured, over the torque limit.
_GUESSED_NOISE = 0.01
# Smoothed states end at about three times the bandwidth of the motion: twice that of
# least acceleration error would attenuate it, half would let noise through.
_STATE_BAND = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownRobot:
    """A robot, identified or only described."""

    # bodies alone, without friction, as effects correct the robot
    features: RigidBodyFeatures
    inertial: np.ndarray  # (nv, 10): of the bodies
    effects: tuple  # friction and effects of the model, each on its joint
    coefficients: tuple
    joint_names: tuple
    # (nv,): deviation in the band of the fit [N m or N]; nan if not known
    torque_noise: np.ndarray
    cutoff: float  # that band [Hz]
    # (nv,): deviation of one sample of the positions [rad or m]; 0 if unknown
    encoder_noise: np.ndarray
    description: object = None  # URDF file, for the geometry

    @classmethod
    def of(cls, model):
        """Take the properties from a path, a model or an identified robot."""
        if isinstance(model, cls):
            return model
        if hasattr(type(model), "robot_"):
            return cls._identified(model.robot_)
        return cls._described(model)

    @classmethod
    def _described(cls, model):
        features = RigidBodyFeatures(model, friction=()).load()
        nv = features.n_joints_
        effects = _on_all_joints(_FRICTION, nv)
        is_path = isinstance(model, (str, os.PathLike))
        return cls(
            features=features,
            inertial=nominal_parameters(features.model_),
            effects=effects,
            coefficients=tuple(np.zeros(1) for _ in effects),
            joint_names=joint_names(features.model_),
            torque_noise=np.full(nv, np.nan),
            cutoff=np.inf,
            encoder_noise=np.zeros(nv),
            description=model if is_path else None,
        )

    @classmethod
    def _identified(cls, robot):
        full = robot.features_
        nv = full.n_joints_
        bodies = robot.bodies(robot.theta_)
        effects = _on_all_joints(full.friction_, nv)
        coefficients = [bodies[:, 10 + k] for k in range(len(full.friction_))]
        coefficients = list(np.concatenate([np.zeros(0), *coefficients])[:, None])
        for effect, values in zip(robot.effects_, robot.split(robot.theta_)):
            if effect.in_model:
                # the model itself holds it
                continue
            effects += (effect,)
            coefficients.append(values)
        features = RigidBodyFeatures(full.model_, friction=()).load()
        estimator = robot.plan.state_estimator
        variance = getattr(estimator, "noise_variance_", np.zeros(nv))
        encoder = np.sqrt(np.broadcast_to(variance, (nv,)))
        _tell_unknown(np.isnan(encoder), robot.joint_names_)
        given = robot.source
        # The floor has the encoders' share in it, which depends on the motion; a saved
        # robot has no other.
        noise = (
            robot.noise_floor_ if robot.torque_noise_ is None else robot.torque_noise_
        )
        noise = np.array(noise, dtype=float)
        # A floor that is not known: what the model left is more than noise.
        left = (
            np.full(nv, np.nan) if robot.output_noise_ is None else robot.output_noise_
        )
        return cls(
            features=features,
            inertial=robot.inertial(),
            effects=effects,
            coefficients=tuple(np.atleast_1d(c) for c in coefficients),
            joint_names=robot.joint_names_,
            torque_noise=np.where(np.isfinite(noise), noise, left),
            cutoff=float(robot.cutoff_),
            encoder_noise=np.where(np.isnan(encoder), 0.0, encoder),
            description=given if isinstance(given, (str, os.PathLike)) else None,
        )

    @property
    def n_joints(self):
        """Number of joints."""
        return self.features.n_joints_

    def band(self, highest, dt):
        """Band of a fit to a motion up to a frequency [Hz]; see `resolve_cutoff`."""
        return min(CUTOFF_PER_BANDWIDTH * highest, 0.4 / dt)

    def still(self, limits):
        """Speeds below which joints count as standing (nv,)."""
        return STANDSTILL_SHARE * limits.velocity

    def noise(self, limits, reference, highest, dt):
        """Deviation of the noise of each joint's equations in the band (nv,)."""
        # Torque noise is taken as white, and so is that of the encoders, which enters
        # through the inertia: of white position noise with the deviation s, a band B
        # leaves an acceleration of the variance 2 dt s^2 (2 pi)^4 B^5 / 5.
        band = self.band(highest, dt)
        guessed = np.where(np.isfinite(limits.torque), limits.torque, np.nan)
        if not np.isfinite(guessed).all():
            q, v, a = np.split(reference, 3, axis=1)
            size = np.abs(self.features.torques(q, v, a, self.inertial)).max(axis=0)
            guessed = np.where(np.isfinite(guessed), guessed, size)
        ratio = band / self.cutoff if np.isfinite(self.cutoff) else 1.0
        measured = self.torque_noise * np.sqrt(ratio)
        torque = np.where(measured > 0, measured, _GUESSED_NOISE * guessed)
        states = min(_STATE_BAND * highest, band)
        acceleration = 2 * dt * self.encoder_noise**2 * (2 * np.pi) ** 4
        acceleration = acceleration * states**5 / 5
        inertia = self.inertia(reference)
        return np.sqrt(torque**2 + inertia**2 @ acceleration)

    def inertia(self, reference):
        """Root mean squares of the mass matrix over poses (nv, nv), rotors included."""
        nv = self.n_joints
        q = reference[:100, :nv]
        still = np.zeros_like(q)
        inertial = np.ascontiguousarray(self.inertial)
        at_rest = self.features.torques(q, still, still, inertial)
        rotor = np.zeros(nv)
        for effect, values in zip(self.effects, self.coefficients):
            if isinstance(effect, RotorInertia):
                rotor[effect.joint] += values[0]
        columns = []
        for k in range(nv):
            unit = still.copy()
            unit[:, k] = 1.0
            moved = self.features.torques(q, still, unit, inertial)
            felt = moved - at_rest
            felt[:, k] += rotor[k]
            columns.append(np.sqrt((felt**2).mean(axis=0)))
        return np.array(columns).T


def _on_all_joints(names, nv):
    """Return effects by their names on every joint."""
    if not names:
        return ()
    return tuple(
        clone(effect).set_params(joint=j)
        for effect in resolve(names)
        for j in range(nv)
    )


def _tell_unknown(unknown, names):
    """Warn of encoders whose noise does not count, as nobody knows it."""
    named = [name for name, bad in zip(names, unknown) if bad]
    if named:
        warnings.warn(
            f"The encoder noise of {', '.join(named)} is not known, as no recording of "
            "the robot is long enough to show it, and counts as none: the motion may "
            "be quicker than is good. Identify from a recording of 16 samples or more.",
            UserWarning,
            stacklevel=5,
        )
