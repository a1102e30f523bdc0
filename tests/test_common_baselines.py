"""The contract of scikit-learn for the baseline regressors."""

from sklearn.utils.estimator_checks import parametrize_with_checks

from sklearn_vbjfa import InstrumentalVariables, StepwiseRegressor, TotalLeastSquares


@parametrize_with_checks(
    [
        StepwiseRegressor(),
        StepwiseRegressor(fit_intercept=False),
        TotalLeastSquares(),
        TotalLeastSquares(fit_intercept=False),
        InstrumentalVariables(),
        InstrumentalVariables(fit_intercept=False),
    ]
)
def test_scikit_learn_contract(estimator, check):
    check(estimator)
