"""The chain out of scikit-learn's own parts: pipelines and searches."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import LassoCV, LinearRegression
from sklearn.model_selection import GridSearchCV, GroupKFold, KFold
from sklearn.pipeline import Pipeline

pytest.importorskip("pinocchio")

from sklearn_vbjfa import (
    JointTorqueRegressor,
    PhysicalProjector,
    RigidBodyFeatures,
    RobotIdentifier,
    StateEstimator,
    VBJFARegressor,
)
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.physical import Options

FRICTION = ("viscous", "coulomb")


@pytest.fixture(scope="module")
def recording():
    return make_robot_recording(
        duration=10.0, dt=0.02, frequency=1.0, n_recordings=2, random_state=5
    )


def pipeline(recording, **settings):
    return Pipeline(
        [
            ("features", RigidBodyFeatures(recording.urdf, friction=FRICTION)),
            ("identify", JointTorqueRegressor(**settings)),
        ]
    )


def test_search_swaps_the_regressor(recording):
    X, y = recording.states, recording.tau
    blocks = np.arange(X.shape[0]) // 100  # stretches of 2 s
    candidates = [
        VBJFARegressor(latent="correlated"),
        LassoCV(cv=KFold(3), alphas=10, tol=1e-3, max_iter=5000),
        PLSRegression(n_components=30, scale=False),
        PLSRegression(n_components=1, scale=False),
    ]
    search = GridSearchCV(
        pipeline(recording), {"identify__regressor": candidates}, cv=GroupKFold(4)
    )
    search.fit(X, y, groups=blocks)
    scores = search.cv_results_["mean_test_score"]
    assert np.all(np.isfinite(scores))
    # 5 % of torque noise leaves an R^2 of 1 - 0.05^2; one component cannot do it
    assert scores[0] > 0.995
    assert scores[2] > 0.98
    assert scores[3] < 0.9
    assert search.best_params_["identify__regressor"] is candidates[0]
    # every fold was really fitted with that regressor, and tested on whole blocks
    best = search.best_estimator_["identify"]
    assert isinstance(best.regressor_, VBJFARegressor)
    train = np.isin(blocks, np.unique(blocks)[:8])
    refitted = pipeline(recording, regressor=candidates[0]).fit(X[train], y[train])
    assert refitted.score(X[~train], y[~train]) == pytest.approx(scores[0], abs=0.003)


def test_from_positions_to_a_possible_robot(recording):
    friction = [12 * j + 10 + k for j in range(6) for k in range(2)]
    chain = Pipeline(
        [
            ("states", StateEstimator(recording.dt)),
            ("features", RigidBodyFeatures(recording.urdf, friction=FRICTION)),
            (
                "identify",
                JointTorqueRegressor(
                    projector=PhysicalProjector(
                        options=Options(
                            body_starts=12 * np.arange(6), nonnegative=friction
                        )
                    ),
                    dt=recording.dt,
                    cutoff=5.0,
                ),
            ),
        ]
    )
    groups = recording.groups
    chain.fit(
        recording.q,
        recording.tau,
        states__groups=groups,
        identify__groups=groups,
    )
    theta = chain["identify"].theta_.reshape(6, 12)
    assert np.all(theta[:, 10:] >= 0)
    # A consistent vector comes back as it is.
    row = theta.reshape(1, -1)
    assert np.array_equal(chain["identify"].projector_.transform(row), row)
    test = make_robot_recording(
        duration=8.0,
        dt=0.02,
        inertial=recording.inertial,
        friction=recording.friction,
        random_state=6,
    )
    error = chain.predict(test.q) - test.tau_clean
    # positions of 1e-4 rad at 50 Hz, Coulomb friction at the wrong sample
    assert np.all(np.mean(error**2, axis=0) < 0.02 * test.tau_clean.var(axis=0))


# -- features, regressor and projector in one


@pytest.fixture(scope="module")
def framed(recording):
    """Pipeline with names: nothing is said of bodies, friction or their signs."""
    pytest.importorskip("pandas")
    chain = pipeline(
        recording, regressor=LinearRegression(), projector=PhysicalProjector()
    )
    return chain.set_output(transform="pandas")


def short(recording):
    """Return a second of a recording."""
    rows = slice(0, 50)
    return recording.states[rows], recording.tau[rows]


def test_the_projector_takes_signs_and_bodies_from_names(recording, framed):
    X, y = short(recording)
    # a channel in which friction would drive the third joint
    y = y.copy()
    y[:, 2] -= 2 * recording.friction["coulomb"][2] * np.sign(X[:, 8])
    model = clone(framed).fit(X, y)
    found = model["identify"]
    assert found.parameter_names_ == model["features"].parameter_names_
    by_hand = pipeline(
        recording,
        regressor=LinearRegression(),
        projector=PhysicalProjector(
            options=Options(
                body_starts=12 * np.arange(6),
                nonnegative=[12 * j + 10 + k for j in range(6) for k in range(2)],
            )
        ),
    ).fit(X, y)
    np.testing.assert_array_equal(found.theta_, by_hand["identify"].theta_)
    # and there was something to do
    raw = found.theta_unconstrained_.reshape(6, 12)
    assert raw[2, 11] < 0
    assert found.theta_.reshape(6, 12)[:, 10:].min() >= 0
    assert framed["identify"].projector.parameter_names is None


def test_the_identifier_is_the_same_chain(recording):
    groups = recording.groups
    robot = RobotIdentifier(
        recording.urdf,
        dt=recording.dt,
        friction=FRICTION,
        projector=None,
        cutoff=5.0,
        state_cutoff=6.0,
        standstill=None,
        regressor=LinearRegression(),
    ).fit(recording.q, recording.tau, groups=groups)
    states = StateEstimator(recording.dt, cutoff=6.0).fit_transform(
        recording.q, groups=groups
    )
    chain = pipeline(
        recording, regressor=LinearRegression(), dt=recording.dt, cutoff=5.0
    )
    # The identifier leaves out one period of the state cut-off at both ends.
    edge = int(1 / (6.0 * recording.dt))
    inside = np.ones(groups.size)
    for label in np.unique(groups):
        rows = np.flatnonzero(groups == label)
        inside[rows[:edge]] = inside[rows[-edge:]] = 0
    chain.fit(
        states,
        recording.tau,
        identify__groups=groups,
        identify__sample_weight=inside,
    )
    Phi = chain[:-1].transform(states[:40])
    np.testing.assert_allclose(
        chain["identify"].predict(Phi), robot.predict(states[:40]), rtol=1e-7, atol=1e-7
    )
    np.testing.assert_array_equal(chain["identify"].n_rows_, robot.estimator_.n_rows_)
