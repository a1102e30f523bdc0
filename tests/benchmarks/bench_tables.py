"""The default estimator on ordinary tables and on a grid of simulated problems.

Run ``python tests/benchmarks/bench_tables.py [--study tables grid robots] [--write]``.

* tables: cross-validated squared error (10 folds; blocks where rows are times, else
  shuffled with seed 0) of ``VBJFARegressor()`` on the tables of scikit-learn and
  statsmodels, over the best of five rivals.
* grid: 10 inputs, 100 to 100,000 rows, correlation 0 to 0.99, SNR 1 to 100, fraction
  of noise in the inputs 0, 0.1 and 0.3; 20 repeats with seeds from `--first-seed`. The
  squared error on new noisy rows over that of the best of least squares, BayesianRidge
  and ARDRegression; and, for noiseless queries, the error against the noiseless truth
  plus the output noise, again over the best of the three.
* robots: the features of the measured robots, then plain ``VBJFARegressor()``, beside
  weighted least squares; splits and filters of ``bench_measured_robots.py``.
"""

import warnings

import numpy as np
from _report import fixed, parser, publish, rst_table, rst_title
from _tables import tables
from sklearn.base import clone
from sklearn.linear_model import (
    ARDRegression,
    BayesianRidge,
    LassoCV,
    LinearRegression,
    RidgeCV,
)
from sklearn.model_selection import KFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_vbjfa import VBJFARegressor

_SEED = 0
_FOLDS = 10
GRID = [
    (n, rho, snr, fraction)
    for n in (100, 1000, 10_000, 100_000)
    for rho in (0.0, 0.5, 0.9, 0.99)
    for snr in (1.0, 10.0, 100.0)
    for fraction in (0.0, 0.1, 0.3)
]
_INPUTS = 10
ALPHAS = np.geomspace(1e-3, 1e4, 15)


def rivals():
    """Rival name -> estimator; those with a penalty see scaled columns."""
    return {
        "OLS": LinearRegression(),
        "RidgeCV": make_pipeline(StandardScaler(), RidgeCV(ALPHAS)),
        "BayesianRidge": make_pipeline(StandardScaler(), BayesianRidge()),
        "ARD": make_pipeline(StandardScaler(), ARDRegression()),
        "LassoCV": make_pipeline(StandardScaler(), LassoCV(max_iter=20_000)),
    }


def table_errors(table, models):
    """Cross-validated mean squared error over the variance of y, by model name."""
    folds = KFold(_FOLDS)
    if not table.in_time:
        folds = KFold(_FOLDS, shuffle=True, random_state=_SEED)
    spread = table.y.var()
    errors = {}
    for name, model in models.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            predicted = cross_val_predict(clone(model), table.X, table.y, cv=folds)
        errors[name] = float(np.mean((predicted - table.y) ** 2) / spread)
    return errors


def tables_study(ours=None):
    """Text of the study of tables, and the ratios to the best rival."""
    ours = VBJFARegressor() if ours is None else ours
    rows, ratios = [], []
    for table in tables():
        errors = table_errors(table, {**rivals(), "VB-JFA": ours})
        best = min(errors[name] for name in rivals())
        ratios.append(errors["VB-JFA"] / best)
        rows.append(
            [
                table.name + (" (blocks)" if table.in_time else ""),
                *table.X.shape,
                *fixed(errors.values(), 4),
                f"{ratios[-1]:.3f}",
            ]
        )
    ratios = np.array(ratios)
    headers = ["data", "rows", "inputs", *rivals(), "VB-JFA", "ratio"]
    text = (
        f"Mean squared error over the variance of y, {_FOLDS} folds, seed {_SEED}. "
        f"Geometric mean of the ratios to the best rival "
        f"{np.exp(np.log(ratios).mean()):.3f}, largest {ratios.max():.3f}, above 1.1 "
        f"on {int((ratios > 1.1).sum())} of {ratios.size} tables.\n\n"
        + rst_table(rows, headers)
    )
    return text, ratios


def draw(n, rho, snr, fraction, seed):
    """Noiseless and noisy inputs, outputs and coefficients of a problem of the grid.

    Latent inputs have unit variance and the correlation `rho` with one another; SNR is
    that of the output; `fraction` is the share of noise in each input's variance.
    """
    rng = np.random.default_rng(seed)
    common = rng.normal(size=(n, 1))
    T = np.sqrt(rho) * common + np.sqrt(1 - rho) * rng.normal(size=(n, _INPUTS))
    return _observe(T, rng, snr, fraction, np.random.default_rng([seed, 1]), rho)


