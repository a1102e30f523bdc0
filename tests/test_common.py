"""scikit-learn's own checks; what cannot hold for a robot is named with its reason."""

import inspect
from pathlib import Path

import pytest
from sklearn.linear_model import LinearRegression
from sklearn.utils.estimator_checks import parametrize_with_checks

from sklearn_vbjfa import (
    InstrumentalVariables,
    JFARegressor,
    JointTorqueRegressor,
    PhysicalProjector,
    RigidBodyFeatures,
    RobotIdentifier,
    StateEstimator,
    StepwiseRegressor,
    TotalLeastSquares,
    VBJFARegressor,
)

# One joint has three columns of states, as many as most of the checks' tables.
SWING = str(Path(__file__).parent / "model" / "swing.urdf")

# Few iterations: what is checked does not depend on the last digits.
ESTIMATORS = [
    JFARegressor(query="noiseless", max_iter=15),
    VBJFARegressor(max_iter=15),
    VBJFARegressor(query="noiseless", max_iter=15),
    VBJFARegressor(prior="paper", max_iter=15),
    JointTorqueRegressor(),
    JointTorqueRegressor(LinearRegression(), joint_weights=None),
    StepwiseRegressor(),
    TotalLeastSquares(),
    InstrumentalVariables(),
    PhysicalProjector(),
    PhysicalProjector("eq30"),
]

_ORDER = "rows are samples in the order of time, not independent of one another"
_SHORT = "needs 16 samples to choose the cut-off, the check has fewer"
_WIDTH = "a robot's states have three columns a joint, the check has others"

STATES = {
    "check_methods_sample_order_invariance": _ORDER,
    "check_methods_subset_invariance": _ORDER,
}
AUTOMATIC_STATES = {
    **STATES,
    "check_n_features_in_after_fitting": _SHORT,
    "check_estimators_nan_inf": _SHORT,
    "check_fit2d_1feature": _SHORT,
}
WIDTH = dict.fromkeys(
    [
        "check_estimators_overwrite_params",
        "check_estimators_fit_returns_self",
        "check_readonly_memmap_input",
        "check_n_features_in_after_fitting",
        "check_positive_only_tag_during_fit",
        "check_estimators_dtypes",
        "check_dtype_object",
        "check_fit2d_1sample",
        "check_fit_idempotent",
        "check_fit_check_is_fitted",
        "check_n_features_in",
        # Skipped unless SCIPY_ARRAY_API is set, as .ci/full does.
        "check_array_api_input",
    ],
    _WIDTH,
)
FEATURES = {**WIDTH, "check_fit2d_1feature": _WIDTH}
IDENTIFIER = {
    **WIDTH,
    **dict.fromkeys(
        [
            "check_sample_weights_not_an_array",
            "check_sample_weights_pandas_series",
            "check_all_zero_sample_weights_error",
            "check_sample_weights_shape",
            "check_sample_weights_not_overwritten",
            "check_sample_weight_equivalence_on_dense_data",
            "check_regressors_train",
            "check_regressor_data_not_an_array",
            "check_regressor_multioutput",
            "check_regressors_no_decision_function",
            "check_regressors_int",
        ],
        _WIDTH,
    ),
    "check_fit2d_1feature": "one column is positions, " + _SHORT,
}


def expected_failures(estimator):
    """Return check -> reason for an estimator of the robot chain."""
    if isinstance(estimator, StateEstimator):
        return STATES if estimator.cutoff != "auto" else AUTOMATIC_STATES
    return FEATURES if isinstance(estimator, RigidBodyFeatures) else IDENTIFIER


# From 1.8 on an expected failure that passes can be made to fail.
_STRICT = (
    {"xfail_strict": True}
    if "xfail_strict" in inspect.signature(parametrize_with_checks).parameters
    else {}
)


# Some checks take standardised columns, which is a warning for a single torque, or
# tables narrower than one body.
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore:X is not as RigidBodyFeatures computes it")
@pytest.mark.filterwarnings("ignore:.*too few for a body:UserWarning")
@parametrize_with_checks(ESTIMATORS)
def test_estimator(estimator, check):
    check(estimator)


@parametrize_with_checks(
    [StateEstimator(dt=0.01), StateEstimator(dt=0.01, cutoff=20.0)],
    expected_failed_checks=expected_failures,
    **_STRICT,
)
def test_state_estimator(estimator, check):
    check(estimator)


# Pure noise as states: joints "move", and what the projection has to drop is a lot.
@pytest.mark.filterwarnings("ignore::UserWarning")
@parametrize_with_checks(
    [RigidBodyFeatures(SWING), RobotIdentifier(SWING, friction=(), dt=0.01)],
    expected_failed_checks=expected_failures,
    **_STRICT,
)
def test_robot_estimator(estimator, check):
    check(estimator)
