"""
=========================
Design the next recording
=========================

A slow first recording leaves two possible causes of the model error. An exciting
trajectory is designed to distinguish them, recorded, and searched again.
"""

# %%
# Robot
# -----
# The arm has three joints with the declared friction. A bundle of cables over the
# second joint acts as a spring and is not declared.

import warnings

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.design import design_motion
from sklearn_vbjfa.effects import resolve

DT, DURATION, NV = 0.01, 20.0, 3
arm = make_robot_recording(duration=1.0).robot_model()
model = pin.buildReducedModel(arm, [4, 5, 6], np.zeros(6))
data = model.createData()

VISCOUS = np.array([4.0, 4.0, 2.0])  # N m s/rad
CABLES = 40.0  # N m/rad
NOISE = np.array([0.3, 1.0, 0.3])  # N m
STIFFNESS, DAMPING = np.array([600.0, 900.0, 400.0]), np.array([60.0, 80.0, 30.0])


def record(motion, seed, steps=10):
    """Record encoders and torques while a controller of low gains follows a motion."""
    h = DT / steps
    desired = motion(h * np.arange(round(DURATION / h)))
    q, v = desired[0, :NV].copy(), desired[0, NV : 2 * NV].copy()
    readings, torques = [], []
    for k, (q_d, v_d, a_d) in enumerate(desired.reshape(-1, 3, NV)):
        tau = pin.rnea(model, data, q_d, v_d, a_d)
        tau += STIFFNESS * (q_d - q) + DAMPING * (v_d - v)

        def acceleration(q, v, tau=tau):
            cables = np.array([0.0, CABLES * (q[1] - 0.3), 0.0])
            return pin.aba(model, data, q, v, tau - VISCOUS * v - cables)

        # Second order: the torque belongs to the middle of the step.
        q_half, v_half = q + 0.5 * h * v, v + 0.5 * h * acceleration(q, v)
        if k % steps == 0:
            readings.append(q_half)
            torques.append(tau)
        q, v = q + h * v_half, v + h * acceleration(q_half, v_half)
    rng = np.random.default_rng(seed)
    shape = (len(readings), NV)
    return (
        np.array(readings) + 2e-5 * rng.normal(size=shape),
        np.array(torques) + NOISE * rng.normal(size=shape),
    )


# %%
# First recording
# ---------------
# Each joint follows three slow sines, and the second joint covers a quarter of its
# range only. The motion does not repeat, because a repetition would also repeat the
# model error.

SIZE = np.array([[1.8, 0.24, 0.36], [0.6, 0.36, 0.18], [0.6, 0.18, 0.18]])
PHASE = np.array([[0.0, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 0.0, 4.0]])
MIDDLE = np.array([0.0, 0.6, 0.5])
FREQUENCY = np.array([0.1, 0.16, 0.27])  # Hz


def slow(t):
    """States [q | v | a] of the first motion."""
    w = 2 * np.pi * FREQUENCY[:, None, None]
    angle = w * t[:, None] + PHASE[:, None]
    size = SIZE[:, None]
    q = MIDDLE + (size * np.sin(angle)).sum(axis=0)
    v = (size * w * np.cos(angle)).sum(axis=0)
    return np.hstack([q, v, -(size * w**2 * np.sin(angle)).sum(axis=0)])


# The drives have no gears: without backlash, and without rotors of their own.
EFFECTS = ("asymmetric_friction", "stribeck", "viscous_quadratic", "load_friction")
EFFECTS += ("offset", "spring", "counterbalance", "ripple")


def search(*recordings):
    """Close the loop on recordings."""
    robot = RobotIdentifier(model, dt=DT, friction=("viscous", "coulomb"))
    loop = EffectDiscovery(robot, effects=EFFECTS, random_state=0)
    q, tau = (np.concatenate(parts) for parts in zip(*recordings))
    groups = np.repeat(np.arange(len(recordings)), [len(q) for q, _ in recordings])
    loop.fit(q, tau, groups=groups)
    for effect in loop.effects_:
        rivals = " or ".join((effect.name, *effect.rivals))
        print(f"{effect.joint_name}: {rivals}")
    return loop


