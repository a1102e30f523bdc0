"""
============================================
Local linear models for a nonlinear function
============================================

Section 6 of the paper suggests locally weighted linear models for nonlinear functions.
They fit a curved surface over two noisy inputs.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import LocallyWeightedRegressor, VBJFARegressor


def surface(t):
    return np.sin(1.5 * t[:, 0]) + 0.5 * t[:, 1] ** 2


# %%
# Both inputs and the output are noisy.
rng = np.random.default_rng(0)
t = rng.uniform(-2, 2, size=(3000, 2))
X = t + 0.15 * rng.normal(size=t.shape)
y = surface(t) + 0.1 * rng.normal(size=3000)

# %%
# A global linear model is compared with 25 local models of two kinds.
models = {
    "global VB-JFA": VBJFARegressor(),
    "25 local least-squares models": LocallyWeightedRegressor(
        LinearRegression(), n_models=25
    ),
    "25 local VB-JFA models": LocallyWeightedRegressor(n_models=25),
}
# %%
# The figure shows a cut through the surface; the error is that on 2,000 noise-free
# points.
line = np.column_stack([np.linspace(-1.8, 1.8, 200), np.full(200, 0.5)])
grid = rng.uniform(-1.8, 1.8, size=(2000, 2))

fig, ax = plt.subplots(layout="constrained")
ax.plot(line[:, 0], surface(line), "k", lw=3, label="truth")
for name, model in models.items():
    model.fit(X, y)
    error = np.mean((model.predict(grid) - surface(grid)) ** 2) / surface(grid).var()
    ax.plot(line[:, 0], model.predict(line), label=f"{name}: nMSE {error:.3f}")
ax.set_xlabel("first input (second input 0.5)")
ax.set_ylabel("output")
ax.legend()
plt.show()
