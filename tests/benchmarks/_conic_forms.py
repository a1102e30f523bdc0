"""The projection's programme stated in several forms for clarabel alone."""

from unittest import mock

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular

from sklearn_vbjfa.physical import _projection, project

# What clarabel is told beside the form; the later ones include "tight".
_TIGHT = {"tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13, "tol_feas": 1e-13}
_REFINED = {
    **_TIGHT,
    "iterative_refinement_reltol": 1e-15,
    "iterative_refinement_abstol": 1e-15,
    "iterative_refinement_max_iter": 60,
    "iterative_refinement_stop_ratio": 1.2,
}
SETTINGS = {
    "default": {},
    "tight": _TIGHT,
    "refined": _REFINED,
    "no equilibration": {**_REFINED, "equilibrate_enable": False},
    "weak regularisation": {**_REFINED, "static_regularization_constant": 1e-12},
}


class _StatedError(Exception):
    pass


def programme(theta, A, **options):
    """Return the scaled programme of a projection, None for a consistent vector."""
    stated = []

    def keep(given, **_):
        stated.append(given)
        raise _StatedError

    with mock.patch.object(_projection, "solve", keep):
        try:
            project(theta, A, **options)
        except _StatedError:
            return stated[0]
    return None


def _quadratic(T, c, G, h):
    """Minimise 1/2 x'T'Tx - c'Tx: the smallest, and its condition is squared."""
    return T.T @ T, -T.T @ c, G, h, [], lambda x: x


def _residual(T, c, G, h):
    """Minimise 1/2 |r|^2 with r = Tx - c as unknowns of their own."""
    n = len(c)
    P = np.diag(np.r_[np.zeros(n), np.ones(n)])
    A = np.block([[T, -np.eye(n)], [G, np.zeros((len(G), n))]])
    return P, np.zeros(2 * n), A, np.r_[c, h], [clarabel.ZeroConeT(n)], lambda x: x[:n]


def _cone(T, c, G, h):
    """Minimise t with |Tx - c| <= t."""
    n = len(c)
    A = np.zeros((n + 1 + len(G), n + 1))
    A[0, n], A[1 : n + 1, :n], A[n + 1 :, :n] = -1.0, -T, G
    cones = [clarabel.SecondOrderConeT(n + 1)]
    P = np.zeros((n + 1, n + 1))
    return P, np.eye(n + 1)[n], A, np.r_[0.0, -c, h], cones, lambda x: x[:n]


def _rotated(T, c, G, h):
    """Minimise s with |Tx - c|^2 <= 2 s, that is |(Tx - c, s - 1/2)| <= s + 1/2."""
    n = len(c)
    A = np.zeros((n + 2 + len(G), n + 1))
    A[[0, n + 1], n], A[1 : n + 1, :n], A[n + 2 :, :n] = -1.0, -T, G
    cones = [clarabel.SecondOrderConeT(n + 2)]
    b = np.r_[0.5, -c, -0.5, h]
    P = np.zeros((n + 1, n + 1))
    return P, np.eye(n + 1)[n], A, b, cones, lambda x: x[:n]


def _reduced(T, c, G, h):
    """Minimise 1/2 |y|^2 with x = T^-1 (y + c): the metric is the unit matrix."""
    inverse = solve_triangular(T, np.eye(len(c)))
    b = h - G @ (inverse @ c)
    return np.eye(len(c)), 0.0 * c, G @ inverse, b, [], lambda y: inverse @ (y + c)


FORMS = {
    "quadratic form": _quadratic,
    "residual": _residual,
    "cone": _cone,
    "rotated cone": _rotated,
    "reduced": _reduced,
}


def solve(stated, form, settings, scale):
    """Return vector, duals and multipliers of clarabel, distances in units of scale."""
    bodies, kept = stated.body_columns, stated.nonnegative
    size = stated.generators.shape[-1]
    # clarabel stacks the upper triangle by columns, off-diagonal entries times sqrt(2).
    column, row = np.tril_indices(size)
    weight = np.where(row == column, 1.0, np.sqrt(2.0))
    triangle = (stated.generators[:, row, column] * weight).T
    n_bodies, n_entries, n = len(bodies), len(row), stated.n_features
    first_kept = n_bodies * n_entries
    G = np.zeros((first_kept + kept.size, n))
    for k, columns in enumerate(bodies):
        G[k * n_entries : (k + 1) * n_entries, columns] = -triangle
    G[first_kept + np.arange(kept.size), kept] = -1.0
    slack = stated.point[bodies] @ triangle.T - stated.margin * (row == column)
    h = np.r_[slack.ravel(), stated.point[kept]] / scale
    P, q, A, b, cones, unknowns = FORMS[form](stated.root, stated.shift / scale, G, h)
    cones = cones + [clarabel.PSDTriangleConeT(size)] * n_bodies
    cones += [clarabel.NonnegativeConeT(kept.size)] if kept.size else []
    options = clarabel.DefaultSettings()
    options.verbose = False
    for name, value in SETTINGS[settings].items():
        setattr(options, name, value)
    P, A = sparse.csc_matrix(np.triu(P)), sparse.csc_matrix(A)
    answer = clarabel.DefaultSolver(P, q, A, b, cones, options).solve()
    z = scale * np.array(answer.z)[len(b) - len(h) :]
    if form == "cone":
        # Multipliers of a distance, not of half its square.
        z *= answer.x[-1]
    duals = np.zeros((n_bodies, size, size))
    entries = z[:first_kept].reshape(n_bodies, n_entries) / weight
    duals[:, row, column] = duals[:, column, row] = entries
    vector = stated.point + scale * unknowns(np.array(answer.x))
    return vector, duals, z[first_kept:]


def smallest_gap(stated, form, settings):
    """Certified relative gap of the better of two solves, nan without an answer.

    The second measures distances in units of what the first has found.
    """
    scale, gap = stated.distance(stated.clip(2 * stated.margin)), np.nan
    for _ in range(2):
        vector, duals, multipliers = solve(stated, form, settings, scale)
        if not np.isfinite(vector).all():
            break
        vector = stated.lift(vector, stated.margin)
        gap = np.fmin(gap, stated.relative_gap(vector, duals, multipliers))
        scale = max(stated.distance(vector), stated.resolution)
    return gap
