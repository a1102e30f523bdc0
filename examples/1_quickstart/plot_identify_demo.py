"""
==================================
Identify an arm from one recording
==================================

A rigid-body model is identified from joint positions and torques. The recording is
simulated, so that the true parameters are known: a six-axis arm at 200 Hz with encoder
noise of 1e-4 rad and torque noise of 5 %.
"""

# %%
# Recording
# ---------
# Two motions of 20 s each. The model is fitted to the first and tested on the second.
# The inertias of the description are wrong by about 30 %.

import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording
from sklearn_vbjfa.diagnosis import TorqueDisplay

recording = load_demo_recording()
fitted, tested = recording.groups == 0, recording.groups == 1
print(recording)

# %%
# Fit
# ---
# Smoothing, low-pass filter, standstill mask and joint weights are chosen from the
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
# Error on the second motion
# --------------------------
# The error is the RMS of the residual divided by the standard deviation of the torque,
# after the same low-pass filter.

residuals = robot.residuals(recording.q[tested], recording.tau[tested])
for name, error in zip(robot.joint_names_, residuals.normalised_error()):
    print(f"{name}: {100 * error:.2f} %")

# %%
# The recording is simulated, so the prediction at the true states can also be compared
# with the noise-free torque.

clean = recording.tau_clean[tested]
predicted = robot.predict(recording.states[tested])
truth_error = np.sqrt(np.mean((predicted - clean) ** 2, axis=0)) / clean.std(axis=0)
print(f"against the clean torque [%]: {(100 * truth_error).round(2)}")

# %%
# Noise
# -----
# The fit estimates the encoder noise, its effect on the torques, and the noise of the
# torque sensors. On joint 2 the residual (output noise) exceeds the noise floor: its
# friction depends on the load, which the model does not contain. `EffectDiscovery`
# finds such effects.

for name, floor, output in zip(
    robot.joint_names_, robot.noise_floor_, robot.output_noise_
):
    print(f"{name}: noise floor {floor:.3f} N m, output noise {output:.3f} N m")

# %%
# Parameters
# ----------
# The torques determine some parameters individually (``identifiable_``); the others are
# completed from the description. The identifiable ones are compared with the truth. The
# intervals of joint 2 do not cover the missing effect.

truth = recording.theta(robot.friction)
half = 1.645 * robot.theta_std_
for i in np.flatnonzero(robot.identifiable_):
    name, unit = robot.parameter_names_[i], robot.parameter_units_[i]
    value = robot.theta_[i]
    print(f"{name:20s} {value:8.4f} +- {half[i]:.4f} {unit}, true {truth[i]:.4f}")

# %%
# All bodies are physically consistent: the smallest eigenvalues of their pseudo-inertia
# matrices are positive.

print(robot.min_eigenvalues_)

# %%
# Measured and predicted torque of joint 2
# ----------------------------------------

display = TorqueDisplay.from_estimator(
    robot, recording.q[tested], recording.tau[tested], joints=[1]
).plot()
plt.show()
