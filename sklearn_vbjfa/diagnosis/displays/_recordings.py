"""A model beside a recording: what it leaves of the torque, and how it moves."""

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_vbjfa._core._progress import counted
from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
from sklearn_vbjfa.diagnosis.displays._base import Display
from sklearn_vbjfa.recording import check_clock, contiguous_groups
from sklearn_vbjfa.robot._equations import make_motion
from sklearn_vbjfa.robot._identifier import RobotIdentifier
from sklearn_vbjfa.robot._robot import IdentifiedRobot
from sklearn_vbjfa.robot._windows import simulate_windows

# Points of one panel: more are a blot, and slow.
_POINTS = 4000
# Bins of the running median, and how many samples one must hold.
_BINS, _FEWEST = 25, 5
# Samples beyond this quantile of the residual do not set the scale.
_QUANTILE = 0.998
_GREY, _COLOUR, _FLOOR = "0.72", "tab:blue", "tab:orange"
# Most windows of a figure of one's own: more are no longer told apart.
_MOST_WINDOWS = 16
# What runs away may leave the measured range by this share of it, and is cut off there.
_MARGIN = 0.6
# Positions that hardly move have at least this range [degrees or mm].
_SMALLEST = 0.1
_COLOURS = ("tab:orange", "tab:blue", "tab:green", "tab:purple")
_MEASURED, _BORDER, _FAILED, _TOLD = "0.25", "0.85", "tab:red", "0.5"


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
            Columns recorded beside the motion, for effects that vary with them.

        Returns
        -------
        ResidualDisplay
            Display; call `plot`.
        """
        check_is_fitted(estimator)
        if isinstance(estimator, RobotIdentifier):
            robot, models = estimator, (estimator,)
        else:
            cls._require(estimator, ("declared_", "identifier_"))
            robot = estimator.declared_
            models = (robot, estimator.identifier_)
        names = robot.joint_names_
        joints = _check_joints(joints, len(names))
        found = [
            model.residuals(X, y, groups, t=t, signals=signals) for model in models
        ]
        values = [
            np.where(r.weight > 0, r.residual, np.nan)[:, joints]
            for r in (found[0], found[-1])
        ]
        signals, prismatic = _signals(models[-1], X, groups, t, found[0].index, joints)
        return cls(
            residual_before=values[0],
            residual_after=values[1] if len(models) > 1 else None,
            signals=signals,
            joint_names=tuple(names[j] for j in joints),
            units=tuple("N" if prismatic[j] else "N m" for j in joints),
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
        robot.robot_.query(X, groups)[0],
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
    return signals, motion.prismatic


def _unit(kinds, turning, sliding):
    """Return the unit of what the joints of some kinds share, or both units."""
    return " or ".join(dict.fromkeys(sliding if kind else turning for kind in kinds))


class SimulationDisplay(Display):
    """Measured and simulated positions over windows, joint by joint.

    One row a joint. Every window begins at its vertical line, at the measured state;
    the errors beside a joint's name are root mean squares over all windows that were
    simulated to their end. Windows that were not are shaded, and counted below. A star
    marks errors that are not clearly smaller than those of a robot that stays and of
    one that keeps its velocity, or of one that is where it is told to be
    (`SimulatedWindows.clearly_better`). Commanded positions are dotted.

    Parameters
    ----------
    windows : dict of str to SimulatedWindows
        Simulations of the same windows; the keys become labels.

    Attributes
    ----------
    figure_ : matplotlib Figure
        Figure, after `plot`.
    axes_ : ndarray of Axes, shape (nv,)
        Axes, after `plot`.
    measured_lines_ : list of matplotlib Line2D
        Measured positions, one line a joint, after `plot`.
    lines_ : list of matplotlib Line2D
        Simulated positions, one line a joint for each label in turn, after `plot`.

    See Also
    --------
    SimulationDisplay.from_estimator : Make one from a robot and a recording.
    simulate_windows : Simulates the windows.

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.diagnosis import SimulationDisplay
    >>> recording = load_demo_recording().select(0)
    >>> robot = RobotIdentifier(
    ...     recording.urdf, dt=recording.dt, friction=("viscous", "coulomb")
    ... )
    >>> robot = robot.fit(recording.q[:3000], recording.tau[:3000])
    >>> display = SimulationDisplay.from_estimator(
    ...     robot, recording.q[3000:], recording.tau[3000:], window=0.5
    ... )
    >>> display.windows["simulated"].n_windows
    9
    """

    _accepts = "a RobotIdentifier, an IdentifiedRobot or an EffectDiscovery"

    def __init__(self, *, windows):
        self.windows = windows

    @classmethod
    def from_estimator(
        cls, estimator, X, y, groups=None, t=None, *, window=1.0, signals=None
    ):
        """Simulate windows of a recording.

        Parameters
        ----------
        estimator : RobotIdentifier, IdentifiedRobot or EffectDiscovery
            Fitted; a discovery shows the declared and the completed model.
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Measured joint positions [rad or m], or states.
        y : array-like of shape (n_samples, nv)
            Measured torques [N m or N].
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        t : array-like of shape (n_samples,), default=None
            Time [s] on the clock of the fit, for effects that vary with time.
        window : float, default=1.0
            Length of a window [s].
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Columns recorded beside the motion, for effects that vary with them.

        Returns
        -------
        SimulationDisplay
            Display; call `plot`.

        Raises
        ------
        ValueError
            As `simulate_windows` does.
        """
        robots = cls._robots(estimator)
        settings = {"window": window, "signals": signals}
        return cls(windows=windows_of(robots, X, y, groups, t, **settings))

    @classmethod
    def _robots(cls, estimator):
        """Return what is simulated, by its label."""
        if isinstance(estimator, IdentifiedRobot):
            return {"simulated": estimator}
        if not isinstance(estimator, (RobotIdentifier, EffectDiscovery)):
            raise TypeError(
                f"{cls.__name__} shows {cls._accepts}; got {type(estimator).__name__}."
            )
        check_is_fitted(estimator)
        if isinstance(estimator, RobotIdentifier):
            return {"simulated": estimator}
        robots = {"declared model": estimator.declared_}
        if estimator.added_:
            robots["with the four plain terms"] = estimator.baseline_
        return {**robots, "completed model": estimator.identifier_}

    def plot(self, ax=None, *, shown=None, measured_kwargs=None, line_kwargs=None):
        """Draw.

        Parameters
        ----------
        ax : array-like of Axes, default=None
            One for each joint; None makes a figure.
        shown : slice or sequence of int, default=None
            Numbers of the windows to draw, from zero; None draws the first ones, at
            most 16.
        measured_kwargs, line_kwargs : dict, default=None
            What matplotlib's ``plot`` gets for measured and for simulated positions.

        Returns
        -------
        self : object
            With `figure_`, `axes_`, `measured_lines_` and `lines_`.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If the axes do not match, or no window is shown.
        """
        one = next(iter(self.windows.values()))
        chosen = _chosen(shown, one.n_windows)
        rows = len(one.joint_names)
        self._open(
            ax,
            [(rows, 1)],
            "one for each joint",
            sharex=True,
            figsize=(min(4.5 + 0.45 * chosen.size, 11.0), 1.5 * rows + 1.0),
        )
        self.measured_lines_, self.lines_ = [], []
        for j, axis in enumerate(self.axes_):
            self._joint(axis, j, chosen, measured_kwargs or {}, line_kwargs or {})
        self.axes_[-1].set_xlabel("\n".join(["time [s]", *self._notes()]))
        self._name_artists(chosen)
        if ax is None and chosen.size < one.n_windows:
            low, high = chosen.min() + 1, chosen.max() + 1
            self.figure_.supxlabel(
                f"windows {low} to {high} of {one.n_windows}", fontsize="small"
            )
        self._close(ax)
        return self

    def _joint(self, ax, j, chosen, measured_style, line_style):
        """Draw one joint."""
        one = next(iter(self.windows.values()))
        scale, unit = (1e3, "mm") if one.prismatic[j] else (180 / np.pi, "degrees")
        for k in chosen:
            ax.axvline(one.t[k, 0], color=_BORDER, lw=0.8, zorder=0)
        if one.told is not None:
            told = _joined(one.t, scale * one.told[..., j], chosen)
            ax.plot(*told, color=_TOLD, lw=1.0, ls=":", label="commanded")
        measured = _joined(one.t, scale * one.positions[..., j], chosen)
        style = {"color": _MEASURED, "lw": 2.4, "alpha": 0.45} | measured_style
        self.measured_lines_ += ax.plot(*measured, **style)
        told = []
        for (label, own), colour in zip(self.windows.items(), self._colours()):
            curve = _joined(own.t, scale * own.simulated[..., j], chosen)
            style = {"color": colour, "lw": 1.2} | line_style
            self.lines_ += ax.plot(*curve, **style)
            for k in chosen[own.failed[chosen]]:
                span = own.t[k, 0], own.t[k, -1]
                ax.axvspan(*span, color=_FAILED, alpha=0.12, lw=0, zorder=0)
            factors, units = own.scales
            errors = factors[j] * own.errors[~own.failed, j]
            size = "none"
            if errors.size:
                star = "" if own.clearly_better[j] else "*"
                size = f"{np.sqrt(np.mean(errors**2)):.3g} {units[j]}{star}"
            told.append(f"{label} {size}" if len(self.windows) > 1 else size)
        low, high = np.nanmin(measured[1]), np.nanmax(measured[1])
        room = _MARGIN * max(high - low, _SMALLEST)
        bottom, top = ax.get_ylim()
        ax.set_ylim(max(bottom, low - room), min(top, high + room))
        ax.set_ylabel(f"[{unit}]")
        ax.set_title(one.joint_names[j], loc="left", fontsize="small")
        text = f"rms error: {', '.join(told)}"
        ax.set_title(text, loc="right", fontsize="small")

    def _notes(self):
        """Say what the star means, and how many windows failed."""
        found = []
        starred = [~own.clearly_better.all() for own in self._simulated()]
        if any(starred):
            without = "to stay and to keep the velocity"
            if next(iter(self.windows.values())).told is not None:
                without = "to be where it is told to be"
            found.append(f"* not clearly better than {without}")
        for label, own in self.windows.items():
            if own.failed.any():
                told = f"{own.failed.sum()} of {own.n_windows} windows failed, "
                told += "not in these errors"
                found.append(f"{label}: {told}" if len(self.windows) > 1 else told)
        return found

    def _simulated(self):
        """Return the windows of those of which any was simulated to its end."""
        return [own for own in self.windows.values() if not own.failed.all()]

    def _colours(self):
        """Return one colour for each label."""
        count = len(self.windows)
        if count == 1:
            return _COLOURS[1:2]
        return [_COLOURS[k % len(_COLOURS)] for k in range(count)]

    def _name_artists(self, chosen):
        """Give the legend one entry for each kind of line."""
        ax = self.axes_[0]
        self.measured_lines_[0].set_label("measured")
        for label, line in zip(self.windows, self.lines_):
            line.set_label(label)
        if any(own.failed[chosen].any() for own in self.windows.values()):
            style = {"color": _FAILED, "alpha": 0.3, "lw": 6}
            ax.plot([], [], label="simulation failed", **style)


def windows_of(robots, *recording, by=simulate_windows, **settings):
    """Simulate the same windows by several robots, of each label its windows."""
    # recording, settings: what `simulate_windows`, or `follow_windows`, gets beside the
    # robot.
    found = {}
    for label in counted(robots, "simulating", "robots"):
        robot, first = robots[label], next(iter(found.values()), None)
        found[label] = by(robot, *recording, beside=first, **settings)
    return found


def _chosen(shown, n_windows):
    """Numbers of the windows to draw, ndarray of int."""
    if shown is None:
        shown = slice(_MOST_WINDOWS)
    if isinstance(shown, slice):
        found = np.arange(n_windows)[shown]
    else:
        found = np.asarray(shown, dtype=int)
    if not found.size or found.min() < 0 or found.max() >= n_windows:
        raise ValueError(
            f"shown must choose some of the windows 0 to {n_windows - 1}; got "
            f"{shown!r}."
        )
    return found


def _joined(t, values, chosen):
    """Join windows to one line, broken between them; its times and values."""
    gap = np.full((chosen.size, 1), np.nan)
    x = np.hstack([t[chosen], gap]).ravel()
    return x, np.hstack([values[chosen], gap]).ravel()
