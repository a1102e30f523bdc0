"""The chain out of scikit-learn's own parts: pipelines and searches."""

import numpy as np
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline

from sklearn_vbjfa import (
    JointTorqueRegressor,
    RigidBodyFeatures,
    RobotIdentifier,
    StateEstimator,
)
from sklearn_vbjfa.robot import FitOptions

FRICTION = ("viscous", "coulomb")


def test_the_identifier_is_the_same_chain(simulated):
    groups = simulated.groups
    robot = RobotIdentifier(
        simulated.urdf,
        dt=simulated.dt,
        friction=FRICTION,
        projector=None,
        cutoff=None,
        options=FitOptions(state_cutoff=6.0, standstill=None),
        regressor=LinearRegression(),
    ).fit(simulated.q, simulated.tau, groups=groups)
    states = StateEstimator(simulated.dt, cutoff=6.0).fit_transform(
        simulated.q, groups=groups
    )
    chain = Pipeline(
        [
            ("features", RigidBodyFeatures(simulated.urdf, friction=FRICTION)),
            ("identify", JointTorqueRegressor(LinearRegression())),
        ]
    )
    # The identifier leaves out one period of the state cut-off at both ends.
    edge = int(1 / (6.0 * simulated.dt))
    inside = np.ones(groups.size)
    for label in np.unique(groups):
        rows = np.flatnonzero(groups == label)
        inside[rows[:edge]] = inside[rows[-edge:]] = 0
    chain.fit(states, simulated.tau, identify__sample_weight=inside)
    Phi = chain[:-1].transform(states[:40])
    np.testing.assert_allclose(
        chain["identify"].predict(Phi), robot.predict(states[:40]), rtol=1e-7, atol=1e-7
    )
    rows = robot.estimate_.moments.n_rows
    assert (rows == inside.sum()).all()
