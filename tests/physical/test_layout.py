"""Layout of the parameter vector: by length, explicit, and by names."""

import numpy as np
import pytest

from sklearn_vbjfa.physical import INERTIAL_NAMES, Options, PhysicalProjector

pytestmark = pytest.mark.filterwarnings("error")


def layout(n_features, names=None, **options):
    """First columns of the bodies and the non-negative columns."""
    projector = PhysicalProjector(parameter_names=names, options=Options(**options))
    projector.fit(np.ones((1, n_features)))
    return projector.body_starts_.tolist(), projector.nonnegative_.tolist()


@pytest.mark.parametrize(
    ("n_features", "starts", "nonnegative"),
    [(10, [0], []), (70, range(0, 70, 10), []), (33, [0, 11, 22], [10, 21, 32])],
)
def test_the_length_gives_the_layout(n_features, starts, nonnegative):
    assert layout(n_features) == (list(starts), nonnegative)


@pytest.mark.parametrize(("n_features", "names"), [(24, None), (12, ["a"])])
def test_wrong_layouts_are_refused(n_features, names):
    with pytest.raises(ValueError, match="parameter_names"):
        layout(n_features, names)


def names_of(*joints):
    """Column names of joints, each a pair of name and extra columns."""
    names = []
    for joint, extras in joints:
        names += [f"{joint}:{name}" for name in (*INERTIAL_NAMES, *extras)]
    return names


def test_explicit_columns_take_precedence_over_names():
    names = names_of(("a", ("viscous", "offset")), ("b", ("viscous", "offset")))
    assert layout(24, names) == ([0, 12], [10, 22])
    assert layout(24, names, body_starts=[12], nonnegative=[11]) == ([12], [11])
