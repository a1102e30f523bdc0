"""Inertial parameters as matrices, and when a rigid body exists that has them.

The ten parameters of a body stand in Pinocchio's order, (m, m c_x, m c_y, m c_z, I_xx,
I_xy, I_yy, I_xz, I_yz, I_zz), with the inertia about the origin of the joint's frame.
Functions are batched over the leading axes. Source: Wensing, Kim and Slotine, "Linear
Matrix Inequalities for Physically Consistent Inertial Parameter Identification", IEEE
RA-L 3(1), 2018 [WKS2018]_.
"""

import numpy as np

# A body's parameters in Pinocchio's order, as columns and reports name them.
INERTIAL_NAMES = (
    "m",
    "mc_x",
    "mc_y",
    "mc_z",
    "I_xx",
    "I_xy",
    "I_yy",
    "I_xz",
    "I_yz",
    "I_zz",
)
N_INERTIAL = len(INERTIAL_NAMES)
CONSTRAINTS = ("pseudo-inertia", "eq30")

# Row and column of each of the six inertia parameters, in Pinocchio's order.
_INERTIA_ROW = np.array([0, 0, 1, 0, 1, 2])
_INERTIA_COLUMN = np.array([0, 1, 1, 2, 2, 2])
# Powers of the length unit in m, m c and I.
_LENGTH_POWER = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])


def _check_parameters(phi):
    """Return phi as a float array of shape (..., 10)."""
    phi = np.asarray(phi, dtype=float)
    if phi.ndim == 0 or phi.shape[-1] != N_INERTIAL:
        raise ValueError(
            "The last axis of phi must hold the 10 inertial parameters of a body "
            "(m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz); got an array of "
            f"shape {phi.shape}."
        )
    return phi


def _check_constraint(constraint):
    """Raise when `constraint` is not one of the two constraint sets."""
    if constraint not in CONSTRAINTS:
        raise ValueError(f"constraint must be one of {CONSTRAINTS}, got {constraint!r}")


def inertia_matrix(phi):
    """Inertia of a body about the origin of its frame.

    Parameters
    ----------
    phi : array-like of shape (..., 10)
        Inertial parameters [kg, kg m, kg m^2] in Pinocchio's order.

    Returns
    -------
    inertia : ndarray of shape (..., 3, 3)
        Symmetric inertia matrix [kg m^2].

    Raises
    ------
    ValueError
        If the last axis does not have ten entries.

    Examples
    --------
    >>> from sklearn_vbjfa.physical import inertia_matrix
    >>> inertia_matrix([1, 0, 0, 0, 2, 0.5, 3, 0, 0, 4])
    array([[2. , 0.5, 0. ],
           [0.5, 3. , 0. ],
           [0. , 0. , 4. ]])
    """
    phi = _check_parameters(phi)
    inertia = np.empty((*phi.shape[:-1], 3, 3))
    inertia[..., _INERTIA_ROW, _INERTIA_COLUMN] = phi[..., 4:]
    inertia[..., _INERTIA_COLUMN, _INERTIA_ROW] = phi[..., 4:]
    return inertia


