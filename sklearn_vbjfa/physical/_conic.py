"""The projection stated for clarabel, a conic solver.

With displacement d from the vector to project, in units of a distance s:

    min_(d, t) t  such that  (t, T d - c / s) in SOC,
    (M_j(x_0) - eps E) / s + M_j(d) >= 0,  x_0k / s + d_k >= 0.

As a second-order cone the distance keeps the condition number of T, which its square,
the quadratic form T' T, would square.
"""

import clarabel
import numpy as np
from scipy import sparse

from sklearn_vbjfa.physical._programme import PrimalDual


def solve_conic(programme, *, max_steps):
    """Solve with clarabel; return where it ended, its iterations and its own words."""
    # The answer is not finite where the solver broke down.

    # The tolerances are absolute too. The distance of a consistent vector is the unit,
    # unless it is below the resolution, where it cannot be measured.
    upper = programme.distance(programme.clip(2 * programme.margin))
    scale = max(upper, programme.resolution) or 1.0
    bodies, kept = programme.body_columns, programme.nonnegative
    n, n_bodies = programme.n_features, len(bodies)
    size = programme.generators.shape[-1]
    # clarabel stacks the upper triangle by columns, off-diagonal entries times sqrt(2).
    column, row = np.tril_indices(size)
    weight = np.where(row == column, 1.0, np.sqrt(2.0))
    entries = weight * programme.generators[:, row, column]
    at_point = weight * programme.slack(programme.point)[:, row, column]
    # Rows of s = b - A (d, t): the distance, then every body, then the columns kept.
    distance = -np.vstack([np.eye(n + 1)[n], np.c_[programme.root, np.zeros(n)]])
    matrices = np.zeros((n_bodies, len(row), n + 1))
    matrices[np.arange(n_bodies)[:, None], :, bodies] = -entries
    cones = [clarabel.SecondOrderConeT(n + 1)]
    cones += [clarabel.PSDTriangleConeT(size)] * n_bodies
    cones += [clarabel.NonnegativeConeT(kept.size)] if kept.size else []

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = max_steps
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((n + 1, n + 1)),
        np.eye(n + 1)[n],
        sparse.csc_matrix(
            np.vstack([distance, matrices.reshape(-1, n + 1), -np.eye(n + 1)[kept]])
        ),
        np.r_[
            0.0,
            -programme.shift / scale,
            at_point.ravel() / scale,
            programme.point[kept] / scale,
        ],
        cones,
        settings,
    ).solve()

    # The multipliers are those of the distance; of half its square they are as many
    # times as large as the distance is.
    length = scale * max(solution.x[-1], 0.0)
    z = length * np.array(solution.z[n + 1 :])
    stacked = z[: n_bodies * len(row)].reshape(n_bodies, len(row)) / weight
    duals = np.zeros((n_bodies, size, size))
    duals[:, row, column] = duals[:, column, row] = stacked
    answer = PrimalDual(
        vector=programme.point + scale * np.array(solution.x[:n]),
        duals=duals,
        multipliers=z[stacked.size :],
    )
    return answer, int(solution.iterations), str(solution.status)
