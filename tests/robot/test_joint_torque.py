"""One parameter vector from all joints: weights, filter, swapped regressors."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.cross_decomposition import PLSRegression
from sklearn.ensemble import RandomForestRegressor
from sklearn.linear_model import LassoCV, LinearRegression, Ridge
from sklearn.model_selection import GridSearchCV, KFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.tree import DecisionTreeRegressor

from sklearn_vbjfa import (
    JointTorqueRegressor,
    PhysicalProjector,
    TotalLeastSquares,
    VBJFARegressor,
)
from tests.model._robots import (
    joint_equations,
    random_body,
    weighted_least_squares,
    wide,
)

NOISE = np.array([0.1, 1.0, 10.0])


def fitted(Phi, tau, regressor=None, projector=None, fit=None, **settings):
    regressor = LinearRegression() if regressor is None else regressor
    model = JointTorqueRegressor(regressor, projector, **settings)
    return model.fit(wide(Phi), tau, **(fit or {}))


@pytest.fixture
def rng():
    return np.random.default_rng(20)


def test_is_weighted_least_squares(rng):
    Phi, tau, _ = joint_equations(rng, noise=NOISE)
    given = np.array([3.0, 0.2, 1.5])
    expected = weighted_least_squares(Phi, tau, np.tile(given, (300, 1)))
    model = fitted(Phi, tau, joint_weights=given)
    np.testing.assert_allclose(model.theta_, expected, rtol=1e-10)
    np.testing.assert_allclose(model.predict(wide(Phi)), Phi @ expected, rtol=1e-9)
    unweighted = weighted_least_squares(Phi, tau, np.ones((300, 3)))
    plain = fitted(Phi, tau, joint_weights=None)
    np.testing.assert_allclose(plain.theta_, unweighted, rtol=1e-10)


def test_automatic_weights_are_iterated_to_their_fixed_point(rng):
    Phi, tau, theta = joint_equations(rng, n=2000, noise=NOISE)
    model = fitted(Phi, tau)
    weight = np.ones(3)
    for _ in range(50):
        estimate = weighted_least_squares(
            Phi[:200], tau[:200], np.tile(weight, (200, 1))
        )
        weight = 1 / np.mean((tau[:200] - Phi[:200] @ estimate) ** 2, axis=0)
    small = fitted(Phi[:200], tau[:200])
    # the iteration stops when no variance changes by more than 1e-6
    np.testing.assert_allclose(small.joint_weights_, weight, rtol=1e-5)
    np.testing.assert_allclose(small.theta_, estimate, rtol=1e-6)
    # a variance from 2000 residuals has a deviation of sqrt(2 / 2000) = 3.2 %
    np.testing.assert_allclose(model.joint_weights_ * NOISE**2, 1, atol=0.13)
    # and the weighting pays: the third joint's noise would drown the rest
    plain = fitted(Phi, tau, joint_weights=None)
    error = [np.linalg.norm((m.theta_ - theta) / theta) for m in (model, plain)]
    assert error[0] < 0.2 * error[1]


@pytest.mark.parametrize(
    ("regressor", "rtol"),
    [
        (LinearRegression(), 1e-9),
        (Ridge(alpha=1e-8), 1e-8),
        (PLSRegression(n_components=5, scale=False), 1e-8),
        (TotalLeastSquares(), 1e-6),
        # The smallest penalty, 1e-6 of the largest, shrinks the weakest column, which
        # explains 1e-4 of the torque.
        (LassoCV(cv=KFold(4), alphas=30, eps=1e-6, tol=1e-6, max_iter=20_000), 0.05),
        (VBJFARegressor(latent="correlated"), 1e-6),
        (make_pipeline(StandardScaler(), LinearRegression()), 1e-8),
        (
            GridSearchCV(
                PLSRegression(scale=False), {"n_components": [2, 5]}, cv=KFold(4)
            ),
            1e-8,
        ),
    ],
    ids=lambda value: type(value).__name__,
)
def test_any_linear_regressor_finds_the_parameters(rng, regressor, rtol):
    # Columns of mean 3: a regressor that centred them would lose information.
    Phi, _, theta = joint_equations(rng)
    Phi += 3.0 * np.geomspace(0.1, 10, 5)
    before = clone(regressor).get_params(deep=False).keys()
    model = fitted(Phi, Phi @ theta, regressor)
    np.testing.assert_allclose(model.theta_, theta, rtol=rtol)
    np.testing.assert_allclose(model.predict(wide(Phi)), Phi @ theta, rtol=10 * rtol)
    assert regressor.get_params(deep=False).keys() == before
    assert not hasattr(regressor, "coef_")  # the one given is a pattern


def test_vb_from_second_moments_is_vb_on_the_rows(rng):
    Phi, tau, _ = joint_equations(rng, noise=NOISE)
    model = fitted(Phi, tau, VBJFARegressor(latent="correlated"))
    root = np.sqrt(model.joint_weights_)
    direct = VBJFARegressor(latent="correlated", input_noise=0.0, fit_intercept=False)
    direct.fit((Phi * root[:, None]).reshape(-1, 5), (tau * root).ravel())
    np.testing.assert_allclose(model.theta_, direct.coef_, rtol=1e-6)


@pytest.mark.parametrize(
    "regressor", [DecisionTreeRegressor(), RandomForestRegressor(n_estimators=5)]
)
def test_refuses_a_regressor_that_is_not_linear(rng, regressor):
    Phi, tau, _ = joint_equations(rng)
    name = type(regressor).__name__
    with pytest.raises(ValueError, match=f"must be linear in its inputs.*got {name}"):
        fitted(Phi, tau, regressor)


# -- sample weights


REGRESSORS = [
    LinearRegression(),
    PLSRegression(n_components=3, scale=False),
    VBJFARegressor(latent="correlated"),
]


# Not Ridge: weights go into the rows with mean one, so that a mean of squares (Lasso)
# keeps its size; a sum of squares against a penalty then sees fewer rows.
@pytest.mark.parametrize("regressor", REGRESSORS, ids=lambda r: type(r).__name__)
def test_weight_two_is_the_sample_twice(rng, regressor):
    Phi, tau, _ = joint_equations(rng, noise=NOISE)
    times = rng.integers(0, 3, size=300)
    weighted = fitted(Phi, tau, regressor, fit={"sample_weight": times.astype(float)})
    repeated = fitted(
        np.repeat(Phi, times, axis=0), np.repeat(tau, times, axis=0), regressor
    )
    np.testing.assert_allclose(weighted.theta_, repeated.theta_, rtol=1e-6)
    np.testing.assert_allclose(
        weighted.joint_weights_, repeated.joint_weights_, rtol=1e-9
    )


def test_projector_gets_the_metric_of_the_fit(rng):
    body = np.append(random_body(rng), 0.3)
    Phi = rng.normal(size=(80, 2, 11))
    tau = Phi @ body + 3.0 * rng.normal(size=(80, 2))
    projector = PhysicalProjector()
    model = fitted(Phi, tau, None, projector)
    expected = sum(model.joint_weights_[j] * Phi[:, j].T @ Phi[:, j] for j in range(2))
    np.testing.assert_allclose(model.metric_, expected, rtol=1e-10, atol=1e-8)
    assert model.projector_.metric is model.metric_
    assert projector.metric is None  # the one given is a pattern
    by_hand = PhysicalProjector(metric=expected)
    by_hand.fit(model.theta_unconstrained_[None])
    np.testing.assert_allclose(
        model.theta_, by_hand.transform(model.theta_unconstrained_[None])[0], rtol=1e-6
    )
    with pytest.raises(AssertionError):  # it had something to do
        np.testing.assert_allclose(model.theta_, model.theta_unconstrained_, rtol=1e-3)


def test_one_output_keeps_one_dimension(rng):
    Phi, tau, _ = joint_equations(rng, nv=1)
    flat = JointTorqueRegressor(LinearRegression()).fit(wide(Phi), tau[:, 0])
    assert flat.predict(wide(Phi)).shape == (300,)
    column = JointTorqueRegressor(LinearRegression()).fit(wide(Phi), tau)
    assert column.predict(wide(Phi)).shape == (300, 1)
    np.testing.assert_array_equal(flat.theta_, column.theta_)


@pytest.mark.parametrize(
    ("settings", "fit", "message"),
    [
        (
            {"joint_weights": "even"},
            {},
            r"'auto', None or an array.*\(3,\); got 'even'",
        ),
        ({"joint_weights": [1.0, -1.0, 1.0]}, {}, "must hold 3 finite, non-negative"),
        ({}, {"sample_weight": np.ones(5)}, r"shape \(300,\) or \(300, 3\); got \(5,"),
        ({}, {"sample_weight": np.full(300, np.nan)}, "finite and not negative"),
        ({}, {"sample_weight": np.zeros(300)}, "at least one non-zero number"),
    ],
)
def test_errors_say_what_to_do(rng, settings, fit, message):
    Phi, tau, _ = joint_equations(rng)
    with pytest.raises(ValueError, match=message):
        fitted(Phi, tau, **settings, fit=fit)
