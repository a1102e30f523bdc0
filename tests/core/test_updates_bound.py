"""The value of the bound."""

import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa._core._updates import (
    data_bound,
    expect_hidden,
    prior_bound,
)
from tests.core import _problems
from tests.core._problems import ARD_RATE, ARD_SHAPE
from tests.reference import paper_jfa as ref


@pytest.mark.parametrize("n_features", [1, 3, 6])
def test_parts_equal_those_of_the_reference(n_features):
    X, y, _ = _problems.make_data(n_features, n_features)
    state = _problems.make_state(n_features, n_features)
    params = _problems.as_vb_params(state)
    hidden = expect_hidden(_problems.as_gram(X, y), state)
    posterior = ref.posterior_zt(X, y, **params.moments())
    data = sum(ref.data_terms(X, y, posterior, **params.moments()).values())
    # 25 samples in sums of size 1e2: rounding 1e-14, times the reference's inverses.
    assert_allclose(data_bound(_problems.as_gram(X, y), hidden), data, rtol=1e-10)
    prior = _problems.make_prior("paper", 25, n_features)
    expected = sum(ref.prior_terms(params, ARD_SHAPE, ARD_RATE).values())
    assert_allclose(prior_bound(state, prior), expected, rtol=1e-10)
