"""
===================================
Identify an arm from one recording
===================================

Joint positions and torques in, a physically consistent rigid-body model out. The
recording is simulated, so that the truth is known: an invented six-axis arm, 200 Hz,
encoder noise of 1e-4 rad, torque noise of 5 %.
"""

# %%
# The recording
# -------------
# Two motions of 20 s each. The first is fitted, the second kept for testing. The
# inertias of the robot description are wrong by some 30 %.

import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording
from sklearn_vbjfa.diagnosis import TorqueDisplay

recording = load_demo_recording()
fitted, tested = recording.groups == 0, recording.groups == 1
print(recording)

# %%
# The fit
# -------
# States, filter, standstill mask, joint weights and projection are chosen from the
# data.

robot = RobotIdentifier(
    recording.urdf, dt=recording.dt, friction=("viscous", "coulomb")
)
robot.fit(recording.q[fitted], recording.tau[fitted])

print(f"cut-off of the states [Hz]: {robot.state_estimator_.cutoff_.round(1)}")
print(f"cut-off of the low-pass [Hz]: {robot.cutoff_:.2f}")
noise = robot.state_estimator_.noise_variance_**0.5
print(f"encoder noise found [rad]: {noise.round(6)}")

# %%
# Held-out error
# --------------
# Root mean square of the residual over the standard deviation of the torque, both after
# the same low-pass.

residuals = robot.residuals(recording.q[tested], recording.tau[tested])
for name, error in zip(robot.joint_names_, residuals.normalised_error()):
    print(f"{name}: {100 * error:.2f} %")

# %%
# Since the truth is known, the prediction can be compared with the noiseless torque at
# the true states, which count as noiseless queries.

clean = recording.tau_clean[tested]
predicted = robot.predict(recording.states[tested])
truth_error = np.sqrt(np.mean((predicted - clean) ** 2, axis=0)) / clean.std(axis=0)
print(f"against the clean torque [%]: {(100 * truth_error).round(2)}")

# %%
# Noise
# -----
# The fit measures the noise of the encoders, its effect on the torques through the
# regressors (input noise), and the noise of the torque sensors. On joint 2 more remains
# (output noise) than the sensors explain (noise floor): its friction depends on the
# load, which the model does not contain.
# :ref:`sphx_glr_auto_examples_1_quickstart_plot_what_is_missing.py` finds that out.

for name, floor, output in zip(
    robot.joint_names_, robot.noise_floor_, robot.output_noise_
):
    print(f"{name}: noise floor {floor:.3f} N m, output noise {output:.3f} N m")

# %%
# Parameters
# ----------
# Inertial parameters act on the torques in combinations; those that the data do not
# determine on their own are completed from the robot description, scaled to the data.
# What the data determine can be compared with the truth (the intervals of joint 2 do
# not allow for what the model lacks).

truth = recording.theta(robot.friction)
half = 1.645 * robot.theta_std_
for i in np.flatnonzero(robot.identifiable_):
    name, unit = robot.parameter_names_[i], robot.parameter_units_[i]
    value = robot.theta_[i]
    print(f"{name:20s} {value:8.4f} +- {half[i]:.4f} {unit}, true {truth[i]:.4f}")

# %%
# Every body exists: its smallest pseudo-inertia eigenvalue is positive.

print(robot.min_eigenvalues_)

# %%
# Torques of the second joint
# ---------------------------

display = TorqueDisplay.from_estimator(
    robot, recording.q[tested], recording.tau[tested], joints=[1]
).plot()
plt.show()
