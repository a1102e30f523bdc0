"""The chain out of scikit-learn's own parts: pipelines and searches."""

import pickle

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import Lasso, LassoCV, LinearRegression
from sklearn.model_selection import GridSearchCV, GroupKFold, KFold, cross_val_score
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


def test_groups_reach_the_filter_through_a_search(recording):
    chain = pipeline(recording, regressor=LinearRegression(), dt=0.02, cutoff=6.0)
    labels = np.arange(recording.q.shape[0]) // 250
    X, y = recording.states, recording.tau
    fit = {"identify__groups": labels}
    scores = cross_val_score(
        chain, X, y, groups=labels, cv=GroupKFold(4), params=fit, error_score="raise"
    )
    for score, (train, test) in zip(scores, GroupKFold(4).split(X, y, labels)):
        alone = pipeline(recording, regressor=LinearRegression(), dt=0.02, cutoff=6.0)
        alone.fit(X[train], y[train], identify__groups=labels[train])
        assert alone.score(X[test], y[test]) == pytest.approx(score, rel=1e-9)
        blind = pipeline(recording, regressor=LinearRegression(), dt=0.02, cutoff=6.0)
        blind.fit(X[train], y[train])
        assert blind["identify"].n_rows_.sum() > alone["identify"].n_rows_.sum()


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


def test_an_offset_keeps_its_sign(recording):
    pytest.importorskip("pandas")
    chain = Pipeline(
        [
            ("features", RigidBodyFeatures(recording.urdf, friction=("offset",))),
            (
                "identify",
                JointTorqueRegressor(LinearRegression(), PhysicalProjector()),
            ),
        ]
    ).set_output(transform="pandas")
    shift = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0]) * recording.tau.std(axis=0)
    chain.fit(recording.states, recording.tau_clean + shift)
    model = chain["identify"]
    offsets = model.theta_[10::11]
    assert model.projector_.nonnegative_.size == 0
    # eleven columns without names are the paper's: friction, not negative
    assert np.all(np.sign(offsets) == np.sign(shift))


def test_without_names_the_pipeline_says_what_to_do(recording):
    chain = pipeline(recording, projector=PhysicalProjector())
    with pytest.raises(ValueError, match=r'set_output\(transform="pandas"\)'):
        chain.fit(*short(recording))
    names = chain["features"].parameter_names_
    chain.set_params(identify__projector__parameter_names=names)
    assert chain.fit(*short(recording))["identify"].projector_.nonnegative_.size == 12


def test_the_projector_works_on_a_frame_of_parameters(recording):
    pandas = pytest.importorskip("pandas")
    robot = RobotIdentifier(
        recording.urdf, dt=recording.dt, friction=("viscous", "offset"), projector=None
    ).fit(recording.q, recording.tau, groups=recording.groups)
    frame = pandas.DataFrame([robot.theta_], columns=robot.parameter_names_)
    projector = PhysicalProjector().set_output(transform="pandas")
    projected = projector.fit_transform(frame)
    assert list(projected.columns) == list(robot.parameter_names_)
    signs = [robot.parameter_names_[k] for k in projector.nonnegative_]
    assert signs == [f"joint_{j}:viscous" for j in range(1, 7)]


def test_a_search_reaches_regressor_and_projector(recording, framed):
    X, y = recording.states, recording.tau
    blocks = np.arange(X.shape[0]) // 100
    grid = [
        {"identify__regressor": [Lasso()], "identify__regressor__alpha": [1e-3, 1.0]},
        {
            "identify__regressor": [PLSRegression()],
            "identify__regressor__n_components": [1, 20],
            "identify__projector": [None, PhysicalProjector()],
        },
        {
            "identify__regressor": [VBJFARegressor(latent="correlated")],
            "identify__regressor__input_noise": [0.0, 0.01],
            "identify__projector__constraint": ["pseudo-inertia", "eq30"],
            "features__friction": [("viscous",), FRICTION],
        },
    ]
    search = GridSearchCV(framed, grid, cv=GroupKFold(2), error_score="raise")
    search.fit(X, y, groups=blocks)
    scores = search.cv_results_["mean_test_score"]
    assert len(scores) == 2 + 4 + 8
    assert np.all(np.isfinite(scores))
    # useless settings lose: a penalty of 1 in unit columns, a single component
    assert scores[0] > scores[1]
    one, several = scores[[2, 4]], scores[[3, 5]]
    assert min(several) > max(one)
    # the robot has Coulomb friction
    assert search.best_params_.get("features__friction", FRICTION) == FRICTION
    assert search.best_estimator_["identify"].projector_ is not None


def test_copies_of_the_pipeline(recording, framed):
    X, y = short(recording)
    model = clone(framed).fit(X, y)
    for other in (clone(model).fit(X, y), pickle.loads(pickle.dumps(model))):
        np.testing.assert_array_equal(
            other["identify"].theta_, model["identify"].theta_
        )
        np.testing.assert_array_equal(other.predict(X), model.predict(X))


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


def test_names_travel_through_the_pipeline(recording):
    chain = pipeline(recording).fit(recording.states[:200], recording.tau[:200])
    names = chain[:-1].get_feature_names_out()
    assert len(names) == 6 * 72
    assert names[0] == "tau_joint_1/joint_1:m"
    assert names[-1] == "tau_joint_6/joint_6:coulomb"
