"""scikit-learn's estimator checks; those that robot estimators must reject."""

import os
import re
from pathlib import Path

import pytest
from sklearn.linear_model import LinearRegression
from sklearn.utils.estimator_checks import parametrize_with_checks

import sklearn_vbjfa as sv

# One joint: three columns of states, as many as most of the checks use.
SWING = str(Path(__file__).parent / "model" / "swing.urdf")

# Few iterations suffice: the checks do not depend on convergence.
ESTIMATORS = [
    sv.JFARegressor(query="noiseless", max_iter=15),
    sv.VBJFARegressor(),
    sv.JointTorqueRegressor(),
    sv.LocallyWeightedRegressor(LinearRegression(), n_models=3),
    sv.StepwiseRegressor(),
    sv.TotalLeastSquares(),
    sv.InstrumentalVariables(),
    sv.PhysicalProjector(),
]
# The same classes with other options.
OTHER_OPTIONS = [
    sv.VBJFARegressor(query="noiseless", max_iter=15),
    sv.VBJFARegressor(prior="paper", max_iter=15),
    sv.JointTorqueRegressor(LinearRegression(), joint_weights=None),
    sv.PhysicalProjector("eq30"),
]

# Expected error messages of checks that cannot pass.
# Rows are consecutive samples in time, not independent observations.
_ORDER = "different sample order|recording must have at least 8 samples"
# The check has fewer samples than the selection of the cutoff needs.
_SHORT = "needs a recording of at least 16 samples"
# States have three columns per joint; the check has another number of columns.
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
    # One column is read as positions.
    "check_fit2d_1feature": _SHORT,
}


def refusals(estimator):
    """Return the expected error message by name of the rejected check."""
    if isinstance(estimator, sv.StateEstimator):
        return STATES if estimator.cutoff != "auto" else AUTOMATIC_STATES
    return FEATURES if isinstance(estimator, sv.RigidBodyFeatures) else IDENTIFIER


def checks_of(estimators):
    """Parametrize by estimator and by the scikit-learn checks that can run here."""
    mark = parametrize_with_checks(estimators)
    names, pairs = mark.args
    # scikit-learn skips it without this variable, which `.ci/full` sets.
    if not os.environ.get("SCIPY_ARRAY_API"):
        pairs = [x for x in pairs if x[1].func.__name__ != "check_array_api_input"]
    return pytest.mark.parametrize(names, pairs, **mark.kwargs)


def messages(error):
    """Messages of an error and of its causes."""
    while error is not None:
        yield str(error)
        error = error.__cause__ or error.__context__


# Some checks standardise the columns, which causes a warning, or use fewer columns
# than one body has parameters.
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore:X is not as sv.RigidBodyFeatures computes it")
@pytest.mark.filterwarnings("ignore:.*too few for a body:UserWarning")
@checks_of(ESTIMATORS)
def test_estimator(estimator, check):
    check(estimator)


@pytest.mark.slow
@checks_of(OTHER_OPTIONS)
def test_estimator_with_other_options(estimator, check):
    test_estimator(estimator, check)


# States are pure noise, so the projection removes a large part of the estimate.
@pytest.mark.filterwarnings("ignore::UserWarning")
@checks_of(
    [
        sv.StateEstimator(dt=0.01),
        sv.StateEstimator(dt=0.01, cutoff=20.0),
        sv.RigidBodyFeatures(SWING),
        sv.RobotIdentifier(SWING, friction=(), dt=0.01),
    ]
)
def test_robot_estimator(estimator, check):
    expected = refusals(estimator).get(check.func.__name__)
    if expected is None:
        check(estimator)
        return
    with pytest.raises((ValueError, AssertionError)) as error_info:
        check(estimator)
    assert any(re.search(expected, text) for text in messages(error_info.value))
