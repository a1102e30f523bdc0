"""
============================
Designing the next recording
============================

A first recording has left some parameters undetermined. Which motion should be recorded
next? The one that minimises the expected error of the torques on the motions that the
robot is meant for.
"""

# %%
# A robot and a poor first recording
# ----------------------------------
# The arm is simulated. Its first motion is slow, one sine in each joint.

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import qr

from sklearn_vbjfa import RigidBodyFeatures, RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording

FRICTION = ("viscous", "coulomb")
robot_data = {"dt": 0.01, "friction": FRICTION}
first = make_robot_recording(
    duration=10.0, frequency=0.2, n_harmonics=1, random_state=0, **robot_data
)
same_robot = {"inertial": first.inertial, "friction": first.friction}
features = RigidBodyFeatures(first.urdf, friction=FRICTION)


def rows(states, every=10):
    """Equations of every tenth sample, (n, nv, p)."""
    thin = states[::every]
    return features.fit_transform(thin).reshape(len(thin), 6, -1)


# %%
# Base parameters
# ---------------
# A maximal set of independent columns, by pivoted QR at random states.

rng = np.random.default_rng(0)
W = rows(rng.uniform(-2, 2, size=(200, 18)), every=1).reshape(1200, -1)
size = np.linalg.norm(W, axis=0)
R, pivots = qr(W / np.where(size > 0, size, 1.0), mode="r", pivoting=True)
diagonal = np.abs(np.diag(R))
base = np.sort(pivots[: np.count_nonzero(diagonal > 1e-9 * diagonal[0])])
print(f"{base.size} base parameters of {features.n_parameters_}")

# %%
# What the first recording determines
# -----------------------------------
# The information matrix, with the residual of each joint as its noise.

identifier = RobotIdentifier(first.urdf, dt=first.dt, friction=FRICTION)
identifier.fit(first.q, first.tau)
noise = identifier.output_noise_


def information(states):
    """Information matrix of the base parameters, in units of random states."""
    A = (rows(states)[:, :, base] / noise[:, None]).reshape(-1, base.size)
    A *= np.sqrt(len(W)) / size[base]
    return A.T @ A


known = information(first.states)
print(f"condition number of the first recording: {np.linalg.cond(known) ** 0.5:.1e}")

# %%
# Candidates
# ----------
# Motions of five sines per joint, within 80 % of the ranges and speeds of the robot.

HARMONICS = 0.1 * np.arange(1, 6)
t = np.arange(0.0, 10.0, first.dt)
phase = 2 * np.pi * np.outer(t, HARMONICS)
w = 2 * np.pi * HARMONICS[:, None]
model = first.robot_model()
reach = 0.8 * model.upperPositionLimit
speed = 0.8 * model.velocityLimit


def motion(weights):
    """States [q | v | a] of weights (2, 5, 6) of cosines and sines."""
    a, b = weights
    c, s = np.cos(phase), np.sin(phase)
    q, v = c @ a + s @ b, c @ (w * b) - s @ (w * a)
    shrink = np.minimum(reach / np.abs(q).max(axis=0), speed / np.abs(v).max(axis=0))
    return np.hstack([q, v, -c @ (w**2 * a) - s @ (w**2 * b)]) * np.tile(shrink, 3)


def draw():
    """Draw the weights of a motion."""
    return rng.normal(size=(2, 5, 6)) / HARMONICS[:, None]


# %%
# The choice
# ----------
# The intended use is represented by twenty random motions. Let M be the information
# matrix of the data, and U that of one equation of these motions on average. The
# expected squared error of the predictions, in units of the noise, is then the trace of
# M^-1 U. The best of 60 random motions is improved by small changes, kept if they help.

uses = [information(motion(draw())) for _ in range(20)]
wanted = np.mean(uses, axis=0) / (len(t) / 10 * 6)


def expected_error(total):
    return np.sqrt(np.trace(np.linalg.solve(total, wanted)))


def after(weights):
    return expected_error(known + information(motion(weights)))


drawn = [draw() for _ in range(60)]
errors = np.array([after(weights) for weights in drawn])
best, best_error = drawn[int(np.argmin(errors))], errors.min()
for _ in range(200):
    trial = best + 0.2 * draw()
    trial_error = after(trial)
    if trial_error < best_error:
        best, best_error = trial, trial_error
typical = drawn[int(np.argsort(errors)[len(drawn) // 2])]
motions = {"first alone": None, "median draw": typical, "designed": best}
totals = {
    name: known + (0.0 if weights is None else information(motion(weights)))
    for name, weights in motions.items()
}
for name, total in totals.items():
    print(
        f"{name}: expected error {expected_error(total):.3f} of the noise, "
        f"condition number {np.linalg.cond(total) ** 0.5:.0f}"
    )

# %%
# Record it, fit both together
# ----------------------------
# The robot is simulated along the motion: true torques plus noise. A third motion, fast
# and of another kind, is the test.

inertial = np.hstack([first.inertial, np.column_stack(list(first.friction.values()))])


def record(weights, seed):
    """Noisy positions and torques."""
    states, draw = motion(weights), np.random.default_rng(seed)
    torque = rows(states, every=1) @ inertial.ravel()
    torque += first.torque_noise * draw.normal(size=torque.shape)
    return states[:, :6] + first.encoder_noise * draw.normal(size=torque.shape), torque


test = make_robot_recording(
    duration=20.0, dt=0.01, frequency=0.6, random_state=5, **same_robot
)


def error(weights, seed):
    """Error on the test motion after one more recording, or none."""
    q, tau, groups = first.q, first.tau, np.zeros(len(first.q), int)
    if weights is not None:
        q2, tau2 = record(weights, seed)
        q, tau = np.vstack([q, q2]), np.vstack([tau, tau2])
        groups = np.r_[groups, np.ones(len(q2), int)]
    fitted = RobotIdentifier(first.urdf, dt=first.dt, friction=FRICTION)
    fitted.fit(q, tau, groups=groups)
    rest = fitted.predict(test.states) - test.tau_clean
    return np.sqrt(np.mean(rest**2, axis=0)) / test.tau_clean.std(axis=0)


results = {}
for name, weights in motions.items():
    results[name] = np.mean([error(weights, seed) for seed in range(5)], axis=0)
    print(
        f"{name}: {(100 * results[name]).round(2)} % of the torque, "
        f"{100 * results[name].mean():.2f} % on average"
    )

# %%
# What a design promises holds for the sum over all joints and uses; a single joint may
# do better with a random motion.

# %%
# Expected standard deviations, and the actual error
# --------------------------------------------------

figure, axes = plt.subplots(1, 2, layout="constrained", figsize=(9, 3.5))
for name, matrix in totals.items():
    spread = 1 / np.sqrt(np.linalg.eigvalsh(matrix).clip(1e-12))
    axes[0].semilogy(spread, label=name)
axes[0].set_xlabel("direction in parameter space")
axes[0].set_ylabel("standard deviation, relative")
axes[0].legend()
place = np.arange(6)
for k, (name, values) in enumerate(results.items()):
    axes[1].bar(place + 0.27 * (k - 1), 100 * values, width=0.27, label=name)
axes[1].set_xticks(place, first.joint_names)
axes[1].set_yscale("log")
axes[1].set_ylabel("error on the test motion [% of the torque]")
plt.show()
