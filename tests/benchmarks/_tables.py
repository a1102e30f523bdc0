"""Ordinary regression tables: those that scikit-learn and statsmodels bring along.

Each is a pair (X, y) of numbers with at least 50 rows; `in_time` says that the rows
are times, so that folds have to be blocks. Nothing is downloaded.
"""

import warnings
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Table:
    """A regression problem.

    Attributes
    ----------
    name : str
        Package and data set, with the target.
    X : ndarray of shape (n_samples, n_features)
        Inputs.
    y : ndarray of shape (n_samples,)
        Target.
    in_time : bool
        Whether the rows are in the order of time.
    """

    name: str
    X: np.ndarray
    y: np.ndarray
    in_time: bool


# statsmodels data set: target, columns that are left out (labels of rows, other
# outcomes of the same case), whether rows are times.
_STATSMODELS = {
    "anes96": ("PID", ("popul", "logpopul"), False),
    "cancer": ("cancer", (), False),
    "ccard": ("AVGEXP", (), False),
    "danish_data": ("lrm", ("period",), True),
    "engel": ("foodexp", (), False),
    "fair": ("rate_marriage", (), False),
    "grunfeld": ("invest", ("firm", "year"), False),
    "heart": ("survival", ("censors",), False),
    "interest_inflation": ("R", ("year", "quarter"), True),
    "macrodata": ("realcons", ("year", "quarter"), True),
    "modechoice": ("gc", ("individual", "mode", "choice"), False),
    "randhie": ("mdvis", (), False),
    "star98": ("NABOVE", ("NBELOW",), False),
    "statecrime": ("murder", ("state",), False),
    "strikes": ("duration", (), False),
}
# Series that are predicted from their own past: data set -> column, number of lags.
_SERIES = {"co2": ("co2", 12), "nile": ("volume", 4), "sunspots": ("SUNACTIVITY", 9)}


def sklearn_tables():
    """Regression problems made of scikit-learn's embedded tables."""
    from sklearn import datasets

    X, y = datasets.load_diabetes(return_X_y=True)
    yield Table(name="sklearn diabetes", X=X, y=y, in_time=False)
    for name, target in (
        ("iris", "petal width (cm)"),
        ("wine", "alcohol"),
        ("wine", "proline"),
        ("breast_cancer", "mean fractal dimension"),
    ):
        bunch = getattr(datasets, f"load_{name}")()
        names = list(bunch.feature_names)
        at = names.index(target)
        yield Table(
            name=f"sklearn {name}, {target}",
            X=np.delete(bunch.data, at, axis=1),
            y=bunch.data[:, at],
            in_time=False,
        )


def statsmodels_tables():
    """Regression problems made of the tables of statsmodels."""
    import statsmodels.datasets as datasets

    for name, (target, left_out, in_time) in _STATSMODELS.items():
        frame = getattr(datasets, name).load_pandas().data
        if name == "statecrime":
            frame = frame.reset_index()
        frame = frame.select_dtypes("number").dropna()
        kept = [c for c in frame.columns if c != target and c not in left_out]
        yield Table(
            name=f"statsmodels {name}, {target}",
            X=frame[kept].to_numpy(dtype=float),
            y=frame[target].to_numpy(dtype=float),
            in_time=in_time,
        )
    for name, (column, lags) in _SERIES.items():
        series = getattr(datasets, name).load_pandas().data[column].dropna()
        values = series.to_numpy(dtype=float)
        past = [values[k : values.size - lags + k] for k in range(lags)]
        yield Table(
            name=f"statsmodels {name}, {lags} lags",
            X=np.column_stack(past),
            y=values[lags:],
            in_time=True,
        )


def tables():
    """All tables of 50 rows or more, those of statsmodels where it is installed."""
    found = list(sklearn_tables())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found += statsmodels_tables()
    except ImportError:
        pass
    return [table for table in found if table.y.size >= 50]
