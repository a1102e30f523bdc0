"""Virtual parameters of eq. 30.

The virtual parameters of a body are, in the paper's order, the square root of the
mass, the centre of mass and the upper triangular factor ``U`` of the inertia at the
centre of mass, ``I_c = U' U``, row by row: ``(sqrt(m), c_x, c_y, c_z, U_11, U_12, U_13,
U_22, U_23, U_33)``.  Any ten numbers give a positive mass and a positive semidefinite
``I_c``.

The paper calls the minimisation convex. In the virtual parameters it is not: a sign
change of any factor gives the same body. It is convex in the parameters themselves,
and the package solves it there; this module imports nothing from the package.
"""

import numpy as np

# Row and column of Ixx, Ixy, Iyy, Ixz, Iyz, Izz, Pinocchio's order, in the inertia.
_INERTIA_ROW = np.array([0, 0, 1, 0, 1, 2])
_INERTIA_COLUMN = np.array([0, 1, 1, 2, 2, 2])
# Row and column of U_11, U_12, U_13, U_22, U_23, U_33 in U.
FACTOR_ROW = np.array([0, 0, 0, 1, 1, 2])
FACTOR_COLUMN = np.array([0, 1, 2, 1, 2, 2])


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
    virtual[..., 4:] = factor[..., FACTOR_COLUMN, FACTOR_ROW]
    return virtual
