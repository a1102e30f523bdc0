"""
======================================
Identify motors from position commands
======================================

A quadruped with twelve motors has no torque sensors. The log has commanded and measured
positions at 200 Hz. Armature, damping and friction of the motors and the delay of the
commands are identified, with ranges.
"""

# %%
# Robot and log
# -------------
# The quadruped is simulated, so that the true values are known. The description has
# bodies that are wrong by about 10 %, one shank by 40 %, and no motor parameters. The
# true robot has a PD loop at 1 kHz with encoder noise and a command delay of 8 ms.

import importlib.util
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

from sklearn_vbjfa import RobotIdentifier, load_model
from sklearn_vbjfa.datasets import Recording
from sklearn_vbjfa.robot import PDDrive

LEGS, MOTORS = ("FL", "FR", "RL", "RR"), ("hip", "thigh", "calf")
KP, KD = {"hip": 20.0, "thigh": 20.0, "calf": 40.0}, {"hip": 1, "thigh": 1, "calf": 2}
DT, DELAY, NOISE = 0.005, 0.008, 1e-4


def description():
    """Text of the robot, whose base is held."""
    legs = ""
    for leg in LEGS:
        x, y = (0.19 if leg[0] == "F" else -0.19), (1 if leg[1] == "L" else -1)
        legs += f"""
        <body name="{leg}_hip_body" pos="{x} {0.05 * y} 0.3">
          <joint name="{leg}_hip" axis="1 0 0" range="-1 1"/>
          <inertial pos="0 {0.03 * y} 0" mass="0.7" diaginertia="7e-4 9e-4 7e-4"/>
          <body name="{leg}_thigh_body" pos="0 {0.09 * y} 0">
            <joint name="{leg}_thigh" axis="0 1 0" range="-1.5 3"/>
            <inertial pos="0 {-0.02 * y} -0.03" mass="1.1"
              diaginertia="5.5e-3 5e-3 1.2e-3"/>
            <body name="{leg}_calf_body" pos="0 0 -0.21">
              <joint name="{leg}_calf" axis="0 1 0" range="-2.7 -0.8"/>
              <inertial pos="0.006 0 -0.11" mass="0.24" diaginertia="3e-3 3e-3 4e-5"/>
            </body>
          </body>
        </body>"""
    return (
        '<mujoco model="quadruped"><compiler angle="radian"/>'
        f"<worldbody>{legs}</worldbody></mujoco>"
    )


folder = Path(tempfile.mkdtemp())
(folder / "quadruped.xml").write_text(description())
described = load_model(folder / "quadruped.xml")
names = tuple(described.names)[1:]
kind = np.array([MOTORS.index(name.split("_")[1]) for name in names])
kp, kd = (np.array([gain[MOTORS[k]] for k in kind]) for gain in (KP, KD))

rng = np.random.default_rng(0)
truth = {
    "rotor_inertia": np.array([0.010, 0.010, 0.024])[kind] * rng.normal(1, 0.04, 12),
    "viscous": np.array([0.15, 0.12, 0.25])[kind] * rng.normal(1, 0.04, 12),
    "coulomb": np.array([0.20, 0.18, 0.50])[kind] * rng.normal(1, 0.04, 12),
}
real = described.copy()
for j in range(12):
    share = rng.uniform(0.9, 1.1) if names[j] != "RR_calf" else 1.4
    real.inertias[j + 1] = pin.Inertia.FromDynamicParameters(
        share * described.inertias[j + 1].toDynamicParameters()
    )


