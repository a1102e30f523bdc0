"""
==================================================
How much noise is in the inputs: measure it, twice
==================================================

A few dimensions of three hundred castings are measured with a hand gauge, and their
weight on a good scale. What does a millimetre weigh? Noise in the gauge makes
regression answer too little, and no table of single measurements says by how much: all
splits of an input's variance into signal and noise have the same likelihood. Measuring
every casting twice settles it.
"""

# %%
# The data
# --------
# Three dimensions, which vary together as those of castings do, are measured twice. The
# error of the gauge is 0.5 mm; for the two inner dimensions, which are taken from one
# set-up, part of it is common.

import matplotlib.pyplot as plt
import numpy as np
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import VBJFARegressor, replicate_noise

N_UNITS = 300
WEIGHTS = np.array([12.0, 7.0, 5.0])  # [g/mm]
GAUGE = 0.5 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.6, 0.8]])  # [mm]


def measure(seed):
    """Two measurements (2, n, 3) [mm] of each casting, and weights (n,) [g]."""
    rng = np.random.default_rng(seed)
    size = rng.normal(size=(N_UNITS, 1)) + 0.6 * rng.normal(size=(N_UNITS, 3))
    X = size + rng.normal(size=(2, N_UNITS, 3)) @ GAUGE.T
    return X, size @ WEIGHTS + rng.normal(size=N_UNITS)


X, weight = measure(0)
unit = np.tile(np.arange(N_UNITS), 2)
noise = replicate_noise(X.reshape(-1, 3), unit)
print("noise of the gauge [mm^2], with", int(noise.dof), "degrees of freedom")
print(np.asarray(noise).round(2))
print("in truth")
print((GAUGE @ GAUGE.T).round(2))

# %%
# What a millimetre weighs
# ------------------------
# If the noise is unknown, the interval has to cover all that the data permit. If it is
# measured, only the rest remains: the scatter of the castings, and how well 300 pairs
# determine the noise.

models = {
    "least squares": LinearRegression().fit(X[0], weight),
    "noise unknown": VBJFARegressor(query="noiseless").fit(X[0], weight),
    "noise from pairs": VBJFARegressor(input_noise=noise, query="noiseless").fit(
        X[0], weight
    ),
    "pairs averaged": VBJFARegressor(
        input_noise=noise.of_means(2), query="noiseless"
    ).fit(X.mean(axis=0), weight),
}
for name, model in models.items():
    print(f"{name:18s}", model.coef_.round(1), "g/mm")

figure, axis = plt.subplots(layout="constrained", figsize=(8, 3.6))
place = np.arange(3)
for k, (name, model) in enumerate(models.items()):
    deviation = getattr(model, "coef_std_", None)
    width = None if deviation is None else 1.645 * deviation
    axis.errorbar(
        place + 0.15 * (k - 1.5), model.coef_, width, fmt="o", capsize=4, label=name
    )
axis.hlines(WEIGHTS, place - 0.35, place + 0.35, color="black", label="truth")
axis.set_xticks(place, ["length", "inner width", "inner height"])
axis.set_ylabel("weight of a millimetre [g/mm]")
figure.legend(loc="outside right center")

# %%
# Over 200 such sets of castings, the 90 % intervals from the measured noise contain the
# truth as often as they should:

inside = []
for seed in range(200):
    X, weight = measure(seed)
    noise = replicate_noise(X.reshape(-1, 3), unit).of_means(2)
    model = VBJFARegressor(input_noise=noise, query="noiseless")
    model.fit(X.mean(axis=0), weight)
    inside.append(np.abs(model.coef_ - WEIGHTS) < 1.645 * model.coef_std_)
print(f"truth inside: {100 * np.mean(inside):.0f} %")

# %%
# With an exact gauge the pairs agree, the covariance is zero, and the answers for
# noiseless and noisy queries are the same.

exact = replicate_noise(np.vstack([X[0], X[0]]), unit)
model = VBJFARegressor(input_noise=exact).fit(X[0], weight)
print(np.array_equal(model.coef_noiseless_, model.coef_noisy_))
plt.show()
