"""
================================================
Look at a fit: noise, coefficients, convergence
================================================

Three displays show what a regression with noisy inputs found, here on data with a known
truth.
"""

# %%
# The data
# --------
# A smaller version of the paper's synthetic problem (section 5.1): six inputs matter,
# and a third of their variance is noise; thirty inputs have nothing to do with the
# output. One fit is given the noise of the inputs, the other is not.

# sphinx_gallery_thumbnail_number = 2
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
# Noise is shown as shares of the variances, since inputs may have any units; with
# `units` it is shown as standard deviations, one panel per unit. Without known noise,
# the regression treats the inputs that it finds irrelevant (one too many here) as
# exact, and gives the others one common share, of which second moments give only an
# upper bound.

figure, axes = plt.subplots(1, 2, figsize=(9, 7.5), layout="constrained")
for axis, model, title in zip(axes, (told, free), ("noise known", "noise estimated")):
    NoiseDisplay.from_estimator(model).plot(axis)
    axis.set_title(title)

# %%
# Coefficients
# ------------
# Coefficients for noiseless queries, with their intervals, and the smaller ones for
# queries as noisy as the data. Inputs that the fit finds irrelevant have hollow
# markers. One of them, x0, does matter: the intervals hold for the chosen inputs and do
# not allow for errors of that choice.

display = ParameterDisplay.from_estimator(told, nominal=true).plot()

# %%
# Coefficients of the inputs that matter, and their errors in standard deviations.

for j in np.flatnonzero(data.relevant):
    error = (told.coef_[j] - true[j]) / told.coef_std_[j]
    print(f"x{j}: {told.coef_[j]: .2f}, true {true[j]: .2f}, {error: .1f} std")

# %%
# Convergence
# -----------
# The lower bound of the variational fit, the likelihood of EM, and the gain per sample
# at which each stops.

em = JFARegressor(input_noise=data.input_noise, query="noiseless").fit(data.X, data.y)
figure, axes = plt.subplots(2, 2, figsize=(9, 5), sharex="col", layout="constrained")
for column, model in zip(axes.T, (told, em)):
    ConvergenceDisplay.from_estimator(model).plot(column)
plt.show()
