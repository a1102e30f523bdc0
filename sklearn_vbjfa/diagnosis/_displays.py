"""Figures of fitted models and a recording, drawn by Matplotlib."""

import importlib

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_vbjfa.model._trees import is_prismatic
from sklearn_vbjfa.recording import check_clock, contiguous_groups
from sklearn_vbjfa.robot._equations import make_motion
from sklearn_vbjfa.robot._identifier import RobotIdentifier


class Display:
    """A new figure, or the user's axes, and the legend of what is drawn in them."""

    # A display stores its data in the constructor; its `plot` calls `_open`, draws on
    # `axes_` and ends with `_close`. Matplotlib is imported when a figure is made.

    # What `from_estimator` takes, for those who give something else.
    _accepts = ""

    @classmethod
    def _require(cls, estimator, attributes):
        """Refuse a fitted estimator that lacks what the display shows."""
        missing = [name for name in attributes if not hasattr(estimator, name)]
        if missing:
            raise ValueError(
                f"{cls.__name__} shows {cls._accepts}; got {type(estimator).__name__}, "
                f"which has no {', '.join(missing)}."
            )

    def _open(self, ax, shapes, contents, **subplots):
        """Take axes, of one of the shapes, or make a figure; the last shape is its."""
        if ax is None:
            name = type(self).__name__
            figure, axes = _import_pyplot(name).subplots(
                *shapes[-1], squeeze=False, layout="constrained", **subplots
            )
        else:
            axes = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
            if axes.size not in [rows * columns for rows, columns in shapes]:
                expected = " or ".join(
                    f"{r} x {c}" if min(r, c) > 1 else str(r * c) for r, c in shapes
                )
                raise ValueError(
                    f"ax must hold {expected} axes, {contents}; got {axes.size}."
                )
            figure = axes[0].figure
        self.figure_, self.axes_ = figure, axes.ravel()

    def _close(self, ax, *, least=1):
        """Make one legend of the artists of all axes, if it has enough entries."""
        entries = {}
        for axis in self.axes_.flat:
            for handle, label in zip(*axis.get_legend_handles_labels()):
                entries.setdefault(label, handle)
        if len(entries) < least:
            return
        place = {"handles": list(entries.values()), "labels": list(entries)}
        if ax is None:
            room = max(1, int(self.figure_.get_figwidth() / 2.2))
            place |= {"loc": "outside upper left", "frameon": False}
            self.figure_.legend(**place, ncols=min(len(entries), room))
        else:
            self.axes_.flat[0].legend(**place, fontsize="small")


def _import_pyplot(display):
    """Import matplotlib.pyplot; an error names the display that needs it."""
    try:
        # By name, so that nothing here imports an optional package.
        return importlib.import_module("matplotlib.pyplot")
    except ImportError as error:
        raise ImportError(
            f"{display}.plot needs matplotlib; install it with pip install matplotlib."
        ) from error


# Points of one panel: more are a blot, and slow.
_POINTS = 4000
# Bins of the running median, and how many samples one must hold.
_BINS, _FEWEST = 25, 5
# Samples beyond this quantile of the residual do not set the scale.
_QUANTILE = 0.998
_GREY, _COLOUR, _FLOOR, _MEASURED = "0.72", "tab:blue", "tab:orange", "0.25"


