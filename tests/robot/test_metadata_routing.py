"""Groups, weights and times find their way, with metadata routing on and off."""

import numpy as np
import pytest
import sklearn
from sklearn.base import clone
from sklearn.exceptions import UnsetMetadataPassedError
from sklearn.linear_model import LassoCV, LinearRegression
from sklearn.metrics import r2_score
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_validate
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.metadata_routing import MetadataRouter

pytest.importorskip("pinocchio")

from sklearn_vbjfa import (
    EffectDiscovery,
    JointTorqueRegressor,
    LocallyWeightedRegressor,
    RigidBodyFeatures,
    RobotIdentifier,
    StateEstimator,
    VBJFARegressor,
)
from sklearn_vbjfa.datasets import make_robot_recording

DT = 0.02
FOLDS = GroupKFold(2)


@pytest.fixture(scope="module")
def recording():
    return make_robot_recording(duration=6.0, dt=DT, n_recordings=4, random_state=5)


@pytest.fixture(scope="module")
def weight(recording):
    """Weights, zero for a second of each recording."""
    weight = np.random.default_rng(0).uniform(0.5, 2.0, size=recording.n_samples)
    weight[recording.t < 1.0] = 0.0
    return weight


@pytest.fixture
def routing():
    with sklearn.config_context(enable_metadata_routing=True):
        yield


class LooksAtRows(LinearRegression):
    """Least squares that keeps what `fit` was given."""

    def fit(self, X, y, sample_weight=None, groups=None):
        self.given_ = {"sample_weight": sample_weight, "groups": groups}
        self.rows_ = X, y
        return super().fit(X, y, sample_weight)


def chain(recording, cutoff=5.0):
    return Pipeline(
        [
            ("states", StateEstimator(DT, cutoff=8.0)),
            ("features", RigidBodyFeatures(recording.urdf)),
            ("torque", JointTorqueRegressor(LinearRegression(), dt=DT, cutoff=cutoff)),
        ]
    )


def routed_chain(recording, weighted=True):
    found = chain(recording)
    found["states"].set_fit_request(groups=True).set_transform_request(groups=True)
    found["torque"].set_fit_request(groups=True, sample_weight=weighted)
    found["torque"].set_score_request(sample_weight=weighted)
    return found


def by_hand(recording, weight, train, test, cutoff=5.0):
    """Fit and score the chain step by step, without a pipeline; R^2 on `test`."""
    states, features, torque = (clone(step) for _, step in chain(recording).steps)
    torque.set_params(cutoff=cutoff)
    groups, y = recording.groups, recording.tau
    seen = states.fit_transform(recording.q[train], groups=groups[train])
    w = None if weight is None else weight[train]
    torque.fit(
        features.fit_transform(seen), y[train], groups=groups[train], sample_weight=w
    )
    unseen = states.transform(recording.q[test], groups=groups[test])
    predicted = torque.predict(features.transform(unseen))
    w = None if weight is None else weight[test]
    return r2_score(y[test], predicted, sample_weight=w)


def splits(recording):
    return list(FOLDS.split(recording.q, recording.tau, recording.groups))


def test_cross_validation_of_the_chain(recording, weight, routing):
    result = cross_validate(
        routed_chain(recording),
        recording.q,
        recording.tau,
        params={"groups": recording.groups, "sample_weight": weight},
        cv=FOLDS,
        error_score="raise",
    )
    expected = [by_hand(recording, weight, *split) for split in splits(recording)]
    np.testing.assert_allclose(result["test_score"], expected, rtol=1e-10)


def test_search_over_the_chain(recording, routing):
    search = GridSearchCV(
        routed_chain(recording),
        {"torque__cutoff": [3.0, 5.0]},
        cv=FOLDS,
        error_score="raise",
    )
    search.fit(recording.q, recording.tau, groups=recording.groups)
    for cutoff, score in zip([3.0, 5.0], search.cv_results_["mean_test_score"]):
        expected = [
            by_hand(recording, None, *split, cutoff=cutoff)
            for split in splits(recording)
        ]
        assert score == pytest.approx(np.mean(expected), rel=1e-10)


def test_the_chain_predicts_recording_by_recording(recording, routing):
    model = routed_chain(recording, weighted=False)
    model.fit(recording.q, recording.tau, groups=recording.groups)
    together = model.predict(recording.q, groups=recording.groups)
    for label in range(4):
        rows = recording.groups == label
        alone = model.predict(recording.q[rows])
        np.testing.assert_allclose(together[rows], alone, rtol=1e-9, atol=1e-9)
    assert not np.allclose(model.predict(recording.q), together)


