"""Figures of fitted models and a recording, drawn by Matplotlib."""

import importlib
from dataclasses import dataclass

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_vbjfa.equations._equations import make_motion
from sklearn_vbjfa.fit._identifier import RobotIdentifier
from sklearn_vbjfa.model._trees import is_prismatic
from sklearn_vbjfa.recording import check_clock, contiguous_groups

# Points of one panel: more are a blot, and slow.
_POINTS = 4000
# Bins of the running median, and how many samples one must hold.
_BINS, _FEWEST = 25, 5
# Samples beyond this quantile of the residual do not set the scale.
_QUANTILE = 0.998
_COLOURS = {"measured": "0.25", "before": "0.72", "after": "tab:blue"}
_FLOOR = "tab:orange"


class _Display:
    """Residuals or torques of the models of an estimator, and the axes they are in."""

    @classmethod
    def from_estimator(
        cls, estimator, X, y, groups=None, t=None, joints=None, signals=None
    ):
        """Make the display of a fitted model and a recording.

        Parameters
        ----------
        estimator : EffectDiscovery or RobotIdentifier
            Fitted. A discovery shows its declared model before and its completed model
            after.
        X, y, groups, t, signals : array-like
            Positions or states and torques of the recording, as for
            `RobotIdentifier.residuals`.
        joints : list of int, default=None
            Joints to show, from zero; None shows all.

        Returns
        -------
        display : object
            Display; call `plot`.
        """
        check_is_fitted(estimator)
        models = (estimator,)
        if not isinstance(estimator, RobotIdentifier):
            if not hasattr(estimator, "declared_"):
                raise ValueError(
                    f"{cls.__name__} shows a RobotIdentifier or an EffectDiscovery; "
                    f"got {type(estimator).__name__}."
                )
            models = (estimator.declared_, estimator.identifier_)
        robot = models[-1]
        names, slides = robot.joint_names_, is_prismatic(robot.features_.model_)
        chosen = [*range(len(names))] if joints is None else [int(j) for j in joints]
        if not chosen or any(not 0 <= j < len(names) for j in chosen):
            raise ValueError(
                f"joints must be some of 0 to {len(names) - 1}; got {joints!r}."
            )
        found = [m.residuals(X, y, groups, t=t, signals=signals) for m in models]
        clock = check_clock(t, np.shape(X)[0], robot.dt)
        return cls(
            **cls._values(robot, found, X, groups, clock, chosen),
            joint_names=tuple(names[j] for j in chosen),
            units=tuple("N" if slides[j] else "N m" for j in chosen),
        )

    def _axes(self, ax, columns, **subplots):
        """Take axes with one row a joint, or make a figure with them."""
        shape = len(self.joint_names), columns
        if ax is None:
            try:
                # By name, so that nothing here imports an optional package.
                pyplot = importlib.import_module("matplotlib.pyplot")
            except ImportError as error:
                raise ImportError(
                    f"{type(self).__name__}.plot needs matplotlib; install it with pip "
                    "install matplotlib."
                ) from error
            figure, axes = pyplot.subplots(
                *shape, squeeze=False, layout="constrained", **subplots
            )
        else:
            axes = np.atleast_1d(np.asarray(ax, dtype=object))
            if axes.size != shape[0] * shape[1]:
                raise ValueError(
                    f"ax must hold {shape[0]} x {shape[1]} axes, one row a joint; got "
                    f"{axes.size}."
                )
            figure = axes.flat[0].figure
        self.figure_, self.axes_, self.lines_ = figure, axes.reshape(shape), []
        for own, joint, unit in zip(self.axes_, self.joint_names, self.units):
            own[0].set_ylabel(f"{joint} [{unit}]")

    def _legend(self, ax):
        """Make one legend of the artists of all axes."""
        labelled = [axis.get_legend_handles_labels() for axis in self.axes_.flat]
        entries = {x: handle for own in labelled for handle, x in zip(*own)}
        handles, labels = list(entries.values()), list(entries)
        if ax is None:
            place = {"loc": "outside upper left", "ncols": len(labels)}
            self.figure_.legend(handles, labels, frameon=False, **place)
        else:
            self.axes_.flat[0].legend(handles, labels, fontsize="small")
        return self


