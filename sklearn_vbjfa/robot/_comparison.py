"""Compare methods on one recording: same equations, same held-out part."""

from dataclasses import dataclass

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.linear_model import LassoCV, LinearRegression, RidgeCV
from sklearn.model_selection import KFold

from sklearn_vbjfa._core._progress import counted, say
from sklearn_vbjfa.recording import take_arrays
from sklearn_vbjfa.regression import (
    InstrumentalVariables,
    JFARegressor,
    StepwiseRegressor,
    TotalLeastSquares,
    VBJFARegressor,
)
from sklearn_vbjfa.robot._estimate import min_eigenvalues
from sklearn_vbjfa.robot._plan import corrects_noise
from sklearn_vbjfa.robot._residuals import collect_residuals, torque_spread

OURS = "VB + projection"
# Methods with physically consistent parameters.
PROJECTED = (OURS, "VB + description")
# Rows are in time order, so unshuffled folds are blocks of time.
_BLOCKS = KFold(5)


class PartialLeastSquares(RegressorMixin, BaseEstimator):
    """Partial least squares, its number of directions chosen on blocks of time."""

    # That of scikit-learn (PLSRegression, without scaling, in a GridSearchCV), from the
    # triangle of an orthogonal decomposition of each block in place of its rows: what
    # is fitted and judged are lengths and angles of columns, which are the same.

    def __init__(self, components=(1,)):
        self.components = components

    def fit(self, X, y):
        """Fit to X (n, p) and y (n,), whose means are taken off."""
        rows = np.column_stack([np.ones(len(X)), X, y])
        blocks = [_triangle(rows[own]) for _, own in _BLOCKS.split(rows)]
        sizes = [own.size for _, own in _BLOCKS.split(rows)]
        errors = np.zeros(len(self.components))
        for k, (block, size) in enumerate(zip(blocks, sizes)):
            others = _triangle(np.concatenate([*blocks[:k], *blocks[k + 1 :]]))
            for i, (first, coef) in enumerate(_directions(others, self.components)):
                left = block @ np.concatenate([[-first], -coef, [1.0]])
                errors[i] += left @ left / size
        best = [self.components[int(np.argmin(errors))]]
        self.n_components_ = best[0]
        whole = _triangle(np.concatenate(blocks))
        ((self.intercept_, self.coef_),) = _directions(whole, best)
        return self

    def predict(self, X):
        """Predict y (n,) for X (n, p)."""
        return X @ self.coef_ + self.intercept_


def _triangle(rows):
    """Triangle of an orthogonal decomposition of rows (n, k)."""
    return np.linalg.qr(rows, mode="r")


def _directions(triangle, components):
    """Intercept and coefficients (p,) of so many directions, for each number."""
    # triangle: of [1, X, y]; below its first row are X and y without their means.
    means = triangle[0, 1:] / triangle[0, 0]
    X, y = triangle[1:, 1:-1].copy(), triangle[1:, -1].copy()
    weights, loadings, shares, found = [], [], [], {0: np.zeros(X.shape[1])}
    # Directions beyond those that the data have would be rounding.
    least = X.size * np.finfo(float).eps * np.linalg.norm(X) * np.linalg.norm(y)
    for count in range(1, max(components) + 1):
        weight = X.T @ y
        size = np.linalg.norm(weight)
        if not size > least:
            break
        weight /= size
        score = X @ weight
        power = score @ score
        loading, share = score @ X / power, score @ y / power
        X -= np.outer(score, loading)
        y -= share * score
        weights.append(weight)
        loadings.append(loading)
        shares.append(share)
        W, P = np.transpose(weights), np.transpose(loadings)
        found[count] = W @ np.linalg.solve(P.T @ W, shares)
    for count in components:
        coef = found[min(count, max(found))]
        yield means[-1] - means[:-1] @ coef, coef


