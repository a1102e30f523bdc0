"""Inertial parameters as matrices, and when a rigid body exists that has them.

The ten parameters of a body stand in Pinocchio's order, (m, m c_x, m c_y, m c_z, I_xx,
I_xy, I_yy, I_xz, I_yz, I_zz), with the inertia about the origin of the joint's frame.
Functions are batched over the leading axes. Source: Wensing, Kim and Slotine, "Linear
Matrix Inequalities for Physically Consistent Inertial Parameter Identification", IEEE
RA-L 3(1), 2018 [WKS2018]_.
"""

import numpy as np

# A body's parameters in Pinocchio's order, as columns and reports name them.
INERTIAL_NAMES = tuple("m mc_x mc_y mc_z I_xx I_xy I_yy I_xz I_yz I_zz".split())
N_INERTIAL = len(INERTIAL_NAMES)
CONSTRAINTS = ("pseudo-inertia", "eq30")

# Row and column of each of the six inertia parameters, in Pinocchio's order.
_INERTIA_ROW = np.array([0, 0, 1, 0, 1, 2])
_INERTIA_COLUMN = np.array([0, 1, 1, 2, 2, 2])
# Powers of the length unit in m, m c and I.
_LENGTH_POWER = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])


def check_constraint(constraint):
    """Raise when `constraint` is not one of the two constraint sets."""
    if constraint not in CONSTRAINTS:
        raise ValueError(f"constraint must be one of {CONSTRAINTS}, got {constraint!r}")


def inertia_matrix(phi):
    """Inertia (..., 3, 3) about the origin of the frame of bodies (..., 10)."""
    phi = np.asarray(phi, dtype=float)
    inertia = np.empty((*phi.shape[:-1], 3, 3))
    inertia[..., _INERTIA_ROW, _INERTIA_COLUMN] = phi[..., 4:]
    inertia[..., _INERTIA_COLUMN, _INERTIA_ROW] = phi[..., 4:]
    return inertia


def pseudo_inertia(phi):
    """Pseudo-inertia matrices (..., 4, 4), eq. 14 of [WKS2018]_."""
    # J = [[tr(I) E / 2 - I, m c], [(m c)', m]] = sum of m [r 1]' [r 1]: positive
    # semidefinite if and only if a distribution of positive mass has these parameters.
    phi = np.asarray(phi, dtype=float)
    inertia = inertia_matrix(phi)
    trace = phi[..., 4] + phi[..., 6] + phi[..., 9]
    J = np.empty((*phi.shape[:-1], 4, 4))
    J[..., :3, :3] = 0.5 * trace[..., None, None] * np.eye(3) - inertia
    J[..., :3, 3] = phi[..., 1:4]
    J[..., 3, :3] = phi[..., 1:4]
    J[..., 3, 3] = phi[..., 0]
    return J


def inertial_parameters(J):
    """Parameters (..., 10) of pseudo-inertia matrices (..., 4, 4)."""
    # With S the upper left block of J, I = tr(S) E - S.
    J = np.asarray(J, dtype=float)
    second = J[..., :3, :3]
    trace = np.trace(second, axis1=-2, axis2=-1)
    inertia = trace[..., None, None] * np.eye(3) - second
    phi = np.empty((*J.shape[:-2], N_INERTIAL))
    phi[..., 0] = J[..., 3, 3]
    phi[..., 1:4] = J[..., :3, 3]
    phi[..., 4:] = inertia[..., _INERTIA_ROW, _INERTIA_COLUMN]
    return phi


def spatial_inertia(phi):
    """Spatial inertia matrices (..., 6, 6), angular rows first, eq. 7 of [WKS2018]_."""
    # M = [[I, [m c]x], [[m c]x', m E]]: by the Schur complement of m E it is positive
    # definite if and only if the mass and the inertia about the centre of mass are,
    # which is the set of eq. 30 of the paper.
    phi = np.asarray(phi, dtype=float)
    skew = np.zeros((*phi.shape[:-1], 3, 3))
    skew[..., 2, 1] = phi[..., 1]
    skew[..., 0, 2] = phi[..., 2]
    skew[..., 1, 0] = phi[..., 3]
    skew = skew - np.swapaxes(skew, -1, -2)
    M = np.empty((*phi.shape[:-1], 6, 6))
    M[..., :3, :3] = inertia_matrix(phi)
    M[..., :3, 3:] = skew
    M[..., 3:, :3] = np.swapaxes(skew, -1, -2)
    M[..., 3:, 3:] = phi[..., 0, None, None] * np.eye(3)
    return M


