"""Time and memory of a fit, beside scikit-learn's linear models.

Run as ``python tests/benchmarks/bench_speed.py``. All models see the same array in the
same process; ratios are taken within a round, so that a busy machine slows both sides.
A second array has five times as many columns as rows, a third table holds the figures
against the targets.
"""

import time
import tracemalloc

import numpy as np
from _growth_problems import FACTORS, RELEVANT, SEED, LinearProblem
from _report import parser, publish, rst_table, rst_title
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import (
    ARDRegression,
    BayesianRidge,
    LassoCV,
    LinearRegression,
    Ridge,
)

from sklearn_vbjfa import JFARegressor, VBJFARegressor

OURS = "VBJFARegressor()"
RIDGE = "Ridge (scikit-learn)"
LEAST_SQUARES = "LinearRegression (scikit-learn)"
ARD = "ARDRegression (scikit-learn)"
LASSO = "LassoCV (scikit-learn)"
# Ratio of times in the first table -> the two models, bound, whether a lower one.
TARGETS = {
    "VB-JFA / Ridge": ((OURS, RIDGE), 1.3, False),
    "LinearRegression / VB-JFA": ((LEAST_SQUARES, OURS), 8.0, True),
    "ARDRegression / VB-JFA": ((ARD, OURS), 8.0, True),
    "LassoCV / VB-JFA": ((LASSO, OURS), 40.0, True),
}
# More columns than rows: VB-JFA faster than ARDRegression, and below this memory.
WIDE_MEGABYTES = 4096.0


def make_data(n_samples, n_features):
    """Return X and y of `LinearProblem` with exact columns."""
    return LinearProblem(n_samples, n_features).arrays()


def models():
    """Name -> estimator; the first is the unit of the ratios."""
    return {
        RIDGE: Ridge(),
        LEAST_SQUARES: LinearRegression(),
        "BayesianRidge (scikit-learn)": BayesianRidge(),
        ARD: ARDRegression(),
        LASSO: LassoCV(),
        "PLSRegression (scikit-learn)": PLSRegression(),
        OURS: VBJFARegressor(),
        'VBJFARegressor(latent="correlated", input_noise=0.0)': VBJFARegressor(
            latent="correlated", input_noise=0.0
        ),
        'VBJFARegressor(latent="independent")': VBJFARegressor(latent="independent"),
        'VBJFARegressor(latent="independent", prior="paper")': VBJFARegressor(
            latent="independent", prior="paper"
        ),
        "JFARegressor()": JFARegressor(),
    }


def wide_models():
    """Name -> estimator for more columns than rows."""
    names = (RIDGE, LEAST_SQUARES, ARD, LASSO, OURS)
    return {name: models()[name] for name in names}


def measure(X, y, rounds, chosen):
    """Seconds (rounds, n_models), iterations and peak memory [MB] of every model."""
    seconds = np.empty((rounds, len(chosen)))
    iterations, memory = [], []
    for k in range(rounds):
        for i, model in enumerate(chosen.values()):
            started = time.perf_counter()
            model.fit(X, y)
            seconds[k, i] = time.perf_counter() - started
    for model in chosen.values():
        iterations.append(getattr(model, "n_iter_", None))
        tracemalloc.start()
        model.fit(X, y)
        memory.append(tracemalloc.get_traced_memory()[1] / 2**20)
        tracemalloc.stop()
    return seconds, iterations, memory


def model_table(chosen, seconds, iterations, memory):
    """Table of all models on one array."""
    ratio = np.median(seconds / seconds[:, :1], axis=0)
    rows = [
        [
            f"``{name}``",
            f"{np.median(seconds[:, i]):.2f}",
            f"{ratio[i]:.2f}",
            "" if iterations[i] is None else int(np.max(iterations[i])),
            f"{memory[i]:.0f}",
        ]
        for i, name in enumerate(chosen)
    ]
    return rst_table(
        rows, ["model", "time [s]", "time / Ridge", "iterations", "peak memory [MB]"]
    )


def met(value, bound, at_least):
    """Cells of a target: what was asked, and whether it was met."""
    reached = value >= bound if at_least else value <= bound
    asked = f"{'>=' if at_least else '<='} {bound:g}"
    return asked, "yes" if reached else "no"


def target_table(seconds, wide_seconds, wide_memory):
    """Ratios of times, and memory, against their targets."""
    names, wide_names = list(models()), list(wide_models())
    rows = []
    for what, (pair, bound, at_least) in TARGETS.items():
        slow, fast = (seconds[:, names.index(name)] for name in pair)
        value = np.median(slow / fast)
        rows.append([f"{what}, time", f"{value:.2f}", *met(value, bound, at_least)])
    ours, ard = wide_names.index(OURS), wide_names.index(ARD)
    value = np.median(wide_seconds[:, ard] / wide_seconds[:, ours])
    wide = "ARDRegression / VB-JFA, more columns than rows, time"
    rows.append([wide, f"{value:.2f}", *met(value, 1.0, True)])
    value = wide_memory[ours]
    wide = "VB-JFA, more columns than rows, peak memory [MB]"
    rows.append([wide, f"{value:.0f}", *met(value, WIDE_MEGABYTES, False)])
    return rst_table(rows, ["figure", "measured", "target", "met"])


def describe(X, rounds):
    """Return the size of an array and how its times were taken."""
    times = f"medians of {rounds} rounds" if rounds > 1 else "those of one fit"
    return (
        f"{X.shape[0]} samples, {X.shape[1]} columns made of {FACTORS} common factors "
        f"and noise, {RELEVANT} of them relevant, seed {SEED}; the array takes "
        f"{X.nbytes / 2**20:.0f} MB. Times and ratios are {times} in one process."
    )


def report(
    n_samples=500_000, n_features=110, rounds=3, wide=(1_000, 5_000), wide_rounds=1
):
    """Tables of all models, of the wide array and of the targets."""
    X, y = make_data(n_samples, n_features)
    tall = measure(X, y, rounds, models())
    tall_text = describe(X, rounds)
    X, y = make_data(*wide)
    broad = measure(X, y, wide_rounds, wide_models())
    return "\n\n".join(
        [
            model_table(models(), *tall),
            f"{tall_text} Peak memory is what a fit allocates through NumPy beyond the "
            "data (tracemalloc).",
            rst_title("More columns than rows", "~"),
            model_table(wide_models(), *broad),
            describe(X, wide_rounds),
            rst_title("Targets", "~"),
            target_table(tall[0], broad[0], broad[2]),
        ]
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--samples", type=int, default=500_000)
    arguments.add_argument("--features", type=int, default=110)
    arguments.add_argument("--rounds", type=int, default=3)
    arguments.add_argument("--wide-rounds", type=int, default=1)
    arguments = arguments.parse_args(argv)
    text = report(
        arguments.samples,
        arguments.features,
        arguments.rounds,
        wide_rounds=arguments.wide_rounds,
    )
    publish("speed", text, write=arguments.write)


if __name__ == "__main__":
    main()
