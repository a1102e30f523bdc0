"""Robots to simulate: those that come with the package, and others that differ.

The demo arm is made up; head and arm are those of Ting, D'Souza and Schaal (2011).
"""

import os
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from sklearn_vbjfa.model import is_prismatic, joint_names, load_model
from sklearn_vbjfa.physical import inertial_parameters, pseudo_inertia

if TYPE_CHECKING:
    import pinocchio as pin
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sklearn_vbjfa.model import nominal_parameters

if TYPE_CHECKING:
    import pinocchio as pin

# Rate of the controller of either robot in the paper [Hz].
RATES = {"head": 420.0, "arm": 480.0}
# Range [rad or m] and speed [per s] where the description gives none, or wider ones.
_DEFAULT_RANGE = 2.5
_DEFAULT_SPEED = 2.5


# -- robots that come with the package -------------------------------------------------
EFFECTS = ("actuator", "cables", "friction", "rotor_inertia", "shell")
# Size of each effect as a share of the standard deviation of the joint's rigid-body
# torque, times 0.5 to 1.5: at typical speed, elongation (hardening: twice that) and
# acceleration, and half way from where the shell touches to the end of the motion.
_SHARES = {
    "viscous": 0.15,
    "coulomb": 0.10,
    "stiction": 0.05,
    "cable_spring": 0.10,
    "cable_hardening": 0.05,
    "cable_hysteresis": 0.05,
    "shell": 0.25,
    "rotor_inertia": 0.15,
}
# Speed at which Coulomb friction is fully there, in units of the typical speed.
_CREEP = 0.04
# Elongation over which a cable's hysteresis turns round, in units of the typical one.
_TURN = 0.15
# Arm of a cable at the next joint of the chain, for joints of the same torque.
_COUPLING = 0.3
# The shell touches beyond this share of the way from the centre to the limit.
_SHELL_GAP = 0.2
# Time constant of the actuators [s].
_LAG = 0.004
# Largest value of r / (1 + r^2), which shapes the extra friction at creeping speed.
STRIBECK_PEAK = 0.5
# Share of a joint's range and speed that a motion uses at most.
_RANGE_SHARE = 0.6
_SPEED_SHARE = 0.5


def packaged_urdf(name: str) -> str:
    """Path of the URDF of "demo_arm", "head" or "arm"."""
    folder = resources.files("sklearn_vbjfa.datasets").joinpath("robots")
    return str(folder.joinpath(f"{name}.urdf"))


def demo_arm_urdf() -> str:
    """Path of the URDF of a made-up six-axis arm."""
    return packaged_urdf("demo_arm")


def load_head_model() -> "pin.Model":
    """Load the nominal model of a vision head with seven joints.

    Three joints in the neck (pitch, roll, yaw) and two in each eye (pan, tilt), so
    that the tree forks at the skull. Made up after the description of the head in
    section 5.2 of [1]_: sizes and masses are plausible, not those of that robot.

    Returns
    -------
    pinocchio.Model
        Model with ``nq == nv == 7`` and limits of position [rad], speed [rad/s] and
        effort [N m].

    Raises
    ------
    ImportError
        If Pinocchio is not installed.

    See Also
    --------
    load_arm_model : The arm of the same article.
    make_closed_loop_recording : Recordings of a robot that differs from its model.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_head_model
    >>> model = load_head_model()
    >>> model.nv, model.names[1], model.names[7]
    (7, 'neck_pitch', 'right_eye_tilt')
    """
    return load_model(packaged_urdf("head"))


def load_arm_model() -> "pin.Model":
    """Load the nominal model of an anthropomorphic arm with ten joints.

    Three joints in the shoulder, one in the elbow, three in the wrist and three
    fingers, which all begin at the hand. Made up after the description of the arm in
    section 5.3 of [1]_: sizes and masses are plausible, not those of that robot.

    Returns
    -------
    pinocchio.Model
        Model with ``nq == nv == 10`` and limits of position [rad], speed [rad/s] and
        effort [N m].

    Raises
    ------
    ImportError
        If Pinocchio is not installed.

    See Also
    --------
    load_head_model : The head of the same article.
    make_closed_loop_recording : Recordings of a robot that differs from its model.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_arm_model
    >>> model = load_arm_model()
    >>> model.nv, model.names[1], model.names[10]
    (10, 'shoulder_flexion', 'thumb_opposition')
    """
    return load_model(packaged_urdf("arm"))


