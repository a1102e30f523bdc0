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

# sphinx_gallery_thumbnail_number = 4
import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording
from sklearn_vbjfa.diagnosis import ConvergenceDisplay, NoiseDisplay, ParameterDisplay

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

display = NoiseDisplay.from_estimator(robot).plot()

# %%
# Parameters
# ----------
# One panel per joint and unit. Inertial parameters act on the torques in combinations;
# those that the data do not determine on their own have hollow markers. Before the
# projection their values are arbitrary; after it they are completed from the robot
# description, scaled to the data. What the data determine, and the friction, can be
# compared with the truth (the intervals of joint 2 do not allow for what the model
# lacks).

truth = recording.theta(robot.friction)
display = ParameterDisplay.from_estimator(
    robot, nominal=truth, parameters=["joint_2", "joint_3", "joint_6"]
).plot()

# %%
# Every body exists: its smallest pseudo-inertia eigenvalue is positive.

print(robot.min_eigenvalues_)

# %%
# Convergence
# -----------
# The bound of the regression over its iterations, and the gain of each iteration.

display = ConvergenceDisplay.from_estimator(robot).plot()

# %%
# Torques of the second joint
# ---------------------------

time = residuals.index * recording.dt
figure, axes = plt.subplots(2, 1, sharex=True, layout="constrained")
axes[0].plot(time, residuals.torque[:, 1], label="measured")
axes[0].plot(time, residuals.predicted[:, 1], label="predicted")
axes[0].set_ylabel("torque of joint_2 [N m]")
axes[0].legend()
axes[1].plot(time, residuals.residual[:, 1])
axes[1].set_ylabel("residual [N m]")
axes[1].set_xlabel("time [s]")
plt.show()
