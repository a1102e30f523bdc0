"""The penalised spline by a sparse design matrix, for the fast one to be held to."""

import numpy as np
from scipy import linalg, sparse
from scipy.interpolate import BSpline

from sklearn_vbjfa._core import _smoothing

DEGREE = ORDER = 5


def smooth(x, dt, cutoff, at=None):
    """Smooth samples (n,), differentiate them twice, (3, m), `at` times (m,) [s]."""
    # cutoff [Hz]: where the gain is one half; infinity interpolates. Times count from
    # the first sample, up to one period outside the recording, and are by default those
    # of the samples.
    n = x.shape[0]
    step, lam = _smoothing.knots_and_penalty(dt, cutoff)
    # In units of the knot distance, with knots beyond both ends.
    u = np.arange(n) / step
    n_intervals = max(1, int(np.ceil(u[-1] - 1e-9)))
    times = u if at is None else np.asarray(at) / (dt * step)
    knots = np.arange(-DEGREE, n_intervals + DEGREE + 1, dtype=float)
    design = BSpline.design_matrix(np.minimum(u, n_intervals), knots, DEGREE).tocsr()
    n_coef = n_intervals + DEGREE
    gram = design.T @ design
    differences = sparse.diags_array(
        [np.full(n_coef - ORDER, c) for c in np.poly(np.ones(ORDER))[::-1]],
        offsets=range(ORDER + 1),
        shape=(n_coef - ORDER, n_coef),
    ).tocsr()
    offset = x.mean()
    bands = _bands(gram + lam * (differences.T @ differences))
    coef = np.zeros(n_coef)
    # Iterative refinement, with residuals of fit and penalty computed separately.
    for _ in range(3):
        left = design.T @ (x - offset - design @ coef)
        left -= lam * (differences.T @ np.diff(coef, ORDER))
        coef += linalg.solveh_banded(bands, left)
    spline = BSpline(knots, coef, DEGREE)
    h = step * dt
    return np.stack(
        [
            spline(times) + offset,
            spline.derivative(1)(times) / h,
            spline.derivative(2)(times) / h**2,
        ]
    )


def _bands(matrix):
    """Upper bands of a sparse matrix."""
    bands = np.zeros((DEGREE + 1, matrix.shape[0]))
    for k in range(DEGREE + 1):
        bands[DEGREE - k, k:] = matrix.diagonal(k)
    return bands
