"""Fits to more data than one machine holds, with Dask.

A fit needs second moments only, and those of separate rows add up: each worker reduces
what it reads to matrices of the size of the parameters, and the matrices are merged.
Needs the extra ``sklearn-vbjfa[dask]``.
"""

from sklearn_vbjfa.distributed._arrays import fit_array
from sklearn_vbjfa.distributed._recordings import fit_recordings

__all__ = ["fit_array", "fit_recordings"]
