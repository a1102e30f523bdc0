"""Torques of an MJCF file by MuJoCo's own inverse dynamics."""

import numpy as np


def drive_torques(path, states, *, friction=True):
    """Compute controls (n, nv) that the motors of a file need in states (n, 3 nv).

    Columns and controls are in the order of the motors. Forces that MuJoCo leaves to
    the actuators are theirs without control.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    if not friction:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    data = mujoco.MjData(model)
    joints = model.actuator_trnid[:, 0]
    dofs = model.jnt_dofadr[joints]
    found = []
    for row in states:
        q, v, a = row.reshape(3, -1)
        data.qpos[model.jnt_qposadr[joints]] = q
        data.qvel[dofs], data.qacc[dofs] = v, a
        data.ctrl[:] = 0.0
        mujoco.mj_inverse(model, data)
        needed = data.qfrc_inverse.copy()
        mujoco.mj_fwdActuation(model, data)
        gain = model.actuator_gainprm[:, 0]
        found.append((needed - data.qfrc_actuator)[dofs] / gain)
    return np.array(found)


def moving_states(rng, n, nv, reach=1.0, slowest=0.1):
    """States (n, 3 nv) in which every joint moves, some in either direction."""
    q = rng.uniform(-reach, reach, size=(n, nv))
    v = rng.uniform(slowest, 3.0, size=(n, nv)) * rng.choice([-1, 1], size=(n, nv))
    a = rng.uniform(-30.0, 30.0, size=(n, nv))
    return np.hstack([q, v, a])


def followed(path, start, wanted, dt):
    """Simulate positions (n, nv) at rows of `dt` seconds, from commanded ones (n, nv).

    A command is held until the next one, and the first one was there for long; start
    (2 nv,) are positions and velocities. Columns are in the order of the motors.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    joints = model.actuator_trnid[:, 0]
    dofs, places = model.jnt_dofadr[joints], model.jnt_qposadr[joints]
    data.qpos[places], data.qvel[dofs] = np.split(start, 2)
    for j, kept in enumerate(model.actuator_history[:, 0]):
        if kept:
            times = -model.opt.timestep * np.arange(kept, 0.0, -1.0)
            before = np.full(kept, wanted[0, j])
            mujoco.mj_initCtrlHistory(model, data, j, times, before)
    steps = round(dt / model.opt.timestep)
    found = np.empty(wanted.shape)
    for k, now in enumerate(wanted):
        found[k] = data.qpos[places]
        data.ctrl[:] = now
        for _ in range(steps):
            mujoco.mj_step(model, data)
    return found
