"""The chain out of scikit-learn's own parts: pipelines and searches."""

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline

from sklearn_vbjfa import (
    JointTorqueRegressor,
    RigidBodyFeatures,
    RobotIdentifier,
    StateEstimator,
)
from sklearn_vbjfa.datasets import make_robot_recording
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


# -- features, regressor and projector in one


def test_the_identifier_is_the_same_chain(recording):
    groups = recording.groups
    robot = RobotIdentifier(
        recording.urdf,
        dt=recording.dt,
        friction=FRICTION,
        projector=None,
        cutoff=None,
        options=FitOptions(state_cutoff=6.0, standstill=None),
        regressor=LinearRegression(),
    ).fit(recording.q, recording.tau, groups=groups)
    states = StateEstimator(recording.dt, cutoff=6.0).fit_transform(
        recording.q, groups=groups
    )
    chain = pipeline(recording, regressor=LinearRegression())
    # The identifier leaves out one period of the state cut-off at both ends.
    edge = int(1 / (6.0 * recording.dt))
    inside = np.ones(groups.size)
    for label in np.unique(groups):
        rows = np.flatnonzero(groups == label)
        inside[rows[:edge]] = inside[rows[-edge:]] = 0
    chain.fit(
        states,
        recording.tau,
        identify__sample_weight=inside,
    )
    Phi = chain[:-1].transform(states[:40])
    np.testing.assert_allclose(
        chain["identify"].predict(Phi), robot.predict(states[:40]), rtol=1e-7, atol=1e-7
    )
    rows = robot.estimate_.moments.n_rows
    np.testing.assert_array_equal(chain["identify"].n_rows_, rows)