def methods(n_parameters):
    """Return name -> settings of `RobotIdentifier` for every method."""
    # All share states, filter, mask and joint weights (except ordinary least squares);
    # hyperparameters are cross-validated over five blocks of time of the training part.
    components = sorted(
        {int(c) for c in np.geomspace(3, max(4, 0.8 * n_parameters), 8)}
    )
    pls = PartialLeastSquares(components=components)
    ridge = RidgeCV(alphas=np.geomspace(1e-4, 1e4, 17), cv=_BLOCKS)
    lasso = LassoCV(cv=_BLOCKS, alphas=30, eps=1e-5, max_iter=20_000, tol=1e-3)
    alone = {"regressor": None, "bodies": "free", "alike": None}
    plain = {"projector": None, "alike": None}
    return {
        OURS: {**alone, "projector": "default"},
        "VB + description": {
            "regressor": None,
            "projector": "default",
            "bodies": "prior",
        },
        "VB": {**alone, "projector": None},
        "OLS": {**plain, "regressor": LinearRegression(), "joint_weights": None},
        "WLS": {"regressor": LinearRegression(), **plain},
        "ridge": {"regressor": ridge, **plain},
        "LASSO": {"regressor": lasso, **plain},
        "PLS": {"regressor": pls, **plain},
        "stepwise": {"regressor": StepwiseRegressor(), **plain},
        "TLS": {"regressor": TotalLeastSquares(), **plain},
        "IV": {"regressor": InstrumentalVariables(), **plain},
        "JFA": {"regressor": JFARegressor(query="noiseless"), **plain},
        "VB-JFA": {
            "regressor": VBJFARegressor(latent="independent", query="noiseless"),
            **plain,
        },
        "VB-JFA, default": {"regressor": VBJFARegressor(), **plain},
        "VB-JFA, paper": {
            "regressor": VBJFARegressor(
                latent="independent", prior="paper", query="noiseless"
            ),
            **plain,
        },
    }


@dataclass(frozen=True, kw_only=True)
class MethodResult:
    """One method on one recording."""

    name: str
    # (nv,): held out: root mean square of the residual over the torque's deviation
    error: np.ndarray
    train_error: np.ndarray  # (nv,): the same on the training part
    # smallest over all bodies' pseudo-inertia matrices, dimensionless
    min_eigenvalue: float
    n_inconsistent: int  # number of bodies that are not physically consistent
    message: str = ""  # why the method gave no result; empty otherwise


def compare_methods(identifier, train, test, *, names=None, of_both=False):
    """Fit all methods to the training part and evaluate them on the held-out part."""
    # train, test: (X, y, groups); names: by default all; of_both: whether errors are
    # over the torque's deviation in both parts, as in a report, and not in each.
    # Returns a `MethodResult` each, and the fitted identifier of the first method.
    base = clone(identifier)
    X, y, groups = train
    own = {"dt": base.dt, "joint_names": base.build_model().joint_names_}
    base.fit_inspected(take_arrays(X, y, groups, **own))
    robot = base.robot_
    train_pieces, test_pieces = robot.pieces(*train), robot.pieces(*test)
    halves = None if base.input_noise is None else "noise"
    measured_pieces = robot.pieces(*train, halves=halves)
    chosen = methods(len(base.parameter_names_))
    if names is not None:
        chosen = {name: chosen[name] for name in names}
    results = []
    for name in counted(chosen, "comparing methods", "methods"):
        say(name)
        model = clone(identifier).set_params(**chosen[name])
        pieces = train_pieces
        if corrects_noise(model.regressor):
            pieces = measured_pieces
        if name == "IV":
            pieces = robot.pieces(*train, halves="instruments")
        try:
            found = model.estimated(pieces, robot.plan)
        except ValueError as refused:
            nothing = np.full(len(base.joint_names_), np.nan)
            results.append(
                MethodResult(
                    name=name,
                    error=nothing,
                    train_error=nothing,
                    min_eigenvalue=np.nan,
                    n_inconsistent=0,
                    message=str(refused),
                )
            )
            continue
        rigid = found.theta[: base.features_.n_parameters_]
        eigenvalues = min_eigenvalues(rigid.reshape(len(base.joint_names_), -1))
        left = [
            collect_residuals(parts, found.theta)
            for parts in (test_pieces, train_pieces)
        ]
        spreads = [torque_spread(*left)] * 2 if of_both else map(torque_spread, left)
        error, train_error = (
            own.relative_error(spread) for own, spread in zip(left, spreads)
        )
        results.append(
            MethodResult(
                name=name,
                error=error,
                train_error=train_error,
                min_eigenvalue=float(eigenvalues.min()),
                n_inconsistent=int((eigenvalues <= 0).sum()),
            )
        )
    return results, base
