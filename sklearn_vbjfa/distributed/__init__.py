"""Fits to more data than one machine holds, with Dask.

A fit needs only second moments, and those of disjoint rows add up: each worker reduces
what it reads to matrices whose size depends on the number of parameters alone, and the
matrices are merged. Requires Dask (``pip install "dask[array]" distributed``).
"""

from sklearn_vbjfa.distributed._passes import fit_array, fit_recordings, workers

__all__ = ["fit_array", "fit_recordings", "workers"]
