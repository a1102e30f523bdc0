"""One thread for the linear algebra, only during a projection."""

from contextlib import contextmanager

import pytest
from threadpoolctl import threadpool_info

from sklearn_vbjfa._core._runtime import one_blas_thread
from sklearn_vbjfa.physical import PhysicalProjector, ProjectionError, _solver

FLAT = [2.0, 0, 0, 0, 1, 0, 1, 0, 0, 3]


class Library:
    """A BLAS with one number of threads for the process."""

    def __init__(self):
        self.n_threads = 2
        self.limits = []

    @contextmanager
    def limit(self, *, limits, user_api):
        assert user_api == "blas"
        before, self.n_threads = self.n_threads, limits
        self.limits.append(limits)
        try:
            yield
        finally:
            self.n_threads = before


@pytest.fixture
def library(monkeypatch):
    library = Library()
    monkeypatch.setattr("sklearn_vbjfa._core._runtime._controller", lambda: library)
    return library


def test_projection_limits_threads_and_restores_them(library, monkeypatch):
    projector = PhysicalProjector()
    projector.fit_transform([FLAT])
    assert (set(library.limits), library.n_threads) == ({1}, 2)
    monkeypatch.setattr(_solver, "_MAX_STEPS", 1)
    with pytest.raises(ProjectionError):
        projector.fit_transform([FLAT])
    assert library.n_threads == 2


def test_real_libraries_are_limited():
    def threads():
        return [x["num_threads"] for x in threadpool_info() if x["user_api"] == "blas"]

    with one_blas_thread():
        assert set(threads()) == {1}
