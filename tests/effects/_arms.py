"""Small arms, motions and torques, computed independently of the package."""

import numpy as np


def arm(axes="ZYX", gravity=9.81):
    """Make a serial arm; X, Y, Z are revolute and x, y, z prismatic joints."""
    import pinocchio as pin

    rng = np.random.default_rng(5)
    model = pin.Model()
    model.name = "arm"
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    parent = 0
    for j, axis in enumerate(axes):
        kind = "P" if axis.islower() else "R"
        joint = getattr(pin, f"JointModel{kind}{axis.upper()}")()
        shift = np.array([0.05, 0.0, 0.3 if j else 0.0])
        name = f"joint_{j + 1}"
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), shift), name)
        centre = np.array([0.12, 0.03, 0.15]) + 0.02 * rng.normal(size=3)
        box = pin.Inertia.FromBox(max(4.0 - j, 1.0), 0.1, 0.15, 0.3)
        model.inertias[parent] = pin.SE3(np.eye(3), centre).act(box)
    return model


def motion(nv, duration=20.0, dt=0.01, seed=0, size=1.0, top=0.9):
    """Make sums of sines: time (n,), states [q | v | a] (n, 3 nv)."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration - 0.5 * dt, dt)
    q, v, a = (np.zeros((t.size, nv)) for _ in range(3))
    for j in range(nv):
        for f in rng.uniform(0.1, top, size=5):
            w = 2 * np.pi * f
            amplitude = size * 0.25 / np.sqrt(f)
            phase = rng.uniform(0, 2 * np.pi)
            q[:, j] += amplitude * np.sin(w * t + phase)
            v[:, j] += amplitude * w * np.cos(w * t + phase)
            a[:, j] -= amplitude * w**2 * np.sin(w * t + phase)
    return t, np.hstack([q, v, a])


def inverse_dynamics(model, states):
    """Return the rigid-body torques, row by row."""
    import pinocchio as pin

    data = model.createData()
    return np.array(
        [pin.rnea(model, data, *row.reshape(3, model.nv)) for row in states]
    )


class Derivatives:
    """Derivatives of torques by the geometry, by central differences.

    Has the interface of `TorqueDerivatives`, without its mathematics.
    """

    def __init__(self, model, states, step=1e-4, torques=inverse_dynamics):
        self._model, self._states, self._step = model, states, step
        self._torques = torques

    def _change(self, change):
        """Differentiate by the scalar that `change` applies to a model and states."""
        high, low = (self._model.copy() for _ in range(2))
        shifted = self._states.copy(), self._states.copy()
        change(high, shifted[0], self._step)
        change(low, shifted[1], -self._step)
        rise = self._torques(high, shifted[0]) - self._torques(low, shifted[1])
        return rise / (2 * self._step)

    def by_turn(self, joint, turns):
        """Differentiate by rotations (3, k) of a joint's placement, (n, nv, k)."""
        import pinocchio as pin

        def about(axis):
            def change(model, states, angle):
                placement = model.jointPlacements[joint + 1]
                placement.rotation = placement.rotation @ pin.exp3(angle * axis)

            return self._change(change)

        return np.stack([about(axis) for axis in np.eye(3)], axis=2) @ turns

    def by_position(self, joint):
        """Differentiate by the position of a joint, (n, nv)."""

        def change(model, states, shift):
            states[:, joint] += shift

        return self._change(change)

    def by_gravity(self):
        """Differentiate by the gravity vector, (n, nv, 3)."""

        def along(axis):
            def change(model, states, size):
                model.gravity.linear = model.gravity.linear + size * axis

            return self._change(change)

        return np.stack([along(axis) for axis in np.eye(3)], axis=2)

    @property
    def axes(self):
        """Directions of the joints in their own frames, (nv, 3); of `arm` only."""
        names = [joint.shortname() for joint in self._model.joints[1:]]
        return np.eye(3)[["XYZ".index(name[-1]) for name in names]]

    def rotation(self, joint):
        """Return the rotation of a joint's placement, (3, 3)."""
        return self._model.jointPlacements[joint + 1].rotation

    # The model has no corrections.
    nominal_rotation = rotation
    nominal_gravity = property(lambda self: self._model.gravity.linear)


def with_changed_body(model, delta):
    """Return a copy with delta (10,) added to the last body's parameters."""
    import pinocchio as pin

    other = model.copy()
    theta = other.inertias[model.njoints - 1].toDynamicParameters() + delta
    other.inertias[model.njoints - 1] = pin.Inertia.FromDynamicParameters(theta)
    return other


def last_body_regressor(model, states):
    """Return the regressor of the last body's ten parameters, (n, nv, 10)."""
    from tests.model._trees import by_sample

    return by_sample(model, *np.split(states, 3, axis=1))[:, :, -1]


def stops_sample_by_sample(q, displacement, level=None):
    """Return the stop operator by its definition, limited to a level (n,)."""
    level, z = np.ones(q.size) if level is None else level, np.zeros_like(q)
    for i in range(1, q.size):
        z[i] = z[i - 1] + (q[i] - q[i - 1]) / displacement
        if q[i] > q[i - 1]:
            z[i] = min(z[i], level[i])
        elif q[i] < q[i - 1]:
            z[i] = max(z[i], -level[i])
    return z


def bristles_sample_by_sample(q, displacement, level):
    """Step the LuGre bristle, z' = dq / d (1 - sign(dq) z / level), exactly."""
    z = np.zeros_like(q)
    for i in range(1, q.size):
        end = np.sign(q[i] - q[i - 1]) * level[i]
        left = np.exp(-abs(q[i] - q[i - 1]) / (displacement * level[i]))
        z[i] = end + (z[i - 1] - end) * left
    return z


def lag_step_by_step(x, dt, time_constant, n=200):
    """Apply a first-order low-pass to linearly interpolated samples, by Euler steps."""
    fine = np.interp(np.arange(0, x.size - 1 + 1e-9, 1 / n), np.arange(x.size), x)
    middle, y = 0.5 * (fine[1:] + fine[:-1]), np.full_like(fine, fine[0])
    for i, now in enumerate(middle):
        y[i + 1] = y[i] + dt / n / time_constant * (now - y[i])
    return y[::n]


def play_sample_by_sample(q, width):
    """Return the play operator by its definition."""
    out = np.empty(q.size)
    out[0] = q[0]
    for i in range(1, q.size):
        out[i] = min(max(out[i - 1], q[i] - width / 2), q[i] + width / 2)
    return out
