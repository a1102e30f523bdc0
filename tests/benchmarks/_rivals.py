"""scikit-learn's regressors, as rivals on the columns of this package."""

from dataclasses import replace

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import (
    HuberRegressor,
    LassoCV,
    LinearRegression,
    RidgeCV,
    TheilSenRegressor,
)
from sklearn.model_selection import GridSearchCV, KFold

from sklearn_vbjfa import InstrumentalVariables, StepwiseRegressor

# Rows are in time order, so unshuffled folds are blocks of time.
BLOCKS = KFold(5)


class PartialLeastSquares(RegressorMixin, BaseEstimator):
    """Partial least squares whose number of directions is chosen on blocks of time."""

    def fit(self, X, y):
        rank = np.linalg.matrix_rank(X.T @ X, hermitian=True)
        counts = sorted({int(c) for c in np.geomspace(1, rank, 8)})
        grid = {"n_components": counts}
        search = GridSearchCV(PLSRegression(scale=False), grid, cv=BLOCKS).fit(X, y)
        self.coef_ = np.ravel(search.best_estimator_.coef_)
        self.intercept_ = float(np.ravel(search.best_estimator_.intercept_)[0])
        return self

    def predict(self, X):
        return X @ self.coef_ + self.intercept_


def regressors():
    """Return name -> regressor; strengths are chosen over five blocks of time."""
    alone = {"fit_intercept": False}
    return {
        "WLS": LinearRegression(**alone),
        "ridge": RidgeCV(alphas=np.geomspace(1e-4, 1e4, 17), cv=BLOCKS),
        "LASSO": LassoCV(cv=BLOCKS, alphas=30, eps=1e-5, max_iter=20_000, tol=1e-3),
        "PLS": PartialLeastSquares(),
        "stepwise": StepwiseRegressor(),
        "IDIM-IV": InstrumentalVariables(),
        "Huber": HuberRegressor(alpha=0.0, max_iter=500, **alone),
        "Theil-Sen": TheilSenRegressor(
            max_subpopulation=200, max_iter=50, random_state=0, **alone
        ),
    }


def settings_of(name, options):
    """Return settings of a `RobotIdentifier` with one of the regressors."""
    return {
        "regressor": regressors()[name],
        "projector": None,
        "options": replace(options, alike=None),
    }
