"""Ordinary tables, with no noise of the inputs in mind, against scikit-learn.

Run ``python tests/benchmarks/bench_ordinary_tables.py [--write]``. Sixteen regression
tables, measured ones that come with scikit-learn and synthetic ones: few and many
inputs, sparse and dense coefficients, correlated, redundant and constant columns, fewer
rows than columns. Errors are root mean squares of five-fold cross-validation, folds
shuffled, repeated; each estimator has its defaults behind a StandardScaler, and Ridge
its built-in choice of the penalty.
"""

import warnings

import numpy as np
from _report import parser, publish, rst_table
from sklearn import datasets
from sklearn.linear_model import ARDRegression, BayesianRidge, LassoCV, RidgeCV
from sklearn.model_selection import RepeatedKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_vbjfa import VBJFARegressor

PEERS = {
    "Ridge": lambda: RidgeCV(np.logspace(-3, 3, 13)),
    "BayesianRidge": BayesianRidge,
    "ARD": ARDRegression,
    "LassoCV": LassoCV,
}


def _linear(seed, n, p, used, noise, mixed=0.0):
    """Gaussian inputs, correlated if mixed, of which some matter; relative noise."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, p)) + mixed * rng.normal(size=(n, 1))
    signal = X[:, :used] @ rng.normal(size=used)
    return X, signal + noise * signal.std() * rng.normal(size=n)


def _redundant(seed):
    """Columns that are copies, sums and constants."""
    X, y = _linear(seed, 120, 6, 4, 0.3)
    more = np.column_stack([X[:, :3], X[:, 0] + X[:, 1], np.ones(120)])
    return np.hstack([X, more]), y


def _low_rank(seed):
    """Fifty inputs that five factors drive."""
    rng = np.random.default_rng(seed)
    factors = rng.normal(size=(150, 5))
    X = factors @ rng.normal(size=(5, 50)) + 0.1 * rng.normal(size=(150, 50))
    return X, factors @ rng.normal(size=5) + 0.5 * rng.normal(size=150)


def _cancer():
    X, y = datasets.load_breast_cancer(return_X_y=True)
    return X, y.astype(float)


def _iris():
    X = datasets.load_iris().data
    return X[:, :3], X[:, 3]


def _wine():
    X = datasets.load_wine().data
    return np.delete(X, 0, axis=1), X[:, 0]


def _linnerud():
    found = datasets.load_linnerud()
    return found.data, found.target[:, 1]


def _digits():
    X, y = datasets.load_digits(return_X_y=True)
    return X[:600], y[:600].astype(float)


TABLES = {
    "diabetes": lambda: datasets.load_diabetes(return_X_y=True),
    "breast cancer": _cancer,
    "iris": _iris,
    "wine": _wine,
    "linnerud": _linnerud,
    "digits": _digits,
    "Friedman 1": lambda: datasets.make_friedman1(200, random_state=0),
    "sparse 500 x 10": lambda: _linear(1, 500, 10, 3, 0.5),
    "dense 500 x 10": lambda: _linear(2, 500, 10, 10, 0.5),
    "sparse 100 x 30": lambda: _linear(3, 100, 30, 4, 0.5),
    "dense 100 x 30": lambda: _linear(4, 100, 30, 30, 0.5),
    "correlated 150 x 20": lambda: _linear(5, 150, 20, 10, 0.3, mixed=3.0),
    "redundant 120 x 11": lambda: _redundant(6),
    "low rank 150 x 50": lambda: _low_rank(7),
    "sparse 60 x 50": lambda: _linear(8, 60, 50, 5, 0.1),
    "dense 60 x 50": lambda: _linear(9, 60, 50, 50, 0.1),
}


def error(estimator, X, y, repeats):
    """Root mean square of the held-out errors of a table."""
    folds = RepeatedKFold(n_splits=5, n_repeats=repeats, random_state=0)
    chain = make_pipeline(StandardScaler(), estimator)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        squares = cross_val_score(
            chain, X, y, cv=folds, scoring="neg_mean_squared_error"
        )
    return np.sqrt(-squares.mean())


def compared(names, repeats):
    """One row a table: errors over the smallest of the peers, VB-JFA first."""
    rows = []
    for name in names:
        X, y = TABLES[name]()
        peers = [error(make(), X, y, repeats) for make in PEERS.values()]
        own = error(VBJFARegressor(), X, y, repeats)
        rows.append([name, *(np.array([own, *peers]) / min(peers))])
    return rows


def report(names, repeats):
    """Table of ratios, and their geometric means."""
    rows = compared(names, repeats)
    means = np.exp(np.log([row[1:] for row in rows]).mean(axis=0))
    table = rst_table(
        [
            [name, *(f"{x:.3f}" for x in values)]
            for name, *values in [*rows, ["geometric mean", *means]]
        ],
        ["table", "VB-JFA", *PEERS],
    )
    return (
        "Held-out root mean square error over that of the best of the four others; "
        f"five folds, {repeats} times.\n\n{table}"
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__).parse_args(argv)
    few = ("iris", "linnerud", "redundant 120 x 11")
    names, repeats = (few, 1) if arguments.quick else (tuple(TABLES), 4)
    publish("ordinary_tables", report(names, repeats), arguments)


if __name__ == "__main__":
    main()
