"""
====================================================
Ting, D'Souza and Schaal (2011): the synthetic study
====================================================

Section 5.1 of the paper: a hundred inputs, ten of them relevant and noisy, the others
redundant (convex combinations of the noisy relevant ones) or irrelevant. Models are
fitted to noisy data and judged on noiseless data, with signal-to-noise ratios of two
(Fig. 2) and five (Fig. 3) in the inputs and five in the output.

All estimators run with their defaults. Two trials per cell keep this page short; the
benchmark ``tests/benchmarks/bench_synthetic.py`` runs ten.
"""

# %%
# Methods
# -------
# The paper's, and also automatic relevance determination and total least squares. The
# oracle knows the ten inputs and the variances of their noise.

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
# Mean squared errors on noiseless test data, over the variance of the output.


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

fig, axes = plt.subplots(2, 1, figsize=(9, 7), sharex=True, layout="constrained")
for ax, snr in zip(axes, (2.0, 5.0)):
    cells = (0, 30, 60, 90)
    means = []
    for redundant in cells:
        trials = [trial(snr, redundant, seed) for seed in range(TRIALS)]
        means.append({name: np.mean([t[name] for t in trials]) for name in trials[0]})
    names = list(means[0])
    width = 0.8 / len(names)
    for k, name in enumerate(names):
        x = np.arange(4) + (k - 0.5 * (len(names) - 1)) * width
        color = {"VB-JFA": "black", "oracle": "tab:green"}.get(name, f"C{k}")
        ax.bar(x, [m[name] for m in means], width, label=name, color=color)
    ax.set_yscale("log")
    ax.set_ylim(5e-3, 1.0)
    ax.set_ylabel("nMSE, noiseless test data")
    ax.set_title(f"Input SNR {snr:.0f}, output SNR 5 (tall bars are cut off)")
    ax.set_xticks(range(4), [f"r = {r}, u = {90 - r}" for r in cells])
axes[0].legend(ncols=5, fontsize="small")
plt.show()

# %%
# With redundant inputs the noise is shared: the default finds the ten inputs that
# generate the rest, drops what does not matter, and subtracts as much noise as the
# second moments allow. The paper's literal model depends on where its iteration starts
# and stops.
