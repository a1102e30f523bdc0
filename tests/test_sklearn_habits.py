"""What users of scikit-learn expect beside its checks: frames, copies, notebooks."""

import pickle
import re

import numpy as np
import pytest
import sklearn
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.utils import get_tags

import sklearn_vbjfa
from sklearn_vbjfa import (
    EffectDiscovery,
    InstrumentalVariables,
    JFARegressor,
    JointTorqueRegressor,
    LocallyWeightedRegressor,
    PhysicalProjector,
    RigidBodyFeatures,
    RobotIdentifier,
    StateEstimator,
    StepwiseRegressor,
    TotalLeastSquares,
    VBJFARegressor,
    effects,
)
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


# -- frames ---------------------------------------------------------------------------


def transformers():
    model = arm("YY")
    return {
        "features": (RigidBodyFeatures(model, friction=("viscous", "offset")), "qva"),
        "states": (StateEstimator(0.01, cutoff=20.0), "q"),
        "projector": (PhysicalProjector(), "theta"),
        "viscous": (effects.Viscous(joint=1), "qva"),
        "ripple": (effects.Ripple(joint=0), "qva"),
    }


@pytest.mark.parametrize("name", transformers())
@pytest.mark.parametrize("given", ["array", "frame"])
def test_transformers_return_frames(name, given, states):
    import pandas

    transformer, takes = transformers()[name]
    X = {"qva": states, "q": states[:, :2], "theta": np.array([BODY, BODY])}[takes]
    if given == "frame":
        names = [f"column {j}" for j in range(X.shape[1])]
        X = pandas.DataFrame(X, columns=names, index=np.arange(len(X)) + 100)
    plain = clone(transformer).fit(X).transform(X)
    assert isinstance(plain, np.ndarray)
    transformer.set_output(transform="pandas")
    frame = transformer.fit_transform(X)
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == list(transformer.get_feature_names_out())
    assert len(set(frame.columns)) == plain.shape[1]
    np.testing.assert_array_equal(frame.to_numpy(), plain)
    if given == "frame":
        assert list(frame.index) == list(X.index)


def test_frames_all_through_the_chain(recording):
    import pandas

    q = pandas.DataFrame(recording.q, columns=recording.joint_names)

    plain = chain(recording).fit(recording.q, recording.tau)
    framed = chain(recording).set_output(transform="pandas").fit(q, recording.tau)
    np.testing.assert_array_equal(plain["torque"].theta_, framed["torque"].theta_)
    assert list(framed["features"].feature_names_in_[:2]) == ["q_joint_1", "q_joint_2"]
    names = framed[:-1].get_feature_names_out()
    assert list(framed["torque"].feature_names_in_) == list(names)
    np.testing.assert_array_equal(plain.predict(recording.q), framed.predict(q))


def test_names_of_states_are_checked(states):
    import pandas

    positions = states[:, :2]
    plain = StateEstimator(0.01, cutoff=20.0).fit(positions)
    assert plain.get_feature_names_out()[:3].tolist() == ["q_0", "q_1", "v_0"]
    assert plain.get_feature_names_out(["a", "b"])[2] == "v_a"
    with pytest.raises(ValueError, match=r"number of features \(2\), got 3"):
        plain.get_feature_names_out(["a", "b", "c"])
    named = clone(plain).fit(pandas.DataFrame(positions, columns=["a", "b"]))
    assert named.get_feature_names_out()[-1] == "a_b"
    with pytest.raises(ValueError, match="not equal to feature_names_in_"):
        named.get_feature_names_out(["a", "c"])


# -- tags, text, notebooks, copies ----------------------------------------------------


def estimators():
    """One of each, with models as path and as object."""
    robot = RobotIdentifier(arm("YY"), dt=0.01, friction=("viscous",))
    return [
        EffectDiscovery(robot, effects=["coulomb"]),
        InstrumentalVariables(),
        JFARegressor(input_noise=[0.1, 0.2]),
        JointTorqueRegressor(VBJFARegressor(), projector=PhysicalProjector()),
        LocallyWeightedRegressor(LinearRegression()),
        PhysicalProjector(metric=np.eye(22)),
        RigidBodyFeatures(arm("YY")),
        robot,
        RobotIdentifier(
            "arm.urdf", effects=(effects.Coulomb(joint=1),), friction=("viscous",)
        ),
        StateEstimator(0.01),
        StepwiseRegressor(),
        TotalLeastSquares(),
        VBJFARegressor(input_noise=np.eye(3)),
        *effects.resolve(),
    ]


def name_of(estimator):
    return type(estimator).__name__


def test_every_estimator_is_looked_at():
    public = {
        name
        for name in sklearn_vbjfa.__all__
        if hasattr(getattr(sklearn_vbjfa, name), "get_params")
    }
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
        estimator, (EffectDiscovery, JointTorqueRegressor, RobotIdentifier)
    )
    assert tags.target_tags.multi_output == several
    assert not tags.input_tags.allow_nan
    assert not tags.input_tags.sparse


@pytest.mark.parametrize("estimator", estimators(), ids=name_of)
def test_text_and_notebooks_are_short(estimator):
    text = repr(estimator)
    assert text.startswith(name_of(estimator) + "(")
    assert len(text) < 1200
    html = estimator._repr_html_()
    body = re.sub(r"<(style|script)>.*?</\1>", "", html, flags=re.DOTALL)
    assert name_of(estimator) in body
    # parameters are folded away; unfolded they are still no more than a page
    assert len(re.sub(r"<[^>]+>", "", body).split()) < 600
    with sklearn.config_context(display="text"):
        bundle = estimator._repr_mimebundle_()
    assert list(bundle) == ["text/plain"]


def test_a_discovery_shows_its_identifier():
    html = estimators()[0]._repr_html_()
    assert "identifier: RobotIdentifier" in html


def assert_same(one, other):
    """Compare the parameters of two estimators, one level after the other."""
    assert type(one) is type(other)
    theirs = other.get_params(deep=False)
    for name, value in one.get_params(deep=False).items():
        if hasattr(value, "get_params"):
            assert_same(value, theirs[name])
        elif isinstance(value, tuple) and any(hasattr(v, "get_params") for v in value):
            assert len(value) == len(theirs[name])
            for mine, its in zip(value, theirs[name]):
                assert_same(mine, its)
        else:
            assert np.all(value == theirs[name]), name


@pytest.mark.parametrize("estimator", estimators(), ids=name_of)
@pytest.mark.parametrize(
    "copy", [clone, lambda e: pickle.loads(pickle.dumps(e))], ids=["clone", "pickle"]
)
def test_copies(estimator, copy):
    found = copy(estimator)
    assert found is not estimator
    assert_same(estimator, found)


@pytest.mark.parametrize("kind", ["path", "model"])
def test_fitted_identifiers_are_pickled(recording, kind):
    model = recording.urdf if kind == "path" else recording.robot_model()
    robot = RobotIdentifier(model, dt=recording.dt, friction=("viscous",))
    robot.fit(recording.q, recording.tau, groups=recording.groups)
    found = pickle.loads(pickle.dumps(robot))
    np.testing.assert_array_equal(found.theta_, robot.theta_)
    groups = recording.groups
    np.testing.assert_array_equal(
        found.predict(recording.q, groups=groups),
        robot.predict(recording.q, groups=groups),
    )
    again = clone(found).fit(recording.q, recording.tau, groups=groups)
    np.testing.assert_array_equal(again.theta_, robot.theta_)
