"""Locally weighted regression around any linear regressor."""

from numbers import Integral

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.regression._base import BaseRegressor, Interval
from sklearn_vbjfa.regression._vbjfa import VBJFARegressor

# Samples further than this many bandwidths from a centre weigh less than 0.4 % there
# and are left out of its model.
_REACH = 3.3
# Width of a model, in standard deviations, that weighs all samples alike.
_WIDEST = 1e6


class LocallyWeightedRegressor(BaseRegressor):
    r"""Piecewise linear regression: local models, blended by their distance.

    The extension that section 6 of [1]_ names: linear models around centres
    :math:`c_k`, each fitted with the weights

    .. math:: w_k(x) = \exp(-\tfrac12 |D (x - c_k)|^2 / h_k^2),

    D scaling every input to unit standard deviation; the prediction is the weighted
    mean of the local models' predictions.

    Parameters
    ----------
    regressor : estimator, default=None
        Linear regressor whose `fit` takes `sample_weight`; None is
        ``VBJFARegressor()``.
    n_models : int, default=10
        Number of local models, whose centres k-means finds without random numbers.

    Attributes
    ----------
    centers_ : ndarray of shape (n_models, n_features)
        Centres, in the units of X.
    bandwidth_ : ndarray of shape (n_models,)
        Distances h to the nearest other centre, in standard deviations of the inputs.
    scale_ : ndarray of shape (n_features,)
        Standard deviations of the inputs; 1 for a constant one.
    estimators_ : list of estimator
        Local models, of inputs relative to their centre.
    n_features_in_ : int
        Number of features seen during fit.
    feature_names_in_ : ndarray of shape (n_features,)
        Their names, where X had names that are all strings.

    Notes
    -----
    Locality is judged by the noisy inputs: a model sees samples whose noise put them
    there, and within a small neighbourhood noise is a larger share of the inputs'
    variance. Widths far below the standard deviation of the noise make no sense.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`
    .. [2] C. G. Atkeson, A. W. Moore, S. Schaal, "Locally weighted learning",
       Artificial Intelligence Review 11, 1997. :doi:`10.1023/A:1006559212014`

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa import LocallyWeightedRegressor
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(-3, 3, size=(2000, 1))
    >>> y = np.sin(X[:, 0])
    >>> model = LocallyWeightedRegressor().fit(X, y)
    >>> bool(model.score(X, y) > 0.99)
    True
    """

    _parameter_constraints: dict = {  # noqa: RUF012
        "regressor": "no_validation",
        "n_models": [Interval(Integral, 1, None, closed="left")],
    }

    def __init__(self, regressor=None, *, n_models=10):
        self.regressor = regressor
        self.n_models = n_models

    def _fit_rows(self, X, y, weight):
        if weight is None:
            weight = np.ones(X.shape[0])
        used = weight > 0
        mean = np.average(X, axis=0, weights=weight)
        spread = np.sqrt(np.average((X - mean) ** 2, axis=0, weights=weight))
        self.scale_ = or_one(spread)
        Z = X / self.scale_
        first = _spread_points(Z[used], self.n_models)
        n_models = first.shape[0]
        # Imported here: it brings eighty modules that nothing else needs.
        from sklearn.cluster import KMeans

        means = KMeans(n_models, init=first, n_init=1)
        means.fit(Z[used], sample_weight=weight[used])
        centers = means.cluster_centers_
        self.centers_ = centers * self.scale_
        squares = ((centers[:, None] - centers[None]) ** 2).sum(axis=-1)
        np.fill_diagonal(squares, np.inf)
        # A single model is the global one.
        self.bandwidth_ = np.minimum(np.sqrt(squares.min(axis=1)), _WIDEST)
        local = np.exp(self._exponents(Z, centers))
        template = VBJFARegressor() if self.regressor is None else self.regressor
        self.estimators_ = []
        for k in range(n_models):
            w = local[:, k] * weight
            near = used & (local[:, k] > np.exp(-0.5 * _REACH**2))
            if np.unique(Z[near], axis=0).shape[0] < 2 or w[near].sum() <= 1.1:
                near, w = used, weight
            model = clone(template)
            model.fit(X[near] - self.centers_[k], y[near], sample_weight=w[near])
            self.estimators_.append(model)

    def _exponents(self, Z, centers):
        """Logarithms (n, k) of the weights of standardised rows around centres."""
        squares = ((Z[:, None] - centers[None]) ** 2).sum(axis=-1)
        return -0.5 * squares / self.bandwidth_**2

    def predict(self, X):
        """Blend the local models' predictions.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Queries.

        Returns
        -------
        ndarray of shape (n_samples,)
            Predicted outputs.
        """
        X = self._check_queries(X)
        exponent = self._exponents(X / self.scale_, self.centers_ / self.scale_)
        # Far from all centres the nearest model decides, whatever underflows.
        exponent -= exponent.max(axis=1, keepdims=True)
        weight = np.exp(exponent)
        local = np.column_stack(
            [model.predict(X - c) for model, c in zip(self.estimators_, self.centers_)]
        )
        return (weight * local).sum(axis=1) / weight.sum(axis=1)


def _spread_points(Z, count):
    """Pick up to `count` distinct rows, each the farthest from those before."""
    rows = np.unique(Z, axis=0)
    middle = rows.mean(axis=0)
    chosen = [int(np.argmin(((rows - middle) ** 2).sum(axis=1)))]
    distance = ((rows - rows[chosen[0]]) ** 2).sum(axis=1)
    while len(chosen) < count and distance.max() > 0:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, ((rows - rows[chosen[-1]]) ** 2).sum(axis=1))
    return rows[chosen]
