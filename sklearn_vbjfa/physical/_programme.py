"""The projection as a convex programme: its data, consistent vectors, its certificate.

In scaled variables x (every parameter divided by its unit), with T upper triangular and
nonsingular:

    min_x |T x - c|^2 / 2  such that  M_j(x) - eps E >= 0 for every body,
    x_k >= 0 for the non-negative columns.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from sklearn_vbjfa._core._linear_systems import svd
from sklearn_vbjfa.physical._pseudo_inertia import (
    N_INERTIAL,
    constraint_matrix,
    inertial_parameters,
    min_eigenvalue,
)

# Distances below this fraction of the vector's own length count as this fraction in the
# relative gap: rounding of the matrices leaves about 1e-9 of their size, the square
# root of the largest gap accepted times this.
_RESOLUTION = 1e-7
# Weight of the pull to the anchor, relative to the largest diagonal entry of the metric
# in scaled units. Consistency couples the null space of the metric with its complement:
# a pull must cost little in units of the noise, whose largest entries are about 1e9.
_ANCHOR_WEIGHT = 1e-10


@dataclass(frozen=True, kw_only=True)
class PrimalDual:
    """A vector with multipliers of its constraints."""

    vector: np.ndarray  # (n_features,): vector in scaled units
    duals: np.ndarray  # (n_bodies, n, n): multipliers of the bodies' matrices
    multipliers: np.ndarray  # (n_nonnegative,): multipliers of the non-negative columns

    @property
    def is_finite(self):
        """Whether all values are finite."""
        parts = self.vector, self.duals, self.multipliers
        return all(np.isfinite(part).all() for part in parts)


@dataclass(frozen=True, kw_only=True)
class Programme:
    """The projection in scaled variables."""

    constraint: str  # which matrix of a body has to be positive definite
    body_columns: np.ndarray  # (n_bodies, 10): columns of every body
    nonnegative: np.ndarray  # columns that must not be negative
    margin: float  # least eigenvalue (dimensionless) of every body's matrix
    point: np.ndarray  # (n_features,): the vector to project
    # (n_features, n_features): T, metric and pull to the anchor as one square root
    root: np.ndarray
    # (n_features,): `c`: the distance of a vector is ``|T (vector - point) - c|``
    shift: np.ndarray
    resolution: float  # distance below which rounding decides

    @classmethod
    def pulled(cls, point, *, metric_root, anchor, **constraints):
        """State the programme of a metric and of a pull to an anchor."""
        # metric_root: in scaled variables, largest column norm one (or zero). Its null
        # space is pulled to `anchor`, which makes the minimum unique.
        # Rank up to ten times the rounding of the metric, the square of its root, with
        # columns of equal norm: light bodies must not hide heavy ones.
        rounding = np.sqrt(len(point) * np.finfo(float).eps)
        size = np.linalg.norm(metric_root, axis=0)
        size[size <= rounding * size.max()] = 1.0
        _, values, rows = svd(metric_root / size)
        hidden = rows[values <= 10 * rounding * values.max()] / size
        # |R x|^2 + w |N'(x - a)|^2 as one triangular factor: the stacked QR does not
        # square the condition number as R'R would.
        pull = np.sqrt(_ANCHOR_WEIGHT) * np.linalg.qr(hidden.T)[0].T
        right = np.zeros(len(metric_root) + len(pull))
        right[len(metric_root) :] = pull @ (anchor - point)
        Q, root = np.linalg.qr(np.vstack([metric_root, pull]))
        return cls(
            point=point,
            root=root,
            shift=Q.T @ right,
            resolution=_RESOLUTION * float(np.linalg.norm(root @ point)),
            **constraints,
        )

    def broken(self, vector):
        """Bodies and columns that violate their constraints, two arrays, bool."""
        lowest = min_eigenvalue(vector[self.body_columns], self.constraint)
        return lowest < self.margin, vector[self.nonnegative] < 0.0

    def restricted(self, bodies, columns):
        """Return the programme with the constraints of some bodies and columns only.

        Returns it, in their variables, and a function that completes its vector.
        """
        # A triangular factor eliminates unconstrained variables, which come first.
        chosen, kept = self.body_columns[bodies], self.nonnegative[columns]
        left = np.union1d(chosen, kept)
        rest = np.setdiff1d(np.arange(self.n_features), left)
        Q, root = np.linalg.qr(self.root[:, np.r_[rest, left]])
        shift, k = Q.T @ self.shift, rest.size
        part = replace(
            self,
            body_columns=np.searchsorted(left, chosen),
            nonnegative=np.searchsorted(left, kept),
            point=self.point[left],
            root=root[k:, k:],
            shift=shift[k:],
        )

        def completed(vector):
            out = self.point.copy()
            out[left] = vector
            right = shift[:k] - root[:k, k:] @ (vector - part.point)
            if k:
                out[rest] += solve_triangular(root[:k, :k], right)
            return out

        return part, completed

    @property
    def n_features(self):
        """Length of the parameter vector."""
        return self.point.size

    @cached_property
    def generators(self):
        """Matrices of the ten unit bodies, shape (10, n, n), n = 4 or 6."""
        return constraint_matrix(np.eye(N_INERTIAL), self.constraint)

    def residual(self, vector):
        """T (vector - point) - c, shape (n_features,)."""
        return self.root @ (vector - self.point) - self.shift

    def distance(self, vector):
        """Norm of the residual."""
        return float(np.linalg.norm(self.residual(vector)))

    def slack(self, vector):
        """Matrices that must be positive semidefinite, shape (n_bodies, n, n)."""
        matrices = constraint_matrix(vector[self.body_columns], self.constraint)
        return matrices - self.margin * np.eye(matrices.shape[-1])

    def lift(self, vector, floor):
        """Return a vector moved inside the set along the bodies' unit matrices."""
        # Adding ``t`` times the body whose matrix is the unit matrix raises the
        # smallest eigenvalue by exactly ``t``: the least change that reaches `floor`.
        # Non-negative columns end at ``floor - margin`` or above.
        vector = vector.copy()
        unit = np.zeros(N_INERTIAL)
        unit[0] = 1.0
        unit[[4, 6, 9]] = 2.0 if self.constraint == "pseudo-inertia" else 1.0
        lowest = min_eigenvalue(vector[self.body_columns], self.constraint)
        vector[self.body_columns] += np.maximum(floor - lowest, 0.0)[:, None] * unit
        kept = self.nonnegative
        vector[kept] = np.maximum(vector[kept], floor - self.margin)
        return vector

    def clip(self, floor):
        """Return the point with eigenvalues raised to `floor`."""
        vector = self.point.copy()
        J = constraint_matrix(vector[self.body_columns], "pseudo-inertia")
        vector[self.body_columns] = inertial_parameters(raised(J, floor))
        return self.lift(vector, floor)

    def relative_gap(self, vector, duals, multipliers):
        """Bound how far a consistent vector is from optimal."""
        # For any positive semidefinite Z_j and non-negative z_k (negative parts are
        # dropped), weak duality of the strongly convex programme gives, relative to
        # |r(x)|^2 or to the square of the resolution where that is larger,
        #     |r(x)|^2 / 2 - |r(x*)|^2 / 2 <= sum_j <Z_j, M_j(x) - eps E>
        #         + sum_k z_k x_k + |T^-T (T' r - G' z)|^2 / 2.
        duals, multipliers = raised(duals, 0.0), np.maximum(multipliers, 0.0)
        residual = self.residual(vector)
        complementarity = np.sum(duals * self.slack(vector))
        complementarity += multipliers @ vector[self.nonnegative]
        stationarity = self.root.T @ residual
        stationarity[self.body_columns] -= np.einsum(
            "kij,bij->bk", self.generators, duals
        )
        stationarity[self.nonnegative] -= multipliers
        error = solve_triangular(self.root, stationarity, trans="T")
        excess = 2.0 * complementarity + error @ error
        least = max(self.resolution**2, np.finfo(float).tiny)
        return float(excess / max(residual @ residual, least))


def raised(matrices, floor):
    """Return symmetric matrices with eigenvalues of at least `floor`."""
    eigenvalue, basis = np.linalg.eigh(matrices)
    eigenvalue = np.maximum(eigenvalue, floor)
    return np.einsum("...ik,...k,...jk->...ij", basis, eigenvalue, basis)
