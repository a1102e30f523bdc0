"""What the columns in front of a torque regressor are: names, and traces of scalers."""

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler

from sklearn_vbjfa import JointTorqueRegressor, RigidBodyFeatures

FRICTION = ("viscous", "coulomb", "offset")


@pytest.fixture(scope="module", name="features")
def fixture_features(simulated):
    return RigidBodyFeatures(simulated.urdf, friction=FRICTION).fit(simulated.states)


def fitted(simulated, features, names, kept=slice(None)):
    """Fit to columns of the features with these names."""
    import pandas

    X = features.transform(simulated.states[::10])[:, kept]
    X = pandas.DataFrame(X, columns=names)
    return JointTorqueRegressor(LinearRegression()).fit(X, simulated.tau[::10])


def test_names_of_the_parameters(simulated, features):
    names = features.get_feature_names_out()
    for given in (names, [f"robot__{name}" for name in names]):
        found = fitted(simulated, features, given).parameter_names_
        assert found == features.parameter_names_


def test_names_that_are_not_all_there_are_refused(simulated, features):
    names = features.get_feature_names_out()
    kept = np.delete(np.arange(names.size), range(5, 11))
    for wrong in (names[::-1], names[kept]):
        rows = kept if wrong.size == kept.size else slice(None)
        with pytest.raises(ValueError, match="removed, renamed or reordered"):
            fitted(simulated, features, wrong, rows)
    shuffled = names.copy()
    shuffled[[100, 101]] = names[[101, 100]]
    with pytest.raises(ValueError, match="468 for 6 joints"):
        fitted(simulated, features, shuffled)


# -- scalers


SCALERS = {
    "StandardScaler": StandardScaler(),
    "StandardScaler, scale only": StandardScaler(with_mean=False),
    "MinMaxScaler": MinMaxScaler(),
    "MinMaxScaler of a range": MinMaxScaler((-1, 1)),
}


def chain(simulated, step, regressor=None):
    regressor = JointTorqueRegressor(regressor or LinearRegression())
    features = RigidBodyFeatures(simulated.urdf, friction=FRICTION)
    return Pipeline([("features", features), ("between", step), ("torque", regressor)])


@pytest.mark.parametrize("name", SCALERS)
@pytest.mark.parametrize("output", ["default", "pandas"])
def test_a_scaler_in_between_is_refused(simulated, name, output):
    model = chain(simulated, SCALERS[name]).set_output(transform=output)
    expected = "all .* columns that vary have .* as scalers leave them.*put it into"
    with pytest.raises(ValueError, match=expected):
        model.fit(simulated.states, simulated.tau)


def test_a_scaler_inside_is_understood(simulated):
    inside = make_pipeline(StandardScaler(), LinearRegression())
    plain = chain(simulated, "passthrough").fit(simulated.states, simulated.tau)
    scaled = chain(simulated, "passthrough", inside)
    scaled.fit(simulated.states, simulated.tau)
    np.testing.assert_allclose(
        scaled.predict(simulated.states),
        plain.predict(simulated.states),
        atol=1e-6 * np.abs(simulated.tau).max(),
    )
