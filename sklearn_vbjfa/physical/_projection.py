"""Projection of parameter vectors on the physically consistent ones, in a metric."""

import warnings
from dataclasses import dataclass

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import (
    assert_all_finite,
    check_array,
    check_consistent_length,
    column_or_1d,
)

from sklearn_vbjfa._core._threads import one_blas_thread
from sklearn_vbjfa.physical._layout import resolve_layout
from sklearn_vbjfa.physical._programme import Programme
from sklearn_vbjfa.physical._pseudo_inertia import (
    body_scales,
    check_constraint,
    min_eigenvalue,
    parameter_units,
)
from sklearn_vbjfa.physical._solver import GAP_TARGET, ProjectionError, solve

# How many times longer than the visible part of a vector its hidden part may be before
# it is taken for rounding; a plausible robot's are of one order.
_HIDDEN_LIMIT = 100.0


@dataclass(frozen=True, kw_only=True)
class Metric:
    """Validated metric with its square root."""

    matrix: np.ndarray  # (n_features, n_features): symmetric positive semidefinite `A`
    root: np.ndarray  # (n_features, n_features): `R` with ``R' R = A``
    size: np.ndarray  # (n_features,): square root of the diagonal
    # (n_features, n_visible): orthonormal basis of what `A` sees, in units of `size`
    basis: np.ndarray

    def visible_part(self, theta):
        """Drop what the metric does not see where it dwarfs what it sees."""
        # A least-squares solve that does not cut its singular values returns 1e10 and
        # more along directions without information; scales and anchors do not come from
        # those. Also returns the lengths of the hidden and the visible part.
        standardised = theta * self.size
        part = self.basis @ (self.basis.T @ standardised)
        hidden, visible = np.linalg.norm(standardised - part), np.linalg.norm(part)
        if hidden > _HIDDEN_LIMIT * visible:
            theta = np.divide(
                part, self.size, out=np.zeros_like(theta), where=self.size > 0
            )
        return theta, hidden, visible

    def without_rounding(self, theta):
        """Return the `visible_part`; warn where that is not all."""
        part, hidden, visible = self.visible_part(theta)
        if part is not theta:
            warnings.warn(
                f"The part of theta that the metric does not see is {hidden:.1e} long "
                f"in units of the metric, the part it sees {visible:.1e}: taken for "
                "the rounding of a singular regression and replaced by the shortest "
                "vector that predicts the same. Fit with a regressor that cuts small "
                "singular values.",
                UserWarning,
                stacklevel=5,
            )
        return part


@one_blas_thread()
def check_metric(metric, n_features):
    """Validate a metric (n_features, n_features) and take its square root."""
    metric = check_array(metric, dtype=np.float64, input_name="metric")
    if metric.shape != (n_features, n_features):
        raise ValueError(
            f"metric must have shape ({n_features}, {n_features}), one row and column "
            f"per parameter, got {metric.shape}."
        )
    diagonal = np.diag(metric)
    if np.any(diagonal < 0):
        raise ValueError("metric must be positive semidefinite; its diagonal is not.")
    # Compared in units of the diagonal: the entries of a Gram matrix carry the units
    # of two parameters and may be many orders of magnitude apart.
    size = np.sqrt(diagonal)
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    rounding = n_features * np.finfo(float).eps * np.abs(metric).max(initial=0.0)
    metric = 0.5 * (metric + metric.T)
    correlation = metric * inverse * inverse[:, None]
    correlation = 0.5 * (correlation + correlation.T)
    eigenvalue, basis = np.linalg.eigh(correlation)
    # A matrix computed in its own units (a clipped eigendecomposition) is semidefinite
    # to rounding in those, though perhaps not in units of a tiny diagonal.
    if eigenvalue[0] < -1e-10 * max(eigenvalue[-1], 1.0) or np.any(
        np.abs(metric[size == 0]) > 0
    ):
        raw = np.linalg.eigvalsh(metric)[0]
        if raw < -10 * rounding:
            raise ValueError(
                "metric must be positive semidefinite; its smallest eigenvalue is "
                f"{raw:.3g}. A Gram matrix from which a noise covariance was "
                "subtracted has to be clipped first."
            )
    visible = eigenvalue > n_features * np.finfo(float).eps * max(eigenvalue[-1], 0.0)
    eigenvalue[~visible] = 0.0
    return Metric(
        matrix=metric,
        root=np.sqrt(eigenvalue)[:, None] * basis.T * size,
        size=size,
        basis=basis[:, visible],
    )


# Non-negative values below this share of the largest, in the units of the programme,
# are zeros: an interior path ends inside. Measured robots: 1e-14, least friction 1e-3.
_ROUNDING = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Options:
    """Layout, margin and anchor of a projection."""

    # First column of each body's ten, and columns that must not be negative (viscous
    # and Coulomb friction, rotor inertia). None: those that the names of the columns
    # give. Without names, joints have 11 columns (viscous friction last) or 10,
    # whichever divides the number of columns; if both do, 11, with a warning.
    body_starts: object = None
    nonnegative: object = ()
    # least eigenvalue of each body's matrix in units of the body's mass and length
    # scale, above zero, so that the projected robot can be simulated
    margin: float = 1e-8
    # (n_features,): vector to which directions are pulled that the metric does not
    # see, such as that of a data sheet. None: the vector itself
    anchor: object = None

    def __post_init__(self):
        """Raise ValueError for an impossible margin."""
        if not 0 < self.margin < 1:
            raise ValueError(f"margin must be between 0 and 1, got {self.margin!r}.")