def test_without_routing_the_steps_are_named(recording, weight):
    model = chain(recording)
    model.fit(
        recording.q,
        recording.tau,
        states__groups=recording.groups,
        torque__groups=recording.groups,
        torque__sample_weight=weight,
    )
    with sklearn.config_context(enable_metadata_routing=True):
        routed = routed_chain(recording).fit(
            recording.q, recording.tau, groups=recording.groups, sample_weight=weight
        )
    np.testing.assert_array_equal(model["torque"].theta_, routed["torque"].theta_)


def test_what_no_step_asked_for_is_refused(recording, weight, routing):
    model = chain(recording)
    with pytest.raises(UnsetMetadataPassedError, match="sample_weight"):
        model.fit(recording.q, recording.tau, sample_weight=weight)


def test_groups_need_no_ceremony(recording, routing):
    q, tau, groups = recording.q, recording.tau, recording.groups
    search = GridSearchCV(
        chain(recording), {"torque__cutoff": [3.0, 5.0]}, cv=FOLDS, error_score="raise"
    )
    search.fit(q, tau, groups=groups)
    asked = GridSearchCV(
        routed_chain(recording), {"torque__cutoff": [3.0, 5.0]}, cv=FOLDS
    )
    asked.fit(q, tau, groups=groups)
    scores = (found.cv_results_["mean_test_score"] for found in (search, asked))
    np.testing.assert_array_equal(*scores)
    # each recording is differentiated by itself, also to predict and to score
    best = search.best_estimator_
    assert best.score(q, tau, groups=groups) > best.score(q, tau)
    expected = r2_score(tau, best.predict(q, groups=groups))
    assert best.score(q, tau, groups=groups) == expected


def test_groups_of_the_identifier_need_no_ceremony(recording, routing):
    q, tau, groups = recording.q, recording.tau, recording.groups
    search = GridSearchCV(
        identifier(recording), {"cutoff": [5.0]}, cv=FOLDS, error_score="raise"
    )
    search.fit(q, tau, groups=groups)
    alone = identifier(recording).fit(q, tau, groups=groups)
    np.testing.assert_array_equal(search.best_estimator_.theta_, alone.theta_)
    train, test = splits(recording)[0]
    alone.fit(q[train], tau[train], groups=groups[train])
    expected = alone.score(q[test], tau[test], groups=groups[test])
    assert search.cv_results_["split0_test_score"] == [expected]
    loop = EffectDiscovery(identifier(recording))
    for method in ("fit", "predict", "score"):
        assert loop.get_metadata_routing().consumes(method, ["groups"]) == {"groups"}


def test_groups_can_be_declined(recording, routing):
    torque = JointTorqueRegressor(LinearRegression(), dt=DT, cutoff=5.0)
    torque.set_fit_request(groups=False)
    model = make_pipeline(RigidBodyFeatures(recording.urdf), torque)
    blind = make_pipeline(RigidBodyFeatures(recording.urdf), clone(torque))
    model.fit(recording.states, recording.tau)
    blind.fit(recording.states, recording.tau)
    np.testing.assert_array_equal(model[-1].theta_, blind[-1].theta_)
    with pytest.raises(TypeError, match="groups"):
        model.fit(recording.states, recording.tau, groups=recording.groups)


# -- the regressor inside -------------------------------------------------------------


def equations(recording):
    features = RigidBodyFeatures(recording.urdf)
    return features.fit_transform(recording.states), recording.tau


