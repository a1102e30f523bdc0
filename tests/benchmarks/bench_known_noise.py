"""A table whose inputs have measured standard errors: what knowing them changes.

Run ``python tests/benchmarks/bench_known_noise.py [--draws 20] [--write]``. In
scikit-learn's breast-cancer data each input is the mean over the cell nuclei of one
image, and its standard error stands beside it. The diagnosis (malignant 1, benign 0) is
regressed on radius, texture and smoothness: size, grey levels and outline, whose errors
have little in common.

A truth to compare with does not exist. The check is to lose nuclei: with half of them
the standard errors are larger by the root of two. Noise is added to each row, from the
row's own standard error, and a method that is right answers as with all nuclei.
Held-out errors are of ten folds, rows shuffled; images are of different patients.
"""

import numpy as np
from _report import parser, publish, rst_table
from sklearn.datasets import load_breast_cancer
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import KFold

from sklearn_vbjfa import VBJFARegressor

INPUTS = ("radius", "texture", "smoothness")
FEWER = (1, 2, 4)
NINETY = 1.645


def load():
    """Return inputs, their standard errors (n, 3), over the inputs' spread, y (n,)."""
    data = load_breast_cancer(as_frame=True)
    means = data.data[[f"mean {name}" for name in INPUTS]].to_numpy()
    errors = data.data[[f"{name} error" for name in INPUTS]].to_numpy()
    spread = means.std(axis=0)
    y = 1.0 - data.target.to_numpy()
    return (means - means.mean(axis=0)) / spread, errors / spread, y


def with_fewer(X, errors, fewer, seed):
    """Return inputs as from one in `fewer` of the nuclei."""
    drawn = np.random.default_rng(seed).normal(size=X.shape)
    return X + np.sqrt(fewer - 1.0) * errors * drawn


def least_squares_interval(X, y):
    """Half-widths of the 90 % intervals of least squares (d,)."""
    design = np.column_stack([np.ones(len(y)), X])
    rest = y - LinearRegression().fit(X, y).predict(X)
    scale = rest @ rest / (len(y) - design.shape[1])
    return NINETY * np.sqrt(scale * np.diag(np.linalg.inv(design.T @ design)))[1:]


def coefficients(draws):
    """One row an input and number of nuclei: least squares, VB-JFA, intervals."""
    X, errors, y = load()
    variance = np.mean(errors**2, axis=0)
    rows = []
    for fewer in FEWER:
        found = []
        for seed in range(draws if fewer > 1 else 1):
            Z = with_fewer(X, errors, fewer, seed)
            plain = LinearRegression().fit(Z, y).coef_
            model = VBJFARegressor(input_noise=fewer * variance, query="noiseless")
            model.fit(Z, y)
            half = NINETY * model.coef_std_
            found.append([plain, least_squares_interval(Z, y), model.coef_, half])
        for k, name in enumerate(INPUTS):
            plain, wide, known, half = np.mean(found, axis=0)[:, k]
            share = fewer * variance[k] / (1.0 + (fewer - 1) * variance[k])
            rows.append(
                [
                    name,
                    "all" if fewer == 1 else f"1 in {fewer}",
                    f"{100 * share:.0f}",
                    f"{plain:.3f} ± {wide:.3f}",
                    f"{known:.3f} ± {half:.3f}",
                ]
            )
    rows.sort(key=lambda row: INPUTS.index(row[0]))
    return rows


def held_out(draws):
    """Held-out squared error over the variance of y, one row a task, in per cent."""
    X, errors, y = load()
    tasks = {
        "all, all": (1, False),
        "1 in 4, 1 in 4": (4, False),
        "1 in 4, all": (4, True),
    }
    rows = []
    for label, (fewer, cleaner) in tasks.items():
        found = []
        for seed in range(draws):
            Z = with_fewer(X, errors, fewer, seed)
            asked = X if cleaner else Z
            for fitted, tested in KFold(10, shuffle=True, random_state=seed).split(Z):
                variance = np.mean(errors[fitted] ** 2, axis=0)
                excess = (fewer - 1.0) * variance if cleaner else 0.0 * variance
                models = (
                    LinearRegression(),
                    VBJFARegressor(input_noise=excess, query="noiseless"),
                    VBJFARegressor(input_noise=fewer * variance, query="noiseless"),
                )
                found.append(
                    [
                        np.mean(
                            (
                                m.fit(Z[fitted], y[fitted]).predict(asked[tested])
                                - y[tested]
                            )
                            ** 2
                        )
                        / y.var()
                        for m in models
                    ]
                )
        rows.append([label, *(f"{100 * x:.1f}" for x in np.mean(found, axis=0))])
    return rows


def report(draws=20):
    """Tables of the guide."""
    first = rst_table(
        coefficients(draws),
        ["input", "nuclei", "noise [%]", "least squares", "VB-JFA"],
    )
    second = rst_table(
        held_out(max(1, draws // 4)),
        [
            "fitted, asked",
            "least squares",
            "VB-JFA, excess noise",
            "VB-JFA, all noise",
        ],
    )
    return (
        "Change of the share of malignant images with one standard deviation of the "
        f"input, with 90 % intervals; means of {draws} draws where nuclei were lost.\n"
        f"\n{first}\n\n"
        "Held-out squared error over the variance of the diagnosis [%], ten folds, "
        f"{max(1, draws // 4)} draws. Excess noise: what the fitted rows have more "
        "than those that are asked.\n"
        f"\n{second}"
    )


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__)
    arguments.add_argument("--draws", type=int, default=20)
    arguments = arguments.parse_args(argv)
    publish("known_noise", report(2 if arguments.quick else arguments.draws), arguments)


if __name__ == "__main__":
    main()
