"""Virtual parameters of eq. 30 and the minimisation of eq. 35 in them.

The virtual parameters of a body are, in the paper's order, the square root of the
mass, the centre of mass and the upper triangular factor ``U`` of the inertia at the
centre of mass, ``I_c = U' U``, row by row: ``(sqrt(m), c_x, c_y, c_z, U_11, U_12, U_13,
U_22, U_23, U_33)``.  Any ten numbers give a positive mass and a positive semidefinite
``I_c``.

The paper calls the minimisation convex with a unique minimum.  In the virtual
parameters it is not: a sign change of any factor gives the same body, so minima come
in pairs with saddle points between them.  It is convex in the parameters themselves,
which is how the package solves it; this module imports nothing from there.

Source: Ting, D'Souza and Schaal, "Bayesian robot system identification with input and
output noise", Neural Networks 24(1), 2011, doi:10.1016/j.neunet.2010.08.011.
"""

import numpy as np
from scipy.optimize import minimize

# Row and column of Ixx, Ixy, Iyy, Ixz, Iyz, Izz, Pinocchio's order, in the inertia.
_INERTIA_ROW = np.array([0, 0, 1, 0, 1, 2])
_INERTIA_COLUMN = np.array([0, 1, 1, 2, 2, 2])
# Place of U_11, U_12, U_13, U_22, U_23, U_33 in U.
_FACTOR_ROW = np.array([0, 0, 0, 1, 1, 2])
_FACTOR_COLUMN = np.array([0, 1, 2, 1, 2, 2])


def inertia_matrix(phi):
    """Inertia (..., 3, 3) about the origin of the body's frame."""
    inertia = np.empty((*phi.shape[:-1], 3, 3))
    inertia[..., _INERTIA_ROW, _INERTIA_COLUMN] = phi[..., 4:]
    inertia[..., _INERTIA_COLUMN, _INERTIA_ROW] = phi[..., 4:]
    return inertia


def inertial_from_virtual(virtual):
    """Inertial parameters (..., 10) of virtual ones, by eq. 30."""
    v = np.moveaxis(np.asarray(virtual, dtype=float), -1, 0)
    # The paper prints theta_1 = theta_1; the lines that follow multiply by the square,
    # and its text calls the first virtual parameter the square root of the mass.
    m = v[0] ** 2
    phi = np.empty(v.shape)
    phi[0] = m  # [eq. 30, line 1]
    phi[1:4] = v[1:4] * m  # [eq. 30, lines 2-4]
    # The paper's order is Ixx Ixy Ixz Iyy Iyz Izz, Pinocchio's Ixx Ixy Iyy Ixz Iyz Izz.
    phi[4] = v[4] ** 2 + (v[3] ** 2 + v[2] ** 2) * m  # [eq. 30, line 5]
    phi[5] = v[4] * v[5] - v[1] * v[2] * m  # [eq. 30, line 6]
    phi[7] = v[4] * v[6] - v[1] * v[3] * m  # [eq. 30, line 7]
    phi[6] = v[5] ** 2 + v[7] ** 2 + (v[1] ** 2 + v[3] ** 2) * m  # [eq. 30, line 8]
    phi[8] = v[5] * v[6] + v[7] * v[8] - v[2] * v[3] * m  # [eq. 30, line 9]
    phi[9] = (
        v[6] ** 2 + v[8] ** 2 + v[9] ** 2 + (v[1] ** 2 + v[2] ** 2) * m
    )  # [eq. 30, line 10]
    return np.moveaxis(phi, 0, -1)


def virtual_from_inertial(phi):
    """Virtual parameters with positive roots of consistent bodies."""
    phi = np.asarray(phi, dtype=float)
    mass = phi[..., 0]
    centre = phi[..., 1:4] / mass[..., None]
    square = np.sum(centre**2, axis=-1)[..., None, None] * np.eye(3)
    outer = centre[..., :, None] * centre[..., None, :]
    inertia = inertia_matrix(phi) - mass[..., None, None] * (square - outer)
    factor = np.linalg.cholesky(inertia)
    virtual = np.empty(phi.shape)
    virtual[..., 0] = np.sqrt(mass)
    virtual[..., 1:4] = centre
    # numpy's lower triangular factor is the transpose of the paper's U.
    virtual[..., 4:] = factor[..., _FACTOR_COLUMN, _FACTOR_ROW]
    return virtual


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
    same_row = _FACTOR_ROW[:, None] == _FACTOR_ROW[None, :]
    curvature[..., 4:, 4:] = np.where(
        same_row, 2 * G[..., _FACTOR_COLUMN[:, None], _FACTOR_COLUMN[None, :]], 0.0
    )
    return curvature


def descend(problem, starts, *, max_steps):
    """Minimise eq. 35 in the virtual parameters of eq. 30 from consistent starts.

    The problem has ``body_columns`` (n_bodies, 10), ``nonnegative`` columns, the
    ``margin`` by which spatial inertias exceed zero, and the functions ``residual`` and
    ``distance`` of a vector, of which the former's derivative is ``root``.
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
