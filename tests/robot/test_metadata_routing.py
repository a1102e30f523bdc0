"""Groups, weights and times find their way, with metadata routing on and off."""

import numpy as np
import pytest
import sklearn
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.metrics import r2_score
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_validate
from sklearn.pipeline import Pipeline

from sklearn_vbjfa import (
    JointTorqueRegressor,
    RigidBodyFeatures,
    RobotIdentifier,
    StateEstimator,
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


def chain(recording):
    return Pipeline(
        [
            ("states", StateEstimator(DT, cutoff=8.0)),
            ("features", RigidBodyFeatures(recording.urdf)),
            ("torque", JointTorqueRegressor(LinearRegression())),
        ]
    )


def routed_chain(recording, weighted=True):
    found = chain(recording)
    found["states"].set_fit_request(groups=True).set_transform_request(groups=True)
    found["torque"].set_fit_request(sample_weight=weighted)
    found["torque"].set_score_request(sample_weight=weighted)
    return found


def by_hand(recording, weight, train, test):
    """Fit and score the chain step by step, without a pipeline; R^2 on `test`."""
    states, features, torque = (clone(step) for _, step in chain(recording).steps)
    groups, y = recording.groups, recording.tau
    seen = states.fit_transform(recording.q[train], groups=groups[train])
    w = None if weight is None else weight[train]
    torque.fit(features.fit_transform(seen), y[train], sample_weight=w)
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


def test_groups_need_no_ceremony(recording, routing):
    q, tau, groups = recording.q, recording.tau, recording.groups
    grid = {"states__cutoff": [6.0, 8.0]}
    search = GridSearchCV(chain(recording), grid, cv=FOLDS, error_score="raise")
    search.fit(q, tau, groups=groups)
    asked = GridSearchCV(routed_chain(recording), grid, cv=FOLDS)
    asked.fit(q, tau, groups=groups)
    scores = (found.cv_results_["mean_test_score"] for found in (search, asked))
    np.testing.assert_array_equal(*scores)
    # each recording is differentiated by itself, also to predict and to score
    best = search.best_estimator_
    assert best.score(q, tau, groups=groups) > best.score(q, tau)
    expected = r2_score(tau, best.predict(q, groups=groups))
    assert best.score(q, tau, groups=groups) == expected


def identifier(recording):
    return RobotIdentifier(
        recording.urdf, dt=DT, cutoff=5.0, projector=None, friction=("viscous",)
    )


def test_cross_validation_of_the_identifier(recording, weight, routing):
    robot = identifier(recording)
    robot.set_fit_request(groups=True, sample_weight=True, t=True)
    robot.set_score_request(groups=True, sample_weight=True, t=True)
    # one clock over all recordings; torques of no weight have no effect
    t = recording.t + 10.0 * recording.groups
    result = cross_validate(
        robot,
        recording.q,
        recording.tau + 50.0 * (weight == 0)[:, None],
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
