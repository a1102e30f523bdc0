"""What the columns in front of a torque regressor are: names, and traces of scalers."""

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import (
    MinMaxScaler,
    StandardScaler,
)

from sklearn_vbjfa import JointTorqueRegressor, RigidBodyFeatures
from sklearn_vbjfa.datasets import make_robot_recording

FRICTION = ("viscous", "coulomb", "offset")


# -- names


@pytest.fixture(scope="module", name="recording")
def fixture_recording():
    return make_robot_recording(duration=4.0, dt=0.01, random_state=3)


@pytest.fixture(scope="module", name="features")
def fixture_features(recording):
    return RigidBodyFeatures(recording.urdf, friction=FRICTION).fit(recording.states)


def fitted(recording, features, names, kept=slice(None)):
    """Fit to columns of the features with these names."""
    import pandas

    X = features.transform(recording.states[::10])[:, kept]
    X = pandas.DataFrame(X, columns=names)
    return JointTorqueRegressor(LinearRegression()).fit(X, recording.tau[::10])


def test_names_of_the_parameters(recording, features):
    names = features.get_feature_names_out()
    for given in (names, [f"robot__{name}" for name in names]):
        found = fitted(recording, features, given).parameter_names_
        assert found == features.parameter_names_


def test_names_that_are_not_all_there_are_refused(recording, features):
    names = features.get_feature_names_out()
    kept = np.delete(np.arange(names.size), range(5, 11))
    for wrong in (names[::-1], names[kept]):
        rows = kept if wrong.size == kept.size else slice(None)
        with pytest.raises(ValueError, match="removed, renamed or reordered"):
            fitted(recording, features, wrong, rows)
    shuffled = names.copy()
    shuffled[[100, 101]] = names[[101, 100]]
    with pytest.raises(ValueError, match="468 for 6 joints"):
        fitted(recording, features, shuffled)


# -- scalers


SCALERS = {
    "StandardScaler": StandardScaler(),
    "StandardScaler, scale only": StandardScaler(with_mean=False),
    "MinMaxScaler": MinMaxScaler(),
    "MinMaxScaler of a range": MinMaxScaler((-1, 1)),
}


def chain(recording, step, regressor=None, projector=None):
    return Pipeline(
        [
            ("features", RigidBodyFeatures(recording.urdf, friction=FRICTION)),
            ("between", step),
            (
                "torque",
                JointTorqueRegressor(regressor or LinearRegression(), projector),
            ),
        ]
    )


@pytest.mark.parametrize("name", SCALERS)
@pytest.mark.parametrize("output", ["default", "pandas"])
def test_a_scaler_in_between_is_refused(recording, name, output):
    model = chain(recording, SCALERS[name]).set_output(transform=output)
    expected = "all .* columns that vary have .* as scalers leave them.*put it into"
    with pytest.raises(ValueError, match=expected):
        model.fit(recording.states, recording.tau)


def test_a_scaler_inside_is_understood(recording):
    inside = make_pipeline(StandardScaler(), LinearRegression())
    plain = chain(recording, "passthrough").fit(recording.states, recording.tau)
    scaled = chain(recording, "passthrough", inside)
    scaled.fit(recording.states, recording.tau)
    np.testing.assert_allclose(
        scaled.predict(recording.states),
        plain.predict(recording.states),
        atol=1e-6 * np.abs(recording.tau).max(),
    )
