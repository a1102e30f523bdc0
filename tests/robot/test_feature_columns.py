"""What the columns in front of a torque regressor are: names, and traces of scalers."""

import warnings

import numpy as np
import pytest
from sklearn.decomposition import PCA
from sklearn.feature_selection import VarianceThreshold
from sklearn.linear_model import Lasso, LinearRegression
from sklearn.pipeline import FeatureUnion, Pipeline, make_pipeline
from sklearn.preprocessing import (
    FunctionTransformer,
    MaxAbsScaler,
    MinMaxScaler,
    Normalizer,
    PowerTransformer,
    QuantileTransformer,
    RobustScaler,
    StandardScaler,
)

pytest.importorskip("pinocchio")

from sklearn_vbjfa import JointTorqueRegressor, PhysicalProjector, RigidBodyFeatures
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.robot._features import check_as_computed, parameter_names_of

FRICTION = ("viscous", "coulomb", "offset")


@pytest.fixture(scope="module", name="recording")
def fixture_recording():
    return make_robot_recording(duration=4.0, dt=0.01, random_state=3)


@pytest.fixture(scope="module", name="features")
def fixture_features(recording):
    return RigidBodyFeatures(recording.urdf, friction=FRICTION).fit(recording.states)


# -- names


def test_names_of_the_parameters(features):
    names = features.get_feature_names_out()
    assert parameter_names_of(names, 6) == features.parameter_names_
    prefixed = [f"robot__{name}" for name in names]
    assert parameter_names_of(prefixed, 6) == features.parameter_names_


@pytest.mark.parametrize("joint", ["a", "tau_x", "left/arm/1", "a:m", "tau_a/b"])
def test_any_name_of_a_joint(joint):
    parameters = tuple(f"{body}:{k}" for body in (joint, "other") for k in "mnc")
    names = [f"tau_{j}/{name}" for j in (joint, "other") for name in parameters]
    assert parameter_names_of(names, 2) == parameters


@pytest.mark.parametrize("names", [None, [f"x{k}" for k in range(12)], ["pca0", "tau"]])
def test_other_names_say_nothing(names):
    assert parameter_names_of(names, 2) is None


def test_names_that_are_not_all_there_are_refused(features):
    names = features.get_feature_names_out()
    for wrong in (names[::-1], np.delete(names, range(5, 11))):
        with pytest.raises(ValueError, match="left out, renamed or put in another"):
            parameter_names_of(wrong, 6)
    shuffled = names.copy()
    shuffled[[100, 101]] = names[[101, 100]]
    with pytest.raises(ValueError, match="468 columns from tau_joint_1/joint_1:m to"):
        parameter_names_of(shuffled, 6)


def test_frames_through_a_union(recording):
    pytest.importorskip("pandas")
    robot = RigidBodyFeatures(recording.urdf, friction=FRICTION)
    chain = make_pipeline(
        FeatureUnion([("robot", robot)]), JointTorqueRegressor(LinearRegression())
    ).set_output(transform="pandas")
    chain.fit(recording.states, recording.tau)
    assert chain[-1].parameter_names_[:2] == ("joint_1:m", "joint_1:mc_x")


# -- scalers


SCALERS = {
    "StandardScaler": StandardScaler(),
    "StandardScaler, scale only": StandardScaler(with_mean=False),
    "MinMaxScaler": MinMaxScaler(),
    "MinMaxScaler of a range": MinMaxScaler((-1, 1)),
    "MaxAbsScaler": MaxAbsScaler(),
    "RobustScaler": RobustScaler(),
    "RobustScaler, scale only": RobustScaler(with_centering=False),
    "PCA": PCA(60),
    "PCA, white": PCA(60, whiten=True),
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
    if output == "pandas":
        pytest.importorskip("pandas")
    model = chain(recording, SCALERS[name]).set_output(transform=output)
    blame = name.split(",")[0].split(" ")[0]
    expected = f"all .* columns that vary have .* as {blame} leaves them.*put it into"
    with pytest.raises(ValueError, match=expected):
        model.fit(recording.states, recording.tau)


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        (StandardScaler(with_std=False), "joint_1:coulomb of a sign reach 1."),
        (Normalizer(), "joint_1:offset of a constant torque are not 1"),
        (FunctionTransformer(lambda X: 2 * X, feature_names_out="one-to-one"), "sign"),
        (
            VarianceThreshold(),
            "PCA and selections of columns belong inside the regressor",
        ),
        (PowerTransformer(), "StandardScaler"),
        (QuantileTransformer(n_quantiles=50), "MinMaxScaler"),
    ],
)
def test_frames_show_what_else_was_done(recording, step, reason):
    pytest.importorskip("pandas")
    model = chain(recording, step).set_output(transform="pandas")
    with pytest.raises(ValueError, match=reason):
        model.fit(recording.states, recording.tau)


def test_centred_arrays_get_a_warning(recording):
    model = chain(recording, StandardScaler(with_std=False))
    with pytest.warns(UserWarning, match=r"mean of zero.* \(gravity\) are lost"):
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


@pytest.mark.parametrize("inside", [StandardScaler(), MaxAbsScaler(), PCA(40)])
def test_nothing_inside_is_refused(recording, inside):
    model = chain(recording, "passthrough", make_pipeline(inside, Lasso(alpha=1e-3)))
    model.fit(recording.states, recording.tau)
    assert model.score(recording.states, recording.tau) > 0.9


@pytest.mark.parametrize("friction", [(), ("viscous",), FRICTION])
@pytest.mark.parametrize("seed", range(5))
def test_no_robot_is_taken_for_scaled(friction, seed):
    motion = make_robot_recording(duration=3.0, dt=0.02, random_state=seed)
    features = RigidBodyFeatures(motion.urdf, friction=friction)
    X = features.fit_transform(motion.states)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_as_computed(X, motion.tau, features.parameter_names_)
        # in other units of length and of torque, and with a joint at rest
        check_as_computed(1e-3 * X, 1e-3 * motion.tau)
        still = X.reshape(len(X), 6, -1).copy()
        still[:, 2:] = 0.0
        check_as_computed(still.reshape(len(X), -1), motion.tau)


def test_columns_of_signs_alone_are_no_scaler():
    rng = np.random.default_rng(0)
    X = rng.choice([-1.0, 1.0], size=(200, 6))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_as_computed(X, rng.normal(size=(200, 2)))


def test_one_joint_about_the_vertical_keeps_its_symmetric_motion():
    # all columns have a mean of zero, and so has the torque
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    X = np.column_stack([np.cos(t) + 0.3 * np.cos(2 * t), -np.sin(t)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_as_computed(X, X @ [[1.0], [0.5]])
    with pytest.warns(UserWarning, match="mean of zero"):
        check_as_computed(X, X @ [[1.0], [0.5]] + 1.0)


def test_one_output_without_projector_gets_a_warning():
    rng = np.random.default_rng(0)
    X = StandardScaler().fit_transform(rng.normal(size=(200, 11)))
    y = X @ np.arange(11.0)
    with pytest.warns(UserWarning, match="standard deviation of 1, as StandardScaler"):
        model = JointTorqueRegressor(LinearRegression()).fit(X, y)
    np.testing.assert_allclose(model.theta_, np.arange(11.0), atol=1e-9)
    with pytest.raises(ValueError, match="as StandardScaler leaves them"):
        JointTorqueRegressor(LinearRegression(), PhysicalProjector()).fit(X, y)
