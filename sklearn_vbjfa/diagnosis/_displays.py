"""Figures of fitted models and a recording, drawn by Matplotlib."""

import importlib

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_vbjfa.model._trees import is_prismatic
from sklearn_vbjfa.recording import check_clock, contiguous_groups
from sklearn_vbjfa.robot._equations import make_motion
from sklearn_vbjfa.robot._identifier import RobotIdentifier

# Points of one panel: more are a blot, and slow.
_POINTS = 4000
# Bins of the running median, and how many samples one must hold.
_BINS, _FEWEST = 25, 5
# Samples beyond this quantile of the residual do not set the scale.
_QUANTILE = 0.998
_GREY, _COLOUR, _FLOOR, _MEASURED = "0.72", "tab:blue", "tab:orange", "0.25"


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
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions or states.
        y : array-like of shape (n_samples, nv)
            Torques [N m or N].
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        t : array-like of shape (n_samples,), default=None
            Time [s], on the clock of the fit.
        joints : list of int, default=None
            Joints to show, from zero; None shows all.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Recorded signals, for effects that vary with them.

        Returns
        -------
        display : object
            Display; call `plot`.

        Raises
        ------
        ValueError
            If the estimator or the joints do not fit.
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
        names, prismatic = models[0].joint_names_, models[0].features_.model_
        chosen = list(range(len(names)))
        if joints is not None:
            chosen = [int(j) for j in joints]
        if not chosen or any(not 0 <= j < len(names) for j in chosen):
            raise ValueError(
                f"joints must be some of 0 to {len(names) - 1}; got {joints!r}."
            )
        found = [m.residuals(X, y, groups, t=t, signals=signals) for m in models]
        slides = is_prismatic(prismatic)
        return cls(
            **cls._values(models[-1], found, X, groups, t, chosen),
            joint_names=tuple(names[j] for j in chosen),
            units=tuple("N" if slides[j] else "N m" for j in chosen),
        )

    def _open(self, ax, shape, **subplots):
        """Take axes of a shape, or make a figure with them."""
        if ax is None:
            figure, axes = _import_pyplot(type(self).__name__).subplots(
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
        self.figure_, self.axes_ = figure, axes.reshape(shape)
        self.lines_ = []

    def _close(self, ax):
        """Make one legend of the artists of all axes."""
        entries = {}
        for axis in self.axes_.flat:
            for handle, label in zip(*axis.get_legend_handles_labels()):
                entries.setdefault(label, handle)
        place = {"handles": list(entries.values()), "labels": list(entries)}
        if ax is None:
            place |= {"loc": "outside upper left", "ncols": len(entries)}
            self.figure_.legend(**place, frameon=False)
        else:
            self.axes_.flat[0].legend(**place, fontsize="small")
        return self


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
    figure_ : matplotlib Figure
        Figure, after `plot`.
    axes_ : ndarray of Axes, shape (nv, n_signals)
        Axes, after `plot`.
    lines_, median_lines_ : list of matplotlib Line2D
        Samples and running medians of each panel, after `plot`.

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

    def __init__(
        self,
        *,
        residual_before,
        residual_after=None,
        signals,
        joint_names,
        units,
        floor=None,
    ):
        self.residual_before = residual_before
        self.residual_after = residual_after
        self.signals = signals
        self.joint_names = joint_names
        self.units = units
        self.floor = floor

    @staticmethod
    def _values(robot, found, X, groups, t, joints):
        """Return the arguments of the display."""
        values = [np.where(r.weight > 0, r.residual, np.nan)[:, joints] for r in found]
        return {
            "residual_before": values[0],
            "residual_after": values[1] if len(values) > 1 else None,
            "signals": _signals(robot, X, groups, t, found[0].index, joints),
            "floor": np.asarray(robot.noise_floor_, dtype=float)[joints],
        }

    def plot(self, ax=None, *, scatter_kwargs=None, line_kwargs=None):
        """Draw.

        Parameters
        ----------
        ax : array-like of Axes, default=None
            One row a joint, one column a signal; None makes a figure.
        scatter_kwargs, line_kwargs : dict, default=None
            Arguments of matplotlib's ``plot`` for the samples and for the medians.

        Returns
        -------
        self : object
            With `figure_`, `axes_`, `lines_` and `median_lines_`.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If the axes do not match.
        """
        rows, columns = shape = len(self.joint_names), len(self.signals)
        size = {"figsize": (3.0 * columns + 0.6, 1.7 * rows + 0.7), "sharey": "row"}
        self._open(ax, shape, **size)
        self.median_lines_ = []
        for j, axes in enumerate(self.axes_):
            for axis, (name, signal) in zip(axes, self.signals.items()):
                x = np.asarray(signal)
                x = x[:, j] if x.ndim == 2 else x
                self._panel(axis, j, x, scatter_kwargs or {}, line_kwargs or {})
                if j == rows - 1:
                    axis.set_xlabel(name)
            axes[0].set_ylabel(f"{self.joint_names[j]} [{self.units[j]}]")
        if ax is None:
            self.figure_.supylabel("torque residual", fontsize="medium")
        return self._close(ax)

    def _panel(self, ax, j, x, dots, line):
        """Draw the residuals of a joint over a signal."""
        floor = np.nan if self.floor is None else float(self.floor[j])
        if np.isfinite(floor):
            band = {"color": _FLOOR, "alpha": 0.25, "lw": 0, "label": "noise floor"}
            ax.axhspan(-floor, floor, **band)
        ax.axhline(0.0, color="0.5", lw=0.6)
        every = slice(None, None, max(1, x.size // _POINTS))
        shown = [np.empty(0)]
        for label, values, colour, dark in (
            ("before", self.residual_before, _GREY, "0.35"),
            ("after", self.residual_after, _COLOUR, "navy"),
        ):
            if values is None:
                continue
            r = np.asarray(values)[:, j]
            shown.append(np.abs(r[np.isfinite(r)]))
            style = {"ls": "", "marker": ".", "ms": 2.5, "color": colour, "alpha": 0.7}
            style |= {"rasterized": True, "label": label} | dots
            self.lines_ += ax.plot(x[every], r[every], **style)
            style = {"color": dark, "lw": 1.5} | line
            self.median_lines_ += ax.plot(*running_median(x, r), **style)
        shown = np.concatenate(shown)
        limit = 1.1 * float(np.quantile(shown, _QUANTILE)) if shown.size else 0.0
        if limit > 0:
            ax.set_ylim(-limit, limit)


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
    figure_ : matplotlib Figure
        Figure, after `plot`.
    axes_ : ndarray of Axes, shape (nv, 1)
        Axes, after `plot`.
    lines_ : list of matplotlib Line2D
        Curves of each joint, after `plot`: measured, before, after.

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

    def __init__(self, *, time, measured, before, after=None, joint_names, units):
        self.time = time
        self.measured = measured
        self.before = before
        self.after = after
        self.joint_names = joint_names
        self.units = units

    @staticmethod
    def _values(robot, found, X, groups, t, joints):
        """Return the arguments of the display."""
        index, clock = found[0].index, check_clock(t, np.shape(X)[0], robot.dt)
        predicted = [r.predicted[:, joints] for r in found]
        return {
            "time": index if clock is None else clock[index],
            "measured": found[0].torque[:, joints],
            "before": predicted[0],
            "after": predicted[1] if len(predicted) > 1 else None,
        }

    def plot(self, ax=None, *, line_kwargs=None):
        """Draw.

        Parameters
        ----------
        ax : array-like of Axes, default=None
            One for each joint; None makes a figure.
        line_kwargs : dict, default=None
            Arguments of matplotlib's ``plot`` for all curves.

        Returns
        -------
        self : object
            With `figure_`, `axes_` and `lines_`.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If the axes do not match.
        """
        rows = len(self.joint_names)
        self._open(ax, (rows, 1), sharex=True, figsize=(8.0, 1.6 * rows + 0.7))
        every = slice(None, None, max(1, len(self.time) // _POINTS))
        for j, axis in enumerate(self.axes_[:, 0]):
            for label, values, colour in (
                ("measured", self.measured, _MEASURED),
                ("before", self.before, _FLOOR),
                ("after", self.after, _COLOUR),
            ):
                if values is not None:
                    style = {"color": colour, "lw": 1.0, "label": label}
                    shown = np.asarray(values)[every, j]
                    style |= line_kwargs or {}
                    self.lines_ += axis.plot(self.time[every], shown, **style)
            axis.set_ylabel(f"{self.joint_names[j]} [{self.units[j]}]")
        self.axes_[-1, 0].set_xlabel("time [s]")
        return self._close(ax)


def _import_pyplot(display):
    """Import matplotlib.pyplot; an error names the display that needs it."""
    try:
        # By name, so that nothing here imports an optional package.
        return importlib.import_module("matplotlib.pyplot")
    except ImportError as error:
        raise ImportError(
            f"{display}.plot needs matplotlib; install it with pip install matplotlib."
        ) from error


def running_median(x, y):
    """Medians of x and y in bins of x that hold as many samples each, without nan."""
    used = np.isfinite(x) & np.isfinite(y)
    x, y = x[used], y[used]
    count = min(_BINS, x.size // _FEWEST)
    if count == 0:
        return np.empty(0), np.empty(0)
    parts = np.array_split(np.argsort(x, kind="stable"), count)
    return (np.array([np.median(z[part]) for part in parts]) for z in (x, y))


def _signals(robot, X, groups, t, index, joints):
    """Velocity, position, load and time at the rows of the residuals."""
    X = np.asarray(X, dtype=float)
    clock = check_clock(t, X.shape[0], robot.dt)
    motion = make_motion(
        robot.features_,
        robot.robot_.states(X, groups),
        clock,
        contiguous_groups(groups, X.shape[0]),
        robot.theta_[: robot.features_.n_parameters_],
        robot.cutoff_,
    )
    kinds = motion.prismatic[joints]

    def unit(turning, sliding):
        return " or ".join(dict.fromkeys(sliding if k else turning for k in kinds))

    signals = {
        f"velocity [{unit('rad/s', 'm/s')}]": motion.v[index][:, joints],
        f"position [{unit('rad', 'm')}]": motion.q[index][:, joints],
        f"rigid-body torque [{unit('N m', 'N')}]": motion.load[index][:, joints],
    }
    if clock is not None:
        signals["time [s]"] = clock[index]
    return signals
