"""Simulation of one joint for each effect: picture, rivals, export.

A six-axis arm moves for 40 s. Each effect of the library adds its torque to one joint,
with values chosen for the picture.
"""

import functools
import tempfile
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from effect_curves import effect_figure
from sklearn.base import clone

from sklearn_vbjfa import effects
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.effects import Motion, closure, cross_axes, rotation
from sklearn_vbjfa.equations import RigidBodyFeatures
from sklearn_vbjfa.equations._equations import make_motion
from sklearn_vbjfa.model import CorrectedModel
from sklearn_vbjfa.robot._exports import to_mjcf, to_urdf
from sklearn_vbjfa.simulation import TorqueModel, why_left_out

DURATION, DT = 40.0, 0.01
# Noise of the pictures, as a share of the effect's root mean square.
NOISE = 0.12
# Rows of a picture, at least.
FEWEST = 8000
# Length of a picture over time in which every sample counts [s].
WINDOW = 4.0
# Declared friction, offset and rotor inertia.
DECLARED = ("viscous", "coulomb", "offset", "rotor_inertia")
FRICTION = {"viscous": 8.0, "coulomb": 6.0}
# Rows that are compared: every so many.
EVERY = 4
# Share of an effect's torque from which on another one counts as a rival, and how many
# are named.
ALIKE, MOST = 0.3, 4
UNITS = {
    "position": "rad",
    "speed": "rad/s",
    "acceleration": "rad/s²",
    "load": "N m",
    "time": "s",
}


@dataclass(frozen=True, kw_only=True)
class Use:
    """A simulated effect.

    Attributes
    ----------
    effect : Effect
        With its shape.
    coef : tuple of float
        Coefficients; of one in the model its values.
    joint : int
        Joint whose torque is drawn, from zero.
    x_label : str
        Horizontal axis, where it is none of those that the class names.
    signal : callable or None
        `Motion` -> that signal (n,); nan where there is nothing to draw.
    with_motion : bool or None
        Whether torques count in the direction of the motion; None is as in the class.
    """

    effect: effects.Effect
    coef: tuple
    joint: int = 1
    x_label: str = ""
    signal: object = None
    with_motion: bool | None = None

    @property
    def values(self):
        """Values of all parameters of the form in use, by name."""
        return self.effect.shape() | self.effect.parameters(self.coef)


# Quantities over which effects are drawn; others are over the position.
AXES = {
    "speed": "viscous coulomb asymmetric_friction stribeck viscous_quadratic".split(),
    "load": "load_friction gear_loss torque_gain".split(),
    "acceleration": ["rotor_inertia"],
    "time": ["drift", "payload"],
    "signal": ["signal"],
}
OTHER = "position"


def _of_window(motion):
    """Time in a short stretch."""
    t = motion.t - 10.0
    return np.where((t >= 0) & (t < WINDOW), t, np.nan)


def _since_reversal(motion, joint=1):
    """Way of a joint since it last turned round; nan before that."""
    q, v = motion.q[:, joint], motion.v[:, joint]
    turns = np.flatnonzero(np.diff(np.sign(v)) != 0) + 1
    last = np.searchsorted(turns, np.arange(q.size), side="right") - 1
    way = np.abs(q - q[turns[np.maximum(last, 0)]])
    return np.where((last >= 0) & (way < 0.15), way, np.nan)


def _over_time(**changed):
    return {"x_label": "time [s]", "signal": _of_window, **changed}


