"""Input noise from repeated measurements of the same units."""

from dataclasses import dataclass

import numpy as np
from sklearn.utils.validation import check_array, check_consistent_length, column_or_1d


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseCovariance:
    """Covariance of the input noise, and how well it is known.

    ``input_noise=`` of the regressors takes it as it is, and counts its degrees of
    freedom in their intervals; ``np.asarray`` gives the covariance alone.

    Attributes
    ----------
    covariance : ndarray of shape (n_features, n_features)
        Covariance of the noise of one measurement [unit of X_i times unit of X_j].
    dof : float
        Degrees of freedom: measurements less units.
    """

    covariance: np.ndarray
    dof: float

    def __array__(self, dtype=None, copy=None):
        """Return the covariance as an array, a copy of it unless `copy` is False."""
        if copy is False:
            return np.asarray(self.covariance, dtype=dtype)
        return np.array(self.covariance, dtype=dtype)

    def of_means(self, n_measurements):
        """Return the covariance of the noise of means.

        Parameters
        ----------
        n_measurements : int
            Measurements that each mean was taken of.

        Returns
        -------
        NoiseCovariance
            Covariance divided by their number, with the same degrees of freedom.

        Raises
        ------
        ValueError
            If their number is less than one.
        """
        if not n_measurements >= 1:
            raise ValueError(
                "n_measurements must be the number of measurements in each mean, 1 or "
                f"more; got {n_measurements!r}."
            )
        return NoiseCovariance(
            covariance=self.covariance / n_measurements, dof=self.dof
        )


def replicate_noise(X, groups):
    """Estimate the covariance of the input noise from repeated measurements.

    What differs between measurements of one unit is noise. Its covariance is that of
    the measurements about the means of their units, pooled over all units, with as many
    degrees of freedom as there are measurements more than units (Fuller 1987,
    section 2.2).

    Parameters
    ----------
    X : array-like of shape (n_samples, n_features)
        Measurements, a row each.
    groups : array-like of shape (n_samples,)
        Label of the unit that each row is a measurement of. Units may have unequal
        numbers of measurements; those with a single one say nothing of the noise.

    Returns
    -------
    NoiseCovariance
        Covariance of the noise of a single measurement, and its degrees of freedom.
        It is singular with fewer degrees of freedom than features, and zero in a
        column whose measurements agree.

    Raises
    ------
    ValueError
        If no unit was measured more than once, or X and groups do not fit.

    See Also
    --------
    VBJFARegressor : Takes it as `input_noise`.

    Notes
    -----
    The noise must be that of the rows which the model is fitted to: for means of m
    measurements take ``replicate_noise(X, groups).of_means(m)``. What all measurements
    of a unit have in common (a bias of its own, a drift from unit to unit) is no
    difference between them, and is not seen.

    References
    ----------
    W. A. Fuller, "Measurement Error Models", Wiley, 1987. :doi:`10.1002/9780470316665`

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa import VBJFARegressor, replicate_noise
    >>> rng = np.random.default_rng(0)
    >>> t = rng.normal(size=(4000, 2))
    >>> y = t @ [1.0, -2.0] + 0.1 * rng.normal(size=4000)
    >>> first, second = (t + 0.5 * rng.normal(size=t.shape) for _ in range(2))
    >>> noise = replicate_noise(np.vstack([first, second]), np.tile(range(4000), 2))
    >>> noise.dof
    4000.0
    >>> np.asarray(noise).diagonal().round(2)
    array([0.24, 0.25])
    >>> model = VBJFARegressor(input_noise=noise, query="noiseless")
    >>> model.fit(first, y).coef_.round(1)
    array([ 1., -2.])
    """
    X = check_array(X, dtype=np.float64, ensure_min_samples=2, input_name="X")
    groups = column_or_1d(groups)
    check_consistent_length(X, groups)
    _, unit, count = np.unique(groups, return_inverse=True, return_counts=True)
    dof = X.shape[0] - count.size
    if dof == 0:
        raise ValueError(
            "groups must name some unit more than once: the noise is what differs "
            f"between measurements of the same unit; got {count.size} units with one "
            "measurement each."
        )
    # About the first measurement of each unit first: measurements that agree then
    # differ from their mean by exactly zero, whatever their offset.
    first = np.zeros(count.size, dtype=int)
    first[unit[::-1]] = np.arange(X.shape[0])[::-1]
    rest = X - X[first][unit]
    mean = np.zeros((count.size, X.shape[1]))
    np.add.at(mean, unit, rest)
    rest -= (mean / count[:, None])[unit]
    return NoiseCovariance(covariance=rest.T @ rest / dof, dof=float(dof))