def _observe(T, rng, snr, fraction, weights, rho):
    coef = weights.normal(size=_INPUTS)
    signal = (1 - rho) * coef @ coef + rho * coef.sum() ** 2
    noise = signal / snr
    X = T + np.sqrt(fraction / (1 - fraction)) * rng.normal(size=T.shape)
    y = T @ coef + np.sqrt(noise) * rng.normal(size=T.shape[0])
    return T, X, y, coef, noise


def grid_cell(n, rho, snr, fraction, seeds, n_test=5000):
    """Mean squared errors (noisy queries, noiseless queries) by model name."""
    total = {}
    for seed in seeds:
        T, X, y, coef, noise = draw(n + n_test, rho, snr, fraction, seed)
        train, test = slice(0, n), slice(n, None)
        models = {
            "OLS": LinearRegression(),
            "BayesianRidge": BayesianRidge(),
            "ARD": ARDRegression(),
            "noisy": VBJFARegressor(query="noisy"),
            "noiseless": VBJFARegressor(query="noiseless"),
        }
        for name, model in models.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                model.fit(X[train], y[train])
            on_noisy = np.mean((y[test] - model.predict(X[test])) ** 2)
            truth = T[test] @ coef
            on_clean = np.mean((truth - model.predict(T[test])) ** 2) + noise
            total.setdefault(name, []).append((on_noisy, on_clean))
    return {name: np.mean(values, axis=0) for name, values in total.items()}


def grid_study(first_seed=0, repeats=20, cells=GRID):
    """Text of the grid, and the two ratios of each cell (n_cells, 2)."""
    rows, ratios = [], []
    for cell in cells:
        errors = grid_cell(*cell, range(first_seed, first_seed + repeats))
        best = np.min([errors[k] for k in ("OLS", "BayesianRidge", "ARD")], axis=0)
        ratio = errors["noisy"][0] / best[0], errors["noiseless"][1] / best[1]
        ratios.append(ratio)
        n, rho, snr, fraction = cell
        rows.append([str(n), f"{rho:g}", f"{snr:g}", f"{fraction:g}", *fixed(ratio, 3)])
    ratios = np.array(ratios)
    exact = np.array([cell[3] == 0 for cell in cells])
    lines = [
        f"{_INPUTS} inputs, {repeats} repeats, seeds {first_seed} to "
        f"{first_seed + repeats - 1}. Error of the default over that of the best of "
        "least squares, BayesianRidge and ARDRegression (means over the repeats).",
        f"New noisy rows: mean {ratios[:, 0].mean():.3f}, largest "
        f"{ratios[:, 0].max():.3f}.",
    ]
    for name, chosen in (("no noise", exact), ("noise", ~exact)):
        if chosen.any():
            part = ratios[chosen, 1]
            lines.append(
                f"Noiseless queries where there is {name} in the inputs: mean "
                f"{part.mean():.3f}, largest {part.max():.3f}."
            )
    headers = ["rows", "correlation", "SNR", "noise", "noisy rows", "noiseless"]
    text = "\n\n".join([*lines, rst_table(rows, headers)])
    return text, ratios


def robots_study(data_home, names=None):
    """Text: the features of the measured robots with plain VBJFARegressor()."""
    from bench_measured_robots import load

    from sklearn_vbjfa.datasets import protocols

    names = names or [name for name in protocols() if name != "demo"]
    rows = []
    for name in names:
        _, _, identifier, (train, test) = load(name, data_home)
        errors = []
        for regressor in (LinearRegression(), VBJFARegressor()):
            model = clone(identifier).set_params(regressor=regressor, projector=None)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                model.fit(train[0], train[1], groups=train[2])
                residuals = model.residuals(test[0], test[1], groups=test[2])
            errors.append(100 * float(np.nanmean(residuals.normalised_error())))
        rows.append([name, *fixed(errors, 2), f"{errors[1] / errors[0]:.3f}"])
    headers = ["mean held-out error [%]", "WLS", "VB-JFA", "ratio"]
    return rst_table(rows, headers)


def main(argv=None):
    """Run the studies from the command line."""
    arguments = parser(__doc__.splitlines()[0])
    studies = ("tables", "grid", "robots")
    arguments.add_argument("--study", nargs="*", choices=studies, default=studies)
    arguments.add_argument("--repeats", type=int, default=20)
    arguments.add_argument("--first-seed", type=int, default=0)
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments = arguments.parse_args(argv)
    text = []
    if "tables" in arguments.study:
        text += [rst_title("Tables", "~"), tables_study()[0]]
    if "grid" in arguments.study:
        study = grid_study(arguments.first_seed, arguments.repeats)[0]
        text += [rst_title("Grid", "~"), study]
    if "robots" in arguments.study:
        text += [
            rst_title("Features of measured robots", "~"),
            robots_study(arguments.data_home),
        ]
    publish("tables", "\n\n".join(text), write=arguments.write)


if __name__ == "__main__":
    main()
