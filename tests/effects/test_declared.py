"""Columns of declared friction equal those of the effects with the same names."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import Motion, Rest
from tests.effects._arms import motion

T, X = motion(2, duration=6.0, seed=3)
Q, V, A = np.split(X, 3, axis=1)
REST = Rest(speed=np.array([0.3, 0.1]), time=np.full(2, 0.1), noise=np.full(2, 0.01))


@pytest.mark.parametrize("rest", [None, REST])
@pytest.mark.parametrize("joint", [0, 1])
def test_declared_columns_equal_the_effects_columns(joint, rest):
    names = effects.declarable()
    assert names == ("viscous", "coulomb", "offset", "rotor_inertia")
    columns = effects.declared_columns(names, V, A, rest)
    assert columns.shape == (*V.shape, len(names))
    signals = Motion(q=Q, v=V, a=A, rest=rest)
    for k, effect in enumerate(effects.resolve(names)):
        column = effect.set_params(joint=joint).columns(signals)
        assert_array_equal(columns[:, [joint], k], column)