def constraint_matrix(phi, constraint="pseudo-inertia"):
    """Matrix, linear in `phi`, that must be positive definite."""
    check_constraint(constraint)
    return (
        pseudo_inertia(phi) if constraint == "pseudo-inertia" else spatial_inertia(phi)
    )


def parameter_units(mass_scale=1.0, length_scale=1.0):
    """Sizes (..., 10) of a body's parameters in units of mass and of length."""
    mass_scale = np.asarray(mass_scale, dtype=float)[..., None]
    length_scale = np.asarray(length_scale, dtype=float)[..., None]
    return mass_scale * length_scale**_LENGTH_POWER


def min_eigenvalue(
    phi, constraint="pseudo-inertia", *, mass_scale=1.0, length_scale=1.0
):
    """Smallest eigenvalues (...) of the constraint matrix of bodies (..., 10)."""
    # Dimensionless: that of S J S / m0, S = diag(1/l0, 1/l0, 1/l0, 1), and the analogue
    # for the spatial inertia. The sign does not depend on the units.
    phi = np.asarray(phi, dtype=float) / parameter_units(mass_scale, length_scale)
    return np.linalg.eigvalsh(constraint_matrix(phi, constraint))[..., 0]


def is_consistent(phi, constraint="pseudo-inertia", *, margin=0.0):
    """Tell which bodies are physically consistent.

    Parameters
    ----------
    phi : array-like of shape (..., 10)
        Inertial parameters [kg, kg m, kg m^2] in Pinocchio's order.
    constraint : {"pseudo-inertia", "eq30"}, default="pseudo-inertia"
        "pseudo-inertia": a mass distribution exists. "eq30": mass and inertia about
        the centre of mass are positive, without the triangle inequality.
    margin : float, default=0.0
        Least eigenvalue of the constraint's matrix, in units of 1 kg and 1 m.

    Returns
    -------
    consistent : ndarray of bool of shape (...)
        Whether each body is.

    Raises
    ------
    ValueError
        If `constraint` is unknown or the last axis does not have ten entries.

    Examples
    --------
    >>> from sklearn_vbjfa.physical import is_consistent
    >>> is_consistent([[2, 0, 0, 0, 1, 0, 1, 0, 0, 3], [2, 0, 0, 0, 1, 0, 1, 0, 0, 1]])
    array([False,  True])
    """
    return min_eigenvalue(phi, constraint) >= margin


def body_scales(phi):
    """Units of mass and length (n_bodies,) of bodies (..., n_bodies, 10)."""
    # With the sizes M = |m|, H = |m c|, N = |I|_F of every body, the length of the
    # robot is L = sqrt(sum N / sum M), that of a body l0 = sqrt(N / M), within a factor
    # of ten of L, and m0 = max(M, H / l0, N / l0^2), which change as units do. A body
    # of zeros takes the mean mass of the others.
    phi = np.asarray(phi, dtype=float)
    rows = phi.reshape(np.prod(phi.shape[:-2], dtype=int), *phi.shape[-2:])
    # Frobenius norm, invariant to rotation: off-diagonal entries count twice.
    weight = np.where(_INERTIA_ROW == _INERTIA_COLUMN, 1.0, 2.0)
    mass = np.sqrt(np.mean(rows[..., 0] ** 2, axis=0))
    first = np.sqrt(np.mean(np.sum(rows[..., 1:4] ** 2, axis=-1), axis=0))
    inertia = np.sqrt(np.mean(np.sum(weight * rows[..., 4:] ** 2, axis=-1), axis=0))

    total_mass, total_first, total_inertia = mass.sum(), first.sum(), inertia.sum()
    if total_mass > 0 and total_inertia > 0:
        robot_length = np.sqrt(total_inertia / total_mass)
    elif total_mass > 0 and total_first > 0:
        robot_length = total_first / total_mass
    elif total_first > 0 and total_inertia > 0:
        robot_length = total_inertia / total_first
    else:
        robot_length = 1.0
    length_scale = np.full(mass.shape, robot_length)
    known = (mass > 0) & (inertia > 0)
    length_scale[known] = np.clip(
        np.sqrt(inertia[known] / mass[known]), robot_length / 10, robot_length * 10
    )
    mass_scale = np.maximum(mass, first / length_scale)
    mass_scale = np.maximum(mass_scale, inertia / length_scale**2)
    empty = mass_scale == 0
    mass_scale[empty] = 1.0 if empty.all() else mass_scale[~empty].mean()
    return mass_scale, length_scale
