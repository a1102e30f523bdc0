"""The projection of eq. 35 by descent in the virtual parameters, as a projector."""

from dataclasses import replace
from unittest import mock

import numpy as np
from scipy.optimize import minimize

from sklearn_vbjfa.physical import (
    PhysicalProjector,
    ProjectionError,
    _projection,
    _solver,
)
from tests.reference.virtual_parameters import (
    FACTOR_COLUMN,
    FACTOR_ROW,
    inertia_matrix,
    inertial_from_virtual,
    virtual_from_inertial,
)

# Steps are cheaper and more numerous than those of the interior-point method.
_STEPS = 2000
# Excess of the squared distance up to which an answer is accepted, relative.
_LIMIT = 1e-4


def virtual_jacobian(virtual):
    """Differentiate eq. 30, as (..., 10, 10), by the virtual parameters."""
    virtual = np.asarray(virtual, dtype=float)
    v = np.moveaxis(virtual, -1, 0)
    m = v[0] ** 2
    jacobian = np.zeros((10, 10, *v.shape[1:]))
    x, y, z = v[1], v[2], v[3]
    # Every row is linear in the mass: column 0 is 2 v_0 times the derivative by m.
    by_mass = np.stack(
        [
            np.ones_like(m),
            x,
            y,
            z,
            y**2 + z**2,
            -x * y,
            x**2 + z**2,
            -x * z,
            -y * z,
            x**2 + y**2,
        ]
    )
    jacobian[:, 0] = 2 * v[0] * by_mass
    for axis in range(3):
        jacobian[1 + axis, 1 + axis] = m
    jacobian[4, 2], jacobian[4, 3] = 2 * y * m, 2 * z * m
    jacobian[5, 1], jacobian[5, 2] = -y * m, -x * m
    jacobian[6, 1], jacobian[6, 3] = 2 * x * m, 2 * z * m
    jacobian[7, 1], jacobian[7, 3] = -z * m, -x * m
    jacobian[8, 2], jacobian[8, 3] = -z * m, -y * m
    jacobian[9, 1], jacobian[9, 2] = 2 * x * m, 2 * y * m
    jacobian[4, 4] = 2 * v[4]
    jacobian[5, 4], jacobian[5, 5] = v[5], v[4]
    jacobian[7, 4], jacobian[7, 6] = v[6], v[4]
    jacobian[6, 5], jacobian[6, 7] = 2 * v[5], 2 * v[7]
    jacobian[8, 5], jacobian[8, 6] = v[6], v[5]
    jacobian[8, 7], jacobian[8, 8] = v[8], v[7]
    jacobian[9, 6], jacobian[9, 8], jacobian[9, 9] = 2 * v[6], 2 * v[8], 2 * v[9]
    return np.moveaxis(jacobian, (0, 1), (-2, -1))


