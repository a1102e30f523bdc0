"""
===============================================
Ting, D'Souza and Schaal (2011): synthetic data
===============================================

Section 5.1 of the paper: of a hundred inputs, ten are relevant and noisy; the others
are redundant (convex combinations of noisy relevant inputs) or irrelevant. Models are
fitted to noisy data and tested on noise-free data, with signal-to-noise ratios of two
(Fig. 2) and five (Fig. 3) in the inputs and five in the output. All estimators have
their default parameters; there are two trials per cell.
"""

# %%
# Methods
# -------
# The methods of the paper, automatic relevance determination and total least squares.
# The oracle knows the ten inputs and the variances of their noise.

import warnings

import matplotlib.pyplot as plt
import numpy as np
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import ARDRegression, LassoCV, LinearRegression

from sklearn_vbjfa import (
    JFARegressor,
    StepwiseRegressor,
    TotalLeastSquares,
    VBJFARegressor,
)
from sklearn_vbjfa.datasets import make_noisy_regression

TRIALS = 2


def methods():
    return {
        "OLS": LinearRegression(),
        "stepwise": StepwiseRegressor(),
        "PLS": PLSRegression(10),
        "LASSO": LassoCV(),
        "ARD": ARDRegression(),
        "TLS": TotalLeastSquares(),
        "JFA": JFARegressor(query="noiseless"),
        "VB-JFA, paper": VBJFARegressor(
            latent="independent", prior="paper", query="noiseless"
        ),
        "VB-JFA": VBJFARegressor(query="noiseless"),
    }


# %%
# Mean squared errors on noise-free test data, divided by the variance of the output.


def nmse(prediction, data):
    return np.mean((np.ravel(prediction) - data.y_test) ** 2) / data.y_test.var()


def trial(snr, redundant, seed):
    data = make_noisy_regression(
        n_redundant=redundant,
        n_irrelevant=90 - redundant,
        input_snr=snr,
        random_state=seed,
    )
    errors = {}
    with warnings.catch_warnings():
        # Some rivals do not converge on redundant inputs; that is part of the study.
        warnings.simplefilter("ignore")
        for name, model in methods().items():
            errors[name] = nmse(model.fit(data.X, data.y).predict(data.X_test), data)
        known = VBJFARegressor(
            latent="correlated",
            input_noise=np.diag(data.input_noise[data.relevant]),
            query="noiseless",
        ).fit(data.X[:, data.relevant], data.y)
    errors["oracle"] = nmse(known.predict(data.X_test[:, data.relevant]), data)
    return errors


# %%
# Figures 2 and 3
# ---------------
# The grey band contains the methods that assume exact inputs. Total least squares,
# which assumes equal noise, is outside the scale.

exact = ("OLS", "stepwise", "PLS", "LASSO", "ARD")
drawn = {
    "VB-JFA": {"color": "black", "lw": 3},
    "VB-JFA, paper": {"color": "tab:purple"},
    "JFA": {"color": "tab:orange"},
    "oracle": {"color": "tab:green", "ls": "--"},
}
cells = (0, 30, 60, 90)
fig, axes = plt.subplots(1, 2, figsize=(9.5, 4), sharey=True, layout="constrained")
for ax, snr in zip(axes, (2.0, 5.0)):
    means = []
    for redundant in cells:
        trials = [trial(snr, redundant, seed) for seed in range(TRIALS)]
        means.append({name: np.mean([t[name] for t in trials]) for name in trials[0]})
    print(f"input SNR {snr:.0f}, redundant: {cells}")
    for name in means[0]:
        print(f"  {name:15s}", *(f"{mean[name]:9.3f}" for mean in means))
    rivals = np.array([[mean[name] for name in exact] for mean in means])
    ax.fill_between(cells, rivals.min(axis=1), rivals.max(axis=1), color="0.85")
    for name, style in drawn.items():
        ax.plot(cells, [mean[name] for mean in means], marker="o", label=name, **style)
    ax.set_yscale("log")
    ax.set_yticks([0.01, 0.02, 0.05, 0.1, 0.2], ["0.01", "0.02", "0.05", "0.1", "0.2"])
    ax.minorticks_off()
    ax.set_title(f"input SNR {snr:.0f}")
    ax.set_xlabel("redundant inputs of 90, the others irrelevant")
    ax.set_xticks(cells)
    ax.spines[["top", "right"]].set_visible(False)
# Names beside the last points, kept apart where lines end close to each other.
places = [(line.get_ydata()[-1], line) for line in axes[1].lines]
places += [(np.sqrt(rivals[-1].min() * rivals[-1].max()), None)]
height = 0.0
for value, line in sorted(places, key=lambda place: place[0]):
    height = max(value, 1.18 * height)
    axes[1].text(
        93,
        height,
        "OLS, stepwise,\nPLS, LASSO, ARD" if line is None else line.get_label(),
        color="0.4" if line is None else line.get_color(),
        va="center",
    )
axes[0].set_ylabel("nMSE, noiseless test data")
plt.show()

# %%
# Redundant inputs share their noise. The default finds the ten inputs that generate the
# others, excludes irrelevant ones, and subtracts as much noise as the second moments
# allow. The literal model of the paper depends on its starting point and stopping rule.
