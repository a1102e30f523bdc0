"""Regression on Dask arrays."""

import numpy as np
from sklearn.utils.validation import check_array

from sklearn_vbjfa._core import _moments
from sklearn_vbjfa.distributed._merging import import_dask, merge_tree
from sklearn_vbjfa.regression._base import check_sample_weight
from sklearn_vbjfa.regression._joint_factor import (
    BaseJointFactorRegressor,
    fit_moments,
)


def fit_array(estimator, X, y, sample_weight=None):
    """Fit a joint factor analysis regressor to Dask arrays.

    Each worker reduces its blocks of rows to count, means and scatter. The result is
    that of `fit` on the same rows in memory, up to rounding.

    Parameters
    ----------
    estimator : VBJFARegressor or JFARegressor
        Estimator; it is fitted in place.
    X : dask.array.Array of shape (n_samples, n_features)
        Inputs.
    y : dask.array.Array of shape (n_samples,)
        Output.
    sample_weight : dask.array.Array of shape (n_samples,), default=None
        Weights.

    Returns
    -------
    estimator
        The fitted estimator.

    Raises
    ------
    ImportError
        If Dask is not installed.
    TypeError
        If the estimator needs more than second moments, or an argument is not a Dask
        array.
    ValueError
        If shapes disagree, a value is not finite, or there are fewer than two rows.

    Notes
    -----
    Fewer samples than features are fitted from the scatter matrix here, whereas `fit`
    keeps the rows. The computation runs where Dask is configured to: on the cluster of
    the current `distributed.Client`, otherwise in threads.

    Examples
    --------
    >>> import numpy as np
    >>> import dask.array as da
    >>> from sklearn_vbjfa import JFARegressor
    >>> from sklearn_vbjfa.distributed import fit_array
    >>> rng = np.random.default_rng(0)
    >>> X = rng.normal(size=(1000, 2))
    >>> y = X @ [1.0, -2.0]
    >>> model = JFARegressor(input_noise=0.0)
    >>> blocks = da.from_array(X, chunks=(100, 2)), da.from_array(y, chunks=100)
    >>> fit_array(model, *blocks).coef_.round(6)
    array([ 1., -2.])
    """
    dask = import_dask()
    if not isinstance(estimator, BaseJointFactorRegressor):
        raise TypeError(
            "estimator must be a VBJFARegressor or JFARegressor, for which second "
            f"moments suffice; got {type(estimator).__name__}."
        )
    arrays = {"X": X, "y": y}
    if sample_weight is not None:
        arrays["sample_weight"] = sample_weight
    for name, array in arrays.items():
        if not dask.is_dask_collection(array) or not hasattr(array, "to_delayed"):
            raise TypeError(
                f"{name} must be a Dask array, got {type(array).__name__}; use "
                "dask.array.from_array, or fit for data in memory."
            )
    _check_shapes(arrays)
    estimator._validate_params()
    X = X.rechunk({1: -1}) if X.numblocks[1] > 1 else X
    blocks = [list(X.to_delayed().ravel())]
    for name in list(arrays)[1:]:
        array = arrays[name]
        if array.chunks[0] != X.chunks[0] and not np.isnan(array.chunks[0]).any():
            array = array.rechunk((X.chunks[0],))
        blocks.append(list(array.to_delayed().ravel()))
    if len({len(parts) for parts in blocks}) > 1:
        raise ValueError(
            "Arrays of unknown length must have the same number of blocks; got "
            f"{[len(parts) for parts in blocks]} for {', '.join(arrays)}. Call "
            "compute_chunk_sizes on them."
        )
    block_statistics = dask.delayed(_block_statistics, pure=False)
    total = merge_tree(_merge, [block_statistics(*parts) for parts in zip(*blocks)])
    (total,) = dask.compute(total)
    if total is None or total.n_rows < 2:
        raise ValueError(
            "X must have at least 2 rows that count, got "
            f"{0 if total is None else total.n_rows}."
        )
    return fit_moments(estimator, total)


def _check_shapes(arrays):
    X = arrays["X"]
    if X.ndim != 2:
        raise ValueError(f"X must have two axes, got shape {X.shape}.")
    for name, array in list(arrays.items())[1:]:
        known = not np.isnan([array.shape[0], X.shape[0]]).any()
        if array.ndim != 1 or (known and array.shape[0] != X.shape[0]):
            raise ValueError(
                f"{name} must have the shape {X.shape[:1]}, one value a row of X; got "
                f"{array.shape}."
            )


def _block_statistics(X, y, weight=None):
    """Statistics of one block of rows, None of an empty one."""
    if X.shape[0] == 0:
        return None
    X = check_array(X, dtype=np.float64)
    y = check_array(y, dtype=np.float64, ensure_2d=False)
    if weight is not None:
        # A block may have no weight, but not all of them together.
        if not np.any(weight):
            return None
        weight = check_sample_weight(weight, X)
    return _moments.from_data(X, y, weight)


def _merge(first, second):
    if first is None or second is None:
        return first if second is None else second
    return first + second