def resolve_model(model):
    """Path (None for a model without one), nominal model and rate of the paper."""
    urdf = model if isinstance(model, (str, os.PathLike)) else None
    rate = RATES.get(str(urdf), RATES["arm"])
    if urdf is not None:
        urdf = packaged_urdf(urdf) if urdf in RATES else os.fspath(urdf)
    return urdf, load_model(model if urdf is None else urdf), rate


# -- what a robot can do, and what it takes --------------------------------------------


def joint_range(model):
    """Middle and half width of each joint's range; a default where it is unlimited."""
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    # Halved first: Pinocchio's "no limit" is the largest number there is.
    reach, centre = 0.5 * high - 0.5 * low, 0.5 * high + 0.5 * low
    wide = ~(reach <= _DEFAULT_RANGE)
    return np.where(wide, 0.0, centre), np.where(wide, _DEFAULT_RANGE, reach)


def speed_limit(model):
    """Speed limit (nv,) of each joint; a default where the description gives none."""
    limit = model.velocityLimit
    return np.where((limit > 0) & (limit < 1e3), limit, _DEFAULT_SPEED)


def rigid_torques(model, states):
    """Inverse dynamics of a Pinocchio model for rows [q | v | a]."""
    import pinocchio as pin

    data, rnea = model.createData(), pin.rnea
    q, v, a = np.split(states, 3, axis=1)
    out = np.empty(q.shape)
    for k in range(len(out)):
        out[k] = rnea(model, data, q[k], v[k], a[k])
    return out


# -- robots that differ from their model -----------------------------------------------


def true_inertias(model, perturbation, rng):
    """Draw inertial parameters (nv, 10) near the nominal ones, that some body has."""
    # The pseudo-inertia J of each body is multiplied from both sides by the exponential
    # of a random symmetric matrix: it stays positive definite whatever is drawn.
    from scipy.linalg import expm

    bodies = []
    for inertia in model.inertias[1:]:
        J = pseudo_inertia(inertia.toDynamicParameters())
        E = rng.normal(scale=0.5 * perturbation, size=(4, 4))
        E = 0.5 * (E + E.T)
        length = np.sqrt(max(np.trace(J[:3, :3]) / max(J[3, 3], 1e-12), 1e-12))
        S = np.diag([length, length, length, 1.0])
        T = S @ expm(E) @ np.linalg.inv(S)
        bodies.append(inertial_parameters(T @ J @ T.T))
    return np.array(bodies)


def with_inertias(model, inertial):
    """Copy a model and give its bodies inertial parameters (nv, 10)."""
    import pinocchio as pin

    other = model.copy()
    for j, body in enumerate(inertial):
        other.inertias[j + 1] = pin.Inertia.FromDynamicParameters(body)
    return other


