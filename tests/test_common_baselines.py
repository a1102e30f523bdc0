"""The contract of scikit-learn for the baseline regressors."""

from sklearn.utils.estimator_checks import parametrize_with_checks

from sklearn_vbjfa import InstrumentalVariables, StepwiseRegressor, TotalLeastSquares


@parametrize_with_checks(
    [
        StepwiseRegressor(),
        TotalLeastSquares(),
        InstrumentalVariables(),
    ]
)
def test_scikit_learn_contract(estimator, check):
    check(estimator)