@dataclass(frozen=True, kw_only=True)
class Projection:
    """Where vectors are projected and in which distance; validated, in SI units."""

    constraint: str
    margin: float
    bodies: np.ndarray  # (n_bodies, 10): columns of every body
    nonnegative: np.ndarray  # columns that must not be negative
    metric: Metric
    # (n_bodies,): units of each body's matrix [kg] and [m]
    mass_scale: np.ndarray
    length_scale: np.ndarray
    # (n_features,): where unseen directions are pulled; None for the vector
    anchor: np.ndarray | None

    @classmethod
    def of(cls, rows, constraint, metric, options, parameter_names=None):
        """Validate the settings for rows (n_samples, n_features)."""
        check_constraint(constraint)
        n_features = rows.shape[1]
        bodies, nonnegative = resolve_layout(n_features, options, parameter_names)
        anchor = options.anchor
        if anchor is not None:
            anchor = column_or_1d(anchor, dtype=np.float64, input_name="anchor")
            assert_all_finite(anchor, input_name="anchor")
            check_consistent_length(anchor, rows.T)
        if metric is not None:
            metric = check_metric(metric, n_features)
            rows = np.array([metric.visible_part(row)[0] for row in rows])
        # The anchor is usually a plausible robot.
        source = rows if anchor is None else anchor[None]
        mass_scale, length_scale = body_scales(source[:, bodies])
        if metric is None:
            # Each parameter counts in its own unit: those of a body in units of its
            # scales, others in units of their root mean square, 1 for zeros.
            units = np.sqrt(np.mean(rows**2, axis=0))
            units[units == 0] = 1.0
            units[bodies] = parameter_units(mass_scale, length_scale)
            metric = check_metric(np.diag(units**-2.0), n_features)
        return cls(
            constraint=constraint,
            margin=options.margin,
            bodies=bodies,
            nonnegative=nonnegative,
            metric=metric,
            mass_scale=mass_scale,
            length_scale=length_scale,
            anchor=anchor,
        )

    @one_blas_thread()
    def __call__(self, theta):
        """Project one vector (n_features,)."""
        theta = self.metric.without_rounding(theta)
        bodies, kept = self.bodies, self.nonnegative
        enough = self._eigenvalues(theta) >= self.margin
        if np.all(enough) and np.all(theta[kept] >= 0):
            return theta.copy()
        units, scaled_root = self._scale(theta)
        # One common factor brings bodies far from their scales back near one.
        common = np.abs((theta / units)[bodies]).max(initial=0.0)
        common = common if common > 0 else 1.0
        units = units * common
        programme = Programme.pulled(
            theta / units,
            constraint=self.constraint,
            body_columns=bodies,
            nonnegative=kept,
            margin=self.margin / common,
            metric_root=scaled_root,
            anchor=(theta if self.anchor is None else self.anchor) / units,
        )
        solution = solve(programme)
        if solution.gap > GAP_TARGET:
            _warn_gap(solution)
        return self._settle(solution.vector * units, units, programme)

    def _eigenvalues(self, vector):
        """Smallest eigenvalue of each body's matrix, shape (n_bodies,)."""
        return min_eigenvalue(
            vector[self.bodies],
            self.constraint,
            mass_scale=self.mass_scale,
            length_scale=self.length_scale,
        )

    def _scale(self, theta):
        """Units of the columns, and the metric's root in them, columns up to one."""
        bodies, diagonal = self.bodies, self.metric.size**2
        units = np.ones(theta.size)
        units[bodies] = parameter_units(self.mass_scale, self.length_scale)
        outside = np.ones(theta.size, dtype=bool)
        outside[bodies] = False
        # Columns outside the bodies have no unit of their own: take the one in which
        # their metric equals the largest of the bodies.
        largest = (diagonal * units**2)[~outside].max(initial=0.0)
        seen = outside & (diagonal > 0)
        units[seen] = np.sqrt((largest if largest > 0 else 1.0) / diagonal[seen])
        root = self.metric.root * units
        size = np.linalg.norm(root, axis=0).max(initial=0.0)
        return units, root / size if size > 0 else root

    def _settle(self, vector, units, programme):
        """Make a vector consistent to the last bit in the user's own units."""
        # Division by the units rounds, so an eigenvalue may come out a few rounding
        # errors below the margin; the least lift that restores it is added.
        bodies, kept = self.bodies, self.nonnegative
        least = _ROUNDING * np.abs(vector / units).max(initial=0.0) * units[kept]
        vector[kept] = np.where(vector[kept] > least, vector[kept], 0.0)
        excess = np.finfo(float).eps
        for _ in range(60):
            lacking = self._eigenvalues(vector) < self.margin
            if not lacking.any():
                return vector
            lifted = programme.lift(vector / units, programme.margin + excess)
            changed = bodies[lacking]
            vector[changed] = lifted[changed] * units[changed]
            excess *= 2
        raise ProjectionError(
            "The projection failed: rounding keeps a body's smallest eigenvalue below "
            f"the margin of {self.margin:.1e}. Raise margin."
        )


def _warn_gap(solution):
    """Warn of an answer that is accepted, but not certified as well as was aimed at."""
    warnings.warn(
        f"The projection is certified to a relative gap of {solution.gap:.1e}, and not "
        f"to {GAP_TARGET:.0e}: its squared distance may exceed the least one by that "
        f"share. The solver: {solution.status}. Check the "
        "vector and the metric for columns many orders of magnitude apart.",
        ConvergenceWarning,
        stacklevel=5,
    )
