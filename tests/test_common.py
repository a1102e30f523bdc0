"""scikit-learn's own checks; those that no robot can pass are refused with a reason."""

import os
import re
from pathlib import Path

import pytest
from sklearn.linear_model import LinearRegression
from sklearn.utils.estimator_checks import parametrize_with_checks

from sklearn_vbjfa import (
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
)

# One joint has three columns of states, as many as most of the checks' tables.
SWING = str(Path(__file__).parent / "model" / "swing.urdf")

# Few iterations: what is checked does not depend on the last digits.
ESTIMATORS = [
    JFARegressor(query="noiseless", max_iter=15),
    VBJFARegressor(),
    JointTorqueRegressor(),
    LocallyWeightedRegressor(LinearRegression(), n_models=3),
    StepwiseRegressor(),
    TotalLeastSquares(),
    InstrumentalVariables(),
    PhysicalProjector(),
]
# The same classes with other options.
OTHER_OPTIONS = [
    VBJFARegressor(query="noiseless", max_iter=15),
    VBJFARegressor(prior="paper", max_iter=15),
    JointTorqueRegressor(LinearRegression(), joint_weights=None),
    PhysicalProjector("eq30"),
]

# Why a check cannot pass, as the message says it.
# Rows are samples in the order of time, not independent of one another.
_ORDER = "different sample order|recording must have at least 8 samples"
# The check has fewer samples than the choice of a cut-off needs.
_SHORT = "needs a recording of at least 16 samples"
# A robot's states have three columns a joint, and the check another number.
_WIDTH = r"states \[q \| v \| a\]"

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
    # One column is positions.
    "check_fit2d_1feature": _SHORT,
}


def refusals(estimator):
    """Return check -> message of what an estimator of the robot chain refuses."""
    if isinstance(estimator, StateEstimator):
        return STATES if estimator.cutoff != "auto" else AUTOMATIC_STATES
    return FEATURES if isinstance(estimator, RigidBodyFeatures) else IDENTIFIER


def checks_of(estimators):
    """Parametrize by estimators and scikit-learn's checks that can run here."""
    mark = parametrize_with_checks(estimators)
    names, pairs = mark.args
    # It is skipped unless the variable is set, as `.ci/full` does.
    if not os.environ.get("SCIPY_ARRAY_API"):
        pairs = [x for x in pairs if x[1].func.__name__ != "check_array_api_input"]
    return pytest.mark.parametrize(names, pairs, **mark.kwargs)


def messages(error):
    """Messages of an error and of those that it was raised from."""
    while error is not None:
        yield str(error)
        error = error.__cause__ or error.__context__


# Some checks take standardised columns, which is a warning for a single torque, or
# tables narrower than one body.
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore:X is not as RigidBodyFeatures computes it")
@pytest.mark.filterwarnings("ignore:.*too few for a body:UserWarning")
@checks_of(ESTIMATORS)
def test_estimator(estimator, check):
    check(estimator)


@pytest.mark.slow
@checks_of(OTHER_OPTIONS)
def test_estimator_with_other_options(estimator, check):
    test_estimator(estimator, check)


# Pure noise as states: joints "move", and what the projection has to drop is a lot.
@pytest.mark.filterwarnings("ignore::UserWarning")
@checks_of(
    [
        StateEstimator(dt=0.01),
        StateEstimator(dt=0.01, cutoff=20.0),
        RigidBodyFeatures(SWING),
        RobotIdentifier(SWING, friction=(), dt=0.01),
    ]
)
def test_robot_estimator(estimator, check):
    expected = refusals(estimator).get(check.func.__name__)
    if expected is None:
        check(estimator)
        return
    with pytest.raises((ValueError, AssertionError)) as refused:
        check(estimator)
    assert any(re.search(expected, text) for text in messages(refused.value))
