"""Random robots and motions for the recordings with undeclared effects.

Nothing here uses the code of the package: what is judged must not make its own exam.
"""

from dataclasses import dataclass
from importlib import resources

import numpy as np

# A metre of a prismatic joint counts as this many radians of a revolute one: all
# ranges, speeds and displacement scales are drawn in radians and divided by it.
RADIANS_PER_METRE = 7.0

GRAVITY_SHARE = 0.1


def is_prismatic(model):
    """Tell which joints slide, shape (nv,)."""
    names = [joint.shortname() for joint in model.joints[1:]]
    return np.array([name.startswith("JointModelP") for name in names])


def length_units(model):
    """Size of a radian in each joint's own unit, shape (nv,)."""
    return np.where(is_prismatic(model), 1.0 / RADIANS_PER_METRE, 1.0)


def _rotation(rng):
    import pinocchio as pin

    x = rng.normal(size=4)
    return pin.Quaternion(x / np.linalg.norm(x)).matrix()


def _quarter_turn(rng, tilt):
    import pinocchio as pin

    angles = 0.5 * np.pi * rng.integers(0, 4, size=3) + rng.normal(scale=tilt, size=3)
    return pin.rpy.rpyToMatrix(*angles)


def _body(mass, length, rng):
    import pinocchio as pin

    width = rng.uniform(0.25, 0.6, size=2) * length
    box = pin.Inertia.FromBox(mass, *width, length)
    centre = rng.uniform(-0.25, 0.25, size=3) * length
    centre[rng.integers(3)] += rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.6) * length
    return pin.SE3(_rotation(rng), centre).act(box)


def _random_arm(kind, rng, nv=None):
    import pinocchio as pin

    smallest = {"serial": 2, "prismatic": 3, "tree": 4}[kind]
    nv = int(rng.integers(smallest, 8)) if nv is None else nv
    model = pin.Model()
    slider = int(rng.integers(nv)) if kind == "prismatic" else -1
    fork = int(rng.integers(1, nv - 1)) if kind == "tree" else -1
    mass, length = rng.uniform(5.0, 15.0), rng.uniform(0.2, 0.45)
    tilt = rng.choice([0.0, 0.15])
    axis = -1
    for j in range(nv):
        # neighbouring axes in different directions, as robots are built
        axis = int(rng.choice([k for k in range(3) if k != axis]))
        family = "P" if j == slider else "R"
        joint = getattr(pin, f"JointModel{family}{'XYZ'[axis]}")()
        # the second arm of a tree starts from the first body
        parent = 1 if j == fork + 1 and kind == "tree" else j
        shift = rng.uniform(-0.3, 0.3, size=3) * length
        shift[rng.integers(3)] += length
        rotation = _quarter_turn(rng, tilt) if j else _rotation(rng)
        index = model.addJoint(
            parent, joint, pin.SE3(rotation, shift), f"joint_{j + 1}"
        )
        body = _body(mass, length, rng)
        model.appendBodyToJoint(index, body, pin.SE3.Identity())
        mass *= rng.uniform(0.55, 0.85)
        length *= rng.uniform(0.75, 1.0)
    return model


def _demo_arm():
    import pinocchio as pin

    folder = resources.files("sklearn_vbjfa.datasets").joinpath("robots")
    return pin.buildModelFromUrdf(str(folder.joinpath("demo_arm.urdf")))


def nominal_robot(kind, rng, nv=None):
    """Make a robot as its data sheet has it."""
    return _demo_arm() if kind == "demo" else _random_arm(kind, rng, nv)


def true_robot(nominal, rng):
    """Change the inertias: scale each body and fix a small lump of mass to it."""
    import pinocchio as pin

    model = nominal.copy()
    for i in range(1, model.njoints):
        body = nominal.inertias[i]
        size = max(np.sqrt(np.trace(body.inertia) / body.mass), 0.02)
        lump = pin.Inertia(
            body.mass * rng.uniform(0.02, 0.15),
            np.array(body.lever) + rng.normal(scale=size, size=3),
            np.zeros((3, 3)),
        )
        vector = body.toDynamicParameters() * np.exp(rng.normal(scale=0.15))
        model.inertias[i] = pin.Inertia.FromDynamicParameters(vector) + lump
    return model


