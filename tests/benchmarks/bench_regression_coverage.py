"""How often 90 % intervals of the regressors hold the truth.

Run ``python tests/benchmarks/bench_regression_coverage.py [--trials 200] [--write]``.
Each cell has 200 data sets, seeds from `--first-seed`: six inputs with correlation
0.5, normal coefficients, SNR 1 and 10 of the output, 100 and 1000 rows, inputs exact or
with a fifth of noise. Asked of are, at 1.645 deviations, the coefficients, and new
outputs of 200 further rows by `return_std`.

The second table is harder: eight inputs in units of 0.1 to 10, two with correlation
0.95 and coefficients of opposite signs, three with correlation 0.5, three alone, three
coefficients zero. Its share of coefficients is of those that are not zero. It has half
as many data sets a cell, seeds from 100 on; those below served to choose the intervals.
"""

import warnings

import numpy as np
from _report import fixed, parser, publish, rst_table
from scipy import linalg, signal

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

# The second table: coefficients and correlations of latent inputs of unit variance, ...
BLOCK_COEF = np.array([1.0, -0.5, 0.7, 0.0, -1.0, 0.0, 0.8, 0.0])
BLOCK_UNIT = np.geomspace(0.1, 10, 8)
BLOCK_LATENT = linalg.block_diag(
    [[1.0, 0.95], [0.95, 1.0]], 0.5 * (np.eye(3) + 1), np.eye(3)
)
BLOCK_KINDS = (KINDS[0], KINDS[1], KINDS[3])
# ... and the variance of what is added to each. With "rows" it follows the first input,
# as that of the output; "AR(0.9)" are latent inputs and the noise of the output.
BLOCK_NOISE = {
    "0": 0.0,
    "0.15": 0.15,
    "0.05 to 0.25": np.array([0.15, 0.05, 0.25, 0.15, 0.05, 0.25, 0.15, 0.05]),
    "0.15, rows": 0.15,
    "0.15, AR(0.9)": 0.15,
}
BLOCK_CELLS = [
    (noise, n, snr)
    for noise in BLOCK_NOISE
    for n, snr in ((80, 3.0), (80, 30.0), (600, 3.0), (600, 30.0), (5000, 30.0))
    if n < 5000 or noise == "0.15"
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


def draw_blocks(noise, n, snr, seed):
    """Latent inputs, measured ones, outputs, coefficients, noise variances."""
    # A generator of its own: no row is one of the first table.
    rng = np.random.default_rng([seed, 1])
    z, ex, ey = (rng.normal(size=size) for size in ((n, 8), (n, 8), n))
    variance = BLOCK_NOISE[noise] * np.ones(8)
    if noise.endswith("AR(0.9)"):
        both = np.column_stack([z, ey])
        both[1:] *= np.sqrt(1 - 0.9**2)  # stationary from the first row on
        both = signal.lfilter([1.0], [1.0, -0.9], both, axis=0)
        z, ey = both[:, :8], both[:, 8]
    t = z @ linalg.cholesky(BLOCK_LATENT)
    if noise.endswith("rows"):
        size = np.sqrt(0.5 * (1 + t[:, 0] ** 2))
        ex, ey = ex * size[:, None], ey * size
    deviation = np.sqrt(BLOCK_COEF @ BLOCK_LATENT @ BLOCK_COEF / snr)
    y = t @ BLOCK_COEF + deviation * ey
    X = t + np.sqrt(variance) * ex
    unit = BLOCK_UNIT
    return t * unit, X * unit, y, BLOCK_COEF / unit, variance * unit**2


def trial_blocks(kind, noise, n, snr, seed):
    """Whether intervals hold the coefficients (5,), outputs (m,), and widths of both.

    Widths are in standardised units; coefficients are those that are not zero.
    """
    t, X, y, coef, variance = draw_blocks(noise, n + N_TEST, snr, seed)
    nonzero = coef != 0
    known, query, new = None, "noiseless", t[n:]
    if kind == KINDS[0]:
        query, new = "noisy", X[n:]
        latent = BLOCK_LATENT * np.outer(BLOCK_UNIT, BLOCK_UNIT)
        coef = linalg.solve(latent + np.diag(variance), latent @ coef)
    elif kind == KINDS[1]:
        known = np.diag(variance)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = VBJFARegressor(input_noise=known, query=query).fit(X[:n], y[:n])
    mean, std = model.predict(new, return_std=True)
    held = np.abs(model.coef_ - coef) < DEVIATIONS * model.coef_std_
    outputs = np.abs(y[n:] - mean) < DEVIATIONS * std
    widths = 2 * DEVIATIONS * model.coef_std_ * BLOCK_UNIT
    return held[nonzero], outputs, widths[nonzero], 2 * DEVIATIONS * std


def study_blocks(trials, first_seed=0, cells=BLOCK_CELLS):
    """Rows of the second table, and shares (n_cells, 3 kinds, 2)."""
    rows, shares = [], []
    for cell in cells:
        found = {
            kind: [
                trial_blocks(kind, *cell, seed)
                for seed in range(first_seed, first_seed + trials)
            ]
            for kind in BLOCK_KINDS
        }
        held = {  # one share for each data set
            kind: np.array([[np.mean(one[0]), np.mean(one[1])] for one in trials_])
            for kind, trials_ in found.items()
        }
        known, unknown = (
            [np.median([one[k] for one in found[kind]]) for k in (2, 3)]
            for kind in BLOCK_KINDS[1:]
        )
        shares.append([held[kind].mean(axis=0) for kind in BLOCK_KINDS])
        rows.append(
            [
                cell[0],
                *(f"{value:g}" for value in cell[1:]),
                *(
                    " ± ".join(fixed([100 * mean, 100 * error]))
                    for kind in BLOCK_KINDS
                    for mean, error in zip(
                        held[kind].mean(axis=0),
                        held[kind].std(axis=0) / np.sqrt(trials),
                    )
                ),
                *fixed(np.divide(unknown, known), 2),
            ]
        )
    return rows, np.array(shares)


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


def second_table(trials, first_seed):
    """Text of the second table."""
    rows, _ = study_blocks(trials, first_seed)
    headers = ["noise of inputs", "rows", "SNR"]
    for kind in ("noisy", "known", "unknown"):
        headers += [f"{kind}: coef. [%]", "outputs [%]"]
    headers += ["widths unknown / known: coef.", "outputs"]
    return (
        f"\n\nEight inputs, two of them with correlation 0.95, {trials} data sets a "
        f"cell, seeds from {first_seed}: share of the 90 % intervals that hold the "
        "coefficients that are not zero, and new outputs, with the standard errors of "
        "the data sets, for noisy queries, and for noiseless ones with known and "
        "unknown noise; and the median widths with unknown noise over those with known "
        "noise.\n\n" + rst_table(rows, headers)
    )


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
        + second_table(max(arguments.trials // 2, 1), arguments.first_seed + 100)
    )
    publish("regression_coverage", text, write=arguments.write)


if __name__ == "__main__":
    main()