def pseudo_inertia(phi):
    r"""Pseudo-inertia matrix of a body.

    .. math::

        J = \begin{bmatrix} \tfrac12 \operatorname{tr}(I) E - I & m c \\
            (m c)^\top & m \end{bmatrix}
          = \int \begin{bmatrix} r \\ 1 \end{bmatrix}
            \begin{bmatrix} r \\ 1 \end{bmatrix}^\top \mathrm{d}m(r)

    A distribution of positive mass has these ten parameters exactly when `J` is
    positive semidefinite (eq. 14 and theorem 1 of [WKS2018]_).

    Parameters
    ----------
    phi : array-like of shape (..., 10)
        Inertial parameters [kg, kg m, kg m^2] in Pinocchio's order.

    Returns
    -------
    J : ndarray of shape (..., 4, 4)
        Symmetric matrix: second moments of the mass [kg m^2], first moments
        [kg m], mass [kg].

    Raises
    ------
    ValueError
        If the last axis does not have ten entries.

    References
    ----------
    .. [WKS2018] P. M. Wensing, S. Kim, J.-J. E. Slotine, "Linear Matrix
       Inequalities for Physically Consistent Inertial Parameter Identification: A
       Statistical Perspective on the Mass Distribution", IEEE Robotics and
       Automation Letters 3(1), 2018. :doi:`10.1109/LRA.2017.2729659`

    Examples
    --------
    A point mass of 2 kg at (1, 0, 0) m:

    >>> from sklearn_vbjfa.physical import pseudo_inertia
    >>> pseudo_inertia([2, 2, 0, 0, 0, 0, 2, 0, 0, 2])
    array([[2., 0., 0., 2.],
           [0., 0., 0., 0.],
           [0., 0., 0., 0.],
           [2., 0., 0., 2.]])
    """
    phi = _check_parameters(phi)
    inertia = inertia_matrix(phi)
    trace = phi[..., 4] + phi[..., 6] + phi[..., 9]
    J = np.empty((*phi.shape[:-1], 4, 4))
    J[..., :3, :3] = 0.5 * trace[..., None, None] * np.eye(3) - inertia
    J[..., :3, 3] = phi[..., 1:4]
    J[..., 3, :3] = phi[..., 1:4]
    J[..., 3, 3] = phi[..., 0]
    return J


def inertial_parameters(J):
    r"""Inertial parameters of a pseudo-inertia matrix: `pseudo_inertia` undone.

    With :math:`\Sigma` the upper left block of `J`,
    :math:`I = \operatorname{tr}(\Sigma) E - \Sigma`.

    Parameters
    ----------
    J : array-like of shape (..., 4, 4)
        Pseudo-inertia matrices [kg m^2, kg m, kg]; the upper triangle is read.

    Returns
    -------
    phi : ndarray of shape (..., 10)
        Inertial parameters [kg, kg m, kg m^2] in Pinocchio's order.

    Raises
    ------
    ValueError
        If the last two axes are not 4 by 4.

    Examples
    --------
    >>> from sklearn_vbjfa.physical import inertial_parameters, pseudo_inertia
    >>> phi = [2.0, 0.1, 0.2, 0.3, 1.0, 0.01, 1.1, 0.02, 0.03, 1.2]
    >>> bool(abs(inertial_parameters(pseudo_inertia(phi)) - phi).max() < 1e-15)
    True
    """
    J = np.asarray(J, dtype=float)
    if J.ndim < 2 or J.shape[-2:] != (4, 4):
        raise ValueError(
            f"J must have shape (..., 4, 4), got an array of shape {J.shape}"
        )
    second = J[..., :3, :3]
    trace = np.trace(second, axis1=-2, axis2=-1)
    inertia = trace[..., None, None] * np.eye(3) - second
    phi = np.empty((*J.shape[:-2], N_INERTIAL))
    phi[..., 0] = J[..., 3, 3]
    phi[..., 1:4] = J[..., :3, 3]
    phi[..., 4:] = inertia[..., _INERTIA_ROW, _INERTIA_COLUMN]
    return phi


