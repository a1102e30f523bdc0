"""Robots with known parameters, as the simulator of the package takes them."""

import numpy as np


def torque_model(model, *, bodies=None, friction=None, effects=None, dt=None):
    """Make a `TorqueModel` of numbers.

    Parameters
    ----------
    model : pinocchio.Model
        Robot.
    bodies : ndarray of shape (nv, 10), default=None
        Inertial parameters; those of the model by default.
    friction : dict of str to float or ndarray of shape (nv,), default=None
        Declared friction: names with coefficients.
    effects : dict of Effect to sequence of float, default=None
        Effects with their coefficients.
    dt : float, default=None
        Sample period [s].
    """
    from sklearn_vbjfa.model import nominal_parameters
    from sklearn_vbjfa.simulation import Load, TorqueModel

    friction, effects = friction or {}, effects or {}
    if bodies is None:
        bodies = np.reshape(nominal_parameters(model), (model.nv, 10))
    values = [np.broadcast_to(x, model.nv) for x in friction.values()]
    coefficients = np.reshape(np.transpose(values), (model.nv, len(values)))
    own = tuple(np.asarray(x, dtype=float) for x in effects.values())
    with_load = [bool({"load", "torque"} & set(effect.needs)) for effect in effects]
    return TorqueModel(
        model=model,
        bodies=bodies,
        friction_names=tuple(friction),
        friction=coefficients,
        effects=tuple(effects),
        coefficients=own,
        gains=np.ones(model.nv),
        load=Load(
            bodies=bodies,
            friction=coefficients,
            coefficients=tuple(
                np.empty(0) if needs else x for needs, x in zip(with_load, own)
            ),
        )
        if any(with_load)
        else None,
        dt=dt,
    )


def torques(robot, q, v, a, t=None):
    """Torques (n, nv) of a `TorqueModel` along a motion, by its effects' own columns.

    Parameters
    ----------
    robot : TorqueModel
        Robot whose effects are none in the model.
    q, v, a : ndarray of shape (n, nv)
        Motion.
    t : ndarray of shape (n,), default=None
        Time [s]; multiples of the robot's period by default.
    """
    from sklearn_vbjfa.effects import Motion
    from sklearn_vbjfa.model import TreeRegressor

    rigid = TreeRegressor(robot.model).torques(q, v, a, robot.bodies)
    columns = {
        "viscous": v,
        "coulomb": np.sign(v),
        "offset": np.ones_like(v),
        "rotor_inertia": a,
    }
    out = rigid.copy()
    for k, name in enumerate(robot.friction_names):
        out += columns[name] * robot.friction[:, k]
    motion = Motion(
        q=q,
        v=v,
        a=a,
        t=robot.dt * np.arange(len(q)) if t is None else t,
        load=rigid,
    )
    for effect, values in zip(robot.effects, robot.coefficients):
        out[:, effect.joint] += effect.columns(motion) @ values
    return out


def simulated(robot, tau, q0, v0, t=None):
    """States (n, 3 nv) of a `TorqueModel` by the package."""
    from sklearn_vbjfa.simulation import simulate

    return np.asarray(simulate(robot, tau, q0, v0, t))


def slide(*masses):
    """Slides in a row along one horizontal axis, each on the one before it."""
    import pinocchio as pin

    model = pin.Model()
    for j, mass in enumerate(masses):
        number = model.addJoint(j, pin.JointModelPX(), pin.SE3.Identity(), f"slide_{j}")
        model.inertias[number] = pin.Inertia.FromSphere(mass, 0.05)
    return model


def pendulum(*links):
    """Pendulum of links (mass, lever, inertia about its centre of mass, length).

    All axes are horizontal and parallel, all angles zero where it hangs straight.
    """
    import pinocchio as pin

    model, length = pin.Model(), 0.0
    for j, (mass, lever, inertia, following) in enumerate(links):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -length]))
        number = model.addJoint(j, pin.JointModelRY(), place, f"hinge_{j}")
        centre = np.array([0.0, 0.0, -lever])
        model.inertias[number] = pin.Inertia(mass, centre, inertia * np.eye(3))
        length = following
    return model


def chain(n_joints, rng):
    """Arm of revolute joints about x, y and z in turn, placed at random."""
    import pinocchio as pin

    model = pin.Model()
    kinds = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
    for j in range(n_joints):
        rotation = pin.Quaternion(*rng.normal(size=4)).normalized()
        placement = pin.SE3(rotation, 0.3 * rng.normal(size=3))
        number = model.addJoint(j, kinds[j % 3](), placement, f"joint_{j}")
        model.inertias[number] = pin.Inertia.FromSphere(1.0, 0.1)
    return model