first = record(slow, seed=0)
loop = search(first)

# %%
# The spring may also be a counterbalance, a spring on a lever, whose torque differs
# only outside the recorded range.
#
# Design
# ------
# The trajectory stays within the limits of the description. The report provides the two
# effects to distinguish, and the first recording the noise of the joints.

motion = design_motion(
    loop.identifier_, report=loop, duration=DURATION, dt=DT, random_state=0
)
print(motion)
for name in ("position", "velocity", "torque"):
    print(f"margin of {name}: {motion.margins[name].round(3)}")
for shown in motion.shows:
    if shown.joint == 1 and shown.name in ("spring", "counterbalance"):
        print(f"{shown.name}: detectable if its torque is {shown.least:.2f} N m")

# %%
# Second recording
# ----------------
# The controller does not follow the trajectory exactly. The recorded motion is fitted,
# so this does not matter.

second = record(motion.states, seed=1)
print(f"tracking error: up to {np.abs(second[0] - motion.q).max():.3f} rad")
both = search(first, second)
cables = both.effects_[0]
for symbol, (low, high) in cables.intervals.items():
    print(f"{symbol}: {cables.parameters[symbol]:.3f} ({low:.3f} to {high:.3f})")

# %%
# Excitation of the two effects
# -----------------------------
# Both effects are fitted to the first recording. On its motion the predicted torques
# agree within a fraction of the noise; on the designed motion they differ. The models
# warn because the designed motion leaves the range of their fit.

(spring,) = (effect for effect in loop.effects_ if effect.name == "spring")
shapes = {"spring": {}} | {trial["name"]: trial["shape"] for trial in spring.trials[:1]}


def fitted(name):
    """Fit the model with one of the causes to the first recording."""
    (effect,) = resolve((name,))
    effect.set_params(joint=1, **shapes[name])
    robot = RobotIdentifier(
        model, dt=DT, friction=("viscous", "coulomb"), effects=(effect,)
    )
    return robot.fit(*first)


causes = {name: fitted(name) for name in shapes}
t = DT * np.arange(round(DURATION / DT))
figure, axes = plt.subplots(
    2, 2, sharex="col", sharey="row", layout="constrained", figsize=(9, 5)
)
for column, (title, states) in enumerate(
    {"first motion": slow(t), "designed motion": motion.states(t)}.items()
):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        torque = {name: robot.predict(states)[:, 1] for name, robot in causes.items()}
    one, other = torque.values()
    apart = np.sqrt(np.mean((one - other) ** 2)) / NOISE[1]
    print(f"{title}: {' and '.join(torque)} differ by {apart:.2f} of the noise")
    axes[0, column].set_title(title)
    for (name, values), style in zip(torque.items(), ("-", "--")):
        axes[0, column].plot(t, values, style, lw=1, label=name)
    axes[1, column].axhspan(-NOISE[1], NOISE[1], color="0.9", label="noise")
    axes[1, column].plot(t, other - one, "C3", lw=1)
    axes[1, column].set_xlabel("time [s]")
axes[0, 0].set_ylabel("torque of joint 2 [N m]")
axes[0, 0].legend()
axes[1, 0].set_ylabel("difference [N m]")
axes[1, 0].legend()

# %%
# Motion and limits
# -----------------
# Each signal relative to its limit; positions relative to half of their range, from its
# centre.

limits = motion.limits
middle, half = limits.position.mean(axis=1), np.ptp(limits.position, axis=1) / 2
signals = {
    "position": (motion.q - middle) / half,
    "velocity": motion.v / limits.velocity,
    "torque": motion.tau / limits.torque,
}
figure, axes = plt.subplots(3, 1, sharex=True, layout="constrained", figsize=(9, 6))
for axis, (name, values) in zip(axes, signals.items()):
    axis.plot(motion.t, values, lw=1, label=motion.joint_names)
    for end in (-1, 1):
        axis.axhline(end, color="0.4", lw=0.8, ls=":")
    axis.set_ylabel(f"{name} / limit")
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
axes[-1].set_xlabel("time [s]")
plt.show()
