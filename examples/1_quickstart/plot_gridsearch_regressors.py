"""
======================================
Select a regressor by cross-validation
======================================

`RigidBodyFeatures` and `JointTorqueRegressor` are steps of a scikit-learn pipeline, so
`GridSearchCV` can select the regressor. The folds are blocks of time, because
consecutive samples are correlated.
"""

# %%
# States
# ------
# The states are estimated once, before the pipeline.

import matplotlib.pyplot as plt
import numpy as np
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import LassoCV
from sklearn.model_selection import GridSearchCV, KFold
from sklearn.pipeline import Pipeline

from sklearn_vbjfa import (
    JointTorqueRegressor,
    RigidBodyFeatures,
    StateEstimator,
    VBJFARegressor,
)
from sklearn_vbjfa.datasets import make_robot_recording

recording = make_robot_recording(
    duration=6.0, dt=0.01, n_recordings=2, torque_noise=0.1, random_state=0
)
states = StateEstimator(dt=recording.dt).fit_transform(
    recording.q, groups=recording.groups
)
fitted, tested = recording.groups == 0, recording.groups == 1

# %%
# Grid search
# -----------
# LASSO selects its penalty by cross-validation over blocks of time; PLS has a grid of
# components.

pipeline = Pipeline(
    [
        (
            "features",
            RigidBodyFeatures(recording.urdf, friction=("viscous", "coulomb")),
        ),
        ("torque", JointTorqueRegressor()),
    ]
)
grid = [
    {"torque__regressor": [VBJFARegressor(latent="correlated")]},
    {"torque__regressor": [LassoCV(cv=KFold(4), alphas=20, eps=1e-4, max_iter=5000)]},
    {
        "torque__regressor": [PLSRegression(scale=False)],
        "torque__regressor__n_components": [10, 20, 30],
    },
]
search = GridSearchCV(pipeline, grid, cv=KFold(4), scoring="neg_mean_squared_error")
search.fit(states[fitted], recording.tau[fitted])

# %%
# Result
# ------
# Most of the error is noise of the torque sensors. The recording is simulated, so the
# mean square of this noise is known and can be subtracted.

noise = np.mean((recording.tau - recording.tau_clean)[fitted] ** 2)
labels = []
for parameters in search.cv_results_["params"]:
    label = type(parameters["torque__regressor"]).__name__
    components = parameters.get("torque__regressor__n_components")
    labels.append(label if components is None else f"{label}({components})")
mean_square = -search.cv_results_["mean_test_score"]
validated = np.sqrt(np.maximum(mean_square - noise, 0.0))
for label, error in zip(labels, validated):
    print(f"{label:22s} {error:.3f} N m")
print(f"chosen: {labels[search.best_index_]}; torque noise {np.sqrt(noise):.3f} N m")

# %%
# The selected model is tested on the second motion, against the noise-free torque.

difference = search.predict(states[tested]) - recording.tau_clean[tested]
print(f"second motion: {np.sqrt(np.mean(difference**2)):.3f} N m")

# %%
# Comparison
# ----------

figure, axes = plt.subplots(layout="constrained")
axes.barh(labels, validated)
axes.set_xlabel("error on blocks of time without the torque noise [N m]")
plt.show()