@dataclass(frozen=True)
class Motion:
    """Sum of sines in every joint."""

    centre: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def at(self, t):
        """Return q, v and a at the times t, each of shape (n, nv)."""
        w = 2.0 * np.pi * self.frequency
        angle = t[:, None, None] * w + self.phase
        s, c = self.amplitude * np.sin(angle), self.amplitude * np.cos(angle)
        return (
            self.centre + s.sum(axis=2),
            (c * w).sum(axis=2),
            -(s * w**2).sum(axis=2),
        )

    def with_vibration(self, joint, frequency, amplitude, phase):
        """Return the motion with more sines in one joint."""
        nv, more = self.centre.size, np.size(frequency)
        extra = [np.zeros((nv, more)) for _ in range(3)]
        for array, values in zip(extra, (amplitude, frequency, phase)):
            array[joint] = values
        return Motion(
            self.centre,
            np.hstack([self.amplitude, extra[0]]),
            np.hstack([self.frequency, extra[1]]),
            np.hstack([self.phase, extra[2]]),
        )


def draw_motion(unit, top_frequency, t, rng, *, reversals=10):
    """Draw a motion in which every joint turns round often."""
    nv, n_sines = unit.size, 5
    for _ in range(100):
        frequency = top_frequency * rng.uniform(0.15, 1.0, size=(nv, n_sines))
        frequency[:, 0] = top_frequency * rng.uniform(0.85, 1.0, size=nv)
        amplitude = rng.uniform(0.3, 1.0, size=(nv, n_sines)) / frequency
        phase = rng.uniform(0.0, 2.0 * np.pi, size=(nv, n_sines))
        q, v, _ = Motion(np.zeros(nv), amplitude, frequency, phase).at(t)
        reach, speed = np.abs(q).max(axis=0), np.abs(v).max(axis=0)
        wanted = rng.uniform(0.8, 1.8, size=nv)
        scale = unit * np.minimum(wanted / reach, 3.0 / speed)
        if np.min(np.sum(v[1:] * v[:-1] < 0, axis=0)) >= reversals:
            centre = rng.uniform(-1.0, 1.0, size=nv) * unit
            return Motion(centre, amplitude * scale[:, None], frequency, phase)
    raise ValueError(f"No motion with {reversals} reversals of every joint was drawn.")


def inverse_dynamics(model, q, v, a):
    """Torques of the rigid bodies, without rotors, shape (n, nv)."""
    import pinocchio as pin

    model = model.copy()
    model.armature[:] = 0.0
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(q, v, a)])


def regressor(model, q, v, a):
    """Columns of the inertial parameters, shape (n, nv, 10 nv)."""
    import pinocchio as pin

    data = model.createData()
    rows = [
        pin.computeJointTorqueRegressor(model, data, *row).copy()
        for row in zip(q, v, a)
    ]
    # Pinocchio drops the axis of the joints where there is one.
    return np.array(rows).reshape(len(rows), model.nv, -1)


def own_inertia(model, q, joint):
    """Inertia about one axis in every pose, all other joints fixed, shape (n,)."""
    import pinocchio as pin

    data = model.createData()
    return np.array([pin.crba(model, data, x)[joint, joint] for x in q])


def joint_inertia(model, q):
    """Mean inertia about each axis, all other joints fixed, shape (nv,)."""
    import pinocchio as pin

    data = model.createData()
    some = q[:: max(1, len(q) // 50)]
    return np.mean([np.diag(pin.crba(model, data, x)).copy() for x in some], axis=0)


def feels_gravity(model, q):
    """Whether gravity loads at least half of the joints noticeably."""
    still = np.zeros_like(q)
    held = inverse_dynamics(model, q, still, still)
    spread = held.std(axis=0)
    return np.mean(spread > GRAVITY_SHARE * spread.max()) >= 0.5
