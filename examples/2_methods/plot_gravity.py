"""
===========================================
Correct the masses for gravity compensation
===========================================

An arm that sinks or rises in gravity compensation has wrong masses in its description.
Held poses and slow motion of a measured KUKA LBR Med 7 correct them.
"""

# %%
# Recording
# ---------
# The measured set is read from the folder that the environment variable
# ``SKLEARN_VBJFA_DATA`` names, or from scikit-learn's data folder. Without it the
# example simulates slow motion of an arm whose bodies differ from the description by
# about 30 %.

import os

import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa.datasets import fetch_kuka_lbr_med7, make_robot_recording
from sklearn_vbjfa.gravity import correct_gravity, gravity_poses

home = os.environ.get("SKLEARN_VBJFA_DATA")
try:
    recording = fetch_kuka_lbr_med7(data_home=home, download_if_missing=False)
    model = recording.robot_model()
except (ImportError, OSError):
    recording = make_robot_recording(
        duration=120.0, dt=0.02, frequency=0.03, random_state=0
    )
    model = recording.urdf
print(recording)

# %%
# Correction
# ----------
# Only poses and windows of slow motion are used. The
# masses and first moments move as far from the description as the torques require, and
# the bodies stay physically consistent. Errors are those at samples that were left out
# of the fit.

found = correct_gravity(recording, model)
print(f"{found.n_samples} poses and windows of slow motion")
print("joint      described  corrected  90 % interval  friction")
for j, name in enumerate(recording.joint_names):
    known = "known" if found.friction_known[j] else "assumed"
    print(
        f"{name:10} {found.error_before[j]:9.2f}  {found.error_after[j]:9.2f}  "
        f"{found.interval[j]:13.2f}  {known}"
    )
for body in found.identifier.mass_deviations_:
    print(" or ".join(body.bodies), np.round(body.factors, 2), "of the described mass")

# %%
# Joints with a vertical axis have no gravity torque; their error is that of friction.
#
# Next poses
# ----------
# Each of these poses narrows the widest interval most. The way points before and beyond
# it let the joints come to it from both sides.

print(f"Further poses that are enough: {found.poses_enough}")
way, hold = gravity_poses(model, 3, fitted=found.identifier)
print(np.round(way[hold > 0][::2], 2))

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
at = np.arange(len(recording.joint_names))
left.bar(at - 0.2, found.error_before, 0.4, label="described")
left.bar(at + 0.2, found.error_after, 0.4, label="corrected")
left.set_xticks(at, at + 1)
left.set(xlabel="joint", ylabel="held-out torque error [N m]")
left.legend()
right.bar(at, found.gravity, 0.6, yerr=found.interval, capsize=4)
right.set_xticks(at, at + 1)
right.set(xlabel="joint", ylabel="gravity torque, 90 % interval [N m]")
plt.show()
