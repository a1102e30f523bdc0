"""
====================================================
Two seconds, coarse encoders: one pipeline, a search
====================================================

Features of the robot, a regressor and the projection onto possible robots make one
scikit-learn pipeline. With little data and coarse encoders the choice among them
matters; blocks of time of the fitted recording make it, and another motion, looked at
once, says what it was worth.
"""

# %%
# The recording
# -------------
# A simulated arm for 2 s at 100 Hz, with encoders that scatter by 5 mrad (0.3 degrees)
# and 5 % of noise in the torques. Its labels are two blocks of one second: the search
# fits one and predicts the other. The other motion, of 10 s, is the same robot's.

import matplotlib.pyplot as plt
import numpy as np
import sklearn
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import Lasso, LinearRegression
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut
from sklearn.pipeline import Pipeline

from sklearn_vbjfa import (
    JointTorqueRegressor,
    PhysicalProjector,
    RigidBodyFeatures,
    StateEstimator,
    VBJFARegressor,
)
from sklearn_vbjfa.datasets import make_robot_recording

noise = {"encoder_noise": 5e-3, "torque_noise": 0.05}
short = make_robot_recording(
    duration=2.0, dt=0.01, frequency=1.0, **noise, random_state=0
)
other = make_robot_recording(
    duration=10.0,
    dt=0.01,
    frequency=1.0,
    inertial=short.inertial,
    friction=short.friction,
    random_state=50,
)
states = StateEstimator(short.dt).fit_transform(short.q)
blocks = np.arange(short.n_samples) // 100

# %%
# The pipeline
# ------------
# Its frames carry the names of the features, from which the projector knows bodies and
# friction. With metadata routing, the labels that choose the folds also keep the blocks
# apart in the low-pass of the regressor, in every fold.

sklearn.set_config(enable_metadata_routing=True)
pipeline = Pipeline(
    [
        ("features", RigidBodyFeatures(short.urdf, friction=("viscous", "coulomb"))),
        ("torque", JointTorqueRegressor(dt=short.dt, cutoff=10.0)),
    ]
).set_output(transform="pandas")

# %%
# The search
# ----------
# Each regressor with its own grid, with and without the projection.

regressors = {
    "least squares": {"torque__regressor": [LinearRegression()]},
    "PLS": {
        "torque__regressor": [PLSRegression()],
        "torque__regressor__n_components": [10, 15, 20, 25, 30],
    },
    "Lasso": {
        "torque__regressor": [Lasso(max_iter=10_000)],
        "torque__regressor__alpha": [1e-4, 3e-4, 1e-3, 3e-3, 1e-2],
    },
    "VB-JFA": {
        "torque__regressor": [VBJFARegressor(latent="correlated", query="noiseless")],
        "torque__regressor__input_noise": [0.0, 1e-3, 1e-2, 1e-1],
    },
}
projectors = {"as fitted": None, "projected": PhysicalProjector()}
searches = {}
for name, grid in regressors.items():
    for kind, projector in projectors.items():
        search = GridSearchCV(
            pipeline,
            {**grid, "torque__projector": [projector]},
            cv=LeaveOneGroupOut(),
        )
        searches[name, kind] = search.fit(states, short.tau, groups=blocks)
chosen = max(searches, key=lambda key: searches[key].best_score_)
sklearn.set_config(enable_metadata_routing=False)

# %%
# The other motion
# ----------------
# As feedforward uses a model: along the motion as planned, compared with the torques
# without noise. Root mean square error over the spread of the torque, mean over the
# joints. The best setting of each search is asked once.

spread = other.tau_clean.std(axis=0)
predicted = {key: search.predict(other.states) for key, search in searches.items()}
errors = {
    key: 100 * np.mean(np.sqrt(np.mean((tau - other.tau_clean) ** 2, axis=0)) / spread)
    for key, tau in predicted.items()
}
print("regressor      projection  R^2 of the blocks  error of the other motion")
for key, search in searches.items():
    mark = "  <- chosen" if key == chosen else ""
    print(
        f"{key[0]:14s} {key[1]:11s} {search.best_score_:17.4f}"
        f" {errors[key]:24.1f} %{mark}"
    )

# %%
# The same at a glance
# --------------------
# Left: what the projection takes from the error of each regressor. Right: the joint on
# which the choice and least squares differ most. The choice is the best here, which is
# luck as well: over twenty robots, the blocks choose projected LASSO on most, while
# projected VB-JFA has the lowest median (``docs/benchmarks.rst``, "One pipeline, a
# search"). What helps nearly always is the projection.

figure, (left, right) = plt.subplots(
    1, 2, figsize=(10, 4), layout="constrained", width_ratios=(2, 3)
)
for row, name in enumerate(reversed(regressors)):
    before, after = (errors[name, kind] for kind in projectors)
    left.plot([before, after], [row, row], color="0.7", lw=3, zorder=0)
    left.scatter(before, row, 110, "white", edgecolors="C0", linewidths=2)
    left.scatter(after, row, 50, "C0")
left.scatter([], [], 110, "white", edgecolors="C0", linewidths=2, label="as fitted")
left.scatter([], [], 50, "C0", label="projected")
row = list(reversed(regressors)).index(chosen[0])
left.scatter(
    errors[chosen], row, 320, "none", edgecolors="C3", linewidths=2, label="chosen"
)
left.set_yticks(range(len(regressors)), list(reversed(regressors)))
left.set_xlim(0, 1.1 * max(errors.values()))
left.set_ylim(-0.5, len(regressors) + 0.4)
left.set_xlabel("error of the other motion [% of the torque's spread]")
left.legend(loc="upper left", ncols=3, columnspacing=1.0, handletextpad=0.3)

plain = predicted["least squares", "as fitted"]
joint = np.argmax(np.mean((plain - predicted[chosen]) ** 2, axis=0) / spread**2)
rows = slice(0, 400)
t = np.arange(400) * other.dt
right.axhline(0.0, color="0.8", lw=1)
for label, tau, colour in (
    ("least squares", plain, "0.6"),
    (f"chosen: {chosen[0]}, {chosen[1]}", predicted[chosen], "C3"),
):
    missed = tau[rows, joint] - other.tau_clean[rows, joint]
    right.plot(t, missed, color=colour, label=label)
right.set_xlabel("time [s]")
right.set_ylabel(f"torque missed on {other.joint_names[joint]} [N m]")
low, high = right.get_ylim()
right.set_ylim(low, high + 0.15 * (high - low))
right.legend(loc="upper right", ncols=2)
plt.show()
