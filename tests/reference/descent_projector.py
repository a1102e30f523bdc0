"""The projection of eq. 35 by descent in the virtual parameters, as a projector."""

from dataclasses import replace
from unittest import mock

import numpy as np

from sklearn_vbjfa.physical import (
    PhysicalProjector,
    ProjectionError,
    _projection,
    _solver,
)
from tests.reference.virtual_parameters import descend

# Steps are cheaper and more numerous than those of the interior-point method.
_STEPS = 2000
# Excess of the squared distance up to which an answer is accepted, relative.
_LIMIT = 1e-4


class DescentProjector(PhysicalProjector):
    """Project in the virtual parameters of eq. 30, as the paper does.

    Parameters and attributes are those of `PhysicalProjector` with
    ``constraint="eq30"``.
    """

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
    return _solver.CertifiedVector(
        vector=vector, gap=max(excess, 0.0), n_iter=steps, status=message
    )
