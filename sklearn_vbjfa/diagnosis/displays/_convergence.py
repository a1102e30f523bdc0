"""The bound or likelihood of an iterative fit over its iterations."""

import numpy as np

from sklearn_vbjfa.diagnosis.displays._base import Display, fitted_robot

# Samples at which the horizontal axis becomes logarithmic.
_LONG = 200


class ConvergenceDisplay(Display):
    """Bound or likelihood over the iterations, and what each gained.

    Parameters
    ----------
    history : array-like of shape (k,)
        Bound after each iteration that was kept [nat].
    quantity : str, default="lower bound"
        What it is.
    n_samples : float, default=None
        Number of samples, to which `tol` refers; None shows gains of all together.
    tol : float, default=None
        Gain per sample at which the iteration stops.
    converged : bool, default=None
        Whether it stopped for that reason.
    n_iter : int, default=None
        Number of iterations done, kept or not.
    name : str, default=None
        Name of the model, for a legend.

    Attributes
    ----------
    figure_ : matplotlib Figure
        Figure, after `plot`.
    axes_ : ndarray of Axes, shape (1,) or (2,)
        Axes, after `plot`: the bound, the gains.
    line_, gain_line_, tol_line_ : matplotlib Line2D
        Bound, gains and `tol`, after `plot`; None where they are not drawn.

    See Also
    --------
    ConvergenceDisplay.from_estimator : Make one from a fitted model.

    Notes
    -----
    A gain of an accelerated step may be greater than that of the step before. Gains
    that are not positive are rounding and have no place on a logarithmic axis.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa import JFARegressor
    >>> from sklearn_vbjfa.diagnosis import ConvergenceDisplay
    >>> rng = np.random.default_rng(0)
    >>> X = rng.normal(size=(100, 2))
    >>> y = X @ [1.0, -2.0] + 0.1 * rng.normal(size=100)
    >>> display = ConvergenceDisplay.from_estimator(JFARegressor().fit(X, y))
    >>> display.quantity
    'log-likelihood'
    >>> bool((np.diff(display.history).round(9) >= 0).all())
    True
    """

    _accepts = "a VBJFARegressor or JFARegressor, or a robot identified with one"

    def __init__(
        self,
        *,
        history,
        quantity="lower bound",
        n_samples=None,
        tol=None,
        converged=None,
        n_iter=None,
        name=None,
    ):
        self.history = history
        self.quantity = quantity
        self.n_samples = n_samples
        self.tol = tol
        self.converged = converged
        self.n_iter = n_iter
        self.name = name

    @classmethod
    def from_estimator(cls, estimator, *, name=None):
        """Show how a fit converged.

        Parameters
        ----------
        estimator : VBJFARegressor, JFARegressor, RobotIdentifier or EffectDiscovery
            Fitted. Any regressor with `elbo_history_` will do; of a robot the one
            that estimated its parameters is shown.
        name : str, default=None
            Name in the legend; None takes that of the class.

        Returns
        -------
        ConvergenceDisplay
            Display; call `plot`.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the estimator is not fitted.
        ValueError
            If it has no history, or an empty one.
        """
        robot = fitted_robot(estimator)
        regressor = estimator if robot is None else robot.estimator_.regressor_
        cls._require(regressor, ("elbo_history_",))
        history = np.array(regressor.elbo_history_, dtype=float)
        if history.size == 0:
            raise ValueError(
                f"This {type(regressor).__name__} did not iterate: its inputs or its "
                "output were constant, and the intercept is all there is."
            )
        stats = getattr(regressor, "statistics_", None)
        # Without precisions of the coefficients there is no prior, hence no bound.
        bayesian = hasattr(regressor, "alpha_")
        return cls(
            history=history,
            quantity="lower bound" if bayesian else "log-likelihood",
            n_samples=None if stats is None else float(stats.n_samples),
            tol=regressor.tol,
            converged=regressor.converged_,
            n_iter=regressor.n_iter_,
            name=type(regressor).__name__ if name is None else name,
        )

    def gains(self):
        """Return what each kept iteration gained, per sample where known [nat].

        Returns
        -------
        ndarray of shape (k - 1,)
            Gains.
        """
        return np.diff(np.asarray(self.history, dtype=float)) / (self.n_samples or 1)

    def plot(self, ax=None, *, line_kwargs=None):
        """Draw.

        Parameters
        ----------
        ax : Axes or array-like of Axes, default=None
            Two for bound and gains, one for the bound alone; None makes a figure
            with both.
        line_kwargs : dict, default=None
            What matplotlib's ``plot`` gets for bound and gains.

        Returns
        -------
        self : object
            With `figure_`, `axes_` and the lines.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If the axes do not match.
        """
        shapes = [(1, 1), (2, 1)]
        contents = "the bound and its gains"
        self._open(ax, shapes, contents, sharex=True, figsize=(6.4, 5.0))
        history = np.asarray(self.history, dtype=float)
        steps = np.arange(1, history.size + 1)
        style = {"marker": ".", "ms": 4, "lw": 1.2} | (line_kwargs or {})
        label = {"label": self._label()} | style
        (self.line_,) = self.axes_[0].plot(steps, history, **label)
        self.axes_[0].set_ylabel(f"{self.quantity} [nat]")
        self.gain_line_ = self.tol_line_ = None
        if self.axes_.size == 2:
            self._draw_gains(self.axes_[1], steps[1:], style)
        self.axes_[-1].set_xlabel("iteration (kept)")
        for axis in self.axes_:
            if history.size > _LONG:
                axis.set_xscale("log")
            else:
                axis.xaxis.get_major_locator().set_params(integer=True)
        self._close(ax)
        return self

    def _label(self):
        parts = [self.name] if self.name else []
        if self.n_iter is not None:
            parts.append(f"{self.n_iter} iterations")
        if self.converged is not None:
            parts.append("converged" if self.converged else "not converged")
        return ", ".join(parts) or self.quantity

    def _draw_gains(self, ax, steps, style):
        gains = self.gains()
        rising = gains > 0
        (self.gain_line_,) = ax.plot(steps[rising], gains[rising], **style)
        if rising.any():
            ax.set_yscale("log")
        per_sample = self.n_samples is not None
        ax.set_ylabel("gain per sample [nat]" if per_sample else "gain [nat]")
        if self.tol is not None and self.tol > 0 and per_sample:
            self.tol_line_ = ax.axhline(
                self.tol, color="0.4", ls="--", lw=1, label="tol"
            )
