"""Identify a robot with mujoco.sysid, as its documentation and examples do."""

import mujoco
import numpy as np
from mujoco import sysid


def name_parts(spec):
    """Give bodies, actuators and sensors of positions the names of their joints."""
    for body in spec.bodies[1:]:
        body.name = body.joints[0].name
    for actuator in spec.actuators:
        actuator.name = actuator.target
    for joint in spec.joints:
        spec.add_sensor(
            name=joint.name,
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint.name,
        )


def set_bias(spec, name, torque):
    """Add a constant torque to that of an actuator."""
    actuator = spec.actuator(name)
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[0] = torque


def value_of(joint, word, most):
    """Parameter of a joint: "armature", "damping", "frictionloss" or "bias"."""

    def put(spec, parameter):
        value = parameter.value[0]
        if word == "bias":
            set_bias(spec, joint, value)
        elif word == "damping":
            spec.joint(joint).damping[0] = value
        else:
            setattr(spec.joint(joint), word, value)

    least, first = (-most, 0.0) if word == "bias" else (0.0, 0.1 * most)
    return sysid.Parameter(f"{joint} {word}", first, least, most, modifier=put)


def body_of(spec, model, name):
    """Parameter of a body: its pseudo-inertia."""

    def put(spec, parameter):
        sysid.apply_body_inertia(spec, name, parameter)
        # MuJoCo 4.0.0 leaves nan here, with which the robot does not compile.
        spec.body(name).iquat = [1.0, 0.0, 0.0, 0.0]

    kind = sysid.InertiaType.Pseudo
    return sysid.body_inertia_param(spec, model, name, kind, modifier=put)


def identify(xml, runs, most, *, bodies, delay, iterations):
    """Fit values of joints, and bodies or a delay, to positions of several runs."""
    spec = mujoco.MjSpec.from_string(xml)
    name_parts(spec)
    model, parameters = spec.compile(), sysid.ParameterDict()
    joints = [joint.name for joint in spec.joints]
    for word, limits in most.items():
        for joint, limit in zip(joints, limits):
            parameters.add(value_of(joint, word, limit))
    if bodies:
        for name in joints:
            parameters.add(body_of(spec, model, name))
    transform = sysid.SignalTransform()
    if delay is not None:
        late = sysid.Parameter("delay", 0.5 * delay, 0.0, delay)
        parameters.add(late)
        transform.delay("*", late)
    measured = sysid.ModelSequences(
        "robot",
        spec,
        [str(k) for k in range(len(runs))],
        [sysid.create_initial_state(model, q[0], v) for _, _, q, v in runs],
        [sysid.TimeSeries.from_control_names(t, told, model) for t, told, _, _ in runs],
        [sysid.TimeSeries.from_names(t, q, model) for t, _, q, _ in runs],
    )
    residual = sysid.build_residual_fn(
        models_sequences=[measured], modify_residual=transform.apply, n_threads=1
    )
    found, _ = sysid.optimize(
        parameters, residual, verbose=False, max_iters=iterations, x_scale="jac"
    )
    return sysid.apply_param_modifiers(found, spec), found


def dynamic_parameters(model):
    """Mass, first moments and inertias about the joints' frames, (nv, 10)."""
    rows = []
    for body in range(1, model.nbody):
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
        R, m = rotation.reshape(3, 3), model.body_mass[body]
        c = model.body_ipos[body]
        inertia = R @ np.diag(model.body_inertia[body]) @ R.T
        inertia += m * (c @ c * np.eye(3) - np.outer(c, c))
        upper = inertia[(0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)]
        rows.append([m, *(m * c), *upper])
    return np.array(rows)
