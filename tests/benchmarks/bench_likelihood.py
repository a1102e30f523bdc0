"""How far from the highest likelihood the solvers of `JFARegressor` stop.

Run ``python tests/benchmarks/bench_likelihood.py [--trials 10] [--write]``. Inputs have
a given condition number; the highest likelihood is that of least squares. The input
noise is not identified: the table shows where it ends when it starts at 0.3.
"""

import warnings

import numpy as np
from _report import parser, publish, rst_table
from sklearn.exceptions import ConvergenceWarning

from sklearn_vbjfa import JFARegressor

CONDITIONS = (1e1, 1e2, 1e3, 2e5)
SOLVERS = ("accelerated", "plain")
N_SAMPLES, N_FEATURES, SNR = 1000, 5, 10.0


def make_inputs(condition, seed):
    """Return inputs (n, d) of a condition number, and outputs (n,)."""
    rng = np.random.default_rng([seed, int(condition)])
    U, _ = np.linalg.qr(rng.normal(size=(N_SAMPLES, N_FEATURES)))
    V, _ = np.linalg.qr(rng.normal(size=(N_FEATURES, N_FEATURES)))
    X = np.sqrt(N_SAMPLES) * U * np.geomspace(1.0, 1.0 / condition, N_FEATURES) @ V.T
    signal = X @ rng.normal(size=N_FEATURES)
    noise = np.sqrt(signal.var() / SNR) * rng.normal(size=N_SAMPLES)
    return X, signal + noise


def measure(condition, solver, seed, **options):
    """Return iterations, likelihood left, distance to least squares, end of the noise.

    The likelihood is by sample, the distance relative to the length of the coefficients
    and in standard errors, the noise the smallest and largest share of an input's
    variance.
    """
    X, y = make_inputs(condition, seed)
    with warnings.catch_warnings():
        # Whether it converged is in the table; noise at zero is what is looked at.
        warnings.simplefilter("ignore", ConvergenceWarning)
        warnings.simplefilter("ignore", UserWarning)
        model = JFARegressor(solver=solver, **options).fit(X, y)
    Xc, yc = X - X.mean(axis=0), y - y.mean()
    coef = np.linalg.lstsq(Xc, yc, rcond=None)[0]
    variance = np.mean((yc - Xc @ coef) ** 2)
    top = (np.log(2 * np.pi * Xc.var(axis=0)) + 1).sum()
    top += np.log(2 * np.pi * variance) + 1
    away = model.coef_noisy_ - coef
    share = model.input_noise_ / Xc.var(axis=0)
    return (
        model.n_iter_,
        float(model.converged_),
        -0.5 * top - model.elbo_history_[-1] / N_SAMPLES,
        np.linalg.norm(away) / np.linalg.norm(coef),
        np.sqrt(np.sum((Xc @ away) ** 2) / variance),
        share.min(),
        share.max(),
    )


def report(conditions=CONDITIONS, trials=10):
    """Table of conditions and solvers."""
    rows = []
    for condition in conditions:
        for solver in SOLVERS:
            found = np.array([measure(condition, solver, k) for k in range(trials)])
            rows.append(
                [
                    f"{condition:.0e}",
                    solver,
                    f"{np.median(found[:, 0]):.0f}",
                    f"{found[:, 1].sum():.0f}",
                    # Rounding is on either side.
                    f"{max(found[:, 2].max(), 0.0):.0e}",
                    f"{100 * found[:, 3].max():.2g}",
                    f"{found[:, 4].max():.1g}",
                    f"{found[:, 5].min():.1g} to {found[:, 6].max():.2g}",
                ]
            )
    table = rst_table(
        rows,
        [
            "condition",
            "solver",
            "iterations",
            "converged",
            "likelihood left",
            "from least squares [%]",
            "in standard errors",
            "input noise",
        ],
        n_labels=2,
    )
    return (
        f"{table}\n\n{trials} data sets a row, {N_SAMPLES} samples, {N_FEATURES} "
        f"inputs, signal to noise {SNR:.0f}, seeds from 0, defaults otherwise. "
        "Iterations are "
        "medians; the likelihood left (nats by sample) and the distances of "
        "``coef_noisy_`` from least squares are the largest; the input noise is the "
        "range of its shares of an input's variance, which start at 0.3."
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--trials", type=int, default=10)
    arguments = arguments.parse_args(argv)
    publish("likelihood", report(trials=arguments.trials), write=arguments.write)


if __name__ == "__main__":
    main()