def virtual_curvature(virtual, gradient):
    """Second derivative of a gradient times `inertial_from_virtual`.

    With the symmetric matrix G for which the inertia's share of the product is <G, I>,
    and Q = tr(G) E - G, the product is v_0^2 (g_m + g_h' c + c' Q c) + <G, U' U>.
    """
    virtual = np.asarray(virtual, dtype=float)
    gradient = np.asarray(gradient, dtype=float)
    # An off-diagonal parameter stands at two places of I: half its weight at each.
    G = inertia_matrix(gradient) * np.where(np.eye(3) == 1.0, 1.0, 0.5)
    Q = np.trace(G, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - G
    root, centre = virtual[..., 0], virtual[..., 1:4]
    Q_centre = np.einsum("...ij,...j->...i", Q, centre)
    first = gradient[..., 1:4]
    curvature = np.zeros((*virtual.shape, 10))
    curvature[..., 0, 0] = 2 * (
        gradient[..., 0]
        + np.sum(first * centre, axis=-1)
        + np.sum(centre * Q_centre, axis=-1)
    )
    cross = 2 * root[..., None] * (first + 2 * Q_centre)
    curvature[..., 0, 1:4] = cross
    curvature[..., 1:4, 0] = cross
    curvature[..., 1:4, 1:4] = 2 * root[..., None, None] ** 2 * Q
    # <G, U'U> is a sum over the rows of U, each with the same quadratic form.
    same_row = FACTOR_ROW[:, None] == FACTOR_ROW[None, :]
    curvature[..., 4:, 4:] = np.where(
        same_row, 2 * G[..., FACTOR_COLUMN[:, None], FACTOR_COLUMN[None, :]], 0.0
    )
    return curvature


def descend(problem, starts, *, max_steps):
    """Minimise eq. 35 in the virtual parameters of eq. 30 from consistent starts.

    Returned are the best vector, the steps of all starts and the optimiser's message.
    """
    bodies = problem.body_columns
    nonnegative = problem.nonnegative
    # The set {min_eigenvalue >= margin} is the set of eq. 30 moved by the parameters
    # whose spatial inertia is the margin times the unit matrix.
    offset = np.zeros(starts[0].size)
    if bodies.size:
        offset[bodies[:, [0, 4, 6, 9]]] = problem.margin
    scale = problem.distance(starts[0])
    for start in starts[1:]:
        scale = min(scale, problem.distance(start))
    scale = scale if scale > 0 else 1.0

    def to_vector(virtual):
        vector = virtual.copy()
        vector[bodies] = inertial_from_virtual(virtual[bodies])
        vector[nonnegative] = virtual[nonnegative] ** 2  # [eq. 30, line 11]
        return vector + offset

    def jacobian(virtual):
        derivative = np.eye(starts[0].size)
        derivative[bodies[:, :, None], bodies[:, None, :]] = virtual_jacobian(
            virtual[bodies]
        )
        derivative[nonnegative, nonnegative] = 2 * virtual[nonnegative]
        return derivative

    def value(virtual):
        residual = problem.residual(to_vector(virtual)) / scale
        gradient = problem.root.T @ residual / scale
        return 0.5 * residual @ residual, jacobian(virtual).T @ gradient

    def hessian(virtual):
        residual = problem.residual(to_vector(virtual)) / scale
        gradient = problem.root.T @ residual / scale
        linear = problem.root @ jacobian(virtual) / scale
        curvature = linear.T @ linear
        # At the boundary of the set a factor tends to zero and its row of the Jacobian
        # with it: Gauss-Newton stalls there, the full second derivative does not.
        curvature[bodies[:, :, None], bodies[:, None, :]] += virtual_curvature(
            virtual[bodies], gradient[bodies]
        )
        curvature[nonnegative, nonnegative] += 2 * gradient[nonnegative]
        return curvature

    best, n_iter = None, 0
    for start in starts:
        vector = start - offset
        virtual = vector.copy()
        virtual[bodies] = virtual_from_inertial(vector[bodies])
        virtual[nonnegative] = np.sqrt(vector[nonnegative])
        outcome = minimize(
            value,
            virtual,
            jac=True,
            hess=hessian,
            method="trust-exact",
            options={"gtol": 1e-9, "maxiter": max_steps},
        )
        n_iter += int(outcome.nit)
        if best is None or outcome.fun < best.fun:
            best = outcome
    return to_vector(best.x), n_iter, str(best.message)


class DescentProjector(PhysicalProjector):
    """`PhysicalProjector` in the virtual parameters of eq. 30, as the paper does."""

    def transform(self, X):
        """Project every row by descent."""
        with mock.patch.object(_projection, "solve", _solve):
            return super().transform(X)


def _solve(programme):
    """Descend from two consistent vectors and check the end."""
    # Away from the boundary: a factor that is exactly zero has a zero derivative and
    # would stay zero.
    floor = programme.margin + 1e-4
    stricter = _solver.solve(replace(programme, constraint="pseudo-inertia"))
    starts = [programme.lift(stricter.vector, floor), programme.clip(floor)]
    vector, steps, message = descend(programme, starts, max_steps=_STEPS)
    # A stationary point of a problem that is not convex proves nothing.  The convex
    # programme has the same minimum, and its certificate bounds it from below.
    nearest = _solver.solve(programme)
    least = programme.distance(nearest.vector) ** 2 * (1.0 - nearest.gap)
    excess = programme.distance(vector) ** 2 / max(least, np.finfo(float).tiny) - 1.0
    if not excess <= _LIMIT:
        raise ProjectionError(
            "The projection in the virtual parameters of eq. 30 failed: after "
            f"{steps} steps the optimiser reports {message!r}, {excess:.1e} above the "
            "least squared distance (relative)."
        )
    return _solver.CertifiedVector(vector=vector, gap=max(excess, 0.0), status=message)
