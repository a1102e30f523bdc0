"""The chain out of scikit-learn's own parts: pipelines and searches."""

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline

pytest.importorskip("pinocchio")

from sklearn_vbjfa import (
    JointTorqueRegressor,
    PhysicalProjector,
    RigidBodyFeatures,
    RobotIdentifier,
    StateEstimator,
)
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.physical import Options
from sklearn_vbjfa.robot import FitOptions

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


def test_the_identifier_is_the_same_chain(recording):
    groups = recording.groups
    robot = RobotIdentifier(
        recording.urdf,
        dt=recording.dt,
        friction=FRICTION,
        projector=None,
        cutoff=5.0,
        options=FitOptions(state_cutoff=6.0, standstill=None),
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
