"""
================================================
Ten runs, one motion: what they show of a leg
================================================

Twelve motors of a quadruped that was held in the air, recorded ten times. How well are
the rotor inertias of its legs known, if they come out alike in every run? What of them
is measured, and what is from the description of the robot?
"""

# %%
# The recordings
# --------------
# Motor tests of a Unitree Go2: a chirp on all joints at once, ten runs of 24 s. The
# torque is the commanded one, and acts two samples later. The description holds
# the base level; friction and rotor inertia in it are left out, as they are identified
# here.
#
# The files are not part of the package. The environment variable SKLEARN_VBJFA_DATA
# names the folder that holds them, by default scikit-learn's data folder.

import os
import warnings

import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import fetch_unitree_go2

LEGS = ("FL", "FR", "RL", "RR")  # front and rear, left and right
MOTORS = ("hip", "thigh", "calf")
WAYS = ("free", "prior", "fixed")
LATE = 2  # [samples]


def load():
    """Return (recording, model); None if a file is not here."""
    home = os.environ.get("SKLEARN_VBJFA_DATA")
    try:
        recording = fetch_unitree_go2(data_home=home, download_if_missing=False)
        with warnings.catch_warnings():
            # It says what is left out of the description, as above.
            warnings.simplefilter("ignore")
            return recording, recording.robot_model()
    except OSError:
        print(
            "The recordings are not here: name the folder of unitree_go2 in "
            "SKLEARN_VBJFA_DATA. Shown are the rotor inertias that were found with "
            "them; the other figures are left out."
        )
        return None


found = load()

# %%
# One motion
# ----------
# Ten runs are ten measurements of one motion. Whatever the model lacks comes again in
# each of them, in runs 7 to 9 as in run 0: to fit some runs and to predict the others
# tells how well the robot repeats itself, and nothing of another motion. The search for
# effects finds this in the positions, and its report says it: "Motion that repeats: one
# of 23.9 s, 9.84 times."

if found is not None:
    recording, model = found
    shortest = min(part.stop - part.start for part in recording.segments)
    runs = np.array(
        [recording.q[part.start :][:shortest] for part in recording.segments]
    )
    apart = runs.std(axis=0).mean(axis=0) / runs.mean(axis=0).std(axis=0)
    print(
        f"positions scatter between runs by {100 * apart.min():.1f} to "
        f"{100 * apart.max():.1f} % of the motion"
    )

    t = recording.dt * np.arange(shortest)
    figure, axes = plt.subplots(1, 2, layout="constrained", figsize=(9, 3.2))
    thigh = runs[:, :, 1]
    for k, q in enumerate(thigh):
        colour = plt.cm.viridis(k / 9)
        axes[0].plot(t, q, lw=0.8, color=colour, label=f"run {k}")
        axes[1].plot(t, q - thigh.mean(axis=0), lw=0.6, color=colour)
    axes[0].set_ylabel(f"{recording.joint_names[1]} [rad]")
    axes[1].set_ylabel("less the mean of the runs [rad]")
    for axis in axes:
        axis.set_xlabel("time [s]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")

# %%
# A fit to each run
# -----------------
# Each run alone, with the bodies in three ways: free, which is least squares within
# what is physically possible; near those of the description (``"prior"``, the default);
# and as described (``"fixed"``). Each motor is fitted for itself, ``alike=None``: by
# default those of the four legs have values near each other.


def fit(run, bodies):
    """Identify the robot from one run."""
    part = recording.segments[run]
    robot = RobotIdentifier(
        model,
        dt=recording.dt,
        friction=("viscous", "coulomb", "offset", "rotor_inertia"),
        cutoff=10.0,
        bodies=bodies,
        alike=None,
    )
    q, tau = recording.q[part], recording.tau[part]
    return robot.fit(q[LATE:], tau[:-LATE])


def values(robot, name):
    """Values of a parameter of all joints."""
    own = [x.endswith(f":{name}") for x in robot.parameter_names_]
    return robot.theta_[own]


# Lowest, middle and highest of ten runs [1e-3 kg m^2]: hip, thigh, calf of each leg.
FOUND = """
free  0.0 0.0 36.4 0.0 0.0 39.6 0.0 1.3 32.5 0.0 2.2 36.8
free  0.0 0.0 39.5 0.0 1.4 43.8 0.0 4.6 38.1 0.0 9.7 39.3
free  0.0 0.0 43.3 0.0 17.6 45.6 0.0 6.8 43.7 0.0 14.5 44.7
prior 11.2 14.8 35.8 10.1 13.5 40.0 7.5 10.3 37.1 8.6 15.1 40.3
prior 12.3 16.4 39.2 12.1 15.4 43.2 9.9 13.3 41.2 11.2 16.9 42.8
prior 14.2 17.5 42.3 13.0 17.8 45.3 11.4 15.1 43.5 14.1 18.7 44.4
fixed 11.7 14.9 36.9 8.8 15.6 39.6 13.7 13.9 38.0 7.5 14.9 40.4
fixed 13.6 16.1 40.3 10.8 16.6 42.2 15.2 15.4 41.9 9.8 16.3 42.9
fixed 15.7 17.9 42.6 12.8 18.4 43.7 15.9 17.1 44.6 12.3 17.8 44.2
"""

if found is None:
    rows = [row.split() for row in FOUND.strip().splitlines()]
    rotors = {
        way: np.array([row[1:] for row in rows if row[0] == way], dtype=float)
        for way in WAYS
    }
