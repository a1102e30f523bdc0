"""Import of Dask, and merging of what the tasks of a graph return."""

import functools

# Results that are merged in one task: few enough to be in memory together.
_FAN_IN = 8


def import_dask():
    """Import Dask, or say what to install."""
    try:
        import dask
    except ImportError as error:
        raise ImportError(
            "Fits on several machines need Dask: pip install 'sklearn-vbjfa[dask]'."
        ) from error
    return dask


def merge_tree(merge, values):
    """Merge delayed values pairwise, in an order that depends only on their number."""
    dask = import_dask()
    reduce = dask.delayed(functools.partial(_reduce, merge), pure=False)
    while len(values) > 1:
        values = [
            reduce(values[i : i + _FAN_IN]) for i in range(0, len(values), _FAN_IN)
        ]
    return values[0]


def _reduce(merge, values):
    return functools.reduce(merge, values)