def spatial_inertia(phi):
    r"""Spatial inertia matrix of a body, angular rows first.

    .. math::

        M = \begin{bmatrix} I & [m c]_\times \\ [m c]_\times^\top & m E \end{bmatrix}

    By the Schur complement of `m E`, `M` is positive definite exactly when the mass
    and the inertia about the centre of mass are: the set that eq. 30 of [TDS2011]_
    describes is convex in the parameters themselves (eq. 7 of [WKS2018]_).

    Parameters
    ----------
    phi : array-like of shape (..., 10)
        Inertial parameters [kg, kg m, kg m^2] in Pinocchio's order.

    Returns
    -------
    M : ndarray of shape (..., 6, 6)
        Symmetric matrix: inertia [kg m^2], first moments [kg m], mass [kg].

    Raises
    ------
    ValueError
        If the last axis does not have ten entries.

    References
    ----------
    .. [TDS2011] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system
       identification with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`
    .. [WKS2018] P. M. Wensing, S. Kim, J.-J. E. Slotine, IEEE Robotics and Automation
       Letters 3(1), 2018. :doi:`10.1109/LRA.2017.2729659`

    Examples
    --------
    >>> from sklearn_vbjfa.physical import spatial_inertia
    >>> spatial_inertia([2, 0, 0, 1, 3, 0, 3, 0, 0, 3])[:3, 3:]
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  0.]])
    """
    phi = _check_parameters(phi)
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
    """Matrix that must be positive definite: pseudo-inertia or spatial inertia.

    Parameters
    ----------
    phi : array-like of shape (..., 10)
        Inertial parameters [kg, kg m, kg m^2] in Pinocchio's order.
    constraint : {"pseudo-inertia", "eq30"}, default="pseudo-inertia"
        "pseudo-inertia": a mass distribution exists.  "eq30": mass and inertia about
        the centre of mass are positive, which leaves the triangle inequality out.

    Returns
    -------
    matrix : ndarray of shape (..., 4, 4) or (..., 6, 6)
        Linear in `phi`.

    Raises
    ------
    ValueError
        If `constraint` is unknown or the last axis does not have ten entries.

    Examples
    --------
    >>> from sklearn_vbjfa.physical import constraint_matrix
    >>> constraint_matrix([1, 0, 0, 0, 1, 0, 1, 0, 0, 1], "eq30").shape
    (6, 6)
    """
    _check_constraint(constraint)
    return (
        pseudo_inertia(phi) if constraint == "pseudo-inertia" else spatial_inertia(phi)
    )


def parameter_units(mass_scale=1.0, length_scale=1.0):
    """Size of each parameter of a body in a unit of mass and a unit of length.

    Parameters
    ----------
    mass_scale : array-like of shape (...), default=1.0
        Unit of mass m0 [kg].
    length_scale : array-like of shape (...), default=1.0
        Unit of length l0 [m].

    Returns
    -------
    units : ndarray of shape (..., 10)
        ``m0``, three times ``m0 l0``, six times ``m0 l0^2``.

    Examples
    --------
    >>> from sklearn_vbjfa.physical import parameter_units
    >>> parameter_units(2.0, 10.0)[[0, 1, 4]]
    array([  2.,  20., 200.])
    """
    mass_scale = np.asarray(mass_scale, dtype=float)[..., None]
    length_scale = np.asarray(length_scale, dtype=float)[..., None]
    return mass_scale * length_scale**_LENGTH_POWER


def min_eigenvalue(
    phi, constraint="pseudo-inertia", *, mass_scale=1.0, length_scale=1.0
):
    r"""Smallest eigenvalue of a body's constraint matrix, as a pure number.

    The pseudo-inertia mixes kg m^2, kg m and kg, so its eigenvalues mean nothing
    before a unit of mass `m0` and one of length `l0` are chosen.  The value is the
    smallest eigenvalue of :math:`S J S / m_0`, :math:`S = \mathrm{diag}(1/l_0, 1/l_0,
    1/l_0, 1)`, and the analogue for the spatial inertia.  Its sign does not depend on
    the units.

    Parameters
    ----------
    phi : array-like of shape (..., 10)
        Inertial parameters [kg, kg m, kg m^2] in Pinocchio's order.
    constraint : {"pseudo-inertia", "eq30"}, default="pseudo-inertia"
        The constraint set, see :func:`constraint_matrix`.
    mass_scale : array-like of shape (...), default=1.0
        Unit of mass [kg].
    length_scale : array-like of shape (...), default=1.0
        Unit of length [m].

    Returns
    -------
    eigenvalue : ndarray of shape (...)
        Dimensionless; positive for a consistent body.

    Raises
    ------
    ValueError
        If `constraint` is unknown or the last axis does not have ten entries.

    Examples
    --------
    Izz > Ixx + Iyy: no body has this inertia, though the matrix is positive.

    >>> from sklearn_vbjfa.physical import min_eigenvalue
    >>> phi = [2, 0, 0, 0, 1, 0, 1, 0, 0, 3]
    >>> float(min_eigenvalue(phi)), float(min_eigenvalue(phi, "eq30"))
    (-0.5, 1.0)
    """
    phi = _check_parameters(phi) / parameter_units(mass_scale, length_scale)
    return np.linalg.eigvalsh(constraint_matrix(phi, constraint))[..., 0]