@dataclass(kw_only=True, eq=False)
class ResidualDisplay(_Display):
    """Torque residuals against velocity, position, load and time.

    One row a joint: before in grey, after in colour, lines for the running medians
    (a residual without structure has flat ones), a band for the noise floor.

    Parameters
    ----------
    residual_before : ndarray of shape (m, nv)
        Residuals of the declared model [N m or N]; nan is not drawn.
    residual_after : ndarray of shape (m, nv), default=None
        Residuals of the model with effects.
    signals : dict of str to ndarray of shape (m, nv) or (m,)
        Horizontal axes; the keys become labels.
    joint_names, units : sequence of str
        Joints, and the units of their torques.
    floor : ndarray of shape (nv,), default=None
        Noise floor [N m or N]; nan where unknown.

    Attributes
    ----------
    figure_, axes_ : matplotlib Figure, and ndarray of Axes (nv, n_signals)
        Those of `plot`.
    lines_, median_lines_ : list of matplotlib Line2D
        Samples and running medians of each panel.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa.diagnosis import ResidualDisplay
    >>> v = np.linspace(-1, 1, 200)[:, None]
    >>> display = ResidualDisplay(
    ...     residual_before=np.sign(v), signals={"velocity [rad/s]": v},
    ...     joint_names=["joint1"], units=["N m"])
    >>> display.residual_before.shape
    (200, 1)
    """

    residual_before: np.ndarray
    residual_after: np.ndarray | None = None
    signals: dict
    joint_names: tuple
    units: tuple
    floor: np.ndarray | None = None

    @staticmethod
    def _values(robot, found, X, groups, clock, joints):
        """Return the arguments of the display."""
        values = [np.where(r.weight > 0, r.residual, np.nan)[:, joints] for r in found]
        return {
            **dict(zip(("residual_before", "residual_after"), values)),
            "signals": _signals(robot, X, groups, clock, found[0].index, joints),
            "floor": np.asarray(robot.noise_floor_, dtype=float)[joints],
        }

    def plot(self, ax=None):
        """Draw into axes, one row a joint and one column a signal.

        Parameters
        ----------
        ax : array-like of Axes, default=None
            Axes to draw into; None makes a figure.

        Returns
        -------
        self : object
            With `figure_`, `axes_`, `lines_` and `median_lines_`.
        """
        rows, columns = len(self.joint_names), len(self.signals)
        size = 3.0 * columns + 0.6, 1.7 * rows + 0.7
        self._axes(ax, columns, figsize=size, sharey="row")
        self.median_lines_ = []
        for j, axes in enumerate(self.axes_):
            for axis, (name, signal) in zip(axes, self.signals.items()):
                x = np.asarray(signal)
                self._panel(axis, j, x[:, j] if x.ndim == 2 else x)
                if j == rows - 1:
                    axis.set_xlabel(name)
        if ax is None:
            self.figure_.supylabel("torque residual", fontsize="medium")
        return self._legend(ax)

    def _panel(self, ax, j, x):
        """Draw the residuals of a joint over a signal."""
        if self.floor is not None and np.isfinite(self.floor[j]):
            band = {"color": _FLOOR, "alpha": 0.25, "lw": 0, "label": "noise floor"}
            ax.axhspan(-self.floor[j], self.floor[j], **band)
        ax.axhline(0.0, color="0.5", lw=0.6)
        every = slice(None, None, max(1, x.size // _POINTS))
        models = {"before": self.residual_before, "after": self.residual_after}
        shown = {k: np.asarray(r)[:, j] for k, r in models.items() if r is not None}
        for label, r in shown.items():
            style = {"ms": 2.5, "alpha": 0.7, "rasterized": True, "label": label}
            self.lines_ += ax.plot(x[every], r[every], ".", c=_COLOURS[label], **style)
            dark = {"before": "0.35", "after": "navy"}[label]
            self.median_lines_ += ax.plot(*running_median(x, r), c=dark, lw=1.5)
        sizes = np.abs(np.concatenate(list(shown.values())))
        sizes = sizes[np.isfinite(sizes)]
        limit = 1.1 * float(np.quantile(sizes, _QUANTILE)) if sizes.size else 0.0
        if limit > 0:
            ax.set_ylim(-limit, limit)


@dataclass(kw_only=True, eq=False)
class TorqueDisplay(_Display):
    """Measured and predicted torques over time.

    One row a joint: the measured torque, the prediction of the declared model and that
    of the completed one.

    Parameters
    ----------
    time : ndarray of shape (m,)
        Time [s]; rows without a sample period are counted.
    measured, before : ndarray of shape (m, nv)
        Measured torques after the low-pass, and those that the declared model predicts
        [N m or N].
    after : ndarray of shape (m, nv), default=None
        Torques that the completed model predicts [N m or N].
    joint_names, units : sequence of str
        Joints, and the units of their torques.

    Attributes
    ----------
    figure_, axes_ : matplotlib Figure, and ndarray of Axes (nv, 1)
        Those of `plot`.
    lines_ : list of matplotlib Line2D
        Curves of each joint: measured, before, after.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa.diagnosis import TorqueDisplay
    >>> t = np.linspace(0, 1, 200)
    >>> torque = np.sin(9 * t)[:, None]
    >>> display = TorqueDisplay(
    ...     time=t, measured=torque, before=0.8 * torque, joint_names=["joint1"],
    ...     units=["N m"])
    >>> display.measured.shape
    (200, 1)
    """

    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray | None = None
    joint_names: tuple
    units: tuple

    @staticmethod
    def _values(robot, found, X, groups, clock, joints):
        """Return the arguments of the display."""
        index = found[0].index
        predicted = [r.predicted[:, joints] for r in found]
        return {
            "time": index if clock is None else clock[index],
            "measured": found[0].torque[:, joints],
            **dict(zip(("before", "after"), predicted)),
        }

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
        size = 8.0, 1.6 * len(self.joint_names) + 0.7
        self._axes(ax, 1, sharex=True, figsize=size)
        every = slice(None, None, max(1, len(self.time) // _POINTS))
        models = {"measured": self.measured, "before": self.before, "after": self.after}
        for j, axis in enumerate(self.axes_[:, 0]):
            for label, values in models.items():
                if values is not None:
                    shown = np.asarray(values)[every, j]
                    style = {"c": _COLOURS[label], "lw": 1.0, "label": label}
                    self.lines_ += axis.plot(self.time[every], shown, **style)
        self.axes_[-1, 0].set_xlabel("time [s]")
        return self._legend(ax)


def running_median(x, y):
    """Medians of x and y in bins of x that hold as many samples each, without nan."""
    used = np.isfinite(x) & np.isfinite(y)
    x, y = x[used], y[used]
    count = min(_BINS, x.size // _FEWEST)
    if count == 0:
        return np.empty(0), np.empty(0)
    parts = np.array_split(np.argsort(x, kind="stable"), count)
    return (np.array([np.median(z[part]) for part in parts]) for z in (x, y))


def _signals(robot, X, groups, clock, index, joints):
    """Velocity, position, load and time at the rows of the residuals."""
    motion = make_motion(
        robot.features_,
        robot.robot_.states(np.asarray(X, dtype=float), groups),
        clock,
        contiguous_groups(groups, np.shape(X)[0]),
        robot.theta_[: robot.features_.n_parameters_],
        robot.cutoff_,
    )
    kinds = motion.prismatic[joints]
    signals = {}
    for name, values, turning, sliding in (
        ("velocity", motion.v, "rad/s", "m/s"),
        ("position", motion.q, "rad", "m"),
        ("rigid-body torque", motion.load, "N m", "N"),
    ):
        units = " or ".join(dict.fromkeys(sliding if k else turning for k in kinds))
        signals[f"{name} [{units}]"] = values[index][:, joints]
    if clock is not None:
        signals["time [s]"] = clock[index]
    return signals