def uses():
    """Return how each effect of the library is simulated, name -> `Use`."""
    found = [
        Use(effect=effects.Viscous(joint=1), coef=(8.0,)),
        Use(effect=effects.Coulomb(joint=1), coef=(6.0,)),
        Use(effect=effects.AsymmetricFriction(joint=1), coef=(2.0, 3.0)),
        Use(effect=effects.Stribeck(joint=1, vs=0.15), coef=(4.0,)),
        Use(effect=effects.ViscousQuadratic(joint=1), coef=(5.0,)),
        Use(effect=effects.LoadFriction(joint=1), coef=(0.1,)),
        Use(effect=effects.GearLoss(joint=1), coef=(0.15, 0.05)),
        Use(
            effect=effects.MaxwellSlip(joint=1, displacements=(0.005, 0.02, 0.08)),
            coef=(2.0, 2.0, 2.0),
            x_label="way of joint 2 since it turned round [rad]",
            signal=_since_reversal,
            with_motion=True,
        ),
        Use(effect=effects.Backlash(joint=1, width=0.6), coef=(10.0, 0.0)),
        Use(effect=effects.Offset(joint=1), coef=(3.0,)),
        Use(effect=effects.Spring(joint=1), coef=(20.0, -10.0)),
        Use(
            effect=effects.Counterbalance(
                joint=1, form="linkage", ratio=0.5, angle=-0.5
            ),
            coef=(-40.0, 10.0),
        ),
        Use(effect=effects.Ripple(joint=1, period=0.35), coef=(2.0, 1.0)),
        Use(effect=effects.FrictionByPosition(joint=1, period=2.0), coef=(2.0, 1.0)),
        Use(effect=effects.RotorInertia(joint=3), coef=(0.4,), joint=3),
        Use(
            effect=effects.Coupling(joint=4, other=5, ratio=1.0),
            coef=(0.5, 1.5, 0.02),
            joint=4,
            x_label="sum of the speeds of joints 5 and 6 [rad/s]",
            signal=lambda motion: motion.v[:, 4] + motion.v[:, 5],
        ),
        Use(
            effect=effects.CouplingSpring(joint=4, other=5),
            coef=(3.0, 0.1),
            joint=4,
        ),
        Use(effect=effects.Elastic(joint=1), coef=(1 / 2000.0,), **_over_time()),
        Use(effect=effects.Delay(joint=1, delay=0.02), coef=(0.02,), **_over_time()),
        Use(
            effect=effects.TorqueFilter(joint=1, kind="smooth", time_constant=0.05),
            coef=(0.05,),
            **_over_time(),
        ),
        Use(
            effect=effects.Jerk(joint=1),
            coef=(0.05,),
            x_label="third derivative of the position of joint 2 [rad/s³]",
            signal=lambda motion: motion.derivative(motion.a[:, 1]),
        ),
        Use(
            effect=effects.Signal(
                joint=1, signal="temperature", of="coulomb", reference=30.0
            ),
            coef=(-0.2,),
            x_label="temperature, the recorded signal [°C]",
        ),
        Use(
            effect=effects.Drift(joint=1, of="coulomb", time_constant=12.0), coef=(4.0,)
        ),
        Use(
            effect=effects.Payload(joint=5, instant=18.0, centre=(0.0, 0.0, 0.1)),
            coef=(2.0, 0.0, 0.0, 0.2, 0.002),
        ),
        Use(
            effect=effects.BaseTilt(),
            coef=(np.deg2rad(4.0), np.deg2rad(2.0)),
            **_over_time(),
        ),
        Use(effect=effects.JointZero(joint=2), coef=(np.deg2rad(3.0),), joint=2),
        Use(
            effect=effects.JointAxis(joint=2),
            coef=(np.deg2rad(3.0), np.deg2rad(-2.0)),
            joint=2,
            **_over_time(),
        ),
        Use(effect=effects.TorqueGain(joint=1), coef=(1.15,)),
    ]
    return {one.effect.name: one for one in found}


