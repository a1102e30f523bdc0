"""Methods side by side: the same data, the same judge."""

import numpy as np
import pytest
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV, KFold

pytest.importorskip("pinocchio")

from sklearn_vbjfa import RobotIdentifier, StepwiseRegressor
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.robot import OURS, _comparison, compare_methods, methods
from tests.model._robots import swing


@pytest.fixture(scope="module")
def parts(simulated):
    rows = [np.flatnonzero(simulated.groups == k) for k in (0, 1)]
    return [(simulated.q[r], simulated.tau[r], simulated.groups[r]) for r in rows]


@pytest.fixture(scope="module")
def compared(simulated, parts):
    identifier = RobotIdentifier(
        simulated.urdf,
        dt=simulated.dt,
        friction=("viscous", "coulomb"),
    )
    names = ["VB + description", OURS, "VB", "OLS", "WLS", "stepwise", "TLS", "IV"]
    results, base = compare_methods(identifier, *parts, names=names)
    return {result.name: result for result in results}, base


@pytest.mark.parametrize("noise", [0.1, 3.0])
def test_partial_least_squares_are_those_of_their_rows(noise):
    rng, components = np.random.default_rng(0), [1, 2, 3, 5, 8]
    X = 2.0 + rng.normal(size=(997, 9)) * np.geomspace(1, 1e-3, 9)
    y = X @ rng.normal(size=9) + noise * np.cumsum(rng.normal(size=997)) / 30
    of_rows = GridSearchCV(
        PLSRegression(scale=False),
        {"n_components": components},
        cv=KFold(5),
        scoring="neg_mean_squared_error",
    ).fit(X, y)
    found = _comparison.PartialLeastSquares(components=components).fit(X, y)
    assert found.n_components_ == of_rows.best_params_["n_components"]
    expected = of_rows.best_estimator_
    np.testing.assert_allclose(found.coef_, np.ravel(expected.coef_), rtol=1e-9)
    np.testing.assert_allclose(found.predict(X), np.ravel(expected.predict(X)))


def test_partial_least_squares_end_where_nothing_is_left():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 3)) @ rng.normal(size=(3, 6))
    y = X @ rng.normal(size=6)
    found = _comparison.PartialLeastSquares(components=[1, 5, 6]).fit(X, y)
    np.testing.assert_allclose(found.predict(X), y, atol=1e-10)


def test_every_method_is_fitted_and_judged(compared):
    results, _ = compared
    for result in results.values():
        assert result.message == ""
        assert result.error.shape == result.train_error.shape == (6,)
        assert np.all(np.isfinite(result.error))
    assert results[OURS].n_inconsistent == 0
    assert results[OURS].min_eigenvalue > 0
    assert results["VB"].n_inconsistent > 0
    assert results["VB"].min_eigenvalue < 0


def test_results_are_those_of_the_identifier(simulated, parts, compared):
    results, base = compared
    (q, tau, groups), (q_test, tau_test, groups_test) = parts
    for name, settings in (
        ("VB + description", {}),
        (OURS, {"bodies": "free"}),
        ("WLS", {"regressor": LinearRegression(), "projector": None}),
        (
            "OLS",
            {
                "regressor": LinearRegression(),
                "projector": None,
                "joint_weights": None,
            },
        ),
        ("stepwise", {"regressor": StepwiseRegressor(), "projector": None}),
    ):
        robot = RobotIdentifier(
            simulated.urdf,
            dt=simulated.dt,
            friction=("viscous", "coulomb"),
            **settings,
        ).fit(q, tau, groups=groups)
        error = robot.residuals(q_test, tau_test, groups=groups_test)
        # OLS: directions without information are cut at another rounding
        np.testing.assert_allclose(
            results[name].error, error.normalised_error(), rtol=1e-6
        )
        train = robot.residuals(q, tau, groups=groups).normalised_error()
        np.testing.assert_allclose(results[name].train_error, train, rtol=1e-6)
    assert base.cutoff_ == robot.cutoff_


def test_weighting_helps_the_weak_joints(compared):
    results, _ = compared
    # the wrist's torques are a hundredth of the shoulder's: OLS fits the shoulder
    assert results["WLS"].error[5] < 0.7 * results["OLS"].error[5]


def test_independent_halves_do_as_well_as_the_whole(compared):
    # Encoder noise of 1e-4 rad hardly biases: instruments must not cost much.
    results, _ = compared
    np.testing.assert_allclose(
        results["IV"].error, results["WLS"].error, rtol=0.05, atol=0.002
    )


def test_a_method_that_fails_says_why(simulated, parts, monkeypatch):
    class Fails(LinearRegression):
        def fit(self, X, y, sample_weight=None):
            raise ValueError("no answer")

    chosen = methods(72)
    chosen["WLS"] = {"regressor": Fails(), "projector": None}
    monkeypatch.setattr(_comparison, "methods", lambda n: chosen)
    identifier = RobotIdentifier(simulated.urdf, dt=simulated.dt, friction=("viscous",))
    results, _ = compare_methods(identifier, *parts, names=["WLS", "OLS"])
    assert results[0].message == "no answer"
    assert np.isnan(results[0].error).all()
    assert results[1].message == ""


def test_a_robot_of_one_joint():
    recording = make_robot_recording(swing(), duration=12.0, dt=0.01, random_state=2)
    half = 800
    cut = [
        (recording.q[r], recording.tau[r], recording.groups[r])
        for r in (slice(0, half), slice(half, None))
    ]
    names = [OURS, "VB", "OLS", "WLS", "ridge", "LASSO", "PLS", "stepwise", "TLS"]
    results, _ = compare_methods(
        RobotIdentifier(swing(), dt=0.01, friction=("viscous", "coulomb")),
        *cut,
        names=names,
    )
    assert [r.message for r in results] == [""] * len(names)
    # 5 % of torque noise, of which the filter passes a part
    assert all(result.error[0] < 0.05 for result in results)


def test_the_settings_name_every_family():
    chosen = methods(72)
    assert next(iter(chosen)) == OURS
    assert {"OLS", "PLS", "LASSO", "ridge", "stepwise", "TLS", "IV"} < set(chosen)
    # all but ours leave the parameters as estimated
    projected = [n for n, settings in chosen.items() if settings["projector"]]
    assert projected == [OURS, "VB + description"]