class ResidualDisplay(Display):
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
        What to plot against; the keys become labels.
    joint_names : sequence of str
        Joints.
    units : sequence of str
        Units of their torques.
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

    See Also
    --------
    ResidualDisplay.from_estimator : Make one from a fitted model and a recording.
    ResidualDisplay.from_report : Make one from the report of a discovery.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa.diagnosis import ResidualDisplay
    >>> v = np.linspace(-1, 1, 200)[:, None]
    >>> display = ResidualDisplay(
    ...     residual_before=np.sign(v), residual_after=0.1 * np.sin(40 * v),
    ...     signals={"velocity [rad/s]": v}, joint_names=["joint1"], units=["N m"])
    >>> display.residual_before.shape
    (200, 1)
    """

    _accepts = "a RobotIdentifier or an EffectDiscovery"

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

    @classmethod
    def from_estimator(
        cls, estimator, X, y, groups=None, t=None, joints=None, signals=None
    ):
        """Compare a fitted model with a recording.

        The residuals are those of the models as they are fitted: give data that they
        have not seen.

        Parameters
        ----------
        estimator : EffectDiscovery or RobotIdentifier
            Fitted; a discovery shows the declared model before, the completed one
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
        ResidualDisplay
            Display; call `plot`.
        """
        models, found, joints = _compared(
            cls, estimator, X, y, groups, t, joints, signals
        )
        names = models[0].joint_names_
        values = [
            np.where(r.weight > 0, r.residual, np.nan)[:, joints]
            for r in (found[0], found[-1])
        ]
        signals = _signals(models[-1], X, groups, t, found[0].index, joints)
        return cls(
            residual_before=values[0],
            residual_after=values[1] if len(models) > 1 else None,
            signals=signals,
            joint_names=tuple(names[j] for j in joints),
            units=_torque_units(models[-1], joints),
            floor=np.asarray(models[-1].noise_floor_, dtype=float)[joints],
        )

    @classmethod
    def from_report(cls, report, *, joints=None):
        """Show what a discovery left on the held-out part of the recording.

        Parameters
        ----------
        report : Report
            Its report, which keeps the residuals before and after for pictures.
        joints : list of int, default=None
            Joints to show, from zero; None shows all.

        Returns
        -------
        ResidualDisplay
            Display over torque and, where the sample period is known, time; call
            `plot`.
        """
        outcome, curves = report.outcome, report.outcome.curves
        joints = _check_joints(joints, len(outcome.joint_names))
        counts = curves["weight"] > 0
        units = tuple(outcome.torque_units[j] for j in joints)
        signals = {
            f"torque [{' or '.join(dict.fromkeys(units))}]": curves["torque"][:, joints]
        }
        if "seconds" in curves:
            signals["time [s]"] = curves["seconds"]
        before, after = (
            np.where(counts, curves[key], np.nan)[:, joints]
            for key in ("before", "after")
        )
        return cls(
            residual_before=before,
            residual_after=after,
            signals=signals,
            joint_names=tuple(outcome.joint_names[j] for j in joints),
            units=units,
            floor=(outcome.floor * outcome.spread)[joints],
        )

    def plot(self, ax=None, *, medians=True, scatter_kwargs=None, line_kwargs=None):
        """Draw.

        Parameters
        ----------
        ax : array-like of Axes, default=None
            One row a joint, one column a signal; None makes a figure.
        medians : bool, default=True
            Whether running medians are drawn.
        scatter_kwargs, line_kwargs : dict, default=None
            What matplotlib's ``plot`` gets for the samples and for the medians.

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
        self._open(
            ax,
            [shape],
            "one row a joint and one column a signal",
            sharey="row",
            sharex="col" if rows == 1 else False,
            figsize=(3.0 * columns + 0.6, 1.7 * rows + 0.7),
        )
        self.axes_ = self.axes_.reshape(shape)
        self.lines_, self.median_lines_ = [], []
        styles = scatter_kwargs or {}, (line_kwargs or {}) if medians else None
        for j, axes in enumerate(self.axes_):
            for axis, (name, signal) in zip(axes, self.signals.items()):
                signal = np.asarray(signal)
                self._panel(
                    axis, j, signal[:, j] if signal.ndim == 2 else signal, *styles
                )
                if j == rows - 1:
                    axis.set_xlabel(name)
            axes[0].set_ylabel(f"{self.joint_names[j]} [{self.units[j]}]")
        if ax is None:
            self.figure_.supylabel("torque residual", fontsize="medium")
        self._name_artists()
        self._close(ax)
        return self

    def _panel(self, ax, j, x, scatter_style, line_style):
        floor = np.nan if self.floor is None else float(self.floor[j])
        if np.isfinite(floor):
            ax.axhspan(-floor, floor, color=_FLOOR, alpha=0.25, lw=0, zorder=0)
        ax.axhline(0.0, color="0.5", lw=0.6, zorder=1)
        every = slice(None, None, max(1, x.size // _POINTS))
        size = float(np.clip(60.0 / np.sqrt(max(x.size, 1)), 1.5, 5.0))
        shown = [np.empty(0)]
        for values, colour, dark in (
            (self.residual_before, _GREY, "0.35"),
            (self.residual_after, _COLOUR, "navy"),
        ):
            if values is None:
                continue
            r = np.asarray(values)[:, j]
            shown.append(np.abs(r[np.isfinite(r)]))
            dots = {"ls": "", "marker": ".", "ms": size, "color": colour, "alpha": 0.7}
            dots |= {"rasterized": True} | scatter_style
            self.lines_ += ax.plot(x[every], r[every], **dots)
            if line_style is not None:
                line = {"color": dark, "lw": 1.5} | line_style
                self.median_lines_ += ax.plot(*running_median(x, r), **line)
        shown = np.concatenate(shown)
        limit = 1.1 * float(np.quantile(shown, _QUANTILE)) if shown.size else 0.0
        if limit > 0:
            ax.set_ylim(-limit, limit)

    def _name_artists(self):
        """Give the legend marks that are larger than the samples."""
        ax = self.axes_[0, 0]
        dots = {"marker": ".", "ms": 8, "ls": ""}
        entries = [("before", {"color": _GREY} | dots)]
        if self.residual_after is not None:
            entries.append(("after", {"color": _COLOUR} | dots))
        if self.floor is not None and np.isfinite(self.floor).any():
            entries.append(("noise floor", {"color": _FLOOR, "lw": 6, "alpha": 0.4}))
        for label, style in entries:
            ax.plot([], [], label=label, **style)


class TorqueDisplay(Display):
    """Measured and predicted torques over time.

    One row a joint: the measured torque, the prediction of the declared model and that
    of the completed one.

    Parameters
    ----------
    time : ndarray of shape (m,)
        Time [s]; rows without a sample period are counted.
    measured : ndarray of shape (m, nv)
        Measured torques after the low-pass [N m or N].
    before : ndarray of shape (m, nv)
        Torques that the declared model predicts [N m or N].
    after : ndarray of shape (m, nv), default=None
        Torques that the completed model predicts [N m or N].
    joint_names : sequence of str
        Joints.
    units : sequence of str
        Units of their torques.

    Attributes
    ----------
    figure_ : matplotlib Figure
        Figure, after `plot`.
    axes_ : ndarray of Axes, shape (nv,)
        Axes, after `plot`.
    lines_ : list of matplotlib Line2D
        Curves of each joint, after `plot`: measured, before, after.

    See Also
    --------
    TorqueDisplay.from_estimator : Make one from a fitted model and a recording.
    TorqueDisplay.from_report : Make one from the report of a discovery.

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

    _accepts = "a RobotIdentifier or an EffectDiscovery"

    def __init__(self, *, time, measured, before, after=None, joint_names, units):
        self.time = time
        self.measured = measured
        self.before = before
        self.after = after
        self.joint_names = joint_names
        self.units = units

    @classmethod
    def from_estimator(
        cls, estimator, X, y, groups=None, t=None, joints=None, signals=None
    ):
        """Predict the torques of a recording by a fitted model.

        Parameters
        ----------
        estimator : EffectDiscovery or RobotIdentifier
            Fitted; a discovery shows the declared model before, the completed one
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
        TorqueDisplay
            Display; call `plot`.
        """
        models, found, joints = _compared(
            cls, estimator, X, y, groups, t, joints, signals
        )
        robot, index = models[-1], found[0].index
        clock = check_clock(t, np.shape(X)[0], robot.dt)
        predicted = [r.predicted[:, joints] for r in found]
        return cls(
            time=index if clock is None else clock[index],
            measured=found[0].torque[:, joints],
            before=predicted[0],
            after=predicted[1] if len(models) > 1 else None,
            joint_names=tuple(robot.joint_names_[j] for j in joints),
            units=_torque_units(robot, joints),
        )

    @classmethod
    def from_report(cls, report, *, joints=None):
        """Show the torques of the held-out part of the recording of a discovery.

        Parameters
        ----------
        report : Report
            Its report, which keeps torques and residuals for pictures.
        joints : list of int, default=None
            Joints to show, from zero; None shows all.

        Returns
        -------
        TorqueDisplay
            Display; call `plot`.
        """
        outcome, curves = report.outcome, report.outcome.curves
        joints = _check_joints(joints, len(outcome.joint_names))
        torque = curves["torque"]
        return cls(
            time=curves.get("seconds", curves["index"]),
            measured=torque[:, joints],
            before=(torque - curves["before"])[:, joints],
            after=(torque - curves["after"])[:, joints],
            joint_names=tuple(outcome.joint_names[j] for j in joints),
            units=tuple(outcome.torque_units[j] for j in joints),
        )

    def plot(self, ax=None, *, line_kwargs=None):
        """Draw.

        Parameters
        ----------
        ax : array-like of Axes, default=None
            One for each joint; None makes a figure.
        line_kwargs : dict, default=None
            What matplotlib's ``plot`` gets for all curves.

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
        shape = {"sharex": True, "figsize": (8.0, 1.6 * rows + 0.7)}
        self._open(ax, [(rows, 1)], "one for each joint", **shape)
        self.lines_ = []
        every = slice(None, None, max(1, len(self.time) // _POINTS))
        for j, axis in enumerate(self.axes_):
            for label, values, colour in (
                ("measured", self.measured, _MEASURED),
                ("before", self.before, _FLOOR),
                ("after", self.after, _COLOUR),
            ):
                if values is not None:
                    style = {"color": colour, "lw": 1.0, "label": label}
                    style |= line_kwargs or {}
                    shown = np.asarray(values)[every, j]
                    self.lines_ += axis.plot(self.time[every], shown, **style)
            axis.set_ylabel(f"{self.joint_names[j]} [{self.units[j]}]")
        self.axes_[-1].set_xlabel("time [s]")
        self._close(ax)
        return self


def _compared(cls, estimator, X, y, groups, t, joints, signals):
    """Return the models of an estimator, their residuals, and the joints to show."""
    check_is_fitted(estimator)
    if isinstance(estimator, RobotIdentifier):
        models = (estimator,)
    else:
        cls._require(estimator, ("declared_", "identifier_"))
        models = (estimator.declared_, estimator.identifier_)
    joints = _check_joints(joints, len(models[0].joint_names_))
    found = [model.residuals(X, y, groups, t=t, signals=signals) for model in models]
    return models, found, joints


def _torque_units(robot, joints):
    prismatic = is_prismatic(robot.features_.model_)
    return tuple("N" if prismatic[j] else "N m" for j in joints)


def running_median(x, y):
    """Medians of x and y in bins of x that hold as many samples each, without nan."""
    used = np.isfinite(x) & np.isfinite(y)
    x, y = x[used], y[used]
    count = min(_BINS, x.size // _FEWEST)
    if count == 0:
        return np.empty(0), np.empty(0)
    parts = np.array_split(np.argsort(x, kind="stable"), count)
    return (np.array([np.median(z[part]) for part in parts]) for z in (x, y))


def _check_joints(joints, nv):
    found = list(range(nv)) if joints is None else [int(j) for j in joints]
    if not found or any(not 0 <= j < nv for j in found):
        raise ValueError(f"joints must be some of 0 to {nv - 1}; got {joints!r}.")
    return found


def _signals(robot, X, groups, t, index, joints):
    """Velocity, position, load and time at the rows of the residuals."""
    X = np.asarray(X, dtype=float)
    parts = contiguous_groups(groups, X.shape[0])
    clock = check_clock(t, X.shape[0], robot.dt)
    rigid = robot.theta_[: robot.features_.n_parameters_]
    motion = make_motion(
        robot.features_,
        robot.robot_.states(X, groups),
        clock,
        parts,
        rigid,
        robot.cutoff_,
    )
    kinds, load = motion.prismatic[joints], motion.load[index][:, joints]
    signals = {
        f"velocity [{_unit(kinds, 'rad/s', 'm/s')}]": motion.v[index][:, joints],
        f"position [{_unit(kinds, 'rad', 'm')}]": motion.q[index][:, joints],
        f"rigid-body torque [{_unit(kinds, 'N m', 'N')}]": load,
    }
    if clock is not None:
        signals["time [s]"] = clock[index]
    return signals


def _unit(kinds, turning, sliding):
    """Return the unit of what the joints of some kinds share, or both units."""
    return " or ".join(dict.fromkeys(sliding if kind else turning for kind in kinds))