def recording_fields(model, n, n_recordings, dt):
    """Fields of a `Recording` that simulations share: n rows of each motion."""
    slides = is_prismatic(model)
    return {
        "t": np.tile(np.arange(n) * dt, n_recordings),
        "dt": float(dt),
        "groups": np.repeat(np.arange(n_recordings), n),
        "group_names": tuple(f"motion_{k + 1}" for k in range(n_recordings)),
        "joint_names": joint_names(model),
        "position_units": tuple("m" if slide else "rad" for slide in slides),
        "torque_units": tuple("N" if slide else "N m" for slide in slides),
        "licence": "BSD-3-Clause",
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class SineMotion:
    """Sum of sines in all joints, as long as one likes."""

    # centre (nv,) [rad or m]; amplitude [rad or m], frequency [Hz], phase [rad]: (nv,
    # n_harmonics).

    centre: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def states(self, t):
        """Return the states (n, 3 * nv), [q | v | a], at times t (n,) [s]."""
        w = 2 * np.pi * self.frequency
        angle = t[:, None, None] * w + self.phase
        s, c = np.sin(angle), np.cos(angle)
        q = self.centre + (self.amplitude * s).sum(axis=-1)
        v = (self.amplitude * w * c).sum(axis=-1)
        a = -(self.amplitude * w**2 * s).sum(axis=-1)
        return np.hstack([q, v, a])


def draw_motion(model, frequency, n_harmonics, rng):
    """Draw a motion of sines in all joints."""
    # Frequencies [Hz] go from a tenth of the highest up to it; whenever the sines meet,
    # the motion stays within 60 % of the range and half the speed limit.
    shape = (model.nv, n_harmonics)
    centre, reach = joint_range(model)
    f = frequency * rng.uniform(0.1, 1.0, size=shape)
    f[:, 0] = frequency * rng.uniform(0.85, 1.0, size=model.nv)
    size = rng.uniform(0.3, 1.0, size=shape) / f
    phase = rng.uniform(0, 2 * np.pi, size=shape)
    room = np.minimum(
        _RANGE_SHARE * reach / size.sum(axis=1),
        _SPEED_SHARE * speed_limit(model) / (2 * np.pi * f * size).sum(axis=1),
    )
    return SineMotion(
        centre=centre, amplitude=size * room[:, None], frequency=f, phase=phase
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Plant:
    """A robot with all that its declared model lacks."""

    # model: true inertias, with rotor inertias [kg m^2 or kg] in its ``armature``;
    # torque_size (nv,): root mean square of the torque in a typical motion [N m or N];
    # viscous (nv,) [N m s/rad or N s/m]; coulomb, stiction (nv,): friction at speed,
    # and how much more of it there is at creeping speed [N m]; creep_speed (nv,): where
    # friction has reached 71 % of its size; lag: time constant of the actuators [s],
    # zero for torques at once.
    # routing (n_cables, nv): elongation of each cable by each joint; cable_rest (nv,):
    # position in which no cable pulls; cable_spring, cable_hardening (n_cables,):
    # linear and cubic stiffness [N m/rad, N m/rad^3]; cable_hysteresis (n_cables,):
    # torque when turned round [N m], over an elongation of cable_turn [rad].
    # shell_side (nv,): +1 or -1, towards which limit the shell is in the way; shell_gap
    # (nv,): where it begins to touch, ``shell_side * q``; shell_stiffness (nv,): torque
    # over squared deformation [N m/rad^2].

    model: "pin.Model"
    torque_size: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    stiction: np.ndarray
    creep_speed: np.ndarray
    routing: np.ndarray
    cable_rest: np.ndarray
    cable_spring: np.ndarray
    cable_hardening: np.ndarray
    cable_hysteresis: np.ndarray
    cable_turn: np.ndarray
    shell_side: np.ndarray
    shell_gap: np.ndarray
    shell_stiffness: np.ndarray
    lag: float

    @property
    def inertial(self):
        """True inertial parameters of each body, ndarray of shape (nv, 10)."""
        return nominal_parameters(self.model)

    def theta(self, friction=("viscous",)):
        """Return the true parameters of a declared model, (nv (10 + n_friction),)."""
        # What the robot does not have is zero.
        known = {
            "viscous": self.viscous,
            "coulomb": self.coulomb,
            "offset": np.zeros_like(self.viscous),
            "rotor_inertia": np.asarray(self.model.armature),
        }
        extra = [known[name] for name in friction]
        return np.column_stack([self.inertial, *extra]).ravel()

    def friction_torque(self, v):
        """Torque that friction takes at speeds v [N m]."""
        r = v / self.creep_speed
        w = 1.0 / (1.0 + r * r)
        extra = self.stiction / STRIBECK_PEAK
        return self.viscous * v + r * (self.coulomb * np.sqrt(w) + extra * w)

    def cable_torque(self, q):
        """Torque that the cables take along positions q, ndarray of shape (n, nv)."""
        # The hysteresis is neutral in the first row and follows the rows in order.
        e = (q - self.cable_rest) @ self.routing.T
        z = np.zeros_like(e)
        for k in range(1, len(e)):
            de = e[k] - e[k - 1]
            c = 0.5 * np.abs(de) / self.cable_turn
            z[k] = (z[k - 1] * (1 - c) + de) / (1 + c)
        force = e * (self.cable_spring + self.cable_hardening * e * e)
        return (force + self.cable_hysteresis * z / self.cable_turn) @ self.routing

    def shell_torque(self, q):
        """Torque that the shells take at positions q [N m]."""
        deep = np.maximum(self.shell_side * q - self.shell_gap, 0.0)
        return self.shell_side * self.shell_stiffness * deep**2

    def inverse_dynamics(self, states):
        """Torques (n, nv) behind the actuators for states (n, 3 nv), row after row."""
        q, v, _ = np.split(states, 3, axis=1)
        rigid = rigid_torques(self.model, states)
        return (
            rigid
            + self.friction_torque(v)
            + self.cable_torque(q)
            + self.shell_torque(q)
        )

    def command(self, torques, dt):
        """Commands, held for dt [s] each, whose lagged torques are these, (n, nv)."""
        # The first torque is there already; the last command repeats the one before.
        if self.lag == 0:
            return torques.copy()
        kept = np.exp(-dt / self.lag)
        command = (torques[1:] - kept * torques[:-1]) / (1 - kept)
        return np.vstack([command, command[-1:]])


def draw_plant(nominal, *, perturbation, effects, effect_size, motion, rng):
    """Draw a robot that differs from its nominal model by some of `EFFECTS`."""
    # `perturbation` is how far inertias are from the nominal ones, relative;
    # `effect_size` a factor on all effects but the actuators' lag and viscous friction;
    # `motion` is what "typical" torques, speeds and accelerations are taken from.
    import pinocchio as pin

    if int(pin.__version__.split(".")[0]) < 3:
        # Version 2 has an armature but leaves it out of the dynamics.
        raise ImportError(
            "Simulated plants need Pinocchio 3 for their rotor inertias, got "
            f'{pin.__version__}: pip install "pin>=3"'
        )
    unknown = set(effects) - set(EFFECTS)
    if unknown:
        raise ValueError(
            f"Unknown effect(s) {sorted(unknown)}; expected some of {list(EFFECTS)}."
        )
    model = with_inertias(nominal, true_inertias(nominal, perturbation, rng))
    nv = model.nv
    # A minute of the slowest motion, densely enough for its standard deviations.
    states = motion.states(np.linspace(0.0, 60.0, 1201))
    q, v, a = np.split(states, 3, axis=1)
    size = rigid_torques(model, states).std(axis=0)
    speed, acceleration = v.std(axis=0), a.std(axis=0)

    def draw(name, effect, unit):
        has = effect is None or effect in effects
        factor = 1.0 if effect is None else effect_size
        drawn = rng.uniform(0.5, 1.5, size=nv) * _SHARES[name]
        return drawn * factor * has * size / unit

    # A cable runs along each joint and the first one that follows it.
    routing = np.eye(nv)
    for j in range(nv):
        children = [i for i in range(nv) if model.parents[i + 1] == j + 1]
        # Its arm at a weak joint is short, or it would be the stronger of the two.
        weaker = np.minimum(size[children[:1]] / size[j], 1.0)
        routing[j, children[:1]] = _COUPLING * weaker
    centre, reach = joint_range(model)
    rest = centre + 0.2 * reach * rng.uniform(-1, 1, size=nv)
    stretch = ((q - rest) @ routing.T).std(axis=0)
    side = rng.choice([-1.0, 1.0], size=nv)
    depth = 0.5 * (_RANGE_SHARE - _SHELL_GAP) * reach
    model.armature = draw("rotor_inertia", "rotor_inertia", acceleration)
    plant = Plant(
        model=model,
        torque_size=size,
        viscous=draw("viscous", None, speed),
        coulomb=draw("coulomb", "friction", 1.0),
        stiction=draw("stiction", "friction", 1.0),
        creep_speed=_CREEP * speed,
        routing=routing,
        cable_rest=rest,
        cable_spring=draw("cable_spring", "cables", stretch),
        cable_hardening=draw("cable_hardening", "cables", (2 * stretch) ** 3),
        cable_hysteresis=draw("cable_hysteresis", "cables", 1.0),
        cable_turn=_TURN * stretch,
        shell_side=side,
        shell_gap=side * centre + _SHELL_GAP * reach,
        shell_stiffness=draw("shell", "shell", depth**2),
        lag=_LAG if "actuator" in effects else 0.0,
    )
    torques = plant.inverse_dynamics(states)
    return replace(plant, torque_size=np.sqrt(np.mean(torques**2, axis=0)))
