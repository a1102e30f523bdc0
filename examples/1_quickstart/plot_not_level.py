"""
==========================================
Find a tilted base and a wrong torque gain
==========================================

An arm is recorded on a table that is tilted by a few degrees, and the torque sensor of
its second joint reads 15 % too much. Both faults change the torques of several joints.
The search is run with and without the effects of the geometry and the sensors.
"""

# %%
# Recording
# ---------
# Two motions of 20 s. The description has a level base and correct torques.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.effects import InModel, available, resolve

roll, pitch, gain = np.deg2rad(4.0), np.deg2rad(2.0), 1.15
recording = make_robot_recording(
    duration=20.0,
    dt=0.01,
    frequency=1.0,
    n_recordings=2,
    torque_noise=0.02,
    base_tilt=(roll, pitch),
    torque_gain={1: gain},
    random_state=2,
)
declared = RobotIdentifier(
    recording.urdf, dt=recording.dt, friction=("viscous", "coulomb")
)
data = recording.q, recording.tau
groups = recording.groups

# %%
# Search
# ------
# The tilt belongs to the whole robot. A rotated axis of the first joint would have the
# same torques and is listed as a rival. Values and intervals are in SI units here; the
# report has degrees and the remedy.

search = EffectDiscovery(declared, random_state=0)
search.fit(*data, groups=groups)

truth = {"roll": roll, "pitch": pitch, "gain": gain}
for effect in search.effects_:
    where = "robot" if effect.scope == "robot" else effect.joint_name
    print(f"{where}: {effect.name}, rivals {effect.rivals or 'none'}")
    for symbol, (low, high) in effect.intervals.items():
        value, true = effect.parameters[symbol], truth[symbol]
        print(f"  {symbol} = {value:.4f} ({low:.4f} to {high:.4f}), true {true:.4f}")

print(search.report_)

# %%
# Search without effects of the geometry
# --------------------------------------
# Without these effects the search explains the torques joint by joint, by effects that
# the arm does not have, and the error remains above the noise floor.

plain = [effect.name for effect in resolve() if not isinstance(effect, InModel)]
print(f"left out: {sorted(set(available()) - set(plain))}")
misled = EffectDiscovery(declared, effects=plain, random_state=0)
misled.fit(*data, groups=groups)
for effect in misled.effects_:
    print(f"{effect.joint_name}: {effect.name} {effect.rivals or ''}")

# %%
# Errors
# ------
# Errors on the held-out data and the noise floor.

names = recording.joint_names
errors = {
    "declared model": (search.error_before_, "0.6"),
    "completed without them": (misled.error_after_, "tab:orange"),
    "completed": (search.error_after_, "tab:blue"),
}
figure, axis = plt.subplots(layout="constrained", figsize=(7.5, 3.5))
place = np.arange(len(names))
for label, (error, colour) in errors.items():
    axis.plot(place, 100 * error, "o", color=colour, label=label)
floor = 100 * search.report_.outcome.column("floor")
axis.plot(place, floor, "k_", ms=24, label="noise floor")
axis.set_yscale("log")
axis.set_yticks([0.3, 1, 3, 10, 30], ["0.3", "1", "3", "10", "30"])
axis.minorticks_off()
axis.grid(axis="y", lw=0.4)
axis.set_xticks(place, names)
axis.set_ylabel("error [% of the torque's spread]")
axis.legend(ncols=2, fontsize="small")
axis.set_ylim(top=100)

# %%
# The axis of the first joint is vertical. If the base is level, it carries no weight;
# on the tilted base its torque varies with its position and with the reach of the arm.

shown = np.flatnonzero(groups == 1)
rows = recording.q[shown], recording.tau[shown], groups[shown]
figure, axes = plt.subplots(
    1, 3, sharex=True, sharey=True, layout="constrained", figsize=(9, 3.2)
)
models = (search.declared_, misled.identifier_, search.identifier_)
for axis, (label, (_, colour)), model in zip(axes, errors.items(), models):
    found = model.residuals(*rows)
    used = found.weight[:, 0] > 0
    angle = np.rad2deg(rows[0][found.index, 0])
    axis.plot(angle[used], found.residual[used, 0], ".", ms=2.5, color=colour)
    axis.axhline(0.0, color="0.4", lw=0.8)
    axis.set_title(label)
    axis.set_xlabel("position of joint_1 [degrees]")
axes[0].set_ylabel("residual of joint_1 [N m]")
plt.show()

# %%
# Corrected description
# ---------------------
# The exported inertias and friction are those of the true torques. A URDF cannot hold
# the tilt of the base or the gain of a torque sensor; a comment describes the remedy,
# and ``report.json`` has it for programs.

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "identified.urdf"
    search.identifier_.to_urdf(path)
    text = path.read_text(encoding="utf-8")
for line in text[text.index("<!--") + 4 : text.index("-->")].strip().splitlines():
    print(line.strip())

for correction in search.report_.to_dict()["robot"]["corrections"]:
    print(correction)
