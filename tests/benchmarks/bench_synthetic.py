"""The synthetic study of section 5.1 (Figs. 2 and 3) with rivals and an oracle.

Run ``python tests/benchmarks/bench_synthetic.py [--trials 10] [--write]``. Everything
runs with its defaults. Seeds are 0 .. trials - 1 in every cell; errors are normalised
mean squared errors on 2,000 noiseless test samples, averaged over the trials.
"""

import warnings

import numpy as np
from _report import parser, publish
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import ARDRegression, LassoCV, LinearRegression
from sklearn.model_selection import GridSearchCV

from sklearn_vbjfa import (
    JFARegressor,
    StepwiseRegressor,
    TotalLeastSquares,
    VBJFARegressor,
)
from sklearn_vbjfa.datasets import make_noisy_regression

CELLS = [(snr, r) for snr in (2.0, 5.0) for r in (0, 30, 60, 90)]
OURS = "VB-JFA"
RIVALS = ("OLS", "stepwise", "PLS", "LASSO", "ARD", "TLS", "JFA")


def rivals():
    """Rival name -> estimator, all with defaults (PLS: components by 5-fold CV)."""
    return {
        "OLS": LinearRegression(),
        "stepwise": StepwiseRegressor(),
        "PLS": GridSearchCV(PLSRegression(), {"n_components": [1, 2, 4, 6, 8, 10]}),
        "LASSO": LassoCV(),
        "ARD": ARDRegression(),
        "TLS": TotalLeastSquares(),
        "JFA": JFARegressor(query="noiseless"),
    }


def oracle(data):
    """Correlated-latent VB that knows the ten inputs and the noise variances."""
    model = VBJFARegressor(
        latent="correlated",
        input_noise=np.diag(data.input_noise[data.relevant]),
        query="noiseless",
    )
    model.fit(data.X[:, data.relevant], data.y)
    return model.predict(data.X_test[:, data.relevant])


def nmse(prediction, data):
    """Mean squared error over the variance of the noiseless output."""
    return float(np.mean((prediction - data.y_test) ** 2) / data.y_test.var())


def run_trial(snr, redundant, seed, *, with_rivals=True, n_samples=1000):
    """Return name -> nMSE, and name -> (recall, share of irrelevant inputs kept)."""
    data = make_noisy_regression(
        n_samples,
        n_redundant=redundant,
        n_irrelevant=90 - redundant,
        input_snr=snr,
        random_state=seed,
    )
    models = rivals() if with_rivals else {}
    models[OURS] = VBJFARegressor(query="noiseless")
    models["VB-JFA, noise given"] = VBJFARegressor(
        input_noise=data.input_noise, query="noiseless"
    )
    models["VB-JFA, paper"] = VBJFARegressor(
        latent="independent", prior="paper", query="noiseless"
    )
    models["VB-JFA, independent"] = VBJFARegressor(
        latent="independent", query="noiseless"
    )
    errors, kept = {}, {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, model in models.items():
            model.fit(data.X, data.y)
            errors[name] = nmse(model.predict(data.X_test), data)
            mask = _relevant(model)
            if mask is not None:
                irrelevant = mask[data.irrelevant]
                kept[name] = (
                    float(mask[data.relevant].mean()),
                    float(irrelevant.mean()) if irrelevant.size else 0.0,
                )
    errors["oracle"] = nmse(oracle(data), data)
    return errors, kept


def _relevant(model):
    if hasattr(model, "relevant_"):
        return model.relevant_
    if isinstance(model, (LassoCV, ARDRegression)):
        return model.coef_ != 0
    return getattr(model, "selected_", None)


def run(trials=10, cells=CELLS, **options):
    """Return cell -> name -> array of errors, and the same for relevance."""
    errors, relevance = {}, {}
    for cell in cells:
        results = [run_trial(*cell, seed, **options) for seed in range(trials)]
        names = results[0][0]
        errors[cell] = {n: np.array([e[n] for e, _ in results]) for n in names}
        relevance[cell] = {
            n: np.array([k[n] for _, k in results]) for n in results[0][1]
        }
    return errors, relevance


def tables(errors, relevance):
    """Return the two tables as text."""
    from tabulate import tabulate

    rows = []
    for (snr, r), cell in errors.items():
        mean = {name: values.mean() for name, values in cell.items()}
        best = min(mean[name] for name in RIVALS if name in mean)
        rows.append(
            [
                f"{snr:.0f}",
                f"{r}/{90 - r}",
                *(mean[name] for name in (*RIVALS, OURS) if name in mean),
                mean[OURS] / best,
                mean["VB-JFA, noise given"],
                mean["oracle"],
                mean["VB-JFA, noise given"] / mean["oracle"],
                mean["VB-JFA, independent"],
                mean["VB-JFA, paper"],
            ]
        )
    first = next(iter(errors.values()))
    headers = ["SNR", "r/u", *(n for n in (*RIVALS, OURS) if n in first)]
    headers += ["ratio to best rival", "noise given", "oracle", "ratio to oracle"]
    headers += ["independent", "paper"]
    error_table = tabulate(rows, headers=headers, floatfmt=".3f", tablefmt="rst")
    rows = []
    for (snr, r), cell in relevance.items():
        for name, values in cell.items():
            recall, false_alarm = values.mean(axis=0)
            rows.append([f"{snr:.0f}", f"{r}/{90 - r}", name, recall, false_alarm])
    relevance_table = tabulate(
        rows,
        headers=["SNR", "r/u", "method", "recall", "irrelevant inputs kept"],
        floatfmt=".3f",
        tablefmt="rst",
    )
    return error_table, relevance_table


def main():
    """Run the study from the command line."""
    arguments = parser(__doc__)
    arguments.add_argument("--trials", type=int, default=10)
    arguments = arguments.parse_args()
    errors, relevance = run(arguments.trials)
    error_table, relevance_table = tables(errors, relevance)
    note = (
        f"{arguments.trials} trials, seeds 0 to {arguments.trials - 1}, 1,000 training "
        "samples, 100 inputs. Mean normalised squared error on noiseless test data:"
    )
    publish(
        "synthetic",
        f"{note}\n\n{error_table}\n\nRelevant inputs found:\n\n{relevance_table}",
        write=arguments.write,
    )


if __name__ == "__main__":
    main()
