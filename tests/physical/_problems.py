"""Random robots and metrics, and an independent convex solver as an oracle."""

import numpy as np
import pytest


def point_masses(rng, n_points=8, *, spread=0.3, mass=1.0):
    """Random point masses: positions (n, 3) [m] and masses (n,) [kg]."""
    centre = rng.normal(size=3) * 0.3
    return centre + spread * rng.normal(size=(n_points, 3)), mass * rng.uniform(
        0.1, 1.0, size=n_points
    )


def parameters_of(points, masses):
    """Sum the ten parameters over points, from their definitions."""
    phi = np.zeros(10)
    for r, m in zip(points, masses):
        inertia = m * (r @ r * np.eye(3) - np.outer(r, r))
        phi += [m, *(m * r), *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    return phi


def robot(rng, n_bodies, n_extra=1):
    """Consistent vector of a robot with positive friction."""
    return np.concatenate(
        [
            np.r_[
                parameters_of(*point_masses(rng)), rng.uniform(0.05, 0.5, size=n_extra)
            ]
            for _ in range(n_bodies)
        ]
    )


def metric(rng, n_features, condition=1.0, rank=None):
    """Metric with a given condition number (of the whole, or of its range)."""
    rank = n_features if rank is None else rank
    basis, _ = np.linalg.qr(rng.normal(size=(n_features, n_features)))
    eigenvalue = np.zeros(n_features)
    eigenvalue[:rank] = np.logspace(0, -np.log10(condition), rank)
    return (basis * eigenvalue) @ basis.T


def literal_matrix(phi, constraint):
    """Constraint matrix of one body written entry by entry."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = phi
    if constraint == "pseudo-inertia":
        return np.array(
            [
                [(-xx + yy + zz) / 2, -xy, -xz, x],
                [-xy, (xx - yy + zz) / 2, -yz, y],
                [-xz, -yz, (xx + yy - zz) / 2, z],
                [x, y, z, m],
            ]
        )
    return np.array(
        [
            [xx, xy, xz, 0, -z, y],
            [xy, yy, yz, z, 0, -x],
            [xz, yz, zz, -y, x, 0],
            [0, z, -y, m, 0, 0],
            [-z, 0, x, 0, m, 0],
            [y, -x, 0, 0, 0, m],
        ]
    )


def cvxopt_projection(theta, matrix, constraint, starts, nonnegative, floor=0.0):
    """Solve the projection by the cone QP of cvxopt, an independent optimum.

    `floor` is the minimum eigenvalue of each body's matrix (units of 1 kg and 1 m).
    """
    dense = pytest.importorskip("cvxopt").matrix
    solvers = pytest.importorskip("cvxopt.solvers")

    n = theta.size
    starts = np.asarray(starts)
    G, h = [], []
    if len(nonnegative):
        block = np.zeros((len(nonnegative), n))
        block[np.arange(len(nonnegative)), nonnegative] = -1.0
        G.append(block)
        h.append(theta[nonnegative])
    size = 4 if constraint == "pseudo-inertia" else 6
    for start in starts:
        block = np.zeros((size * size, n))
        for k in range(10):
            block[:, start + k] = -literal_matrix(np.eye(10)[k], constraint).ravel()
        G.append(block)
        value = literal_matrix(theta[start : start + 10], constraint) - floor * np.eye(
            size
        )
        h.append(value.ravel())
    options = {
        "show_progress": False,
        "abstol": 1e-13,
        "reltol": 1e-12,
        "feastol": 1e-12,
        "maxiters": 60,
    }
    scale = 1.0
    # cvxopt uses an absolute gap: the second solve has an optimum near one.
    for _ in range(2):
        solution = solvers.coneqp(
            dense(matrix / scale),
            dense(np.zeros(n)),
            dense(np.vstack(G)),
            dense(np.concatenate(h)),
            {"l": len(nonnegative), "q": [], "s": [size] * len(starts)},
            options=options,
        )
        delta = np.array(solution["x"]).ravel()
        squared = float(delta @ matrix @ delta)
        scale = squared
    return theta + delta, squared