def test_an_inner_search_by_recordings(recording, routing):
    Phi, tau = equations(recording)
    lasso = LassoCV(cv=GroupKFold(4), alphas=[1e-4, 1e-3, 1e-2], max_iter=2000, tol=0.1)
    model = JointTorqueRegressor(lasso, joint_weights=None)
    names = model.get_metadata_routing().consumes("fit", ["groups", "sample_weight"])
    assert names == {"groups"}
    model.fit(Phi, tau, groups=recording.groups)
    # the same search by hand, on the scaled equations
    A = Phi.reshape(-1, Phi.shape[1] // 6)
    scale = np.sqrt(np.mean(A**2, axis=0))
    scale[scale == 0] = 1.0
    b = tau.ravel() / np.sqrt(np.mean(tau**2))
    alone = clone(lasso).set_params(fit_intercept=False)
    alone.fit(A / scale, b, groups=np.repeat(recording.groups, 6))
    assert model.regressor_.alpha_ == alone.alpha_
    np.testing.assert_allclose(model.regressor_.mse_path_, alone.mse_path_, rtol=1e-6)


def test_labels_stay_with_their_equations(recording, weight, routing):
    Phi, tau = equations(recording)
    rows = LooksAtRows().set_fit_request(groups=True)
    model = JointTorqueRegressor(rows, joint_weights=None, dt=DT, cutoff=5.0)
    model.fit(Phi, tau, groups=recording.groups, sample_weight=weight)
    given = model.regressor_.given_
    assert given["sample_weight"] is None  # folded into the equations
    counts = [
        JointTorqueRegressor(LinearRegression(), dt=DT, cutoff=5.0)
        .fit(Phi[part], tau[part], sample_weight=weight[part])
        .n_rows_.sum()
        for part in (recording.groups == label for label in range(4))
    ]
    np.testing.assert_array_equal(given["groups"], np.repeat(range(4), counts))


def test_weights_go_to_a_regressor_that_requests_them(recording, weight, routing):
    Phi, tau = equations(recording)
    settings = {"joint_weights": None, "dt": DT, "cutoff": 5.0}
    folded = JointTorqueRegressor(LooksAtRows(), **settings)
    folded.fit(Phi, tau, sample_weight=weight)
    asked = JointTorqueRegressor(
        LooksAtRows().set_fit_request(sample_weight=True), **settings
    )
    asked.fit(Phi, tau, sample_weight=weight)
    w = asked.regressor_.given_["sample_weight"]
    assert w.mean() == pytest.approx(1.0)
    A, b = asked.regressor_.rows_
    np.testing.assert_allclose(folded.regressor_.rows_[0], A * np.sqrt(w)[:, None])
    np.testing.assert_allclose(folded.regressor_.rows_[1], b * np.sqrt(w))
    np.testing.assert_allclose(
        asked.predict(Phi), folded.predict(Phi), atol=1e-6 * np.abs(tau).max()
    )


def test_mirrored_equations_keep_their_labels(recording, routing):
    Phi, tau = equations(recording)
    rows = LooksAtRows().set_fit_request(groups=True)
    model = JointTorqueRegressor(make_pipeline(StandardScaler(), rows))
    model.fit(Phi, tau, groups=recording.groups)
    groups = model.regressor_[-1].given_["groups"]
    np.testing.assert_array_equal(groups, np.repeat(recording.groups, 12))


def test_aliases_are_followed(recording, routing):
    Phi, tau = equations(recording)
    rows = LooksAtRows().set_fit_request(sample_weight="groups", groups=False)
    model = JointTorqueRegressor(rows).fit(Phi, tau, groups=recording.groups)
    given = model.regressor_.given_["sample_weight"]
    np.testing.assert_array_equal(given, np.repeat(recording.groups, 6))


def test_what_is_ignored_stays_ignored(recording, weight, routing):
    model = routed_chain(recording, weighted=False)
    groups = recording.groups
    scored = cross_validate(
        model,
        recording.q,
        recording.tau,
        params={"groups": groups, "sample_weight": weight},
        cv=FOLDS,
        scoring=sklearn.metrics.make_scorer(r2_score).set_score_request(
            sample_weight=True
        ),
        return_estimator=True,
        error_score="raise",
    )
    train, _ = splits(recording)[0]
    plain = clone(model).fit(
        recording.q[train], recording.tau[train], groups=groups[train]
    )
    found = scored["estimator"][0]["torque"]
    np.testing.assert_array_equal(found.theta_, plain["torque"].theta_)


def test_routing_of_the_joint_torques(routing):
    plain = JointTorqueRegressor(LinearRegression()).get_metadata_routing()
    assert isinstance(plain, MetadataRouter)
    assert "regressor" not in dict(iter(plain))
    asking = LinearRegression().set_fit_request(sample_weight=True)
    router = JointTorqueRegressor(asking).get_metadata_routing()
    assert "regressor" in dict(iter(router))
    assert JointTorqueRegressor().get_metadata_routing().consumes("fit", ["x"]) == set()


# -- the whole chain ------------------------------------------------------------------


def identifier(recording):
    return RobotIdentifier(
        recording.urdf, dt=DT, cutoff=5.0, projector=None, friction=("viscous",)
    )


def test_cross_validation_of_the_identifier(recording, weight, routing):
    robot = identifier(recording)
    robot.set_fit_request(groups=True, sample_weight=True, t=True)
    robot.set_score_request(groups=True, sample_weight=True, t=True)
    # one clock over all recordings, in which their order is kept
    t = recording.t + 10.0 * recording.groups
    result = cross_validate(
        robot,
        recording.q,
        recording.tau,
        params={"groups": recording.groups, "sample_weight": weight, "t": t},
        cv=FOLDS,
        error_score="raise",
    )
    groups, expected = recording.groups, []
    for train, test in splits(recording):
        alone = identifier(recording).fit(
            recording.q[train],
            recording.tau[train],
            groups=groups[train],
            sample_weight=weight[train],
            t=t[train],
        )
        predicted = alone.predict(recording.q[test], groups=groups[test], t=t[test])
        expected.append(
            r2_score(recording.tau[test], predicted, sample_weight=weight[test])
        )
    np.testing.assert_allclose(result["test_score"], expected, rtol=1e-10)


def test_score_knows_the_borders_of_recordings(recording):
    groups = recording.groups
    robot = identifier(recording).fit(recording.q, recording.tau, groups=groups)
    score = robot.score(recording.q, recording.tau, groups=groups)
    predicted = robot.predict(recording.q, groups=groups)
    assert score == r2_score(recording.tau, predicted)
    assert score > robot.score(recording.q, recording.tau)


def test_cross_validation_of_the_identifier_without_routing(recording):
    groups = recording.groups
    result = cross_validate(
        identifier(recording),
        recording.q,
        recording.tau,
        groups=groups,
        params={"groups": groups},
        cv=FOLDS,
        error_score="raise",
    )
    train, test = splits(recording)[0]
    alone = identifier(recording)
    alone.fit(recording.q[train], recording.tau[train], groups=groups[train])
    expected = alone.score(recording.q[test], recording.tau[test])
    assert result["test_score"][0] == pytest.approx(expected, rel=1e-10)


def test_metadata_reach_a_discovery(recording, weight, routing):
    q, tau, groups = recording.q, recording.tau, recording.groups
    loop = EffectDiscovery(identifier(recording), effects=["coulomb"], max_effects=1)
    loop.set_fit_request(groups=True, sample_weight=True, t=True)
    loop.set_score_request(groups=True, sample_weight=False, t=True)
    t = recording.t + 10.0 * groups
    inside = (weight > 0).astype(float)
    search = GridSearchCV(loop, {"alpha": [0.05]}, cv=FOLDS, error_score="raise")
    search.fit(q, tau, groups=groups, sample_weight=inside, t=t)
    alone = clone(loop).fit(q, tau, groups=groups, sample_weight=inside, t=t)
    found = search.best_estimator_
    np.testing.assert_array_equal(found.identifier_.theta_, alone.identifier_.theta_)
    expected = r2_score(tau, alone.predict(q, groups=groups, t=t))
    assert found.score(q, tau, groups=groups, t=t) == expected


# -- locally weighted -----------------------------------------------------------------


def test_weights_reach_locally_weighted_models(routing):
    rng = np.random.default_rng(0)
    X = rng.uniform(-3, 3, size=(400, 2))
    y = np.sin(X[:, 0]) + 0.1 * rng.normal(size=400)
    weight = rng.integers(0, 3, size=400).astype(float)
    model = LocallyWeightedRegressor(LinearRegression(), n_models=4)
    with pytest.raises(UnsetMetadataPassedError, match="sample_weight"):
        cross_validate(model, X, y, params={"sample_weight": weight})
    model.set_fit_request(sample_weight=True).set_score_request(sample_weight=True)
    result = cross_validate(
        model,
        X,
        y,
        params={"sample_weight": weight},
        cv=[(np.arange(300), np.arange(300, 400))],
        error_score="raise",
    )
    alone = clone(model).fit(X[:300], y[:300], sample_weight=weight[:300])
    expected = alone.score(X[300:], y[300:], sample_weight=weight[300:])
    assert result["test_score"] == [expected]


def test_a_pipeline_as_local_model(routing):
    rng = np.random.default_rng(0)
    X = rng.uniform(-3, 3, size=(400, 2))
    y = np.sin(X[:, 0])
    scaler = StandardScaler().set_fit_request(sample_weight=True)
    inner = VBJFARegressor(input_noise=0.0).set_fit_request(sample_weight=True)
    model = LocallyWeightedRegressor(make_pipeline(scaler, inner), n_models=4)
    plain = LocallyWeightedRegressor(VBJFARegressor(input_noise=0.0), n_models=4)
    np.testing.assert_allclose(
        model.fit(X, y).predict(X), plain.fit(X, y).predict(X), atol=1e-2
    )