def simulate(model, motors, commands, delay, noise=0.0, substeps=4):
    """Positions and speeds (n, 12) as read, by rows of the commands of a PD loop."""
    ticks = round(DT / 1e-3)
    step = DT / ticks / substeps
    model = model.copy()
    model.armature = motors["rotor_inertia"]
    data = model.createData()
    times = np.arange(len(commands) * ticks) * 1e-3
    # A command acts until the next one comes.
    rows = np.clip(np.floor((times - delay) / DT + 1e-9), 0, len(commands) - 1)
    told = commands[rows.astype(int)]
    q, v = commands[0].copy(), np.zeros(12)
    seen, rate, read = q.copy(), np.zeros(12), np.empty((2, *commands.shape))
    for k, wanted in enumerate(told):
        now = q + noise * rng.standard_normal(12)
        # The drive's own speed: differences behind a low-pass of 40 Hz.
        rate += (1 - np.exp(-2 * np.pi * 40e-3)) * ((now - seen) / 1e-3 - rate)
        seen = now
        if k % ticks == 0:
            read[:, k // ticks] = now, rate
        tau = kp * (wanted - now) - kd * rate
        for _ in range(substeps):
            friction = motors["viscous"] * v + motors["coulomb"] * np.tanh(v / 0.02)
            v = v + step * pin.aba(model, data, q, v, tau - friction)
            q = q + step * v
    return read


def chirps(seed, seconds=7.0):
    """Commands of all joints, unlike from joint to joint."""
    own = np.random.default_rng(seed)
    t = DT * np.arange(round(seconds / DT))[:, None]
    first, last = own.uniform(0.2, 0.6, 12), own.uniform(2.0, 4.0, 12)
    turns = first * t + (last - first) * t**2 / (2 * seconds)
    size = own.uniform(0.25, 0.45, 12) / (
        1 + (first + (last - first) * t / seconds) / 3
    )
    centre = np.array([0.0, 0.8, -1.6])[kind]
    return centre + np.clip(t, 0, 1) ** 2 * size * np.sin(2 * np.pi * turns)


told = [chirps(seed) for seed in range(3)]
read = [simulate(real, truth, one, DELAY, NOISE) for one in told]


drive = PDDrive(kp=KP, kd=KD, period=1e-3)


def recorded(states, commands):
    """Recording of some motions, as a reader would make it of files."""
    groups = np.repeat(np.arange(len(commands)), [len(x) for x in commands])
    recording = Recording(
        name="quadruped",
        q=np.concatenate([one[0] for one in states]),
        v=np.concatenate([one[1] for one in states]),
        tau=np.zeros((len(groups), 12)),
        t=np.concatenate([DT * np.arange(len(x)) for x in commands]),
        dt=DT,
        groups=groups,
        group_names=tuple(f"motion {k + 1}" for k in range(len(commands))),
        joint_names=names,
        position_units=("rad",) * 12,
        torque_units=("N m",) * 12,
        signals={"q_desired": np.concatenate(commands)},
    )
    return drive.driven(recording)


# %%
# Identification
# --------------
# The drive describes the law of the loop: gains by parts of the joint names, and its
# period. The delay is estimated with all other parameters. Two motions are fitted; the
# third is held out.

robot = RobotIdentifier(described, dt=DT, drive=drive)
robot.fit_recording(recorded(read[:2], told[:2]))

late = robot.parameter_names_.index("drive:delay")
found, deviation = robot.theta_[late], robot.theta_std_[late]
print(
    f"commands act {1e3 * found:.2f} +- {1.645e3 * deviation:.2f} ms late (90 %); "
    f"in truth {1e3 * DELAY:g} ms"
)

# %%
# Ranges
# ------
# A 90 % range contains the value in the robot's next recording with a probability of 90
# %. The four hips, thighs and calves each have the same motor, so their values share a
# mean.

ranges = robot.ranges(level=0.9)
titles = {
    "rotor_inertia": "armature [kg m²]",
    "viscous": "damping [N m s/rad]",
    "coulomb": "dry friction [N m]",
}
figure, axes = plt.subplots(1, 3, layout="constrained", figsize=(10, 4), sharey=True)
for axis, (term, title) in zip(axes, titles.items()):
    own = [ranges[f"{name}:{term}"] for name in names]
    value = np.array([one.value for one in own])
    ends = np.array([[one.value - one.lower, one.upper - one.value] for one in own]).T
    axis.errorbar(value, np.arange(12), xerr=np.abs(ends), fmt="o", ms=4, label="found")
    axis.plot(truth[term], np.arange(12), "kx", label="truth")
    axis.set_xlabel(title)
    axis.set_xlim(left=0)
axes[0].set_yticks(np.arange(12), names)
axes[0].invert_yaxis()
axes[0].legend(loc="lower left", fontsize="small")
inside = [
    ranges[f"{name}:{term}"].lower <= truth[term][j] <= ranges[f"{name}:{term}"].upper
    for term in titles
    for j, name in enumerate(names)
]
print(f"{np.sum(inside)} of {len(inside)} true values are in their ranges")

# %%
# Simulation from commands
# ------------------------
# The third motion is simulated from its commands alone, by the robot as described
# without motors and by the identified robot.

last = recorded(read[2:], told[2:])
after = robot.follow(last)[:, :12]
nothing = {term: np.zeros(12) for term in truth}
before, _ = simulate(described, nothing, told[2], 0.0)

t = last.t
figure, axes = plt.subplots(2, 3, layout="constrained", figsize=(10, 5), sharex=True)
window = (t > 5.0) & (t < 7.0)
for (upper, lower), j in zip(axes.T, range(3)):
    upper.plot(t[window], told[2][window, j], ":", color="0.6", label="command")
    upper.plot(t[window], before[window, j], color="C1", label="before")
    upper.plot(t[window], last.q[window, j], color="k", lw=2.5, label="recorded")
    upper.plot(t[window], after[window, j], color="C0", lw=1, label="after")
    upper.set_title(names[j])
    for simulated, colour in ((before, "C1"), (after, "C0")):
        lower.semilogy(
            t[window], 1e3 * np.abs(simulated - last.q)[window, j] + 1e-3, color=colour
        )
    lower.set_ylim(bottom=0.05)
    lower.set_xlabel("time [s]")
axes[0, 0].set_ylabel("position [rad]")
axes[1, 0].set_ylabel("error [mrad]")
figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right center")

for label, positions in (("commands", told[2]), ("before", before), ("after", after)):
    error = np.sqrt(((positions - last.q) ** 2).mean())
    print(f"{label}: {1e3 * error:.1f} mrad from the recorded positions")

# %%
# Export
# ------
# `to_mjcf` writes the robot with position-controlled motors. With ``sample=k`` it
# writes a random draw of all parameters, delay included, for domain randomisation.

for k in range(3):
    robot.to_mjcf(folder / f"sample_{k}.xml", sample=k)
    root = ElementTree.parse(folder / f"sample_{k}.xml").getroot()
    joint = next(x for x in root.iter("joint") if x.get("name") == "FL_calf")
    motor = next(x for x in root.iter("general") if x.get("name") == "FL_calf")
    told_of = ", ".join(
        f"{word} {float(joint.get(word)):.4f}"
        for word in ("armature", "damping", "frictionloss")
    )
    late = 1e3 * float(motor.get("delay"))
    print(f"sample {k}, FL_calf: {told_of}, delay {late:.2f} ms")

if importlib.util.find_spec("mujoco"):
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(folder / "sample_0.xml"))
    print(
        f"MuJoCo reads it: {model.nu} motors, masses of {sum(model.body_mass):.2f} kg"
    )