# -- the motion --------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """The arm in motion.

    Attributes
    ----------
    urdf : str
        Its description.
    features : RigidBodyFeatures
        Of that.
    bodies : ndarray of shape (nv, 10)
        Its inertial parameters.
    motion : Motion
        Signals without noise.
    """

    urdf: str
    features: RigidBodyFeatures
    bodies: np.ndarray
    motion: Motion


@functools.cache
def scene():
    """Return the arm in motion, `Scene`."""
    recording = make_robot_recording(
        duration=DURATION,
        dt=DT,
        perturbation=0.0,
        encoder_noise=0.0,
        torque_noise=0.0,
        random_state=0,
    )
    features = RigidBodyFeatures(recording.urdf, friction=tuple(FRICTION))
    features.fit(recording.states[:4])
    model = features.model_
    bodies = np.array([one.toDynamicParameters() for one in model.inertias[1:]])
    declared = np.tile(list(FRICTION.values()), (model.nv, 1))
    t = DT * np.arange(len(recording.states))
    motion = make_motion(
        features,
        recording.states,
        (slice(0, t.size),),
        theta=np.hstack([bodies, declared]).ravel(),
        t=t,
        bandwidth=10.0,
        signals={"temperature": 30.0 + 8.0 * np.sin(0.4 * t)},
    )
    return Scene(urdf=recording.urdf, features=features, bodies=bodies, motion=motion)


def columns_of(effect, motion):
    """Columns of an effect on all joints, (n, nv, k)."""
    columns = effect.columns(motion)
    if columns.ndim == 3:
        return columns
    out = np.zeros((*motion.q.shape, columns.shape[1]))
    out[:, effect.joint] = columns
    return out


def torque_of(use, motion):
    """Torque of an effect in use, (n, nv)."""
    coef = np.asarray(use.coef)
    if isinstance(use.effect, effects.InModel):
        # Columns are derivatives by the values, of which these are small changes.
        coef = coef - use.effect.nominal
    return columns_of(use.effect, motion) @ coef


# -- the picture -------------------------------------------------------------------


def axis_of(effect):
    """Quantity over which an effect is drawn."""
    return next((axis for axis, names in AXES.items() if effect.name in names), OTHER)


def figure_of(use):
    """Draw the torque of an effect as reports draw it, a `Figure`."""
    motion, joint = scene().motion, use.joint
    law = torque_of(use, motion)[:, joint]
    kind = axis_of(use.effect)
    if use.signal is not None:
        x = use.signal(motion)
    elif kind == "time":
        x = motion.t
    elif kind == "signal":
        x = motion.signals[use.effect.recorded[0]]
    else:
        name = {"position": "q", "speed": "v", "acceleration": "a", "load": "load"}
        x = getattr(motion, name[kind])[:, joint]
    with_motion = use.with_motion
    if with_motion is None:
        others = {"load", "position"} & set(use.effect.depends)
        with_motion = bool(others) and "direction" in use.effect.depends
        if isinstance(use.effect, effects.Varied):
            with_motion |= use.effect.of != "offset"
    way = np.sign(motion.v[:, joint]) if with_motion else 1.0
    drawn = np.flatnonzero(np.isfinite(x))
    # The motion of a short stretch is repeated until there are rows enough.
    drawn = np.tile(drawn, max(1, FEWEST // drawn.size))
    rng = np.random.default_rng(0)
    noise = NOISE * np.sqrt(np.mean(law**2)) * rng.standard_normal(drawn.size)
    return effect_figure(
        x[drawn],
        noise,
        (way * law)[drawn],
        with_motion=with_motion,
        x_label=use.x_label or _label(kind, joint),
        y_label=f"torque of joint {joint + 1} [N m]",
    )


def _label(kind, joint):
    what = "time" if kind == "time" else f"{kind} of joint {joint + 1}"
    return f"{what} [{UNITS[kind]}]"


# -- rivals ------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Rivals:
    """What explains the torque of an effect as well.

    Attributes
    ----------
    kept : float
        Share of its squares that bodies and declared terms do not take over.
    others : tuple of (str, float)
        Effects that do not contain it, and what share of the squares that are kept each
        of them explains beside bodies and declared terms, its shape chosen; the most
        first.
    """

    kept: float
    others: tuple


def rivals_of(use):
    """Compare an effect with all others in the motion of the scene, `Rivals`."""
    name, at = use.effect.name, scene()
    base = _base_columns(name if name in DECLARED else "")
    torque = (torque_of(use, at.motion) / _sizes()[None])[::EVERY].ravel()
    rest = torque - base @ (base.T @ torque)
    whole, kept = torque @ torque, rest @ rest
    shares = {}
    for other, columns in _candidates(use.effect.joint):
        if other == name or other in DECLARED or other in containing(name):
            continue
        share = _share(columns, base, rest)
        shares[other] = max(share, shares.get(other, 0.0))
    alike = {other: min(s, 1.0) for other, s in shares.items() if s >= ALIKE}
    ordered = sorted(alike.items(), key=lambda one: -one[1])
    return Rivals(kept=kept / whole, others=tuple(ordered[:MOST]))


def containing(name):
    """Names of the effects that contain an effect, directly or not, a tuple."""
    library = effects.resolve("all")
    return tuple(one.name for one in library if name in closure(one, library))


def _share(columns, base, rest):
    """Return the share of a remainder (m,) that columns (m, k) explain with a base."""
    inside = base.T @ columns
    gram = columns.T @ columns - inside.T @ inside
    size = np.sqrt(np.maximum(np.diag(columns.T @ columns), np.finfo(float).tiny))
    gram, moment = gram / np.outer(size, size), (columns.T @ rest) / size
    # What the base has already is rounding here.
    values, vectors = np.linalg.eigh(gram)
    kept = values > 1e-9
    along = vectors[:, kept].T @ moment
    return float((along**2 / values[kept]).sum() / (rest @ rest))


@functools.cache
def _sizes():
    """Return the standard deviation of each joint's torque (nv,)."""
    return scene().motion.torque.std(axis=0)


@functools.cache
def _base_columns(name):
    """Orthonormal columns (n nv, p) of bodies and declared terms, but for one."""
    at = scene()
    states = np.hstack([at.motion.q, at.motion.v, at.motion.a])
    bodies = RigidBodyFeatures(at.urdf, friction=()).fit(states[:4])
    columns = [bodies.matrices(states)]
    for one in DECLARED:
        if one != name:
            (effect,) = effects.resolve(one)
            columns += [
                columns_of(clone(effect).set_params(joint=j), at.motion)
                for j in range(at.features.n_joints_)
            ]
    W = np.concatenate(columns, axis=2) / _sizes()[None, :, None]
    W = W[::EVERY].reshape(-1, W.shape[2])
    U, s, _ = np.linalg.svd(
        W / np.maximum(np.linalg.norm(W, axis=0), 1e-300), full_matrices=False
    )
    return U[:, s > 1e-9 * s[0]]


