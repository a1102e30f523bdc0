"""
=============================================
Regression with standard errors of the inputs
=============================================

Many tables contain means with standard errors, which ordinary least squares cannot use.
A diagnosis is regressed on three means over cell nuclei, with the standard errors as
input noise.
"""

# %%
# Data
# ----
# Scikit-learn's breast cancer data: 569 images of different patients. An input is the
# mean over the nuclei of an image, and the table has its standard error. The inputs are
# radius, texture and smoothness. The share of noise is the mean squared standard error
# over the variance of the input:

# sphinx_gallery_thumbnail_number = 1
import matplotlib.pyplot as plt
import numpy as np
from sklearn.datasets import load_breast_cancer
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import KFold, cross_val_score

from sklearn_vbjfa import VBJFARegressor

table, benign = load_breast_cancer(return_X_y=True, as_frame=True)
malignant = 1.0 - benign.to_numpy()


def read(*names):
    """Means and their standard errors, both over the spread of the means."""
    means = table[[f"mean {name}" for name in names]].to_numpy()
    errors = table[[f"{name} error" for name in names]].to_numpy()
    return (means - means.mean(axis=0)) / means.std(axis=0), errors / means.std(axis=0)


names = ("radius", "texture", "smoothness")
X, errors = read(*names)
noise = np.mean(errors**2, axis=0)
for name, share in zip(names, noise):
    print(f"{name:10s} {100 * share:3.0f} % of the variance is noise")

# %%
# The noise is assumed to be independent between inputs. Then the covariance of the
# inputs minus that of the noise has no negative eigenvalues. With a fourth input,
# symmetry, it has one, probably because nuclei with a rough outline are also less
# symmetric. Symmetry is therefore excluded:

for chosen in (names, (*names, "symmetry")):
    Z, its_errors = read(*chosen)
    left = np.cov(Z.T) - np.diag(np.mean(its_errors**2, axis=0))
    print(chosen[-1], "smallest eigenvalue:", np.linalg.eigvalsh(left)[0].round(2))

# %%
# Coefficients
# ------------
# A coefficient is the change of the share of malignant images per standard deviation of
# the input. Least squares estimates it for the *measured* mean, and
# ``query="noiseless"`` for the mean over many nuclei.

plain = LinearRegression().fit(X, malignant)
known = VBJFARegressor(input_noise=noise, query="noiseless").fit(X, malignant)
for k, name in enumerate(names):
    print(
        f"{name:10s} least squares {plain.coef_[k]:.3f}, "
        f"VB-JFA {known.coef_[k]:.3f} +- {1.645 * known.coef_std_[k]:.3f}"
    )

# %%
# The coefficient of the radius, with 2 % of noise, hardly changes. That of smoothness,
# with 30 % of noise, is about 40 % larger than by least squares.
#
# Check with fewer nuclei
# -----------------------
# The true coefficients are unknown, but the measurement can be degraded: with half of
# the nuclei the variances of the errors double. Noise is added to each row accordingly.
# A correct method gives the same coefficients.

fewer = np.array([1, 2, 3, 4])
rng = np.random.default_rng(0)
answers = {"least squares": [], "VB-JFA, noise known": []}
for part in fewer:
    drawn = [
        X + np.sqrt(part - 1) * errors * rng.normal(size=X.shape) for _ in range(10)
    ]
    model = VBJFARegressor(input_noise=part * noise, query="noiseless")
    for name, one in zip(answers, (LinearRegression(), model)):
        answers[name].append([one.fit(Z, malignant).coef_ for Z in drawn])

figure, axes = plt.subplots(1, 3, layout="constrained", figsize=(9, 3.2), sharey=True)
for k, axis in enumerate(axes):
    for name, values in answers.items():
        values = np.array(values)[:, :, k]
        axis.errorbar(fewer, values.mean(1), values.std(1), marker="o", label=name)
    axis.set_title(f"{names[k]}, {100 * noise[k]:.0f} % noise")
    axis.set_xlabel("nuclei: one in ...")
    axis.set_xticks(fewer)
axes[0].set_ylabel("coefficient")
axes[0].set_ylim(0.0)
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)

# %%
# With fewer nuclei, the least squares coefficients of texture and smoothness decrease.
# Those of VB-JFA remain nearly the same.
#
# Predictions for equally noisy inputs
# ------------------------------------
# For patients who are measured in the same way, least squares is unbiased, and the
# default ``query="noisy"`` is as good. The coefficients for noiseless inputs predict
# worse from noisy ones:

folds = KFold(10, shuffle=True, random_state=0)
models = {
    "least squares": LinearRegression(),
    "VB-JFA, noisy queries (default)": VBJFARegressor(),
    "VB-JFA, noiseless queries": known,
}
for name, one in models.items():
    error = 1 - cross_val_score(one, X, malignant, cv=folds, scoring="r2").mean()
    print(f"{name:32s} {100 * error:.1f} % of the variance left")

# %%
# The noise matters if new measurements are better than the fitted ones. Here the model
# is fitted with a quarter of the nuclei and predicts from all nuclei. The relevant
# noise is the excess of the fitted rows, three times that of the table.

Z = X + np.sqrt(3) * errors * rng.normal(size=X.shape)
models["VB-JFA, excess noise known"] = VBJFARegressor(
    input_noise=3 * noise, query="noiseless"
)
for name in ("least squares", "VB-JFA, excess noise known"):
    left = []
    for fitted, tested in folds.split(X):
        one = models[name].fit(Z[fitted], malignant[fitted])
        left.append(np.mean((one.predict(X[tested]) - malignant[tested]) ** 2))
    print(f"{name:32s} {100 * np.mean(left) / malignant.var():.1f} %")

plt.show()