def is_consistent(
    phi,
    constraint="pseudo-inertia",
    *,
    margin=0.0,
    mass_scale=1.0,
    length_scale=1.0,
):
    """Tell which bodies are physically consistent.

    Parameters
    ----------
    phi : array-like of shape (..., 10)
        Inertial parameters [kg, kg m, kg m^2] in Pinocchio's order.
    constraint : {"pseudo-inertia", "eq30"}, default="pseudo-inertia"
        The constraint set, see :func:`constraint_matrix`.
    margin : float, default=0.0
        Least value of :func:`min_eigenvalue` (dimensionless).
    mass_scale : array-like of shape (...), default=1.0
        Unit of mass [kg] of the margin.
    length_scale : array-like of shape (...), default=1.0
        Unit of length [m] of the margin.

    Returns
    -------
    consistent : ndarray of bool of shape (...)
        True where ``min_eigenvalue(...) >= margin``.

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
    eigenvalue = min_eigenvalue(
        phi, constraint, mass_scale=mass_scale, length_scale=length_scale
    )
    return eigenvalue >= margin


def body_scales(phi):
    r"""Units of mass and of length in which each body's parameters are near one.

    With the sizes :math:`M = |m|, H = \|m c\|, N = \|I\|_F` of every body (root mean
    squares over the leading axes), the length of the whole robot is
    :math:`L = \sqrt{\sum N / \sum M}`; that of a body is
    :math:`l_0 = \sqrt{N / M}`, kept within a factor of ten of `L` because an estimate
    of a barely identifiable body may have any size; and :math:`m_0 = \max(M, H / l_0,
    N / l_0^2)`.  Parameters multiplied by a constant, another unit of length, rotated
    frames and reordered bodies change the scales exactly as the units they are.

    Parameters
    ----------
    phi : array-like of shape (..., n_bodies, 10)
        Inertial parameters [kg, kg m, kg m^2] in Pinocchio's order; they need not be
        consistent.

    Returns
    -------
    mass_scale : ndarray of shape (n_bodies,)
        m0 [kg], positive.  A body of zeros takes the mean of the others; without
        any other, 1 kg.
    length_scale : ndarray of shape (n_bodies,)
        l0 [m], positive.  Where the parameters hold no length (all masses zero, say)
        it follows from the first moments, and from nothing but zeros it is 1 m.

    Raises
    ------
    ValueError
        If `phi` has fewer than two axes or its last does not have ten entries.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa.physical import body_scales
    >>> mass_scale, length_scale = body_scales([[2, 0, 0, 0, 8, 0, 0, 0, 0, 0]])
    >>> float(mass_scale[0]), float(length_scale[0])
    (2.0, 2.0)
    """
    phi = _check_parameters(phi)
    if phi.ndim < 2:
        raise ValueError(
            f"phi must have shape (..., n_bodies, 10), got shape {phi.shape}"
        )
    rows = phi.reshape(np.prod(phi.shape[:-2], dtype=int), *phi.shape[-2:])
    # Frobenius norm: the off-diagonal entries count twice, so that turning the frame
    # changes nothing.
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