else:
    robots = {way: [fit(run, way) for run in range(10)] for way in WAYS}
    rotors = {
        way: 1e3 * np.array([values(robot, "rotor_inertia") for robot in own])
        for way, own in robots.items()
    }
    described = sum(body.mass for body in model.inertias[1:])
    print(f"masses of the legs: {described:.2f} kg in the description")
    for way, own in robots.items():
        mass = [values(robot, "m").sum() for robot in own]
        scatter = rotors[way].std(axis=0, ddof=1) / rotors[way].mean(axis=0)
        legs = rotors[way].mean(axis=0).reshape(4, 3)
        legs = legs.std(axis=0, ddof=1) / legs.mean(axis=0)
        print(
            f"{way}: {min(mass):.1f} to {max(mass):.1f} kg; rotor inertias scatter by "
            f"{100 * np.median(scatter):.0f} % between runs (median of the motors), by "
            f"{', '.join(f'{100 * x:.0f}' for x in legs)} % between legs (hip, thigh, "
            "calf)"
        )

print("rotor inertias [1e-3 kg m^2], lowest, middle and highest of the runs")
for way, runs_of in rotors.items():
    for row in np.quantile(runs_of, [0.0, 0.5, 1.0], axis=0):
        print(f"{way:5s}", *(f"{x:.1f}" for x in row))

# %%
# Left free, the legs of 8 kg weigh 29 to 56 kg, the rotors of the hips are nothing at
# all, and those of the thighs anything. The rotor of a hip or a thigh adds to the
# torque what the links add by their inertia about the same axis. Only the sum can be
# measured (``identifiable_`` is false), and where the border of the possible lies
# decides how it is split. The calves are known in all three ways.
#
# With the links near their description the rotors have the rest of the sum, and scatter
# by 8 % in the median. Hips and thighs of the four legs agree to 11 %; the description
# has the same leg four times, so that this is its doing in part. With the links as
# described the runs agree still better, and yet the rotors of the left hips are larger
# than those of the right ones, by 30 and 56 %: to repeat is not to be right.

figure, axes = plt.subplots(1, 3, sharey=True, layout="constrained", figsize=(9, 3.6))
for axis, way in zip(axes, WAYS):
    for place in range(len(MOTORS)):
        for leg, name in enumerate(LEGS):
            x, own = place + 0.18 * (leg - 1.5), rotors[way][:, 3 * leg + place]
            axis.vlines(x, own.min(), own.max(), color=f"C{leg}", lw=1.0)
            axis.plot(
                np.full(own.size, x),
                own,
                "o",
                ms=4,
                alpha=0.6,
                color=f"C{leg}",
                label=name if place == 0 else None,
            )
    axis.set_title(f'bodies="{way}"')
    axis.set_xticks(range(3), MOTORS)
axes[0].set_ylabel("rotor inertia [$10^{-3}$ kg m$^2$]")
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")

# %%
# From the description, and from the torques
# ------------------------------------------
# ``theta_prior_std_`` is the standard deviation by the description alone,
# ``theta_std_`` that after the fit. How far a description is off is not known before:
# each body has a scale of its own, which the torques decide. The picture is what they
# took away of the variance, the mean of the runs. Where that is less than half, the
# value is the description's more than a measured one (``from_description_``; a cross
# where most runs say so).

if found is not None:
    own = robots["prior"]
    before = np.array([robot.theta_prior_std_ for robot in own])
    after = np.array([robot.theta_std_ for robot in own])
    learned = np.clip(1.0 - (after / before) ** 2, 0.0, 1.0).mean(axis=0)
    taken = np.mean([robot.from_description_ for robot in own], axis=0)
    names = own[0].parameter_names_[:10]

    figure, axis = plt.subplots(layout="constrained", figsize=(7, 4.6))
    # Ten parameters of a body come first, then those of the joint.
    learned, taken = (x.reshape(12, -1)[:, :10] for x in (learned, taken))
    image = axis.imshow(
        100 * learned, vmin=0.0, vmax=100.0, cmap="Blues", aspect="auto"
    )
    body, parameter = np.nonzero(taken > 0.5)
    axis.plot(parameter, body, "x", color="C3")
    axis.set_xticks(range(10), [name.partition(":")[2] for name in names])
    axis.set_yticks(range(12), [f"{leg} {motor}" for leg in LEGS for motor in MOTORS])
    figure.colorbar(image, label="learned from the torques [%]")

    sizes = [robot.common_size_ for robot in own]
    departures = sum(len(robot.mass_deviations_) for robot in own)
    print(f"all bodies {min(sizes):.2f} to {max(sizes):.2f} times as heavy")
    print(f"bodies of another mass than described, in ten runs: {departures}")

# %%
# All bodies together are as heavy as described, to 10 % (``common_size_``), and no body
# is named as another one than described (``mass_deviations_`` is empty in each run).
# Masses and most inertias of the hips are the description's: the torques do not depend
# on them, or only on their sums with others. On the thighs and the front calves the
# torques ask for so much else that the description hardly counts; on the rear calves it
# does. Each body decides by itself, so that legs that are alike are not treated alike
# (``alike="auto"``, the default, does so with their motors).
#
# What this does not show
# -----------------------
# That runs agree says nothing of what they have in common: a torque that is commanded
# and not measured, a base that may not be level, whatever the model lacks, and the
# description. The rotor of a hip is as right as the link that was described. And there
# is no other motion in these recordings on which the models could be judged; ``design``
# makes one.

plt.show()
