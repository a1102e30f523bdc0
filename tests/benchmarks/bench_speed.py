"""Time and memory of a fit, beside scikit-learn's linear models.

Run as ``python tests/benchmarks/bench_speed.py``. All models see the same array in the
same process; ratios are taken within a round, so that a busy machine slows both sides.
"""

import time
import tracemalloc

import numpy as np
from _report import parser, publish, rst_table
from sklearn.linear_model import ARDRegression, LinearRegression, Ridge

from sklearn_vbjfa import JFARegressor, VBJFARegressor

_SEED = 0
_FACTORS = 20
_RELEVANT = 10


def make_data(n_samples, n_features):
    """Correlated columns: 20 common factors plus noise of half their deviation.

    x = F B + 0.5 E with standard normal F (n, 20), E (n, d) and B (20, d) scaled by
    1 / sqrt(20); y depends on ten columns, with noise of half its deviation.
    """
    rng = np.random.default_rng(_SEED)
    mixing = rng.normal(size=(_FACTORS, n_features)) / np.sqrt(_FACTORS)
    X = rng.normal(size=(n_samples, n_features))
    X *= 0.5
    X += rng.normal(size=(n_samples, _FACTORS)) @ mixing
    coef = np.zeros(n_features)
    chosen = rng.choice(n_features, size=min(_RELEVANT, n_features), replace=False)
    coef[chosen] = rng.normal(size=chosen.size)
    clean = X @ coef
    return X, clean + 0.5 * clean.std() * rng.normal(size=n_samples)


def models():
    """Name -> estimator; the first is the unit of the ratios."""
    return {
        "Ridge (scikit-learn)": Ridge(),
        "LinearRegression (scikit-learn)": LinearRegression(),
        "ARDRegression (scikit-learn)": ARDRegression(),
        "VBJFARegressor()": VBJFARegressor(),
        'VBJFARegressor(latent="correlated", input_noise=0.0)': VBJFARegressor(
            latent="correlated", input_noise=0.0
        ),
        'VBJFARegressor(latent="independent")': VBJFARegressor(latent="independent"),
        'VBJFARegressor(latent="independent", prior="paper")': VBJFARegressor(
            latent="independent", prior="paper"
        ),
        "JFARegressor()": JFARegressor(),
    }


def measure(X, y, rounds):
    """Seconds (rounds, n_models), iterations and peak memory [MB] of every model."""
    chosen = models()
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


def report(n_samples=500_000, n_features=110, rounds=3):
    """Table of all models."""
    X, y = make_data(n_samples, n_features)
    seconds, iterations, memory = measure(X, y, rounds)
    ratio = np.median(seconds / seconds[:, :1], axis=0)
    rows = [
        [
            f"``{name}``",
            f"{np.median(seconds[:, i]):.2f}",
            f"{ratio[i]:.2f}",
            "" if iterations[i] is None else int(np.max(iterations[i])),
            f"{memory[i]:.0f}",
        ]
        for i, name in enumerate(models())
    ]
    table = rst_table(
        rows, ["model", "time [s]", "time / Ridge", "iterations", "peak memory [MB]"]
    )
    return (
        f"{table}\n\n{n_samples} samples, {n_features} columns made of {_FACTORS} "
        f"common factors and noise, {_RELEVANT} of them relevant, seed {_SEED}; the "
        f"array takes {X.nbytes / 2**20:.0f} MB. Times and ratios are medians of "
        f"{rounds} rounds in one process. Peak memory is what a fit allocates through "
        "NumPy beyond the data (tracemalloc)."
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--samples", type=int, default=500_000)
    arguments.add_argument("--features", type=int, default=110)
    arguments = arguments.parse_args(argv)
    text = report(arguments.samples, arguments.features)
    publish("speed", text, write=arguments.write)


if __name__ == "__main__":
    main()
