"""
=========================
What does the model lack?
=========================

A declared model is fitted, the plain terms that it lacks are added, its torque
residuals are searched for known effects, and the model is completed with what is found.
The recorded arm has viscous and Coulomb friction, and on joint 2 friction proportional
to the load; the declared model has only viscous friction.
"""

# %%
# The declared model
# ------------------
# Two motions of 20 s. An eighth at either end of each is set aside for the final test.

import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording

recording = load_demo_recording()
declared = RobotIdentifier(recording.urdf, dt=recording.dt, friction=("viscous",))

# %%
# The loop
# --------
# Coulomb friction, an offset and a rotor inertia are fitted on every joint, as no drive
# is without them; all further effects of the library are tried on all joints.

loop = EffectDiscovery(declared, random_state=0)
loop.fit(recording.q, recording.tau, groups=recording.groups)

print(f"added on every joint: {', '.join(loop.added_)}")
for effect in loop.effects_:
    print(f"{effect.joint_name}: {effect.name}, rivals {effect.rivals or 'none'}")
    for symbol, (low, high) in effect.intervals.items():
        value, unit = effect.parameters[symbol], effect.units[symbol]
        print(f"  {symbol} = {value:.3f} {unit} ({low:.3f} to {high:.3f})")
values = dict(zip(loop.identifier_.parameter_names_, loop.identifier_.theta_))
found = [values[f"{name}:coulomb"] for name in recording.joint_names]
print(f"Fc:      {np.round(found, 3)} N m")
print(f"true Fc: {recording.friction['coulomb'].round(3)} N m")
print(f"true mu: {recording.undeclared['load_friction'][1]} (joint_2)")

# %%
# Of an effect that was found, the loop says the logarithm of its posterior odds beside
# the others, and which share of the squared error it saves on stretches of time that
# were not fitted. What is more probable than not and is not named stands apart.

for effect in loop.effects_:
    print(
        f"{effect.name} saves {100 * effect.evidence.gain:.0f} %, "
        f"log odds {effect.log_odds:.1f}"
    )
for effect in loop.possible_:
    print(
        f"possible: {effect.name}, {100 * effect.probability:.0f} %: {effect.warning}"
    )

# %%
# The held-out part
# -----------------
# Root mean square of the residual over the standard deviation of the torque in the
# moving time of the whole recording.

errors = loop.error_before_, loop.error_plain_, loop.error_after_
for name, before, plain, after in zip(recording.joint_names, *errors):
    print(
        f"{name}: {100 * before:5.2f} % before, {100 * plain:5.2f} % with the plain "
        f"terms, {100 * after:5.2f} % after"
    )
print(f"unexplained: {[rest.joint_name for rest in loop.unexplained_]}")

# %%
# Effects that could not have been found, whatever the motion or in this one.

for effect in loop.hidden_:
    print(f"{effect.joint_name}: {effect.name} ({effect.reason})")

# %%
# Residual against speed
# ----------------------
# The residual of the declared model has a step where the joint reverses. On joint 2
# more is missing: the step depends on the load. (The completed model is the final one,
# fitted to all data.)

tested = np.concatenate(
    [np.flatnonzero(recording.groups == label)[-1000:] for label in (0, 1)]
)
rows = recording.q[tested], recording.tau[tested], recording.groups[tested]
joints = (1, 3)
figure, axes = plt.subplots(
    len(joints), 2, sharex="row", sharey="row", layout="constrained", figsize=(8, 6)
)
for column, (title, model) in enumerate(
    {"declared": loop.declared_, "completed": loop.identifier_}.items()
):
    residuals = model.residuals(*rows)
    speed = recording.states[tested][residuals.index, 6:12]
    for row, joint in enumerate(joints):
        used = residuals.weight[:, joint] > 0
        axis = axes[row, column]
        axis.plot(speed[used, joint], residuals.residual[used, joint], ".", ms=3)
        axis.axhline(0.0, color="0.6", lw=0.8)
        axis.set_xlabel(f"speed of joint_{joint + 1} [rad/s]")
        axis.set_title(title)
        if column == 0:
            axis.set_ylabel(f"residual of joint_{joint + 1} [N m]")
plt.show()