@functools.cache
def _candidates(joint):
    """Every effect that a search would try on a joint: pairs of name and columns."""
    motion, found = scene().motion, []
    for effect in effects.resolve("all"):
        places = (
            range(motion.n_joints) if isinstance(effect, effects.InModel) else (joint,)
        )
        for place in places:
            placed = clone(effect).set_params(joint=place)
            if placed.applies(motion):
                continue
            for shape in placed.shapes(motion):
                shaped = clone(placed).set_params(**shape)
                columns = columns_of(shaped, motion) / _sizes()[None, :, None]
                columns = columns[::EVERY]
                found.append((effect.name, columns.reshape(-1, columns.shape[2])))
    return found


# -- files and control loops ---------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Destination:
    """What a file has of an effect.

    Attributes
    ----------
    places : tuple of str
        Elements of the file that are others with the effect, such as
        "joint: damping".
    lacks : str
        What of it is not in the file, and why; empty if nothing is.
    """

    places: tuple
    lacks: str


def destinations(use):
    """Return where an effect goes, (`Destination` in URDF, the same in MJCF)."""
    used = [(use.effect, np.asarray(use.coef, dtype=float))]
    if use.effect.name == "coupling":
        # A tendon needs both joints to have it of each other.
        j, k = use.effect.joint, use.effect.other
        used.append((clone(use.effect).set_params(joint=k, other=j), used[0][1]))
    if isinstance(use.effect, effects.InModel):
        used = [(use.effect.with_values(use.coef), used[0][1])]
    plain, robot = (_robot(pairs) for pairs in ((), used))
    return tuple(_written(format_, plain, robot) for format_ in (_urdf, _mjcf))


def _robot(used):
    """Arm of the scene with effects, pairs of an effect and its coefficients."""
    at = scene()
    corrected = CorrectedModel(at.features.nominal_)
    for effect, _ in used:
        if isinstance(effect, effects.InModel):
            effect.correct(corrected)
    return TorqueModel(
        model=corrected.model,
        bodies=at.bodies,
        friction_names=tuple(FRICTION),
        friction=np.tile(list(FRICTION.values()), (at.features.n_joints_, 1)),
        effects=tuple(effect for effect, _ in used),
        coefficients=tuple(coef for _, coef in used),
        gains=corrected.gains,
        dt=DT,
    )


def _urdf(path, robot):
    """Write a robot as URDF, with its axes."""
    turned = {
        robot.joint_names[effect.joint]: rotation(
            effect.values @ cross_axes(CorrectedModel(robot.model).axes[effect.joint])
        )
        for effect in robot.effects
        if isinstance(effect, effects.JointAxis)
    }
    source, solid = Path(scene().urdf).read_text(), np.ones(robot.n_joints)
    return to_urdf(path, source, robot, solid, turned_joints=turned)


def _mjcf(path, robot):
    """Write a robot as MJCF."""
    return to_mjcf(path, robot, np.ones(robot.n_joints))


def _written(write, plain, robot):
    """Compare the files of a robot without and with effects, a `Destination`."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / name for name in ("plain", "with")]
        left = [write(path, one) for path, one in zip(paths, (plain, robot))][1]
        before, after = (_attributes(path) for path in paths)
    names = {effect.name for effect in robot.effects}
    changed = {
        key for key in before.keys() | after.keys() if before.get(key) != after.get(key)
    }
    return Destination(
        places=tuple(sorted({f"{tag}: {name}" for _, tag, name in changed})),
        lacks="; ".join(dict.fromkeys(one.reason for one in left if one.name in names)),
    )


def _attributes(path):
    """Attributes of a file, (path of names, tag, attribute) -> value."""
    found = {}

    def walk(element, above):
        here = (*above, element.get("name") or element.tag)
        for name, value in element.attrib.items():
            found[here, element.tag, name] = value
        for child in element:
            walk(child, here)

    walk(ET.parse(path).getroot(), ())
    return found


def step_reasons(use):
    """Say why `step` leaves an effect out, pairs of a shape and the reason or ""."""
    if isinstance(use.effect, effects.InModel):
        return (({}, ""),)
    shapes = use.effect.shapes(scene().motion)
    return tuple(
        (shape, why_left_out(clone(use.effect).set_params(**shape))) for shape in shapes
    )
