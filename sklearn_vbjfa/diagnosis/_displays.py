"""Figures of fitted models and a recording, drawn by Matplotlib."""

import importlib
from dataclasses import dataclass

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_vbjfa.fit._identifier import RobotIdentifier
from sklearn_vbjfa.model._trees import is_prismatic
from sklearn_vbjfa.recording import check_clock

# Maximum number of points per panel, for legibility and speed.
_POINTS = 4000
_COLOURS = {"measured": "0.25", "before": "0.72", "after": "tab:blue"}


@dataclass(kw_only=True, eq=False)
class TorqueDisplay:
    """Measured and predicted torques over time, one panel a joint.

    Parameters
    ----------
    time : ndarray of shape (m,)
        Time [s]; rows without a sample period are counted.
    measured, before : ndarray of shape (m, nv)
        Low-pass filtered torques, and those predicted by the declared model [N m or N].
    after : ndarray of shape (m, nv), default=None
        Torques predicted by the completed model [N m or N].
    joint_names, units : sequence of str
        Joint names and torque units.

    Attributes
    ----------
    figure_, axes_, lines_ : Figure, ndarray of Axes (nv,), list of Line2D
        Set by `plot`; the lines of each joint are measured, before, after.
    """

    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray | None = None
    joint_names: tuple
    units: tuple
    _style = "-", "time [s]"

    @classmethod
    def from_estimator(
        cls, estimator, X, y, groups=None, t=None, joints=None, signals=None
    ):
        """Create the display from a fitted model and a recording.

        Parameters
        ----------
        estimator : EffectDiscovery or RobotIdentifier
            Fitted. A discovery shows its declared and its completed model.
        X, y, groups, t, signals : array-like
            Recording, as for `RobotIdentifier.residuals`.
        joints : list of int, default=None
            Joints to show, from zero; None shows all.

        Returns
        -------
        display : TorqueDisplay
            Display; call `plot`.
        """
        check_is_fitted(estimator)
        alone = isinstance(estimator, RobotIdentifier)
        models = (estimator,) if alone else (estimator.declared_, estimator.identifier_)
        residuals = [m.residuals(X, y, groups, t=t, signals=signals) for m in models]
        clock, index = check_clock(t, np.shape(X)[0], models[-1].dt), residuals[0].index
        slides = is_prismatic(models[-1].features_.model_)
        chosen = list(range(slides.size) if joints is None else joints)
        predicted = (r.predicted[:, chosen] for r in residuals)
        return cls(
            time=index if clock is None else clock[index],
            measured=residuals[0].torque[:, chosen],
            **dict(zip(("before", "after"), predicted)),
            joint_names=tuple(models[-1].joint_names_[j] for j in chosen),
            units=tuple("N" if slides[j] else "N m" for j in chosen),
        )

    def plot(self, ax=None):
        """Draw into axes, one for each joint.

        Parameters
        ----------
        ax : array-like of Axes, default=None
            Axes to draw into; None makes a figure.

        Returns
        -------
        self : object
            With `figure_`, `axes_` and `lines_`.
        """
        count = len(self.joint_names)
        if ax is None:
            try:
                # Matplotlib is optional; import it on first use.
                pyplot = importlib.import_module("matplotlib.pyplot")
            except ImportError as error:
                message = "A display needs matplotlib: pip install matplotlib."
                raise ImportError(message) from error
            size = 8.0, 1.6 * count + 0.7
            _, ax = pyplot.subplots(count, layout="constrained", figsize=size)
        self.axes_ = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
        if (n := self.axes_.size) != count:
            raise ValueError(f"ax must hold {count} axes, one a joint; got {n}.")
        self.figure_, self.lines_ = self.axes_[0].figure, []
        every = slice(None, None, max(1, len(self.time) // _POINTS))
        marker, x_label = self._style
        for j, axis in enumerate(self.axes_):
            axis.set_ylabel(f"{self.joint_names[j]} [{self.units[j]}]")
            for label, (x, y) in self._curves().items():
                style = {"c": _COLOURS[label], "lw": 1.0, "ms": 2.5, "label": label}
                self.lines_ += axis.plot(x[every, j], y[every, j], marker, **style)
        self.axes_[0].legend(fontsize="small")
        self.axes_[-1].set_xlabel(x_label)
        return self

    def _curves(self):
        """Return curves by label, pairs of (m, nv)."""
        time = np.broadcast_to(self.time[:, None], self.measured.shape)
        torques = {label: getattr(self, label) for label in _COLOURS}
        return {label: (time, x) for label, x in torques.items() if x is not None}


class ResidualDisplay(TorqueDisplay):
    """Residuals, measured minus predicted, over predicted torques, one panel a joint.

    Parameters and attributes are those of `TorqueDisplay`.
    """

    _style = ".", "predicted torque"

    def _curves(self):
        curves = super()._curves().items()
        return {k: (x, self.measured - x) for k, (_, x) in curves if k != "measured"}
