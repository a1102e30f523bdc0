"""
============================
From a log to a MuJoCo model
============================

An arm is identified, the missing effect is found, and the result is written for MuJoCo.
The simulators of the package and of MuJoCo are then compared with the measured motion.
"""

# %%
# Identification
# --------------
# The demonstration recording has two motions of a simulated six-axis arm. The model is
# fitted to the first. The friction of the second joint depends on its load, which the
# declared model does not contain.

import importlib.util
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording
from sklearn_vbjfa.diagnosis import simulate_windows

recording = load_demo_recording()
fitted, kept = recording.groups == 0, recording.groups == 1
declared = RobotIdentifier(
    recording.urdf, dt=recording.dt, friction=("viscous", "coulomb")
)
search = EffectDiscovery(declared, random_state=0)
search.fit(recording.q[fitted], recording.tau[fitted])
models = {"declared": search.declared_, "completed": search.identifier_}
for effect in search.effects_:
    print(f"{effect.joint_name}: {effect.name} {effect.parameters}")

# %%
# Export
# ------
# MuJoCo has bodies, damping, dry friction and rotor inertia. Load-dependent friction
# has no counterpart: ``to_mjcf`` fits the friction of the file to it, and
# lists it in the file. It warns if the simulated motion still differs by more than 2 %.
# The declared model exports completely: its Coulomb friction approximates the missing
# effect.

folder = Path(tempfile.mkdtemp())
files = {}
for name, robot in models.items():
    files[name] = folder / f"{name}.xml"
    left_out = robot.to_mjcf(files[name])
    print(f"{name}: {len(left_out)} left out")
    for one in left_out:
        print(f"  {one}")

# %%
# Simulation by the package
# -------------------------
# Windows of half a second of the second motion start at measured states. Two baselines
# have no model: one stays at its position, the other keeps its velocity.

WINDOW = 0.5
q, tau = recording.q[kept][:1700], recording.tau[kept][:1700]
windows = {
    name: simulate_windows(robot, q, tau, window=WINDOW)
    for name, robot in models.items()
}
one = windows["declared"]


def table(errors):
    """Root mean square over the windows, joint by joint."""
    for name, found in errors.items():
        size = np.rad2deg(np.sqrt(np.nanmean(found**2, axis=0)))
        print(f"{name:22s}", " ".join(f"{x:7.2f}" for x in size), "degrees")


table({f"{name}, package": own.errors for name, own in windows.items()})
table({name: rival.errors for name, rival in one.rivals.items()})

# %%
# Simulation by MuJoCo
# --------------------
# The same windows are simulated by MuJoCo with the same torques. The control of a motor
# is the reading of the torque channel, joints are addressed by name, and the time step
# divides the sample period. Without MuJoCo (``pip install mujoco``) its curves are
# missing.


def by_mujoco(path, found):
    """Simulate windows with MuJoCo: positions (n_windows, m, nv)."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in found.joint_names]
    places = [joint.qposadr[0] for joint in joints]
    speeds = [joint.dofadr[0] for joint in joints]
    steps = round(recording.dt / model.opt.timestep)
    out = np.empty_like(found.positions)
    for k, start in enumerate(found.starts):
        mujoco.mj_resetData(model, data)
        data.qpos[places], data.qvel[speeds] = np.split(found.start_states[k], 2)
        out[k, 0] = data.qpos[places]
        for i in range(1, out.shape[1]):
            before, after = tau[start + i - 1], tau[start + i]
            for step in range(steps):
                share = (step + 0.5) / steps
                data.ctrl[:] = before + share * (after - before)
                mujoco.mj_step(model, data)
            out[k, i] = data.qpos[places]
    return out


other = {}
if importlib.util.find_spec("mujoco"):
    other = {name: by_mujoco(path, one) for name, path in files.items()}
    errors = {
        f"{name}, MuJoCo": np.sqrt(np.mean((x - one.positions) ** 2, axis=1))
        for name, x in other.items()
    }
    table(errors)
else:
    print("MuJoCo is not installed: its curves are missing.")

# %%
# The largest difference between the simulators shows the effect of what the file cannot
# hold: none for the declared model, the load-dependent friction for the completed one.

for name, positions in other.items():
    apart = np.abs(positions - windows[name].simulated[..., :6]).max(axis=(0, 1))
    print(f"{name:10s}", " ".join(f"{x:7.2f}" for x in np.rad2deg(apart)), "degrees")

# %%
# Measured and simulated motion
# -----------------------------
# The second joint and its neighbour. Left, the declared model: both simulators agree,
# and both are wrong. Right, the completed model: the package follows the measured
# motion; MuJoCo, without load-dependent friction, is less accurate.

shown = slice(2, 6)
figure, axes = plt.subplots(
    2, 2, sharex=True, sharey="row", layout="constrained", figsize=(9.5, 5.5)
)
gap = np.full((one.t[shown].shape[0], 1), np.nan)


def curve(values):
    """Degrees in the windows shown as one line, broken between them."""
    return np.hstack([np.rad2deg(values[shown]), gap]).ravel()


time = np.hstack([one.t[shown], gap]).ravel()
for column, (name, own) in zip(axes.T, windows.items()):
    column[0].set_title(f"{name} model")
    for axis, j in zip(column, (1, 2)):
        for start in one.t[shown, 0]:
            axis.axvline(start, color="0.88", lw=0.8, zorder=0)
        axis.plot(
            time,
            curve(one.positions[..., j]),
            color="0.3",
            lw=3,
            alpha=0.4,
            label="measured",
        )
        axis.plot(
            time,
            curve(own.simulated[..., j]),
            color="tab:blue",
            lw=1.5,
            label="package",
        )
        if name in other:
            axis.plot(
                time,
                curve(other[name][..., j]),
                "--",
                color="tab:red",
                lw=1.5,
                label="MuJoCo",
            )
        axis.set_ylabel(f"{recording.joint_names[j]} [degrees]")
    column[-1].set_xlabel("time [s]")
axes[0, 0].legend()
plt.show()

# %%
# Conclusions
# -----------
# - The list of effects that are left out has the sizes of their remainders. Compare
#   them with the torques and with the residual.
# - The file of the completed model is at least as accurate as that of the declared
#   model, because its friction is fitted to the remainder.
# - If nothing is left out, both simulators agree.
# - MuJoCo enforces joint limits; the package warns.
