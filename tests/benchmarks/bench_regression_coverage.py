"""How often 90 % intervals of the regressors hold the truth.

Run ``python tests/benchmarks/bench_regression_coverage.py [--trials 200] [--write]``.
Each cell has 200 data sets, seeds from `--first-seed`: six inputs with correlation
0.5, normal coefficients, SNR 1 and 10 of the output, 100 and 1000 rows, inputs exact or
with a fifth of noise. Asked of are, at 1.645 deviations, the coefficients, and new
outputs of 200 further rows by `return_std`.
"""

import warnings

import numpy as np
from _report import fixed, parser, publish, rst_table
from scipy import linalg

from sklearn_vbjfa import VBJFARegressor, replicate_noise

N_FEATURES, RHO, N_TEST, DEVIATIONS = 6, 0.5, 200, 1.645
LATENT = (1 - RHO) * np.eye(N_FEATURES) + RHO
# What is known of the input noise, and the queries that are asked.
KINDS = (
    "noisy queries",
    "noiseless, noise known",
    "noiseless, noise from pairs",
    "noiseless, noise unknown",
)
CELLS = [
    (kind, n, snr, fraction)
    for kind in KINDS
    for n in (100, 1000)
    for snr in (1.0, 10.0)
    for fraction in (0.0, 0.2)
    # Exact inputs that are known to be exact are those of noisy queries.
    if fraction or kind not in KINDS[1:3]
]


def draw(n, snr, fraction, seed):
    """Latent inputs, two measurements, outputs, coefficients, noise variance."""
    rng = np.random.default_rng(seed)
    t = rng.normal(size=(n, N_FEATURES)) @ linalg.cholesky(LATENT)
    coef = rng.normal(size=N_FEATURES)
    deviation = np.sqrt(coef @ LATENT @ coef / snr)
    y = t @ coef + deviation * rng.normal(size=n)
    variance = fraction / (1 - fraction)
    X = t + np.sqrt(variance) * rng.normal(size=(2, *t.shape))
    return t, X, y, coef, variance


def trial(kind, n, snr, fraction, seed):
    """Whether intervals hold the truth (d,), new outputs (m,), and widths (d,)."""
    t, X, y, coef, variance = draw(n + N_TEST, snr, fraction, seed)
    known, query = None, "noiseless"
    if kind == "noisy queries":
        query = "noisy"
        total = LATENT + variance * np.eye(N_FEATURES)
        coef = linalg.solve(total, LATENT @ coef)
    elif kind == "noiseless, noise known":
        known = variance * np.eye(N_FEATURES)
    elif kind == "noiseless, noise from pairs":
        pairs = X[:, :n].reshape(-1, N_FEATURES)
        known = replicate_noise(pairs, np.tile(np.arange(n), 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = VBJFARegressor(input_noise=known, query=query).fit(X[0, :n], y[:n])
    new = X[0, n:] if query == "noisy" else t[n:]
    mean, std = model.predict(new, return_std=True)
    held = np.abs(model.coef_ - coef) < DEVIATIONS * model.coef_std_
    outputs = np.abs(y[n:] - mean) < DEVIATIONS * std
    scale = np.sqrt(np.mean(coef**2))
    return held, outputs, 2 * DEVIATIONS * model.coef_std_ / scale


def study(trials, first_seed=0, cells=CELLS):
    """Rows of the table, and shares (n_cells, 2) of coefficients and outputs."""
    rows, shares = [], []
    for kind, n, snr, fraction in cells:
        seeds = range(first_seed, first_seed + trials)
        found = [trial(kind, n, snr, fraction, seed) for seed in seeds]
        held, outputs, widths = (np.array(x) for x in zip(*found))
        shares.append((held.mean(), outputs.mean()))
        rows.append(
            [
                kind,
                f"{fraction:g}",
                str(n),
                f"{snr:g}",
                *fixed(100 * np.array(shares[-1])),
                *fixed([np.median(widths)], 3),
            ]
        )
    return rows, np.array(shares)


def main(argv=None):
    """Run the study from the command line."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--trials", type=int, default=200)
    arguments.add_argument("--first-seed", type=int, default=0)
    arguments = arguments.parse_args(argv)
    rows, shares = study(arguments.trials, arguments.first_seed)
    identified = np.array([cell[0] != KINDS[3] for cell in CELLS])
    pooled = 100 * shares[identified].mean(axis=0)
    headers = [
        "asked",
        "noise of inputs",
        "rows",
        "SNR",
        "coefficients [%]",
        "new outputs [%]",
        "median width",
    ]
    text = (
        f"{arguments.trials} data sets a cell, seeds from {arguments.first_seed}. "
        "Share of 90 % intervals that hold the truth; widths over the root mean "
        f"square of the coefficients. Pooled without the last eight rows: "
        f"{pooled[0]:.1f} % of the coefficients, {pooled[1]:.1f} % of the outputs.\n\n"
        + rst_table(rows, headers)
    )
    publish("regression_coverage", text, write=arguments.write)


if __name__ == "__main__":
    main()
