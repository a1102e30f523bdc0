"""Conventions of scikit-learn beyond its checks: data frames, copies, display."""

import pickle

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.utils import get_tags

import sklearn_vbjfa as sv
from sklearn_vbjfa.datasets import make_robot_recording
from tests.effects._arms import arm
from tests.robot.test_metadata_routing import chain

BODY = [2.0, 0, 0, 0, 1, 0, 1, 0, 0, 3, -0.1]


@pytest.fixture(scope="module", name="recording")
def fixture_recording():
    return make_robot_recording(duration=6.0, dt=0.02, n_recordings=2, random_state=0)


@pytest.fixture(scope="module", name="states")
def fixture_states():
    """States of two joints."""
    return np.random.default_rng(0).normal(size=(40, 6))


def transformers():
    model = arm("YY")
    return {
        "features": (
            sv.RigidBodyFeatures(model, friction=("viscous", "offset")),
            "qva",
        ),
        "states": (sv.StateEstimator(0.01, cutoff=20.0), "q"),
        "projector": (sv.PhysicalProjector(), "theta"),
        "viscous": (sv.effects.Viscous(joint=1), "qva"),
        "ripple": (sv.effects.Ripple(joint=0), "qva"),
    }


@pytest.mark.parametrize("name", transformers())
@pytest.mark.parametrize("container", ["array", "frame"])
def test_transformers_return_frames(name, container, states):
    import pandas

    transformer, kind = transformers()[name]
    X = {"qva": states, "q": states[:, :2], "theta": np.array([BODY, BODY])}[kind]
    if container == "frame":
        names = [f"column {j}" for j in range(X.shape[1])]
        X = pandas.DataFrame(X, columns=names, index=np.arange(len(X)) + 100)
    expected = clone(transformer).fit(X).transform(X)
    assert isinstance(expected, np.ndarray)
    transformer.set_output(transform="pandas")
    frame = transformer.fit_transform(X)
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == list(transformer.get_feature_names_out())
    assert len(set(frame.columns)) == expected.shape[1]
    np.testing.assert_array_equal(frame.to_numpy(), expected)
    if container == "frame":
        assert list(frame.index) == list(X.index)


def test_pipeline_accepts_data_frames(recording):
    import pandas

    q = pandas.DataFrame(recording.q, columns=recording.joint_names)

    plain = chain(recording).fit(recording.q, recording.tau)
    fitted = chain(recording).set_output(transform="pandas").fit(q, recording.tau)
    np.testing.assert_array_equal(plain["torque"].theta_, fitted["torque"].theta_)
    assert list(fitted["features"].feature_names_in_[:2]) == ["q_joint_1", "q_joint_2"]
    names = fitted[:-1].get_feature_names_out()
    assert list(fitted["torque"].feature_names_in_) == list(names)
    np.testing.assert_array_equal(plain.predict(recording.q), fitted.predict(q))


def test_state_feature_names_are_checked(states):
    import pandas

    positions = states[:, :2]
    plain = sv.StateEstimator(0.01, cutoff=20.0).fit(positions)
    assert plain.get_feature_names_out()[:3].tolist() == ["q_0", "q_1", "v_0"]
    assert plain.get_feature_names_out(["a", "b"])[2] == "v_a"
    with pytest.raises(ValueError, match=r"number of features \(2\), got 3"):
        plain.get_feature_names_out(["a", "b", "c"])
    named = clone(plain).fit(pandas.DataFrame(positions, columns=["a", "b"]))
    assert named.get_feature_names_out()[-1] == "a_b"
    with pytest.raises(ValueError, match="not equal to feature_names_in_"):
        named.get_feature_names_out(["a", "c"])


def estimators():
    """One instance of each estimator, with models as path and as object."""
    robot = sv.RobotIdentifier(arm("YY"), dt=0.01, friction=("viscous",))
    return [
        sv.EffectDiscovery(robot, effects=["coulomb"]),
        sv.InstrumentalVariables(),
        sv.JFARegressor(input_noise=[0.1, 0.2]),
        sv.JointTorqueRegressor(sv.VBJFARegressor(), projector=sv.PhysicalProjector()),
        sv.LocallyWeightedRegressor(LinearRegression()),
        sv.PhysicalProjector(metric=np.eye(22)),
        sv.RigidBodyFeatures(arm("YY")),
        robot,
        sv.RobotIdentifier(
            "arm.urdf", effects=(sv.effects.Coulomb(joint=1),), friction=("viscous",)
        ),
        sv.StateEstimator(0.01),
        sv.StepwiseRegressor(),
        sv.TotalLeastSquares(),
        sv.VBJFARegressor(input_noise=np.eye(3)),
        *sv.effects.resolve(),
    ]


def name_of(estimator):
    return type(estimator).__name__


def test_every_estimator_is_tested():
    public = {name for name in sv.__all__ if hasattr(getattr(sv, name), "get_params")}
    assert public <= {name_of(estimator) for estimator in estimators()}


@pytest.mark.parametrize("estimator", estimators(), ids=name_of)
def test_tags(estimator):
    tags = get_tags(estimator)
    transforms = hasattr(estimator, "transform")
    assert tags.estimator_type == (None if transforms else "regressor")
    assert (tags.transformer_tags is not None) == transforms
    assert (tags.regressor_tags is not None) != transforms
    assert tags.target_tags.required != transforms
    several = isinstance(
        estimator, (sv.EffectDiscovery, sv.JointTorqueRegressor, sv.RobotIdentifier)
    )
    assert tags.target_tags.multi_output == several
    assert not tags.input_tags.allow_nan
    assert not tags.input_tags.sparse


def assert_same(estimator, other):
    """Compare the parameters of two estimators recursively."""
    assert type(estimator) is type(other)
    other_parameters = other.get_params(deep=False)
    for name, value in estimator.get_params(deep=False).items():
        if hasattr(value, "get_params"):
            assert_same(value, other_parameters[name])
        elif isinstance(value, tuple) and any(hasattr(v, "get_params") for v in value):
            assert len(value) == len(other_parameters[name])
            for element, other_element in zip(value, other_parameters[name]):
                assert_same(element, other_element)
        else:
            assert np.all(value == other_parameters[name]), name


@pytest.mark.parametrize("estimator", estimators(), ids=name_of)
@pytest.mark.parametrize(
    "copy", [clone, lambda e: pickle.loads(pickle.dumps(e))], ids=["clone", "pickle"]
)
def test_copies(estimator, copy):
    copied = copy(estimator)
    assert copied is not estimator
    assert_same(estimator, copied)


@pytest.mark.parametrize("kind", ["path", "model"])
def test_fitted_identifiers_are_pickled(recording, kind):
    model = recording.urdf if kind == "path" else recording.robot_model()
    robot = sv.RobotIdentifier(model, dt=recording.dt, friction=("viscous",))
    robot.fit(recording.q, recording.tau, groups=recording.groups)
    loaded = pickle.loads(pickle.dumps(robot))
    np.testing.assert_array_equal(loaded.theta_, robot.theta_)
    groups = recording.groups
    np.testing.assert_array_equal(
        loaded.predict(recording.q, groups=groups),
        robot.predict(recording.q, groups=groups),
    )
    refitted = clone(loaded).fit(recording.q, recording.tau, groups=groups)
    np.testing.assert_array_equal(refitted.theta_, robot.theta_)
