"""Fits to more recordings than the memory of one machine holds, with Dask.

A fit needs only second moments, and those of disjoint rows add up: each worker reduces
the files that it reads to matrices whose size depends on the number of parameters
alone. Requires Dask (``pip install "sklearn-vbjfa[dask]"``).
"""

from sklearn_vbjfa.distributed._passes import fit_recordings

__all__ = ["fit_recordings"]
