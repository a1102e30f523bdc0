"""scikit-learn's own checks of the projector; none is expected to fail."""

import pytest
from sklearn.utils.estimator_checks import parametrize_with_checks

from sklearn_vbjfa.physical import PhysicalProjector


# The checks use tables narrower than one body; the warning says that nothing is bound.
@pytest.mark.filterwarnings("ignore:.*too few for a body:UserWarning")
@parametrize_with_checks(
    [
        PhysicalProjector(),
        PhysicalProjector("eq30"),
    ]
)
def test_sklearn_checks(estimator, check):
    check(estimator)
