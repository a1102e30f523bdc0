"""
================================================
Look at a fit: noise, coefficients, convergence
================================================

Three displays show what a regression with noisy inputs found, here of data whose truth
is known.
"""

# %%
# The data
# --------
# The synthetic problem of the paper (section 5.1), smaller: six inputs matter, and a
# third of their variance is noise; thirty inputs have nothing to do with the output.
# One fit is told how noisy the inputs are, the other is not.

import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa import JFARegressor, VBJFARegressor
from sklearn_vbjfa.datasets import make_noisy_regression
from sklearn_vbjfa.diagnosis import ConvergenceDisplay, NoiseDisplay, ParameterDisplay

data = make_noisy_regression(
    n_samples=2000, n_relevant=6, n_irrelevant=30, random_state=0
)
true = np.zeros(36)
true[data.relevant] = data.coef
told = VBJFARegressor(input_noise=data.input_noise, query="noiseless").fit(
    data.X, data.y
)
free = VBJFARegressor(query="noiseless").fit(data.X, data.y)
share = data.input_noise / data.X.var(axis=0)
print(f"noise of the first six inputs: {share[:6].round(2)} of their variances")

# %%
# Noise
# -----
# As shares of the variances, since inputs may have any units; with `units` it is shown
# as standard deviations, one panel a unit. Not told, the regression takes the inputs
# that it finds irrelevant for exact, one too many here, and gives the others one common
# share, which second moments bound from above only.

figure, axes = plt.subplots(1, 2, figsize=(9, 7.5), layout="constrained")
for axis, model, title in zip(axes, (told, free), ("noise known", "noise estimated")):
    NoiseDisplay.from_estimator(model).plot(axis)
    axis.set_title(title)

# %%
# Coefficients
# ------------
# For noiseless queries, with their intervals, and for queries as noisy as the data,
# whose sizes are smaller. Inputs that the fit takes for irrelevant are hollow. One of
# them, x0, does matter: its interval is that of the choice of inputs which was made and
# knows nothing of the choice.

display = ParameterDisplay.from_estimator(told, nominal=true).plot()

# %%
# Those of the inputs that matter, and how far they are off in standard deviations.

for j in np.flatnonzero(data.relevant):
    error = (told.coef_[j] - true[j]) / told.coef_std_[j]
    print(f"x{j}: {told.coef_[j]: .2f}, true {true[j]: .2f}, {error: .1f} std")

# %%
# Convergence
# -----------
# The lower bound of the variational fit, the likelihood of EM, and the gain per sample
# at which they stop.

em = JFARegressor(input_noise=data.input_noise, query="noiseless").fit(data.X, data.y)
figure, axes = plt.subplots(2, 2, figsize=(9, 5), sharex="col", layout="constrained")
for column, model in zip(axes.T, (told, em)):
    ConvergenceDisplay.from_estimator(model).plot(column)
plt.show()
