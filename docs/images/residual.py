"""Draw the residual of a joint before and after the effect that its model lacked.

Run ``python docs/images/residual.py``; it takes about ten seconds and writes
``residual.png`` beside itself. The recording is the one that comes with the package.
Models are fitted to its first motion, and what is drawn is the second.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sklearn_vbjfa import EffectDiscovery, RigidBodyFeatures, RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording

PICTURE = Path(__file__).with_name("residual.png")
JOINT = 1
FRICTION = ("viscous", "coulomb")
# Told apart by the colour-blind too.
BEFORE, AFTER, LAW = "#b34700", "#0063a3", "#222222"


def identify(recording, rows):
    """Search one motion for what the declared model lacks."""
    declared = RobotIdentifier(recording.urdf, dt=recording.dt, friction=FRICTION)
    loop = EffectDiscovery(declared, random_state=0)
    return loop.fit(recording.q[rows], recording.tau[rows])


def load_of(robot, recording, states):
    """Torques of the identified rigid bodies without friction (n, nv) [N m]."""
    features = RigidBodyFeatures(recording.urdf, friction=FRICTION).fit(states)
    values = dict(zip(robot.parameter_names_, robot.theta_))
    bodies = [
        0.0 if name.endswith(FRICTION) else values[name]
        for name in features.parameter_names_
    ]
    n, nv = states.shape[0], features.n_joints_
    return features.transform(states).reshape(n, nv, -1) @ np.array(bodies)


def draw(recording, loop, rows):
    """Residual over load, without and with the effect, on rows that were not fitted.

    Residuals count in the direction of the motion, so that friction is positive.
    """
    (effect,) = (found for found in loop.effects_ if found.joint == JOINT)
    states = loop.identifier_.state_estimator_.transform(recording.q[rows])
    load = load_of(loop.identifier_, recording, states)[:, JOINT]
    way = np.sign(states[:, len(recording.joint_names) + JOINT])

    figure = Figure(figsize=(7.8, 3.4), facecolor="white", layout="constrained")
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    models = {
        "Before: bodies, viscous and Coulomb friction": (loop.declared_, BEFORE),
        f"After: {effect.effect.label} found": (loop.identifier_, AFTER),
    }
    for axis, (title, (model, colour)) in zip(axes, models.items()):
        found = model.residuals(recording.q[rows], recording.tau[rows])
        used = found.weight[:, JOINT] > 0
        at = found.index[used]
        residual = way[at] * found.residual[used, JOINT]
        axis.plot(load[at], residual, ".", color=colour, ms=4.5, alpha=0.8, mew=0)
        axis.axhline(0.0, color="0.4", lw=0.9)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_xlabel(f"load on {effect.joint_name} [N m]")
        axis.set_title(title, loc="left", fontsize=11, color=colour)
    axes[0].set_ylabel("residual along the motion [N m]")
    mu = effect.parameters["mu"]
    write_law(axes[0], mu, load, taken_up(loop, effect.joint_name))
    return figure


def taken_up(loop, joint):
    """Friction that the declared model has in place of the effect [N m]."""
    declared, completed = (
        dict(zip(model.parameter_names_, model.theta_))[f"{joint}:coulomb"]
        for model in (loop.declared_, loop.identifier_)
    )
    return declared - completed


def write_law(axis, mu, load, constant):
    """Draw the law, less the constant friction that the declared model has for it."""
    ends = np.array([load.min(), 0.0, load.max()])
    axis.plot(ends, mu * np.abs(ends) - constant, "--", color=LAW, lw=1.3)
    axis.annotate(
        f"missing: {mu:.2f} N m\nof friction per N m of load",
        (0.5 * ends[0], 0.5 * mu * abs(ends[0]) - constant),
        (0.2, 0.97),
        textcoords="axes fraction",
        va="top",
        color=LAW,
        arrowprops={"arrowstyle": "-", "color": LAW, "lw": 0.8, "relpos": (0.1, 0)},
    )


def main():
    """Write the picture."""
    recording = load_demo_recording()
    loop = identify(recording, recording.groups == 0)
    draw(recording, loop, recording.groups == 1).savefig(PICTURE, dpi=180)


if __name__ == "__main__":
    main()
