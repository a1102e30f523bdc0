"""
============================================
Ting, D'Souza and Schaal (2011): vision head
============================================

Section 5.2 of the paper and the left columns of its Figs. 6 to 8. A vision head with
seven joints is identified while it moves under a low-gain controller. The identified
model then provides feedforward torques for unseen motions.

The robot of the paper is not available. The simulated head differs from its declared
model in inertias, cables, shells, actuators and nonlinear friction. The benchmark
``tests/benchmarks/bench_paper_robots.py`` has longer recordings and more methods.
"""

# %%
# Recording
# ---------
# Six motions of eight seconds with sinusoids in all joints, at 150 Hz (420 Hz in the
# paper).

import warnings

import matplotlib.pyplot as plt
import numpy as np
from paper_robots import make_closed_loop_recording, simulate_tracking
from sklearn.linear_model import LassoCV, RidgeCV
from sklearn.model_selection import KFold

from sklearn_vbjfa import (
    EffectDiscovery,
    PhysicalProjector,
    RobotIdentifier,
    StepwiseRegressor,
)

recording = make_closed_loop_recording(
    "head", duration=8.0, dt=1 / 150, n_recordings=6, random_state=0
)
fit_to = (recording.q, recording.tau, recording.groups)

# %%
# Methods
# -------
# The methods of the paper, each with the projection onto physically consistent
# parameters; the default of `RobotIdentifier`; and the default with the effects that
# `EffectDiscovery` finds.

blocks = KFold(5)
regressors = {
    "ridge": RidgeCV(alphas=np.geomspace(1e-4, 1e4, 17), cv=blocks),
    "stepwise": StepwiseRegressor(),
    "LASSO": LassoCV(cv=blocks, eps=1e-4, max_iter=5000, tol=1e-3),
}


def declared(**settings):
    return RobotIdentifier(
        recording.robot_model(), dt=recording.dt, friction=("viscous",), **settings
    )


models = {}
with warnings.catch_warnings():
    # Convergence of the rivals is part of the study.
    warnings.simplefilter("ignore")
    for name, regressor in regressors.items():
        projector = PhysicalProjector(constraint="eq30")
        model = declared(regressor=regressor, projector=projector, input_noise=None)
        models[name] = model.fit(*fit_to)
    models["VB"] = declared().fit(*fit_to)
    loop = EffectDiscovery(
        declared(), effects=["coulomb", "spring"], random_state=0
    ).fit(*fit_to)
models["VB + effects"] = loop.identifier_
print(loop.report_)

# %%
# Control
# -------
# Each model provides the feedforward torques of the desired motion; the feedback is the
# same.

motion = make_closed_loop_recording(
    "head", duration=1.0, plant=recording.plant, random_state=1001
).motions[0]


def follow(feedforward):
    return simulate_tracking(
        recording.plant,
        motion,
        feedforward,
        duration=8.0,
        dt=1 / 420,
        random_state=0,
    ).averages()


figures = {name: follow(model.predict) for name, model in models.items()}

# %%
# Figures 6, 7 and 8
# ------------------

colors = {"VB": "black", "VB + effects": "tab:green"}
fig, axes = plt.subplots(1, 3, figsize=(9, 2.9), sharey=True, layout="constrained")
labels = ["position error [rad]", "velocity error [rad/s]", "feedback [N m]"]
for k, (ax, label) in enumerate(zip(axes, labels)):
    lengths = np.array([averages[k] for averages in figures.values()])
    bars = ax.barh(
        list(figures),
        np.nan_to_num(lengths),
        color=[colors.get(name, "0.75") for name in figures],
    )
    # A robot that had to be stopped has no bar, as in the paper.
    texts = [f"{x:#.2g}" if np.isfinite(x) else "stopped" for x in lengths]
    ax.bar_label(bars, texts, padding=4)
    ax.set_title(f"Fig. {6 + k}: {label}", fontsize=10)
    ax.set_xticks([])
    ax.margins(x=0.2)
    ax.spines[["top", "right", "bottom"]].set_visible(False)
axes[0].invert_yaxis()
fig.suptitle("What counts is what the model contains", weight="bold")
plt.show()

# %%
# In the paper the Bayesian estimate was 10 to 25 % better than ridge regression. Here
# the methods are equal, because smoothing and low-pass filtering leave little noise in
# the inputs. The missing effects dominate the error, and finding them reduces it.
#
# With states smoothed to 60 Hz and no low-pass filter the default needs a fifth less
# feedback than the other methods.
